"""A frame that swings with time hides in noise whose covariance is unknown.

Where nothing states the noise, its covariance is that of the residuals. A swing in one direction is then a
large variance in that direction, and in units of this noise small. The test of Wilks compares the covariances
with and without a wave of time (Anderson, Introduction to Multivariate Statistical Analysis, 3rd ed., 8.4).
"""

from __future__ import annotations

import math

import numpy as np

from kincal_shared.schema.terms import ONE, Basis

from ..fit.least_squares import Fit
from ..model.effects import Hypothesis, Parameter, Term
from ..model.places import TYPICAL_SIZE
from ..model.shapes import SWINGS
from ..numerics.distributions import chi2_tail
from ..numerics.types import Array

_CLOSER = 0.25  # of a period
_SURE = 1e-6
_LEAST_POSES = 40
_NAME = "swing"


def swing(fit: Fit) -> Hypothesis | None:
    """The wave of time, of base translation and rotation, that the residuals of a fit follow beyond doubt;
    None if they do not, or if the noise is stated."""
    data = fit.data
    if data.cov is not None or data.t_s is None or np.ptp(data.t_s) <= 1e-9 or fit.good.sum() < _LEAST_POSES:
        return None
    z, t = fit.z.reshape(data.n, -1)[fit.good], data.t_s[fit.good]
    tried = np.arange(SWINGS[0], SWINGS[-1] + 0.5 * _CLOSER, _CLOSER)
    rates = 2.0 * math.pi * tried / np.ptp(data.t_s)
    p_values = [_wilks_p(z, rate * (t - data.t_s.min())) for rate in rates]
    best = int(np.argmin(p_values))
    if p_values[best] * len(tried) > _SURE:
        return None
    return _wave(float(data.t_s.min()), float(rates[best]))


def _wilks_p(z: Array, angle: Array) -> float:
    """p-value that residuals (N, c) do not follow a wave; Bartlett's approximation."""
    n, c = z.shape
    centred = z - z.mean(axis=0)
    wave = np.column_stack([np.cos(angle), np.sin(angle)])
    wave -= wave.mean(axis=0)
    left = centred - wave @ np.linalg.lstsq(wave, centred, rcond=None)[0]
    ln = [np.linalg.slogdet(x.T @ x)[1] for x in (left, centred)]
    return float(chi2_tail((n - 1 - 0.5 * (c + 3)) * (ln[1] - ln[0]), 2 * c))


def _wave(start_s: float, rate: float) -> Hypothesis:
    """Shifts and turns of the base in both phases."""
    bases = [Basis(fn, "t", 0, start_s, rate) for fn in ("cos", "sin")]
    parameters = tuple(
        Parameter(f"c{number}", "m" if comp < 3 else "rad", TYPICAL_SIZE, (Term(0, comp, 1.0, (basis, ONE)),))
        for number, (comp, basis) in enumerate(((k, b) for k in range(6) for b in bases), 1)
    )
    return Hypothesis(_NAME, _NAME, parameters)
