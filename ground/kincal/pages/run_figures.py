"""Figures of a run. Each function draws plain results; none computes an answer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from kincal.pages import scene as scene3
from kincal.pages import theme
from kincal.results import CoefResult, Curve, RunResult, Scene

COLOURS = {
    "ucb": theme.BLUE,
    "random": theme.ORANGE,
    "dopt": theme.GREEN,
    "vopt": theme.PURPLE,
    "rate": theme.INK,
}
MARKS = {"ucb": "circle", "random": "square", "dopt": "triangle-up", "vopt": "diamond", "rate": "cross"}
MILLI = {"rad": "mrad", "m": "mm"}
KINDS = {"rad": "Angles", "m": "Lengths"}
_SEEN_M = 1e-6  # an error before calibration that is drawn; a healthy arm has none
OBJECTIVE = "Objective −f (eq. 6): size of the residual, largest = 1"
HELD_OUT = "Held-out position error"


def headline(result: RunResult) -> str:
    """One line that says how it went."""
    choice = f"{len(result.poses)} poses by {result.acquisition}"
    text = f"{result.title}: {result.mode}, {choice}, seed {result.seed}"
    if not (result.before and result.after):
        return text
    return (
        f"{text}<br><span style='font-size:13px'>held-out RMS over {result.after.n} poses: "
        f"{result.before.pos_m * 1e3:.1f} mm, {result.before.rot_rad * 1e3:.1f} mrad before; "
        f"{result.after.pos_m * 1e3:.2f} mm, {result.after.rot_rad * 1e3:.2f} mrad after</span>"
    )


def arm(scene: Scene, result: RunResult) -> go.Figure:
    """The arm at the measured poses, the candidates and the camera."""
    figure = theme.figure(640, margin={"l": 0, "r": 0, "t": 8, "b": 0}, scene=scene3.layout())
    figure.add_traces(_scene_traces(scene, result))
    return figure.update_layout(legend={"x": 0.0, "y": 1.0, "itemsizing": "constant"})


def _scene_traces(scene: Scene, result: RunResult) -> list[go.Scatter3d | go.Mesh3d]:
    n = len(scene.candidates)
    cloud = scene3.dots(scene.candidates, theme.GREY, 1.6, f"{n} candidates", hoverinfo="skip")
    out = [
        scene3.ground_trace(scene),
        cloud,
        *scene3.arm_traces(scene.skeletons, "arm at the measured poses, blue first"),
    ]
    if len(scene.skeletons):
        tips = scene.skeletons[:, -1, :]
        out.append(scene3.pose_trace(tips, result.poses[: len(tips)]))
    return [*out, *scene3.camera_traces(scene)]


def progress(result: RunResult) -> go.Figure:
    """Objective and held-out error by number of poses, a line for each method of choosing them."""
    figure = make_subplots(rows=1, cols=2, subplot_titles=(OBJECTIVE, HELD_OUT), horizontal_spacing=0.1)
    theme.styled(figure, 430, legend={"orientation": "h", "y": -0.2}, margin=theme.TITLED)
    _add_progress(figure, result, (1, 1), (1, 2))
    return figure


def _add_progress(
    figure: go.Figure, result: RunResult, left: tuple[int, int], right: tuple[int, int]
) -> None:
    for curve in result.curves:
        _add(figure, _curve(curve, [-p.f_run for p in curve.poses], True), left)
        _add(figure, _curve(curve, [p.held_pos_m * 1e3 for p in curve.poses], False), right)
    if result.before and result.before.pos_m > _SEEN_M and result.curves:
        _add(figure, _before(result), right)
    for at, title in ((left, "−f [-]"), (right, "position RMS [mm]")):
        figure.update_xaxes(title_text="poses measured", row=at[0], col=at[1])
        figure.update_yaxes(title_text=title, row=at[0], col=at[1])
    log = {"type": "log", "dtick": 1, "tickformat": "~g", "minor": {"ticks": "outside"}}
    # linear, all of f but the first pose lies on the axis, however wrong the arm still is (docs/STUDY.md)
    for row, col in (left, right):
        figure.update_yaxes(**log, row=row, col=col)


def _add(figure: go.Figure, trace: go.Scatter, at: tuple[int, int]) -> None:
    figure.add_trace(trace, row=at[0], col=at[1])


def _curve(curve: Curve, values: list[float], named: bool) -> go.Scatter:
    """One run over its poses; comparison runs without pixels are dashed."""
    acquisition = curve.label.split(",")[0]
    colour = COLOURS.get(acquisition, theme.INK)
    return go.Scatter(
        x=[p.number for p in curve.poses], y=values, mode="lines+markers", name=curve.label,
        legendgroup=curve.label, showlegend=named,
        line={"color": colour, "width": 2, "dash": "dash" if "fast" in curve.label else "solid"},
        marker={"symbol": MARKS.get(acquisition, "circle"), "size": 6, "color": colour},
    )  # fmt: skip


def _before(result: RunResult) -> go.Scatter:
    # a trace, not a shape: the range of shapes does not follow a logarithmic axis
    last = max(len(curve.poses) for curve in result.curves)
    error_mm = result.before.pos_m * 1e3 if result.before else float("nan")
    return go.Scatter(
        x=[1, last], y=[error_mm] * 2, mode="lines", name="before calibration",
        line={"color": theme.RED, "dash": "dot", "width": 1.5},
    )  # fmt: skip


# --------------------------------------------------------------------------- corrections


def corrections(coefs: Sequence[CoefResult]) -> go.Figure:
    """Estimate minus true with 3-sigma bars, or the estimate itself where the truth is unknown."""
    figure = make_subplots(
        rows=1, cols=2, horizontal_spacing=0.1, subplot_titles=[coef_title(coefs, u) for u in MILLI]
    )
    theme.styled(figure, 460, margin=theme.TITLED)
    for column, unit in enumerate(MILLI, 1):
        add_corrections(figure, coefs, unit, (1, column))
    return figure


def truth_known(coefs: Sequence[CoefResult]) -> bool:
    """True for runs in simulation."""
    return any(np.isfinite(c.true) for c in coefs)


def coef_title(coefs: Sequence[CoefResult], unit: str) -> str:
    """What add_corrections draws."""
    what = "estimate minus true value" if truth_known(coefs) else "estimate"
    return f"{KINDS[unit]}: {what}, bars 3 sigma"


def add_corrections(figure: go.Figure, coefs: Sequence[CoefResult], unit: str, at: tuple[int, int]) -> None:
    """Estimated coefficients of one unit ("rad" or "m") at (row, column) of a figure."""
    rows = [c for c in coefs if c.unit == unit and c.sigma > 0.0]
    known = truth_known(coefs)
    colours = [theme.BLUE if not known or c.inside_3_sigma else theme.RED for c in rows]
    trace = go.Scatter(
        x=[c.name.removesuffix(f"_{unit}") for c in rows],
        y=[(c.error if known else c.estimate) * 1e3 for c in rows],
        error_y={"type": "data", "array": [3e3 * c.sigma for c in rows], "thickness": 1.4, "width": 4,
                 "color": theme.GREY},
        mode="markers", marker={"color": colours, "size": 8}, showlegend=False,
        hovertext=[_coef_text(c, unit) for c in rows], hoverinfo="text",
    )  # fmt: skip
    _add(figure, trace, at)
    figure.update_yaxes(
        title_text=f"{'error of the estimate' if known else 'correction'} [{MILLI[unit]}]",
        row=at[0],
        col=at[1],
    )
    figure.update_xaxes(tickangle=-90, showgrid=False, row=at[0], col=at[1])
    for c in rows:
        if known and c.true != 0.0:
            figure.add_annotation(**_injected(c, unit), row=at[0], col=at[1])


def _injected(c: CoefResult, unit: str) -> dict[str, Any]:
    """The true value, upright above the bar of a coefficient that was not zero."""
    return {
        "x": c.name.removesuffix(f"_{unit}"),
        "y": (c.error + 3.0 * c.sigma) * 1e3,
        "text": f"true {c.true * 1e3:+.4g}",
        "textangle": -90,
        "yanchor": "bottom",
        "yshift": 4,
        "showarrow": False,
        "font": {"size": 11},
    }


def _coef_text(c: CoefResult, unit: str) -> str:
    text = f"{c.name}<br>estimate {c.estimate * 1e3:.3f} ± {c.sigma * 1e3:.3f} {MILLI[unit]}"
    return text + (f"<br>true {c.true * 1e3:.3f} {MILLI[unit]}" if np.isfinite(c.true) else "")


# --------------------------------------------------------------------------- one sheet


def sheet(result: RunResult) -> go.Figure:
    """The whole run in one picture: arm, progress, corrections."""
    figure = make_subplots(
        rows=3, cols=2, row_heights=[0.3, 0.3, 0.4], vertical_spacing=0.085, horizontal_spacing=0.085,
        specs=[[{"type": "scene", "rowspan": 2}, {}], [None, {}], [{}, {}]],
        subplot_titles=("Arm and measured poses", OBJECTIVE, HELD_OUT,
                        *(coef_title(result.coefs, unit) for unit in MILLI)),
    )  # fmt: skip
    theme.styled(figure, 1360, width=1500, title=headline(result), margin={"t": 100})
    right, top, below = figure.layout.xaxis.domain, figure.layout.yaxis.domain, figure.layout.scene.domain.y
    legend = {"orientation": "h", "yanchor": "bottom"}
    figure.update_layout(
        title={"y": 0.985, "yanchor": "top"},
        legend={**legend, "x": right[0], "y": top[1] + 0.03, "title": {"text": "poses chosen by "}},
        legend2={"x": 0.0, "y": below[0] - 0.02, "yanchor": "bottom", "itemsizing": "constant"},
    )
    if result.scene is not None:
        traces = [trace.update(legend="legend2") for trace in _scene_traces(result.scene, result)]
        figure.add_traces(traces, rows=[1] * len(traces), cols=[1] * len(traces))
        figure.update_layout(scene=scene3.layout(1.3), scene_camera_center_z=-0.38)  # room for the legend
    _add_progress(figure, result, (1, 2), (2, 2))
    add_corrections(figure, result.coefs, "rad", (3, 1))
    add_corrections(figure, result.coefs, "m", (3, 2))
    return figure
