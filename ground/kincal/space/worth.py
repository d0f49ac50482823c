"""What a search space is worth before it is sent up: rank, sigma of parameters and poses after n looks, what
it cannot identify."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg

from kincal import core
from kincal.errors import KincalError
from kincal.geometry import quat_to_R

from .explain import seeds
from .look import ordinary, priors
from .spread import Metric

ACQUISITIONS = ("random", "ucb", "dopt", "vopt")
_DRAWS = 20  # of random
_PIVOT_MIN = 1.0  # as flight: data must tell a coefficient better than its typical size
_WEAK = 3.0  # prior of the criteria while the data do not determine everything, in typical sizes


@dataclass(frozen=True)
class Sigma:
    """After n poses chosen one way: rank, worst sigma of an angle and a length, pose sigma over the space.
    nan while the rank is not full."""

    acquisition: str
    n: int
    rank: int
    angle_rad: float
    length_m: float
    pos_m: float
    rot_rad: float


@dataclass(frozen=True)
class Worth:
    """asked: coefficients to be estimated. held: those that flight would hold, with what imitates each."""

    asked: tuple[str, ...]
    rank: int
    held: dict[str, tuple[str, ...]]
    table: tuple[Sigma, ...]
    chosen: list[int]  # candidates that dopt would take
    sigma_pos_m: float
    sigma_rot_rad: float

    @property
    def ok(self) -> bool:
        return not self.held


class Information:
    """Whitened, scaled Jacobians of all candidates of a space."""

    def __init__(
        self, space: Any, arm: Any, terms: Any, free_mask: int, sigma_pos_m: float, sigma_rot_rad: float
    ) -> None:
        free = [i for i in range(int(terms.n_coef)) if terms.coef[i].enabled and free_mask >> i & 1]
        if not free:
            raise KincalError("no coefficient is enabled and free", "terms and config tables")
        self.names = tuple(core.ffi.string(terms.coef[i].name).decode() for i in free)
        self.scale = np.array([float(terms.coef[i].scale) for i in free])
        model = core.Model(arm, terms)
        q = seeds(space, int(arm.n_joints))
        self.plain = np.array([model.eval(x).J[free].T for x in q]) * self.scale  # (N, 6, k)
        self.noise = np.repeat([sigma_pos_m, sigma_rot_rad], 3)
        self.J = self.plain / self.noise[:, None]
        self.H = np.einsum("nik,nil->nkl", self.J, self.J)
        self.is_angle = np.array([name.endswith("_rad") for name in self.names])

    def rank(self, chosen: list[int], rank_tol: float) -> tuple[int, np.ndarray]:
        """As flight judges it: pivots of QR with column pivoting; also the order of the pivots."""
        _, r, order = linalg.qr(self.J[chosen].reshape(-1, len(self.names)), mode="economic", pivoting=True)
        pivot = np.abs(np.diag(r))
        return int(np.sum((pivot >= rank_tol * pivot[0]) & (pivot >= _PIVOT_MIN))), order

    def sigma(self, acquisition: str, chosen: list[int], rank_tol: float) -> Sigma:
        rank, _ = self.rank(chosen, rank_tol)
        n = len(chosen)
        if rank < len(self.names):
            nan = float("nan")
            return Sigma(acquisition, n, rank, nan, nan, nan, nan)
        C = np.linalg.inv(self.H[chosen].sum(axis=0))
        s = np.sqrt(np.diag(C)) * self.scale
        var = np.einsum("nik,kl,nil->ni", self.plain, C, self.plain).mean(axis=0)
        worst = lambda pick: float(s[pick].max()) if np.any(pick) else 0.0  # noqa: E731
        return Sigma(
            acquisition,
            n,
            rank,
            worst(self.is_angle),
            worst(~self.is_angle),
            float(np.sqrt(var[:3].sum())),
            float(np.sqrt(var[3:].sum())),
        )

    def greedy(self, rule: str, start: list[int], n: int) -> list[int]:
        """Poses that the information criterion would take, errors being small (dopt, vopt)."""
        k = len(self.names)
        A = self.H[start].sum(axis=0) + np.eye(k) / _WEAK**2
        len_m = np.array([1.0] * 3 + [0.3] * 3)
        V = np.einsum("nik,nil,i->kl", self.plain, self.plain, len_m**2) / len(self.plain)
        chosen = list(start)
        while len(chosen) < n:
            C = np.linalg.inv(A)
            S = np.eye(6) + np.einsum("nik,kl,njl->nij", self.J, C, self.J)
            if rule == "dopt":
                gain = np.linalg.slogdet(S)[1]
            else:
                B = np.einsum("nik,kl->nil", self.J, C)
                gain = np.einsum("nij,nji->n", np.linalg.inv(S), np.einsum("nik,kl,njl->nij", B, V, B))
            gain[chosen] = -np.inf
            best = int(np.argmax(gain))
            chosen.append(best)
            A = A + self.H[best]
        return chosen


def explore(metric: Metric, start: list[int], n: int, noise: float) -> list[int]:
    """Poses that GP-UCB takes when it knows nothing: where the process is least certain."""
    chosen = list(start)
    K = np.array([metric.covariance(i) for i in chosen])
    while len(chosen) < n:
        inner = K[:, chosen] + noise**2 * np.eye(len(chosen))
        var = 1.0 - np.einsum("in,in->n", K, np.linalg.solve(inner, K))
        var[chosen] = -np.inf
        best = int(np.argmax(var))
        chosen.append(best)
        K = np.vstack([K, metric.covariance(best)])
    return chosen


def worth(
    space: Any,
    arm: Any,
    terms: Any,
    config: Any,
    kernel: Any,
    steps: tuple[int, ...] = (5, 8, 12, 20),
    sigma_pos_m: float = 0.0005,
    sigma_rot_rad: float = 0.0035,
) -> Worth:
    """Expected outcome for each acquisition; steps beyond the number of candidates are left out."""
    info = Information(space, arm, terms, int(config.est.free_mask), sigma_pos_m, sigma_rot_rad)
    total = ordinary(space)  # first looks come on top
    steps = tuple(n for n in steps if n <= total) or (total,)
    start = list(priors(space))[: steps[0]] or [0]
    cands = space.cand[0:total]
    metric = Metric(
        kernel,
        0,
        np.array([list(c.p_m) for c in cands]),
        np.array([quat_to_R(list(c.q_wxyz)) for c in cands]),
    )
    noise = float(kernel.sigma_eps / kernel.hyper[0].sigma_s)
    tol = float(config.est.rank_tol)
    order = {
        "ucb": explore(metric, start, steps[-1], noise),
        "dopt": info.greedy("dopt", start, steps[-1]),
        "vopt": info.greedy("vopt", start, steps[-1]),
    }
    rows = [_random(info, start, n, total, tol) for n in steps]
    rows += [info.sigma(name, order[name][:n], tol) for name in ACQUISITIONS[1:] for n in steps]
    best = info.greedy("dopt", start, min(int(core.lib.KC_MEAS_MAX), total)) if total > 1 else [0]
    rank, pivots = info.rank(best, tol)
    return Worth(
        info.names,
        rank,
        _held(info, best, rank, pivots),
        tuple(rows),
        order["dopt"],
        sigma_pos_m,
        sigma_rot_rad,
    )


def _random(info: Information, start: list[int], n: int, total: int, tol: float) -> Sigma:
    """Median over draws; worst rank."""
    got = []
    for seed in range(_DRAWS):
        rest = np.setdiff1d(np.arange(total), start)
        more = np.random.default_rng([seed, n]).permutation(rest)[: n - len(start)]
        got.append(info.sigma("random", [*start, *(int(i) for i in more)], tol))
    mid = lambda f: float(np.median([getattr(s, f) for s in got]))  # noqa: E731
    rank = min(s.rank for s in got)
    return Sigma("random", n, rank, mid("angle_rad"), mid("length_m"), mid("pos_m"), mid("rot_rad"))


def _held(info: Information, chosen: list[int], rank: int, order: np.ndarray) -> dict[str, tuple[str, ...]]:
    """What flight would hold, and what imitates it: the largest shares of its best imitation by the rest."""
    J = info.J[chosen].reshape(-1, len(info.names))
    kept = order[:rank]
    out = {}
    for k in order[rank:]:
        share, *_ = np.linalg.lstsq(J[:, kept], J[:, k], rcond=None)
        left = J[:, k] - J[:, kept] @ share
        blind = np.linalg.norm(J[:, k]) < _PIVOT_MIN or np.linalg.norm(left) > 0.5 * np.linalg.norm(J[:, k])
        like = [] if blind else [i for i in np.argsort(-np.abs(share)) if abs(share[i]) > 0.1][:4]
        out[info.names[k]] = tuple(info.names[kept[i]] for i in like)
    return out
