"""Rotations and poses of the ground, by scipy. Quaternions are (w, x, y, z), as in the tables.

Every function takes one rotation or a stack of them along the first axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

Floats: TypeAlias = NDArray[np.float64]


def _rotation() -> type[Rotation]:
    """scipy's class, loaded when first asked for: that takes as long as all else that a command loads."""
    from scipy.spatial.transform import Rotation

    return Rotation


def rotation_of_wxyz(quat_wxyz: ArrayLike) -> Rotation:
    """scipy Rotation of (..., 4) quaternions, which need not be of unit length. ValueError for a zero one."""
    return _rotation().from_quat(np.asarray(quat_wxyz, dtype=float), scalar_first=True)


def matrix_of_wxyz(quat_wxyz: ArrayLike) -> Floats:
    """(..., 3, 3) rotation matrices of (..., 4) quaternions."""
    return rotation_of_wxyz(quat_wxyz).as_matrix()


def wxyz_of_matrix(matrix: ArrayLike) -> Floats:
    """(..., 4) unit quaternions with w >= 0 of (..., 3, 3) rotation matrices; with w = 0 the first of x, y, z
    that is not zero is positive."""
    return _rotation().from_matrix(np.asarray(matrix, dtype=float)).as_quat(canonical=True, scalar_first=True)


def rotvec_of_matrix(matrix: ArrayLike) -> Floats:
    """(..., 3) rotation vectors [rad], length 0..pi."""
    return _rotation().from_matrix(np.asarray(matrix, dtype=float)).as_rotvec()


def angle_of_matrix(matrix: ArrayLike) -> Floats:
    """Angle of (..., 3, 3) rotation matrices [rad], 0..pi, accurate near both ends."""
    return np.asarray(_rotation().from_matrix(np.asarray(matrix, dtype=float)).magnitude())


def nearest_rotation(matrix: ArrayLike) -> Floats:
    """The rotation matrix nearest to a 3x3 matrix in the Frobenius norm: sum of the inner products of its
    columns with the axes, which is Wahba's problem."""
    found, _ = _rotation().align_vectors(np.asarray(matrix, dtype=float).T, np.eye(3))
    return found.as_matrix()


@dataclass(frozen=True)
class Pose:
    """Where frames stand: origins p_m (..., 3) [m] and rotation matrices R (..., 3, 3)."""

    p_m: Floats
    R: Floats

    @classmethod
    def identity(cls) -> Pose:
        """The frame itself."""
        return cls(np.zeros(3), np.eye(3))

    @classmethod
    def of_wxyz(cls, xyz_m: ArrayLike, quat_wxyz: ArrayLike) -> Pose:
        """Pose of an origin and a quaternion, as tables hold it."""
        return cls(np.array(xyz_m, dtype=float), matrix_of_wxyz(quat_wxyz))

    @classmethod
    def of_matrix(cls, matrix: ArrayLike) -> Pose:
        """Pose of a (..., 4, 4) homogeneous matrix."""
        m = np.array(matrix, dtype=float)
        return cls(m[..., :3, 3], m[..., :3, :3])

    @property
    def matrix(self) -> Floats:
        """(..., 4, 4) homogeneous matrix."""
        out = np.zeros((*self.p_m.shape[:-1], 4, 4))
        out[..., :3, :3], out[..., :3, 3], out[..., 3, 3] = self.R, self.p_m, 1.0
        return out

    @property
    def quat_wxyz(self) -> Floats:
        """(..., 4) unit quaternions, w >= 0."""
        return wxyz_of_matrix(self.R)

    @property
    def inverse(self) -> Pose:
        """The pose that undoes this one."""
        R = np.swapaxes(self.R, -1, -2)
        return Pose(-(R @ self.p_m[..., None])[..., 0], R)

    def __matmul__(self, other: Pose) -> Pose:
        """This pose, then the other in its frame."""
        return Pose(self.apply(other.p_m), self.R @ other.R)

    def apply(self, points_m: ArrayLike) -> Floats:
        """Points (..., 3) of this frame, in the frame that the pose is given in [m]."""
        points = np.asarray(points_m, dtype=float)
        moved: Floats = self.p_m + (self.R @ points[..., None])[..., 0]
        return moved

    def __getitem__(self, index: int | slice | Sequence[int] | NDArray[np.intp]) -> Pose:
        """Some of a stack of poses."""
        return Pose(self.p_m[index], self.R[index])


def pose_difference(measured: Pose, model: Pose) -> Floats:
    """(..., 6) position difference [m], then rotation vector of R_measured R_model^T [rad], base frame."""
    turn = measured.R @ np.swapaxes(model.R, -1, -2)
    return np.concatenate([measured.p_m - model.p_m, rotvec_of_matrix(turn)], axis=-1)


def rigid_fit(points_m: ArrayLike, seen_m: ArrayLike) -> Pose:
    """The pose that carries (N, 3) points nearest to where they were seen (Kabsch).

    ValueError for fewer than three points; points on one line leave the turn about it open.
    """
    points, seen = np.asarray(points_m, dtype=float), np.asarray(seen_m, dtype=float)
    if len(points) < 3:
        raise ValueError(f"{len(points)} points do not fix a rigid motion; three or more are needed")
    centre, centre_seen = points.mean(axis=0), seen.mean(axis=0)
    turn, _ = _rotation().align_vectors(seen - centre_seen, points - centre)
    return Pose(centre_seen - turn.apply(centre), turn.as_matrix())
