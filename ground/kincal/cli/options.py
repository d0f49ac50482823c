"""Options that several commands share; those of commands that talk to flight are in wire.py."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from kincal_shared import installation

Command = TypeVar("Command", bound=Callable[..., Any])

PATH = click.Path(path_type=Path)
FILE = click.Path(path_type=Path, exists=True, dir_okay=False)
EXISTS = click.Path(path_type=Path, exists=True)


def tables_option(what: str) -> Callable[[Command], Command]:
    """`--tables`: the folder tables/bin below the current one, else the tables that came with kincal."""
    return click.option(
        "--tables",
        "tables_dir",
        type=PATH,
        default=lambda: installation.file("tables/bin"),
        show_default="tables/bin, else as shipped",
        help=what,
    )


TABLES = tables_option("Directory with built table images.")
DESCRIPTION = click.option(
    "--description",
    type=FILE,
    default=lambda: installation.file("tables/src/space.toml"),
    show_default="tables/src/space.toml, else as shipped",
    help="What the table was built from.",
)
PROCESSES = click.option(
    "--processes",
    type=click.IntRange(1, 64),
    default=2,
    show_default=True,
    help="Processes to share the work; the result does not depend on it.",
)
