"""The orientation of the tool as a driver of errors: of a sensor, of its target, of a tool that bends.

Joint angles determine the orientation only all together, and angles of the tool wrap: the drivers are
components of unit vectors, which are smooth and have one value each. They are taken where the model expects
the tool, since the measured orientation carries the noise of the residual.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from kincal.rotations import matrix_of_wxyz

from ..fit.columns import Columns
from ..model.unnamed_names import GRAVITY, HEADINGS, ORIENTATION, TOOL_AXES
from ..numerics.types import Array, array

_XYZ = "xyz"
_LEAST_SPREAD = 1e-3  # of the components of a unit vector: less is no turn
_SECOND = 0.5  # size of the second degree of a function relative to the first one: it is smooth


def orientation_features(columns: Columns) -> Iterator[tuple[str, Array]]:
    """(name, (N, k) centred features) of each driver that varies.

    ORIENTATION: in proportion to the nine components of the tool's axes as the sensor sees them, in the frame
    of the camera or else of the base; TOOL_AXES: the direction of one of these axes, to the second degree;
    GRAVITY: its direction in the frame of the tool, to the second degree; HEADINGS: a wave of some periods a
    turn, which is of a higher degree.
    """
    tool, axes = _tool(columns), axes_of_tool(columns)
    gravity = _gravity(columns, tool)
    every = axes.reshape(-1, 9)
    if _varies(every):
        yield ORIENTATION, _centred(every)
    for name, direction in zip((*TOOL_AXES, GRAVITY), (*axes.transpose(2, 0, 1), gravity), strict=True):
        if _varies(direction):
            yield name, _centred(_to_second_degree(direction))
    angles = np.array([periods * _heading(name, axes) for name, (*_, periods) in HEADINGS.items()])
    waves = np.stack([np.cos(angles), np.sin(angles)], axis=2)
    waves -= waves.mean(axis=1, keepdims=True)
    varies = waves.std(axis=1).max(axis=1) > _LEAST_SPREAD
    yield from ((name, wave) for name, wave, one in zip(HEADINGS, waves, varies, strict=True) if one)


def z_component(driver: str, columns: Columns) -> Array:
    """(N,) of the direction that a driver is, to plot against; of all axes, that of the tool's z axis. Of a
    heading the angle [rad]."""
    if driver == GRAVITY:
        return array(_gravity(columns, _tool(columns))[:, 2])
    axes = axes_of_tool(columns)
    if driver in HEADINGS:
        return _heading(driver, axes)
    axis = TOOL_AXES.index(driver) if driver in TOOL_AXES else 2
    return array(axes[:, 2, axis])


def axes_of_tool(columns: Columns) -> Array:
    """(N, 3, 3) axes of the tool, as columns, in the frame of the sensor, where the model expects it."""
    return array(from_base(columns) @ _tool(columns))


def from_base(columns: Columns) -> Array:
    """(N, 3, 3) turns from the base to the frame of the sensor: of the camera, or else of the base."""
    camera = columns.fit.data.cam_quat_wxyz
    if camera is None:
        return np.broadcast_to(np.eye(3), (columns.n, 3, 3))
    return array(matrix_of_wxyz(camera).transpose(0, 2, 1))


def _heading(driver: str, axes: Array) -> Array:
    """(N,) angle [rad] of an axis about one of the other frame. axes: (N, 3, 3) of the tool, as columns, in
    the frame of the sensor."""
    axis, about, _ = HEADINGS[driver]
    seen = axes if axis in TOOL_AXES else axes.transpose(0, 2, 1)
    own, other = (_XYZ.index(name[-1]) for name in (axis, about))
    return array(np.arctan2(seen[:, other - 1, own], seen[:, other - 2, own]))


def _gravity(columns: Columns, tool: Array) -> Array:
    """(N, 3) direction of gravity in the frame of the tool; 0 where there is none."""
    fit = columns.fit
    g = fit.data.g_m_s2 if fit.data.g_m_s2 is not None else np.array(fit.arm.gravity_m_s2, dtype=float)
    down = np.broadcast_to(g / np.maximum(np.linalg.norm(g, axis=-1, keepdims=True), 1e-9), (len(tool), 3))
    return array(np.einsum("nji,nj->ni", tool, down))


def _tool(columns: Columns) -> Array:
    """(N, 3, 3) axes of the tool, as columns, where the model expects it."""
    return columns.fit.model.poses(columns.fit.estimate).R


def _varies(x: Array) -> bool:
    return bool(x.std(axis=0).max() > _LEAST_SPREAD)


def _centred(x: Array) -> Array:
    return array(x - x.mean(axis=0))


def _to_second_degree(direction: Array) -> Array:
    """(N, 8) of unit vectors (N, 3): components, and the products that are orthogonal over the sphere."""
    x, y, z = direction.T
    second = [x * y, y * z, z * x, (x**2 - y**2) / 2.0, (3.0 * z**2 - 1.0) / np.sqrt(12.0)]
    return np.column_stack([direction, _SECOND * np.sqrt(3.0) * np.array(second).T])
