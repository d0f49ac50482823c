"""Unknown base and tool frames found without a first guess.

    T_meas,i = B A_i X,  A_i the nominal chain, B (base) and X (tool) unknown where `estimate` is set.

Both unknown: with orientations the linear robot-world / hand-eye solution (Shah 2013, J. Mechanisms
Robotics 5:031007: Kronecker product and SVD); with positions only a global search over R_B, for which
the remaining unknowns are linear. One unknown: closed form by averaging.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from kincal.errors import CannotAnswer

_SEARCH = 3000  # rotations tried; the mean gap is about 15 degrees, well inside the basin


def nearest_rotation(matrix: np.ndarray) -> np.ndarray:
    """The rotation nearest to a 3x3 matrix (Frobenius), by SVD."""
    u, _, vt = np.linalg.svd(matrix)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt


def _as_matrix(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rotation, translation
    return out


def solve_frames(
    chain: np.ndarray,
    p_m: np.ndarray,
    rotation: np.ndarray | None,
    base: np.ndarray | None,
    tool: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Base and tool frames (4x4) from the nominal chain.

    chain: (N, 4, 4) A_i; p_m: (N, 3); rotation: (N, 3, 3) measured, or None; base, tool: the known
    frame, or None to estimate it. CannotAnswer when there are too few or too similar poses.
    """
    if base is not None and tool is not None:
        return base, tool
    need = 3 if rotation is not None else (7 if base is None and tool is None else 4)
    if len(p_m) < need:
        raise CannotAnswer(
            f"{len(p_m)} poses cannot determine the unknown frames; at least {need} are needed"
        )
    if rotation is not None:
        if base is None and tool is None:
            base, tool = _robot_world_hand_eye(chain, p_m, rotation)
        elif base is None:
            base = _mean_frame([m @ np.linalg.inv(a @ tool) for m, a in _pairs(chain, p_m, rotation)])
        else:
            tool = _mean_frame([np.linalg.inv(base @ a) @ m for m, a in _pairs(chain, p_m, rotation)])
        return base, tool
    return _positions_only(chain, p_m, base, tool)


def _pairs(chain, p_m, rotation):
    return [(_as_matrix(r, p), a) for r, p, a in zip(rotation, p_m, chain, strict=True)]


def _mean_frame(frames: list[np.ndarray]) -> np.ndarray:
    stack = np.array(frames)
    rotation = Rotation.from_matrix(stack[:, :3, :3]).mean().as_matrix()
    return _as_matrix(rotation, np.median(stack[:, :3, 3], axis=0))


def _robot_world_hand_eye(chain, p_m, rotation):
    # R_meas = R_B R_A R_X  <=>  R_B^T R_meas = R_A R_X; K = sum R_A (x) R_meas has the pair
    # (vec R_X, vec R_B^T ...) as leading singular vectors (Shah 2013, eq. 11-14).
    k = sum(np.kron(a[:3, :3].T, m.T) for a, m in zip(chain, rotation, strict=True))
    u, s, vt = np.linalg.svd(k)
    if s[1] > 0.999 * s[0]:
        raise CannotAnswer("the poses turn too little to tell the base frame from the tool frame")
    # kron(A^T, M^T) vec(R_B) = vec(M^T R_B A) = vec(R_X^T), column-major vec
    r_b = vt[0].reshape(3, 3, order="F")
    r_xt = u[:, 0].reshape(3, 3, order="F")
    sign = 1.0 if np.linalg.det(r_b) > 0 else -1.0
    r_b, r_x = nearest_rotation(sign * r_b), nearest_rotation(sign * r_xt).T
    # p = R_B (R_A t_X + t_A) + t_B: linear in t_X and t_B
    rows = np.concatenate([np.hstack([r_b @ a[:3, :3], np.eye(3)]) for a in chain])
    rhs = np.concatenate([p - r_b @ a[:3, 3] for a, p in zip(chain, p_m, strict=True)])
    solution, *_ = np.linalg.lstsq(rows, rhs, rcond=None)
    return _as_matrix(r_b, solution[3:]), _as_matrix(r_x, solution[:3])


def _positions_only(chain, p_m, base, tool):
    """Tool orientation cannot be seen; it stays the identity."""
    r_a, t_a = chain[:, :3, :3], chain[:, :3, 3]
    if base is not None:
        # p = R_B (R_A t_X + t_A) + t_B with B known
        rows = np.concatenate(r_a)
        rhs = ((p_m - base[:3, 3]) @ base[:3, :3] - t_a).ravel()
        t_x, *_ = np.linalg.lstsq(rows, rhs, rcond=None)
        return base, _as_matrix(np.eye(3), t_x)
    if tool is not None:
        points = t_a + r_a @ tool[:3, 3]
        return _rigid_fit(points, p_m), tool
    # R_B^T (p - t_B) = R_A t_X + t_A: for a given R_B linear in t_X and s = R_B^T t_B, with a
    # design that does not depend on R_B, so one projection serves all rotations tried.
    n = len(p_m)
    design = np.concatenate([np.hstack([r, np.eye(3)]) for r in r_a])
    q, _ = np.linalg.qr(design)

    def leftover(rhs: np.ndarray) -> np.ndarray:
        return rhs - q @ (q.T @ rhs)

    # leftover is affine in the nine entries of R_B^T: project each once
    columns = []
    for i in range(3):
        for j in range(3):
            rhs = np.zeros((n, 3))
            rhs[:, i] = p_m[:, j]
            columns.append(leftover(rhs.ravel()))
    columns = np.array(columns).T
    constant = leftover(-t_a.ravel())
    gram, cross = columns.T @ columns, columns.T @ constant
    tries = Rotation.random(_SEARCH, random_state=np.random.RandomState(1)).as_matrix().reshape(-1, 9)
    cost = np.einsum("ni,ij,nj->n", tries, gram, tries) + 2.0 * tries @ cross
    best, best_cost = None, np.inf
    for index in np.argsort(cost)[:12]:
        start = Rotation.from_matrix(tries[index].reshape(3, 3))

        def residual(w, start=start):
            matrix = (Rotation.from_rotvec(w) * start).as_matrix()
            return columns @ matrix.ravel() + constant

        found = least_squares(residual, np.zeros(3), method="lm")
        if found.cost < best_cost:
            best, best_cost = (Rotation.from_rotvec(found.x) * start).as_matrix(), found.cost
    rhs = ((p_m @ best.T) - t_a).ravel()
    solution, *_ = np.linalg.lstsq(design, rhs, rcond=None)
    rotation = best.T
    return _as_matrix(rotation, rotation @ solution[3:]), _as_matrix(np.eye(3), solution[:3])


def _rigid_fit(points: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Rotation and translation that carry points onto seen (Kabsch)."""
    cp, cs = points.mean(axis=0), seen.mean(axis=0)
    rotation = nearest_rotation((seen - cs).T @ (points - cp))
    return _as_matrix(rotation, cs - rotation @ cp)
