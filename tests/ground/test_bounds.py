"""What TERMS may describe against what SPACE was verified for: the ground's checks before anything is sent,
and the bounds that `kincal model uplink` makes."""

import shutil
import struct
import tomllib
import zlib

import poses
import pytest
from commands import good
from commands import shell as kincal
from places import BIN, SRC

from kincal import workbench as wb
from kincal.cli.errors import EXIT_INPUT
from kincal.flight import library
from kincal.flight import tables as codec
from kincal.workbench.model.uplink import term_table
from kincal_shared.errors import BadInput

SOURCE = tomllib.loads((SRC / "space.toml").read_text())["error_bounds"]
FIELDS = ("phi_rad", "alpha_rad", "a_m", "d_m")
FLIGHT = library("flight")


def bounds_of(table):
    return {FLIGHT.text(c.name): c.ub for c in table.coef[0 : table.n_coef]}


@pytest.fixture(scope="module")
def arm():
    return wb.read_arm("wam")


@pytest.fixture(scope="module")
def effects():
    return wb.Library.load()


# --------------------------------------------------------------------------- the SPACE table


def test_the_space_table_carries_the_error_bounds_of_its_description():
    space = codec.decode_as("space", (BIN / "space.tbl").read_bytes())[1]
    for j in range(7):
        assert [getattr(space.verified[j], f) for f in FIELDS] == [SOURCE[f][j] for f in FIELDS]


def test_a_space_of_the_former_layout_is_refused_by_its_version():
    data = (BIN / "space.tbl").read_bytes()
    payload = data[16 : -7 * 4 * 8]  # as it was before
    former = b"KCT1" + struct.pack("<HHII", 5, 1, len(payload), zlib.crc32(payload)) + payload
    with pytest.raises(BadInput, match="TBL_FORMAT: .*field 2 is 1, expected 2"):
        codec.decode(former)


# --------------------------------------------------------------------------- what uplink makes


def test_dh_bounds_are_those_of_the_space_and_a_tenth(arm):
    table = term_table(arm, [], poses.flown())
    bounds = bounds_of(table)
    for j in range(7):
        for field in FIELDS:
            assert bounds[f"J{j + 1}.{field}"] == pytest.approx(1.1 * SOURCE[field][j])
    shipped = codec.decode_as("terms", (BIN / "terms.tbl").read_bytes())[1]
    assert [c.ub for c in table.coef[0:28]] == pytest.approx([c.ub for c in shipped.coef[0:28]])


def test_an_effect_has_twice_its_fitted_size_and_the_dh_error_there_the_rest(arm, effects):
    flown = poses.flown()
    (h,) = effects.find("backlash[1]", arm, None)
    bounds = bounds_of(term_table(arm, [h], flown, wb.ModelFile(values={"backlash[1].h": (-3e-3, 1e-5)})))
    assert bounds["backlash[1]"] == pytest.approx(6e-3)
    assert bounds["J1.phi_rad"] == pytest.approx(0.11 - 6e-3)
    assert bounds["J2.phi_rad"] == pytest.approx(0.11)
    small = bounds_of(term_table(arm, [h], flown, wb.ModelFile(values={"backlash[1].h": (1e-6, 1e-5)})))
    assert small["backlash[1]"] == pytest.approx(3e-3)  # three typical sizes
    unfitted = bounds_of(term_table(arm, [h], flown))
    assert unfitted["backlash[1]"] == pytest.approx(30e-3)


def test_an_effect_gets_half_of_what_is_allowed_at_most(arm, effects):
    flown = poses.flown()
    (h,) = effects.find("joint_compliance[4]", arm, None)
    table = term_table(arm, [h], flown)
    torque = flown.size(table, 28)
    assert 6.0 < torque < 12.0  # N m about the elbow of this arm
    assert bounds_of(table)["joint_compliance[4]"] == pytest.approx(min(30 * 2e-4, 0.055 / torque))
    (h,) = effects.find("joint_compliance[2]", arm, None)
    table = term_table(arm, [h], flown)
    assert bounds_of(table)["joint_compliance[2]"] == pytest.approx(0.055 / flown.size(table, 28))
    assert bounds_of(table)["J2.phi_rad"] == pytest.approx(0.055)


def test_an_effect_that_the_space_was_not_verified_for_is_refused_with_both_numbers(arm, effects):
    (h,) = effects.find("joint_compliance[2]", arm, None)
    model = wb.ModelFile(values={"joint_compliance[2].c": (3e-3, 1e-5)})
    with pytest.raises(
        BadInput,
        match=r"joint_compliance\[2\]\.c of 0\.003 .* rad about z of frame 1 \(J2\.phi_rad\).* 0\.11,",
    ):
        term_table(arm, [h], poses.flown(), model)


def test_a_space_that_was_verified_for_no_such_error_leaves_none(arm, effects):
    flown = poses.flown_of(arm, 0.1)
    flown.space.verified[2].phi_rad = 0.0
    table = term_table(arm, [], flown)
    row = next(c for c in table.coef[0:28] if FLIGHT.text(c.name) == "J3.phi_rad")
    assert (row.lb, row.ub, row.enabled) == (0.0, 0.0, 0)
    with pytest.raises(BadInput, match=r"backlash\[3\]"):
        term_table(arm, effects.find("backlash[3]", arm, None), flown)


def test_every_effect_of_the_library_flies_inside_what_was_verified(arm, effects):
    """Not fitted, at a joint or all of them, as far as flight has room."""
    flown, tried = poses.flown(), 0
    for name in effects.effects:
        try:
            found = effects.find(name, arm, None)
        except BadInput:  # needs what no arm table states, or data
            continue
        for h in found[:1]:
            try:
                table = term_table(arm, [h], flown)
            except BadInput as error:  # effects of a camera with many points, of an arm not at rest
                of_last_move = name in ("joint_settling", "measurement_lag")
                assert "acts through all points" in str(error) or of_last_move, name
                continue
            assert flown.excess(table) is None, name
            tried += 1
    assert tried > 15


# --------------------------------------------------------------------------- before sending


@pytest.fixture
def folder(tmp_path):
    shutil.copytree(BIN, tmp_path / "bin")
    return tmp_path / "bin"


def widened(folder, coefficient, ub):
    table = codec.decode_as("terms", (folder / "terms.tbl").read_bytes())[1]
    (row,) = (c for c in table.coef[0 : table.n_coef] if FLIGHT.text(c.name) == coefficient)
    row.ub, row.enabled = ub, 1
    path = folder / "wide.tbl"
    path.write_bytes(codec.encode("terms", table).data)
    return path


def test_check_refuses_wide_terms_with_the_coefficient_and_both_numbers(folder):
    done = kincal("table", "check", widened(folder, "J4.phi_rad", 1.5))
    assert done.exit_code == EXIT_INPUT
    assert "with J4.phi_rad the arm may be off by 1.5 rad about z of frame 3 (J4.phi_rad)" in done.stderr
    assert "verified for 0.1" in done.stderr


def test_check_refuses_an_effect_beside_dh_errors_at_their_bounds(folder):
    done = kincal("table", "check", widened(folder, "encoder_gain[5]", 0.01))
    assert done.exit_code == EXIT_INPUT
    assert "with encoder_gain[5] the arm may be off by 0.641 rad about z of frame 4" in done.stderr


def test_check_refuses_a_space_that_is_too_narrow(folder, tmp_path):
    space = codec.decode_as("space", (BIN / "space.tbl").read_bytes())[1]
    space.verified[4].d_m = 0.1
    path = tmp_path / "narrow.tbl"
    path.write_bytes(codec.encode("space", space).data)
    done = kincal("table", "check", path, "--tables", folder)
    assert done.exit_code == EXIT_INPUT
    assert "J5.d_m the arm may be off by 0.165 m along z" in done.stderr and "for 0.1" in done.stderr


def test_check_says_with_what_it_compared(folder, tmp_path):
    assert (
        f"bounds agree with {folder / 'space.tbl'}" in kincal("table", "check", folder / "terms.tbl").output
    )
    assert (
        f"bounds agree with {folder / 'terms.tbl'}" in kincal("table", "check", folder / "space.tbl").output
    )
    lone = tmp_path / "terms.tbl"
    shutil.copy(folder / "terms.tbl", lone)
    done = good("table", "check", lone)
    assert f"not compared: {tmp_path} holds no arm.tbl and no space.tbl" in done.output
    (folder / "arm.tbl").unlink()
    assert "holds no arm.tbl" in kincal("table", "check", folder / "terms.tbl").output


def test_a_space_of_another_arm_table_is_not_compared(folder):
    arm = codec.decode_as("arm", (folder / "arm.tbl").read_bytes())[1]
    arm.joint[0].mass_kg += 1.0
    (folder / "arm.tbl").write_bytes(codec.encode("arm", arm).data)
    assert "for another arm table" in kincal("table", "check", folder / "terms.tbl").output


def test_uplink_compares_before_it_sends(folder):
    wide = widened(folder, "J1.d_m", 0.2)
    done = kincal("table", "uplink", wide, "--url", "udpm://239.255.76.67:1?ttl=0")
    assert done.exit_code == EXIT_INPUT
    assert "terms table refused beside" in done.stderr and "J1.d_m" in done.stderr
