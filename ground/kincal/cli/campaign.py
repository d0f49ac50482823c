"""`kincal campaign`: many simulated calibrations with dispersed values, and what they show."""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from kincal.cli.errors import EXIT_FAILED, EXIT_INTERRUPTED
from kincal.cli.options import FILE, PROCESSES
from kincal.cli.outputs import FILE_OUT, FOLDER_OUT, REPORT
from kincal.cli.terminal import console, progress
from kincal_shared import installation

if TYPE_CHECKING:
    from kincal.campaign import Progress

FOLDER = click.Path(path_type=Path, exists=True, file_okay=False)
SAY_S = 30.0  # between lines about progress where there is no terminal


@click.group()
def campaign() -> None:
    """Fly many simulated calibrations with dispersed values, and judge requirements by them.

    \b
    Example:
        kincal campaign run sim/campaigns/errors.toml --out out/errors
    """


@campaign.command("run")
@click.argument("spec", type=FILE)
@click.option(
    "--out", "folder", type=FOLDER_OUT, default=None, help="Folder of the cases.  [default: out/SPEC]"
)
@PROCESSES
@click.option(
    "--scheduler",
    default="",
    metavar="ADDRESS",
    help="Fly on the workers of this dask scheduler instead, such as tcp://host:8786.",
)
@click.option("--batch", type=click.IntRange(1, 1000), default=20, show_default=True,
              help="Cases a file, and a task of the cluster (10 to 50).")  # fmt: skip
def campaign_run(spec: Path, folder: Path | None, processes: int, scheduler: str, batch: int) -> None:
    """Fly the cases of a campaign that are not in its folder yet.

    SPEC says what scenario is flown, how often, what differs from case to case, and what has to hold. The
    command can be interrupted (Ctrl-C) or killed at any time; given again, it goes on. A case that dies
    is an outcome. Status 0 when all cases are flown, whatever came of them.

    \b
    Examples:
        kincal campaign run sim/campaigns/errors.toml --out out/errors --processes 8
        kincal campaign run sim/campaigns/errors.toml --out out/errors --scheduler tcp://head:8786
    """
    installation.campaign()
    from kincal import campaign as lib

    folder = folder or Path("out") / spec.stem
    plan = lib.prepare(spec)
    try:
        with _progress() as tick:
            end = lib.run(plan, folder, processes=processes, scheduler=scheduler, batch=batch, tick=tick)
    except KeyboardInterrupt:
        click.echo("interrupted; finished cases are kept, and the same command goes on", err=True)
        sys.exit(EXIT_INTERRUPTED)
    click.echo(f"{end.done} of {end.of} cases in {folder}; {end.flown} flown now, {end.died} of these died")
    click.echo(f"report: kincal campaign report {shlex.quote(str(folder))}")


@contextmanager
def _progress() -> Iterator[Callable[[Progress], None]]:
    """Progress with rate and time left: a bar on a terminal, else a line now and then."""
    said = time.monotonic()
    with progress() as bar:

        def tick(now: Progress) -> None:
            nonlocal said
            died = f", {now.died} died" if now.died else ""
            text = f"{now.done}/{now.of} cases{died}, {now.rate:.2f} a second, {_span(now.left_s)} left"
            bar(text, now.done, now.of)
            if not sys.stderr.isatty() and time.monotonic() - said > SAY_S:
                said = time.monotonic()
                click.echo(text, err=True)

        yield tick


def _span(s: float) -> str:
    """A time as people say it."""
    if s < 100:
        return f"{s:.0f} s"
    return f"{s / 60:.0f} min" if s < 6000 else f"{s / 3600:.1f} h"


@campaign.command("report")
@click.argument("folder", type=FOLDER)
@click.argument("other", type=FOLDER, required=False)
@click.option(
    "--outcome",
    default="",
    help="Number by which cases are good or bad [default: after_pos_m; with a function, its first number]",
)
@click.option("--sobol", is_flag=True, help="Also first-order Sobol indices of the dispersed values.")
@click.option("--report", "page", type=REPORT, default=None, help="HTML page.  [default: FOLDER/report.html]")
def campaign_report(folder: Path, other: Path | None, outcome: str, sobol: bool, page: Path | None) -> None:
    """Say what the cases of a campaign show: requirements, distributions, influences, the worst cases.

    With OTHER, the folder of a second campaign, both are compared. Status 1 unless all cases are flown
    and every requirement is shown to be met.

    \b
    Examples:
        kincal campaign report out/errors
        kincal campaign report out/errors out/errors-before --outcome after_rot_rad
    """
    installation.campaign()
    from kincal import campaign as lib
    from kincal.cli.provenance import today
    from kincal.cli.text import campaign as text
    from kincal.pages import campaign as pages

    made = lib.report(lib.read(folder), outcome, sobol)
    compared = lib.compare(made, lib.report(lib.read(other), outcome)) if other else None
    text.report(console(), made)
    if compared:
        text.compared(console(), compared)
    path = pages.write(made, compared, page or folder / "report.html", today())
    click.echo(f"page: {path}")
    sys.exit(0 if made.ok else EXIT_FAILED)


@campaign.command("replay")
@click.argument("folder", type=FOLDER)
@click.argument("index", type=click.IntRange(0))
@click.option("--log", type=FILE_OUT, default=None, help="Also write all telemetry, for `kincal log`.")
def campaign_replay(folder: Path, index: int, log: Path | None) -> None:
    """Fly one case again and compare it with what is stored, bit for bit.

    Status 1 when anything differs.

    \b
    Example:
        kincal campaign replay out/errors 17 --log out/case-17.lcmlog
    """
    installation.campaign()
    from kincal import campaign as lib
    from kincal.cli.text import campaign as text

    found = lib.replay(folder, index, log)
    text.replayed(console(), found)
    sys.exit(EXIT_FAILED if found.differing else 0)
