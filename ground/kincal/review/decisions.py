"""Decisions about the proposal that waits on board: arm its approval, let it go, reject it.

An approval is two commands. The first arms flight for one CRC, for a time; the second puts that correction in
force. Each is a call of its own here, with a name and a reason and a line in the journal, so that the second
can be another person's. Who approves has seen the proposal: `see` writes that into the journal, with the
verdict and the numbers as they were shown, and `arm` and `go` look for it. What there are reasons to reject
needs an override, which is signed with the command: flight refuses a poor fit without it."""

from __future__ import annotations

import dataclasses
import datetime
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from kincal.flight import library
from kincal.link import CommandLink, crc_text, unsigned32
from kincal.link.names import state_name, verdict_name
from kincal_shared.errors import BadInput, CommandFailed, KincalError, NoAnswer
from kincal_shared.keys import Signer, holder, other_than

from . import (
    KIN_KIND,
    Entry,
    Review,
    check_words,
    journal,
    parse_crc,
    reasons_known,
    reasons_to_reject,
    record,
    warnings,
)

LEAST_WORDS = 3
"""Of an override: who reads the journal later has to learn from it why."""
_MOST_OF_ONE, _MOST_SEEN = 400, 10_000  # characters that the line of what was seen has of what stood out
_MOST_WAIT_S = 3600.0  # between the two steps, whatever CONFIG says (docs/TABLES.md, approval_timeout_us)
OVERRIDE = int(library("flight").constant("KC_OVERRIDE_FIT"))
Say = Callable[[str], None]
Accepted = Callable[[], None]
Command = Callable[[CommandLink, str, tuple[int, ...], float, Accepted], None]
"""Sends a command (link, opcode, arguments, time-out) once, and calls what it is given as soon as flight has
taken it. CommandFailed if flight refuses it or does not answer."""


def seen_text(stood_out: Sequence[str]) -> str:
    """What stood out, for the line that it was seen. A question stands in full in its own line: one as long
    as a line may be, said again here, would leave no room, and nobody could have seen it."""
    return _cut("; ".join(_cut(one, _MOST_OF_ONE) for one in stood_out), _MOST_SEEN) or "nothing stood out"


def _cut(text: str, most: int) -> str:
    return f"{text[:most]} …" if len(text) > most else text


def _silent(_text: str) -> None:
    """Says nothing."""


@dataclass(frozen=True)
class OnBoard:
    """What waits on board. crc: 0: nothing; verdict: of it, "" if flight does not know it (any more); armed:
    the first step was taken; left_s: until it expires; state: of flight; armed_key: that took the first step,
    0 if none did or flight is older; two_holders: the second step has to come from another holder; table_crc:
    of the tables in force, by kind."""

    crc: int
    verdict: str
    armed: bool
    left_s: float
    state: str
    armed_key: int
    two_holders: bool
    table_crc: tuple[int, ...]

    @property
    def other_than(self) -> str:
        """Which key has to give the second step, in words; empty if any may, or nothing is armed."""
        return other_than(self.armed_key) if self.armed and self.two_holders else ""


def on_board(link: CommandLink, timeout_s: float = 5.0) -> OnBoard:
    """What waits on board, by the next housekeeping."""
    hk = link.wait_hk(lambda _hk: True, timeout_s, "housekeeping")
    return OnBoard(
        unsigned32(hk.proposal_crc),
        verdict_name(hk.proposal_verdict) if hk.proposal_verdict else "",
        hk.state == library("flight").constant("KC_ST_ARMED"),
        hk.approval_left_us * 1e-6,
        state_name(hk.state),
        hk.armed_key,
        bool(hk.go_by_other_key),
        tuple(map(unsigned32, hk.table_crc)),
    )


# ---- commands alone


def _nothing() -> None:
    """Does nothing."""


def plainly(
    link: CommandLink, opcode: str, args: tuple[int, ...], timeout_s: float, accepted: Accepted
) -> None:
    """Send a command and wait for its answer."""
    link.command(opcode, args, timeout_s)
    accepted()


def send_arm(
    link: CommandLink,
    crc: int,
    timeout_s: float,
    override: bool = False,
    accepted: Accepted = _nothing,
    command: Command = plainly,
) -> None:
    """The first step. accepted: called as soon as flight has taken the command."""
    command(link, "APPROVE_ARM", (crc, OVERRIDE) if override else (crc,), timeout_s, accepted)


def send_go(
    link: CommandLink, crc: int, timeout_s: float, accepted: Accepted = _nothing, command: Command = plainly
) -> None:
    """The second step, until the table is seen in force. accepted: called as soon as flight has taken the
    command, also if what it brings is not seen."""
    command(link, "APPROVE_GO", (crc,), timeout_s, accepted)
    try:
        link.wait_hk(lambda hk: unsigned32(hk.table_crc[KIN_KIND]) == crc, timeout_s, "the new table")
    except CommandFailed:
        raise CommandFailed(
            f"approved, but table {crc_text(crc)} was not seen in housekeeping",
            link.url,
            "look at the events and at `kincal table dump kin`",
        ) from None


def send_reject(
    link: CommandLink, crc: int, timeout_s: float, accepted: Accepted = _nothing, command: Command = plainly
) -> None:
    """Tell flight to drop the proposal; accepted: as for `send_go`."""
    command(link, "REJECT", (crc,), timeout_s, accepted)
    link.wait_hk(lambda hk: hk.proposal_crc == 0, timeout_s, "the end of the proposal")


# ---- what an operator does


@dataclass(frozen=True)
class Operator:
    """Who decides. by: name; why: reason; journal: where it is written; timeout_s: longest wait for an
    answer; say: takes what is done, a sentence; command: sends."""

    by: str
    why: str
    journal: Path
    timeout_s: float = 10.0
    say: Say = _silent
    command: Command = plainly


def see(
    journal_file: Path,
    review: Review,
    by: str,
    log: Path,
    signer: Signer,
    stood_out: Sequence[str] | None = None,
    shown_with: int | None = None,
) -> Entry:
    """Write down that somebody has seen a proposal of a log, with everything that stood out, as it was
    shown. shown_with: how many lines the journal had when it was read, None: not known. CommandFailed
    if somebody else has written of the proposal since: clearance and page take seconds."""
    check_words(by, "seen")
    why = seen_text(warnings(review) if stood_out is None else stood_out)

    def check(now: journal.Journal) -> None:
        if shown_with is not None and (new := _remarks_after(now, shown_with, review.crc_text, by)):
            raise CommandFailed(
                f"while correction {review.crc_text} was shown to {by}, this was written: {'; '.join(new)}",
                str(journal_file),
                "look at it again: that it was seen is not in the journal",
            )

    return record(
        journal_file, journal.SEEN, review.crc, by, why, str(log.resolve()), review, signer, check=check
    )


def arm(
    link: CommandLink, crc: str, who: Operator, override: str = "", against: Sequence[str] = ()
) -> OnBoard:
    """First step of an approval; returns what housekeeping says after it. override: why, in spite of the
    reasons to reject; against: those that clearance gives, as far as the caller knows them now. BadInput or
    CommandFailed before any command is sent if something else waits, it is armed already, `who.by` has not
    seen it (with those reasons), or it needs an override and has none, or has one and needs none."""
    case = _case(link, crc, who, "APPROVE_ARM")
    with _recorded(case, who, "APPROVE_ARM", override):
        if case.waits.armed:
            raise CommandFailed(
                f"the approval of correction {case.text} is armed already, for another "
                f"{case.waits.left_s:.0f} s",
                link.url,
                f"`kincal review go {case.text}`"
                + (f", given with {case.waits.other_than}," if case.waits.other_than else "")
                + " puts it in force, "
                f"`kincal review reject {case.text}` drops it",
            )
        seen = _seen(case, who, against)
        _say_overridden(who, _check_override(case, seen, override))

        def accepted() -> None:
            who.say(f"approval of correction {case.text} armed")
            _write(case, who, journal.ARMED, seen, override)

        send_arm(link, case.crc, who.timeout_s, bool(override), accepted, who.command)
    now = on_board(link, who.timeout_s)
    by = f", given with {now.other_than}," if now.other_than else ""
    who.say(
        f"nothing is in force yet: within {now.left_s:.0f} s `kincal review go {case.text}`{by} puts it in "
        "force"
    )
    return now


def go(link: CommandLink, crc: str, who: Operator, against: Sequence[str] = (), override: str = "") -> None:
    """Second step: the correction comes in force. Refused, before any command is sent, if it is not armed,
    `who.by` has not seen it, it needs the key of another holder, or there are reasons to reject it that the
    first step did not override. against: as for `arm`; override: as for `arm`, where the first step is in
    another journal."""
    case = _case(link, crc, who, "APPROVE_GO")
    with _recorded(case, who, "APPROVE_GO", override):
        if not case.waits.armed:
            raise CommandFailed(
                f"the approval of correction {case.text} is not armed (or has expired)",
                link.url,
                f"`kincal review arm {case.text}` first",
            )
        _check_holder(case, link)
        seen = _seen(case, who, against)
        first = first_step(case.before.entries, case.text, case.waits.armed_key)
        override, reasons = _overridden(case, seen, first, override)
        if first is not None:
            who.say(f"armed by {first.by}, {first.time}: {journal.one_line(first.why)}")
        if override:
            who.say(f"by override: {journal.one_line(override)}")
        _say_overridden(who, reasons)
        send_go(
            link,
            case.crc,
            who.timeout_s,
            lambda: _write(case, who, journal.APPROVED, seen, override),
            who.command,
        )
    who.say(f"correction {case.text} is in force")


def reject(link: CommandLink, crc: str, who: Operator) -> None:
    """Drop what waits; the table in force stays. It need not have been seen."""
    case = _case(link, crc, who, "REJECT")
    seen = case.before.seen_by(who.by, case.text)
    with _recorded(case, who, "REJECT"):
        send_reject(
            link,
            case.crc,
            who.timeout_s,
            lambda: _write(case, who, journal.REJECTED, seen),
            who.command,
        )
    who.say(f"correction {case.text} rejected")


@contextmanager
def _recorded(case: _Case, who: Operator, command: str, override: str = "") -> Iterator[None]:
    """The attempt is written before anything is sent; then that it was refused, or that nobody knows, unless
    flight took it: that line is written where it is known."""

    def write(what: str, why: str) -> None:
        record(who.journal, what, case.crc, who.by, why, case.url, None, case.signer, override, command)

    write(journal.ATTEMPT, who.why)
    try:
        yield
    except BaseException as error:
        if not case.taken:
            known = isinstance(error, KincalError) and not isinstance(error, NoAnswer)
            why = str(error).splitlines()[0] if isinstance(error, KincalError) else "interrupted"
            write(journal.REFUSED if known else journal.UNANSWERED, _cut(why, _MOST_SEEN))  # it may quote
        raise
    for unwritten in case.unwritten:
        raise CommandFailed(
            f"flight took {command} of correction {case.text}, but the journal has only the attempt: "
            f"{unwritten.what}",
            unwritten.where,
            "do not send it again: see to the journal, then write down by `kincal review comment` what came "
            "of it",
        )


@dataclass(frozen=True)
class _Case:
    """What is decided about, with what it is signed, and what came of it."""

    crc: int
    waits: OnBoard
    before: journal.Journal
    signer: Signer
    url: str
    taken: list[str] = field(default_factory=list)  # decisions that flight took
    unwritten: list[KincalError] = field(default_factory=list)  # why one of them is not in the journal

    @property
    def text(self) -> str:
        return crc_text(self.crc)


def _case(link: CommandLink, crc: str, who: Operator, command: str) -> _Case:
    """Refused when the words are missing, the journal is not sound, or something else waits."""
    wanted = parse_crc(crc)
    if not wanted:  # to flight, that nothing waits
        raise BadInput(
            f"no correction has the CRC {crc}", todo="`kincal review list --live` shows what waits"
        )
    check_words(who.by, who.why)
    signer = signer_of(link)
    before = journal.read(who.journal, signer.known)
    if before.unconfirmed:
        who.say(f"note: {who.journal}, {before.vouched}")
    waits = on_board(link, who.timeout_s)
    if waits.crc != wanted:
        instead = f"{crc_text(waits.crc)} does" if waits.crc else "nothing does"
        why = f"correction {crc_text(wanted)} does not wait on board; {instead}"
        record(who.journal, journal.REFUSED, wanted, who.by, why, link.url, None, signer, command=command)
        raise CommandFailed(why, link.url, "`kincal review list --live` shows what waits")
    return _Case(wanted, waits, before, signer, link.url)


def signer_of(link: CommandLink) -> Signer:
    """Who signs what the link sends. BadInput if nobody does: a decision could not be recorded."""
    if link.signer is None:
        raise BadInput("what is sent to flight has to be signed", link.url, "name a key file by --keys")
    return link.signer


def _seen(case: _Case, who: Operator, against: Sequence[str] = ()) -> Entry:
    """That `who.by` has seen what waits, with these reasons against it, and saw the verdict that flight
    states. The entry, with the reasons that anybody has seen: who could not know them needs the override
    too."""
    seen = case.before.seen_by(who.by, case.text)
    if seen is None:
        others = {e.by for e in case.before.entries if (e.decision, e.crc) == (journal.SEEN, case.text)}
        raise BadInput(
            f"{who.by} has not seen correction {case.text}"
            + (f" (seen by {', '.join(sorted(others))})" if others else ""),
            str(who.journal),
            f'`kincal review show --live --by "{who.by}"` shows it and notes that; if it was recorded '
            f"elsewhere, LOG --crc {case.text} in place of --live",
        )
    if case.waits.verdict not in ("", seen.verdict):
        raise BadInput(
            f"flight says of correction {case.text}: {case.waits.verdict}; the log that {seen.by} has seen "
            f"says: {seen.verdict}",
            seen.url,
            "that log is not what flight sent: find out why, and reject",
        )
    if new := [reason for reason in against if reason not in seen.against]:
        raise BadInput(
            f"{who.by} saw correction {case.text} before this was known: {'; '.join(new)}",
            seen.url,
            "look at it again, then decide",
        )
    _look_at_questions(case, who, seen)
    known = [reason for entry in case.before.seen_all(case.text) for reason in entry.against]
    return dataclasses.replace(seen, against=tuple(dict.fromkeys(known)))


def _check_holder(case: _Case, link: CommandLink) -> None:
    """That flight would take the second step from this key."""
    waits, mine = case.waits, case.signer.key.id
    if waits.other_than and holder(mine) == holder(waits.armed_key):
        raise CommandFailed(
            f"GO of correction {case.text} has to be given with {waits.other_than}; this is key {mine}",
            link.url,
            f"the second person: `kincal review go {case.text} --keys FILE`; {waits.left_s:.0f} s are left",
        )


def remarks_since(before: journal.Journal, seen: Entry, by: str) -> list[str]:
    """Comments and questions about a correction that others wrote after a line that says that it was seen."""
    return _remarks_after(before, _line(before, seen), seen.crc, by)


def _line(kept: journal.Journal, entry: Entry) -> int:
    return max(n for n, one in enumerate(kept.entries, 1) if one == entry)


def _remarks_after(found: journal.Journal, at: int, crc: str, by: str) -> list[str]:
    """Comments and questions about a correction that others wrote below a line."""
    mine = by.strip().casefold()
    return [
        _cut(journal.remark_text(n, e), _MOST_OF_ONE)
        for n, e in enumerate(found.entries, 1)
        if n > at and e.decision in journal.REMARKS and e.crc == crc and e.by.strip().casefold() != mine
    ]


def _look_at_questions(case: _Case, who: Operator, seen: Entry) -> None:
    """Name the open questions; BadInput if somebody else has asked or said something of the correction since
    `who.by` has seen it: an answer may be a reason to reject it."""
    now = journal.read(who.journal, case.signer.known)  # housekeeping was waited for since `case.before`
    if new := _remarks_after(now, _line(case.before, seen), seen.crc, who.by):
        raise BadInput(
            f"{who.by} saw correction {case.text} before this was written: {'; '.join(new)}",
            str(who.journal),
            "look at it again with `kincal review show`, then decide",
        )
    for n, entry in now.open_questions(case.text).items():
        who.say(f"note: {journal.question_text(n, entry)}")


def _say_overridden(who: Operator, reasons: Sequence[str]) -> None:
    for reason in reasons:
        who.say(f"reason to reject, overridden: {reason}")


def check_words_of_override(override: str) -> None:
    """BadInput if it is too short to be a reason, or too long for the journal."""
    check_words("override", override or "-")
    n = sum(any(map(str.isalnum, word)) for word in override.split())
    if n < LEAST_WORDS:
        raise BadInput(
            f"an override has to say why in at least {LEAST_WORDS} words; this one has {n}: {override!r}",
            "--override",
            "say why it is approved in spite of the reasons to reject it: the journal keeps it",
        )


def _check_override(case: _Case, seen: Entry, override: str) -> list[str]:
    """The reasons to reject that are overridden; BadInput if there are some and no override, or the other way
    round."""
    reasons = reasons_known([seen], case.waits.verdict)
    if override and not reasons:
        raise BadInput(f"there is nothing to override: nothing speaks against correction {case.text}",
                       todo="leave --override out")  # fmt: skip
    if reasons and not override.strip():
        raise BadInput(
            f"there are reasons to reject correction {case.text}: {'; '.join(reasons)}",
            seen.url,
            f"`kincal review reject {case.text}`; to approve it in spite of them, say why in at least "
            f"{LEAST_WORDS} words: --override REASON",
        )
    if reasons:
        check_words_of_override(override)
    return reasons


def first_step(entries: Sequence[Entry], crc: str, armed_key: int) -> Entry | None:
    """The line of the first step that is in force, if it is in this journal: the newest one, unless it was
    given with another key than flight names (0: none is known), or longer ago than flight may wait."""
    for entry in reversed(entries):
        if (entry.decision, entry.crc) != (journal.ARMED, crc):
            continue
        age = datetime.datetime.now(datetime.UTC) - datetime.datetime.fromisoformat(entry.time)
        other_key = armed_key and entry.key_id and entry.key_id != armed_key
        return None if other_key or age.total_seconds() > _MOST_WAIT_S else entry
    return None


def _overridden(case: _Case, seen: Entry, first: Entry | None, override: str) -> tuple[str, list[str]]:
    """Why the second step is taken in spite of reasons to reject, and these: as the first step says (None: it
    is not in this journal), or as `override` says. BadInput if there are some and neither does."""
    if first is None:
        return override, _check_override(case, seen, override)
    if override:
        raise BadInput(
            f"{first.by} has taken the first step, and said what it overrides: "
            f"{journal.one_line(first.override) or 'nothing'}",
            todo="leave --override out",
        )
    reasons = reasons_to_reject(seen)
    if reasons and not first.override:
        raise BadInput(
            f"the first step overrides nothing, and there are reasons to reject correction {case.text}: "
            f"{'; '.join(reasons)}",
            seen.url,
            f"`kincal review reject {case.text}`; to approve it in spite of them, wait until the "
            f"approval has expired ({case.waits.left_s:.0f} s), then `kincal review arm {case.text} "
            "--override REASON`",
        )
    return first.override, reasons


def _write(case: _Case, who: Operator, decision: str, seen: Entry | None, override: str = "") -> None:
    """Flight has taken it: whatever the journal does, what comes of the command is waited for."""
    case.taken.append(decision)
    armed_key = case.waits.armed_key if decision == journal.APPROVED else 0
    try:
        record(
            who.journal,
            decision,
            case.crc,
            who.by,
            who.why,
            case.url,
            seen,
            case.signer,
            override,
            armed_key=armed_key,
        )
    except KincalError as error:
        case.unwritten.append(error)
        who.say(f"NOT in the journal: {error.what}")
    else:
        who.say(f"recorded in {who.journal}")
