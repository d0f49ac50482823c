"""`kincal key`: the key file that signs commands."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import click

from kincal.cli.options import PATH
from kincal_shared import keys


@click.group()
def key() -> None:
    """Make, rotate and show the keys that sign commands to flight.

    Flight reads the key file when it starts (kincal-fsw --keys FILE) and takes commands signed with any of
    its keys: one or two of each holder. `kincal` and the executive sign with the first. Copy the file by a
    way that nobody else can read; each machine keeps its own counters beside it.

    \b
    Example:
        kincal key new
    """


def _verb(act: Callable[[Path], str]) -> Callable[[Path], str]:
    """Make `kincal key NAME` of a function that acts on the key file and returns what to say of it."""
    name = act.__name__.removeprefix("key_")

    def command(file: Path | None) -> None:
        path = keys.file_of(file)
        click.echo(f"{path}: {act(path)}")
        if name == "show":
            for k in keys.read(path):
                click.echo(f"  key {k.id}: fingerprint {k.fingerprint}")

    command.__doc__ = f"""{act.__doc__}

    Without FILE: the file of ${keys.VARIABLE}, else {keys.DEFAULT}.

    \b
    Example:
        kincal key {name}
    """
    file = click.argument("file", type=PATH, required=False)
    key.command(name)(file(command))
    return act


@key.command("new")
@click.argument("file", type=PATH, required=False)
@click.option("--holder", type=click.IntRange(0), default=0, show_default=True, help="Number of the person.")
def key_new(file: Path | None, holder: int) -> None:
    """Make a key file with one key.

    Without FILE: the file of $KINCAL_KEYS, else ~/.kincal/keys. Where CONFIG asks for two persons
    (go_by_other_key), each has a file of his own: --holder 0 makes key 1 (its rotations: 2, 3, ... 99),
    --holder 1 makes key 101, and so on. Flight gets both files in one: `kincal key join`.

    \b
    Examples:
        kincal key new
        kincal key new second.keys --holder 1
    """
    path = keys.file_of(file)
    made = keys.new(path, holder)
    click.echo(f"{path}: key {made.id}; start kincal-fsw with --keys and this file")


@key.command("join")
@click.argument("files", nargs=-1, type=PATH, required=True)
@click.option("-o", "--out", type=PATH, required=True, help="Key file for flight.")
def key_join(files: tuple[Path, ...], out: Path) -> None:
    """Make the key file of flight from those of several holders.

    Who audits checks a journal of several holders with such a file too. Nobody should sign with it: whoever
    holds it can sign for each of them.

    \b
    Example:
        kincal key join first.keys second.keys -o flight.keys
    """
    joined = keys.join(out, files)
    n = len({keys.holder(k.id) for k in joined})
    click.echo(f"{out}: keys {', '.join(str(k.id) for k in joined)} of {n} holder{'s' if n > 1 else ''}; "
               "start kincal-fsw with --keys and this file")  # fmt: skip


@_verb
def key_rotate(path: Path) -> str:
    """Add a new key; the old one signs until `kincal key retire`.

    Give the file to flight and to all senders, and start flight again: it takes both keys then."""
    made = keys.rotate(path)
    return f"key {made.id} added; copy the file, start flight again, then `kincal key retire`"


@_verb
def key_retire(path: Path) -> str:
    """Take the old key out; the new one signs from now on.

    Give the file to all senders, then to flight, and start flight again: it refuses the old key then."""
    gone = keys.retire(path)
    return f"key {gone.id} is gone, key {keys.read(path)[0].id} signs; copy the file, start flight again"


@_verb
def key_show(path: Path) -> str:
    """Check a key file and list its keys: numbers and fingerprints, not the secrets. Files hold the same key
    if number and fingerprint are the same: each `kincal key new` makes a key 1."""
    signs, *others = keys.read(path)
    mine = keys.holder(signs.id)
    text = f"key {signs.id} signs"
    for k in others:
        text += f", key {k.id} is " + ("new" if keys.holder(k.id) == mine else "another holder's")
    return text
