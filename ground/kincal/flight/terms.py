"""Correction terms: schema objects and term tables as the struct that the model works on.

A term acts at a frame: 0 .. n of the chain, or one of the last three, which count from the end, so that
`Evaluation.twist[:, frame, component]` is the right row for all of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Protocol

import numpy as np

from kincal_shared.errors import CannotAnswer
from kincal_shared.schema.names import PNP, VARIABLES

from .builds import FlightLibrary, GroundLibrary, library

if TYPE_CHECKING:
    from .headers import KcBasis, KcTerm, KcTerms

FRAME_TOOL, FRAME_CAMERA, FRAME_MEAS = -3, -2, -1
# Names that people write; the sensor is the camera, or the measurement frame itself without one.
FRAMES = {
    "base": 0,
    "tool": FRAME_TOOL,
    "camera": FRAME_CAMERA,
    "sensor": FRAME_CAMERA,
    "meas": FRAME_MEAS,
}
_FRAME_MACROS = {
    FRAME_TOOL: "KC_FRAME_TOOL",
    FRAME_CAMERA: "KC_FRAME_CAMERA",
    FRAME_MEAS: "KC_FRAME_MEAS",
}
_ENUMERATORS = {name.upper(): of.flight.upper() for name, of in VARIABLES.items()}


class BasisLike(Protocol):
    """fn(c1 (x - c0)) of variable `var` at joint or link `index` (0 where it has none)."""

    @property
    def fn(self) -> str:
        """Name of kc_fn_t."""

    @property
    def var(self) -> str:
        """Name of the variable in the term grammar."""

    @property
    def index(self) -> int:
        """Joint or link, from 1; 0 where the variable has none."""

    @property
    def c0(self) -> float:
        """Offset, in the variable's unit."""

    @property
    def c1(self) -> float:
        """Scale, 1 over that unit."""


class TermLike(Protocol):
    """gain x basis x basis, added to twist component `comp` (0..5 or "tx".."rz") at `frame`."""

    @property
    def frame(self) -> int | str:
        """0 (base) to n, or the name of a special frame."""

    @property
    def comp(self) -> int | str:
        """Component of the twist."""

    @property
    def gain(self) -> float:
        """Constant factor."""

    @property
    def basis(self) -> Sequence[BasisLike]:
        """Two factors."""


class ParameterLike(Protocol):
    """A coefficient: its typical size and the terms that it scales."""

    @property
    def sigma(self) -> float:
        """Typical size, in the coefficient's unit."""

    @property
    def terms(self) -> Sequence[TermLike]:
        """What the coefficient scales."""


@dataclass(frozen=True)
class Coefficient:
    """One row of a term table: bounds are -bound .. bound, 0: not estimated; prior_sigma 0 means flat."""

    name: str
    terms: Sequence[TermLike]
    bound: float
    prior_sigma: float
    scale: float


@cache
def functions() -> dict[str, int]:
    """Basis functions of the headers by their name in the grammar: {"lin": 0 ...}."""
    return {name.lower(): number for name, number in library("ground").enum("kc_fn_t", "KC_FN_").items()}


@cache
def components() -> dict[str, int]:
    """Twist components by name: {"tx": 0 .. "rz": 5}."""
    return {name.lower(): number for name, number in library("ground").enum("kc_comp_t", "KC_").items()}


@cache
def variable(name: str) -> int:
    """Number of a basis variable by its name in the grammar, any case. KeyError if there is none."""
    upper = name.upper()
    return library("ground").enum("kc_var_t", "KC_VAR_")[_ENUMERATORS.get(upper, upper)]


def fill_basis(out: KcBasis, basis: BasisLike) -> None:
    """Set a kc_basis_t."""
    out.fn, out.var, out.index = functions()[basis.fn], variable(basis.var), basis.index
    out.c0, out.c1 = basis.c0, basis.c1


def _frame_number(build: FlightLibrary | GroundLibrary, frame: int | str) -> int:
    number = FRAMES[frame] if isinstance(frame, str) else frame
    number = build.constant(_FRAME_MACROS[number]) if number in _FRAME_MACROS else number
    if not 0 <= number < build.lib.KC_FRAME_COUNT:
        raise ValueError(f"there is no frame {frame}")
    return number


def _fill_term(build: FlightLibrary | GroundLibrary, out: KcTerm, coef: int, term: TermLike) -> None:
    out.coef, out.frame, out.gain = coef, _frame_number(build, term.frame), term.gain
    out.comp = components()[term.comp] if isinstance(term.comp, str) else term.comp
    for row, basis in zip(out.basis, term.basis, strict=False):  # a missing second one is 1: all zeros
        fill_basis(row, basis)


def fill_terms(build: FlightLibrary | GroundLibrary, coefficients: Sequence[Coefficient]) -> KcTerms:
    """kc_terms_t of a build, all coefficients with a bound enabled. CannotAnswer if they are more than it
    carries."""
    most, most_terms = build.lib.KC_COEF_MAX, build.lib.KC_TERM_MAX
    whose = "flight" if build.build == "flight" else "the ground tool"
    if len(coefficients) > most:
        raise CannotAnswer(
            f"the model has {len(coefficients)} coefficients, {whose} carries at most {most}; "
            "remove an effect"
        )
    if sum(len(c.terms) for c in coefficients) > most_terms:
        raise CannotAnswer(f"the model has more than {most_terms} terms; remove an effect")
    out = build.new("kc_terms_t")
    for number, coefficient in enumerate(coefficients):
        row = out.coef[number]
        row.name = coefficient.name.encode("ascii", "replace")[: build.lib.KC_NAME_LEN - 1]
        row.lb, row.ub = -coefficient.bound, coefficient.bound
        row.prior_sigma, row.scale = coefficient.prior_sigma, coefficient.scale
        row.enabled = int(coefficient.bound > 0.0)
        for term in coefficient.terms:
            _fill_term(build, out.term[out.n_term], number, term)
            out.n_term += 1
    out.n_coef = len(coefficients)
    return out


def _number_pnp(struct: KcTerms) -> tuple[int, ...]:
    """Columns of PnP poses that the terms use, renumbered there from 1: a model uses few of many."""
    ground = library("ground")
    basis = ground.rows(struct.term, struct.n_term)["basis"]
    mine = np.isin(basis["var"], [variable(name) for name in PNP])
    numbers, place = np.unique(basis["index"][mine], return_inverse=True)
    if len(numbers) > ground.lib.KC_PNP_MAX:
        raise CannotAnswer(
            f"the model has {len(numbers)} faults of camera and target, at most "
            f"{ground.lib.KC_PNP_MAX} are possible; remove an effect"
        )
    basis["index"][mine] = place + 1
    return tuple(int(number) for number in numbers)


class Terms:
    """The coefficients of a model and what they act on: up to 256. Do not change `struct`.

    pnp: numbers of the columns of PnP poses that the terms use, in the order in which `struct` has them.
    """

    def __init__(self, struct: KcTerms, pnp: tuple[int, ...] = ()) -> None:
        self.struct = struct
        self.n = int(struct.n_coef)
        self.pnp = pnp

    @classmethod
    def of(cls, parameters: Iterable[tuple[str, ParameterLike]]) -> Terms:
        """From (name, parameter) pairs, in their order. CannotAnswer if they are too many."""
        rows = [Coefficient(name, p.terms, 1e3, p.sigma, p.sigma) for name, p in parameters]
        struct = fill_terms(library("ground"), rows)
        return cls(struct, _number_pnp(struct))

    @classmethod
    def of_table(cls, table: KcTerms) -> Terms:
        """From flight's term table, by `tables.decode`."""
        flight, ground = library("flight"), library("ground")
        out = ground.new("kc_terms_t")
        out.n_coef, out.n_term = table.n_coef, table.n_term
        ground.rows(out.coef, out.n_coef)[:] = flight.rows(table.coef, table.n_coef)
        terms = ground.rows(out.term, out.n_term)
        terms[:] = flight.rows(table.term, table.n_term)
        tool = flight.lib.KC_FRAME_TOOL
        terms["frame"][terms["frame"] >= tool] += ground.lib.KC_FRAME_TOOL - tool
        return cls(out)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coefficients, as far as a table holds them (23 characters)."""
        ground = library("ground")
        return tuple(ground.text(self.struct.coef[i].name) for i in range(self.n))
