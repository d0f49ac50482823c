"""Sends a command once, and follows it until it is done, refused, or the time is over."""

from __future__ import annotations

import time
from collections.abc import Callable

from kincal.flight import event_name
from kincal.link import CommandLink
from kincal.link.connection import Received, is_ack
from kincal_shared.errors import BadInput
from kincal_shared.keys import Signer

from .commands import Request, Step, Tracked
from .snapshot import Snapshot

_POLL_S = 0.2
_ASKING = 1  # counter of a question: those of commands begin at the clock


def _silent(_step: Step) -> None:
    """Says nothing."""


def listen(link: CommandLink, snapshot: Snapshot, seconds: float, enough: Callable[[Snapshot], bool]) -> None:
    """Take messages of a link for some time, or until it is enough."""
    deadline = link.clock_s() + seconds
    while (left := deadline - link.clock_s()) > 0.0 and not enough(snapshot):
        if (received := link.next(min(left, _POLL_S))) is not None:
            snapshot.take(received.channel, received.message, link.clock_s(), time.time())


def accepted_counter(link: CommandLink, timeout_s: float = 5.0) -> int:
    """The highest counter that flight has accepted of commands of the link's key; 0: none. Asked by a NOOP
    that has the counter 1: its refusal (CMD_REPLAYED) names the highest one, and a flight that has accepted
    none answers it. BadInput if the link has no key, NoAnswer or CommandFailed if flight does not say."""
    if link.signer is None:
        raise BadInput("a key is needed to ask for its counter", link.url, "name a key file by --keys")
    hk = link.wait_hk(lambda _hk: True, timeout_s, "housekeeping")
    signer, found = link.signer, []
    link.signer = Signer(signer.key, lambda _source: _ASKING, signer.known)
    try:
        seq = link.send("NOOP", t_us=hk.t_us)
    finally:
        link.signer = signer

    def answered(r: Received) -> bool:
        event = event_name(r.message.id) if r.channel == "KC_EVENT" else ""
        if event == "CMD_REPLAYED" and r.message.got == _ASKING:
            found.append(int(r.message.want))
        return bool(found) or (is_ack(r, seq) and r.message.status == 0)

    link.wait_for(answered, timeout_s, "the counter of this key")
    return found[0] if found and found[0] > _ASKING else 0  # that of an earlier question is none


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
