"""Names of unnamed effects: unnamed[joint 1: q1, q3]."""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass

from kincal_shared.errors import BadInput
from kincal_shared.schema.names import UNNAMED

TOOL_AXES = ("tool_x", "tool_y", "tool_z")
SENSOR_AXES = ("sensor_x", "sensor_y", "sensor_z")
ORIENTATION, GRAVITY = "orientation", "gravity"
_PERIODS = (3, 4)  # a turn; fewer are of the second degree in the axis
HEADINGS = {
    f"{periods} periods of {axis} about {about}": (axis, about, periods)
    for axes, others in ((TOOL_AXES, SENSOR_AXES), (SENSOR_AXES, TOOL_AXES))
    for axis, about, periods in itertools.product(axes, others, _PERIODS)
}
"""Axis, the axis of the other frame that its heading is about, and periods a turn of the error, by driver."""
OF_ORIENTATION = frozenset((ORIENTATION, *TOOL_AXES, GRAVITY, *HEADINGS))
"""Drivers of the map that are the orientation of the tool."""
TOOL_MOVE = "tool_move"
"""Driver of the map that is the change of the tool's pose since the pose before."""

_HELD_BY = {"range": "camera translation", "tag tilt": "tag rotation"}
_NAME = re.compile(rf"{UNNAMED}\[(?P<place>[^:\[\]]+):(?P<drivers>[^:\[\]]+)\]")


@dataclass(frozen=True)
class UnnamedName:
    """Place and one or two drivers of an unnamed effect."""

    place: str
    drivers: tuple[str, ...]

    @classmethod
    def parse(cls, text: str) -> UnnamedName:
        """Of "unnamed[joint 1: q1, q3]". BadInput says how to write it."""
        match = _NAME.fullmatch(text.strip())
        drivers = tuple(d.strip() for d in match["drivers"].split(",")) if match else ()
        if not match or not 1 <= len(set(drivers)) == len(drivers) <= 2:
            raise BadInput(
                f"cannot read {text!r}",
                todo='write the place and one or two different variables: "unnamed[joint 1: q1, q3]"',
            )
        return cls(" ".join(match["place"].split()), drivers)

    @classmethod
    def of_cell(cls, location: str, drivers: tuple[str, ...]) -> UnnamedName:
        """Of a cell of the map; a location that terms cannot act at is named by the place that holds it."""
        return cls(_HELD_BY.get(location, location), drivers)

    @property
    def of_time(self) -> bool:
        """Whether the function has no value for poses that are yet to come."""
        return bool({"order", "t"} & set(self.drivers))

    @property
    def without_terms(self) -> bool:
        """Whether the function is one of the tool's orientation or of its last move, for which terms have no
        variables."""
        return self.of_tool_move or not OF_ORIENTATION.isdisjoint(self.drivers)

    @property
    def of_tool_move(self) -> bool:
        """Whether the function is one of the tool's last move."""
        return TOOL_MOVE in self.drivers

    def __str__(self) -> str:
        return f"{UNNAMED}[{self.place}: {', '.join(self.drivers)}]"
