"""The numpy face of the core against plain numpy."""

from pathlib import Path

import numpy as np
import pytest

from kincal import tables
from kincal.geometry import (
    ArmChain,
    Camera,
    CorrectedArm,
    R_to_quat,
    quat_to_R,
    rotation_angle,
    with_dh_errors,
)

BIN = Path(__file__).resolve().parents[2] / "tables" / "bin"
_, ARM = tables.load(BIN / "arm.tbl")
_, CAMERA = tables.load(BIN / "camera.tbl")
_, TERMS = tables.load(BIN / "terms.tbl")
HALF = np.pi / 2
# a, alpha, d of the arm, typed here a second time
WAM = [
    (0, -HALF, 0),
    (0, HALF, 0),
    (0.045, -HALF, 0.55),
    (-0.045, HALF, 0),
    (0, -HALF, 0.3),
    (0, HALF, 0),
    (0, 0, 0.06),
]


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
    chain = ArmChain(ARM)
    for q in joints:
        frames, tool = wam(q)
        points = chain.points(q)
        assert np.allclose(points[1:-1], [T[:3, 3] for T in frames[:-1]], atol=1e-12)
        assert np.allclose(points[-1], tool[:3, 3], atol=1e-12)
        for (p, R), T in zip(chain.frames(q), frames[:-1], strict=True):
            assert np.allclose(p, T[:3, 3], atol=1e-12)
            assert np.allclose(R, T[:3, :3], atol=1e-12)


def test_corrections_by_terms_and_by_changed_dh_agree_with_the_textbook(joints):
    errors = {"J2.alpha_rad": 0.4, "J7.phi_rad": 1.3, "J3.a_m": 0.01, "J3.d_m": 0.15, "J5.alpha_rad": -0.02}
    textbook = {(2, "alpha"): 0.4, (7, "phi"): 1.3, (3, "a"): 0.01, (3, "d"): 0.15, (5, "alpha"): -0.02}
    model = CorrectedArm(ARM, TERMS)
    coef = [errors.get(name, 0.0) for name in model.names]
    chain = ArmChain(with_dh_errors(ARM, errors))
    for q in joints:
        _, tool = wam(q, textbook)
        for p, R in (model.fk(q, coef), chain.fk(q)):
            assert np.allclose(p, tool[:3, 3], atol=1e-12)
            assert np.allclose(R, tool[:3, :3], atol=1e-12)


def test_held_out_error_is_the_rms_over_poses(joints):
    model = CorrectedArm(ARM, TERMS)
    p, R = zip(*(model.fk(q, np.zeros(model.n_coef)) for q in joints), strict=True)
    shift, turn = np.array([3e-3, 0.0, 4e-3]), quat_to_R([np.cos(0.01), np.sin(0.01), 0, 0])
    held = model.held_out(
        joints, np.array(p) + shift, np.array([r @ turn for r in R]), np.zeros(model.n_coef)
    )
    assert held.n == 20
    assert held.pos_m == pytest.approx(5e-3, rel=1e-9)
    assert held.rot_rad == pytest.approx(0.02, rel=1e-9)


def test_rotation_angle_keeps_its_digits_near_zero_and_works_at_half_turns():
    tiny = 1e-9
    assert rotation_angle(quat_to_R([np.cos(tiny / 2), 0, np.sin(tiny / 2), 0])) == pytest.approx(
        tiny, rel=1e-6
    )
    assert rotation_angle(np.diag([1.0, -1.0, -1.0])) == pytest.approx(np.pi)


def test_quaternion_round_trip_up_to_sign():
    for q in np.random.default_rng(1).normal(size=(20, 4)):
        q = q / np.linalg.norm(q)
        assert abs(R_to_quat(quat_to_R(q)) @ q) == pytest.approx(1.0, abs=1e-12)


def test_aimed_camera_sees_the_point_in_the_image_centre():
    camera = Camera(CAMERA)
    target = np.array([0.6, -0.2, 0.4])
    pan, tilt, inside = camera.aim(target)
    p, R = camera.pose(pan, tilt)
    seen = R.T @ (target - p)
    assert inside
    assert np.allclose(seen[:2] / seen[2], 0.0, atol=1e-9)
    assert seen[2] > 0.5
    eye, corners = camera.frustum(pan, tilt, 1.0)
    assert np.allclose(eye, p)
    # 69 x 42 degrees of view
    half = np.degrees(np.arctan(np.linalg.norm(corners[1] - corners[0]) / 2))
    assert 2 * half == pytest.approx(69.0, abs=0.5)
