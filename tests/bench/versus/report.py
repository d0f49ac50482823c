"""docs/BENCHMARKS.md and its figures, from what was measured."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from kincal.pages import image, theme

from . import fits
from .build import ROOT
from .measure import OURS, Growth, Ratio

PAGE, IMAGES = ROOT / "docs" / "BENCHMARKS.md", ROOT / "docs" / "img"
AHEAD, BEHIND = theme.BLUE, theme.ORANGE


def significant(x: float) -> str:
    """Two digits, no powers of ten."""
    rounded = float(f"{x:.2g}")
    return f"{rounded:,.0f}".replace(",", " ") if abs(rounded) >= 10.0 else f"{rounded:g}"


def seconds_text(s: float) -> str:
    """With the unit that fits."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("\u00b5s", 1e-6)):
        if s >= size:
            return f"{s / size:.3g} {unit}"
    return f"{s / 1e-9:.3g} ns"


def _table(head: Sequence[str], right: int, cells: Sequence[Sequence[str]]) -> list[str]:
    """Markdown; the last `right` columns to the right."""
    rule = "---|" * (len(head) - right) + "---:|" * right
    return [f"| {' | '.join(head)} |", f"|{rule}", *(f"| {' | '.join(row)} |" for row in cells)]


def ratio_table(found: Sequence[Ratio]) -> list[str]:
    """Ratios, what 80 % of the rounds gave, our time, how far results differ."""
    cells = [
        [
            r.part,
            r.case,
            r.other,
            f"**{significant(r.ratio)}**",
            f"{significant(r.low)} to {significant(r.high)}",
            seconds_text(r.ours_s),
            f"{r.off:.0e}" if r.off else "0",
        ]
        for r in found
    ]
    head = ("part", "on", "against", "times as long", "8 of 10 turns", "KinCal", "results differ by")
    return _table(head, 4, cells)


def growth_table(found: Sequence[Growth]) -> list[str]:
    """Exponents of all programs."""
    cells = []
    for g in found:
        others = "; ".join(f"{name} {g.exponent(name):.2f}" for name in g.seconds if name != OURS)
        sizes = f"{g.sizes[0]:,} to {g.sizes[-1]:,}".replace(",", " ")
        cells.append([g.part, f"{g.variable}, {sizes}", f"{g.exponent(OURS):.2f}", others])
    return _table(("part", "grows with", "KinCal", "others"), 0, cells)


def error_text(o: fits.Outcome) -> str:
    """mm, and mrad if there are orientations."""
    text = f"{1e3 * o.pos_m:.3f} mm"
    return text if o.rot_rad is None else f"{text}, {1e3 * o.rot_rad:.2f} mrad"


def fit_table(found: Sequence[fits.Row]) -> list[str]:
    """A row a program and set."""
    cells = []
    for row in found:
        for who, s in row.seconds.items():
            times = f"**{significant(s / row.seconds[OURS])}**"
            poses = f"{row.poses[0]}, {row.poses[1]}"
            cells.append([row.name, poses, who, error_text(row.error[who]), times, seconds_text(s)])
    head = (
        "set",
        "poses fitted, held out",
        "program",
        "held-out error",
        "times as long as KinCal's fit",
        "time",
    )
    return _table(head, 3, cells)


# ---- figures


def ratios_figure(found: Sequence[Ratio]) -> go.Figure:
    """A bar a ratio, on a logarithmic scale from 1: to the right KinCal is ahead."""
    shown = list(found)[::-1]
    y = [f"{r.part}: {r.case} \u2013 <b>{r.other}</b>" for r in shown]
    x = [r.ratio for r in shown]
    figure = theme.figure(90 + 30 * len(shown), margin={"t": 16, "l": 420, "r": 64})
    bars = go.Bar(
        x=list(np.log10(x)),
        y=y,
        orientation="h",
        marker={"color": [AHEAD if v >= 1.0 else BEHIND for v in x]},
        text=[significant(v) for v in x],
        textposition="outside",
        cliponaxis=False,
    )
    figure.add_trace(bars)
    ends = np.floor(min(0.0, *np.log10(x))), np.ceil(max(1.0, *np.log10(x)))
    ticks = list(range(int(ends[0]), int(ends[1]) + 1))
    names = [f"{10.0**t:g}" for t in ticks]
    figure.update_xaxes(
        tickvals=ticks,
        ticktext=names,
        range=[ends[0] - (0.3 if ends[0] < 0.0 else 0.0), ends[1] + 0.2],
        title_text="time of the other in parts of KinCal's",
        zerolinewidth=2,
    )
    figure.update_yaxes(ticks="", showline=False)
    return figure


def growth_figure(found: Sequence[Growth]) -> go.Figure:
    """A panel a growth, both axes logarithmic; programs with their exponents above the lines."""
    columns = 3
    rows = -(-len(found) // columns)
    titles = [f"{g.part} by {g.variable}" for g in found]
    figure = make_subplots(
        rows=rows,
        cols=columns,
        subplot_titles=titles,
        horizontal_spacing=0.09,
        vertical_spacing=0.5 / rows**2,
    )
    theme.styled(figure, 360 * rows, margin=theme.TITLED, showlegend=False)
    for k, g in enumerate(found):
        at = {"row": k // columns + 1, "col": k % columns + 1}
        for i, (name, seconds) in enumerate(g.seconds.items()):
            style = {"color": theme.SERIES[i], "width": 2.2}
            line = go.Scatter(x=g.sizes, y=seconds, mode="lines+markers", line=style, name=name)
            figure.add_trace(line.update(marker={"symbol": theme.SYMBOLS[i], "size": 7}), **at)
            label = {
                "text": f"{name}: {g.exponent(name):.1f}",
                "font": {"size": 12, "color": theme.SERIES[i]},
            }
            corner = {"x": 0.02, "y": 0.99 - 0.085 * i, "xref": "x domain", "yref": "y domain"}
            figure.add_annotation(
                **label, **corner, showarrow=False, xanchor="left", yanchor="top", bgcolor=theme.PAPER, **at
            )
        low, high = np.log10(min(_all(g))), np.log10(max(_all(g)))
        room = 0.13 * len(g.seconds) / (1.0 - 0.085 * len(g.seconds)) * (high - low)
        figure.update_xaxes(
            type="log", tickvals=g.sizes, ticktext=[_short(v) for v in g.sizes], tickangle=0, **at
        )
        dtick = 1 if high - low > 1.5 else "D2"
        ends = [low - 0.05 * (high - low), high + room]
        figure.update_yaxes(type="log", exponentformat="SI", ticksuffix="s", dtick=dtick, range=ends, **at)
    return figure


def _all(g: Growth) -> list[float]:
    return [s for seconds in g.seconds.values() for s in seconds]


def _short(size: int) -> str:
    """Of a size, as a tick has it."""
    return f"{size / 1e6:.2g} M" if size >= 100_000 else str(size)


def fits_figure(found: Sequence[fits.Row]) -> go.Figure:
    """Time against held-out error, a panel a set: down and to the left is better."""
    titles = [row.name for row in found]
    figure = make_subplots(rows=1, cols=len(found), subplot_titles=titles, horizontal_spacing=0.07)
    theme.styled(figure, 400, margin=theme.TITLED, legend={"orientation": "h", "y": -0.22})
    names = list(dict.fromkeys(name for row in found for name in row.seconds))
    for k, row in enumerate(found, 1):
        for name, s in row.seconds.items():
            i = names.index(name)
            mark = {"color": theme.SERIES[i], "symbol": theme.SYMBOLS[i], "size": 11}
            error_mm = 1e3 * row.error[name].pos_m
            point = go.Scatter(x=[s], y=[error_mm], mode="markers", marker=mark, name=name, legendgroup=name)
            figure.add_trace(point.update(showlegend=k == 1), row=1, col=k)
        figure.update_xaxes(
            type="log", title_text="processor time [s]", dtick=1, tickformat="~g", row=1, col=k
        )
    figure.update_yaxes(rangemode="tozero")
    figure.update_yaxes(title_text="held-out position RMS [mm]", row=1, col=1)
    return figure


# ---- the page


def put(name: str, lines: Sequence[str], page: Path = PAGE, by: str = "make bench") -> None:
    """Lines between the marks of that name. ValueError if the page has no such marks."""
    begin, end = f"<!-- {name}: {by} -->", f"<!-- end of {name} -->"
    text = page.read_text()
    if begin not in text or end not in text:
        raise ValueError(f"{page} has no marks {begin} and {end}")
    before, _, rest = text.partition(begin)
    _, _, after = rest.partition(end)
    page.write_text("\n".join([before + begin, "", *lines, "", end]) + after)


def save(ratios: Sequence[Ratio], growths: Sequence[Growth], rows: Sequence[fits.Row]) -> list[Path]:
    """The figures that there are measurements for. NoPictures if no browser can be started."""
    made: dict[Path, go.Figure] = {}
    if ratios:
        made[IMAGES / "bench-ratios.png"] = ratios_figure(ratios)
    if growths:
        made[IMAGES / "bench-growth.png"] = growth_figure(growths)
    if rows:
        made[IMAGES / "bench-fits.png"] = fits_figure(rows)
    return image.save(made)
