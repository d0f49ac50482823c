"""`kincal model`: every verb through the command, its exit status, the pinned keys of its answers."""

import csv
import json
import re
import struct
import tomllib

import numpy as np
import poses
import pytest
import samples
from builders import ffi
from commands import FIGURES, kincal, shell
from commands import good as ends_well
from places import BIN, SRC

from kincal import space, tables
from kincal import workbench as wb
from kincal.cli.errors import EXIT_DATA, EXIT_INPUT
from kincal.pages import diagnosis as pages
from kincal.pages import image
from kincal.pages.page import Provenance, render
from kincal.workbench.data.readers import read_measurements
from kincal.workbench.report.content import report_content

COMPARE = {
    "poses": int, "fit": int, "held": int, "components": int, "noise_floor": dict, "rms": dict,
    "chi2_per_dof": float, "p_lack_of_fit": float, "adequate": bool, "worst_poses": list, "where": list,
    "outliers": list,
}  # fmt: skip
DIAGNOSE = {
    "verdict": str, "effects": list, "novel": (dict, type(None)), "not_testable": list, "next_poses": list,
}  # fmt: skip
EFFECT = {
    "name", "probability", "p_value", "delta_bic", "held_rms_before_mm", "held_rms_after_mm", "parameters",
    "confounded_with", "negative", "why",
}  # fmt: skip
MINE = """[[effect]]
name = "odd_coupling"
formula = "dq_3 = k tanh(q4) cos(q6)"
[[effect.parameter]]
name = "k"
unit = "rad"
sigma = 5e-3
[[effect.parameter.term]]
at = "joint[3]"
basis = "tanh(q4) * cos(q6)"
"""


def good(*args):
    return ends_well("model", *args)


def answer(*args):
    """JSON answer; NaN and infinity are not JSON."""

    def refuse(name):
        raise AssertionError(f"{name} in the answer")

    return json.loads(good(*args, "--json").stdout, parse_constant=refuse)


def has(keys, doc):
    for key, kind in keys.items():
        assert isinstance(doc[key], kind), f"{key}: {doc[key]!r}"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """An arm table and measurements with a hidden backlash of joint 4."""
    out = tmp_path_factory.mktemp("workbench")
    poses.arm_toml(out / "arm.toml")
    poses.poses_csv(out / "poses.csv", 44, 12, lambda q, d: q + np.array([0, 0, 0, 3e-3 * d[3], 0, 0, 0]))
    return out


@pytest.fixture(scope="module")
def given(folder):
    return "--arm", folder / "arm.toml", "--data", folder / "poses.csv"


@pytest.fixture(scope="module")
def compared(given):
    """What DH errors alone leave of them."""
    return answer("compare", *given)


@pytest.fixture(scope="module")
def flight_log(tmp_path_factory):
    """A short calibration in simulation, without pixels."""
    out = tmp_path_factory.mktemp("run")
    command = [
        "run", "compliance", "--fast", "--poses", "12", "--accept", "auto", "--no-compare", "--no-summary",
    ]  # fmt: skip
    shell(*command, "--tables", BIN, "--out", out)
    return out / "run.lcmlog"


@pytest.fixture
def model(tmp_path):
    return tmp_path / "M.toml"


# --------------------------------------------------------------------------- answers


def test_compare_answers_with_the_pinned_keys(given, compared):
    got = compared
    has(COMPARE, got)
    assert (got["poses"], got["fit"], got["held"], got["components"]) == (44, 33, 11, 6)
    for name in ("nominal", "fit", "held"):
        assert set(got["rms"][name]) == {"pos_mm", "rot_mrad"}
    assert {"variable", "p_value", "share_of_variance"} <= set(got["where"][0])
    assert got["where"][0]["variable"] == "dir4"
    assert set(got["worst_poses"][0]) == {"id", "pos_mm", "rot_mrad", "sigma"}
    assert got["adequate"] is False
    assert "does NOT explain" in good("compare", *given).output


def test_compare_with_positions_only_has_three_components(tmp_path):
    arm = poses.arm_toml(tmp_path / "arm.toml")
    data = poses.poses_csv(tmp_path / "d.csv", 60, 3, position_only=True)
    got = answer("compare", "--arm", arm, "--data", data)
    assert got["components"] == 3
    assert got["rms"]["held"]["rot_mrad"] is None


def test_diagnose_names_the_effect_and_answers_with_the_pinned_keys(given):
    got = answer("diagnose", *given)
    has(COMPARE | DIAGNOSE, got)
    assert got["verdict"] == "effect"
    best = got["effects"][0]
    assert set(best) >= EFFECT
    assert (best["name"], best["accepted"]) == ("backlash[4]", True)
    assert best["held_rms_after_mm"] < best["held_rms_before_mm"]
    assert best["probability"] > 0.9
    (value,) = best["parameters"]
    assert set(value) == {"name", "value", "std_err", "unit"}
    assert value["value"] == pytest.approx(3e-3, abs=4 * value["std_err"])
    assert "consistent with" in best["why"]
    needs = {row["name"]: row["needs"] for row in got["not_testable"]}
    assert needs["latency"] == ["qdot"]


def test_added_effect_is_no_longer_missing(given, model, compared):
    good("add", "--model", model, "backlash[4]")
    got = answer("diagnose", *given, "--model", model)
    assert got["verdict"] == "adequate"
    assert got["rms"]["held"]["pos_mm"] < compared["rms"]["held"]["pos_mm"]


def test_model_is_built_step_by_step(given, model, folder):
    good("add", "--model", model, "backlash[4]")
    good("add", "--model", model, "base_flex", "joint_compliance[2]")
    assert good("list", "--model", model).output.split() == [
        "backlash[4]",
        "base_flex",
        "joint_compliance[2]",
    ]
    good("remove", "--model", model, "base_flex", "joint_compliance[2]")
    good("undo", "--model", model)
    good("undo", "--model", model)
    assert answer("list", "--model", model)["effects"] == ["backlash[4]"]
    actions = [line.split()[1] for line in good("history", "--model", model).output.splitlines()]
    assert actions == ["add", "add", "remove", "undo", "undo"]
    fitted = answer("fit", *given, "--model", model)
    by_name = {p["name"]: p for p in fitted["parameters"]}
    assert by_name["backlash[4].h"]["value"] == pytest.approx(
        3e-3, abs=4 * by_name["backlash[4].h"]["std_err"]
    )
    models = {r["model"] for r in fitted["nested_models"]["models"]}
    assert models == {"nominal", "DH", "+ backlash[4]"}
    assert {r["held_out"] for r in fitted["nested_models"]["models"]} == {
        "poses in turns", "held-out poses", "unseen region", "time block", "direction"}  # fmt: skip
    # values are in the file now, and the arm it is for
    assert "backlash[4].h = " in good("list", "--model", model).output
    assert tomllib.loads(model.read_text())["arm"] == str(folder / "arm.toml")


@pytest.mark.parametrize(("effect", "joints"), [("backlash[3,4]", (3, 4)), ("backlash", range(1, 8))])
def test_list_shows_the_values_of_an_effect_at_several_joints(given, model, effect, joints):
    good("add", "--model", model, effect)
    good("fit", *given, "--model", model)
    shown = good("list", "--model", model).output.splitlines()
    assert [line.split()[0] for line in shown] == [effect, *(f"backlash[{j}].h" for j in joints)]


def test_unnamed_effect_is_added_fitted_taken_back_and_flown(given, model, compared):
    name = "unnamed[joint 4: dir4]"
    said = good("add", *given, "--model", model, "unnamed[joint 4:dir4]").output
    assert f"{name}: 1 coefficient (" in said
    assert "c1 x dir4 at joint[4]" in said
    assert ": improved" in said
    fitted = answer("fit", *given, "--model", model)
    assert fitted["rms"]["held"]["pos_mm"] < compared["rms"]["held"]["pos_mm"]
    assert "+ " + name in {row["model"] for row in fitted["nested_models"]["models"]}
    value = next(p for p in fitted["parameters"] if p["name"] == f"{name}.c1")
    assert value["value"] == pytest.approx(3e-3, abs=4 * value["std_err"])
    assert f"{name}.c1 = " in good("list", "--model", model).output
    good("uplink", "--model", model)
    good("remove", "--model", model, name)
    assert answer("list", "--model", model)["effects"] == []
    good("undo", "--model", model)
    assert answer("list", "--model", model)["effects"] == [name]
    assert answer("diagnose", *given, "--model", model)["verdict"] == "adequate"
    twice = kincal("add", *given, "--model", model, name)
    assert (twice.exit_code, "already in the model" in twice.output) == (EXIT_INPUT, True)


def test_unnamed_alone_adds_all_that_pay_in_one_step(given, model):
    said = good("add", *given, "--model", model, "encoder_gain[4]", "unnamed").output
    effects = answer("list", "--model", model)["effects"]
    assert effects[0] == "encoder_gain[4]"
    assert all(name.startswith("unnamed[") for name in effects[1:])
    assert any("dir4" in name for name in effects[1:])
    assert f"unnamed: {len(effects) - 1} added; held-out error with all of them: " in said
    again = good("add", *given, "--model", model, "unnamed").output
    assert "unnamed: nothing to add" in again
    assert answer("list", "--model", model)["effects"] == effects
    good("undo", "--model", model)
    assert answer("list", "--model", model)["effects"] == []


def test_unnamed_effect_needs_measurements(model):
    done = kincal("add", "--model", model, "unnamed")
    assert (done.exit_code, "give --arm and --data" in done.output) == (EXIT_INPUT, True)
    done = kincal("add", "--model", model, "unnamed[joint 4: q4]")
    assert done.exit_code == EXIT_INPUT
    assert "give --arm and --data" in done.output
    model.write_text('effects = ["unnamed[joint 4: q4]"]\n')
    done = kincal("list", "--model", model)
    assert (done.exit_code, "add it again" in done.output) == (EXIT_INPUT, True)


def test_effect_of_all_joints_is_not_added_beside_one_of_them(tmp_path):
    for first, second in (("backlash", "backlash[4]"), ("backlash[4]", "backlash")):
        path = tmp_path / f"{first}.toml"
        assert kincal("add", "--model", path, first).exit_code == 0
        done = kincal("add", "--model", path, second)
        assert done.exit_code == EXIT_INPUT
        assert "cannot stand beside" in done.output
    twice = kincal("add", "--model", tmp_path / "N.toml", "latency", "latency")
    assert twice.exit_code == EXIT_INPUT, twice.output


def test_fit_says_when_an_effect_does_not_help(given, model):
    good("add", "--model", model, "backlash[2]")
    assert (
        "backlash[2] does not help on poses held out in turns" in good("fit", *given, "--model", model).output
    )


def test_next_poses_name_the_alternatives(given):
    got = answer("next", *given, "--count", 3, "joint_compliance[2]", "base_flex")
    assert len(got["next_poses"]) == 3
    for pose in got["next_poses"]:
        assert set(pose) >= {"q", "separates", "power"}
        assert len(pose["q"]) == 7
        assert pose["separates"] == ["joint_compliance[2]", "base_flex"]
    assert "next poses, to separate" in good("next", *given, "joint_compliance[2]", "base_flex").output


def test_next_poses_keep_clear_of_the_shapes_of_a_search_space(given, tmp_path):
    """A ball that is kept out where the tool would have been."""
    bin_dir, names = BIN, ("--count", 4, "joint_compliance[2]", "base_flex")
    free = answer("next", *given, *names)["next_poses"]
    shapes = tmp_path / "space.toml"
    ball = f'[[keep_out]]\nname = "ball"\nkind = "sphere"\ncentre_m = {free[0]["tool_m"]}\nradius_m = 0.25\n'
    shapes.write_text((SRC / "space.toml").read_text() + ball)
    folder = space.TablesFolder(bin_dir)
    arm = space.CollisionModel(space.read_description(shapes), folder.arm, folder.camera)
    assert "ball" in arm.contact(np.array(free[0]["q"]))
    clear = answer("next", *given, *names, "--space", shapes, "--tables", bin_dir)["next_poses"]
    assert len(clear) == 4
    for pose in clear:
        assert arm.contact(np.array(pose["q"])) == ""
        assert np.linalg.norm(np.subtract(pose["tool_m"], free[0]["tool_m"])) > 0.2


def test_next_poses_refuse_shapes_of_another_arm(given, tmp_path):
    for name in ("arm", "camera"):
        (tmp_path / f"{name}.tbl").write_bytes((BIN / f"{name}.tbl").read_bytes())
    shapes = SRC / "space.toml"
    other = ("--arm", "iiwa7", *given[2:], "--force")
    done = kincal("next", *other, "--space", shapes, "--tables", tmp_path, "backlash[4]", "base_flex")
    assert done.exit_code == EXIT_INPUT
    assert "other DH parameters" in done.output


def test_next_poses_are_written_as_measurements_are_read(given, folder, tmp_path):
    out = tmp_path / "next.csv"
    got = answer("next", *given, "--count", 3, "-o", out, "joint_compliance[2]", "base_flex")["next_poses"]
    arm = wb.read_arm(folder / "arm.toml")
    back = wb.read_csv(out, arm.n)
    assert back.q == pytest.approx(np.array([pose["q"] for pose in got]), abs=1e-8)
    assert back.p_m == pytest.approx(np.array([pose["tool_m"] for pose in got]), abs=1e-8)
    assert back.direction.tolist() == [pose["direction"] for pose in got]
    assert [set(pose) >= {"d2", "probability"} for pose in got] == [True] * 3
    done = kincal("next", *given, "backlash[4]", "backlash[4]")
    assert (done.exit_code, "twice" in done.output) == (EXIT_INPUT, True)
    done = kincal("next", *given, "--inside", "1,2,x", "backlash[4]", "base_flex")
    assert (done.exit_code, "x0,y0,z0" in done.output) == (EXIT_INPUT, True)


def test_effects_lists_what_people_need():
    rows = {row["name"]: row for row in answer("effects")}
    assert len(rows) >= 28
    row = rows["joint_compliance[j]"]
    wrong = row["parameters"][0].pop("if_negative")
    assert row["parameters"] == [{"name": "c", "unit": "rad/(N m)", "sigma": 2e-4, "image": None}]
    assert "gravity_m_s2" in wrong
    for name, row in rows.items():
        for key in ("title", "formula", "looks_like", "inspect"):
            assert row[key], f"{name} has no {key}"
    text = good("effects").output
    assert "dq_j = c_j tau_j" in text
    assert f"c is positive in nature; if negative, {wrong}" in text
    assert "confounded with" in text


# --------------------------------------------------------------------------- uplink


def test_uplink_writes_an_image_that_flight_accepts(given, model):
    good("add", "--model", model, "backlash[4]", "encoder_eccentricity[5]")
    good("fit", *given, "--model", model)
    done = good("uplink", "--model", model)
    image, struct_ = tables.load(model.with_suffix(".tbl"))
    assert image.kind == "terms"
    assert image.crc_text in done.output
    names = [ffi.string(struct_.coef[i].name).decode() for i in range(struct_.n_coef)]
    assert names[28:] == ["backlash[4]", "encoder_eccentrici[5].A", "encoder_eccentrici[5].B"]
    assert all(struct_.coef[i].enabled for i in range(struct_.n_coef))


def test_uplink_keeps_the_step_time_that_the_fit_found(tmp_path, model):
    """An effect whose constant comes from the data: the image says the same without the data."""
    count = iter(range(10**6))

    def true_q(q, _direction):
        return q + np.array([0, 5e-3 * (next(count) >= 30), 0, 0, 0, 0, 0])

    arm = poses.arm_toml(tmp_path / "arm.toml")
    data = poses.poses_csv(tmp_path / "d.csv", 60, 5, true_q)
    good("add", "--model", model, "bias_step[2]")
    assert kincal("uplink", "--model", model, "--arm", arm).exit_code == EXIT_INPUT
    good("fit", "--arm", arm, "--data", data, "--model", model)
    t0 = wb.read_model(model).constants["bias_step[2]"]["t0"]
    assert 29 * 60.0 <= t0 <= 31 * 60.0
    good("uplink", "--model", model, "-o", tmp_path / "a.tbl")
    good("uplink", "--model", model, "--data", data, "-o", tmp_path / "b.tbl")
    assert (tmp_path / "a.tbl").read_bytes() == (tmp_path / "b.tbl").read_bytes()
    assert struct.pack("<d", t0) in (tmp_path / "a.tbl").read_bytes()


# --------------------------------------------------------------------------- own effects, logs, own arms


def test_own_effect_is_listed_added_fitted_and_uplinked(tmp_path, model):
    mine = tmp_path / "mine.toml"
    mine.write_text(MINE)
    arm = poses.arm_toml(tmp_path / "arm.toml")

    def true_q(q, _direction):
        return q + np.array([0, 0, 8e-3 * np.tanh(q[3]) * np.cos(q[5]), 0, 0, 0, 0])

    given = ("--arm", arm, "--data", poses.poses_csv(tmp_path / "d.csv", 80, 13, true_q))
    assert "odd_coupling" in good("effects", "--effects", mine).output
    got = answer("diagnose", *given, "--effects", mine)
    assert (got["verdict"], got["effects"][0]["name"]) == ("effect", "odd_coupling")
    good("add", "--model", model, "--effects", mine, "odd_coupling")
    fitted = answer("fit", *given, "--model", model)  # the model file remembers whose library it needs
    k = next(p for p in fitted["parameters"] if p["name"] == "odd_coupling.k")
    assert k["value"] == pytest.approx(8e-3, abs=4 * k["std_err"])
    nested = {m["model"]: m for m in fitted["nested_models"]["models"] if m["held_out"] == "held-out poses"}
    assert nested["+ odd_coupling"]["pos_mm"] < nested["DH"]["pos_mm"]
    good("uplink", "--model", model)
    table = tables.load(model.with_suffix(".tbl"))[1]
    assert (ffi.string(table.coef[28].name), table.n_term) == (b"odd_coupling", 29)


def test_effects_that_the_model_file_remembers_may_be_named_again(tmp_path, monkeypatch):
    """By a path from the folder of work; only other effects of the same name are refused."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text(MINE)
    (tmp_path / "copy.toml").write_text(MINE)
    good("add", "--model", "M.toml", "--effects", "mine.toml", "odd_coupling")
    good("add", "--model", "M.toml", "--effects", "mine.toml", "backlash[4]")
    done = kincal("add", "--model", "M.toml", "--effects", "copy.toml", "backlash[5]")
    assert done.exit_code == EXIT_INPUT and "already in the library" in done.stderr


def test_log_of_the_flight_process_is_read_as_it_is(flight_log):
    got = answer("compare", "--arm", "wam", "--data", flight_log)
    has(COMPARE, got)
    assert got["poses"] >= 12
    assert got["noise_floor"]["source"] == "stated covariance"
    arm = wb.read_arm("wam")
    data = read_measurements(flight_log, arm.n)
    for column in (
        "dir", "temp_c", "payload_kg", "qdot", "range_m", "incid_rad", "u_px", "cam", "pan_rad", "tag",
    ):  # fmt: skip
        assert data.has(column), column


def test_log_without_measurements_and_of_another_arm_is_refused(tmp_path, flight_log):
    samples.write_log(tmp_path / "run.lcmlog")
    done = kincal("compare", "--arm", "wam", "--data", tmp_path / "run.lcmlog")
    assert done.exit_code == EXIT_INPUT
    assert "KC_MEAS" in done.output
    two = tmp_path / "two.toml"
    head, joint, *_ = poses.arm_toml(tmp_path / "seven.toml").read_text().split("[[joint]]")
    two.write_text(head + f"[[joint]]{joint}" * 2)
    done = kincal("compare", "--arm", two, "--data", flight_log)
    assert done.exit_code == EXIT_INPUT
    assert "7 joints" in done.output


def test_shipped_arm_is_the_arm_that_flies():
    arm, flown = wb.read_arm("wam"), tables.load(BIN / "arm.tbl")[1]
    camera = tables.load(BIN / "camera.tbl")[1]
    assert arm.n == flown.n_joints
    for ours, theirs in zip(arm.joints, flown.joint, strict=False):
        for key in ("a_m", "alpha_rad", "d_m", "phi_rad", "q_min", "q_max", "mass_kg", "gear_ratio"):
            assert getattr(ours, key) == pytest.approx(getattr(theirs, key), abs=1e-15)
        assert list(ours.com_m) == pytest.approx(list(theirs.com_m))
    assert list(arm.base.xyz_m) == list(flown.base_xyz_m)
    assert list(arm.tool.xyz_m) == list(flown.tool_xyz_m)
    assert list(arm.gravity_m_s2) == list(flown.gravity_m_s2)
    for key in ("fx_px", "fy_px", "cx_px", "cy_px"):
        assert getattr(arm.camera, key) == getattr(camera, key)


# --------------------------------------------------------------------------- report


def test_report_is_one_page_with_every_figure(given, tmp_path, monkeypatch):
    """And each beside it as a picture; test_wheel.py has them drawn."""
    drawn = []
    monkeypatch.setattr(image, "save", lambda figures: drawn.extend(figures) or [])
    page = tmp_path / "out" / "report.html"
    done = good("diagnose", *given, "--report", page)
    assert str(page) in done.output.replace("\n", "")
    assert "backlash[4]" in done.output and "'Consistent with' does not" in done.output
    text = page.read_text()
    own = re.sub(r"<script>.*?</script>", "", text, flags=re.S)  # plotly.js names its home in comments
    assert not re.search(r"""(?:src|href)=["'](?!data:|#)|https?://|@import|url\(""", own)
    assert {path.name for path in drawn} == {f"report-{key}.png" for key in FIGURES}
    assert text.count('data-figure="figure-') == 10
    assert text.count("<table>") >= 2
    head = re.sub(r"</?a\b[^>]*>", "", text[: text.index("<details>")])  # links of words to the glossary
    assert "backlash[4] (P " in head
    assert "Inspect:" in head
    for label in ("nominal arm", "after DH calibration", "with the findings"):
        assert label in head


def test_figures_of_awkward_data_are_made(tmp_path):
    """Positions only, no held-out poses, nothing found: every figure can still be drawn."""
    arm = wb.read_arm(poses.arm_toml(tmp_path / "arm.toml", masses=False))
    path = poses.poses_csv(tmp_path / "d.csv", 40, 3, position_only=True)
    rows = path.read_text().splitlines()
    path.write_text("\n".join([rows[0] + ",split", *[row + ",fit" for row in rows[1:]]]) + "\n")
    library, data = wb.Library.load(), wb.read_csv(path, 7)
    found = wb.diagnose(arm, data, library)
    made = pages.page(report_content(found, library), Provenance("2026-11-22"))
    assert len(pages.pictures(made, tmp_path / "page.html")) >= 8
    assert "These data show no missing effect." in render(made)


def test_nested_models_of_a_report_are_those_of_the_model_file(tmp_path):
    """Effects under the name they were added by, and DH errors only where the model has them."""
    arm, library = wb.read_arm(poses.arm_toml(tmp_path / "arm.toml")), wb.Library.load()
    data = wb.read_csv(poses.poses_csv(tmp_path / "d.csv", 40, 3, dh_size=0.0), 7)
    effects = library.find("backlash[3,4]", arm, data)
    found = wb.diagnose(arm, data, library, effects, dh=False)
    content = report_content(found, library, ["backlash[3,4]"], dh=False)
    labels = [m.model for m in content.nested.models if m.block == content.nested.models[0].block]
    assert labels[:2] == ["nominal", "+ backlash[3,4]"]
    assert "DH" not in labels


# --------------------------------------------------------------------------- what is refused


def rewritten(folder, tmp_path, change):
    """The measurements with rows changed: change(header, rows) in place."""
    with (folder / "poses.csv").open(newline="") as file:
        header, *rows = list(csv.reader(file))
    change(header, rows)
    path = tmp_path / "changed.csv"
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([header, *rows])
    return path


def set_cell(line, name, value):
    def change(header, rows):
        rows[line - 2][header.index(name)] = value

    return change


def test_skip_bad_keeps_the_rest_and_counts(folder, tmp_path):
    data = rewritten(folder, tmp_path, set_cell(7, "px", "nan"))
    got = answer("compare", "--arm", folder / "arm.toml", "--data", data, "--skip-bad")
    assert (got["poses"], got["skipped"]) == (43, 1)


def few(count):
    def change(_header, rows):
        del rows[count:]

    return change


def all_alike(_header, rows):
    for row in rows:
        row[2:] = rows[0][2:]


def one_joint(_header, rows):
    """Only joint 1 moves: a circle."""
    for k, row in enumerate(rows):
        angle = -1.5 + 3.0 * k / len(rows)
        q = np.array([angle, 0.4, 0.1, 1.2, 0.2, 0.3, 0.1])
        pose = poses.tool_pose(q, np.zeros((7, 4)))
        row[2:16] = [*map(str, [*q, *pose[:3, 3], *poses.quat_wxyz(pose[:3, :3])])]


@pytest.mark.parametrize("change", [few(3), few(5), all_alike, one_joint])
@pytest.mark.parametrize("verb", ["compare", "diagnose"])
def test_data_that_cannot_answer_are_status_3(folder, tmp_path, change, verb):
    done = kincal(verb, "--arm", folder / "arm.toml", "--data", rewritten(folder, tmp_path, change))
    assert done.exit_code == EXIT_DATA, done.output
    assert "poses" in done.output
    assert done.stdout == ""


def test_effect_without_its_column_is_status_3(folder, model):
    good("add", "--model", model, "latency")
    done = kincal("fit", "--arm", folder / "arm.toml", "--data", folder / "poses.csv", "--model", model)
    assert done.exit_code == EXIT_DATA
    assert "qdot" in done.output


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (("add", "--model", "M.toml", "joint_complaince[2]"), ["joint_complaince", "joint_compliance"]),
        (("add", "--model", "M.toml", "joint_compliance[x]"), ["joint_compliance[2]"]),
        (("add", "--model", "M.toml", "base_flex[2]"), ["whole arm"]),
        (("list", "--model", "none.toml"), ["none.toml", "no such file"]),
        (("undo", "--model", "none.toml"), ["no such file"]),
        (("history", "--model", "none.toml"), ["no such file"]),
        (("remove", "--model", "none.toml", "backlash[4]"), ["no such file"]),
        (("uplink", "--model", "none.toml"), ["no such file"]),
        (("effects", "--effects", "none.toml"), ["none.toml"]),
        (("compare", "--arm", "none", "--data", "d.csv"), ["none", "wam"]),
    ],
)
def test_bad_words_are_status_2_and_say_what_to_do(tmp_path, monkeypatch, args, words):
    monkeypatch.chdir(tmp_path)
    done = kincal(*args)
    assert done.exit_code == EXIT_INPUT, done.output
    for word in words:
        assert word in done.output


def test_undo_without_history_and_a_single_alternative_are_refused(given, model):
    good("add", "--model", model, "backlash[4]")
    good("undo", "--model", model)
    done = kincal("undo", "--model", model)
    assert (done.exit_code, "nothing to undo" in done.output) == (EXIT_INPUT, True)
    done = kincal("next", *given, "backlash[4]")
    assert (done.exit_code, "two or more" in done.output) == (EXIT_INPUT, True)
    done = kincal("next", *given, "backlash[9]", "base_flex")
    assert (done.exit_code, "no such joint" in done.output) == (EXIT_INPUT, True)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (('basis = "tanh(q4) * cos(q6)"', 'basis = "tanh(q4) * cosh(q6)"'), "cosh"),
        (('name = "odd_coupling"', 'name = "backlash"'), "already"),
        (('at = "joint[3]"', 'at = "joint[9]"'), "joint"),
    ],
)  # fmt: skip
def test_broken_effect_file_is_refused_with_the_reason(given, tmp_path, change, word):
    assert MINE.count(change[0]) >= 1
    mine = tmp_path / "mine.toml"
    mine.write_text(MINE.replace(*change, 1))
    done = kincal("diagnose", *given, "--effects", mine)
    assert done.exit_code == EXIT_INPUT
    assert word in done.output
    assert "mine.toml" in done.output
