"""What to write in place of an unknown key: another unit, the nearest name, another table."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Iterator
from typing import Any

from .base import Strict, item_annotation, keys_of, model_of, toml_text
from .numbers import evaluate

# suffix that people write -> (suffix of the key, factor, name of the unit)
_UNITS = {
    "deg": [("rad", math.pi / 180.0, "radians")],
    "degrees": [("rad", math.pi / 180.0, "radians")],
    "mrad": [("rad", 1e-3, "radians")],
    "mm": [("m", 1e-3, "metres")],
    "cm": [("m", 1e-2, "metres")],
    "um": [("m", 1e-6, "metres")],
    "g": [("kg", 1e-3, "kilograms")],
    "s": [("us", 1e6, "microseconds")],
    "ms": [("us", 1e3, "microseconds"), ("s", 1e-3, "seconds")],
    "us": [("s", 1e-6, "seconds")],
}
# for keys without a unit
_UNIT_NAMES = {"rad": "radians", "m": "metres", "kg": "kilograms", "us": "microseconds", "s": "seconds"}


def instead(root: type[Strict], table: type[Strict] | None, key: str, got: Any) -> tuple[str, str]:
    """The key of `table` that the unknown `key` stands for ("" if none does), and what to write for the value
    `got`. root: the model of the whole file."""
    known = keys_of(table) if table else {}
    for right, todo in (
        _other_unit(key, known, got),
        _other_order(key, known, got),
        _synonym(table, key, known),
        _without_unit(key, known),
        _nearest(key, known, got, 0.8),
        _elsewhere(root, table, key, got),
        _nearest(key, known, got, 0.6),
    ):
        if todo:
            return right, todo
    return "", f"known keys are {', '.join(sorted(known))}" if known else ""


def _other_unit(key: str, known: dict[str, Any], got: Any) -> tuple[str, str]:
    """alpha_deg = -90 -> write alpha_rad in radians: alpha_rad = -1.5708"""
    stem, _, unit = key.rpartition("_")
    for suffix, factor, name in _UNITS.get(unit.lower(), ()):
        right = f"{stem}_{suffix}"
        if right in known:
            value = _scaled(got, factor)
            written = f": {right} = {toml_text(value)}" if value is not None else ""
            return right, f"write {right} in {name}{written}"
    return "", ""


def _scaled(got: Any, factor: float) -> Any:
    if isinstance(got, list):
        items = [_scaled(item, factor) for item in got]
        return None if None in items else items
    if isinstance(got, str):
        try:
            got = evaluate(got)
        except ValueError:
            return None
    if isinstance(got, bool) or not isinstance(got, (int, float)) or not math.isfinite(got):
        return None
    return float(f"{got * factor:.6g}")


def _other_order(key: str, known: dict[str, Any], got: Any) -> tuple[str, str]:
    """quat_xyzw -> quat_wxyz, reordered."""
    right = key.replace("xyzw", "wxyz")
    if right == key or right not in known:
        return "", ""
    value = f": {right} = {toml_text([got[3], *got[:3]])}" if isinstance(got, list) and len(got) == 4 else ""
    return right, f"write {right}, the scalar part first{value}"


def _synonym(table: type[Strict] | None, key: str, known: dict[str, Any]) -> tuple[str, str]:
    right = table.SYNONYMS.get(key, "") if table else ""
    return (right, f"write {right}") if right in known else ("", "")


def _without_unit(key: str, known: dict[str, Any]) -> tuple[str, str]:
    """alpha -> alpha_rad; d -> d_m"""
    for right in known:
        stem, _, unit = right.rpartition("_")
        if stem == key and unit in _UNIT_NAMES:
            return right, f"write {right} (in {_UNIT_NAMES[unit]})"
    return "", ""


def _nearest(key: str, known: dict[str, Any], got: Any, likeness: float) -> tuple[str, str]:
    """estimated = true -> write estimate = true"""
    near = difflib.get_close_matches(key, list(known), 1, likeness)
    if not near:
        return "", ""
    value = "" if isinstance(got, (dict, list)) else f" = {toml_text(got)}"
    return near[0], f"write {near[0]}{value}"


def _elsewhere(root: type[Strict], table: type[Strict] | None, key: str, got: Any) -> tuple[str, str]:
    """The key exists, but in another table; or it is a table whose keys do."""
    wanted = sorted(got) if isinstance(got, dict) and got else [key]
    for path, model in _tables(root):
        if set(wanted) <= set(keys_of(model)) and model is not table:
            where = f"in [{path}]" if path else "at the top of the file, above the first [table]"
            return "", f"{', '.join(wanted)} {'belongs' if len(wanted) == 1 else 'belong'} {where}"
    return "", ""


def _tables(model: type[Strict], path: str = "") -> Iterator[tuple[str, type[Strict]]]:
    """Every table of a file with its path, the file itself first."""
    yield path, model
    for key, field in keys_of(model).items():
        annotation = field.annotation
        inner = model_of(annotation) or model_of(item_annotation(annotation))
        if inner is not None:
            yield from _tables(inner, f"{path}.{key}" if path else key)


def nearest_name(name: str, known: Iterable[str]) -> str:
    """The known name that is most like the given one, whatever the case; "" if none is near."""
    lower = {candidate.lower(): candidate for candidate in known}
    near = difflib.get_close_matches(name.lower(), list(lower), 1, 0.6)
    return lower[near[0]] if near else ""
