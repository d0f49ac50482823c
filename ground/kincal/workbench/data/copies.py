"""Rows that are the same measurement written twice: to the last digit, with fewer digits, or in other
units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree

from ..numerics.types import Array, Indices, Mask
from .measurements import SAME_POSE, Measurements

_MEASURED = ("direction", "q", "p_m", "quat_wxyz", "payload_kg", "temp_c")  # equal in copies of a row
_DEGREES = 180.0 / np.pi
_FEWEST, _MOST = 3, 9  # decimals or significant digits that numbers are looked at with
_COARSE = 4  # decimals up to which replicates may be equal
_BEYOND_CHANCE_M = 1e-5  # step of the positions up to which no replicate agrees with a row in all its numbers
_NEARLY_ALL = 0.9  # share of the rows of few digits that have a finer one near
_LEAST_SHARE = 0.2  # of all rows; single ones end in zeros by chance
_EXACT = 1e-9  # [rad, m] differences of one number in two units


def without_copies(data: Measurements) -> Measurements:
    """The poses without rows that repeat another one, to the last bit, with fewer digits (rounded or cut off)
    or in other units: noise makes replicates differ, so these are the same measurement written twice. Rows
    that the file states as replicates of each other are that."""
    same = _repeated(data)
    once = data.take(np.flatnonzero(~same)) if same.any() else data
    coarse = _written_again(once)
    if not same.any() and not coarse.any():
        return data
    return replace(
        once.take(np.flatnonzero(~coarse)),
        duplicates=data.duplicates + int(same.sum() + coarse.sum()),
        rounded=data.rounded + int(coarse.sum()),
        whole=None,
    )


def few_digits(data: Measurements) -> bool:
    """All positions have so few decimals that measurements of one pose may be equal."""
    return bool(_whole(data.p_m * 10.0**_COARSE).all())


def _repeated(data: Measurements) -> Mask:
    """(N,) rows that an earlier one equals to the last bit."""
    names = _MEASURED[data.direction_source == "inferred" :]
    parts = [x for name in names if (x := getattr(data, name)) is not None]
    if not data.order_is_time and data.t_s is not None and few_digits(data):
        parts.append(data.t_s)  # measured anew, by a device that does not resolve its noise
    rows = np.ascontiguousarray(np.column_stack(parts)) + 0.0  # no negative zeros
    _, first, number = np.unique(
        rows.view(np.dtype((np.void, rows.strides[0]))).ravel(), return_index=True, return_inverse=True
    )
    repeated: Mask = first[number] != np.arange(data.n)
    return repeated & ~_stated_together(data, np.arange(data.n), first[number])


def _stated_together(data: Measurements, a: Indices, b: Indices) -> Mask:
    """(M,) pairs of rows that the file states as replicates of each other."""
    if not data.replicate_stated or data.replicate is None:
        return np.zeros(len(a), dtype=bool)
    together: Mask = data.replicate[a] == data.replicate[b]
    return together


@dataclass(frozen=True)
class _Writing:
    """How numbers (N, m) may be written in a unit, with so many decimals or so many significant digits in all
    of a row. step: (N, m) between two such numbers, 0 where they have all digits; count: (N,) of digits."""

    step: Array
    count: Indices

    @classmethod
    def of(cls, x: Array, unit: float, *, significant: bool) -> _Writing:
        """The fewest digits that give the numbers of each row exactly. unit: of the file in one of ours."""
        size = 10.0 ** (np.floor(np.log10(np.maximum(np.abs(x * unit), 1e-300))) + 1.0)
        step, counts = np.zeros(x.shape), np.full(len(x), _MOST + 1)
        for count in range(_MOST, _FEWEST - 1 - 2 * (unit > 1.0), -1):
            one = (size if significant else np.ones(x.shape)) * 10.0**-count
            fits = _whole(x * unit / one).all(axis=1)
            step[fits], counts[fits] = one[fits] / unit, count
        return cls(step, counts)


def _whole(x: Array) -> Mask:
    """Numbers that are whole but for rounding errors."""
    whole: Mask = np.abs(x - np.round(x)) < np.maximum(1e-5, 1e-15 * np.abs(x))
    return whole


def _writings(x: Array, *units: float) -> list[_Writing]:
    return [_Writing.of(x, unit, significant=some) for some in (False, True) for unit in units]


def _written_again(data: Measurements) -> Mask:
    """(N,) rows that another one gives when it is written as they are. With few digits replicates do so too:
    there nearly all rows have to."""
    joints, positions = _writings(data.q, 1.0, _DEGREES), _writings(data.p_m, 1.0)
    x = np.column_stack([data.q, data.p_m])
    found = np.zeros(data.n, dtype=bool)
    pairs = KDTree(x).query_pairs(SAME_POSE, p=np.inf, output_type="ndarray")
    pairs = pairs[~_stated_together(data, *pairs.T)]
    most = np.abs(x[pairs[:, 0]] - x[pairs[:, 1]]).max(axis=1)
    exact = pairs[(most > 0.0) & (most <= _EXACT)]  # equal ones may differ in another column
    form = np.column_stack([joints[0].count, joints[1].count, positions[0].count])
    coarse, fine = _by_step(pairs[(form[pairs[:, 0]] != form[pairs[:, 1]]).any(axis=1)], positions, joints)
    turned = np.any([_agree(data.q, coarse, fine, joints, one) for one in joints], axis=0)
    agrees, sure = np.zeros(len(coarse), dtype=bool), np.zeros(len(coarse), dtype=bool)
    for one in positions:
        same = turned & _agree(data.p_m, coarse, fine, positions, one)
        agrees |= same
        sure |= same & (one.step[coarse].max(axis=1) <= 1.001 * _BEYOND_CHANCE_M)
    found[coarse[sure]] = True
    rest, rows = np.unique(coarse[~sure]), np.unique(coarse[agrees & ~sure])
    if len(rows) >= max(_NEARLY_ALL * len(rest), _LEAST_SHARE * data.n):
        found[rows] = True
    found[exact.max(axis=1)[~found[exact].any(axis=1)]] = True
    return found


def _by_step(
    pairs: Indices, positions: Sequence[_Writing], joints: Sequence[_Writing]
) -> tuple[Indices, Indices]:
    """Pairs of rows (M, 2) as the coarser and the finer ones, by the largest steps of positions, then
    joints."""
    position, joint = (np.max([w.step.max(axis=1) for w in part], axis=0) for part in (positions, joints))
    a, b = pairs.T
    swap = (position[a] < position[b]) | ((position[a] == position[b]) & (joint[a] < joint[b]))
    return np.where(swap, b, a), np.where(swap, a, b)


def _agree(
    x: Array, coarse: Indices, fine: Indices, writings: Sequence[_Writing], as_written: _Writing
) -> Mask:
    """(M,) coarse rows of numbers x (N, n) that are the fine ones rounded to their step, or cut off there,
    towards zero or downwards. as_written: one of the possible writings, by which the coarse ones are."""
    step, own = as_written.step[coarse], np.max([w.step[fine] for w in writings], axis=0)
    slack, a, b = 0.5001 * own + _EXACT, x[coarse], x[fine]

    def cut(more: Array) -> Mask:
        return np.asarray((more >= -slack) & (more <= 1.0001 * step + slack), dtype=bool)

    kinds = (np.abs(a - b) <= 0.5001 * step + slack, cut(np.abs(b) - np.abs(a)), cut(b - a))
    agrees: Mask = np.any([kind.all(axis=1) for kind in kinds], axis=0)
    return agrees
