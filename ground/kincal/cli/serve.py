"""`kincal serve`: the operator's console."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from kincal.cli.options import FILE, PATH, TABLES
from kincal.cli.wire import JOURNAL, KEYS, TIMEOUT, URL
from kincal_shared import installation

if TYPE_CHECKING:
    from kincal.console.guard import Access


@click.command()
@click.option("--log", "log_file", type=FILE, default=None, help="Open a recording instead of the live link.")
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=8674,
    show_default=True,
    help="Port to listen on; 0: any free one.",
)
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    help="Address to listen on. Others than this machine's own are not encrypted.",
)
@click.option(
    "--name",
    "names",
    multiple=True,
    help="Further name by which browsers may call the console, for instance that of a tunnel.",
)
@click.option(
    "--folder",
    type=PATH,
    default=Path("~/.kincal/console"),
    show_default=True,
    help="What outlives the console: corrections and events heard, and the files of the workbench.",
)
@click.option(
    "--files",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    default=None,
    help="Further folder with arm tables and measurements for the workbench.",
)
@click.option(
    "--record/--no-record",
    default=True,
    help="Record the link as long as the console runs (kincal record).  [default: record]",
)
@click.option(
    "--recordings", type=PATH, default=None, show_default="~/.kincal/recordings", help="Where recordings go."
)
@click.option("--seconds", type=float, default=None, show_default="until Ctrl-C", help="How long.")
@URL
@TIMEOUT
@KEYS
@JOURNAL
@TABLES
def serve(
    log_file: Path | None,
    port: int,
    host: str,
    names: tuple[str, ...],
    folder: Path,
    files: Path | None,
    record: bool,
    recordings: Path | None,
    seconds: float | None,
    url: str,
    timeout_s: float,
    key_file: Path,
    journal: Path | None,
    tables_dir: Path,
) -> None:
    """Open the operator's console in a browser: see flight work, review corrections, decide, abort.

    Prints the address to open, with a token that is valid until the console is stopped (Ctrl-C). Only
    browsers of this machine reach it. Everything that it does, the commands of kincal do too.

    \b
    Examples:
        kincal serve --keys ~/.kincal/keys
        kincal serve --log out/paper/run.lcmlog
    """
    installation.require("console", "the console")
    from kincal.console.serve import Options, serve

    def ready(access: Access) -> None:
        click.echo(f"console of {log_file or url}, Ctrl-C ends it. Open:\n{access.start}")

    serve(
        Options(
            url,
            tables_dir,
            key_file,
            journal,
            log_file,
            host,
            port,
            names,
            timeout_s,
            folder,
            files,
            record,
            recordings,
            seconds,
        ),
        ready,
    )
