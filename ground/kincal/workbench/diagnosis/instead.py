"""Another cause in the place of one that held-out poses contradict: two effects may do the same to the poses
that were fitted, and only one of them to others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from ..model.hypotheses import effect_of
from .findings import confounded_effects
from .guard import never_worse
from .selection import select
from .states import Kept, Selection
from .study import Model, Study

_TRIES = 3  # effects that are left out, one after another


def instead(
    study: Study, found: Selection, taking: Callable[[Model], None], evaluated: Callable[[Study], Study]
) -> tuple[Study, Selection]:
    """The selection of `never_worse`, or, where it took back an effect that others imitate, the one without
    that effect, if held-out poses surely gain from it; and the study that it is of. evaluated: gives the
    study of all poses."""
    for _ in range(_TRIES):
        gone = _imitated(study, found)
        if gone is None:
            return study, found
        others = study.without(effect_of(gone.effect.name))
        again = never_worse(others, select(others, taking), evaluated(others))
        if not evaluated(study).held_change(found.model, again.model).gains:
            return study, found
        study, found = others, replace(again, taken_back=(*again.taken_back, gone))
    return study, found


def _imitated(study: Study, found: Selection) -> Kept | None:
    """Of the effects that were taken back and that compete, the one with the most evidence, if these data
    cannot tell another effect from it."""
    names = {c.name for c in study.competition.candidates}
    back = [k for k in found.taken_back if k.role == "accepted" and effect_of(k.effect.name) in names]
    most = max(back, key=lambda k: k.posterior.by_name[k.effect.name].ln_bf, default=None)
    if most is None:
        return None
    alike = confounded_effects(study, most.effect, most.posterior)
    return most if any(effect_of(name) != most.effect.effect for name in alike) else None
