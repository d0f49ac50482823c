"""Effects that measurements in a search space could not see or not tell apart, by the model workbench."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kincal.geometry import ArmChain, R_to_quat
from kincal.workbench.arms import read_arm
from kincal.workbench.data import Measurements
from kincal.workbench.effects import Library
from kincal.workbench.engine import merged
from kincal.workbench.fit import fit_model
from kincal.workbench.power import TWIN_CHI2, confounding, harm

from .explain import seeds


@dataclass(frozen=True)
class Apart:
    """unseen: effects of typical size that these poses would not show; twins: pairs that both show but that
    cannot be told apart; harm_m: what the worst ones could do to the tool while still unseen."""

    tested: int
    unseen: list[str]
    twins: list[tuple[str, str]]
    harm_m: list[tuple[str, float]]


def apart(
    space: Any, arm: Any, model: str | Path, chosen: list[int], sigma_pos_m: float, sigma_rot_rad: float
) -> Apart:
    """For candidates `chosen`, as if each had been measured once; `model`: arm file of the workbench."""
    table, chain = read_arm(model), ArmChain(arm)
    q = seeds(space, chain.n)[chosen]
    rng = np.random.default_rng(1)
    poses = [chain.fk(x) for x in q]
    noise = np.repeat([sigma_pos_m, sigma_rot_rad], 3)
    data = Measurements(
        "search space",
        tuple(str(i) for i in chosen),
        q,
        np.array([p for p, _ in poses]) + rng.normal(0.0, sigma_pos_m, (len(q), 3)),
        np.array([R_to_quat(R) for _, R in poses]),
        np.tile(np.diag(noise**2), (len(q), 1, 1)),
    )
    fit = fit_model(table, data)
    hypotheses = []
    for effect in Library.load().effects.values():
        if effect.missing(table, data) or effect.twin_of or (effect.per == "pair" and not effect.pairs):
            continue
        group = effect.instances(table, data)
        first = [h for h in group if h.constants == group[len(group) // 2].constants]
        hypotheses += [h for h in [merged(effect, first)] if any(p.terms for p in h.parameters)]
    c = confounding(fit, hypotheses)
    seen = np.diag(c.d2) >= TWIN_CHI2
    twins = [
        (c.names[i], c.names[j])
        for i in range(len(c.names))
        for j in range(i)
        if seen[i] and seen[j] and min(c.d2[i, j], c.d2[j, i]) < TWIN_CHI2
    ]
    worst = [(h.name, h.error_m) for h in harm(fit, hypotheses)[:5]]
    return Apart(len(c.names), [n for n, s in zip(c.names, seen, strict=True) if not s], twins, worst)
