"""What the camera sees of tool poses, the pan-tilt unit aimed at the tool."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kincal.flight.camera import Aim, Camera
from kincal.rotations import Pose
from kincal_shared.schema.space import Description

from .arrays import Bools, Floats, Ints
from .reasons import Reason

if TYPE_CHECKING:
    from kincal.flight.headers import KcCamera


@dataclass(frozen=True)
class CameraViews:
    """The pan-tilt unit aimed at n tool poses.

    pan_rad, tilt_rad (n,): its angles. inside (n,): whether its limits less margins allow them. camera (n,):
    pose of the camera in the base frame. tool (n,): pose of the tool in the camera frame."""

    pan_rad: Floats
    tilt_rad: Floats
    inside: Bools
    camera: Pose
    tool: Pose


class ViewChecks:
    """The [tool] box and the [view] of a description against one CAMERA table."""

    def __init__(self, desc: Description, camera: KcCamera) -> None:
        self.desc, self.camera = desc, Camera(camera)
        self.n_tags = len(self.camera.tags)
        # a margin at the image rim is a camera with a smaller image
        self._inner = self.camera.cropped(desc.view.image_margin_px)

    def aim(self, poses: Pose) -> CameraViews:
        """Views of (n,) tool poses in the base frame."""
        aim = self.camera.aim(poses.p_m)
        camera = self.camera.pose(aim.pan_rad, aim.tilt_rad)
        inside = aim.inside & self._keeps_margin(aim)
        return CameraViews(aim.pan_rad, aim.tilt_rad, inside, camera, camera.inverse @ poses)

    def _keeps_margin(self, aim: Aim) -> Bools:
        c, m = self.camera.struct, self.desc.view.pantilt_margin_rad
        pan_in = (aim.pan_rad >= c.pan_min_rad + m) & (aim.pan_rad <= c.pan_max_rad - m)
        tilt_in = (aim.tilt_rad >= c.tilt_min_rad + m) & (aim.tilt_rad <= c.tilt_max_rad - m)
        return np.logical_and(pan_in, tilt_in)

    def incidence_rad(self, views: CameraViews) -> Floats:
        """Angle between line of sight and normal of each tag [rad], (n, tags)."""
        return self.camera.incidence(views.tool)

    def tag_edges_px(self, views: CameraViews) -> Floats:
        """Shortest edge of each tag's black square in the image, (n, tags)."""
        c = self.camera.struct
        unit = np.array([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]])
        out = []
        for tag, size_m in zip(self.camera.tags, self.camera.sizes_m, strict=True):
            in_tool = tag.p_m + (size_m * unit) @ tag.R.T
            at = views.tool.p_m[:, None] + in_tool @ views.tool.R.transpose(0, 2, 1)
            uv = at[..., :2] / np.maximum(at[..., 2:], 1e-6) * [c.fx_px, c.fy_px]
            edges = np.linalg.norm(uv - uv[:, [3, 0, 1, 2]], axis=2)
            out.append(np.min(edges, axis=1))
        return np.array(out).T

    def problems(self, p_m: Floats, views: CameraViews, *, box: bool = True) -> tuple[list[str], Ints]:
        """First check of the view that each tool position (n, 3) fails ("": none), and the tags that show if
        nothing hides them (bits; 0 where a check fails), (n,). box: the position box is one of the checks."""
        t, v = self.desc.tool, self.desc.view
        far_m = np.linalg.norm(views.tool.p_m, axis=1)
        facing = np.sum(self.incidence_rad(views) <= v.incid_max_rad, axis=1)
        in_image = self._inner.visible(views.tool, v.incid_max_rad)
        shown = in_image & (self.tag_edges_px(views) >= v.tag_min_px) @ (1 << np.arange(self.n_tags))
        failed = {
            Reason.OUTSIDE_BOX: np.any((p_m < t.box_min_m) | (p_m > t.box_max_m), axis=1) & box,
            Reason.RANGE: (far_m < v.range_min_m) | (far_m > v.range_max_m),
            Reason.PANTILT: ~views.inside,
            Reason.OBLIQUE: facing < v.tags_min,
            Reason.FEW_TAGS: np.bitwise_count(in_image) < v.tags_min,
            Reason.SMALL_TAGS: np.bitwise_count(shown) < v.tags_min,
        }
        return _first_failed(failed, len(p_m)), np.where(np.any([*failed.values()], axis=0), 0, shown)


def _first_failed(failed: dict[Reason, Bools], n: int) -> list[str]:
    """Name of the first check that each of n rows fails, "" if none."""
    first = np.argmax([*failed.values(), np.ones(n, bool)], axis=0)
    names = [*map(str, failed), ""]
    return [names[k] for k in first]
