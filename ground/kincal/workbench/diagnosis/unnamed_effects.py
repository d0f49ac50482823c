"""Unnamed effects that are asked for by name, found in the data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from kincal_shared.schema.arm import ArmTable
from kincal_shared.schema.names import UNNAMED, is_unnamed

from ..comparison.compare import Comparison, compare
from ..comparison.fitting import check_needs
from ..data.measurements import Measurements
from ..evidence.constants import Choice
from ..evidence.smooth import SmoothEffect
from ..model.effects import Hypothesis, Library
from ..model.unnamed_names import UnnamedName
from ..numerics.types import Progress, no_progress
from ..prediction.nested import EffectGain, harmful
from .additions import Addition, Additions, add_one, add_unnamed, only


@dataclass(frozen=True)
class Found:
    """Names of effects, the unnamed ones among them found in the data.

    names: what was asked for, in its order, "unnamed" replaced by what was found; additions: the terms of
    each unnamed effect and what it brings; all_of_them: of the last "unnamed", None if it was not asked for;
    against: what speaks against unnamed effects, as a fit finds it: those that "unnamed" found were left out,
    one that was asked for by its name stays.
    """

    names: tuple[str, ...]
    additions: tuple[Addition, ...] = ()
    all_of_them: Additions | None = None
    against: tuple[EffectGain, ...] = ()


def find_unnamed(
    arm: ArmTable,
    data: Measurements,
    names: Sequence[str],
    beside: Sequence[str] = (),
    *,
    library: Library | None = None,
    dh: bool = True,
    progress: Progress = no_progress,
) -> Found:
    """Effects with the terms of the unnamed ones chosen on the fit poses of the data.

    names: of any effects; "unnamed[joint 1: q1, q3]" is the smooth function there, "unnamed" as many of them
    as pay (`add_unnamed`), each beside the effects before it and `beside`, without those that a fit would
    advise against. Errors as `fit`; BadInput for an unknown place or driver; CannotAnswer where
    the data do not vary the driver, or ask for no term of that function.
    """
    known, found = library or Library.load(), Found(())
    for name in names:
        effects = (*beside, *found.names)
        if name != UNNAMED and not is_unnamed(name):
            found = replace(found, names=(*found.names, name))
            continue
        check_needs(known, effects, arm, data)
        choice = Choice(known, effects, arm, data, dh)
        comparison = compare(arm, data, choice.hypotheses, dh=dh, anew=choice.anew)
        hypotheses = comparison.fit_part.hypotheses
        if name == UNNAMED:
            every = add_unnamed(comparison, hypotheses, dh=dh, progress=progress)
            every, against = _harmless(comparison, choice, every, progress=progress)
            found = replace(found, all_of_them=every, against=(*found.against, *against))
            new = every.steps
        else:
            new = (add_one(comparison, UnnamedName.parse(name), hypotheses, dh=dh),)
            speaks = _against(choice, [new[0].effect], progress=progress)
            found = replace(found, against=(*found.against, *speaks))
        called = tuple(str(addition.effect.name) for addition in new)
        found = replace(found, names=(*found.names, *called), additions=(*found.additions, *new))
        known = known.with_unnamed([addition.effect.entry() for addition in new])
    return found


def _harmless(
    comparison: Comparison,
    choice: Choice,
    every: Additions,
    *,
    progress: Progress,
) -> tuple[Additions, list[EffectGain]]:
    """The unnamed effects without those that `fit` would advise against, and why those were left out. The
    worst goes first: without it others may do no harm."""
    effects, out = [step.effect for step in every.steps], list[EffectGain]()
    while against := _against(choice, effects, progress=progress):
        worst = max(against, key=lambda g: g.interval[0]).effect
        out += [g for g in against if g.effect == worst]
        effects = [effect for effect in effects if str(effect.name) != worst]
    hypotheses = comparison.fit_part.hypotheses
    return (only(comparison, hypotheses, effects, dh=choice.dh) if out else every), out


def _against(
    choice: Choice, effects: Sequence[SmoothEffect], *, progress: Progress
) -> tuple[EffectGain, ...]:
    """What speaks against unnamed effects beside those of a model."""
    if not effects:
        return ()
    added = [effect.hypothesis for effect in effects]

    def anew(part: Measurements) -> list[Hypothesis]:
        return [*choice.anew(part), *added]

    return harmful(
        choice.arm, choice.data, [*choice.hypotheses, *added], [str(effect.name) for effect in effects],
        dh=choice.dh, anew=anew, progress=progress,
    )  # fmt: skip
