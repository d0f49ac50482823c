"""The pan-tilt camera of a camera table, by flight's own code."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kincal.rotations import Pose

from .builds import Floats, doubles, library

if TYPE_CHECKING:
    from .headers import KcCamera


@dataclass(frozen=True)
class Aim:
    """Angles [rad] that centre points in the image, (N,) each; inside: the limits of the unit allow it (else
    they cut the angles off)."""

    pan_rad: Floats
    tilt_rad: Floats
    inside: NDArray[np.bool_]


class Camera:
    """A camera table and the tags on the tool. Do not change `struct`.

    tags: pose of each tag in the tool frame, z into the tag away from the viewer; sizes_m: edges of their
    black squares.
    """

    def __init__(self, struct: KcCamera) -> None:
        self.struct = struct
        self.tags = [Pose.of_wxyz(list(t.xyz_m), list(t.quat_wxyz)) for t in struct.tag[0 : struct.n_tags]]
        self.sizes_m = np.array([t.size_m for t in struct.tag[0 : struct.n_tags]])

    def cropped(self, margin_px: float) -> Camera:
        """The same camera with an image that is smaller by a margin on each side."""
        out, m = library("flight").copy(self.struct), margin_px
        out.width_px, out.height_px = int(out.width_px - 2 * m), int(out.height_px - 2 * m)
        out.cx_px, out.cy_px = out.cx_px - m, out.cy_px - m
        return Camera(out)

    def aim(self, points_m: ArrayLike) -> Aim:
        """Angles that centre points (N, 3) of the base frame."""
        flight, points = library("flight"), doubles(points_m)
        n = len(points)
        pan, tilt, inside = np.empty(n), np.empty(n), np.empty(n, dtype=np.bool_)
        at, x, y = flight.pointer(points), flight.pointer(pan), flight.pointer(tilt)
        for i in range(n):
            inside[i] = flight.lib.kc_camera_aim(self.struct, at + 3 * i, x + i, y + i) == 0
        return Aim(pan, tilt, inside)

    def pose(self, pan_rad: ArrayLike, tilt_rad: ArrayLike) -> Pose:
        """Camera in the base frame at pan and tilt angles, (N,) poses or one."""
        flight = library("flight")
        pan, tilt = np.atleast_1d(doubles(pan_rad)), np.atleast_1d(doubles(tilt_rad))
        rows = np.empty((len(pan), 12))
        at = flight.pointer(rows, "kc_pose_t")
        for i in range(len(pan)):
            flight.lib.kc_camera_pose(self.struct, float(pan[i]), float(tilt[i]), at + i)
        out = Pose(rows[:, :3].copy(), rows[:, 3:].reshape(-1, 3, 3).copy())
        return out if np.ndim(pan_rad) else out[0]

    def visible(self, tool: Pose, max_incid_rad: float) -> NDArray[np.int64]:
        """(N,) bit sets of the tags that lie inside the image with an incidence below the limit, for (N,)
        tool poses in the camera frame. Nothing hides anything here."""
        flight = library("flight")
        p = np.atleast_2d(tool.p_m)
        rows = doubles(np.concatenate([p, tool.R.reshape(len(p), 9)], axis=1))
        at = flight.pointer(rows, "kc_pose_t")
        found = [flight.lib.kc_camera_visible(self.struct, at + i, max_incid_rad) for i in range(len(p))]
        return np.array(found, dtype=np.int64)

    def incidence(self, tool: Pose) -> Floats:
        """(..., tags) angle between line of sight and normal of each tag [rad], for (...,) tool poses in the
        camera frame."""
        out = []
        for tag in self.tags:
            placed = tool @ tag
            cos = np.sum(placed.p_m * placed.R[..., :, 2], axis=-1) / np.linalg.norm(placed.p_m, axis=-1)
            out.append(np.arccos(np.clip(cos, -1.0, 1.0)))
        return np.stack(out, axis=-1)

    def frustum(self, pan_rad: float, tilt_rad: float, depth_m: float) -> tuple[Floats, Floats]:
        """Camera position (3,) and the four image corners (4, 3) at a depth, base frame [m]."""
        c, pose = self.struct, self.pose(pan_rad, tilt_rad)
        u, v = np.array([0, c.width_px, c.width_px, 0]), np.array([0, 0, c.height_px, c.height_px])
        rays = np.stack([(u - c.cx_px) / c.fx_px, (v - c.cy_px) / c.fy_px, np.ones(4)], axis=1)
        return pose.p_m, pose.p_m + depth_m * rays @ pose.R.T
