"""The model file M.toml: effects in use, with every change kept as history (docs/WORKBENCH.md)."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import pydantic

from .base import Strict
from .effects import ParameterEntry
from .errors import Contradiction
from .names import effect_of, is_unnamed, split_constants
from .numbers import NotNegative, Real, Vec3

VERSION = 1
_SAME_CONSTANT = 1e-9  # of a constant, as files round it
Name = Annotated[str, pydantic.Field(min_length=1)]


class ChangeEntry(Strict):
    """One entry of the history, written by the tool."""

    when: str
    """Time in UTC, ISO 8601."""
    action: Literal["add", "remove", "undo"]
    """What was done."""
    effects: list[Name]
    """Effects that it was done to."""
    before: list[Name]
    """Effects in use before, as `effects` of the model has them."""


class ValueEntry(Strict):
    """A coefficient of the last fit, written by the tool."""

    name: Name
    """Coefficient."""
    value: Real
    """Estimate, in the coefficient's unit."""
    std_err: NotNegative
    """Standard error, in the coefficient's unit."""
    unit: str = ""
    """Unit of both."""


class FrameEntry(Strict):
    """A frame that the last fit worked with."""

    xyz_m: Vec3
    """Origin [m]."""
    quat_wxyz: tuple[Real, Real, Real, Real]
    """Orientation, unit quaternion, scalar part first."""


class ExpectedEntry(Strict):
    """The error that the last fit says of poses that it was not fitted to."""

    held_out: Literal["held-out poses", "poses in turns"]
    """How these poses were held out; in turns where few are held out at once."""
    poses: Annotated[int, pydantic.Field(ge=1)]
    """Number of these poses."""
    outliers: Annotated[int, pydantic.Field(ge=0)] = 0
    """Number of outliers among them."""
    distinct: Annotated[int, pydantic.Field(ge=1)]
    """Number of the others, replicates of one pose counted once."""
    mm: NotNegative
    """RMS position error [mm]."""
    mrad: NotNegative | None = None
    """RMS rotation error [mrad]."""
    usual_mm: NotNegative
    """RMS position error without the outliers [mm]."""
    usual_mrad: NotNegative | None = None
    """RMS rotation error without the outliers [mrad]."""


class DataEntry(Strict):
    """A file of measurements that the model was fitted to."""

    path: str
    """Where it was."""
    sha256: str
    """SHA-256 of its content."""


class SightEntry(Strict):
    """Camera and target of the last fit, for effects that act through all points of the target."""

    on_tool: bool
    """true: the camera is on the tool, and the measured pose is its own; false: the target is on the tool."""
    points_m: list[Vec3]
    """Points of the target in its frame [m]."""
    second_m: list[Vec3] | None = None
    """Those of poses with tag = 1, if these are others."""
    low: tuple[Real, Real]
    """Left and upper border of the image, normalised."""
    high: tuple[Real, Real]
    """Right and lower border."""
    focal: tuple[Real, Real]
    """What a unit of normalised image position weighs along u and v [px], or 1."""


class FitEntry(Strict):
    """The last fit: what it was made from, and what an export needs beside the coefficients. Written by the
    tool."""

    when: str
    """Time in UTC, ISO 8601."""
    tool_version: str
    """Version of kincal."""
    arm_sha256: str
    """SHA-256 of the numbers of the arm table, whatever its layout."""
    data: list[DataEntry] = []
    """Measurements."""
    poses: Annotated[int, pydantic.Field(ge=0)]
    """Number of poses."""
    components: Literal[3, 6]
    """Measured components of a pose: 3 of the position, 6 with the orientation."""
    held: list[str] = []
    """Names of the poses that were held out to test the model."""
    held_mm: NotNegative | None = None
    """RMS position error on the held-out poses of a fit to the others [mm]."""
    held_mrad: NotNegative | None = None
    """RMS rotation error on the held-out poses [mrad]."""
    held_table_mm: NotNegative | None = None
    """RMS position error on the held-out poses of what a DH table holds of a fit to the others, where that is
    less than all of it [mm]."""
    exported_table_mm: NotNegative | None = None
    """RMS position error on the same poses of the table that is exported, fitted to all poses [mm]."""
    expected: ExpectedEntry | None = None
    """The error that `fit` begins with: what other poses of this kind are compared with."""
    end_s: Real | None = None
    """Time of the last pose, fitted or not [s]: where effects of time stand in other sessions."""
    noise_scale: NotNegative
    """Fitted over stated noise."""
    base: FrameEntry
    """Measurement frame -> frame 0, before the corrections base.* among the coefficients."""
    tool: FrameEntry
    """Last link -> measured frame, before the corrections tool.*."""
    sight: SightEntry | None = None
    """Camera and target, stated or assumed; null unless an effect acts through all points of the target."""
    position_change_mm: dict[str, NotNegative] = {}
    """Effect, or "DH beta" -> RMS change of the position over the poses that it makes [mm]."""
    covariance: list[list[Real]] = []
    """Covariance of the coefficients, lower triangle row by row, in their units and order."""


class FormerEntry(Strict):
    """A fit that a change of the effects discarded: `undo` back to these effects brings it back. Written by
    the tool."""

    effects: list[Name]
    """Effects that were fitted, as `effects` of the model had them."""
    arm: str = ""
    """Arm table."""
    value: list[ValueEntry] = []
    """Coefficients."""
    constants: dict[str, dict[str, Real]] = {}
    """Constants, by effect and name."""
    fit: FitEntry
    """What it was made from."""


class UnnamedEntry(Strict):
    """Terms of an effect that the library has no name for, written by `kincal model add "unnamed[...]"`."""

    name: Name
    """Place and driver variables: unnamed[joint 1: q1, q3]."""
    parameter: list[ParameterEntry]
    """Coefficients with their terms. Each sigma was chosen by the data; a fit keeps to it."""


class ModelEntry(Strict):
    """A model: the arm's DH errors, base and tool frame as the arm table says, and these effects."""

    version: Literal[1] = 1
    """Layout of this file."""
    dh: pydantic.StrictBool = True
    """true: the DH errors of every joint are estimated."""
    effects: list[Name] = []
    """Effects in use, in the order they were added: "joint_compliance[2]", "base_flex" ... Constants that a
    fit keeps stand behind the name: "bias_step[2](t0=120)"; others are chosen by the data."""
    libraries: list[Name] = []
    """Files with effects of one's own."""
    arm: str = ""
    """Arm table that the model was fitted with, or begun with (`add --arm`)."""
    history: list[ChangeEntry] = []
    """Every change, oldest first."""
    unnamed: list[UnnamedEntry] = []
    """Terms of the unnamed effects, in use or in the history."""
    value: list[ValueEntry] = []
    """Coefficients of the last fit."""
    constants: dict[str, dict[str, Real]] = {}
    """Constants of the last fit, by effect and name."""
    fit: FitEntry | None = None
    """The last fit; null before the first, and after a change of the effects."""
    former: FormerEntry | None = None
    """The last fit of other effects that a change discarded."""

    @property
    def names(self) -> list[str]:
        """Effects in use, without constants."""
        return [split_constants(text)[0] for text in self.effects]

    @pydantic.field_validator("effects")
    @classmethod
    def _each_once(cls, effects: list[str]) -> list[str]:
        names = [split_constants(text)[0] for text in effects]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"names {twice[0]} twice")
        return effects

    @pydantic.model_validator(mode="after")
    def _values_stand_once(self) -> ModelEntry:
        names = [entry.name for entry in self.value]
        for number, name in enumerate(names, 1):
            if name in names[: number - 1]:
                raise Contradiction(
                    f"value[{number}].name", f"is {name}, which stands above already", "take one of them out"
                )
        return self

    @pydantic.model_validator(mode="after")
    def _constants_agree(self) -> ModelEntry:
        stated = dict(map(split_constants, self.effects))
        for effect, found in self.constants.items():
            kept = stated.get(effect) or stated.get(effect_of(effect), {})
            for key in kept.keys() & found.keys():
                if not math.isclose(kept[key], found[key], rel_tol=_SAME_CONSTANT):
                    raise Contradiction(
                        f'constants."{effect}".{key}',
                        f"is {found[key]:.9g}, but effects says {key}={kept[key]:.9g}",
                        "take the table out, and run `kincal model fit` again",
                    )
        return self

    @pydantic.model_validator(mode="after")
    def _unnamed_have_terms(self) -> ModelEntry:
        there = {entry.name for entry in self.unnamed}
        for name in self.names:
            if is_unnamed(name) and name not in there:
                raise Contradiction(
                    "effects", f"holds {name}, but no [[unnamed]] has its terms", "add it again with --data"
                )
        return self

    @pydantic.model_validator(mode="after")
    def _whole_or_single(self) -> ModelEntry:
        for name in self.names:
            whole = effect_of(name)
            if whole != name and whole in self.names:
                raise Contradiction(
                    "effects",
                    f"holds {whole}, which is the effect at all joints, beside {name}",
                    f"remove {name}",
                )
        return self
