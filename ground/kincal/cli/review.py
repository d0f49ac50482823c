"""`kincal review`: see a proposed correction, question it, approve or reject it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypedDict, TypeVar, Unpack

import click

from kincal import link
from kincal.cli.options import FILE, PATH, TABLES
from kincal.cli.outputs import FILE_OUT, PICTURE
from kincal.cli.provenance import say_files, table_crcs, today
from kincal.cli.terminal import console
from kincal.cli.text import review as text
from kincal.cli.wire import KEYS, TIMEOUT, URL
from kincal.errors import CommandFailed
from kincal.keys import file_of, signer_of
from kincal.keys import read as read_keys
from kincal.review import journal as journals
from kincal.review.journal import Journal

JOURNAL = click.option(
    "--journal",
    type=PATH,
    default=None,
    show_default=f"{journals.NAME} beside the key file",
    envvar=journals.VARIABLE,
    help="Append-only record of decisions.",
)
BY = click.option("--by", required=True, help="Who decides.")
WHY = click.option("--why", required=True, help="Reason, for the record.")
LOG = click.option(
    "--log",
    "log_file",
    type=FILE,
    default=None,
    help="Log with the proposal; its numbers go into the record.",
)
Command = TypeVar("Command", bound=Callable[..., Any])


@click.group()
def review() -> None:
    """See a proposed correction, question it, approve or reject it.

    \b
    Example:
        kincal review show out/paper/run.lcmlog
    """


@review.command("list")
@click.argument("logs", nargs=-1, type=FILE)
@click.option("--live", is_flag=True, help="Also ask the flight process at --url what waits there.")
@URL
@TIMEOUT
@KEYS
@JOURNAL
def review_list(
    logs: tuple[Path, ...], live: bool, url: str, timeout_s: float, key_file: Path, journal: Path | None
) -> None:
    """List proposals in logs, what waits on board, and past decisions.

    Decisions are those of the journal and of the journals beside the logs.

    \b
    Examples:
        kincal review list out/*/run.lcmlog
        kincal review list --live
    """
    from kincal import review as lib

    out = console()
    text.proposals(out, [lib.proposals_in(path) for path in logs])
    if live:
        with link.Link(url) as up:
            crc = lib.waiting(up, timeout_s)
        out.print(f"on board: correction {crc:08x} waits for review" if crc else "on board: nothing waits")
    found = _journals(logs, journal, key_file)
    for one in found:
        text.decisions(out, one)
    text.absent(out, _absent(logs, found))


def _journals(logs: Sequence[Path], journal: Path | None, key_file: Path) -> list[Journal]:
    """The journal, and those beside the logs, each checked with its keys."""
    file = file_of(key_file)
    mine = journals.read(journals.place(journal, file), read_keys(file) if file.exists() else ())
    of_runs = {found.path: found for log in logs if (found := journals.of_run(log))}
    return [mine, *(found for path, found in of_runs.items() if path != mine.path)]


def _absent(logs: Sequence[Path], found: Sequence[Journal]) -> list[str]:
    return [f"{log}: {text}" for log in logs for text in journals.absent(found, link.read_log(log))]


@review.command("verify")
@click.argument("logs", nargs=-1, type=FILE)
@KEYS
@JOURNAL
def review_verify(logs: tuple[Path, ...], key_file: Path, journal: Path | None) -> None:
    """Check the journal of decisions, of itself and against logs.

    Every line has to follow from the one before and to be written with its key, and every decision that
    flight took in these logs has to be there. Names the line that is wrong or missing. With logs, the
    journals beside them too.

    \b
    Examples:
        kincal review verify
        kincal review verify out/paper/run.lcmlog
    """
    found = _journals(logs, journal, key_file)
    for one in found:
        click.echo(f"{one.path}: {len(one.entries)} decisions, {one.vouched}")
    missing = _absent(logs, found)
    text.absent(console(), missing)
    if missing or any(one.unconfirmed for one in found):
        raise CommandFailed("the journal is not what it should be", todo="see above; keep your copies of it")


@review.command("show")
@click.argument("file", type=FILE)
@click.option("--crc", default=None, help="Which proposal of the log, by CRC.  [default: the last]")
@click.option(
    "--picture",
    type=PICTURE,
    default=None,
    help="Picture to write (.png or .svg); the page (.html) lies beside it.  [default: next to the log]",
)
@TABLES
@KEYS
@JOURNAL
def review_show(
    file: Path, crc: str | None, picture: Path | None, tables_dir: Path, key_file: Path, journal: Path | None
) -> None:
    """Show a proposal of a log with all its numbers and their thresholds, what became of it, and which poses
    were rejected: as text, as a page (HTML) and as a picture.

    \b
    Example:
        kincal review show out/paper/run.lcmlog --crc 1a2b3c4d
    """
    from kincal import review as lib
    from kincal.pages import review as pages
    from kincal.pages.page import Provenance
    from kincal.review.status import status
    from kincal.review.thresholds import read_limits

    found, limits = lib.find(file, crc, tables_dir), read_limits(tables_dir)
    read = _journals((file,), journal, key_file)
    about = status(link.read_log(file), found, [entry for one in read for entry in one.entries])
    picture = picture or file.with_name(f"review-{found.crc_text}.png")
    warnings = lib.warnings(found)
    text.show(console(), found, warnings, about, limits)
    text.absent(console(), _absent((file,), read))
    provenance = Provenance.of_file(today(), file, tables=table_crcs(tables_dir, ("terms",)))
    say_files("page", *pages.write_all(found, warnings, picture, provenance, about, limits))


class Decision(TypedDict):
    """What approve and reject are given besides the CRC."""

    by: str
    why: str
    log_file: Path | None
    url: str
    key_file: Path
    timeout_s: float
    journal: Path | None
    tables_dir: Path


def decision_options(command: Command) -> Command:
    """Options of approve and reject."""
    for option in (TABLES, JOURNAL, TIMEOUT, KEYS, URL, LOG, WHY, BY, click.argument("crc")):
        command = option(command)
    return command


@review.command("approve")
@decision_options
def review_approve(crc: str, **given: Unpack[Decision]) -> None:
    """Approve the correction that waits on board: two commands bound to its CRC.

    \b
    Example:
        kincal review approve 1a2b3c4d --by "A. Reviewer" --why "residuals clean, rank full"
    """
    _decide("approve", crc, given)


@review.command("reject")
@decision_options
def review_reject(crc: str, **given: Unpack[Decision]) -> None:
    """Reject the correction that waits on board; the table in force stays.

    \b
    Example:
        kincal review reject 1a2b3c4d --by "A. Reviewer" --why "pose 7 looks blurred"
    """
    _decide("reject", crc, given)


def _decide(decision: str, crc: str, given: Decision) -> None:
    """Send a decision and record it, with the numbers of the proposal where the log is given."""
    from kincal import review as lib

    found = lib.find(given["log_file"], crc, given["tables_dir"]) if given["log_file"] else None
    by, why, timeout_s, keys = given["by"], given["why"], given["timeout_s"], file_of(given["key_file"])
    journal = FILE_OUT.convert(journals.place(given["journal"], keys), None, None)
    with link.Link(given["url"], signer=signer_of(keys)) as up:
        lib.decide(up, decision, crc, by, why, journal, found, timeout_s, say=click.echo)
