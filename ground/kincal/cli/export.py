"""`kincal export`: descriptions of flight's telemetry for other ground systems."""

from __future__ import annotations

from pathlib import Path

import click

from kincal.cli.outputs import OutputFile
from kincal.cli.wire import APID


@click.group()
def export() -> None:
    """Describe flight's telemetry for other ground systems.

    \b
    Example:
        kincal export xtce -o kincal.xml
    """


@export.command("xtce")
@APID
@click.option("-o", "--out", type=OutputFile(".xml"), help="Write this file.  [default: standard output]")
def export_xtce(first_apid: int, out: Path | None) -> None:
    """Write an XTCE 1.2 database of the telemetry packets.

    It names every field of the packets that `kincal bridge ccsds` sends, with unit, meaning, names of
    states and events, and alarm limits. Yamcs and other systems load it.

    \b
    Example:
        kincal export xtce -o kincal.xml
    """
    from kincal.spacepackets.database import xtce
    from kincal_shared.writing import write_file

    text = xtce(first_apid)
    if out is None:
        click.echo(text, nl=False)
    else:
        write_file(out, text)
        click.echo(f"{out}: XTCE 1.2, identifiers from {first_apid}")
