"""What differs between measurements of one commanded pose: noise, and what follows how the arm came there.

Backlash makes replicates differ that were approached from different sides. That is no noise: with it in the
noise floor, the floor hides the very effect. What follows the last moves of the joints is tested, and taken
out where it is certain.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..data.direction import order_of_measurement
from ..fit.least_squares import Fit
from ..numerics.distributions import f_tail
from ..numerics.types import Array, Groups, Indices, array

Approach = Literal["direction", "move", "visit"]
"""What replicates differ by: the sides that joints came from, the lengths of their last moves, or (where
nothing says from where they came) every other visit of a pose."""

_FAR = 10.0  # median distances from the middle of a group: a mistake rather than noise
_CERTAIN_P = 1e-4


@dataclass(frozen=True)
class Approached:
    """Replicates differ by how the arm came to the pose, p_value: that this is chance, by the F test."""

    by: Approach
    p_value: float


@dataclass(frozen=True)
class Replicates:
    """groups: poses that were measured again; error: (N, c) part of the residuals that follows the approach
    [m, rad]; taken: number of coefficients that describe it; approached: the test of it, None if replicates
    do not follow it."""

    groups: tuple[Indices, ...]
    error: Array
    taken: int = 0
    approached: Approached | None = None

    @property
    def repeats(self) -> int:
        """Poses measured again, beyond one of each group."""
        return sum(len(members) - 1 for members in self.groups)

    def square(self, rows: Array) -> Array:
        """(c,) sum of squares about the mean of each group; rows: (N, c)."""
        return array(sum((_centred(rows[members]) ** 2).sum(axis=0) for members in self.groups))


def replicates(fit: Fit) -> Replicates:
    """The replicates of the poses of a fit, and what of their differences follows the approach."""
    found = Replicates(tuple(_groups(fit)), np.zeros_like(fit.evaluation.r))
    if not found.groups:
        return found
    tried = [x for by, values in _approaches(fit) if (x := _following(fit, found, by, values)) is not None]
    best = min(tried, key=_p_value, default=found)
    return best if _p_value(best) * len(tried) < _CERTAIN_P else found


def _p_value(x: Replicates) -> float:
    return 1.0 if x.approached is None else x.approached.p_value


def _groups(fit: Fit) -> Iterator[Indices]:
    """Indices of the poses of each group that was measured more than once, without those far from the others
    of their group. What a model calls an outlier does not matter: the noise is that of the data."""
    groups = fit.data.replicate if fit.data.replicate is not None else np.arange(fit.data.n)
    numbers, counts = np.unique(groups, return_counts=True)
    found = [np.flatnonzero(groups == number) for number in numbers[counts > 1]]
    if not found:
        return
    z = fit.z.reshape(fit.data.n, -1)
    away = [np.linalg.norm(z[members] - np.median(z[members], axis=0), axis=1) for members in found]
    most = _FAR * np.median(np.concatenate(away))
    for members, distance in zip(found, away, strict=True):
        if (kept := members[distance <= most]).size > 1:
            yield kept


def _approaches(fit: Fit) -> Iterator[tuple[Approach, Array]]:
    """(N, n) how each joint came to each pose: from which side, from how far, on which visit."""
    data = fit.data
    if data.direction is not None:
        yield "direction", data.direction
    if data.move is not None:
        yield "move", data.move
    order = order_of_measurement(data)
    if order is not None and data.replicate is not None and data.direction_source != "measured":
        visit = _alternating(data.replicate, order)[:, None]
        yield "visit", np.tile(visit, data.n_joints)
        if data.direction is not None:  # every other time from the side opposite to that of the first visit
            yield "visit", visit * _of_first_visit(data.direction, data.replicate, order)


def _alternating(groups: Groups, order: Indices) -> Array:
    """(N,) +1, -1, +1 ... of the visits of each pose, in the order of measurement."""
    sign = np.empty(len(groups))
    for number in np.unique(groups):
        visits = order[groups[order] == number]
        sign[visits] = 1.0 - 2.0 * (np.arange(len(visits)) % 2)
    return sign


def _of_first_visit(values: Array, groups: Groups, order: Indices) -> Array:
    """(N, n) of values (N, n) those of the first visit of the same pose."""
    first = {groups[row]: row for row in order[::-1]}
    return array(values[[first[number] for number in groups]])


def _following(fit: Fit, found: Replicates, by: Approach, values: Array) -> Replicates | None:
    """What of the differences is a motion of each joint in proportion to `values` (N, n); None if too few
    replicates differ by them to tell."""
    moved = fit.evaluation.Jq * values[:, None, :]
    design = _stacked(fit.whiten @ moved, found)
    z = fit.z.reshape(fit.data.n, -1)
    target = _stacked(z, found)
    size, _, taken, _ = np.linalg.lstsq(design, target, rcond=1e-9)
    dof = len(target) - len(found.groups) * z.shape[1] - int(taken)
    if taken == 0 or dof < taken:
        return None
    left = float(((target - design @ size) ** 2).sum())
    explained = float((target**2).sum()) - left
    p_value = f_tail(explained / taken / max(left / dof, 1e-300), int(taken), dof)
    return Replicates(found.groups, array(moved @ size), int(taken), Approached(by, p_value))


def _stacked(rows: Array, found: Replicates) -> Array:
    """Rows (N, c, ...) of the replicates about the mean of their group, one under another."""
    together = np.concatenate([_centred(rows[members]) for members in found.groups])
    return array(together.reshape(-1, *rows.shape[2:]))


def _centred(rows: Array) -> Array:
    return array(rows - rows.mean(axis=0))
