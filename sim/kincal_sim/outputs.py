"""The folder that a run leaves: which files it holds, and the record of how the run ended."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .scenario import Scenario

RESULT, TRUTH, CONTACTS, LAUNCH, LOG = (
    "result.json",
    "truth.json",
    "contacts.json",
    "launch.json",
    "run.lcmlog",
)


def prepare(out: Path, store: Path | None = None) -> Path:
    """Make the folder, remove what an earlier run left in it. Returns the store of flight: the given one, or
    an empty one in the folder."""
    out.mkdir(parents=True, exist_ok=True)
    for name in (RESULT, TRUTH, CONTACTS, LAUNCH, LOG):
        (out / name).unlink(missing_ok=True)
    shutil.rmtree(out / "logs", ignore_errors=True)
    if store is None:
        shutil.rmtree(out / "store", ignore_errors=True)
    kept = store or out / "store"
    kept.mkdir(parents=True, exist_ok=True)
    return kept


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
