"""LCM for the simulator's processes: publishing with a count, and the lockstep side of a participant.

Lockstep: the simulator publishes its sensor messages of a tick, then KC_TIME; every participant handles
what is due, publishes its answers stamped with the time of the tick, then KC_TICK_DONE. A message from
another participant is handled at the first tick whose time is later than its stamp, in the order of
channel and sequence number, so that the order of arrival never matters.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable

import lcm

import kcm

LEAVE = -1  # KC_TICK_DONE.tick of a participant that goes away
HELLO_S = 0.1  # wall time between announcements before the first tick
TYPES = {
    "KC_TIME": kcm.time_t,
    "KC_TICK_DONE": kcm.tick_done_t,
    "KC_ARM_STATE": kcm.arm_state_t,
    "KC_ARM_CMD": kcm.arm_cmd_t,
    "KC_PANTILT_STATE": kcm.pantilt_state_t,
    "KC_PANTILT_CMD": kcm.pantilt_cmd_t,
    "KC_FRAME_REQUEST": kcm.frame_request_t,
    "KC_IMAGE": kcm.image_t,
    "KC_DETECTION": kcm.detection_t,
    "KC_CMD": kcm.cmd_t,
    "KC_ACK": kcm.ack_t,
    "KC_TABLE_UP": kcm.table_chunk_t,
    "KC_TABLE_DOWN": kcm.table_chunk_t,
    "KC_EVENT": kcm.event_t,
    "KC_HK": kcm.hk_t,
    "KC_MEAS": kcm.meas_t,
    "KC_PROGRESS": kcm.progress_t,
    "KC_PROPOSAL": kcm.proposal_t,
    "KC_SIM_TRUTH": kcm.sim_truth_t,
}


class Bus:
    """An LCM connection that decodes what it hears and counts what it says."""

    def __init__(self, url: str):
        self.lcm = lcm.LCM(url)
        self.n_published = 0
        self.n_rx_errors = 0

    def listen(self, channel: str, handler: Callable) -> None:
        """Call handler(channel, message) for every message; undecodable ones are only counted."""

        def on(ch: str, data: bytes) -> None:
            try:
                message = TYPES[channel].decode(data)
            except (ValueError, struct.error) as e:
                self.n_rx_errors += 1
                print(f"{ch}: message dropped: {e}", flush=True)
                return
            handler(ch, message)

        # LCM's own queue of 30 drops what a slow reader misses; nothing may be dropped here.
        self.lcm.subscribe(channel, on).set_queue_capacity(0)

    def publish(self, channel: str, message) -> None:
        self.lcm.publish(channel, message.encode())
        self.n_published += 1

    def wait(self, seconds: float) -> bool:
        """Handle one message, waiting at most so long."""
        return bool(self.lcm.handle_timeout(max(0, int(seconds * 1000))))


class Participant:
    """One lockstep (or live) process that listens to channels and acts at ticks.

    act(now_us, messages) is called once a tick with the due (channel, message) pairs and publishes through
    `bus`; it gives False when it is done for good.
    """

    def __init__(self, bus: Bus, who: int, channels: list[str], act: Callable[[int, list], bool]):
        self.bus, self.who, self.act = bus, who, act
        self.queue: list[tuple[str, object]] = []
        self.last = kcm.tick_done_t()
        self.last.who = who
        self.alive = True
        for channel in channels:
            bus.listen(channel, lambda ch, m: self.queue.append((ch, m)))

    def run_lockstep(self) -> None:
        """Announce until the first tick, then answer ticks until act() says stop."""
        self.bus.listen("KC_TIME", self._on_time)
        while self.alive:
            if self.last.tick == 0:
                self.bus.publish("KC_TICK_DONE", self.last)
            self.bus.wait(HELLO_S if self.last.tick == 0 else 1.0)

    def run_live(self, period_s: float = 0.1) -> None:
        """Act at a steady rate on the wall clock; messages are due as soon as they are here."""
        due = time.monotonic()
        while self.alive:
            due += period_s
            while (left := due - time.monotonic()) > 0:
                self.bus.wait(left)
            self._act(time.time_ns() // 1000, 1 << 62)
        self._leave()

    def _on_time(self, _: str, t) -> None:
        if not self.alive:
            return
        if t.tick > self.last.tick:
            before = self.bus.n_published
            self._act(t.now_us, t.now_us)
            self.last.tick, self.last.n_published = t.tick, self.bus.n_published - before
        if self.alive:
            self.bus.publish("KC_TICK_DONE", self.last)
        else:
            self._leave()

    def _act(self, now_us: int, before_us: int) -> None:
        due = [m for m in self.queue if m[1].t_us < before_us]
        self.queue = [m for m in self.queue if m[1].t_us >= before_us]
        due.sort(key=lambda m: (m[0], m[1].t_us, getattr(m[1], "seq", 0)))
        self.alive = self.act(now_us, due)

    def _leave(self) -> None:
        """Say that nobody needs to wait for this process any more."""
        done = kcm.tick_done_t()
        done.tick, done.who, done.n_published = LEAVE, self.who, self.last.n_published
        self.bus.publish("KC_TICK_DONE", done)
