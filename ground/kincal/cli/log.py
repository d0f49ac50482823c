"""`kincal log`: what was said on the wire."""

from __future__ import annotations

import json
from pathlib import Path

import click

from kincal.cli.options import FILE
from kincal.cli.terminal import console
from kincal.cli.text import log as text


@click.command()
@click.argument("file", type=FILE)
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
@click.option("--debug", is_flag=True, help="Also list debug events.")
def log(file: Path, as_json: bool, debug: bool) -> None:
    """Summarise an LCM log: messages, sessions, poses, events, proposals.

    \b
    Example:
        kincal log out/paper/run.lcmlog
    """
    from kincal.link import read_log

    summary = read_log(file)
    if as_json:
        click.echo(json.dumps(summary.as_dict(), indent=1))
    else:
        text.show(console(), summary, debug)
