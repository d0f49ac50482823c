"""Terms to try for an unnamed effect: simple bases that imitate a cell's function best."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from kincal.errors import BadInput
from kincal.schema.terms import parse_basis

from ..effects import Term
from ..scoring import Scorer
from ..unnamed import Cell

_COUNT = 3
_SIGMA = 1e-3  # [rad or m] size at which the bases are compared


@dataclass(frozen=True)
class Suggestion:
    """A term of an effect file: `at` a place of the arm, with a `basis`; basis "" where only the place and
    the driver are known."""

    at: str
    basis: str
    driver: str


def suggest(cell: Cell, scorer: Scorer) -> tuple[Suggestion, ...]:
    """Simple bases, alone or as a product, that imitate the cell's function, best first."""
    if not cell.location.startswith("joint"):
        return tuple(Suggestion(cell.location, "", driver) for driver in cell.drivers)
    joint = int(cell.location.split()[1])
    ranked = sorted(((_chi2(text, joint, scorer), text) for text in _readable(cell)), reverse=True)
    return tuple(Suggestion(f"joint[{joint}]", text, "") for _, text in ranked[:_COUNT])


def _readable(cell: Cell) -> Iterator[str]:
    """Products of simple functions of the drivers, and each alone; drivers without a basis are left out."""
    forms = [_forms(driver) for driver in cell.drivers]
    products = [f"{a} * {b}" for a in forms[0] for b in forms[1]] if len(forms) == 2 else []
    for text in (*products, *(form for one in forms for form in one)):
        try:
            parse_basis(text, {}, "suggestion")
        except BadInput:
            continue
        yield text


def _forms(driver: str) -> list[str]:
    if driver[0] == "q" and driver[1:].isdigit():
        return [driver, f"sin({driver})", f"cos({driver})", f"sin(2*{driver})", f"cos(2*{driver})",
                f"tanh({driver})"]  # fmt: skip
    if driver.startswith("tau"):
        return [driver, f"tanh({driver}/1.0)"]
    return ["t" if driver == "order" else driver]


def _chi2(text: str, joint: int, scorer: Scorer) -> float:
    """Score of a term about a joint's axis (along it, if it slides)."""
    component = 2 if scorer.columns.fit.arm.joints[joint - 1].prismatic else 5
    term = Term(joint - 1, component, 1.0, parse_basis(text, {}, "suggestion"))
    column = scorer.columns.term(term)[:, None] * _SIGMA
    return scorer.scores([column])[0][0].chi2
