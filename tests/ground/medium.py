"""A medium that is full."""

import os
import resource
import signal
import sys
from contextlib import contextmanager


@contextmanager
def full_medium(room_bytes=100):
    """No file grows beyond so many bytes: writing more raises OSError. No bytecode is written meanwhile, nor
    by children: Python keeps what had room of it, and fails when it loads that (EOFError)."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    bytecode, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
    resource.setrlimit(resource.RLIMIT_FSIZE, (room_bytes, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        del os.environ["PYTHONDONTWRITEBYTECODE"]
        sys.dont_write_bytecode = bytecode
        signal.signal(signal.SIGXFSZ, ignored)
