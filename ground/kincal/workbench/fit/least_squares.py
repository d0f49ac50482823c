"""Robust nonlinear least squares of the corrected arm: DH, base, tool and any effects.

Levenberg-Marquardt on whitened residuals with Gaussian priors on the coefficients; poses farther out than
normal noise reaches are weighted as Student-t samples (Lange, Little, Taylor, J. Am. Stat. Assoc. 84(408),
1989). The bulk of the poses sets the noise scale and, for poses whose noise is not stated, its covariance.
Where rows are few, so are DH errors: their prior narrows to the size that a well-built arm has.
A fit is: prepare the `Problem`, `_iterate` (step, then reweight) until nothing changes, `_finish`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from kincal.flight import Evaluation, Model
from kincal.rotations import Pose, matrix_of_wxyz
from kincal_shared.errors import CannotAnswer
from kincal_shared.schema.arm import ArmTable

from ..data.measurements import Measurements, at_time, of_one_session
from ..model.effects import Hypothesis, Parameter
from ..model.flight_model import flight_model, nominal_chain, observations
from ..model.parameters import dh_parameters, effect_parameters, frame_parameters
from ..numerics.distributions import chi2_quantile
from ..numerics.types import Array, Mask, array
from .frames import solve_frames

_STUDENT_NU = 4.0
# Of poses with normal noise, the shares that lie farther out than where weights begin to fall, and than where
# a pose no longer counts toward noise and degrees of freedom.
_FULL_WEIGHT_TAIL, _OUTLIER_TAIL = 1e-2, 1e-4
_MAX_ITERATIONS = 60
_MAX_DAMPINGS = 12
_LEAST_DAMPING, _FIRST_DAMPING = 1e-12, 1e-6
# Converged: the cost falls by less than this share and no pose changes its weight by more than that.
_SAME_COST, _SAME_WEIGHT, _SAME_STEP = 1e-7, 5e-3, 1e-9
_ROUGH_COST = 1e-3  # the same for a fit that only tells the noise
_STRAIGHT, _PROBE = 1e-2, 0.1  # prior sigmas of a step too short to bend; share of a step that is probed
_LEAST_SCALE2 = 1e-6
_LEAST_LEFT = 1e-9  # share of a row that a fit leaves
# Norm of Q'Q - I up to which a second pass makes Q orthogonal (Yamamoto, theorem 3.1).
_NEARLY_ORTHOGONAL = 5 / 64
# Free effect parameters carry this many prior sigmas when their value is reported.
EFFECT_WIDTH = 10.0
# Stand-in noise where nothing was stated; the fitted scale replaces it, for poses the residuals' covariance.
_DEFAULT_SP_M, _DEFAULT_SR_RAD = 1e-3, 3e-3
# Rows for each coefficient of DH and frames up to which DH errors are expected to be as small as those of a
# well-built arm (4 mrad, 2 mm: this share of their prior sigmas), and from which on their prior stays wide.
_FEW_ROWS, _MANY_ROWS = 2.0, 5.0
_WELL_BUILT = 0.02
_SAME_SIGMA = 1e-2  # converged: no prior sigma changes by a larger share
# Where noise is unknown its covariance is mixed with that of so many poses of independent components, so that
# few poses do not make one up.
_NOISE_PRIOR_POSES = 12.0
# It depends on the fit, and the fit on it: again until it stays, where there are more poses than coefficients
# (of fewer, a fit may leave nothing at one component, and would be drawn there).
_WHITENINGS = 5
_SAME_PROPORTIONS = 0.2

Frames = tuple[Pose, Pose]
"""Base and tool frame."""


# ------------------------------------------------------------------------------------------- results


@dataclass(frozen=True)
class Fit:
    """A fitted model of k coefficients on N poses with c residual components (6, or 3 for positions only).

    names, parameters, estimate, std_err: one per coefficient, in the unit of the parameter (std_err scaled
    by the fitted noise scale); cov: (k, k) their covariance; base, tool: frames that the twists of
    base and tool correct; evaluation: unweighted residuals and derivatives at the estimate;
    whiten: (N, c, c) inverse Cholesky factors of the noise, stated or estimated; z: (N c,) whitened
    residuals; J: (N c, k) whitened derivatives of the model; weight: (N,) robust weights;
    d2: (N,) squared whitened distance of each pose in units of the fitted noise; dof: rows of good poses
    minus what the coefficients took; scale: fitted over stated noise; chi2: of the good poses.
    """

    arm: ArmTable
    data: Measurements
    base: Pose
    tool: Pose
    hypotheses: tuple[Hypothesis, ...]
    names: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    estimate: Array
    std_err: Array
    cov: Array
    model: Model
    evaluation: Evaluation
    whiten: Array
    z: Array
    J: Array
    weight: Array
    d2: Array
    dof: float
    scale: float
    chi2: float
    converged: bool

    @property
    def good(self) -> Mask:
        """(N,) poses that are no outliers: they count toward noise and degrees of freedom."""
        return _good(self.weight, self.evaluation.r.shape[1])

    @cached_property
    def sigma_prior(self) -> Array:
        """(k,) prior sigma of each coefficient."""
        return np.array([p.sigma for p in self.parameters])

    @property
    def rank(self) -> int:
        """Directions of the coefficients that the data determine better than the priors do, and not by
        rounding alone."""
        scaled = self.J * self.sigma_prior / self.scale
        if not scaled.size:
            return 0
        value = np.linalg.svd(scaled, compute_uv=False)
        rounding = value[0] * max(scaled.shape) * np.finfo(float).eps
        return int((value > max(1.0, rounding)).sum())

    @property
    def of_session(self) -> tuple[str, ...]:
        """Effects that hold for the session of these data only."""
        return tuple(h.name for h in self.hypotheses if h.of_session)

    def predict(self, data: Measurements) -> Array:
        """Residuals (M, c) of other measurements [m, rad] under this fit; those of another session with
        effects of time as they were in the end of this one."""
        end_s = self.data.end_s
        if self.of_session and end_s is not None and not of_one_session(data, self.data):
            data = at_time(data, end_s)
        return self.model.at(observations(self.arm, data)).residuals(self.estimate)

    def at(self, data: Measurements) -> Fit:
        """The same model linearised at other poses, all with full weight: what it would do there.

        Only evaluation, whiten, weight, model and data follow the new poses; z, J and d2 do not."""
        model = self.model.at(observations(self.arm, data))
        return replace(
            self,
            data=data,
            model=model,
            evaluation=model.evaluate(self.estimate),
            whiten=np.tile(self.whiten[0], (data.n, 1, 1)) if noise_is_unknown(data) else whitener(data),
            weight=np.ones(data.n),
        )


def rms(r: Array) -> tuple[float, float | None]:
    """RMS position error [m] and rotation error [rad] (None without rotations) of residuals (N, c)."""
    if len(r) == 0:
        return float("nan"), None
    position = float(np.sqrt((r[:, :3] ** 2).sum(axis=1).mean()))
    rotation = float(np.sqrt((r[:, 3:] ** 2).sum(axis=1).mean())) if r.shape[1] == 6 else None
    return position, rotation


# ------------------------------------------------------------------------------------------- prepare


@dataclass(frozen=True)
class Problem:
    """What one fit minimises; nothing of it changes while the fit runs.

    names, parameters: one per coefficient; sigma: (k,) their prior sigmas; dh_size: (k,) how large DH errors
    are expected to be, infinite where nothing narrows a prior; whiten: (N, c, c).
    """

    arm: ArmTable
    data: Measurements
    base: Pose
    tool: Pose
    hypotheses: tuple[Hypothesis, ...]
    names: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    sigma: Array
    dh_size: Array
    model: Model
    whiten: Array

    @classmethod
    def prepare(
        cls,
        arm: ArmTable,
        data: Measurements,
        hypotheses: Sequence[Hypothesis],
        *,
        dh: bool,
        frames: Frames | None,
        effect_width: float,
    ) -> Problem:
        """Coefficients, flight model and whitener of a fit. CannotAnswer if there are too few rows."""
        base, tool = frames if frames is not None else find_frames(arm, data)
        ends, errors = frame_parameters(arm), dh_parameters(arm) if dh else []
        named = [*ends, *errors, *effect_parameters(hypotheses, effect_width)]
        rows = data.n * data.components
        if rows <= min(len(named), 6):
            raise CannotAnswer(
                f"{data.n} poses give {rows} rows for {len(named)} coefficients; measure more poses"
            )
        return cls(
            arm=arm,
            data=data,
            base=base,
            tool=tool,
            hypotheses=tuple(hypotheses),
            names=tuple(name for name, _ in named),
            parameters=tuple(p for _, p in named),
            sigma=np.array([p.sigma for _, p in named]),
            dh_size=_dh_size(rows, len(ends), [p.sigma for _, p in errors], len(named)),
            model=flight_model(arm, data, base, tool, named),
            whiten=whitener(data),
        )

    def start(self, values: Mapping[str, float]) -> Array:
        """(k,) coefficients to begin with: by name, 0 where there is none."""
        return np.array([values.get(name, 0.0) for name in self.names])

    def linearised(self, coef: Array) -> _Point:
        """The model and its whitened residuals and derivatives at coefficients, loads taken there too."""
        r, jac = self.model.linearised(coef)
        return _Point(coef, r, self._whitened(r), self.whiten @ jac)

    def trial(self, coef: Array, loads_at: Array) -> Array:
        """(N, c) whitened residuals at coefficients, loads kept where a step began."""
        return self._whitened(self.model.residuals(coef, loads_at))

    def _whitened(self, r: Array) -> Array:
        return array(np.einsum("nij,nj->ni", self.whiten, r))


def _dh_size(rows: int, frames: int, widest: Sequence[float], count: int) -> Array:
    """(count,) expected sizes of DH errors, which follow `frames` coefficients; infinite for all others, and
    where there are many rows."""
    size = np.full(count, np.inf)
    enough = (rows / max(frames + len(widest), 1) - _FEW_ROWS) / (_MANY_ROWS - _FEW_ROWS)
    if enough < 1.0:
        size[frames : frames + len(widest)] = np.array(widest) * _WELL_BUILT ** (1.0 - max(enough, 0.0))
    return size


def noise_is_unknown(data: Measurements) -> bool:
    """Nothing says how errors of position and orientation compare, nor how they go together."""
    return data.cov is None and data.components == 6


def _stand_in(c: int) -> Array:
    """(c,) standard deviations where none are stated."""
    return np.array([_DEFAULT_SP_M] * 3 + [_DEFAULT_SR_RAD] * (c - 3))


def whitener(data: Measurements) -> Array:
    """(N, c, c) inverse Cholesky factors of the stated noise, or of a stand-in if none was stated."""
    c = data.components
    if data.cov is None:
        return np.tile(np.diag(1.0 / _stand_in(c)), (data.n, 1, 1))
    return np.linalg.inv(np.linalg.cholesky(data.cov[:, :c, :c]))


def find_frames(arm: ArmTable, data: Measurements) -> Frames:
    """Base and tool frame: as the table says, or found without a first guess (frames.py)."""
    known = []
    for frame in (arm.base, arm.tool):
        known.append(None if frame.estimate else Pose.of_wxyz(frame.xyz_m, frame.quat_wxyz))
    if known[0] is not None and known[1] is not None:
        return known[0], known[1]
    rotation = None if data.quat_wxyz is None else matrix_of_wxyz(data.quat_wxyz)
    return solve_frames(nominal_chain(arm, data), data.p_m, rotation, known[0], known[1])


# -------------------------------------------------------------------------------- step and reweight


@dataclass(frozen=True)
class _Point:
    """The model at one set of coefficients; r: (N, c) residuals; z: (N, c), jac: (N, c, k), both whitened."""

    coef: Array
    r: Array
    z: Array
    jac: Array


@dataclass(frozen=True)
class _Weights:
    """pose: (N,) robust weights; scale2: squared noise over stated noise."""

    pose: Array
    scale2: float


@dataclass(frozen=True)
class _Iterate:
    """Where an iteration stands; `converged` ends it. problem: with the prior sigmas there."""

    problem: Problem
    point: _Point
    weights: _Weights
    damping: float
    converged: bool


@dataclass(frozen=True)
class _Step:
    """An accepted step: the coefficients it leads to, and whether it was too small to matter."""

    coef: Array
    damping: float
    small: bool


def distance_beside(z: Array, hat: Array) -> Array:
    """(N,) d_i^2 = z_i' (I - H_ii)^-1 z_i for residuals z (N, c) and blocks of a hat matrix (N, c, c).

    No share of a row that is left counts as less than `_LEAST_LEFT`: below it there is rounding only."""
    one = np.eye(z.shape[1])
    try:
        np.linalg.cholesky((1.0 - _LEAST_LEFT) * one - hat)
    except np.linalg.LinAlgError:  # some share is as small; this takes three times as long
        value, vector = np.linalg.eigh(one - hat)
        along = (vector.transpose(0, 2, 1) @ z[:, :, None])[:, :, 0]
        return array((along**2 / np.maximum(value, _LEAST_LEFT)).sum(axis=1))
    return array((z * np.linalg.solve(one - hat, z[:, :, None])[:, :, 0]).sum(axis=1))


def _solve(
    problem: Problem,
    start: Array,
    robust: bool,
    same_cost: float = _SAME_COST,
    weight: Array | None = None,
) -> _Iterate:
    """Iterate until no step lowers the cost or neither cost nor weights change any more; `weight`: (N,) of
    poses, where another fit has found them."""
    now = _Iterate(
        problem=problem,
        point=problem.linearised(start),
        weights=_Weights(np.ones(problem.data.n) if weight is None else weight, 1.0),
        damping=_FIRST_DAMPING,
        converged=len(problem.names) == 0,
    )
    for number in range(_MAX_ITERATIONS):
        if now.converged:
            break
        now = _iterate(now, robust, same_cost, first=number < 2)
    return now


def _iterate(now: _Iterate, robust: bool, same_cost: float, first: bool) -> _Iterate:
    """One accepted step, and what follows from it; `first`: weights have not settled yet."""
    problem = now.problem
    step = _step(problem, now, same_cost)
    if step is None:  # no step lowers the cost: at the minimum to rounding
        return replace(now, converged=True)
    point = problem.linearised(step.coef)
    weights = _reweight(point, problem.sigma, now.weights, robust)
    steady = float(np.abs(weights.pose - now.weights.pose).max()) < _SAME_WEIGHT
    narrowed = _narrowed(problem, point, weights)
    if narrowed is not problem:
        steady &= bool(np.allclose(narrowed.sigma, problem.sigma, rtol=_SAME_SIGMA, atol=0.0))
    return _Iterate(narrowed, point, weights, step.damping, step.small and steady and not first)


def _narrowed(problem: Problem, point: _Point, weights: _Weights) -> Problem:
    """The problem with the prior sigmas of DH errors that go with few rows: Student-t, of the size that a
    well-built arm has, as a mixture of normals (EM as for the poses). What the data determine, a slipped
    encoder, keeps a wide prior; what they do not does not wander."""
    if np.isinf(problem.dh_size).all():
        return problem
    noise = float(np.sqrt(weights.scale2))
    var = np.diag(_covariance(point.jac, problem.sigma, weights.pose, noise))
    local = np.sqrt((_STUDENT_NU * problem.dh_size**2 + point.coef**2 + var) / (_STUDENT_NU + 1.0))
    widest = np.array([p.sigma for p in problem.parameters])
    return replace(problem, sigma=np.minimum(local, widest))


def _step(problem: Problem, now: _Iterate, same_cost: float) -> _Step | None:
    """The least damped Levenberg-Marquardt step that does not raise the cost; None if there is none."""
    normal = _NormalEquations.of(problem.sigma, now)
    before = _cost(now.point.z, now.point.coef, problem.sigma, now.weights)
    damping = now.damping
    for _ in range(_MAX_DAMPINGS):
        step = _accelerated(problem, now, normal, damping)
        coef = now.point.coef + step
        cost = _cost(problem.trial(coef, now.point.coef), coef, problem.sigma, now.weights)
        if cost <= before * (1 + 1e-12):
            tiny = float(np.abs(step / problem.sigma).max()) < _SAME_STEP
            small = tiny or before - cost < same_cost * before
            return _Step(coef, max(damping * 0.1, _LEAST_DAMPING), small)
        damping = max(damping * 10.0, _FIRST_DAMPING)
    return None


def _accelerated(problem: Problem, now: _Iterate, normal: _NormalEquations, damping: float) -> Array:
    """A damped step, bent along the valley by its second derivative where the fit is far from the bottom
    (geodesic acceleration: Transtrum, Sethna, arXiv:1201.5885). Positions alone leave long curved valleys,
    in which straight steps would be many and short."""
    velocity = normal.solve(normal.slope, damping)
    if float(np.abs(velocity).max()) < _STRAIGHT:
        return problem.sigma * velocity
    probe = now.point.coef + _PROBE * problem.sigma * velocity
    moved = (problem.trial(probe, now.point.coef) - now.point.z) * normal.root
    curved = (2.0 / _PROBE) * (moved.ravel() / _PROBE + normal.rows @ velocity)
    bend = normal.solve(normal.vector.T @ (normal.rows.T @ curved), damping)
    return problem.sigma * (velocity + 0.5 * bend)


@dataclass(frozen=True)
class _NormalEquations:
    """(A'A + damping) x = A'b in units of the priors, of the model's weighted rows (N c, k) and the priors'.

    value, vector: eigenvalues and vectors of A'A, whose least is 1, so that squaring loses nothing that
    matters; slope: A'b in those vectors; root: (N, 1) what weights the rows.
    """

    rows: Array
    root: Array
    value: Array
    vector: Array
    slope: Array

    @classmethod
    def of(cls, sigma: Array, now: _Iterate) -> _NormalEquations:
        """At a point, with its weights."""
        n, c = now.point.z.shape
        root = np.sqrt(now.weights.pose / now.weights.scale2)[:, None]
        rows = (root[:, :, None] * now.point.jac).reshape(n * c, -1) * sigma
        value, vector = np.linalg.eigh(rows.T @ rows + np.eye(len(sigma)))
        downhill = rows.T @ (root * now.point.z).ravel() - now.point.coef / sigma
        return cls(rows, root, value, vector, vector.T @ downhill)

    def solve(self, slope: Array, damping: float) -> Array:
        """(k,) solution for a right side in the eigenvectors."""
        return array(self.vector @ (slope / (self.value + damping)))


def _cost(z: Array, coef: Array, sigma: Array, weights: _Weights) -> float:
    """Weighted squares of the residuals and of the coefficients in prior sigmas."""
    data = (weights.pose[:, None] * z**2).sum() / weights.scale2
    return float(data + ((coef / sigma) ** 2).sum())


def _reweight(point: _Point, sigma: Array, old: _Weights, robust: bool) -> _Weights:
    """Noise scale s and pose weights by d^2 / s^2, d^2 = z'(I - H)^-1 z."""
    n, c = point.z.shape
    hat, spent = _leverage(point.jac, sigma, old.pose, 1.0)
    if not robust:
        square = float((old.pose[:, None] * point.z**2).sum())
        return _Weights(np.ones(n), max(square / max(n * c - spent, 1.0), _LEAST_SCALE2))
    d2 = distance_beside(point.z, hat)
    # the bulk sets the scale: outliers must not hide behind the noise they make themselves
    scale2 = max(float(np.median(d2) / chi2_quantile(0.5, c)), _LEAST_SCALE2)
    return _Weights(_pose_weights(d2 / scale2, c), scale2)


def _pose_weights(d2: Array, c: int) -> Array:
    """(N,) weights of poses with c components: full where normal noise of the same size reaches."""
    return student_weights(d2, chi2_quantile(_FULL_WEIGHT_TAIL, c))


def student_weights(d2: Array, full_to: float) -> Array:
    """(N,) weights of poses at squared distance d2 [in units of the noise]: 1 up to `full_to`, beyond it they
    fall as those of a Student-t sample, (nu + full_to) / (nu + d2)."""
    weights: Array = np.minimum((_STUDENT_NU + full_to) / (_STUDENT_NU + d2), 1.0)
    return weights


def _good(weight: Array, c: int) -> Mask:
    """(N,) poses whose weight is that of a pose within the bulk of normal noise."""
    least = _pose_weights(np.array(chi2_quantile(_OUTLIER_TAIL, c)), c)
    good: Mask = weight > least
    return good


def _leverage(jac: Array, sigma: Array, weight: Array, scale2: float) -> tuple[Array, float]:
    """Hat-matrix blocks (N, c, c) and their trace for weighted rows with the priors."""
    n, c, k = jac.shape
    if k == 0:
        return np.zeros((n, c, c)), 0.0
    taken = taken_by((np.sqrt(weight / scale2)[:, None, None] * jac * sigma).reshape(n * c, k))
    blocks = taken.reshape(n, c, k)
    return blocks @ blocks.transpose(0, 2, 1), float((taken**2).sum())


def taken_by(rows: Array) -> Array:
    """(rows, k) Q with QQ' = A (A'A + I)^-1 A', the hat matrix of a ridge fit with rows A.

    By a QR factorisation of A above the rows I of the prior, so that no block of QQ' exceeds 1 by more than
    rounding. Squares A'A alone lose half the digits: where few poses leave next to no noise, blocks of 1.01
    made squared distances, and so weights, negative. Columns that squares leave nearly orthogonal are made so
    to rounding by a second pass (CholeskyQR2: Yamamoto and others, ETNA 44, 2015), in half the time of
    orthogonal transformations (Golub, Van Loan, Matrix Computations, 4th ed., 5.3), which do the others."""
    one = np.eye(rows.shape[1])
    try:
        prior = np.linalg.inv(np.linalg.cholesky(rows.T @ rows + one)).T
        basis = rows @ prior
        square = basis.T @ basis + prior.T @ prior
        if float(np.abs(square - one).max(initial=0.0)) * len(one) < _NEARLY_ORTHOGONAL:
            return array(basis @ np.linalg.inv(np.linalg.cholesky(square)).T)
    except np.linalg.LinAlgError:
        pass
    return array(np.linalg.qr(np.vstack([rows, one]))[0][: len(rows)])


# -------------------------------------------------------------------------------------------- finish


def fit_model(
    arm: ArmTable,
    data: Measurements,
    hypotheses: Sequence[Hypothesis] = (),
    *,
    dh: bool = True,
    robust: bool = True,
    frames: Frames | None = None,
    start: Mapping[str, float] | None = None,
    effect_width: float = EFFECT_WIDTH,
    rough: bool = False,
) -> Fit:
    """Fit DH errors (`dh`), unknown frames and the effects of `hypotheses`, with wide priors.

    robust: outlying poses weigh less (METHOD.md 12.1), else all 1; frames: (base, tool) found before;
    start: coefficient values to begin with, by name; effect_width: prior sigmas of effects; rough: converged
    as soon as the cost falls by less than a thousandth, with noise as it is stated or stands in.
    CannotAnswer if there are fewer rows than the coefficients need.
    """
    problem = Problem.prepare(arm, data, hypotheses, dh=dh, frames=frames, effect_width=effect_width)
    at = problem.start(start or {})
    if rough:
        return _finish(_solve(problem, at, robust, _ROUGH_COST))
    if not noise_is_unknown(data):
        return _finish(_solve(problem, at, robust))
    last = _solve(problem, at, robust, _ROUGH_COST)
    newer = _whitener_of(last)
    for _ in range(_WHITENINGS if data.n > len(problem.names) else 1):
        used = newer
        last = _solve(replace(problem, whiten=used), last.point.coef, robust, weight=last.weights.pose)
        newer = _whitener_of(last)
        if _change_of_proportions(used[0], newer[0]) < _SAME_PROPORTIONS:
            break
    return _finish(last)


def _change_of_proportions(whitener: Array, newer: Array) -> float:
    """Largest over least ratio of the variances (of any combination of components) of two whiteners (c, c),
    less 1: what one scale of all noise does not take."""
    value = np.linalg.svd(whitener @ np.linalg.inv(newer), compute_uv=False)
    return float((value[0] / value[-1]) ** 2 - 1.0)


def _whitener_of(last: _Iterate) -> Array:
    """(N, 6, 6) inverse Cholesky factors of the covariance that the residuals show, one for all poses: a
    point seen from afar moves with every error of orientation, so that the six numbers of a pose are no
    independent witnesses (multivariate t with unknown covariance: Lange, Little, Taylor, section 3)."""
    r, weight = last.point.r, last.weights.pose
    spent = _leverage(last.point.jac, last.problem.sigma, weight, last.weights.scale2)[1] / r.shape[1]
    count = max(float(weight.sum()) - spent, 1.0)
    square = (r * weight[:, None]).T @ r
    plain = np.repeat(np.diag(square).reshape(2, 3).mean(axis=1), 3) / count
    cov = (square + _NOISE_PRIOR_POSES * np.diag(plain)) / (count + _NOISE_PRIOR_POSES)
    least = _LEAST_SCALE2 * _stand_in(6) ** 2
    return np.tile(np.linalg.inv(np.linalg.cholesky(cov + np.diag(least))), (len(r), 1, 1))


def _finish(last: _Iterate) -> Fit:
    """Noise scale, covariance and distances at the end of an iteration."""
    problem = last.problem
    n, c = last.point.z.shape
    pose = last.weights.pose
    good = _good(pose, c)
    hat, spent = _leverage(last.point.jac, problem.sigma, pose, last.weights.scale2)
    dof = max(float(good.sum() * c) - spent, 1.0)
    chi2 = float((last.point.z[good] ** 2).sum())
    scale = float(np.sqrt(chi2 / dof))
    cov = _covariance(last.point.jac, problem.sigma, pose, scale)
    return Fit(
        arm=problem.arm,
        data=problem.data,
        base=problem.base,
        tool=problem.tool,
        hypotheses=problem.hypotheses,
        names=problem.names,
        parameters=tuple(
            p if p.sigma == s else replace(p, sigma=float(s))
            for p, s in zip(problem.parameters, problem.sigma, strict=True)
        ),
        estimate=last.point.coef,
        std_err=np.sqrt(np.diag(cov)),
        cov=cov,
        model=problem.model,
        evaluation=problem.model.evaluate(last.point.coef),
        whiten=problem.whiten,
        z=last.point.z.ravel(),
        J=last.point.jac.reshape(n * c, -1),
        weight=pose,
        d2=distance_beside(last.point.z, hat) / scale**2,
        dof=dof,
        scale=scale,
        chi2=chi2,
        converged=last.converged,
    )


def _covariance(jac: Array, sigma: Array, weight: Array, scale: float) -> Array:
    """(k, k) (A'A + B^-1)^-1 with the noise at the fitted scale; positive even where A'A is singular."""
    n, c, k = jac.shape
    if k == 0:
        return np.zeros((0, 0))
    a = (np.sqrt(weight)[:, None, None] * jac).reshape(n * c, k) * sigma / scale
    value, vector = np.linalg.eigh(a.T @ a)  # in units of the priors
    cov: Array = (vector / (1.0 + np.maximum(value, 0.0))) @ vector.T * np.outer(sigma, sigma)
    return cov
