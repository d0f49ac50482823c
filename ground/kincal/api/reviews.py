"""Proposed corrections in logs, and the journals of decisions about them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from kincal.link import read_log
from kincal.review import Review, find, warnings
from kincal.review import journal as journals
from kincal.review.journal import Journal
from kincal.review.status import Listed, Status, proposals_in, status
from kincal.review.thresholds import Limits, read_limits
from kincal_shared.keys import file_of
from kincal_shared.keys import read as read_keys


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


@dataclass(frozen=True)
class Shown:
    """A proposal with all that a reviewer needs: warnings, what became of it, limits of the tables."""

    review: Review
    warnings: list[str]
    about: Status
    limits: Limits | None


def show(log: Path, crc: str | None, tables_dir: Path, found: Sequence[Journal]) -> Shown:
    """The proposal of a log with that CRC, the last if there is none. BadInput if it is not there."""
    review, limits = find(log, crc, tables_dir), read_limits(tables_dir)
    entries = [entry for one in found for entry in one.entries]
    return Shown(review, warnings(review), status(read_log(log), review, entries), limits)
