"""Where a pose can be measured: learned from the poses that were, and from boxes that people give."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from kincal.flight import Arm
from kincal.rotations import Pose, matrix_of_wxyz
from kincal_shared.errors import BadInput

from ..data.measurements import Measurements
from ..fit.least_squares import Fit
from ..model.flight_model import observations
from ..numerics.types import Array, Mask

_MARGIN_M = 2e-3  # beyond the hull of the measured positions
_MARGIN_COSINE = 0.02  # beyond the cone of the measured directions of the tool
BOX_TEXT = "write x0,y0,z0,x1,y1,z1 in metres"
_ALONG = 12  # points of each link that are kept out of boxes


@dataclass(frozen=True)
class Box:
    """An upright box of the measurement frame; low, high: (3,) corners [m]."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]

    @classmethod
    def of(cls, numbers: Sequence[float]) -> Box:
        """From x0, y0, z0, x1, y1, z1, opposite corners in any order. BadInput for another number of them."""
        if len(numbers) != 6 or not np.isfinite(numbers).all():
            raise BadInput(f"a box has six numbers, not {len(numbers)}", todo=BOX_TEXT)
        corners = np.sort(np.reshape(numbers, (2, 3)), axis=0).tolist()
        return cls(tuple(corners[0]), tuple(corners[1]))

    def holds(self, p_m: Array) -> Mask:
        """Whether points (..., 3) lie inside: (...)."""
        low, high = np.array(self.low), np.array(self.high)
        return np.asarray(np.all((p_m >= low) & (p_m <= high), axis=-1), dtype=np.bool_)


@dataclass(frozen=True)
class Limits:
    """What people say about where poses may be. inside: the tool point has to lie in one of these boxes
    (none: in the hull of the measured ones); outside: no part of the arm may lie in one of these; possible:
    joint vectors (N, n) to (N,), for instance a test with collision shapes."""

    inside: tuple[Box, ...] = ()
    outside: tuple[Box, ...] = ()
    possible: Callable[[Array], Mask] | None = None


@dataclass(frozen=True)
class Measurable:
    """The region about the measured poses of a fit.

    faces: (k, 4) half spaces whose common part holds the measured tool positions; axes: (3, 3) mean direction
    of each axis of the tool, cones: (3,) least cosine with it; view: (2, 3) least and largest image position
    and depth (u, v, z) of the tool, None without camera columns.
    """

    fit: Fit
    limits: Limits
    faces: Array
    axes: Array
    cones: Array
    view: Array | None

    @classmethod
    def of(cls, fit: Fit, limits: Limits) -> Measurable:
        """Learned from the poses of a fit."""
        tool = tool_poses(fit, fit.data)
        axes = tool.R.mean(axis=0).T
        axes /= np.maximum(np.linalg.norm(axes, axis=1, keepdims=True), 1e-9)
        cones = _cosines(tool, axes).min(axis=0) - _MARGIN_COSINE
        seen = _seen(fit.data, tool.p_m)
        view = None if seen is None else np.stack([seen.min(axis=0), seen.max(axis=0)])
        return cls(fit, limits, _faces(tool.p_m), axes, cones, view)

    def allows(self, data: Measurements) -> Mask:
        """(N,) whether each of these poses can be measured."""
        tool = tool_poses(self.fit, data)
        allowed = self._in_volume(tool.p_m) & (_cosines(tool, self.axes) >= self.cones).all(axis=1)
        seen = _seen(data, tool.p_m)
        if self.view is not None and seen is not None:
            allowed &= ((seen >= self.view[0]) & (seen <= self.view[1])).all(axis=1)
        if self.limits.outside:
            allowed &= ~self._touches(data.q)
        if self.limits.possible is not None:
            allowed[allowed] = self.limits.possible(data.q[allowed])
        return allowed

    def _in_volume(self, p_m: Array) -> Mask:
        if self.limits.inside:
            return _any([box.holds(p_m) for box in self.limits.inside])
        return np.asarray(
            (p_m @ self.faces[:, :3].T + self.faces[:, 3] <= _MARGIN_M).all(axis=1), dtype=np.bool_
        )

    def _touches(self, q: Array) -> Mask:
        """Whether the line from joint to joint meets a box that is kept out."""
        nominal = Arm.of(self.fit.arm, self.fit.base, self.fit.tool).points(q)
        share = np.linspace(0.0, 1.0, _ALONG)[:, None]
        along = nominal[:, :-1, None] * (1.0 - share) + nominal[:, 1:, None] * share
        every = along.reshape(len(q), -1, 3)
        return _any([_any(list(box.holds(every).T)) for box in self.limits.outside])


def _any(masks: Sequence[Mask]) -> Mask:
    return np.asarray(np.stack(masks).any(axis=0), dtype=np.bool_)


def tool_poses(fit: Fit, data: Measurements) -> Pose:
    """(N,) where the fitted model has the tool."""
    return fit.model.at(observations(fit.arm, data)).poses(fit.estimate)


def _faces(p_m: Array) -> Array:
    """Half spaces (k, 4), normal and offset, around points (N, 3); a box where they lie in one plane."""
    try:
        return np.asarray(ConvexHull(p_m).equations, dtype=np.float64)
    except (QhullError, ValueError):
        eye = np.eye(3)
        high, low = p_m.max(axis=0), p_m.min(axis=0)
        return np.vstack([np.column_stack([eye, -high]), np.column_stack([-eye, low])])


def _cosines(tool: Pose, axes: Array) -> Array:
    """(N, 3) cosine of each axis of the tool with a direction of the measurement frame."""
    cosines: Array = np.einsum("nia,ai->na", tool.R, axes)
    return cosines


def _seen(data: Measurements, p_m: Array) -> Array | None:
    """(N, 3) image position and depth of points in the camera of each pose; None without camera columns."""
    if data.cam_p_m is None or data.cam_quat_wxyz is None:
        return None
    x, y, z = np.einsum("nji,nj->in", matrix_of_wxyz(data.cam_quat_wxyz), p_m - data.cam_p_m)
    depth = np.where(np.abs(z) > 1e-6, z, 1e-6)
    return np.stack([x / depth, y / depth, z], axis=1)
