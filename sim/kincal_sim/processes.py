"""The processes of a run: started together, stopped together, and nobody else's touched."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from kincal_shared.installation import root

ROOT = root()
STOP_WAIT_S = 5.0  # for a process to end by itself or on request
TAIL_LINES = 15
PR_SET_PDEATHSIG = 1

_libc = ctypes.CDLL(None, use_errno=True)


def _die_with_parent() -> None:
    """Linux: no orphans, even if the launcher is killed."""
    _libc.prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)


def _environment() -> dict[str, str]:
    """Of a process that finds this Python first."""
    path = [str(Path(sys.executable).parent), os.environ.get("PATH", "")]
    return {**os.environ, "PYTHONUNBUFFERED": "1", "PATH": os.pathsep.join(path)}


class ProcessGroup:
    """Processes by name; what they print goes to logs/NAME.out and logs/NAME.err."""

    def __init__(self, logs: Path):
        self.logs = logs
        self.processes: dict[str, subprocess.Popen] = {}

    def start(self, name: str, argv: Sequence) -> None:
        """Start a process. argv: command line, any objects that str() turns into words."""
        self.logs.mkdir(parents=True, exist_ok=True)
        with open(self.logs / f"{name}.out", "wb") as out, open(self.logs / f"{name}.err", "wb") as err:
            # A session of its own: ctrl-C reaches only the launcher, which then stops everybody in order.
            self.processes[name] = subprocess.Popen(
                [str(a) for a in argv],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                env=_environment(),
                start_new_session=True,
                preexec_fn=_die_with_parent,
            )

    def status(self, name: str) -> int | None:
        """Exit status, None while it runs."""
        return self.processes[name].poll()

    def wait(self, name: str, seconds: float) -> int | None:
        """Exit status, None if it still runs after these seconds."""
        try:
            return self.processes[name].wait(seconds)
        except subprocess.TimeoutExpired:
            return None

    def stop(self) -> None:
        """Ask all processes to end, and kill those that do not."""
        for process in self.processes.values():
            if process.poll() is None:
                process.terminate()
        deadline = time.monotonic() + STOP_WAIT_S
        for process in self.processes.values():
            try:
                process.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def tail(self, name: str) -> str:
        """The last lines that a process printed."""
        lines: list[str] = []
        for kind in ("out", "err"):
            path = self.logs / f"{name}.{kind}"
            if path.exists():
                lines += path.read_text(errors="replace").splitlines()[-TAIL_LINES:]
        return "\n".join(f"    {line}" for line in lines)
