"""The description of a search space as a form: its values as the file writes them, what each is, and what is
wrong with it, at its field."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic.fields import FieldInfo

from kincal_shared.errors import BadInput
from kincal_shared.schema.base import Strict, keys_of, model_of, toml_text
from kincal_shared.schema.edit import as_value, changed, value_text
from kincal_shared.schema.errors import Problem, SchemaError, parse_toml, validate
from kincal_shared.schema.files import texts_under_keys
from kincal_shared.schema.space import Description

# lists of tables and of pairs: they describe the arm and the lander, and are edited in the file
NOT_HERE = ("kind", "provenance", "shape", "keep_out", "collision_exclusions")
_UNIT = re.compile(r"\s*\[([^\]]+)\]\.?$")
_LONG = 60
Plain = dict[str, Any]


class Form:
    """file: the description, edited in place."""

    def __init__(self, file: Path) -> None:
        self.file = file

    def sections(self) -> list[Plain]:
        """Tables of the description with their fields."""
        text = self.file.read_text("utf-8")
        out = [{"title": "Search", "about": "", "fields": list(_fields(Description, "", text))}]
        about = texts_under_keys(Description)
        for key, field in keys_of(Description).items():
            model = None if key in NOT_HERE else model_of(field.annotation)
            if model is not None:
                fields = list(_fields(model, f"{key}.", text))
                out.append({"title": key, "about": about.get(key, ""), "fields": fields})
        return out

    def problems(self) -> list[Plain]:
        """What is wrong with the file as it is."""
        return _said(_wrong(self.file.read_text("utf-8"), str(self.file)))

    def change(self, values: Mapping[str, str]) -> list[Plain]:
        """Take these values (path -> as typed), all or none: what is wrong, each with the path of its field;
        empty if they were taken."""
        known = {field["path"] for section in self.sections() for field in section["fields"]}
        text, bad = self.file.read_text("utf-8"), []
        for path, typed in values.items():
            if path not in known:
                raise BadInput(f"there is no field {path[:80]}")
            if not typed.strip():
                bad.append(Problem(path, "is empty"))
                continue
            try:
                text = changed(text, path, as_value(typed))
            except BadInput as error:
                bad.append(Problem(path, error.what, error.todo))
        bad = bad or _wrong(text, str(self.file))
        if not bad:
            part = self.file.with_suffix(".part")
            part.write_text(text, "utf-8")
            part.replace(self.file)
        return _said(bad)


def _fields(model: type[Strict], prefix: str, text: str) -> Iterator[Plain]:
    about = texts_under_keys(model)
    for key, field in keys_of(model).items():
        if key in NOT_HERE or model_of(field.annotation) is not None:
            continue
        words = " ".join(about.get(key, "").split())
        unit = _UNIT.search(words)
        written = value_text(text, prefix + key)
        shown = _default(field) if written is None else written
        yield {
            "path": prefix + key,
            "key": key,
            "unit": unit[1] if unit else "",
            "about": _UNIT.sub(".", words),
            "text": shown,
            "given": written is not None,
            "long": "\n" in shown or len(shown) > _LONG,
        }


def _default(field: FieldInfo) -> str:
    return "" if field.is_required() else toml_text(field.default)


def _wrong(text: str, source: str) -> list[Problem]:
    try:
        validate(Description, parse_toml(text, source), source)
    except SchemaError as error:
        return list(error.problems)
    except BadInput as error:  # somebody edited the file
        return [Problem("", error.what, error.todo)]
    return []


def _said(problems: list[Problem]) -> list[Plain]:
    """field: the path without numbers of entries."""
    return [
        {
            "path": p.path,
            "field": re.sub(r"\[\d+\].*", "", p.path),
            "text": f"{p.path.rpartition('.')[2]} {p.what}".strip() + (f"; {p.todo}" if p.todo else ""),
        }
        for p in problems
    ]
