"""Never worse: what held-out poses contradict is taken back."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

from kincal_shared.errors import CannotAnswer

from ..evidence.serial import Serial, serial_correlation
from ..evidence.smooth import smooth_effect
from ..model.effects import Hypothesis, Term
from ..model.unnamed_names import UnnamedName
from .heldout import HeldGain
from .states import Kept, Selection
from .study import Model, Study

_IMPOSSIBLE = 0.01  # probability of an effect against something unnamed
_SURE = 0.9  # probability that an effect helps other stretches: few of them tell little


def without_doubtful(study: Study, found: Selection) -> Selection:
    """Where the unnamed wins in the end, a named effect that resembles it may have won a place: those that
    held-out poses are predicted worse with go, one after another. Where it wins still, those whose gain may
    be chance stay for what they predict, not as having won."""
    if not (found.last.unnamed_wins and study.has_held_out):
        return found
    kept = found.kept
    while (gone := _worst(study, kept)) is not None:
        kept = tuple(k for k in kept if k is not gone)
    model = _model(kept)
    if study.posterior(model).unnamed_wins:
        kept = tuple(k if study.held_gain(model, k.effect).gains else replace(k, role="helps") for k in kept)
    return settled(study, found, kept, found.taken_back)


def without_unsupported(study: Study, found: Selection) -> Selection:
    """Where the unnamed wins in the end, effects that are all but impossible against it were taken for what
    they imitate of it. Once its function is in the model, those go from which held-out poses gain nothing
    more, one after another."""
    if not (found.last.unnamed_wins and study.has_held_out):
        return found
    one, kept = _top_function(study, found), found.kept
    while one is not None and (gone := _least_needed(study, kept, one)) is not None:
        kept = tuple(k for k in kept if k is not gone)
    return settled(study, found, kept, found.taken_back)


def _top_function(study: Study, found: Selection) -> Hypothesis | None:
    """What is unnamed, as terms; None where none can hold it."""
    top = found.last.top_unnamed.best
    name = UnnamedName.of_cell(top.location, top.drivers)
    try:
        return None if name.without_terms else smooth_effect(name, study.held_scorer(found.model)).hypothesis
    except CannotAnswer:
        return None


def _least_needed(study: Study, kept: tuple[Kept, ...], one: Hypothesis) -> Kept | None:
    """The impossible effect that helps least beside the function, of those that do not help beyond chance."""
    model = (*_model(kept), one)
    refuted = [k for k in kept if k.posterior.presence(k.effect.name) < _IMPOSSIBLE]
    gains = [(study.held_gain(model, k.effect), k) for k in refuted]
    useless = [(gain.ratio, k) for gain, k in gains if not (gain.gains or math.isnan(gain.ratio))]
    return max(useless, key=lambda pair: pair[0])[1] if useless else None


def _worst(study: Study, kept: tuple[Kept, ...]) -> Kept | None:
    """The effect without which held-out poses are predicted best, if better than with it."""
    model = _model(kept)
    gains = [(study.held_gain(model, k.effect), k) for k in kept]
    worse = [(gain.after_m / gain.before_m, k) for gain, k in gains if gain.worse]
    return max(worse, key=lambda pair: pair[0])[1] if worse else None


def never_worse(study: Study, found: Selection, evaluation: Study) -> Selection:
    """Without effects that harm or surely do not help, and, where the model does not explain the data to
    within a known noise, without those that held-out poses gain nothing from or that make a block of poses
    much worse, nor whatever makes the whole predict held-out poses worse than no effect at all.

    evaluation: the study of all poses, where `study` has a part of them."""
    kept, back = found.kept, found.taken_back
    while (gone := _contradicted(evaluation, kept)) is not None:
        kept, back = tuple(k for k in kept if k is not gone), (*back, gone)
    return settled(study, found, kept, back)


def correlated_noise(study: Study, model: Model) -> Serial | None:
    """Noise that is correlated in time; None if it is not. It shows in what the final model leaves, or, where
    many effects were fitted to it, in what the given one leaves, unless that follows place as well as time or
    an effect of the model follows time."""
    if (left := serial_correlation(study.fit(model))).correlated:
        return left
    given = serial_correlation(study.base)
    alone = given.correlated and given.separable and not any(map(follows_time, model))
    return given if alone else None


def follows_time(h: Hypothesis) -> bool:
    """An effect that depends on time, or on a temperature that follows it."""
    return any(b.var in ("t", "temp") for term in _terms(h) for b in term.basis)


def shifts_with_time(h: Hypothesis) -> bool:
    """An effect that shifts all positions alike from some time on, or more and more: what noise does that is
    correlated in time."""
    return any(term.frame == 0 and term.comp < 3 and term.basis[0].var == "t" for term in _terms(h))


def _terms(h: Hypothesis) -> Iterator[Term]:
    return (term for p in h.parameters for term in p.terms)


def holding(study: Study, found: Selection, evaluation: Study) -> Selection:
    """Without effects that stretches of the session, held out as a whole, are not predicted better with:
    noise that is correlated in time is alike in poses measured one after another, so that an effect fitted to
    some of them seems to predict the others. Without those, too, that are such noise by another name.
    evaluation: of all poses, by stretches."""
    kept, back = found.kept, found.taken_back
    while (gone := _least_held(evaluation, kept)) is not None:
        kept, back = tuple(k for k in kept if k is not gone), (*back, gone)
    return settled(study, found, kept, back)


def _least_held(study: Study, kept: tuple[Kept, ...]) -> Kept | None:
    """The effect that helps least, of those that do not surely help; None if all do."""
    model = _model(kept)

    def holds(k: Kept, gain: HeldGain) -> bool:
        if not gain.gains or shifts_with_time(k.effect):
            return False
        support = study.support(model, k.effect)
        return support is not None and support.probability >= _SURE

    gains = [(study.held_gain(model, k.effect), k) for k in kept]
    doubtful = [(gain.ratio, k) for gain, k in gains if not holds(k, gain)]
    return max(doubtful, key=lambda pair: pair[0])[1] if doubtful else None


def settled(
    study: Study, found: Selection, kept: tuple[Kept, ...], taken_back: tuple[Kept, ...] = ()
) -> Selection:
    """The outcome with these effects."""
    if kept == found.kept:
        return found
    model = _model(kept)
    return replace(found, kept=kept, model=model, last=study.posterior(model), taken_back=taken_back)


def _model(kept: tuple[Kept, ...]) -> Model:
    return tuple(k.effect for k in kept)


def _contradicted(study: Study, kept: tuple[Kept, ...]) -> Kept | None:
    """The effect that held-out poses speak against most; None if there is none."""
    if not (kept and study.has_held_out):
        return None
    model = _model(kept)
    gains = [(study.held_gain(model, k.effect), k) for k in kept]
    harmful = [(gain.interval[0], k) for gain, k in gains if gain.harms]
    if harmful:
        return max(harmful, key=lambda pair: pair[0])[1]
    if study.explains(model):  # to within a known noise: the evidence stands, unless nothing is gained at all
        refuted = [(gain.ratio, k) for gain, k in gains if gain.judged == "does not help"]
        return max(refuted, key=lambda pair: pair[0])[1] if refuted else None
    if (useless := _useless(study, model, gains)) is not None:
        return useless
    # a rotation error that grows by chance does not speak against an effect that is sure to gain
    doubtful = gains if _worse(study, model) else [(g, k) for g, k in gains if not g.gains]
    if not (doubtful and _worse(study, model, rotation=True)):
        return None
    return max(doubtful, key=lambda pair: pair[0].after_m / pair[0].before_m)[1]


def _useless(study: Study, model: Model, gains: Sequence[tuple[HeldGain, Kept]]) -> Kept | None:
    """The effect that helps least, of those from which held-out poses gain nothing, or which make a block of
    poses much worse; None if all help."""

    ratios = [(gain.ratio, k) for gain, k in gains if gain.nothing or study.worse_blocks(model, k.effect)]
    return max(ratios, key=lambda pair: pair[0])[1] if ratios else None


def _worse(study: Study, model: Model, *, rotation: bool = False) -> bool:
    """Position (rotation: or rotation) error of the held-out poses is larger than without effects."""
    turns = study.held_square(model).mean() > study.held_square(()).mean()
    after, before = study.held_error(model), study.held_error(())
    return bool(turns) or after[0] > before[0] or (rotation and _larger(after[1], before[1]))


def _larger(after: float | None, before: float | None) -> bool:
    return after is not None and before is not None and after > before
