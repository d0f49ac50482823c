"""The flight box QP against other solvers: time of a solution and KKT residual, in one run.

    python tests/bench/qp.py [--problems 40] [--seed 1]

Flight's library is the one that flies, with its compiler flags; the others are as PyPI has them. Of each
problem all solvers take turns, and the least of several times counts, so that what else the machine does
hits all alike. Taken is the time inside the solver: where it states none, the time of the call less that of
a call that has nothing to do. A solution starts from H, g and the bounds as arrays and from x = 0; nothing
is known from another problem. Tolerances are 1e-9. The residual is |x - clip(x - gradient)|, in parts of
max(1, |g|), the largest component.

Problems, with 28 and with 64 variables:

    random          H = A'A, A with twice as many rows as columns; two fifths of the bounds hold
    correlated      four common factors and a tenth of independent noise
    near-singular   eigenvalues from 1 to 1e-9 in even ratios; more than half of the bounds hold
    few data        H = A'A + 1e-8, A with half as many rows as columns
    recorded        the QPs of the estimator in a calibration of the paper's errors that is flown here: 28 DH
                    errors as flight has them, or 64 coefficients with priors for the same observations

qpOASES is the one that casadi ships; L-BFGS-B is scipy's, for boxes. bench.py writes the table. Exit status
1 if flight's median is above DAQP's for a kind, or a residual of flight above 1e-9."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import importlib.util
import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import daqp
import numpy as np
from builders import basis, fill, flight, lib, term, view
from versus.measure import Growth

from kincal.flight import check
from kincal.run.inprocess import simulate

TOL = 1e-9
SLOW, SLOW_TURNS = ("ProxQP", "OSQP", "L-BFGS-B"), 2  # seconds a problem of some kinds
TURNS, REPEATS = 6, 4  # of each problem: every solver so often in turn, so many solutions in a turn
SIZES = (28, 64)
GROWN_SIZES = (8, 16, 32, 64)
GROWN = ("KinCal", "DAQP", "quadprog", "ProxQP")
RECORDED_SEED = 11
DISTINCT_POSES = 2  # of so many observations more, the QPs of one solution are recorded


@dataclass(frozen=True)
class Problem:
    """Minimise x'Hx / 2 + g'x in the box."""

    H: np.ndarray
    g: np.ndarray
    lb: np.ndarray
    ub: np.ndarray

    def residual(self, x: np.ndarray) -> float:
        inside = np.clip(x, self.lb, self.ub)
        step = inside - np.clip(inside - (self.H @ inside + self.g), self.lb, self.ub)
        return float(max(np.abs(step).max(), np.abs(x - inside).max()) / max(1.0, np.abs(self.g).max()))


# ------------------------------------------------------------------------------------------- made problems


def _hessian(kind: str, n: int, rng: np.random.Generator) -> np.ndarray:
    if kind == "random":
        A = rng.normal(size=(2 * n, n))
        return A.T @ A / (2 * n)
    if kind == "correlated":
        factors = rng.normal(size=(n, 4))
        return factors @ factors.T + 0.1 * np.diag(rng.uniform(0.5, 1.5, n))
    if kind == "few data":
        A = rng.normal(size=(n // 2, n))
        return A.T @ A + 1e-8 * np.eye(n)
    Q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    return Q * np.geomspace(1.0, 1e-9, n) @ Q.T


def made(kind: str, n: int, rng: np.random.Generator) -> Problem:
    """A problem whose start, x = 0, is inside the box."""
    H = _hessian(kind, n, rng)
    H = (H + H.T) / 2
    width = np.exp(rng.normal(size=n))
    centre = rng.uniform(-0.5, 0.5, n) * width
    return Problem(H, -H @ rng.normal(size=n), np.minimum(centre - width, 0), np.maximum(centre + width, 0))


# ------------------------------------------------------------------------------------------- recorded ones


def flown_estimators() -> list[Any]:
    """Copies of flight's estimator with the observations of a calibration, at every second pose."""
    copies: dict[int, Any] = {}

    def note(_tick: Any) -> bool:
        est = lib.kc_app_instance.est
        n = int(est.n_obs)
        if n > 0 and n % DISTINCT_POSES == 0 and n not in copies:
            copies[n] = flight.copy(est)
        return True

    simulate("paper", RECORDED_SEED, each_tick=note)
    return list(copies.values())


def wide_terms(narrow: Any, n_joints: int) -> Any:
    """The DH errors of `narrow`, and errors of base, tool, camera and encoders up to 64 coefficients."""
    out = flight.new("kc_terms_t")
    out.n_coef = out.n_term = 4 * n_joints
    for k in range(4 * n_joints):
        out.coef[k], out.term[k] = narrow.coef[k], narrow.term[k]
    axes = ("tx", "ty", "tz", "rx", "ry", "rz")
    more = [(frame, axis, basis()) for frame in (0, lib.KC_JOINT_MAX + 1) for axis in axes]
    more += [(j, "rz", basis(fn, "q", j + 1)) for fn in ("lin", "sin", "cos") for j in range(n_joints)]
    more += [(lib.KC_JOINT_MAX + 2, axis, basis()) for axis in axes[:3]]
    for frame, axis, of in more[: lib.KC_COEF_MAX - out.n_coef]:
        c = out.n_coef
        prior = {"lb": -0.05, "ub": 0.05, "prior_sigma": 0.01, "scale": 0.05}
        fill(out.coef[c], {"name": f"more[{c}]", "enabled": 1, **prior})
        fill(out.term[out.n_term], term(c, frame, axis, of))
        out.n_coef, out.n_term = c + 1, out.n_term + 1
    index, got = flight.ffi.new("int32_t *"), flight.ffi.new("double *")
    check(lib.kc_terms_validate(out, n_joints, index, got), f"terms, index {index[0]}, value {got[0]}")
    return out


def recorded(est: Any) -> Iterator[Problem]:
    """Every QP of a solution. A step with next to no work does one unit; between the beginning of a QP and
    its first iteration there is one."""
    work, ld = flight.new("kc_work_t"), lib.KC_COEF_MAX
    work.most = 1
    over = False
    lib.kc_est_begin(est)
    while not over:
        qp = est.qp
        if qp.status == lib.KC_ERR_ITER and qp.iters == 0 and 0 < qp.n <= ld:
            n = qp.n
            yield Problem(
                view(qp.H, ld, ld)[:n, :n].copy(), *(view(v)[:n].copy() for v in (qp.g, qp.lb, qp.ub))
            )
        work.used = 0
        over = bool(lib.kc_est_step(est, work))


def flown(n: int, estimators: list[Any], number: int) -> list[Problem]:
    """At most `number`, evenly from all."""
    out: list[Problem] = []
    for flown_with in estimators:
        est = flight.copy(flown_with)
        if n > 4 * est.arm.n_joints:
            terms = wide_terms(est.terms, est.arm.n_joints)
            est.terms, est.hold_none = terms, 1
            est.opt.use_prior, est.opt.free_mask = 1, 2**lib.KC_COEF_MAX - 1
        out += [p for p in recorded(est) if len(p.g) == n]
    return out[:: max(1, len(out) // number)][:number]


# ------------------------------------------------------------------------------------------- solvers

Solver = Callable[[Problem], Callable[[], tuple[float, np.ndarray]]]
"""Made ready for a problem: each call solves it anew and gives seconds and x."""


def _call_cost() -> float:
    """Seconds of a call of the core that has nothing to do."""
    qp = flight.new("kc_qp_t")
    times = []
    for _ in range(2000):
        begun = time.perf_counter_ns()
        lib.kc_qp_solve(qp)  # n = 0: refused at once
        times.append(time.perf_counter_ns() - begun)
    return 1e-9 * min(times)


def kincal(p: Problem) -> Callable[[], tuple[float, np.ndarray]]:
    qp, n, ld = flight.new("kc_qp_t"), len(p.g), lib.KC_COEF_MAX
    qp.n = n
    view(qp.H, ld, ld)[:n, :n] = p.H
    for field, values in ((qp.g, p.g), (qp.lb, p.lb), (qp.ub, p.ub)):
        view(field)[:n] = values
    x, idle = view(qp.x), _call_cost()

    def solve() -> tuple[float, np.ndarray]:
        x[:n] = 0.0
        begun = time.perf_counter_ns()
        status = lib.kc_qp_solve(qp)
        took = time.perf_counter_ns() - begun
        check(status, "box QP")
        return 1e-9 * took - idle, x[:n].copy()

    return solve


def by_daqp(p: Problem) -> Callable[[], tuple[float, np.ndarray]]:
    n = len(p.g)
    arguments = (p.H, p.g, np.zeros((0, n)), p.ub, p.lb, np.zeros(n, dtype=np.int32))

    def solve() -> tuple[float, np.ndarray]:
        x, _, _, info = daqp.solve(*arguments, primal_tol=TOL, dual_tol=TOL)
        return info["setup_time"] + info["solve_time"], x

    return solve


def by_quadprog(p: Problem) -> Callable[[], tuple[float, np.ndarray]]:
    quadprog = importlib.import_module("quadprog")
    n = len(p.g)
    C, b = np.hstack([np.eye(n), -np.eye(n)]), np.concatenate([p.lb, -p.ub])
    one = (np.eye(1), np.zeros(1), np.eye(1), -np.ones(1))
    idle = min(_timed(lambda: quadprog.solve_qp(*one))[0] for _ in range(200))

    def solve() -> tuple[float, np.ndarray]:
        took, found = _timed(lambda: quadprog.solve_qp(p.H, -p.g, C, b))
        return took - idle, found[0]

    return solve


def by_piqp(p: Problem) -> Callable[[], tuple[float, np.ndarray]]:
    piqp = importlib.import_module("piqp")

    def solve() -> tuple[float, np.ndarray]:
        solver = piqp.DenseSolver()
        solver.settings.compute_timings = True
        solver.settings.eps_abs = solver.settings.eps_rel = TOL
        solver.setup(p.H, p.g, x_l=p.lb, x_u=p.ub)
        solver.solve()
        return solver.result.info.run_time, np.array(solver.result.x)

    return solve


def by_proxqp(p: Problem) -> Callable[[], tuple[float, np.ndarray]]:
    proxsuite = importlib.import_module("proxsuite")
    n = len(p.g)

    def solve() -> tuple[float, np.ndarray]:
        qp = proxsuite.proxqp.dense.QP(n, 0, 0, True)
        qp.settings.compute_timings = True
        qp.settings.eps_abs, qp.settings.eps_rel = TOL, 0.0
        qp.init(p.H, p.g, None, None, None, None, None, p.lb, p.ub)
        qp.solve()
        return 1e-6 * (qp.results.info.setup_time + qp.results.info.solve_time), np.array(qp.results.x)

    return solve


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Nothing goes to standard output, from C either."""
    sys.stdout.flush()
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


def by_osqp(p: Problem) -> Callable[[], tuple[float, np.ndarray]]:
    osqp, sparse = importlib.import_module("osqp"), importlib.import_module("scipy.sparse")
    n = len(p.g)
    H, A = sparse.csc_matrix(np.triu(p.H)), sparse.csc_matrix(np.eye(n))
    asked = {"eps_abs": TOL, "eps_rel": 0.0, "max_iter": 20_000, "polishing": True, "verbose": False}

    def solve() -> tuple[float, np.ndarray]:
        with _silent():  # it says when it does not polish
            solver = osqp.OSQP()
            solver.setup(H, p.g, A, p.lb, p.ub, **asked)
            found = solver.solve(raise_error=False)
        return found.info.run_time, np.asarray(found.x)

    return solve


def by_qpoases(p: Problem) -> Callable[[], tuple[float, np.ndarray]]:
    casadi = importlib.import_module("casadi")

    def made(n: int) -> Any:
        shape = {"h": casadi.Sparsity.dense(n, n), "a": casadi.Sparsity(0, n)}
        return casadi.conic("qp", "qpoases", shape, {"printLevel": "none", "sparse": False})

    def given(q: Problem) -> dict[str, Any]:
        return {"h": casadi.DM(q.H), "g": q.g, "lbx": q.lb, "ubx": q.ub, "x0": np.zeros(len(q.g))}

    one = Problem(np.eye(1), np.zeros(1), -np.ones(1), np.ones(1))
    with _silent():  # it says who made it
        solver, arguments = made(len(p.g)), given(p)
        small, nothing = made(1), given(one)
        idle = min(_timed(lambda: small(**nothing))[0] for _ in range(50))
        solver(**arguments)

    def solve() -> tuple[float, np.ndarray]:
        took, found = _timed(lambda: solver(**arguments))
        return took - idle, np.asarray(found["x"]).ravel()

    return solve


def by_scipy(p: Problem) -> Callable[[], tuple[float, np.ndarray]]:
    optimize = importlib.import_module("scipy.optimize")
    bounds = optimize.Bounds(p.lb, p.ub)

    def cost(x: np.ndarray) -> tuple[float, np.ndarray]:
        Hx = p.H @ x
        return 0.5 * float(x @ Hx) + float(p.g @ x), Hx + p.g

    asked = {"gtol": TOL, "ftol": 1e-16, "maxiter": 10_000, "maxfun": 20_000}

    def solve() -> tuple[float, np.ndarray]:
        start = np.zeros(len(p.g))
        took, found = _timed(
            lambda: optimize.minimize(cost, start, jac=True, method="L-BFGS-B", bounds=bounds, options=asked)
        )
        return took, found.x

    return solve


def _timed(call: Callable[[], Any]) -> tuple[float, Any]:
    begun = time.perf_counter_ns()
    out = call()
    return 1e-9 * (time.perf_counter_ns() - begun), out


SOLVERS: dict[str, Solver] = {
    "KinCal": kincal,
    "DAQP": by_daqp,
    "quadprog": by_quadprog,
    "PIQP": by_piqp,
    "ProxQP": by_proxqp,
    "qpOASES": by_qpoases,
    "OSQP": by_osqp,
    "L-BFGS-B": by_scipy,
}
MODULES = {"quadprog": "quadprog", "PIQP": "piqp", "ProxQP": "proxsuite", "qpOASES": "casadi", "OSQP": "osqp"}


def there() -> dict[str, Solver]:
    """The solvers that are installed."""
    missing = {name for name, module in MODULES.items() if importlib.util.find_spec(module) is None}
    return {name: solver for name, solver in SOLVERS.items() if name not in missing}


# ------------------------------------------------------------------------------------------- the run


@dataclass(frozen=True)
class Row:
    """A kind: by solver the median ratio of its time to flight's and largest residual; flight's median."""

    kind: str
    n: int
    ratio: dict[str, float]
    residual: dict[str, float]
    seconds: float
    worst_to_daqp: float


def measure(kind: str, n: int, problems: list[Problem], solvers: dict[str, Solver]) -> Row:
    took: dict[str, list[float]] = {name: [] for name in solvers}
    residual = dict.fromkeys(solvers, 0.0)
    for p in problems:
        ready = {name: make(p) for name, make in solvers.items()}
        least = dict.fromkeys(solvers, np.inf)
        for turn in range(TURNS):
            for name, solve in ready.items():
                if name in SLOW and turn >= SLOW_TURNS:
                    continue
                for _ in range(REPEATS if name in ("KinCal", "DAQP") else 1):
                    seconds, x = solve()
                    least[name] = min(least[name], seconds)
                residual[name] = max(residual[name], p.residual(x))
        for name in solvers:
            took[name].append(least[name])
    ours = np.array(took["KinCal"])
    ratio = {name: float(np.median(np.array(t) / ours)) for name, t in took.items()}
    to_daqp = float(np.quantile(ours / np.array(took["DAQP"]), 0.9))
    return Row(kind, n, ratio, residual, float(np.median(ours)), to_daqp)


def rows(number: int, seed: int) -> Iterator[Row]:
    solvers, estimators = there(), flown_estimators()
    for n in SIZES:
        for kind in ("random", "correlated", "near-singular", "few data"):
            rng = np.random.default_rng(seed)
            yield measure(kind, n, [made(kind, n, rng) for _ in range(number)], solvers)
        yield measure("recorded", n, flown(n, estimators, number), solvers)


def table(found: list[Row]) -> list[str]:
    """Markdown: ratios of all solvers, and in brackets residuals that miss what was asked for."""
    names = [name for name in found[0].ratio if name != "KinCal"]
    head = ["problems", "n", *names, "KinCal to DAQP, 9 of 10 below", "residual of KinCal"]
    lines = [f"| {' | '.join(head)} |", f"|---|{'---:|' * (len(head) - 1)}"]
    for r in found:
        ratios = [_cell(r, name) for name in names]
        cells = [r.kind, str(r.n), *ratios, f"{r.worst_to_daqp:.2f}", f"{r.residual['KinCal']:.0e}"]
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def _cell(r: Row, name: str) -> str:
    text = f"{r.ratio[name]:.{1 if r.ratio[name] < 10 else 0}f}"
    return text if r.residual[name] <= TOL else f"{text} ({r.residual[name]:.0e})"


def by_size(number: int, seed: int) -> Growth:
    """Random problems: those that take the same steps whatever the binding."""
    chosen = {name: SOLVERS[name] for name in GROWN if name in there()}
    medians = []
    for n in GROWN_SIZES:
        rng = np.random.default_rng(seed)
        least: dict[str, list[float]] = {name: [] for name in chosen}
        for p in [made("random", n, rng) for _ in range(number)]:
            for name, make in chosen.items():
                solve = make(p)
                least[name].append(min(solve()[0] for _ in range(TURNS)))
        medians.append({name: float(np.median(times)) for name, times in least.items()})
    return Growth("box QP", "variables", GROWN_SIZES, {k: tuple(m[k] for m in medians) for k in chosen})


def main(argv: list[str] | None = None) -> int:
    p = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    p.add_argument("--problems", type=int, default=40)
    p.add_argument("--seed", type=int, default=1)
    o = p.parse_args(argv)
    found = []
    for row in rows(o.problems, o.seed):
        found.append(row)
        others = ", ".join(
            f"{k} {v:.2g} ({row.residual[k]:.0e})" for k, v in row.ratio.items() if k != "KinCal"
        )
        print(
            f"{row.kind:14s} n = {row.n}: KinCal {1e6 * row.seconds:.1f} us ({row.residual['KinCal']:.0e}); "
            f"times as long, residual: {others}; KinCal to DAQP, 9 of 10 below {row.worst_to_daqp:.2f}",
            flush=True,
        )
    bad = [f"{r.kind} {r.n}" for r in found if r.ratio["DAQP"] < 1.0 or r.residual["KinCal"] > TOL]
    if bad:
        print("slower than DAQP, or not solved: " + ", ".join(bad))
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
