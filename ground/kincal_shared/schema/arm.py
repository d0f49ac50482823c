"""Arm tables of the workbench (TOML, docs/WORKBENCH.md): as written, and as the ground works with them.

`ArmFile` is the file. `read_arm` gives an `ArmTable`: standard (distal) DH; a file in modified DH is
converted exactly.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import pydantic
from numpy.typing import NDArray

from kincal_shared.errors import BadInput
from kincal_shared.letters import unseen

from .base import Strict
from .errors import Contradiction, parse_toml, read_toml, validate
from .numbers import Angle, Length, NotNegative, Place, Positive, Real, Vec3

MAX_JOINTS = 16
_SAME_DH = 1e-6  # [rad or m], as people round DH parameters
_UNIT_TOLERANCE = 1e-3  # of the norm of a quaternion as people round it
MOST_GRAVITY_M_S2 = 30.0
"""More than on any planet that an arm can stand on (Jupiter: 25)."""

Quat = tuple[Real, Real, Real, Real]
Array = NDArray[np.float64]


# --------------------------------------------------------------------------- the file


class FrameEntry(Strict):
    """A fixed frame: place and orientation in the frame before it."""

    xyz_m: Place | None = pydantic.Field(default=None, examples=[[0.0, 0.0, 0.346]])
    """Origin [m]."""
    quat_wxyz: Quat | None = pydantic.Field(default=None, examples=[[1.0, 0.0, 0.0, 0.0]])
    """Orientation, unit quaternion, scalar part first."""
    estimate: pydantic.StrictBool = False
    """true: the frame is unknown, with no first guess; the fit finds it."""

    @pydantic.field_validator("quat_wxyz")
    @classmethod
    def _is_unit(cls, quat: Quat | None) -> Quat | None:
        if quat is not None and abs(math.hypot(*quat) - 1.0) > _UNIT_TOLERANCE:
            raise ValueError(f"has norm {math.hypot(*quat):.6g}, 1 is needed")
        return quat

    @pydantic.model_validator(mode="after")
    def _is_known_or_estimated(self) -> FrameEntry:
        if self.estimate:
            return self
        for key, example in (("xyz_m", "[0.0, 0.0, 0.0]"), ("quat_wxyz", "[1.0, 0.0, 0.0, 0.0]")):
            if getattr(self, key) is None:
                raise Contradiction(
                    key, "is missing", f"write {key} = {example}, or estimate = true if unknown"
                )
        return self


class JointEntry(Strict):
    """One joint and its link."""

    SYNONYMS: ClassVar[dict[str, str]] = {
        "theta_rad": "phi_rad", "theta": "phi_rad", "offset_rad": "phi_rad", "r_m": "a_m", "kind": "type",
    }  # fmt: skip

    name: str = ""
    """What people call the joint."""
    link: str = ""
    """What people call the link that it moves."""
    type: Literal["revolute", "prismatic"]
    """revolute turns, prismatic slides along its axis."""
    a_m: Length = pydantic.Field(examples=[0.0])
    """DH length a [m]."""
    alpha_rad: Angle = pydantic.Field(examples=["-pi/2"])
    """DH twist alpha [rad]."""
    d_m: Length = pydantic.Field(examples=[0.0])
    """DH offset d [m]."""
    phi_rad: Angle = pydantic.Field(examples=[0.0])
    """Offset of the joint angle at reading 0 [rad]."""
    q_min_rad: Real | None = pydantic.Field(default=None, examples=[-2.6])
    """Lower limit of the reading [rad]; of a prismatic joint [m]."""
    q_max_rad: Real | None = pydantic.Field(default=None, examples=[2.6])
    """Upper limit of the reading [rad]; of a prismatic joint [m]."""
    q_min_m: Real | None = None
    """Lower limit of a prismatic joint [m], in place of q_min_rad."""
    q_max_m: Real | None = None
    """Upper limit of a prismatic joint [m], in place of q_max_rad."""
    mass_kg: NotNegative | None = None
    """Mass of the link [kg]; effects of gravity need it, with com_m, on every joint."""
    com_m: Place | None = None
    """Centre of mass in the frame of the link [m]."""
    gear_ratio: Real | None = None
    """Motor turns per joint turn, not 0; effects of the motor need it on every joint."""

    @pydantic.field_validator("gear_ratio")
    @classmethod
    def _is_a_ratio(cls, ratio: float | None) -> float | None:
        if ratio == 0.0:
            raise ValueError("is 0, a joint that turns has a ratio; leave gear_ratio out if it is unknown")
        return ratio

    @pydantic.model_validator(mode="after")
    def _has_limits(self) -> JointEntry:
        for end in ("min", "max"):
            rad, m = f"q_{end}_rad", f"q_{end}_m"
            if self.type == "revolute" and getattr(self, m) is not None:
                raise Contradiction(
                    m, "is in metres, but the joint is revolute", f'write {rad}, or type = "prismatic"'
                )
            if getattr(self, rad) is None and getattr(self, m) is None:
                raise Contradiction(rad, "is missing", f"write {rad} = ..., the {end}imum of the reading")
            if getattr(self, rad) is not None and getattr(self, m) is not None:
                raise Contradiction(m, f"stands beside {rad}", "write one of the two")
        low, high = self.limits
        if not low < high:
            raise Contradiction("q_min_rad", f"is {low:g}, which is not below q_max_rad {high:g}")
        return self

    @pydantic.model_validator(mode="after")
    def _mass_has_its_place(self) -> JointEntry:
        if (self.mass_kg is None) != (self.com_m is None):
            given, other = ("mass_kg", "com_m") if self.com_m is None else ("com_m", "mass_kg")
            raise Contradiction(other, f"is missing beside {given}", "write both or neither")
        return self

    @property
    def limits(self) -> tuple[float, float]:
        """Lower and upper limit of the reading [rad or m]."""
        low = self.q_min_rad if self.q_min_m is None else self.q_min_m
        high = self.q_max_rad if self.q_max_m is None else self.q_max_m
        assert low is not None and high is not None
        return low, high


_INTRINSICS = ("fx_px", "fy_px", "cx_px", "cy_px")
_SIZE = ("width_px", "height_px")


class SensorEntry(Strict):
    """The camera or other sensor that measured the poses."""

    mount: Literal["world", "tool"] = "world"
    """world: the sensor stands, the target moves with the arm. tool: camera on the flange, target fixed;
    p and q of the data are the camera's pose in the target's frame."""
    fx_px: Positive | None = None
    """Focal length along u [px]; effects of the image position need all of fx, fy, cx, cy."""
    fy_px: Positive | None = None
    """Focal length along v [px]."""
    cx_px: Real | None = None
    """Principal point, u [px]."""
    cy_px: Real | None = None
    """Principal point, v [px]."""
    width_px: Positive | None = None
    """Width of the image [px]."""
    height_px: Positive | None = None
    """Height of the image [px]."""

    @pydantic.model_validator(mode="after")
    def _is_whole(self) -> SensorEntry:
        for group in (_INTRINSICS, _SIZE):
            absent = [key for key in group if getattr(self, key) is None]
            if absent and len(absent) < len(group):
                raise Contradiction(absent[0], "is missing", f"{', '.join(group)} belong together")
        return self


class TargetEntry(Strict):
    """What was measured."""

    points_m: list[Place] = pydantic.Field(min_length=1, examples=[[[0.0, 0.0, 0.0]]])
    """Points that one pose was computed from (corners of a board or tag), in the target's frame [m]."""
    second_points_m: list[Place] | None = pydantic.Field(None, min_length=1)
    """The same of poses with tag = 1: corners of a second tag, in the same frame [m]."""


class ArmFile(Strict):
    """An arm: DH parameters, base and tool frame, what is known about its masses and its sensor."""

    name: str = ""
    """What people call the arm; the file's name if absent."""
    convention: Literal["standard", "modified"]
    """DH convention: standard (distal, Rz Tz Tx Rx) or modified (proximal, Rx Tx Rz Tz)."""
    gravity_m_s2: Vec3 = pydantic.Field(examples=[[0.0, 0.0, -9.81]])
    """Gravity in the base frame [m/s^2]."""
    base: FrameEntry
    """Measurement frame -> frame 0."""
    tool: FrameEntry
    """Last link -> measured frame."""
    joint: list[JointEntry] = pydantic.Field(
        min_length=1, max_length=MAX_JOINTS, examples=["one [[joint]] table for each joint"]
    )
    """Joints from the base to the tool, 1 to 16."""
    sensor: SensorEntry = SensorEntry()
    """The sensor, where effects of it matter."""
    target: TargetEntry | None = None
    """The target, where the points behind a pose are known."""
    provenance: dict[str, str] = {}
    """Where the numbers come from."""

    @pydantic.field_validator("name")
    @classmethod
    def _is_seen(cls, name: str) -> str:
        if code := unseen(name):
            raise ValueError(f"holds {code}, which is not shown; write letters that are")
        return name

    @pydantic.field_validator("gravity_m_s2")
    @classmethod
    def _is_of_a_planet(cls, gravity: Vec3) -> Vec3:
        if math.hypot(*gravity) > MOST_GRAVITY_M_S2:
            raise ValueError(
                f"comes to {math.hypot(*gravity):.6g} m/s^2, more than {MOST_GRAVITY_M_S2:g} on no planet; "
                "write m/s^2: [0.0, 0.0, -9.81] on Earth"
            )
        return gravity

    @pydantic.model_validator(mode="after")
    def _masses_of_all_or_none(self) -> ArmFile:
        without = [number for number, joint in enumerate(self.joint, 1) if joint.mass_kg is None]
        if without and len(without) < len(self.joint):
            raise Contradiction(
                f"joint[{without[0]}].mass_kg",
                "is missing, but other joints have masses",
                "give every joint mass_kg and com_m, or none",
            )
        return self


# --------------------------------------------------------------------------- what the ground works with


@dataclass(frozen=True)
class Joint:
    """One joint and its link, standard DH; limits [rad or m]; com_m (x, y, z) in the standard link frame
    [m]."""

    prismatic: bool
    a_m: float
    alpha_rad: float
    d_m: float
    phi_rad: float
    q_min: float
    q_max: float
    mass_kg: float | None = None
    com_m: tuple[float, float, float] | None = None
    gear_ratio: float | None = None
    name: str = ""
    link: str = ""


@dataclass(frozen=True)
class Frame:
    """A fixed frame: xyz_m (3,) [m], unit quat_wxyz (4,); `estimate`: unknown, the fit finds it."""

    xyz_m: Array
    quat_wxyz: Array
    estimate: bool


@dataclass(frozen=True)
class Camera:
    """Intrinsics [px], only needed for effects that depend on the image position."""

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    width_px: float | None = None
    height_px: float | None = None


@dataclass(frozen=True, eq=False)
class ArmTable:
    """A serial arm in standard DH.

    base: measurement frame -> frame 0; tool: last link -> measured frame; gravity_m_s2 (3,) in the base
    frame.
    camera: intrinsics if the file has them; mount: "world" or "tool"; target_points_m (k, 3) in the target's
    frame or None; target_second_m (k, 3) those of poses with tag = 1 or None. source: the file; provenance:
    where its numbers come from, as it says; first_link: a [m] and alpha [rad] before joint 1 of a file in
    modified DH, which are in `base` here, None if the file is in standard DH.
    """

    name: str
    joints: tuple[Joint, ...]
    base: Frame
    tool: Frame
    gravity_m_s2: Array
    camera: Camera | None = None
    mount: str = "world"
    target_points_m: Array | None = None
    target_second_m: Array | None = None
    source: str = ""
    provenance: Mapping[str, str] = field(default_factory=dict)
    first_link: tuple[float, float] | None = None

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def has_masses(self) -> bool:
        """Whether every link has a mass and its centre, so that effects of gravity can be tested."""
        return all(joint.mass_kg is not None and joint.com_m is not None for joint in self.joints)


def dh_rows(arm: ArmTable) -> Array:
    """(n, 5) nominal joints: 1 for prismatic, a [m], alpha [rad], d [m], phi [rad], standard DH."""
    return np.array([(j.prismatic, j.a_m, j.alpha_rad, j.d_m, j.phi_rad) for j in arm.joints], dtype=float)


def same_joints(one: ArmTable, other: ArmTable) -> bool:
    """Whether two tables describe the same nominal arm, base and tool frame aside."""
    return one.n == other.n and np.allclose(dh_rows(one), dh_rows(other), rtol=0.0, atol=_SAME_DH)


def shipped_arms() -> dict[str, Traversable]:
    """Arm tables that come with the package, by name."""
    folder = resources.files("kincal_shared") / "arms"
    return {f.name.removesuffix(".toml"): f for f in folder.iterdir() if f.name.endswith(".toml")}


def read_arm(path: str | Path) -> ArmTable:
    """Read an arm table by path, or a shipped one by its name ("wam").

    SchemaError lists all that is wrong with the file; BadInput if there is none.
    """
    path, shipped = Path(path), shipped_arms()
    if str(path) in shipped and not path.is_file():  # a folder of that name is no arm table
        return read_shipped(str(path))
    if not path.exists():
        raise BadInput(
            "no such file, nor an arm that is shipped", str(path), f"shipped: {', '.join(shipped)}"
        )
    content = read_toml(path)
    if "kind" in content:  # which tables of flight have, and arm tables have not
        raise BadInput(
            f"this is a table of flight (kind = {content['kind']!r}), no arm table of the workbench",
            str(path),
            f"--arm takes an arm that is shipped ({', '.join(shipped)}) or a table of `kincal arm import`; "
            "flight's tables as shipped are those of the arm wam",
        )
    return _arm(validate(ArmFile, content, str(path)), str(path), path.stem)


@cache
def read_shipped(name: str) -> ArmTable:
    """A shipped arm table by its name, whatever lies in the current folder. KeyError if there is none."""
    with resources.as_file(shipped_arms()[name]) as file:
        return _arm(validate(ArmFile, read_toml(file), name), name, name)


def arm_of_text(text: str, source: str) -> ArmTable:
    """An arm table that is no file; source: what messages call it. SchemaError lists all that is wrong."""
    return _arm(validate(ArmFile, parse_toml(text, source), source), source, source)


def _arm(file: ArmFile, source: str, stem: str) -> ArmTable:
    joints, base = [_joint(entry) for entry in file.joint], _frame(file.base)
    if file.convention == "modified":
        joints, base = _from_modified(joints, base)
    return ArmTable(
        name=file.name or stem,
        joints=tuple(joints),
        base=base,
        tool=_frame(file.tool),
        gravity_m_s2=np.array(file.gravity_m_s2, dtype=float),
        camera=_camera(file.sensor),
        mount=file.sensor.mount,
        target_points_m=_points(file.target.points_m if file.target else None),
        target_second_m=_points(file.target.second_points_m if file.target else None),
        source=source,
        provenance=file.provenance,
        first_link=_first_link(file),
    )


def _points(rows: list[Vec3] | None) -> Array | None:
    return None if rows is None else np.array(rows, dtype=float)


def _first_link(file: ArmFile) -> tuple[float, float] | None:
    return (file.joint[0].a_m, file.joint[0].alpha_rad) if file.convention == "modified" else None


def other_convention(arm: ArmTable) -> ArmTable:
    """The arm that the same numbers mean in the other DH convention; the base frame is left as it is."""
    if arm.first_link is None:
        joints, _ = _from_modified(list(arm.joints), arm.base)
        return replace(arm, joints=tuple(joints), first_link=(arm.joints[0].a_m, arm.joints[0].alpha_rad))
    links = [arm.first_link, *((joint.a_m, joint.alpha_rad) for joint in arm.joints[:-1])]
    joints = [
        replace(joint, a_m=a_m, alpha_rad=alpha_rad)
        for joint, (a_m, alpha_rad) in zip(arm.joints, links, strict=True)
    ]
    return replace(arm, joints=tuple(joints), first_link=None)


def _camera(sensor: SensorEntry) -> Camera | None:
    values: dict[str, Any] = {key: getattr(sensor, key) for key in (*_INTRINSICS, *_SIZE)}
    return Camera(**values) if sensor.fx_px is not None else None


def _joint(entry: JointEntry) -> Joint:
    low, high = entry.limits
    return Joint(
        entry.type == "prismatic", entry.a_m, entry.alpha_rad, entry.d_m, entry.phi_rad, low, high,
        entry.mass_kg, entry.com_m, entry.gear_ratio, entry.name, entry.link,
    )  # fmt: skip


def _frame(entry: FrameEntry) -> Frame:
    quat = np.array(entry.quat_wxyz or (1.0, 0.0, 0.0, 0.0), dtype=float)
    xyz = np.array(entry.xyz_m or (0.0, 0.0, 0.0), dtype=float)
    return Frame(xyz, quat / float(np.linalg.norm(quat)), entry.estimate)


def _from_modified(joints: list[Joint], base: Frame) -> tuple[list[Joint], Frame]:
    """Modified (proximal) DH is the standard chain with a and alpha shifted by one link.

    prod Rx(al_{i-1}) Tx(a_{i-1}) Rz(th_i) Tz(d_i) = [Rx(al_0) Tx(a_0)] prod Rz(th_i) Tz(d_i) Tx(a_i) Rx(al_i)
    with a_n = alpha_n = 0: the first pair moves into the base frame.
    """
    from scipy.spatial.transform import Rotation  # takes longer to load than most commands to run

    following = [(joint.a_m, joint.alpha_rad) for joint in joints[1:]] + [(0.0, 0.0)]
    shifted = [
        replace(joint, a_m=a_m, alpha_rad=alpha_rad, com_m=_com_beyond(joint, a_m, alpha_rad))
        for joint, (a_m, alpha_rad) in zip(joints, following, strict=True)
    ]
    turn = Rotation.from_quat(base.quat_wxyz, scalar_first=True)
    xyz = base.xyz_m + turn.apply([joints[0].a_m, 0.0, 0.0])
    quat = (turn * Rotation.from_rotvec([joints[0].alpha_rad, 0.0, 0.0])).as_quat(scalar_first=True)
    return shifted, Frame(xyz, quat, base.estimate)


def _com_beyond(joint: Joint, a_m: float, alpha_rad: float) -> tuple[float, float, float] | None:
    """The centre of mass, from the modified to the standard frame of its link (by the same Tx Rx)."""
    if joint.com_m is None:
        return None
    from scipy.spatial.transform import Rotation

    moved = np.array(joint.com_m) - [a_m, 0.0, 0.0]
    x, y, z = Rotation.from_rotvec([alpha_rad, 0.0, 0.0]).inv().apply(moved)
    return float(x), float(y), float(z)
