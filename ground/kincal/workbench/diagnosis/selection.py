"""Which effects the data ask for: forward one after another, then backward, each against the rest.

Every function takes a `Study` and a frozen `State` (or a model) and returns a new one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import islice

import numpy as np

from ..evidence.scoring import Scorer
from ..model.effects import Hypothesis
from ..model.hypotheses import joints_of, merged_if_several
from .guard import settled, without_doubtful, without_unsupported
from .one_function import without_pieces
from .posterior import ACCEPT_ODDS, Posterior
from .predictive import helpful
from .states import Grids, Kept, Selection, Settled, State
from .study import Model, Study
from .subsets import fewest_joints

MAX_EFFECTS = 12  # bounds the work; before it, the poses limit the coefficients (Study.room)
_SETTLE_MAX = 4
_SEVERAL = 3  # joints with a coefficient each
_HELP_TRIES = 4  # effects tried at each step for what they predict


def select(study: Study, taking: Callable[[Model], None]) -> Selection:
    """Forward, then backward; `taking` is called with each model on the way forward."""
    states = []
    for state in forward(study):
        taking(state.model)
        states.append(state)
    first, last = study.posterior(()), study.posterior(states[-1].model)
    reviewed = backward(study, states[-1])
    found = Selection(reviewed.kept, reviewed.state.model, first, last)
    found = settled(study, found, without_pieces(study, found.kept, reviewed.state.grids))
    return without_unsupported(study, without_doubtful(study, found))


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
        return with_settled(study, replace(state, grids=found.grids), found.effect)
    with_two = pair(study, replace(state, grids=found.grids), best)
    if with_two.model != state.model:
        return with_two
    return helped(study, with_two)


def helped(study: Study, state: State) -> State | None:
    """The model with the named effect that predicts best, although something unnamed explains more: chosen
    by cross-validation of the fit poses, refused where the held-out poses contradict."""
    for found in islice(helpful(study, state.model), _HELP_TRIES):
        h, grids = sharpen(study, state.model, found.effect, state.grids)
        if not study.held_gain(state.model, h).worse:
            ties = {**state.ties, h.name: found.ties}
            return _taken(replace(state, grids=grids, ties=ties), h)
    return None


def _taken(state: State, h: Hypothesis) -> State:
    """The model with an effect added; at all joints: instead of at one."""
    return replace(state, model=(*(x for x in state.model if x.effect != h.name), h))


def with_settled(study: Study, state: State, h: Hypothesis) -> State:
    """The model with an effect that wins. Several joints that settle: what all have alike, and half as many
    joints at most, in the place of those that are needed, where that explains more with no more coefficients:
    a lagging sensor is no error of joints."""
    if len(h.parameters) < _SEVERAL or not h.of_last_move:
        return _taken(state, h)
    posterior = study.posterior(state.model)
    lone = [s.best for s in posterior.scored if s.best.of_last_move and len(s.best.parameters) == 1]
    of_all = [x for x in lone if len(x.parameters[0].terms) > 1]
    of_one = [x for x in lone if len(x.parameters[0].terms) == 1]
    several = fewest_joints(posterior.scorer, h) or h
    [(_, instead_of)] = posterior.scorer.hypotheses([several])
    most = (len(several.parameters) + 1) // 2
    found = [_with_few(study, posterior.scorer, x, of_one, most) for x in of_all]
    best, models = max(found, key=lambda one: one[0], default=(-math.inf, ()))
    if best < instead_of:
        return _taken(state, h)
    return reduce(_taken, models, state)


def _with_few(
    study: Study, scorer: Scorer, whole: Hypothesis, of_one: Sequence[Hypothesis], most: int
) -> tuple[float, Model]:
    """An effect of all joints, and one of single joints at those that explain most beside it, one after
    another, further ones only where the odds are for them: ln Bayes factor and both effects."""
    ln_bf, now, joints = -math.inf, whole, list[Hypothesis]()
    while len(joints) < most and (others := [x for x in of_one if x not in joints]):
        tried = [replace(now, parameters=now.parameters + x.parameters) for x in others]
        scored = [ln for _, ln in scorer.hypotheses(tried)]
        k = int(np.argmax(scored))
        if joints and scored[k] < ln_bf + math.log(ACCEPT_ODDS):
            break
        ln_bf, now, joints = scored[k], tried[k], [*joints, others[k]]
    if not joints:
        return ln_bf, ()
    joints.sort(key=lambda x: joints_of(x.name))
    effect = study.library.effects[joints[0].effect]
    places = ",".join(str(j) for x in joints for j in joints_of(x.name))
    return ln_bf, (whole, merged_if_several(effect, joints, f"{effect.name}[{places}]"))


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
        scored = study.scorer((*beside, h), drop=(h,)).hypotheses(grid)
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
    again = settle(study, replace(state, model=(*state.model, other.effect), grids=other.grids), first)
    if again.effect is None:
        return replace(state, grids=again.grids)
    return _taken(replace(state, model=(*state.model, again.effect), grids=again.grids), other.effect)


def _beat_the_unnamed(alone: Posterior, beside: Posterior, first: Hypothesis, second: Hypothesis) -> bool:
    both = alone.probability[first.name] * beside.probability[second.name]
    return both >= ACCEPT_ODDS * alone.unnamed * beside.none


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
    if _predicts(study, state, h):
        return Reviewed(state, (*now.kept, Kept(h, "helps", posterior, state.ties.get(h.name, ()))))
    without = tuple(x for x in state.model if x is not h)  # not needed once the others are there
    return replace(now, state=replace(state, model=without))


def _predicts(study: Study, state: State, h: Hypothesis) -> bool:
    """Held-out poses gain, or do not contradict what cross-validation of the fit poses has shown."""
    gain = study.held_gain(state.model, h)
    return gain.gains or (h.name in state.ties and not gain.worse)


def _simplified(study: Study, state: State, h: Hypothesis) -> tuple[State, Hypothesis]:
    """One joint, or some, instead of all where that is enough beside the others."""
    one = study.reopened(state.model, h, state.grids.get(h.name, ())).one_joint(h)
    one = one or study.fewest_joints(state.model, h)
    return (state, h) if one is None else (_with(state, h, one), one)


def _replaced(study: Study, state: State, h: Hypothesis) -> tuple[State, Hypothesis]:
    """What fits far better in its place: the effect was taken before the others were there."""
    posterior = study.reopened(state.model, h, state.grids.get(h.name, ()))
    winner = posterior.best(study.room(state.model) + len(h.parameters))
    if winner is None or posterior.presence(winner.name) <= ACCEPT_ODDS * posterior.presence(h.name):
        return state, h
    return _with(state, h, winner), winner


def _with(state: State, old: Hypothesis, new: Hypothesis) -> State:
    """Another effect in the place of one; at other joints the same has what was found about it."""
    model = tuple(new if x is old else x for x in state.model)
    if old.effect != new.effect or old.name not in state.ties:
        return replace(state, model=model)
    return replace(state, model=model, ties={**state.ties, new.name: state.ties[old.name]})
