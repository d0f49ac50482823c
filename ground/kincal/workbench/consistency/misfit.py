"""How badly an arm explains poses, as a share of the motion that was measured.

`misfit` fits unknown frames and joint offsets. `screened` is a bound from linear regression alone: with R_B^T
replaced by any matrix M, R_B^T (p - t_B) = R_A t_X + t_A is linear in M, t_X and R_B^T t_B. Hundreds of
readings of the files can be compared with it.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from kincal.flight import Arm
from kincal.rotations import Pose, matrix_of_wxyz, rotation_of_wxyz
from kincal_shared.errors import CannotAnswer
from kincal_shared.schema.arm import ArmTable

from ..data.measurements import Measurements
from ..fit.least_squares import Fit, fit_model
from ..model.effects import Hypothesis
from ..model.parameters import dh_parameters
from ..numerics.types import Array, array

LEAST_POSES = 12  # fewer leave the regression, with its 15 unknowns, too little to say
KEPT = 0.8  # share of the poses that counts
_OFFSET = "offset"  # name of the joint offsets among the coefficients
_OFFSET_SIGMA = 0.3  # [rad or m]
_MOST_OFFSET = 1.4  # [rad], below a quarter turn
_RANK = 1e-10  # of the regression, to its largest singular value
_AT_ONCE = 256  # ways of reading the files, for memory
_LEAST_SPREAD_M, _LEAST_TURN = 1e-6, 0.1  # smallest motion that errors are compared with [m], [rad]


def misfit(arm: ArmTable, data: Measurements, kept: float = KEPT) -> float:
    """Error that is left by unknown frames and joint offsets, over the spread of the measured poses; infinite
    where the poses do not determine the frames. Offsets of quarter turns are not fitted: they stand for
    another reading of the files. kept: share of the poses that counts."""
    try:
        with np.errstate(all="ignore"):  # a wrong reading may lead anywhere
            fit = fit_model(arm, data, [_offsets(arm)], dh=False, effect_width=1.0, rough=True)
            turned = np.abs(fit.estimate[_places(fit)]).max() > _MOST_OFFSET
            fit = fit_model(arm, data, dh=False, rough=True) if turned else fit
            left = rms_of_most(misfit_of(fit, data), kept)
    except (CannotAnswer, ValueError, np.linalg.LinAlgError):
        return np.inf
    return left if np.isfinite(left) else np.inf


def _places(fit: Fit) -> list[int]:
    """Where the offsets of turning joints are among the coefficients."""
    return [k for k, name in enumerate(fit.names) if name.startswith(_OFFSET) and name.endswith("phi_rad")]


def misfit_of(fit: Fit, data: Measurements) -> Array:
    """(N,) residuals of poses over the spread of all of them; of position and of orientation, whichever there
    are, as a root of the sum of squares."""
    r = fit.evaluation.r if data is fit.data else fit.predict(data)
    square = (r[:, :3] ** 2).sum(axis=1) / max(_spread_m(data), _LEAST_SPREAD_M) ** 2
    if data.quat_wxyz is not None:
        square = square + (r[:, 3:] ** 2).sum(axis=1) / max(_turn(data.quat_wxyz), _LEAST_TURN) ** 2
    return array(np.sqrt(square))


def rms_of_most(left: Array, kept: float = KEPT) -> float:
    """RMS of numbers (N,), without the largest, which `kept` leaves out: outliers are no question of how
    files are read, they are a finding of their own."""
    square = np.sort(left**2)
    return float(np.sqrt(square[: max(int(kept * len(square)), 1)].mean()))


def _offsets(arm: ArmTable) -> Hypothesis:
    """Offsets of the readings of all joints, as one effect."""
    wanted = {f"J{j}.{'d_m' if joint.prismatic else 'phi_rad'}" for j, joint in enumerate(arm.joints, 1)}
    found = [replace(p, name=name, sigma=_OFFSET_SIGMA) for name, p in dh_parameters(arm) if name in wanted]
    return Hypothesis(_OFFSET, _OFFSET, tuple(found))


def _spread_m(data: Measurements) -> float:
    return float(np.sqrt(((data.p_m - data.p_m.mean(axis=0)) ** 2).sum(axis=1).mean()))


def _turn(quat_wxyz: Array) -> float:
    """RMS angle of orientations (N, 4) about their mean [rad]."""
    turns = rotation_of_wxyz(quat_wxyz)
    return float(np.sqrt(((turns * turns.mean().inv()).magnitude() ** 2).mean()))


def screened(arm: ArmTable, q: Array, data: Measurements) -> Array:
    """Share of the motion of the nominal arm that the measured poses do not follow, frames and offsets aside:
    0 for an arm that explains them, up to about 1.

    q: (K, N, n) joint readings of the N poses, understood in K ways; the answer has one value for each. 5000
    ways of 60 poses take about half a second.
    """
    poses = Arm.of(arm)
    turns = None if data.quat_wxyz is None else matrix_of_wxyz(data.quat_wxyz)
    follow = _Positions(data.p_m)
    left = []
    for some in np.array_split(q, max(math.ceil(len(q) / _AT_ONCE), 1)):
        chain = poses.fk(some)
        one = follow.left_of(chain)
        left.append(one if turns is None else np.hypot(one, _left_of_turns(chain.R, turns)))
    return np.concatenate(left)


class _Positions:
    """The regression of the nominal arm's positions on measured ones (N, 3) [m]."""

    def __init__(self, p_m: Array) -> None:
        known = np.zeros((len(p_m), 3, 12))
        for i in range(3):
            known[:, i, 3 * i : 3 * i + 3] = p_m - p_m.mean(axis=0)
        known[:, :, 9:] = np.eye(3)
        u, s, _ = np.linalg.svd(_scaled(known.reshape(-1, 12)), full_matrices=False)
        self._basis = u[:, s > _RANK * s[0]]  # (3N, r) what the measured positions explain, for every arm

    def left_of(self, chain: Pose) -> Array:
        """(K,) shares of the positions of K x N poses that are left; the tool offset turns with the chain."""
        wanted = (chain.p_m - chain.p_m.mean(axis=-2, keepdims=True)).reshape(len(chain.p_m), -1, 1)
        turning = chain.R.reshape(len(chain.R), -1, 3)
        size = np.linalg.norm(wanted, axis=1)[:, 0]
        wanted, turning = self._without_known(wanted), self._without_known(turning)
        u, s, _ = np.linalg.svd(turning, full_matrices=False)
        u = u * (s > _RANK * math.sqrt(turning.shape[1] / 3))[:, None, :]  # its columns have this length
        rest = wanted - u @ (np.swapaxes(u, 1, 2) @ wanted)
        left: Array = np.linalg.norm(rest, axis=1)[:, 0] / np.maximum(size, _LEAST_SPREAD_M)
        return left

    def _without_known(self, columns: Array) -> Array:
        out: Array = columns - self._basis @ (self._basis.T @ columns)
        return out


def _scaled(columns: Array) -> Array:
    """Columns of unit length; those of zeros stay."""
    size = np.linalg.norm(columns, axis=0)
    out: Array = columns / np.where(size > 0.0, size, 1.0)
    return out


def _left_of_turns(nominal: Array, measured: Array) -> Array:
    """(K,) from the largest singular value of K = sum R_A^T (x) R_meas^T (frames.py), N for turns that agree;
    nominal: (K, N, 3, 3), measured: (N, 3, 3)."""
    k = np.swapaxes(nominal.reshape(len(nominal), -1, 9), 1, 2) @ measured.reshape(-1, 9)
    k = k.reshape(-1, 3, 3, 3, 3).transpose(0, 2, 4, 1, 3).reshape(-1, 9, 9)
    largest = np.linalg.svd(k, compute_uv=False)[:, 0]
    left: Array = np.sqrt(np.maximum(1.0 - largest / len(measured), 0.0))
    return left
