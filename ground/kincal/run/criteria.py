"""What a run has to meet."""

from __future__ import annotations

from collections.abc import Iterator

from kincal.link import names
from kincal.results import Criterion, HeldOut, RunResult, angle_text, length_text

from .finished import Finished
from .request import Expectation, Request

INSIDE_SHARE = 0.95  # of the true values must lie inside 3 sigma


def criteria(
    request: Request, expectation: Expectation, done: Finished, result: RunResult
) -> Iterator[Criterion]:
    """All acceptance criteria of a run; without a proposal only how it ended."""
    launch = done.launch
    how = str(launch.get("problem") or launch.get("reason", ""))
    yield Criterion("run ended well", how, "success", bool(launch.get("ok")))
    proposal = done.session.proposal
    if proposal is None:
        return
    verdict = names.verdict_key(proposal.verdict)
    if wanted := expectation.verdict:
        yield Criterion("verdict", verdict, wanted, verdict == wanted)
    if verdict == "change" and not _waits_for_ground(request, expectation):
        active, crc = f"{result.active_crc:08x}", f"{result.crc:08x}"
        yield Criterion("correction in force", active, crc, active == crc)
    if result.after:
        yield from _held_out(expectation, result.after, "" if result.after_is == "after" else ", proposed")
    yield from _true_values(result, set(done.evaluator.errors))


def _waits_for_ground(request: Request, expectation: Expectation) -> bool:
    """Whether the ground decides, but not this command."""
    return (request.accept or expectation.accept) == "ground" and request.accept != "ground"


def _held_out(expectation: Expectation, after: HeldOut, which: str) -> Iterator[Criterion]:
    if (most := expectation.held_out_pos_m) > 0.0:
        got, want = length_text(after.pos_m), f"<= {length_text(most)}"
        yield Criterion(f"held-out position RMS{which}", got, want, after.pos_m <= most)
    if (most := expectation.held_out_rot_rad) > 0.0:
        got, want = angle_text(after.rot_rad), f"<= {angle_text(most)}"
        yield Criterion(f"held-out rotation RMS{which}", got, want, after.rot_rad <= most)


def _true_values(result: RunResult, injected: set[str]) -> Iterator[Criterion]:
    """Only where the model can hold every injected error."""
    estimated = [c for c in result.coefs if c.sigma > 0.0]
    if not estimated or not injected <= {c.name for c in estimated}:
        return
    inside = sum(c.inside_3_sigma for c in estimated)
    got, want = f"{inside} of {len(estimated)}", f">= {INSIDE_SHARE:.0%}"
    yield Criterion("true values inside 3 sigma", got, want, inside >= INSIDE_SHARE * len(estimated))
