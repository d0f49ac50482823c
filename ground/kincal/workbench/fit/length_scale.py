"""Are all lengths of the arm wrong by one factor? Then the sensor may be: a wrong size of the tag looks the
same (METHOD.md 12.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..numerics.distributions import f_tail
from ..numerics.types import Array, array
from .least_squares import Fit

_DETERMINED_M = 3e-3  # standard error of a combination of lengths that the data determine
_LEAST = 3  # such combinations: fewer agree with a factor by chance
_BUILT_M = np.geomspace(1e-6, 1e-1, 101)  # errors of lengths, as they are built, that are tried
_SURELY = 5.0  # standard errors
_P = 1e-3
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
    built, of equal and unknown size (by restricted maximum likelihood)."""
    at, nominal = _lengths(fit)
    if not at:
        return None
    variance, axes = np.linalg.eigh(fit.cov[np.ix_(at, at)])
    shown = variance < _DETERMINED_M**2
    errors, lengths = (axes[:, shown].T @ x for x in (fit.estimate[at], nominal))
    count = int(shown.sum())
    if count < _LEAST or not np.abs(lengths).max() > 0.0:
        return None
    share, std_err = _common(errors, lengths, array(np.maximum(variance[shown], 0.0)))
    p_value = f_tail((share / std_err) ** 2, 1.0, count - 1.0)
    if abs(share) < max(_SURELY * std_err, _LEAST_SHARE) or p_value > _P:
        return None
    return LengthScale(share, std_err, p_value, count)


def _lengths(fit: Fit) -> tuple[list[int], Array]:
    """Places of a and d among the coefficients, and their values in the arm table [m]. d of a sliding joint
    is where its reading begins, and no length."""
    found = [
        (fit.names.index(name), value)
        for j, joint in enumerate(fit.arm.joints, 1)
        for key, value in (("a_m", joint.a_m), ("d_m", joint.d_m))
        if (name := f"J{j}.{key}") in fit.names and not (key == "d_m" and joint.prismatic)
    ]
    return [at for at, _ in found], array(np.array([value for _, value in found]))


def _common(errors: Array, lengths: Array, variance: Array) -> tuple[float, float]:
    """Factor and its standard error."""
    v = variance + _BUILT_M[:, None] ** 2
    information = (lengths**2 / v).sum(axis=1)
    share = (lengths * errors / v).sum(axis=1) / information
    left = ((errors - share[:, None] * lengths) ** 2 / v).sum(axis=1)
    best = int(np.argmin(left + np.log(v).sum(axis=1) + np.log(information)))  # -2 ln restricted likelihood
    return float(share[best]), float(information[best] ** -0.5)
