"""Records all messages of a link in LCM's log format, whatever happens to the medium.

Files are named by the time of their first message, and a new one begins when one is full. When the medium is
full, messages are counted as lost and the file is cut back to its last whole message; as soon as there is
space again, recording goes on in a new file. Old files are deleted only where the caller says how many are
kept."""

from __future__ import annotations

import datetime
import errno
import math
import os
import re
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from queue import Empty, Full, Queue
from typing import TYPE_CHECKING, cast

import lcm

from kincal.link import channels
from kincal.link.connection import open_lcm
from kincal.link.eventfile import SYNC, EventFile
from kincal_shared.errors import BadInput

from .snapshot import EventLine, event_of, utc_text

if TYPE_CHECKING:
    from kincal.link.messages import Event

FOLDER = Path("~/.kincal/recordings")
SUFFIX = ".lcmlog"
FRAMES = "KC_IMAGE"
MOST_BYTES = 256 * 2**20
"""Of a file, as shipped."""
RETRY_S = 5.0  # before a full medium is tried again
_HEADER = struct.Struct(">4sqqii")
_TAIL_BYTES = 4 * 2**20  # that are looked through for the last events
_QUEUE = 20_000  # messages that wait for a slow medium
_SYNC_S = 1.0  # between two fsyncs: what a power cut loses


@dataclass(frozen=True)
class Recorded:
    """How a recording stands. file: the present one; trouble: why nothing is written, "" if all is well."""

    file: Path | None
    n_files: int
    n_messages: int
    n_bytes: int
    n_lost: int
    trouble: str


class Recorder:
    """Writes messages to files in a folder; `take` never raises for what the medium does. most_files: 0 keeps
    all; frame_s: of the camera's frames at most one in so many seconds is kept, 0: all, inf: none.

    BadInput if the folder cannot be made or written when it begins."""

    def __init__(
        self,
        folder: Path,
        stem: str = "link",
        most_bytes: int = MOST_BYTES,
        most_files: int = 0,
        frame_s: float = 0.0,
    ) -> None:
        self.folder, self.stem = folder.expanduser(), stem
        self.most_bytes, self.most_files, self.frame_s = most_bytes, most_files, frame_s
        self._frame_due_s = 0.0 if math.isfinite(frame_s) else math.inf
        self.files: list[Path] = []
        self.n_messages = self.n_lost = self.n_bytes = 0
        self.trouble = ""
        self._file: FileIO | None = None
        self._size = self._number = 0
        self._unchecked = 0  # messages since the file was last seen to be there
        self._retry_s = self._sync_s = 0.0
        try:
            self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            probe = self.folder / f".{stem}.{os.getpid()}"
            probe.touch()
            probe.unlink()
        except OSError as error:
            raise BadInput(
                f"nothing can be recorded there: {error.strerror}", str(self.folder), "name another folder"
            ) from None

    def take(self, channel: str, data: bytes, utc_us: int, now_s: float) -> None:
        """One message; utc_us: when it was received [us since 1970]; now_s: a clock that only goes
        forward."""
        if channel == FRAMES:
            if now_s < self._frame_due_s:
                return
            self._frame_due_s = now_s + self.frame_s
        name = channel.encode("utf-8", "replace")
        record = _HEADER.pack(SYNC, self._number, utc_us, len(name), len(data)) + name + data
        if self.trouble and now_s < self._retry_s:
            self.n_lost += 1
            return
        try:
            if self._file is None or self._size + len(record) > self.most_bytes:
                self._begin(utc_us)
            self._write(record)
        except OSError as error:
            self._failed(error, now_s)
            return
        self.trouble = ""
        self._number += 1
        self.n_messages += 1
        self.n_bytes += len(record)
        self._unchecked += 1
        if now_s - self._sync_s > _SYNC_S and self._file is not None:
            self._sync_s = now_s
            try:
                self._check_there()
                _synced(self._file)
            except OSError as error:
                self._failed(error, now_s)
            else:
                self._unchecked = 0

    def _check_there(self) -> None:
        """What is written into a file that somebody has removed, or moved to another medium, is lost."""
        path, file = self.files[-1], self._file
        if file is not None and not (
            path.exists() and os.path.samestat(path.stat(), os.fstat(file.fileno()))
        ):
            self.n_lost += self._unchecked - 1  # `_failed` counts one
            raise OSError(errno.ENOENT, f"{path.name} was removed while it was written")

    def _begin(self, utc_us: int) -> None:
        self._end()
        stamp = datetime.datetime.fromtimestamp(utc_us * 1e-6, datetime.UTC).strftime("%Y%m%dT%H%M%S%f")[:-3]
        self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        path = self.folder / f"{self.stem}-{stamp}Z{SUFFIX}"
        for n in range(1, 1000):
            if not os.path.lexists(path):
                break
            path = self.folder / f"{self.stem}-{stamp}Z-{n}{SUFFIX}"
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
        self._file, self._size = FileIO(handle, "w"), 0
        self.files.append(path)
        while self.most_files and len(self.files) > self.most_files:
            self.files.pop(0).unlink(missing_ok=True)

    def _write(self, record: bytes) -> None:
        file = self._file
        if file is None:
            return
        written = 0
        while written < len(record):
            n = file.write(record[written:])
            if not n:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            written += n
        self._size += len(record)

    def _failed(self, error: OSError, now_s: float) -> None:
        """Only whole messages stay; the next try is a new file."""
        self.n_lost += 1
        self._retry_s = now_s + RETRY_S
        self.trouble = f"{error.strerror}: {self.folder}"
        self._end(self._size)

    def _end(self, size: int | None = None) -> None:
        if self._file is None:
            return
        file, self._file = self._file, None
        try:
            if size is not None:
                file.truncate(size)
            _synced(file)
        except OSError:
            pass
        finally:
            file.close()
        if size == 0 and self.files:  # nothing whole in it
            self.files.pop().unlink(missing_ok=True)

    def close(self) -> None:
        """End the file."""
        self._end()

    @property
    def state(self) -> Recorded:
        """How it stands."""
        file = self.files[-1] if self.files else None
        return Recorded(file, len(self.files), self.n_messages, self.n_bytes, self.n_lost, self.trouble)


def _synced(file: FileIO) -> None:
    os.fsync(file.fileno())


class Tap:
    """All messages of a network, received in a thread of its own, so that a slow medium delays nobody."""

    def __init__(self, url: str) -> None:
        self.url, self.n_lost = url, 0
        self._queue: Queue[tuple[str, bytes, int]] = Queue(_QUEUE)
        self._lcm: lcm.LCM = open_lcm(url)
        self._lcm.subscribe(".*", self._received).set_queue_capacity(0)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._loop, daemon=True)
        self._thread.start()

    def _received(self, channel: str, data: bytes) -> None:
        try:
            self._queue.put_nowait((channel, data, time.time_ns() // 1000))
        except Full:
            self.n_lost += 1

    def _loop(self) -> None:
        while not self._stop.is_set():
            self._lcm.handle_timeout(100)

    def next(self, timeout_s: float) -> tuple[str, bytes, int] | None:
        """The next message: channel, bytes, time of reception [us since 1970]."""
        try:
            return self._queue.get(timeout=timeout_s)
        except Empty:
            return None

    def close(self) -> None:
        """Stop receiving."""
        self._stop.set()
        self._thread.join(timeout=2.0)


def record(
    url: str,
    recorder: Recorder,
    stop: Callable[[], bool],
    say: Callable[[Recorded], None],
    say_every_s: float = 10.0,
) -> Recorded:
    """Record a link until `stop`; `say` hears how it stands, at once when trouble begins or ends."""
    tap = Tap(url)
    due_s, trouble = 0.0, ""
    try:
        while not stop():
            if (received := tap.next(0.2)) is not None:
                recorder.take(*received, time.monotonic())
            if time.monotonic() >= due_s or recorder.trouble != trouble:
                due_s, trouble = time.monotonic() + say_every_s, recorder.trouble
                say(recorder.state)
    finally:
        tap.close()
        while (received := tap.next(0.0)) is not None:
            recorder.take(*received, time.monotonic())
        recorder.n_lost += tap.n_lost
        recorder.close()
    return recorder.state


def spawn(url: str, folder: Path | None = None) -> subprocess.Popen[bytes]:
    """`kincal record` as a process of its own. It is stopped by SIGTERM, and ends in good order with whoever
    asked for it, however that ended: its standard input ends then."""
    command = [sys.executable, "-m", "kincal", "record", "--url", url, "--quiet", "--attached"]
    if folder is not None:
        command += ["--folder", str(folder)]
    return subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True)


def stem_of(url: str) -> str:
    """What names of recordings of a link begin with: flights on other networks are not mixed up."""
    return re.sub(r"[^0-9A-Za-z.]+", "-", url.partition("?")[0].rpartition("/")[2]).strip("-.") or "link"


def recordings(folder: Path | None = None, url: str = "") -> list[Path]:
    """Files of a folder of recordings, of a link if it is named, the newest first."""
    where = (folder or FOLDER).expanduser()
    begin = f"{stem_of(url)}-" if url else ""
    found = []
    for path in where.glob(f"*{SUFFIX}"):
        with suppress(OSError):  # a link that leads nowhere, or removed just now
            if path.name.startswith(begin) and path.is_file():
                found.append((path.stat().st_mtime, path))
    return [path for _, path in sorted(found, reverse=True)]


def recent_events(url: str, n: int, folder: Path | None = None) -> list[EventLine]:
    """The last events of the newest recording of a link, but those for debugging; the newest last. Empty if
    there is none."""
    for file in recordings(folder, url)[:1]:
        skip = frozenset(channels.BY_NAME) - {"KC_EVENT"}
        found = []
        for event in EventFile(file, skip, max(file.stat().st_size - _TAIL_BYTES, 0)):
            if event.channel == "KC_EVENT":
                try:
                    message = channels.decode(event.channel, event.data)
                except Exception:  # noqa: BLE001, S112 generated decoders raise anything
                    continue
                found.append(event_of(cast("Event", message), utc_text(event.utc_us * 1e-6)))
        return [e for e in found if e.severity != "debug"][-n:]
    return []
