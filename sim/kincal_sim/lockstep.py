"""Lockstep: mission time that waits for everybody.

The simulator publishes its sensor messages of a tick, then KC_TIME; every participant handles what is due,
publishes its answers stamped with the time of the tick, then KC_TICK_DONE. A message from another participant
is handled at the first tick whose time is later than its stamp, in the order of channel and sequence number,
so that the order of arrival never matters.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import kcm

from .bus import Bus

LEAVE = -1  # KC_TICK_DONE.tick of a participant that goes away
ANNOUNCE_S = 0.1  # wall time between announcements before the first tick
REPEAT_S = 1.0  # wall time after which a tick is announced again
REPEATS_MAX = 120  # then a participant that does not answer counts as dead
START_WAIT_S = 60.0
ALL_DUE_US = 1 << 62
WHO = {
    "fsw": kcm.tick_done_t.WHO_FSW,
    "detector": kcm.tick_done_t.WHO_DETECTOR,
    "executive": kcm.tick_done_t.WHO_EXECUTIVE,
}

Received = tuple[str, Any]  # channel, message


class ParticipantTimeout(RuntimeError):
    """A participant did not answer."""


class Inbox:
    """Messages of others wait here until they are due, and leave in canonical order."""

    def __init__(self) -> None:
        self._waiting: list[Received] = []

    def __bool__(self) -> bool:
        return bool(self._waiting)

    def put(self, channel: str, message: Any) -> None:
        """A message has arrived."""
        self._waiting.append((channel, message))

    def take(self, before_us: int) -> list[Received]:
        """What was stamped before this time, in the order of channel, stamp and sequence number."""
        if not self._waiting:
            return []
        due = [m for m in self._waiting if m[1].t_us < before_us]
        self._waiting = [m for m in self._waiting if m[1].t_us >= before_us]
        return sorted(due, key=lambda m: (m[0], m[1].t_us, getattr(m[1], "seq", 0)))


class Participant:
    """One lockstep (or live) process that listens to channels and acts at ticks.

    who: number in KC_TICK_DONE. act(now_us, messages) is called once a tick with the due (channel, message)
    pairs and publishes through `bus`; it gives False when the process is done.
    """

    def __init__(self, bus: Bus, who: int, channels: list[str], act: Callable[[int, list[Received]], bool]):
        self.bus, self.who, self.act = bus, who, act
        self.alive = True
        self._inbox = Inbox()
        self._done = kcm.tick_done_t()  # answer to the last tick
        self._done.who = who
        for channel in channels:
            bus.listen(channel, self._inbox.put)

    def run_lockstep(self) -> None:
        """Announce until the first tick, then answer ticks until act() says stop."""
        self.bus.listen("KC_TIME", self._on_time)
        while self.alive:
            if self._done.tick == 0:
                self.bus.publish("KC_TICK_DONE", self._done)
            self.bus.wait(ANNOUNCE_S if self._done.tick == 0 else 1.0)

    def run_live(self, period_s: float = 0.1) -> None:
        """Act at a steady rate on the wall clock; messages are due as soon as they are here."""
        due = time.monotonic()
        while self.alive:
            due += period_s
            while (left := due - time.monotonic()) > 0:
                self.bus.wait(left)
            self._act(time.time_ns() // 1000, ALL_DUE_US)
        self._leave()

    def _on_time(self, _: str, t: kcm.time_t) -> None:
        if not self.alive:
            return
        if t.tick > self._done.tick:
            before = self.bus.n_published
            self._act(t.now_us, t.now_us)
            self._done.tick, self._done.n_published = t.tick, self.bus.n_published - before
        if self.alive:
            self.bus.publish("KC_TICK_DONE", self._done)
        else:
            self._leave()

    def _act(self, now_us: int, before_us: int) -> None:
        self.alive = self.act(now_us, self._inbox.take(before_us))

    def _leave(self) -> None:
        """Announce that nobody needs to wait for this process any more."""
        left = kcm.tick_done_t()
        left.tick, left.who, left.n_published = LEAVE, self.who, self._done.n_published
        self.bus.publish("KC_TICK_DONE", left)


class LockstepClock:
    """Time as fast as everybody can follow: the next tick comes when all have done this one.

    who: numbers of the participants to wait for; left: those that have gone since.
    """

    def __init__(self, bus: Bus, who: set[int]):
        self.bus, self.who = bus, set(who)
        self.left: set[int] = set()
        self._done: dict[int, int] = {}
        bus.listen("KC_TICK_DONE", self._on_done)

    def wait_for_all(self) -> None:
        """Until every participant has announced itself. Raises ParticipantTimeout."""
        deadline = time.monotonic() + START_WAIT_S
        while self._missing(0):
            self.bus.wait(0.5)
            if time.monotonic() > deadline:
                raise ParticipantTimeout(f"nothing received from {self._names(0)} for {START_WAIT_S:g} s")

    def tick(self, tick: int, now_us: int) -> None:
        """Announce a tick and wait until all have done it; repeated, because datagrams can get lost.

        Raises ParticipantTimeout."""
        t = kcm.time_t()
        t.tick, t.now_us = tick, now_us
        for _ in range(REPEATS_MAX):
            self.bus.publish("KC_TIME", t)
            deadline = time.monotonic() + REPEAT_S
            while self._missing(tick) and (left := deadline - time.monotonic()) > 0.0:
                self.bus.wait(left)
            if not self._missing(tick):
                return
        raise ParticipantTimeout(f"tick {tick} was not answered by {self._names(tick)}")

    def _on_done(self, _: str, m: kcm.tick_done_t) -> None:
        if m.tick == LEAVE:
            self.left.add(m.who)
        else:
            self._done[m.who] = max(m.tick, self._done.get(m.who, -1))

    def _missing(self, tick: int) -> set[int]:
        return {w for w in self.who - self.left if self._done.get(w, -1) < tick}

    def _names(self, tick: int) -> str:
        return ", ".join(name for name, w in WHO.items() if w in self._missing(tick))
