"""Numbers of a search space, and what changed between two, in words: (what, value)."""

from __future__ import annotations

from collections.abc import Sequence

from kincal.results import spans

from .recheck import Difference
from .summary import Summary


def facts(n: Summary) -> list[tuple[str, str]]:
    """What is to be known of a search space: (what, value)."""
    box = zip(n.box_min_m, n.box_max_m, strict=True)
    return [
        ("candidates, hubs", f"{n.candidates}, {n.hubs}"),
        ("local initial poses", f"{n.local_initial}, of which {n.reserve} are in reserve"),
        ("initial poses (candidate index)", " ".join(map(str, n.initial))),
        ("direct segments", str(n.direct_edges)),
        ("stops", f"{n.stops} on the way to {n.stopping} candidates"),
        ("box of the tool", " x ".join(f"{a:.3f}..{b:.3f} m" for a, b in box)),
        ("camera distance", f"{n.range_m[0]:.2f}..{n.range_m[1]:.2f} m"),
        ("incidence", f"{n.incid_deg[0]:.0f}..{n.incid_deg[1]:.0f} deg (most oblique tag in view)"),
        ("candidates with two tags in view", str(n.two_tags)),
        ("nearest neighbour", f"{n.nearest_m * 1e3:.0f} mm (median)"),
        ("servo bound", f"{spans(n.servo_bound_rad)} rad"),
        ("verified for DH errors up to", _verified(n.verified)),
        ("candidates with a check missing", str(n.unchecked)),
        ("built for the arm table here", "yes" if n.arm_fits else f"NO: for {n.arm_crc:08x}"),
    ]


def _verified(bounds: Sequence[Sequence[float]]) -> str:
    phi, alpha, a, d = bounds
    lengths = f"a {spans(1e3 * x for x in a)} mm, d {spans(1e3 * x for x in d)} mm"
    return f"phi {spans(phi)} rad, alpha {spans(alpha)} rad, {lengths}"


def difference(d: Difference) -> list[tuple[str, str]]:
    """What changed from one table to another."""
    moved, changed = ", moved" if d.hubs_differ else "", ", changed" if d.local_differ else ""
    return [
        ("candidates in both", str(d.same)),
        ("only in the first, only in the second", f"{len(d.only_a)}, {len(d.only_b)}"),
        ("hubs", f"{d.n_hubs[0]} -> {d.n_hubs[1]}{moved}"),
        ("local initial poses", f"{d.n_local[0]} -> {d.n_local[1]}{changed}"),
        ("servo bound", f"{spans(d.servo_bound_rad[0])} -> {spans(d.servo_bound_rad[1])} rad"),
        ("verified for DH errors up to", f"{_verified(d.verified[0])} -> {_verified(d.verified[1])}"),
        ("new candidate farthest from any old one", f"{d.farthest_new_m * 1e3:.0f} mm"),
        ("least kernel covariance of a new one with the old", f"{d.min_covariance:.3f}"),
    ]
