"""The grammar of correction terms: names, places, bases, and that reading what was written gives the same."""

import math
import random

import pytest

from kincal.flight import library
from kincal.flight.terms import fill_basis
from kincal_shared.errors import BadInput
from kincal_shared.schema import names
from kincal_shared.schema.errors import Contradiction
from kincal_shared.schema.terms import (
    ONE,
    Basis,
    TermEntry,
    basis_text,
    parse_basis,
    parse_factors,
    parse_gain,
    parse_place,
    place_text,
)

HEADERS = library("flight")


def enum(ctype, prefix):
    return [name.lower() for name in HEADERS.enum(ctype, prefix)]


def test_functions_and_components_are_those_of_the_headers_in_their_order():
    assert list(names.FUNCTIONS) == enum("kc_fn_t", "KC_FN_")
    assert list(names.COMPONENTS) == enum("kc_comp_t", "KC_")


def test_every_variable_of_the_headers_has_a_name_and_none_has_two_meanings():
    assert {v.flight for v in names.VARIABLES.values()} == set(enum("kc_var_t", "KC_VAR_"))
    for variable in names.VARIABLES.values():
        assert variable.unit
    first = [v.flight for name, v in names.VARIABLES.items() if not name.startswith("s")]
    assert len(first) == len(set(first))


def test_special_places_are_frames_of_the_headers():
    frames = {frame for frame, _ in names.PLACES.values() if isinstance(frame, str)}
    for build in (HEADERS, library("ground")):
        numbers = [build.constant(f"KC_FRAME_{frame.upper()}") for frame in frames]
        assert len(set(numbers)) == len(frames)


def test_written_basis_reads_back_to_the_same_numbers():
    rng = random.Random(7)
    for _ in range(500):
        pair = []
        for _ in range(rng.choice((1, 2))):
            var = rng.choice([name for name in names.VARIABLES if name != "1"])
            index = rng.randint(1, 16) if names.VARIABLES[var].indexed else 0
            c0 = rng.choice((0.0, rng.uniform(-300, 300), 1e-7 * rng.random()))
            c1 = rng.choice((1.0, -2.0, rng.uniform(-5, 5), 1 / 3))
            pair.append(Basis(rng.choice(names.FUNCTIONS), var, index, c0, c1))
        pair += [ONE] * (2 - len(pair))
        assert parse_basis(basis_text(*pair), {}) == tuple(pair), basis_text(*pair)


def test_no_basis_is_one():
    assert basis_text(ONE) == basis_text(ONE, ONE) == "1"
    assert parse_basis("1", {}) == (ONE, ONE)


@pytest.mark.parametrize(
    ("text", "given", "want"),
    [
        ("q[j]", {"j": 3}, Basis("lin", "q", 3)),
        ("q12", {}, Basis("lin", "q", 12)),
        ("Mx[p]", {"p": 2}, Basis("lin", "Mx", 2)),
        ("cos(N*q[j])", {"j": 1, "N": 42.0}, Basis("cos", "q", 1, 0.0, 42.0)),
        ("tanh(tau[j]/$tau0)", {"j": 2, "tau0": 0.5}, Basis("tanh", "tau", 2, 0.0, 2.0)),
        ("ln1p((t-$tstart)/$tau)", {"tstart": 10.0, "tau": 4.0}, Basis("ln1p", "t", 0, 10.0, 0.25)),
        ("temp+5", {}, Basis("lin", "temp", 0, -5.0)),
        ("r2", {}, Basis("lin", "r2", 0)),
    ],
)
def test_letters_and_constants_are_filled_in(text, given, want):
    assert parse_basis(text, given) == (want, ONE)


@pytest.mark.parametrize(("text", "token"), [("q[j]", "j"), ("N*q1", "N"), ("t-$t0", r"\$t0")])
def test_letter_or_constant_without_a_value_is_refused(text, token):
    with pytest.raises(BadInput, match=f"uses {token}, which has no value here") as error:
        parse_basis(text, {}, "here")
    assert error.value.where == "here"


@pytest.mark.parametrize("text", ["q[x]", "sinh(q1)", "speed", "q1*q2*q3", "q", "sin(", "t2", "", "q1 q2"])
def test_basis_that_is_none_is_refused(text):
    with pytest.raises(Contradiction):
        parse_factors(text)


@pytest.mark.parametrize(
    ("text", "given", "frame"),
    [
        ("base", {}, 0), ("tool", {}, "tool"), ("sensor", {}, "camera"), ("meas", {}, "meas"),
        ("joint[3]", {}, 2), ("before[j]", {"j": 3}, 2), ("link[j]", {"j": 3}, 3), ("link[p]", {"p": 2}, 2),
    ],
)  # fmt: skip
def test_place_is_a_frame(text, given, frame):
    assert parse_place(text).frame(given) == frame
    if not isinstance(frame, str):
        assert parse_place(place_text(frame)).frame({}) == frame


@pytest.mark.parametrize("text", ["elbow", "joint", "joint[x]", "link[0]", "base[1]", "before joint"])
def test_place_that_is_none_is_refused(text):
    with pytest.raises(Contradiction, match="no place"):
        parse_place(text)


def test_gain_of_what_is_neither_a_number_nor_a_property_is_refused():
    with pytest.raises(Contradiction, match="'Lw' is neither"):
        parse_gain("2*Lw")


def test_term_says_what_it_needs():
    term = TermEntry(at="camera", comp="tx", basis="cos(N*q1) * temp")
    assert list(term.needs()) == ["gear_ratio", "temp_c", "cam"]


def test_flight_computes_what_the_text_says():
    ctx, loads = HEADERS.new("kc_ctx_t"), HEADERS.new("kc_loads_t")
    ctx.q[0], ctx.temp_c = 0.4, 25.0
    value = 1.0
    for basis in parse_basis("tanh(q1/0.5) * temp-20", {}):
        struct = HEADERS.new("kc_basis_t")
        fill_basis(struct, basis)
        value *= HEADERS.lib.kc_basis_eval(struct, ctx, loads)
    assert value == pytest.approx(math.tanh(0.8) * 5.0, rel=1e-12)
