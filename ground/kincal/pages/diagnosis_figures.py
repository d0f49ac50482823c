"""Figures of a diagnosis. Each function draws plain results; none computes an answer."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from kincal.pages import theme, words
from kincal.workbench.diagnosis import Diagnosis
from kincal.workbench.model.unnamed_names import HEADINGS
from kincal.workbench.prediction.nested import NestedModel, NestedModels
from kincal.workbench.prediction.power import CONFOUNDED_CHI2, Confounding, Harm
from kincal.workbench.report import explain

_ROW_PX = 30  # of a bar chart
_CONFOUNDING_MAX = 14
_PLAUSIBLE = 10.0  # typical sizes; nothing is larger than that without being known
_BAR_GAP = 0.1  # between ticks, of the length of a colour bar
_MAP_NAMED = 6  # cells that carry their number


def _short(text: str, width: int) -> str:
    return text if len(text) <= width else text[: width - 1] + "…"


def _bars(height_rows: int, **layout: object) -> go.Figure:
    figure = theme.figure(110 + _ROW_PX * height_rows, showlegend=False, **layout)
    figure.update_yaxes(autorange="reversed", showgrid=False, ticks="")
    return figure


# --------------------------------------------------------------------------- models, probabilities


def nested(models: NestedModels, reachable_m: float | None = None) -> go.Figure:
    """Held-out error of each nested model with its interval, a column for each way of holding poses back;
    noise floor and what is reachable as lines."""
    blocks = models.blocks
    figure = make_subplots(rows=1, cols=len(blocks), subplot_titles=blocks, shared_yaxes=True,
                           horizontal_spacing=0.03)  # fmt: skip
    names = list(dict.fromkeys(m.model for m in models.models))
    theme.styled(figure, 150 + _ROW_PX * len(names), showlegend=False, margin={"t": 64, "b": 56})
    figure.update_annotations(font={"size": theme.FONT_PX})
    for column, block in enumerate(blocks, 1):
        figure.add_trace(_errors(models.of(block)), row=1, col=column)
        lines = _lines(models, reachable_m if column == 1 else None)
        for level, (value_m, label, colour) in enumerate(lines):
            style = {"color": colour, "dash": "dash", "width": 1.5}
            figure.add_vline(value_m * 1e3, line=style, row=1, col=column)
            if column == 1:
                figure.add_annotation(_line_label(value_m, label, colour, level))
    figure.update_yaxes(autorange="reversed", showgrid=False, ticks="", type="category")
    return figure.update_xaxes(type="log", range=_log_range(models, reachable_m), tickvals=_ticks(models),
                               title_text="RMS [mm]")  # fmt: skip


def _errors(mine: Sequence[NestedModel]) -> go.Scatter:
    """Errors of one block with their intervals."""
    pos_mm = np.array([m.pos_m for m in mine]) * 1e3
    low, high = (np.array([m.pos_interval[k] for m in mine]) * 1e3 for k in (0, 1))
    bars = {"type": "data", "symmetric": False, "array": high - pos_mm, "arrayminus": pos_mm - low}
    return go.Scatter(
        x=pos_mm, y=[m.model for m in mine], mode="lines+markers", marker={"color": theme.BLUE, "size": 9},
        line={"color": theme.GRID, "width": 2}, error_x={**bars, "color": theme.BLUE, "thickness": 1.6},
        hovertext=[f"{m.model}: {x:.3f} mm ({a:.3f} to {b:.3f})"
                   for m, x, a, b in zip(mine, pos_mm, low, high, strict=True)], hoverinfo="text",
    )  # fmt: skip


def _lines(models: NestedModels, reachable_m: float | None) -> Iterator[tuple[float, str, str]]:
    """Values [m] that no model passes, with their label and colour."""
    if models.floor.pos_m:
        yield models.floor.pos_m, "noise floor", theme.MUTED
    if reachable_m:
        yield reachable_m, "reachable", theme.GREEN


def _line_label(value_m: float, label: str, colour: str, level: int) -> dict[str, object]:
    """Above a line of the first column and the column's title, where no point is drawn however narrow the
    columns are; on a logarithmic axis it stands at the logarithm. level: rows above the title."""
    return {
        "x": float(np.log10(value_m * 1e3)), "y": 1, "xref": "x", "yref": "y domain", "showarrow": False,
        "text": f"{label} {value_m * 1e3:.3g}", "font": {"size": 11, "color": colour}, "xanchor": "left",
        "yanchor": "bottom", "xshift": -3, "yshift": 20 + 14 * level,
    }  # fmt: skip


def _log_range(models: NestedModels, reachable_m: float | None) -> tuple[float, float]:
    """Of a logarithmic axis for all that is drawn."""
    values = [x for m in models.models for x in (m.pos_m, *m.pos_interval) if np.isfinite(x) and x > 0]
    values += [value for value, _, _ in _lines(models, reachable_m)]
    low, high = np.log10(min(values) * 1e3), np.log10(max(values) * 1e3)
    edge = 0.06 * (high - low) + 0.02
    return float(low - edge), float(high + edge)


def _ticks(models: NestedModels) -> list[float]:
    """1, 2, 5, 10 ... around the errors [mm], for a logarithmic axis."""
    values = [m.pos_m * 1e3 for m in models.models]
    decades = range(int(np.floor(np.log10(min(values)))) - 2, int(np.ceil(np.log10(max(values)))) + 1)
    return [float(f"{step}e{decade}") for decade in decades for step in (1, 2, 5)]


def _hypotheses(d: Diagnosis) -> Iterator[tuple[str, float, str, str]]:
    """Label, probability, colour and what it is confounded with."""
    yield "nothing missing", d.probability_none, theme.GREY, ""
    if d.novel:
        what = f"not in the library: {d.novel.location}<br>by {' and '.join(d.novel.depends_on)}"
        yield what, d.novel.probability, theme.RED, ""
    for e in d.effects:
        colour = theme.BLUE if e.accepted else theme.ORANGE
        if e.role != "helps":  # held-out poses decided that, no probability
            yield e.name, e.probability, colour, explain.grouped(e.confounded_with)


def posterior(d: Diagnosis) -> go.Figure:
    """Probabilities of what may be missing; beside a bar stand effects that it is confounded with."""
    rows = list(_hypotheses(d))
    figure = _bars(len(rows))
    text = [
        explain.probability(p) + (f", confounded with {_short(confounded, 60)}" if confounded else "")
        for _, p, _, confounded in rows
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
    cells = dict[tuple[str, str], float]()
    for (location, variable), value in d.map_ln_bf.items():
        if " x " not in variable:  # the many headings share a column
            at = location, words.HEADING if variable in HEADINGS else variable
            cells[at] = max(value, cells.get(at, value))
    rows = list(dict.fromkeys(location for location, _ in cells))
    columns = list(dict.fromkeys(variable for _, variable in cells))
    grid = np.full((len(rows), len(columns)), np.nan)
    for (location, variable), value in cells.items():
        grid[rows.index(location), columns.index(variable)] = max(value, 0.0)
    figure = theme.figure(150 + 19 * len(rows), margin={"t": 16})
    figure.add_heatmap(
        z=np.sqrt(grid), x=[words.driver(c) for c in columns], y=rows, customdata=grid,
        text=_named_cells(grid), texttemplate="%{text}",
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
    least = (_BAR_GAP**2) * top  # ticks below it would lie on zero
    ticks = [v for v in (0, 1, 3, 10, 30, 100, 300, 1000, 3000, 10000) if v == 0 or least <= v <= top]
    places = {"tickvals": [float(np.sqrt(v)) for v in ticks], "ticktext": [str(v) for v in ticks]}
    return theme.colour_bar("ln evidence over nothing missing", **places)


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
    sized = [f"{c.names[i]} ({c.sizes[i]})" for i in keep]
    share = d2 / np.maximum(np.diag(d2)[:, None], 1e-12)
    text = [
        [f"<b>{v:.0f}</b>" if i != j and v < CONFOUNDED_CHI2 else f"{v:.0f}" for j, v in enumerate(row)]
        for i, row in enumerate(d2)
    ]
    figure = theme.figure(290 + 30 * len(names))
    figure.add_heatmap(
        z=share, x=names, y=sized, text=text, texttemplate="%{text}", zmin=0.0, zmax=1.0,
        colorscale=theme.SHARE,
        xgap=1, ygap=1, hovertemplate="%{y} beside %{x}: %{text}<extra></extra>",
        colorbar=theme.colour_bar("share left"),
    )  # fmt: skip
    figure.update_xaxes(
        title_text="... once DH and this effect have explained it", showgrid=False, tickangle=-45
    )
    return figure.update_yaxes(
        title_text="left of this effect<br>[chi2] ...", autorange="reversed", showgrid=False
    )


def harm(rows: Sequence[Harm], count: int = 14) -> go.Figure:
    """Tool error that an effect would cause just below detection."""
    shown = [h for h in rows if h.smallest <= _PLAUSIBLE][:count]
    errors_mm = [h.error_m * 1e3 for h in shown]
    figure = _bars(len(shown))
    figure.add_bar(
        x=errors_mm, y=[f"{h.name} ({h.smallest:.2g})" for h in shown], orientation="h",
        marker={"color": theme.ORANGE}, text=[f"{x:.2g}" for x in errors_mm], textposition="outside",
        cliponaxis=False,
    )  # fmt: skip
    return figure.update_xaxes(title_text="tool error it would cause just below the detection limit [mm]")


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
