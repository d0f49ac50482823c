"""Errors for people: what is wrong, where, and what to do about it.

Plain exceptions: the library raises them, `kincal.cli` turns them into an exit status."""

from __future__ import annotations


class KincalError(Exception):
    """Something that the caller can do something about.

    what: one line, what is wrong. where: file, key path, URL or line; may be empty. todo: what to do
    about it; may be empty. str() gives them as up to three lines.
    """

    def __init__(self, what: str, where: str = "", todo: str = "") -> None:
        self.what, self.where, self.todo = what, where, todo
        super().__init__(what, where, todo)

    def __str__(self) -> str:
        lines = [self.what]
        if self.where:
            lines.append(f"  where: {self.where}")
        if self.todo:
            lines.append(f"  to do: {self.todo}")
        return "\n".join(lines)


class BadInput(KincalError):
    """What was given cannot be used: a file, an argument, a value in one of them."""


class CannotAnswer(KincalError):
    """The input is fine, but the data do not determine the answer (too few poses, a singular design)."""


class CommandFailed(KincalError):
    """The work was done and its answer is no: criteria missed, command refused, time ran out."""


class NoAnswer(CommandFailed):
    """Nothing came in time: whether what was sent has been taken is not known."""
