"""Effects on joints, links and base. Formulas are physics, not the ones a diagnosis would try.

Arguments named per joint are (n,) arrays over the joints; frames and signs as in plant.Effect.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..mechanics.effects import spring_deflection
from ..mechanics.plant import Conditions, Effect, Loads, Offsets, turn
from ..transforms import rotation_matrix, trans, transform

HARDENING_NM = 60.0  # a cable spring deflects half as much at this torque
BEAM_PARTS = 8
TORSION = 1.3  # a tube twists this much more easily than it bends


def _shift(vector_m: ArrayLike) -> np.ndarray:
    return trans(*np.asarray(vector_m))


def _rotation(R: np.ndarray) -> np.ndarray:
    return transform(np.zeros(3), R)


def _about(point_m: np.ndarray, R: np.ndarray) -> np.ndarray:
    """4x4 rotation about a fixed point of the base frame."""
    return _shift(point_m) @ _rotation(R) @ _shift(-point_m)


# ---- joints -----------------------------------------------------------------------------------------


class PayloadSag(Effect):
    """The controller compensates the arm's own weight but does not know the payload. rad_per_nm: (n,)."""

    def __init__(self, rad_per_nm: ArrayLike):
        self.rad_per_nm = np.asarray(rad_per_nm)

    def joint_offsets(self, _at: Conditions, loads: Loads) -> np.ndarray:
        """(n,) [rad]"""
        return spring_deflection(self.rad_per_nm, loads.payload_torque_nm, HARDENING_NM)


class DifferentialCoupling(Effect):
    """Two joints share two motors: each deflects under the other's torque. pair: indices from 0."""

    def __init__(self, pair: tuple[int, int], rad_per_nm: float):
        self.pair, self.rad_per_nm = pair, rad_per_nm

    def joint_offsets(self, _at: Conditions, loads: Loads) -> np.ndarray:
        """(n,) [rad]"""
        a, b = self.pair
        out = np.zeros(len(loads.torque_nm))
        out[a], out[b] = self.rad_per_nm * loads.torque_nm[b], self.rad_per_nm * loads.torque_nm[a]
        return out


class Ratio(Effect):
    """Transmission ratio: the joint turns (1 + gain) times what its motor's encoder shows, from q0_rad on."""

    def __init__(self, gain: ArrayLike, q0_rad: ArrayLike):
        self.gain, self.q0_rad = np.asarray(gain), np.asarray(q0_rad)

    def joint_offsets(self, at: Conditions, _loads: Loads) -> np.ndarray:
        """(n,) [rad]"""
        return self.gain * (at.q_rad - self.q0_rad)


class Routing(Effect):
    """A cable runs over another joint's axis and is taken along by it. joint, other: indices from 0."""

    def __init__(self, joint: int, other: int, gain: float):
        self.joint, self.other, self.gain = joint, other, gain

    def joint_offsets(self, at: Conditions, _loads: Loads) -> np.ndarray:
        """(n,) [rad]"""
        out = np.zeros(len(at.q_rad))
        out[self.joint] = self.gain * at.q_rad[self.other]
        return out


class Eccentricity(Effect):
    """An encoder disc off centre: exact reading geometry, so higher harmonics come along."""

    def __init__(self, cos_rad: ArrayLike, sin_rad: ArrayLike):
        self.size = np.hypot(cos_rad, sin_rad)
        self.phase = np.arctan2(cos_rad, sin_rad)

    def joint_offsets(self, at: Conditions, _loads: Loads) -> np.ndarray:
        """(n,) [rad]"""
        a = at.q_rad + self.phase
        return np.arctan2(self.size * np.sin(a), 1.0 + self.size * np.cos(a))


class OvalPulley(Effect):
    """An oval pulley: two waves a turn."""

    def __init__(self, cos_rad: ArrayLike, sin_rad: ArrayLike):
        self.cos, self.sin = np.asarray(cos_rad), np.asarray(sin_rad)

    def joint_offsets(self, at: Conditions, _loads: Loads) -> np.ndarray:
        """(n,) [rad]"""
        return self.cos * np.cos(2 * at.q_rad) + self.sin * np.sin(2 * at.q_rad)


class MotorWave(Effect):
    """A motor encoder's wave seen through the gear.

    motor_per_joint: (motors, joints) turns; the shares of a motor's error that reach the joints are those of
    the gear's inverse. amplitude_rad, phase_rad: per motor.
    """

    def __init__(self, motor_per_joint: ArrayLike, amplitude_rad: ArrayLike, phase_rad: ArrayLike):
        self.gear = np.asarray(motor_per_joint)
        self.amplitude, self.phase = np.asarray(amplitude_rad), np.asarray(phase_rad)
        self.inverse = np.linalg.inv(self.gear)

    def joint_offsets(self, at: Conditions, _loads: Loads) -> np.ndarray:
        """(n,) [rad]"""
        return self.inverse @ (self.amplitude * np.sin(self.gear @ at.q_rad + self.phase))


class FrictionWindup(Effect):
    """Cable wound up against bearing friction: a Dahl spring with memory, and friction grows with load."""

    def __init__(self, rad: ArrayLike):
        self.rad = np.asarray(rad)

    def joint_offsets(self, at: Conditions, loads: Loads) -> np.ndarray:
        """(n,) [rad]"""
        load = 1.0 + 0.15 * np.tanh(np.abs(loads.torque_nm) / 20.0)
        return self.rad * at.friction_state * load


class GravityBacklash(Effect):
    """Play that gravity takes up: the joint lies on the loaded flank, or stays where the last motion left it
    when the torque does not overcome friction."""

    def __init__(self, rad: ArrayLike, friction_nm: float):
        self.rad, self.friction_nm = np.asarray(rad), friction_nm

    def joint_offsets(self, at: Conditions, loads: Loads) -> np.ndarray:
        """(n,) [rad]"""
        tau = loads.torque_nm
        # A smooth flank: the equilibrium has to exist.
        pressed = np.tanh(tau / (0.5 * self.friction_nm))
        held = np.exp(-((tau / self.friction_nm) ** 2))
        return self.rad * ((1.0 - held) * pressed + held * at.friction_state * 0.3)


class ThermalZero(Effect):
    """Encoder zeros drift with the temperature of their own joint. rad_per_k: per joint, zero at t0_c."""

    def __init__(self, rad_per_k: ArrayLike, t0_c: float):
        self.rad_per_k, self.t0_c = np.asarray(rad_per_k), t0_c

    def joint_offsets(self, at: Conditions, _loads: Loads) -> np.ndarray:
        """(n,) [rad]"""
        return self.rad_per_k * (at.joint_temp_c - self.t0_c)


class Creep(Effect):
    """Cables lose tension, logarithmically in time; each has its own time constant tau_s."""

    def __init__(self, rad: ArrayLike, tau_s: ArrayLike):
        self.rad, self.tau_s = np.asarray(rad), np.asarray(tau_s)

    def joint_offsets(self, at: Conditions, _loads: Loads) -> np.ndarray:
        """(n,) [rad]"""
        return self.rad * np.log1p(at.t_s / self.tau_s)


class EncoderStep(Effect):
    """Counts lost at the time t0_s, and never found again."""

    def __init__(self, rad: ArrayLike, t0_s: float):
        self.rad, self.t0_s = np.asarray(rad), t0_s

    def joint_offsets(self, at: Conditions, _loads: Loads) -> np.ndarray:
        """(n,) [rad]"""
        return self.rad * float(at.t_s >= self.t0_s)


class Latency(Effect):
    """The frame is taken dt_s after the reading; a vibration that decays moves the joints in between."""

    def __init__(self, dt_s: float, decay_s: float = 1.0):
        self.reach_s = decay_s * np.sign(dt_s) * (1.0 - np.exp(-abs(dt_s) / decay_s))

    def joint_offsets(self, at: Conditions, _loads: Loads) -> np.ndarray:
        """(n,) [rad]"""
        return at.dq_rad_s * self.reach_s


# ---- links and tool ---------------------------------------------------------------------------------


class Wobble(Effect):
    """A bearing whose axis tilts as it turns: mostly about one direction, a little across, a little twice."""

    def __init__(self, cos_rad: ArrayLike, sin_rad: ArrayLike):
        self.cos, self.sin = np.asarray(cos_rad), np.asarray(sin_rad)

    def body_offsets(self, at: Conditions, _loads: Loads) -> Offsets:
        """Frames before the joints."""
        c, s = np.cos(at.q_rad), np.sin(at.q_rad)
        size = np.hypot(self.cos, self.sin)
        rx = self.cos * c + self.sin * s
        ry = 0.2 * (self.sin * c - self.cos * s)
        rx = rx + 0.1 * size * np.cos(2 * at.q_rad)
        return {f"frame{j}": _rotation(turn([rx[j], ry[j], 0.0])) for j in np.flatnonzero(size)}


class OutOfRound(Effect):
    """A bearing whose axis moves on a closed curve as the joint turns: k times a turn, a little three times.

    cos, sin: (n,) of the curve, a shift [m] or, if tilts, a turn [rad] about the frame before the joint.
    """

    def __init__(self, cos: ArrayLike, sin: ArrayLike, k: int, *, tilts: bool):
        self.size, self.phase = np.hypot(cos, sin), np.arctan2(sin, cos)
        self.k, self.tilts = k, tilts

    def body_offsets(self, at: Conditions, _loads: Loads) -> Offsets:
        """Frames before the joints."""
        angle = self.k * at.q_rad + self.phase
        x = self.size * (np.cos(angle) + 0.1 * np.cos(3 * at.q_rad))
        y = self.size * np.sin(angle)
        return {f"frame{j}": self._moved(x[j], y[j]) for j in np.flatnonzero(self.size)}

    def _moved(self, x: float, y: float) -> np.ndarray:
        return _rotation(turn([x, y, 0.0])) if self.tilts else _shift([x, y, 0.0])


class Bending(Effect):
    """A link as a beam of several parts: each bends and twists by the moment on it, own weight included.

    rad_per_nm: per link.
    """

    def __init__(self, rad_per_nm: ArrayLike):
        self.rad_per_nm = np.asarray(rad_per_nm)

    def body_offsets(self, _at: Conditions, loads: Loads) -> Offsets:
        """Frames after the links."""
        return {f"frame{j + 1}": self._link(j, loads) for j in np.flatnonzero(self.rad_per_nm)}

    def _link(self, j: int, loads: Loads) -> np.ndarray:
        """Motion of the end of a link (index from 0), in the frame there."""
        start, end = loads.point(f"frame{j}"), loads.point(f"frame{j + 1}")
        along, R = end - start, loads.rotation(f"frame{j + 1}")
        length = np.linalg.norm(along)
        axis = along / length if length > 1e-6 else R[:, 2]
        turned, shifted = np.zeros(3), np.zeros(3)
        for k in range(BEAM_PARTS):
            at = start + along * (k + 0.5) / BEAM_PARTS
            part = self.rad_per_nm[j] * self._moment(j, at, axis, loads) / BEAM_PARTS
            turned += part
            shifted += np.cross(part, end - at)
        return transform(R.T @ shifted, turn(R.T @ turned))

    @staticmethod
    def _moment(j: int, at: np.ndarray, axis: np.ndarray, loads: Loads) -> np.ndarray:
        """(3,) moment [N m] on a cross section, torsion weighted."""
        moment = loads.moment_nm(at, beyond=f"frame{j + 1}")
        com, weight = loads.weight_n(f"frame{j + 1}")
        if (com - at) @ axis > 0.0:
            moment = moment + np.cross(com - at, weight)
        return moment + (TORSION - 1.0) * axis * (axis @ moment)


class ToolMoved(Effect):
    """The bracket was bent once: the tool frame sits elsewhere on the last link."""

    def __init__(self, shift_m: ArrayLike, turn_rad: ArrayLike):
        self.E = transform(shift_m, turn(turn_rad))

    def body_offsets(self, _at: Conditions, _loads: Loads) -> Offsets:
        """The tool frame."""
        return {"tool": self.E}


class LinkGrowth(Effect):
    """Links grow with their own temperature, not with the sensor's. per_k: strain, zero at t0_c."""

    def __init__(self, spec: dict, per_k: float, t0_c: float):
        self.links = [(joint["a_m"], joint["d_m"]) for joint in spec["joint"]]
        self.per_k, self.t0_c = per_k, t0_c

    def body_offsets(self, at: Conditions, loads: Loads) -> Offsets:
        """Frames after the links."""
        out = {}
        for j, (a, d) in enumerate(self.links):
            if a or d:
                grown = self.per_k * (at.link_temp_c[j] - self.t0_c) * np.array([a, 0.0, d])
                # In the joint's frame; the body's own frame is turned by alpha about x.
                k = loads.arm.model.body(f"frame{j + 1}").id
                out[f"frame{j + 1}"] = _shift(rotation_matrix(loads.arm.model.body_quat[k]).T @ grown)
        return out


# ---- base -------------------------------------------------------------------------------------------


class _BaseMotion(Effect):
    """The arm turns or moves on the lander. T_base_frame0: nominal pose of frame 0."""

    def __init__(self, T_base_frame0: np.ndarray):
        self.T_base_frame0 = T_base_frame0

    def motion(self, at: Conditions, loads: Loads) -> np.ndarray:
        """4x4 motion of the arm in the base frame."""
        raise NotImplementedError

    def body_offsets(self, at: Conditions, loads: Loads) -> Offsets:
        """Frame 0."""
        T = self.T_base_frame0
        return {"frame0": np.linalg.inv(T) @ self.motion(at, loads) @ T}


class BaseFlex(_BaseMotion):
    """Deck and mount deflect under the moment of the whole arm about pivot_m, unequally in x and y."""

    def __init__(
        self, T_base_frame0: np.ndarray, rad_per_nm_x: float, rad_per_nm_y: float, pivot_m: ArrayLike
    ):
        super().__init__(T_base_frame0)
        self.pivot = np.asarray(pivot_m)
        across = 0.1 * rad_per_nm_y
        self.compliance = np.array(
            [[rad_per_nm_x, across, 0.0], [across, rad_per_nm_y, 0.0], [0.0, 0.0, 0.0]]
        )

    def motion(self, _at: Conditions, loads: Loads) -> np.ndarray:
        """4x4, base frame"""
        return _about(self.pivot, turn(self.compliance @ loads.moment_nm(self.pivot)))


class BaseMoved(_BaseMotion):
    """A constant turn (about the base plate) and shift."""

    def __init__(self, T_base_frame0: np.ndarray, turn_rad: ArrayLike, shift_m: ArrayLike):
        super().__init__(T_base_frame0)
        self.moved = _shift(shift_m) @ _rotation(turn(turn_rad))

    def motion(self, _at: Conditions, _loads: Loads) -> np.ndarray:
        """4x4, base frame"""
        return self.moved


class BaseSettling(_BaseMotion):
    """The lander settles about pivot_m: fast at first, then ever more slowly, by turn_rad in the end."""

    def __init__(self, T_base_frame0: np.ndarray, turn_rad: ArrayLike, tau_s: float, pivot_m: ArrayLike):
        super().__init__(T_base_frame0)
        self.turn_rad, self.tau_s, self.pivot = np.asarray(turn_rad), tau_s, np.asarray(pivot_m)

    def motion(self, at: Conditions, _loads: Loads) -> np.ndarray:
        """4x4, base frame"""
        return _about(self.pivot, turn(self.turn_rad * (1.0 - np.exp(-at.t_s / self.tau_s))))
