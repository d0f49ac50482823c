"""The model workbench behind the console: files, the case in hand, and one piece of long work at a time.

All of it lies in a folder, so that it outlives the server: uploads, the case with its effects and what can be
undone, and the newest answer of each kind."""

from __future__ import annotations

import json
import os
import re
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from kincal.api.case import check_alternatives
from kincal.api.models import check_names
from kincal.workbench.model.effects import Library
from kincal_shared.errors import BadInput, CommandFailed
from kincal_shared.schema.arm import read_arm, shipped_arms

from . import own
from .work import Job, Work

ARMS, DATA = (".toml",), (".csv", ".lcmlog", ".npz", ".parquet", ".mat", ".json")
TASKS = ("compare", "diagnose", "fit", "next")
MOST_UPLOAD = 64 << 20
_MOST_FILES, _MOST_DEPTH, _MOST_UNDO = 400, 2, 100
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._-]{0,99}")
_MOST_EFFECTS = 100
_RENAME = "give the new one another name"
Plain = dict[str, Any]


@dataclass
class Case:
    """arm, data: as `Bench.files` names them, empty: not chosen; effects: of the model; past: models before,
    for undo; errors: held-out errors of the fits, by model."""

    arm: str = ""
    data: str = ""
    effects: list[str] = field(default_factory=list)
    past: list[list[str]] = field(default_factory=list)
    fits: list[Plain] = field(default_factory=list)

    @property
    def key(self) -> Plain:
        """What an answer belongs to."""
        return {"arm": self.arm, "data": self.data, "effects": list(self.effects)}


class Bench:
    """folder: where everything is kept; given: further folder with files to choose among. A context."""

    def __init__(self, folder: Path, given: Path | None = None) -> None:
        self.folder, self.given = folder.expanduser(), given
        self.uploads, self.own = self.folder / "uploads", self.folder / "own"
        self._lock = threading.RLock()
        self.case = self._read()
        self.work = Work(self.folder / "answers", "kincal.console.job", self._fitted)

    def __enter__(self) -> Bench:
        return self

    def __exit__(self, *_exc: object) -> None:
        self.close()

    # ---- files

    def files(self) -> dict[str, Path | str]:
        """Everything that can be chosen: name -> path, or name of an arm that ships."""
        out: dict[str, Path | str] = {f"shipped: {name}": name for name in sorted(shipped_arms())}
        for label, folder in (("uploaded", self.uploads), ("folder", self.given)):
            if folder is not None and folder.is_dir():
                out |= {f"{label}: {path.relative_to(folder)}": path for path in _files_in(folder)}
        return out

    def upload(self, name: str, data: bytes) -> Plain:
        """Keep a file. BadInput if its name is none or its kind is not read; an existing file stays."""
        if not _NAME.fullmatch(name) or Path(name).suffix.lower() not in ARMS + DATA:
            raise BadInput(
                f"{name[:100]!r} is not taken",
                todo=f"letters, digits, . _ - and one of {', '.join(ARMS + DATA)}",
            )
        path = self.uploads / name
        part = path.with_name(f".{name}.part")
        with self._lock:
            try:
                self.uploads.mkdir(parents=True, exist_ok=True)
                if os.path.lexists(path) and not (path.is_file() and path.read_bytes() == data):
                    raise BadInput(f"there is another file {name} already", todo=_RENAME)
                part.write_bytes(data)
                part.replace(path)
            except OSError as error:
                with suppress(OSError):
                    part.unlink(missing_ok=True)
                raise CommandFailed(f"{name} was not kept: {error.strerror}", str(self.uploads)) from None
        return {"ok": True, "text": f"{name} uploaded", "name": f"uploaded: {name}"}

    # ---- the case

    def state(self) -> Plain:
        """For the browser."""
        with self._lock:
            files = list(self.files())
            return {
                "arms": [f for f in files if f.startswith("shipped") or f.endswith(ARMS)],
                "data": [f for f in files if f.lower().endswith(DATA)],
                "case": asdict(self.case),
                "library": [
                    {
                        "name": e.name,
                        "title": e.title,
                        "per": e.per,
                        "own": bool(e.source) and e.source != "effects.toml",
                    }
                    for e in self.library().effects.values()
                ],
                "job": self.work.state(),
                "answers": {what: found for what in TASKS if (found := self.work.key_of(what))},
                "now_s": time.time(),
            }

    def choose(self, arm: str | None = None, data: str | None = None) -> Plain:
        """Arm and measurements (None: as it is, whatever another page has chosen); another choice begins with
        DH errors alone."""
        files = self.files()
        for name in (arm, data):
            if name and name not in files:
                raise BadInput(f"no such file: {name[:200]}", todo="choose one of the list")
        with self._change() as case:
            arm, data = case.arm if arm is None else arm, case.data if data is None else data
            if (arm, data) != (case.arm, case.data):
                case.arm, case.data, case.effects, case.past, case.fits = arm, data, [], [], []
        return {"ok": True, "text": "chosen"}

    def effects(self, names: list[str], without: Sequence[str] | None = None) -> Plain:
        """The model's effects from now on. without: those to remove; then `names` are added and others stay,
        also those that another page added meanwhile. BadInput for what is no name, no effect of the library,
        or at a joint that the arm does not have."""
        good = all(isinstance(name, str) and 0 < len(name) < 200 for name in names)
        if not good or len(names) > _MOST_EFFECTS:
            raise BadInput("these are no names of effects")
        self._known(names)
        with self._change() as case:
            if without is not None:
                names = [*(name for name in case.effects if name not in without), *names]
            names = list(dict.fromkeys(names))
            if len(names) > _MOST_EFFECTS:
                raise BadInput(f"a model has at most {_MOST_EFFECTS} effects", todo="remove some of them")
            if names != case.effects:
                case.past = [*case.past, list(case.effects)][-_MOST_UNDO:]
                case.effects = names
        return {"ok": True, "text": "effects: " + (", ".join(names) or "none")}

    def _known(self, names: list[str]) -> None:
        if not all(isinstance(name, str) and 0 < len(name) < 200 for name in names):
            raise BadInput("these are no names of effects")
        arm = self.files().get(self.case.arm)
        check_names(self.library(), names, read_arm(arm) if arm is not None else None)

    def library(self) -> Library:
        """The effects that ship, and those of one's own."""
        return Library.load(*own.libraries(self.own))

    def form(self, values: Plain) -> Plain:
        """Keep an effect of one's own; what is wrong with it stands at its fields."""
        doc, problems = own.checked(values)
        if not problems:
            name, problems = own.keep(self.own, doc)
        if problems:
            return {"ok": False, "text": "the effect was not kept", "problems": problems}
        return {
            "ok": True,
            "text": f"{name} is in the library of this workbench",
            "name": name,
            "problems": [],
        }

    def undo(self) -> Plain:
        """The effects before the last change."""
        with self._change() as case:
            if not case.past:
                raise BadInput("there is nothing to undo")
            case.effects = case.past.pop()
        return {"ok": True, "text": "effects: " + (", ".join(self.case.effects) or "none")}

    # ---- long work

    def run(self, what: str, alternatives: Sequence[str] = ()) -> Plain:
        """Begin a task; alternatives: effects that the next poses are to separate. CommandFailed if another
        runs."""
        if what not in TASKS:
            raise BadInput(f"no such task: {what[:40]}")
        with self._lock:
            files, case = self.files(), self.case
            self.work.refuse_two()
            if case.arm not in files or case.data not in files:
                raise BadInput("choose an arm and measurements first")
            spec: Plain = {
                "arm": str(files[case.arm]), "data": [str(files[case.data])],
                "effects": case.effects, "date": datetime.now(UTC).date().isoformat(),
                "libraries": [str(path) for path in own.libraries(self.own)],
                "alternatives": list(alternatives),
            }  # fmt: skip
            if what == "next":
                self._known(list(alternatives))
                check_alternatives(alternatives)
            return self.work.begin(what, case.key, spec)

    def cancel(self) -> Plain:
        """End the running task; the answers that there are stay."""
        return self.work.cancel()

    def close(self) -> None:
        """End what runs."""
        self.work.close()

    def _fitted(self, job: Job, answer: Plain) -> None:
        """Held-out errors of a fit go beside those of the other models of the case."""
        same = {name: job.key[name] for name in ("arm", "data")}
        if job.what == "fit" and same == {name: self.case.key[name] for name in same}:
            with self._change() as case:
                line = {"effects": job.key["effects"], "errors": answer["errors"]}
                others = [f for f in case.fits if f["effects"] != line["effects"]]
                case.fits = [*others, line]

    # ---- answers

    def answer(self, what: str) -> Plain:
        """The newest answer of a task, and whether it is about the case in hand."""
        if what not in TASKS:
            raise BadInput(f"no answer of {what[:40]} yet")
        found = self.work.answer(what)
        return {**found, "current": found["key"] == self.case.key}

    def file(self, what: str, name: str) -> Path:
        """A file that a task left. BadInput if it left none of that name."""
        if what in TASKS and name in self.answer(what).get("files", ()):
            return self.folder / "answers" / what / name
        raise BadInput("no such file")

    # ---- the folder

    def _read(self) -> Case:
        try:
            return Case(**json.loads((self.folder / "case.json").read_text("utf-8")))
        except (OSError, ValueError, TypeError):
            return Case()

    def _change(self) -> _Change:
        return _Change(self)

    def write(self) -> None:
        """Keep the case; whole or not at all."""
        self.folder.mkdir(parents=True, exist_ok=True)
        part = self.folder / "case.part"
        part.write_text(json.dumps(asdict(self.case)), "utf-8")
        part.replace(self.folder / "case.json")


class _Change:
    """The case, locked, and written when it was changed without an error."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    def __enter__(self) -> Case:
        self._bench._lock.acquire()  # noqa: SLF001 one class in two
        return self._bench.case

    def __exit__(self, kind: object, *_exc: object) -> None:
        try:
            if kind is None:
                self._bench.write()
        finally:
            self._bench._lock.release()  # noqa: SLF001


def _files_in(folder: Path) -> Iterator[Path]:
    """Files that can be chosen, at most so many and so deep; no links out of the folder."""
    found, root = 0, folder.resolve()
    for path in sorted(folder.rglob("*")):
        deep = len(path.relative_to(folder).parts) > _MOST_DEPTH + 1
        if deep or path.name.startswith(".") or path.suffix.lower() not in ARMS + DATA:
            continue
        if path.is_file() and path.resolve().is_relative_to(root):
            found += 1
            yield path
        if found >= _MOST_FILES:
            return
