"""Rows or columns of a file, or links of an arm table, that are in another unit than the others."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain, combinations

import numpy as np

from kincal_shared.schema.arm import ArmTable

from ..data.measurements import Measurements
from ..numerics.types import Array, Mask
from .findings import Finding
from .misfit import LEAST_POSES, misfit

_DEGREE = math.pi / 180.0
_MILLIMETRE = 1e-3
_FACTOR = 20.0  # times farther than the others, or than the arm reaches: another unit, no motion
_NEAR = 2.5  # times the reach, within which poses of one arm are to each other
_FARTHEST = 1.5  # times as far from the middle as the poses in metres
_SMALL = 0.05  # of the reach: shorter positions say nothing of the unit
_TURNS = 2.2 * math.pi  # [rad] that readings in radians hardly exceed
_BEYOND = 0.1  # [rad] outside a limit that counts
_MOST_JOINTS = 0.5  # of the joints of a row outside their limits: the row is in degrees
_MOST_ROWS = 0.3  # of the rows outside the limits of a joint: the column may be
_BETTER = 5.0  # times that the arm has to explain the poses better with a column in degrees
_NAMED = 12  # poses in a sentence
_MOST_REACH_M = 20.0  # that links of an arm add up to
_LONG_M = 1.0  # a link from which on it may be in millimetres
_EXPLAINED = 0.05  # of the motion, up to which an arm explains poses
_AS_GOOD = 1.1  # times the least misfit
_ENOUGH = 60  # poses to tell units


Link = tuple[int, str]  # place of the joint from 0, a_m or d_m


def mixed_units(arm: ArmTable, data: Measurements) -> tuple[Finding, ...]:
    """Poses, or columns, in millimetres or degrees beside others in metres and radians."""
    return (*_rows(data, millimetre_rows(arm, data), "millimetres", "metres", "px,py,pz", "--units mm"),
            *_rows(data, degree_rows(arm, data), "degrees", "radians", "the joint readings", "--units deg"),
            *_column_in_millimetres(arm, data),
            *_columns_in_degrees(arm, data))  # fmt: skip


def reach_m(arm: ArmTable) -> float:
    """How far the tool can be from the base, at most [m]."""
    slide = sum(max(abs(j.q_min), abs(j.q_max)) for j in arm.joints if j.prismatic)
    return float(sum(abs(j.a_m) + abs(j.d_m) for j in arm.joints) + slide + np.linalg.norm(arm.tool.xyz_m))


def millimetre_rows(arm: ArmTable, data: Measurements) -> Mask:
    """(N,) poses that are where the others are if their positions are millimetres; none if all are alike."""
    reach = reach_m(arm)
    lost = ~data.p_m.any(axis=1)  # (0, 0, 0) stands for no measurement
    size = np.maximum(np.linalg.norm(data.p_m, axis=1), _SMALL * reach)
    ordered = np.sort(size[~lost])
    if len(ordered) < 2 or reach <= 0.0 or (ratio := ordered[1:] / ordered[:-1]).max() < _FACTOR:
        return np.zeros(data.n, dtype=np.bool_)
    far = np.asarray(size > ordered[int(ratio.argmax())], dtype=np.bool_)
    if far.mean() > 0.5 and _spread(data.p_m[far]) < _NEAR * reach:  # far away, and of one arm
        return np.zeros(data.n, dtype=np.bool_)
    middle = np.median(data.p_m[~far & ~lost], axis=0)
    near = min(_NEAR * reach, _FARTHEST * np.linalg.norm(data.p_m[~far & ~lost] - middle, axis=1).max())
    there = np.linalg.norm(_MILLIMETRE * data.p_m - middle, axis=1) <= max(near, _SMALL * reach)
    return np.asarray(far & there, dtype=np.bool_)


def _spread(p_m: Array) -> float:
    """Median distance from the middle."""
    return float(np.median(np.linalg.norm(p_m - np.median(p_m, axis=0), axis=1)))


def degree_rows(arm: ArmTable, data: Measurements) -> Mask:
    """(N,) poses most of whose readings are outside their limits, and inside if they are degrees; none if
    all are."""
    turning = np.array([not joint.prismatic for joint in arm.joints])
    if not turning.any():
        return np.zeros(data.n, dtype=np.bool_)
    q = data.q[:, turning]
    # a controller that counts turns adds one to readings that are inside
    turns = [np.where(turning, data.q + k * 2.0 * np.pi, data.q) for k in (-1, 0, 1)]
    full_turns = ~np.logical_and.reduce([_outside(arm, some) for some in turns]).any(axis=1)
    most = _outside(arm, data.q)[:, turning].mean(axis=1) >= _MOST_JOINTS
    inside = ~_outside(arm, data.q * np.where(turning, _DEGREE, 1.0)).any(axis=1)
    found = most & inside & ~full_turns & (np.abs(q).max(axis=1) > _TURNS)
    return np.asarray(found & ~found.all(), dtype=np.bool_)


def _outside(arm: ArmTable, q: Array) -> Mask:
    """(N, n) readings outside the limits of the arm table."""
    limits = np.array([[joint.q_min, joint.q_max] for joint in arm.joints])
    return np.asarray((q < limits[:, 0] - _BEYOND) | (q > limits[:, 1] + _BEYOND), dtype=np.bool_)


def _rows(data: Measurements, found: Mask, unit: str, ours: str, what: str, option: str) -> Iterator[Finding]:
    """The finding for rows in another unit; those that are fewer are named."""
    if not found.any():
        return
    count, most = int(found.sum()), bool(found.mean() > 0.5)
    names = [name for name, other in zip(data.ids, found, strict=True) if other != most]
    shown = ", ".join(names[:_NAMED]) + (f" and {len(names) - _NAMED} more" if len(names) > _NAMED else "")
    rest = f", the others like {ours}" if most else ""
    factor = "1000" if unit == "millimetres" else "180/pi"
    todo = f"multiply {what} of these {len(names)} rows by {factor} and add {option}" if most else (
        f"divide {what} of these rows by {factor}")  # fmt: skip
    yield Finding(
        unit,
        f"{count} of {data.n} poses look like {unit} ({what}){rest}: ids {shown}",
        f"{todo}, or leave them out: --exclude {','.join(names)}",
        poses=tuple(names),
    )


def links_in_metres(arm: ArmTable, data: Measurements) -> tuple[ArmTable, tuple[Finding, ...]]:
    """The arm table with the lengths of links that look like millimetres in metres, and which ones they are.
    As it is where the poses speak against that."""
    links = {
        (j, key): abs(getattr(joint, key)) for j, joint in enumerate(arm.joints) for key in ("a_m", "d_m")
    }
    ordered = sorted((link for link, size in links.items() if size > 0.0), key=lambda link: -links[link])
    far = sum(links.values()) > _MOST_REACH_M
    if not ordered or links[ordered[0]] < _LONG_M:
        return arm, ()
    found = _shortened(arm, data, ordered, links, far) if data.n >= LEAST_POSES else None
    if found is None:
        return arm, (_impossible(arm, ordered, links),) if far and not _there_and_back(arm, data) else ()
    some, gain = found
    if len(some) == len(ordered):
        shorter, frames = _frames_in_metres(_in_metres(arm, some), data)
        return shorter, (_impossible(arm, ordered, links, gain, frames),)
    names = ", ".join(f"{key} of joint {_number(arm, j, key)} ({links[j, key]:g})" for j, key in some)
    values = ", ".join(
        f"joint[{_number(arm, j, key)}].{key} = {getattr(arm.joints[j], key) * _MILLIMETRE:.6g}"
        for j, key in some
    )
    why = f"the arm table seems to be in millimetres for {names}, in metres for the others{_better(gain)}"
    return _in_metres(arm, some), (Finding("millimetres", why, f"write metres: {values}", gain),)


def _shortened(
    arm: ArmTable, data: Measurements, ordered: Sequence[Link], links: Mapping[Link, float], far: bool
) -> tuple[Sequence[Link], float] | None:
    """The longest links, as many as explain the poses best if they are in millimetres, and how many times
    better; None if metres do. far: metres are impossible for some of them."""
    data = data.take(np.linspace(0, data.n - 1, min(data.n, _ENOUGH)).astype(int))
    least = max(sum(size > _MOST_REACH_M for size in links.values()), 1)
    long = sum(size >= _LONG_M for size in links.values())
    tried = [k for k in range(least, long + 1) if far or k < len(ordered)]
    left = [misfit(_in_metres(arm, ordered[:k]), data) for k in tried]
    if not np.isfinite(best := min(left, default=np.inf)):
        return None
    chosen = max(k for k, one in zip(tried, left, strict=True) if one <= _AS_GOOD * best)
    if far and _BETTER * (all_of_them := misfit(_in_metres(arm, ordered), data)) <= best:
        best, chosen = all_of_them, len(ordered)
    given = misfit(arm, data)
    better = best <= _AS_GOOD * given if far else best <= _EXPLAINED and _BETTER * best <= given
    return (ordered[:chosen], given / best) if better else None


def _there_and_back(arm: ArmTable, data: Measurements) -> bool:
    """The links are as long as stated: the arm explains the poses, and these lie within the reach of an arm.
    Axes that are almost parallel have such links, there and back along them."""
    if data.n < LEAST_POSES or np.ptp(data.p_m, axis=0).max() > _MOST_REACH_M:
        return False
    return misfit(arm, data) <= _EXPLAINED


def _in_metres(arm: ArmTable, some: Sequence[Link]) -> ArmTable:
    """The arm table with these lengths in millimetres."""
    joints = list(arm.joints)
    for j, key in some:
        length_m = {key: getattr(joints[j], key) * _MILLIMETRE}
        joints[j] = replace(joints[j], **length_m)
    return replace(arm, joints=tuple(joints))


def _frames_in_metres(arm: ArmTable, data: Measurements) -> tuple[ArmTable, tuple[str, ...]]:
    """An arm whose links were in millimetres, with base and tool in metres where that explains the poses much
    better, and which these are."""
    long = [name for name in ("base", "tool") if np.linalg.norm(getattr(arm, name).xyz_m) >= _LONG_M]
    best, least = arm, misfit(arm, data) / _BETTER
    found: tuple[str, ...] = ()
    for names in chain.from_iterable(combinations(long, k) for k in (1, 2)):
        frames = {name: getattr(arm, name) for name in names}
        shorter = {name: replace(f, xyz_m=_MILLIMETRE * f.xyz_m) for name, f in frames.items()}
        tried = replace(arm, **shorter)
        if (left := misfit(tried, data)) < least:
            best, least, found = tried, left, names
    return best, found


def _impossible(
    arm: ArmTable,
    ordered: Sequence[Link],
    links: Mapping[Link, float],
    gain: float = 1.0,
    frames: Sequence[str] = (),
) -> Finding:
    """The finding for links that add up to more than any arm has; frames: in millimetres too."""
    j, key = ordered[0]
    return Finding(
        "millimetres",
        f"the links of the arm table add up to {sum(links.values()):.4g} m (the largest: {key} of joint "
        f"{_number(arm, j, key)}, {links[j, key]:g}), which looks like millimetres{_better(gain)}",
        f"write {', '.join(['a_m, d_m', *(f'xyz_m of [{name}]' for name in frames)])} in metres",
        gain,
    )


def _number(arm: ArmTable, j: int, key: str) -> int:
    """Number of the joint that a length stands with in the file: a stands with the joint after it in modified
    DH."""
    return j + 1 + (key == "a_m" and arm.first_link is not None)


def _better(gain: float) -> str:
    """How much better the arm explains the poses with a change, as the end of a sentence."""
    if gain < _BETTER:
        return ""
    return f": the arm then explains the poses {f'{gain:.0f} times' if math.isfinite(gain) else 'far'} better"


def _column_in_millimetres(arm: ArmTable, data: Measurements) -> Iterator[Finding]:
    reach = reach_m(arm)
    low, high = np.quantile(data.p_m, [0.1, 0.9], axis=0)
    far = high - low > _FACTOR * reach
    if reach <= 0.0 or not far.any() or far.all():
        return
    if ((high - low) * np.where(far, _MILLIMETRE, 1.0) <= _NEAR * reach).all():
        names = ", ".join(name for name, other in zip(("px", "py", "pz"), far, strict=True) if other)
        yield Finding("millimetres", f"{names} of the measured positions look like millimetres, the others "
                      "like metres", f"divide {names} by 1000")  # fmt: skip


def _columns_in_degrees(arm: ArmTable, data: Measurements) -> Iterator[Finding]:
    """Columns that leave their limits unless they are degrees, where the arm then explains the poses."""
    turning = np.array([not joint.prismatic for joint in arm.joints])
    outside = _outside(arm, data.q).mean(axis=0) >= _MOST_ROWS
    found = turning & outside & (np.abs(data.q).max(axis=0) > _TURNS)
    if not found.any() or (found == turning).all() or data.n < LEAST_POSES:
        return
    read = replace(data, q=data.q * np.where(found, _DEGREE, 1.0), whole=None)
    before, after = misfit(arm, data), misfit(arm, read)
    if not after * _BETTER <= before:
        return
    joints = ", ".join(str(j + 1) for j in np.flatnonzero(found))
    columns = ", ".join(f"q{j + 1}" for j in np.flatnonzero(found))
    yield Finding(
        "degrees",
        f"the readings of joint {joints} seem to be in degrees, the others in radians"
        f"{_better(before / after)}",
        f"multiply {columns} by pi/180: --units is for all columns",
        before / after,
    )
