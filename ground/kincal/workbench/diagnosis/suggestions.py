"""Terms to try for an unnamed effect: simple bases that imitate a cell's function best."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from kincal_shared.errors import BadInput
from kincal_shared.schema.terms import ONE, Basis, parse_basis

from ..evidence.scoring import Scorer
from ..evidence.unnamed import Cell
from ..model.effects import Term
from ..model.places import ErrorPlace, all_places

_COUNT = 3
_SIGMA = 1e-3  # [rad or m] size at which the bases are compared


@dataclass(frozen=True)
class Suggestion:
    """A term of an effect file: `at` a place of the arm, component `comp` of it (empty at a joint, which has
    its own axis), with a `basis`; basis "" where only the place and the driver are known."""

    at: str
    basis: str
    driver: str
    comp: str = ""


def suggest(cell: Cell, scorer: Scorer) -> tuple[Suggestion, ...]:
    """Simple bases, alone or as a product, that imitate the cell's function, best first."""
    fit = scorer.columns.fit
    place = next((p for p in all_places(fit.arm, fit.data) if p.name == cell.location), None)
    if place is None:
        return tuple(Suggestion(cell.location, "", driver) for driver in cell.drivers)
    texts = dict.fromkeys(_readable(cell))  # the product of the dictionary may be among the simple ones
    tried = [(text, component) for text in texts for component in place.components]
    terms = [Term(place.frame, component, 1.0, _bases(text)) for text, component in tried]
    scores = scorer.scores([scorer.columns.term(term)[:, None] * _SIGMA for term in terms])
    ranked = sorted(zip(scores, tried, strict=True), key=lambda row: -row[0][0].chi2)
    return tuple(_suggestion(place, *what) for _, what in ranked[:_COUNT])


def _suggestion(place: ErrorPlace, text: str, component: int) -> Suggestion:
    term = place.term(component, text)
    return Suggestion(term.at, text, "", term.comp or "")


def _bases(text: str) -> tuple[Basis, Basis]:
    return parse_basis(text, {}, "suggestion")


def _readable(cell: Cell) -> Iterator[str]:
    """Products of simple functions of the drivers, and each alone; drivers without a basis are left out."""
    if cell.product is not None:
        yield " * ".join(str(basis) for basis in cell.product.bases if basis != ONE)
    forms = [_forms(driver) for driver in cell.drivers]
    products = [f"{a} * {b}" for a in forms[0] for b in forms[1]] if len(forms) == 2 else []
    for text in (*products, *(form for one in forms for form in one)):
        try:
            _bases(text)
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
