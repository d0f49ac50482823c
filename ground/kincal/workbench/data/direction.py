"""What the order of the measurements tells: each joint's last move, and its sign, the approach direction,
where the data do not record it. Both are taken from the whole file before poses are split or chosen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..numerics.types import Array, Indices
from .measurements import SAME_POSE, Measurements

_LEAST_POSES = 10  # fewer rows can be sorted by chance
_DISTINCT = 0.9  # share of different values from which on a sorted column is no grid
_RANDOM = 0.8  # of the mean square of steps, in units of its mean for a random order
_TURNS = 0.25  # of the moves: another joint that turns back so often was not led by the sorted one
_ELSEWHERE = 0.1  # of the moves against the recorded direction: the arm went by other points between
# Jitter: a joint's moves are of two sizes, hardly any of them in between, and the small ones go back.
_SMALL = SAME_POSE * np.geomspace(1.0, 7.5, 16)  # [rad or m] that small ones may reach
_TIMES = 3.0  # times that: what lies in between
_FEW_BETWEEN = 0.05  # of the small ones
_LEAST_OF_EACH = 0.1  # share of the moves that are small, and that are larger than those in between
_GOES_BACK = -0.25  # correlation of consecutive small ones: -0.5 of jitter, 0 of steps in any direction


def with_direction(data: Measurements) -> Measurements:
    """The data with each joint's last move, and with the approach direction inferred if none is recorded. A
    note says how, or why not."""
    if data.direction is not None:
        return _with_moves(data)
    time = "the order of rows" if data.order_is_time else "the times"
    reason = _why_not(data)
    if reason:
        note = f"approach direction is not inferred from {time}: {reason}"
        return replace(data, notes=(*data.notes, note))
    order = _by_time(data)
    direction = np.empty_like(data.q)
    direction[order] = last_moves(data.q[order])
    note = f"approach direction inferred from {time}: no dir columns"
    inferred = replace(data, direction=direction, direction_source="inferred", notes=(*data.notes, note))
    return _with_moves(inferred)


def least_moves(q: Array) -> Array:
    """(n,) [rad or m] by how much the readings of each joint differ at least where it has moved: `SAME_POSE`,
    or more where those of a joint at rest jitter. q: (N, n) readings in the order of measurement."""
    return np.array([_least_move(moves) for moves in np.diff(q, axis=0).T])


def _least_move(moves: Array) -> float:
    size = np.abs(moves)
    found = [(between, small) for small in _SMALL if (between := _between(size, small)) is not None]
    _, small = min(found, default=(0, SAME_POSE))
    rests = size <= small
    again = rests[1:] & rests[:-1]
    product = (moves[1:] * moves[:-1])[again].sum()
    if small == SAME_POSE or product > _GOES_BACK * (moves[rests] ** 2).mean() * again.sum():
        return SAME_POSE
    return float(np.sqrt(_TIMES) * small)


def _between(size: Array, small: float) -> int | None:
    """Number of moves between small ones and large ones; None if these are not two kinds."""
    rests, goes = size <= small, size > _TIMES * small
    between = int((~rests & ~goes).sum())
    two = min(rests.mean(), goes.mean()) >= _LEAST_OF_EACH and between <= _FEW_BETWEEN * rests.sum()
    return between if two else None


def _with_moves(data: Measurements) -> Measurements:
    """The data with each joint's last move, unless their order tells none, or recorded directions say that
    the arm came from elsewhere than the pose before. A single move against them is unknown: 0."""
    order = order_of_measurement(data)
    if order is None:
        return data
    move = np.empty_like(data.q)
    move[order] = changes(data.q[order])
    if data.direction_source != "inferred" and data.direction is not None:
        moved = np.abs(move) > least_moves(data.q[order])
        against = (data.direction * move < 0.0) & moved
        if against.sum() > _ELSEWHERE * moved.sum():
            return data
        move[against] = 0.0
    return replace(data, move=move)


def order_of_measurement(data: Measurements) -> Indices | None:
    """(N,) the poses in the order in which they were measured; None if the rows are evidently in another."""
    return None if _why_not(data) else _by_time(data)


def in_random_order(data: Measurements) -> bool:
    """Consecutive poses are as far apart as any two (von Neumann, Ann. Math. Statist. 12, 1941)."""
    order = order_of_measurement(data)
    if order is None or data.n < _LEAST_POSES:
        return False
    q = data.q[order]
    moved = q.std(axis=0) > SAME_POSE
    ratio = (np.diff(q[:, moved], axis=0) ** 2).mean(axis=0) / (2.0 * q[:, moved].var(axis=0))
    return bool(moved.any() and ratio.mean() > _RANDOM)


def _by_time(data: Measurements) -> Indices:
    return np.arange(data.n) if data.t_s is None else np.argsort(data.t_s, kind="stable")


def last_moves(q: Array) -> Array:
    """(N, n) sign of each joint's last move before each pose; q: (N, n) readings in the order of measurement.

    A joint that has not moved keeps the sign before; 0 until it has moved.
    """
    moves = np.diff(q, axis=0, prepend=q[:1])
    sign = np.where(np.abs(moves) > least_moves(q), np.sign(moves), 0.0)
    last = np.maximum.accumulate(np.where(sign != 0.0, np.arange(len(q))[:, None], 0), axis=0)
    return np.take_along_axis(sign, last, axis=0)


def changes(q: Array) -> Array:
    """(N, n) change of each joint from the pose before [rad or m]; q: (N, n) readings in the order of
    measurement. Readings of one pose, where no joint has moved, keep that of the first; 0 before any move.
    """
    moves = np.diff(q, axis=0, prepend=q[:1])
    moved = (np.abs(moves) > least_moves(q)).any(axis=1)
    last: Array = moves[np.maximum.accumulate(np.where(moved, np.arange(len(q)), 0))]
    return last


def _why_not(data: Measurements) -> str:
    """Why the rows are evidently not in the order of measurement; empty if they may be."""
    if data.n < 2:
        return "there is only one pose"
    if not data.order_is_time:
        return ""
    if _numbers_out_of_order(data.ids):
        return "the ids are numbers in another order"
    names = [f"q{j}" for j in range(1, data.n_joints + 1)] + ["px", "py", "pz"]
    columns = np.hstack([data.q, data.p_m])
    found = [name for name, x in zip(names, columns.T, strict=True) if _sorted(x)]
    if found and data.n >= _LEAST_POSES and _turns(data.q).max() > _TURNS:
        return f"the rows are sorted by {found[0]}"
    return ""


def _numbers_out_of_order(ids: tuple[str, ...]) -> bool:
    if not all(name.isdigit() for name in ids):
        return False
    return bool((np.diff([float(name) for name in ids]) < 0).any())


def _sorted(x: Array) -> bool:
    """Monotone, with so many different values that it is no loop over a grid."""
    steps = np.diff(x)
    monotone = bool((steps >= 0).all() or (steps <= 0).all())
    return monotone and len(np.unique(x)) > _DISTINCT * len(x)


def _turns(q: Array) -> Array:
    """(n,) share of each joint's moves that go back."""
    moves = np.sign(np.diff(q, axis=0))
    turns: Array = (moves[1:] * moves[:-1] < 0).mean(axis=0) if len(moves) > 1 else np.zeros(q.shape[1])
    return turns
