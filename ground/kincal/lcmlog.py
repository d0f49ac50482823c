"""What an LCM log holds: channels, sessions, poses, events, proposals."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import lcm
import numpy as np

from kincal import channels
from kincal.errors import KincalError
from kincal.tables import event_line

SKIP = {"KC_IMAGE"}  # large and of no use to a summary


@dataclass(frozen=True)
class EventLine:
    t_us: int
    severity: str
    id: int
    text: str


@dataclass
class Session:
    """One calibration."""

    number: int
    progress: list[Any] = field(default_factory=list)  # progress_t in order
    measurements: list[Any] = field(default_factory=list)  # meas_t in order
    proposal: Any = None  # proposal_t


@dataclass
class LogSummary:
    path: Path
    n_messages: int = 0
    counts: Counter[str] = field(default_factory=Counter)
    undecodable: Counter[str] = field(default_factory=Counter)
    t_first_us: int | None = None
    t_last_us: int | None = None
    sessions: dict[int, Session] = field(default_factory=dict)
    events: list[EventLine] = field(default_factory=list)
    acks: list[Any] = field(default_factory=list)
    commands: list[Any] = field(default_factory=list)
    hk: Any = None  # the last hk_t

    @property
    def mission_s(self) -> float:
        if self.t_first_us is None or self.t_last_us is None:
            return 0.0
        return (self.t_last_us - self.t_first_us) * 1e-6

    def session(self, number: int) -> Session:
        return self.sessions.setdefault(number, Session(number))

    def take(self, channel: str, message: Any) -> None:
        """Add one decoded message."""
        if channel in ("KC_HK", "KC_EVENT", "KC_PROGRESS"):
            self.t_first_us = message.t_us if self.t_first_us is None else self.t_first_us
            self.t_last_us = message.t_us
        if channel == "KC_PROGRESS":
            self.session(message.session).progress.append(message)
        elif channel == "KC_MEAS":
            self.session(message.session).measurements.append(message)
        elif channel == "KC_PROPOSAL":
            self.session(message.session).proposal = message
        elif channel == "KC_EVENT":
            self.events.append(
                EventLine(
                    message.t_us,
                    channels.named(channels.SEVERITIES, message.severity),
                    message.id,
                    event_line(message.id, message.index, message.got, message.want),
                )
            )
        elif channel == "KC_ACK":
            self.acks.append(message)
        elif channel == "KC_CMD":
            self.commands.append(message)
        elif channel == "KC_HK":
            self.hk = message

    def as_dict(self) -> dict[str, Any]:
        """Plain data for --json."""
        return {
            "file": str(self.path),
            "messages": self.n_messages,
            "channels": dict(sorted(self.counts.items())),
            "undecodable": dict(self.undecodable),
            "mission_s": self.mission_s,
            "sessions": [session_dict(s) for s in self.sessions.values()],
            "events": [
                {"t_us": e.t_us, "severity": e.severity, "id": e.id, "text": e.text} for e in self.events
            ],
            "commands": len(self.commands),
            "refused": sum(1 for a in self.acks if a.status != 0),
            "table_crc": {}
            if self.hk is None
            else {i: channels.crc32_text(c) for i, c in enumerate(self.hk.table_crc) if c},
            "state": None if self.hk is None else channels.named(channels.STATES, self.hk.state),
        }


def session_dict(session: Session) -> dict[str, Any]:
    proposal = session.proposal
    return {
        "session": session.number,
        "poses": len(session.progress),
        "measurements": len(session.measurements),
        "last_pred_pos_m": session.progress[-1].pred_pos_m if session.progress else None,
        "proposal": None
        if proposal is None
        else {
            "crc": channels.crc32_text(proposal.crc),
            "verdict": channels.named(channels.VERDICTS, proposal.verdict),
            "rank": proposal.rank,
            "n_free": proposal.n_free,
            "p_fit": proposal.p_fit,
            "p_no_change": proposal.p_no_change,
            "fit_pos_m": proposal.fit_pos_m,
            "before_pos_m": proposal.before_pos_m,
        },
    }


def read(path: Path) -> LogSummary:
    """Read a whole log once. Messages that are damaged or of unknown channels are counted, not fatal."""
    if not path.is_file():
        raise KincalError("no such log file", str(path))
    summary = LogSummary(path)
    try:
        log = lcm.EventLog(str(path), "r")
    except OSError as error:
        raise KincalError(f"cannot open the log: {error}", str(path)) from None
    for event in log:
        summary.n_messages += 1
        summary.counts[event.channel] += 1
        if event.channel in SKIP or event.channel not in channels.BY_NAME:
            continue
        try:
            message = channels.decode(event.channel, event.data)
        except (ValueError, IndexError, Exception) as error:  # noqa: BLE001 generated decoders raise anything
            if isinstance(error, KincalError):
                raise
            summary.undecodable[event.channel] += 1
            continue
        summary.take(event.channel, message)
    if summary.n_messages == 0:
        raise KincalError(
            "the file holds no LCM messages", str(path), "give a log written by lcm-logger or a run"
        )
    return summary


def unpack_cov(packed: list[float], n: int) -> np.ndarray:
    """Square matrix from an upper triangle stored row by row."""
    full = np.zeros((n, n))
    rows, cols = np.triu_indices(n)
    full[rows, cols] = packed[: len(rows)]
    return full + np.triu(full, 1).T
