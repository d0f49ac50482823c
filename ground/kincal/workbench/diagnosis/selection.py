"""Which effects the data ask for: forward one after another, then backward, each against the rest.

Every function takes a `Study` and a frozen `State` (or a model) and returns a new one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import Literal

import numpy as np

from ..effects import Hypothesis
from ..hypotheses import PRIOR_NONE
from .posterior import ACCEPT_ODDS, Posterior
from .study import Model, Study

MAX_EFFECTS = 5
_SETTLE_MAX = 4
_HELP_TRIES = 4  # named effects tried at each step when something unnamed wins

Grids = Mapping[str, Model]
"""By effect name: the closer search for its constants that was made last."""

Role = Literal["accepted", "helps"]


@dataclass(frozen=True)
class State:
    """A model on the way: effects beside the given ones, in the order they were taken."""

    model: Model = ()
    grids: Grids = field(default_factory=dict)


@dataclass(frozen=True)
class Settled:
    """What won at the fit that contains an effect (None: no effect did), and the grids searched so far;
    done: it is that very effect, or none, so that nothing changes any more."""

    effect: Hypothesis | None
    grids: Grids
    done: bool = False


@dataclass(frozen=True)
class Kept:
    """An effect of the final model, why it stays, and what competed for its place."""

    effect: Hypothesis
    role: Role
    posterior: Posterior


@dataclass(frozen=True)
class Selection:
    """The outcome: kept effects, their model, and the posteriors before the first and after the last one."""

    kept: tuple[Kept, ...]
    model: Model
    first: Posterior
    last: Posterior


def select(study: Study, taking: Callable[[Model], None]) -> Selection:
    """Forward, then backward; `taking` is called with each model on the way forward."""
    states = []
    for state in forward(study):
        taking(state.model)
        states.append(state)
    first, last = study.posterior(()), study.posterior(states[-1].model)
    reviewed = backward(study, states[-1])
    return without_doubtful(study, Selection(reviewed.kept, reviewed.state.model, first, last))


# ------------------------------------------------------------------------------------------- forward


def forward(study: Study) -> Iterator[State]:
    """Models from the given one on, each with what the data ask for most; the last one is complete."""
    state: State | None = State()
    while state is not None:
        yield state
        state = extended(study, state)


def extended(study: Study, state: State) -> State | None:
    """The model with the next effect (or two) that the data ask for; None if they ask for none."""
    posterior = study.posterior(state.model)
    if len(state.model) >= MAX_EFFECTS or not posterior.something_missing:
        return None
    best = posterior.best(study.room(state.model))
    if best is None:
        return None
    found = settle(study, state, best)
    if found.effect is not None:
        return _taken(State(state.model, found.grids), found.effect)
    with_two = pair(study, State(state.model, found.grids), best)
    if with_two.model != state.model:
        return with_two
    help_ = helpful(study, state.model)
    return None if help_ is None else _taken(with_two, help_)


def _taken(state: State, h: Hypothesis) -> State:
    """The model with an effect added; at all joints: instead of at one."""
    return replace(state, model=(*(x for x in state.model if x.effect != h.name), h))


def settle(study: Study, state: State, h: Hypothesis) -> Settled:
    """The named effect that still wins when everything is linearised at the fit that contains it; none
    when the unnamed wins even there, or nothing is needed."""
    return reduce(
        lambda tried, _: tried if tried.done else _settled_once(study, state.model, tried),
        range(_SETTLE_MAX),
        Settled(h, state.grids),
    )


def _settled_once(study: Study, beside: Model, tried: Settled) -> Settled:
    """Search the constants of the effect closer, fit it, and see what wins there."""
    assert tried.effect is not None
    h, grids = sharpen(study, beside, tried.effect, tried.grids)
    model = (*beside, h)
    posterior = study.reopened(model, h, grids.get(h.name, ()))
    winner = posterior.best(study.room(model) + len(h.parameters))
    if winner is None or not posterior.wins(winner.name):
        return Settled(None, grids, done=True)
    same = winner.name == h.name and winner.constants == h.constants
    return Settled(h if same else winner, grids, done=same)


def sharpen(study: Study, beside: Model, h: Hypothesis, grids: Grids) -> tuple[Hypothesis, Grids]:
    """The effect with its constants searched closer than the grid has them, and the grids with that search:
    of a large effect even a small error of its moment or period leaves something that looks like another."""
    for constant in study.constants_of(h):
        grid = study.closer(h, constant)
        if not grid:
            continue
        scored = study.scorer((*beside, h), drop=h).hypotheses(grid)
        h = grid[int(np.argmax([ln_bf for _, ln_bf in scored]))]
        grids = {**grids, h.name: grid}
    return h, grids


def pair(study: Study, state: State, first: Hypothesis) -> State:
    """The model with two named effects that together beat the unnamed that beats each of them alone: two
    effects at one joint look like one unknown function of both their drivers. Unchanged if there are none."""
    if len(state.model) + 2 > MAX_EFFECTS:
        return state
    alone, beside = study.posterior(state.model), study.posterior((*state.model, first))
    second = beside.best(study.room(state.model) - len(first.parameters))
    if second is None or not _beat_the_unnamed(alone, beside, first, second):
        return state
    other = settle(study, replace(state, model=(*state.model, first)), second)
    if other.effect is None:
        return replace(state, grids=other.grids)
    again = settle(study, State((*state.model, other.effect), other.grids), first)
    if again.effect is None:
        return replace(state, grids=again.grids)
    return _taken(State((*state.model, again.effect), again.grids), other.effect)


def _beat_the_unnamed(alone: Posterior, beside: Posterior, first: Hypothesis, second: Hypothesis) -> bool:
    both = alone.probability[first.name] * beside.probability[second.name]
    return both >= ACCEPT_ODDS * alone.unnamed * beside.none


def helpful(study: Study, model: Model) -> Hypothesis | None:
    """The most probable named effect that held-out poses are predicted better with, although something
    unnamed explains more. The data have to ask for it beside the unnamed: an effect that merely resembles
    that explains nothing more once it is granted."""
    posterior = study.posterior(model)
    if not (study.has_held_out and posterior.unknown):
        return None
    names = posterior.named(study.room(model))[:_HELP_TRIES]
    effects = [posterior.by_name[name].best for name in names]
    unnamed = posterior.top_unnamed
    scored = study.scorer(model, granted=unnamed.block).hypotheses(effects)
    prior = {c.name: c.prior for c in study.competition.candidates}
    for h, (_, ln_bf) in zip(effects, scored, strict=True):
        odds = np.log(prior[h.name] / PRIOR_NONE) + ln_bf
        if odds > np.log(ACCEPT_ODDS) and study.held_gain(model, h).gains:
            return h
    return None


# ------------------------------------------------------------------------------------------ backward


@dataclass(frozen=True)
class Reviewed:
    """A model whose effects are tested once more, one after another; kept: those that passed so far."""

    state: State
    kept: tuple[Kept, ...] = ()


def backward(study: Study, state: State) -> Reviewed:
    """Each effect against everything that could stand in its place, the others kept. One that was only
    taken for its help wins here if what stood against it was another missing effect in disguise."""
    return reduce(lambda now, h: reviewed(study, now, h), state.model, Reviewed(state))


def reviewed(study: Study, now: Reviewed, h: Hypothesis) -> Reviewed:
    """One effect reviewed: kept, replaced by what fits far better, or removed."""
    state, h = _simplified(study, now.state, h)
    state, h = _replaced(study, state, h)
    posterior = study.reopened(state.model, h, state.grids.get(h.name, ()))
    if posterior.wins(h.name):
        return Reviewed(state, (*now.kept, Kept(h, "accepted", posterior)))
    if study.held_gain(state.model, h).gains:
        return Reviewed(state, (*now.kept, Kept(h, "helps", posterior)))
    without = tuple(x for x in state.model if x is not h)  # not needed once the others are there
    return replace(now, state=replace(state, model=without))


def _simplified(study: Study, state: State, h: Hypothesis) -> tuple[State, Hypothesis]:
    """One joint instead of all where it is enough beside the others."""
    one = study.reopened(state.model, h, state.grids.get(h.name, ())).one_joint(h)
    return (state, h) if one is None else (_with(state, h, one), one)


def _replaced(study: Study, state: State, h: Hypothesis) -> tuple[State, Hypothesis]:
    """What fits far better in its place: the effect was taken before the others were there."""
    posterior = study.reopened(state.model, h, state.grids.get(h.name, ()))
    winner = posterior.best(study.room(state.model) + len(h.parameters))
    if winner is None or posterior.presence(winner.name) <= ACCEPT_ODDS * posterior.presence(h.name):
        return state, h
    return _with(state, h, winner), winner


def _with(state: State, old: Hypothesis, new: Hypothesis) -> State:
    return replace(state, model=tuple(new if x is old else x for x in state.model))


def without_doubtful(study: Study, found: Selection) -> Selection:
    """Where the unnamed wins in the end, only the effects that held-out poses gain from: a named effect
    that resembles the unnamed often wins a place; it has to prove itself."""
    if not (found.last.unnamed_wins and study.has_held_out):
        return found
    kept = tuple(k for k in found.kept if study.held_gain(found.model, k.effect).gains)
    if len(kept) == len(found.kept):
        return found
    model = tuple(k.effect for k in kept)
    return Selection(kept, model, found.first, study.posterior(model))
