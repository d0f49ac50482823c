"""What a correction changes, in degrees and millimetres: a proposal, a rollback."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from places import BIN
from samples import CRC, NAMES, proposal, sealed, write_log

from kincal import review
from kincal.api import previews
from kincal.flight import Arm, library, tables
from kincal.flight.tables import decode_as
from kincal.pages import review as review_page
from kincal.pages.page import Provenance
from kincal.review import changes, warnings
from kincal.review.changes import KinValues, amount, of_review, of_rollback, of_values
from kincal.review.status import Status
from kincal.rotations import angle_of_matrix
from kincal_shared.errors import BadInput


@pytest.fixture(scope="module")
def flown():
    return changes.Flown(BIN)


def kin_image(values, before=0):
    """A KIN table with these values."""
    kin = library("flight").new("kc_kin_t")
    image, terms = decode_as("terms", (BIN / "terms.tbl").read_bytes())
    arm = decode_as("arm", (BIN / "arm.tbl").read_bytes())[0]
    kin.n_coef, kin.prev_crc = terms.n_coef, before
    kin.arm_crc, kin.terms_crc = arm.crc, image.crc
    for i, value in enumerate(values):
        kin.value[i] = value
    return tables.encode("kin", kin)


def in_force(kin):
    """CRCs of the tables in force: only the kinematics table is known, so that no clearance is computed."""
    return [0, 0, 1, 0, kin, 0, 0, 0]  # another CAMERA


def row(found, name):
    return next(r for r in found.rows if r.name == name)


def big_proposal(index=24, value=1.3):
    p = proposal()
    p.value[index] = value
    return sealed(p)


def test_a_joint_that_is_74_degrees_off_stands_out_first(flown):
    r = review.from_message(big_proposal(), review.coef_names(BIN))
    old = KinValues(0x1234, (0.0,) * 54)
    found = of_review(r, old, flown)
    assert found.rows[0].name == "J7.phi_rad"
    assert found.headline.startswith("Joint 7 is 74 deg off; the tool moves by up to ")
    assert found.big == ("joint 7 is 74 deg off",)
    assert "joint 7 is 74 deg off" in warnings(r, found.big)


def test_what_is_small_does_not_stand_out_and_is_still_named(flown):
    r = review.from_message(proposal(), review.coef_names(BIN))
    found = of_review(r, KinValues(0x1234, (0.0,) * 54), flown)
    assert found.big == () and found.headline.startswith("Largest change: J")


def test_a_value_is_shown_old_and_new_with_sigma_share_and_source(flown):
    p = proposal()
    r = review.from_message(p, review.coef_names(BIN))
    old = [0.0] * 54
    old[0] = -0.01
    first = row(of_review(r, KinValues(1, tuple(old)), flown), "J1.phi_rad")
    assert first.old_text == f"{math.degrees(-0.01):.3f} deg"
    sigma = amount(p.sigma[0], "rad")
    assert first.new_text == f"{math.degrees(-0.02):.3f} deg ± {sigma}"
    assert first.delta_text == f"{math.degrees(-0.01):+.3f} deg"
    assert (first.share_text, first.source, first.joint) == ("18%", "data", 1)
    assert first.share == pytest.approx(0.02 / 0.11)


@pytest.mark.parametrize(
    ("status", "sigma", "prior", "text"),
    [
        ("estimated", 0.1, 0.0, "data"), ("estimated", 0.1, 1.0, "data"),
        ("estimated", 0.5, 1.0, "data 75%, prior"), ("estimated", 0.99, 1.0, "prior"),
        ("estimated", 2.0, 1.0, "prior"), ("at upper bound", 0.1, 0.0, "data, at upper bound"),
        ("held", 0.0, 1.0, "held: kept as it was"), ("masked", 0.0, 0.0, "masked: kept as it was"),
    ],
)  # fmt: skip
def test_a_value_rests_on_data_or_on_its_prior(status, sigma, prior, text):
    assert changes._source(status, sigma, prior) == text


def test_the_tool_goes_where_the_model_of_flight_says(flown):
    new = [0.0] * flown.terms.n
    new[0] = 0.1  # joint 1 turns about the vertical axis of the base
    shifts = flown.shifts([0.0] * flown.terms.n, new)
    names, q = flown.places
    assert names[0] == "park pose" and len(shifts) == len(names) == len(q)
    assert all(s.rot_rad == pytest.approx(0.1, abs=1e-6) for s in shifts)
    arm = decode_as("arm", (BIN / "arm.tbl").read_bytes())[1]
    plain = Arm.of_table(arm).fk(q)
    turned = q.copy()
    turned[:, 0] += 0.1
    after = Arm.of_table(arm).fk(turned)
    assert np.allclose([s.vector_m for s in shifts], after.p_m - plain.p_m, atol=1e-9)
    assert np.allclose([s.rot_rad for s in shifts], angle_of_matrix(plain.R.transpose(0, 2, 1) @ after.R))


def test_the_space_is_summed_up_and_its_worst_place_named(flown):
    r = review.from_message(big_proposal(0, 0.1), review.coef_names(BIN))
    found = of_review(r, KinValues(1, (0.0,) * 54), flown)
    over = [s for s in flown.shifts([0.0] * 54, [c.value for c in r.coefs]) if s.place.startswith("cand")]
    assert found.space[1] == pytest.approx(max(s.pos_m for s in over))
    assert found.space[0] == pytest.approx(math.sqrt(sum(s.pos_m**2 for s in over) / len(over)))
    assert found.tool[-1].pos_m == found.space[1] and found.tool[-1].place.startswith("candidate")
    assert [t.place for t in found.tool[:2]] == ["park pose", "hub 1"]


def test_without_the_table_before_that_is_said_and_nothing_is_invented(flown):
    r = review.from_message(proposal(), review.coef_names(BIN))
    found = of_review(r, None, flown)
    assert not found.old_known and found.tool == () and found.space is None
    assert row(found, "J1.phi_rad").old_text == "?"
    bare = of_review(r, None, None)
    assert row(bare, "J1.phi_rad").share_text == "-"


def test_what_the_poses_do_not_tell_apart_or_determine_is_named():
    p = proposal()
    r = review.from_message(p, review.coef_names(BIN))
    tight = r.correlation.copy()
    tight[:] = np.eye(len(tight))
    tight[0, 3] = tight[3, 0] = -0.97
    tight[1, 2] = tight[2, 1] = 0.999
    tight[4, 5] = tight[5, 4] = 0.94
    found = of_review(replace(r, correlation=tight), None, None)
    assert found.correlations == (("J1.alpha_rad", "J1.a_m", 0.999), ("J1.phi_rad", "J1.d_m", -0.97))
    assert found.undetermined == ("J7.a_m",)


def test_reasons_against_come_with_number_and_threshold():
    p = proposal(verdict=2)
    p.p_fit, p.fit_pos_m, p.before_pos_m = 1e-9, 0.004, 0.003
    found = of_review(review.from_message(p, review.coef_names(BIN)), None, None)
    text = [reason.text for reason in found.reasons]
    assert text[0] == "flight itself calls the fit poor"
    assert "p_fit is 1e-09, has to be at least 0.001" in text
    assert "fit_pos_m is 4.00 mm, has to be below before_pos_m" in text
    assert "rank is 27, has to be all 28 asked for" in text


# ---------------------------------------------------------------------------- old values


def test_old_values_are_found_by_their_crc_in_tables_folders_and_logs(tmp_path):
    image = kin_image([0.01] * 3)
    (tmp_path / "tables").mkdir()
    (tmp_path / "tables" / "kin.tbl").write_bytes(image.data)
    (tmp_path / "broken.tbl").write_bytes(b"KCT1 no")
    (tmp_path / "no.lcmlog").write_bytes(b"")
    write_log(tmp_path / "run.lcmlog")
    places = [tmp_path / n for n in ("missing.tbl", "broken.tbl", "no.lcmlog", "tables", "run.lcmlog")]
    assert changes.kin_values(image.crc, places).values[:3] == (0.01,) * 3
    found = changes.kin_values(CRC, places)
    assert found.where.endswith("run.lcmlog")
    assert changes.kin_values(CRC, [tmp_path]).crc == CRC
    assert changes.kin_values(0x999, places) is None


def test_a_rollback_is_shown_before_it_is_sent(tmp_path):
    first = kin_image([0.02])
    second = kin_image([1.3 if n == "J7.phi_rad" else 0.0 for n in NAMES], before=first.crc)
    for name, image in (("first", first), ("second", second)):
        (tmp_path / f"{name}.tbl").write_bytes(image.data)
    places = (tmp_path / "first.tbl", tmp_path / "second.tbl")
    back = previews.what_rolls_back(in_force(second.crc), first.crc, BIN, places)
    found = back.changes
    assert back.corrected is None and "CAMERA 00000001 is in force" in back.why_not
    assert [r.name for r in found.rows] == ["J7.phi_rad", "J1.phi_rad"]
    assert row(found, "J7.phi_rad").delta_text == f"{math.degrees(-1.3):+.3f} deg"
    assert found.headline.startswith("J7.phi_rad goes back by -74 deg; the tool moves by up to")
    with pytest.raises(BadInput, match=f"holds no table before {second.crc:08x} and refuses to roll back"):
        previews.what_rolls_back(in_force(second.crc), 0, BIN, places)
    with pytest.raises(BadInput, match=f"brings back {first.crc:08x}, whose values are in none"):
        previews.what_rolls_back(in_force(second.crc), first.crc, BIN, (tmp_path / "second.tbl",))
    with pytest.raises(BadInput, match="are in none of the places"):
        previews.what_rolls_back(in_force(0x77), first.crc, BIN)


def test_a_rollback_goes_by_what_flight_holds_and_not_by_the_record_of_the_table(tmp_path):
    """A KIN table that was uplinked replaces whatever was in force, not what it says it replaced."""
    nominal = decode_as("kin", (BIN / "kin.tbl").read_bytes(), "")[0]
    held, uplinked = kin_image([0.02]), kin_image([0.01], before=nominal.crc)
    for name, image in (("held", held), ("uplinked", uplinked)):
        (tmp_path / f"{name}.tbl").write_bytes(image.data)
    places = (tmp_path / "held.tbl", tmp_path / "uplinked.tbl")
    found = previews.what_rolls_back(in_force(uplinked.crc), held.crc, BIN, places).changes
    assert row(found, "J1.phi_rad").delta_text == f"{math.degrees(0.01):+.3f} deg"


def test_the_same_table_changes_nothing():
    values = KinValues(1, (0.1, 0.2))
    found = of_rollback(values, values, ["a", "b"], None)
    assert found.rows == () and found.headline == "Nothing changes"


def test_values_alone_are_enough_to_see_what_changes(flown):
    found = of_values(
        [0.1, 0.0], [0.001, 0.0], KinValues(1, (0.05, 0.0)), ["J1.phi_rad", "J1.alpha_rad"], flown
    )
    assert [r.name for r in found.rows] == ["J1.phi_rad"]
    assert found.rows[0].source == "data" and found.old_known


# ---------------------------------------------------------------------------- one function for all


def test_page_text_and_json_say_the_same(flown):
    r = review.from_message(big_proposal(), review.coef_names(BIN))
    found = of_review(r, KinValues(0x1234, (0.0,) * 54), flown)
    about = Status("waits for review", True, False, (), True)
    page = review_page.page(r, [], Provenance("now"), about, None, (), found)
    assert page.summary[0] == f"{found.headline}."
    grid = next(s.grid for s in page.sections if s.key == "changes")
    assert [c.text for c in grid.rows[0]][:4] == [
        "J7.phi_rad", "0.000 deg", found.rows[0].new_text, "+74.485 deg",
    ]  # fmt: skip
    assert next(s for s in page.sections if s.key == "tool").grid.rows[0][0].text == "park pose"
    data = json.loads(json.dumps(found.as_dict()))
    assert data["headline"] == found.headline
    assert data["rows"][0]["delta_text"] == found.rows[0].delta_text


# ---------------------------------------------------------------------------- in words and figures


@pytest.mark.parametrize(
    ("value", "unit", "options", "text"),
    [
        (math.radians(1.5), "rad", {}, "1.500 deg"),
        (math.radians(9.94), "rad", {"short": True}, "9.9 deg"),
        (math.radians(-10.0), "rad", {"short": True}, "-10 deg"),
        (math.radians(12.6), "rad", {"short": True, "sign": True}, "+13 deg"),
        (0.01, "m", {"short": True}, "10 mm"),
        (0.00994, "m", {"short": True}, "9.94 mm"),
        (-0.0126, "m", {"short": True, "sign": True}, "-13 mm"),
        (0.0126, "m", {"sign": True}, "+12.60 mm"),
        (0.00012345, "1/N", {}, "0.0001234 1/N"),
        (0.5, "", {"sign": True}, "+0.5"),
    ],
)
def test_an_amount_is_in_degrees_or_millimetres(value, unit, options, text):
    assert amount(value, unit, **options) == text


@pytest.mark.parametrize(
    ("name", "old", "new", "big", "sentence"),
    [
        ("J2.phi_rad", 0.0, changes.BIG_RAD, True, "joint 2 is 3.0 deg off"),
        ("J2.alpha_rad", 0.01, 0.0, False, "link 2 is twisted by 0.6 deg"),
        ("J2.a_m", 0.05, 0.025, True, "link 2 is 25 mm off in length"),
        ("J2.d_m", 0.0, -0.0249, False, "link 2 is 25 mm off along its joint axis"),
        ("J2.d_m", None, 0.03, True, "link 2 is 30 mm off along its joint axis"),
        ("J2.x_m", 0.0, 0.001, False, "J2.x_m changes by 1.00 mm"),
        ("base.tx_m", 0.0, 0.001, False, "base.tx_m changes by 1.00 mm"),
        ("encoder_gain[2]", 0.0, 9.0, False, "encoder_gain[2] changes by 9 rad/rad"),
    ],
)
def test_what_a_change_means_for_the_arm(name, old, new, big, sentence):
    found = changes._change(name, old, new, 0.0, 0.0, "")
    assert (found.big, found.sentence) == (big, sentence)
    assert found.joint == (2 if name.startswith("J2.") else 0)
    assert found.delta == new - (old or 0.0) and found.share_text == "-"


def test_a_headline_names_four_of_the_large_changes_the_largest_first():
    names = [f"J{j}.a_m" for j in range(1, 7)] + ["encoder_gain[1]"]
    before, after = KinValues(1, (0.0,) * 7), [0.03, 0.04, 0.05, 0.06, 0.07, 0.001, 0.5]
    found = of_values(after, [0.0] * 7, before, names, None)
    assert [r.name for r in found.rows] == [names[i] for i in (4, 3, 2, 1, 0, 5, 6)]
    assert len(found.big) == 5 and found.headline.startswith("Link 5 is 70 mm off in length, link 4 is 60 mm")
    assert found.headline.endswith("link 2 is 40 mm off in length, and 1 more")
    four = of_values(after[:4], [0.0] * 4, before, names, None)
    assert four.headline.endswith("link 1 is 30 mm off in length")


def test_a_table_of_fewer_coefficients_has_zero_for_the_others():
    assert changes.padded((1.0, 2.0), 3).tolist() == [1.0, 2.0, 0.0]
    assert changes.padded((1.0, 2.0), 1).tolist() == [1.0]
    r = review.from_message(proposal(), review.coef_names(BIN))
    found = of_review(r, KinValues(1, (0.5,)), None)
    assert [row(found, n).old for n in ("J1.phi_rad", "J1.alpha_rad")] == [0.5, 0.0]
    back = of_rollback(KinValues(2, (0.1,)), KinValues(1, (0.0, 0.2)), ["a"], None)
    assert {(r.name, r.old, r.new) for r in back.rows} == {("a", 0.1, 0.0), ("coef[1]", 0.0, 0.2)}


def test_coefficients_that_correlate_by_95_per_cent_are_named():
    r = review.from_message(proposal(), review.coef_names(BIN))
    tight = np.eye(len(r.correlation))
    tight[0, 1] = tight[1, 0] = 0.95
    tight[2, 3] = tight[3, 2] = 0.9499
    found = of_review(replace(r, correlation=tight), None, None).correlations
    assert found == (("J1.phi_rad", "J1.alpha_rad", 0.95),)
