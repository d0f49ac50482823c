"""Rotations of the flight core against scipy and mpmath; half turns exactly; the paper's seven-row
residual against ours."""

import itertools

import chains
import mpmath
import numpy as np
import pytest
from builders import (
    PoseModel,
    R_exp,
    R_from_quat,
    R_log,
    dh_terms,
    pose_residual,
    quat_dist_rad,
    quat_from_R,
    quat_mul,
)
from scipy.spatial.transform import Rotation
from test_kinematics import flight_arm

from kincal.rotations import Pose


def random_quats(n, seed=0):
    return Rotation.random(n, random_state=np.random.default_rng(seed)).as_quat(scalar_first=True)


def same_rotation(q1, q2, atol=1e-14):
    return np.allclose(q1, q2, atol=atol, rtol=0) or np.allclose(q1, -np.asarray(q2), atol=atol, rtol=0)


def test_matrix_to_quaternion_agrees_with_scipy():
    for q in random_quats(500):
        R = Rotation.from_quat(q, scalar_first=True).as_matrix()
        got = quat_from_R(R)
        assert same_rotation(got, q)
        assert got[0] >= 0
        np.testing.assert_allclose(R_from_quat(q), R, atol=1e-15)


HALF_TURN_AXES = [a for a in itertools.product((-1, 0, 1), repeat=3) if any(a)] + [
    (3, -4, 0),
    (1, 2, -2),
    (0, -3, 4),
]


@pytest.mark.parametrize("axis", HALF_TURN_AXES, ids=str)
def test_half_turns_are_exact(axis):
    """R = 2 a a' - 1 (the case R = diag(1,-1,-1) of the method page and all others)."""
    a = np.array(axis) / np.linalg.norm(axis)
    R = 2 * np.outer(a, a) - np.eye(3)
    q = quat_from_R(R)
    assert q[0] == pytest.approx(0.0, abs=1e-16)
    assert np.linalg.norm(q) == pytest.approx(1.0, abs=1e-15)
    assert same_rotation(q[1:], a, atol=2e-16 * 4)
    assert q[np.flatnonzero(np.abs(q) > 1e-15)[0]] > 0  # one sign a rotation
    assert np.linalg.norm(R_log(R)) == pytest.approx(np.pi, abs=1e-15)
    assert quat_dist_rad([1, 0, 0, 0], q) == pytest.approx(np.pi, abs=1e-15)


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1)], ids=str)
def test_half_turns_about_the_axes_have_exact_bits(axis):
    q = quat_from_R(np.diag(2.0 * np.array(axis) - 1.0))
    assert q.tolist() == [0.0, *map(float, axis)]
    assert not np.signbit(q).any()


def test_near_half_turns_keep_their_digits():
    for eps in (1e-3, 1e-6, 1e-9, 1e-12, 1e-15):
        for axis in HALF_TURN_AXES:
            a = np.array(axis) / np.linalg.norm(axis)
            R = Rotation.from_rotvec((np.pi - eps) * a).as_matrix()
            w = R_log(R)
            assert np.linalg.norm(w) <= np.pi + 1e-15
            np.testing.assert_allclose(Rotation.from_rotvec(w).as_matrix(), R, atol=4e-15)


def exact_exp(w):
    """Rodrigues in 40 digits."""
    with mpmath.workdps(40):
        x, y, z = (mpmath.mpf(float(v)) for v in w)
        t = mpmath.sqrt(x * x + y * y + z * z)
        K = mpmath.matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        a, b = (mpmath.sin(t) / t, (1 - mpmath.cos(t)) / t**2) if t else (mpmath.mpf(1), mpmath.mpf(1) / 2)
        return np.array((mpmath.eye(3) + a * K + b * K * K).tolist(), dtype=float)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-9, 1.9e-4, 2.1e-4, 1e-3, 0.5, 2.0, 3.0, 3.14159])
def test_exp_and_log_at_every_size(angle):
    for v in np.random.default_rng(3).normal(size=(20, 3)):
        w = angle * v / np.linalg.norm(v)
        R = R_exp(w)
        np.testing.assert_allclose(R, exact_exp(w), atol=5e-16 * (1 + angle))
        np.testing.assert_allclose(R_log(R), w, rtol=0, atol=4e-15)


def test_angle_between_quaternions():
    """Right from 1e-12 rad (where acos would say 0 or 1e-8) to pi, blind to either sign."""
    base = random_quats(1, 5)[0]
    for angle in (0.0, 1e-12, 1e-9, 1e-4, 0.3, 1.0, np.pi / 2, 3.0, np.pi):
        for v in np.random.default_rng(6).normal(size=(10, 3)):
            turn = np.r_[np.cos(angle / 2), np.sin(angle / 2) * v / np.linalg.norm(v)]
            other = quat_mul(base, turn)
            for s1, s2 in itertools.product((1, -1), repeat=2):
                assert quat_dist_rad(s1 * base, s2 * other) == pytest.approx(angle, rel=1e-3, abs=1e-15)


def test_product_agrees_with_scipy():
    for a, b in zip(random_quats(100, 7), random_quats(100, 8), strict=True):
        want = (
            Rotation.from_quat(a, scalar_first=True) * Rotation.from_quat(b, scalar_first=True)
        ).as_matrix()
        np.testing.assert_allclose(R_from_quat(quat_mul(a, b)), want, atol=1e-15)


def test_pose_residual_agrees_with_scipy():
    rng = np.random.default_rng(9)
    for a, b in zip(random_quats(100, 10), random_quats(100, 11), strict=True):
        A, B = (Pose(rng.normal(size=3), R_from_quat(q)) for q in (a, b))
        want = Rotation.from_matrix(A.R @ B.R.T).as_rotvec()
        np.testing.assert_allclose(pose_residual(A, B), np.r_[A.p_m - B.p_m, want], atol=1e-12)


# --------------------------------------------------------------------------- the paper's residual


def seven_rows(meas, model):
    """(p - p; q_meas - q_model with the nearer sign)."""
    q1, q2 = (Rotation.from_matrix(T.R).as_quat(scalar_first=True) for T in (meas, model))
    return np.r_[meas.p_m - model.p_m, (q1 if q1 @ q2 > 0 else -q1) - q2]


def seven_row_jacobian(T, J):
    """dq = 1/2 (0, dtheta) q for a turn dtheta in the base frame."""
    w, x, y, z = Rotation.from_matrix(T.R).as_quat(scalar_first=True)
    half = 0.5 * np.array([[-x, -y, -z], [w, z, -y], [-z, w, x], [y, -x, w]])
    return np.vstack([J[:, :3].T, half @ J[:, 3:].T])


def corrections(size, seed=12):
    """Gauss-Newton step from nominal by six rows and by the paper's seven, for errors and noise of a size."""
    rng = np.random.default_rng(seed)
    arm = chains.wam()
    model = PoseModel(flight_arm(arm), dh_terms(7))
    truth = size * rng.normal(size=28)
    six, seven = [], []
    for _ in range(20):
        q = rng.uniform(*chains.WAM_LIMITS.T)
        nominal, true = model.eval(q), model.eval(q, truth, want_J=False).T
        meas = Pose(true.p_m + size * rng.normal(size=3), true.R @ R_exp(size * rng.normal(size=3)))
        six.append((pose_residual(meas, nominal.T), nominal.J.T))
        # A quaternion changes by half the angle: twice the weight makes the rows equal.
        weight = np.r_[np.ones(3), 2 * np.ones(4)]
        seven.append(
            (weight * seven_rows(meas, nominal.T), weight[:, None] * seven_row_jacobian(nominal.T, nominal.J))
        )
    return [
        np.linalg.lstsq(np.vstack([J for _, J in rows]), np.hstack([r for r, _ in rows]), rcond=None)[0]
        for rows in (six, seven)
    ]


def test_the_papers_quaternion_residual_gives_the_same_correction_to_first_order():
    gaps = []
    for size in (1e-2, 1e-3, 1e-4):
        six, seven = corrections(size)
        assert np.linalg.norm(six) > 0.5 * size
        gaps.append(np.linalg.norm(six - seven) / np.linalg.norm(six))
    assert gaps[0] < 1e-2
    # The angle of a quaternion difference is off by its cube, so the relative gap falls as size^2.
    assert gaps[1] < gaps[0] / 50
    assert gaps[2] < gaps[1] / 50
