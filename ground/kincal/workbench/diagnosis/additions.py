"""Unnamed effects added to a model, one after another, while poses that were left out gain from them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from kincal_shared.errors import CannotAnswer

from ..comparison.compare import Comparison
from ..data.measurements import Measurements
from ..evidence.products import ScoredProduct, score_products
from ..evidence.scoring import Scorer, bulk_weights
from ..evidence.smooth import MOST_TERMS, SmoothEffect, full_effect, smooth_effect
from ..fit.least_squares import Fit, fit_model, rms
from ..model.effects import Hypothesis
from ..model.flight_model import room_for
from ..model.hypotheses import PRIOR_NONE, PRIOR_UNNAMED
from ..model.places import all_places
from ..model.unnamed_names import UnnamedName
from ..numerics.types import Array, Indices, Progress, array, no_progress
from ..prediction.crossval import FOLDS, folds
from . import Diagnosis, HeldGain

MOST_EFFECTS = 10
_TRIED = 12  # names whose whole function is scored at each step
_ODDS = 9.0
_TIMES = 2.0  # the ln evidence of all other functions that one of the orientation needs to stop them
_ROWS_EACH = (
    2  # that the poses have for each coefficient of the whole model; with fewer, functions only fit noise
)


@dataclass(frozen=True)
class Addition:
    """One unnamed effect beside those before it.

    crossed: gain by cross-validation inside the fit poses; held: gain of the held-out poses, None where there
    are none.
    """

    effect: SmoothEffect
    crossed: HeldGain
    held: HeldGain | None


@dataclass(frozen=True)
class Additions:
    """Unnamed effects that a model asks for.

    steps: in the order they were added; fit: of the model with all of them, on the fit poses; held_pos_m,
    held_rot_rad: RMS error of the held-out poses with it [m], [rad]; NaN and None where there are none;
    instead: a function of time, or of the tool's orientation, that explains far more of what is left than any
    that is added here, which would only stand for it.
    """

    steps: tuple[Addition, ...]
    fit: Fit
    held_pos_m: float
    held_rot_rad: float | None
    instead: UnnamedName | None = None

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """The added effects, as a fit takes them."""
        return tuple(step.effect.hypothesis for step in self.steps)


def add_unnamed(
    comparison: Comparison,
    hypotheses: Sequence[Hypothesis] = (),
    *,
    dh: bool = True,
    most: int = MOST_EFFECTS,
    progress: Progress = no_progress,
) -> Additions:
    """Add unnamed effects to a model while they pay for their number of tries in evidence and poses left out
    in cross-validation are predicted better.

    comparison: of the data; hypotheses: effects of the model. Everything is chosen on the fit poses; the
    held-out ones only refuse an effect with which their error is larger than with none. most: unnamed effects
    at most.
    """
    steps: list[Addition] = []
    fit = fit_part(comparison, hypotheses, dh=dh)
    begin, instead = fit, None
    while len(steps) < most:
        progress("unnamed effects", len(steps), most)
        scorer = _scorer(fit)
        names, tries, instead = _proposed(fit, scorer)
        wanted = () if instead else _wanted(fit, scorer, names, tries)
        step = _next(comparison, fit, wanted, begin, dh=dh)
        if step is None:
            break
        addition, fit = step
        steps.append(addition)
    position, rotation = rms(_held_residuals(fit, comparison.held_data))
    return Additions(tuple(steps), fit, position, rotation, instead)


def only(
    comparison: Comparison,
    hypotheses: Sequence[Hypothesis],
    effects: Sequence[SmoothEffect],
    *,
    dh: bool = True,
) -> Additions:
    """These unnamed effects, one after another beside those of a model, with what each gains then."""
    steps, fit = [], fit_part(comparison, hypotheses, dh=dh)
    for effect in effects:
        grown = fit_part(comparison, (*fit.hypotheses, effect.hypothesis), dh=dh)
        steps.append(_addition(comparison, fit, grown, effect))
        fit = grown
    return Additions(tuple(steps), fit, *rms(_held_residuals(fit, comparison.held_data)))


def add_unnamed_to(
    diagnosis: Diagnosis, *, most: int = MOST_EFFECTS, progress: Progress = no_progress
) -> Additions:
    """`add_unnamed` beside the effects that a diagnosis ends with."""
    dh = any(name.startswith("J1.") for name in diagnosis.final.names)
    return add_unnamed(diagnosis.comparison, diagnosis.final.hypotheses, dh=dh, most=most, progress=progress)


def add_one(
    comparison: Comparison, name: UnnamedName, hypotheses: Sequence[Hypothesis], *, dh: bool
) -> Addition:
    """The smooth function of this name beside the effects of a model, chosen on the fit poses, with its gain.
    Errors as `smooth_effect`."""
    fit = fit_part(comparison, hypotheses, dh=dh)
    scorer = _scorer(fit)
    effect = smooth_effect(name, scorer, most=_room(fit))
    return _addition(
        comparison, fit, fit_part(comparison, (*fit.hypotheses, effect.hypothesis), dh=dh), effect
    )


def fit_part(comparison: Comparison, hypotheses: Sequence[Hypothesis], *, dh: bool) -> Fit:
    """A model fitted to the fit poses of a comparison."""
    part = comparison.fit_part
    return fit_model(part.arm, part.data, hypotheses, dh=dh, frames=(part.base, part.tool))


def _scorer(fit: Fit) -> Scorer:
    return Scorer(fit, bulk_weights(fit), fit.data.cov is not None)


def _room(fit: Fit) -> int:
    """Coefficients that an effect may take: what the core carries, and what the poses do."""
    by_poses = min(int(fit.dof) // 4, len(fit.z) // _ROWS_EACH - len(fit.names))
    return max(0, min(MOST_TERMS, room_for(fit.parameters), by_poses))


def _next(
    comparison: Comparison, fit: Fit, wanted: Iterable[SmoothEffect], begin: Fit, *, dh: bool
) -> tuple[Addition, Fit] | None:
    """The first effect that holds and the fit with it, None if there is none. begin: before any was added."""
    for effect in wanted:
        grown = fit_part(comparison, (*fit.hypotheses, effect.hypothesis), dh=dh)
        addition = _addition(comparison, fit, grown, effect)
        harms = addition.held is not None and addition.held.harms
        if addition.crossed.gains and not harms and not _worse(comparison, begin, grown):
            return addition, grown
    return None


def _wanted(fit: Fit, scorer: Scorer, names: Sequence[UnnamedName], tries: int) -> Iterator[SmoothEffect]:
    """Effects that beat "nothing missing" after paying for all that were tried, most evidence first."""
    room = _room(fit)
    found = [full_effect(name, scorer) for name in names]
    least = _least_ln_bf(tries)
    for whole in sorted(found, key=lambda f: -f.ln_bf)[:2]:
        if room and whole.ln_bf > least:
            try:
                yield smooth_effect(whole.name, scorer, most=room)
            except CannotAnswer:
                continue


def _proposed(fit: Fit, scorer: Scorer) -> tuple[list[UnnamedName], int, UnnamedName | None]:
    """Places and drivers that the map and the dictionary of products point at, how many there are, and a
    function that is not to be added and has far more evidence than all that are."""
    cells = scorer.map()
    scored = {(s.best.location, s.best.drivers): s.ln_bf for s in cells}
    for product in _products(scorer, fast=False):
        key = (product.place.name, product.drivers)
        scored[key] = max(product.ln_bf, scored.get(key, -np.inf))
    # many as they are, fast waves stand for smooth functions too, and predict less: only those that win, of
    # two angles (of one, the whole function has fine cosines)
    smooth = max(scored.values(), default=0.0)
    for wave in _products(scorer, fast=True):
        if wave.ln_bf > smooth and len(wave.drivers) > 1:
            key = (wave.place.name, wave.drivers)
            scored[key] = max(wave.ln_bf, scored.get(key, -np.inf))
    taken, possible = {h.name for h in fit.hypotheses}, {p.name for p in all_places(fit.arm, fit.data)}
    ranked = sorted(scored, key=lambda key: -scored[key])
    every = [UnnamedName(place, drivers) for place, drivers in ranked]
    new = [n for n in every if str(n) not in taken and (n.place in possible or n.without_terms)]
    instead, new = _first_instead(scored, new), [name for name in new if not _not_added(name)]
    # the map is too smooth to point at ripples of a joint's own angle
    own = [UnnamedName(f"joint {j}", (f"q{j}",)) for j in range(1, fit.arm.n + 1)]
    ripples = [name for name in own if name in new[_TRIED:]]
    return [*new[:_TRIED], *ripples], max(len(scored), 1), instead


def _products(scorer: Scorer, *, fast: bool) -> list[ScoredProduct]:
    """The products of the dictionary with the most evidence, or its fast waves; the ln evidence of these pays
    for their number."""
    found = score_products(
        scorer.columns, scorer.projector, scorer.wz, scorer.noise, count=10 * _TRIED, fast=(fast,)
    )
    if found is None:
        return []
    ln_tries = float(np.log(found.tries)) if fast else 0.0
    return [replace(product, ln_bf=product.ln_bf - ln_tries) for product in found.best]


def _not_added(name: UnnamedName) -> bool:
    """It predicts no later poses, or no term can hold it."""
    return name.of_time or name.without_terms


def _first_instead(
    scored: Mapping[tuple[str, tuple[str, ...]], float], ranked: Sequence[UnnamedName]
) -> UnnamedName | None:
    """The first function that is not added, if it has far more evidence than those that are, and nothing."""
    first = next((name for name in ranked if _not_added(name)), None)
    if first is None:
        return None
    ln_bf = scored[first.place, first.drivers]
    others = max(
        (scored[name.place, name.drivers] for name in ranked if not _not_added(name)), default=-np.inf
    )
    least = max(_least_ln_bf(len(scored)), others + np.log(_ODDS))
    if first.without_terms:  # which joint angles follow in part: little more evidence decides nothing
        least = max(least, _TIMES * others)
    return first if ln_bf > least else None


def _least_ln_bf(tries: int) -> float:
    """Evidence that beats "nothing missing" after paying for all that were tried."""
    return float(np.log(_ODDS * PRIOR_NONE / PRIOR_UNNAMED) + np.log(tries))


# ------------------------------------------------------------------------------------------------ gains


def _addition(comparison: Comparison, before: Fit, after: Fit, effect: SmoothEffect) -> Addition:
    return Addition(effect, _crossed(after, effect.hypothesis), _held_gain(comparison, before, after))


def _worse(comparison: Comparison, before: Fit, after: Fit) -> bool:
    """The error of the held-out poses is larger, be it by chance."""
    held = _held_gain(comparison, before, after)
    return held is not None and held.after_m > held.before_m


def _held_gain(comparison: Comparison, before: Fit, after: Fit) -> HeldGain | None:
    """Of the held-out poses, None if there are none."""
    if comparison.held_data is None:
        return None
    without, with_it = (_squares(_held_residuals(fit, comparison.held_data)) for fit in (before, after))
    return HeldGain.of(without, with_it, comparison.held_data.repeats, cross_validated=False)


def _held_residuals(fit: Fit, held: Measurements | None) -> Array:
    return fit.predict(held) if held is not None else np.zeros((0, fit.data.components))


def _squares(r: Array) -> Array:
    """(M,) squared position errors of residuals (M, c)."""
    squares: Array = (r[:, :3] ** 2).sum(axis=1)
    return squares


def _crossed(fit: Fit, h: Hypothesis) -> HeldGain:
    """Gain of an effect by cross-validation: the fit's linear model, solved without each fold in turn."""
    mine = np.array([name.startswith(f"{h.name}.") for name in fit.names])
    squares = np.zeros((2, fit.data.n))
    number, linear = folds(fit.data), _Linear.of(fit, np.argsort(mine, kind="stable"))
    counts = (int((~mine).sum()), len(mine))
    for fold in (np.flatnonzero(number == k) for k in range(FOLDS)):
        for row, r in zip(squares, linear.left_out(fold, counts), strict=True):
            row[fold] = _squares(r)
    return HeldGain.of(squares[0], squares[1], fit.data.repeats, cross_validated=True)


@dataclass(frozen=True)
class _Linear:
    """The linear model of a fit. a: (N, c, k) columns in units of noise and priors; z: (N, c) what they
    explain; root: (N, 1) roots of the robust weights; metres: (N, c, c) from units of noise to [m, rad]."""

    a: Array
    z: Array
    root: Array
    metres: Array

    @classmethod
    def of(cls, fit: Fit, order: Indices) -> _Linear:
        """Of coefficients in this order."""
        n, c = fit.evaluation.r.shape
        a = (fit.J * fit.sigma_prior)[:, order].reshape(n, c, -1) / fit.scale
        z = (fit.z + fit.J @ fit.estimate).reshape(n, c) / fit.scale
        return cls(a, z, np.sqrt(fit.weight)[:, None], array(np.linalg.inv(fit.whiten) * fit.scale))

    def left_out(self, fold: Indices, counts: Sequence[int]) -> Iterator[Array]:
        """(M, c) residuals [m, rad] of the poses of a fold under the first so many coefficients, for each
        count, solved with the other poses only. One triangle serves all counts: its upper left corner is that
        of the first columns. Normal equations would lose digits."""
        k = self.a.shape[2]
        kept = np.delete(np.arange(len(self.a)), fold)
        root = self.root[kept]
        rows = np.empty((self.z[kept].size + k, k + 1))
        rows[:-k, :k] = (self.a[kept] * root[:, :, None]).reshape(-1, k)
        rows[:-k, k] = (self.z[kept] * root).ravel()
        rows[-k:] = np.eye(k, k + 1)
        triangle = array(np.linalg.qr(rows, mode="r"))
        for count in counts:
            solved = solve_triangular(triangle[:count, :count], triangle[:count, k], check_finite=False)
            left = self.z[fold] - self.a[fold, :, :count] @ solved
            yield np.einsum("nij,nj->ni", self.metres[fold], left)
