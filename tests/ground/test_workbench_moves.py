"""Errors by a joint's last move: its length (not at rest yet) or its sign (backlash); by the tool's, of a
sensor that lags; and replicates, which differ by where the arm came from."""

from dataclasses import replace

import numpy as np
import poses
import pytest
from places import DATA

from kincal import workbench as wb
from kincal.rotations import rotvec_of_matrix
from kincal.workbench.comparison.fitting import check_needs
from kincal.workbench.data.direction import changes, with_direction
from kincal.workbench.data.readers import read_measurements
from kincal.workbench.diagnosis.competing import advise
from kincal.workbench.diagnosis.study import Study
from kincal.workbench.evidence.adequacy import REPLICATES, STATED, find_outliers, noise_floor
from kincal.workbench.evidence.lag import last_move_of_tool, length_of_last_move
from kincal.workbench.evidence.replicates import replicates
from kincal.workbench.evidence.unnamed import lagging as lagging_cells
from kincal.workbench.fit.columns import Columns
from kincal.workbench.fit.least_squares import fit_model
from kincal.workbench.model.grids import finer, grid_values
from kincal.workbench.model.uplink import term_table
from kincal.workbench.prediction.nextposes import next_poses
from kincal.workbench.report import answers, explain
from kincal.workbench.report.partial import place_panels
from kincal_shared.errors import BadInput, CannotAnswer

NOISE_M = 1e-4
LOW, HIGH = (np.array([row[k] for row in poses.WAM]) for k in (3, 4))


def random_joints(rng, count):
    return rng.uniform(0.9 * LOW, 0.9 * HIGH, (count, 7))


def measured(rng, q, error, **columns):
    """Positions of the true arm at readings q (N, 7) with joints off by `error`, in the order of rows."""
    dh = 2e-3 * rng.normal(size=(7, 4))
    p_m = np.array([poses.tool_pose(row, dh)[:3, 3] for row in q + error])
    return wb.Measurements(
        source="made", ids=tuple(f"p{k}" for k in range(len(q))), q=q,
        p_m=p_m + NOISE_M * rng.normal(size=p_m.shape),
        t_s=np.arange(len(q), dtype=float), order_is_time=True, **columns,
    )  # fmt: skip


def of_joint_2(values):
    return values[:, 1:2] * np.eye(7)[1]


def signs(q):
    return np.sign(np.diff(q, axis=0, prepend=q[:1]))


def test_last_moves_make_no_room_for_bad_poses():
    """With a column of them for each joint a pose of the real WAM was another outlier, and another function
    was unnamed, which random poses speak against."""
    arm = wb.read_arm(DATA / "wam" / "wam.toml")
    data = read_measurements(DATA / "wam" / "wam.csv", arm)
    assert data.has("move")
    comparisons = [wb.compare(arm, d) for d in (data, replace(data, move=None))]
    weights = [Study.of(c, wb.Library.load(), (), True).weight for c in comparisons]
    np.testing.assert_allclose(*weights, rtol=1e-9)


# --------------------------------------------------------------------------- from the order


def test_readings_of_one_pose_keep_its_last_move_and_a_joint_that_rests_has_none():
    q = np.array([[0.0, 1.0], [0.5, 1.0], [0.5005, 1.0], [0.5, 0.2], [0.1, 0.9]])
    want = [[0, 0], [0.5, 0], [0.5, 0], [-0.0005, -0.8], [-0.4, 0.7]]
    np.testing.assert_allclose(changes(q), want, atol=1e-12)


def test_moves_are_those_of_the_times_and_of_each_file():
    rng = np.random.default_rng(0)
    q, shuffled = rng.uniform(-1, 1, (30, 2)), rng.permutation(30)
    rows = wb.Measurements("m", tuple(map(str, range(30))), q[shuffled], q[:, [0, 1, 1]])
    data = with_direction(replace(rows, t_s=shuffled.astype(float)))
    np.testing.assert_array_equal(data.move[np.argsort(shuffled)], changes(q))
    part = data.take(np.arange(0, 30, 3))
    np.testing.assert_array_equal(part.move, data.move[::3])


def test_rows_in_no_order_of_motion_tell_no_moves():
    q = np.random.default_rng(0).uniform(-1, 1, (60, 2))
    q = q[np.argsort(q[:, 0])]
    rows = wb.Measurements("m", tuple(f"p{k}" for k in range(60)), q, q[:, [0, 1, 1]], order_is_time=True)
    assert not with_direction(rows).has("move")
    assert not with_direction(replace(rows, direction=np.ones_like(q))).has("move")


def test_recorded_directions_against_the_order_say_that_the_arm_went_by_other_points():
    q = np.random.default_rng(0).uniform(-1, 1, (60, 2))
    rows = wb.Measurements("m", tuple(f"p{k}" for k in range(60)), q, q[:, [0, 1, 1]], order_is_time=True)
    same = signs(q)
    np.testing.assert_array_equal(with_direction(replace(rows, direction=same)).move, changes(q))
    once = np.where(np.arange(60)[:, None] == 30, -same, same)
    want = np.where(np.arange(60)[:, None] == 30, 0.0, changes(q))
    np.testing.assert_array_equal(with_direction(replace(rows, direction=once)).move, want)
    from_below = with_direction(replace(rows, direction=np.ones_like(q)))
    assert not from_below.has("move")
    assert (from_below.direction == 1.0).all()


# --------------------------------------------------------------------------- diagnosis


@pytest.mark.parametrize(
    ("named", "error"),
    [
        ("joint_settling[2]", lambda q: 6e-4 * of_joint_2(changes(q))),
        ("backlash[2]", lambda q: 8e-4 * of_joint_2(signs(q))),
    ],
)
def test_an_error_by_the_length_of_the_last_move_is_no_backlash(arm, library, named, error):
    """It was named backlash[2] with P > 0.9, confounded with nothing, and encoder_gain[2] joined it."""
    rng = np.random.default_rng(3)
    q = random_joints(rng, 90)
    data = with_direction(measured(rng, q, error(q)))
    recorded = with_direction(replace(data, move=None))
    np.testing.assert_array_equal(recorded.direction, data.direction)
    np.testing.assert_array_equal(recorded.move, data.move)
    d = wb.diagnose(arm, data, library)
    assert [e.name for e in d.effects if e.in_model] == [named]
    assert d.effects[0].accepted and d.effects[0].probability > 0.9


def test_moves_of_one_length_tell_neither_from_the_other(arm, library):
    rng = np.random.default_rng(4)
    q = random_joints(rng, 90)
    up = np.cumsum(rng.choice([-1.0, 1.0], 90))
    q[:, 1] = 0.8 * (np.abs((up % 8.0) - 4.0) - 2.0)  # up or down by 0.8 rad from pose to pose
    data = with_direction(measured(rng, q, 8e-4 * of_joint_2(signs(q))))
    pair = {"backlash[2]", "joint_settling[2]"}
    found = {e.name: e for e in wb.diagnose(arm, data, library).effects if e.name in pair}
    assert found
    for name, e in found.items():
        assert pair - {name} <= set(e.confounded_with)
        assert e.probability < 0.9


def test_the_first_pose_of_a_session_is_no_outlier_of_what_follows_the_last_move(arm, library):
    rng = np.random.default_rng(5)
    q = random_joints(rng, 60)
    error = 4e-3 * of_joint_2(changes(q))
    error[0, 1] = 8e-3  # it came from somewhere
    data = with_direction(measured(rng, q, error))
    settling = library.find("joint_settling[2]", arm, data)
    assert "p0" not in find_outliers(fit_model(arm, data, settling)).ids
    data.move[0, 0] = 1e-9  # known
    assert "p0" in find_outliers(fit_model(arm, data, settling)).ids


# --------------------------------------------------------------------------- a sensor that lags


def lagging(data, share):
    """Positions that are behind by a share of the way from the pose before."""
    step = np.diff(data.p_m, axis=0, prepend=data.p_m[:1])
    return with_direction(replace(data, p_m=data.p_m - share * step))


def slow_walk(rng, count, size=0.03):
    """Steps of some hundredths of a radian that change their length and direction."""
    step = np.zeros((count, 7))
    for k in range(1, count):
        step[k] = 0.8 * step[k - 1] + size * rng.normal(size=7)
    x = np.cumsum(step, axis=0)
    x -= 0.5 * (x.max(axis=0) + x.min(axis=0))
    return 0.5 * (LOW + HIGH) + x * np.minimum(1.0, 0.4 * (HIGH - LOW) / np.abs(x).max(axis=0))


LAG = "unnamed[measured pose: tool_move]"


@pytest.fixture(scope="module")
def of_sensor(arm, library):
    """A sensor that lags by a thousandth of each way, poses far apart."""
    rng = np.random.default_rng(11)
    q = random_joints(rng, 90)
    return wb.diagnose(arm, lagging(measured(rng, q, 0.0 * q), 1e-3), library)


def test_a_sensor_that_lags_is_no_error_of_joints(of_sensor):
    """Nothing was missing, P > .76 in nine sets, and up to 13 times the noise was left."""
    d = of_sensor
    assert d.novel is not None and d.novel.found and d.novel.name == LAG and d.novel.held.gains
    assert not d.adequate_after and not any(e.in_model for e in d.effects)
    assert not d.novel.suggested_terms and not d.novel.curves


def test_what_may_make_a_sensor_lag_is_said_and_no_term_is_offered(of_sensor, arm, library):
    d = of_sensor
    assert explain.cause_without_terms(LAG) == explain.SENSOR_LAGS
    assert explain.cause_without_terms("unnamed[joint 1: q1]") == ""
    assert explain.unnamed(d.novel) == "the measured pose depends on the last move of the tool"
    with pytest.raises(CannotAnswer, match="no term can follow the last move of the tool"):
        wb.find_unnamed(arm, d.comparison.data, [LAG], library=library)
    [panel] = place_panels(d.final, "measured pose", ("tool_move",))
    assert panel.place == "measured position" and not panel.angular
    np.testing.assert_array_equal(panel.x, length_of_last_move(d.final))


def test_the_last_move_of_the_tool_is_that_of_the_model(arm):
    """Whatever rows were left out in between; and none where the order of the rows tells none."""
    rng = np.random.default_rng(12)
    q = random_joints(rng, 40)
    data = measured(rng, q, 0.0 * q)
    fit = fit_model(arm, with_direction(data))
    pose = fit.model.poses(fit.estimate)
    move = last_move_of_tool(fit.at(fit.data.take(np.arange(0, 40, 3))))
    assert not move[0].any()
    np.testing.assert_allclose(move[1:, :3], (pose.p_m[3::3] - pose.p_m[2:-1:3]), atol=1e-12)
    turned = [rotvec_of_matrix(b @ a.T) for a, b in zip(pose.R[2:-1:3], pose.R[3::3], strict=True)]
    np.testing.assert_allclose(move[1:, 3:], turned, atol=1e-9)
    assert last_move_of_tool(fit_model(arm, data)) is None
    assert lagging_cells(Columns(fit_model(arm, data))) == []
    assert not length_of_last_move(fit_model(arm, data)).any()


def test_after_short_moves_a_sensor_that_lags_is_what_joints_do_that_all_settle_alike(arm, library):
    """It was `joint_settling` of all joints, P > .99, confounded with nothing."""
    rng = np.random.default_rng(13)
    q = slow_walk(rng, 90)
    d = wb.diagnose(arm, lagging(measured(rng, q, 0.0 * q), 4e-3), library)
    [found] = [e for e in d.effects if e.in_model]
    assert found.name == "measurement_lag" and "joint_settling" in found.confounded_with
    assert LAG in found.confounded_with
    assert found.doubts.evidence > 0.95 and "sensor" in found.inspect
    assert abs(found.parameters[0].value + 4e-3) < 1e-3
    assert advise(d, library)  # poses that tell it from joint_settling: no unnamed function takes part


def test_a_lag_that_the_tool_shows_better_is_no_less_a_lag(arm, library):
    """`measurement_lag` stood in the model with P = 2e-8: the sensor that it names was held against it."""
    rng = np.random.default_rng(14)
    q = slow_walk(rng, 100, 0.1)
    d = wb.diagnose(arm, lagging(measured(rng, q, 0.0 * q), 4e-3), library)
    [found] = [e for e in d.effects if e.in_model]
    assert found.name == "measurement_lag" and LAG in found.confounded_with
    assert found.probability > 0.9 and found.doubts.identity > 0.9


@pytest.mark.parametrize("k", [4e-3, -4e-3], ids=["cancels the lag", "adds to it"])
def test_a_joint_that_settles_beside_a_sensor_that_lags_is_not_all_joints(arm, library, k):
    """It was `joint_settling` of all joints, or of all but this one, P up to .99, confounded with nothing."""
    rng = np.random.default_rng(21)
    q = slow_walk(rng, 120)
    d = wb.diagnose(arm, lagging(measured(rng, q, k * of_joint_2(changes(q))), 4e-3), library)
    found = {e.name: e for e in d.effects if e.in_model}
    assert set(found) == {"measurement_lag", "joint_settling[2]"}
    assert "joint_settling" in found["measurement_lag"].confounded_with
    assert abs(found["joint_settling[2]"].parameters[0].value - k) < 1e-3


def test_two_joints_that_settle_beside_a_sensor_that_lags_are_not_all_joints(arm, library):
    """It was "these data do not determine what", with `joint_settling` of all joints."""
    rng = np.random.default_rng(22)
    q = slow_walk(rng, 120)
    error = np.zeros(q.shape)
    error[:, [1, 3]] = changes(q)[:, [1, 3]] * [-6e-3, 5e-3]
    d = wb.diagnose(arm, lagging(measured(rng, q, error), 4e-3), library)
    assert {e.name for e in d.effects if e.in_model} == {"measurement_lag", "joint_settling[2,4]"}


def test_joints_that_settle_by_different_shares_are_no_lag(arm, library):
    rng = np.random.default_rng(21)
    q = slow_walk(rng, 120)
    error = changes(q) * rng.uniform(-8e-3, 8e-3, 7)
    d = wb.diagnose(arm, with_direction(measured(rng, q, error)), library)
    [found] = [e for e in d.effects if e.in_model]
    assert found.hypothesis.effect == "joint_settling" and len(found.parameters) > 2
    assert "measurement_lag" not in found.confounded_with


def test_joints_that_settle_alike_are_one_number(arm, library):
    rng = np.random.default_rng(14)
    q = random_joints(rng, 90)
    d = wb.diagnose(arm, with_direction(measured(rng, q, -6e-4 * changes(q))), library)
    assert [e.name for e in d.effects if e.in_model] == ["measurement_lag"]
    assert d.effects[0].probability > 0.9 and LAG not in d.effects[0].confounded_with


# --------------------------------------------------------------------------- joints that jitter


def raster(rng, count):
    """Joint 3 goes up and down in steps of one length and stays at its ends, where its readings jitter by a
    milliradian; the others go anywhere."""
    q = random_joints(rng, count)
    step = np.tile([0, 1, 2, 2, 1, 0], count)[:count]
    q[:, 2] = 0.6 * (step - 1.0)
    return q + 1e-3 * rng.normal(size=q.shape)


@pytest.mark.parametrize(
    ("error", "settles"),
    [(lambda q: 5e-4 * signs(q), False), (lambda q: 5e-4 * changes(q) / 0.6, True)],
    ids=["backlash that every move decides", "settling"],
)
def test_jitter_of_a_joint_that_stays_does_not_make_settling_of_backlash(arm, library, error, settles):
    """It was joint_settling[3], P up to .98, where backlash follows moves of a milliradian."""
    rng = np.random.default_rng(21)
    q = raster(rng, 120)
    data = with_direction(measured(rng, q, error(q)[:, 2:3] * np.eye(7)[2]))
    [found] = [e for e in wb.diagnose(arm, data, library).effects if e.name == "joint_settling[3]"]
    assert (found.probability > 0.9) == settles
    assert ("backlash[3]" in found.confounded_with) != settles


def idle(rng, count):
    """Joints of which two in three stay at each pose: where they are, their readings, off by two milliradians
    where they stay, and the side of the last move of each."""
    moved = rng.random((count, 7)) < 0.35
    last = np.maximum.accumulate(np.where(moved, np.arange(count)[:, None], 0), axis=0)
    q = np.take_along_axis(random_joints(rng, count), last, axis=0)
    side = np.take_along_axis(signs(q), last, axis=0)
    return q, q + 2e-3 * rng.normal(size=q.shape) * ~moved, side


@pytest.mark.parametrize("loose", [0.0, 2e-3])
def test_readings_that_jitter_beyond_a_pose_make_no_backlash(arm, library, loose):
    """Their noise decided the sides: `backlash` of up to five joints, P = .8, that the arm did not have."""
    rng = np.random.default_rng(2)
    q, readings, side = idle(rng, 120)
    data = measured(rng, readings, q - readings + loose * of_joint_2(side))
    found = [e.name for e in wb.diagnose(arm, with_direction(data), library).effects if e.in_model]
    assert found == (["backlash[2]"] if loose else [])


# --------------------------------------------------------------------------- where it does not carry over


def test_in_a_raster_the_pose_without_a_last_move_does_not_decide(arm, library):
    """Joint 2 goes +h, +h, -2h again and again: its move is an offset and a multiple of its sign, but for
    row 0. That one made P(settling) = .97 to .99 of backlash in six sets."""
    rng = np.random.default_rng(1)
    q = random_joints(rng, 120)
    q[:, 1] = np.tile([-0.6, 0.0, 0.6], 40)
    side = signs(np.vstack([q[-1:], q]))[1:]  # before the first pose it was as before any other of its kind
    data = with_direction(measured(rng, q, 8e-4 * of_joint_2(side)))
    found = {e.name: e for e in wb.diagnose(arm, data, library).effects}
    pair = ("backlash[2]", "joint_settling[2]")
    for name, other in (pair, pair[::-1]):
        assert other in found[name].confounded_with
        assert found[name].doubts.evidence > 0.9 and 0.2 < found[name].doubts.identity < 0.8


def test_what_follows_the_last_move_does_not_fly_and_is_said_to_need_the_order(arm, library):
    rng = np.random.default_rng(6)
    q = random_joints(rng, 60)
    data = with_direction(measured(rng, q, 6e-4 * of_joint_2(changes(q))))
    [h] = library.find("joint_settling[2]", arm, data)
    with pytest.raises(BadInput, match=r"joint_settling\[2\] follows the last move.*\n.*--drop"):
        term_table(arm, [h], poses.flown())
    fit = fit_model(arm, data, [h])
    assert "depends on the pose before" in explain.of_order(fit)[0]
    assert explain.of_order(fit_model(arm, data)) == []
    with pytest.raises(CannotAnswer, match="rows in the order of measurement"):
        check_needs(library, ["joint_settling[2]"], arm, replace(data, move=None))


def test_next_poses_are_not_said_to_tell_what_only_the_length_of_their_moves_would(arm, library):
    """From where the arm will come to them, nobody knows."""
    rng = np.random.default_rng(7)
    q = random_joints(rng, 60)
    data = with_direction(measured(rng, q, 6e-4 * of_joint_2(changes(q))))
    fit = fit_model(arm, data)

    def separation(*names):
        effects = [library.find(name, arm, data)[0] for name in names]
        return max(pose.d2 for pose in next_poses(fit, effects, count=3))

    beside_gain = separation("joint_settling[2]", "encoder_gain[2]")
    assert separation("joint_settling[2]", "backlash[2]") < 0.3 * beside_gain


# --------------------------------------------------------------------------- replicates


def twice(rng, error_of_sign, **columns):
    """Forty poses, each from both sides of all joints; error_of_sign: (N, 7) of the sides (N, 7)."""
    side = np.tile(np.repeat([[1.0], [-1.0]], 7, axis=1), (40, 1))
    q = np.repeat(random_joints(rng, 40), 2, axis=0)
    return measured(rng, q, error_of_sign(side), replicate=np.arange(80) // 2, **columns), side


def loose(side):
    return 2e-3 * of_joint_2(side)


def test_backlash_is_no_noise_of_replicates_that_were_approached_from_both_sides(arm):
    """The floor held it, 1 mm for .17 mm, and hid it."""
    data, side = twice(np.random.default_rng(8), loose)
    fit = fit_model(arm, replace(data, direction=side))
    floor = noise_floor(fit)
    assert floor.source == REPLICATES and floor.dof == 40 - 3
    assert 0.7 < floor.pos_m / (np.sqrt(3.0) * NOISE_M) < 1.3
    assert floor.approached.by == "direction" and floor.approached.p_value < 1e-20
    assert wb.compare(arm, replace(data, direction=side)).p_lack_of_fit < 1e-6
    text = answers.comparison_text(wb.compare(arm, replace(data, direction=side)))
    assert "differ by the side that joints came from" in text


def test_a_second_visit_from_the_side_opposite_to_the_first_is_seen_without_directions(arm):
    """The way between two visits of a pose is in no file; backlash went into the floor, .34 mm for .17."""
    rng = np.random.default_rng(9)
    first = random_joints(rng, 40)
    side = np.repeat(signs(first), 2, axis=0)
    side[1::2] *= -1.0
    data = measured(rng, np.repeat(first, 2, axis=0), loose(side), replicate=np.arange(80) // 2)
    floor = noise_floor(fit_model(arm, with_direction(data)))
    assert floor.approached.by == "visit" and floor.approached.p_value < 1e-20
    assert 0.7 < floor.pos_m / (np.sqrt(3.0) * NOISE_M) < 1.3


def test_where_all_joints_came_from_one_side_the_joint_that_errs_is_the_simpler_cause(arm, library):
    """It was P = .33, shared with couplings to each other joint, of which such data show nothing."""
    data, side = twice(np.random.default_rng(8), loose)
    d = wb.diagnose(arm, replace(data, direction=side), library)
    [found] = [e for e in d.effects if e.in_model]
    assert found.name == "backlash[2]" and found.accepted and found.probability > 0.9
    assert {f"backlash_coupling[2,{j}]" for j in (1, 3, 4, 5, 6, 7)} <= set(found.confounded_with)


def test_without_directions_every_other_visit_shows_it(arm):
    data, _ = twice(np.random.default_rng(8), loose)
    floor = noise_floor(fit_model(arm, with_direction(data)))
    assert floor.approached.by == "visit"
    assert "record it as dir1" in explain.approached(floor)


def test_too_few_replicates_beside_their_sides_are_no_floor(arm):
    """Eight pairs: what is left of them beside the motions of seven joints is too little."""
    data, side = twice(np.random.default_rng(8), loose)
    group = np.where(np.arange(80) < 16, np.arange(80) // 2, np.arange(80))
    stated = np.tile(NOISE_M**2 * np.eye(6), (80, 1, 1))
    few = replace(data, direction=side, replicate=group)
    assert noise_floor(fit_model(arm, few)).source.startswith("unknown: 5 of the 6")
    assert noise_floor(fit_model(arm, replace(few, cov=stated))).source == STATED


@pytest.mark.parametrize("seed", range(5))
def test_noise_of_replicates_follows_no_approach(arm, seed):
    rng = np.random.default_rng(100 + seed)
    data, side = twice(rng, np.zeros_like)
    for known in (replace(data, direction=side), with_direction(data)):
        fit = fit_model(arm, known)
        found = replicates(fit)
        assert found.approached is None and not found.error.any()
        assert explain.approached(noise_floor(fit)) == ""


# --------------------------------------------------------------------------- one pose


def test_no_pose_alone_supports_a_step():
    """A step between the first pose and the second was found in five joints at once."""
    rng = np.random.default_rng(2)
    q = random_joints(rng, 20)
    data = measured(rng, q, np.zeros_like(q))
    tried = [
        *grid_values("times", data),
        *(t for best in (0.5, 9.5, 18.5) for t in finer("times", best, data)),
    ]
    assert {min(sum(data.t_s < t), sum(data.t_s > t)) >= 3 for t in tried} == {True}
    assert {2.5, 16.5} <= set(tried), "as near to the ends as three poses let it be"


def test_a_break_between_two_times_of_many_poses_is_a_step():
    rng = np.random.default_rng(2)
    q = random_joints(rng, 12)
    data = replace(measured(rng, q, np.zeros_like(q)), t_s=np.repeat([0.0, 100.0], 6))
    assert grid_values("times", data) == [50.0]


@pytest.mark.parametrize("name", ["measurement_lag", "joint_settling"])
def test_beside_an_effect_of_moves_nothing_explains_the_pose_whose_move_nobody_knows(arm, library, name):
    rng = np.random.default_rng(11)
    q = random_joints(rng, 40)
    error = -2e-3 * changes(q)
    error[0] = rng.normal(0.0, 4e-3, 7)  # it came from somewhere
    data = with_direction(measured(rng, q, error))
    study = Study.of(wb.compare(arm, data), library, (), True)
    [h] = [c.variants[0] for c in study.competition.candidates if c.name == name]
    weight = study.scorer((h,)).columns.weight
    assert weight[0] <= 1e-3 and (weight[1:] == study.weight[1:]).all()
    assert not study.posterior((h,)).something_missing
    alone = study.scorer(()).columns.weight
    assert (alone == study.weight).all(), "backlash may have its evidence there"
