"""What a selection passes on: models on the way, what won, what was kept and what was taken back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from ..model.effects import Hypothesis
from .posterior import Posterior
from .study import Model

Grids = Mapping[str, Model]
"""By effect name: the closer search for its constants that was made last."""

Ties = Mapping[str, tuple[str, ...]]
"""By effect name: effects that predicted as well when it was taken because it predicts."""

Role = Literal["accepted", "helps"]


@dataclass(frozen=True)
class State:
    """A model on the way: effects beside the given ones, in the order they were taken; grids, ties: what
    was found about them on the way."""

    model: Model = ()
    grids: Grids = field(default_factory=dict)
    ties: Ties = field(default_factory=dict)


@dataclass(frozen=True)
class Settled:
    """What won at the fit that contains an effect (None: no effect did), and the grids searched so far;
    done: it is that very effect, or none, so that nothing changes any more."""

    effect: Hypothesis | None
    grids: Grids
    done: bool = False


@dataclass(frozen=True)
class Kept:
    """An effect of the final model, why it stays, what competed for its place, and what predicts as well;
    identity: probability that it is what its name says, beside what `posterior` knows."""

    effect: Hypothesis
    role: Role
    posterior: Posterior
    ties: tuple[str, ...] = ()
    identity: float = 1.0


@dataclass(frozen=True)
class Selection:
    """The outcome: kept effects, their model, and the posteriors before the first and after the last one;
    taken_back: effects that were taken and that held-out poses are predicted worse with."""

    kept: tuple[Kept, ...]
    model: Model
    first: Posterior
    last: Posterior
    taken_back: tuple[Kept, ...] = ()
