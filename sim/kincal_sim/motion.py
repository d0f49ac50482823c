"""Joint and head controllers: they know encoder readings only, and move them with limited speed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

REACHED = 1e-9  # [rad] nearer than this is no motion


@dataclass(frozen=True)
class Profile:
    """Distance along a path over time: pieces (acceleration, duration) from a starting speed."""

    v0: float
    pieces: tuple[tuple[float, float], ...]

    @staticmethod
    def rest_to_rest(distance: float, v_max: float, a_max: float) -> Profile:
        """Trapezoid (or triangle, if the way is short) from rest to rest."""
        v = min(v_max, float(np.sqrt(distance * a_max)))
        ramp = v / a_max
        return Profile(0.0, ((a_max, ramp), (0.0, distance / v - ramp), (-a_max, ramp)))

    @staticmethod
    def stop(v: float, a_max: float) -> Profile:
        return Profile(v, ((-a_max, v / a_max),))

    @property
    def duration(self) -> float:
        return sum(t for _, t in self.pieces)

    def at(self, t: float) -> tuple[float, float]:
        """Distance and speed at time t since the start (clamped to the end)."""
        s, v = 0.0, self.v0
        for a, length in self.pieces:
            dt = min(max(t, 0.0), length)
            s, v, t = s + v * dt + 0.5 * a * dt * dt, v + a * dt, t - length
        return s, v


class Mover:
    """Moves a vector of axes along straight lines, all axes arriving together, then settles.

    A new goal while moving first brakes along the old line. Time is in seconds and only runs forward.
    """

    def __init__(self, q, speed, accel, settle_s=0.0, settle_hz=5.0, settle_gain_s=0.0):
        self.q_rest = np.array(q, float)  # start of the present line
        self.unit = np.zeros_like(self.q_rest)
        self.profile: Profile | None = None
        self.t_start = self.t_rest = 0.0
        self.goal: np.ndarray | None = None  # waits until braking is done
        self.goal_scale = 1.0
        self.speed, self.accel = np.array(speed, float), np.array(accel, float)
        self.settle_s, self.settle_hz, self.settle_gain_s = settle_s, settle_hz, settle_gain_s
        self.swing = np.zeros_like(self.q_rest)
        self.dir = np.zeros(len(self.q_rest), int)

    def command(self, t: float, goal, scale: float) -> None:
        """Go to `goal` with `scale` of the speed limits, from wherever the axes are at time t."""
        self._brake(t)
        self.goal, self.goal_scale = np.array(goal, float), scale
        self._advance(t)

    def hold(self, t: float) -> None:
        """Brake and stay."""
        self._brake(t)
        self.goal = None

    def _brake(self, t: float) -> None:
        if self.profile is None:
            return
        s, v = self.profile.at(t - self.t_start)
        self.q_rest = self.q_rest + s * self.unit
        self.profile, self.t_start = Profile.stop(v, self._a_line), t

    def _arrive(self, t: float) -> None:
        # Braking shakes the arm: the first swing follows the speed it braked from.
        v = max((-a * length for a, length in self.profile.pieces), default=0.0)
        self.swing = self.settle_gain_s * v * self.unit
        self.profile, self.t_rest = None, t

    def _begin(self, t: float) -> None:
        line = self.goal - self.q_rest
        scale, self.goal = self.goal_scale, None
        distance = float(np.max(np.abs(line)))
        if distance < REACHED:
            return
        self.unit = line / distance
        share = np.maximum(np.abs(self.unit), 1e-12)
        self._a_line = float(np.min(self.accel / share))
        self.profile = Profile.rest_to_rest(distance, scale * float(np.min(self.speed / share)), self._a_line)
        self.t_start = t
        self.dir = np.where(np.abs(line) < REACHED, self.dir, np.sign(line)).astype(int)

    def _advance(self, t: float) -> None:
        # At most: the end of braking, then the start and end of one waiting move.
        for _ in range(3):
            if self.profile is not None and t - self.t_start >= self.profile.duration:
                t_end = self.t_start + self.profile.duration
                self.q_rest = self.q_rest + self.profile.at(self.profile.duration)[0] * self.unit
                self._arrive(t_end)
                if self.goal is not None:
                    self._begin(t_end)
            elif self.profile is None and self.goal is not None:
                self._begin(t)

    def at(self, t: float) -> tuple[np.ndarray, np.ndarray, bool]:
        """Positions, speeds, and whether anything moves or settles."""
        self._advance(t)
        if self.profile is not None:
            s, v = self.profile.at(t - self.t_start)
            return self.q_rest + s * self.unit, v * self.unit, True
        left = self.settle_s - (t - self.t_rest)
        if left <= 1e-9 or not self.swing.any():
            return self.q_rest.copy(), np.zeros_like(self.q_rest), False
        # Decays to a thousandth and is cut off there, so that "at rest" is exact.
        tau = self.settle_s / 7.0
        omega, dt = 2 * np.pi * self.settle_hz, t - self.t_rest
        decay = np.exp(-dt / tau)
        swing = self.swing * decay * np.sin(omega * dt)
        speed = self.swing * decay * (omega * np.cos(omega * dt) - np.sin(omega * dt) / tau)
        return self.q_rest + swing, speed, True


class ArmController:
    """Takes arm commands, refuses impossible ones with a fault bit, and answers with encoder readings."""

    def __init__(self, spec: dict, q_start=None):
        joints, m = spec["joint"], spec["motion"]
        self.n = len(joints)
        self.q_min = np.array([j["q_rad"][0] for j in joints])
        self.q_max = np.array([j["q_rad"][1] for j in joints])
        start = np.array(m["home_rad"] if q_start is None else q_start, float)
        self.mover = Mover(
            start,
            [j["speed_rad_s"] for j in joints],
            [j["accel_rad_s2"] for j in joints],
            m["settle_s"],
            m["settle_hz"],
            m["settle_gain_s"],
        )
        self.q_cmd = start.copy()
        self.fault_mask = 0
        self.last_seq: int | None = None

    def command(self, t: float, seq: int, q_rad, speed_scale: float, hold: bool) -> bool:
        """Start a move. False if refused: the arm goes on with what it did, fault_mask names the joints
        (all of them for a wrong count or speed) until the next good command. A repeated or older sequence
        number is ignored."""
        if self.last_seq is not None and seq <= self.last_seq:
            return False
        self.last_seq = seq
        if hold:
            self.fault_mask = 0
            self.mover.hold(t)
            self.q_cmd = self.mover.at(t)[0]
            return True
        self.fault_mask = self._faults(np.asarray(q_rad, float), speed_scale)
        if self.fault_mask:
            return False
        self.q_cmd = np.array(q_rad, float)
        self.mover.command(t, self.q_cmd, speed_scale)
        return True

    def _faults(self, q: np.ndarray, speed_scale: float) -> int:
        if q.shape != (self.n,) or not 0.0 < speed_scale <= 1.0:
            return (1 << self.n) - 1
        bad = ~((q >= self.q_min) & (q <= self.q_max))  # NaN is bad too
        return int(sum(1 << int(j) for j in np.flatnonzero(bad)))


class HeadController:
    """Pan/tilt head with absolute encoders; commands beyond its limits stop at the limit."""

    def __init__(self, spec: dict):
        head = spec["head"]
        self.lo = np.array([head["pan_rad"][0], head["tilt_rad"][0]])
        self.hi = np.array([head["pan_rad"][1], head["tilt_rad"][1]])
        speed = head["speed_rad_s"]
        self.mover = Mover(head["start_rad"], [speed, speed], [4 * speed, 4 * speed])
        self.last_seq: int | None = None

    def command(self, t: float, seq: int, pan_rad: float, tilt_rad: float) -> bool:
        if (self.last_seq is not None and seq <= self.last_seq) or not np.isfinite([pan_rad, tilt_rad]).all():
            return False
        self.last_seq = seq
        self.mover.command(t, np.clip([pan_rad, tilt_rad], self.lo, self.hi), 1.0)
        return True
