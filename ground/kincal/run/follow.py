"""A run while it goes on: poses as they come, and the ground's decision."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from kincal import review
from kincal.link import CommandLink, Link, Received
from kincal.results import PoseLine
from kincal.review import decisions
from kincal_shared.keys import signer_of

from .evaluate import Evaluator, GroundTruth
from .processes import Processes, read_json
from .request import Expectation, Request

if TYPE_CHECKING:
    from kincal.link.messages import Proposal

ANSWER_S = 10.0
LISTEN = ("KC_ACK", "KC_HK", "KC_MEAS", "KC_PROGRESS", "KC_PROPOSAL")
_POLL_S = 0.05
_DECIDER = "kincal run"


class Observer:
    """What a run reports while it goes on. This one ignores everything: override what is to be shown."""

    def started(self, request: Request, expectation: Expectation) -> None:
        """The run begins."""

    def pose(self, line: PoseLine, n_goal: int) -> None:
        """A pose was measured, in order and without a gap; n_goal: poses planned."""

    def note(self, text: str) -> None:
        """Something else to tell, a sentence."""


def follow(request: Request, processes: Processes, evaluator: Evaluator, observer: Observer) -> int:
    """Report poses while they come, decide if the ground does; returns how many poses were reported."""
    reported = 0
    with Link(processes.url, LISTEN, first_seq=0, signer=signer_of(processes.keys)) as link:
        for received in _until_ended(processes, link):
            message = received.message
            if received.channel == "KC_PROGRESS" and message.pose == reported + 1:
                _learn_truth(request, evaluator)
                observer.pose(evaluator.pose_line(message, None), message.n_goal)
                reported += 1
            elif received.channel == "KC_PROPOSAL" and request.accept == "ground":
                decide(request, link, message, evaluator.names, observer)
    return reported


def _until_ended(processes: Processes, link: Link) -> Iterator[Received]:
    """What is received until the run has ended and nothing more comes."""
    while True:
        ended = not processes.running()
        received = link.next(_POLL_S)
        if received is not None:
            yield received
        elif ended:
            return


def _learn_truth(request: Request, evaluator: Evaluator) -> None:
    """The simulator writes it when it begins."""
    path = request.out / "truth.json"
    if evaluator.truth is None and path.is_file():
        evaluator.learn(GroundTruth.of(read_json(path)))


def decide(
    request: Request, link: CommandLink, proposal: Proposal, names: Sequence[str], observer: Observer
) -> None:
    """The ground's review of a run: approve what flight proposes unless the fit is bad. The decision goes
    into the journal of the run. CommandFailed if flight refuses it."""
    found = review.from_message(proposal, list(names))
    if not found.changes_something:
        return
    journal = request.out / review.journals.NAME

    def record(decision: str, why: str) -> None:
        signer = decisions.signer_of(link)
        review.record(journal, decision, found.crc, _DECIDER, why, link.url, found, signer)

    correction = f"ground: correction {found.crc_text}"
    if reasons := review.reasons_to_reject(found):
        why = "; ".join(reasons)
        decisions.send_reject(link, found.crc, ANSWER_S, lambda: record(review.journals.REJECTED, why))
        observer.note(f"{correction} rejected: {why}")
        return
    observer.note(f"{correction} reviewed, no reason to reject it")
    why = "no reason to reject it"
    decisions.send_arm(link, found.crc, ANSWER_S)
    record(review.journals.ARMED, why)
    observer.note(f"ground: armed for CRC {found.crc_text}")
    decisions.send_go(link, found.crc, ANSWER_S, lambda: record(review.journals.APPROVED, why))
    observer.note(f"ground: approved; table {found.crc_text} is active")
