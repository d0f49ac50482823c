"""A smooth function that the library has no name for, as ordinary terms: unnamed[joint 1: q1, q3].

At a place the error is a sum of simple shapes of one or two drivers (cosines over the measured range,
Fourier terms of the angle, polynomials with tanh). The family of shapes and their size are those with the
most evidence (empirical Bayes); of the shapes only those are kept that the data ask for, one after another,
so that few coefficients remain. Their sizes stay with them as priors: a later fit shrinks them likewise.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kincal_shared.errors import BadInput, CannotAnswer
from kincal_shared.schema.effects import ParameterEntry
from kincal_shared.schema.model import UnnamedEntry
from kincal_shared.schema.terms import basis_text

from ..fit.columns import Columns
from ..fit.least_squares import Fit
from ..model.effects import Hypothesis, Parameter, Term
from ..model.places import TYPICAL_SIZE, ErrorPlace, find_place
from ..model.shapes import FAMILIES, Shape, Variable, is_angle, shapes, swings, variable_basis, waves
from ..model.unnamed_names import UnnamedName
from ..numerics.types import Array
from .bayes_factors import Score, ln_bayes_factor
from .scoring import Scorer

MOST_TERMS = 16
LEAST_LN_BF = 0.5  # a shape is kept if it makes the data e^0.5 times as likely; its size is shrunk as well
_SIZES = np.array([0.03, 0.1, 0.3, 1.0, 3.0, 10.0])  # of the function, in typical sizes of its place
_LEAST_RANGE = 1e-6
_LEAST_TURN = 0.02  # [rad or m] a joint that moves less stands still


@dataclass(frozen=True)
class SmoothEffect:
    """An unnamed effect with its terms.

    family: of the shapes; ln_bf: ln Bayes factor of the whole family against nothing, at the best size.
    """

    name: UnnamedName
    family: str
    ln_bf: float
    hypothesis: Hypothesis
    place: ErrorPlace

    def entry(self) -> UnnamedEntry:
        """As the model file holds it."""
        return UnnamedEntry(
            name=str(self.name), parameter=[_entry(self.place, p) for p in self.hypothesis.parameters]
        )


def _entry(place: ErrorPlace, p: Parameter) -> ParameterEntry:
    terms = [place.term(term.comp, basis_text(*term.basis)) for term in p.terms]
    return ParameterEntry(name=p.name, unit=p.unit, sigma=p.sigma, term=terms)


def smooth_effect(name: UnnamedName, scorer: Scorer, *, most: int = MOST_TERMS) -> SmoothEffect:
    """The smooth function at a place that the data ask for, in at most `most` coefficients.

    scorer: at the fit of the model that it joins. BadInput for an unknown place or driver;
    CannotAnswer where the data do not vary the driver, or ask for no term.
    """
    whole = full_effect(name, scorer)
    kept = _kept(scorer, whole.hypothesis, most)
    if not kept:
        raise CannotAnswer(f"the data ask for no term of {name}")
    parameters = tuple(
        replace(p, name=f"c{number}")
        for number, p in enumerate((whole.hypothesis.parameters[k] for k in kept), 1)
    )
    return replace(whole, hypothesis=replace(whole.hypothesis, parameters=parameters))


def full_effect(name: UnnamedName, scorer: Scorer) -> SmoothEffect:
    """All shapes of the family and the size with the most evidence. Errors as `smooth_effect`."""
    if name.without_terms:
        what = "last move" if name.of_tool_move else "orientation"
        raise CannotAnswer(
            f"{name}: no term can follow the {what} of the tool: flight has no such variables",
            todo="look at the target, the sensor and the tool; an arm model is no place for their errors",
        )
    fit = scorer.columns.fit
    place = find_place(name.place, fit.arm, fit.data)
    variables = [_variable(driver, scorer.columns) for driver in name.drivers]
    families = [(family, shapes(variables, family)) for family in _families(variables)]
    fast = [*(waves(variables) if place.name.startswith("joint") else ()), *swings(variables)]
    units = [
        SmoothEffect(name, family, 0.0, _hypothesis(name, place, functions), place)
        for family, functions in (*families, *fast)
    ]
    scores = scorer.hypotheses([unit.hypothesis for unit in units])
    found = [_sized(unit, score, scorer) for unit, (score, _) in zip(units, scores, strict=True)]
    smooth, of_waves = found[: len(families)], found[len(families) :]
    paid = [replace(f, ln_bf=f.ln_bf - math.log(len(fast))) for f in of_waves]  # for their number
    return max((*smooth, *paid), key=lambda f: f.ln_bf)


def _families(variables: Sequence[Variable]) -> tuple[str, ...]:
    """Those that differ for these variables."""
    if all(v.switches for v in variables):
        return FAMILIES[:1]
    cosines, fourier, polynomial, fine = FAMILIES
    of_angles = (fourier,) if any(v.turns for v in variables) else ()
    of_one = (fine,) if len(variables) == 1 else ()
    return (cosines, *of_angles, polynomial, *of_one)


def _variable(driver: str, columns: Columns) -> Variable:
    """A driver with its values. CannotAnswer where the data do not have it or do not vary it."""
    fit = columns.fit
    basis = variable_basis(driver)
    if basis.index > fit.arm.n:
        raise BadInput(f"{driver!r}: {fit.arm.name} has {fit.arm.n} joints")
    if not _recorded(driver, fit):
        raise CannotAnswer(f"{driver!r} is not in these data or in the arm table")
    turns = is_angle(driver) and not (basis.var == "q" and fit.arm.joints[basis.index - 1].prismatic)
    found = Variable(driver, columns.basis(basis), turns)
    if found.half < (_LEAST_TURN / 2 if basis.var == "q" else _LEAST_RANGE):
        raise CannotAnswer(f"{driver!r} does not vary in these data")
    return found


def _recorded(driver: str, fit: Fit) -> bool:
    need = variable_basis(driver).need
    if need == "mass":
        return fit.arm.has_masses
    return need is None or fit.data.has("cam" if need == "image" else need)


def _sized(unit: SmoothEffect, score: Score, scorer: Scorer) -> SmoothEffect:
    """The same at the size with the most evidence. score: at unit size."""
    one, size = np.ones(1), _SIZES[:, None]
    ln_bf = ln_bayes_factor(score.u * size, score.v * size**2, scorer.noise, one, one)
    best = int(np.argmax(ln_bf))
    parameters = tuple(
        replace(p, sigma=float(f"{p.sigma * _SIZES[best]:.4g}")) for p in unit.hypothesis.parameters
    )
    hypothesis = replace(unit.hypothesis, parameters=parameters)
    return replace(unit, ln_bf=float(ln_bf[best]), hypothesis=hypothesis)


def _hypothesis(name: UnnamedName, place: ErrorPlace, functions: Sequence[Shape]) -> Hypothesis:
    """Every shape on every component, each a coefficient."""
    parameters = tuple(
        Parameter(
            f"c{number}", place.unit, TYPICAL_SIZE * shape.weight,
            (Term(place.frame, component, 1.0, shape.bases),), shrunk=True,
        )
        for number, (shape, component) in enumerate(
            ((shape, component) for shape in functions for component in place.components), 1
        )
    )  # fmt: skip
    return Hypothesis(str(name), str(name), parameters)


# --------------------------------------------------------------------------------------- which terms


def _kept(scorer: Scorer, whole: Hypothesis, most: int) -> list[int]:
    """Positions of the coefficients that the data ask for, the most telling first."""
    return list(forward(scorer, scorer.columns.hypothesis(whole), most))


def forward(scorer: Scorer, block: Array, most: int) -> Iterator[int]:
    """Greedy forward selection: the column with the most evidence beside those chosen so far, while there is
    enough. Each choice is taken out of the others by a rank-one step of W = (I + G G')^-1."""
    g = block / scorer.scale
    left, z = scorer.projector.apply(g), scorer.wz / scorer.scale
    open_ = np.ones(g.shape[1], dtype=bool)
    for _ in range(min(most, g.shape[1])):
        u, v = g.T @ z, np.maximum((g * left).sum(axis=0), 0.0)
        ln_bf = np.where(open_, 0.5 * (u**2 / (1.0 + v) - np.log1p(v)), -np.inf)
        best = int(np.argmax(ln_bf))
        if ln_bf[best] < LEAST_LN_BF:
            return
        yield best
        open_[best] = False
        column, share = left[:, best].copy(), 1.0 + v[best]
        z = z - column * (u[best] / share)
        left = left - np.outer(column, (g[:, best] @ left) / share)
