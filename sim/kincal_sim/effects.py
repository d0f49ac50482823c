"""What joints do that their encoders do not see: q_true = q(reading) + sum of effects(q_true).

Each effect gives joint offsets at a posture; the equilibrium is found by iteration because an effect
may depend on where the arm ends up (a sagging arm loads its joints differently).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .arm import Arm

EQUILIBRIUM_ITER_MAX = 60
EQUILIBRIUM_TOL_RAD = 1e-13


@dataclass
class State:
    """What an effect may look at besides the posture."""

    t_s: float = 0.0
    temp_c: float = 20.0
    payload_kg: float = 0.0
    dir: np.ndarray = field(default_factory=lambda: np.zeros(7))


class Compliance:
    """Joint springs: each joint gives way by its compliance [rad/(N m)] times the gravity torque about it."""

    def __init__(self, rad_per_nm: np.ndarray):
        self.rad_per_nm = rad_per_nm

    def offset(self, arm: Arm, _state: State) -> np.ndarray:
        return self.rad_per_nm * arm.gravity_torque()


class Hysteresis:
    """Friction wind-up: a joint stays back on the side that it came from, by so much [rad]."""

    def __init__(self, rad: np.ndarray):
        self.rad = rad

    def offset(self, _arm: Arm, state: State) -> np.ndarray:
        return self.rad * state.dir


class Coupling:
    """One joint is off by size tanh(angle of a second) cos(angle of a third): an effect that nobody has in a
    library."""

    def __init__(self, joint: int, size_rad: float, tanh: int, cos: int):
        self.joint, self.size_rad, self.tanh, self.cos = joint, size_rad, tanh, cos

    def offset(self, arm: Arm, _state: State) -> np.ndarray:
        q, out = arm.data.qpos, np.zeros(arm.n)
        out[self.joint] = self.size_rad * np.tanh(q[self.tanh]) * np.cos(q[self.cos])
        return out


class Truth:
    """From encoder readings to true joint angles: biases, gains and hidden effects of one scenario."""

    def __init__(self, arm: Arm, bias_rad: np.ndarray, gain: np.ndarray, effects: list):
        self.arm, self.bias_rad, self.gain, self.effects = arm, bias_rad, gain, effects

    def settle(self, q_enc, state: State) -> np.ndarray:
        """True joint angles at rest for these readings; the arm is left standing there."""
        q0 = (np.asarray(q_enc) - self.bias_rad) * (1.0 + self.gain)
        q = q0
        self.arm.set(q)
        if not self.effects:
            return q
        for _ in range(EQUILIBRIUM_ITER_MAX):
            q_next = q0 + sum(e.offset(self.arm, state) for e in self.effects)
            step = np.max(np.abs(q_next - q))
            q = q_next
            self.arm.set(q)
            if step < EQUILIBRIUM_TOL_RAD:
                return q
        raise ArithmeticError(
            f"no equilibrium after {EQUILIBRIUM_ITER_MAX} iterations (last step {step:.1e} rad)"
        )
