"""All kinds of files, and their JSON Schema for editors."""

from __future__ import annotations

import ast
import inspect
import json
import textwrap
from itertools import pairwise
from pathlib import Path
from typing import Any

from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core.core_schema import ModelSchema

from kincal_shared.writing import write_files

from .arm import ArmFile
from .base import Strict, model_of
from .campaign import Campaign
from .datamap import DataMap
from .effects import EffectsFile
from .model import ModelEntry
from .scenario import Scenario
from .simulator import OpticsFile, PlantFile
from .space import Description
from .tables import SOURCES

DIALECT = "https://json-schema.org/draft/2020-12/schema"
SUFFIX = ".schema.json"

# name of the schema -> model of the file
FILES: dict[str, type[Strict]] = {
    "arm": ArmFile,
    "campaign": Campaign,
    "data-map": DataMap,
    "effects": EffectsFile,
    "model": ModelEntry,
    "space": Description,
    "scenario": Scenario,
    "simulator-arm": PlantFile,
    "simulator-camera": OpticsFile,
    **{f"table-{kind}": model for kind, model in SOURCES.items()},
}


class _Documented(GenerateJsonSchema):
    """JSON Schema with the text under each key as its description."""

    def model_schema(self, schema: ModelSchema) -> JsonSchemaValue:
        """Schema of one table."""
        found, table = super().model_schema(schema), schema["cls"]
        texts = texts_under_keys(table)
        for name, field in table.model_fields.items():
            kind = model_of(field.annotation)
            if name in texts and (kind is None or texts[name] != kind.__doc__):  # the table says so itself
                found["properties"][field.alias or name]["description"] = texts[name]
        return found


def texts_under_keys(table: type) -> dict[str, str]:
    """By attribute: the string that stands under it in the source of its class."""
    found: dict[str, str] = {}
    for cls in reversed(table.__mro__):
        if issubclass(cls, Strict):
            found |= _texts_in(cls)
    return found


def _texts_in(cls: type) -> dict[str, str]:
    (node,) = ast.parse(textwrap.dedent(inspect.getsource(cls))).body
    assert isinstance(node, ast.ClassDef)
    return {
        key.target.id: inspect.cleandoc(text.value.value)
        for key, text in pairwise(node.body)
        if isinstance(key, ast.AnnAssign)
        and isinstance(key.target, ast.Name)
        and isinstance(text, ast.Expr)
        and isinstance(text.value, ast.Constant)
        and isinstance(text.value.value, str)
    }


def json_schema(name: str) -> str:
    """JSON Schema of one kind of file, as text. KeyError if there is none of that name."""
    model = FILES[name]
    made = model.model_json_schema(schema_generator=_Documented)
    schema = {"$schema": DIALECT, "$id": f"{name}{SUFFIX}", **_without_null(made)}
    return json.dumps(schema, indent=1, ensure_ascii=False) + "\n"


def _without_null(node: Any) -> Any:
    """TOML has no null: a key may be left out instead. Titles that are made of keys say nothing."""
    if isinstance(node, list):
        return [_without_null(item) for item in node]
    if not isinstance(node, dict):
        return node
    cleaned = {key: _without_null(value) for key, value in node.items() if not _is_noise(key, value)}
    kinds = cleaned.get("anyOf")
    if isinstance(kinds, list):
        kinds = [kind for kind in kinds if kind != {"type": "null"}]
        if len(kinds) == 1:
            del cleaned["anyOf"]
            return kinds[0] | cleaned
        cleaned["anyOf"] = kinds
    return cleaned


def _is_noise(key: str, value: Any) -> bool:
    return (key == "title" and isinstance(value, str)) or (key == "default" and value is None)


def write_json_schemas(folder: Path) -> list[Path]:
    """Write the JSON Schema of every kind of file into a folder; the paths, in order of the names."""
    return write_files({folder / f"{name}{SUFFIX}": json_schema(name) for name in sorted(FILES)})
