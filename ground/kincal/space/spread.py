"""Distance between poses as flight's Gaussian process sees it, and poses far apart under it."""

from __future__ import annotations

from typing import Any

import numpy as np

from kincal import core
from kincal.geometry import R_to_quat

_ANGLES = 8193  # the core's kernel is tabled over the rotation angle: interpolation is good to 1e-6


class Metric:
    """d(x, y)^2 = k(x, x) + k(y, y) - 2 k(x, y), over k(x, x): 0 for the same pose, at most about 2."""

    def __init__(self, kernel: Any, hyper: int, p: np.ndarray, R: np.ndarray) -> None:
        self.n, self.p = len(p), p
        self.q = np.array([R_to_quat(x) for x in R]).reshape(-1, 4)
        self.beta_m = float(kernel.hyper[hyper].beta_m)
        self.angle = np.linspace(0.0, np.pi, _ANGLES)
        one, at = core.ffi.new("double[4]", [1.0, 0.0, 0.0, 0.0]), core.ffi.new("double[4]")
        rot = np.empty(_ANGLES)
        for i, a in enumerate(self.angle):
            at[0], at[1] = np.cos(0.5 * a), np.sin(0.5 * a)
            rot[i] = core.lib.kc_kernel_rot(kernel, hyper, one, at)
        self.rot = rot / rot[0]

    def covariance(self, i: int) -> np.ndarray:
        """Of pose i with all poses, over its variance."""
        w = np.abs(self.q @ self.q[i])
        v = np.linalg.norm(self.q - np.sign(self.q @ self.q[i])[:, None] * self.q[i], axis=1)
        angle = np.where(
            w < 0.9, 2.0 * np.arccos(np.minimum(w, 1.0)), 4.0 * np.arcsin(0.5 * np.minimum(v, 2.0))
        )
        far = np.sum((self.p - self.p[i]) ** 2, axis=1)
        return np.interp(angle, self.angle, self.rot) * np.exp(-far / (2.0 * self.beta_m**2))

    def squared(self, i: int) -> np.ndarray:
        return np.maximum(2.0 - 2.0 * self.covariance(i), 0.0)


def farthest(metric: Metric, n: int, first: int) -> list[int]:
    """Farthest-point selection: each next pose is the one farthest from those chosen; ties by index."""
    chosen = [first]
    nearest = metric.squared(first)
    nearest[first] = -1.0
    while len(chosen) < min(n, metric.n):
        i = int(np.argmax(nearest))
        chosen.append(i)
        nearest = np.minimum(nearest, metric.squared(i))
        nearest[i] = -1.0
    return chosen
