"""Named effects that predict better, whether or not something unnamed explains more.

Chosen by cross-validation of the fit poses only, so that the held-out poses stay the judges.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..fit.columns import Columns
from ..model.effects import Hypothesis
from ..prediction.crossval import cross_validate
from .posterior import ACCEPT_ODDS
from .study import Model, Study

_SIGNIFICANT = 1.645  # standard errors of a gain: one-sided 95 %
_AS_WELL = 1.0  # standard errors within which effects predict equally well


@dataclass(frozen=True)
class Helper:
    """An effect that predicts significantly better, and the other effects that predict as well as it."""

    effect: Hypothesis
    ties: tuple[str, ...]


def helpful(study: Study, model: Model) -> Iterator[Helper]:
    """Effects to add to a model, best first. The best of those that predict as well (within one standard
    error: Breiman, Friedman, Olshen, Stone, Classification and Regression Trees, 1984, section 3.4.3) is
    the one with the fewest parameters."""
    asked = _asked_for(study, model)
    if not asked:
        return
    fit = study.held_fit(model)
    columns = Columns(fit, study.part_weight)
    losses = cross_validate(fit, columns, columns.hypotheses(asked))
    good = [k for k in np.argsort(-losses.gain) if losses.sigmas[k] > _SIGNIFICANT]
    while good:
        ties = [k for k in good if losses.behind(good[0])[k] <= _AS_WELL]
        first = min(ties, key=lambda k: len(asked[k].parameters))
        yield Helper(asked[first], tuple(asked[k].name for k in ties if k != first))
        good.remove(first)


def _asked_for(study: Study, model: Model) -> list[Hypothesis]:
    """Effects that win against "nothing missing" and need no more coefficients than there is room for: the
    prior of each keeps the best of many from winning by chance."""
    posterior = study.posterior(model)
    names = posterior.named(study.room(model))
    least = ACCEPT_ODDS * posterior.none
    return [posterior.by_name[name].best for name in names if posterior.probability[name] > least]
