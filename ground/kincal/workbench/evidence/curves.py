"""The function that an unnamed effect fits, with its error band: for pages, JSON and people."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kincal_shared.schema.names import COMPONENTS, VARIABLES
from kincal_shared.schema.terms import Basis

from ..fit.columns import Columns
from ..fit.least_squares import Fit
from ..model.effects import Hypothesis, Parameter
from ..model.shapes import evaluate, variable_basis
from ..model.unnamed_names import UnnamedName
from ..numerics.types import Array

_POINTS = 61
_SLICES = (0.1, 0.5, 0.9)  # quantiles of the other driver


@dataclass(frozen=True)
class Curve:
    """One line of a fitted function.

    driver, driver_unit: what x is; component: "rz", "tx" ... of the place; x: (M,) over the measured
    range; value, std: (M,) [unit] the error and its standard error, about the mean over the poses (a
    constant cannot be told from the DH errors); beside, at: the other driver and its value, "" and 0 where
    there is none.
    """

    driver: str
    driver_unit: str
    component: str
    unit: str
    x: Array
    value: Array
    std: Array
    beside: str = ""
    at: float = 0.0


def curves(fit: Fit, h: Hypothesis) -> tuple[Curve, ...]:
    """The function of an unnamed effect in a fit: one line for each component that has terms, and for each of
    up to three values of a second driver."""
    name = UnnamedName.parse(h.name)
    columns = Columns(fit, np.ones(fit.data.n))
    samples = {driver: columns.basis(variable_basis(driver)) for driver in name.drivers}
    along, *other = sorted(name.drivers, key=lambda d: len(np.unique(samples[d])) <= len(_SLICES))
    components = sorted({p.terms[0].comp for p in h.parameters})
    slices = _values(samples[other[0]]) if other else [0.0]
    return tuple(
        _curve(fit, h, component, along, samples, other[0] if other else "", at)
        for component in components
        for at in slices
    )


def _values(x: Array) -> list[float]:
    """Values of the second driver that lines are drawn at."""
    distinct = np.unique(x)
    return [float(v) for v in (distinct if len(distinct) <= len(_SLICES) else np.quantile(x, _SLICES))]


def _curve(
    fit: Fit, h: Hypothesis, component: int, along: str, samples: dict[str, Array], other: str, at: float
) -> Curve:
    x = np.linspace(samples[along].min(), samples[along].max(), _POINTS)
    line = {along: x} | ({other: np.full_like(x, at)} if other else {})
    mine = [p for p in h.parameters if p.terms[0].comp == component]
    design = _design(mine, line) - _design(mine, samples).mean(axis=0)
    places = [fit.names.index(f"{h.name}.{p.name}") for p in mine]
    cov = fit.cov[np.ix_(places, places)]
    return Curve(
        driver=along,
        driver_unit=VARIABLES[variable_basis(along).var].unit,
        component=COMPONENTS[component],
        unit=mine[0].unit,
        x=x,
        value=design @ fit.estimate[places],
        std=np.sqrt(np.maximum(((design @ cov) * design).sum(axis=1), 0.0)),
        beside=other,
        at=at,
    )


def _design(parameters: Sequence[Parameter], values: dict[str, Array]) -> Array:
    """(M, k) what one unit of each coefficient does at values of the drivers."""
    by_basis = {(b.var, b.index): x for driver, x in values.items() for b in [variable_basis(driver)]}

    def factor(basis: Basis) -> Array:
        rows = len(next(iter(values.values())))
        return evaluate(basis, by_basis[basis.var, basis.index]) if basis.var != "1" else np.ones(rows)

    return np.column_stack([factor(p.terms[0].basis[0]) * factor(p.terms[0].basis[1]) for p in parameters])
