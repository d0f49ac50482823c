"""One data set under study: what stays the same while effects are tried; fits and posteriors of any model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from ..comparison.compare import Comparison
from ..data.measurements import Measurements
from ..data.split import Split
from ..evidence.adequacy import ADEQUATE_P, lack_of_fit, noise_floor
from ..evidence.scoring import Scorer, bulk_weights, of_known_moves, robust_weights
from ..evidence.swing import swing
from ..fit.least_squares import Fit, fit_model, rms
from ..fit.thinning import MANY, part_of
from ..model.effects import Hypothesis, Library
from ..model.flight_model import room_for
from ..model.grids import finer
from ..model.hypotheses import Competition, merged_if_several
from ..numerics.types import Array, Groups, Indices, array
from ..prediction.crossval import folds, predicted, stretches
from ..prediction.nested import FEW_HELD, LEAST_IN_TURNS, TURNS, Block, blocks
from ..prediction.reachable import PosRot
from .heldout import NO_HELD_OUT, HeldGain
from .posterior import Posterior
from .subsets import fewest_joints, joints_with
from .support import Support, of_turns, worse_blocks

Model = tuple[Hypothesis, ...]
"""The effects of a model beside DH, frames and what was given."""

T = TypeVar("T")

_FITTED_ANEW = 300  # poses up to which each turn is a fit of its own
_OF_COMPETITION = ("beside", "for")  # what a study remembers of the effects that compete
_ROWS_EACH = 4.0  # degrees of freedom that each coefficient of an effect needs


@dataclass(frozen=True)
class Study:
    """Data, candidates and weights of one diagnosis. Nothing of it changes; its functions depend on
    their arguments only and remember what they have computed.

    weight: (N,) robust weights under DH plus all effects; stated: the data state their noise; given: effects
    that are in the model from the start; dh: DH errors are; in_stretches: the noise is correlated in time, so
    that stretches of the session are held out in turns, and neither the evidence nor single held-out poses,
    whose neighbours were fitted, count.
    """

    comparison: Comparison
    library: Library
    given: Model
    dh: bool
    competition: Competition
    weight: Array
    in_stretches: bool = False
    _memory: dict[tuple[object, ...], object] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, comparison: Comparison, library: Library, given: Sequence[Hypothesis], dh: bool) -> Study:
        """Prepare the candidates for what the given model leaves. comparison: of that model with the data."""
        base = comparison.fit_all
        competition = Competition.of(base.arm, base.data, library, {h.name for h in given})
        weight = robust_weights(base, competition.candidates)
        return cls(comparison, library, tuple(given), dh, competition, weight)

    def judging(self, comparison: Comparison) -> Study:
        """The same study of all poses, where this one has a part of them: for fits and held-out errors, too
        large for posteriors. comparison: of the given model with all poses."""
        if comparison is self.comparison:
            return self
        weight = np.ones(comparison.fit_all.data.n)
        return replace(self, comparison=comparison, weight=weight, _memory={})

    def by_stretches(self) -> Study:
        """The same study, judged by stretches of the session that are held out."""
        return replace(self, in_stretches=True, _memory={})

    def without(self, effect: str) -> Study:
        """The same study with an effect that does not compete."""
        fits = {key: known for key, known in self._memory.items() if key[0] not in _OF_COMPETITION}
        return replace(self, competition=self.competition.without(effect), _memory=fits)

    @property
    def base(self) -> Fit:
        """The given model fitted to the data."""
        return self.comparison.fit_all

    @property
    def stated(self) -> bool:
        """The data state their noise."""
        return self.base.data.cov is not None

    @property
    def has_held_out(self) -> bool:
        """Some poses can be held out, so that gains can be tested."""
        return len(self.comparison.split.held) > 0 or self._few

    @property
    def _few(self) -> bool:
        """Too few poses are held out for an interval, or the wrong ones, and enough are there to take
        turns."""
        few = self.in_stretches or len(self.comparison.split.held) < FEW_HELD
        return few and self.can_take_turns

    @property
    def _pool(self) -> Measurements:
        """The poses that may be fitted."""
        return self.base.data

    @property
    def part_weight(self) -> Array:
        """Robust weights of the poses that `held_fit` uses."""
        split = self.comparison.split
        return self.weight if split.given else self.weight[split.fit]

    def _remembered(self, key: tuple[object, ...], make: Callable[[], T]) -> T:
        if key not in self._memory:
            self._memory[key] = make()
        return self._memory[key]  # type: ignore[return-value]

    def fit(self, model: Model) -> Fit:
        """These effects beside the given ones, fitted to the data."""
        base = self.base
        if not model:
            return base
        return self._remembered(("fit", model), lambda: self._fit_to(base.data, base, model))

    def explains(self, model: Model) -> bool:
        """These effects explain the data to within a noise that is known and not correlated."""
        if self.in_stretches:
            return False
        fit = self.fit(model)
        p = lack_of_fit(fit, noise_floor(fit))
        return p is not None and p > ADEQUATE_P

    def room(self, model: Model) -> int:
        """Coefficients that may still be added to this model: what the core carries, and what the poses do.

        Every coefficient beside DH and frames needs at least `_ROWS_EACH` degrees of freedom of the poses
        that are fitted while others are held out."""
        used = sum(len(h.parameters) for h in model)
        by_poses = int(self.comparison.fit_part.dof / _ROWS_EACH) - used
        return max(min(room_for(self.fit(model).parameters), by_poses), 0)

    def scorer(self, model: Model, drop: Model = (), granted: Array | None = None) -> Scorer:
        """Scores at the fit of this model; drop, granted: as of `Scorer`. A frame that swings with time is
        fitted with it, and competes like what is dropped: in its noise it would hide."""
        of_moves = any(h.of_last_move for h in (*self.given, *model))
        weight = of_known_moves(self.weight, self.base.data) if of_moves else self.weight
        fit, wave = self._with_swing(self.fit(model), model)
        return Scorer(fit, weight, self.stated, drop=(*drop, *wave), granted=granted)

    def _with_swing(self, fit: Fit, model: Model) -> tuple[Fit, Model]:
        """A fit of a model with the swing that it leaves, and that swing; itself where it leaves none."""
        if (wave := swing(fit)) is None:
            return fit, ()
        return self._fit_to(fit.data, fit, (*model, wave)), (wave,)

    def held_scorer(self, model: Model) -> Scorer:
        """Scores at the fit of this model without the held-out poses, if there are some."""
        return self.scorer_at(self.held_fit(model) if self.has_held_out else self.fit(model), model)

    def scorer_at(self, fit: Fit, model: Model) -> Scorer:
        """The same at a fit of this model to any poses."""
        fit, wave = self._with_swing(fit, model)
        return Scorer(fit, bulk_weights(fit), self.stated, drop=wave)

    def posterior(self, model: Model) -> Posterior:
        """What this model leaves to explain, and by what."""
        return self._remembered(
            ("beside", model),
            lambda: Posterior.at(self.scorer(model), self.competition.open([*self.given, *model])),
        )

    def reopened(self, model: Model, h: Hypothesis, grid: Model = ()) -> Posterior:
        """What competes for the place of effect `h` of this model, linearised at the fit that has it; grid:
        its closer search for constants, which replaces that part of the library's grid."""
        return self._remembered(("for", model, h, grid), lambda: self._reopened(model, h, grid))

    def _reopened(self, model: Model, h: Hypothesis, grid: Model) -> Posterior:
        open_ = self.competition.open([*self.given, *(x for x in model if x is not h)])
        open_ = self.competition.with_itself(open_, h)
        candidates = [c.refined(grid) if grid and c.name == h.name else c for c in open_]
        return Posterior.at(self.scorer(model, drop=(h,)), candidates)

    def fewest_joints(self, model: Model, h: Hypothesis) -> Hypothesis | None:
        """An effect of this model at fewer joints that explain as much; None if all of them are needed."""
        return fewest_joints(self.scorer(model, drop=(h,)), h) if len(joints_with(h)) > 2 else None

    def constants_of(self, h: Hypothesis) -> tuple[str, ...]:
        """Constants of an effect that are searched on a grid."""
        return tuple(self.library.grid_of(h.name))

    def closer(self, h: Hypothesis, constant: str) -> Model:
        """The effect with values of a constant about the present one, closer than the library's grid has
        them; empty where that grid is a plain list."""
        effect, known = self.library.effects[h.effect], dict(h.constants)
        arm, data, name = self.base.arm, self.base.data, h.name
        return tuple(
            merged_if_several(effect, self.library.find(name, arm, data, {**known, constant: value}), name)
            for value in finer(self.library.grid_of(h.name)[constant], known[constant], data)
        )

    def held_fit(self, model: Model) -> Fit:
        """These effects beside the given ones, fitted without the held-out poses."""
        part = self.comparison.fit_part
        if not model:
            return part
        return self._remembered(("held", model), lambda: self._fit_to(part.data, part, model))

    def _fit_to(self, data: Measurements, near: Fit, model: Model) -> Fit:
        """A fit that begins where another one is, with the constants that the given effects have there."""
        frames, start = (near.base, near.tool), dict(zip(near.names, near.estimate, strict=True))
        given = near.hypotheses[: len(self.given)]
        return fit_model(near.arm, data, [*given, *model], dh=self.dh, frames=frames, start=start)

    def held_error(self, model: Model) -> PosRot:
        """RMS error of the held-out poses [m], [rad], NaN if there are none; the model is fitted to
        the others."""
        held = self.comparison.held_data
        return (float("nan"), None) if held is None else rms(self._held_residual(model, held))

    def _held_residual(self, model: Model, held: Measurements) -> Array:
        return self._remembered(("residual", model), lambda: self.held_fit(model).predict(held))

    def held_square(self, model: Model) -> Array:
        """(M,) squared position error [m^2] of poses that the model was not fitted to: the held-out ones,
        or all poses in turns where those are too few."""
        return _square(self._held(model))

    def _held(self, model: Model) -> Array:
        turns = self._judged is self._pool
        return self._in_turns(model) if turns else self._held_residual(model, self._judged)

    @property
    def _judged(self) -> Measurements:
        """The poses of `held_square`."""
        held = self.comparison.held_data
        return self._pool if self._few or held is None else held

    def _in_turns(self, model: Model) -> Array:
        """(N, c) residuals of the poses that may be fitted, each fold predicted by a fit to the others."""
        return self._remembered(("turns", model), lambda: self._predicted_in_turns(model))

    def _predicted_in_turns(self, model: Model) -> Array:
        data = self._pool
        if self.in_stretches and data.n > _FITTED_ANEW:
            return predicted(self.fit(model), self._turns)
        r, fold = np.zeros((data.n, data.components)), self._turns
        for k in np.unique(fold):
            out = fold == k
            r[out] = self._fit_to(data.take(~out), self.base, model).predict(data.take(out))
        return r

    @property
    def _turns(self) -> Indices:
        """(N,) number of the turn in which each pose is held out."""
        return stretches(self._pool, TURNS) if self.in_stretches else folds(self._pool, TURNS)

    @property
    def _alike(self) -> Groups | None:
        """(M,) of the judged poses: number of the group of replicates, or of the stretch, half a turn, whose
        poses have noise in common. None if each has its own."""
        return stretches(self._judged, 2 * TURNS) if self.in_stretches else self._judged.repeats

    @property
    def can_take_turns(self) -> bool:
        """Enough poses are there to be held out in turns."""
        return self._pool.n >= LEAST_IN_TURNS

    def support(self, model: Model, h: Hypothesis) -> Support | None:
        """What poses that were not fitted say of an effect beside the others of a model; None where too few
        poses are there, or too few coefficients are left."""
        if not self._can_test(model, h):
            return None
        without, with_it = self._without_and_with(model, h)
        return self._remembered(("support", without, with_it), lambda: self._supported(without, with_it))

    def worse_blocks(self, model: Model, h: Hypothesis) -> tuple[str, ...]:
        """Those of `support` that an effect makes worse, without what takes longer: poses in turns."""
        return self._worse_blocks(*self._without_and_with(model, h)) if self._can_test(model, h) else ()

    def _can_test(self, model: Model, h: Hypothesis) -> bool:
        return self.can_take_turns and len(h.parameters) <= room_for(self.fit(model).parameters)

    def _worse_blocks(self, without: Model, with_it: Model) -> tuple[str, ...]:
        return worse_blocks(self._in_blocks(without, with_it), self._in_blocks(with_it, with_it))

    def _supported(self, without: Model, with_it: Model) -> Support:
        if self._pool.n <= _FITTED_ANEW:
            before, after = self._in_turns(without), self._in_turns(with_it)
        else:  # linear at the fit of each: to fit anew takes far longer and says the same
            before, after = (predicted(self.fit(some), self._turns) for some in (without, with_it))
        if self.in_stretches:
            found = of_turns(before, after, TURNS, stretches(self._pool, 2 * TURNS))
            return found.beside(self._worse_blocks(without, with_it))
        groups = self._pool.repeats
        if self.comparison.split.given and (held := self.comparison.held_data) is not None:
            before = np.vstack([before, self._held_residual(without, held)])
            after = np.vstack([after, self._held_residual(with_it, held)])
            groups = _together(groups, self._pool.n, held)
        return of_turns(before, after, TURNS, groups).beside(self._worse_blocks(without, with_it))

    def support_of(self, model: Model, chosen: Callable[[Fit], Hypothesis | None]) -> Support | None:
        """The same for an effect whose terms are chosen from the data, beside a model: in each turn from the
        poses that are fitted, since terms chosen from all of them know those that are held out. chosen: gives
        the effect beside a fit, None if it has none; of many poses, a part."""
        if not self.can_take_turns:
            return None
        data = self._pool.take(part_of(self._pool)) if self._pool.n > MANY else self._pool
        turn = stretches(data, TURNS) if self.in_stretches else folds(data, TURNS)
        before, after = np.zeros((2, data.n, data.components))
        for k in np.unique(turn):
            out = turn == k
            fit = self._fit_to(data.take(~out), self.base, model)
            h = chosen(fit)
            before[out] = after[out] = fit.predict(data.take(out))
            if h is not None:
                after[out] = self._fit_to(fit.data, fit, (*model, h)).predict(data.take(out))
        return of_turns(
            before, after, TURNS, stretches(data, 2 * TURNS) if self.in_stretches else data.repeats
        )

    def linear_gain(self, model: Model, columns: Callable[[Fit], Array]) -> tuple[HeldGain, Support] | None:
        """What poses that were not fitted gain from a function that no term can hold: of all poses in turns,
        linear at the fit, where `columns` gives its whitened ones. None where too few poses are there."""
        if not self.can_take_turns:
            return None
        fit, groups = self.fit(model), self._pool.repeats
        if self.in_stretches:
            groups = stretches(self._pool, 2 * TURNS)
        before, after = predicted(fit, self._turns), predicted(fit, self._turns, columns(fit))
        gain = HeldGain.of(_square(before), _square(after), groups, cross_validated=True)
        return _with_rotation(gain, before, after), of_turns(before, after, TURNS, groups)

    def black_box_gains(self, model: Model) -> bool:
        """A black box beside the given model predicts held-out poses better than this one, beyond chance."""
        box = None if self.in_stretches else self.comparison.reachable
        if box is None or box.judged is None or box.left is None:
            return False
        mine = self.held_fit(model).predict(box.judged)
        return HeldGain.of(_square(mine), _square(box.left), box.judged.repeats, cross_validated=False).gains

    def _in_blocks(self, model: Model, near: Model) -> dict[str, Array]:
        """(M, c) residuals [m, rad] of an unseen region, a time block and one direction of approach (of many
        poses, of a part), each predicted by a fit to the other poses that begins where that of `near` is."""
        return self._remembered(("blocks", model, near), lambda: self._predicted_in_blocks(model, near))

    def _predicted_in_blocks(self, model: Model, near: Model) -> dict[str, Array]:
        pool, begin = self._pool, self.fit(near)
        data = pool.take(part_of(pool)) if pool.n > MANY else pool

        def left(block: Block) -> Array:
            return self._fit_to(data.take(block.fit), begin, model).predict(data.take(block.held))

        every = Split(np.arange(data.n), np.arange(0), False)
        return {block.name: left(block) for block in blocks(data, every)}

    @staticmethod
    def _without_and_with(model: Model, h: Hypothesis) -> tuple[Model, Model]:
        others = tuple(x for x in model if x.name != h.name)
        return others, model if h in model else (*others, h)  # one order, one fit

    def held_gain(self, model: Model, h: Hypothesis) -> HeldGain:
        """What held-out poses gain from an effect, the other effects of the model with and without it."""
        if not self.has_held_out or len(h.parameters) > room_for(self.fit(model).parameters):
            return NO_HELD_OUT
        return self.held_change(*self._without_and_with(model, h))

    def held_change(self, before_it: Model, after_it: Model) -> HeldGain:
        """What held-out poses gain from one model in the place of another."""
        if not self.has_held_out:
            return NO_HELD_OUT
        before, after = self._held(before_it), self._held(after_it)
        groups = self._alike
        gain = HeldGain.of(_square(before), _square(after), groups, cross_validated=self._few)
        return _with_rotation(gain, before, after)


def _with_rotation(gain: HeldGain, before: Array, after: Array) -> HeldGain:
    """A gain with the ratio of the rotation errors of residuals (M, c), where there are some."""
    turned = rms(after)[1], rms(before)[1]
    return replace(gain, rotation=turned[0] / turned[1]) if turned[0] and turned[1] else gain


def _together(groups: Groups | None, n: int, held: Measurements) -> Groups | None:
    """Groups of replicates of n poses and of those held out behind them; None where no pose was repeated."""
    if groups is None and held.repeats is None:
        return None
    own = np.arange(n) if groups is None else groups
    theirs = np.arange(held.n) if held.repeats is None else held.repeats
    together: Groups = np.concatenate([own, theirs + own.max() + 1])
    return together


def _square(r: Array) -> Array:
    """(M,) squared position errors [m^2] of residuals (M, c)."""
    return array((r[:, :3] ** 2).sum(axis=1))
