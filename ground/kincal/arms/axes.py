"""Axes of joints as DH parameters.

The axes of the moving joints, as lines in the base link at q = 0, determine the distal DH parameters
(Siciliano et al., Robotics, 2.8.2): frame i has its z axis on the axis of joint i + 1 and its x axis on the
common normal of the axes of joints i and i + 1. The first frame and the last one are free; base and tool
frame take what is left, so every serial chain fits, and the motion is the same to rounding.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kincal.rotations import Pose

Floats = NDArray[np.float64]

_PARALLEL = 1e-9  # sine of the angle between two axes below which they are parallel
_NEAR_M = 1e-9  # distance below which two axes meet


@dataclass(frozen=True)
class Axis:
    """A joint axis as a line at q = 0, in the base link: a point (3,) [m] and its unit direction (3,)."""

    point_m: Floats
    direction: Floats


@dataclass(frozen=True)
class DhRow:
    """One row of the distal DH table: T = Rz(phi + q) Tz(d) Tx(a) Rx(alpha) [rad, m]."""

    phi_rad: float
    d_m: float
    a_m: float
    alpha_rad: float

    def pose(self, q: float, prismatic: bool) -> Pose:
        """Link frame in the frame before it, for a joint value [rad, or m]; a prismatic joint adds q to d."""
        phi = self.phi_rad + (0.0 if prismatic else q)
        d = self.d_m + (q if prismatic else 0.0)
        c, s = math.cos(phi), math.sin(phi)
        ca, sa = math.cos(self.alpha_rad), math.sin(self.alpha_rad)
        R = np.array([[c, -s * ca, s * sa], [s, c * ca, -c * sa], [0.0, sa, ca]])
        return Pose(np.array([self.a_m * c, self.a_m * s, d]), R)


@dataclass(frozen=True)
class DhChain:
    """DH rows, base frame (base link -> frame 0) and link frames 1..n at q = 0 in the base link."""

    rows: tuple[DhRow, ...]
    base: Pose
    links: tuple[Pose, ...]


def dh_chain(axes: Sequence[Axis]) -> DhChain:
    """DH parameters of one or more joint axes, from base to tip."""
    frames = _frames(axes)
    rows = [_row(a, b) for a, b in zip(frames[:-1], frames[1:], strict=True)]
    # frame n is frame n - 1, turned or moved by joint n: the same at q = 0
    rows.append(DhRow(0.0, 0.0, 0.0, 0.0))
    return DhChain(tuple(rows), frames[0], (*frames[1:], frames[-1]))


def _frames(axes: Sequence[Axis]) -> list[Pose]:
    """Frames 0 .. n-1 at q = 0: z on the axis of joint i + 1, x on the common normal from the axis before."""
    normals = [_normal(a, b) for a, b in zip(axes[:-1], axes[1:], strict=True)]
    first_x = normals[0].x if normals else _perpendicular(axes[0].direction)
    # Origin of frame 0: where the first normal leaves axis 1, or the joint's own origin.
    first_at = axes[0].point_m
    if normals and not normals[0].parallel:
        first_at = _closest(axes[0], axes[1])[0]
    frames = [_frame(first_at, first_x, axes[0].direction)]
    for axis, normal in zip(axes[1:], normals, strict=True):
        # Parallel axes have many normals: take the one through the frame before, so that d = 0.
        at = _foot(frames[-1].p_m, axis) if normal.parallel else normal.foot_m
        frames.append(_frame(at, normal.x, axis.direction))
    return frames


@dataclass(frozen=True)
class _Normal:
    """Common normal of two axes: where it meets the second one, its unit direction from the first, and
    whether the axes are parallel."""

    foot_m: Floats
    x: Floats
    parallel: bool


def _normal(a: Axis, b: Axis) -> _Normal:
    cross = np.cross(a.direction, b.direction)
    sine = float(np.linalg.norm(cross))
    if sine < _PARALLEL:
        gap = b.point_m - a.point_m
        gap = gap - (gap @ a.direction) * a.direction
        distance = float(np.linalg.norm(gap))
        if distance > _NEAR_M:
            return _Normal(b.point_m, gap / distance, True)
        return _Normal(b.point_m, _perpendicular(a.direction), True)
    on_a, on_b = _closest(a, b)
    x = cross / sine
    side = -1.0 if (on_b - on_a) @ x < -_NEAR_M else 1.0
    return _Normal(on_b, np.asarray(side * x, dtype=float), False)


def _closest(a: Axis, b: Axis) -> tuple[Floats, Floats]:
    """Points of two skew lines that are nearest to each other."""
    cross = np.cross(a.direction, b.direction)
    along = np.column_stack([a.direction, -b.direction, cross])
    s, t, _ = np.linalg.solve(along, b.point_m - a.point_m)
    return a.point_m + s * a.direction, b.point_m + t * b.direction


def _foot(point_m: Floats, axis: Axis) -> Floats:
    """The point of an axis that is nearest to a point."""
    foot: Floats = axis.point_m + ((point_m - axis.point_m) @ axis.direction) * axis.direction
    return foot


def _perpendicular(z: Floats) -> Floats:
    """A unit vector across z, along a coordinate axis where possible."""
    unit = np.eye(3)[int(np.argmax(np.abs(z) < math.sqrt(0.75)))]
    x: Floats = unit - (unit @ z) * z
    return x / float(np.linalg.norm(x))


def _frame(at_m: Floats, x: Floats, z: Floats) -> Pose:
    across = x - (x @ z) * z
    across = across / float(np.linalg.norm(across))
    return Pose(np.array(at_m), np.column_stack([across, np.cross(z, across), z]))


def _row(a: Pose, b: Pose) -> DhRow:
    """DH parameters from frame i - 1 to frame i, both at q = 0."""
    step = a.inverse @ b
    phi = math.atan2(step.R[1, 0], step.R[0, 0])
    alpha = math.atan2(step.R[2, 1], step.R[2, 2])
    return DhRow(phi, float(step.p_m[2]), float(step.p_m[:2] @ step.R[:2, 0]), alpha)
