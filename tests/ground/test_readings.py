"""Several readings of a pose at rest count as one measurement."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kincal import workbench as wb
from kincal.workbench.data.readers import read_measurements
from kincal.workbench.data.readings import one_measurement_a_pose

POSES, READINGS = 30, 3
SENSOR_M = 2e-5


def readings(seed=0, each=READINGS, *, move_s=10.0, within_s=1.0, **columns):
    """Poses of two joints, each read several times at rest; what the poses truly are under `true_m`."""
    rng = np.random.default_rng(seed)
    number = np.repeat(np.arange(POSES), each)
    q = rng.uniform(-1, 1, (POSES, 2))[number] + rng.normal(0, 1e-5, (len(number), 2))
    true_m = rng.uniform(-1, 1, (POSES, 3))
    p_m = true_m[number] + rng.normal(0, SENSOR_M, (len(number), 3))
    quat = Rotation.random(POSES, rng=seed).as_quat(scalar_first=True)[number]
    quat[1::2] *= -1.0  # the same rotations
    t_s = np.tile(np.arange(each) * within_s, POSES) + number * (move_s + (each - 1) * within_s)
    data = wb.Measurements(
        source="made", ids=tuple(f"r{k}" for k in range(len(number))), q=q, p_m=p_m, quat_wxyz=quat,
        t_s=t_s, replicate=number * each, direction=np.ones_like(q), **columns,
    )  # fmt: skip
    return data, true_m


def test_each_pose_becomes_the_mean_of_its_readings_under_the_id_of_the_first():
    data, true_m = readings()
    poses = one_measurement_a_pose(data)
    assert poses.ids == data.ids[::READINGS]
    np.testing.assert_allclose(poses.p_m, data.p_m.reshape(POSES, READINGS, 3).mean(axis=1))
    assert np.sqrt(((poses.p_m - true_m) ** 2).mean()) < 0.75 * SENSOR_M
    turned = np.abs(np.einsum("ni,ni->n", poses.quat_wxyz, data.quat_wxyz[::READINGS]))
    np.testing.assert_allclose(turned, 1.0)
    assert poses.repeats is None
    assert poses.notes == (
        "90 rows are readings of 30 poses at rest: each pose counts once, with their mean",
    )


def test_rows_in_any_order_are_put_together_by_their_times():
    data, _ = readings()
    mixed = data.take(np.random.default_rng(1).permutation(data.n))
    poses = one_measurement_a_pose(mixed)
    by_time = np.argsort(poses.t_s)
    np.testing.assert_allclose(poses.p_m[by_time], one_measurement_a_pose(data).p_m)


@pytest.mark.parametrize("within_s", [1.0, 10.0, 12.0])
def test_times_too_short_to_leave_the_pose_and_come_back(within_s):
    data, _ = readings(within_s=within_s)
    assert one_measurement_a_pose(data).n == POSES


def test_poses_that_the_arm_left_and_came_back_to_stay_measurements_of_their_own():
    data, _ = readings(within_s=20.0)
    assert one_measurement_a_pose(data) is data


@pytest.mark.parametrize(
    ("column", "values"),
    [
        ("direction", np.tile([[1.0, 1.0], [-1.0, 1.0], [1.0, 1.0]], (POSES, 1))),
        ("temp_c", np.tile([20.0, 21.0, 22.0], POSES)),
        ("payload_kg", np.tile([0.0, 1.0, 0.0], POSES)),
        ("tag", np.tile([0.0, 1.0, 0.0], POSES)),
        ("qdot", np.tile([[0.1, 0.0], [-0.1, 0.0], [0.1, 0.0]], (POSES, 1))),
        ("g_m_s2", np.tile([[0.0, 0.0, -9.8], [1.0, 0.0, -9.8], [0.0, 1.0, -9.8]], (POSES, 1))),
    ],
)
def test_rows_that_differ_in_what_an_effect_may_follow_are_no_readings_of_one_state(column, values):
    data, _ = readings()
    assert one_measurement_a_pose(replace(data, **{column: values})).n == data.n


def test_replicates_that_a_campaign_states_for_a_part_of_its_poses_stay():
    data, _ = readings()
    part = np.concatenate([np.arange(0, 60, READINGS), np.arange(60, 66)])
    assert one_measurement_a_pose(data.take(part)).n < len(part)
    stated = replace(data.take(part), replicate_stated=True)
    assert one_measurement_a_pose(stated) is stated
    everywhere, _ = readings(replicate_stated=True)
    assert one_measurement_a_pose(everywhere).n == POSES


def test_a_few_repeated_rows_are_readings_only_if_their_times_say_so():
    """Six such rows of 114 made a noise floor of the sensor alone, which no model of the arm could meet."""
    data, _ = readings()
    few = data.take(np.sort([*range(0, 87, READINGS), 1]))
    assert one_measurement_a_pose(few).n == few.n - 1
    untimed = replace(few, t_s=None)
    assert one_measurement_a_pose(untimed) is untimed


def test_a_mistake_of_the_sensor_in_one_reading_is_left_out_and_said():
    data, true_m = readings()
    data.p_m[4] += 0.01
    poses = one_measurement_a_pose(data)
    np.testing.assert_allclose(poses.p_m[1], true_m[1], atol=5 * SENSOR_M)
    assert "without 1 far from the others of its pose" in poses.notes[-1]


@pytest.mark.parametrize(
    ("stated_m", "share"),
    [(SENSOR_M, 1.0 / READINGS), (25 * SENSOR_M, 1.0)],
    ids=["noise of the sensor alone", "noise that a pose keeps"],
)
def test_stated_noise_loses_what_differs_between_readings(stated_m, share):
    cov = np.broadcast_to(np.eye(6) * stated_m**2, (POSES * READINGS, 6, 6)).copy()
    data, _ = readings(cov=cov)
    poses = one_measurement_a_pose(data)
    np.testing.assert_allclose(poses.cov[:, 0, 0] / stated_m**2, share, rtol=0.4)


def test_files_are_read_so_and_a_row_is_excluded_before(tmp_path):
    data, _ = readings()
    rows = np.column_stack([data.t_s, data.q, data.p_m])
    text = "\n".join(f"r{k}," + ",".join(f"{x:.9f}" for x in row) for k, row in enumerate(rows))
    file = tmp_path / "poses.csv"
    file.write_text("id,t_s,q1,q2,px,py,pz\n" + text + "\n")
    assert read_measurements(file, 2).n == POSES
    without = read_measurements(file, 2, excluded=["r1"])  # a reading
    assert (without.n, without.ids[0]) == (POSES, "r0")
    np.testing.assert_allclose(without.p_m[0], data.p_m[[0, 2]].mean(axis=0), atol=1e-8)
    without = read_measurements(file, 2, excluded=["r0", "r3"])  # poses, as they are named
    assert (without.n, without.ids[0]) == (POSES - 2, "r6")
    for every in (data.ids, data.ids[::READINGS]):
        with pytest.raises(wb.BadInput, match="no pose is left"):
            read_measurements(file, 2, excluded=every)
    with pytest.raises(wb.BadInput, match="no pose has the id r900"):
        read_measurements(file, 2, excluded=["r900"])


def test_what_the_times_do_not_tell_the_positions_do():
    """A hysteresis test approaches each pose from both sides, a reading every 15 s: 1.6 mm became 0.1 mm."""
    data, _ = readings(each=2, move_s=15.0, within_s=15.0)
    assert one_measurement_a_pose(data).n == POSES
    data.p_m[1::2] += 8e-4
    left_m = {"backlash": 1e-3, "noise that a pose keeps": 4e-3}
    assert one_measurement_a_pose(data, left_m=lambda _: left_m["backlash"]) is data
    assert one_measurement_a_pose(data, left_m=lambda _: left_m["noise that a pose keeps"]).n == POSES
    quick = replace(data, t_s=readings(each=2)[0].t_s)  # no time to leave the pose
    assert one_measurement_a_pose(quick, left_m=lambda _: 0.0).n == POSES


def test_a_split_of_the_rows_does_not_part_the_readings_of_a_pose():
    data, _ = readings()
    poses = one_measurement_a_pose(replace(data, split=np.tile(["held", "fit", "fit"], POSES)))
    assert poses.n == POSES and set(poses.split) == {"held"}


def test_a_slow_change_in_one_pose_is_no_rest():
    """Each row is within .5 C of the one before, from 20 to 38 C."""
    data, _ = readings(each=60, within_s=0.1)
    data = data.take(np.arange(120))
    warm = replace(data, temp_c=np.tile(np.linspace(20.0, 38.0, 60), 2))
    assert one_measurement_a_pose(warm).n > 40
