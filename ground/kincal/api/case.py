"""An arm, its measurements and a model of it: what the questions of the workbench are about."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

from kincal.workbench.comparison.compare import Comparison, compare
from kincal.workbench.comparison.fitting import FitResult, fit
from kincal.workbench.data.measurements import Measurements
from kincal.workbench.diagnosis import Diagnosis, diagnose
from kincal.workbench.diagnosis.competing import advise, separating_poses
from kincal.workbench.evidence.constants import Choice
from kincal.workbench.model.effects import Hypothesis, Library
from kincal.workbench.model.modelfile import ModelFile
from kincal.workbench.numerics.background import Begin, when_asked
from kincal.workbench.numerics.types import Progress, no_progress
from kincal.workbench.prediction.measurable import Limits
from kincal.workbench.prediction.nextposes import NextPose
from kincal.workbench.report.content import ReportContent, report_content
from kincal_shared.errors import BadInput
from kincal_shared.schema.arm import ArmTable


@dataclass(frozen=True)
class Case:
    """effects: of the model, by name, with the constants that are kept; dh: whether it has DH errors;
    library: that the effects are from. Errors as the functions of `kincal.workbench`."""

    arm: ArmTable
    data: Measurements
    effects: tuple[str, ...] = ()
    dh: bool = True
    library: Library = field(default_factory=Library.load)

    @classmethod
    def of_model(cls, arm: ArmTable, data: Measurements, model: ModelFile, library: Library) -> Case:
        """With the effects of a model file."""
        return cls(arm, data, model.texts, model.dh, library)

    @cached_property
    def hypotheses(self) -> list[Hypothesis]:
        """The effects of the model, their open constants chosen from the data."""
        return self._choice.hypotheses

    @cached_property
    def _choice(self) -> Choice:
        return Choice(self.library, self.effects, self.arm, self.data, self.dh)

    def compare(self, begin: Begin = when_asked) -> Comparison:
        """Does the model explain the data, and where does it fail?"""
        return compare(
            self.arm, self.data, self.hypotheses, dh=self.dh, begin=begin, anew=self._choice.anew
        )  # fmt: skip

    def diagnose(self, progress: Progress = no_progress, begin: Begin = when_asked) -> Diagnosis:
        """Which effect does the model lack?"""
        return diagnose(
            self.arm, self.data, self.library, self.hypotheses,
            given=self.effects, dh=self.dh, progress=progress, begin=begin, anew=self._choice.anew,
        )  # fmt: skip

    def advise(self, diagnosis: Diagnosis) -> tuple[NextPose, ...]:
        """Poses to measure next where effects still compete; empty otherwise."""
        return advise(diagnosis, self.library)

    def report(
        self, diagnosis: Diagnosis, poses: Sequence[NextPose], progress: Progress = no_progress
    ) -> ReportContent:
        """What the page of a diagnosis shows."""
        return report_content(
            diagnosis, self.library, self.effects, poses, dh=self.dh, progress=progress
        )  # fmt: skip

    def fit(self, progress: Progress = no_progress, begin: Begin = when_asked) -> FitResult:
        """The model fitted to the data, with its errors on held-out poses."""
        return fit(
            self.arm, self.data, self.effects,
            library=self.library, dh=self.dh, progress=progress, begin=begin,
        )  # fmt: skip

    def separating_poses(
        self, alternatives: Sequence[str], *, count: int, limits: Limits
    ) -> tuple[NextPose, ...]:
        """The poses that separate alternative effects best. BadInput if those are not two or more."""
        check_alternatives(alternatives)
        return separating_poses(
            self.arm, self.data, self.library, self.hypotheses, alternatives,
            dh=self.dh, count=count, limits=limits,
        )  # fmt: skip


def check_alternatives(names: Sequence[str]) -> None:
    """BadInput unless these are two or more different effects."""
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise BadInput(f"{twice[0]} is given twice", todo="name two or more different effects")
    if len(names) < 2:
        raise BadInput(
            "one effect alone is no choice",
            todo="name two or more alternative effects: joint_compliance[2] base_flex",
        )
