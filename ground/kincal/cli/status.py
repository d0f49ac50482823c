"""`kincal status`: the state of flight on one screen."""

from __future__ import annotations

import json
import time
from dataclasses import replace
from typing import TYPE_CHECKING

import click

from kincal import link as links
from kincal.cli.terminal import console
from kincal.cli.wire import URL
from kincal_shared.errors import CommandFailed

if TYPE_CHECKING:
    from kincal.api.operate import EventLine


def _with_recorded(events: tuple[EventLine, ...], url: str) -> tuple[EventLine, ...]:
    """The last events, with those of before this program began to listen from the recording of the link."""
    from kincal.cli.text.operate import SHOWN_EVENTS
    from kincal.operate.recording import recent_events

    here = {(e.t_us, e.seq, e.id) for e in events}
    before = [e for e in recent_events(url, SHOWN_EVENTS) if (e.t_us, e.seq, e.id) not in here]
    return (*before, *events)[-SHOWN_EVENTS:]


@click.command()
@URL
@click.option("--seconds", type=float, default=2.5, show_default=True, help="How long to listen first.")
@click.option("--all", "all_items", is_flag=True, help="Every value of telemetry.")
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
@click.option("--repeat", is_flag=True, help="Print it again and again, until Ctrl-C.")
def status(url: str, seconds: float, all_items: bool, as_json: bool, repeat: bool) -> None:
    """State of flight on one screen: what waits for whom, the age of each value (fresh, stale, unknown), the
    correction that waits, the last events with cause and action, the tables in force.

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
                found = replace(found, events=_with_recorded(found.events, url))
            if as_json:
                click.echo(json.dumps(found.as_dict(), indent=None if repeat else 1))
            else:
                if repeat and out.is_terminal:
                    out.clear()
                text.status(out, found, url, all_items)
            if not repeat:
                break
    if snapshot.hk is None:
        raise CommandFailed(
            f"no housekeeping within {seconds:g} s", url, "is flight running on this URL? docs/OPERATIONS.md"
        )
