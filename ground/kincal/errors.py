"""Errors for people: what is wrong, where, and what to do about it."""

from __future__ import annotations

import click

EXIT_FAILED = 1  # the work was done and its answer is no
EXIT_INPUT = 2  # what was given cannot be used
EXIT_DATA = 3  # the input is fine, but the data do not determine the answer


class KincalError(click.ClickException):
    """Bad input. Renders as three short lines and ends the command with status 2."""

    exit_code = EXIT_INPUT

    def __init__(self, what: str, where: str = "", todo: str = "") -> None:
        lines = [what]
        if where:
            lines.append(f"  where: {where}")
        if todo:
            lines.append(f"  to do: {todo}")
        super().__init__("\n".join(lines))
        self.what, self.where, self.todo = what, where, todo


class KincalFailed(KincalError):
    """The command worked but the answer is a failure (gates missed, refused, timed out)."""

    exit_code = EXIT_FAILED


class BadInput(KincalError):
    """Something given to the workbench is wrong: says what, where and what to do."""


class CannotAnswer(KincalError):
    """The input is fine, but the data do not determine the answer (too few poses, a singular design)."""

    exit_code = EXIT_DATA
