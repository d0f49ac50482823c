"""An effect of one's own as a form: its keys, checked by the grammar of terms, errors at their fields."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from kincal.workbench.model.effects import Library
from kincal_shared.errors import BadInput
from kincal_shared.schema.effects import EffectEntry, EffectsFile, ParameterEntry
from kincal_shared.schema.errors import SchemaError, validate
from kincal_shared.schema.files import texts_under_keys
from kincal_shared.schema.terms import TermEntry

TERMS = 3
_EFFECT, _PARAMETER, _TERM = (
    ("name", "title", "formula"),
    ("name", "unit", "sigma"),
    ("at", "comp", "gain", "basis"),
)
_PER = ("arm", "joint", "pair")
_AN_EXAMPLE = {
    "effect.name": "odd_coupling", "effect.formula": "dq_3 = k tanh(q4) cos(q6)", "effect.per": "arm",
    "parameter.name": "k", "parameter.unit": "rad", "parameter.sigma": "5e-3",
    "term1.at": "joint[3]", "term1.basis": "tanh(q4) * cos(q6)",
}  # fmt: skip
_FIELD = re.compile(r"^effect\[1\]\.?(parameter)?(?:\[1\])?\.?(?:term\[(\d)\])?\.?(\w*)")
Plain = dict[str, Any]


def sections() -> list[Plain]:
    """The form, with an effect of ten lines to begin with (docs/EFFECTS.md)."""

    def fields(prefix: str, keys: tuple[str, ...], model: type) -> list[Plain]:
        about = texts_under_keys(model)
        rows = [
            {"path": f"{prefix}.{key}", "key": key, "unit": "", "long": False,
             "about": " ".join(about.get(key, "").split()), "text": _AN_EXAMPLE.get(f"{prefix}.{key}", "")}
            for key in keys
        ]  # fmt: skip
        return [row | {"choices": list(_PER)} if row["key"] == "per" else row for row in rows]

    return [
        {"title": "Effect", "about": "", "fields": fields("effect", (*_EFFECT, "per"), EffectEntry)},
        {"title": "Coefficient", "about": "", "fields": fields("parameter", _PARAMETER, ParameterEntry)},
        *({"title": f"Term {n}", "about": "" if n == 1 else "may be left empty",
           "fields": fields(f"term{n}", _TERM, TermEntry)} for n in range(1, TERMS + 1)),
    ]  # fmt: skip


def checked(values: Mapping[str, str]) -> tuple[Plain, list[Plain]]:
    """The effect as a file holds it, and what is wrong with it: field, text."""
    known = {field["path"] for section in sections() for field in section["fields"]}
    if not set(values) <= known or not all(isinstance(x, str) and len(x) < 500 for x in values.values()):
        raise BadInput("these are no values of an effect")
    given = {path: text.strip() for path, text in values.items() if text.strip()}

    def table(prefix: str, keys: tuple[str, ...]) -> Plain:
        return {key: _value(key, given[f"{prefix}.{key}"]) for key in keys if f"{prefix}.{key}" in given}

    numbers = [n for n in range(1, TERMS + 1) if table(f"term{n}", _TERM)]
    parameter = table("parameter", _PARAMETER) | {"term": [table(f"term{n}", _TERM) for n in numbers]}
    effect = table("effect", (*_EFFECT, "per")) | {"parameter": [parameter]}
    doc = {"effect": [effect]}
    try:
        validate(EffectsFile, doc, "own effect")
    except SchemaError as error:
        return doc, [{"path": p.path, "field": _field(p.path, numbers), "text": _words(p.what, p.todo)}
                     for p in error.problems]  # fmt: skip
    return doc, []


def keep(folder: Path, doc: Plain) -> tuple[str, list[Plain]]:
    """Write a checked effect into a folder, as a library that `--effects FILE` takes; its name, and what is
    wrong if the name is taken by an effect that ships."""
    effect = doc["effect"][0]
    name = str(effect["name"])
    if name in Library.load().effects:
        return name, [
            {"path": "effect[1].name", "field": "effect.name", "text": f"{name} is an effect that ships"}
        ]
    folder.mkdir(parents=True, exist_ok=True)
    part = folder / f"{name}.part"
    part.write_text(_toml(effect), "utf-8")
    part.replace(folder / f"{name}.toml")
    return name, []


def libraries(folder: Path) -> list[Path]:
    """Files of the effects of one's own."""
    return sorted(folder.glob("*.toml"))


def _value(key: str, text: str) -> Any:
    if key not in ("sigma", "gain"):
        return text
    try:
        return float(text)
    except ValueError:
        return text  # an expression, or for the model to refuse


def _field(path: str, numbers: list[int]) -> str:
    """Field of the form that a path of the file belongs to."""
    found = _FIELD.match(path)
    if found is None:
        return ""
    inside, term, key = found.groups()
    if term:
        return f"term{numbers[int(term) - 1]}.{key or 'at'}"
    if key == "term":
        return "term1.at"
    return f"{'parameter' if inside else 'effect'}.{key or 'name'}"


def _words(what: str, todo: str) -> str:
    return f"{what}; {todo}" if todo else what


def _toml(effect: Plain) -> str:
    parameter = effect["parameter"][0]
    lines = ["[[effect]]", *_pairs(effect), "[[effect.parameter]]", *_pairs(parameter)]
    for term in parameter["term"]:
        lines += ["[[effect.parameter.term]]", *_pairs(term)]
    return "\n".join(lines) + "\n"


def _pairs(table: Plain) -> list[str]:
    return [f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in table.items()
            if not isinstance(value, list)]  # fmt: skip
