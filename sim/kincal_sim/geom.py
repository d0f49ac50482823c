"""Rotations and rigid transforms, as few as the simulator needs. Quaternions are (w, x, y, z)."""

from __future__ import annotations

import numpy as np

AXES = {"x": 0, "y": 1, "z": 2}


def rot(axis: str, angle_rad: float) -> np.ndarray:
    """4x4 rotation about a coordinate axis."""
    T = np.eye(4)
    i = (AXES[axis] + 1) % 3
    j = (AXES[axis] + 2) % 3
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    T[i, i], T[i, j], T[j, i], T[j, j] = c, -s, s, c
    return T


def trans(x: float, y: float, z: float) -> np.ndarray:
    """4x4 translation."""
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def twist(tx=0.0, ty=0.0, tz=0.0, rx=0.0, ry=0.0, rz=0.0) -> np.ndarray:
    """Finite frame error in the project's order Tx Rx Ty Ry Rz Tz."""
    return trans(tx, 0, 0) @ rot("x", rx) @ trans(0, ty, 0) @ rot("y", ry) @ rot("z", rz) @ trans(0, 0, tz)


def quat(R: np.ndarray) -> np.ndarray:
    """Unit quaternion of a rotation matrix: largest component first, so half turns are exact too."""
    R = np.asarray(R)[:3, :3]
    d = np.diag(R)
    four = np.array([1 + d.sum(), 1 + d[0] - d[1] - d[2], 1 - d[0] + d[1] - d[2], 1 - d[0] - d[1] + d[2]])
    k = int(np.argmax(four))
    w, x, y, z = 0, 1, 2, 3
    q = np.empty(4)
    q[k] = 0.5 * np.sqrt(four[k])
    h = 0.25 / q[k]
    skew = {x: R[2, 1] - R[1, 2], y: R[0, 2] - R[2, 0], z: R[1, 0] - R[0, 1]}
    if k == w:
        for i, v in skew.items():
            q[i] = h * v
    else:
        q[w] = h * skew[k]
        for i in (x, y, z):
            if i != k:
                q[i] = h * (R[k - 1, i - 1] + R[i - 1, k - 1])
    if q[0] < 0:
        q = -q
    return q / np.linalg.norm(q)


def matrix(q_wxyz) -> np.ndarray:
    """3x3 rotation matrix of a unit quaternion."""
    w, x, y, z = q_wxyz
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def pose(p_m, R: np.ndarray) -> np.ndarray:
    """4x4 transform of a position and a 3x3 rotation."""
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = p_m
    return T


def angle(Ra: np.ndarray, Rb: np.ndarray) -> float:
    """Rotation angle between two attitudes [rad], in [0, pi]."""
    q = quat(np.asarray(Ra)[:3, :3].T @ np.asarray(Rb)[:3, :3])
    return float(2 * np.arctan2(np.linalg.norm(q[1:]), abs(q[0])))
