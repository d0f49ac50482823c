"""A Gaussian process that is the sum of many, each with a variance of its own.

Residuals of N poses with c components are nuisance + components + noise. A component is low-rank (columns,
such as those of a cell of the map) or dense (an error at a place of the chain that is a smooth function of
many variables at once). The variances are those of greatest likelihood (METHOD.md 18).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from .types import Array, Indices, Mask, array

_ITERATIONS = 8
_FIRST_SHARE = 0.3  # of the rows' variance, all components together, before the first iteration
_NEGLIGIBLE = 1e-4  # of the noise variance: a component that small is switched off
_NUISANCE_NOISE = 0.8  # of the rows' variance: noise in a fit of the nuisance parameters alone


@dataclass(frozen=True)
class Place:
    """Dense components at one place: covariance (rows rows') times a kernel. rows: (N c, m); kernels:
    (k, N, N)."""

    rows: Array
    kernels: Array


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

    y: (N c,) residuals; nuisance: (N c, k) columns times their prior sigmas; columns: (N c, p) of the
    low-rank components, group: (p,) the component of each; places: the dense ones; names: (T,).
    """

    c: int
    y: Array
    nuisance: Array
    columns: Array
    group: Indices
    places: tuple[Place, ...]
    names: tuple[str, ...]

    @property
    def low(self) -> int:
        """Number of low-rank components."""
        return len(self.names) - sum(len(place.kernels) for place in self.places)

    def rows(self, poses: Indices) -> Indices:
        """Rows of some poses."""
        return (poses[:, None] * self.c + np.arange(self.c)).ravel()

    def cross(self, at: Indices, of: Indices, variance: Array) -> Array:
        """Covariance of the rows of poses `at` with those of poses `of`, without noise."""
        a, b = self.rows(at), self.rows(of)
        live = self._live(variance)
        sigma = np.sqrt(variance[self.group[live]])
        mine = self.columns[np.ix_(a, live)] * sigma
        other = mine if at is of else self.columns[np.ix_(b, live)] * sigma  # the same array: half the work
        out = self.nuisance[a] @ self.nuisance[b].T + mine @ other.T
        blocks = out.reshape(len(at), self.c, len(of), self.c)
        for place, part in self._dense(variance):
            if part.any():
                kernel = np.tensordot(part, place.kernels[:, at[:, None], of], 1)
                geometry = (place.rows[a] @ place.rows[b].T).reshape(blocks.shape)
                blocks += geometry * kernel[:, None, :, None]
        return array(out)

    def _live(self, variance: Array) -> Mask:
        """(p,) columns whose component is not switched off."""
        live: Mask = variance[self.group] > 0
        return live

    def _dense(self, variance: Array) -> Iterator[tuple[Place, Array]]:
        """Each place with the variances of its kernels."""
        start = self.low
        for place in self.places:
            yield place, variance[start : start + len(place.kernels)]
            start += len(place.kernels)

    def fit(self, poses: Indices, variances: Variances | None = None) -> Fitted:
        """The process given the rows of some poses; variances: found before, else fitted to these rows."""
        y = self.y[self.rows(poses)]
        if variances is None:
            variances = self._greatest_likelihood(poses, y)
        _, weights = self._inverse(poses, y, variances)
        return Fitted(poses, variances, weights)

    def predict(self, fitted: Fitted, at: Indices) -> Array:
        """(rows,) mean of the process at other poses."""
        return array(self.cross(at, fitted.poses, fitted.variances.component) @ fitted.weights)

    def nuisance_alone(self, poses: Indices, at: Indices) -> Array:
        """(rows,) what the nuisance parameters alone, fitted to some poses, predict at others."""
        a, y = self.nuisance[self.rows(poses)], self.y[self.rows(poses)]
        inner = a.T @ a + _NUISANCE_NOISE * y.var() * np.eye(a.shape[1])
        return array(self.nuisance[self.rows(at)] @ np.linalg.solve(inner, a.T @ y))

    def _inverse(self, poses: Indices, y: Array, variances: Variances) -> tuple[Array, Array]:
        """K^-1 and K^-1 y of the rows of some poses."""
        k = self.cross(poses, poses, variances.component)
        k.flat[:: len(y) + 1] += variances.noise
        lower, _ = lapack.dpotrf(k, lower=1, clean=1, overwrite_a=1)
        half, _ = lapack.dpotri(lower, lower=1)
        inverse = array(half + np.tril(half, -1).T)
        return inverse, inverse @ y

    # ---------------------------------------------------------------------- variances

    def _greatest_likelihood(self, poses: Indices, y: Array) -> Variances:
        """Each variance times y'K^-1 K_i K^-1 y / tr(K^-1 K_i), a factor that is 1 where the derivative of
        the likelihood vanishes (MacKay, Neural Comput. 4(3), 1992). Its square root never lowers the
        likelihood (Zhou et al., J. Comput. Graph. Stat. 28(2), 2019) but takes twice the steps."""
        count, total = len(self.names), max(float(y.var()), 1e-30)
        component, noise = np.full(count, _FIRST_SHARE * total / count), (1.0 - _FIRST_SHARE) * total
        for _ in range(_ITERATIONS):
            inverse, weights = self._inverse(poses, y, Variances(component, noise))
            found, expected = self._squares(poses, inverse, weights, component)
            component = component * found / np.maximum(expected, 1e-300)
            noise *= float(weights @ weights) / float(np.trace(inverse))
            component = np.where(component > _NEGLIGIBLE * noise, component, 0.0)
        return Variances(component, noise)

    def _squares(
        self, poses: Indices, inverse: Array, weights: Array, variance: Array
    ) -> tuple[Array, Array]:
        """(T,) y'K^-1 K_i K^-1 y and tr(K^-1 K_i) of every component."""
        live = self._live(variance)
        u, group = self.columns[np.ix_(self.rows(poses), live)], self.group[live]
        found = [array(np.bincount(group, (weights @ u) ** 2, self.low))]
        expected = [array(np.bincount(group, (u * (inverse @ u)).sum(axis=0), self.low))]
        for place in self.places:
            have, need = self._dense_squares(place, poses, inverse, weights)
            found.append(have)
            expected.append(need)
        return np.concatenate(found), np.concatenate(expected)

    def _dense_squares(
        self, place: Place, poses: Indices, inverse: Array, weights: Array
    ) -> tuple[Array, Array]:
        """`_squares` of the components of one place."""
        n, rows = len(poses), place.rows[self.rows(poses)]
        shape = (n, self.c, n, self.c)
        trace = ((rows @ rows.T) * inverse).reshape(shape).sum(axis=(1, 3))
        moments = (rows * weights[:, None]).reshape(n, self.c, -1).sum(axis=1)
        kernels = place.kernels[:, poses[:, None], poses]
        have, need = np.tensordot(kernels, moments @ moments.T), np.tensordot(kernels, trace)
        return array(have), array(need)
