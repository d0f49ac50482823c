"""Proposed corrections in logs, and the journals of decisions about them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kincal.flight.tables import decode_as
from kincal.link import crc_text, read_log, unsigned32
from kincal.operate.recording import recordings
from kincal.review import (
    OF_A_GOOD_FIT,
    Review,
    changes,
    find,
    history,
    parse_crc,
    poor_fit,
    reasons_known,
    reasons_to_reject,
    warnings,
)
from kincal.review import journal as journals
from kincal.review.changes import Changes
from kincal.review.history import History, Trend
from kincal.review.journal import ARMED, SEEN, Entry, Journal
from kincal.review.residuals import PoseResidual, residuals
from kincal.review.status import Listed, Status, proposals_in, status
from kincal.review.thresholds import Limits, read_limits
from kincal_shared.errors import BadInput, KincalError
from kincal_shared.keys import Key, Signer, file_of
from kincal_shared.keys import read as read_keys

from . import corrected
from .corrected import Corrected

if TYPE_CHECKING:
    from kincal.link.messages import Hk


def read_journals(
    logs: Sequence[Path],
    journal: Path | None,
    key_file: Path,
    how: Callable[[Path, Sequence[Key]], Journal] = journals.read,
) -> list[Journal]:
    """The journal, and those beside the logs, each checked with its keys. how: `journals.inspect` also takes
    those that were changed, to be shown."""
    file = file_of(key_file)
    mine = how(journals.place(journal, file), read_keys(file) if file.exists() else ())
    of_runs = {found.path: found for log in logs if (found := journals.of_run(log, how))}
    return [mine, *(found for path, found in of_runs.items() if path != mine.path)]


def absent(logs: Sequence[Path], found: Sequence[Journal]) -> list[str]:
    """Decisions that flight took in these logs and that no journal holds, in words."""
    return [f"{log}: {text}" for log in logs for text in journals.absent(found, read_log(log))]


def refuse_broken(found: Sequence[Journal]) -> None:
    """The error of the first journal that does not verify, after it was shown."""
    for one in found:
        if one.broken is not None:
            raise one.broken


@dataclass(frozen=True)
class Known:
    """What journals say of a correction that waits. reasons: to reject it; questions: that are open, in
    words; override: who has armed it in spite of the reasons, and why, in words; broken: which journal does
    not verify, "" if all do."""

    reasons: tuple[str, ...] = ()
    questions: tuple[str, ...] = ()
    override: str = ""
    broken: str = ""


def known(found: Sequence[Journal], crc: int, verdict: str, armed: bool = False) -> Known:
    """By the journals, and by the verdict that flight states ("" if it has lost it); armed: the first step
    was taken."""
    text = crc_text(crc)
    lines = [e for one in found for e in one.entries if e.crc == text]
    reasons = reasons_known([e for e in lines if e.decision == SEEN], verdict)
    first = [e for e in lines if e.decision == ARMED and e.override] if armed else []
    override = [f"{e.by}, {e.time}: {journals.one_line(e.override)}" for e in first[-1:]]
    broken = [f"{one.path} does not verify: {one.broken.what}" for one in found if one.broken]
    return Known(tuple(reasons), tuple(questions(found, text)), "".join(override), "; ".join(broken))


def answered(path: Path, signer: Signer, line: int, crc: int, is_question: bool) -> int:
    """CRC of the question in a line of the journal that a comment answers; crc: that was named, 0 if none
    was. BadInput if there is no such question."""
    entries = journals.read(path, signer.known).entries
    asked = entries[line - 1] if 0 < line <= len(entries) else None
    if asked is None or asked.decision != journals.QUESTION:
        where = f"{path}:{line}"
        raise BadInput("there is no question in this line", where, "`kincal audit log` numbers the lines")
    of_question = parse_crc(asked.crc) if asked.crc else 0
    if is_question or crc not in (0, of_question):
        about = f"correction {asked.crc}" if asked.crc else "the mission"
        raise BadInput(f"the question in line {line} is about {about}, and a comment answers it",
                       "--answers", "leave out --question, and --crc")  # fmt: skip
    return of_question


def questions(found: Sequence[Journal], crc: str) -> list[str]:
    """Open questions about a correction, in words."""
    return [journals.question_text(n, e) for one in found for n, e in one.open_questions(crc).items()]


def proposals(logs: Sequence[Path], found: Sequence[Journal]) -> list[list[Listed]]:
    """The proposals of each log, and what became of them."""
    lines = [entry for one in found for entry in one.entries]
    return [proposals_in(path, lines) for path in logs]


def history_of(
    logs: Sequence[Path], tables_dir: Path, entries: Sequence[Entry] = ()
) -> tuple[History, list[Trend]]:
    """What was in force when by these logs, and the trend of each coefficient that a folder's TERMS table
    names. BadInput if they hold nothing of it."""
    parts = [history.go_on(History(), log) for log in logs]
    if not any(part.until_s for part in parts):
        where = ", ".join(map(str, logs))
        raise BadInput(
            "no message of tables or corrections", where, "give logs of a run or of `kincal record`"
        )
    found = history.joined(parts)
    file, terms = tables_dir / "terms.tbl", {}
    if file.is_file():
        image, struct = decode_as("terms", file.read_bytes(), str(file))
        terms[image.crc_text] = struct
    return found, history.trends(found, terms, entries)


@dataclass(frozen=True)
class Shown:
    """A proposal with all that a reviewer needs: what changes, warnings, what became of it, limits of the
    tables, what is left at each pose, clearance and reach; why_not: why these are not known."""

    review: Review
    warnings: list[str]
    about: Status
    limits: Limits | None
    changes: Changes
    residuals: tuple[PoseResidual, ...] = ()
    corrected: Corrected | None = None
    why_not: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Plain data for --json."""
        r, about = self.review, self.about
        return {
            "crc": r.crc_text,
            "replaces": crc_text(r.crc_before),
            "session": r.session,
            "verdict": r.verdict,
            "state": about.state,
            "waits": about.waits,
            "poses": r.n_poses,
            "outliers": r.n_outliers,
            "numbers": r.numbers,
            "do_not_hold": sorted(OF_A_GOOD_FIT) if poor_fit(r) else [],
            "reasons_to_reject": reasons_to_reject(r),
            "look_at": self.warnings,
            "changes": self.changes.as_dict(),
            **clearance_dict(self.corrected, self.why_not),
            "residuals": [asdict(p) for p in self.residuals],
        }


def clearance_dict(found: Corrected | None, why_not: str) -> dict[str, Any]:
    """Clearance and reach for --json."""
    return {"clearance": found.as_dict() if found else None, "clearance_unknown": why_not}


def show(
    log: Path,
    crc: str | None,
    tables_dir: Path,
    found: Sequence[Journal],
    before: Sequence[Path] = (),
    space: Path | None = None,
) -> Shown:
    """The proposal of a log with that CRC, the last if there is none. BadInput if it is not there. before:
    tables, logs and folders that may hold the table in force, after the log and the tables of the folder;
    space: description of the SPACE table, if it is not found (`corrected.description_of`)."""
    review, limits = find(log, crc, tables_dir), read_limits(tables_dir)
    entries = [entry for one in found for entry in one.entries]
    found_changes = what_changes(review, tables_dir, (log, *before), limits)
    summary = read_log(log)
    about = status(summary, review, entries)
    wanted = of_flight(review, summary.hk)
    old = changes.kin_values(review.crc_before, (tables_dir, log, *before))
    clear, why = known_or_why(
        lambda: corrected.of_review(review, old, tables_dir, space, wanted=wanted), space
    )
    review, found_changes, stands_out = with_clearance(review, found_changes, clear, why)
    left = _residuals(log, review, about, tables_dir, before)
    stands_out = [*stands_out, *questions(found, review.crc_text)]
    return Shown(review, stands_out, about, limits, found_changes, left, clear, why)


def of_flight(review: Review, hk: Hk | None) -> dict[str, int]:
    """Kind -> CRC of the tables that clearance and reach of a proposal depend on: those that it was made
    with, of others those in force."""
    now = corrected.in_force(hk.table_crc) if hk is not None else {}
    made = {"arm": review.crc_arm, "terms": review.crc_terms}
    return now | {kind: crc for kind, crc in made.items() if crc}


def with_clearance(
    review: Review, found: Changes, clear: Corrected | None, why_not: str = ""
) -> tuple[Review, Changes, list[str]]:
    """A proposal, and what it changes, with what clearance and reach say against it; and everything that
    stands out. why_not: why they are not known."""
    if clear is None:
        unknown = [f"clearance and reach are not known: {why_not.splitlines()[0]}"] if why_not else []
        return review, found, [*warnings(review, found.big), *unknown]
    review = replace(review, against=clear.against)
    found = replace(found, reasons=(*found.reasons, *clear.reasons))
    return review, found, [*warnings(review, found.big), *clear.look_at]


def known_or_why(compute: Callable[[], Corrected], description: Path | None) -> tuple[Corrected | None, str]:
    """Clearance and reach, or why they are not known. A description that was named and does not fit is an
    error."""
    try:
        return compute(), ""
    except KincalError as error:
        if description is not None:
            raise
        return None, str(error)


def _residuals(
    log: Path, review: Review, about: Status, tables_dir: Path, places: Sequence[Path]
) -> tuple[PoseResidual, ...]:
    flown = changes.flown(tables_dir)
    if flown is None:
        return ()
    old = changes.kin_values(review.crc_before, (tables_dir, log, *places))
    before, after = None if old is None else old.values, [c.value for c in review.coefs]
    return residuals(log, review.session, before, after, flown, about.rejected, about.rejected_extra)


def what_changes(
    review: Review, tables_dir: Path, places: Sequence[Path] = (), limits: Limits | None = None
) -> Changes:
    """What a proposal changes. places: tables, logs and folders that may hold the table in force."""
    old = changes.kin_values(review.crc_before, (tables_dir, *places))
    return changes.of_review(review, old, changes.flown(tables_dir), limits)


def recorded(crc: int, folder: Path | None = None) -> Path | None:
    """The newest recording that holds the proposal of a correction; None if none does."""
    for file in recordings(folder):
        try:
            sessions = read_log(file).sessions.values()
        except KincalError:
            continue  # empty, or no log
        if any(s.proposal is not None and unsigned32(s.proposal.crc) == crc for s in sessions):
            return file
    return None
