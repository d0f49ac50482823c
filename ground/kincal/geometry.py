"""Arm, camera and corrections as numpy calls into the flight core."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from kincal import core
from kincal.results import HeldOut


def pose_arrays(pose: Any) -> tuple[np.ndarray, np.ndarray]:
    """Position and rotation matrix of a kc_pose_t."""
    return np.array(list(pose.p_m)), np.array(list(pose.R)).reshape(3, 3)


class ArmChain:
    """Forward kinematics of one arm table, also of its inner frames."""

    def __init__(self, arm: Any) -> None:
        self.arm = arm
        self.n = int(arm.n_joints)
        self._pose = core.ffi.new("kc_pose_t *")
        self._q = core.ffi.new("double[]", self.n)
        # The chain cut after joint i, without tool: its tool point is the origin of frame i.
        self._cut = []
        for i in range(1, self.n):
            cut = core.ffi.new("kc_arm_t *", arm[0])
            cut.n_joints = i
            cut.tool_xyz_m = [0.0, 0.0, 0.0]
            cut.tool_quat_wxyz = [1.0, 0.0, 0.0, 0.0]
            self._cut.append(cut)
        self.base_R = quat_to_R(list(arm.base_quat_wxyz))
        self.base_m = np.array(list(arm.base_xyz_m))
        self.q_min = np.array([arm.joint[j].q_min for j in range(self.n)])
        self.q_max = np.array([arm.joint[j].q_max for j in range(self.n)])

    def fk(self, q: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
        """Tool position [m] and rotation in the base frame."""
        self._q[0 : self.n] = list(q)
        core.lib.kc_arm_fk(self.arm, self._q, self._pose)
        return pose_arrays(self._pose)

    def points(self, q: Sequence[float]) -> np.ndarray:
        """Base plate, frame origins 0..n-1 and the tool point, (n + 2, 3)."""
        out = [np.zeros(3), self.base_m]
        self._q[0 : self.n] = list(q)
        for cut in self._cut:
            core.lib.kc_arm_fk(cut, self._q, self._pose)
            out.append(np.array(list(self._pose.p_m)))
        core.lib.kc_arm_fk(self.arm, self._q, self._pose)
        out.append(np.array(list(self._pose.p_m)))
        return np.array(out)

    def frames(self, q: Sequence[float]) -> list[tuple[np.ndarray, np.ndarray]]:
        """Pose of frames 0..n-1 (frame 0: on the base, i: end of link i)."""
        out = [(self.base_m, self.base_R)]
        self._q[0 : self.n] = list(q)
        for cut in self._cut:
            core.lib.kc_arm_fk(cut, self._q, self._pose)
            out.append(pose_arrays(self._pose))
        return out


def with_dh_errors(arm: Any, values: dict[str, float]) -> Any:
    """Copy of an arm with DH errors added; other coefficients are ignored."""
    out = core.ffi.new("kc_arm_t *", arm[0])
    for name, value in values.items():
        if found := re.fullmatch(r"J(\d+)\.(phi_rad|alpha_rad|a_m|d_m)", name):
            joint = out.joint[int(found[1]) - 1]
            setattr(joint, found[2], getattr(joint, found[2]) + value)
    return out


class CorrectedArm:
    """The flight model with correction terms."""

    def __init__(self, arm: Any, terms: Any) -> None:
        self.arm, self.terms = arm, terms
        self.n = int(arm.n_joints)
        self.n_coef = int(terms.n_coef)
        self.names = [core.ffi.string(terms.coef[i].name).decode() for i in range(self.n_coef)]
        self._ctx = core.ffi.new("kc_ctx_t *")
        self._ctx.g_m_s2 = list(arm.gravity_m_s2)
        self._loads = core.ffi.new("kc_loads_t *")
        self._eval = core.ffi.new("kc_eval_t *")
        self._coef = core.ffi.new("double[64]")

    def fk(
        self, q: Sequence[float], coef: Sequence[float], side: Sequence[float] | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Tool position and rotation with the coefficients `coef`; side: direction of approach (+1, -1)."""
        self._ctx.q[0 : self.n] = list(q)
        self._ctx.dir[0 : self.n] = [0.0] * self.n if side is None else list(side)
        self._coef[0 : self.n_coef] = list(coef)[: self.n_coef]
        core.lib.kc_model_loads(self.arm, self.terms, self._coef, self._ctx, self._loads)
        core.lib.kc_model_eval(self.arm, self.terms, self._coef, self._ctx, self._loads, 0, self._eval)
        return pose_arrays(self._eval.T)

    def held_out(
        self,
        q: np.ndarray,
        p_true: np.ndarray,
        R_true: np.ndarray,
        coef: Sequence[float],
        side: np.ndarray | None = None,
    ) -> HeldOut:
        """RMS pose error with `coef` over joint vectors with known true poses; side: as for fk."""
        side = np.zeros_like(q) if side is None else side
        dp, dr = [], []
        for qi, pi, Ri, si in zip(q, p_true, R_true, side, strict=True):
            p, R = self.fk(qi, coef, si)
            dp.append(np.sum((p - pi) ** 2))
            dr.append(rotation_angle(R.T @ Ri) ** 2)
        return HeldOut(len(dp), float(np.sqrt(np.mean(dp))), float(np.sqrt(np.mean(dr))))


def rotation_angle(R: np.ndarray) -> float:
    """Angle of a rotation matrix, accurate near 0 and pi."""
    v = 0.5 * np.linalg.norm([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return float(np.arctan2(v, 0.5 * (np.trace(R) - 1.0)))


def quat_to_R(q: Sequence[float]) -> np.ndarray:
    w, x, y, z = np.asarray(q, float) / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def R_to_quat(R: np.ndarray) -> np.ndarray:
    """By the core, which keeps half turns exact."""
    out = core.ffi.new("double[4]")
    core.lib.kc_R_to_quat(core.ffi.new("double[9]", [float(x) for x in R.reshape(9)]), out)
    return np.array(list(out))


class Camera:
    """The pan/tilt camera of a camera table."""

    def __init__(self, camera: Any) -> None:
        self.camera = camera
        self._pose = core.ffi.new("kc_pose_t *")
        self._point = core.ffi.new("double[3]")
        self._pan, self._tilt = core.ffi.new("double *"), core.ffi.new("double *")
        self.tags = [
            (np.array(list(t.xyz_m)), quat_to_R(list(t.quat_wxyz)))
            for t in camera.tag[0 : int(camera.n_tags)]
        ]

    def aim(self, p: np.ndarray) -> tuple[float, float, bool]:
        """Pan, tilt that centre a point, and whether the limits allow it."""
        self._point[0:3] = [float(x) for x in p]
        status = core.lib.kc_camera_aim(self.camera, self._point, self._pan, self._tilt)
        return self._pan[0], self._tilt[0], status == 0

    def pose(self, pan: float, tilt: float) -> tuple[np.ndarray, np.ndarray]:
        core.lib.kc_camera_pose(self.camera, pan, tilt, self._pose)
        return pose_arrays(self._pose)

    def visible(self, p_cam: np.ndarray, R_cam: np.ndarray, max_incid_rad: float) -> int:
        """Bit set of tags seen, the tool being at that pose in the camera frame."""
        self._pose.p_m = [float(x) for x in p_cam]
        self._pose.R = [float(x) for x in R_cam.reshape(9)]
        return int(core.lib.kc_camera_visible(self.camera, self._pose, max_incid_rad))

    def incidence(self, p_cam: np.ndarray, R_cam: np.ndarray) -> np.ndarray:
        """Angle between line of sight and normal of each tag [rad]."""
        out = []
        for xyz, R_tag in self.tags:
            centre = p_cam + R_cam @ xyz
            normal_in = (R_cam @ R_tag)[:, 2]  # z into the tag, away from the viewer
            out.append(np.arccos(np.clip(centre @ normal_in / np.linalg.norm(centre), -1.0, 1.0)))
        return np.array(out)

    def frustum(self, pan: float, tilt: float, depth_m: float) -> tuple[np.ndarray, np.ndarray]:
        """Camera position and the four image corners at a depth, base frame."""
        p, R = self.pose(pan, tilt)
        c = self.camera
        corners = [
            ((u - c.cx_px) / c.fx_px, (v - c.cy_px) / c.fy_px, 1.0)
            for u, v in ((0, 0), (c.width_px, 0), (c.width_px, c.height_px), (0, c.height_px))
        ]
        return p, np.array([p + R @ (depth_m * np.array(k)) for k in corners])
