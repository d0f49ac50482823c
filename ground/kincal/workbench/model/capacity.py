"""What effects take of the room on board, and which to leave out first if it is too little.

The order is that of backward elimination by the fit in M.toml: with estimate m and covariance C of the
coefficients, a fit without the coefficients S, the others fitted anew, has chi^2 larger by
m_S' C_SS^-1 m_S (Wald's statistic, to first order). The effect that loses least for each coefficient goes
first; m and C of the others are then those given that it is zero."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..numerics.types import Array, Indices
from .effects import Hypothesis
from .modelfile import ModelFile, covariance_of


@dataclass(frozen=True)
class Removal:
    """An effect in the order of removal: its coefficients and terms, and the rise of chi^2 when it is
    removed after those before it."""

    name: str
    coefficients: int
    terms: int
    chi2: float

    @property
    def each(self) -> float:
        """Rise of chi^2 for each coefficient."""
        return self.chi2 / self.coefficients


def size(hypotheses: Sequence[Hypothesis]) -> tuple[int, int]:
    """Coefficients and terms of effects."""
    return sum(len(h.parameters) for h in hypotheses), sum(
        len(p.terms) for h in hypotheses for p in h.parameters
    )


def order_of_removal(hypotheses: Sequence[Hypothesis], model: ModelFile) -> list[Removal]:
    """All effects, those first that the poses of the last fit show least for each coefficient. Empty if the
    model holds no fit of these effects."""
    cov = covariance_of(model)
    index = {name: k for k, name in enumerate(model.values)}
    own = {h.name: [index.get(f"{h.name}.{p.name}", -1) for p in h.parameters] for h in hypotheses}
    if cov is None or min((min(rows) for rows in own.values()), default=-1) < 0:
        return []
    # Units differ by orders of magnitude; chi^2 does not depend on them.
    std_err = np.sqrt(np.maximum(np.diag(cov), np.finfo(float).tiny))
    mean = np.array([value for value, _ in model.values.values()]) / std_err
    cov = cov / np.outer(std_err, std_err)
    out: list[Removal] = []
    left = {h.name: h for h in hypotheses}
    while left:
        found = [Removal(n, *size([h]), _rise(mean, cov, np.array(own[n]))) for n, h in left.items()]
        least = min(found, key=lambda removal: removal.each)
        mean, cov = _without(mean, cov, np.array(own[least.name]))
        del left[least.name]
        out.append(least)
    return out


def _rise(mean: Array, cov: Array, own: Indices) -> float:
    return max(0.0, float(mean[own] @ np.linalg.pinv(cov[np.ix_(own, own)], hermitian=True) @ mean[own]))


def _without(mean: Array, cov: Array, own: Indices) -> tuple[Array, Array]:
    """Mean and covariance given that these coefficients are zero."""
    gain = cov[:, own] @ np.linalg.pinv(cov[np.ix_(own, own)], hermitian=True)
    return mean - gain @ mean[own], cov - gain @ cov[own]
