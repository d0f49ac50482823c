"""`kincal audit`: the journal of a mission, and whether it is whole."""

from __future__ import annotations

from pathlib import Path

import click

from kincal import link
from kincal.cli.options import FILE
from kincal.cli.terminal import console, say
from kincal.cli.text import review as text
from kincal.cli.wire import JOURNAL, KEYS, TIMEOUT, URL
from kincal.review import journal as journals
from kincal_shared.errors import CommandFailed
from kincal_shared.keys import file_of, signer_of


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
    from kincal.api.reviews import read_journals, refuse_broken

    found = read_journals((), journal, key_file, journals.inspect)
    for one in found:
        text.decisions(console(), one)
    refuse_broken(found)


@audit.command("verify")
@click.argument("logs", nargs=-1, type=FILE)
@click.option(
    "--noted",
    default="",
    metavar="LINES:HASH",
    help="What an earlier `verify` said: the journal still has to hold it.",
)
@click.option(
    "--live",
    is_flag=True,
    help="Of a journal without a line, also ask flight at --url whether it knows this key.",
)
@URL
@TIMEOUT
@KEYS
@JOURNAL
def audit_verify(
    logs: tuple[Path, ...],
    noted: str,
    live: bool,
    url: str,
    timeout_s: float,
    key_file: Path,
    journal: Path | None,
) -> None:
    """Check the journal, of itself, against its end mark, and against logs.

    Every line has to follow from the one before and to be written with its key, the journal has to end where
    its end mark says, and every decision that flight took in these logs has to be there. Names the line that
    was changed, removed or appended. With logs, the journals beside them too.

    It prints where the journal ends (lines and a hash). Note that elsewhere: with --noted, a journal that was
    put back to an earlier state together with its end mark is noticed too.

    A journal that was deleted, with its end mark, looks like that of a first start. With --live flight is
    asked: if it has accepted commands of this key, the journal is missing. The question is a NOOP with
    counter 1, which flight refuses: everybody on the network sees its error CMD_REPLAYED, and for counter 1
    `kincal` says that there is nothing to do. A journal with lines asks nothing.

    \b
    Examples:
    kincal audit verify
    kincal audit verify --live
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
    if live and not found[0].entries:
        _ask(found[0], url, timeout_s, key_file)
    missing = absent(logs, found)
    text.absent(console(), missing)
    if missing or any(one.unconfirmed for one in found):
        raise CommandFailed("the journal is not what it should be", todo="see above; keep your copies of it")


def _ask(journal: journals.Journal, url: str, timeout_s: float, key_file: Path) -> None:
    """CommandFailed if flight has accepted commands that should be in this journal."""
    from kincal.api import operate

    signer = signer_of(file_of(key_file))
    with link.Link(url, operate.LISTEN, signer=signer) as up:
        accepted = operate.accepted_counter(up, timeout_s)
    if why := journals.missing(journal, signer.key.id, accepted):
        raise CommandFailed(why, url, journals.MISSING_TODO)
    say(f"flight has accepted no command of key {signer.key.id} yet: a first start")
