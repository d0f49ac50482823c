"""Gravity levers of an arm whose masses nobody knows: which bodies act on a joint in ways of their own.

The torque of gravity about a joint is the sum over what hangs beyond it of mass x lever. The masses are the
unknowns of a fit, the levers follow from the geometry. Bodies whose levers are sums of others' (frames with
one origin, a link that does not move its end) would only share their coefficients: they are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from kincal.flight import Arm, Model, Observations, Terms
from kincal.rotations import Pose
from kincal_shared.schema.arm import ArmTable
from kincal_shared.schema.names import LEVER_STRIDE
from kincal_shared.schema.terms import Basis

from ..numerics.types import Array

TOOL = 0
"""Number of the tool among the bodies; the others have that of their link."""

_POSTURES = 128
_SEED = 11  # of the postures that levers are compared at
_OWN_PART = 0.2  # of a lever's spread that others do not explain: less is no lever of its own
_LEAST = 1e-3  # [N m/kg] spread of a lever: 0.1 mm
_SOME_TOOL_M = (0.11, 0.07, 0.13)
_GRAVITY = 9.81  # [m/s^2] where the arm table has none


def bodies(arm: ArmTable, link: int, variables: Sequence[str]) -> tuple[int, ...]:
    """Bodies beyond a link (0 = base) with levers of their own, from the tool inwards, TOOL first.

    variables: which components count, of "levx", "levy", "levz". A constant lever is none: DH errors take it.
    """
    taken: list[Array] = []
    found = []
    for body in (TOOL, *range(min(arm.n, LEVER_STRIDE - 1), link, -1)):
        lever = np.concatenate([_lever(arm, variable, link, body) for variable in variables])
        if _is_own(lever, taken):
            taken.append(_without(lever, taken) / np.linalg.norm(_without(lever, taken)))
            found.append(body)
    return tuple(found)


def _is_own(lever: Array, taken: Sequence[Array]) -> bool:
    spread = float(np.linalg.norm(lever))
    own = float(np.linalg.norm(_without(lever, taken)))
    return spread > _LEAST * np.sqrt(len(lever)) and own > _OWN_PART * spread


def _without(lever: Array, taken: Sequence[Array]) -> Array:
    """What of a lever is left when unit vectors that are at right angles are taken out."""
    left = lever
    for unit in taken:
        left = left - (unit @ left) * unit
    return left


@lru_cache(maxsize=2048)
def _lever(arm: ArmTable, variable: str, link: int, body: int) -> Array:
    """(postures,) of one lever, its mean taken out."""
    values = _postures(arm).basis_values(Basis("lin", variable, LEVER_STRIDE * link + body), ())
    centred: Array = values - values.mean()
    return centred


@lru_cache(maxsize=32)
def _postures(arm: ArmTable) -> Model:
    """The nominal arm at postures all over its joint limits; where nobody knows how its base stands, gravity
    comes from all sides."""
    rng = np.random.default_rng(_SEED)
    low, high = (np.array([getattr(joint, key) for joint in arm.joints]) for key in ("q_min", "q_max"))
    columns = {"q": rng.uniform(low, high, (_POSTURES, arm.n))}
    g = np.asarray(arm.gravity_m_s2, dtype=float)
    if arm.base.estimate:
        side = rng.standard_normal((_POSTURES, 3))
        size = float(np.linalg.norm(g)) or _GRAVITY
        columns["g_m_s2"] = size * side / np.linalg.norm(side, axis=1)[:, None]
    base = Pose.identity() if arm.base.estimate else Pose.of_wxyz(arm.base.xyz_m, arm.base.quat_wxyz)
    tool = _some_tool() if arm.tool.estimate else Pose.of_wxyz(arm.tool.xyz_m, arm.tool.quat_wxyz)
    return Model(Arm.of(arm, base, tool), Terms.of(()), Observations.of_columns(columns, g))


def _some_tool() -> Pose:
    """Stands for a tool that nobody knows: off every axis."""
    return Pose(np.array(_SOME_TOOL_M), np.eye(3))
