"""What these poses can and cannot show: confounding, smallest visible size, and the harm of the unseen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .columns import Columns
from .evidence import Projector
from .fit import Fit

TWIN_CHI2 = 9.0  # below this a pair cannot be told apart with these poses
_NINETY_PERCENT = 10.5  # chi^2 with 1 dof: non-centrality for 90 % power at 5 %


@dataclass(frozen=True)
class Confounding:
    """d2[i, j]: how much of effect i no mixture of DH and effect j explains [chi^2]; below about 9 the
    pair cannot be told apart with these poses (diagnosis.md 6)."""

    names: tuple[str, ...]
    d2: np.ndarray
    absorbed: np.ndarray


@dataclass(frozen=True)
class Harm:
    """smallest: size with 90 % power, in prior sigmas; error_m: what it would do to the tool position
    over the poses after DH has absorbed what it can."""

    name: str
    smallest: float
    error_m: float


def _engine(fit: Fit):
    columns = Columns(fit)
    projector = Projector.of(columns.weighted(fit.J) * fit.sigma_prior)
    return columns, projector


def confounding(fit: Fit, hypotheses) -> Confounding:
    """d^2(i|j) for every ordered pair of hypotheses."""
    columns, projector = _engine(fit)
    scale2 = fit.scale**2
    designs = [columns.hypothesis(h) for h in hypotheses]
    projected = [projector.apply(g) for g in designs]
    k = len(designs)
    d2 = np.zeros((k, k))
    absorbed = np.zeros(k)
    for i in range(k):
        own = float((designs[i] * projected[i]).sum()) / scale2
        absorbed[i] = 1.0 - float((designs[i] * projected[i]).sum()) / max(
            float((designs[i] ** 2).sum()), 1e-300
        )
        d2[i, i] = own
        for j in range(k):
            if i != j:
                inner = designs[j].T @ projected[j] + scale2 * np.eye(designs[j].shape[1])
                cross = projected[j].T @ designs[i]
                d2[i, j] = own - float((cross * np.linalg.solve(inner, cross)).sum()) / scale2
    return Confounding(tuple(h.name for h in hypotheses), np.maximum(d2, 0.0), absorbed)


def harm(fit: Fit, hypotheses) -> list[Harm]:
    """Harm chart: what could still be wrong unseen, and how much it would hurt. Worst first."""
    columns, projector = _engine(fit)
    plain = Columns(fit, np.ones(len(fit.weight)))
    n, c = fit.evaluation.r.shape
    unwhiten = np.linalg.inv(fit.whiten)
    out = []
    for h in hypotheses:
        g = columns.hypothesis(h)
        left = projector.apply(g)
        worst = None
        for k in range(g.shape[1]):
            signal = float((g[:, k] * left[:, k]).sum()) / fit.scale**2
            size = float(np.sqrt(_NINETY_PERCENT / signal)) if signal > 1e-9 else np.inf
            if not np.isfinite(size):
                continue
            rest = plain.hypothesis(h)[:, k]
            rest = rest - fit.J @ _absorbed_by_dh(fit, columns, g[:, k])
            error = np.einsum("nij,nj->ni", unwhiten, rest.reshape(n, c))[:, :3]
            found = Harm(h.name, size, size * float(np.sqrt((error**2).sum(axis=1).mean())))
            if worst is None or found.error_m > worst.error_m:
                worst = found
        if worst is not None:
            out.append(worst)
    return sorted(out, key=lambda x: -x.error_m)


def _absorbed_by_dh(fit: Fit, columns: Columns, g: np.ndarray) -> np.ndarray:
    """The DH (and frame) change that imitates the effect best, per coefficient."""
    a = columns.weighted(fit.J) * fit.sigma_prior / fit.scale
    inner = a.T @ a + np.eye(a.shape[1])
    return fit.sigma_prior * np.linalg.solve(inner, a.T @ g) / fit.scale
