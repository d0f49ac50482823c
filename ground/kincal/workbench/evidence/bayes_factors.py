"""Evidence for hypotheses with the DH errors and the noise scale marginalised (METHOD.md 12, 13).

Everything here works on whitened rows: z residuals, J columns of the nuisance parameters (DH, base,
tool) scaled by their prior sigma, G columns of a hypothesis scaled by theirs. No arm, no files.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..numerics.distributions import chi2_tail
from ..numerics.types import Array, Indices, array

# Sizes of an effect in units of its typical size, and their weights. The large ones are rare, but
# without them a gross effect would be beyond what its own prior allows, and any looser shape would win.
LAMBDAS = np.array([0.3, 1.0, 3.0, 10.0, 30.0])
LAMBDA_WEIGHTS = np.array([1.0, 1.0, 1.0, 0.1, 0.03])
LN_SCALE_SIGMA = 0.25
_SMALLEST = 1e-300
_FACTORS = 8  # of one product: far below overflow even if each is 1e30
_TOGETHER = 64  # blocks
_LN_ROUNDING = 45.0  # e^-45 is 3e-20
_RANK_TOLERANCE = 1e-9  # of the largest variance: components below say nothing


@dataclass(frozen=True)
class Projector:
    """W = I - J (J'J + B^-1)^-1 J' for columns already scaled to unit prior (B = I).

    basis: (rows, k) left singular vectors of J; shrink: (k,) s^2 / (1 + s^2).
    """

    basis: Array
    shrink: Array

    @classmethod
    def of(cls, columns: Array) -> Projector:
        """The projector that takes out columns (rows, k)."""
        u, s, _ = np.linalg.svd(columns, full_matrices=False)
        return cls(u, s**2 / (1.0 + s**2))

    def apply(self, x: Array) -> Array:
        """W x, for a vector (rows,) or a matrix of columns (rows, m)."""
        ux = self.basis.T @ x
        out: Array = x - self.basis @ (self.shrink[:, None] * ux if ux.ndim == 2 else self.shrink * ux)
        return out

    def gram(self, own: Array, seen: Array) -> Array:
        """(k, m, m) G'WG of k blocks, from G'G and seen (k, m, basis) G'basis."""
        grams: Array = own - (seen * self.shrink) @ seen.transpose(0, 2, 1)
        return grams

    @cached_property
    def squared(self) -> Projector:
        """W W."""
        return Projector(self.basis, self.shrink * (2.0 - self.shrink))

    @property
    def spent(self) -> float:
        """Degrees of freedom the nuisance parameters took."""
        return float(self.shrink.sum())


@dataclass(frozen=True)
class NoiseScale:
    """Grid over the true noise in units of the stated one, with its posterior weight under 'none'.

    s, ln_weight: (g,). Weights are kept as logarithms: a large effect makes the true scale all but
    impossible under 'none', and it is just there that its Bayes factor is large.
    """

    s: Array
    ln_weight: Array

    @property
    def weight(self) -> Array:
        """(g,) posterior weights, sum 1."""
        return np.exp(self.ln_weight)

    @property
    def mean(self) -> float:
        """Posterior mean of the scale."""
        return float((self.s * self.weight).sum())

    @classmethod
    def posterior(cls, wz: float, dof: float, *, stated: bool = True) -> NoiseScale:
        """wz = z'Wz; stated: ln s ~ N(0, 0.25^2), else a wide prior about the fitted scale."""
        if stated:
            # far up too: before a gross effect is found, all that is left must count as noise
            ln_s = np.linspace(-1.0, 2.5, 71)
            ln_prior = -0.5 * (ln_s / LN_SCALE_SIGMA) ** 2
        else:
            ln_s = 0.5 * np.log(max(wz, 1e-12) / max(dof, 1.0)) + np.linspace(-2.0, 0.5, 51)
            ln_prior = np.zeros_like(ln_s)
        ln_w = ln_prior - dof * ln_s - 0.5 * wz / np.exp(2.0 * ln_s)
        return cls(np.exp(ln_s), ln_w - np.logaddexp.reduce(ln_w))


def ln_bayes_factor(
    u: Array, v: Array, noise: NoiseScale, lambdas: Array = LAMBDAS, weights: Array = LAMBDA_WEIGHTS
) -> Array:
    """ln BF against 'none' (...,), averaged over effect size (lambda, by weight) and noise scale.

    u: (..., m) and v: (..., m): rotated score E'P^1/2 U and its variances (METHOD.md 13).
    Components with v = 0 add nothing.
    """
    # components first: sums and products over them are then sums of whole arrays
    u, v = (np.moveaxis(x, -1, 0)[..., None] for x in (u, v))
    shares = weights / np.sum(weights)
    chi2 = np.where(v > 0, u**2 / np.where(v > 0, v, 1.0), 0.0)
    noise = _that_matters(noise, chi2, v, float(lambdas[0]), float(shares[0]))
    s2 = noise.s**2
    per_s2, chi2 = v / s2, chi2 / s2
    out = np.full(u.shape[1:-1], -np.inf)
    for lam, share in zip(lambdas, shares, strict=True):
        x = lam**2 * per_s2
        grown = 1.0 + x
        x /= grown
        x *= chi2
        ln_bf = 0.5 * (x.sum(axis=0) - _ln_product(grown))
        out = np.logaddexp(out, np.log(share) + np.logaddexp.reduce(ln_bf + noise.ln_weight, axis=-1))
    return out


def _that_matters(noise: NoiseScale, chi2: Array, v: Array, lam: float, share: float) -> NoiseScale:
    """The part of the grid from which the factors of some effects come, all but a rounding error of each.

    Nowhere is an effect of any size worth more than half its chi^2; where that is largest, an effect of one
    size lam, with its share, is worth this less. chi2, v: (m, ..., 1), of noise 1."""
    most = noise.ln_weight + 0.5 * chi2.sum(axis=0) / noise.s**2
    s2 = noise.s[most.argmax(axis=-1)][..., None] ** 2
    grown = 1.0 + lam**2 * v / s2
    less = 0.5 * (chi2 / s2 / grown + np.log(grown)).sum(axis=0) - np.log(share)
    enough = most > most.max(axis=-1, keepdims=True) - less - _LN_ROUNDING
    matters = enough.reshape(-1, len(noise.s)).any(axis=0)
    return NoiseScale(noise.s[matters], noise.ln_weight[matters])


def _ln_product(x: Array) -> Array:
    """ln of the product over the first axis, of a few factors at a time: fewer logarithms, no overflow."""
    parts = [x[k : k + _FACTORS].prod(axis=0) for k in range(0, len(x), _FACTORS)]
    return array(np.sum(np.log(parts), axis=0))


@dataclass(frozen=True)
class Score:
    """Score of one hypothesis of m parameters, rotated to independent components.

    u: (m,) scores; v: (m,) their variances; absorbed: share of the effect that the nuisance parameters
    can imitate; rank: parameters of the effect that the data say anything about; chi2: U' V^+ U, chi^2 with
    `rank` degrees of freedom if there is no effect.
    """

    u: Array
    v: Array
    absorbed: float
    chi2: float
    rank: int


@dataclass(frozen=True)
class Scores:
    """Those of k hypotheses of m parameters each: u, v (k, m), absorbed, chi2, rank (k,)."""

    u: Array
    v: Array
    absorbed: Array
    chi2: Array
    rank: Indices

    def each(self) -> Iterator[Score]:
        """One by one."""
        numbers = (x.tolist() for x in (self.absorbed, self.chi2, self.rank))
        return map(Score, self.u, self.v, *numbers)


@dataclass(frozen=True)
class Moments:
    """What scores need of k blocks of columns G: places (k,) of them in a list, own (k, m, m) G'G, and cross
    (k, m, d) G'C for some columns C."""

    places: Sequence[int]
    own: Array
    cross: Array


def block_moments(blocks: Sequence[Array], columns: Array) -> Iterator[Moments]:
    """Moments of blocks (rows, m) with columns (rows, d), those of one width together."""
    same: dict[int, list[int]] = {}
    for k, block in enumerate(blocks):
        same.setdefault(block.shape[1], []).append(k)
    for places in same.values():
        for some in (places[k : k + _TOGETHER] for k in range(0, len(places), _TOGETHER)):
            g = np.stack([blocks[k].T for k in some])
            cross = (g.reshape(-1, g.shape[2]) @ columns).reshape(*g.shape[:2], -1)
            yield Moments(some, g @ g.transpose(0, 2, 1), cross)


def together(moments: Iterable[Moments]) -> Iterator[Moments]:
    """The same in fewer parts, each of one width and small enough for the cache, or as it came."""
    same: dict[int, list[Moments]] = {}
    for one in moments:
        width = one.own.shape[1]
        waiting = same.setdefault(width, [])
        if sum(len(x.places) for x in waiting) + len(one.places) > _TOGETHER and waiting:
            yield _joined(same.pop(width))
            waiting = same.setdefault(width, [])
        waiting.append(one)
    yield from map(_joined, same.values())


def _joined(some: Sequence[Moments]) -> Moments:
    if len(some) == 1:
        return some[0]
    places = [k for one in some for k in one.places]
    return Moments(places, *(np.concatenate([getattr(x, name) for x in some]) for name in ("own", "cross")))


def scores(own: Array, gram: Array, u: Array) -> Scores:
    """Scores of k blocks of one width: G'G, G'WG (k, m, m) and u = G'W z0 (k, m), G scaled by prior sigma."""
    v, e = np.linalg.eigh(gram)
    raw = np.trace(own, axis1=1, axis2=2)
    left = v.sum(axis=1)
    v = np.maximum(v, 0.0)
    largest = np.maximum(v.max(axis=1, initial=0.0, keepdims=True), _SMALLEST)
    v = np.where(v > 1e-12 * largest, v, 0.0)
    rotated = (e.transpose(0, 2, 1) @ u[:, :, None])[:, :, 0]
    absorbed = 1.0 - np.where(raw > 0, left / np.where(raw > 0, raw, 1.0), 0.0)
    good = v > _RANK_TOLERANCE * largest
    chi2 = np.where(good, rotated**2 / np.where(good, v, 1.0), 0.0).sum(axis=1)
    return Scores(rotated, v, absorbed, chi2, good.sum(axis=1))


def flat_p(chi2: float, rank: int) -> float:
    """Tail probability of a score test; 1 where the data say nothing about the effect."""
    return float(chi2_tail(chi2, rank)) if rank else 1.0


def softmax(ln_bf: Mapping[str, float], prior: Mapping[str, float]) -> dict[str, float]:
    """Posterior of ln prior + ln BF by name; names of prior 0 are left out, 'none' has ln BF 0."""
    names = [name for name in prior if prior[name] > 0]
    ln_p = np.array([np.log(prior[name]) + ln_bf.get(name, 0.0) for name in names])
    p = np.exp(ln_p - ln_p.max())
    p /= p.sum()
    return dict(zip(names, (float(x) for x in p), strict=True))
