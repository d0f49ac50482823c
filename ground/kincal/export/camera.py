"""A camera and its target of many points as the generated code has them (METHOD.md 13.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kincal.rotations import Floats
from kincal.schema.model import SightEntry
from kincal.workbench.pnp import EDGE, LEAST_SEEN, fault_of_column, moved_points

from .calibrated import CalibratedArm
from .expressions import points_of

# What a unit of a fault of the camera moves an image point by, along u and v; the same text in Python and C.
_SHIFTS: dict[str, tuple[str, str]] = {
    "radial_1": ("u * (u * u + v * v)", "v * (u * u + v * v)"),
    "radial_2": ("u * (u * u + v * v) * (u * u + v * v)", "v * (u * u + v * v) * (u * u + v * v)"),
    "decentring_1": ("2.0 * u * v", "u * u + 3.0 * v * v"),
    "decentring_2": ("3.0 * u * u + v * v", "2.0 * u * v"),
    "focal_x": ("u", "0.0"),
    "focal_y": ("0.0", "v"),
    "centre_x": ("1.0", "0.0"),
    "centre_y": ("0.0", "1.0"),
}
# Faults that the generated code does not know: the edges of a tag in the image.
_NOT_WRITTEN = frozenset({"target_edges"})


@dataclass(frozen=True)
class Fault:
    """A fault of camera or target. shift: expressions along u and v; None for points that lie elsewhere (a
    bent or too large target), which are the `bow`-th list of `Target.bows`."""

    name: str
    shift: tuple[str, str] | None
    bow: int = 0


@dataclass(frozen=True)
class Target:
    """points: (m, 3) in the target's frame [m]; bows: (m, 3) how its points move by a unit of
    each fault that moves them."""

    points: Floats
    bows: tuple[Floats, ...]


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


def camera_of(arm: CalibratedArm) -> Camera | None:
    """Camera and target of the effects that act through all points of it; None if there is no such effect, or
    the fit does not say what they are, or a fault cannot be written."""
    numbers = sorted({basis.index for term in arm.terms for basis in points_of(term)})
    sight = arm.record.sight
    if not numbers or sight is None:
        return None
    names = [fault_of_column(number) for number in numbers]
    if _NOT_WRITTEN.intersection(names):
        return None
    bent = [name for name in names if name not in _SHIFTS]
    low, high = np.array(sight.low), np.array(sight.high)
    return Camera(
        on_tool=sight.on_tool,
        targets=tuple(
            Target(points, tuple(moved_points(points, name) for name in bent))
            for points in _all_points(sight)
        ),
        low=low,
        high=high,
        focal=np.array(sight.focal),
        edge=EDGE * (high - low) / 2.0,
        least_seen=LEAST_SEEN,
        numbers=tuple(numbers),
        faults=tuple(
            Fault(name, _SHIFTS.get(name), bent.index(name) if name in bent else 0) for name in names
        ),
    )


def _all_points(sight: SightEntry) -> list[Floats]:
    return [np.array(points) for points in (sight.points_m, sight.second_m) if points is not None]
