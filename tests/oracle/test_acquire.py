"""The flight's choices against brute force in numpy."""

import numpy as np
import pytest
from builders import ffi, fill, lib
from calibration import PAPER, SCALE, SIGMA, Flight, chain_poses, joints, observations
from scipy.spatial.transform import Rotation

from kincal.flight import check

LEN_M = 0.3
N_CAND = 60


def pose_jacobian(x, q, h=1e-6):
    """d (position, rotation) of each pose / d DH errors, (poses, 6, 28), by central differences."""
    columns = []
    for e in np.eye(28):
        Ra, pa = chain_poses(q, x - h * e)
        Rb, pb = chain_poses(q, x + h * e)
        turn = Rotation.from_matrix(Rb @ Ra.transpose(0, 2, 1)).as_rotvec()
        columns.append(np.hstack([pb - pa, turn]) / (2 * h))
    return np.stack(columns, axis=2)


class Site:
    """A calibration of n observations and a set of candidates."""

    def __init__(self, seed, n, rows=6):
        rng = np.random.default_rng(seed)
        self.q = joints(rng, n)
        self.flight = Flight()
        if n:
            self.flight.observe(self.q, *observations(rng, self.q, PAPER), rows=rows)
            assert self.flight.solve() == lib.KC_OK
        self.x = self.flight.x
        self.cand = joints(rng, N_CAND).astype(np.float32)
        self.usable = rng.random(N_CAND) < 0.7
        self.rows = rows
        root = rng.normal(size=(6, 6)) * 0.3 + np.eye(6)
        self.cov = (root @ root.T) * np.outer(SIGMA, SIGMA)

    def choose(self, kind):
        q = np.zeros((N_CAND, 8), np.float32)
        q[:, :7] = self.cand
        usable = ffi.new("uint8_t[]", self.usable.astype(np.uint8).tobytes())
        work, c, value = ffi.new("kc_acq_work_t *"), ffi.new("uint32_t *"), ffi.new("double *")
        cov = ffi.new("double[36]", self.cov.ravel().tolist())
        q_c = ffi.cast("float *", q.ctypes.data)
        status = lib.kc_acq_info(kind, self.flight.est, q_c, N_CAND, usable, cov, LEN_M, work, c, value)
        assert status == lib.KC_OK
        return c[0], value[0]

    def information(self):
        J = pose_jacobian(self.x, self.q)[:, : self.rows] / SIGMA[: self.rows, None] if len(self.q) else []
        return sum((Ji.T @ Ji for Ji in J), np.diag(1 / SCALE**2))


@pytest.mark.parametrize("rows", [6, 3])
@pytest.mark.parametrize("n", [0, 2, 5, 12])
def test_dopt_is_the_largest_gain_of_log_det(n, rows):
    site = Site(10 * n + rows, n, rows)
    M, W = site.information(), np.linalg.inv(site.cov)
    gain = []
    for J in pose_jacobian(site.x, site.cand.astype(float)):
        gain.append(np.linalg.slogdet(M + J.T @ W @ J)[1] - np.linalg.slogdet(M)[1])
    best = int(np.argmax(np.where(site.usable, gain, -np.inf)))
    c, value = site.choose(lib.KC_ACQ_DOPT)
    assert c == best
    assert value == pytest.approx(gain[best], rel=1e-5)


@pytest.mark.parametrize("n", [0, 2, 5, 12])
def test_vopt_is_the_least_mean_predicted_variance(n):
    site = Site(500 + n, n)
    M, W = site.information(), np.linalg.inv(site.cov)
    all_J = pose_jacobian(site.x, site.cand.astype(float))
    unit = np.array([1 / LEN_M] * 3 + [1.0] * 3)[:, None]
    left = []
    for J in all_J:
        C = np.linalg.inv(M + J.T @ W @ J)
        left.append(np.mean([np.trace((unit * Jx) @ C @ (unit * Jx).T) for Jx in all_J]))
    best = int(np.argmin(np.where(site.usable, left, np.inf)))
    c, value = site.choose(lib.KC_ACQ_VOPT)
    assert c == best
    assert value == pytest.approx(left[best], rel=1e-4)


def test_ucb_is_the_largest_bound():
    rng = np.random.default_rng(3)
    kernel = ffi.new("kc_kernel_t *")
    kernel.n_hyper, kernel.sigma_eps = 1, 0.05
    fill(kernel.hyper[0], {"sigma_s": 0.5, "beta_m": 0.4, "kappa": 0.5, "n_w": 3, "w": [0.4, 0, 0.2]})
    quats = Rotation.random(N_CAND, rng=rng).as_quat(scalar_first=True)
    p = rng.uniform(-0.5, 0.5, (N_CAND, 3))
    cand = ffi.new("kc_point_t[]", N_CAND)
    for point, q, x in zip(cand, quats, p, strict=True):
        point.q_wxyz, point.p_m = q.tolist(), x.tolist()

    def k(a, b):
        dot = np.clip(np.abs(quats[a] @ quats[b].T), 0, 1)
        rot = 0.4 + 0.2 * (4 * dot**2 - 1)
        return 0.25 * rot * np.exp(-np.sum((p[a][:, None] - p[b][None]) ** 2, axis=2) / (2 * 0.16))

    gp, c, value = ffi.new("kc_gp_t *"), ffi.new("uint32_t *"), ffi.new("double *")
    check(lib.kc_gp_init(gp, kernel, 0, cand, N_CAND), "init")
    measured, y, usable = [], [], np.ones(N_CAND, np.uint8)
    everything = np.arange(N_CAND)
    for step in range(1, 25):
        beta = lib.kc_acq_beta(N_CAND, step, 0.2)
        assert beta == pytest.approx(0.2 * 2 * np.log(N_CAND * step**2 * np.pi**2 / 0.6))
        flags = ffi.new("uint8_t[]", usable.tobytes())
        assert lib.kc_acq_ucb(gp, flags, beta, c, value) == lib.KC_OK
        if measured:
            G = np.linalg.inv(k(measured, measured) + 0.05**2 * np.eye(len(measured)))
            cross = k(everything, measured)
            mean, var = cross @ G @ y, 0.25 - np.einsum("ij,jk,ik->i", cross, G, cross)
        else:
            mean, var = np.zeros(N_CAND), np.full(N_CAND, 0.25)
        bound = np.where(usable > 0, mean + np.sqrt(beta * np.maximum(var, 0)), -np.inf)
        assert bound[c[0]] >= bound.max() - 1e-4  # single precision cache
        assert value[0] == pytest.approx(bound[c[0]], abs=1e-4)
        measured.append(c[0])
        y.append(float(-rng.random()))
        usable[c[0]] = 0
        check(lib.kc_gp_add(gp, ffi.addressof(cand[c[0]]), y[-1], cand), "add")
