"""How far poses that a fit has not seen support an effect: the probability that it helps there.

The evidence of METHOD.md 13 holds if the noise is independent and as large as is assumed. Where nothing says
how large it is, or more than noise is left, an effect may win by what it fits of other errors: its
probability counts only as far as predictions bear it out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from scipy.special import stdtr

from ..evidence.adequacy import gross
from ..numerics.types import Array, Groups, array
from ..prediction.gain import group_means, held_ratio, much_worse

_HARM, _HARM_ROTATION = 1.02, 1.1  # growth of an error that is harm
_CONTRADICTED = 0.025  # what an interval of 95 % that lies beyond leaves
_LEAST = 3  # poses that give a standard error
_CHOSEN = 1.0  # standard errors of a gain that the best of many has by being chosen
UNTESTED = 0.5
"""Probability that an effect helps where no poses can be held out."""

_POSITION, _ROTATION = slice(0, 3), slice(3, 6)


@dataclass(frozen=True)
class Support:
    """What poses that were not fitted say of an effect beside the others of a model.

    ratio: RMS error with over without it (with orientations: of positions and rotations in equal shares);
    probability: that it helps on other poses and does no harm; worse: blocks in which the error grows by more
    than a tenth, beyond chance.
    """

    ratio: float
    probability: float
    worse: tuple[str, ...] = ()

    def beside(self, worse: tuple[str, ...]) -> Support:
        """The same with the blocks of poses that the effect makes worse."""
        return replace(self, probability=min(self.probability, _CONTRADICTED), worse=worse) if worse else self


def worse_blocks(before: Mapping[str, Array], after: Mapping[str, Array]) -> tuple[str, ...]:
    """Names of the blocks whose error an effect makes grow by more than a tenth, beyond chance; of residuals
    (M, c) by name, without and with it."""
    return tuple(name for name, r in before.items() if _much_worse(r, after[name]))


def of_turns(before: Array, after: Array, folds: int, groups: Groups | None = None) -> Support:
    """From residuals (M, c) [m, rad] of poses that took turns, without and with an effect; gross outliers,
    without and with it, tell nothing and are left out. groups: (M,) equal for replicates: they
    count once."""
    usual = ~(gross(_square(before, _POSITION)) & gross(_square(after, _POSITION)))
    before, after = before[usual], after[usual]
    groups = None if groups is None else groups[usual]
    parts = [(part, max(float(_square(before, part).mean()), 1e-300)) for part in _parts(before)]

    def loss(r: Array) -> Array:
        return array(sum(_square(r, part) / mean for part, mean in parts))

    def harmless(part: slice, growth: float) -> float:
        gain = growth**2 * _square(before, part) - _square(after, part)
        return _positive(group_means(gain, groups), folds)

    gain = group_means(loss(before) - loss(after), groups)
    chances = [_positive(gain, folds), harmless(_POSITION, _HARM)]
    chances += [harmless(part, _HARM_ROTATION) for part, _ in parts[1:]]
    return Support(math.sqrt(loss(after).sum() / loss(before).sum()), min(chances))


def _parts(r: Array) -> tuple[slice, ...]:
    return (_POSITION, _ROTATION) if r.shape[1] == 6 else (_POSITION,)


def _square(r: Array, part: slice) -> Array:
    """(M,) squared errors of position or rotation."""
    return array((r[:, part] ** 2).sum(axis=1))


def _positive(gain: Array, folds: int) -> float:
    """Probability that the mean of gains (M,) is positive on other poses: the corrected resampled t-test
    (Nadeau, Bengio, Machine Learning 52, 2003). Fits to overlapping poses err together: the variance of a
    mean over k folds is 1 + k / (k - 1) times that of independent ones. The effect is the best of many on
    these very poses: only what it gains beyond one standard error counts."""
    if len(gain) < _LEAST:
        return UNTESTED
    error = max(float(gain.std(ddof=1)) / math.sqrt(len(gain)), 1e-300)
    t = float(gain.mean()) / error - _CHOSEN
    return float(stdtr(folds - 1, t / math.sqrt(1.0 + folds / (folds - 1.0))))


def _much_worse(before: Array, after: Array) -> bool:
    """Position or rotation error of a block grows by more than a tenth, with its 95 % interval."""
    parts = _parts(before)
    return any(much_worse(held_ratio(_square(after, part), _square(before, part))[1]) for part in parts)
