"""The page of a campaign."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from kincal.campaign import Comparison, Report
from kincal.campaign.words import (
    influence_cells,
    number,
    percent,
    quantile_cells,
    requirement_cells,
    verdict_text,
)
from kincal.pages import page as pages
from kincal.pages import theme
from kincal.pages.page import Cell, Grid, Page, Provenance, Section, Tile

MOODS = {"pass": "good", "fail": "bad", "not shown": ""}
STRONGEST = 15
POINTS = 2000  # of a curve
WIDE = 50.0  # largest over smallest value, from where on the axis is logarithmic
_OF_ENDS = (
    "With 95 % bounds of Clopper and Pearson. Where only numbers differ it is one end, with the first's."
)
UNITS = {"_m": (1e3, "mm"), "_rad": (1e3, "mrad"), "_s": (1.0, "s")}


def page(r: Report, compared: Comparison | None, date: str) -> Page:
    """A campaign, with another one for comparison or None; date: ISO day."""
    spec, results = r.results.plan.spec, r.results
    how = f"{spec.sampling} sampling, {len(results.plan.keys)} values dispersed"
    sections = [
        Section("requirements", "Requirements", _requirement_text(r), grid=_requirements(r)),
        Section("ends", "How cases ended", _OF_ENDS, grid=_ends(r)),
    ]  # fmt: skip
    if r.distributions:
        figure = distribution_figure([r, *([compared.b] if compared else [])])
        text = "Band: 95 % bounds of Clopper and Pearson."
        sections.append(Section("distribution", f"Distribution of {r.column}", text, figure=figure))
        text = "Bounds, 95 %, are order statistics."
        sections.append(Section("quantiles", "Quantiles", text, grid=_quantiles(r)))
    if r.influences:
        text = (
            "Spearman's rank correlation with the value, and with its distance from the middle. A "
            "grey bar is no more than chance gives (p > 0.05 over all values)."
        )
        rows = [influence_cells(i) for i in r.influences]
        cells = Grid.of("<value|with value|with size|p|Sobol index", rows)
        title = f"What {r.column} goes with"
        sections.append(Section("influences", title, text, influence_figure(r), cells))
    sections.append(
        Section("worst", "Worst cases", "Each command flies the case again, to the bit.", grid=_worst(r))
    )
    if compared:
        sections.insert(2, Section("compared", "Compared", _differing(compared), grid=_compared(compared)))
    return Page(
        kind="Campaign",
        title=spec.title or spec.scenario or spec.function,
        subtitle=f"{results.n} of {spec.cases} cases, {how}",
        provenance=Provenance(date, results.plan.crcs[""], str(results.folder), results.plan.hash, spec.seed),
        verdict=_verdict(r),
        tiles=_tiles(r),
        sections=sections,
        details="\n".join(f"{k}: {v}" for k, v in results.software.items()),
    )


def write(r: Report, compared: Comparison | None, path: Path, date: str) -> Path:
    """Write the page; its path."""
    return pages.write(page(r, compared, date), path)


def _verdict(r: Report) -> str:
    if not r.requirements:
        return "No requirement was asked to be judged."
    met = sum(j.verdict == "pass" for j in r.requirements)
    rest = "" if r.complete else " Not all cases are flown yet."
    return f"{met} of {len(r.requirements)} requirements are shown to be met.{rest}"


def _tiles(r: Report) -> list[Tile]:
    found = [
        Tile("cases", f"{r.results.n} of {r.results.plan.spec.cases}"),
        Tile("died", str(r.died), "bad" if r.died else "good"),
    ]
    return found + [
        Tile(j.requirement.name, j.verdict, MOODS[j.verdict], percent(j.share.value)) for j in r.requirements
    ]


def _requirement_text(r: Report) -> str:
    return " ".join(f"{verdict_text(j)}." for j in r.requirements)


def _requirements(r: Report) -> Grid:
    rows: list[Sequence[str | Cell]] = []
    for judged in r.requirements:
        *cells, verdict = requirement_cells(judged)
        rows.append([*cells, Cell(verdict, MOODS[verdict])])
    return Grid.of("<requirement|met|share|shown|wanted|<verdict", rows)


def _ends(r: Report) -> Grid:
    rows = [[end, str(s.k), percent(s.value), percent(s.low), percent(s.high)] for end, s in r.ends]
    return Grid.of("<end|cases|share|at least|at most", rows)


def _quantiles(r: Report) -> Grid:
    rows = [[d.column, str(len(d.values)), *quantile_cells(d)] for d in r.distributions]
    return Grid.of("<outcome|cases|5 %|50 %|95 %|99 %", rows)


def _worst(r: Report) -> Grid:
    rows = [[str(b.index), number(r.column, b.value), b.ended, b.reason, b.command] for b in r.worst]
    return Grid.of(f"case|{r.column or 'outcome'}|<ended|<reason|<command", rows)


def _differing(c: Comparison) -> str:
    different = "; ".join(c.different) or "nothing"
    return f"A: {c.a.results.folder}. B: {c.b.results.folder}. They differ in: {different}."


def _compared(c: Comparison) -> Grid:
    rows = [
        [x.name, f"{x.a.share.k} of {x.a.share.n}", f"{x.b.share.k} of {x.b.share.n}", f"{x.p:.3g}"]
        for x in c.requirements
    ]
    theirs = {d.column: d for d in c.b.distributions}
    for d in c.a.distributions:
        if d.column in theirs:
            p = f"{c.p_outcome:.3g}" if d.column == c.a.column else ""
            rows.append([f"{d.column}, median", quantile_cells(d)[1], quantile_cells(theirs[d.column])[1], p])
    return Grid.of("<|A|B|p if alike", rows)


# ---- figures


def distribution_figure(reports: Sequence[Report]) -> go.Figure:
    """Share of cases up to each value of the outcome, with bounds; of one or two campaigns."""
    column = reports[0].column
    scale, unit = next((u for end, u in UNITS.items() if column.endswith(end)), (1.0, ""))
    made = theme.figure(
        420, xaxis_title=f"{column} [{unit}]" if unit else column, yaxis_title="share of cases"
    )
    for r, colour in zip(reports, theme.SERIES, strict=False):
        d = next(d for d in r.distributions if d.column == column)
        if not len(d.values):
            continue
        low, high = d.bounds()
        use = np.unique(np.linspace(0, len(d.values) - 1, POINTS).astype(int))
        x, share = d.values[use] * scale, (use + 1) / len(d.values)
        steps = {"mode": "lines", "line_shape": "hv"}
        edge = {**steps, "line": {"color": colour, "width": 0.5}, "showlegend": False, "hoverinfo": "skip"}
        made.add_trace(go.Scatter(x=x, y=high[use], **edge))
        made.add_trace(go.Scatter(x=x, y=low[use], fill="tonexty", opacity=0.3, **edge))
        line = {"color": colour, "width": 2}
        made.add_trace(go.Scatter(x=x, y=share, name=str(r.results.folder), line=line, **steps))
        if d.values[0] > 0.0 and d.values[-1] > WIDE * d.values[0]:
            made.update_xaxes(type="log")
    return made


def influence_figure(r: Report) -> go.Figure:
    """The strongest rank correlations as bars, the strongest on top."""
    shown = r.influences[:STRONGEST][::-1]
    made = theme.figure(
        90 + 30 * len(shown), xaxis_title="rank correlation", xaxis_range=[-1, 1], barmode="group"
    )
    keys = [i.key for i in shown]
    for name, colour, opacity, values in (
        ("with its size", theme.ORANGE, 0.5, [i.size for i in shown]),
        ("with the value", theme.BLUE, 1.0, [i.rank for i in shown]),
    ):
        colours = [colour if i.p <= 0.05 else theme.GREY for i in shown]
        made.add_trace(
            go.Bar(x=values, y=keys, name=name, orientation="h", marker_color=colours, opacity=opacity)
        )
    return made.update_layout(legend_traceorder="reversed")
