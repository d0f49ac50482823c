"""Does an effect help on held-out poses? One rule, by the interval of a ratio of errors."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from ..numerics.types import Array

Gain = Literal["helps", "harms", "does not help", "undecided"]

_LEAST_GAIN = 0.97  # an effect that gains less than 3 % brings nothing
_MUCH_WORSE = 1.1
_BOOTSTRAP = 1000


def judged(interval: tuple[float, float]) -> Gain:
    """helps: the interval of the ratio lies below 1; harms: above 1; does not help: it excludes a gain of
    3 % and more; undecided: these poses leave both open (also where no poses are held out: NaN)."""
    low, high = interval
    if not (math.isfinite(low) and math.isfinite(high)):
        return "undecided"
    if high < 1.0:
        return "helps"
    if low > 1.0:
        return "harms"
    return "does not help" if low >= _LEAST_GAIN else "undecided"


def much_worse(interval: tuple[float, float]) -> bool:
    """The error grows by more than a tenth, with the whole interval of the ratio."""
    return interval[0] > _MUCH_WORSE


def held_ratio(after: Array, before: Array) -> tuple[float, tuple[float, float]]:
    """Ratio of RMS errors, given their squares (M,) over the same held-out poses, with its 95 % bootstrap
    interval. The draws depend on M only, so that every table says the same of the same poses."""
    pick = np.random.default_rng(2).integers(0, len(after), (_BOOTSTRAP, len(after)))
    boot = np.sqrt(after[pick].mean(axis=1) / np.maximum(before[pick].mean(axis=1), 1e-300))
    return float(np.sqrt(after.mean() / before.mean())), _interval_95(boot)


def rms_interval(square: Array) -> tuple[float, float]:
    """95 % bootstrap interval of the RMS of errors, given their squares (M,)."""
    pick = np.random.default_rng(2).integers(0, len(square), (_BOOTSTRAP, len(square)))
    return _interval_95(np.sqrt(square[pick].mean(axis=1)))


def _interval_95(values: Array) -> tuple[float, float]:
    return float(np.quantile(values, 0.025)), float(np.quantile(values, 0.975))
