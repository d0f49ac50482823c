"""The posterior at one fit: probabilities of every candidate, of "nothing missing" and of the unnamed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..evidence.bayes_factors import softmax
from ..evidence.scoring import Scored, Scorer, unexplained
from ..evidence.unnamed import Cell
from ..model.effects import Hypothesis
from ..model.hypotheses import PRIOR_NONE, PRIOR_UNNAMED, Candidate, covers, effect_of

NONE, UNNAMED = "none", "novel"  # names in `probability` beside those of effects
ACCEPT_ODDS = 9.0
ABSORBED = 0.995  # share of an effect that the nuisance parameters imitate: the data say nothing about it
_LN_PREFER_SINGLE = math.log(10.0)


@dataclass(frozen=True)
class Posterior:
    """All hypotheses scored at one fit.

    scored: named effects; mapped: cells of the location x driver map; unknown: those of them, and the
    products of two drivers with the most evidence, that no effect describes; probability: by name, sums to
    1, with NONE and UNNAMED among the names. Effects that the nuisance parameters imitate are left out of
    it. tries: products and cells that were scored.
    """

    scorer: Scorer
    scored: tuple[Scored[Hypothesis], ...]
    mapped: tuple[Scored[Cell], ...]
    unknown: tuple[Scored[Cell], ...]
    probability: dict[str, float]
    tries: int = 0

    @classmethod
    def at(cls, scorer: Scorer, candidates: Sequence[Candidate]) -> Posterior:
        """Score candidates and the map, and weigh them by their priors."""
        scored, mapped = scorer.candidates(candidates), scorer.map()
        unknown = unexplained(mapped, scored)
        products, ln_mean, tries = _unknown_products(scorer, scored)
        probability = _probabilities(candidates, scored, unknown, ln_mean)
        both = (*unknown, *products)
        return cls(scorer, tuple(scored), tuple(mapped), both, probability, tries + len(mapped))

    @cached_property
    def by_name(self) -> dict[str, Scored[Hypothesis]]:
        """Scored effects by name."""
        return {s.name: s for s in self.scored}

    @property
    def none(self) -> float:
        """Probability that nothing is missing."""
        return self.probability[NONE]

    @property
    def unnamed(self) -> float:
        """Probability that something is missing that no effect of the library describes."""
        return self.probability.get(UNNAMED, 0.0)

    @property
    def top_unnamed(self) -> Scored[Cell]:
        """The unnamed with the most evidence, of those that there are; at a joint axis unless another place
        explains far more: the tilt of a link about that very axis is the same error."""
        top = max(self.unknown, key=lambda s: s.ln_bf)
        axes = [s for s in self.unknown if s.best.at_joint and s.best.drivers == top.best.drivers]
        axis = max(axes, key=lambda s: s.ln_bf, default=top)
        return axis if axis.ln_bf > top.ln_bf - _LN_PREFER_SINGLE else top

    @property
    def something_missing(self) -> bool:
        """Some hypothesis beats "nothing is missing" by the odds that acceptance needs."""
        best = max(p for name, p in self.probability.items() if name != NONE)
        return best > ACCEPT_ODDS * self.none

    @property
    def unnamed_wins(self) -> bool:
        """Something is missing, and what no effect describes is more likely than each effect."""
        return self.unnamed > ACCEPT_ODDS * self.none and all(
            self.unnamed > self.presence(name) for name in self._effects
        )

    @property
    def _effects(self) -> list[str]:
        return [name for name in self.probability if name not in (NONE, UNNAMED)]

    def named(self, room: int) -> list[str]:
        """Effects by probability, best first, that need no more coefficients than there is room for."""
        fitting = [name for name in self._effects if len(self.by_name[name].best.parameters) <= room]
        return sorted(fitting, key=lambda name: -self.probability[name])

    def best(self, room: int) -> Hypothesis | None:
        """The best effect; one joint alone unless the data clearly ask for all of them."""
        names = self.named(room)
        if not names:
            return None
        single = next((name for name in names if name.startswith(f"{names[0]}[")), None)
        if single is not None and self._explains_as_well(single, names[0]):
            return self.by_name[single].best
        return self.by_name[names[0]].best

    def one_joint(self, h: Hypothesis) -> Hypothesis | None:
        """For an effect at all joints: the joint that explains the data as well alone, if there is one."""
        singles = [s for s in self.scored if h.name == h.effect and s.name.startswith(f"{h.name}[")]
        top = max(singles, key=lambda s: s.ln_bf, default=None)
        return top.best if top is not None and self._explains_as_well(top.name, h.name) else None

    def _explains_as_well(self, single: str, whole: str) -> bool:
        return self.by_name[single].ln_bf > self.by_name[whole].ln_bf - _LN_PREFER_SINGLE

    def presence(self, name: str) -> float:
        """Probability that this effect is there: at this joint (alone or with others), at some of several
        joints, or, for a name without joint, at any joint."""
        same = self._by_effect.get(effect_of(name), ())
        return sum(p for other, p in same if covers(name, other) or covers(other, name))

    @cached_property
    def _by_effect(self) -> dict[str, list[tuple[str, float]]]:
        """Names and probabilities of the instances of each effect."""
        found: dict[str, list[tuple[str, float]]] = {}
        for name, p in self.probability.items():
            found.setdefault(effect_of(name), []).append((name, p))
        return found

    def wins(self, name: str) -> bool:
        """This effect beats nothing (by the odds of acceptance) and the unnamed."""
        return self.presence(name) >= max(ACCEPT_ODDS * self.none, self.unnamed)


def _unknown_products(
    scorer: Scorer, scored: Sequence[Scored[Hypothesis]]
) -> tuple[list[Scored[Cell]], float | None, int]:
    """Products of two drivers that are no effect of the library; ln of the mean Bayes factor of all, and how
    many they are."""
    cells, found = scorer.products()
    if found is None:
        return [], None, 0
    kept = unexplained(cells, scored)
    names = {s.name for s in kept}
    return kept, found.ln_mean([k for k, s in enumerate(cells) if s.name not in names]), found.tries


def _probabilities(
    candidates: Sequence[Candidate],
    scored: Sequence[Scored[Hypothesis]],
    unknown: Sequence[Scored[Cell]],
    products: float | None,
) -> dict[str, float]:
    ln_bf, prior = {NONE: 0.0}, {NONE: PRIOR_NONE}
    for candidate, s in zip(candidates, scored, strict=True):
        if s.score.absorbed < ABSORBED:
            ln_bf[candidate.name], prior[candidate.name] = s.ln_bf, candidate.prior
    if unknown:
        ln_bf[UNNAMED], prior[UNNAMED] = _ln_bf_unnamed(unknown, products), PRIOR_UNNAMED
    return softmax(ln_bf, prior)


def _ln_bf_unnamed(unknown: Sequence[Scored[Cell]], products: float | None) -> float:
    """Evidence of the whole map: half for cells of one driver, half for those of two, equal within; of the
    latter half for smooth functions, half for the dictionary of products (their ln mean)."""
    by_drivers = [[s.ln_bf for s in unknown if len(s.best.drivers) == count] for count in (1, 2)]
    smooth = [_ln_mean(group) for group in by_drivers if group]
    if products is not None:
        smooth[1:] = [_ln_mean([*smooth[1:], products])]
    return _ln_mean(smooth)


def _ln_mean(ln: Iterable[float]) -> float:
    values = list(ln)
    return float(np.logaddexp.reduce(values) - np.log(len(values)))
