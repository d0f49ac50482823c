"""Whether a SPACE table still holds, and what changed between two."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kincal.rotations import Pose
from kincal_shared.errors import BadInput
from kincal_shared.schema.dh import DH_FIELDS

from .arrays import Ints
from .checks import Checks
from .metric import KernelMetric
from .samples import check_row, segment_clear
from .search import Progress, silent
from .table import SpaceTable, reserve_bit
from .workers import WorkerPool

if TYPE_CHECKING:
    from kincal.flight.headers import KcKernel

_SAME_RAD = 1e-5  # joints of the same candidate in two tables


@dataclass(frozen=True)
class Recheck:
    """problems: (candidate, what). node_problems: what is wrong with hubs and local initial poses. contacts
    of sampled: postures inside servo bounds, with other random numbers than the search used."""

    problems: list[tuple[int, str]]
    node_problems: list[str]
    contacts: int
    sampled: int

    @property
    def ok(self) -> bool:
        """Whether everything holds."""
        return not self.problems and not self.node_problems


def recheck(checks: Checks, pool: WorkerPool, table: SpaceTable, progress: Progress = silent) -> Recheck:
    """Every candidate, hub, local initial pose and direct segment of a table verified again, by the hubs,
    segments and servo bound of the table."""
    n = table.n_candidates
    problems, contacts = [], 0
    rows = pool.map(check_row, [(table.row(i), table.servo_bound_rad) for i in range(n)])
    for i, row in enumerate(rows):
        problems += [(i, what) for what in row.problems]
        contacts += row.contacts
        progress("candidates checked", i + 1, n)
    problems += _blocked_segments(pool, table, progress)
    nodes = [*_bounds_problems(checks, table), *_hub_problems(checks, table), *_local_problems(checks, table)]
    return Recheck(problems, nodes, contacts, n * checks.desc.clear.servo_bound_samples)


def _blocked_segments(pool: WorkerPool, table: SpaceTable, progress: Progress) -> list[tuple[int, str]]:
    pairs = np.argwhere(table.candidates().direct)
    clear = pool.map(segment_clear, [(table.q_rad[i], table.q_rad[j]) for i, j in pairs])
    blocked = []
    for k, is_clear in enumerate(clear):
        if not is_clear:
            i, j = pairs[k]
            blocked.append((int(i), f"direct segment to {j} not clear"))
        progress("direct segments", k + 1, len(pairs))
    return blocked


def _bounds_problems(checks: Checks, table: SpaceTable) -> Iterator[str]:
    """What is verified here are the errors of the description; flight goes by those of the table."""
    for field, bounds in zip(DH_FIELDS, table.verified.T.tolist(), strict=True):
        wanted = getattr(checks.desc.error_bounds, field)
        if bounds != wanted:
            yield f"the table says verified for {field} {bounds}, the description has error_bounds {wanted}"


def _hub_problems(checks: Checks, table: SpaceTable) -> Iterator[str]:
    for h, q in enumerate(table.hub_q_rad):
        if problem := checks.hub_problem(q):
            yield f"hub {h}: {problem}"


def _local_problems(checks: Checks, table: SpaceTable) -> Iterator[str]:
    for number, i in enumerate(range(table.n_candidates, len(table.q_rad)), 1):
        row, reserve = table.row(i), bool(table.checks[i] & reserve_bit())
        if problem := checks.local_problem(row.q_rad, row.hub_q_rad, reserve):
            yield f"local initial pose {number} at {np.round(row.q_rad, 2).tolist()}: {problem}"


@dataclass(frozen=True)
class Difference:
    """Two tables, a and b, candidate by candidate; pairs are (a, b)."""

    same: int  # candidates in both
    only_a: list[int]
    only_b: list[int]
    servo_bound_rad: tuple[tuple[float, ...], tuple[float, ...]]
    verified: tuple[list[list[float]], list[list[float]]]  # DH errors: phi, alpha, a, d, each of every joint
    n_hubs: tuple[int, int]
    hubs_differ: bool
    n_local: tuple[int, int]
    local_differ: bool
    farthest_new_m: float  # of the candidates only in b, from the nearest in a
    min_covariance: float  # of the candidates only in b with the nearest in a, as the kernel sees it


def compare(a: SpaceTable, b: SpaceTable, kernel: KcKernel, hyper: int) -> Difference:
    """What changed from table a to table b; kernel, hyper: KERNEL table and its set of hyperparameters.
    BadInput if they are for different arms."""
    if a.n_joints != b.n_joints:
        raise BadInput(f"spaces of different arms: {a.n_joints} and {b.n_joints} joints")
    ca, cb = a.candidates(), b.candidates()
    gap = np.max(np.abs(ca.q_rad[:, None] - cb.q_rad[None]), axis=2)
    new = np.flatnonzero(gap.min(axis=0) >= _SAME_RAD)
    gone = np.flatnonzero(gap.min(axis=1) >= _SAME_RAD)
    far_m, covariance = _novelty(ca, cb, new, kernel, hyper)
    return Difference(
        same=len(ca.q_rad) - len(gone),
        only_a=gone.tolist(),
        only_b=new.tolist(),
        servo_bound_rad=(tuple(a.servo_bound_rad.tolist()), tuple(b.servo_bound_rad.tolist())),
        verified=(a.verified.T.tolist(), b.verified.T.tolist()),
        n_hubs=(len(a.hub_q_rad), len(b.hub_q_rad)),
        hubs_differ=a.hub_q_rad.shape != b.hub_q_rad.shape
        or not np.allclose(a.hub_q_rad, b.hub_q_rad, atol=1e-6),
        n_local=(a.n_local, b.n_local),
        local_differ=_local(a) != _local(b),
        farthest_new_m=far_m,
        min_covariance=covariance,
    )


def _novelty(a: SpaceTable, b: SpaceTable, new: Ints, kernel: KcKernel, hyper: int) -> tuple[float, float]:
    """Largest distance [m] and least kernel covariance between a new candidate of b and the nearest of a."""
    n = len(a.p_m)
    poses = Pose(np.vstack([a.p_m, b.p_m]), np.concatenate([a.poses.R, b.poses.R]))
    metric = KernelMetric(kernel, hyper, poses)
    far_m = [float(np.min(np.linalg.norm(a.p_m - b.p_m[i], axis=1))) for i in new]
    covariance = [float(np.max(metric.covariance(n + int(i))[:n])) for i in new]
    return max(far_m, default=0.0), min(covariance, default=1.0)


def _local(table: SpaceTable) -> list[tuple[int, list[float]]]:
    """Bits and joints of the local initial poses, in order."""
    n = table.n_candidates
    rows = zip(table.checks[n:], table.q_rad[n:], strict=True)
    return [(int(bits), [round(x, 5) for x in q.tolist()]) for bits, q in rows]
