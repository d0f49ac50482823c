"""One data set under study: what stays the same while effects are tried; fits and posteriors of any model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from kincal.schema.arm import ArmTable

from ..compare import Comparison, compare
from ..data import Measurements
from ..effects import Hypothesis, Library
from ..fit import Fit, fit_model
from ..grids import finer
from ..hypotheses import Competition, merged_if_several
from ..model import room_for
from ..scoring import Scorer, robust_weights
from ..types import Array
from .posterior import Posterior
from .subsets import fewest_joints, joints_with

_BOOTSTRAP = 1000
_INTERVAL = (0.025, 0.975)

Model = tuple[Hypothesis, ...]
"""The effects of a model beside DH, frames and what was given."""

T = TypeVar("T")


@dataclass(frozen=True)
class HeldGain:
    """Held-out position RMS [m] without and with an effect, and a 95 % bootstrap interval over held-out
    poses of their ratio (with / without). NaN where no poses are held out."""

    before_m: float
    after_m: float
    interval: tuple[float, float]

    @property
    def gains(self) -> bool:
        """Held-out poses are predicted better: the interval excludes 1."""
        return self.interval[1] < 1.0


NO_HELD_OUT = HeldGain(float("nan"), float("nan"), (float("nan"), float("nan")))


@dataclass(frozen=True)
class Study:
    """Data, candidates and weights of one diagnosis. Nothing of it changes; its functions depend on
    their arguments only and remember what they have computed.

    weight: (N,) robust weights under DH plus all effects; stated: the data state their noise;
    given: effects that are in the model from the start; dh: DH errors are.
    """

    comparison: Comparison
    library: Library
    given: Model
    dh: bool
    competition: Competition
    weight: Array
    _memory: dict[object, object] = field(default_factory=dict, repr=False)

    @classmethod
    def of(
        cls, arm: ArmTable, data: Measurements, library: Library, given: Sequence[Hypothesis], dh: bool
    ) -> Study:
        """Compare the given model with the data and prepare the candidates. Errors as `compare`."""
        comparison = compare(arm, data, given, dh=dh)
        base = comparison.fit_all
        competition = Competition.of(arm, base.data, library, {h.name for h in given})
        weight = robust_weights(base, competition.candidates)
        return cls(comparison, library, tuple(given), dh, competition, weight)

    @property
    def base(self) -> Fit:
        """The given model fitted to the data."""
        return self.comparison.fit_all

    @property
    def stated(self) -> bool:
        """The data state their noise."""
        return self.base.data.cov is not None

    @property
    def has_held_out(self) -> bool:
        """Poses are held out, so that gains can be tested."""
        return len(self.comparison.split.held) > 0

    def _remembered(self, key: object, make: Callable[[], T]) -> T:
        if key not in self._memory:
            self._memory[key] = make()
        return self._memory[key]  # type: ignore[return-value]

    def fit(self, model: Model) -> Fit:
        """These effects beside the given ones, fitted to the data."""
        return self._remembered(("fit", model), lambda: self._fit(model)) if model else self.base

    def _fit(self, model: Model) -> Fit:
        base = self.base
        start = dict(zip(base.names, base.estimate, strict=True))
        frames = (base.base, base.tool)
        return fit_model(base.arm, base.data, [*self.given, *model], dh=self.dh, frames=frames, start=start)

    def room(self, model: Model) -> int:
        """Coefficients that may still be added to this model."""
        return room_for(self.fit(model).parameters)

    def scorer(self, model: Model, drop: Hypothesis | None = None, granted: Array | None = None) -> Scorer:
        """Scores at the fit of this model; drop, granted: as of `Scorer`."""
        return Scorer(self.fit(model), self.weight, self.stated, drop=drop, granted=granted)

    def posterior(self, model: Model) -> Posterior:
        """What this model leaves to explain, and by what."""
        return self._remembered(
            ("beside", model),
            lambda: Posterior.at(self.scorer(model), self.competition.open({h.name for h in model})),
        )

    def reopened(self, model: Model, h: Hypothesis, grid: Model = ()) -> Posterior:
        """What competes for the place of effect `h` of this model, linearised at the fit that has it; grid:
        its closer search for constants, which replaces that part of the library's grid."""
        return self._remembered(("for", model, h, grid), lambda: self._reopened(model, h, grid))

    def _reopened(self, model: Model, h: Hypothesis, grid: Model) -> Posterior:
        open_ = self.competition.open({x.name for x in model if x is not h})
        open_ = self.competition.with_some_joints(open_, h)
        candidates = [c.refined(grid) if grid and c.name == h.name else c for c in open_]
        return Posterior.at(self.scorer(model, drop=h), candidates)

    def fewest_joints(self, model: Model, h: Hypothesis) -> Hypothesis | None:
        """An effect of this model at fewer joints that explain as much; None if all of them are needed."""
        return fewest_joints(self.scorer(model, drop=h), h) if len(joints_with(h)) > 2 else None

    def constants_of(self, h: Hypothesis) -> tuple[str, ...]:
        """Constants of an effect that are searched on a grid."""
        return tuple(self.library.grid_of(h.name))

    def closer(self, h: Hypothesis, constant: str) -> Model:
        """The effect with values of a constant about the present one, closer than the library's grid has
        them; empty where that grid is a plain list."""
        effect, known = self.library.effects[h.effect], dict(h.constants)
        arm, data, name = self.base.arm, self.base.data, h.name
        return tuple(
            merged_if_several(effect, self.library.find(name, arm, data, {**known, constant: value}), name)
            for value in finer(self.library.grid_of(h.name)[constant], known[constant], data)
        )

    def held_fit(self, model: Model) -> Fit:
        """These effects beside the given ones, fitted without the held-out poses."""
        part = self.comparison.fit_part
        return self._remembered(
            ("held", model),
            lambda: fit_model(
                part.arm, part.data, [*self.given, *model], dh=self.dh, frames=(part.base, part.tool)
            ),
        )

    def held_square(self, model: Model) -> Array:
        """(M,) squared position error [m^2] of the held-out poses, the model fitted to the others only."""
        held = self.comparison.held_data
        assert held is not None
        return self._remembered(
            ("square", model), lambda: (self.held_fit(model).predict(held)[:, :3] ** 2).sum(axis=1)
        )

    def held_gain(self, model: Model, h: Hypothesis) -> HeldGain:
        """What held-out poses gain from an effect, the other effects of the model with and without it."""
        if not self.has_held_out:
            return NO_HELD_OUT
        others = tuple(x for x in model if x.name != h.name)
        before, after = self.held_square(others), self.held_square((*others, h))
        pick = np.random.default_rng(2).integers(0, len(before), (_BOOTSTRAP, len(before)))
        ratio = np.sqrt(after[pick].mean(axis=1) / np.maximum(before[pick].mean(axis=1), 1e-300))
        low, high = (float(np.quantile(ratio, q)) for q in _INTERVAL)
        return HeldGain(float(np.sqrt(before.mean())), float(np.sqrt(after.mean())), (low, high))
