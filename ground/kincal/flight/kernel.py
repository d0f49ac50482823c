"""The rotation kernel of flight's Gaussian process: its values, and spectral tables (fsw/design/kc_kernel.h;
mathematics: eq. 4 of the paper).

    k(t) = sum_n w_n U_n(cos t),   w_n = (n + 1) s_n / C_inf,   C_inf = sum over the kept n of (n + 1)^2 s_n

U_n are the Chebyshev polynomials of the second kind, which are the Gegenbauer polynomials of S3; (n + 1)^2 is
the multiplicity of the eigenvalue n (n + 2) of its Laplacian. The spectrum s_n is

    heat:       exp(-kappa^2 n (n + 2) / 2)                      nu = 0 in the tables
    Matern nu:  (2 nu / kappa^2 + n (n + 2))^(-nu - 3/2)

``so3`` keeps even n, with t = acos|<q, q'>|, half the rotation angle: functions on rotations. ``paper``
keeps all n, with t the rotation angle itself. C_inf is the sum of what is kept, so k(0) = 1 to rounding
and the signal variance of the process is sigma_s^2, whatever was cut off. What was cut off is stated:
``trunc_err`` is its share of the infinite sum at t = 0. As |U_n| <= n + 1, the kept kernel differs from
the infinite one by no more than 2 trunc_err anywhere. Heat kernels reach TOLERANCE within the table;
Matern 1/2 falls like 1/n, so there the table's length decides.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .builds import Floats, doubles, library

if TYPE_CHECKING:
    from .headers import KcKernel

TOLERANCE = 1e-13
TRUNC_MAX = 0.1  # the flight software refuses more
_FAR = 100_000  # degrees summed one by one; an integral bounds the rest


@dataclass(frozen=True)
class Spectrum:
    """Coefficients w_0 .. and the share of k(0) that was cut off."""

    w: Floats
    trunc_err: float


def spectral_density(n: NDArray[Any], kappa: float, nu: float) -> Floats:
    """Spectrum at degrees n, relative to n = 0."""
    laplacian = n * (n + 2.0)
    if nu == 0.0:
        return np.asarray(np.exp(-(kappa**2) * laplacian / 2.0))
    base = 2.0 * nu / kappa**2
    return np.asarray((1.0 + laplacian / base) ** (-nu - 1.5))


def _rest(kappa: float, nu: float, step: int) -> float:
    """Bound of the terms beyond _FAR: integral of m^2 (m^2 / base)^(-nu - 3/2), m = n + 1.

    Nothing is left of a heat spectrum there.
    """
    if nu == 0.0:
        return 0.0
    base = 2.0 * nu / kappa**2
    return float(base ** (nu + 1.5) * _FAR ** (-2.0 * nu) / (2.0 * nu) / step)


def spectral_table(arg: str, kappa: float, nu: float) -> Spectrum:
    """Table for argument ``so3`` or ``paper``, length scale kappa, smoothness nu (0: heat).

    ValueError if an argument is not positive or unknown, or if the table cannot hold the kernel: then try
    a larger kappa or nu.
    """
    if arg not in ("so3", "paper"):
        raise ValueError(f"kernel argument {arg!r}: so3 or paper")
    if not (kappa > 0.0 and nu >= 0.0 and np.isfinite(kappa) and np.isfinite(nu)):
        raise ValueError(f"kappa {kappa}, nu {nu}: kappa must be positive, nu positive or 0 for heat")
    step = 2 if arg == "so3" else 1
    n = np.arange(0, _FAR, step)
    mass = (n + 1.0) ** 2 * spectral_density(n, kappa, nu)
    # beyond[i]: what is cut off when i terms are kept
    beyond = np.cumsum(mass[::-1])[::-1] + _rest(kappa, nu, step)
    total = beyond[0]
    most = library("flight").lib.KC_SPECTRUM_MAX
    room = (most - 1) // step + 1
    small = np.flatnonzero(beyond[1 : room + 1] <= TOLERANCE * total)
    keep = int(small[0]) + 1 if small.size else room
    trunc_err = float(beyond[keep] / total)
    if trunc_err > TRUNC_MAX:
        missing = f"{most} degrees miss {trunc_err:.0%} of the kernel"
        raise ValueError(f"kappa {kappa}, nu {nu}: {missing}; a larger kappa or nu needs fewer")
    w = np.zeros(int(n[keep - 1]) + 1)
    w[::step] = mass[:keep] / (n[:keep] + 1.0) / mass[:keep].sum()
    return Spectrum(w, trunc_err)


def rotation_correlation(kernel: KcKernel, hyper: int, angles_rad: Floats) -> Floats:
    """(N,) kernel between rotations that are these angles [rad] apart, over its value at 0, by flight's code;
    hyper: which set of the kernel table."""
    flight = library("flight")
    one = doubles([1.0, 0.0, 0.0, 0.0])
    turned = np.zeros((len(angles_rad) + 1, 4))
    turned[0, 0] = 1.0
    turned[1:, 0], turned[1:, 1] = np.cos(0.5 * angles_rad), np.sin(0.5 * angles_rad)
    first, at = flight.pointer(one), flight.pointer(turned)
    values = [flight.lib.kc_kernel_rot(kernel, hyper, first, at + 4 * i) for i in range(len(turned))]
    return np.array(values[1:]) / values[0]
