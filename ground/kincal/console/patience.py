"""How many connections without a request there may be, and how long one may last.

A program without the token can still connect. One that opens connections and sends nothing, or never the end
of a request, would keep every file descriptor of the console, and ABORT with it."""

from __future__ import annotations

import asyncio
import resource
import time

from uvicorn.protocols.http.h11_impl import H11Protocol

HEAD_S = 3.0
"""From the connection to the end of the head of its first request; a refused request ends its connection."""
MOST = 300
"""Connections at once; beyond, the oldest without a request makes room."""
_FILES = 1024


class Patient(H11Protocol):
    """Ends a connection that brings no request in time, or is in the way of others."""

    since_s = 0.0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """See uvicorn."""
        self.since_s = time.monotonic()
        super().connection_made(transport)
        asyncio.get_running_loop().call_later(HEAD_S, self._end_idle)
        if len(self.connections) > MOST:
            idle = [one for one in self.connections if isinstance(one, Patient) and one.idle]
            min(idle, key=lambda one: one.since_s, default=self).transport.abort()

    @property
    def idle(self) -> bool:
        """Whether it has brought no request so far. A WebSocket has a protocol of its own."""
        own = self.cycle is None and self.transport.get_protocol() is self
        return own and not self.transport.is_closing()

    def _end_idle(self) -> None:
        if self.idle:
            self.transport.abort()


def few_files() -> None:
    """No more open files than LCM can wait for: by select(), which writes beyond its memory for a descriptor
    from 1024 on. Shells and containers often allow many more."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft > _FILES:
        resource.setrlimit(resource.RLIMIT_NOFILE, (_FILES, hard))
