"""Poses to measure next where a diagnosis leaves effects in competition."""

from __future__ import annotations

from collections.abc import Sequence

from kincal_shared.schema.arm import ArmTable
from kincal_shared.schema.names import is_unnamed

from ..data.measurements import Measurements
from ..evidence.constants import choose_constants
from ..fit.least_squares import fit_model
from ..model.effects import Hypothesis, Library
from ..prediction.measurable import Limits
from ..prediction.nextposes import AS_MEASURED, NextPose, next_poses
from .findings import MENTION, Diagnosis

_CERTAIN = 0.9  # probability from which on an effect needs no more poses
_MOST_COMPETING = 4


def advise(diagnosis: Diagnosis, library: Library, *, count: int = 4) -> tuple[NextPose, ...]:
    """Poses to measure next when two or more effects still compete; empty otherwise. The same as
    `separating_poses` of the given model, so that the command that is advised says the same of them."""
    names = _competing(diagnosis, library)[:_MOST_COMPETING]
    if len(names) < 2:
        return ()
    given = diagnosis.comparison.fit_all
    dh = any(name.startswith("J1.") for name in given.names)
    data = diagnosis.comparison.data
    return separating_poses(given.arm, data, library, given.hypotheses, names, dh=dh, count=count)


def separating_poses(
    arm: ArmTable,
    data: Measurements,
    library: Library,
    hypotheses: Sequence[Hypothesis],
    alternatives: Sequence[str],
    *,
    dh: bool,
    count: int,
    limits: Limits = AS_MEASURED,
) -> tuple[NextPose, ...]:
    """The poses that separate alternative effects best beside a model, fitted to all poses. hypotheses, dh:
    of the model."""
    effects = [choose_constants(library, [name], arm, data, dh=dh, joined=True)[0] for name in alternatives]
    return next_poses(fit_model(arm, data, hypotheses, dh=dh), effects, count=count, limits=limits)


def _competing(diagnosis: Diagnosis, library: Library) -> list[str]:
    """Effects that the evidence is not sure of and those confounded with them, without the unnamed, those
    that no data can tell apart, those of the session, which is over, and those that are unlikely against
    something unnamed. What unseen poses do not bear out competes with no other effect by that."""
    likely = [e for e in diagnosis.effects if e.in_model or e.doubts.evidence > MENTION]
    uncertain = [e for e in likely if e.doubts.evidence < _CERTAIN or e.confounded_with]
    names = dict.fromkeys(name for e in uncertain for name in (e.name, *e.confounded_with))
    named = [name for name in names if not is_unnamed(name) and not _is_equivalent(library, name)]
    fit = diagnosis.comparison.fit_all
    return [name for name in named if not any(h.of_session for h in library.find(name, fit.arm, fit.data))]


def _is_equivalent(library: Library, name: str) -> bool:
    effect = library.effect(name)
    return effect is not None and bool(effect.equivalent_to)
