"""Files of a case in the workbench's formats (docs/WORKBENCH.md): arm.toml, poses.csv, queries.csv."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from ..mechanics.mjcf import GRAVITY_EARTH
from ..mechanics.plant import Conditions
from ..transforms import quaternion
from ..vision import tags
from . import kinds, optics
from .bench import NOISE, Observation


def _numbered(stem: str, n: int = 7) -> list[str]:
    return [f"{stem}{j}" for j in range(1, n + 1)]


_STATE = ["t_s", *_numbered("q"), *_numbered("dir"), *_numbered("qdot"), "temp_c", "payload_kg"]
_POSE = ["px", "py", "pz", "qw", "qx", "qy", "qz"]
_COV = [f"c{i}{j}" for i in range(1, 7) for j in range(i, 7)]
_CAMERA = ["cx", "cy", "cz", "cqw", "cqx", "cqy", "cqz", "pan_rad", "tilt_rad", "tag"]
COLUMNS = ["id", *_STATE, *_POSE, *_COV, "range_m", "incid_rad", "u_px", "v_px", *_CAMERA, "replicate"]
TARGETS = ("points_m", "second_points_m")  # by tag
QUERY_COLUMNS = ["id", *_STATE, "px", "py", "pz"]


def write_csv(path: Path, columns: list[str], rows: list[list]) -> None:
    """A row begins with its name; all the rest are numbers."""
    with path.open("w", newline="", encoding="utf-8") as f:
        out = csv.writer(f, lineterminator="\n")
        out.writerow(columns)
        out.writerows([[row[0], *(f"{value:.10g}" for value in row[1:])] for row in rows])


def state_values(at: Conditions) -> list[float]:
    """Values of the columns t_s .. payload_kg."""
    return [at.t_s, *at.q_rad, *_each(at.direction), *_each(at.dq_rad_s), at.temp_c, at.payload_kg]


def _each(values: np.ndarray | float) -> list[float]:
    return list(np.atleast_1d(values))


def pose_values(T: np.ndarray) -> list[float]:
    """Position and quaternion of a 4x4 pose."""
    return [*T[:3, 3], *quaternion(T)]


def observation_values(seen: Observation, T: np.ndarray, table: optics.Optics, arm_spec: dict) -> list[float]:
    """Values of the columns t_s .. tag. T: noisy tool pose (4x4); range, incidence and image position are
    those of the noisy pose, which is all that a detector knows."""
    C, at = seen.T_base_cam, seen.at
    T_cam_tool = np.linalg.inv(C) @ T
    rotate = np.kron(np.eye(2), C[:3, :3])
    cov = rotate @ np.diag(NOISE**2) @ rotate.T
    u, v, w = table.K @ T_cam_tool[:3, 3]
    incidence = optics.incidence_rad(T_cam_tool @ optics.nominal_tag_pose(arm_spec, at.tag))
    return [
        *state_values(at), *pose_values(T), *cov[np.triu_indices(6)],
        float(np.linalg.norm(T_cam_tool[:3, 3])), incidence, u / w, v / w,
        *pose_values(C), at.pan_rad, at.tilt_rad, at.tag,
    ]  # fmt: skip


def arm_toml(spec: dict) -> str:
    """The arm as the table has it, in the workbench's format."""
    lines = [
        f'name = "{spec["name"]}"',
        'convention = "standard"',
        f"gravity_m_s2 = {list(GRAVITY_EARTH)}",
    ]
    for frame in ("base", "tool"):
        lines += _frame_lines(frame, spec[frame])
    cam = spec["camera"]
    lines += ["[sensor]", *(f"{key} = {cam[key]}" for key in ("fx_px", "fy_px", "cx_px", "cy_px"))]
    lines += ["[target]", *(f"{key} = {_corners(spec, tag)}" for tag, key in enumerate(TARGETS))]
    for joint, gear_ratio in zip(spec["joint"], kinds.GEAR_RATIO, strict=True):
        lines += _joint_lines(joint, gear_ratio)
    return "\n".join(lines) + "\n"


def _corners(spec: dict, tag: int) -> list[list[float]]:
    """Of a tag, in the tool's frame; rows of three, as TOML has them."""
    T_tool_tag = optics.nominal_tag_pose(spec, tag)
    corners_m = tags.corners_m(spec["tag"][tag]["size_m"])
    return (corners_m @ T_tool_tag[:3, :3].T + T_tool_tag[:3, 3]).round(9).tolist()


def _frame_lines(name: str, frame: dict) -> list[str]:
    return [
        f"[{name}]",
        f"xyz_m = {frame['xyz_m']}",
        "quat_wxyz = [1.0, 0.0, 0.0, 0.0]",
        "estimate = false",
    ]


def _joint_lines(joint: dict, gear_ratio: float) -> list[str]:
    keys = ("a_m", "alpha_rad", "d_m", "phi_rad", "mass_kg", "com_m")
    return [
        "[[joint]]",
        'type = "revolute"',
        *(f"{key} = {joint.get(key, 0.0)}" for key in keys),
        f"q_min_rad = {joint['q_rad'][0]}",
        f"q_max_rad = {joint['q_rad'][1]}",
        f"gear_ratio = {gear_ratio}",
    ]
