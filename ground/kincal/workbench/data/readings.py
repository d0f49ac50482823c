"""Several readings of one pose as one measurement.

An arm that stands still repeats its own error in every reading: only the noise of the sensor differs.
Readings that count as poses of their own let any smooth function of the pose look certain, and a fit look
better known than it is (Kish, Survey Sampling, 1965, section 5.4: the design effect of clusters).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from ..numerics.types import Array, Groups, Indices, Mask
from .direction import order_of_measurement
from .measurements import SAME_PAYLOAD_KG, SAME_POSE, Measurements, replicate_groups

LeftM = Callable[[Measurements], float]
"""RMS position [m] that a fit of the arm leaves of measurements."""

_LEAST_SHARE = 0.1  # of the rows; fewer change little, and stay as they are where the times do not tell
_LEAST_STATED = 1.0 / 3.0  # where the file calls them replicates: a campaign repeats a part of its poses
_LEAVES = 1.25  # times the usual interval between poses: to leave a pose and come back takes two moves
_STAYS = 0.5  # times that interval: too short to leave
_OF_LEFT = 0.5  # of what a fit leaves: readings that differ by more repeat no error of the arm
_MEDIAN_STEP = 0.795  # RMS noise of positions over the median distance of two of them
_FAR = 10.0  # median distances from the middle of a pose: a mistake of the sensor
_FEWEST_TO_REFUSE = 3  # readings; of two, none is known to be the wrong one
# What an effect may follow, and by how much it differs between readings of one pose.
_SAME = {
    "q": SAME_POSE, "direction": 0.0, "tag": 0.0, "payload_kg": SAME_PAYLOAD_KG, "temp_c": 0.5, "qdot": 0.1,
    "g_m_s2": 0.6, "pan_rad": 1e-3, "tilt_rad": 1e-3, "cam_p_m": 1e-3,
}  # fmt: skip


def one_measurement_a_pose(
    data: Measurements, excluded: Collection[str] = (), left_m: LeftM | None = None
) -> Measurements:
    """The data with the mean of each run of readings at rest in its place, under the id of the first one.

    Readings follow one another in time, agree in all that an effect may follow, and no time between them
    was long enough to leave the pose and come back; where the times do not tell, their positions differ by
    much less than what a fit leaves (else they repeat no error, and may count each). Stated noise is taken
    for that of a reading, of which the mean loses what differs between readings. A note says how many rows
    became how many poses. excluded: ids to leave out, of single readings or, by that of the first one, of a
    pose. BadInput names those that no row has.
    """
    kept = data.without(excluded) if excluded else data
    runs = _runs(data, left_m)
    if not runs:
        return kept
    out = set(excluded)
    poses = [rows for rows in runs if data.ids[rows[0]] not in out]
    poses = [rows[[data.ids[k] not in out for k in rows]] for rows in poses]
    if not poses:
        return data.without(data.ids)  # says that none is left
    return _together(data, list(_without_mistakes(data, poses)), poses)


def _runs(data: Measurements, left_m: LeftM | None) -> list[Indices]:
    """Rows of each pose, in the order of the file; none where readings at rest are too few to matter."""
    order = order_of_measurement(data)
    if order is None or data.n < 2:
        return []
    number, surely = _numbered(data, order, left_m)
    if data.replicate_stated and data.n - 1 - number.max() < _LEAST_STATED * data.n:
        return []
    if data.n - 1 - number.max() < max(_LEAST_SHARE * data.n, 1.0):
        number = surely
    if number.max() == data.n - 1:
        return []
    rows = np.argsort(number, kind="stable")
    found = np.split(rows, np.flatnonzero(np.diff(number[rows])) + 1)
    return sorted(found, key=lambda run: int(run[0]))


def _numbered(data: Measurements, order: Indices, left_m: LeftM | None) -> tuple[Groups, Groups]:
    """(N,) number of the run that each row belongs to; the same of the runs that times alone tell."""
    alike = _follows(data, order)
    if data.replicate_stated and data.replicate is not None:
        alike &= np.diff(data.replicate[order]) == 0
    gap = None if data.order_is_time or data.t_s is None else np.diff(data.t_s[order])
    usual = float(np.median(gap[~alike])) if gap is not None and not alike.all() else np.inf
    surely = np.zeros(len(alike), dtype=bool) if gap is None else gap <= _STAYS * usual
    if gap is not None:
        alike &= gap <= _LEAVES * usual
    surely &= alike
    perhaps = alike & ~surely
    step = np.linalg.norm(np.diff(data.p_m[order], axis=0), axis=1)
    if perhaps.any() and left_m is not None:
        noise_m = _MEDIAN_STEP * float(np.median(step[perhaps]))
        if noise_m > _OF_LEFT * left_m(data):
            alike = surely
    return _runs_of(alike, order), _runs_of(surely, order)


def _runs_of(alike: Mask, order: Indices) -> Groups:
    """(N,) number of the run of each row, where a row that is alike belongs to that of the row before it."""
    number = np.empty(len(order), dtype=int)
    number[order] = np.concatenate([[0], np.cumsum(~alike)])
    return number


def _follows(data: Measurements, order: Indices) -> Mask:
    """(N - 1,) rows that may be another reading of the pose that the first row of their run has."""
    columns = [(x[order].reshape(data.n, -1), most) for name, most in _SAME.items()
               if (x := getattr(data, name)) is not None]  # fmt: skip
    values = np.column_stack([x for x, _ in columns])
    most = np.concatenate([np.full(x.shape[1], limit) for x, limit in columns])
    alike, first = np.zeros(data.n - 1, dtype=bool), 0
    for k in range(1, data.n):
        alike[k - 1] = bool((np.abs(values[k] - values[first]) <= most).all())
        first = first if alike[k - 1] else k
    return alike


def _without_mistakes(data: Measurements, runs: list[Indices]) -> Iterator[Indices]:
    """The readings of each run whose positions are not far from the others."""
    away = [
        np.linalg.norm(data.p_m[rows] - np.median(data.p_m[rows], axis=0), axis=1)
        for rows in runs
    ]  # fmt: skip
    several = [x for x in away if len(x) >= _FEWEST_TO_REFUSE]
    most = _FAR * float(np.median(np.concatenate(several))) if several else np.inf
    for rows, distance in zip(runs, away, strict=True):
        usual = distance <= most if len(rows) >= _FEWEST_TO_REFUSE else np.ones(len(rows), dtype=bool)
        yield rows[usual] if usual.any() else rows


def _together(data: Measurements, used: list[Indices], runs: list[Indices]) -> Measurements:
    """The means of the rows used of each run."""
    first = np.array([rows[0] for rows in runs])
    poses = replace(data.take(first), whole=data.whole)
    means: dict[str, Any] = {}
    for name in ("q", "p_m", "t_s", "qdot", "temp_c", "payload_kg", "g_m_s2", "range_m", "incid_rad", "u_px",
                 "v_px", "cam_p_m", "pan_rad", "tilt_rad"):  # fmt: skip
        if (values := getattr(data, name)) is not None:
            means[name] = np.stack([values[rows].mean(axis=0) for rows in used])
    for name in ("quat_wxyz", "cam_quat_wxyz"):
        if (values := getattr(data, name)) is not None:
            means[name] = np.stack([_mean_rotation(values[rows]) for rows in used])
    if data.cov is not None:
        means["cov"] = _of_means(data, means, used)
    return replace(
        poses,
        **means,
        replicate=poses.replicate
        if data.replicate_stated
        else replicate_groups(means["q"], means.get("payload_kg")),
        notes=(*data.notes, _note(data, used, runs)),
    )


def _mean_rotation(quat_wxyz: Array) -> Array:
    """(4,) mean of rotations (m, 4): Markley, Cheng, Crassidis, Oshman, J. Guidance 30, 2007."""
    vector: Array = np.linalg.eigh(quat_wxyz.T @ quat_wxyz)[1][:, -1]
    return vector * (1.0 if vector @ quat_wxyz[0] >= 0.0 else -1.0)


def _of_means(data: Measurements, means: dict[str, Any], used: list[Indices]) -> Array:
    """(M, 6, 6) covariance of the means: of the stated variance, the share that differs between readings of a
    pose is divided by their number, the rest belongs to the pose."""
    assert data.cov is not None
    square, dof = 0.0, 0
    for rows, mean in zip(used, means["p_m"], strict=True):
        off = data.p_m[rows] - mean
        square += float(
            np.einsum("ni,ni->", off, np.linalg.solve(data.cov[rows, :3, :3], off[:, :, None])[:, :, 0])
        )
        dof += 3 * (len(rows) - 1)
    share = min(square / dof, 1.0) if dof else 0.0
    return np.stack([(1.0 - share * (1.0 - 1.0 / len(rows))) * data.cov[rows].mean(axis=0) for rows in used])


def _note(data: Measurements, used: list[Indices], runs: list[Indices]) -> str:
    count = sum(len(rows) for rows in runs)
    left = count - sum(len(rows) for rows in used)
    mistakes = (
        f", without {left} far from the others of {'its' if left == 1 else 'their'} pose" if left else ""
    )
    anew = " (if each was approached again, times in t_s would show it)" if data.order_is_time else ""
    found = f"{count} rows are readings of {len(runs)} poses at rest"
    return f"{found}: each pose counts once, with their mean{mistakes}{anew}"
