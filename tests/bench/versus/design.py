"""Kernel and design step: the choice of the next pose by GP-UCB, against a Gaussian process from libraries.

The others know nothing from the step before: kernel matrices, Cholesky factor, mean and variance of all
candidates anew. KinCal adds one row, since that is what it does on board; a second figure is its choice from
nothing. scikit-learn has no kernel of rotations: it is given one in numpy, the sum over the same spectrum."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from builders import ffi, fill, lib
from geometric_kernels.kernels import MaternKarhunenLoeveKernel
from geometric_kernels.spaces import Hypersphere, SpecialOrthogonal
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.spatial.transform import Rotation
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import Kernel

from kincal.flight import check
from kincal.flight.kernel import Spectrum, spectral_table

from .build import flight_loop
from .measure import OURS, Growth, Ratio, Timed, compared, growth, timed

NU, KAPPA, BETA_M, SIGMA_S, EPS = 2.5, 0.7, 0.4, 0.5, 0.05
SO3_LEVELS = 25  # as far as the other library has characters
BETA = 30.0
MEASURED, CANDIDATES = 20, 1024
GEOMETRIC, SCIKIT = "numpy + geometric_kernels", "scikit-learn"
Array = np.ndarray


@cache
def loops() -> ctypes.CDLL:
    """The loops over flight's functions; all give seconds."""
    found = ctypes.CDLL(str(flight_loop()))
    for name in ("loop_kernel", "loop_step", "loop_design", "loop_model"):
        getattr(found, name).restype = ctypes.c_double
    return found


def at(made: Any) -> ctypes.c_void_p:
    """Address of what cffi made, or of an array."""
    if isinstance(made, np.ndarray):
        return ctypes.c_void_p(made.ctypes.data)
    return ctypes.c_void_p(int(ffi.cast("uintptr_t", made)))


def spectrum(arg: str) -> Spectrum:
    """Flight's table; on SO(3) cut off where the other library ends, so that both sum the same."""
    table = spectral_table(arg, KAPPA, NU)
    if arg == "so3" and len(table.w) > 2 * SO3_LEVELS - 1:
        w = table.w[: 2 * SO3_LEVELS - 1]
        table = Spectrum(w / np.sum(w * (np.arange(len(w)) + 1)), table.trunc_err)
    return table


def flight_kernel(arg: str) -> Any:
    """KERNEL table with one set."""
    table, k = spectrum(arg), ffi.new("kc_kernel_t *")
    k.arg, k.n_hyper, k.sigma_eps = int(arg == "paper"), 1, EPS
    fill(k.hyper[0], {"sigma_s": SIGMA_S, "beta_m": BETA_M, "kappa": KAPPA, "nu": NU})
    fill(k.hyper[0], {"n_w": len(table.w), "w": table.w, "trunc_err": table.trunc_err})
    index, got = ffi.new("int32_t *"), ffi.new("double *")
    check(lib.kc_kernel_validate(k, index, got), "kernel")
    return k


def poses(rng: np.random.Generator, n: int) -> Array:
    """Rows of quaternion and position."""
    quats = Rotation.random(n, rng=rng).as_quat(scalar_first=True)
    return np.hstack([quats, rng.uniform(-0.5, 0.5, (n, 3))])


def points(X: Array) -> Any:
    """The same for flight."""
    out = ffi.new("kc_point_t[]", len(X))
    for point, x in zip(out, X, strict=True):
        point.q_wxyz, point.p_m = x[:4].tolist(), x[4:].tolist()
    return out


# ---- kernel of rotations


@cache
def _levels(arg: str) -> tuple[Any, Any]:
    """Kernel of geometric_kernels with as many levels as flight's table, and its parameters."""
    n = len(spectrum(arg).w)
    space, levels = (Hypersphere(3), n) if arg == "paper" else (SpecialOrthogonal(3), (n + 1) // 2)
    k = MaternKarhunenLoeveKernel(space, levels)
    params = k.init_params()
    params["nu"] = np.array([NU])
    # the Laplacian of SO(3) has l (l + 1) = n (n + 2) / 4 there
    params["lengthscale"] = np.array([KAPPA if arg == "paper" else 2.0 * KAPPA])
    return k, params


def inputs(arg: str, quats: Array) -> Array:
    """What the other library takes: matrices; on the sphere (rotations about one axis) points the rotation
    angle apart, as the paper has it."""
    if arg == "so3":
        return np.asarray(Rotation.from_quat(quats, scalar_first=True).as_matrix())
    angle = 2.0 * np.arctan2(quats[:, 3], quats[:, 0])
    zero = np.zeros_like(angle)
    return np.stack([np.cos(angle), np.sin(angle), zero, zero], axis=1)


def rotations(arg: str, rng: np.random.Generator, n: int) -> Array:
    """n quaternions; for the paper's argument about one axis, which changes nothing in the work."""
    if arg == "so3":
        return np.asarray(Rotation.random(n, rng=rng).as_quat(scalar_first=True))
    half = 0.5 * rng.uniform(-np.pi, np.pi, n)
    zero = np.zeros(n)
    return np.stack([np.cos(half), zero, zero, np.sin(half)], axis=1)


@dataclass(frozen=True)
class Gram:
    """The kernel between n and m rotations, by both."""

    arg: str
    a: Array
    b: Array

    def ours(self, rounds: int) -> tuple[float, Array]:
        """Seconds a round, and the matrix."""
        K = np.zeros((len(self.a), len(self.b)))
        k, a, b = flight_kernel(self.arg), points(with_places(self.a)), points(with_places(self.b))
        sizes = ctypes.c_uint32(len(self.a)), ctypes.c_uint32(len(self.b))
        took = loops().loop_kernel(at(k), at(a), sizes[0], at(b), sizes[1], ctypes.c_uint32(rounds), at(K))
        return took / rounds, K

    def other(self) -> Array:
        """The matrix by geometric_kernels."""
        k, params = _levels(self.arg)
        return np.asarray(k.K(params, self._x, self._y))

    @property
    def _x(self) -> Array:
        return inputs(self.arg, self.a)

    @property
    def _y(self) -> Array:
        return inputs(self.arg, self.b)


def with_places(quats: Array) -> Array:
    """Poses at the origin."""
    return np.hstack([quats, np.zeros((len(quats), 3))])


def gram(arg: str, n: int, m: int) -> Gram:
    """The same one every time."""
    rng = np.random.default_rng(5)
    return Gram(arg, rotations(arg, rng, n), rotations(arg, rng, m))


def _gram_calls(g: Gram, rounds: int) -> dict[str, Timed]:
    k, params = _levels(g.arg)
    x, y = inputs(g.arg, g.a), inputs(g.arg, g.b)
    return {OURS: lambda: g.ours(rounds)[0], GEOMETRIC: timed(lambda: k.K(params, x, y))}


def kernel_ratios(rounds: int) -> Iterator[Ratio]:
    """Both kernels of rotations, 20 x 1024 values."""
    for arg, name in (("paper", "S3"), ("so3", "SO(3)")):
        g = gram(arg, MEASURED, CANDIDATES)
        off = float(np.abs(g.ours(1)[1] - g.other()).max())
        case = f"{name}, {len(spectrum(arg).w)} degrees, {MEASURED} x {CANDIDATES}"
        yield from compared("kernel", case, _gram_calls(g, 20), {GEOMETRIC: off}, "k(0) = 1", rounds)


def kernel_growth(rounds: int) -> Growth:
    """By number of values."""
    sizes = (64, 256, 1024, 4096)
    return growth(
        "kernel on S3", "values", sizes, lambda n: _gram_calls(gram("paper", 16, n // 16), 20), rounds
    )


# ---- design step


@dataclass(frozen=True)
class Step:
    """The last of n measurements has just been made; which candidate is next? X: (n, 7), y: (n,), cand:
    (m, 7)."""

    X: Array
    y: Array
    cand: Array


def step_of(n: int, m: int) -> Step:
    """The same one every time."""
    rng = np.random.default_rng(n + 1000 * m)
    return Step(poses(rng, n), rng.normal(size=n) - 1.0, poses(rng, m))


def kernel_matrix(A: Array, B: Array) -> Array:
    """The whole kernel, rotations by geometric_kernels."""
    k, params = _levels("so3")
    K = k.K(params, inputs("so3", A[:, :4]), inputs("so3", B[:, :4]))
    d2 = ((A[:, None, 4:] - B[None, :, 4:]) ** 2).sum(axis=2)
    return np.asarray(SIGMA_S**2 * K * np.exp(-d2 / (2.0 * BETA_M**2)))


def by_geometric_kernels(s: Step) -> tuple[int, Array]:
    """Chosen candidate and the value of all: GPML Alg. 2.1 in numpy."""
    L = cholesky(kernel_matrix(s.X, s.X) + EPS**2 * np.eye(len(s.X)), lower=True)
    K = kernel_matrix(s.X, s.cand)
    mean = K.T @ cho_solve((L, True), s.y)
    V = solve_triangular(L, K, lower=True)
    value = mean + np.sqrt(BETA * np.maximum(SIGMA_S**2 - (V**2).sum(axis=0), 0.0))
    return int(value.argmax()), value


class Poses(Kernel):
    """The same kernel for scikit-learn: the sum over the spectrum as sines."""

    def __init__(self) -> None:
        """No parameters: scikit-learn asks for a signature."""

    def __call__(self, X: Array, Y: Array | None = None, eval_gradient: bool = False) -> Any:
        Y = X if Y is None else Y
        w = spectrum("so3").w
        degrees = np.flatnonzero(w)
        t = np.clip(np.arccos(np.clip(np.abs(X[:, :4] @ Y[:, :4].T), 0, 1)), 1e-7, np.pi - 1e-7)
        K = sum(w[n] * np.sin((n + 1) * t) for n in degrees) / np.sin(t)
        d2 = ((X[:, None, 4:] - Y[None, :, 4:]) ** 2).sum(axis=2)
        K = SIGMA_S**2 * K * np.exp(-d2 / (2.0 * BETA_M**2))
        return (K, np.empty((*K.shape, 0))) if eval_gradient else K

    def diag(self, X: Array) -> Array:
        return np.full(len(X), SIGMA_S**2)

    def is_stationary(self) -> bool:
        return False


def by_scikit_learn(s: Step) -> tuple[int, Array]:
    """Chosen candidate and the value of all."""
    gp = GaussianProcessRegressor(Poses(), alpha=EPS**2, optimizer=None).fit(s.X, s.y)
    mean, sigma = gp.predict(s.cand, return_std=True)
    value = mean + np.sqrt(BETA) * sigma
    return int(value.argmax()), value


class OurStep:
    """Flight's functions on a step."""

    def __init__(self, s: Step) -> None:
        self.kernel, self.x, self.cand = flight_kernel("so3"), points(s.X), points(s.cand)
        self.y, self.n, self.m = s.y.copy(), len(s.X), len(s.cand)
        self.usable = np.ones(self.m, dtype=np.uint8)
        self.gp, self.scratch = ffi.new("kc_gp_t *"), ffi.new("kc_gp_t *")
        check(lib.kc_gp_init(self.gp, self.kernel, 0, self.cand, self.m), "GP")
        for i in range(self.n - 1):
            check(lib.kc_gp_add(self.gp, ffi.addressof(self.x[i]), self.y[i], self.cand), "GP")
        self.chosen, self.value = ctypes.c_uint32(), ctypes.c_double()

    def _result(self) -> tuple[Any, ...]:
        return ctypes.byref(self.chosen), ctypes.byref(self.value)

    def step(self, rounds: int) -> float:
        """Seconds of one: the last measurement is added to those before."""
        new = ffi.addressof(self.x[self.n - 1])
        given = (at(self.gp), at(self.scratch), at(new), ctypes.c_double(self.y[-1]), at(self.cand))
        beta = ctypes.c_double(BETA)
        return (
            loops().loop_step(*given, at(self.usable), beta, ctypes.c_uint32(rounds), *self._result())
            / rounds
        )

    def anew(self, rounds: int) -> float:
        """Seconds of one from nothing."""
        n, m = ctypes.c_uint32(self.n), ctypes.c_uint32(self.m)
        given = (at(self.scratch), at(self.kernel), at(self.x), at(self.y), n, at(self.cand), m)
        beta = ctypes.c_double(BETA)
        return (
            loops().loop_design(*given, at(self.usable), beta, ctypes.c_uint32(rounds), *self._result())
            / rounds
        )


def off_value(ours: OurStep, other: tuple[int, Array]) -> float:
    """How far the value of our choice is from what the other finds best; both must choose alike."""
    chosen, value = other
    if ours.chosen.value != chosen:
        return float("nan")
    return float(abs(ours.value.value - value[chosen]))


def step_ratios(rounds: int) -> Iterator[Ratio]:
    """n = 20, 1024 candidates: a step of ours, and the choice from nothing."""
    s = step_of(MEASURED, CANDIDATES)
    ours = OurStep(s)
    others = {GEOMETRIC: by_geometric_kernels, SCIKIT: by_scikit_learn}
    for case, call in (("one more pose", ours.step), ("from nothing", ours.anew)):
        calls: dict[str, Timed] = {OURS: lambda call=call: call(20)}
        calls |= {name: timed(lambda of=of: of(s)) for name, of in others.items()}
        call(1)
        off = {name: off_value(ours, of(s)) for name, of in others.items()}
        text = f"{case}, n = {MEASURED}, {CANDIDATES} candidates"
        yield from compared("design step", text, calls, off, "value of the choice", rounds)


def _step_calls(n: int, m: int) -> dict[str, Timed]:
    s = step_of(n, m)
    ours = OurStep(s)
    return {OURS: lambda: ours.step(20), GEOMETRIC: timed(lambda: by_geometric_kernels(s))}


def step_growths(rounds: int) -> Iterator[Growth]:
    """By poses, and by candidates."""
    yield growth("design step", "poses", (4, 8, 16, 32, 60), lambda n: _step_calls(n, CANDIDATES), rounds)
    yield growth(
        "design step", "candidates", (64, 128, 256, 512, 1024), lambda m: _step_calls(MEASURED, m), rounds
    )
