"""The effect library and a model file as text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import isfinite
from typing import Any

from kincal.api.predicted import Predicted
from kincal.export import Exported
from kincal.workbench.diagnosis.additions import Addition
from kincal.workbench.diagnosis.unnamed_effects import Found
from kincal.workbench.model.effects import Effect, Library
from kincal.workbench.model.hypotheses import covers
from kincal.workbench.model.modelfile import ModelFile
from kincal.workbench.model.parameters import BETA
from kincal.workbench.model.unnamed_names import UnnamedName
from kincal.workbench.prediction.nested import EffectGain
from kincal.workbench.prediction.reachable import PosRot
from kincal.workbench.report import explain
from kincal_shared.schema.model import ExpectedEntry, FitEntry
from kincal_shared.schema.terms import TermEntry

_INSTANCES = {"joint": "[j]", "pair": "[i,j]"}
_SHOWN = ("name", "unit", "sigma", "if_negative", "image")  # of a parameter


def effects_json(library: Library) -> list[dict[str, Any]]:
    """Every effect as plain values, in the library's order."""
    return [_effect_json(effect) for effect in library.effects.values()]


def _effect_json(e: Effect) -> dict[str, Any]:
    return {
        "name": e.name + _INSTANCES.get(e.per, ""),
        "title": e.title,
        "formula": e.formula,
        "parameters": [{key: getattr(p, key) for key in _SHOWN} for p in e.parameters],
        "needs": list(e.needs),
        "looks_like": e.looks_like,
        "inspect": e.inspect,
        "confounded_with": list(e.confounded_with),
        "source": e.source,
    }


def effects(library: Library) -> str:
    """Every effect in a few lines."""
    return "\n".join(line for row in effects_json(library) for line in _effect_lines(row))


def _size(p: dict[str, Any]) -> str:
    """A parameter with its typical size; of a target of many points: with what it does to their image."""
    size = f"{p['name']} ~ {p['sigma']:g} {p['unit']}"
    return f"{size} through many points" if p["image"] else size


def _effect_lines(row: dict[str, Any]) -> list[str]:
    sizes = ", ".join(_size(p) for p in row["parameters"])
    lists = (("needs", row["needs"]), ("confounded with", row["confounded_with"]))
    return [
        f"{row['name']:<30} {row['title']}",
        f"    {row['formula']}    ({sizes})",
        f"    looks like: {row['looks_like']}",
        f"    inspect: {row['inspect']}",
        *(
            f"    {p['name']} is positive in nature; if negative, {p['if_negative']}"
            for p in row["parameters"]
            if p["if_negative"]
        ),
        *(f"    {what}: {', '.join(names)}" for what, names in lists if names),
    ]


def cost(gain: EffectGain) -> str:
    """What a model loses on held-out poses without some of its effects."""
    low, high = gain.interval
    return (
        f"held-out error without them {gain.before_m * 1e3:.3f} mm, with them {gain.after_m * 1e3:.3f} mm "
        f"(with / without {gain.ratio:.3f}, 95 % interval {low:.3f} to {high:.3f})"
    )


def _instead(name: UnnamedName) -> str:
    """Why no function is added beside one that is not to be added."""
    if name.without_terms:
        return f"{explain.cause_without_terms(str(name))}; {explain.NO_TERM}"
    return (
        "the remaining error varies with time, which no function of the pose can represent; to describe "
        f"these poses, add {str(name)!r} by its name"
    )


def additions(found: Found) -> Iterator[str]:
    """Unnamed effects, a few lines each: their terms and what held-out poses gain; those that other poses
    speak against; last, what all of them bring."""
    for a in found.additions:
        yield from _addition(a)
    added = [str(a.effect.name) for a in found.additions]
    for name in dict.fromkeys(g.effect for g in found.against):
        done = "added as requested" if name in added else "not added"
        yield f"NOT recommended: {name}: {explain.harms(found.against, name)}; {done}"
    every = found.all_of_them
    if every is None:
        return
    if every.instead is not None:
        yield f"unnamed: {_instead(every.instead)}"
    elif not every.steps:
        yield "unnamed: nothing to add: no smooth function predicts left-out poses better and harms no others"
    if not every.steps:
        return
    held = f"held-out error with all of them: {every.held_pos_m * 1e3:.3f} mm"
    yield f"unnamed: {len(every.steps)} added" + (f"; {held}" if isfinite(every.held_pos_m) else "")


def _addition(a: Addition) -> Iterator[str]:
    parameters = a.effect.entry().parameter
    gain = a.held or a.crossed
    low, high = gain.interval
    by = "held-out poses" if a.held else "cross-validation"
    verdict = "improved" if gain.gains else "worse" if low > 1.0 else "no improvement is shown"
    count = "1 coefficient" if len(parameters) == 1 else f"{len(parameters)} coefficients"
    yield f"{a.effect.name}: {count} ({a.effect.family})"
    yield from (_term_line(p.name, term) for p in parameters for term in p.term)
    yield (
        f"{by}: {gain.before_m * 1e3:.3f} -> {gain.after_m * 1e3:.3f} mm, ratio "
        f"{gain.after_m / gain.before_m:.3f} (95 % interval {low:.3f} to {high:.3f}): {verdict}"
    )


def _term_line(name: str, term: TermEntry) -> str:
    component = f", {term.comp}" if term.comp else ""
    return f"    {name} x {term.basis} at {term.at}{component}"


def names(model: ModelFile) -> str:
    """The effects of a model in one line."""
    return ", ".join(model.texts) or "no effects (DH only)"


def of_other_data(model: ModelFile, files: Mapping[str, str]) -> str:
    """That a model has effects and was fitted to other files than these, path and digest; empty where not."""
    if model.fit is None or not model.texts:
        return ""
    if any(entry.path in files or entry.sha256 in files.values() for entry in model.fit.data):
        return ""
    return (
        f"note: the model was fitted to {', '.join(entry.path for entry in model.fit.data)}, and keeps its "
        f"effects: {names(model)}; a new name after --model begins without effects"
    )


def contents_json(model: ModelFile) -> dict[str, Any]:
    """Effects in use and their fitted values."""
    values = {name: {"value": v, "std_err": s} for name, (v, s) in model.values.items()}
    return {"effects": list(model.effects), "fixed": model.fixed, "dh": model.dh, "values": values}


def _belongs(owner: str, model: ModelFile) -> bool:
    """Whether a coefficient's effect is in use: by itself, or at one joint of an effect at all or some."""
    return any(covers(name, owner) for name in model.effects)


def contents(model: ModelFile) -> str:
    """Effects in use, one a line, then their fitted values."""
    fitted = [
        f"    {name} = {value:.6g} +- {std_err:.2g}"
        for name, (value, std_err) in model.values.items()
        if _belongs(name.partition(".")[0], model)
    ]
    return "\n".join([*(model.texts or ("no effects (DH only)",)), *fitted])


_WITH_EFFECTS = "  --format python and --format c contain them"


def exported(made: Exported) -> str:
    """The files that were written."""
    return "\n".join(f"{path}: {path.stat().st_size} bytes" for path in made.files)


def of_session(names: Sequence[str], form: str) -> str:
    """What an export holds of effects that follow the time of the fitted session. A fit without them is no
    way out: DH values and frames would then follow that session."""
    them = "them" if len(names) > 1 else "it"
    holds = (
        "the file holds the arm as it is where that is zero: before a step, at the start of a drift, after "
        "settling"
        if form in ("dh", "urdf")
        else "give a t_s of that session; its end, `end_s` in the model file, for the arm as it was left"
    )
    return (
        f"note: valid for the fitted session only, since time starts again in others: {', '.join(names)}; "
        f"{holds}. A fit without {them} would put the error into the DH values"
    )


def left_out(made: Exported, form: str, fit: FitEntry | None, session: Sequence[str] = ()) -> str:
    """What the format does not hold, which ones do, and the error of what was written; fit: of the model;
    session: effects that follow time."""
    return "\n".join(
        [
            f"warning: --format {form} cannot represent these effects (mm: RMS over the fitted poses):",
            *(f"  {one}" for one in made.left_out),
            *_without_them(made, form, fit, session),
        ]
    )


def _without_them(made: Exported, form: str, fit: FitEntry | None, session: Sequence[str]) -> Iterator[str]:
    if form not in ("dh", "urdf"):
        return
    left = [one.effect for one in made.left_out]
    if left != [BETA]:
        yield _WITH_EFFECTS
        if others := [effect for effect in left if effect not in (BETA, *session)]:
            yield f"  for the best DH table or URDF alone, fit a model without {explain.listed(others)}"
        return
    held, exported = (None, None) if fit is None else (fit.held_table_mm, fit.exported_table_mm)
    if fit is not None and fit.held_mm is not None and held is not None:
        yield (
            f"  error on the held-out poses: {held:.3f} mm with such a table, {fit.held_mm:.3f} mm with all "
            "that was fitted (both fitted to the other poses)"
        )
        if exported is not None and exported != held:
            yield (
                f"  {exported:.3f} mm on these poses with the table that was written (`compare --arm`), "
                "which is fitted to all poses"
            )
    yield "  --format urdf, json, python and c contain it"


def predicted(p: Predicted) -> str:
    """Errors at poses that the model was not fitted to."""
    lines = [
        f"{p.arm}: {p.poses} poses of {p.source}, {p.components} components"
        + ("" if p.fitted else "; the model was fitted to other files"),
        *([f"skipped: {p.skipped} malformed rows"] if p.skipped else []),
        f"nominal arm        {_error(p.nominal)} in the base and tool frame of the fit, which suit its "
        "values; `compare` gives the nominal arm its own",
        f"fitted model       {_error(p.model)}, largest {_error(p.largest)}",
        *_without_outliers(p),
        f"when it was fitted {_expected(p.expected)}",
    ]
    lines += [f"new poses          {_as_well(p)}"] if p.ratio is not None else []
    if p.oriented:
        lines.append("note: orientations are not compared: the model was fitted to positions alone")
    if p.as_in_the_end:
        names = ", ".join(p.as_in_the_end)
        lines.append(f"note: {names}: as in the end of the fitted session; what has moved since is not known")
    lines += [f"note: the model was fitted to {file}: this is not a prediction" for file in p.fitted]
    return "\n".join(
        [*lines, "worst poses        " + "; ".join(f"{w.id} {_error((w.pos_m, w.rot_rad))}" for w in p.worst)]
    )


def _without_outliers(p: Predicted) -> list[str]:
    if p.far > len(p.outliers):
        much = "off by more than ten times the median error: too many to be bad poses, none is left out"
        return [f"outliers           {p.far} of {p.poses} poses are {much}"]
    if not p.outliers:
        return []
    which = "outlier" if len(p.outliers) == 1 else f"{len(p.outliers)} outliers"
    return [f"without outliers   {_error(p.usual)} ({which}: {', '.join(p.outliers)})"]


def _expected(e: ExpectedEntry | None) -> str:
    """What the fit said of poses that it was not fitted to."""
    if e is None:
        return "unknown: no poses were held out"
    usual = _metres(e.usual_mm, e.usual_mrad)
    without = f" ({explain.without_outliers(e.outliers, *usual)})" if e.outliers else ""
    return f"{_error(_metres(e.mm, e.mrad))} on {e.held_out}{without}"


def _expected_json(e: ExpectedEntry) -> dict[str, Any]:
    return {
        "held_out": e.held_out,
        "poses": e.poses,
        "outliers": e.outliers,
        **_milli(_metres(e.mm, e.mrad)),
        "without_outliers": _milli(_metres(e.usual_mm, e.usual_mrad)),
    }


def _metres(mm: float, mrad: float | None) -> PosRot:
    return mm * 1e-3, None if mrad is None else mrad * 1e-3


def _as_well(p: Predicted) -> str:
    """Whether these poses are predicted as well as those that were held out when the model was fitted."""
    assert p.ratio is not None and p.expected is not None  # as asked before
    ratio, (low, high) = p.ratio
    how = "worse than" if low > 1.0 else "better than" if high < 1.0 else "as well as"
    theirs = " without their outliers" if p.expected.outliers else ""
    without = ", outliers excluded" if p.outliers else theirs
    return (
        f"predicted {how} the held-out ones of the fit{without}: ratio of position errors {ratio:.2f} (95 % "
        f"interval {low:.2f} to {high:.2f})"
    )


def predicted_json(p: Predicted) -> dict[str, Any]:
    """`kincal model predict --json`."""
    return {
        "arm": p.arm,
        "data": p.source,
        "poses": p.poses,
        "components": p.components,
        "skipped": p.skipped,
        "errors": [
            {"model": "nominal", **_milli(p.nominal)},
            {"model": "model", **_milli(p.model)},
        ],
        "max": _milli(p.largest),
        "far": p.far,
        "outliers": list(p.outliers),
        "without_outliers": _milli(p.usual),
        "ratio": p.ratio and p.ratio[0],
        "ratio_interval": p.ratio and list(p.ratio[1]),
        "held": None if p.held is None else _milli(p.held),
        "expected": None if p.expected is None else _expected_json(p.expected),
        "worst_poses": [{"id": w.id, **_milli((w.pos_m, w.rot_rad))} for w in p.worst],
        "fit_data": list(p.fitted),
        "as_in_the_end": list(p.as_in_the_end),
    }


def _error(pair: tuple[float, float | None]) -> str:
    rotation = "" if pair[1] is None else f", {pair[1] * 1e3:.2f} mrad"
    return f"{pair[0] * 1e3:.3f} mm{rotation}"


def _milli(pair: tuple[float, float | None]) -> dict[str, float | None]:
    """Millimetres and milliradians."""
    rotation = None if pair[1] is None else round(pair[1] * 1e3, 6)
    return {"pos_mm": round(pair[0] * 1e3, 6), "rot_mrad": rotation}
