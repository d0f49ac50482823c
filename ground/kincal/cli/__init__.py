"""The `kincal` command. Every command is a short call into the library; one module a group."""

from __future__ import annotations

import atexit
import gc
import os
from collections.abc import Iterator, MutableMapping
from importlib import import_module

import click

# The workbench handles thousands of small matrices: threads inside the linear algebra only get in each
# other's way (five times slower). Has to be said before numpy is loaded; the user's own setting wins.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
# Nothing here draws with MuJoCo, which looks for a back end to do it when it is loaded.
os.environ.setdefault("MUJOCO_GL", "disable")

# What a command holds goes with its process: a search for cycles at the end takes as long as many commands
# run. While packages are loaded, hardly anything becomes garbage.
atexit.register(gc.freeze)
gc.set_threshold(50_000)

from kincal import __version__  # noqa: E402
from kincal.cli.errors import Commands  # noqa: E402


class _Groups(MutableMapping[str, click.Command]):
    """The groups by name, each loaded when it is asked for: no command waits for what another one needs."""

    def __init__(self, *names: str) -> None:
        self._found: dict[str, click.Command | None] = dict.fromkeys(names)

    def __getitem__(self, name: str) -> click.Command:
        found = self._found[name] or getattr(import_module(f"kincal.cli.{name}"), name)
        self._found[name] = found
        return found

    def __setitem__(self, name: str, command: click.Command) -> None:
        self._found[name] = command

    def __delitem__(self, name: str) -> None:
        del self._found[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._found)

    def __len__(self) -> int:
        return len(self._found)


@click.group(
    cls=Commands,
    commands=_Groups(
        *("arm", "audit", "bridge", "campaign", "command", "export", "key", "log", "model", "record"),
        *("review", "run", "schema", "serve", "space", "status", "table"),
    ),
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(__version__)
def main() -> None:
    """Ground side of KinCal: make tables and search spaces, run calibrations, read logs, review
    corrections, find what the arm model lacks.

    \b
    Exit status: 0 good, 1 the work was done and the answer is no, 2 bad input, 3 the data cannot answer,
    130 interrupted.

    \b
    Example:
        kincal run paper --fast
    """
