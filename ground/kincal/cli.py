"""The `kincal` command. Every command is a short call into the library."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

# The workbench handles thousands of small matrices: threads inside the linear algebra only get in each
# other's way (five times slower). Has to be said before numpy is loaded; the user's own setting wins.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from kincal import __version__, link, show  # noqa: E402
from kincal.cli_model import model  # noqa: E402

PATH = click.Path(path_type=Path)
URL = click.option(
    "--url",
    default=link.DEFAULT_URL,
    show_default=True,
    envvar="KINCAL_URL",
    help="LCM URL of the flight process.",
)
TABLES = click.option(
    "--tables",
    "tables_dir",
    type=PATH,
    default=Path("tables/bin"),
    show_default=True,
    help="Directory with built table images.",
)
TIMEOUT = click.option(
    "--timeout",
    "timeout_s",
    type=float,
    default=10.0,
    show_default=True,
    help="Seconds to wait for each answer.",
)


def console() -> Console:
    """Rich output; plain and wide when it does not go to a terminal."""
    out = Console(highlight=False)
    return out if out.is_terminal else Console(highlight=False, width=140)


def bar(out: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed}/{task.total}"),
        TimeElapsedColumn(),
        console=out,
        transient=True,
        disable=not out.is_terminal,
    )


PROCESSES = click.option(
    "--processes",
    type=click.IntRange(1, 64),
    default=2,
    show_default=True,
    help="Processes to share the work; the result does not depend on it.",
)


def phases(progress: Progress) -> Callable[[str, int, int], None]:
    """A tick for work in phases, on one bar."""
    task = progress.add_task("starting", total=1)
    return lambda what, done, of: progress.update(task, description=what, completed=done, total=of)


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__)
def main() -> None:
    """Ground side of KinCal: make tables and search spaces, run calibrations, read logs, review
    corrections, find what the arm model lacks.

    \b
    Exit status: 0 good, 1 the work was done and the answer is no, 2 bad input, 3 the data cannot answer.

    \b
    Example:
        kincal run paper --fast
    """


# --------------------------------------------------------------------------- table


@main.group()
def table() -> None:
    """Build, check, compare, uplink and dump tables.

    \b
    Example:
        kincal table build tables/src tables/bin
    """


@table.command("build")
@click.argument("source", type=click.Path(path_type=Path, exists=True))
@click.argument("out", type=PATH)
@click.option(
    "--tables",
    "tables_dir",
    type=PATH,
    default=None,
    help="Directory with arm.tbl and camera.tbl, for a search space.  [default: next to OUT]",
)
def table_build(source: Path, out: Path, tables_dir: Path | None) -> None:
    """Build table images from TOML sources.

    SOURCE is one file, or a directory of which every *.toml is built. What flight would refuse is
    refused here, with the same words.

    \b
    Examples:
        kincal table build tables/src/config.toml tables/bin/config.tbl
        kincal table build tables/src tables/bin
    """
    from kincal import tables

    if source.is_dir():
        pairs = [(p, out / f"{p.stem}.tbl") for p in tables.build_order(sorted(source.glob("*.toml")))]
    else:
        pairs = [(source, out)]
    for src, dst in pairs:
        image = tables.build(src, tables_dir or dst.parent)
        link.write_image(image, dst)
        click.echo(f"{dst}: {image.kind}, {len(image.data)} bytes, CRC {image.crc_text}")


@table.command("show")
@click.argument("file", type=click.Path(path_type=Path, exists=True))
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def table_show(file: Path, as_json: bool) -> None:
    """Print a table image (or a TOML source, as it would be built).

    \b
    Example:
        kincal table show tables/bin/arm.tbl
    """
    from kincal import tables

    image, struct = tables.load(file)
    doc = tables.to_doc(struct)
    if as_json:
        click.echo(
            json.dumps(
                {"kind": image.kind, "crc": image.crc_text, "fields": doc},
                indent=1,
                default=lambda b: b.hex(),
            )
        )
    else:
        show.table(console(), image, doc)


@table.command("check")
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path, exists=True))
def table_check(files: tuple[Path, ...]) -> None:
    """Check tables as flight would; status 2 if any is refused.

    \b
    Example:
        kincal table check tables/bin/*.tbl
    """
    from kincal import tables
    from kincal.errors import EXIT_INPUT, KincalError

    bad = 0
    for file in files:
        try:
            image, _ = tables.load(file)
            click.echo(f"ok    {file}: {image.kind}, CRC {image.crc_text}")
        except KincalError as error:
            bad += 1
            click.echo(f"BAD   {file}: {error.what}", err=True)
    if bad:
        click.echo(f"{bad} of {len(files)} refused", err=True)
        raise SystemExit(EXIT_INPUT)


@table.command("diff")
@click.argument("a", type=click.Path(path_type=Path, exists=True))
@click.argument("b", type=click.Path(path_type=Path, exists=True))
def table_diff(a: Path, b: Path) -> None:
    """Print every field that differs between two tables; status 1 if any does.

    \b
    Example:
        kincal table diff tables/src/config.toml tables/bin/config.tbl
    """
    from kincal import tables

    image_a, image_b, changes = tables.diff(a, b)
    show.diff(console(), image_a, image_b, changes)
    raise SystemExit(1 if changes else 0)


@table.command("uplink")
@click.argument("file", type=click.Path(path_type=Path, exists=True))
@URL
@TIMEOUT
def table_uplink(file: Path, url: str, timeout_s: float) -> None:
    """Send a table to flight: stage, validate, activate, and see its CRC in housekeeping.

    \b
    Example:
        kincal table uplink tables/bin/config.tbl
    """
    from kincal import tables

    image, _ = tables.load(file)
    with link.Link(url) as up:
        up.upload(image, timeout_s)
    click.echo(f"{image.kind} table {image.crc_text} is active")


@table.command("dump")
@click.argument("kind", type=click.Choice(["arm", "camera", "terms", "kin", "space", "kernel", "config"]))
@click.argument("out", type=PATH)
@URL
@TIMEOUT
def table_dump(kind: str, out: Path, url: str, timeout_s: float) -> None:
    """Bring down the table that is active on board.

    \b
    Example:
        kincal table dump kin out/kin.tbl
    """
    with link.Link(url) as down:
        image = down.dump(kind, timeout_s)
    link.write_image(image, out)
    click.echo(f"{out}: {kind}, {len(image.data)} bytes, CRC {image.crc_text}")


# --------------------------------------------------------------------------- space


@main.group()
def space() -> None:
    """Make and look at search spaces.

    \b
    Example:
        kincal space build tables/src/space.toml tables/bin/space.tbl
    """


@space.command("build")
@click.argument("description", type=click.Path(path_type=Path, exists=True, dir_okay=False))
@click.argument("out", type=PATH)
@TABLES
@click.option(
    "--picture", type=PATH, default=None, help="Also draw what was kept and dropped: PNG, and HTML beside it."
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
    from kincal import tables

    out_console = console()
    with bar(out_console) as progress:
        built = lib.build(lib.read_description(description), tables_dir, phases(progress), processes)
    link.write_image(built.image, out)
    show.space_built(out_console, built, out)
    if picture:
        from kincal.space import figures

        _, arm = tables.load(tables_dir / "arm.tbl")
        _, camera = tables.load(tables_dir / "camera.tbl")
        scene = lib.scene(built.struct, arm, camera)
        title = f"{built.kept} candidates of {built.n_samples} samples, {built.image.crc_text}"
        figures.save_png(built, scene, picture.with_suffix(".png"), title)
        figures.save_html(built, scene, picture.with_suffix(".html"), title)
        out_console.print(f"pictures: {picture.with_suffix('.png')}, {picture.with_suffix('.html')}")


@space.command("show")
@click.argument("file", type=click.Path(path_type=Path, exists=True))
@TABLES
@click.option("--picture", type=PATH, default=None, help="Where to write the picture.  [default: FILE.png]")
def space_show(file: Path, tables_dir: Path, picture: Path | None) -> None:
    """Print numbers of a search space and draw it: PNG, and HTML beside it.

    What was dropped is drawn by `kincal space build --picture`; a table only holds what was kept.

    \b
    Example:
        kincal space show tables/bin/space.tbl --picture out/space.png
    """
    from kincal import pictures, tables
    from kincal import space as lib
    from kincal.space import figures

    image, struct = _space(file, tables_dir)
    arm_image, arm = tables.load(tables_dir / "arm.tbl")
    _, camera = tables.load(tables_dir / "camera.tbl")
    numbers, incid, rng = lib.describe(struct, arm_image, camera)
    picture = picture or file.with_suffix(".png")
    geometry = lib.scene(struct, arm, camera)
    title = f"{numbers.candidates} candidates, {len(numbers.priors)} priors, table {image.crc_text}"
    pictures.save_space_png(geometry, picture, title, incid, rng)
    kept = lib.Built(image, struct, numbers.candidates, {})
    figures.save_html(kept, geometry, picture.with_suffix(".html"), title)
    show.space(console(), image, numbers, picture)


def _space(file: Path, tables_dir: Path) -> tuple[Any, Any]:
    """Image and struct of a space table."""
    from kincal import tables

    image, struct = tables.load(file, tables_dir)
    if image.kind != "space":
        raise click.BadParameter(f"{file} is a {image.kind} table")
    return image, struct


DESCRIPTION = click.option(
    "--description",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    default=Path("tables/src/space.toml"),
    show_default=True,
    help="What the table was built from.",
)


@space.command("explain")
@click.argument("file", type=click.Path(path_type=Path, exists=True, dir_okay=False))
@click.argument("candidate", type=int, required=False)
@click.option("--at", type=float, nargs=3, default=None, help="Instead: why is there none at X Y Z [m]?")
@click.option("--half", type=float, default=0.05, show_default=True, help="Half size of that corner [m].")
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
    """Say why a candidate is in, or why there is none in some corner.

    Status 1 when the candidate fails a check, or nothing passes in that corner.

    \b
    Examples:
        kincal space explain tables/bin/space.tbl 17
        kincal space explain tables/bin/space.tbl --at 0.5 0.4 0.1
    """
    from kincal import space as lib
    from kincal import tables
    from kincal.space import explain

    if (candidate is None) == (not at):
        raise click.UsageError("give a candidate, or --at X Y Z")
    _, struct = _space(file, tables_dir)
    _, arm = tables.load(tables_dir / "arm.tbl")
    _, camera = tables.load(tables_dir / "camera.tbl")
    checks = lib.Checks(lib.read_description(description), arm, camera)
    if candidate is not None:
        lines = explain.candidate(checks, struct, candidate)
        show.space_candidate(console(), candidate, lines)
        raise SystemExit(0 if all(x.ok for x in lines if not x.check.startswith("tag ")) else 1)
    corner = explain.corner(checks, at, half, samples)
    show.space_corner(console(), at, half, corner)
    raise SystemExit(0 if corner.good else 1)


@space.command("check")
@click.argument("file", type=click.Path(path_type=Path, exists=True, dir_okay=False))
@DESCRIPTION
@TABLES
@PROCESSES
def space_check(file: Path, description: Path, tables_dir: Path, processes: int) -> None:
    """Prove all candidates, first looks, segments and servo boxes of a table again; status 1 if not all hold.

    Servo boxes are sampled with other random numbers than the search used: the share that touches is an
    honest estimate of what the search missed.

    \b
    Example:
        kincal space check tables/bin/space.tbl
    """
    from kincal import space as lib
    from kincal import tables
    from kincal.space import explain, work

    _, struct = _space(file, tables_dir)
    arm_image, arm = tables.load(tables_dir / "arm.tbl")
    camera_image, camera = tables.load(tables_dir / "camera.tbl")
    desc = lib.read_description(description)
    checks = lib.Checks(desc, arm, camera)
    out = console()
    with bar(out) as progress, work.Crew(checks, desc, arm_image.data, camera_image.data, processes) as crew:
        found = explain.recheck(checks, crew, struct, phases(progress))
    n = lib.ordinary(struct)
    show.space_checked(out, file, n, int(struct.n_cand) - n, found)
    raise SystemExit(0 if found.ok else 1)


@space.command("diff")
@click.argument("a", type=click.Path(path_type=Path, exists=True, dir_okay=False))
@click.argument("b", type=click.Path(path_type=Path, exists=True, dir_okay=False))
@TABLES
def space_diff(a: Path, b: Path, tables_dir: Path) -> None:
    """Compare two search spaces candidate by candidate; status 1 if they differ.

    \b
    Example:
        kincal space diff tables/bin/space.tbl out/space.tbl
    """
    from kincal import tables
    from kincal.space import explain

    _, kernel = tables.load(tables_dir / "kernel.tbl")
    image_a, one = _space(a, tables_dir)
    image_b, two = _space(b, tables_dir)
    found = explain.difference(one, two, kernel, 0)
    show.space_diff(console(), image_a, image_b, found)
    raise SystemExit(0 if image_a.crc == image_b.crc else 1)


@space.command("worth")
@click.argument("file", type=click.Path(path_type=Path, exists=True, dir_okay=False))
@TABLES
@click.option("--sigma-mm", type=float, default=0.5, show_default=True, help="Noise of a measured position.")
@click.option("--sigma-mrad", type=float, default=3.5, show_default=True, help="Noise of a rotation.")
@click.option(
    "--poses", type=click.IntRange(2, 64), default=20, show_default=True, help="Looks to plan with."
)
@click.option(
    "--model", default="wam", show_default=True, help="Arm file of the workbench, for effects; `none`: skip."
)
def space_worth(
    file: Path, tables_dir: Path, sigma_mm: float, sigma_mrad: float, poses: int, model: str
) -> None:
    """Say what a space is worth before it is sent up.

    Expected rank and sigma for each acquisition, what cannot be identified, by name, and which effects these
    poses would not show or not tell apart. Status 1 when a parameter cannot be identified.

    \b
    Example:
        kincal space worth tables/bin/space.tbl
    """
    from kincal import tables
    from kincal.space import apart
    from kincal.space import worth as lib

    _, struct = _space(file, tables_dir)
    got = {k: tables.load(tables_dir / f"{k}.tbl")[1] for k in ("arm", "terms", "config", "kernel")}
    steps = tuple(sorted({n for n in (5, 8, 12) if n < poses} | {poses}))
    noise = sigma_mm * 1e-3, sigma_mrad * 1e-3
    found = lib.worth(struct, got["arm"], got["terms"], got["config"], got["kernel"], steps, *noise)
    show.space_worth(console(), found)
    if model != "none":
        show.space_apart(console(), apart.apart(struct, got["arm"], model, found.chosen, *noise))
    raise SystemExit(0 if found.ok else 1)


# --------------------------------------------------------------------------- run


@main.command()
@click.argument("scenario")
@click.option(
    "--fast/--pixels", default=False, help="Detections without pixels, or rendered images.  [default: pixels]"
)
@click.option(
    "--acquisition",
    type=click.Choice(["table", "ucb", "random", "dopt", "vopt"]),
    default=None,
    help="How poses are chosen.  [default: as the scenario says]",
)
@click.option(
    "--poses",
    type=click.IntRange(1, 64),
    default=None,
    help="Number of poses besides the first looks.  [default: scenario]",
)
@click.option("--seed", type=int, default=1, show_default=True, help="Seed of everything random.")
@click.option(
    "--accept",
    type=click.Choice(["auto", "policy", "ground"]),
    default=None,
    help="Who accepts: executive, flight's own policy, or this command as the ground, in two steps.  "
    "[default: scenario]",
)
@click.option("--out", "out_dir", type=PATH, default=None, help="Result directory.  [default: out/SCENARIO]")
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
    acquisition: str | None,
    poses: int | None,
    seed: int,
    accept: str | None,
    out_dir: Path | None,
    summary: bool,
    compare: bool,
    tables_dir: Path,
) -> None:
    """Run a whole calibration in simulation and judge it.

    SCENARIO is a file or a name from sim/scenarios. Prints one line a pose (the first looks, about the place
    where the arm stands, come before the poses asked for), then true and estimated
    values of all corrections, then the pose error over held-out poses before and after. Status 1 when the
    calibration failed or a gate was missed.

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
    )
    result = lib.run_and_judge(request, console(), compare=compare, summary=summary)
    raise SystemExit(0 if result.ok else 1)


# --------------------------------------------------------------------------- log


@main.command()
@click.argument("file", type=click.Path(path_type=Path, exists=True, dir_okay=False))
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
@click.option("--debug", is_flag=True, help="Also list debug events.")
def log(file: Path, as_json: bool, debug: bool) -> None:
    """Summarise an LCM log: messages, sessions, poses, events, proposals.

    \b
    Example:
        kincal log out/paper/run.lcmlog
    """
    from kincal import lcmlog

    summary = lcmlog.read(file)
    if as_json:
        click.echo(json.dumps(summary.as_dict(), indent=1))
    else:
        show.log(console(), summary, debug)


# --------------------------------------------------------------------------- review

JOURNAL = click.option(
    "--journal",
    type=PATH,
    default=Path("out/review.jsonl"),
    show_default=True,
    envvar="KINCAL_JOURNAL",
    help="Append-only record of decisions.",
)
BY = click.option("--by", required=True, help="Who decides.")
WHY = click.option("--why", required=True, help="Reason, for the record.")


@main.group()
def review() -> None:
    """See a proposed correction, question it, approve or reject it.

    \b
    Example:
        kincal review show out/paper/run.lcmlog
    """


@review.command("list")
@click.argument("logs", nargs=-1, type=click.Path(path_type=Path, exists=True, dir_okay=False))
@click.option("--live", is_flag=True, help="Also ask the flight process at --url what waits there.")
@URL
@TIMEOUT
@JOURNAL
def review_list(logs: tuple[Path, ...], live: bool, url: str, timeout_s: float, journal: Path) -> None:
    """List proposals in logs, what waits on board, and past decisions.

    \b
    Examples:
        kincal review list out/*/run.lcmlog
        kincal review list --live
    """
    from kincal import review as lib

    out = console()
    show.proposals(out, [lib.proposals_in(path) for path in logs])
    if live:
        with link.Link(url) as up:
            crc = lib.waiting(up, timeout_s)
        out.print(f"on board: correction {crc:08x} waits for review" if crc else "on board: nothing waits")
    show.decisions(out, lib.check_journal(journal), journal)


@review.command("show")
@click.argument("file", type=click.Path(path_type=Path, exists=True, dir_okay=False))
@click.option("--crc", default=None, help="Which proposal of the log, by CRC.  [default: the last]")
@click.option(
    "--picture", type=PATH, default=None, help="Where to write the picture.  [default: next to the log]"
)
@TABLES
def review_show(file: Path, crc: str | None, picture: Path | None, tables_dir: Path) -> None:
    """Show a proposal of a log with all its numbers and a picture.

    \b
    Example:
        kincal review show out/paper/run.lcmlog --crc 1a2b3c4d
    """
    from kincal import review as lib

    found = lib.find(file, crc, tables_dir)
    picture = picture or file.with_name(f"review-{found.crc_text}.png")
    lib.save_picture(found, picture)
    show.review(console(), found, lib.worries(found), picture)


@review.command("approve")
@click.argument("crc")
@BY
@WHY
@click.option(
    "--log",
    "log_file",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    default=None,
    help="Log with the proposal; its numbers go into the record.",
)
@URL
@TIMEOUT
@JOURNAL
@TABLES
def review_approve(
    crc: str,
    by: str,
    why: str,
    log_file: Path | None,
    url: str,
    timeout_s: float,
    journal: Path,
    tables_dir: Path,
) -> None:
    """Approve the correction that waits on board: two commands bound to its CRC.

    \b
    Example:
        kincal review approve 1a2b3c4d --by "A. Reviewer" --why "residuals clean, rank full"
    """
    from kincal import review as lib

    found = lib.find(log_file, crc, tables_dir) if log_file else None
    with link.Link(url) as up:
        lib.decide(up, "approve", crc, by, why, journal, found, timeout_s, say=click.echo)


@review.command("reject")
@click.argument("crc")
@BY
@WHY
@click.option(
    "--log",
    "log_file",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    default=None,
    help="Log with the proposal; its numbers go into the record.",
)
@URL
@TIMEOUT
@JOURNAL
@TABLES
def review_reject(
    crc: str,
    by: str,
    why: str,
    log_file: Path | None,
    url: str,
    timeout_s: float,
    journal: Path,
    tables_dir: Path,
) -> None:
    """Reject the correction that waits on board; the table in force stays.

    \b
    Example:
        kincal review reject 1a2b3c4d --by "A. Reviewer" --why "pose 7 looks blurred"
    """
    from kincal import review as lib

    found = lib.find(log_file, crc, tables_dir) if log_file else None
    with link.Link(url) as up:
        lib.decide(up, "reject", crc, by, why, journal, found, timeout_s, say=click.echo)


main.add_command(model)

if __name__ == "__main__":
    main()
