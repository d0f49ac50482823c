"""A URDF as an arm table of the workbench, checked against the URDF."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kincal.rotations import Pose, rotvec_of_matrix
from kincal_shared.errors import CannotAnswer
from kincal_shared.schema.arm import MAX_JOINTS, ArmFile
from kincal_shared.schema.errors import parse_toml, validate

from .axes import DhChain, DhRow, dh_chain
from .urdf import ChainJoint, Step, UrdfChain, read_chain, tip_pose

Floats = NDArray[np.float64]

_CHECKED = 100  # random joint vectors
_SEED = 1  # of the joint vectors, so that the check is the same every time
_TOLERANCE = 1e-9  # [m, rad] above which the conversion itself failed
_FAR_M = 10.0  # DH lengths above it come from axes that are almost parallel
_SKEW_RAD = 0.2  # axes of which at least that is skew cross within the reach of an arm
_CLEAN = 1e-15  # [m, rad] numbers below it are 0
_TURN_RAD = 2.0 * math.pi


@dataclass(frozen=True)
class Difference:
    """Largest difference between two chains over the joint vectors of the check."""

    position_m: float
    rotation_rad: float

    @property
    def largest(self) -> float:
        """The larger of the two numbers."""
        return max(self.position_m, self.rotation_rad)


@dataclass(frozen=True)
class ImportedArm:
    """An arm table made from a URDF.

    text: the TOML; joints: names of the moving joints; difference: table against the file as written, at 100
    random joint vectors; notes: what people should know (rounded angles, missing limits or masses).
    """

    text: str
    robot: str
    joints: tuple[str, ...]
    difference: Difference
    has_masses: bool
    notes: tuple[str, ...]


def import_urdf(
    path: Path, base: str | None = None, tip: str | None = None, *, estimate_frames: bool = False
) -> ImportedArm:
    """The serial chain between two links of a URDF as an arm table, checked at 100 random joint vectors.

    estimate_frames: base and tool frame are unknown; what the URDF says of them stands beside that.

    BadInput for a file that holds no such chain; CannotAnswer if the chain does not fit into a table (more
    than 16 joints, axes so near parallel that the table would be wrong).
    """
    chain = read_chain(path, base, tip)
    if len(chain.joints) > MAX_JOINTS:
        raise CannotAnswer(
            f"the chain has {len(chain.joints)} moving joints, an arm table has room for {MAX_JOINTS}",
            str(path),
            "choose --base or --tip nearer",
        )
    dh = dh_chain([joint.axis for joint in chain.joints])
    text = _toml(chain, dh, path, estimate_frames)
    table = validate(ArmFile, parse_toml(text, str(path)), str(path))
    own = _difference(table, chain, chain.steps)
    if not own.largest <= _TOLERANCE:
        raise CannotAnswer(
            f"the DH table differs from the URDF by {own.position_m:.1e} m, {own.rotation_rad:.1e} rad",
            str(path),
            "two axes are almost parallel; import the nominal URDF, in which they are parallel",
        )
    return ImportedArm(
        text=text,
        robot=chain.robot,
        joints=tuple(joint.name for joint in chain.joints),
        difference=_difference(table, chain, chain.written),
        has_masses=_has_masses(chain),
        notes=tuple(_notes(chain, dh)),
    )


# --------------------------------------------------------------------------- check


def _difference(table: ArmFile, chain: UrdfChain, steps: tuple[Step, ...]) -> Difference:
    rng = np.random.default_rng(_SEED)
    low, high = np.array([_range(joint) for joint in chain.joints]).T
    worst_m, worst_rad = 0.0, 0.0
    for q in rng.uniform(low, high, (_CHECKED, len(low))):
        got, want = _table_pose(table, q), tip_pose(steps, q)
        worst_m = max(worst_m, float(np.linalg.norm(got.p_m - want.p_m)))
        worst_rad = max(worst_rad, float(np.linalg.norm(rotvec_of_matrix(got.R @ want.R.T))))
    return Difference(worst_m, worst_rad)


def _table_pose(table: ArmFile, q: Floats) -> Pose:
    """Pose of the measured frame by the numbers that stand in the table."""
    pose = Pose.of_wxyz(table.base.xyz_m or (), table.base.quat_wxyz or ())
    for joint, value in zip(table.joint, q, strict=True):
        row = DhRow(joint.phi_rad, joint.d_m, joint.a_m, joint.alpha_rad)
        pose = pose @ row.pose(float(value), joint.type == "prismatic")
    return pose @ Pose.of_wxyz(table.tool.xyz_m or (), table.tool.quat_wxyz or ())


def _range(joint: ChainJoint) -> tuple[float, float]:
    """Limits of a joint; without, a turn or a metre to either side."""
    span = 1.0 if joint.prismatic else _TURN_RAD
    return joint.limits or (-span, span)


def _has_masses(chain: UrdfChain) -> bool:
    return all(joint.mass_kg > 0.0 for joint in chain.joints)


def _notes(chain: UrdfChain, dh: DhChain) -> list[str]:
    notes = []
    if chain.snapped:
        notes.append(
            "angles within 1e-5 rad of a multiple of 90 degrees were rounded to it: "
            + ", ".join(chain.snapped)
        )
    unlimited = [joint.name for joint in chain.joints if joint.limits is None]
    if unlimited:
        notes.append(f"no limits in the URDF, a turn or 1 m to either side assumed: {', '.join(unlimited)}")
    without = [joint.name for joint in chain.joints if not joint.mass_kg > 0.0]
    if without and len(without) < len(chain.joints):
        notes.append(f"no masses in the table, since these joints carry none: {', '.join(without)}")
    elif without:
        notes.append("the URDF has no masses: effects of gravity are not testable until the table has them")
    for joint, row in zip(chain.joints, dh.rows, strict=True):
        skew_rad = abs(math.sin(row.alpha_rad))
        far = max(abs(row.d_m), abs(row.a_m)) > _FAR_M
        if far and skew_rad < _SKEW_RAD:  # the next row, whatever its angle, leads back
            notes.append(
                f"joint {joint.name} and the next are almost parallel, {skew_rad:.1e} rad "
                f"(d = {row.d_m:.6g} m); the nominal URDF, with parallel axes, is the better start"
            )
    return notes


# --------------------------------------------------------------------------- file


def _toml(chain: UrdfChain, dh: DhChain, path: Path, estimate_frames: bool) -> str:
    tool = dh.base
    for joint, row in zip(chain.joints, dh.rows, strict=True):
        tool = tool @ row.pose(0.0, joint.prismatic)
    lines = [
        f"# {chain.robot}, {chain.base_link} to {chain.tip_link}, made by `kincal arm import`.",
        f"name = {_text(chain.robot)}",
        'convention = "standard"',
        "gravity_m_s2 = [0.0, 0.0, -9.81]",
        "",
        f"# {chain.base_link} -> frame 0; estimate = true if the data are in another frame",
        *_frame("base", dh.base, estimate_frames),
        "",
        f"# last link -> {chain.tip_link}; estimate = true if another point was measured",
        *_frame("tool", tool.inverse @ chain.tip, estimate_frames),
    ]
    masses = _has_masses(chain)
    for joint, row, link in zip(chain.joints, dh.rows, dh.links, strict=True):
        lines += ["", *_joint(joint, row)]
        if masses:
            lines += [f"mass_kg = {joint.mass_kg!r}", f"com_m = {_numbers(link.inverse.apply(joint.com_m))}"]
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    lines += ["", "[provenance]", f"urdf = {_text(path.name)}", f'sha256 = "{digest}"',
              f"base_link = {_text(chain.base_link)}", f"tip_link = {_text(chain.tip_link)}"]  # fmt: skip
    if chain.snapped:
        lines.append(f"rounded_to_90_degrees = {_text('; '.join(chain.snapped))}")
    return "\n".join(lines) + "\n"


def _frame(name: str, pose: Pose, estimate: bool) -> list[str]:
    quat = _numbers(pose.quat_wxyz)
    return [f"[{name}]", f"xyz_m = {_numbers(pose.p_m)}", f"quat_wxyz = {quat}",
            f"estimate = {str(estimate).lower()}"]  # fmt: skip


def _joint(joint: ChainJoint, row: DhRow) -> list[str]:
    low, high = _range(joint)
    unit = "m" if joint.prismatic else "rad"
    return [
        "[[joint]]",
        f"name = {_text(joint.name)}",
        f"link = {_text(joint.link)}",
        f'type = "{"prismatic" if joint.prismatic else "revolute"}"',
        f"a_m = {_number(row.a_m)}",
        f"alpha_rad = {_angle(row.alpha_rad)}",
        f"d_m = {_number(row.d_m)}",
        f"phi_rad = {_angle(row.phi_rad)}",
        f"q_min_{unit} = {low!r}",
        f"q_max_{unit} = {high!r}",
    ]


def _text(text: str) -> str:
    """A TOML string: JSON's escapes are TOML's."""
    return json.dumps(text, ensure_ascii=False)


def _number(value: float) -> str:
    return repr(0.0 if abs(value) < _CLEAN else float(value))


def _angle(value: float) -> str:
    """Multiples of a right angle in words, so that people see them."""
    for quarters, text in ((1, '"pi/2"'), (-1, '"-pi/2"'), (2, '"pi"'), (-2, '"-pi"')):
        if abs(value - quarters * math.pi / 2.0) < _CLEAN:
            return text
    return _number(value)


def _numbers(values: Floats) -> str:
    return f"[{', '.join(_number(float(value)) for value in values)}]"
