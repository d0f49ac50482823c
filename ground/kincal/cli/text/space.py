"""Search spaces as text."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape

from kincal.cli.text.layout import grid
from kincal.results import angle_text, length_text, summed

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


def summary(out: Console, image: Image, numbers: space_mod.Summary) -> None:
    """What `kincal space show` prints."""
    from kincal.space import words

    out.print(f"[bold]search space[/], CRC {image.crc_text}")
    rows = grid("", "what", "value")
    for what, value in words.facts(numbers):
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
    from kincal.space import words

    rows = grid(f"{a.crc_text} -> {b.crc_text}", "what", "value")
    for what, value in words.difference(d):
        rows.add_row(what, value)
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
