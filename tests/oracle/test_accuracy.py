"""The bound of the error over the search space against scipy: a weighted sum of chi-squares, integrated by
Imhof's formula (1961), and the noncentral chi-square of the power."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

from kincal.flight import library

FLIGHT = library("flight")
ffi, lib = FLIGHT.ffi, FLIGHT.lib
COEFS, CHAIN, MAX = 28, lib.KC_CHAIN_COUNT, lib.KC_COEF_MAX


def tail(x: float, weights: np.ndarray, shifts: np.ndarray) -> float:
    """P(sum w_i (z_i + shift_i)^2 > x), by Imhof."""

    def f(u):
        w = weights * u
        angle = 0.5 * np.sum(np.arctan(w) + shifts**2 * w / (1 + w**2)) - 0.5 * x * u
        log = 0.25 * np.sum(np.log1p(w**2)) + 0.5 * np.sum((shifts * w) ** 2 / (1 + w**2))
        return np.sin(angle) / (u * np.exp(log))

    scale = weights.sum()
    return 0.5 + quad(f, 1e-12, 400 / scale, limit=2000)[0] / np.pi


def exact(weights: np.ndarray, shifts: np.ndarray) -> float:
    """Quantile of 0.9 over the mean, as a factor of the RMS."""
    mean = np.sum(weights * (1 + shifts**2))
    return float(np.sqrt(brentq(lambda x: tail(x * mean, weights, shifts) - 0.1, 0.5, 6.0)))


def ours(J: np.ndarray, H: np.ndarray, C: np.ndarray, scale: float, known: np.ndarray) -> float:
    """The same by flight. J (poses, 3, coefs), H (poses, 3, CHAIN), C (coefs, coefs)."""
    est, terms, ev = ffi.new("kc_est_t *"), ffi.new("kc_terms_t *"), ffi.new("kc_eval_t *")
    terms.n_coef, est.terms = COEFS, terms
    cov = np.zeros((MAX, MAX))
    cov[:COEFS, :COEFS] = C
    ffi.memmove(est.cov, cov.tobytes(), cov.nbytes)
    accuracy = ffi.new("kc_accuracy_t *")
    lib.kc_accuracy_begin(accuracy, est)
    for j, h in zip(J, H, strict=True):
        for c in range(COEFS):
            ev.J[c] = [*j[:, c], 0.0, 0.0, 0.0]
        chain = np.vstack([h, np.zeros((3, CHAIN))]).tolist()
        lib.kc_accuracy_add(accuracy, ev, ffi.new("double[6][24]", chain))
    dof = lib.kc_accuracy_dof(accuracy, accuracy.pos, est, scale, known.tolist())
    return lib.kc_accuracy_bound(1.0, dof, 0.9)


@pytest.mark.parametrize("seed", range(12))
def test_the_bound_is_the_quantile_of_the_weighted_chi_squares(seed):
    rng = np.random.default_rng(seed)
    poses, scale = 40, 1.3
    J = rng.normal(size=(poses, 3, COEFS)) * np.exp(rng.normal(size=COEFS))
    A = rng.normal(size=(COEFS, COEFS)) * 1e-3
    C = A @ A.T
    H = rng.normal(size=(poses, 3, CHAIN)) * np.exp(1.5 * rng.normal(size=CHAIN)) * 3e-3 * (seed % 3)
    known = rng.normal(size=CHAIN) * 0.7 * (seed % 3)
    G = np.concatenate([np.einsum("pak,kj->paj", J, np.linalg.cholesky(scale**2 * C)), H], axis=2)
    S = np.einsum("pai,paj->ij", G, G) / poses
    weights, V = np.linalg.eigh(S)
    on = weights > 1e-12 * weights[-1]
    shifts = (V.T @ np.concatenate([np.zeros(COEFS), known]))[on]
    assert ours(J, H, C, scale, known) == pytest.approx(exact(weights[on], shifts), rel=0.03)


@pytest.mark.parametrize("dof", [1, 6, 28, 64])
@pytest.mark.parametrize("ncp", [0.0, 0.5, 20.0, 80.0, 200.0])
def test_power_is_the_noncentral_chi_square(dof, ncp):
    x = lib.kc_chi2_quantile(0.005, dof)
    want = ncx2.sf(x, dof, ncp) if ncp > 0 else 0.005
    assert lib.kc_chi2_noncentral_sf(x, dof, ncp) == pytest.approx(want, rel=1e-6)


def test_a_larger_noncentrality_counts_as_the_largest():
    assert lib.kc_chi2_noncentral_sf(50.0, 28, 1e9) == lib.kc_chi2_noncentral_sf(50.0, 28, 200.0)


@pytest.mark.parametrize("dof", [1.0, 2.5, 7.31, 88.0])
def test_quantiles_of_degrees_that_are_not_whole(dof):
    assert lib.kc_chi2_quantile_real(0.1, dof) == pytest.approx(chi2.isf(0.1, dof), rel=1e-9)
