"""Approach direction inferred from the order of measurement."""

from dataclasses import replace

import numpy as np
import poses
import pytest

from kincal import workbench as wb
from kincal.workbench.data.direction import in_random_order, last_moves, least_moves, with_direction
from kincal.workbench.data.measurements import SAME_POSE
from kincal.workbench.data.readers import read_measurements
from kincal.workbench.evidence.adequacy import find_outliers
from kincal.workbench.fit.least_squares import fit_model


def campaign(q, **columns):
    n = len(q)
    return wb.Measurements(source="made", ids=tuple(map(str, range(n))), q=q, p_m=q[:, [0, 1, 1]], **columns)


def said(data):
    return [note for note in data.notes if "direction" in note]


def test_the_sign_of_the_last_move_and_the_one_before_it_where_a_joint_rests():
    q = np.array([[0.0, 1.0], [0.5, 1.0], [0.5, 0.2], [0.5005, 0.2], [0.1, 0.9]])
    np.testing.assert_array_equal(last_moves(q), [[0, 0], [1, 0], [1, -1], [1, -1], [-1, 1]])


def idle(rng, count, jitter):
    """(N, 7) where joints are, of which two in three stay at each pose; their readings, which jitter where
    they stay."""
    moved = rng.random((count, 7)) < 0.35
    last = np.maximum.accumulate(np.where(moved, np.arange(count)[:, None], 0), axis=0)
    q = np.take_along_axis(rng.uniform(-2, 2, (count, 7)), last, axis=0)
    return q, q + jitter * rng.normal(size=q.shape) * ~moved


@pytest.mark.parametrize("jitter", [1e-3, 2e-3, 3e-3])
def test_a_joint_that_stays_keeps_its_side_however_its_readings_jitter(jitter):
    """The side of a third of such poses was that of their noise."""
    rng = np.random.default_rng(5)
    wrong = [
        (last_moves(q) != last_moves(readings))[10:].mean()
        for q, readings in (idle(rng, 120, jitter) for _ in range(5))
    ]
    assert np.mean(wrong) < 0.02


def slow_walk(rng):
    """Steps of some milliradians, in random directions, between long ones."""
    return np.repeat(rng.uniform(-2, 2, (30, 7)), 4, axis=0) + np.cumsum(
        3e-3 * rng.normal(size=(120, 7)), axis=0
    )


def anywhere(rng):
    return rng.uniform(-2, 2, (100, 7))


@pytest.mark.parametrize(("poses_of", "most"), [(slow_walk, 0.1), (anywhere, 0.0)])
def test_small_moves_that_do_not_go_back_are_no_jitter(poses_of, most):
    rng = np.random.default_rng(6)
    least = np.array([least_moves(poses_of(rng)) for _ in range(20)])
    assert (least > SAME_POSE).mean() <= most


def test_times_give_the_order_where_rows_do_not():
    rng = np.random.default_rng(0)
    q = rng.uniform(-1, 1, (30, 2))
    shuffled = rng.permutation(30)
    data = with_direction(campaign(q[shuffled], t_s=shuffled.astype(float)))
    assert data.direction_source == "inferred"
    np.testing.assert_array_equal(data.direction[np.argsort(shuffled)], last_moves(q))


def test_recorded_directions_stay():
    q = np.random.default_rng(0).uniform(-1, 1, (30, 2))
    data = with_direction(campaign(q, direction=np.ones_like(q)))
    assert data.direction_source == "measured"
    assert (data.direction == 1.0).all()


def rows_in_order(q, **columns):
    return campaign(q, t_s=np.arange(len(q), dtype=float), order_is_time=True, **columns)


@pytest.mark.parametrize("column", [0, 1])
def test_rows_sorted_by_a_joint_are_no_order_of_motion(column):
    q = np.random.default_rng(0).uniform(-1, 1, (60, 2))
    data = with_direction(rows_in_order(q[np.argsort(q[:, column])]))
    assert data.direction is None
    assert data.direction_source == "none"
    assert f"sorted by q{column + 1}" in said(data)[0]


def test_a_loop_over_a_grid_and_a_random_campaign_are_one():
    grid = np.array([(a, b) for a in np.linspace(-1, 1, 6) for b in np.linspace(-1, 1, 6)])
    free = np.random.default_rng(0).uniform(-1, 1, (60, 2))
    for q in (grid, free):
        data = with_direction(rows_in_order(q))
        assert data.direction_source == "inferred"
        assert "inferred from the order of rows" in said(data)[0]


def test_a_random_order_is_told_from_a_path_and_a_grid():
    rng = np.random.default_rng(3)
    grid = np.array([(a, b) for a in np.linspace(-1, 1, 6) for b in np.linspace(-1, 1, 6)])
    path = np.cumsum(rng.normal(size=(60, 2)), axis=0)
    still = np.column_stack([rng.uniform(-1, 1, (60, 2)), np.zeros(60)])  # a joint that does not move
    for q, want in ((grid, False), (path, False), (rng.permutation(grid), True), (still, True)):
        assert in_random_order(rows_in_order(q)) is want
    assert not in_random_order(rows_in_order(np.sort(rng.uniform(-1, 1, (60, 2)), axis=0)))
    assert not in_random_order(rows_in_order(rng.uniform(-1, 1, (5, 2))))  # too few to tell


def test_a_sweep_of_all_joints_at_once_may_be_an_order_of_motion():
    q = np.linspace(-1, 1, 60)[:, None] * np.array([1.0, 0.5])
    assert with_direction(rows_in_order(q)).direction_source == "inferred"


def test_ids_that_are_numbers_in_another_order_are_heeded():
    q = np.random.default_rng(0).uniform(-1, 1, (30, 2))
    data = rows_in_order(q)
    other = replace(data, ids=tuple(map(str, np.random.default_rng(1).permutation(30))))
    assert with_direction(other).direction is None


def test_a_subset_keeps_what_the_whole_file_said():
    q = np.random.default_rng(0).uniform(-1, 1, (30, 2))
    data = with_direction(rows_in_order(q))
    np.testing.assert_array_equal(data.take(np.arange(0, 30, 3)).direction, last_moves(q)[::3])


def write(path, q):
    rows = [f"{a!r},{b!r},0.1,0.2,0.3" for a, b in q.tolist()]
    path.write_text("\n".join(["q1,q2,px,py,pz", *rows]) + "\n")
    return path


def test_files_are_read_each_in_its_own_order_and_the_argument_switches_it_off(tmp_path):
    q = np.random.default_rng(0).uniform(-1, 1, (24, 2))
    files = [write(tmp_path / "a.csv", q[:12]), write(tmp_path / "b.csv", q[12:])]
    data = read_measurements(files, 2)
    assert data.direction_source == "inferred"
    np.testing.assert_array_equal(data.direction, np.vstack([last_moves(q[:12]), last_moves(q[12:])]))
    off = read_measurements(files, 2, infer_direction=False)
    assert off.direction is None
    assert off.direction_source == "none"


def test_a_pose_whose_direction_nobody_knows_is_no_outlier_of_an_effect_that_follows_it(
    arm, library, tmp_path
):
    """The first pose of a session: half the backlash is missing there, and `--exclude` was advised."""

    def loose(q, direction):
        return q + 0.006 * np.eye(7)[1] * direction[1]

    data = wb.read_csv(poses.poses_csv(tmp_path / "loose.csv", 60, 5, loose), 7)
    data.direction[0] = 0.0
    for source, outliers in (("measured", ("p0",)), ("inferred", ())):
        fit = fit_model(arm, replace(data, direction_source=source), library.find("backlash[2]", arm, data))
        assert find_outliers(fit).ids == outliers
    without = fit_model(arm, replace(data, direction_source="inferred"))
    assert find_outliers(without) == find_outliers(replace(without, data=data))
