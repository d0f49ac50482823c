"""Work in a second process, begun when a function asks for it."""

from __future__ import annotations

import os
import pickle
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Generic, NoReturn, Protocol, TypeVar

T = TypeVar("T")


class Begin(Protocol):
    """Takes work and returns what gives its result."""

    def __call__(self, work: Callable[[], T], /) -> Callable[[], T]:
        """Begin, or remember the work for later."""


def when_asked(work: Callable[[], T]) -> Callable[[], T]:
    """Work is done in this process when its result is asked for."""
    return work


@contextmanager
def second_process() -> Iterator[Begin]:
    """Work begins at once, in a process of its own (a fork of this one), which ends with this context.

    Results have to be picklable. Where that process fails, or somebody ends it, the work is done here when it
    is asked for: it gives the same result, or raises the same error.
    """
    begun: list[_Process[Any]] = []

    def begin(work: Callable[[], T]) -> Callable[[], T]:
        process = _Process(work)
        begun.append(process)
        return process.result

    try:
        yield begin
    finally:
        for process in begun:
            process.end()


class _Process(Generic[T]):
    """A fork of this process that does one piece of work and sends the result through a pipe."""

    def __init__(self, work: Callable[[], T]) -> None:
        self._work = work
        self._source, sink = os.pipe()
        self._pid = os.fork()
        if self._pid == 0:
            _send(work, sink)
        os.close(sink)

    def result(self) -> T:
        """The result, as soon as it is there. To be asked for once."""
        with os.fdopen(self._source, "rb", closefd=False) as stream:
            answer = stream.read()
        try:
            result: T = pickle.loads(answer)
        except (EOFError, pickle.UnpicklingError):  # nothing came, or not all of it
            return self._work()
        return result

    def end(self) -> None:
        """End the process, done or not."""
        os.kill(self._pid, signal.SIGKILL)  # nobody else waits for it: the number is still its own
        os.waitpid(self._pid, 0)
        os.close(self._source)


def _send(work: Callable[[], object], sink: int) -> NoReturn:
    """What the second process does. It ends without a word, whatever happens: the first one speaks."""
    try:
        answer = pickle.dumps(work())
        with os.fdopen(sink, "wb") as stream:
            stream.write(answer)
    finally:
        os._exit(0)
