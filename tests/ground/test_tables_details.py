"""Tables to the last detail: what fills a struct and what is refused, limits met exactly, defaults."""

import math
import zlib

import pytest
from places import BIN, SRC

from kincal import tables
from kincal.flight import library
from kincal.flight import tables as codec
from kincal.flight.terms import FRAMES, Coefficient, Terms, fill_terms
from kincal.workbench.model.effects import Parameter, Term
from kincal_shared.errors import BadInput, CannotAnswer, KincalError
from kincal_shared.schema import tables as sources
from kincal_shared.schema.base import has_key, toml_text
from kincal_shared.schema.numbers import number
from kincal_shared.schema.terms import parse_basis

FLIGHT = library("flight")


def shipped(kind):
    return codec.decode_as(kind, (BIN / f"{kind}.tbl").read_bytes())[1]


def source(tmp_path, kind, *changes):
    text = (SRC / f"{kind}.toml").read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path = tmp_path / f"{kind}.toml"
    path.write_text(text)
    return path


# --------------------------------------------------------------------------- dict and struct


def test_a_struct_takes_every_field_once_and_no_other():
    doc = codec.to_doc(shipped("config"))
    for wrong, what in (
        ({**doc, "extra": 1}, "unknown field 'extra'"),
        ({k: v for k, v in doc.items() if k != "poses_min"}, "field 'poses_min' is missing"),
        ([doc], "expected a block of fields"),
    ):
        with pytest.raises(BadInput, match=what):
            codec.fill(codec.new("config"), wrong)
    struct = codec.new("config")
    codec.fill(struct, doc)
    assert codec.to_doc(struct) == doc


def test_a_name_fills_its_field_but_for_the_zero_at_its_end():
    doc = codec.to_doc(shipped("terms"))
    room = FLIGHT.lib.KC_NAME_LEN
    doc["coef"][0]["name"] = "x" * (room - 1)
    struct = codec.new("terms")
    codec.fill(struct, doc)
    assert FLIGHT.text(struct.coef[0].name) == "x" * (room - 1)
    doc["coef"][0]["name"] += "x"
    with pytest.raises(BadInput, match=f"longer than {room - 1} characters"):
        codec.fill(codec.new("terms"), doc)


def test_lists_count_themselves_up_to_the_room_there_is():
    doc = codec.to_doc(shipped("terms"))
    most = FLIGHT.lib.KC_COEF_MAX
    struct = codec.new("terms")
    codec.fill(struct, {**doc, "coef": [doc["coef"][0]] * most})
    assert (struct.n_coef, struct.n_term) == (most, len(doc["term"]))
    with pytest.raises(BadInput, match=f"{most + 1} entries, room for {most}"):
        codec.fill(codec.new("terms"), {**doc, "coef": [doc["coef"][0]] * (most + 1)})
    with pytest.raises(BadInput, match="expected a list"):
        codec.fill(codec.new("terms"), {**doc, "coef": 3})


@pytest.mark.parametrize(
    ("field", "value", "what"),
    [
        ("poses_min", 2.5, "must be a whole number"), ("poses_min", math.inf, "must be a whole number"),
        ("poses_min", -1, "does not fit"), ("poses_min", "3", "is not a number"),
        ("no_change_p", None, "is not a number"), ("acquisition", "guess", "is none of"),
    ],
)  # fmt: skip
def test_a_value_that_its_field_cannot_hold_is_refused_where_it_stands(field, value, what):
    doc = {**codec.to_doc(shipped("config")), field: value}
    with pytest.raises(BadInput, match=what) as error:
        codec.fill(codec.new("config"), doc, "here")
    assert error.value.where == f"here:{field}"


def test_whole_numbers_stay_whole_and_names_of_numbers_that_have_none_are_numbers():
    doc, struct = codec.to_doc(shipped("terms")), codec.new("terms")
    codec.fill(struct, {**doc, "kinematics_crc": 0xFFFFFFFF})
    assert struct.kinematics_crc == 0xFFFFFFFF
    config = codec.new("config")
    last = len(codec.names_of_field("kc_config_t", "acquisition")) - 1
    config.acquisition = last
    assert codec.to_doc(config)["acquisition"] == codec.names_of_field("kc_config_t", "acquisition")[last]
    config.acquisition = last + 1
    assert codec.to_doc(config)["acquisition"] == last + 1


def test_kinds_have_numbers_and_back_and_errors_say_where():
    assert [codec.kind_name(codec.kind_number(kind)) for kind in codec.kinds()] == list(codec.kinds())
    for act in (lambda: codec.kind_number("nothing"), lambda: codec.kind_name(99)):
        with pytest.raises(BadInput, match="unknown table kind") as error:
            act()
        assert error.value.where == ""
    with pytest.raises(BadInput) as error:
        codec.decode_as("kin", (BIN / "terms.tbl").read_bytes(), "there")
    assert (error.value.what, error.value.where) == ("this is a terms table, a kin table is needed", "there")


def test_fewer_bytes_than_a_header_are_no_image():
    data = (BIN / "kin.tbl").read_bytes()
    assert codec.header(data[:16]).kind == "kin"
    for wrong in (data[:15], b"KCT2" + data[4:], b""):
        with pytest.raises(BadInput, match="not a table image"):
            codec.header(wrong)


def test_a_count_that_is_impossible_is_not_written():
    struct = codec.new("kin")
    struct.n_coef = FLIGHT.lib.KC_COEF_MAX + 1
    with pytest.raises(BadInput, match="the table cannot be written"):
        codec.encode("kin", struct)


# --------------------------------------------------------------------------- correction terms


def coefficient(terms, bound=1.0):
    return Coefficient("c", terms, bound, 0.5, 2.0)


def term(frame=0, comp=0, *basis):
    return Term(frame, comp, 1.5, basis)


def test_terms_go_to_their_frame_and_coefficient():
    of_flight = {name: FLIGHT.constant(f"KC_FRAME_{name.upper()}") for name in ("tool", "camera", "meas")}
    first, second = (
        (term("base", "ry"), term("tool")),
        (term("camera"), term("sensor"), term("meas"), term(3)),
    )
    table = fill_terms(FLIGHT, [coefficient(first), coefficient(second, 0.0)])
    frames = [table.term[k].frame for k in range(table.n_term)]
    assert frames == [0, of_flight["tool"], of_flight["camera"], of_flight["camera"], of_flight["meas"], 3]
    assert [table.term[k].coef for k in range(table.n_term)] == [0, 0, 1, 1, 1, 1]
    assert (table.term[0].comp, table.term[0].gain) == (FLIGHT.enum("kc_comp_t", "KC_")["RY"], 1.5)
    a, b = table.coef[0], table.coef[1]
    assert (a.lb, a.ub, a.prior_sigma, a.scale, a.enabled) == (-1.0, 1.0, 0.5, 2.0, 1)
    assert (b.lb, b.ub, b.enabled, table.n_coef) == (0.0, 0.0, 0, 2)
    assert FRAMES["base"] == 0


def test_as_many_coefficients_and_terms_as_a_build_carries_and_no_more():
    most, most_terms = FLIGHT.lib.KC_COEF_MAX, FLIGHT.lib.KC_TERM_MAX
    assert fill_terms(FLIGHT, [coefficient((term(),))] * most).n_coef == most
    assert fill_terms(FLIGHT, [coefficient((term(),) * most_terms)]).n_term == most_terms
    with pytest.raises(CannotAnswer, match=f"has {most + 1} coefficients, flight carries at most {most}"):
        fill_terms(FLIGHT, [coefficient((term(),))] * (most + 1))
    with pytest.raises(CannotAnswer, match=f"more than {most_terms} terms"):
        fill_terms(FLIGHT, [coefficient((term(),) * (most_terms + 1))])
    with pytest.raises(CannotAnswer, match="the ground tool carries"):
        fill_terms(library("ground"), [coefficient((term(),))] * 10_000)


def test_terms_of_a_table_are_those_of_the_model_they_were_made_of():
    parameters = [
        ("a", Parameter("a", "rad", 0.1, (term(-3, 2), term(2, 5)))),
        ("b" * 30, Parameter("b", "m", 0.2, ())),
    ]
    terms = Terms.of(parameters)
    assert (terms.n, terms.names, terms.pnp) == (2, ("a", "b" * 23), ())
    assert (terms.struct.coef[0].prior_sigma, terms.struct.coef[1].scale) == (0.1, 0.2)
    table = shipped("terms")
    again = Terms.of_table(table)
    assert again.names == tuple(FLIGHT.text(table.coef[c].name) for c in range(table.n_coef))
    assert [again.struct.term[k].frame for k in range(28)] == [table.term[k].frame for k in range(28)]


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("levx[1]", "has one index"),
        ("q[1,2]", "has two indices"),
        ("q", "needs a joint"),
        ("nothing", "no variable"),
    ],
)
def test_a_variable_has_the_indices_that_it_needs(text, what):
    with pytest.raises((KincalError, ValueError), match=what):
        parse_basis(f"lin({text})", {})


# --------------------------------------------------------------------------- sources


def test_kin_has_a_number_of_zeros_or_two_lists_of_one_length(tmp_path):
    def made(text):
        zero = [
            (f"{key} = 0", f"{key} = 1")
            for key in ("session  ", "n_poses  ", "made_us  ", "arm_crc  ", "terms_crc")
        ]
        return source(tmp_path, "kin", ("n_coef = 54", text), *zero)

    struct = codec.decode(tables.build(made("value = [0.1, 0.2]\nsigma = [0.3, 0.4]")).data)[1]
    assert (struct.n_coef, list(struct.value[0:2]), list(struct.sigma[0:2])) == (2, [0.1, 0.2], [0.3, 0.4])
    for text, what in (
        ("value = [0.1]\nsigma = [0.3, 0.4]", "has 2 entries, value has 1"),
        ("value = [0.1]", "is missing"),
        ("n_coef = 1\nsigma = [0.3]", "stands beside"),
    ):
        with pytest.raises(KincalError, match=what):
            tables.build(made(text))


def test_an_arm_without_masses_has_none(tmp_path):
    path = source(tmp_path, "arm")
    lines = [x for x in path.read_text().splitlines() if not x.strip().startswith(("mass_kg", "com_m"))]
    path.write_text("\n".join(lines) + "\n")
    arm = codec.decode(tables.build(path).data)[1]
    assert [(j.has_mass, j.mass_kg, list(j.com_m)) for j in arm.joint[0:2]] == [(0, 0.0, [0.0] * 3)] * 2
    assert all(j.has_mass and j.mass_kg > 0.0 for j in shipped("arm").joint[0:7])


def test_names_are_as_long_as_the_table_has_room_for():
    entry = {
        "joints": [1], "lb": -1.0, "ub": 1.0, "prior_sigma": 0.0, "scale": 1.0, "enabled": True,
        "term": [{"at": "base", "comp": "tx"}],
    }  # fmt: skip
    room = sources.NAME_CHARACTERS - 2
    assert sources.CoefEntry(name="x" * room + "[{j}"[1:] + "]", **entry)
    with pytest.raises(ValueError, match="longer than 23 characters"):
        sources.CoefEntry(name="x" * (room + 1) + "{j}]", **entry)
    assert sources.CoefEntry(name="x", **{**entry, "lb": 1.0})
    with pytest.raises(ValueError, match="above ub"):
        sources.CoefEntry(name="x", **{**entry, "lb": 1.1})


@pytest.mark.parametrize(
    ("norm", "good"), [(1.0, True), (1.0009, True), (0.9991, True), (1.0011, False), (0.99, False)]
)
def test_a_quaternion_may_be_a_thousandth_off(norm, good):
    quat = (0.6 * norm, 0.0, 0.8 * norm, 0.0)
    if good:
        assert sources._is_unit(quat) == quat
    else:
        with pytest.raises(ValueError, match="has norm"):
            sources._is_unit(quat)


def test_tables_are_compared_whatever_else_the_folder_lacks(tmp_path):
    image, struct = codec.decode((BIN / "terms.tbl").read_bytes())
    assert tables.compared(image, struct, BIN) == f"bounds agree with {BIN}/space.tbl"
    assert "no arm.tbl and no space.tbl" in tables.compared(image, struct, tmp_path)
    (tmp_path / "arm.tbl").write_bytes((BIN / "arm.tbl").read_bytes())
    assert tables.compared(image, struct, tmp_path).endswith("holds no space.tbl")
    image, struct = codec.decode((BIN / "config.tbl").read_bytes())
    assert tables.compared(image, struct, tmp_path) == ""


def test_differences_name_entries_and_show_bit_sets_as_a_hash():
    doc = {"a": [{"name": "x", "v": 1}, {"name": "", "v": 2}, 3], "b": {"c": b"\x03\x80"}}
    assert tables.flatten(doc) == {
        "a[x].name": "x", "a[x].v": 1, "a[1].name": "", "a[1].v": 2, "a[2]": 3,
        "b.c": f"3 bits set, 2 bytes, hash {zlib.crc32(bytes([3, 128])):08x}",
    }  # fmt: skip


def test_values_are_shown_in_full_up_to_sixty_characters():
    assert toml_text("x" * 58) == '"' + "x" * 58 + '"'
    assert len(toml_text("x" * 59)) == 60 and toml_text("x" * 59).endswith("...")
    assert has_key(sources.DhBlock, "joints") and not has_key(sources.DhBlock, "nothing")
    assert not has_key(int, "joints")


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("pi/2", math.pi / 2), ("-2*3", -6.0), ("7 - 2 - 1", 4.0), ("2**3", 8.0), ("(1 + 2) * 3", 9.0),
        ("+4", 4.0), (" 1 ", 1.0), ("sin(pi/2)", 1.0), ("sqrt(16)", 4.0), ("180*deg", math.pi), (3, 3.0),
        ("cos(pi/3)", 0.5), ("2**-1", 0.5), ("sqrt(2)*1e-3", 1.4142135623730951e-3),
    ],
)  # fmt: skip
def test_numbers_may_be_worked_out(text, value):
    assert number(text) == pytest.approx(value, rel=1e-15)
