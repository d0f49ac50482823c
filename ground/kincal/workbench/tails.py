"""Tails and quantiles of the distributions that tests use, from scipy.special.

scipy.stats has them too, but importing it takes longer than comparing a model with a hundred poses.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from .types import Array


def chi2_tail(x: ArrayLike, dof: float) -> Array:
    """P(chi^2 > x)."""
    return np.asarray(special.chdtrc(dof, np.maximum(x, 0.0)))


def chi2_quantile(tail: float, dof: float) -> float:
    """The x with P(chi^2 > x) = tail; the median for 0.5."""
    return float(special.chdtri(dof, tail))


def chi2_shifted_tail(x: float, dof: float, noncentrality: float) -> float:
    """P(chi^2 > x) with a non-centrality: the power of a test at x."""
    return float(1.0 - special.chndtr(x, dof, noncentrality))


def f_tail(x: float, dof: float, dof_error: float) -> float:
    """P(F > x)."""
    return float(special.fdtrc(dof, dof_error, x))


def normal_quantile(tail: float) -> float:
    """The x with P(normal > x) = tail."""
    return float(-special.ndtri(tail))
