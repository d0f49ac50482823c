"""The processes of a run: the simulator's launcher as a child, which starts and stops all others."""

from __future__ import annotations

import json
import subprocess
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from kincal_shared import installation
from kincal_shared.errors import CommandFailed

from .request import Request

STOP_WAIT_S = 15.0
LOGS = "look into logs/ of that directory"


class Processes:
    """A running launcher; use as a context, so that nothing outlives an interruption.

    url: LCM network of the run; keys: file whose key it takes commands with. BadInput if this installation
    lacks something that a run needs, CommandFailed if the launcher does not start."""

    def __init__(self, request: Request) -> None:
        _check_installation(request)
        from kincal_sim import outputs  # only now is it known to be there

        self._alone = ExitStack()
        self._alone.enter_context(outputs.alone(request.out))
        # stderr to a file: a full pipe must not stop the launcher
        self._errors = (request.out / outputs.ERRORS).open("w+", encoding="utf-8")
        self.child = subprocess.Popen(
            request.command(), stdout=subprocess.PIPE, stderr=self._errors, text=True
        )
        self.url, self.keys = self._read_first(request.scenario)

    def _read_first(self, scenario: str) -> tuple[str, Path]:
        """The launcher's first line names the LCM network and the key file."""
        first = self.child.stdout.readline() if self.child.stdout else ""
        try:
            facts = json.loads(first)
            return str(facts["url"]), Path(facts["keys"])
        except (ValueError, KeyError):
            self.child.wait()
            what = f"the scenario did not start: {self.errors() or first.strip()}"
            raise CommandFailed(what, scenario, "`make` builds what is missing") from None

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, *_exc: object) -> None:
        if self.running():
            self.child.terminate()  # the launcher stops all it started
            try:
                self.child.wait(STOP_WAIT_S)
            except subprocess.TimeoutExpired:
                self.child.kill()
        if self.child.stdout:
            self.child.stdout.close()
        self._errors.close()
        self._alone.close()

    def running(self) -> bool:
        """Whether the launcher still runs."""
        return self.child.poll() is None

    def errors(self) -> str:
        """What the launcher wrote to stderr."""
        self._errors.flush()
        self._errors.seek(0)
        return self._errors.read().strip()


def _check_installation(request: Request) -> None:
    installation.simulator()
    installation.built("kincal-fsw")
    if request.mode == "pixels":
        installation.built("kincal-tagdet")


def read_json(path: Path) -> dict[str, Any]:
    """A file that a run leaves. CommandFailed if it is missing or no JSON."""
    try:
        return dict(json.loads(path.read_text("utf-8")))
    except (OSError, ValueError) as error:
        raise CommandFailed(f"the run left no {path.name}: {error}", str(path.parent), LOGS) from None
