"""What pages show of a fit and what the answers do not hold: values of variables, apparent motions."""

from __future__ import annotations

import numpy as np

from kincal_shared.schema.terms import Basis

from ..evidence.unnamed import drivers
from ..fit.columns import Columns
from ..fit.least_squares import Fit
from ..numerics.types import Array, array

# Typical size of a joint's motion [rad or m]: keeps joints at zero that poses do not show.
_SIGMA_MOTION = 3e-3


def variable_values(name: str, fit: Fit) -> Array:
    """(N,) values of a driver variable over the poses, in its own unit where the data hold them or the
    model computes them, else the leading feature of its kernel."""
    recorded = _recorded(name, fit)
    if recorded is not None:
        return recorded
    if name in ("zcam", "u", "v", "r2", "sx", "sy", "sz"):
        return fit.model.basis_values(Basis("lin", name, 0), fit.estimate)
    if name.startswith("tau"):
        return fit.model.basis_values(Basis("lin", "tau", int(name[3:])), fit.estimate)
    return next(driver.features[:, 0] for driver in drivers(Columns(fit)) if driver.name == name)


def _recorded(name: str, fit: Fit) -> Array | None:
    """A column of the data; None if it is not one."""
    data = fit.data
    kind = name.rstrip("0123456789")
    per_joint = {"q": data.q, "dir": data.direction, "qdot": data.qdot}.get(kind)
    if per_joint is not None and kind != name:
        return array(per_joint[:, int(name[len(kind) :]) - 1])
    columns = {
        "t": data.t_s, "order": data.t_s, "temp": data.temp_c, "payload": data.payload_kg,
        "incid": data.incid_rad, "pan": data.pan_rad, "tilt": data.tilt_rad, "tag": data.tag,
    }  # fmt: skip
    return columns.get(name)


def apparent_motion(fit: Fit, joint: int) -> Array:
    """(N,) motion [rad, prismatic: m] of one joint (from 1) alone that would explain each pose's residual
    best. A view of the residuals, not a test."""
    jq = np.einsum("nij,nj->ni", fit.whiten, fit.evaluation.Jq[:, :, joint - 1])
    z = fit.z.reshape(len(jq), -1)
    return array((jq * z).sum(axis=1) / ((jq**2).sum(axis=1) + 1.0 / _SIGMA_MOTION**2))
