"""A calibration as it goes on: poses, events and states as lines, until something waits for people."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from kincal.link import CommandLink, crc_text, names
from kincal.results import PoseLine

from .snapshot import FRESH, UNKNOWN, EventLine, Snapshot, calibrating

_POLL_S = 0.2
_NOTHING_RUNS = (
    "no calibration runs: this waits for the next one, Ctrl-C ends it; `kincal status` has the last events"
)
_QUIET = ("CAL_POSE", "CMD_ACCEPTED")  # the pose has a line of its own


@dataclass(frozen=True)
class Line:
    """Something new. text: for people; the rest where there is more to show.
    first: no pose was shown before."""

    text: str = ""
    pose: PoseLine | None = None
    n_goal: int = 0
    event: EventLine | None = None
    first: bool = False


class Follower:
    """Turns messages into lines. Takes messages and times; no input or output. ended: why there is nothing to
    wait for any more, "" while there is."""

    def __init__(self, snapshot: Snapshot) -> None:
        self.snapshot = snapshot
        self.ended = ""
        self._state = ""
        self._link = ""
        self._ran = self._posed = False

    def take(self, channel: str, message: Any, now_s: float, utc_s: float) -> list[Line]:
        """A message that was received."""
        restarts = self.snapshot.restarts
        self.snapshot.take(channel, message, now_s, utc_s)
        out = []
        if self.snapshot.restarts > restarts:
            out.append(Line("flight was started again: a calibration that ran is lost"))
        if channel == "KC_PROGRESS":
            out.append(Line(pose=PoseLine.of(message), n_goal=message.n_goal, first=not self._posed))
            self._posed = True
        elif channel == "KC_EVENT":
            (*_, newest) = (None, *self.snapshot.events(1))
            if newest is not None and newest.seq == message.seq and newest.name not in _QUIET:
                out.append(Line(event=newest))
        elif channel == "KC_PROPOSAL":
            verdict = names.verdict_name(message.verdict)
            out.append(Line(f"correction {crc_text(message.crc)} proposed: {verdict}"))
        elif channel == "KC_HK":
            out += self._heartbeat(now_s)
        return out

    def _heartbeat(self, now_s: float) -> list[Line]:
        state, was = self.snapshot.state, self._state
        self._state = state
        self._ran = self._ran or calibrating(state)
        if state == was:
            return []
        waits = self.snapshot.waits_for(now_s)
        if state in ("REVIEW", "ARMED"):
            self.ended = "a correction waits for people"
        elif self._ran and state in ("IDLE", "SAFE"):
            self.ended = "the calibration has ended"
        out = [] if calibrating(state) and calibrating(was) else [Line(f"state {state}, waits for {waits}")]
        if not was and state in ("IDLE", "SAFE"):
            out.append(Line(_NOTHING_RUNS))
        return out

    def tick(self, now_s: float) -> list[Line]:
        """Time passes: a link that falls silent, or comes back, is said once."""
        age = self.snapshot.freshness("KC_HK", now_s)
        was, self._link = self._link, age.status
        if was in ("", UNKNOWN, age.status):
            return []
        text = (
            "housekeeping comes again" if age.status == FRESH else f"housekeeping is {age.status}: {age.why}"
        )
        return [Line(text)]


def follow(link: CommandLink, snapshot: Snapshot, stop: Callable[[Follower], bool]) -> Iterator[Line]:
    """Lines as they come, until `stop`."""
    found = Follower(snapshot)
    while not stop(found):
        received = link.next(_POLL_S)
        if received is not None:
            yield from found.take(received.channel, received.message, link.clock_s(), time.time())
        yield from found.tick(link.clock_s())
