"""Poses that are fitted and poses that are held out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..numerics.types import Indices
from .measurements import Measurements

_HELD_OUT = 4  # every fourth pose is held out where the file does not say
_LEAST, _MOST = 0.125, 0.5  # share of the poses


@dataclass(frozen=True)
class Split:
    """Indices of the poses to fit and of those held out; `given`: the file said so."""

    fit: Indices
    held: Indices
    given: bool


def choose_split(data: Measurements) -> Split:
    """The file's split, or the poses of every fourth row held out; replicates of one pose stay together.
    Where poses were repeated in step with that (each two or four times in a row), every fourth pose."""
    if data.split is not None:
        return Split(np.flatnonzero(data.split == "fit"), np.flatnonzero(data.split == "held"), True)
    groups = data.replicate if data.replicate is not None else np.arange(data.n)
    _, first, number = np.unique(groups, return_index=True, return_inverse=True)
    last = _HELD_OUT - 1
    chosen = first % _HELD_OUT == last
    if not _LEAST <= chosen.mean() <= _MOST:
        chosen = np.argsort(np.argsort(first)) % _HELD_OUT == last
    held = chosen[number]
    return Split(np.flatnonzero(~held), np.flatnonzero(held), False)


def may_be_fitted(data: Measurements) -> Measurements:
    """The poses that a fit may use: all, but those that the file keeps back."""
    split = choose_split(data)
    return data.take(split.fit) if split.given else data
