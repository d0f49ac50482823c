"""Constants of effects: those that follow from the data, and grids of those that are searched."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from ..data.measurements import Measurements
from ..numerics.types import Array, array

Grid = Sequence[float] | Literal["times", "durations", "periods"]
"""Values of a constant: a list, or times of a step [s], fractions of the time span [s], periods per turn."""

# Joints turn by 3 to 6 rad, so that half a period per turn more or less still looks alike.
PERIODS = array(np.arange(3.0, 30.25, 0.5))
_EACH_SIDE = 3  # poses before a step, and after it
_STEPS = 16  # times of a step that are tried first
_BREAK = 5.0  # usual intervals between poses: a longer one is a break of the session
_MOST_BREAKS = 6
_FINER = 9  # values of a closer search
_REFERENCE_C = 20.0
_SESSION_S = 3600.0  # where there are no times


def data_constants(data: Measurements | None) -> dict[str, float]:
    """Reference temperature [deg C], begin and length of the session [s], which bases may use as $T0, $tstart
    and $tspan."""
    if data is None:
        return {"T0": _REFERENCE_C, "tstart": 0.0, "tspan": _SESSION_S}
    return {
        "T0": float(np.mean(data.temp_c)) if data.temp_c is not None else _REFERENCE_C,
        "tstart": float(np.min(data.t_s)) if data.t_s is not None else 0.0,
        "tspan": float(np.ptp(data.t_s)) or _SESSION_S if data.t_s is not None else _SESSION_S,
    }


def grid_values(grid: Grid, data: Measurements | None) -> list[float]:
    """Values of a constant that are tried first; without data one that stands for all."""
    if grid == "periods":
        return _floats(PERIODS)
    if not isinstance(grid, str):
        return [float(v) for v in grid]
    if data is None or data.t_s is None:
        return [0.0 if grid == "times" else 1.0]
    return _durations(data.t_s) if grid == "durations" else _times(data.t_s)


def _durations(t_s: Array) -> list[float]:
    span = float(np.ptp(t_s)) or 1.0
    return [span / 30.0, span / 8.0, span / 2.0]


def grid_weight(grid: Grid, value: float, data: Measurements | None) -> float:
    """Prior weight of a value that is tried, to be scaled: of the times of a step, the breaks of the session
    have one half together."""
    if grid != "times" or data is None or data.t_s is None:
        return 1.0
    breaks = _breaks(data.t_s)
    return _STEPS / len(breaks) if value in breaks else 1.0


def _times(t_s: Array) -> list[float]:
    """A step is placed midway between two measurements, three poses away from either end; in each of the
    longest breaks too: there arms are switched off and things are moved."""
    inner = _inner(t_s)
    tried = inner[np.unique(np.linspace(0, len(inner) - 1, _STEPS).round().astype(int))]
    return _floats(np.union1d(tried, _breaks(t_s)))


def _inner(t_s: Array) -> Array:
    """Times between measurements with enough poses on each side, so that no pose alone supports a step; all
    of them where there are too few poses."""
    middles = _between(t_s)
    before = np.searchsorted(np.sort(t_s), middles)
    enough = np.minimum(before, len(t_s) - before) >= _EACH_SIDE
    return array(middles[enough]) if enough.any() else middles


def _breaks(t_s: Array) -> Array:
    """Middles of the longest breaks that are three poses away from either end."""
    gaps = np.diff(np.unique(t_s))
    if not len(gaps):
        return gaps
    longest = np.argsort(-gaps, kind="stable")[:_MOST_BREAKS]
    middles = _between(t_s)[longest[gaps[longest] > _BREAK * np.median(gaps)]]
    return array(np.intersect1d(middles, _inner(t_s)))


def _between(t_s: Array) -> Array:
    """Times midway between two measurements; the one time there is if all were measured at it."""
    t = np.unique(t_s)
    middles: Array = 0.5 * (t[1:] + t[:-1]) if len(t) > 1 else t
    return middles


def finer(grid: Grid, best: float, data: Measurements) -> list[float]:
    """Values around the best one of a grid, closer than its neighbours; empty for a plain list."""
    if grid == "periods":
        return _floats(best + (PERIODS[1] - PERIODS[0]) * np.linspace(-0.8, 0.8, _FINER))
    if grid == "durations":
        return _floats(best * 2.0 ** np.linspace(-1.0, 1.0, _FINER))
    if grid != "times" or data.t_s is None:
        return []
    middles = _inner(data.t_s)
    place = int(np.abs(middles - best).argmin())
    reach = max(1, round(len(middles) / _STEPS))
    return _floats(middles[max(place - reach, 0) : place + reach + 1])


def _floats(values: Array) -> list[float]:
    return [float(v) for v in values]
