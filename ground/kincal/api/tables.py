"""Table images from any source, search spaces included."""

from __future__ import annotations

import shutil
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from kincal import tables
from kincal.link import write_image
from kincal_shared.errors import BadInput
from kincal_shared.writing import keep_inputs, write_files

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


def build_files(source: Path, out: Path, tables_dir: Path | None = None) -> list[tuple[Path, Image]]:
    """Images of a source, or of every source in a folder: all of them are written, or none."""
    if not source.is_dir():
        keep_inputs([out], [source])
        image = build(source, tables_dir or out.parent)
        write_image(image, out)
        return [(out, image)]
    sources = sorted(source.glob("*.toml"))
    if not sources:
        raise BadInput("no sources of tables (*.toml) here", str(source), "name a file, or their folder")
    built = {}
    with TemporaryDirectory() as name:  # what a search space needs of the others, before they are written
        beside = tables_dir or Path(name)
        if tables_dir is None:
            for path in out.glob("*.tbl"):
                shutil.copyfile(path, beside / path.name)
        for path in tables.build_order(sources):
            image = _build_beside(path, beside, tables_dir or out)
            built[out / f"{path.stem}.tbl"] = image
            if tables_dir is None:
                write_image(image, beside / f"{path.stem}.tbl")
    write_files({path: image.data for path, image in built.items()})
    return list(built.items())


def _build_beside(source: Path, beside: Path, called: Path) -> Image:
    """As `build`; an error names the folder as the user knows it."""
    try:
        return build(source, beside)
    except BadInput as error:
        if str(beside) not in error.where:
            raise
        raise BadInput(error.what, error.where.replace(str(beside), str(called)), error.todo) from None


def load(file: Path) -> tuple[Image, Table]:
    """Image and contents of a table, or of a source as it would be built."""
    return tables.load(file, build)


def check(file: Path, tables_dir: Path | None = None) -> tuple[Image, str]:
    """Image of a table that flight takes, and what it was compared with, in words: TERMS with SPACE of
    `tables_dir` (as default that of the file). BadInput if flight would refuse it."""
    image, struct = load(file)
    return image, tables.compared(image, struct, tables_dir or file.parent)
