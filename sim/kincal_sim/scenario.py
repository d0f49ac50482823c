"""Scenario files: what is wrong with the arm, its surroundings, what is asked of it, what must come out."""

from __future__ import annotations

import tomllib
import zlib
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np

from .arm import GRAVITY_EARTH, Arm, load_spec, split_errors
from .effects import Compliance, Coupling, Hysteresis, Truth

SCENARIO_DIR = Path(__file__).resolve().parent.parent / "scenarios"
ACQUISITIONS = {"table": -1, "ucb": 0, "random": 1, "dopt": 2, "vopt": 3}
VERDICTS = ("no_change", "change", "poor")
COUPLING_KEYS = {"name", "joint", "size_rad", "tanh", "cos"}
ACCEPT = ("ground", "auto", "policy")


class ScenarioError(ValueError):
    """The scenario file asks for something that does not exist."""


@dataclass
class ArmTruth:
    """Deviations of the true arm from nominal."""

    errors: dict[str, float] = field(default_factory=dict)  # coefficient name -> value
    encoder_bias_rad: dict[str, float] = field(default_factory=dict)  # joint -> reading minus truth
    encoder_gain: dict[str, float] = field(default_factory=dict)  # joint -> turns (1 + gain) x reading
    encoder_noise_rad: float = 0.0
    encoder_step_rad: float = 0.0  # quantisation, 0 = none
    compliance_rad_per_nm: dict[str, float] = field(default_factory=dict)
    hysteresis_rad: dict[str, float] = field(default_factory=dict)  # joint -> offset by approach direction
    # { name, joint, size_rad, tanh, cos }: the joint is off by size_rad tanh(q of one) cos(q of another)
    coupling: list[dict] = field(default_factory=list)


@dataclass
class Environment:
    gravity_m_s2: list[float] = field(default_factory=lambda: list(GRAVITY_EARTH))
    temp_c: float = 20.0
    payload_kg: float = 0.0


@dataclass
class Calibration:
    """What the executive asks for; the defaults leave the choice to the flight tables."""

    acquisition: str = "table"
    poses: int = 0
    estimate_mask: int = 0


@dataclass
class Limits:
    """Executive: what it accepts without the ground, and how long it waits [s of mission time]."""

    accept: str = "auto"
    pred_pos_max_m: float = 0.005
    pred_rot_max_rad: float = 0.02
    outliers_max: int = 5
    heartbeat_timeout_s: float = 5.0
    ack_timeout_s: float = 3.0
    pose_timeout_s: float = 600.0
    total_timeout_s: float = 7200.0
    ground_wait_s: float = 0.0  # accept = "ground": how long the run goes on for its decision


@dataclass
class Expect:
    """What a correct system makes of it; checked by launch, the tests and hil."""

    verdict: str = ""
    held_out_pos_m: float = 0.0
    held_out_rot_rad: float = 0.0


@dataclass
class Scenario:
    name: str
    title: str
    arm: ArmTruth = field(default_factory=ArmTruth)
    env: Environment = field(default_factory=Environment)
    camera: dict = field(default_factory=dict)  # settings of the camera, see camera.py
    fastcam: dict = field(default_factory=dict)  # noise of the fast mode, see fastcam.py
    calibration: Calibration = field(default_factory=Calibration)
    executive: Limits = field(default_factory=Limits)
    expect: Expect = field(default_factory=Expect)

    def build_arm(self) -> Arm:
        return Arm(load_spec(), self.arm.errors, self.env.gravity_m_s2, self.env.payload_kg)

    def build_truth(self, arm: Arm) -> Truth:
        """The map from encoder readings to true joints, on this arm."""
        c = per_joint(self.arm.compliance_rad_per_nm, arm.n)
        h = per_joint(self.arm.hysteresis_rad, arm.n)
        effects = ([Compliance(c)] if c.any() else []) + ([Hysteresis(h)] if h.any() else [])
        effects += [
            Coupling(
                joint_index(k["joint"], arm.n),
                k["size_rad"],
                *(joint_index(k[x], arm.n) for x in ("tanh", "cos")),
            )
            for k in self.arm.coupling
        ]
        return Truth(
            arm, per_joint(self.arm.encoder_bias_rad, arm.n), per_joint(self.arm.encoder_gain, arm.n), effects
        )

    def coefficients(self) -> dict[str, float]:
        """Injected errors as the values that a perfect calibration would find. An encoder that reads b too
        much means that the joint stands at q - b, which is a DH error phi of -b."""
        found = dict(self.arm.errors)
        for joint, bias in self.arm.encoder_bias_rad.items():
            found[f"{joint}.phi_rad"] = found.get(f"{joint}.phi_rad", 0.0) - bias
        for joint, gain in self.arm.encoder_gain.items():
            found[f"encoder_gain[{joint[1:]}]"] = gain
        for joint, c in self.arm.compliance_rad_per_nm.items():
            found[f"joint_compliance[{joint[1:]}]"] = c
        for joint, h in self.arm.hysteresis_rad.items():
            found[f"backlash[{joint[1:]}]"] = h
        found |= {k["name"]: k["size_rad"] for k in self.arm.coupling}
        return found


def per_joint(named: dict[str, float], n: int) -> np.ndarray:
    """Values named J1..Jn as a vector."""
    out = np.zeros(n)
    for name, value in named.items():
        out[joint_index(name, n)] = value
    return out


def joint_index(name: str, n: int) -> int:
    """0 for J1."""
    if name not in (f"J{j + 1}" for j in range(n)):
        raise ScenarioError(f"unknown joint '{name}'; known: J1..J{n}")
    return int(name[1:]) - 1


def _take(cls, where: str, data: dict):
    """A dataclass from a TOML table; unknown keys are errors, so that no typing slip passes silently."""
    known = {f.name for f in fields(cls)}
    unknown = sorted(set(data) - known)
    if unknown:
        raise ScenarioError(f"[{where}] has unknown key '{unknown[0]}'; known: {', '.join(sorted(known))}")
    return cls(**data)


def find(name: str | Path) -> Path:
    """A scenario by file name or by its bare name."""
    path = Path(name)
    if path.exists():
        return path
    path = SCENARIO_DIR / f"{name}.toml"
    if not path.exists():
        known = ", ".join(sorted(p.stem for p in SCENARIO_DIR.glob("*.toml")))
        raise ScenarioError(f"no scenario '{name}'; known: {known}, or give a file")
    return path


def load(name: str | Path) -> Scenario:
    """Read and check a scenario."""
    path = find(name)
    with open(path, "rb") as f:
        data = tomllib.load(f)
    parts = {
        "arm": ArmTruth,
        "env": Environment,
        "calibration": Calibration,
        "executive": Limits,
        "expect": Expect,
    }
    for key, cls in parts.items():
        if key in data:
            data[key] = _take(cls, key, data[key])
    scenario = _take(Scenario, path.name, {"name": path.stem, "title": "", **data})
    _check(scenario)
    return scenario


def _check(s: Scenario) -> None:
    n = len(load_spec()["joint"])
    split_errors(s.arm.errors, n)
    a = s.arm
    for named in (a.encoder_bias_rad, a.encoder_gain, a.compliance_rad_per_nm, a.hysteresis_rad):
        per_joint(named, n)
    for k in a.coupling:
        if set(k) != COUPLING_KEYS:
            raise ScenarioError(
                f"[arm] coupling needs {', '.join(sorted(COUPLING_KEYS))}; it has {', '.join(k)}"
            )
    for value, known in (
        (s.calibration.acquisition, ACQUISITIONS),
        (s.executive.accept, ACCEPT),
        (s.expect.verdict, ("", *VERDICTS)),
    ):
        if value not in known:
            raise ScenarioError(f"'{value}' is not one of {', '.join(k for k in known if k)}")


def generator(seed: int, purpose: str) -> np.random.Generator:
    """Random numbers for one purpose: adding a consumer changes nobody else's numbers."""
    return np.random.default_rng([seed, zlib.crc32(purpose.encode())])
