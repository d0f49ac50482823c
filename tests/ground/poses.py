"""Simulated measurements for workbench tests: a plain numpy chain, no flight code, effects as they are
in physics (the true joint angle differs from the reading), one camera, stated covariance."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from places import BIN
from scipy.spatial.transform import Rotation

from kincal.flight import Arm, library
from kincal.flight.bounds import Flown

# a, alpha, d, q_min, q_max, mass, centre of mass, gear ratio (METHOD.md 1)
WAM = [
    (0.0, -np.pi / 2, 0.0, -2.6, 2.6, 10.7677, (-0.00443, 0.12189, -0.00066), 42.0),
    (0.0, np.pi / 2, 0.0, -2.0, 2.0, 3.8749, (-0.00237, 0.03106, 0.01542), 28.25),
    (0.045, -np.pi / 2, 0.55, -2.8, 2.8, 1.8023, (-0.03826, 0.20751, 0.00003), 28.25),
    (-0.045, np.pi / 2, 0.0, -0.9, 3.1, 2.1727, (0.00553, 0.00007, 0.11928), 18.0),
    (0.0, -np.pi / 2, 0.30, -4.76, 1.24, 0.35656, (0.00005, 0.02886, 0.00148), 9.48),
    (0.0, np.pi / 2, 0.0, -1.6, 1.6, 0.40916, (-0.00006, -0.01686, 0.02419), 9.48),
    (0.0, 0.0, 0.06, -3.0, 3.0, 0.07548, (0.00015, 0.00007, -0.00335), 14.93),
]
BASE_Z_M, TOOL_Z_M = 0.346, 0.10
CAMERA_M = np.array([-0.35, 0.45, 1.25])
SIGMA = np.array([0.6e-3, 0.6e-3, 1.8e-3, 5e-3, 5e-3, 2e-3])


def arm_toml(path: Path, *, masses: bool = True) -> Path:
    """The WAM as a workbench arm table."""
    lines = [
        'name = "WAM"',
        'convention = "standard"',
        "gravity_m_s2 = [0.0, 0.0, -9.81]",
        f"[base]\nxyz_m = [0.0, 0.0, {BASE_Z_M}]\nquat_wxyz = [1.0, 0.0, 0.0, 0.0]",
        f"[tool]\nxyz_m = [0.0, 0.0, {TOOL_Z_M}]\nquat_wxyz = [1.0, 0.0, 0.0, 0.0]",
    ]
    for a, alpha, d, low, high, mass, com, gear in WAM:
        lines.append(
            f'[[joint]]\ntype = "revolute"\na_m = {a}\nalpha_rad = {alpha}\nd_m = {d}\nphi_rad = 0.0\n'
            f"q_min_rad = {low}\nq_max_rad = {high}\ngear_ratio = {gear}"
        )
        if masses:
            lines.append(f"mass_kg = {mass}\ncom_m = {list(com)}")
    path.write_text("\n".join(lines) + "\n")
    return path


def link(a: float, alpha: float, d: float, theta: float) -> np.ndarray:
    """Rz(theta) Tz(d) Tx(a) Rx(alpha), written out."""
    c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]])


def frames(q: np.ndarray, dh_error: np.ndarray) -> list[np.ndarray]:
    """4x4 poses of the base, behind each joint and of the tool; dh_error: (7, 4) of phi, alpha, a, d."""
    out = [np.eye(4)]
    out[0][2, 3] = BASE_Z_M
    for (a, alpha, d, *_), angle, (dphi, dalpha, da, dd) in zip(WAM, q, dh_error, strict=True):
        out.append(out[-1] @ link(a + da, alpha + dalpha, d + dd, angle + dphi))
    tool = np.eye(4)
    tool[2, 3] = TOOL_Z_M
    return [*out, out[-1] @ tool]


def tool_pose(q: np.ndarray, dh_error: np.ndarray) -> np.ndarray:
    """4x4 tool pose of the true arm."""
    return frames(q, dh_error)[-1]


def look_from(points: np.ndarray) -> np.ndarray:
    """(N, 3, 3) rotations of a camera at CAMERA_M that looks at each of the points: z forward, y down."""
    z = (points - CAMERA_M) / np.linalg.norm(points - CAMERA_M, axis=1, keepdims=True)
    x = np.cross([0.0, 0.0, -1.0], z)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=2)


def quat_wxyz(matrix: np.ndarray) -> np.ndarray:
    return Rotation.from_matrix(matrix).as_quat(scalar_first=True)


def poses_csv(path: Path, n: int, seed: int, true_q=None, *, dh_size: float = 3e-3,
              noise_size: float = 1.0, position_only: bool = False) -> Path:  # fmt: skip
    """n shuffled poses; true_q(q, direction) -> true joint angles (the hidden effect)."""
    rng = np.random.default_rng(seed)
    low, high = (np.array([row[k] for row in WAM]) for k in (3, 4))
    dh_error = rng.normal(0.0, 1.0, (7, 4)) * [dh_size, dh_size, dh_size / 3, dh_size / 3]
    upper = np.triu_indices(6)
    header = ["id", "t_s", *[f"q{j}" for j in range(1, 8)], "px", "py", "pz"]
    if not position_only:
        header += ["qw", "qx", "qy", "qz"]
    header += [f"c{i + 1}{j + 1}" for i, j in zip(*upper, strict=True)]
    header += [f"dir{j}" for j in range(1, 8)]
    header += ["temp_c", "cx", "cy", "cz", "cqw", "cqx", "cqy", "cqz"]
    q, direction, pose, aside, noise, temp_c = [], [], [], [], [], []
    for _ in range(n):
        q.append(rng.uniform(low, high))
        direction.append(rng.choice([-1.0, 1.0], 7))
        pose.append(tool_pose(q[-1] if true_q is None else true_q(q[-1], direction[-1]), dh_error))
        aside.append(rng.normal(0.0, 0.08, 3))
        noise.append(rng.normal(size=6) * SIGMA * noise_size)
        temp_c.append(rng.uniform(-5, 45))
    pose, noise = np.array(pose), np.array(noise)
    aim = look_from(pose[:, :3, 3] + aside)
    block = np.kron(np.eye(2), aim)
    cov = block @ np.diag(SIGMA**2) @ block.transpose(0, 2, 1)
    p = pose[:, :3, 3] + np.einsum("nij,nj->ni", aim, noise[:, :3])
    turn = Rotation.from_rotvec(np.einsum("nij,nj->ni", aim, noise[:, 3:])).as_matrix()
    camera, sensor = np.tile(CAMERA_M, (n, 1)), quat_wxyz(aim)
    columns = [60.0 * np.arange(n)[:, None], q, p]
    if not position_only:
        columns.append(quat_wxyz(turn @ pose[:, :3, :3]))
    columns += [cov[:, *upper], direction, np.array(temp_c)[:, None], camera, sensor]
    with path.open("w", newline="") as file:
        out = csv.writer(file)
        out.writerow(header)
        out.writerows([f"p{i}", *row] for i, row in enumerate(np.hstack(columns).tolist()))
    return path


def flown():
    """ARM and SPACE table that ship."""
    return Flown.read(BIN)


def flown_of(arm, verified):
    """As if a search space of another arm had been verified for errors of that size [rad or m]."""
    flight, ground, given = library("flight"), library("ground"), Arm.of(arm).struct
    table, space = flight.new("kc_arm_t"), flight.new("kc_space_t")
    table.n_joints = space.n_joints = arm.n
    flight.rows(table.joint, arm.n)[:] = ground.rows(given.joint, arm.n)
    table.gravity_m_s2, table.tool_xyz_m = list(given.gravity_m_s2), list(given.tool_xyz_m)
    for joint in space.verified[0 : arm.n]:
        joint.phi_rad = joint.alpha_rad = joint.a_m = joint.d_m = verified
    return Flown(table, space)
