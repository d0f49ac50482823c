"""The LCM log of a run."""

from __future__ import annotations

import struct
import threading
import time
from pathlib import Path

import lcm

import kcm

QUIET_S = 0.2  # the log is complete when nothing came for so long
ALL = "KC_.*"
ALL_BUT_IMAGES = "KC_(?!IMAGE).*"


class Recorder:
    """Writes what is on the bus to an LCM log, in a thread. Times are mission time.

    url: LCM network; path: the log, overwritten; images: log the frames too.
    n_rx_errors: packets on KC_TIME that are no time_t.
    """

    def __init__(self, url: str, path: Path, images: bool):
        self._lcm = lcm.LCM(url)
        self._log = lcm.EventLog(str(path), "w", overwrite=True)
        self._lcm.subscribe(ALL if images else ALL_BUT_IMAGES, self._on_message).set_queue_capacity(0)
        self._now_us = 0
        self.n_rx_errors = 0
        self._last_heard = time.monotonic()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> None:
        """Begin to record."""
        self._thread.start()

    def close(self) -> None:
        """Take in what is still on its way, then close the file."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        self._log.close()

    def _run(self) -> None:
        while not self._stop.is_set() or time.monotonic() - self._last_heard < QUIET_S:
            self._lcm.handle_timeout(100)

    def _take_time(self, data: bytes) -> None:
        """A packet that is no time_t is logged like any other, and changes no time: an exception would end
        the thread, and the log with it."""
        try:
            self._now_us = kcm.time_t.decode(data).now_us
        except (ValueError, struct.error):
            self.n_rx_errors += 1

    def _on_message(self, channel: str, data: bytes) -> None:
        self._last_heard = time.monotonic()
        if channel == "KC_TIME":
            self._take_time(data)
        self._log.write_event(self._now_us or time.time_ns() // 1000, channel, data)
