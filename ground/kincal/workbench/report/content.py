"""Everything that a report of a diagnosis shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from kincal_shared.schema.arm import ArmTable
from kincal_shared.schema.names import split_constants

from ..data.measurements import Measurements
from ..diagnosis import Diagnosis
from ..evidence.constants import Choice
from ..model.effects import Effect, Hypothesis, Library
from ..model.hypotheses import by_constants, merged_if_several
from ..numerics.types import Progress, no_progress
from ..prediction.nested import NestedModels, fit_nested
from ..prediction.nextposes import NextPose
from ..prediction.power import Confounding, Harm, confounding, harm


@dataclass(frozen=True)
class ReportContent:
    """Everything a diagnosis report shows."""

    diagnosis: Diagnosis
    library: Library
    nested: NestedModels
    confounding: Confounding
    harm: tuple[Harm, ...]
    next_poses: tuple[NextPose, ...]


def report_content(
    diagnosis: Diagnosis,
    library: Library,
    given: Sequence[str] = (),
    poses: Sequence[NextPose] = (),
    *,
    dh: bool = True,
    progress: Progress = no_progress,
) -> ReportContent:
    """What a report shows beside the diagnosis: nested models, confounding and harm of every effect.

    given: the effects that the diagnosed model had from the start, as `choose_constants` takes them; dh:
    whether it has DH errors; poses: as `advise` gave them.
    """
    whole = diagnosis.comparison.fit_all
    arm = whole.arm
    effects = diagnosis.advised.model_after(given)
    data, floor = diagnosis.comparison.data, diagnosis.comparison.noise_floor
    outliers = diagnosis.outliers.ids
    choice = Choice(library, effects, arm, data, dh)
    names = [split_constants(text)[0] for text in effects]
    nested = fit_nested(
        arm, data, choice.hypotheses, floor, names,
        dh=dh, outliers=outliers, anew=choice.anew, progress=progress,
    )  # fmt: skip
    shown = _shown(library, arm, whole.data)
    return ReportContent(
        diagnosis, library, nested, confounding(whole, shown), harm(whole, shown), tuple(poses)
    )


def _shown(library: Library, arm: ArmTable, data: Measurements) -> list[Hypothesis]:
    """Each testable effect at all its joints; pairs of joints only where the library lists them."""
    testable = [e for e in library.effects.values() if not e.missing(arm, data) and not e.equivalent_to]
    listed = [e for e in testable if e.per != "pair" or e.pairs]
    wholes = [_whole(e, e.instances(arm, data)) for e in listed if e.instances(arm, data)]
    return [h for h in wholes if any(p.terms for p in h.parameters)]


def _whole(effect: Effect, instances: list[Hypothesis]) -> Hypothesis:
    """An effect at all joints, its constants in the middle of their grid."""
    middle = instances[len(instances) // 2].constants
    group = next(group for group in by_constants(instances) if group[0].constants == middle)
    return merged_if_several(effect, group)
