"""What became of a proposal, what can be decided about it, and which poses its fit rejected: from the log
that holds it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from kincal.flight import library
from kincal.link import crc_text, read_log, unsigned32
from kincal.link.log import LogSummary, Session
from kincal.link.names import VERDICTS, opcode, verdict_name

from . import KIN_KIND, Entry, Review, journal, reasons_to_reject

if TYPE_CHECKING:
    from kincal.link.messages import Proposal

# events about a correction, by name: what they make of it
_WAITS, _ARMED = "waits for review", "approval armed, not confirmed yet"
_EXPIRED = "waits for review; an approval was armed and expired"
_STATES = {
    "COR_PROPOSED": _WAITS,
    "COR_ARMED": _ARMED,
    "COR_EXPIRED": _EXPIRED,
    "COR_ACTIVE": "in force",
    "COR_REJECTED": "rejected",
    "COR_ROLLBACK": "in force again after a rollback",
}
_DECIDED = {journal.ARMED: "armed", journal.APPROVED: "approved", journal.REJECTED: "rejected"}


@dataclass(frozen=True)
class Status:
    """state: in words, at the end of the log, or as the journal says what came after it; waits: for a
    decision, as far as these two say; armed: the first step of an approval was taken, at the end of the log;
    rejected: poses from 1 that the fit left out; rejected_extra: numbers of those on the way to a pose;
    exact: the log names as many as the proposal counts; decisions: lines of the journal, oldest first."""

    state: str
    waits: bool
    armed: bool
    rejected: tuple[int, ...]
    exact: bool
    decisions: tuple[Entry, ...] = ()
    rejected_extra: tuple[int, ...] = ()


def status(log: LogSummary, review: Review, decisions: Sequence[Entry] = ()) -> Status:
    """What a log and the journal say of a proposal."""
    rejected, extra = _rejected(log, review.session)
    mine = tuple(entry for entry in decisions if entry.crc == review.crc_text)
    state, waits = _state(log, review.crc, review.verdict, mine)
    exact = len(rejected) + len(extra) == review.n_outliers
    return Status(state, waits, state == _ARMED, rejected, exact, mine, extra)


def _state(log: LogSummary, crc: int, verdict: str, lines: Sequence[Entry]) -> tuple[str, bool]:
    """In words, and whether it waits."""
    state = _state_in_log(log, crc, verdict)
    decided = [entry for entry in lines if entry.decision in _DECIDED]
    if state not in (_WAITS, _ARMED, _EXPIRED):
        return state, False
    if not decided:
        return state, True
    last = decided[-1]
    if last.decision != journal.ARMED:
        return f"{_DECIDED[last.decision]} by {last.by}, {last.time}, after this log ends", False
    if state == _ARMED:
        return state, True
    return f"{_WAITS}; an approval was armed by {last.by}, {last.time}, and may have expired", True


def _state_in_log(log: LogSummary, crc: int, verdict: str) -> str:
    active = log.hk is not None and unsigned32(log.hk.table_crc[KIN_KIND]) == crc
    if verdict == VERDICTS["NO_CHANGE"]:
        return "nothing to decide, the table in force stays"
    mine = [e for e in log.events if e.name in _STATES and int(e.got) == crc]
    last = _STATES[mine[-1].name] if mine else ""
    if active:
        return (last if last.startswith("in force") else "in force") + _by_executive(log, crc)
    if last.startswith("in force"):
        return "was in force; another table is now"
    return last or _WAITS


def _by_executive(log: LogSummary, crc: int) -> str:
    """That the executive took the second step of an approval, in words: no journal has it."""
    steps = [c for c in log.commands if c.opcode == opcode("APPROVE_GO") and unsigned32(c.arg_i[0]) == crc]
    executive = int(library("flight").lib.KC_SRC_EXECUTIVE)
    return ", approved by the executive" if steps and steps[-1].source == executive else ""


@dataclass(frozen=True)
class Listed:
    """One proposal of a log, for a list; state: what became of it, in words."""

    log: Path
    crc: int
    session: int
    verdict: str
    n_poses: int
    p_fit: float
    before_pos_m: float
    fit_pos_m: float
    state: str


def proposals_in(path: Path, lines: Sequence[Entry] = ()) -> list[Listed]:
    """All proposals of a log; lines: of journals."""
    log = read_log(path)

    def state(p: Proposal) -> str:
        mine = [entry for entry in lines if entry.crc == crc_text(p.crc)]
        return _state(log, unsigned32(p.crc), verdict_name(p.verdict), mine)[0]

    return [
        Listed(
            path,
            unsigned32(p.crc),
            p.session,
            verdict_name(p.verdict),
            p.n_poses,
            p.p_fit,
            p.before_pos_m,
            p.fit_pos_m,
            state(p),
        )
        for s in log.sessions.values()
        if (p := s.proposal) is not None
    ]


@dataclass(frozen=True)
class Choice:
    """A decision that can be taken, and the command for it."""

    what: str
    command: str


def choices(
    crc: int,
    verdict: str,
    reasons: Sequence[str],
    armed: bool = False,
    options: str = "",
    go_by: str = "",
) -> tuple[Choice, ...]:
    """What can be done about a proposal that waits; verdict: "" if flight does not know it; reasons: to
    reject it; options: more words of each command; go_by: who has to take the second step. The likeliest
    first."""
    text, who = crc_text(crc), "--by NAME --why REASON"
    doubtful = bool(reasons) or verdict != VERDICTS["CHANGE"]
    override = " --override REASON" if doubtful else ""
    all_the_same = " in spite of the reasons to reject it" if doubtful else ""
    reject = Choice("reject it; the table in force stays", f"kincal review reject {text} {who}{options}")
    arm = Choice(
        f"approve it{all_the_same}, first step", f"kincal review arm {text} {who}{override}{options}"
    )
    by = f" by {go_by}" if go_by else ""
    second = Choice(
        f"approve it, second step{by}: it comes in force", f"kincal review go {text} {who}{options}"
    )
    if armed:
        return second, reject
    return (reject, arm, second) if doubtful else (arm, second, reject)


def _rejected(log: LogSummary, session: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Poses, and observations on the way to one, that were rejected and did not come back."""
    begin, end = _span(log.sessions[session]) if session in log.sessions else (0, 0)
    poses: set[int] = set()
    extra: set[int] = set()
    for e in log.events:
        if e.name == "CAL_OUTLIER" and begin <= e.t_us <= end:
            poses.add(e.index)
        elif e.name == "CAL_OUTLIER_ACCEPTED":
            poses.discard(e.index)
        elif e.name == "CAL_EXTRA_OUTLIER" and begin <= e.t_us <= end:
            extra.add(int(e.got))
        elif e.name == "CAL_EXTRA_OUTLIER_ACCEPTED":
            extra.discard(int(e.got))
    return tuple(sorted(poses)), tuple(sorted(extra))


def _span(session: Session) -> tuple[int, int]:
    """Mission time [us] of a session, from its first pose to its proposal."""
    first = session.progress[0].t_us if session.progress else 0
    return first, session.proposal.t_us if session.proposal is not None else first


def see_first(crc: int, log: str = "LOG", options: str = "") -> Choice:
    """What comes before an approval."""
    return Choice(
        "before an approval, note in the journal that you have seen it",
        f"kincal review show {log} --crc {crc_text(crc)} --by NAME{options}",
    )


def to_decide(
    review: Review, about: Status, log: str = "LOG", options: str = "", seen: bool = False
) -> tuple[Choice, ...]:
    """What can be done about a proposal of a log (its path, as a word of a command); empty if it does not
    wait. seen: the journal notes already that the person has seen it."""
    found = choices(review.crc, review.verdict, reasons_to_reject(review), about.armed, options)
    first = () if seen else (see_first(review.crc, log, options),)
    return (*first, *found) if about.waits else ()
