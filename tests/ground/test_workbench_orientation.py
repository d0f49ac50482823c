"""Errors that follow the orientation of the tool: their drivers against scipy, where they are found, what is
said of them, and that no term stands for them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import poses
import pytest
from scipy.spatial.transform import Rotation

from kincal import workbench as wb
from kincal.cli.text import model as text
from kincal.pages import words
from kincal.pages.diagnosis_figures import location_map
from kincal.workbench.comparison.compare import compare
from kincal.workbench.diagnosis.additions import _first_instead
from kincal.workbench.diagnosis.heldout import HeldGain
from kincal.workbench.evidence import orientation
from kincal.workbench.evidence.orientation import axes_of_tool, orientation_features, z_component
from kincal.workbench.evidence.unnamed import oriented
from kincal.workbench.fit.columns import Columns
from kincal.workbench.fit.least_squares import fit_model
from kincal.workbench.model.unnamed_names import HEADINGS, UnnamedName
from kincal.workbench.prediction.reachable import Reachable
from kincal.workbench.report import advice, explain
from kincal.workbench.report.diagnosis_text import diagnosis_text
from kincal.workbench.report.partial import place_panels

SIGHT = np.array([0.8, 0.6, 0.0])  # from a tracker that is far away


def axes_of(data):
    """(N, 3, 3) measured axes of the tool."""
    return Rotation.from_quat(data.quat_wxyz, scalar_first=True).as_matrix()


def of_tracker(tmp_path, seed):
    """120 poses that a laser tracker measured: no camera, its noise unknown."""
    data = wb.read_csv(poses.poses_csv(tmp_path / f"{seed}.csv", 120, seed, noise_size=0.1), 7)
    return replace(data, cam_p_m=None, cam_quat_wxyz=None, cov=None)


def scaled_orientations(data):
    """The tracker turns its measurement by 4 mrad times where the tool's z axis points."""
    turn = Rotation.from_rotvec(4e-3 * np.cross(axes_of(data)[:, :, 2], [1.0, 0.0, 0.0]))
    turned = turn * Rotation.from_quat(data.quat_wxyz, scalar_first=True)
    return replace(data, quat_wxyz=turned.as_quat(scalar_first=True))


def target_off_its_centre(data):
    """The range is wrong by 3 mm times the cosine between a tool axis and the line of sight."""
    return replace(data, p_m=data.p_m + 3e-3 * (axes_of(data)[:, :, 0] @ SIGHT)[:, None] * SIGHT)


def bending_tool(data):
    """The target sinks by up to 3 mm where the tool's x axis is upright."""
    return replace(data, p_m=data.p_m - 3e-3 * axes_of(data)[:, 2, :1] ** 2 * [0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    return of_tracker(tmp_path_factory.mktemp("data"), 31)


@pytest.fixture(scope="module")
def diagnosed(arm, measured):
    return wb.diagnose(arm, bending_tool(measured), wb.Library.load())


# ------------------------------------------------------------------------------------------- drivers


def correlation(a, b):
    return abs(np.corrcoef(a, b)[0, 1])


def test_drivers_are_components_of_the_axes_where_the_model_expects_the_tool(arm, measured):
    columns = Columns(fit_model(arm, measured))
    found = dict(orientation_features(columns))
    axes = axes_of(measured)
    assert {name: x.shape[1] for name, x in found.items() if name not in HEADINGS} == {
        "orientation": 9, "tool_x": 8, "tool_y": 8, "tool_z": 8, "gravity": 8,
    }  # fmt: skip
    for k, component in enumerate(axes.reshape(-1, 9).T):
        assert correlation(found["orientation"][:, k], component) > 0.9999
    for axis in range(3):
        for k in range(3):
            assert correlation(found["tool_" + "xyz"[axis]][:, k], axes[:, k, axis]) > 0.9999
        assert correlation(z_component("tool_" + "xyz"[axis], columns), axes[:, 2, axis]) > 0.9999
    assert correlation(found["gravity"][:, 2], axes[:, 2, 2]) > 0.9999  # gravity is along z of the base
    assert correlation(z_component("gravity", columns), axes[:, 2, 2]) > 0.9999


def test_headings_are_waves_over_the_angles_of_euler(arm, measured):
    """The first of these turns about an axis of the sensor, the last about one of the tool."""
    columns = Columns(fit_model(arm, measured))
    found = dict(orientation_features(columns))
    assert set(HEADINGS) <= set(found)
    yaw_angle, _, roll_angle = Rotation.from_matrix(axes_of_tool(columns)).as_euler("ZYX").T
    waves = {
        "3 periods of tool_x about sensor_z": 3 * yaw_angle,
        "4 periods of sensor_z about tool_x": 4 * roll_angle,
    }
    for name, angle in waves.items():
        expected = np.column_stack([np.ones(measured.n), np.cos(angle), np.sin(angle)])
        left = np.linalg.lstsq(expected, found[name], rcond=None)[1]
        np.testing.assert_allclose(left, 0.0, atol=1e-12)


def test_gravity_may_come_from_another_side_at_every_pose(arm, measured):
    """As a lander that stands on a slope records it, or an arm that is tilted between poses."""
    g = np.random.default_rng(5).normal(size=(measured.n, 3))
    columns = Columns(fit_model(arm, replace(measured, g_m_s2=9.81 * g)))
    x = dict(orientation_features(columns))["gravity"]
    down = Rotation.from_quat(measured.quat_wxyz, scalar_first=True).apply(g, inverse=True)
    down /= np.linalg.norm(g, axis=1)[:, None]
    assert all(correlation(x[:, k], down[:, k]) > 0.9999 for k in range(3))


def test_second_degree_of_a_direction_is_orthogonal_over_the_sphere():
    direction = np.random.default_rng(1).normal(size=(200_000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    inner = np.cov(orientation._to_second_degree(direction).T)
    np.testing.assert_allclose(inner, np.diag(np.diag(inner)), atol=3e-3)
    np.testing.assert_allclose(np.diag(inner)[:3], 1 / 3, atol=3e-3)
    np.testing.assert_allclose(np.diag(inner)[3:], np.diag(inner)[3], atol=3e-3)


def test_a_camera_sees_the_axes_in_its_own_frame_and_turns_what_it_measures_about_its_own(arm, tmp_path):
    data = wb.read_csv(poses.poses_csv(tmp_path / "d.csv", 60, 33), 7)
    columns = Columns(fit_model(arm, data), np.ones(data.n))
    camera = Rotation.from_quat(data.cam_quat_wxyz, scalar_first=True).as_matrix()
    seen = camera.transpose(0, 2, 1) @ axes_of(data)
    x = dict(orientation_features(columns))["tool_y"]
    assert all(correlation(x[:, k], seen[:, k, 1]) > 0.999 for k in range(3))
    [rows] = [place.rows for place, _ in oriented(columns) if place.name == "measured orientation"]
    turn = np.einsum("nij,nj->ni", np.linalg.inv(columns.fit.whiten), rows[:, 2, :])
    np.testing.assert_allclose(turn[:, :3], 0.0, atol=1e-12)
    np.testing.assert_allclose(
        turn[:, 3:] / np.linalg.norm(turn[:, 3:], axis=1)[:, None], camera[:, :, 2], atol=1e-9
    )


def test_a_tool_that_never_turns_has_no_such_drivers(arm, measured):
    still = replace(measured, q=np.tile(measured.q[:1], (measured.n, 1)))
    assert list(orientation_features(Columns(fit_model(arm, measured).at(still)))) == []


# ------------------------------------------------------------------------------------------ findings


@pytest.mark.parametrize(
    ("error", "place", "variables"),
    [(scaled_orientations, "measured orientation", {"orientation", "tool_z"}),
     (target_off_its_centre, "base translation", {"orientation", "tool_x"}),
     (bending_tool, "base translation", {"tool_x", "gravity"})],
)  # fmt: skip
def test_errors_of_sensor_target_and_tool_are_seen_where_they_enter(arm, measured, error, place, variables):
    found = compare(arm, error(measured))
    assert not found.adequate and found.p_structure < 1e-6
    assert found.where[0].at == place and found.where[0].variable in variables


def over_heading(data, size, periods, angle):
    """The sensor is off along its x axis by a wave over an angle of the tool's orientation."""
    wave = size * np.sin(periods * angle(axes_of(data)))
    return replace(data, p_m=data.p_m + wave[:, None] * [1.0, 0.0, 0.0])


def yaw(axes):
    return np.arctan2(axes[:, 1, 0], axes[:, 0, 0])


def own(axes):
    return np.arctan2(axes[:, 2, 1], axes[:, 2, 0])


@pytest.mark.parametrize(
    ("periods", "angle", "variable"),
    [(3, yaw, "3 periods of tool_x about sensor_z"), (4, own, "4 periods of sensor_z about tool_z")],
)
def test_waves_over_the_heading_of_the_tool_are_seen(arm, measured, periods, angle, variable):
    found = compare(arm, over_heading(measured, 5e-4, periods, angle))
    assert not found.adequate and found.p_structure < 1e-6
    assert (found.where[0].variable, found.where[0].at) == (variable, "base translation")
    assert UnnamedName("base translation", (variable,)).without_terms
    assert f"the heading of the {variable.split()[3].split('_')[0]}'s" in explain.left_over(found)


def test_nothing_is_seen_where_there_is_none(arm, measured):
    found = compare(arm, measured)
    assert found.adequate and found.p_structure > 0.05


def test_positions_alone_show_a_target_off_its_centre(arm, measured):
    found = compare(arm, replace(target_off_its_centre(measured), quat_wxyz=None))
    assert not found.adequate and found.where[0].at == "base translation"


def test_what_is_reachable_knows_the_orientation(arm, measured):
    found = compare(arm, target_off_its_centre(measured))
    assert found.reachable.pos_m < 0.8 * found.rms["held"][0]
    assert found.reachable.parts[0][0] == "base translation"
    assert found.reachable.parts[0][1] in ("orientation", "tool_x")


@pytest.mark.parametrize(
    ("structured", "said"), [(False, "depends on no recorded variable"), (True, "none of it")]
)
def test_what_follows_a_variable_but_is_not_predicted_is_not_said_to_follow_none(structured, said):
    nothing = Reachable(1e-3, None, 0.0)
    assert explain.reachable_by(nothing, structured=structured).endswith(said)


def test_it_is_an_unnamed_finding_and_the_model_does_not_explain_the_data(diagnosed):
    assert (diagnosed.verdict, diagnosed.adequate_after) == ("novel", False)
    assert diagnosed.novel.location == "base translation"
    assert diagnosed.novel.depends_on[0] in ("tool_x", "gravity")
    assert diagnosed.novel.found and diagnosed.novel.held.gains and diagnosed.novel.held.cross_validated
    assert diagnosed.novel.held.ratio < 0.8 and diagnosed.novel.curves == ()


def test_it_is_said_what_to_look_at_and_advises_no_function_of_the_joints(diagnosed):
    said = diagnosis_text(diagnosed)
    assert said.count(explain.FOLLOWS_ORIENTATION) == 1 and " try: " not in said
    assert "the base position depends on" in said
    steps = advice.next_steps(diagnosed, (), advice.Inputs("a.toml", ("--data", "d.csv")))
    assert any(s.why.startswith(explain.FOLLOWS_ORIENTATION) for s in steps)
    assert not any("add" in s.command for s in steps)


def test_a_gain_of_rotations_alone_is_said_without_a_judgement_on_positions():
    held = HeldGain(1e-3, 1e-3, (0.99, 1.01), cross_validated=True, rotation=0.25)
    said = explain.smooth_gain(SimpleNamespace(name="unnamed[measured orientation: tool_z]", held=held))
    assert said == "cross-validated error 1.000 to 1.000 mm, rotation error times 0.250"
    of_joint = explain.smooth_gain(SimpleNamespace(name="unnamed[joint 1: q1]", held=held))
    assert of_joint == explain.held_gain(held)


def test_what_it_leaves_is_drawn_against_a_component(diagnosed):
    panels = place_panels(diagnosed.final, "measured orientation", ("tool_z",))
    assert len(panels) == 3
    assert all(np.abs(panel.x).max() <= 1.0 for panel in panels)


@pytest.mark.parametrize(
    ("name", "said"),
    [("tool_x", "direction of the tool's x axis, z component"),
     ("gravity", "gravity in the tool frame, z component"),
     ("orientation", "tool orientation, z component of the tool's z axis"),
     ("3 periods of sensor_z about tool_x",
      "heading of the sensor's z axis about the tool's x axis, 3 periods a turn [rad]")],
)  # fmt: skip
def test_an_axis_of_a_picture_names_the_component_that_is_drawn(name, said):
    assert words.axis(name) == said


def test_the_map_has_one_column_for_all_headings(diagnosed):
    [heatmap] = location_map(diagnosed).data
    assert list(heatmap.x).count("heading of the tool") == 1 and not any("periods" in x for x in heatmap.x)
    row, column = list(heatmap.y).index("base translation"), list(heatmap.x).index("heading of the tool")
    mine = [v for (at, by), v in diagnosed.map_ln_bf.items() if at == "base translation" and by in HEADINGS]
    assert heatmap.customdata[row][column] == pytest.approx(max(*mine, 0.0)) and len(mine) > 20


# ------------------------------------------------------------------------------------------ no terms


def test_no_term_stands_for_it(arm, measured):
    data = target_off_its_centre(measured)
    with pytest.raises(wb.CannotAnswer, match="no term can follow the orientation of the tool"):
        wb.find_unnamed(arm, data, ["unnamed[base translation: tool_x]"])
    found = wb.find_unnamed(arm, data, ["unnamed"])
    assert found.names == () and found.all_of_them.instead.without_terms
    assert explain.FOLLOWS_ORIENTATION in "\n".join(text.additions(found))


@pytest.mark.parametrize(("of_joint", "stops"), [(10.0, True), (25.0, False)])
def test_orientation_stops_other_functions_only_with_twice_their_evidence(of_joint, stops):
    """Joint angles follow the orientation in part: on a real arm, functions of them predict better."""
    names = [wb.UnnamedName("base translation", ("tool_x",)), wb.UnnamedName("joint 2", ("q2",))]
    scored = {(n.place, n.drivers): ln_bf for n, ln_bf in zip(names, (30.0, of_joint), strict=True)}
    assert (_first_instead(scored, names) == names[0]) == stops
