"""Changes of a Python source, one token or statement at a time, by its syntax tree.

Another comparison, arithmetic or logical operator; a condition negated; a constant or a default changed; min
for max, any for all; a statement deleted: a call, a change of an attribute or an item, `raise`, `break`.
Annotations, decorators, docstrings, texts and their formats are left alone."""

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

from mutants import Mutant

OTHER = {
    "<=": ["<", ">"], ">=": [">", "<"], "<": ["<=", ">="], ">": [">=", "<="], "==": ["!="], "!=": ["=="],
    "in": ["not in"], "not in": ["in"], "is": ["is not"], "is not": ["is"], "and": ["or"], "or": ["and"],
    "+": ["-"], "-": ["+"], "*": ["/"], "/": ["*"], "//": ["/"], "%": ["*"], "**": ["*"],
    "<<": [">>"], ">>": ["<<"], "&": ["|"], "|": ["&"],
    "+=": ["-="], "-=": ["+="], "*=": ["/="], "/=": ["*="], "|=": ["&="], "&=": ["|="],
}  # fmt: skip
# Between two operands: brackets and comments besides. Longer operators are found first.
OPERATOR = re.compile(r"not\s+in\b|is\s+not\b|in\b|is\b|and\b|or\b|\*\*|//|<<|>>|[<>=!+\-*/|&]=|[<>+\-*/%&|]")
NAMES = {"min": "max", "max": "min", "any": "all", "all": "any", "True": "False", "False": "True"}
_FUNCTION = (ast.FunctionDef, ast.AsyncFunctionDef)
_OPPOSITE = (ast.Eq, ast.NotEq, ast.In, ast.NotIn, ast.Is, ast.IsNot)


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.JoinedStr) or (
        isinstance(node, ast.Constant) and isinstance(node.value, (str, bytes))
    )


@dataclass(frozen=True)
class Place:
    """Where a mutant is. function: "" in the module or in a class; lines: those of its statement, or of the
    function where it is a default of it; empty outside of functions; loaded: whether it is run when the
    module is loaded."""

    function: str
    lines: tuple[int, ...]
    loaded: bool


class Source:
    """A module's text with its syntax tree, and where each node begins and ends in it."""

    def __init__(self, path: str, text: str) -> None:
        self.path, self.text, self.tree = path, text, ast.parse(text)
        self.lines = text.splitlines(keepends=True)
        self.used = set(self._called(self.tree))  # names of functions that run when the module is loaded
        self.begin = [0]
        for line in self.lines:
            self.begin.append(self.begin[-1] + len(line))

    def at(self, line: int, column: int) -> int:
        """Characters before a place; columns of the tree count bytes."""
        return self.begin[line - 1] + len(self.lines[line - 1].encode()[:column].decode())

    def start(self, node: ast.expr | ast.stmt) -> int:
        return self.at(node.lineno, node.col_offset)

    def end(self, node: ast.expr | ast.stmt) -> int:
        return self.at(node.end_lineno or node.lineno, node.end_col_offset or 0)

    def of(self, node: ast.expr | ast.stmt) -> str:
        return self.text[self.start(node) : self.end(node)]

    def changes(self) -> list[tuple[Mutant, Place]]:
        """Every mutant, in the order of the text."""
        return [
            (Mutant(self.path, start, end, text), place)
            for start, end, text, place in self._block(self.tree.body, Place("", (), True))
        ]

    @cached_property
    def _said(self) -> str:
        return ast.dump(self.tree)

    def differs(self, mutant: Mutant) -> bool:
        """Whether it can be loaded and says something else."""
        try:
            return ast.dump(ast.parse(mutant.of(self.text))) != self._said
        except SyntaxError:
            return False

    def _called(self, node: ast.AST) -> Iterator[str]:
        """Names that are called, or decorate, outside of functions."""
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.Call) and isinstance(child.func, ast.Name):
                yield child.func.id
            if isinstance(child, _FUNCTION):
                for decorator in child.decorator_list:
                    yield from [decorator.id] if isinstance(decorator, ast.Name) else []
                    yield from self._called(ast.Expression(decorator))
            elif not isinstance(child, ast.Lambda):
                yield from self._called(child)

    def _block(self, body: list[ast.stmt], place: Place) -> Iterator[tuple[int, int, str, Place]]:
        for node in body:
            for start, end, text in self._statement(node):
                yield start, end, text, self._place(node, place)
            if isinstance(node, _FUNCTION):
                if any(ast.unparse(d) == "overload" for d in node.decorator_list):
                    continue
                name = f"{place.function}.{node.name}".lstrip(".")
                lines = tuple(range(node.body[0].lineno, (node.end_lineno or 0) + 1))
                inside = Place(name, lines, place.loaded and bool(place.function) or node.name in self.used)
                default_of = Place(name, lines, True)
                for default in (*node.args.defaults, *node.args.kw_defaults):
                    if default is not None:
                        yield from ((*change, default_of) for change in self._default(default))
                yield from self._block(node.body, inside)
            elif isinstance(node, ast.ClassDef):
                yield from self._block(node.body, place)
            elif isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
                continue
            else:
                for name in ("body", "orelse", "finalbody"):
                    yield from self._block(getattr(node, name, []), place)
                for handler in getattr(node, "handlers", []):
                    yield from self._block(handler.body, place)

    def _place(self, node: ast.stmt, place: Place) -> Place:
        """Of what stands in a statement, without the statements inside."""
        if not place.function:
            return place
        inner = getattr(node, "body", None)
        last = inner[0].lineno if isinstance(inner, list) and inner else (node.end_lineno or node.lineno) + 1
        return Place(place.function, tuple(range(node.lineno, max(last, node.lineno + 1))), place.loaded)

    def _statement(self, node: ast.stmt) -> Iterator[tuple[int, int, str]]:
        """Changes in a statement, but for those in the statements inside."""
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            return  # a docstring
        if isinstance(node, (*_FUNCTION, ast.ClassDef, ast.Import, ast.ImportFrom)):
            return
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            return
        if self._deletable(node):
            yield self.start(node), self.end(node), "pass"
        if isinstance(node, (ast.If, ast.While)):
            yield from self._negated(node.test)
        if isinstance(node, ast.AugAssign):
            yield from self._between([node.target, node.value])
        for child in ast.iter_child_nodes(node):
            if isinstance(node, ast.AnnAssign) and child is node.annotation:
                continue
            if isinstance(child, (ast.expr, ast.withitem)):
                yield from self._expression(child)

    @staticmethod
    def _deletable(node: ast.stmt) -> bool:
        if isinstance(node, ast.Assign):
            return not any(isinstance(t, (ast.Name, ast.Tuple)) for t in node.targets)
        return isinstance(node, (ast.Expr, ast.AugAssign, ast.Raise, ast.Break, ast.Continue, ast.Delete))

    def _negated(self, test: ast.expr) -> Iterator[tuple[int, int, str]]:
        """Not where another change of it says the same."""
        opposite = isinstance(test, ast.UnaryOp) and isinstance(test.op, ast.Not)
        opposite |= isinstance(test, ast.Compare) and isinstance(test.ops[0], _OPPOSITE)
        if not opposite:
            yield self.start(test), self.end(test), f"not ({self.of(test)})"

    def _expression(self, node: ast.AST) -> Iterator[tuple[int, int, str]]:
        if isinstance(node, ast.JoinedStr):
            return  # a text; and its places are not right before Python 3.12
        if isinstance(node, ast.Compare):
            yield from self._between([node.left, *node.comparators])
        elif isinstance(node, ast.BoolOp):
            yield from self._between(node.values)
        elif isinstance(node, ast.BinOp) and not any(map(_is_text, (node.left, node.right))):
            yield from self._between([node.left, node.right])
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.Not, ast.USub)):
            sign = "not " if isinstance(node.op, ast.Not) else "-"  # what it stands before may begin with (
            yield self.start(node), self.start(node) + len(sign), ""
        elif isinstance(node, ast.IfExp):
            yield from self._negated(node.test)
        elif isinstance(node, ast.comprehension):
            for test in node.ifs:
                yield from self._negated(test)
        elif isinstance(node, ast.Name) and node.id in NAMES:
            yield self.start(node), self.end(node), NAMES[node.id]
        elif isinstance(node, ast.Constant):
            yield from self._constant(node)
        for child in ast.iter_child_nodes(node):
            yield from self._expression(child)

    def _between(self, operands: list[ast.expr]) -> Iterator[tuple[int, int, str]]:
        for left, right in zip(operands, operands[1:], strict=False):
            at = self.end(left)
            gap = re.sub(r"#[^\n]*", lambda m: " " * len(m[0]), self.text[at : self.start(right)])
            if found := OPERATOR.search(gap):
                for other in OTHER.get(" ".join(found[0].split()), []):
                    yield at + found.start(), at + found.end(), other

    def _constant(self, node: ast.Constant) -> Iterator[tuple[int, int, str]]:
        value, old = node.value, self.of(node)
        if isinstance(value, bool):
            yield self.start(node), self.end(node), NAMES[old]
        elif isinstance(value, int):
            yield self.start(node), self.end(node), f"({old} - 1)" if value else "1"
        elif isinstance(value, float):
            yield self.start(node), self.end(node), f"({old} * 1.5)" if value else "1.0"

    def _default(self, node: ast.expr) -> Iterator[tuple[int, int, str]]:
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield self.start(node), self.end(node), '"mutant"' if node.value == "" else '""'
        yield from self._expression(node)
