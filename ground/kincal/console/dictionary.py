"""Every event with its likely causes and what to do, as docs/OPERATIONS.md has them."""

from __future__ import annotations

from functools import cache

from kincal.flight.events import event_cause, event_name, event_todo

_MOST = 2**10


@cache
def dictionary() -> dict[str, dict[str, str]]:
    """Name of an event -> cause, do."""
    names = {number: event_name(number) for number in range(1, _MOST)}
    return {
        name: {"cause": event_cause(number), "do": event_todo(number)}
        for number, name in names.items()
        if name not in ("", "UNKNOWN")
    }
