"""Sampled DH errors: the wrong arms under which a search space has to be safe."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from kincal_shared.schema.dh import DH_FIELDS
from kincal_shared.schema.space import Description


class Stream(IntEnum):
    """Purposes of random numbers. Each has its own stream, so that more numbers for one leave the others."""

    ERRORS = 1
    TOOL_POSES = 2
    SERVO_BOUND = 3
    RECHECK = 4


def error_bounds(desc: Description, n_joints: int) -> dict[str, float]:
    """Bound of every DH error [rad or m] by name ("J7.phi_rad"); parameters without an error are left out."""
    out = {}
    for j in range(n_joints):
        for field in DH_FIELDS:
            if (value := getattr(desc.error_bounds, field)[j]) > 0.0:
                out[f"J{j + 1}.{field}"] = value
    return out


def sampled_errors(desc: Description, n_joints: int) -> list[dict[str, float]]:
    """Sets of DH errors [rad or m] by name: the named cases, then each large error alone at both its bounds,
    then combinations of several errors at their bounds, sampled from the seed of the description."""
    bound = error_bounds(desc, n_joints)
    named = [dict(case) for case in desc.error_bounds.case]
    return named + _single(desc, bound) + _combined(desc, bound)


def _single(desc: Description, bound: dict[str, float]) -> list[dict[str, float]]:
    threshold = {True: desc.error_bounds.alone_rad, False: desc.error_bounds.alone_m}
    large = [name for name in bound if bound[name] >= threshold[name.endswith("_rad")]]
    return [{name: sign * bound[name]} for name in large for sign in (1.0, -1.0)]


def _combined(desc: Description, bound: dict[str, float]) -> list[dict[str, float]]:
    rng = np.random.default_rng([desc.seed, Stream.ERRORS])
    names = list(bound)
    out = []
    for _ in range(desc.error_bounds.draws if names else 0):
        chosen = rng.choice(len(names), min(desc.error_bounds.errors, len(names)), replace=False)
        out.append({names[k]: float(rng.choice([-1.0, 1.0])) * bound[names[k]] for k in chosen})
    return out
