"""Cases of a bench as a campaign (kincal.campaign) in a folder, so that it can be stopped and started again.

A bench has a function `case(seed, values)` and AXES: values by name, of which every combination is flown with
every seed, the last name fastest. What a case gives may be nested: that is kept as JSON."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from math import prod
from pathlib import Path
from typing import Any

from kincal import campaign
from kincal.campaign.function import DIED
from kincal_shared.errors import BadInput, KincalError
from kincal_shared.schema.campaign import CASES_MAX, Campaign

BUILD = Path(__file__).resolve().parents[2] / "build"
Axes = Mapping[str, Sequence[Any]]
Line = dict[str, Any]
Wanted = Callable[[int, Mapping[str, Any]], bool]
TIME_LIMIT_S = 7200.0
EMPTY_MIN = 0.99  # share of the cases, shown with 95 % confidence
_JSON = "_json"  # end of the name of a column


def options(name: str, doc: str | None, seeds: int = 0, first: int = 1) -> argparse.ArgumentParser:
    """The command line of a bench, with what all have. seeds: how many; 0: it has other words for that."""
    p = argparse.ArgumentParser(prog=f"{name}.py", description=(doc or "").split("\n")[0])
    if seeds:
        p.add_argument("--seeds", type=int, default=seeds)
        p.add_argument("--first", type=int, default=first, help="first seed")
    p.add_argument("--jobs", type=int, default=2, help="processes")
    p.add_argument("--scheduler", default="", metavar="ADDRESS", help="of dask, instead of processes here")
    p.add_argument("--out", type=Path, default=BUILD / "campaigns" / name, help="folder of the cases")
    return p


def columns(line: Line) -> Line:
    """A line as columns: what is nested as JSON."""
    nested = {key: value for key, value in line.items() if isinstance(value, (dict, list, tuple))}
    return {k: v for k, v in line.items() if k not in nested} | {
        f"{key}{_JSON}": json.dumps(value) for key, value in nested.items()
    }


def _line(row: Line) -> Line:
    """The same again, with seed and values of the case; what has no value is left out."""
    found = {key.removeprefix("x."): value for key, value in row.items() if value is not None}
    for key in [key for key in found if key.endswith(_JSON)]:
        found[key.removesuffix(_JSON)] = json.loads(found.pop(key))
    return found


def _wrong_seeds(first: int, seeds: int, each: int) -> BadInput | None:
    """Why these seeds cannot be flown: a case is known by its number, which counts all seeds from 0."""
    most = CASES_MAX // each
    if first >= 0 and seeds >= 1 and first + seeds <= most:
        return None
    return BadInput(
        f"first seed {first} with {seeds} seeds: a campaign has {CASES_MAX} cases, and each seed {each} of "
        "them, counted from seed 0",
        "--first, --seeds",
        f"--first at least 0, --seeds at least 1, and together at most {most}",
    )


def fly(
    o: argparse.Namespace,
    function: str,
    axes: Axes,
    wanted: Wanted,
    settings: Mapping[str, Any] | None = None,
    empty: Sequence[str] = (),
) -> list[Line]:
    """Lines of the seeds and combinations that are wanted, seeds first; what the folder has is not flown
    again. settings: the same in all cases; empty: columns whose text has to be empty in all cases, which
    `kincal campaign report` judges. Exit status 2 if the folder belongs to something else, 1 if a case
    died."""
    each = prod(map(len, axes.values()))
    if (wrong := _wrong_seeds(o.first, o.seeds, each)) is not None:
        print(wrong, file=sys.stderr)
        sys.exit(2)
    spec = Campaign(
        function=function,
        seed=0,
        sampling="combinations",
        cases=(o.first + o.seeds) * each,
        time_limit_s=TIME_LIMIT_S,
        set=dict(settings or {}),
        dispersion=[{"key": key, "choice": list(values)} for key, values in axes.items()],
        columns=dict.fromkeys(empty, "text"),
        requirement=[{"name": n, "holds": f'{n} == ""', "probability": EMPTY_MIN} for n in empty],
    )
    try:
        plan = campaign.planned(spec, Path(__file__))
        every = plan.cases(range(o.first * plan.combinations, spec.cases))
        asked = [case.index for case in every if wanted(case.seed, case.changes)]
        campaign.run(plan, o.out, processes=o.jobs, scheduler=o.scheduler, tick=_say, indices=asked)
        found = campaign.read(o.out).columns
    except KincalError as e:
        print(e, file=sys.stderr)
        sys.exit(2)
    rows = {v[0]: dict(zip(found, v, strict=True)) for v in zip(*found.values(), strict=True)}
    dead = [f"case {k} died: {rows[k]['reason']}" for k in asked if rows[k]["ended"] == DIED]
    if dead:
        print("\n".join(dead), file=sys.stderr)
        sys.exit(1)
    return [_line(rows[k]) for k in asked]


def _say(p: campaign.Progress) -> None:
    if p.flown % 20 == 0 or p.done == p.of:
        text = f"{p.done}/{p.of} runs, {p.took_s:.0f} s, {p.left_s:.0f} s to go"
        print(text, file=sys.stderr, flush=True)
