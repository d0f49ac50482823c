"""One arm on its lander in MuJoCo: positions are set, never integrated. Numbers are in models/wam.toml."""

from __future__ import annotations

import re
from collections.abc import Sequence
from copy import deepcopy
from functools import lru_cache
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from kincal_shared.installation import root
from kincal_shared.schema.errors import read_toml, validate
from kincal_shared.schema.simulator import PlantFile

from ..transforms import rotation_matrix, transform
from .mjcf import GRAVITY_EARTH, mjcf

SPEC_PATH = root() / "sim" / "models" / "wam.toml"
DH = ("phi_rad", "alpha_rad", "a_m", "d_m")
# Components of a frame error, as coefficients are named and as transforms.frame_error has them.
FRAME = {"tx_m": "tx", "ty_m": "ty", "tz_m": "tz", "rx_rad": "rx", "ry_rad": "ry", "rz_rad": "rz"}


def load_spec(path: Path = SPEC_PATH) -> dict:
    """The simulator's numbers of arm, lander, mast and camera, as the TOML file has them. Raises BadInput."""
    return deepcopy(_read_spec(path, path.stat().st_mtime_ns if path.exists() else 0))


@lru_cache(maxsize=8)
def _read_spec(path: Path, _changed_ns: int) -> dict:
    """Cached: a run in process asks for it dozens of times, and it takes as long as 20 steps of flight."""
    spec = read_toml(path)
    validate(PlantFile, spec, str(path))
    return spec


class UnknownName(ValueError):
    """A joint or an error was named that the arm does not have."""


def joint_index(name: str, n: int) -> int:
    """Index from 0 of a joint named J1..Jn. Raises UnknownName."""
    if name not in (f"J{j + 1}" for j in range(n)):
        raise UnknownName(f"unknown joint '{name}'; known: J1..J{n}")
    return int(name[1:]) - 1


def per_joint(named: dict[str, float], n: int) -> np.ndarray:
    """(n,) values that are named J1..Jn, zero where none is given. Raises UnknownName."""
    out = np.zeros(n)
    for name, value in named.items():
        out[joint_index(name, n)] = value
    return out


def split_errors(errors: dict[str, float], n: int) -> tuple[np.ndarray, dict, dict]:
    """Named errors as (n, 4) DH errors [rad, rad, m, m], and keywords of frame_error for base and tool.

    Names are those of the coefficients: J<j>.phi_rad .alpha_rad .a_m .d_m, base.* and tool.* with
    tx_m ty_m tz_m rx_rad ry_rad rz_rad. Raises UnknownName.
    """
    dh = np.zeros((n, 4))
    frames: dict[str, dict[str, float]] = {"base": {}, "tool": {}}
    for name, value in errors.items():
        joint = re.fullmatch(r"J(\d+)\.(\w+)", name)
        frame, _, component = name.partition(".")
        if joint and 1 <= int(joint[1]) <= n and joint[2] in DH:
            dh[int(joint[1]) - 1, DH.index(joint[2])] = value
        elif frame in frames and component in FRAME:
            frames[frame][FRAME[component]] = value
        else:
            raise UnknownName(
                f"unknown error '{name}'; known: J1..J{n} with {', '.join(DH)}; "
                f"base and tool with {', '.join(FRAME)}"
            )
    return dh, frames["base"], frames["tool"]


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
