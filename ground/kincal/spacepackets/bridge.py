"""From LCM to a ground system: every telemetry message, as one UDP datagram with one space packet."""

from __future__ import annotations

import socket
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

from kincal.link import Link
from kincal_shared.errors import BadInput

from .packets import APIDS, DEFAULT_APID, Packer, check_apid

DEFAULT_TARGET = "127.0.0.1:10015"
_WAIT_S = 0.2


@dataclass
class Forwarded:
    """What was sent: packets by channel, messages that were damaged, packets that the network refused."""

    packets: Counter[str] = field(default_factory=Counter)
    damaged: int = 0
    refused: int = 0
    why: str = ""  # the newest refusal


def address(target: str) -> tuple[str, int]:
    """Host and port of "HOST:PORT", or "[IPv6]:PORT". BadInput if it is neither, or no such host is known."""
    host, _, port = target.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise BadInput(f"'{target}' is no address", "--to", f"write HOST:PORT, for instance {DEFAULT_TARGET}")
    try:
        socket.getaddrinfo(host, int(port), type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "this is no name"
        raise BadInput(f"host '{host[:100]}': {why or error}", "--to", "check the name") from None
    return host, int(port)


def forward(
    url: str,
    target: tuple[str, int],
    go_on: Callable[[Forwarded], bool],
    first_apid: int = DEFAULT_APID,
) -> Forwarded:
    """Send telemetry on until go_on, asked at least five times a second, answers False.

    url: LCM network; target: host and port; first_apid: as in the XTCE database. The bridge never publishes
    to LCM, so nothing goes from the ground system to flight. BadInput if LCM or the identifiers cannot be
    used."""
    check_apid(first_apid)
    packer, done = Packer(first_apid), Forwarded()
    family = socket.getaddrinfo(*target, type=socket.SOCK_DGRAM)[0][0]
    with Link(url, tuple(APIDS)) as link, socket.socket(family, socket.SOCK_DGRAM) as out:
        while go_on(done):
            received = link.next(_WAIT_S)
            done.damaged = link.bad_messages
            if received is None:
                continue
            try:
                out.sendto(packer.packet(received.channel, received.message.encode()), target)
            except OSError as error:  # nobody routes there now: telemetry goes on, the next one may pass
                done.refused += 1
                done.why = str(error)
            else:
                done.packets[received.channel] += 1
    return done
