"""Tails and quantiles of the distributions that tests use, from scipy.special.

scipy.stats has them too, but importing it takes longer than comparing a model with a hundred poses.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from .types import Array

_FEW = 8  # values up to which the normal distribution is too coarse for a rank sum


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


def rank_sum_p(x: Array, y: Array) -> float:
    """Two-sided p-value that samples (n,) and (m,) have one distribution (Mann, Whitney, Ann. Math. Stat.
    18(1), 1947): exact for a small sample without ties, else normal with continuity and ties corrected."""
    n, m = len(x), len(y)
    _, place, count = np.unique(np.concatenate([x, y]), return_inverse=True, return_counts=True)
    ranks = (np.cumsum(count) - 0.5 * (count - 1))[place]
    u = float(ranks[:n].sum()) - 0.5 * n * (n + 1)
    least = min(u, n * m - u)
    if min(n, m) <= _FEW and count.max() == 1:
        return min(1.0, 2.0 * _rank_sum_share(min(n, m), max(n, m), round(least)))
    ties = float((count**3.0 - count).sum()) / ((n + m) * (n + m - 1))
    variance = n * m / 12.0 * (n + m + 1 - ties)
    if variance <= 0.0:  # all values are the same
        return 1.0
    return min(1.0, 2.0 * float(special.ndtr((least + 0.5 - 0.5 * n * m) / np.sqrt(variance))))


def _rank_sum_share(n: int, m: int, most: int) -> float:
    """Share of the choices of n from n + m ranks whose statistic U is `most` at most: coefficients of the
    Gaussian binomial, the product of (1 - z^(m+i)) / (1 - z^i) for i = 1 .. n."""
    counts = np.zeros(most + 1)
    counts[0] = 1.0
    for i in range(1, n + 1):
        counts[m + i :] -= counts[: max(most + 1 - m - i, 0)].copy()
        for k in range(i, most + 1):
            counts[k] += counts[k - i]
    return float(counts.sum() / special.binom(n + m, n))
