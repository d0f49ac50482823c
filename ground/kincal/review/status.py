"""What became of a proposal, and which poses its fit rejected: from the log that holds it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from kincal.link import unsigned32
from kincal.link.log import LogSummary, Session

from . import KIN_KIND, Entry, Review

# events about a correction, by name: what they make of it
_STATES = {
    "COR_PROPOSED": "waits for review",
    "COR_ARMED": "approval armed, not confirmed yet",
    "COR_EXPIRED": "waits for review; an approval was armed and expired",
    "COR_ACTIVE": "in force",
    "COR_REJECTED": "rejected",
    "COR_ROLLBACK": "in force again after a rollback",
}


@dataclass(frozen=True)
class Status:
    """state: in words, at the end of the log; rejected: poses from 1 that the fit left out; exact: the log
    names as many as the proposal counts; decisions: of the journal, oldest first."""

    state: str
    rejected: tuple[int, ...]
    exact: bool
    decisions: tuple[Entry, ...] = ()


def status(log: LogSummary, review: Review, decisions: Sequence[Entry] = ()) -> Status:
    """What a log and the journal say of a proposal."""
    rejected = _rejected(log, review.session)
    mine = tuple(entry for entry in decisions if entry.crc == review.crc_text)
    return Status(_state(log, review), rejected, len(rejected) == review.n_outliers, mine)


def _state(log: LogSummary, review: Review) -> str:
    active = log.hk is not None and unsigned32(log.hk.table_crc[KIN_KIND]) == review.crc
    if not review.changes_something:
        return "nothing to decide, the table in force stays"
    mine = [e for e in log.events if e.name in _STATES and int(e.got) == review.crc]
    last = _STATES[mine[-1].name] if mine else ""
    if active:
        return last if last.startswith("in force") else "in force"
    if last.startswith("in force"):
        return "was in force; another table is now"
    return last or "waits for review"


def _rejected(log: LogSummary, session: int) -> tuple[int, ...]:
    """Poses that were rejected and did not come back."""
    begin, end = _span(log.sessions[session]) if session in log.sessions else (0, 0)
    poses: set[int] = set()
    for e in log.events:
        if e.name == "CAL_OUTLIER" and begin <= e.t_us <= end:
            poses.add(e.index)
        if e.name == "CAL_OUTLIER_ACCEPTED":
            poses.discard(e.index)
    return tuple(sorted(poses))


def _span(session: Session) -> tuple[int, int]:
    """Mission time [us] of a session, from its first pose to its proposal."""
    first = session.progress[0].t_us if session.progress else 0
    return first, session.proposal.t_us if session.proposal is not None else first
