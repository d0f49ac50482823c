"""What the poses of a fit determine: rank, condition, correlated coefficients, and those without a value of
their own (Belsley, Kuh & Welsch, Regression Diagnostics, 1980; Khalil & Dombre, Modeling, Identification and
Control of Robots, 2002, chapter 11)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from ..numerics.types import Array, Mask, array
from .least_squares import Fit

_ZERO = 1e-7  # of the largest singular value of the scaled design: a direction that no pose shows
_NO_COLUMN = 1e-10  # of the longest column: rounding
_PART = 0.02  # of a coefficient lies in directions that no pose shows
_TOGETHER = 0.05  # cosine from which on two such coefficients can stand for each other
_CORRELATED = 0.95
_MOST_PAIRS = 8

AXES = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True)
class Pair:
    """Two coefficients whose estimates are correlated."""

    first: str
    second: str
    correlation: float


@dataclass(frozen=True)
class Axis:
    """Residuals along (x, y, z [m]) or about (rx, ry, rz [rad]) one axis of the measurement frame."""

    name: str
    rms: float
    largest: float


@dataclass(frozen=True)
class Identifiability:
    """The design of a fit.

    parameters: coefficients; rank: directions that the data show at all; determined: those that they
    determine better than the priors do; condition: of the design with columns scaled to length 1, over the
    directions that are shown; correlated: pairs with |correlation| above 0.95, largest first;
    not_separate: groups of coefficients that can stand for each other, so that only what they do together is
    determined; a group of one does nothing at these poses.
    """

    parameters: int
    rank: int
    determined: int
    condition: float
    correlated: tuple[Pair, ...]
    not_separate: tuple[tuple[str, ...], ...]


def identifiability(fit: Fit) -> Identifiability:
    """What the poses of a fit determine; of a fit without coefficients nothing."""
    if not fit.names:
        return Identifiability(0, 0, 0, 1.0, (), ())
    weight = np.repeat(np.sqrt(fit.weight), fit.evaluation.r.shape[1])
    design = fit.J * weight[:, None]
    length = np.linalg.norm(design, axis=0)
    seen = length > _NO_COLUMN * length.max()
    value, vector = _singular(np.where(seen, design / np.where(seen, length, 1.0), 0.0))
    shown: Mask = value > _ZERO * value[0]
    groups = _groups(fit.names, vector[:, ~shown])
    return Identifiability(
        parameters=len(fit.names),
        rank=int(shown.sum()),
        determined=fit.rank,
        condition=float(value[0] / value[shown][-1]),
        correlated=_correlated(fit, groups),
        not_separate=groups,
    )


def _singular(design: Array) -> tuple[Array, Array]:
    """Singular values, largest first, and right singular vectors (k, k) of a design (rows, k)."""
    square = np.linalg.qr(design, mode="r")
    _, value, vt = np.linalg.svd(square, full_matrices=True)
    k = design.shape[1]
    return array(np.pad(value, (0, k - len(value)))), array(vt.T)


def _groups(names: tuple[str, ...], null: Array) -> tuple[tuple[str, ...], ...]:
    """Coefficients that share a direction which no pose shows; null: (k, d) orthonormal such directions."""
    projector = null @ null.T
    part = np.diag(projector)
    inside = [int(i) for i in np.flatnonzero(part > _PART)]
    cosine = np.abs(projector) / np.sqrt(np.maximum(np.outer(part, part), 1e-300))
    groups: list[set[int]] = []
    for i in inside:
        mine = {i} | {j for j in inside if cosine[i, j] > _TOGETHER}
        merged = [g for g in groups if g & mine]
        groups = [g for g in groups if not g & mine] + [mine.union(*merged)]
    return tuple(tuple(names[i] for i in sorted(g)) for g in sorted(groups, key=min))


def _correlated(fit: Fit, groups: tuple[tuple[str, ...], ...]) -> tuple[Pair, ...]:
    """Pairs of coefficients with a value of their own whose estimates are correlated."""
    grouped = {name for group in groups for name in group}
    own = [i for i, name in enumerate(fit.names) if name not in grouped]
    sigma = np.sqrt(np.diag(fit.cov))
    pairs = [
        Pair(fit.names[i], fit.names[j], float(fit.cov[i, j] / (sigma[i] * sigma[j])))
        for i, j in itertools.combinations(own, 2)
        if abs(fit.cov[i, j]) > _CORRELATED * sigma[i] * sigma[j]
    ]
    return tuple(sorted(pairs, key=lambda p: -abs(p.correlation))[:_MOST_PAIRS])


def residual_axes(r: Array) -> tuple[Axis, ...]:
    """RMS and largest residual by axis of residuals (N, c); empty without poses."""
    if len(r) == 0:
        return ()
    rms, largest = np.sqrt((r**2).mean(axis=0)), np.abs(r).max(axis=0)
    return tuple(Axis(*row) for row in zip(AXES, map(float, rms), map(float, largest), strict=False))
