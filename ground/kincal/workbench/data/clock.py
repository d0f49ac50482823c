"""One clock for sessions whose clocks began anew: several files, or one file put together from several."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..numerics.types import Array, Groups, Mask, array
from .measurements import SAME_POSE, Measurements

_MOST_RESTARTS = 0.25  # of the rows of a file; if times fall back more often, rows are in no order of time
_LEAST_POSES = 3  # of a session
_LEAST_MEETINGS = 5  # of poses of two sessions that follow one another in time
_TOO_CLOSE = 0.5  # times a short interval of one session: no arm is measured in two poses so soon
_SHARE = 0.15  # of the meetings that are too close: the sessions did not run at one time
_DAY_S, _HOUR_S = 86400.0, 3600.0
_MIDNIGHT = "t_s falls back as seconds of the day do: what comes after is taken for the next day"
_BREAK = 10.0  # usual intervals between one session and the next: how long it truly was, nothing says


def one_clock(data: Measurements, file: Groups | None = None) -> Measurements:
    """The data with sessions one after another, as they stand, where their clocks each began anew: then poses
    of two sessions have times at which no arm can have been in both. A note says so.

    file: (N,) number of the file of each row, rising; absent: all are of one. With the times of each session
    as they are, a base that was moved between two of them would move back and forth with every pose.
    """
    if data.t_s is None or data.order_is_time:
        return data
    session = _sessions(data.t_s, np.zeros(data.n, dtype=int) if file is None else file)
    count = int(session.max()) + 1 if data.n else 0
    t_s, later, midnight = data.t_s.copy(), 0, False
    for k in range(1, count):
        mine, before = session == k, session < k
        own = np.concatenate([_intervals(data, session == one) for one in (k - 1, k)])
        if _over_midnight(data.t_s[session == k - 1], data.t_s[mine]):
            t_s[session >= k] += _DAY_S
            midnight = True
            continue
        if not _at_one_time(t_s[before], t_s[mine], own):
            continue
        usual = float(np.median(np.diff(np.sort(t_s[before]))))
        t_s[mine] += float(t_s[before].max() - t_s[mine].min()) + _BREAK * usual
        later += 1
    notes = [_MIDNIGHT] if midnight else []
    if later:
        begin = "another session begins" if later == 1 else f"{later} other sessions begin"
        notes.append(
            f"t_s starts again where {begin}: sessions are put one after another, with breaks of "
            f"{_BREAK:.0f} usual intervals, since their true lengths are unknown"
        )
    return replace(data, t_s=t_s, notes=(*data.notes, *notes)) if notes else data


def _sessions(t_s: Array, file: Groups) -> Groups:
    """(N,) number of the session of each row: a file, or a part of it after which the times fall back."""
    begins = np.zeros(len(t_s), dtype=bool)
    begins[1:] = np.diff(file) != 0
    back = np.zeros(len(t_s), dtype=bool)
    back[1:] = (np.diff(t_s) < 0.0) & ~begins[1:]
    for k in np.unique(file):
        if back[file == k].mean() <= _MOST_RESTARTS:
            begins |= back & (file == k)
    return np.cumsum(begins)


def _intervals(data: Measurements, rows: Mask) -> Array:
    """Times [s] from one pose of a session to the next, in the order of its times; between readings of one
    pose there is none."""
    assert data.t_s is not None
    order = np.flatnonzero(rows)[np.argsort(data.t_s[rows], kind="stable")]
    moved = (np.abs(np.diff(data.q[order], axis=0)) > SAME_POSE).any(axis=1)
    return array(np.diff(data.t_s[order])[moved])


def _over_midnight(before: Array, mine: Array) -> bool:
    """Seconds of the day that fall back, by more than half a day or in sessions that do not begin at 0."""
    begin, end = min(before.min(), mine.min()), max(before.max(), mine.max())
    back = before.min() - mine.max()
    return bool(begin >= 0.0 and end < _DAY_S and back > 0.0 and (back > 0.5 * _DAY_S or begin > _HOUR_S))


def _at_one_time(before: Array, mine: Array, own: Array) -> bool:
    """Poses of a session lie between those before it closer than an arm can move from one to the next.
    before, mine: times of all sessions before, and of this one; own: from one pose to the next."""
    if min(len(before), len(mine)) < _LEAST_POSES:
        return False
    short = float(np.quantile(own[own > 0.0], 0.05)) if (own > 0.0).any() else 0.0
    times = np.concatenate([before, mine])
    order = np.argsort(times, kind="stable")
    meets = np.diff(order < len(before)) != 0
    gaps = np.diff(times[order])[meets]
    return len(gaps) >= _LEAST_MEETINGS and float((gaps < _TOO_CLOSE * short).mean()) > _SHARE
