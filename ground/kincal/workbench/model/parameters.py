"""Coefficients of a model, each with the correction terms it scales: DH errors, frames, effects."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from kincal.flight import FRAME_TOOL
from kincal_shared.schema.arm import ArmTable, Frame
from kincal_shared.schema.dh import BETA_ERROR, DH_ERRORS
from kincal_shared.schema.terms import ONE

from ..numerics.types import Array, array
from .effects import Hypothesis, Parameter, Term

# Prior sigmas. Wide enough that data of a few poses overrule them (1.3 rad is moved by 0.1 mrad), tight
# enough to keep combinations that the data do not determine from wandering.
DH_SIGMA = {"phi_rad": 0.2, "alpha_rad": 0.2, "a_m": 0.1, "d_m": 0.1, "beta_rad": 0.2}
FRAME_SIGMA = {"m": 1.0, "rad": 1.0}

# Axes of consecutive joints whose sine is less count as parallel: a tilt of 5 mrad in their common plane
# would turn the common normal, and with it phi, by more than 0.1 rad.
_PARALLEL = 0.05

_LEAST_SIGMA_RAD = 1e-7  # of a beta: a covariance beside priors of 0.1 rad is rounding below

BETA = "DH beta"
"""What the turns between parallel axes are called together where a file cannot hold them."""

Named = tuple[str, Parameter]
_FRAME_COMPONENTS = (("tx", "m"), ("ty", "m"), ("tz", "m"), ("rx", "rad"), ("ry", "rad"), ("rz", "rad"))


def _constant(name: str, unit: str, sigma: float, frame: int, component: int) -> Parameter:
    """A coefficient that is one component of the twist at one frame."""
    return Parameter(name, unit, sigma, (Term(frame, component, 1.0, (ONE, ONE)),))


def dh_parameters(arm: ArmTable) -> list[Named]:
    """The DH errors as single terms: rz, tz at frame j-1; tx, rx at frame j; and ry there where the next axis
    is nearly parallel (Hayati & Mirmirani's beta, METHOD.md 9). Names `J3.alpha_rad`."""
    return [
        (f"J{j}.{e.name}", _constant(e.name, e.unit, DH_SIGMA[e.name], e.frame(j), e.component))
        for j in range(1, arm.n + 1)
        for e in (*DH_ERRORS, BETA_ERROR)
        if e is not BETA_ERROR or _parallel_to_next(arm, j)
    ]


def is_beta(name: str) -> bool:
    """Whether a coefficient is a turn between parallel axes: J2.beta_rad."""
    return name.endswith(f".{BETA_ERROR.name}")


def given_no_beta(names: Sequence[str], value: Array, cov: Array) -> Array:
    """(k,) the most probable coefficients if every turn between parallel axes were zero: the mean of a fit's
    normal distribution under that condition."""
    beta = np.array([is_beta(name) for name in names], dtype=bool)
    own = cov[np.ix_(beta, beta)] + _LEAST_SIGMA_RAD**2 * np.eye(int(beta.sum()))
    moved = value - cov[:, beta] @ np.linalg.solve(own, value[beta])
    return array(np.where(beta, 0.0, moved))


def _parallel_to_next(arm: ArmTable, j: int) -> bool:
    """Whether the axis of joint j + 1 is nearly parallel to that of joint j."""
    return j < arm.n and abs(math.sin(arm.joints[j - 1].alpha_rad)) < _PARALLEL


def frame_parameters(arm: ArmTable) -> list[Named]:
    """Twists of base and tool where the arm table says they are to be estimated. Names `base.tx_m`."""

    def twist(label: str, frame: Frame, number: int) -> Iterator[Named]:
        for component, (name, unit) in enumerate(_FRAME_COMPONENTS):
            if frame.estimate:
                yield f"{label}.{name}_{unit}", _constant(name, unit, FRAME_SIGMA[unit], number, component)

    return [*twist("base", arm.base, 0), *twist("tool", arm.tool, FRAME_TOOL)]


def effect_parameters(hypotheses: Iterable[Hypothesis], width: float) -> list[Named]:
    """The coefficients of effects, `width` prior sigmas wide unless the data chose their size. Names
    `joint_compliance[2].c`."""
    return [
        (f"{h.name}.{p.name}", p if p.shrunk else replace(p, sigma=width * p.sigma))
        for h in hypotheses
        for p in h.parameters
    ]
