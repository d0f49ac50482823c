"""Scores every hypothesis and every cell of the map at one fit, by the same formula."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Generic, TypeVar

import numpy as np

from ..data.measurements import Measurements
from ..fit.columns import Columns
from ..fit.least_squares import Fit, distance_beside, student_weights, taken_by
from ..model.effects import Hypothesis
from ..model.hypotheses import Candidate
from ..numerics.distributions import chi2_quantile, chi2_tail
from ..numerics.types import Array, Mask, array
from .bayes_factors import (
    Moments,
    NoiseScale,
    Projector,
    Score,
    block_moments,
    flat_p,
    ln_bayes_factor,
    scores,
    together,
)
from .finer import finer_cells
from .products import ProductScores, score_products
from .unnamed import Cell, cell_moments, cells

_EQUAL_MOVES = 0.01  # share of a joint's last moves that their sign does not explain
_UNKNOWN_MOVE = 1e-3  # weight of a pose of unknown last move where an effect of that move may add to it
_BULK = 0.35  # Student-t weight from which on a pose gets full weight: the evidence is Gaussian
_NULL_DRAWS = 400
_GRANTED_WIDTH = 30.0  # prior sigmas
_SAME = 1.0 - 1e-6  # cosine of two columns that are the same function
_REWEIGHTINGS = 6
_CANCELS = 1e-4  # of an effect's squares: of what is left below it, differences show rounding alone

What = TypeVar("What", Hypothesis, Cell, covariant=True)


@dataclass(frozen=True)
class Scored(Generic[What]):
    """A named effect or a cell of the map with its evidence.

    ln_bf: ln Bayes factor against "nothing missing"; best: the variant with the most evidence;
    make: gives its columns G; signal: (rows,) W z0, what there is to explain; tries: functions of which a
    cell is the best.
    """

    name: str
    ln_bf: float
    score: Score
    best: What
    make: Callable[[], Array]
    projector: Projector
    signal: Array
    tries: int = 1

    @property
    def block(self) -> Array:
        """(rows, m) columns G."""
        return self.make()

    @property
    def columns(self) -> Array:
        """(rows, m) W G: what of the effect the nuisance parameters cannot imitate."""
        return self.projector.apply(self.block)


def bulk_weights(fit: Fit) -> Array:
    """(N,) weights of a fit, those of good poses raised to 1."""
    return np.where(fit.good, 1.0, fit.weight)


def robust_weights(fit: Fit, candidates: Sequence[Candidate]) -> Array:
    """(N,) Student-t pose weights under DH plus ALL effects at prior width, so that an effect is not
    mistaken for outliers (METHOD.md 12.2): all but those that act alike at all poses, and those of the last
    move, which takes any value anywhere and so makes room for any bad pose. Poses that are merely a little
    off keep their full weight."""
    n, c = fit.evaluation.r.shape
    plain = Columns(fit, np.ones(n))
    first = [candidate.variants[0] for candidate in candidates if candidate.prior > 0]
    blocks = plain.hypotheses([h for h in first if not (h.even or h.of_last_move)])
    big = np.hstack([fit.J * fit.sigma_prior, *blocks])
    z0 = fit.z + fit.J @ fit.estimate
    weight = np.ones(n)
    for _ in range(_REWEIGHTINGS):
        d2 = _ridge_distance(big, z0, weight, fit.scale, c)
        scale2 = max(float(np.median(d2) / chi2_quantile(0.5, c)), 1e-6)
        weight = student_weights(d2 / scale2, c)
    weight = np.where(weight > _BULK, 1.0, weight)
    weight[_undecided_by_move(fit.data)] *= _UNKNOWN_MOVE
    return weight


def of_known_moves(weight: Array, data: Measurements) -> Array:
    """(N,) weights beside an effect of the last move: what it does at poses whose last move nobody knows is
    not in the model, and nothing else is to explain it."""
    if data.move is None:
        return weight
    return array(np.where(data.move.any(axis=1), weight, np.minimum(weight, _UNKNOWN_MOVE)))


def _undecided_by_move(data: Measurements) -> Mask:
    """(N,) poses of unknown last move, the first ones of sessions, where a joint's last moves are as good as
    equally long forth, and back: but for these poses their length is a function of their sign."""
    if data.move is None or data.direction is None:
        return np.zeros(data.n, dtype=bool)
    known = data.move.any(axis=1)
    for move, sign in zip(data.move[known].T, data.direction[known].T, strict=True):
        sides = [move[sign == side] for side in (-1.0, 0.0, 1.0)]
        left = sum(float(((side - side.mean()) ** 2).sum()) for side in sides if side.size)
        spread = float(((move - move.mean()) ** 2).sum())
        if spread > 0.0 and left <= _EQUAL_MOVES * spread:
            return np.asarray(~known, dtype=bool)
    return np.zeros(data.n, dtype=bool)


def _ridge_distance(columns: Array, z0: Array, weight: Array, scale: float, c: int) -> Array:
    """(N,) d_i^2 = e_i' (I - H_ii)^-1 e_i of the residuals e of a ridge fit with weighted rows.

    Of rows A, H = A (s^2 I + A'A)^-1 A'.
    """
    root = np.repeat(np.sqrt(weight), c)
    taken = taken_by(columns * (root / scale)[:, None])
    y = root * z0
    e = (y - taken @ (taken.T @ y)).reshape(len(weight), c)
    blocks = taken.reshape(len(weight), c, -1)
    return array(distance_beside(e, blocks @ blocks.transpose(0, 2, 1)) / weight)


class Scorer:
    """Scores at one fit: candidates and map cells by the same formula.

    weight: (N,) pose weights, 1 but for outliers; stated: the data state their noise; drop: effects of
    the fit that are to compete again (the point of linearisation stays the fit WITH it: a large effect bends
    the DH errors, and columns taken beside it would favour other effects); granted: (rows, m) columns that
    count as known to be there, at any size, like the DH errors.

    wz: (rows,) W z0; scale: expected noise over stated noise.
    """

    def __init__(
        self,
        fit: Fit,
        weight: Array,
        stated: bool,
        drop: Sequence[Hypothesis] = (),
        granted: Array | None = None,
    ):
        self.columns = Columns(fit, weight)
        keep = _nuisance(fit, drop)
        # priors against the noise there is: stand-in noise of 1 mm would keep a fit of 0.1 mm from moving
        noise = 1.0 if stated else fit.scale
        nuisance = self.columns.weighted(fit.J[:, keep]) * fit.sigma_prior[keep] / noise
        if granted is not None:
            nuisance = np.hstack([nuisance, _GRANTED_WIDTH * granted])
        self.projector = Projector.of(nuisance)
        self.wz = self.projector.apply(self.columns.weighted(fit.z + fit.J @ fit.estimate))
        rows = float((weight == 1.0).sum() * self.columns.c)
        dof = max(rows - self.projector.spent, 1.0)
        self.noise = NoiseScale.posterior(float(self.wz @ self.wz), dof, stated=stated)
        self.scale = self.noise.mean

    @property
    def left(self) -> float:
        """z'Wz: the squares that are left to explain."""
        return float(self.wz @ self.wz)

    def scores(self, blocks: Sequence[Array]) -> list[tuple[Score, float]]:
        """Score and ln Bayes factor of each block (rows, m)."""
        return self._scores(block_moments(blocks, self._known))

    @cached_property
    def _known(self) -> Array:
        """(rows, k + 1) what the moments of blocks are taken with: the projector's basis, and W z0."""
        return np.column_stack([self.projector.basis, self.wz])

    def _scores(self, moments: Iterable[Moments]) -> list[tuple[Score, float]]:
        """Score and ln Bayes factor of blocks in their places, from their moments with `_known`."""
        out: dict[int, tuple[Score, float]] = {}
        for some in together(moments):
            gram = self.projector.gram(some.own, some.cross[:, :, :-1])
            found = scores(some.own, gram, some.cross[:, :, -1])
            ln_bf = ln_bayes_factor(found.u, found.v, self.noise)
            out |= zip(some.places, zip(found.each(), ln_bf.tolist(), strict=True), strict=True)
        return [out[k] for k in range(len(out))]

    def hypotheses(self, hypotheses: Sequence[Hypothesis]) -> list[tuple[Score, float]]:
        """Score and ln Bayes factor of each hypothesis."""
        return self.scores(self.columns.hypotheses(hypotheses))

    def candidates(self, candidates: Sequence[Candidate]) -> list[Scored[Hypothesis]]:
        """Each candidate with its evidence averaged over its variants."""
        variants = [h for candidate in candidates for h in candidate.variants]
        blocks = self.columns.hypotheses(variants)
        rows = iter(zip(variants, blocks, self.scores(blocks), strict=True))
        return [
            self._averaged(candidate, [next(rows) for _ in candidate.variants]) for candidate in candidates
        ]

    def _averaged(
        self, candidate: Candidate, rows: list[tuple[Hypothesis, Array, tuple[Score, float]]]
    ) -> Scored[Hypothesis]:
        """The variant with the most evidence, with the evidence of all of them by weight."""
        h, block, (score, _) = max(rows, key=lambda row: row[2][1])
        weights = np.array(candidate.weights or np.ones(len(rows)))
        ln_mean = np.logaddexp.reduce(np.log(weights / weights.sum()) + [row[2][1] for row in rows])
        return Scored(candidate.name, float(ln_mean), score, h, lambda: block, self.projector, self.wz)

    def map(self, *, double: bool = True) -> list[Scored[Cell]]:
        """All cells of the location x driver map; double: also those with two drivers."""
        made = cells(self.columns, double=double)
        finer = finer_cells(self.columns)
        found = self._as_cells([*made, *finer], self._scores(cell_moments([*made, *finer], self._known)))
        return _with_variants(found[: len(made)], found[len(made) :])

    def products(self) -> tuple[list[Scored[Cell]], ProductScores | None]:
        """The products of two drivers with the most evidence, as cells, and the evidence of all of them."""
        found = score_products(self.columns, self.projector, self.wz, self.noise)
        one = np.ones((self.columns.n, 1))
        made = [
            Cell(p.place.name, p.drivers, p.column.reshape(self.columns.n, 1, -1), one, p)
            for p in (found.best if found else ())
        ]
        return self._as_cells(made, self.scores([cell.columns for cell in made])), found

    def _as_cells(self, made: Sequence[Cell], found: Sequence[tuple[Score, float]]) -> list[Scored[Cell]]:
        return [
            Scored(cell.name, ln_bf, score, cell, partial(getattr, cell, "columns"), self.projector, self.wz)
            for cell, (score, ln_bf) in zip(made, found, strict=True)
        ]

    @cached_property
    def null(self) -> Array:
        """(rows, draws) W z of noise alone."""
        z = np.random.default_rng(1).standard_normal((len(self.wz), _NULL_DRAWS))
        return self.projector.apply(z)


def _with_variants(found: Sequence[Scored[Cell]], variants: Sequence[Scored[Cell]]) -> list[Scored[Cell]]:
    """Cells with the evidence of all functions of the same name, each as likely, and the best of these."""
    of_name: dict[str, list[Scored[Cell]]] = {}
    for s in variants:
        of_name.setdefault(s.name, []).append(s)
    return [_averaged(s, of_name[s.name]) if s.name in of_name else s for s in found]


def _averaged(cell: Scored[Cell], variants: Sequence[Scored[Cell]]) -> Scored[Cell]:
    every = (cell, *variants)
    ln_mean = np.logaddexp.reduce([s.ln_bf for s in every]) - np.log(len(every))
    return replace(max(every, key=lambda s: s.ln_bf), ln_bf=float(ln_mean), tries=len(every))


def _nuisance(fit: Fit, drop: Sequence[Hypothesis]) -> Mask:
    """(k,) coefficients of the fit that are marginalised: all but those of the dropped effects."""
    dropped = {f"{h.name}.{p.name}" for h in drop for p in h.parameters}
    return np.array([name not in dropped for name in fit.names], dtype=bool)


def unexplained(mapped: Sequence[Scored[Cell]], known: Sequence[Scored[Hypothesis]]) -> list[Scored[Cell]]:
    """The cells without those that are the very function of a known effect: that effect is not unnamed."""
    taken, mine = _directions(known), _directions(mapped)
    if not taken or not mine:
        return list(mapped)
    cosine = np.abs(np.array(list(mine.values())) @ np.array(list(taken.values())).T).max(axis=1)
    same = {name for name, x in zip(mine, cosine, strict=True) if x > _SAME}
    return [s for s in mapped if s.name not in same]


def _directions(scored: Sequence[Scored[Hypothesis] | Scored[Cell]]) -> dict[str, Array]:
    """Unit vectors of those with a single column."""
    single = [s for s in scored if len(s.score.u) == 1]
    if not single:
        return {}
    columns = single[0].projector.apply(np.hstack([s.block for s in single]))
    length = np.linalg.norm(columns, axis=0)
    return {s.name: columns[:, k] / length[k] for k, s in enumerate(single) if length[k] > 0}


def family_p(scorer: Scorer, scored: Sequence[Scored[Hypothesis] | Scored[Cell]]) -> dict[str, float]:
    """Family-wise p-value of each score test by name: draws from the null give the distribution of the
    least p over everything tested (Westfall, Young, Resampling-Based Multiple Testing, 1993)."""
    own = {s.name: 1.0 for s in scored if s.score.rank == 0}
    least = np.ones(_NULL_DRAWS)
    for rank, (names, square) in _squares(scorer, [s for s in scored if s.score.rank > 0]).items():
        least = np.minimum(least, chi2_tail(square[:, :-1].max(axis=0), rank))
        p = chi2_tail(square[:, -1], rank)
        own |= {name: float(x) for name, x in zip(names, p, strict=True)}
    least.sort()
    return {name: _family_wise(p, least, len(own)) for name, p in own.items()}


def _squares(
    scorer: Scorer, scored: Sequence[Scored[Hypothesis] | Scored[Cell]]
) -> dict[int, tuple[list[str], Array]]:
    """By rank: names and (tests, draws + 1) chi^2 of the null draws and, last, of the data."""
    twice, z = scorer.projector.squared, np.hstack([scorer.null, scorer.wz[:, None] / scorer.scale])
    moments = _moments(scored, np.hstack([twice.basis, scorer.projector.apply(z)]))
    found: dict[int, tuple[list[str], list[Array]]] = {}
    for some in together(moments):
        seen, u = np.split(some.cross, [twice.basis.shape[1]], axis=2)
        gram = twice.gram(some.own, seen)
        whole, left = (np.trace(x, axis1=1, axis2=2) for x in (some.own, gram))
        for k in np.flatnonzero(left < _CANCELS * whole):
            columns = scored[some.places[k]].columns
            gram[k], u[k] = columns.T @ columns, columns.T @ z
        for k, rank, row in zip(some.places, *_tested(gram, u), strict=True):
            names, rows = found.setdefault(int(rank), ([], []))
            names.append(scored[k].name)
            rows.append(row)
    return {rank: (names, np.array(rows)) for rank, (names, rows) in found.items()}


def _moments(scored: Sequence[Scored[Hypothesis] | Scored[Cell]], columns: Array) -> Iterator[Moments]:
    """Moments with columns (rows, d)."""
    made = {k: s.best for k, s in enumerate(scored) if isinstance(s.best, Cell)}
    others = {k: s.block for k, s in enumerate(scored) if k not in made}
    for kind, found in (
        (list(made), cell_moments(list(made.values()), columns)),
        (list(others), block_moments(list(others.values()), columns)),
    ):
        yield from (replace(one, places=[kind[k] for k in one.places]) for one in found)


def _tested(gram: Array, u: Array) -> tuple[Array, Array]:
    """Ranks (k,) and chi^2 (k, d) of blocks with G'WWG (k, m, m) and G'W times columns (k, m, d)."""
    value, vector = np.linalg.eigh(gram)
    good = value > 1e-10 * value.max(axis=1, keepdims=True)
    white = vector.transpose(0, 2, 1) @ u
    square = np.where(good, 1.0 / np.where(good, value, 1.0), 0.0)[:, None, :] @ white**2
    return good.sum(axis=1), square[:, 0, :]


def _family_wise(p: float, least: Array, tests: int) -> float:
    """Share of null draws with a smaller least p; Bonferroni below what the draws resolve."""
    drawn = float((np.searchsorted(least, p, side="right") + 1) / (len(least) + 1))
    return min(drawn, max(p * tests, 0.0)) if p * tests < 1.0 / len(least) else drawn


def scaled_p(scored: Scored[Cell], scale: float) -> float:
    """p-value of one score test at a noise scale, for its tries (Bonferroni)."""
    return min(1.0, scored.tries * flat_p(scored.score.chi2 / scale**2, scored.score.rank))
