"""Numbers in files that people write: plain, or as a short expression such as "-pi/2" or "25*deg"."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from kincal_shared.errors import BadInput

_OPERATORS: dict[type[ast.AST], Callable[..., float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
_CONSTANTS = {"pi": math.pi, "deg": math.pi / 180.0}
_CALLS: dict[str, Callable[[float], float]] = {"sin": math.sin, "cos": math.cos, "sqrt": math.sqrt}
_ALLOWED = "use numbers, + - * / **, pi, deg, sin(), cos(), sqrt()"


def evaluate(text: str) -> float:
    """Value of an expression of numbers, pi, deg (one degree in rad), sin, cos and sqrt. ValueError
    otherwise."""
    try:
        value = _walk(ast.parse(text.strip(), mode="eval").body)
        if math.isfinite(value):
            return value
    except (ValueError, TypeError, SyntaxError, ArithmeticError, RecursionError, MemoryError):
        pass
    raise ValueError(f"cannot work out {text!r}; {_ALLOWED}")


def plain_number(text: str) -> float:
    """A number as other programs write it. ValueError for what only Python takes for one: underscores
    between digits, digits of other scripts."""
    if "_" in text or not text.isascii():
        raise ValueError(text)
    return float(text)


def number(value: Any, where: str = "") -> float:
    """A number as written in a file: int, float or expression text. BadInput with `where` otherwise."""
    if isinstance(value, (int, float)):
        return float(value)
    if not isinstance(value, str):
        raise BadInput(f"{value!r} is not a number", where)
    try:
        return evaluate(value)
    except ValueError as error:
        raise BadInput(str(error).partition(";")[0], where, _ALLOWED) from None


def _walk(node: ast.AST) -> float:
    match node:
        case ast.Constant(value=bool() | str() | bytes()):
            pass
        case ast.Constant(value=int() | float() as value):
            return float(value)
        case ast.Name(id=name) if name in _CONSTANTS:
            return _CONSTANTS[name]
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
            return _OPERATORS[type(op)](_walk(left), _walk(right))
        case ast.UnaryOp(op=op, operand=operand) if type(op) in _OPERATORS:
            return _OPERATORS[type(op)](_walk(operand))
        case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]) if name in _CALLS:
            return _CALLS[name](_walk(argument))
    raise ValueError(type(node).__name__)


@dataclass(frozen=True)
class Quantity:
    """Annotation of a float field: a finite number or an expression text, inside the given limits."""

    ge: float | None = None
    gt: float | None = None
    le: float | None = None
    lt: float | None = None

    def __get_pydantic_core_schema__(self, _source: Any, _handler: GetCoreSchemaHandler) -> CoreSchema:
        inner = core_schema.float_schema(
            strict=True, allow_inf_nan=False, ge=self.ge, gt=self.gt, le=self.le, lt=self.lt
        )
        return core_schema.no_info_before_validator_function(_from_text, inner)

    def __get_pydantic_json_schema__(
        self, _schema: CoreSchema, _handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        return {"anyOf": [{"type": "number", **self._limits()}, _EXPRESSION]}

    def _limits(self) -> dict[str, float]:
        names = {
            "minimum": self.ge,
            "exclusiveMinimum": self.gt,
            "maximum": self.le,
            "exclusiveMaximum": self.lt,
        }
        return {name: value for name, value in names.items() if value is not None}


@dataclass(frozen=True)
class Count:
    """Annotation of an int field: a whole number, or an expression text that gives one, inside the limits."""

    ge: int | None = None
    le: int | None = None

    def __get_pydantic_core_schema__(self, _source: Any, _handler: GetCoreSchemaHandler) -> CoreSchema:
        inner = core_schema.int_schema(strict=True, ge=self.ge, le=self.le)
        return core_schema.no_info_before_validator_function(_whole_from_text, inner)

    def __get_pydantic_json_schema__(
        self, _schema: CoreSchema, _handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        limits = {"minimum": self.ge, "maximum": self.le}
        return {"type": "integer", **{name: value for name, value in limits.items() if value is not None}}


_EXPRESSION: JsonSchemaValue = {"type": "string", "description": 'an expression such as "-pi/2" or "25*deg"'}


def _from_text(value: Any) -> Any:
    if isinstance(value, bool):
        raise ValueError("a number is needed")
    return evaluate(value) if isinstance(value, str) else value


def _whole_from_text(value: Any) -> Any:
    value = _from_text(value)
    return int(value) if isinstance(value, float) and value.is_integer() else value


Real = Annotated[float, Quantity()]
Positive = Annotated[float, Quantity(gt=0.0)]
NotNegative = Annotated[float, Quantity(ge=0.0)]
Angle = Annotated[float, Quantity(ge=-2.0 * math.pi, le=2.0 * math.pi)]
# Nothing that an arm or its measurement frame has is longer, in metres; larger numbers are slips.
Length = Annotated[float, Quantity(ge=-1e7, le=1e7)]
Whole = Annotated[int, Count()]
Vec3 = tuple[Real, Real, Real]
Place = tuple[Length, Length, Length]
