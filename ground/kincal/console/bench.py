"""The model workbench behind the console: files, the case in hand, and one piece of long work at a time.

All of it lies in a folder, so that it outlives the server: uploads, the case with its effects and what can be
undone, and the newest answer of each kind."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from kincal_shared.errors import BadInput, CommandFailed
from kincal_shared.schema.arm import shipped_arms

ARMS, DATA = (".toml",), (".csv", ".lcmlog", ".npz", ".parquet", ".mat", ".json")
TASKS = ("compare", "diagnose", "fit")
MOST_UPLOAD = 64 << 20
_MOST_FILES, _MOST_DEPTH, _MOST_UNDO = 400, 2, 100
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._-]{0,99}")
_STOP_S = 3.0
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


@dataclass
class Job:
    """status: running, done, failed, cancelled."""

    what: str
    key: Plain
    began_s: float
    status: str = "running"
    progress: Plain = field(default_factory=dict)
    text: str = ""
    ended_s: float | None = None


class Bench:
    """folder: where everything is kept; given: further folder with files to choose among. A context."""

    def __init__(self, folder: Path, given: Path | None = None) -> None:
        self.folder, self.given = folder.expanduser(), given
        self.uploads = self.folder / "uploads"
        self._lock = threading.RLock()
        self.case = self._read()
        self.job: Job | None = None
        self._process: subprocess.Popen[str] | None = None

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
                "job": asdict(self.job) if self.job else None,
                "answers": {what: found for what in TASKS if (found := self._kept_key(what))},
                "now_s": time.time(),
            }

    def choose(self, arm: str, data: str) -> Plain:
        """Arm and measurements; another choice begins with DH errors alone."""
        files = self.files()
        for name in (arm, data):
            if name and name not in files:
                raise BadInput(f"no such file: {name[:200]}", todo="choose one of the list")
        with self._change() as case:
            if (arm, data) != (case.arm, case.data):
                case.arm, case.data, case.effects, case.past, case.fits = arm, data, [], [], []
        return {"ok": True, "text": "chosen"}

    def effects(self, names: list[str]) -> Plain:
        """The model's effects from now on. BadInput for what is no name."""
        good = all(isinstance(name, str) and 0 < len(name) < 200 for name in names)
        if not good or len(names) > _MOST_EFFECTS:
            raise BadInput("these are no names of effects")
        with self._change() as case:
            if names != case.effects:
                case.past = [*case.past, list(case.effects)][-_MOST_UNDO:]
                case.effects = list(dict.fromkeys(names))
        return {"ok": True, "text": "effects: " + (", ".join(names) or "none")}

    def undo(self) -> Plain:
        """The effects before the last change."""
        with self._change() as case:
            if not case.past:
                raise BadInput("there is nothing to undo")
            case.effects = case.past.pop()
        return {"ok": True, "text": "effects: " + (", ".join(self.case.effects) or "none")}

    # ---- long work

    def run(self, what: str) -> Plain:
        """Begin a task. CommandFailed if another runs."""
        if what not in TASKS:
            raise BadInput(f"no such task: {what[:40]}")
        with self._lock:
            if self.job is not None and self.job.status == "running":
                raise CommandFailed(f"{self.job.what} runs already", todo="wait for it, or cancel it")
            files, case = self.files(), self.case
            if case.arm not in files or case.data not in files:
                raise BadInput("choose an arm and measurements first")
            out = self.folder / "answers" / f"{what}.new"
            shutil.rmtree(out, ignore_errors=True)
            spec = {
                "what": what, "arm": str(files[case.arm]), "data": [str(files[case.data])],
                "effects": case.effects, "out": str(out), "date": datetime.now(UTC).date().isoformat(),
            }  # fmt: skip
            self.job = Job(what, case.key, time.time())
            self._process = _start(spec)
            threading.Thread(target=self._follow, args=(self.job, self._process, out), daemon=True).start()
        return {"ok": True, "text": f"{what} began"}

    def cancel(self) -> Plain:
        """End the running task; the answers that there are stay."""
        with self._lock:
            if self.job is None or self.job.status != "running" or self._process is None:
                raise BadInput("nothing runs")
            self.job.status = "cancelled"
            job, process = self.job, self._process
        _end(process)
        return {"ok": True, "text": f"{job.what} cancelled"}

    def close(self) -> None:
        """End what runs."""
        if self._process is not None:
            _end(self._process)

    def _follow(self, job: Job, process: subprocess.Popen[str], out: Path) -> None:
        for line in process.stdout or ():
            try:
                job.progress = json.loads(line)
            except ValueError:
                continue  # what a library prints
        errors = (process.stderr.read() if process.stderr else "").strip()
        process.wait()
        with self._lock:
            job.ended_s = time.time()
            if job.status == "cancelled":
                shutil.rmtree(out, ignore_errors=True)
                return
            answer = _answer_in(out)
            if not answer.get("ok"):
                job.status = "failed"
                job.text = str(answer.get("text") or (errors or "the process ended").splitlines()[-1])
                return
            self._keep(job, out, answer)
            job.status, job.text = "done", f"done in {job.ended_s - job.began_s:.0f} s"

    def _keep(self, job: Job, out: Path, answer: Plain) -> None:
        (out / "key.json").write_text(json.dumps(job.key), "utf-8")
        kept = self.folder / "answers" / job.what
        shutil.rmtree(kept, ignore_errors=True)
        out.rename(kept)
        if job.what == "fit":
            same = {name: job.key[name] for name in ("arm", "data")}
            if same == {name: self.case.key[name] for name in same}:
                with self._change() as case:
                    line = {"effects": job.key["effects"], "errors": answer["errors"]}
                    others = [f for f in case.fits if f["effects"] != line["effects"]]
                    case.fits = [*others, line]

    # ---- answers

    def answer(self, what: str) -> Plain:
        """The newest answer of a task, and whether it is about the case in hand."""
        found, key = _answer_in(self.folder / "answers" / what) if what in TASKS else {}, self._kept_key(what)
        if not found or key is None:
            raise BadInput(f"no answer of {what[:40]} yet")
        return {**found, "key": key, "current": key == self.case.key}

    def file(self, what: str, name: str) -> Path:
        """A file that a task left. BadInput if it left none of that name."""
        if what in TASKS and name in self.answer(what).get("files", ()):
            return self.folder / "answers" / what / name
        raise BadInput("no such file")

    def _kept_key(self, what: str) -> Plain | None:
        try:
            key: Plain = json.loads((self.folder / "answers" / what / "key.json").read_text("utf-8"))
        except (OSError, ValueError):
            return None
        return key

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


def _start(spec: Plain) -> subprocess.Popen[str]:
    one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    process = subprocess.Popen(
        [sys.executable, "-m", "kincal.console.job"], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True, start_new_session=True, env={**one, **os.environ},
    )  # fmt: skip
    if process.stdin:
        process.stdin.write(json.dumps(spec) + "\n")
        process.stdin.flush()  # stays open: its end tells the process that the console is gone
    return process


def _end(process: subprocess.Popen[str]) -> None:
    """The process and what it started."""
    send: Callable[[int], None] = lambda number: os.killpg(process.pid, number)  # noqa: E731
    try:
        send(signal.SIGTERM)
        process.wait(_STOP_S)
    except subprocess.TimeoutExpired:
        send(signal.SIGKILL)
    except ProcessLookupError:
        return


def _answer_in(folder: Path) -> Plain:
    try:
        answer: Plain = json.loads((folder / "answer.json").read_text("utf-8"))
    except (OSError, ValueError):
        return {}
    return answer
