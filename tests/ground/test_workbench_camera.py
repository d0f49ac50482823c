"""Faults of camera and target in poses that were computed from many points: columns against OpenCV's PnP,
and diagnoses of sets with a camera on the flange and with one that stands."""

from dataclasses import replace
from pathlib import Path

import boards
import numpy as np
import poses
import pytest
from places import DATA
from scipy.spatial.transform import Rotation

from kincal import workbench as wb
from kincal.rotations import Pose
from kincal.workbench.diagnosis.study import Study
from kincal.workbench.fit.least_squares import fit_model
from kincal.workbench.model import pnp, sight
from kincal.workbench.model.pnp import PnpColumns, column_number
from kincal.workbench.model.uplink import term_table
from kincal.workbench.report import explain
from kincal_shared.errors import BadInput
from kincal_shared.schema.arm import ArmTable
from kincal_shared.schema.names import FAULTS

STEP = 1e-4


# --------------------------------------------------------------------------- columns


TAG = np.array([[0.05, -0.05, 0.0], [-0.05, 0.05, 0.0], [0.05, 0.05, 0.0], [-0.05, -0.05, 0.0]])  # no order


def sight_of_boards(points=boards.BOARD) -> sight.Sight:
    focal, middle = boards.K[[0, 1], [0, 1]], boards.K[:2, 2]
    size = np.array([boards.WIDTH, boards.HEIGHT])
    return sight.Sight(points, -middle / focal, (size - middle) / focal, focal)


def faulty(fault: str, target: np.ndarray, size: float) -> np.ndarray:
    """Pixels that a fault of this size leaves."""
    K, points, lens = boards.K.copy(), boards.BOARD.copy(), [0.0] * 4
    if fault.startswith(("radial", "decentring")):
        order = ("radial_1", "radial_2", "decentring_1", "decentring_2")
        lens[order.index(fault)] = size
    elif fault.startswith("focal"):
        axis = int(fault == "focal_y")
        K[axis, axis] *= 1.0 + size
    elif fault.startswith("centre"):
        axis = int(fault == "centre_y")
        K[axis, 2] += size * K[axis, axis]
    elif fault == "target_size":
        points *= 1.0 + size
    elif fault == "target_edges":
        return grown(boards.project(target, lens, K, TAG)[0], size * K[[0, 1], [0, 1]].mean())
    else:
        points[:, 2] += size * (points[:, int(fault == "bow_y")] / boards.HALF_M) ** 2
    return boards.project(target, lens, K, points)[0]


def grown(px: np.ndarray, by_px: float) -> np.ndarray:
    """Corners of TAG where the moved lines through its edges meet, in homogeneous coordinates."""
    neighbours = {0: (2, 3), 1: (2, 3), 2: (0, 1), 3: (0, 1)}

    def moved(a, b):
        line = np.cross(np.r_[px[a], 1.0], np.r_[px[b], 1.0])
        line /= np.hypot(*line[:2])
        side = np.sign(line @ np.r_[px.mean(axis=0), 1.0])
        return line + [0.0, 0.0, side * by_px]

    meet = [np.cross(*(moved(k, other) for other in neighbours[k])) for k in range(4)]
    return np.array([x[:2] / x[2] for x in meet])


def views(n: int, seed: int):
    """Targets in the camera frame with at least 12 points well in the image, some with points outside."""
    rng = np.random.default_rng(seed)
    found = []
    while len(found) < n:
        turn = Rotation.from_euler("xyz", [np.pi + rng.uniform(-0.7, 0.7), *rng.uniform(-0.7, 0.7, 2)])
        at = [*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.3, 0.5)]
        target = boards.pose(turn.as_rotvec(), at)
        pixels, inside = boards.project(target)
        border = np.minimum(pixels, [boards.WIDTH, boards.HEIGHT] - pixels).min(axis=1)
        if inside.sum() >= 12 and not np.any((border > -1.0) & (border < 20.0)):
            found.append((target, inside))
    return found


@pytest.mark.parametrize("mount", ["tool", "world"])
@pytest.mark.parametrize("fault", FAULTS)
def test_columns_are_the_derivatives_of_opencvs_pnp(fault, mount):
    rng = np.random.default_rng(3)
    points = TAG if fault == "target_edges" else boards.BOARD
    for target, inside in views(6, seed=sum(map(ord, fault))):
        seen = inside if points is boards.BOARD else np.full(len(points), True)
        shifted = [boards.pnp(faulty(fault, target, s)[seen], points[seen]) for s in (STEP, -STEP)]
        camera = boards.pose(rng.normal(size=3), rng.normal(size=3)) if mount == "world" else None
        measured = [np.linalg.inv(x) if camera is None else camera @ x for x in (target, *shifted)]
        pose = Pose(measured[0][None, :3, 3], measured[0][None, :3, :3])
        stands = None if camera is None else Pose(camera[None, :3, 3], camera[None, :3, :3])
        got = PnpColumns((sight_of_boards(points),), stands, pose.R)([column_number(0, fault)], pose)[0, :, 0]
        step = np.linalg.inv(measured[2]) @ measured[1]
        want = np.r_[step[:3, 3], Rotation.from_matrix(step[:3, :3]).as_rotvec()] / (2.0 * STEP)
        np.testing.assert_allclose(got, want, atol=2e-3 * np.abs(want).max())


def test_points_outside_the_image_do_not_count():
    partly = [view for view in views(40, seed=1) if not view[1].all()]
    assert len(partly) >= 5
    target, inside = partly[0]
    measured = np.linalg.inv(target)
    pose = Pose(measured[None, :3, 3], measured[None, :3, :3])
    whole = sight_of_boards()
    seen = replace(whole, points_m=whole.points_m[inside])
    column = [PnpColumns((s,), None, pose.R)([1], pose) for s in (whole, seen)]
    np.testing.assert_allclose(column[0], column[1], rtol=1e-9)
    everything = replace(whole, low=whole.low * 100, high=whole.high * 100)
    assert not np.allclose(PnpColumns((everything,), None, pose.R)([1], pose), column[0], rtol=1e-2)


def test_poses_of_the_second_tag_are_computed_from_its_corners(tmp_path):
    """Two tags on the tool, 25 degrees to either side: each pose has the columns of the tag that it saw."""
    tilted = Rotation.from_euler("y", 25, degrees=True).as_matrix()
    corners = [[0.03 * x, 0.03 * y, 0.0] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    sides = ((tilted, 0.1), (tilted.T, -0.1))
    left, right = (np.array(corners) @ turn.T + [x, 0.0, 0.0] for turn, x in sides)
    text = Path(arm_with_camera(tmp_path, stated=True, mount="world").source).read_text()
    head, tail = text.split(f"points_m = {boards.BOARD.tolist()}\n")

    def columns(name, *keys):
        rows = "".join(f"{key} = {points.tolist()}\n" for key, points in keys)
        (tmp_path / name).write_text(head + rows + tail)
        arm = wb.read_arm(tmp_path / name)
        found = PnpColumns.of(arm, data)
        return found([column_number(0, "radial_1")], Pose(data.p_m, found.measured))

    data = wb.read_csv(boards.world_csv(tmp_path / "poses.csv", 8, 5, (0.1, 0.0, 0.0, 0.0)), 7)
    data = replace(data, tag=np.arange(8.0) % 2.0)
    first, second = columns("a.toml", ("points_m", left)), columns("b.toml", ("points_m", right))
    both = columns("c.toml", ("points_m", left), ("second_points_m", right))
    assert np.abs(first - second).max() > 1e-3
    np.testing.assert_array_equal(both, np.where((data.tag == 1.0)[:, None, None], second, first))


def test_columns_act_along_the_expected_axes():
    """A measured orientation with noise turns the column back: what it does in the base frame stays."""
    target, _ = views(1, seed=2)[0]
    T = np.linalg.inv(target)
    pose = Pose(T[None, :3, 3], T[None, :3, :3])
    noisy = pose.R @ Rotation.from_rotvec([0.01, -0.02, 0.005]).as_matrix()
    plain = PnpColumns((sight_of_boards(),), None, pose.R)([1], pose)[0, :3, 0]
    turned = PnpColumns((sight_of_boards(),), None, noisy)([1], pose)[0, :3, 0]
    np.testing.assert_allclose(pose.R[0] @ plain, noisy[0] @ turned, atol=1e-15)


# --------------------------------------------------------------------------- what is assumed


@pytest.fixture(scope="module")
def distorted(tmp_path_factory):
    """45 poses of a camera on the flange with k1 = 0.1."""
    path = tmp_path_factory.mktemp("distorted") / "poses.csv"
    return wb.read_csv(boards.eye_in_hand_csv(path, 45, 4, (0.1, 0.0, 0.0, 0.0)), 7)


def arm_with_camera(tmp_path, *, stated: bool, mount: str = "tool"):
    return wb.read_arm(boards.arm_toml(tmp_path / "arm.toml", mount, stated))


def test_board_is_assumed_where_the_camera_looked(tmp_path, distorted):
    arm, data = arm_with_camera(tmp_path, stated=False), distorted
    seen = sight.sights(arm, data)
    assert len(seen) == len(sight.assumptions(arm)) == 9
    for one in seen:
        np.testing.assert_allclose(one.points_m.mean(axis=0), 0.0, atol=0.03)
    text = sight.in_words(arm, data)
    assert "[target] points_m" in text
    assert "fx_px" in text


def test_part_of_a_set_assumes_what_the_whole_set_does(tmp_path, distorted):
    arm, data = arm_with_camera(tmp_path, stated=False), distorted
    part = data.take(np.array([0, 5, 7])).take(np.array([True, False, True]))
    for one, whole in zip(sight.sights(arm, part), sight.sights(arm, data), strict=True):
        np.testing.assert_array_equal(one.points_m, whole.points_m)


def test_stated_camera_and_target_leave_nothing_to_assume(tmp_path, library, distorted):
    arm, data = arm_with_camera(tmp_path, stated=True), distorted
    assert [a.constants for a in sight.assumptions(arm)] == [()]
    assert sight.in_words(arm, data) == ""
    assert [h.label for h in library.find("lens_radial", arm, data)] == ["lens_radial"]


def test_effects_of_one_model_assume_one_camera_and_target(tmp_path, library, distorted):
    arm, data = arm_with_camera(tmp_path, stated=False), distorted
    result = wb.fit(arm, data, ["lens_radial", "focal_length", "target_bow"], library=library)
    assumed = {tuple(result.constants[name][key] for key in ("field_deg", "fill")) for name in result.effects}
    assert len(assumed) == 1


def test_without_a_camera_on_the_flange_or_points_nothing_changes(library):
    arm = wb.read_arm("wam")
    assert not sight.sees_points(arm, None)
    assert [p.name for p in library.find("lens_radial", arm, None)[0].parameters] == ["k1", "k2", "m1", "m2"]
    assert library.effects["target_bow"].missing(arm, None)


def test_positions_alone_say_that_orientations_are_needed(tmp_path, library, distorted):
    arm, data = arm_with_camera(tmp_path, stated=True), distorted
    lacking = library.effects["lens_radial"].missing(arm, replace(data, quat_wxyz=None))
    assert any("qw..qz" in text for text in lacking)


# --------------------------------------------------------------------------- diagnoses


def leading(answer: wb.Diagnosis):
    return next(e for e in answer.effects if e.role == "accepted")


@pytest.mark.parametrize("stated", [True, False])
def test_radial_distortion_of_a_camera_on_the_flange_is_named(tmp_path, library, stated, distorted):
    arm, data = arm_with_camera(tmp_path, stated=stated), distorted
    answer = wb.diagnose(arm, data, library)
    lens = leading(answer)
    assert lens.name == "lens_radial"
    assert lens.probability >= 0.9
    assert lens.held.gains
    if stated:
        k1 = lens.parameters[0]
        assert abs(k1.value - 0.1) < 0.01 + 4.0 * k1.std_err
    else:
        assert any("are tried" in note for note in explain.notes(answer.comparison))


def test_radial_distortion_of_a_camera_that_stands_is_named(tmp_path, library):
    arm = arm_with_camera(tmp_path, stated=True, mount="world")
    data = wb.read_csv(boards.world_csv(tmp_path / "poses.csv", 40, 5, (0.1, 0.0, 0.0, 0.0)), 7)
    lens = leading(wb.diagnose(arm, data, library))
    assert (lens.name, lens.probability >= 0.9) == ("lens_radial", True)
    k1 = lens.parameters[0]
    assert abs(k1.value - 0.1) < 0.01 + 4.0 * k1.std_err


def test_a_perfect_camera_is_not_blamed(tmp_path, library):
    arm = arm_with_camera(tmp_path, stated=False)
    data = wb.read_csv(boards.eye_in_hand_csv(tmp_path / "poses.csv", 40, 6, (0.0,) * 4), 7)
    answer = wb.diagnose(arm, data, library)
    assert not [e.name for e in answer.effects if e.accepted]


def test_uplink_refuses_effects_of_another_camera(tmp_path, library):
    arm = arm_with_camera(tmp_path, stated=True)
    with pytest.raises(BadInput, match="lens_radial acts through all points"):
        term_table(arm, library.find("lens_radial", arm, None), poses.flown())
    assert term_table(arm, library.find("encoder_gain[2]", arm, None), poses.flown()).n_coef == 29


# --------------------------------------------------------------------------- a real arm


def fr3() -> tuple[ArmTable, wb.Measurements]:
    return wb.read_arm(DATA / "fr3" / "fr3.toml"), wb.read_csv(DATA / "fr3" / "fr3.csv", 7)


@pytest.mark.parametrize("seed", range(2))
def test_fr3_with_permuted_residuals_blames_no_camera(library, seed):
    arm, data = fr3()
    fit = fit_model(arm, data)
    r = fit.evaluation.r[np.random.default_rng(seed).permutation(data.n)]
    model = fit.model.poses(fit.estimate)
    turned = Rotation.from_rotvec(r[:, 3:]) * Rotation.from_matrix(model.R)
    mixed = replace(data, p_m=model.p_m + r[:, :3], quat_wxyz=turned.as_quat(scalar_first=True))
    probability = Study.of(wb.compare(arm, mixed), library, (), True).posterior(()).probability
    assert max(probability[name] for name in ("lens_radial", "focal_length", "target_bow")) < 0.3


@pytest.mark.parametrize(("n_points", "bends"), [(4, False), (9, True)])
def test_four_corners_cannot_bend_a_board_can(n_points, bends):
    """Corners of a tag are all as far from its middle: a bow lifts them alike, as a mount does."""
    grid = np.array([[x, y, 0.0] for x in (-0.03, 0.0, 0.03) for y in (-0.03, 0.0, 0.03)])
    points_m = grid if n_points == 9 else grid[[0, 2, 8, 6]]
    assert (np.ptp(pnp.moved_points(points_m, "bow_x")[:, 2]) > 0.9) == bends
    assert np.any(pnp.moved_points(points_m, "bow_y")) == bends
