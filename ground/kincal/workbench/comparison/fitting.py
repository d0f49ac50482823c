"""A fitted model with its errors on held-out poses.

from kincal import workbench as wb
arm, data = wb.read_arm("arm.toml"), wb.read_csv("poses.csv", 7)
result = wb.fit(arm, data, ["joint_compliance[2]"])
print(result.nested.of("held-out poses")[-1].pos_m)
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from kincal_shared.errors import CannotAnswer
from kincal_shared.schema.arm import ArmTable
from kincal_shared.schema.names import split_constants

from ..data.measurements import Measurements
from ..evidence.constants import Choice
from ..fit.least_squares import Fit
from ..model.effects import Hypothesis, Library
from ..model.grids import data_constants
from ..model.hypotheses import covers
from ..numerics.background import Begin, when_asked
from ..numerics.types import Array, Progress, no_progress
from ..prediction.nested import NestedModels, fit_nested
from .compare import Comparison, compare


@dataclass(frozen=True)
class FitResult:
    """A fitted model.

    effects: by name; texts: as they were asked for, with constants that are kept; names, units, estimate,
    std_err: one per coefficient (k,), values in their units; rank: directions that
    the data determine, of k; noise_scale: fitted over stated noise; nested: held-out error of each model on
    the way; constants: effect -> constants of its bases, e.g. the time of a step.
    """

    arm: str
    effects: tuple[str, ...]
    texts: tuple[str, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    estimate: Array
    std_err: Array
    rank: int
    noise_scale: float
    comparison: Comparison
    nested: NestedModels
    fit: Fit
    constants: dict[str, dict[str, float]]

    @property
    def searched(self) -> dict[str, tuple[dict[str, float], dict[str, float]]]:
        """Effect -> constants that were searched: those of the model, chosen by all poses that may be fitted,
        and those with which held-out poses are predicted, chosen by the others alone."""
        stated = dict(map(split_constants, self.texts))
        found: dict[str, tuple[dict[str, float], dict[str, float]]] = {}
        for name in self.effects:
            mine, held = (
                {k: v for h in fit.hypotheses if covers(name, h.name) for k, v in h.constants}
                for fit in (self.fit, self.comparison.fit_part)
            )
            if set(mine) - set(stated[name]):
                found[name] = mine, held
        return found


def fit(
    arm: ArmTable,
    data: Measurements,
    effects: Sequence[str] = (),
    *,
    library: Library | None = None,
    dh: bool = True,
    progress: Progress = no_progress,
    begin: Begin = when_asked,
) -> FitResult:
    """Fit DH errors (`dh`), base and tool as the arm table says, and the named effects, and measure what
    each brings on held-out poses. effects: as `choose_constants` takes them; begin: as of `compare`.

    CannotAnswer if an effect needs what the data do not have, or as `compare`; BadInput for unknown names.
    """
    library = library or Library.load()
    names = [split_constants(text)[0] for text in effects]
    check_needs(library, names, arm, data)
    choice = Choice(library, tuple(effects), arm, data, dh)
    hypotheses = choice.hypotheses
    comparison = compare(arm, data, hypotheses, dh=dh, begin=begin, anew=choice.anew)
    nested = fit_nested(
        arm, data, hypotheses, comparison.noise_floor, names,
        dh=dh, outliers=comparison.outliers.ids, anew=choice.anew, progress=progress,
    )  # fmt: skip
    whole = comparison.fit_all
    return FitResult(
        arm=arm.name,
        effects=tuple(names),
        texts=tuple(effects),
        names=whole.names,
        units=tuple(p.unit for p in whole.parameters),
        estimate=whole.estimate,
        std_err=whole.std_err,
        rank=whole.rank,
        noise_scale=whole.scale,
        comparison=comparison,
        nested=nested,
        fit=whole,
        constants=_constants(names, hypotheses, data),
    )


def check_needs(library: Library, names: Iterable[str], arm: ArmTable, data: Measurements) -> None:
    """CannotAnswer that names what an effect needs and the data or the arm table do not have."""
    for name, _ in map(split_constants, names):
        library.check_joints(name, arm)
        effect = library.effect(name)
        lacking = effect.missing(arm, data) if effect else []
        if lacking:
            raise CannotAnswer(f"{name} needs {', '.join(lacking)}, which these data do not have")


def _constants(
    names: Sequence[str], hypotheses: Sequence[Hypothesis], data: Measurements
) -> dict[str, dict[str, float]]:
    """Constants of every effect by the name it was asked for with."""
    return {
        name: data_constants(data) | dict(h.constants)
        for name in names
        for h in hypotheses
        if covers(name, h.name)
    }
