"""Structs of messages for flight: what the comments of a message file say, and what the build refuses."""

import sys

import pytest
from places import ROOT

sys.path.insert(0, str(ROOT / "ground"))
import lcm_files  # noqa: E402
import message_structs  # noqa: E402

HEAD = """package kcm;

// Channel KC_A: {direction}; 1 Hz; something.
//
// Flight: messages/kc_messages.h, with kc_x.h
// Flight also: kc_x_t x: nested
// Flight also: uint8_t seen
// Flight input: thing
struct a_t
{{
{fields}
}}
"""
TAKEN, SENT = "arm -> flight", "flight -> ground"


def made(folder, fields, direction=TAKEN):
    (folder / "a_t.lcm").write_text(HEAD.format(direction=direction, fields=fields))
    return message_structs.made(lcm_files.messages(folder))


@pytest.mark.parametrize(
    ("field", "member", "copied"),
    [
        ("double a;", "double a;", "to->a = from->a;"),
        ("int32_t a; // flight: unsigned", "uint32_t a;", "to->a = (uint32_t)from->a;"),
        ("int64_t a; // flight: unsigned", "uint64_t a;", "to->a = (uint64_t)from->a;"),
        ("int8_t a; // flight: flag", "uint8_t a;", "to->a = from->a != 0;"),
        ("int32_t a; // flight: gathered", "int32_t a;", "to->a |= from->a;"),
        ("int32_t a; // flight: as b, unsigned", "uint32_t b;", "to->b = (uint32_t)from->a;"),
        ("double a[8]; // flight: [KC_JOINT_MAX]", "double a[KC_JOINT_MAX];", "COPY(to->a, from->a);"),
        ("byte a[9];", "uint8_t a[9u];", "COPY(to->a, from->a);"),
        ("double a[21]; // flight: triangle", "double a[36u];", "unpack(from->a, to->a, 6u);"),
        ("int8_t a[3]; // flight: real", "double a[3u];", "to->a[i] = (double)from->a[i];"),
    ],
)
def test_a_field_is_declared_and_copied_as_its_comment_says(tmp_path, field, member, copied):
    texts = made(tmp_path, field)
    assert f"    {member}\n" in texts["messages/kc_messages.h"]
    assert copied in texts["lcm/kc_wire.c"]


def test_a_field_inside_a_further_member_is_not_declared_again(tmp_path):
    texts = made(tmp_path, "double a; // flight: as x.b", SENT)
    assert "double b" not in texts["messages/kc_messages.h"]
    assert "to->a = from->x.b;" in texts["lcm/kc_wire.c"]
    assert "void kc_wire_a(const kc_a_t *from, int64_t t_us, kcm_a_t *to)" in texts["lcm/kc_wire.h"]


def test_what_no_field_fills_is_zero_in_what_arrives(tmp_path):
    source = made(tmp_path, "double a; // flight: as x.b")["lcm/kc_wire.c"]
    assert "to->seen = 0u;" in source
    assert "to->x = 0u;" not in source


def test_the_edge_fills_in_what_is_sent(tmp_path):
    texts = made(tmp_path, "int64_t t_us; // flight: edge\nint32_t seq; // flight: edge", SENT)
    assert "t_us" not in texts["messages/kc_messages.h"]
    assert "(const kc_a_t *from, int64_t t_us, int32_t seq, kcm_a_t *to)" in texts["lcm/kc_wire.h"]


def test_constants_are_an_enumeration_of_flight(tmp_path):
    text = made(tmp_path, "const int32_t GO = 1,\n    NOT = -1; // flight: kc_way_t KC_WAY_")[
        "messages/kc_messages.h"
    ]
    assert "typedef enum {\n    KC_WAY_GO = 1,\n    KC_WAY_NOT = -1\n} kc_way_t;" in text


def test_inputs_have_numbers_and_names(tmp_path):
    text = made(tmp_path, "double a[3]; // flight: input 110 THING_A")["messages/kc_messages.h"]
    assert 'X(110, 3u, THING_A, "thing a")' in text


@pytest.mark.parametrize(
    ("fields", "what"),
    [
        ("double a; // flight: unsinged", "a: 'unsinged' after `// flight:` means nothing"),
        ("double a; // flight: [3]", "a: '[3]' after `// flight:` means nothing"),
        ("int32_t n;\ndouble a[n];", "a: flight takes single values and arrays of one fixed length"),
        ("const int32_t A = 1; // flight: KC_A_", "behind constants `kc_x_t KC_X_`"),
        (
            "double a[3]; // flight: input 110 A\ndouble b; // flight: input 112 B",
            "b: another field has number 112",
        ),
    ],
)
def test_what_has_no_meaning_stops_the_build(tmp_path, fields, what):
    with pytest.raises(SystemExit, match="Message files") as refused:
        made(tmp_path, fields)
    assert what in str(refused.value)


def test_files_of_messages_that_went_are_deleted_and_others_left_alone(tmp_path, monkeypatch):
    folder, out = tmp_path / "msg", tmp_path / "out"
    folder.mkdir()
    (folder / "a_t.lcm").write_text(HEAD.format(direction=TAKEN, fields="double a;"))
    monkeypatch.setattr(sys, "argv", ["message_structs.py", str(out), str(folder)])
    message_structs.main()
    (out / "decide").mkdir()
    (out / "decide/kc_old.h").write_text("")
    before = (out / "lcm/kc_wire.c").stat().st_mtime_ns
    message_structs.main()
    assert not (out / "decide/kc_old.h").exists()
    assert (out / "lcm/kc_wire.c").stat().st_mtime_ns == before
