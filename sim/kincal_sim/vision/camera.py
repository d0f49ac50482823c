"""The frames that the camera on the lander's mast takes.

A frame is the MuJoCo scene rendered in software (OSMesa) with the tags printed on their plates
(tag_renderer.py); then lens blur, shot and read noise, 8 bits and JPEG.

Pixel centres have whole coordinates (OpenCV's convention): the image spans -0.5 .. width - 0.5.
"""

from __future__ import annotations

import atexit
import os
from copy import deepcopy
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

# PyOpenGL chooses its back end at import.
os.environ.setdefault("PYOPENGL_PLATFORM", "osmesa")

import cv2
import mujoco
import numpy as np
from numpy.typing import ArrayLike

from kincal_shared.installation import root
from kincal_shared.schema.errors import read_toml, validate
from kincal_shared.schema.simulator import OpticsFile

from ..mechanics import appearance
from ..mechanics.spec import load_spec
from ..transforms import rot, trans
from .tag_renderer import Lighting, TagRenderer, Window
from .tags import Tag

# Beside the tags' prints: more than the detector looks at.
TAG_MARGIN_PX = 40
JPEG_BLOCK_PX = 16
FLAT_DN = 96
MODELS = root() / "sim" / "models"


@dataclass(frozen=True)
class Config:
    """Geometry of wam.toml with the tables of camera.toml.

    width_px, height_px: size of the image; K: 3x3 intrinsics [px]; tags: those on the tool; image, optics,
    detection: the tables of that name.
    """

    width_px: int
    height_px: int
    K: np.ndarray
    tags: tuple[Tag, ...]
    image: dict
    optics: dict
    detection: dict


@lru_cache(maxsize=8)
def _read(path: Path, _changed_ns: int) -> dict:
    """Cached: each run in process asks for it."""
    return read_toml(path)


def load_config(
    spec: dict | None = None, optics: dict | None = None, detection: dict | None = None
) -> Config:
    """Make the configuration from the arm's spec (spec.load_spec) and models/camera.toml.

    `optics` and `detection` replace settings of the tables of that name. Raises BadInput on an unknown
    setting, and ValueError if the pixels are not square: MuJoCo's frustum has one scale.
    """
    spec = spec or load_spec()
    path = MODELS / "camera.toml"
    raw = deepcopy(_read(path, path.stat().st_mtime_ns))
    raw["optics"] |= optics or {}
    raw["detection"] |= detection or {}
    validate(OpticsFile, raw, "models/camera.toml")
    cam = spec["camera"]
    if cam["fx_px"] != cam["fy_px"]:
        raise ValueError("fx_px and fy_px must be equal, the renderer has square pixels")
    return Config(
        cam["width_px"],
        cam["height_px"],
        np.array([[cam["fx_px"], 0.0, cam["cx_px"]], [0.0, cam["fy_px"], cam["cy_px"]], [0.0, 0.0, 1.0]]),
        tuple(Tag(t["id"], t["size_m"], trans(*t["xyz_m"]) @ rot("y", t["rot_y_rad"])) for t in spec["tag"]),
        raw["image"],
        raw["optics"],
        raw["detection"],
    )


def aim(spec: dict, p_base_m: ArrayLike) -> tuple[float, float]:
    """Pan and tilt [rad] that bring a point of the base frame to the image centre, within the limits."""
    unit = spec["pantilt"]
    target = np.asarray(p_base_m, float) - unit["mast_xyz_m"]
    _, _, z_off = unit["camera_xyz_m"]
    forward = np.hypot(target[0], target[1])
    # The optical axis passes z_off above the tilt axis.
    lift = np.arcsin(np.clip(z_off / max(np.hypot(forward, target[2]), 1e-9), -1.0, 1.0))
    pan = np.arctan2(target[1], target[0])
    tilt = lift - np.arctan2(target[2], forward)
    return float(np.clip(pan, *unit["pan_rad"])), float(np.clip(tilt, *unit["tilt_rad"]))


@dataclass(frozen=True)
class Jpeg:
    """A frame as sent, with the quality that kept it below the size limit."""

    data: bytes
    quality: int


@dataclass(frozen=True)
class TagsRadiance:
    """The scene about the tags as it reaches the lens, 0..255."""

    part: Window
    frame: np.ndarray


class Camera:
    """Takes frames of one MuJoCo model. Holds a software GL context; call close() when done."""

    def __init__(self, cfg: Config, model: mujoco.MjModel, shadows: bool = True):
        self.cfg = cfg
        self.model = model
        self._shadows = shadows
        model.vis.global_.offwidth = cfg.width_px
        model.vis.global_.offheight = cfg.height_px
        # Here and not above: the mode without pixels runs on machines without OSMesa.
        from mujoco.osmesa import GLContext

        appearance.fill_textures(model)
        self._gl = GLContext(cfg.width_px, cfg.height_px)
        self._gl.make_current()
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._scene = mujoco.MjvScene(model, max(2000, 4 * model.ngeom))
        self._option = mujoco.MjvOption()
        self._free = mujoco.MjvCamera()
        self._tags = TagRenderer(cfg.K, cfg.optics, (cfg.width_px, cfg.height_px), self._render_window)
        self._last_scene, self._last_frame = b"", np.empty((0, 0), np.float32)
        # GL must go before the interpreter unloads PyOpenGL.
        atexit.register(self.close)

    def close(self) -> None:
        """Give the GL context back; a closed camera takes no more frames. Safe to repeat."""
        atexit.unregister(self.close)
        self._context.free()
        self._gl.free()

    def radiance(self, data: mujoco.MjData, T_base_cam: np.ndarray, T_base_tool: np.ndarray) -> np.ndarray:
        """(height, width) float32, 0..255: the scene as it reaches the lens, before blur and noise."""
        cfg = self.cfg
        self._gl.make_current()
        self._update(data, T_base_cam)
        frame, depth = self._render_window(T_base_cam, Window(0, 0, cfg.width_px, cfg.height_px), 1)
        frame = np.ascontiguousarray(frame)
        self._draw_tags(frame, depth, data, T_base_cam, T_base_tool)
        return frame

    def _draw_tags(
        self,
        frame: np.ndarray,
        depth_m: np.ndarray,
        data: mujoco.MjData,
        T_base_cam: np.ndarray,
        T_base_tool: np.ndarray,
    ) -> None:
        lighting = Lighting(self.model, data, self._scene.lights[: self._scene.nlight], self._shadows)
        for tag in self.cfg.tags:
            self._tags.draw(frame, depth_m, lighting, T_base_cam, T_base_tool, tag)

    def tags_radiance(
        self, data: mujoco.MjData, T_base_cam: np.ndarray, T_base_tool: np.ndarray
    ) -> TagsRadiance | None:
        """The part of radiance() about the tags, in a fraction of the time; None if no tag faces the camera.

        It is made of whole JPEG blocks, so that compression there is that of the whole frame.
        """
        T_cam_tool = np.linalg.inv(T_base_cam) @ T_base_tool
        part = self._tags.around(T_cam_tool, self.cfg.tags, TAG_MARGIN_PX, JPEG_BLOCK_PX)
        if part is None:
            return None
        shape = (self.cfg.height_px, self.cfg.width_px)
        frame, depth = np.zeros(shape, np.float32), np.full(shape, np.inf, np.float32)
        self._gl.make_current()
        self._update(data, T_base_cam)
        frame[part.slices], depth[part.slices] = self._render_window(T_base_cam, part, 1)
        self._draw_tags(frame, depth, data, T_base_cam, T_base_tool)
        return TagsRadiance(part, frame[part.slices].copy())

    def expose_tags(self, radiance: TagsRadiance | None, rng: np.random.Generator) -> np.ndarray:
        """(height, width) uint8: one frame of tags_radiance(), flat grey elsewhere."""
        image = np.full((self.cfg.height_px, self.cfg.width_px), FLAT_DN, np.uint8)
        if radiance is not None:
            image[radiance.part.slices] = self._expose(radiance.frame, rng)
        return image

    def render(
        self,
        data: mujoco.MjData,
        T_base_cam: np.ndarray,
        T_base_tool: np.ndarray,
        rng: np.random.Generator,
    ) -> np.ndarray:
        """(height, width) uint8: one frame in grey. The MuJoCo world is the arm's base frame. Where nothing
        has moved since the last frame, only the noise is new."""
        scene = b"".join(x.tobytes() for x in (data.qpos, T_base_cam, T_base_tool))
        if scene != self._last_scene:
            self._last_scene, self._last_frame = scene, self.radiance(data, T_base_cam, T_base_tool)
        return self._expose(self._last_frame, rng)

    def _expose(self, frame: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """What the sensor makes of it: lens blur, shot and read noise, 8 bits."""
        optics = self.cfg.optics
        sigma = optics["psf_sigma_px"]
        frame = cv2.GaussianBlur(frame, (7, 7), sigma) if sigma > 0.0 else frame.copy()
        noise_dn = np.sqrt(optics["read_noise_dn"] ** 2 + frame / np.float32(optics["electrons_per_dn"]))
        frame += noise_dn * rng.standard_normal(frame.shape, dtype=np.float32)
        return np.clip(np.rint(frame), 0, 255).astype(np.uint8)

    def encode(self, image: np.ndarray) -> Jpeg:
        """JPEG below the size limit. Raises ValueError if even the lowest quality is too large."""
        im = self.cfg.image
        for quality in range(im["jpeg_quality"], im["jpeg_quality_min"] - 1, -im["jpeg_quality_step"]):
            ok, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
            if ok and len(jpeg) <= im["max_jpeg_bytes"]:
                return Jpeg(jpeg.tobytes(), quality)
        raise ValueError(f"frame does not fit {im['max_jpeg_bytes']} bytes at quality {quality}")

    # ---- OpenGL ---------------------------------------------------------------------------------

    def _update(self, data: mujoco.MjData, T_base_cam: np.ndarray) -> None:
        # The arm only updates body frames; lights would otherwise stay where they were.
        mujoco.mj_camlight(self.model, data)
        mujoco.mjv_updateScene(
            self.model, data, self._option, None, self._free, mujoco.mjtCatBit.mjCAT_ALL, self._scene
        )
        # The lamp beside the lens; MuJoCo put it where its own free camera stands.
        for light in self._scene.lights[: self._scene.nlight]:
            if light.headlight:
                light.pos = T_base_cam[:3, 3]
                light.dir = T_base_cam[:3, 2]
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = self._shadows
        self._scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False

    def _set_frustum(self, T_base_cam: np.ndarray, part: Window) -> None:
        """Frustum through the pixels of the window and through nothing else."""
        K, near = self.cfg.K, self.cfg.optics["near_m"]
        scale = near / K[0, 0]
        for cam in self._scene.camera:  # both eyes alike: without stereo MuJoCo averages them
            cam.pos = T_base_cam[:3, 3]
            cam.forward = T_base_cam[:3, 2]
            cam.up = -T_base_cam[:3, 1]
            cam.frustum_center = (part.u0 - 0.5 + 0.5 * part.width - K[0, 2]) * scale
            cam.frustum_top = (K[1, 2] - (part.v0 - 0.5)) * scale
            cam.frustum_bottom = (K[1, 2] - (part.v0 + part.height - 0.5)) * scale
            cam.frustum_near = near
            cam.frustum_far = self.cfg.optics["far_m"]

    def _render_window(
        self, T_base_cam: np.ndarray, part: Window, scale: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Grey value (float32, 0..255) and depth along the optical axis [m] of a part of the image.

        scale: samples per pixel along each axis; both arrays are (scale * height, scale * width).
        """
        self._set_frustum(T_base_cam, part)
        width, height = part.width * scale, part.height * scale
        view = mujoco.MjrRect(0, 0, width, height)
        rgb = np.empty((height, width, 3), np.uint8)
        depth = np.empty((height, width), np.float32)
        mujoco.mjr_render(view, self._scene, self._context)
        mujoco.mjr_readPixels(rgb, depth, view, self._context)
        near, far = self.cfg.optics["near_m"], self.cfg.optics["far_m"]
        grey = cv2.cvtColor(rgb[::-1], cv2.COLOR_RGB2GRAY).astype(np.float32)
        return grey, near / (1.0 - depth[::-1] * np.float32(1.0 - near / far))
