"""A camera and its target of many points as the generated code has them (METHOD.md 13.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kincal.rotations import Floats
from kincal.workbench.model.pnp import (
    CORNERS,
    EDGE,
    LEAST_SEEN,
    OF_CAMERA,
    fault_of_column,
    in_order,
    moved_points,
    sight_of_column,
)
from kincal_shared.errors import BadInput
from kincal_shared.schema.model import SightEntry

from .calibrated import CalibratedArm
from .expressions import points_of

_EDGES = "target_edges"


@dataclass(frozen=True)
class Fault:
    """A fault of camera or target. shift: what a unit of it moves an image point by along u and v, as
    expressions of both languages; move: instead, for points that lie elsewhere (a bent or too large
    target), which of `Target.moves` theirs are. Neither: the edges of a tag in the image."""

    name: str
    shift: tuple[str, str] | None = None
    move: int | None = None


@dataclass(frozen=True)
class Target:
    """points: (m, 3) in the target's frame [m], corners of a tag as one walks around it; moves: (m, 3) how
    its points move by a unit of each fault that moves them."""

    points: Floats
    moves: tuple[Floats, ...]


@dataclass(frozen=True)
class Camera:
    """What the camera sees and how.

    on_tool: it is on the tool, and the measured pose is its own in the target's frame; targets: the one, or
    first and second; low, high, focal: (2,) as of `SightEntry`; edge: (2,) width of the border over which
    points lose their weight; numbers, faults: columns that the effects use.
    """

    on_tool: bool
    targets: tuple[Target, ...]
    low: Floats
    high: Floats
    focal: Floats
    edge: Floats
    least_seen: float
    numbers: tuple[int, ...]
    faults: tuple[Fault, ...]

    @property
    def edges(self) -> bool:
        """Whether edges of a tag in the image matter."""
        return any(fault.name == _EDGES for fault in self.faults)

    @property
    def most_points(self) -> int:
        """Points of the target that has most; no fewer than a tag has."""
        return max(CORNERS, *(len(target.points) for target in self.targets))


def camera_of(arm: CalibratedArm) -> Camera | None:
    """Camera and target of the effects that act through all points of it; None if there is no such effect, or
    they assume several. BadInput if the fit does not say what they are."""
    numbers = sorted({basis.index for term in arm.terms for basis in points_of(term)})
    if len({sight_of_column(number) for number in numbers}) != 1:
        return None
    sight = arm.record.sight
    if sight is None:
        raise BadInput(
            "[fit.sight] is missing: camera and target that effects of the sensor act through",
            arm.file,
            "run `kincal model fit` again, which writes it; files of older versions do not have it",
        )
    names = [fault_of_column(number) for number in numbers]
    moving = [name for name in names if name not in OF_CAMERA and name != _EDGES]
    low, high = np.array(sight.low), np.array(sight.high)
    return Camera(
        on_tool=sight.on_tool,
        targets=tuple(
            Target(points, tuple(moved_points(points, name) for name in moving))
            for points in _all_points(sight)
        ),
        low=low,
        high=high,
        focal=np.array(sight.focal),
        edge=EDGE * (high - low) / 2.0,
        least_seen=LEAST_SEEN,
        numbers=tuple(numbers),
        faults=tuple(
            Fault(name, _shift(name), moving.index(name) if name in moving else None) for name in names
        ),
    )


def _all_points(sight: SightEntry) -> list[Floats]:
    found = [np.array(points) for points in (sight.points_m, sight.second_m) if points is not None]
    return [points[in_order(points)] if len(points) == CORNERS else points for points in found]


@dataclass(frozen=True)
class _Text:
    """A name or what was computed from names, as text that Python and C read alike.

    binds: 2 a name, 1 a product, 0 a sum; what binds less than its place needs gets brackets.
    """

    text: str
    binds: int = 2

    def __add__(self, other: _Text) -> _Text:
        return _Text(f"{self._at(0)} + {other._at(1)}", 0)

    def __mul__(self, other: _Text) -> _Text:
        return _Text(f"{self._at(1)} * {other._at(2)}", 1)

    def __rmul__(self, number: float) -> _Text:
        return _Text(f"{number} * {self._at(2)}", 1)

    def __str__(self) -> str:
        return self.text

    def _at(self, binds: int) -> str:
        return self.text if self.binds >= binds else f"({self.text})"


def _shift(fault: str) -> tuple[str, str] | None:
    """The formulas of a fault of the camera as text."""
    if fault not in OF_CAMERA:
        return None
    along_u, along_v = OF_CAMERA[fault](_Text("u"), _Text("v"))
    return str(along_u), str(along_v)
