"""Controllers of the arm and of the pan-tilt unit: they know encoder readings only and move them at
limited speed. Time is in seconds and only runs forward."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from operator import truediv

import numpy as np
from numpy.typing import ArrayLike

REACHED_RAD = 1e-9  # nearer than this is no motion
SETTLE_TIME_CONSTANTS = 7.0  # vibration decays to a thousandth while the arm settles


@dataclass(frozen=True)
class VelocityProfile:
    """Distance along a line over time: pieces (acceleration, duration) from a starting speed."""

    v0: float
    pieces: tuple[tuple[float, float], ...]

    @staticmethod
    def rest_to_rest(distance: float, v_max: float, a_max: float) -> VelocityProfile:
        """Trapezoid, or a triangle if the distance is short."""
        v = min(v_max, math.sqrt(distance * a_max))
        ramp = v / a_max
        return VelocityProfile(0.0, ((a_max, ramp), (0.0, distance / v - ramp), (-a_max, ramp)))

    @staticmethod
    def stop(v: float, a_max: float) -> VelocityProfile:
        """Brake from speed v."""
        return VelocityProfile(v, ((-a_max, v / a_max),))

    @cached_property
    def duration(self) -> float:
        """[s]"""
        return sum(t for _, t in self.pieces)

    @property
    def braked_from(self) -> float:
        """Speed before the braking at the end."""
        return max((-a * t for a, t in self.pieces), default=0.0)

    def at(self, t: float) -> tuple[float, float]:
        """Distance and speed at time t since the start (clamped to the end)."""
        s, v = 0.0, self.v0
        for a, length in self.pieces:
            dt = 0.0 if t < 0.0 else length if t > length else t
            s, v, t = s + v * dt + 0.5 * a * dt * dt, v + a * dt, t - length
        return s, v


@dataclass(frozen=True)
class Vibration:
    """How axes vibrate after braking. gain_s: amplitude [rad] per speed braked from [rad/s]."""

    duration_s: float = 0.0
    frequency_hz: float = 5.0
    gain_s: float = 0.0

    def at(self, dt_s: float, amplitude_rad: np.ndarray | None) -> tuple[np.ndarray, np.ndarray] | None:
        """Displacement and speed dt_s after the end of the move; None once it is over, or without amplitude.

        It is cut off at a thousandth of the amplitude, so that "at rest" is exact."""
        if self.duration_s - dt_s <= 1e-9 or amplitude_rad is None:
            return None
        tau = self.duration_s / SETTLE_TIME_CONSTANTS
        omega = 2 * np.pi * self.frequency_hz
        decayed, sine = amplitude_rad * np.exp(-dt_s / tau), np.sin(omega * dt_s)
        return decayed * sine, decayed * (omega * np.cos(omega * dt_s) - sine / tau)


class TrajectoryGenerator:
    """Moves axes along straight lines, all of them arriving together, then lets them vibrate.

    q: (n,) start; speed, accel: (n,) limits per axis. direction: (n,) sign of each axis' last motion.
    A new goal while moving first brakes along the old line.
    """

    def __init__(self, q: ArrayLike, speed: ArrayLike, accel: ArrayLike, vibration: Vibration | None = None):
        self._speeds, self._accels = np.array(speed, float).tolist(), np.array(accel, float).tolist()
        self.vibration = vibration or Vibration()
        self.direction = np.zeros(len(self._speeds), int)
        self._start = np.array(q, float)  # of the present line
        self._unit = np.zeros_like(self._start)  # along the present line; the fastest axis has 1
        self._line_accel = 0.0
        self._profile: VelocityProfile | None = None  # None: at rest
        self._t_start = self._t_rest = 0.0
        self._goal: np.ndarray | None = None  # waits until braking is done
        self._goal_scale = 1.0
        self._amplitude: np.ndarray | None = None  # of the vibration; None: none
        self._no_speed = np.zeros_like(self._start)
        self._at_rest = False  # and nothing commanded since

    def command(self, t: float, goal: ArrayLike, scale: float) -> None:
        """Go to `goal` with `scale` (0..1] of the speed limits, from wherever the axes are at time t."""
        self._brake(t)
        self._goal, self._goal_scale, self._at_rest = np.array(goal, float), scale, False
        self._advance(t)

    def hold(self, t: float) -> None:
        """Brake and stay."""
        self._brake(t)
        self._goal = None

    def at(self, t: float) -> tuple[np.ndarray, np.ndarray, bool]:
        """Positions, speeds, and whether anything moves or vibrates. At rest the arrays are the same ones
        each time; nobody changes them in place."""
        if self._at_rest:  # most of the time
            return self._start, self._no_speed, False
        profile = self._profile
        if profile is None or t - self._t_start >= profile.duration:
            self._advance(t)
        if self._profile is not None:
            s, v = self._profile.at(t - self._t_start)
            return self._start + s * self._unit, v * self._unit, True
        vibrating = self.vibration.at(t - self._t_rest, self._amplitude)
        if vibrating is None:
            self._at_rest = True
            return self._start, self._no_speed, False
        return self._start + vibrating[0], vibrating[1], True

    def _brake(self, t: float) -> None:
        if self._profile is None:
            return
        s, v = self._profile.at(t - self._t_start)
        self._start = self._start + s * self._unit
        self._profile, self._t_start = VelocityProfile.stop(v, self._line_accel), t

    def _advance(self, t: float) -> None:
        # At most: the end of braking, then the start and end of one waiting move.
        for _ in range(3):
            if self._profile is not None and t - self._t_start >= self._profile.duration:
                self._arrive(self._profile)
            elif self._profile is None and self._goal is not None:
                self._begin(t, self._goal)
            else:
                return

    def _arrive(self, profile: VelocityProfile) -> None:
        t_end = self._t_start + profile.duration
        self._start = self._start + profile.at(profile.duration)[0] * self._unit
        # Braking shakes the arm: the first swing follows the speed it braked from.
        swing_s = self.vibration.gain_s * profile.braked_from
        self._amplitude = swing_s * self._unit if swing_s else None
        self._profile, self._t_rest = None, t_end
        if self._goal is not None:
            self._begin(t_end, self._goal)

    def _begin(self, t: float, goal: np.ndarray) -> None:
        line, self._goal = goal - self._start, None
        moves = line.tolist()  # for a few axes plain numbers are quicker than arrays
        distance = max(map(abs, moves))
        if distance < REACHED_RAD:
            return
        self._unit = line / distance
        share = [max(abs(unit), 1e-12) for unit in self._unit.tolist()]
        speed = self._goal_scale * min(map(truediv, self._speeds, share))
        self._line_accel = min(map(truediv, self._accels, share))
        self._profile = VelocityProfile.rest_to_rest(distance, speed, self._line_accel)
        self._t_start = t
        before = self.direction.tolist()
        self.direction = np.array(
            [
                old if abs(move) < REACHED_RAD else 1 if move > 0.0 else -1
                for old, move in zip(before, moves, strict=True)
            ]
        )


class ArmController:
    """Takes arm commands and refuses impossible ones with a fault bit per joint.

    spec: as load_spec reads it; q_start: (n,) instead of the park pose. trajectory: encoder readings over
    time; q_cmd: (n,) last accepted goal; fault_mask: bit j-1 for joint j.
    """

    def __init__(self, spec: dict, q_start: ArrayLike | None = None):
        joints, motion = spec["joint"], spec["motion"]
        self.n = len(joints)
        self.q_min = np.array([j["q_rad"][0] for j in joints])
        self.q_max = np.array([j["q_rad"][1] for j in joints])
        start = np.array(motion["park_rad"] if q_start is None else q_start, float)
        self.trajectory = TrajectoryGenerator(
            start,
            [j["speed_rad_s"] for j in joints],
            [j["accel_rad_s2"] for j in joints],
            Vibration(motion["settle_s"], motion["settle_hz"], motion["settle_gain_s"]),
        )
        self.q_cmd = start.copy()
        self.fault_mask = 0
        self._last_seq: int | None = None

    def command(self, t: float, seq: int, q_rad: ArrayLike, speed_scale: float, hold: bool) -> bool:
        """Start a move, or brake and stay (hold). False if refused.

        A refused command leaves the arm with what it did; fault_mask names the joints (all of them for a
        wrong count or speed) until the next good command. A repeated or older number is ignored.
        """
        if self._last_seq is not None and seq <= self._last_seq:
            return False
        self._last_seq = seq
        if hold:
            self.fault_mask = 0
            self.trajectory.hold(t)
            self.q_cmd = self.trajectory.at(t)[0]
            return True
        self.fault_mask = self._faults(np.asarray(q_rad, float), speed_scale)
        if self.fault_mask:
            return False
        self.q_cmd = np.array(q_rad, float)
        self.trajectory.command(t, self.q_cmd, speed_scale)
        return True

    def _faults(self, q: np.ndarray, speed_scale: float) -> int:
        if q.shape != (self.n,) or not 0.0 < speed_scale <= 1.0:
            return (1 << self.n) - 1
        good = ((q >= self.q_min) & (q <= self.q_max)).tolist()  # NaN is bad too
        return sum(1 << j for j, fine in enumerate(good) if not fine)


class PanTiltController:
    """Pan-tilt unit with absolute encoders; a command beyond a limit stops at the limit.

    trajectory: (pan, tilt) [rad] over time.
    """

    def __init__(self, spec: dict):
        unit = spec["pantilt"]
        self.lower = np.array([unit["pan_rad"][0], unit["tilt_rad"][0]])
        self.upper = np.array([unit["pan_rad"][1], unit["tilt_rad"][1]])
        speed = unit["speed_rad_s"]
        self.trajectory = TrajectoryGenerator(unit["start_rad"], [speed, speed], [4 * speed, 4 * speed])
        self._last_seq: int | None = None

    def command(self, t: float, seq: int, pan_rad: float, tilt_rad: float) -> bool:
        """Start a move. False if refused: not finite, or a repeated or older number."""
        newer = self._last_seq is None or seq > self._last_seq
        if not newer or not (math.isfinite(pan_rad) and math.isfinite(tilt_rad)):
            return False
        self._last_seq = seq
        self.trajectory.command(t, np.clip([pan_rad, tilt_rad], self.lower, self.upper), 1.0)
        return True
