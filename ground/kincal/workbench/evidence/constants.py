"""Effects of a model by name, their constants (time of a step, period of a ripple) chosen from the data."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kincal_shared.errors import BadInput
from kincal_shared.schema.arm import ArmTable
from kincal_shared.schema.names import split_constants

from ..data.measurements import Measurements
from ..data.split import may_be_fitted
from ..fit.least_squares import Frames, find_frames, fit_model
from ..model.effects import Hypothesis, Library
from ..model.grids import finer
from ..model.hypotheses import assumed_by, by_constants, covers, merged_if_several
from .scoring import Scorer, bulk_weights

Known = Mapping[str, Mapping[str, float]]
"""Constants of effects that are not searched: effect -> constant -> value."""

_UNKNOWN: Known = {}

Anew = Callable[[Measurements], Sequence[Hypothesis]]
"""The effects of a model, their open constants chosen by these poses alone."""


@dataclass(frozen=True)
class Choice:
    """The effects of a model as `choose_constants` takes them, for data that choose their open constants: all
    poses for the model to use, those that are fitted for errors of poses that are held out."""

    library: Library
    effects: tuple[str, ...]
    arm: ArmTable
    data: Measurements
    dh: bool = True

    @cached_property
    def hypotheses(self) -> list[Hypothesis]:
        """Chosen by all poses that may be fitted."""
        return choose_constants(self.library, self.effects, self.arm, self.data, dh=self.dh)

    def anew(self, part: Measurements) -> list[Hypothesis]:
        """Chosen by a part of the poses. What follows from the readings alone, as the mean temperature does,
        stays as it is: it tells nothing of errors."""
        every = may_be_fitted(self.data)
        stated = dict(map(split_constants, self.effects))
        searched = any(self.library.is_open(name, self.arm, every, known) for name, known in stated.items())
        if part.n == every.n or not searched:
            return self.hypotheses
        of_part = choose_constants(self.library, self.effects, self.arm, part, dh=self.dh)
        chosen = {name: dict(h.constants) for name in stated for h in of_part if covers(name, h.name)}
        return choose_constants(self.library, self.effects, self.arm, self.data, dh=self.dh, known=chosen)


def choose_constants(
    library: Library,
    effects: Sequence[str],
    arm: ArmTable,
    data: Measurements | None,
    *,
    dh: bool = True,
    joined: bool = False,
    known: Known = _UNKNOWN,
) -> list[Hypothesis]:
    """Hypotheses for effects by name, each grid constant (step time ...) at the value with the least cost,
    unless it stands behind the name (bias_step[3](t0=120)) or is known from an earlier fit.

    joined: a name without a joint becomes one hypothesis of all joints instead of one per joint. Poses that
    the file keeps back choose nothing. BadInput for an unknown name or constant, or where constants have to
    come from measurements and there are none.
    """
    data = None if data is None else may_be_fitted(data)
    stated = dict(map(split_constants, effects))
    names = [split_constants(text)[0] for text in effects]
    for name, constants in stated.items():
        library.check_constants(name, constants)
    known = {**known, **{name: {**known.get(name, {}), **own} for name, own in stated.items() if own}}
    open_names = [name for name in names if library.is_open(name, arm, data, known.get(name, {}))]
    found = {
        name: library.find(name, arm, data, dict(known.get(name, {})))
        for name in names
        if name not in open_names
    }
    for name in found:
        if not found[name] and stated[name]:
            raise BadInput(f"{name}: nothing has the constants {dict(stated[name])}", todo="leave them out")
    if open_names:
        found |= _searched(library, open_names, found, arm, data, dh)
    groups = [found[name] for name in names]
    if joined:
        return [_joined(library, name, group) for name, group in zip(names, groups, strict=True)]
    return _each_once([h for group in groups for h in group])


def _joined(library: Library, name: str, group: list[Hypothesis]) -> Hypothesis:
    effect = library.effect(group[0].effect)
    assert effect is not None  # it was found by this library
    return merged_if_several(effect, group, name)


def _each_once(hypotheses: list[Hypothesis]) -> list[Hypothesis]:
    """The same; BadInput where two names hold one effect at one joint: backlash[1,5] and backlash[5,6]."""
    names = [h.name for h in hypotheses]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise BadInput(f"the model holds {twice[0]} twice, by two names", todo="remove one of them")
    return hypotheses


def _searched(
    library: Library,
    names: Sequence[str],
    found: Mapping[str, list[Hypothesis]],
    arm: ArmTable,
    data: Measurements | None,
    dh: bool,
) -> dict[str, list[Hypothesis]]:
    """Effects with open constants, each searched beside those before it."""
    if data is None:
        raise BadInput(
            f"{names[0]} has constants that come from measurements; run `kincal model fit` or give --data"
        )
    search = _Search(library, arm, data, dh, find_frames(arm, data))
    out: dict[str, list[Hypothesis]] = {}
    for name in names:
        beside = [h for group in (*found.values(), *out.values()) for h in group]
        out[name] = search.best(name, beside)
    return out


@dataclass(frozen=True)
class _Search:
    """Scores groups of instances beside a model: linear in the effect, so cheap."""

    library: Library
    arm: ArmTable
    data: Measurements
    dh: bool
    frames: Frames

    def best(self, name: str, beside: list[Hypothesis]) -> list[Hypothesis]:
        """The instances of an effect with the constants of least cost, first on the grid, then closer."""
        fit = fit_model(self.arm, self.data, beside, dh=self.dh, frames=self.frames)
        scorer = Scorer(fit, bulk_weights(fit), self.data.cov is not None)
        assumed = dict(assumed_by(beside))
        best = _least_cost(scorer, by_constants(self.library.find(name, self.arm, self.data, assumed)))
        for constant, values in self.library.grid_of(name).items():
            fixed = dict(best[0].constants)
            near = finer(values, fixed[constant], self.data)
            if near:
                tried = [self.library.find(name, self.arm, self.data, {**fixed, constant: v}) for v in near]
                best = _least_cost(scorer, tried)
        return best


def _least_cost(scorer: Scorer, groups: Sequence[list[Hypothesis]]) -> list[Hypothesis]:
    blocks = [np.hstack([scorer.columns.hypothesis(h) for h in group]) for group in groups]
    return groups[int(np.argmax([score.chi2 for score, _ in scorer.scores(blocks)]))]
