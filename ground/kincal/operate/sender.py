"""Sends a command once, and follows it until it is done, refused, or the time is over."""

from __future__ import annotations

import time
from collections.abc import Callable

from kincal.link import CommandLink

from .commands import Request, Step, Tracked
from .snapshot import Snapshot

_POLL_S = 0.2
FIRST_HK_S = 2.5


def _silent(_step: Step) -> None:
    """Says nothing."""


def listen(link: CommandLink, snapshot: Snapshot, seconds: float, enough: Callable[[Snapshot], bool]) -> None:
    """Take messages of a link for some time, or until it is enough."""
    deadline = link.clock_s() + seconds
    while (left := deadline - link.clock_s()) > 0.0 and not enough(snapshot):
        if (received := link.next(min(left, _POLL_S))) is not None:
            snapshot.take(received.channel, received.message, link.clock_s(), time.time())


def send(
    link: CommandLink,
    request: Request,
    snapshot: Snapshot,
    timeout_s: float = 10.0,
    say: Callable[[Step], None] = _silent,
) -> Tracked:
    """Send a command, once, stamped with the time of flight's newest housekeeping; follow it until it has an
    outcome. Messages go into the snapshot too."""
    hk = snapshot.hk
    seq = link.send(request.opcode, request.arg_i, request.arg_u64, None if hk is None else hk.t_us)
    boots = None if hk is None else hk.boot_count
    now_s = link.clock_s()
    several = snapshot.several(now_s)
    tracked = Tracked(request, seq, now_s, time.time(), timeout_s, boots, snapshot.state, hk, several)
    say(tracked.steps[0])
    while not tracked.outcome:
        received = link.next(_POLL_S)
        now_s, utc_s = link.clock_s(), time.time()
        if received is not None:
            snapshot.take(received.channel, received.message, now_s, utc_s)
            tracked.several = tracked.several or snapshot.several(now_s)
            for step in tracked.take(received.channel, received.message, now_s, utc_s):
                say(step)
        tracked.tick(now_s)
    return tracked
