"""A serial chain of a URDF: its moving joints with axes, limits and the masses that they carry."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from kincal.rotations import Pose
from kincal_shared import installation
from kincal_shared.errors import BadInput
from kincal_shared.schema.suggestions import nearest_name

from .axes import Axis

Floats = NDArray[np.float64]

MOVING = ("revolute", "continuous", "prismatic")
# A right angle written with few digits (1.5708) leaves axes almost parallel, with a common normal kilometres
# away. Within this much of a multiple of 90 degrees an angle is taken to be that multiple, and it is said.
SNAP_RAD = 1e-5
_SAID_RAD = 1e-9  # smaller roundings change nothing that can be measured
_LISTED = 12  # names that an error lists


@dataclass(frozen=True)
class ChainJoint:
    """A moving joint of the chain and the link that it moves.

    limits [rad or m], None if the URDF states none; axis at q = 0 in the base link; mass_kg, com_m (3,): of
    all that it carries up to the next moving joint, in the base link at q = 0 (mass 0 if the URDF has none).
    """

    name: str
    link: str
    prismatic: bool
    limits: tuple[float, float] | None
    axis: Axis
    mass_kg: float
    com_m: Floats


@dataclass(frozen=True)
class Step:
    """A joint as the URDF writes it: fixed transform, then the motion along or about `axis` (None: fixed)."""

    origin: Pose
    axis: Floats | None
    prismatic: bool


@dataclass(frozen=True)
class UrdfChain:
    """Moving joints from base to tip, pose of the tip at q = 0 in the base link, and the steps of the file.

    snapped: joints whose angles were rounded to a multiple of 90 degrees, in words; joints, tip and steps
    have the rounded angles, written has them as they stand in the file.
    """

    robot: str
    base_link: str
    tip_link: str
    joints: tuple[ChainJoint, ...]
    tip: Pose
    steps: tuple[Step, ...]
    written: tuple[Step, ...]
    snapped: tuple[str, ...]


def tip_pose(steps: Sequence[Step], q: Floats) -> Pose:
    """Pose of the tip in the base link for joint values q (n,) [rad or m]: the file's own transforms, one
    after the other."""
    pose, values = Pose.identity(), iter(q)
    for step in steps:
        pose = pose @ step.origin
        if step.axis is not None:
            move = step.axis * float(next(values))
            turn = np.eye(3) if step.prismatic else Rotation.from_rotvec(move).as_matrix()
            pose = pose @ Pose(move if step.prismatic else np.zeros(3), turn)
    return pose


def read_chain(path: Path, base: str | None = None, tip: str | None = None) -> UrdfChain:
    """The chain between two links of a URDF; without names from the root to the only leaf.

    BadInput says which links there are, or what in the file has no place in a serial chain.
    """
    robot = _parse(path)
    where = str(path)
    base, tip = _ends(robot, base, tip, where)
    joints = _joint_path(robot, base, tip, where)
    _check_joints(joints, where)
    written = [_step(joint, where) for joint in joints]
    rounded = [_snap(step.origin) for step in written]
    steps = [Step(pose, step.axis, step.prismatic) for (pose, _), step in zip(rounded, written, strict=True)]
    snapped = tuple(
        f"joint {joint.name}: {size:.1e} rad"
        for joint, (_, size) in zip(joints, rounded, strict=True)
        if size > _SAID_RAD
    )
    poses = _poses(steps)
    return UrdfChain(
        robot=robot.name or path.stem,
        base_link=base,
        tip_link=tip,
        joints=_chain_joints(robot, joints, steps, poses),
        tip=poses[-1],
        steps=tuple(steps),
        written=tuple(written),
        snapped=snapped,
    )


def _refuse_other(path: Path) -> None:
    """BadInput for what is no XML: the parser would print what its library thinks of it."""
    text = path.read_bytes().lstrip(b"\xef\xbb\xbf \t\r\n")
    if not text.startswith((b"<", b"\xff\xfe", b"\xfe\xff")):
        todo = "name a URDF: XML that begins with <robot>"
        raise BadInput("not a URDF: " + ("no XML" if text else "the file is empty"), str(path), todo)


def _parse(path: Path) -> Any:
    """The robot as the parser has it: links, joints, name."""
    installation.require("urdf", "reading a URDF")
    if not path.is_file():
        raise BadInput("no such file", str(path), "name a URDF")
    _refuse_xacro(path)
    _refuse_other(path)
    import yourdfpy

    logging.getLogger("yourdfpy").setLevel(logging.ERROR)
    try:
        robot: Any = yourdfpy.URDF.load(str(path), build_scene_graph=False, load_meshes=False).robot
    except Exception as error:  # the parser passes on whatever its XML library and float() raise
        raise BadInput(
            f"not a URDF: {error}", str(path), "name a URDF: XML that begins with <robot>"
        ) from None
    if not robot.links:
        raise BadInput("not a URDF: it has no links", str(path))
    return robot


def _refuse_xacro(path: Path) -> None:
    """The parser takes macros for nothing: the arm would lack what they stand for."""
    if b"xacro:" in path.read_bytes():
        todo = (
            f"expand it first: `xacro {path.name} > robot.urdf` (ROS package xacro), then import robot.urdf"
        )
        raise BadInput("this is a xacro file: its macros are not expanded", str(path), todo)


# --------------------------------------------------------------------------- which joints


def _ends(robot: Any, base: str | None, tip: str | None, where: str) -> tuple[str, str]:
    links = [link.name for link in robot.links]
    children, parents = {j.child for j in robot.joints}, {j.parent for j in robot.joints}
    roots = [name for name in links if name not in children]
    leaves = [name for name in links if name not in parents]
    for flag, name in (("--base", base), ("--tip", tip)):
        if name is not None and name not in links:
            near = nearest_name(name, links)
            todo = f"did you mean {near}? " if near else ""
            raise BadInput(f"{flag}: there is no link {name!r}", where, f"{todo}links are {_listed(links)}")
    if base is None and len(roots) != 1:
        raise BadInput(f"the tree has {len(roots)} roots", where, f"name one with --base: {_listed(roots)}")
    if tip is None and len(leaves) != 1:
        raise BadInput(f"the tree has {len(leaves)} ends", where, f"name one with --tip: {_listed(leaves)}")
    return base or roots[0], tip or leaves[0]


def _listed(names: Sequence[str]) -> str:
    more = f" ... ({len(names)} in all)" if len(names) > _LISTED else ""
    return ", ".join(names[:_LISTED]) + more


def _joint_path(robot: Any, base: str, tip: str, where: str) -> list[Any]:
    """Joints from base to tip."""
    by_child = {joint.child: joint for joint in robot.joints}
    path: list[Any] = []
    link = tip
    while link != base:
        if link not in by_child or len(path) == len(by_child):
            above = [joint.parent for joint in path]
            todo = f"links between it and the root are {_listed(above)}" if above else "exchange the two?"
            raise BadInput(f"link {tip!r} does not hang on link {base!r}: no serial chain", where, todo)
        path.append(by_child[link])
        link = by_child[link].parent
    return path[::-1]


def _check_joints(joints: Sequence[Any], where: str) -> None:
    for joint in joints:
        if joint.type != "fixed" and joint.type not in MOVING:
            raise BadInput(
                f"joint {joint.name!r} is {joint.type}; an arm has {', '.join(MOVING)} and fixed joints",
                where,
                f"begin the chain behind it: --base {joint.child}",
            )
        if joint.mimic is not None and joint.type != "fixed":
            raise BadInput(
                f"joint {joint.name!r} follows joint {joint.mimic.joint!r} (mimic): it has no own reading",
                where,
                f"end the chain before it (--tip {joint.parent}), or begin it behind (--base {joint.child})",
            )
    if all(joint.type == "fixed" for joint in joints):
        raise BadInput(
            "no moving joint between base and tip", where, "choose links further apart with --base and --tip"
        )


# --------------------------------------------------------------------------- what they do


def _step(joint: Any, where: str) -> Step:
    origin = _pose(joint.origin)
    if joint.type == "fixed":
        return Step(origin, None, False)
    axis = np.array([1.0, 0.0, 0.0]) if joint.axis is None else np.array(joint.axis, dtype=float)
    length = float(np.linalg.norm(axis))
    if not length > 0.0:
        raise BadInput(
            f"joint {joint.name!r} has an axis of length {length:g}", where, 'write axis xyz="0 0 1"'
        )
    return Step(origin, axis / length, joint.type == "prismatic")


def _pose(origin: Any) -> Pose:
    return Pose.identity() if origin is None else Pose.of_matrix(origin)


def _snap(origin: Pose) -> tuple[Pose, float]:
    """The transform with its roll, pitch, yaw rounded to multiples of 90 degrees where they are that near,
    and the largest rounding [rad]."""
    whole = np.round(origin.R)
    # A rotation by multiples of 90 degrees about all three axes is a signed permutation of the axes.
    if np.abs(origin.R - whole).max() < SNAP_RAD:
        return Pose(origin.p_m, whole), float(np.abs(origin.R - whole).max())
    rpy = _roll_pitch_yaw(origin.R)
    step = math.pi / 2.0
    near = np.round(rpy / step) * step
    size = np.abs(rpy - near)
    exact = (size < SNAP_RAD) & (size > 0.0)
    if not exact.any():
        return origin, 0.0
    turn = Rotation.from_euler("xyz", np.where(exact, near, rpy)).as_matrix()
    turn[np.abs(turn) < 1e-16] = 0.0
    return Pose(origin.p_m, turn), float(size[exact].max())


def _roll_pitch_yaw(R: Floats) -> Floats:
    """(3,) angles of Rz(yaw) Ry(pitch) Rx(roll), as URDF has them; roll 0 where pitch is a right angle."""
    pitch = math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0]))
    if math.hypot(R[0, 0], R[1, 0]) < SNAP_RAD:
        return np.array([0.0, pitch, math.atan2(-R[0, 1], R[1, 1])])
    return np.array([math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])])


def _poses(steps: Sequence[Step]) -> list[Pose]:
    """Frame of each joint at q = 0 in the base link."""
    poses, pose = [], Pose.identity()
    for step in steps:
        pose = pose @ step.origin
        poses.append(pose)
    return poses


def _chain_joints(
    robot: Any, joints: Sequence[Any], steps: Sequence[Step], poses: Sequence[Pose]
) -> tuple[ChainJoint, ...]:
    inertials = {link.name: link.inertial for link in robot.links}
    out = []
    for k, (joint, step, pose) in enumerate(zip(joints, steps, poses, strict=True)):
        if step.axis is None:
            continue
        later = {other.name for other in joints[k + 1 :] if other.type != "fixed"}
        mass, com = _carried(robot, inertials, joint.child, pose, later)
        direction = pose.R @ step.axis
        axis = Axis(pose.p_m.copy(), direction / float(np.linalg.norm(direction)))
        out.append(ChainJoint(joint.name, joint.child, step.prismatic, _limits(joint), axis, mass, com))
    return tuple(out)


def _limits(joint: Any) -> tuple[float, float] | None:
    if joint.limit is None or joint.type == "continuous":
        return None
    lower, upper = joint.limit.lower or 0.0, joint.limit.upper or 0.0
    return (float(lower), float(upper)) if lower < upper else None


def _carried(
    robot: Any, inertials: dict[str, Any], link: str, pose: Pose, later: set[str]
) -> tuple[float, Floats]:
    """Mass and centre of everything that moves with a link, side branches included, at q = 0."""
    mass, moment, open_links = 0.0, np.zeros(3), [(link, pose)]
    while open_links:
        name, at = open_links.pop()
        inertial = inertials[name]
        if inertial is not None and inertial.mass:
            centre = (at @ _pose(inertial.origin)).p_m
            mass, moment = mass + float(inertial.mass), moment + float(inertial.mass) * centre
        open_links += [
            (joint.child, at @ _pose(joint.origin))
            for joint in robot.joints
            if joint.parent == name and joint.name not in later
        ]
    return mass, moment / mass if mass else np.zeros(3)
