"""Pose of the tool from tag corners, for the mode without pixels.

The minima are those of the tag detector (docs/METHOD.md 19). All corners count alike and are independent, and
the covariance is of first order; the detector weighs corners by their edges and sums over tilts.
They are found in C++ (sim/native/ks_pnp.cpp); in a run there are hundreds of frames.
Points are (k, 3) in the tool frame [m], pixels (k, 2), K is 3x3 [px]; R (3x3) and p (3,) [m] take the tool to
the camera frame.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass

import numpy as np

from kincal_shared.installation import built

from . import tags

LIBRARY = "libsim_native.so"
_NATIVE = ctypes.CDLL(str(built(LIBRARY)))
_POSE = 13  # doubles of a pose: attitude by rows, position, RMS
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


def tool_corners(T_tool_tag: np.ndarray, size_m: float) -> np.ndarray:
    """(4, 3) corners of a tag in the tool frame, in libapriltag's order."""
    return tags.corners_m(size_m) @ T_tool_tag[:3, :3].T + T_tool_tag[:3, 3]


def project(K: np.ndarray, R: np.ndarray, p: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(k, 2) pixels of tool-frame points."""
    seen_m = points @ R.T + p
    return K.diagonal()[:2] * seen_m[:, :2] / seen_m[:, 2:] + K[:2, 2]


def corner_sigma(rms_px: float, n_corners: int, known_px: float, weight: float) -> float:
    """Corner noise [px]: what is known beforehand, for `weight` residuals, and the residuals of this fit."""
    n = 2 * n_corners
    return float(np.sqrt((weight * known_px**2 + n * rms_px**2) / (weight + n - 6.0)))


def covariance(information: np.ndarray, sigma_px: float) -> np.ndarray:
    """6x6 covariance (position [m], rotation vector [rad]) of a pose fitted to corners of this noise."""
    return np.linalg.inv(information) * sigma_px**2


def solve(K: np.ndarray, seen: list[SeenTag]) -> tuple[Pose, np.ndarray] | None:
    """One pose from all tags seen, and J'J (6x6) of their corners by position and rotation vector (in the
    camera frame, on the left); None if no candidate lies in front.

    Each tag gives two plane poses (IPPE); each is refined on all corners together. The best is the answer,
    the next one that differs from it is the alternative.
    """
    camera = np.array((K[0, 0], K[1, 1], K[0, 2], K[1, 2]))
    points = np.concatenate([tag.tool_corners_m for tag, _ in seen])
    pixels = np.concatenate([px for _, px in seen])
    poses, information = np.empty((2, _POSE)), np.empty((6, 6))
    arrays = camera, points, pixels, poses, information
    if not _NATIVE.ks_pnp(len(seen), *(ctypes.c_void_p(array.ctypes.data) for array in arrays)):
        return None
    (R, p, rms), (R_alt, p_alt, rms_alt) = ((x[:9].reshape(3, 3), x[9:12], float(x[12])) for x in poses)
    return Pose(R, p, rms, R_alt, p_alt, rms_alt), information
