"""Printed tags in a rendered frame: by homography, supersampled, lit like MuJoCo's own surfaces, and hidden
where something stands in front."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import mujoco
import numpy as np

from . import tags
from .tags import Tag

# Subsamples of a pixel along each axis where a tag is drawn, and of a tag cell in its bitmap.
SUPER = 4
CELL_PX = 32
BITMAP_PX = CELL_PX * tags.CELLS
# A thing hides the tag if it is nearer by more than this: more than the thickness of the tag's own plate.
OCCLUSION_MARGIN_M = 0.008
# Shadow rays per tag edge.
SHADOW_GRID = 9


@dataclass(frozen=True)
class Window:
    """Part of an image: pixels u0 .. u0 + width - 1 and v0 .. v0 + height - 1."""

    u0: int
    v0: int
    width: int
    height: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Of an image array, (rows, columns)."""
        return slice(self.v0, self.v0 + self.height), slice(self.u0, self.u0 + self.width)

    @property
    def super_size(self) -> tuple[int, int]:
        """(width, height) in subsamples."""
        return self.width * SUPER, self.height * SUPER


# (T_base_cam, window, samples per pixel) -> grey value and depth [m] of the scene without tags
RenderWindow = Callable[[np.ndarray, Window, int], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Lighting:
    """The lights of a scene, to shade a white matt surface as MuJoCo would. lights: MuJoCo's mjvLight."""

    model: mujoco.MjModel
    data: mujoco.MjData
    lights: Sequence[Any]
    shadows: bool

    def on(self, centre_m: np.ndarray, normal: np.ndarray, points_m: np.ndarray) -> np.ndarray:
        """(k,) light, 0..1, that falls on points (k, 3) of a flat surface; base frame."""
        total = np.zeros(len(points_m))
        for light in self.lights:
            total += float(np.mean(light.ambient))
            total += self._diffuse(light, centre_m, normal, points_m)
        return np.minimum(total, 1.0)

    def _diffuse(
        self, light: Any, centre_m: np.ndarray, normal: np.ndarray, points_m: np.ndarray
    ) -> np.ndarray | float:
        directional = int(light.type) == int(mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
        to_light = -np.array(light.dir, float) if directional else np.array(light.pos, float) - centre_m
        reach = np.linalg.norm(to_light)
        to_light = to_light / max(reach, 1e-9)
        lambert = max(0.0, float(normal @ to_light)) * float(np.mean(light.diffuse))
        if lambert == 0.0 or not (self.shadows and light.castshadow and not light.headlight):
            return lambert
        starts = points_m + OCCLUSION_MARGIN_M * normal
        return lambert * self._lit(starts, to_light, np.inf if directional else float(reach))

    def _lit(self, starts_m: np.ndarray, to_light: np.ndarray, reach_m: float) -> np.ndarray:
        """(k,) 1 where the ray to the light is free, 0 in shadow."""
        hit = np.zeros(1, np.int32)
        far = [mujoco.mj_ray(self.model, self.data, s, to_light, None, 1, -1, hit) for s in starts_m]
        return np.array([0.0 if 0.0 <= d < reach_m else 1.0 for d in far])


class TagRenderer:
    """Draws tags into frames of a camera.

    K: 3x3 intrinsics [px]; optics: table of camera.toml; size_px: (width, height) of the image;
    render_window: renders a part of the scene again, finely, where something cuts into a tag.
    """

    def __init__(self, K: np.ndarray, optics: dict, size_px: tuple[int, int], render_window: RenderWindow):
        self.K, self.optics, self.size_px, self.render_window = K, optics, size_px, render_window

    def draw(
        self,
        frame: np.ndarray,
        depth_m: np.ndarray,
        lighting: Lighting,
        T_base_cam: np.ndarray,
        T_base_tool: np.ndarray,
        tag: Tag,
    ) -> None:
        """Draw one tag into the frame (in place), where it faces the camera and nothing hides it.

        frame, depth_m: (height, width) grey value and depth of the scene.
        """
        T_base_tag = T_base_tool @ tag.T_tool_tag
        T_cam_tag = np.linalg.inv(T_base_cam) @ T_base_tag
        part = self._window(T_cam_tag, tag)
        if part is None:
            return
        ink, cover = self._print(self._ink(lighting, T_base_tag, tag), T_cam_tag, tag, part)
        plane = self._plane_depth(T_cam_tag, part)
        ground, cover = self._behind(frame, depth_m, T_base_cam, part, plane, cover)
        mixed = ground + cover * (ink - ground)
        mean = mixed.reshape(part.height, SUPER, part.width, SUPER).mean(axis=(1, 3))
        frame[part.slices] = mean

    def around(
        self, T_cam_tool: np.ndarray, drawn: Sequence[Tag], margin_px: int, block_px: int
    ) -> Window | None:
        """The part of the image with all tags in view and a margin about them, in whole blocks."""
        windows = [self._window(T_cam_tool @ tag.T_tool_tag, tag) for tag in drawn]
        found = [w for w in windows if w is not None]
        if not found:
            return None
        low = np.min([[w.u0, w.v0] for w in found], axis=0) - margin_px
        high = np.max([[w.u0 + w.width, w.v0 + w.height] for w in found], axis=0) + margin_px
        u0, v0 = np.maximum(low // block_px * block_px, 0)
        u1, v1 = np.minimum(-(-high // block_px) * block_px, self.size_px)
        return Window(int(u0), int(v0), int(u1 - u0), int(v1 - v0))

    def _window(self, T_cam_tag: np.ndarray, tag: Tag) -> Window | None:
        """The part of the image that the tag covers; None if it is not in view or seen from behind."""
        R, t = T_cam_tag[:3, :3], T_cam_tag[:3, 3]
        edge = _half_print_m(tag)
        outline = np.array([[-edge, -edge, 0], [edge, -edge, 0], [edge, edge, 0], [-edge, edge, 0]]) @ R.T + t
        if float(R[:, 2] @ t) <= 0.0 or np.any(outline[:, 2] < self.optics["near_m"]):
            return None
        px = outline @ self.K.T
        px = px[:, :2] / px[:, 2:]
        u0, v0 = np.maximum(np.floor(px.min(axis=0)).astype(int) - 1, 0)
        u1, v1 = np.minimum(np.ceil(px.max(axis=0)).astype(int) + 2, self.size_px)
        return Window(int(u0), int(v0), int(u1 - u0), int(v1 - v0)) if u1 > u0 and v1 > v0 else None

    def _ink(self, lighting: Lighting, T_base_tag: np.ndarray, tag: Tag) -> np.ndarray:
        """(BITMAP_PX, BITMAP_PX) grey value of the lit print."""
        edge = _half_print_m(tag)
        g = (np.arange(SHADOW_GRID) + 0.5) / SHADOW_GRID * 2.0 * edge - edge
        gx, gy = np.meshgrid(g, g)
        flat = np.column_stack([gx.ravel(), gy.ravel(), np.zeros(gx.size)])
        points = flat @ T_base_tag[:3, :3].T + T_base_tag[:3, 3]
        light = lighting.on(T_base_tag[:3, 3], -T_base_tag[:3, 2], points)
        light = cv2.resize(light.reshape(gx.shape).astype(np.float32), (BITMAP_PX, BITMAP_PX))
        black, white = self.optics["tag_black"], self.optics["tag_white"]
        cells = np.kron(tags.bitmap(tag.id), np.ones((CELL_PX, CELL_PX), np.float32))
        return 255.0 * light * (black + (white - black) * cells)

    def _print(
        self, ink: np.ndarray, T_cam_tag: np.ndarray, tag: Tag, part: Window
    ) -> tuple[np.ndarray, np.ndarray]:
        """Grey value of the print at every subsample of the window, and how much of it the print covers."""
        edge = _half_print_m(tag)
        # Bitmap pixel -> metres on the tag -> image -> subsample of the window.
        m = tag.size_m / tags.BLACK_CELLS / CELL_PX
        from_bitmap = np.array([[m, 0, 0.5 * m - edge], [0, m, 0.5 * m - edge], [0, 0, 1.0]])
        to_image = self.K @ np.column_stack([T_cam_tag[:3, 0], T_cam_tag[:3, 1], T_cam_tag[:3, 3]])
        to_sub = np.array(
            [
                [SUPER, 0, SUPER * (0.5 - part.u0) - 0.5],
                [0, SUPER, SUPER * (0.5 - part.v0) - 0.5],
                [0, 0, 1.0],
            ]
        )
        H = to_sub @ to_image @ from_bitmap
        whole = np.ones((BITMAP_PX, BITMAP_PX), np.float32)
        return (
            cv2.warpPerspective(
                ink, H, part.super_size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            ),
            cv2.warpPerspective(whole, H, part.super_size, flags=cv2.INTER_LINEAR),
        )

    def _plane_depth(self, T_cam_tag: np.ndarray, part: Window) -> np.ndarray:
        """Depth [m] of the tag plane at every subsample: n . (z K^-1 uv1) = n . t."""
        normal, t = T_cam_tag[:3, 2], T_cam_tag[:3, 3]
        width, height = part.super_size
        us = (np.arange(width) + 0.5) / SUPER + part.u0 - 0.5
        vs = (np.arange(height) + 0.5) / SUPER + part.v0 - 0.5
        nk = normal @ np.linalg.inv(self.K)
        along = nk[0] * us[None, :] + nk[1] * vs[:, None] + nk[2]
        return float(normal @ t) / np.maximum(along, 1e-9)

    def _behind(
        self,
        frame: np.ndarray,
        depth_m: np.ndarray,
        T_base_cam: np.ndarray,
        part: Window,
        plane_m: np.ndarray,
        cover: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """The scene at every subsample, and the share that the print covers where nothing is in front."""
        scene, scene_depth = _repeat(frame[part.slices], SUPER), _repeat(depth_m[part.slices], SUPER)
        if not np.any((scene_depth < plane_m - OCCLUSION_MARGIN_M) & (cover > 0.0)):
            return scene, cover
        # Something cuts into the tag: render the scene there as finely as the tag.
        fits = (s for s in (4, 2) if part.width * s <= self.size_px[0] and part.height * s <= self.size_px[1])
        fine = next(fits, 1)
        scene, scene_depth = (_repeat(a, SUPER // fine) for a in self.render_window(T_base_cam, part, fine))
        return scene, np.where(scene_depth < plane_m - OCCLUSION_MARGIN_M, 0.0, cover)


def _half_print_m(tag: Tag) -> float:
    """Half the edge of the print, white border included."""
    return 0.5 * (tag.size_m / tags.BLACK_CELLS) * tags.CELLS


def _repeat(image: np.ndarray, k: int) -> np.ndarray:
    return np.repeat(np.repeat(image, k, 0), k, 1)
