"""`kincal space`: make search spaces and ask them questions."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np

from kincal import link
from kincal.cli.errors import EXIT_FAILED
from kincal.cli.options import DESCRIPTION, EXISTS, FILE, PROCESSES, TABLES, Command
from kincal.cli.outputs import FILE_OUT, PICTURE
from kincal.cli.provenance import say_files, table_crcs, today
from kincal.cli.terminal import console, progress
from kincal.cli.text import space as text

if TYPE_CHECKING:
    from kincal.space import BuiltSpace, ExpectedInformation, SpaceTable


@click.group()
def space() -> None:
    """Make search spaces and ask them questions.

    \b
    Example:
        kincal space build tables/src/space.toml tables/bin/space.tbl
    """


@space.command("build")
@click.argument("description", type=FILE)
@click.argument("out", type=FILE_OUT)
@TABLES
@click.option(
    "--picture",
    type=PICTURE,
    default=None,
    help="Also draw kept and rejected poses: PNG, and HTML beside it.",
)
@PROCESSES
def space_build(description: Path, out: Path, tables_dir: Path, picture: Path | None, processes: int) -> None:
    """Search for candidate poses: reachable, in view, clear of everything, also when the arm is wrong.

    The same description, arm, camera and kernel always give the same table.

    \b
    Examples:
        kincal space build tables/src/space.toml tables/bin/space.tbl
        kincal space build tables/src/space.toml out/space.tbl --picture out/space.png
    """
    from kincal import space as lib
    from kincal_shared.writing import keep_inputs

    keep_inputs([out], [description])
    out_console = console()
    with progress() as tick:
        built = lib.build(lib.read_description(description), tables_dir, tick, processes)
    link.write_image(built.image, out)
    text.built(out_console, built, out)
    if picture:
        _draw(built, tables_dir, picture)


@space.command("show")
@click.argument("file", type=EXISTS)
@TABLES
@click.option(
    "--picture", type=PICTURE, default=None, help="Where to write the picture.  [default: FILE.png]"
)
def space_show(file: Path, tables_dir: Path, picture: Path | None) -> None:
    """Print numbers of a search space and draw it: PNG, and HTML beside it.

    What was rejected is drawn by `kincal space build --picture`; a table only holds what was kept.

    \b
    Example:
        kincal space show tables/bin/space.tbl --picture out/space.png
    """
    from kincal import space as lib
    from kincal.api.spaces import load

    image, table = load(file, tables_dir)
    tables = lib.TablesFolder(tables_dir)
    text.summary(console(), image, lib.summarise(table, tables.camera, tables.arm_crc))
    built = lib.BuiltSpace(image, table, table.n_candidates, {})
    _draw(built, tables_dir, picture or file.with_suffix(".png"))


def _draw(built: BuiltSpace, tables_dir: Path, picture: Path) -> None:
    """The page of a search space and its picture."""
    from kincal.pages import space as pages
    from kincal.pages.page import Provenance

    crcs = {**table_crcs(tables_dir, ("arm", "camera")), "space": built.image.crc_text}
    made, shown, outcome = pages.of_built(built, tables_dir, Provenance(today(), crcs))
    say_files("page", *pages.write_all(made, shown, outcome, picture))


@space.command("explain")
@click.argument("file", type=FILE)
@click.argument("candidate", type=int, required=False)
@click.option("--at", type=float, nargs=3, default=None, help="Instead: why is there none near X Y Z [m]?")
@click.option("--half", type=float, default=0.05, show_default=True, help="Half size of that region [m].")
@click.option("--samples", type=int, default=400, show_default=True, help="Tool poses tried there.")
@DESCRIPTION
@TABLES
def space_explain(
    file: Path,
    candidate: int | None,
    at: tuple[float, float, float] | None,
    half: float,
    samples: int,
    description: Path,
    tables_dir: Path,
) -> None:
    """Say why a candidate is in, or why there is none in some region.

    Status 1 when the candidate fails a check, or nothing passes in that region.

    \b
    Examples:
        kincal space explain tables/bin/space.tbl 17
        kincal space explain tables/bin/space.tbl --at 0.5 0.4 0.1
    """
    from kincal import space as lib
    from kincal.api.spaces import checks, load

    _, table = load(file, tables_dir)
    asked = checks(description, tables_dir)
    if at is None and candidate is not None:
        lines = lib.explain_candidate(asked, table, candidate)
        text.candidate(console(), candidate, lines)
        good = all(x.ok for x in lines if x.counts)
    elif at is not None and candidate is None:
        region = lib.explain_region(asked, np.array(at), half, samples)
        text.region(console(), at, half, region)
        good = region.good > 0
    else:
        raise click.UsageError("give a candidate, or --at X Y Z")
    raise SystemExit(0 if good else EXIT_FAILED)


@space.command("check")
@click.argument("file", type=FILE)
@DESCRIPTION
@TABLES
@PROCESSES
def space_check(file: Path, description: Path, tables_dir: Path, processes: int) -> None:
    """Verify all candidates, local initial poses, segments and servo bounds of a table again; status 1 if not
    all hold.

    Servo bounds are sampled with other random numbers than the search used: the share that touches is an
    honest estimate of what the search missed.

    \b
    Example:
        kincal space check tables/bin/space.tbl
    """
    from kincal import space as lib
    from kincal.api.spaces import checks, load

    _, table = load(file, tables_dir)
    asked = checks(description, tables_dir)
    with progress() as tick, lib.WorkerPool(asked, processes) as pool:
        found = lib.recheck(asked, pool, table, tick)
    text.checked(console(), file, table, found)
    raise SystemExit(0 if found.ok else EXIT_FAILED)


@space.command("diff")
@click.argument("a", type=FILE)
@click.argument("b", type=FILE)
@TABLES
def space_diff(a: Path, b: Path, tables_dir: Path) -> None:
    """Compare two search spaces candidate by candidate; status 1 if they differ.

    \b
    Example:
        kincal space diff tables/bin/space.tbl out/space.tbl
    """
    from kincal import space as lib
    from kincal.api.spaces import load

    image_a, one = load(a, tables_dir)
    image_b, two = load(b, tables_dir)
    text.diff(console(), image_a, image_b, lib.compare(one, two, lib.TablesFolder(tables_dir).kernel, 0))
    raise SystemExit(0 if image_a.crc == image_b.crc else EXIT_FAILED)


NOISE = (
    click.option(
        "--sigma-mm", type=float, default=0.5, show_default=True, help="Noise of a measured position."
    ),
    click.option("--sigma-mrad", type=float, default=3.5, show_default=True, help="Noise of a rotation."),
    click.option(
        "--poses", type=click.IntRange(2, 64), default=20, show_default=True, help="Poses to plan with."
    ),
)


def _planned(command: Command) -> Command:
    """The options of a planned calibration."""
    for option in reversed(NOISE):
        command = option(command)
    return command


def _expected(
    file: Path, tables_dir: Path, sigma_mm: float, sigma_mrad: float, poses: int
) -> tuple[SpaceTable, ExpectedInformation]:
    """A space and what it is expected to tell after up to that many poses."""
    from kincal.api.spaces import expected, load

    _, table = load(file, tables_dir)
    return table, expected(table, tables_dir, poses, sigma_mm * 1e-3, sigma_mrad * 1e-3)


def _separability(table: SpaceTable, tables_dir: Path, model: str, found: ExpectedInformation) -> None:
    from kincal import space as lib

    arm = lib.TablesFolder(tables_dir).arm
    text.separability(console(), lib.separability(table, arm, model, found.chosen, found.noise))


@space.command("information")
@click.argument("file", type=FILE)
@TABLES
@_planned
@click.option(
    "--model", default="wam", show_default=True, help="Arm file of the workbench, for effects; `none`: skip."
)
def space_information(
    file: Path, tables_dir: Path, sigma_mm: float, sigma_mrad: float, poses: int, model: str
) -> None:
    """Say what measurements in a space are expected to tell, before it is sent up.

    Expected rank and sigma for each acquisition, and by name what cannot be identified; then which effects
    these poses would not show or not distinguish. Status 1 when a parameter cannot be identified.

    \b
    Example:
        kincal space information tables/bin/space.tbl
    """
    table, found = _expected(file, tables_dir, sigma_mm, sigma_mrad, poses)
    text.information(console(), found)
    if model != "none":
        _separability(table, tables_dir, model, found)
    raise SystemExit(0 if found.ok else EXIT_FAILED)


@space.command("separability")
@click.argument("file", type=FILE)
@TABLES
@_planned
@click.option("--model", default="wam", show_default=True, help="Arm file of the workbench.")
def space_separability(
    file: Path, tables_dir: Path, sigma_mm: float, sigma_mrad: float, poses: int, model: str
) -> None:
    """Say which effects measurements in a space would not show, or not distinguish.

    Every effect of the library at its typical size, at the poses that D-optimal design would choose.

    \b
    Example:
        kincal space separability tables/bin/space.tbl --model wam
    """
    table, found = _expected(file, tables_dir, sigma_mm, sigma_mrad, poses)
    _separability(table, tables_dir, model, found)
