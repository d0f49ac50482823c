"""Search spaces as text."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape

from kincal.cli.text.layout import grid
from kincal.results import angle_text, length_text, spans, summed

if TYPE_CHECKING:
    from kincal import space as space_mod
    from kincal.flight.tables import Image


def built(out: Console, built: space_mod.BuiltSpace, path: Path) -> None:
    """What a search found, and why samples were rejected."""
    table, image = built.table, built.image
    out.print(
        f"{path}: {table.n_candidates} candidates from {built.n_samples} samples, "
        f"{table.n_local} local initial poses, {len(image.data)} bytes, CRC {image.crc_text}"
    )
    _reasons(out, "samples rejected", built.rejected)


def _reasons(out: Console, head: str, reasons: dict[str, int]) -> None:
    rows = grid("", head, "because", right=(0,))
    for n, reason in summed(reasons):
        rows.add_row(str(n), reason)
    out.print(rows)


def facts(n: space_mod.Summary) -> list[tuple[str, str]]:
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


def summary(out: Console, image: Image, numbers: space_mod.Summary) -> None:
    """What `kincal space show` prints."""
    out.print(f"[bold]search space[/], CRC {image.crc_text}")
    rows = grid("", "what", "value")
    for what, value in facts(numbers):
        rows.add_row(what, value)
    out.print(rows)


def candidate(out: Console, index: int, lines: Sequence[space_mod.CheckLine]) -> None:
    """All checks of a candidate."""
    rows = grid(f"candidate {index}", "", "check", "found", "wanted")
    for x in lines:
        rows.add_row("ok" if x.ok else "NO", x.check, escape(x.got), x.want)
    out.print(rows)


def region(out: Console, at: tuple[float, ...], half_m: float, found: space_mod.Region) -> None:
    """What became of the tool poses of a region."""
    place = " ".join(f"{x:.2f}" for x in at)
    poses = f"{found.good} of {found.examined} tool poses"
    out.print(f"{poses} within {half_m:.2f} m of {place} could be candidates")
    _reasons(out, "rejected", found.reasons)


def checked(out: Console, path: Path, table: space_mod.SpaceTable, found: space_mod.Recheck) -> None:
    """What does not hold in a table."""
    share = found.contacts / max(found.sampled, 1)
    problems = len(found.problems) + len(found.node_problems)
    counts = f"{table.n_candidates} candidates, {table.n_local} local initial poses"
    out.print(f"{path}: {counts}, {problems} problems")
    out.print(f"servo bounds: {found.contacts} of {found.sampled} newly sampled postures touch ({share:.2%})")
    for what in found.node_problems:
        out.print(f"  {what}")
    for i, what in found.problems:
        out.print(f"  candidate {i}: {what}")


def diff(out: Console, a: Image, b: Image, d: space_mod.Difference) -> None:
    """What changed from one table to another."""
    rows = grid(f"{a.crc_text} -> {b.crc_text}", "what", "value")
    rows.add_row("candidates in both", str(d.same))
    rows.add_row("only in the first, only in the second", f"{len(d.only_a)}, {len(d.only_b)}")
    rows.add_row("hubs", f"{d.n_hubs[0]} -> {d.n_hubs[1]}" + (", moved" if d.hubs_differ else ""))
    local = f"{d.n_local[0]} -> {d.n_local[1]}" + (", changed" if d.local_differ else "")
    rows.add_row("local initial poses", local)
    rows.add_row("servo bound", f"{spans(d.servo_bound_rad[0])} -> {spans(d.servo_bound_rad[1])} rad")
    rows.add_row("verified for DH errors up to", f"{_verified(d.verified[0])} -> {_verified(d.verified[1])}")
    rows.add_row("new candidate farthest from any old one", f"{d.farthest_new_m * 1e3:.0f} mm")
    rows.add_row("least kernel covariance of a new one with the old", f"{d.min_covariance:.3f}")
    out.print(rows)


def information(out: Console, found: space_mod.ExpectedInformation) -> None:
    """What a space is expected to tell."""
    noise = found.noise
    out.print(
        f"one observation: {noise.pos_m * 1e3:.2f} mm, {noise.rot_rad * 1e3:.2f} mrad; "
        f"{found.rank} of {len(found.coefficients)} coefficients can be identified"
    )
    for name, alike in found.unidentifiable.items():
        why = f"acts like {', '.join(alike)}" if alike else "hardly shows at these poses"
        out.print(f"  [bold]{name}[/] cannot: {why}")
    rows = grid("", "poses", "chosen by", "rank", "worst angle", "worst length", "tool position", "rotation")
    for e in sorted(found.expected, key=lambda e: e.n):
        sigmas = (
            angle_text(e.angle_rad),
            length_text(e.length_m),
            length_text(e.pos_m),
            angle_text(e.rot_rad),
        )
        rows.add_row(str(e.n), e.acquisition, str(e.rank), *sigmas)
    out.print(rows)


def separability(out: Console, found: space_mod.Separability) -> None:
    """Effects that a space would not show or not distinguish."""
    out.print(f"{found.tested} effects of the library, each at its typical size:")
    out.print("  not detectable beside the parameters: " + (", ".join(found.undetectable) or "none"))
    pairs = "; ".join(f"{x} / {y}" for x, y in found.confounded) or "none"
    out.print("  detectable but confounded: " + pairs)
    worst = ", ".join(f"{name} {m * 1e3:.2f} mm" for name, m in found.harm_m)
    out.print(f"  could hide this much tool error: {worst}")
