"""What of a model flies: effects that flight cannot have, that the search space has no room for, or that are
too many, and what to leave out then, in which order and at which cost."""

from dataclasses import replace

import numpy as np
import poses
import pytest
from places import BIN

from kincal import workbench as wb
from kincal.flight import library
from kincal.flight import tables as codec
from kincal.flight.bounds import shared_bounds, tightest
from kincal.workbench.model import uplink
from kincal.workbench.model.effects import Basis, Hypothesis, Parameter, Term
from kincal_shared.errors import BadInput
from kincal_shared.schema.model import FitEntry
from kincal_shared.schema.names import PNP

FLIGHT = library("flight")
COMP = FLIGHT.enum("kc_comp_t", "KC_")
RZ, TX = COMP["RZ"], COMP["TX"]


@pytest.fixture(scope="module")
def arm():
    return wb.read_arm("wam")


@pytest.fixture(scope="module")
def flown():
    return poses.flown()


def effect(name, count=1, frame="tool", comp=TX, *, sigma=1e-6, basis=()):
    """An effect of so many coefficients, each with a term at that place."""
    row = tuple(Parameter(f"c{k}", "rad", sigma, (Term(frame, comp, 1.0, basis),)) for k in range(count))
    return Hypothesis(name.partition("[")[0], name, row)


def fitted(ratios):
    """A model with the last fit of effects, uncorrelated. ratios: effect -> value over sigma of each."""
    names = [f"{h.name}.{p.name}" for h in ratios for p in h.parameters]
    values = [(1e-6 * x, 1e-6) for h, x in ratios.items() for _ in h.parameters]
    frame = {"xyz_m": (0, 0, 0), "quat_wxyz": (1, 0, 0, 0)}
    lower = [[0.0] * k + [1e-12] for k in range(len(names))]
    fit = FitEntry(when="", tool_version="", arm_sha256="", poses=60, components=6, noise_scale=1.0,
                   base=frame, tool=frame, covariance=lower)  # fmt: skip
    return wb.ModelFile(values=dict(zip(names, values, strict=True)), fit=fit)


def with_value(model, name, value):
    return wb.ModelFile(values={**model.values, name: (value, 1e-6)}, fit=model.fit)


def refusal(arm, effects, flown, model=None):
    with pytest.raises(BadInput) as error:
        uplink.term_table(arm, effects, flown, model)
    return error.value


# ------------------------------------------------------------------------ not for flight


def test_effects_of_many_points_do_not_fly_and_are_named_with_how_to_leave_them_out(arm, flown):
    point = (Basis("lin", next(iter(PNP)), 1),)
    one, two = effect("lens_a", basis=point), effect("lens_b", basis=point)
    error = refusal(arm, [effect("backlash[1]"), one], flown)
    assert error.what.startswith("lens_a acts through all points of the target")
    assert "with --drop lens_a: the effects of the arm stay" in error.todo
    error = refusal(arm, [two, effect("backlash[1]"), one], flown)
    assert error.what.startswith("lens_b, lens_a act through all points")
    assert "--drop lens_b --drop lens_a:" in error.todo
    assert uplink.term_table(arm, [effect("backlash[1]")], flown).n_coef == 29


def test_an_arm_has_as_many_joints_as_flight_carries_and_no_more(arm, flown):
    most = FLIGHT.lib.KC_JOINT_MAX
    larger = [replace(arm, joints=(*[arm.joints[1]] * (n - arm.n), *arm.joints)) for n in (most, most + 1)]
    assert uplink.term_table(larger[0], [], poses.flown_of(larger[0], 0.1)).n_coef == 4 * most
    assert f"has {most + 1} joints; flight carries {most}" in refusal(larger[1], [], flown).what


# ------------------------------------------------------------------------ room in the search space


@pytest.mark.parametrize(
    ("value", "flies"), [(0.0458, True), (-0.0458, True), (0.0459, False), (-0.0459, False)]
)
def test_an_effect_flies_with_1_2_times_its_value_inside_its_bounds_or_not_at_all(arm, flown, value, flies):
    """Half of 0.11 rad is what it may have beside the DH error there."""
    h = effect("turn[1]", 1, 0, RZ, sigma=1e-3)
    model = wb.ModelFile(values={"turn[1].c0": (value, 1e-4)})
    if flies:
        assert uplink.term_table(arm, [h], flown, model).coef[28].ub == pytest.approx(0.055)
    else:
        error = refusal(arm, [h], flown, model)
        assert "turn[1].c0 of 0.0459 can cause up to 0.0459 rad about z of frame 0" in error.what
        assert error.todo.endswith("--drop 'turn[1]'")


def test_what_has_not_been_fitted_is_named_by_the_bound_that_it_asks_for(arm):
    flown = poses.flown_of(arm, 0.1)
    flown.space.verified[0].phi_rad = 0.0
    error = refusal(arm, [effect("turn[1]", 1, 0, RZ, sigma=1e-3)], flown)
    assert "turn[1].c0 of 0.03 can cause up to 0.03" in error.what
    assert "may add up to 0, a tenth more" in error.what


def test_all_effects_without_room_are_left_out_and_the_others_stay(arm, flown):
    small, large, larger = (effect(n, 1, k, RZ) for k, n in enumerate(("small", "large", "larger")))
    model = with_value(fitted({small: 1, large: 1, larger: 1}), "large.c0", 0.2)
    model = with_value(model, "larger.c0", 0.3)
    assert refusal(arm, [small, large, larger], flown, model).todo.endswith("--drop large --drop larger")
    assert uplink.term_table(arm, [small], flown, model).n_coef == 29


def test_a_coefficient_that_acts_at_two_places_has_the_tighter_of_their_bounds(arm):
    flown = poses.flown_of(arm, 0.1)
    flown.space.verified[1].phi_rad = 0.02
    both = (Term(0, RZ, 1.0, ()), Term(1, RZ, 1.0, ()))
    for terms in (both, both[::-1]):
        h = Hypothesis("both", "both", (Parameter("c", "rad", 1e-2, terms),))
        table = uplink.term_table(arm, [h], flown)
        row = {FLIGHT.text(c.name): c.ub for c in table.coef[0 : table.n_coef]}
        assert row["both"] == pytest.approx(0.011)
        assert row["J1.phi_rad"] == pytest.approx(0.11 - 0.011) and row["J2.phi_rad"] == pytest.approx(0.011)


def test_dh_errors_that_act_at_two_places_have_the_tighter_too_and_the_tightest_place_is_named(arm):
    flown, table = poses.flown_of(arm, 0.1), codec.new("terms")
    flown.space.verified[1].phi_rad = 0.02
    for order in ((0, 1), (1, 0)):
        for k, frame in enumerate(order):
            row = table.term[k]
            row.coef, row.frame, row.comp, row.gain = 0, frame, RZ, 1.0
        table.n_term, table.n_coef = 2, 1
        assert shared_bounds(flown, table, {}) == pytest.approx([0.022])
        assert tightest(flown, table, 0, -0.05) == ((1, RZ), pytest.approx(0.05), pytest.approx(0.022))
    table.term[0].frame = table.term[1].frame = 1  # both there: their sizes add up
    assert shared_bounds(flown, table, {}) == pytest.approx([0.011])
    assert tightest(flown, table, 0, 0.05)[1] == pytest.approx(0.1)
    table.term[0].frame, table.term[2].frame, table.term[3].frame = 0, 0, 1  # two coefficients at both places
    for row in table.term[2:4]:
        row.coef, row.comp, row.gain = 1, RZ, 1.0
    table.n_term, table.n_coef = 4, 2
    assert shared_bounds(flown, table, {}) == pytest.approx([0.011, 0.011])


# ------------------------------------------------------------------------ too many


def leaving(error):
    """name -> words of its line in the table of what leaves first."""
    head, rows = "each coefficient\n", error.todo
    lines = rows.partition(head)[2].partition("\n  add to the command")[0].splitlines()
    return {line.split()[0]: line.split()[1:] for line in lines}


def test_before_a_fit_the_largest_effects_are_named_first_with_their_sizes(arm, flown):
    effects = [effect("few[1]", 3), effect("many[1]", 17), effect("few[2]", 3), effect("many[2]", 17)]
    error = refusal(arm, effects, flown)
    assert "needs 68 coefficients (28 of DH errors, 40 of effects) and 68 terms" in error.what
    assert error.todo.endswith("coefficients by effect: many 34, few 6")
    assert refusal(arm, effects, flown, wb.ModelFile()).todo == error.todo


def test_what_the_poses_show_least_leaves_first_and_only_until_the_others_have_room(arm, flown):
    a, b, c = effect("a", 20), effect("b", 10), effect("c", 8)
    error = refusal(arm, [b, a, c], flown, fitted({a: 3.0, b: 2.0, c: 1.0}))
    rows = leaving(error)
    assert list(rows) == ["c", "b", "a"]
    assert rows["c"] == ["8", "8", "8.0", "1.0", "leave", "out"]
    assert rows["b"] == ["10", "10", "40.0", "4.0"]
    assert rows["a"] == ["20", "20", "180.0", "9.0"]
    assert "add to the command: --drop c\n" in error.todo
    assert uplink.term_table(arm, [b, a], flown, fitted({a: 3.0, b: 2.0})).n_coef == 58


def test_one_more_leaves_where_the_first_does_not_make_room_enough(arm, flown):
    a, b, c = effect("a", 30), effect("b", 5), effect("c", 3)
    error = refusal(arm, [a, b, c], flown, fitted({a: 3.0, b: 2.0, c: 1.0}))
    assert "--drop c\n" in error.todo  # 38 - 3 of 36
    a, b, c = effect("a", 30), effect("b", 7), effect("c", 1)
    error = refusal(arm, [a, b, c], flown, fitted({a: 3.0, b: 2.0, c: 1.0}))
    assert "--drop b\n" in error.todo, "c comes back where b has made room"


def test_what_left_for_its_size_comes_back_where_one_without_room_leaves(arm, flown):
    a, b, wide = effect("a", 30), effect("b", 3), effect("wide", 8, 0, RZ)
    model = fitted({b: 1.0, a: 2.0, wide: 3.0})
    assert "--drop b --drop wide\n" not in refusal(arm, [a, b, wide], flown, model).todo
    model = with_value(model, "wide.c0", 0.5)
    error = refusal(arm, [a, b, wide], flown, model)
    assert "add to the command: --drop wide\n" in error.todo
    assert [name for name, words in leaving(error).items() if "out" in words] == ["wide"]


def test_terms_are_counted_beside_coefficients(arm, flown):
    most = FLIGHT.lib.KC_TERM_MAX
    for n in (most - 28, most - 27):
        terms = tuple(Term("tool", TX, 1.0, ()) for _ in range(n))
        h = Hypothesis("h", "h", (Parameter("c", "m", 1e-6, terms),))
        if n == most - 28:
            assert uplink.term_table(arm, [h], flown).n_term == most
        else:
            assert (
                f"29 coefficients (28 of DH errors, 1 of effects) and {most + 1} terms"
                in refusal(arm, [h], flown).what
            )


# ------------------------------------------------------------------------ sizes and names on board


def test_priors_and_scales_on_board_are_those_of_the_shipped_table(arm, flown):
    shipped = codec.decode_as("terms", (BIN / "terms.tbl").read_bytes())[1]
    table = uplink.term_table(arm, [], flown)
    assert [(c.scale, c.prior_sigma) for c in table.coef[0:28]] == [
        (c.scale, c.prior_sigma) for c in shipped.coef[0:28]
    ]


def test_an_effect_of_several_parameters_names_each_and_keeps_the_prior_that_data_chose(arm, flown):
    h = effect("ripple[2]", 2, sigma=2e-6)
    table = uplink.term_table(arm, [h], flown)
    assert [FLIGHT.text(c.name) for c in table.coef[28:30]] == ["ripple[2].c0", "ripple[2].c1"]
    assert [c.prior_sigma for c in table.coef[28:30]] == pytest.approx([6e-6] * 2)
    shrunk = Hypothesis("s", "s", (Parameter("c", "m", 2e-6, (Term("tool", TX, 1.0, ()),), shrunk=True),))
    row = uplink.term_table(arm, [shrunk], flown).coef[28]
    assert (row.prior_sigma, row.scale) == pytest.approx((2e-6, 2e-6))
    assert np.isfinite(row.ub)


def test_a_longer_unnamed_name_keeps_its_end():
    longest = FLIGHT.lib.KC_NAME_LEN - 1
    long = uplink.flight_name("unnamed[camera translation: temp, q12]", "coefficient12", False)
    assert long == "Ct:temp,q12.coefficient12"[-longest:] and len(long) == longest
    assert uplink.flight_name("unnamed[base tilt: q1]", "p", True) == "Br:q1.p"
