"""Effects on joints that scenarios and hidden cases share. Signs: an offset is true angle minus reading."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from .plant import Conditions, Effect, Loads


def spring_deflection(
    rad_per_nm: np.ndarray, torque_nm: np.ndarray, hardening_nm: float = np.inf
) -> np.ndarray:
    """(n,) deflection [rad] of springs that harden: at hardening_nm a spring deflects half as much."""
    return rad_per_nm * torque_nm / (1.0 + np.abs(torque_nm) / hardening_nm)


class JointCompliance(Effect):
    """Each joint deflects under the gravity torque about it at the deflected posture.

    rad_per_nm: (n,) compliance at no load; hardening_nm: see spring_deflection, infinite = linear.
    """

    def __init__(self, rad_per_nm: ArrayLike, hardening_nm: float = np.inf):
        self.rad_per_nm, self.hardening_nm = np.asarray(rad_per_nm), hardening_nm

    def joint_offsets(self, _at: Conditions, loads: Loads) -> np.ndarray:
        """(n,) [rad]"""
        return spring_deflection(self.rad_per_nm, loads.torque_nm, self.hardening_nm)


class Hysteresis(Effect):
    """Friction wind-up without memory: a joint stays back on the side from which it came.

    rad: (n,) offset after a motion in the positive direction.
    """

    def __init__(self, rad: ArrayLike):
        self.rad = np.asarray(rad)

    def joint_offsets(self, at: Conditions, _loads: Loads) -> np.ndarray:
        """(n,) [rad]"""
        return self.rad * at.direction


class JointFunction(Effect):
    """One joint is off by any function of conditions and loads: for effects that no library holds.

    joint: index from 0; offset_rad(at, loads): the offset [rad]; drivers: joints (from 1) whose angles it
    follows, for the sealed answer.
    """

    def __init__(
        self,
        joint: int,
        offset_rad: Callable[[Conditions, Loads], float],
        drivers: tuple[int, ...] = (),
    ):
        self.joint, self.offset_rad, self.drivers = joint, offset_rad, drivers

    def joint_offsets(self, at: Conditions, loads: Loads) -> np.ndarray:
        """(n,) [rad]"""
        out = np.zeros(len(at.q_rad))
        out[self.joint] = self.offset_rad(at, loads)
        return out
