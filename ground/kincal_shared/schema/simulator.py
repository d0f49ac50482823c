"""The simulator's own numbers (sim/models/*.toml): the true arm and lander, and the camera's optics.

They are kept apart from the flight tables on purpose, so that an error in one of them shows.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import pydantic

from .base import Strict
from .errors import Contradiction
from .numbers import Angle, Count, NotNegative, Positive, Real, Vec3

Range = tuple[Real, Real]


class Settings(Strict):
    """Keys that may each be left out."""

    def changes(self) -> dict[str, Any]:
        """The keys that are given, as a dict."""
        return self.model_dump(exclude_none=True)


def _all_given(settings: Settings) -> None:
    for key in type(settings).model_fields:
        if getattr(settings, key) is None:
            raise Contradiction(key, "is missing", f"write {key} = ...")


class OpticsSettings(Settings):
    """Lens, sensor and printed tags of the rendered camera."""

    psf_sigma_px: NotNegative | None = None
    """1-sigma of lens and pixel blur [px]."""
    read_noise_dn: NotNegative | None = None
    """Read noise of a pixel, in 8-bit steps."""
    electrons_per_dn: Positive | None = None
    """Shot noise: the variance grows by DN / electrons_per_dn."""
    tag_black: NotNegative | None = None
    """Reflectance of a tag's black."""
    tag_white: NotNegative | None = None
    """Reflectance of a tag's white."""
    near_m: Positive | None = None
    """Nothing nearer is drawn or hides anything [m]."""
    far_m: Positive | None = None
    """Nothing farther is drawn [m]."""


class Optics(OpticsSettings):
    """OpticsSettings, every key given."""

    @pydantic.model_validator(mode="after")
    def _complete(self) -> Optics:
        _all_given(self)
        return self


class DetectionSettings(Settings):
    """Detections without pixels."""

    noise: Literal["corners", "isotropic"] | None = None
    """corners: noise on the corners, then the pose that fits them; isotropic: one sigma per axis."""
    corner_sigma_px: NotNegative | None = None
    """Noise of one corner coordinate [px]."""
    frame_shared: Annotated[float, pydantic.Field(ge=0.0, le=1.0)] | None = None
    """Share of its variance that every frame of a resting scene repeats."""
    corner_sigma_weight: NotNegative | None = None
    """For how many residuals corner_sigma_px counts in the reported covariance."""
    max_incidence_deg: NotNegative | None = None
    """A tag is detected up to this incidence [deg]."""
    min_edge_px: NotNegative | None = None
    """A tag is detected from this edge length on [px]."""
    margin_px: NotNegative | None = None
    """Distance of a tag from the rim of the image [px]."""
    isotropic_position_m: NotNegative | None = None
    """With noise = "isotropic": 1-sigma of each axis of position [m]."""
    isotropic_rotation_deg: NotNegative | None = None
    """With noise = "isotropic": 1-sigma of each axis of rotation [deg]."""


class Detection(DetectionSettings):
    """DetectionSettings, every key given."""

    @pydantic.model_validator(mode="after")
    def _complete(self) -> Detection:
        _all_given(self)
        return self


class Jpeg(Strict):
    """The frame as it is sent."""

    max_jpeg_bytes: Annotated[int, Count(ge=1)]
    """A frame is sent below this size, at a lower quality if need be [bytes]."""
    jpeg_quality: Annotated[int, Count(ge=1, le=100)]
    """Quality that is tried first."""
    jpeg_quality_min: Annotated[int, Count(ge=1, le=100)]
    """Lowest quality."""
    jpeg_quality_step: Annotated[int, Count(ge=1, le=100)]
    """Step between qualities."""


class OpticsFile(Strict):
    """models/camera.toml: lens, sensor, printed tags and picture format."""

    image: Jpeg
    """Picture format."""
    optics: Optics
    """The rendered camera."""
    detection: Detection
    """Detections without pixels."""


# --------------------------------------------------------------------------- the true arm and lander


class Place(Strict):
    """A fixed frame, turned like the one before it."""

    xyz_m: Vec3
    """Origin [m]."""


class Motion(Strict):
    """How the arm moves and settles."""

    park_rad: list[Angle]
    """Park pose, by the encoders [rad]."""
    settle_s: NotNegative
    """The arm vibrates this long after a move [s]."""
    settle_hz: NotNegative
    """Frequency of the vibration [Hz]."""
    settle_gain_s: NotNegative
    """First amplitude [rad] per joint speed before braking [rad/s]."""


class Capsule(Strict):
    """A solid of a link, in its joint frame (z is the axis, before a and alpha)."""

    type: Literal["capsule"]
    """Shape."""
    from_: Vec3 = pydantic.Field(alias="from")
    """One end of the axis [m]."""
    to: Vec3
    """The other end [m]."""
    radius: Positive
    """Radius [m]."""


class PlantJoint(Strict):
    """One joint and its link, standard DH."""

    a_m: Real
    """DH length a [m]."""
    alpha_rad: Angle
    """DH twist alpha [rad]."""
    d_m: Real
    """DH offset d [m]."""
    phi_rad: Angle = 0.0
    """Offset of the joint angle at reading 0 [rad]."""
    q_rad: Range
    """Limits [rad]."""
    speed_rad_s: Positive
    """Largest speed [rad/s]."""
    accel_rad_s2: Positive
    """Largest acceleration [rad/s^2]."""
    mass_kg: NotNegative
    """Mass of the link [kg]."""
    com_m: Vec3
    """Centre of mass in the link frame [m]."""
    shapes: list[Capsule]
    """Solids of the link."""


class PlantTag(Strict):
    """One tag on the tool."""

    id: Annotated[int, Count(ge=0)]
    """Member of the family 36h11."""
    size_m: Positive
    """Edge of the black square [m]."""
    xyz_m: Vec3
    """Centre in the tool frame [m]."""
    rot_y_rad: Angle
    """Turn about y of the tool frame [rad]."""


class PanTilt(Strict):
    """Pan-tilt unit on its mast."""

    mast_xyz_m: Vec3
    """Unit in the base frame [m]."""
    camera_xyz_m: Vec3
    """Camera in the tilt frame, looking along its x [m]."""
    pan_rad: Range
    """Limits of pan [rad]."""
    tilt_rad: Range
    """Limits of tilt, positive looks down [rad]."""
    speed_rad_s: Positive
    """Speed [rad/s]."""
    start_rad: Range
    """Pan and tilt at power-up [rad]."""


class Pinhole(Strict):
    """Camera after rectification."""

    width_px: Annotated[int, Count(ge=1)]
    """Width of the image [px]."""
    height_px: Annotated[int, Count(ge=1)]
    """Height of the image [px]."""
    fx_px: Positive
    """Focal length along u [px]."""
    fy_px: Positive
    """Focal length along v [px]."""
    cx_px: Real
    """Principal point, u [px]."""
    cy_px: Real
    """Principal point, v [px]."""


class Lander(Strict):
    """Deck and ground."""

    deck_xyz_m: Vec3
    """Centre of the deck [m]."""
    deck_half_m: Vec3
    """Half sizes of the deck [m]."""
    ice_z_m: Real
    """Height of the ice [m]."""


class Region(Strict):
    """Box of tool positions in the base frame."""

    min_m: Vec3
    """Lower corner [m]."""
    max_m: Vec3
    """Upper corner [m]."""


class PlantFile(Strict):
    """models/wam.toml: the true arm, lander, mast and camera."""

    name: str
    """Name of the arm."""
    base: Place
    """Frame 0 in the base frame."""
    tool: Place
    """Tool frame in the last link frame."""
    motion: Motion
    """How the arm moves."""
    joint: list[PlantJoint] = pydantic.Field(min_length=1)
    """Joints from the base to the tool."""
    tag: list[PlantTag]
    """Tags on the tool."""
    pantilt: PanTilt
    """Pan-tilt unit."""
    camera: Pinhole
    """Camera."""
    lander: Lander
    """Lander."""
    region: Region
    """Where held-out poses are sampled."""

    @pydantic.model_validator(mode="after")
    def _one_park_angle_a_joint(self) -> PlantFile:
        if len(self.motion.park_rad) != len(self.joint):
            raise Contradiction(
                "motion.park_rad",
                f"has {len(self.motion.park_rad)} entries, the arm has {len(self.joint)} joints",
            )
        return self
