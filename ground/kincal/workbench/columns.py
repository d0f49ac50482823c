"""Whitened design columns at a fit: what each hypothesis or map cell would do to the residuals."""

from __future__ import annotations

import numpy as np

from .basis import Basis
from .effects import Hypothesis, Term
from .fit import Fit


class Columns:
    """Columns of correction terms, linearised at a fit, in whitened and robustly weighted rows.

    rows: the square root of the pose weight times the whitener; every matrix here has N c rows,
    pose by pose.
    """

    def __init__(self, fit: Fit, weight: np.ndarray | None = None):
        self.fit = fit
        self.n, self.c = fit.evaluation.r.shape
        self.weight = fit.weight if weight is None else weight
        self._root = np.sqrt(self.weight)
        rows = fit.whiten * self._root[:, None, None]
        # (N, 72, c): what one unit of each frame component does to the whitened residual
        self.twist = np.einsum("nij,nfj->nfi", rows, fit.evaluation.twist)
        self._values: dict[Basis, np.ndarray] = {}

    def rows_of(self, per_pose: np.ndarray) -> np.ndarray:
        """(N, c) -> (N c,)"""
        return per_pose.reshape(self.n * self.c)

    def weighted(self, rows: np.ndarray) -> np.ndarray:
        """Apply the pose weights to rows that are whitened only."""
        shape = rows.shape
        scaled = rows.reshape(self.n, self.c, -1) * self._root[:, None, None]
        return scaled.reshape(shape)

    def basis(self, basis: Basis) -> np.ndarray:
        """(N,) values of a basis by flight's code, remembered."""
        if basis not in self._values:
            self._values[basis] = self.fit.chain.basis_values(basis)
        return self._values[basis]

    def term(self, term: Term) -> np.ndarray:
        value = term.gain * self.basis(term.basis[0])
        if term.basis[1].var != "1":
            value = value * self.basis(term.basis[1])
        return self.twist[:, term.frame * 6 + term.comp, :] * value[:, None]

    def hypothesis(self, hypothesis: Hypothesis) -> np.ndarray:
        """(N c, m) columns, each scaled by its prior sigma."""
        out = np.empty((self.n * self.c, len(hypothesis.parameters)))
        for k, parameter in enumerate(hypothesis.parameters):
            column = np.zeros((self.n, self.c))
            for term in parameter.terms:
                column += self.term(term)
            out[:, k] = parameter.sigma * self.rows_of(column)
        return out

    def locus(self, frame: int, components: tuple[int, ...]) -> np.ndarray:
        """(N, m, c) twist rows of some components at a frame."""
        return self.twist[:, [frame * 6 + k for k in components], :]
