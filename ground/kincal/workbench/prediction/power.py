"""What these poses can and cannot show: confounding, smallest visible size, and the harm of the unseen."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..evidence.bayes_factors import Projector
from ..fit.columns import Columns
from ..fit.least_squares import Fit
from ..model.effects import Hypothesis
from ..numerics.types import Array

CONFOUNDED_CHI2 = 9.0  # below this these poses cannot distinguish a pair
_NINETY_PERCENT = 10.5  # chi^2 with 1 dof: non-centrality for 90 % power at 5 %


@dataclass(frozen=True)
class Confounding:
    """How well k effects can be distinguished.

    d2: (k, k), [i, j]: how much of effect i no mixture of DH and effect j explains [chi^2]; below
    CONFOUNDED_CHI2 these poses cannot distinguish the pair (METHOD.md 16); absorbed: (k,) share
    of each that the fitted parameters imitate; sizes: that each has, its typical one, in words.
    """

    names: tuple[str, ...]
    d2: Array
    absorbed: Array
    sizes: tuple[str, ...]


@dataclass(frozen=True)
class Harm:
    """smallest: size with 90 % power, in prior sigmas; error_m: what it would do to the tool position
    over the poses after DH has absorbed what it can, RMS."""

    name: str
    smallest: float
    error_m: float


def confounding(fit: Fit, hypotheses: Sequence[Hypothesis]) -> Confounding:
    """d^2(i|j) for every ordered pair of hypotheses, at the poses of a fit."""
    columns, projector = _projected(fit)
    designs = [columns.hypothesis(h) for h in hypotheses]
    projected = [projector.apply(g) for g in designs]
    own = np.array([float((g * wg).sum()) for g, wg in zip(designs, projected, strict=True)])
    whole = np.array([max(float((g**2).sum()), 1e-300) for g in designs])
    shared = np.array([[_shared(gi, wj, gj, fit.scale) for gj, wj in zip(designs, projected, strict=True)]
                       for gi in designs]).reshape(len(own), len(own))  # fmt: skip
    np.fill_diagonal(shared, 0.0)
    d2 = np.maximum((own[:, None] - shared) / fit.scale**2, 0.0)
    names = tuple(h.name for h in hypotheses)
    return Confounding(names, d2, 1.0 - own / whole, tuple(_typical(h) for h in hypotheses))


def _typical(h: Hypothesis) -> str:
    """Typical sizes of an effect's parameters, each once."""
    return ", ".join(dict.fromkeys(_size(p.sigma, p.unit) for p in h.parameters))


def _size(sigma: float, unit: str) -> str:
    """Angles in mrad and lengths in mm, as everywhere in reports."""
    if unit in ("rad", "m"):
        return f"{sigma * 1e3:.3g} m{unit}"
    return f"{sigma:.3g} {unit}".strip()


def _shared(mine: Array, projected: Array, other: Array, scale: float) -> float:
    """What of effect `mine` (rows, m) the effect `other` explains beside DH, times scale^2."""
    inner = other.T @ projected + scale**2 * np.eye(other.shape[1])
    cross = projected.T @ mine
    return float((cross * np.linalg.solve(inner, cross)).sum())


def harm(fit: Fit, hypotheses: Iterable[Hypothesis]) -> tuple[Harm, ...]:
    """What could still be wrong unseen, and how much it would hurt at most. Worst first."""
    columns, projector = _projected(fit)
    plain = Columns(fit, np.ones(len(fit.weight)))
    worst = [
        max(_harms(fit, columns, plain, projector, h), key=lambda x: x.error_m, default=None)
        for h in hypotheses
    ]
    return tuple(sorted((x for x in worst if x is not None), key=lambda x: -x.error_m))


def _harms(fit: Fit, columns: Columns, plain: Columns, projector: Projector, h: Hypothesis) -> Iterator[Harm]:
    """One for each parameter of an effect that the data say anything about."""
    n, c = fit.evaluation.r.shape
    g, whole = columns.hypothesis(h), plain.hypothesis(h)
    left = projector.apply(g)
    for k in range(g.shape[1]):
        signal = float((g[:, k] * left[:, k]).sum()) / fit.scale**2
        if signal <= 1e-9:
            continue
        size = float(np.sqrt(_NINETY_PERCENT / signal))
        rest = whole[:, k] - fit.J @ _absorbed_by_dh(fit, columns, g[:, k])
        error = np.linalg.solve(fit.whiten, rest.reshape(n, c, 1))[:, :3, 0]
        yield Harm(h.name, size, size * float(np.sqrt((error**2).sum(axis=1).mean())))


def _projected(fit: Fit) -> tuple[Columns, Projector]:
    columns = Columns(fit)
    return columns, Projector.of(columns.weighted(fit.J) * fit.sigma_prior)


def _absorbed_by_dh(fit: Fit, columns: Columns, g: Array) -> Array:
    """(k,) the DH (and frame) change that imitates an effect's column (rows,) best, per coefficient."""
    a = columns.weighted(fit.J) * fit.sigma_prior / fit.scale
    inner = a.T @ a + np.eye(a.shape[1])
    change: Array = fit.sigma_prior * np.linalg.solve(inner, a.T @ g) / fit.scale
    return change
