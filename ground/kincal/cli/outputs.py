"""Paths that a command will write to, checked before it does its work."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

import click

from kincal.cli.terminal import say
from kincal_shared.errors import BadInput
from kincal_shared.letters import unseen
from kincal_shared.writing import is_stream, refuse_loop

_WRITABLE = os.O_WRONLY | os.O_APPEND | os.O_NONBLOCK  # a pipe that nobody reads is no place to write


class OutputFile(click.ParamType[Path]):
    """A file to write: its folder is there or can be made, it can be written, its suffix is one of those."""

    name = "path"

    def __init__(self, *suffixes: str) -> None:
        self.suffixes = suffixes

    def convert(self, value: Any, _param: click.Parameter | None, _ctx: click.Context | None) -> Path:
        """The path. BadInput says why nothing can be written there."""
        path = _seen(value)
        refuse_loop(path)
        if self.suffixes and path.suffix.lower() not in self.suffixes:
            kinds = " or ".join(self.suffixes)
            raise BadInput(f"{path.name} cannot be written as {path.suffix or 'a file without suffix'}",
                           str(path), f"name a file that ends in {kinds}")  # fmt: skip
        if path.is_dir():
            raise BadInput("this is a directory, a file is to be written", str(path), "add a file name")
        if path.exists():
            _try(path, lambda: os.close(os.open(path, _WRITABLE)))
            if path.is_file() and not is_stream(path):
                _check_folder(path.resolve().parent, path)  # a new file will take its place
        else:
            _check_folder(path.parent, path)
            if not path.parent.exists():  # a mistyped one is noticed before the work begins
                say(f"note: the folder {path.parent} is not there yet, it will be made", err=True)
        return path


class OutputFolder(click.ParamType[Path]):
    """A folder to write files into: it is there or can be made, and can be written."""

    name = "path"

    def convert(self, value: Any, _param: click.Parameter | None, _ctx: click.Context | None) -> Path:
        """The path. BadInput says why nothing can be written there."""
        path = _seen(value)
        _check_folder(path, path, "name another folder")
        return path


def _seen(value: Any) -> Path:
    """The path. BadInput if its name holds what is not shown: nobody could tell it from another one."""
    path = Path(value)
    if code := unseen(str(path)):
        raise BadInput(f"the name holds {code}, which is not shown", ascii(str(path)), "name another file")
    return path


def _check_folder(folder: Path, path: Path, todo: str = "name a file in a directory") -> None:
    """A file can be made in the folder, or in the nearest one above it that is there."""
    there = next(one for one in (folder, *folder.absolute().parents) if os.path.lexists(one))
    if not there.is_dir():
        raise BadInput(f"{there} is no directory", str(path), todo)
    _try(path, lambda: tempfile.TemporaryFile(dir=there).close())


def _try(path: Path, write: Any) -> None:
    try:
        write()
    except OSError as error:
        raise BadInput(
            f"nothing can be written there: {error.strerror}", str(path), "name another place"
        ) from None


REPORT = OutputFile(".html", ".htm")
PICTURE = OutputFile(".png", ".svg")
FILE_OUT = OutputFile()
FOLDER_OUT = OutputFolder()
