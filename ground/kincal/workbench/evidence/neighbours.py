"""Is what a fit leaves alike at poses that are near each other? A test for what no driver describes.

Residuals that follow anything smooth are alike at poses that are near in it, whatever the function is. The
test asks for no function, and so finds those that are too fast, or follow too much at once, for the cells of
the map. It says where to look, not what is there.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..model.places import joint_places
from ..model.unnamed_names import SENSOR_AXES, TOOL_AXES
from ..numerics.distributions import chi2_tail
from ..numerics.types import Array, Groups, Indices
from .orientation import axes_of_tool, from_base
from .scoring import Scorer

NEIGHBOURS_P = 1e-3
_DRAWS = 400
_NEAREST = 3  # poses beside each
_LEAST_POSES = 20
_LEAST_SKEW = 0.05  # of the draws: a gamma distribution as good as normal
_JOINTS = "all joints"


@dataclass(frozen=True)
class Alike:
    """What poses that are near each other have in common.

    by: names of what they are near in; at: the motion that is alike; p_value: that it is chance, over
    everything that was tried (Bonferroni); correlation: of the residuals of nearest poses.
    """

    by: tuple[str, ...]
    at: str
    p_value: float
    correlation: float

    @property
    def shown(self) -> bool:
        """It is hardly chance."""
        return self.p_value < NEIGHBOURS_P


@dataclass(frozen=True)
class _View:
    """Motions of a place, and what they may follow. rows: (N, m, c), from whitened residuals; by: coordinates
    (N, d) in which poses are near, by names."""

    at: str
    rows: Array
    by: dict[tuple[str, ...], Array]


def neighbours_alike(scorer: Scorer) -> Alike | None:
    """The most significant likeness of near poses; None where they are too few. Residuals of one sensor frame
    and of the tool's, by everything that says where the tool is; motions of each joint, by its reading and by
    that of one joint more. The distribution of each without any likeness comes from the same residuals, those
    of each pose with a sign that is drawn (wild bootstrap: Liu, Annals of Statistics 16, 1988): noise of any
    shape stays what it is, and what the fit takes, which makes residuals alike too, is taken of the draws."""
    columns = scorer.columns
    poses = _different_poses(columns.fit.data.repeats, columns.n)
    if len(poses) < _LEAST_POSES:
        return None
    signs = np.random.default_rng(2).choice([-1.0, 1.0], size=(columns.n, _DRAWS))
    signed = scorer.projector.apply(np.repeat(signs, columns.c, axis=0) * scorer.wz[:, None])
    drawn = np.hstack([signed, scorer.wz[:, None]])
    z = drawn.reshape(columns.n, columns.c, -1)[poses]
    nearest: dict[tuple[str, ...], Indices] = {}
    found: list[Alike] = []
    for view in _views(scorer):
        motion = np.einsum("nmc,ncd->nmd", view.rows[poses], z)
        square = (motion**2).sum(axis=(0, 1))
        for by, x in view.by.items():
            if by not in nearest:
                nearest[by] = _nearest(x[poses])
            near = np.mean([motion[k] for k in nearest[by]], axis=0)
            alike = (motion * near).sum(axis=(0, 1)) / np.maximum(square, 1e-300)
            found.append(Alike(by, view.at, _tail(alike), float(alike[-1] - alike[:-1].mean())))
    best = min(found, key=lambda one: one.p_value)
    return Alike(best.by, best.at, min(1.0, best.p_value * len(found)), best.correlation)


def _different_poses(repeats: Groups | None, n: int) -> Indices:
    """Indices of one pose of each group of replicates: those have more in common than the place."""
    return np.arange(n) if repeats is None else np.asarray(np.sort(np.unique(repeats, return_index=True)[1]))


def _nearest(x: Array) -> Indices:
    """(3, N) indices of the nearest poses of each."""
    n = len(x)
    # one more: the pose itself, or one at the very same place
    nearest = np.asarray(cKDTree(x).query(x, _NEAREST + 1)[1])
    itself = nearest == np.arange(n)[:, None]
    others = np.take_along_axis(nearest, np.argsort(itself, axis=1, kind="stable")[:, :_NEAREST], axis=1)
    return np.asarray(others.T)


def _tail(drawn: Array) -> float:
    """Probability of more than the last value, under the distribution of those before it: gamma of their
    first three moments (Pearson, type III)."""
    null = drawn[:-1]
    spread = max(float(null.std()), 1e-300)
    skew = max(float(((null - null.mean()) ** 3).mean()) / spread**3, _LEAST_SKEW)
    dof = 8.0 / skew**2
    return float(chi2_tail(dof + 4.0 / skew * (drawn[-1] - null.mean()) / spread, dof))


def _views(scorer: Scorer) -> Iterator[_View]:
    columns = scorer.columns
    fit, n, c = columns.fit, columns.n, columns.c
    readings = _readings(scorer)
    axes, to_sensor = axes_of_tool(columns), from_base(columns)
    expected = fit.data.p_m - fit.evaluation.r[:, :3]
    where: dict[tuple[str, ...], Array] = {
        ("orientation",): axes.reshape(n, 9),
        ("tool position",): expected,
        **({(_JOINTS,): np.hstack(list(readings.values()))} if readings else {}),
        **{(name,): axes[:, :, k] for k, name in enumerate(TOOL_AXES)},
        **{(name,): axes[:, k, :] for k, name in enumerate(SENSOR_AXES)},
    }
    frames = {"sensor": to_sensor, "tool": axes.transpose(0, 2, 1) @ to_sensor}
    for (frame, turn), first in itertools.product(frames.items(), range(0, c, 3)):
        rows = np.zeros((n, 3, c))
        rows[:, :, first : first + 3] = turn
        yield _View(f"{'rotation' if first else 'position'} in the frame of the {frame}", rows, where)
    for place in joint_places(fit.arm):
        own = f"q{place.name.removeprefix('joint ')}"
        if own in readings:
            others = [name for name in readings if name != own]
            pairs = {tuple(sorted((own, b))): np.hstack([readings[own], readings[b]]) for b in others}
            rows = columns.location(place.frame, place.components)
            yield _View(place.name, rows, {(own,): readings[own], **pairs})


def _readings(scorer: Scorer) -> dict[str, Array]:
    """(N, 2) points on the circle of each revolute joint that moves, (N, 1) slides in units of spread."""
    fit = scorer.columns.fit
    out = {}
    for k, (q, joint) in enumerate(zip(fit.data.q.T, fit.arm.joints, strict=True), 1):
        if q.std() > 1e-3:
            slide = q[:, None] / q.std()
            out[f"q{k}"] = slide if joint.prismatic else np.column_stack([np.cos(q), np.sin(q)])
    return out
