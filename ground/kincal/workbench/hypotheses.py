"""What competes: every testable effect of the library as candidates with their prior probabilities."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

from kincal.schema.arm import ArmTable
from kincal.schema.names import effect_of as effect_of
from kincal.schema.names import place_of as place_of

from .data import Measurements
from .effects import Effect, Hypothesis, Library, Parameter

# Prior probabilities of "nothing is missing" and "what is missing has no name in the library"; the
# testable effects share the rest equally.
PRIOR_NONE, PRIOR_UNNAMED = 0.3, 0.1

Constants = tuple[tuple[str, float], ...]


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

    def refined(self, finer: Sequence[Hypothesis]) -> Candidate:
        """The same with the part of its grid that `finer` spans replaced by these variants."""
        low, high = min(h.constants for h in finer), max(h.constants for h in finer)
        rest = [h for h in self.variants if not low <= h.constants <= high]
        share = 1.0 / len(self.variants)
        inside = (1.0 - share * len(rest)) or share
        weights = [share] * len(rest) + [inside / len(finer)] * len(finer)
        return replace(self, variants=(*rest, *finer), weights=tuple(weights))


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

    def open(self, taken: Collection[str]) -> tuple[Candidate, ...]:
        """Those that may still be added: an effect that is in at all joints has nothing to add at one."""
        return tuple(c for c in self.candidates if c.name not in taken and c.effect.name not in taken)


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
    out = [Candidate(name, effect, tuple(hs), alone) for name, hs in by_name.items() if name not in used]
    if several:
        variants = tuple(merged(effect, group) for group in by_constants(instances))
        out.append(Candidate(effect.name, effect, variants, 0.5 * share))
    return out


def merged(effect: Effect, hypotheses: Sequence[Hypothesis]) -> Hypothesis:
    """One hypothesis with the parameters of all joints: "joint_compliance" from its instances."""
    parameters = tuple(
        Parameter(f"{p.name}{h.name[len(effect.name) :]}", p.unit, p.sigma, p.terms)
        for h in hypotheses
        for p in h.parameters
    )
    return Hypothesis(effect.name, effect.name, parameters, hypotheses[0].constants)


def merged_if_several(effect: Effect, hypotheses: Sequence[Hypothesis]) -> Hypothesis:
    """All joints of an effect as one hypothesis; a single instance stays as it is."""
    return merged(effect, hypotheses) if len(hypotheses) > 1 else hypotheses[0]


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
