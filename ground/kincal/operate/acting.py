"""What an operator does, with a line in the journal before it and one after it.

The line before says that it was attempted, so that a program that ends in between leaves a trace; the line
after says what came of it. ABORT is sent first and written down afterwards: nothing may stand in its way."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from kincal.flight import library
from kincal.flight.tables import Image, kind_number
from kincal.link import CommandLink, dump, upload
from kincal.review import check_words, journal, record
from kincal.review.decisions import Accepted, Command, Operator, signer_of
from kincal_shared.errors import CommandFailed, KincalError, NoAnswer
from kincal_shared.keys import Signer

from .commands import ACCEPTED, DONE, END_OTHER, REFUSED, Request, Step, Tracked, activate
from .sender import listen, send
from .snapshot import SEVERAL, Snapshot

if TYPE_CHECKING:
    from kincal.link.messages import Hk

Say = Callable[[Step], None]
OTHERS_S = 1.2
"""A little more than the period of housekeeping: each flight on the network is heard in that time."""
_HEARTBEATS = 3  # with these, another flight would have been heard between two of one
UNSIGNED = ("ABORT", "NOOP")
"""What flight takes without a signature."""
NOT_AGAIN = (
    "do not send it again: see to the journal, then write down by `kincal review comment` what came of it"
)
"""After a command whose end could not be written down."""


def act(link: CommandLink, request: Request, who: Operator, snapshot: Snapshot, say: Say) -> Tracked:
    """Send a command and write it down. BadInput before anything is sent if it cannot be signed or the
    journal is not sound, CommandFailed if more than one flight is heard; an ABORT is sent all the same, and
    `who.say` tells what could not be written. Without a key NOOP is sent too, and written nowhere."""
    if request.opcode == "ABORT":
        tracked = send(link, request, snapshot, who.timeout_s, say)
        _write_abort(link, who, tracked)
        return tracked
    if link.signer is None and request.opcode in UNSIGNED:
        refuse_others(link, snapshot, request.opcode)
        return send(link, request, snapshot, who.timeout_s, say)
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


def uplink(
    link: CommandLink, image: Image, who: Operator, timeout_s: float, snapshot: Snapshot | None = None
) -> None:
    """Put a table in force, and write it down: the attempt before its first chunk is sent, then that flight
    has taken its last command, refused one, or did not answer. BadInput and CommandFailed as for `act`;
    timeout_s: longest wait for an answer."""
    check_words(who.by, who.why)
    refuse_others(link, snapshot or Snapshot(), "the table")
    with _written(link, who, activate(image.kind.lower(), image.crc)) as taken:
        upload(link, image, timeout_s, taken)


def read_back(
    link: CommandLink, kind: str, who: Operator, timeout_s: float, snapshot: Snapshot | None = None
) -> Image:
    """Bring down the table in force of a kind (lower case), or "proposal", and write it down as `uplink`
    does. The lines name the CRC that housekeeping has of it."""
    check_words(who.by, who.why)
    refuse_others(link, snapshot or Snapshot(), "TABLE_DUMP")
    hk = link.wait_hk(lambda _hk: True, timeout_s, "housekeeping")
    with _written(link, who, _dumped(kind, hk)) as taken:
        image = dump(link, kind, timeout_s)
        taken()
    return image


def _dumped(kind: str, hk: Hk) -> Request:
    if kind == "proposal":
        return Request("TABLE_DUMP", (int(library("flight").constant("KC_STORE_PROPOSAL")), hk.proposal_crc))
    number = kind_number(kind)
    return Request("TABLE_DUMP", (number, hk.table_crc[number]))


@contextmanager
def _written(link: CommandLink, who: Operator, request: Request) -> Iterator[Callable[[], None]]:
    """The attempt is written before anything is sent; what is given has to be called when flight has taken
    all of it. Otherwise it is written that it was refused, or that nobody knows."""
    signer = signer_of(link)
    taken: list[str] = []
    unwritten: list[KincalError] = []

    def took() -> None:
        taken.append(request.opcode)
        try:
            write(link, who, signer, request, request.opcode.lower(), who.why)
        except KincalError as error:
            unwritten.append(error)

    write(link, who, signer, request, journal.ATTEMPT, who.why)
    try:
        yield took
    except BaseException as error:
        if not taken:
            known = isinstance(error, KincalError) and not isinstance(error, NoAnswer)
            why = str(error).splitlines()[0] if isinstance(error, KincalError) else "interrupted"
            write(link, who, signer, request, journal.REFUSED if known else journal.UNANSWERED, why)
        raise
    for why_not in unwritten:
        said = f"flight took {request.opcode}, but the journal has only the attempt: {why_not.what}"
        raise CommandFailed(said, why_not.where, NOT_AGAIN)


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
    name, kind = request.opcode, request.kind
    record(who.journal, what, request.crc, who.by, why, link.url, None, signer, command=name, kind=kind)


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
