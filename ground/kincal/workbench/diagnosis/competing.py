"""Poses to measure next where a diagnosis leaves effects in competition."""

from __future__ import annotations

from ..evidence.constants import choose_constants
from ..fit.least_squares import fit_model
from ..model.effects import Library
from ..prediction.nextposes import NextPose, next_poses
from .findings import Diagnosis

_CERTAIN = 0.9  # probability from which on an effect needs no more poses
_MOST_COMPETING = 4


def advise(diagnosis: Diagnosis, library: Library, *, count: int = 4) -> tuple[NextPose, ...]:
    """Poses to measure next when two or more effects still compete; empty otherwise."""
    final = diagnosis.final
    names = _competing(diagnosis, library)[:_MOST_COMPETING]
    if len(names) < 2:
        return ()
    known = {h.name: dict(h.constants) for h in final.hypotheses if h.constants}
    effects = [
        choose_constants(library, [name], final.arm, final.data, joined=True, known=known)[0]
        for name in names
    ]
    plain = fit_model(final.arm, final.data, frames=(final.base, final.tool))
    return next_poses(plain, effects, count=count)


def _competing(diagnosis: Diagnosis, library: Library) -> list[str]:
    """Effects that the evidence is not sure of and those confounded with them, without those that no data can
    tell apart. What unseen poses do not bear out competes with no other effect by that."""
    uncertain = [e for e in diagnosis.effects if e.doubts.evidence < _CERTAIN or e.confounded_with]
    names = dict.fromkeys(name for e in uncertain for name in (e.name, *e.confounded_with))
    return [name for name in names if not _is_equivalent(library, name)]


def _is_equivalent(library: Library, name: str) -> bool:
    effect = library.effect(name)
    return effect is not None and bool(effect.equivalent_to)
