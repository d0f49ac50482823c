"""Which physical effect is missing: evidence for every effect and joint, with calibrated probabilities.

docs/METHOD.md 12 to 17 give the mathematics. What competes is in `hypotheses`; here: the `posterior` at one
fit, a `study` of one data set, the `selection` of effects forward and backward, and the `findings`. The
probabilities are conditional on the library and on its priors; wording is "consistent with", never "proven".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from kincal_shared.schema.arm import ArmTable

from ..comparison.compare import compare
from ..data.measurements import Measurements
from ..data.split import choose_split
from ..evidence.constants import Anew
from ..fit.thinning import MANY, part_of
from ..model.effects import Hypothesis, Library
from ..numerics.background import Begin, when_asked
from ..numerics.types import Progress, no_progress
from .advised import advised, texts_of
from .findings import Diagnosis, EffectFinding, ParameterValue, Remainder, UnnamedFinding, conclude, promising
from .guard import correlated_noise, holding, never_worse
from .heldout import HeldGain
from .instead import instead
from .selection import MAX_EFFECTS, select
from .study import Model, Study

__all__ = [
    "Diagnosis",
    "EffectFinding",
    "HeldGain",
    "ParameterValue",
    "Remainder",
    "UnnamedFinding",
    "diagnose",
]

_STEPS = MAX_EFFECTS + 3


def diagnose(
    arm: ArmTable,
    data: Measurements,
    library: Library,
    hypotheses: Sequence[Hypothesis] = (),
    *,
    given: Sequence[str] | None = None,
    dh: bool = True,
    progress: Progress = no_progress,
    begin: Begin = when_asked,
    anew: Anew | None = None,
) -> Diagnosis:
    """Find the effects that the data ask for, one after another, and say how sure that is.

    library: the effects that compete; hypotheses: effects that are in the model already; given: as they were
    asked for (absent: with the constants that they have); dh: DH errors are; begin, anew: as of `compare`.
    BadInput if the units of the data look wrong, CannotAnswer if its poses are too few or too similar.
    """

    def taking(model: Model) -> None:
        what = f"evidence beside {model[-1].name}" if model else "evidence"
        progress(what, 1 + len(model), _STEPS)

    def of_all(study: Study) -> Study:
        return study.judging(comparison)

    progress("fit", 0, _STEPS)
    comparison, part = compare(arm, data, hypotheses, dh=dh, begin=begin, anew=anew), searched(data)
    of_part = comparison if part is data else compare(arm, part, hypotheses, dh=dh)
    study = Study.of(of_part, library, hypotheses, dh)
    found = select(study, taking)
    progress("check", _STEPS - 1, _STEPS)
    evaluation = of_all(study)
    study, kept = instead(study, never_worse(study, found, evaluation), taking, of_all)
    evaluation = of_all(study)
    serial = correlated_noise(evaluation, kept.model)
    if serial is not None:
        evaluation = evaluation.by_stretches()
        kept = holding(study, kept, evaluation)
        serial = correlated_noise(evaluation, kept.model) or serial  # in what those leave that hold
    asked = texts_of(hypotheses) if given is None else given
    answer = conclude(evaluation, kept, serial)
    advice = advised(arm, data, library, asked, kept.model, dh=dh, outliers=answer.outliers.ids)
    return promising(answer, advice)


def searched(data: Measurements) -> Measurements:
    """The poses that effects are searched on: all, or a designed part of many; held-out ones stay so."""
    if data.n <= MANY:
        return data
    held = np.isin(np.arange(data.n), choose_split(data).held)
    split = np.where(held, "held", "fit")
    return replace(data, split=split).take(part_of(data))
