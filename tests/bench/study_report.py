"""Tables and figures of study.py: lines of its runs in, Markdown and plotly figures out."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.colors import hex_to_rgb
from plotly.subplots import make_subplots
from scipy.stats import binomtest

from kincal.pages import image, theme

LIMIT_MM, LIMIT_MRAD = 1.0, 5.0
REFERENCE = "ucb"  # today's default: what other designs are compared with
BASELINE = "random"
A1 = 0.5  # share of the position in f, as CONFIG has it
OBJECTIVE = (REFERENCE, BASELINE)  # designs in the figures of f
OBJECTIVE_SCENARIOS = ("paper", "two_biases")  # the paper's Fig. 1 and Fig. 3
ERROR_SCENARIOS = ("paper", "uniform")
BANDS_MAX = 4  # in one panel
FINISHED = ("change", "no change")
COSTS = {
    "visits": "poses",
    "observations": "observations",
    "seconds": "mission time [s]",
    "joules": "energy [J]",
}
VISITS = (2, 6, 8, 10, 12, 14, 17, 20, 25, 34)
Line = dict[str, Any]
Lines = Sequence[Line]


# ---- numbers of a run ------------------------------------------------------------------------------------


def settled(line: Line) -> int | None:
    """Index of the entry from which on the held-out error stays within both limits; None if it does not, or
    if the run ended without a correction."""
    errors = zip(line["columns"]["mm"], line["columns"]["mrad"], strict=True)
    good = [mm <= LIMIT_MM and mrad <= LIMIT_MRAD for mm, mrad in errors]
    if not good or not good[-1] or line["end"] not in FINISHED:
        return None
    return next((k + 1 for k in range(len(good) - 1, -1, -1) if not good[k]), 0)


def cost(line: Line, column: str) -> float:
    """Visits, observations, seconds or joules until the error stays within the limits; infinite if it does
    not, nan if the design does not tell."""
    k, spent = settled(line), line["columns"][column]
    if any(value is None for value in spent):
        return float("nan")
    return float("inf") if k is None else float(spent[k])


def error_at(line: Line, column: str, limit: float, what: str = "mm") -> float:
    """Held-out error when that many visits, seconds ... are spent: that of the last entry within the limit;
    before the first one, the error before the calibration."""
    within = [k for k, value in enumerate(line["columns"][column]) if value <= limit]
    return float(line["columns"][what][within[-1]] if within else line["before"][what == "mrad"])


def quantile(values: Iterable[float], q: float) -> float:
    """The smallest of the values that a share q does not exceed; may be infinite."""
    return float(np.quantile(list(values), q, method="inverted_cdf"))


def spent(line: Line, column: str) -> float:
    """In the whole run; nan if the design does not tell."""
    last = line["columns"][column][-1]
    return float("nan") if last is None else float(last)


# ---- tables ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Study:
    """Runs, and the names of scenarios and designs in the order of tables. outside: designs of others."""

    lines: Lines
    scenarios: dict[str, str]
    designs: dict[str, str]
    outside: dict[str, str]

    def of(self, scenario: str, design: str) -> Lines:
        """Runs of one scenario and design, by seed."""
        own = [x for x in self.lines if (x["scenario"], x["design"]) == (scenario, design)]
        return sorted(own, key=lambda x: x["seed"])

    def groups(self, scenario: str, outside: bool = True) -> list[tuple[str, Lines]]:
        """Designs that have runs, with these."""
        names = [*self.designs, *(self.outside if outside else ())]
        return [(name, own) for name in names if (own := self.of(scenario, name))]

    @property
    def flown(self) -> list[str]:
        """Scenarios that have runs."""
        return [name for name in self.scenarios if self.groups(name)]


def number(value: float, digits: str, beyond: str = "never") -> str:
    """A number for a table; "-" if it is not known."""
    if np.isnan(value):
        return "-"
    return format(value, digits) if np.isfinite(value) else beyond


def both(values: Iterable[float], digits: str, beyond: str = "never") -> str:
    """Median / 90th percentile."""
    values = list(values)
    if any(np.isnan(v) for v in values):
        return "-"
    return " / ".join(number(quantile(values, q), digits, beyond) for q in (0.5, 0.9))


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]], texts: int = 1) -> str:
    """A table; all columns but the first ones are numbers."""
    lines = [f"| {' | '.join(head)} |", f"|{'---|' * texts}{'---:|' * (len(head) - texts)}"]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)]) + "\n"


def cost_table(study: Study, scenario: str) -> str:
    """Until the error stays within the limits, and at the end."""
    head = ("design", "within the limits", "poses", "observations", "s", "J", "poses in all", "mm at the end")
    rows = []
    for design, own in study.groups(scenario):
        beyond = f"> {max(int(spent(x, 'visits')) for x in own)}"
        costs = [both((cost(x, c) for x in own), ".0f", beyond if c == "visits" else "never") for c in COSTS]
        reached = f"{sum(settled(x) is not None for x in own)} of {len(own)}"
        visits = number(quantile([spent(x, "visits") for x in own], 0.5), ".0f")
        rows.append(
            (f"`{design}`", reached, *costs, visits, both((x["columns"]["mm"][-1] for x in own), ".2f"))
        )
    return markdown(head, rows)


def visit_table(study: Study, scenario: str) -> str:
    """Error after some numbers of poses."""
    rows = []
    for design, own in study.groups(scenario, outside=False):
        cells = [both((error_at(x, "visits", n) for x in own), ".3g") for n in VISITS]
        rows.append((f"`{design}`", *cells))
    return markdown(("mm after poses", *map(str, VISITS)), rows)


def ratio_table(study: Study) -> str:
    """Each design in parts of the reference, same scenario: medians."""
    head = ("scenario", "design", "poses", "s", "J", "error at the mission time of the reference")
    rows = []
    for scenario in study.flown:
        groups = dict(study.groups(scenario, outside=False))
        if REFERENCE not in groups:
            continue
        reference = {x["seed"]: x for x in groups[REFERENCE]}
        for design, own in groups.items():
            if design != REFERENCE and (
                pairs := [(x, reference[x["seed"]]) for x in own if x["seed"] in reference]
            ):
                rows.append((study.scenarios[scenario], f"`{design}`", *_ratios(pairs)))
    return markdown(head, rows, texts=2)


def _ratios(pairs: list[tuple[Line, Line]]) -> list[str]:
    cells = []
    for column in ("visits", "seconds", "joules"):
        ours, theirs = (quantile([cost(p[k], column) for p in pairs], 0.5) for k in (0, 1))
        finite = np.isfinite(ours) and np.isfinite(theirs)
        cells.append(number(ours / theirs if finite else float("nan"), ".2f"))
    ends = [spent(theirs, "seconds") for _, theirs in pairs]
    at = [error_at(ours, "seconds", end) for (ours, _), end in zip(pairs, ends, strict=True)]
    theirs = quantile([p[1]["columns"]["mm"][-1] for p in pairs], 0.5)
    return [*cells, number(quantile(at, 0.5) / theirs, ".2f")]


def baseline_table(study: Study) -> str:
    """Against the baseline, seed by seed: is a design better than chance?"""
    head = ["scenario", "design", "fewer poses", "as many", "more", "p of poses"]
    head += ["smaller error at the end", "larger", "p of error"]
    rows = []
    for scenario in study.flown:
        groups = dict(study.groups(scenario, outside=False))
        base = {x["seed"]: x for x in groups.get(BASELINE, ())}
        for design, own in groups.items():
            pairs = [(x, base[x["seed"]]) for x in own if x["seed"] in base]
            if design != BASELINE and pairs:
                fewer, same, more, p = sign_test([(cost(x, "visits"), cost(y, "visits")) for x, y in pairs])
                ends = [(x["columns"]["mm"][-1], y["columns"]["mm"][-1]) for x, y in pairs]
                smaller, _, larger, p_end = sign_test(ends)
                cells = (
                    *map(str, (fewer, same, more)),
                    f"{p:.2g}",
                    str(smaller),
                    str(larger),
                    f"{p_end:.2g}",
                )
                rows.append((study.scenarios[scenario], f"`{design}`", *cells))
    return markdown(head, rows, texts=2)


def sign_test(pairs: Sequence[tuple[float, float]]) -> tuple[int, int, int, float]:
    """How many of the first are less, the same, more, and the two-sided p of a sign test."""
    less, more = sum(a < b for a, b in pairs), sum(a > b for a, b in pairs)
    p = float(binomtest(less, less + more).pvalue) if less + more else 1.0
    return less, len(pairs) - less - more, more, p


def hidden_table(study: Study, scenario: str) -> str:
    """f on the scale of its whole run beside what is still wrong, for the reference."""
    own = study.of(scenario, REFERENCE)
    found = [(objectives(x), x["columns"]) for x in own]
    rows = []
    for k in (1, 2, 3, 6, 10, 14, 20, 34):
        at = [
            (f[k - 1], c["off_mm"][k - 1], c["mm"][k - 1], c["mrad"][k - 1]) for f, c in found if len(f) >= k
        ]
        if 2 * len(at) > len(own):
            f, *rest = zip(*at, strict=True)
            cells = [*(quantile(f, q) for q in (0.1, 0.5, 0.9)), *(quantile(v, 0.5) for v in rest)]
            rows.append((str(k), *(f"{v:.3g}" for v in cells)))
    head = ("pose", "f, 10 % are below", "f, median", "f, 90 % are below", "this pose is off by, mm")
    return markdown((*head, "held out, mm", "held out, mrad"), rows)


def objectives(line: Line) -> list[float]:
    """f of eq. 6 for each pose of a run; s_p and s_q are the largest distances of the run."""
    c = line["columns"]
    off = [(mm, mrad) for mm, mrad in zip(c["off_mm"], c["off_mrad"], strict=True) if mm is not None]
    most = [max(max(v), 1e-9) for v in zip(*off, strict=True)]
    return [-(A1 * mm / most[0] + (1.0 - A1) * mrad / most[1]) for mm, mrad in off]


def endings(study: Study) -> str:
    """Every run that did not end with a correction, and every contact of the true arm."""
    flown = [x for x in study.lines if x["design"] in study.designs]
    odd = [x for x in flown if x["end"] not in ("change", "no change")]
    touched = [x for x in flown if x.get("contacts")]
    out = [
        f"{len(flown)} missions flown. {len(odd)} ended without a correction to approve,"
        f" in {len(touched)} the true arm touched something."
    ]
    for x, what in [(x, x["end"]) for x in odd] + [(x, ", ".join(x["contacts"])) for x in touched]:
        out.append(f"- {study.scenarios[x['scenario']]}, `{x['design']}`, seed {x['seed']}: {what}")
    return "\n".join(out) + "\n"


def page_parts(study: Study) -> dict[str, str]:
    """The generated parts of docs/STUDY.md by name."""
    seeds = sorted({x["seed"] for x in study.lines})
    limits = (
        f"Limits: {LIMIT_MM:g} mm and {LIMIT_MRAD:g} mrad. Median / 90th percentile of seeds {seeds[0]} to"
        f" {seeds[-1]}."
    )
    has_runs = {x["design"] for x in study.lines}
    every = study.designs | study.outside
    named = ((f"`{name}`", what) for name, what in every.items() if name in has_runs)
    designs = markdown(("design", "how poses are chosen"), named, texts=2)
    costs = [f"### {_title(study, s)}\n\n{cost_table(study, s)}" for s in study.flown]
    errors = [f"### {_title(study, s)}\n\n{visit_table(study, s)}" for s in study.flown]
    first = study.flown[0]
    return {
        "designs": designs,
        "costs": "\n".join([limits + "\n", *costs]),
        "errors": "\n".join(errors),
        "baseline": baseline_table(study),
        "ratios": ratio_table(study),
        "hidden": hidden_table(study, first),
        "endings": endings(study),
    }


def _title(study: Study, scenario: str) -> str:
    title = study.scenarios[scenario]
    return title[0].upper() + title[1:]


PART = re.compile(r"(?<=<!-- made: )(?P<name>\w+)( -->\n).*?(?=<!-- end -->\n)", re.S)


def write_page(page: Path, parts: dict[str, str]) -> None:
    """Put each part between its marks. ValueError if the page lacks one."""
    text = page.read_text()
    if lacking := [name for name in parts if name not in {m["name"] for m in PART.finditer(text)}]:
        raise ValueError(f"{page.name} has no part {lacking[0]!r}: no line <!-- made: {lacking[0]} -->")
    page.write_text(PART.sub(lambda m: f"{m['name']} -->\n\n{parts[m['name']]}\n", text))


# ---- figures ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Band:
    """Median and 10 to 90 % of some runs over x."""

    x: np.ndarray
    low: np.ndarray
    median: np.ndarray
    high: np.ndarray


def band(x: Sequence[float], columns: Sequence[Sequence[float]]) -> Band:
    """columns: for each x, the values of all runs."""
    found = [[quantile(values, q) for q in (0.1, 0.5, 0.9)] for values in columns]
    low, median, high = np.array(found).T
    return Band(np.array(x, float), low, median, high)


def error_band(own: Lines, column: str, points: int = 120) -> Band:
    """Held-out error [mm] over visits, observations, seconds or joules."""
    end = quantile([spent(x, column) for x in own], 0.9)
    whole = column in ("visits", "observations")
    x = np.arange(1, end + 1) if whole else np.linspace(end / points, end, points)
    return band(x, [[error_at(run, column, v) for run in own] for v in x])


def objective_band(own: Lines, scale: tuple[float, float]) -> Band:
    """-f of eq. 6 by pose, with the same s_p [mm] and s_q [mrad] for all, while half of the runs measure."""
    values: list[list[float]] = []
    for run in own:
        c = run["columns"]
        for k, (mm, mrad) in enumerate(zip(c["off_mm"], c["off_mrad"], strict=True)):
            if mm is not None:
                values += [[]] if k == len(values) else []
                values[k].append(A1 * mm / scale[0] + (1.0 - A1) * mrad / scale[1])
    kept = [v for v in values if 2 * len(v) >= len(own)]
    return band(range(1, len(kept) + 1), kept)


def colour_of(study: Study, design: str) -> str:
    """The same in all figures."""
    colours = (*theme.SERIES, theme.WINE, theme.GREY)
    return colours[[*study.designs, *study.outside].index(design) % len(colours)]


def label(study: Study, design: str) -> str:
    """In a legend."""
    return f"<b>{design}</b>: {(study.designs | study.outside)[design]}"


def banded(study: Study, scenario: str) -> list[str]:
    """Designs whose bands are drawn: all that fly; of many the reference and the soonest within limits."""
    flown = dict(study.groups(scenario, outside=False))
    if len(flown) <= BANDS_MAX:
        return list(flown)
    others = [d for d in flown if d != REFERENCE]
    return [REFERENCE, min(others, key=lambda d: quantile([cost(x, "seconds") for x in flown[d]], 0.5))]


def add_band(figure: go.Figure, made: Band, colour: str, at: tuple[int, int]) -> None:
    """10 to 90 % of the runs."""
    x, y = np.concatenate([made.x, made.x[::-1]]), np.concatenate([made.high, made.low[::-1]])
    fill = f"rgba{(*hex_to_rgb(colour), 0.14)}"
    trace = go.Scatter(x=x, y=y, fill="toself", fillcolor=fill, line={"width": 0}, mode="lines")
    figure.add_trace(trace.update(hoverinfo="skip", showlegend=False), row=at[0], col=at[1])


def add_median(
    figure: go.Figure, study: Study, design: str, x: Sequence[float], y: Sequence[float], at: tuple[int, int]
) -> None:
    """The line of a design; in the legend once, by the first panel."""
    dash = "dash" if design in study.outside else "solid"
    line = {"color": colour_of(study, design), "width": 2.2, "dash": dash}
    named = not any(t.legendgroup == design for t in figure.data)
    trace = go.Scatter(x=x, y=y, mode="lines", line=line, name=label(study, design), legendgroup=design)
    figure.add_trace(trace.update(showlegend=named), row=at[0], col=at[1])


LOG = {"type": "log", "dtick": 1, "tickformat": "~g", "minor": {"ticks": "outside"}}
LEGEND = {"orientation": "h", "yanchor": "top", "xanchor": "left", "x": 0.0}


def add_limit(figure: go.Figure, x_end: float, at: tuple[int, int], limit: float = LIMIT_MM) -> None:
    """A dotted line at the limit; a trace, because shapes do not follow a logarithmic axis."""
    line = {"color": theme.GREY, "dash": "dot", "width": 1.5}
    trace = go.Scatter(
        x=[0, x_end], y=[limit] * 2, mode="lines", line=line, showlegend=False, hoverinfo="skip"
    )
    figure.add_trace(trace, row=at[0], col=at[1])


def objective(study: Study, scenario: str, designs: Sequence[str]) -> go.Figure:
    """The paper's figure: f by pose, linear as there and logarithmic, and what it does not show."""
    titles = (
        "f (eq. 6), as the paper draws it",
        "\u2212f on a logarithmic scale",
        "held-out error meanwhile",
    )
    figure = make_subplots(rows=1, cols=3, subplot_titles=titles, horizontal_spacing=0.08)
    theme.styled(figure, 440, legend={**LEGEND, "y": -0.2}, margin=theme.TITLED)
    chosen = [(d, own) for d in designs if (own := study.of(scenario, d))]
    every = [x["columns"] for _, own in chosen for x in own]
    scale = tuple(max(v for c in every for v in c[name] if v is not None) for name in ("off_mm", "off_mrad"))
    last = 1.0
    for design, own in chosen:
        colour, f, error = colour_of(study, design), objective_band(own, scale), error_band(own, "visits")
        last = max(last, error.x[-1])
        for col, made in enumerate((Band(f.x, -f.high, -f.median, -f.low), f, error), 1):
            add_band(figure, made, colour, (1, col))
            add_median(figure, study, design, made.x, made.median, (1, col))
    add_limit(figure, last, (1, 3))
    figure.update_xaxes(title_text="poses measured", range=[0, last])
    figure.update_xaxes(title_text="poses visited", row=1, col=3)
    for col, title in enumerate(("f [-]", "\u2212f [-]", "position RMS [mm]"), 1):
        figure.update_yaxes(title_text=title, row=1, col=col)
    figure.update_yaxes(**LOG, row=1, col=2)
    figure.update_yaxes(**LOG, row=1, col=3)
    return figure


def errors(study: Study, scenario: str) -> go.Figure:
    """Held-out error against all that a calibration costs."""
    figure = make_subplots(rows=2, cols=2, horizontal_spacing=0.09, vertical_spacing=0.16)
    theme.styled(figure, 780, legend={**LEGEND, "y": -0.1}, margin={"t": 24})
    bands = banded(study, scenario)
    for k, (column, title) in enumerate(COSTS.items()):
        at, last = (k // 2 + 1, k % 2 + 1), 1.0
        for design, own in study.groups(scenario, outside=column in ("visits", "observations")):
            made = error_band(own, column)
            if design in study.outside:  # nothing is known of fewer poses than they are made for
                known = made.x >= quantile([x["columns"][column][0] for x in own], 0.9)
                made = Band(*(v[known] for v in (made.x, made.low, made.median, made.high)))
            last = max(last, float(made.x[-1]))
            if design in bands:
                add_band(figure, made, colour_of(study, design), at)
            add_median(figure, study, design, made.x, made.median, at)
        add_limit(figure, last, at)
        figure.update_xaxes(title_text=title, rangemode="tozero", row=at[0], col=at[1])
        figure.update_yaxes(title_text="held-out position RMS [mm]", **LOG, row=at[0], col=at[1])
    return figure


def shares(study: Study) -> go.Figure:
    """Share of the runs within the limits by number of poses, all scenarios and designs."""
    names = study.flown
    titles = [_title(study, s) for s in names]
    figure = make_subplots(
        rows=1, cols=len(names), shared_yaxes=True, subplot_titles=titles, horizontal_spacing=0.025
    )
    theme.styled(figure, 420, width=1500, legend={**LEGEND, "y": -0.22}, margin=theme.TITLED)
    for col, scenario in enumerate(names, 1):
        for design, own in study.groups(scenario):
            found = np.array([cost(x, "visits") for x in own])
            # a run that skips one candidate after the other does not set the scale
            x = np.arange(0, int(quantile([spent(run, "visits") for run in own], 0.9)) + 1)
            y = [100.0 * np.mean(found <= v) for v in x]
            add_median(figure, study, design, np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1], (1, col))
        figure.update_xaxes(title_text="poses visited", row=1, col=col)
    figure.update_yaxes(title_text="runs within the limits [%]", row=1, col=1)
    return figure


def figures(study: Study, folder: Path) -> dict[Path, go.Figure]:
    """All figures that there are runs for, by file."""
    makers: dict[str, Callable[[], go.Figure]] = {"study-poses": lambda: shares(study)}
    for scenario in study.flown:
        word = scenario.replace("_", "-")
        if scenario in OBJECTIVE_SCENARIOS:
            makers[f"study-f-{word}"] = lambda s=scenario: objective(study, s, OBJECTIVE)
        if scenario in ERROR_SCENARIOS:
            makers[f"study-error-{word}"] = lambda s=scenario: errors(study, s)
    return {folder / f"{name}.png": make() for name, make in makers.items()}


def save(study: Study, folder: Path) -> list[Path]:
    """Make them. NoPictures if no browser can be started."""
    return image.save(figures(study, folder))
