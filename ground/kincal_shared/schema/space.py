"""Description of a search space (space.toml, docs/SPACES.md): where flight may bring the tool for a
measurement."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic

from kincal_shared.errors import BadInput

from .base import Strict
from .dh import DH_FIELDS
from .errors import Contradiction, read_toml, validate
from .numbers import Angle, Count, NotNegative, Positive, Quantity, Whole

# Limits of the SPACE table; tests/ground/test_schema.py compares them with the headers.
CAND_MAX, HUB_MAX, INITIAL_MAX, STOP_MAX = 1024, 16, 32, 4
JOINT_MAX = 8
FAR_M = 10.0
_ERROR_NAME = re.compile(rf"J([1-{JOINT_MAX}])\.({'|'.join(DH_FIELDS)})")

Metres = Annotated[float, Quantity(ge=-FAR_M, le=FAR_M)]
AngleSize = Annotated[float, Quantity(ge=0.0, le=math.pi)]
Length = Annotated[float, Quantity(ge=0.0, le=1.0)]
Vec3 = tuple[Metres, Metres, Metres]
Posture = Annotated[list[Angle], pydantic.Field(min_length=1, max_length=JOINT_MAX)]
PoseNumber = Annotated[int, Count(ge=1, le=INITIAL_MAX)]

_SIZES_OF: dict[str, set[str]] = {
    "below": set(),
    "box": {"half_m"},
    "capsule": {"end_m", "radius_m"},
    "sphere": {"radius_m"},
}


def _check_sizes(half_m: Vec3 | None) -> None:
    if half_m is not None and min(half_m) <= 0.0:
        raise Contradiction("half_m", "must be above 0 in every direction")


class Joints(Strict):
    """Limits of the joints, the roadmap's hubs and the local initial poses."""

    margin_rad: list[AngleSize]
    """Distance from the joint limits, one for each joint [rad]."""
    hubs_rad: list[Posture] = pydantic.Field(min_length=1, max_length=HUB_MAX)
    """Roadmap nodes; all moves go from hub to hub to candidate. The first one is the park pose [rad]."""
    servo_bound_rad: Positive | list[Positive]
    """How far the servo may move each joint from a seed, one for all joints or one for each [rad]."""
    local_initial_rad: list[Posture] = pydantic.Field(default=[], max_length=INITIAL_MAX)
    """Local initial poses: small joint motions about the park pose, measured before any long move [rad]."""
    reserve: list[PoseNumber] = []
    """Local initial poses, counted from 1, that are only taken while few before them detected a tag."""


class Tool(Strict):
    """Box of tool positions in the base frame."""

    box_min_m: Vec3
    """Lower corner [m]."""
    box_max_m: Vec3
    """Upper corner [m]."""

    @pydantic.model_validator(mode="after")
    def _has_room(self) -> Tool:
        for axis, low, high in zip("xyz", self.box_min_m, self.box_max_m, strict=True):
            if low >= high:
                raise Contradiction(
                    "box_min_m", f"leaves no room along {axis}: {low:g} is not below box_max_m {high:g}"
                )
        return self


class View(Strict):
    """What the camera must see at a candidate."""

    range_min_m: NotNegative
    """Least distance of the camera to a tag [m]."""
    range_max_m: Positive
    """Largest distance of the camera to a tag [m]."""
    tags_min: Annotated[int, Count(ge=1, le=4)]
    """Tags in view, whole."""
    incid_max_rad: Annotated[float, Quantity(gt=0.0, lt=1.5)]
    """Largest incidence angle of those tags [rad]."""
    tag_min_px: NotNegative
    """Shortest edge of the black square in the image [px]."""
    image_margin_px: NotNegative
    """Margin at the rim of the image [px]."""
    pantilt_margin_rad: NotNegative
    """Distance from the limits of the pan-tilt unit [rad]."""

    @pydantic.model_validator(mode="after")
    def _has_room(self) -> View:
        if self.range_min_m >= self.range_max_m:
            raise Contradiction(
                "range_min_m", f"is {self.range_min_m:g}, which is not below range_max_m {self.range_max_m:g}"
            )
        return self


class Clear(Strict):
    """Clearances, and how finely moves are checked."""

    nominal_m: NotNegative
    """Clearance of the nominal arm [m]."""
    perturbed_m: NotNegative
    """Clearance of the arms with sampled errors [m]."""
    step_rad: Annotated[float, Quantity(gt=0.0, le=0.2)]
    """Step along segments [rad]."""
    direct_max_rad: NotNegative
    """Candidates nearer than this may be joined without a hub [rad]."""
    servo_bound_samples: Annotated[int, Count(ge=1)]
    """Postures inside the servo bound of each seed that are checked, errors in turn."""


class ErrorBounds(Strict):
    """DH errors that the space must allow for."""

    phi_rad: list[AngleSize]
    """Bound of each joint's offset error [rad]."""
    alpha_rad: list[AngleSize]
    """Bound of each link's twist error [rad]."""
    a_m: list[Length]
    """Bound of each link's length error [m]."""
    d_m: list[Length]
    """Bound of each link's offset error [m]."""
    alone_rad: NotNegative
    """Bounds from here on are also tried alone, both ways [rad]."""
    alone_m: NotNegative
    """Bounds from here on are also tried alone, both ways [m]."""
    draws: Annotated[int, Count(ge=0, le=200)]
    """Sampled sets of errors."""
    errors: Annotated[int, Count(ge=1)]
    """Errors at their full bound in each sampled set."""
    case: list[dict[str, Angle]] = []
    """Sets of errors named by people: "J7.phi_rad" = 1.3."""
    reach: pydantic.StrictBool = False
    """true: the servo must be able to bring the tool to the pose under every case."""

    @pydantic.field_validator("case", mode="before")
    @classmethod
    def _known_errors(cls, cases: Any) -> Any:
        found = cases if isinstance(cases, list) else []
        for name in (name for case in found if isinstance(case, dict) for name in case):
            if not _ERROR_NAME.fullmatch(name):
                raise Contradiction("", f"{name!r} is no DH error", "they are called J1.phi_rad, J2.a_m ...")
        return cases


class Spread(Strict):
    """What measures the distance between candidates."""

    set: Annotated[int, Count(ge=0)]
    """Set of hyperparameters of the kernel table, from 0 as the table has it."""


class Shape(Strict):
    """A capsule or box on the arm, in the frame of a joint (z its axis, before a and alpha) or the tool."""

    name: str
    """What messages call it."""
    joint: Annotated[int, Count(ge=0, le=JOINT_MAX)] = 0
    """Joint whose frame it is given in; 0: the tool."""
    start_m: Vec3 | None = None
    """Capsule: one end of its axis [m]."""
    end_m: Vec3 | None = None
    """Capsule: the other end [m]."""
    radius_m: Positive | None = None
    """Capsule: radius [m]."""
    centre_m: Vec3 | None = None
    """Box: centre [m]."""
    half_m: Vec3 | None = None
    """Box: half sizes [m]."""
    tag: Whole | None = None
    """Id of the tag that the shape carries."""

    @pydantic.model_validator(mode="after")
    def _one_kind(self) -> Shape:
        capsule = [x is not None for x in (self.start_m, self.end_m, self.radius_m)]
        box = [x is not None for x in (self.centre_m, self.half_m)]
        if not ((all(capsule) and not any(box)) or (all(box) and not any(capsule))):
            raise Contradiction(
                "", f"{self.name} is no shape", "write start_m, end_m and radius_m, or centre_m and half_m"
            )
        _check_sizes(self.half_m)
        return self


class KeepOut(Strict):
    """A volume that nothing of the arm may enter, in the base frame."""

    name: str
    """What messages call it."""
    kind: Literal["box", "capsule", "sphere", "below"]
    """below: everything under centre_m."""
    centre_m: Vec3 = (0.0, 0.0, 0.0)
    """Centre, or one end of a capsule's axis [m]."""
    half_m: Vec3 | None = None
    """Box: half sizes [m]."""
    end_m: Vec3 | None = None
    """Capsule: other end of its axis [m]."""
    radius_m: Positive | None = None
    """Capsule, sphere: radius [m]."""
    except_: list[str] = pydantic.Field(default=[], alias="except")
    """Shapes of the arm that may be inside."""

    @pydantic.model_validator(mode="after")
    def _complete(self) -> KeepOut:
        given = {key for key in ("half_m", "end_m", "radius_m") if getattr(self, key) is not None}
        wanted = _SIZES_OF[self.kind]
        if given != wanted:
            takes = " and ".join(["centre_m", *sorted(wanted)])
            raise Contradiction("", f"{self.name}: a volume of kind {self.kind!r} takes {takes}")
        _check_sizes(self.half_m)
        return self


class Sight(Strict):
    """Lines of sight from the camera to the tags."""

    margin_m: NotNegative
    """Links are taken this much thicker [m]."""
    border: Annotated[float, Quantity(ge=1.0)]
    """Printed size of a tag, white border included, over its black square."""


class Stops(Strict):
    """Stops on the segments from hubs to candidates, where flight observes on its way."""

    most: Annotated[int, Count(ge=0, le=STOP_MAX)] = 0
    """Stops for each candidate at most, evenly along its segment; 0: none."""
    shown_min: Annotated[float, Quantity(gt=0.0, le=1.0)] = 0.8
    """Least share of the arms with errors that show a tag at a stop."""
    spacing_rad: Positive = 0.2
    """Least distance of a stop from both ends of the segment and from the stop before, in one joint [rad]."""


class Description(Strict):
    """A search space: what candidates are sampled from and what they have to pass."""

    kind: Literal["space"]
    """Kind of table that this file is the source of."""
    title: str = ""
    """What it is, for people."""
    provenance: dict[str, str] = {}
    """Where the numbers come from."""
    seed: Annotated[int, Count(ge=0)]
    """Seed of all sampling; the same description always gives the same table."""
    candidates: Annotated[int, Count(ge=1, le=CAND_MAX)]
    """Candidates that are kept, spread by farthest-point selection."""
    samples: Annotated[int, Count(ge=1, le=10_000_000)]
    """Tool poses that are examined."""
    initial_poses: Annotated[int, Count(ge=0, le=INITIAL_MAX)]
    """Candidates of the initial design: visible under most errors, far apart."""
    joints: Joints
    """Joint limits, hubs, local initial poses."""
    tool: Tool
    """Box of tool positions."""
    view: View
    """What the camera must see."""
    clear: Clear
    """Clearances."""
    error_bounds: ErrorBounds
    """DH errors that the space must allow for."""
    spread: Spread
    """Distance between candidates."""
    stops: Stops = Stops()
    """Stops on the way to candidates."""
    sight: Sight
    """Lines of sight."""
    shape: list[Shape]
    """The arm as solid shapes."""
    collision_exclusions: list[tuple[str, str]] = []
    """Pairs of shapes that may touch."""
    keep_out: list[KeepOut]
    """Volumes that nothing of the arm may enter."""

    @pydantic.model_validator(mode="after")
    def _fits_the_table(self) -> Description:
        local = len(self.joints.local_initial_rad)
        for number, pose in enumerate(self.joints.reserve, 1):
            if pose > local:
                raise Contradiction(
                    f"joints.reserve[{number}]", f"is {pose}, there are {local} local initial poses"
                )
        if self.initial_poses + local > INITIAL_MAX:
            raise Contradiction(
                "initial_poses",
                f"is {self.initial_poses}, with {local} local ones; the table has room for {INITIAL_MAX}",
            )
        if self.candidates + local > CAND_MAX:
            raise Contradiction(
                "candidates",
                f"is {self.candidates}, with {local} local initial poses; the table has room for {CAND_MAX}",
            )
        return self

    @pydantic.model_validator(mode="after")
    def _one_of_each(self) -> Description:
        names = [shape.name for shape in self.shape] + [volume.name for volume in self.keep_out]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise Contradiction("", f"two shapes or volumes are called {', '.join(map(repr, twice))}")
        return self

    @pydantic.model_validator(mode="after")
    def _names_are_those_of_shapes(self) -> Description:
        known = {shape.name for shape in self.shape}
        for number, pair in enumerate(self.collision_exclusions, 1):
            _check_names(pair, known, f"collision_exclusions[{number}]")
        for number, volume in enumerate(self.keep_out, 1):
            _check_names(volume.except_, known, f"keep_out[{number}].except")
        return self


def _check_names(names: Any, known: set[str], key: str) -> None:
    for name in names:
        if name not in known:
            raise Contradiction(
                key, f"names {name!r}, which is no shape", f"shapes are {', '.join(sorted(known))}"
            )


def read_description(path: Path) -> Description:
    """Read space.toml. SchemaError lists all that is wrong; BadInput if it is the source of another table."""
    doc = read_toml(path)
    if doc.get("kind", "space") != "space":
        raise BadInput(f"this is a {doc['kind']!r} source, not a search space", str(path))
    return validate(Description, doc, str(path))
