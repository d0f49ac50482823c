"""What to do after a diagnosis, as commands to copy."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import count

from kincal_shared.schema.names import UNNAMED, split_constants

from ..diagnosis import Diagnosis
from ..diagnosis.findings import UnnamedFinding
from ..model.unnamed_names import UnnamedName
from ..prediction.nested import DH, FITTED, NOMINAL, NestedModel
from ..prediction.nextposes import NextPose, would_decide
from . import explain

_NEW_MODEL = "M.toml"
_NAMED = 100  # outliers in a command
_MUCH = 1.2  # times the error without outliers


@dataclass(frozen=True)
class Inputs:
    """What a command was given, as words of a command line: the arm, the options that say the data, the model
    file (empty if none), and files with effects; new_model: where to write a model if none was given."""

    arm: str
    data: tuple[str, ...]
    model: str = ""
    effects: tuple[str, ...] = ()
    new_model: str = _NEW_MODEL

    @property
    def sources(self) -> tuple[str, ...]:
        """Arm and data."""
        return ("--arm", self.arm, *self.data)

    @property
    def library(self) -> tuple[str, ...]:
        """Options for the user's own effects."""
        return tuple(word for path in self.effects for word in ("--effects", path))

    @property
    def written(self) -> tuple[str, ...]:
        """Option for the model file that the commands make or change."""
        return ("--model", self.model or self.new_model)

    @property
    def diagnosed(self) -> tuple[str, ...]:
        """Options for the model that was diagnosed."""
        return (*(("--model", self.model) if self.model else ()), *self.library)


@dataclass(frozen=True)
class Step:
    """Something to do: why, and the command for it."""

    why: str
    command: str


def next_steps(d: Diagnosis, poses: Sequence[NextPose], inputs: Inputs) -> tuple[Step, ...]:
    """The commands that follow from a diagnosis: DH calibration first, then what else was found."""
    outliers = tuple(_excluding(d, inputs))
    first = outliers if _outliers_count(d) else ()
    if worse := _worse_calibrated(d, inputs):
        return (*first, worse)
    return (
        *first,
        *_calibrating(d, inputs),
        *_adding(d, inputs),
        *_measuring(poses, inputs),
        *(outliers if not first else ()),
    )


def free_name(taken: Callable[[str], bool], name: str = _NEW_MODEL) -> str:
    """M.toml, or M2.toml, M3.toml ... where that is taken: what is there may be of another arm."""
    stem, dot, suffix = name.partition(".")
    numbered = (f"{stem}{number}{dot}{suffix}" for number in count(2))
    return name if not taken(name) else next(other for other in numbered if not taken(other))


def _kincal(*words: str) -> str:
    return "kincal model " + " ".join(map(shlex.quote, words))


def _worse_calibrated(d: Diagnosis, inputs: Inputs) -> Step | None:
    """Held-out poses are predicted worse after DH calibration than by the nominal arm, and no better with the
    effects that were found: no fit of these poses is to be used."""
    errors = _usual_held(d)
    if inputs.model or not _worse_by_dh(d) or [*errors.values()][-1] < errors[NOMINAL]:
        return None
    return Step(
        "measure more poses, and do not calibrate with these alone: after DH calibration, held-out poses are "
        f"predicted worse than by the nominal arm ({_by_dh(d)})",
        _kincal("check", *inputs.sources),
    )


def _usual_held(d: Diagnosis) -> dict[str, float]:
    """Error of the held-out poses without outliers [m] by model."""
    return {e.model: e.usual[0] for e in d.advised.headline if e.block != FITTED}


def _worse_by_dh(d: Diagnosis) -> bool:
    errors = _usual_held(d)
    return DH in errors and errors[DH] >= errors[NOMINAL]


def _by_dh(d: Diagnosis) -> str:
    errors = _usual_held(d)
    return explain.fall(errors[NOMINAL], errors[DH])


def _calibrating(d: Diagnosis, inputs: Inputs) -> Iterator[Step]:
    """DH calibration alone, of an arm that has none yet."""
    if inputs.model:
        return
    if _worse_by_dh(d):
        why = f"not to be used without the effects below: {explain.held_error(d)} {_by_dh(d)}"
        yield Step(
            f"calibrate the DH parameters and frames of the arm; {why}",
            _kincal("fit", *inputs.sources, *inputs.written),
        )
        return
    errors = {e.model: e for e in d.advised.headline}
    gain = ""
    if _measured(d) and DH in errors:
        gain = f" ({_gain(d, (errors[NOMINAL].pos_m, errors[NOMINAL].usual[0]), errors[DH])})"
    yield Step(
        f"calibrate the DH parameters and frames of the arm{gain}",
        _kincal("fit", *inputs.sources, *inputs.written),
    )
    table = d.comparison.table_errors
    less = ""
    if table:  # beside the error of the same poses: the gain above may be of others
        both = (f"{e * 1e3:.3f} mm" for e in (table.held[0], d.comparison.rms["held"][0]))
        less = f"; a DH table cannot hold all of it: held-out error {', with all of it '.join(both)}"
    yield _export(inputs, f"export the calibrated arm as a DH table (also urdf, json, python, c{less})", "dh")


def _adding(d: Diagnosis, inputs: Inputs) -> Iterator[Step]:
    change = d.advised
    cause = explain.cause_without_terms(d.novel.name) if d.novel is not None and d.novel.found else ""
    if cause:
        yield Step(
            f"{cause}; {explain.NO_TERM}",
            _kincal("compare", *inputs.sources, *inputs.diagnosed),
        )
    smooth = [] if d.novel is None or d.exhausted else [*_smooth(d.novel, inputs)]
    if change.removed:
        yield Step(
            "remove effects that were now found at more joints",
            _kincal("remove", *inputs.written, *(split_constants(text)[0] for text in change.removed)),
        )
    if change.added:
        gain = f" ({_gain(d, explain.given_errors(d), change.headline[-1])})" if _measured(d) else ""
        yield Step(
            f"add the effects that were found{gain}{_only_predicting(d)}",
            _kincal("add", *inputs.written, *inputs.library, *change.added),
        )
    yield from smooth
    if change.added or smooth or inputs.model:
        yield Step(
            "fit the model and see how much each effect helps",
            _kincal("fit", *inputs.sources, *inputs.written, *inputs.library),
        )
        yield _export(inputs, "export the arm with all effects as source code (also c)", "python")


def _smooth(u: UnnamedFinding, inputs: Inputs) -> Iterator[Step]:
    """What follows time is added by its name: `unnamed` alone adds what predicts poses to come."""
    words = (*inputs.written, *inputs.library, *inputs.sources)
    if UnnamedName.parse(u.name).without_terms:
        return
    if UnnamedName.parse(u.name).of_time and u.curves and u.held.gains:
        yield Step(
            "add a smooth function of time: it describes these poses, but cannot predict later ones; look "
            "for what moves or warms up",
            _kincal("add", *words, u.name),
        )
    yield Step(
        "add smooth functions for what no named effect explains, as many as improve cross-validation without "
        "making held-out poses worse",
        _kincal("add", *words, UNNAMED),
    )


def _only_predicting(d: Diagnosis) -> str:
    """What is said of effects that are in the final model for what they predict, however unlikely."""
    names = [e.name for e in d.effects if e.role == "helps"]
    if not names:
        return ""
    verb = "improves" if len(names) == 1 else "improve"
    more = "others explain more"
    if d.novel is not None:
        more = "something unnamed explains more"
        if not d.novel.found:  # these poses say so, and unseen ones do not confirm it
            more += f" of these poses ({explain.probability(d.novel.probability)} that it helps on others)"
    return f"; {explain.listed(names)} {verb} cross-validation, but {more}: no cause is shown"


def _measured(d: Diagnosis) -> bool:
    return any(e.block != FITTED for e in d.advised.headline)


def _gain(d: Diagnosis, before_m: tuple[float, float], after: NestedModel) -> str:
    """From an error, with and without outliers, to that of a model; without outliers too, where there are
    some."""
    text = f"{explain.held_error(d)} {explain.fall(before_m[0], after.pos_m)}"
    if after.usual[0] == after.pos_m:
        return text
    return f"{text}; outliers excluded, {explain.fall(before_m[1], after.usual[0])}"


def _export(inputs: Inputs, why: str, form: str) -> Step:
    out = {"dh": "calibrated.toml", "python": "calibrated.py"}[form]
    return Step(why, _kincal("export", *inputs.written, *inputs.library, "--format", form, "-o", out))


def _measuring(poses: Sequence[NextPose], inputs: Inputs) -> Iterator[Step]:
    if poses and not would_decide(poses):
        why = f"to tell {explain.listed(poses[0].separates)} apart, {explain.would_not_decide(poses)}"
        yield Step(why, _kincal("effects", *inputs.library))
    elif poses:
        names = poses[0].separates
        why = f"measure poses that separate {explain.listed(names)}"
        words = (*inputs.sources, *inputs.diagnosed, "--count", str(len(poses)), *names)
        yield Step(why, _kincal("next", *words))


def _excluding(d: Diagnosis, inputs: Inputs) -> Iterator[Step]:
    ids = d.outliers.ids
    if len(ids) > _NAMED:
        words = (*inputs.sources, *inputs.diagnosed)
        yield Step(f"check the {len(ids)} outliers: so many are not chance", _kincal("compare", *words))
    elif ids:
        words = (*inputs.sources, *inputs.diagnosed, "--exclude", ",".join(ids))
        if d.outliers.clusters:
            why = f"{explain.outlier_note(d.outliers)}; measure more there: excluding them would hide it"
            yield Step(why, _kincal("compare", *inputs.sources, *inputs.diagnosed))
        else:
            them = "it" if len(ids) == 1 else "them"
            why = f"check {explain.outliers_left(d)}{explain.in_a_row(d.outliers)}; to repeat without {them}:"
            yield Step(why, _kincal("diagnose", *words))


def _outliers_count(d: Diagnosis) -> bool:
    """Outliers make up much of the error with the findings, or are many."""
    last = d.advised.headline[-1] if d.advised.headline else None
    return not d.outliers.few or (last is not None and last.pos_m > _MUCH * last.usual[0])
