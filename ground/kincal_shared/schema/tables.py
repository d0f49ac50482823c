"""Sources of flight tables (tables/src/*.toml): one model a kind of table (docs/TABLES.md).

Keys are the field names of the kind's C struct, which the headers in fsw/ define; a test compares them.
For people, some fields may be left out or written shorter: masses of the arm, [dh] and joints = [...] of the
terms, lists in a [[set]] of the kernel, n_coef of the correction. What a value may be is up to flight's own
check.
"""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal

import pydantic

from .acquisitions import Acquisition
from .arm import Quat
from .base import Strict
from .errors import Contradiction
from .numbers import Angle, Count, NotNegative, Positive, Real, Vec3
from .terms import TermEntry

# Limits of the flight tables; tests/ground/test_schema.py compares them with the headers.
NAME_CHARACTERS = 23
JOINT_MAX = 8
COEF_MAX = 64

Natural = Annotated[int, Count(ge=0)]
Microseconds = Annotated[int, Count(ge=0)]
Switch = Annotated[int, Count(ge=0, le=1)]
Crc = Annotated[int, Count(ge=0, le=0xFFFFFFFF)]
Mask = Annotated[int, Count(ge=0, le=0xFFFFFFFFFFFFFFFF)]
TableName = Annotated[str, pydantic.Field(min_length=1)]
JointNumber = Annotated[int, Count(ge=1, le=JOINT_MAX)]


def _fits(name: str) -> str:
    if len(name) > NAME_CHARACTERS:
        raise Contradiction("", f"is {name!r}, longer than {NAME_CHARACTERS} characters")
    return name


def _is_unit(quat: Quat) -> Quat:
    if abs(math.hypot(*quat) - 1.0) > 1e-3:
        raise Contradiction("", f"has norm {math.hypot(*quat):.6g}, 1 is needed")
    return quat


UnitQuat = Annotated[Quat, pydantic.AfterValidator(_is_unit)]
ShortName = Annotated[TableName, pydantic.AfterValidator(_fits)]


class Source(Strict):
    """What every source may say beside the fields of its table."""

    title: str = ""
    """What the table is, for people."""
    provenance: dict[str, str] = {}
    """Where the numbers come from."""


# --------------------------------------------------------------------------- arm


class ArmSourceJoint(Strict):
    """One joint and its link, standard DH."""

    joint_name: str = ""
    """What people call the joint."""
    type: Literal["revolute", "prismatic"]
    """revolute turns, prismatic slides along its axis."""
    phi_rad: Angle = pydantic.Field(examples=[0.0])
    """Offset of the joint angle at reading 0 [rad]."""
    alpha_rad: Angle = pydantic.Field(examples=["-pi/2"])
    """DH twist alpha [rad]."""
    a_m: Real = pydantic.Field(examples=[0.0])
    """DH length a [m]."""
    d_m: Real = pydantic.Field(examples=[0.0])
    """DH offset d [m]."""
    q_min: Real
    """Lower limit of the reading [rad or m]."""
    q_max: Real
    """Upper limit of the reading [rad or m]."""
    speed_max: Real
    """Largest speed in operations [rad/s or m/s]."""
    mass_kg: NotNegative | None = None
    """Mass of the link [kg], with com_m; without, effects of gravity are not computed."""
    com_m: Vec3 | None = None
    """Centre of mass in the frame of the link [m]."""
    gear_ratio: Real = 0.0
    """Motor turns per joint turn, 0: unknown."""

    @pydantic.model_validator(mode="after")
    def _goes_together(self) -> ArmSourceJoint:
        if not self.q_min < self.q_max:
            raise Contradiction("q_min", f"is {self.q_min:g}, which is not below q_max {self.q_max:g}")
        if (self.mass_kg is None) != (self.com_m is None):
            given, other = ("mass_kg", "com_m") if self.com_m is None else ("com_m", "mass_kg")
            raise Contradiction(other, f"is missing beside {given}", "write both or neither")
        return self


class ArmSource(Source):
    """Source of the arm table (kc_arm_t)."""

    kind: Literal["arm"]
    """Kind of table."""
    name: ShortName
    """Name of the arm, at most 23 characters."""
    base_xyz_m: Vec3
    """Origin of frame 0 in the base frame [m]."""
    base_quat_wxyz: UnitQuat
    """Orientation of frame 0 in the base frame, scalar part first."""
    tool_xyz_m: Vec3
    """Origin of the tool frame in the last link frame [m]."""
    tool_quat_wxyz: UnitQuat
    """Orientation of the tool frame in the last link frame, scalar part first."""
    gravity_m_s2: Vec3
    """Gravity in the base frame [m/s^2]."""
    joint: list[ArmSourceJoint] = pydantic.Field(min_length=1, max_length=JOINT_MAX)
    """Joints from the base to the tool."""


# --------------------------------------------------------------------------- camera


class TagEntry(Strict):
    """One printed tag on the tool."""

    id: Natural
    """Member of the family 36h11."""
    size_m: Positive
    """Edge of the black square [m]."""
    xyz_m: Vec3
    """Centre in the tool frame [m]."""
    quat_wxyz: UnitQuat
    """Orientation in the tool frame: x right, y down, z into the tag as a viewer sees it."""


class CameraSource(Source):
    """Source of the camera table (kc_camera_t): camera on its pan-tilt unit, and the tags."""

    kind: Literal["camera"]
    """Kind of table."""
    mast_xyz_m: Vec3
    """Pan-tilt unit in the base frame [m]."""
    mast_quat_wxyz: UnitQuat
    """Orientation of the pan-tilt unit in the base frame at pan = tilt = 0."""
    pantilt_xyz_m: Vec3
    """Camera in the frame of the pan-tilt unit [m]."""
    pantilt_quat_wxyz: UnitQuat
    """Orientation of the camera in the frame of the pan-tilt unit."""
    pan_min_rad: Angle
    """Lower limit of pan [rad]."""
    pan_max_rad: Angle
    """Upper limit of pan [rad]."""
    tilt_min_rad: Angle
    """Lower limit of tilt [rad]."""
    tilt_max_rad: Angle
    """Upper limit of tilt [rad], positive looks down."""
    fx_px: Positive
    """Focal length along u [px]."""
    fy_px: Positive
    """Focal length along v [px]."""
    cx_px: Real
    """Principal point, u [px]."""
    cy_px: Real
    """Principal point, v [px]."""
    width_px: Natural
    """Width of the image [px]."""
    height_px: Natural
    """Height of the image [px]."""
    mast_sigma_m: NotNegative
    """1-sigma of the place of the pan-tilt unit on its mast, each axis [m]; here and below 0: exact."""
    mast_sigma_rad: NotNegative
    """1-sigma of its orientation, each axis [rad]."""
    zero_sigma_rad: NotNegative
    """1-sigma of the zeros of pan and tilt [rad]."""
    axis_sigma_rad: NotNegative
    """1-sigma of axes that are not square to each other, and of the camera on its mount [rad]."""
    tag_size_sigma: NotNegative
    """1-sigma of the size of all tags together, relative."""
    plate_sigma_m: NotNegative
    """1-sigma of the place of all tags together on the tool, each axis [m]."""
    plate_sigma_rad: NotNegative
    """1-sigma of their orientation, each axis [rad]."""
    drift_sigma_m_s: NotNegative
    """1-sigma of a steady drift of the mast during a calibration, each axis [m/s]."""
    drift_sigma_rad_s: NotNegative
    """1-sigma of a steady turning of the mast during a calibration, each axis [rad/s]."""
    tag: list[TagEntry] = pydantic.Field(min_length=1, max_length=4)
    """Tags on the tool."""

    @pydantic.model_validator(mode="after")
    def _has_room(self) -> CameraSource:
        for axis in ("pan", "tilt"):
            low, high = getattr(self, f"{axis}_min_rad"), getattr(self, f"{axis}_max_rad")
            if not low < high:
                raise Contradiction(
                    f"{axis}_min_rad", f"is {low:g}, which is not below {axis}_max_rad {high:g}"
                )
        return self


# --------------------------------------------------------------------------- terms


class OfEachDh(Strict):
    """One number for each kind of DH error."""

    phi_rad: NotNegative
    """Of the joint offset [rad]."""
    alpha_rad: NotNegative
    """Of the link twist [rad]."""
    a_m: NotNegative
    """Of the link length [m]."""
    d_m: NotNegative
    """Of the link offset [m]."""


class DhBounds(Strict):
    """Bound of each kind of DH error: one for all joints, or a list with one for each."""

    phi_rad: NotNegative | list[NotNegative]
    """Of the joint offset [rad]."""
    alpha_rad: NotNegative | list[NotNegative]
    """Of the link twist [rad]."""
    a_m: NotNegative | list[NotNegative]
    """Of the link length [m]."""
    d_m: NotNegative | list[NotNegative]
    """Of the link offset [m]."""


class DhBlock(Strict):
    """The four DH errors of every joint: J1.phi_rad, J1.alpha_rad, J1.a_m, J1.d_m, J2.phi_rad ..."""

    joints: JointNumber
    """Number of joints."""
    enabled: pydantic.StrictBool = True
    """true: estimated."""
    prior_sigma: OfEachDh
    """1-sigma of the prior about 0; 0: none."""
    scale: OfEachDh
    """Typical size, for rank decisions."""
    bound: DhBounds
    """Largest value, both ways."""

    @pydantic.model_validator(mode="after")
    def _one_bound_a_joint(self) -> DhBlock:
        for name in DhBounds.model_fields:
            bound = getattr(self.bound, name)
            if isinstance(bound, list) and len(bound) != self.joints:
                raise Contradiction(f"bound.{name}", f"has {len(bound)} bounds for {self.joints} joints")
        return self


class CoefEntry(Strict):
    """One coefficient, or with `joints` one for each of these joints, and the terms that carry it."""

    name: TableName = pydantic.Field(examples=["encoder_gain[{j}]"])
    """Name, at most 23 characters; {j} stands for the joint."""
    joints: list[JointNumber] | None = None
    """Joints j that get a coefficient of their own."""
    lb: Real
    """Lower bound of the value."""
    ub: Real
    """Upper bound of the value."""
    prior_sigma: NotNegative
    """1-sigma of the prior about 0; 0: none."""
    scale: Positive
    """Typical size, for rank decisions."""
    enabled: pydantic.StrictBool
    """true: estimated."""
    term: list[TermEntry] = pydantic.Field(min_length=1, examples=['term = [{ at = "base", comp = "tx" }]'])
    """Terms of the coefficient."""

    @pydantic.model_validator(mode="after")
    def _goes_together(self) -> CoefEntry:
        if not self.lb <= self.ub:
            raise Contradiction("lb", f"is {self.lb:g}, which is above ub {self.ub:g}")
        for j in self.joints or [0]:
            if len(self.name.replace("{j}", str(j))) > NAME_CHARACTERS:
                raise Contradiction("name", f"is longer than {NAME_CHARACTERS} characters")
        for number, term in enumerate(self.term, 1):
            self._has_values(term, f"term[{number}]")
        return self

    def _has_values(self, term: TermEntry, where: str) -> None:
        """Only j (and p before it) of `joints` have a value here; properties of links are the effect
        library's."""
        known = {"j", "p"} if self.joints else set()
        at = [term.place.joint] if term.place.joint and not term.place.joint.isdigit() else []
        basis = [letter for factor in term.factors for letter in factor.letters()]
        for key, letters in (("at", at), ("basis", basis)):
            for letter in letters:
                if letter not in known:
                    todo = "write joints = [...] or a number"
                    raise Contradiction(f"{where}.{key}", f"names joint {letter}", todo)
        if isinstance(term.gain, str):
            raise Contradiction(f"{where}.gain", f"is {term.gain!r}", "write a number")
        if any(
            token.startswith(("$", "N")) for f in term.factors for token in (f.scale, f.offset, f.divisor)
        ):
            raise Contradiction(
                f"{where}.basis", f"{term.basis!r} uses a constant by name", "write its number"
            )


class TermsSource(Source):
    """Source of the terms table (kc_terms_t): coefficients and the correction terms that carry them."""

    kind: Literal["terms"]
    """Kind of table."""
    dh: DhBlock | None = None
    """DH errors of all joints."""
    coef: list[CoefEntry] = []
    """Other coefficients."""
    kinematics_crc: Crc = 0
    """Kinematics CRC of the arm that the terms were made for (`kincal model uplink` writes it); 0: any."""


# --------------------------------------------------------------------------- kernel


class KernelSet(Strict):
    """Hyperparameters; lists stand for their whole grid."""

    nu: NotNegative | list[NotNegative]
    """Matern smoothness; 0: heat kernel."""
    kappa: Positive | list[Positive]
    """Length scale of rotation [rad]."""
    beta_m: Positive | list[Positive]
    """Length scale of position [m]."""
    sigma_s: Positive | list[Positive]
    """Signal standard deviation."""


class KernelSource(Source):
    """Source of the kernel table (kc_kernel_t): the Gaussian process that chooses poses."""

    kind: Literal["kernel"]
    """Kind of table."""
    arg: Literal["so3", "paper"]
    """so3: even degrees, blind to the sign of the quaternion; paper: all degrees, as printed."""
    choose: Switch
    """1: flight takes the set of largest marginal likelihood."""
    sigma_eps: NotNegative
    """Noise of the objective, which lies in [-1, 0]."""
    set: list[KernelSet] = pydantic.Field(min_length=1)
    """Sets; the first one is the default."""


# --------------------------------------------------------------------------- correction


class KinSource(Source):
    """Source of the correction in force (kc_kin_t): values of the coefficients."""

    kind: Literal["kin"]
    """Kind of table."""
    n_coef: Annotated[int, Count(ge=0, le=COEF_MAX)] | None = None
    """Number of coefficients, all zero; in place of value and sigma."""
    value: list[Real] | None = pydantic.Field(default=None, max_length=COEF_MAX)
    """Values of the coefficients."""
    sigma: list[NotNegative] | None = pydantic.Field(default=None, max_length=COEF_MAX)
    """1-sigma of the values."""
    arm_crc: Crc
    """CRC of the arm table that it belongs to; 0: any."""
    terms_crc: Crc
    """CRC of the terms table that it belongs to; 0: any."""
    prev_crc: Crc
    """CRC of the correction that it replaced; 0: none."""
    session: Natural
    """Calibration that made it; 0: none."""
    n_poses: Natural
    """Poses that it was estimated from."""
    made_us: Microseconds
    """Mission time when it was made [us]."""

    @pydantic.model_validator(mode="after")
    def _values_or_their_number(self) -> KinSource:
        lists = (self.value, self.sigma)
        if self.n_coef is None and None in lists:
            raise Contradiction("n_coef", "is missing", "write n_coef (all values zero), or value and sigma")
        if self.n_coef is not None and lists != (None, None):
            raise Contradiction("n_coef", "stands beside value or sigma", "write the number or the lists")
        if self.value is not None and self.sigma is not None and len(self.value) != len(self.sigma):
            raise Contradiction("sigma", f"has {len(self.sigma)} entries, value has {len(self.value)}")
        return self


# --------------------------------------------------------------------------- configuration


class ServoBlock(Strict):
    """Servo that brings the tool to a candidate by what the camera sees (kc_servo_opt_t)."""

    gain: Real
    """Share of the error that one step takes back, (0, 1]."""
    damping: Real
    """Damping of the least squares."""
    step_max: Real
    """Largest joint step [rad or m]."""
    bound: Real
    """No joint goes farther from its seed, whatever the space allows [rad or m]."""
    tol_pos_m: Real
    """Position that counts as there [m]."""
    tol_rot_rad: Real
    """Rotation that counts as there [rad]."""
    margin: Real
    """Distance from the joint limits [rad or m]."""


class EstimatorBlock(Strict):
    """Estimator (kc_est_opt_t)."""

    SYNONYMS: ClassVar[dict[str, str]] = {"mask": "free_mask"}

    free_mask: Mask
    """One bit per coefficient that is estimated."""
    iter_max: Natural
    """Gauss-Newton iterations of one fit."""
    tol_step: Real
    """Converged when every step is below this times its scale."""
    rank_tol: Real
    """A scaled pivot below this times the largest is dependent."""
    outlier_p: Real
    """Family-wise chance of rejecting a good pose; 0: off."""
    outlier_max: Natural
    """Poses that may be rejected."""
    use_prior: Switch
    """1: priors of the terms table count."""


class ConfigSource(Source):
    """Source of the configuration table (kc_config_t): how a calibration is run."""

    kind: Literal["config"]
    """Kind of table."""
    acquisition: Acquisition
    """How the next pose is chosen."""
    n_poses: Natural
    """Poses of a calibration."""
    replicate_every: Natural
    """After so many poses one is measured again; 0: never."""
    beta_scale: Real
    """Scale of the exploration weight."""
    a1: Real
    """Weight of position in the objective."""
    sp_floor_m: Real
    """Least position scale of the objective [m]."""
    sq_floor_rad: Real
    """Least rotation scale of the objective [rad]."""
    vopt_len_m: Real
    """Length that counts as 1 rad for V-optimality [m]."""
    stop_pos_m: Real
    """Stop when the position error over the search space is below this [m]; 0: off."""
    stop_rot_rad: Real
    """Stop when the rotation error over the search space is below this [rad]; 0: off."""
    frames_per_meas: Natural
    """Frames of one measurement."""
    frame_retries: Natural
    """Frames that are asked for again."""
    settle_us: Microseconds
    """Rest after a motion before a frame counts [us]."""
    frame_timeout_us: Microseconds
    """Longest wait for a frame [us]."""
    move_timeout_us: Microseconds
    """Longest wait for a motion [us]."""
    frame_age_max_us: Microseconds
    """Oldest frame that counts [us]."""
    search_steps: Natural
    """Pan-tilt directions that are searched around the expected one."""
    search_step_rad: Real
    """Angle between them [rad]."""
    jump_pos_m: Real
    """Frames of one measurement may differ by this [m]."""
    jump_rot_rad: Real
    """Frames of one measurement may differ by this [rad]."""
    sigma_pos_max_m: Real
    """A detection less certain is refused [m]."""
    sigma_rot_max_rad: Real
    """A detection less certain is refused [rad]."""
    sigma_pos_min_m: Real
    """Detections claim no better [m]."""
    sigma_rot_min_rad: Real
    """Detections claim no better [rad]."""
    rms_max_px: Real
    """A detection with a larger residual is refused [px]."""
    servo_steps_max: Natural
    """Servo steps at one candidate."""
    speed_scale: Real
    """Share of the arm's speed limits that is used."""
    arrive_tol: Real
    """Joint distance that counts as arrived [rad or m]."""
    approach_rad: Real
    """Last motion before a measurement, from a random side of every joint [rad or m]; 0: off."""
    accept_on_board: Switch
    """1: flight may accept a correction without the ground."""
    accept_change_max_pos_m: Real
    """RMS change of the predicted position up to which it may [m]."""
    accept_sigma_max_pos_m: Real
    """Predicted position sigma up to which it may [m]."""
    accept_p_fit_min: Real
    """p-value of the fit from which it may."""
    frame: Literal["camera", "lander"] = "camera"
    """Where a correction has to be right: camera, where the camera sees; lander, in the base frame."""
    no_change_p: Real
    """p-value above which nothing needs to change."""
    budget_us: Microseconds
    """Time for a calibration [us]; 0: no limit."""
    power_idle_w: Real
    """Power at rest [W]."""
    power_move_w: Real
    """Power while arm or pan-tilt unit move [W]."""
    energy_budget_j: Real
    """Energy for a calibration [J]; 0: no limit."""
    mismatch_pos_m: Real
    """An observation farther than this from the best correction within its bounds stops the calibration
    [m]."""
    mismatch_rot_rad: Real
    """An observation farther than this from the best correction within its bounds stops the calibration
    [rad]."""
    flip_rms_ratio: Real = 2.0
    """The second pose of a flat tag is taken up to this RMS over that of the first."""
    flip_trust_rad: Real = 0.5
    """And up to this angle to the prediction [rad]."""
    frame_shared: Real = 0.25
    """Share of the error variance that the frames of one measurement have in common."""
    search_safety: Real = 2.0
    """Factor of the last residual up to which the next pose may be off."""
    poses_min: Natural = 3
    """Fewest poses besides the local initial poses."""
    tags_tried_min: Natural = 6
    """Local initial poses after which a tag must have been detected."""
    second_start_noise_scale: Real = 2.0
    """A fit with a larger noise scale gets a second start."""
    mismatch_noise_scale: Real = 3.5
    """Noise scale of the local initial poses above which the arm is another one."""
    mismatch_dof_min: Natural = 12
    """Degrees of freedom that this takes."""
    mismatch_outliers_min: Natural = 3
    """Outliers among the local initial poses that are no bad detections any more."""
    poor_noise_scale: Real = 3.0
    """Noise scale above which the fit is poor."""
    poor_noise_scale_unlikely: Real = 2.0
    """Noise scale above which a fit less likely than poor_p_fit is poor."""
    poor_p_fit: Real = 1e-9
    """p-value of the fit below which it is unlikely."""
    store_retries: int = 2
    """Times that storing is tried again."""
    store_retry_us: Microseconds = 1_000_000
    """Time from a failure of the store to the next try."""
    approval_timeout_us: Microseconds = 600_000_000
    """Time in which APPROVE_GO must follow APPROVE_ARM."""
    signed_age_max_us: Microseconds = 43_200_000_000
    """Largest difference between the stamp of a signed message and flight's clock; 0: not checked."""
    initial_design: Literal["table", "information"] = "information"
    """Initial poses: table, all, in the order of SPACE; information, as many as are needed."""
    local_safe_m: Real = 0.02
    """Sigma of the tool's position up to which a local initial pose may be chosen [m]."""
    leave_safe_m: Real = 0.06
    """Sigma of the tool's position at a pose up to which the arm may leave the park pose for it [m]."""
    doubt_p: Real = 0.01
    """p-value of the first observations below which all local initial poses are measured."""
    outside_factor: Real = 2.0
    """An arm outside its bounds: one with errors this many times as large."""
    power_min: Real = 0.95
    """Probability with which it has to cast doubt before the arm leaves the park pose."""
    rate_measure: Literal["dopt", "vopt"] = "dopt"
    """What rate takes as information."""
    rate_cost: Literal["time", "energy"] = "time"
    """What rate takes as cost: seconds or joules."""
    frame_s: Real = 0.8
    """Time from the request of a frame to its detection [s]."""
    stop_confidence: Real = 0.9
    """Probability with which the error shall be within stop_pos_m and stop_rot_rad; 0: their RMS."""
    stop_checks: int = 2
    """Poses in a row that have to be as predicted, before they are used."""
    extra_obs_max: Natural = 4
    """Observations on the way to each candidate, on arrival and after servo steps; 0: none."""
    extra_pos_m: Real = 0.02
    """Least distance of the tool from the candidate and from the one before for one of them [m] ..."""
    extra_rot_rad: Real = 0.05
    """... or least angle [rad]: one of the two is enough."""
    stops_max: Natural = 2
    """Stops on the way to each candidate, of those that the SPACE table has; 0: none."""
    rest_part: Real = 0.01
    """START from the monitor's suspects: sigma of what is not suspected, part of its scale."""
    no_change_power: Real = 0.99
    """With a required accuracy: a right table ends the calibration once an error that large would show with
    this probability; 0: never."""
    go_by_other_key: Switch = 0
    """1: the second step of an approval has to be signed by another holder than the first."""
    servo: ServoBlock
    """Servo."""
    est: EstimatorBlock
    """Estimator."""


SOURCES: dict[str, type[Source]] = {
    "arm": ArmSource,
    "camera": CameraSource,
    "terms": TermsSource,
    "kernel": KernelSource,
    "kin": KinSource,
    "config": ConfigSource,
}
