"""Comparison and diagnosis, as text for people and as a table in a notebook."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from kincal.workbench.comparison.compare import Comparison
from kincal.workbench.data.measurements import Measurements
from kincal.workbench.diagnosis import Diagnosis
from kincal.workbench.numerics.types import Progress, no_progress
from kincal.workbench.report import answers
from kincal.workbench.report.diagnosis_text import diagnosis_text

from . import html
from .case import Case
from .inputs import Arm, Data, checked


@dataclass(frozen=True)
class Compared:
    """What a model leaves of the measurements; `comparison` holds all numbers."""

    comparison: Comparison

    def __str__(self) -> str:
        """What `kincal model compare` prints."""
        return answers.comparison_text(self.comparison)

    def _repr_html_(self) -> str:
        rows = [(name, *map(html.mm, pair)) for name, pair in self.comparison.rms.items()]
        return html.table(("poses", "mm", "mrad"), rows, self.comparison.arm) + html.text(str(self))


@dataclass(frozen=True)
class Diagnosed:
    """Which effects are missing; `diagnosis` holds all numbers."""

    diagnosis: Diagnosis

    @property
    def effects(self) -> tuple[str, ...]:
        """Effects that were accepted, or help, with the constants that were found: `fit` takes them."""
        return self.diagnosis.advised.added

    def __str__(self) -> str:
        """What `kincal model diagnose` prints."""
        return diagnosis_text(self.diagnosis)

    def _repr_html_(self) -> str:
        rows = [
            (e.name, f"{e.probability:.2f}", html.mm(e.held.before_m), html.mm(e.held.after_m))
            for e in self.diagnosis.effects
        ]
        head = ("effect", "probability", "held-out mm before", "after")
        return html.table(head, rows, self.diagnosis.comparison.arm) + html.text(str(self))


def compare(
    arm: Arm, data: Data | Measurements, effects: Sequence[str] = (), *, force: bool = False
) -> Compared:
    """Does the model (DH errors and these effects) explain the data, and where does it fail?

    Errors as `kincal.workbench.compare`, and BadInput if arm and data do not belong together, unless forced;
    `comparison.consistency` says what is odd.
    """
    read = checked(arm, data, force)
    return Compared(Case(arm.table, read, tuple(effects)).compare())


def diagnose(
    arm: Arm,
    data: Data | Measurements,
    effects: Sequence[str] = (),
    *,
    force: bool = False,
    progress: Progress = no_progress,
) -> Diagnosed:
    """Which effect is missing beside the DH errors and these effects? Errors as `compare`."""
    read = checked(arm, data, force)
    return Diagnosed(Case(arm.table, read, tuple(effects)).diagnose(progress))
