"""The map of a measurements file that has its own column names and units (`--map`, docs/WORKBENCH.md)."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import pydantic

from .base import Strict
from .errors import Contradiction
from .numbers import Positive, Vec3

Name = Annotated[str, pydantic.Field(min_length=1)]
Names = Name | list[Name]

COUNT = {"wxyz": 4, "xyzw": 4, "rotvec": 3, "matrix": 9, "euler": 3}


class ColumnsEntry(Strict):
    """Name of the file's column for a quantity. Several columns: a list of names, or one name with {} for
    the number, which counts from 1."""

    SYNONYMS: ClassVar[dict[str, str]] = {
        "px": "p", "position": "p", "xyz": "p", "q1": "q", "joints": "q", "time": "t_s", "t": "t_s",
        "gx": "g", "gravity": "g", "dir1": "dir", "qdot1": "qdot", "temp": "temp_c", "cx": "cam",
    }  # fmt: skip

    q: Names | None = pydantic.Field(default=None, examples=["joint_{}"])
    """Encoder readings, one column a joint."""
    p: Names | None = pydantic.Field(default=None, examples=[["X", "Y", "Z"]])
    """Measured tool position, three columns."""
    dir: Names | None = None
    """Approach direction, one column a joint."""
    qdot: Names | None = None
    """Joint speeds, one column a joint."""
    g: Names | None = None
    """Gravity in the base frame, three columns."""
    cam: Names | None = None
    """Camera pose in the base frame, seven columns: position, quaternion with the scalar part first."""
    cov: Names | None = None
    """Upper triangle of the covariance, 21 columns row by row."""
    id: Name | None = None
    """Name of the pose."""
    t_s: Name | None = None
    """Time."""
    sp_m: Name | None = None
    """1-sigma noise of the position (of one target, where targets were measured)."""
    sr_rad: Name | None = None
    """1-sigma noise of the rotation."""
    temp_c: Name | None = None
    """Arm temperature [deg C]."""
    payload_kg: Name | None = None
    """Extra mass at the tool [kg]."""
    range_m: Name | None = None
    """Camera range."""
    incid_rad: Name | None = None
    """Incidence angle."""
    u_px: Name | None = None
    """Image position, u [px]."""
    v_px: Name | None = None
    """Image position, v [px]."""
    tag: Name | None = None
    """Tag seen: 0, 1, or 0.5 for both."""
    pan_rad: Name | None = None
    """Pan angle of the camera."""
    tilt_rad: Name | None = None
    """Tilt angle of the camera."""
    split: Name | None = None
    """fit or held."""
    replicate: Name | None = None
    """Number of the group of repeated poses; empty: not repeated."""


# Quantities of several columns, and of text; all others are one number a pose.
_SEVERAL = ("q", "p", "dir", "qdot", "g", "cam", "cov")
TEXTS = ("id", "split")
SCALARS = tuple(name for name in ColumnsEntry.model_fields if name not in (*_SEVERAL, *TEXTS))
# Those that say how a pose was measured. The others say how certain it is, or belong to the set.
RECORDED = tuple(name for name in SCALARS if name not in ("sp_m", "sr_rad", "replicate"))


class UnitsEntry(Strict):
    """Units of the file. A column that the file itself calls by a name with a unit (sp_m, t_s) is in that
    unit; all others are in these."""

    angle: Literal["rad", "deg"] = "rad"
    """Joint readings, Euler angles and all other angles."""
    length: Literal["m", "mm"] = "m"
    """Positions and all other lengths."""
    time: Literal["s", "ms", "us", "ns"] = "s"
    """Time."""


class RotationEntry(Strict):
    """How the file writes the measured orientation (tool in the base frame)."""

    form: Literal["wxyz", "xyzw", "rotvec", "matrix", "euler"]
    """Quaternion with the scalar part first or last, rotation vector, rotation matrix row by row, or Euler
    angles."""
    columns: Names = pydantic.Field(examples=[["A", "B", "C"]])
    """Columns: 4 of a quaternion, 3 of a rotation vector or of Euler angles, 9 of a matrix."""
    axes: Name | None = pydantic.Field(default=None, examples=["ZYX"])
    """Axes of Euler angles in the order of the columns: capitals about the axes as they turn (ZYX: yaw,
    pitch, roll), small letters about the fixed axes (xyz: roll, pitch, yaw)."""

    @pydantic.model_validator(mode="after")
    def _fits(self) -> RotationEntry:
        if isinstance(self.columns, list) and len(self.columns) != COUNT[self.form]:
            raise Contradiction(
                "columns", f"has {len(self.columns)} names, {self.form} needs {COUNT[self.form]}"
            )
        if self.form == "euler" and self.axes is None:
            raise Contradiction("axes", "is missing", 'write axes = "ZYX" (or the order of your file)')
        if self.form != "euler" and self.axes is not None:
            raise Contradiction("axes", f"has no meaning for {self.form}", "leave it out")
        if self.axes is not None and not _is_euler(self.axes):
            raise Contradiction(
                "axes",
                f'is "{self.axes}"',
                'write three of X, Y, Z, or three of x, y, z, no two neighbours equal: "ZYX"',
            )
        return self


def _is_euler(axes: str) -> bool:
    return (
        len(axes) == 3
        and (set(axes) <= set("XYZ") or set(axes) <= set("xyz"))
        and axes[0] != axes[1]
        and axes[1] != axes[2]
    )


class TargetsEntry(Strict):
    """Up to three targets on the tool whose positions were measured: three make a pose."""

    columns: list[Names] = pydantic.Field(min_length=1, max_length=3, examples=[["X1", "Y1", "Z1"]])
    """Three columns for each target."""
    tool_m: list[Vec3] | None = None
    """Where the targets are in the tool frame [m]. Without it the tool frame stands in the middle of the
    three, x from the first to the second, z across them; the arm table says `estimate = true` for it then."""
    tolerance_m: Positive = 1e-3
    """Largest distance of a target from where the rigid tool has it [m]."""

    @pydantic.model_validator(mode="after")
    def _fits(self) -> TargetsEntry:
        if self.tool_m is not None and len(self.tool_m) != len(self.columns):
            raise Contradiction(
                "tool_m", f"has {len(self.tool_m)} points, there are {len(self.columns)} targets"
            )
        return self


class TextEntry(Strict):
    """How a text file is written, where the program should not find it out by itself."""

    separator: Literal[",", ";", "\t", " "] | None = None
    """Between the columns."""
    decimal: Literal[".", ","] | None = None
    """Decimal sign."""
    header: pydantic.StrictBool = True
    """false: there is no header row; the columns are called "1", "2" and so on."""


class RosEntry(Strict):
    """Topics of a ROS bag."""

    joint_topic: Name | None = pydantic.Field(default=None, examples=["/joint_states"])
    """Topic of sensor_msgs/JointState; the only one if absent."""
    pose_topic: Name | None = pydantic.Field(default=None, examples=["/tracker/pose"])
    """Topic of geometry_msgs/PoseStamped; the only one if absent."""
    joint_names: list[Name] | None = None
    """Names of the joints in the order of the arm table; the arm table's names if absent."""
    tolerance_s: Positive = 0.02
    """Largest time between a pose and the joint state that belongs to it [s]."""


# "q3 + q2": a reading, and that of another joint which is added to it or taken from it
Sum = Annotated[str, pydantic.StringConstraints(pattern=r"^q[1-9][0-9]? [+-] q[1-9][0-9]?$")]
Reading = Annotated[str, pydantic.StringConstraints(pattern=r"^q[1-9][0-9]?$")]


class DataMap(Strict):
    """What the columns of a measurements file mean."""

    columns: ColumnsEntry = ColumnsEntry()
    """Names of the columns."""
    units: UnitsEntry = UnitsEntry()
    """Units of the columns."""
    rotation: RotationEntry | None = None
    """The orientation, where it is no quaternion qw, qx, qy, qz."""
    readings: dict[Reading, Sum] = pydantic.Field(default={}, examples=[{"q3": "q3 + q2"}])
    """Joints whose readings contain those of another one, as a FANUC controller states joint 3: what the
    joint angle is, of the readings in the file."""
    targets: TargetsEntry | None = None
    """Targets on the tool."""
    text: TextEntry = TextEntry()
    """Text files."""
    ros: RosEntry = RosEntry()
    """ROS bags."""

    @pydantic.model_validator(mode="after")
    def _one_source_of_the_pose(self) -> DataMap:
        for name, text in self.readings.items():
            one, _, other = text.split()
            if one == other or name not in (one, other):
                raise Contradiction(
                    f"readings.{name}",
                    f'is "{text}"',
                    f"write {name} and one other joint, the sum or the difference",
                )
        if self.targets is not None and self.columns.p is not None:
            raise Contradiction("columns.p", "stands beside [targets]", "write one of the two")
        return self
