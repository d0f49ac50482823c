"""Answers of the workbench as JSON (docs/WORKBENCH.md pins the keys) and as text for people."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from ..comparison.compare import Comparison
from ..comparison.fitting import FitResult
from ..diagnosis import Diagnosis, EffectFinding, Remainder, UnnamedFinding
from ..evidence.adequacy import REPLICATES, NoiseFloor, Where
from ..evidence.curves import Curve
from ..evidence.neighbours import Alike
from ..prediction.nested import HELD_OUT, NestedModel, NestedModels
from ..prediction.nextposes import NextPose, would_decide
from . import explain
from .advice import Step
from .design_text import axes_json, design_lines, identifiability_json

Json = dict[str, Any]


# ---------------------------------------------------------------------------------------------- JSON


def _mm(value: float | None) -> float | None:
    """Millimetres (milliradians) of metres (radians); null where there is no number."""
    return None if value is None or not math.isfinite(value) else round(value * 1e3, 6)


def _pos_rot(position_m: float | None, rotation_rad: float | None) -> Json:
    return {"pos_mm": _mm(position_m), "rot_mrad": _mm(rotation_rad)}


def _floor(floor: NoiseFloor) -> Json:
    found = floor.approached
    approached = None if found is None else {"by": found.by, "p_value": found.p_value}
    return {**_pos_rot(floor.pos_m, floor.rot_rad), "source": floor.source, "approached": approached}


def _reachable(c: Comparison) -> Json | None:
    r = c.reachable
    if r is None:
        return None
    usual = _pos_rot(*r.errors_without(c.outliers.ids))
    return {
        **_pos_rot(r.pos_m, r.rot_rad),
        "without_outliers": usual,
        "by": explain.reachable_by(r, structured=c.structured),
    }


def _where(found: Sequence[Where]) -> list[Json]:
    return [
        {
            "variable": w.variable,
            "p_value": w.p_value,
            "share_of_variance": w.share_of_variance,
            "at": w.at,
        }
        for w in found
    ]


def _alike(a: Alike | None) -> Json | None:
    if a is None:
        return None
    return {"by": list(a.by), "at": a.at, "p_value": a.p_value, "correlation": a.correlation}


def comparison_json(c: Comparison) -> Json:
    """`kincal model compare --json`."""
    usual = c.errors_without(c.outliers.ids)
    return {
        "arm": c.arm,
        "data": c.source,
        "poses": c.poses,
        "fit": len(c.split.fit),
        "held": len(c.split.held),
        "skipped": c.skipped,
        "components": c.components,
        "direction": c.data.direction_source,
        "noise_floor": _floor(c.noise_floor),
        "rms": {name: _pos_rot(*pair) for name, pair in c.rms.items()},
        "errors": [
            {
                "model": name,
                "poses": "held" if len(c.split.held) else "fit",
                **_pos_rot(*pair),
                "without_outliers": _pos_rot(*usual[name]),
            }
            for name, pair in c.errors.items()
        ],
        "reachable": _reachable(c),
        "identifiability": identifiability_json(c.identifiability),
        "length_scale": c.length_scale and asdict(c.length_scale),
        "axes": {name: axes_json(axes) for name, axes in c.residual_axes.items()},
        "chi2_per_dof": c.chi2_per_dof,
        "p_lack_of_fit": c.p_lack_of_fit,
        "p_structure": c.p_structure,
        "neighbours": _alike(c.alike),
        "turned_frame": c.turned
        and {"rotation_rad": list(c.turned.rotation_rad), "p_value": c.turned.p_value},
        "p_unseen": c.p_unseen,
        "adequate": c.adequate,
        "worst_poses": [
            {"id": w.id, **_pos_rot(w.pos_m, w.rot_rad), "sigma": w.sigma} for w in c.worst_poses
        ],
        "where": _where(c.where),
        "outliers": list(c.outliers.ids),
        "outlier_note": explain.outlier_note(c.outliers),
        "notes": explain.notes(c),
    }


def diagnosis_json(d: Diagnosis, next_poses: Sequence[NextPose] = (), steps: Sequence[Step] = ()) -> Json:
    """`kincal model diagnose --json`."""
    return {
        **comparison_json(d.comparison),
        "adequate": d.adequate,
        "errors": [
            {
                "model": e.model,
                "poses": "held" if e.block == HELD_OUT else "fit",
                **_pos_rot(e.pos_m, e.rot_rad),
                "without_outliers": _pos_rot(*e.usual),
            }
            for e in d.advised.errors
        ],
        "in_turns": [
            {"model": e.model, **_pos_rot(e.pos_m, e.rot_rad), "without_outliers": _pos_rot(*e.usual)}
            for e in d.advised.crossed
        ]
        or None,
        "advised": {"remove": list(d.advised.removed), "add": list(d.advised.added)},
        "next_steps": [{"why": step.why, "command": step.command} for step in steps],
        "verdict": d.verdict,
        "correlated_in_time": None
        if d.serial is None
        else {"share": d.serial.share, "p_value": d.serial.p_value},
        "probability_none": d.probability_none,
        "adequate_after": d.adequate_after,
        "outliers_after": list(d.outliers.ids),
        "effects": [_effect_json(e) for e in d.effects],
        "novel": None if d.novel is None else _unnamed_json(d.novel),
        "not_testable": [{"name": n.name, "needs": list(n.needs)} for n in d.not_testable],
        "next_poses": poses_json(next_poses),
        "remainder": _remainder_json(d.remainder),
    }


def _effect_json(e: EffectFinding) -> Json:
    return {
        "name": e.name,
        "probability": e.probability,
        "evidence": e.doubts.evidence,
        "support": e.doubts.support,
        "identity": e.doubts.identity,
        "p_value": e.p_value,
        "delta_bic": e.delta_bic,
        "held_rms_before_mm": _mm(e.held.before_m),
        "held_rms_after_mm": _mm(e.held.after_m),
        "held_ratio_interval": [x if math.isfinite(x) else None for x in e.held.interval],
        "held_rotation_ratio": e.held.rotation,
        "constants": dict(e.constants),
        "parameters": [
            {"name": p.name, "value": p.value, "std_err": p.std_err, "unit": p.unit} for p in e.parameters
        ],
        "confounded_with": list(e.confounded_with),
        "inspect": e.inspect,
        "negative": explain.negative(e.parameters),
        "why": explain.why(e),
        "accepted": e.accepted,
        "helps": e.helps,
        "harms": e.harms,
        "in_model": e.in_model,
    }


def _unnamed_json(u: UnnamedFinding) -> Json:
    return {
        "name": u.name,
        "where": u.location,
        "depends_on": list(u.depends_on),
        "suggested_terms": [explain.suggestion(s) for s in u.suggested_terms],
        "p_value": u.p_value,
        "probability": u.probability,
        "held_rms_before_mm": _mm(u.held.before_m),
        "held_rms_after_mm": _mm(u.held.after_m),
        "held_ratio_interval": [x if math.isfinite(x) else None for x in u.held.interval],
        "curves": [_curve_json(c) for c in u.curves],
    }


def _curve_json(c: Curve) -> Json:
    beside = {"beside": c.beside, "at": c.at} if c.beside else {}
    values = {key: [float(f"{v:.6g}") for v in getattr(c, key)] for key in ("x", "value", "std")}
    return {"driver": c.driver, "driver_unit": c.driver_unit, "component": c.component, "unit": c.unit,
            **beside, **values}  # fmt: skip


def _remainder_json(r: Remainder) -> Json:
    return {
        "held": _pos_rot(r.held_pos_m, r.held_rot_rad),
        "noise_floor": _pos_rot(r.floor.pos_m, r.floor.rot_rad),
        "where": _where(r.where),
        "neighbours": _alike(r.alike),
    }


def poses_json(poses: Sequence[NextPose]) -> list[Json]:
    """`kincal model next --json`."""
    return [
        {"q": list(p.q), "direction": None if p.direction is None else list(p.direction),
         "tool_m": list(p.tool_m), "payload_kg": p.payload_kg, "separates": list(p.separates), "d2": p.d2,
         "power": p.power, "probability": p.probability}
        for p in poses
    ]  # fmt: skip


def nested_json(nested: NestedModels) -> Json:
    """Held-out errors of nested models."""
    return {
        "models": [_nested_model_json(m) for m in nested.models],
        "noise_floor": _floor(nested.floor),
        "not_recommended": list(nested.not_recommended),
        "verdicts": [*explain.not_recommended(nested), *(explain.no_gain(n) for n in nested.no_gain)],
    }


def _nested_model_json(m: NestedModel) -> Json:
    return {
        "model": m.model,
        "held_out": m.block,
        **_pos_rot(m.pos_m, m.rot_rad),
        "without_outliers": _pos_rot(*m.usual),
        "systematic_pos_mm": _mm(m.sys_pos_m),
        "max_pos_mm": _mm(m.max_pos_m),
        "ratio": m.ratio,
        "ratio_interval": None if m.ratio_interval is None else list(m.ratio_interval),
    }


def fit_json(f: FitResult) -> Json:
    """`kincal model fit --json`."""
    return {
        **comparison_json(f.comparison),
        "effects": list(f.effects),
        "constants": {name: {"model": mine, "held_out": held} for name, (mine, held) in f.searched.items()},
        "rank": f.rank,
        "noise_scale": f.noise_scale,
        "negative": explain.all_negative(f.fit),
        "parameters": [
            {"name": n, "value": float(v), "std_err": float(s), "unit": u}
            for n, v, s, u in zip(f.names, f.estimate, f.std_err, f.units, strict=True)
        ],
        "nested_models": nested_json(f.nested),
    }


# ---------------------------------------------------------------------------------------------- text


def _text(position_m: float | None, rotation_rad: float | None) -> str:
    if position_m is None or not math.isfinite(position_m):
        return "unknown"
    tail = "" if rotation_rad is None else f", {rotation_rad * 1e3:.2f} mrad"
    return f"{position_m * 1e3:.3f} mm{tail}"


def comparison_text(c: Comparison, *, adequate: bool = True) -> str:
    """Numbers, what is left and where, and the worst poses. adequate: nothing more than the comparison, such
    as a diagnosis, says that the model does not explain the data."""
    untested = "cannot be tested: the noise level is unknown"
    against = REPLICATES if c.noise_floor.source == REPLICATES else "the stated noise"
    p_text = untested if c.p_lack_of_fit is None else f"p = {c.p_lack_of_fit:.3g}, against {against}"
    lines = [
        f"{c.arm}: {c.poses} poses ({len(c.split.fit)} to fit, {len(c.split.held)} held out), "
        f"{c.components} components",
        *([f"skipped: {c.skipped} malformed rows"] if c.skipped else []),
        *([f"lengths            {explain.length_scale(c.length_scale)}"] if c.length_scale else []),
        *_error_lines(c),
        f"reachable          {_reachable_text(c)}",
        f"noise floor        {_floor_text(c.noise_floor)}",
        *([f"replicates         {differ}"] if (differ := explain.approached(c.noise_floor)) else []),
        *design_lines(c),
        f"chi2 / dof         {c.chi2_per_dof:.3f} {_unit_of_chi2(c)}",
        f"lack of fit        {p_text}",
        f"residual           {explain.left_over(c)}",
        *([f"unseen poses       {explain.unseen(c)}"] if c.p_unseen is not None else []),
        f"verdict            {explain.adequacy(c, adequate=adequate)}",
        "",
        *_rest_lines(c),
    ]
    return "\n".join(lines)


def _unit_of_chi2(c: Comparison) -> str:
    """What the residuals are divided by."""
    if c.data.cov is not None:
        return "(relative to the stated noise)"
    if c.components == 3:
        return "(relative to 1 mm: no noise is stated)"
    return "(relative to the noise estimated from the residuals)"


def _error_lines(c: Comparison) -> list[str]:
    """The arm as it is, then with what was fitted of it."""
    held = " on held-out poses" if len(c.split.held) else ""
    errors, after = c.errors, "after DH calibration" if "DH" in c.errors else "after a fit"
    whole = "model" if "model" in errors else "DH"
    alone = []
    if "model" in errors and "DH" in errors:
        alone = [f"DH alone           {_text(*errors['DH'])}{held}{_without(c, 'DH')}"]
        after += ", with the effects"
    return [
        f"nominal arm        {_text(*errors['nominal'])}{held}{_without(c, 'nominal')}",
        *alone,
        f"fitted poses       {_text(*c.rms['fit'])} {after}",
        f"held-out poses     {_text(*c.rms['held'])}" + (f" {after}{_without(c, whole)}" if held else ""),
    ]


def _without(c: Comparison, model: str) -> str:
    """The error without outliers, where there are some among its poses."""
    count = explain.among(c.outliers, c.measured)
    return f" ({explain.without_outliers(count, *c.errors_without(c.outliers.ids)[model])})" if count else ""


def _floor_text(floor: NoiseFloor) -> str:
    if floor.pos_m is None:
        return floor.source
    return f"{_text(floor.pos_m, floor.rot_rad)} ({floor.source})"


def _reachable_text(c: Comparison) -> str:
    r = c.reachable
    if r is None:
        return "unknown (no poses are held out)"
    without = explain.reachable_without(r, c.outliers)
    return f"{_text(r.pos_m, r.rot_rad)} ({without}{explain.reachable_by(r, structured=c.structured)})"


def _rest_lines(c: Comparison) -> list[str]:
    worst = ", ".join(f"{w.id} ({w.pos_m * 1e3:.2f} mm, {w.sigma:.1f} sigma)" for w in c.worst_poses)
    note = explain.outlier_note(c.outliers)
    shown = {explain.in_words(w.variable): w for w in c.where[:6]}
    width = max(map(len, shown), default=0) + 2
    return [
        "where the residual comes from (share of it, p-value):",
        *[
            f"  {name:<{max(width, 38)}}at {w.at:<20}{w.share_of_variance:7.1%}   p = {w.p_value:.2g}"
            for name, w in shown.items()
        ],
        "",
        f"worst poses (in sigma of the residual): {worst}",
        f"outliers of {_model_text(c)}: " + (", ".join(c.outliers.ids) or "none"),
        *([note] if note else []),
        *explain.notes(c),
    ]


def _model_text(c: Comparison) -> str:
    return "the model" if c.fit_all.hypotheses else "the arm after DH calibration"


def poses_text(poses: Sequence[NextPose]) -> str:
    """Numbered poses, and what they buy; each line counts the poses above too. Empty if there are none."""
    if not poses:
        return ""
    lines = [
        f"next poses, to separate {', '.join(poses[0].separates)} (power: chance that the true one then",
        "exceeds P = 0.90, with this pose and those above it):",
    ]
    for k, p in enumerate(poses, 1):
        sign = "" if p.direction is None else "  approach " + " ".join(f"{s:+d}" for s in p.direction)
        lines.append(f"  {k:2d}  q = {', '.join(f'{x:+.3f}' for x in p.q)}{sign}  power {p.power:.2f}")
    last = poses[-1]
    expected = explain.probability(last.probability)
    lines += [
        f"with all {len(poses)} of them, the true effect is expected to reach {expected} against the nearest",
        f"alternative (squared distance d2 = {last.d2:.1f})",
    ]
    if not would_decide(poses):
        lines.append(explain.would_not_decide(poses))
    return "\n".join(lines)


def fit_text(f: FitResult) -> str:
    """Held-out errors of the nested models, then every coefficient."""
    coefficients = zip(f.names, f.estimate, f.std_err, f.units, strict=True)
    width = max(26, *(len(m.model) for m in f.nested.models)) + 2
    without = "   without outliers" if f.comparison.outliers.ids else ""
    return "\n".join(
        [
            f"{f.arm}: {f.comparison.poses} poses, {len(f.names)} coefficients, rank {f.rank}",
            f"effects: {', '.join(f.texts) or 'none (DH only)'}",
            *explain.searched(f),
            *([f"lengths: {explain.length_scale(scale)}"] if (scale := f.comparison.length_scale) else []),
            *explain.all_negative(f.fit),
            "",
            f"{'model':<{width}}{'held out':<18}{'mm':>8}{'mrad':>9}{'ratio':>8}  95 % interval{without}",
            *(f"{m.model:<{width}}{_errors(m, bool(without))}" for m in f.nested.models),
            f"reachable: {_reachable_text(f.comparison)}",
            f"noise floor: {_floor_text(f.nested.floor)}",
            *([f"outliers: {', '.join(f.comparison.outliers.ids)}"] if without else []),
            *explain.not_recommended(f.nested),
            *map(explain.no_gain, f.nested.no_gain),
            *explain.of_session(f.fit),
            *explain.of_order(f.fit),
            "",
            f"{'coefficient':<34}{'value':>12}{'std err':>12}  unit",
            *(_coefficient(*row) for row in coefficients),
        ]
    )


def _coefficient(name: str, value: float, err: float, unit: str) -> str:
    """A line of the table: as many decimals as two digits of the standard error take, at least six."""
    decimals = max(6, 1 - math.floor(math.log10(err))) if err > 0.0 else 6
    return f"{name:<33} {value:12.{decimals}f} {err:11.{decimals}f}  {unit}"


def _errors(m: NestedModel, without_outliers: bool) -> str:
    rotation = f"{m.rot_rad * 1e3:9.2f}" if m.rot_rad is not None else f"{'-':>9}"
    ratio = ""
    if m.ratio is not None and m.ratio_interval is not None:
        low, high = m.ratio_interval
        ratio = f"{m.ratio:8.3f}  {low:.3f} to {high:.3f}"
    line = f"{m.block:<18}{m.pos_m * 1e3:8.3f}{rotation}{ratio}"
    return f"{line:<61}{_text(*m.usual):>14}" if without_outliers else line
