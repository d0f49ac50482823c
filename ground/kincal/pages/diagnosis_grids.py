"""Tables of a diagnosis page."""

from __future__ import annotations

import math

from kincal.pages.page import Cell, Grid
from kincal.workbench.diagnosis import Diagnosis, EffectFinding, ParameterValue
from kincal.workbench.prediction.gain import Gain
from kincal.workbench.prediction.nested import EffectGain, NestedModel, NestedModels
from kincal.workbench.report import explain

_EFFECTS = (
    "<effect|<role|<probability|<against|<measured on|without it [mm]|with it [mm]|ratio 95 % interval"
    "|<judged|<confounded with"
)
_MODELS = "<held out|<model|RMS [mm]|95 % interval|RMS [mrad]|without noise [mm]|worst [mm]|ratio to the line above|95 % interval"  # noqa: E501
_GAINS = "<effect|<held out|without it [mm]|with it [mm]|ratio|95 % interval|<judged"
_SAME_NOTE = (
    "Without it: the final model refitted without this one effect. With it, for an alternative: the final "
    "model plus this effect. Judged by the interval: below 1, helps; above 1, harms; excluding a gain of 3 % "
    "or more, with nothing gained, does not help; otherwise undecided. What surely does not help is not in "
    "the model, however strong the evidence of the fitted poses."
)
_MOODS: dict[Gain, str] = {"helps": "good", "harms": "bad", "does not help": "", "undecided": ""}
_ROLES = {"accepted": "added", "helps": "added: predictions gain", "alternative": "alternative"}


def effects(d: Diagnosis) -> Grid:
    """Every finding with its probability, its gain and its values."""
    return filled(Grid.of(_EFFECTS, [_effect(e, d) for e in d.effects], _SAME_NOTE if d.effects else ""))


def _effect(e: EffectFinding, d: Diagnosis) -> list[str | Cell]:
    kind = "cross-validated" if e.held.cross_validated else "held-out"
    sure = "" if e.role == "helps" else explain.probability(e.probability)
    return [
        e.label, _ROLES[e.role], sure, explain.against(e, d).removeprefix("against "), kind,
        _milli(e.held.before_m), _milli(e.held.after_m), _interval(e.held.interval), _judged(e.held.judged),
        explain.grouped(e.confounded_with),
    ]  # fmt: skip


def parameters(e: EffectFinding) -> Grid:
    """Fitted values of an effect."""
    rows = [[p.name, f"{p.value:.4g}", f"{p.std_err:.2g}", _sigmas(p), p.unit] for p in e.parameters]
    return Grid.of("<parameter|value|standard error|value / error|<unit", rows)


def _sigmas(p: ParameterValue) -> str:
    return f"{p.value / p.std_err:+.1f}" if p.std_err > 0 else ""


def _judged(said: Gain) -> Cell:
    return Cell(said, _MOODS[said])


def _milli(value: float | None) -> str:
    return "" if value is None or not math.isfinite(value) else f"{value * 1e3:.3f}"


def _interval(values: tuple[float, float] | None, scale: float = 1.0) -> str:
    if values is None or not all(map(math.isfinite, values)):
        return ""
    return f"{values[0] * scale:.3f} to {values[1] * scale:.3f}"


def models(nested: NestedModels) -> Grid:
    """Held-out errors, the kinds of holding back one after the other."""
    return filled(Grid.of(_MODELS, [_model(m) for block in nested.blocks for m in nested.of(block)]))


def filled(grid: Grid) -> Grid:
    """The table without columns that are empty in every row."""
    keep = [k for k in range(len(grid.columns)) if any(row[k].text for row in grid.rows)]
    rows = tuple(tuple(row[k] for k in keep) for row in grid.rows)
    return Grid(tuple(grid.columns[k] for k in keep), rows, grid.note)


def _model(m: NestedModel) -> list[str]:
    return [
        m.block, m.model, _milli(m.pos_m), _interval(m.pos_interval, 1e3), _milli(m.rot_rad),
        _milli(m.sys_pos_m), _milli(m.max_pos_m), "" if m.ratio is None else f"{m.ratio:.3f}",
        _interval(m.ratio_interval),
    ]  # fmt: skip


def gains(nested: NestedModels) -> Grid:
    """What each effect brings on each kind of held-out poses."""
    return Grid.of(_GAINS, [_gain(g) for g in nested.gains], _SAME_NOTE if nested.gains else "")


def _gain(g: EffectGain) -> list[str | Cell]:
    return [
        g.effect, g.block, _milli(g.before_m), _milli(g.after_m), f"{g.ratio:.3f}", _interval(g.interval),
        _judged(g.judged),
    ]  # fmt: skip
