"""The flight model of an arm, its coefficients and its measurements, made from the workbench's objects."""

from __future__ import annotations

from collections.abc import Sequence

from kincal.flight import Arm, Model, Observations, Terms
from kincal.flight.builds import library
from kincal.rotations import Pose
from kincal_shared.schema.arm import ArmTable

from ..data.measurements import Measurements
from .effects import Parameter
from .parameters import Named
from .pnp import PnpColumns


def flight_model(
    arm: ArmTable, data: Measurements, base: Pose, tool: Pose, parameters: Sequence[Named]
) -> Model:
    """The model with base and tool frame set. CannotAnswer if it has more terms than the ground's
    build of the core carries."""
    return Model(Arm.of(arm, base, tool), Terms.of(parameters), observations(arm, data))


def observations(arm: ArmTable, data: Measurements) -> Observations:
    """Measurements as the flight model reads them."""
    return Observations.of(data, arm.gravity_m_s2, arm.camera).seen_by(PnpColumns.of(arm, data))


def nominal_chain(arm: ArmTable, data: Measurements) -> Pose:
    """(N,) poses of the last link of the nominal arm in frame 0: no base, no tool."""
    return Arm.of(arm).fk(data.q)


def room_for(parameters: Sequence[Parameter]) -> int:
    """Coefficients that may be added to these before the ground's term table is full."""
    limits = library("ground").lib
    n_terms = sum(len(p.terms) for p in parameters)
    return 0 if n_terms >= limits.KC_TERM_MAX else limits.KC_COEF_MAX - len(parameters)
