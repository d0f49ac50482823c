"""Tables: TOML sources, images, and their comparison. Oracle of the format: struct and zlib."""

import math
import struct
import tomllib
import zlib
from pathlib import Path

import pytest

from kincal import core, tables
from kincal.errors import EXIT_INPUT, KincalError

ROOT = Path(__file__).resolve().parents[2]
SRC = ROOT / "tables" / "src"
BIN = ROOT / "tables" / "bin"
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


@pytest.mark.parametrize("kind", tables.KINDS)
def test_header_says_what_the_file_is(kind):
    data = (BIN / f"{kind}.tbl").read_bytes()
    magic, number, version, size, crc = struct.unpack("<4sHHII", data[:16])
    assert (magic, number, version, size) == (b"KCT1", tables.KINDS[kind], 1, len(data) - 16)
    assert crc == zlib.crc32(data[16:])
    assert tables.header(data).crc == crc


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
    again = core.ffi.new(f"{tables.CTYPES[kind]} *")
    tables.fill(again, tables.to_doc(decoded), "test")
    assert tables.encode(kind, again).data == image.data


def test_dh_block_is_the_cores_own_list_of_dh_errors():
    """But for the bounds, which the core takes the same for all joints."""
    bound = core.ffi.new("double[4]", [1.5, 0.6, 0.05, 0.2])
    want = core.ffi.new("kc_terms_t *")
    assert core.lib.kc_terms_add_dh(want, 7, bound) == 0
    _, got = tables.load(BIN / "terms.tbl")
    for i in range(28):
        a, b = got.coef[i], want.coef[i]
        assert core.ffi.string(a.name) == core.ffi.string(b.name)
        assert (a.lb, a.enabled) == (-a.ub, 1)
        s, t = got.term[i], want.term[i]
        assert (s.coef, s.frame, s.comp, s.gain) == (t.coef, t.frame, t.comp, t.gain)


def test_bounds_of_dh_errors_are_what_the_search_space_was_proven_for_and_a_tenth_more():
    _, got = tables.load(BIN / "terms.tbl")
    with open(SRC / "space.toml", "rb") as f:
        survive = tomllib.load(f)["survive"]
    for j in range(7):
        for k, name in enumerate(("phi_rad", "alpha_rad", "a_m", "d_m")):
            assert got.coef[4 * j + k].ub == pytest.approx(1.1 * survive[name][j]), (j, name)


def test_one_dh_bound_stands_for_all_joints_and_a_list_for_each(tmp_path):
    image = tables.build(changed(tmp_path, "terms", "alpha_rad = 0.44", "alpha_rad = 0.3"))
    _, got = tables.decode(image.data, "here")
    assert [got.coef[4 * j + 1].ub for j in range(7)] == [0.3] * 7


def test_per_joint_coefficients_act_before_their_joint():
    _, terms = tables.load(BIN / "terms.tbl")
    names = [core.ffi.string(terms.coef[i].name).decode() for i in range(terms.n_coef)]
    at = names.index("joint_compliance[4]")
    term = next(t for t in terms.term[0 : terms.n_term] if t.coef == at)
    assert (term.frame, term.comp) == (3, core.lib.KC_RZ)
    assert (term.basis[0].var, term.basis[0].index) == (core.lib.KC_VAR_TAU, 4)
    assert len(names) <= 64
    assert not terms.coef[at].enabled


def test_kernel_sets_are_the_grid_with_unit_variance_at_zero_distance():
    _, kernel = tables.load(BIN / "kernel.tbl")
    assert kernel.n_hyper == 1 + 3 * 2 * 2 * 2
    for h in kernel.hyper[0 : kernel.n_hyper]:
        # U_n(1) = n + 1
        assert math.isclose(sum((n + 1) * h.w[n] for n in range(h.n_w)), 1.0, rel_tol=1e-9)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("-pi/2", -math.pi / 2),
        ("25*deg", math.radians(25)),
        ("cos(pi/3)", 0.5),
        ("2**-1", 0.5),
        ("sqrt(2)*1e-3", 1.4142135623730951e-3),
    ],
)
def test_expression_is_worked_out(text, value):
    assert tables.number(text, "") == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize("text", ["__import__('os')", "q", "1/0", "pi(", "(1).real", "10**10**10**10", "[1]"])
def test_expression_that_is_none_is_refused(text):
    with pytest.raises(KincalError, match="cannot work out"):
        tables.number(text, "here")


@pytest.mark.parametrize(
    ("kind", "old", "new", "what"),
    [
        ("arm", "q_max = 2.6", "", "field 'q_max' is missing"),
        ("arm", "q_max = 2.6", "q_max = 2.6\nqmax = 1", "unknown field 'qmax'"),
        ("arm", 'type = "revolute"', 'type = "ball"', "none of revolute, prismatic"),
        ("arm", "q_max = 2.6", "q_max = -2.7", "refused"),
        ("arm", "d_m = 0.55", 'd_m = "nan"', "cannot work out"),
        ("arm", "base_quat_wxyz  = [1.0,", "base_quat_wxyz  = [2.0,", "refused"),
        ("arm", 'name = "WAM-7"', f'name = "{"x" * 30}"', "longer than 23 characters"),
        ("camera", "id = 1\n", "id = 0\n", "refused"),
        ("camera", "width_px  = 1920", "width_px  = 1920.5", "whole number"),
        ("config", "n_poses         = 20", "n_poses         = 65", "refused"),
        ("config", "n_poses         = 20", "n_poses         = -1", "does not fit"),
        ("config", "iter_max    = 50", "", "field 'iter_max' is missing"),
        ("config", "free_mask   = 0xffffffffffffffff", "free_mask   = 0", "refused"),
        ("terms", "d_m       = [0.022,", "d         = [0.022,", "'d_m' is missing"),
        ("terms", "d_m       = [0.022,", "d_m       = [", "6 bounds for 7 joints"),
        ("terms", "alpha_rad = 0.44", "alpha_rad = [0.44]", "1 bounds for 7 joints"),
        ("terms", 'frame = "tool"', 'frame = "elbow"', "unknown frame 'elbow'"),
        ("terms", 'comp = "tx"', 'comp = "xt"', "none of tx, ty"),
        ("kernel", "kappa = 0.3", "kappa = -0.3", "kappa"),
        ("kin", "n_coef = 54", "n_coef = 65", "room for 64"),
        ("kin", 'kind  = "kin"', 'kind  = "kinn"', "unknown table kind"),
    ],
)
def test_wrong_source_is_refused_with_what_and_where(tmp_path, kind, old, new, what):
    path = changed(tmp_path, kind, old, new)
    with pytest.raises(KincalError, match=what) as error:
        tables.build(path)
    assert str(path) in error.value.message
    assert error.value.exit_code == EXIT_INPUT


def test_broken_toml_is_refused(tmp_path):
    path = tmp_path / "arm.toml"
    path.write_text("kind = ")
    with pytest.raises(KincalError, match="not valid TOML"):
        tables.build(path)


def test_more_than_one_problem_of_an_image_is_counted(tmp_path):
    path = changed(tmp_path, "arm", "q_max = 2.6", "q_max = -2.7")
    path.write_text(path.read_text().replace("q_max = 2.0", "q_max = -2.1", 1))
    with pytest.raises(KincalError) as error:
        tables.build(path)
    assert "TBL_RANGE" in error.value.message
    assert "TBL_BAD_TOTAL" in error.value.message


@pytest.mark.parametrize(
    ("damage", "what"),
    [
        (lambda d: d[:10], "not a table image"),
        (lambda d: b"XXXX" + d[4:], "not a table image"),
        (lambda d: d[:4] + b"\x63\0" + d[6:], "unknown table kind 99"),
        (lambda d: d[:-1], "KC_ERR_FORMAT"),
        (lambda d: d + b"\0", "KC_ERR_FORMAT"),
        (lambda d: d[:-1] + bytes([d[-1] ^ 1]), "KC_ERR_CRC"),
        (lambda d: d[:6] + b"\x02\0" + d[8:], "KC_ERR_FORMAT"),
    ],
)
def test_damaged_image_is_refused(damage, what):
    with pytest.raises(KincalError, match=what):
        tables.decode(damage((BIN / "arm.tbl").read_bytes()), "somewhere")


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
    line = tables.event_line(core.lib.KC_EVT_COR_ACTIVE, -1, float(0xDEADBEEF), 0.0)
    assert line == "COR_ACTIVE: correction active, CRC deadbeef"
    assert "kind 3 staged, 100 bytes" in tables.event_line(core.lib.KC_EVT_TBL_STAGED, 3, 100.0, 0.0)


def test_units_follow_from_names():
    units = {
        n: tables.unit_of(n) for n in ("J1.phi_rad", "J1.a_m", "encoder_gain[2]", "joint_compliance[2]", "x")
    }
    assert list(units.values()) == ["rad", "m", "rad/rad", "rad/(N m)", ""]
