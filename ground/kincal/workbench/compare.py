"""Does the model explain the data, and if not, where does it fail?"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from kincal.errors import BadInput, CannotAnswer

from .arms import ArmTable
from .columns import Columns
from .data import Measurements
from .effects import Hypothesis
from .engine import Engine
from .evidence import LN_SCALE_SIGMA
from .fit import Fit, find_frames, fit_model, rms
from .novel import drivers

_MIN_REPLICATE_DOF = 6
ADEQUATE_P = 0.05
_WHERE_P = 0.01
_MIN_POSES = 4
_MIN_RANK_SHARE = 1.0 / 3.0  # of the coefficients; seven joints that move freely give 28 of 28
_STILL = 0.02  # [rad or m], a joint that moves less stands still
BULK = 0.35  # robust weight from which on a pose counts as good


@dataclass(frozen=True)
class Split:
    """Indices of the poses to fit and of those held out; `given`: the file said so."""

    fit: np.ndarray
    held: np.ndarray
    given: bool


@dataclass(frozen=True)
class NoiseFloor:
    """What the measurement itself cannot do better than; source says where the number comes from."""

    pos_m: float | None
    rot_rad: float | None
    source: str
    dof: int = 0


@dataclass(frozen=True)
class Where:
    """share_of_variance: of what the model leaves, explained by an error at `at` that follows the
    variable."""

    variable: str
    p_value: float
    share_of_variance: float
    at: str


@dataclass(frozen=True)
class WorstPose:
    id: str
    pos_m: float
    rot_rad: float | None
    sigma: float


@dataclass(frozen=True)
class Comparison:
    """Answer of `kincal model compare`; rms: name -> (position [m], rotation [rad] or None).

    p_lack_of_fit: of the size of the leftover, None where nothing says how large the noise is;
    p_structure: that it follows some recorded variable somewhere, over all variables.
    """

    arm: str
    source: str
    poses: int
    components: int
    split: Split
    held_data: Measurements | None
    skipped: int
    noise_floor: NoiseFloor
    rms: dict[str, tuple[float, float | None]]
    chi2_per_dof: float
    p_lack_of_fit: float | None
    p_structure: float
    adequate: bool
    worst_poses: tuple[WorstPose, ...]
    where: tuple[Where, ...]
    outliers: tuple[str, ...]
    outlier_note: str
    fit_all: Fit
    fit_part: Fit
    notes: tuple[str, ...] = ()


def choose_split(data: Measurements) -> Split:
    """The file's split, or every fourth pose held out; replicates of one pose stay together."""
    if data.split is not None:
        return Split(np.flatnonzero(data.split == "fit"), np.flatnonzero(data.split == "held"), True)
    groups = data.replicate if data.replicate is not None else np.arange(data.n)
    first = {int(group): int(np.flatnonzero(groups == group)[0]) for group in np.unique(groups)}
    held = np.array([first[int(g)] % 4 == 3 for g in groups])
    return Split(np.flatnonzero(~held), np.flatnonzero(held), False)


def check_units(arm: ArmTable, data: Measurements) -> list[str]:
    """Suspicions about units, in words; empty if all looks right."""
    found = []
    limits = np.array([[joint.q_min, joint.q_max] for joint in arm.joints])
    turning = np.array([not joint.prismatic for joint in arm.joints])
    out = (data.q < limits[:, 0] - 0.1) | (data.q > limits[:, 1] + 0.1)
    if turning.any() and np.abs(data.q[:, turning]).max() > 2.2 * np.pi and out.mean() > 0.2:
        found.append(
            f"joint angles reach {np.abs(data.q[:, turning]).max():.1f}: they look like degrees; "
            "q1..qN must be radians (multiply by pi/180)"
        )
    reach = sum(abs(j.a_m) + abs(j.d_m) for j in arm.joints) + np.linalg.norm(arm.tool.xyz_m)
    spread = float(np.linalg.norm(data.p_m - data.p_m.mean(axis=0), axis=1).max())
    if reach > 0 and spread > 20.0 * reach:
        found.append(
            f"positions spread over {spread:.0f}, the arm reaches about {reach:.1f} m: they look like "
            "millimetres; px,py,pz must be metres"
        )
    return found


def compare(
    arm: ArmTable,
    data: Measurements,
    hypotheses: list[Hypothesis] | tuple[Hypothesis, ...] = (),
    *,
    dh: bool = True,
) -> Comparison:
    """Robust fit on the fit poses, its error on the held-out ones, lack of fit, and where it fails."""
    suspicions = check_units(arm, data)
    if suspicions:
        raise BadInput(f"{data.source}: " + "; ".join(suspicions))
    split = choose_split(data)
    part = data.take(split.fit)
    different = len(split.fit) if part.replicate is None else len(np.unique(part.replicate))
    if different < _MIN_POSES:
        raise CannotAnswer(
            f"{data.source}: {different} different poses to fit; at least {_MIN_POSES} are needed"
        )
    frames = find_frames(arm, part)
    nominal = fit_model(arm, part, (), dh=False, robust=True, frames=frames)
    fit_part = fit_model(arm, part, hypotheses, dh=dh, frames=frames)
    determined = fit_part.dof
    if determined < 1.5:
        raise CannotAnswer(
            f"{data.source}: {len(split.fit)} poses leave no degree of freedom beside the "
            f"{len(fit_part.names)} coefficients; measure more poses"
        )
    rank = fit_part.rank
    if dh and rank < _MIN_RANK_SHARE * len(fit_part.names):
        raise CannotAnswer(
            f"{data.source}: singular design: the poses determine {rank} of {len(fit_part.names)} directions "
            "of the model; move more joints, and farther"
        )
    # the whole model is judged on every pose unless the file keeps some back
    fit_all = fit_part if split.given else fit_model(
        arm, data, hypotheses, dh=dh, frames=(fit_part.base, fit_part.tool)
    )  # fmt: skip
    floor = noise_floor(fit_all)
    p_lack = lack_of_fit(fit_all, floor)
    where = where_it_fails(fit_all)
    held = data.take(split.held) if len(split.held) else None
    outliers, note = find_outliers(fit_all)
    structure = min(1.0, where[0].p_value * len(where)) if where else 1.0
    adequate = structure > _WHERE_P and (p_lack is None or p_lack > ADEQUATE_P)
    return Comparison(
        arm=arm.name,
        source=data.source,
        poses=data.n,
        components=data.components,
        split=split,
        held_data=held,
        skipped=len(data.skipped),
        noise_floor=floor,
        rms={
            "nominal": rms(nominal.evaluation.r),
            "fit": rms(fit_part.evaluation.r),
            "held": rms(fit_part.predict(held)) if held is not None else (float("nan"), None),
        },
        chi2_per_dof=fit_all.scale**2,
        p_lack_of_fit=p_lack,
        p_structure=structure,
        adequate=adequate,
        worst_poses=worst_poses(fit_all),
        where=where,
        outliers=outliers,
        outlier_note=note,
        fit_all=fit_all,
        fit_part=fit_part,
        notes=tuple(still_joints(data)),
    )


def still_joints(data: Measurements) -> list[str]:
    """Joints that the poses do not move, in words."""
    still = np.flatnonzero(np.ptp(data.q, axis=0) < _STILL) + 1
    return [f"joint {j} stands still in these data: nothing about it can be told" for j in still]


def noise_floor(fit: Fit) -> NoiseFloor:
    """From replicates if there are enough, else from the stated covariance, else unknown."""
    data, r = fit.chain.data, fit.evaluation.r
    groups = data.replicate if data.replicate is not None else np.arange(data.n)
    square, dof = np.zeros(r.shape[1]), 0
    for group in np.unique(groups):
        members = np.flatnonzero((groups == group) & (fit.weight > 0.3))
        if len(members) > 1:
            square += ((r[members] - r[members].mean(axis=0)) ** 2).sum(axis=0)
            dof += len(members) - 1
    if dof >= _MIN_REPLICATE_DOF:
        return NoiseFloor(*_pos_rot(square / dof), "replicates", dof)
    if data.cov is not None:
        variance = np.einsum("nii->ni", data.cov).mean(axis=0)[: r.shape[1]]
        return NoiseFloor(*_pos_rot(variance), "stated covariance")
    return NoiseFloor(None, None, "unknown: no replicates and no stated covariance")


def _pos_rot(variance: np.ndarray) -> tuple[float, float | None]:
    rotation = float(np.sqrt(variance[3:].sum())) if len(variance) == 6 else None
    return float(np.sqrt(variance[:3].sum())), rotation


def lack_of_fit(fit: Fit, floor: NoiseFloor) -> float | None:
    """p-value of lack of fit: F test against replicates, else chi^2 with the noise scale marginalised.

    None when nothing says how large the noise is.
    """
    data = fit.chain.data
    good = fit.weight > 0.3
    z = fit.z.reshape(data.n, -1)
    if floor.source == "replicates":
        square, dof_pe = 0.0, 0
        for group in np.unique(data.replicate):
            members = np.flatnonzero((data.replicate == group) & good)
            if len(members) > 1:
                square += float(((z[members] - z[members].mean(axis=0)) ** 2).sum())
                dof_pe += (len(members) - 1) * z.shape[1]
        dof_lof = fit.dof - dof_pe
        if dof_lof > 0 and square > 0:
            f = ((fit.chi2 - square) / dof_lof) / (square / dof_pe)
            return float(stats.f.sf(max(f, 0.0), dof_lof, dof_pe))
    if data.cov is None:
        return None
    ln_s = np.linspace(-4.0, 4.0, 161) * LN_SCALE_SIGMA
    weight = np.exp(-0.5 * (ln_s / LN_SCALE_SIGMA) ** 2)
    return float((weight * stats.chi2.sf(fit.chi2 / np.exp(2 * ln_s), fit.dof)).sum() / weight.sum())


def worst_poses(fit: Fit, count: int = 5) -> tuple[WorstPose, ...]:
    r = fit.evaluation.r
    out = []
    for i in np.argsort(-fit.d2)[:count]:
        tail = stats.chi2.sf(fit.d2[i], r.shape[1])
        rot = float(np.linalg.norm(r[i, 3:])) if r.shape[1] == 6 else None
        sigma = float(stats.norm.isf(max(tail, 1e-300) / 2.0))
        out.append(WorstPose(fit.chain.data.ids[i], float(np.linalg.norm(r[i, :3])), rot, sigma))
    return tuple(out)


def find_outliers(fit: Fit) -> tuple[tuple[str, ...], str]:
    """Poses beyond the chi^2 quantile 1 - 0.01/N; and whether they cluster, which would be an effect."""
    n, c = fit.evaluation.r.shape
    flagged = np.flatnonzero(fit.d2 > stats.chi2.isf(0.01 / n, c))
    ids = tuple(fit.chain.data.ids[i] for i in flagged)
    if len(flagged) < 3:
        return ids, ""
    columns = Columns(fit, np.ones(n))
    hits = []
    mark = np.zeros(n, dtype=bool)
    mark[flagged] = True
    singles = drivers(columns)
    for driver in singles:
        x = driver.features[:, 0]
        p = float(stats.mannwhitneyu(x[mark], x[~mark]).pvalue)
        if p * len(singles) < 0.01:
            hits.append(driver.name)
    if hits:
        return ids, f"the outliers cluster in {', '.join(hits)}: that is an effect rather than bad poses"
    return ids, ""


def where_it_fails(fit: Fit) -> tuple[Where, ...]:
    """Each recorded variable with the place where an error that follows it explains most of the leftover:
    score test of every place x variable cell, DH projected out. Best first.

    The p-value counts the places tried for that variable (Bonferroni), not the number of variables.
    """
    weight = np.where(fit.weight > BULK, 1.0, fit.weight)
    engine = Engine(fit, weight, fit.chain.data.cov is not None)
    total = max(float(engine.wz @ engine.wz), 1e-300)
    by_variable: dict[str, list[Where]] = {}
    for s in engine.map(double=False):
        p = float(stats.chi2.sf(s.score.chi2 / engine.scale**2, s.score.rank)) if s.score.rank else 1.0
        name = s.best.drivers[0]
        by_variable.setdefault(name, []).append(Where(name, p, s.score.chi2 / total, s.best.locus))
    out = []
    for found in by_variable.values():
        best = min(found, key=lambda w: (w.p_value, -w.share_of_variance))
        out.append(replace(best, p_value=min(1.0, best.p_value * len(found))))
    return tuple(sorted(out, key=lambda w: (w.p_value, -w.share_of_variance)))
