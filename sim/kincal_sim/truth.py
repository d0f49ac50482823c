"""From a scenario to the true arm, and the record of that truth to evaluate a correction with."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from kincal_shared.schema.scenario import Coupling

from .mechanics.arm import Arm
from .mechanics.effects import Hysteresis, JointCompliance, JointFunction
from .mechanics.plant import Conditions, Effect, Encoders, Plant
from .mechanics.spec import joint_index, load_spec, per_joint
from .randomness import generator
from .scenario import Scenario
from .transforms import quaternion

HELD_OUT_N = 200
HELD_OUT_TRIES = 200_000
DRAWN_AT_ONCE = 500


def build_plant(scenario: Scenario, pictures: bool = True) -> Plant:
    """The arm of a scenario with its errors, encoders, effects, gravity and payload. pictures: whether any
    will be taken of it."""
    spec, truth, env = load_spec(), scenario.arm, scenario.env
    n = len(spec["joint"])
    return Plant(
        spec,
        truth.errors,
        payloads_kg=(env.payload_kg,),
        gravity_m_s2=env.gravity_m_s2,
        encoders=Encoders(per_joint(truth.encoder_bias_rad, n), per_joint(truth.encoder_gain, n)),
        effects=_effects(scenario, n),
        pictures=pictures,
    )


def _effects(scenario: Scenario, n: int) -> list[Effect]:
    compliance = per_joint(scenario.arm.compliance_rad_per_nm, n)
    hysteresis = per_joint(scenario.arm.hysteresis_rad, n)
    effects: list[Effect] = []
    if compliance.any():
        effects.append(JointCompliance(compliance))
    if hysteresis.any():
        effects.append(Hysteresis(hysteresis))
    return effects + [_coupling(row, n) for row in scenario.arm.coupling]


def _coupling(row: Coupling, n: int) -> Effect:
    """A joint that is off by size_rad tanh(true angle of one joint) cos(that of another)."""
    joint, a, b = (joint_index(name, n) for name in (row.joint, row.tanh, row.cos))
    size = row.size_rad
    return JointFunction(joint, lambda _at, loads: size * np.tanh(loads.q_rad[a]) * np.cos(loads.q_rad[b]))


def conditions(
    scenario: Scenario,
    q_rad: np.ndarray,
    direction: np.ndarray | float = 0.0,
    t_s: float = 0.0,
    pantilt_rad: tuple[float, float] = (0.0, 0.0),
) -> Conditions:
    """Conditions of an observation in the scenario's surroundings. q_rad: (n,) encoder readings;
    direction: (n,) signs of the last motion; t_s: mission time; pantilt_rad: encoders of the pan-tilt
    unit."""
    (pan_rad, tilt_rad), env = pantilt_rad, scenario.env
    return Conditions(
        q_rad=q_rad,
        direction=direction,
        t_s=t_s,
        temp_c=env.temp_c,
        payload_kg=env.payload_kg,
        pan_rad=pan_rad,
        tilt_rad=tilt_rad,
    )


def true_coefficients(scenario: Scenario) -> dict[str, float]:
    """The injected errors as values that a perfect calibration would find, by coefficient name.

    An encoder that reads b too much means that the joint stands at q - b, which is a DH error phi of -b.
    """
    truth = scenario.arm
    found = dict(truth.errors)
    for joint, bias in truth.encoder_bias_rad.items():
        found[f"{joint}.phi_rad"] = found.get(f"{joint}.phi_rad", 0.0) - bias
    for name, values in (
        ("encoder_gain", truth.encoder_gain),
        ("joint_compliance", truth.compliance_rad_per_nm),
        ("backlash", truth.hysteresis_rad),
    ):
        found |= {f"{name}[{joint[1:]}]": value for joint, value in values.items()}
    return found | {row.name: row.size_rad for row in truth.coupling}


def truth_record(scenario: Scenario, plant: Plant, seed: int, mode: str) -> dict:
    """What truth.json holds: errors by name, surroundings, held-out poses. mode: "fast" or "pixels"."""
    env = scenario.env
    return {
        "scenario": scenario.name,
        "title": scenario.title,
        "seed": seed,
        "mode": mode,
        "errors": true_coefficients(scenario),
        "encoder_bias_rad": plant.encoders.bias_rad.tolist(),
        "env": {
            "gravity_m_s2": list(env.gravity_m_s2),
            "temp_c": env.temp_c,
            "payload_kg": env.payload_kg,
        },
        "held_out": held_out_poses(scenario, plant, seed),
    }


def _random_postures(arm: Arm, seed: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Readings inside the limits and sides they are reached from, (n,) each, HELD_OUT_TRIES times."""
    rng, rng_sides = generator(seed, "held out"), generator(seed, "held out sides")
    for _ in range(HELD_OUT_TRIES // DRAWN_AT_ONCE):
        q = rng.uniform(arm.q_min, arm.q_max, (DRAWN_AT_ONCE, arm.n))
        yield from zip(q, rng_sides.choice([-1, 1], (DRAWN_AT_ONCE, arm.n)), strict=True)


def held_out_poses(scenario: Scenario, plant: Plant, seed: int, n: int = HELD_OUT_N) -> list[dict]:
    """n random poses inside the joint limits with the tool in the search region.

    Each is reached from a random side: q_rad (readings) and dir [-1, 1], then p_m and q_wxyz, where the tool
    truly is in the base frame. Raises ArithmeticError if too few random poses lie in the region.
    """
    arm, region = plant.arm(scenario.env.payload_kg), plant.spec["region"]
    (x_min, y_min, z_min), (x_max, y_max, z_max) = region["min_m"], region["max_m"]
    found: list[dict] = []
    for q, side in _random_postures(arm, seed):
        if plant.effects:
            plant.stand(conditions(scenario, q, side))
        else:  # depends on nothing but the joints
            arm.set(plant.encoders.joints_rad(q), 0.0, 0.0)
        x_m, y_m, z_m = p_m = arm.p_base_tool_m.tolist()
        if x_min <= x_m <= x_max and y_min <= y_m <= y_max and z_min <= z_m <= z_max:
            reached = {"q_rad": q.tolist(), "dir": side.tolist()}
            found.append(reached | {"p_m": p_m, "q_wxyz": quaternion(arm.T_base_tool).tolist()})
        if len(found) == n:
            return found
    raise ArithmeticError(f"only {len(found)} of {HELD_OUT_TRIES} random poses have the tool in the region")
