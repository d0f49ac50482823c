"""LCM for the simulator's processes: decodes what is heard and counts what is published."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import lcm

import kcm
from kincal_shared.schema.channels import CHANNELS

TYPES: dict[str, Any] = {channel.name: getattr(kcm, channel.type) for channel in CHANNELS}


class Bus:
    """An LCM connection. n_published: messages sent; n_rx_errors: messages that could not be decoded."""

    def __init__(self, url: str):
        self.lcm = lcm.LCM(url)
        self.n_published = 0
        self.n_rx_errors = 0
        self._subscriptions: list[Any] = []

    def listen(self, channel: str, handler: Callable[[str, Any], None]) -> None:
        """Call handler(channel, message) for every message; undecodable ones are only counted."""

        def on(ch: str, data: bytes) -> None:
            try:
                message = TYPES[channel].decode(data)
            except (ValueError, struct.error) as e:
                self.n_rx_errors += 1
                print(f"{ch}: message dropped: {e}", flush=True)
                return
            handler(ch, message)

        # LCM's own queue of 30 drops what a slow reader misses; nothing may be dropped here.
        subscription = self.lcm.subscribe(channel, on)
        subscription.set_queue_capacity(0)
        self._subscriptions.append(subscription)

    def close(self) -> None:
        """Listen no more. The LCM object holds its handlers, and they often hold it: Python cannot free such
        a circle, and its sockets would stay open."""
        for subscription in self._subscriptions:
            self.lcm.unsubscribe(subscription)
        self._subscriptions.clear()

    def publish(self, channel: str, message: Any) -> None:
        """Send a message of the class in TYPES."""
        self.lcm.publish(channel, message.encode())
        self.n_published += 1

    def wait(self, seconds: float) -> bool:
        """Handle one message, waiting at most this long. False if none came."""
        return bool(self.lcm.handle_timeout(max(0, int(seconds * 1000))))
