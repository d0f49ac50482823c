"""Options of the commands that talk to the flight process."""

from __future__ import annotations

import click

from kincal import link
from kincal.cli.options import PATH
from kincal_shared import keys

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
