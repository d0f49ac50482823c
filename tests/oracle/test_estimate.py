"""The flight estimator against scipy, central differences, Monte Carlo and linear algebra."""

import numpy as np
import pytest
from builders import PoseModel, arm_from, basis, lib, term, terms_from
from calibration import (
    BOUND,
    PAPER,
    SCALE,
    SIGMA,
    Flight,
    N,
    chain_poses,
    jacobian,
    joints,
    observations,
    residual,
    wam_tables,
)
from chains import WAM_DH, WAM_LIMITS
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import binom, chi2

lib = lib


def by_scipy(q, R, p, bound=None, rows=6, start=None):
    box = (-np.inf, np.inf) if bound is None else (-bound, bound)
    x0 = np.zeros(N) if start is None else np.clip(start, box[0], box[1])
    method = {"x_scale": SCALE, "xtol": 1e-14, "ftol": 1e-14, "gtol": 1e-12, "max_nfev": 200}
    return least_squares(residual, x0, lambda x, *a: jacobian(x, *a), box, args=(q, R, p, rows), **method)


@pytest.mark.parametrize("seed", range(8))
def test_same_minimum_as_scipy(seed):
    rng = np.random.default_rng(seed)
    q = joints(rng, 20)
    R, p = observations(rng, q, PAPER)
    flight = Flight().observe(q, R, p)
    assert flight.solve() == lib.KC_OK
    other = by_scipy(q, R, p, start=PAPER)
    assert np.max(np.abs(flight.x - other.x) / flight.sigma) < 1e-4
    assert flight.est.cost == pytest.approx(2 * other.cost, rel=1e-9)
    assert flight.est.chi2 == pytest.approx(np.sum(residual(flight.x, q, R, p) ** 2), rel=1e-9)
    assert flight.est.kkt < 1e-6


@pytest.mark.parametrize("seed", range(6))
def test_same_minimum_as_scipy_in_a_box(seed):
    """Bounds so tight that several of the true errors lie outside."""
    rng = np.random.default_rng(100 + seed)
    q = joints(rng, 15)
    bound = np.tile([0.4, 0.1, 0.006, 0.006], 7)
    truth = rng.uniform(-1.3, 1.3, N) * bound
    R, p = observations(rng, q, truth)
    flight = Flight(terms=wam_tables(bound)[1]).observe(q, R, p)
    assert flight.solve() == lib.KC_OK
    other = by_scipy(q, R, p, bound)
    assert np.all(np.abs(flight.x) <= bound)
    assert flight.est.cost <= 2 * other.cost * (1 + 1e-6)
    assert np.allclose(flight.x, other.x, atol=2e-4 * SCALE.max())
    g = jacobian(flight.x, q, R, p).T @ residual(flight.x, q, R, p)  # of half the cost
    at_lower, at_upper = flight.status == 3, flight.status == 4
    assert at_lower.any() and at_upper.any()
    assert np.allclose(flight.x[at_lower], -bound[at_lower]) and np.all(g[at_lower] > 0)
    assert np.allclose(flight.x[at_upper], bound[at_upper]) and np.all(g[at_upper] < 0)
    inside = flight.status == 0
    assert np.max(np.abs(g[inside]) * flight.sigma[inside]) < 1e-2  # far below one sigma of the cost
    assert np.all(flight.sigma[~inside] == 0)


def test_covariance_is_the_inverse_of_the_information():
    rng = np.random.default_rng(3)
    q = joints(rng, 20)
    R, p = observations(rng, q, PAPER)
    flight = Flight().observe(q, R, p)
    flight.solve()
    J = jacobian(flight.x, q, R, p)
    want = np.linalg.inv(J.T @ J)
    unit = np.sqrt(np.diag(want))
    # the estimator's J is that of the model, central differences see the residual's log as well: first order
    assert np.max(np.abs(flight.cov - want) / np.outer(unit, unit)) < 0.02
    R0, p0 = chain_poses(q, flight.x)  # at zero residual both are the same
    J = jacobian(flight.x, q, R0, p0)
    want = np.linalg.inv(J.T @ J)
    assert np.max(np.abs(flight.cov - want) / np.outer(unit, unit)) < 1e-6


def test_the_truth_lies_inside_3_sigma():
    """200 calibrations of 12 poses: whitened errors are chi-square, 3 sigma holds as often as it should."""
    rng = np.random.default_rng(4)
    d2, inside, fit = [], [], []
    flight = Flight()
    for _ in range(200):
        q = joints(rng, 12)
        flight.observe(q, *observations(rng, q, PAPER))
        assert flight.solve() == lib.KC_OK
        e = flight.x - PAPER
        d2.append(e @ np.linalg.solve(flight.cov, e))
        inside.append(np.abs(e) < 3 * flight.sigma)
        fit.append(chi2.sf(flight.est.chi2, flight.est.dof))
    assert 25 < np.mean(d2) < 31  # 28 +- 0.53 if exactly linear
    assert np.mean(inside) > 0.99
    assert 0.4 < np.mean(fit) < 0.6


@pytest.mark.parametrize("n", [8, 12, 20])
def test_converges_from_zero_to_the_papers_errors(n):
    for seed in range(25):
        rng = np.random.default_rng(1000 * n + seed)
        q = joints(rng, n)
        flight = Flight().observe(q, *observations(rng, q, PAPER))
        assert flight.solve() == lib.KC_OK
        assert np.max(np.abs(flight.x - PAPER) / np.maximum(flight.sigma, 1e-12)) < 6


def test_converges_from_zero_to_large_errors_of_any_joint():
    good = 0
    for seed in range(40):
        rng = np.random.default_rng(7000 + seed)
        truth = np.zeros(N)
        for c, size in zip(rng.choice(N, 4, replace=False), (1.0, 0.7, 0.9, 0.5), strict=True):
            truth[c] = size * BOUND[c] * rng.choice([-1, 1])
        q = joints(rng, 15)
        flight = Flight().observe(q, *observations(rng, q, truth))
        good += flight.solve() == lib.KC_OK and np.all(np.abs(flight.x - truth) < 6 * flight.sigma + 1e-6)
    assert good >= 38  # least squares has other minima; nearly all starts are inside the right valley


def test_seven_quaternion_rows_of_the_paper_give_the_same_correction():
    """Nearest-sign quaternion difference, twice, for the rotation vector: equal to first order."""
    rng = np.random.default_rng(5)
    q = joints(rng, 20)
    R, p = observations(rng, q, PAPER)
    quat = Rotation.from_matrix(R).as_quat()

    def seven_rows(x):
        Rm, pm = chain_poses(q, x)
        other = Rotation.from_matrix(Rm).as_quat()
        other *= np.sign(np.sum(quat * other, axis=1, keepdims=True))
        return np.hstack([(p - pm) / SIGMA[0], 2 * (quat - other) / SIGMA[3]]).ravel()

    flight = Flight().observe(q, R, p)
    flight.solve()
    paper = least_squares(seven_rows, flight.x, x_scale=SCALE, xtol=1e-12, ftol=1e-12)
    assert np.max(np.abs(paper.x - flight.x) / flight.sigma) < 0.02


# --------------------------------------------------------------------------- identifiability


def null_space(J, tol=1e-7):
    u, s, vt = np.linalg.svd(J * SCALE)
    return vt[np.sum(s > tol * s[0]) :]


def assert_held_and_named(flight, J):
    """Held ones keep their start, as many as the rank lacks; every null direction lies in a named set."""
    null = null_space(J)
    held = np.flatnonzero(flight.status == lib.KC_COEF_HELD)
    assert len(held) == len(null)
    assert np.all(flight.x[held] == 0) and np.all(flight.sigma[held] == 0)
    assert np.all(flight.cov[held] == 0)
    involved = np.any(np.abs(null) > 1e-6, axis=0)
    named = flight.confounded.any(axis=0) | np.isin(np.arange(N), held)
    assert np.array_equal(named, involved)
    assert np.array_equal(flight.confounded, flight.confounded.T)
    estimated = flight.status == lib.KC_COEF_ESTIMATED
    assert np.linalg.matrix_rank((J * SCALE)[:, estimated]) == estimated.sum()


def test_position_only_determines_24():
    rng = np.random.default_rng(6)
    q = joints(rng, 30)
    truth = PAPER.copy()
    R, p = observations(rng, q, truth)
    flight = Flight().observe(q, R, p, rows=3)
    assert flight.solve() == lib.KC_OK
    assert flight.est.rank == 24 and flight.est.n_free == 28
    assert_held_and_named(flight, jacobian(PAPER, q, R, p, rows=3))
    # held at zero or not, positions elsewhere come out right
    far = joints(rng, 200)
    error = chain_poses(far, flight.x)[1] - chain_poses(far, truth)[1]
    assert np.sqrt(np.mean(np.sum(error**2, axis=1))) < 2e-3


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_too_few_poses(n):
    rng = np.random.default_rng(60 + n)
    q = joints(rng, n)
    R, p = observations(rng, q, 0.1 * PAPER)
    flight = Flight().observe(q, R, p)
    assert flight.solve() == lib.KC_OK
    held = flight.status == lib.KC_COEF_HELD
    assert flight.est.rank <= 6 * n and held.sum() == N - flight.est.rank
    assert np.all(flight.x[held] == 0)
    assert flight.est.fit_pos_m <= flight.est.before_pos_m


def test_masked_joints_are_held_and_what_depends_on_them_is_freed():
    """With the wrist's errors known, position alone determines all others."""
    rng = np.random.default_rng(8)
    q = joints(rng, 30)
    truth = np.where(np.arange(N) < 20, 0.05 * SCALE * rng.normal(size=N), 0.0)
    R, p = observations(rng, q, truth)
    flight = Flight().observe(q, R, p, rows=3)
    flight.est.opt.free_mask = (1 << 20) - 1
    assert flight.solve() == lib.KC_OK
    assert np.all(flight.status[20:] == lib.KC_COEF_MASKED) and np.all(flight.x[20:] == 0)
    J = jacobian(truth, q, R, p, rows=3)[:, :20] * SCALE[:20]
    assert flight.est.rank == np.linalg.matrix_rank(J) == flight.est.n_free == 20
    assert np.max(np.abs(flight.x[:20] - truth[:20]) / flight.sigma[:20]) < 5


def test_dh_with_base_and_tool_frames_has_rank_34_of_40():
    rng = np.random.default_rng(9)
    components = ("tx", "ty", "tz", "rx", "ry", "rz")
    places = [*((j, "rz", j, "tz", j + 1, "tx", j + 1, "rx") for j in range(7))]
    terms, coefs = [], []
    for place in places:
        for frame, comp in zip(place[::2], place[1::2], strict=True):
            terms.append(term(len(coefs), frame, comp))
            coefs.append(
                {"name": f"c{len(coefs)}", "lb": -1, "ub": 1, "scale": 0.1 if comp[0] == "r" else 0.05}
            )
    for frame in (0, lib.KC_FRAME_TOOL):
        for comp in components:
            terms.append(term(len(coefs), frame, comp))
            coefs.append(
                {"name": f"c{len(coefs)}", "lb": -1, "ub": 1, "scale": 0.1 if comp[0] == "r" else 0.05}
            )
    arm = wam_tables()[0]
    q = joints(rng, 40)
    truth = 0.1 * PAPER
    flight = Flight(arm, terms_from(coefs, terms, 7)).observe(q, *observations(rng, q, truth))
    assert flight.solve() == lib.KC_OK
    assert flight.est.n_free == 40 and flight.est.rank == 34
    assert np.sum(flight.status == lib.KC_COEF_HELD) == 6
    assert chi2.sf(flight.est.chi2, flight.est.dof) > 1e-3


def test_gravity_compliance_is_found_with_loads_of_the_corrected_arm():
    """A term that depends on loads: they are those of each step's coefficients."""
    rng = np.random.default_rng(10)
    rows = [
        {"alpha_rad": al, "a_m": a, "d_m": d, "q_min": lo, "q_max": hi, "mass_kg": 2.0, "has_mass": 1}
        for (_, al, a, d), (lo, hi) in zip(WAM_DH, WAM_LIMITS, strict=True)
    ]
    terms = [term(0, 1, "rz", basis(var="tau", index=2)), term(1, 0, "rz")]
    terms += [term(2, 1, "rx")]
    coefs = [{"name": f"c{i}", "lb": -1, "ub": 1, "scale": s} for i, s in enumerate((1e-3, 0.1, 0.1))]
    arm, table = arm_from(rows), terms_from(coefs, terms, 7)
    truth = np.array([3e-3, 0.2, 0.3])
    q = joints(rng, 10)
    poses = [PoseModel(arm, table).eval(qi, truth, want_J=False).T for qi in q]
    flight = Flight(arm, table).observe(q, [T.R for T in poses], [T.p_m for T in poses])
    assert flight.solve() == lib.KC_OK
    assert np.allclose(flight.x, truth, atol=1e-8)


# --------------------------------------------------------------------------- outliers and probabilities


def test_good_poses_are_rejected_no_more_often_than_stated():
    rng = np.random.default_rng(11)
    rejected = 0
    flight = Flight()
    flight.est.opt.outlier_p, flight.est.opt.outlier_max = 0.05, 1
    for _ in range(300):
        q = joints(rng, 14)
        flight.observe(q, *observations(rng, q, 0.1 * PAPER))
        flight.solve()
        rejected += flight.est.n_outliers
    assert rejected <= binom.ppf(0.999, 300, 0.05)
    assert rejected >= binom.ppf(0.001, 300, 0.05 / 4)  # nor is it asleep (noise below 1 counts as 1)


def test_wrong_poses_are_found():
    rng = np.random.default_rng(12)
    flight = Flight()
    flight.est.opt.outlier_p, flight.est.opt.outlier_max = 0.001, 4
    for _ in range(40):
        q = joints(rng, 20)
        R, p = observations(rng, q, PAPER)
        wrong = rng.choice(20, 2, replace=False)
        u = rng.normal(size=(2, 3))
        p[wrong] += u / np.linalg.norm(u, axis=1, keepdims=True) * rng.uniform(0.015, 0.1, (2, 1))
        flight.observe(q, R, p)
        assert flight.solve() == lib.KC_OK
        found = np.flatnonzero(list(flight.est.outlier[0:20]))
        assert set(wrong) <= set(found)


def test_chi_square_tail_over_its_whole_range():
    for dof in (1, 2, 3, 6, 7, 30, 100, 299, 384):
        for x in np.concatenate([np.geomspace(1e-6, 20, 40), dof * np.linspace(0.1, 6, 60)]):
            want, got = chi2.sf(x, dof), lib.kc_chi2_sf(float(x), dof)
            assert got == pytest.approx(want, rel=1e-9, abs=1e-14), (x, dof)
