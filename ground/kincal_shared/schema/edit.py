"""Values of a TOML file changed in its text, so that comments and everything else stay as they were."""

from __future__ import annotations

import json
import tomllib
from functools import lru_cache
from typing import Any

from kincal_shared.errors import BadInput


def value_text(text: str, path: str) -> str | None:
    """The value under a key as the file writes it, without its comment; None if the file lacks it."""
    lines = text.split("\n")
    place = _places(text).get(path)
    if place is None:
        return None
    first, end = place
    entry = "\n".join(lines[first:end])
    return _split_comment(entry)[0].partition("=")[2].strip()


def changed(text: str, path: str, value: str) -> str:
    """The text with another value under a key ("key" or "table.key"), which is added if it is not there.
    BadInput if the value is no TOML, or the file writes the key in a way that cannot be edited here."""
    table, _, key = path.rpartition(".")
    wanted = _parsed(value, path)
    lines = text.split("\n")
    place = _places(text).get(path)
    if place is None:
        lines = _with_key(lines, table, f"{key} = {value}")
    else:
        first, end = place
        comment = _split_comment("\n".join(lines[first:end]))[1]
        lines[first:end] = [f"{key} = {value}" + (f" {comment}" if comment else "")]
    out = "\n".join(lines)
    expected = _doc(text)
    if expected is None:
        raise BadInput("the file is not valid TOML", todo="correct the file itself")
    (expected.setdefault(table, {}) if table else expected)[key] = wanted
    if _doc(out) != expected:
        raise BadInput(f"{path} is written in a way that cannot be changed here", todo="edit the file itself")
    return out


def as_value(text: str) -> str:
    """What a person typed as TOML: as it is, or in quotes if it is an expression ("50*deg") or a text."""
    text = text.strip()
    try:
        tomllib.loads(f"x = {text}")
    except tomllib.TOMLDecodeError:
        return json.dumps(text, ensure_ascii=False)
    return text


def _doc(text: str) -> Any:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return None


def _parsed(value: str, path: str) -> Any:
    try:
        doc = tomllib.loads(f"x = {value}")
    except tomllib.TOMLDecodeError as error:
        raise BadInput(f"is not valid TOML: {error}", path) from None
    if set(doc) != {"x"}:
        raise BadInput("holds more than one value", path)
    return doc["x"]


@lru_cache(maxsize=4)
def _places(text: str) -> dict[str, tuple[int, int]]:
    """By path of the key: its first line and the one after its value. What stands in tables of a list is not
    told apart, and cannot be edited."""
    lines, out = text.split("\n"), dict[str, tuple[int, int]]()
    table, number = "", 0
    while number < len(lines):
        bare = lines[number].strip()
        if bare.startswith("["):
            table = bare.partition("#")[0].strip().removeprefix("[").removesuffix("]").strip()
        elif "=" in bare and not bare.startswith("#"):
            end = next((n for n in range(number + 1, len(lines) + 1) if _complete(lines[number:n])), None)
            if end is None:
                break
            key = bare.partition("=")[0].strip()
            out.setdefault(f"{table}.{key}" if table else key, (number, end))
            number = end  # behind a list over several lines, whose lines may look like headers
            continue
        number += 1
    return out


def _complete(entry: list[str]) -> bool:
    try:
        tomllib.loads("\n".join(entry))
    except tomllib.TOMLDecodeError:
        return False
    return True


def _split_comment(entry: str) -> tuple[str, str]:
    """An entry and the comment behind its value."""
    whole = tomllib.loads(entry)
    last = entry.rfind("\n") + 1
    at = entry.find("#", last)
    while at >= 0:
        try:
            if tomllib.loads(entry[:at]) == whole:
                return entry[:at].rstrip(), entry[at:].strip()
        except tomllib.TOMLDecodeError:
            pass
        at = entry.find("#", at + 1)
    return entry, ""


def _with_key(lines: list[str], table: str, entry: str) -> list[str]:
    """With an entry more: behind the header of its table, or in a new table at the end."""
    if not table:
        first = next((n for n, line in enumerate(lines) if line.strip().startswith("[")), len(lines))
        return [*lines[:first], entry, "", *lines[first:]]
    for number, line in enumerate(lines):
        if line.partition("#")[0].strip() == f"[{table}]":
            return [*lines[: number + 1], entry, *lines[number + 1 :]]
    return [*lines, f"[{table}]", entry, ""]
