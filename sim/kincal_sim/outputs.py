"""The folder that a run leaves: which files it holds, and the record of how the run ended."""

from __future__ import annotations

import fcntl
import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import Any

from kincal_shared.errors import BadInput
from kincal_shared.keys import JOURNAL, JOURNAL_END, RUN_KEYS
from kincal_shared.writing import MARK, claim

from .scenario import Scenario

RESULT, TRUTH, CONTACTS, LAUNCH, LOG = (
    "result.json",
    "truth.json",
    "contacts.json",
    "launch.json",
    "run.lcmlog",
)
PROCESSES = ("fsw", "detector", "executive", "server")
"""Whose output lies in logs/."""
ERRORS, SUMMARY = "launch.err", ("summary.html", "summary.json", "summary.png")
"""What `kincal run` adds."""


def take(out: Path) -> None:
    """Make the folder, or take it over from an earlier run. BadInput if a file that a run would replace is
    there, and no run has left it."""
    of_runs = [str(path.relative_to(out)) for path in _left_in(out, with_store=True)]
    claim(out, "a run", [*of_runs, RUN_KEYS, ERRORS, *SUMMARY], former=_is_run(out))


@contextmanager
def alone(out: Path) -> Iterator[None]:
    """Take the folder, and keep other runs out of it. BadInput as take, or if another run is at it: each
    would remove what the other has written. The lock is of this process, so that none is left by a run that
    was killed."""
    take(out)
    with (out / MARK).open("rb") as mark:
        try:
            fcntl.flock(mark, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise BadInput(
                "another run is writing there", str(out), "wait for its end, or name another folder"
            ) from None
        except OSError:
            pass  # a file system without locks
        yield


def _is_run(out: Path) -> bool:
    """Whether the folder holds what a run leaves, also one of a version that set no mark."""
    with suppress(OSError, ValueError, TypeError):
        return {"scenario", "seed", "mode"} <= set(read(out / LAUNCH) or read(out / TRUTH))
    return False


def prepare(out: Path, store: Path | None = None) -> Path:
    """Make the folder, remove what an earlier run left in it, and nothing else. Returns the store of flight:
    the given one, or an empty one in the folder. BadInput if files of no run, or a review journal of none,
    would be replaced there."""
    journal = _journal_in(out) if store is None else []
    take(out)
    if journal:
        _put_aside(out, journal)
    for path in _left_in(out, store is None):
        path.unlink(missing_ok=True)
    with suppress(OSError):  # not there, or somebody else's files are in it
        (out / "logs").rmdir()
    kept = store or out / "store"
    kept.mkdir(parents=True, exist_ok=True)
    return kept


def _left_in(out: Path, with_store: bool) -> Iterator[Path]:
    """Files that an earlier run wrote, by their names."""
    yield from (out / name for name in (RESULT, TRUTH, CONTACTS, LAUNCH, LOG))
    yield from (out / "logs" / f"{name}.{kind}" for name in PROCESSES for kind in ("out", "err"))
    if with_store:
        for slot in ("a", "b", "tmp"):  # as kc_files.c names them
            yield from (out / "store").glob(f"k[0-9][0-9].{slot}")


def _journal_in(out: Path) -> list[Path]:
    """Files of the review journal of an earlier run. BadInput if it is of none."""
    journal = out / JOURNAL
    there = [path for path in (journal, out / (JOURNAL + JOURNAL_END)) if path.exists()]
    if there and not (out / RUN_KEYS).exists():
        raise BadInput("the folder holds a review journal of no run", str(journal), "name another folder")
    return there


def _put_aside(out: Path, journal: list[Path]) -> None:
    """The review journal of an earlier run, with the key that vouches for its lines, into earlier-N: a new
    run has another key, by which that journal would look changed."""
    aside = next(path for n in count(1) if not (path := out / f"earlier-{n}").exists())
    aside.mkdir()
    shutil.copy2(
        out / RUN_KEYS, aside / RUN_KEYS
    )  # the run makes its own; one that was named stays where it is
    for path in journal:
        path.rename(aside / path.name)


def write(path: Path, record: Mapping[str, Any]) -> None:
    """Write a record as JSON; whoever finds the file finds all of it."""
    part = path.with_name(path.name + ".part")
    part.write_text(json.dumps(record, indent=1) + "\n")
    part.rename(path)


def read(path: Path) -> dict[str, Any]:
    """A record; empty if nobody left one."""
    return dict(json.loads(path.read_text())) if path.exists() else {}


def problem_with(scenario: Scenario, result: Mapping[str, Any]) -> str:
    """Why a run is no success; empty if it is one. result: what the executive left."""
    if not result.get("success"):
        return str(result.get("reason", "the executive left no result"))
    if scenario.expect.verdict and result["verdict"] != scenario.expect.verdict:
        return f"verdict {result['verdict']}, the scenario expects {scenario.expect.verdict}"
    return ""


def conclude(out: Path, scenario: Scenario, facts: Mapping[str, Any], wall_s: float) -> dict[str, Any]:
    """Write launch.json: what the executive left, the facts about the run (where, scenario, seed, mode),
    "ok", "problem", "wall_s" and "contacts"; the same is returned."""
    result = read(out / RESULT)
    problem = problem_with(scenario, result)
    record = {
        **result,
        **facts,
        "ok": not problem,
        "problem": problem,
        "wall_s": round(wall_s, 2),
        # Shapes of the simulated arm that touched, with the seconds; for information, it ends no run.
        "contacts": read(out / CONTACTS),
    }
    write(out / LAUNCH, record)
    return record
