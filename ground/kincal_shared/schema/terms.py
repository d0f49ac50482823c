"""The one grammar of correction terms, for the effect library and for tables/src/terms.toml alike.

A term adds `coefficient x gain x basis` to one component of the twist at one place of the arm:

    at = "joint[j]"                     about (or along) the joint's own axis
    at = "before[3]", comp = "rx"       at the frame before joint 3; also link[3] (after it), base, tool,
                                        camera (sensor where data have no camera columns), meas (the tag)
    basis = "tanh(q4/0.5) * cos(q6)"    at most two factors, each var or fn(scale*(var - offset)/divisor)
    gain = "0.5*long"                   a number, or a product with properties of link j

Joints count from 1; j, i and p (the joint before j) stand for them in entries that are made for many joints;
a gravity lever levz[p,k] has a link and a body beyond it: k in entries made for many bodies, or a number, or
tool.
$name is a constant that is given when the term is made (a searched one, $T0, $tstart, $tspan); N is the gear
ratio.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import pydantic

from kincal_shared.errors import BadInput

from .base import Strict
from .errors import Contradiction
from .names import (
    COMPONENTS,
    FUNCTIONS,
    GEAR_RATIO,
    JOINT_LETTERS,
    JOINT_PLACES,
    LEVER_STRIDE,
    PLACES,
    TOOL_BODY,
    VARIABLES,
)

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|\$\w+|N"
_VARIABLE = re.compile(r"^(r2|[A-Za-z]+)(?:\[(\w+(?:,\w+)?)\]|(\d+))?$")
_ARGUMENT = re.compile(
    rf"^(?:(?P<scale>{_NUMBER})\s*\*\s*)?\(?\s*(?P<var>[A-Za-z]+\d*(?:\[\w+(?:\s*,\s*\w+)?\])?|1)"
    rf"\s*(?:(?P<sign>[-+])\s*(?P<offset>{_NUMBER}))?\s*\)?\s*(?:/\s*(?P<div>{_NUMBER}))?$"
)
_PLACE = re.compile(r"^([a-z]+)(?:\[(\w+)\])?$")
_CONSTANT = re.compile(r"\$\w+")
GAIN_SYMBOLS = ("Lx", "Ly", "Lz", "a", "d", "long", "Bx", "By", "Bz")

Names = Mapping[str, float]


# --------------------------------------------------------------------------- bases


@dataclass(frozen=True)
class Basis:
    """fn(c1 (x - c0)) of variable `var` with joint or link `index` (0 where it has none)."""

    fn: str
    var: str
    index: int
    c0: float = 0.0
    c1: float = 1.0

    @property
    def flight_var(self) -> str:
        """Name of the variable in kc_var_t of the flight headers, small letters."""
        return VARIABLES[self.var].flight

    @property
    def need(self) -> str | None:
        """What the data or the arm table must hold for the variable; None if nothing."""
        return VARIABLES[self.var].needs or None

    def __str__(self) -> str:
        """As people read it, numbers with six digits."""
        return self.text(lambda x: f"{x:.6g}")

    def exact(self) -> str:
        """As a file holds it: reading it gives the same numbers again."""
        return self.text(repr)

    @property
    def highest_link(self) -> int:
        """The highest joint or link that the variable names; 0 where it names none."""
        return max(divmod(self.index, LEVER_STRIDE)) if VARIABLES[self.var].of_body else self.index

    def _index_text(self) -> str:
        """2 of q2, [1,4] and [1,tool] of a gravity lever, nothing for a variable without an index."""
        if not VARIABLES[self.var].indexed:
            return ""
        if not VARIABLES[self.var].of_body:
            return str(self.index)
        link, body = divmod(self.index, LEVER_STRIDE)
        return f"[{link},{body or TOOL_BODY}]"

    def text(self, write: Callable[[float], str]) -> str:
        """The basis in the grammar, numbers written by `write`."""
        if self.var == "1":
            return "1"
        argument = self.var + self._index_text()
        if self.c0:
            offset = write(-self.c0)
            argument += offset if offset.startswith("-") else f"+{offset}"
            if self.c1 != 1.0:
                argument = f"({argument})"
        if self.c1 != 1.0:
            argument = f"{write(self.c1)}*{argument}"
        return argument if self.fn == "lin" else f"{self.fn}({argument})"


ONE = Basis("lin", "1", 0)


@dataclass(frozen=True)
class Factor:
    """A basis as written: joint letters and named constants are still open."""

    text: str
    fn: str
    var: str
    joint: str  # "", a number, or a letter
    scale: str
    offset: str
    divisor: str
    negative: bool  # the offset is added: x + c
    inner: bool  # the offset stands in parentheses: scale * (x - c)

    def bind(self, names: Names) -> Basis:
        """The basis with the values of `names`. BadInput names what has no value."""
        index = self._index(names)
        offset = self._value(self.offset, names) * (-1.0 if self.negative else 1.0) if self.offset else 0.0
        scale = self._value(self.scale, names) if self.scale else 1.0
        c1 = scale / (self._value(self.divisor, names) if self.divisor else 1.0)
        if offset and c1 != 1.0 and not self.inner:
            # 2*q-1 means 2 (q - 0.5): the offset is in units of the variable.
            offset /= scale
        return Basis(self.fn, self.var, index, offset, c1)

    def letters(self) -> list[str]:
        """The joint letters that the index uses."""
        return [part for part in self.joint.split(",") if part in JOINT_LETTERS]

    def _index(self, names: Names) -> int:
        """Number of the joint or link; of a link and a body, as flight counts them."""
        link, _, body = self.joint.partition(",")
        if not body:
            return self._number(link, names)
        return LEVER_STRIDE * self._number(link, names) + self._number(body, names)

    def _number(self, token: str, names: Names) -> int:
        if token in ("", TOOL_BODY):
            return 0
        return int(token) if token.isdigit() else int(self._value(token, names))

    def _value(self, token: str, names: Names) -> float:
        name = token.removeprefix("$")
        if name in names and (token.startswith("$") or token in (GEAR_RATIO, *JOINT_LETTERS)):
            return names[name]
        try:
            return float(token)
        except ValueError:
            raise BadInput(f"basis {self.text!r} uses {token}, which has no value here") from None


@functools.lru_cache(maxsize=1024)
def parse_factors(text: str) -> tuple[Factor, ...]:
    """One or two factors of a basis text. Contradiction says what cannot be read and what is possible."""
    factors = split_product(text)
    if len(factors) > 2:
        raise Contradiction("", f"basis {text!r} has {len(factors)} factors, at most two are possible")
    return tuple(_parse_factor(factor) for factor in factors)


def parse_basis(text: str, names: Names, where: str = "") -> tuple[Basis, Basis]:
    """The two factors of "b" or "b * b", the second ONE if there is none. `names` gives the joint
    letters, N and the constants. BadInput says what could not be read and what is possible."""
    try:
        bases = [factor.bind(names) for factor in parse_factors(text)]
    except (BadInput, Contradiction) as error:
        raise BadInput(error.what, where, error.todo) from None
    return bases[0], bases[1] if len(bases) == 2 else ONE


def basis_text(first: Basis, second: Basis = ONE) -> str:
    """A product of bases as a file holds it, exact; "1" for none."""
    factors = [basis.exact() for basis in (first, second) if basis.var != "1"]
    return " * ".join(factors) or "1"


def split_product(text: str) -> list[str]:
    """Factors of a product: split at '*' between two bases, not inside parentheses and not after a number."""
    factors, depth, start = [], 0, 0
    for i, char in enumerate(text):
        depth += {"(": 1, ")": -1}.get(char, 0)
        if char == "*" and depth == 0 and not re.fullmatch(rf"\s*(?:{_NUMBER})\s*", text[start:i]):
            factors.append(text[start:i])
            start = i + 1
    factors.append(text[start:])
    return [factor.strip() for factor in factors]


def _parse_factor(text: str) -> Factor:
    fn, body = "lin", text
    call = re.fullmatch(r"([a-z0-9]+)\((.*)\)", text)
    if call:
        fn, body = call.group(1), call.group(2).strip()
        if fn not in FUNCTIONS:
            raise Contradiction("", f"{fn!r} is no function", todo=f"there are {', '.join(FUNCTIONS)}")
    match = _ARGUMENT.fullmatch(body)
    if not match:
        raise Contradiction(
            "", f"cannot read basis {text!r}", todo='write for instance "sin(2*q3)" or "temp-20"'
        )
    var, joint = _parse_variable(match["var"])
    scale, offset, divisor = (match[key] or "" for key in ("scale", "offset", "div"))
    return Factor(text, fn, var, joint, scale, offset, divisor, match["sign"] == "+", "(" in body)


def _parse_variable(text: str) -> tuple[str, str]:
    """Variable and its joint: a number, a letter, or "" where it has none."""
    if text in VARIABLES and not VARIABLES[text].indexed:
        return text, ""
    match = _VARIABLE.match(text)
    name, letter, digits = match.groups() if match else (text, None, None)
    if name not in VARIABLES:
        raise Contradiction("", f"{text!r} is no variable", todo=f"there are {', '.join(VARIABLES)}")
    if not VARIABLES[name].indexed:
        raise Contradiction("", f"variable {name} has no index")
    joint = letter or digits
    if joint is None:
        raise Contradiction(
            "", f"variable {name} needs a joint", todo=f"write for instance {name}[j] or {name}3"
        )
    link, comma, body = joint.partition(",")
    if bool(comma) != VARIABLES[name].of_body:
        example = f"{name}[p,k] or {name}[1,tool]" if VARIABLES[name].of_body else f"{name}[j]"
        raise Contradiction("", f"{text!r} has {'two indices' if comma else 'one index'}", f"write {example}")
    for part, more in ((link, ()), (body, (TOOL_BODY,))) if comma else ((link, ()),):
        if not (part.isdigit() or part in (*JOINT_LETTERS, *more)):
            raise Contradiction("", f"{text!r}: no joint {part!r} here", todo="write the number or j")
    return name, joint


# --------------------------------------------------------------------------- places


@dataclass(frozen=True)
class Place:
    """Where a term acts, as written: kind "joint", "before", "link" with a joint, or a fixed place."""

    kind: str
    joint: str = ""

    @property
    def needs(self) -> str:
        """What the data must hold for this place, "" if nothing."""
        return PLACES[self.kind][1] if self.kind in PLACES else ""

    def index(self, names: Names) -> int:
        """Number of the joint, from 1. BadInput if its letter has no value here."""
        if self.joint.isdigit():
            return int(self.joint)
        if self.joint not in names:
            raise BadInput(
                f'at = "{self.kind}[{self.joint}]" names no joint here', todo="write its number or j"
            )
        return int(names[self.joint])

    def frame(self, names: Names) -> int | str:
        """Link after which the term acts, 0 for the base; or "tool", "camera", "meas"."""
        if self.kind in PLACES:
            return PLACES[self.kind][0]
        return self.index(names) if self.kind == "link" else self.index(names) - 1


@functools.lru_cache(maxsize=256)
def parse_place(text: str) -> Place:
    """A place as written in `at`. Contradiction names the possible ones."""
    match = _PLACE.match(text.replace(" ", ""))
    kind, joint = match.groups() if match else (text, None)
    possible = ", ".join(f"{name}[j]" for name in JOINT_PLACES) + ", " + ", ".join(PLACES)
    if kind in PLACES and joint is None:
        return Place(kind)
    known = joint is not None and (joint.isdigit() or joint in JOINT_LETTERS)
    if kind not in JOINT_PLACES or not known or joint == "0":
        raise Contradiction(
            "", f"at = {text!r} is no place", todo=f"write one of {possible}; joints count from 1"
        )
    return Place(kind, joint or "")


def place_text(frame: int | str) -> str:
    """A frame as `at` writes it: "base", "link[3]", "tool" ..."""
    if isinstance(frame, str):
        return frame
    return f"link[{frame}]" if frame else "base"


# --------------------------------------------------------------------------- gains


@functools.lru_cache(maxsize=256)
def parse_gain(text: str) -> tuple[float, tuple[str, ...]]:
    """A product of numbers, properties of link or base and constants ($name): its number, and the names.
    Contradiction otherwise."""
    factor, symbols = 1.0, []
    for part in text.replace(" ", "").split("*"):
        sign = -1.0 if part.startswith("-") else 1.0
        part = part.lstrip("+-")
        if part in GAIN_SYMBOLS or _CONSTANT.fullmatch(part):
            factor *= sign
            symbols.append(part)
            continue
        try:
            factor *= sign * float(part)
        except ValueError:
            raise Contradiction(
                "",
                f"gain {text!r}: {part!r} is neither a number, nor a $constant, nor one of "
                f"{' '.join(GAIN_SYMBOLS)}",
            ) from None
    return factor, tuple(symbols)


# --------------------------------------------------------------------------- one term of a file


class TermEntry(Strict):
    """One term: coefficient x gain x basis, added to one component of the twist at a place."""

    at: str = pydantic.Field(examples=["joint[j]"])
    """Place: joint[j] (its own axis), before[j], link[j], base, tool, camera, sensor, meas. Joints count
    from 1."""
    comp: Literal["tx", "ty", "tz", "rx", "ry", "rz"] | None = None
    """Component of the twist; joint[j] has its own axis and takes none."""
    gain: pydantic.StrictFloat | pydantic.StrictInt | pydantic.StrictStr = 1.0
    """Constant factor: a number, or a product with Lx Ly Lz (link j as a vector in its own frame [m]), a,
    d [m], long (1 if link j has a length, else 0), Bx By Bz (origin of the base frame to frame 0 [m]), $name
    (a constant of the grid)."""
    basis: str = "1"
    """At most two factors, each var or fn(scale*(var - offset)), e.g. "tanh(q4/0.5) * cos(q6)"."""

    @pydantic.field_validator("at")
    @classmethod
    def _readable_place(cls, text: str) -> str:
        parse_place(text)
        return text

    @pydantic.field_validator("basis")
    @classmethod
    def _readable_basis(cls, text: str) -> str:
        parse_factors(text)
        return text

    @pydantic.field_validator("gain")
    @classmethod
    def _readable_gain(cls, value: float | str) -> float | str:
        if isinstance(value, str):
            parse_gain(value)
        return value

    @pydantic.model_validator(mode="after")
    def _has_its_axis(self) -> TermEntry:
        own = self.place.kind == "joint"
        if own and self.comp is not None:
            raise Contradiction(
                "comp", f"{self.at} has its own axis and takes no comp", "leave it out, or write before[j]"
            )
        if not own and self.comp is None:
            raise Contradiction("comp", "is missing", f"write comp = one of {', '.join(COMPONENTS)}")
        return self

    @property
    def place(self) -> Place:
        """Where the term acts."""
        return parse_place(self.at)

    @property
    def factors(self) -> tuple[Factor, ...]:
        """The bases, joint letters and constants still open."""
        return parse_factors(self.basis)

    def needs(self) -> Iterator[str]:
        """What the data or the arm table must hold for this term."""
        if any(GEAR_RATIO in (f.scale, f.offset, f.divisor) for f in self.factors):
            yield "gear_ratio"
        yield from (VARIABLES[f.var].needs for f in self.factors if VARIABLES[f.var].needs)
        if self.place.needs:
            yield self.place.needs

    @property
    def constants(self) -> tuple[str, ...]:
        """Names of the constants that basis and gain use."""
        gain = parse_gain(self.gain)[1] if isinstance(self.gain, str) else ()
        tokens = (*gain, *(token for f in self.factors for token in (f.scale, f.offset, f.divisor)))
        return tuple(token[1:] for token in tokens if token.startswith("$"))

    def bases(self, names: Names, where: str = "") -> tuple[Basis, Basis]:
        """The two bases with joint letters and constants filled in."""
        return parse_basis(self.basis, names, where)
