"""Campaigns (sim/campaigns/*.toml): which cases are flown, how they are dispersed, what has to hold of them.

A key of a dispersion is a path in the scenario (`arm.errors.J2.phi_rad`, `detection.corner_sigma_px`), a
field of the CONFIG table (`config.stop_pos_m`), or `tables`. `J*` stands for every joint. Where a function
takes the place of the scenario, keys are its own."""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic

from .base import Strict, annotation_of, item_annotation, keys_of, model_of
from .errors import Contradiction, read_toml, validate
from .numbers import Count, Positive, Quantity, Real
from .scenario import Scenario
from .tables import ConfigSource

JOINTS = 7
SECTIONS = ("arm", "env", "detection", "calibration", "executive")
CASES_MAX = 10_000_000
SEED_MAX = 2**31 - 1  # what flight takes
Choice = Real | str | bool


# ---- keys


def expanded(key: str) -> list[str]:
    """The keys that a key with J* stands for."""
    return [key.replace("J*", f"J{j}") for j in range(1, JOINTS + 1)] if "J*" in key else [key]


def split_key(key: str) -> list[str]:
    """A key as a path: arm.errors.J2.phi_rad is arm, errors, "J2.phi_rad". Contradiction if there is nothing
    of that name that a case can change."""
    if key == "tables":
        return [key]
    root, _, rest = key.partition(".")
    model = ConfigSource if root == "config" else Scenario
    parts = rest.split(".") if root == "config" else key.split(".")
    if root != "config" and root not in SECTIONS:
        known = ", ".join(f"{name}.*" for name in (*SECTIONS, "config"))
        raise Contradiction("key", f"{key!r} is nothing that can be changed", f"known: {known}, tables")
    return [*(["config"] if root == "config" else []), *_walk(model, parts, key)]


def _walk(model: type[Strict], parts: list[str], key: str) -> list[str]:
    here: type[Strict] | None = model
    for number, part in enumerate(parts):
        if here is None or part not in keys_of(here):
            known = ", ".join(sorted(keys_of(here))) if here else "nothing"
            raise Contradiction("key", f"{key!r}: unknown key {part!r}", f"known there: {known}")
        annotation = annotation_of(here, part)
        here = model_of(annotation)
        if here is not None and item_annotation(annotation) is None:
            continue
        rest = parts[number + 1 :]
        if here is None and rest and item_annotation(annotation) is not None:
            return [*parts[: number + 1], ".".join(rest)]
        if rest or here is not None or item_annotation(annotation) is not None:
            raise Contradiction("key", f"{key!r} is no single value", "name one value, such as env.temp_c")
    if here is not None:
        todo = f"name one of: {', '.join(sorted(keys_of(here)))}"
        raise Contradiction("key", f"{key!r} is no single value", todo)
    return parts


# ---- conditions on the outcome of a case

# Columns of the outcome that a condition may name, with their types.
OUTCOME: dict[str, type] = {
    "ended": str,
    "reason": str,
    "verdict": str,
    "success": bool,
    "poses": int,
    "outliers": int,
    "active": bool,
    "before_pos_m": float,
    "before_rot_rad": float,
    "after_pos_m": float,
    "after_rot_rad": float,
    "proposed_pos_m": float,
    "proposed_rot_rad": float,
    "pred_pos_m": float,
    "pred_rot_rad": float,
    "p_fit": float,
    "contacts_s": float,
    "mission_s": float,
}
# What flown cases have in these; a requirement never counts a case that died as met.
WORDS: dict[str, tuple[str, ...]] = {
    "ended": ("finished", "stopped", "no end", "died"),
    "verdict": ("no_change", "change", "poor", ""),
}
_COMPARE: dict[type[ast.cmpop], Callable[[Any, Any], bool]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}
_ARITHMETIC: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}
_WRITE = 'write a comparison such as after_pos_m <= 0.001, or active and verdict == "change"'


class Condition:
    """A condition on the outcome of a case, such as "after_pos_m <= 0.001 or not active"."""

    def __init__(self, text: str, columns: Mapping[str, type] = OUTCOME) -> None:
        """columns: that it may name, with their types. Contradiction if it cannot be used, or a part of it is
        the same for every case."""
        self.text, self._columns = text, columns
        self._words = WORDS if columns is OUTCOME else {}
        try:
            self._tree = ast.parse(text.strip(), mode="eval").body
            kind = self._kind(self._tree)
            if kind is bool:
                self._tells(self._tree)
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            if isinstance(error, Contradiction):
                raise
            raise Contradiction("", f"{text!r} cannot be read", _WRITE) from None
        if kind is not bool:
            raise Contradiction("", f"{text!r} is not true or false", _WRITE)

    def _tells(self, node: ast.AST) -> None:
        """Contradiction if it, or a part of it that is true or false, names no column, or a text is compared
        with one that it never is."""
        if not any(isinstance(part, ast.Name) for part in ast.walk(node)):
            what = f"{self.text!r}: {ast.unparse(node)} is the same for every case"
            raise Contradiction("", what, f"name a column: {', '.join(self._columns)}")
        match node:
            case ast.BoolOp(values=parts):
                for part in parts:
                    self._tells(part)
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                self._tells(operand)
            case ast.Compare(left=left, comparators=right):
                sides = [left, *right]
                names = [side.id for side in sides if isinstance(side, ast.Name) and side.id in self._words]
                texts = [side.value for side in sides if isinstance(side, ast.Constant)]
                for name, text in ((name, text) for name in names for text in texts):
                    if text not in self._words[name]:
                        known = ", ".join(map(repr, self._words[name]))
                        raise Contradiction("", f"{self.text!r}: {name} is never {text!r}", f"known: {known}")

    def holds(self, outcome: Mapping[str, Any]) -> bool | None:
        """Whether it holds; None if it needs a value that the case has not got."""
        try:
            return bool(self._value(self._tree, outcome))
        except (_NoValue, ArithmeticError):
            return None

    def _kind(self, node: ast.AST) -> type:
        """bool, float or str; Contradiction for what is not allowed, or does not go together."""
        match node:
            case ast.Constant(value=bool() | str() as value):
                return type(value)
            case ast.Constant(value=int() | float()):
                return float
            case ast.Name(id=name) if name in self._columns:
                return float if self._columns[name] is int else self._columns[name]
            case ast.Name(id=name):
                known = ", ".join(self._columns)
                raise Contradiction("", f"{self.text!r}: a case has no {name!r}", f"known: {known}")
            case ast.BoolOp(values=values):
                self._all(values, bool)
                return bool
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                self._all([operand], bool)
                return bool
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                self._all([operand], float)
                return float
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _ARITHMETIC:
                self._all([left, right], float)
                return float
            case ast.Compare(left=left, ops=ops, comparators=right):
                self._all([left, *right], self._kind(left))
                known_ops = all(type(op) in _COMPARE for op in ops)
                ordered = any(not isinstance(op, (ast.Eq, ast.NotEq)) for op in ops)
                if known_ops and not (ordered and self._kind(left) is not float):
                    return bool
        raise Contradiction("", f"{self.text!r} cannot be read", _WRITE)

    def _all(self, nodes: list[ast.expr], kind: type) -> None:
        for node in nodes:
            if self._kind(node) is not kind:
                words = {bool: "true or false", float: "a number", str: "a text"}
                raise Contradiction("", f"{self.text!r}: {ast.unparse(node)} is not {words[kind]}", _WRITE)

    def _value(self, node: ast.AST, outcome: Mapping[str, Any]) -> Any:
        match node:
            case ast.Constant(value=value):
                return value
            case ast.Name(id=name):
                found = outcome.get(name)
                if found is None or found != found:  # not-a-number would meet `not x > 1` and `x != 1`
                    raise _NoValue
                return found
            case ast.BoolOp(op=op, values=values):
                return self._connected(isinstance(op, ast.And), values, outcome)
            case ast.UnaryOp(op=op, operand=operand):
                value = self._value(operand, outcome)
                return not value if isinstance(op, ast.Not) else -value
            case ast.BinOp(left=left, op=op, right=right):
                return _ARITHMETIC[type(op)](self._value(left, outcome), self._value(right, outcome))
            case ast.Compare(left=left, ops=ops, comparators=comparators):
                values = [self._value(x, outcome) for x in (left, *comparators)]
                return all(
                    _COMPARE[type(o)](*pair) for o, *pair in zip(ops, values, values[1:], strict=False)
                )
        raise AssertionError(ast.dump(node))

    def _connected(self, every: bool, nodes: list[ast.expr], outcome: Mapping[str, Any]) -> bool:
        """and, or: from left to right, so that the left side can ask whether there is a value at all."""
        for node in nodes:
            if bool(self._value(node, outcome)) != every:
                return not every
        return every


class _NoValue(Exception):
    pass


# ---- the file


class Dispersion(Strict):
    """One value, or one of each joint (J*), that differs from case to case. Exactly one of uniform, normal,
    choice."""

    key: str = pydantic.Field(examples=["arm.errors.J2.phi_rad"])
    """What differs: a path in the scenario, config.FIELD, or tables. J* stands for every joint. With a
    function, any name."""
    uniform: tuple[Real, Real] | None = None
    """Evenly distributed between these two."""
    normal: tuple[Real, Positive] | None = None
    """Normally distributed: mean and sigma."""
    limits: tuple[Real, Real] | None = None
    """With normal: distribution cut off here."""
    choice: list[Choice] | None = None
    """One of these, all equally likely."""

    @pydantic.model_validator(mode="after")
    def _one_law(self) -> Dispersion:
        given = [name for name in ("uniform", "normal", "choice") if getattr(self, name) is not None]
        if len(given) != 1:
            what = "gives " + (" and ".join(given) or "no distribution")
            raise Contradiction("", f"{self.key!r} {what}", "give exactly one of uniform, normal, choice")
        if self.limits is not None and self.normal is None:
            raise Contradiction("limits", f"{given[0]} has no limits", "limits go with normal")
        for name in ("uniform", "limits"):
            ends = getattr(self, name)
            if ends is not None and not ends[0] < ends[1]:
                raise Contradiction(
                    name,
                    f"the range {ends[0]:g} to {ends[1]:g} is empty",
                    "write [low, high], low below high",
                )
        self._check_choice()
        return self

    def _check_choice(self) -> None:
        choice = self.choice
        if choice is None:
            if self.key == "tables":
                raise Contradiction("", "tables are no number", 'write choice = ["FOLDER", "FOLDER"]')
            return
        if len(choice) < 2 or len({str(value) for value in choice}) < len(choice):
            raise Contradiction("choice", "needs at least two values, all different")
        if len({type(value) for value in choice}) > 1:
            raise Contradiction("choice", "mixes numbers and texts", "write all values alike, 1.0 and not 1")


ALL = "True"  # given of all cases


class Requirement(Strict):
    """What has to hold in a share of the cases, shown with confidence."""

    name: str = pydantic.Field(min_length=1)
    """What it is called in reports."""
    holds: str = pydantic.Field(examples=["after_pos_m <= 0.001"])
    """Condition on the outcome of a case."""
    given: str = ALL
    """Counted are only the cases in which this holds; True: all."""
    probability: Annotated[float, Quantity(gt=0.0, lt=1.0)]
    """Least probability with which it has to hold."""
    confidence: Annotated[float, Quantity(gt=0.0, lt=1.0)] = 0.95
    """Confidence of the one-sided bound that shows it."""


class Campaign(Strict):
    """A campaign: cases of one scenario, or of one function, each with other values of what is dispersed."""

    title: str = ""
    """What it is for."""
    scenario: str = pydantic.Field(default="", examples=["healthy"])
    """Name in sim/scenarios, or a file, from the folder of this file."""
    function: str = pydantic.Field(default="", examples=["faults:case"])
    """Instead of a scenario: MODULE:FUNCTION that flies a case, in the folder of this file or installed."""
    tables: str = ""
    """Folder with table images, from the folder of this file; "": as shipped."""
    seed: Annotated[int, Count(ge=0)] = 1
    """Root of all seeds."""
    cases: Annotated[int, Count(ge=1, le=CASES_MAX)]
    """How many are flown."""
    sampling: Literal["random", "latin hypercube", "sobol", "combinations"] = "random"
    """How the dispersed values are drawn. combinations: all of the choices in turn, then again with the next
    seed."""
    time_limit_s: Positive = 900.0
    """A case that takes longer on the clock of the computer is ended, and counts as died [s]."""
    set: dict[str, Choice] = {}
    """Values that differ from the scenario in all cases, by key."""
    dispersion: list[Dispersion] = []
    """What differs from case to case."""
    columns: dict[str, Literal["number", "text", "true or false"]] = {}
    """With a function: what it gives that requirements name."""
    requirement: list[Requirement] = []
    """What has to hold."""

    @property
    def outcome(self) -> dict[str, type]:
        """The columns of a case that conditions may name, with their types."""
        if not self.function:
            return OUTCOME
        kinds = {"number": float, "text": str, "true or false": bool}
        return {"ended": str, "reason": str} | {name: kinds[kind] for name, kind in self.columns.items()}

    @pydantic.model_validator(mode="after")
    def _consistent(self) -> Campaign:
        if bool(self.scenario) == bool(self.function):
            what = "is given, and a function too" if self.scenario else "is missing, and there is no function"
            raise Contradiction("scenario", what, "give one of scenario, function")
        owner: dict[str, str] = {}
        for key in self.set:
            self._check_key(key, "set")
            owner[key] = "set"
        for number, dispersion in enumerate(self.dispersion, 1):
            for key in expanded(dispersion.key):
                self._check_key(key, f"dispersion[{number}]")
                if key in owner:
                    what = f"{key!r} is given twice, here and by {owner[key]}"
                    raise Contradiction(f"dispersion[{number}]", what, "remove one of them")
                owner[key] = f"dispersion[{number}]"
        if self.sampling != "random" and not self.dispersion:
            raise Contradiction(
                "sampling", f"{self.sampling}, but nothing is dispersed", "add a [[dispersion]]"
            )
        if self.sampling == "combinations" and any(d.choice is None for d in self.dispersion):
            raise Contradiction("sampling", "only choices have combinations", "write choice = [...]")
        if self.sampling == "combinations" and self.seed + self.cases > SEED_MAX:
            raise Contradiction(
                "seed", f"with combinations at most {SEED_MAX} less the cases", "give a smaller one"
            )
        if self.sampling == "sobol" and self.cases & (self.cases - 1):
            below = 1 << (self.cases.bit_length() - 1)
            todo = f"write cases = {below} or {2 * below}"
            raise Contradiction("cases", "a Sobol sequence is balanced only in powers of two", todo)
        names = [r.name for r in self.requirement]
        if twice := {n for n in names if names.count(n) > 1}:
            raise Contradiction("requirement", f"two are called {twice.pop()!r}", "name each otherwise")
        self._check_columns()
        return self

    def _check_columns(self) -> None:
        """Columns that are declared, and conditions that name them."""
        if self.columns and not self.function:
            what = "a scenario has columns of its own"
            raise Contradiction("columns", what, "remove them, or give a function")
        if given := {"ended", "reason"} & self.columns.keys():
            raise Contradiction("columns", f"{given.pop()!r} is a text in every campaign", "remove it")
        for number, requirement in enumerate(self.requirement, 1):
            for name in ("holds", "given") if requirement.given != ALL else ("holds",):
                try:
                    Condition(getattr(requirement, name), self.outcome)
                except Contradiction as error:
                    where = f"requirement[{number}].{name}"
                    hint = "; others are declared in [columns]" if self.function else ""
                    raise Contradiction(where, error.what, error.todo + hint) from None

    def _check_key(self, key: str, where: str) -> None:
        """Contradiction if there is nothing of that name that a case can change."""
        try:
            if not self.function:
                split_key(key)
        except Contradiction as error:
            raise Contradiction(where, error.what, error.todo) from None


def read_campaign(path: Path) -> Campaign:
    """Read a campaign. SchemaError lists all that is wrong; BadInput if there is no such file."""
    return validate(Campaign, read_toml(path), str(path))
