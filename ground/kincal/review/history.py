"""The tables of a mission: what was in force when, the values of each correction in turn, and the monitor;
from recordings. A history of a growing recording goes on from where it ended."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kincal.flight import Terms, library
from kincal.link import channels, crc_text, unsigned32
from kincal.link.eventfile import EventFile
from kincal.link.names import verdict_name
from kincal.tables import unit_of
from kincal_shared.errors import KincalError

from .journal import APPROVED, Entry, one_line

if TYPE_CHECKING:
    from kincal.flight.headers import KcTerms

_WANTED = frozenset({"KC_HK", "KC_PROPOSAL"})
_FIRST_DATE_S = 1e9  # since 1970; a clock below this one began with the mission
_OVERLAP = 1 << 16  # bytes: the last event of a growing file may be cut
_MONITOR = ("quiet", "one joint reads wrong", "unexplained residuals")
# lines of the journal by which the table that they name came in force, in words
_CHANGING = {APPROVED: "approved", "table_activate": "sent"}
NO_PROPOSAL = "its proposal is in none of these recordings"
NOBODY = "not by a command of this journal: a start of flight, or another journal"
_MONITOR_EVERY_S = 60.0  # at least; every change of its state is kept


@dataclass(frozen=True)
class InForce:
    """From a time on a table was in force. utc_s: of the recording, since 1970; crc: empty for none."""

    utc_s: float
    kind: str
    crc: str


@dataclass(frozen=True)
class Correction:
    """A proposed correction. terms: CRC of the TERMS table that says which coefficients the values are of."""

    utc_s: float
    session: int
    crc: str
    before: str
    terms: str
    verdict: str
    value: tuple[float, ...]
    sigma: tuple[float, ...]


@dataclass(frozen=True)
class MonitorState:
    """What the monitor for miscalibration said. joint: from 1, 0: none; bias_rad, sigma_rad: of it."""

    utc_s: float
    state: int
    joint: int
    bias_rad: float
    sigma_rad: float
    p: float

    @property
    def text(self) -> str:
        """The state in words."""
        return _MONITOR[self.state] if 0 <= self.state < len(_MONITOR) else f"state {self.state}"

    @property
    def suspected(self) -> str:
        """The joint in words; empty if none is suspected."""
        if not self.joint:
            return ""
        return f"joint {self.joint}: {math.degrees(self.bias_rad):.3f} ± {math.degrees(self.sigma_rad):.3f}°"


@dataclass
class History:
    """In order of time. end: byte of the file up to which it was read; until_s: time of the last message."""

    in_force: list[InForce] = field(default_factory=list)
    corrections: list[Correction] = field(default_factory=list)
    monitor: list[MonitorState] = field(default_factory=list)
    end: int = 0
    until_s: float = 0.0

    def add(self, channel: str, message: Any, utc_s: float) -> None:
        """Take a message of KC_HK or KC_PROPOSAL, unless it was taken before."""
        if utc_s <= self.until_s:
            return
        self.until_s = utc_s
        if channel == "KC_HK":
            self._tables(message, utc_s)
            self._monitor(message, utc_s)
        elif channel == "KC_PROPOSAL":
            n = message.n_coef
            self.corrections.append(
                Correction(
                    utc_s, message.session, crc_text(message.crc), crc_text(message.crc_kin_before),
                    crc_text(message.crc_terms), verdict_name(message.verdict),
                    tuple(message.value[:n]), tuple(message.sigma[:n]),
                )
            )  # fmt: skip

    def _tables(self, hk: Any, utc_s: float) -> None:
        last = {x.kind: x.crc for x in self.in_force}
        for kind, number in library("flight").enum("kc_tbl_kind_t", "KC_TBL_").items():
            crc = crc_text(hk.table_crc[number]) if unsigned32(hk.table_crc[number]) else ""
            if last.get(kind, "") != crc:
                self.in_force.append(InForce(utc_s, kind, crc))

    def _monitor(self, hk: Any, utc_s: float) -> None:
        now = MonitorState(utc_s, hk.mon_state, hk.mon_joint, hk.mon_bias, hk.mon_sigma, hk.mon_p)
        last = self.monitor[-1] if self.monitor else None
        if last is None or last.state != now.state or utc_s - last.utc_s >= _MONITOR_EVERY_S:
            self.monitor.append(now)

    def what(self, x: InForce) -> str:
        """What is known of a table that came in force, in words; empty of a table that is no correction."""
        made = next((c for c in self.corrections if c.crc == x.crc), None)
        if x.kind != "KIN" or not x.crc:
            return ""
        return f"correction of session {made.session}, {made.verdict}" if made else NO_PROPOSAL

    def monitor_changes(self) -> list[MonitorState]:
        """Where its state changed."""
        rows = self.monitor
        return [m for k, m in enumerate(rows) if not k or rows[k - 1].state != m.state]

    def as_dict(self) -> dict[str, Any]:
        """Plain data, for --json and to keep."""
        return asdict(self)

    @classmethod
    def of_dict(cls, doc: dict[str, Any]) -> History:
        """The same again."""
        return cls(
            [InForce(**x) for x in doc["in_force"]],
            [Correction(**x | {"value": tuple(x["value"]), "sigma": tuple(x["sigma"])})
             for x in doc["corrections"]],
            [MonitorState(**x) for x in doc["monitor"]],
            doc["end"],
            doc["until_s"],
        )  # fmt: skip


def go_on(history: History, log: Path) -> History:
    """Read what a recording holds beyond what was read. BadInput if the file cannot be read."""
    size = log.stat().st_size
    for event in EventFile(log, frozenset(channels.BY_NAME) - _WANTED, max(history.end - _OVERLAP, 0)):
        if event.channel not in _WANTED:
            continue
        try:
            message = channels.decode(event.channel, event.data)
        except KincalError:
            raise
        except Exception:  # noqa: BLE001, S112 a damaged message is passed over; decoders raise anything
            continue
        history.add(event.channel, message, event.utc_us * 1e-6)
    history.end = size
    return history


def joined(parts: Iterable[History]) -> History:
    """Histories of several recordings as one; a correction that is in two is taken once."""
    out, rows = History(), sorted(parts, key=lambda part: part.until_s)
    for one in sorted((x for part in rows for x in part.in_force), key=lambda x: x.utc_s):
        last = {x.kind: x.crc for x in out.in_force}
        if last.get(one.kind) != one.crc:
            out.in_force.append(one)
    seen: set[tuple[int, str]] = set()
    for made in sorted((x for part in rows for x in part.corrections), key=lambda x: x.utc_s):
        if (made.session, made.crc) not in seen:
            seen.add((made.session, made.crc))
            out.corrections.append(made)
    out.monitor = sorted((x for part in rows for x in part.monitor), key=lambda x: x.utc_s)
    return out


def utc(seconds: float) -> str:
    """UTC to the second; seconds of the mission in the log of a simulated run, which has no date."""
    if seconds < _FIRST_DATE_S:
        return f"{seconds:.1f} s"
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d %H:%M:%S")


def decided(x: InForce, entries: Iterable[Entry]) -> str:
    """Who put a table in force and why, by the journal."""
    lines = [e for e in entries if e.crc == x.crc and e.decision in _CHANGING]
    return (
        "; ".join(dict.fromkeys(f"{_CHANGING[e.decision]} by {e.by}: {one_line(e.why)}" for e in lines))
        or NOBODY
    )


@dataclass(frozen=True)
class Point:
    """A coefficient in one correction. active: the correction was put in force."""

    utc_s: float
    crc: str
    value: float
    sigma: float
    active: bool


@dataclass(frozen=True)
class Trend:
    """A coefficient over the corrections. lower, upper: its bounds."""

    name: str
    unit: str
    lower: float
    upper: float
    points: tuple[Point, ...]


def trends(history: History, terms: Mapping[str, KcTerms], entries: Iterable[Entry] = ()) -> list[Trend]:
    """Every coefficient that some correction estimated, by name. terms: TERMS tables by CRC: corrections of
    others have no names and are left out; entries: of the journal, for what was approved."""
    points: dict[str, list[Point]] = {}
    bounds: dict[str, tuple[float, float]] = {}
    active = {x.crc for x in history.in_force if x.kind == "KIN"}
    active |= {e.crc for e in entries if e.decision == APPROVED}
    for made in history.corrections:
        table = terms.get(made.terms)
        if table is None:
            continue
        names = Terms.of_table(table).names
        for k, (name, value, sigma) in enumerate(zip(names, made.value, made.sigma, strict=False)):
            bounds[name] = (float(table.coef[k].lb), float(table.coef[k].ub))
            points.setdefault(name, []).append(Point(made.utc_s, made.crc, value, sigma, made.crc in active))
    return [
        Trend(name, unit_of(name), *bounds[name], tuple(rows))
        for name, rows in points.items()
        if any(p.sigma > 0.0 or p.value != 0.0 for p in rows)
    ]
