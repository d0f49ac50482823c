"""Kernel tables and their sum on board against geometric_kernels and numpy; what is positive definite."""

import functools

import geometric_kernels.spaces as spaces
import numpy as np
import pytest
from builders import ffi, fill, lib, quat_dist_rad
from geometric_kernels.kernels import MaternKarhunenLoeveKernel
from scipy.spatial.transform import Rotation

from kincal.flight.kernel import TOLERANCE, Spectrum, spectral_density, spectral_table

SETS = [(nu, kappa) for nu in (0.0, 0.5, 1.5, 2.5) for kappa in (0.3, 0.7, 1.4)]


def kernel_table(arg, nu, kappa, sigma_s=1.0, beta_m=1.0, degrees=None):
    """degrees: cut the table there and scale the rest to k(0) = 1, as the other library does."""
    table = spectral_table(arg, kappa, nu)
    if degrees is not None:
        w = table.w[:degrees]
        table = Spectrum(w / np.sum(w * (np.arange(len(w)) + 1)), table.trunc_err)
    k = ffi.new("kc_kernel_t *")
    k.arg, k.n_hyper, k.sigma_eps = int(arg == "paper"), 1, 0.01
    fill(k.hyper[0], {"sigma_s": sigma_s, "beta_m": beta_m, "kappa": kappa, "nu": nu})
    fill(k.hyper[0], {"n_w": len(table.w), "w": table.w, "trunc_err": table.trunc_err})
    index, got = ffi.new("int32_t *"), ffi.new("double *")
    assert lib.kc_kernel_validate(k, index, got) == lib.KC_OK
    return k, table


def gram(k, quats):
    rows = [ffi.new("double[4]", q.tolist()) for q in quats]
    return np.array([[lib.kc_kernel_rot(k, 0, a, b) for b in rows] for a in rows])


def rotations(seed, n):
    return Rotation.random(n, rng=np.random.default_rng(seed)).as_quat(scalar_first=True)


@functools.cache
def other_levels(space, levels):
    """To set up the levels takes seconds; nu and kappa are parameters of each call."""
    return MaternKarhunenLoeveKernel(space(3), levels)


def other_kernel(space, levels, nu, kappa):
    k = other_levels(space, levels)
    params = k.init_params()
    params["nu"] = np.array([np.inf if nu == 0 else nu])
    params["lengthscale"] = np.array([kappa])
    return lambda x, y: k.K(params, x, y)


@pytest.mark.parametrize(("nu", "kappa"), SETS)
def test_so3_is_the_kernel_of_the_special_orthogonal_group(nu, kappa):
    """Degree n = 2 l. Their Laplacian has l (l + 1) = n (n + 2) / 4, so their length scale is 2 kappa.
    They have characters for 25 levels."""
    k, table = kernel_table("so3", nu, kappa, degrees=49)
    quats = rotations(1, 12)
    matrices = Rotation.from_quat(quats, scalar_first=True).as_matrix()
    levels = (len(table.w) + 1) // 2
    other = other_kernel(spaces.SpecialOrthogonal, levels, nu, 2 * kappa)
    assert np.max(np.abs(gram(k, quats) - other(matrices, matrices))) < 1e-10
    signs = np.where(np.arange(12) % 2, 1.0, -1.0)[:, None]
    assert np.array_equal(gram(k, quats * signs), gram(k, quats))


@pytest.mark.parametrize(("nu", "kappa"), SETS)
def test_paper_is_the_kernel_of_the_sphere_at_the_rotation_angle(nu, kappa):
    """Points of S3 the rotation angle apart, as the paper writes its cosine."""
    k, table = kernel_table("paper", nu, kappa)
    angle = np.concatenate([[0.0, 1e-9, 1e-4], np.linspace(0.05, np.pi - 0.05, 40), [np.pi - 1e-9, np.pi]])
    zero = np.zeros_like(angle)
    points = np.stack([np.cos(angle), np.sin(angle), zero, zero], 1)
    quats = np.stack([np.cos(angle / 2), zero, np.sin(angle / 2), zero], 1)
    other = other_kernel(spaces.Hypersphere, len(table.w), nu, kappa)(points[:1], points)[0]
    one = ffi.new("double[4]", [1, 0, 0, 0])
    got = [lib.kc_kernel_rot(k, 0, one, ffi.new("double[4]", q.tolist())) for q in quats]
    assert np.max(np.abs(got - other)) < 1e-10


@pytest.mark.parametrize("arg", ["so3", "paper"])
@pytest.mark.parametrize(("nu", "kappa"), SETS)
def test_what_was_cut_off_is_stated(arg, nu, kappa):
    """Against the sum of 20000 degrees: never further off than twice the stated share."""
    k, table = kernel_table(arg, nu, kappa)
    n = np.arange(0, 20000, 2 if arg == "so3" else 1)
    weight = (n + 1) * spectral_density(n, kappa, nu)
    t = np.linspace(0.02, np.pi / 2 if arg == "so3" else np.pi - 0.02, 60)
    full = np.array([np.sum(weight * np.sin((n + 1) * ti)) / np.sin(ti) for ti in t])
    full /= np.sum(weight * (n + 1))
    mine = [np.sum(table.w * np.sin((np.arange(len(table.w)) + 1) * ti)) / np.sin(ti) for ti in t]
    rest = 2e-4 if nu == 0.5 else 1e-7  # what 20000 degrees miss themselves
    assert np.max(np.abs(mine - full)) <= 2 * table.trunc_err + 1e-12 + rest * (nu > 0)
    if nu == 0:
        assert table.trunc_err <= TOLERANCE


def test_impossible_tables_are_refused():
    for bad in (("so4", 0.5, 0.0), ("so3", 0.0, 0.0), ("so3", np.nan, 0.0), ("so3", 0.5, -1.0)):
        with pytest.raises(ValueError):
            spectral_table(*bad)
    with pytest.raises(ValueError, match="larger kappa"):
        spectral_table("paper", 0.05, 0.5)


def test_product_with_the_position_kernel():
    k, table = kernel_table("so3", 2.5, 0.7, sigma_s=1.7, beta_m=0.4)
    rng = np.random.default_rng(2)
    quats, p = rotations(3, 8), rng.normal(size=(8, 3))
    points = [
        ffi.new("kc_point_t *", {"q_wxyz": q.tolist(), "p_m": x.tolist()})
        for q, x in zip(quats, p, strict=True)
    ]
    got = np.array([[lib.kc_kernel_eval(k, 0, a, b) for b in points] for a in points])
    d2 = np.sum((p[:, None] - p[None]) ** 2, axis=2)
    assert np.allclose(got, 1.7**2 * gram(k, quats) * np.exp(-d2 / (2 * 0.4**2)), rtol=1e-13)


# --------------------------------------------------------------------------- positive definite, and not


@pytest.mark.parametrize("arg", ["so3", "paper"])
@pytest.mark.parametrize("kappa", [0.1, 0.3, 1.0, 3.0])
def test_both_arguments_are_positive_definite(arg, kappa):
    k, _ = kernel_table(arg, 0.0, kappa)
    least = np.linalg.eigvalsh(gram(k, rotations(4, 400)))[0]
    assert least > -1e-10


def test_all_degrees_at_the_folded_angle_are_not_a_kernel():
    """All n with |<q,q'>| as cosine: least eigenvalue about -2.9 at kappa = 1."""
    table = spectral_table("paper", 1.0, 0.0)
    quats = rotations(5, 400)
    t = np.arccos(np.clip(np.abs(quats @ quats.T), 0, 1 - 1e-14))
    folded = sum(w * np.sin((n + 1) * t) / np.sin(t) for n, w in enumerate(table.w))
    least = np.linalg.eigvalsh(folded)[0]
    assert least == pytest.approx(-2.9, abs=0.5)


def test_odd_degrees_in_an_so3_table_are_refused():
    k, table = kernel_table("paper", 0.0, 1.0)
    k.arg = lib.KC_KERNEL_SO3
    index, got = ffi.new("int32_t *"), ffi.new("double *")
    assert lib.kc_kernel_validate(k, index, got) == lib.KC_ERR_RANGE
    assert got[0] == table.w[1]


def test_example_1_of_the_paper():
    """Its kernel (5), a Gaussian of the rotation distance: not definite for beta = 12, definite for 1."""
    h = np.sqrt(0.5)
    quats = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [h, h, 0, 0], [h, 0, h, 0]])
    d = np.array([[quat_dist_rad(a, b) for b in quats] for a in quats])

    def eigenvalues(beta, gamma_2=0.9):
        return np.linalg.eigvalsh(np.exp(-((gamma_2 * d) ** 2) / (2 * beta**2)))

    assert eigenvalues(12) == pytest.approx([-0.0001, 0.0084, 0.0356, 3.9562], abs=1e-4)
    assert eigenvalues(1) == pytest.approx([0.4725, 0.6941, 1.1404, 1.6930], abs=1e-4)
    for arg in ("so3", "paper"):  # ours at the same four rotations
        for kappa in (0.1, 1.0, 3.0):
            k, _ = kernel_table(arg, 0.0, kappa)
            assert np.linalg.eigvalsh(gram(k, quats))[0] > -1e-12
