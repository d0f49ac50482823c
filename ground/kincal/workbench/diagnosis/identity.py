"""How sure a name is while the model with it leaves more than noise: it may stand for a similar effect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from kincal_shared.schema.terms import ONE

from ..evidence.adequacy import STRUCTURE_P, Where, explained, structure
from ..evidence.neighbours import Alike
from ..fit.least_squares import Fit
from ..model.effects import Hypothesis
from ..model.places import all_places

NAMED_RIGHT = 0.9
"""How often names were right that the blind bench stated with 0.80 to 0.95, most of them in models that left
more than noise (docs/DIAGNOSIS.md)."""


@dataclass(frozen=True)
class Left:
    """What a final model leaves: its fit, p-value of lack of fit (None where no noise is known), and what the
    rest follows, of all variables; alike, p_unseen: as of `Comparison`; clusters: variables in which its
    outliers cluster, which the tests leave out."""

    fit: Fit
    p_lack_of_fit: float | None
    where: tuple[Where, ...]
    alike: Alike | None = None
    p_unseen: float | None = None
    clusters: tuple[str, ...] = ()

    @property
    def is_noise(self) -> bool:
        """No more than a known noise, if there is one, follows no variable, not alike at near poses, and no
        outliers that are an effect."""
        return not self.clusters and explained(
            self.p_lack_of_fit, structure(self.where), self.alike, self.p_unseen
        )

    @property
    def is_known_noise(self) -> bool:
        """It is noise, and of the size that is known: evidence holds as it stands."""
        return self.p_lack_of_fit is not None and self.is_noise

    def identity(self, h: Hypothesis) -> float:
        """Probability that an effect is what its name says. Where the noise is known and more is left,
        something is missing, and any name may stand for it. Where it is unknown, what a similar effect would
        leave shows at a place of this one, or follows a variable of it."""
        doubtful = not self.is_noise if self.p_lack_of_fit is not None else self._similar(h)
        return NAMED_RIGHT if doubtful else 1.0

    def _similar(self, h: Hypothesis) -> bool:
        places, variables = self._places(h), _variables(h)
        return any(w.at in places or w.variable in variables for w in self._beyond_chance())

    def _beyond_chance(self) -> Sequence[Where]:
        return [w for w in self.where if w.p_value * len(self.where) <= STRUCTURE_P]

    def _places(self, h: Hypothesis) -> set[str]:
        """Places of the map where the terms of an effect act."""
        at = {(term.frame, term.comp) for p in h.parameters for term in p.terms}
        every = all_places(self.fit.arm, self.fit.data)
        return {place.name for place in every if any((place.frame, c) in at for c in place.components)}


def _variables(h: Hypothesis) -> set[str]:
    """Variables of the map that an effect follows; time by both its names."""
    bases = {b for p in h.parameters for term in p.terms for b in term.basis if b != ONE}
    names = {f"{b.var}{b.index or ''}" for b in bases}
    return names | {"order"} if "t" in names else names
