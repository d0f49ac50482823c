"""A campaign as text."""

from __future__ import annotations

from rich.console import Console
from rich.markup import escape

from kincal.campaign import Comparison, Replayed, Report
from kincal.campaign.words import (
    influence_cells,
    number,
    percent,
    quantile_cells,
    requirement_cells,
    verdict_text,
)
from kincal.cli.text.layout import grid

COLOURS = {"pass": "green", "fail": "red", "not shown": "yellow"}
STRONGEST = 10
LISTED = 5  # outcomes that differ from the flight of a case to its replay, and worst cases


def report(out: Console, r: Report) -> None:
    """Print what the cases show."""
    spec = r.results.plan.spec
    title = escape(spec.title or spec.scenario or spec.function)
    out.print(f"[bold]{title}[/]: {r.results.n} of {spec.cases} cases, {r.died} died")
    _ends(out, r)
    _requirements(out, r)
    _distributions(out, r)
    _influences(out, r)
    _worst(out, r)


def _ends(out: Console, r: Report) -> None:
    title = "\nHow cases ended; where only numbers differ, those of the first"
    rows = grid(title, "end", "cases", "share", "95 % bounds", right=(1, 2))
    for end, share in r.ends:
        bounds = f"{percent(share.low)} to {percent(share.high)}"
        rows.add_row(escape(end), str(share.k), percent(share.value), bounds)
    out.print(rows)


def _requirements(out: Console, r: Report) -> None:
    if not r.requirements:
        return
    rows = grid(
        "\nRequirements", "requirement", "met", "share", "shown", "wanted", "verdict", right=(1, 2, 3, 4)
    )
    for judged in r.requirements:
        *cells, verdict = requirement_cells(judged)
        rows.add_row(*map(escape, cells), f"[{COLOURS[verdict]}]{verdict}[/]")
    out.print(rows)
    for judged in r.requirements:
        out.print(escape(verdict_text(judged)))


def _distributions(out: Console, r: Report) -> None:
    if not r.distributions:
        out.print("\nNo case gave a number: no distributions, no influences")
        return
    title = "\nDistributions (quantiles with 95 % bounds)"
    rows = grid(title, "outcome", "cases", "5 %", "50 %", "95 %", "99 %", right=(1,))
    for d in r.distributions:
        rows.add_row(escape(d.column), str(len(d.values)), *quantile_cells(d))
    out.print(rows)


def _influences(out: Console, r: Report) -> None:
    if not r.influences:
        return
    title = f"\nWhat {escape(r.column)} goes with (Spearman's rank correlation)"
    rows = grid(title, "value", "with value", "with size", "p", "Sobol index", right=(1, 2, 3, 4))
    for influence in r.influences[:STRONGEST]:
        rows.add_row(*map(escape, influence_cells(influence)))
    out.print(rows)


def _worst(out: Console, r: Report) -> None:
    rows = grid("\nWorst cases", escape(r.column) or "outcome", "ended", "reason", "again")
    for bad in r.worst[:LISTED]:
        value = number(r.column, bad.value)
        rows.add_row(value, escape(bad.ended), escape(bad.reason), escape(bad.command))
    out.print(rows)


def compared(out: Console, c: Comparison) -> None:
    """Print two campaigns side by side."""
    a, b = c.a.results.folder, c.b.results.folder
    rows = grid("\nCompared", "", escape(str(a)), escape(str(b)), "p if alike", right=(3,))
    for row in c.requirements:
        shares = (f"{x.share.k} of {x.share.n}: {x.verdict}" for x in (row.a, row.b))
        rows.add_row(escape(row.name), *shares, f"{row.p:.3g}")
    pairs = {d.column: d for d in c.b.distributions}
    for d in c.a.distributions:
        one, two = (quantile_cells(x)[1] if x else "-" for x in (d, pairs.get(d.column)))
        rows.add_row(
            f"{escape(d.column)}, median", one, two, f"{c.p_outcome:.3g}" if d.column == c.a.column else ""
        )
    out.print(rows)
    out.print(escape(f"differ in: {'; '.join(c.different) or 'nothing'}"))


def replayed(out: Console, r: Replayed) -> None:
    """Print whether a case came out as before."""
    index, end = r.stored["index"], f"{r.flown['ended']}, {r.flown['reason']}"
    out.print(f"case {index}, seed {r.stored['seed']}: {escape(end)}")
    if not r.differing:
        out.print(
            f"[green]the same to the bit[/]: {len(r.stored)} columns, digest {r.flown['digest'][:16] or '-'}"
        )
        return
    rows = grid("[red]differs[/]", "column", "stored", "flown now")
    for name in r.differing[:LISTED]:
        rows.add_row(escape(name), escape(repr(r.stored[name])), escape(repr(r.flown[name])))
    out.print(rows)
    more = len(r.differing) - LISTED
    if more > 0:
        out.print(f"and {more} more")
    why = "; ".join(r.software) or "the software is the same: a fault of KinCal, or of this computer"
    out.print(escape(f"because: {why}"))
