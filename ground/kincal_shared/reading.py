"""Files that are read: regular ones, and pipes that somebody writes into."""

from __future__ import annotations

import io
import os
import select
import stat
from pathlib import Path

from kincal_shared.errors import BadInput

_PATIENCE_MS = 2000  # for somebody who is about to write into a pipe
_MOST_BYTES = 1 << 28  # from a pipe, which may have no end
_BLOCK = 1 << 16


def file_bytes(path: Path) -> bytes:
    """Content of a file or pipe. BadInput for a device, or a pipe that nobody writes into or that has no
    end; OSError if it cannot be read."""
    mode = path.stat().st_mode
    if stat.S_ISFIFO(mode):
        return _of_pipe(path)
    _refuse_device(path, mode)
    return path.read_bytes()


def refuse_stream(path: Path, why: str) -> None:
    """BadInput for what is neither a file nor a folder; why: what a pipe is not good for."""
    mode = path.stat().st_mode
    if stat.S_ISFIFO(mode):
        raise BadInput(f"this is a pipe, but {why}", str(path), "write it to a file, and name that")
    _refuse_device(path, mode)


def _refuse_device(path: Path, mode: int) -> None:
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise BadInput("this is a device, a file is needed", str(path), "name a file")


def _of_pipe(path: Path) -> bytes:
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    with io.FileIO(handle) as pipe:
        poll = select.poll()
        poll.register(pipe, select.POLLIN)
        came = poll.poll(_PATIENCE_MS)
        block = pipe.read(_BLOCK)  # None: somebody has it open and has written nothing yet
        if block == b"" and not came:
            raise BadInput("this is a pipe that nobody writes into", str(path), "name a file")
        os.set_blocking(handle, True)
        data = block or b""
        while block is None or block:
            block = pipe.read(_BLOCK) or b""
            data += block
            if len(data) > _MOST_BYTES:
                most = _MOST_BYTES >> 20
                raise BadInput(f"up to {most} MiB are read from a pipe", str(path), "name a file")
    return data
