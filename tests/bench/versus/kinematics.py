"""Forward kinematics with Jacobians of one joint vector after the other, each library in its own language.

KinCal gives the corrected pose, the Jacobian by the 4 n DH errors and that by the joints. Pinocchio is asked
for pose and joint Jacobian; with its kinematic regressor, which has six displacements a joint, it gives what
a calibration needs of it. The arm is the same: the nominal WAM with errors, and arms of 2 to 8 joints."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from builders import arm_from, check, ffi, flight, lib, pose_of, view

from .build import pinocchio_loop
from .design import at, loops
from .measure import OURS, Growth, Ratio, Timed, compared, growth

Array = np.ndarray
VECTORS, ROUNDS = 64, 40
PINOCCHIO, REGRESSOR = "Pinocchio, joint Jacobian", "Pinocchio, and kinematic regressor"


@cache
def pinocchio() -> ctypes.CDLL:
    """The loops over Pinocchio's functions."""
    found = ctypes.CDLL(str(pinocchio_loop()))
    found.chain_new.restype = ctypes.c_void_p
    found.chain_kinematics.restype = found.chain_regressor.restype = ctypes.c_double
    return found


@dataclass(frozen=True)
class Numbers:
    """An arm by its DH parameters (n, 4) with the errors (n, 4) of each, and joint vectors (count, n)."""

    dh: Array
    errors: Array
    base_m: Array
    tool_m: Array
    q: Array

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.dh)


def arm_of(n: int, count: int = VECTORS) -> Numbers:
    """An arm of n joints, the same one every time; of seven the WAM."""
    rng = np.random.default_rng(n)
    dh = np.column_stack([rng.uniform(-2, 2, (n, 2)), rng.uniform(-0.5, 0.5, (n, 2))])
    if n == 7:
        half = np.pi / 2
        alpha = [-half, half, -half, half, -half, half, 0.0]
        a, d = [0, 0, 0.045, -0.045, 0, 0, 0], [0, 0, 0.55, 0, 0.3, 0, 0.06]
        dh = np.column_stack([np.zeros(7), alpha, a, d])
    errors = rng.normal(size=(n, 4)) * [0.02, 0.02, 0.004, 0.004]
    q = rng.uniform(-2.0, 2.0, (count, n))
    return Numbers(dh, errors, np.array([0, 0, 0.346]), np.array([0, 0, 0.1]), q)


class Ours:
    """Flight's model."""

    def __init__(self, arm: Numbers) -> None:
        fields = ("phi_rad", "alpha_rad", "a_m", "d_m")
        joints = [dict(zip(fields, row, strict=True)) | {"q_min": -3.0, "q_max": 3.0} for row in arm.dh]
        self.n, self.arm = arm.n, arm_from(joints, base_xyz_m=arm.base_m, tool_xyz_m=arm.tool_m)
        self.terms = flight.new("kc_terms_t")
        check(lib.kc_terms_add_dh(self.terms, arm.n, [0.1] * 4), "terms")
        self.coef = arm.errors.ravel().copy()
        self.ctx = ffi.new("kc_ctx_t[]", len(arm.q))
        for ctx, q in zip(self.ctx, arm.q, strict=True):
            view(ctx.q)[: arm.n] = q
            ctx.g_m_s2 = [0.0, 0.0, -9.81]
        self.loads, self.ev = ffi.new("kc_loads_t *"), ffi.new("kc_eval_t *")

    def seconds(self, with_loads: bool = False, rounds: int = ROUNDS) -> float:
        """Of one joint vector."""
        count = len(self.ctx)
        given = (at(self.arm), at(self.terms), at(self.coef), at(self.ctx), ctypes.c_uint32(count))
        took = loops().loop_model(
            *given, ctypes.c_uint32(rounds), ctypes.c_uint8(with_loads), at(self.loads), at(self.ev)
        )
        return float(took) / (rounds * count)

    def last(self) -> tuple[Array, Array, Array]:
        """Pose (3, 4), joint Jacobian (6, n) and parameter Jacobian (6, 4 n) of the last joint vector."""
        pose = pose_of(self.ev.T)
        T = np.column_stack([pose.R, pose.p_m])
        Jq, J = view(self.ev.Jq, lib.KC_JOINT_MAX, 6), view(self.ev.J, lib.KC_COEF_MAX, 6)
        return T, Jq[: self.n].T.copy(), J[: 4 * self.n].T.copy()


class Theirs:
    """Pinocchio's."""

    def __init__(self, arm: Numbers) -> None:
        self.n, self.q = arm.n, np.ascontiguousarray(arm.q)
        dh = np.ascontiguousarray(arm.dh + arm.errors)
        made = pinocchio().chain_new(arm.n, at(dh), at(arm.base_m.astype(float)), at(arm.tool_m))
        self._chain = ctypes.c_void_p(made)
        self.T, self.J, self.R = np.zeros((3, 4)), np.zeros((arm.n, 6)), np.zeros((6 * arm.n, 6))

    def __del__(self) -> None:
        pinocchio().chain_free(self._chain)

    def seconds(self, regressor: bool = False, rounds: int = ROUNDS) -> float:
        """Of one joint vector."""
        given: tuple[Any, ...] = (self._chain, len(self.q), at(self.q), rounds)
        if regressor:
            took = pinocchio().chain_regressor(*given, at(self.R))
        else:
            took = pinocchio().chain_kinematics(*given, at(self.T), at(self.J))
        return float(took) / (rounds * len(self.q))


def off(ours: Ours, theirs: Theirs) -> float:
    """Largest difference of poses and joint Jacobians [m, rad]."""
    ours.seconds(rounds=1)
    theirs.seconds(rounds=1)
    T, Jq, _ = ours.last()
    return float(max(np.abs(T - theirs.T).max(), np.abs(Jq - theirs.J.T).max()))


def _calls(n: int) -> dict[str, Timed]:
    ours, theirs = Ours(arm_of(n)), Theirs(arm_of(n))
    return {OURS: ours.seconds, PINOCCHIO: theirs.seconds, REGRESSOR: lambda: theirs.seconds(True)}


def ratios(rounds: int) -> Iterator[Ratio]:
    """Seven joints, 28 errors; without and with gravity loads, which effects need."""
    ours, theirs = Ours(arm_of(7)), Theirs(arm_of(7))
    found = off(ours, theirs)
    calls = _calls(7)
    differences = {PINOCCHIO: found, REGRESSOR: found}
    yield from compared("kinematics", "pose, 28 errors", calls, differences, "pose, Jacobian", rounds)
    loaded = calls | {OURS: lambda: ours.seconds(True)}
    yield from compared(
        "kinematics", "pose, 28 errors, gravity loads", loaded, differences, "pose, Jacobian", rounds
    )


def by_joints(rounds: int) -> Growth:
    """By number of joints."""
    return growth("kinematics", "joints", (2, 3, 4, 5, 6, 7, 8), _calls, rounds)
