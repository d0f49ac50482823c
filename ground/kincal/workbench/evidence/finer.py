"""Functions of a joint's own angle that are smoother or less smooth than the map's, and of time where frames
move.

A bump or a kink in one joint's error, its square or cube, a base that swings some times a session or wanders,
are one function each. The kernels of the map have one length, which suits none of these; sums of named waves,
or of drift, step and settling, would be all that fits them.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ..data.measurements import Measurements
from ..fit.columns import Columns
from ..model.shapes import SWINGS
from ..numerics.types import Array, array
from .unnamed import Cell, Driver, leading_features, locations, rbf, session_driver, unit_variance

_PERIODIC = (0.5, 0.25)  # lengths of kernels of an angle [rad]
_OPEN = 2.0  # of one that knows no turn, in standard deviations: straight lines, squares, cubes
_MOST = 24  # columns
_KEPT, _KEPT_OPEN = 0.999, 0.99999  # of a kernel's variance: a cube is a small part of a smooth one
_WALK = 8  # terms of the series of a random walk
_WALKED = (1.0, 0.2)  # sizes of a walk, in typical ones: the noise leaves the smallest terms of a small walk
_MOVING = ("base translation", "base rotation", "camera translation", "camera rotation")


def finer_cells(columns: Columns) -> list[Cell]:
    """Variants of cells of the map, by the same names."""
    data, arm = columns.fit.data, columns.fit.arm
    angles, session = _drivers(data, tuple(joint.prismatic for joint in arm.joints))
    out: list[Cell] = []
    for place in locations(columns):
        own = [d for d in angles if place.name == f"joint {d.name[1:]}"]
        moving = session if place.name in _MOVING else ()
        out += [Cell(place.name, (d.name,), place.rows, d.features) for d in (*own, *moving)]
    return out


@lru_cache(maxsize=4)
def _drivers(
    data: Measurements, prismatic: tuple[bool, ...]
) -> tuple[tuple[Driver, ...], tuple[Driver, ...]]:
    """Those of joints' angles, and of time; none where nothing varies."""
    angles: list[Driver] = []
    for j, slides in enumerate(prismatic, 1):
        q = data.q[:, j - 1]
        if np.ptp(q) > 1e-9:
            kernels = () if slides else tuple(_periodic(q, length) for length in _PERIODIC)
            features = [leading_features(kernel, _MOST, _KEPT) for kernel in kernels]
            features.append(leading_features(rbf(q, _OPEN), _MOST, _KEPT_OPEN))
            angles += [Driver(f"q{j}", x) for x in features]
    if data.t_s is None or np.ptp(data.t_s) <= 1e-9:
        return tuple(angles), ()
    share = (data.t_s - data.t_s.min()) / np.ptp(data.t_s)
    moves = [*(_wave(share, k) for k in SWINGS), *walks(data)]
    return tuple(angles), tuple(Driver(session_driver(data), x) for x in moves)


def _periodic(q: Array, length: float) -> Array:
    """(N, N) kernel of an angle."""
    return array(np.exp(-2.0 * np.sin(0.5 * (q[:, None] - q[None, :])) ** 2 / length**2))


def _wave(share: Array, periods: float) -> Array:
    """(N, 2) features of so many periods in a session, in any phase; share: (N,) of it that is over."""
    turn = 2.0 * np.pi * periods * share[:, None]
    wave = np.hstack([np.cos(turn), np.sin(turn)])
    return unit_variance(wave - wave.mean(axis=0))


def walks(data: Measurements) -> list[Array]:
    """(N, k) features of random walks in the session, each of another size: of the series of Karhunen and
    Loeve of Brownian motion. Not centred: the base is where it is known to be as the session begins. None
    without times."""
    if data.t_s is None or np.ptp(data.t_s) <= 1e-9:
        return []
    share = (data.t_s - data.t_s.min()) / np.ptp(data.t_s)
    half_turns = np.arange(_WALK) + 0.5
    series = np.sin(np.pi * share[:, None] * half_turns) / half_turns
    return [size * unit_variance(series) for size in _WALKED]
