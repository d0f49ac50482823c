"""Several effects of one place and one driver beside a single function of it that has no name.

The pieces of a Fourier series are waves too: a bump, a kink or any other smooth error of a joint is a sum of
some. A base or a sensor that wanders seems to drift, to settle and to be moved. The more of them are named,
the less likely it is that each has a cause of its own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kincal_shared.errors import CannotAnswer
from kincal_shared.schema.terms import ONE

from ..evidence.finer import walks
from ..evidence.scoring import Scorer
from ..evidence.smooth import smooth_effect
from ..evidence.unnamed import Cell, locations, session_driver
from ..model.effects import Hypothesis, Parameter
from ..model.hypotheses import PRIOR_NONE, PRIOR_UNNAMED, Candidate
from ..model.places import ErrorPlace, joint_places
from ..model.unnamed_names import UnnamedName
from .states import Grids, Kept
from .study import Model, Study

_BASE = ("base translation", "base rotation")
_FIRST = {"encoder_harmonic2": "encoder_eccentricity"}
_COMMON = 0.2  # probability of an encoder's second harmonic beside its first one: they share causes
_LARGEST = 700.0  # exponent
_EVEN, _SURE = 0.5, 0.99


@dataclass(frozen=True)
class OneFunction:
    """name: of the function that may be all of `effects`; named: probability that they are what their names
    say, against that function; alone: they are at this place only."""

    name: UnnamedName
    effects: Model
    named: float
    alone: bool


def without_pieces(study: Study, kept: tuple[Kept, ...], grids: Grids) -> tuple[Kept, ...]:
    """Effects without those that are pieces of one function: where that is more likely, and poses that were
    not fitted are predicted as well with it, they make room for it. The others are as likely to be what
    they are called as they are against it."""
    for found in (*_of_one_angle(study, _model(kept), grids), *_of_the_base(study, _model(kept), grids)):
        if found.named < _EVEN and found.alone and _predicts_as_well(study, _model(kept), found):
            kept = tuple(k for k in kept if k.effect not in found.effects)
        else:
            kept = tuple(_doubted(k, found) if k.effect in found.effects else k for k in kept)
    return kept


def _doubted(k: Kept, found: OneFunction) -> Kept:
    return replace(k, ties=(*k.ties, str(found.name)), identity=k.identity * found.named)


def _model(kept: Sequence[Kept]) -> Model:
    return tuple(k.effect for k in kept)


def _predicts_as_well(study: Study, model: Model, found: OneFunction) -> bool:
    """Held-out poses do not contradict the function in the place of the effects."""
    beside = tuple(h for h in model if h not in found.effects)
    try:
        one = smooth_effect(found.name, study.held_scorer(beside)).hypothesis
    except CannotAnswer:
        return False
    return not study.held_change(model, (*beside, one)).harms


def _of_one_angle(study: Study, model: Model, grids: Grids) -> list[OneFunction]:
    """Joints at which a model has two or more effects of the joint's own angle."""
    found = []
    for joint, place in enumerate(joint_places(study.base.arm), 1):
        parts = {h: part for h in model if (part := _own(h, place, joint)).parameters}
        if len(parts) > 1:
            name = UnnamedName(place.name, (f"q{joint}",))
            named = _probability(_ln_named(study, model, parts, grids) - _ln_one(study, model, parts, name))
            alone = all(part.parameters == h.parameters for h, part in parts.items())
            found.append(OneFunction(name, tuple(parts), named, alone))
    return found


def _probability(ln_odds: float) -> float:
    return 1.0 / (1.0 + math.exp(min(-ln_odds, _LARGEST)))


def _own(h: Hypothesis, place: ErrorPlace, joint: int) -> Hypothesis:
    """The part of an effect that is a motion of this joint by its own angle alone."""

    def mine(p: Parameter) -> bool:
        return all(
            (t.frame, (t.comp,)) == (place.frame, place.components)
            and (t.basis[0].var, t.basis[0].index, t.basis[1]) == ("q", joint, ONE)
            for t in p.terms
        )

    return replace(h, parameters=tuple(p for p in h.parameters if mine(p)))


def _ln_named(study: Study, model: Model, parts: Mapping[Hypothesis, Hypothesis], grids: Grids) -> float:
    """ln of prior and evidence of the parts, one beside another, against nothing in their place."""
    ln, left = 0.0, dict(parts)
    for h in parts:
        scorer = study.scorer(model, drop=tuple(left.values()))
        candidate = _candidate(study, h, left.pop(h), grids)
        [scored] = scorer.candidates([candidate])
        beside = any(x.effect == _FIRST.get(h.effect) for x in parts)
        ln += scored.ln_bf + math.log(_COMMON if beside else candidate.prior / PRIOR_NONE)
    return ln


def _candidate(study: Study, h: Hypothesis, part: Hypothesis, grids: Grids) -> Candidate:
    """The effect at the one joint of its part, with the constants that it might have."""
    joints = {t.basis[0].index for p in part.parameters for t in p.terms if t.basis[0].var == "q"}
    name = f"{h.effect}[{joints.pop()}]" if joints else h.name
    known = next((c for c in study.competition.candidates if c.name == name), None)
    assert known is not None  # the effect competed there before it was taken
    return known.refined(grids[h.name]) if h.name == known.name and grids.get(h.name) else known


def _ln_one(study: Study, model: Model, parts: Mapping[Hypothesis, Hypothesis], name: UnnamedName) -> float:
    """The same of the function, as one of all that have one driver."""
    cells = study.scorer(model, drop=tuple(parts.values())).map(double=False)
    [one] = [s for s in cells if (s.best.location, s.best.drivers) == (name.place, name.drivers)]
    return one.ln_bf + _ln_prior(len(cells))


def _of_the_base(study: Study, model: Model, grids: Grids) -> list[OneFunction]:
    """The effects of a model that move the base with time. One is enough: a base that wanders turns as well
    as it shifts, and no cell of the map does both. One that is surely what it is called is none of them."""
    parts = {h: h for h in model if _moves_base(h)}
    if not parts:
        return []
    scorer = study.scorer(model, drop=tuple(parts))
    cells = scorer.map(double=False)
    time = (session_driver(study.base.data),)
    moving = [s for s in cells if s.best.location in _BASE and s.best.drivers == time]
    if not moving:
        return []
    # as likely as a shift or a turn alone
    ln_bf = np.logaddexp.reduce([_ln_walk(scorer), *(s.ln_bf for s in moving)])
    ln_one = float(ln_bf) + _ln_prior(len(cells))
    best = max(moving, key=lambda s: s.ln_bf).best
    named = _probability(_ln_named(study, model, parts, grids) - ln_one)
    if len(parts) == 1 and named > _SURE:
        return []
    return [OneFunction(UnnamedName(best.location, best.drivers), tuple(parts), named, alone=True)]


def _moves_base(h: Hypothesis) -> bool:
    """The effect is a motion of the base that depends on time alone."""
    terms = [t for p in h.parameters for t in p.terms]
    drivers = {b.var for t in terms for b in t.basis if b != ONE}
    return drivers == {"t"} and all(t.frame == 0 for t in terms)


def _ln_walk(scorer: Scorer) -> float:
    """ln Bayes factor of a random walk of the base in all six components, of any of its sizes."""
    rows = [place.rows for place in locations(scorer.columns) if place.name in _BASE]
    data = scorer.columns.fit.data
    blocks = [
        Cell("base", (session_driver(data),), np.concatenate(rows, axis=1), features).columns
        for features in walks(data)
    ]
    ln = [ln_bf for _, ln_bf in scorer.scores(blocks)]
    return float(np.logaddexp.reduce(ln) - math.log(len(ln)))


def _ln_prior(cells: int) -> float:
    """ln of the prior of one of the map's cells of one driver against that of nothing."""
    return math.log(PRIOR_UNNAMED / PRIOR_NONE / (2.0 * cells))
