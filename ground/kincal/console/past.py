"""History behind the console: from the recordings of its link, kept by file so that each is read once, and
from what was heard since."""

from __future__ import annotations

import hashlib
import json
import threading
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from kincal import tables
from kincal.operate.recording import recordings
from kincal.pages import history as pages
from kincal.pages.page import Provenance
from kincal.review import Entry, history
from kincal_shared.errors import KincalError

from .document import document
from .shelf import FOLDER, MADE, READ, Shelf

if TYPE_CHECKING:
    from kincal.flight.headers import KcTerms

    from .desk import Desk
    from .picture import Picture

_MOST_FILES = 60
Plain = dict[str, Any]


@dataclass
class Past:
    """url: of the link; recorded: folder of its recordings, None: the usual one; folder: of what was read of
    them; picture: what was heard; shelf: for the TERMS tables; desk: for the journal; logs: instead of
    the recordings of the link."""

    url: str
    recorded: Path | None
    folder: Path
    picture: Picture
    shelf: Shelf
    desk: Desk | None
    logs: tuple[Path, ...] = ()
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def page(self) -> Plain:
        """The page of the history, as `kincal review history` shows it."""
        with self._lock:
            logs = self._recorded()
            found = history.joined([*logs, self._heard()])
        entries: tuple[Entry, ...] = ()
        trouble = ""
        if self.desk is not None:
            try:
                entries = self.desk.entries()
            except KincalError as error:
                trouble = str(error)
        trends = history.trends(found, self._terms(), entries)
        today = Provenance(datetime.now(UTC).date().isoformat())
        made = pages.page(found, trends, entries, today, recorded=bool(logs))
        return {"page": document(made), "trouble": trouble, "corrections": len(found.corrections)}

    def _recorded(self) -> list[history.History]:
        return [self._of(log) for log in self.logs or recordings(self.recorded, self.url)[:_MOST_FILES]]

    def _of(self, log: Path) -> history.History:
        place = hashlib.sha256(str(log.resolve()).encode()).hexdigest()[:12]  # two may have the same name
        kept = self.folder / f"{log.stem}-{place}.json"
        try:
            before = history.History.of_dict(json.loads(kept.read_text("utf-8")))
        except (OSError, ValueError, TypeError, KeyError):
            before = history.History()
        try:
            size = log.stat().st_size
            if size == before.end:
                return before
            if size < before.end:  # another file of that name
                before = history.History()
            found = history.go_on(before, log)
        except (OSError, KincalError):
            return before  # it was removed meanwhile
        self.folder.mkdir(parents=True, exist_ok=True)
        kept.write_text(json.dumps(found.as_dict()), "utf-8")
        return found

    def _heard(self) -> history.History:
        """Of a console that does not record: corrections that it holds, tables in force now."""
        out = history.History()
        hk, now_s = self.picture.newest("KC_HK"), self.picture.clock()
        late_s = now_s - self.picture.t_us * 1e-6  # mission time to UTC
        for heard in self.picture.heard_proposals():
            out.add("KC_PROPOSAL", heard, heard.t_us * 1e-6 + late_s)
        if hk is not None:
            out.add("KC_HK", hk, max(now_s, out.until_s + 1e-3))
        return out

    def _terms(self) -> dict[str, KcTerms]:
        found = {}
        for of in (FOLDER, MADE, READ):
            file = self.shelf.place("TERMS", of)
            try:
                image, struct = tables.load(file)
            except (OSError, KincalError):
                continue
            found[image.crc_text] = cast("KcTerms", struct)
        return found
