"""Inverse kinematics, by flight's own solver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kincal.rotations import Pose

from .builds import Floats, doubles, library

if TYPE_CHECKING:
    from .headers import KcArm


class Solver:
    """Finds joints of one arm table, nominal, inside its limits.

    options: fields of kc_ik_opt_t (iter_max, tol_pos_m, tol_rot_rad, margin, step_max); limits: lower and
    upper joint limits (n,) in place of the table's.
    """

    def __init__(
        self,
        arm: KcArm,
        options: Mapping[str, float],
        limits: tuple[ArrayLike, ArrayLike] | None = None,
    ) -> None:
        flight = library("flight")
        self._arm, self._n = flight.copy(arm), int(arm.n_joints)
        self._options = flight.set_fields(flight.new("kc_ik_opt_t"), options)
        self._work = flight.new("kc_eval_t")
        if limits is not None:
            self.limit(*limits)

    def limit(self, low: ArrayLike, high: ArrayLike) -> None:
        """Set the joint limits (n,) [rad or m]."""
        joints = library("flight").rows(self._arm.joint, self._n)
        joints["q_min"], joints["q_max"] = low, high

    def solve(self, goals: Pose, start: ArrayLike) -> tuple[Floats, NDArray[np.bool_]]:
        """Joints (N, n) that bring the tool to (N,) goals in the base frame, from `start` (N, n), and whether
        each goal was reached; joints of those that were not are the closest found."""
        flight, null = library("flight"), library("flight").ffi.NULL
        q = doubles(start).copy()
        rows = doubles(np.concatenate([goals.p_m, goals.R.reshape(-1, 9)], axis=1))
        goal, at = flight.pointer(rows, "kc_pose_t"), flight.pointer(q)
        status = [
            flight.lib.kc_ik_solve(
                self._arm, null, null, goal + i, self._options, at + self._n * i, self._work, null
            )
            for i in range(len(rows))
        ]
        return q, np.array(status) == 0
