"""What a campaign of a million cases takes on a cluster, from what tasks and cases take here.

    python tests/bench/scaling.py [--sizes 1 10 50] [--poses N] [--write]

A dask scheduler with two workers on this computer flies tasks of the example campaign
(sim/campaigns/errors.toml) of each size, twice as many as workers (of the largest size one each). Measured,
all in processor time, which other work on the machine changes little:

- a case and the start of a task: the line through what tasks of all sizes take
- the scheduler: of scheduler and client for a task that does nothing but carry what a task carries
- the command: to write a case, and to read it again; bytes of a part of Parquet

--poses N: calibrations of at most N poses, for a short run. --write: the tables of docs/SCALING.md."""

from __future__ import annotations

import argparse
import os
import resource
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402
from versus.report import put, seconds_text, significant  # noqa: E402

from kincal import campaign  # noqa: E402
from kincal.campaign import cluster, store  # noqa: E402
from kincal.campaign.plan import Plan  # noqa: E402
from kincal.campaign.pool import Answer  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "SCALING.md"
SPEC = ROOT / "sim" / "campaigns" / "errors.toml"
WORKERS = 2
CASES = 256  # more than are flown
IDLE_TASKS = 300
MILLION = 1_000_000
CLUSTERS = (64, 512, 4096)  # processors


@dataclass(frozen=True)
class Task:
    """One task on a worker. took_s: processor time of it and of the process that it starts; answers: of its
    cases."""

    took_s: float
    answers: list[Answer]


@dataclass(frozen=True)
class Costs:
    """What was measured [processor s]. poses: of a calibration, 0: as CONFIG has it; case_s: of a case;
    start_s: of a task besides; schedule_s: of scheduler and client for a task by its size; write_s, read_s:
    of the command for a case; part_bytes: of a part by its cases."""

    poses: int
    case_s: float
    start_s: float
    schedule_s: dict[int, float]
    write_s: float
    read_s: float
    part_bytes: dict[int, int]

    def cpu_s(self, size: int) -> float:
        """Of a case in tasks of a size, with its share of the task."""
        return self.case_s + self.start_s / size

    def serial_s(self, size: int) -> float:
        """Of scheduler and command for a case: they take one after the other."""
        return self.schedule_s[size] / size + self.write_s

    def hours(self, size: int, processors: int) -> float:
        """For a million cases."""
        return MILLION * max(self.cpu_s(size) / processors, self.serial_s(size)) / 3600.0

    def most_processors(self, size: int) -> float:
        """That the scheduler and the command keep busy."""
        return self.cpu_s(size) / self.serial_s(size)


# ---- on a worker


def fly_timed(*given: Any) -> Task:
    """A task of the engine, with what it took."""
    begun_s = spent_s()
    answers = cluster.fly_task(*given)
    if isinstance(answers, dict):
        raise RuntimeError(f"the worker has other software: {answers}")
    return Task(spent_s() - begun_s, answers)


def spent_s() -> float:
    """Processor time of this process and of those that it started and that have ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


def carry(*given: Any) -> int:
    """What a task is sent, and as good as nothing back."""
    return len(given)


# ---- measure


def measured(plan: Plan, sizes: Sequence[int]) -> Costs:
    """All costs; some minutes."""
    from distributed import Client, LocalCluster

    folders = [str(plan.tables)]
    expected = cluster.belongings(folders)

    def given(cases: list[Any]) -> tuple[Any, ...]:
        return (plan.for_worker(), cases, plan.spec.time_limit_s, folders, expected)

    tasks: dict[int, list[Task]] = {}
    schedule_s: dict[int, float] = {}
    with (
        LocalCluster(n_workers=WORKERS, threads_per_worker=1, dashboard_address=":0") as made,
        Client(made) as client,
    ):
        at = 0
        for size in sizes:
            number = WORKERS * (1 if size >= max(sizes) else 2)
            blocks = [list(plan.cases(range(at + k * size, at + (k + 1) * size))) for k in range(number)]
            at += number * size
            tasks[size] = client.gather([client.submit(fly_timed, *given(b), pure=False) for b in blocks])
            begun_s, one = time.process_time(), given(blocks[0])  # the scheduler runs in this process
            client.gather([client.submit(carry, *one, pure=False) for _ in range(IDLE_TASKS)])
            schedule_s[size] = (time.process_time() - begun_s) / IDLE_TASKS
    poses = int(plan.spec.set.get("calibration.poses", plan.scenario["calibration"]["poses"]))
    every = [task for found in tasks.values() for task in found]
    case_s, start_s = np.polyfit([len(t.answers) for t in every], [t.took_s for t in every], 1)
    answers = [answer for task in every for answer in task.answers]
    write_s, read_s, part_bytes = filed(plan, answers, sizes)
    return Costs(poses, float(case_s), float(start_s), schedule_s, write_s, read_s, part_bytes)


def filed(plan: Plan, answers: list[Answer], sizes: Sequence[int]) -> tuple[float, float, dict[int, int]]:
    """Seconds a case to write parts of the largest size and to read them; bytes of a part by its cases."""
    most, part_bytes = min(max(sizes), len(answers)), {}
    with tempfile.TemporaryDirectory() as folder:
        for size in (size for size in sizes if size <= most):
            place = Path(folder) / str(size)
            with store.Store(place, plan) as files:
                begun_s = spent_s()
                files.write(answers[:size])
                write_s = (spent_s() - begun_s) / size
            part_bytes[size] = store.parts(place)[0].stat().st_size
            begun_s = spent_s()
            campaign.read(place)
            read_s = (spent_s() - begun_s) / size
    return write_s, read_s, part_bytes


# ---- tables


def measured_table(c: Costs) -> list[str]:
    """By size of a task, and what does not depend on it."""
    of = f"of at most {c.poses} poses" if c.poses else "of as many poses as it takes"
    head = ("cases a task", "scheduler, a task", "share of cases", "Parquet, a case")
    lines = [
        f"A case {of} takes {seconds_text(c.case_s)}, a task {seconds_text(c.start_s)} to start; the command",
        f"takes {seconds_text(c.write_s)} a case to write, {seconds_text(c.read_s)} to read.",
        "",
        f"| {' | '.join(head)} |",
        "|" + "---:|" * len(head),
    ]
    for size, schedule_s in c.schedule_s.items():
        share = f"{100.0 * c.case_s / c.cpu_s(size):.1f} %"
        cells = (str(size), seconds_text(schedule_s), share, f"{c.part_bytes[size] / size / 1e3:.2f} kB")
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def million_table(c: Costs) -> list[str]:
    """A million cases by size of a task and processors."""
    names = [f"{n} processors" for n in CLUSTERS]
    head = ("cases a task", "tasks", *names, "processors kept busy", "lost with a worker", "Parquet")
    lines = [f"| {' | '.join(head)} |", "|" + "---:|" * len(head)]
    for size in c.schedule_s:
        hours = [f"{significant(c.hours(size, n))} h" for n in CLUSTERS]
        bytes_ = MILLION / size * c.part_bytes[size] / 1e9
        cells = (
            str(size),
            f"{MILLION // size:,}".replace(",", " "),
            *hours,
            significant(c.most_processors(size)),
            seconds_text(c.cpu_s(size) * size),
            f"{bytes_:.2f} GB",
        )
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def options(argv: list[str] | None) -> argparse.Namespace:
    """The command line."""
    p = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    p.add_argument("--sizes", type=int, nargs="+", default=[1, 10, 50], help="cases a task")
    p.add_argument("--poses", type=int, help="poses of a calibration, at most")
    p.add_argument("--write", action="store_true", help="the tables of docs/SCALING.md")
    return p.parse_args(argv)


def main(argv: list[str] | None = None) -> int:
    """Measure and print."""
    o = options(argv)
    plan = campaign.prepare(SPEC)
    new: dict[str, Any] = {"cases": CASES}
    if o.poses:
        new["set"] = {**plan.spec.set, "calibration.poses": float(o.poses)}
    plan = replace(plan, spec=plan.spec.model_copy(update=new))
    costs = measured(plan, sorted(o.sizes))
    for name, lines in (("measured", measured_table(costs)), ("million", million_table(costs))):
        print("\n".join(lines), end="\n\n", flush=True)
        if o.write:
            put(name, lines, PAGE, "make scaling")
    return 0


if __name__ == "__main__":
    sys.exit(main())
