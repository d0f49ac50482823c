"""Pictures of a run and of a search space: matplotlib for PNG, plotly for the page."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from kincal.results import CoefResult, Curve, RunResult, Scene

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402 the backend comes first

INK, GREY, LIGHT = "#22303c", "#8a97a3", "#d5dce2"
BLUE, ORANGE, GREEN, RED, PURPLE = "#1f6fb4", "#e07b1a", "#2c8a4b", "#c0392b", "#7a4ca0"
CURVE_COLOURS = {"ucb": BLUE, "random": ORANGE, "dopt": GREEN, "vopt": PURPLE}
MARKS = {"ucb": "o", "random": "s", "dopt": "^", "vopt": "D"}

plt.rcParams.update(
    {
        "font.size": 9.5,
        "axes.edgecolor": GREY,
        "axes.labelcolor": INK,
        "xtick.color": INK,
        "ytick.color": INK,
        "axes.titlesize": 10.5,
        "axes.titlecolor": INK,
        "axes.grid": True,
        "grid.color": LIGHT,
        "grid.linewidth": 0.6,
        "legend.frameon": False,
        "axes.spines.top": False,
        "axes.spines.right": False,
    }
)


def _colour(curve: Curve) -> str:
    return CURVE_COLOURS.get(curve.label.split(",")[0], INK)


def _mark(curve: Curve) -> str:
    return MARKS.get(curve.label.split(",")[0], "o")


def _dashed(curve: Curve) -> bool:
    """Comparison runs without pixels are dashed."""
    return "fast" in curve.label


# --------------------------------------------------------------------------- matplotlib


def save_png(result: RunResult, path: Path) -> None:
    """The whole run on one sheet."""
    figure = plt.figure(figsize=(13.5, 10.0), dpi=110, layout="constrained")
    figure.get_layout_engine().set(wspace=0.06)
    grid = figure.add_gridspec(2, 3, width_ratios=[1.15, 1.0, 1.0], height_ratios=[1.0, 1.0])
    figure.suptitle(headline(result), fontsize=12.5, color=INK, x=0.01, ha="left")
    if result.scene is not None:
        draw_scene(figure.add_subplot(grid[0, 0], projection="3d"), result.scene)
    draw_f(figure.add_subplot(grid[0, 1]), result.curves)
    draw_held_out(figure.add_subplot(grid[0, 2]), result.curves, result)
    below = grid[1, :].subgridspec(1, 2)
    draw_coefs(figure.add_subplot(below[0, 0]), result.coefs, "rad")
    draw_coefs(figure.add_subplot(below[0, 1]), result.coefs, "m")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    plt.close(figure)


def headline(result: RunResult) -> str:
    """One line that says how it went."""
    text = (
        f"{result.title}: {result.mode}, {len(result.poses)} poses by {result.acquisition}, "
        f"seed {result.seed}"
    )
    if result.before and result.after:
        text += (
            f".  Held-out RMS over {result.after.n} poses: {result.before.pos_m * 1e3:.1f} mm, "
            f"{result.before.rot_rad * 1e3:.1f} mrad before; {result.after.pos_m * 1e3:.2f} mm, "
            f"{result.after.rot_rad * 1e3:.2f} mrad after"
        )
    return text


def draw_scene(ax: Any, scene: Scene) -> None:
    """Arm at the chosen poses, candidates, mast and view."""
    c = scene.candidates
    ax.scatter(*c.T, s=6, color=GREY, alpha=0.6, linewidths=0, label=f"{len(c)} candidates")
    shades = plt.get_cmap("viridis")(np.linspace(0.05, 0.95, max(len(scene.skeletons), 1)))
    for shade, bones in zip(shades, scene.skeletons, strict=False):
        ax.plot(*bones.T, color=shade, lw=1.1, alpha=0.45)
    if len(scene.skeletons):
        last = scene.skeletons[-1]
        ax.plot(*last.T, color=INK, lw=2.4, marker="o", ms=3.0, label="arm at the last pose")
        tips = scene.skeletons[:, -1, :]
        ax.scatter(
            *tips.T,
            s=26,
            c=shades,
            edgecolors="white",
            linewidths=0.6,
            depthshade=False,
            label="chosen poses, first dark to last bright",
        )
    ax.plot(*scene.mast.T, color=GREY, lw=3)
    for corner in scene.frustum:
        ax.plot(*np.array([scene.camera_m, corner]).T, color=ORANGE, lw=0.8, alpha=0.8)
    ring = np.vstack([scene.frustum, scene.frustum[:1]])
    ax.plot(*ring.T, color=ORANGE, lw=0.8, alpha=0.8, label="camera view")
    x, y = np.meshgrid([-0.5, 1.1], [-0.75, 0.75])
    ax.plot_surface(x, y, np.zeros_like(x), color=LIGHT, alpha=0.35, linewidth=0)
    ax.set(xlim=(-0.5, 1.1), ylim=(-0.8, 0.8), zlim=(0.0, 1.4))
    ax.set_xlabel("x forward [m]", labelpad=1)
    ax.set_ylabel("y left [m]", labelpad=1)
    ax.set_zlabel("z up [m]", labelpad=-3)
    ax.set_box_aspect((1.6, 1.6, 1.4), zoom=0.92)
    ax.tick_params(labelsize=7.5, pad=-1)
    ax.set_title("Arm and chosen poses")
    ax.view_init(elev=21, azim=-58)
    ax.legend(loc="upper left", fontsize=7.5, bbox_to_anchor=(-0.06, 1.0))


def draw_f(ax: Any, curves: list[Curve]) -> None:
    for curve in curves:
        ax.plot(
            [p.number for p in curve.poses],
            [p.f_run for p in curve.poses],
            color=_colour(curve),
            marker=_mark(curve),
            ms=3.5,
            lw=1.4,
            ls="--" if _dashed(curve) else "-",
            label=curve.label,
        )
    ax.axhline(0.0, color=GREY, lw=0.8)
    ax.set(
        xlabel="poses measured", ylabel="f of eq. 6, largest residuals of the run = 1 [-]", ylim=(-1.05, 0.08)
    )
    ax.set_title("Objective: how far the model was off, 0 is perfect")
    ax.xaxis.get_major_locator().set_params(integer=True)
    ax.legend(loc="lower right")


def draw_held_out(ax: Any, curves: list[Curve], result: RunResult) -> None:
    for curve in curves:
        ax.semilogy(
            [p.number for p in curve.poses],
            [p.held_pos_m * 1e3 for p in curve.poses],
            color=_colour(curve),
            marker=_mark(curve),
            ms=3.5,
            lw=1.4,
            ls="--" if _dashed(curve) else "-",
            label=curve.label,
        )
    if result.before:
        ax.axhline(result.before.pos_m * 1e3, color=RED, lw=1.0, ls="--", label="before calibration")
    ax.set(xlabel="poses measured", ylabel="held-out position RMS [mm]")
    ax.set_title(f"Held-out error over {result.after.n if result.after else 0} poses")
    ax.xaxis.get_major_locator().set_params(integer=True)
    ax.legend(loc="center right")


def draw_coefs(ax: Any, coefs: list[CoefResult], unit: str) -> None:
    """Corrections with +-3 sigma bars. With truth known the error is drawn and the injected value is
    written above it; otherwise the estimate itself, on an axis that is linear near zero."""
    small = "mrad" if unit == "rad" else "mm"
    rows = [c for c in coefs if c.unit == unit and c.sigma > 0.0]
    known = any(np.isfinite(c.true) for c in rows)
    value = np.array([(c.error if known else c.estimate) * 1e3 for c in rows])
    bars = np.array([3e3 * c.sigma for c in rows])
    good = np.array([not known or c.inside_3_sigma for c in rows], dtype=bool)
    x = np.arange(len(rows))
    for mask, colour, label in (
        (good, BLUE, "within 3 sigma of the truth" if known else "estimate and 3 sigma"),
        (~good, RED, "further off"),
    ):
        if mask.any():
            ax.errorbar(
                x[mask],
                value[mask],
                yerr=bars[mask],
                fmt="o",
                ms=4,
                color=colour,
                elinewidth=1.4,
                capsize=3,
                label=label,
            )
    ax.axhline(0.0, color=GREY, lw=0.8)
    names = [c.name.removesuffix(f"_{unit}") for c in rows]
    if known:
        top = float(np.max(np.abs(value) + bars, initial=1e-6))
        ax.set_ylim(-1.2 * top, 1.45 * top)
        for i, c in enumerate(rows):
            if c.true != 0.0:
                ax.text(
                    i,
                    value[i] + bars[i] + 0.04 * top,
                    f"true {c.true * 1e3:+.4g}",
                    ha="center",
                    va="bottom",
                    fontsize=7.5,
                    color=INK,
                    rotation=90,
                )
    elif len(rows):
        spread = max(float(np.median(bars)), 1e-6)
        ax.set_yscale("symlog", linthresh=10.0 ** np.ceil(np.log10(spread)))
        ax.set_ylim(
            2.5 * min(float(np.min(value - bars)), -spread), 3.5 * max(float(np.max(value + bars)), spread)
        )
    ax.set_xticks(x, names, rotation=90, fontsize=8)
    ax.set_ylabel(f"{'estimate - true' if known else 'correction'} [{small}]")
    ax.set_title(
        f"{'Angles' if unit == 'rad' else 'Lengths'}: "
        + ("error of the estimate, bars 3 sigma" if known else "estimate, bars 3 sigma")
    )
    if len(rows):
        ax.legend(loc="upper left", fontsize=8, ncols=2)


def save_space_png(scene: Scene, path: Path, title: str, incid_deg: np.ndarray, range_m: np.ndarray) -> None:
    """A search space: where the tool goes, and how well it is seen from there."""
    figure = plt.figure(figsize=(12.5, 5.2), dpi=110, layout="constrained")
    figure.get_layout_engine().set(wspace=0.06)
    figure.suptitle(title, fontsize=12, color=INK, x=0.01, ha="left")
    grid = figure.add_gridspec(1, 3, width_ratios=[1.25, 1.0, 1.0])
    ax = figure.add_subplot(grid[0, 0], projection="3d")
    draw_scene(ax, scene)
    ax.set_title("Candidates and prior poses")
    ax = figure.add_subplot(grid[0, 1])
    dots = ax.scatter(
        scene.candidates[:, 0], scene.candidates[:, 1], c=scene.candidates[:, 2], s=9, cmap="viridis"
    )
    figure.colorbar(dots, ax=ax, label="tool height z [m]")
    ax.set(xlabel="x forward [m]", ylabel="y left [m]", title="Seen from above", aspect="equal")
    ax = figure.add_subplot(grid[0, 2])
    ax.scatter(range_m, incid_deg, s=9, color=BLUE, linewidths=0, alpha=0.7)
    ax.set(xlabel="camera to tool [m]", ylabel="incidence of the tag [deg]", title="How candidates are seen")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    plt.close(figure)


def save_review_png(
    names: list[str],
    units: list[str],
    value: np.ndarray,
    sigma: np.ndarray,
    correlation: np.ndarray,
    path: Path,
    title: str,
) -> None:
    """A proposal: corrections with error bars, and which of them hang together."""
    figure = plt.figure(figsize=(13.0, 5.6), dpi=110, layout="constrained")
    figure.suptitle(title, fontsize=12, color=INK, x=0.01, ha="left")
    grid = figure.add_gridspec(1, 3, width_ratios=[1.0, 1.0, 1.1])
    lines = [
        CoefResult(n, u, float("nan"), v, s, "")
        for n, u, v, s in zip(names, units, value, sigma, strict=True)
    ]
    for i, unit in enumerate(("rad", "m")):
        draw_coefs(figure.add_subplot(grid[0, i]), lines, unit)
    ax = figure.add_subplot(grid[0, 2])
    shown = ax.imshow(correlation, cmap="RdBu_r", vmin=-1, vmax=1)
    ax.grid(False)
    ax.set_xticks(range(len(names)), names, rotation=90, fontsize=6.5)
    ax.set_yticks(range(len(names)), names, fontsize=6.5)
    ax.set_title("Correlation of the estimates")
    figure.colorbar(shown, ax=ax, shrink=0.85, label="correlation [-]")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    plt.close(figure)


# --------------------------------------------------------------------------- plotly

_LAYOUT: dict[str, Any] = {
    "template": "plotly_white",
    "font": {"family": "system-ui, sans-serif", "size": 13, "color": INK},
}


def _line3(points: np.ndarray, **kw: Any) -> go.Scatter3d:
    return go.Scatter3d(x=points[:, 0], y=points[:, 1], z=points[:, 2], **kw)


def page_scene(scene: Scene, result: RunResult) -> go.Figure:
    figure = go.Figure()
    figure.add_trace(
        _line3(
            scene.candidates,
            mode="markers",
            name=f"{len(scene.candidates)} candidates",
            marker={"size": 2, "color": GREY, "opacity": 0.45},
            hoverinfo="skip",
        )
    )
    steps = np.linspace(0.05, 0.95, max(len(scene.skeletons), 1))
    from plotly.colors import sample_colorscale

    shades = sample_colorscale("Viridis", list(steps))
    for i, bones in enumerate(scene.skeletons):
        figure.add_trace(
            _line3(
                bones,
                mode="lines",
                line={"width": 3, "color": shades[i]},
                opacity=0.45,
                name="arm at the poses",
                legendgroup="arms",
                showlegend=i == 0,
                hoverinfo="skip",
            )
        )
    if len(scene.skeletons):
        tips = scene.skeletons[:, -1, :]
        text = [
            f"pose {p.number}, {'first look' if p.first_look else f'candidate {p.candidate}'}"
            f"<br>servo steps {p.servo_steps}<br>residual "
            f"{p.res_pos_m * 1e3:.2f} mm, {p.res_rot_rad * 1e3:.2f} mrad<br>f {p.f:.3f}"
            for p in result.poses[: len(tips)]
        ]
        figure.add_trace(
            _line3(
                scene.skeletons[-1],
                mode="lines+markers",
                name="arm at the last pose",
                line={"width": 7, "color": INK},
                marker={"size": 4, "color": INK},
                hoverinfo="skip",
            )
        )
        figure.add_trace(
            _line3(
                tips,
                mode="markers+text",
                name="chosen poses, in order",
                hovertext=text,
                hoverinfo="text",
                text=[str(p.number) for p in result.poses[: len(tips)]],
                textposition="top center",
                textfont={"size": 11},
                marker={
                    "size": 6,
                    "color": list(range(1, len(tips) + 1)),
                    "colorscale": "Viridis",
                    "line": {"width": 1, "color": "white"},
                },
            )
        )
    figure.add_trace(
        _line3(
            scene.mast, mode="lines", line={"width": 9, "color": GREY}, name="camera mast", hoverinfo="skip"
        )
    )
    rays = np.vstack(
        [p for corner in scene.frustum for p in (scene.camera_m, corner, np.full(3, np.nan))]
        + [np.vstack([scene.frustum, scene.frustum[:1]])]
    )
    figure.add_trace(
        _line3(rays, mode="lines", line={"width": 2, "color": ORANGE}, name="camera view", hoverinfo="skip")
    )
    figure.add_trace(
        go.Mesh3d(
            x=[-0.5, 1.1, 1.1, -0.5],
            y=[-0.75, -0.75, 0.75, 0.75],
            z=[0, 0, 0, 0],
            i=[0, 0],
            j=[1, 2],
            k=[2, 3],
            color=LIGHT,
            opacity=0.5,
            hoverinfo="skip",
        )
    )
    figure.update_layout(
        **_LAYOUT,
        height=620,
        margin={"l": 0, "r": 0, "t": 10, "b": 0},
        legend={"x": 0.0, "y": 1.0},
        scene={
            "xaxis_title": "x forward [m]",
            "yaxis_title": "y left [m]",
            "zaxis_title": "z up [m]",
            "aspectmode": "data",
            "camera": {"eye": {"x": 1.15, "y": -1.75, "z": 0.8}, "center": {"x": 0, "y": 0, "z": -0.12}},
        },
    )
    return figure


def page_progress(result: RunResult) -> go.Figure:
    figure = make_subplots(
        rows=1,
        cols=2,
        subplot_titles=("Objective f of eq. 6 (largest residuals of the run = 1)", "Held-out position error"),
        horizontal_spacing=0.1,
    )
    for curve in result.curves:
        style = {
            "line": {"color": _colour(curve), "dash": "dash" if _dashed(curve) else "solid"},
            "mode": "lines+markers",
            "legendgroup": curve.label,
            "name": curve.label,
        }
        x = [p.number for p in curve.poses]
        figure.add_trace(go.Scatter(x=x, y=[p.f_run for p in curve.poses], **style), row=1, col=1)
        figure.add_trace(
            go.Scatter(x=x, y=[p.held_pos_m * 1e3 for p in curve.poses], showlegend=False, **style),
            row=1,
            col=2,
        )
    if result.before and result.curves:
        # a trace, because annotations of shapes do not follow a logarithmic axis
        last = max(len(c.poses) for c in result.curves)
        figure.add_trace(
            go.Scatter(
                x=[1, last],
                y=[result.before.pos_m * 1e3] * 2,
                mode="lines",
                name="before calibration",
                line={"color": RED, "dash": "dot", "width": 1.5},
            ),
            row=1,
            col=2,
        )
    figure.update_xaxes(title_text="poses measured")
    figure.update_yaxes(title_text="f [-]", row=1, col=1)
    figure.update_yaxes(title_text="position RMS [mm]", type="log", row=1, col=2)
    figure.update_layout(**_LAYOUT, height=430, margin={"l": 60, "r": 20, "t": 40, "b": 50})
    return figure


def page_coefs(result: RunResult) -> go.Figure:
    """Estimate minus true with 3-sigma bars (or the estimate itself when truth is unknown)."""
    known = any(c.true == c.true for c in result.coefs)
    pick: Callable[[CoefResult], float] = (lambda c: c.error) if known else (lambda c: c.estimate)
    what = "estimate - true" if known else "estimate"
    figure = make_subplots(
        rows=1,
        cols=2,
        subplot_titles=(f"Angles: {what}, bars 3 sigma", f"Lengths: {what}, bars 3 sigma"),
        horizontal_spacing=0.1,
    )
    for col, (unit, small) in enumerate((("rad", "mrad"), ("m", "mm")), 1):
        rows = [c for c in result.coefs if c.unit == unit and c.sigma > 0.0]
        colours = [BLUE if not known or c.inside_3_sigma else RED for c in rows]
        hover = [
            f"{c.name}<br>estimate {c.estimate * 1e3:.3f} ± {c.sigma * 1e3:.3f} {small}"
            + (f"<br>true {c.true * 1e3:.3f} {small}" if known else "")
            for c in rows
        ]
        figure.add_trace(
            go.Scatter(
                x=[c.name.removesuffix(f"_{unit}") for c in rows],
                y=[pick(c) * 1e3 for c in rows],
                mode="markers",
                error_y={
                    "type": "data",
                    "array": [3e3 * c.sigma for c in rows],
                    "thickness": 1.4,
                    "width": 4,
                    "color": GREY,
                },
                marker={"color": colours, "size": 8},
                hovertext=hover,
                hoverinfo="text",
                showlegend=False,
            ),
            row=1,
            col=col,
        )
        figure.update_yaxes(title_text=f"[{small}]", row=1, col=col)
    figure.update_xaxes(tickangle=-90)
    figure.update_layout(**_LAYOUT, height=430, margin={"l": 60, "r": 20, "t": 40, "b": 90})
    return figure
