"""Formats that a fitted model can be taken away in, and writing them."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from kincal_shared.errors import BadInput
from kincal_shared.writing import keep_inputs, write_files

from .calibrated import CalibratedArm
from .dh import dh_table, four_parameter_table
from .document import document
from .leftout import LeftOut
from .source import c_header, c_source, python_source, source_left_out
from .tabular import arm_toml, dh_csv
from .urdf import urdf, urdf_left_out

Format = Literal["dh", "json", "urdf", "python", "c"]
FORMATS: tuple[Format, ...] = get_args(Format)
SUFFIXES: dict[Format, tuple[str, ...]] = {
    "dh": (".toml",),
    "json": (".json",),
    "urdf": (".urdf", ".xml"),
    "python": (".py",),
    "c": (".c",),
}
_BESIDE: dict[Format, str] = {"dh": ".csv", "c": ".h"}


@dataclass(frozen=True)
class Exported:
    """Files that were written, and effects of the model that they do not hold."""

    files: tuple[Path, ...]
    left_out: tuple[LeftOut, ...]


def export(arm: CalibratedArm, form: Format, path: str | Path, *, keep: tuple[Path, ...] = ()) -> Exported:
    """Write a fitted arm: dh makes NAME.toml and NAME.csv, c NAME.c and NAME.h, the others one file.

    keep: files that must not be overwritten, the inputs. BadInput for a suffix that does not belong to the
    format, or a path that cannot be written.
    """
    first = Path(path)
    files = targets(form, first)
    _check(files, keep)
    texts, left_out = _MAKERS[form](arm, first)
    write_files(dict(zip(files, texts, strict=True)))
    return Exported(files, left_out)


def targets(form: Format, path: Path) -> tuple[Path, ...]:
    """Files that an export to a path writes. BadInput for a suffix that does not belong to the format."""
    if path.suffix not in SUFFIXES[form]:
        wanted = " or ".join(SUFFIXES[form])
        raise BadInput(
            f"--format {form} writes {wanted}", str(path), f"write -o {path.stem}{SUFFIXES[form][0]}"
        )
    beside = [path.with_suffix(_BESIDE[form])] if form in _BESIDE else []
    return (path, *beside)


def _check(files: tuple[Path, ...], keep: tuple[Path, ...]) -> None:
    keep_inputs(files, keep)
    for file in files:
        if file.is_dir():
            raise BadInput("this is a directory, a file is to be written", str(file), "add a file name")
    named, *beside = files
    for file in beside:
        if file.exists() and not named.exists():  # an earlier export has left both
            raise BadInput(f"would be replaced by what is written beside {named.name}", str(file),
                           "choose another name")  # fmt: skip


_Made = tuple[tuple[str, ...], tuple[LeftOut, ...]]


def _dh(arm: CalibratedArm, _path: Path) -> _Made:
    four = four_parameter_table(arm)
    return (arm_toml(arm, four), dh_csv(arm, dh_table(arm))), four.left_out


def _json(arm: CalibratedArm, _path: Path) -> _Made:
    return (json.dumps(document(arm, dh_table(arm)), indent=1) + "\n",), ()


def _urdf(arm: CalibratedArm, _path: Path) -> _Made:
    return (urdf(arm),), urdf_left_out(arm)


def _python(arm: CalibratedArm, _path: Path) -> _Made:
    return (python_source(arm),), source_left_out(arm)


def _c(arm: CalibratedArm, path: Path) -> _Made:
    return (c_source(arm, path.with_suffix(".h").name), c_header(arm)), source_left_out(arm)


_MAKERS: dict[Format, Callable[[CalibratedArm, Path], _Made]] = {
    "dh": _dh,
    "json": _json,
    "urdf": _urdf,
    "python": _python,
    "c": _c,
}
