"""What an operator does, with a line in the journal before it and one after it.

The line before says that it was attempted, so that a program that ends in between leaves a trace; the line
after says what came of it. ABORT is sent first and written down afterwards: nothing may stand in its way."""

from __future__ import annotations

from collections.abc import Callable

from kincal.link import CommandLink
from kincal.review import check_words, journal, record
from kincal.review.decisions import Accepted, Command, Operator, signer_of
from kincal_shared.errors import CommandFailed, KincalError, NoAnswer
from kincal_shared.keys import Signer

from .commands import ACCEPTED, DONE, END_OTHER, REFUSED, Request, Step, Tracked
from .sender import listen, send
from .snapshot import SEVERAL, Snapshot

Say = Callable[[Step], None]
OTHERS_S = 1.2
"""A little more than the period of housekeeping: each flight on the network is heard in that time."""
_HEARTBEATS = 3  # with these, another flight would have been heard between two of one
NOT_AGAIN = (
    "do not send it again: see to the journal, then write down by `kincal review comment` what came of it"
)
"""After a command whose end could not be written down."""


def act(link: CommandLink, request: Request, who: Operator, snapshot: Snapshot, say: Say) -> Tracked:
    """Send a command and write it down. BadInput before anything is sent if it cannot be signed or the
    journal is not sound, CommandFailed if more than one flight is heard; an ABORT is sent all the same, and
    `who.say` tells what could not be written."""
    if request.opcode == "ABORT":
        tracked = send(link, request, snapshot, who.timeout_s, say)
        _write_abort(link, who, tracked)
        return tracked
    check_words(who.by, who.why)
    signer = signer_of(link)
    refuse_others(link, snapshot, request.opcode)
    write(link, who, signer, request, journal.ATTEMPT, who.why)
    try:
        tracked = send(link, request, snapshot, who.timeout_s, say)
    except BaseException as error:
        why = str(error).splitlines()[0] if isinstance(error, KincalError) else "interrupted"
        write(link, who, signer, request, journal.UNANSWERED, why)
        raise
    try:
        write(link, who, signer, request, outcome(tracked), _why(who, tracked))
    except KincalError as error:
        raise CommandFailed(
            f"{tracked.last_line} But the journal has only the attempt: {error.what}", error.where, NOT_AGAIN
        ) from None
    return tracked


def refuse_several(what: str, several: bool, url: str) -> None:
    """CommandFailed if more than one flight is heard: each would take the command."""
    if several:
        raise CommandFailed(f"{what} was not sent: {SEVERAL}", url, END_OTHER)


def refuse_others(link: CommandLink, snapshot: Snapshot, what: str) -> None:
    """Listen for as long as each flight on the network needs to be heard, then refuse as `refuse_several`:
    for a command that is sent by a program that has only just begun to listen."""
    listen(link, snapshot, OTHERS_S, lambda s: s.heartbeats >= _HEARTBEATS)
    refuse_several(what, snapshot.doubtful(link.clock_s()), link.url)


def outcome(tracked: Tracked) -> str:
    """What the journal says of a command that has an outcome: its name in small letters if flight took it."""
    if tracked.outcome in (DONE, ACCEPTED):
        return tracked.request.opcode.lower()
    return journal.REFUSED if tracked.outcome == REFUSED else journal.UNANSWERED


def _why(who: Operator, tracked: Tracked) -> str:
    return who.why if tracked.outcome == DONE else tracked.last_line


def write(link: CommandLink, who: Operator, signer: Signer, request: Request, what: str, why: str) -> None:
    """A line of the journal about a command."""
    record(who.journal, what, request.crc, who.by, why, link.url, None, signer, command=request.opcode)


def _write_abort(link: CommandLink, who: Operator, tracked: Tracked) -> None:
    if link.signer is None:
        who.say("not in the journal: there is no key to vouch for the line")
        return
    try:
        write(link, who, link.signer, tracked.request, outcome(tracked), _why(who, tracked))
    except KincalError as error:
        who.say(f"not in the journal: {error}")


def verified(snapshot: Snapshot, say: Say) -> Command:
    """Sends a decision as `act` sends a command, for an `Operator`: its verifiers go to `say`."""

    def command(
        link: CommandLink, opcode: str, args: tuple[int, ...], timeout_s: float, accepted: Accepted
    ) -> None:
        def reached(step: Step) -> None:
            say(step)
            if step.stage == ACCEPTED:
                accepted()

        refuse_others(link, snapshot, opcode)
        tracked = send(link, Request(opcode, args), snapshot, timeout_s, reached)
        if tracked.outcome in (DONE, ACCEPTED):
            return
        failed = CommandFailed if tracked.outcome == REFUSED else NoAnswer
        raise failed(tracked.last_line, link.url)

    return command


def comment(file: str, what: str, crc: int, who: Operator, signer: Signer) -> None:
    """A question or comment about a correction (crc 0: about the mission) goes into the journal."""
    check_words(who.by, who.why)
    record(who.journal, what, crc, who.by, who.why, file, None, signer)
