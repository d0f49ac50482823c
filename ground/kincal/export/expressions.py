"""Bases of correction terms as expressions of Python and C; both languages write them almost alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from kincal_shared.errors import CannotAnswer
from kincal_shared.schema.names import LEVER_STRIDE, PNP, VARIABLES, Variable
from kincal_shared.schema.terms import Basis

from .calibrated import FittedTerm

Language = Literal["python", "c"]


def _variables_with(*texts: str) -> frozenset[str]:
    """Variables whose expression has one of these texts in it."""
    return frozenset(
        name
        for name, of in VARIABLES.items()
        if of.computed and any(text in of.computed[0] for text in texts)
    )


MASSES = _variables_with("load.tau", "load.moment")
LOADS = _variables_with("load.", "_lever(load")
LEVERS = LOADS - MASSES  # where frames, tool and gravity are
IMAGE = _variables_with("view.u", "view.v")
VIEW = _variables_with("view.p") | IMAGE

_FUNCTIONS: dict[str, tuple[str, str]] = {
    "lin": ("{z}", "{z}"),
    "sin": ("math.sin({z})", "sin({z})"),
    "cos": ("math.cos({z})", "cos({z})"),
    "tanh": ("math.tanh({z})", "tanh({z})"),
    "ln1p": ("math.log1p(max({z}, 0.0))", "log1p(fmax({z}, 0.0))"),
    "expn": ("math.exp(-max({z}, 0.0))", "exp(-fmax({z}, 0.0))"),
    "step": ("(1.0 if {z} >= 0.0 else 0.0)", "({z} >= 0.0 ? 1.0 : 0.0)"),
    "sq": ("({z}) ** 2", "square({z})"),
    "tan2": ("math.tan(min(max({z}, -1.4), 1.4)) ** 2", "square(tan(fmin(fmax({z}, -1.4), 1.4)))"),
    "abs": ("abs({z})", "fabs({z})"),
}


def points_of(term: FittedTerm) -> tuple[Basis, ...]:
    """Bases by which a term corrects a pose that a camera found from many points."""
    return tuple(basis for basis in term.bases if basis.var in PNP)


@dataclass(frozen=True)
class Line:
    """One correction of the generated code: twist[row][comp] += factor * product. comment: which
    coefficient it is, with its unit."""

    row: int
    comp: int
    factor: str
    product: str
    comment: str


def basis_expression(basis: Basis, language: Language) -> str:
    """The value of a basis. CannotAnswer for a variable or function that the generated code does not know."""
    if not known(basis.var) or basis.fn not in _FUNCTIONS:
        raise CannotAnswer(f"{basis} cannot be written as source code: {basis.var} is not known there")
    column = 0 if language == "python" else 1
    z = _argument(_value(VARIABLES[basis.var])[column].format(**_index(basis)), basis)
    return _FUNCTIONS[basis.fn][column].format(z=z)


def known(variable: str) -> bool:
    """Whether the generated code has the value of a variable."""
    return bool(VARIABLES[variable].given or VARIABLES[variable].computed)


def _value(of: Variable) -> tuple[str, str]:
    """The value of a known variable in both languages."""
    index = "[{i}]" if of.indexed else ""
    return of.computed or (f'd["{of.given}"]{index}', f"d->{of.given}{index}")


def _index(basis: Basis) -> dict[str, object]:
    """Joint, link or column from 0, and the body of a gravity lever, the tool after the last link."""
    if VARIABLES[basis.var].of_body:
        link, body = divmod(basis.index, LEVER_STRIDE)
        return {"i": link, "body": body or "N + 1"}
    return {"i": basis.index if VARIABLES[basis.var].of_link else basis.index - 1}


def _argument(x: str, basis: Basis) -> str:
    """c1 (x - c0), without what changes nothing."""
    if basis.c0:
        x = f"({x} {'-' if basis.c0 > 0.0 else '+'} {abs(basis.c0)!r})"
    return x if basis.c1 == 1.0 else f"{number(basis.c1)} * {x}"


def number(value: float) -> str:
    """A number that both languages read back as the same double."""
    text = repr(float(value))
    return f"({text})" if text.startswith("-") else text


def line(term: FittedTerm, row: int, language: Language) -> Line:
    """A term as a line of code; row: of its frame in the table of twists."""
    product = " * ".join(basis_expression(basis, language) for basis in term.bases)
    unit = f" [{term.coefficient.unit}]" if term.coefficient.unit else ""
    comment = plain(f"{term.coefficient.name}{unit}")
    return Line(row, term.comp, repr(term.factor), product, comment)


def plain(text: str) -> str:
    """Text that cannot end a comment or a string of either language."""
    kept = "".join(char if char.isprintable() else " " for char in text)
    for bad, instead in (("*/", "* /"), ("/*", "/ *"), ('"', "'"), ("\\", "/"), ("??", "? ?")):
        kept = kept.replace(bad, instead)
    return " ".join(kept.split())
