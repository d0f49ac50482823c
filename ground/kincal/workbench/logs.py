"""Measurements from a recorded LCM log of the flight process: everything that KC_MEAS carries."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kincal.errors import BadInput

from .data import Measurements, read_csv, replicate_groups


def is_log(path: str | Path) -> bool:
    """LCM event logs begin with the sync word EDA1DA01 (LCM log file format)."""
    try:
        with open(path, "rb") as file:
            return file.read(4) == bytes.fromhex("eda1da01")
    except OSError:
        return False


def read_measurements(path: str | Path, n_joints: int, *, skip_bad: bool = False, session: int | None = None):
    """CSV or LCM log, by content. BadInput as read_csv; a log of another arm is refused."""
    return (
        read_log(path, n_joints, session=session)
        if is_log(path)
        else read_csv(path, n_joints, skip_bad=skip_bad)
    )


def read_log(path: str | Path, n_joints: int, *, session: int | None = None) -> Measurements:
    """All measurements of one session (the last one with measurements if not named)."""
    from kincal import lcmlog

    path = Path(path)
    sessions = {number: s for number, s in lcmlog.read(path).sessions.items() if s.measurements}
    if not sessions:
        raise BadInput(f"{path}: holds no measurement (channel KC_MEAS); record a calibration")
    number = max(sessions) if session is None else session
    if number not in sessions:
        raise BadInput(f"{path}: has no session {number}; it holds {', '.join(map(str, sorted(sessions)))}")
    rows = sessions[number].measurements
    if rows[0].n_joints != n_joints:
        raise BadInput(f"{path}: was recorded with {rows[0].n_joints} joints, the arm table has {n_joints}")
    crcs = {(m.crc_arm, m.crc_terms, m.crc_camera) for m in rows}
    if len(crcs) > 1:
        raise BadInput(f"{path}: session {number} mixes measurements of different tables; split the log")

    def stack(get) -> np.ndarray:
        return np.array([get(m) for m in rows], dtype=float)

    cov = np.zeros((len(rows), 6, 6))
    cov[:, *np.triu_indices(6)] = stack(lambda m: m.cov)
    cov += np.triu(cov, 1).transpose(0, 2, 1)
    q = stack(lambda m: m.q_rad[:n_joints])
    return Measurements(
        source=f"{path} session {number}",
        ids=tuple(f"{m.pose}" if not m.replicate else f"{m.pose}r{m.replicate}" for m in rows),
        q=q,
        p_m=stack(lambda m: m.p_m),
        quat_wxyz=stack(lambda m: m.q_wxyz),
        cov=cov,
        t_s=stack(lambda m: m.t_us * 1e-6),
        direction=stack(lambda m: m.dir[:n_joints]),
        qdot=stack(lambda m: m.dq_rad_s[:n_joints]),
        temp_c=stack(lambda m: m.temp_c),
        payload_kg=stack(lambda m: m.payload_kg),
        g_m_s2=stack(lambda m: m.g_m_s2),
        range_m=stack(lambda m: m.range_m),
        incid_rad=stack(lambda m: m.incid_rad),
        u_px=stack(lambda m: m.u_px),
        v_px=stack(lambda m: m.v_px),
        tag=stack(_tag_share),
        cam_p_m=stack(lambda m: m.p_cam_m),
        cam_quat_wxyz=stack(lambda m: m.q_cam_wxyz),
        pan_rad=stack(lambda m: m.pan_rad),
        tilt_rad=stack(lambda m: m.tilt_rad),
        replicate=replicate_groups(q),
    )


def _tag_share(m) -> float:
    """0 first tag only, 1 second only, 0.5 both (kc_terms.h KC_VAR_TAG); tags in ascending order of id."""
    seen = [tag for tag in m.tag_id[: m.n_tags] if tag >= 0]
    return 0.5 if len(seen) != 1 else float(seen[0] != 0)
