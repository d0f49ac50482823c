"""Detections without pixels: the geometry of camera plus detector, with simpler noise.

Corners of the tags in view get Gaussian noise, independent and of one sigma, part of which every frame of a
resting scene repeats. pnp.py makes a pose of them, its alternative and its covariance of first order. The
detector has noise of edges and sums over the tilts of a tag seen from the front (docs/METHOD.md 19); nothing
here does. With noise "isotropic" the true pose gets a fixed noise instead, anew in each frame.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import mujoco
import numpy as np

from ..transforms import quaternion
from . import pnp
from .camera import Config
from .tag_renderer import OCCLUSION_MARGIN_M
from .tags import Tag

MAX_TAGS = 4
# Corners that moved less than this [px] since the frame before: the scene rests.
_REST_PX = 0.02
_UPPER = np.ravel_multi_index(np.triu_indices(6), (6, 6))
PoseAndCovariance = tuple[pnp.Pose, np.ndarray]


@dataclass(frozen=True)
class Visible:
    """A tag in view: its corners (4, 2) [px] without noise, and its incidence [rad]."""

    tag: Tag
    corner_px: np.ndarray
    incidence_rad: float


def visible_tags(
    cfg: Config, model: mujoco.MjModel, data: mujoco.MjData, T_base_cam: np.ndarray, T_base_tool: np.ndarray
) -> list[Visible]:
    """Tags that the camera sees whole: facing it, in the image, large enough and not hidden."""
    T_cam_tool = np.linalg.inv(T_base_cam) @ T_base_tool
    return [
        seen
        for seen in _facing_tags(cfg, T_cam_tool)
        if _in_image(cfg, seen.corner_px)
        and _unobstructed(cfg, model, data, T_base_cam, T_base_tool @ seen.tag.T_tool_tag, seen.tag)
    ]


def _facing_tags(cfg: Config, T_cam_tool: np.ndarray) -> Iterator[Visible]:
    """Tags in front of the camera that are turned to it and large enough."""
    near_m, detection = cfg.optics["near_m"], cfg.detection
    most_rad = math.radians(detection["max_incidence_deg"])
    R, p = T_cam_tool[:3, :3], T_cam_tool[:3, 3]
    for tag in cfg.tags:
        T = T_cam_tool @ tag.T_tool_tag
        p_tag = T[:3, 3]
        if T[2, 3] <= near_m:
            continue
        cosine = float(T[:3, 2] @ p_tag) / _length(p_tag)
        incidence = float(np.arccos(min(max(cosine, -1.0), 1.0)))
        if incidence > most_rad:
            continue
        px = pnp.project(cfg.K, R, p, tag.tool_corners_m)
        if _shortest_edge(px.tolist()) >= detection["min_edge_px"]:
            yield Visible(tag, px, incidence)


# For a few corners plain numbers are quicker than arrays.
def _shortest_edge(corners: list[list[float]]) -> float:
    before = (corners[-1], *corners[:-1])
    edges = ((u - a, v - b) for (u, v), (a, b) in zip(corners, before, strict=True))
    return math.sqrt(min(du * du + dv * dv for du, dv in edges))


def _in_image(cfg: Config, px: np.ndarray) -> bool:
    m = cfg.detection["margin_px"]
    right, bottom = cfg.width_px - 1.0 - m, cfg.height_px - 1.0 - m
    return all(m <= u <= right and m <= v <= bottom for u, v in px.tolist())


def _unobstructed(
    cfg: Config,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    T_base_cam: np.ndarray,
    T_base_tag: np.ndarray,
    tag: Tag,
) -> bool:
    """True if nothing stands between the camera and the points of the tag."""
    lens, near_m = T_base_cam[:3, 3], cfg.optics["near_m"]
    rays = tag.in_sight_m @ T_base_tag[:3, :3].T + T_base_tag[:3, 3] - lens
    lengths = np.sqrt((rays * rays).sum(1))
    rays /= lengths[:, None]
    clear_m = (lengths - near_m - OCCLUSION_MARGIN_M).tolist()
    hit = np.zeros(1, np.int32)
    for origin, ray, clear in zip(lens + near_m * rays, rays, clear_m, strict=True):
        if 0.0 <= mujoco.mj_ray(model, data, origin, ray, None, 1, -1, hit) < clear:
            return False
    return True


def _length(v: np.ndarray) -> float:
    """The same bits as numpy.linalg.norm."""
    return math.sqrt(v @ v)


def _no_detection() -> dict[str, Any]:
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


def _tag_fields(seen: list[Visible], corners: list[np.ndarray]) -> dict[str, Any]:
    """Fields of a detection about the tags in it."""
    fields, n = _no_detection(), len(seen)
    fields["n_tags"] = n
    fields["tag_id"][:n] = [s.tag.id for s in seen]
    fields["corner_px"][: 8 * n] = np.concatenate([c.ravel() for c in corners]).tolist()
    fields["incid_rad"] = min(s.incidence_rad for s in seen)
    return fields


def _pose_fields(K: np.ndarray, pose: pnp.Pose, cov: np.ndarray) -> dict[str, Any]:
    """Fields of a detection about the tool's pose."""
    u, v, w = (K @ pose.p_m).tolist()
    return {
        "p_cam_tool_m": pose.p_m.tolist(),
        "q_cam_tool_wxyz": quaternion(pose.R).tolist(),
        "cov": cov.take(_UPPER).tolist(),
        "p_alt_m": pose.p_alt_m.tolist(),
        "q_alt_wxyz": quaternion(pose.R_alt).tolist(),
        "rms_px": pose.rms_px,
        "rms_alt_px": pose.rms_alt_px,
        "range_m": _length(pose.p_m),
        "u_px": u / w,
        "v_px": v / w,
    }


class DetectionModel:
    """Makes the fields of detection_t, all but t_us and seq; the setting detection.noise chooses how.

    Raises ValueError for an unknown noise.
    """

    def __init__(self, cfg: Config, model: mujoco.MjModel):
        self.cfg, self.model, self._solver = cfg, model, pnp.Solver(cfg.K)
        # Of the frame before, by tag: corners without noise [px], noise that a resting scene repeats.
        self._before: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        # Of the frame before: where everything stood, and the tags in view.
        self._scene: tuple[bytes, ...] = ()
        self._seen: list[Visible] = []

    def detect(
        self,
        data: mujoco.MjData,
        T_base_cam: np.ndarray,
        T_base_tool: np.ndarray,
        rng: np.random.Generator,
    ) -> dict[str, Any]:
        """What the detector would report about a frame taken now, by field name."""
        seen = self._visible(data, T_base_cam, T_base_tool)
        if not seen:
            return _no_detection()
        corners = self._noisy_corners(seen, rng)
        if self.cfg.detection["noise"] == "isotropic":
            pose = _isotropic(self.cfg, np.linalg.inv(T_base_cam) @ T_base_tool, rng)
        else:
            pose = self._from_corners(seen, corners)
        if pose is None:
            return _no_detection()
        return _tag_fields(seen, corners) | _pose_fields(self.cfg.K, *pose)

    def _visible(self, data: mujoco.MjData, T_base_cam: np.ndarray, T_base_tool: np.ndarray) -> list[Visible]:
        """visible_tags(); if nothing has moved since the frame before, its answer."""
        places = (T_base_cam, T_base_tool, data.geom_xpos, data.geom_xmat)
        scene = tuple(array.tobytes() for array in places)
        if scene != self._scene:
            self._scene = scene
            self._seen = visible_tags(self.cfg, self.model, data, T_base_cam, T_base_tool)
        return self._seen

    def _noisy_corners(self, seen: list[Visible], rng: np.random.Generator) -> list[np.ndarray]:
        sigma, share = self.cfg.detection["corner_sigma_px"], self.cfg.detection["frame_shared"]
        repeats, differs = math.sqrt(share), math.sqrt(1.0 - share)
        before, self._before = self._before, {}
        out = []
        for v in seen:
            old = before.get(v.tag.id)
            rests = old is not None and _at_rest(old[0], v.corner_px)
            repeated = old[1] if old is not None and rests else rng.standard_normal((4, 2))
            self._before[v.tag.id] = (v.corner_px, repeated)
            noise = repeats * repeated + differs * rng.standard_normal((4, 2))
            out.append(v.corner_px + sigma * noise)
        return out

    def _from_corners(self, seen: list[Visible], corners: list[np.ndarray]) -> PoseAndCovariance | None:
        """The pose that the detector finds; None if there is none in front of the camera."""
        tags = [v.tag for v in seen]
        solved = self._solver.solve(list(zip(tags, corners, strict=True)))
        if solved is None:
            return None
        pose, information = solved
        known_px, weight = self.cfg.detection["corner_sigma_px"], self.cfg.detection["corner_sigma_weight"]
        sigma = pnp.corner_sigma(pose.rms_px, 4 * len(tags), known_px, weight)
        return pose, pnp.covariance(information, sigma)


def _at_rest(before_px: np.ndarray, now_px: np.ndarray) -> bool:
    """Corners of a tag in two frames."""
    return now_px is before_px or bool(np.abs(before_px - now_px).max() < _REST_PX)


def _isotropic(cfg: Config, T_cam_tool: np.ndarray, rng: np.random.Generator) -> PoseAndCovariance | None:
    """The true pose with the same noise on every axis."""
    sp = cfg.detection["isotropic_position_m"]
    sr = np.radians(cfg.detection["isotropic_rotation_deg"])
    p = T_cam_tool[:3, 3] + sp * rng.standard_normal(3)
    R = cv2.Rodrigues(sr * rng.standard_normal(3))[0] @ T_cam_tool[:3, :3]
    return pnp.Pose(R, p, 0.0, R, p, 0.0), np.diag([sp**2] * 3 + [sr**2] * 3)
