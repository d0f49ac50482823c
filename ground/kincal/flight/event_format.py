"""Text of a flight event with its values filled in.

The texts stand in fsw/tables/kc_events.h (docs/EVENTS.md). They name values as `{field:type}`; the field is
index, got or want, and KC_EVENT_TYPE_LIST in that header says what each type means. This is the one place
that shows them. It knows no enum numbers: names come from the caller, who reads them from the headers.
"""

from __future__ import annotations

import datetime
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

Names = Mapping[str, Mapping[int, str]]
"""Name of each number, by type: store, state, command, source, input, input_field, status, cause,
acquisition, coefficient (index in TERMS), joint_unit (joint from 1: "rad" or "m"), and entry (least number of
a range of table entries: what they are, as {0: "entry", 1000: "term"}). The rest is
shown as numbers.
"""

_PLACEHOLDER = re.compile(r"\{(index|got|want):([^{}]*)\}")


@dataclass(frozen=True)
class _Event:
    """What else a value may need to be shown."""

    index: int
    names: Names


Show = Callable[[float, _Event], str]


def _plain(show: Callable[[float], str]) -> Show:
    """A type that needs nothing but its value."""
    return lambda x, _event: show(x)


# ---- numbers


def _count(x: float) -> str:
    return f"{x:.0f}"


def _count_or_none(x: float) -> str:
    return "none" if x < 0 else _count(x)


def _number(x: float) -> str:
    return f"{x:.4g}"


def _rounded(x: float) -> str:
    """Three digits, without exponent for large numbers."""
    return f"{x:.0f}" if 1e3 <= abs(x) < 1e9 else f"{x:.3g}"


def _unit(scale: float, unit: str) -> Show:
    return _plain(lambda x: f"{_rounded(scale * x)} {unit}")


_LONG_US = 1e15  # 30 years: a time since 1970, or since something that never happened


def _seconds(us: float) -> str:
    return f"{_rounded(1e-6 * us)} s"


def _ago(us: float) -> str:
    return f"{_seconds(us)} ago" if 0.0 <= us < _LONG_US else "never"


def _before_now(us: float) -> str:
    if us >= _LONG_US:
        return "without a time stamp"
    return f"{_seconds(us)} before now" if us >= 0.0 else f"{_seconds(-us)} after now"


def _time(us: float) -> str:
    if us < _LONG_US:
        return _seconds(us)
    try:
        return datetime.datetime.fromtimestamp(us * 1e-6, datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    except (OverflowError, ValueError):
        return _seconds(us)


def _stopped(poses: float) -> str:
    return f"calibration stopped after {_count(poses)} poses" if poses >= 0.0 else "no calibration ran"


def _by_index(*units: Show) -> Show:
    def show(x: float, event: _Event) -> str:
        return units[event.index](x, event) if 0 <= event.index < len(units) else _number(x)

    return show


def _bits(x: float) -> int:
    """Fields of 32 bits travel as signed integers or as doubles: both show the same bits."""
    return int(x) & 0xFFFFFFFF


def _finite(show: Callable[[float], str]) -> Show:
    """NaN and infinity have no bits and no names."""
    return _plain(lambda x: show(x) if math.isfinite(x) else str(x))


def _joints(x: float) -> str:
    return ", ".join(str(j + 1) for j in range(32) if _bits(x) >> j & 1) or "none"


# ---- names


def _named(kind: str) -> Show:
    def show(x: float, event: _Event) -> str:
        known = event.names.get(kind, {}).get(int(x)) if math.isfinite(x) else None
        return known or f"{kind.replace('_', ' ')} {_count(x)}"

    return show


def _entry(x: float, event: _Event) -> str:
    """Numbers from each base on are entries of that name; negative: the table as a whole."""
    if x < 0 or not math.isfinite(x):
        return "the table as a whole"
    bases = event.names.get("entry", {0: "entry"})
    base = max((b for b in bases if b <= x), default=0)
    return f"{bases.get(base, 'entry')} {_count(x - base)}"


def _field(x: float) -> str:
    return f"field {_count(x)}" if x > 0 else "a rule between entries"


def _argument(x: float) -> str:
    return "arg_u64" if x == 4 else f"arg_i[{_count(x)}]"


def _candidate_or_any(x: float) -> str:
    return "any candidate" if x < 0 else f"candidate {_count(x)}"


def _coefficient(x: float, event: _Event) -> str:
    known = event.names.get("coefficient", {}).get(int(x)) if math.isfinite(x) else None
    return known or f"#{_count(x)}"


def _joint_value(x: float, event: _Event) -> str:
    return f"{_rounded(x)} {event.names.get('joint_unit', {}).get(event.index, 'rad')}"


_MM, _MRAD, _PX = _unit(1e3, "mm"), _unit(1e3, "mrad"), _unit(1.0, "px")

TYPES: Mapping[str, Show] = {
    "count": _plain(_count_or_none),
    "number": _plain(_number),
    "mm": _MM,
    "mrad": _MRAD,
    "mm/mrad": _by_index(_MM, _MRAD),
    "mm/mrad/px": _by_index(_MM, _MRAD, _PX),
    "s": _plain(_seconds),
    "ago": _finite(_ago),
    "before_now": _finite(_before_now),
    "time": _finite(_time),
    "stopped": _finite(_stopped),
    "J": _unit(1.0, "J"),
    "crc": _finite(lambda x: f"{_bits(x):08x}"),
    "mask": _finite(lambda x: f"{_bits(x):#x}"),
    "store": _named("store"),
    "state": _named("state"),
    "command": _named("command"),
    "source": _named("source"),
    "argument": _plain(_argument),
    "input": _named("input"),
    "input_field": _named("input_field"),
    "status": _named("status"),
    "cause": _named("cause"),
    "acquisition": _named("acquisition"),
    "entry": _entry,
    "field": _plain(_field),
    "pose": _plain(_count),
    "candidate": _plain(_count),
    "candidate_or_any": _plain(_candidate_or_any),
    "coefficient": _coefficient,
    "joint": _plain(_count),
    "joint_value": _joint_value,
    "joints": _finite(_joints),
    "body": _plain(_count),
    "volume": _plain(_count),
}
"""How each type of KC_EVENT_TYPE_LIST is shown: (value, event) -> text."""


def event_text(text: str, index: int, got: float, want: float, names: Names) -> str:
    """`text` of the dictionary with its placeholders replaced by names, units and rounded numbers.

    text: with placeholders {field:type}; index, got, want: values of the event, in the units that the header
    states; names: see Names. ValueError for a placeholder of an unknown type.
    """
    event = _Event(index, names)
    values = {"index": float(index), "got": got, "want": want}

    def show(found: re.Match[str]) -> str:
        field, kind = found.groups()
        if kind not in TYPES:
            raise ValueError(f"unknown placeholder type {kind!r} in event text {text!r}")
        return TYPES[kind](values[field], event)

    return _PLACEHOLDER.sub(show, text)
