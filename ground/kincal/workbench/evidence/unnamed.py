"""The map of the unnamed: where an error enters x what it depends on, scored like named effects.

A cell is a Gaussian process embedded in the chain: at its location (a joint axis, the base, the camera,
the tool ...) an error that is a smooth unknown function of its driver (a joint angle, a torque, time
...), or of two drivers at once. The leading eigenvectors of the driver's kernel are its columns
(METHOD.md 14), so the evidence of a cell and that of a named effect are on one scale.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import lapack

from kincal.flight import FRAME_CAMERA, FRAME_MEAS
from kincal.rotations import matrix_of_wxyz
from kincal_shared.schema.terms import Basis

from ..data.measurements import Measurements
from ..fit.columns import Columns
from ..model.places import TYPICAL_SIZE, ErrorPlace, joint_places, other_places
from ..model.unnamed_names import GRAVITY, HEADINGS, ORIENTATION, TOOL_AXES, TOOL_MOVE
from ..numerics.types import Array, array
from .bayes_factors import Moments
from .lag import last_move_of_tool
from .orientation import orientation_features
from .products import ScoredProduct

_SINGLE = 5  # eigenvectors of one driver
_DOUBLE = 12  # of two drivers together
_MAX_INCIDENCE_MISFIT = 0.15  # of the cosine: the tag sits beside the tool point
_MIN_INCIDENCE_POSES = 6
_MIN_IMAGE_SPREAD = 0.01  # of normalised image position: about 14 px
_LEAST_EIGENVALUE = 1e-6  # of the largest one
_SHIFTS, _TURNS = (0, 1, 2), (3, 4, 5)
_MEASURED, MEASURED_POSE = "measured orientation", "measured pose"
_SEEN = (ORIENTATION, *TOOL_AXES, *HEADINGS)
# What may follow the orientation of the tool: errors of the sensor follow it as the sensor sees it, a tool or
# a target that bends follows gravity.
_ORIENTED = {
    "base translation": (*_SEEN, GRAVITY),
    "camera translation": _SEEN,
    "range": _SEEN,
    _MEASURED: _SEEN,
    "tool rotation": (GRAVITY, *HEADINGS),
    "tool translation": (GRAVITY, *HEADINGS),
}


@dataclass(frozen=True)
class Location:
    """Where an error enters; rows: (N, m, c) twist rows, scaled to the error's typical size."""

    name: str
    rows: Array


@dataclass(frozen=True)
class Driver:
    """What an error depends on; features: (N, k) of a centred kernel, scaled to unit mean variance."""

    name: str
    features: Array

    @property
    def is_move(self) -> bool:
        """A joint's last move, which a pose has only after another one."""
        return self.name.startswith("move")

    def acts_at(self, location: str) -> bool:
        """Whether an error at a location may follow it: how far joints moved tells of joints that are not at
        rest, and of nothing else."""
        return location.startswith("joint") or not self.is_move


@dataclass(frozen=True)
class Cell:
    """An unknown function of one or two drivers at a location.

    rows: (N, m, c) of the location; features: (N, k) of the drivers; product: of the dictionary
    (products.py): then the function is this one, and there is one column.
    """

    location: str
    drivers: tuple[str, ...]
    rows: Array
    features: Array
    product: ScoredProduct | None = None

    @property
    def width(self) -> int:
        """Number of columns, m k."""
        return int(self.rows.shape[1] * self.features.shape[1])

    @property
    def columns(self) -> Array:
        """(N c, m k) whitened; made when asked for, since all cells of all fits fill gigabytes. Scores do
        without them: `cell_moments`."""
        n, m, c = self.rows.shape
        k = self.features.shape[1]
        columns = self.rows.transpose(1, 0, 2)[:, None] * self.features.T[None, :, :, None]
        return array(columns.reshape(m * k, n * c).T)

    @property
    def at_joint(self) -> bool:
        """The error is a motion of a joint."""
        return self.location.startswith("joint")

    @property
    def name(self) -> str:
        """Location and drivers, for instance "joint 3 | q4 x q5"."""
        text = " x ".join(self.drivers) if self.product is None else self.product.text
        return f"{self.location} | {text}"


def cells(columns: Columns, *, double: bool = True) -> list[Cell]:
    """All cells. Cells of two drivers are only made at joints (elsewhere they cannot be distinguished)."""
    places, singles = locations(columns), drivers(columns)
    joints = [place for place in places if place.name.startswith("joint")]
    out = [_cell(place, driver) for place in places for driver in singles if driver.acts_at(place.name)]
    out += [_cell(place, driver) for place, by in (*oriented(columns), *lagging(columns)) for driver in by]
    if double:
        out += [_cell(place, driver) for driver in _pairs(columns) for place in joints]
    return out


def _cell(location: Location, driver: Driver) -> Cell:
    return Cell(location.name, tuple(driver.name.split(" x ")), location.rows, driver.features)


def cell_moments(made: Sequence[Cell], columns: Array) -> Iterator[Moments]:
    """Moments of cells with columns (rows, d), without making theirs: all functions at a location see the
    columns through its rows."""
    together: dict[tuple[int, int], list[int]] = {}
    for k, cell in enumerate(made):
        together.setdefault((id(cell.rows), cell.features.shape[1]), []).append(k)
    for places in together.values():
        features = np.stack([made[k].features.T for k in places])
        yield Moments(places, *_moments_at(made[places[0]].rows, features, columns))


def _moments_at(rows: Array, features: Array, columns: Array) -> tuple[Array, Array]:
    """(D, m k, m k) and (D, m k, d) of cells at one location, rows (N, m, c), with features (D, k, N)."""
    (n, m, c), (count, k, _) = rows.shape, features.shape
    seen = (rows @ columns.reshape(n, c, -1)).reshape(n, -1)
    cross = (features.reshape(-1, n) @ seen).reshape(count, k, m, -1).transpose(0, 2, 1, 3)
    pairs = (rows @ rows.transpose(0, 2, 1)).reshape(n, m * m).T
    own = (features[:, None] * pairs[:, None, :]) @ features.transpose(0, 2, 1)[:, None]
    own = own.reshape(count, m, m, k, k).transpose(0, 1, 3, 2, 4)
    return own.reshape(count, m * k, m * k), cross.reshape(count, m * k, -1)


# ----------------------------------------------------------------------------------------- locations


def locations(columns: Columns) -> list[Location]:
    """Joint axes, off-axis joint motions, base, tool, and the camera side when the data have it."""
    fit = columns.fit
    camera = fit.data.has("cam")
    out = [_rows(place, columns) for place in joint_places(fit.arm)]
    out += [_range(columns)] if camera else []
    out += [Location("tag tilt", TYPICAL_SIZE * tilt) for tilt in _tag_tilt(columns)]
    out += [_rows(place, columns) for place in other_places(fit.arm, camera)]
    return [location for location in out if np.abs(location.rows).max() > 0]


def _rows(place: ErrorPlace, columns: Columns) -> Location:
    return Location(place.name, TYPICAL_SIZE * columns.location(place.frame, place.components))


def oriented(columns: Columns) -> list[tuple[Location, list[Driver]]]:
    """Locations with the drivers of the tool's orientation that an error there may follow."""
    made = {name: Driver(name, unit_variance(x)) for name, x in orientation_features(columns)}
    measured = [_measured(columns)] if columns.c == 6 else []
    places = [place for place in (*locations(columns), *measured) if place.name in _ORIENTED]
    return [(place, [made[name] for name in _ORIENTED[place.name] if name in made]) for place in places]


def lagging(columns: Columns) -> list[tuple[Location, list[Driver]]]:
    """The measured pose, moved back along the last move of the tool, as by a sensor that lags: by a share of
    its length, and of its turn. None where the order of the data tells no moves."""
    move = last_move_of_tool(columns.fit)
    if move is None:
        return []
    rows = np.stack([_along(columns, move, part) for part in range(columns.c // 3)], axis=1)
    return [(Location(MEASURED_POSE, rows), [Driver(TOOL_MOVE, np.ones((columns.n, 1)))])]


def _along(columns: Columns, move: Array, part: int) -> Array:
    """(N, c) of the positions (part 0) or the rotations (1) of moves (N, 6), scaled to unit mean square."""
    own = slice(3 * part, 3 * part + 3)
    size = np.sqrt((move[:, own] ** 2).sum(axis=1).mean())
    rows = np.einsum("nij,nj->ni", columns.fit.whiten[:, :, own], move[:, own] / max(size, 1e-9))
    return TYPICAL_SIZE * columns.weighted(rows.ravel()).reshape(rows.shape)


def _measured(columns: Columns) -> Location:
    """A turn of the measured orientation, about axes of the sensor, that leaves the position as it is: no
    frame of the chain does that."""
    camera = columns.fit.data.cam_quat_wxyz
    turns = columns.fit.whiten[:, :, 3:]
    if camera is not None:
        turns = turns @ matrix_of_wxyz(camera)
    rows = columns.weighted(turns.reshape(-1, 3)).reshape(columns.n, columns.c, 3)
    return Location(_MEASURED, TYPICAL_SIZE * rows.transpose(0, 2, 1))


def _range(columns: Columns) -> Location:
    """A shift along the line of sight."""
    seen = np.stack([columns.basis(Basis("lin", v, 0)) for v in ("xcam", "ycam", "zcam")], axis=1)
    ray = seen / np.maximum(np.linalg.norm(seen, axis=1, keepdims=True), 1e-9)
    rows = columns.location(FRAME_CAMERA, _SHIFTS)
    return Location("range", TYPICAL_SIZE * np.einsum("nm,nmc->nc", ray, rows)[:, None, :])


def _tag_tilt(columns: Columns) -> Iterator[Array]:
    """(N, 1, c) rows of a turn of the seen tag toward the camera: what a bias of the slant does."""
    data = columns.fit.data
    if data.incid_rad is None or data.quat_wxyz is None or data.cam_p_m is None:
        return
    ray = data.p_m - data.cam_p_m
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    ray_tool = np.einsum("nji,nj->ni", matrix_of_wxyz(data.quat_wxyz), ray)
    axis = np.cross(_tag_normals(data, data.incid_rad, ray_tool), ray_tool)
    yield np.einsum("nm,nmc->nc", axis, columns.location(FRAME_MEAS, _TURNS))[:, None, :]


def _tag_normals(data: Measurements, incid_rad: Array, ray_tool: Array) -> Array:
    """(N, 3) normals of the tags in the tool frame. They are not in the arm table; the recorded incidence
    angles tell them, tag by tag; 0 where they do not."""
    tag = data.tag if data.tag is not None else np.zeros(data.n)
    normal = np.zeros((data.n, 3))
    for which in np.unique(tag):
        mine = tag == which
        if mine.sum() < _MIN_INCIDENCE_POSES:
            continue
        found, *_ = np.linalg.lstsq(ray_tool[mine], np.cos(incid_rad[mine]), rcond=None)
        if np.abs(ray_tool[mine] @ found - np.cos(incid_rad[mine])).max() < _MAX_INCIDENCE_MISFIT:
            normal[mine] = found / np.linalg.norm(found)
    return normal


# ------------------------------------------------------------------------------------------- drivers


def drivers(columns: Columns) -> list[Driver]:
    """Everything the data record that an error could follow, and what the model adds to that (torques,
    where the tool is)."""
    data, arm = columns.fit.data, columns.fit.arm
    recorded = _recorded(data, tuple(joint.prismatic for joint in arm.joints))
    modelled = {name: _features(rbf(x, length)) for name, x, length in _modelled(columns)}
    found = {**modelled, **recorded}
    return [Driver(name, found[name]) for name in _order(found, arm.n) if found[name].shape[1]]


def _order(found: Mapping[str, Array], joints: int) -> list[str]:
    """Names in the order of the map's columns."""
    per_joint = [f"{kind}{j}" for kind in ("q", "tau", "dir", "move", "qdot") for j in range(1, joints + 1)]
    single = ["t", "temp", "payload", "tag", "zcam", "u", "v", "r2", "sx", "sy", "sz", "incid", "pan",
              "tilt", "order"]  # fmt: skip
    return [name for name in (*per_joint, *single) if name in found]


@lru_cache(maxsize=4)
def _recorded(data: Measurements, prismatic: tuple[bool, ...]) -> dict[str, Array]:
    """Features (N, k) of the drivers that are columns of the data; they are the same at every fit."""
    out = {
        f"q{j}": _features(_angle_kernel(data.q[:, j - 1], slides)) for j, slides in enumerate(prismatic, 1)
    }
    for label, values in (("dir", data.direction), ("move", data.move), ("qdot", data.qdot)):
        if values is not None:
            out |= {f"{label}{j}": _linear(values[:, j - 1]) for j in range(1, len(prismatic) + 1)}
    scalars = {"temp": data.temp_c, "payload": data.payload_kg, "tag": data.tag, "incid": data.incid_rad,
               "pan": data.pan_rad, "tilt": data.tilt_rad}  # fmt: skip
    out |= {name: _smooth(x) for name, x in scalars.items() if x is not None}
    if data.t_s is not None:
        out[session_driver(data)] = _smooth(data.t_s, 0.5)
    return out


def session_driver(data: Measurements) -> str:
    """Name of the driver that is time, or the order of the rows that stands for it."""
    return "order" if data.order_is_time else "t"


def _modelled(columns: Columns) -> Iterator[tuple[str, Array, float]]:
    """(name, (N,) values, kernel length) of the drivers that the model computes: gravity torques, and
    where it expects the tool. The measured position carries the very noise of the residual and would seem
    to explain it."""
    data = columns.fit.data
    for j, tau in columns.torques().items():
        yield f"tau{j}", tau, 1.5
    expected = data.p_m - columns.fit.evaluation.r[:, :3]
    places = zip(("sx", "sy", "sz"), expected.T, strict=True)
    for name, x in _image(data, expected) if data.has("cam") else places:
        if x.std() > 1e-9:
            yield name, x, 1.0


def _image(data: Measurements, expected: Array) -> Iterator[tuple[str, Array]]:
    """Depth and normalised image position of the tool at its expected positions (N, 3)."""
    assert data.cam_p_m is not None
    assert data.cam_quat_wxyz is not None
    x, y, z = np.einsum("nji,nj->in", matrix_of_wxyz(data.cam_quat_wxyz), expected - data.cam_p_m)
    z = np.maximum(z, 1e-6)
    u, v = x / z, y / z
    yield "zcam", z
    # a camera that always aims at the tag leaves no image position to depend on
    if max(u.std(), v.std()) > _MIN_IMAGE_SPREAD:
        yield from (("u", u), ("v", v), ("r2", u**2 + v**2))


def _pairs(columns: Columns) -> tuple[Driver, ...]:
    """Two drivers at once: joint angle x joint angle, and joint angle x everything slow."""
    fit = columns.fit
    return _recorded_pairs(fit.data, tuple(joint.prismatic for joint in fit.arm.joints))


@lru_cache(maxsize=4)
def _recorded_pairs(data: Measurements, prismatic: tuple[bool, ...]) -> tuple[Driver, ...]:
    found = {name: x for name, x in _recorded(data, prismatic).items() if x.shape[1]}
    angles = [name for name in found if name[0] == "q" and name[1:].isdigit()]
    slow = [name for name in ("temp", "t", "payload", "pan", "tilt") if name in found]
    wanted: Iterable[tuple[str, str]] = (
        *itertools.combinations(angles, 2),
        *itertools.product(angles, slow),
    )
    return tuple(Driver(f"{a} x {b}", _product(found[a], found[b])) for a, b in wanted)


def _product(a: Array, b: Array) -> Array:
    """(N, k) features of the kernel (1 + k_a)(1 + k_b) - 1, compressed by SVD."""
    both = np.einsum("ni,nj->nij", a, b).reshape(len(a), -1)
    u, s, _ = np.linalg.svd(np.hstack([a, b, both - both.mean(axis=0)]), full_matrices=False)
    return unit_variance(u[:, :_DOUBLE] * s[:_DOUBLE])


# ------------------------------------------------------------------------------------------- kernels


def _angle_kernel(q: Array, slides: bool) -> Array:
    """(N, N) kernel of a joint's motion: periodic in an angle [rad], squared exponential in a slide [m]."""
    if slides:
        return rbf(q)
    kernel: Array = np.exp(-2.0 * np.sin(0.5 * (q[:, None] - q[None, :])) ** 2)
    return kernel


def rbf(x: Array, length: float = 1.0) -> Array:
    """(N, N) squared exponential kernel; length: in standard deviations of x."""
    spread = x.std()
    z = (x - x.mean()) / (spread if spread > 0 else 1.0)
    kernel: Array = np.exp(-0.5 * ((z[:, None] - z[None, :]) / length) ** 2)
    return kernel


def _smooth(x: Array, length: float = 1.0) -> Array:
    """Features of a smooth function of x (N,); none where x does not vary."""
    return _features(rbf(x, length)) if x.std() > 1e-9 else np.zeros((len(x), 0))


def _linear(x: Array) -> Array:
    """The one feature of the kernel x x': x itself, centred; none where x does not vary."""
    return unit_variance((x - x.mean())[:, None]) if x.std() > 0 else np.zeros((len(x), 0))


def _features(kernel: Array) -> Array:
    """The few features of a map cell."""
    return leading_features(kernel, _SINGLE)


def leading_features(kernel: Array, most: int, share: float = 1.0) -> Array:
    """(N, k) leading eigenvectors of a centred kernel (N, N) times the roots of their eigenvalues, `most` of
    them, or those that have a share of the variance together.

    Smooth kernels have a rank of some twenty to rounding, which a pivoted Cholesky factor shows: the vectors
    are those of that factor."""
    factor, pivots, rank, _ = lapack.dpstrf(kernel, lower=1)
    lower = np.zeros((len(kernel), rank))
    lower[pivots - 1] = np.tril(factor[:, :rank])
    vectors, roots, _ = np.linalg.svd(lower - lower.mean(axis=0), full_matrices=False)
    variance = roots**2
    good = variance[:most] > _LEAST_EIGENVALUE * max(variance.max(initial=0.0), 1e-12)
    good &= (np.cumsum(variance) - variance)[:most] <= share * variance.sum()
    if not good.any():
        return np.zeros((len(kernel), 0))
    return unit_variance((vectors * roots)[:, :most][:, good])


def unit_variance(features: Array) -> Array:
    """Features (N, k) scaled so that the variances of the poses have the mean 1."""
    scaled: Array = features / np.sqrt((features**2).sum(axis=1).mean())
    return scaled
