"""Arms, inverse kinematics, camera and kernel of kincal.flight against plain numpy."""

import numpy as np
import pytest
from places import BIN

from kincal import rotations
from kincal.flight import Arm, Model, Observations, Terms, library, tables
from kincal.flight.arm import with_dh_errors
from kincal.flight.camera import Camera
from kincal.flight.ik import Solver
from kincal.flight.kernel import rotation_correlation, spectral_table
from kincal.rotations import Pose

ARM, CAMERA, TERMS, KERNEL = (
    tables.decode((BIN / f"{kind}.tbl").read_bytes())[1] for kind in ("arm", "camera", "terms", "kernel")
)
HALF = np.pi / 2
# a, alpha, d of the arm, typed here a second time
WAM = [
    (0, -HALF, 0), (0, HALF, 0), (0.045, -HALF, 0.55), (-0.045, HALF, 0), (0, -HALF, 0.3), (0, HALF, 0),
    (0, 0, 0.06),
]  # fmt: skip


def dh(theta, d, a, alpha):
    ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array(
        [[ct, -st * ca, st * sa, a * ct], [st, ct * ca, -ct * sa, a * st], [0, sa, ca, d], [0, 0, 0, 1]]
    )


def wam(q, errors=None):
    """Frames of the arm by textbook matrices; errors: {(joint, "phi"|"alpha"|"a"|"d"): value}."""
    errors = errors or {}
    T = np.eye(4)
    T[2, 3] = 0.346
    frames = [T]
    for j, (a, alpha, d) in enumerate(WAM, 1):
        e = {k: errors.get((j, k), 0.0) for k in ("phi", "alpha", "a", "d")}
        T = T @ dh(q[j - 1] + e["phi"], d + e["d"], a + e["a"], alpha + e["alpha"])
        frames.append(T)
    tool = T.copy()
    tool[:3, 3] += 0.1 * T[:3, 2]
    return frames, tool


@pytest.fixture
def joints():
    return np.random.default_rng(3).uniform(-1.2, 1.2, (20, 7))


def test_points_and_frames_are_those_of_the_textbook(joints):
    arm = Arm.of_table(ARM)
    points, frames = arm.points(joints), arm.frames(joints)
    for i, q in enumerate(joints):
        want, tool = wam(q)
        np.testing.assert_allclose(points[i, 1:-1], [T[:3, 3] for T in want[:-1]], atol=1e-12)
        np.testing.assert_allclose(points[i, -1], tool[:3, 3], atol=1e-12)
        np.testing.assert_allclose(frames[i].matrix, [*want, tool], atol=1e-12)


def corrected(joints):
    return Model(
        Arm.of_table(ARM), Terms.of_table(TERMS), Observations.of_columns({"q": joints}, (0, 0, -9.81))
    )


def test_corrections_by_terms_and_by_changed_dh_agree_with_the_textbook(joints):
    errors = {"J2.alpha_rad": 0.4, "J7.phi_rad": 1.3, "J3.a_m": 0.01, "J3.d_m": 0.15, "J5.alpha_rad": -0.02}
    textbook = {(2, "alpha"): 0.4, (7, "phi"): 1.3, (3, "a"): 0.01, (3, "d"): 0.15, (5, "alpha"): -0.02}
    model = corrected(joints)
    want = [wam(q, textbook)[1] for q in joints]
    coef = [errors.get(name, 0.0) for name in model.terms.names]
    np.testing.assert_allclose(model.poses(coef).matrix, want, atol=1e-12)
    np.testing.assert_allclose(Arm.of_table(ARM, errors).fk(joints).matrix, want, atol=1e-12)
    np.testing.assert_allclose(Arm.of_table(with_dh_errors(ARM, errors)).fk(joints).matrix, want, atol=1e-12)


def test_pose_jacobian_needs_no_measurement(joints):
    model, h = corrected(joints), 1e-6
    zero = np.zeros(model.terms.n)
    J = model.pose_jacobian(zero)
    assert J.shape == (20, 6, model.terms.n)
    for k in range(28):
        step = h * np.eye(model.terms.n)[k]
        slope = rotations.pose_difference(model.poses(step), model.poses(-step)) / (2 * h)
        np.testing.assert_allclose(J[:, :, k], slope, atol=1e-8)


def test_inverse_kinematics_undoes_the_forward_one(joints):
    options = {"iter_max": 50, "tol_pos_m": 1e-9, "tol_rot_rad": 1e-9, "margin": 0.0, "step_max": 1.0}
    arm = Arm.of_table(ARM)
    goals = arm.fk(joints)
    q, found = Solver(ARM, options).solve(goals, joints + 0.05)
    assert found.sum() >= 18
    np.testing.assert_allclose(arm.fk(q[found]).matrix, goals.matrix[found], atol=1e-8)
    low, high = np.full(7, -0.1), np.full(7, 0.1)
    q, found = Solver(ARM, options, (low, high)).solve(goals, np.zeros((20, 7)))
    assert not found.any() and np.abs(q).max() <= 0.1 + 1e-12
    assert ARM.joint[0].q_min < -0.1  # the table itself is left alone


def test_aimed_camera_sees_the_point_in_the_image_centre():
    camera = Camera(CAMERA)
    target = np.array([[0.6, -0.2, 0.4], [0.5, 0.2, 0.3]])
    aim = camera.aim(target)
    pose = camera.pose(aim.pan_rad, aim.tilt_rad)
    seen = pose.inverse.apply(target)
    assert aim.inside.all()
    np.testing.assert_allclose(seen[:, :2] / seen[:, 2:], 0.0, atol=1e-9)
    assert (seen[:, 2] > 0.5).all()
    one = camera.pose(aim.pan_rad[0], aim.tilt_rad[0])
    np.testing.assert_array_equal(one.matrix, pose.matrix[0])
    eye, corners = camera.frustum(aim.pan_rad[0], aim.tilt_rad[0], 1.0)
    assert np.allclose(eye, one.p_m)
    # 69 x 42 degrees of view
    half = np.degrees(np.arctan(np.linalg.norm(corners[1] - corners[0]) / 2))
    assert 2 * half == pytest.approx(69.0, abs=0.5)


def test_points_beside_the_unit_are_out_of_its_limits():
    behind = np.array(list(CAMERA.mast_xyz_m)) + [[0.0, 0.0, 5.0]]
    assert not Camera(CAMERA).aim(behind).inside.any()


def test_tags_are_seen_when_they_face_the_camera_inside_the_image():
    camera = Camera(CAMERA)
    # the tool stands so that the first tag is seen square on, 0.8 m in front of the camera
    first = camera.tags[0]
    tool = Pose(np.array([0.0, 0.0, 0.8]), np.eye(3)) @ first.inverse
    away = Pose(np.array([0.0, 0.0, 0.8]), np.diag([1.0, -1.0, -1.0])) @ first.inverse
    aside = Pose(np.array([0.8, 0.0, 0.8]), np.eye(3)) @ first.inverse
    both = Pose(np.array([tool.p_m, away.p_m, aside.p_m]), np.array([tool.R, away.R, aside.R]))
    seen = camera.visible(both, 1.0)
    assert seen[0] & 1 and not seen[1] & 1 and not seen[2] & 1
    np.testing.assert_allclose(camera.incidence(both)[:2, 0], [0.0, np.pi], atol=1e-6)
    room = camera.struct.height_px // 2 - 20
    assert not camera.cropped(room).visible(tool, 1.0)[0] & 1
    assert camera.struct.width_px == CAMERA.width_px


def test_kernel_over_the_rotation_angle_is_the_sum_of_its_table():
    flight, angles = library("flight"), np.linspace(0.0, np.pi, 7)
    for h in range(int(KERNEL.n_hyper)):
        w = flight.array(KERNEL.hyper[h].w)[: KERNEL.hyper[h].n_w]
        t = 0.5 * angles[:, None]  # so3: half the rotation angle; U_n(cos t) = sin((n + 1) t) / sin t
        n = np.arange(len(w))
        with np.errstate(invalid="ignore"):
            u = np.where(t > 0, np.sin((n + 1) * t) / np.sin(t), n + 1.0)
        np.testing.assert_allclose(rotation_correlation(KERNEL, h, angles), u @ w / ((n + 1) @ w), atol=1e-10)


def test_a_spectral_table_has_no_more_than_flight_holds():
    assert len(spectral_table("so3", 0.4, 1.5).w) <= library("flight").lib.KC_SPECTRUM_MAX
