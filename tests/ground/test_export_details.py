"""Exports to the last detail: what is identifiable, what has no place in a DH table, rows, names, masses."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from kincal.export import calibrated, expressions, source, tabular
from kincal.export.calibrated import (
    BASE,
    DH,
    CalibratedArm,
    Coefficient,
    FittedTerm,
    frame_name,
    screw,
    twist_pose,
)
from kincal.export.dh import RZ, TURNED, TX, TY, TZ, FoundFrame, _fits, _of_base, dh_table
from kincal.export.leftout import left_out
from kincal.export.urdf import _different
from kincal.flight import FRAME_CAMERA, FRAME_MEAS, FRAME_TOOL
from kincal.rotations import Pose
from kincal.workbench.model.effects import Term
from kincal_shared.errors import BadInput, CannotAnswer
from kincal_shared.schema.arm import read_arm
from kincal_shared.schema.dh import DH_FIELDS
from kincal_shared.schema.model import FitEntry, FrameEntry
from kincal_shared.schema.names import PNP
from kincal_shared.schema.terms import Basis

ZERO = FrameEntry(xyz_m=(0, 0, 0), quat_wxyz=(1, 0, 0, 0))
RECORD = FitEntry(
    when="2026-01-01T00:00:00+00:00", tool_version="0", arm_sha256="", poses=9, components=6, noise_scale=1.0,
    base=ZERO, tool=ZERO,
)  # fmt: skip
SAG = Basis("lin", "q", 2, 0.0, 1.0)


def coefficient(group, *terms, value=0.01, sigma=1e-3, prior=0.1):
    return Coefficient(f"{group}.c", group, "m", value, sigma, prior, tuple(Term(*t) for t in terms))


def fitted(*coefficients, arm="wam", record=RECORD):
    cov = np.diag([c.std_err**2 for c in coefficients])
    return CalibratedArm(read_arm(arm), Pose.identity(), Pose.identity(), coefficients, cov, record)


def test_data_that_halve_the_variance_of_the_prior_identify_a_coefficient():
    for sigma, known in ((0.0, True), (0.070, True), (0.071, False), (0.1, False)):
        c = coefficient(DH, (1, TX, 1.0, ()), sigma=sigma)
        assert c.identifiable is known
        (found,) = (p for p in dh_table(fitted(c)).parameters if (p.joint, p.name) == (1, "a_m"))
        assert found.state == ("identifiable" if known else "not identifiable")
        assert (found.correction, found.sigma) == (pytest.approx(0.01), pytest.approx(sigma))
    exactly = coefficient(DH, (1, TX, 1.0, ()), sigma=0.5, prior=0.5**0.5)
    assert not replace(exactly, prior_sigma=0.25**0.5, std_err=0.5).identifiable
    assert {p.state for p in dh_table(fitted(c)).parameters if p.name != "a_m"} == {"not estimated"}


def test_a_shift_along_y_has_a_place_at_the_two_ends_only():
    one = coefficient("bent", (1, TY, 1.0, ()))
    n = 7
    fits = [_fits(FittedTerm(one, frame, TY, 1.0, ()), n, DH_FIELDS) for frame in range(n + 1)]
    assert fits == [True, *[False] * (n - 1), True]
    assert _fits(FittedTerm(one, FRAME_TOOL, TY, 1.0, ()), n, TURNED)
    assert not _fits(FittedTerm(one, FRAME_CAMERA, TZ, 1.0, ()), n, TURNED)
    assert not _fits(FittedTerm(one, 0, TZ, 1.0, (SAG,)), n, TURNED)
    assert [_fits(FittedTerm(one, 3, 4, 1.0, ()), n, columns) for columns in (DH_FIELDS, TURNED)] == [
        False,
        True,
    ]


def test_what_is_left_out_comes_with_its_reason_the_largest_first():
    record = RECORD.model_copy(update={"position_change_mm": {"small": 0.1, "large": 2.0}})
    small = coefficient("small", (3, TY, 1.0, ()), (4, TY, 1.0, ()))
    large = coefficient("large", (3, TX, 1.0, (SAG,)))
    sensor = coefficient("eye", (FRAME_CAMERA, TX, 1.0, ()))
    arm = fitted(small, large, sensor, record=record)
    found = left_out(arm, arm.terms)
    assert [(x.effect, x.position_mm) for x in found] == [("large", 2.0), ("small", 0.1), ("eye", None)]
    assert found[0].why.startswith("it changes with ") and "q2" in found[0].why and "..." not in found[0].why
    assert found[1].why == "a DH table has no place for ty at link 3, ty at link 4"
    assert str(found[1]).startswith("small, worth 0.1 mm: ")
    assert str(found[2]) == "eye: it corrects the sensor, not the arm"


def test_frames_have_names_and_rows_of_their_own():
    frames = (0, 3, 7, FRAME_TOOL, FRAME_CAMERA, FRAME_MEAS)
    assert [frame_name(f) for f in frames] == ["base", "link 3", "link 7", "tool", "sensor", "target"]
    assert [source._row(f, 7) for f in frames] == [0, 3, 7, 8, 9, 10]


def test_constant_corrections_add_up_by_frame_and_group():
    arm = fitted(
        coefficient(DH, (3, TX, 2.0, ()), (4, TX, 1.0, ())), coefficient("b", (3, TX, 1.0, ()), value=0.5),
        coefficient("c", (3, TX, 1.0, (SAG,))), coefficient("zero", (3, TZ, 1.0, ()), value=0.0),
    )  # fmt: skip
    assert arm.constant_twist(3)[TX] == pytest.approx(0.52)
    assert arm.constant_twist(3, ["b"])[TX] == 0.5
    assert arm.constant_twist(2).tolist() == [0.0] * 6
    assert [t.coefficient.group for t in arm.terms] == [DH, DH, "b", "c"]
    assert arm.effects == ("b", "c", "zero")
    table = source._constants(arm, None)
    assert table.shape == (11, 6) and table[3, TX] == pytest.approx(0.52)
    assert fitted(coefficient(BASE, (0, TY, 1.0, ()))).found_frames()[0].p_m.tolist() == [0.0, 0.01, 0.0]


def test_a_twist_is_a_screw_about_x_then_y_then_z():
    one = screw(1, 0.5, np.pi / 2)
    assert one.p_m.tolist() == [0.0, 0.5, 0.0]
    assert np.allclose(one.R @ [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    both = twist_pose(np.array([0.1, 0.0, 0.0, np.pi / 2, 0.5, 0.0]))
    assert np.allclose(both.R, screw(0, 0.1, np.pi / 2).R @ screw(1, 0.0, 0.5).R)


def test_masses_of_the_generated_code_are_those_of_the_arm_or_none(monkeypatch):
    made = source.describe(fitted(coefficient(DH, (1, TX, 1.0, ()))), "python")
    joints = read_arm("wam").joints
    assert made.masses == [(j.mass_kg, tuple(j.com_m)) for j in joints]
    assert made.keeps_orientation and not made.uses_loads
    bare = replace(read_arm("wam"), joints=tuple(replace(j, mass_kg=None, com_m=None) for j in joints))
    without = replace(made, arm=replace(made.arm, arm=bare))
    assert without.masses == [(0.0, (0.0, 0.0, 0.0))] * 7
    monkeypatch.setattr(type(bare), "has_masses", True)
    assert without.masses == [(0.0, (0.0, 0.0, 0.0))] * 7


def test_variables_ask_for_what_the_generated_code_has_to_work_out():
    assert {"gx", "gy", "gz", "levx", "levy", "levz"} == expressions.LEVERS
    assert {"tau", "taup", "Mx", "My", "Mz"} == expressions.MASSES
    assert {"u", "v", "r2"} == expressions.IMAGE
    assert {"u", "v", "r2", "xcam", "ycam", "zcam", "sx", "sy", "sz"} == expressions.VIEW
    assert expressions.basis_expression(Basis("sin", "q", 2, -0.5, 2.0), "c") == "sin(2.0 * (q[1] + 0.5))"
    assert expressions.basis_expression(Basis("lin", "q", 1, 0.5, 1.0), "python") == "(q[0] - 0.5)"
    assert expressions.plain('a*/b"c\\d\n e') == "a* /b'c/d e"


def test_links_of_one_name_are_numbered():
    assert _different(["a", "b", "a", "a"]) == ["a", "b", "a_1", "a_2"]


# ---- found missing by mutants


def test_variables_are_found_by_the_text_of_their_expression():
    assert expressions._variables_with("load.gravity", "_lever(load") == expressions.LEVERS
    assert expressions._variables_with("no such text") == frozenset()


def test_a_name_of_the_generated_code_does_not_begin_with_a_digit():
    names = {"7 DOF arm": "arm_7_dof_arm", "a7": "a7", "x": "x", "UR-5 (CB)": "ur_5_cb", "--": "arm"}
    assert {name: source.identifier(name) for name in names} == names


def test_what_the_generated_code_does_not_know_is_refused():
    unknown = replace(SAG, fn="of tomorrow")
    for language in ("python", "c"):
        with pytest.raises(CannotAnswer, match="cannot be written as source code"):
            expressions.basis_expression(unknown, language)


def test_a_line_of_code_says_its_coefficient_and_unit():
    one = coefficient("bent", (1, TY, 1.0, ()))
    term = FittedTerm(one, 1, TY, 1.0, (SAG,))
    assert expressions.line(term, 1, "python").comment == "bent.c [m]"
    bare = FittedTerm(replace(one, unit=""), 1, TY, 1.0, (SAG,))
    assert expressions.line(bare, 1, "c").comment == "bent.c"


def test_six_joints_restore_an_orientation_that_was_measured():
    term = (1, TX, 1.0, ())
    positions = RECORD.model_copy(update={"components": 3})
    made = [
        source.describe(fitted(coefficient(DH, term), arm=arm, record=record), "c")
        for arm, record in (("ur5", RECORD), ("ur5", positions), ("wam", RECORD))
    ]
    assert [m.keeps_orientation for m in made] == [True, False, True]
    assert not any(m.uses_image or m.uses_view or m.uses_levers or m.uses_masses for m in made)


def test_of_what_an_effect_changes_with_two_are_named():
    for drivers, more in ((2, False), (3, True)):
        terms = [(2, TX, 1.0, (Basis("lin", "q", j, 0.0, 1.0),)) for j in range(1, drivers + 1)]
        (found,) = left_out(arm := fitted(coefficient("sag", *terms)), arm.terms)
        assert found.why.endswith(", ...") is more
        assert found.why.count("q1") == found.why.count("q2") == 1 and "q3" not in found.why


def test_a_turn_about_the_first_axis_belongs_to_its_joint_and_all_else_there_to_the_base():
    for group, of_joint in ((DH, True), ("backlash[1]", True), (BASE, False), ("sag", False)):
        one = coefficient(group, (0, TX, 1.0, ()))
        found = [_of_base(FittedTerm(one, 0, comp, 1.0, ())) for comp in range(6)]
        assert found == [not (of_joint and comp in (RZ, TZ)) for comp in range(6)]
        assert not _of_base(FittedTerm(one, 1, TX, 1.0, ()))


def test_rows_of_a_frame_say_whether_it_was_estimated():
    known = tabular._frame_rows(FoundFrame("base", Pose.identity(), None))
    found = tabular._frame_rows(FoundFrame("tool", Pose.identity(), np.full(6, 0.5)))
    assert len(known) == len(found) == 6
    assert all(row.startswith("base,") and row.endswith(",0.0,,not estimated") for row in known)
    assert all(row.startswith("tool,") and row.endswith(",0.0,0.5,estimated") for row in found)


def test_a_table_says_what_it_does_not_contain():
    said = []
    for coefficients in ([coefficient(DH, (1, TX, 1.0, ()))], [coefficient("sag", (2, TX, 1.0, (SAG,)))]):
        arm = fitted(*coefficients)
        said += [line for line in tabular._provenance(arm, dh_table(arm)) if "not_contained" in line]
    assert "nothing" in said[0] and "sag: it changes with" in said[1] and "nothing" not in said[1]


def test_columns_of_points_are_counted_as_the_code_has_them():
    points = Basis("lin", next(iter(PNP)), 9, 0.0, 1.0)
    term = FittedTerm(coefficient("lens", (0, TX, 1.0, ())), 0, TX, 1.0, (points, SAG))
    placed = source._placed(term, SimpleNamespace(numbers=(5, 9)))
    assert [b.index for b in placed.bases] == [2, 2] and placed.bases[1] == SAG


def test_a_model_with_an_effect_that_nobody_knows_names_its_file(monkeypatch):
    def unknown(*_args, **_more):
        raise BadInput("no such effect", todo="spell it right")

    monkeypatch.setattr(calibrated, "choose_constants", unknown)
    model = SimpleNamespace(effects=(), dh=True, constants={})
    with pytest.raises(BadInput, match="no such effect") as refused:
        calibrated._named(read_arm("wam"), model, None, "M.toml")
    assert (refused.value.where, refused.value.todo) == ("M.toml", "spell it right")
