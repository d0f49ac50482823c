"""Long work behind the console: one process at a time, with progress, cancel and an answer on disk.

An answer that is there stays until a later one is complete. The first line of the process's standard input
says what to do (JSON). Progress comes as a line of JSON each on standard output, the answer goes to a file.
When standard input ends, the console is gone, and so is the process."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from kincal_shared.errors import BadInput, CommandFailed, KincalError

_STOP_S = 3.0
Plain = dict[str, Any]


@dataclass
class Job:
    """status: running, done, failed, cancelled; key: what the answer will belong to."""

    what: str
    key: Plain
    began_s: float
    status: str = "running"
    progress: Plain = field(default_factory=dict)
    text: str = ""
    ended_s: float | None = None


class Work:
    """folder: of the answers; module: that does it, started with `python -m`; kept: called with
    every answer that was kept, in the thread that follows."""

    def __init__(self, folder: Path, module: str, kept: Callable[[Job, Plain], None]) -> None:
        self.folder, self.module, self._kept = folder, module, kept
        self.job: Job | None = None
        self._lock = threading.RLock()
        self._process: subprocess.Popen[str] | None = None

    def begin(self, what: str, key: Plain, spec: Plain) -> Plain:
        """Start a task. CommandFailed if another runs. spec: for the process, which also gets `out`, the
        folder of its answer."""
        with self._lock:
            self.refuse_two()
            out = self.folder / f"{what}.new"
            shutil.rmtree(out, ignore_errors=True)
            self.job = Job(what, key, time.time())
            self._process = _start(self.module, {"what": what, **spec, "out": str(out)})
            threading.Thread(target=self._follow, args=(self.job, self._process, out), daemon=True).start()
        return {"ok": True, "text": f"{what} began"}

    def refuse_two(self) -> None:
        """CommandFailed while a task runs."""
        if self.job is not None and self.job.status == "running":
            raise CommandFailed(f"{self.job.what} runs already", todo="wait for it, or cancel it")

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

    def state(self) -> Plain | None:
        """The newest task, for the browser."""
        with self._lock:
            return asdict(self.job) if self.job else None

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
            self._keep(job, out)
        self._kept(job, answer)  # without the lock: it may wait for who asks for the state
        with self._lock:
            job.status, job.text = "done", f"done in {job.ended_s - job.began_s:.0f} s"

    def _keep(self, job: Job, out: Path) -> None:
        (out / "key.json").write_text(json.dumps(job.key), "utf-8")
        kept = self.folder / job.what
        shutil.rmtree(kept, ignore_errors=True)
        out.rename(kept)

    def answer(self, what: str) -> Plain:
        """The newest answer of a task, with the key that it belongs to. BadInput if there is none."""
        found, key = _answer_in(self.folder / what), self.key_of(what)
        if not found or key is None:
            raise BadInput(f"no answer of {what[:40]} yet")
        return {**found, "key": key}

    def key_of(self, what: str) -> Plain | None:
        """What the newest answer of a task belongs to, None if there is none."""
        try:
            key: Plain = json.loads((self.folder / what / "key.json").read_text("utf-8"))
        except (OSError, ValueError):
            return None
        return key


def perform(what: Callable[[Plain], Plain]) -> int:
    """The process: does what standard input says, and leaves the answer in its folder."""
    spec = json.loads(sys.stdin.readline())
    threading.Thread(target=_end_with_the_console, daemon=True).start()
    out = Path(spec["out"])
    out.mkdir(parents=True, exist_ok=True)
    try:
        answer = {"ok": True, **what(spec)}
    except KincalError as error:
        answer = {"ok": False, "text": str(error)}
    part = out / "answer.part"
    part.write_text(json.dumps(answer), "utf-8")
    part.replace(out / "answer.json")
    return 0


def progress(what: str, done: int, of: int) -> None:
    """Say how far the process has come."""
    print(json.dumps({"what": what, "done": done, "of": of}), flush=True)


def _end_with_the_console() -> None:
    """Once standard input ends, so does this process, and what it started."""
    while sys.stdin.readline():
        pass
    os.killpg(0, signal.SIGKILL)


def _start(module: str, spec: Plain) -> subprocess.Popen[str]:
    one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    process = subprocess.Popen(
        [sys.executable, "-m", module], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
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
