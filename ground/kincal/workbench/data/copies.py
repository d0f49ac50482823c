"""Rows that are the same measurement written twice: to the last digit, or with fewer digits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import KDTree

from ..numerics.types import Array, Indices, Mask
from .measurements import SAME_POSE, Measurements

_MEASURED = ("direction", "q", "p_m", "quat_wxyz", "payload_kg", "temp_c")  # equal in copies of a row
_FEWEST, _MOST = 3, 9  # decimals [rad, m] that rows are looked at with
_COARSE = 4  # decimals up to which replicates may be equal
_BEYOND_CHANCE = 5  # decimals from which on no replicate agrees with a rounded row in all its numbers
_NEARLY_ALL = 0.9  # share of the rows of fewer decimals that have a finer one near
_LEAST_SHARE = 0.2  # of all rows; single ones end in zeros by chance


def without_copies(data: Measurements) -> Measurements:
    """The poses without rows that repeat another one to the last bit or are another one with fewer digits:
    noise makes replicates differ, so these are the same measurement written twice."""
    same = _repeated(data)
    once = data.take(np.flatnonzero(~same)) if same.any() else data
    coarse = _rounded(once)
    if not same.any() and not coarse.any():
        return data
    return replace(
        once.take(np.flatnonzero(~coarse)),
        duplicates=data.duplicates + int(same.sum() + coarse.sum()),
        rounded=data.rounded + int(coarse.sum()),
        whole=None,
    )


def _repeated(data: Measurements) -> Mask:
    """(N,) rows that an earlier one equals to the last bit."""
    names = _MEASURED[data.direction_source == "inferred" :]
    parts = [x for name in names if (x := getattr(data, name)) is not None]
    if not data.order_is_time and data.t_s is not None and _decimals(_numbers(data)).max() <= _COARSE:
        parts.append(data.t_s)  # measured anew, by a device that does not resolve its noise
    rows = np.ascontiguousarray(np.column_stack(parts)) + 0.0  # no negative zeros
    _, first = np.unique(rows.view(np.dtype((np.void, rows.strides[0]))), return_index=True)
    return ~np.isin(np.arange(data.n), first)


def _rounded(data: Measurements) -> Mask:
    """(N,) rows that another one gives when it is rounded to their decimals. With few decimals replicates do
    so too: there nearly all rows have to."""
    x = _numbers(data)
    places = _decimals(x)
    found = np.zeros(data.n, dtype=bool)
    if places.min() == places.max():
        return found
    pairs = KDTree(x).query_pairs(SAME_POSE, p=np.inf, output_type="ndarray")
    coarse, fine = _by_decimals(pairs, places)
    agrees = (np.abs(x[coarse] - x[fine]) <= 0.5001 * 10.0 ** -places[coarse, None]).all(axis=1)
    for count in np.unique(places[coarse]):
        mine = places[coarse] == count
        rows = np.unique(coarse[mine & agrees])
        nearly_all = len(rows) >= max(_NEARLY_ALL * len(np.unique(coarse[mine])), _LEAST_SHARE * data.n)
        if count >= _BEYOND_CHANCE or nearly_all:
            found[rows] = True
    return found


def _numbers(data: Measurements) -> Array:
    """(N, n + 3) readings and positions."""
    return np.column_stack([data.q, data.p_m])


def _decimals(x: Array) -> Array:
    """(N,) decimals that all numbers of a row are written with."""
    places = np.full(len(x), float(_MOST))
    for count in range(_MOST - 1, _FEWEST - 1, -1):
        scaled = x * 10.0**count
        places[(np.abs(scaled - np.round(scaled)) < 1e-5).all(axis=1)] = count
    return places


def _by_decimals(pairs: Indices, places: Array) -> tuple[Indices, Indices]:
    """Pairs of rows (M, 2) with different decimals as the rows with fewer and with more."""
    pairs = pairs[places[pairs[:, 0]] != places[pairs[:, 1]]]
    swap = places[pairs[:, 0]] > places[pairs[:, 1]]
    pairs[swap] = pairs[swap][:, ::-1]
    return pairs[:, 0], pairs[:, 1]
