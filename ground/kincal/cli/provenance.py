"""What the commands say about the origin of a page."""

from __future__ import annotations

import datetime
import os
from collections.abc import Iterable
from pathlib import Path

import click

TABLE_KINDS = ("arm", "camera", "terms", "kin", "space", "kernel", "config")


def today() -> str:
    """The day, ISO; SOURCE_DATE_EPOCH (seconds) names another one, so that a page can be made again."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    now = datetime.datetime.fromtimestamp(int(epoch), datetime.UTC) if epoch else datetime.datetime.now()
    return now.date().isoformat()


def table_crcs(directory: Path, kinds: Iterable[str] = TABLE_KINDS) -> dict[str, str]:
    """kind -> CRC of the table images that a directory holds."""
    from kincal import tables

    paths = {kind: directory / f"{kind}.tbl" for kind in kinds}
    return {kind: tables.load(path)[0].crc_text for kind, path in paths.items() if path.is_file()}


def say_files(what: str, files: list[Path], why_no_pictures: str, *, err: bool = False) -> None:
    """Name the page that was written, how many pictures lie beside it, and why there are none."""
    beside = f" ({len(files) - 1} pictures beside it)" if len(files) > 2 else ""
    names = f"{files[0]}{beside}" if beside or len(files) == 1 else f"{files[0]} and {files[1]}"
    click.echo(f"{what}: {names}", err=err)
    if why_no_pictures:
        click.echo(why_no_pictures, err=True)
