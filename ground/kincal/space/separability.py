"""Effects that measurements in a search space could not detect or could not tell apart, by the model
workbench. That is loaded when it is asked: a simulated run needs search spaces, but no workbench."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kincal.flight import Arm
from kincal_shared.schema.arm import ArmTable, read_arm

from .arrays import Bools, Floats
from .information import Noise
from .table import SpaceTable

if TYPE_CHECKING:
    from kincal.flight.headers import KcArm
    from kincal.workbench.data.measurements import Measurements
    from kincal.workbench.model.effects import Hypothesis
    from kincal.workbench.prediction.power import Confounding

_SEED = 1  # of the simulated noise
_WORST = 5  # undetectable effects that are named with the error they could cause


@dataclass(frozen=True)
class Separability:
    """Effects of the library, each at its typical size: how many were tested; those that the poses would not
    show; pairs that both show but cannot be told apart; what the worst ones could do to the tool while still
    undetected [m]."""

    tested: int
    undetectable: list[str]
    confounded: list[tuple[str, str]]
    harm_m: list[tuple[str, float]]


def separability(
    table: SpaceTable,
    arm: KcArm,
    model: str | Path,
    chosen: list[int],
    noise: Noise | None = None,
) -> Separability:
    """For candidates `chosen`, as if each had been measured once with the nominal arm of the ARM table;
    model: arm file of the workbench."""
    from kincal.workbench.fit.least_squares import fit_model
    from kincal.workbench.prediction.power import CONFOUNDED_CHI2, confounding, harm

    geometry = read_arm(model)
    data = _simulated(arm, table.q_rad[chosen], [str(i) for i in chosen], noise or Noise())
    fit = fit_model(geometry, data)
    hypotheses = list(_hypotheses(geometry, data))
    found = confounding(fit, hypotheses)
    shown = np.diag(found.d2) >= CONFOUNDED_CHI2
    return Separability(
        len(found.names),
        [name for name, show in zip(found.names, shown, strict=True) if not show],
        _confounded(found, shown, CONFOUNDED_CHI2),
        [(h.name, h.error_m) for h in harm(fit, hypotheses)[:_WORST]],
    )


def _simulated(arm: KcArm, q_rad: Floats, ids: list[str], noise: Noise) -> Measurements:
    """Measurements of the nominal arm at joints (n, joints)."""
    from kincal.workbench.data.measurements import Measurements

    rng = np.random.default_rng(_SEED)
    poses = Arm.of_table(arm).fk(q_rad)
    return Measurements(
        "search space",
        tuple(ids),
        q_rad,
        poses.p_m + rng.normal(0.0, noise.pos_m, (len(q_rad), 3)),
        poses.quat_wxyz,
        np.tile(np.diag(noise.rows**2), (len(q_rad), 1, 1)),
    )


def _hypotheses(geometry: ArmTable, data: Measurements) -> Iterator[Hypothesis]:
    """Effects of the library that the arm and data allow, at the middle of their grid of constants."""
    from kincal.workbench.model.effects import Library
    from kincal.workbench.model.hypotheses import merged

    for effect in Library.load().effects.values():
        if (
            effect.missing(geometry, data)
            or effect.equivalent_to
            or (effect.per == "pair" and not effect.pairs)
        ):
            continue
        group = effect.instances(geometry, data)
        middle = group[len(group) // 2].constants
        hypothesis = merged(effect, [h for h in group if h.constants == middle])
        if any(p.terms for p in hypothesis.parameters):
            yield hypothesis


def _confounded(found: Confounding, shown: Bools, least: float) -> list[tuple[str, str]]:
    """Pairs of detectable effects that are too alike: their chi2 differs by less than `least`."""
    pairs = ((i, j) for i in range(len(found.names)) for j in range(i) if shown[i] and shown[j])
    close = ((i, j) for i, j in pairs if min(found.d2[i, j], found.d2[j, i]) < least)
    return [(found.names[i], found.names[j]) for i, j in close]
