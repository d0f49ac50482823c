"""Distance between tool poses as flight's Gaussian process sees it, and poses far apart under it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kincal.flight.kernel import rotation_correlation
from kincal.rotations import Pose

from .arrays import Floats

if TYPE_CHECKING:
    from kincal.flight.headers import KcKernel

_ANGLES = 8193  # the core's kernel is tabled over the rotation angle: interpolation is good to 1e-6


class KernelMetric:
    """d(x, y)^2 = (k(x, x) + k(y, y) - 2 k(x, y)) / k(x, x): 0 for the same pose, at most about 2.

    kernel: KERNEL table; hyper: which of its sets of hyperparameters; poses: (n,) tool poses in the base
    frame."""

    def __init__(self, kernel: KcKernel, hyper: int, poses: Pose) -> None:
        self.n, self._p_m = len(poses.p_m), poses.p_m
        self._quat = poses.quat_wxyz.reshape(-1, 4)
        self._beta_m = float(kernel.hyper[hyper].beta_m)
        self._angles_rad = np.linspace(0.0, np.pi, _ANGLES)
        self._correlation = rotation_correlation(kernel, hyper, self._angles_rad)
        self._slope = np.diff(self._correlation) / np.diff(self._angles_rad)

    def _of_rotation(self, angle_rad: Floats) -> Floats:
        """Its part of the correlation, (n,). Angles are even, so none is sought as np.interp does: that took
        more time than everything else here."""
        k = np.minimum((angle_rad * ((_ANGLES - 1) / np.pi)).astype(int), _ANGLES - 2)
        out: Floats = self._correlation[k] + self._slope[k] * (angle_rad - self._angles_rad[k])
        return out

    def covariance(self, i: int) -> Floats:
        """Of pose i with all poses, over its variance, (n,)."""
        half_cosine: Floats = np.abs(self._quat @ self._quat[i])
        angle: Floats = 2.0 * np.arccos(np.minimum(half_cosine, 1.0))
        squared_m2 = np.sum((self._p_m - self._p_m[i]) ** 2, axis=1)
        position: Floats = np.exp(-squared_m2 / (2.0 * self._beta_m**2))
        return self._of_rotation(angle) * position

    def squared(self, i: int) -> Floats:
        """Squared distance of pose i to all poses, (n,)."""
        return np.maximum(2.0 - 2.0 * self.covariance(i), 0.0)


def farthest_points(metric: KernelMetric, n: int, start: int) -> list[int]:
    """Farthest-point selection of at most n poses from pose `start` on: each next pose is the one farthest
    from those chosen; ties by index."""
    chosen = [start]
    nearest = metric.squared(start)
    nearest[start] = -1.0
    while len(chosen) < min(n, metric.n):
        i = int(np.argmax(nearest))
        chosen.append(i)
        nearest = np.minimum(nearest, metric.squared(i))
        nearest[i] = -1.0
    return chosen


def central(p_m: Floats) -> int:
    """Index of the position nearest to the mean of all, (n, 3)."""
    return int(np.argmin(np.linalg.norm(p_m - p_m.mean(axis=0), axis=1)))
