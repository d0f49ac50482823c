"""Cross-validated gain of effects beside a model, linear at its fit: cheap enough to try every effect.

Fold by fold the coefficients of the model (DH, frames, effects) and those of an effect are estimated
together by ridge regression with their priors from the other folds, and predict the fold (Hastie,
Tibshirani, Friedman, The Elements of Statistical Learning, 2nd ed., sections 3.4 and 7.10).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..data.measurements import Measurements
from ..fit.columns import Columns
from ..fit.least_squares import Fit
from ..numerics.types import Array, Indices, Mask, array

FOLDS, _DRAWS = 8, 3  # folds, and how often poses are shared out anew: less depends on luck
_GROSS = 0.1  # robust weight below which a pose tells nothing about what predicts better
_WIDTH = 10.0  # prior sigmas of an effect, as in a fit


def folds(data: Measurements, count: int = FOLDS, draw: int = 0) -> NDArray[np.int_]:
    """(N,) number of the fold of each pose, drawn at random but always alike; replicates stay together."""
    groups = data.replicate if data.replicate is not None else np.arange(data.n)
    _, number = np.unique(groups, return_inverse=True)
    drawn = np.random.default_rng(4 + draw).permutation(int(number.max()) + 1) % count
    fold: NDArray[np.int_] = drawn[number]
    return fold


def stretches(data: Measurements, count: int) -> NDArray[np.int_]:
    """(N,) number of the stretch of the session in which each pose was measured; all have as many poses."""
    place = np.arange(data.n)
    if data.t_s is not None:
        place[np.argsort(data.t_s, kind="stable")] = np.arange(data.n)
    stretch: NDArray[np.int_] = place * count // data.n
    return stretch


def predicted(fit: Fit, fold: Indices, beside: Array | None = None) -> Array:
    """(N, c) residuals [m, rad] of the poses of a fit, each fold (N,) predicted by the others: linear at the
    fit, with its weights and priors. beside: whitened columns (N c, m) of an effect that the model lacks."""
    n, c = fit.evaluation.r.shape
    a = fit.J * fit.sigma_prior / fit.scale
    if beside is not None:
        a = np.hstack([a, beside * (_WIDTH / fit.scale)])
    y = (fit.z + fit.J @ fit.estimate) / fit.scale
    root, fold = np.repeat(np.sqrt(fit.weight), c), np.repeat(fold, c)
    left = np.zeros(n * c)
    for k in np.unique(fold):
        fitted = fold != k
        rows = np.vstack([a[fitted] * root[fitted, None], np.eye(a.shape[1])])
        right = np.concatenate([y[fitted] * root[fitted], np.zeros(a.shape[1])])
        basis, triangle = np.linalg.qr(rows)
        left[~fitted] = y[~fitted] - a[~fitted] @ np.linalg.solve(triangle, basis.T @ right)
    whitened = fit.scale * left.reshape(n, c, 1)
    return array(np.linalg.solve(fit.whiten, whitened)[:, :, 0])


@dataclass(frozen=True)
class Losses:
    """Cross-validated squared distances of each pose in units of the noise, 0 for gross outliers.

    model: (N,) of the model alone; effects: (k, N) with each effect beside it.
    """

    model: Array
    effects: Array

    @property
    def gain(self) -> Array:
        """(k,) share of the RMS distance that each effect takes away."""
        left = self.effects.sum(axis=1) / max(float(self.model.sum()), 1e-300)
        gain: Array = 1.0 - np.sqrt(left)
        return gain

    @property
    def sigmas(self) -> Array:
        """(k,) that gain over its standard error, from the differences pose by pose."""
        return _sigmas(self.model - self.effects)

    def behind(self, best: int) -> Array:
        """(k,) by how many standard errors each effect predicts worse than one of them."""
        return _sigmas(self.effects - self.effects[best])


def _sigmas(differences: Array) -> Array:
    """(k,) sums of rows (k, N) over the standard errors of those sums."""
    spread = differences.std(axis=1) * np.sqrt(differences.shape[1])
    sigmas: Array = differences.sum(axis=1) / np.maximum(spread, 1e-12)
    return sigmas


def cross_validate(fit: Fit, columns: Columns, blocks: Sequence[Array]) -> Losses:
    """Losses of the model of a fit, and with each of some effects; blocks: their columns (rows, m)."""
    validation = _Validation.of(fit, columns, blocks)
    model, effects = np.zeros(columns.n), np.zeros((len(blocks), columns.n))
    for held in _turns(fit.data):
        alone, with_each = validation.losses(held)
        model[held] += alone
        effects[:, held] += with_each
    kept = np.where(columns.weight < _GROSS, 0.0, 1.0 / columns.weight) / _DRAWS
    return Losses(model * kept, effects * kept)


def _turns(data: Measurements) -> Iterator[Mask]:
    """(N,) poses that are held out together, every pose once in each draw."""
    for draw in range(_DRAWS):
        fold = folds(data, draw=draw)
        yield from (fold == k for k in np.unique(fold))


@dataclass(frozen=True)
class _Validation:
    """Rows of all poses in units of noise and priors: a (rows, k) of the model, y (rows,) what it and the
    effects explain, g (rows, m) columns of all effects side by side; ends: where each begins and ends."""

    c: int
    a: Array
    y: Array
    g: Array
    ends: tuple[tuple[int, int], ...]

    @classmethod
    def of(cls, fit: Fit, columns: Columns, blocks: Sequence[Array]) -> _Validation:
        """The rows of a fit, robustly weighted."""
        last = np.cumsum([block.shape[1] for block in blocks])
        first = [0, *last[:-1]]
        return cls(
            columns.c,
            columns.weighted(fit.J) * fit.sigma_prior / fit.scale,
            columns.weighted(fit.z + fit.J @ fit.estimate) / fit.scale,
            np.hstack(blocks) * (_WIDTH / fit.scale),
            tuple((int(i), int(j)) for i, j in zip(first, last, strict=True)),
        )

    def losses(self, held: Mask) -> tuple[Array, Array]:
        """(M,) and (k, M) squared distances of the held-out poses, everything fitted to the others.

        The model is eliminated by an orthogonal basis of its columns with their priors: normal equations
        would lose the digits that frames and DH errors which act alike leave (gains to 1e-4 only).
        """
        out = np.repeat(held, self.c)
        a, y, g = self.a[~out], self.y[~out], self.g[~out]
        basis, triangle = np.linalg.qr(np.vstack([a, np.eye(a.shape[1])]))
        basis = basis[: len(a)]
        known, shared = basis.T @ y, basis.T @ g
        predicted = np.linalg.solve(triangle.T, self.a[out].T).T
        left = self.y[out] - predicted @ known
        moved = self.g[out] - predicted @ shared
        score = g.T @ y - shared.T @ known
        effects = [left - moved[:, i:j] @ _ridge(g[:, i:j], shared[:, i:j], score[i:j]) for i, j in self.ends]
        return self._by_pose(left), np.array([self._by_pose(e) for e in effects])

    def _by_pose(self, rows: Array) -> Array:
        """(M,) squares of rows (M c,), summed pose by pose."""
        squares: Array = (rows.reshape(-1, self.c) ** 2).sum(axis=1)
        return squares


def _ridge(g: Array, shared: Array, score: Array) -> Array:
    """(m,) coefficients of one effect; shared: the part (k, m) of its columns that the model takes away."""
    return array(np.linalg.solve(g.T @ g - shared.T @ shared + np.eye(g.shape[1]), score))
