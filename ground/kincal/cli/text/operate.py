"""State of flight, and a command with its verifiers, as text."""

from __future__ import annotations

import datetime
from collections.abc import Sequence

from rich.console import Console
from rich.markup import escape

from kincal.api.operate import (
    FRESH,
    STALE,
    EventLine,
    Freshness,
    Item,
    Line,
    Status,
    Step,
    Tracked,
    Unmet,
)
from kincal.api.reviews import Known
from kincal.cli.text.layout import grid
from kincal.cli.text.run import POSE_HEAD, pose_line

_MARK = {"done": "[green]done[/]", "refused": "[red]refused[/]"}
_SEVERITY = {"error": "red", "warning": "yellow"}
SHOWN_EVENTS = 6


def status(out: Console, s: Status, url: str, all_items: bool = False, said: Known = Known()) -> None:  # noqa: B008
    """One screen: state and what waits for whom, the correction that waits and what the journal says of it,
    ages, tables, events."""
    state = escape(s.state) or "state unknown"
    mark = f" [yellow]({STALE})[/]" if s.state_freshness.status == STALE else ""
    boots = "" if s.boot_count is None else f"; start {s.boot_count} of flight"
    out.print(f"[bold]{state}[/]{mark}  {s.utc[:19]}Z  {escape(url)}{boots}")
    fresh = s.state_freshness.status == FRESH
    out.print(f"{'waits for' if fresh else 'who has to act is'} {escape(s.waits_for)}")
    _waiting(out, s)
    known(out, said, "  ")
    _trouble(out, s)
    _tables(out, s)
    _items(out, [i for i in s.items if all_items or i.key not in _REST])
    events(out, s.events, s.boot_count or 0, s.recording)


_REST = {"mission_time", "candidate", "rx_errors", "tx_errors", "energy", "staged", "events_dropped"}


def _waiting(out: Console, s: Status) -> None:
    w = s.waiting
    if s.state_freshness.status != FRESH:
        last = f"; {escape(w.crc)} waited when flight was last heard" if w.crc else ""
        out.print(f"[yellow]whether a correction waits is not known{last}[/]")
        return
    if not w.crc:
        out.print("no correction waits")
        return
    armed = f"; approval armed, {w.left_s:.0f} s left" if w.armed else ""
    armed += f", GO with {w.go_by}" if w.go_by else ""
    verdict = escape(w.verdict) or "verdict not known"
    out.print(
        f"correction [bold]{w.crc}[/] waits: {verdict}{armed}; `kincal review list --live` says what to do"
    )


def known(out: Console, said: Known, indent: str = "") -> None:
    """What the journals say of a correction that waits."""
    mark = " [red](of a journal that does not verify)[/]" if said.broken else ""
    if said.broken:
        out.print(f"{indent}[red]{escape(said.broken)}[/]", soft_wrap=True)
    for reason in said.reasons:
        out.print(f"{indent}[red]reason to reject: {escape(reason)}[/]{mark}", soft_wrap=True)
    if said.override:
        text = f"armed by override of these reasons: {escape(said.override)}"
        out.print(f"{indent}[red]{text}[/]{mark}", soft_wrap=True)
    for text in said.questions:
        out.print(f"{indent}[yellow]look at: {escape(text)}[/]{mark}", soft_wrap=True)


def _trouble(out: Console, s: Status) -> None:
    if s.restarts:
        out.print(f"[yellow]flight was started again {s.restarts} times since this program listens[/]")
    if s.lost_events:
        out.print(f"[yellow]{s.lost_events} events were lost, on board or on the way[/]")


def _tables(out: Console, s: Status) -> None:
    if s.tables:
        shown = (f"{t.kind} {t.crc}" if t.crc else f"[red]{t.kind} missing[/]" for t in s.tables)
        out.print(f"tables in force: {', '.join(shown)}")


def _items(out: Console, items: Sequence[Item]) -> None:
    rows = grid("", "telemetry", "value", "", "received", "stamped", right=(3, 4))
    for i in items:
        text = escape(i.text) if i.freshness.status == FRESH else f"[dim]{escape(i.text)}[/]"
        rows.add_row(escape(i.label), text, _fresh(i.freshness), *map(_age, _ages(i.freshness)))
    out.print(rows)


def _fresh(f: Freshness) -> str:
    return (
        "" if f.status == FRESH else f"[yellow]{f.status}[/]" if f.status == STALE else f"[dim]{f.status}[/]"
    )


def _ages(f: Freshness) -> tuple[float | None, float | None]:
    return f.receive_age_s, f.mission_age_s


def _age(age_s: float | None) -> str:
    if age_s is None:
        return "-"
    return f"{age_s:.1f} s ago" if age_s < 600 else f"{datetime.timedelta(seconds=round(age_s))} ago"


def events(out: Console, found: Sequence[EventLine], start: int = 0, recording: str = "") -> None:
    """The last events with cause and action; the newest last. start: of flight now, 0 if it is not known;
    recording: how the one stands that some are from."""
    if not found:
        out.print("no events received, and none in a recording of this link (`kincal record` makes one)")
        return
    out.print("[bold]Last events[/]")
    if recording:
        style = "yellow" if "ended" in recording else "dim"
        out.print(f"[{style}]those with a date are {escape(recording)}[/]", soft_wrap=True)
    for i, e in enumerate(found):
        again = any((e.id, e.action) == (later.id, later.action) for later in found[i + 1 :])
        event(out, e, not again, start)


def event(out: Console, e: EventLine, explained: bool = True, start: int = 0) -> None:
    """One event. explained: with cause and action, if it is a warning or an error; start: of flight now, 0 if
    it is not known: one of another start is marked."""
    style = _SEVERITY.get(e.severity, "default")
    when = f"{e.utc[:19] if e.recorded else e.utc[11:19]}Z " if e.utc else ""
    other = (
        f" [yellow](start {e.start} of flight, not the present one)[/]"
        if start and e.start not in (0, start)
        else ""
    )
    out.print(f"{when}[{style}]{e.severity:8}[/]{escape(e.name)}: {escape(e.text)}{other}", soft_wrap=True)
    if explained and e.severity in _SEVERITY:
        out.print(f"        cause: {escape(e.cause)}", soft_wrap=True)
        out.print(f"        do:    {escape(e.action)}", soft_wrap=True)


def step(out: Console, s: Step) -> None:
    """A verifier, as soon as it is reached."""
    mark = _MARK.get(s.stage, s.stage)
    out.print(f"{s.utc[11:23]}Z  {mark + ' ' * (9 - len(s.stage))} {escape(s.evidence)}", soft_wrap=True)


def last_line(out: Console, t: Tracked) -> None:
    """How a command ended."""
    style = "green" if t.outcome == "done" else "red" if t.outcome == "refused" else "yellow"
    out.print(f"[{style}]{escape(t.last_line)}[/]", soft_wrap=True)


def unmet(out: Console, name: str, found: Sequence[Unmet], ages: Freshness, state: str) -> None:
    """What speaks against a command, by the last telemetry."""
    age = "never received" if ages.receive_age_s is None else f"received {ages.receive_age_s:.1f} s ago"
    out.print(f"state {escape(state) or 'unknown'}, housekeeping {age} ({ages.status})")
    for one in found:
        out.print(f"[red]not met:[/] {escape(one.text)}", soft_wrap=True)
    if not found:
        out.print(f"nothing known speaks against {name}; nothing was sent")
    else:
        out.print(f"flight would refuse {name}; nothing was sent")


def watched(out: Console, line: Line) -> None:
    """Something new of a calibration that goes on."""
    if line.pose is not None:
        if line.first:
            out.print(POSE_HEAD.removesuffix("     held-out"))
        out.print(pose_line(line.pose, line.n_goal))
    elif line.event is not None:
        event(out, line.event)
    else:
        out.print(f"[bold]{escape(line.text)}[/]", soft_wrap=True)
