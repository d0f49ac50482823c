"""Does a fit leave more than noise, and where? Noise floor, lack of fit, outliers, the variables to blame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import comb

import numpy as np

from ..data.direction import order_of_measurement
from ..data.measurements import Measurements
from ..fit.columns import Columns
from ..fit.least_squares import Fit, taken_by
from ..fit.thinning import thinned
from ..numerics.distributions import chi2_quantile, chi2_tail, f_tail, normal_quantile, rank_sum_p
from ..numerics.types import Array, Mask
from .bayes_factors import LN_SCALE_SIGMA
from .neighbours import Alike, neighbours_alike
from .replicates import Approached, replicates
from .scoring import Scorer, bulk_weights, scaled_p
from .unnamed import Driver, drivers
from .variables import variable_values

ADEQUATE_P = 0.05
STRUCTURE_P = 0.01
_MIN_REPLICATE_DOF = 6
_GROSS = 10.0  # median errors of poses that were not fitted: the same
_MANY_OUTLIERS = 0.05  # of the poses; a model that leaves out more does not explain them
_CLUSTER_P = 0.01
_FEATURES = 2  # of a kernel: one of them is even
_MIN_CLUSTER = 3  # outliers; fewer cannot cluster
_ROW_P = 0.05  # of outliers that are so near each other in time by chance; it is a hint, no verdict
_SOON = 3  # poses behind the last outlier, of which chance may hide as many
_LEAST_TO_TURN = 12  # poses
_TURNED_P = 1e-6
_LEAST_TURN = 0.4  # of what is left of the rotations
REPLICATES, STATED, UNKNOWN = (
    "replicates",
    "stated covariance",
    "unknown: no replicates and no stated covariance",
)


@dataclass(frozen=True)
class NoiseFloor:
    """What the measurement itself cannot do better than, RMS position [m] and rotation [rad].

    source: where the numbers come from; both are None where nothing says; dof: of the replicates;
    approached: how the differences of replicates follow the way the arm came, which is not in the numbers.
    """

    pos_m: float | None
    rot_rad: float | None
    source: str
    dof: int = 0
    approached: Approached | None = None


@dataclass(frozen=True)
class Where:
    """share_of_variance: of what the model leaves, explained by an error at `at` that follows the
    variable; p_value: of that, counting every place that was tried for the variable."""

    variable: str
    p_value: float
    share_of_variance: float
    at: str


@dataclass(frozen=True)
class TurnedFrame:
    """Mean rotation vector of the residuals in the base frame [rad]: of the turn between the frames of
    orientations and positions the part that the fitted base does not take; p_value: that it is chance."""

    rotation_rad: tuple[float, float, float]
    p_value: float


@dataclass(frozen=True)
class WorstPose:
    """A pose far from the model: residual [m], [rad] (None without rotations); sigma: how unlikely it is,
    as a distance of a normal variable."""

    id: str
    pos_m: float
    rot_rad: float | None
    sigma: float


@dataclass(frozen=True)
class Outliers:
    """ids: poses that noise does not explain; poses: number of all; clusters: variables in which they
    cluster, which makes them an effect rather than bad poses; in_a_row: they were measured one after another,
    or nearly so, which single bad poses are not; lasting: up to the last pose of the session, so that nobody
    can tell whether what happened then has passed."""

    ids: tuple[str, ...]
    poses: int
    clusters: tuple[str, ...] = ()
    in_a_row: bool = False
    lasting: bool = False

    @property
    def few(self) -> bool:
        """So few that they may be bad poses of data that a model explains."""
        return len(self.ids) <= _MANY_OUTLIERS * self.poses

    @property
    def may_be_chance(self) -> bool:
        """They may be bad poses: few, and alike in nothing."""
        return self.few and not self.clusters


def noise_floor(fit: Fit) -> NoiseFloor:
    """From replicates if there are enough, else from the stated covariance, else unknown. What differs
    between replicates because the arm came from another side is no noise."""
    r, found = fit.evaluation.r, replicates(fit)
    taken = found.taken / r.shape[1]  # degrees of freedom of a pose that went to the approach
    if (dof := int(found.repeats - taken)) >= _MIN_REPLICATE_DOF:
        square = found.square(r - found.error)
        if square[:3].sum() > 0.0:  # else they are equal to the last digit that the device gives
            variance = square / (found.repeats - taken)
            return NoiseFloor(*_pos_rot(variance), REPLICATES, dof, found.approached)
    if fit.data.cov is not None:
        variance = np.einsum("nii->ni", fit.data.cov).mean(axis=0)[: r.shape[1]]
        return NoiseFloor(*_pos_rot(variance), STATED, approached=found.approached)
    return NoiseFloor(None, None, _unknown(found.repeats, dof), approached=found.approached)


def _unknown(repeats: int, dof: int) -> str:
    """Why nothing says how large the noise is; dof: of the repeats, which the approach takes some of."""
    if repeats == 0:
        return UNKNOWN
    if dof >= _MIN_REPLICATE_DOF:
        return "unknown: replicates are equal to the last digit, and no stated covariance"
    enough = f"{max(dof, 0)} of the {_MIN_REPLICATE_DOF} repeated measurements that are needed"
    return f"unknown: {enough}, and no stated covariance"


def _pos_rot(variance: Array) -> tuple[float, float | None]:
    rotation = float(np.sqrt(variance[3:].sum())) if len(variance) == 6 else None
    return float(np.sqrt(variance[:3].sum())), rotation


def lack_of_fit(fit: Fit, floor: NoiseFloor) -> float | None:
    """p-value of lack of fit: F test against replicates, else chi^2 with the noise scale marginalised, of all
    rows, or of positions and of rotations by themselves: one that is left must not hide behind the other.

    None when nothing says how large the noise is.
    """
    by_replicates = _f_test(fit) if floor.source == REPLICATES else None
    if by_replicates is not None:
        return by_replicates
    if fit.data.cov is None:
        return None
    parts = [_beyond_stated(chi2, dof) for chi2, dof in _position_and_rotation(fit)]
    return min([_beyond_stated(fit.chi2, fit.dof), *(2.0 * p for p in parts)])


def _beyond_stated(chi2: float, dof: float) -> float:
    """p-value of chi^2 with stated noise, whose scale is marginalised."""
    ln_s = np.linspace(-4.0, 4.0, 161) * LN_SCALE_SIGMA
    weight = np.exp(-0.5 * (ln_s / LN_SCALE_SIGMA) ** 2)
    return float((weight * chi2_tail(chi2 / np.exp(2 * ln_s), dof)).sum() / weight.sum())


def _position_and_rotation(fit: Fit) -> Iterator[tuple[float, float]]:
    """chi^2 and degrees of freedom of the position rows and of the rotation rows of good poses; none where
    there are no rotations."""
    z = fit.z.reshape(fit.data.n, -1)
    if z.shape[1] < 6:
        return
    rows = fit.J.reshape(fit.data.n, 6, -1) * fit.sigma_prior / fit.scale
    rows *= np.sqrt(fit.weight)[:, None, None]
    spent = (taken_by(rows.reshape(z.size, -1)) ** 2).sum(axis=1).reshape(z.shape) if rows.size else 0.0 * z
    for part in (slice(0, 3), slice(3, 6)):
        left = (1.0 - spent[fit.good, part]).sum()
        yield float((z[fit.good, part] ** 2).sum()), max(float(left), 1.0)


def _f_test(fit: Fit) -> float | None:
    """Lack of fit against pure error (Draper, Smith, Applied Regression Analysis, 3rd ed., section 2.1)."""
    found = replicates(fit)
    error = np.einsum("nij,nj->ni", fit.whiten, found.error)
    square = float(found.square(fit.z.reshape(error.shape) - error).sum())
    dof_error = found.repeats * error.shape[1] - found.taken
    dof_lack = fit.dof - dof_error
    if dof_lack <= 0 or square <= 0:
        return None
    f = ((fit.chi2 - square) / dof_lack) / (square / dof_error)
    return f_tail(max(f, 0.0), dof_lack, dof_error)


def worst_poses(fit: Fit, count: int = 5) -> tuple[WorstPose, ...]:
    """The poses farthest from the model, worst first."""
    return tuple(_worst_pose(fit, int(i)) for i in np.argsort(-fit.d2)[:count])


def _worst_pose(fit: Fit, i: int) -> WorstPose:
    r = fit.evaluation.r[i]
    tail = float(chi2_tail(fit.d2[i], len(r)))
    rotation = float(np.linalg.norm(r[3:])) if len(r) == 6 else None
    sigma = normal_quantile(max(tail, 1e-300) / 2.0)
    return WorstPose(fit.data.ids[i], float(np.linalg.norm(r[:3])), rotation, sigma)


def find_outliers(fit: Fit, held: Measurements | None = None) -> Outliers:
    """Poses beyond the chi^2 quantile 1 - 0.01/N; and whether they cluster, which would be an effect. Of held
    poses, which are not among the fitted ones, those that are grossly off too. Not those whose last move
    nobody knows (the first one of a session), where an effect of the model follows it or its sign."""
    n, c = fit.evaluation.r.shape
    flagged = list((fit.d2 > chi2_quantile(0.01 / n, c)) & ~_without_last_move(fit))
    names = fit.data.ids
    if held is not None:
        names += held.ids
        flagged += list(gross((fit.predict(held)[:, :3] ** 2).sum(axis=1)))
    ids = tuple(name for name, out in zip(names, flagged, strict=True) if out)
    return Outliers(ids, len(names), _clusters(thinned(fit), ids), *_stretch(fit.data, ids))


def _stretch(data: Measurements, ids: tuple[str, ...]) -> tuple[bool, bool]:
    """Whether all outliers are in so short a part of the session that it is no chance (by Bonferroni over its
    n beginnings), and whether that reaches its end. Not without two outliers or an order of measurement;
    replicates that follow one another count as one pose, which may be a bad one."""
    order = order_of_measurement(data)
    if order is None:
        return False, False
    number = np.arange(data.n)
    if data.replicate is not None:
        number[1:] = np.cumsum(np.diff(data.replicate[order]) != 0)
    at = np.unique(number[np.isin(data.ids, ids)[order]])
    n = int(number[-1]) + 1
    if len(at) < 2:
        return False, False
    length = int(at[-1] - at[0]) + 1
    near = n * comb(length - 1, len(at) - 1) / comb(n, len(at)) < _ROW_P
    return near, near and int(at[-1]) + 1 + _SOON >= n


def _without_last_move(fit: Fit) -> Mask:
    """(N,) poses without an approach direction or a last move that the model needs, since their order does
    not tell it."""
    used = {(b.var, b.index - 1) for p in fit.parameters for t in p.terms for b in t.basis}
    direction, move = fit.data.direction, fit.data.move
    unknown = np.zeros(fit.data.n, dtype=bool)
    if direction is not None and fit.data.direction_source == "inferred":
        joints = sorted(j for var, j in used if var == "dir")
        unknown |= (direction[:, joints] == 0.0).any(axis=1)
    if move is not None and any(var == "move" for var, _ in used):
        unknown |= ~move.any(axis=1)
    return unknown


def gross(square: Array) -> Mask:
    """(M,) squared errors of more than `_GROSS` times the median error."""
    return np.asarray(square > _GROSS**2 * np.median(square), dtype=bool)


def _clusters(fit: Fit, ids: tuple[str, ...]) -> tuple[str, ...]:
    """Variables whose values differ between the outliers and the other poses (Mann-Whitney): more or less of
    them, or, by the leading features of their kernel, in the middle or at the ends."""
    flagged = np.isin(fit.data.ids, ids)
    if flagged.sum() < _MIN_CLUSTER:
        return ()
    singles = drivers(Columns(fit, np.ones(fit.data.n)))

    def p_value(x: Array) -> float:
        return rank_sum_p(x[flagged], x[~flagged])

    def clustered(d: Driver) -> bool:
        tried = [p_value(variable_values(d.name, fit)), *map(p_value, d.features[:, :_FEATURES].T)]
        return min(tried) * len(tried) * len(singles) < _CLUSTER_P

    return tuple(d.name for d in singles if clustered(d))


def where_it_fails(fit: Fit) -> tuple[Where, ...]:
    """Each recorded variable with the place where an error that follows it explains most of the leftover:
    score test of every place x variable cell, DH projected out. Best first.

    The p-value counts the places tried for that variable (Bonferroni), not the number of variables.
    """
    scorer = _scorer(fit)
    total = max(scorer.left, 1e-300)
    by_variable: dict[str, list[Where]] = {}
    for s in scorer.map(double=False):
        name = s.best.drivers[0]
        found = Where(name, scaled_p(s, scorer.scale), s.score.chi2 / total, s.best.location)
        by_variable.setdefault(name, []).append(found)
    return tuple(sorted(map(_best_place, by_variable.values()), key=_least_likely))


def near_poses_alike(fit: Fit) -> Alike | None:
    """What a fit leaves alike at poses that are near each other; None where they are too few to tell."""
    return neighbours_alike(_scorer(fit))


def _scorer(fit: Fit) -> Scorer:
    fit = thinned(fit)
    return Scorer(fit, bulk_weights(fit), fit.data.cov is not None)


def unseen_p(fit: Fit, held: Measurements, outliers: Outliers) -> float:
    """p-value that a fit predicts poses which it was not fitted to as well as its noise and the error of its
    coefficients allow, without outliers: the predictive test of Chow (Econometrica 28, 1960)."""
    usual = held.take(held.are_not(outliers.ids))
    there = fit.at(usual)
    z = np.einsum("nij,nj->ni", there.whiten, there.evaluation.r).ravel() / fit.scale
    jac = (there.whiten @ there.evaluation.J).reshape(len(z), -1) / fit.scale
    # z' (I + J C J')^-1 z, C = L L'
    moved = jac @ np.linalg.cholesky(fit.cov + 1e-18 * np.diag(fit.sigma_prior**2))
    seen = moved.T @ z
    square = float(z @ z - seen @ np.linalg.solve(np.eye(len(seen)) + moved.T @ moved, seen))
    return f_tail(max(square, 0.0) / len(z), len(z), fit.dof)


def turned_frame(fit: Fit) -> TurnedFrame | None:
    """The turn of the measured orientations against the positions, where they are in frames that differ: no
    error of the arm leaves all orientations turned alike in the base frame. Hotelling's T^2 of the rotation
    residuals (Anderson, An Introduction to Multivariate Statistical Analysis, 3rd ed., section 5.2). None if
    there is no such turn, or if it is a small part of what is left."""
    r = fit.evaluation.r[fit.good, 3:]
    n, c = r.shape
    if c == 0 or n < _LEAST_TO_TURN:
        return None
    mean = r.mean(axis=0)
    t2 = float(n * mean @ np.linalg.solve(np.cov(r.T) + 1e-18 * np.eye(3), mean))
    p_value = f_tail(t2 * (n - 3) / (3 * (n - 1)), 3, n - 3)
    size, left = float(np.linalg.norm(mean)), float(np.sqrt((r**2).sum(axis=1).mean()))
    if p_value > _TURNED_P or size < _LEAST_TURN * left:
        return None
    x, y, z = map(float, mean)
    return TurnedFrame((x, y, z), p_value)


def structure(where: Sequence[Where]) -> float:
    """p-value that what is left follows some variable, over all variables (Bonferroni)."""
    return min(1.0, where[0].p_value * len(where)) if where else 1.0


def explained(
    p_lack_of_fit: float | None, p_structure: float, alike: Alike | None, p_unseen: float | None = None
) -> bool:
    """What is left is no larger than a known noise, where one is known, follows no variable, is not alike at
    poses that are near each other, and is as large at poses that the file keeps back, where it keeps some.
    Outliers count in none."""
    small = p_lack_of_fit is None or p_lack_of_fit > ADEQUATE_P
    if alike is not None and alike.shown:
        return False
    return small and p_structure > STRUCTURE_P and (p_unseen is None or p_unseen > STRUCTURE_P)


def _least_likely(w: Where) -> tuple[float, float]:
    return w.p_value, -w.share_of_variance


def _best_place(found: list[Where]) -> Where:
    """The first of those that differ by rounding alone: some places have the same motion."""
    best = min(found, key=lambda w: (float(f"{w.p_value:.6g}"), -round(w.share_of_variance, 6)))
    return replace(best, p_value=min(1.0, best.p_value * len(found)))
