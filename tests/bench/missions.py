"""Arms that benches calibrate, and how far a correction is off the true one.

Scenarios: healthy, the paper's errors, one encoder that has slipped, and an arm with a soft elbow whose
TERMS table has the effect. The truth is MuJoCo's; nothing here uses flight's kinematics.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from pathlib import Path

import numpy as np

from kincal.flight import library
from kincal.flight import tables as codec
from kincal.flight.bounds import Flown
from kincal.run.inprocess import TABLES
from kincal.workbench import Library
from kincal.workbench.evidence.constants import choose_constants
from kincal.workbench.model.uplink import term_image
from kincal_shared.schema.arm import read_arm
from kincal_sim.mechanics.plant import Plant
from kincal_sim.mechanics.spec import load_spec
from kincal_sim.randomness import generator
from kincal_sim.scenario import ArmTruth, Scenario, load
from kincal_sim.transforms import rot, transform
from kincal_sim.truth import build_plant, conditions

SCENARIOS = ("healthy", "paper", "slipped", "uplinked")
EFFECT = "joint_compliance[4]"
HELD_OUT = 100
BUILD = Path(__file__).resolve().parents[2] / "build"
FLIGHT = library("flight")
Seen = Callable[[np.ndarray, float, float], np.ndarray]
"""(true pose in the base frame (4x4), pan, tilt [rad]) -> the pose at which the camera sees it, base frame
(4x4)."""
CAMERA_ON_TILT = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # camera on the tilt frame


def scenario_of(name: str, seed: int) -> Scenario:
    """One of SCENARIOS, with errors that the seed draws."""
    rng = generator(seed, f"errors of {name}")
    sign = float(rng.choice([-1.0, 1.0]))
    if name in ("healthy", "paper"):
        return load(name)
    if name == "slipped":
        bias = {f"J{rng.integers(1, 8)}": sign * float(rng.uniform(0.02, 0.09))}
        arm = ArmTruth(encoder_bias_rad=bias)
    else:
        compliance = {"J4": float(rng.uniform(0.001, 0.004))}
        arm = ArmTruth(compliance_rad_per_nm=compliance, errors={"J2.phi_rad": 0.005 * sign})
    return load("healthy").model_copy(deep=True, update={"name": name, "arm": arm})


@cache
def names(scenario: str) -> tuple[str, ...]:
    """Coefficients of the TERMS table of a scenario, in its order."""
    _, terms = codec.decode_as("terms", (tables_of(scenario) / "terms.tbl").read_bytes())
    return tuple(FLIGHT.text(terms.coef[k].name) for k in range(terms.n_coef))


@cache
def tables_of(scenario: str, policy: bool = False) -> Path:
    """Folder with the shipped tables; policy: flight may accept on board; "uplinked": with the effect."""
    folder = BUILD / "missions" / f"{os.getpid()}-{scenario == 'uplinked'}-{policy}"
    shutil.copytree(TABLES, folder, dirs_exist_ok=True)
    if policy:
        _, config = codec.decode_as("config", (TABLES / "config.tbl").read_bytes())
        config.accept_on_board = 1
        (folder / "config.tbl").write_bytes(codec.encode("config", config).data)
    if scenario == "uplinked":
        arm, library_ = read_arm("wam"), Library.load()
        terms = term_image(arm, choose_constants(library_, [EFFECT], arm, None), Flown.read(TABLES))
        kin = codec.new("kin")
        kin.n_coef = codec.decode_as("terms", terms.data)[1].n_coef
        (folder / "terms.tbl").write_bytes(terms.data)
        (folder / "kin.tbl").write_bytes(codec.encode("kin", kin).data)
    return folder


def nees(proposal, errors: dict[str, float], names_: Iterable[str]) -> tuple[float, int]:
    """Squared normalised error of the coefficients that the data determined, and their number.
    names_: the coefficients of the TERMS table (names())."""
    n = proposal.n_coef
    C = np.zeros((n, n))
    C[np.triu_indices(n)] = proposal.cov[: n * (n + 1) // 2]
    C = C + np.triu(C, 1).T
    e = np.array([v - errors.get(k, 0.0) for k, v in zip(names_, proposal.value, strict=False)])
    use = np.flatnonzero(np.diag(C) > 0.0)
    scale = np.sqrt(np.diag(C)[use])
    z = e[use] / scale
    return float(z @ np.linalg.solve(C[np.ix_(use, use)] / np.outer(scale, scale), z)), len(use)


def plant_of(scenario: Scenario, correction: Mapping[str, float]) -> Plant:
    """The arm that a correction describes, in the surroundings of a scenario: a MuJoCo arm of its own."""
    dh = {name: value for name, value in correction.items() if name.startswith("J")}
    effect = {"J4": correction[EFFECT]} if correction.get(EFFECT) else {}
    believed = ArmTruth(errors=dh, compliance_rad_per_nm=effect)
    return build_plant(scenario.model_copy(update={"arm": believed}))


@cache
def _pantilt() -> dict:
    """The simulator's numbers of mast and camera."""
    return load_spec()["pantilt"]


def camera_pose(pan_rad: float, tilt_rad: float) -> np.ndarray:
    """T_base_cam (4x4) by the simulator's numbers."""
    spec = _pantilt()
    mast = transform(np.array(spec["mast_xyz_m"]), np.eye(3)) @ rot("z", pan_rad) @ rot("y", tilt_rad)
    return mast @ transform(np.array(spec["camera_xyz_m"]), CAMERA_ON_TILT)


def aimed(p_base_m: np.ndarray) -> tuple[float, float]:
    """Pan and tilt that look at a point [rad]."""
    d = p_base_m - np.array(_pantilt()["mast_xyz_m"])
    return float(np.arctan2(d[1], d[0])), float(-np.arctan2(d[2], np.hypot(d[0], d[1])))


def error_m(
    scenario: Scenario,
    correction: Mapping[str, float],
    seed: int,
    slip_rad: np.ndarray | float = 0.0,
    seen: Seen | None = None,
) -> float:
    """RMS distance of the tool of a correction (values by coefficient name) from the true tool, over
    postures with the true tool in the search region. slip_rad: by how much encoders read wrong besides
    (n,); seen: the tool has to be where the camera sees its target; None: right in the base frame."""
    true, believed = build_plant(scenario), plant_of(scenario, correction)
    arm, region = true.arm(scenario.env.payload_kg), true.spec["region"]
    rng, found = generator(seed, "held out"), []
    while len(found) < HELD_OUT:
        q = rng.uniform(arm.q_min, arm.q_max)
        T = true.settle(conditions(scenario, q - slip_rad)).T_base_tool
        if not (np.all(T[:3, 3] >= region["min_m"]) and np.all(T[:3, 3] <= region["max_m"])):
            continue
        p = T[:3, 3] if seen is None else seen(T, *aimed(T[:3, 3]))[:3, 3]
        off = believed.settle(conditions(scenario, q)).T_base_tool[:3, 3] - p
        found.append(float(off @ off))
    return float(np.sqrt(np.mean(found)))


def in_camera(change: Callable[[np.ndarray], np.ndarray]) -> Seen:
    """Everything that the camera sees is changed alike: change(T) of poses (4x4) in its frame."""

    def seen(T_base: np.ndarray, pan_rad: float, tilt_rad: float) -> np.ndarray:
        C = camera_pose(pan_rad, tilt_rad)
        return C @ change(np.linalg.inv(C) @ T_base)

    return seen
