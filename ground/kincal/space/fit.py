"""Whether a description fits the arm and camera tables."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kincal_shared.errors import BadInput
from kincal_shared.schema.dh import DH_FIELDS
from kincal_shared.schema.space import Description

from .arrays import Floats

if TYPE_CHECKING:
    from kincal.flight.headers import KcArm, KcCamera


def require_fit(desc: Description, arm: KcArm, camera: KcCamera) -> None:
    """BadInput naming the key of the description that does not fit the ARM or CAMERA table."""
    n = int(arm.n_joints)
    _one_value_per_joint(desc, n)
    _margins_leave_room(desc, arm)
    _names_known_joints(desc, n)
    _view_fits_camera(desc, camera)


def servo_bound_rad(desc: Description, n_joints: int) -> Floats:
    """How far the servo may take each joint from a seed, (joints,); in the single precision of the
    table."""
    bound = desc.joints.servo_bound_rad
    return np.array(bound if isinstance(bound, list) else [bound] * n_joints).astype(np.float32).astype(float)


def _one_value_per_joint(desc: Description, n: int) -> None:
    joints = desc.joints
    lists = {"joints.margin_rad": joints.margin_rad}
    if isinstance(joints.servo_bound_rad, list):
        lists["joints.servo_bound_rad"] = joints.servo_bound_rad
    lists |= {f"joints.hubs_rad[{i}]": q for i, q in enumerate(joints.hubs_rad, 1)}
    lists |= {f"joints.local_initial_rad[{i}]": q for i, q in enumerate(joints.local_initial_rad, 1)}
    lists |= {f"error_bounds.{f}": getattr(desc.error_bounds, f) for f in DH_FIELDS}
    for where, values in lists.items():
        if len(values) != n:
            raise BadInput(
                f"{len(values)} values for an arm of {n} joints", where, "give one value per joint"
            )


def _margins_leave_room(desc: Description, arm: KcArm) -> None:
    for j, margin in enumerate(desc.joints.margin_rad):
        lo, hi = arm.joint[j].q_min, arm.joint[j].q_max
        if lo + margin >= hi - margin:
            raise BadInput(
                f"a margin of {margin:g} rad leaves J{j + 1} no room: its limits are {lo:g} and {hi:g} rad",
                f"joints.margin_rad[{j + 1}]",
                "make the margin smaller",
            )


def _names_known_joints(desc: Description, n: int) -> None:
    for s in desc.shape:
        if s.joint > n:
            raise BadInput(f"{s.name!r} is on joint {s.joint} of an arm of {n}", "shape")
    for name in (name for case in desc.error_bounds.case for name in case):
        if int(name[1 : name.index(".")]) > n:
            raise BadInput(f"{name!r}: the arm has {n} joints", "error_bounds.case")


def _view_fits_camera(desc: Description, camera: KcCamera) -> None:
    v = desc.view
    half_px = 0.5 * min(camera.width_px, camera.height_px)
    if v.image_margin_px >= half_px:
        raise BadInput(
            f"{v.image_margin_px:g} px leave nothing of {camera.width_px} x {camera.height_px} px",
            "view.image_margin_px",
            f"stay below {half_px:g}",
        )
    pan, tilt = camera.pan_max_rad - camera.pan_min_rad, camera.tilt_max_rad - camera.tilt_min_rad
    if v.pantilt_margin_rad >= (half := 0.5 * min(pan, tilt)):
        raise BadInput(
            f"{v.pantilt_margin_rad:g} rad leave the pan-tilt unit no room",
            "view.pantilt_margin_rad",
            f"stay below {half:g}",
        )
    if v.tags_min > camera.n_tags:
        raise BadInput(f"{v.tags_min} tags wanted, the camera table has {camera.n_tags}", "view.tags_min")
