"""Targets on the tool whose positions were measured: three of them make a pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kincal.rotations import Pose, rigid_fit
from kincal_shared.errors import CannotAnswer
from kincal_shared.schema.datamap import TargetsEntry

from ...numerics.types import Array, array
from .columns import Columns

_FLAT_M = 1e-3  # extent across their line below which three targets fix no orientation


@dataclass(frozen=True)
class TargetPoses:
    """p_m (N, 3); quat_wxyz (N, 4) and jacobian (N, 3 k, 6), the targets' motion by that of the tool frame
    (position, rotation vector), None with fewer than three targets; notes: what was assumed."""

    p_m: Array
    quat_wxyz: Array | None
    jacobian: Array | None
    notes: tuple[str, ...] = ()


def target_poses(columns: Columns, entry: TargetsEntry) -> TargetPoses:
    """Pose of the tool frame in every row; rows in which a target is not where the rigid tool has it become
    bad."""
    names = [f"target {k}" for k in range(1, len(entry.columns) + 1)]
    seen = np.stack([columns.values[name] for name in names], axis=1)
    if len(names) < 3:
        return _position_only(columns, entry, seen)
    good = columns.good()
    notes: tuple[str, ...] = ()
    if entry.tool_m is not None:
        tool = array(entry.tool_m)
    else:
        tool = _triangle(seen[good] if good.any() else np.zeros((1, 3, 3)))
        notes = ("tool frame: in the middle of the three targets, x from the first to the second",)
    _check_triangle(columns, tool)
    poses = [rigid_fit(tool, row) if ok else Pose.identity() for row, ok in zip(seen, good, strict=True)]
    fitted = np.array([pose.apply(tool) for pose in poses])
    off_m = np.linalg.norm(fitted - seen, axis=2)
    _refuse(columns, np.where(good[:, None], off_m, 0.0), entry.tolerance_m)
    arms = fitted - np.array([pose.p_m for pose in poses])[:, None]
    return TargetPoses(
        np.array([pose.p_m for pose in poses]),
        np.array([pose.quat_wxyz for pose in poses]),
        _jacobian(arms),
        notes,
    )


def _check_triangle(columns: Columns, tool_m: Array) -> None:
    """CannotAnswer if the turn about the longest side is as good as unknown."""
    _, across, _ = np.linalg.svd(tool_m - tool_m.mean(axis=0), compute_uv=False)
    if columns.good().any() and across < _FLAT_M:
        raise CannotAnswer(
            "the three targets lie on one line: they do not fix the orientation",
            columns.table.source,
            "use one or two of them, or targets that make a triangle",
        )


def _refuse(columns: Columns, off_m: Array, tolerance_m: float) -> None:
    worst = off_m.max(axis=1)
    wrong = worst > tolerance_m
    columns.refuse(wrong, (
        f"target {int(off_m[k].argmax()) + 1} is {worst[k] * 1e3:.3g} mm from where the tool has it, "
        f"up to {tolerance_m * 1e3:g} mm are allowed" for k in np.flatnonzero(wrong)
    ))  # fmt: skip


def _position_only(columns: Columns, entry: TargetsEntry, seen: Array) -> TargetPoses:
    """One target is a position; two do not fix the turn about the line between them: their middle is used."""
    if seen.shape[1] == 1:
        return TargetPoses(seen[:, 0], None, None)
    gap_m = np.linalg.norm(seen[:, 1] - seen[:, 0], axis=1)
    good = columns.good()
    if entry.tool_m is not None:
        want_m = float(np.linalg.norm(array(entry.tool_m[1]) - array(entry.tool_m[0])))
    else:
        want_m = float(np.median(gap_m[good])) if good.any() else 0.0
    off_m = np.zeros_like(seen[:, :, 0])
    off_m[:, 1] = np.where(good, np.abs(gap_m - want_m), 0.0)
    _refuse(columns, off_m, entry.tolerance_m)
    note = "two targets do not fix an orientation: the point in the middle between them is used"
    return TargetPoses(seen.mean(axis=1), None, None, (note,))


def _triangle(seen: Array) -> Array:
    """(3, 3) targets in a tool frame of their own, from the median distances of (N, 3, 3) positions."""
    sides = [np.median(np.linalg.norm(seen[:, b] - seen[:, a], axis=1)) for a, b in ((0, 1), (0, 2), (1, 2))]
    c, b, a = (float(side) for side in sides)
    x = (b**2 + c**2 - a**2) / (2.0 * c) if c > 0.0 else 0.0
    points = np.array([[0.0, 0.0, 0.0], [c, 0.0, 0.0], [x, np.sqrt(max(b**2 - x**2, 0.0)), 0.0]])
    return array(points - points.mean(axis=0))


def _jacobian(arms_m: Array) -> Array:
    """(N, 3 k, 6) of (N, k, 3) targets seen from the tool frame's origin, in the base frame."""
    n, k, _ = arms_m.shape
    out = np.zeros((n, k, 3, 6))
    out[..., :3] = np.eye(3)
    x, y, z = np.moveaxis(arms_m, -1, 0)
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(n, k, 3, 3)
    out[..., 3:] = -cross
    return out.reshape(n, 3 * k, 6)
