"""What an LCM log holds: channels, sessions, poses, events, proposals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kincal.flight import event_line, event_name, library
from kincal.rotations import Floats
from kincal_shared.errors import BadInput

from . import channels, names
from .eventfile import EventFile, FileEvent

if TYPE_CHECKING:
    from .messages import Ack, Cmd, Event, Hk, LcmMessage, Meas, Progress, Proposal

_IMAGE = "KC_IMAGE"
SKIP = frozenset({_IMAGE})  # large and of no use to a summary
MOST_NUMBERS = 5
"""Of damaged events, that are kept for each channel."""
TIMED = {"KC_HK", "KC_EVENT", "KC_PROGRESS"}  # say how long the mission lasted
STATES = {"KC_ARM_STATE", "KC_PANTILT_STATE"}  # most messages; only counted


@dataclass(frozen=True)
class LogEvent:
    """An event in words; t_us: mission time; name: without its prefix; index, got: what it is about, as
    EVENTS.md says for each event."""

    t_us: int
    severity: str
    id: int
    text: str
    name: str = ""
    index: int = -1
    got: float = 0.0

    @classmethod
    def of(cls, event: Event) -> LogEvent:
        """From its message."""
        text = event_line(event.id, event.index, event.got, event.want)
        severity = names.severity_name(event.severity)
        return cls(event.t_us, severity, event.id, text, event_name(event.id), event.index, event.got)

    def as_dict(self) -> dict[str, Any]:
        """Plain data for --json."""
        return {"t_us": self.t_us, "severity": self.severity, "id": self.id, "text": self.text}


@dataclass
class Session:
    """One calibration: messages in order."""

    number: int
    progress: list[Progress] = field(default_factory=list)
    measurements: list[Meas] = field(default_factory=list)
    proposal: Proposal | None = None
    disputed: bool = False  # another message of the same correction says something else of it

    def propose(self, m: Proposal) -> None:
        """Take a proposal. Flight says one thing of a correction: where two messages differ, a stranger
        sent one of them, and the first one stays."""
        if self.proposal is not None and self.proposal.crc == m.crc:
            self.disputed |= not alike(self.proposal, m)
        else:
            self.proposal, self.disputed = m, False

    def went_on(self, m: Progress) -> None:
        """Add a pose. If there was one with its number, the calibration began again there."""
        self.progress = [*(p for p in self.progress if p.pose < m.pose), m]

    def measure(self, meas: Meas) -> None:
        """Take a measurement; it replaces one with its number, at the same place or of an earlier beginning.
        Number 0: none was given."""
        number = meas.observation
        held = [m for m in self.measurements if not number or m.observation != number]
        self.measurements = [*held, meas]

    @property
    def at_poses(self) -> list[Meas]:
        """Measurements of the poses, without those on the way to them."""
        at = library("flight").constant("KC_AT_CANDIDATE")
        return [m for m in self.measurements if m.taken_at == at]

    def as_dict(self) -> dict[str, Any]:
        """Plain data for --json."""
        return {
            "session": self.number,
            "poses": len(self.progress),
            "measurements": len(self.measurements),
            "last_pred_pos_m": self.progress[-1].pred_pos_m if self.progress else None,
            "proposal": None if self.proposal is None else proposal_dict(self.proposal),
        }


def alike(one: Proposal, other: Proposal) -> bool:
    """Whether two messages of a correction say the same; its CRC covers the values and their sigmas alone."""
    fields: tuple[str, ...] = getattr(type(one), "__slots__", ())
    return all(getattr(one, name) == getattr(other, name) for name in fields)


def proposal_dict(proposal: Proposal) -> dict[str, Any]:
    """What --json says of a proposed correction."""
    copied = ("rank", "n_free", "p_fit", "p_no_change", "fit_pos_m", "before_pos_m")
    return {
        "crc": channels.crc_text(proposal.crc),
        "verdict": names.verdict_name(proposal.verdict),
        **{name: getattr(proposal, name) for name in copied},
    }


@dataclass
class LogSummary:
    """A log: how many messages on each channel, how many of them damaged, and what they say."""

    path: Path
    n_messages: int = 0
    counts: Counter[str] = field(default_factory=Counter)
    undecodable: Counter[str] = field(default_factory=Counter)
    undecodable_at: dict[str, list[int]] = field(default_factory=dict)
    """By channel, the numbers of the first events whose messages are damaged."""
    damaged: int = 0  # places of the file that hold no message
    t_first_us: int | None = None
    t_last_us: int | None = None
    sessions: dict[int, Session] = field(default_factory=dict)
    events: list[LogEvent] = field(default_factory=list)
    acks: list[Ack] = field(default_factory=list)
    commands: list[Cmd] = field(default_factory=list)
    hk: Hk | None = None  # the last one

    @property
    def mission_s(self) -> float:
        """Mission time from the first to the last message [s]."""
        if self.t_first_us is None or self.t_last_us is None:
            return 0.0
        return (self.t_last_us - self.t_first_us) * 1e-6

    @property
    def last_session(self) -> Session:
        """The session with the highest number; an empty one if there is none."""
        return max(self.sessions.values(), key=lambda s: s.number, default=Session(0))

    def session(self, number: int) -> Session:
        """A session, made if it is new."""
        return self.sessions.setdefault(number, Session(number))

    def count(self, channels: Iterable[str], n: int = 1) -> None:
        """n messages on each of these channels, with nothing in them that is kept."""
        for channel in channels:
            self.n_messages += n
            self.counts[channel] += n

    def count_damaged(self, channel: str, number: int) -> None:
        """The message of the event of this number is none of its channel."""
        self.undecodable[channel] += 1
        if len(at := self.undecodable_at.setdefault(channel, [])) < MOST_NUMBERS:
            at.append(number)

    def add(self, channel: str, message: LcmMessage) -> None:
        """Add one decoded message."""
        m: Any = message
        if channel in STATES:
            return
        if channel in TIMED:
            self.t_first_us = m.t_us if self.t_first_us is None else self.t_first_us
            self.t_last_us = m.t_us
        if channel == "KC_PROGRESS":
            self.session(m.session).went_on(m)
        elif channel == "KC_MEAS":
            self.session(m.session).measure(m)
        elif channel == "KC_PROPOSAL":
            self.session(m.session).propose(m)
        elif channel == "KC_EVENT":
            self.events.append(LogEvent.of(m))
        elif channel == "KC_ACK":
            self.acks.append(m)
        elif channel == "KC_CMD":
            self.commands.append(m)
        elif channel == "KC_HK":
            self.hk = m

    def as_dict(self) -> dict[str, Any]:
        """Plain data for --json."""
        crcs = {} if self.hk is None else {i: crc for i, crc in enumerate(self.hk.table_crc) if crc}
        return {
            "file": str(self.path),
            "messages": self.n_messages,
            "channels": dict(sorted(self.counts.items())),
            "undecodable": dict(self.undecodable),
            "undecodable_at": self.undecodable_at,
            "damaged": self.damaged,
            "mission_s": self.mission_s,
            "sessions": [s.as_dict() for s in self.sessions.values()],
            "events": [e.as_dict() for e in self.events],
            "commands": len(self.commands),
            "refused": sum(1 for a in self.acks if a.status != 0),
            "table_crc": {i: channels.crc_text(crc) for i, crc in crcs.items()},
            "state": None if self.hk is None else names.state_name(self.hk.state),
        }


def read_log(path: Path, only: Collection[str] = channels.BY_NAME) -> LogSummary:
    """Read a whole log once; only: channels that are of interest, most of the time goes into the others.
    Messages that are damaged or of other channels, and places of the file that hold none, are counted, not
    fatal. BadInput if the file holds no message."""
    skip = SKIP | (channels.BY_NAME.keys() - only)
    summary, file = LogSummary(path), EventFile(path, skip, heads={_IMAGE: channels.IMAGE_HEAD.size})
    for event in file:
        summary.n_messages += 1
        summary.counts[event.channel] += 1
        if event.channel in only:
            _add_event(summary, event)
    summary.damaged = file.damaged
    if summary.n_messages == 0:
        raise BadInput(
            "the file holds no LCM messages", str(path), "give a log written by lcm-logger or a run"
        )
    return summary


def _add_event(summary: LogSummary, event: FileEvent) -> None:
    channels.message_type(channels.BY_NAME[event.channel].type)  # types that are not built are no damage
    try:
        if event.channel in SKIP:
            channels.check_image(event.data, event.n_bytes)
            return
        message = channels.decode(event.channel, event.data)
    except Exception:  # noqa: BLE001 generated decoders raise anything
        summary.count_damaged(event.channel, event.number)
        return
    summary.add(event.channel, message)


def estimated_sigma(p: Proposal) -> list[float]:
    """Sigma of each coefficient that this calibration estimated, else 0: the others keep what the table
    before had, in value and sigma."""
    lib = library("flight").lib
    kept = (lib.KC_COEF_MASKED, lib.KC_COEF_HELD)
    return [0.0 if status in kept else s for s, status in zip(p.sigma, p.status, strict=True)]


def unpack_covariance(packed: ArrayLike, n: int) -> Floats:
    """Covariance (n, n) from its upper triangle stored row by row."""
    out: Floats = np.asarray(packed, float)[_places(n)]
    return out


@cache
def _places(n: int) -> NDArray[np.intp]:
    """(n, n) where each entry of a symmetric matrix is in its upper triangle."""
    at = np.zeros((n, n), np.intp)
    rows, cols = np.triu_indices(n)
    at[rows, cols] = at[cols, rows] = np.arange(len(rows))
    return at
