"""What every reader of a file format gives: named columns, before anybody asks what they mean."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from kincal_shared.schema.arm import ArmTable
from kincal_shared.schema.datamap import DataMap

from ...numerics.types import Array

Column = Array | Sequence[str]


@dataclass(frozen=True, eq=False)
class Table:
    """The rows of a file.

    source: the file; where: place of its header in words ("line 1"); row: what a row is called ("line",
    "row"); numbers: (N,) number of each row as people count; columns: name -> N numbers or N texts;
    malformed: rows that could not be taken apart, (number, reason); decimal: decimal sign of texts, None if
    it has to be found out; notes: what people should know.
    """

    source: str
    where: str
    row: str
    numbers: Sequence[int]
    columns: dict[str, Column]
    malformed: tuple[tuple[int, str], ...] = ()
    decimal: str | None = "."
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Joints:
    """What a reader knows of the arm: number of joints, which of them are prismatic, their names ("" if the
    arm table has none)."""

    prismatic: tuple[bool, ...]
    names: tuple[str, ...]

    @classmethod
    def of(cls, arm: ArmTable | int) -> Joints:
        """Joints of an arm table, or of an arm of so many revolute joints."""
        if isinstance(arm, int):
            return cls((False,) * arm, ("",) * arm)
        return cls(tuple(j.prismatic for j in arm.joints), tuple(j.name for j in arm.joints))

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.prismatic)


Reader = Callable[[str, DataMap, Joints], Table]
"""reader(path, map, joints): the rows of a file; BadInput says what is wrong with it as a whole."""
