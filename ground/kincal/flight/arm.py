"""Arms: an arm description or an arm table as the struct that the model works on."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import ArrayLike

from kincal.rotations import Pose
from kincal_shared.errors import BadInput

from .builds import Floats, doubles, library

if TYPE_CHECKING:
    from .headers import Array, KcArm, KcJoint


_DH_NAME = re.compile(r"J(\d+)\.(phi_rad|alpha_rad|a_m|d_m)")


class JointLike(Protocol):
    """One joint and its link, standard DH, as kincal_shared.schema reads it; masses None where not known."""

    @property
    def prismatic(self) -> bool:
        """Whether the joint slides."""

    @property
    def a_m(self) -> float:
        """Link length [m]."""

    @property
    def alpha_rad(self) -> float:
        """Link twist [rad]."""

    @property
    def d_m(self) -> float:
        """Link offset [m]."""

    @property
    def phi_rad(self) -> float:
        """Joint offset [rad]."""

    @property
    def q_min(self) -> float:
        """Lower limit of the reading [rad or m]."""

    @property
    def q_max(self) -> float:
        """Upper limit of the reading [rad or m]."""

    @property
    def mass_kg(self) -> float | None:
        """Mass of the link [kg]."""

    @property
    def com_m(self) -> Sequence[float] | Floats | None:
        """(3,) centre of mass in the frame of the link [m]."""

    @property
    def gear_ratio(self) -> float | None:
        """Motor turns per joint turn."""


class ArmLike(Protocol):
    """An arm description as kincal_shared.schema reads it; base and tool frame are given beside it."""

    @property
    def name(self) -> str:
        """What people call the arm."""

    @property
    def joints(self) -> Sequence[JointLike]:
        """From the base to the tool."""

    @property
    def gravity_m_s2(self) -> Sequence[float] | Floats:
        """(3,) in the base frame [m/s^2]."""


def with_dh_errors(table: KcArm, errors: Mapping[str, float]) -> KcArm:
    """Copy of a flight arm table with DH errors added: {"J3.a_m": 0.001 ...}. Names that are no DH error are
    passed over."""
    out = library("flight").copy(table)
    _add_dh_errors(out, errors)
    return out


def _add_dh_errors(arm: KcArm, errors: Mapping[str, float]) -> None:
    for name, value in errors.items():
        if found := _DH_NAME.fullmatch(name):
            joint = arm.joint[int(found[1]) - 1]
            setattr(joint, found[2], getattr(joint, found[2]) + value)


def _set_joint(row: KcJoint, joint: JointLike) -> None:
    lib = library("ground").lib
    row.type = lib.KC_PRISMATIC if joint.prismatic else lib.KC_REVOLUTE
    row.phi_rad, row.alpha_rad, row.a_m, row.d_m = joint.phi_rad, joint.alpha_rad, joint.a_m, joint.d_m
    row.q_min, row.q_max, row.speed_max = joint.q_min, joint.q_max, 1.0
    row.gear_ratio = joint.gear_ratio or 0.0


def _set_masses(arm: KcArm, joints: Sequence[JointLike]) -> None:
    """Masses of all links, or of none: gravity torques of a part of the arm would be wrong."""
    for row, joint in zip(arm.joint[0 : len(joints)], joints, strict=True):
        if joint.mass_kg is None or joint.com_m is None:
            for each in arm.joint[0 : len(joints)]:
                each.has_mass = 0
            return
        row.has_mass, row.mass_kg = 1, joint.mass_kg
        row.com_m[0:3] = [float(x) for x in joint.com_m]


def _set_frame(xyz_m: Array[float], quat_wxyz: Array[float], pose: Pose | None) -> None:
    if pose is None:
        quat_wxyz[0] = 1.0
    else:
        xyz_m[0:3], quat_wxyz[0:4] = pose.p_m.tolist(), pose.quat_wxyz.tolist()


class Arm:
    """A serial arm with base and tool frame, nominal: up to 16 joints. Do not change `struct`."""

    def __init__(self, struct: KcArm) -> None:
        self.struct = struct
        self.n = int(struct.n_joints)

    @classmethod
    def of(cls, arm: ArmLike, base: Pose | None = None, tool: Pose | None = None) -> Arm:
        """From an arm description; frames not given are the identity. BadInput if it has too many joints."""
        ground = library("ground")
        most = ground.lib.KC_JOINT_MAX
        if len(arm.joints) > most:
            raise BadInput(f"{arm.name} has {len(arm.joints)} joints, at most {most} are possible")
        out = ground.new("kc_arm_t")
        out.name = arm.name.encode("ascii", "replace")[: ground.lib.KC_NAME_LEN - 1]
        out.n_joints = len(arm.joints)
        for row, joint in zip(out.joint[0 : len(arm.joints)], arm.joints, strict=True):
            _set_joint(row, joint)
        _set_masses(out, arm.joints)
        _set_frame(out.base_xyz_m, out.base_quat_wxyz, base)
        _set_frame(out.tool_xyz_m, out.tool_quat_wxyz, tool)
        out.gravity_m_s2[0:3] = [float(x) for x in arm.gravity_m_s2]
        return cls(out)

    @classmethod
    def of_table(cls, table: KcArm, errors: Mapping[str, float] | None = None) -> Arm:
        """From flight's arm table, by `tables.decode`; errors: DH errors to add, as for with_dh_errors."""
        ground = library("ground")
        out = ground.new("kc_arm_t")
        n = int(table.n_joints)
        ground.rows(out.joint, n)[:] = library("flight").rows(table.joint, n)
        out.name, out.n_joints = ground.text(table.name).encode(), n
        for name in ("base_xyz_m", "base_quat_wxyz", "tool_xyz_m", "tool_quat_wxyz", "gravity_m_s2"):
            setattr(out, name, list(getattr(table, name)))
        _add_dh_errors(out, errors or {})
        return cls(out)

    @property
    def kinematics_crc(self) -> int:
        """What identifies the nominal joints to flight; limits, masses, base and tool frame do not enter."""
        return int(library("ground").lib.kc_arm_kinematics_crc(self.struct))

    @property
    def q_min(self) -> Floats:
        """(n,) lower joint limits [rad or m]."""
        return np.array([self.struct.joint[j].q_min for j in range(self.n)])

    @property
    def q_max(self) -> Floats:
        """(n,) upper joint limits [rad or m]."""
        return np.array([self.struct.joint[j].q_max for j in range(self.n)])

    def frames(self, q: ArrayLike) -> Pose:
        """Nominal pose in the base frame of frame 0 (on the base), frames 1..n (at the end of each link)
        and the tool: (N, n + 2) poses for joint vectors (N, n) [rad or m], (n + 2) for one."""
        ground = library("ground")
        joints = doubles(q)
        if joints.shape[-1] != self.n:
            raise ValueError(f"{joints.shape[-1]} joint values for an arm of {self.n}")
        rows = doubles(joints.reshape(-1, self.n))
        out = np.empty((len(rows), self.n + 2, 12))
        ground.lib.kg_frames(self.struct, len(rows), ground.pointer(rows), ground.pointer(out, "kc_pose_t"))
        shape = (*joints.shape[:-1], self.n + 2)
        return Pose(out[..., :3].reshape(*shape, 3), out[..., 3:].reshape(*shape, 3, 3))

    def fk(self, q: ArrayLike) -> Pose:
        """Nominal tool pose in the base frame: (N,) poses for joint vectors (N, n), one for (n,)."""
        frames = self.frames(q)
        return Pose(frames.p_m[..., -1, :].copy(), frames.R[..., -1, :, :].copy())

    def points(self, q: ArrayLike) -> Floats:
        """Base plate (the base origin), origins of frames 0..n-1 and the tool point: (..., n + 2, 3) [m]."""
        p = self.frames(q).p_m
        return np.concatenate([np.zeros_like(p[..., :1, :]), p[..., :-2, :], p[..., -1:, :]], axis=-2)
