"""Residuals of a diagnosis, pose by pose. Each function draws plain results; none computes an answer."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from kincal.pages import theme, words
from kincal.pages.poses import Poses, Range, bulk_range, dots
from kincal.workbench.diagnosis import Diagnosis
from kincal.workbench.evidence.variables import variable_values
from kincal.workbench.fit.least_squares import Fit
from kincal.workbench.report.views import apparent_motion

_BINS = 8
_VARIABLES = 8
_SUSPECTS = 4


def vectors(d: Diagnosis, poses: Poses) -> go.Figure:
    """Residual position vectors over the workspace from above and from the side, before and after the
    accepted effects; colour: the out-of-plane component."""
    fits = _before_after(d)
    before = fits[0][0]
    size_m = max(_typical(before), 1e-12)
    grow = magnification(d)
    views = (("from above", (0, 1, 2)), ("from the side", (0, 2, 1)))
    shown = [(fit, label, view, axes) for fit, _, label in fits for view, axes in views]
    titles = [f"{label}, {view}: {_rms(fit) * 1e3:.2f} mm RMS" for fit, label, view, _ in shown]
    figure = make_subplots(
        rows=len(fits), cols=2, subplot_titles=titles, horizontal_spacing=0.08, vertical_spacing=0.13
    )
    theme.styled(figure, 60 + 440 * len(fits), showlegend=False, coloraxis=_across_bar(2e3 * size_m),
                 margin={"t": 40})  # fmt: skip
    figure.update_annotations(font={"size": theme.FONT_PX})
    for number, (fit, _, _, axes) in enumerate(shown):
        at = {"row": number // 2 + 1, "col": number % 2 + 1}
        for trace in _arrows(fit, axes, grow, 3.0 * size_m, poses):
            figure.add_trace(trace, **at)
        figure.update_xaxes(title_text="xyz"[axes[0]] + " [m]", **at)
        anchor = f"x{number + 1}" if number else "x"
        figure.update_yaxes(title_text="xyz"[axes[1]] + " [m]", scaleanchor=anchor, **at)
    return figure


def magnification(d: Diagnosis) -> float:
    """How much longer than they are `vectors` draws the residuals."""
    before = d.comparison.fit_all
    return 0.1 * (float(np.ptp(before.data.p_m, axis=0).max()) or 1.0) / max(_typical(before), 1e-12)


def _typical(fit: Fit) -> float:
    """A length of residuals [m] that outliers do not move."""
    return 1.2 * float(np.median(np.linalg.norm(fit.evaluation.r[:, :3], axis=1)))


def _rms(fit: Fit) -> float:
    """RMS length of the position residuals [m]."""
    return float(np.sqrt((fit.evaluation.r[:, :3] ** 2).sum(axis=1).mean()))


def _across_bar(limit_mm: float) -> dict[str, object]:
    bar = theme.colour_bar("out-of-plane component [mm]")
    return {"colorscale": theme.SIGNED_STRONG, "cmin": -limit_mm, "cmax": limit_mm, "colorbar": bar}


def _arrows(
    fit: Fit, axes: tuple[int, int, int], grow: float, longest_m: float, poses: Poses
) -> list[go.Scatter]:
    """Shafts as one broken line, heads as markers that are turned and coloured; longer ones are cut."""
    a, b, across = axes
    k = poses.drawn
    p, r = fit.data.p_m[k], fit.evaluation.r[k, :3]
    length = np.linalg.norm(r, axis=1)
    tip = p + grow * r * np.minimum(1.0, longest_m / np.maximum(length, 1e-12))[:, None]
    gap = np.full(len(p), np.nan)
    shaft = {axis: np.column_stack([p[:, i], tip[:, i], gap]).ravel().astype(np.float32)
             for axis, i in (("x", a), ("y", b))}  # fmt: skip
    angle = np.degrees(np.arctan2(r[:, a], r[:, b]))  # of the marker: clockwise from up
    heads = {"symbol": "arrow", "size": 8, "angle": angle.astype(np.float32),
             "color": (r[:, across] * 1e3).astype(np.float32), "coloraxis": "coloraxis"}  # fmt: skip
    far = np.flatnonzero(length > longest_m)
    return [
        go.Scatter(**shaft, mode="lines", line={"color": theme.GREY, "width": 1.2}, hoverinfo="skip"),
        go.Scatter(
            x=tip[:, a].astype(np.float32), y=tip[:, b].astype(np.float32), marker=heads, mode="markers",
            customdata=[fit.data.ids[i] for i in k], meta={"poses": True},
            hovertemplate="pose %{customdata}<extra></extra>",
        ),
        go.Scatter(
            x=tip[far, a].tolist(), y=tip[far, b].tolist(), text=[fit.data.ids[k[i]] for i in far],
            mode="text", textposition="top center", textfont={"size": 11, "color": theme.RED},
            hoverinfo="skip",
        ),
    ]  # fmt: skip


def _trend(
    poses: Poses, x: np.ndarray, y: np.ndarray, limits: Range, colour: str, label: str, named: bool
) -> list[go.Scatter]:
    """Dots, and the mean of each bin with its standard error; few levels are bins themselves."""
    levels = np.unique(x)
    if len(levels) <= 4:
        bins = [x == level for level in levels]
        spread = 0.12 * (float(np.ptp(levels)) or 1.0)
        shown = x + np.random.default_rng(1).uniform(-spread, spread, len(x))
    else:
        edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, _BINS + 1)))
        bins = [(x >= low) & (x <= high) for low, high in itertools.pairwise(edges)]
        shown = x
    bins = [b for b in bins if b.sum() > 1]
    mean = {"x": [x[b].mean() for b in bins], "y": [y[b].mean() for b in bins]}
    error = [y[b].std(ddof=1) / np.sqrt(b.sum()) for b in bins]
    return [
        *dots(poses, shown, y, limits, colour=colour),
        go.Scatter(**mean, mode="lines+markers", name=label, legendgroup=label, showlegend=named,
                   line={"color": colour, "width": 2}, marker={"size": 6, "color": colour},
                   error_y={"type": "data", "array": error, "color": colour, "thickness": 1.4}),
    ]  # fmt: skip


def _panels(
    titles: Sequence[str], per_row: int, height_px: int, ylabel: str, *, shared: bool = True
) -> tuple[go.Figure, list[tuple[int, int]]]:
    """A figure of small panels, and the (row, column) of each."""
    rows = -(-len(titles) // per_row)
    figure = make_subplots(
        rows=rows, cols=per_row, subplot_titles=titles, shared_yaxes=shared,
        horizontal_spacing=0.025 if shared else 0.05,
        vertical_spacing=0.36 / rows,  # three lines of a title
    )  # fmt: skip
    theme.styled(figure, 90 + height_px * rows, margin={"t": 44, "b": 84},
                 legend={"orientation": "h", "y": 0.0, "yref": "container", "yanchor": "bottom"})  # fmt: skip
    figure.update_annotations(font={"size": theme.FONT_PX})
    places = [(i // per_row + 1, i % per_row + 1) for i in range(len(titles))]
    for row in range(1, rows + 1):
        figure.update_yaxes(title_text=ylabel, row=row, col=1)
    return figure, places


def variables(d: Diagnosis, poses: Poses) -> go.Figure:
    """Residual components against the variables that explain most of them, with means of bins."""
    fit = d.comparison.fit_all
    names = [w.variable for w in d.comparison.where[:_VARIABLES]]
    figure, places = _panels(["" for _ in names], 4, 300, "residual [mm]")
    parts = [fit.evaluation.r[:, k] * 1e3 for k in range(3)]
    limits = bulk_range(*parts)
    for name, at in zip(names, places, strict=True):
        x = variable_values(name, fit)
        for part, axis, colour in zip(parts, "xyz", (theme.RED, theme.GREEN, theme.BLUE), strict=True):
            traces = _trend(poses, x, part, limits, colour, axis, named=at == (1, 1))
            figure.add_traces(traces, rows=[at[0]] * len(traces), cols=[at[1]] * len(traces))
        figure.update_xaxes(title_text=words.title(name), row=at[0], col=at[1])
    return figure.update_yaxes(range=limits)


def suspects(d: Diagnosis, poses: Poses) -> go.Figure:
    """The joints with the most evidence: apparent motion against its driver variable, before and after the
    accepted effects."""
    cells = [key for key in d.map_ln_bf if key[0].startswith("joint") and " x " not in key[1]]
    cells = sorted(cells, key=lambda key: -d.map_ln_bf[key])[:_SUSPECTS]
    titles = [f"{place}, ln evidence {d.map_ln_bf[place, variable]:.1f}" for place, variable in cells]
    figure, places = _panels(titles, max(len(cells), 1), 290, "apparent joint motion [mrad]", shared=False)
    moved = {(place, label): apparent_motion(fit, int(place.split()[1])) * 1e3
             for place, _ in cells for fit, _, label in _before_after(d)}  # fmt: skip
    for (place, variable), at in zip(cells, places, strict=True):
        limits = bulk_range(*(y for (where, _), y in moved.items() if where == place))
        for fit, colour, label in _before_after(d):
            x = variable_values(variable, fit)
            traces = _trend(poses, x, moved[place, label], limits, colour, label, named=at == (1, 1))
            figure.add_traces(traces, rows=[at[0]] * len(traces), cols=[at[1]] * len(traces))
        figure.update_xaxes(title_text=words.title(variable), row=at[0], col=at[1])
        figure.update_yaxes(range=limits, row=at[0], col=at[1])
    return figure


def _before_after(d: Diagnosis) -> tuple[tuple[Fit, str, str], ...]:
    """The fit before and after the findings; only one where nothing was added."""
    now = (d.comparison.fit_all, theme.ORANGE, "now")
    return (now,) if d.final is d.comparison.fit_all else (now, (d.final, theme.BLUE, "with the findings"))


def joints(d: Diagnosis) -> go.Figure:
    """RMS motion of each joint alone that would explain the residuals, before and after."""
    figure = theme.figure(
        340, barmode="group", bargap=0.35, legend={"orientation": "h", "y": 1.0, "yanchor": "bottom"}
    )
    for fit, colour, label in _before_after(d):
        n = fit.evaluation.Jq.shape[2]
        size = [float(np.sqrt((apparent_motion(fit, j) ** 2).mean())) * 1e3 for j in range(1, n + 1)]
        figure.add_bar(x=[str(j) for j in range(1, n + 1)], y=size, name=label, marker={"color": colour})
    figure.update_xaxes(title_text="joint", type="category", showgrid=False)
    return figure.update_yaxes(title_text="RMS motion [mrad]")
