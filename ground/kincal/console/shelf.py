"""Tables behind the console: those of its folder beside those in force, values, read back, difference, send;
and why a candidate is in the search space."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kincal import tables
from kincal.api import operate
from kincal.api.tables import check
from kincal.link import dump, upload, write_image
from kincal.operate.acting import write
from kincal.pages.page import Cell, Grid
from kincal.review import check_words, journal
from kincal_shared import installation
from kincal_shared.errors import BadInput, CommandFailed, KincalError

from .desk import Desk, Words
from .document import plain_grid
from .words import kinds

if TYPE_CHECKING:
    from kincal.space import CheckLine, Checks, SpaceTable

REVIEWED = "KIN"
"""What only a review puts in force."""
_MOST_ROWS = 1500
_SPACE_SOURCE = "tables/src/space.toml"
Plain = dict[str, Any]


@dataclass
class Shelf:
    """folder: tables of this console; read: where those that were read back are kept; desk: None: nothing can
    be sent."""

    folder: Path
    read: Path
    desk: Desk | None
    _checks: tuple[Checks, SpaceTable] | None = None
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def _file(self, kind: str) -> Path:
        if kind.upper() not in kinds().values():
            raise BadInput(f"no such kind of table: {kind[:40]}")
        return self.folder / f"{kind.lower()}.tbl"

    # ---- looking

    def state(self) -> list[Plain]:
        """A row a kind: CRC in force, in the folder and read back."""
        return [self._row(kind) for _, kind in sorted(kinds().items())]

    def _row(self, kind: str) -> Plain:
        file, there = self._file(kind), self.read / f"{kind.lower()}.tbl"
        row: Plain = {"kind": kind, "file": str(file), "crc": "", "trouble": "", "read": ""}
        try:
            row["crc"] = tables.load(file)[0].crc_text
        except KincalError as error:
            row["trouble"] = error.what
        if there.is_file():
            row["read"] = tables.load(there)[0].crc_text
        return row

    def values(self, kind: str) -> Plain:
        """Every field of the table in the folder."""
        image, struct = tables.load(self._file(kind))
        flat = tables.flatten(tables.readable(struct))
        rows = [[path, _said(value)] for path, value in list(flat.items())[:_MOST_ROWS]]
        rest = len(flat) - len(rows)
        note = f"{rest} more fields: `kincal table show {self._file(kind)}`" if rest > 0 else ""
        return {"crc": image.crc_text, "grid": plain_grid(Grid.of("<field|<value", rows, note))}

    def difference(self, kind: str) -> Plain:
        """Between the table in the folder and the one that was read back."""
        there = self.read / f"{kind.lower()}.tbl"
        if not self._file(kind).is_file() or not there.is_file():
            raise BadInput(f"the {kind} table was not read back yet")
        mine, board, changes = tables.diff(self._file(kind), there)
        rows = [[c.path, _said(c.a), _said(c.b)] for c in changes[:_MOST_ROWS]]
        rest = len(changes) - len(rows)
        grid = Grid.of("<field|<in the folder|<read back", rows, f"{rest} more" if rest > 0 else "")
        return {"crc": mine.crc_text, "read": board.crc_text, "n": len(changes), "grid": plain_grid(grid)}

    # ---- the link

    def read_back(self, kind: str) -> Plain:
        """Bring down the table in force."""
        desk, name = self._desk(), kind.lower()
        self._file(kind)
        with desk.link(signed=True) as link:
            image = dump(link, name, max(desk.timeout_s, 20.0))
        write_image(image, self.read / f"{name}.tbl")
        desk.picture.note("info", "READ_BACK", f"{kind} table {image.crc_text}, {len(image.data)} bytes")
        return {"ok": True, "text": f"{kind} table {image.crc_text} read back"}

    def send(self, kind: str, crc: str, words: Words) -> Plain:
        """Put the table of the folder in force; crc: as it was shown. BadInput if flight would refuse it."""
        desk = self._desk()
        check_words(words.by, words.why)
        if kind.upper() == REVIEWED:
            raise BadInput(
                f"a {REVIEWED} table is not sent from here: corrections are reviewed",
                todo="in an emergency `kincal table uplink`",
            )
        image, _ = check(self._file(kind), self.folder)
        if image.crc_text != crc:
            raise CommandFailed(
                f"the file holds table {image.crc_text} now, not {crc}", str(self._file(kind))
            )
        request, who = operate.activate(kind.lower(), image.crc), desk.operator(words)
        with desk.link(signed=True) as link:
            signer = link.signer
            if signer is None:
                raise BadInput("a table has to be signed")
            write(link, who, signer, request, journal.ATTEMPT, words.why)
            try:
                upload(link, image, max(desk.timeout_s, 20.0))
            except KincalError as error:
                write(link, who, signer, request, journal.UNANSWERED, error.what)
                raise
            write(link, who, signer, request, request.opcode.lower(), words.why)
        text = f"{kind} table {image.crc_text} is in force"
        desk.picture.note("info", "TABLE", f"{text}, by {words.by}: {words.why}")
        return {"ok": True, "text": text}

    def _desk(self) -> Desk:
        if self.desk is None:
            raise BadInput("this is a recording: nothing can be sent")
        return self.desk

    # ---- the search space

    def explain(self, candidate: int) -> Plain:
        """All checks of a candidate of the SPACE table in the folder."""
        installation.require("sim", "an explanation")
        from kincal import space
        from kincal.api import spaces

        with self._lock:
            if self._checks is None:
                _, table = spaces.load(self._file("SPACE"), self.folder)
                self._checks = spaces.checks(installation.file(_SPACE_SOURCE), self.folder), table
            asked, table = self._checks
            lines = space.explain_candidate(asked, table, candidate)
        rows = [(x.check, x.got, x.want, _kept(x)) for x in lines]
        good = all(x.ok for x in lines if x.counts)
        return {
            "candidate": candidate,
            "good": good,
            "of": table.n_candidates,
            "grid": plain_grid(Grid.of("<check|<found|<wanted|<kept", rows)),
        }


def _kept(line: CheckLine) -> Cell:
    if not line.counts:
        return Cell("for information")
    return Cell("yes", "good") if line.ok else Cell("no", "bad")


def _said(value: Any) -> str:
    if value is None:
        return "absent"
    return f"{value:.9g}" if isinstance(value, float) else str(value)
