"""Proposed corrections and decisions about them as text."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from kincal.cli.text.layout import grid
from kincal.results import angle_text, chance_text, length_text
from kincal.review import NUMBERS, CoefLine, Review, reasons_to_reject
from kincal.review.decisions import OnBoard
from kincal.review.journal import Journal
from kincal.review.status import Choice, Listed, Status, choices, see_first
from kincal.review.thresholds import Limits, Threshold, thresholds

_MILLI = {"rad": "mrad", "m": "mm"}


def proposals(out: Console, logs: Sequence[Sequence[Listed]]) -> None:
    """Proposals of several logs."""
    columns = ("CRC", "verdict", "state", "poses", "residual before", "after", "p of the fit", "log")
    rows = grid("", *columns, right=(3, 4, 5, 6))
    for p in (p for log in logs for p in log):
        numbers = length_text(p.before_pos_m), length_text(p.fit_pos_m), chance_text(p.p_fit)
        rows.add_row(f"{p.crc:08x}", p.verdict, p.state, str(p.n_poses), *numbers, escape(str(p.log)))
    if rows.row_count:
        out.print(rows)
    elif logs:
        out.print("no proposals in these logs")


def on_board(out: Console, waits: OnBoard, signing: str = "", sending: str = "") -> None:
    """What waits on board, and what can be decided; signing: options of the commands that see it; sending: of
    those that decide."""
    if not waits.crc:
        out.print("on board: nothing waits")
        return
    what = f"correction {waits.crc:08x} ({waits.verdict or 'verdict not known'})"
    if waits.armed:
        out.print(f"on board: the approval of {what} is armed for another {waits.left_s:.0f} s")
    else:
        out.print(f"on board: {what} waits for review")
    seen = see_first(waits.crc, options=signing)
    _choices(out, (seen, *choices(waits.crc, waits.verdict, (), waits.armed, sending)))


def _choices(out: Console, found: Sequence[Choice]) -> None:
    for choice in found:
        out.print(f"  {choice.what}: [bold]{escape(choice.command)}[/]", soft_wrap=True)


def decisions(out: Console, journal: Journal) -> None:
    """Past decisions of a journal, and who vouches for them."""
    if not journal.entries:
        out.print(f"no decisions in {escape(str(journal.path))}")
        return
    rows = grid(f"\nDecisions in {escape(str(journal.path))}", "time", "decision", "CRC", "by", "why")
    for e in journal.entries:
        why = f"{e.why}; override: {e.override}" if e.override else e.why
        rows.add_row(escape(e.time), escape(e.decision), escape(e.crc), escape(e.by), escape(why))
    out.print(rows)
    if journal.unconfirmed:
        out.print(f"[yellow]look at: {escape(journal.vouched)}[/]")


def absent(out: Console, missing: Sequence[str]) -> None:
    """Decisions that flight took and that no journal has."""
    for text in missing:
        out.print(f"[red]NOT in the journal: {escape(text)}[/]")


def show(
    out: Console,
    r: Review,
    warnings: Sequence[str],
    about: Status,
    limits: Limits | None = None,
    decide: Sequence[Choice] = (),
) -> None:
    """A proposal with all its numbers, what became of it, what a reviewer should look at, and the commands to
    decide."""
    out.print(
        f"[bold]correction {r.crc_text}[/]: {r.verdict}; {about.state}; session "
        f"{r.session}, {r.n_poses} poses, replaces {r.crc_before:08x}; to be right in the frame of the "
        f"{r.frame}"
    )
    shown = [c for c in r.coefs if not c.idle]
    out.print(_coefficients(shown))
    if len(shown) < len(r.coefs):
        out.print(f"{len(r.coefs) - len(shown)} masked coefficients at zero not listed")
    out.print(_numbers(r, limits))
    if about.rejected:
        again = "" if about.exact else " (the log is not whole)"
        out.print(f"poses rejected: {', '.join(map(str, about.rejected))}{again}")
    reasons = reasons_to_reject(r)
    for line in warnings:
        what = "[red]reason to reject" if line in reasons else "[yellow]look at"
        out.print(f"{what}: {escape(line)}[/]")
    if not warnings:
        out.print("nothing stands out")
    if about.waits:
        out.print("flight waits for a decision; the table in force stays until then:")
    _choices(out, decide)


def _coefficients(coefs: Sequence[CoefLine]) -> Table:
    columns = ("coefficient", "value", "sigma", "value/sigma", "unit", "status", "confounded with")
    rows = grid("\nCoefficients", *columns, right=(1, 2, 3))
    for c in coefs:
        k = 1e3 if c.unit in _MILLI else 1.0
        sigma = (f"± {c.sigma * k:.3f}", f"{c.z:+.1f}") if c.sigma > 0 else ("-", "-")
        about = (_MILLI.get(c.unit, c.unit), c.status, escape(", ".join(c.confounded)))
        rows.add_row(escape(c.name), f"{c.value * k:.3f}", *sigma, *about)
    return rows


def _numbers(r: Review, limits: Limits | None) -> Table:
    rows = grid("\nNumbers", "", "", "threshold", "what", right=(1,))
    texts, asked = {"rad": angle_text, "m": length_text}, thresholds(r, limits)
    for key, unit, text in NUMBERS:
        value = r.numbers[key]
        say = chance_text if key.startswith("p_") else texts.get(unit, "{:.4g}".format)
        rows.add_row(key, say(value), _asked(asked.get(key)), text)
    return rows


def _asked(threshold: Threshold | None) -> str:
    if threshold is None:
        return ""
    return f"[red]NOT {threshold.text}[/]" if threshold.kept is False else threshold.text
