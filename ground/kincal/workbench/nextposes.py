"""The poses that separate competing effects best: multi-response Box-Hill / Meyer-Steinberg-Box criterion.

    MD = sum_{i<j} p_i p_j 1/2 [ tr(V_i V_j^-1 + V_j V_i^-1 - 2I)
                                 + (y_i - y_j)' (V_i^-1 + V_j^-1) (y_i - y_j) ]

greedy over random poses inside the joint limits, each with the levers that the arm has: the approach
direction is chosen, a payload may be taken. After each choice the belief of every effect about its own
parameters is updated by a Kalman step. Meyer, Steinberg, Box, Technometrics 38(4), 1996.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from kincal.errors import CannotAnswer

from .columns import Columns
from .data import Measurements
from .effects import Hypothesis
from .fit import Fit
from .tails import chi2_shifted_tail
from .types import Array, array

_TRIES = 160
_TELLS_APART = 2.0 * np.log(9.0) + 2.0  # chi^2 that moves even odds of two effects to 90 %


@dataclass(frozen=True)
class NextPose:
    """A pose to measure.

    q: joint angles [rad or m]; direction: approach signs, None if the data have none; separates: names
    of the competing effects; power: chance that, with this pose and the ones before it, an effect is
    distinguished from the others at 90 % probability if it is the true one.
    """

    q: tuple[float, ...]
    direction: tuple[int, ...] | None
    separates: tuple[str, ...]
    power: float


@dataclass(frozen=True)
class _Belief:
    """What one effect says of every pose. design: (N, c, k) whitened columns of all coefficients in prior
    sigmas; mean (k,), cov (k, k): of these coefficients."""

    design: Array
    mean: Array
    cov: Array

    def after(self, pose: int) -> _Belief:
        """The belief once a pose is measured (Kalman step; its mean does not matter any more)."""
        a = self.design[pose]
        gain = self.cov @ a.T @ np.linalg.inv(np.eye(len(a)) + a @ self.cov @ a.T)
        return replace(self, cov=self.cov - gain @ a @ self.cov)


def next_poses(
    fit: Fit, effects: Sequence[Hypothesis], *, count: int = 8, tries: int = _TRIES, seed: int = 1
) -> tuple[NextPose, ...]:
    """Poses that separate two or more competing effects, best first.

    fit: of the model that they would join; tries: random poses to choose from, drawn with `seed`.
    CannotAnswer for fewer than two effects.
    """
    if len(effects) < 2:
        raise CannotAnswer("two or more competing effects are needed to separate")
    data = _random_poses(fit, tries, seed)
    beliefs = _beliefs(fit, data, effects)
    names = tuple(h.name for h in effects)
    left = np.ones(tries, dtype=bool)
    total, chosen = 0.0, []
    for _ in range(min(count, tries)):
        md, gap = _criterion(beliefs)
        best = int(np.argmax(np.where(left, md, -np.inf)))
        left[best] = False
        total += gap[best]
        chosen.append(_next_pose(data, best, names, total))
        beliefs = [belief.after(best) for belief in beliefs]
    return tuple(chosen)


def _next_pose(data: Measurements, i: int, names: tuple[str, ...], separation: float) -> NextPose:
    power = chi2_shifted_tail(_TELLS_APART, 1, max(separation, 1e-9))
    sign = None if data.direction is None else tuple(int(x) for x in data.direction[i])
    return NextPose(tuple(float(x) for x in data.q[i]), sign, names, power)


def _random_poses(fit: Fit, count: int, seed: int) -> Measurements:
    """Poses inside the limits and the range of the data, with conditions of measured ones."""
    data, arm = fit.data, fit.arm
    rng = np.random.default_rng(seed)
    limits = np.array([[j.q_min, j.q_max] for j in arm.joints])
    low = np.maximum(data.q.min(axis=0), limits[:, 0])
    high = np.minimum(data.q.max(axis=0), limits[:, 1])
    like = data.take(rng.integers(0, data.n, count))
    q = rng.uniform(low, high, (count, arm.n))
    direction = None if data.direction is None else rng.choice([-1.0, 1.0], (count, arm.n))
    ids = tuple(str(i) for i in range(count))
    return replace(like, q=q, direction=direction, ids=ids, split=None, replicate=None)


def _beliefs(fit: Fit, data: Measurements, effects: Sequence[Hypothesis]) -> list[_Belief]:
    """Each effect's belief after the poses measured so far, and its columns at the new ones."""
    old, there = Columns(fit), fit.at(data)
    new = Columns(there)
    nuisance_old = old.weighted(fit.J) * fit.sigma_prior / fit.scale
    nuisance_new = np.einsum("nij,njk->nik", there.whiten, there.evaluation.J) * fit.sigma_prior / fit.scale
    z0 = old.weighted(fit.z + fit.J @ fit.estimate) / fit.scale

    def belief(h: Hypothesis) -> _Belief:
        measured = np.hstack([nuisance_old, old.hypothesis(h) / fit.scale])
        columns = new.hypothesis(h).reshape(data.n, fit.evaluation.r.shape[1], -1) / fit.scale
        cov = np.linalg.inv(measured.T @ measured + np.eye(measured.shape[1]))
        design = np.concatenate([nuisance_new, columns], axis=2)
        return _Belief(design, array(cov @ (measured.T @ z0)), array(cov))

    return [belief(h) for h in effects]


def _criterion(beliefs: Sequence[_Belief]) -> tuple[Array, Array]:
    """(N,) MD of every pose with equal priors, and the least squared separation among the pairs [chi^2]."""
    n, c, _ = beliefs[0].design.shape
    prior = 1.0 / len(beliefs)
    predicted = [_predicted(belief) for belief in beliefs]
    md, gap = np.zeros(n), np.full(n, np.inf)
    for (yj, vj, wj), (yi, vi, wi) in itertools.combinations(predicted, 2):
        trace = np.einsum("nij,nji->n", vi, wj) + np.einsum("nij,nji->n", vj, wi) - 2 * c
        d = yi - yj
        separation = np.einsum("ni,nij,nj->n", d, wi + wj, d)
        md += prior * prior * 0.5 * (trace + separation)
        gap = np.minimum(gap, 0.5 * separation)
    return md, gap


def _predicted(belief: _Belief) -> tuple[Array, Array, Array]:
    """Mean (N, c), covariance and information (N, c, c) of a new measurement at every pose."""
    a = belief.design
    v = np.eye(a.shape[1]) + np.einsum("nik,kl,njl->nij", a, belief.cov, a)
    return a @ belief.mean, v, np.linalg.inv(v)
