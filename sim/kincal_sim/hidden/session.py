"""A measurement campaign: where the arm goes, in which order and from where, what the weather does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arm import Arm
from . import eye
from .plant import Moment

SECONDS_PER_POSE = 60.0
TEMP_MEAN_C, TEMP_SWING_C = 20.0, 25.0
MAX_INCIDENCE_RAD = np.radians(50.0)
MAX_RANGE_M = 1.6
REST_SPEED_RAD_S = 5e-3  # how fast joints still move when they are read, 1 sigma
REPEAT_RAD = 2e-4  # how well the controller finds a posture again
APPROACH_RAD = (0.03, 0.15)  # length of the last motion of a joint
PRESLIDING_RAD = 0.015  # a joint has to move so far to wind its cable up again
# Poses to measure lie right of this line (y of the tool), the unseen region left of it.
BORDER_Y_M, GAP_M = 0.20, 0.03


@dataclass(frozen=True)
class Visit:
    """One visit: commanded posture and head, which tag to look at, which earlier visit it repeats."""

    q: np.ndarray
    pan: float
    tilt: float
    tag: int
    replicate: int
    payload_kg: float


def _in_sight(arm: Arm, optics: eye.Optics, cam: dict, tag: int) -> bool:
    T = np.linalg.inv(arm.T_base_cam) @ arm.T_base_tool @ eye.mount(arm.spec, tag)
    if T[2, 3] < 0.2 or np.linalg.norm(T[:3, 3]) > MAX_RANGE_M or eye.incidence_rad(T) > MAX_INCIDENCE_RAD:
        return False
    px = eye.image(optics, T)
    margin = 20.0
    return bool((px > margin).all() and (px < np.array([cam["width_px"], cam["height_px"]]) - margin).all())


def _aim(arm: Arm, p: np.ndarray, rng: np.random.Generator, fixed: tuple[float, float] | None):
    """Head angles that look at p roughly: the tool lands anywhere in the middle two thirds of the picture."""
    if fixed is not None:
        return fixed
    head = arm.spec["head"]
    x, y, z = p - head["mast_xyz_m"]
    pan = float(np.arctan2(y, x) + rng.uniform(-0.40, 0.40))
    tilt = float(np.arctan2(-z, np.hypot(x, y)) + rng.uniform(-0.22, 0.22))
    return float(np.clip(pan, *head["pan_rad"])), float(np.clip(tilt, *head["tilt_rad"]))


def postures(
    arm: Arm, n: int, left: bool, rng: np.random.Generator, fixed_head: tuple[float, float] | None = None
) -> list[tuple[np.ndarray, float, float, int]]:
    """Random postures in the search region on one side of the border: a tag in sight, nothing touching."""
    region, optics, cam = arm.spec["region"], eye.nominal(arm.spec), arm.spec["camera"]
    low, high = np.array(region["min_m"]), np.array(region["max_m"])
    if left:
        low[1] = BORDER_Y_M + GAP_M
    else:
        high[1] = BORDER_Y_M
    found = []
    for _ in range(400_000):
        if len(found) == n:
            return found
        q = rng.uniform(arm.q_min + 0.15, arm.q_max - 0.15)
        arm.set(q)
        p = arm.T_base_tool[:3, 3]
        if not ((p > low).all() and (p < high).all()):
            continue
        pan, tilt = _aim(arm, p, rng, fixed_head)
        arm.set(q, pan, tilt)
        seen = [tag for tag in (0, 1) if _in_sight(arm, optics, cam, tag)]
        if seen and not arm.collisions():
            found.append((q, pan, tilt, int(rng.choice(seen))))
    raise RuntimeError(f"only {len(found)} of {n} postures found")


def look_at(arm: Arm, p) -> tuple[float, float]:
    """Head angles that look at a point."""
    x, y, z = np.asarray(p) - arm.spec["head"]["mast_xyz_m"]
    return float(np.arctan2(y, x)), float(np.arctan2(-z, np.hypot(x, y)))


def visits(
    arm: Arm, n: int, rng: np.random.Generator, *, order: str, payload_kg: float, fixed_head: bool
) -> list[Visit]:
    """n visits, 10-20 % of them replicates that approach an earlier posture anew.

    order: "shuffled", or "sorted" = region by region, the way of the arm deciding the approach.
    """
    repeated = round(n * rng.uniform(0.10, 0.20))
    head = look_at(arm, [0.62, -0.15, 0.5]) if fixed_head else None
    base = postures(arm, n - repeated, False, rng, head)
    out = [Visit(*b, k, payload_kg if rng.random() < 0.5 else 0.0) for k, b in enumerate(base)]
    again = rng.choice(len(out), repeated, replace=False)
    out += [out[k] for k in again]
    if order == "sorted":
        return sorted(out, key=lambda v: (round(v.q[1], 1), v.q[0]))
    return [out[k] for k in rng.permutation(len(out))]


@dataclass(frozen=True)
class Weather:
    """Ambient temperature cycles; joints, links, sensor and camera follow late, each in its own time."""

    period_s: float
    phase: float
    lag_s: np.ndarray  # joints, links, sensor, camera
    dt_s: float = 20.0

    def field(self, t_s: np.ndarray) -> np.ndarray:
        """(len(t), len(lag)) temperatures [C], integrated as first-order lags."""
        grid = np.arange(0.0, t_s.max() + 2 * self.dt_s, self.dt_s)
        ambient = TEMP_MEAN_C + TEMP_SWING_C * np.sin(2 * np.pi * grid / self.period_s + self.phase)
        state = np.full(len(self.lag_s), ambient[0])
        rows = np.empty((len(grid), len(self.lag_s)))
        follow = 1.0 - np.exp(-self.dt_s / self.lag_s)
        for i, outside in enumerate(ambient):
            state = state + follow * (outside - state)
            rows[i] = state
        return np.column_stack([np.interp(t_s, grid, row) for row in rows.T])


def weather(n_joints: int, span_s: float, rng: np.random.Generator) -> Weather:
    lag = np.concatenate([rng.uniform(40, 150, n_joints), rng.uniform(60, 200, n_joints), [60.0], [100.0]])
    return Weather(span_s / rng.uniform(2.5, 4.0), rng.uniform(0, 2 * np.pi), lag)


def _wind(before: np.ndarray, move: np.ndarray) -> np.ndarray:
    """Dahl friction along a monotone move: the wound-up state runs into +-1."""
    end = np.sign(move)
    return np.where(move == 0.0, before, end + (before - end) * np.exp(-np.abs(move) / PRESLIDING_RAD))


def run(
    arm: Arm,
    todo: list[Visit],
    sky: Weather,
    span_s: float,
    rng: np.random.Generator,
    *,
    order: str,
    still=False,
) -> list[Moment]:
    """Moments of a campaign, one a visit. The joints carry their history along. still: read at full rest."""
    n = len(todo)
    t_s = span_s / n * (np.arange(n) + rng.uniform(0.2, 0.8, n))
    temps = sky.field(t_s)
    speed = 0.0 if still else REST_SPEED_RAD_S
    moments = []
    q_at = np.array(arm.spec["motion"]["home_rad"], float)
    wound = np.zeros(arm.n)
    for i, visit in enumerate(todo):
        target = np.clip(visit.q + REPEAT_RAD * rng.standard_normal(arm.n), arm.q_min, arm.q_max)
        if order == "sorted":
            direction = np.where(target >= q_at, 1.0, -1.0)
            wound = _wind(wound, target - q_at)
        else:
            direction = rng.choice([-1.0, 1.0], arm.n)
            start = target - direction * rng.uniform(*APPROACH_RAD, arm.n)
            wound = _wind(_wind(wound, start - q_at), target - start)
        q_at = target
        moments.append(
            Moment(
                q=target,
                dir=direction,
                wind=wound.copy(),
                qdot=speed * rng.standard_normal(arm.n),
                t_s=float(t_s[i]),
                temp_c=float(temps[i, 2 * arm.n] + 0.2 * rng.standard_normal()),
                joint_temp_c=temps[i, : arm.n],
                link_temp_c=temps[i, arm.n : 2 * arm.n],
                camera_temp_c=float(temps[i, 2 * arm.n + 1]),
                payload_kg=visit.payload_kg,
                pan=visit.pan,
                tilt=visit.tilt,
                tag=visit.tag,
            )
        )
    return moments


def reported_camera(table: Arm, now: Moment) -> np.ndarray:
    """T_base_cam that the table and the head encoders give."""
    table.set(now.q, now.pan, now.tilt)
    return table.T_base_cam
