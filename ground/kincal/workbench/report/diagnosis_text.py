"""A diagnosis as text: verdict, big numbers, what to do, what was found, then the comparison."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from ..diagnosis import Diagnosis, EffectFinding, UnnamedFinding
from ..diagnosis.findings import LIKELY
from ..model.hypotheses import Untestable
from ..model.unnamed_names import UnnamedName
from ..prediction.nextposes import NextPose
from . import explain
from .advice import Step
from .answers import comparison_text, poses_text
from .headline import BigNumber, big_numbers


def _mark(e: EffectFinding) -> str:
    """* for the effects of the final model that the verdict names as shown, + for its others."""
    if not e.in_model:
        return " "
    return "*" if explain.is_shown(e) else "+"


def diagnosis_text(d: Diagnosis, poses: Sequence[NextPose] = (), steps: Sequence[Step] = ()) -> str:
    """The whole answer, most important first."""
    return "\n".join([*_head(d), *_next(steps, poses), *_found(d), *_details(d)])


def _head(d: Diagnosis) -> list[str]:
    return [f"diagnosis: {explain.verdict(d)}", "", *numbers_text(big_numbers(d.comparison, d, each=True))]


def numbers_text(numbers: Sequence[BigNumber]) -> list[str]:
    """One number a line, with what it is."""
    width = max(len(n.label) for n in numbers)
    return [f"  {n.label:<{width}}  {n.text}   ({n.about})" for n in numbers]


def _next(steps: Sequence[Step], poses: Sequence[NextPose]) -> list[str]:
    lines = [line for step in steps for line in (f"  # {step.why}", f"  {step.command}")]
    listed = ["", poses_text(poses)] if poses and not explain.cannot_decide(poses) else []
    return [*(["", "what to do next:", *lines] if lines else []), *listed]


def _found(d: Diagnosis) -> Iterator[str]:
    nothing = explain.probability(d.probability_none)
    yield from ("", f'what may be missing ("nothing missing": {nothing} against all of these):')
    if d.novel is not None:
        yield from _unnamed_lines(d.novel)
    inspected = {""}
    for e in d.effects:
        yield from _effect_lines(e, d)
        if e.inspect not in inspected and (explain.is_shown(e) or explain.is_confounded(e)):
            inspected.add(e.inspect)
            yield f"      inspect: {e.inspect}"
    if d.effects:
        yield from (
            "  * added and shown to help: poses that were not fitted are predicted better, and P, where it",
            "  decides, is at least 0.5; + added, undecided: the interval of the ratio reaches 1, or P is",
            "  below 0.5; the others are alternatives. Ratio: error of the final model with the effect /",
            "  without it. P = evidence x support x identity: the effect explains these poses, helps on",
            "  poses that were not fitted, and is what its name says. P depends on this library and its",
            "  priors. Where something unnamed explains more, effects are added for what they predict,",
            "  however small P is. 'Consistent with' does not mean 'proven'.",
        )


def _effect_lines(e: EffectFinding, d: Diagnosis) -> list[str]:
    odds = explain.odds(e, d)
    if e.taken_back or (e.accepted and e.probability < LIKELY):
        odds += explain.doubts(e)
    return [
        f"{_mark(e)} {e.label}: {explain.held_gain(e.held)}" + (f"; {odds}" if odds else ""),
        *([f"      {explain.not_confirmed(e)}"] if e.taken_back else []),
        *[f"      {p.name} = {p.value:.4g} +- {p.std_err:.2g} {p.unit}" for p in e.parameters],
        *[f"      {wrong}" for wrong in [explain.negative(e.parameters)] if wrong],
        *([f"      confounded with: {explain.grouped(e.confounded_with)}"] if e.confounded_with else []),
    ]


def _unnamed_lines(u: UnnamedFinding) -> list[str]:
    return [
        f"not in the library: {explain.unnamed(u)} "
        f'({explain.probability(u.probability)} against "nothing missing" and every named effect)',
        *([f'      a smooth function there, "{u.name}": {explain.smooth_gain(u)}'] if _modelled(u) else []),
        *[f"      {cause}" for cause in [explain.cause_without_terms(u.name)] if cause],
        *([] if u.found else [f"      {explain.MAY_BE_NOISE}"]),
        *[f"      try: {explain.suggestion(s)}" for s in u.suggested_terms],
    ]


def _modelled(u: UnnamedFinding) -> bool:
    """Something is known of its function: its curves, or, of one that no term can hold, what it predicts."""
    return bool(u.curves) or (UnnamedName.parse(u.name).without_terms and math.isfinite(u.held.after_m))


def _details(d: Diagnosis) -> Iterator[str]:
    yield from ("", comparison_text(d.comparison, adequate=d.adequate))
    if d.effects or d.novel:
        yield from _remainder_lines(d)
    if d.not_testable:
        yield from ("", "not testable on these data:", *not_testable_lines(d.not_testable))


def _remainder_lines(d: Diagnosis) -> Iterator[str]:
    found = [
        f"{w.at} vs {explain.in_words(w.variable)} ({explain.percent(w.share_of_variance)})"
        for w in d.remainder.where
        if w.p_value < 0.001
    ]
    if not found and d.remainder.alike is not None and d.remainder.alike.shown:
        found = [explain.alike(d.remainder.alike)]
    if found:
        yield f"residual of the final model: {', '.join(found)}"


def not_testable_lines(effects: Sequence[Untestable]) -> list[str]:
    """Effects by what they lack: one line for each lacking thing."""
    groups: dict[str, list[str]] = {}
    for n in effects:
        lacking = f"need {', '.join(n.needs)}" if n.needs else "absorbed by the fitted parameters"
        groups.setdefault(lacking, []).append(n.name)
    return [f"  {lacking}: {', '.join(names)}" for lacking, names in groups.items()]
