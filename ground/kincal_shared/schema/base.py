"""What every table of a file is, what its keys are, and how TOML writes a value."""

from __future__ import annotations

import math
from collections.abc import Iterator
from types import UnionType
from typing import Any, ClassVar, Literal, TypeVar, Union, get_args, get_origin

import pydantic
from pydantic.fields import FieldInfo


class Strict(pydantic.BaseModel):
    """A table of a file: only the keys below, frozen; the text under a key is its documentation (read by
    files.py when it is wanted: reading all sources takes longer than everything else at the start)."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    # Names that people write for a key, where no rule finds it.
    SYNONYMS: ClassVar[dict[str, str]] = {}


Model = TypeVar("Model", bound=Strict)


def has_key(annotation: Any, key: str) -> bool:
    """Whether an annotation is a table with that key."""
    model = model_of(annotation)
    return model is not None and key in keys_of(model)


def keys_of(model: type[Strict]) -> dict[str, FieldInfo]:
    """Keys of a table as a file writes them."""
    return {field.alias or name: field for name, field in model.model_fields.items()}


def annotation_of(model: type[Strict] | None, key: str) -> Any:
    """Annotation of a key; None if there is none."""
    field = keys_of(model).get(key) if model else None
    return field.annotation if field else None


def alternatives(annotation: Any) -> Iterator[Any]:
    """The annotation without Annotated and Optional, one by one."""
    origin = get_origin(annotation)
    if origin in (Union, UnionType):
        for part in get_args(annotation):
            yield from alternatives(part)
    elif hasattr(annotation, "__metadata__"):
        yield from alternatives(get_args(annotation)[0])
    else:
        yield annotation


def model_of(annotation: Any) -> type[Strict] | None:
    """The table among the alternatives of an annotation; None if there is none."""
    for part in alternatives(annotation):
        if isinstance(part, type) and issubclass(part, Strict):
            return part
    return None


def item_annotation(annotation: Any) -> Any:
    """Annotation of the entries of a list or of the values of a dict; None for anything else."""
    for part in alternatives(annotation):
        if get_origin(part) in (list, tuple):
            return get_args(part)[0]
        if get_origin(part) is dict:
            return get_args(part)[1]
    return None


def fixed_length(annotation: Any) -> int:
    """Length of a list of fixed length, 0 for any other."""
    sizes = [get_args(part) for part in alternatives(annotation) if get_origin(part) is tuple]
    return len(sizes[0]) if sizes and Ellipsis not in sizes[0] else 0


def choices_of(annotation: Any) -> list[Any]:
    """Values that a key may take, if they are a few."""
    return [c for part in alternatives(annotation) if get_origin(part) is Literal for c in get_args(part)]


_WRITTEN_OUT = 1e15  # whole numbers up to here are written without exponent


def toml_text(value: Any) -> str:
    """A value as TOML writes it, long ones cut."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        whole = math.isfinite(value) and value.is_integer() and abs(value) < _WRITTEN_OUT
        return f"{value:.1f}" if whole else f"{value:.6g}"
    if isinstance(value, str):
        text = f'"{value}"'
    elif isinstance(value, (list, tuple)):
        text = "[" + ", ".join(toml_text(item) for item in value) + "]"
    elif isinstance(value, dict):
        text = "{ " + ", ".join(f"{key} = {toml_text(item)}" for key, item in value.items()) + " }"
    else:
        text = str(value)
    return text if len(text) <= 60 else text[:57] + "..."
