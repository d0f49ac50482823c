"""Tables: TOML sources, images, and their comparison. Oracle of the format: struct and zlib."""

import math
import struct
import tomllib
import zlib
from pathlib import Path

import pytest
from places import BIN, SRC

from kincal import tables
from kincal.cli.errors import EXIT_INPUT, exit_status
from kincal.flight import event_line, library
from kincal.flight import tables as codec
from kincal_shared.errors import BadInput, KincalError

FLIGHT = library("flight")
QUICK = ("arm", "camera", "terms", "kin", "kernel", "config")


def changed(tmp_path: Path, name: str, old: str, new: str) -> Path:
    """A copy of a source with one piece of text replaced."""
    text = (SRC / f"{name}.toml").read_text()
    assert old in text
    path = tmp_path / f"{name}.toml"
    path.write_text(text.replace(old, new, 1))
    return path


@pytest.mark.parametrize("kind", QUICK)
def test_committed_image_is_what_its_source_builds(kind):
    assert tables.build(SRC / f"{kind}.toml").data == (BIN / f"{kind}.tbl").read_bytes()


@pytest.mark.parametrize("kind", codec.kinds())
def test_header_says_what_the_file_is(kind):
    data = (BIN / f"{kind}.tbl").read_bytes()
    magic, number, version, size, crc = struct.unpack("<4sHHII", data[:16])
    of_kind = library("flight").lib.kc_layout_version(codec.kinds()[kind])
    assert of_kind == {"camera": 2, "space": 2, "config": 2}.get(kind, 1)
    assert (magic, number, version, size) == (b"KCT1", codec.kinds()[kind], of_kind, len(data) - 16)
    assert crc == zlib.crc32(data[16:])
    assert codec.header(data).crc == crc


def test_arm_image_holds_the_numbers_of_its_source_little_endian():
    data = (BIN / "arm.tbl").read_bytes()
    with (SRC / "arm.toml").open("rb") as file:
        joints = tomllib.load(file)["joint"]
    for joint in joints:
        d_and_limits = struct.pack("<3d", joint["d_m"], joint["q_min"], joint["q_max"])
        assert d_and_limits in data


@pytest.mark.parametrize("kind", QUICK)
def test_reading_and_writing_again_gives_the_same_bytes(kind):
    image, decoded = tables.load(BIN / f"{kind}.tbl")
    again = codec.new(kind)
    codec.fill(again, codec.to_doc(decoded), "test")
    assert codec.encode(kind, again).data == image.data


def test_dh_block_is_the_cores_own_list_of_dh_errors():
    """But for the bounds, which the core takes the same for all joints."""
    bound = FLIGHT.ffi.new("double[4]", [1.5, 0.6, 0.05, 0.2])
    want = FLIGHT.ffi.new("kc_terms_t *")
    assert FLIGHT.lib.kc_terms_add_dh(want, 7, bound) == 0
    _, got = tables.load(BIN / "terms.tbl")
    for i in range(28):
        a, b = got.coef[i], want.coef[i]
        assert FLIGHT.ffi.string(a.name) == FLIGHT.ffi.string(b.name)
        assert (a.lb, a.enabled) == (-a.ub, 1)
        s, t = got.term[i], want.term[i]
        assert (s.coef, s.frame, s.comp, s.gain) == (t.coef, t.frame, t.comp, t.gain)


def test_bounds_of_dh_errors_are_those_of_the_search_space_and_a_tenth_more():
    _, got = tables.load(BIN / "terms.tbl")
    with open(SRC / "space.toml", "rb") as f:
        bounds = tomllib.load(f)["error_bounds"]
    for j in range(7):
        for k, name in enumerate(("phi_rad", "alpha_rad", "a_m", "d_m")):
            assert got.coef[4 * j + k].ub == pytest.approx(1.1 * bounds[name][j]), (j, name)


def test_one_dh_bound_stands_for_all_joints_and_a_list_for_each(tmp_path):
    image = tables.build(changed(tmp_path, "terms", "alpha_rad = 0.44", "alpha_rad = 0.3"))
    _, got = codec.decode(image.data, "here")
    assert [got.coef[4 * j + 1].ub for j in range(7)] == [0.3] * 7


def test_per_joint_coefficients_act_before_their_joint():
    _, terms = tables.load(BIN / "terms.tbl")
    names = [FLIGHT.ffi.string(terms.coef[i].name).decode() for i in range(terms.n_coef)]
    at = names.index("joint_compliance[4]")
    term = next(t for t in terms.term[0 : terms.n_term] if t.coef == at)
    assert (term.frame, term.comp) == (3, FLIGHT.lib.KC_RZ)
    assert (term.basis[0].var, term.basis[0].index) == (FLIGHT.lib.KC_VAR_TAU, 4)
    assert len(names) <= 64
    assert not terms.coef[at].enabled


def test_kernel_sets_are_the_grid_with_unit_variance_at_zero_distance():
    _, kernel = tables.load(BIN / "kernel.tbl")
    assert kernel.n_hyper == 1 + 3 * 2 * 2 * 2
    for h in kernel.hyper[0 : kernel.n_hyper]:
        # U_n(1) = n + 1
        assert math.isclose(sum((n + 1) * h.w[n] for n in range(h.n_w)), 1.0, rel_tol=1e-9)


@pytest.mark.parametrize(
    ("kind", "old", "new", "what"),
    [
        ("arm", "q_max = 2.6", "", r"joint\[1\].q_max: is missing"),
        ("arm", "q_max = 2.6", "q_max = 2.6\nqmax = 1", r"joint\[1\].qmax: unknown key; write q_max"),
        ("arm", 'type = "revolute"', 'type = "ball"', 'is "ball"; write "revolute" or "prismatic"'),
        ("arm", "q_max = 2.6", "q_max = -2.7", "q_min: is -2.6, which is not below q_max -2.7"),
        ("arm", "d_m = 0.55", 'd_m = "nan"', "cannot work out"),
        (
            "arm",
            "base_quat_wxyz  = [1.0,",
            "base_quat_wxyz  = [2.0,",
            "base_quat_wxyz: has norm 2, 1 is needed",
        ),
        ("arm", 'name = "WAM-7"', f'name = "{"x" * 30}"', "longer than 23 characters"),
        ("arm", "speed_max = 0.8", "speed_max = -0.8", "refused"),
        ("camera", "id = 1\n", "id = 0\n", "refused"),
        ("camera", "width_px  = 1920", "width_px  = 1920.5", "whole number"),
        ("camera", "pan_min_rad  = -1.6", "pan_min_rad  = 1.7", "pan_min_rad: is 1.7, which is not below"),
        ("config", "n_poses         = 20", "n_poses         = 65", "refused"),
        ("config", "n_poses         = 20", "n_poses         = -1", "n_poses: is -1, must be 0 or more"),
        ("config", "n_poses         = 20", "n_poses         = 5000000000", "does not fit"),
        ("config", "settle_us         = 300000", "settle_s = 0.3", "microseconds: settle_us = 300000"),
        ("config", "iter_max    = 50", "", "est.iter_max: is missing"),
        ("config", "free_mask   = 0xffffffffffffffff", "free_mask   = 0", "refused"),
        ("terms", "d_m       = [0.022,", "d         = [0.022,", r"dh.bound.d: unknown key; write d_m"),
        ("terms", "d_m       = [0.022,", "d_m       = [", "dh.bound.d_m: has 6 bounds for 7 joints"),
        ("terms", "alpha_rad = 0.44", "alpha_rad = [0.44]", "has 1 bounds for 7 joints"),
        ("terms", 'at = "tool"', 'at = "elbow"', "at = 'elbow' is no place"),
        ("terms", 'comp = "tx"', 'comp = "xt"', 'is "xt"; write "tx" or "ty"'),
        ("terms", 'basis = "q[j]"', 'basis = "q[i]"', r"term\[1\].basis: names joint i"),
        ("terms", 'basis = "q[j]"', 'basis = "q[j]/$tau"', "uses a constant by name; write its number"),
        ("terms", 'basis = "q[j]"', 'basis = [{ var = "q" }]', "basis: .* a text in quotes is needed"),
        ("kernel", "kappa = 0.3", "kappa = -0.3", r"set\[1\].kappa: is -0.3, must be above 0"),
        ("kin", "n_coef = 54", "n_coef = 65", "n_coef: is 65, must be 64 or less"),
        ("kin", 'kind  = "kin"', 'kind  = "kinn"', "kind: 'kinn' is no kind of table"),
    ],
)
def test_wrong_source_is_refused_with_what_and_where(tmp_path, kind, old, new, what):
    path = changed(tmp_path, kind, old, new)
    with pytest.raises(KincalError, match=what) as error:
        tables.build(path)
    assert str(path) in str(error.value)
    assert exit_status(error.value) == EXIT_INPUT


def test_broken_toml_is_refused(tmp_path):
    path = tmp_path / "arm.toml"
    path.write_text("kind = ")
    with pytest.raises(KincalError, match="not valid TOML"):
        tables.build(path)


def test_more_than_one_problem_of_an_image_is_counted(tmp_path):
    path = changed(tmp_path, "arm", "speed_max = 0.8", "speed_max = -0.8")
    path.write_text(path.read_text().replace("speed_max = 0.8", "speed_max = -0.7", 1))
    with pytest.raises(KincalError) as error:
        tables.build(path)
    assert "TBL_RANGE" in str(error.value)
    assert "TBL_BAD_TOTAL" in str(error.value)


def test_a_refused_number_leads_to_the_page_that_names_its_field(tmp_path):
    """Nobody knows from "field 82" alone that stop_confidence is meant."""
    path = changed(tmp_path, "config", "stop_confidence = 0.9", "stop_confidence = 1.0")
    with pytest.raises(BadInput, match="field 82: value 1 is not allowed") as error:
        tables.build(path)
    assert error.value.todo == "docs/TABLES.md has the fields of CONFIG by their numbers, with their limits"
    page = (SRC.parents[1] / "docs" / "TABLES.md").read_text().split("### 7 CONFIG")[1]
    assert "| 82 | stop_confidence |" in page
    with pytest.raises(BadInput) as error:
        codec.decode(b"KCT1" + bytes(12))
    assert "docs/TABLES.md" not in error.value.todo


def test_space_source_is_left_to_kincal_space():
    with pytest.raises(BadInput, match="not built like other tables") as error:
        tables.build(SRC / "space.toml")
    assert "kincal space build" in error.value.todo
    assert tables.source_kind(SRC / "space.toml") == "space"


def test_terms_are_shown_in_the_grammar_of_their_source():
    _, terms = tables.load(BIN / "terms.tbl")
    doc = tables.readable(terms)
    by_coef = {doc["coef"][t["coef"]]["name"]: t for t in doc["term"]}
    assert by_coef["joint_compliance[4]"] == {
        "coef": 50, "at": "link[3]", "comp": "rz", "gain": 1.0, "basis": "tau4",
    }  # fmt: skip
    assert by_coef["tool.tx_m"]["at"] == "tool"


@pytest.mark.parametrize(
    ("damage", "what"),
    [
        (lambda d: d[:10], "not a table image"), (lambda d: b"XXXX" + d[4:], "not a table image"),
        (lambda d: d[:4] + b"\x63\0" + d[6:], "unknown table kind 99"),
        (lambda d: d[:-1], r"KC_ERR_FORMAT\n.* (\d+) bytes of contents, the file has (?!\1\b)"),
        (lambda d: d + b"\0", r"KC_ERR_FORMAT\n.* (\d+) bytes of contents, the file has (?!\1\b)"),
        (lambda d: d[:-1] + bytes([d[-1] ^ 1]), "KC_ERR_CRC"),
        (lambda d: d[:6] + b"\x02\0" + d[8:], "KC_ERR_FORMAT"),
    ],
)  # fmt: skip
def test_damaged_image_is_refused(damage, what):
    with pytest.raises(KincalError, match=what):
        codec.decode(damage((BIN / "arm.tbl").read_bytes()), "somewhere")


def test_diff_names_the_field_that_differs(tmp_path):
    path = changed(tmp_path, "arm", "d_m = 0.55", "d_m = 0.56")
    a, b, changes = tables.diff(BIN / "arm.tbl", path)
    assert [(c.path, c.a, c.b) for c in changes] == [("joint[2].d_m", 0.55, 0.56)]
    assert a.crc != b.crc


def test_diff_finds_coefficients_by_name(tmp_path):
    path = changed(tmp_path, "terms", "scale = 0.05\nenabled = false", "scale = 0.05\nenabled = true")
    _, _, changes = tables.diff(BIN / "terms.tbl", path)
    assert [c.path for c in changes] == ["coef[base.tx_m].enabled"]


def test_diff_of_two_kinds_is_refused():
    with pytest.raises(KincalError, match="cannot be compared"):
        tables.diff(BIN / "arm.tbl", BIN / "camera.tbl")


def test_event_text_shows_values_and_crcs():
    line = event_line(FLIGHT.lib.KC_EVT_COR_ACTIVE, -1, float(0xDEADBEEF), 0.0)
    assert line == "COR_ACTIVE: correction CRC deadbeef active"
    assert "TERMS table staged, 100 bytes" in event_line(FLIGHT.lib.KC_EVT_TBL_STAGED, 3, 100.0, 0.0)


def test_units_follow_from_names():
    units = {
        n: tables.unit_of(n) for n in ("J1.phi_rad", "J1.a_m", "encoder_gain[2]", "joint_compliance[2]", "x")
    }
    assert list(units.values()) == ["rad", "m", "rad/rad", "rad/(N m)", ""]
