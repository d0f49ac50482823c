"""A finished search space in numbers and as geometry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kincal.flight import Arm
from kincal.flight.camera import Camera
from kincal.results import Scene

from .arrays import Floats
from .table import ALL_CHECKS, SpaceTable

if TYPE_CHECKING:
    from kincal.flight.headers import KcArm, KcCamera

FRUSTUM_M = 0.6  # depth at which the image corners are drawn


@dataclass(frozen=True)
class Summary:
    """Numbers of a search space. Unless named otherwise they are of the candidates, base frame."""

    candidates: int
    local_initial: int
    reserve: int  # of the local initial poses
    hubs: int
    initial: tuple[int, ...]  # candidates of the initial design
    direct_edges: int
    stops: int  # on segments to candidates
    stopping: int  # candidates with a stop
    arm_crc: int
    servo_bound_rad: tuple[float, ...]
    verified: tuple[tuple[float, ...], ...]  # DH errors: phi, alpha [rad], a, d [m], each of every joint
    box_min_m: tuple[float, ...]  # of tool positions
    box_max_m: tuple[float, ...]
    range_m: tuple[float, float]  # from the camera
    incid_deg: tuple[float, float]  # of the most oblique tag in view
    nearest_m: float  # median distance to the nearest other candidate
    two_tags: int  # candidates that show more than one tag
    unchecked: int  # candidates that lack a check
    arm_fits: bool  # built for the arm table it is shown with
    candidate_incid_deg: Floats  # (candidates,)
    candidate_range_m: Floats  # (candidates,)


def summarise(table: SpaceTable, camera: KcCamera, arm_crc: int) -> Summary:
    """Numbers of a table, seen by the camera of a CAMERA table; arm_crc: CRC of the ARM table in use."""
    cands = table.candidates()
    range_m, incid_deg = _range_and_incidence(cands, Camera(camera))
    gaps_m = np.linalg.norm(cands.p_m[:, None] - cands.p_m[None], axis=2)
    np.fill_diagonal(gaps_m, np.inf)
    return Summary(
        candidates=table.n_candidates,
        local_initial=table.n_local,
        reserve=table.n_reserve,
        hubs=len(table.hub_q_rad),
        initial=cands.initial,
        direct_edges=int(table.direct.sum()),
        stops=int(np.count_nonzero(table.stops)),
        stopping=int(np.count_nonzero(np.any(table.stops, axis=1))),
        arm_crc=table.arm_crc,
        servo_bound_rad=tuple(table.servo_bound_rad.tolist()),
        verified=tuple(map(tuple, table.verified.T.tolist())),
        box_min_m=tuple(cands.p_m.min(axis=0).tolist()),
        box_max_m=tuple(cands.p_m.max(axis=0).tolist()),
        range_m=_extent(range_m),
        incid_deg=_extent(incid_deg),
        nearest_m=float(np.median(gaps_m.min(axis=1))),
        two_tags=int(np.sum(np.bitwise_count(cands.tags) > 1)),
        unchecked=int(np.sum(cands.checks != ALL_CHECKS)),
        arm_fits=table.arm_crc == arm_crc,
        candidate_incid_deg=incid_deg,
        candidate_range_m=range_m,
    )


def _extent(values: Floats) -> tuple[float, float]:
    return float(values.min()), float(values.max())


def _range_and_incidence(table: SpaceTable, camera: Camera) -> tuple[Floats, Floats]:
    """Distance of the poses from the camera [m] and incidence of the most oblique tag in view [deg], (n,)."""
    tool = camera.pose(*table.pan_tilt_rad.T).inverse @ table.poses
    in_view = table.tags[:, None] >> np.arange(len(camera.tags)) & 1
    incid = np.max(np.where(in_view, camera.incidence(tool), 0.0), axis=1)
    return np.linalg.norm(tool.p_m, axis=1), np.degrees(incid)


def scene(
    table: SpaceTable,
    arm: KcArm,
    camera: KcCamera,
    q_rad: Floats | None = None,
    points: Callable[[Floats], Floats] | None = None,
) -> Scene:
    """Geometry for a figure, base frame [m]. The arm is shown at the candidates of the initial design, or at
    joints (n, joints); `points` maps joints to points of the arm (default: the nominal arm's)."""
    cands = table.candidates()
    q_rad = cands.q_rad[list(cands.initial)] if q_rad is None else q_rad
    skeletons = np.array([(points or Arm.of_table(arm).points)(q) for q in q_rad])
    target_m = skeletons[-1][-1] if len(skeletons) else cands.p_m[0]
    view = Camera(camera)
    aim = view.aim(target_m[None])
    eye_m, corners_m = view.frustum(aim.pan_rad[0], aim.tilt_rad[0], FRUSTUM_M)
    mast_m = np.array(list(camera.mast_xyz_m))
    return Scene(cands.p_m, skeletons, np.array([mast_m * [1, 1, 0], mast_m]), eye_m, corners_m)
