"""The corrected DH table: what is constant in a fitted model, as DH parameters and two frames.

With E = Tx Rx Ty Ry Rz Tz after each link, rz and tz at frame j-1 add to phi and d of joint j, tx and rx at
frame j to its a and alpha. ry there is beta, a turn about y that ends the link where the next axis is
parallel: Rz(phi + q) Tz(d) Tx(a) Rx(alpha) Ry(beta) (METHOD.md 9). The rest at the two ends goes into base
and tool frame. All of this is exact.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from kincal.flight import FRAME_TOOL
from kincal.rotations import Floats, Pose
from kincal.workbench.model.parameters import BETA, given_no_beta
from kincal_shared.schema.dh import BETA_ERROR, DH_ERRORS, DH_FIELDS

from .calibrated import BASE, DH, TOOL, CalibratedArm, FittedTerm, twist_pose
from .leftout import LeftOut, left_out

TX, TY, TZ, RX, RY, RZ = range(6)
TURNED = (*DH_FIELDS, BETA_ERROR.name)

State = Literal["identifiable", "not identifiable", "not estimated"]


@dataclass(frozen=True)
class DhParameter:
    """One number of the table: nominal + correction = corrected, sigma its standard error, in `unit`."""

    joint: int
    name: str
    unit: str
    nominal: float
    correction: float
    sigma: float
    state: State

    @property
    def corrected(self) -> float:
        """The number to use."""
        return self.nominal + self.correction


@dataclass(frozen=True)
class FoundFrame:
    """A fixed frame as the fit found it; sigma (6,): of its shift and turn [m, rad], None if it was given."""

    name: str
    pose: Pose
    sigma: Floats | None


@dataclass(frozen=True)
class DhTable:
    """The part of a model that is a DH table.

    parameters: phi, alpha, a, d of joint 1 (and beta where a model has one), then of joint 2 ...; base:
    measurement frame to frame 0; tool: last link to measured frame; left_out: effects of the model that are
    not in it.
    """

    parameters: tuple[DhParameter, ...]
    base: FoundFrame
    tool: FoundFrame
    left_out: tuple[LeftOut, ...]

    def of_joint(self, joint: int) -> dict[str, float]:
        """Corrected phi_rad, alpha_rad, a_m, d_m of a joint, from 1, and beta_rad where there is one."""
        return {p.name: p.corrected for p in self.parameters if p.joint == joint}


def dh_table(arm: CalibratedArm) -> DhTable:
    """The corrected DH table of a fitted arm, with beta."""
    return _table(arm, TURNED)


def four_parameter_table(arm: CalibratedArm) -> DhTable:
    """The corrected DH table of a fitted arm as an arm table holds it: without beta, the other parameters as
    a fit without beta would have them."""
    table = _table(_given_no_beta(arm), DH_FIELDS)
    dropped = left_out(arm, [term for term in arm.terms if term.coefficient.group == BETA])
    return replace(table, left_out=(*dropped, *table.left_out))


def _table(arm: CalibratedArm, columns: tuple[str, ...]) -> DhTable:
    n = arm.n
    found = [p for joint in range(1, n + 1) for p in _parameters(arm, joint)]
    return DhTable(
        parameters=tuple(p for p in found if p.name in columns),
        base=FoundFrame("base", arm.base @ twist_pose(_base_twist(arm)), _frame_sigma(arm, BASE)),
        tool=FoundFrame("tool", _tool(arm), _frame_sigma(arm, TOOL)),
        left_out=left_out(arm, [term for term in arm.terms if not _fits(term, n, columns)]),
    )


def _given_no_beta(arm: CalibratedArm) -> CalibratedArm:
    """The arm with the most probable coefficients if every beta were zero."""
    names, value = [c.name for c in arm.coefficients], np.array([c.value for c in arm.coefficients])
    kept = given_no_beta(names, value, arm.covariance)
    rows = zip(arm.coefficients, kept, strict=True)
    return replace(arm, coefficients=tuple(replace(c, value=float(x)) for c, x in rows))


def _fits(term: FittedTerm, n: int, columns: tuple[str, ...]) -> bool:
    inner = 0 < term.frame < n
    no_place = (TY,) if columns == TURNED else (TY, RY)
    return term.constant and not term.on_sensor and not (inner and term.comp in no_place)


# ------------------------------------------------------------------------------------ parameters


def _parameters(arm: CalibratedArm, joint: int) -> list[DhParameter]:
    row = arm.arm.joints[joint - 1]
    tilted = joint < arm.n and any(map(_at(joint, RY), _all_terms(arm)))
    return [
        _parameter(arm, joint, e.name, e.unit, getattr(row, e.name, 0.0), _at(e.frame(joint), e.component))
        for e in (*DH_ERRORS, BETA_ERROR)
        if e is not BETA_ERROR or tilted
    ]


def _at(frame: int, comp: int) -> Callable[[FittedTerm], bool]:
    """Whether a constant correction belongs to the DH parameter at this place."""
    return lambda term: term.constant and (term.frame, term.comp) == (frame, comp) and not _of_base(term)


def _of_base(term: FittedTerm) -> bool:
    """Whether a correction at frame 0 belongs to the base frame: all but those of joint 1 itself."""
    of_joint = term.coefficient.group == DH or "[" in term.coefficient.group
    return term.frame == 0 and not (of_joint and term.comp in (RZ, TZ))


def _parameter(
    arm: CalibratedArm,
    joint: int,
    name: str,
    unit: str,
    nominal: float,
    belongs: Callable[[FittedTerm], bool],
) -> DhParameter:
    terms = [term for term in _all_terms(arm) if belongs(term)]
    weights = np.zeros(len(arm.coefficients))
    for term in terms:
        weights[arm.coefficients.index(term.coefficient)] = _gain(term)
    variance = float(weights @ arm.covariance @ weights)
    prior = float((weights**2 * [c.prior_sigma**2 for c in arm.coefficients]).sum())
    state: State = "not estimated"
    if terms:
        state = "identifiable" if variance < 0.5 * prior else "not identifiable"
    correction = sum(term.factor for term in terms)
    return DhParameter(joint, name, unit, nominal, correction, float(np.sqrt(variance)), state)


def _all_terms(arm: CalibratedArm) -> list[FittedTerm]:
    """Corrections, also those whose coefficient came out as zero."""
    return [
        FittedTerm(c, t.frame, t.comp, c.value * t.gain, tuple(b for b in t.basis if b.var != "1"))
        for c in arm.coefficients
        for t in c.terms
    ]


def _gain(term: FittedTerm) -> float:
    """Correction by unit of its coefficient."""
    own = [t for t in term.coefficient.terms if (t.frame, t.comp) == (term.frame, term.comp)]
    return sum(t.gain for t in own if all(b.var == "1" for b in t.basis))


# ---------------------------------------------------------------------------------------- frames


def _base_twist(arm: CalibratedArm) -> Floats:
    """(6,) corrections at frame 0 that are not those of joint 1."""
    out = np.zeros(6)
    for term in arm.terms:
        if term.constant and _of_base(term):
            out[term.comp] += term.factor
    return out


def _tool(arm: CalibratedArm) -> Pose:
    """The tool frame, with what comes after the last link's a and alpha."""
    last = arm.constant_twist(arm.n)
    last[[TX, RX]] = 0.0
    return twist_pose(last) @ arm.tool @ twist_pose(arm.constant_twist(FRAME_TOOL))


def _frame_sigma(arm: CalibratedArm, group: str) -> Floats | None:
    sigma = [c.std_err for c in arm.coefficients if c.group == group]
    return np.array(sigma) if sigma else None
