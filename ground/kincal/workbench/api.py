"""The workbench as functions with typed results.

from kincal import workbench as wb
arm, data = wb.read_arm("arm.toml"), wb.read_csv("poses.csv", 7)
result = wb.fit(arm, data, ["joint_compliance[2]"])
print(result.nested.of("held-out poses")[-1].pos_m)
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from kincal.errors import CannotAnswer
from kincal.schema.arm import ArmTable
from kincal.schema.names import UNNAMED, is_unnamed, split_constants

from .additions import Addition, Additions, add_one, add_unnamed, only
from .beside import Begin, when_asked
from .compare import Comparison, compare
from .constants import choose_constants
from .data import Measurements
from .diagnosis import Diagnosis
from .effects import Effect, Hypothesis, Library
from .fit import Fit, fit_model
from .grids import data_constants
from .hypotheses import by_constants, covers, merged_if_several
from .nested import EffectGain, NestedModels, fit_nested, harmful
from .nextposes import NextPose, next_poses
from .power import Confounding, Harm, confounding, harm
from .smooth import SmoothEffect, UnnamedName
from .types import Array, Progress, no_progress

_CERTAIN = 0.9  # probability from which on an effect needs no more poses
_MOST_COMPETING = 4


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
    _check_needs(library, names, arm, data)
    hypotheses = choose_constants(library, effects, arm, data, dh=dh)
    comparison = compare(arm, data, hypotheses, dh=dh, begin=begin)
    nested = fit_nested(arm, data, hypotheses, comparison.noise_floor, names, dh=dh, progress=progress)
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


@dataclass(frozen=True)
class Found:
    """Names of effects, the unnamed ones among them found in the data.

    names: what was asked for, in its order, "unnamed" replaced by what was found; additions: the terms of
    each unnamed effect and what it brings; all_of_them: of the last "unnamed", None if it was not asked for;
    against: what speaks against unnamed effects, as a fit finds it: those that "unnamed" found were left out,
    one that was asked for by its name stays.
    """

    names: tuple[str, ...]
    additions: tuple[Addition, ...] = ()
    all_of_them: Additions | None = None
    against: tuple[EffectGain, ...] = ()


def find_unnamed(
    arm: ArmTable,
    data: Measurements,
    names: Sequence[str],
    beside: Sequence[str] = (),
    *,
    library: Library | None = None,
    dh: bool = True,
    progress: Progress = no_progress,
) -> Found:
    """Effects with the terms of the unnamed ones chosen on the fit poses of the data.

    names: of any effects; "unnamed[joint 1: q1, q3]" is the smooth function there, "unnamed" as many of them
    as pay (`add_unnamed`), each beside the effects before it and `beside`, without those that a fit would
    advise against. Errors as `fit`; BadInput for a place or a driver that there is not; CannotAnswer where
    the data do not vary the driver, or ask for no term of that function.
    """
    known, found = library or Library.load(), Found(())
    for name in names:
        effects = (*beside, *found.names)
        if name != UNNAMED and not is_unnamed(name):
            found = replace(found, names=(*found.names, name))
            continue
        _check_needs(known, effects, arm, data)
        hypotheses = choose_constants(known, effects, arm, data, dh=dh)
        comparison = compare(arm, data, hypotheses, dh=dh)
        if name == UNNAMED:
            every = add_unnamed(comparison, hypotheses, dh=dh, progress=progress)
            every, against = _harmless(comparison, hypotheses, every, dh=dh, progress=progress)
            found = replace(found, all_of_them=every, against=(*found.against, *against))
            new = every.steps
        else:
            new = (add_one(comparison, UnnamedName.parse(name), hypotheses, dh=dh),)
            speaks = _against(comparison, hypotheses, [new[0].effect], dh=dh, progress=progress)
            found = replace(found, against=(*found.against, *speaks))
        called = tuple(str(addition.effect.name) for addition in new)
        found = replace(found, names=(*found.names, *called), additions=(*found.additions, *new))
        known = known.with_unnamed([addition.effect.entry() for addition in new])
    return found


def _harmless(
    comparison: Comparison,
    hypotheses: Sequence[Hypothesis],
    every: Additions,
    *,
    dh: bool,
    progress: Progress,
) -> tuple[Additions, list[EffectGain]]:
    """The unnamed effects without those that `fit` would advise against, and why those were left out. The
    worst goes first: without it others may do no harm."""
    effects, out = [step.effect for step in every.steps], list[EffectGain]()
    while against := _against(comparison, hypotheses, effects, dh=dh, progress=progress):
        worst = max(against, key=lambda g: g.interval[0]).effect
        out += [g for g in against if g.effect == worst]
        effects = [effect for effect in effects if str(effect.name) != worst]
    return (only(comparison, hypotheses, effects, dh=dh) if out else every), out


def _against(
    comparison: Comparison,
    hypotheses: Sequence[Hypothesis],
    effects: Sequence[SmoothEffect],
    *,
    dh: bool,
    progress: Progress,
) -> tuple[EffectGain, ...]:
    """What speaks against unnamed effects beside those of a model."""
    names = [str(effect.name) for effect in effects]
    whole = (*hypotheses, *(effect.hypothesis for effect in effects))
    arm, data = comparison.fit_all.arm, comparison.data
    return harmful(arm, data, whole, names, dh=dh, progress=progress) if names else ()


def _check_needs(library: Library, names: Iterable[str], arm: ArmTable, data: Measurements) -> None:
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


def advise(diagnosis: Diagnosis, library: Library, *, count: int = 4) -> tuple[NextPose, ...]:
    """Poses to measure next when two or more effects still compete; empty otherwise."""
    final = diagnosis.final
    names = _competing(diagnosis, library)[:_MOST_COMPETING]
    if len(names) < 2:
        return ()
    known = {h.name: dict(h.constants) for h in final.hypotheses if h.constants}
    effects = [
        choose_constants(library, [name], final.arm, final.data, joined=True, known=known)[0]
        for name in names
    ]
    plain = fit_model(final.arm, final.data, frames=(final.base, final.tool))
    return next_poses(plain, effects, count=count)


def _competing(diagnosis: Diagnosis, library: Library) -> list[str]:
    """Effects that the evidence is not sure of and those confounded with them, without those that no data can
    tell apart. What unseen poses do not bear out competes with no other effect by that."""
    uncertain = [e for e in diagnosis.effects if e.doubts.evidence < _CERTAIN or e.confounded_with]
    names = dict.fromkeys(name for e in uncertain for name in (e.name, *e.confounded_with))
    return [name for name in names if not _is_equivalent(library, name)]


def _is_equivalent(library: Library, name: str) -> bool:
    effect = library.effect(name)
    return effect is not None and bool(effect.equivalent_to)


@dataclass(frozen=True)
class ReportContent:
    """Everything a diagnosis report shows."""

    diagnosis: Diagnosis
    library: Library
    nested: NestedModels
    confounding: Confounding
    harm: tuple[Harm, ...]
    next_poses: tuple[NextPose, ...]


def report_content(
    diagnosis: Diagnosis,
    library: Library,
    given: Sequence[str] = (),
    poses: Sequence[NextPose] = (),
    *,
    dh: bool = True,
    progress: Progress = no_progress,
) -> ReportContent:
    """What a report shows beside the diagnosis: nested models, confounding and harm of every effect.

    given: the effects that the diagnosed model had from the start, as `choose_constants` takes them; dh:
    whether it has DH errors; poses: as `advise` gave them.
    """
    whole = diagnosis.comparison.fit_all
    arm = whole.arm
    effects = diagnosis.advised.model_after(given)
    data, floor = diagnosis.comparison.data, diagnosis.comparison.noise_floor
    hypotheses = choose_constants(library, effects, arm, data, dh=dh)
    names = [split_constants(text)[0] for text in effects]
    nested = fit_nested(arm, data, hypotheses, floor, names, dh=dh, progress=progress)
    shown = _shown(library, arm, whole.data)
    return ReportContent(
        diagnosis, library, nested, confounding(whole, shown), harm(whole, shown), tuple(poses)
    )


def _shown(library: Library, arm: ArmTable, data: Measurements) -> list[Hypothesis]:
    """Each testable effect at all its joints; pairs of joints only where the library lists them."""
    testable = [e for e in library.effects.values() if not e.missing(arm, data) and not e.equivalent_to]
    listed = [e for e in testable if e.per != "pair" or e.pairs]
    wholes = [_whole(e, e.instances(arm, data)) for e in listed if e.instances(arm, data)]
    return [h for h in wholes if any(p.terms for p in h.parameters)]


def _whole(effect: Effect, instances: list[Hypothesis]) -> Hypothesis:
    """An effect at all joints, its constants in the middle of their grid."""
    middle = instances[len(instances) // 2].constants
    group = next(group for group in by_constants(instances) if group[0].constants == middle)
    return merged_if_several(effect, group)
