"""What goes to the terminal: the console for results, and the one place that draws progress."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from kincal_shared.printable import printable

if TYPE_CHECKING:
    from rich.console import Console

PIPE_WIDTH = 140  # columns, where there is no terminal to ask


def console() -> Console:
    """Rich output on standard output; plain and wide when it does not go to a terminal. What is printed
    cannot command the terminal."""
    from rich.console import Console, ConsoleOptions, ConsoleRenderable, RenderHook, RenderResult
    from rich.segment import Segment

    class Shown:
        """A renderable without control characters of its own."""

        def __init__(self, inner: ConsoleRenderable) -> None:
            self.inner = inner

        def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
            for text, style, control in console.render(self.inner, options):
                yield Segment(text if control else printable(text), style, control)

    class Hook(RenderHook):
        def process_renderables(self, renderables: list[ConsoleRenderable]) -> list[ConsoleRenderable]:
            return [Shown(one) for one in renderables]

    out = Console(highlight=False)
    out = out if out.is_terminal else Console(highlight=False, width=PIPE_WIDTH)
    out.push_render_hook(Hook())
    return out


def say(text: str, err: bool = False) -> None:
    """A line that may hold names from elsewhere."""
    import click

    click.echo(printable(text), err=err)


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
