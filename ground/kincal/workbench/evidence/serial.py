"""Is what a fit leaves correlated in time? Residuals of poses measured one after another, beside those of
poses that are as near in joint space and were measured long before or after.

A plain test (Durbin, Watson, Biometrika 37, 1950) cannot tell time from place: on a grid, the next pose is
near the last one, and what a model lacks is alike in both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist
from scipy.special import stdtr

from ..data.direction import order_of_measurement
from ..data.measurements import Measurements
from ..fit.least_squares import Fit
from ..numerics.types import Array, array

SERIAL_P = 1e-3
_LEAST_SHARE = 0.15  # of the variance of the residuals that time explains; less does no harm
_LEAST_POSES = 24
_LONG = 0.2  # of the session: poses so far apart in time have nothing in common through it
_PARTNERS = 8  # poses beside which each pair is put
_AS_NEAR = 1.25  # times the distance of the pair in joint space
_MOST_POSES = 2000  # of a session; of a longer one its beginning
_BATCH = 5  # pairs: one after another they have poses in common
_LEAST_PAIRS = 20
_USUAL = 3.0  # length of a whitened residual from which on it counts no more


@dataclass(frozen=True)
class Serial:
    """share: of the variance of the residuals that poses measured one after another have in common and poses
    as near do not; p_value: that it is chance; separable: false where no poses as near were measured at
    another time, so that time and place are one, and the share is that of both."""

    share: float = 0.0
    p_value: float = 1.0
    separable: bool = True

    @property
    def correlated(self) -> bool:
        """What is left follows time, beyond chance and by enough to look like effects."""
        return self.p_value < SERIAL_P and self.share > _LEAST_SHARE


def serial_correlation(fit: Fit) -> Serial:
    """Of the poses of a fit, in the order of measurement."""
    order = order_of_measurement(fit.data)
    if order is None or len(order) < _LEAST_POSES:
        return Serial()
    order = order[:_MOST_POSES]
    z = fit.z.reshape(fit.data.n, -1)[order] / fit.scale
    return _beside_as_near(_usual(z), _places(fit.data.take(order)))


def _usual(z: Array) -> Array:
    """(N, c) whitened residuals, no longer than usual ones: an outlier says nothing of its neighbours."""
    length = np.linalg.norm(z, axis=1) / math.sqrt(z.shape[1])
    return array(z / np.maximum(length / _USUAL, 1.0)[:, None])


def _places(data: Measurements) -> Array:
    """(N, n + 3) joints and positions, each in units of its spread."""
    x = np.column_stack([data.q, data.p_m])
    return array((x - x.mean(axis=0)) / np.maximum(x.std(axis=0), 1e-9))


def _beside_as_near(z: Array, x: Array) -> Serial:
    """From residuals z (N, c) and places x (N, k) in the order of measurement: squared differences of
    residuals from one pose to the next beside those of each of the two to poses as near."""
    n = len(z)
    away, step = cdist(x, x), np.linalg.norm(np.diff(x, axis=0), axis=1)
    number = np.arange(n)
    away[np.abs(np.subtract.outer(number, number)) < _LONG * n] = np.inf
    pairs = []
    for i in range(n - 1):
        others = [mean for k in (i, i + 1) if (mean := _to_as_near(z, k, away[k], step[i])) is not None]
        if others:
            pairs.append((float(np.mean(others)), float(((z[i + 1] - z[i]) ** 2).sum())))
    if separable := len(pairs) >= _LEAST_PAIRS:
        usual, next_ = np.array(pairs).T
    else:
        usual = np.full(n - 1, 2.0 * (z**2).sum() / n)
        next_ = (np.diff(z, axis=0) ** 2).sum(axis=1)
    batches = len(usual) // _BATCH
    less = (usual - next_)[: batches * _BATCH].reshape(batches, _BATCH).mean(axis=1)
    t = less.mean() / max(float(less.std(ddof=1)) / math.sqrt(batches), 1e-300)
    share = float(1.0 - next_.sum() / max(usual.sum(), 1e-300))
    return Serial(share, float(stdtr(batches - 1, -t)), separable)


def _to_as_near(z: Array, k: int, away: Array, step: float) -> float | None:
    """Mean squared difference of the residual of pose k to those of poses about a step from it; None if there
    are none. away: (N,) distances from pose k, infinite to poses that were measured soon before or after."""
    near = np.flatnonzero(away <= _AS_NEAR * step)
    if not len(near):
        return None
    chosen = near[np.argsort(np.abs(away[near] - step), kind="stable")[:_PARTNERS]]
    return float(((z[chosen] - z[k]) ** 2).sum(axis=1).mean())
