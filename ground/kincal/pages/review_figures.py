"""Figures of a proposed correction."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from kincal.pages import run_figures, theme
from kincal.results import CoefResult
from kincal.review import Review


def estimates(review: Review) -> list[CoefResult]:
    """The estimated coefficients; nobody knows their true values."""
    nan = float("nan")
    return [CoefResult(c.name, c.unit, nan, c.value, c.sigma, c.status) for c in review.estimated]


def corrections(review: Review) -> go.Figure:
    """Estimates with 3-sigma bars."""
    return run_figures.corrections(estimates(review))


def correlation(review: Review) -> go.Figure:
    """Correlation of the estimated coefficients, (k, k)."""
    names = [c.name for c in review.estimated]
    figure = theme.figure(200 + 18 * len(names), margin={"l": 90, "b": 90})
    figure.add_trace(_correlation(review.correlation, names))
    figure.update_xaxes(tickangle=-90, showgrid=False, tickfont={"size": 10}, dtick=1)
    return figure.update_yaxes(autorange="reversed", showgrid=False, tickfont={"size": 10}, dtick=1)


def _correlation(values: np.ndarray, names: list[str]) -> go.Heatmap:
    return go.Heatmap(
        z=values, x=names, y=names, zmin=-1.0, zmax=1.0, colorscale=theme.SIGNED, xgap=1, ygap=1,
        colorbar=theme.colour_bar("correlation [-]"),
        hovertemplate="%{x}, %{y}: %{z:.2f}<extra></extra>",
    )  # fmt: skip


def sheet(review: Review) -> go.Figure:
    """Corrections and correlation in one picture."""
    names = [c.name for c in review.estimated]
    coefs = estimates(review)
    figure = make_subplots(
        rows=1, cols=3, column_widths=[0.31, 0.31, 0.38], horizontal_spacing=0.075,
        subplot_titles=[*(run_figures.coef_title(coefs, u) for u in run_figures.MILLI), "Correlation"],
    )  # fmt: skip
    title = (
        f"Correction {review.crc_text}: {review.verdict}, {review.n_poses} poses, "
        f"p of the fit {review.numbers['p_fit']:.3f}"
    )
    theme.styled(figure, 600, width=1480, title=title, margin={"t": 96})
    for column, unit in enumerate(run_figures.MILLI, 1):
        run_figures.add_corrections(figure, coefs, unit, (1, column))
    figure.add_trace(_correlation(review.correlation, names), row=1, col=3)
    small = {"showgrid": False, "tickfont": {"size": 9}, "dtick": 1, "row": 1, "col": 3}
    figure.update_xaxes(tickangle=-90, **small)
    figure.update_yaxes(autorange="reversed", **small)
    return figure
