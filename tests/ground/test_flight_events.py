"""kincal.flight.event_format: placeholders become names, units and rounded numbers."""

import math
import re

import pytest
from places import ROOT

from kincal.flight import library
from kincal.flight.event_format import TYPES, event_text

HEADER = (ROOT / "fsw" / "tables" / "kc_events.h").read_text().replace("\\\n", " ")
NAMES = {
    "store": {3: "TERMS table", 16: "proposal"}, "state": {4: "OBSERVE"}, "command": {1: "START"},
    "input": {1: "arm", 2: "pan-tilt"}, "input_field": {112: "arm q_rad of joint 3"},
    "cause": {4: "no frame in spite of all retries"}, "status": {-7: "KC_ERR_RANGE"},
    "coefficient": {2: "J1.a_m"}, "joint_unit": {1: "rad", 2: "m"},
    "entry": {0: "entry", 1000: "term", 2000: "hub"},
}  # fmt: skip


def test_the_enumeration_has_every_event_of_the_header():
    events = library("flight").enum("kc_event_id_t", "KC_EVT_")
    listed = {name: int(number) for number, name in re.findall(r"X\((\d+), (\w+),", body("KC_EVENT_LIST"))}
    assert events == {"NONE": 0, **listed}


def body(macro: str) -> str:
    found = re.search(rf"#define {macro}\(X\)(.*)", HEADER)
    assert found
    return found[1]


def show(kind: str, got: float, index: int = -1) -> str:
    return event_text(f"{{got:{kind}}}", index, got, 0.0, NAMES)


def test_every_type_of_the_header_is_shown_and_no_other():
    types = re.findall(r'X\(\s*"([^"]*)"', body("KC_EVENT_TYPE_LIST"))
    assert sorted(types) == sorted(TYPES)


def test_every_placeholder_of_the_dictionary_has_a_field_and_a_known_type():
    placeholders = re.findall(r"\{([^{}]*)\}", body("KC_EVENT_LIST"))
    assert len(placeholders) > 80
    for placeholder in placeholders:
        field, _, kind = placeholder.partition(":")
        assert field in ("index", "got", "want") and kind in TYPES, placeholder


def test_fields_are_filled_in_by_name():
    text = "{index:store} dropped: built for {got:crc}, active is {want:crc}"
    shown = event_text(text, 3, float(0xDEADBEEF), 16.0, NAMES)
    assert shown == "TERMS table dropped: built for deadbeef, active is 00000010"


@pytest.mark.parametrize(
    ("kind", "value", "index", "shown"),
    [
        ("count", 3.0, -1, "3"),
        ("count", -1.0, -1, "none"),
        ("number", 0.0001234567, -1, "0.0001235"),
        ("mm", 0.0123456, -1, "12.3 mm"),
        ("mrad", 0.0123456, -1, "12.3 mrad"),
        ("mm/mrad", 0.05, 0, "50 mm"),
        ("mm/mrad", 0.05, 1, "50 mrad"),
        ("mm/mrad/px", 2.5, 2, "2.5 px"),
        ("mm/mrad/px", 2.5, 7, "2.5"),
        ("s", 2_500_000.0, -1, "2.5 s"),
        ("ago", 2_500_000.0, -1, "2.5 s ago"),
        ("ago", 0.0, -1, "0 s ago"),
        ("ago", -1.0, -1, "never"),
        ("ago", 1.8e15, -1, "never"),  # recorded before flight said so: since 1970
        ("before_now", 2_500_000.0, -1, "2.5 s before now"),
        ("before_now", -2_500_000.0, -1, "2.5 s after now"),
        ("before_now", 1.8e15, -1, "without a time stamp"),
        ("time", 2_500_000.0, -1, "2.5 s"),
        ("time", 1.795e15, -1, "2026-11-18T11:06:40Z"),
        ("time", 1e300, -1, "1e+294 s"),
        ("stopped", 6.0, -1, "calibration stopped after 6 poses"),
        ("stopped", -1.0, -1, "no calibration ran"),
        ("J", 1234.5, -1, "1234 J"),
        ("crc", -1.0, -1, "ffffffff"),  # 32 bits travel as int32
        ("mask", 5.0, -1, "0x5"),
        ("state", 4.0, -1, "OBSERVE"),
        ("state", 99.0, -1, "state 99"),
        ("input_field", 112.0, -1, "arm q_rad of joint 3"),
        ("input_field", 999.0, -1, "input field 999"),
        ("status", -7.0, -1, "KC_ERR_RANGE"),
        ("cause", 4.0, -1, "no frame in spite of all retries"),
        ("entry", -1.0, -1, "the table as a whole"),
        ("entry", 12.0, -1, "entry 12"),
        ("entry", 1012.0, -1, "term 12"),
        ("entry", 2001.0, -1, "hub 1"),
        ("field", 0.0, -1, "a rule between entries"),
        ("field", 53.0, -1, "field 53"),
        ("argument", 1.0, -1, "arg_i[1]"),
        ("argument", 4.0, -1, "arg_u64"),
        ("candidate_or_any", -1.0, -1, "any candidate"),
        ("candidate_or_any", 7.0, -1, "candidate 7"),
        ("coefficient", 2.0, -1, "J1.a_m"),
        ("coefficient", 9.0, -1, "#9"),
        ("joint_value", 0.0123456, 1, "0.0123 rad"),
        ("joint_value", 0.0123456, 2, "0.0123 m"),
        ("joints", 5.0, -1, "1, 3"),
        ("joints", 0.0, -1, "none"),
    ],
)
def test_a_value_is_shown_as_its_type_says(kind, value, index, shown):
    assert show(kind, value, index) == shown


@pytest.mark.parametrize("kind", sorted(TYPES))
def test_a_value_that_is_not_finite_is_shown_and_raises_nothing(kind):
    assert show(kind, math.nan)
    assert show(kind, math.inf)


@pytest.mark.parametrize("kind", sorted(TYPES))
def test_without_names_numbers_are_shown(kind):
    assert event_text(f"{{index:{kind}}}", 3, 0.0, 0.0, {})


def test_an_unknown_type_is_refused():
    with pytest.raises(ValueError, match="furlong"):
        event_text("{got:furlong}", 0, 1.0, 0.0, {})
