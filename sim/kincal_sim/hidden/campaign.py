"""A measurement campaign: where the arm goes, in which sequence, from where, and how temperatures change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..mechanics.arm import Arm
from ..mechanics.plant import Conditions
from . import optics

SECONDS_PER_POSE = 60.0
TEMP_MEAN_C, TEMP_SWING_C = 20.0, 25.0
MAX_INCIDENCE_RAD = np.radians(50.0)
MIN_DEPTH_M, MAX_RANGE_M = 0.2, 1.6
IMAGE_MARGIN_PX = 20.0
LIMIT_MARGIN_RAD = 0.15
REST_SPEED_RAD_S = 5e-3  # how fast joints still move when they are read, 1 sigma
REPEAT_RAD = 2e-4  # how well the controller finds a posture again, 1 sigma
APPROACH_RAD = (0.03, 0.15)  # length of the last motion of a joint
PRESLIDING_RAD = 0.015  # a joint has to move this far to wind its cable up again
SENSOR_NOISE_C = 0.2
# Poses to measure lie right of this line (y of the tool), the unseen region left of it.
BORDER_Y_M, GAP_M = 0.20, 0.03
FIXED_AIM_M = (0.62, -0.15, 0.5)  # aim of a camera that never turns
POSTURE_TRIES = 400_000
TAGS = (0, 1)


@dataclass(frozen=True)
class Posture:
    """Joints (n,), pan and tilt [rad], and a tag that is in sight."""

    q_rad: np.ndarray
    pan_rad: float
    tilt_rad: float
    tag: int


@dataclass(frozen=True)
class Visit:
    """One visit: commanded posture, number of the visit that it repeats (its own if none), payload."""

    posture: Posture
    replicate: int
    payload_kg: float


# ---- postures ---------------------------------------------------------------------------------------


def look_at(arm: Arm, p_m: ArrayLike) -> tuple[float, float]:
    """Pan and tilt [rad] towards a point of the base frame."""
    x, y, z = np.asarray(p_m) - arm.spec["pantilt"]["mast_xyz_m"]
    return float(np.arctan2(y, x)), float(np.arctan2(-z, np.hypot(x, y)))


def postures(
    arm: Arm,
    n: int,
    rng: np.random.Generator,
    *,
    unseen: bool = False,
    aim: tuple[float, float] | None = None,
) -> list[Posture]:
    """n random postures in the search region: a tag in sight, nothing touching.

    unseen: in the part where nothing is measured; aim: pan and tilt of a camera that never turns. Raises
    RuntimeError if too few are found.
    """
    low, high = _region(arm, unseen)
    q_low, q_high = arm.q_min + LIMIT_MARGIN_RAD, arm.q_max - LIMIT_MARGIN_RAD
    found: list[Posture] = []
    for _ in range(POSTURE_TRIES):
        if len(found) == n:
            return found
        q = rng.uniform(q_low, q_high)
        arm.set(q)
        p = arm.p_base_tool_m
        if not all(a < x < b for a, x, b in zip(low, p, high, strict=True)):  # most end here
            continue
        pan, tilt = _random_aim(arm, p, rng) if aim is None else aim
        arm.set(q, pan, tilt)
        seen = [tag for tag in TAGS if _in_sight(arm, tag)]
        if seen and not arm.collisions():
            found.append(Posture(q, pan, tilt, int(rng.choice(seen))))
    raise RuntimeError(f"only {len(found)} of {n} postures found")


def _region(arm: Arm, unseen: bool) -> tuple[np.ndarray, np.ndarray]:
    """Box of tool positions [m] on one side of the border."""
    region = arm.spec["region"]
    low, high = np.array(region["min_m"]), np.array(region["max_m"])
    if unseen:
        low[1] = BORDER_Y_M + GAP_M
    else:
        high[1] = BORDER_Y_M
    return low, high


def _random_aim(arm: Arm, p: np.ndarray, rng: np.random.Generator) -> tuple[float, float]:
    """Pan and tilt that see p anywhere in the middle two thirds of the image."""
    unit = arm.spec["pantilt"]
    pan, tilt = look_at(arm, p)
    pan, tilt = pan + rng.uniform(-0.40, 0.40), tilt + rng.uniform(-0.22, 0.22)
    return float(np.clip(pan, *unit["pan_rad"])), float(np.clip(tilt, *unit["tilt_rad"]))


def _in_sight(arm: Arm, tag: int) -> bool:
    T = np.linalg.inv(arm.T_base_cam) @ arm.T_base_tool @ optics.nominal_tag_pose(arm.spec, tag)
    too_far = T[2, 3] < MIN_DEPTH_M or np.linalg.norm(T[:3, 3]) > MAX_RANGE_M
    if too_far or optics.incidence_rad(T) > MAX_INCIDENCE_RAD:
        return False
    cam, px = arm.spec["camera"], optics.image(optics.nominal(arm.spec), T)
    end = np.array([cam["width_px"], cam["height_px"]]) - IMAGE_MARGIN_PX
    return bool((px > IMAGE_MARGIN_PX).all() and (px < end).all())


# ---- sequence ---------------------------------------------------------------------------------------


def visits(
    arm: Arm, n: int, rng: np.random.Generator, *, sequence: str, payload_kg: float, fixed_pantilt: bool
) -> list[Visit]:
    """n visits, 10-20 % of them replicates that approach an earlier posture anew; every other one carries
    the payload. sequence, fixed_pantilt: see CaseSpec."""
    repeated = round(n * rng.uniform(0.10, 0.20))
    aim = look_at(arm, FIXED_AIM_M) if fixed_pantilt else None
    base = postures(arm, n - repeated, rng, aim=aim)
    out = [Visit(posture, k, random_payload(payload_kg, rng)) for k, posture in enumerate(base)]
    again = rng.choice(len(out), repeated, replace=False)
    out += [out[k] for k in again]
    if sequence == "sorted":
        return sorted(out, key=lambda v: (round(v.posture.q_rad[1], 1), v.posture.q_rad[0]))
    return [out[k] for k in rng.permutation(len(out))]


def random_payload(payload_kg: float, rng: np.random.Generator) -> float:
    """The payload, or nothing."""
    return payload_kg if rng.random() < 0.5 else 0.0


# ---- temperatures -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class ThermalCycle:
    """Ambient temperature cycles; joints (n), links (n), sensor and camera follow, each with its own lag.

    period_s, phase_rad: of the ambient; lag_s: (2n + 2,) time constants.
    """

    period_s: float
    phase_rad: float
    lag_s: np.ndarray
    dt_s: float = 20.0

    def at(self, t_s: np.ndarray) -> np.ndarray:
        """(len(t_s), 2n + 2) temperatures [C], integrated as first-order lags."""
        grid = np.arange(0.0, t_s.max() + 2 * self.dt_s, self.dt_s)
        ambient = TEMP_MEAN_C + TEMP_SWING_C * np.sin(2 * np.pi * grid / self.period_s + self.phase_rad)
        state = np.full(len(self.lag_s), ambient[0])
        rows = np.empty((len(grid), len(self.lag_s)))
        follow = 1.0 - np.exp(-self.dt_s / self.lag_s)
        for i, outside in enumerate(ambient):
            state = state + follow * (outside - state)
            rows[i] = state
        return np.column_stack([np.interp(t_s, grid, row) for row in rows.T])


def thermal_cycle(n_joints: int, span_s: float, rng: np.random.Generator) -> ThermalCycle:
    """A random cycle of which a campaign of span_s sees two and a half to four."""
    joints, links = rng.uniform(40, 150, n_joints), rng.uniform(60, 200, n_joints)
    lag = np.concatenate([joints, links, [60.0], [100.0]])
    return ThermalCycle(span_s / rng.uniform(2.5, 4.0), rng.uniform(0, 2 * np.pi), lag)


# ---- the campaign -----------------------------------------------------------------------------------


def dahl_friction(before: np.ndarray, move_rad: np.ndarray) -> np.ndarray:
    """(n,) friction state, -1..1, after a monotone move: it runs into +-1 (Dahl's model)."""
    end = np.sign(move_rad)
    return np.where(
        move_rad == 0.0, before, end + (before - end) * np.exp(-np.abs(move_rad) / PRESLIDING_RAD)
    )


class _Approach:
    """How the joints come to each posture; they carry their history along."""

    def __init__(self, arm: Arm, sequence: str, rng: np.random.Generator):
        self.arm, self.sequence, self.rng = arm, sequence, rng
        self.q_rad = np.array(arm.spec["motion"]["park_rad"], float)
        self.friction_state = np.zeros(arm.n)
        self.direction = np.zeros(arm.n)

    def move_to(self, goal_rad: np.ndarray) -> None:
        """Shuffled, each joint comes from a random side; sorted, from where it was."""
        arm, rng = self.arm, self.rng
        target = np.clip(goal_rad + REPEAT_RAD * rng.standard_normal(arm.n), arm.q_min, arm.q_max)
        start = self.q_rad
        if self.sequence == "sorted":
            self.direction = np.where(target >= self.q_rad, 1.0, -1.0)
        else:
            self.direction = rng.choice([-1.0, 1.0], arm.n)
            start = target - self.direction * rng.uniform(*APPROACH_RAD, arm.n)
            self.friction_state = dahl_friction(self.friction_state, start - self.q_rad)
        self.friction_state = dahl_friction(self.friction_state, target - start)
        self.q_rad = target

    def conditions(
        self, visit: Visit, t_s: float, dq_rad_s: np.ndarray, measured_c: float, temps_c: np.ndarray
    ) -> Conditions:
        """Of the observation at the present posture. temps_c: (2n + 2,) as ThermalCycle.at gives them."""
        n = self.arm.n
        return Conditions(
            q_rad=self.q_rad,
            direction=self.direction,
            friction_state=self.friction_state,
            dq_rad_s=dq_rad_s,
            t_s=t_s,
            temp_c=measured_c,
            joint_temp_c=temps_c[:n],
            link_temp_c=temps_c[n : 2 * n],
            camera_temp_c=float(temps_c[2 * n + 1]),
            payload_kg=visit.payload_kg,
            pan_rad=visit.posture.pan_rad,
            tilt_rad=visit.posture.tilt_rad,
            tag=visit.posture.tag,
        )


def conditions(
    arm: Arm,
    todo: list[Visit],
    cycle: ThermalCycle,
    span_s: float,
    rng: np.random.Generator,
    *,
    sequence: str,
    still: bool = False,
) -> list[Conditions]:
    """Conditions of each visit of a campaign that takes span_s. still: joints are read at full rest."""
    n = len(todo)
    t_s = span_s / n * (np.arange(n) + rng.uniform(0.2, 0.8, n))
    temps = cycle.at(t_s)
    speed = 0.0 if still else REST_SPEED_RAD_S
    approach = _Approach(arm, sequence, rng)
    out = []
    for t, temp, visit in zip(t_s, temps, todo, strict=True):
        approach.move_to(visit.posture.q_rad)
        dq_rad_s = speed * rng.standard_normal(arm.n)
        measured_c = float(temp[2 * arm.n] + SENSOR_NOISE_C * rng.standard_normal())
        out.append(approach.conditions(visit, float(t), dq_rad_s, measured_c, temp))
    return out
