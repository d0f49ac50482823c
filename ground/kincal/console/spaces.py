"""Search spaces behind the console: candidates and why they are in, the description as a form, build, check,
difference. What is sent and read back are tables (shelf)."""

from __future__ import annotations

import shutil
import threading
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kincal.pages.page import Cell, Grid
from kincal_shared import installation
from kincal_shared.errors import BadInput

from .description import Form
from .document import plain_grid
from .geometry import Geometry
from .shelf import FOLDER, MADE, Shelf
from .work import Job, Work

if TYPE_CHECKING:
    from kincal.space import CheckLine, Checks, SpaceTable

SOURCE = "tables/src/space.toml"
TASKS = ("build", "check")
PROCESSES = 2
Plain = dict[str, Any]


class Spaces:
    """folder: where description and answers are kept; shelf: of the tables; geometry: of the arm. A
    context."""

    def __init__(self, folder: Path, shelf: Shelf, geometry: Geometry) -> None:
        self.folder, self.shelf, self.geometry = folder.expanduser(), shelf, geometry
        self.work = Work(self.folder / "answers", "kincal.console.spacework", self._made)
        self._lock = threading.RLock()
        self._checks: dict[tuple[str, str], tuple[Checks, SpaceTable]] = {}

    def __enter__(self) -> Spaces:
        return self

    def __exit__(self, *_exc: object) -> None:
        self.work.close()

    # ---- tables

    def _load(self, of: str) -> tuple[str, SpaceTable]:
        from kincal.api import spaces

        file = self.shelf.place("SPACE", of)
        if not file.is_file():
            raise BadInput(f"there is no SPACE table {of} yet", str(file))
        image, table = spaces.load(file, self.shelf.flown())
        return image.crc_text, table

    def state(self) -> Plain:
        """For the browser."""
        return {
            "tables": self.shelf.row("SPACE"),
            "job": self.work.state(),
            "answers": {what: found for what in TASKS if (found := self.work.key_of(what)) is not None},
            "wrong": len(self.form().problems()),
        }

    def candidates(self, of: str) -> Plain:
        """Every candidate of a table, and its numbers."""
        _require()
        from kincal import space
        from kincal.space import words

        crc, table = self._load(of)
        given, rows = space.TablesFolder(self.shelf.flown()), table.candidates()
        facts = words.facts(space.summarise(table, given.camera, given.arm_crc))
        initial = set(table.initial)
        return {
            "crc": crc,
            "rows": [
                {"p_m": [round(float(x), 4) for x in p], "hub": int(hub), "tags": int(tags).bit_count(),
                 "initial": i in initial}
                for i, (p, hub, tags) in enumerate(zip(rows.p_m, rows.hub, rows.tags, strict=True))
            ],
            "facts": plain_grid(Grid.of("<what|<value", facts)),
        }  # fmt: skip

    def explain(self, candidate: int, of: str) -> Plain:
        """All checks of a candidate: why it is in, and the arm there."""
        _require()
        from kincal import space
        from kincal.api import spaces

        with self._lock:
            crc, table = self._load(of)
            description = self._description_of(of)
            if (of, crc) not in self._checks:
                self._checks = {(of, crc): (spaces.checks(description, self.shelf.flown()), table)}
            asked, table = self._checks[of, crc]
            lines = space.explain_candidate(asked, table, candidate)
        rows = [(x.check, x.got, x.want, _kept(x)) for x in lines]
        pan, tilt = (float(x) for x in table.pan_tilt_rad[candidate])
        return {
            "candidate": candidate,
            "crc": crc,
            "good": all(x.ok for x in lines if x.counts),
            "of": table.n_candidates,
            "against": str(description),
            "points_m": self.geometry.posture(table.q_rad[candidate]),
            "view_m": self.geometry.view_at(pan, tilt),
            "grid": plain_grid(Grid.of("<check|<found|<wanted|<kept", rows)),
        }

    def difference(self, of: str, to: str) -> Plain:
        """From one SPACE table to another, candidate by candidate, as `kincal space diff`."""
        _require()
        from kincal import space
        from kincal.space import words

        crc_a, one = self._load(of)
        crc_b, two = self._load(to)
        found = space.compare(one, two, space.TablesFolder(self.shelf.flown()).kernel, 0)
        grid = Grid.of("<what|<value", words.difference(found))
        return {
            "from": crc_a,
            "to": crc_b,
            "same": crc_a == crc_b,
            "gone_m": _places(one, found.only_a),
            "new_m": _places(two, found.only_b),
            "grid": plain_grid(grid),
        }

    # ---- description

    def form(self) -> Form:
        """The description in hand: a copy of the one that ships, until it is changed."""
        file = self.folder / "space.toml"
        if not file.is_file():
            self.folder.mkdir(parents=True, exist_ok=True)
            shutil.copy(installation.file(SOURCE), file)
        return Form(file)

    def description(self) -> Plain:
        """The form and what is wrong with it."""
        form = self.form()
        return {"file": str(form.file), "sections": form.sections(), "problems": form.problems()}

    def change(self, values: Plain) -> Plain:
        """Take values, all or none."""
        if not all(isinstance(text, str) and len(text) < 20_000 for text in values.values()):
            raise BadInput("values are texts")
        with self._lock:
            problems = self.form().change(values)
        wrong = f"{len(problems)} value{'s are' if len(problems) > 1 else ' is'} wrong"
        text = f"{wrong}: nothing was changed" if problems else "kept"
        return {"ok": not problems, "text": text, "problems": problems}

    def begin_anew(self) -> Plain:
        """The description that ships; the one before stays beside it."""
        file = self.form().file
        file.replace(file.with_suffix(".former.toml"))
        return {"ok": True, "text": f"the description of {installation.file(SOURCE)}; the one before is "
                f"{file.with_suffix('.former.toml')}"}  # fmt: skip

    def _description_of(self, of: str) -> Path:
        """What a table was built from, as far as it is known."""
        return self.shelf.made / "space.toml" if of == MADE else installation.file(SOURCE)

    # ---- long work

    def run(self, what: str, of: str) -> Plain:
        """Begin to build the description in hand, or to check a table. CommandFailed if something runs."""
        _require()
        self.work.refuse_two()
        spec: Plain = {"tables": str(self.shelf.flown().resolve()), "processes": PROCESSES,
                       "date": datetime.now(UTC).date().isoformat()}  # fmt: skip
        if what == "build":
            form = self.form()
            if wrong := form.problems():
                raise BadInput(f"the description is wrong: {wrong[0]['text']}", wrong[0]["path"])
            frozen = self.folder / "building.toml"  # the form may be edited meanwhile
            shutil.copy(form.file, frozen)
            return self.work.begin("build", {}, {**spec, "description": str(frozen)})
        if what != "check":
            raise BadInput(f"no such task: {what[:40]}")
        crc, _ = self._load(of)
        where = {
            "table": str(self.shelf.place("SPACE", of)),
            "of": {FOLDER: "table in the folder", MADE: "table built here"}.get(of, "table read back"),
        }
        description = str(self._description_of(of))
        return self.work.begin("check", {"crc": crc}, {**spec, **where, "description": description})

    def _made(self, job: Job, _answer: Plain) -> None:
        """A table that was built lies among those that can be sent."""
        if job.what == "build":
            self.shelf.made.mkdir(parents=True, exist_ok=True)
            for name in ("space.toml", "space.tbl"):
                shutil.copy(self.work.folder / "build" / name, self.shelf.made / name)

    def answer(self, what: str) -> Plain:
        """The newest answer of a task."""
        if what not in TASKS:
            raise BadInput(f"no such task: {what[:40]}")
        return self.work.answer(what)

    def file(self, name: str) -> Path:
        """A file to take away."""
        if name == "space.toml":
            return self.form().file
        if name == "space.tbl" and (path := self.shelf.place("SPACE", MADE)).is_file():
            return path
        raise BadInput("no such file")


def _require() -> None:
    installation.require("sim", "a search space")


def _kept(line: CheckLine) -> Cell:
    if not line.counts:
        return Cell("for information")
    return Cell("yes", "good") if line.ok else Cell("no", "bad")


def _places(table: SpaceTable, rows: list[int]) -> list[list[float]]:
    return [[round(float(x), 4) for x in table.p_m[i]] for i in rows]
