"""Evidence for hypotheses with the DH errors and the noise scale marginalised (docs/DIAGNOSIS.md).

Everything here works on whitened rows: z residuals, J columns of the nuisance parameters (DH, base,
tool) scaled by their prior sigma, G columns of a hypothesis scaled by theirs. No arm, no files.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

# Sizes of an effect in units of its typical size, and their weights. The large ones are rare, but
# without them a gross effect would be beyond what its own prior allows, and any looser shape would win.
LAMBDAS = np.array([0.3, 1.0, 3.0, 10.0, 30.0])
LAMBDA_WEIGHTS = np.array([1.0, 1.0, 1.0, 0.1, 0.03])
LN_SCALE_SIGMA = 0.25


@dataclass(frozen=True)
class Projector:
    """W = I - J (J'J + B^-1)^-1 J' for columns already scaled to unit prior (B = I)."""

    basis: np.ndarray  # (rows, k) left singular vectors of J
    shrink: np.ndarray  # (k,) s^2 / (1 + s^2)

    @classmethod
    def of(cls, columns: np.ndarray) -> Projector:
        u, s, _ = np.linalg.svd(columns, full_matrices=False)
        return cls(u, s**2 / (1.0 + s**2))

    def apply(self, x: np.ndarray) -> np.ndarray:
        """W x, for a vector or a matrix of columns."""
        ux = self.basis.T @ x
        return x - self.basis @ (self.shrink[:, None] * ux if ux.ndim == 2 else self.shrink * ux)

    def grams(self, blocks: np.ndarray) -> np.ndarray:
        """(k, m, m) G'WG of blocks (k, rows, m), without forming W G."""
        k, rows, m = blocks.shape
        seen = (self.basis.T @ blocks.transpose(1, 0, 2).reshape(rows, k * m)).reshape(-1, k, m)
        seen = seen.transpose(1, 0, 2)
        turned = seen.transpose(0, 2, 1) * self.shrink
        return blocks.transpose(0, 2, 1) @ blocks - turned @ seen

    @property
    def spent(self) -> float:
        """Degrees of freedom the nuisance parameters took."""
        return float(self.shrink.sum())


@dataclass(frozen=True)
class NoiseScale:
    """Grid over the true noise in units of the stated one, with its posterior weight under 'none'.

    Weights are kept as logarithms: a large effect makes the true scale all but impossible under
    'none', and it is just there that its Bayes factor is large.
    """

    s: np.ndarray
    ln_weight: np.ndarray

    @property
    def weight(self) -> np.ndarray:
        return np.exp(self.ln_weight)

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
    u: np.ndarray, v: np.ndarray, noise: NoiseScale, lambdas=LAMBDAS, weights=None
) -> np.ndarray:
    """ln BF against 'none', averaged over effect size (lambda) and noise scale.

    u: (..., m) and v: (..., m): rotated score E'P^1/2 U and its variances (diagnosis.md section 4).
    Components with v = 0 add nothing.
    """
    if weights is None:
        weights = LAMBDA_WEIGHTS if lambdas is LAMBDAS else np.ones(len(lambdas))
    s2 = noise.s[:, None] ** 2
    out = np.full(u.shape[:-1], -np.inf)
    for lam, share in zip(lambdas, weights / np.sum(weights), strict=True):
        x = lam**2 * v[..., None, :] / s2
        gain = x / (1.0 + x) * np.where(v > 0, u**2 / np.where(v > 0, v, 1.0), 0.0)[..., None, :] / s2
        ln_bf = 0.5 * (gain - np.log1p(x)).sum(axis=-1)
        out = np.logaddexp(out, np.log(share) + np.logaddexp.reduce(ln_bf + noise.ln_weight, axis=-1))
    return out


@dataclass(frozen=True)
class Score:
    """Score of one hypothesis: rotated to independent components."""

    u: np.ndarray
    v: np.ndarray
    absorbed: float  # share of the effect that the nuisance parameters can imitate

    @property
    def chi2(self) -> float:
        good = self.v > 1e-9 * max(self.v.max(initial=0.0), 1e-300)
        return float((self.u[good] ** 2 / self.v[good]).sum())

    @property
    def rank(self) -> int:
        return int((self.v > 1e-9 * max(self.v.max(initial=0.0), 1e-300)).sum())

    @property
    def p_value(self) -> float:
        """Flat-prior score test, at noise scale 1."""
        return float(stats.chi2.sf(self.chi2, self.rank)) if self.rank else 1.0


def scores(g: np.ndarray, gram: np.ndarray, wz: np.ndarray) -> list[Score]:
    """Scores of blocks of one width: g (k, rows, m) scaled by prior sigma; gram (k, m, m) G'WG; wz = W z0."""
    u = g.transpose(0, 2, 1) @ wz
    v, e = np.linalg.eigh(gram)
    raw = (g**2).sum(axis=(1, 2))
    left = v.sum(axis=1)
    v = np.maximum(v, 0.0)
    v = np.where(v > 1e-12 * np.maximum(v.max(axis=1, initial=0.0, keepdims=True), 1e-300), v, 0.0)
    rotated = (e.transpose(0, 2, 1) @ u[:, :, None])[:, :, 0]
    absorbed = 1.0 - np.where(raw > 0, left / np.where(raw > 0, raw, 1.0), 0.0)
    return [Score(rotated[k], v[k], float(absorbed[k])) for k in range(len(g))]


def score(columns: np.ndarray, projected: np.ndarray, wz: np.ndarray) -> Score:
    """columns G (rows, m) scaled by prior sigma; projected W G; wz = W z0."""
    return scores(columns[None], (columns.T @ projected)[None], wz)[0]


def posterior(ln_bf: dict[str, float], prior: dict[str, float]) -> dict[str, float]:
    """Softmax of ln prior + ln BF; keys as given ('none' has ln BF 0)."""
    names = [name for name in prior if prior[name] > 0]
    ln_p = np.array([np.log(prior[name]) + ln_bf.get(name, 0.0) for name in names])
    p = np.exp(ln_p - ln_p.max())
    p /= p.sum()
    return dict(zip(names, (float(x) for x in p), strict=True))
