"""Bases of correction terms as expressions of Python and C; both languages write them almost alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from kincal.errors import CannotAnswer
from kincal.schema.names import LEVER_STRIDE, PNP, VARIABLES
from kincal.schema.terms import Basis

from .calibrated import FittedTerm

Language = Literal["python", "c"]

# Value of each basis variable in the generated code; {i} counts joints from 0, links from 0 (the base).
_VARIABLES: dict[str, tuple[str, str]] = {
    "q": ("q[{i}]", "q[{i}]"),
    "tau": ("load.tau[{i}]", "load->tau[{i}]"),
    "Mx": ("load.moment[{i}][0]", "load->moment[{i}][0]"),
    "My": ("load.moment[{i}][1]", "load->moment[{i}][1]"),
    "Mz": ("load.moment[{i}][2]", "load->moment[{i}][2]"),
    "taup": ("load.tau_payload[{i}]", "load->tau_payload[{i}]"),
    "dir": ('d["direction"][{i}]', "d->direction[{i}]"),
    "qdot": ('d["qdot"][{i}]', "d->qdot[{i}]"),
    "temp": ('d["temp_c"]', "d->temp_c"),
    "t": ('d["t_s"]', "d->t_s"),
    "payload": ('d["payload_kg"]', "d->payload_kg"),
    "range": ('d["range_m"]', "d->range_m"),
    "incid": ('d["incid_rad"]', "d->incid_rad"),
    "pan": ('d["pan_rad"]', "d->pan_rad"),
    "tilt": ('d["tilt_rad"]', "d->tilt_rad"),
    "tag": ('d["tag"]', "d->tag"),
    "u": ("view.u", "view->u"),
    "v": ("view.v", "view->v"),
    "r2": ("(view.u**2 + view.v**2)", "(view->u * view->u + view->v * view->v)"),
    **{name: (f"view.p[{k}]", f"view->p[{k}]") for k, name in enumerate(("xcam", "ycam", "zcam"))},
    **{name: (f"view.p[{k}]", f"view->p[{k}]") for k, name in enumerate(("sx", "sy", "sz"))},
    **{f"g{c}": (f"load.gravity[{{i}}][{k}]", f"load->gravity[{{i}}][{k}]") for k, c in enumerate("xyz")},
    **{
        f"lev{c}": (f"_lever(load, {{i}}, {{body}}, {k})", f"lever(load, {{i}}, {{body}}, {k})")
        for k, c in enumerate("xyz")
    },
}
LINK_INDEXED = ("Mx", "My", "Mz", "gx", "gy", "gz")
MASSES = ("tau", "Mx", "My", "Mz", "taup")
LEVERS = ("gx", "gy", "gz", "levx", "levy", "levz")
LOADS = (*MASSES, *LEVERS)
VIEW = ("u", "v", "r2", "xcam", "ycam", "zcam", "sx", "sy", "sz")
IMAGE = ("u", "v", "r2")

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


def through_points(term: FittedTerm) -> bool:
    """Whether a term corrects a pose that a camera found from many points: that takes the camera's own
    computation, which the generated code does not repeat."""
    return any(basis.var in PNP for basis in term.bases)


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
    if basis.var not in _VARIABLES or basis.fn not in _FUNCTIONS:
        raise CannotAnswer(f"{basis} cannot be written as source code: {basis.var} is not known there")
    column = 0 if language == "python" else 1
    z = _argument(_VARIABLES[basis.var][column].format(**_index(basis)), basis)
    return _FUNCTIONS[basis.fn][column].format(z=z)


def _index(basis: Basis) -> dict[str, object]:
    """Joint or link from 0, and the body of a gravity lever, the tool after the last link."""
    if VARIABLES[basis.var].of_body:
        link, body = divmod(basis.index, LEVER_STRIDE)
        return {"i": link, "body": body or "N + 1"}
    return {"i": basis.index if basis.var in LINK_INDEXED else basis.index - 1}


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
