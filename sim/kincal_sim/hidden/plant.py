"""The true arm at rest: MuJoCo bodies moved by errors and effects until joints, bodies and loads agree."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from .. import geom
from ..arm import Arm

EQUILIBRIUM_ITER_MAX = 60
EQUILIBRIUM_TOL = 1e-13


@dataclass(frozen=True)
class Moment:
    """Everything an effect may know about one reading. Joint quantities are arrays over the joints.

    q: encoder readings; wind: what bearing friction left in each joint (-1..1, by the history of its moves);
    dir: sign of the last motion; temp_c: what the one arm sensor says; joint_temp_c, link_temp_c,
    camera_temp_c: the field behind it; pan, tilt: head encoders; tag: which one is seen.
    """

    q: np.ndarray
    dir: np.ndarray
    wind: np.ndarray
    qdot: np.ndarray
    t_s: float
    temp_c: float
    joint_temp_c: np.ndarray
    link_temp_c: np.ndarray
    camera_temp_c: float
    payload_kg: float
    pan: float
    tilt: float
    tag: int


def turn(rotation_vector) -> np.ndarray:
    """3x3 rotation of a rotation vector."""
    return cv2.Rodrigues(np.asarray(rotation_vector, float).reshape(3))[0]


class Loads:
    """Gravity loads at the posture the arm stands in now; each is computed when first asked for."""

    def __init__(self, arm: Arm, masses: np.ndarray, payload_kg: float):
        self.arm, self._m, self._payload_kg = arm, masses, payload_kg
        self._g = np.array(arm.model.opt.gravity)

    @cached_property
    def torque(self) -> np.ndarray:
        """About each joint, from MuJoCo's dynamics [N m]."""
        return self.arm.gravity_torque()

    @cached_property
    def payload_torque(self) -> np.ndarray:
        """About each joint, of the payload alone [N m]."""
        data, n = self.arm.data, self.arm.n
        lever = self.point("tool") - data.xanchor[:n]
        return np.einsum("ni,ni->n", data.xaxis[:n], np.cross(lever, self._payload_kg * self._g))

    def point(self, body: str) -> np.ndarray:
        """Origin of a body in the base frame."""
        return self.arm.data.xpos[self.arm.model.body(body).id].copy()

    def rotation(self, body: str) -> np.ndarray:
        return self.arm.data.xmat[self.arm.model.body(body).id].reshape(3, 3).copy()

    def moment(self, about: np.ndarray, beyond: str | None = None) -> np.ndarray:
        """Moment about a point of all masses of the arm, or of those beyond a body [N m, base frame]."""
        first = 0 if beyond is None else self.arm.model.body(beyond).id + 1
        weight = self._m.copy()
        weight[:first] = 0.0
        lever = self.arm.data.xipos - about
        return np.cross(lever, weight[:, None] * self._g).sum(axis=0)

    def weight_of(self, body: str) -> tuple[np.ndarray, np.ndarray]:
        """Centre of mass and weight of one body [N], base frame."""
        k = self.arm.model.body(body).id
        return self.arm.data.xipos[k].copy(), self._m[k] * self._g


class Plant:
    """One arm with its errors; a MuJoCo model for each payload it may carry."""

    def __init__(self, spec: dict, errors: dict[str, float], payloads_kg=(0.0,)):
        self.spec = spec
        self.arms = {float(kg): Arm(spec, errors, payload_kg=kg) for kg in payloads_kg}
        self._masses, self._home = {}, {}
        for kg, arm in self.arms.items():
            # Only the chain has weight that bends it; the mast head stands beside.
            masses = arm.model.body_mass.copy()
            chain = [arm.model.body(f"frame{i + 1}").id for i in range(arm.n)]
            chain += [arm.model.body("payload").id] if kg > 0 else []
            keep = np.zeros(len(masses), bool)
            keep[chain] = True
            self._masses[kg] = np.where(keep, masses, 0.0)
            self._home[kg] = (arm.model.body_pos.copy(), arm.model.body_quat.copy())

    def _place(self, kg: float, q, pan: float, tilt: float, moved: dict[str, np.ndarray]) -> None:
        arm = self.arms[kg]
        pos, quat = self._home[kg]
        arm.model.body_pos[:], arm.model.body_quat[:] = pos, quat
        for body, E in moved.items():
            k = arm.model.body(body).id
            T = geom.pose(pos[k], geom.matrix(quat[k])) @ E
            arm.model.body_pos[k], arm.model.body_quat[k] = T[:3, 3], geom.quat(T)
        arm.set(q, pan, tilt)

    def settle(self, now: Moment, effects=()) -> tuple[np.ndarray, np.ndarray]:
        """True tool and camera pose in the base frame, at rest under gravity with these effects."""
        kg = float(now.payload_kg)
        arm = self.arms[kg]
        pan, tilt = now.pan, now.tilt
        for effect in effects:
            pan, tilt = effect.head(now, pan, tilt)
        q, moved = now.q.copy(), {}
        self._place(kg, q, pan, tilt, moved)
        for _ in range(EQUILIBRIUM_ITER_MAX):
            loads = Loads(arm, self._masses[kg], kg)
            q_next, moved_next = now.q.copy(), {}
            for effect in effects:
                q_next = q_next + effect.joints(now, loads)
                for body, E in effect.bodies(now, loads).items():
                    moved_next[body] = moved_next.get(body, np.eye(4)) @ E
            step = max(
                [np.abs(q_next - q).max()]
                + [np.abs(E - moved.get(body, np.eye(4))).max() for body, E in moved_next.items()]
            )
            q, moved = q_next, moved_next
            self._place(kg, q, pan, tilt, moved)
            if step < EQUILIBRIUM_TOL:
                break
        else:
            raise ArithmeticError(
                f"no equilibrium after {EQUILIBRIUM_ITER_MAX} iterations (last step {step:.1e})"
            )
        T_base_cam = arm.T_base_cam
        for effect in effects:
            T_base_cam = T_base_cam @ effect.camera(now)
        return arm.T_base_tool, T_base_cam


class Effect:
    """What may go wrong; each effect overrides what it changes and leaves the rest as it is."""

    def joints(self, _now: Moment, _loads: Loads):
        """Joint angles beyond what the encoders say [rad]."""
        return 0.0

    def bodies(self, _now: Moment, _loads: Loads) -> dict[str, np.ndarray]:
        """Bodies that sit elsewhere: 4x4 motions in the body's own frame."""
        return {}

    def head(self, _now: Moment, pan: float, tilt: float) -> tuple[float, float]:
        """True pan and tilt."""
        return pan, tilt

    def camera(self, _now: Moment) -> np.ndarray:
        """Motion of the camera in its own frame."""
        return np.eye(4)

    def optics(self, _now: Moment, optics):
        """The lens, sensor and tags as they really are."""
        return optics

    def sensed(self, _now: Moment, T_cam_tag: np.ndarray) -> np.ndarray:
        """The tag's pose as the detector gives it out."""
        return T_cam_tag
