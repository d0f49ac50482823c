"""Where the console has its messages from: the live link, or a recording."""

from __future__ import annotations

import bisect
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from kincal.link import Link, Received, channels
from kincal.link.eventfile import EventFile
from kincal_shared.errors import BadInput, CommandFailed

from .geometry import Geometry
from .memory import Memory
from .picture import LISTEN, Picture, jpeg_of

_IMAGE = "KC_IMAGE"
_WAIT_S = 0.25


class Live:
    """Fills a picture from the network, in a thread of its own; memory: from which a later console goes on.
    Use as a context."""

    def __init__(self, url: str, picture: Picture, memory: Memory | None = None) -> None:
        self.url, self.picture, self.memory = url, picture, memory
        self._stop = threading.Event()
        self._link = Link(url, (*LISTEN, _IMAGE))
        self._thread = threading.Thread(target=self._run, name="console-live", daemon=True)

    def __enter__(self) -> Live:
        self._thread.start()
        return self

    def __exit__(self, *_exc: object) -> None:
        self._stop.set()
        self._thread.join(timeout=2.0)
        self._link.close()

    def _run(self) -> None:
        while not self._stop.is_set():
            received = self._link.next(_WAIT_S)
            if received is not None:
                now_s = self.picture.clock()
                self.picture.add(received.channel, received.message, now_s)
                if self.memory is not None:
                    self._keep(self.memory, received, now_s)

    def _keep(self, memory: Memory, received: Received, now_s: float) -> None:
        before = memory.trouble
        memory.keep(received.channel, received.message, now_s)
        if memory.trouble != before:
            self.picture.note("warning", "NOT_KEPT", f"nothing is kept for a restart: {memory.trouble}")


@dataclass(frozen=True)
class Frame:
    """A frame of the camera in a file, without the image: where it begins, and a number of its own."""

    t_us: int
    seq: int
    width_px: int
    height_px: int
    at: int
    key: int


@dataclass
class Recording:
    """A recording in memory: messages with their mission time, in the order in which they were written. The
    frames stay in the file."""

    path: Path
    messages: list[tuple[int, str, Any]] = field(default_factory=list)
    frames: list[Frame] = field(default_factory=list)

    @classmethod
    def read(cls, path: Path) -> Recording:
        """BadInput if the file holds nothing that a console shows."""
        out, t_us = cls(path), 0
        for event in EventFile(path):
            if event.channel not in (*LISTEN, _IMAGE):
                continue
            try:
                message: Any = channels.decode(event.channel, event.data)
            except CommandFailed:  # types that are not built are no damage
                raise
            except Exception:  # noqa: BLE001, S112 a damaged message is passed over; decoders raise anything
                continue
            t_us = max(t_us, getattr(message, "t_us", t_us))
            shown: Any = out._frame(message, event.at) if event.channel == _IMAGE else message
            out.messages.append((t_us, event.channel, shown))
        if not out.messages:
            raise BadInput("the recording holds no messages of flight", str(path), "give a log of a run")
        return out

    def _frame(self, image: Any, at: int) -> Frame:
        size = image.width_px, image.height_px
        self.frames.append(Frame(image.t_us, image.seq, *size, at, len(self.frames)))
        return self.frames[-1]

    def jpeg(self, key: int) -> bytes | None:
        """A frame by its own number, read from the file; None if there is none."""
        if not 0 <= key < len(self.frames):
            return None
        event = next(iter(EventFile(self.path, start=self.frames[key].at)), None)
        if event is None or event.channel != _IMAGE:
            return None
        try:
            return jpeg_of(channels.decode(event.channel, event.data))
        except Exception:  # noqa: BLE001 the file was changed; decoders raise anything
            return None

    @property
    def span_us(self) -> tuple[int, int]:
        """Mission time of the first and the last message."""
        return self.messages[0][0], self.messages[-1][0]


class Playback:
    """A recording as one browser sees it. Forward it goes on, backward it begins anew."""

    def __init__(self, recording: Recording, geometry: Geometry) -> None:
        self.recording, self.geometry = recording, geometry
        self._times = [t for t, _, _ in recording.messages]
        self._at = 0
        self.picture = Picture(geometry)

    def seek(self, t_us: int) -> Picture:
        """The picture at a mission time."""
        end = bisect.bisect_right(self._times, t_us)
        if end < self._at:
            self._at, self.picture = 0, Picture(self.geometry)
        for t, channel, message in self.recording.messages[self._at : end]:
            self.picture.add(channel, message, received_s=t * 1e-6)
        self._at = end
        return self.picture
