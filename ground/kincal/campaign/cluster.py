"""Cases on the workers of a dask.distributed scheduler, a batch a task.

Every worker is asked for its software and tables before anything is flown, and a task asks again, because
workers come and go. A worker flies its cases in a process of its own, as this computer does."""

from __future__ import annotations

import asyncio
import concurrent.futures
import logging
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

from kincal.run import dispersed
from kincal_shared import installation
from kincal_shared.errors import BadInput, CommandFailed

from . import function
from .plan import Case, Plan
from .pool import Answer, Pool

LEAST, MOST = 10, 50  # cases a task: below, starting the process costs; above, a lost task does
QUEUED = 2  # tasks a thread of a worker
CONNECT_S = 10.0
GONE_S = 20.0  # without the scheduler
_WAIT_S = 1.0


def belongings(shared: dict[str, Any], folders: list[str]) -> dict[str, Any]:
    """What a worker would fly with: its software and tables."""
    software = function.software(shared["function"], Path(shared["beside"]))
    return {"software": software, "tables": [dispersed.crcs(Path(folder)) for folder in folders]}


def fly_task(
    shared: dict[str, Any], cases: list[Case], limit_s: float, folders: list[str], expected: dict[str, Any]
) -> dict[str, Any] | list[Answer]:
    """What a task does: answers, or the belongings of a worker that has others than expected."""
    found = belongings(shared, folders)
    if found != expected:
        return found
    return list(Pool(1, shared, limit_s).fly(cases))


def fly(plan: Plan, cases: Iterable[Case], address: str, batch: int) -> Iterator[Answer]:
    """Answers as tasks end. BadInput if there is no scheduler, or a worker would fly with something else;
    CommandFailed if the scheduler goes away. Closing the iterator cancels what is left."""
    installation.require("campaign", "a campaign on a cluster")
    from distributed import Client

    begun = False
    try:
        connect: Any = Client  # distributed publishes types for a part only
        with (
            _quiet(),
            connect(address, timeout=CONNECT_S, name="kincal-campaign", set_as_default=False) as client,
        ):
            begun = True
            yield from _on(client, plan, cases, address, batch)
    except (OSError, ValueError) as error:
        if begun:
            raise _gone(address) from error
        todo = "start one (`dask scheduler`, and `dask worker ADDRESS` for each computer), or fly without"
        raise BadInput("no scheduler answers", address, todo) from None


@contextmanager
def _quiet() -> Iterator[None]:
    """No tracebacks of the client when the scheduler goes away: the command says it."""
    logger = logging.getLogger("distributed.client")
    before = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(before)


def _gone(address: str) -> CommandFailed:
    todo = "start it and its workers again, then give the same command: it goes on with what is missing"
    return CommandFailed("the scheduler has gone away", address, todo)


def _on(client: Any, plan: Plan, cases: Iterable[Case], address: str, batch: int) -> Iterator[Answer]:
    folders = sorted({str(plan.tables), *(name for name in plan.crcs if name)})
    shared = plan.for_worker()
    expected = belongings(shared, folders)
    threads = _checked_workers(client, (shared, folders), expected, address)
    waiting, pending = iter(cases), set[Any]()
    watch = _Watch(client, address)
    try:
        while True:
            while len(pending) < QUEUED * threads and (some := list(islice(waiting, batch))):
                given = (shared, some, plan.spec.time_limit_s, folders, expected)
                pending.add(client.submit(fly_task, *given, pure=False))
            if not pending:
                return
            for future in watch.ended(pending):
                pending.discard(future)
                yield from _answers(future, expected, address)
    finally:
        if client.status == "running":
            client.cancel(list(pending))


def _checked_workers(client: Any, given: tuple[Any, ...], expected: dict[str, Any], address: str) -> int:
    """How many threads the workers have. given: to belongings there. BadInput if there is none, or one would
    fly with something else."""
    threads = client.nthreads()
    if not threads:
        raise BadInput("the scheduler has no workers", address, f"`dask worker {address}` starts one")
    for worker, found in client.run(belongings, *given, on_error="return").items():
        if isinstance(found, BaseException):
            todo = "install the same kincal[campaign,sim] there, with the tables under the same path"
            raise BadInput(f"a worker cannot fly cases: {type(found).__name__}: {found}", worker, todo)
        _same(found, expected, worker)
    return sum(threads.values())


def _same(found: dict[str, Any], expected: dict[str, Any], worker: str) -> None:
    if found == expected:
        return
    there, here = found["software"], expected["software"]
    what = [f"{k}: {there.get(k)} there, {here[k]} here" for k in here if there.get(k) != here[k]]
    text = "; ".join(what) or "other tables"
    raise BadInput(
        f"a worker would fly with something else ({text})",
        worker,
        "install the same there, or stop that worker",
    )


class _Watch:
    """Waits for futures, and notices that the scheduler is gone."""

    def __init__(self, client: Any, address: str) -> None:
        self._client, self._address, self._seen_s = client, address, time.monotonic()

    def ended(self, pending: set[Any]) -> list[Any]:
        """Those that have ended, after at most _WAIT_S. CommandFailed if the scheduler is gone for long."""
        now = time.monotonic()
        if self._client.status == "running":
            self._seen_s = now
        elif self._client.status == "closed" or now - self._seen_s > GONE_S:
            raise _gone(self._address)
        found = [future for future in pending if future.done()]
        if not found:
            time.sleep(_WAIT_S / 10)
        return found


def _answers(future: Any, expected: dict[str, Any], address: str) -> list[Answer]:
    from distributed import KilledWorker

    try:
        found = future.result()
    except KilledWorker as error:
        todo = "see the log of the workers, then give the same command: it goes on with what is missing"
        raise CommandFailed(f"workers died, again and again: {error}", address, todo) from None
    except (OSError, TimeoutError, asyncio.CancelledError, concurrent.futures.CancelledError):
        raise _gone(address) from None
    if isinstance(found, dict):
        _same(found, expected, address)
    return list(found)
