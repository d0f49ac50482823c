"""The fields of every LCM message. The list is messages.csv, made from fsw/msg by `make stubs`."""

from __future__ import annotations

import csv
import re
from importlib import resources
from math import prod
from typing import NamedTuple


class Field(NamedTuple):
    """A field of a message. type: as in the .lcm file, "double[6]"; unit: by the end of its name, or "";
    flight: what flight holds differently, in the words of the message files (docs/DEVELOPING.md)."""

    message: str
    name: str
    type: str
    unit: str
    meaning: str
    flight: str = ""

    @property
    def base(self) -> str:
        """Its LCM type without dimensions."""
        return self.type.partition("[")[0]

    @property
    def length(self) -> int:
        """Number of values: 1, or the product of its dimensions. ValueError if another field gives it."""
        return prod(int(n) for n in re.findall(r"\[(\w+)\]", self.type))


def _read() -> tuple[Field, ...]:
    text = resources.files(__package__).joinpath("messages.csv").read_text(encoding="utf-8")
    return tuple(Field(**row) for row in csv.DictReader(text.splitlines()))


_ALL = _read()


def fields_of(message: str) -> tuple[Field, ...]:
    """Fields of a message type, e.g. "hk_t", in LCM's order. KeyError if there is no such type."""
    found = tuple(field for field in _ALL if field.message == message)
    if not found:
        raise KeyError(message)
    return found
