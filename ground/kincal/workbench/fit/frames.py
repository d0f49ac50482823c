"""Unknown base and tool frames found without a first guess.

    T_meas,i = B A_i X,  A_i the nominal chain, B (base) and X (tool) unknown where `estimate` is set.

Both unknown: with orientations the linear robot-world / hand-eye solution (Shah 2013, J. Mechanisms
Robotics 5:031007: Kronecker product and SVD); with positions only a global search over R_B, for which
the remaining unknowns are linear. One unknown: closed form by averaging.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from kincal.rotations import Pose, nearest_rotation, rigid_fit
from kincal_shared.errors import CannotAnswer

from ..numerics.types import Array, array

_SEARCH = 3000  # rotations tried; the mean gap is about 15 degrees, well inside the basin
_REFINED = 12  # the best of them, refined
_STEPS, _STEP_RAD, _DAMPING = 100, 1e-12, 1e-3  # of each; it ends at a step below _STEP_RAD
_GENERATORS = -np.array(np.cross(np.eye(3)[:, None], np.eye(3)[None]))  # of rotations about x, y, z
_TWICE = _GENERATORS[:, None] @ _GENERATORS
_SECOND = (_TWICE + np.swapaxes(_TWICE, 0, 1)) / 2.0  # second derivatives of a rotation vector's matrix at 0
_FLAT = 1e-15  # of the largest curvature
_FEWEST_POSITIONS = 7  # that determine both frames
_SAME_TURNS = 0.999  # ratio of singular values from which on the poses turn too little


def solve_frames(
    chain: Pose, p_m: Array, rotation: Array | None, base: Pose | None, tool: Pose | None
) -> tuple[Pose, Pose]:
    """Base and tool frames from the nominal chain A_i (N poses).

    p_m: (N, 3) measured positions; rotation: (N, 3, 3) measured, or None; base, tool: the known frame,
    or None to estimate it. CannotAnswer when there are too few or too similar poses.
    """
    if base is not None and tool is not None:
        return base, tool
    _check_number(len(p_m), rotation is not None, base is None and tool is None)
    if rotation is None:
        return _positions_only(chain, p_m, base, tool)
    measured = Pose(p_m, rotation)
    if tool is not None:
        return _mean(measured @ (chain @ tool).inverse), tool
    if base is not None:
        return base, _mean((base @ chain).inverse @ measured)
    return _robot_world_hand_eye(chain, measured)


def _check_number(n: int, rotations: bool, both: bool) -> None:
    need = 3 if rotations else (_FEWEST_POSITIONS if both else 4)
    if n < need:
        frames = "base and tool frames" if both else "base or tool frame"
        raise CannotAnswer(
            f"{n} poses cannot determine the unknown {frames}, with which a fit begins: that takes at least "
            f"{need}",
            todo="measure more poses (coefficients take more than frames), or give a frame in the arm table",
        )


def _mean(frames: Pose) -> Pose:
    """Mean rotation and median position of a stack of frames."""
    return Pose(np.median(frames.p_m, axis=0), Rotation.from_matrix(frames.R).mean().as_matrix())


def _robot_world_hand_eye(chain: Pose, measured: Pose) -> tuple[Pose, Pose]:
    """R_meas = R_B R_A R_X  <=>  R_B^T R_meas = R_A R_X; K = sum R_A^T (x) R_meas^T has the pair
    (vec R_B, vec R_X^T) as leading singular vectors (Shah 2013, eq. 11-14), vec column-major. Where the
    orientation hardly changes, or turns about one axis only, the positions determine R_B."""
    k = np.einsum("nji,nlk->ikjl", chain.R, measured.R).reshape(9, 9)
    u, s, vt = np.linalg.svd(k)
    if s[1] > _SAME_TURNS * s[0]:
        if len(measured.p_m) < _FEWEST_POSITIONS:
            raise CannotAnswer(
                f"{len(measured.p_m)} poses that hardly turn cannot tell the base frame from the tool frame",
                todo=f"measure poses of other orientations, or at least {_FEWEST_POSITIONS} poses",
            )
        r_b = _RotationSearch.of(chain, measured.p_m).best()
        r_x = Rotation.from_matrix(np.swapaxes(r_b @ chain.R, 1, 2) @ measured.R).mean().as_matrix()
    else:
        r_b, r_xt = vt[0].reshape(3, 3, order="F"), u[:, 0].reshape(3, 3, order="F")
        sign = 1.0 if np.linalg.det(r_b) > 0 else -1.0
        r_b, r_x = nearest_rotation(sign * r_b), nearest_rotation(sign * r_xt).T
    # p = R_B (R_A t_X + t_A) + t_B: linear in t_X and t_B
    turned = r_b @ chain.R
    rhs = (measured.p_m - chain.p_m @ r_b.T).ravel()
    solution = _least_squares(_shift_design(turned), rhs)
    return Pose(solution[3:], r_b), Pose(solution[:3], r_x)


def _shift_design(turns: Array) -> Array:
    """(3 N, 6) rows [R_i, I] of turns (N, 3, 3): what a shift before and after them does."""
    eye = np.broadcast_to(np.eye(3), turns.shape)
    return array(np.concatenate([turns, eye], axis=2)).reshape(-1, 6)


def _least_squares(design: Array, rhs: Array) -> Array:
    return array(np.linalg.lstsq(design, rhs, rcond=None)[0])


# ------------------------------------------------------------------------------------ positions only


def _positions_only(chain: Pose, p_m: Array, base: Pose | None, tool: Pose | None) -> tuple[Pose, Pose]:
    """The tool's orientation cannot be seen; it stays the identity."""
    if base is not None:
        # p = R_B (R_A t_X + t_A) + t_B with B known
        rhs = (base.inverse.apply(p_m) - chain.p_m).ravel()
        return base, Pose(_least_squares(np.concatenate(chain.R), rhs), np.eye(3))
    if tool is not None:
        return rigid_fit(chain.apply(tool.p_m), p_m), tool
    search = _RotationSearch.of(chain, p_m)
    r_b = search.best()
    solution = _least_squares(search.design, (p_m @ r_b - chain.p_m).ravel())
    return Pose(r_b @ solution[3:], r_b), Pose(solution[:3], np.eye(3))


@dataclass(frozen=True)
class _RotationSearch:
    """R_B^T (p - t_B) = R_A t_X + t_A: for a given R_B linear in t_X and s = R_B^T t_B, with a design that
    does not depend on R_B, so that one projection serves all rotations tried.

    design: (3 N, 6); left: (10, 10), what the design leaves is as long as left @ (vec(R_B^T), 1), vec row by
    row: the triangle of its QR factors, so that a trial costs the same for any number of poses.
    """

    design: Array
    left: Array

    @classmethod
    def of(cls, chain: Pose, p_m: Array) -> _RotationSearch:
        """The search for a chain (N poses) and positions (N, 3)."""
        design = _shift_design(chain.R)
        q, _ = np.linalg.qr(design)
        entries = np.zeros((len(p_m), 3, 3, 3))  # pose, component, then row and column of R_B^T
        for i in range(3):
            entries[:, i, i, :] = p_m
        raw = np.column_stack([entries.reshape(-1, 9), -chain.p_m.ravel()])
        return cls(design, array(np.linalg.qr(raw - q @ (q.T @ raw), mode="r")))

    def best(self) -> Array:
        """R_B (3, 3) of least cost: many random rotations, the best of them refined."""
        turns = Rotation.random(_SEARCH, random_state=np.random.RandomState(1)).as_matrix()
        starts = turns[np.argsort(self._cost(turns))[:_REFINED]]
        refined = self._refined(starts)
        turn: Array = refined[np.argmin(self._cost(refined))].T
        return turn

    def _residual(self, turn: Array) -> Array:
        return array(turn.reshape(*turn.shape[:-2], 9) @ self.left[:, :9].T + self.left[:, 9])

    def _cost(self, turn: Array) -> Array:
        return array(np.sum(self._residual(turn) ** 2, axis=-1))

    def _refined(self, turns: Array) -> Array:
        """(K, 3, 3) R_B^T of least cost near K rotations: damped Newton steps of all at once, as rotation
        vectors, with all curvatures taken positive, which leads away from a saddle; one whose step is below
        _STEP_RAD stays where it is. Gauss-Newton took up to a hundred steps with an arm that does not fit."""
        turns, cost = turns.copy(), self._cost(turns)
        damping, moving = np.full(len(turns), _DAMPING), np.arange(len(turns))
        for _ in range(_STEPS):
            here = turns[moving]
            slope, curvature = self._derivatives(here)
            value, vector = np.linalg.eigh(curvature)
            size = np.abs(value) * (1.0 + damping[moving, None])
            size[size <= _FLAT * size.max(axis=1, keepdims=True)] = np.inf
            step = -(vector @ ((np.swapaxes(vector, 1, 2) @ slope) / size[:, :, None]))[:, :, 0]
            tried = Rotation.from_rotvec(step).as_matrix() @ here
            less = self._cost(tried)
            better = less < cost[moving]
            turns[moving[better]], cost[moving[better]] = tried[better], less[better]
            damping[moving] *= np.where(better, 0.1, 10.0)
            moving = moving[np.linalg.norm(step, axis=1) >= _STEP_RAD]
            if len(moving) == 0:
                break
        return turns

    def _derivatives(self, turns: Array) -> tuple[Array, Array]:
        """(K, 3, 1) and (K, 3, 3) derivatives of half the cost by a rotation vector, at K rotations."""
        matrix, residual = self.left[:, :9], self._residual(turns)
        jacobian = matrix @ np.swapaxes((_GENERATORS @ turns[:, None]).reshape(-1, 3, 9), 1, 2)
        across = np.swapaxes(jacobian, 1, 2)
        bent = (_SECOND @ turns[:, None, None]).reshape(-1, 3, 3, 9) @ (residual @ matrix)[:, None, :, None]
        return across @ residual[:, :, None], across @ jacobian + bent[..., 0]
