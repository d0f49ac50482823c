"""One arm on its lander in MuJoCo: positions are set, never integrated."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from ..transforms import rotation_matrix, transform
from .mjcf import GRAVITY_EARTH, mjcf
from .spec import load_spec, split_errors


class Arm:
    """MuJoCo model and data of one arm.

    spec: as load_spec reads it; errors: as split_errors takes them; gravity_m_s2: (3,) in the base frame;
    payload_kg: mass in the scoop; pictures: whether any will be taken of it.
    n: number of joints; q_min, q_max: (n,) limits [rad]; model, data: MuJoCo's.
    """

    def __init__(
        self,
        spec: dict | None = None,
        errors: dict[str, float] | None = None,
        gravity_m_s2: Sequence[float] = GRAVITY_EARTH,
        payload_kg: float = 0.0,
        pictures: bool = True,
    ):
        self.spec = spec or load_spec()
        self.n = len(self.spec["joint"])
        text = mjcf(self.spec, *split_errors(errors or {}, self.n), payload_kg, pictures)
        self.model = mujoco.MjModel.from_xml_string(text)
        self.model.opt.gravity[:] = gravity_m_s2
        self.data = mujoco.MjData(self.model)
        # Views of MuJoCo's arrays; to make one takes as long as to copy what is in it.
        self._joints, self._pantilt = self.data.qpos[: self.n], self.data.qpos[self.n :]
        self._tool, self._camera = self._place_of("tool"), self._place_of("camera")
        self._shape_names = [self.model.geom(i).name for i in range(self.model.ngeom)]
        self.q_min = np.array([j["q_rad"][0] for j in self.spec["joint"]])
        self.q_max = np.array([j["q_rad"][1] for j in self.spec["joint"]])

    def set(self, q_rad: ArrayLike, pan_rad: float | None = None, tilt_rad: float | None = None) -> None:
        """Put the true joints (and the pan-tilt unit) there and update all frames."""
        self._joints[:] = q_rad
        if pan_rad is not None:
            self._pantilt[0], self._pantilt[1] = pan_rad, tilt_rad
        mujoco.mj_kinematics(self.model, self.data)

    def tool_positions_m(self, q_rad: np.ndarray) -> np.ndarray:
        """(k, 3) positions of the tool frame at joints (k, n) [rad], but for rounding those that set() gives;
        the arm stays where it stands. A twentieth of the time for hundreds at once."""
        chain, k = [], self.model.body("tool").id
        while k:
            chain.append(k)
            k = self.model.body_parentid[k]
        rows, p = np.tile(np.eye(3), (len(q_rad), 1)), np.zeros(3 * len(q_rad))  # of attitudes; of positions
        for k in reversed(chain):
            p += rows @ self.model.body_pos[k]
            rows = rows @ rotation_matrix(self.model.body_quat[k])
            if self.model.body_jntnum[k]:  # mjcf.py: about z
                angle = np.repeat(q_rad[:, self.model.jnt_qposadr[self.model.body_jntadr[k]]], 3)
                x, y, c, s = rows[:, 0].copy(), rows[:, 1].copy(), np.cos(angle), np.sin(angle)
                rows[:, 0], rows[:, 1] = x * c + y * s, y * c - x * s
        return p.reshape(-1, 3)

    def _place_of(self, body: str) -> tuple[np.ndarray, np.ndarray]:
        """Position (3,) and attitude (3, 3) of a body as they are when they are read."""
        k = self.model.body(body).id
        return self.data.xpos[k], self.data.xmat[k].reshape(3, 3)

    @property
    def p_base_tool_m(self) -> np.ndarray:
        """(3,) position of the tool frame [m]."""
        return self._tool[0].copy()

    @property
    def T_base_tool(self) -> np.ndarray:
        """4x4 pose of the tool frame."""
        return transform(*self._tool)

    @property
    def T_base_cam(self) -> np.ndarray:
        """4x4 pose of the camera: z forward, x right, y down."""
        return transform(*self._camera)

    def gravity_torque(self) -> np.ndarray:
        """(n,) torque [N m] that gravity exerts about each joint at this posture, positive along +q."""
        bias = np.zeros(self.model.nv)
        mujoco.mj_comPos(self.model, self.data)
        self.data.qvel[:] = 0.0
        mujoco.mj_comVel(self.model, self.data)
        mujoco.mj_rne(self.model, self.data, 0, bias)
        return -bias[: self.n]

    def collisions(self) -> list[tuple[str, str]]:
        """Names of the shapes that touch at this posture."""
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_collision(self.model, self.data)
        if not self.data.ncon:  # mostly; the list is slow even if it is empty
            return []
        shape = self._shape_names
        return [(shape[a], shape[b]) for a, b in self.data.contact.geom]
