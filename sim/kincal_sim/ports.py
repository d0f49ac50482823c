"""LCM networks of their own for runs side by side."""

from __future__ import annotations

import random
import socket

GROUP = "239.255.76.67"
PORTS = range(20000, 32000)
RECEIVE_BYTES = 4 << 20  # asked for; the kernel gives what it allows


class NoFreePort(RuntimeError):
    """All ports of the range are in use."""


def private_port() -> tuple[int, socket.socket]:
    """A port that nobody uses for LCM, and the socket that reserves it while it stays open.

    Multicast receivers share ports, so a TCP socket on the same number serves as the lock between
    launches, and an exclusive UDP bind shows whether anything else listens there. Raises NoFreePort.
    """
    first = random.SystemRandom().randrange(len(PORTS))
    for k in range(len(PORTS)):
        port = PORTS[(first + k) % len(PORTS)]
        lock = _reserve(port)
        if lock is not None:
            return port, lock
    raise NoFreePort(f"no free port in {PORTS.start}..{PORTS.stop}")


def _reserve(port: int) -> socket.socket | None:
    lock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        lock.bind(("127.0.0.1", port))
        lock.listen(1)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("", port))
        return lock
    except OSError:
        lock.close()
        return None


def private_url(port: int) -> str:
    """LCM URL of a network on this machine."""
    return f"udpm://{GROUP}:{port}?ttl=0&recv_buf_size={RECEIVE_BYTES}"
