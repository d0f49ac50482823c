"""What competes: every testable effect of the library as candidates with their prior probabilities."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

from kincal_shared.schema.arm import ArmTable
from kincal_shared.schema.names import effect_of as effect_of
from kincal_shared.schema.names import place_of as place_of

from ..data.measurements import Measurements
from .effects import Effect, Hypothesis, Library
from .grids import grid_weight
from .sight import Constants, sight_constants

# Prior probabilities of "nothing is missing" and "what is missing has no name in the library"; the
# testable effects share the rest equally.
PRIOR_NONE, PRIOR_UNNAMED = 0.3, 0.1
# Of the prior of a pair, where data show nothing of its second joint: one joint is the simpler cause.
_UNSEEN = 1e-3


@dataclass(frozen=True)
class Candidate:
    """An effect at one place (or at all joints) that competes.

    variants: the same with each value of its grid constants, over which its evidence is averaged by
    weight (equally if there are no weights); prior: its probability before the data are seen.
    """

    name: str
    effect: Effect
    variants: tuple[Hypothesis, ...]
    prior: float
    weights: tuple[float, ...] = ()

    def agreeing(self, assumed: Constants) -> Candidate:
        """The same without the variants that assume another camera or target than a model does already."""
        if len(self.variants) < 2 or not assumed or not sight_constants(self.variants[0].constants):
            return self
        same = tuple(h for h in self.variants if h.constants == assumed)
        return replace(self, variants=same or self.variants, weights=())

    def refined(self, finer: Sequence[Hypothesis]) -> Candidate:
        """The same with the part of its grid that `finer` spans replaced by these variants: they share its
        weight, but those that had more than an equal one keep it."""
        low, high = min(h.constants for h in finer), max(h.constants for h in finer)
        equal = 1.0 / len(self.variants)
        weight = dict(zip((h.constants for h in self.variants), self._shares, strict=True))
        rest = [h for h in self.variants if not low <= h.constants <= high]
        kept = [w if (w := weight.get(h.constants, 0.0)) > equal else 0.0 for h in finer]
        others = (1.0 - sum(weight[h.constants] for h in rest) - sum(kept)) or equal
        each = others / max(kept.count(0.0), 1)
        weights = [*(weight[h.constants] for h in rest), *(w or each for w in kept)]
        return replace(self, variants=(*rest, *finer), weights=tuple(weights))

    @property
    def _shares(self) -> list[float]:
        """Weights of the variants, of sum 1."""
        weights = self.weights or (1.0,) * len(self.variants)
        return [w / sum(weights) for w in weights]


@dataclass(frozen=True)
class Untestable:
    """An effect that these data cannot show, and the columns or arm keys that it would need."""

    name: str
    needs: tuple[str, ...]


@dataclass(frozen=True)
class Competition:
    """All candidates for one arm and data set.

    untestable: effects that lack a column or key; equivalents: effect -> effects with the very same
    formula, which no data can tell from it.
    """

    candidates: tuple[Candidate, ...]
    untestable: tuple[Untestable, ...]
    equivalents: dict[str, tuple[str, ...]]

    @classmethod
    def of(
        cls, arm: ArmTable, data: Measurements, library: Library, used: Collection[str] = ()
    ) -> Competition:
        """Every effect of the library that these data can test; `used`: names already in the model."""
        missing = {e.name: tuple(e.missing(arm, data)) for e in library.effects.values()}
        tested = [e for e in library.effects.values() if not missing[e.name] and not e.equivalent_to]
        share = (1.0 - PRIOR_NONE - PRIOR_UNNAMED) / max(len(tested), 1)
        candidates = [c for e in tested for c in _candidates(e, arm, data, share, used)]
        untestable = [Untestable(name, needs) for name, needs in missing.items() if needs]
        return cls(tuple(candidates), tuple(untestable), _equivalents(library))

    def open(self, model: Collection[Hypothesis]) -> tuple[Candidate, ...]:
        """Those that may still be added: an effect that is in at some joints has nothing to add at those, and
        one camera saw one target."""
        assumed = assumed_by(model)
        taken = [h.name for h in model]
        return tuple(c.agreeing(assumed) for c in self.candidates if _is_open(c, taken))

    def without(self, effect: str) -> Competition:
        """The same without an effect, wherever it acts."""
        return replace(self, candidates=tuple(c for c in self.candidates if c.effect.name != effect))

    def with_itself(self, open_: Sequence[Candidate], h: Hypothesis) -> tuple[Candidate, ...]:
        """Candidates for the place of an effect of the model, with that effect itself: at some joints it
        shares the prior of that at all of them; a second one stays when the first has left the model."""
        if any(c.name == h.name for c in open_):
            return tuple(open_)
        known = {c.name: c for c in self.candidates}
        if h.name in known:
            return (*open_, known[h.name])
        prior = 0.5 * known[h.effect].prior
        shared = [replace(c, prior=prior) if c.name == h.effect else c for c in open_]
        return (*shared, Candidate(h.name, known[h.effect].effect, (h,), prior))


def assumed_by(model: Iterable[Hypothesis]) -> Constants:
    """What the effects of a model assume of camera and target: all the same."""
    return next((x for h in model if (x := sight_constants(h.constants))), ())


def _is_open(candidate: Candidate, taken: Collection[str]) -> bool:
    """Not in the model yet, nor at all joints what is in at several; a second one beside the first."""
    if any(covers(name, candidate.name) or _would_double(candidate, name) for name in taken):
        return False
    return not candidate.effect.beside or _is_beside(candidate, taken)


def _would_double(candidate: Candidate, name: str) -> bool:
    """An effect at all its joints would repeat what is in at several of them."""
    return candidate.name == effect_of(name) and len(joints_of(name)) > 1


def _is_beside(candidate: Candidate, taken: Collection[str]) -> bool:
    """The effect that this one is a second of is in the model: at its joint; for all joints, at several."""
    first = candidate.effect.beside + place_of(candidate.name)
    several = not joints_of(first)
    return any(
        covers(name, first) or (several and effect_of(name) == first and len(joints_of(name)) > 1)
        for name in taken
    )


def _equivalents(library: Library) -> dict[str, tuple[str, ...]]:
    out: dict[str, tuple[str, ...]] = {}
    for effect in library.effects.values():
        if effect.equivalent_to:
            out[effect.equivalent_to] = (*out.get(effect.equivalent_to, ()), effect.name)
    return out


def _candidates(
    effect: Effect, arm: ArmTable, data: Measurements, share: float, used: Collection[str]
) -> list[Candidate]:
    """Each joint or pair alone, and all joints at once with half the effect's share of the prior."""
    if effect.name in used:
        return []
    instances = [h for h in effect.instances(arm, data) if any(p.terms for p in h.parameters)]
    by_name = grouped_by_name(instances)
    several = effect.per == "joint" and len(by_name) > 1
    alone = share / max(len(by_name), 1) * (0.5 if several else 1.0)
    weights = _weights(effect, next(iter(by_name.values()), []), data)
    out = [
        Candidate(name, effect, tuple(hs), alone * (_UNSEEN if _of_one_joint(hs[0], data) else 1.0), weights)
        for name, hs in by_name.items()
        if name not in used
    ]
    if several:
        variants = tuple(merged(effect, group) for group in by_constants(instances))
        out.append(Candidate(effect.name, effect, variants, 0.5 * share, weights))
    return out


def _of_one_joint(h: Hypothesis, data: Measurements) -> bool:
    """An error of one joint by the side that another came from, and both came from the same side, or from
    opposite ones, to all poses."""
    joints = joints_of(h.name)
    if len(joints) != 2 or data.direction is None or not h.follows("dir"):
        return False
    a, b = (data.direction[:, joint - 1] for joint in joints)
    return bool((a == b).all() or (a == -b).all())


def _weights(effect: Effect, variants: Sequence[Hypothesis], data: Measurements) -> tuple[float, ...]:
    """Prior weights of the constants of an effect; none where all are equal."""
    weights = tuple(
        math.prod(
            grid_weight(effect.grid[name], value, data) for name, value in h.constants if name in effect.grid
        )
        for h in variants
    )
    return weights if len(set(weights)) > 1 else ()


def merged(effect: Effect, hypotheses: Sequence[Hypothesis], name: str = "") -> Hypothesis:
    """One hypothesis with the parameters of all joints: "joint_compliance" from its instances; name: that of
    some of the joints, "joint_compliance[2,3]"."""
    parameters = tuple(
        replace(p, name=f"{p.name}{h.name[len(effect.name) :]}") for h in hypotheses for p in h.parameters
    )
    return Hypothesis(effect.name, name or effect.name, parameters, hypotheses[0].constants)


def merged_if_several(effect: Effect, hypotheses: Sequence[Hypothesis], name: str = "") -> Hypothesis:
    """All (or, with a name, some) joints of an effect as one hypothesis; a single instance stays as it is."""
    return merged(effect, hypotheses, name) if len(hypotheses) > 1 else hypotheses[0]


def at_joints(whole: Hypothesis, joints: Sequence[int]) -> Hypothesis:
    """An effect at all joints cut down to two or more of them: joint_compliance[2,3]."""
    kept = tuple(p for p in whole.parameters if joints_of(p.name)[0] in joints)
    return replace(whole, name=f"{whole.effect}[{','.join(map(str, joints))}]", parameters=kept)


def grouped_by_name(hypotheses: Iterable[Hypothesis]) -> dict[str, list[Hypothesis]]:
    """Instances by name, each group one place with its grid of constants."""
    groups: dict[str, list[Hypothesis]] = {}
    for h in hypotheses:
        groups.setdefault(h.name, []).append(h)
    return groups


def by_constants(hypotheses: Iterable[Hypothesis]) -> list[list[Hypothesis]]:
    """Groups of instances with the same constants, each group all places of an effect."""
    groups: dict[Constants, list[Hypothesis]] = {}
    for h in hypotheses:
        groups.setdefault(h.constants, []).append(h)
    return list(groups.values())


def joints_of(name: str) -> tuple[int, ...]:
    """Joints that a name states: (2, 3) of joint_compliance[2,3], none for the whole arm or all joints."""
    place = place_of(name)[1:-1]
    return tuple(int(number) for number in place.split(",")) if place else ()


@lru_cache(maxsize=65536)
def covers(name: str, other: str) -> bool:
    """Whether an effect by its name holds another: the same, at all joints, or at some and one of them."""
    if effect_of(name) != effect_of(other):
        return False
    single = joints_of(other)
    return name == other or not joints_of(name) or (len(single) == 1 and single[0] in joints_of(name))
