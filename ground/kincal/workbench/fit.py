"""Robust nonlinear least squares of the corrected arm: DH, base, tool and any effects."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy import stats

from kincal.errors import CannotAnswer

from .arms import ArmTable, quat_to_matrix
from .basis import ONE
from .chain import Chain, Evaluation, nominal_chain
from .data import Measurements
from .effects import FRAME_TOOL, Hypothesis, Parameter, Term
from .frames import solve_frames

STUDENT_NU = 4.0
# Wide enough that data of a few poses overrule them (1.3 rad is moved by 0.1 mrad), tight enough to
# keep combinations that the data do not see from wandering.
DH_SIGMA = {"phi_rad": 0.1, "alpha_rad": 0.1, "a_m": 0.05, "d_m": 0.05}
FRAME_SIGMA = {"t": 1.0, "r": 1.0}
_MAX_ITER = 60
# Converged: the cost falls by less than this share and no pose changes its weight by more than that.
_SAME_COST, _SAME_WEIGHT = 1e-7, 5e-3
# Free effect parameters carry this many prior sigmas when their value is reported.
_EFFECT_WIDTH = 10.0
# Stand-in noise where nothing was stated; the fitted scale replaces it.
_DEFAULT_SP_M, _DEFAULT_SR_RAD = 1e-3, 3e-3


def dh_parameters(arm: ArmTable) -> list[tuple[str, Parameter]]:
    """The 4 n DH errors as single terms: rz, tz at frame j-1; tx, rx at frame j."""
    out = []
    for j, _joint in enumerate(arm.joints, 1):
        for name, frame, comp, unit in (
            ("phi_rad", j - 1, 5, "rad"),
            ("alpha_rad", j, 3, "rad"),
            ("a_m", j, 0, "m"),
            ("d_m", j - 1, 2, "m"),
        ):
            term = Term(frame, comp, 1.0, (ONE, ONE))
            out.append((f"J{j}.{name}", Parameter(name, unit, DH_SIGMA[name], (term,))))
    return out


def frame_parameters(arm: ArmTable) -> list[tuple[str, Parameter]]:
    """Twists of base and tool where the arm table says they are to be estimated."""
    out = []
    for label, frame, number in (("base", arm.base, 0), ("tool", arm.tool, FRAME_TOOL)):
        if frame.estimate:
            for comp, axis in enumerate("xyz"):
                term = Term(number, comp, 1.0, (ONE, ONE))
                out.append((f"{label}.t{axis}_m", Parameter("t" + axis, "m", FRAME_SIGMA["t"], (term,))))
            for comp, axis in enumerate("xyz", 3):
                term = Term(number, comp, 1.0, (ONE, ONE))
                out.append((f"{label}.r{axis}_rad", Parameter("r" + axis, "rad", FRAME_SIGMA["r"], (term,))))
    return out


def effect_parameters(hypotheses: list[Hypothesis], width: float) -> list[tuple[str, Parameter]]:
    return [
        (f"{h.name}.{p.name}", Parameter(p.name, p.unit, width * p.sigma, p.terms))
        for h in hypotheses
        for p in h.parameters
    ]


@dataclass(frozen=True)
class Fit:
    """A fitted model. r_m etc. are unweighted; whitened rows use the stated (or stand-in) noise.

    names, estimate, std_err: one per coefficient (std_err scaled by the fitted noise scale);
    z: (N c,) whitened residual at the estimate; J: (N c, k) whitened, not scaled; weight: (N,) robust
    weight; d2: (N,) squared whitened distance of each pose in units of the fitted noise;
    dof: rows minus what the parameters took; scale: fitted noise over stated noise.
    """

    names: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    estimate: np.ndarray
    std_err: np.ndarray
    cov: np.ndarray
    chain: Chain
    terms: object
    evaluation: Evaluation
    whiten: np.ndarray
    z: np.ndarray
    J: np.ndarray
    weight: np.ndarray
    d2: np.ndarray
    dof: float
    scale: float
    chi2: float
    converged: bool
    hypotheses: tuple[Hypothesis, ...] = ()
    base: np.ndarray = field(default_factory=lambda: np.eye(4))
    tool: np.ndarray = field(default_factory=lambda: np.eye(4))

    @property
    def sigma_prior(self) -> np.ndarray:
        return np.array([p.sigma for p in self.parameters])

    @property
    def rank(self) -> int:
        """Directions of the coefficients that the data determine better than the priors do."""
        scaled = self.J * self.sigma_prior / self.scale
        return int((np.linalg.svd(scaled, compute_uv=False) > 1.0).sum()) if scaled.size else 0

    @property
    def misfit(self) -> float:
        """-2 ln of the Student-t likelihood of all poses, up to a constant. Unlike chi2 it also counts the
        poses that were weighted down, so that models with different outliers can be compared."""
        n, c = self.evaluation.r.shape
        square = (self.z.reshape(n, c) ** 2).sum(axis=1) / self.scale**2
        return float(
            (STUDENT_NU + c) * np.log1p(square / STUDENT_NU).sum() + 2.0 * n * c * np.log(self.scale)
        )

    def predict(self, data: Measurements) -> np.ndarray:
        """Residuals (M, c) of other measurements under this fit."""
        chain = Chain(self.chain.arm, data, self.base, self.tool)
        chain.loads(self.terms, self.estimate)
        return chain.evaluate(self.terms, self.estimate).r


def rms(r: np.ndarray) -> tuple[float, float | None]:
    """RMS position error [m] and rotation error [rad] (None without rotations)."""
    if len(r) == 0:
        return float("nan"), None
    position = float(np.sqrt((r[:, :3] ** 2).sum(axis=1).mean()))
    rotation = float(np.sqrt((r[:, 3:] ** 2).sum(axis=1).mean())) if r.shape[1] == 6 else None
    return position, rotation


def whitener(data: Measurements) -> np.ndarray:
    """(N, c, c) inverse Cholesky factors of the stated noise, or of a stand-in if none was stated."""
    c = data.components
    if data.cov is None:
        sigma = [_DEFAULT_SP_M] * 3 + [_DEFAULT_SR_RAD] * (c - 3)
        return np.tile(np.diag(1.0 / np.array(sigma)), (data.n, 1, 1))
    return np.linalg.inv(np.linalg.cholesky(data.cov[:, :c, :c]))


def find_frames(arm: ArmTable, data: Measurements) -> tuple[np.ndarray, np.ndarray]:
    """Base and tool frame: as the table says, or found without a first guess."""
    known = []
    for frame in (arm.base, arm.tool):
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = quat_to_matrix(frame.quat_wxyz), frame.xyz_m
        known.append(None if frame.estimate else matrix)
    if known[0] is not None and known[1] is not None:
        return known[0], known[1]
    rotation = None
    if data.quat_wxyz is not None:
        rotation = np.array([quat_to_matrix(q) for q in data.quat_wxyz])
    return solve_frames(nominal_chain(arm, data), data.p_m, rotation, known[0], known[1])


def fit_model(
    arm: ArmTable,
    data: Measurements,
    hypotheses: list[Hypothesis] | tuple[Hypothesis, ...] = (),
    *,
    dh: bool = True,
    robust: bool = True,
    frames: tuple[np.ndarray, np.ndarray] | None = None,
    start: dict[str, float] | None = None,
    effect_width: float = _EFFECT_WIDTH,
) -> Fit:
    """Levenberg-Marquardt with Student-t pose weights (nu = 4) and wide priors.

    frames: (base, tool) found before; start: coefficient values to begin with, by name.
    CannotAnswer if there are fewer rows than the data-determined parameters need.
    """
    base, tool = frames if frames is not None else find_frames(arm, data)
    parameters = frame_parameters(arm) + (dh_parameters(arm) if dh else [])
    parameters += effect_parameters(list(hypotheses), effect_width)
    chain = Chain(arm, data, base, tool)
    terms = chain.terms(parameters) if parameters else chain.terms([])
    sigma = np.array([p.sigma for _, p in parameters])
    coef = np.array([(start or {}).get(name, 0.0) for name, _ in parameters])
    rows = data.n * data.components
    whiten = whitener(data)
    if rows <= min(len(parameters), 6):
        raise CannotAnswer(
            f"{data.n} poses give {rows} rows for {len(parameters)} coefficients; measure more poses"
        )

    def look(x):
        ev = chain.evaluate(terms, x)
        z = np.einsum("nij,nj->ni", whiten, ev.r)
        return ev, z

    weight = np.ones(data.n)
    chain.loads(terms, coef)
    ev, z = look(coef)
    damping, converged = 1e-6, len(parameters) == 0
    scale2 = 1.0

    def cost_of(z_now, x_now):
        return (weight[:, None] * z_now**2).sum() / scale2 + ((x_now / sigma) ** 2).sum()

    for iteration in range(_MAX_ITER):
        if not len(parameters):
            break
        jac = np.einsum("nij,njk->nik", whiten, ev.J)
        root = np.sqrt(weight / scale2)[:, None]
        a = np.concatenate([(root[:, :, None] * jac).reshape(rows, -1) * sigma, np.eye(len(sigma))])
        b = np.concatenate([(root * z).ravel(), -coef / sigma])
        # A'A in units of the priors: its least eigenvalue is 1, so that squaring loses nothing that matters
        value, vector = np.linalg.eigh(a.T @ a)
        slope = vector.T @ (a.T @ b)
        before = cost_of(z, coef)
        for _ in range(12):
            step = sigma * (vector @ (slope / (value + damping)))
            trial_ev, trial_z = look(coef + step)
            if cost_of(trial_z, coef + step) <= before * (1 + 1e-12):
                damping = max(damping * 0.1, 1e-12)
                break
            damping = max(damping * 10.0, 1e-6)
        else:
            converged = True  # no step lowers the cost: at the minimum to rounding
            break
        coef = coef + step
        small = np.abs(step / sigma).max() < 1e-9 or before - cost_of(trial_z, coef) < _SAME_COST * before
        chain.loads(terms, coef)
        ev, z = look(coef)
        old = weight.copy()
        jac = np.einsum("nij,njk->nik", whiten, ev.J)
        scale2, weight = _reweight(z, jac, sigma, weight, robust)
        if small and np.abs(weight - old).max() < _SAME_WEIGHT and iteration > 1:
            converged = True
            break

    jac = np.einsum("nij,njk->nik", whiten, ev.J).reshape(rows, -1)
    return _finish(
        parameters,
        coef,
        sigma,
        chain,
        terms,
        ev,
        whiten,
        z,
        jac,
        weight,
        scale2,
        converged,
        hypotheses,
        base,
        tool,
    )


def _leverage(
    jac: np.ndarray, sigma: np.ndarray, weight: np.ndarray, scale2: float
) -> tuple[np.ndarray, float]:
    """Hat-matrix blocks (N, c, c) and their trace for weighted rows with the priors."""
    n, c, k = jac.shape
    if k == 0:
        return np.zeros((n, c, c)), 0.0
    a = (np.sqrt(weight / scale2)[:, None, None] * jac * sigma).reshape(n * c, k)
    inverse = np.linalg.inv(a.T @ a + np.eye(k))
    blocks = a.reshape(n, c, k)
    hat = (blocks @ inverse) @ blocks.transpose(0, 2, 1)
    return hat, float(np.einsum("nii->", hat))


def _reweight(z, jac, sigma, weight, robust) -> tuple[float, np.ndarray]:
    """Noise scale^2 and Student-t weights w = (nu + c) / (nu + d^2), d^2 = r'(I - H)^-1 r."""
    n, c = z.shape
    hat, spent = _leverage(jac, sigma, weight, 1.0)
    dof = max(n * c - spent, 1.0)
    scale2 = max(float((weight[:, None] * z**2).sum()) / dof, 1e-6)
    if not robust:
        return scale2, np.ones(n)
    d2 = _distance(z, hat)
    # the bulk sets the scale: outliers must not hide behind the noise they make themselves
    scale2 = max(float(np.median(d2) / stats.chi2.median(c)), 1e-6)
    weight = (STUDENT_NU + c) / (STUDENT_NU + d2 / scale2)
    return scale2, np.minimum(weight, 1.0)


def _distance(z: np.ndarray, hat: np.ndarray) -> np.ndarray:
    """d_i^2 = z_i' (I - H_ii)^-1 z_i."""
    n, c = z.shape
    inner = np.eye(c) - hat
    inner += 1e-9 * np.eye(c)
    return np.einsum("ni,ni->n", z, np.linalg.solve(inner, z[:, :, None])[:, :, 0])


def _finish(
    parameters,
    coef,
    sigma,
    chain,
    terms,
    ev,
    whiten,
    z,
    jac,
    weight,
    scale2,
    converged,
    hypotheses,
    base,
    tool,
) -> Fit:
    n, c = z.shape
    k = len(sigma)
    hat, spent = _leverage(jac.reshape(n, c, k), sigma, weight, scale2)
    rows = float((weight > 0.3).sum() * c)
    dof = max(rows - spent, 1.0)
    good = weight > 0.3
    chi2 = float((z[good] ** 2).sum())
    scale = float(np.sqrt(chi2 / dof))
    if k:
        a = (np.sqrt(weight)[:, None, None] * jac.reshape(n, c, k)).reshape(n * c, k) * sigma / scale
        value, vector = np.linalg.eigh(a.T @ a)  # in units of the priors: stays positive when singular
        cov = (vector / (1.0 + np.maximum(value, 0.0))) @ vector.T * np.outer(sigma, sigma)
    else:
        cov = np.zeros((0, 0))
    d2 = _distance(z, hat) / scale**2
    return Fit(
        names=tuple(name for name, _ in parameters),
        parameters=tuple(p for _, p in parameters),
        estimate=coef,
        std_err=np.sqrt(np.diag(cov)),
        cov=cov,
        chain=chain,
        terms=terms,
        evaluation=ev,
        whiten=whiten,
        z=z.ravel(),
        J=jac,
        weight=weight,
        d2=d2,
        dof=dof,
        scale=scale,
        chi2=chi2,
        converged=converged,
        hypotheses=tuple(hypotheses),
        base=base,
        tool=tool,
    )
