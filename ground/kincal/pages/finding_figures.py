"""What was found, drawn: partial residuals of an effect with its curve, and of the unnamed at its place."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from kincal.pages import theme, words
from kincal.pages.poses import Poses, Range, bulk_range, dots
from kincal.workbench.evidence.curves import Curve
from kincal.workbench.report.partial import Bin, Group, Panel

PANELS = 8  # of an effect
_PER_ROW = 4
_HEIGHT_PX = 290
_LEAST_KNOWN = 3.0  # a pose is drawn if its standard error is at most this many times the median
_LEVELS = 4
_BLURRED = 5.0  # means with more than this many times the median standard error are not drawn


def findings(panels: Sequence[Panel], poses: Poses, functions: Sequence[Curve] = ()) -> go.Figure:
    """One panel a place and driver: poses, means with standard errors, and the fitted curve. functions: of an
    unnamed effect, drawn with their error bands."""
    shown = panels[:PANELS]
    across = max(min(len(shown), _PER_ROW), 2)  # one alone takes half the width
    down = -(-len(shown) // across)
    figure = make_subplots(
        rows=down, cols=across, subplot_titles=[p.place for p in shown], horizontal_spacing=0.06,
        vertical_spacing=0.3 / down,
    )  # fmt: skip
    legend = {"orientation": "h", "y": 0.0, "yref": "container", "yanchor": "bottom"}
    theme.styled(figure, 120 + _HEIGHT_PX * down, margin={"t": 44, "b": 92}, legend=legend)
    figure.update_annotations(font={"size": theme.FONT_PX})
    for i, panel in enumerate(shown):
        at = (i // across + 1, i % across + 1)
        _draw(figure, panel, poses, at, first=i == 0)
        for k, curve in enumerate(c for c in functions if _belongs(c, panel)):
            for trace in _function(curve, _colours(panel)[k % len(panel.groups)], first=i == k == 0):
                figure.add_trace(trace, row=at[0], col=at[1])
    return figure


def _belongs(curve: Curve, panel: Panel) -> bool:
    """Whether a function is that of a panel: of its driver, and of its axis where the place has several."""
    _, comma, axis = panel.place.partition(", ")
    return curve.driver == panel.driver and (not comma or curve.component[1] == axis)


def _colours(panel: Panel) -> list[str]:
    return [theme.BLUE] if len(panel.groups) == 1 else theme.shades(len(panel.groups))


def _function(curve: Curve, colour: str, *, first: bool) -> Iterator[go.Scatter]:
    """A line, and a band of two standard errors."""
    x, y, wide = curve.x, curve.value * 1e3, 2e3 * curve.std
    style = {"legendgroup": "function", "hoverinfo": "skip"}
    yield _band(x, y, wide, colour, "function")
    line = {"color": colour, "width": 2.6, "dash": "dash"}
    name = "fitted smooth function, ± 2 standard errors"
    yield go.Scatter(x=x, y=y, mode="lines", line=line, name=name, showlegend=first, **style)


def _band(x: np.ndarray, y: np.ndarray, wide: np.ndarray, colour: str, group: str) -> go.Scatter:
    """What lies within `wide` of a line."""
    return go.Scatter(
        x=[*x, *x[::-1]], y=[*(y + wide), *(y - wide)[::-1]], fill="toself", mode="none", fillcolor=colour,
        opacity=0.15, showlegend=False, hoverinfo="skip", legendgroup=group,
    )  # fmt: skip


def _draw(figure: go.Figure, panel: Panel, poses: Poses, at: tuple[int, int], *, first: bool) -> None:
    limits = _limits(panel)
    known = panel.sigma <= _LEAST_KNOWN * float(np.median(panel.sigma))
    for group, colour in zip(panel.groups, _colours(panel), strict=True):
        mine = group.poses & known
        cloud = dots(
            poses,
            _spread(panel.x),
            panel.y * 1e3,
            limits,
            mask=mine,
            colour=colour,
            border=False,
        )
        for trace in (*cloud, *_curves(panel, group, colour, first)):
            figure.add_trace(trace, row=at[0], col=at[1])
    figure.update_xaxes(title_text=words.axis(panel.driver, panel.unit), row=at[0], col=at[1])
    figure.update_yaxes(title_text="motion [mrad]" if panel.angular else "motion [mm]", range=limits,
                        row=at[0], col=at[1])  # fmt: skip


def _spread(x: np.ndarray) -> np.ndarray:
    """Few levels are spread sideways, so that their dots can be told apart."""
    levels = np.unique(x)
    if len(levels) > _LEVELS:
        return x
    width = 0.12 * (float(np.ptp(levels)) or 1.0)
    spread: np.ndarray = x + np.random.default_rng(1).uniform(-width, width, len(x))
    return spread


def _limits(panel: Panel) -> Range:
    """The curve and the means with their errors, and the middle of the poses."""
    bins = [b for g in panel.groups for b in g.bins]
    means = np.array([edge for b in bins for edge in (b.y - 2 * b.sigma, b.y + 2 * b.sigma, b.fitted)])
    middle = np.quantile(panel.y, (0.1, 0.9))
    low, high = bulk_range(np.concatenate([means, middle, panel.fitted]) * 1e3)
    edge = 0.1 * (high - low)
    return low - edge, high + edge


def _curves(panel: Panel, group: Group, colour: str, first: bool) -> Iterator[go.Scatter]:
    """Means with error bars, and what the effect says."""
    label = group.label or "mean of similar poses ± standard error"
    shared = {"legendgroup": label, "showlegend": first}
    yield _means(_sharp(panel, group), colour, label, shared, joined=not panel.fitted.any())
    if panel.fitted.any():
        fitted = {
            "legendgroup": "fit",
            "name": "fitted effect" + (", ± 2 standard errors" if panel.line is not None else ""),
            "showlegend": first and group is panel.groups[0],
        }
        yield from _fitted(panel, group, theme.ORANGE if not group.label else colour, fitted)


def _sharp(panel: Panel, group: Group) -> list[Bin]:
    """Means that say something: bars across the whole panel hide the others."""
    limit = _BLURRED * float(np.median([b.sigma for g in panel.groups for b in g.bins]))
    return [b for b in group.bins if b.sigma <= limit]


def _means(
    bins: Sequence[Bin], colour: str, label: str, shared: dict[str, object], *, joined: bool
) -> go.Scatter:
    error = [b.sigma * 1e3 for b in bins]
    marker = {"color": colour, "size": 8, "line": {"color": theme.INK, "width": 1}}
    return go.Scatter(
        x=[b.x for b in bins], y=[b.y * 1e3 for b in bins], mode="lines+markers" if joined else "markers",
        name=label, line={"color": colour, "width": 1.6}, marker=marker,
        error_y={"type": "data", "array": error, "color": colour, "thickness": 1.5, "width": 3},
        hovertext=[f"mean of {b.count} poses: {b.y * 1e3:.3g} ± {b.sigma * 1e3:.2g}" for b in bins],
        hoverinfo="text", **shared,
    )  # fmt: skip


def _fitted(panel: Panel, group: Group, colour: str, style: dict[str, object]) -> Iterator[go.Scatter]:
    """The curve of an effect of one driver, with its error band; means of what it does where it has two."""
    if panel.line is not None:
        x, y, wide = panel.line.x, panel.line.value * 1e3, 2e3 * panel.line.std
        yield _band(x, y, wide, colour, str(style["legendgroup"]))
    else:
        x, y = np.array([b.x for b in group.bins]), np.array([b.fitted * 1e3 for b in group.bins])
    yield go.Scatter(x=x, y=y, mode="lines", line={"color": colour, "width": 2.6, "dash": "solid"},
                     hoverinfo="skip", **style)  # fmt: skip
