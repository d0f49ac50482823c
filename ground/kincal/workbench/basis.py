"""The small language of bases: "q3", "sin(2*q[j])", "tanh(tau[j]/0.5)", "temp-20", "zcam * r2".

A basis is fn(z) with z = c1 (x - c0) of one variable x, the same form flight evaluates
(fsw/model/kc_terms.h); a term holds the product of at most two.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from kincal.errors import BadInput

FUNCTIONS = {
    "lin": 0,
    "sin": 1,
    "cos": 2,
    "tanh": 3,
    "ln1p": 4,
    "expn": 5,
    "step": 6,
    "sq": 7,
    "tan2": 8,
    "abs": 9,
}
# name: (number of kc_var_t, takes an index)
VARIABLES = {
    "1": (0, False),
    "q": (1, True),
    "tau": (2, True),
    "Mx": (3, True),
    "My": (4, True),
    "Mz": (5, True),
    "dir": (6, True),
    "temp": (7, False),
    "t": (8, False),
    "payload": (9, False),
    "range": (10, False),
    "incid": (11, False),
    "u": (12, False),
    "v": (13, False),
    "r2": (14, False),
    "pan": (15, False),
    "tilt": (16, False),
    "qdot": (17, True),
    "taup": (18, True),
    "xcam": (19, False),
    "ycam": (20, False),
    "zcam": (21, False),
    "tag": (22, False),
    # Without camera columns the sensor is the measurement frame itself (a laser tracker, a board):
    # the position it saw, by the same variables.
    "sx": (19, False),
    "sy": (20, False),
    "sz": (21, False),
}
# What the data or the arm table must hold for a variable.
NEEDS = {
    "tau": "mass",
    "Mx": "mass",
    "My": "mass",
    "Mz": "mass",
    "dir": "dir",
    "temp": "temp_c",
    "t": "t_s",
    "payload": "payload_kg",
    "taup": "payload_kg",
    "range": "range_m",
    "incid": "incid_rad",
    "u": "image",
    "v": "image",
    "r2": "image",
    "pan": "pan_rad",
    "tilt": "tilt_rad",
    "qdot": "qdot",
    "xcam": "cam",
    "ycam": "cam",
    "zcam": "cam",
    "tag": "tag",
    "sx": "own_sensor",
    "sy": "own_sensor",
    "sz": "own_sensor",
}
_NUM = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|\$\w+|N"
_VAR = re.compile(r"^(r2|[A-Za-z]+)(?:\[(\w+)\]|(\d))?$")
_ARG = re.compile(
    rf"^(?:(?P<scale>{_NUM})\s*\*\s*)?\(?\s*(?P<var>[A-Za-z]+\d?(?:\[\w+\])?|1)"
    rf"\s*(?:(?P<sign>[-+])\s*(?P<offset>{_NUM}))?\s*\)?\s*(?:/\s*(?P<div>{_NUM}))?$"
)


@dataclass(frozen=True)
class Basis:
    """fn(c1 (x - c0)) of variable `var` with joint or link `index` (0 where it has none)."""

    fn: str
    var: str
    index: int
    c0: float = 0.0
    c1: float = 1.0

    @property
    def fn_number(self) -> int:
        return FUNCTIONS[self.fn]

    @property
    def var_number(self) -> int:
        return VARIABLES[self.var][0]

    @property
    def need(self) -> str | None:
        return NEEDS.get(self.var)

    def __str__(self) -> str:
        name = self.var + (str(self.index) if VARIABLES[self.var][1] else "")
        if self.var == "1":
            return "1"
        arg = name
        if self.c0:
            arg = f"{arg}{-self.c0:+.6g}"
            if self.c1 != 1.0:
                arg = f"({arg})"
        if self.c1 != 1.0:
            arg = f"{self.c1:.6g}*{arg}"
        return arg if self.fn == "lin" else f"{self.fn}({arg})"


ONE = Basis("lin", "1", 0)


def split_product(text: str) -> list[str]:
    """Factors of a product: split at '*' between two bases, not inside parentheses and not after a number."""
    factors, depth, start = [], 0, 0
    for i, char in enumerate(text):
        depth += {"(": 1, ")": -1}.get(char, 0)
        if char == "*" and depth == 0 and not re.fullmatch(rf"\s*(?:{_NUM})\s*", text[start:i]):
            factors.append(text[start:i])
            start = i + 1
    factors.append(text[start:])
    return [factor.strip() for factor in factors]


def parse_basis(text: str, names: dict[str, float], where: str) -> tuple[Basis, Basis]:
    """Parse "b" or "b * b". `names` gives $constants, N, and the joint letters i, j.

    BadInput says what could not be read and what is allowed.
    """
    factors = split_product(text)
    if len(factors) > 2:
        raise BadInput(f"{where}: basis {text!r} has {len(factors)} factors, at most two are possible")
    parsed = [_parse_one(factor, names, where) for factor in factors]
    return parsed[0], parsed[1] if len(parsed) == 2 else ONE


def _parse_one(text: str, names: dict[str, float], where: str) -> Basis:
    fn, body = "lin", text
    match = re.fullmatch(r"([a-z0-9]+)\((.*)\)", text)
    if match and match.group(1) in FUNCTIONS:
        fn, body = match.group(1), match.group(2).strip()
    elif match:
        raise BadInput(f"{where}: {match.group(1)!r} is no function; there are {', '.join(FUNCTIONS)}")
    match = _ARG.fullmatch(body)
    if not match:
        raise BadInput(f'{where}: cannot read basis {text!r}; write for instance "sin(2*q3)" or "temp-20"')
    var_text = match.group("var")
    var, index = _variable(var_text, names, where)

    def number(key: str, default: float) -> float:
        token = match.group(key)
        if token is None:
            return default
        if token.startswith("$") or token == "N":
            if token.lstrip("$") not in names:
                raise BadInput(f"{where}: basis {text!r} uses {token}, which has no value here")
            return names[token.lstrip("$")]
        return float(token)

    offset = number("offset", 0.0) * (-1.0 if match.group("sign") == "+" else 1.0)
    scale = number("scale", 1.0) / number("div", 1.0)
    inner = "(" in body
    if offset and scale != 1.0 and not inner:
        # 2*q-1 means 2 (q - 0.5): the offset is in units of the variable.
        offset = offset / number("scale", 1.0)
    return Basis(fn, var, index, offset, scale)


def _variable(text: str, names: dict[str, float], where: str) -> tuple[str, int]:
    if text in VARIABLES and not VARIABLES[text][1]:
        return text, 0
    match = _VAR.match(text)
    name, letter, digit = match.groups() if match else (text, None, None)
    if name not in VARIABLES:
        raise BadInput(f"{where}: {text!r} is no variable; there are {', '.join(VARIABLES)}")
    if not VARIABLES[name][1]:
        raise BadInput(f"{where}: variable {name} has no index")
    token = letter or digit
    if token is None:
        raise BadInput(f"{where}: variable {name} needs a joint, for instance {name}[j] or {name}3")
    if token.isdigit():
        return name, int(token)
    if token not in names:
        raise BadInput(f"{where}: {text!r}: no joint {token!r} here; write the number or j")
    return name, int(names[token])
