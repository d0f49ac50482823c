"""The workbench as objects: `fit` and friends, with results that print themselves.

from kincal import workbench as wb
arm, data = wb.read_arm("arm.toml"), wb.read_csv("poses.csv", 7)
result = wb.fit(arm, data, ["joint_compliance[2]"])
print(result.summary())
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kincal.errors import BadInput, CannotAnswer

from .answers import poses_json
from .arms import ArmTable
from .compare import BULK, Comparison, compare
from .data import Measurements
from .diagnose import Diagnosis
from .effects import Hypothesis, Library, data_constants, finer
from .engine import Engine, merged
from .fit import Fit, find_frames, fit_model
from .ladder import Ladder, climb
from .nextposes import next_poses
from .power import confounding, harm


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
    constants: dict[str, dict[str, float]]  # effect -> constants of its bases, e.g. the time of a step

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


class _Chooser:
    """Scores groups of hypotheses beside a model, to choose constants: linear in the effect, so cheap."""

    def __init__(self, arm: ArmTable, data: Measurements, beside: list[Hypothesis], dh: bool, frames) -> None:
        fit = fit_model(arm, data, beside, dh=dh, frames=frames)
        self.engine = Engine(fit, np.where(fit.weight > BULK, 1.0, fit.weight), data.cov is not None)

    def best(self, groups: list[list[Hypothesis]]) -> list[Hypothesis]:
        columns = self.engine.columns
        scored = self.engine.scores([np.hstack([columns.hypothesis(h) for h in group]) for group in groups])
        return groups[int(np.argmax([s.chi2 for s, _ in scored]))]


def choose_constants(
    library: Library,
    names,
    arm: ArmTable,
    data: Measurements | None,
    *,
    dh: bool = True,
    joined: bool = False,
    known: dict[str, dict[str, float]] | None = None,
) -> list[Hypothesis]:
    """Hypotheses for effect names, each grid constant (step time ...) at the value with the least cost,
    or as known (effect -> constant -> value) from an earlier fit.

    joined: a name without a joint becomes one hypothesis of all joints instead of one per joint.
    """
    known = known or {}
    found: dict[str, list[Hypothesis]] = {}
    open_names = [n for n in names if library.grid_of(n, known.get(n, {}))]
    if open_names and data is None:
        raise BadInput(
            f"{open_names[0]} has constants that come from measurements; "
            "run `kincal model fit` or give --data"
        )
    for name in names:
        if name not in open_names:
            found[name] = library.find(name, arm, data, known.get(name))
    frames = find_frames(arm, data) if open_names else None
    for name in open_names:
        chooser = _Chooser(arm, data, [h for hs in found.values() for h in hs], dh, frames)
        best = chooser.best(_by_constants(library.find(name, arm, data)))
        for constant, values in library.grid_of(name).items():
            fixed = dict(best[0].constants)
            near = finer(values, fixed[constant], data)  # the grid is coarse
            if near:
                tried = [library.find(name, arm, data, {**fixed, constant: v}) for v in near]
                best = chooser.best(tried)
        found[name] = best
    chosen: list[Hypothesis] = []
    for name in names:
        group = found[name]
        chosen += [merged(library.effects[group[0].effect], group)] if joined and len(group) > 1 else group
    return chosen


def _by_constants(hypotheses: list[Hypothesis]) -> list[list[Hypothesis]]:
    groups: dict[tuple, list[Hypothesis]] = {}
    for h in hypotheses:
        groups.setdefault(h.constants, []).append(h)
    return list(groups.values())


def advise(diagnosis: Diagnosis, library: Library, *, count: int = 4) -> list[dict]:
    """Next poses when two or more effects still compete; empty otherwise."""
    arm, data = diagnosis.final.chain.arm, diagnosis.final.chain.data
    uncertain = [e for e in diagnosis.effects if e.probability < 0.9 or e.confounded_with]
    names = list(dict.fromkeys(n for e in uncertain for n in (e.name, *e.confounded_with)))
    names = [n for n in names if not library.effects[n.partition("[")[0]].twin_of][:4]
    if len(names) < 2:
        return []
    known = {h.name: dict(h.constants) for h in diagnosis.final.hypotheses if h.constants}
    rivals = [choose_constants(library, [n], arm, data, joined=True, known=known)[0] for n in names]
    base = fit_model(arm, data, frames=(diagnosis.final.base, diagnosis.final.tool))
    return poses_json(next_poses(base, rivals, count=count))


def report(
    path, diagnosis: Diagnosis, library: Library, arm, data, effects, poses, progress=None
) -> list[Path]:
    """Write the diagnosis report; returns the files."""
    from .report import Content, write_report

    accepted = [h for h in diagnosis.final.hypotheses if h.name not in {e.name for e in effects}]
    ladder = climb(arm, data, [*effects, *accepted], diagnosis.comparison.noise_floor, progress=progress)
    fit_all = diagnosis.comparison.fit_all
    testable = [
        e for e in library.effects.values() if not e.missing(arm, fit_all.chain.data) and not e.twin_of
    ]
    named = []
    for effect in testable:
        if effect.per != "pair" or effect.pairs:
            group = effect.instances(arm, fit_all.chain.data)
            first = [h for h in group if h.constants == group[len(group) // 2].constants]
            named.append(first[0] if len(first) == 1 else merged(effect, first))
    shown = [h for h in named if any(p.terms for p in h.parameters)]
    content = Content(diagnosis, library, ladder, confounding(fit_all, shown), harm(fit_all, shown), poses)
    return write_report(path, content)


def fit(
    arm: ArmTable,
    data: Measurements,
    effects=(),
    *,
    library: Library | None = None,
    dh: bool = True,
    progress=None,
) -> FitResult:
    """Fit DH, base and tool as the arm table says, and the named effects; with the ladder of held-out
    errors."""
    library = library or Library.load()
    for name in effects:
        effect = library.effects.get(name.partition("[")[0])
        lacking = effect.missing(arm, data) if effect else []
        if lacking:
            raise CannotAnswer(f"{name} needs {', '.join(lacking)}, which these data do not have")
    hypotheses = choose_constants(library, list(effects), arm, data, dh=dh)
    comparison = compare(arm, data, hypotheses, dh=dh)
    ladder = climb(arm, data, hypotheses, comparison.noise_floor, dh=dh, progress=progress)
    whole = comparison.fit_all
    return FitResult(
        arm=arm.name,
        effects=tuple(effects),
        names=whole.names,
        units=tuple(p.unit for p in whole.parameters),
        estimate=whole.estimate,
        std_err=whole.std_err,
        rank=whole.rank,
        noise_scale=whole.scale,
        comparison=comparison,
        ladder=ladder,
        fit=whole,
        constants={
            name: data_constants(data) | dict(h.constants)
            for name in effects
            for h in hypotheses
            if h.effect == name.partition("[")[0] and (h.name == name or "[" not in name)
        },
    )
