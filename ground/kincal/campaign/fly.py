"""A campaign from start to end, and one of its cases again."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from kincal.run import dispersed
from kincal_shared.errors import BadInput, CommandFailed

from . import cluster
from .function import TIMINGS
from .plan import Plan
from .pool import Answer, Pool
from .store import Row, Store, fitting, kinds_of, plan_of, read, row_of, software_differences

BATCH = 20  # cases a part, and a task of a cluster
KEEP_S = 30.0  # no finished case waits longer to be written


@dataclass(frozen=True)
class Progress:
    """How far a campaign is. flown: in this call; died: of these."""

    done: int
    of: int
    flown: int
    died: int
    took_s: float

    @property
    def rate(self) -> float:
        """Cases a second."""
        return self.flown / self.took_s if self.took_s > 0.0 else 0.0

    @property
    def left_s(self) -> float:
        """Time left at this rate [s]."""
        return (self.of - self.done) / self.rate if self.rate > 0.0 else float("inf")


def run(
    plan: Plan,
    folder: Path,
    *,
    processes: int = 2,
    scheduler: str = "",
    batch: int = BATCH,
    tick: Callable[[Progress], None] | None = None,
    indices: Collection[int] | None = None,
) -> Progress:
    """Fly the cases of a campaign that its folder does not hold yet. scheduler: address of a dask scheduler
    ("": processes of this computer); batch: cases a part and a task; indices: of the cases to fly (None:
    all). An interruption (KeyboardInterrupt) writes what is finished. BadInput if the folder belongs to
    something else, or the cluster cannot fly it; CommandFailed if the disk is full or the scheduler goes
    away. Whatever ends it, the same call goes on."""
    if scheduler and not cluster.LEAST <= batch <= cluster.MOST:
        todo = f"give {cluster.LEAST} to {cluster.MOST} cases a task"
        raise BadInput(f"{batch} cases a task", "--batch", todo)
    with Store(folder, plan) as store:
        asked = range(plan.spec.cases) if indices is None else indices
        cases = plan.cases([index for index in asked if index not in store.done])
        if scheduler:
            answers = cluster.fly(plan, cases, scheduler, batch)
        else:
            answers = Pool(processes, plan.for_worker(), plan.spec.time_limit_s).fly(cases)
        with closing(cast("Any", answers)):
            return _collect(store, asked, answers, batch, tick or _nobody)


def _nobody(_progress: Progress) -> None:
    """Progress that nobody sees."""


def _collect(
    store: Store,
    asked: Collection[int],
    answers: Iterator[Answer],
    batch: int,
    tick: Callable[[Progress], None],
) -> Progress:
    begun_s = kept_s = time.monotonic()
    held: list[Answer] = []
    flown = died = 0
    before = sum(index in store.done for index in asked)

    def keep() -> None:
        nonlocal held, kept_s, died
        rows, held, kept_s = held, [], time.monotonic()  # before it may fail: no second try at the end
        died += store.write(rows)

    def progress() -> Progress:
        return Progress(before + flown, len(asked), flown, died, time.monotonic() - begun_s)

    try:
        for answer in answers:
            held.append(answer)
            flown, died = flown + 1, died + ("error" in answer.answer)
            if len(held) >= batch or time.monotonic() - kept_s > KEEP_S:
                keep()
            tick(progress())
    finally:
        keep()
    return progress()


# ---- one case again


@dataclass(frozen=True)
class Replayed:
    """A case flown again. stored, flown: its columns; differing: those that differ, except timings; software:
    what differs between here and what flew the campaign."""

    stored: Row
    flown: Row
    differing: tuple[str, ...]
    software: tuple[str, ...]


def replay(folder: Path, index: int, log: Path | None = None) -> Replayed:
    """Fly one case of a campaign again and compare it with what is stored, bit for bit. log: file for an LCM
    log. BadInput if there is no such case, the tables have changed, or a function should write a log."""
    stored, plan = read(folder).row(index), plan_of(folder)
    _same_tables(plan)
    if log and plan.spec.function:
        raise BadInput("a function writes no log", str(folder), "leave --log out")
    pool = Pool(1, plan.for_worker(), plan.spec.time_limit_s, str(log.absolute()) if log else "")
    answers = list(pool.fly(plan.cases([index])))
    if not answers:
        raise CommandFailed("the case gave no answer", str(folder))
    answer = fitting(answers[0], kinds_of(folder)) if plan.spec.function else answers[0]
    flown = row_of(plan, answer)
    flown = dict.fromkeys(stored) | flown  # columns that other cases of a function have
    stored = dict.fromkeys(flown) | stored
    differing = [name for name in stored if name not in TIMINGS and not _same(stored[name], flown[name])]
    return Replayed(stored, flown, tuple(differing), tuple(software_differences(folder)))


def _same_tables(plan: Plan) -> None:
    for name, there in plan.crcs.items():
        here = dispersed.crcs(Path(name) if name else plan.tables)
        if changed := [
            f"{k}: {there[k]} then, {here.get(k, 'none')} now" for k in there if here.get(k) != there[k]
        ]:
            todo = "restore the tables that were flown"
            raise BadInput(f"the tables have changed ({'; '.join(changed)})", name or str(plan.tables), todo)


def _same(a: Any, b: Any) -> bool:
    """Equal to the bit; not-a-number is itself."""
    return bool(a == b or (a != a and b != b))
