"""Layout of the flight tables, for docs/TABLES.md: read from the C source that walks them
(fsw/tables/kc_layout.c, kc_config.c).

Fields, order, types and limits are what the source calls. A comment behind a call, or on the line before it,
is the note of the field. Values of constants come from the flight core."""

from __future__ import annotations

import ast
import operator
import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

TABLES = Path(__file__).resolve().parent.parent / "fsw/tables"
# The bit set of the segments has no range, and so no call with a number.
BIT_SET = ("18", "edge", "u8[n_edge]")
TYPES = {"name": "char[24]", "count": "u32"}
TOKEN = re.compile(
    r"(?P<comment>/\*.*?\*/)"
    r"|for \(uint32_t \w+ = 0u; \w+ < (?P<bound>[^;]+);[^)]*\) (?=\{)"
    r"|(?:(?P<variable>\w+) = )?kc_walk_(?P<kind>\w+)\(w, (?P<values>[^;]*)\);"
    r"|\b(?P<function>walk_\w+)\(w, (?P<arguments>[^;]*)\);"
    r"|kc_\w+_t \*(?P<alias>\w+) = &\w+->(?P<array>\w+)\["
    r"|(?P<open>\{)|(?P<close>\})",
    re.S,
)
OPERATORS: dict[type[ast.operator], Callable[[int, int], int]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.LShift: operator.lshift,
}
FUNCTION = re.compile(r"^(?:static )?void (\w+)\([^)]*\)\n\{\n(.*?)^\}", re.M | re.S)
DEFINE = re.compile(r"^#define (\w+) (.*?)(?: /\*.*)?$", re.M)


@dataclass(frozen=True)
class Row:
    """A field of a table, as the page says it."""

    number: str
    name: str
    type: str
    limits: str = ""
    note: str = ""


@dataclass
class Block:
    """Fields that are stored `count` times; the outermost block is the table (count "")."""

    count: str
    array: str = ""
    rows: list[Row | Block] = field(default_factory=list)


class Source:
    """The C source of the walks: functions and #defines by name."""

    def __init__(self, text: str) -> None:
        self.functions = dict(FUNCTION.findall(text))
        self.defines = dict(DEFINE.findall(text))

    def table(self, kind: str) -> Block:
        """Layout of a table kind, by the switch of kc_layout_walk. SystemExit when it has none."""
        found = re.search(rf"case KC_TBL_{kind}: (\w+)\(", self.functions["kc_layout_walk"])
        if found is None:
            raise SystemExit(f"kc_layout_walk does not know {kind}")
        table = Block("")
        self._body(found[1], table, {})
        return table

    def _body(self, function: str, into: Block, counts: dict[str, str]) -> None:
        """Rows of a function. counts: variable -> field that it was read from."""
        text = self.functions[function]
        blocks, bound, end, before = [into], "", None, ""
        for token in TOKEN.finditer(text):
            block = blocks[-1]
            if token["comment"]:
                behind = end is not None and "\n" not in text[end : token.start()]
                if behind:
                    self._note(block, token["comment"])
                before = "" if behind else token["comment"]
                continue
            if token["bound"]:
                bound = counts.get(token["bound"], self._size(token["bound"]))
            elif token["open"]:
                blocks.append(Block(bound))
                bound = ""
            elif token["close"]:
                self._close(blocks.pop(), blocks[-1])
            elif token["alias"]:
                block.array = token["array"]
            elif token["function"] == "walk_point":  # three numbers, and no name of its own
                number, value = token["arguments"].split(", ")
                block.rows.append(Row(number.rstrip("u"), _name(value)[1], "f32[3]", self._point_limits()))
            elif token["function"]:
                if array := re.search(r"&\w+->(\w+)\[", token["arguments"]):
                    block.array = array[1]
                self._body(token["function"], block, counts)
            elif token["kind"] and token["kind"] != "rule":
                self._field(token, block, counts)
            if token["kind"] or token["function"]:
                if before and token["kind"] != "rule":
                    self._note(block, before)
                end = token.end()
            before = ""

    def _field(self, token: re.Match[str], block: Block, counts: dict[str, str]) -> None:
        kind, values = token["kind"], re.split(r",\s+", token["values"])
        if kind == "raw":
            block.rows.append(Row(*BIT_SET))
            return
        array, name = _name(values[1])
        if array:
            block.array = array
        if token["variable"]:
            counts[token["variable"]] = name
        limits = f"{self._value(values[-2])} .. {self._value(values[-1])}" if len(values) > 3 else ""
        type_ = TYPES.get(kind, kind)
        if kind == "vec":
            type_ = f"f64[{counts.get(values[2], self._size(values[2]))}]"
        block.rows.append(Row(values[0].rstrip("u"), name, type_, limits))

    def _point_limits(self) -> str:
        values = re.search(r"kc_walk_f32\(w, field, [^,]*, (.*?), (.*?)\);", self.functions["walk_point"])
        return f"{self._value(values[1])} .. {self._value(values[2])}" if values else ""

    @staticmethod
    def _note(block: Block, comment: str) -> None:
        """A comment behind the call of a field, or on the line before it, is its note."""
        last = block.rows[-1] if block.rows else None
        if isinstance(last, Row) and not last.note:
            block.rows[-1] = replace(last, note=" ".join(re.sub(r"\n *\*", "", comment[2:-2]).split()))

    @staticmethod
    def _close(block: Block, outer: Block) -> None:
        """A loop over one number of single precision is a vector; a block that is no loop is no block."""
        only = block.rows[0] if len(block.rows) == 1 else None
        if isinstance(only, Row) and only.type == "f32" and block.count:
            outer.rows.append(replace(only, type=f"f32[{block.count}]"))
        elif block.count and block.rows:
            outer.rows.append(block)
        else:
            outer.rows += block.rows

    @staticmethod
    def _size(text: str) -> str:
        """Number of repeats: a literal, or the count that a parameter or a member is named after."""
        return text.split("->")[-1].removesuffix("u")

    def _value(self, text: str) -> str:
        """A limit as the page writes it: decimals as in the source, whole numbers worked out."""
        text = re.sub(r"\(uint\d+_t\)", "", text)
        sign, name = ("-", text[1:]) if text.startswith("-") else ("", text)
        if name in self.defines:
            return sign + self._value(self.defines[name])
        if re.fullmatch(r"[\d.]+(e-?\d+)?", name):
            return sign + name.removesuffix(".0")
        return str(self._whole(ast.parse(re.sub(r"\b(\w+?)u(ll)?\b", r"\1", text), mode="eval").body))

    def _whole(self, node: ast.expr) -> int:
        from kincal.flight import library

        match node:
            case ast.Constant(value=int() as number):
                return int(number)
            case ast.Name(id=name) if limit := re.fullmatch(r"UINT(\d+)_MAX", name):
                return 2 ** int(limit[1]) - 1
            case ast.Name(id=name) if name in self.defines:
                return int(self._value(self.defines[name]))
            case ast.Name(id=name):
                return library("flight").constant(name)
            case ast.BinOp(left=left, op=op, right=right) if type(op) in OPERATORS:
                work = OPERATORS[type(op)]
                return work(self._whole(left), self._whole(right))
        raise SystemExit(f"limit of a table: cannot read {ast.unparse(node)}")


def _name(value: str) -> tuple[str, str]:
    """(array of structs, field) of an argument: `&t->basis[b].fn` is ("basis", "fn"), `&c->servo.gain`
    ("", "servo.gain"), `&k->value[i]` ("", "value")."""
    member = value.split("->", 1)[1]
    if found := re.fullmatch(r"(\w+)\[\w+\]\.(\w+)", member):
        return found[1], found[2]
    return "", member.split("[")[0]


def markdown(block: Block) -> list[str]:
    """Rows of the page's table."""
    out: list[str] = []
    for row in block.rows:
        if isinstance(row, Row):
            cells = (row.number, row.name, row.type, row.limits, row.note)
            out.append("|" + "|".join(f" {cell} " if cell else " " for cell in cells) + "|")
        else:
            array = f"`{row.array}` " if row.array else ""
            out += [f"| | repeat {row.count} | | | {array}|", *markdown(row), "| | end | | | |"]
    return out


def page_table(kind: str) -> str:
    """The layout of a table kind ("CONFIG") in Markdown."""
    source = Source("".join((TABLES / name).read_text("utf-8") for name in ("kc_layout.c", "kc_config.c")))
    head = ["| field | name | type | limits | |", "|---:|---|---|---|---|"]
    return "\n".join(head + markdown(source.table(kind)))
