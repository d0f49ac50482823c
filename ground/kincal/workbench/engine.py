"""Scores every hypothesis and every cell of the map at one fit, by the same formula."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import stats

from .arms import ArmTable
from .columns import Columns
from .data import Measurements
from .effects import Effect, Hypothesis, Library, Parameter
from .evidence import NoiseScale, Projector, Score, ln_bayes_factor, scores
from .fit import STUDENT_NU, Fit
from .novel import Cell, cells

PRIOR_NONE, PRIOR_NOVEL = 0.3, 0.1
_NULL_DRAWS = 400
_GRANTED_WIDTH = 30.0  # prior sigmas
_SAME = 1.0 - 1e-6  # cosine of two columns that are the same function


@dataclass(frozen=True)
class Candidate:
    """A hypothesis that competes: the constants of its grid are summed over, by weight (equal if none)."""

    name: str
    effect: Effect
    variants: tuple[Hypothesis, ...]
    prior: float
    weights: tuple[float, ...] = ()

    def closer(self, tried: list[Hypothesis]) -> Candidate:
        """The same with the part of its grid that `tried` spans replaced by these."""
        low, high = min(h.constants for h in tried), max(h.constants for h in tried)
        rest = [h for h in self.variants if not low <= h.constants <= high]
        share = 1.0 / len(self.variants)
        inside = (1.0 - share * len(rest)) or share
        weights = [share] * len(rest) + [inside / len(tried)] * len(tried)
        return replace(self, variants=(*rest, *tried), weights=tuple(weights))


@dataclass(frozen=True)
class Scored:
    """block: G; columns: W G; signal: W z0, what there is to explain."""

    name: str
    ln_bf: float
    score: Score
    best: Hypothesis | Cell
    block: np.ndarray
    projector: Projector
    signal: np.ndarray

    @cached_property
    def columns(self) -> np.ndarray:
        return self.projector.apply(self.block)


def merged(effect: Effect, hypotheses: list[Hypothesis]) -> Hypothesis:
    """One hypothesis with the parameters of all joints: "joint_compliance" from its instances."""
    parameters = tuple(
        Parameter(f"{p.name}{h.name[len(effect.name) :]}", p.unit, p.sigma, p.terms)
        for h in hypotheses
        for p in h.parameters
    )
    return Hypothesis(effect.name, effect.name, parameters, hypotheses[0].constants)


def build_candidates(
    arm: ArmTable, data: Measurements, library: Library, used: set[str]
) -> tuple[list[Candidate], list[tuple[str, tuple[str, ...]]]]:
    """Every testable effect: all joints at once (half its prior) and each joint or pair alone; and the
    names of the others with what they need."""
    testable, lacking = [], []
    for effect in library.effects.values():
        missing = effect.missing(arm, data)
        if missing:
            lacking.append((effect.name, tuple(missing)))
        elif not effect.twin_of:
            testable.append(effect)
    out: list[Candidate] = []
    share = (1.0 - PRIOR_NONE - PRIOR_NOVEL) / max(len(testable), 1)
    for effect in testable:
        by_constants: dict[tuple, list[Hypothesis]] = {}
        by_name: dict[str, list[Hypothesis]] = {}
        for h in effect.instances(arm, data):
            if not any(p.terms for p in h.parameters):
                continue
            by_constants.setdefault(h.constants, []).append(h)
            by_name.setdefault(h.name, []).append(h)
        several = effect.per == "joint" and len(by_name) > 1
        singles = [name for name in by_name if name not in used and effect.name not in used]
        for name in singles:
            prior = share / len(by_name) * (0.5 if several else 1.0)
            out.append(Candidate(name, effect, tuple(by_name[name]), prior))
        if several and effect.name not in used:
            variants = tuple(merged(effect, group) for group in by_constants.values())
            out.append(Candidate(effect.name, effect, variants, 0.5 * share))
    return out, lacking


def robust_weights(fit: Fit, candidates: list[Candidate]) -> np.ndarray:
    """Student-t pose weights under DH plus ALL effects at prior width, so that an effect is not
    mistaken for outliers (diagnosis.md 3.1)."""
    n, c = fit.evaluation.r.shape
    plain = Columns(fit, np.ones(n))
    blocks = [plain.hypothesis(cand.variants[0]) for cand in candidates if cand.prior > 0]
    big = np.hstack([fit.J * fit.sigma_prior, *blocks])
    z0 = fit.z + fit.J @ fit.estimate
    weight = np.ones(n)
    for _ in range(6):
        root = np.repeat(np.sqrt(weight), c)
        a = big * root[:, None]
        # Ridge fit; I - H = K^-1 = I - A (s^2 I + A'A)^-1 A' (Woodbury), of which the blocks are needed
        inner = np.linalg.inv(a.T @ a + fit.scale**2 * np.eye(a.shape[1]))
        y = root * z0
        e = (y - a @ (inner @ (a.T @ y))).reshape(n, c)
        blocks = a.reshape(n, c, -1)
        left = np.eye(c) - (blocks @ inner) @ blocks.transpose(0, 2, 1)
        d2 = (e * np.linalg.solve(left + 1e-9 * np.eye(c), e[:, :, None])[:, :, 0]).sum(axis=1) / weight
        scale2 = max(float(np.median(d2) / stats.chi2.median(c)), 1e-6)
        weight = np.minimum((STUDENT_NU + c) / (STUDENT_NU + d2 / scale2), 1.0)
    # poses that are merely a little off keep their full weight: the evidence is Gaussian
    return np.where(weight > 0.35, 1.0, weight)


class Engine:
    """Scores everything at one fit: candidates and map cells by the same formula.

    drop: an effect of the fit that is to compete again. The point of linearisation stays the fit WITH
    it: a large effect bends the DH errors, and columns taken beside the truth would favour cousins.
    granted: (rows, m) columns that count as known to be there, at any size, like the DH errors.
    """

    def __init__(
        self,
        fit: Fit,
        weight: np.ndarray,
        stated: bool,
        drop: Hypothesis | None = None,
        granted: np.ndarray | None = None,
    ):
        self.columns = Columns(fit, weight)
        keep = np.array(
            [drop is None or not name.startswith(f"{drop.name}.") for name in fit.names], dtype=bool
        )
        nuisance = self.columns.weighted(fit.J[:, keep]) * fit.sigma_prior[keep]
        if granted is not None:
            nuisance = np.hstack([nuisance, _GRANTED_WIDTH * granted])
        self.projector = Projector.of(nuisance)
        z0 = self.columns.weighted(fit.z + fit.J @ fit.estimate)
        self.wz = self.projector.apply(z0)
        rows = float((weight > 0.35).sum() * self.columns.c)
        self.dof = max(rows - self.projector.spent, 1.0)
        self.noise = NoiseScale.posterior(float(self.wz @ self.wz), self.dof, stated=stated)
        self.scale = float((self.noise.s * self.noise.weight).sum())

    def score(self, columns: np.ndarray) -> Score:
        """Score of one block of columns."""
        return self.scores([columns])[0][0]

    def scores(self, blocks: list[np.ndarray]) -> list[tuple[Score, float]]:
        """Score and ln Bayes factor of each block; those of one width together."""
        out: dict[int, tuple[Score, float]] = {}
        by_width: dict[int, list[int]] = {}
        for k, block in enumerate(blocks):
            by_width.setdefault(block.shape[1], []).append(k)
        for places in by_width.values():
            g = np.stack([blocks[k] for k in places])
            found = scores(g, self.projector.grams(g), self.wz)
            ln_bf = ln_bayes_factor(
                np.stack([s.u for s in found]), np.stack([s.v for s in found]), self.noise
            )
            out |= dict(zip(places, zip(found, map(float, ln_bf), strict=True), strict=True))
        return [out[k] for k in range(len(blocks))]

    def candidates(self, candidates: list[Candidate]) -> list[Scored]:
        flat = [(candidate, h) for candidate in candidates for h in candidate.variants]
        blocks = [self.columns.hypothesis(h) for _, h in flat]
        found: dict[str, list[Scored]] = {}
        for (candidate, h), block, (s, ln_bf) in zip(flat, blocks, self.scores(blocks), strict=True):
            one = Scored(candidate.name, ln_bf, s, h, block, self.projector, self.wz)
            found.setdefault(candidate.name, []).append(one)
        out = []
        for candidate in candidates:
            variants = found[candidate.name]
            best = max(variants, key=lambda f: f.ln_bf)
            weights = np.array(candidate.weights or np.ones(len(variants)))
            ln_mean = np.logaddexp.reduce(np.log(weights / weights.sum()) + [f.ln_bf for f in variants])
            out.append(replace(best, ln_bf=float(ln_mean)))
        return out

    def map(self, *, double: bool = True) -> list[Scored]:
        """All cells; double: also those with two drivers."""
        made = cells(self.columns, double=double)
        scored = self.scores([cell.columns for cell in made])
        return [
            Scored(cell.name, ln_bf, s, cell, cell.columns, self.projector, self.wz)
            for cell, (s, ln_bf) in zip(made, scored, strict=True)
        ]

    @cached_property
    def null(self) -> np.ndarray:
        """(rows, draws) W z of noise alone."""
        z = np.random.default_rng(1).standard_normal((len(self.wz), _NULL_DRAWS))
        return self.projector.apply(z)


def unknown(mapped: list[Scored], known: list[Scored]) -> list[Scored]:
    """The cells without those that are the very function of a known effect: that effect is not novel."""
    taken, mine = _directions(known), _directions(mapped)
    if not taken or not mine:
        return mapped
    cosine = np.abs(np.array(list(mine.values())) @ np.array(list(taken.values())).T).max(axis=1)
    same = {name for name, x in zip(mine, cosine, strict=True) if x > _SAME}
    return [s for s in mapped if s.name not in same]


def _directions(scored) -> dict[str, np.ndarray]:
    """Unit vectors of those with a single column."""
    single = {s.name: s.columns[:, 0] for s in scored if s.block.shape[1] == 1}
    return {name: x / np.linalg.norm(x) for name, x in single.items() if np.linalg.norm(x) > 0}


def family_p(engine: Engine, scored: list[Scored]) -> dict[str, float]:
    """Family-wise p-value of each score test: draws from the null give the distribution of the least p."""
    least = np.ones(_NULL_DRAWS)
    own: dict[str, float] = {}
    noise = engine.null
    both = np.hstack([noise, engine.wz[:, None] / engine.scale])
    by_rank: dict[int, list[tuple[str, np.ndarray]]] = {}
    for s in scored:
        if s.score.rank == 0:
            own[s.name] = 1.0
            continue
        value, vector = np.linalg.eigh(s.columns.T @ s.columns)
        good = value > 1e-10 * value.max()
        white = (vector[:, good].T @ (s.columns.T @ both)) / np.sqrt(value[good])[:, None]
        by_rank.setdefault(int(good.sum()), []).append((s.name, (white**2).sum(axis=0)))
    for rank, found in by_rank.items():
        square = np.array([square for _, square in found])
        least = np.minimum(least, stats.chi2.sf(square[:, :-1].max(axis=0), rank))
        p = stats.chi2.sf(square[:, -1], rank)
        own |= {name: float(x) for (name, _), x in zip(found, p, strict=True)}
    least.sort()
    count = len(least)
    out = {}
    for name, p in own.items():
        drawn = float((np.searchsorted(least, p, side="right") + 1) / (count + 1))
        # below what the draws resolve: Bonferroni
        out[name] = min(drawn, max(p * len(own), 0.0)) if p * len(own) < 1.0 / count else drawn
    return out
