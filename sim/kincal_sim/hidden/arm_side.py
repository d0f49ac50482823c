"""Effects on joints, links and base. Formulas are physics, not the ones a diagnosis would try."""

from __future__ import annotations

import numpy as np

from .. import geom
from .plant import Effect, Loads, Moment, turn

HARDENING_NM = 60.0  # a spring is this much stiffer per newton metre
BEAM_PARTS = 8
TORSION = 1.3  # a tube twists this much more easily than it bends


def _shift(vector) -> np.ndarray:
    return geom.trans(*vector)


def _about(point: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Turn about a fixed point of the base frame."""
    return _shift(point) @ geom.pose(np.zeros(3), rotation) @ _shift(-point)


class Compliance(Effect):
    """Cable springs that harden a little; with the arm's own torque at the deflected posture."""

    def __init__(self, rad_per_nm):
        self.c = np.asarray(rad_per_nm)

    def joints(self, _now: Moment, loads: Loads):
        tau = loads.torque
        return self.c * tau / (1.0 + np.abs(tau) / HARDENING_NM)


class Droop(Effect):
    """The log holds commanded angles: a proportional controller stands off by torque over gain."""

    def __init__(self, rad_per_nm):
        self.c = np.asarray(rad_per_nm)

    def joints(self, _now: Moment, loads: Loads):
        return self.c * loads.torque


class PayloadSag(Effect):
    """The controller makes up for the arm's own weight but does not know the payload."""

    def __init__(self, rad_per_nm):
        self.c = np.asarray(rad_per_nm)

    def joints(self, _now: Moment, loads: Loads):
        tau = loads.payload_torque
        return self.c * tau / (1.0 + np.abs(tau) / HARDENING_NM)


class DifferentialCoupling(Effect):
    """Two joints share two motors: each gives way to the other's torque."""

    def __init__(self, pair: tuple[int, int], rad_per_nm: float):
        self.pair, self.c = pair, rad_per_nm

    def joints(self, _now: Moment, loads: Loads):
        a, b = self.pair
        out = np.zeros(len(loads.torque))
        out[a], out[b] = self.c * loads.torque[b], self.c * loads.torque[a]
        return out


class Ratio(Effect):
    """Transmission ratio: the joint turns a little more than its motor's encoder thinks."""

    def __init__(self, gain, home):
        self.gain, self.home = np.asarray(gain), np.asarray(home)

    def joints(self, now: Moment, _loads: Loads):
        return self.gain * (now.q - self.home)


class Routing(Effect):
    """A cable runs over another joint's axis and is taken along by it."""

    def __init__(self, joint: int, other: int, gain: float):
        self.joint, self.other, self.gain = joint, other, gain

    def joints(self, now: Moment, _loads: Loads):
        out = np.zeros(len(now.q))
        out[self.joint] = self.gain * now.q[self.other]
        return out


class Eccentricity(Effect):
    """An encoder disc off centre: exact reading geometry, so higher harmonics come along."""

    def __init__(self, cos_rad, sin_rad):
        self.size = np.hypot(cos_rad, sin_rad)
        self.phase = np.arctan2(cos_rad, sin_rad)

    def joints(self, now: Moment, _loads: Loads):
        a = now.q + self.phase
        return np.arctan2(self.size * np.sin(a), 1.0 + self.size * np.cos(a))


class Oval(Effect):
    """An oval pulley: two waves a turn."""

    def __init__(self, cos_rad, sin_rad):
        self.cos, self.sin = np.asarray(cos_rad), np.asarray(sin_rad)

    def joints(self, now: Moment, _loads: Loads):
        return self.cos * np.cos(2 * now.q) + self.sin * np.sin(2 * now.q)


class MotorWave(Effect):
    """A motor encoder's wave seen through the gear. motor_per_joint: (motors, joints) turns; the shares of
    a motor's error that reach the joints are those of the gear's inverse."""

    def __init__(self, motor_per_joint, amplitude_rad, phase_rad):
        self.N = np.asarray(motor_per_joint)
        self.amplitude, self.phase = np.asarray(amplitude_rad), np.asarray(phase_rad)
        self.back = np.linalg.inv(self.N)

    def joints(self, now: Moment, _loads: Loads):
        return self.back @ (self.amplitude * np.sin(self.N @ now.q + self.phase))


class FrictionWindup(Effect):
    """Cable wound up against bearing friction: a Dahl spring with memory, and friction grows with load."""

    def __init__(self, rad):
        self.h = np.asarray(rad)

    def joints(self, now: Moment, loads: Loads):
        load = 1.0 + 0.15 * np.tanh(np.abs(loads.torque) / 20.0)
        return self.h * now.wind * load


class GravityBacklash(Effect):
    """Play that gravity takes up: the joint lies on the loaded flank, or stays where the last motion left it
    when the torque does not overcome friction."""

    def __init__(self, rad, friction_nm: float):
        self.b, self.friction_nm = np.asarray(rad), friction_nm

    def joints(self, now: Moment, loads: Loads):
        tau = loads.torque
        # A smooth flank: the equilibrium has to exist.
        pressed = np.tanh(tau / (0.5 * self.friction_nm))
        held = np.exp(-((tau / self.friction_nm) ** 2))
        return self.b * ((1.0 - held) * pressed + held * now.wind * 0.3)


class Wobble(Effect):
    """A bearing whose axis tilts as it turns: mostly about one direction, a little across, a little twice."""

    def __init__(self, cos_rad, sin_rad):
        self.cos, self.sin = np.asarray(cos_rad), np.asarray(sin_rad)

    def bodies(self, now: Moment, _loads: Loads):
        c, s = np.cos(now.q), np.sin(now.q)
        rx = self.cos * c + self.sin * s
        ry = 0.2 * (self.sin * c - self.cos * s)
        rx = rx + 0.1 * np.hypot(self.cos, self.sin) * np.cos(2 * now.q)
        out = {}
        for j in np.flatnonzero(np.hypot(self.cos, self.sin)):
            out[f"frame{j}"] = geom.pose(np.zeros(3), turn([rx[j], ry[j], 0.0]))
        return out


class Bending(Effect):
    """A link as a beam of several parts: each bends and twists by the moment on it, own weight included."""

    def __init__(self, rad_per_nm):
        self.e = np.asarray(rad_per_nm)

    def bodies(self, _now: Moment, loads: Loads):
        out = {}
        for j in np.flatnonzero(self.e):
            start, end = loads.point(f"frame{j}"), loads.point(f"frame{j + 1}")
            com, weight = loads.weight_of(f"frame{j + 1}")
            along = end - start
            length = np.linalg.norm(along)
            axis = along / length if length > 1e-6 else loads.rotation(f"frame{j + 1}")[:, 2]
            turned, shifted = np.zeros(3), np.zeros(3)
            for k in range(BEAM_PARTS):
                at = start + along * (k + 0.5) / BEAM_PARTS
                moment = loads.moment(at, beyond=f"frame{j + 1}")
                if (com - at) @ axis > 0.0:
                    moment = moment + np.cross(com - at, weight)
                moment = moment + (TORSION - 1.0) * axis * (axis @ moment)
                bit = self.e[j] * moment / BEAM_PARTS
                turned += bit
                shifted += np.cross(bit, end - at)
            R = loads.rotation(f"frame{j + 1}")
            out[f"frame{j + 1}"] = geom.pose(R.T @ shifted, turn(R.T @ turned))
        return out


class _Base(Effect):
    """The arm turns or moves on the lander about the middle of its base plate."""

    home = None  # pose of frame 0 in the base frame, set by the case

    def motion(self, now: Moment, loads: Loads) -> np.ndarray:
        raise NotImplementedError

    def bodies(self, now: Moment, loads: Loads):
        T = self.home
        return {"frame0": np.linalg.inv(T) @ self.motion(now, loads) @ T}


class BaseFlex(_Base):
    """Deck and mount give way to the moment of the whole arm on the base plate, unequally in x and y."""

    def __init__(self, home, rad_per_nm_x: float, rad_per_nm_y: float, pivot_m):
        self.home, self.pivot = home, np.asarray(pivot_m)
        across = 0.1 * rad_per_nm_y
        self.C = np.array([[rad_per_nm_x, across, 0.0], [across, rad_per_nm_y, 0.0], [0.0, 0.0, 0.0]])

    def motion(self, _now: Moment, loads: Loads):
        return _about(self.pivot, turn(self.C @ loads.moment(self.pivot)))


class BaseMoved(_Base):
    """A constant turn (about the base plate) and shift."""

    def __init__(self, home, turn_rad, shift_m):
        self.home, self.turn, self.move = home, np.asarray(turn_rad), np.asarray(shift_m)

    def motion(self, _now: Moment, _loads: Loads):
        return _shift(self.move) @ geom.pose(np.zeros(3), turn(self.turn))


class BaseSettling(_Base):
    """The lander settles: fast at first, then ever more slowly."""

    def __init__(self, home, turn_rad, tau_s: float, pivot_m):
        self.home, self.turn, self.tau_s, self.pivot = home, np.asarray(turn_rad), tau_s, np.asarray(pivot_m)

    def motion(self, now: Moment, _loads: Loads):
        return _about(self.pivot, turn(self.turn * (1.0 - np.exp(-now.t_s / self.tau_s))))


class ToolMoved(Effect):
    """The bracket was bent once: the tool frame sits elsewhere on the last link."""

    def __init__(self, shift_m, turn_rad):
        self.E = geom.pose(shift_m, turn(turn_rad))

    def bodies(self, _now: Moment, _loads: Loads):
        return {"tool": self.E}


class LinkGrowth(Effect):
    """Links grow with their own temperature, not with the sensor's."""

    def __init__(self, spec: dict, per_k: float, t0_c: float):
        self.links = [(joint["a_m"], joint["d_m"]) for joint in spec["joint"]]
        self.per_k, self.t0_c = per_k, t0_c

    def bodies(self, now: Moment, loads: Loads):
        out = {}
        for j, (a, d) in enumerate(self.links):
            if a or d:
                grown = self.per_k * (now.link_temp_c[j] - self.t0_c) * np.array([a, 0.0, d])
                # in the joint's frame; the body's own frame is turned by alpha about x
                k = loads.arm.model.body(f"frame{j + 1}").id
                out[f"frame{j + 1}"] = _shift(geom.matrix(loads.arm.model.body_quat[k]).T @ grown)
        return out


class ThermalZero(Effect):
    """Encoder zeros drift with the temperature of their own joint."""

    def __init__(self, rad_per_k, t0_c: float):
        self.beta, self.t0_c = np.asarray(rad_per_k), t0_c

    def joints(self, now: Moment, _loads: Loads):
        return self.beta * (now.joint_temp_c - self.t0_c)


class Creep(Effect):
    """Cables lose tension, logarithmically in time; each has its own time constant."""

    def __init__(self, rad, tau_s):
        self.r, self.tau_s = np.asarray(rad), np.asarray(tau_s)

    def joints(self, now: Moment, _loads: Loads):
        return self.r * np.log1p(now.t_s / self.tau_s)


class EncoderStep(Effect):
    """Counts lost at one moment, and never found again."""

    def __init__(self, rad, t0_s: float):
        self.d, self.t0_s = np.asarray(rad), t0_s

    def joints(self, now: Moment, _loads: Loads):
        return self.d * float(now.t_s >= self.t0_s)


class Latency(Effect):
    """The picture is taken after the reading; a swing that dies out moves the joints in between."""

    def __init__(self, dt_s: float, decay_s: float = 1.0):
        self.reach_s = decay_s * np.sign(dt_s) * (1.0 - np.exp(-abs(dt_s) / decay_s))

    def joints(self, now: Moment, _loads: Loads):
        return now.qdot * self.reach_s


class Function(Effect):
    """A joint error that is any function of the readings: for effects that no library holds."""

    def __init__(self, joint: int, function):
        self.joint, self.function = joint, function

    def joints(self, now: Moment, _loads: Loads):
        out = np.zeros(len(now.q))
        out[self.joint] = self.function(now)
        return out
