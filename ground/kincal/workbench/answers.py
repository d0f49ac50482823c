"""Answers of the workbench as JSON (docs/WORKBENCH.md pins the keys) and as text for people."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from .compare import Comparison, Where
from .diagnose import Diagnosis
from .ladder import Ladder
from .nextposes import NextPose

if TYPE_CHECKING:
    from .api import FitResult


def _mm(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else round(value * 1e3, 6)


def _pos_rot(pair: tuple[float | None, float | None]) -> dict:
    return {"pos_mm": _mm(pair[0]), "rot_mrad": _mm(pair[1])}


def _where(found: tuple[Where, ...]) -> list[dict]:
    return [
        {
            "variable": w.variable,
            "p_value": w.p_value,
            "share_of_variance": w.share_of_variance,
            "at": w.at,
        }
        for w in found
    ]


def comparison_json(c: Comparison) -> dict:
    return {
        "arm": c.arm,
        "data": c.source,
        "poses": c.poses,
        "fit": len(c.split.fit),
        "held": len(c.split.held),
        "skipped": c.skipped,
        "components": c.components,
        "noise_floor": {
            **_pos_rot((c.noise_floor.pos_m, c.noise_floor.rot_rad)),
            "source": c.noise_floor.source,
        },
        "rms": {name: _pos_rot(pair) for name, pair in c.rms.items()},
        "chi2_per_dof": c.chi2_per_dof,
        "p_lack_of_fit": c.p_lack_of_fit,
        "p_structure": c.p_structure,
        "adequate": c.adequate,
        "worst_poses": [
            {"id": w.id, "pos_mm": _mm(w.pos_m), "rot_mrad": _mm(w.rot_rad), "sigma": w.sigma}
            for w in c.worst_poses
        ],
        "where": _where(c.where),
        "outliers": list(c.outliers),
        "outlier_note": c.outlier_note,
        "notes": list(c.notes),
    }


def diagnosis_json(d: Diagnosis, next_poses: list[dict] | None = None) -> dict:
    return {
        **comparison_json(d.comparison),
        "verdict": d.verdict,
        "probability_none": d.probability_none,
        "adequate_after": d.adequate_after,
        "effects": [
            {
                "name": e.name,
                "probability": e.probability,
                "p_value": e.p_value,
                "delta_bic": e.delta_bic,
                "held_rms_before_mm": _mm(e.held_rms_before_m),
                "held_rms_after_mm": _mm(e.held_rms_after_m),
                "held_ratio_interval": [x if math.isfinite(x) else None for x in e.held_ratio_interval],
                "parameters": [
                    {"name": p.name, "value": p.value, "std_err": p.std_err, "unit": p.unit}
                    for p in e.parameters
                ],
                "confounded_with": list(e.confounded_with),
                "why": e.why,
                "accepted": e.accepted,
                "helps": e.helps,
            }
            for e in d.effects
        ],
        "novel": None
        if d.novel is None
        else {
            "where": d.novel.locus,
            "depends_on": list(d.novel.depends_on),
            "suggested_terms": list(d.novel.suggested_terms),
            "p_value": d.novel.p_value,
            "probability": d.novel.probability,
        },
        "not_testable": [{"name": n.name, "needs": list(n.needs)} for n in d.not_testable],
        "next_poses": next_poses or [],
        "remainder": {
            "held": _pos_rot((d.remainder.held_pos_m, d.remainder.held_rot_rad)),
            "noise_floor": _pos_rot((d.remainder.floor.pos_m, d.remainder.floor.rot_rad)),
            "where": _where(d.remainder.where),
        },
    }


def ladder_json(ladder: Ladder) -> dict:
    return {
        "rungs": [
            {
                "model": r.model,
                "held_out": r.block,
                **_pos_rot((r.pos_m, r.rot_rad)),
                "systematic_pos_mm": _mm(r.sys_pos_m),
                "max_pos_mm": _mm(r.max_pos_m),
                "ratio": r.ratio,
                "ratio_interval": None if r.ratio_interval is None else list(r.ratio_interval),
            }
            for r in ladder.rungs
        ],
        "noise_floor": {
            **_pos_rot((ladder.floor.pos_m, ladder.floor.rot_rad)),
            "source": ladder.floor.source,
        },
        "verdicts": list(ladder.verdicts),
    }


def fit_json(f: FitResult) -> dict:
    return {
        **comparison_json(f.comparison),
        "effects": list(f.effects),
        "rank": f.rank,
        "noise_scale": f.noise_scale,
        "parameters": [
            {"name": n, "value": float(v), "std_err": float(s), "unit": u}
            for n, v, s, u in zip(f.names, f.estimate, f.std_err, f.units, strict=True)
        ],
        "ladder": ladder_json(f.ladder),
    }


_DRIVERS = {
    "t": "time",
    "order": "order in which the poses were taken",
    "temp": "temperature",
    "payload": "payload",
    "tag": "tag that was seen",
    "zcam": "distance along the line of sight",
    "u": "image position, across",
    "v": "image position, down",
    "r2": "distance from the image centre, squared",
    "incid": "incidence angle",
    "pan": "pan of the head",
    "tilt": "tilt of the head",
    "sx": "tool position x",
    "sy": "tool position y",
    "sz": "tool position z",
}
_JOINT_DRIVERS = {"tau": "gravity torque", "dir": "approach direction", "qdot": "velocity"}


def in_words(variable: str) -> str:
    """tau2 -> gravity torque of joint 2; joint angles and unknown names stay."""
    kind = variable.rstrip("0123456789")
    if kind in _JOINT_DRIVERS and kind != variable:
        return f"{_JOINT_DRIVERS[kind]} of joint {variable[len(kind) :]}"
    return _DRIVERS.get(variable, variable)


def _text_pair(pair: tuple[float | None, float | None]) -> str:
    position, rotation = pair
    if position is None or not math.isfinite(position):
        return "unknown"
    tail = "" if rotation is None else f", {rotation * 1e3:.2f} mrad"
    return f"{position * 1e3:.3f} mm{tail}"


def comparison_text(c: Comparison) -> str:
    floor = _text_pair((c.noise_floor.pos_m, c.noise_floor.rot_rad))
    p_text = (
        "cannot be tested (no replicates, no stated noise)"
        if c.p_lack_of_fit is None
        else f"p = {c.p_lack_of_fit:.3g}"
    )
    lines = [
        f"{c.arm}: {c.poses} poses ({len(c.split.fit)} to fit, {len(c.split.held)} held out), "
        f"{c.components} components",
        *([f"skipped: {c.skipped} malformed rows"] if c.skipped else []),
        f"nominal arm        {_text_pair(c.rms['nominal'])}",
        f"fitted poses       {_text_pair(c.rms['fit'])}",
        f"held-out poses     {_text_pair(c.rms['held'])}",
        f"noise floor        {floor} ({c.noise_floor.source})",
        f"chi2 per degree    {c.chi2_per_dof:.3f}",
        f"lack of fit        {p_text}",
        f"verdict            the model {'explains' if c.adequate else 'does NOT explain'} these data",
        "",
        "where the rest lives (share of what is left, p-value):",
        *[
            f"  {in_words(w.variable):<38}at {w.at:<18}{w.share_of_variance:7.1%}   p = {w.p_value:.2g}"
            for w in c.where[:6]
        ],
        "",
        "worst poses: "
        + ", ".join(f"{w.id} ({w.pos_m * 1e3:.2f} mm, {w.sigma:.1f} sigma)" for w in c.worst_poses),
        "outliers: " + (", ".join(c.outliers) if c.outliers else "none"),
        *([c.outlier_note] if c.outlier_note else []),
        *c.notes,
    ]
    return "\n".join(lines)


VERDICTS = {
    "adequate": "Nothing is missing that these data could show.",
    "effect": "One effect is missing.",
    "several_effects": "Several effects are missing.",
    "novel": "Something is missing that no effect of the library describes.",
    "undecidable": "Something is missing, but these data do not tell what: "
    "see the candidates and the next poses.",
}


def poses_json(poses: list[NextPose]) -> list[dict]:
    return [
        {"q": list(p.q), "direction": None if p.direction is None else list(p.direction),
         "separates": list(p.separates), "power": p.power}
        for p in poses
    ]  # fmt: skip


def poses_text(poses: list[dict]) -> str:
    """Numbered poses; power counts the poses above too."""
    if not poses:
        return ""
    lines = [f"next poses, to separate {', '.join(poses[0]['separates'])}:"]
    for k, p in enumerate(poses, 1):
        sign = "" if p["direction"] is None else "  approach " + " ".join(f"{s:+d}" for s in p["direction"])
        lines.append(f"  {k:2d}  q = {', '.join(f'{x:+.3f}' for x in p['q'])}{sign}  power {p['power']:.2f}")
    return "\n".join(lines)


def _grouped(names: tuple[str, ...]) -> str:
    """gain[1], gain[2], flex -> gain[1], [2]; flex"""
    groups: dict[str, list[str]] = {}
    for name in names:
        effect, bracket, rest = name.partition("[")
        groups.setdefault(effect, []).append(bracket + rest)
    return "; ".join(effect + ", ".join(places) for effect, places in groups.items())


def _remainder_text(d: Diagnosis) -> str:
    r = d.remainder
    floor = "unknown" if r.floor.pos_m is None else _text_pair((r.floor.pos_m, r.floor.rot_rad))
    text = f"left on held-out poses: {_text_pair((r.held_pos_m, r.held_rot_rad))}; noise floor {floor}"
    live = [
        f"{w.at} by {in_words(w.variable)} ({w.share_of_variance:.0%})" for w in r.where if w.p_value < 0.001
    ]
    return text + (f"; it lives at {', '.join(live)}" if live else "")


def diagnosis_text(d: Diagnosis, poses: list[dict] | None = None) -> str:
    lines = [
        comparison_text(d.comparison),
        "",
        f"diagnosis: {VERDICTS[d.verdict]} (P(nothing missing) = {d.probability_none:.2g})",
    ]
    for e in d.effects:
        mark = "*" if e.accepted else "+" if e.helps else " "
        lines.append(f"{mark} {e.name:<26} P = {e.probability:.2f}   p = {e.p_value:.2g}   {e.why}")
        lines += [f"      {p.name} = {p.value:.4g} +- {p.std_err:.2g} {p.unit}" for p in e.parameters]
        if e.confounded_with:
            lines.append(f"      cannot be told from: {_grouped(e.confounded_with)}")
    if d.novel:
        lines += [
            f"not in the library: {d.novel.locus}, depending on "
            f"{' and '.join(in_words(name) for name in d.novel.depends_on)} "
            f"(P = {d.novel.probability:.2f}, p = {d.novel.p_value:.2g})",
            *[f"      try: {term}" for term in d.novel.suggested_terms],
        ]
    if d.effects or d.novel:
        lines.append(_remainder_text(d))
    if d.not_testable:
        lines.append("not testable on these data:")
        absorbed = "absorbed by the fitted parameters (DH, base, tool)"
        lines += [
            f"      {n.name}: {'needs ' + ', '.join(n.needs) if n.needs else absorbed}"
            for n in d.not_testable
        ]
    if poses:
        lines.append(poses_text(poses))
    if d.effects:
        lines.append("Probabilities hold for this library and its priors; 'consistent with' is not 'proven'.")
    return "\n".join(lines)
