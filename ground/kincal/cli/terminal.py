"""What goes to the terminal: the console for results, and the one place that draws progress."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

PIPE_WIDTH = 140  # columns, where there is no terminal to ask


def console() -> Console:
    """Rich output on standard output; plain and wide when it does not go to a terminal."""
    from rich.console import Console

    out = Console(highlight=False)
    return out if out.is_terminal else Console(highlight=False, width=PIPE_WIDTH)


@contextmanager
def progress() -> Iterator[Callable[[str, int, int], None]]:
    """Yields progress(what, done, of) for the library to call: a bar on a terminal, nothing in a pipe.

    The bar goes to standard error and vanishes in the end, so that results stay clean."""
    if not sys.stderr.isatty():
        yield _nothing
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=1)
        yield lambda what, done, of: bar.update(task, description=what, completed=done, total=of)


def _nothing(_what: str, _done: int, _of: int) -> None:
    """Progress that nobody sees."""
