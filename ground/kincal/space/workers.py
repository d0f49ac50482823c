"""Processes that share the work of a search. Results do not depend on how many there are."""

from __future__ import annotations

import os
import pickle
import queue
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, BinaryIO, Concatenate, ParamSpec, TypeVar

from kincal.flight import tables
from kincal_shared.errors import CommandFailed

from . import samples
from .checks import Checks

P = ParamSpec("P")
T = TypeVar("T")
Job = Callable[..., Any]


def serve(source: BinaryIO, sink: BinaryIO) -> None:
    """What a worker process does: reads description, ARM and CAMERA image, then jobs with their items, all
    pickled; answers each job with the list of its results."""
    desc, arm, camera = pickle.load(source)
    checks = Checks(desc, tables.decode_as("arm", arm)[1], tables.decode_as("camera", camera)[1])
    while True:
        try:
            name, items = pickle.load(source)
        except EOFError:
            return
        pickle.dump([getattr(samples, name)(checks, *item) for item in items], sink)
        sink.flush()


class WorkerPool:
    """Maps functions of samples.py over items; results come in the order of the items, whoever did them.

    Workers are processes, started as `python -m kincal.space` when first needed, so that this works from any
    program. Use as a context, which ends them."""

    def __init__(self, checks: Checks, processes: int = 2) -> None:
        self.checks, self.processes = checks, processes
        self._workers: list[subprocess.Popen[bytes]] = []
        self._idle: queue.SimpleQueue[subprocess.Popen[bytes]] = queue.SimpleQueue()

    def __enter__(self) -> WorkerPool:
        return self

    def __exit__(self, *_error: object) -> None:
        for worker in self._workers:
            worker.kill()
            worker.communicate()

    def map(
        self, job: Callable[Concatenate[Checks, P], T], items: Sequence[tuple[Any, ...]], chunk: int = 8
    ) -> Iterator[T]:
        """job(checks, *item) for every item; a worker takes `chunk` items at a time. CommandFailed if one
        ends early."""
        if self.processes < 2 or len(items) <= 2 * chunk:
            call: Job = job
            yield from (call(self.checks, *item) for item in items)
            return
        self._start()
        chunks = [items[i : i + chunk] for i in range(0, len(items), chunk)]
        with ThreadPoolExecutor(self.processes) as threads:
            for results in threads.map(lambda part: self._ask(job.__name__, part), chunks):
                yield from results

    def _start(self) -> None:
        if self._workers:
            return
        images = (tables.encode(kind, getattr(self.checks, kind)).data for kind in ("arm", "camera"))
        setup = pickle.dumps((self.checks.desc, *images))
        command, env = [sys.executable, "-m", "kincal.space"], dict(os.environ, OMP_NUM_THREADS="1")
        for _ in range(self.processes):
            worker = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=env)
            self._workers.append(worker)
            _pipe(worker.stdin).write(setup)
            self._idle.put(worker)

    def _ask(self, job: str, items: Sequence[tuple[Any, ...]]) -> list[Any]:
        worker = self._idle.get()
        try:
            pickle.dump((job, items), _pipe(worker.stdin))
            _pipe(worker.stdin).flush()
            results: list[Any] = pickle.load(_pipe(worker.stdout))
            return results
        except (OSError, EOFError):
            status = f"status {worker.poll()}"
            raise CommandFailed("a worker process of the search ended early", status) from None
        finally:
            self._idle.put(worker)


def _pipe(stream: Any) -> Any:
    """A stream of a process that was started with pipes."""
    assert stream is not None
    return stream
