"""A table of any format as measurements: every row checked, a malformed one refused or skipped."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kincal_shared.errors import BadInput
from kincal_shared.letters import shown
from kincal_shared.schema.datamap import RECORDED, DataMap

from ...numerics.types import Array, Groups, Mask
from ..measurements import Measurements, replicate_groups
from ..sums import Sums, in_words, matrix, of_joints
from .columns import Columns, quaternions, unit
from .ranges import RANGES, unusable_variance
from .table import Joints, Table
from .targets import TargetPoses, target_poses

_SHOWN = 10  # malformed rows that an error lists
_ONE_POSE = 0.05  # [rad or m] between readings of one commanded pose: no controller misses it by that
_SINGULAR = 1e-6  # determinant, of whole numbers
_NO_TARGETS = TargetPoses(np.zeros((0, 3)), None, None)


def measurements(table: Table, mapping: DataMap, joints: Joints, *, skip_bad: bool = False) -> Measurements:
    """The rows of a table. BadInput naming file, row and reason for columns that are missing, a malformed row
    (with skip_bad they are left out and counted), a noise that is stated in part."""
    columns = Columns(table, mapping, joints)
    plan = columns.plan()
    columns.read(plan)
    values = columns.values
    sums = tuple(mapping.readings.items())
    _check_sums(sums, joints, table.source)
    for name in ("q", "qdot"):
        if name in values:
            values[name] = of_joints(values[name], sums)
    targets = target_poses(columns, mapping.targets) if mapping.targets else _NO_TARGETS
    quat = quaternions(columns, mapping.rotation) if "rotation" in values else targets.quat_wxyz
    if "cam" in values:
        values["cam"][:, 3:] = unit(columns, values["cam"][:, 3:], "cqw,cqx,cqy,cqz")
    _check_signs(columns)
    _check_sizes(columns)
    cov = _covariance(columns, quat is not None, targets)
    _check_texts(columns)
    problems = list(columns.problems())
    if problems and not skip_bad:
        raise BadInput(_problem_text(table.source, problems))
    good = columns.good()
    if not good.any():
        raise BadInput(f"{table.source}: has no usable row")
    q, t_s = values["q"][good], _scalar(columns, "t_s", good)
    payload = _scalar(columns, "payload_kg", good)
    replicate, cam = _scalar(columns, "replicate", good), _rows(values.get("cam"), good)
    return Measurements(
        source=table.source,
        ids=_ids(columns, good),
        q=q,
        p_m=(targets.p_m if mapping.targets else values["p"])[good],
        quat_wxyz=_rows(quat, good),
        cov=_rows(cov, good),
        t_s=t_s if t_s is not None else np.arange(len(q), dtype=float),
        order_is_time=t_s is None,
        direction=_rows(values.get("dir"), good),
        direction_source="measured" if "dir" in values else "none",
        qdot=_rows(values.get("qdot"), good),
        g_m_s2=_rows(values.get("g"), good),
        cam_p_m=None if cam is None else cam[:, :3],
        cam_quat_wxyz=None if cam is None else cam[:, 3:],
        split=np.array(columns.texts["split"])[good] if "split" in columns.texts else None,
        replicate=_stated_groups(replicate) if replicate is not None else replicate_groups(q, payload),
        replicate_stated=replicate is not None,
        skipped=tuple(problems),
        duplicates=0,  # counted when all files are joined
        rounded=0,
        unknown_columns=tuple(shown(name) for name in table.columns if name not in columns.used),
        notes=(*table.notes, *targets.notes),
        whole=None,
        sums=sums,
        orientation=_form(mapping) if "rotation" in values else "",
        euler_rad=_rows(values["rotation"], good) if _form(mapping).startswith("euler") else None,
        **{name: _scalar(columns, name, good) for name in RECORDED if name != "t_s"},
    )


def _check_sums(sums: Sums, joints: Joints, source: str) -> None:
    """BadInput for sums that are no joint readings."""
    for name, text in sums:
        one, _, other = text.split()
        used = {int(q_j[1:]) - 1 for q_j in (name, one, other)}
        said = f'[readings] {name} = "{text}"'
        if max(used) >= joints.n:
            raise BadInput(f"{said} names a joint that is not there: there are {joints.n}", source)
        if len({joints.prismatic[j] for j in used}) > 1:
            raise BadInput(f"{said} adds a length to an angle: one of the joints slides", source)
    if abs(np.linalg.det(matrix(sums, joints.n))) < _SINGULAR:
        raise BadInput(
            f"{in_words(sums)}: some joints then always move together",
            source,
            "write a sum for the joint whose reading contains another one, and none for that one",
        )


def _form(mapping: DataMap) -> str:
    """How the file writes orientations, as --rotation says it."""
    entry = mapping.rotation
    return "wxyz" if entry is None else f"{entry.form}-{entry.axes}" if entry.axes else entry.form


def _problem_text(source: str, problems: Sequence[str]) -> str:
    more = f"\n  ... and {len(problems) - _SHOWN} more" if len(problems) > _SHOWN else ""
    shown = "\n  ".join(problems[:_SHOWN])
    return f"{source}: {len(problems)} malformed row(s); correct them or use --skip-bad\n  {shown}{more}"


def _rows(values: Array | None, good: Mask) -> Array | None:
    return None if values is None else values[good]


def _scalar(columns: Columns, key: str, good: Mask) -> Array | None:
    """(n,) of a quantity of one column."""
    return columns.values[key][good, 0] if key in columns.values else None


# --------------------------------------------------------------------------- checks of rows


def _check_sizes(columns: Columns) -> None:
    plan = columns.plan()
    for key, values in columns.values.items():
        known = RANGES.get("p" if key.startswith("target ") else key)
        if known is None:
            continue
        outside = known.wrong(values)
        rows = np.asarray(outside.any(axis=1), dtype=np.bool_)
        columns.refuse(rows, (
            known.why(plan[key][j], values[k, j])
            for k in np.flatnonzero(rows) for j in [int(outside[k].argmax())]
        ))  # fmt: skip


def _check_signs(columns: Columns) -> None:
    for key in columns.values.keys() & {"sp_m", "sr_rad"}:
        sigma = columns.values[key][:, 0]
        wrong = sigma <= 0.0
        columns.refuse(wrong, (f"{key} is {x:g}, more than 0 is needed" for x in sigma[wrong]))
    if "replicate" in columns.values:
        group = columns.values["replicate"][:, 0]
        part = np.asarray(np.isfinite(group) & (group != np.round(group)), dtype=np.bool_)
        columns.refuse(part, (f"replicate is {x:g}, a whole number is needed" for x in group[part]))
        _check_groups(columns, group)
    if "dir" in columns.values:
        allowed = np.isin(columns.values["dir"], (-1.0, 0.0, 1.0))
        other = np.asarray(~allowed.all(axis=1), dtype=np.bool_)
        columns.refuse(other, ("dir1.. must be -1, 0 or +1" for _ in range(int(other.sum()))))


def _check_groups(columns: Columns, group: Array) -> None:
    """Poses of one group are measurements of one commanded pose: else their differences are no noise."""
    q = columns.values["q"]
    usable = np.isfinite(group) & np.isfinite(q).all(axis=1)
    first = {g: k for k, g in reversed([*enumerate(group)]) if usable[k]}
    off = np.zeros(q.shape)
    for k in np.flatnonzero(usable):
        off[k] = np.abs(q[k] - q[first[group[k]]])
    wrong = np.asarray((off > _ONE_POSE).any(axis=1), dtype=np.bool_)
    names = columns.plan()["q"]
    columns.refuse(wrong, (
        f"replicate {group[k]:g} has poses of which {names[j]} differs by {off[k, j]:.3g}: a group holds "
        "measurements of one commanded pose"
        for k in np.flatnonzero(wrong) for j in [int(off[k].argmax())]
    ))  # fmt: skip


def _stated_groups(group: Array) -> Groups:
    """(n,) numbers of the groups; a pose without one (nan) was not repeated, and is a group of its own."""
    alone = np.isnan(group)
    free = int(np.max(group, initial=0.0, where=~alone)) + 1
    return np.where(alone, free + np.cumsum(alone), group).astype(int)


def _check_texts(columns: Columns) -> None:
    split = np.array(columns.texts.get("split", ["fit"] * columns.n), dtype=str)
    wrong = ~np.isin(split, ("fit", "held"))
    columns.refuse(wrong, (f"split is {shown(x) or 'empty'}, fit or held is needed" for x in split[wrong]))


def _ids(columns: Columns, good: Mask) -> tuple[str, ...]:
    """Names of the poses, or their numbers from 1."""
    given = columns.texts.get("id", [""] * columns.n)
    kept = [given[k] for k in np.flatnonzero(good)]
    return tuple(name or str(k) for k, name in enumerate(kept, 1))


# --------------------------------------------------------------------------- noise


def _covariance(columns: Columns, with_rotation: bool, targets: TargetPoses) -> Array | None:
    """(N, 6, 6) stated covariance. A sigma that is stated alone would leave the other to a loose value, which
    silently switches that half of the data off: both or neither are asked for."""
    values, source = columns.values, columns.table.source
    if "cov" in values:
        return _of_triangle(columns, values["cov"])
    if "sp_m" not in values and "sr_rad" not in values:
        return None
    if "sp_m" not in values:
        raise BadInput(f"{source}: sr_rad without sp_m; state both")
    sp = values["sp_m"][:, 0]
    if targets.jacobian is not None:
        return _of_targets(columns, targets.jacobian, sp)
    if with_rotation and "sr_rad" not in values:
        raise BadInput(f"{source}: sp_m and sr_rad go together when orientations are given")
    sr = values["sr_rad"][:, 0] if "sr_rad" in values else np.ones_like(sp)
    sigma = np.repeat(np.where(columns.good()[:, None], np.column_stack([sp, sr]), 1.0), 3, axis=1)
    cov: Array = sigma[:, :, None] ** 2 * np.eye(6)
    return cov


def _of_triangle(columns: Columns, upper: Array) -> Array:
    """(N, 6, 6) of upper triangles (N, 21), row by row; rows that are not positive definite become bad."""
    cov = np.zeros((len(upper), 6, 6))
    cov[:, *np.triu_indices(6)] = upper
    cov += np.triu(cov, 1).transpose(0, 2, 1)
    finite = np.asarray(np.isfinite(cov).all(axis=(1, 2)), dtype=np.bool_)
    lowest = np.linalg.eigvalsh(np.where(finite[:, None, None], cov, np.eye(6)))[:, 0]
    wrong = lowest <= 0.0
    columns.refuse(wrong, ("covariance c11..c66 is not positive definite" for _ in range(int(wrong.sum()))))
    beyond = unusable_variance(cov) & finite
    reason = "covariance c11..c66 has a variance of no instrument"
    columns.refuse(beyond, (reason for _ in range(int(beyond.sum()))))
    return cov


def _of_targets(columns: Columns, jacobian: Array, sp_m: Array) -> Array:
    """(N, 6, 6) covariance of the tool pose that follows from the noise of one target (least squares)."""
    information = jacobian.transpose(0, 2, 1) @ jacobian
    safe = np.where(columns.good()[:, None, None], information, np.eye(6))
    cov: Array = np.linalg.inv(safe) * sp_m[:, None, None] ** 2
    return cov
