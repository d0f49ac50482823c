"""kincal.rotations against the definitions and against flight's own code."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kincal import rotations
from kincal.flight import library
from kincal.rotations import Pose

RNG = np.random.default_rng(4)
TURNS = Rotation.random(200, random_state=RNG)


def test_quaternions_have_w_first_and_not_negative():
    half = np.sqrt(0.5)
    np.testing.assert_allclose(
        rotations.matrix_of_wxyz([half, 0, 0, half]), [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15
    )
    q = rotations.wxyz_of_matrix(TURNS.as_matrix())
    assert q.shape == (200, 4) and (q[:, 0] >= 0).all()
    np.testing.assert_allclose(rotations.matrix_of_wxyz(q), TURNS.as_matrix(), atol=1e-14)


def test_quaternions_are_those_of_flight():
    flight = library("flight")
    for R in [*TURNS.as_matrix()[:50], np.diag([1.0, -1.0, -1.0]), np.diag([-1.0, 1.0, -1.0])]:
        q = np.empty(4)
        flight.lib.kc_R_to_quat(flight.pointer(np.ascontiguousarray(R)), flight.pointer(q))
        np.testing.assert_allclose(rotations.wxyz_of_matrix(R), q, atol=1e-14)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 1.0, np.pi - 1e-6, np.pi])
def test_angles_keep_their_digits(angle):
    R = Rotation.from_rotvec(np.array([0.6, 0.0, 0.8]) * angle).as_matrix()
    assert rotations.angle_of_matrix(R) == pytest.approx(angle, rel=1e-7, abs=1e-15)
    assert np.linalg.norm(rotations.rotvec_of_matrix(R)) == pytest.approx(angle, rel=1e-7, abs=1e-15)


def test_poses_multiply_like_matrices():
    a, b = (Pose(RNG.normal(size=(5, 3)), Rotation.random(5, random_state=RNG).as_matrix()) for _ in "ab")
    np.testing.assert_allclose((a @ b).matrix, a.matrix @ b.matrix, atol=1e-14)
    np.testing.assert_allclose((a.inverse @ a).matrix, np.tile(np.eye(4), (5, 1, 1)), atol=1e-14)
    np.testing.assert_allclose(a[2].apply([1.0, 2.0, 3.0]), (a.matrix[2] @ [1, 2, 3, 1])[:3], atol=1e-14)
    np.testing.assert_allclose(Pose.of_matrix(a.matrix).matrix, a.matrix)
    np.testing.assert_allclose(Pose.of_wxyz(a.p_m, a.quat_wxyz).matrix, a.matrix, atol=1e-14)


def test_pose_difference_is_flights_residual():
    flight = library("flight")
    a, b = (Pose(RNG.normal(size=(9, 3)), Rotation.random(9, random_state=RNG).as_matrix()) for _ in "ab")
    want = np.empty((9, 6))
    for i in range(9):
        c = [
            flight.set_fields(flight.new("kc_pose_t"), {"p_m": p.p_m[i], "R": p.R[i].ravel()}) for p in (a, b)
        ]
        flight.lib.kc_pose_residual(*c, flight.pointer(want[i]))
    np.testing.assert_allclose(rotations.pose_difference(a, b), want, atol=1e-12)


def test_nearest_rotation_undoes_a_stretch():
    R = TURNS[0].as_matrix()
    stretch = np.eye(3) + 0.05 * np.array([[2, 1, 0], [1, -1, 1], [0, 1, 1]])
    np.testing.assert_allclose(rotations.nearest_rotation(R @ stretch), R, atol=1e-12)
    assert np.linalg.det(rotations.nearest_rotation(-R)) == pytest.approx(1.0)


def test_rigid_fit_finds_the_motion():
    pose = Pose(np.array([0.3, -0.2, 1.0]), TURNS[1].as_matrix())
    points = RNG.normal(size=(12, 3))
    found = rotations.rigid_fit(points, pose.apply(points))
    np.testing.assert_allclose(found.matrix, pose.matrix, atol=1e-12)
    with pytest.raises(ValueError, match="2 points"):
        rotations.rigid_fit(points[:2], points[:2])
