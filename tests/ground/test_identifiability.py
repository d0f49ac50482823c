"""What the poses of a fit determine, on arms whose answer is known from the mechanics, and against plain
linear algebra."""

import json
from dataclasses import replace

import numpy as np
import poses
import pytest
from commands import good
from exports import random_data, unfitted

from kincal import workbench as wb
from kincal.flight import Arm, library, tables
from kincal.rotations import Pose
from kincal.workbench.fit.identifiability import identifiability, residual_axes
from kincal.workbench.model.uplink import coefficients, term_image
from kincal_shared.errors import CannotAnswer


def unknown_frames(path):
    """The WAM with base and tool frames to be found."""
    text = poses.arm_toml(path, masses=False).read_text()
    path.write_text(
        text.replace("quat_wxyz = [1.0, 0.0, 0.0, 0.0]", "quat_wxyz = [1.0, 0.0, 0.0, 0.0]\nestimate = true")
    )
    return wb.read_arm(path)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    unknown_frames(folder / "arm.toml")
    poses.poses_csv(folder / "d.csv", 80, 2, position_only=True)
    return folder / "arm.toml", folder / "d.csv"


@pytest.fixture(scope="module")
def comparison(files):
    arm = wb.read_arm(files[0])
    return wb.compare(arm, wb.read_csv(files[1], 7))


def test_a_base_along_the_first_axis_is_not_told_from_the_first_joint(comparison):
    """Shifting the base along joint 1's axis is d1, turning it about that is phi1 (Khalil & Dombre 11)."""
    groups = [set(group) for group in comparison.identifiability.not_separate]
    assert {"base.tz_m", "J1.d_m"} in groups
    assert {"base.rz_rad", "J1.phi_rad"} in groups
    tool = next(group for group in groups if "J7.d_m" in group)
    assert "tool.tz_m" in tool


def test_with_known_frames_every_dh_error_of_full_poses_is_identifiable(tmp_path):
    arm = wb.read_arm(poses.arm_toml(tmp_path / "arm.toml"))
    found = wb.compare(arm, wb.read_csv(poses.poses_csv(tmp_path / "d.csv", 80, 2), 7)).identifiability
    assert (found.parameters, found.rank, found.not_separate) == (28, 28, ())


def test_rank_and_condition_are_those_of_numpy(comparison):
    fit = comparison.fit_all
    design = fit.J * np.repeat(np.sqrt(fit.weight), 3)[:, None]
    length = np.linalg.norm(design, axis=0)
    design = design[:, length > 1e-6] / length[length > 1e-6]
    value = np.linalg.svd(design, compute_uv=False)
    rank = np.linalg.matrix_rank(design, tol=1e-7 * value[0])
    assert comparison.identifiability.rank == rank < len(fit.names)
    assert comparison.identifiability.condition == pytest.approx(value[0] / value[rank - 1], rel=1e-6)


def test_two_joints_that_move_together_are_correlated(comparison):
    """Columns of phi of joints 3 and 5 made almost the same: their estimates are almost opposite."""
    fit = comparison.fit_all
    i, k = fit.names.index("J3.phi_rad"), fit.names.index("J5.phi_rad")
    rng = np.random.default_rng(1)
    design = rng.normal(size=(240, len(fit.names)))
    design[:, k] = design[:, i] + 0.05 * rng.normal(size=240)
    cov = np.linalg.inv(design.T @ design)
    found = identifiability(replace(fit, J=design, cov=cov, weight=np.ones(80)))
    (pair,) = found.correlated
    assert {pair.first, pair.second} == {"J3.phi_rad", "J5.phi_rad"}
    assert pair.correlation == pytest.approx(cov[i, k] / np.sqrt(cov[i, i] * cov[k, k]))
    assert pair.correlation < -0.95
    assert found.not_separate == ()


def test_residuals_by_axis_add_up(comparison):
    r = comparison.fit_part.predict(comparison.held_data)
    axes = residual_axes(r)
    assert [a.name for a in axes] == ["x", "y", "z"]
    assert np.sqrt(sum(a.rms**2 for a in axes)) == pytest.approx(comparison.rms["held"][0])
    assert [a.largest for a in axes] == pytest.approx(np.abs(r).max(axis=0))


# ------------------------------------------------------------------------------------------- on one page


def test_compare_says_it_on_one_page(files):
    text = good("model", "compare", "--arm", files[0], "--data", files[1]).stdout
    for words in (
        " of 40 constrained by the data, rank 3", "condition", "base.rz_rad, J1.phi_rad", "by axis",
        "reachable",
    ):  # fmt: skip
        assert words in text


def test_compare_says_it_as_json(files):
    answer = json.loads(good("model", "compare", "--arm", files[0], "--data", files[1], "--json").stdout)
    found = answer["identifiability"]
    assert found["parameters"] == 40
    assert ["base.rz_rad", "J1.phi_rad"] in found["not_separate"]
    assert {row["axis"] for row in answer["axes"]["held"]} == {"x", "y", "z"}
    assert set(answer["axes"]["fit"][0]) == {"axis", "rms_mm", "max_mm"}
    assert set(answer["reachable"]) == {"pos_mm", "rot_mrad", "without_outliers", "by"}


def test_fit_without_a_model_file_is_dh_calibration(files):
    """The same coefficients as with an empty model file, and no file is written."""
    folder = files[0].parent
    before = set(folder.iterdir())
    answer = json.loads(good("model", "fit", "--arm", files[0], "--data", files[1], "--json").stdout)
    assert len(answer["parameters"]) == 40
    assert answer["effects"] == []
    assert answer["rms"]["held"]["pos_mm"] < answer["rms"]["nominal"]["pos_mm"]
    assert set(folder.iterdir()) == before


def test_too_few_replicates_are_counted(tmp_path):
    """Three poses measured twice: three repeated measurements, too few to say how large the noise is."""
    arm = wb.read_arm(poses.arm_toml(tmp_path / "arm.toml", masses=False))
    data = wb.read_csv(poses.poses_csv(tmp_path / "d.csv", 60, 3), 7)
    group = np.arange(60)
    group[[10, 20, 30]] = [9, 19, 29]
    floor = wb.compare(arm, replace(data, cov=None, replicate=group)).noise_floor
    assert floor.pos_m is None
    assert floor.source.startswith("unknown: 3 of the 6 repeated measurements")


def scara(path):
    """Two parallel turns, a slide along them and a turn about the slide, frames to be found."""
    rows = [("revolute", 0.3, "0"), ("revolute", 0.25, "pi"), ("prismatic", 0.0, "0"), ("revolute", 0.0, "0")]
    text = "".join(
        f'[[joint]]\ntype = "{kind}"\na_m = {a}\nalpha_rad = "{alpha}"\nd_m = 0.1\nphi_rad = 0.0\n'
        + "q_min_{0} = -1.5\nq_max_{0} = 1.5\n".format("m" if kind == "prismatic" else "rad")
        for kind, a, alpha in rows
    )
    frame = "xyz_m = [0.0, 0.0, 0.0]\nquat_wxyz = [1.0, 0.0, 0.0, 0.0]\nestimate = true\n"
    head = 'name = "scara"\nconvention = "standard"\ngravity_m_s2 = [0.0, 0.0, -9.81]\n'
    path.write_text(f"{head}[base]\n{frame}[tool]\n{frame}{text}")
    return wb.read_arm(path)


@pytest.mark.parametrize("name", ["wam", "fr3", "irb120", "ur5e", "scara"])
def test_plain_dh_holds_every_small_error_of_every_link(name, tmp_path):
    """A model is complete if no small shift or turn of any link needs more coefficients (Mooring, Roth &
    Driels, Fundamentals of Manipulator Calibration, 1991); DH alone is not where axes are parallel."""
    arm = scara(tmp_path / "scara.toml") if name == "scara" else wb.read_arm(name)
    arm = replace(arm, base=replace(arm.base, estimate=True), tool=replace(arm.tool, estimate=True))
    fit = unfitted(arm, random_data(arm, 5, 60), [])
    fit = replace(fit, evaluation=fit.model.evaluate(np.zeros(len(fit.names))))
    design = fit.evaluation.J.reshape(-1, len(fit.names))
    basis = np.linalg.svd(design / np.maximum(np.linalg.norm(design, axis=0), 1e-12), full_matrices=False)
    shown = basis[0][:, basis[1] > 1e-7]
    link = fit.evaluation.twist[:, : arm.n + 1]
    columns = link.transpose(0, 3, 1, 2).reshape(len(design), -1)
    left = np.linalg.norm(columns - shown @ (shown.T @ columns), axis=0) / np.linalg.norm(columns, axis=0)
    assert left.max() < 1e-6, np.argwhere(left.reshape(arm.n + 1, 6) > 1e-6).tolist()


def test_flight_takes_the_turns_between_parallel_axes():
    arm = wb.read_arm("ur5e")
    rows = {row.name: row.terms for row in coefficients(arm, [])}
    assert [name for name in rows if "beta" in name] == ["J2.beta_rad", "J3.beta_rad"]
    assert [(t.frame, t.comp, t.gain) for t in rows["J2.beta_rad"]] == [(2, 4, 1.0)]
    flown = poses.flown_of(arm, 0.2)
    _, table = tables.decode_as("terms", term_image(arm, [], flown).data)
    flight = library("flight")
    bounds = {flight.text(c.name): c.ub for c in table.coef[0 : table.n_coef]}
    assert bounds["J2.beta_rad"] == pytest.approx(1.1 * 0.2)
    assert flown.excess(table) is None


def test_poses_that_no_fit_explains_are_not_said_to_move_too_little():
    """Three targets of the tool mixed in one column: what a fit leaves counts as noise, which determines next
    to nothing. Two joints that move determine little whatever the noise."""
    arm, rng = wb.read_arm("irb120"), np.random.default_rng(3)
    arm = replace(arm, base=replace(arm.base, estimate=True), tool=replace(arm.tool, estimate=True))
    base = Pose.of_wxyz([0.3, 0.2, 0.1], [1, 0, 0, 0])

    def at(target_m, q):
        return Arm.of(arm, base, Pose.of_wxyz(target_m, [1, 0, 0, 0])).fk(q).p_m

    q = rng.uniform(-1, 1, (30, 6))
    targets = np.array([at(m, q) for m in ([0.05, 0.02, 0.1], [-0.15, 0.02, 0.1], [0.05, -0.15, 0.1])])
    ids = tuple(map(str, range(30)))
    mixed = wb.Measurements("mixed", ids, q, targets[np.arange(30) % 3, np.arange(30)])
    with pytest.raises(CannotAnswer, match="no fit explains the poses: 112 mm are left") as refused:
        wb.compare(arm, mixed)
    assert "several targets may be mixed" in refused.value.todo
    two = q * [1, 1, 0, 0, 0, 0]
    with pytest.raises(CannotAnswer, match="singular design") as refused:
        wb.compare(arm, wb.Measurements("two joints", ids, two, at([0.05, 0.02, 0.1], two)))
    assert refused.value.todo == "move more joints, and farther"
