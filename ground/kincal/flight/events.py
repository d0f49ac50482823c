"""Flight's events in words. The dictionary is the core's own (fsw/tables/kc_events.h)."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from functools import cache
from typing import Any

from kincal_shared import installation

from . import event_format
from .builds import FlightLibrary, library
from .event_format import Names

_ENUMS = {
    "state": ("kc_state_t", "KC_ST_"),
    "command": ("kc_opcode_t", "KC_CMD_"),
    "acquisition": ("kc_acq_t", "KC_ACQ_"),
    "status": ("kc_status_t", ""),
}
_NAMED = re.compile(r"[A-Z]+(?:_[A-Z]+)+")  # names of events in a text
_MOST_EVENT = 2**16 - 1
_MOST_INPUT_FIELDS = 400  # 100 x input + field, three inputs


def _by_number(flight: FlightLibrary, ctype: str, prefix: str) -> dict[int, str]:
    return {number: name for name, number in flight.enum(ctype, prefix).items()}


def _stores(flight: FlightLibrary) -> dict[int, str]:
    kinds = _by_number(flight, "kc_tbl_kind_t", "KC_TBL_")
    return {number: f"{name} table" for number, name in kinds.items()} | {
        flight.lib.KC_STORE_PROPOSAL: "proposal",
        flight.lib.KC_STORE_PREV: "previous correction",
        flight.lib.KC_STORE_JOURNAL: "journal",
    }


def _input_fields(flight: FlightLibrary) -> dict[int, str]:
    element, names = flight.ffi.new("uint32_t *"), {}
    for i in range(_MOST_INPUT_FIELDS):
        if name := flight.text(flight.lib.kc_input_field(i, element)):
            names[i] = f"{name}, element {element[0]}" if element[0] else name
    return names


@cache
def event_names() -> Names:
    """Names of the numbers in events, from the headers; those of coefficients and joint units belong to the
    tables of an arm and are not among them."""
    flight = library("flight")
    lib = flight.lib
    inputs, sources = (
        _by_number(flight, *enum) for enum in (("kc_sensor_t", "KC_INPUT_"), ("kc_source_t", "KC_SRC_"))
    )
    return {
        **{kind: _by_number(flight, *enum) for kind, enum in _ENUMS.items()},
        "source": {i: name.lower() for i, name in sources.items()},
        "store": _stores(flight),
        "input": {i: name.lower().replace("pantilt", "pan-tilt") for i, name in inputs.items()},
        "input_field": _input_fields(flight),
        "cause": {i: flight.text(lib.kc_cause_text(i)) for i in range(lib.KC_CAUSE_COUNT)},
        "entry": {
            0: "entry",
            lib.KC_TERMS_INDEX_TERM: "term",
            lib.KC_SPACE_INDEX_HUB: "hub",
            lib.KC_SPACE_INDEX_INITIAL: "initial pose",
            lib.KC_SPACE_INDEX_BODY: "body",
            lib.KC_SPACE_INDEX_VOLUME: "volume",
            lib.KC_SPACE_INDEX_VERIFIED: "verified errors, joint",
        },
    }


def _known(event_id: int) -> int:
    """The number as the core takes it; 0, which no event has, for what else a message may hold."""
    return event_id if 0 <= event_id <= _MOST_EVENT else 0


def event_name(event_id: int) -> str:
    """Name of an event, e.g. "CAL_DONE"."""
    flight = library("flight")
    return flight.text(flight.lib.kc_event_name(_known(event_id)))


def event_action(event_id: int) -> str:
    """What the operator does after an event; empty if there is nothing to do, or no such event."""
    flight = library("flight")
    return flight.text(flight.lib.kc_event_action(_known(event_id)))


@cache
def _table() -> Mapping[str, Any]:
    """The table that docs/OPERATIONS.md is made of: cause and what to do of every event, by its name, and
    what to do after each cause of an abort."""
    path = installation.root() / "fsw" / "tables" / "kc_events.toml"
    return tomllib.loads(path.read_text("utf-8"))


def _advice() -> Mapping[str, Mapping[str, str]]:
    found: Mapping[str, Mapping[str, str]] = _table()["event"]
    return found


def abort_todo(cause: int) -> str:
    """What the operator does after a calibration that was aborted; empty if there is no such cause. Where it
    is the same as after an event, that is said too."""
    flight = library("flight")
    name = {number: name for name, number in flight.enum("kc_cause_t", "KC_CAUSE_").items()}.get(cause, "")
    text: str = _table()["abort"].get(name, "")
    events = flight.enum("kc_event_id_t", "KC_EVT_")
    same = [event_todo(events[each]) for each in _NAMED.findall(text) if each in events]
    return " ".join([text, *same])


def event_cause(event_id: int) -> str:
    """What is likely behind an event, the likeliest first; empty if there is no such event."""
    return _advice().get(event_name(event_id), {}).get("cause", "")


def event_todo(event_id: int) -> str:
    """What the operator does, as docs/OPERATIONS.md has it; empty if there is no such event."""
    action, more = event_action(event_id), _advice().get(event_name(event_id), {}).get("do", "")
    return action if more == "Nothing." and action else f"{action} {more}".strip()


def event_text(
    event_id: int, index: int, got: float, want: float, tables: Mapping[str, Mapping[int, str]] | None = None
) -> str:
    """Text of an event with its values as names and with units.

    tables: names that tables give, where they are known: {"coefficient": {0: "J1.phi_rad" ...},
    "joint_unit": {1: "rad" ...}}.
    """
    flight = library("flight")
    text = flight.text(flight.lib.kc_event_text(_known(event_id)))
    return event_format.event_text(text, index, got, want, {**event_names(), **(tables or {})})


def event_line(event_id: int, index: int, got: float, want: float) -> str:
    """NAME: text of an event with its values filled in."""
    return f"{event_name(event_id)}: {event_text(event_id, index, got, want)}"
