"""Poses from a camera and a board of many points, made with OpenCV: projection with a faulty lens, pose by
PnP with the nominal one. The arm is the plain numpy chain of poses.py."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import poses
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

WIDTH, HEIGHT = 1280, 720
K = np.array([[900.0, 0.0, 645.0], [0.0, 902.0, 355.0], [0.0, 0.0, 1.0]])
HALF_M = 0.16
BOARD = np.array(
    [(x, y, 0.0) for x in np.linspace(-HALF_M, HALF_M, 7) for y in np.linspace(-HALF_M, HALF_M, 7)]
)
NO_ERROR = np.zeros((7, 4))
BOARD_M = np.array([0.62, 0.0, 0.0])  # of the fixed board in the base frame
START = np.array([0.0, 0.35, 0.0, 2.0, 0.0, 0.7, 0.0])
STATED = "\n".join(
    [
        f"fx_px = {K[0, 0]}\nfy_px = {K[1, 1]}\ncx_px = {K[0, 2]}\ncy_px = {K[1, 2]}",
        f"width_px = {WIDTH}\nheight_px = {HEIGHT}",
        f"[target]\npoints_m = {BOARD.tolist()}",
    ]
)


def pose(rotvec, p_m):
    """4x4 pose."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = Rotation.from_rotvec(rotvec).as_matrix(), p_m
    return out


def project(target_in_camera, distortion=(0.0,) * 4, camera=K, points=BOARD):
    """(m, 2) pixels of the points and (m,) whether they are in the image."""
    R, t = target_in_camera[:3, :3], target_in_camera[:3, 3]
    pixels = cv2.projectPoints(points, cv2.Rodrigues(R)[0], t, camera, np.array(distortion))[0][:, 0]
    inside = np.all((pixels > 0) & (pixels < [WIDTH, HEIGHT]), axis=1) & ((points @ R.T + t)[:, 2] > 0)
    return pixels, inside


def pnp(pixels, points, camera=K):
    """4x4 pose of the target in the camera frame that fits the pixels best, camera without distortion."""
    _, r, t = cv2.solvePnP(points, pixels, camera, None, flags=cv2.SOLVEPNP_SQPNP)
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 200, 1e-15)
    r, t = cv2.solvePnPRefineLM(points, pixels, camera, None, r, t, criteria)
    return pose(r[:, 0], t[:, 0])


def arm_toml(path: Path, mount: str, stated: bool) -> Path:
    """The WAM with a camera; `stated`: the table holds intrinsics and points."""
    text = poses.arm_toml(path, masses=False).read_text()
    joints = text.index("[[joint]]")
    head = f'{text[:joints]}\n[sensor]\nmount = "{mount}"\n{STATED if stated else ""}\n'
    path.write_text(head.replace("quat_wxyz = [1.0, 0.0, 0.0, 0.0]\n", "estimate = true\n") + text[joints:])
    return path


def aimed(rng) -> np.ndarray | None:
    """Joint angles whose tool looks along z at the board from somewhere; None out of reach."""
    away = rng.uniform(0.3, 0.55)
    towards = Rotation.from_euler("xyz", [*rng.uniform(-0.6, 0.6, 2), rng.uniform(-1.5, 1.5)])
    R = towards.as_matrix() @ np.diag([1.0, -1.0, -1.0])
    aim = BOARD_M + np.r_[rng.normal(0.0, 0.04, 2), 0.0]
    want = aim - away * R[:, 2]

    def gap(q):
        got = poses.tool_pose(q, NO_ERROR)
        turn = Rotation.from_matrix(got[:3, :3].T @ R).as_rotvec()
        return np.r_[10.0 * (got[:3, 3] - want), turn, 0.02 * (q - START)]

    def slope(q):
        """Of the gap; of its turn as of a small one."""
        *joints, got = poses.frames(q, NO_ERROR)
        axes, places = (np.array([T[:3, k] for T in joints[:7]]) for k in (2, 3))
        moves = 10.0 * np.cross(axes, got[:3, 3] - places)
        return np.vstack([moves.T, -got[:3, :3].T @ axes.T, 0.02 * np.eye(7)])

    start = START + rng.normal(0.0, 0.2, 7)
    q = least_squares(gap, start, slope, ftol=1e-3, xtol=1e-3, max_nfev=60).x
    low, high = (np.array([row[k] for row in poses.WAM]) for k in (3, 4))
    return q if np.abs(gap(q)[:6]).max() < 0.1 and np.all((q > low) & (q < high)) else None


def eye_in_hand_csv(path: Path, n: int, seed: int, distortion, noise_px: float = 0.1) -> Path:
    """n poses of a camera at the tool in the frame of a fixed board."""
    rng = np.random.default_rng(seed)
    dh_error = rng.normal(0.0, 1.0, (7, 4)) * [1e-3, 1e-3, 3e-4, 3e-4]
    mount = pose(rng.normal(0.0, 0.02, 3), rng.normal(0.0, 0.01, 3))
    board = pose(np.zeros(3), BOARD_M)
    rows = []
    while len(rows) < n:
        q = aimed(rng)
        if q is None:
            continue
        camera = poses.tool_pose(q, dh_error) @ mount
        pixels, inside = project(np.linalg.inv(camera) @ board, distortion)
        if inside.sum() >= 12:
            noisy = pixels[inside] + rng.normal(0.0, noise_px, (inside.sum(), 2))
            rows.append((q, np.linalg.inv(pnp(noisy, BOARD[inside]))))
    return _write(path, rows)


def world_csv(path: Path, n: int, seed: int, distortion, noise_px: float = 0.1) -> Path:
    """n poses of a board at the tool, seen by a camera that stands and is turned at random."""
    rng = np.random.default_rng(seed)
    dh_error = rng.normal(0.0, 1.0, (7, 4)) * [1e-3, 1e-3, 3e-4, 3e-4]
    rows = []
    while len(rows) < n:
        q = START + rng.uniform(-0.6, 0.6, 7)
        tool = poses.tool_pose(q, dh_error)
        away = tool[:3, :3] @ Rotation.from_euler("xy", rng.uniform(-0.5, 0.5, 2)).apply([0.0, 0.0, 1.0])
        camera = _facing(tool[:3, 3] + rng.uniform(0.35, 0.5) * away, tool[:3, 3] + rng.normal(0.0, 0.05, 3))
        pixels, inside = project(np.linalg.inv(camera) @ tool, distortion)
        if inside.sum() >= 12:
            noisy = pixels[inside] + rng.normal(0.0, noise_px, (inside.sum(), 2))
            rows.append((q, camera @ pnp(noisy, BOARD[inside]), camera))
    return _write(path, rows)


def _facing(place, point):
    """4x4 pose of a camera that looks at a point."""
    z = (point - place) / np.linalg.norm(point - place)
    x = np.cross([0.1, 1.0, 0.2], z)
    x /= np.linalg.norm(x)
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = np.stack([x, np.cross(z, x), z], axis=1), place
    return out


def _write(path: Path, rows) -> Path:
    header = [f"q{j}" for j in range(1, 8)] + ["px", "py", "pz", "qw", "qx", "qy", "qz"]
    header += ["cx", "cy", "cz", "cqw", "cqx", "cqy", "cqz"] if len(rows[0]) == 3 else []
    with path.open("w", newline="") as file:
        out = csv.writer(file)
        out.writerow(header)
        for q, *seen in rows:
            out.writerow([*q, *(x for T in seen for x in (*T[:3, 3], *poses.quat_wxyz(T[:3, :3])))])
    return path
