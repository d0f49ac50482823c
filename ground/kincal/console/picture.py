"""Everything known about flight at one moment, and what changed since another.

A browser gets a snapshot first, then changes: of each value only the newest, of events and acknowledgements
every one. The picture keeps one message of each channel, so it does not grow; of the log of events it keeps
the newest KEPT rows, and says how many came before them."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import islice
from typing import TYPE_CHECKING, Any

from kincal.flight import event_name
from kincal.link import LogEvent, LogSummary, Session, crc_text, unsigned32
from kincal.operate.commands import END_OTHER
from kincal.operate.snapshot import SEVERAL, Senders
from kincal.review import kin_crc
from kincal_shared.errors import KincalError

from . import words
from .geometry import Geometry
from .words import Plain

if TYPE_CHECKING:
    from kincal.link.messages import Hk, Proposal

KEPT = 20_000
_JUMP_S = 1.0
_REPORT_S = 60.0
SNAPSHOT_ROWS = 1_000  # of the log in a snapshot; older ones are asked for page by page
PROPOSALS = 50
# channel -> seconds between two messages, where they come regularly: after three of them a value is stale
PERIOD_S = {"KC_HK": 1.0, "KC_ARM_STATE": 0.5, "KC_PANTILT_STATE": 0.5}
LISTEN = (
    *("KC_HK", "KC_EVENT", "KC_ACK", "KC_PROGRESS", "KC_PROPOSAL", "KC_ARM_STATE", "KC_PANTILT_STATE"),
    *("KC_DETECTION", "KC_ARM_CMD", "KC_MEAS"),
)
MOST_JPEG = 1 << 20  # bytes of a frame; flight's are at most 120 kB
# events that say what became of a correction (kincal.review.status)
_ROWS: dict[str, Callable[[Any], Plain]] = {"KC_EVENT": words.event, "KC_ACK": words.ack}
_ABOUT_CORRECTIONS = ("COR_", "CAL_OUTLIER")


class Clock:
    """UTC since 1970 [s], by a clock that only goes forward, also while the machine sleeps: ages stay right
    when the machine's own is set."""

    def __init__(
        self, wall: Callable[[], float] = time.time, steady: Callable[[], float] | None = None
    ) -> None:
        self._wall, self._steady = wall, steady or (lambda: time.clock_gettime(time.CLOCK_BOOTTIME))
        self._offset_s = self._wall() - self._steady()

    def __call__(self) -> float:
        """Now."""
        return self._steady() + self._offset_s

    def jump_s(self) -> float:
        """By how much the machine's clock was set since this was asked last; from now on this one follows."""
        jump_s = self._wall() - self()
        if abs(jump_s) < _JUMP_S:
            return 0.0
        self._offset_s += jump_s
        return jump_s


def jpeg_of(image: Any) -> bytes | None:
    """The JPEG of a KC_IMAGE, None if it holds none."""
    if image.n_bytes > MOST_JPEG:
        return None
    data = bytes(image.jpeg)
    return data if data.startswith(b"\xff\xd8\xff") else None


def _own_values(message: Proposal) -> bool:
    """Whether a proposal describes the table that its CRC names."""
    try:
        return kin_crc(message) == unsigned32(message.crc)
    except KincalError:
        return False


@dataclass
class _Value:
    """Newest message of a channel. version: of the picture when it came; received_s: UTC since 1970."""

    version: int
    received_s: float
    message: Any


@dataclass
class Cursor:
    """What a browser has: version of the values, number of the next row of the log."""

    version: int = 0
    row: int = 0


@dataclass
class Picture:
    """Filled by one thread, read by others. clock: UTC since 1970 [s]."""

    geometry: Geometry
    clock: Clock = field(default_factory=Clock)
    version: int = 0
    t_us: int = 0  # newest mission time
    rows: deque[Plain] = field(default_factory=lambda: deque(maxlen=KEPT))
    n_rows: int = 0
    proposals: dict[int, Proposal] = field(default_factory=dict)
    disputed: set[int] = field(default_factory=set)  # CRCs of which two messages say different things
    _values: dict[str, _Value] = field(default_factory=dict)
    _poses: _Value | None = None
    _sessions: dict[int, Session] = field(default_factory=dict)
    _events: deque[LogEvent] = field(default_factory=lambda: deque(maxlen=KEPT))
    _senders: Senders = field(default_factory=Senders)
    _reported_s: float = -math.inf  # when it was last said that there are several senders
    _lock: threading.Lock = field(default_factory=threading.Lock)

    # ---- filling

    def add(self, channel: str, message: Any, received_s: float | None = None) -> None:
        """Take one message."""
        received = self.clock() if received_s is None else received_s
        row = _ROWS.get(channel)
        with self._lock:
            self.version += 1
            self.t_us = getattr(message, "t_us", self.t_us)
            if row is not None:
                self._add_row({**row(message), "received_s": round(received, 3)})
            else:
                self._values[channel] = _Value(self.version, received, message)
            if channel == "KC_HK":
                self._several(message, received)
            if channel == "KC_EVENT" and event_name(message.id).startswith(_ABOUT_CORRECTIONS):
                self._events.append(LogEvent.of(message))
            elif channel == "KC_PROGRESS":
                self._add_pose(message, received)
            elif channel == "KC_MEAS":
                self._add_measurement(message)
            elif channel == "KC_PROPOSAL":
                self._add_proposal(message)

    def note(self, severity: str, name: str, text: str) -> None:
        """A row of the console's own."""
        with self._lock:
            self._note(severity, name, text)

    def _note(self, severity: str, name: str, text: str) -> None:
        self.version += 1
        self._add_row({"kind": "console", "t_us": self.t_us, "severity": severity, "name": name,
                       "text": text, "received_s": round(self.clock(), 3)})  # fmt: skip

    def follow_clock(self) -> None:
        """Ages stay what they are when the clock of this machine is set: times of reception go with it."""
        with self._lock:
            if not (jump_s := self.clock.jump_s()):
                return
            for value in (*self._values.values(), *([self._poses] if self._poses else ())):
                value.received_s += jump_s
                value.version = self.version + 1
            self._note(
                "warning",
                "CLOCK_SET",
                f"the clock of this machine was set by {jump_s:+.0f} s; ages are right",
            )

    def _several(self, hk: Hk, now_s: float) -> None:
        """Says once in a while that two flights are heard."""
        self._senders.take(hk, now_s)
        if self._senders.several(now_s) and now_s - self._reported_s > _REPORT_S:
            self._reported_s = now_s
            self._note("error", "TWO_SENDERS", f"{SEVERAL}. To do: {END_OTHER}")

    def _add_row(self, row: Plain) -> None:
        self.rows.append({"n": self.n_rows, **row})
        self.n_rows += 1

    def _add_pose(self, message: Any, received: float) -> None:
        session = self._sessions.setdefault(message.session, Session(message.session))
        if message.pose <= len(session.progress):  # flight began to count anew after a restart
            session.progress.clear()
        session.progress.append(message)
        for old in sorted(self._sessions)[:-PROPOSALS]:
            del self._sessions[old]
        self._poses = _Value(self.version, received, session)

    def _add_measurement(self, message: Any) -> None:
        session = self._sessions.setdefault(message.session, Session(message.session))
        kept = session.measurements
        if kept and (message.observation, message.pose) < (kept[-1].observation, kept[-1].pose):
            kept.clear()  # the calibration began again, or flight did after a restart
        session.measure(message)

    def _add_proposal(self, message: Proposal) -> None:
        if not _own_values(message):  # it must not stand in for the one that waits under this CRC
            text = f"a message on this network names correction {crc_text(message.crc)}, and has other values"
            self._note("error", "WRONG_PROPOSAL", f"{text}: it is not shown")
            return
        session = self._sessions.setdefault(message.session, Session(message.session))
        session.propose(message)
        if session.disputed:
            text = f"two messages of correction {crc_text(message.crc)} say different things of it"
            self._note("error", "WRONG_PROPOSAL", f"{text}: nobody can decide by them")
            self.disputed.add(unsigned32(message.crc))
            return
        self.proposals.pop(message.crc, None)
        self.proposals[message.crc] = message
        for old in list(self.proposals)[:-PROPOSALS]:
            del self.proposals[old]

    # ---- reading

    def proposal(self, crc: str) -> Proposal | None:
        """The proposal with these eight hex digits."""
        with self._lock:
            return next((p for p in self.proposals.values() if crc_text(p.crc) == crc), None)

    def heard_proposals(self) -> list[Proposal]:
        """All proposals that are held, oldest first."""
        with self._lock:
            return list(self.proposals.values())

    def summary(self) -> LogSummary:
        """What was heard as the summary of a log: sessions, what became of corrections, last housekeeping."""
        with self._lock:
            hk = self._values.get("KC_HK")
            out = LogSummary(self.geometry.tables.path, events=list(self._events))
            out.sessions = {
                n: Session(n, list(s.progress), list(s.measurements), s.proposal, s.disputed)
                for n, s in self._sessions.items()
            }
            out.hk = hk.message if hk else None
            return out

    def newest(self, channel: str) -> Any:
        """Newest message of a channel, None if there is none."""
        with self._lock:
            value = self._values.get(channel)
            return value.message if value else None

    def several(self) -> bool:
        """Whether more than one flight is heard."""
        with self._lock:
            return self._senders.several(self.clock())

    def jpeg(self, seq: int) -> bytes | None:
        """The newest frame of the camera, if it has this number and is a JPEG."""
        image = self.newest("KC_IMAGE")
        return None if image is None or image.seq != seq else jpeg_of(image)

    def snapshot(self) -> tuple[Plain, Cursor]:
        """All last values and the newest rows of the log, and the cursor from which changes go on."""
        with self._lock:
            cursor = Cursor(0, max(self.n_rows - SNAPSHOT_ROWS, 0))
            body = self._since(cursor)
        first = body["rows"][0]["n"] if body["rows"] else self.n_rows
        return {"kind": "snapshot", **body, "first_row": first, "periods_s": PERIOD_S}, cursor

    def changes(self, cursor: Cursor) -> Plain | None:
        """What is new since the cursor, which moves on; None if nothing is."""
        self.follow_clock()
        with self._lock:
            if self.version == cursor.version:
                return None
            return {"kind": "changes", **self._since(cursor)}

    def page(self, before: int, count: int) -> list[Plain]:
        """Rows of the log before a number, oldest first."""
        with self._lock:
            kept_from = self.n_rows - len(self.rows)
            end = min(max(before - kept_from, 0), len(self.rows))
            return list(islice(self.rows, max(end - count, 0), end))

    def _since(self, cursor: Cursor) -> Plain:
        kept_from = self.n_rows - len(self.rows)
        lost = max(kept_from - cursor.row, 0)  # said to a browser that is slower than KEPT rows
        start = max(cursor.row, kept_from) - kept_from
        rows = list(islice(self.rows, start, None))
        values = {name: v for name, v in self._values.items() if v.version > cursor.version}
        if self._poses is not None and self._poses.version > cursor.version:
            values["poses"] = self._poses
        changed = {}
        for name, v in values.items():
            data, t_us = self._plain(name, v.message), getattr(v.message, "t_us", None)
            if data is not None:
                changed[name] = {"received_s": round(v.received_s, 3), "t_us": t_us, "data": data}
        if "KC_PROPOSAL" in values or cursor.version == 0:
            inbox = [words.proposal(p) for p in reversed(self.proposals.values())]
            changed["inbox"] = {"received_s": round(self.clock(), 3), "t_us": None, "data": inbox}
        cursor.version, cursor.row = self.version, self.n_rows
        return {
            "now_s": round(self.clock(), 3),
            "t_us": self.t_us,
            "values": changed,
            "rows": rows,
            "rows_lost": lost,
            "kept_from": kept_from,
        }

    def _plain(self, name: str, message: Any) -> Any:
        if name == "KC_HK":
            hk = words.housekeeping(message)
            if self._senders.several(self.clock()):
                hk |= {"text": f"NOT KNOWN: {SEVERAL}.", "waits_for": "operator", "several": SEVERAL}
            return {**hk, "tables_differ": words.table_mismatch(hk, self.geometry.crcs)}
        if name == "KC_ARM_STATE":
            return {
                **words.arm_state(message, self.geometry.joints),
                "points_m": self.geometry.points(message),
                "corrected_m": self._corrected(message),
            }
        if name == "KC_PANTILT_STATE":
            return {**words.pantilt(message), "view_m": self.geometry.view(message)}
        if name == "KC_DETECTION":
            return {**words.detection(message), "image_px": self.geometry.image_px}
        if name == "KC_IMAGE":
            return words.frame(message)
        if name == "poses":
            return [words.pose(p) for p in message.progress]
        return None

    def _corrected(self, message: Any) -> list[list[float]] | None:
        """The arm as the correction that waits has it."""
        hk = self._values.get("KC_HK")
        waits = hk.message.proposal_crc if hk else 0
        proposal = self.proposals.get(waits) if waits else None
        return self.geometry.points(message, proposal) if proposal is not None else None
