"""From a description to a SPACE table: sample, verify, choose, connect."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kincal.flight import tables
from kincal.flight.tables import decode_as
from kincal.results import summed
from kincal.rotations import Pose
from kincal_shared.errors import BadInput
from kincal_shared.schema.dh import DH_FIELDS
from kincal_shared.schema.space import Description

from .arrays import Bools, Floats, Ints
from .checks import Checks
from .encoding import encode
from .inputs import TablesFolder
from .metric import KernelMetric, central, farthest_points
from .samples import BLOCK, Box, Sample, detections, examine, segment_clear, stops_on, verify
from .table import ALL_CHECKS, SpaceTable, local_bit, reserve_bit
from .workers import WorkerPool

if TYPE_CHECKING:
    from kincal.flight.headers import KcKernel

POOL = 8  # samples that are verified, per candidate wanted
INITIAL_SHARE = 10  # initial poses come from the tenth of the candidates that shows tags under most errors
Progress = Callable[[str, int, int], None]  # phase, items done, items in all


def silent(_phase: str, _done: int, _of: int) -> None:
    """A progress callback that shows nothing."""


@dataclass(frozen=True)
class BuiltSpace:
    """A finished search: the table as image and as arrays, how many tool poses were examined, why those were
    rejected that were (kind and detail -> count), and all of them for figures."""

    image: tables.Image
    table: SpaceTable
    n_samples: int
    rejected: dict[str, int]
    samples: tuple[Sample, ...] = ()


@dataclass(frozen=True)
class Candidates:
    """Rows that become part of a table: joints (n, joints), hub (n,), tool poses in the base frame (n,)."""

    q_rad: Floats
    hub: Ints
    tool: Pose

    def take(self, rows: list[int]) -> Candidates:
        """Some of the rows, in that order."""
        return Candidates(self.q_rad[rows], self.hub[rows], self.tool[rows])


def build(desc: Description, tables_dir: Path, progress: Progress = silent, processes: int = 2) -> BuiltSpace:
    """The SPACE table of a description, for arm.tbl, camera.tbl and kernel.tbl of a folder. The same inputs
    give the same bytes. BadInput if a table is missing or does not fit, a hub or local initial pose does
    not hold, or too few samples could be candidates."""
    given = TablesFolder(tables_dir)
    checks = Checks.load(desc, given)
    kernel = _kernel(desc, given)
    hub_edges, local = verified_hub_edges(checks), verified_local(checks)
    with WorkerPool(checks, processes) as pool:
        search = _Search(pool, kernel, progress)
        found, samples = search.candidates()
        initial = search.initial(found)
        direct = search.direct_segments(found.q_rad)
        stops = search.stops(found)
    table = _table(checks, found, local, hub_edges, initial, direct, stops, given.arm_crc)
    image = encode(table, desc, checks.camera)
    as_flown = SpaceTable.from_struct(decode_as("space", image.data, desc.title)[1])
    rejected = Counter(s.rejection for s in samples if s.rejection)
    return BuiltSpace(image, as_flown, desc.samples, dict(rejected), tuple(samples))


def _kernel(desc: Description, given: TablesFolder) -> KcKernel:
    """The KERNEL table; BadInput if it lacks the set of hyperparameters that measures distance."""
    if desc.spread.set >= given.kernel.n_hyper:
        raise BadInput(f"the kernel table has sets 0 to {given.kernel.n_hyper - 1}", "spread.set")
    return given.kernel


def verified_hub_edges(checks: Checks) -> list[int]:
    """Bit sets of clear segments between hubs. BadInput names a hub that does not hold."""
    hubs = checks.hubs
    for h, q in enumerate(hubs):
        if problem := checks.hub_problem(q):
            todo = "give it joints that are farther from everything"
            raise BadInput(f"hub {h}: {problem}", f"joints.hubs_rad[{h + 1}]", todo)
    edges = [0] * len(hubs)
    for j, i in itertools.combinations(range(len(hubs)), 2):
        if not checks.clearance.segment_contact(hubs[i], hubs[j]):
            edges[i] |= 1 << j
            edges[j] |= 1 << i
    return edges


def verified_local(checks: Checks) -> Floats:
    """Joints of the local initial poses, (n, joints). BadInput names one that does not hold."""
    joints = checks.desc.joints
    local = np.array(joints.local_initial_rad, float).reshape(-1, checks.kinematics.n)
    for i, q in enumerate(local):
        if problem := checks.local_problem(q, checks.hubs[0], i + 1 in joints.reserve):
            todo = "take joints nearer to hub 0, or farther from what it touches"
            raise BadInput(
                f"local initial pose {i + 1}: {problem}", f"joints.local_initial_rad[{i + 1}]", todo
            )
    return local


class _Search:
    """The steps of one search that workers share."""

    def __init__(self, pool: WorkerPool, kernel: KcKernel, progress: Progress) -> None:
        self.pool, self.kernel, self.progress = pool, kernel, progress
        self.checks, self.desc = pool.checks, pool.checks.desc

    def candidates(self) -> tuple[Candidates, list[Sample]]:
        """Candidates, well spread, and every sample with why it was rejected."""
        samples = self._examined()
        pool = self._spread_out(np.array([s.q_rad for s in samples if not s.rejection]))
        found, rejected = self._verified(pool)
        samples += rejected
        if len(found.q_rad) < max(self.desc.initial_poses, 1):
            raise _too_few(self.desc, len(found.q_rad), samples)
        chosen = self._far_apart(found.tool, self.desc.candidates)
        return found.take(chosen), samples

    def _far_apart(self, poses: Pose, n: int) -> list[int]:
        """At most n poses far apart, from the one in the middle on."""
        metric = KernelMetric(self.kernel, self.desc.spread.set, poses)
        return farthest_points(metric, n, central(poses.p_m))

    def _examined(self) -> list[Sample]:
        total, box = self.desc.samples, Box(self.desc.tool.box_min_m, self.desc.tool.box_max_m)
        blocks = [(b, min(BLOCK, total - b * BLOCK), box) for b in range(-(-total // BLOCK))]
        samples: list[Sample] = []
        for part in self.pool.map(examine, blocks, chunk=1):
            samples += part
            self.progress("samples examined", len(samples), total)
        return samples

    def _spread_out(self, q_rad: Floats) -> Floats:
        """At most POOL for each candidate wanted, well spread: verification is what costs time."""
        q_rad, n = q_rad.reshape(-1, self.checks.kinematics.n), POOL * self.desc.candidates
        if len(q_rad) <= n:
            return q_rad
        return q_rad[sorted(self._far_apart(self.checks.kinematics.poses(q_rad), n))]

    def _verified(self, q_rad: Floats) -> tuple[Candidates, list[Sample]]:
        """Rows that stay clear with errors and have a hub, and the rejected ones."""
        verdicts = []
        for i, verdict in enumerate(self.pool.map(verify, [(q,) for q in q_rad])):
            verdicts.append(verdict)
            self.progress("servo bounds and segments", i + 1, len(q_rad))
        tool = self.checks.kinematics.poses(q_rad)
        keep = [i for i, v in enumerate(verdicts) if not v.rejection]
        rejected = [Sample(tool.p_m[i], q_rad[i], v.rejection) for i, v in enumerate(verdicts) if v.rejection]
        hub = np.array([v.hub for v in verdicts], int)
        return Candidates(q_rad, hub, tool).take(keep), rejected

    def initial(self, found: Candidates) -> list[int]:
        """Candidates of the initial design, when nothing is known about the errors yet: among the tenth that
        shows a tag under most of the sampled errors, spread far apart."""
        n, total = self.desc.initial_poses, len(found.q_rad)
        if n == 0:
            return []
        score = np.zeros(total)
        for i, detected in enumerate(self.pool.map(detections, [(q,) for q in found.q_rad])):
            score[i] = detected
            self.progress("errors at candidates", i + 1, total)
        best = np.argsort(-score, kind="stable")[: max(total // INITIAL_SHARE, n)]
        return [int(best[k]) for k in self._far_apart(found.tool[best], n)]

    def direct_segments(self, q_rad: Floats) -> Bools:
        """Clear direct segments between near candidates, (n, n), below the diagonal; everything else goes
        over hubs."""
        pairs = near_pairs(q_rad, self.desc.clear.direct_max_rad)
        direct = np.zeros((len(q_rad), len(q_rad)), bool)
        clear = self.pool.map(segment_clear, [(q_rad[i], q_rad[j]) for i, j in pairs])
        for k, (pair, is_clear) in enumerate(zip(pairs, clear, strict=True)):
            direct[pair] = is_clear
            self.progress("direct segments", k + 1, len(pairs))
        return direct

    def stops(self, found: Candidates) -> Ints:
        """Places of stops on the segments from the hubs, (n, most); 0: none."""
        most, total = self.desc.stops.most, len(found.q_rad)
        out = np.zeros((total, most), int)
        hubs = np.array(self.checks.hubs).astype(np.float32).astype(float)  # as the table has them
        segments = [(hubs[h], q) for h, q in zip(found.hub, found.q_rad, strict=True)]
        for i, places in enumerate(self.pool.map(stops_on, segments) if most else ()):
            out[i, : len(places)] = places
            self.progress("stops along segments", i + 1, total)
        return out


def near_pairs(q_rad: Floats, limit_rad: float) -> list[tuple[int, int]]:
    """Pairs (i, j), i > j, of rows whose joints all differ by at most a limit."""
    return [
        (i, int(j))
        for i in range(1, len(q_rad))
        for j in np.flatnonzero(np.max(np.abs(q_rad[:i] - q_rad[i]), axis=1) <= limit_rad)
    ]


def _too_few(desc: Description, n: int, samples: list[Sample]) -> BadInput:
    rejected = Counter(s.rejection for s in samples if s.rejection)
    why = "; ".join(f"{reason} {count}" for count, reason in summed(rejected)[:3]) or "no samples"
    return BadInput(
        f"only {n} of {desc.samples} samples could be candidates; most fail: {why}",
        desc.title,
        "widen the box, the view or the margins in the description, or ask for more samples",
    )


def _table(
    checks: Checks,
    found: Candidates,
    local_q_rad: Floats,
    hub_edges: list[int],
    initial: list[int],
    direct: Bools,
    stops: Ints,
    arm_crc: int,
) -> SpaceTable:
    """Candidates and local initial poses put together."""
    n, n_local = len(found.q_rad), len(local_q_rad)
    q_rad = np.vstack([found.q_rad, local_q_rad])
    poses = checks.kinematics.poses(q_rad)
    views = checks.view.aim(poses)
    tags = [checks.visible_tags(q) for q in found.q_rad] + [checks.detected_nominal(q) for q in local_q_rad]
    reserve = [reserve_bit() * (number in checks.desc.joints.reserve) for number in range(1, n_local + 1)]
    all_direct = np.zeros((n + n_local, n + n_local), bool)
    all_direct[:n, :n] = direct
    return SpaceTable(
        q_rad=q_rad,
        poses=poses,
        pan_tilt_rad=np.column_stack([views.pan_rad, views.tilt_rad]),
        tags=np.array(tags, int),
        hub=np.append(found.hub, np.zeros(n_local, int)),
        checks=np.array([ALL_CHECKS] * n + [local_bit() | bit for bit in reserve], int),
        stops=np.vstack([stops, np.zeros((n_local, stops.shape[1]), int)]),
        hub_q_rad=np.array(checks.hubs),
        hub_edges=np.array(hub_edges, int),
        direct=all_direct,
        initial=(*range(n, n + n_local), *initial),
        servo_bound_rad=checks.servo_bound_rad,
        verified=np.array([getattr(checks.desc.error_bounds, field) for field in DH_FIELDS]).T,
        arm_crc=arm_crc,
    )
