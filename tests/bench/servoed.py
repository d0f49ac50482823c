"""Where the visual servo would bring the true arm, without flight: joints for a pose, on the MuJoCo model."""

from __future__ import annotations

import mujoco
import numpy as np

from kincal_sim.mechanics.arm import Arm


def pose_error(want: np.ndarray, have: np.ndarray) -> np.ndarray:
    """Position and small-angle rotation that bring `have` to `want`, base frame."""
    E = want[:3, :3] @ have[:3, :3].T
    axis = 0.5 * np.array([E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]])
    s, c = np.linalg.norm(axis), 0.5 * (np.trace(E) - 1.0)
    return np.concatenate([want[:3, 3] - have[:3, 3], axis * (np.arctan2(s, c) / s if s > 1e-9 else 1.0)])


def true_joints(arm: Arm, want: np.ndarray, q: np.ndarray, tries: int = 200) -> np.ndarray | None:
    """Joints of the true arm for a pose, by damped least squares from q; None if out of reach."""
    q = q.copy()
    tool = arm.model.body("tool").id
    J = np.zeros((6, arm.model.nv))
    for _ in range(tries):
        arm.set(q)
        e = pose_error(want, arm.T_base_tool)
        if np.linalg.norm(e) < 1e-9:
            return q
        mujoco.mj_comPos(arm.model, arm.data)
        mujoco.mj_jacBody(arm.model, arm.data, J[:3], J[3:], tool)
        Ja = J[:, : arm.n]
        step = Ja.T @ np.linalg.solve(Ja @ Ja.T + 1e-4 * min(1.0, np.linalg.norm(e)) * np.eye(6), e)
        step *= min(1.0, 0.3 / np.abs(step).max())
        q = np.clip(q + step, arm.q_min, arm.q_max)
    return None
