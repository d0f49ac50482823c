"""Pose of the tool from tag corners, for the mode without pixels.

The minima are those of the tag detector (docs/METHOD.md 19). All corners count alike and are independent, and
the covariance is of first order; the detector weighs corners by their edges and sums over tilts.
They are found in C++ (sim/native/ks_pnp.cpp); in a run there are hundreds of frames.
Points are (k, 3) in the tool frame [m], pixels (k, 2), K is 3x3 [px]; R (3x3) and p (3,) [m] take the tool to
the camera frame.
"""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass
from functools import partial

import numpy as np

from kincal_shared.installation import SIMULATOR_LIBRARY, built

from . import tags

_PNP = ctypes.CDLL(str(built(SIMULATOR_LIBRARY))).ks_pnp
_PNP.argtypes, _PNP.restype = (ctypes.c_uint32, *[ctypes.c_void_p] * 5), ctypes.c_uint32
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
    return math.sqrt((weight * known_px**2 + n * rms_px**2) / (weight + n - 6.0))


def covariance(information: np.ndarray, sigma_px: float) -> np.ndarray:
    """6x6 covariance (position [m], rotation vector [rad]) of a pose fitted to corners of this noise."""
    return np.linalg.inv(information) * sigma_px**2


class _Room:
    """What the library reads and writes for some number of tags, with the addresses of it."""

    def __init__(self, camera: np.ndarray, n_tags: int) -> None:
        self.points, self.pixels = np.empty((n_tags, 4, 3)), np.empty((n_tags, 4, 2))
        self.poses, self.information = np.empty((2, _POSE)), np.empty((6, 6))
        self._camera = camera
        arrays = camera, self.points, self.pixels, self.poses, self.information
        self.call = partial(_PNP, n_tags, *(array.ctypes.data for array in arrays))


class Solver:
    """Solves for the poses of one camera (K). Not for two threads at once."""

    def __init__(self, K: np.ndarray) -> None:
        self._camera = np.array((K[0, 0], K[1, 1], K[0, 2], K[1, 2]))
        self._rooms: dict[int, _Room] = {}

    def solve(self, seen: list[SeenTag]) -> tuple[Pose, np.ndarray] | None:
        """One pose from all tags seen, and J'J (6x6) of their corners by position and rotation vector (in
        the camera frame, on the left); None if no candidate lies in front.

        Each tag gives two plane poses (IPPE); each is refined on all corners together. The best is the
        answer, the next one that differs from it is the alternative.
        """
        room = self._rooms.get(len(seen))
        if room is None:
            room = self._rooms[len(seen)] = _Room(self._camera, len(seen))
        for k, (tag, px) in enumerate(seen):
            room.points[k], room.pixels[k] = tag.tool_corners_m, px
        if not room.call():
            return None
        best, other = room.poses.copy()
        R, R_alt = best[:9].reshape(3, 3), other[:9].reshape(3, 3)
        pose = Pose(R, best[9:12], float(best[12]), R_alt, other[9:12], float(other[12]))
        return pose, room.information.copy()
