"""The simulator's arm, controllers and clockwork, against formulas written out here."""

import itertools
import time

import numpy as np
import pytest

import kcm
from kincal_sim import transforms
from kincal_sim.mechanics.arm import Arm
from kincal_sim.mechanics.effects import JointCompliance
from kincal_sim.mechanics.motion import ArmController, PanTiltController, TrajectoryGenerator
from kincal_sim.mechanics.plant import Conditions, NoEquilibrium, Plant
from kincal_sim.mechanics.spec import UnknownName, load_spec, split_errors
from kincal_sim.scenario import ArmTruth, Scenario, load
from kincal_sim.truth import build_plant, true_coefficients
from kincal_sim.vision.imagers import BackgroundImager, Imager
from kincal_sim.world import World

SPEED, ACCEL = 0.8, 2.0


def rz(t):
    return np.array([[np.cos(t), -np.sin(t), 0, 0], [np.sin(t), np.cos(t), 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


def rx(t):
    return np.array([[1, 0, 0, 0], [0, np.cos(t), -np.sin(t), 0], [0, np.sin(t), np.cos(t), 0], [0, 0, 0, 1]])


def move(x, y, z):
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def dh_product(spec, q, delta, base=None, tool=None):
    """Eq. 2 of the method: f_B T_01 ... T_67 f_T with DH errors (phi, alpha, a, d) added."""
    T = move(*spec["base"]["xyz_m"]) @ (np.eye(4) if base is None else base)
    for j, (dphi, dalpha, da, dd) in zip(range(len(q)), delta, strict=True):
        p = spec["joint"][j]
        T = (
            T
            @ rz(q[j] + dphi)
            @ move(0, 0, p["d_m"] + dd)
            @ move(p["a_m"] + da, 0, 0)
            @ rx(p["alpha_rad"] + dalpha)
        )
    return T @ move(*spec["tool"]["xyz_m"]) @ (np.eye(4) if tool is None else tool)


def named(delta):
    return {
        f"J{j + 1}.{n}": delta[j, k]
        for j in range(7)
        for k, n in enumerate(("phi_rad", "alpha_rad", "a_m", "d_m"))
    }


@pytest.fixture(scope="module")
def nominal():
    return Arm()


@pytest.fixture
def rng():
    return np.random.default_rng(20)


# -- kinematics -------------------------------------------------------------------------------------


def test_mujoco_bodies_follow_eq_2_with_any_dh_errors(rng):
    for _ in range(10):
        delta = rng.uniform(-1, 1, (7, 4)) * [1.3, 0.5, 0.1, 0.2]
        arm = Arm(errors=named(delta))
        for _ in range(10):
            q = rng.uniform(arm.q_min, arm.q_max)
            arm.set(q)
            np.testing.assert_allclose(arm.T_base_tool, dh_product(arm.spec, q, delta), atol=1e-12)


def test_tool_positions_of_many_postures_are_those_of_one_after_the_other(rng):
    arm = Arm(
        errors={"J2.alpha_rad": 0.4, "J5.d_m": 0.1, "base.rx_rad": 0.2, "tool.ty_m": 0.05}, payload_kg=0.3
    )
    q_rad = rng.uniform(arm.q_min, arm.q_max, (40, arm.n))
    found = arm.tool_positions_m(q_rad)
    for q, p_m in zip(q_rad, found, strict=True):
        arm.set(q)
        assert p_m == pytest.approx(arm.p_base_tool_m, abs=1e-13)


def test_base_and_tool_errors_are_twists_in_the_stated_order(rng):
    def ry(t):
        return np.array(
            [[np.cos(t), 0, np.sin(t), 0], [0, 1, 0, 0], [-np.sin(t), 0, np.cos(t), 0], [0, 0, 0, 1]]
        )

    def twist(v):
        return move(v[0], 0, 0) @ rx(v[3]) @ move(0, v[1], 0) @ ry(v[4]) @ rz(v[5]) @ move(0, 0, v[2])

    base, tool = rng.uniform(-0.2, 0.2, (2, 6))
    names = ("tx_m", "ty_m", "tz_m", "rx_rad", "ry_rad", "rz_rad")
    errors = {f"base.{n}": v for n, v in zip(names, base, strict=True)}
    errors |= {f"tool.{n}": v for n, v in zip(names, tool, strict=True)}
    arm = Arm(errors=errors)
    q = rng.uniform(arm.q_min, arm.q_max)
    arm.set(q)
    np.testing.assert_allclose(
        arm.T_base_tool, dh_product(arm.spec, q, np.zeros((7, 4)), twist(base), twist(tool)), atol=1e-12
    )


def test_camera_stands_where_pan_and_tilt_put_it(nominal):
    pan, tilt = 0.3, 0.5  # positive tilt looks down
    nominal.set(np.zeros(7), pan, tilt)
    forward = [
        np.cos(pan) * np.cos(tilt),
        np.sin(pan) * np.cos(tilt),
        -np.sin(tilt),
    ]
    T = nominal.T_base_cam
    np.testing.assert_allclose(T[:3, 2], forward, atol=1e-12)
    np.testing.assert_allclose(T[:3, 0], [np.sin(pan), -np.cos(pan), 0], atol=1e-12)  # x right of the view
    up = np.cross(T[:3, 0], forward)
    np.testing.assert_allclose(
        T[:3, 3], np.array([-0.35, 0.45, 1.25]) + 0.05 * np.array(forward) + 0.03 * up, atol=1e-12
    )


def test_gravity_torque_is_minus_the_slope_of_potential_energy(rng):
    arm = Arm(gravity_m_s2=(0.3, -0.2, -1.315), payload_kg=0.7)

    def energy(q):
        arm.set(q)
        return -float(arm.model.body_mass @ (arm.data.xipos @ arm.model.opt.gravity))

    for _ in range(5):
        q, h = rng.uniform(arm.q_min, arm.q_max), 1e-5
        slope = [(energy(q + h * e) - energy(q - h * e)) / (2 * h) for e in np.eye(7)]
        arm.set(q)
        np.testing.assert_allclose(arm.gravity_torque(), -np.array(slope), atol=1e-7)


def test_all_mass_is_in_the_links_and_the_payload():
    spec = load_spec()
    arm = Arm(payload_kg=0.5)
    moving = arm.model.body_subtreemass[arm.model.body("link1").id]
    assert moving == pytest.approx(sum(j["mass_kg"] for j in spec["joint"]) + 0.5)


def test_unknown_errors_are_refused_with_the_known_names():
    for name in ("J8.phi_rad", "J1.theta", "base.phi_rad", "elbow"):
        with pytest.raises(UnknownName, match="known: J1..J7"):
            split_errors({name: 0.1}, 7)


def test_quaternions_are_exact_for_half_turns_and_random_rotations(rng):
    half_turns = [np.diag(d).astype(float) for d in ((1, -1, -1), (-1, 1, -1), (-1, -1, 1))]
    for R in half_turns + [
        transforms.rotation_matrix(q / np.linalg.norm(q)) for q in rng.standard_normal((50, 4))
    ]:
        q = transforms.quaternion(R)
        assert np.linalg.norm(q) == pytest.approx(1.0, abs=1e-15)
        np.testing.assert_allclose(transforms.rotation_matrix(q), R, atol=1e-14)


def test_an_arm_without_textures_is_the_same_arm(rng):
    """To the bit, in all numbers of MuJoCo's model that are not about textures and names."""
    dressed, bare = (Arm(errors={"J2.phi_rad": 0.1, "J3.a_m": 0.01}, pictures=t) for t in (True, False))
    assert dressed.model.ntex == 3 and bare.model.ntex == 0
    about = ("tex", "mat_texid", "name", "nname", "nbuffer", "ntex", "signature")
    for field in dir(dressed.model):
        value = getattr(dressed.model, field)
        if isinstance(value, np.ndarray | int | float) and not field.startswith(("_", *about)):
            np.testing.assert_array_equal(getattr(bare.model, field), value, field)
    q = rng.uniform(bare.q_min, bare.q_max)
    for arm in (dressed, bare):
        arm.set(q, 0.1, 0.2)
    np.testing.assert_array_equal(bare.T_base_tool, dressed.T_base_tool)
    np.testing.assert_array_equal(bare.T_base_cam, dressed.T_base_cam)


# -- what the encoders do not show -------------------------------------------------------------------


def plant_of(**settings):
    scenario = Scenario(name="test", arm=ArmTruth(**settings))
    return build_plant(scenario), true_coefficients(scenario)


def rest(plant, q_read, direction=0.0):
    """True joints for these readings; the arm stands there."""
    return plant.settle(Conditions(q_rad=np.asarray(q_read, float), direction=direction)).q_rad


def test_an_encoder_bias_is_a_dh_error_phi_of_the_other_sign(rng):
    plant, coefficients = plant_of(encoder_bias_rad={"J2": -0.06, "J5": 0.07})
    assert coefficients == {"J2.phi_rad": 0.06, "J5.phi_rad": -0.07}
    arm, same = plant.arm(), Arm(errors=coefficients)
    reading = rng.uniform(arm.q_min, arm.q_max)
    rest(plant, reading)
    same.set(reading)
    np.testing.assert_allclose(arm.T_base_tool, same.T_base_tool, atol=1e-12)


def test_an_encoder_gain_turns_the_joint_in_proportion():
    plant, coefficients = plant_of(encoder_gain={"J4": 0.02})
    assert coefficients == {"encoder_gain[4]": 0.02}
    assert rest(plant, [0, 0, 0, 2.0, 0, 0, 0])[3] == pytest.approx(2.04)


def test_a_soft_joint_rests_where_spring_and_gravity_balance(rng):
    soft = np.array([0, 0.002, 0.001, 0.004, 0, 0, 0])
    plant, _ = plant_of(compliance_rad_per_nm={f"J{j + 1}": c for j, c in enumerate(soft)})
    arm = plant.arm()
    for _ in range(5):
        q = rng.uniform(arm.q_min, arm.q_max)
        q_true = rest(plant, q)
        np.testing.assert_allclose(q_true - q, soft * arm.gravity_torque(), atol=1e-12)
        arm.set(q_true)
    # An outstretched arm sags: the tool is lower than the encoders say.
    q = np.array([0.0, 1.2, 0.0, 0.3, 0.0, 0.0, 0.0])
    rest(plant, q)
    sagging = arm.T_base_tool[2, 3]
    arm.set(q)
    assert sagging < arm.T_base_tool[2, 3] - 0.01


def test_friction_keeps_a_joint_on_the_side_from_which_it_came():
    plant, coefficients = plant_of(hysteresis_rad={"J1": 0.003})
    assert coefficients == {"backlash[1]": 0.003}
    for side in (-1, 0, 1):
        q_true = rest(plant, np.full(7, 0.2), direction=np.array([side, 1, 1, 1, 1, 1, 1]))
        np.testing.assert_allclose(q_true, [0.2 + 0.003 * side, *[0.2] * 6], atol=1e-15)


def test_a_coupling_moves_one_joint_by_two_others():
    coupling = {"name": "odd", "joint": "J3", "size_rad": 0.008, "tanh": "J4", "cos": "J6"}
    plant, coefficients = plant_of(coupling=[coupling])
    assert coefficients == {"odd": 0.008}
    q = np.array([0.1, 0.2, 0.3, 1.4, 0.5, 0.6, 0.7])
    off = rest(plant, q) - q
    np.testing.assert_allclose(off, [0, 0, 0.008 * np.tanh(1.4) * np.cos(0.6), 0, 0, 0, 0], atol=1e-12)


def test_a_spring_too_soft_to_balance_is_an_error_not_a_number():
    plant = Plant(load_spec(), effects=[JointCompliance([0, 1.0, 0, 1.0, 0, 0, 0])])
    with pytest.raises(NoEquilibrium, match="no equilibrium"):
        rest(plant, [0.0, 1.2, 0.0, 0.3, 0.0, 0.0, 0.0])


# -- motion -----------------------------------------------------------------------------------------


def trajectory(q=(0.0, 0.0, 0.0)):
    n = len(q)
    return TrajectoryGenerator(q, [SPEED] * n, [ACCEL] * n)


def test_axes_move_on_a_straight_line_inside_the_limits_and_arrive_together(rng):
    for _ in range(30):
        q0, q1 = rng.uniform(-2, 2, (2, 3)) * rng.choice([1.0, 0.01], 3)
        m, scale = trajectory(q0), rng.uniform(0.1, 1.0)
        m.command(0.0, q1, scale)
        h = 1e-3
        times = np.arange(0.0, 60.0, h * 50)
        far = np.max(np.abs(q1 - q0))
        v_line = min(scale * SPEED, np.sqrt(far * ACCEL))
        duration = far / v_line + v_line / ACCEL
        for t in times[times < duration]:
            q, v, moving = m.at(t)
            share = (q - q0) / (q1 - q0)
            assert np.ptp(share) < 1e-9 and moving
            assert np.max(np.abs(v)) <= scale * SPEED + 1e-12
        q, v, moving = m.at(duration + 1e-6)
        np.testing.assert_allclose(q, q1, atol=1e-12)
        assert not moving and not v.any()
        np.testing.assert_array_equal(m.direction, np.sign(q1 - q0))


def test_speed_changes_no_faster_than_the_acceleration_limit_even_when_redirected(rng):
    m, h = trajectory(), 0.01
    v_before, q_before = np.zeros(3), np.zeros(3)
    for k in range(3000):
        t = k * h
        if k % 70 == 0:
            m.command(t, rng.uniform(-1, 1, 3), 1.0)
        if k % 510 == 509:
            m.hold(t)
        q, v, _ = m.at(t)
        assert np.max(np.abs(v)) <= SPEED + 1e-12
        assert np.max(np.abs(v - v_before)) <= ACCEL * h + 1e-9
        np.testing.assert_allclose(q - q_before, 0.5 * h * (v + v_before), atol=0.5 * ACCEL * h * h)
        v_before, q_before = v, q


def test_hold_brakes_and_stays():
    m = trajectory()
    m.command(0.0, [1.0, 0.5, 0.0], 1.0)
    m.hold(0.7)
    brake = SPEED**2 / (2 * ACCEL)
    q, v, moving = m.at(0.7 + SPEED / ACCEL + 0.01)
    reached = (0.7 - 0.5 * SPEED / ACCEL) * SPEED + brake
    np.testing.assert_allclose(q, [reached, 0.5 * reached, 0.0], atol=1e-12)
    assert not moving and not v.any()
    np.testing.assert_array_equal(m.at(20.0)[0], q)


def test_an_arm_vibrates_for_half_a_second_after_braking_and_is_then_exactly_at_rest():
    c = ArmController(load_spec(), np.zeros(7))
    goal = np.array([0.5, -0.3, 0, 0, 0, 0, 0])
    assert c.command(0.0, 1, goal, 1.0, False)
    arrival = 0.5 / SPEED + SPEED / ACCEL
    vibration = [c.trajectory.at(arrival + dt)[0] - goal for dt in np.linspace(0.001, 0.499, 100)]
    assert 5e-4 < np.max(np.abs(vibration)) < 5e-3
    assert all(c.trajectory.at(arrival + dt)[2] for dt in (0.01, 0.25, 0.49))
    q, v, moving = c.trajectory.at(arrival + 0.501)
    assert not moving and not v.any()
    np.testing.assert_array_equal(q, goal)


@pytest.mark.parametrize(
    "q, scale, mask",
    [
        ([2.7, 0, 0, 0, 0, 0, 0], 1.0, 0b0000001),
        ([0, 0, 0, -1.0, 0, 0, 3.1], 1.0, 0b1001000),
        ([0, np.nan, 0, 0, 0, 0, 0], 1.0, 0b0000010),
        ([0, 0, 0, 0, 0, 0], 1.0, 0b1111111),
        ([0, 0, 0, 0, 0, 0, 0], 0.0, 0b1111111),
        ([0, 0, 0, 0, 0, 0, 0], 1.5, 0b1111111),
        ([0, 0, 0, 0, 0, 0, 0], np.nan, 0b1111111),
    ],
)
def test_impossible_commands_are_refused_with_fault_bits_and_the_arm_stays(q, scale, mask):
    c = ArmController(load_spec(), np.full(7, 0.1))
    assert not c.command(0.0, 1, q, scale, False)
    assert c.fault_mask == mask
    np.testing.assert_array_equal(c.trajectory.at(5.0)[0], np.full(7, 0.1))
    assert c.command(5.0, 2, np.zeros(7), 1.0, False) and c.fault_mask == 0


def test_repeated_and_older_commands_are_ignored():
    c = ArmController(load_spec(), np.zeros(7))
    assert c.command(0.0, 5, np.full(7, 0.1), 1.0, False)
    for seq in (5, 4):
        assert not c.command(0.1, seq, np.full(7, -0.1), 1.0, False)
    np.testing.assert_array_equal(c.trajectory.at(9.0)[0], np.full(7, 0.1))


def test_the_pan_tilt_unit_stops_at_its_limits_and_keeps_its_speed_limit():
    unit = PanTiltController(load_spec())
    assert unit.command(0.0, 1, 9.0, -9.0)
    q = [unit.trajectory.at(0.1 * k)[0] for k in range(100)]
    np.testing.assert_allclose(q[-1], [1.6, -0.6])
    assert np.max(np.abs(np.diff(q, axis=0))) <= 0.1 + 1e-9
    assert not unit.command(11.0, 2, np.nan, 0.0)


# -- the world: messages in, messages out -----------------------------------------------------------


def exact_imager(*_):
    """A camera that reports the true position at the exposure."""

    def expose(exposure):
        m = kcm.detection_t()
        m.t_us, m.seq = exposure.t_us, exposure.seq
        m.p_cam_tool_m = (np.linalg.inv(exposure.T_base_cam) @ exposure.T_base_tool)[:3, 3].tolist()
        return m

    return Imager("KC_DETECTION", expose)


def arm_cmd(seq, q):
    m = kcm.arm_cmd_t()
    m.seq, m.n_joints, m.speed_scale = seq, 7, 1.0
    m.q_rad = [*q, 0.0]
    return m


def steps(world, ticks, first=1):
    return [dict(world.step(k * 100_000)) for k in range(first, first + ticks)]


def test_a_frame_is_exposed_at_the_next_tick_with_the_true_pose_of_that_tick():
    world = World(load("paper"), 1, exact_imager)
    steps(world, 3)
    request = kcm.frame_request_t()
    request.seq = 41
    world.receive("KC_ARM_CMD", arm_cmd(1, [0.5, -0.3, 0.2, 1.9, 0.3, 0.2, -0.4]))
    world.receive("KC_FRAME_REQUEST", request)
    out = steps(world, 1, 4)[0]
    seen, state = out["KC_DETECTION"], out["KC_ARM_STATE"]
    assert (seen.t_us, seen.seq, state.t_us, state.moving) == (400_000, 41, 400_000, 1)
    same = Arm(errors=world.scenario.arm.errors)
    same.set(state.q_rad[:7], out["KC_PANTILT_STATE"].pan_rad, out["KC_PANTILT_STATE"].tilt_rad)
    expected = np.linalg.inv(same.T_base_cam) @ same.T_base_tool
    np.testing.assert_allclose(seen.p_cam_tool_m, expected[:3, 3], atol=1e-12)
    assert "KC_DETECTION" not in steps(world, 1, 5)[0]


def test_states_count_up_and_truth_comes_every_second():
    world = World(load("encoder_bias"), 1, exact_imager)
    out = steps(world, 50)
    assert [o["KC_ARM_STATE"].seq for o in out] == list(range(1, 51))
    times = [o["KC_SIM_TRUTH"].t_us for o in out if "KC_SIM_TRUTH" in o]
    assert times == [100_000, *range(1_000_000, 5_000_001, 1_000_000)]
    bias = world.plant.encoders.bias_rad
    np.testing.assert_allclose(
        np.array(out[-1]["KC_SIM_TRUTH"].q_true_rad[:7]) + bias, out[-1]["KC_ARM_STATE"].q_rad[:7], atol=1e-12
    )


def test_messages_of_one_tick_give_the_same_whatever_their_order_of_arrival():
    def run(order):
        world = World(load("healthy"), 1, exact_imager)
        steps(world, 2)
        pantilt = kcm.pantilt_cmd_t()
        pantilt.seq, pantilt.pan_rad = 1, 0.4
        messages = [
            ("KC_ARM_CMD", arm_cmd(1, [0.1] * 7)),
            ("KC_ARM_CMD", arm_cmd(2, [0.2] * 7)),
            ("KC_PANTILT_CMD", pantilt),
            ("KC_FRAME_REQUEST", kcm.frame_request_t()),
        ]
        for k in order:
            world.receive(*messages[k])
        return [m.encode() for o in steps(world, 20, 3) for m in o.values()]

    first = run((0, 1, 2, 3))
    assert all(
        run(order) == first for order in itertools.islice(itertools.permutations(range(4)), 1, None, 5)
    )


def test_the_world_counts_the_seconds_in_which_shapes_touch():
    world = World(load("healthy"), 1, exact_imager)
    world.receive("KC_ARM_CMD", arm_cmd(1, [2.5, 1.9, 0.0, 0.5, 0.0, 0.0, 0.0]))
    steps(world, 100)
    assert any("deck" in pair and seconds >= 3 for pair, seconds in world.contacts.items())


def test_noise_and_quantisation_act_on_readings_only():
    scenario = load("healthy")
    scenario.arm.encoder_noise_rad, scenario.arm.encoder_step_rad = 1e-4, 1e-5
    world = World(scenario, 1, exact_imager)
    out = steps(world, 200)
    q = np.array([o["KC_ARM_STATE"].q_rad[:7] for o in out])
    park = np.array(world.arm.spec["motion"]["park_rad"])
    assert np.std(q - park) == pytest.approx(1e-4, rel=0.1)
    np.testing.assert_allclose(np.round(q / 1e-5), q / 1e-5, atol=1e-6)
    np.testing.assert_allclose(out[-1]["KC_SIM_TRUTH"].q_true_rad[:7], park, atol=1e-12)


def test_the_arm_starts_free_of_collisions(nominal):
    nominal.set(nominal.spec["motion"]["park_rad"], *nominal.spec["pantilt"]["start_rad"])
    assert nominal.collisions() == []


def test_a_collision_is_noticed(nominal):
    # Bent down and forward, the arm reaches through the deck.
    nominal.set([3.0, 2.0, 0.0, 0.5, 0.0, 0.0, 0.0], 0.0, 0.0)
    assert any("deck" in pair for pair in nominal.collisions())


# -- frames rendered in the background (real time) ------------------------------------------------------


def completed(background, now_us, last_motion_us):
    """What the background imager hands out, waiting for its thread."""
    deadline = time.monotonic() + 20.0
    while time.monotonic() < deadline:
        if out := background.completed(now_us, last_motion_us):
            return out
        time.sleep(0.005)
    raise AssertionError("nothing was rendered")


def test_a_frame_of_a_still_scene_counts_as_taken_when_it_is_ready():
    background = BackgroundImager(exact_imager)
    world = World(load("paper"), 1, background.imager)
    instant = World(load("paper"), 1, exact_imager)
    for w in (world, instant):
        steps(w, 3)
        w.receive("KC_FRAME_REQUEST", kcm.frame_request_t())
    assert "KC_DETECTION" not in steps(world, 1, 4)[0]
    expected = steps(instant, 1, 4)[0]["KC_DETECTION"]
    ((channel, m),) = completed(background, 900_000, world.last_motion_us)
    assert (channel, m.t_us) == ("KC_DETECTION", 900_000)
    assert m.p_cam_tool_m == expected.p_cam_tool_m


def test_a_frame_of_a_moving_scene_keeps_the_time_of_its_exposure():
    background = BackgroundImager(exact_imager)
    world = World(load("paper"), 1, background.imager)
    steps(world, 3)
    world.receive("KC_ARM_CMD", arm_cmd(1, [0.5, -0.3, 0.2, 1.9, 0.3, 0.2, -0.4]))
    world.receive("KC_FRAME_REQUEST", kcm.frame_request_t())
    steps(world, 1, 4)
    assert completed(background, 900_000, world.last_motion_us)[0][1].t_us == 400_000


def far_end(arm, shape):
    """The end of a capsule that is farther from the base."""
    g = arm.model.geom(shape)
    centre, axis = arm.data.geom_xpos[g.id], arm.data.geom_xmat[g.id].reshape(3, 3)[:, 2]
    ends = [centre + sign * g.size[1] * axis for sign in (-1, 1)]
    return max(ends, key=lambda p: float(np.linalg.norm(p)))


@pytest.mark.parametrize("errors", [{}, {"J3.d_m": 0.15, "J3.a_m": 0.03}, {"J3.d_m": -0.15}])
def test_a_link_of_another_length_still_ends_at_its_next_joint(errors):
    arm = Arm(errors=errors)
    arm.set([0.4, -0.3, 0.2, 0.8, 0.1, 0.2, 0.0])
    np.testing.assert_allclose(far_end(arm, "link3.1"), arm.data.body("frame3").xpos, atol=1e-9)


def test_the_models_own_camera_has_the_cameras_field_of_view(nominal):
    camera = nominal.spec["camera"]
    half = 0.5 * np.radians(nominal.model.cam_fovy[0])
    assert np.tan(half) * camera["fy_px"] == pytest.approx(0.5 * camera["height_px"])
