"""`kincal table`: build, check, compare, uplink and dump tables."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Unpack

import click

from kincal import link
from kincal.cli.errors import EXIT_FAILED, EXIT_INPUT
from kincal.cli.options import EXISTS, PATH
from kincal.cli.outputs import FILE_OUT
from kincal.cli.terminal import console
from kincal.cli.text import table as text
from kincal.cli.wire import Recorded, operator, recorded
from kincal_shared.errors import KincalError
from kincal_shared.keys import file_of, signer_of


@click.group()
def table() -> None:
    """Build, check, compare, uplink and dump tables.

    \b
    Example:
        kincal table build tables/src tables/bin
    """


@table.command("build")
@click.argument("source", type=EXISTS)
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
    from kincal.api import tables

    for dst, image in tables.build_files(source, out, tables_dir):
        click.echo(f"{dst}: {image.kind}, {len(image.data)} bytes, CRC {image.crc_text}")


@table.command("show")
@click.argument("file", type=EXISTS)
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def table_show(file: Path, as_json: bool) -> None:
    """Print a table image (or a TOML source, as it would be built).

    \b
    Example:
        kincal table show tables/bin/arm.tbl
    """
    from kincal.api.tables import load
    from kincal.tables import readable

    image, struct = load(file)
    doc = readable(struct)
    if as_json:
        click.echo(
            json.dumps(
                {"kind": image.kind, "crc": image.crc_text, "fields": doc},
                indent=1,
                default=lambda b: b.hex(),
            )
        )
    else:
        text.show(console(), image, doc)


BESIDE = click.option(
    "--tables",
    "tables_dir",
    type=EXISTS,
    default=None,
    help="Directory with flight's tables: TERMS and SPACE are compared with each other.  "
    "[default: that of the file]",
)


@table.command("check")
@click.argument("files", nargs=-1, required=True, type=EXISTS)
@BESIDE
def table_check(files: tuple[Path, ...], tables_dir: Path | None) -> None:
    """Check tables as flight would; status 2 if any is refused.

    A TERMS table is also compared with the SPACE table that it flies with, and the other way round: the
    bounds of TERMS have to be within what SPACE was verified for, plus a tenth (docs/SPACES.md).

    \b
    Examples:
        kincal table check tables/bin/*.tbl
        kincal table check terms.tbl --tables tables/bin
    """
    from kincal.api.tables import check

    bad = 0
    for file in files:
        try:
            image, words = check(file, tables_dir)
            click.echo(f"ok    {file}: {image.kind}, CRC {image.crc_text}" + (f"; {words}" if words else ""))
        except KincalError as error:
            bad += 1
            click.echo(f"BAD   {file}: {error.what}", err=True)
    if bad:
        click.echo(f"{bad} of {len(files)} refused", err=True)
        raise SystemExit(EXIT_INPUT)


@table.command("diff")
@click.argument("a", type=EXISTS)
@click.argument("b", type=EXISTS)
def table_diff(a: Path, b: Path) -> None:
    """Print every field that differs between two tables; status 1 if any does.

    \b
    Example:
        kincal table diff tables/src/config.toml tables/bin/config.tbl
    """
    from kincal.api.tables import build
    from kincal.tables import diff

    image_a, image_b, changes = diff(a, b, build)
    text.diff(console(), image_a, image_b, changes)
    raise SystemExit(EXIT_FAILED if changes else 0)


@table.command("uplink")
@click.argument("file", type=EXISTS)
@recorded
@BESIDE
def table_uplink(file: Path, tables_dir: Path | None, **given: Unpack[Recorded]) -> None:
    """Send a table to flight: stage, validate, activate, and see its CRC in housekeeping.

    TERMS and SPACE are compared with each other before anything is sent, as by `kincal table check`. The
    attempt goes into the journal before the first byte is sent, and what came of it afterwards.

    \b
    Examples:
        kincal table uplink tables/bin/config.tbl
        kincal table uplink out/terms.tbl --by "A. Operator" --why "gravity sag of joint 2"
    """
    from kincal.api import operate
    from kincal.api.tables import check

    image, words = check(file, tables_dir)
    if words:
        click.echo(words)
    who = operator(given)
    with link.Link(given["url"], signer=signer_of(file_of(given["key_file"]))) as up:
        operate.uplink(up, image, who, given["timeout_s"])
    click.echo(f"{image.kind} table {image.crc_text} is active")


@table.command("dump")
@click.argument(
    "kind",
    type=click.Choice(["arm", "camera", "terms", "kin", "space", "kernel", "config"], case_sensitive=False),
)
@click.argument("out", type=FILE_OUT)
@recorded
def table_dump(kind: str, out: Path, **given: Unpack[Recorded]) -> None:
    """Bring down the table that is active on board. The command is signed, so that no stranger stops it, and
    goes into the journal as every other one.

    \b
    Example:
        kincal table dump kin out/kin.tbl
    """
    from kincal.api import operate

    who = operator(given)
    with link.Link(given["url"], signer=signer_of(file_of(given["key_file"]))) as down:
        image = operate.read_back(down, kind, who, given["timeout_s"])
    link.write_image(image, out)
    click.echo(f"{out}: {kind}, {len(image.data)} bytes, CRC {image.crc_text}")
