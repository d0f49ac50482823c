"""What measurements in a search space are expected to tell, before the table is sent up: rank and sigma of
parameters and poses after n measurements, and what cannot be identified."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

from kincal.flight import Arm, Model, Observations, Terms, library
from kincal_shared.errors import BadInput

from .arrays import Floats
from .inputs import TablesFolder
from .metric import KernelMetric
from .table import SpaceTable

if TYPE_CHECKING:
    from kincal.flight.headers import KcArm, KcKernel, KcTerms

ACQUISITIONS = ("random", "ucb", "dopt", "vopt")
_DRAWS = 20  # of random
_PIVOT_MIN = 1.0  # as flight: data must tell a coefficient better than its typical size
_WEAK = 3.0  # prior of the criteria while the data do not determine everything, in typical sizes
_VOPT_LEVER_M = 0.3  # how much a rotation counts beside a position in vopt
_ALIKE_SHARE, _ALIKE_MAX = 0.1, 4  # of an imitation by other coefficients: what is named
_UNLIKE = 0.5  # of a column left over by its best imitation: it is not imitated


@dataclass(frozen=True)
class Noise:
    """1-sigma noise of a measured pose in each axis."""

    pos_m: float = 0.0005
    rot_rad: float = 0.0035

    @property
    def rows(self) -> Floats:
        """Of the six rows of a pose residual, (6,)."""
        return np.repeat([self.pos_m, self.rot_rad], 3)


@dataclass(frozen=True)
class Expected:
    """After n poses chosen by one acquisition: rank, worst sigma of an angle and of a length, RMS pose sigma
    over the space. nan while the rank is not full."""

    acquisition: str
    n: int
    rank: int
    angle_rad: float = float("nan")
    length_m: float = float("nan")
    pos_m: float = float("nan")
    rot_rad: float = float("nan")


@dataclass(frozen=True)
class ExpectedInformation:
    """coefficients: names of those to estimate. rank: how many can be identified with as many poses as flight
    takes. unidentifiable: those that flight would hold, with what imitates each. expected: outcomes by
    acquisition and number of poses. chosen: candidates that dopt would take. noise: of one measurement."""

    coefficients: tuple[str, ...]
    rank: int
    unidentifiable: dict[str, tuple[str, ...]]
    expected: tuple[Expected, ...]
    chosen: list[int]
    noise: Noise = field(default_factory=Noise)

    @property
    def ok(self) -> bool:
        """Whether all coefficients can be identified."""
        return not self.unidentifiable


class Design:
    """Scaled Jacobians of n candidates with respect to k coefficients that are estimated.

    plain (n, 6, k): rows position [m], rotation [rad], per typical size of the coefficient. J: the same in
    units of the noise. H (n, k, k): information of each candidate."""

    def __init__(self, table: SpaceTable, tables: TablesFolder, noise: Noise) -> None:
        terms, config = tables.terms, tables.config
        free = _estimated(terms, int(config.est.free_mask))
        self.names = tuple(Terms.of_table(terms).names[i] for i in free)
        self.scale = np.array([float(terms.coef[i].scale) for i in free])
        self.rank_tol = float(config.est.rank_tol)
        self.plain = _jacobians(table, tables.arm, terms)[:, :, free] * self.scale
        self.J = self.plain / noise.rows[:, None]
        self.H = self.J.transpose(0, 2, 1) @ self.J
        self.is_angle = np.array([name.endswith("_rad") for name in self.names])

    def pivots(self, chosen: list[int]) -> tuple[int, Floats]:
        """Rank as flight determines it, by QR with column pivoting, and the order of the pivots (k,)."""
        _, r, order = linalg.qr(self.J[chosen].reshape(-1, len(self.names)), mode="economic", pivoting=True)
        pivot = np.abs(np.diag(r))
        return int(np.sum((pivot >= self.rank_tol * pivot[0]) & (pivot >= _PIVOT_MIN))), order

    def expected(self, acquisition: str, chosen: list[int]) -> Expected:
        """Outcome when candidates `chosen` have been measured."""
        rank, _ = self.pivots(chosen)
        out = Expected(acquisition, len(chosen), rank)
        if rank < len(self.names):
            return out
        C = np.linalg.inv(self.H[chosen].sum(axis=0))
        sigma = np.sqrt(np.diag(C)) * self.scale
        var = ((self.plain @ C) * self.plain).sum(axis=2).mean(axis=0)
        return replace(
            out,
            angle_rad=_worst(sigma[self.is_angle]),
            length_m=_worst(sigma[~self.is_angle]),
            pos_m=float(np.sqrt(var[:3].sum())),
            rot_rad=float(np.sqrt(var[3:].sum())),
        )

    def greedy(self, rule: str, start: list[int], n: int) -> list[int]:
        """n poses that an information criterion ("dopt", "vopt") would take after `start`, errors being
        small."""
        A = self.H[start].sum(axis=0) + np.eye(len(self.names)) / _WEAK**2
        gain = self._dopt_gain if rule == "dopt" else self._vopt_gain
        chosen = list(start)
        while len(chosen) < n:
            value = gain(np.linalg.inv(A))
            value[chosen] = -np.inf
            chosen.append(int(np.argmax(value)))
            A = A + self.H[chosen[-1]]
        return chosen

    def _innovation(self, C: Floats) -> Floats:
        """Covariance of the next residual of each candidate in units of the noise, (n, 6, 6)."""
        S: Floats = np.eye(6) + self.J @ C @ self.J.transpose(0, 2, 1)
        return S

    def _dopt_gain(self, C: Floats) -> Floats:
        gain: Floats = np.linalg.slogdet(self._innovation(C)).logabsdet
        return gain

    def _vopt_gain(self, C: Floats) -> Floats:
        weight = np.array([1.0] * 3 + [_VOPT_LEVER_M] * 3) ** 2
        rows = self.plain.reshape(-1, len(C))
        V = (rows.T * np.tile(weight, len(self.plain))) @ rows / len(self.plain)
        B = self.J @ C
        reduced = B @ V @ B.transpose(0, 2, 1)
        gain: Floats = np.einsum("nij,nji->n", np.linalg.inv(self._innovation(C)), reduced)
        return gain

    def unidentifiable(self, chosen: list[int]) -> dict[str, tuple[str, ...]]:
        """What flight would hold, and what imitates it: the largest shares of its best imitation by the
        coefficients that are estimated."""
        rank, order = self.pivots(chosen)
        J = self.J[chosen].reshape(-1, len(self.names))
        kept = order[:rank]
        return {self.names[k]: tuple(self.names[i] for i in _alike(J, k, kept)) for k in order[rank:]}


def _estimated(terms: KcTerms, free_mask: int) -> list[int]:
    """Coefficients that are enabled and free. BadInput if there is none."""
    free = [i for i in range(int(terms.n_coef)) if terms.coef[i].enabled and free_mask >> i & 1]
    if not free:
        raise BadInput("no coefficient is enabled and free", "terms and config tables")
    return free


def _jacobians(table: SpaceTable, arm: KcArm, terms: KcTerms) -> Floats:
    """Of the tool pose with respect to all coefficients at the candidates, (n, 6, coefficients)."""
    at = Observations.of_columns({"q": table.candidates().q_rad}, list(arm.gravity_m_s2))
    model = Model(Arm.of_table(arm), Terms.of_table(terms), at)
    return model.pose_jacobian(np.zeros(model.terms.n))


def _worst(sigma: Floats) -> float:
    return float(sigma.max()) if len(sigma) else 0.0


def _alike(J: Floats, k: int, kept: Floats) -> list[int]:
    """Columns among `kept` that together imitate column k, most important first; none if it hardly shows or
    nothing imitates it."""
    share, *_ = np.linalg.lstsq(J[:, kept], J[:, k], rcond=None)
    left, size = np.linalg.norm(J[:, k] - J[:, kept] @ share), np.linalg.norm(J[:, k])
    if size < _PIVOT_MIN or left > _UNLIKE * size:
        return []
    return [int(kept[i]) for i in np.argsort(-np.abs(share)) if abs(share[i]) > _ALIKE_SHARE][:_ALIKE_MAX]


def explore(metric: KernelMetric, start: list[int], n: int, noise: float) -> list[int]:
    """n poses that GP-UCB takes after `start` when it knows nothing: where the process is least certain.
    noise: 1-sigma, in units of the process."""
    chosen = list(start)
    K = np.array([metric.covariance(i) for i in chosen])
    while len(chosen) < n:
        inner = K[:, chosen] + noise**2 * np.eye(len(chosen))
        var = 1.0 - np.einsum("in,in->n", K, np.linalg.solve(inner, K))
        var[chosen] = -np.inf
        chosen.append(int(np.argmax(var)))
        K = np.vstack([K, metric.covariance(chosen[-1])])
    return chosen


def expected_information(
    table: SpaceTable,
    tables: TablesFolder,
    steps: tuple[int, ...] = (5, 8, 12, 20),
    noise: Noise | None = None,
) -> ExpectedInformation:
    """Expected outcome for each acquisition after each number of poses in `steps` (numbers beyond that of the
    candidates are left out), with the ARM, TERMS, CONFIG and KERNEL tables. Local initial poses do not count.
    BadInput if no coefficient is estimated."""
    noise = noise or Noise()
    design = Design(table, tables, noise)
    total = table.n_candidates
    steps = tuple(n for n in steps if n <= total) or (total,)
    start = list(table.initial_candidates)[: steps[0]] or [0]
    order = _orders(design, table, tables.kernel, start, steps[-1])
    most = (
        design.greedy("dopt", start, min(int(library("flight").lib.KC_MEAS_MAX), total)) if total > 1 else [0]
    )
    rows = [_random(design, start, n) for n in steps]
    rows += [design.expected(name, order[name][:n]) for name in ACQUISITIONS[1:] for n in steps]
    return ExpectedInformation(
        design.names,
        design.pivots(most)[0],
        design.unidentifiable(most),
        tuple(rows),
        order["dopt"],
        noise,
    )


def _orders(
    design: Design, table: SpaceTable, kernel: KcKernel, start: list[int], n: int
) -> dict[str, list[int]]:
    """The first n candidates that each acquisition takes."""
    cands = table.candidates()
    metric = KernelMetric(kernel, 0, cands.poses)
    return {
        "ucb": explore(metric, start, n, float(kernel.sigma_eps / kernel.hyper[0].sigma_s)),
        "dopt": design.greedy("dopt", start, n),
        "vopt": design.greedy("vopt", start, n),
    }


def _random(design: Design, start: list[int], n: int) -> Expected:
    """Median over random choices; worst rank."""
    rest = np.setdiff1d(np.arange(len(design.J)), start)
    got = []
    for seed in range(_DRAWS):
        more = np.random.default_rng([seed, n]).permutation(rest)[: n - len(start)]
        got.append(design.expected("random", [*start, *more.tolist()]))
    figures = ("angle_rad", "length_m", "pos_m", "rot_rad")
    median = {name: float(np.median([getattr(e, name) for e in got])) for name in figures}
    return Expected("random", n, min(e.rank for e in got), **median)
