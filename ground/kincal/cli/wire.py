"""Options of the commands that talk to the flight process."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict, TypeVar

import click

from kincal import link
from kincal.cli.options import PATH
from kincal.cli.outputs import FILE_OUT
from kincal.cli.terminal import say
from kincal.review import journal as journals
from kincal_shared import keys

if TYPE_CHECKING:
    from kincal.review.decisions import Operator

F = TypeVar("F", bound=Callable[..., Any])

URL = click.option(
    "--url",
    default=link.DEFAULT_URL,
    show_default=True,
    envvar="KINCAL_URL",
    help="LCM URL of the flight process.",
)
KEYS = click.option(
    "--keys",
    "key_file",
    type=PATH,
    default=keys.DEFAULT,
    show_default=True,
    envvar=keys.VARIABLE,
    help="Key file; its first key signs what is sent.",
)
TIMEOUT = click.option(
    "--timeout",
    "timeout_s",
    type=float,
    default=10.0,
    show_default=True,
    help="Seconds to wait for each answer.",
)
APID = click.option(
    "--apid",
    "first_apid",
    type=int,
    default=1000,
    show_default=True,
    help="CCSDS application process identifier before the first channel's.",
)
JOURNAL = click.option(
    "--journal",
    type=PATH,
    default=None,
    show_default=f"{journals.NAME} beside the key file",
    envvar=journals.VARIABLE,
    help="Append-only record of decisions.",
)
_BY = click.option(
    "--by",
    default=lambda: os.environ.get("USER", "operator"),
    show_default="$USER",
    help="Who commands, for the record.",
)
_WHY = click.option("--why", default="operator's command", help="Reason, for the record.")


class Recorded(TypedDict):
    """What every command is given that sends something signed: where to, with which key, and for the journal
    who and why."""

    by: str
    why: str
    url: str
    key_file: Path
    timeout_s: float
    journal: Path | None


def recorded(function: F) -> F:
    """Options of every command that sends something signed."""
    for option in (JOURNAL, TIMEOUT, KEYS, URL, _WHY, _BY):
        function = option(function)
    return function


def operator(given: Recorded) -> Operator:
    """Who commands. BadInput if the journal cannot be kept there."""
    from kincal.review.decisions import Operator

    journal = FILE_OUT.convert(journals.place(given["journal"], keys.file_of(given["key_file"])), None, None)
    return Operator(given["by"], given["why"], journal, given["timeout_s"], lambda said: say(said, err=True))
