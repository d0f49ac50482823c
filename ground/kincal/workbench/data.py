"""Measurements: the workbench's CSV format (docs/WORKBENCH.md) into arrays.

Every row is checked; a malformed one is refused by line number with the reason, or skipped and
counted when asked to.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from kincal.errors import BadInput

_COV_NAMES = [f"c{i}{j}" for i in range(1, 7) for j in range(i, 7)]
_CAM_NAMES = ["cx", "cy", "cz", "cqw", "cqx", "cqy", "cqz"]
_SCALARS = ["t_s", "sp_m", "sr_rad", "temp_c", "payload_kg", "range_m", "incid_rad", "u_px", "v_px", "tag"]
_VECTORS = {
    "quat": ["qw", "qx", "qy", "qz"],
    "g_m_s2": ["gx", "gy", "gz"],
    "cam": _CAM_NAMES,
    "cov": _COV_NAMES,
}
_UNIT_TOL = 1e-3
# Names that effects use for their needs, where they differ from ours.
_RENAMED = {"dir": "direction", "cam": "cam_p_m", "rotation": "quat_wxyz"}


@dataclass(frozen=True)
class Measurements:
    """Arrays of N poses of an arm with n joints; optional ones are None when the file lacks them.

    q: (N, n) encoder readings [rad or m]; p_m: (N, 3) measured tool position, base frame;
    quat_wxyz: (N, 4); cov: (N, 6, 6) stated covariance of (position, rotation vector), base frame
    (None if nothing was stated); direction: (N, n) approach signs; cam_p_m, cam_quat_wxyz: camera
    pose in the base frame. `replicate` groups poses that were measured again (same commanded pose).
    """

    source: str
    ids: tuple[str, ...]
    q: np.ndarray
    p_m: np.ndarray
    quat_wxyz: np.ndarray | None = None
    cov: np.ndarray | None = None
    t_s: np.ndarray | None = None
    direction: np.ndarray | None = None
    qdot: np.ndarray | None = None
    temp_c: np.ndarray | None = None
    payload_kg: np.ndarray | None = None
    g_m_s2: np.ndarray | None = None
    range_m: np.ndarray | None = None
    incid_rad: np.ndarray | None = None
    u_px: np.ndarray | None = None
    v_px: np.ndarray | None = None
    cam_p_m: np.ndarray | None = None
    cam_quat_wxyz: np.ndarray | None = None
    tag: np.ndarray | None = None
    pan_rad: np.ndarray | None = None
    tilt_rad: np.ndarray | None = None
    split: np.ndarray | None = None
    replicate: np.ndarray | None = None
    order_is_time: bool = False
    skipped: tuple[str, ...] = ()
    unknown_columns: tuple[str, ...] = field(default=())

    @property
    def n(self) -> int:
        return len(self.ids)

    @property
    def n_joints(self) -> int:
        return self.q.shape[1]

    @property
    def components(self) -> int:
        """6 with orientation, 3 with positions only."""
        return 6 if self.quat_wxyz is not None else 3

    def take(self, index: np.ndarray) -> Measurements:
        """The poses of `index` (positions or mask), in that order."""
        index = np.asarray(index)
        if index.dtype == bool:
            index = np.flatnonzero(index)
        changes: dict[str, object] = {"ids": tuple(self.ids[i] for i in index)}
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray):
                changes[name] = value[index]
        return replace(self, **changes)

    def has(self, column: str) -> bool:
        """Whether the data carry what an effect needs (`dir`, `temp_c`, `cam`, `rotation` ...)."""
        if column == "own_sensor":
            return self.cam_p_m is None
        return getattr(self, _RENAMED.get(column, column)) is not None

    def constant(self, column: str) -> bool:
        """Whether a column is there and never changes."""
        values = getattr(self, _RENAMED.get(column, column), None)
        return values is not None and not np.ptp(values, axis=0).any()


def read_csv(path: str | Path, n_joints: int, *, skip_bad: bool = False) -> Measurements:
    """Read a measurements file for an arm with `n_joints` joints.

    Raises BadInput naming file, line and reason for a missing column, a malformed row, a
    quaternion that is not of unit norm, a covariance that is not positive definite.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise BadInput(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(f"{path}: cannot be read as UTF-8 text: {error}") from None
    lines = [
        (number, line)
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not lines:
        raise BadInput(f"{path}: is empty; a header row with q1..q{n_joints},px,py,pz is needed")
    header_line, header_text = lines[0]
    header = [name.strip() for name in next(csv.reader([header_text]))]
    plan = _plan_columns(path, header_line, header, n_joints)

    rows, problems = [], []
    for number, line in lines[1:]:
        try:
            rows.append(_parse_row(next(csv.reader([line])), header, plan))
        except ValueError as error:
            problems.append(f"line {number}: {error}")
    if problems and not skip_bad:
        shown = "\n  ".join(problems[:10])
        more = f"\n  ... and {len(problems) - 10} more" if len(problems) > 10 else ""
        raise BadInput(
            f"{path}: {len(problems)} malformed row(s); mend them or use --skip-bad\n  {shown}{more}"
        )
    if not rows:
        raise BadInput(f"{path}: has no usable row")
    return _assemble(path, rows, plan, header, tuple(problems))


def _plan_columns(path: Path, line: int, header: list[str], n_joints: int) -> dict[str, list[str]]:
    """Which columns are there, by quantity; BadInput names what is missing or doubled."""
    doubled = sorted({name for name in header if header.count(name) > 1})
    if doubled:
        raise BadInput(f"{path}: line {line}: column {', '.join(doubled)} stands twice in the header")
    required = [f"q{j}" for j in range(1, n_joints + 1)] + ["px", "py", "pz"]
    missing = [name for name in required if name not in header]
    if missing:
        raise BadInput(
            f"{path}: line {line}: column(s) {', '.join(missing)} missing; an arm with {n_joints} "
            f"joints needs q1..q{n_joints},px,py,pz"
        )
    extra_joint = f"q{n_joints + 1}"
    if extra_joint in header:
        raise BadInput(
            f"{path}: line {line}: has column {extra_joint}, but the arm table has {n_joints} joints"
        )
    plan = {"q": required[:n_joints], "p": required[n_joints:]}
    groups = dict(_VECTORS)
    groups["dir"] = [f"dir{j}" for j in range(1, n_joints + 1)]
    groups["qdot"] = [f"qdot{j}" for j in range(1, n_joints + 1)]
    for key, names in groups.items():
        there = [name for name in names if name in header]
        if there and len(there) < len(names):
            lacking = [name for name in names if name not in header]
            raise BadInput(
                f"{path}: line {line}: has {', '.join(there[:4])} but lacks {', '.join(lacking[:4])}; "
                f"give all of {names[0]}..{names[-1]} or none"
            )
        if there:
            plan[key] = names
    for name in [*_SCALARS, "pan_rad", "tilt_rad", "replicate"]:
        if name in header:
            plan[name] = [name]
    return plan


def _number(name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"{name} is {text.strip() or 'empty'!s}, a number is needed") from None
    if not math.isfinite(value):
        raise ValueError(f"{name} is {text.strip()}, a finite number is needed")
    return value


def _parse_row(cells: list[str], header: list[str], plan: dict[str, list[str]]) -> dict:
    if len(cells) != len(header):
        raise ValueError(f"has {len(cells)} values, the header names {len(header)}")
    row = dict(zip(header, cells, strict=True))
    out: dict[str, object] = {
        key: np.array([_number(name, row[name]) for name in names]) for key, names in plan.items()
    }
    for key, what in (("quat", "qw,qx,qy,qz"), ("cam", "cqw,cqx,cqy,cqz")):
        if key in out:
            quat = out[key][-4:]
            norm = float(np.linalg.norm(quat))
            if abs(norm - 1.0) > _UNIT_TOL:
                raise ValueError(f"{what} has norm {norm:.6g}, 1 is needed")
            quat /= norm
    if "cov" in out:
        cov = _full_cov(out["cov"])
        try:
            np.linalg.cholesky(cov)
        except np.linalg.LinAlgError:
            raise ValueError("covariance c11..c66 is not positive definite") from None
        out["cov"] = cov
    for key in ("sp_m", "sr_rad"):
        if key in out and out[key][0] <= 0.0:
            raise ValueError(f"{key} is {out[key][0]:g}, more than 0 is needed")
    if "dir" in out and not set(np.unique(out["dir"])) <= {-1.0, 0.0, 1.0}:
        raise ValueError("dir1.. must be -1, 0 or +1")
    if "split" in row:
        split = row["split"].strip()
        if split not in ("fit", "held"):
            raise ValueError(f"split is {split or 'empty'!s}, fit or held is needed")
        out["split"] = split
    out["id"] = row.get("id", "").strip()
    return out


def _full_cov(upper: np.ndarray) -> np.ndarray:
    cov = np.zeros((6, 6))
    cov[np.triu_indices(6)] = upper
    return cov + np.triu(cov, 1).T


def _assemble(path: Path, rows: list[dict], plan: dict, header: list[str], skipped) -> Measurements:
    def stack(key: str) -> np.ndarray | None:
        return np.array([row[key] for row in rows]) if key in plan else None

    def scalar(key: str) -> np.ndarray | None:
        return stack(key)[:, 0] if key in plan else None

    ids = tuple(row["id"] or str(i) for i, row in enumerate(rows))
    twice = sorted({name for name in ids if ids.count(name) > 1}) if len(set(ids)) < len(ids) else []
    if twice:
        raise BadInput(f"{path}: id {twice[0]!r} stands {ids.count(twice[0])} times; ids name one pose each")
    cov = stack("cov")
    if cov is None and ("sp_m" in plan or "sr_rad" in plan):
        # A sigma that is stated alone leaves the other to the fitted scale; a loose value would
        # silently switch that half of the data off, so both or neither are asked for.
        if "quat" in plan and not ("sp_m" in plan and "sr_rad" in plan):
            raise BadInput(f"{path}: sp_m and sr_rad go together when orientations are given")
        if "sp_m" not in plan:
            raise BadInput(f"{path}: sr_rad without sp_m; state both")
        sp = scalar("sp_m")
        sr = scalar("sr_rad") if "sr_rad" in plan else np.ones_like(sp)
        cov = np.zeros((len(rows), 6, 6))
        cov[:, range(3), range(3)] = (sp**2)[:, None]
        cov[:, range(3, 6), range(3, 6)] = (sr**2)[:, None]
    cam = stack("cam")
    q = stack("q")
    replicate = scalar("replicate")
    known = {name for names in plan.values() for name in names} | {"id", "split"}
    return Measurements(
        source=str(path),
        ids=ids,
        q=q,
        p_m=stack("p"),
        quat_wxyz=stack("quat"),
        cov=cov,
        t_s=scalar("t_s") if "t_s" in plan else np.arange(len(rows), dtype=float),
        order_is_time="t_s" not in plan,
        direction=stack("dir"),
        qdot=stack("qdot"),
        temp_c=scalar("temp_c"),
        payload_kg=scalar("payload_kg"),
        g_m_s2=stack("g_m_s2"),
        range_m=scalar("range_m"),
        incid_rad=scalar("incid_rad"),
        u_px=scalar("u_px"),
        v_px=scalar("v_px"),
        cam_p_m=None if cam is None else cam[:, :3],
        cam_quat_wxyz=None if cam is None else cam[:, 3:],
        tag=scalar("tag"),
        pan_rad=scalar("pan_rad"),
        tilt_rad=scalar("tilt_rad"),
        split=np.array([row["split"] for row in rows]) if "split" in header else None,
        replicate=replicate_groups(q) if replicate is None else replicate.astype(int),
        skipped=skipped,
        unknown_columns=tuple(name for name in header if name not in known),
    )


def replicate_groups(q: np.ndarray, tol: float = 2e-3) -> np.ndarray:
    """Group number per pose: poses whose readings all agree within `tol` [rad or m] are replicates."""
    group = np.full(len(q), -1)
    for i in range(len(q)):
        if group[i] < 0:
            near = np.flatnonzero((group < 0) & (np.abs(q - q[i]).max(axis=1) <= tol))
            group[near] = i
    return group
