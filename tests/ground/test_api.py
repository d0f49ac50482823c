"""`import kincal` for programs and notebooks."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import poses
import pytest
from commands import good
from exports import drivers_at, python_module

import kincal
import kincal.api
from kincal import workbench as wb
from kincal.export import calibrated_arm
from kincal_shared.errors import BadInput


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("api")
    poses.arm_toml(out / "arm.toml")
    poses.poses_csv(out / "poses.csv", 44, 4, lambda q, d: q + np.array([0, 0, 0, 3e-3 * d[3], 0, 0, 0]))
    return out


@pytest.fixture(scope="module")
def given(folder):
    return kincal.Arm.load(folder / "arm.toml"), kincal.Data.load(folder / "poses.csv")


@pytest.fixture(scope="module")
def fitted(given):
    return kincal.fit(*given, ["backlash[4]", "tag_scale"])


def test_import_alone_is_light():
    code = (
        "import sys, kincal; print([n for n in ('numpy', 'scipy', 'pydantic', 'click') if n in sys.modules])"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("start", "loaded", "without"),
    [
        ("from kincal.cli import main; main(['review', '--help'], standalone_mode=False)", "kincal.review",
         {"scipy", "pycparser", "kincal.workbench"}),
        ("import kincal.campaign.worker", "kincal.campaign", {"mujoco", "kincal.run", "kincal.workbench"}),
        ("import kincal.run.dispersed", "mujoco", {"scipy.stats", "pycparser", "kincal.workbench"}),
    ],
)  # fmt: skip
def test_what_takes_long_to_load_waits_until_it_is_needed(start, loaded, without):
    ask = f"print(sorted({without} & sys.modules.keys()), '{loaded}' in sys.modules)"
    code = f"import sys; {start}; {ask}"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert said.stdout.splitlines()[-1] == "[] True", said.stderr


def test_names_are_there_and_others_are_not():
    assert set(kincal.__all__) <= set(dir(kincal))
    with pytest.raises(AttributeError, match="calibrate"):
        _ = kincal.calibrate


def test_the_one_door_has_runs_logs_and_the_link_too_and_loads_each_when_it_is_used():
    code = (
        "import sys, kincal.api as api; print('numpy' in sys.modules); "
        "print(set(api.__all__) <= set(dir(api)), [n for n in api.__all__ if not callable(getattr(api, n))])"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert said.stdout.split("\n")[:2] == ["False", "True []"], said.stderr
    assert set(kincal.__all__) <= set(kincal.api.__all__)
    with pytest.raises(AttributeError, match="diagnosis"):
        _ = kincal.api.diagnosis


def test_compare_and_diagnose_show_themselves(given):
    compared, found = kincal.compare(*given), kincal.diagnose(*given)
    assert not compared.comparison.adequate
    assert "WAM: 44 poses" in str(compared)
    assert found.effects == ("backlash[4]",)
    for answer in (compared, found):
        assert "<table>" in answer._repr_html_()
    assert "backlash[4]" in found._repr_html_()


@pytest.mark.parametrize("verb", [kincal.compare, kincal.diagnose, kincal.fit])
def test_data_of_another_arm_are_refused_unless_forced(given, verb):
    arm, data = given
    read = data.read(arm)
    swapped = replace(read, q=read.q[:, [0, 2, 1, 3, 4, 5, 6]])
    with pytest.raises(BadInput, match=r"do not belong together(.|\n)*force=True"):
        verb(arm, swapped)


def test_a_forced_comparison_says_what_is_wrong(given):
    arm, data = given
    read = data.read(arm)
    flipped = replace(read, q=read.q * [1, 1, 1, 1, 1, 1, -1])
    compared = kincal.compare(arm, flipped, force=True)
    assert [finding.code for finding in compared.comparison.consistency.errors] == ["sign"]
    assert compared.comparison.consistency.doubts[0] in str(compared)
    assert kincal.compare(arm, read).comparison.consistency.doubts == ()


def test_fit_holds_what_the_workbench_fit_holds(given, fitted, folder):
    direct = wb.fit(
        wb.read_arm(folder / "arm.toml"), wb.read_csv(folder / "poses.csv", 7), ["backlash[4]", "tag_scale"]
    )
    assert fitted.names == direct.names
    assert [v for v, *_ in fitted.parameters.values()] == pytest.approx(direct.estimate.tolist())
    assert np.allclose(fitted.covariance, direct.fit.cov)
    assert np.allclose(fitted.residuals(), direct.fit.evaluation.r)
    assert np.allclose(fitted.residuals(given[1]), direct.fit.evaluation.r)
    assert "backlash[4]" in fitted._repr_html_()


def test_predict_is_the_exported_code(given, fitted, folder):
    fitted.export("python", folder / "made.py")
    module, data = python_module(folder / "made.py"), given[1].read(given[0])
    names = {*module.DEFAULTS, *module.NEEDED}
    many = fitted.predict(
        data.q, direction=data.direction, sensor_xyz_m=data.cam_p_m, sensor_wxyz=data.cam_quat_wxyz
    )
    for i in range(5):
        p, R = module.forward(data.q[i], **drivers_at(data, i, names))
        one = fitted.predict(data.q[i], **drivers_at(data, i, names))
        assert np.abs(many.p_m[i] - p).max() < 1e-9
        assert np.abs(one.p_m - p).max() < 1e-9
        assert np.abs(one.R - R).max() < 1e-9


def test_correct_brings_the_tool_to_where_it_was_planned(fitted):
    q = np.array([[0.2, 0.5, -0.3, 1.5, 0.2, -0.9, 0.3], [0.1, 0.6, -0.2, 1.3, 0.0, -0.8, 0.1]])
    direction = [1, 1, 1, -1, 1, 1, 1]
    sent = fitted.correct(q, direction=direction)
    nominal = fitted._code.nominal(q[1])
    assert np.abs(fitted.predict(sent, direction=direction).p_m[1] - nominal[0]).max() < 2e-9
    assert sent.shape == (2, 7)
    assert fitted.correct(q[0], direction=direction).shape == (7,)


def test_missing_driver_and_unreachable_pose_are_said(fitted):
    with pytest.raises(BadInput, match="missing: direction"):
        fitted.predict(np.zeros(7))
    with pytest.raises(BadInput, match="unknown: wind"):
        fitted.predict(np.zeros(7), direction=np.ones(7), wind=1.0)


def test_unnamed_effect_is_fitted_saved_and_exported(tmp_path):
    """An error of joint 3 that follows joint 4 has no name; it goes into the exported code all the same."""
    poses.arm_toml(tmp_path / "arm.toml")
    poses.poses_csv(
        tmp_path / "poses.csv", 120, 4, lambda q, _: q + np.array([0, 0, 8e-3 * np.sin(2 * q[3]), 0, 0, 0, 0])
    )
    arm, data = kincal.Arm.load(tmp_path / "arm.toml"), kincal.Data.load(tmp_path / "poses.csv")
    fitted = kincal.fit(arm, data, ["unnamed[joint 3: q4]"])
    fitted.save(tmp_path / "M.toml")
    model = wb.read_model(tmp_path / "M.toml")
    library = wb.Library.load().with_unnamed(model.unnamed.values())
    again = calibrated_arm(arm.table, model, library)
    assert [c.name for c in again.coefficients] == list(fitted.names)
    fitted.export("python", tmp_path / "made.py")
    module = python_module(tmp_path / "made.py")
    q = np.array([0.2, 0.5, -0.3, 1.5, 0.2, -0.9, 0.3])
    assert np.abs(module.forward(q)[0] - fitted.predict(q).p_m).max() < 1e-9
    assert np.linalg.norm(module.forward(q)[0] - fitted.predict(q + [0, 0, 0, 0.3, 0, 0, 0]).p_m) > 1e-3


def test_saved_model_serves_the_commands(fitted, folder):
    fitted.save(folder / "M.toml")
    assert wb.read_model(folder / "M.toml").fit.data[0].path == str(folder / "poses.csv")
    words = ("--model", folder / "M.toml", "--format", "urdf", "-o", folder / "o.urdf")
    good("model", "export", *words)
    joints = [line for line in (folder / "o.urdf").read_text().splitlines() if "<origin" in line]
    assert joints == [line for line in fitted.to_urdf().splitlines() if "<origin" in line]


def test_data_takes_other_names_and_units(given, folder):
    arm, data = given[0], given[1].read(given[0])
    rows = np.column_stack([np.degrees(data.q), 1e3 * data.p_m])
    head = ",".join([*(f"A{j}" for j in range(1, 8)), "X", "Y", "Z"])
    np.savetxt(folder / "other.csv", rows, delimiter=",", header=head, comments="", fmt="%.15g")
    other = kincal.Data.load(
        folder / "other.csv",
        columns={"q": "A{}", "p": ["X", "Y", "Z"]},
        units={"angle": "deg", "length": "mm"},
    )
    assert np.allclose(other.read(arm).q, data.q)
    assert np.allclose(other.read(arm).p_m, data.p_m)
    with pytest.raises(BadInput, match="no such file"):
        kincal.Data.load("nowhere.csv")


def test_arm_comes_from_a_urdf(tmp_path):
    pytest.importorskip("yourdfpy")
    (tmp_path / "bot.urdf").write_text(
        '<robot name="bot"><link name="base"/><link name="arm"/><joint name="j" type="revolute">'
        '<parent link="base"/><child link="arm"/><origin xyz="0 0 0.3"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
    )
    arm = kincal.Arm.from_urdf(tmp_path / "bot.urdf")
    assert (arm.name, arm.n, arm.table.joints[0].link) == ("bot", 1, "arm")
    assert arm.table.provenance["tip_link"] == "arm"
