"""Events of an LCM log file, whatever the file holds.

LCM's own reader takes each length as it stands in the file: one of 2 GiB ends the process, a channel that is
no text ends the reading. Here a damaged place is counted and passed, up to where the next event begins."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import BinaryIO, NamedTuple

from kincal_shared.errors import BadInput

SYNC = bytes.fromhex("eda1da01")
_HEADER = struct.Struct(">4sqqii")  # sync word, number, time, bytes of the channel, bytes of the message
MOST_CHANNEL = 63
"""Bytes of the name of a channel, as LCM has it."""
MOST_BYTES = 1 << 26
"""Bytes of a message: many times the largest image."""
_AT_ONCE = 1 << 20  # bytes that are looked through for the next event


class FileEvent(NamedTuple):
    """An event of a file. channel: its printable name; data: the bytes of the message, as many as are wanted;
    utc_us: when it was recorded [us since 1970]; at: byte of the file at which it begins; number: that the
    recorder gave it; n_bytes: of the whole message."""

    channel: str
    data: bytes
    utc_us: int = 0
    at: int = 0
    number: int = 0
    n_bytes: int = 0


def event_bytes(number: int, utc_us: int, channel: str, data: bytes) -> bytes:
    """An event as it stands in a file."""
    name = channel.encode("ascii")
    return _HEADER.pack(SYNC, number, utc_us, len(name), len(data)) + name + data


@dataclass
class EventFile:
    """The events of a file, one after the other, up to where it ended when reading began: a recording grows.
    skip: channels whose messages are not read; start: byte to begin at, or after it where the first event
    there begins; heads: how many bytes are read, at most, of messages that are skipped; damaged: places of
    the file, so far, that hold no event. BadInput if the file cannot be read."""

    path: Path
    skip: frozenset[str] = frozenset()
    start: int = 0
    heads: Mapping[str, int] = field(default_factory=dict)
    damaged: int = field(default=0, init=False)

    def __iter__(self) -> Iterator[FileEvent]:
        if not self.path.is_file():
            raise BadInput(
                "no such log file",
                str(self.path),
                "recordings lie in ~/.kincal/recordings, logs of simulated runs in out/SCENARIO/run.lcmlog",
            )
        try:
            with self.path.open("rb") as file:
                yield from self._events(file, self.path.stat().st_size)
        except OSError as error:
            raise BadInput(
                f"cannot read the log: {error.strerror}",
                str(self.path),
                "see to its permissions and its medium",
            ) from None

    def _events(self, file: BinaryIO, size: int) -> Iterator[FileEvent]:
        # where the next event should begin; whether the one before it was one
        at, whole = max(_next_sync(file, self.start), 0) if self.start else 0, True
        file.seek(at)
        while at < size and len(header := file.read(_HEADER.size)) == _HEADER.size:
            sync, number, utc_us, n_channel, n_data = _HEADER.unpack(header)
            end = at + _HEADER.size + n_channel + n_data
            known = sync == SYNC and 0 < n_channel <= MOST_CHANNEL and 0 <= n_data <= MOST_BYTES
            if known and end <= size:
                channel = _printable(file.read(n_channel))
                wanted = min(self.heads.get(channel, 0), n_data) if channel in self.skip else n_data
                yield FileEvent(channel, file.read(wanted), utc_us, at, number, n_data)
                at, whole = end, True
            else:
                self.damaged += whole
                at, whole = _next_sync(file, at + 1), False
                if at < 0:
                    return
            file.seek(at)
        if at < size:
            self.damaged += whole  # cut off


def _next_sync(file: BinaryIO, start: int) -> int:
    """Where the next event may begin, at or after a place; -1 if none does."""
    file.seek(start)
    tail = b""
    while part := file.read(_AT_ONCE):
        window = tail + part
        if (found := window.find(SYNC)) >= 0:
            return file.tell() - len(window) + found
        tail = window[-len(SYNC) + 1 :]
    return -1


@lru_cache(maxsize=256)
def _printable(name: bytes) -> str:
    """The name of a channel; what is no printable ASCII as \\xff, so that a terminal only shows it."""
    return "".join(chr(b) if 32 <= b < 127 else f"\\x{b:02x}" for b in name)
