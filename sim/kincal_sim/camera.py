"""The frames that the camera on the lander's mast takes.

A frame is the MuJoCo scene drawn in software (OSMesa) with the two tags printed on their plates by
homography, four times supersampled and hidden where the arm stands in front; then lens blur,
shot and read noise, 8 bits and JPEG.

Pixel centres have whole coordinates (OpenCV's convention): the image spans -0.5 .. width - 0.5.
"""

from __future__ import annotations

import atexit
import os
import tomllib
from dataclasses import dataclass
from pathlib import Path

# MuJoCo and PyOpenGL choose their back end at import.
os.environ.setdefault("MUJOCO_GL", "osmesa")
os.environ.setdefault("PYOPENGL_PLATFORM", "osmesa")

import cv2
import mujoco
import numpy as np

from . import geom, scenery, tags
from .arm import load_spec

MODELS = Path(__file__).resolve().parent.parent / "models"
# Subsamples of a pixel along each axis where a tag is drawn, and of a tag cell in its bitmap.
SUPER = 4
CELL_PX = 32
# A thing hides the tag if it is nearer by more than this: more than the thickness of the tag's own plate.
OCCLUSION_MARGIN_M = 0.008
# Shadow rays per tag edge.
SHADOW_GRID = 9


@dataclass(frozen=True)
class Tag:
    """One printed tag: family member, edge of its black square, place in the tool frame (4x4)."""

    id: int
    size_m: float
    T_tool_tag: np.ndarray


@dataclass(frozen=True)
class Config:
    """Geometry of wam.toml (image size, intrinsics, tags) with the tables of camera.toml."""

    width_px: int
    height_px: int
    K: np.ndarray
    tags: tuple[Tag, ...]
    image: dict
    optics: dict
    fast: dict


def _override(table: dict, changes: dict, name: str) -> dict:
    unknown = sorted(set(changes) - set(table))
    if unknown:
        raise ValueError(f"unknown setting {name}.{unknown[0]}; known: {', '.join(table)}")
    return table | changes


def load_config(spec: dict | None = None, optics: dict | None = None, fast: dict | None = None) -> Config:
    """Make the configuration from the arm's spec (arm.load_spec) and models/camera.toml.

    `optics` and `fast` replace settings of the tables of that name. Raises ValueError on an unknown
    setting, and if the pixels are not square: MuJoCo's frustum has one scale.
    """
    spec = spec or load_spec()
    with open(MODELS / "camera.toml", "rb") as f:
        raw = tomllib.load(f)
    raw["optics"] = _override(raw["optics"], optics or {}, "optics")
    raw["fast"] = _override(raw["fast"], fast or {}, "fast")
    cam = spec["camera"]
    if cam["fx_px"] != cam["fy_px"]:
        raise ValueError("fx_px and fy_px must be equal, the renderer has square pixels")
    K = np.array([[cam["fx_px"], 0.0, cam["cx_px"]], [0.0, cam["fy_px"], cam["cy_px"]], [0.0, 0.0, 1.0]])
    placed = tuple(
        Tag(t["id"], t["size_m"], geom.trans(*t["xyz_m"]) @ geom.rot("y", t["rot_y_rad"]))
        for t in spec["tag"]
    )
    return Config(cam["width_px"], cam["height_px"], K, placed, raw["image"], raw["optics"], raw["fast"])


def aim(spec: dict, p_base_m) -> tuple[float, float]:
    """Pan and tilt that bring a point of the base frame to the image centre, inside the head's limits."""
    head = spec["head"]
    target = np.asarray(p_base_m, float) - head["mast_xyz_m"]
    _, _, z_off = head["camera_xyz_m"]
    forward = np.hypot(target[0], target[1])
    # The optical axis passes z_off above the tilt axis.
    lift = np.arcsin(np.clip(z_off / max(np.hypot(forward, target[2]), 1e-9), -1.0, 1.0))
    pan = np.arctan2(target[1], target[0])
    tilt = lift - np.arctan2(target[2], forward)
    return float(np.clip(pan, *head["pan_rad"])), float(np.clip(tilt, *head["tilt_rad"]))


@dataclass(frozen=True)
class Frame:
    """A JPEG as sent, with the quality that kept it below the size limit."""

    jpeg: bytes
    quality: int


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

        scenery.paint(model)
        self._gl = GLContext(cfg.width_px, cfg.height_px)
        self._gl.make_current()
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._scene = mujoco.MjvScene(model, max(2000, 4 * model.ngeom))
        self._option = mujoco.MjvOption()
        self._free = mujoco.MjvCamera()
        self._bitmaps = {t.id: self._enlarged(t.id) for t in cfg.tags}
        # GL must go before the interpreter takes PyOpenGL apart.
        atexit.register(self.close)

    def _enlarged(self, tag_id: int) -> np.ndarray:
        cells = tags.bitmap(tag_id)
        return np.kron(cells, np.ones((CELL_PX, CELL_PX), np.float32))

    def close(self) -> None:
        """Give the GL context back; a closed camera takes no more frames. Safe to repeat."""
        atexit.unregister(self.close)
        self._context.free()
        self._gl.free()

    # -- drawing ---------------------------------------------------------------------------------

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

    def _aim_gl(self, T_base_cam: np.ndarray, u0: int, v0: int, w: int, h: int) -> None:
        """Frustum through the pixels u0 .. u0+w-1, v0 .. v0+h-1 and through nothing else."""
        K, near = self.cfg.K, self.cfg.optics["near_m"]
        scale = near / K[0, 0]
        for cam in self._scene.camera:  # both eyes alike: without stereo MuJoCo averages them
            cam.pos = T_base_cam[:3, 3]
            cam.forward = T_base_cam[:3, 2]
            cam.up = -T_base_cam[:3, 1]
            cam.frustum_center = (u0 - 0.5 + 0.5 * w - K[0, 2]) * scale
            cam.frustum_top = (K[1, 2] - (v0 - 0.5)) * scale
            cam.frustum_bottom = (K[1, 2] - (v0 + h - 0.5)) * scale
            cam.frustum_near = near
            cam.frustum_far = self.cfg.optics["far_m"]

    def _draw(self, T_base_cam, u0: int, v0: int, w: int, h: int, scale: int):
        """Grey value (float32, 0..255) and depth [m] along the optical axis of a part of the image."""
        self._aim_gl(T_base_cam, u0, v0, w, h)
        view = mujoco.MjrRect(0, 0, w * scale, h * scale)
        rgb = np.empty((h * scale, w * scale, 3), np.uint8)
        depth = np.empty((h * scale, w * scale), np.float32)
        mujoco.mjr_render(view, self._scene, self._context)
        mujoco.mjr_readPixels(rgb, depth, view, self._context)
        near, far = self.cfg.optics["near_m"], self.cfg.optics["far_m"]
        grey = cv2.cvtColor(rgb[::-1], cv2.COLOR_RGB2GRAY).astype(np.float32)
        return grey, near / (1.0 - depth[::-1] * np.float32(1.0 - near / far))

    # -- tags ------------------------------------------------------------------------------------

    def _light_on(self, data, centre, normal, points) -> np.ndarray:
        """Light falling on the points of a tag, as MuJoCo's own lights shade a white matt surface."""
        total = np.zeros(len(points))
        hit = np.zeros(1, np.int32)
        for light in self._scene.lights[: self._scene.nlight]:
            total += float(np.mean(light.ambient))
            headlight = bool(light.headlight)
            directional = int(light.type) == int(mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
            to_light = -np.array(light.dir, float)
            if not directional:
                to_light = np.array(light.pos, float) - centre
            reach = np.linalg.norm(to_light)
            to_light = to_light / max(reach, 1e-9)
            lambert = max(0.0, float(normal @ to_light)) * float(np.mean(light.diffuse))
            if lambert == 0.0:
                continue
            lit = np.ones(len(points))
            if self._shadows and light.castshadow and not headlight:
                for i, p in enumerate(points):
                    start = p + OCCLUSION_MARGIN_M * normal
                    d = mujoco.mj_ray(self.model, data, start, to_light, None, 1, -1, hit)
                    lit[i] = 0.0 if d >= 0.0 and (directional or d < reach) else 1.0
            total += lambert * lit
        return np.minimum(total, 1.0)

    def _print(self, frame, depth, data, T_base_cam, T_base_tool, tag: Tag) -> None:
        """Draw one tag into the frame (in place), where it faces the camera and nothing hides it."""
        cfg = self.cfg
        T_base_tag = T_base_tool @ tag.T_tool_tag
        T_cam_tag = np.linalg.inv(T_base_cam) @ T_base_tag
        R, t = T_cam_tag[:3, :3], T_cam_tag[:3, 3]
        cell = tag.size_m / tags.BLACK_CELLS
        edge = 0.5 * cell * tags.CELLS
        outline = np.array([[-edge, -edge, 0], [edge, -edge, 0], [edge, edge, 0], [-edge, edge, 0]])
        outline = outline @ R.T + t
        facing = float(R[:, 2] @ t)  # > 0: the tag's inward axis points away from the camera
        if facing <= 0.0 or np.any(outline[:, 2] < cfg.optics["near_m"]):
            return
        px = outline @ cfg.K.T
        px = px[:, :2] / px[:, 2:]
        u0, v0 = np.maximum(np.floor(px.min(axis=0)).astype(int) - 1, 0)
        u1, v1 = np.minimum(np.ceil(px.max(axis=0)).astype(int) + 2, [cfg.width_px, cfg.height_px])
        if u1 <= u0 or v1 <= v0:
            return
        w, h = int(u1 - u0), int(v1 - v0)

        # Light over the tag, sampled on a grid of points.
        g = (np.arange(SHADOW_GRID) + 0.5) / SHADOW_GRID * 2.0 * edge - edge
        gx, gy = np.meshgrid(g, g)
        flat = np.column_stack([gx.ravel(), gy.ravel(), np.zeros(gx.size)])
        points = flat @ T_base_tag[:3, :3].T + T_base_tag[:3, 3]
        light = self._light_on(data, T_base_tag[:3, 3], -T_base_tag[:3, 2], points)
        n = CELL_PX * tags.CELLS
        light = cv2.resize(light.reshape(gx.shape).astype(np.float32), (n, n))
        black, white = cfg.optics["tag_black"], cfg.optics["tag_white"]
        ink = 255.0 * light * (black + (white - black) * self._bitmaps[tag.id])

        # Bitmap pixel -> metres on the tag -> image -> subsample of the region.
        m = cell / CELL_PX
        from_bitmap = np.array([[m, 0, 0.5 * m - edge], [0, m, 0.5 * m - edge], [0, 0, 1.0]])
        to_image = cfg.K @ np.column_stack([R[:, 0], R[:, 1], t])
        to_sub = np.array(
            [[SUPER, 0, SUPER * (0.5 - u0) - 0.5], [0, SUPER, SUPER * (0.5 - v0) - 0.5], [0, 0, 1.0]]
        )
        H = to_sub @ to_image @ from_bitmap
        size = (w * SUPER, h * SUPER)
        ink = cv2.warpPerspective(ink, H, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        cover = cv2.warpPerspective(np.ones((n, n), np.float32), H, size, flags=cv2.INTER_LINEAR)

        # Depth of the tag plane at every subsample: n . (z K^-1 uv1) = n . t.
        us = (np.arange(size[0]) + 0.5) / SUPER + u0 - 0.5
        vs = (np.arange(size[1]) + 0.5) / SUPER + v0 - 0.5
        nk = R[:, 2] @ np.linalg.inv(cfg.K)
        along = nk[0] * us[None, :] + nk[1] * vs[:, None] + nk[2]
        plane = facing / np.maximum(along, 1e-9)

        region = (slice(v0, v1), slice(u0, u1))
        ground = np.repeat(np.repeat(frame[region], SUPER, 0), SUPER, 1)
        scene_depth = np.repeat(np.repeat(depth[region], SUPER, 0), SUPER, 1)
        near_thing = (scene_depth < plane - OCCLUSION_MARGIN_M) & (cover > 0.0)
        if np.any(near_thing):
            # Something cuts into the tag: draw the scene there as finely as the tag.
            fine = next((s for s in (4, 2) if w * s <= cfg.width_px and h * s <= cfg.height_px), 1)
            grey, scene_depth = self._draw(T_base_cam, int(u0), int(v0), w, h, fine)
            k = SUPER // fine
            ground = np.repeat(np.repeat(grey, k, 0), k, 1)
            scene_depth = np.repeat(np.repeat(scene_depth, k, 0), k, 1)
            cover = np.where(scene_depth < plane - OCCLUSION_MARGIN_M, 0.0, cover)
        mixed = ground + cover * (ink - ground)
        frame[region] = mixed.reshape(h, SUPER, w, SUPER).mean(axis=(1, 3))

    # -- frames ----------------------------------------------------------------------------------

    def radiance(self, data: mujoco.MjData, T_base_cam: np.ndarray, T_base_tool: np.ndarray) -> np.ndarray:
        """The scene as it reaches the lens: float32, 0..255, before blur and noise."""
        cfg = self.cfg
        self._gl.make_current()
        self._update(data, T_base_cam)
        frame, depth = self._draw(T_base_cam, 0, 0, cfg.width_px, cfg.height_px, 1)
        frame = np.ascontiguousarray(frame)
        for tag in cfg.tags:
            self._print(frame, depth, data, T_base_cam, T_base_tool, tag)
        return frame

    def render(
        self,
        data: mujoco.MjData,
        T_base_cam: np.ndarray,
        T_base_tool: np.ndarray,
        rng: np.random.Generator,
    ) -> np.ndarray:
        """One frame, uint8 grey, height x width. The MuJoCo world is the arm's base frame."""
        optics = self.cfg.optics
        frame = self.radiance(data, T_base_cam, T_base_tool)
        sigma = optics["psf_sigma_px"]
        frame = cv2.GaussianBlur(frame, (7, 7), sigma) if sigma > 0.0 else frame
        spread = np.sqrt(optics["read_noise_dn"] ** 2 + frame / np.float32(optics["electrons_per_dn"]))
        frame += spread * rng.standard_normal(frame.shape, dtype=np.float32)
        return np.clip(np.rint(frame), 0, 255).astype(np.uint8)

    def encode(self, image: np.ndarray) -> Frame:
        """JPEG below the size limit. Raises ValueError if even the lowest quality is too large."""
        im = self.cfg.image
        for quality in range(im["jpeg_quality"], im["jpeg_quality_min"] - 1, -im["jpeg_quality_step"]):
            ok, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
            if ok and len(jpeg) <= im["max_jpeg_bytes"]:
                return Frame(jpeg.tobytes(), quality)
        raise ValueError(f"frame does not fit {im['max_jpeg_bytes']} bytes at quality {quality}")
