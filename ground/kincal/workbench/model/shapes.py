"""Smooth functions of the variables that errors depend on, as bases that fly."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from kincal_shared.errors import BadInput
from kincal_shared.schema.names import VARIABLES
from kincal_shared.schema.terms import ONE, Basis

from ..numerics.types import Array

FAMILIES = ("cosines", "Fourier", "polynomial and tanh", "fine cosines")
_COSINES, _HARMONICS = 5, 3
_FINE, _FINE_HALF = 40, 12.0  # of one driver alone: gear teeth and bearings ripple
_LEAST_WEIGHT = 0.09  # products of two fine shapes are left out: too many, and noise
_JOINT_DRIVER = re.compile(r"([a-z]+?)(\d+)")
_SWITCHES = ("dir", "move", "tag", "qdot")  # an error follows them in proportion
_ANGLES = ("q", "pan", "tilt")
_FUNCTIONS: dict[str, Callable[[Array], Array]] = {
    "lin": lambda x: x,
    "sq": lambda x: x**2,
    "sin": np.sin,
    "cos": np.cos,
    "tanh": np.tanh,
}
EVALUATED = tuple(_FUNCTIONS)
"""Functions of bases that `evaluate` knows."""

WAVES = range(1, 7)
"""Periods a turn of waves of two joint angles."""
FAST_WAVES = 3
"""One of the two has at least so many: slower ones are products of other shapes."""

SWINGS = tuple(0.5 * k for k in range(2, 13))
"""Periods in a session of what swings with the day."""

Product = tuple[Basis, Basis]


@dataclass(frozen=True)
class Shape:
    """A basis, or a product of two; weight: prior size relative to that of the whole function. Finer
    shapes are smaller: the function is smooth."""

    bases: Product
    weight: float


@dataclass(frozen=True)
class Variable:
    """A driver over the poses. values: (N,); turns: an angle that repeats every turn."""

    name: str
    values: Array
    turns: bool = False

    @property
    def basis(self) -> Basis:
        """The variable itself."""
        return variable_basis(self.name)

    @property
    def switches(self) -> bool:
        """An error follows it in proportion: signs, last moves, the tag that was seen, velocities."""
        return self.basis.var in _SWITCHES

    @property
    def middle(self) -> float:
        """Middle of the range."""
        return _rounded(0.5 * (self.values.max() + self.values.min()))

    @property
    def half(self) -> float:
        """Half of the range; 0 where it does not vary."""
        return _rounded(0.5 * float(np.ptp(self.values)))


def _rounded(x: float) -> float:
    """Four digits are enough for a constant of a basis, and can be read."""
    return float(f"{x:.4g}")


def variable_basis(driver: str) -> Basis:
    """A driver of the map as a basis: q3, tau2, temp ... BadInput for an unknown name."""
    match = _JOINT_DRIVER.fullmatch(driver)
    name, index = (match[1], int(match[2])) if match and match[1] in VARIABLES else (driver, 0)
    name = "t" if name == "order" else name
    if name not in VARIABLES or VARIABLES[name].indexed != bool(index):
        raise BadInput(
            f"{driver!r} is no variable that terms can follow", todo="write for instance q3 or temp"
        )
    return Basis("lin", name, index)


def is_angle(driver: str) -> bool:
    """Whether a driver is an angle if its joint turns."""
    return variable_basis(driver).var in _ANGLES


def evaluate(basis: Basis, x: Array) -> Array:
    """Values of one of these shapes at values x of its variable, as flight computes them."""
    return np.ones_like(x) if basis.var == "1" else _FUNCTIONS[basis.fn](basis.c1 * (x - basis.c0))


def shapes(variables: Sequence[Variable], family: str) -> tuple[Shape, ...]:
    """Smooth functions of one variable or of two at once, from coarse to fine."""
    single = [tuple(_single(v, family)) for v in variables]
    alone = tuple(s for one in single for s in one)
    return alone if len(single) == 1 else (*alone, *_products(*single))


def waves(variables: Sequence[Variable]) -> Iterator[tuple[str, tuple[Shape, ...]]]:
    """Products of waves of two angles, by name: those of so many periods a turn of each, in any phase."""
    if len(variables) != 2 or not all(v.turns for v in variables):
        return
    for k, l in itertools.product(WAVES, WAVES):
        if max(k, l) >= FAST_WAVES:
            first, second = ([_scaled(v, fn, 0.0, float(n)) for fn in ("sin", "cos")]
                             for v, n in zip(variables, (k, l), strict=True))  # fmt: skip
            every = tuple(Shape((a, b), 1.0) for a in first for b in second)
            yield f"{k} and {l} periods a turn", every


def swings(variables: Sequence[Variable]) -> Iterator[tuple[str, tuple[Shape, ...]]]:
    """Waves of time, by name: those of so many periods in the session, in any phase."""
    if [v.basis.var for v in variables] != ["t"]:
        return
    [v] = variables
    for k in SWINGS:
        rate = _rounded(np.pi * k / v.half)
        both = tuple(Shape((_scaled(v, fn, v.middle - v.half, rate), ONE), 1.0) for fn in ("cos", "sin"))
        yield f"{k:g} periods in the session", both


def _products(first: Sequence[Shape], second: Sequence[Shape]) -> Iterator[Shape]:
    for a in first:
        for b in second:
            if a.weight * b.weight >= _LEAST_WEIGHT:
                yield Shape((a.bases[0], b.bases[0]), a.weight * b.weight)


def _single(v: Variable, family: str) -> Iterator[Shape]:
    if v.switches:
        yield Shape((v.basis, ONE), 1.0)
    elif family == "Fourier" and v.turns:
        yield from _fourier(v)
    elif family == "polynomial and tanh":
        yield from _polynomial(v)
    elif family == "fine cosines":
        yield from _cosines(v, _FINE, _FINE_HALF)
    else:
        yield from _cosines(v, _COSINES, 2.0)


def _cosines(v: Variable, count: int, half: float) -> Iterator[Shape]:
    """Half waves over the measured range (the discrete cosine transform's); half: number of the one that is
    half as large as the first ones."""
    for k in range(1, count + 1):
        basis = _scaled(v, "cos", v.middle - v.half, _rounded(np.pi * k / (2.0 * v.half)))
        yield Shape((basis, ONE), 1.0 / (1.0 + (k / half) ** 2))


def _fourier(v: Variable) -> Iterator[Shape]:
    for k in range(1, _HARMONICS + 1):
        for fn in ("sin", "cos"):
            yield Shape((_scaled(v, fn, 0.0, float(k)), ONE), k**-1.5)


def _polynomial(v: Variable) -> Iterator[Shape]:
    for fn, steepness, weight in (
        ("lin", 1.0, 1.0),
        ("sq", 1.0, 0.6),
        ("tanh", 3.0, 0.6),
        ("tanh", 8.0, 0.3),
    ):
        yield Shape((_scaled(v, fn, v.middle, _rounded(steepness / v.half)), ONE), weight)


def _scaled(v: Variable, fn: str, c0: float, c1: float) -> Basis:
    return Basis(fn, v.basis.var, v.basis.index, _rounded(c0), c1)
