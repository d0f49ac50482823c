"""Why a candidate is in, why none is in a corner, whether a table still holds, what changed between two."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from kincal import core
from kincal.errors import KincalError
from kincal.geometry import quat_to_R
from kincal.results import spans

from .checks import WHY_SPARE, Checks
from .look import leash, ordinary
from .spread import Metric
from .work import BLOCK, Crew, examine, prove

Tick = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Line:
    """One check of one candidate."""

    check: str
    got: str
    want: str
    ok: bool


def seeds(space: Any, n_joints: int) -> np.ndarray:
    return np.array([list(c.q_seed)[:n_joints] for c in space.cand[0 : ordinary(space)]]).reshape(
        -1, n_joints
    )


def hubs(space: Any, n_joints: int) -> np.ndarray:
    return np.array([list(space.hub_q[h])[:n_joints] for h in range(int(space.n_hub))])


def first_looks(space: Any, n_joints: int) -> list[tuple[int, list[float]]]:
    """Their bits and joints, in order."""
    looks = space.cand[ordinary(space) : int(space.n_cand)]
    return [(int(c.why), [round(x, 5) for x in list(c.q_seed)[:n_joints]]) for c in looks]


def candidate(checks: Checks, space: Any, number: int) -> list[Line]:
    """All checks of a candidate with their figures."""
    total, last = int(space.n_cand), ordinary(space) - 1
    if not 0 <= number < total:
        raise KincalError(f"candidate {number}: the table has 0..{last}")
    if number > last:
        raise KincalError(
            f"candidate {number} is a first look, not one to choose",
            "",
            "see joints.first_rad in the description; `kincal space check` proves first looks again",
        )
    d, n = checks.desc, checks.chain.n
    q = seeds(space, n)[number]
    (p,), R = checks.poses(q)
    look = checks.looks(p[None], R)
    pan, tilt, inside, p_cam = look.pan[0], look.tilt[0], bool(look.inside[0]), look.p_cam[0]
    v = d.view
    room = np.minimum(q - checks.chain.q_min, checks.chain.q_max - q) - np.array(d.joints.margin_rad)
    tight = int(np.argmin(room))
    out = [
        Line(
            "joint limits",
            f"J{tight + 1} {room[tight]:.2f} rad inside its margin",
            ">= 0",
            room[tight] >= -1e-6,
        )
    ]
    inside_box = bool(np.all(p >= d.tool.box_min_m) and np.all(p <= d.tool.box_max_m))
    out.append(Line("tool in the box", " ".join(f"{x:.3f}" for x in p) + " m", "inside", inside_box))
    far = float(np.linalg.norm(p_cam))
    out.append(
        Line(
            "camera distance",
            f"{far:.2f} m",
            f"{v.range_min_m}..{v.range_max_m} m",
            v.range_min_m <= far <= v.range_max_m,
        )
    )
    out.append(Line("head", f"pan {pan:.2f}, tilt {tilt:.2f} rad", "inside its margins", inside))
    tags = checks.tags(q)
    edge, incid = checks.edge_px(look)[0], checks.incidence(look)[0]
    shown = checks.thick.seen(q, look.eye[0], (1 << len(edge)) - 1)
    for k in range(len(edge)):
        text = f"{np.degrees(incid[k]):.0f} deg, edge {edge[k]:.0f} px, "
        text += "free line of sight" if shown >> k & 1 else "hidden by the arm"
        want = f"<= {np.degrees(v.incid_max_rad):.0f} deg, >= {v.tag_min_px:.0f} px"
        out.append(Line(f"tag {k}", text, want, bool(tags >> k & 1)))
    enough = tags.bit_count() >= v.tags_min
    out.append(Line("tags in view", str(tags.bit_count()), f">= {v.tags_min}", enough))
    pair = checks.nominal.touching(q)
    out.append(
        Line("clear as drawn", pair or "nothing near", f">= {d.clear.nominal_m * 1e3:.0f} mm", not pair)
    )
    found = checks.wrong_touching(q)
    text = f"{found[0]} with {_errors(checks.errors[found[1]])}" if found else f"{len(checks.errors)} arms"
    out.append(Line("clear with errors", text, f">= {d.clear.drawn_m * 1e3:.0f} mm", not found))
    hub = int(space.cand[number].hub)
    way = checks.segment_problem(hubs(space, n)[hub], q)
    out.append(Line(f"segment from hub {hub}", way or "clear", "clear with all errors", not way))
    span, samples = leash(space, n), d.clear.leash_samples
    if d.survive.reach:
        short = checks.servo_problem(q, p, R[0], span)
        out.append(Line("servo under named errors", short or "reaches the pose", "inside its box", not short))
    box = checks.leash_problem(q, span, samples, checks.stream(3, q))
    out.append(Line(f"servo box +-{spans(span)} rad", box or "clear", f"{samples} postures clear", not box))
    text = f"{sum(checks.shown_by_wrong(q))} of {len(checks.errors)} arms with errors"
    out.append(Line("still shows a tag", text, "for information", True))
    return out


def _errors(e: dict[str, float]) -> str:
    return ", ".join(f"{k} {v:+.2f}" for k, v in e.items())


@dataclass(frozen=True)
class Corner:
    """What happens to tool poses in a small box."""

    examined: int
    good: int
    reasons: dict[str, int]


def corner(checks: Checks, at: np.ndarray, half_m: float, count: int) -> Corner:
    """Examines tool poses about a place and proves what is left: why is there no candidate?"""
    lo, hi = np.asarray(at) - half_m, np.asarray(at) + half_m
    reasons: Counter[str] = Counter()
    good = 0
    for block in range(-(-count // BLOCK)):
        for s in examine(checks, block, min(BLOCK, count - block * BLOCK), lo, hi):
            reason = s.reason or prove(checks, s.q)[1]
            if reason:
                reasons[reason] += 1
            else:
                good += 1
    return Corner(count, good, dict(reasons.most_common()))


@dataclass(frozen=True)
class Checked:
    """problems: (candidate, what); bad_hubs: what is wrong with hubs and first looks. touched of tried:
    sampled postures of servo boxes, with other random numbers than the search used."""

    problems: list[tuple[int, str]]
    bad_hubs: list[str]
    touched: int
    tried: int

    @property
    def ok(self) -> bool:
        return not self.problems and not self.bad_hubs


def recheck(checks: Checks, crew: Crew, space: Any, tick: Tick = lambda *_a: None) -> Checked:
    """Every candidate of a table again, by its own hubs, segments and leash."""
    n = checks.chain.n
    q, h = seeds(space, n), hubs(space, n)
    problems, bad_hubs = [], []
    span, cand = leash(space, n), space.cand
    items = [
        (x, h[int(cand[i].hub)], span, (list(cand[i].p_m), list(cand[i].q_wxyz)), int(cand[i].tags))
        for i, x in enumerate(q)
    ]
    for k, x in enumerate(h):
        if problem := checks.hub_problem(x):
            bad_hubs.append(f"hub {k} is {problem}")
    for c in space.cand[len(q) : int(space.n_cand)]:
        x = np.array(list(c.q_seed)[:n])
        if problem := checks.first_problem(x, h[int(c.hub)], bool(c.why & WHY_SPARE)):
            bad_hubs.append(f"first look at {np.round(x, 2).tolist()} is {problem}")
    touched = 0
    for i, (what, hit) in enumerate(crew.map("recheck", items)):
        problems += [(i, w) for w in what]
        touched += hit
        tick("candidates checked", i + 1, len(q))
    pairs = [(i, j) for i in range(len(q)) for j in range(i) if core.lib.kc_space_edge(space, i, j)]
    for k, good in enumerate(crew.map("joined", [(q[i], q[j]) for i, j in pairs])):
        if not good:
            problems.append((pairs[k][0], f"direct segment to {pairs[k][1]} not clear"))
        tick("direct segments", k + 1, len(pairs))
    return Checked(problems, bad_hubs, touched, len(q) * checks.desc.clear.leash_samples)


@dataclass(frozen=True)
class Difference:
    """Candidates in both, only in one, and how far the new ones are from the nearest old ones."""

    same: int
    only_a: list[int]
    only_b: list[int]
    leash_rad: tuple[tuple[float, ...], tuple[float, ...]]
    hubs: tuple[int, int]
    hubs_differ: bool
    first: tuple[int, int]
    first_differ: bool
    farthest_new_m: float
    least_covariance: float  # of new candidates with the old ones, as the kernel sees it


def difference(a: Any, b: Any, kernel: Any, hyper: int) -> Difference:
    n = int(a.n_joints)
    if n != int(b.n_joints):
        raise KincalError(f"spaces of different arms: {n} and {int(b.n_joints)} joints")
    qa, qb = seeds(a, n), seeds(b, n)
    gap = np.max(np.abs(qa[:, None] - qb[None]), axis=2)
    in_b, in_a = gap.min(axis=1) < 1e-5, gap.min(axis=0) < 1e-5
    cands = [*a.cand[0 : ordinary(a)], *b.cand[0 : ordinary(b)]]
    p = np.array([list(c.p_m) for c in cands])
    metric = Metric(kernel, hyper, p, np.array([quat_to_R(list(c.q_wxyz)) for c in cands]))
    new = np.flatnonzero(~in_a)
    far = [float(np.min(np.linalg.norm(p[: len(qa)] - p[len(qa) + i], axis=1))) for i in new]
    cov = [float(np.max(metric.covariance(len(qa) + int(i))[: len(qa)])) for i in new]
    ha, hb = hubs(a, n), hubs(b, n)
    fa, fb = first_looks(a, n), first_looks(b, n)
    return Difference(
        int(in_b.sum()),
        [int(i) for i in np.flatnonzero(~in_b)],
        [int(i) for i in new],
        (tuple(leash(a, n)), tuple(leash(b, n))),
        (len(ha), len(hb)),
        ha.shape != hb.shape or not np.allclose(ha, hb, atol=1e-6),
        (len(fa), len(fb)),
        fa != fb,
        max(far, default=0.0),
        min(cov, default=1.0),
    )
