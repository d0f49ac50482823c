"""What a restarted console has to know: corrections, poses, events and acknowledgements.

They are appended to a file as they come, one file for each network. It is an LCM log, bounded: when it is
full it becomes the former one, and two are read at the start. A medium that is full ends the keeping, never
the console."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING

from kincal.link import channels
from kincal.link.eventfile import EventFile, event_bytes
from kincal_shared.errors import KincalError

from .picture import Picture

if TYPE_CHECKING:
    from kincal.link.messages import LcmMessage

KEPT = frozenset({"KC_PROPOSAL", "KC_PROGRESS", "KC_MEAS", "KC_EVENT", "KC_ACK"})
MOST_BYTES = 8 << 20
_AGAIN_US = 5_000_000  # the same message within this time came once


class Memory:
    """folder: of the files; url: of the network. trouble: why nothing is kept any more, in words."""

    def __init__(self, folder: Path, url: str) -> None:
        name = hashlib.sha256(url.encode()).hexdigest()[:12]
        self.path = folder.expanduser() / f"heard-{name}.lcmlog"
        self.former = self.path.with_suffix(".former.lcmlog")
        self.trouble = ""
        self._number = 0

    def recall(self, picture: Picture) -> int:
        """Everything kept, into a picture; returns how many messages. What is damaged is passed over, and
        what several consoles have kept of the same counts once."""
        found, known = 0, dict[bytes, int]()
        for path in (self.former, self.path):
            if not path.is_file():
                continue
            for event in EventFile(path):
                digest = hashlib.sha256(event.channel.encode() + event.data).digest()[:12]
                again = event.utc_us - known.get(digest, -_AGAIN_US) < _AGAIN_US
                if event.channel not in KEPT or again:
                    continue
                known[digest] = event.utc_us
                try:
                    message = channels.decode(event.channel, event.data)
                except KincalError:
                    raise
                except Exception:  # noqa: BLE001, S112 decoders raise anything
                    continue
                picture.add(event.channel, message, event.utc_us * 1e-6)
                found += 1
        return found

    def keep(self, channel: str, message: LcmMessage, received_s: float) -> None:
        """One message more, if it is of those that are kept."""
        if channel not in KEPT or self.trouble:
            return
        self._number += 1
        whole = event_bytes(self._number, int(received_s * 1e6), channel, message.encode())
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            if self.path.is_file() and self.path.stat().st_size > MOST_BYTES:
                self.path.replace(self.former)
            with self.path.open("ab") as file:
                file.write(whole)
        except OSError as error:
            self.trouble = f"{self.path}: {error.strerror}"
