"""The theme of all figures and pages: colours, fonts and sizes, once.

Figures are made in the light colours. A page in dark mode replaces each light colour by its dark partner
(page.js), so every colour of a figure has to be one of these names."""

from __future__ import annotations

from typing import Any, Final

import plotly.graph_objects as go
from plotly.colors import sample_colorscale

PAPER: Final = "#ffffff"
INK: Final = "#1d2733"
MUTED: Final = "#67737f"
GREY: Final = "#8a97a3"
GRID: Final = "#dfe4e9"
BLUE: Final = "#1f6fb4"
ORANGE: Final = "#d9730d"
GREEN: Final = "#257a40"
RED: Final = "#c0392b"
PURPLE: Final = "#7a4ca0"
TEAL: Final = "#148f9c"
BROWN: Final = "#8c5a1f"
WINE: Final = "#7d2a3c"

# light colour -> dark partner, of like contrast against DARK_PAPER
DARK: Final[dict[str, str]] = {
    PAPER: "#161b21",
    INK: "#e6ecf1",
    MUTED: "#9caab6",
    GREY: "#7d8a96",
    GRID: "#2f3842",
    BLUE: "#5fb0f0",
    ORANGE: "#f5a04c",
    GREEN: "#5ec982",
    RED: "#f2756a",
    PURPLE: "#b995e0",
    TEAL: "#4cc7d3",
    BROWN: "#d3a162",
    WINE: "#d77f93",
}
SERIES: Final = (BLUE, ORANGE, GREEN, PURPLE, RED, TEAL, BROWN)
SYMBOLS: Final = ("circle", "square", "triangle-up", "diamond", "cross", "x", "star")

# The paper's colour at one end, so that "nothing" looks like nothing in both modes.
AMOUNT: Final = ((0.0, PAPER), (0.35, ORANGE), (1.0, RED))
SIGNED: Final = ((0.0, BLUE), (0.5, PAPER), (1.0, RED))
SIGNED_STRONG: Final = ((0.0, BLUE), (0.5, GREY), (1.0, RED))  # where the middle has to be seen too
SHARE: Final = ((0.0, RED), (0.5, PAPER), (1.0, GREEN))
# first to last, low to high: bright enough for dark paper, dark enough for light
ORDER: Final = ((0.0, "#4a5bd0"), (0.33, "#1c93ad"), (0.67, "#3fa65a"), (1.0, "#dba014"))
# angles: both ends alike
CYCLE: Final = tuple(
    (i / 6, colour)
    for i, colour in enumerate(("#4a5bd0", "#1c93ad", "#3fa65a", "#dba014", "#d0563f", "#a0509c", "#4a5bd0"))
)

FONT: Final = "Inter, system-ui, -apple-system, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif"
FONT_PX: Final = 13
TITLE_PX: Final = 15
PNG_WIDTH_PX: Final = 1100
PNG_SCALE: Final = 1.5


def _axis() -> dict[str, Any]:
    return {
        "automargin": True,
        "gridcolor": GRID,
        "linecolor": GREY,
        "zerolinecolor": GREY,
        "zerolinewidth": 1,
        "ticks": "outside",
        "tickcolor": GREY,
        "ticklen": 4,
        "showline": True,
        "title": {"standoff": 8, "font": {"size": FONT_PX}},
    }


def _axis3() -> dict[str, Any]:
    return {"gridcolor": GRID, "linecolor": GREY, "zerolinecolor": GRID, "backgroundcolor": PAPER,
            "title": {"font": {"size": 12}}, "tickfont": {"size": 11}}  # fmt: skip


def template() -> go.layout.Template:
    """The look of every figure."""
    axes3 = {f"{a}axis": _axis3() for a in "xyz"}
    layout = go.Layout(
        font={"family": FONT, "size": FONT_PX, "color": INK},
        title={"font": {"size": TITLE_PX}, "x": 0.0, "xanchor": "left", "xref": "paper"},
        paper_bgcolor=PAPER,
        plot_bgcolor=PAPER,
        colorway=SERIES,
        xaxis=_axis(),
        yaxis=_axis(),
        scene=axes3,
        hoverlabel={"font": {"family": FONT, "size": 12}, "bgcolor": PAPER, "bordercolor": GREY},
        legend={"bgcolor": "rgba(0,0,0,0)", "font": {"size": 12}},
        margin={"l": 64, "r": 24, "t": 24, "b": 48},
        annotationdefaults={"font": {"size": TITLE_PX, "color": INK}},
    )
    return go.layout.Template(layout=layout)


def figure(height_px: int, **layout: Any) -> go.Figure:
    """An empty figure of the theme; the width is the page's."""
    return styled(go.Figure(), height_px, **layout)


TITLED: Final = {"t": 56}  # margin of a figure whose panels have titles


def styled(made: go.Figure, height_px: int, **layout: Any) -> go.Figure:
    """The same figure with the theme; for those that make_subplots made."""
    made.update_layout(template=template(), height=height_px, **layout)
    made.update_annotations(font={"size": TITLE_PX, "color": INK})
    return made


def colour_bar(title: str, **place: Any) -> dict[str, Any]:
    """A colour bar with its title along it; place: x, tickvals ..."""
    text = {"text": title, "side": "right", "font": {"size": FONT_PX}}
    return {"title": text, "outlinewidth": 0, "thickness": 13, "tickfont": {"size": 12}, **place}


def shades(n: int) -> list[str]:
    """n colours along ORDER, first to last."""
    return list(sample_colorscale([colour for _, colour in ORDER], [i / max(n - 1, 1) for i in range(n)]))


def css_colours() -> str:
    """The colours as CSS variables, light and dark, for the style sheet."""
    names = {
        "paper": PAPER, "ink": INK, "muted": MUTED, "grey": GREY, "grid": GRID, "blue": BLUE,
        "orange": ORANGE, "green": GREEN, "red": RED,
    }  # fmt: skip
    light = "".join(f"--{name}:{value};" for name, value in names.items())
    dark = "".join(f"--{name}:{DARK[value]};" for name, value in names.items())
    return f":root{{{light}}}\n@media screen and (prefers-color-scheme: dark){{:root{{{dark}}}}}"
