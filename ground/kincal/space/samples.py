"""Sampled tool poses, and what becomes of them: the work of a search that processes share out (workers.py).

Every function takes the checks first and depends on nothing else, so that results do not depend on who does
the work."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kincal.flight import library
from kincal.rotations import Pose, pose_difference
from kincal_shared.schema.space import Vec3

from .arrays import Floats
from .checks import Checks
from .error_sampling import Stream
from .reasons import Reason
from .table import Row, stop_joints

if TYPE_CHECKING:
    from kincal.flight.headers import KcCamera

BLOCK = 250  # tool poses from one stream of random numbers
STOP_STEP = 8  # parts between places that are tried for a stop
_STARTS = 3  # of the inverse kinematics for one tool pose
_POSE_TOL = 1e-5  # m or rad, between a pose of the table and where its joints lead


@dataclass(frozen=True)
class Sample:
    """A tool position [m, base frame] that was examined: joints if it was reached, and why it was rejected
    ("" if it was not)."""

    p_m: Floats
    q_rad: Floats | None
    rejection: str


@dataclass(frozen=True)
class Box:
    """Tool positions between lo and hi [m, base frame]."""

    lo_m: Vec3
    hi_m: Vec3


@dataclass(frozen=True)
class Verdict:
    """Hub of a candidate that was verified (-1: none), and why it was rejected ("" if it was not)."""

    hub: int
    rejection: str


@dataclass(frozen=True)
class RowCheck:
    """What does not hold for a row of a table, and how many of the sampled postures of its servo bound touch
    something."""

    problems: list[str]
    contacts: int


def _facing(z: Floats) -> Floats:
    """Rotations (n, 3, 3) whose z axes are the unit vectors z (n, 3), some turn about it."""
    x = np.cross(z, np.where(np.abs(z[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]))
    x /= np.linalg.norm(x, axis=1)[:, None]
    return np.stack([x, np.cross(z, x), z], axis=2)


def _rotations(q_wxyz: Floats) -> Floats:
    """(n, 3, 3) of unit quaternions (n, 4), by flight's code. Inverse kinematics from far away amplifies the
    last bit of a pose to other joints, so another formula would give another table."""
    flight, q = library("flight"), np.ascontiguousarray(q_wxyz)
    R = np.empty((len(q), 3, 3))
    source, target = flight.pointer(q), flight.pointer(R)
    for i in range(len(q)):
        flight.lib.kc_quat_to_R(source + 4 * i, target + 9 * i)
    return R


def _tag_rotations(camera: KcCamera) -> Floats:
    """Of the tags in the tool frame, (tags, 3, 3)."""
    q = np.array([list(tag.quat_wxyz) for tag in camera.tag[0 : camera.n_tags]])
    return _rotations(np.array([x / np.linalg.norm(x) for x in q]))


def tool_poses(checks: Checks, rng: np.random.Generator, n: int, box: Box) -> Pose:
    """n tool poses in the base frame: positions (n, 3) [m] even in a box; rotations (n, 3, 3) by a tag,
    its incidence inside the cone of the description, the side it leans to and the turn about the line of
    sight, all even."""
    p_m = rng.uniform(box.lo_m, box.hi_m, (n, 3))
    tag = rng.integers(checks.view.n_tags, size=n)
    incid = np.arccos(rng.uniform(np.cos(checks.desc.view.incid_max_rad), 1.0, n))
    lean, turn = rng.uniform(-np.pi, np.pi, (2, n))
    z = p_m - checks.view.aim(Pose(p_m, np.tile(np.eye(3), (n, 1, 1)))).camera.p_m
    z /= np.linalg.norm(z, axis=1)[:, None]
    c, s, none = np.cos(0.5 * incid), np.sin(0.5 * incid), np.zeros(n)
    leaning = _rotations(np.stack([c, s * np.cos(lean), s * np.sin(lean), none], axis=1))
    turned = _rotations(np.stack([np.cos(0.5 * turn), none, none, np.sin(0.5 * turn)], axis=1))
    R_tag_tool = _tag_rotations(checks.camera).transpose(0, 2, 1)
    return Pose(p_m, _facing(z) @ leaning @ turned @ R_tag_tool[tag])


def examine(checks: Checks, block: int, count: int, box: Box) -> list[Sample]:
    """Tool poses of one stream: in view, reached, tags not hidden, nominal arm clear?"""
    rng = np.random.default_rng([checks.desc.seed, Stream.TOOL_POSES, block])
    poses = tool_poses(checks, rng, count, box)
    kin = checks.kinematics
    starts = rng.uniform(kin.lo, kin.hi, (_STARTS, count, kin.n))
    in_view, _ = checks.view.problems(poses.p_m, checks.view.aim(poses))
    rejections = [reason or str(Reason.UNREACHED) for reason in in_view]
    joints: list[Floats | None] = [None] * count
    left = np.flatnonzero(~kin.beyond_reach(poses) & [not reason for reason in in_view])
    for start in starts:  # another elbow may do
        q, found = kin.solve(poses[left], start[left])
        for i, x, reason in zip(left[found], q[found], checks.problems(q[found]), strict=True):
            joints[i], rejections[i] = x, reason
        left = np.array([i for i in left if rejections[i]], int)
    return [Sample(*s) for s in zip(poses.p_m, joints, rejections, strict=True)]


def verify(checks: Checks, q_rad: Floats) -> Verdict:
    """Whether a candidate stays clear with errors, inside its servo bound and on a segment from a hub."""
    if problem := checks.error_problem(q_rad) or checks.servo_bound_problem(q_rad):
        return Verdict(-1, problem)
    hub = checks.nearest_hub(q_rad)
    return Verdict(-1, str(Reason.NO_SEGMENT)) if hub is None else Verdict(hub, "")


def detections(checks: Checks, q_rad: Floats) -> int:
    """How many of the arms with errors show a tag at joints q."""
    return sum(checks.detected_with_errors(q_rad))


def stops_on(checks: Checks, hub_rad: Floats, q_rad: Floats) -> list[int]:
    """Places of stops on the verified segment from a hub to a candidate, in parts of `stop_joints`: evenly
    along it, each the nearest place that holds."""
    parts, most = library("flight").lib.KC_STOP_PARTS, checks.desc.stops.most
    span_rad = float(np.max(np.abs(q_rad - hub_rad)))
    gap = int(np.ceil(parts * checks.desc.stops.spacing_rad / max(span_rad, 1e-9)))
    found, last = [], 0
    for k in range(most):
        middle, half = round(parts * (k + 1) / (most + 1)), parts // (2 * (most + 1))
        near = sorted(range(middle - half, middle + half, STOP_STEP), key=lambda part: abs(part - middle))
        free = (part for part in near if last + gap <= part <= parts - gap)
        held = (part for part in free if not checks.stop_problem(stop_joints(hub_rad, q_rad, part)))
        if part := next(held, 0):
            found.append(part)
            last = part
    return found


def segment_clear(checks: Checks, a_rad: Floats, b_rad: Floats) -> bool:
    """Whether the straight joint-space segment is clear for the nominal arm and all arms with errors."""
    return not checks.clearance.segment_contact(a_rad, b_rad)


def check_row(checks: Checks, row: Row, bound_rad: Floats) -> RowCheck:
    """A candidate of a table again, by its own hub, pose and tags and the table's servo bound (joints,);
    postures inside the bound with other random numbers than the search used."""
    q = row.q_rad
    what = [*filter(None, checks.problems(q)), *_off_pose(checks, row)]
    if not what and (shown := checks.visible_tags(q)) != row.tags:
        what.append(f"shows tags {shown:02b}, the table says {row.tags:02b}")
    what += filter(None, [checks.error_problem(q)])
    if pair := checks.clearance.segment_contact(row.hub_q_rad, q):
        what.append(f"segment from its hub not clear: {pair}")
    at = [(part, stop_joints(row.hub_q_rad, q, part)) for part in row.stops]
    what += [f"stop {part}: {problem}" for part, stop in at if (problem := checks.stop_problem(stop))]
    rng = checks.stream(Stream.RECHECK, q)
    tries = (
        checks.servo_bound_contact(q, bound_rad, 1, rng) for _ in range(checks.desc.clear.servo_bound_samples)
    )
    return RowCheck(what, sum(map(bool, tries)))


def _off_pose(checks: Checks, row: Row) -> list[str]:
    """Whether the joints of a row lead to its pose."""
    difference = pose_difference(checks.kinematics.poses(row.q_rad)[0], row.pose)
    off_m, turn_rad = np.linalg.norm(difference[:3]), np.linalg.norm(difference[3:])
    if max(off_m, turn_rad) <= _POSE_TOL:
        return []
    return [f"its joints lead {off_m * 1e3:.1f} mm and {turn_rad * 1e3:.1f} mrad beside its pose"]
