"""The poses that separate rival effects best: multi-response Box-Hill / Meyer-Steinberg-Box criterion.

    MD = sum_{i<j} p_i p_j 1/2 [ tr(V_i V_j^-1 + V_j V_i^-1 - 2I)
                                 + (y_i - y_j)' (V_i^-1 + V_j^-1) (y_i - y_j) ]

greedy over random poses inside the joint limits, each with the levers that the arm has: the approach
direction is chosen, a payload may be taken. After each choice every rival's belief about its own
parameters is updated by a Kalman step. Meyer, Steinberg, Box, Technometrics 38(4), 1996.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from kincal.errors import CannotAnswer

from .columns import Columns
from .data import Measurements
from .effects import Hypothesis
from .fit import Fit, whitener

_TRIES = 160


@dataclass(frozen=True)
class NextPose:
    """Joint angles [rad or m], approach signs (or None), and how well the pose tells the rivals apart."""

    q: tuple[float, ...]
    direction: tuple[int, ...] | None
    separates: tuple[str, ...]
    power: float


def _candidates(fit: Fit, count: int, seed: int) -> Measurements:
    data, arm = fit.chain.data, fit.chain.arm
    rng = np.random.default_rng(seed)
    low, high = data.q.min(axis=0), data.q.max(axis=0)
    limits = np.array([[j.q_min, j.q_max] for j in arm.joints])
    low, high = np.maximum(low, limits[:, 0]), np.minimum(high, limits[:, 1])
    like = data.take(rng.integers(0, data.n, count))
    q = rng.uniform(low, high, (count, arm.n))
    direction = None if data.direction is None else rng.choice([-1.0, 1.0], (count, arm.n))
    return replace(
        like, q=q, direction=direction, ids=tuple(str(i) for i in range(count)), split=None, replicate=None
    )


def next_poses(
    fit: Fit, rivals: list[Hypothesis], *, count: int = 8, tries: int = _TRIES, seed: int = 1
) -> list[NextPose]:
    """Poses that separate two or more rival effects, best first; power: chance that, with this pose and
    the ones before it, a rival is told from the others at 90 % probability if it is the true one."""
    if len(rivals) < 2:
        raise CannotAnswer("two or more rival effects are needed to separate")
    data = _candidates(fit, tries, seed)
    chain = type(fit.chain)(fit.chain.arm, data, fit.base, fit.tool)
    chain.loads(fit.terms, fit.estimate)
    there = replace(
        fit,
        chain=chain,
        evaluation=chain.evaluate(fit.terms, fit.estimate),
        whiten=whitener(data),
        weight=np.ones(tries),
    )
    old, new = Columns(fit), Columns(there)
    c = fit.evaluation.r.shape[1]
    scale = fit.scale
    nuisance_old = old.weighted(fit.J) * fit.sigma_prior / scale
    jac = np.einsum("nij,njk->nik", there.whiten, there.evaluation.J) * fit.sigma_prior / scale
    z0 = old.weighted(fit.z + fit.J @ fit.estimate) / scale
    beliefs = []
    for h in rivals:
        g_old = old.hypothesis(h) / scale
        g_new = new.hypothesis(h).reshape(tries, c, -1) / scale
        a_old = np.hstack([nuisance_old, g_old])
        a_new = np.concatenate([jac, g_new], axis=2)
        cov = np.linalg.inv(a_old.T @ a_old + np.eye(a_old.shape[1]))
        beliefs.append([a_new, cov @ (a_old.T @ z0), cov])
    names = tuple(h.name for h in rivals)
    prior = 1.0 / len(rivals)
    chosen: list[NextPose] = []
    total = 0.0
    left = np.ones(tries, dtype=bool)
    for _ in range(min(count, tries)):
        md, gap = _criterion(beliefs, prior)
        md[~left] = -np.inf
        best = int(np.argmax(md))
        left[best] = False
        total += gap[best]
        power = float(stats.ncx2.sf(2.0 * np.log(9.0) + 2.0, 1, max(total, 1e-9)))
        sign = None if data.direction is None else tuple(int(x) for x in data.direction[best])
        chosen.append(NextPose(tuple(float(x) for x in data.q[best]), sign, names, power))
        for belief in beliefs:
            a = belief[0][best]
            gain = belief[2] @ a.T @ np.linalg.inv(np.eye(c) + a @ belief[2] @ a.T)
            belief[2] = belief[2] - gain @ a @ belief[2]
    return chosen


def _criterion(beliefs, prior: float) -> tuple[np.ndarray, np.ndarray]:
    """MD of every candidate, and the least squared separation among the pairs [chi^2]."""
    predicted = []
    for a, mean, cov in beliefs:
        v = np.eye(a.shape[1]) + np.einsum("nik,kl,njl->nij", a, cov, a)
        predicted.append((a @ mean, v, np.linalg.inv(v)))
    md = np.zeros(len(predicted[0][0]))
    gap = np.full(len(md), np.inf)
    c = predicted[0][1].shape[1]
    for i in range(len(predicted)):
        for j in range(i):
            (yi, vi, wi), (yj, vj, wj) = predicted[i], predicted[j]
            trace = np.einsum("nij,nji->n", vi, wj) + np.einsum("nij,nji->n", vj, wi) - 2 * c
            d = yi - yj
            quad = np.einsum("ni,nij,nj->n", d, wi + wj, d)
            md += prior * prior * 0.5 * (trace + quad)
            gap = np.minimum(gap, 0.5 * quad)
    return md, gap
