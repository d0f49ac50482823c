"""Consider parameters of the flight core against dense generalised least squares over all poses at once.

The chain of frames is numpy's here: each error's column is a central difference of the tool pose that the
camera would show. No flight kinematics in here."""

from functools import cache, cached_property

import numpy as np
import pytest
from builders import c_pose, ffi, fill, lib, view
from calibration import SIGMA, Flight, N, chain_poses, jacobian, joints, residual
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from kincal.rotations import Pose

N_CHAIN = 24
MAST, CAMERA = np.array([-0.35, 0.45, 1.25]), np.array([0.05, 0.0, 0.03])
MOUNT = Rotation.from_quat([0.5, -0.5, 0.5, -0.5], scalar_first=True)
SIGMAS = {
    "mast_sigma_m": 1e-3,
    "mast_sigma_rad": 1.5e-3,
    "zero_sigma_rad": 2e-3,
    "axis_sigma_rad": 1e-3,
    "tag_size_sigma": 2e-3,
    "plate_sigma_m": 7e-4,
    "plate_sigma_rad": 1.2e-3,
    "drift_sigma_m_s": 4e-6,
    "drift_sigma_rad_s": 3e-6,
}


def camera_table(**changes):
    """kc_camera_t of the mast above."""
    cam = ffi.new("kc_camera_t *")
    quat = {"mast_quat_wxyz": [1.0, 0.0, 0.0, 0.0], "pantilt_quat_wxyz": [0.5, -0.5, 0.5, -0.5]}
    return fill(cam, {"mast_xyz_m": MAST, "pantilt_xyz_m": CAMERA, **quat, **SIGMAS, **changes})


def camera_pose(pan, tilt, c, since_s):
    """Rotation and place of a camera whose chain is off by c (24 numbers in units of their own)."""
    drift, mast, zero, axis = c[7:13], c[13:19], c[19:21], c[21:24]
    turn = Rotation.from_rotvec
    R = turn(mast[3:] + since_s * drift[3:])
    R = R * turn([0, 0, pan + zero[0]]) * turn([axis[0], 0, 0]) * turn([0, tilt + zero[1], 0])
    R = R * turn([axis[1], 0, 0]) * turn([0, 0, axis[2]])
    return R * MOUNT, MAST + mast[:3] + since_s * drift[:3] + R.apply(CAMERA)


def seen(R, p, pan, tilt, since_s, c):
    """Tool pose in the base frame when the chain is off by c and the detection is that of an exact one."""
    R_n, p_n = camera_pose(pan, tilt, np.zeros(N_CHAIN), 0.0)
    R_c, p_c = camera_pose(pan, tilt, c, since_s)
    R, p = R * Rotation.from_rotvec(c[3:6]), p + R.apply(c[:3])
    R, p = R_n.inv() * R, (1.0 + c[6]) * R_n.inv().apply(p - p_n)
    return R_c * R, p_c + R_c.apply(p)


def stated():
    s = SIGMAS
    six = [
        ([s["plate_sigma_m"]] * 3, [s["plate_sigma_rad"]] * 3, [s["tag_size_sigma"]]),
        ([s["drift_sigma_m_s"]] * 3, [s["drift_sigma_rad_s"]] * 3),
        ([s["mast_sigma_m"]] * 3, [s["mast_sigma_rad"]] * 3),
        ([s["zero_sigma_rad"]] * 2, [s["axis_sigma_rad"]] * 3),
    ]
    return np.concatenate([x for group in six for x in group])


def columns(R, p, pan, tilt, since_s, h=1e-5):
    """(6, 24): motion of the pose that is seen for 1 sigma of each error, by central differences."""
    out = []
    for k, sigma in enumerate(stated()):
        e = np.zeros(N_CHAIN)
        e[k] = h
        (R1, p1), (R0, p0) = seen(R, p, pan, tilt, since_s, e), seen(R, p, pan, tilt, since_s, -e)
        out.append(sigma * np.concatenate([p1 - p0, (R1 * R0.inv()).as_rotvec()]) / (2 * h))
    return np.array(out).T


class Case:
    """A calibration of 20 poses with a hidden chain error, dense and by flight."""

    def __init__(self, seed, hidden_sigmas=1.0, camera=None, n=20):
        rng = self.rng = np.random.default_rng(seed)
        self.q = joints(rng, n)
        self.x = rng.normal(0, 0.01, N)
        self.pan, self.tilt = rng.uniform(-1, 1, n), rng.uniform(0, 0.8, n)
        self.since_s = np.sort(rng.uniform(0, 400, n))
        self.since_s -= self.since_s[0]
        self.c = hidden_sigmas * rng.normal(size=N_CHAIN)
        R, p = chain_poses(self.q, self.x)
        self.R, self.p = np.empty_like(R), np.empty_like(p)
        noise = rng.normal(0, SIGMA, (n, 6))
        for i in range(n):
            off = self.c * stated()
            Ri, pi = seen(Rotation.from_matrix(R[i]), p[i], self.pan[i], self.tilt[i], self.since_s[i], off)
            self.R[i] = (Rotation.from_rotvec(noise[i, 3:]) * Ri).as_matrix()
            self.p[i] = pi + noise[i, :3]
        self.flight = Flight().observe(self.q, self.R, self.p)
        for i in range(n):
            ctx = self.flight.est.obs[i].ctx
            ctx.pan_rad, ctx.tilt_rad, ctx.t_s = self.pan[i], self.tilt[i], 1000.0 + self.since_s[i]
        assert self.flight.solve() == lib.KC_OK
        self.camera = camera or camera_table()
        self.r = residual(self.flight.x, self.q, self.R, self.p)
        self.r0 = residual(np.zeros(N), self.q, self.R, self.p)
        self.consider = self.by_flight()

    @cached_property
    def J(self):
        return -jacobian(self.flight.x, self.q, self.R, self.p)

    @cached_property
    def H(self):
        return np.vstack([self.column(i) / SIGMA[:, None] for i in range(len(self.q))])

    def column(self, i):
        return columns(Rotation.from_matrix(self.R[i]), self.p[i], self.pan[i], self.tilt[i], self.since_s[i])

    def evaluated(self, i):
        """kc_eval_t at observation i, residual included."""
        est, obs = self.flight.est, self.flight.est.obs[i]
        ev, loads, r = ffi.new("kc_eval_t *"), ffi.new("kc_loads_t *"), ffi.new("double[6]")
        at = ffi.addressof(obs)
        lib.kc_model_loads(est.arm, est.terms, est.coef, ffi.addressof(obs.ctx), loads)
        lib.kc_model_residual(est.arm, est.terms, est.coef, at, loads, r, ev)
        return ev, at

    def by_flight(self):
        con, est = ffi.new("kc_consider_t *"), self.flight.est
        lib.kc_consider_begin(con)
        for i in range(len(self.q)):
            ev, _ = self.evaluated(i)
            H = ffi.new("double[24][6]")
            tool = c_pose(Pose(self.p[i], self.R[i]))
            lib.kc_camera_chain(self.camera, self.pan[i], self.tilt[i], tool, self.since_s[i], H)
            W = np.diag(1 / SIGMA).ravel().tolist()
            rows = slice(6 * i, 6 * i + 6)
            parts = [ffi.new("double[]", list(map(float, v))) for v in (self.r0[rows], self.r[rows], W)]
            pose = ffi.new("kc_consider_pose_t *", [*parts, ev, H])
            lib.kc_consider_add(con, est, pose)
        lib.kc_consider_end(con, est)
        return con

    def cov(self):
        S = view(self.consider.S).reshape(-1, N_CHAIN)[:N]
        assert lib.kc_consider_cov(self.consider, 3, 7) == pytest.approx(S[3] @ S[7], rel=1e-12)
        return self.flight.cov + S @ S.T


@cache
def fitted(seed):
    """A case that nothing changes."""
    return Case(seed, hidden_sigmas=2.0)


@pytest.mark.parametrize("seed", range(4))
def test_covariance_is_that_of_least_squares_under_correlated_noise(seed):
    """x = (J'J)^-1 J'r, r of covariance I + H H'."""
    case = fitted(seed)
    gain = np.linalg.solve(case.J.T @ case.J, case.J.T)
    want = gain @ (np.eye(len(case.r)) + case.H @ case.H.T) @ gain.T
    scale = np.sqrt(np.diag(want))
    # differences of flight and central differences in the Jacobian are 1e-3 of its entries
    assert np.allclose(case.cov() / np.outer(scale, scale), want / np.outer(scale, scale), atol=5e-3)
    assert np.all(np.diag(want) > 1.1 * np.diag(case.flight.cov))  # the chain matters here


@pytest.mark.parametrize("seed", range(4))
def test_chi_squares_are_those_of_generalised_least_squares(seed):
    case = fitted(seed)
    for n in (13, N_CHAIN):
        H = case.H[:, :n]
        C = np.eye(len(case.r)) + H @ H.T
        before = case.r0 @ np.linalg.solve(C, case.r0)
        L = np.linalg.cholesky(C)
        Jw, rw = np.linalg.solve(L, case.J), np.linalg.solve(L, case.r)
        after = np.sum((rw - Jw @ np.linalg.lstsq(Jw, rw, rcond=None)[0]) ** 2)
        got_before = case.r0 @ case.r0 - lib.kc_consider_explains_before(case.consider, n)
        got_after = case.r @ case.r - lib.kc_consider_explains_after(case.consider, n)
        assert got_before == pytest.approx(before, rel=1e-3)
        assert got_after == pytest.approx(after, rel=1e-3)
        assert after < 0.99 * (case.r @ case.r)


def deleted(case, i):
    """Squared residual of pose i against a generalised least squares fit of all others, in units of its
    covariance there, and the chi-square of that fit. Linear at the estimate."""
    rows = np.arange(len(case.r)) // 6 == i
    H, J, r = case.H, case.J, case.r
    C = np.eye(len(r)) + H @ H.T
    inverse = np.linalg.inv(C[np.ix_(~rows, ~rows)])
    P = np.linalg.inv(J[~rows].T @ inverse @ J[~rows])
    x = P @ J[~rows].T @ inverse @ r[~rows]
    left = r[~rows] - J[~rows] @ x
    gain = C[np.ix_(rows, ~rows)] @ inverse
    J_i = J[rows] - gain @ J[~rows]
    off = r[rows] - J[rows] @ x - gain @ left
    cov = C[np.ix_(rows, rows)] - gain @ C[np.ix_(~rows, rows)] + J_i @ P @ J_i.T
    return off @ np.linalg.solve(cov, off), left @ inverse @ left


@pytest.mark.parametrize("seed", range(4))
def test_a_residual_that_an_error_of_the_chain_explains_is_no_outlier(seed):
    """Each pose against all others, all errors of the chain estimated with the coefficients."""
    case = Case(40 + seed, hidden_sigmas=2.0)
    est = case.flight.est
    est.opt.outlier_p, est.opt.outlier_max = 1e-300, 1  # tested, none rejected
    assert case.flight.solve() == lib.KC_OK
    exact_camera = est.job.p_worst
    est.camera = case.camera
    assert case.flight.solve() == lib.KC_OK and est.n_outliers == 0 and est.job.n_tested == len(case.q)
    n = len(case.q)
    dof = 6 * n - N - 6
    judged = [deleted(case, i) for i in range(n)]
    p = [chi2.sf(d2 / max(1.0, others / dof), 6) for d2, others in judged]
    assert est.job.worst == np.argmin(p)
    assert np.log(est.job.p_worst) == pytest.approx(np.log(min(p)), rel=0.02)
    assert est.job.p_worst > exact_camera


def test_an_outlier_is_found_beside_errors_of_the_chain():
    """For which good poses are rejected where the camera is taken to be exact."""
    case = Case(7, hidden_sigmas=2.0)
    est = case.flight.est
    est.opt.outlier_p, est.opt.outlier_max = 1e-3, 4
    assert case.flight.solve() == lib.KC_OK and est.n_outliers > 0
    est.camera = case.camera
    assert case.flight.solve() == lib.KC_OK and est.n_outliers == 0
    est.obs[11].p_m[2] += 0.01
    assert case.flight.solve() == lib.KC_OK
    assert est.n_outliers == 1 and est.outlier[11] == 1


@pytest.mark.parametrize("camera_frame", [False, True])
def test_predicted_error_is_that_of_the_joint_posterior(camera_frame):
    """Coefficients and chain in one Bayesian fit; the estimate of the coefficients alone is used in it."""
    case = fitted(3)
    full = np.hstack([case.J, case.H])
    info = full.T @ full + np.diag([0.0] * N + [1.0] * N_CHAIN)
    joint = np.linalg.inv(info)
    mean, C = (joint @ (full.T @ case.r))[N:], joint[N:, N:]
    S = np.linalg.solve(case.J.T @ case.J, case.J.T @ case.H)
    ev, at = case.evaluated(5)
    J = view(ev.J).reshape(-1, 6)[:N].T
    H = case.column(5)
    M = J @ S - (H * (np.arange(N_CHAIN) >= 7) if camera_frame else 0.0)
    var = (M @ mean) ** 2 + np.diag(M @ C @ M.T)
    chain, pos2, rot2 = ffi.new("double[24][6]"), ffi.new("double *"), ffi.new("double *")
    tool = c_pose(Pose(case.p[5], case.R[5]))
    lib.kc_camera_chain(case.camera, case.pan[5], case.tilt[5], tool, case.since_s[5], chain)
    shown = chain if camera_frame else ffi.NULL
    lib.kc_consider_pose(case.consider, case.flight.est, ev, shown, pos2, rot2)
    assert pos2[0] == pytest.approx(var[:3].sum(), rel=1e-2)
    assert rot2[0] == pytest.approx(var[3:].sum(), rel=1e-2)


def test_errors_drawn_from_the_stated_sigmas_are_as_large_as_the_covariance_says():
    """Normalised error squared over 20 arms inside its 99.9 % band; without the chain far outside."""
    with_chain = without = 0.0
    runs = 20
    for seed in range(runs):
        case = Case(100 + seed)
        e = case.flight.x - case.x
        with_chain += e @ np.linalg.solve(case.cov(), e)
        without += e @ np.linalg.solve(case.flight.cov, e)
    low, high = chi2.ppf([0.0005, 0.9995], N * runs)
    assert low < with_chain < high
    assert without > 1.5 * high
