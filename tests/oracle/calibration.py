"""Calibration problems from numbers only: poses of a DH chain with errors, by numpy over all observations at
once, and the same problem handed to the flight estimator. No flight kinematics in here."""

import numpy as np
from builders import arm_from, dh_terms, ffi, fill, lib, view
from chains import WAM_DH, WAM_LIMITS
from scipy.spatial.transform import Rotation

from kincal.flight import check

N = 28
SIGMA = np.array([0.5e-3] * 3 + [np.deg2rad(0.2)] * 3)
SCALE = np.tile([0.1, 0.1, 0.05, 0.05], 7)
BOUND = np.tile([1.5, 0.6, 0.05, 0.2], 7)
PAPER = np.zeros(N)
PAPER[[24, 5, 10, 11]] = 1.3, 0.4, 0.01, 0.15


def chain_poses(q, x):
    """Rotation matrices and positions of the WAM with DH errors x at joint rows q; no base or tool frame."""
    dh = WAM_DH + np.reshape(x, (7, 4))
    R, p = np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3))
    for (phi, alpha, a, d), qi in zip(dh, np.asarray(q).T, strict=True):
        turn = Rotation.from_rotvec(np.outer(phi + qi, [0, 0, 1])).as_matrix()
        p = p + R @ np.array([0, 0, d]) + (R @ turn) @ np.array([a, 0, 0])
        R = R @ turn @ Rotation.from_rotvec([alpha, 0, 0]).as_matrix()
    return R, p


def joints(rng, n):
    return rng.uniform(*WAM_LIMITS.T, (n, 7))


def observations(rng, q, x, noise=1.0):
    """Measured rotations and positions of the arm with errors x."""
    R, p = chain_poses(q, x)
    turned = Rotation.from_rotvec(noise * rng.normal(0, SIGMA[3:], (len(q), 3))).as_matrix() @ R
    return turned, p + noise * rng.normal(0, SIGMA[:3], (len(q), 3))


def residual(x, q, R, p, rows=6):
    """Whitened residuals, row by row."""
    Rm, pm = chain_poses(q, x)
    r = np.hstack([p - pm, Rotation.from_matrix(R @ Rm.transpose(0, 2, 1)).as_rotvec()]) / SIGMA
    return r[:, :rows].ravel()


def jacobian(x, q, R, p, rows=6, h=1e-6):
    """d residual / d x by central differences."""
    columns = []
    for e in np.eye(N):
        columns.append((residual(x + h * e, q, R, p, rows) - residual(x - h * e, q, R, p, rows)) / (2 * h))
    return np.array(columns).T


def wam_tables(bound=BOUND):
    """Flight tables of the bare WAM with its 28 DH errors."""
    rows = [
        {"alpha_rad": al, "a_m": a, "d_m": d, "phi_rad": phi, "q_min": lo, "q_max": hi}
        for (phi, al, a, d), (lo, hi) in zip(WAM_DH, WAM_LIMITS, strict=True)
    ]
    terms = dh_terms(7)
    for c in range(N):
        terms.coef[c].lb, terms.coef[c].ub, terms.coef[c].scale = -bound[c], bound[c], SCALE[c]
    return arm_from(rows), terms


class Flight:
    """The flight estimator on one problem."""

    def __init__(self, arm=None, terms=None):
        tables = wam_tables()
        self.arm, self.terms = arm or tables[0], terms or tables[1]
        self.est = ffi.new("kc_est_t *")
        self.est.arm, self.est.terms = self.arm, self.terms
        options = {"free_mask": 2**64 - 1, "iter_max": 60, "tol_step": 1e-9, "rank_tol": 1e-4}
        fill(self.est.opt, options)

    def observe(self, q, R, p, rows=6):
        self.est.n_obs = 0
        obs = ffi.new("kc_obs_t *")
        cov = np.diag(SIGMA**2).ravel().tolist()
        for qi, Ri, pi in zip(q, R, p, strict=True):
            quat = Rotation.from_matrix(Ri).as_quat(scalar_first=True).tolist()
            obs.ctx.q[0:7], obs.ctx.g_m_s2 = qi.tolist(), [0.0, 0.0, -9.81]
            obs.p_m, obs.q_wxyz, obs.cov, obs.has_rot = pi.tolist(), quat, cov, int(rows == 6)
            check(lib.kc_est_add(self.est, obs), "observation")
        return self

    def solve(self):
        return lib.kc_est_solve(self.est)

    @property
    def x(self):
        return view(self.est.coef)[: self.terms.n_coef].copy()

    @property
    def sigma(self):
        return view(self.est.sigma)[: self.terms.n_coef].copy()

    @property
    def cov(self):
        n = self.terms.n_coef
        return view(self.est.cov).reshape(64, 64)[:n, :n].copy()

    @property
    def status(self):
        return np.array(list(self.est.status[0 : self.terms.n_coef]))

    @property
    def confounded(self):
        """Row c: which coefficients share a null direction with c."""
        n = self.terms.n_coef
        return np.array([[(int(self.est.confounded[c]) >> k) & 1 for k in range(n)] for c in range(n)], bool)
