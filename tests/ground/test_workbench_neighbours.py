"""Near poses that are alike in what a fit leaves: functions that no driver describes, and silence without."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import poses
import pytest
from scipy.spatial.transform import Rotation

from kincal import workbench as wb
from kincal.workbench.comparison.compare import compare
from kincal.workbench.diagnosis import findings
from kincal.workbench.evidence.adequacy import Outliers, bulk_weights
from kincal.workbench.evidence.neighbours import NEIGHBOURS_P, Alike, neighbours_alike
from kincal.workbench.evidence.scoring import Scorer
from kincal.workbench.evidence.serial import Serial
from kincal.workbench.fit.least_squares import fit_model
from kincal.workbench.report import explain
from kincal.workbench.report.answers import comparison_json
from kincal.workbench.report.diagnosis_text import diagnosis_text


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """120 poses that a laser tracker measured: no camera, its noise unknown."""
    folder = tmp_path_factory.mktemp("data")
    data = wb.read_csv(poses.poses_csv(folder / "d.csv", 120, 31, noise_size=0.1), 7)
    return replace(data, cam_p_m=None, cam_quat_wxyz=None, cov=None)


@pytest.fixture(scope="module")
def scorer(arm, measured):
    fit = fit_model(arm, measured)
    return Scorer(fit, bulk_weights(fit), stated=False)


def fast_wave(data):
    """The sensor is off by a circle, six times a turn of the tool's x axis about the vertical: faster than
    anything that the map has."""
    x = Rotation.from_quat(data.quat_wxyz, scalar_first=True).as_matrix()[:, :, 0]
    angle = 6 * np.arctan2(x[:, 1], x[:, 0])
    return replace(data, p_m=data.p_m + 1e-3 * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle]))


@pytest.fixture(scope="module")
def diagnosed(arm, measured):
    return wb.diagnose(arm, fast_wave(measured), wb.Library.load())


def test_a_function_that_no_variable_describes_is_no_noise(diagnosed):
    found = diagnosed.comparison
    assert found.p_structure > 0.01 and found.alike.p_value < NEIGHBOURS_P
    assert (found.alike.by, found.alike.at) == (("tool_x",), "position in the frame of the sensor")
    assert found.alike.correlation > 0.2
    assert (diagnosed.verdict, found.adequate, diagnosed.adequate_after) == ("undecidable", False, False)


def test_joints_that_stay_are_no_places(arm, measured):
    still = replace(measured, q=measured.q * [0, 1, 1, 1, 0, 1, 1] + [0.1, 0, 0, 0, 0.3, 0, 0])
    assert not {"q1", "q5"} & set(compare(arm, still).alike.by)


def test_what_near_poses_have_in_common_is_said(diagnosed):
    said = diagnosis_text(diagnosed)
    common = (
        "near poses, by direction of the tool's x axis, have its part at position in the frame of the sensor"
    )
    assert said.count(common) == 2 and "depends on no recorded variable" not in said
    assert comparison_json(diagnosed.comparison)["neighbours"]["by"] == ["tool_x"]


def test_noise_that_follows_time_is_not_taken_for_something_missing():
    """On a path it is alike at near poses too."""
    alike = Alike(("all joints",), "joint 2", 1e-9, 0.5)
    c = SimpleNamespace(outliers=Outliers((), 90), turned=None, p_unseen=None, alike=alike)
    assert findings._verdict(0.9, (), None, c, None) == "undecidable"
    assert findings._verdict(0.9, (), None, c, Serial(0.5, 1e-9)) == "adequate"


def test_noise_alone_has_nothing_in_common(arm, measured, scorer):
    found = compare(arm, measured)
    assert found.adequate and not found.alike.shown
    draws = np.random.default_rng(8).standard_normal((16, len(scorer.wz)))
    p = [_of_noise(scorer, draw).p_value for draw in draws]
    assert sum(x < 0.2 for x in p) <= 8  # of 16, more than half: once in 600, at 0.2 each


def _of_noise(scorer, z):
    noisy = SimpleNamespace(**{k: getattr(scorer, k) for k in ("columns", "projector")})
    noisy.wz = scorer.projector.apply(z)
    return neighbours_alike(noisy)


@pytest.mark.parametrize("by", [("q2",), ("q2", "q4")])
def test_a_joint_may_follow_what_no_term_is_fast_enough_for(scorer, by):
    """Of one reading 23 periods a turn, of two a product of waves."""
    q = scorer.columns.fit.data.q
    value = np.sin(23 * q[:, 1]) if len(by) == 1 else np.sin(3 * q[:, 1]) * np.sin(4 * q[:, 3])
    there = 2e-3 * (value[:, None] * scorer.columns.location(1, (5,))[:, 0]).ravel()
    found = _of_noise(scorer, there + np.random.default_rng(3).standard_normal(there.size))
    assert found.shown and (found.by, found.at) == (by, "joint 2")


def test_replicates_are_one_pose(arm, measured):
    """Each pose was read four times without leaving it: what the readings share follows nothing."""
    few = measured.take(np.repeat(np.arange(40), 4))
    common = 3e-4 * np.repeat(np.random.default_rng(6).normal(size=(40, 3)), 4, axis=0)
    data = replace(
        few, p_m=few.p_m + common, ids=tuple(map(str, range(160))), replicate=np.repeat(np.arange(40), 4)
    )
    assert not compare(arm, data).alike.shown


def test_few_poses_have_no_neighbours(arm, measured):
    assert compare(arm, measured.take(np.arange(18))).alike is None


@pytest.mark.parametrize(
    ("alike", "said"),
    [(Alike(("sensor_z",), "rotation in the frame of the tool", 1e-9, 0.5),
      "near poses, by direction of the sensor's z axis in the frame of the tool, have its part at rotation"),
     (Alike(("q2", "q4"), "joint 2", 1e-9, 0.5), "near poses, by q2 and q4, have its motion at joint 2")],
)  # fmt: skip
def test_likeness_in_words(alike, said):
    assert explain.alike(alike).startswith(said)
