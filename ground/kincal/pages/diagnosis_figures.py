"""Figures of a diagnosis. Each function draws plain results; none computes an answer."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from kincal.pages import theme
from kincal.workbench.diagnosis import Diagnosis
from kincal.workbench.fit import Fit
from kincal.workbench.nested import NestedModels
from kincal.workbench.power import CONFOUNDED_CHI2, Confounding, Harm
from kincal.workbench.views import apparent_motion, variable_values

_ROW_PX = 30  # of a bar chart
_CONFOUNDING_MAX = 14
_PLAUSIBLE = 10.0  # typical sizes; nothing is larger than that without being known
_BINS = 8
_VARIABLES = 8
_SUSPECTS = 4
_MAP_NAMED = 6  # cells that carry their number
_UNITS = {"t": "s", "temp": "deg C", "payload": "kg", "zcam": "m", "sx": "m", "sy": "m", "sz": "m",
          "incid": "rad", "pan": "rad", "tilt": "rad"}  # fmt: skip


def _short(text: str, width: int) -> str:
    return text if len(text) <= width else text[: width - 1] + "…"


def _bars(height_rows: int, **layout: object) -> go.Figure:
    figure = theme.figure(110 + _ROW_PX * height_rows, showlegend=False, **layout)
    figure.update_yaxes(autorange="reversed", showgrid=False, ticks="")
    return figure


# --------------------------------------------------------------------------- models, probabilities


def nested(models: NestedModels) -> go.Figure:
    """Held-out error of each nested model, a line for each way of holding poses back, and the noise floor."""
    figure = theme.figure(430, legend={"orientation": "h", "y": -0.2})
    for i, block in enumerate(dict.fromkeys(m.block for m in models.models)):
        mine = models.of(block)
        style = {"color": theme.SERIES[i % len(theme.SERIES)]}
        figure.add_scatter(
            x=[m.model for m in mine], y=[m.pos_m * 1e3 for m in mine], mode="lines+markers", name=block,
            line={**style, "width": 2}, marker={**style, "symbol": theme.SYMBOLS[i], "size": 8},
        )  # fmt: skip
    if models.floor.pos_m is not None:
        names = list(dict.fromkeys(m.model for m in models.models))
        figure.add_scatter(
            x=[names[0], names[-1]], y=[models.floor.pos_m * 1e3] * 2, mode="lines",
            name=f"noise floor ({models.floor.source})",
            line={"color": theme.MUTED, "dash": "dash", "width": 1.5},
        )  # fmt: skip
    errors_mm = [m.pos_m * 1e3 for m in models.models]
    figure.update_yaxes(type="log", title_text="held-out position RMS [mm]", tickvals=_ticks(errors_mm))
    last = len(dict.fromkeys(m.model for m in models.models)) - 1
    return figure.update_xaxes(showgrid=False, range=[-0.35, last + 0.35])


def _ticks(values: Sequence[float]) -> list[float]:
    """1, 2, 5, 10 ... around values, for a logarithmic axis."""
    decades = range(int(np.floor(np.log10(min(values)))), int(np.ceil(np.log10(max(values)))) + 1)
    return [float(f"{step}e{decade}") for decade in decades for step in (1, 2, 5)]


def _hypotheses(d: Diagnosis) -> Iterator[tuple[str, float, str, str]]:
    """Label, probability, colour and what it is confounded with."""
    yield "nothing missing", d.probability_none, theme.GREY, ""
    if d.novel:
        what = f"not in the library: {d.novel.location}<br>by {' and '.join(d.novel.depends_on)}"
        yield what, d.novel.probability, theme.RED, ""
    for e in d.effects:
        colour = theme.BLUE if e.accepted else theme.ORANGE
        yield e.name, e.probability, colour, ", ".join(e.confounded_with)


def posterior(d: Diagnosis) -> go.Figure:
    """Probabilities of what may be missing; beside a bar stand effects that it is confounded with."""
    rows = list(_hypotheses(d))
    figure = _bars(len(rows))
    text = [
        f"{p:.2f}" + (f"  = {_short(confounded, 60)}" if confounded else "") for _, p, _, confounded in rows
    ]
    figure.add_bar(
        x=[row[1] for row in rows], y=[row[0] for row in rows], orientation="h",
        marker={"color": [row[2] for row in rows]}, text=text, cliponaxis=False,
        textposition=["inside" if row[1] > 0.9 else "outside" for row in rows],
        insidetextfont={"color": theme.PAPER}, hoverinfo="y+x",
    )  # fmt: skip
    figure.add_vline(x=0.9, line={"color": theme.GREY, "dash": "dot", "width": 1})
    return figure.update_xaxes(range=[0.0, 1.0], title_text="probability, given this library and its priors")


def location_map(d: Diagnosis) -> go.Figure:
    """Where the error enters (row) and what it depends on (column): ln evidence over "nothing missing"."""
    cells = {key: value for key, value in d.map_ln_bf.items() if " x " not in key[1]}
    rows = list(dict.fromkeys(location for location, _ in cells))
    columns = list(dict.fromkeys(variable for _, variable in cells))
    grid = np.full((len(rows), len(columns)), np.nan)
    for (location, variable), value in cells.items():
        grid[rows.index(location), columns.index(variable)] = max(value, 0.0)
    figure = theme.figure(150 + 19 * len(rows), margin={"t": 16})
    figure.add_heatmap(
        z=np.sqrt(grid), x=columns, y=rows, customdata=grid, text=_named_cells(grid), texttemplate="%{text}",
        colorscale=theme.AMOUNT, zmin=0.0, zmax=float(np.sqrt(max(3.0, np.nanmax(grid)))), xgap=1, ygap=1,
        hovertemplate="%{y} by %{x}: %{customdata:.1f}<extra></extra>", colorbar=_root_bar(grid),
    )  # fmt: skip
    figure.update_yaxes(autorange="reversed", showgrid=False, dtick=1, tickfont={"size": 11})
    return figure.update_xaxes(showgrid=False, tickangle=-60, dtick=1, tickfont={"size": 11})


def _named_cells(grid: np.ndarray) -> list[list[str]]:
    """Numbers for the strongest cells, nothing for the others."""
    best = np.sort(grid[np.isfinite(grid)])[-_MAP_NAMED:]
    least = max(float(best[0]) if len(best) else np.inf, 3.0)
    return [[f"{v:.0f}" if np.isfinite(v) and v >= least else "" for v in row] for row in grid]


def _root_bar(grid: np.ndarray) -> dict[str, object]:
    """A colour bar whose colours go with the root of the value, and whose numbers are the value."""
    top = max(3.0, float(np.nanmax(grid)))
    ticks = [v for v in (0, 1, 3, 10, 30, 100, 300, 1000, 3000, 10000) if v <= top]
    places = {"tickvals": [float(np.sqrt(v)) for v in ticks], "ticktext": [str(v) for v in ticks]}
    return theme.colour_bar("ln evidence over nothing missing", **places)


# --------------------------------------------------------------------------- residuals


def vectors(d: Diagnosis) -> go.Figure:
    """Residual position vectors over the workspace from above and from the side, before and after the
    accepted effects; colour: the part across the picture."""
    before, after = d.comparison.fit_all, d.final
    size_m = max(_rms(before), 1e-12)
    span_m = float(np.ptp(before.data.p_m, axis=0).max()) or 1.0
    grow = 0.12 * span_m / size_m
    titles = [f"{name}: {_rms(fit) * 1e3:.2f} mm RMS, {view}" for view in ("from above", "from the side")
              for name, fit in (("before", before), ("after", after))]  # fmt: skip
    figure = make_subplots(
        rows=2, cols=2, subplot_titles=titles, horizontal_spacing=0.08, vertical_spacing=0.11
    )
    theme.styled(figure, 920, showlegend=False, coloraxis=_across_bar(1.2e3 * size_m), margin={"t": 84})
    for column, fit in enumerate((before, after), 1):
        for row, axes in enumerate(((0, 1, 2), (0, 2, 1)), 1):
            for trace in _arrows(fit, axes, grow):
                figure.add_trace(trace, row=row, col=column)
            figure.update_xaxes(title_text="xyz"[axes[0]] + " [m]", row=row, col=column)
            anchor = {"scaleanchor": f"x{2 * row + column - 2}".replace("x1", "x"), "row": row, "col": column}
            figure.update_yaxes(title_text="xyz"[axes[1]] + " [m]", **anchor)
    note = {"x": 0, "y": 1.085, "xref": "paper", "yref": "paper", "showarrow": False, "font": {"size": 12}}
    return figure.add_annotation(text=f"vectors are drawn {grow:.0f} times as long as they are", **note)


def _rms(fit: Fit) -> float:
    """RMS length of the position residuals [m]."""
    return float(np.sqrt((fit.evaluation.r[:, :3] ** 2).sum(axis=1).mean()))


def _across_bar(limit_mm: float) -> dict[str, object]:
    bar = theme.colour_bar("part across the picture [mm]")
    return {"colorscale": theme.SIGNED_STRONG, "cmin": -limit_mm, "cmax": limit_mm, "colorbar": bar}


def _arrows(fit: Fit, axes: tuple[int, int, int], grow: float) -> list[go.Scatter]:
    """Shafts as one broken line, heads as markers that are turned and coloured."""
    a, b, across = axes
    p, r = fit.data.p_m, fit.evaluation.r[:, :3]
    tip = p + grow * r
    gap = np.full(len(p), np.nan)
    shaft = {
        "x": np.column_stack([p[:, a], tip[:, a], gap]).ravel(),
        "y": np.column_stack([p[:, b], tip[:, b], gap]).ravel(),
    }
    angle = np.degrees(np.arctan2(r[:, a], r[:, b]))  # of the marker: clockwise from up
    heads = {
        "symbol": "arrow",
        "size": 9,
        "angle": angle,
        "color": r[:, across] * 1e3,
        "coloraxis": "coloraxis",
    }
    text = [f"{np.linalg.norm(v) * 1e3:.2f} mm" for v in r]
    return [
        go.Scatter(**shaft, mode="lines", line={"color": theme.GREY, "width": 1.2}, hoverinfo="skip"),
        go.Scatter(x=tip[:, a], y=tip[:, b], mode="markers", marker=heads, hovertext=text, hoverinfo="text"),
    ]


def axis_label(name: str) -> str:
    """A driver variable with its unit."""
    if name.startswith("tau"):
        return f"{name} [N m]"
    if name[0] == "q" and name[1:].isdigit():
        return f"{name} [rad]"
    return f"{name} [{_UNITS[name]}]" if name in _UNITS else name


def _trend(x: np.ndarray, y: np.ndarray, colour: str, label: str, named: bool) -> list[go.Scatter]:
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
        go.Scatter(x=shown, y=y, mode="markers", marker={"color": colour, "size": 4, "opacity": 0.35},
                   legendgroup=label, showlegend=False, hoverinfo="skip"),
        go.Scatter(**mean, mode="lines+markers", name=label, legendgroup=label, showlegend=named,
                   line={"color": colour, "width": 2}, marker={"size": 6, "color": colour},
                   error_y={"type": "data", "array": error, "color": colour, "thickness": 1.4}),
    ]  # fmt: skip


def _panels(
    titles: Sequence[str], per_row: int, height_px: int, ylabel: str
) -> tuple[go.Figure, list[tuple[int, int]]]:
    """A figure of small panels, and the (row, column) of each."""
    rows = -(-len(titles) // per_row)
    figure = make_subplots(
        rows=rows, cols=per_row, subplot_titles=titles, shared_yaxes=True, horizontal_spacing=0.025,
        vertical_spacing=0.28 / rows,
    )  # fmt: skip
    theme.styled(figure, 90 + height_px * rows, margin={"t": 44, "b": 84},
                 legend={"orientation": "h", "y": 0.0, "yref": "container", "yanchor": "bottom"})  # fmt: skip
    figure.update_annotations(font={"size": theme.FONT_PX})
    places = [(i // per_row + 1, i % per_row + 1) for i in range(len(titles))]
    for row in range(1, rows + 1):
        figure.update_yaxes(title_text=ylabel, row=row, col=1)
    return figure, places


def variables(d: Diagnosis) -> go.Figure:
    """Residual components against the variables that explain most of them, with means of bins."""
    fit = d.comparison.fit_all
    names = [w.variable for w in d.comparison.where[:_VARIABLES]]
    figure, places = _panels(["" for _ in names], 4, 260, "residual [mm]")
    for name, at in zip(names, places, strict=True):
        for k, colour in enumerate((theme.RED, theme.GREEN, theme.BLUE)):
            values = variable_values(name, fit), fit.evaluation.r[:, k] * 1e3
            traces = _trend(*values, colour, "xyz"[k], named=at == (1, 1))
            figure.add_traces(traces, rows=[at[0]] * 2, cols=[at[1]] * 2)
        figure.update_xaxes(title_text=axis_label(name), row=at[0], col=at[1])
    return figure


def suspects(d: Diagnosis) -> go.Figure:
    """The joints with the most evidence: apparent motion against its driver variable, before and after the
    accepted effects."""
    cells = [key for key in d.map_ln_bf if key[0].startswith("joint") and " x " not in key[1]]
    cells = sorted(cells, key=lambda key: -d.map_ln_bf[key])[:_SUSPECTS]
    titles = [
        f"{place} by {variable}: ln evidence {d.map_ln_bf[place, variable]:.1f}" for place, variable in cells
    ]
    figure, places = _panels(titles, max(len(cells), 1), 290, "apparent joint motion [mrad]")
    for (place, variable), at in zip(cells, places, strict=True):
        joint = int(place.split()[1])
        for fit, colour, label in _before_after(d):
            values = variable_values(variable, fit), apparent_motion(fit, joint) * 1e3
            traces = _trend(*values, colour, label, named=at == (1, 1))
            figure.add_traces(traces, rows=[at[0]] * 2, cols=[at[1]] * 2)
        figure.update_xaxes(title_text=axis_label(variable), row=at[0], col=at[1])
    return figure


def _before_after(d: Diagnosis) -> tuple[tuple[Fit, str, str], tuple[Fit, str, str]]:
    return (d.comparison.fit_all, theme.ORANGE, "before"), (d.final, theme.BLUE, "after")


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


# --------------------------------------------------------------------------- what the poses can show


def _hidden(c: Confounding) -> np.ndarray:
    """Indices of effects worth showing: visible alone, and hidden at least half by some other one."""
    own = np.diag(c.d2)
    others = c.d2 + np.diag(np.full(len(own), np.inf))
    share = others.min(axis=1) / np.maximum(own, 1e-12)
    visible = own >= CONFOUNDED_CHI2
    keep = np.flatnonzero(visible & (share < 0.5))
    partners = {int(others[i].argmin()) for i in keep}
    order = sorted({*keep.tolist(), *(p for p in partners if visible[p])}, key=lambda i: share[i])
    return np.array(sorted(order[:_CONFOUNDING_MAX]), dtype=int)


def confounding(c: Confounding) -> go.Figure | None:
    """d^2 of each effect that is left once DH and another effect have explained it; None if no effect hides
    behind another with these poses."""
    keep = _hidden(c)
    if len(keep) < 2:
        return None
    names, d2 = [c.names[i] for i in keep], c.d2[np.ix_(keep, keep)]
    share = d2 / np.maximum(np.diag(d2)[:, None], 1e-12)
    text = [
        [f"<b>{v:.0f}</b>" if i != j and v < CONFOUNDED_CHI2 else f"{v:.0f}" for j, v in enumerate(row)]
        for i, row in enumerate(d2)
    ]
    figure = theme.figure(190 + 30 * len(names))
    figure.add_heatmap(
        z=share, x=names, y=names, text=text, texttemplate="%{text}", zmin=0.0, zmax=1.0,
        colorscale=theme.SHARE,
        xgap=1, ygap=1, hovertemplate="%{y} beside %{x}: %{text}<extra></extra>",
        colorbar=theme.colour_bar("share left"),
    )  # fmt: skip
    figure.update_xaxes(
        title_text="... once DH and this effect have explained it", showgrid=False, tickangle=-45
    )
    return figure.update_yaxes(
        title_text="left of this effect [chi2] ...", autorange="reversed", showgrid=False
    )


def harm(rows: Sequence[Harm], count: int = 14) -> go.Figure:
    """Tool error that an effect would cause just below detection."""
    shown = [h for h in rows if h.smallest <= _PLAUSIBLE][:count]
    errors_mm = [h.error_m * 1e3 for h in shown]
    figure = _bars(len(shown))
    figure.add_bar(
        x=errors_mm, y=[f"{h.name} ({h.smallest:.2g} sigma)" for h in shown], orientation="h",
        marker={"color": theme.ORANGE}, text=[f"{x:.2f}" for x in errors_mm], textposition="outside",
        cliponaxis=False,
    )  # fmt: skip
    return figure.update_xaxes(title_text="tool error it would cause just below detection [mm]")


def next_poses(q: np.ndarray, low: np.ndarray, high: np.ndarray, power: Sequence[float]) -> go.Figure:
    """Advised poses q (k, joints) [rad or m] inside the limits (joints,), and the power they add up to."""
    titles = ("Joints of the next poses, in their limits", "Power to separate the alternatives")
    figure = make_subplots(
        rows=1, cols=2, column_widths=[0.64, 0.36], subplot_titles=titles, horizontal_spacing=0.1
    )
    theme.styled(figure, 400, legend={"orientation": "h", "y": -0.22}, margin=theme.TITLED)
    joints_ = [str(j) for j in range(1, len(low) + 1)]
    band = {"x": joints_ + joints_[::-1], "y": [*high, *low[::-1]]}
    figure.add_scatter(
        **band,
        fill="toself",
        mode="none",
        fillcolor=theme.GRID,
        name="limits",
        hoverinfo="skip",
        row=1,
        col=1,
    )
    for k, row in enumerate(q, 1):
        again, colour = divmod(k - 1, len(theme.SERIES))
        style = {"color": theme.SERIES[colour], "dash": "dot" if again else "solid"}
        figure.add_scatter(x=joints_, y=row, mode="lines+markers", name=f"pose {k}", line=style, row=1, col=1)
    figure.add_scatter(
        x=list(range(1, len(power) + 1)), y=list(power), mode="lines+markers", showlegend=False,
        line={"color": theme.BLUE}, row=1, col=2,
    )  # fmt: skip
    figure.update_xaxes(title_text="joint", row=1, col=1)
    figure.update_yaxes(title_text="q [rad or m]", row=1, col=1)
    figure.update_xaxes(title_text="poses measured", dtick=1, row=1, col=2)
    return figure.update_yaxes(range=[0.0, 1.04], row=1, col=2)
