"""Places where an error may enter the chain, by name: joint axes, links, base, tool, camera, tag."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from kincal.flight import FRAME_CAMERA, FRAME_MEAS, FRAME_TOOL
from kincal_shared.errors import BadInput
from kincal_shared.schema.arm import ArmTable
from kincal_shared.schema.names import COMPONENTS
from kincal_shared.schema.terms import TermEntry

from ..data.measurements import Measurements

TYPICAL_SIZE = 1.5e-3  # [rad, m] of an unknown error, whose columns are scaled by it
_SHIFTS, _TURNS = (0, 1, 2), (3, 4, 5)
_FIXED = {0: "base", FRAME_TOOL: "tool", FRAME_CAMERA: "camera", FRAME_MEAS: "meas"}


@dataclass(frozen=True)
class ErrorPlace:
    """Components of the twist at a frame that one unknown error may have.

    name: "joint 3", "link 2 tilt", "base rotation" ...; frame: 0 (base) to n, or FRAME_TOOL, FRAME_CAMERA,
    FRAME_MEAS; components: 0..5.
    """

    name: str
    frame: int
    components: tuple[int, ...]

    @property
    def shifts(self) -> bool:
        """The error is a length, not an angle."""
        return self.components[0] in _SHIFTS

    @property
    def unit(self) -> str:
        """Unit of the error."""
        return "m" if self.shifts else "rad"

    def term(self, component: int, basis: str) -> TermEntry:
        """A term of a file that puts a basis on one component here."""
        at = _FIXED.get(self.frame) or f"link[{self.frame}]"
        name = COMPONENTS[component]
        if self.name.startswith("joint"):
            return TermEntry(at=f"joint[{self.frame + 1}]", basis=basis)
        return TermEntry.model_validate({"at": at, "comp": name, "basis": basis})


def joint_places(arm: ArmTable) -> Iterator[ErrorPlace]:
    """Motion about (or along) each joint's own axis."""
    for j, joint in enumerate(arm.joints, 1):
        yield ErrorPlace(f"joint {j}", j - 1, (2 if joint.prismatic else 5,))


def other_places(arm: ArmTable, camera: bool) -> Iterator[ErrorPlace]:
    """Tilt of the links, turns and shifts of the frames; camera: the data say where it stands."""
    yield ErrorPlace("base rotation", 0, _TURNS)
    yield ErrorPlace("tool rotation", FRAME_TOOL, _TURNS)
    if camera:
        yield ErrorPlace("camera rotation", FRAME_CAMERA, _TURNS)
        yield ErrorPlace("tag rotation", FRAME_MEAS, _TURNS)
    for j in range(1, arm.n):
        yield ErrorPlace(f"link {j} tilt", j, _TURNS[:2])
    yield ErrorPlace("base translation", 0, _SHIFTS)
    yield ErrorPlace("tool translation", FRAME_TOOL, _SHIFTS)
    if camera:
        yield ErrorPlace("camera translation", FRAME_CAMERA, _SHIFTS)


def all_places(arm: ArmTable, data: Measurements) -> tuple[ErrorPlace, ...]:
    """Every place that terms can act at."""
    return (*joint_places(arm), *other_places(arm, data.has("cam")))


def find_place(name: str, arm: ArmTable, data: Measurements) -> ErrorPlace:
    """The place of a name. BadInput lists the possible ones."""
    found = {place.name: place for place in all_places(arm, data)}
    if name not in found:
        raise BadInput(f"{name!r} is no place where terms can act on {arm.name}", todo=_possible(found))
    return found[name]


def _possible(found: dict[str, ErrorPlace]) -> str:
    joints = sum(name.startswith("joint") for name in found)
    rest = [name for name in found if not name.startswith(("joint", "link"))]
    return f"write joint 1 to {joints}, link 1 tilt to link {joints - 1} tilt, {', '.join(rest)}"
