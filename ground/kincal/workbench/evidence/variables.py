"""Values of driver variables over the poses."""

from __future__ import annotations

from kincal_shared.schema.terms import Basis

from ..fit.columns import Columns
from ..fit.least_squares import Fit
from ..model.unnamed_names import OF_ORIENTATION, TOOL_MOVE
from ..numerics.types import Array, array
from .lag import length_of_last_move
from .orientation import z_component
from .unnamed import drivers


def variable_values(name: str, fit: Fit) -> Array:
    """(N,) values of a driver variable over the poses, in its own unit where the data hold them or the
    model computes them; of a direction one component, else the leading feature of its kernel."""
    recorded = _recorded(name, fit)
    if recorded is not None:
        return recorded
    if name in ("zcam", "u", "v", "r2", "sx", "sy", "sz"):
        return fit.model.basis_values(Basis("lin", name, 0), fit.estimate)
    if name.startswith("tau"):
        return fit.model.basis_values(Basis("lin", "tau", int(name[3:])), fit.estimate)
    if name in OF_ORIENTATION:
        return z_component(name, Columns(fit))
    if name == TOOL_MOVE:
        return length_of_last_move(fit)
    return next(driver.features[:, 0] for driver in drivers(Columns(fit)) if driver.name == name)


def _recorded(name: str, fit: Fit) -> Array | None:
    """A column of the data; None if it is not one."""
    data = fit.data
    kind = name.rstrip("0123456789")
    per_joint = {"q": data.q, "dir": data.direction, "move": data.move, "qdot": data.qdot}.get(kind)
    if per_joint is not None and kind != name:
        return array(per_joint[:, int(name[len(kind) :]) - 1])
    columns = {
        "t": data.t_s, "order": data.t_s, "temp": data.temp_c, "payload": data.payload_kg,
        "incid": data.incid_rad, "pan": data.pan_rad, "tilt": data.tilt_rad, "tag": data.tag,
    }  # fmt: skip
    return columns.get(name)
