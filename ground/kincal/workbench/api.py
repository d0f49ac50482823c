"""The workbench as objects: `fit` and friends, with results that print themselves.

from kincal import workbench as wb
arm, data = wb.read_arm("arm.toml"), wb.read_csv("poses.csv", 7)
result = wb.fit(arm, data, ["joint_compliance[2]"])
print(result.summary())
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .arms import ArmTable
from .compare import Comparison, compare
from .data import Measurements
from .effects import Hypothesis, Library
from .fit import Fit
from .ladder import Ladder, climb


@dataclass(frozen=True)
class FitResult:
    """A fitted model.

    names: one per coefficient with its unit in the name; estimate, std_err: (k,); rank: directions
    that the data determine, of len(names); ladder: held-out error of each model on the way.
    """

    arm: str
    effects: tuple[str, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    estimate: np.ndarray
    std_err: np.ndarray
    rank: int
    noise_scale: float
    comparison: Comparison
    ladder: Ladder
    fit: Fit

    def summary(self) -> str:
        """The same numbers as text."""
        c = self.comparison
        lines = [
            f"{self.arm}: {c.poses} poses, {len(self.names)} coefficients, rank {self.rank}",
            f"effects: {', '.join(self.effects) or 'none (DH only)'}",
            "",
            f"{'model':<28}{'held out':<18}{'mm':>8}{'mrad':>9}{'ratio':>8}  95 % interval",
        ]
        for rung in self.ladder.rungs:
            rot = f"{rung.rot_rad * 1e3:9.2f}" if rung.rot_rad is not None else f"{'-':>9}"
            ratio = ""
            if rung.ratio is not None and rung.ratio_interval is not None:
                low, high = rung.ratio_interval
                ratio = f"{rung.ratio:8.3f}  {low:.3f} to {high:.3f}"
            lines.append(f"{rung.model:<28}{rung.block:<18}{rung.pos_m * 1e3:8.3f}{rot}{ratio}")
        floor = self.ladder.floor
        floor_text = "unknown" if floor.pos_m is None else f"{floor.pos_m * 1e3:.3f} mm"
        lines += [f"noise floor: {floor_text} ({floor.source})", *self.ladder.verdicts, ""]
        lines.append(f"{'coefficient':<34}{'value':>12}{'std err':>12}  unit")
        for name, unit, value, err in zip(self.names, self.units, self.estimate, self.std_err, strict=True):
            lines.append(f"{name:<34}{value:12.6f}{err:12.6f}  {unit}")
        return "\n".join(lines)


def choose_constants(library: Library, names, arm: ArmTable, data: Measurements, *, dh: bool = True):
    """Hypotheses for effect names, each grid constant (step time ...) at the value with the least cost."""
    from .fit import find_frames, fit_model

    chosen: list[Hypothesis] = []
    frames = find_frames(arm, data)
    for name in names:
        by_constants: dict[tuple, list[Hypothesis]] = {}
        for h in library.find(name, arm, data):
            by_constants.setdefault(h.constants, []).append(h)
        if len(by_constants) == 1:
            chosen += next(iter(by_constants.values()))
            continue
        best = min(
            by_constants.values(),
            key=lambda group: fit_model(arm, data, [*chosen, *group], dh=dh, frames=frames).chi2,
        )
        chosen += best
    return chosen


def fit(
    arm: ArmTable,
    data: Measurements,
    effects=(),
    *,
    library: Library | None = None,
    dh: bool = True,
    progress=None,
) -> FitResult:
    """Fit DH, base and tool as the arm table says, and the named effects; with the ladder of held-out errors."""
    library = library or Library.load()
    for name in effects:
        effect = library.effects.get(name.partition("[")[0])
        lacking = effect.missing(arm, data) if effect else []
        if lacking:
            from .errors import CannotAnswer

            raise CannotAnswer(f"{name} needs {', '.join(lacking)}, which these data do not have")
    hypotheses = choose_constants(library, list(effects), arm, data, dh=dh)
    comparison = compare(arm, data, hypotheses, dh=dh)
    ladder = climb(arm, data, hypotheses, comparison.noise_floor, dh=dh, progress=progress)
    whole = comparison.fit_all
    scaled = whole.J * whole.sigma_prior / whole.scale
    rank = int((np.linalg.svd(scaled, compute_uv=False) > 1.0).sum()) if scaled.size else 0
    return FitResult(
        arm=arm.name,
        effects=tuple(effects),
        names=whole.names,
        units=tuple(p.unit for p in whole.parameters),
        estimate=whole.estimate,
        std_err=whole.std_err,
        rank=rank,
        noise_scale=whole.scale,
        comparison=comparison,
        ladder=ladder,
        fit=whole,
    )
