"""Files that are written whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
from collections.abc import Iterable, Mapping
from pathlib import Path

from kincal_shared.errors import BadInput

MARK = ".kincal"
"""In a folder: whose files there may be replaced, a line for each kind of them."""
_LETTERS = 50  # of its name that a file begun has, as names have a largest length
_FULL = "free space there, or name a place on another disk"
WHAT_TO_DO = {
    errno.ENOSPC: _FULL,
    errno.EDQUOT: _FULL,
    errno.ELOOP: "this symbolic link leads to itself: remove it, or name another file",
    errno.EFBIG: "raise the limit of the size of files (`ulimit -f`), or name a place on another disk",
}
"""What to do about errors where another place is not the first thought."""


def keep_inputs(files: Iterable[Path], inputs: Iterable[Path]) -> None:
    """BadInput if a file that is to be written is an input, by whatever path."""
    kept = {os.path.realpath(path) for path in inputs}  # resolve() fails at a link that leads to itself
    for file in files:
        if os.path.realpath(file) in kept:
            raise BadInput("is an input, and would be overwritten", str(file), "choose another name")


def claim(folder: Path, files: str, names: Iterable[str], *, former: bool = False) -> None:
    """Make a folder for files of these names, or take it over from an earlier time: a mark says that they
    may be replaced. BadInput if one of them is there without it: somebody else made it. files: what they are,
    such as "a run"; former: they are known to be ours, from versions that left no mark."""
    mark = folder / MARK
    if os.path.lexists(mark) and (mark.is_symlink() or not mark.is_file()):  # a pipe would wait for a reader
        raise BadInput("is no mark but a link, a folder or a pipe, and others may need it", str(mark),
                       "name another folder")  # fmt: skip
    try:
        known = mark.read_text("utf-8", errors="replace").splitlines() if mark.is_file() else []
    except OSError as error:
        raise cannot_write(mark, error) from None
    if files in known:
        return
    if not former and (others := sorted(name for name in names if os.path.lexists(folder / name))):
        raise BadInput(
            f"holds {others[0]}, which would be replaced, and no mark ({MARK}) that it is of {files}",
            str(folder),
            "name a new or empty folder, or move that file away",
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        mark.write_text("\n".join([*known, files]) + "\n", "utf-8")
    except OSError as error:
        raise cannot_write(mark, error) from None


def write_file(path: Path, content: str | bytes) -> Path:
    """Write one file, as write_files does; returns its path."""
    return write_files({path: content})[0]


def write_files(contents: Mapping[Path, str | bytes]) -> list[Path]:
    """Write files (text as UTF-8), making their folders: all of them, or BadInput and what was there before.

    Each is written beside its place under another name, with the access rights of the file that it
    replaces, and renamed when all of them are complete. Pipes and devices are written as they are.
    """
    begun: dict[Path, Path] = {}
    made: list[Path] = []
    for path, content in contents.items():
        try:
            _begin(path, content.encode("utf-8") if isinstance(content, str) else content, begun, made)
        except BaseException as error:
            _undo(begun, made)
            raise (cannot_write(path, error) if isinstance(error, OSError) else error) from None
    for place, new in list(begun.items()):
        try:
            os.replace(new, place)
            del begun[place]
        except OSError as error:
            _undo(begun, made)
            raise cannot_write(place, error) from None
    return list(contents)


def cannot_write(path: Path | str, error: OSError) -> BadInput:
    """What to report of a file that could not be written."""
    why = error.strerror or str(error)
    return BadInput(
        f"cannot be written: {why}", str(path), WHAT_TO_DO.get(error.errno or 0, "name another place")
    )


def _begin(path: Path, data: bytes, begun: dict[Path, Path], made: list[Path]) -> None:
    """Write the data under another name, and note that; `made` takes up folders that were not there."""
    if is_stream(path):
        path.write_bytes(data)
        return
    refuse_loop(path)
    place = Path(os.path.realpath(path))  # a link stays one
    missing = [folder for folder in place.parents if not folder.exists()]
    for folder in reversed(missing):
        folder.mkdir(exist_ok=True)
        made.append(folder)
    if place.exists() and not os.access(place, os.W_OK):  # a rename would not ask
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
    begun[place] = new = place.with_name(f".{place.name[:_LETTERS]}.{secrets.token_hex(4)}.new")
    with open(os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666), "wb") as file:
        if place.exists():
            os.fchmod(file.fileno(), place.stat().st_mode & 0o7777)
        file.write(data)
        file.flush()
        os.fsync(file.fileno())  # a full disk is sometimes noticed only here


def refuse_loop(path: Path) -> None:
    """BadInput for a symbolic link that leads back to itself: nothing is behind it, and it would be lost."""
    if os.path.islink(os.path.realpath(path)):
        raise cannot_write(path, OSError(errno.ELOOP, os.strerror(errno.ELOOP)))


def is_stream(path: Path) -> bool:
    """A pipe or device, or what this process has open already: nothing can take its place."""
    other = path.exists() and not path.is_file() and not path.is_dir()
    return other or str(path).startswith(("/dev/std", "/dev/fd/", "/proc/"))


def _undo(begun: Mapping[Path, Path], made: list[Path]) -> None:
    for new in begun.values():
        with contextlib.suppress(OSError):
            new.unlink()
    for folder in reversed(made):
        with contextlib.suppress(OSError):  # what another program has put something into stays
            folder.rmdir()
