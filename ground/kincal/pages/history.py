"""The page of a mission's tables: what was in force when, trends of the coefficients and of the monitor."""

from __future__ import annotations

import math
from collections.abc import Sequence

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from kincal.pages import theme
from kincal.pages.page import Grid, Page, Provenance, Section
from kincal.review.history import History, Trend, decided, utc
from kincal.review.journal import Entry, unfinished

_COLUMNS = 3
_SCALE = {"rad": (180.0 / math.pi, "°"), "m": (1e3, "mm")}


BY_RECORDINGS = "By the recordings; who decided, by the journal."
HEARD = "There are no recordings of this link: in force now, by housekeeping; who decided, by the journal."
DOTS = "Dots: proposed value with 1 sigma, filled where it was put in force. Dotted: bounds."
JOURNAL = "Newest first, by the journal: each signed command, its attempt before and what came of it after."
OPEN = "Nothing says what came of it: the state of flight does"
NO_LINE = "The journal has no line."
_MOST_LINES = 500
NO_TREND = "No correction whose TERMS table is at hand."


def page(
    history: History,
    trends: Sequence[Trend],
    entries: Sequence[Entry],
    provenance: Provenance,
    *,
    recorded: bool = True,
) -> Page:
    """trends: of the coefficients; entries: of the journal; recorded: the times are those of recordings."""
    n, unnamed = len(history.corrections), len(history.corrections) - _named(trends)
    rest = f", {unnamed} of them of TERMS tables that are not at hand" if unnamed else ""
    about = f"{n} correction{'' if n == 1 else 's'}{rest}"
    speaks = any(m.state == 1 for m in history.monitor)
    sections = [
        Section("in-force", "What was in force when", BY_RECORDINGS if recorded else HEARD,
                grid=in_force(history, entries)),
        Section("trend", "Coefficients over the corrections",
                DOTS if trends else NO_TREND, trend_figure(trends) if trends else None),
        Section("monitor", "Monitor for miscalibration", "What it said of the joint that it suspects most.",
                monitor_figure(history) if speaks else None, monitor_grid(history)),
        Section("journal", "What was sent, decided and asked", JOURNAL if entries else NO_LINE,
                grid=journal_grid(entries)),
    ]  # fmt: skip
    return Page("History", "Tables in force, corrections, decisions", about, provenance, sections)


def _named(trends: Sequence[Trend]) -> int:
    return max((len(t.points) for t in trends), default=0)


def in_force(history: History, entries: Sequence[Entry]) -> Grid:
    """Newest first. entries: who decided."""
    rows = [
        [utc(x.utc_s), x.kind, x.crc or "none", history.what(x), decided(x, entries)]
        for x in reversed(history.in_force)
    ]
    return Grid.of("<from [UTC, or s of mission]|<table|<CRC|<what|<who and why", rows)


def journal_grid(entries: Sequence[Entry]) -> Grid:
    """Lines of the journal, newest first."""
    open_ = {id(e) for e in unfinished(entries)}
    rows = []
    for e in reversed(entries[-_MOST_LINES:]):
        why = f"{e.why}; override: {e.override}" if e.override else e.why
        if id(e) in open_:
            why += f". {OPEN}"
        when = e.time.replace("T", " ").replace("+00:00", "")
        rows.append([when, e.words, e.crc, e.by, str(e.key_id or ""), why])
    rest = len(entries) - len(rows)
    note = f"{rest} older entries: `kincal audit log`" if rest > 0 else ""
    return Grid.of("<UTC|<what|<CRC|<by|key|<why", rows, note)


def trend_figure(trends: Sequence[Trend]) -> go.Figure:
    """One small plot for each coefficient."""
    n_rows = -(-len(trends) // _COLUMNS)
    titles = [_title(t) for t in trends]
    figure = make_subplots(rows=n_rows, cols=_COLUMNS, subplot_titles=titles,
                           vertical_spacing=min(0.3 / n_rows, 0.2), horizontal_spacing=0.09)  # fmt: skip
    theme.styled(figure, 50 + 165 * n_rows, showlegend=False, margin={"t": 40})
    figure.update_annotations(font={"size": theme.FONT_PX - 1})
    for number, t in enumerate(trends):
        at = {"row": number // _COLUMNS + 1, "col": number % _COLUMNS + 1}
        scale, unit = _SCALE.get(t.unit, (1.0, t.unit))
        x = [utc(p.utc_s) for p in t.points]
        y, s = [p.value * scale for p in t.points], [p.sigma * scale for p in t.points]
        figure.add_trace(
            go.Scatter(
                x=x, y=y, error_y={"type": "data", "array": s, "color": theme.BLUE, "thickness": 1.5},
                mode="lines+markers", line={"color": theme.GREY, "width": 1},
                marker={"color": [theme.BLUE if p.active else theme.PAPER for p in t.points], "size": 8,
                        "line": {"color": theme.BLUE, "width": 1.5}},
                customdata=[[p.crc, "in force" if p.active else "proposed only"] for p in t.points],
                hovertemplate="%{customdata[0]}, %{customdata[1]}<br>%{y:.4g} ± %{error_y.array:.2g} "
                              f"{unit}<extra></extra>",
            ), **at,
        )  # fmt: skip
        reach = max(abs(v) + 2.0 * e for v, e in zip(y, s, strict=True))
        for bound in (t.lower * scale, t.upper * scale):
            if math.isfinite(bound) and abs(bound) <= 4.0 * max(reach, 1e-12):  # else it would hide the trend
                figure.add_hline(bound, line={"color": theme.RED, "dash": "dot", "width": 1.2}, **at)
        some = x[:: max(len(x) // 2, 1)]
        figure.update_xaxes(type="category", showticklabels=number >= len(trends) - _COLUMNS,
                            tickvals=some, ticktext=_short(some), **at)  # fmt: skip
    return figure


def _short(times: Sequence[str]) -> list[str]:
    """Dates without year and seconds, as labels of an axis."""
    return [text[5:16] if len(text) > 16 else text for text in times]


def _title(t: Trend) -> str:
    scale, unit = _SCALE.get(t.unit, (1.0, t.unit or "1"))
    most = max(abs(t.lower), abs(t.upper)) * scale
    return f"{t.name} [{unit}]" + (f", bound {most:.3g}" if math.isfinite(most) else "")


def monitor_figure(history: History) -> go.Figure:
    """Bias of the suspected joint over time; only where it names one."""
    rows = [m for m in history.monitor if m.state == 1 and m.joint]
    figure = go.Figure()
    theme.styled(figure, 220, showlegend=True)
    for joint in sorted({m.joint for m in rows}):
        mine = [m for m in rows if m.joint == joint]
        figure.add_trace(
            go.Scatter(
                x=[utc(m.utc_s) for m in mine], y=[math.degrees(m.bias_rad) for m in mine],
                mode="lines+markers",
                error_y={"type": "data", "array": [math.degrees(m.sigma_rad) for m in mine]},
                name=f"joint {joint}", marker={"symbol": theme.SYMBOLS[joint % len(theme.SYMBOLS)]},
                line={"color": theme.SERIES[joint % len(theme.SERIES)]},
            )
        )  # fmt: skip
    quiet = [m for m in history.monitor if m.state == 0]
    figure.add_trace(
        go.Scatter(x=[utc(m.utc_s) for m in quiet], y=[0.0] * len(quiet), mode="markers", name="quiet",
                   marker={"color": theme.GREEN, "size": 5})
    )  # fmt: skip
    figure.update_yaxes(title_text="bias [deg]")
    return figure


def monitor_grid(history: History) -> Grid:
    """Its changes of state, newest first."""
    rows = [[utc(m.utc_s), m.text, m.suspected] for m in reversed(history.monitor_changes())]
    return Grid.of("<from [UTC, or s of mission]|<state|<suspected", rows)
