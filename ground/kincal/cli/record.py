"""`kincal record`: everything on the link, in LCM's log format."""

from __future__ import annotations

import json
import math
import os
import signal
import threading
from dataclasses import asdict
from pathlib import Path

import click

from kincal.cli.options import PATH
from kincal.cli.wire import URL
from kincal_shared.errors import CommandFailed


@click.command()
@URL
@click.option(
    "--folder", type=PATH, default=None, show_default="~/.kincal/recordings", help="Where files go."
)
@click.option("--name", default="", show_default="address and port", help="What file names begin with.")
@click.option(
    "--megabytes",
    type=click.FloatRange(0.01, 1e6),
    default=256.0,
    show_default=True,
    help="Of a file; then the next.",
)
@click.option(
    "--keep", type=click.IntRange(0), default=0, show_default="all", help="Files of this recording to keep."
)
@click.option(
    "--frames",
    default="1",
    show_default=True,
    metavar="SECONDS",
    help="Keep at most one frame of the camera in so many seconds; 0: all, none: none.",
)
@click.option("--seconds", type=float, default=None, show_default="until Ctrl-C", help="How long.")
@click.option("--quiet", is_flag=True, help="Say only what goes wrong.")
@click.option("--json", "as_json", is_flag=True, help="Say how it stands as JSON, a line each time.")
@click.option("--attached", is_flag=True, help="End when standard input ends: with whoever started it.")
def record(
    url: str,
    folder: Path | None,
    name: str,
    megabytes: float,
    keep: int,
    frames: str,
    seconds: float | None,
    quiet: bool,
    as_json: bool,
    attached: bool,
) -> None:
    """Record every message of the link, until Ctrl-C or SIGTERM.

    The files are what `kincal log`, `kincal review`, the workbench and `kincal serve --log` read. Frames of
    the camera (KC_IMAGE, where they are transmitted) have up to 120 kB each. A full disk ends nothing: what
    cannot be written is counted and said, and recording goes on when there is space. Exit status 1 if
    messages were lost.

    \b
    Example:
        kincal record --folder recordings
    """
    from kincal.operate.recording import FOLDER, Recorded, Recorder, stem_of
    from kincal.operate.recording import record as run

    if name and not name.replace("-", "").replace("_", "").isalnum():
        raise click.BadParameter("letters, digits, - and _ only", param_hint="--name")
    if math.isnan(megabytes):
        raise click.BadParameter("this is no number", param_hint="--megabytes")
    stem, frame_s = name or stem_of(url), _frame_s(frames)
    recorder = Recorder(folder or FOLDER, stem, int(megabytes * 2**20), keep, frame_s)
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    if seconds is not None:
        threading.Timer(seconds, ended.set).start()

    if attached:
        threading.Thread(target=_until_input_ends, args=(ended,), daemon=True).start()

    def say(r: Recorded) -> None:
        if as_json:
            click.echo(json.dumps(asdict(r), default=str))
        elif r.trouble:
            click.echo(f"NOT RECORDED: {r.trouble}; {r.n_lost} messages lost so far", err=True)
        elif not quiet:
            click.echo(f"{r.file or 'waiting for the first message'}: {r.n_messages} messages, "
                       f"{r.n_bytes / 2**20:.1f} MB, {r.n_lost} lost")  # fmt: skip

    done = run(url, recorder, ended.is_set, say)
    say(done)
    if done.n_lost:
        raise CommandFailed(
            f"{done.n_lost} messages were not recorded",
            str(recorder.folder),
            "free space there, or record to another medium by --folder; a smaller --frames takes less",
        )


def _frame_s(text: str) -> float:
    try:
        value = math.inf if text == "none" else float(text)
    except ValueError:
        value = math.nan
    if not value >= 0.0:
        raise click.BadParameter("seconds, 0 or none", param_hint="--frames")
    return value


def _until_input_ends(ended: threading.Event) -> None:
    # not by sys.stdin: a thread that waits with its lock keeps the interpreter from ending
    while os.read(0, 4096):
        pass
    ended.set()
