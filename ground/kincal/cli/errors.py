"""How a command ends: the one place where errors become an exit status."""

from __future__ import annotations

import contextlib
import sys
from typing import Any

import click

from kincal.cli.terminal import say
from kincal_shared.errors import BadInput, CannotAnswer, CommandFailed, KincalError
from kincal_shared.installation import extra_of
from kincal_shared.writing import WHAT_TO_DO, cannot_write

EXIT_FAILED = 1  # the work was done and its answer is no
EXIT_INPUT = 2  # what was given cannot be used
EXIT_DATA = 3  # the input is fine, but the data do not determine the answer
EXIT_INTERRUPTED = 130  # as a shell reports SIGINT


def exit_status(error: KincalError) -> int:
    """Exit status of a command that ends with this error."""
    if isinstance(error, CommandFailed):
        return EXIT_FAILED
    if isinstance(error, CannotAnswer):
        return EXIT_DATA
    return EXIT_INPUT


def _missing_module(module: str, extra: str) -> BadInput:
    """What to install, for a module that this installation came without."""
    if extra:
        todo = f"pip install 'kincal[{extra}]'"
    else:
        todo = "install liblcm-bin (lcm-gen), then kincal anew: it holds the messages then"
    return BadInput(f"this command needs the Python package {module}", todo=todo)


def _of_the_system(error: OSError) -> BadInput | None:
    """What to report of a file, or standard output, that the system refused; None if the error is
    of something else."""
    if error.errno in WHAT_TO_DO:
        return cannot_write(error.filename or "standard output", error)
    if error.filename is None:
        return None
    return BadInput(f"cannot be read or written: {error.strerror}", str(error.filename), "name another place")


def _close_output() -> None:
    """Drop what standard output still holds: Python would try to write it again at the end."""
    with contextlib.suppress(OSError, ValueError):
        sys.stdout.close()


class Commands(click.Group):
    """The group of all commands. Library errors and Ctrl-C end a command with their exit status, not with
    a traceback."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; end it with the exit status of what went wrong."""
        try:
            return super().invoke(ctx)
        except KincalError as error:
            say(f"Error: {error}", err=True)
            ctx.exit(exit_status(error))
        except ModuleNotFoundError as error:
            extra = extra_of(error.name or "")
            if not extra and error.name != "kcm":
                raise
            click.echo(f"Error: {_missing_module(error.name or '', extra)}", err=True)
            ctx.exit(EXIT_INPUT)
        except OSError as error:
            if (known := _of_the_system(error)) is None:
                raise
            say(f"Error: {known}", err=True)
            if error.filename is None:
                _close_output()
            ctx.exit(EXIT_INPUT)
        except KeyboardInterrupt:
            click.echo("interrupted", err=True)
            ctx.exit(EXIT_INTERRUPTED)
