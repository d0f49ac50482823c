"""Arms and measurements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from kincal.workbench.consistency import check, left_m, refuse
from kincal.workbench.data.measurements import Measurements
from kincal.workbench.data.readers import read_measurements
from kincal_shared.errors import BadInput
from kincal_shared.schema.arm import ArmTable, arm_of_text, read_arm
from kincal_shared.schema.datamap import DataMap
from kincal_shared.schema.errors import read_toml, validate


@dataclass(frozen=True)
class Arm:
    """An arm table; `table` holds its numbers in standard DH."""

    table: ArmTable

    @classmethod
    def load(cls, arm: str | Path) -> Arm:
        """From a file, or by the name of an arm that ships ("wam"). SchemaError lists what is wrong."""
        return cls(read_arm(arm))

    @classmethod
    def from_urdf(cls, path: str | Path, base: str | None = None, tip: str | None = None) -> Arm:
        """From a URDF: the chain between two links, without names from the root to the only end. Needs
        kincal[urdf]."""
        from kincal.arms import import_urdf

        return cls(arm_of_text(import_urdf(Path(path), base, tip).text, str(path)))

    @property
    def name(self) -> str:
        """What people call it."""
        return self.table.name

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.table.n


@dataclass(frozen=True)
class Data:
    """Files of measurements, and how to read them; the arm says how many joints they have."""

    files: tuple[Path, ...]
    mapping: DataMap
    skip_bad: bool = False

    @classmethod
    def load(
        cls,
        *files: str | Path,
        columns: Mapping[str, str | Sequence[str]] | None = None,
        units: Mapping[str, str] | None = None,
        rotation: Mapping[str, Any] | None = None,
        map_file: str | Path | None = None,
        skip_bad: bool = False,
    ) -> Data:
        """Files of any format that the workbench reads, as one set.

        columns, units, rotation: as the tables of a map file (docs/WORKBENCH.md), above those of `map_file`:
        columns={"q": "Joint {}"}, units={"angle": "deg", "length": "mm"}. BadInput for a missing file.
        """
        paths = tuple(Path(file) for file in files)
        for path in paths:
            if not path.exists():
                raise BadInput(
                    "no such file", str(path), "name a file that is there, from the present folder"
                )
        doc = read_toml(Path(map_file)) if map_file else {}
        for key, given in (("columns", columns), ("units", units), ("rotation", rotation)):
            if given:
                doc[key] = {**doc.get(key, {}), **given}
        return cls(paths, validate(DataMap, doc, str(map_file or "Data.load")), skip_bad)

    def read(self, arm: Arm) -> Measurements:
        """The measurements of an arm. BadInput names file, row, column and what to do."""
        return read_measurements(
            self.files, arm.table, self.mapping, skip_bad=self.skip_bad, left_m=partial(left_m, arm.table)
        )


def measurements(arm: Arm, data: Data | Measurements) -> Measurements:
    """Measurements as given, or read."""
    return data.read(arm) if isinstance(data, Data) else data


def checked(arm: Arm, data: Data | Measurements, force: bool) -> Measurements:
    """The same. BadInput if they do not belong to the arm, unless forced."""
    read = measurements(arm, data)
    if not force:
        refuse(check(arm.table, read, thorough=False), arm.table, "correct it, or go on with force=True")
    return read


def files_of(data: Data | Measurements) -> tuple[Path, ...]:
    """Files that measurements come from; none for arrays in memory."""
    return data.files if isinstance(data, Data) else ()
