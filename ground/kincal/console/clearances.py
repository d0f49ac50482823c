"""Clearance and reach of corrections behind the console: computed once for each in a process of its own
(work), `python -m kincal.console.clearances`, and kept."""

from __future__ import annotations

import shutil
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kincal.api import corrected
from kincal.api.corrected import Corrected
from kincal_shared.errors import BadInput, CommandFailed, KincalError

from . import work
from .work import Job, Work

_KEPT = 50
Plain = dict[str, Any]


@dataclass(frozen=True)
class Found:
    """status: done, running, waiting (for another one), or not known; why: it is not; done, of: how far it
    has come."""

    status: str
    corrected: Corrected | None = None
    why: str = ""
    done: int = 0
    of: int = 0

    def as_dict(self) -> Plain:
        """For the browser, without the result."""
        return {"status": self.status, "why": self.why, "done": self.done, "of": self.of}


class Clearances:
    """folder: of the results; descriptions: of search spaces that were built here. A context."""

    def __init__(self, folder: Path, descriptions: Callable[[], Sequence[Path]] = tuple) -> None:
        self.folder, self._descriptions = folder.expanduser(), descriptions
        self.work = Work(self.folder, "kincal.console.clearances", self._kept)
        self._failed: dict[str, str] = {}
        self._lock = threading.Lock()

    def __enter__(self) -> Clearances:
        return self

    def __exit__(self, *_exc: object) -> None:
        self.work.close()

    def ask(
        self,
        crc: str,
        before: Sequence[float] | None,
        after: Sequence[float],
        tables_dir: Path,
        wanted: Mapping[str, int],
    ) -> Found:
        """What is known of a kinematics table with the values `after` (crc: its own), against the one in
        force; what is not is begun. wanted: CRCs of the tables that fly."""
        try:
            if why := corrected.why_not(tables_dir):
                return Found("not known", why=why)
            corrected.require(tables_dir, wanted)
            description = corrected.description_of(tables_dir, self._descriptions())
            name = corrected.identity(before, after, tables_dir, description)
        except (KincalError, OSError) as error:
            return Found("not known", why=str(error))
        what = f"{crc}-{name[:16]}"
        with self._lock:
            try:
                return Found("done", Corrected.of_dict(self.work.answer(what)["corrected"]))
            except (BadInput, KeyError, TypeError):
                pass  # not there, or of another version
            job = self.work.job
            if job is not None and job.what == what and job.status != "running":
                self._failed[what] = job.text
            if what in self._failed:
                return Found("not known", why=self._failed[what])
            if job is None or job.what != what:
                spec = {"before": None if before is None else list(before), "after": list(after),
                        "tables": str(tables_dir.resolve()), "description": str(description),
                        "identity": name}  # fmt: skip
                try:
                    self.work.begin(what, {}, spec)
                except CommandFailed:
                    return Found("waiting")
        progress = self.work.job.progress if self.work.job else {}
        return Found("running", done=progress.get("done", 0), of=progress.get("of", 0))

    def _kept(self, job: Job, _answer: Plain) -> None:
        """Only the newest stay."""
        kept = sorted(self.folder.glob("*/key.json"), key=lambda f: f.stat().st_mtime)
        for file in kept[:-_KEPT]:
            if file.parent.name != job.what:
                shutil.rmtree(file.parent, ignore_errors=True)


def _answer(spec: Plain) -> Plain:
    given = spec["before"], spec["after"], Path(spec["tables"]), Path(spec["description"])
    found = corrected.between(*given, work.progress)
    if corrected.identity(*given) != spec["identity"]:
        raise CommandFailed("the tables have changed meanwhile", spec["tables"], "look at it again")
    return {"corrected": found.as_dict()}


if __name__ == "__main__":
    sys.exit(work.perform(_answer))
