"""A Gaussian process that is the sum of many, each with a variance of its own.

Residuals of N poses with c components are nuisance + components + noise. A component is an error at a place
of the chain that is an unknown function of something: its covariance is the geometry of the place times the
function's kernel, of low rank (features, such as those of a cell of the map) or dense (smooth in many
variables at once). The variances are those of greatest likelihood (METHOD.md 18).

Covariances are never made of columns: all that one place needs of the inverse is one number for each pair of
poses, which serves all its kernels. Rows of some poses are ordered component by component.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from ..numerics.types import Array, Indices, array

_ITERATIONS = 8
_FIRST_SHARE = 0.3  # of the rows' variance, all components together, before the first iteration
_NEGLIGIBLE = 1e-4  # of the noise variance: a component that small is switched off
_NUISANCE_NOISE = 0.8  # of the rows' variance: noise in a fit of the nuisance parameters alone


@dataclass(frozen=True)
class Place:
    """Components at one place: covariance (rows rows') times a kernel each. rows: (N c, m); features: (N, p),
    group: (p,): the kernels of low rank are F F' of the features of one group; kernels: (k, N, N) the dense
    ones. Those of low rank come first."""

    rows: Array
    features: Array
    group: Indices
    kernels: Array

    @property
    def low(self) -> int:
        """Number of kernels of low rank."""
        return int(self.group.max(initial=-1)) + 1

    @property
    def count(self) -> int:
        """Number of components."""
        return self.low + len(self.kernels)


@dataclass(frozen=True)
class Variances:
    """component: (T,), low-rank ones first; noise: of one row."""

    component: Array
    noise: float


@dataclass(frozen=True)
class Fitted:
    """A process fitted to some poses; weights: (rows,) K^-1 y."""

    poses: Indices
    variances: Variances
    weights: Array


@dataclass(frozen=True)
class Components:
    """The process at N poses of c components, rows pose by pose.

    y: (N c,) residuals; nuisance: (N c, k) columns times their prior sigmas; places: of the components;
    names: (T,) of the components, place by place.
    """

    c: int
    y: Array
    nuisance: Array
    places: tuple[Place, ...]
    names: tuple[str, ...]

    def rows(self, poses: Indices) -> Indices:
        """Rows of some poses, component by component: kernels then multiply long runs of them."""
        return (poses * self.c + np.arange(self.c)[:, None]).ravel()

    def between(self, at: Indices, of: Indices) -> Between:
        """The process between the rows of poses `at` and those of poses `of`."""
        a, b = self.rows(at), self.rows(of)
        # several places share their kernels
        kernels = {id(p.kernels): p.kernels[:, at[:, None], of] for p in self.places}
        mine = self.nuisance[a]
        return Between(
            (self.c, len(at), self.c, len(of)),
            mine,
            mine if at is of else self.nuisance[b],  # of the same array: half the work
            tuple(
                _Pairs(p, p.rows[a], p.rows[b], p.features[at], p.features[of], kernels[id(p.kernels)])
                for p in self.places
            ),
        )

    def fit(self, poses: Indices, variances: Variances | None = None) -> Fitted:
        """The process given the rows of some poses; variances: found before, else fitted to these rows."""
        y, between = self.y[self.rows(poses)], self.between(poses, poses)
        if variances is None:
            variances = _greatest_likelihood(between, y)
        _, weights = _inverse(between, y, variances)
        return Fitted(poses, variances, weights)

    def predict(self, fitted: Fitted, at: Indices) -> Array:
        """(rows,) mean of the process at other poses."""
        between = self.between(at, fitted.poses)
        return array(between.covariance(fitted.variances.component) @ fitted.weights)

    def nuisance_alone(self, poses: Indices, at: Indices) -> Array:
        """(rows,) what the nuisance parameters alone, fitted to some poses, predict at others."""
        a, y = self.nuisance[self.rows(poses)], self.y[self.rows(poses)]
        inner = a.T @ a + _NUISANCE_NOISE * y.var() * np.eye(a.shape[1])
        return array(self.nuisance[self.rows(at)] @ np.linalg.solve(inner, a.T @ y))


@dataclass(frozen=True)
class _Pairs:
    """A place between A and B poses: what it has of the ones (`_a`) and of the others; kernels: (k, A, B)."""

    place: Place
    rows_a: Array
    rows_b: Array
    features_a: Array
    features_b: Array
    kernels: Array

    @property
    def geometry(self) -> Array:
        """(rows, rows) what the kernels are multiplied with."""
        return array(self.rows_a @ self.rows_b.T)

    def kernel(self, variance: Array) -> Array:
        """(A, B) sum of the kernels, each with its variance."""
        low, dense = variance[: self.place.low], variance[self.place.low :]
        out = (self.features_a * low[self.place.group]) @ self.features_b.T
        if dense.any():
            out += np.tensordot(dense, self.kernels, 1)
        return array(out)

    def sums(self, weight: Array) -> Array:
        """(count,) of each kernel the sum of its elements times weights (A, B)."""
        each = (self.features_a * (weight @ self.features_b)).sum(axis=0)
        low = np.bincount(self.place.group, each, self.place.low)
        return np.concatenate([low, np.tensordot(self.kernels, weight)])


@dataclass(frozen=True)
class Between:
    """The process between A and B poses of c components. shape: (c, A, c, B)."""

    shape: tuple[int, int, int, int]
    nuisance_a: Array
    nuisance_b: Array
    pairs: tuple[_Pairs, ...]

    def covariance(self, variance: Array) -> Array:
        """(rows, rows) without noise."""
        out = array(self.nuisance_a @ self.nuisance_b.T)
        blocks, start = out.reshape(self.shape), 0
        for pairs in self.pairs:
            part = variance[start : start + pairs.place.count]
            start += pairs.place.count
            if part.any():
                one = pairs.geometry.reshape(self.shape)
                one *= pairs.kernel(part)[:, None, :]
                blocks += one
        return out

    def squares(self, inverse: Array, weights: Array) -> tuple[Array, Array]:
        """(T,) y'K^-1 K_i K^-1 y and tr(K^-1 K_i) of every component."""
        c, n, _, _ = self.shape
        found, expected = [], []
        for pairs in self.pairs:
            moments = (pairs.rows_a * weights[:, None]).reshape(c, n, -1).sum(axis=0)
            weighed = pairs.geometry
            weighed *= inverse
            found.append(pairs.sums(moments @ moments.T))
            expected.append(pairs.sums(weighed.reshape(self.shape).sum(axis=(0, 2))))
        return np.concatenate(found), np.concatenate(expected)


def _inverse(between: Between, y: Array, variances: Variances) -> tuple[Array, Array]:
    """K^-1 and K^-1 y of the rows of some poses."""
    k = between.covariance(variances.component)
    k.flat[:: len(y) + 1] += variances.noise
    lower, _ = lapack.dpotrf(k, lower=1, clean=1, overwrite_a=1)
    half, _ = lapack.dpotri(lower, lower=1, overwrite_c=1)
    inverse = array(half + half.T)
    inverse.flat[:: len(y) + 1] *= 0.5
    return inverse, inverse @ y


def _greatest_likelihood(between: Between, y: Array) -> Variances:
    """Each variance times y'K^-1 K_i K^-1 y / tr(K^-1 K_i), a factor that is 1 where the derivative of
    the likelihood vanishes (MacKay, Neural Comput. 4(3), 1992). Its square root never lowers the
    likelihood (Zhou et al., J. Comput. Graph. Stat. 28(2), 2019) but takes twice the steps."""
    count, total = sum(pairs.place.count for pairs in between.pairs), max(float(y.var()), 1e-30)
    component, noise = np.full(count, _FIRST_SHARE * total / count), (1.0 - _FIRST_SHARE) * total
    for _ in range(_ITERATIONS):
        inverse, weights = _inverse(between, y, Variances(component, noise))
        found, expected = between.squares(inverse, weights)
        component = component * found / np.maximum(expected, 1e-300)
        noise *= float(weights @ weights) / float(np.trace(inverse))
        component = np.where(component > _NEGLIGIBLE * noise, component, 0.0)
    return Variances(component, noise)
