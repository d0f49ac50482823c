"""Worker processes on this computer, one case at a time each.

A case whose worker dies is flown once more by a new one, because what killed it may have come from
outside; if it kills that too, this is its outcome. So is a case that takes longer than the time limit."""

from __future__ import annotations

import json
import os
import selectors
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from kincal_shared.errors import CommandFailed

from .plan import Case

CASES_OF_PROCESS = 400  # then a fresh one: every run leaves a third of a MB, which would come to gigabytes
TRIES = 2
# -P: no modules of the folder in which the command is called
COMMAND = (sys.executable, "-P", "-m", "kincal.campaign.worker")
_WAIT_S = 0.5


@dataclass(frozen=True)
class Answer:
    """What came of a case. answer: as the worker gave it, or with "error"; wall_s: how long it took [s]."""

    case: Case
    answer: dict[str, Any]
    wall_s: float


@dataclass
class _Worker:
    process: subprocess.Popen[bytes]
    served: int = 0
    case: Case | None = None
    begun_s: float = 0.0
    received: bytes = b""

    def give(self, case: Case, log: str) -> None:
        self.case, self.begun_s, self.served, self.received = case, time.monotonic(), self.served + 1, b""
        self.write({"index": case.index, "seed": case.seed, "changes": case.changes, "log": log})

    def write(self, line: dict[str, Any]) -> None:
        assert self.process.stdin is not None
        with suppress(BrokenPipeError):  # it has died; reading says so
            self.process.stdin.write(json.dumps(line).encode() + b"\n")
            self.process.stdin.flush()

    def end(self) -> str:
        """End it with all that cases have started in its group; how it ended, in words."""
        with suppress(ProcessLookupError):  # not yet waited for: the number is still its own
            os.killpg(self.process.pid, signal.SIGKILL)
        code = self.process.wait()
        for stream in (self.process.stdin, self.process.stdout):
            assert stream is not None
            with suppress(BrokenPipeError):
                stream.close()
        return f"signal {-code}" if code < 0 else f"exit status {code}"


@dataclass
class Pool:
    """processes: how many; shared: what all cases share; limit_s: longest time of a case [s]."""

    processes: int
    shared: dict[str, Any]
    limit_s: float
    log: str = ""
    _workers: list[_Worker] = field(default_factory=list)
    _tries: dict[int, int] = field(default_factory=dict)

    def fly(self, cases: Iterable[Case]) -> Iterator[Answer]:
        """Answers as they come. Closing the iterator ends all processes."""
        waiting, again = iter(cases), list[Case]()
        try:
            with selectors.DefaultSelector() as selector:
                while True:
                    self._hand_out(waiting, again, selector)
                    if not any(w.case for w in self._workers):
                        return
                    yield from self._collect(selector, again)
        finally:
            for worker in self._workers:
                worker.end()
            self._workers.clear()

    def _hand_out(self, waiting: Iterator[Case], again: list[Case], selector: selectors.BaseSelector) -> None:
        """A case for every worker that has none."""
        for worker in [w for w in self._workers if w.case is None and w.served >= CASES_OF_PROCESS]:
            self._remove(worker, selector)
        while sum(w.case is not None for w in self._workers) < self.processes:
            case = again.pop() if again else next(waiting, None)
            if case is None:
                return
            idle = next((w for w in self._workers if w.case is None), None) or self._start(selector)
            self._tries[case.index] = self._tries.get(case.index, 0) + 1
            idle.give(case, self.log)

    def _start(self, selector: selectors.BaseSelector) -> _Worker:
        process = subprocess.Popen(
            COMMAND,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # a terminal's Ctrl-C is for the command
        )
        worker = _Worker(process)
        worker.write(self.shared)
        self._workers.append(worker)
        selector.register(process.stdout or 0, selectors.EVENT_READ, worker)
        return worker

    def _remove(self, worker: _Worker, selector: selectors.BaseSelector) -> str:
        selector.unregister(worker.process.stdout or 0)
        self._workers.remove(worker)
        return worker.end()

    def _collect(self, selector: selectors.BaseSelector, again: list[Case]) -> Iterator[Answer]:
        """What has been answered; workers that died or are late."""
        for key, _ in selector.select(_WAIT_S):
            worker: _Worker = key.data
            data = os.read(key.fd, 1 << 16)
            worker.received += data
            case = worker.case
            if not data:
                how = self._remove(worker, selector)
                if case is not None and self._tries[case.index] < TRIES:
                    again.append(case)
                elif case is not None:
                    yield self._dead(worker, case, f"the process that flew it died {TRIES} times, {how}")
            elif case is not None and worker.received.endswith(b"\n"):
                worker.case = None
                self._tries.pop(case.index)
                answer = json.loads(worker.received)
                if "other" in answer:
                    todo = "fly the rest with the software of before, or all of it into another folder"
                    raise CommandFailed("the software has changed while cases were flown", todo=todo)
                yield Answer(case, answer, time.monotonic() - worker.begun_s)
        for worker in list(self._workers):
            case = worker.case
            if case is not None and time.monotonic() - worker.begun_s > self.limit_s:
                self._remove(worker, selector)
                yield self._dead(worker, case, f"not finished within the time limit of {self.limit_s:g} s")

    def _dead(self, worker: _Worker, case: Case, why: str) -> Answer:
        self._tries.pop(case.index, None)
        return Answer(case, {"index": case.index, "error": why}, time.monotonic() - worker.begun_s)
