"""Forward and inverse kinematics of the nominal arm, and of arms with the named errors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from kincal.flight import Arm, library
from kincal.flight.arm import with_dh_errors
from kincal.flight.ik import Solver
from kincal.rotations import Pose
from kincal_shared.schema.space import Description

from .arrays import Bools, Floats

if TYPE_CHECKING:
    from kincal.flight.headers import KcArm

# Starts that 20 steps cannot mend are cheaper tried anew from elsewhere.
_IK = {"iter_max": 20, "tol_pos_m": 1e-6, "tol_rot_rad": 1e-6, "margin": 0.0, "step_max": 1.0}
# As close as the servo is asked to come, and as far from the limits (CONFIG table).
_SERVO_IK = {"iter_max": 60, "tol_pos_m": 2e-3, "tol_rot_rad": 5e-3, "margin": 0.0, "step_max": 0.5}
_SERVO_MARGIN_RAD = 0.02
_ROUNDING_M = 1e-9


class Kinematics:
    """The arm of one ARM table under one description.

    q_min, q_max (joints,): its limits. lo, hi (joints,): the limits less the margins of the description."""

    def __init__(self, desc: Description, arm: KcArm) -> None:
        self.arm, self.table = Arm.of_table(arm), arm
        self.n, self.q_min, self.q_max = self.arm.n, self.arm.q_min, self.arm.q_max
        margin = np.array(desc.joints.margin_rad)
        self.lo, self.hi = self.q_min + margin, self.q_max - margin
        self._reach_m = _stretched_out_m(arm)
        # solved inside the margins at once
        self._solver = Solver(arm, _IK, (self.lo, self.hi))
        cases = desc.error_bounds.case if desc.error_bounds.reach else []
        self._cases = [ServoReach(arm, case) for case in cases]

    def poses(self, q_rad: Floats) -> Pose:
        """(n,) tool poses of the nominal arm in the base frame at joints (n, joints); for one posture
        (joints,) too."""
        return self.arm.fk(np.reshape(q_rad, (-1, self.n)))

    def inside_limits(self, q_rad: Floats) -> Bools:
        """Whether joints (n, joints) keep the margins to their limits, (n,)."""
        inside: Bools = np.all((q_rad >= self.lo) & (q_rad <= self.hi), axis=1)
        return inside

    def beyond_reach(self, poses: Pose) -> Bools:
        """Tool poses that no joints of the nominal arm can reach: the axis of the last joint would be farther
        from the base than all links before it, stretched out. (n,)"""
        if self._reach_m is None:
            return np.zeros(len(poses.p_m), bool)
        arm, last = self.table, self.table.joint[self.n - 1]
        tool = Pose.of_wxyz(list(arm.tool_xyz_m), list(arm.tool_quat_wxyz))
        end = poses @ tool.inverse
        axis = np.array([0.0, np.sin(last.alpha_rad), np.cos(last.alpha_rad)])
        at = end.apply(-last.d_m * axis - [last.a_m, 0.0, 0.0])
        too_far: Bools = np.linalg.norm(at - list(arm.base_xyz_m), axis=1) > self._reach_m + _ROUNDING_M
        return too_far

    def solve(self, goals: Pose, start_rad: Floats) -> tuple[Floats, Bools]:
        """Joints inside the margins that bring the nominal tool to each of (n,) goals, from starts
        (n, joints), and whether any were found: (n, joints), (n,)."""
        q, found = self._solver.solve(goals, start_rad)
        # the table keeps single precision; so does everything that is verified
        q = q.astype(np.float32).astype(float)
        return q, found & self.inside_limits(q)

    def servo_limits(self, q_rad: Floats, bound_rad: Floats) -> tuple[Floats, Floats]:
        """Least and largest joints that the servo may use around a seed."""
        return np.maximum(q_rad - bound_rad, self.q_min), np.minimum(q_rad + bound_rad, self.q_max)

    def case_out_of_reach(self, q_rad: Floats, goal: Pose, bound_rad: Floats) -> int | None:
        """First named case of errors under which the servo cannot bring the tool to a goal from inside its
        bound: neither from the seed, nor with the joints' own errors taken back. None: all can."""
        limits = self.servo_limits(q_rad, bound_rad)
        cases = enumerate(self._cases)
        return next((k for k, case in cases if case.joints(q_rad, goal, *limits) is None), None)


class ServoReach:
    """Where the servo takes the joints of an arm with DH errors (by name), which it knows: the arm that a
    correction describes, or a named case of errors."""

    def __init__(self, arm: KcArm, errors: Mapping[str, float]) -> None:
        wrong, n = with_dh_errors(arm, errors), int(arm.n_joints)
        self._solver, self._errors_rad = Solver(wrong, _SERVO_IK), _joint_errors(wrong, arm)
        self._q_min = np.array([arm.joint[j].q_min for j in range(n)]) + _SERVO_MARGIN_RAD
        self._q_max = np.array([arm.joint[j].q_max for j in range(n)]) - _SERVO_MARGIN_RAD

    def joints(self, q_rad: Floats, goal: Pose, lo: Floats, hi: Floats) -> Floats | None:
        """Joints (joints,) from lo to hi, inside the limits, that bring the tool to a goal: from the seed q,
        or with the joints' own errors taken back. None if there are none."""
        goals = Pose(goal.p_m[None], goal.R[None])
        self._solver.limit(np.maximum(lo, self._q_min), np.minimum(hi, self._q_max))
        for start in (q_rad - self._errors_rad, q_rad):
            q, found = self._solver.solve(goals, start[None])
            if found[0]:
                row: Floats = q[0]
                return row
        return None


def _joint_errors(wrong: KcArm, arm: KcArm) -> Floats:
    """Errors of the joint angles of another arm [rad], (joints,)."""
    n = int(arm.n_joints)
    return np.array([wrong.joint[j].phi_rad - arm.joint[j].phi_rad for j in range(n)])


def _stretched_out_m(arm: KcArm) -> float | None:
    """Length of the links before the last joint; None if a joint slides."""
    joints = list(arm.joint[0 : arm.n_joints])
    if any(j.type != library("flight").lib.KC_REVOLUTE for j in joints):
        return None
    return sum(float(np.hypot(j.a_m, j.d_m)) for j in joints[:-1])
