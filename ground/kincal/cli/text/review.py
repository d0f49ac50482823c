"""Proposed corrections and decisions about them as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from kincal.api.corrected import Corrected
from kincal.api.previews import Asked, RolledBack
from kincal.api.reviews import Known
from kincal.cli.text.layout import grid
from kincal.cli.text.operate import known
from kincal.results import angle_text, chance_text, length_text
from kincal.review import NUMBERS, CoefLine, Review, poor_fit, reasons_to_reject
from kincal.review.changes import Changes, amount
from kincal.review.decisions import OnBoard
from kincal.review.history import History, Trend, decided, utc
from kincal.review.journal import Entry, Journal, one_line, unfinished
from kincal.review.residuals import PoseResidual
from kincal.review.status import Choice, Listed, Status, choices, see_first
from kincal.review.thresholds import SIGMA_DOES_NOT_HOLD, Limits, Threshold, thresholds

_WORST = 5
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


def history(out: Console, found: History, trends: Sequence[Trend], entries: Sequence[Entry]) -> None:
    """What was in force when, coefficients over the corrections, states of the monitor; oldest first."""
    rows = grid("in force", "from [UTC, or s of mission]", "table", "CRC", "what", "decided by")
    for x in found.in_force:
        what, who = escape(found.what(x)), escape(decided(x, entries))
        rows.add_row(utc(x.utc_s), x.kind, x.crc or "none", what, who)
    out.print(rows)
    columns = ("coefficient", "correction", "value", "1 sigma", "bound", "put in force")
    rows = grid("coefficients", *columns, right=(2, 3, 4))
    for t in trends:
        for p in t.points:
            sizes = amount(p.value, t.unit), amount(p.sigma, t.unit), amount(max(-t.lower, t.upper), t.unit)
            rows.add_row(escape(t.name), p.crc, *sizes, "yes" if p.active else "no")
    out.print(rows if trends else "no coefficients: no correction, or of TERMS tables that are not at hand")
    rows = grid("monitor", "from [UTC, or s of mission]", "state", "suspected")
    for m in found.monitor_changes():
        rows.add_row(utc(m.utc_s), m.text, m.suspected)
    out.print(rows)


def on_board(out: Console, waits: OnBoard, sending: str = "", said: Known = Known()) -> None:  # noqa: B008
    """What waits on board, and what can be decided; sending: options of the commands for it; said: what the
    journals say of it."""
    if not waits.crc:
        out.print(f"on board: nothing waits; state {escape(waits.state)}")
        return
    what = f"correction {waits.crc:08x} ({waits.verdict or 'verdict not known'})"
    if waits.armed:
        key = f", by key {waits.armed_key}" if waits.armed_key else ""
        out.print(f"on board: the approval of {what} is armed{key} for another {waits.left_s:.0f} s")
    else:
        out.print(f"on board: {what} waits for review")
    seen = see_first(waits.crc, "--live", sending)
    known(out, said, "  ")
    found = choices(waits.crc, waits.verdict, said.reasons, waits.armed, sending, _second(waits))
    _choices(out, (seen, *found))


def broken(out: Console, journals: Sequence[Journal]) -> None:
    """Journals that do not verify."""
    for one in journals:
        if one.broken is not None:
            text = f"{one.path} does not verify: {one.broken.what}. What is shown of it may have been changed"
            out.print(f"[red]{escape(text)}[/]", soft_wrap=True)


def _second(waits: OnBoard) -> str:
    """Who has to take the second step."""
    return waits.other_than or ("a second person, with a key of his own" if waits.two_holders else "")


def _choices(out: Console, found: Sequence[Choice]) -> None:
    for choice in found:
        out.print(f"  {choice.what}: [bold]{escape(choice.command)}[/]", soft_wrap=True)


def decisions(out: Console, journal: Journal) -> None:
    """Past decisions of a journal, and who vouches for them."""
    broken(out, (journal,))
    if not journal.entries:
        out.print(f"no decisions in {escape(str(journal.path))}")
        return
    rows = grid(
        f"\nDecisions in {escape(str(journal.path))}", "line", "time", "decision", "CRC", "by", "key", "why"
    )
    for n, e in enumerate(journal.entries, 1):
        why = one_line(f"{e.why}; override: {e.override}" if e.override else e.why)
        key = str(e.key_id or "") + (f" (armed by key {e.armed_key})" if e.armed_key else "")
        rows.add_row(str(n), escape(e.time), escape(e.words), escape(e.crc), escape(e.by), key, escape(why))
    out.print(rows)
    for e in unfinished(journal.entries):
        text = f"{e.words} {e.crc} by {e.by}, {e.time}: nothing says what came of it; `kincal status` does"
        out.print(f"[yellow]look at: {escape(text)}[/]", soft_wrap=True)
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
    changes: Changes | None = None,
    left: Sequence[PoseResidual] = (),
    clearance: Corrected | str = "",
) -> None:
    """A proposal with all its numbers, what changes, what became of it, what a reviewer should look at, and
    the commands to decide."""
    out.print(
        f"[bold]correction {r.crc_text}[/]: {r.verdict}; {about.state}; session "
        f"{r.session}, {r.n_poses} poses, replaces {r.crc_before:08x}; to be right in the frame of the "
        f"{r.frame}"
    )
    if r.ended:
        out.print(f"measuring ended: {r.ended}")
    if poor_fit(r):
        out.print(f"[red]{SIGMA_DOES_NOT_HOLD}[/]", soft_wrap=True)
    if changes is not None:
        what_changes(out, changes, {c.name: c.confounded for c in r.coefs})
    what_is_near(out, clearance)
    shown = [c for c in r.coefs if not c.idle]
    if changes is None:
        out.print(_coefficients(shown))
    if len(shown) < len(r.coefs):
        out.print(f"{len(r.coefs) - len(shown)} masked coefficients at zero not listed")
    out.print(_numbers(r, limits))
    if left:
        out.print(_left(left))
    if about.rejected:
        again = "" if about.exact else " (the log is not whole)"
        out.print(f"poses rejected: {', '.join(map(str, about.rejected))}{again}")
    if about.rejected_extra:
        out.print(f"observations on the way to a pose rejected: {len(about.rejected_extra)}")
    reasons = reasons_to_reject(r)
    for line in warnings:
        what = "[red]reason to reject" if line in reasons else "[yellow]look at"
        out.print(f"{what}: {escape(line)}[/]", soft_wrap=True)
    if not warnings:
        out.print("nothing stands out")
    if about.waits:
        out.print("flight waits for a decision; the table in force stays until then:")
    _choices(out, decide)


def what_changes(out: Console, c: Changes, confounded: Mapping[str, Sequence[str]] = {}) -> None:  # noqa: B006
    """The size in one sentence, each value old and new, where the tool goes, what the data do not tell
    apart."""
    out.print(f"[bold {'yellow' if c.big else 'default'}]{escape(c.headline)}[/]", soft_wrap=True)
    columns = (
        "coefficient",
        "old",
        "new ± sigma",
        "change",
        "of its bound",
        "determined by",
        "confounded with",
    )
    rows = grid("\nWhat changes", *columns, right=(1, 2, 3, 4))
    for row in c.rows:
        change = f"[yellow]{row.delta_text}[/]" if row.big else row.delta_text
        cells = (escape(row.name), row.old_text, row.new_text, change, row.share_text, escape(row.source))
        rows.add_row(*cells, escape(", ".join(confounded.get(row.name, ()))))
    out.print(rows)
    if not c.old_known:
        out.print("the table in force is not at hand (`--before`): changes are those from the nominal arm")
    if c.tool:
        shifts = grid(
            "\nWhere the tool goes", "place", "moves", "turns", "along x, y, z of the base", right=(1, 2)
        )
        for t in c.tool:
            vector = ", ".join(amount(x, "m", sign=True) for x in t.vector_m)
            shifts.add_row(escape(t.place), amount(t.pos_m, "m"), amount(t.rot_rad, "rad"), vector)
        out.print(shifts)
    if c.space:
        rms_m, max_m, rms_rad, max_rad = c.space
        out.print(
            f"over the space: {amount(rms_m, 'm')} RMS, {amount(max_m, 'm')} at most; "
            f"{amount(rms_rad, 'rad')} RMS, {amount(max_rad, 'rad')} at most"
        )
    for a, b, rho in c.correlations:
        out.print(f"[yellow]barely told apart[/]: {escape(a)} and {escape(b)}, correlation {rho:+.3f}")
    if c.undetermined:
        out.print(f"[yellow]not determined by these poses[/]: {escape(', '.join(c.undetermined))}")
    for reason in c.reasons:
        out.print(f"[red]against it:[/] {escape(reason.text)}", soft_wrap=True)


def what_is_near(out: Console, found: Corrected | str, new: str = "proposed") -> None:
    """Clearance and reach with the new table, or why they are not known; new: what that table is."""
    if isinstance(found, str):
        if found:
            out.print(f"[yellow]clearance and reach are not known:[/] {escape(found)}", soft_wrap=True)
        return
    columns = ("where", "in force", new, f"nearest, {new}")
    title = f"\nClearance: at least {length_text(found.margin_m)} (SPACE {found.space})"
    rows = grid(title, *columns, right=(1, 2))
    for c in found.clear:
        near = c.after.distance_m is not None and c.after.distance_m < found.margin_m
        after = f"[red]{c.after.text}[/]" if near else c.after.text
        rows.add_row(c.what, c.before.text, after, escape(c.after.where))
    out.print(rows)
    rows = grid("\nReach and view", "poses", "which", "in force", new, "lost", right=(2, 3))
    for r in found.reach:
        counts = f"{r.of - len(r.before)}", f"{r.of - len(r.after)} of {r.of}"
        rows.add_row(r.what, r.want, *counts, escape(r.lost_text))
    out.print(rows)
    for note in found.notes:
        out.print(escape(note), soft_wrap=True)


def rolled_back(out: Console, found: RolledBack) -> None:
    """What a rollback brings back."""
    now, before = found.now, found.before
    place = f" (values from {before.where})" if before.where else ""
    out.print(
        f"[bold]rollback: from KIN table {now.crc:08x} back to {before.crc:08x}[/]{escape(place)}",
        soft_wrap=True,
    )
    what_changes(out, found.changes)
    what_is_near(out, found.corrected or found.why_not, "rolled back")


def asked(out: Console, found: Asked) -> None:
    """What waits on board, as flight holds it."""
    verdict = found.verdict or "verdict not known"
    out.print(f"[bold]correction {found.crc}[/] ({verdict}), as flight holds it; where this comes from:")
    for source in found.sources:
        out.print(f"  {escape(source)}", soft_wrap=True)
    what_changes(out, found.changes)
    what_is_near(out, found.corrected or found.why_not)


def _coefficients(coefs: Sequence[CoefLine]) -> Table:
    columns = ("coefficient", "value", "sigma", "value/sigma", "unit", "status", "confounded with")
    rows = grid("\nCoefficients", *columns, right=(1, 2, 3))
    for c in coefs:
        k = 1e3 if c.unit in _MILLI else 1.0
        sigma = (f"± {c.sigma * k:.3f}", f"{c.z:+.1f}") if c.sigma > 0 else ("-", "-")
        about = (_MILLI.get(c.unit, c.unit), c.status, escape(", ".join(c.confounded)))
        rows.add_row(escape(c.name), f"{c.value * k:.3f}", *sigma, *about)
    return rows


def _left(left: Sequence[PoseResidual]) -> Table:
    """The observations at which most is left, "to 7": on the way to pose 7; the page has all."""
    columns = ("pose", "candidate", "tags", "before", "", "after", "", "")
    title = f"\nWorst observations of {len(left)}: measured minus model"
    rows = grid(title, *columns, right=(0, 1, 3, 4, 5, 6))
    for p in sorted(left, key=lambda p: -p.after_pos_m)[:_WORST]:
        before = length_text(p.before_pos_m), angle_text(p.before_rot_rad)
        after = length_text(p.after_pos_m), angle_text(p.after_rot_rad)
        tags = ", ".join(map(str, p.tags))
        pose, fate = f"to {p.pose}" if p.extra else str(p.pose), "rejected" if p.rejected else ""
        rows.add_row(pose, str(p.candidate), tags, *before, *after, fate)
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
    if not threshold.holds:
        return f"[red]{threshold.text}[/]"
    return f"[red]NOT {threshold.text}[/]" if threshold.kept is False else threshold.text
