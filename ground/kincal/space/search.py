"""From a description to a candidate table."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from kincal import core, tables
from kincal.errors import KincalError
from kincal.geometry import R_to_quat
from kincal.results import summed

from . import guard
from .checks import WHY_ALL, WHY_FIRST, WHY_SPARE, Checks
from .description import Description
from .look import ordinary
from .spread import Metric, farthest
from .work import BLOCK, Crew, Sample

POOL = 8  # survivors that are proven, per candidate wanted
Tick = Callable[[str, int, int], None]


@dataclass
class Built:
    """A finished search space."""

    image: tables.Image
    struct: Any
    n_samples: int
    rejected: dict[str, int]  # why samples were dropped
    samples: list[Sample] = field(default_factory=list)  # what was examined and why dropped, for pictures

    @property
    def kept(self) -> int:
        return ordinary(self.struct)

    @property
    def first_looks(self) -> int:
        return int(self.struct.n_cand) - self.kept


def need(path: Path) -> Path:
    if not path.is_file():
        raise KincalError(
            "a search space needs the built arm, camera and kernel tables",
            str(path),
            "run `kincal table build tables/src tables/bin` or give --tables DIR",
        )
    return path


def build(desc: Description, tables_dir: Path, tick: Tick = lambda *_a: None, processes: int = 2) -> Built:
    """Search, prove, choose, connect. `tick(phase, done, of)` for a progress display."""
    arm_image, arm = tables.load(need(tables_dir / "arm.tbl"))
    camera_image, camera = tables.load(need(tables_dir / "camera.tbl"))
    _, kernel = tables.load(need(tables_dir / "kernel.tbl"))
    if desc.spread.set >= kernel.n_hyper:
        raise KincalError(f"the kernel table has sets 0 to {kernel.n_hyper - 1}", "spread.set")
    checks = Checks(desc, arm, camera)
    hub_edges = _hubs(checks)
    first = _first(checks)
    with Crew(checks, desc, arm_image.data, camera_image.data, processes) as crew:
        samples = _examine(crew, desc, tick)
        rejected = Counter(s.reason for s in samples if s.reason)
        good = [i for i, s in enumerate(samples) if not s.reason]
        q = np.array([samples[i].q for i in good]).reshape(-1, checks.chain.n)
        q, poses = _pool(checks, kernel, q, POOL * desc.candidates)
        q, hub, dropped = _prove(crew, q, tick)
        rejected.update(s.reason for s in dropped)
        if len(q) < max(desc.priors, 1):
            why = "; ".join(f"{reason} {n}" for n, reason in summed(rejected)[:3]) or "no samples"
            raise KincalError(
                f"only {len(q)} of {len(samples)} samples could be candidates; most fail: {why}",
                desc.title,
                "widen the box, the view or the margins in the description, or ask for more samples",
            )
        p, R = checks.poses(q)
        keep = farthest(Metric(kernel, desc.spread.set, p, R), desc.candidates, _middle(p))
        q, hub, p, R = q[keep], hub[keep], p[keep], R[keep]
        n = len(q)
        space = core.ffi.new("kc_space_t *")
        every = np.vstack([q, first])
        _fill(space, checks, every, np.append(hub, np.zeros(len(first), int)), hub_edges)
        for i, x in enumerate(first):
            c = space.cand[n + i]
            c.tags = checks.first_tags(x)
            c.why = WHY_FIRST | (WHY_SPARE if i in desc.joints.spare_first else 0)
        starts = [*range(n, len(every)), *_priors(crew, kernel, q, p, R, tick)]
        space.n_prior = len(starts)
        space.prior[0 : len(starts)] = starts
        space.servo_leash[0 : checks.chain.n] = [float(x) for x in checks.leash]
        space.arm_crc = arm_image.crc
        guard.fill(space, desc, camera)
        _edges(crew, space, q, tick)
    image = tables.encode("space", space)
    tables.decode(image.data, desc.title)
    return Built(image, space, len(samples), dict(rejected), samples + dropped)


def _hubs(checks: Checks) -> list[int]:
    """Bit sets of proven segments between hubs; refuses hubs that do not hold."""
    for h, q in enumerate(checks.hubs):
        if problem := checks.hub_problem(q):
            raise KincalError(
                f"hub {h} is {problem}",
                f"joints.hubs_rad[{h}]",
                "give it joints that are farther from everything",
            )
    n = len(checks.hubs)
    edges = [0] * n
    for i in range(n):
        for j in range(i):
            if not checks.segment_problem(checks.hubs[i], checks.hubs[j]):
                edges[i] |= 1 << j
                edges[j] |= 1 << i
    return edges


def _first(checks: Checks) -> np.ndarray:
    """Joints of the first looks; refuses any that does not hold."""
    looks = np.array(checks.desc.joints.first_rad, float).reshape(-1, checks.chain.n)
    for i, q in enumerate(looks):
        if problem := checks.first_problem(q, checks.hubs[0], i in checks.desc.joints.spare_first):
            raise KincalError(
                f"first look {i} is {problem}",
                f"joints.first_rad[{i}]",
                "take joints nearer to hub 0, or farther from what is in the way",
            )
    return looks


def _examine(crew: Crew, desc: Description, tick: Tick) -> list[Sample]:
    blocks = [
        (b, min(BLOCK, desc.samples - b * BLOCK), desc.tool.box_min_m, desc.tool.box_max_m)
        for b in range(-(-desc.samples // BLOCK))
    ]
    samples: list[Sample] = []
    for part in crew.map("examine", blocks, 1):
        samples += part
        tick("samples examined", len(samples), desc.samples)
    return samples


def _middle(p: np.ndarray) -> int:
    return int(np.argmin(np.linalg.norm(p - p.mean(axis=0), axis=1)))


def _pool(checks: Checks, kernel: Any, q: np.ndarray, n: int) -> tuple[np.ndarray, Any]:
    """At most n, well spread: proving the way there is what costs time."""
    p, R = checks.poses(q)
    if len(q) > n:
        keep = sorted(farthest(Metric(kernel, checks.desc.spread.set, p, R), n, _middle(p)))
        q = q[keep]
    return q, (p, R)


def _prove(crew: Crew, q: np.ndarray, tick: Tick) -> tuple[np.ndarray, np.ndarray, list[Sample]]:
    """Keep what has a clear servo box and a clear straight segment to a hub, nearest hub first."""
    keep, hub, dropped = [], [], []
    for i, (h, reason) in enumerate(crew.map("prove", [(x,) for x in q])):
        if reason:
            dropped.append(Sample(crew.checks.chain.fk(q[i])[0], q[i], reason))
        else:
            keep.append(i)
            hub.append(h)
        tick("servo boxes and segments", i + 1, len(q))
    return q[keep], np.array(hub, dtype=int), dropped


def _fill(space: Any, checks: Checks, q: np.ndarray, hub: np.ndarray, hub_edges: list[int]) -> None:
    p, R = checks.poses(q)
    space.n_cand, space.n_hub, space.n_joints = len(q), len(checks.hubs), checks.chain.n
    for h, x in enumerate(checks.hubs):
        space.hub_q[h][0 : len(x)] = [float(v) for v in x]
        space.hub_edge[h] = hub_edges[h]
    look = checks.looks(p, R)
    for i in range(len(q)):
        c = space.cand[i]
        c.p_m[0:3] = [float(v) for v in p[i]]
        c.q_wxyz[0:4] = [float(v) for v in R_to_quat(R[i])]
        c.q_seed[0 : checks.chain.n] = [float(v) for v in q[i]]
        c.pan_rad, c.tilt_rad = look.pan[i], look.tilt[i]
        c.tags = checks.tags(q[i])
        c.hub, c.why = int(hub[i]), WHY_ALL


def _priors(crew: Crew, kernel: Any, q: np.ndarray, p: np.ndarray, R: np.ndarray, tick: Tick) -> list[int]:
    """Starting poses, when nothing is known about the errors yet: among the tenth that shows a tag under most
    of the errors drawn, spread far apart."""
    n = crew.checks.desc.priors
    if n == 0:
        return []
    score = np.zeros(len(p))
    for i, s in enumerate(crew.map("survives", [(x,) for x in q])):
        score[i] = s
        tick("errors at candidates", i + 1, len(p))
    best = np.argsort(-score, kind="stable")[: max(len(p) // 10, n)]
    metric = Metric(kernel, crew.checks.desc.spread.set, p[best], R[best])
    return [int(best[k]) for k in farthest(metric, n, _middle(p[best]))]


def _edges(crew: Crew, space: Any, q: np.ndarray, tick: Tick) -> None:
    """Direct segments between near candidates; everything else goes over hubs."""
    limit = crew.checks.desc.clear.direct_max_rad
    pairs = [
        (i, int(j))
        for i in range(1, len(q))
        for j in np.flatnonzero(np.max(np.abs(q[:i] - q[i]), axis=1) <= limit)
    ]
    for k, good in enumerate(crew.map("joined", [(q[i], q[j]) for i, j in pairs])):
        if good:
            i, j = pairs[k]
            bit = i * (i - 1) // 2 + j
            space.edge[bit // 8] |= 1 << bit % 8
        tick("direct segments", k + 1, len(pairs))
