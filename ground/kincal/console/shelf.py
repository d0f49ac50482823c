"""Tables behind the console: those of its folder and those made here, beside those in force: values, read
back, difference, send."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from kincal import tables
from kincal.api import operate
from kincal.api.tables import check
from kincal.link import unsigned32, write_image
from kincal.pages.page import Grid
from kincal.review import check_words, parse_crc
from kincal_shared.errors import BadInput, CommandFailed, KincalError

from .desk import Desk, Words
from .document import plain_grid
from .geometry import Geometry, candidates
from .words import kinds

if TYPE_CHECKING:
    from kincal.flight.headers import KcSpace

REVIEWED = "KIN"
"""What only a review puts in force."""
_MOST_ROWS = 1500
_TABLE_S = 20.0  # at least, for an answer while a table is on its way
FOLDER, MADE, READ = "folder", "made", "read"
"""Where a table lies: in the folder of the console, made here, or read back."""
Plain = dict[str, Any]


@dataclass
class Shelf:
    """folder: tables of this console; made: those that were made here (a search space, the terms of a
    model); read: those that were read back; desk: None: nothing can be sent."""

    folder: Path
    made: Path
    read: Path
    desk: Desk | None

    def place(self, kind: str, of: str) -> Path:
        """File of a table. BadInput for an unknown kind or place."""
        where = {FOLDER: self.folder, MADE: self.made, READ: self.read}.get(of)
        if kind.upper() not in kinds().values() or where is None:
            raise BadInput(f"no such table: {kind[:40]} {of[:40]}")
        return where / f"{kind.lower()}.tbl"

    def flown(self) -> Path:
        """A folder with the tables in force, as far as they lie here; of other kinds those of `folder`."""
        hk = self.desk.picture.newest("KC_HK") if self.desk is not None else None
        out = self.made.parent / "flown"
        out.mkdir(parents=True, exist_ok=True)
        for number, kind in kinds().items():
            wanted = unsigned32(hk.table_crc[number]) if hk is not None else 0
            found = [f for of in (FOLDER, MADE, READ) if (f := self.place(kind, of)).is_file()]
            right = next((f for f in found if _crc(f) == wanted), None)
            if right is None and found and (hk is None or kind != REVIEWED):
                right = found[0]
            _copy(right, out / f"{kind.lower()}.tbl")
        return out

    def adopt(self) -> None:
        """From now on names, limits and pictures are those of the tables in force, as far as they lie here:
        without it, a correction of a TERMS table that was sent from here could not be shown."""
        desk = self.desk
        if desk is None:
            return
        try:
            folder = self.flown()
            found = Geometry(folder)
        except (KincalError, OSError):
            return  # a full disk, or tables that do not belong together: the earlier ones stay
        if found.crcs != desk.picture.geometry.crcs or desk.tables_dir != folder:
            desk.picture.geometry, desk.tables_dir = found, folder

    def candidates(self, crc: str) -> Plain:
        """Tool positions of the SPACE table with this CRC. BadInput if it does not lie here."""
        for of in (FOLDER, MADE, READ):
            file = self.place("SPACE", of)
            if file.is_file() and _crc(file) == parse_crc(crc):
                return {"space": crc, "candidates_m": candidates(cast("KcSpace", tables.load(file)[1]))}
        raise BadInput(f"SPACE table {crc} does not lie here", todo="read it back in Space")

    # ---- looking

    def state(self) -> list[Plain]:
        """A row a kind: CRC in force, in the folder and read back."""
        return [self.row(kind) for _, kind in sorted(kinds().items())]

    def row(self, kind: str) -> Plain:
        """CRCs of a kind by place, empty for none; trouble: of the one in the folder."""
        out: Plain = {"kind": kind, "file": str(self.place(kind, FOLDER)), "trouble": ""}
        for of in (FOLDER, MADE, READ):
            file, name = self.place(kind, of), "crc" if of == FOLDER else of
            out[name] = ""
            try:
                if of == FOLDER or file.is_file():
                    out[name] = tables.load(file)[0].crc_text
            except KincalError as error:
                out["trouble"] = out["trouble"] or error.what
        return out

    def values(self, kind: str, of: str = FOLDER) -> Plain:
        """Every field of a table."""
        file = self.place(kind, of)
        image, struct = tables.load(file)
        flat = tables.flatten(tables.readable(struct))
        rows = [[path, _said(value)] for path, value in list(flat.items())[:_MOST_ROWS]]
        rest = len(flat) - len(rows)
        note = f"{rest} more fields: `kincal table show {file}`" if rest > 0 else ""
        return {"crc": image.crc_text, "grid": plain_grid(Grid.of("<field|<value", rows, note))}

    def difference(self, kind: str, of: str = FOLDER, to: str = READ) -> Plain:
        """Between two tables of a kind, as a rule the one of the folder and the one that was read back."""
        file, there = self.place(kind, of), self.place(kind, to)
        if not file.is_file() or not there.is_file():
            missing = "was not read back yet" if file.is_file() and to == READ else "is not there"
            raise BadInput(f"the {kind} table {missing}", todo="Read back brings it down from flight")
        mine, other, changes = tables.diff(file, there)
        rows = [[c.path, *_differing(c.a, c.b)] for c in changes[:_MOST_ROWS]]
        rest = len(changes) - len(rows)
        names = {FOLDER: "in the folder", MADE: "made here", READ: "read back"}
        heads = f"<field|<{names[of]}|<{names[to]}"
        grid = Grid.of(heads, rows, f"{rest} more" if rest > 0 else "")
        return {"crc": mine.crc_text, "read": other.crc_text, "n": len(changes), "grid": plain_grid(grid)}

    # ---- the link

    def read_back(self, kind: str) -> Plain:
        """Bring down the table in force."""
        desk, name = self._desk(), kind.lower()
        file = self.place(kind, READ)
        operate.refuse_several("TABLE_DUMP", desk.picture.several(), desk.url)
        who = desk.operator(Words("console", "read back at the console"))
        with desk.link(signed=True) as link:
            image = operate.read_back(link, name, who, max(desk.timeout_s, _TABLE_S))
        write_image(image, file)
        desk.picture.note("info", "READ_BACK", f"{kind} table {image.crc_text}, {len(image.data)} bytes")
        return {"ok": True, "text": f"{kind} table {image.crc_text} read back"}

    def send(self, kind: str, crc: str, words: Words, of: str = FOLDER) -> Plain:
        """Put a table in force; crc: as it was shown. BadInput if flight would refuse it."""
        desk = self._desk()
        check_words(words.by, words.why)
        if kind.upper() == REVIEWED:
            raise BadInput(
                f"a {REVIEWED} table is not sent from here: corrections are reviewed",
                todo="in an emergency `kincal table uplink`",
            )
        if of == READ:
            raise BadInput("a table that was read back is in force, or was: choose one to send")
        file = self.place(kind, of)
        image, _ = check(file, self.flown())
        if image.crc_text != crc:
            raise CommandFailed(
                f"the file holds table {image.crc_text} now, not {crc}",
                str(file),
                "look at it again, then send it",
            )
        operate.refuse_several("the table", desk.picture.several(), desk.url)
        with desk.link(signed=True) as link:
            operate.uplink(link, image, desk.operator(words), max(desk.timeout_s, _TABLE_S))
        text = f"{kind} table {image.crc_text} is in force"
        desk.picture.note("info", "TABLE", f"{text}, by {words.by}: {words.why}")
        return {"ok": True, "text": text}

    def activate(self, kind: str, crc: str, words: Words) -> Plain:
        """Put in force what is staged and checked, as `kincal command activate`: somebody else sent it.
        CommandFailed, before it is sent, if flight would refuse it by the last telemetry."""
        desk = self._desk()
        self.place(kind, FOLDER)
        if kind.upper() == REVIEWED:
            raise BadInput(
                f"a {REVIEWED} table is not put in force from here: corrections are reviewed",
                todo="in an emergency `kincal command activate kin CRC`",
            )
        number = parse_crc(crc)
        return desk.command(lambda _s: operate.activate(kind.lower(), number), words)

    def _desk(self) -> Desk:
        if self.desk is None:
            raise BadInput("this is a recording: nothing can be sent")
        return self.desk


def _copy(source: Path | None, to: Path) -> None:
    """The same content, replaced as a whole; none if there is none."""
    if source is None:
        to.unlink(missing_ok=True)
    elif not to.is_file() or to.read_bytes() != source.read_bytes():
        part = to.with_suffix(".part")
        part.write_bytes(source.read_bytes())
        part.replace(to)


def _crc(file: Path) -> int | None:
    try:
        return tables.load(file)[0].crc
    except KincalError:
        return None


def _differing(a: Any, b: Any) -> tuple[str, str]:
    """Both values; of those that look the same, by how much the second is more."""
    short = _said(a), _said(b)
    return short if short[0] != short[1] else (short[0], f"{short[1]} ({b - a:+.0e})")


def _said(value: Any) -> str:
    if value is None:
        return "absent"
    return f"{value:.9g}" if isinstance(value, float) else str(value)
