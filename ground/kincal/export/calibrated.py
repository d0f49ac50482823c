"""A fitted arm as plain numbers, rebuilt from the arm table and M.toml alone: no measurements are needed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from kincal.flight import FRAME_CAMERA, FRAME_MEAS, FRAME_TOOL
from kincal.rotations import Floats, Pose
from kincal.workbench.comparison.fitrecord import arm_digest
from kincal.workbench.evidence.constants import choose_constants
from kincal.workbench.fit.least_squares import EFFECT_WIDTH, Fit
from kincal.workbench.model.effects import Library, Parameter, Term
from kincal.workbench.model.modelfile import ModelFile, covariance_of
from kincal.workbench.model.parameters import (
    BETA,
    dh_parameters,
    effect_parameters,
    frame_parameters,
    is_beta,
)
from kincal_shared.errors import BadInput
from kincal_shared.schema.arm import ArmTable
from kincal_shared.schema.model import FitEntry, FrameEntry
from kincal_shared.schema.names import COMPONENTS
from kincal_shared.schema.terms import Basis

_MOST_SIGMAS = 20.0  # of its prior: 2 m and 4 rad for a DH error, 200 typical sizes of an effect
_SAME_VARIANCE = 1e-6  # as the file rounds it

DH, BASE, TOOL = "DH", "base", "tool"
"""Groups of coefficients that are no effect of the library."""


@dataclass(frozen=True)
class Coefficient:
    """A fitted coefficient.

    group: DH, DH beta, base, tool, or the effect it belongs to; value, std_err in `unit`; prior_sigma: the
    same for its prior; terms: what it scales.
    """

    name: str
    group: str
    unit: str
    value: float
    std_err: float
    prior_sigma: float
    terms: tuple[Term, ...]

    @property
    def identifiable(self) -> bool:
        """Whether the data say more about it than the prior does: its variance fell to less than half."""
        return self.std_err**2 < 0.5 * self.prior_sigma**2


@dataclass(frozen=True)
class FittedTerm:
    """One correction: `factor` (coefficient times gain) x basis x basis, added to component `comp` (0..5: tx
    ty tz rx ry rz) of the twist at `frame` (0..n, then FRAME_TOOL, FRAME_CAMERA, FRAME_MEAS)."""

    coefficient: Coefficient
    frame: int
    comp: int
    factor: float
    bases: tuple[Basis, ...]

    @property
    def constant(self) -> bool:
        """Whether it is the same in every pose."""
        return not self.bases

    @property
    def on_sensor(self) -> bool:
        """Whether it corrects what the sensor says, not where the tool is."""
        return self.frame in (FRAME_CAMERA, FRAME_MEAS)


@dataclass(frozen=True)
class CalibratedArm:
    """A fitted arm.

    T(q) = base E_0 L_1(q_1) E_1 ... L_n(q_n) E_n tool E_tool, with L = Rz(phi + q) Tz(d) Tx(a) Rx(alpha)
    and E = Tx Rx Ty Ry Rz Tz of the twist that the terms add up to at that frame (METHOD.md 9).

    arm: nominal table; base, tool: frames before their corrections; coefficients: (k,) in the order of the
    fit; covariance: (k, k), in their units; record: the fit they come from; file: the model file that it
    was read from, empty for a fit in memory.
    """

    arm: ArmTable
    base: Pose
    tool: Pose
    coefficients: tuple[Coefficient, ...]
    covariance: Floats
    record: FitEntry
    file: str = ""

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.arm.n

    @property
    def terms(self) -> tuple[FittedTerm, ...]:
        """All corrections that are not zero."""
        found = [_fitted(c, term) for c in self.coefficients for term in c.terms]
        return tuple(term for term in found if term.factor != 0.0)

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects in the model."""
        plain = (DH, BETA, BASE, TOOL)
        return tuple(dict.fromkeys(c.group for c in self.coefficients if c.group not in plain))

    @property
    def of_session(self) -> tuple[str, ...]:
        """Effects that follow time: they hold for the session that was fitted only."""
        found = {t.coefficient.group for t in self.terms if any(b.var == "t" for b in t.bases)}
        return tuple(sorted(found))

    def constant_twist(self, frame: int, groups: Iterable[str] | None = None) -> Floats:
        """(6,) sum of the constant corrections at a frame [m, rad]; groups: of these coefficients only."""
        chosen = None if groups is None else set(groups)
        out = np.zeros(6)
        for term in self.terms:
            if term.frame == frame and term.constant and (chosen is None or term.coefficient.group in chosen):
                out[term.comp] += term.factor
        return out

    def found_frames(self) -> tuple[Pose, Pose]:
        """Base and tool frame with their own corrections: where the fit found them."""
        base = self.base @ twist_pose(self.constant_twist(0, [BASE]))
        return base, self.tool @ twist_pose(self.constant_twist(FRAME_TOOL, [TOOL]))

    @property
    def sources(self) -> str:
        """Data, date and tool in one line."""
        data = ", ".join(entry.path for entry in self.record.data) or "measurements in memory"
        return f"{self.record.poses} poses of {data}, {self.record.when}, kincal {self.record.tool_version}"


def _fitted(coefficient: Coefficient, term: Term) -> FittedTerm:
    bases = tuple(basis for basis in term.basis if basis.var != "1")
    return FittedTerm(coefficient, term.frame, term.comp, coefficient.value * term.gain, bases)


def twist_pose(twist: Floats) -> Pose:
    """E = Tx Rx Ty Ry Rz Tz of a twist (6,): a screw about x, then y, then z."""
    out = Pose.identity()
    for axis in range(3):
        out = out @ screw(axis, float(twist[axis]), float(twist[3 + axis]))
    return out


def screw(axis: int, shift_m: float, angle_rad: float) -> Pose:
    """Shift along an axis (0 x, 1 y, 2 z) and turn about it."""
    u, v = (axis + 1) % 3, (axis + 2) % 3
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    turn, shift = np.eye(3), np.zeros(3)
    turn[u, u] = turn[v, v] = c
    turn[v, u], turn[u, v] = s, -s
    shift[axis] = shift_m
    return Pose(shift, turn)


def frame_name(frame: int) -> str:
    """A frame in words: base, link 3, tool, sensor, target."""
    special = {0: "base", FRAME_TOOL: "tool", FRAME_CAMERA: "sensor", FRAME_MEAS: "target"}
    return special.get(frame, f"link {frame}")


def term_text(term: FittedTerm) -> str:
    """What a correction depends on, in the grammar of terms; "1" if it is constant."""
    return " * ".join(map(str, term.bases)) or "1"


def component_name(comp: int) -> str:
    """tx, ty, tz, rx, ry or rz."""
    return COMPONENTS[comp]


# ----------------------------------------------------------------------- from a fit, from the files


def calibrated_fit(fit: Fit, record: FitEntry) -> CalibratedArm:
    """The fitted arm of a fit, with its record."""
    of_effect = {f"{h.name}.{p.name}": h.name for h in fit.hypotheses for p in h.parameters}
    rows = zip(fit.names, fit.parameters, fit.estimate, fit.std_err, strict=True)
    return CalibratedArm(
        arm=fit.arm,
        base=fit.base,
        tool=fit.tool,
        coefficients=tuple(
            _coefficient(name, of_effect.get(name, ""), parameter, (float(value), float(std_err)))
            for name, parameter, value, std_err in rows
        ),
        covariance=fit.cov,
        record=record,
    )


def calibrated_arm(
    arm: ArmTable, model: ModelFile, library: Library, *, name: str = "M.toml"
) -> CalibratedArm:
    """The fitted arm of a model file; name: what messages call that file. BadInput if it holds no fit, or one
    of another arm table."""
    record = _record(model, arm, name)
    named = _named(arm, model, library, name)
    if [n for n, *_ in named] != list(model.values):
        raise _stale(name, "its values are those of other effects, or of another version of their library")
    covariance = covariance_of(model)
    if covariance is None:
        raise _stale(name, f"its covariance does not have the {len(named)} rows of the coefficients")
    _refuse_impossible(named, model, covariance, name)
    return CalibratedArm(
        arm=arm,
        base=_pose(record.base),
        tool=_pose(record.tool),
        coefficients=tuple(_coefficient(n, effect, p, model.values[n]) for n, effect, p in named),
        covariance=covariance,
        record=record,
        file=name,
    )


def _record(model: ModelFile, arm: ArmTable, name: str) -> FitEntry:
    if model.fit is None or not model.values:
        raise BadInput("the model holds no fitted values", name, "run `kincal model fit` first")
    if model.fit.arm_sha256 != arm_digest(arm):
        raise BadInput(
            f"the model was fitted with another arm table ({model.arm or 'unknown'}) than {arm.source}",
            name,
            "name that arm table, or run `kincal model fit` with this one",
        )
    return model.fit


def _stale(name: str, why: str) -> BadInput:
    return BadInput(f"the fit in the model is not usable: {why}", name, "run `kincal model fit` again")


def _refuse_impossible(
    named: Sequence[tuple[str, str, Parameter]], model: ModelFile, covariance: Floats, file: str
) -> None:
    """BadInput for what no fit writes: a value far beyond its prior, another unit, a standard error that is
    not that of the covariance. All come from editing the file."""
    for k, (name, effect, parameter) in enumerate(named):
        (value, std_err), unit, variance = model.values[name], model.units.get(name, ""), covariance[k, k]
        most = _MOST_SIGMAS * parameter.sigma
        most = max(most, math.pi) if parameter.unit == "rad" and not effect else most
        where = f"value[{k + 1}], {name},"
        if abs(value) > most:
            raise _stale(file, f"{where} is {value:.6g} {parameter.unit}, up to {most:.3g} can be fitted")
        if unit and unit != parameter.unit:
            raise _stale(file, f"{where} is in {unit}, it is fitted in {parameter.unit}")
        if not math.isclose(std_err**2, variance, rel_tol=_SAME_VARIANCE, abs_tol=1e-300):
            of_covariance = math.sqrt(max(variance, 0.0))
            raise _stale(file, f"{where} has std_err {std_err:.6g}, its covariance {of_covariance:.6g}")


def _named(arm: ArmTable, model: ModelFile, library: Library, name: str) -> list[tuple[str, str, Parameter]]:
    """Coefficients in the order of the fit, each with the effect it belongs to, if any."""
    try:
        effects = choose_constants(library, model.effects, arm, None, dh=model.dh, known=model.constants)
    except BadInput as error:
        raise BadInput(error.what, error.where or name, error.todo) from None
    plain = [*frame_parameters(arm), *(dh_parameters(arm) if model.dh else [])]
    of_effects = [(n, h.name, p) for h in effects for n, p in effect_parameters([h], EFFECT_WIDTH)]
    return [(n, "", p) for n, p in plain] + of_effects


def _coefficient(name: str, effect: str, parameter: Parameter, value: tuple[float, float]) -> Coefficient:
    """effect: empty for the DH errors and the frames, whose names say what they are: J3.a_m, base.tx_m."""
    first = name.partition(".")[0]
    group = effect or (first if first in (BASE, TOOL) else BETA if is_beta(name) else DH)
    return Coefficient(name, group, parameter.unit, value[0], value[1], parameter.sigma, parameter.terms)


def _pose(frame: FrameEntry) -> Pose:
    return Pose.of_wxyz(frame.xyz_m, frame.quat_wxyz)
