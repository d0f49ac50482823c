"""Table images from any source, search spaces included."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from kincal import tables
from kincal.link import write_image

if TYPE_CHECKING:
    from kincal.flight.tables import Image, Table


def build(source: Path, tables_dir: Path | None = None) -> Image:
    """Image of any TOML source; a search space is built for the arm and camera tables of `tables_dir` (as
    default tables/bin beside tables/src)."""
    if tables.source_kind(source) != "space":
        return tables.build(source)
    from kincal import space

    images = tables_dir or source.resolve().parent.parent / "bin"
    return space.build(space.read_description(source), images).image


def build_files(source: Path, out: Path, tables_dir: Path | None = None) -> Iterator[tuple[Path, Image]]:
    """Images of a source, or of every source in a folder, each written as soon as it is built."""
    if source.is_dir():
        pairs = [(p, out / f"{p.stem}.tbl") for p in tables.build_order(sorted(source.glob("*.toml")))]
    else:
        pairs = [(source, out)]
    for src, dst in pairs:
        image = build(src, tables_dir or dst.parent)
        write_image(image, dst)
        yield dst, image


def load(file: Path) -> tuple[Image, Table]:
    """Image and contents of a table, or of a source as it would be built."""
    return tables.load(file, build)


def check(file: Path, tables_dir: Path | None = None) -> tuple[Image, str]:
    """Image of a table that flight takes, and what it was compared with, in words: TERMS with SPACE of
    `tables_dir` (as default that of the file). BadInput if flight would refuse it."""
    image, struct = load(file)
    return image, tables.compared(image, struct, tables_dir or file.parent)
