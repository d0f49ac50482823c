"""The last value of everything that flight said, and how old each is.

A `Snapshot` takes messages and clock readings; it reads no clock and no network. Every value has two ages:
since it was received, and since flight stamped it. Either makes it stale. What was never received is unknown,
which is not the same as stale. After a reconnection or a restart of flight nothing old passes for new: values
from before a restart are stale until flight says them again."""

from __future__ import annotations

import datetime
import math
from collections import deque
from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from kincal.flight import tables
from kincal.flight.events import abort_todo, event_cause, event_names, event_todo
from kincal.link import LogEvent, crc_text, names, unsigned32
from kincal_shared.keys import other_than

if TYPE_CHECKING:
    from kincal.link.messages import Event, Hk, Proposal

FRESH, STALE, UNKNOWN = "fresh", "stale", "unknown"
LISTEN = (
    "KC_ACK", "KC_ARM_STATE", "KC_DETECTION", "KC_EVENT", "KC_HK", "KC_MEAS", "KC_PANTILT_STATE",
    "KC_PROGRESS", "KC_PROPOSAL", "KC_TABLE_DOWN",
)  # fmt: skip
"""Channels that a snapshot is made of."""
MOST_AGE_S: Mapping[str, float] = {"KC_HK": 3.0, "KC_ARM_STATE": 2.0, "KC_PANTILT_STATE": 2.0}
"""What comes at a fixed rate is stale after this time: housekeeping after three periods, states when flight
itself calls their sender silent. The rest comes when there is something to say, and is as fresh as the
link."""
KEEP_EVENTS = 500
SEVERAL = (
    "two senders of housekeeping: its starts, time or numbers go back and forth. Another flight, or a "
    "recording that is replayed, is on this network"
)
_SEVERAL_S = 10.0
_FLIGHT = ("KC_EVENT", "KC_HK", "KC_MEAS", "KC_PROGRESS", "KC_PROPOSAL")  # stamped by flight's own clock
_CALIBRATING_NOT = ("IDLE", "REVIEW", "ARMED", "SAFE", "STORE")
_RAD = 180.0 / math.pi
_STAGES = {0: "nothing", 1: "loading", 2: "complete", 3: "valid"}


@dataclass(frozen=True)
class Last:
    """The newest message of a channel. rx_s: when it was received, by the clock of ages; utc: the same for
    people; n: how many have come; boot: restarts of flight that were seen before it."""

    channel: str
    message: Any
    rx_s: float
    utc: str
    n: int
    boot: int


@dataclass(frozen=True)
class Freshness:
    """How old a value is [s], since it was received and since it was stamped; None where that is not known.
    why: empty where it is fresh."""

    status: str
    receive_age_s: float | None = None
    mission_age_s: float | None = None
    why: str = ""


@dataclass(frozen=True)
class Item:
    """One value of telemetry. text: for people, with its unit; empty if it is unknown."""

    key: str
    label: str
    text: str
    value: Any
    unit: str
    channel: str
    freshness: Freshness


@dataclass(frozen=True)
class EventLine:
    """An event, with what is likely behind it and what to do. utc: when it was received."""

    t_us: int
    utc: str
    seq: int
    severity: str
    id: int
    name: str
    text: str
    cause: str
    action: str


@dataclass(frozen=True)
class Waiting:
    """The correction that waits for the ground; crc: eight hex digits, "" if nothing waits. left_s: until an
    armed approval expires, counted down since the last housekeeping. armed_key: that armed it, 0 if it is not
    known; two_holders: the second step has to come from another holder; go_by: that, in words."""

    crc: str = ""
    verdict: str = ""
    armed: bool = False
    left_s: float = 0.0
    armed_key: int = 0
    two_holders: bool = False
    go_by: str = ""


@dataclass(frozen=True)
class Table:
    """A table in force; crc: "" if there is none of this kind."""

    kind: str
    crc: str


@dataclass(frozen=True)
class Status:
    """All that one screen needs. state: "" if unknown; waits_for: who has to act, a sentence; restarts: of
    flight, since this program listens; lost_events: that flight or the link dropped."""

    utc: str
    state: str
    state_freshness: Freshness
    calibrating: bool
    waits_for: str
    waiting: Waiting
    tables: tuple[Table, ...]
    items: tuple[Item, ...]
    events: tuple[EventLine, ...]
    boot_count: int | None
    restarts: int
    lost_events: int

    def as_dict(self) -> dict[str, Any]:
        """Plain data for --json."""
        return asdict(self)


def utc_text(utc_s: float) -> str:
    """A time of the wall clock [s since 1970] as ISO text with milliseconds."""
    return datetime.datetime.fromtimestamp(utc_s, datetime.UTC).isoformat(timespec="milliseconds")


class Senders:
    """Whether more than one flight is heard: another one on the same network, or a recording that is replayed
    there. Of one flight the starts only grow, and so do the clock from one start to the next and the number
    of a message; either goes back once when a store or a clock was lost, but not again and again. Two flights
    on one machine have the same clock, and as a rule the same number of starts: their messages tell."""

    def __init__(self) -> None:
        self._newest: tuple[int, int, int] | None = None  # starts, time stamp, number
        self._back_s: deque[float] = deque(maxlen=2)  # when they went back
        self.taken = 0  # messages

    def take(self, hk: Hk, now_s: float) -> None:
        """Housekeeping that was received."""
        newest = hk.boot_count, hk.t_us, hk.seq
        if self._newest is not None and _back(newest, self._newest):
            self._back_s.append(now_s)
        self._newest = newest
        self.taken += 1

    def several(self, now_s: float) -> bool:
        """Whether it has gone back and forth lately."""
        return len(self._back_s) == self._back_s.maxlen and now_s - self._back_s[0] < _SEVERAL_S

    def doubtful(self, now_s: float) -> bool:
        """Whether it has gone back at all: who listened for a moment cannot have heard it twice."""
        return bool(self._back_s) and now_s - self._back_s[-1] < _SEVERAL_S


def _back(now: tuple[int, int, int], before: tuple[int, int, int]) -> bool:
    """Whether housekeeping comes from before the one that was received before it, or repeats its number."""
    if now[:2] < before[:2]:
        return True
    same_start = now[0] == before[0]
    return same_start and (now[2] < before[2] or (now[2] == before[2] > 0 and now[1] != before[1]))


class Snapshot:
    """See the module. `take` every message in the order of reception. prismatic: joints, from 1, whose values
    are lengths."""

    def __init__(self, prismatic: Collection[int] = ()) -> None:
        self.prismatic = frozenset(prismatic)
        self.restarts = 0  # of flight, seen
        self.lost_events = 0  # by gaps in their numbers, and by flight's own count
        self._last: dict[str, Last] = {}
        self._events: deque[EventLine] = deque(maxlen=KEEP_EVENTS)
        self._event_seq: int | None = None
        self._gaps = 0
        self._boot: int | None = None
        self._senders = Senders()
        self._offset_us: float | None = None  # largest mission time minus reception
        self._proposals: dict[int, Proposal] = {}

    # ---- inputs

    def take(self, channel: str, message: Any, now_s: float, utc_s: float) -> None:
        """A message that was received; now_s: the clock of ages [s], utc_s: the wall clock [s since 1970]."""
        if channel == "KC_HK":
            self._heartbeat(message)
            self._senders.take(message, now_s)
        if channel in _FLIGHT:
            offset = message.t_us - now_s * 1e6
            self._offset_us = offset if self._offset_us is None else max(self._offset_us, offset)
        if channel == "KC_EVENT":
            self._event(message, utc_s)
        if channel == "KC_PROPOSAL":
            self._proposals[unsigned32(message.crc)] = message
        n = self._last[channel].n + 1 if channel in self._last else 1
        self._last[channel] = Last(channel, message, now_s, utc_text(utc_s), n, self.restarts)

    def _heartbeat(self, hk: Hk) -> None:
        before = self._last.get("KC_HK")
        if self._boot is not None and hk.boot_count != self._boot:
            self.restarts += 1
            self._event_seq = self._offset_us = None
        elif before is not None and hk.t_us < before.message.t_us:
            self._offset_us = None  # flight's clock was set back
        self._boot = hk.boot_count
        self.lost_events = self._gaps + hk.n_events_dropped

    def _event(self, e: Event, utc_s: float) -> None:
        if self._event_seq is not None and e.seq > self._event_seq:
            self._gaps += e.seq - self._event_seq - 1
            self.lost_events += e.seq - self._event_seq - 1
        self._event_seq = e.seq
        self._events.append(event_of(e, utc_text(utc_s)))

    # ---- what is known

    def last(self, channel: str) -> Last | None:
        """The newest message of a channel, however old."""
        return self._last.get(channel)

    @property
    def hk(self) -> Hk | None:
        """The newest housekeeping, however old."""
        last = self._last.get("KC_HK")
        return None if last is None else last.message

    @property
    def state(self) -> str:
        """State by the newest housekeeping, however old; "" if there is none."""
        return "" if self.hk is None else names.state_name(self.hk.state)

    def several(self, now_s: float) -> bool:
        """Whether more than one flight is heard."""
        return self._senders.several(now_s)

    def doubtful(self, now_s: float) -> bool:
        """Whether more than one flight may be heard: not a state to send a command in."""
        return self._senders.doubtful(now_s)

    @property
    def heartbeats(self) -> int:
        """Messages of housekeeping that were taken."""
        return self._senders.taken

    def proposal(self, crc: int) -> Proposal | None:
        """The message of a proposed correction, if it came while this snapshot listened."""
        return self._proposals.get(crc)

    def events(self, n: int) -> tuple[EventLine, ...]:
        """The last n events but those for debugging, the newest last."""
        shown = [e for e in self._events if e.severity != "debug"]
        return tuple(shown[-n:]) if n else ()

    def mission_now_us(self, now_s: float) -> int | None:
        """Flight's clock at a reading of ours, by the message that arrived with the least delay; None if
        flight was never received."""
        return None if self._offset_us is None else round(now_s * 1e6 + self._offset_us)

    def freshness(self, channel: str, now_s: float) -> Freshness:
        """How old the newest message of a channel is."""
        last = self._last.get(channel)
        if last is None:
            return Freshness(UNKNOWN, why="never received since this program listens")
        received = max(now_s - last.rx_s, 0.0)
        mission_us, stamp = self.mission_now_us(now_s), getattr(last.message, "t_us", None)
        stamped = None if mission_us is None or stamp is None else (mission_us - stamp) * 1e-6
        if last.boot < self.restarts:
            return Freshness(STALE, received, stamped, "from before flight was started again")
        if channel not in MOST_AGE_S:
            link = self.freshness("KC_HK", now_s)
            why = "" if link.status == FRESH else f"housekeeping is {link.status}"
            return Freshness(FRESH if not why else STALE, received, stamped, why)
        if channel == "KC_HK" and self._senders.several(now_s):
            return Freshness(STALE, received, stamped, SEVERAL)
        most = MOST_AGE_S[channel]
        if received > most:
            return Freshness(STALE, received, stamped, f"nothing received for {received:.1f} s")
        if stamped is not None and abs(stamped) > most:
            where = "behind" if stamped > 0.0 else "ahead of"
            stamp_text = f"its time stamp is {abs(stamped):.1f} s {where} flight's clock"
            why = f"received {received:.1f} s ago, but {stamp_text}"
            return Freshness(STALE, received, stamped, why)
        return Freshness(FRESH, received, stamped)

    def waiting(self, now_s: float) -> Waiting:
        """The correction that waits, by the newest housekeeping."""
        hk = self.hk
        if hk is None or not hk.proposal_crc:
            return Waiting()
        verdict = names.verdict_name(hk.proposal_verdict) if hk.proposal_verdict else ""
        age_s = now_s - self._last["KC_HK"].rx_s
        left_s = max(hk.approval_left_us * 1e-6 - age_s, 0.0)
        armed, two = self.state == "ARMED", bool(hk.go_by_other_key)
        go_by = other_than(hk.armed_key) if armed and two else ""
        return Waiting(crc_text(hk.proposal_crc), verdict, armed, left_s, hk.armed_key, two, go_by)

    def tables(self) -> tuple[Table, ...]:
        """Tables in force by the newest housekeeping; empty if there is none."""
        hk = self.hk
        if hk is None:
            return ()
        crcs = {kind: hk.table_crc[number] for kind, number in tables.kinds().items()}
        return tuple(Table(kind, crc_text(crc) if crc else "") for kind, crc in crcs.items())

    def status(self, now_s: float, utc_s: float, n_events: int = 8) -> Status:
        """Everything for one screen, at a reading of the two clocks."""
        hk = self.hk
        return Status(
            utc_text(utc_s),
            self.state,
            self.freshness("KC_HK", now_s),
            bool(self.state) and self.state not in _CALIBRATING_NOT,
            self.waits_for(now_s),
            self.waiting(now_s),
            self.tables(),
            self.items(now_s),
            self.events(n_events),
            None if hk is None else hk.boot_count,
            self.restarts,
            self.lost_events,
        )

    def items(self, now_s: float) -> tuple[Item, ...]:
        """Every value with its age; those never received too."""
        ages = {channel: self.freshness(channel, now_s) for channel in {row[3] for row in _ITEMS}}
        out = []
        for key, label, unit, channel, value_of, text_of in _ITEMS:
            last = self._last.get(channel)
            value = None if last is None else value_of(last.message)
            text = "" if last is None else text_of(last.message, self.prismatic)
            out.append(Item(key, label, text, value, unit, channel, ages[channel]))
        return tuple(out)

    def waits_for(self, now_s: float) -> str:
        """Who has to act, a sentence."""
        age, state, waits = self.freshness("KC_HK", now_s), self.state, self.waiting(now_s)
        if age.status == UNKNOWN:
            return "not known: no housekeeping received; is flight running on this URL?"
        if age.status == STALE:
            return f"not known: {age.why}; the last state was {state}"
        if state == "REVIEW":
            return f"the ground: decide on correction {waits.crc} ({waits.verdict or 'verdict not known'})"
        if state == "ARMED":
            by = f" with {waits.go_by}" if waits.go_by else ""
            return (
                f"the ground: second step for correction {waits.crc}{by}, or it expires in "
                f"{waits.left_s:.0f} s"
            )
        if state in _FREE:
            return f"a command: {_FREE[state]}; {self._start_possible(now_s)}"
        return _WAITS_FOR.get(state, "flight: it computes")

    def _start_possible(self, now_s: float) -> str:
        """Whether arm and pan-tilt unit let a calibration begin, as far as is known."""
        for channel, who in (("KC_ARM_STATE", "arm controller"), ("KC_PANTILT_STATE", "pan-tilt unit")):
            age = self.freshness(channel, now_s)
            listened = self._last["KC_HK"].n > 1  # long enough to have heard it
            if age.status == STALE or (age.status == UNKNOWN and listened):
                return f"START would be refused: the {who} is silent ({age.why})"
        arm = self._last.get("KC_ARM_STATE")
        if arm is not None and arm.message.fault_mask:
            mask = f"{arm.message.fault_mask:#x}"
            return f"START would be refused: the arm controller reports a fault, mask {mask}"
        return "START begins a calibration"


def calibrating(state: str) -> bool:
    """Whether a state is one of a calibration that runs."""
    return bool(state) and state not in _CALIBRATING_NOT


_FREE = {"IDLE": "nothing runs", "SAFE": "the arm is held"}
_WAITS_FOR = {
    "STORE": "flight: a change is being stored",
    **dict.fromkeys(("MOVE", "SERVO", "SEED", "RETREAT", "WITHDRAW", "APPROACH"), "the arm: to arrive"),
    **dict.fromkeys(("AIM", "TURN"), "the pan-tilt unit: to arrive"),
    **dict.fromkeys(("SETTLE", "REST"), "arm and pan-tilt unit: to come to rest"),
    **dict.fromkeys(("OBSERVE", "SEARCH", "MEASURE"), "the camera: a frame was requested"),
}


def event_of(e: Event, utc: str = "") -> EventLine:
    """An event with cause and action."""
    line = LogEvent.of(e)
    text = line.text.partition(": ")[2]
    cause, todo = event_cause(e.id), event_todo(e.id)
    if line.name == "CAL_ABORTED" and math.isfinite(e.got):
        cause, todo = event_names()["cause"].get(int(e.got), cause), abort_todo(int(e.got)) or todo
    return EventLine(e.t_us, utc, e.seq, line.severity, e.id, line.name, text, cause, todo)


# ---- values of telemetry: key, label, unit, channel, value, text

Prismatic = frozenset[int]


def _joint_text(value: float, prismatic: bool, digits: str = ".2f") -> str:
    return f"{value * 1e3:{digits}} mm" if prismatic else f"{value * _RAD:{digits}} deg"


def _monitor(hk: Hk, prismatic: Prismatic) -> str:
    if hk.mon_state == 1:
        slide = hk.mon_joint in prismatic
        bias, sigma = _joint_text(hk.mon_bias, slide, ".3g"), _joint_text(hk.mon_sigma, slide, ".2g")
        return f"joint {hk.mon_joint} reads wrong by {bias} ± {sigma}"
    if hk.mon_state == 3:
        sure = ", ".join(f"{j} ({p:.0%})" for j, p in enumerate(hk.mon_chance, 1) if p >= 0.01)
        return f"joints read wrong together; probability of each: {sure}"
    return "quiet" if hk.mon_state == 0 else "unexplained error"


def _staged(hk: Hk, _: Prismatic) -> str:
    if not hk.staged_kind:
        return "nothing"
    kind = next(
        (k for k, number in tables.kinds().items() if number == hk.staged_kind), f"kind {hk.staged_kind}"
    )
    return f"{kind}, {hk.staged_bytes} bytes, {_STAGES.get(hk.staged_state, f'?{hk.staged_state}')}"


def _joints(m: Any, prismatic: Prismatic) -> str:
    q = enumerate(m.q_rad[: m.n_joints], 1)
    return ", ".join(_joint_text(value, joint in prismatic) for joint, value in q)


def _n_tags(m: Any, _: Prismatic) -> str:
    ids = ", ".join(str(i) for i in m.tag_id[: m.n_tags])
    return f"{m.n_tags}" + (f" ({ids})" if m.n_tags else "")


def _pose(hk: Hk, _: Prismatic) -> str:
    included = ", local initial poses included" if hk.n_poses_goal else ""
    return f"{hk.n_poses} of {hk.n_poses_goal}{included}"


def _yes(x: int) -> str:
    return "moving" if x else "at rest"


_Row = tuple[str, str, str, str, Callable[[Any], Any], Callable[[Any, Prismatic], str]]


def _plain(key: str, label: str, unit: str, channel: str, field: str) -> _Row:
    """A whole number as it is."""
    return key, label, unit, channel, lambda m: getattr(m, field), lambda m, _: str(getattr(m, field))


_ITEMS: tuple[_Row, ...] = (
    ("state", "state", "", "KC_HK", lambda m: m.state, lambda m, _: names.state_name(m.state)),
    (
        "mission_time", "mission time", "s", "KC_HK", lambda m: m.t_us * 1e-6,
        lambda m, _: f"{m.t_us * 1e-6:.1f} s",
    ),
    _plain("session", "calibration", "", "KC_HK", "session"),
    ("poses", "poses measured", "", "KC_HK", lambda m: m.n_poses, _pose),
    _plain("candidate", "candidate", "", "KC_HK", "candidate"),
    _plain("boots", "starts of flight", "", "KC_HK", "boot_count"),
    _plain("commands_ok", "commands accepted", "", "KC_HK", "n_cmd_ok"),
    _plain("commands_refused", "commands refused", "", "KC_HK", "n_cmd_refused"),
    _plain("events_dropped", "events dropped on board", "", "KC_HK", "n_events_dropped"),
    _plain("rx_errors", "receive errors on board", "", "KC_HK", "n_rx_errors"),
    _plain("tx_errors", "send errors on board", "", "KC_HK", "n_tx_errors"),
    ("energy", "energy since START", "J", "KC_HK", lambda m: m.energy_j, lambda m, _: f"{m.energy_j:.0f} J"),
    ("monitor", "monitor", "", "KC_HK", lambda m: m.mon_state, _monitor),
    ("staged", "staged table", "", "KC_HK", lambda m: m.staged_kind, _staged),
    ("joints", "joints", "rad", "KC_ARM_STATE", lambda m: list(m.q_rad[: m.n_joints]), _joints),
    ("arm_moving", "arm", "", "KC_ARM_STATE", lambda m: bool(m.moving), lambda m, _: _yes(m.moving)),
    (
        "arm_fault", "arm fault mask", "", "KC_ARM_STATE", lambda m: m.fault_mask,
        lambda m, _: f"{m.fault_mask:#x}",
    ),
    (
        "pantilt", "pan, tilt", "rad", "KC_PANTILT_STATE", lambda m: [m.pan_rad, m.tilt_rad],
        lambda m, _: f"{m.pan_rad * _RAD:.2f} {m.tilt_rad * _RAD:.2f} deg",
    ),
    (
        "pantilt_moving", "pan-tilt unit", "", "KC_PANTILT_STATE", lambda m: bool(m.moving),
        lambda m, _: _yes(m.moving),
    ),
    ("tags", "tags in the last frame", "", "KC_DETECTION", lambda m: m.n_tags, _n_tags),
    (
        "residual", "last pose against prediction", "m", "KC_PROGRESS", lambda m: m.res_pos_m,
        lambda m, _: f"{m.res_pos_m * 1e3:.2f} mm, {m.res_rot_rad * _RAD:.3f} deg",
    ),
    (
        "predicted", "predicted sigma", "m", "KC_PROGRESS", lambda m: m.pred_pos_m,
        lambda m, _: f"{m.pred_pos_m * 1e3:.2f} mm, {m.pred_rot_rad * _RAD:.3f} deg",
    ),
)  # fmt: skip
