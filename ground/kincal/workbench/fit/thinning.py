"""A designed part of many poses, for what costs N^2 or hundreds of columns; the same every time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kincal.flight import Evaluation

from ..data.measurements import Measurements
from ..model.flight_model import observations
from ..numerics.types import Array, Indices
from .least_squares import Fit

MANY = 1000  # poses up to which all are used
PART = 800  # poses of a part


def part_of(data: Measurements) -> Indices:
    """Indices of the poses that stand for all: all of them up to `MANY`, else `PART` spread evenly over
    joints, time, approach directions, temperature and payload."""
    return np.arange(data.n) if data.n <= MANY else np.sort(spread(_conditions(data), PART))


def spread(x: Array, count: int) -> Indices:
    """Indices of rows of x (N, d), each the farthest from those before it (Gonzalez, Theor. Comput. Sci. 38,
    1985), beginning with the one nearest to the mean."""
    chosen = [int(((x - x.mean(axis=0)) ** 2).sum(axis=1).argmin())]
    distance = np.full(len(x), np.inf)
    while len(chosen) < min(count, len(x)):
        distance = np.minimum(distance, ((x - x[chosen[-1]]) ** 2).sum(axis=1))
        chosen.append(int(distance.argmax()))
    return np.array(chosen)


def _conditions(data: Measurements) -> Array:
    """(N, d) what distinguishes poses, each column with unit variance; constant ones left out."""
    recorded = (data.q, data.direction, data.t_s, data.temp_c, data.payload_kg)
    columns = np.column_stack([x for x in recorded if x is not None])
    varied = columns[:, columns.std(axis=0) > 0]
    scaled: Array = (varied - varied.mean(axis=0)) / varied.std(axis=0)
    return scaled


def thinned(fit: Fit) -> Fit:
    """The same fit with the rows of a part of its poses; the fit itself where it has no more than `MANY`."""
    if fit.data.n <= MANY:
        return fit
    part = part_of(fit.data)
    c = fit.evaluation.r.shape[1]
    rows = (part[:, None] * c + np.arange(c)).ravel()
    data = fit.data.take(part)
    ev = fit.evaluation
    return replace(
        fit,
        data=data,
        model=fit.model.at(observations(fit.arm, data)),
        evaluation=Evaluation(ev.r[part], ev.J[part], ev.twist[part], ev.Jq[part]),
        whiten=fit.whiten[part],
        z=fit.z[rows],
        J=fit.J[rows],
        weight=fit.weight[part],
        d2=fit.d2[part],
    )
