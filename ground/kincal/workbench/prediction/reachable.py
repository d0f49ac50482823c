"""How much of what a model leaves can be predicted at all from what is recorded.

A black box predicts the residuals: errors at every place of the chain that follow any recorded variable, all
of them at once, and smooth functions of all joint angles together, with a variance each (METHOD.md 18). It is
fitted without the held-out poses, shrunk by cross-validation, and judged on the held-out poses, so that its
figure stands beside their error under the model. A vector-valued process inside the chain needs a fraction of
the poses that a process for each coordinate needs.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field

import numpy as np

from ..data.measurements import Measurements
from ..evidence.unnamed import drivers, locations, oriented
from ..fit.columns import Columns
from ..fit.least_squares import Fit, rms
from ..model.unnamed_names import HEADINGS
from ..numerics.types import Array, Indices, array
from .additive_gp import Components, Fitted, Place

_FIT_ROWS, _SEARCH_ROWS, _HELD_ROWS = 1200, 720, 900  # bound the time on large data
_FOLDS = 3
_MIN_POSES = 20
_NOTHING = 0.98  # cross-validated error ratio from which on nothing is predictable
_RIPPLES = range(3, 31)  # periods a turn
_NUISANCE_WIDTH = 30.0  # standard errors
_SMOOTHNESS = (1.0, 2.0)  # lengths of kernels of all joint angles together [rad]
_PARTS = 5
_MOST_PAIRS = 36  # of joints; kernels of more would not fit into memory


PosRot = tuple[float, float | None]
"""RMS position [m] and rotation [rad], None without rotations."""


@dataclass(frozen=True)
class Reachable:
    """Held-out RMS position [m] and rotation [rad] that a black box reaches after the model.

    shrink: share of its prediction that cross-validation keeps, 0 where nothing is predictable (the figures
    are then those of the model); parts: its largest components as (place, variable), largest first;
    enough: whether the poses are enough to tell; judged: held-out poses that it was judged on;
    model_left, left: (M, c) what the model and the black box leave of them [m, rad].
    """

    pos_m: float
    rot_rad: float | None
    shrink: float
    parts: tuple[tuple[str, str], ...] = ()
    enough: bool = True
    judged: Measurements | None = field(default=None, compare=False, repr=False)
    model_left: Array | None = field(default=None, compare=False, repr=False)
    left: Array | None = field(default=None, compare=False, repr=False)

    def errors_without(self, ids: Collection[str]) -> PosRot:
        """The figures without the poses of these ids."""
        if self.judged is None or self.model_left is None or self.left is None:
            return self.pos_m, self.rot_rad
        usual = self.judged.are_not(ids)
        pairs = zip(rms(self.model_left[usual]), rms(self.left[usual]), strict=True)
        position, rotation = (None if a is None or b is None else min(a, b) for a, b in pairs)
        return self.pos_m if position is None else position, rotation

    @property
    def nothing(self) -> bool:
        """The poses are enough to tell, and nothing that the model leaves follows what is recorded."""
        return self.enough and self.shrink == 0.0


def reachable(fit: Fit, data: Measurements, fitted: Indices, held: Indices) -> Reachable | None:
    """What can be reached on held-out poses beyond a model.

    fit: the model fitted to the poses `fitted` of the data; held: the held-out ones. None if there are none.
    """
    if len(held) == 0:
        return None
    poses = data.take(held)
    r = fit.predict(poses)
    before = rms(r)
    if len(fitted) < _MIN_POSES:
        return Reachable(*before, 0.0, enough=False)
    train = _spread(np.arange(len(fitted)), _FIT_ROWS // data.components)
    unseen = _spread(held, _HELD_ROWS // data.components)
    weight = np.concatenate([fit.weight[train], np.ones(len(unseen))])
    box = _Box.of(fit, data.take(np.concatenate([fitted[train], unseen])), weight, len(train))
    shrink = box.shrink()
    if shrink == 0.0:
        return Reachable(*before, 0.0, judged=poses, model_left=r, left=r)
    return box.judged(before, shrink)


def _spread(poses: Indices, most: int) -> Indices:
    """At most so many of some poses, evenly spread over their order."""
    if len(poses) <= most:
        return poses
    return poses[np.linspace(0, len(poses) - 1, most).round().astype(np.intp)]


@dataclass(frozen=True)
class _Box:
    """The process at the poses to fit, `train`, and those to unseen by, `held`; at: the model there."""

    at: Fit
    process: Components
    train: Indices
    held: Indices

    @classmethod
    def of(cls, fit: Fit, data: Measurements, weight: Array, n_train: int) -> _Box:
        """The process at the poses of `data` with their weights; the first `n_train` are to fit."""
        at = fit.at(data)
        places = np.arange(data.n)
        return cls(at, _process(at, weight, fit), places[:n_train], places[n_train:])

    def shrink(self) -> float:
        """The share of the prediction that predicts best, by cross-validation with everything fitted anew;
        0 if that does not predict better than nothing."""
        left, found = (np.concatenate(x) for x in zip(*self._folds(), strict=True))
        share = float(np.clip((left @ found) / max(float(found @ found), 1e-300), 0.0, 1.0))
        ratio = np.linalg.norm(left - share * found) / max(float(np.linalg.norm(left)), 1e-300)
        return share if ratio < _NOTHING else 0.0

    def _folds(self) -> Iterator[tuple[Array, Array]]:
        """Of each fold: what the model without it leaves there, and what the process predicts of that."""
        search = self._search
        for k in range(_FOLDS):
            out = search[k::_FOLDS]
            rest = np.setdiff1d(search, out)
            model = self.process.nuisance_alone(rest, out)
            found = self.process.predict(self.process.fit(rest), out)
            yield self.process.y[self.process.rows(out)] - model, found - model

    @property
    def _search(self) -> Indices:
        """Poses that variances are fitted to."""
        return _spread(self.train, _SEARCH_ROWS // self.process.c)

    def judged(self, before: tuple[float, float | None], share: float) -> Reachable:
        """The error on the held-out poses, never above `before`, which is that of all of them."""
        fitted = self.process.fit(self.train, self.process.fit(self._search).variances)
        rows = self.process.predict(fitted, self.held).reshape(-1, len(self.held)).T
        found = np.linalg.solve(self.at.whiten[self.held], rows[:, :, None])[:, :, 0]
        left = self.at.evaluation.r[self.held]
        rest = left - share * found
        old, new = rms(left), rms(rest)
        ratios = [b / a for a, b in zip(old, new, strict=True) if a is not None and b is not None]
        position, *rotation = (x * min(r, 1.0) for x, r in zip(_numbers(before), ratios, strict=True))
        parts = tuple(_largest(self.process, fitted))
        return Reachable(
            position, rotation[0] if rotation else None, share, parts,
            judged=self.at.data.take(self.held), model_left=left, left=rest,
        )  # fmt: skip


def _numbers(pair: tuple[float, float | None]) -> list[float]:
    return [x for x in pair if x is not None]


def _largest(process: Components, fitted: Fitted) -> Iterator[tuple[str, str]]:
    """Place and variable of the largest components."""
    variance = fitted.variances.component
    for k in np.argsort(-variance)[:_PARTS]:
        if variance[k] > 0:
            place, _, variable = process.names[k].partition(" | ")
            yield place, variable


# ---------------------------------------------------------------------------------------- the process


def _process(at: Fit, weight: Array, fit: Fit) -> Components:
    """All components at the poses of `at`; fit: the model that says how sure its coefficients are."""
    columns = Columns(at, weight)
    sigma = np.minimum(fit.sigma_prior, _NUISANCE_WIDTH * fit.std_err)
    k = at.evaluation.J.shape[2]
    places = [place for place in _places(columns) if place.rows.any()]
    return Components(
        c=columns.c,
        y=columns.weighted(np.einsum("nij,nj->ni", at.whiten, at.evaluation.r).ravel()),
        nuisance=columns.weighted((at.whiten @ at.evaluation.J).reshape(-1, k)) * sigma,
        places=tuple(place.made for place in places),
        names=tuple(name for place in places for name in place.names),
    )


@dataclass(frozen=True)
class _Kernels:
    """Kernels (k, N, N) of many variables, with their names."""

    names: tuple[str, ...]
    stack: Array

    @classmethod
    def of(cls, kernels: dict[str, Array], n: int) -> _Kernels:
        """Kernels (N, N) by name."""
        return cls(tuple(kernels), np.array(list(kernels.values())).reshape(-1, n, n))


@dataclass(frozen=True)
class _Functions:
    """A place, rows (N, m, c), and what errors there may follow: features (N, k) of one driver each, by its
    name, and kernels."""

    name: str
    rows: Array
    features: dict[str, Array]
    kernels: _Kernels

    @property
    def names(self) -> list[str]:
        """Of the components, in their order."""
        return [f"{self.name} | {variable}" for variable in (*self.features, *self.kernels.names)]

    @property
    def made(self) -> Place:
        """The place of the process; each component is scaled so that the variances of its rows have the mean
        1."""
        n, m, c = self.rows.shape
        rows = self.rows / np.sqrt((self.rows**2).sum() / (n * c))
        weight = (rows**2).sum(axis=(1, 2)) / c
        features = [x / np.sqrt((weight @ x**2).sum() / n) for x in self.features.values()]
        return Place(
            rows.transpose(0, 2, 1).reshape(n * c, m),
            np.hstack([np.zeros((n, 0)), *features]),
            np.repeat(np.arange(len(features)), [x.shape[1] for x in features]),
            self.kernels.stack,
        )


def _places(columns: Columns) -> Iterator[_Functions]:
    """The map's cells of one driver that a pose has by itself, and at joints waves and smooth functions of
    two angles; then smooth functions of many variables: errors of all joints, of the base and of the tool."""
    singles = {driver.name: driver.features for driver in drivers(columns) if not driver.is_move}
    none, pairs, many = (
        _Kernels.of(kernels, columns.n) for kernels in ({}, _pair_kernels(columns), _kernels(columns))
    )
    places = {place.name: place for place in locations(columns)}
    by_orientation = {place.name: (place, by) for place, by in oriented(columns)}
    for place in (places | {name: place for name, (place, _) in by_orientation.items()}).values():
        seen = (place.rows**2).sum(axis=(1, 2))
        _, by = by_orientation.get(place.name, (place, []))
        # waves over headings are many, and on real arms they made the prediction worse
        seen_by = {d.name: d.features for d in by if d.name not in HEADINGS}
        may_follow = (singles if place.name in places else {}) | seen_by
        features = {name: x for name, x in may_follow.items() if (seen @ x**2).any()}
        if place.name.startswith("joint"):
            waves = _ripples(columns, int(place.name.split()[1]))
            yield _Functions(place.name, place.rows, features | waves, pairs)
        else:
            yield _Functions(place.name, place.rows, features, none)
    n, size = columns.fit.arm.n, 3 if columns.c == 3 else 6
    yield _Functions("all joints", columns.twist[:, :n, 5, :], {}, many)
    yield _Functions("base", columns.twist[:, 0, :size, :], {}, many)
    yield _Functions("tool", columns.twist[:, n + 1, :size, :], {}, many)


def _ripples(columns: Columns, joint: int) -> dict[str, Array]:
    """Features (N, 2) of waves of k periods a turn of a revolute joint, too fast for the map's kernels."""
    if columns.fit.arm.joints[joint - 1].prismatic:
        return {}
    q = columns.fit.data.q[:, joint - 1, None]
    return {f"ripple of {k} periods": np.hstack([np.cos(k * q), np.sin(k * q)]) for k in _RIPPLES}


def _kernels(columns: Columns) -> dict[str, Array]:
    """(N, N) kernels of many variables by name: all joint angles, tool position, approach directions."""
    data = columns.fit.data
    turn = _turns(columns)
    expected = data.p_m - columns.fit.evaluation.r[:, :3]
    distance = ((expected[:, None] - expected[None]) ** 2).sum(axis=-1)
    out = {f"all q within {a:g} rad": np.exp(-0.5 * turn.sum(axis=-1) / a**2) for a in _SMOOTHNESS}
    out["tool position"] = np.exp(-0.5 * distance / max(float(expected.var()), 1e-12))
    if data.direction is not None and np.any(data.direction):
        same = data.direction[:, None] * data.direction[None]
        out["approach direction x q"] = (same * np.exp(-0.5 * turn)).mean(axis=-1)
    return out


def _pair_kernels(columns: Columns) -> dict[str, Array]:
    """(N, N) kernels of two joint angles at once, by name."""
    turn = _turns(columns)
    pairs = list(itertools.combinations(np.flatnonzero(turn.any(axis=(0, 1))), 2))
    if len(pairs) > _MOST_PAIRS:
        return {}
    return {f"q{a + 1} x q{b + 1}": np.exp(-0.5 * (turn[..., a] + turn[..., b])) for a, b in pairs}


def _turns(columns: Columns) -> Array:
    """(N, N, n) squared distances of joint readings: chords of angles, slides in standard deviations."""
    q = columns.fit.data.q
    slides = np.array([joint.prismatic for joint in columns.fit.arm.joints])
    distance = q[:, None] - q[None]
    spread = np.maximum(q.std(axis=0), 1e-9)
    return array(np.where(slides, (distance / spread) ** 2, 4.0 * np.sin(0.5 * distance) ** 2))
