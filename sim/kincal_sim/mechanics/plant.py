"""The true arm at rest. One plant serves the scenarios and the generator of hidden effects.

    q_true = encoders(q_read) + sum of the joint offsets of all effects at q_true
    bodies = as built, each moved by the body offsets of all effects at q_true

An effect may depend on where the arm ends up (a sagging arm loads its joints differently), so the static
equilibrium is found by fixed-point iteration. Kinematics and dynamics are MuJoCo's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike

from ..transforms import quaternion, rotation_matrix, transform
from .arm import Arm
from .mjcf import GRAVITY_EARTH

EQUILIBRIUM_ITER_MAX = 60
EQUILIBRIUM_TOL = 1e-13  # [rad] of joints, entries of the 4x4 offsets of bodies
Offsets = dict[str, np.ndarray]  # body name -> 4x4 motion in the body's own frame


class NoEquilibrium(ArithmeticError):
    """The iteration does not converge: the arm is too soft."""


@dataclass(kw_only=True)
class Conditions:
    """What an effect may depend on at one observation; nobody changes it. Joint quantities are arrays over
    the n joints. Not frozen: a run makes thousands, and a frozen one takes three times as long.

    q_rad: encoder readings
    direction: sign of each joint's last motion, -1, 0 or 1
    friction_state: what bearing friction left in each joint, -1..1 by the history of its moves
    dq_rad_s: speed at which the joints still move when they are read
    t_s: time since the start
    temp_c: reading of the one temperature sensor of the arm
    joint_temp_c, link_temp_c, camera_temp_c: the temperatures behind it
    payload_kg: mass in the scoop
    pan_rad, tilt_rad: encoders of the pan-tilt unit
    tag: id of the tag that is observed
    """

    q_rad: np.ndarray
    direction: np.ndarray | float = 0.0
    friction_state: np.ndarray | float = 0.0
    dq_rad_s: np.ndarray | float = 0.0
    t_s: float = 0.0
    temp_c: float = 20.0
    joint_temp_c: np.ndarray | float = 20.0
    link_temp_c: np.ndarray = field(default_factory=lambda: np.empty(0))
    camera_temp_c: float = 20.0
    payload_kg: float = 0.0
    pan_rad: float = 0.0
    tilt_rad: float = 0.0
    tag: int = 0


@dataclass(frozen=True)
class Encoders:
    """bias_rad: (n,) reading minus truth; gain: (n,) the joint turns (1 + gain) times what is read."""

    bias_rad: np.ndarray
    gain: np.ndarray

    @cached_property
    def _turns(self) -> np.ndarray:
        return 1.0 + self.gain

    @classmethod
    def exact(cls, n: int) -> Encoders:
        """Encoders of n joints without an error."""
        return cls(np.zeros(n), np.zeros(n))

    def joints_rad(self, q_read_rad: ArrayLike) -> np.ndarray:
        """(n,) joint angles behind these readings."""
        return (np.asarray(q_read_rad) - self.bias_rad) * self._turns


@dataclass(frozen=True)
class AtRest:
    """Where the arm comes to rest: true joints (n,) [rad], tool and camera in the base frame (4x4)."""

    q_rad: np.ndarray
    T_base_tool: np.ndarray
    T_base_cam: np.ndarray


def turn(rotation_vector_rad: ArrayLike) -> np.ndarray:
    """3x3 rotation of a rotation vector."""
    return cv2.Rodrigues(np.asarray(rotation_vector_rad, float).reshape(3))[0]


class Loads:
    """Gravity loads at the posture in which the arm stands now; each is computed when first asked for."""

    def __init__(self, arm: Arm, masses_kg: np.ndarray, payload_kg: float):
        self.arm, self._masses_kg, self._payload_kg = arm, masses_kg, payload_kg
        self._gravity = np.array(arm.model.opt.gravity)

    @property
    def q_rad(self) -> np.ndarray:
        """(n,) true joint angles."""
        return self.arm.data.qpos[: self.arm.n]

    @cached_property
    def torque_nm(self) -> np.ndarray:
        """(n,) torque about each joint, positive along +q, from MuJoCo's dynamics."""
        return self.arm.gravity_torque()

    @cached_property
    def payload_torque_nm(self) -> np.ndarray:
        """(n,) torque about each joint of the payload alone."""
        data, n = self.arm.data, self.arm.n
        lever = self.point("tool") - data.xanchor[:n]
        return np.einsum("ni,ni->n", data.xaxis[:n], np.cross(lever, self._payload_kg * self._gravity))

    def point(self, body: str) -> np.ndarray:
        """(3,) origin of a body in the base frame [m]."""
        return self.arm.data.xpos[self.arm.model.body(body).id].copy()

    def rotation(self, body: str) -> np.ndarray:
        """3x3 attitude of a body in the base frame."""
        return self.arm.data.xmat[self.arm.model.body(body).id].reshape(3, 3).copy()

    def moment_nm(self, about_m: np.ndarray, beyond: str | None = None) -> np.ndarray:
        """(3,) moment about a point, base frame, of all masses of the arm or of those beyond a body."""
        first = 0 if beyond is None else self.arm.model.body(beyond).id + 1
        mass = self._masses_kg.copy()
        mass[:first] = 0.0
        lever = self.arm.data.xipos - about_m
        return np.cross(lever, mass[:, None] * self._gravity).sum(axis=0)

    def weight_n(self, body: str) -> tuple[np.ndarray, np.ndarray]:
        """Centre of mass [m] and weight [N] of one body, base frame, (3,) each."""
        k = self.arm.model.body(body).id
        return self.arm.data.xipos[k].copy(), self._masses_kg[k] * self._gravity


class Effect:
    """Something that is wrong with the arm. A subclass overrides what it changes."""

    def joint_offsets(self, _at: Conditions, _loads: Loads) -> np.ndarray | float:
        """(n,) true joint angles minus encoder readings [rad]."""
        return 0.0

    def body_offsets(self, _at: Conditions, _loads: Loads) -> Offsets:
        """Bodies that sit elsewhere: 4x4 motions in the body's own frame."""
        return {}

    def pantilt(self, _at: Conditions, pan_rad: float, tilt_rad: float) -> tuple[float, float]:
        """True pan and tilt for these readings."""
        return pan_rad, tilt_rad

    def camera_offset(self, _at: Conditions) -> np.ndarray:
        """4x4 motion of the camera in its own frame."""
        return np.eye(4)

    def optics(self, _at: Conditions, optics: Any) -> Any:
        """Lens, sensor and tags as they really are (hidden.optics.Optics)."""
        return optics

    def detected(self, _at: Conditions, T_cam_tag: np.ndarray) -> np.ndarray:
        """The tag's pose (4x4) as the detector reports it."""
        return T_cam_tag


class _Variant:
    """The MuJoCo model of the arm with one payload."""

    def __init__(self, arm: Arm, payload_kg: float):
        self.arm, self.payload_kg = arm, payload_kg
        self.masses_kg = self._masses_of_the_arm()
        self._built_pos, self._built_quat = arm.model.body_pos.copy(), arm.model.body_quat.copy()
        self._as_built = True

    def _masses_of_the_arm(self) -> np.ndarray:
        """Masses by body; zero for those that do not load the arm, like the mast."""
        model = self.arm.model
        names = [f"frame{i + 1}" for i in range(self.arm.n)] + ["payload"] * (self.payload_kg > 0)
        masses = np.zeros(model.nbody)
        for k in (model.body(name).id for name in names):
            masses[k] = model.body_mass[k]
        return masses

    def loads(self) -> Loads:
        return Loads(self.arm, self.masses_kg, self.payload_kg)

    def put_back(self) -> None:
        """Bodies to where they were built."""
        if not self._as_built:
            self.arm.model.body_pos[:], self.arm.model.body_quat[:] = self._built_pos, self._built_quat
        self._as_built = True

    def place(self, q_rad: np.ndarray, pantilt_rad: tuple[float, float], offsets: Offsets) -> None:
        """Stand there, with bodies moved from where they were built."""
        model = self.arm.model
        self.put_back()
        self._as_built = not offsets
        for body, E in offsets.items():
            k = model.body(body).id
            T = transform(self._built_pos[k], rotation_matrix(self._built_quat[k])) @ E
            model.body_pos[k], model.body_quat[k] = T[:3, 3], quaternion(T)
        self.arm.set(q_rad, *pantilt_rad)


class Plant:
    """One arm as it truly is: errors of its geometry and encoders, effects, and the payloads it may carry.

    spec: numbers of the nominal arm (spec.load_spec); errors: as spec.split_errors reads them; payloads_kg:
    each gets a MuJoCo model of its own; effects: in force unless settle() is given others; pictures: whether
    any will be taken of the arm.
    """

    def __init__(
        self,
        spec: dict,
        errors: dict[str, float] | None = None,
        *,
        payloads_kg: Sequence[float] = (0.0,),
        gravity_m_s2: Sequence[float] = GRAVITY_EARTH,
        encoders: Encoders | None = None,
        effects: Sequence[Effect] = (),
        pictures: bool = True,
    ):
        self.spec, self.effects = spec, tuple(effects)
        self.encoders = encoders or Encoders.exact(len(spec["joint"]))
        self._variants = {
            float(kg): _Variant(Arm(spec, errors, gravity_m_s2, kg, pictures), float(kg))
            for kg in payloads_kg
        }

    def arm(self, payload_kg: float = 0.0) -> Arm:
        """The MuJoCo arm with that payload, as it stands after the last settle(). KeyError if unknown."""
        return self._variants[float(payload_kg)].arm

    def settle(self, at: Conditions, effects: Sequence[Effect] | None = None) -> AtRest:
        """Find the static equilibrium and leave the arm standing there.

        effects: instead of the plant's own. Raises NoEquilibrium when the iteration does not converge.
        """
        effects = self.effects if effects is None else effects
        q_rad, arm = self.stand(at, effects), self.arm(at.payload_kg)
        T_base_cam = arm.T_base_cam
        for effect in effects:
            T_base_cam = T_base_cam @ effect.camera_offset(at)
        return AtRest(q_rad, arm.T_base_tool, T_base_cam)

    def stand_rigid(
        self, q_read_rad: np.ndarray, pan_rad: float, tilt_rad: float, payload_kg: float = 0.0
    ) -> None:
        """stand() of a plant without effects, where no other condition counts."""
        assert not self.effects
        self._variants[float(payload_kg)].place(self.encoders.joints_rad(q_read_rad), (pan_rad, tilt_rad), {})

    def rigid_tools_m(self, q_read_rad: np.ndarray, payload_kg: float = 0.0) -> np.ndarray:
        """(k, 3) positions of the tool at readings (k, n), of a plant without effects: but for rounding those
        after stand_rigid()."""
        assert not self.effects
        variant = self._variants[float(payload_kg)]
        variant.put_back()
        return variant.arm.tool_positions_m(self.encoders.joints_rad(q_read_rad))

    def stand(self, at: Conditions, effects: Sequence[Effect] | None = None) -> np.ndarray:
        """settle() without poses: the true joints (n,) [rad]."""
        effects = self.effects if effects is None else effects
        variant = self._variants[float(at.payload_kg)]
        return _find_equilibrium(variant, self.encoders.joints_rad(at.q_rad), at, effects)


def _find_equilibrium(
    variant: _Variant, q_start: np.ndarray, at: Conditions, effects: Sequence[Effect]
) -> np.ndarray:
    """(n,) true joints [rad]; the arm stands there."""
    pantilt = at.pan_rad, at.tilt_rad
    for effect in effects:
        pantilt = effect.pantilt(at, *pantilt)
    q, offsets = q_start, Offsets()
    variant.place(q, pantilt, offsets)
    if not effects:
        return q
    for _ in range(EQUILIBRIUM_ITER_MAX):
        before, before_offsets = q, offsets
        q, offsets = _displaced(q_start, at, variant.loads(), effects)
        variant.place(q, pantilt, offsets)
        step = _largest_step(before, before_offsets, q, offsets)
        if step < EQUILIBRIUM_TOL:
            return q
    raise NoEquilibrium(f"no equilibrium after {EQUILIBRIUM_ITER_MAX} iterations (last step {step:.1e})")


def _displaced(
    q_start: np.ndarray, at: Conditions, loads: Loads, effects: Sequence[Effect]
) -> tuple[np.ndarray, Offsets]:
    """Joints and bodies under the loads of the present posture."""
    q, offsets = q_start, Offsets()
    for effect in effects:
        q = q + effect.joint_offsets(at, loads)
        for body, E in effect.body_offsets(at, loads).items():
            offsets[body] = offsets.get(body, np.eye(4)) @ E
    return q, offsets


def _largest_step(q_a: np.ndarray, offsets_a: Offsets, q_b: np.ndarray, offsets_b: Offsets) -> float:
    bodies = [np.abs(E - offsets_a.get(body, np.eye(4))).max() for body, E in offsets_b.items()]
    return float(max([np.abs(q_b - q_a).max(), *bodies]))
