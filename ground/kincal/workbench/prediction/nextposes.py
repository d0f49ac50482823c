"""The poses that separate competing effects best: multi-response Box-Hill / Meyer-Steinberg-Box criterion.

    MD = sum_{i<j} p_i p_j 1/2 [ tr(V_i V_j^-1 + V_j V_i^-1 - 2I)
                                 + (y_i - y_j)' (V_i^-1 + V_j^-1) (y_i - y_j) ]

greedy over random poses where measuring is possible (measurable.py), each with the levers that the arm has:
the approach direction is chosen, a payload may be taken. After each choice the belief of every effect about
its own parameters is updated by a Kalman step. Meyer, Steinberg, Box, Technometrics 38(4), 1996.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree
from scipy.special import expit

from kincal_shared.errors import BadInput, CannotAnswer

from ..data.measurements import Measurements
from ..data.sums import Sums, of_the_joints
from ..fit.columns import Columns
from ..fit.least_squares import Fit
from ..model.effects import Hypothesis
from ..numerics.distributions import chi2_shifted_tail
from ..numerics.types import Array, array
from .measurable import Limits, Measurable, tool_poses

_TRIES = 160
_BATCH, _MOST_DRAWN = 8, 200  # poses drawn at once, and at most, for each that is wanted
_NODES = 40
_CAMERA = ("cam_p_m", "cam_quat_wxyz", "pan_rad", "tilt_rad", "range_m", "incid_rad", "u_px", "v_px")
AS_MEASURED = Limits()
EVEN = 0.5  # power from which on poses are worth measuring
_TELLS_APART = 2.0 * np.log(9.0) + 2.0  # chi^2 that moves even odds of two effects to 90 %


@dataclass(frozen=True)
class NextPose:
    """A pose to measure.

    q: joint angles [rad or m]; direction: approach signs, None if the data have none; tool_m: where the model
    has the tool, measurement frame; payload_kg: None if the data have none; separates: names of the competing
    effects. With this pose and the ones before it: d2: squared distance of the two effects that are nearest
    to each other [chi^2]; power: chance that an effect is distinguished from the others at 90 % probability
    if it is the true one; probability: that the true one is expected to reach against the nearest, from even
    odds.
    """

    q: tuple[float, ...]
    direction: tuple[int, ...] | None
    tool_m: tuple[float, float, float]
    payload_kg: float | None
    separates: tuple[str, ...]
    d2: float
    power: float
    probability: float


@dataclass(frozen=True)
class _Belief:
    """What one effect says of every pose. design: (N, c, k) whitened columns of all coefficients in prior
    sigmas; mean (k,), cov (k, k): of these coefficients."""

    design: Array
    mean: Array
    cov: Array

    def after(self, pose: int) -> _Belief:
        """The belief once a pose is measured (Kalman step; its mean does not matter any more)."""
        a = self.design[pose]
        gain = self.cov @ a.T @ np.linalg.inv(np.eye(len(a)) + a @ self.cov @ a.T)
        return replace(self, cov=self.cov - gain @ a @ self.cov)


def next_poses(
    fit: Fit,
    effects: Sequence[Hypothesis],
    *,
    count: int = 8,
    limits: Limits = AS_MEASURED,
    tries: int = _TRIES,
    seed: int = 1,
) -> tuple[NextPose, ...]:
    """Poses that separate two or more competing effects, best first.

    fit: of the model that they would join; limits: where poses may be, beside what the measured ones show;
    tries: random poses to choose from, drawn with `seed`. BadInput if an effect is given twice; CannotAnswer
    for fewer than two effects, or if no pose can be measured.
    """
    names = tuple(h.name for h in effects)
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise BadInput(f"{twice[0]} is given twice", todo="name two or more different effects")
    if len(effects) < 2:
        raise CannotAnswer("two or more competing effects are needed to separate")
    data = _random_poses(fit, Measurable.of(fit, limits), tries, seed)
    tool_m = tool_poses(fit, data).p_m
    beliefs = _beliefs(fit, data, effects)
    left = np.ones(data.n, dtype=bool)
    total, chosen = 0.0, []
    for _ in range(min(count, data.n)):
        md, gap = _criterion(beliefs)
        best = int(np.argmax(np.where(left, md, -np.inf)))
        left[best] = False
        total += gap[best]
        chosen.append(_next_pose(data, tool_m, best, names, total))
        beliefs = [belief.after(best) for belief in beliefs]
    return tuple(chosen)


def _next_pose(
    data: Measurements, tool_m: Array, i: int, names: tuple[str, ...], separation: float
) -> NextPose:
    sign = None if data.direction is None else tuple(int(x) for x in data.direction[i])
    x, y, z = tool_m[i].tolist()
    return NextPose(
        q=tuple(float(x) for x in data.q[i]),
        direction=sign,
        tool_m=(x, y, z),
        payload_kg=None if data.payload_kg is None else float(data.payload_kg[i]),
        separates=names,
        d2=separation,
        power=chi2_shifted_tail(_TELLS_APART, 1, max(separation, 1e-9)),
        probability=expected_probability(separation),
    )


def expected_probability(d2: float) -> float:
    """Mean posterior probability of the truth of two effects at a squared distance d2 [chi^2], from even
    odds: the log odds are normal with mean d2 / 2 and variance d2."""
    at, weight = np.polynomial.hermite_e.hermegauss(_NODES)
    log_odds = 0.5 * d2 + np.sqrt(max(d2, 0.0)) * at
    return float((weight * expit(log_odds)).sum() / weight.sum())


def would_decide(poses: Sequence[NextPose]) -> bool:
    """The effects are more likely than not told apart by all of these poses."""
    return bool(poses) and poses[-1].power >= EVEN


def poses_to_decide(poses: Sequence[NextPose]) -> int:
    """How many poses such as these it takes until the effects are as likely as not told apart: squared
    distances add up."""
    return int(np.ceil(len(poses) * _TELLS_APART / max(poses[-1].d2, 1e-9)))


def _random_poses(fit: Fit, region: Measurable, count: int, seed: int) -> Measurements:
    """Poses that can be measured, with conditions of measured ones. CannotAnswer if there are none."""
    rng = np.random.default_rng(seed)
    found: list[Measurements] = []
    drawn = 0
    while drawn < _MOST_DRAWN * count and sum(part.n for part in found) < count:
        part = _drawn(fit, rng, _BATCH * count)
        found.append(part.take(region.allows(part)))
        drawn += part.n
    q = np.concatenate([part.q for part in found])
    if not len(q):
        raise CannotAnswer(
            f"none of {drawn} poses about the measured ones lies inside the given boxes and the sensor's view"
        )
    return _joined(found).take(np.arange(min(count, len(q))))


def _joined(parts: Sequence[Measurements]) -> Measurements:
    """The poses of all parts, which have the same columns."""
    arrays = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name, x in vars(parts[0]).items()
        if isinstance(x, np.ndarray)
    }
    total = len(arrays["q"])
    return replace(parts[0], **arrays, ids=tuple(f"next{k + 1}" for k in range(total)))


def _drawn(fit: Fit, rng: np.random.Generator, count: int) -> Measurements:
    """Joint vectors, half of them anywhere in the range of the data, half on the way between two measured
    ones; conditions of measured poses, the camera as it stood for the nearest tool position."""
    data, arm = fit.data, fit.arm
    limits = np.array([[j.q_min, j.q_max] for j in arm.joints])
    low = np.maximum(data.q.min(axis=0), limits[:, 0])
    high = np.minimum(data.q.max(axis=0), limits[:, 1])
    a, b = data.q[rng.integers(0, data.n, (2, count))]
    between = np.clip(a + rng.uniform(0.0, 1.0, (count, 1)) * (b - a), low, high)
    q = np.where(rng.random((count, 1)) < 0.5, between, rng.uniform(low, high, (count, arm.n)))
    direction = None if data.direction is None else rng.choice([-1.0, 1.0], (count, arm.n))
    # as long as they usually are: nobody knows from which pose the arm will come
    usual = None if data.move is None else np.sqrt((data.move**2).mean(axis=0))
    move = None if usual is None or direction is None else direction * usual
    ids = tuple(f"next{k + 1}" for k in range(count))
    like = data.take(rng.integers(0, data.n, count))
    new = replace(like, q=q, direction=direction, move=move, ids=ids, split=None, replicate=None)
    return _aimed(fit, new) if data.has("cam") else new


def _aimed(fit: Fit, new: Measurements) -> Measurements:
    """Poses with the camera of the measured pose whose tool was nearest: a camera that turns aimed there."""
    _, near = KDTree(tool_poses(fit, fit.data).p_m).query(tool_poses(fit, new).p_m)
    camera = {name: getattr(fit.data, name) for name in _CAMERA}
    return replace(new, **{name: x[near] for name, x in camera.items() if x is not None})


def _beliefs(fit: Fit, data: Measurements, effects: Sequence[Hypothesis]) -> list[_Belief]:
    """Each effect's belief after the poses measured so far, and its columns at the new ones."""
    old, there = Columns(fit), fit.at(data)
    new = Columns(there)
    nuisance_old = old.weighted(fit.J) * fit.sigma_prior / fit.scale
    nuisance_new = (there.whiten @ there.evaluation.J) * fit.sigma_prior / fit.scale
    z0 = old.weighted(fit.z + fit.J @ fit.estimate) / fit.scale

    def belief(h: Hypothesis) -> _Belief:
        measured = np.hstack([nuisance_old, old.hypothesis(h) / fit.scale])
        columns = new.hypothesis(h).reshape(data.n, fit.evaluation.r.shape[1], -1) / fit.scale
        k = measured.shape[1]
        basis, triangle = np.linalg.qr(np.vstack([measured, np.eye(k)]))
        root = np.linalg.inv(triangle)  # of the covariance; normal equations would lose half the digits
        design = np.concatenate([nuisance_new, columns], axis=2)
        return _Belief(design, array(root @ (basis[: len(z0)].T @ z0)), array(root @ root.T))

    return [belief(h) for h in effects]


def _criterion(beliefs: Sequence[_Belief]) -> tuple[Array, Array]:
    """(N,) MD of every pose with equal priors, and the least squared separation among the pairs [chi^2]."""
    n, c, _ = beliefs[0].design.shape
    prior = 1.0 / len(beliefs)
    predicted = [_predicted(belief) for belief in beliefs]
    md, gap = np.zeros(n), np.full(n, np.inf)
    for (yj, vj, wj), (yi, vi, wi) in itertools.combinations(predicted, 2):
        trace = np.einsum("nij,nji->n", vi, wj) + np.einsum("nij,nji->n", vj, wi) - 2 * c
        d = yi - yj
        separation = np.einsum("ni,nij,nj->n", d, wi + wj, d)
        md += prior * prior * 0.5 * (trace + separation)
        gap = np.minimum(gap, 0.5 * separation)
    return md, gap


def _predicted(belief: _Belief) -> tuple[Array, Array, Array]:
    """Mean (N, c), covariance and information (N, c, c) of a new measurement at every pose."""
    a = belief.design
    v = np.eye(a.shape[1]) + a @ belief.cov @ a.transpose(0, 2, 1)
    return a @ belief.mean, v, array(np.linalg.inv(v))


def poses_csv(poses: Sequence[NextPose], sums: Sums = ()) -> str:
    """Poses as a file of measurements holds them: px,py,pz is where the model expects the tool, to be
    replaced by what is measured there. sums: of the measurements, by which a controller has other values."""
    n = len(poses[0].q)
    header = ["id", *(f"q{j}" for j in range(1, n + 1))]
    header += [f"dir{j}" for j in range(1, n + 1)] if poses[0].direction else []
    header += ["payload_kg"] if poses[0].payload_kg is not None else []
    lines = [
        f"# next poses, to separate {', '.join(poses[0].separates)}",
        "# px,py,pz: expected by the model; put the measured position there",
        *([f"# {of_the_joints(sums)}; read this file without that map"] if sums else []),
        ",".join([*header, "px", "py", "pz"]),
    ]
    return "\n".join([*lines, *(_csv_row(k, p) for k, p in enumerate(poses, 1))]) + "\n"


def _csv_row(number: int, p: NextPose) -> str:
    payload = [] if p.payload_kg is None else [p.payload_kg]
    values = [*p.q, *(p.direction or ()), *payload, *p.tool_m]
    return ",".join([f"next{number}", *(f"{x:.9g}" for x in values)])
