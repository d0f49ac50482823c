"""Proposed corrections in logs, and the journals of decisions about them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from kincal.flight.tables import decode_as
from kincal.link import CommandLink, crc_text, dump, read_log, unsigned32
from kincal.operate.recording import recordings
from kincal.review import Review, changes, find, history, warnings
from kincal.review import journal as journals
from kincal.review.changes import Changes
from kincal.review.history import History, Trend
from kincal.review.journal import Entry, Journal
from kincal.review.residuals import PoseResidual, residuals
from kincal.review.status import Listed, Status, proposals_in, status
from kincal.review.thresholds import Limits, read_limits
from kincal_shared.errors import BadInput, CommandFailed, KincalError
from kincal_shared.keys import file_of
from kincal_shared.keys import read as read_keys

from . import corrected
from .corrected import Corrected


def read_journals(logs: Sequence[Path], journal: Path | None, key_file: Path) -> list[Journal]:
    """The journal, and those beside the logs, each checked with its keys."""
    file = file_of(key_file)
    mine = journals.read(journals.place(journal, file), read_keys(file) if file.exists() else ())
    of_runs = {found.path: found for log in logs if (found := journals.of_run(log))}
    return [mine, *(found for path, found in of_runs.items() if path != mine.path)]


def absent(logs: Sequence[Path], found: Sequence[Journal]) -> list[str]:
    """Decisions that flight took in these logs and that no journal holds, in words."""
    return [f"{log}: {text}" for log in logs for text in journals.absent(found, read_log(log))]


def proposals(logs: Sequence[Path], found: Sequence[Journal]) -> list[list[Listed]]:
    """The proposals of each log, and what became of them."""
    lines = [entry for one in found for entry in one.entries]
    return [proposals_in(path, lines) for path in logs]


def history_of(
    logs: Sequence[Path], tables_dir: Path, entries: Sequence[Entry] = ()
) -> tuple[History, list[Trend]]:
    """What was in force when by these logs, and the trend of each coefficient that a folder's TERMS table
    names."""
    found = history.joined(history.go_on(History(), log) for log in logs)
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
            "look_at": self.warnings,
            "changes": self.changes.as_dict(),
            "clearance": self.corrected.as_dict() if self.corrected else None,
            "clearance_unknown": self.why_not,
            "residuals": [asdict(p) for p in self.residuals],
        }


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
    about = status(read_log(log), review, entries)
    clear, why = _clearance(review, tables_dir, (log, *before), space)
    found_changes, stands_out = with_clearance(review, found_changes, clear)
    left = _residuals(log, review, about, tables_dir, before)
    return Shown(review, stands_out, about, limits, found_changes, left, clear, why)


def with_clearance(review: Review, found: Changes, clear: Corrected | None) -> tuple[Changes, list[str]]:
    """What a proposal changes, with what clearance and reach say against it; and everything that stands
    out."""
    if clear is None:
        return found, warnings(review, found.big)
    reasons = (*found.reasons, *clear.reasons)
    return replace(found, reasons=reasons), [*warnings(review, found.big), *clear.look_at]


def _clearance(
    review: Review, tables_dir: Path, places: Sequence[Path], description: Path | None
) -> tuple[Corrected | None, str]:
    """Clearance and reach, or why they are not known."""
    old = changes.kin_values(review.crc_before, (tables_dir, *places))
    try:
        return corrected.of_review(review, old, tables_dir, description), ""
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


def what_rolls_back(
    crc_in_force: int, crc_before: int, tables_dir: Path, places: Sequence[Path] = ()
) -> Changes:
    """What a rollback changes back; both CRCs as in KC_HK (table_crc, kin_prev_crc). BadInput if there is no
    table to go back to, or the values of one of them are in none of the places."""
    where = (tables_dir, *places)
    if not crc_before:
        raise BadInput(
            f"flight holds no table before {crc_in_force:08x} and refuses to roll back",
            todo="`kincal table uplink FILE` brings a KIN table in force that you have",
        )
    now = changes.kin_values(crc_in_force, where)
    if now is None:
        raise BadInput(
            f"the values of correction {crc_in_force:08x} are in none of the places looked at",
            ", ".join(map(str, where)),
            "`kincal table dump kin now.tbl`, then --from now.tbl; or --from LOG that holds its proposal",
        )
    previous = changes.kin_values(crc_before, where)
    if previous is None:
        raise BadInput(
            f"a rollback brings back {crc_before:08x}, whose values are in none of the places looked at",
            ", ".join(map(str, where)),
            "--from LOG that holds its proposal, or --from the KIN table",
        )
    return changes.of_rollback(now, previous, changes.names_of(tables_dir), changes.flown(tables_dir))


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


def asked_for(link: CommandLink, crc: int, tables_dir: Path, places: Sequence[Path] = ()) -> Changes:
    """What the correction that waits on board changes, by its table as flight holds it: values and sigmas
    without covariance, fit and residuals."""
    image = dump(link, "proposal")
    if image.crc != crc:
        raise CommandFailed(f"flight sent table {image.crc_text}, {crc:08x} waits", link.url, "try again")
    kin = decode_as("kin", image.data, link.url)[1]
    old = changes.kin_values(kin.prev_crc, (tables_dir, *places)) if kin.prev_crc else None
    names, n = changes.names_of(tables_dir), int(kin.n_coef)
    values, sigmas = tuple(kin.value[0:n]), tuple(kin.sigma[0:n])
    return changes.of_values(values, sigmas, old, names, changes.flown(tables_dir))
