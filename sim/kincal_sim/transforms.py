"""Rotations and rigid transforms. Quaternions are unit, (w, x, y, z), w >= 0; angles in rad, lengths in m.

The simulator has its own, separate from the ground's, so that an error in one of them shows in the tests.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

_UNMOVED = np.eye(4)
AXES = {"x": 0, "y": 1, "z": 2}


def rot(axis: str, angle_rad: float) -> np.ndarray:
    """4x4 rotation about a coordinate axis ("x", "y" or "z")."""
    T = np.eye(4)
    i = (AXES[axis] + 1) % 3
    j = (AXES[axis] + 2) % 3
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    T[i, i], T[i, j], T[j, i], T[j, j] = c, -s, s, c
    return T


def trans(x_m: float, y_m: float, z_m: float) -> np.ndarray:
    """4x4 translation."""
    T = np.eye(4)
    T[:3, 3] = x_m, y_m, z_m
    return T


def frame_error(
    tx: float = 0.0,
    ty: float = 0.0,
    tz: float = 0.0,
    rx: float = 0.0,
    ry: float = 0.0,
    rz: float = 0.0,
) -> np.ndarray:
    """4x4 finite error of a frame [m, rad] in the project's order Tx Rx Ty Ry Rz Tz."""
    return trans(tx, 0, 0) @ rot("x", rx) @ trans(0, ty, 0) @ rot("y", ry) @ rot("z", rz) @ trans(0, 0, tz)


def quaternion(R: np.ndarray) -> np.ndarray:
    """(4,) unit quaternion of a rotation matrix (3x3, or the corner of a 4x4 transform).

    The largest component is found first (Shepperd's method), so half turns are exact too.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = np.asarray(R)[:3, :3].tolist()
    four = (1 + (xx + yy + zz), 1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz)
    k = four.index(max(four))
    largest = 0.5 * math.sqrt(four[k])
    h = 0.25 / largest
    wx, wy, wz = h * (zy - yz), h * (xz - zx), h * (yx - xy)
    if k == 0:
        w, x, y, z = largest, wx, wy, wz
    else:
        vxy, vxz, vyz = h * (yx + xy), h * (zx + xz), h * (zy + yz)
        w, x, y, z = ((wx, largest, vxy, vxz), (wy, vxy, largest, vyz), (wz, vxz, vyz, largest))[k - 1]
    q = np.array((-w, -x, -y, -z) if w < 0 else (w, x, y, z))
    return q / math.sqrt(q @ q)


def rotation_matrix(q_wxyz: ArrayLike) -> np.ndarray:
    """3x3 rotation matrix of a unit quaternion."""
    w, x, y, z = np.asarray(q_wxyz)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def transform(p_m: ArrayLike, R: np.ndarray) -> np.ndarray:
    """4x4 transform of a position and a 3x3 rotation."""
    T = _UNMOVED.copy()
    T[:3, :3] = R
    T[:3, 3] = p_m
    return T


def rotation_angle(Ra: np.ndarray, Rb: np.ndarray) -> float:
    """Angle between two attitudes [rad], in [0, pi]."""
    q = quaternion(np.asarray(Ra)[:3, :3].T @ np.asarray(Rb)[:3, :3])
    return float(2 * np.arctan2(np.linalg.norm(q[1:]), abs(q[0])))
