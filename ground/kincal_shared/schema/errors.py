"""What is wrong with a file, for the person who wrote it: where, what, the nearest known name, what to write.

Paths are those of the file: `joint[3].alpha_rad` is alpha_rad of the third [[joint]]. Entries of lists count
from 1.
"""

from __future__ import annotations

import difflib
import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pydantic

from kincal_shared.errors import BadInput
from kincal_shared.reading import file_bytes

from .base import (
    Model,
    Strict,
    annotation_of,
    choices_of,
    fixed_length,
    has_key,
    item_annotation,
    keys_of,
    model_of,
    toml_text,
)
from .suggestions import instead

_SHOWN_LINE = 200  # bytes of a line that an error shows
_FEW_ZEROS = 0.1  # of the bytes that hold the letters of a text in UTF-16
_LEAST_LETTERS = 0.6  # of the bytes of a line: fewer plain ones are no text of Windows


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong: path of the key, what is wrong, what to write instead ("" if obvious).

    right: path of the key that an unknown one stands for, "" if none is near.
    """

    path: str
    what: str
    todo: str = ""
    right: str = ""

    def __str__(self) -> str:
        text = f"{self.path}: {self.what}" if self.path else self.what
        return f"{text}; {self.todo}" if self.todo else text


class SchemaError(BadInput):
    """A file that cannot be used; `problems` lists all that is wrong with it."""

    def __init__(self, problems: Sequence[Problem], source: str) -> None:
        lines = [str(problem) for problem in problems]
        what = lines[0] if len(lines) == 1 else f"{len(lines)} problems:\n    " + "\n    ".join(lines)
        super().__init__(what, source)
        self.problems = tuple(problems)


class Contradiction(ValueError):
    """Raised by a validator: keys that do not go together, with the key to look at ("" is the table)."""

    def __init__(self, key: str, what: str, todo: str = "") -> None:
        super().__init__(what)
        self.key, self.what, self.todo = key, what, todo


def utf8_text(path: Path) -> str:
    """The text of a file, without byte order marks before it (some programs add one to one that is there).
    BadInput, with the line, if it is in another encoding than UTF-8; OSError if it cannot be read."""
    data = file_bytes(path)
    if wide := _utf16(data):
        raise BadInput(f"the file is in {wide.upper()}, UTF-8 is needed", str(path), _convert(path, wide))
    try:
        return data.decode("utf-8").lstrip("\ufeff")
    except UnicodeDecodeError as error:
        raise _other_encoding(data, error.start, path) from None


def _other_encoding(data: bytes, at: int, path: Path) -> BadInput:
    """What to say of a file that is no UTF-8 text at a byte: text of Windows, or no text at all."""
    begin, number = data.rfind(b"\n", 0, at) + 1, data.count(b"\n", 0, at) + 1
    what = f"line {number} holds the byte 0x{data[at]:02x}: no UTF-8 text"
    line = data[begin:].partition(b"\n")[0][:_SHOWN_LINE]
    if sum(32 <= byte < 127 for byte in line) < _LEAST_LETTERS * len(line):
        return BadInput(f"{what}, and it does not look like text", str(path), "name a text file")
    what += f"; in Windows-1252 the line reads: {line.decode('cp1252', 'replace').strip()}"
    return BadInput(what, str(path), _convert(path, "cp1252"))


def _utf16(data: bytes) -> str:
    """What iconv calls the encoding of a text in UTF-16, with or without a mark; empty for another."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    start = data[:_SHOWN_LINE]
    zeros = [start[k::2].count(0) / max(len(start) // 2, 1) for k in (0, 1)]  # at even and odd places
    if min(zeros) > _FEW_ZEROS or max(zeros) < _LEAST_LETTERS:
        return ""
    return "utf-16le" if zeros[1] > zeros[0] else "utf-16be"


def _convert(path: Path, encoding: str) -> str:
    return f"save it as UTF-8, or `iconv -f {encoding} -t utf-8 {path.name} > NEW` and name the new file"


def _not_toml(text: str, why: str) -> tuple[str, str]:
    """What is wrong with a text that is no TOML, and what to do."""
    if not text.lstrip().startswith("<"):
        return f"not valid TOML: {why}", ""
    if "xacro:" in text:
        todo = "`xacro FILE > robot.urdf`, then `kincal arm import robot.urdf -o arm.toml` makes one"
        return "this is a xacro file (XML), a TOML file is needed", todo
    if "<robot" in text:
        return (
            "this is a URDF (XML), a TOML file is needed",
            "`kincal arm import FILE -o arm.toml` makes one of it",
        )
    return "this is XML, a TOML file is needed", ""


def read_toml(path: Path) -> dict[str, Any]:
    """A TOML file as a dict. BadInput if it is missing, unreadable or not TOML."""
    text = ""
    try:
        text = utf8_text(path)
        return tomllib.loads(text)
    except FileNotFoundError:
        raise BadInput("no such file", str(path)) from None
    except IsADirectoryError:
        raise BadInput("this is a directory, a TOML file is needed", str(path)) from None
    except OSError as error:
        raise BadInput(f"cannot be read: {error.strerror}", str(path)) from None
    except (ValueError, RecursionError) as error:
        what, todo = _not_toml(text, _why_no_toml(error))
        raise BadInput(what, str(path), todo) from None


def parse_toml(text: str, source: str) -> dict[str, Any]:
    """TOML text as a dict. BadInput with the source's name if it is not TOML."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise BadInput(f"not valid TOML: {_why_no_toml(error)}", source) from None


def _why_no_toml(error: ValueError | RecursionError) -> str:
    if isinstance(error, RecursionError):
        return "lists or tables are nested too deeply"
    return str(error) if isinstance(error, tomllib.TOMLDecodeError) else "a number has too many digits"


def validate(model: type[Model], doc: dict[str, Any], source: str) -> Model:
    """The typed content of a file. SchemaError with every problem found."""
    try:
        return model.model_validate(doc)
    except pydantic.ValidationError as error:
        raise SchemaError(_problems(model, doc, error), source) from None


# --------------------------------------------------------------------------- from pydantic to people


@dataclass(frozen=True)
class _Place:
    """Where an error is: keys and indices as the file has them, and the model of the table it is in."""

    parts: tuple[str | int, ...]
    model: type[Strict] | None
    length: int = 0  # of the list of fixed length that the last part is an entry of
    choices: tuple[Any, ...] = ()  # values that the last part may take, if they are a few

    @property
    def path(self) -> str:
        """The place as people read it."""
        return path_text(self.parts)

    @property
    def key(self) -> str:
        """The key itself, without its table."""
        return next((part for part in reversed(self.parts) if isinstance(part, str)), "")


def path_text(parts: Sequence[str | int]) -> str:
    """("joint", 2, "a_m") -> "joint[3].a_m"; a key that is no bare TOML key is quoted."""
    text = ""
    for part in parts:
        if isinstance(part, int):
            text += f"[{part + 1}]"
        else:
            bare = part.replace("-", "_").isidentifier() or part.isdigit()
            text += ("." if text else "") + (part if bare else f'"{part}"')
    return text


def _problems(model: type[Strict], doc: dict[str, Any], error: pydantic.ValidationError) -> list[Problem]:
    found: dict[str, Problem] = {}
    for one in error.errors(include_url=False):
        place = _place(model, doc, one["loc"])
        problem = _problem(model, place, one)
        known = found.get(problem.path)
        if known is None:
            found[problem.path] = problem
        elif problem.what not in known.what:  # alternatives of one key
            found[problem.path] = Problem(
                known.path, f"{known.what}, or {problem.what}", known.todo or problem.todo
            )
    inner = {path for path in found for other in found if other.startswith(f"{path}[") and path}
    renamed = {problem.right for problem in found.values() if problem.right}
    return [problem for path, problem in found.items() if path not in inner | renamed]


def _place(root: type[Strict], doc: Any, loc: tuple[int | str, ...]) -> _Place:
    """The error's location without the names that pydantic gives to alternatives."""
    parts: list[str | int] = []
    model: type[Strict] | None = root
    annotation: Any = root
    here: Any = doc
    length = 0
    for number, part in enumerate(loc):
        last = number == len(loc) - 1
        if (
            isinstance(here, dict)
            and isinstance(part, str)
            and (part in here or last or has_key(annotation, part))
        ):
            model = model_of(annotation)
            annotation = annotation_of(model, part) if model else item_annotation(annotation)
            here = here.get(part)
        elif isinstance(here, list) and isinstance(part, int):
            length = fixed_length(annotation)
            annotation = item_annotation(annotation)
            here = here[part] if part < len(here) else None
        else:
            continue
        parts.append(part)
    return _Place(tuple(parts), model, length, tuple(choices_of(annotation)))


_NEEDED = {
    "float_type": "a number is needed",
    "float_parsing": "a number is needed",
    "int_type": "a whole number is needed",
    "int_from_float": "a whole number is needed",
    "bool_type": "true or false is needed",
    "bool_parsing": "true or false is needed",
    "string_type": "a text in quotes is needed",
    "list_type": "a list is needed",
    "tuple_type": "a list is needed",
    "model_type": "a table with keys is needed",
    "model_attributes_type": "a table with keys is needed",
    "dict_type": "a table with keys is needed",
    "finite_number": "a finite number is needed",
    "string_too_short": "a text that is not empty is needed",
}
_LIMITS = {
    "greater_than": ("gt", "must be above {}"),
    "greater_than_equal": ("ge", "must be {} or more"),
    "less_than": ("lt", "must be below {}"),
    "less_than_equal": ("le", "must be {} or less"),
}


def _problem(root: type[Strict], place: _Place, error: Any) -> Problem:
    kind, got, context = error["type"], error["input"], error.get("ctx", {})
    if kind == "missing":
        return _missing(place, got)
    if kind == "extra_forbidden":
        right, todo = instead(root, place.model, place.key, got)
        return Problem(
            place.path, "unknown key", todo, path_text([*place.parts[:-1], right]) if right else ""
        )
    if kind == "literal_error":
        return _not_one_of(place, got)
    if kind in _NEEDED:
        return Problem(place.path, f"is {toml_text(got)}, {_NEEDED[kind]}", _unquoted(kind, got))
    if kind in _LIMITS:
        limit, text = _LIMITS[kind]
        return Problem(
            place.path, f"is {toml_text(got)}, " + text.format(f"{context[limit]:g}"), _degrees(place, got)
        )
    if kind == "too_long":
        return Problem(place.path, f"has {len(got)} entries, there is room for {context['max_length']}")
    if kind == "too_short":
        return Problem(place.path, f"has {len(got)} entries, at least {context['min_length']} are needed")
    if kind == "string_pattern_mismatch":
        return Problem(place.path, f"is {toml_text(got)}, which has another form", _like(root, place))
    return _said_by_a_validator(place, error)


def _like(root: type[Strict], place: _Place) -> str:
    """How the key is written that an entry belongs to."""
    key = str(place.parts[0])
    field = keys_of(root).get(key)
    return f"write it as in {_example(key, field.examples[0])}" if field and field.examples else ""


def _said_by_a_validator(place: _Place, error: Any) -> Problem:
    cause = error.get("ctx", {}).get("error")
    if isinstance(cause, Contradiction):
        path = ".".join(part for part in (place.path, cause.key) if part)
        return Problem(path.replace(".[", "["), cause.what, cause.todo)
    return Problem(place.path, error["msg"].removeprefix("Value error, "))


def _missing(place: _Place, got: Any) -> Problem:
    if isinstance(place.parts[-1], int):  # an entry of a list of fixed length
        size = len(got) if isinstance(got, (list, tuple)) else 0
        return Problem(path_text(place.parts[:-1]), f"has {size} entries, {place.length} are needed")
    field = keys_of(place.model).get(place.key) if place.model else None
    choices = choices_of(field.annotation) if field else []
    if choices:
        todo = "write " + " or ".join(f"{place.key} = {toml_text(choice)}" for choice in choices)
    elif field and field.examples:
        todo = f"write {_example(place.key, field.examples[0])}"
    elif field and model_of(field.annotation):
        todo = f"write the table [{place.path}]"
    elif field and model_of(item_annotation(field.annotation)):
        todo = f"write a table [[{place.path}]] for each"
    else:
        todo = f"write {place.key} = ..."
    return Problem(place.path, "is missing", todo)


def _example(key: str, example: Any) -> str:
    said = isinstance(example, str) and ("=" in example or "[[" in example)  # how it is written, in words
    return str(example) if said else f"{key} = {toml_text(example)}"


def _not_one_of(place: _Place, got: Any) -> Problem:
    near = difflib.get_close_matches(str(got), [str(c) for c in place.choices], 1, 0.6)
    todo = "write " + " or ".join(toml_text(c) for c in place.choices)
    return Problem(
        place.path, f"is {toml_text(got)}", todo + (f"; nearest is {toml_text(near[0])}" if near else "")
    )


def _unquoted(kind: str, got: Any) -> str:
    if isinstance(got, str) and kind.startswith("bool") and got.lower() in ("true", "false"):
        return f"write {got.lower()} without quotes"
    return ""


def _degrees(place: _Place, got: Any) -> str:
    """Radians that are more than a turn were meant as degrees."""
    if place.key.endswith("_rad") and isinstance(got, (int, float)) and abs(got) > math.pi:
        return f"in radians, {got:g} degrees are {math.radians(got):.6g}"
    return ""
