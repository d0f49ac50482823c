"""A SPACE table as flight reads it, with what the collision guard on board knows of arm and surroundings.

Flight knows capsules only, so a box on the arm becomes a bundle of capsules that it lies in."""

from __future__ import annotations

import itertools
import re
from typing import TYPE_CHECKING, cast

import numpy as np

from kincal.flight import library, tables
from kincal.rotations import Pose
from kincal_shared.errors import BadInput
from kincal_shared.schema.dh import DH_FIELDS
from kincal_shared.schema.space import Description, KeepOut, Shape

from .arrays import Floats
from .table import SpaceTable, pack_direct

if TYPE_CHECKING:
    from kincal.flight.headers import CData, KcCamera, KcSpace, KcVolume

EXCESS_MAX_M = 0.012  # that far the capsules of a box may stand out of it; the ground verifies 10 mm or more
STRIPS_MAX = 8  # capsules side by side in each direction
Capsule = tuple[Floats, Floats, float]  # ends [m], radius [m]


def encode(table: SpaceTable, desc: Description, camera: KcCamera) -> tables.Image:
    """The table image. BadInput if shapes or volumes exceed what flight has room for."""
    space = library("flight").new("kc_space_t")
    _write_poses(space, table)
    _write_roadmap(space, table)
    _write_stops(space, table)
    write_guard(space, desc, camera)
    space.servo_bound[0 : table.n_joints] = table.servo_bound_rad.tolist()
    space.arm_crc = table.arm_crc
    for joint, bounds in zip(space.verified, table.verified.tolist(), strict=False):
        for field, bound in zip(DH_FIELDS, bounds, strict=True):
            setattr(joint, field, bound)
    return tables.encode("space", space)


def _write_poses(space: KcSpace, table: SpaceTable) -> None:
    space.n_cand, space.n_joints = len(table.q_rad), table.n_joints
    rows = library("flight").rows(space.cand, len(table.q_rad))
    rows["p_m"], rows["q_wxyz"] = table.p_m, table.poses.quat_wxyz
    rows["q_seed"][:, : table.n_joints] = table.q_rad
    rows["pan_rad"], rows["tilt_rad"] = table.pan_tilt_rad.T
    rows["tags"], rows["hub"], rows["why"] = table.tags, table.hub, table.checks
    space.n_initial = len(table.initial)
    space.initial[0 : len(table.initial)] = list(table.initial)


def _write_roadmap(space: KcSpace, table: SpaceTable) -> None:
    """Hubs and verified segments."""
    space.n_hub = len(table.hub_q_rad)
    for h, q in enumerate(table.hub_q_rad):
        space.hub_q[h][0 : len(q)] = q.tolist()
        space.hub_edge[h] = int(table.hub_edges[h])
    packed = pack_direct(table.direct)
    flight = library("flight")
    flight.ffi.buffer(cast("CData", space.edge))[0 : len(packed)] = packed


def _write_stops(space: KcSpace, table: SpaceTable) -> None:
    """Stops on the way to candidates; nothing if there are none."""
    most = int(np.max(np.count_nonzero(table.stops, axis=1), initial=0))
    space.n_stop = most
    for i, places in enumerate(table.stops[:, :most].tolist()):
        space.stop[i][0:most] = places


def strips(centre_m: Floats, half_m: Floats) -> list[Capsule]:
    """Capsules along the longest side of a box that contain it: as few as stand out by at most
    EXCESS_MAX_M."""
    counts = itertools.product(range(1, STRIPS_MAX + 1), repeat=2)
    for k, m in sorted(counts, key=lambda n: (n[0] * n[1], n)):
        bundle, excess_m = _bundle(centre_m, half_m, k, m)
        if excess_m <= EXCESS_MAX_M:
            break
    return bundle


def _bundle(centre_m: Floats, half_m: Floats, k: int, m: int) -> tuple[list[Capsule], float]:
    """k x m capsules that contain a box, and how far they stand out of it [m]. Strips of half sizes b, c end
    before the box does, by e; its corners are on their hemispheres when the radius is |(b, c, e)|."""
    order = np.argsort(-half_m, kind="stable")
    length, axes = half_m[order[0]], order[1:]
    b, c = half_m[axes[0]] / k, half_m[axes[1]] / m
    e = min(length, 0.5 * (b + c))
    radius_m = float(np.sqrt(b * b + c * c + e * e))
    along = np.zeros(3)
    along[order[0]] = length - e
    out = []
    for i, j in itertools.product(range(k), range(m)):
        at = centre_m.copy()
        at[axes[0]] += b * (2 * i + 1 - k)
        at[axes[1]] += c * (2 * j + 1 - m)
        out.append((at - along, at + along, radius_m))
    return out, max(radius_m - e, radius_m - b, radius_m - c)


def capsules(s: Shape) -> list[Capsule]:
    """Capsules that contain a shape, in its own frame."""
    if s.radius_m is not None:
        return [(np.array(s.start_m), np.array(s.end_m), s.radius_m)]
    return strips(np.array(s.centre_m), np.array(s.half_m))


def write_guard(space: KcSpace, desc: Description, camera: KcCamera) -> None:
    """Bodies and keep-out volumes of a description into a kc_space_t; other fields are left alone."""
    flight = library("flight")
    bodies_of = _write_bodies(space, desc, camera)
    _write_collision_pairs(space, desc, bodies_of)
    if len(desc.keep_out) > flight.lib.KC_VOLUME_MAX:
        raise BadInput(f"{len(desc.keep_out)} volumes, room for {flight.lib.KC_VOLUME_MAX}", "keep_out")
    space.n_volume = len(desc.keep_out)
    for i, k in enumerate(desc.keep_out):
        _write_volume(space.volume[i], k)
        inside = [name for name in bodies_of if any(re.fullmatch(x, name) for x in k.except_)]
        space.volume[i].excluded = sum(1 << b for name in inside for b in bodies_of[name])


def _write_bodies(space: KcSpace, desc: Description, camera: KcCamera) -> dict[str, list[int]]:
    """Capsules of all shapes; returns the bodies that stand for each shape."""
    room = library("flight").lib.KC_BODY_MAX
    bodies_of: dict[str, list[int]] = {}
    n = 0
    for s in desc.shape:
        frame = _shape_frame(s, camera)
        for a, b, radius_m in capsules(s):
            if n >= room:
                raise BadInput(f"{s.name!r} is more than {n} capsules on board", "shape")
            body = space.body[n]
            body.frame, body.radius_m = s.joint, radius_m
            body.start_m[0:3], body.end_m[0:3] = frame.apply(a).tolist(), frame.apply(b).tolist()
            bodies_of.setdefault(s.name, []).append(n)
            n += 1
    space.n_body = n
    return bodies_of


def _shape_frame(s: Shape, camera: KcCamera) -> Pose:
    """Frame of a shape in that of its body: of its tag in the tool frame, or the same."""
    if s.tag is None:
        return Pose.identity()
    tag = camera.tag[s.tag]
    return Pose.of_wxyz(list(tag.xyz_m), list(tag.quat_wxyz))


def _write_collision_pairs(space: KcSpace, desc: Description, bodies_of: dict[str, list[int]]) -> None:
    """Bodies that must not touch: all pairs but those of one shape, those that may touch by design, and those
    that cannot move against each other."""
    allowed = {frozenset(pair) for pair in desc.collision_exclusions}
    for a, b in itertools.combinations(bodies_of, 2):
        if frozenset((a, b)) in allowed:
            continue
        for i, k in itertools.product(bodies_of[a], bodies_of[b]):
            if space.body[i].frame != space.body[k].frame:
                space.body[max(i, k)].collision_pairs |= 1 << min(i, k)


def _write_volume(v: KcVolume, k: KeepOut) -> None:
    v.kind = library("flight").enum("kc_volume_kind_t", "KC_VOL_")[k.kind.upper()]
    v.p_m[0:3], v.radius_m = k.centre_m, k.radius_m or 0.0
    v.size_m[0:3] = k.half_m or k.end_m or (0.0, 0.0, 0.0)
