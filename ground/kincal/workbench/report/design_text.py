"""What the poses determine of a model and its residuals by axis, as text and as JSON."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from ..comparison.compare import Comparison
from ..fit.identifiability import Axis, Identifiability


def identifiability_json(x: Identifiability) -> dict[str, Any]:
    """`identifiability` of a comparison."""
    return {
        "parameters": x.parameters,
        "rank": x.rank,
        "determined": x.determined,
        "condition": x.condition,
        "correlated": [{"names": [p.first, p.second], "correlation": p.correlation} for p in x.correlated],
        "not_separate": [list(group) for group in x.not_separate],
    }


def axes_json(axes: Sequence[Axis]) -> list[dict[str, Any]]:
    """Residuals by axis, in millimetres and milliradians."""
    return [
        {"axis": a.name, f"rms_{_unit(a)}": 1e3 * a.rms, f"max_{_unit(a)}": 1e3 * a.largest} for a in axes
    ]


def _unit(a: Axis) -> str:
    return "mrad" if a.name.startswith("r") else "mm"


def design_lines(c: Comparison) -> Iterator[str]:
    """Parameters, rank and condition; what cannot be told apart; residuals by axis."""
    x = c.identifiability
    yield (
        f"parameters         {x.determined} of {x.parameters} constrained by the data, rank {x.rank}, "
        f"condition {x.condition:.3g}"
    )
    yield from _correlated_lines(x)
    yield from _group_lines(x)
    yield from _axes_lines(c)


def _correlated_lines(x: Identifiability) -> Iterator[str]:
    if x.correlated:
        pairs = ", ".join(f"{p.first} with {p.second} ({p.correlation:+.3f})" for p in x.correlated)
        yield f"correlated         {pairs}"


def _group_lines(x: Identifiability) -> Iterator[str]:
    several = [group for group in x.not_separate if len(group) > 1]
    alone = [group[0] for group in x.not_separate if len(group) == 1]
    if several:
        yield "not identifiable   one by one, only in combination:"
        yield from (f"                     {', '.join(group)}" for group in several)
    if alone:
        yield f"no effect          at these poses: {', '.join(alone)}"


def _axes_lines(c: Comparison) -> Iterator[str]:
    kind = "held" if c.residual_axes["held"] else "fit"
    label = {"held": "held-out poses", "fit": "fitted poses"}[kind]
    for unit in ("mm", "mrad"):
        axes = [a for a in c.residual_axes[kind] if _unit(a) == unit]
        if axes:
            numbers = ", ".join(f"{a.name} {1e3 * a.rms:.3f} / {1e3 * a.largest:.3f}" for a in axes)
            yield f"by axis            {numbers} {unit} (RMS / largest, {label})"
