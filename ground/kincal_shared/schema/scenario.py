"""Scenarios of the simulator (sim/scenarios/*.toml): what is wrong with the arm, its surroundings, what
is asked of flight, and what must come out."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Literal

import pydantic

from .acquisitions import Acquisition
from .base import Strict
from .errors import Contradiction, read_toml, validate
from .numbers import Count, NotNegative, Quantity, Real, Vec3
from .simulator import DetectionSettings, OpticsSettings

GRAVITY_EARTH_M_S2 = (0.0, 0.0, -9.81)
_ERROR = re.compile(r"(J\d+\.(phi_rad|alpha_rad|a_m|d_m)|(base|tool)\.(t[xyz]_m|r[xyz]_rad))")
_JOINT = re.compile(r"J[1-9]\d*")


def _are_errors(errors: dict[str, float]) -> dict[str, float]:
    for name in errors:
        if not _ERROR.fullmatch(name):
            raise Contradiction(
                "", f"{name!r} is no error", "they are called J1.phi_rad, J2.a_m, base.tx_m, tool.rz_rad ..."
            )
    return errors


def _is_joint(name: str) -> str:
    if not _JOINT.fullmatch(name):
        raise Contradiction("", f"{name!r} is no joint", "they are called J1, J2 ...")
    return name


def _are_joints(values: dict[str, float]) -> dict[str, float]:
    for name in values:
        _is_joint(name)
    return values


Errors = Annotated[dict[str, Real], pydantic.AfterValidator(_are_errors)]
PerJoint = Annotated[dict[str, Real], pydantic.AfterValidator(_are_joints)]
Joint = Annotated[str, pydantic.AfterValidator(_is_joint)]


class Section(Strict):
    """A table of a scenario; programs may change its values, and each change is checked."""

    model_config = pydantic.ConfigDict(frozen=False, validate_assignment=True)


class Coupling(Section):
    """The joint is off by size_rad tanh(q of one joint) cos(q of another)."""

    name: str = pydantic.Field(min_length=1)
    """Name of the coefficient in reports."""
    joint: Joint
    """Joint that is off: "J4"."""
    size_rad: Real
    """Size [rad]."""
    tanh: Joint
    """Joint whose angle goes into tanh."""
    cos: Joint
    """Joint whose angle goes into cos."""


class ArmTruth(Section):
    """Deviations of the true arm from nominal."""

    errors: Errors = {}
    """Errors by coefficient: "J7.phi_rad" = 1.3."""
    encoder_bias_rad: PerJoint = {}
    """Reading minus true angle, by joint [rad]."""
    encoder_gain: PerJoint = {}
    """The joint turns (1 + gain) x reading, by joint."""
    encoder_noise_rad: NotNegative = 0.0
    """1-sigma of the reading [rad]."""
    encoder_step_rad: NotNegative = 0.0
    """Quantisation of the reading [rad]; 0: none."""
    compliance_rad_per_nm: PerJoint = {}
    """Compliance under gravity, by joint [rad/(N m)]."""
    hysteresis_rad: PerJoint = {}
    """Offset by the direction of approach, by joint [rad]."""
    coupling: list[Coupling] = []
    """Couplings of joints."""


class Environment(Section):
    """Surroundings."""

    gravity_m_s2: Vec3 = GRAVITY_EARTH_M_S2
    """Gravity in the base frame [m/s^2]."""
    temp_c: Real = 20.0
    """Temperature of the arm [deg C]."""
    payload_kg: NotNegative = 0.0
    """Mass in the scoop [kg]."""


class Calibration(Section):
    """What the executive asks for; the defaults leave the choice to the flight tables."""

    acquisition: Literal["table", Acquisition] = "table"
    """How the next pose is chosen; table: as the configuration table says."""
    poses: Annotated[int, Count(ge=0)] = 0
    """Number of poses; 0: as the configuration table says."""
    estimate_mask: Annotated[int, Count(ge=0)] = 0
    """One bit per coefficient; 0: as the configuration table says."""
    start: Literal["at_once", "alarm"] = "at_once"
    """When the executive sends START: at once; or on the alarm of the monitor, from the joints that it names,
    while somebody else moves the arm and takes frames."""


class Limits(Section):
    """Executive: what it accepts without the ground, and how long it waits [s of mission time]."""

    accept: Literal["ground", "auto", "policy"] = "auto"
    """Who accepts a correction: an operator (ground), the executive within the limits below (auto), or flight
    by the policy of its CONFIG table (policy)."""
    pred_pos_max_m: NotNegative = 0.0016
    """Largest predicted position error that the executive accepts [m]; 5 mm are then three times as far."""
    pred_rot_max_rad: NotNegative = 0.02
    """Largest predicted rotation error that the executive accepts [rad]."""
    p_fit_min: Annotated[float, Quantity(ge=0.0, le=1.0)] = 0.001
    """Least probability of the fit that the executive accepts, as `accept_p_fit_min` of the shipped CONFIG.
    The verdict of flight alone lets more pass: a drifting camera gave a wrong correction with 3e-24."""
    outliers_max: Annotated[int, Count(ge=0)] = 2
    """Most rejected poses that the executive accepts; more are a case for an operator. An encoder that slips
    halfway leaves poses of two different arms, and the fit is of both."""
    outliers_share_max: NotNegative = 0.15
    """Largest share of rejected poses that the executive accepts. Of 11 poses before and after a camera was
    turned two were rejected, and the fit of the others was between both, 5.1 mm off."""
    undetermined_max: Annotated[int, Count(ge=0)] = 0
    """Most coefficients at their old value or at a bound that the executive accepts: the data did not
    determine them, and the predicted error knows nothing of them."""
    heartbeat_timeout_s: NotNegative = 5.0
    """Longest silence of flight [s]."""
    ack_timeout_s: NotNegative = 3.0
    """Longest wait for the answer to a command [s]."""
    pose_timeout_s: NotNegative = 600.0
    """Longest time for one pose [s]."""
    total_timeout_s: NotNegative = 7200.0
    """Longest time for the calibration [s]."""
    alarm_wait_s: NotNegative = 3600.0
    """With start = "alarm": longest wait for it [s]."""
    ground_wait_s: NotNegative = 0.0
    """With accept = "ground": how long the run goes on for its decision [s]."""


class Expect(Section):
    """What a correct system concludes; checked after the run."""

    verdict: Literal["", "no_change", "change", "poor"] = ""
    """Verdict of flight; "": any."""
    held_out_pos_m: NotNegative = 0.0
    """Largest position error at held-out poses [m]; 0: not checked."""
    held_out_rot_rad: NotNegative = 0.0
    """Largest rotation error at held-out poses [rad]; 0: not checked."""


class Scenario(Section):
    """One scenario."""

    name: str = ""
    """Name; the file's if absent."""
    title: str = ""
    """What it is, for people."""
    arm: ArmTruth = pydantic.Field(default_factory=ArmTruth)
    """What is wrong with the arm."""
    env: Environment = pydantic.Field(default_factory=Environment)
    """Surroundings."""
    optics: OpticsSettings = OpticsSettings()
    """Settings of the rendered camera that differ from models/camera.toml."""
    detection: DetectionSettings = DetectionSettings()
    """Settings of detections without pixels that differ from models/camera.toml."""
    calibration: Calibration = pydantic.Field(default_factory=Calibration)
    """What is asked of flight."""
    executive: Limits = pydantic.Field(default_factory=Limits)
    """Limits and waits of the executive."""
    expect: Expect = pydantic.Field(default_factory=Expect)
    """What must come out."""


def read_scenario(path: Path) -> Scenario:
    """Read a scenario. SchemaError lists all that is wrong; BadInput if there is no such file."""
    scenario = validate(Scenario, read_toml(path), str(path))
    scenario.name = scenario.name or path.stem
    return scenario
