"""The reading of the files that explains the data best: simple changes, one after the other.

Each round compares every reading one change away by `screened`, and the best few of them, with those that
the regression cannot judge, by `misfit`: a quick search tries other units and orientations only where much
of the motion is left, as these mistakes leave much. A change that the final reading can do without is taken
back.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from kincal_shared.schema.arm import ArmTable, read_shipped, same_joints, shipped_arms

from ..data.measurements import Measurements
from ..numerics.types import Array, Indices
from .misfit import misfit, screened
from .reading import (
    Pair,
    Reading,
    all_orders,
    euler_orders,
    frames,
    joint_values,
    mirrors,
    motions,
    poses,
    two_offsets,
)

_POSES = 60  # enough to tell gross misreadings
_ALL = 0.95  # share of the poses that counts where those far off are asked about
_TRIED = 4  # readings a round that are fitted
_ROUNDS = 6
_MEASURED_RIGHT = 0.05  # of the motion: below it units and orientations of the poses, and zeros of joints,
# are not in doubt
_BETTER = 0.75  # of the misfit: a step of the search
_AS_GOOD = 1.1  # times the least misfit
_ALIKE = 1.5  # times the misfit: a mirror explains as much as signs of joints
_MANY_SIGNS = 3  # joints that count the other way round are less likely than one mirrored frame
_NEEDED = 3.0  # times worse without a change: it is part of the answer
GOOD_MISFIT = 0.02  # of the motion: below it nothing gross is wrong
FOUND = 5.0  # times less misfit: the files were misread


@dataclass
class Search:
    """Misfits of readings of one arm table and one set of measurements; each is computed once.

    thorough: units and orientations are tried however little of the motion is left.
    """

    arm: ArmTable
    data: Measurements
    thorough: bool = True
    fitted: dict[Reading, float] = field(default_factory=dict)
    of_all: dict[Reading, float] = field(default_factory=dict)
    bounds: dict[Reading, float] = field(default_factory=dict)

    @cached_property
    def given(self) -> Reading:
        """The files as they are."""
        return Reading.as_given(self.arm.n)

    @cached_property
    def shipped(self) -> tuple[ArmTable, ...]:
        """Arms that ship, with as many joints, that are not this one."""
        found = [replace(read_shipped(name), source=name) for name in shipped_arms()]
        return tuple(one for one in found if one.n == self.arm.n and not same_joints(one, self.arm))

    @cached_property
    def rows(self) -> Indices:
        """(M,) the poses that are looked at."""
        random = np.random.default_rng(1)
        return np.sort(random.choice(self.data.n, min(self.data.n, _POSES), replace=False))

    def of(self, reading: Reading) -> Pair:
        """Arm and measurements of some poses, as a reading understands them."""
        return reading.of(self.arm, self.data, self.shipped, self.rows)

    def misfit(self, reading: Reading) -> float:
        """Share of the measured motion that the arm does not explain, by a fit."""
        if reading not in self.fitted:
            self.fitted[reading] = misfit(*self.of(reading))
        return self.fitted[reading]

    def misfit_of_all(self, reading: Reading) -> float:
        """The same of all poses but the few whose errors may be chance."""
        if reading not in self.of_all:
            self.of_all[reading] = misfit(*self.of(reading), kept=_ALL)
        return self.of_all[reading]

    def ranked(self, readings: Iterable[Reading]) -> list[Reading]:
        """Readings by their misfit by regression, least first. It counts to three digits: smaller differences
        leave the likelier mistake first."""
        readings = list(readings)
        self._screen(reading for reading in readings if reading not in self.bounds)
        return sorted(readings, key=self.bounds.__getitem__)

    def bound(self, reading: Reading) -> float:
        """The misfit by regression."""
        self.ranked([reading])
        return self.bounds[reading]

    def _screen(self, readings: Iterable[Reading]) -> None:
        """Those that differ only in joint readings are computed together."""
        groups: dict[tuple[object, ...], list[Reading]] = defaultdict(list)
        for reading in readings:
            groups[reading.of_the_rest].append(reading)
        for group in groups.values():
            arm, data = self.of(group[0])
            left = screened(arm, joint_values(group, self.data, self.rows), data)
            self.bounds |= zip(group, _to_three_digits(left), strict=True)

    def _best_order(self) -> list[Reading]:
        """The files with their columns in the order that explains most; none for an arm with many joints."""
        orders = all_orders(self.arm.n)
        if not orders:
            return []
        arm, data = self.of(self.given)
        q = self.data.q[self.rows][:, np.array(orders)].transpose(1, 0, 2)
        left = _to_three_digits(screened(arm, q, data))
        return [replace(self.given, order=orders[left.index(min(left))])]

    def best(self) -> Reading:
        """The reading with the least misfit that simple changes lead to, without changes that it does not
        need."""
        found = self._walk(self.given)
        if self.misfit(found) > GOOD_MISFIT and self.misfit(found) * FOUND > self.misfit(self.given):
            found = min((found, *map(self._walk, self._best_order())), key=self.misfit)
        found = self._pruned(found)
        return next(self._mirrors_of(found), found)

    def best_of_all(self) -> Reading | None:
        """The reading one change away that explains poses far off too; None if there is none. A series that
        moves one joint after another shows a mistake about one of them in few poses, and these the misfit of
        most poses leaves out."""
        if self.misfit_of_all(self.given) <= GOOD_MISFIT:
            return None
        ranked = self.ranked(motions(self.given, self.shipped))[:_TRIED]
        best = min(ranked, key=self.misfit_of_all)
        return best if self.misfit_of_all(best) * FOUND <= self.misfit_of_all(self.given) else None

    def alike(self, mirrored: Reading) -> Reading | None:
        """Signs of joints alone that explain the poses as well as a mirror does: an arm that is symmetric
        about a plane moves so. None if there are none."""
        signs = [r for r in motions(without(mirrored, "mirror"), ()) if r.sign != mirrored.sign]
        ranked = self.ranked(signs)[:_TRIED]
        return next((r for r in ranked if self.misfit(r) <= _ALIKE * self.misfit(mirrored)), None)

    def _mirrors_of(self, found: Reading) -> Iterator[Reading]:
        if changed(found) == ["sign"] and found.sign.count(-1) >= _MANY_SIGNS:
            tried = mirrors(without(found, "sign"), self.arm, self.data)
            yield from (r for r in tried if self.misfit(r) <= _ALIKE * self.misfit(found))

    def _walk(self, start: Reading) -> Reading:
        """The best of the readings that steps from a first one pass."""
        passed = [start]
        while len(passed) <= _ROUNDS and (following := self._step(passed[-1])) is not None:
            passed.append(following)
        return min(passed, key=self.misfit)

    def _step(self, here: Reading) -> Reading | None:
        """The best reading one change away; None if none is much better, by fit or by regression."""
        ranked = self.ranked([*motions(here, self.shipped), *self._zeros_otherwise(here)])
        tried = [*ranked[:_TRIED], *self._measured_otherwise(here), *frames(here, self.arm)]
        least = min(map(self.misfit, tried))
        if least < _BETTER * self.misfit(here):
            return next(reading for reading in tried if self.misfit(reading) <= _AS_GOOD * least)
        return ranked[0] if self.bound(ranked[0]) < _BETTER * self.bound(here) else None

    def _measured_otherwise(self, here: Reading) -> Iterable[Reading]:
        """Readings in which the poses are other ones; a quick search has none if they follow the arm: a
        factor between units and an inverse change the motion throughout."""
        if not (self.thorough or self.misfit(here) > _MEASURED_RIGHT):
            return ()
        return *poses(here, self.arm, self.data), *self.ranked(euler_orders(here, self.data))[:_TRIED]

    def _zeros_otherwise(self, here: Reading) -> Iterable[Reading]:
        """Readings with quarter turns at two joints, which leave much of the motion."""
        return two_offsets(here) if self.misfit(here) > _MEASURED_RIGHT else ()

    def _pruned(self, reading: Reading) -> Reading:
        for simpler in simpler_than(reading):
            if self.misfit(simpler) < _NEEDED * self.misfit(reading):
                return self._pruned(simpler)
        return reading


def _to_three_digits(left: Array) -> list[float]:
    return [round(float(x), 3) for x in left]


def simpler_than(reading: Reading) -> Iterable[Reading]:
    """The reading with one kind of change taken back, or the change of one joint."""
    given = Reading.as_given(len(reading.order))
    for name in changed(reading):
        now, back = getattr(reading, name), getattr(given, name)
        yield _with(reading, name, back)
        if name in ("sign", "offset"):
            for j in np.flatnonzero(np.not_equal(now, back)):
                yield _with(reading, name, (*now[:j], back[j], *now[j + 1 :]))
        if name in ("coupled", "sliding", "twisted", "scalar_last"):
            yield from (_with(reading, name, now - {j}) for j in now)


def changed(reading: Reading) -> list[str]:
    """Fields in which a reading differs from the files as given."""
    given = Reading.as_given(len(reading.order))
    return [one.name for one in fields(Reading) if getattr(reading, one.name) != getattr(given, one.name)]


def without(reading: Reading, name: str) -> Reading:
    """The reading with one kind of change taken back."""
    return _with(reading, name, getattr(Reading.as_given(len(reading.order)), name))


def _with(reading: Reading, name: str, value: Any) -> Reading:
    return replace(reading, **{name: value})
