"""Looking at a finished search space: its numbers and its geometry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from kincal import core, tables
from kincal.geometry import ArmChain, Camera, quat_to_R, rotation_angle
from kincal.results import Scene

from .checks import WHY_ALL, WHY_SPARE


def ordinary(space: Any) -> int:
    """Candidates that are chosen among; the first looks come after them."""
    return int(space.n_cand) - int(core.lib.kc_space_n_first(space))


def priors(space: Any) -> tuple[int, ...]:
    """Candidates that start a calibration, after the first looks."""
    return tuple(i for i in space.prior[0 : space.n_prior] if i < ordinary(space))


def leash(space: Any, n_joints: int) -> np.ndarray:
    """How far the servo may take each joint from a seed."""
    return np.array(list(space.servo_leash[0:n_joints]))


@dataclass(frozen=True)
class Numbers:
    """What `space show` prints."""

    candidates: int
    first_looks: int
    spare: int  # of the first looks
    hubs: int
    priors: tuple[int, ...]
    direct_edges: int
    arm_crc: int
    leash_rad: tuple[float, ...]
    box_min_m: tuple[float, ...]
    box_max_m: tuple[float, ...]
    range_m: tuple[float, float]
    incid_deg: tuple[float, float]
    nearest_m: float  # median distance to the nearest other candidate
    spin_rad: float  # widest rotation between two candidates
    two_tags: int  # candidates that show more than one tag
    unchecked: int  # candidates that lack a check of the list above
    arm_fits: bool  # built for the arm table it is shown with


def describe(space: Any, arm_image: tables.Image, camera: Any) -> tuple[Numbers, np.ndarray, np.ndarray]:
    """Numbers, and incidence [deg] and range [m] per candidate."""
    n = ordinary(space)
    cands = space.cand[0:n]
    p = np.array([list(c.p_m) for c in cands])
    R = [quat_to_R(list(c.q_wxyz)) for c in cands]
    cam = Camera(camera)
    incid, rng = [], []
    for i, c in enumerate(cands):
        p_cam, R_cam = cam.pose(c.pan_rad, c.tilt_rad)
        seen = R_cam.T @ (p[i] - p_cam)
        rng.append(float(np.linalg.norm(seen)))
        angles = cam.incidence(seen, R_cam.T @ R[i])
        incid.append(float(np.degrees(max(a for k, a in enumerate(angles) if c.tags >> k & 1))))
    gaps = np.linalg.norm(p[:, None] - p[None], axis=2) + np.diag(np.full(n, np.inf))
    widest = max((rotation_angle(R[0].T @ r) for r in R), default=0.0)
    edges = sum(b.bit_count() for b in core.ffi.buffer(space.edge)[:])
    numbers = Numbers(
        n,
        int(space.n_cand) - n,
        sum(bool(c.why & WHY_SPARE) for c in space.cand[n : int(space.n_cand)]),
        int(space.n_hub),
        priors(space),
        edges,
        int(space.arm_crc),
        tuple(leash(space, int(space.n_joints))),
        tuple(p.min(axis=0)),
        tuple(p.max(axis=0)),
        (min(rng), max(rng)),
        (min(incid), max(incid)),
        float(np.median(gaps.min(axis=1))),
        widest,
        sum(c.tags.bit_count() > 1 for c in cands),
        sum(c.why != WHY_ALL for c in cands),
        int(space.arm_crc) == arm_image.crc,
    )
    return numbers, np.array(incid), np.array(rng)


def scene(
    space: Any,
    arm: Any,
    camera: Any,
    q_poses: np.ndarray | None = None,
    points: Callable[[np.ndarray], np.ndarray] | None = None,
) -> Scene:
    """Geometry of a picture; the poses are the priors unless joint vectors are given."""
    cands = space.cand[0 : ordinary(space)]
    chain, cam = ArmChain(arm), Camera(camera)
    if q_poses is None:
        q_poses = np.array([list(cands[i].q_seed)[: chain.n] for i in priors(space)])
    bones = np.array([(points or chain.points)(q) for q in q_poses])
    target = bones[-1][-1] if len(bones) else np.array(list(cands[0].p_m))
    pan, tilt, _ = cam.aim(target)
    eye, corners = cam.frustum(pan, tilt, 0.6)
    mast = np.array(list(camera.mast_xyz_m))
    return Scene(
        np.array([list(c.p_m) for c in cands]), bones, np.array([mast * [1, 1, 0], mast]), eye, corners
    )
