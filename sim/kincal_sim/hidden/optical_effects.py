"""Effects on the camera, the pan-tilt unit, the lens and the tags; signs and frames as in plant.Effect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..mechanics.plant import Conditions, Effect, turn
from ..transforms import transform
from .optics import Optics, incidence_rad


class CameraMoved(Effect):
    """The camera stands elsewhere, from the beginning or from the time t0_s on."""

    def __init__(self, shift_m: ArrayLike, turn_rad: ArrayLike, t0_s: float = -np.inf):
        self.E, self.t0_s = transform(shift_m, turn(turn_rad)), t0_s

    def camera_offset(self, at: Conditions) -> np.ndarray:
        """4x4, camera frame"""
        return self.E if at.t_s >= self.t0_s else np.eye(4)


class PanTiltError(Effect):
    """Pan and tilt turn (1 + gain) times what their encoders show, and the discs are a little off centre.

    wave_rad, phase_rad: (pan, tilt) amplitude and phase of the disc's error.
    """

    def __init__(
        self,
        gain_pan: float,
        gain_tilt: float,
        wave_rad: Sequence[float] | np.ndarray = (0.0, 0.0),
        phase_rad: Sequence[float] | np.ndarray = (0.0, 0.0),
    ):
        self.gain, self.wave, self.phase = (gain_pan, gain_tilt), wave_rad, phase_rad

    def pantilt(self, _at: Conditions, pan_rad: float, tilt_rad: float) -> tuple[float, float]:
        """True angles [rad]"""
        (a, b), (wa, wb), (pa, pb) = self.gain, self.wave, self.phase
        pan = pan_rad * (1 + a) + wa * np.sin(pan_rad + pa)
        tilt = tilt_rad * (1 + b) + wb * np.sin(tilt_rad + pb)
        return pan, tilt


class Lens(Effect):
    """Numbers of the camera that differ from the table.

    focal: relative error of the focal length; focal_per_k: its change with the camera's temperature, from
    t0_c on; fields: any other fields of Optics.
    """

    def __init__(self, focal: float = 0.0, focal_per_k: float = 0.0, t0_c: float = 20.0, **fields: Any):
        self.focal, self.focal_per_k, self.t0_c, self.fields = focal, focal_per_k, t0_c, fields

    def optics(self, at: Conditions, optics: Optics) -> Optics:
        """True optics"""
        scale = 1.0 + self.focal + self.focal_per_k * (at.camera_temp_c - self.t0_c)
        return replace(optics, fx_px=optics.fx_px * scale, fy_px=optics.fy_px * scale, **self.fields)


class PrincipalPoint(Effect):
    """The principal point is off by du, dv focal lengths."""

    def __init__(self, du: float, dv: float):
        self.du, self.dv = du, dv

    def optics(self, _at: Conditions, optics: Optics) -> Optics:
        """True optics"""
        cx, cy = optics.cx_px + self.du * optics.fx_px, optics.cy_px + self.dv * optics.fy_px
        return replace(optics, cx_px=cx, cy_px=cy)


class TagSize(Effect):
    """All tags were printed too large by this share."""

    def __init__(self, share: float):
        self.share = share

    def optics(self, _at: Conditions, optics: Optics) -> Optics:
        """True optics"""
        return replace(optics, tag_size_m=optics.tag_size_m * (1.0 + self.share))


class TagMoved(Effect):
    """One tag sits elsewhere on its mount."""

    def __init__(self, tag: int, shift_m: ArrayLike, turn_rad: ArrayLike):
        self.tag_offsets = {tag: transform(shift_m, turn(turn_rad))}

    def optics(self, _at: Conditions, optics: Optics) -> Optics:
        """True optics"""
        return replace(optics, tag_offsets=self.tag_offsets)


class DepthByIncidence(Effect):
    """Obliquely seen tags are reported too near or too far, along the ray: by depth_m at 45 degrees."""

    def __init__(self, depth_m: float):
        self.depth_m = depth_m

    def detected(self, _at: Conditions, T_cam_tag: np.ndarray) -> np.ndarray:
        """4x4"""
        p = T_cam_tag[:3, 3]
        out = T_cam_tag.copy()
        out[:3, 3] = p + self.depth_m * np.tan(incidence_rad(T_cam_tag)) ** 2 * p / np.linalg.norm(p)
        return out


class TiltByIncidence(Effect):
    """Obliquely seen tags are reported more frontal (or less) than they are: by turn_rad at 45 degrees."""

    def __init__(self, turn_rad: float):
        self.turn_rad = turn_rad

    def detected(self, _at: Conditions, T_cam_tag: np.ndarray) -> np.ndarray:
        """4x4"""
        ray = T_cam_tag[:3, 3] / np.linalg.norm(T_cam_tag[:3, 3])
        axis = np.cross(T_cam_tag[:3, 2], ray)
        length = np.linalg.norm(axis)
        if length < 1e-9:
            return T_cam_tag
        by = self.turn_rad * np.sin(2.0 * incidence_rad(T_cam_tag))
        return transform(T_cam_tag[:3, 3], turn(axis / length * by) @ T_cam_tag[:3, :3])
