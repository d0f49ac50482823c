"""Whitened design columns at a fit: what each hypothesis or map cell would do to the residuals."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from kincal_shared.schema.names import VARIABLES
from kincal_shared.schema.terms import Basis

from ..data.measurements import Measurements
from ..model.effects import Hypothesis, Parameter, Term
from ..numerics.types import Array
from .least_squares import Fit

# Variables whose values depend on the coefficients: gravity loads, and where the model expects the tool.
_MODELLED = frozenset(name for name, of in VARIABLES.items() if of.modelled)
_VARIES = 1e-3  # standard deviation of a torque over its largest value
_LEAST_TORQUE = 1e-5  # of the arm's largest: less is what DH errors make of masses on the axis of a joint


@lru_cache(maxsize=8)
def _recorded_values(_data: Measurements) -> dict[Basis, Array]:
    """Memory of a data set."""
    return {}


class Columns:
    """Columns of correction terms, linearised at a fit, in whitened and robustly weighted rows.

    Each pose is weighted by the square root of `weight` (default: the fit's). N poses of c components;
    every matrix here has N c rows, pose by pose. twist: (N, frames, 6, c), what one unit of each
    twist component at each frame does to the whitened residual.
    """

    def __init__(self, fit: Fit, weight: Array | None = None):
        self.fit = fit
        self.n, self.c = fit.evaluation.r.shape
        self.weight = fit.weight if weight is None else weight
        self._root = np.sqrt(self.weight)
        rows = fit.whiten * self._root[:, None, None]
        self.twist = fit.evaluation.twist @ rows.transpose(0, 2, 1)[:, None]
        self._by_place = np.ascontiguousarray(self.twist.reshape(self.n, -1, self.c).transpose(1, 0, 2))
        self._modelled: dict[Basis, Array] = {}

    def weighted(self, rows: Array) -> Array:
        """Rows (N c,) or (N c, m) that are whitened only, with the pose weights applied."""
        scaled: Array = rows.reshape(self.n, self.c, -1) * self._root[:, None, None]
        return scaled.reshape(rows.shape)

    def basis(self, basis: Basis) -> Array:
        """(N,) values of a basis by flight's code, remembered: those that are read from the data for the data
        set, those that the model computes (torques, where the tool is) for these columns."""
        memory = self._modelled if basis.var in _MODELLED else _recorded_values(self.fit.data)
        if basis not in memory:
            memory[basis] = self.fit.model.basis_values(basis, self.fit.estimate)
        return memory[basis]

    def torques(self) -> dict[int, Array]:
        """(N,) gravity torques [N m] by joint, of those where they vary; none without masses."""
        arm = self.fit.arm
        of_joints = {j: self.basis(Basis("lin", "tau", j)) for j in range(1, arm.n + 1) if arm.has_masses}
        largest = max((np.abs(tau).max() for tau in of_joints.values()), default=0.0)
        return {
            j: tau
            for j, tau in of_joints.items()
            if tau.std() > max(_VARIES * np.abs(tau).max(), _LEAST_TORQUE * largest)
        }

    def term(self, term: Term) -> Array:
        """(N c,) column of one correction term with coefficient 1."""
        column: Array = self._of([term])[0]
        return column

    def hypothesis(self, hypothesis: Hypothesis) -> Array:
        """(N c, m) columns of an effect, each scaled by its prior sigma."""
        return self.hypotheses([hypothesis])[0]

    def hypotheses(self, hypotheses: Sequence[Hypothesis]) -> list[Array]:
        """(N c, m) columns of each effect, all at once; not to be written to. Effects at one joint and the
        same at all of them share their terms: those are computed once."""
        if not hypotheses:
            return []
        keys = [[(id(p.terms), p.sigma) for p in h.parameters] for h in hypotheses]
        each = dict(zip(itertools.chain(*keys), (p for h in hypotheses for p in h.parameters), strict=True))
        rows, place = self._parameters(list(each.values())), {key: k for k, key in enumerate(each)}
        return [_taken(rows, [place[key] for key in some]).T for some in keys]

    def _parameters(self, parameters: Sequence[Parameter]) -> Array:
        """(p, N c) sums of the terms of each parameter, scaled by its prior sigma."""
        counts = np.array([len(p.terms) for p in parameters])
        first = np.cumsum(counts) - counts
        terms = self._of([term for p in parameters for term in p.terms])
        for k in np.flatnonzero(counts > 1):
            terms[first[k]] = terms[first[k] : first[k] + counts[k]].sum(axis=0)
        there = counts > 0
        if there.all():
            rows = _taken(terms, first.tolist())
        else:
            rows = np.zeros((len(parameters), self.n * self.c))
            rows[there] = terms[first[there]]
        rows *= np.array([p.sigma for p in parameters])[:, None]
        return rows

    def _of(self, terms: Sequence[Term]) -> Array:
        """(t, N c) rows of correction terms with coefficient 1."""
        frames = self.twist.shape[1]
        rows: Array = self._by_place[[6 * (t.frame % frames) + t.comp for t in terms]]
        rows *= np.array([self._value(t) for t in terms]).reshape(len(terms), self.n, 1)
        return rows.reshape(len(terms), self.n * self.c)

    def _value(self, term: Term) -> Array:
        """(N,) gain times bases."""
        value: Array = term.gain * self.basis(term.basis[0])
        return value if term.basis[1].var == "1" else value * self.basis(term.basis[1])

    def location(self, frame: int, components: Sequence[int]) -> Array:
        """(N, m, c) twist rows of some components at a frame."""
        rows: Array = self.twist[:, frame, list(components), :]
        return rows


def _taken(rows: Array, places: Sequence[int]) -> Array:
    """Some of the rows; a view where they follow one another."""
    if places and list(places) == list(range(places[0], places[0] + len(places))):
        return rows[places[0] : places[0] + len(places)]
    taken: Array = rows[places]
    return taken
