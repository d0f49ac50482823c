"""`kincal bridge`: flight's telemetry for other ground systems, live."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import click

from kincal.cli.wire import APID, URL

if TYPE_CHECKING:
    from kincal.spacepackets.bridge import Forwarded

_REPORT_S = 10.0


@click.group()
def bridge() -> None:
    """Send flight's telemetry to other ground systems.

    \b
    Example:
        kincal bridge ccsds
    """


@bridge.command("ccsds")
@URL
@APID
@click.option("--to", "target", default="127.0.0.1:10015", show_default=True, help="Receiver, HOST:PORT.")
@click.option(
    "--seconds", type=click.FloatRange(min=0.0), help="Stop after this time.  [default: with Ctrl-C]"
)
def bridge_ccsds(url: str, first_apid: int, target: str, seconds: float | None) -> None:
    """Send telemetry as CCSDS space packets over UDP, one in each datagram.

    Packets hold the LCM messages unchanged; `kincal export xtce` describes them. Nothing goes the other
    way: a ground system cannot command flight through the bridge. A datagram can get lost on the way; the
    sequence count shows it. Every 10 s a line says how many packets were sent.

    \b
    Example:
        kincal bridge ccsds --to 127.0.0.1:10015
    """
    from kincal.spacepackets.bridge import address, forward

    to = address(target)
    began = shown = time.monotonic()
    click.echo(f"telemetry of {url} goes to {target}; Ctrl-C ends it")

    def go_on(done: Forwarded) -> bool:
        nonlocal shown
        now = time.monotonic()
        if now - shown >= _REPORT_S:
            shown = now
            click.echo(_line(done))
        return seconds is None or now - began < seconds

    click.echo(_line(forward(url, to, go_on, first_apid)))


def _line(done: Forwarded) -> str:
    counts = ", ".join(f"{name} {n}" for name, n in sorted(done.packets.items())) or "no telemetry yet"
    said = [f"{done.packets.total()} packets ({counts})"]
    if done.damaged:
        said.append(f"{done.damaged} damaged messages left out")
    if done.refused:
        said.append(f"{done.refused} packets not sent: {done.why}")
    return "; ".join(said)
