"""Pictures of a search: where candidates were kept, why others were dropped, what orientations there are."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from kincal.geometry import quat_to_R
from kincal.pictures import BLUE, GREEN, GREY, INK, LIGHT, ORANGE, PURPLE, RED, draw_scene
from kincal.results import Scene

from .look import ordinary
from .search import Built

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402 the backend comes first

_GROUPS = (
    ("joint limits or out of reach", ("not reached", "joint limits"), GREY),
    ("not in view", ("too near to or far", "head", "tags", "too few"), ORANGE),
    ("hidden by the arm", ("the arm hides",), PURPLE),
    ("too near as drawn", ("too near as drawn",), RED),
    ("too near with errors", ("too near with errors",), "#7d2a20"),
    ("servo can't reach it, named errors", ("out of the servo's",), "#b8860b"),
    ("servo box not clear", ("servo box",), BLUE),
    ("no way from a hub", ("no clear segment",), "#17a2b8"),
)
_SHOWN = 250  # dots per reason


def group(reason: str) -> int:
    """Which line of the legend a reason belongs to."""
    return next(i for i, (_, starts, _) in enumerate(_GROUPS) if reason.startswith(starts))


def dropped(built: Built) -> list[np.ndarray]:
    """Tool positions of dropped samples by group."""
    out: list[list[np.ndarray]] = [[] for _ in _GROUPS]
    for s in built.samples:
        if s.reason:
            out[group(s.reason)].append(s.p_m)
    return [np.array(x).reshape(-1, 3) for x in out]


def directions(built: Built) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Azimuth and elevation of the tool axis, and spin about it, of every candidate [deg]."""
    R = np.array([quat_to_R(list(c.q_wxyz)) for c in built.struct.cand[0 : ordinary(built.struct)]])
    z, x = R[:, :, 2], R[:, :, 0]
    azimuth = np.degrees(np.arctan2(z[:, 1], z[:, 0]))
    elevation = np.degrees(np.arcsin(np.clip(z[:, 2], -1.0, 1.0)))
    level = np.cross([0.0, 0.0, 1.0], z)
    level /= np.maximum(np.linalg.norm(level, axis=1), 1e-9)[:, None]
    spin = np.degrees(np.arctan2(np.sum(x * np.cross(z, level), axis=1), np.sum(x * level, axis=1)))
    return azimuth, elevation, spin


def save_png(built: Built, scene: Scene, path: Path, title: str) -> None:
    figure = plt.figure(figsize=(16.0, 7.0), dpi=110, layout="constrained")
    figure.suptitle(title, fontsize=12, color=INK, x=0.01, ha="left")
    grid = figure.add_gridspec(1, 3, width_ratios=[1.6, 1.0, 0.9])
    ax = figure.add_subplot(grid[0, 0], projection="3d")
    draw_scene(ax, scene)
    ax.scatter(*scene.candidates.T, s=9, color=GREEN, linewidths=0, label="kept")
    for (label, _, colour), p in zip(_GROUPS, dropped(built), strict=True):
        if len(p):
            ax.scatter(*p[:_SHOWN].T, s=6, color=colour, alpha=0.7, linewidths=0, label=label)
    handles, labels = ax.get_legend_handles_labels()
    keep = [i for i, x in enumerate(labels) if "candidates" not in x and "chosen" not in x]
    ax.legend_.remove()
    figure.legend(
        [handles[i] for i in keep],
        [labels[i].replace("last pose", "last prior pose") for i in keep],
        loc="outside lower left",
        ncol=6,
        fontsize=8.5,
        markerscale=2.0,
    )
    ax.set_box_aspect((1.6, 1.6, 1.4), zoom=0.98)
    ax.set_title("Kept candidates, dropped samples, arm at the last prior pose")
    ax = figure.add_subplot(grid[0, 1])
    azimuth, elevation, spin = directions(built)
    dots = ax.scatter(azimuth, elevation, c=spin, s=14, cmap="twilight", vmin=-180, vmax=180, linewidths=0)
    figure.colorbar(dots, ax=ax, label="spin about the tool axis [deg]")
    ax.set(xlabel="azimuth of the tool axis [deg]", ylabel="elevation [deg]", title="Orientations covered")
    ax = figure.add_subplot(grid[0, 2])
    counts = counted(built)
    ax.barh([x[0] for x in counts], [x[1] for x in counts], color=[x[2] for x in counts], log=True)
    for i, x in enumerate(counts):
        ax.text(x[1] * 1.08, i, str(x[1]), va="center", fontsize=8.5, color=INK)
    ax.set_axisbelow(True)
    ax.set_xlim(0.8, 12.0 * max(x[1] for x in counts))
    ax.invert_yaxis()
    ax.set(xlabel="samples", title=f"What became of {built.n_samples} samples")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    plt.close(figure)


def counted(built: Built) -> list[tuple[str, int, str]]:
    """Legend line, samples, colour; first what was kept."""
    n = [0] * len(_GROUPS)
    for reason, count in built.rejected.items():
        n[group(reason)] += count
    rest = built.n_samples - sum(n) - ordinary(built.struct)
    out = [("kept", ordinary(built.struct), GREEN), ("good as drawn, not needed", rest, LIGHT)]
    return [x for x in out + [(g[0], k, g[2]) for g, k in zip(_GROUPS, n, strict=True)] if x[1] > 0]


def save_html(built: Built, scene: Scene, path: Path, title: str) -> None:
    figure = make_subplots(
        rows=1,
        cols=2,
        column_widths=[0.62, 0.38],
        specs=[[{"type": "scene"}, {"type": "xy"}]],
        subplot_titles=("Kept and dropped (click the legend)", "Orientations covered"),
    )

    def dots(p: np.ndarray, name: str, colour: str, size: float, **kw: object) -> None:
        trace = go.Scatter3d(x=p[:, 0], y=p[:, 1], z=p[:, 2], mode="markers", name=name, **kw)
        trace.marker = {"size": size, "color": colour, "opacity": 0.8}
        figure.add_trace(trace, row=1, col=1)

    cands = built.struct.cand[0 : ordinary(built.struct)]
    text = [f"candidate {i}<br>hub {c.hub}, tags {c.tags:02b}" for i, c in enumerate(cands)]
    dots(scene.candidates, f"kept: {len(cands)}", GREEN, 3.5, hovertext=text, hoverinfo="text")
    for (label, _, colour), p in zip(_GROUPS, dropped(built), strict=True):
        if len(p):
            dots(p[: 3 * _SHOWN], f"{label}: {len(p)}", colour, 1.6, visible="legendonly", hoverinfo="skip")
    for i, bones in enumerate(scene.skeletons):
        line = {"width": 6, "color": INK}
        figure.add_trace(
            go.Scatter3d(
                x=bones[:, 0], y=bones[:, 1], z=bones[:, 2], mode="lines", line=line, opacity=0.6,
                name="arm at the prior poses", legendgroup="arm", showlegend=i == 0, hoverinfo="skip",
            ),
            row=1,
            col=1,
        )  # fmt: skip
    gap = np.full(3, np.nan)
    view = np.vstack(
        [p for c in scene.frustum for p in (scene.camera_m, c, gap)] + [scene.frustum, scene.frustum[:1]]
    )
    for p, name, colour in ((scene.mast, "camera mast", GREY), (view, "camera view", ORANGE)):
        figure.add_trace(
            go.Scatter3d(
                x=p[:, 0], y=p[:, 1], z=p[:, 2], mode="lines", name=name, line={"color": colour, "width": 4}
            ),
            row=1,
            col=1,
        )
    azimuth, elevation, spin = directions(built)
    figure.add_trace(
        go.Scatter(
            x=azimuth,
            y=elevation,
            mode="markers",
            showlegend=False,
            hovertext=[f"{t}<br>spin {s:.0f} deg" for t, s in zip(text, spin, strict=True)],
            hoverinfo="text",
            marker={"color": spin, "colorscale": "Twilight", "cmin": -180, "cmax": 180, "size": 6,
                    "colorbar": {"title": "spin [deg]"}},
        ),
        row=1,
        col=2,
    )  # fmt: skip
    figure.update_xaxes(title_text="azimuth of the tool axis [deg]")
    figure.update_yaxes(title_text="elevation [deg]")
    figure.update_layout(
        template="plotly_white",
        title=title,
        height=840,
        margin={"t": 90, "b": 150, "l": 40, "r": 40},
        legend={"x": 0.0, "y": -0.13, "yanchor": "top", "orientation": "h", "itemsizing": "constant"},
        scene={
            "xaxis_title": "x forward [m]",
            "yaxis_title": "y left [m]",
            "zaxis_title": "z up [m]",
            "aspectmode": "data",
            "camera": {"eye": {"x": 1.3, "y": -1.7, "z": 0.8}, "center": {"x": 0.0, "y": 0.0, "z": -0.15}},
        },
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.write_html(path, include_plotlyjs=True)
