"""Pose of the tool from tag corners, for the mode without pixels.

The minima are those of the tag detector (docs/METHOD.md 19). All corners count alike and are independent, and
the covariance is of first order; the detector weighs corners by their edges and sums over tilts.
Points are (k, 3) in the tool frame [m], pixels (k, 2), K is 3x3 [px]; R (3x3) and p (3,) [m] take the tool to
the camera frame.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from . import tags

REFINE_UNTIL = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1e-12)
SAME_RAD = 0.01  # two refined candidates this close are the same minimum
SeenTag = tuple[tags.Tag, np.ndarray]  # and its corners (4, 2) [px]


@dataclass(frozen=True)
class Pose:
    """Tool in the camera frame, with the other solution and the reprojection RMS [px] of both."""

    R: np.ndarray
    p_m: np.ndarray
    rms_px: float
    R_alt: np.ndarray
    p_alt_m: np.ndarray
    rms_alt_px: float


@dataclass(frozen=True)
class _Candidate:
    R: np.ndarray
    p: np.ndarray
    rms_px: float
    in_front: bool  # all corners lie before the camera


def tool_corners(T_tool_tag: np.ndarray, size_m: float) -> np.ndarray:
    """(4, 3) corners of a tag in the tool frame, in libapriltag's order."""
    return tags.corners_m(size_m) @ T_tool_tag[:3, :3].T + T_tool_tag[:3, 3]


def project(K: np.ndarray, R: np.ndarray, p: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(k, 2) pixels of tool-frame points."""
    return _pixels(K, points @ R.T + p)


def _pixels(K: np.ndarray, seen_m: np.ndarray) -> np.ndarray:
    """(k, 2) pixels of points (k, 3) in the camera frame."""
    return K.diagonal()[:2] * seen_m[:, :2] / seen_m[:, 2:] + K[:2, 2]


def jacobian(K: np.ndarray, R: np.ndarray, p: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(2k, 6) d pixels / d (position, rotation vector) in the camera frame, rotation error on the left."""
    r = points @ R.T
    x, y, z = (r + p).T
    squared = np.array([depth**2 for depth in z.tolist()])
    D, cross = np.zeros((len(points), 2, 3)), np.zeros((len(points), 3, 3))
    D[:, 0, 0], D[:, 0, 2] = K[0, 0] / z, -K[0, 0] * x / squared
    D[:, 1, 1], D[:, 1, 2] = K[1, 1] / z, -K[1, 1] * y / squared
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -r[:, 2], r[:, 1], -r[:, 0]
    cross[:, 1, 0], cross[:, 2, 0], cross[:, 2, 1] = r[:, 2], -r[:, 1], r[:, 0]
    return np.concatenate([D, -D @ cross], axis=2).reshape(-1, 6)


def corner_sigma(rms_px: float, n_corners: int, known_px: float, weight: float) -> float:
    """Corner noise [px]: what is known beforehand, for `weight` residuals, and the residuals of this fit."""
    n = 2 * n_corners
    return float(np.sqrt((weight * known_px**2 + n * rms_px**2) / (weight + n - 6.0)))


def covariance(J: np.ndarray, sigma_px: float) -> np.ndarray:
    """6x6 covariance (position [m], rotation vector [rad]) of a pose fitted to corners of this noise."""
    return np.linalg.inv(J.T @ J) * sigma_px**2


def solve(K: np.ndarray, seen: list[SeenTag]) -> Pose | None:
    """One pose from all tags seen; None if no candidate lies in front.

    Each tag gives two plane poses (IPPE); each is refined on all corners together. The best is the answer,
    the next one that differs from it is the alternative.
    """
    points = np.concatenate([tag.tool_corners_m for tag, _ in seen])
    pixels = np.concatenate([px for _, px in seen])
    starts = [start for tag in seen for start in _plane_poses(K, tag)]
    refined = [_refine(K, R, p, points, pixels) for R, p in starts]
    found = [c for c in refined if math.isfinite(c.rms_px) and c.in_front]
    if not found:
        return None
    found.sort(key=lambda c: c.rms_px)
    best = found[0]
    other = next((c for c in found if _rotation_between(c.R, best.R) > SAME_RAD), best)
    return Pose(best.R, best.p, best.rms_px, other.R, other.p, other.rms_px)


def _plane_poses(K: np.ndarray, seen: SeenTag) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """The two plane poses of one tag, as poses (R, p) of the tool."""
    tag, px = seen
    T = tag.T_tool_tag
    n, rvecs, tvecs, _ = cv2.solvePnPGeneric(tag.corners_m, px, K, None, flags=cv2.SOLVEPNP_IPPE)
    for rvec, tvec in list(zip(rvecs, tvecs, strict=True))[:n]:
        R = cv2.Rodrigues(rvec)[0] @ T[:3, :3].T
        yield R, tvec.ravel() - R @ T[:3, 3]


def _refine(
    K: np.ndarray, R: np.ndarray, p: np.ndarray, points: np.ndarray, pixels: np.ndarray
) -> _Candidate:
    rvec, tvec = cv2.Rodrigues(R)[0], p.reshape(3, 1).copy()
    rvec, tvec = cv2.solvePnPRefineLM(points, pixels, K, None, rvec, tvec, REFINE_UNTIL)
    R, p = cv2.Rodrigues(rvec)[0], tvec.ravel()
    seen_m = points @ R.T + p
    off_px = (_pixels(K, seen_m) - pixels).ravel()
    rms_px = math.sqrt(np.add.reduce(off_px * off_px) / len(off_px))
    return _Candidate(R, p, rms_px, min(seen_m[:, 2].tolist()) > 0.0)


def _rotation_between(A: np.ndarray, B: np.ndarray) -> float:
    return math.hypot(*cv2.Rodrigues(A.T @ B)[0].ravel().tolist())
