"""Camera and tags as they really are, what PnP with the nominal numbers makes of them, and effects."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from .. import geom, tags
from .plant import Effect, Moment, turn

_EXACT = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-15)


@dataclass(frozen=True)
class Optics:
    """Lens, sensor and tags. radial: k1, k2; decentring: p1, p2 (as OpenCV has them); grown_px: how far
    blooming moves every edge of a tag outward; mounts: extra motion of a tag on its mount, by id."""

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    tag_size_m: float
    radial: tuple[float, float] = (0.0, 0.0)
    decentring: tuple[float, float] = (0.0, 0.0)
    grown_px: float = 0.0
    mounts: dict[int, np.ndarray] = field(default_factory=dict)

    @property
    def K(self) -> np.ndarray:
        return np.array([[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]])


def nominal(spec: dict) -> Optics:
    cam = spec["camera"]
    return Optics(cam["fx_px"], cam["fy_px"], cam["cx_px"], cam["cy_px"], spec["tag"][0]["size_m"])


def mount(spec: dict, tag: int) -> np.ndarray:
    """T_tool_tag as the table has it."""
    row = spec["tag"][tag]
    return geom.trans(*row["xyz_m"]) @ geom.rot("y", row["rot_y_rad"])


def _corners(size_m: float) -> np.ndarray:
    return np.column_stack([tags.CORNERS * size_m, np.zeros(4)])


def image(optics: Optics, T_cam_tag: np.ndarray) -> np.ndarray:
    """Corners of a tag in pixels, through the true lens (4x2)."""
    k1, k2 = optics.radial
    lens = np.array([k1, k2, *optics.decentring, 0.0])
    rvec = cv2.Rodrigues(T_cam_tag[:3, :3])[0]
    px, _ = cv2.projectPoints(_corners(optics.tag_size_m), rvec, T_cam_tag[:3, 3], optics.K, lens)
    px = px.reshape(4, 2)
    return _grow(px, optics.grown_px) if optics.grown_px else px


def _grow(px: np.ndarray, by: float) -> np.ndarray:
    """Every edge of the quadrilateral moved outward; the corners are where the edges meet."""
    centre = px.mean(axis=0)
    lines = []
    for a, b in zip(px, np.roll(px, -1, axis=0), strict=True):
        normal = np.array([b[1] - a[1], a[0] - b[0]])
        normal /= np.linalg.norm(normal)
        normal *= np.sign(normal @ (a - centre))
        lines.append(np.array([*normal, normal @ a + by]))
    out = []
    for one, two in zip(np.roll(lines, 1, axis=0), lines, strict=True):
        out.append(np.linalg.solve(np.array([one[:2], two[:2]]), np.array([one[2], two[2]])))
    return np.array(out)


def perceive(table: Optics, px: np.ndarray, near: np.ndarray) -> np.ndarray:
    """T_cam_tag that PnP finds for corners with the numbers of the table. Starts near the truth: the mirrored
    solution is an outlier's business, not an effect's."""
    rvec, tvec = cv2.Rodrigues(near[:3, :3])[0], near[:3, 3].reshape(3, 1).copy()
    rvec, tvec = cv2.solvePnPRefineLM(
        _corners(table.tag_size_m), px, table.K, None, rvec, tvec, criteria=_EXACT
    )
    return geom.pose(tvec.ravel(), cv2.Rodrigues(rvec)[0])


def incidence_rad(T_cam_tag: np.ndarray) -> float:
    """Angle between the ray to the tag and its normal; 0 = seen from the front."""
    ray = T_cam_tag[:3, 3] / np.linalg.norm(T_cam_tag[:3, 3])
    return float(np.arccos(np.clip(T_cam_tag[:3, 2] @ ray, -1.0, 1.0)))


# ---- effects ------------------------------------------------------------------------------------------


class CameraMoved(Effect):
    """The camera stands elsewhere, from the beginning or from one moment on."""

    def __init__(self, shift_m, turn_rad, t0_s: float = -np.inf):
        self.E, self.t0_s = geom.pose(shift_m, turn(turn_rad)), t0_s

    def camera(self, now: Moment):
        return self.E if now.t_s >= self.t0_s else np.eye(4)


class HeadError(Effect):
    """Pan and tilt turn more than their encoders say, and the encoder discs are a little off centre."""

    def __init__(self, k_pan: float, k_tilt: float, wave_rad=(0.0, 0.0), phase_rad=(0.0, 0.0)):
        self.k, self.wave, self.phase = (k_pan, k_tilt), wave_rad, phase_rad

    def head(self, _now: Moment, pan: float, tilt: float):
        (a, b), (wa, wb), (pa, pb) = self.k, self.wave, self.phase
        return pan * (1 + a) + wa * np.sin(pan + pa), tilt * (1 + b) + wb * np.sin(tilt + pb)


class Lens(Effect):
    """Numbers of the camera that differ from the table: any fields of Optics, and the focal length."""

    def __init__(self, focal: float = 0.0, focal_per_k: float = 0.0, t0_c: float = 20.0, **fields):
        self.focal, self.focal_per_k, self.t0_c, self.fields = focal, focal_per_k, t0_c, fields

    def optics(self, now: Moment, optics: Optics):
        scale = 1.0 + self.focal + self.focal_per_k * (now.camera_temp_c - self.t0_c)
        return replace(optics, fx_px=optics.fx_px * scale, fy_px=optics.fy_px * scale, **self.fields)


class PrincipalPoint(Effect):
    def __init__(self, du: float, dv: float):
        self.du, self.dv = du, dv

    def optics(self, _now: Moment, optics: Optics):
        return replace(
            optics, cx_px=optics.cx_px + self.du * optics.fx_px, cy_px=optics.cy_px + self.dv * optics.fy_px
        )


class TagSize(Effect):
    """All tags were printed too large or too small."""

    def __init__(self, share: float):
        self.share = share

    def optics(self, _now: Moment, optics: Optics):
        return replace(optics, tag_size_m=optics.tag_size_m * (1.0 + self.share))


class TagMount(Effect):
    """One tag sits elsewhere on its mount."""

    def __init__(self, tag: int, shift_m, turn_rad):
        self.mounts = {tag: geom.pose(shift_m, turn(turn_rad))}

    def optics(self, _now: Moment, optics: Optics):
        return replace(optics, mounts=self.mounts)


class DepthByIncidence(Effect):
    """Obliquely seen tags come out too near or too far, along the ray."""

    def __init__(self, depth_m: float):
        self.depth_m = depth_m

    def sensed(self, _now: Moment, T_cam_tag: np.ndarray):
        p = T_cam_tag[:3, 3]
        out = T_cam_tag.copy()
        out[:3, 3] = p + self.depth_m * np.tan(incidence_rad(T_cam_tag)) ** 2 * p / np.linalg.norm(p)
        return out


class TiltByIncidence(Effect):
    """Obliquely seen tags come out more frontal (or less) than they are."""

    def __init__(self, turn_rad: float):
        self.turn_rad = turn_rad

    def sensed(self, _now: Moment, T_cam_tag: np.ndarray):
        ray = T_cam_tag[:3, 3] / np.linalg.norm(T_cam_tag[:3, 3])
        axis = np.cross(T_cam_tag[:3, 2], ray)
        length = np.linalg.norm(axis)
        if length < 1e-9:
            return T_cam_tag
        by = self.turn_rad * np.sin(2.0 * incidence_rad(T_cam_tag))
        return geom.pose(T_cam_tag[:3, 3], turn(axis / length * by) @ T_cam_tag[:3, :3])
