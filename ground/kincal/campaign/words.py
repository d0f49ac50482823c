"""The results of a campaign in words and cells, for text and page."""

from __future__ import annotations

from kincal.results import length_text
from kincal_shared.schema.campaign import ALL

from .statistics import OPEN, Distribution, Evaluated, Influence


def percent(share: float) -> str:
    """A share."""
    return f"{100.0 * share:.2f} %" if share == share else "-"


def number(column: str, value: float | None) -> str:
    """A number with the unit that its column says."""
    if value is None or value != value or abs(value) == float("inf"):
        return "-"
    if column.endswith("_m"):
        return length_text(value)
    if column.endswith("_rad"):
        return f"{value * 1e3:.2f} mrad"
    if column.endswith("_s"):
        return f"{value:.0f} s"
    return f"{value:.4g}"


def quantile_cells(d: Distribution) -> list[str]:
    """Quantiles with their bounds; a dash where the cases give none."""
    if not d.quantiles:
        return ["-"] * 4
    return [
        f"{number(d.column, q.value)} ({number(d.column, q.low)} to {number(d.column, q.high)})"
        for q in d.quantiles
    ]


def requirement_cells(r: Evaluated) -> list[str]:
    """Name, cases that met it, share, what is shown, what is wanted, verdict."""
    s, c = r.share, r.requirement
    shown = f">= {percent(r.low)}"
    return [c.name, f"{s.k} of {s.n}", percent(s.value), shown, f">= {percent(c.probability)}", r.verdict]


def verdict_text(r: Evaluated) -> str:
    """What was judged, and what is missing."""
    c = r.requirement
    given = "" if c.given == ALL else f" where {c.given}"
    text = f"{c.name}: {c.holds}{given}, confidence {percent(c.confidence)}"
    if r.died:
        text += f"; {r.died} that died count as not met"
    if r.verdict == OPEN:
        text += f"; at least {max(r.needed, 1)} cases are needed, more if any fails"
    return text


def influence_cells(i: Influence) -> list[str]:
    """Key, correlations, probability by chance, Sobol index with its confidence."""
    sobol = f"{i.sobol[0]:.3f} ± {i.sobol[1]:.3f}" if i.sobol else "-"
    size = "-" if i.size is None else f"{i.size:+.2f}"
    return [i.key, f"{i.rank:+.2f}", size, f"{i.p:.2g}", sobol]
