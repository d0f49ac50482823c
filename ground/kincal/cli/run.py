"""`kincal run`: a whole calibration in simulation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.console import Console

from kincal.cli.errors import EXIT_FAILED
from kincal.cli.options import TABLES
from kincal.cli.outputs import FOLDER_OUT
from kincal.cli.terminal import console
from kincal.cli.text import run as text
from kincal_shared.schema.names import ACQUISITIONS

if TYPE_CHECKING:
    from kincal.results import PoseLine, RunResult
    from kincal.run import Expectation, Observer, Request


@click.command()
@click.argument("scenario")
@click.option(
    "--fast/--pixels", default=False, help="Detections without pixels, or rendered images.  [default: pixels]"
)
@click.option(
    "--processes",
    is_flag=True,
    help="Fast mode too as separate processes over LCM, so that others can listen and take part.",
)
@click.option(
    "--acquisition",
    type=click.Choice(["table", *ACQUISITIONS]),
    default=None,
    help="How poses are chosen.  [default: as the scenario says]",
)
@click.option(
    "--poses",
    type=click.IntRange(1, 64),
    default=None,
    help="Number of poses besides the local initial poses.  [default: scenario]",
)
@click.option(
    "--seed",
    type=click.IntRange(0, 2**31 - 1),
    default=1,
    show_default=True,
    help="Seed of everything random.",
)
@click.option(
    "--accept",
    type=click.Choice(["auto", "policy", "ground"]),
    default=None,
    help="Who accepts: executive, flight's own policy, or this command as the ground, in two steps.  "
    "[default: scenario]",
)
@click.option(
    "--out", "out_dir", type=FOLDER_OUT, default=None, help="Result directory.  [default: out/SCENARIO]"
)
@click.option(
    "--summary/--no-summary", default=True, help="Write summary.html, .png and .json.  [default: summary]"
)
@click.option(
    "--compare/--no-compare",
    default=True,
    help="Also run ucb and random in fast mode for the comparison.  [default: compare]",
)
@TABLES
def run(
    scenario: str,
    fast: bool,
    processes: bool,
    acquisition: str | None,
    poses: int | None,
    seed: int,
    accept: str | None,
    out_dir: Path | None,
    summary: bool,
    compare: bool,
    tables_dir: Path,
) -> None:
    """Run a whole calibration in simulation and evaluate it.

    SCENARIO is a file or a name from sim/scenarios. Prints one line a pose, then true and estimated values
    of all corrections, then the pose error over held-out poses before and after. Local initial poses, small
    joint motions about the park pose, come before the poses asked for. In --out files of an earlier run are
    replaced, never those of others. Status 1 when the calibration failed or an acceptance criterion was
    missed.

    \b
    Examples:
        kincal run paper
        kincal run paper --accept ground --out out/reviewed
        kincal run healthy --fast --no-compare --seed 7 --out out/healthy-7
    """
    from kincal import run as lib

    request = lib.Request(
        scenario,
        "fast" if fast else "pixels",
        acquisition,
        poses,
        seed,
        out_dir or Path("out") / Path(scenario).stem,
        tables_dir,
        accept,
        processes,
    )
    out = console()
    result = lib.calibrate(request, _observer(out), compare=compare)
    files = _write_summary(request, result) if summary and result.poses else []
    text.run_end(out, result, files, request.out / "run.lcmlog")
    raise SystemExit(0 if result.ok else EXIT_FAILED)


def _observer(out: Console) -> Observer:
    """Prints what a run reports."""
    from kincal.run import Observer

    class Printer(Observer):
        def started(self, request: Request, expectation: Expectation) -> None:
            out.print(
                f"[bold]{expectation.title}[/]: {request.mode}, seed {request.seed}, results in {request.out}"
            )
            out.print(text.POSE_HEAD)

        def pose(self, line: PoseLine, n_goal: int) -> None:
            out.print(text.pose_line(line, n_goal), markup=False)

        def note(self, text: str) -> None:
            out.print(text, markup=False)

    return Printer()


def _write_summary(request: Request, result: RunResult) -> list[Path]:
    """The page of a run, its data, and its picture where one can be made."""
    from kincal.cli.provenance import table_crcs, today
    from kincal.pages import run as pages
    from kincal.pages.page import Provenance

    origin = Provenance.of_file(today(), request.out / "run.lcmlog", tables=table_crcs(request.tables))
    files, why = pages.write_all(result, request.out, replace(origin, seed=request.seed))
    if why:
        click.echo(why, err=True)
    return files
