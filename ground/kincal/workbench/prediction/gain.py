"""Does an effect help on held-out poses? One rule, by the interval of a ratio of errors."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from ..numerics.types import Array, Groups, Indices, array

Gain = Literal["helps", "harms", "does not help", "undecided"]

_LEAST_GAIN = 0.97  # an effect that gains less than 3 % brings nothing
_NOTHING = 0.002  # change of an error that says nothing
_UNSEEN = 0.0005  # that three digits do not show
_MUCH_WORSE = 1.1
_BOOTSTRAP = 1000


def judged(ratio: float, interval: tuple[float, float], *, nothing: bool = True) -> Gain:
    """helps: the interval of the ratio lies below 1; harms: above 1 (both where three digits of the ratio
    show it); does not help: it excludes a gain of 3 % and more, and nothing is gained at all (as of
    `nothing_gained`); undecided: these poses leave both open (also where no poses are held out: NaN)."""
    low, high = interval
    if not (math.isfinite(low) and math.isfinite(high)):
        return "undecided"
    if high < 1.0 and ratio < 1.0 - _UNSEEN:
        return "helps"
    if low > 1.0 and ratio > 1.0 + _UNSEEN:
        return "harms"
    return "does not help" if low >= _LEAST_GAIN and nothing else "undecided"


def together(position: float, rotation: float | None) -> float:
    """Ratio of errors, of positions and rotations in equal shares where there are rotations."""
    return position if rotation is None else math.hypot(position, rotation) / math.sqrt(2.0)


def nothing_gained(position: float, rotation: float | None) -> bool:
    """By the ratios of errors: two thousandths at most, or positions lose as much."""
    return together(position, rotation) > 1.0 - _NOTHING or position > 1.0 + _NOTHING


def much_worse(interval: tuple[float, float]) -> bool:
    """The error grows by more than a tenth, with the whole interval of the ratio."""
    return interval[0] > _MUCH_WORSE


def held_ratio(
    after: Array, before: Array, groups: Groups | None = None
) -> tuple[float, tuple[float, float]]:
    """Ratio of RMS errors, given their squares (M,) over the same held-out poses, with its 95 % bootstrap
    interval. groups: (M,) equal for replicates of one pose, None if there are none: what a model leaves of a
    pose is in all of them, so that they are drawn together (Davison, Hinkley, Bootstrap Methods and their
    Application, 1997, section 3.8). The draws depend on the number of poses only, so that every table says
    the same of the same poses."""
    (sums_after, _), (sums_before, _) = _sums(after, groups), _sums(before, groups)
    pick = _drawn(len(sums_after))
    boot = np.sqrt(sums_after[pick].sum(axis=1) / np.maximum(sums_before[pick].sum(axis=1), 1e-300))
    return float(np.sqrt(after.mean() / before.mean())), _interval_95(boot)


def unpaired_ratio(
    square: Array, other_m: float, count: int, groups: Groups | None = None
) -> tuple[float, tuple[float, float]]:
    """Ratio of the RMS of errors, given their squares (M,), to that of `count` other poses of which only the
    RMS is known, with its 95 % bootstrap interval: as if the others were spread alike. groups: as of
    `held_ratio`."""
    mine = float(np.sqrt(square.mean()))
    means = group_means(square, groups)
    drawn = np.random.default_rng(3).integers(0, len(means), (_BOOTSTRAP, count))
    own = means[_drawn(len(means))].mean(axis=1)
    boot = mine / other_m * np.sqrt(own / np.maximum(means[drawn].mean(axis=1), 1e-300))
    return mine / other_m, _interval_95(boot)


def rms_interval(square: Array, groups: Groups | None = None) -> tuple[float, float]:
    """95 % bootstrap interval of the RMS of errors, given their squares (M,). groups: as of `held_ratio`."""
    sums, counts = _sums(square, groups)
    pick = _drawn(len(sums))
    return _interval_95(np.sqrt(sums[pick].sum(axis=1) / counts[pick].sum(axis=1)))


def group_means(values: Array, groups: Groups | None) -> Array:
    """(G,) means of values (M,) over replicates; the values where there are none."""
    sums, counts = _sums(values, groups)
    return array(sums / counts)


def _sums(values: Array, groups: Groups | None) -> tuple[Array, Array]:
    """(G,) sums of values (M,) over groups, and how many each has."""
    if groups is None:
        return values, np.ones(len(values))
    _, number = np.unique(groups, return_inverse=True)
    return array(np.bincount(number, values)), array(np.bincount(number))


def _drawn(count: int) -> Indices:
    """(draws, count) of a bootstrap."""
    return np.random.default_rng(2).integers(0, count, (_BOOTSTRAP, count))


def _interval_95(values: Array) -> tuple[float, float]:
    return float(np.quantile(values, 0.025)), float(np.quantile(values, 0.975))
