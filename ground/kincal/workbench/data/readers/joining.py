"""Several sets of measurements as one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from kincal_shared.errors import BadInput

from ...numerics.types import Array, Groups
from ..clock import one_clock
from ..copies import without_copies
from ..measurements import Measurements, replicate_groups

# Made anew for the whole set, or of no rows.
_MADE_ANEW = {
    "source", "ids", "t_s", "order_is_time", "replicate", "replicate_stated", "skipped", "duplicates",
    "rounded", "unknown_columns", "notes", "direction_source", "whole", "orientation", "euler_rad",
    "sums",
}  # fmt: skip


def joined(sets: Sequence[Measurements]) -> Measurements:
    """All poses of one or more sets, in their order.

    A quantity that not all of them have is left out, and a note says so; BadInput if that is the split,
    or if two sets hold the same rows, or an id names two poses of a file. Rows that repeat another one
    are left out and counted. Where an id occurs in two files, the number of the file is put before all
    ids. Without times everywhere, or with one time for all, the order of the rows is the time; clocks that
    begin anew in each file are put one after another.
    """
    if not sets:
        raise BadInput("no measurements given", todo="name a file with --data")
    sets = [once(data) for data in sets]
    first = sets[0]
    if len(sets) == 1:
        return _timed(first)
    _refuse_doubles(sets)
    left_out: list[str] = []
    changes: dict[str, Any] = {}
    for one in fields(Measurements):
        if one.name in _MADE_ANEW:
            continue
        parts = [getattr(data, one.name) for data in sets]
        lacking = [data.source for data, part in zip(sets, parts, strict=True) if part is None]
        changes[one.name] = None if lacking else np.concatenate(parts)
        if lacking and len(lacking) < len(sets):
            if one.name == "split":
                raise BadInput(f"{lacking[0]}: has no column split, other files have it", todo="all or none")
            left_out.append(f"{one.name} is left out: {', '.join(lacking)} has none")
    timed = not any(data.order_is_time for data in sets)
    times = np.concatenate([np.zeros(0) if data.t_s is None else data.t_s for data in sets])
    n = sum(data.n for data in sets)
    together = replace(
        first,
        **changes,
        source=", ".join(data.source for data in sets),
        ids=_ids(sets),
        t_s=times if timed else np.arange(n, dtype=float),
        order_is_time=not timed,
        direction_source="inferred" if any(d.direction_source == "inferred" for d in sets) else "measured",
        replicate=_groups(sets, changes["q"], changes["payload_kg"]),
        replicate_stated=any(d.replicate_stated for d in sets),
        skipped=tuple(f"{data.source}: {text}" for data in sets for text in data.skipped),
        unknown_columns=tuple(dict.fromkeys(name for data in sets for name in data.unknown_columns)),
        duplicates=sum(data.duplicates for data in sets),
        rounded=sum(data.rounded for data in sets),
        notes=(*dict.fromkeys(note for data in sets for note in data.notes), *left_out),
        **_orientation(sets),
    )
    number = np.repeat(np.arange(len(sets)), [data.n for data in sets])
    file = dict(zip(together.ids, number, strict=True))
    once_each = without_copies(together)
    return _timed(one_clock(once_each, np.array([file[name] for name in once_each.ids])))


def _timed(data: Measurements) -> Measurements:
    """With the order of the rows as time where the times tell nothing apart."""
    if data.t_s is None or data.n < 2 or np.ptp(data.t_s) > 0.0:
        return data
    note = "t_s is the same in every row: the order of the rows is taken for time"
    return replace(data, t_s=np.arange(data.n, dtype=float), order_is_time=True, notes=(*data.notes, note))


def _orientation(sets: Sequence[Measurements]) -> dict[str, Any]:
    """How the orientations are written, where all files write them alike."""
    forms, angles = {data.orientation for data in sets}, [x for d in sets if (x := d.euler_rad) is not None]
    if len(forms) > 1 or 0 < len(angles) < len(sets):
        return {"orientation": "", "euler_rad": None}
    return {"orientation": forms.pop(), "euler_rad": np.concatenate(angles) if angles else None}


def once(data: Measurements) -> Measurements:
    """The poses without copies; BadInput if an id then names two of them."""
    data = without_copies(data)
    if len(set(data.ids)) < data.n:
        twice = min(name for name in data.ids if data.ids.count(name) > 1)
        times = data.ids.count(twice)
        raise BadInput(f"{data.source}: id {twice!r} appears {times} times; ids name one pose each")
    return data


def _refuse_doubles(sets: Sequence[Measurements]) -> None:
    for k, b in enumerate(sets):
        for a in sets[:k]:
            if np.array_equal(a.q, b.q) and np.array_equal(a.p_m, b.p_m):
                raise BadInput(f"{b.source}: holds the same rows as {a.source}", todo="give every file once")


def _ids(sets: Sequence[Measurements]) -> tuple[str, ...]:
    plain = tuple(name for data in sets for name in data.ids)
    if len(set(plain)) == len(plain):
        return plain
    return tuple(f"{number}:{name}" for number, data in enumerate(sets, 1) for name in data.ids)


def _groups(sets: Sequence[Measurements], q: Array, payload_kg: Array | None) -> Groups:
    """Groups of repeated poses: by the readings of all files, unless a file states its own."""
    found = [replicate_groups(d.q, d.payload_kg) for d in sets]
    groups = [by if d.replicate is None else d.replicate for by, d in zip(found, sets, strict=True)]
    if not any(d.replicate_stated for d in sets):
        return replicate_groups(q, payload_kg)
    offset, parts = 0, []
    for own in groups:
        parts.append(own - own.min() + offset)
        offset += int(np.ptp(own)) + 1
    return np.concatenate(parts)
