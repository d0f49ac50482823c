"""Are all lengths of the arm wrong by one factor? Then the sensor may be: a wrong size of the tag looks the
same (METHOD.md 12.3)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ..numerics.distributions import f_tail
from ..numerics.types import Array, Indices, array
from .least_squares import Fit

_DETERMINED_M = 3e-3  # standard error of a combination of lengths that the data determine
_LEAST = 3  # such combinations: fewer agree with a factor by chance
_BUILT_M = np.geomspace(1e-6, 1e-1, 101)  # errors of lengths, as they are built, that are tried
_SURELY, _DENIED = 5.0, 3.0  # standard errors: from zero; between it and that of the lengths but for two
_P = 1e-3
_HALF = 0.5  # of the factor: what the others have less than, they deny
_LEAST_SHARE = 1e-3  # of a length: less matters to nobody


@dataclass(frozen=True)
class LengthScale:
    """The share by which all lengths are longer than in the arm table, with its standard error, from the
    scatter of the lengths about it too; p_value: that it is zero (t test); lengths: how many, or combinations
    of them, the data determine."""

    share: float
    std_err: float
    p_value: float
    lengths: int


def length_scale(fit: Fit) -> LengthScale | None:
    """The common factor of the lengths a and d of a fit, None where there is none. Generalised least squares
    of the lengths' errors on the lengths, with the covariance of the fit and an error of each length as it is
    built, of equal and unknown size (by restricted maximum likelihood). None, too, where the lengths
    but for any two have clearly less of it."""
    at, nominal = _lengths(fit)
    found = _factor(fit, at, nominal)
    if found is None or abs(found.share) < max(_SURELY * found.std_err, _LEAST_SHARE) or found.p_value > _P:
        return None
    for two in combinations(range(len(at)), 2):  # two links that are built wrong are no factor of all
        rest = _factor(fit, np.delete(at, two), np.delete(nominal, two))
        kept = rest.share / found.share if rest else 1.0
        if rest and kept < _HALF and (1.0 - kept) * abs(found.share) > _DENIED * rest.std_err:
            return None
    return found


def _factor(fit: Fit, at: Indices, nominal: Array) -> LengthScale | None:
    """The factor of these lengths, significant or not; None where too few are determined."""
    if len(at) < _LEAST:
        return None
    variance, axes = np.linalg.eigh(fit.cov[np.ix_(at, at)])
    shown = variance < _DETERMINED_M**2
    errors, lengths = (axes[:, shown].T @ x for x in (fit.estimate[at], nominal))
    count = int(shown.sum())
    if count < _LEAST or not np.abs(lengths).max() > 0.0:
        return None
    share, std_err = _common(errors, lengths, array(np.maximum(variance[shown], 0.0)))
    return LengthScale(share, std_err, f_tail((share / std_err) ** 2, 1.0, count - 1.0), count)


def _lengths(fit: Fit) -> tuple[Indices, Array]:
    """Places of a and d among the coefficients, and their values in the arm table [m]. d of a sliding joint
    is where its reading begins, and no length."""
    found = [
        (fit.names.index(name), value)
        for j, joint in enumerate(fit.arm.joints, 1)
        for key, value in (("a_m", joint.a_m), ("d_m", joint.d_m))
        if (name := f"J{j}.{key}") in fit.names and not (key == "d_m" and joint.prismatic)
    ]
    return np.array([at for at, _ in found], dtype=int), array(np.array([value for _, value in found]))


def _common(errors: Array, lengths: Array, variance: Array) -> tuple[float, float]:
    """Factor and its standard error."""
    v = variance + _BUILT_M[:, None] ** 2
    information = (lengths**2 / v).sum(axis=1)
    share = (lengths * errors / v).sum(axis=1) / information
    left = ((errors - share[:, None] * lengths) ** 2 / v).sum(axis=1)
    best = int(np.argmin(left + np.log(v).sum(axis=1) + np.log(information)))  # -2 ln restricted likelihood
    return float(share[best]), float(information[best] ** -0.5)
