"""Measurements from a recorded LCM log of the flight process: everything that KC_MEAS carries."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kincal_shared.errors import BadInput

from ...numerics.types import Array
from ..measurements import Measurements, replicate_groups
from .ranges import RANGES, unusable_variance

if TYPE_CHECKING:
    from kincal.link.messages import Meas

_UNIT_TOLERANCE = 1e-3  # of the norm of a quaternion
_SYNC = bytes.fromhex("eda1da01")  # first word of an LCM event log


def is_log(path: str | Path) -> bool:
    """Whether a file begins as LCM event logs do."""
    try:
        with open(path, "rb") as file:
            return file.read(len(_SYNC)) == _SYNC
    except OSError:
        return False


def read_log(path: str | Path, n_joints: int, *, session: int | None = None) -> Measurements:
    """All measurements of one session of a log (the last one with measurements if not named).

    BadInput if there are none, or they are of another arm or of different tables.
    """
    number, rows = _session(Path(path), session)
    where = f"{path}: session {number}"
    if other := {m.n_joints for m in rows} - {n_joints}:
        raise BadInput(f"{where} was recorded with {min(other)} joints, the arm table has {n_joints}")
    if len({(m.crc_arm, m.crc_terms, m.crc_camera) for m in rows}) > 1:
        raise BadInput(f"{where} mixes measurements of different tables; split the log")
    _refuse_damaged(rows, n_joints, where)
    q = _stack(rows, lambda m: m.q_rad[:n_joints])
    payload_kg = _stack(rows, lambda m: m.payload_kg)
    return Measurements(
        source=f"{path} session {number}",
        ids=tuple(_name(m) for m in rows),
        q=q,
        p_m=_stack(rows, lambda m: m.p_m),
        quat_wxyz=_stack(rows, lambda m: m.q_wxyz),
        cov=_covariance(rows),
        t_s=_stack(rows, lambda m: m.t_us * 1e-6),
        direction=_stack(rows, lambda m: m.dir[:n_joints]),
        qdot=_stack(rows, lambda m: m.dq_rad_s[:n_joints]),
        g_m_s2=_stack(rows, lambda m: m.g_m_s2),
        tag=_stack(rows, _tag_share),
        cam_p_m=_stack(rows, lambda m: m.p_cam_m),
        cam_quat_wxyz=_stack(rows, lambda m: m.q_cam_wxyz),
        replicate=replicate_groups(q, payload_kg),
        temp_c=_stack(rows, lambda m: m.temp_c),
        payload_kg=payload_kg,
        range_m=_stack(rows, lambda m: m.range_m),
        incid_rad=_stack(rows, lambda m: m.incid_rad),
        u_px=_stack(rows, lambda m: m.u_px),
        v_px=_stack(rows, lambda m: m.v_px),
        pan_rad=_stack(rows, lambda m: m.pan_rad),
        tilt_rad=_stack(rows, lambda m: m.tilt_rad),
    )


def _name(m: Meas) -> str:
    """Number of the pose, which replicate it is, or which observation on the way to the pose."""
    if m.taken_at:
        return f"{m.pose}w{m.observation}"
    return f"{m.pose}r{m.replicate}" if m.replicate else f"{m.pose}"


def _session(path: Path, number: int | None) -> tuple[int, Sequence[Meas]]:
    """Number and measurements of a session."""
    from kincal import link  # needs the messages' types; a CSV does not

    sessions = link.read_log(path, ["KC_MEAS"]).sessions
    found = {n: s.measurements for n, s in sessions.items() if s.measurements}
    if not found:
        raise BadInput(f"{path}: holds no measurement (channel KC_MEAS); record a calibration")
    number = max(found) if number is None else number
    if number not in found:
        raise BadInput(f"{path}: has no session {number}; it holds {', '.join(map(str, sorted(found)))}")
    return number, found[number]


# What a fit computes with: a number that is none there would be in every result.
_NUMBERS = (
    "q_rad", "dq_rad_s", "p_m", "q_wxyz", "cov", "p_cam_m", "q_cam_wxyz", "g_m_s2", "temp_c", "payload_kg",
    "range_m", "incid_rad", "u_px", "v_px", "pan_rad", "tilt_rad",
)  # fmt: skip
_SCALARS = tuple(name for name in _NUMBERS if name in RANGES)


def _refuse_damaged(rows: Sequence[Meas], n_joints: int, where: str) -> None:
    """BadInput names the first measurement whose numbers cannot be used."""
    for m in rows:
        wrong = [name for name in _NUMBERS if not np.isfinite(getattr(m, name)).all()]
        wrong += [f"q_rad ({x:g} rad)" for x in m.q_rad[:n_joints] if RANGES["q"].wrong(x)]
        wrong += [f"p_m ({x:g} m)" for x in m.p_m if RANGES["p"].wrong(x)]
        wrong += [RANGES[name].why(name, x) for name in _SCALARS if RANGES[name].wrong(x := getattr(m, name))]
        for name in ("q_wxyz", "q_cam_wxyz"):
            if not wrong and abs(np.linalg.norm(getattr(m, name)) - 1.0) > _UNIT_TOLERANCE:
                wrong.append(f"{name} (norm {np.linalg.norm(getattr(m, name)):.4g})")
        if not wrong and np.linalg.eigvalsh(_covariance([m])[0])[0] <= 0.0:
            wrong.append("cov (not positive definite)")
        if not wrong and unusable_variance(_covariance([m]))[0]:
            wrong.append("cov (a variance of no instrument)")
        if wrong:
            raise BadInput(
                f"{where}: the measurement of pose {m.pose} is damaged: {', '.join(wrong[:4])}",
                todo="take the log from the recorder again",
            )


def _stack(rows: Sequence[Meas], get: Callable[[Any], object]) -> Array:
    """(N, ...) of one field of the messages."""
    return np.array([get(m) for m in rows], dtype=float)


def _covariance(rows: Sequence[Meas]) -> Array:
    """(N, 6, 6) of the upper triangles."""
    cov = np.zeros((len(rows), 6, 6))
    cov[:, *np.triu_indices(6)] = _stack(rows, lambda m: m.cov)
    cov += np.triu(cov, 1).transpose(0, 2, 1)
    return cov


def _tag_share(m: Meas) -> float:
    """0 first tag only, 1 second only, 0.5 both (KC_VAR_TAG); tags in ascending order of id."""
    seen = [tag for tag in m.tag_id[: m.n_tags] if tag >= 0]
    return 0.5 if len(seen) != 1 else float(seen[0] != 0)
