"""Detections without pixels: the same geometry, noise and arithmetic as camera plus detector.

Corners of the tags in view get Gaussian noise, part of which every frame of a resting scene repeats, and the
detector's own arithmetic (pnp.py) turns them into a pose, its alternative and its covariance. With noise
"isotropic" the true pose gets a fixed noise instead, anew in each frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import mujoco
import numpy as np

from . import geom, pnp
from .camera import OCCLUSION_MARGIN_M, Config, Tag

NOISES = ("corners", "isotropic")
MAX_TAGS = 4
# Corners that moved less than this [px] since the frame before: the scene rests.
_REST_PX = 0.02
# Points of a tag, in units of its printed half edge (white border included), that must all be in sight.
_RING = np.array([[x, y] for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)])
_PRINT = 10 / 8


@dataclass(frozen=True)
class Visible:
    """A tag in view: its corners [px] without noise and its incidence [rad]."""

    tag: Tag
    corner_px: np.ndarray
    incidence_rad: float


def _in_image(cfg: Config, px: np.ndarray) -> bool:
    m = cfg.fast["margin_px"]
    return bool(np.all(px >= m) and np.all(px <= np.array([cfg.width_px, cfg.height_px]) - 1.0 - m))


def _clear(cfg: Config, model, data, T_base_cam, T_base_tag, half_m: float) -> bool:
    """True if nothing stands between the camera and the points of the tag."""
    eye = T_base_cam[:3, 3]
    hit = np.zeros(1, np.int32)
    for x, y in _RING * half_m * _PRINT:
        ray = T_base_tag[:3, :3] @ [x, y, 0.0] + T_base_tag[:3, 3] - eye
        length = np.linalg.norm(ray)
        ray /= length
        start = eye + cfg.optics["near_m"] * ray
        d = mujoco.mj_ray(model, data, start, ray, None, 1, -1, hit)
        if 0.0 <= d < length - cfg.optics["near_m"] - OCCLUSION_MARGIN_M:
            return False
    return True


def visible_tags(cfg: Config, model, data, T_base_cam, T_base_tool) -> list[Visible]:
    """Tags that the camera sees whole: facing it, in the image, large enough and not hidden."""
    T_cam_tool = np.linalg.inv(T_base_cam) @ T_base_tool
    found = []
    for tag in cfg.tags:
        T = T_cam_tool @ tag.T_tool_tag
        if T[2, 3] <= cfg.optics["near_m"]:
            continue
        along = float(T[:3, 2] @ T[:3, 3]) / float(np.linalg.norm(T[:3, 3]))
        incidence = float(np.arccos(np.clip(along, -1.0, 1.0)))
        corners = pnp.tool_corners(tag.T_tool_tag, tag.size_m)
        px = pnp.project(cfg.K, T_cam_tool[:3, :3], T_cam_tool[:3, 3], corners)
        edge = np.linalg.norm(px - np.roll(px, 1, axis=0), axis=1).min()
        if incidence > np.radians(cfg.fast["max_incidence_deg"]) or edge < cfg.fast["min_edge_px"]:
            continue
        if not _in_image(cfg, px):
            continue
        if _clear(cfg, model, data, T_base_cam, T_base_tool @ tag.T_tool_tag, 0.5 * tag.size_m):
            found.append(Visible(tag, px, incidence))
    return found


def _nothing() -> dict:
    return {
        "n_tags": 0,
        "tag_id": [-1] * MAX_TAGS,
        "p_cam_tool_m": [0.0] * 3,
        "q_cam_tool_wxyz": [1.0, 0.0, 0.0, 0.0],
        "cov": [0.0] * 21,
        "p_alt_m": [0.0] * 3,
        "q_alt_wxyz": [1.0, 0.0, 0.0, 0.0],
        "rms_px": 0.0,
        "rms_alt_px": 0.0,
        "range_m": 0.0,
        "incid_rad": 0.0,
        "u_px": 0.0,
        "v_px": 0.0,
        "corner_px": [0.0] * (8 * MAX_TAGS),
    }


def _isotropic(cfg: Config, T_cam_tool: np.ndarray, rng) -> tuple[pnp.Pose, np.ndarray]:
    sp = cfg.fast["isotropic_position_m"]
    sr = np.radians(cfg.fast["isotropic_rotation_deg"])
    p = T_cam_tool[:3, 3] + sp * rng.standard_normal(3)
    R = cv2.Rodrigues(sr * rng.standard_normal(3))[0] @ T_cam_tool[:3, :3]
    return pnp.Pose(R, p, 0.0, R, p, 0.0), np.diag([sp**2] * 3 + [sr**2] * 3)


def _from_corners(cfg: Config, seen: list[Visible], corners: list[np.ndarray]):
    pose = pnp.solve(
        cfg.K, [(v.tag.T_tool_tag, v.tag.size_m, px) for v, px in zip(seen, corners, strict=True)]
    )
    if pose is None:
        return None
    points = np.vstack([pnp.tool_corners(v.tag.T_tool_tag, v.tag.size_m) for v in seen])
    sigma = pnp.corner_sigma(
        pose.rms_px, len(points), cfg.fast["corner_sigma_px"], cfg.fast["corner_sigma_weight"]
    )
    return pose, pnp.covariance(pnp.jacobian(cfg.K, pose.R, pose.p_m, points), sigma)


class FastCamera:
    """Makes the fields of detection_t, all but t_us and seq; cfg.fast["noise"] chooses how."""

    def __init__(self, cfg: Config, model: mujoco.MjModel):
        if cfg.fast["noise"] not in NOISES:
            raise ValueError(f"fast.noise '{cfg.fast['noise']}' is not one of {', '.join(NOISES)}")
        self.cfg, self.model, self.noise = cfg, model, cfg.fast["noise"]
        self._scene: dict[int, tuple[np.ndarray, np.ndarray]] = {}  # tag -> its corners, their lasting noise

    def _corners(self, seen: list[Visible], rng: np.random.Generator) -> list[np.ndarray]:
        sigma, share = self.cfg.fast["corner_sigma_px"], self.cfg.fast["frame_shared"]
        before, self._scene = self._scene, {}
        out = []
        for v in seen:
            old = before.get(v.tag.id)
            rests = old is not None and np.abs(old[0] - v.corner_px).max() < _REST_PX
            lasting = old[1] if rests else rng.standard_normal((4, 2))
            self._scene[v.tag.id] = (v.corner_px, lasting)
            noise = np.sqrt(share) * lasting + np.sqrt(1.0 - share) * rng.standard_normal((4, 2))
            out.append(v.corner_px + sigma * noise)
        return out

    def detect(self, data: mujoco.MjData, T_base_cam, T_base_tool, rng: np.random.Generator) -> dict:
        """What the detector would say about a frame taken now."""
        fields = _nothing()
        seen = visible_tags(self.cfg, self.model, data, T_base_cam, T_base_tool)
        if not seen:
            return fields
        corners = self._corners(seen, rng)
        if self.noise == "isotropic":
            answer = _isotropic(self.cfg, np.linalg.inv(T_base_cam) @ T_base_tool, rng)
        else:
            answer = _from_corners(self.cfg, seen, corners)
        if answer is None:
            return fields
        pose, cov = answer
        u, v, w = self.cfg.K @ pose.p_m
        n = len(seen)
        fields["n_tags"] = n
        fields["tag_id"][:n] = [s.tag.id for s in seen]
        fields["corner_px"][: 8 * n] = np.concatenate([c.ravel() for c in corners]).tolist()
        fields |= {
            "p_cam_tool_m": pose.p_m.tolist(),
            "q_cam_tool_wxyz": geom.quat(pose.R).tolist(),
            "cov": cov[np.triu_indices(6)].tolist(),
            "p_alt_m": pose.p_alt_m.tolist(),
            "q_alt_wxyz": geom.quat(pose.R_alt).tolist(),
            "rms_px": float(pose.rms_px),
            "rms_alt_px": float(pose.rms_alt_px),
            "range_m": float(np.linalg.norm(pose.p_m)),
            "incid_rad": min(s.incidence_rad for s in seen),
            "u_px": float(u / w),
            "v_px": float(v / w),
        }
        return fields
