"""The last move of the tool: what the error of a sensor follows that lags.

A filter in the sensor, or an average over time, gives a pose between the present one and those before it. The
move is that of the model, between the joint readings of both poses: the measured one is not known where poses
were left out, and carries noise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kincal.rotations import pose_difference

from ..fit.least_squares import Fit
from ..model.flight_model import observations
from ..numerics.types import Array, array


def last_move_of_tool(fit: Fit) -> Array | None:
    """(N, 6) change of the tool since the pose before, base frame: position [m], rotation vector [rad]; 0
    before any move. None where the order of the data tells none, or the arm stood still."""
    move = fit.data.move
    if move is None or not move.any():
        return None
    before = fit.model.at(observations(fit.arm, replace(fit.data, q=fit.data.q - move)))
    return array(pose_difference(fit.model.poses(fit.estimate), before.poses(fit.estimate)))


def length_of_last_move(fit: Fit) -> Array:
    """(N,) of the tool [m]; 0 where it is not known."""
    move = last_move_of_tool(fit)
    return np.zeros(fit.data.n) if move is None else array(np.linalg.norm(move[:, :3], axis=1))
