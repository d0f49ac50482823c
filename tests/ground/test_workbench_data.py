"""Workbench input: measurements, arm tables, model files. Each refusal says what, where and what to do."""

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from threading import Barrier, Event, Thread
from types import SimpleNamespace

import numpy as np
import poses
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from kincal import workbench as wb
from kincal.api.models import change_by_adding
from kincal.rotations import Pose
from kincal.workbench.consistency.recorded import _duplicates, _too_alike
from kincal.workbench.data.copies import without_copies
from kincal.workbench.data.measurements import Measurements, replicate_groups
from kincal.workbench.data.readers import read_measurements
from kincal.workbench.data.readers.joining import joined
from kincal.workbench.data.split import choose_split
from kincal.workbench.evidence.adequacy import noise_floor
from kincal.workbench.fit.frames import solve_frames
from kincal.workbench.model.flight_model import nominal_chain
from kincal.workbench.model.grids import grid_values, grid_weight
from kincal.workbench.model.modelfile import change_model, held, replace_model
from kincal_shared.schema.effects import ParameterEntry
from kincal_shared.schema.model import DataEntry, FitEntry, FrameEntry, UnnamedEntry
from kincal_shared.schema.terms import TermEntry

HEADER = "q1,q2,px,py,pz"


def csv_file(tmp_path, text):
    path = tmp_path / "poses.csv"
    path.write_text(text)
    return path


def test_csv_reads_required_columns_and_skips_comments(tmp_path):
    data = wb.read_csv(
        csv_file(tmp_path, f"# made by hand\n{HEADER}\n0.1,0.2,1,2,3\n# note\n0.3,0.4,4,5,6\n"), 2
    )
    assert data.n == 2
    assert data.components == 3
    np.testing.assert_array_equal(data.q, [[0.1, 0.2], [0.3, 0.4]])
    assert data.order_is_time


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"{HEADER}\n0.1,nan,1,2,3\n", ["line 2", "q2", "finite"]),
        (f"{HEADER}\n0.1,,1,2,3\n", ["line 2", "q2", "empty"]),
        (f"{HEADER}\n0.1,0.2,1,2\n", ["line 2", "4 values", "names 5"]),
        (f"{HEADER},qw,qx,qy,qz\n0,0,0,0,0,1,1,0,0\n", ["line 2", "norm"]),
        (f"{HEADER},qw,qx\n0,0,0,0,0,1,0\n", ["line 1", "qy"]),
        (f"{HEADER},sp_m\n0,0,0,0,0,-1\n", ["line 2", "sp_m", "more than 0"]),
        (f"{HEADER},split\n0,0,0,0,0,test\n", ["line 2", "fit or held"]),
        (f"{HEADER},q3\n0,0,0,0,0,0\n", ["q3", "2 joints"]),
        (f"{HEADER},q1\n0,0,0,0,0,0\n", ["twice", "q1"]),
    ],
)
def test_malformed_csv_is_refused_with_line_and_reason(tmp_path, text, words):
    with pytest.raises(wb.BadInput) as error:
        wb.read_csv(csv_file(tmp_path, text), 2)
    for word in words:
        assert word in str(error.value)


def test_covariance_must_be_positive_definite(tmp_path):
    names = ",".join(f"c{i}{j}" for i in range(1, 7) for j in range(i, 7))
    bad = ",".join("-1" if i == j == 3 else str(int(i == j)) for i in range(1, 7) for j in range(i, 7))
    with pytest.raises(wb.BadInput, match="line 2.*positive definite"):
        wb.read_csv(csv_file(tmp_path, f"{HEADER},{names}\n0,0,0,0,0,{bad}\n"), 2)


def test_skip_bad_keeps_the_rest_and_counts(tmp_path):
    path = csv_file(tmp_path, f"{HEADER}\n0,0,0,0,0\n0,x,0,0,0\n1,1,1,1,1\n")
    data = wb.read_csv(path, 2, skip_bad=True)
    assert data.n == 2
    assert len(data.skipped) == 1
    assert "line 3" in data.skipped[0]


def modified_link(alpha, a, theta, d):
    """Rx(alpha) Tx(a) Rz(theta) Tz(d), Craig's convention, from elementary matrices."""
    rx, rz, tx, tz = np.eye(4), np.eye(4), np.eye(4), np.eye(4)
    rx[1:3, 1:3] = [[np.cos(alpha), -np.sin(alpha)], [np.sin(alpha), np.cos(alpha)]]
    rz[:2, :2] = [[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]]
    tx[0, 3], tz[2, 3] = a, d
    return rx @ tx @ rz @ tz


def test_modified_dh_is_converted_exactly(tmp_path):
    rng = np.random.default_rng(5)
    rows = rng.uniform(-1.0, 1.0, (6, 4))
    identity = "xyz_m = [0, 0, 0]\nquat_wxyz = [1, 0, 0, 0]\n"
    text = 'convention = "modified"\ngravity_m_s2 = [0, 0, -9.81]\n'
    text += f"[base]\n{identity}[tool]\n{identity}" + "".join(
        f'[[joint]]\ntype = "revolute"\nalpha_rad = {al}\na_m = {a}\nd_m = {d}\nphi_rad = {phi}\n'
        "q_min_rad = -6.0\nq_max_rad = 6.0\n"
        for al, a, d, phi in rows
    )
    path = tmp_path / "arm.toml"
    path.write_text(text)
    arm = wb.read_arm(path)
    q = rng.uniform(-3.0, 3.0, (20, 6))
    data = Measurements(source="", ids=tuple(map(str, range(20))), q=q, p_m=np.zeros((20, 3)))
    got = (Pose.of_wxyz(arm.base.xyz_m, arm.base.quat_wxyz) @ nominal_chain(arm, data)).matrix
    for i in range(20):
        want = np.eye(4)
        for (al, a, d, phi), angle in zip(rows, q[i], strict=True):
            want = want @ modified_link(al, a, phi + angle, d)
        np.testing.assert_allclose(got[i], want, atol=1e-12)


@pytest.mark.parametrize("with_rotation", [True, False])
def test_unknown_frames_are_found_without_a_first_guess(with_rotation):
    rng = np.random.default_rng(8)
    angles = rng.uniform(-1.5, 1.5, (40, 7))
    chain = Pose.of_matrix(np.array([poses.tool_pose(q, np.zeros((7, 4))) for q in angles]))
    for trial in range(10):
        quats, shifts = rng.normal(size=(2, 4)), rng.uniform(-3, 3, (2, 3))
        base, tool = (Pose.of_wxyz(shift, quat) for shift, quat in zip(shifts, quats, strict=True))
        seen = base @ chain @ tool
        got_base, got_tool = solve_frames(chain, seen.p_m, seen.R if with_rotation else None, None, None)
        np.testing.assert_allclose(got_base.matrix, base.matrix, atol=1e-6, err_msg=f"trial {trial}")
        np.testing.assert_allclose(got_tool.p_m, tool.p_m, atol=1e-6)


def test_unknown_frames_of_noisy_positions_are_those_of_least_error():
    """Oracle: scipy's least squares over both frames, started beside what was found."""
    rng = np.random.default_rng(10)
    chain = Pose.of_matrix(
        np.array([poses.tool_pose(q, np.zeros((7, 4))) for q in rng.uniform(-1.5, 1.5, (30, 7))])
    )
    for scale in (1e-4, 1e-2, 0.1):
        base, tool = (Pose.of_wxyz(rng.uniform(-3, 3, 3), rng.normal(size=4)) for _ in range(2))
        p_m = (base @ chain @ tool).p_m + rng.normal(0.0, scale, (30, 3))
        got_base, got_tool = solve_frames(chain, p_m, None, None, None)

        def residual(x, p_m=p_m, got=(got_base, got_tool)):
            turn = Rotation.from_rotvec(x[:3]).as_matrix()
            around = Pose(turn @ got[0].p_m + x[3:6], turn @ got[0].R)
            return (around.apply(chain.apply(got[1].p_m + x[6:])) - p_m).ravel()

        beside = rng.normal(0.0, 1e-2, 9)
        best = least_squares(residual, beside, xtol=1e-15, ftol=1e-15, gtol=1e-15)
        assert np.abs(best.x).max() < 1e-5
        assert np.sum(residual(np.zeros(9)) ** 2) <= 2.0 * best.cost * (1.0 + 1e-9)


@pytest.mark.parametrize("with_rotation", [True, False])
@pytest.mark.parametrize("known", ["base", "tool"])
def test_one_unknown_frame_is_found_beside_the_known_one(with_rotation, known):
    rng = np.random.default_rng(9)
    angles = rng.uniform(-1.5, 1.5, (20, 7))
    chain = Pose.of_matrix(np.array([poses.tool_pose(q, np.zeros((7, 4))) for q in angles]))
    base, tool = (Pose.of_wxyz(rng.uniform(-1, 1, 3), rng.normal(size=4)) for _ in range(2))
    seen = base @ chain @ tool
    given = {"base": (base, None), "tool": (None, tool)}[known]
    got_base, got_tool = solve_frames(chain, seen.p_m, seen.R if with_rotation else None, *given)
    np.testing.assert_allclose(got_base.matrix, base.matrix, atol=1e-9)
    np.testing.assert_allclose(got_tool.p_m, tool.p_m, atol=1e-9)


@pytest.mark.parametrize(
    ("turned", "known", "frames", "need"),
    [(True, False, "base and tool frames", 3), (False, False, "base and tool frames", 7),
     (False, True, "base or tool frame", 4)],
)  # fmt: skip
def test_too_few_poses_for_unknown_frames_say_what_takes_how_many(turned, known, frames, need):
    """One command said that 12 poses are needed, another 7: of different things, which neither said."""
    turns = np.tile(np.eye(3), (2, 1, 1))
    with pytest.raises(wb.CannotAnswer) as error:
        base = Pose(np.zeros(3), np.eye(3)) if known else None
        solve_frames(Pose(np.zeros((2, 3)), turns), np.zeros((2, 3)), turns if turned else None, base, None)
    assert f"the unknown {frames}, with which a fit begins: that takes at least {need}" in str(error.value)
    assert "measure more poses (coefficients take more than frames)" in error.value.todo


def test_model_file_keeps_history_and_undo_walks_back(tmp_path):
    path = tmp_path / "M.toml"
    model = (
        wb.ModelFile().add(["joint_compliance[2]"]).add(["backlash[4]", "base_flex"]).remove(["backlash[4]"])
    )
    wb.write_model(path, model)
    again = wb.read_model(path)
    assert again == model
    assert again.effects == ("joint_compliance[2]", "base_flex")
    once = again.undo()
    assert once.effects == ("joint_compliance[2]", "backlash[4]", "base_flex")
    assert once.undo().effects == ("joint_compliance[2]",)
    assert once.undo().undo().effects == ()
    with pytest.raises(wb.BadInput, match="nothing to undo"):
        once.undo().undo().undo()
    assert [c.action for c in once.undo().history] == ["add", "add", "remove", "undo", "undo"]


def fitted(model, arm="arm.toml"):
    """The model with values, as a fit leaves them."""
    names = [f"{name}.c" for name in model.effects] or ["J1.a_m"]
    frame = FrameEntry(xyz_m=(0.0, 0.0, 0.1), quat_wxyz=(1.0, 0.0, 0.0, 0.0))
    entry = FitEntry(
        when="2026-11-28T00:00:00+00:00", tool_version="0.1.0", arm_sha256="ab",
        data=[DataEntry(path="poses.csv", sha256="cd")], poses=30, components=3, held=["1", "2"], held_mm=0.1,
        noise_scale=1.0, base=frame, tool=frame, position_change_mm=dict.fromkeys(model.effects, 0.5),
        covariance=[[0.0] * k + [1e-8] for k in range(len(names))],
    )  # fmt: skip
    return replace(
        model, arm=arm, values={name: (1e-3 * k, 1e-4) for k, name in enumerate(names, 1)},
        units=dict.fromkeys(names, "rad"), constants={name: {"t0": 1.5} for name in model.effects}, fit=entry,
    )  # fmt: skip


def values_of(model):
    return model.arm, model.values, model.units, model.constants, model.fit


@pytest.mark.parametrize("change", ["remove", "add"])
def test_undo_brings_the_fitted_values_back(tmp_path, change):
    path = tmp_path / "M.toml"
    before = fitted(wb.ModelFile().add(["bias_step[2]", "backlash[4]"]))
    wb.write_model(path, before)
    change_model(path, lambda m: m.remove(["backlash[4]"]) if change == "remove" else m.add(["base_flex"]))
    changed = wb.read_model(path)
    assert changed.fit is None and changed.values == {}
    wb.write_model(path, changed)
    assert wb.read_model(path) == changed
    after = change_model(path, wb.ModelFile.undo)
    assert values_of(after) == values_of(before)
    assert wb.read_model(path) == after and after.former is None


def test_a_damaged_former_fit_is_named_with_the_way_out(tmp_path):
    path = tmp_path / "M.toml"
    wb.write_model(path, fitted(wb.ModelFile().add(["backlash[4]"])).add(["base_flex"]))
    text = path.read_text()
    path.write_text(text.replace("[former]", "[former]\nrubbish = 1"))
    with pytest.raises(wb.BadInput, match="former.rubbish(.|\n)*delete .former. and the tables in it"):
        wb.read_model(path)
    path.write_text(text[: text.index("[former]")])
    assert wb.read_model(path).effects == ("backlash[4]", "base_flex")


def test_undo_brings_back_values_of_the_same_effects_only():
    two = fitted(wb.ModelFile().add(["bias_step[2]"]).add(["backlash[4]"]))
    one = fitted(two.remove(["backlash[4]"]), arm="other.toml")
    assert values_of(one.undo()) == values_of(two)
    assert values_of(one.undo().undo()) == values_of(one)  # a fit of these effects too, the last one
    assert one.undo().undo().undo().fit is None
    none = one.remove(["bias_step[2]"])
    assert values_of(none.undo()) == values_of(one)
    assert none.undo().undo().fit is None


def test_values_of_other_terms_do_not_come_back():
    terms = [UnnamedEntry(name="unnamed[joint 1: q1]", parameter=[
        ParameterEntry(name="k1", sigma=s, unit="rad", term=[TermEntry(at="joint[1]", basis="q1")])])
        for s in (1e-3, 2e-3)]  # fmt: skip
    model = fitted(wb.ModelFile().add([terms[0].name]).with_terms(terms[0])).remove([terms[0].name])
    assert model.with_terms(terms[0]).undo().fit is not None
    assert model.with_terms(terms[1]).undo().fit is None


def test_model_file_refuses_doubles_and_strangers(tmp_path):
    model = wb.ModelFile().add(["base_flex"])
    with pytest.raises(wb.BadInput, match="already"):
        model.add(["base_flex"])
    with pytest.raises(wb.BadInput, match="not in the model"):
        model.remove(["backlash[1]"])
    path = tmp_path / "M.toml"
    path.write_text('effects = ["a"]\ncolour = "red"\n')
    with pytest.raises(wb.BadInput, match="colour"):
        wb.read_model(path)


def test_commands_at_the_same_time_lose_no_effect(tmp_path):
    """Of four that added an effect each at once, one or two were lost; each said it had added its own."""
    path, names = tmp_path / "M.toml", ["base_flex", "backlash[1]", "encoder_gain[2]", "joint_compliance[3]"]
    together = Barrier(len(names))

    def add(name):
        together.wait()
        change_by_adding(path, [name])

    for _ in range(3):
        path.unlink(missing_ok=True)
        with ThreadPoolExecutor(len(names)) as pool:
            list(pool.map(add, names))
        assert set(wb.read_model(path).effects) == set(names)
    assert [p.name for p in tmp_path.iterdir()] == ["M.toml"]


def test_a_change_waits_for_the_command_that_holds_the_model(tmp_path):
    path, begun, read = tmp_path / "M.toml", Event(), []

    def other():
        with held(path):
            begun.set()
            read.append(wb.read_model(path).effects)

    with held(path):
        thread = Thread(target=other)
        thread.start()
        assert not begun.wait(0.2)
        wb.write_model(path, wb.ModelFile().add(["base_flex"]))
    thread.join()
    assert read == [("base_flex",)]


def test_a_long_command_does_not_undo_what_was_changed_meanwhile(tmp_path):
    path = tmp_path / "M.toml"
    wb.write_model(path, wb.ModelFile().add(["base_flex"]))
    before = wb.read_model(path)
    change_model(path, lambda model: model.add(["backlash[1]"]))
    now = path.read_bytes()
    with pytest.raises(wb.BadInput, match="another command changed it meanwhile") as error:
        replace_model(path, before.add(["encoder_gain[2]"]))
    assert error.value.todo == "run this command again"
    assert path.read_bytes() == now
    replace_model(path, wb.read_model(path).add(["encoder_gain[2]"]))
    assert wb.read_model(path).effects == ("base_flex", "backlash[1]", "encoder_gain[2]")


def test_a_new_model_is_not_written_over_one_that_came_meanwhile(tmp_path):
    new = wb.read_model(tmp_path / "new" / "M.toml", must_exist=False).add(["backlash[1]"])
    change_model(tmp_path / "new" / "M.toml", lambda model: model.add(["base_flex"]), must_exist=False)
    with pytest.raises(wb.BadInput, match="meanwhile"):
        replace_model(tmp_path / "new" / "M.toml", new)


def test_answers_are_valid_json_without_nan(tmp_path):
    from kincal.workbench.report.answers import comparison_json

    arm = wb.read_arm(poses.arm_toml(tmp_path / "arm.toml"))
    data = wb.read_csv(poses.poses_csv(tmp_path / "d.csv", 30, 3), 7)
    text = json.dumps(comparison_json(wb.compare(arm, data)), allow_nan=False)
    keys = (
        "poses fit held components noise_floor rms chi2_per_dof p_lack_of_fit adequate "
        "worst_poses where outliers"
    )
    assert set(keys.split()) <= set(json.loads(text))
    for split, of in ((None, "held"), (np.full(30, "fit"), "fit")):
        answer = comparison_json(wb.compare(arm, replace(data, split=split)))
        assert {row["poses"] for row in answer["errors"]} == {of}


@pytest.mark.parametrize(
    ("pose", "held"),
    [
        (np.arange(24), {3, 7, 11, 15, 19, 23}),
        (np.tile(np.arange(24), 4), {3, 7, 11, 15, 19, 23}),
        (
            np.repeat(np.arange(24), 2),
            {3, 7, 11, 15, 19, 23},
        ),  # in step with the fourth row: none was held out
        (np.repeat(np.arange(24), 4), {3, 7, 11, 15, 19, 23}),
        (np.repeat(np.arange(24), 8), {3, 7, 11, 15, 19, 23}),
        (np.repeat(np.arange(24), 3), {1, 5, 9, 13, 17, 21}),  # rows 3, 15, 27 ...
        (np.concatenate([[0, 0, 0, 1, 2, 3], np.arange(4, 24)]), {1, 5, 9, 13, 17, 21}),
    ],
)
def test_a_fourth_of_the_poses_is_held_out_however_often_each_was_measured(pose, held):
    """With their replicates."""
    q = np.column_stack([pose, pose]).astype(float)
    data = Measurements("made up", tuple(map(str, range(len(q)))), q, q, replicate=replicate_groups(q))
    split = choose_split(data)
    assert set(pose[split.held]) == held == set(range(24)) - set(pose[split.fit])


@pytest.mark.parametrize(
    ("again", "decimals", "noise", "copies"),
    [
        (8, 9, 0.0, 8),  # to the last digit
        (8, 6, 0.0, 8),  # single rows with fewer digits
        (8, 5, 0.0, 8),
        (40, 4, 0.0, 40),  # a whole file with few
        (8, 6, 3e-5, 0),  # measured anew
        (40, 4, 3e-5, 0),
        (40, 3, 1e-4, 0),
    ],
)
def test_rows_that_are_others_with_fewer_digits_are_copies(again, decimals, noise, copies):
    """A file given twice, once from a spreadsheet that shows six digits, looked like two files."""
    rng = np.random.default_rng(3)
    x = rng.uniform(-2.0, 2.0, (40, 5))
    more = x[:again] + noise * rng.normal(size=(again, 5))
    rows = np.concatenate([x.round(9), more.round(decimals)])
    order = rng.permutation(len(rows))
    data = Measurements("made up", tuple(map(str, order)), rows[order, :2], rows[order, 2:])
    kept = without_copies(data)
    assert (kept.n, kept.duplicates) == (len(rows) - copies, copies)
    assert kept.rounded == (copies if decimals < 9 else 0)
    if kept.rounded:
        assert set(kept.ids) == set(map(str, range(40)))  # those with all digits stay


def significant(x, digits):
    step = 10.0 ** (np.floor(np.log10(np.abs(x))) + 1 - digits)
    return np.round(x / step) * step


def cut(x, decimals):
    return np.trunc(x * 10.0**decimals) / 10.0**decimals


@pytest.mark.parametrize(
    ("again", "joints", "positions"),
    [
        (8, lambda q: np.deg2rad(np.rad2deg(q).round(4)), lambda p: (p * 1e3).round(3) / 1e3),  # deg, mm
        (8, lambda q: np.deg2rad(np.rad2deg(q)), lambda p: p * 1e3 / 1e3),  # with all digits
        (40, lambda q: np.deg2rad(np.rad2deg(q).round(2)), lambda p: (p * 1e3).round(1) / 1e3),
        (40, lambda q: significant(q, 5), lambda p: significant(p, 5)),
        (8, lambda q: significant(q, 7), lambda p: significant(p, 6)),
        (8, lambda q: cut(q, 6), lambda p: cut(p, 6)),
        (40, lambda q: cut(q, 4), lambda p: cut(p, 4)),
        (8, lambda q: np.floor(q * 1e6) / 1e6, lambda p: np.floor(p * 1e6) / 1e6),
        (8, lambda q: np.deg2rad(cut(np.rad2deg(q), 3)), lambda p: cut(p, 5)),
        (8, lambda q: q, lambda p: p.round(5)),  # one of both parts alone
    ],
)
@pytest.mark.parametrize("seed", range(3))
def test_rows_written_in_other_units_or_cut_off_are_copies(again, joints, positions, seed):
    """They counted as replicates, and their noise as that of the arm. What was measured anew stays."""
    rng = np.random.default_rng(seed)
    q, p = rng.uniform(-2.0, 2.0, (40, 6)), rng.uniform(-1.0, 1.0, (40, 3))
    for noise, copies in ((0.0, again), (5e-5, 0)):
        more = p[:again] + noise * rng.normal(size=(again, 3))
        data = Measurements(
            "made up", tuple(map(str, range(40 + again))), np.concatenate([q, joints(q[:again])]),
            np.concatenate([p, positions(more)]), order_is_time=True,
        )  # fmt: skip
        kept = without_copies(data)
        assert (kept.n, kept.duplicates) == (40 + again - copies, copies)
        assert set(kept.ids[:40]) == set(map(str, range(40)))


def test_files_that_are_both_rounded_are_copies_of_each_other():
    rng = np.random.default_rng(4)
    q, p = rng.uniform(-2.0, 2.0, (30, 6)), rng.uniform(-1.0, 1.0, (30, 3))
    data = Measurements(
        "made up",
        tuple(map(str, range(60))),
        np.concatenate([q.round(5), np.deg2rad(np.rad2deg(q).round(2))]),
        np.concatenate([p.round(5), p.round(4)]),
    )
    assert without_copies(data).ids == tuple(map(str, range(30)))


@pytest.mark.parametrize("numbers", ["from zero", "from one"])
def test_replicates_that_the_file_states_are_no_copies(tmp_path, numbers):
    """A device of tenths of a millimetre repeats itself; the file was refused as doubled."""
    x = np.random.default_rng(3).uniform(-1.0, 1.0, (20, 5)).round(4)
    first = int(numbers == "from one")
    rows = [(*row, k + first) for k, row in enumerate(x) for _ in range(3)]
    lines = [",".join(map(repr, map(float, row[:5]))) + f",{row[5]}" for row in rows]
    path = csv_file(tmp_path, "\n".join([HEADER + ",replicate", *lines]) + "\n")
    data = wb.read_csv(path, 2)
    assert (data.n, data.duplicates) == (60, 0)
    assert len(set(data.repeats)) == 20
    assert list(of_data_codes(data)) == []
    unstated = csv_file(tmp_path, "\n".join([HEADER, *(line.rsplit(",", 1)[0] for line in lines)]) + "\n")
    assert wb.read_csv(unstated, 2).duplicates == 40


@pytest.mark.parametrize("form", ["csv", "npz"])
def test_a_pose_without_a_replicate_number_was_not_repeated(tmp_path, form):
    x = np.random.default_rng(3).uniform(-1.0, 1.0, (6, 5))
    x[1, :2] = x[0, :2]
    x[5, :2] = x[4, :2]  # near each other, and yet not repeated, as the file says
    groups = ["7", "7", "", "", "", ""]
    if form == "csv":
        lines = [",".join(map(repr, map(float, row))) + f",{k}" for row, k in zip(x, groups, strict=True)]
        path = csv_file(tmp_path, "\n".join([HEADER + ",replicate", *lines]) + "\n")
        data = wb.read_csv(path, 2)
    else:
        path = tmp_path / "poses.npz"
        np.savez(path, q=x[:, :2], p=x[:, 2:], replicate=[float(k or "nan") for k in groups])
        data = read_measurements(path, 2)
    assert data.n == 6 and data.replicate_stated and not data.skipped
    assert data.repeats[0] == data.repeats[1] and len(set(data.repeats)) == 5
    assert len(set(joined([data, replace(data, q=data.q + 1.0)]).repeats)) == 10


def test_a_file_in_which_no_pose_has_a_replicate_number_repeats_none(tmp_path):
    path = csv_file(tmp_path, HEADER + ",replicate\n.1,.2,.3,.4,.5,\n.2,.2,.3,.4,.5,\n")
    assert wb.read_csv(path, 2).repeats is None


def of_data_codes(data):
    return [f.code for f in (*_duplicates(data), *_too_alike(data))]


def test_stated_replicates_of_a_file_given_twice_are_copies(tmp_path):
    """In another order, so that the files differ: equal rows of different groups."""
    x = np.random.default_rng(3).uniform(-1.0, 1.0, (20, 5)).round(4)
    rows = [[*row, k] for k, row in enumerate(x) for _ in range(2)]
    paths = []
    for name, order in (("a", range(40)), ("b", reversed(range(40)))):
        path = tmp_path / f"{name}.csv"
        lines = [",".join(map(repr, map(float, rows[i][:5]))) + f",{rows[i][5]}" for i in order]
        path.write_text("\n".join([HEADER + ",replicate", *lines]) + "\n")
        paths.append(path)
    data = joined([wb.read_csv(path, 2) for path in paths])
    assert (data.n, data.duplicates) == (40, 40)


def test_replicates_of_less_than_a_micrometre_are_doubted():
    rng = np.random.default_rng(3)
    x = np.repeat(rng.uniform(-2.0, 2.0, (20, 5)), 2, axis=0)
    for noise, codes in ((2e-7, ["replicates"]), (2e-6, [])):
        rows = x + noise * rng.normal(size=x.shape)
        data = Measurements(
            "m", tuple(map(str, range(40))), rows[:, :2], rows[:, 2:], replicate=np.arange(40) // 2
        )
        assert [f.code for f in _too_alike(data)] == codes


def test_equal_rows_of_a_coarse_device_at_other_times_are_replicates():
    """A tracker that shows tenths of a millimetre repeats itself; its replicates tell no noise."""
    x = np.repeat(np.random.default_rng(3).uniform(-1.0, 1.0, (30, 5)), 3, axis=0)
    x[:, 2:] = x[:, 2:].round(4)
    data = Measurements("m", tuple(map(str, range(90))), x[:, :2], x[:, 2:], t_s=30.0 * np.arange(90))
    assert without_copies(data).n == 90
    assert without_copies(replace(data, order_is_time=True)).n == 30
    assert without_copies(replace(data, p_m=data.p_m + 1e-7)).n == 30  # no noise in six digits: copies
    zero = SimpleNamespace(r=np.zeros((90, 3)), Jq=np.ones((90, 3, 2)))
    fit = SimpleNamespace(data=replace(data, replicate=np.arange(90) // 3), z=np.zeros(270), evaluation=zero)
    floor = noise_floor(SimpleNamespace(**vars(fit), whiten=np.tile(np.eye(3), (90, 1, 1))))
    assert floor.pos_m is None and "equal to the last digit" in floor.source


def test_one_time_for_all_poses_is_no_time():
    """As some devices write it; the constants of a step are looked for between poses."""
    x = np.random.default_rng(3).uniform(-1.0, 1.0, (30, 5))
    a, b = (
        Measurements(name, tuple(map(str, range(30))), x[:, :2] + k, x[:, 2:], t_s=np.full(30, 7.0 + k))
        for k, name in enumerate("ab")
    )
    alone = joined([a])
    assert alone.order_is_time and list(alone.t_s) == list(range(30))
    assert any("t_s is the same in every row" in note for note in alone.notes)
    together = joined([a, b])  # the times tell the sessions apart
    assert not together.order_is_time and set(together.t_s) == {7.0, 8.0}
    assert grid_values("times", together) == [7.5] and grid_values("times", a) == [7.0]


def test_a_step_is_looked_for_in_the_breaks_of_a_session_too():
    x = np.random.default_rng(3).uniform(-1.0, 1.0, (60, 5))
    t_s = 6.0 * np.arange(60) + 7200.0 * (np.arange(60) >= 31) + 90.0 * (np.arange(60) >= 44)
    data = Measurements("a", tuple(map(str, range(60))), x[:, :2], x[:, 2:], t_s=t_s)
    tried = grid_values("times", data)
    breaks = [0.5 * (t_s[k - 1] + t_s[k]) for k in (31, 44)]
    assert set(breaks) <= set(tried) and len(tried) == len(set(tried)) <= 18
    weight = {t: grid_weight("times", t, data) for t in tried}
    assert weight[breaks[0]] == weight[breaks[1]] == 8.0
    assert {weight[t] for t in tried if t not in breaks} == {1.0}
    steady = replace(data, t_s=6.0 * np.arange(60))
    assert {grid_weight("times", t, steady) for t in grid_values("times", steady)} == {1.0}
    assert grid_weight("durations", 1.0, data) == 1.0


def test_poses_with_another_payload_are_no_replicates():
    q = np.repeat(np.random.default_rng(3).uniform(-1.0, 1.0, (9, 6)), 2, axis=0)
    assert len(set(replicate_groups(q, np.tile([0.0, 0.005], 9)))) == 9
    assert len(set(replicate_groups(q, np.tile([0.0, 0.5], 9)))) == 18
