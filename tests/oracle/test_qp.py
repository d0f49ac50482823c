"""The flight box QP against DAQP and scipy on 1000 random problems, degenerate ones among them."""

import daqp
import numpy as np
import pytest
from builders import flight, lib, qp_solve, view
from scipy.optimize import linprog, lsq_linear

from kincal.flight import status_name

N_PROBLEMS = 1000
KINDS = ("definite", "singular", "consistent", "pinned", "half_open", "integer", "scaled", "start_on_bounds")


def problem(seed):
    """H = A'A, g, box, start; the kind goes round."""
    rng = np.random.default_rng(seed)
    kind = KINDS[seed % len(KINDS)]
    n = int(rng.integers(1, 65 if seed % 5 == 0 else 20))
    rows = n + 3 if kind in ("definite", "scaled") else int(rng.integers(0, n + 1))
    A = rng.normal(size=(rows, n))
    b = rng.normal(size=rows)
    g = -A.T @ b if kind == "consistent" else rng.normal(size=n) * 10 ** rng.uniform(-2, 2)
    centre, width = rng.normal(size=n), rng.exponential(size=n) * 10 ** rng.uniform(-2, 2)
    lb, ub = centre - width, centre + width
    x0 = rng.normal(size=n) * 3
    if kind == "scaled":
        A = A * 10 ** rng.uniform(-2, 2, n)
    if kind == "pinned":
        same = rng.random(n) < 0.4
        ub[same] = lb[same]
    if kind == "half_open":  # flat directions end at a bound, because g is downhill toward it
        A[:, rng.random(n) < 0.3] = 0.0
        lb[g < 0] = -np.inf
        ub[g > 0] = np.inf
        A = np.vstack([A, 0.1 * np.eye(n)])
    if kind == "integer":  # many exact ties between bounds
        A, g = np.round(A), np.round(g)
        lb, ub = -np.ones(n), np.ones(n)
        x0 = np.zeros(n)
    if kind == "start_on_bounds":
        x0 = np.where(rng.random(n) < 0.5, lb, ub)
    return A.T @ A, g, lb, ub, x0


def cost(H, g, x):
    return 0.5 * x @ H @ x + g @ x


def projected_gradient(H, g, lb, ub, x):
    """KKT residual, worked out here: the gradient where no bound holds against it."""
    grad = H @ x + g
    held = ((x <= lb) & (grad > 0)) | ((x >= ub) & (grad < 0))
    return np.abs(np.where(held, 0, grad)).max()


def by_daqp(H, g, lb, ub):
    n = len(g)
    x, _, flag, _ = daqp.solve(
        np.ascontiguousarray(H),
        g,
        np.zeros((0, n)),
        np.clip(ub, None, 1e30),
        np.clip(lb, -1e30, None),
        np.zeros(n, dtype=np.int32),
        primal_tol=1e-10,
        dual_tol=1e-10,
    )
    return np.clip(x, lb, ub) if flag > 0 else None


@pytest.fixture(scope="module")
def solved():
    out = []
    for seed in range(N_PROBLEMS):
        H, g, lb, ub, x0 = problem(seed)
        out.append((H, g, lb, ub, qp_solve(H, g, lb, ub, x0)))
    return out


def test_every_problem_is_solved_inside_the_box_to_the_stated_residual(solved):
    for k, (H, g, lb, ub, got) in enumerate(solved):
        scale = max(1.0, np.abs(g).max())
        size = (np.abs(H) @ np.abs(got.x) + np.abs(g)).max()
        assert got.status == 0, k
        assert np.all(got.x >= lb) and np.all(got.x <= ub), k
        worst = projected_gradient(H, g, lb, ub, got.x)
        assert worst <= max(1e-9 * scale, 1e-13 * size), (k, worst)
        assert got.kkt * scale == pytest.approx(worst, abs=1e-13 * size), k


def test_reported_sides_are_where_x_stands(solved):
    for _, _, lb, ub, got in solved:
        np.testing.assert_array_equal(got.active, np.where(got.x <= lb, -1, np.where(got.x >= ub, 1, 0)))


def test_iterations_stay_far_below_the_bound(solved):
    """The bound is 20 per variable."""
    assert max(got.iters / len(got.x) for *_, got in solved) < 5.0


def test_not_worse_than_daqp_and_the_same_point_where_it_is_unique(solved):
    compared = unique = 0
    for k, (H, g, lb, ub, got) in enumerate(solved):
        definite = np.linalg.eigvalsh(H)[0] > 1e-6 * np.abs(H).max() if H.any() else False
        # DAQP wants a strictly convex problem; where this one is not, help it a little.
        want = by_daqp(H if definite else H + 1e-9 * np.eye(len(g)), g, lb, ub)
        if want is None:
            continue
        compared += 1
        assert cost(H, g, got.x) <= cost(H, g, want) + 1e-9 * (1 + abs(cost(H, g, want))), k
        if definite:
            unique += 1
            np.testing.assert_allclose(got.x, want, atol=1e-6 * (1 + np.abs(want).max()), err_msg=str(k))
    assert compared > 0.9 * N_PROBLEMS
    assert unique > 0.2 * N_PROBLEMS


def test_least_squares_problems_agree_with_scipy():
    rng = np.random.default_rng(0)
    for k in range(100):
        n = int(rng.integers(1, 25))
        m = n + 5 if k % 2 else max(1, n - 3)
        A, b = rng.normal(size=(m, n)), rng.normal(size=m) * 3
        lb, ub = -rng.exponential(size=n), rng.exponential(size=n)
        got = qp_solve(A.T @ A, -A.T @ b, lb, ub)
        want = lsq_linear(A, b, (lb, ub), method="bvls", tol=1e-14)
        assert got.status == 0
        assert 0.5 * np.sum((A @ got.x - b) ** 2) == pytest.approx(want.cost, abs=1e-9)
        if k % 2:
            np.testing.assert_allclose(got.x, want.x, atol=1e-8)


def test_without_curvature_it_is_a_linear_program():
    rng = np.random.default_rng(1)
    for _ in range(20):
        n = int(rng.integers(1, 30))
        g, lb = rng.normal(size=n), rng.normal(size=n)
        ub = lb + rng.exponential(size=n)
        got = qp_solve(np.zeros((n, n)), g, lb, ub, (lb + ub) / 2)
        assert got.status == 0
        assert g @ got.x == pytest.approx(linprog(g, bounds=np.c_[lb, ub]).fun, abs=1e-9)


def test_unbounded_below_is_said_and_x_stays_in_the_box():
    H = np.diag([1.0, 0.0])
    got = qp_solve(H, [0.0, -1.0], [-1, -1], [1, np.inf])
    assert status_name(got.status) == "KC_ERR_NUM"
    assert -1 <= got.x[1] < np.inf


def test_from_any_start_the_same_minimum_of_a_definite_problem():
    rng = np.random.default_rng(2)
    H, g, lb, ub, _ = problem(40)
    assert np.linalg.eigvalsh(H)[0] > 0
    first = qp_solve(H, g, lb, ub)
    for _ in range(20):
        again = qp_solve(H, g, lb, ub, rng.normal(size=len(g)) * 10)
        np.testing.assert_allclose(again.x, first.x, atol=1e-7)


NEARLY_SINGULAR = ("spectrum", "few rows", "Hilbert", "scaled", "path")


def nearly_singular(kind, n, rng):
    """H with eigenvalues down to 1e-12 of the largest, and a box that holds many variables."""
    if kind == "spectrum":
        Q, _ = np.linalg.qr(rng.normal(size=(n, n)))
        H = Q * np.geomspace(1.0, 10 ** -rng.uniform(3, 12), n) @ Q.T
    elif kind == "few rows":
        A = rng.normal(size=(max(1, n // 2), n))
        H = A.T @ A + 10 ** rng.uniform(-10, -3) * np.eye(n)
    elif kind == "Hilbert":
        H = 1.0 / (np.arange(n)[:, None] + np.arange(n) + 1.0)
    elif kind == "scaled":
        A, size = rng.normal(size=(n + 1, n)), 10 ** rng.uniform(-4, 4, n)
        H = A.T @ A * np.outer(size, size)
    else:
        H = np.minimum.outer(np.arange(1.0, n + 1), np.arange(1.0, n + 1))
    width = rng.exponential(size=n) * 10 ** rng.uniform(-2, 2)
    return (H + H.T) / 2, -H @ rng.normal(size=n) * 3.0, -width, width


@pytest.mark.parametrize("kind", NEARLY_SINGULAR)
def test_nearly_singular_problems_of_every_size_are_solved_and_the_cost_never_rises(kind):
    rng = np.random.default_rng(NEARLY_SINGULAR.index(kind))
    for n in range(1, 65):
        H, g, lb, ub = nearly_singular(kind, n, rng)
        qp = flight.new("kc_qp_t")
        qp.n = n
        view(qp.H, lib.KC_COEF_MAX, lib.KC_COEF_MAX)[:n, :n] = H
        for field, values in ((qp.g, g), (qp.lb, lb), (qp.ub, ub)):
            view(field)[:n] = values
        x, costs = view(qp.x)[:n], [0.0]
        lib.kc_qp_begin(qp)
        while lib.kc_qp_iterate(qp):
            costs.append(cost(H, g, x))
        size = 0.5 * np.abs(x) @ np.abs(H) @ np.abs(x) + np.abs(g) @ np.abs(x)
        assert np.all(np.diff(costs) <= 1e-13 * size), n
        assert qp.status == 0, n
        assert np.all((x >= lb) & (x <= ub)), n
        terms = (np.abs(H) @ np.abs(x) + np.abs(g)).max()
        assert projected_gradient(H, g, lb, ub, x) <= max(1e-9 * max(1.0, np.abs(g).max()), 1e-13 * terms), n
        assert qp.iters <= 5 * n, n


def test_all_at_bounds_and_all_without_room():
    rng = np.random.default_rng(4)
    for n in range(1, 65):
        A = rng.normal(size=(n, n))
        H, g = A.T @ A + np.eye(n), 1e3 * rng.choice([-1.0, 1.0], n) * n
        got = qp_solve(H, g, -np.full(n, 1e-3), np.full(n, 1e-3))
        assert got.status == 0
        np.testing.assert_array_equal(got.x, -1e-3 * np.sign(g))
        same = rng.normal(size=n)
        got = qp_solve(H, g, same, same, np.zeros(n))
        assert (got.status, got.iters, got.kkt) == (0, 0, 0.0)
        np.testing.assert_array_equal(got.x, same)


def test_same_input_same_bits():
    for seed in range(0, 200, 7):
        args = problem(seed)
        a, b = qp_solve(*args), qp_solve(*args)
        assert a.x.tobytes() == b.x.tobytes()
        assert (a.kkt, a.iters) == (b.kkt, b.iters)


@pytest.mark.parametrize("spoil", ["n0", "crossed", "nan_H", "nan_g", "inf_x", "nan_bound", "no_x"])
def test_impossible_input_is_refused_and_x_stays(spoil):
    H, g, lb, ub, x = np.eye(3), np.ones(3), -np.ones(3), np.ones(3), np.full(3, 0.25)
    if spoil == "n0":
        H, g, lb, ub, x = (a[:0] for a in (H[:, :0], g, lb, ub, x))
    elif spoil == "crossed":
        lb[1] = 2.0
    elif spoil == "nan_H":
        H[2, 1] = np.nan
    elif spoil == "nan_g":
        g[0] = np.nan
    elif spoil == "inf_x":
        x[0] = np.inf
    elif spoil == "nan_bound":
        ub[2] = np.nan
    else:
        lb[0] = ub[0] = np.inf
    got = qp_solve(H, g, lb, ub, x)
    assert status_name(got.status) == "KC_ERR_ARG"
    np.testing.assert_array_equal(got.x, x)
