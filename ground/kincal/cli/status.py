"""`kincal status`: the state of flight on one screen."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from kincal import link as links
from kincal.cli.terminal import console
from kincal.cli.wire import JOURNAL, KEYS, URL
from kincal.review import journal as journals
from kincal_shared.errors import BadInput, CommandFailed

if TYPE_CHECKING:
    from kincal.api.operate import Status
    from kincal.api.reviews import Known


RECORDING_S = 10.0
"""A recording without a message for so long has ended: housekeeping comes every second."""


def _with_recorded(found: Status, url: str) -> Status:
    """With the last events of before this program began to listen, from the recording of the link."""
    from kincal.cli.text.operate import SHOWN_EVENTS
    from kincal.operate.recording import recent_events

    recent = recent_events(url, SHOWN_EVENTS)
    here = {(e.t_us, e.seq, e.id) for e in found.events}
    before = [e for e in recent.events if (e.t_us, e.seq, e.id) not in here]
    events = (*before, *found.events)[-SHOWN_EVENTS:]
    if not any(e.recorded for e in events):
        return replace(found, events=events)
    silent_s = time.time() - datetime.fromisoformat(recent.utc).timestamp()
    stands = f"of {recent.file}"
    if silent_s > RECORDING_S:
        stands += f", which ended at {recent.utc[:19]}Z: nothing is known of what happened since then"
    return replace(found, events=events, recording=stands)


def _of_journal(s: Status, key_file: Path, journal: Path | None) -> Known:
    """What the journal says of the correction that waits; keys and journal may be missing: looking needs
    neither."""
    from kincal.api.reviews import Known, known, read_journals

    if not s.waiting.crc:
        return Known()
    try:
        found = read_journals((), journal, key_file, journals.inspect)
    except BadInput as error:  # the key file
        return Known(broken=str(error))
    return known(found, int(s.waiting.crc, 16), s.waiting.verdict, s.waiting.armed)


@click.command()
@URL
@click.option("--seconds", type=float, default=2.5, show_default=True, help="How long to listen first.")
@click.option("--all", "all_items", is_flag=True, help="Every value of telemetry.")
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
@click.option("--repeat", is_flag=True, help="Print it again and again, until Ctrl-C.")
@KEYS
@JOURNAL
def status(
    url: str,
    seconds: float,
    all_items: bool,
    as_json: bool,
    repeat: bool,
    key_file: Path,
    journal: Path | None,
) -> None:
    """State of flight on one screen: what waits for whom, the age of each value (fresh, stale, unknown), the
    correction that waits with what the journal says of it (reasons to reject it, the override that armed it,
    open questions), the last events with cause and action, the tables in force.

    A value is stale if it was received too long ago, if its time stamp is too old, or if flight was started
    again since. Exit status 1 if no housekeeping came.

    \b
    Example:
        kincal status --url 'udpm://239.255.76.67:7667?ttl=0'
    """
    from kincal.api import operate
    from kincal.cli.text import operate as text

    out, snapshot = console(), operate.Snapshot()
    with links.Link(url, operate.LISTEN) as link:
        while True:
            operate.listen(link, snapshot, seconds, lambda _s: False)
            found = snapshot.status(link.clock_s(), time.time(), text.SHOWN_EVENTS)
            if len(found.events) < text.SHOWN_EVENTS:
                found = _with_recorded(found, url)
            said = _of_journal(found, key_file, journal)
            if as_json:
                plain = {**found.as_dict(), "journal": asdict(said)}
                click.echo(json.dumps(plain, indent=None if repeat else 1))
            else:
                if repeat and out.is_terminal:
                    out.clear()
                text.status(out, found, url, all_items, said)
            if not repeat:
                break
    if snapshot.hk is None:
        raise CommandFailed(
            f"no housekeeping within {seconds:g} s", url, "is flight running on this URL? docs/OPERATIONS.md"
        )
