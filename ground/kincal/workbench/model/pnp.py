"""What faults of camera and target do to a pose computed from many points (METHOD.md 13.1).

A pose from a camera is the one that fits the image of all seen points best (PnP: perspective n points).
A fault moves each image point by d; the pose then moves by the twist xi of least |J xi - d|^2, J the
derivative of the image by the pose. One column for each fault and sight, a twist of six components in the
measured frame, per unit of the fault.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kincal.rotations import Pose, matrix_of_wxyz
from kincal_shared.schema.arm import ArmTable
from kincal_shared.schema.names import FAULTS

from ..data.measurements import Measurements
from ..numerics.types import Array, Indices, Mask, array
from .sight import Sight, camera_poses, sees_points, sights

EDGE = 0.02  # of half the image: over that, points at the border lose their weight gradually
LEAST_SEEN = 4.0  # points; where fewer are in the image, all those in front of the camera count
_AT_ONCE = 400  # poses: bounds memory
CORNERS = 4  # of a tag
_REGULAR = 1e-5  # least over largest pivot of a Cholesky factor
Shift = tuple[Any, Any]
# Brown's lens model (Photogrammetric Engineering 37(8), 1971) with the coefficients' usual names, focal
# lengths by their share, and the principal point in focal lengths. Only sums and products: the export calls
# them with names in place of arrays, and so has the same formulas as text.
OF_CAMERA: dict[str, Callable[[Any, Any], Shift]] = {
    "radial_1": lambda u, v: (u * (u * u + v * v), v * (u * u + v * v)),
    "radial_2": lambda u, v: (
        u * ((u * u + v * v) * (u * u + v * v)),
        v * ((u * u + v * v) * (u * u + v * v)),
    ),
    "decentring_1": lambda u, v: (2.0 * u * v, u * u + 3.0 * v * v),
    "decentring_2": lambda u, v: (3.0 * u * u + v * v, 2.0 * u * v),
    "focal_x": lambda u, _: (u, 0.0),
    "focal_y": lambda _, v: (0.0, v),
    "centre_x": lambda *_: (1.0, 0.0),
    "centre_y": lambda *_: (0.0, 1.0),
}


def column_number(sight: int, fault: str) -> int:
    """Number of a column, from 1, by sight (from 0) and fault."""
    return 1 + sight * len(FAULTS) + FAULTS.index(fault)


def sight_of_column(number: int) -> int:
    """The sight that a column belongs to."""
    return (number - 1) // len(FAULTS)


def fault_of_column(number: int) -> str:
    """The fault that a column stands for."""
    return FAULTS[(number - 1) % len(FAULTS)]


@dataclass(frozen=True)
class PnpColumns:
    """Columns of N poses.

    sights: as `sight.sights`; camera: (N,) poses of a camera in the world, None for one on the flange
    (then the measured pose is the camera's in the target's frame); measured: (N, 3, 3) its orientation;
    second: (N,) poses that were computed from the second target, None if there is one only.
    """

    sights: tuple[Sight, ...]
    camera: Pose | None
    measured: Array
    second: Mask | None = None

    @classmethod
    def of(cls, arm: ArmTable, data: Measurements) -> PnpColumns | None:
        """Columns for these poses; None where they do not come from a target of many points."""
        if not sees_points(arm, data):
            return None
        assert data.quat_wxyz is not None
        second = None if data.tag is None or arm.target_second_m is None else data.tag == 1.0
        return cls(sights(arm, data), camera_poses(arm, data), matrix_of_wxyz(data.quat_wxyz), second)

    def __call__(self, numbers: Sequence[int], expected: Pose) -> Array:
        """(N, 6, k) twists of the columns `numbers` [m, rad per unit], the view taken at the expected poses
        (N): the measured ones would carry the noise of the residual into the columns. They act at the
        measured frame along the axes of the expected one."""
        out = np.zeros((len(self.measured), 6, len(numbers)))
        which = np.array([divmod(number - 1, len(FAULTS)) for number in numbers]).reshape(-1, 2)
        for k in np.unique(which[:, 0]):
            mine = np.flatnonzero(which[:, 0] == k)
            sight, faults = self.sights[k], [FAULTS[f] for f in which[mine, 1]]
            found = self._of_sight(sight, expected, faults)
            if self.second is not None and sight.second_m is not None:
                of_second = self._of_sight(replace(sight, points_m=sight.second_m), expected, faults)
                found = np.where(self.second[:, None, None], of_second, found)
            out[:, :, mine] = found
        turn = self.measured.transpose(0, 2, 1) @ expected.R
        return np.concatenate([turn @ out[:, :3], turn @ out[:, 3:]], axis=1)

    def _of_sight(self, sight: Sight, expected: Pose, faults: Sequence[str]) -> Array:
        out = np.empty((len(expected.p_m), 6, len(faults)))
        for start in range(0, len(out), _AT_ONCE):
            some = slice(start, start + _AT_ONCE)
            view = self._view(sight, Pose(expected.p_m[some], expected.R[some]), some)
            out[some] = view.twists(faults)
        return out

    def _view(self, sight: Sight, expected: Pose, some: slice) -> _View:
        """Points in the camera frame, and how they move there with the measured pose."""
        points = sight.points_m.T
        if self.camera is None:
            turn = expected.R.transpose(0, 2, 1)
            seen = turn @ points - turn @ expected.p_m[:, :, None]
            return _View(sight, seen, -np.eye(3)[None, :, :, None], -_about_axes(seen), turn)
        camera = Pose(self.camera.p_m[some], self.camera.R[some])
        target = camera.inverse @ expected
        turns = target.R @ _about_axes(points).transpose(1, 0, 2).reshape(3, -1)
        turns = turns.reshape(-1, 3, *points.shape).transpose(0, 2, 1, 3)
        shifts = target.R.transpose(0, 2, 1)[..., None]
        seen = target.p_m[:, :, None] + target.R @ points
        return _View(sight, seen, shifts, turns, target.R)


@dataclass(frozen=True)
class _View:
    """n poses of m points: seen (n, 3, m) in the camera frame [m]; how they move there when the measured pose
    does: shifts (n, 3, 3, 1) along each axis, turns (n, 3, 3, m) about each; turn (n, 3, 3) from the target's
    to the camera frame.

    Points are last: sums over them run along memory."""

    sight: Sight
    seen: Array
    shifts: Array
    turns: Array
    turn: Array

    def twists(self, faults: Sequence[str]) -> Array:
        """(n, 6, k) least-squares twists of the faults."""
        x, y, z = self.seen.transpose(1, 0, 2)
        depth = np.where(z > 0.0, z, 1.0)
        u, v = x / depth, y / depth
        (n, m), k = u.shape, len(faults)
        weight = np.sqrt(self._weight(u, v))[:, None] * self.sight.focal[:, None]
        a, d = np.empty((n, 6, 2, m)), np.empty((n, k, 2, m))
        a[:, :3] = _image(u, v, depth, self.shifts)
        a[:, 3:] = _image(u, v, depth, self.turns)
        for i, fault in enumerate(faults):
            d[:, i, 0], d[:, i, 1] = self._shift(fault, u, v, depth)
        a *= weight[:, None]
        d *= weight[:, None]
        a, d = a.reshape(n, 6, -1), d.reshape(n, k, -1)
        return _least_squares(a @ a.transpose(0, 2, 1), a @ d.transpose(0, 2, 1))

    def _weight(self, u: Array, v: Array) -> Array:
        """(n, m) 1 for points in the image, 0 outside, falling over a narrow edge."""
        low, high = self.sight.low, self.sight.high
        edge = EDGE * (high - low) / 2.0
        inside = [
            np.clip(np.minimum(x - low[k], high[k] - x) / edge[k], 0.0, 1.0) for k, x in enumerate((u, v))
        ]
        front = self.seen[:, 2] > 0.0
        weight = np.where(front, inside[0] * inside[1], 0.0)
        few = weight.sum(axis=1) < LEAST_SEEN
        return np.where(few[:, None], front, weight)

    def _shift(self, fault: str, u: Array, v: Array, depth: Array) -> Shift:
        """(n, m) what a unit of a fault does to the image points, normalised, along both axes."""
        if fault in OF_CAMERA:
            return OF_CAMERA[fault](u, v)
        if fault == "target_edges":
            outward = _edges_outward(u, v, self.sight)
            return outward[..., 0], outward[..., 1]
        moved = self.turn @ _moved(self.sight.points_m.tobytes(), fault).T
        image = _image(u, v, depth, moved[:, None])
        return image[:, 0, 0], image[:, 0, 1]


def _image(u: Array, v: Array, depth: Array, moves: Array) -> Array:
    """(n, k, 2, m) how normalised image points move with points that move by `moves` (n, k, 3, m or 1) in the
    camera frame."""
    image = np.stack([u, v], axis=1)[:, None] * moves[:, :, 2:]
    np.subtract(moves[:, :, :2], image, out=image)
    image /= depth[:, None, None]
    return array(image)


def _about_axes(x: Array) -> Array:
    """(..., 3, 3, m) how points x (..., 3, m) move by a turn about each axis: axis cross x."""
    out = np.zeros((*x.shape[:-2], 3, *x.shape[-2:]))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[..., i, k, :], out[..., i, j, :] = x[..., j, :], -x[..., k, :]
    return out


def _least_squares(gram: Array, right: Array) -> Array:
    """(n, 6, k) least solutions of gram (n, 6, 6) x = right (n, 6, k). Where all matrices are regular, which
    Cholesky factors tell soonest, they need no pseudo-inverse."""
    try:
        pivot = np.linalg.cholesky(gram).diagonal(axis1=1, axis2=2)
    except np.linalg.LinAlgError:
        regular = False
    else:
        regular = bool((pivot.min(axis=1) > _REGULAR * pivot.max(axis=1)).all())
    return array(np.linalg.solve(gram, right) if regular else np.linalg.pinv(gram, hermitian=True) @ right)


def moved_points(points_m: Array, fault: str) -> Array:
    """(m, 3) how far points lie from where the table has them. target_size: all farther from the middle, by a
    share of their distance. bow: how far they leave the target's plane when it is bent along its x or y by
    1 m from the middle to the farthest point; of four corners nothing: lifted alike, they are a tag that is
    mounted elsewhere."""
    centred = points_m - points_m.mean(axis=0)
    if fault == "target_size":
        return array(centred)
    if len(points_m) <= CORNERS:
        return np.zeros(points_m.shape)
    normal = np.linalg.svd(centred)[2][2]
    axis = np.eye(3)[0 if fault == "bow_x" else 1]
    along = centred @ (axis - (axis @ normal) * normal)
    largest = float(np.abs(along).max()) or 1.0
    return array((along / largest)[:, None] ** 2 * normal * (1.0 if normal.sum() > 0.0 else -1.0))


@functools.lru_cache(maxsize=256)
def _moved(points_m: bytes, fault: str) -> Array:
    """`moved_points` of (m, 3) doubles: a fit asks for those of one target hundreds of times."""
    moved = moved_points(np.frombuffer(points_m).reshape(-1, 3), fault)
    moved.setflags(write=False)
    return moved


def _edges_outward(u: Array, v: Array, sight: Sight) -> Array:
    """(n, 4, 2) how the corners of a tag move when all its edges in the image move outward by one focal
    length (a bright tag blooms). Nothing for other targets: only the edges of a tag are the borders of
    something bright."""
    if u.shape[1] != CORNERS:
        return np.zeros((*u.shape, 2))
    around = in_order(sight.points_m)
    px = np.stack([u, v], axis=2)[:, around] * sight.focal
    edge = np.roll(px, -1, axis=1) - px  # from corner k to the next one
    normal = np.stack([edge[..., 1], -edge[..., 0]], axis=2)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    outward = np.sum(normal * (px - px.mean(axis=1, keepdims=True)), axis=2, keepdims=True)
    normal *= np.sign(outward)
    meeting = np.stack([np.roll(normal, 1, axis=1), normal], axis=2)  # the two edges of each corner
    moved = np.empty_like(px)
    moved[:, around] = np.linalg.solve(meeting, np.ones((*meeting.shape[:3], 1)))[..., 0]
    return array(moved * sight.focal.mean() / sight.focal)


def in_order(points_m: Array) -> Indices:
    """(m,) points of a plane in the order in which one walks around them."""
    centred = points_m - points_m.mean(axis=0)
    x, y = np.linalg.svd(centred)[2][:2] @ centred.T
    return np.argsort(np.arctan2(y, x))
