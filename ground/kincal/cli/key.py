"""`kincal key`: the key file that signs commands."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from kincal import keys
from kincal.cli.options import PATH

Command = TypeVar("Command", bound=Callable[..., Any])


def _file(command: Command) -> Command:
    shown = f"${keys.VARIABLE}, else {keys.DEFAULT}"
    argument = click.argument("file", type=PATH, required=False, envvar=keys.VARIABLE, metavar="[FILE]")
    command.__doc__ = (command.__doc__ or "").replace("FILE_DEFAULT", f"FILE: {shown} unless it is given.")
    return argument(command)


@click.group()
def key() -> None:
    """Make, rotate and show the keys that sign commands to flight.

    Flight reads the key file when it starts (kincal-fsw --keys FILE) and takes commands signed with any of
    its one or two keys. `kincal` and the executive sign with the first. Copy the file by a way that nobody
    else can read; each machine keeps its own counters beside it.

    \b
    Example:
        kincal key new
    """


@key.command("new")
@_file
def key_new(file: Path | None) -> None:
    """Make a key file with one key.

    FILE_DEFAULT

    \b
    Example:
        kincal key new ~/.kincal/keys
    """
    path = keys.file_of(file)
    made = keys.new(path)
    click.echo(f"{path}: key {made.id}; start kincal-fsw with --keys and this file")


@key.command("rotate")
@_file
def key_rotate(file: Path | None) -> None:
    """Add a new key; the old one signs until `kincal key retire`.

    Give the file to flight and to all senders, and start flight again: it takes both keys then.

    FILE_DEFAULT

    \b
    Example:
        kincal key rotate
    """
    path = keys.file_of(file)
    made = keys.rotate(path)
    click.echo(f"{path}: key {made.id} added; copy the file, start flight again, then `kincal key retire`")


@key.command("retire")
@_file
def key_retire(file: Path | None) -> None:
    """Take the old key out; the new one signs from now on.

    Give the file to all senders, then to flight, and start flight again: it refuses the old key then.

    FILE_DEFAULT

    \b
    Example:
        kincal key retire
    """
    path = keys.file_of(file)
    gone = keys.retire(path)
    click.echo(
        f"{path}: key {gone.id} is gone, key {keys.read(path)[0].id} signs; copy the file, start flight again"
    )


@key.command("show")
@_file
def key_show(file: Path | None) -> None:
    """Check a key file and list the numbers of its keys, not the keys.

    FILE_DEFAULT

    \b
    Example:
        kincal key show
    """
    path = keys.file_of(file)
    signs, *others = keys.read(path)
    click.echo(f"{path}: key {signs.id} signs" + "".join(f", key {k.id} is new" for k in others))
