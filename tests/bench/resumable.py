"""Runs of a bench as lines of a file, so that it can be stopped and started again."""

from __future__ import annotations

import json
import multiprocessing
import sys
import time
import zlib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from kincal.flight import tables as codec
from kincal.flight.builds import library_file

RUNS_OF_PROCESS = 200  # then a fresh one: what MuJoCo and LCM keep of every run would come to gigabytes
Line = dict[str, Any]


class OtherRuns(ValueError):
    """The file holds runs of another flight core, other tables, or with other settings."""


def header(tables: Path, **settings: object) -> Line:
    """What a file of runs belongs to: flight core, tables of a folder, settings of the bench."""
    crc = {p.stem: codec.header(p.read_bytes()).crc_text for p in sorted(tables.glob("*.tbl"))}
    return {**settings, "tables": crc, "flight": f"{zlib.crc32(library_file('flight').read_bytes()):08x}"}


def read(path: Path, head: Line) -> list[Line]:
    """Runs in the file; makes it if there is none. A line that was cut off is dropped."""
    if not path.exists() or not path.read_text().strip():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(head) + "\n")
        return []
    first, *lines = path.read_text().splitlines()
    if json.loads(first) != head:
        raise OtherRuns(
            f"{path} belongs to another flight core, other tables or other settings; delete it, or name one"
        )
    found = []
    for line in lines:
        try:
            found.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    path.write_text("".join(json.dumps(x) + "\n" for x in (head, *found)))
    return found


def run_all(
    fly: Callable[[Any], Line],
    jobs: Sequence[Any],
    path: Path,
    known: Iterable[Line],
    key: Callable[[Line], Any],
    processes: int,
) -> list[Line]:
    """Lines of all jobs: those that are known, and the others as they are flown, each written at once. key:
    the job of a line. What it prints about progress goes to stderr."""
    of = {key(line): line for line in known}
    todo = [job for job in jobs if job not in of]
    start = time.monotonic()
    pools = multiprocessing.get_context("spawn")
    with path.open("a") as file, pools.Pool(processes, maxtasksperchild=RUNS_OF_PROCESS) as pool:
        for k, line in enumerate(pool.imap_unordered(fly, todo), 1):
            file.write(json.dumps(line) + "\n")
            file.flush()
            of[key(line)] = line
            if k % 20 == 0 or k == len(todo):
                took = time.monotonic() - start
                left = took / k * (len(todo) - k)
                print(f"{k}/{len(todo)} runs, {took:.0f} s, {left:.0f} s to go", file=sys.stderr, flush=True)
    return [of[job] for job in jobs]
