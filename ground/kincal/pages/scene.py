"""The arm in three dimensions: candidates, postures, camera. Lengths in metres, base frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from kincal.pages import theme
from kincal.results import PoseLine, Scene

AXES = {"xaxis_title": "x forward [m]", "yaxis_title": "y left [m]", "zaxis_title": "z up [m]"}
CAMERA = {"eye": {"x": 1.13, "y": -1.56, "z": 0.7}, "center": {"x": 0.0, "y": 0.0, "z": -0.12}}
_GROUND_MARGIN_M = 0.1


def layout(distance: float = 1.0) -> dict[str, Any]:
    """Layout of a scene: names of the axes, true proportions, seen from the front right. distance: larger
    where it has less width for its height."""
    eye = {axis: distance * x for axis, x in CAMERA["eye"].items()}
    return {**AXES, "aspectmode": "data", "camera": {**CAMERA, "eye": eye}}


def line(points: np.ndarray, colour: str, width: float, name: str, **style: Any) -> go.Scatter3d:
    """A line through points (n, 3); rows of NaN break it."""
    return go.Scatter3d(
        x=points[:, 0], y=points[:, 1], z=points[:, 2], mode="lines", name=name, hoverinfo="skip",
        line={"color": colour, "width": width}, **style,
    )  # fmt: skip


def dots(points: np.ndarray, colour: str, size: float, name: str, **style: Any) -> go.Scatter3d:
    """Dots at points (n, 3)."""
    return go.Scatter3d(
        x=points[:, 0], y=points[:, 1], z=points[:, 2], mode="markers", name=name,
        marker={"color": colour, "size": size, "opacity": 0.75, "line": {"width": 0}}, **style,
    )  # fmt: skip


def camera_traces(scene: Scene) -> list[go.Scatter3d]:
    """The mast, and the image's corners as rays from the camera."""
    gap = np.full(3, np.nan)
    rays = [point for corner in scene.frustum for point in (scene.camera_m, corner, gap)]
    view = np.vstack([*rays, scene.frustum, scene.frustum[:1]])
    return [
        line(scene.mast, theme.GREY, 9, "camera mast"),
        line(view, theme.ORANGE, 2, "camera view"),
    ]


def ground_trace(scene: Scene) -> go.Mesh3d:
    """The plane z = 0 under everything that is drawn."""
    points = np.vstack([scene.candidates, *scene.skeletons, scene.mast])[:, :2]
    (x0, y0), (x1, y1) = points.min(axis=0) - _GROUND_MARGIN_M, points.max(axis=0) + _GROUND_MARGIN_M
    return go.Mesh3d(
        x=[x0, x1, x1, x0], y=[y0, y0, y1, y1], z=[0.0] * 4, i=[0, 0], j=[1, 2], k=[2, 3],
        color=theme.GRID, opacity=0.45, hoverinfo="skip",
    )  # fmt: skip


def arm_traces(skeletons: np.ndarray, name: str) -> list[go.Scatter3d]:
    """The arm at several poses (poses, points, 3), first dark to last bright, the last one in full."""
    out = [
        line(bones, shade, 3, name, opacity=0.35, legendgroup="arms", showlegend=i == 0)
        for i, (bones, shade) in enumerate(zip(skeletons, theme.shades(len(skeletons)), strict=True))
    ]
    if len(skeletons):
        last = line(skeletons[-1], theme.INK, 7, "arm at the last pose")
        last.update(mode="lines+markers", marker={"size": 4, "color": theme.INK})
        out.append(last)
    return out


def pose_trace(tips_m: np.ndarray, poses: Sequence[PoseLine]) -> go.Scatter3d:
    """Tool positions (n, 3) of the measured poses, coloured in their order; numbers on hover, those of the
    first and the last also beside them: all of them would hide the arm."""
    ends = {0, len(poses) - 1}
    return go.Scatter3d(
        x=tips_m[:, 0], y=tips_m[:, 1], z=tips_m[:, 2], mode="markers+text",
        name="measured poses, blue first",
        hovertext=[_pose_text(p) for p in poses], hoverinfo="text",
        text=[str(p.number) if i in ends else "" for i, p in enumerate(poses)],
        textposition="top center", textfont={"size": 12},
        marker={"size": 3.5, "color": list(range(1, len(tips_m) + 1)), "colorscale": theme.ORDER,
                "line": {"width": 1, "color": theme.PAPER}},
    )  # fmt: skip


def _pose_text(p: PoseLine) -> str:
    return (
        f"pose {p.number}, {'initial' if p.local else f'candidate {p.candidate}'}"
        f"<br>servo steps {p.servo_steps}"
        f"<br>residual {p.res_pos_m * 1e3:.2f} mm, {p.res_rot_rad * 1e3:.2f} mrad<br>f {p.f:.3f}"
    )
