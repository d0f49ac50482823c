"""Pose of the tool from tag corners: the arithmetic of the tag detector, for the mode without pixels.

Written apart from the C++ detector; a test compares the two on the same corners.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from . import tags


@dataclass(frozen=True)
class Pose:
    """Tool in the camera frame, with the other solution and the reprojection RMS [px] of both."""

    R: np.ndarray
    p_m: np.ndarray
    rms_px: float
    R_alt: np.ndarray
    p_alt_m: np.ndarray
    rms_alt_px: float


def tool_corners(T_tool_tag: np.ndarray, size_m: float) -> np.ndarray:
    """The four corners of a tag in the tool frame, in libapriltag's order (4x3)."""
    flat = np.column_stack([tags.CORNERS * size_m, np.zeros(4)])
    return flat @ T_tool_tag[:3, :3].T + T_tool_tag[:3, 3]


def project(K: np.ndarray, R: np.ndarray, p: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Pixels of tool-frame points."""
    x = points @ R.T + p
    return np.column_stack([K[0, 0] * x[:, 0] / x[:, 2] + K[0, 2], K[1, 1] * x[:, 1] / x[:, 2] + K[1, 2]])


def jacobian(K: np.ndarray, R: np.ndarray, p: np.ndarray, points: np.ndarray) -> np.ndarray:
    """d pixels / d (position, rotation vector) in the camera frame, rotation error on the left."""
    r = points @ R.T
    x = r + p
    J = np.zeros((2 * len(points), 6))
    for i, (ri, xi) in enumerate(zip(r, x, strict=True)):
        D = np.array(
            [
                [K[0, 0] / xi[2], 0.0, -K[0, 0] * xi[0] / xi[2] ** 2],
                [0.0, K[1, 1] / xi[2], -K[1, 1] * xi[1] / xi[2] ** 2],
            ]
        )
        cross = np.array([[0, -ri[2], ri[1]], [ri[2], 0, -ri[0]], [-ri[1], ri[0], 0]])
        J[2 * i : 2 * i + 2, :3] = D
        J[2 * i : 2 * i + 2, 3:] = -D @ cross
    return J


def corner_sigma(rms_px: float, n_corners: int, known_px: float, weight: float) -> float:
    """Corner noise: what is known beforehand, for `weight` residuals, and the residuals of this fit."""
    n = 2 * n_corners
    return float(np.sqrt((weight * known_px**2 + n * rms_px**2) / (weight + n - 6.0)))


def covariance(J: np.ndarray, sigma_px: float) -> np.ndarray:
    """6x6 covariance (position, rotation vector) of a pose fitted to corners of this noise."""
    return np.linalg.inv(J.T @ J) * sigma_px**2


def _rms(K, R, p, points, pixels) -> float:
    e = project(K, R, p, points) - pixels
    return float(np.sqrt(np.mean(e**2)))


def _refine(K, R, p, points, pixels) -> tuple[np.ndarray, np.ndarray, float]:
    rvec, tvec = cv2.solvePnPRefineLM(
        points,
        pixels,
        K,
        None,
        cv2.Rodrigues(R)[0],
        p.reshape(3, 1).copy(),
        (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1e-12),
    )
    R = cv2.Rodrigues(rvec)[0]
    p = tvec.ravel()
    return R, p, _rms(K, R, p, points, pixels)


def _rotation_between(A: np.ndarray, B: np.ndarray) -> float:
    return float(np.linalg.norm(cv2.Rodrigues(A.T @ B)[0]))


def solve(K: np.ndarray, seen: list[tuple[np.ndarray, float, np.ndarray]]) -> Pose | None:
    """One pose from all tags seen: list of (T_tool_tag, size_m, corner pixels 4x2).

    Each tag gives two plane poses (IPPE); each is refined on all corners together. The best is the
    answer, the next one that differs from it is the alternative. None if no candidate lies in front.
    """
    points = np.vstack([tool_corners(T, size) for T, size, _ in seen])
    pixels = np.vstack([px for _, _, px in seen])
    found = []
    for T, size, px in seen:
        flat = np.column_stack([tags.CORNERS * size, np.zeros(4)])
        n, rvecs, tvecs, _ = cv2.solvePnPGeneric(flat, px, K, None, flags=cv2.SOLVEPNP_IPPE)
        for rvec, tvec in list(zip(rvecs, tvecs, strict=True))[:n]:
            R = cv2.Rodrigues(rvec)[0] @ T[:3, :3].T
            p = tvec.ravel() - R @ T[:3, 3]
            R, p, rms = _refine(K, R, p, points, pixels)
            if np.isfinite(rms) and np.all((points @ R.T + p)[:, 2] > 0.0):
                found.append((rms, R, p))
    if not found:
        return None
    found.sort(key=lambda f: f[0])
    rms, R, p = found[0]
    other = next((f for f in found if _rotation_between(f[1], R) > 0.01), found[0])
    return Pose(R, p, rms, other[1], other[2], other[0])
