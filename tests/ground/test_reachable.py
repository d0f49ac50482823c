"""What a black box reaches: its process against scikit-learn and scipy, its answer on arms with and without
something to find."""

from dataclasses import replace

import numpy as np
import poses
import pytest
from places import DATA
from scipy import optimize, stats
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel

from kincal import workbench as wb
from kincal.workbench.prediction.additive_gp import Components, Place, Variances


def scalar(x, y, columns, length):
    """A process of one component a pose: one low-rank component, one dense one; no nuisance."""
    kernel = np.exp(-0.5 * (x[:, None] - x[None]) ** 2 / length**2)
    n, p = columns.shape
    place = Place(np.ones((n, 1)), columns, np.zeros(p, int), kernel[None])
    return Components(1, y, np.zeros((n, 0)), (place,), ("low", "dense"))


@pytest.fixture
def drawn():
    """x, y, columns: y drawn from a low-rank component, a smooth one and noise."""
    rng = np.random.default_rng(3)
    x = np.sort(rng.uniform(0.0, 10.0, 150))
    columns = rng.normal(size=(150, 4))
    smooth = 1.5 * np.sin(x) + 0.7 * np.cos(2.3 * x)
    return x, columns @ [1.0, -0.5, 0.8, 0.3] + smooth + rng.normal(0.0, 0.3, 150), columns


def test_prediction_is_that_of_scikit_learn(drawn):
    """Dense component alone, given variances."""
    x, y, columns = drawn
    process = scalar(x, y, columns, 0.8)
    seen, unseen = np.arange(0, 150, 2), np.arange(1, 150, 2)
    fitted = process.fit(seen, Variances(np.array([0.0, 1.7]), 0.09))
    oracle = GaussianProcessRegressor(ConstantKernel(1.7) * RBF(0.8), alpha=0.09, optimizer=None)
    oracle.fit(x[seen, None], y[seen])
    assert process.predict(fitted, unseen) == pytest.approx(oracle.predict(x[unseen, None]), abs=1e-9)


def test_variances_are_those_of_greatest_likelihood(drawn):
    """Against scipy's density and a search without derivatives."""
    x, y, columns = drawn
    process = scalar(x, y, columns, 0.8)
    kernel = process.places[0].kernels[0]

    def minus_ln_likelihood(ln_v):
        low, dense, noise = np.exp(ln_v)
        cov = low * columns @ columns.T + dense * kernel + noise * np.eye(len(x))
        return -stats.multivariate_normal(np.zeros(len(x)), cov).logpdf(y)

    found = process.fit(np.arange(150)).variances
    ours = minus_ln_likelihood(np.log([*found.component, found.noise]))
    best = optimize.minimize(minus_ln_likelihood, np.zeros(3), method="Nelder-Mead", options={"maxiter": 600})
    assert ours < best.fun + 0.5


def test_vector_components_share_one_function(drawn):
    """Two components a pose that see one error with different gains: the covariance is rows rows' times the
    kernels, written out component by component."""
    x, _, columns = drawn
    gains = np.random.default_rng(1).normal(size=(150, 2))
    kernel = np.exp(-0.5 * (x[:, None] - x[None]) ** 2)
    place = Place(gains.reshape(-1, 1), columns, np.zeros(4, int), kernel[None])
    process = Components(2, np.zeros(300), np.zeros((300, 0)), (place,), ("low", "dense"))
    got = process.between(np.array([3, 7]), np.array([5])).covariance(np.array([0.5, 2.0]))
    sums = 0.5 * columns @ columns.T + 2.0 * kernel
    want = [[gains[i, a] * gains[5, b] * sums[i, 5] for b in range(2)] for a in range(2) for i in (3, 7)]
    assert got == pytest.approx(np.array(want))


# ------------------------------------------------------------------------------------------- on arms


def measured(tmp_path, true_q=None, n=120, seed=5):
    arm = wb.read_arm(poses.arm_toml(tmp_path / "arm.toml", masses=False))
    path = poses.poses_csv(tmp_path / "poses.csv", n, seed, true_q, position_only=True, noise_size=0.3)
    return arm, wb.read_csv(path, 7)


def test_a_hidden_error_is_reachable_down_to_the_noise(tmp_path):
    """5 mrad of a smooth function of two joint angles at joint 4, 0.6 mm of noise."""

    def true_q(q, _direction):
        out = q.copy()
        out[3] += 5e-3 * np.sin(q[1]) * np.cos(q[3])
        return out

    c = wb.compare(*measured(tmp_path, true_q))
    noise = 0.3 * float(np.linalg.norm(poses.SIGMA[:3]))
    assert c.rms["held"][0] > 2.0 * noise
    assert c.reachable.pos_m < 0.75 * c.rms["held"][0]
    assert c.reachable.shrink > 0.5
    assert c.reachable.parts


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_without_an_error_nothing_is_reachable(tmp_path, seed):
    c = wb.compare(*measured(tmp_path, seed=seed))
    assert 0.97 * c.rms["held"][0] <= c.reachable.pos_m <= c.rms["held"][0]


def test_too_few_poses_are_said(tmp_path):
    c = wb.compare(*measured(tmp_path, n=24))
    assert not c.reachable.enough
    assert c.reachable.pos_m == c.rms["held"][0]


def test_nothing_is_reachable_without_held_out_poses(tmp_path):
    arm, data = measured(tmp_path, n=40)
    assert wb.compare(arm, replace(data, split=np.full(40, "fit"))).reachable is None


def real_set(folder, name, most=None):
    arm = wb.read_arm(DATA / folder / f"{folder}.toml")
    data = wb.read_measurements(DATA / folder / f"{name}.csv", arm)
    return arm, data if most is None else data.take(np.arange(most))


@pytest.mark.parametrize(
    ("folder", "name", "most", "reached_mm"),
    [
        ("wam", "wam", None, 1.47),
        ("ur5", "ur5", 250, 0.079),
        ("ur10", "ur10d", None, 0.264),
        ("fr3", "fr3", None, 1.0),
    ],
)
def test_real_arms_reach_what_independent_fits_reach(folder, name, most, reached_mm):
    """The figures of independent fits in the folder's README (ur10: of its best named effect)."""
    reached = wb.compare(*real_set(folder, name, most)).reachable
    assert 1e3 * reached.pos_m <= reached_mm


@pytest.mark.parametrize("folder", ["wam", "fr3"])
def test_permuted_residuals_of_real_arms_hold_nothing(folder):
    """Residuals of another pose each, added to the fitted positions."""
    arm, data = real_set(folder, folder)
    r = wb.compare(arm, data).fit_all.evaluation.r[:, :3]
    order = np.random.default_rng(4).permutation(data.n)
    c = wb.compare(arm, replace(data, p_m=data.p_m - r + r[order], quat_wxyz=None))
    assert c.reachable.pos_m >= 0.97 * c.rms["held"][0]
