"""The flight GP against scikit-learn: mean, variance, marginal likelihood, choice of hyperparameters."""

import numpy as np
import pytest
from builders import ffi, fill, lib, pointer
from scipy.spatial.transform import Rotation
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import Kernel

from kincal.flight import check
from kincal.flight.kernel import spectral_table

EPS = 0.05
HYPER = [
    (0.0, 0.3, 0.8, 0.5),
    (0.0, 0.7, 0.25, 1.0),
    (2.5, 0.6, 0.4, 0.3),
    (1.5, 1.4, 1.6, 0.8),
]  # nu kappa beta s


class Poses(Kernel):
    """k of METHOD.md 3 in numpy, sines over the infinite-looking sum; rows are (w, x, y, z, px, py, pz)."""

    def __init__(self, arg="so3", nu=0.0, kappa=0.5, beta_m=0.5, sigma_s=1.0):
        self.arg, self.nu, self.kappa, self.beta_m, self.sigma_s = arg, nu, kappa, beta_m, sigma_s

    def __call__(self, X, Y=None, eval_gradient=False):
        Y = X if Y is None else Y
        w = spectral_table(self.arg, self.kappa, self.nu).w
        n = np.arange(len(w)) + 1.0
        dot = np.clip(np.abs(X[:, :4] @ Y[:, :4].T), 0, 1)
        t = np.arccos(dot) * (1 if self.arg == "so3" else 2)
        t = np.clip(t, 1e-7, np.pi - 1e-7)[..., None]
        d2 = np.sum((X[:, None, 4:] - Y[None, :, 4:]) ** 2, axis=2)
        K = (
            np.sum(w * np.sin(n * t) / np.sin(t), axis=2)
            * np.exp(-d2 / (2 * self.beta_m**2))
            * self.sigma_s**2
        )
        return (K, np.empty((*K.shape, 0))) if eval_gradient else K

    def diag(self, X):
        return np.full(len(X), self.sigma_s**2)

    def is_stationary(self):
        return False


def poses(rng, n):
    quats = Rotation.random(n, rng=rng).as_quat(scalar_first=True)
    return np.hstack([quats, rng.uniform(-0.5, 0.5, (n, 3))])


def points(X):
    out = ffi.new("kc_point_t[]", len(X))
    for point, x in zip(out, X, strict=True):
        point.q_wxyz, point.p_m = x[:4].tolist(), x[4:].tolist()
    return out


def flight_kernel(arg):
    k = ffi.new("kc_kernel_t *")
    k.arg, k.n_hyper, k.sigma_eps = int(arg == "paper"), len(HYPER), EPS
    for h, (nu, kappa, beta_m, sigma_s) in zip(k.hyper, HYPER, strict=False):
        table = spectral_table(arg, kappa, nu)
        fill(h, {"nu": nu, "kappa": kappa, "beta_m": beta_m, "sigma_s": sigma_s})
        fill(h, {"n_w": len(table.w), "w": table.w, "trunc_err": table.trunc_err})
    return k


def flight_gp(kernel, hyper, X, y, cand):
    gp = ffi.new("kc_gp_t *")
    check(lib.kc_gp_init(gp, kernel, hyper, cand, len(cand)), "init")
    for point, value in zip(points(X), y, strict=True):
        check(lib.kc_gp_add(gp, ffi.addressof(point), value, cand), "add")
    return gp


def sklearn_gp(arg, hyper, X, y):
    nu, kappa, beta_m, sigma_s = HYPER[hyper]
    kernel = Poses(arg, nu, kappa, beta_m, sigma_s)
    return GaussianProcessRegressor(kernel, alpha=EPS**2, optimizer=None).fit(X, y)


@pytest.mark.parametrize("arg", ["so3", "paper"])
@pytest.mark.parametrize("hyper", range(len(HYPER)))
def test_posterior_and_marginal_likelihood(arg, hyper):
    rng = np.random.default_rng(hyper)
    X, y, far = poses(rng, 40), rng.normal(size=40), poses(rng, 60)
    kernel, cand = flight_kernel(arg), points(far)
    gp, other = flight_gp(kernel, hyper, X, y, cand), sklearn_gp(arg, hyper, X, y)
    mean, std = other.predict(far, return_std=True)
    m, v = ffi.new("double *"), ffi.new("double *")
    for c in range(len(far)):
        lib.kc_gp_predict(gp, ffi.addressof(cand[c]), m, v)
        assert m[0] == pytest.approx(mean[c], abs=1e-8)
        assert v[0] == pytest.approx(std[c] ** 2, abs=1e-8)
        # the candidate cache is single precision
        assert lib.kc_gp_cand_mean(gp, c) == pytest.approx(mean[c], abs=2e-4)
        assert gp.var[c] == pytest.approx(std[c] ** 2, abs=2e-5)
    want = other.log_marginal_likelihood_value_
    assert lib.kc_gp_log_marginal(gp) == pytest.approx(want, abs=1e-6 * abs(want))


def test_changed_values():
    rng = np.random.default_rng(20)
    X, y, far = poses(rng, 25), rng.normal(size=25), poses(rng, 10)
    kernel, cand = flight_kernel("so3"), points(far)
    gp = flight_gp(kernel, 1, X, np.zeros(25), cand)
    lib.kc_gp_set_y(gp, pointer(y))
    mean = sklearn_gp("so3", 1, X, y).predict(far)
    m, v = ffi.new("double *"), ffi.new("double *")
    for c in range(len(far)):
        lib.kc_gp_predict(gp, ffi.addressof(cand[c]), m, v)
        assert m[0] == pytest.approx(mean[c], abs=1e-9)


@pytest.mark.parametrize("truth", range(len(HYPER)))
def test_choice_is_the_set_of_greatest_marginal_likelihood(truth):
    """Values sampled from one of the sets; the flight GP starts on the next one."""
    rng = np.random.default_rng(30 + truth)
    X, far = poses(rng, 50), poses(rng, 10)
    nu, kappa, beta_m, sigma_s = HYPER[truth]
    K = Poses("so3", nu, kappa, beta_m, sigma_s)(X) + EPS**2 * np.eye(50)
    y = np.linalg.cholesky(K) @ rng.normal(size=50)
    likelihood = [sklearn_gp("so3", h, X, y).log_marginal_likelihood_value_ for h in range(len(HYPER))]
    kernel, cand = flight_kernel("so3"), points(far)
    gp = flight_gp(kernel, (truth + 1) % len(HYPER), X, y, cand)
    best = int(np.argmax(likelihood))
    assert lib.kc_gp_choose(gp, cand) == best == gp.hyper
    mean, std = sklearn_gp("so3", best, X, y).predict(far, return_std=True)
    for c in range(len(far)):  # rebuilt on it
        assert lib.kc_gp_cand_mean(gp, c) == pytest.approx(mean[c], abs=2e-4)
        assert gp.var[c] == pytest.approx(std[c] ** 2, abs=2e-5)
