"""What pages show of a fit and what the answers do not hold: apparent motions."""

from __future__ import annotations

import numpy as np

from ..fit.least_squares import Fit
from ..numerics.types import Array, array

# Typical size of a joint's motion [rad or m]: keeps joints at zero that poses do not show.
_SIGMA_MOTION = 3e-3


def apparent_motion(fit: Fit, joint: int) -> Array:
    """(N,) motion [rad, prismatic: m] of one joint (from 1) alone that would explain each pose's residual
    best. A view of the residuals, not a test."""
    jq = np.einsum("nij,nj->ni", fit.whiten, fit.evaluation.Jq[:, :, joint - 1])
    z = fit.z.reshape(len(jq), -1)
    return array((jq * z).sum(axis=1) / ((jq**2).sum(axis=1) + 1.0 / _SIGMA_MOTION**2))
