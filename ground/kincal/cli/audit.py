"""`kincal audit`: the journal of a mission, and whether it is whole."""

from __future__ import annotations

from pathlib import Path

import click

from kincal.cli.options import FILE
from kincal.cli.review import JOURNAL
from kincal.cli.terminal import console, say
from kincal.cli.text import review as text
from kincal.cli.wire import KEYS
from kincal.review import journal as journals
from kincal_shared.errors import CommandFailed


@click.group()
def audit() -> None:
    """The journal of a mission: who has seen, attempted, decided, commanded, asked what.

    \b
    Example:
        kincal audit verify
    """


@audit.command("log")
@KEYS
@JOURNAL
def audit_log(key_file: Path, journal: Path | None) -> None:
    """List all lines of the journal.

    \b
    Example:
        kincal audit log
    """
    from kincal.api.reviews import read_journals

    for one in read_journals((), journal, key_file):
        text.decisions(console(), one)


@audit.command("verify")
@click.argument("logs", nargs=-1, type=FILE)
@click.option(
    "--noted",
    default="",
    metavar="LINES:HASH",
    help="What an earlier `verify` said: the journal still has to hold it.",
)
@KEYS
@JOURNAL
def audit_verify(logs: tuple[Path, ...], noted: str, key_file: Path, journal: Path | None) -> None:
    """Check the journal, of itself, against its end mark, and against logs.

    Every line has to follow from the one before and to be written with its key, the journal has to end where
    its end mark says, and every decision that flight took in these logs has to be there. Names the line that
    was changed, removed or appended. With logs, the journals beside them too.

    It prints where the journal ends (lines and a hash). Note that elsewhere: with --noted, a journal that was
    put back to an earlier state together with its end mark is noticed too.

    \b
    Examples:
    kincal audit verify
    kincal audit verify out/paper/run.lcmlog
    """
    from kincal.api.reviews import absent, read_journals

    found = read_journals(logs, journal, key_file)
    if noted:
        journals.check_noted(found[0], noted)
    for one in found:
        decided = sum(entry.decision not in journals.SAID for entry in one.entries)
        say(f"{one.path}: {decided} decisions and commands in {len(one.entries)} lines, {one.vouched}")
        say(f"{one.path}: ends at {journals.end_text(one)}")
    missing = absent(logs, found)
    text.absent(console(), missing)
    if missing or any(one.unconfirmed for one in found):
        raise CommandFailed("the journal is not what it should be", todo="see above; keep your copies of it")
