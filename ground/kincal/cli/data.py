"""The options of every command that reads measurements, and what they say together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from kincal.cli.options import PATH
from kincal_shared.errors import BadInput

if TYPE_CHECKING:
    from kincal.workbench.data.measurements import Measurements
    from kincal_shared.schema.arm import ArmTable
    from kincal_shared.schema.datamap import DataMap

Command = TypeVar("Command", bound=Callable[..., Any])

_UNITS = {
    "rad": "angle", "deg": "angle", "m": "length", "mm": "length",
    "s": "time", "ms": "time", "us": "time", "ns": "time",
}  # fmt: skip


@dataclass(frozen=True)
class Given:
    """What the user said about the measurements: files, map file, and what stands above it."""

    paths: tuple[Path, ...]
    map_path: Path | None
    columns: tuple[str, ...]
    units: str | None
    rotation: str | None
    skip_bad: bool
    infer_direction: bool = True
    excluded: tuple[str, ...] = ()
    force: bool = False

    def checked(self, arm: ArmTable) -> Measurements:
        """The measurements for a command that computes with them. BadInput if arm and data do not belong
        together, unless forced; what is odd is said on stderr."""
        from kincal.workbench.consistency import check, refuse

        data = self.read(arm)
        answer = check(arm, data, thorough=False)
        if not self.force:
            refuse(answer, arm, "correct it, or add --force to continue anyway")
        for doubt in answer.doubts:
            click.echo(f"warning: {doubt}", err=True)
        return data

    def read(self, arm: ArmTable) -> Measurements:
        """The measurements; notes and columns that nothing reads are named on stderr."""
        from kincal.workbench.consistency import left_m
        from kincal.workbench.data.readers import read_measurements

        data = read_measurements(
            self.paths,
            arm,
            self.mapping(),
            skip_bad=self.skip_bad,
            infer_direction=self.infer_direction,
            excluded=self.excluded,
            left_m=partial(left_m, arm),
        )
        for note in data.notes:
            click.echo(f"note: {note}", err=True)
        if data.unknown_columns:
            click.echo(f"note: columns not used: {', '.join(data.unknown_columns)}", err=True)
        if count := len(set(self.excluded)):
            click.echo(
                f"note: {count} {'pose or reading' if count == 1 else 'poses or readings'} excluded", err=True
            )
        return data

    def options(self) -> tuple[str, ...]:
        """The same options as words of a command line."""
        pairs = [("--data", str(path)) for path in self.paths]
        pairs += [("--map", str(self.map_path))] if self.map_path else []
        pairs += [("--column", column) for column in self.columns]
        pairs += [("--units", self.units)] if self.units else []
        pairs += [("--rotation", self.rotation)] if self.rotation else []
        pairs += [("--exclude", ",".join(self.excluded))] if self.excluded else []
        said = {
            "--skip-bad": self.skip_bad,
            "--no-inferred-direction": not self.infer_direction,
            "--force": self.force,
        }
        flags = (flag for flag, on in said.items() if on)
        return (*(word for pair in pairs for word in pair), *flags)

    def mapping(self) -> DataMap:
        """The map file with the options in place of what it says. SchemaError if that is no map."""
        from kincal_shared.schema.datamap import DataMap
        from kincal_shared.schema.errors import read_toml, validate

        doc = read_toml(self.map_path) if self.map_path else {}
        for option in self.columns:
            key, value = _pair("--column", option, "q=joint_{} or p=X,Y,Z")
            _table(doc, "columns")[key] = value
        for unit in (self.units or "").replace(",", " ").split():
            if unit not in _UNITS:
                raise BadInput(f"--units: no unit {unit!r}", todo=f"units are {', '.join(_UNITS)}")
            _table(doc, "units")[_UNITS[unit]] = unit
        if self.rotation:
            doc["rotation"] = _rotation(self.rotation)
        return validate(DataMap, doc, str(self.map_path or "--column, --units, --rotation"))


def _table(doc: dict[str, Any], key: str) -> dict[str, Any]:
    table = doc.setdefault(key, {})
    if not isinstance(table, dict):
        raise BadInput(
            f"the map has {key} = ..., which is no table", key, f"write [{key}] and its keys below"
        )
    return table


def _pair(option: str, text: str, example: str) -> tuple[str, str | list[str]]:
    key, equals, value = text.partition("=")
    if not equals or not key.strip() or not value.strip():
        raise BadInput(f"{option} {text}: not NAME=COLUMNS", todo=f"write {option} {example}")
    names = [name.strip() for name in value.split(",")]
    return key.strip(), names if len(names) > 1 else names[0]


def _rotation(text: str) -> dict[str, Any]:
    form, columns = _pair("--rotation", text, "xyzw=qx,qy,qz,qw or euler-ZYX=A,B,C")
    name, _, axes = form.partition("-")
    return {"form": name, "columns": columns} | ({"axes": axes} if axes else {})


def data_options(*, required: bool = True, about: str = "") -> Callable[[Command], Command]:
    """Options --data, --map, --column, --units, --rotation, --skip-bad, --no-inferred-direction, --exclude
    and --force, given to the command as one argument `given` (None if no --data was given and none is
    required)."""
    options = (
        click.option(
            "--data",
            "paths",
            required=required,
            multiple=True,
            type=PATH,
            help=about
            or "Measurements: CSV or other text, npz, Parquet, ROS bag, LCM log; repeat for several files.",
        ),
        click.option("--map", "map_path", type=PATH, default=None,
                     help="Names and units of the columns (TOML)."),
        click.option("--column", "columns", multiple=True, metavar="NAME=COLUMNS",
                     help="Columns of one quantity: q=joint_{}, p=X,Y,Z, t_s=time."),
        click.option("--units", metavar="UNIT,...", default=None,
                     help="Units in the file: any of rad deg m mm s ms us ns.  [default: rad,m,s]"),
        click.option("--rotation", metavar="FORM=COLUMNS", default=None,
                     help="Orientation as xyzw, wxyz, rotvec, matrix or euler-AXES: euler-ZYX=A,B,C."),
        click.option("--skip-bad", is_flag=True, help="Skip malformed rows and count them."),
        click.option("--no-inferred-direction", is_flag=True,
                     help="Without dir columns, do not infer approach directions from the order of rows."),
        click.option("--exclude", "excluded", multiple=True, metavar="ID,...",
                     help="Ids of poses to leave out; the report of `diagnose` lists those that you click."),
        click.option("--force", is_flag=True, help="Continue even if arm table and data do not match."),
    )  # fmt: skip

    def decorate(command: Command) -> Command:
        @wraps(command)
        def called(
            *args: Any,
            paths: tuple[Path, ...],
            map_path: Path | None,
            columns: tuple[str, ...],
            units: str | None,
            rotation: str | None,
            skip_bad: bool,
            no_inferred_direction: bool,
            excluded: tuple[str, ...],
            force: bool,
            **rest: Any,
        ) -> Any:
            ids = tuple(name.strip() for text in excluded for name in text.split(",") if name.strip())
            said = (columns, units, rotation, skip_bad, not no_inferred_direction, ids, force)
            given = Given(paths, map_path, *said) if paths else None
            return command(*args, given=given, **rest)

        wrapped: Any = called
        for option in reversed(options):
            wrapped = option(wrapped)
        result: Command = wrapped
        return result

    return decorate
