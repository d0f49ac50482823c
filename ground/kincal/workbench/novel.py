"""The map of the unknown: where an error enters x what it depends on, scored like named effects.

A cell is a Gaussian process embedded in the chain: at its locus (a joint axis, the base, the camera,
the tool ...) an error that is a smooth unknown function of its driver (a joint angle, a torque, time
...), or of two drivers at once. The leading eigenvectors of the driver's kernel are its columns
(docs/DIAGNOSIS.md), so the evidence of a cell and that of a named effect are on one scale.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from .arms import quat_to_matrix
from .basis import Basis
from .columns import Columns
from .effects import FRAME_CAMERA, FRAME_MEAS, FRAME_TOOL

_SINGLE = 5  # eigenvectors of one driver
_DOUBLE = 12  # of two drivers together
_JOINT_SIGMA = 1.5e-3  # [rad], typical size of an unknown joint error
_SHIFT_SIGMA = 1.5e-3  # [m]
_MAX_INCIDENCE_MISFIT = 0.15  # of the cosine: the tag sits beside the tool point
_MIN_IMAGE_SPREAD = 0.01  # of normalised image position: about 14 px


@dataclass(frozen=True)
class Locus:
    """Where an error enters: twist rows (N, m, c), already scaled to its typical size."""

    name: str
    rows: np.ndarray


@dataclass(frozen=True)
class Driver:
    """What an error depends on: scaled features (N, k) of a centred kernel with unit mean variance."""

    name: str
    features: np.ndarray


@dataclass(frozen=True)
class Cell:
    locus: str
    drivers: tuple[str, ...]
    columns: np.ndarray

    @property
    def name(self) -> str:
        return f"{self.locus} | {' x '.join(self.drivers)}"


def loci(columns: Columns) -> list[Locus]:
    """Joint axes, off-axis joint motions, base, tool, and the camera side when the data have it."""
    fit = columns.fit
    arm = fit.chain.arm
    out = []
    for j, joint in enumerate(arm.joints, 1):
        comp = 2 if joint.prismatic else 5
        size = _SHIFT_SIGMA if joint.prismatic else _JOINT_SIGMA
        out.append(Locus(f"joint {j}", size * columns.locus(j - 1, (comp,))))
    turns = [("base rotation", 0, (3, 4, 5)), ("tool rotation", FRAME_TOOL, (3, 4, 5))]
    shifts = [("base translation", 0, (0, 1, 2)), ("tool translation", FRAME_TOOL, (0, 1, 2))]
    if fit.chain.data.has("cam"):
        turns += [("camera rotation", FRAME_CAMERA, (3, 4, 5)), ("tag rotation", FRAME_MEAS, (3, 4, 5))]
        shifts += [("camera translation", FRAME_CAMERA, (0, 1, 2))]
        seen = np.stack([columns.basis(Basis("lin", v, 0)) for v in ("xcam", "ycam", "zcam")], axis=1)
        ray = seen / np.maximum(np.linalg.norm(seen, axis=1, keepdims=True), 1e-9)
        rows = columns.locus(FRAME_CAMERA, (0, 1, 2))
        out.append(Locus("range", _SHIFT_SIGMA * np.einsum("nm,nmc->nc", ray, rows)[:, None, :]))
    if (tilt := _tag_tilt(columns)) is not None:
        out.append(Locus("tag tilt", _JOINT_SIGMA * tilt))
    turns += [(f"link {j} tilt", j, (3, 4)) for j in range(1, arm.n)]
    out += [Locus(name, _JOINT_SIGMA * columns.locus(frame, comps)) for name, frame, comps in turns]
    out += [Locus(name, _SHIFT_SIGMA * columns.locus(frame, comps)) for name, frame, comps in shifts]
    return [locus for locus in out if np.abs(locus.rows).max() > 0]


def _tag_tilt(columns: Columns) -> np.ndarray | None:
    """Rows of a turn of the seen tag toward the camera: what a bias of the slant does. The tags' normals
    are not in the arm table; the recorded incidence angles tell them, tag by tag."""
    data = columns.fit.chain.data
    if data.incid_rad is None or data.quat_wxyz is None or not data.has("cam"):
        return None
    ray = data.p_m - data.cam_p_m
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    rotation = np.array([quat_to_matrix(q) for q in data.quat_wxyz])
    ray_tool = np.einsum("nji,nj->ni", rotation, ray)
    tag = data.tag if data.tag is not None else np.zeros(data.n)
    normal = np.zeros((data.n, 3))
    for which in np.unique(tag):
        mine = tag == which
        if mine.sum() < 6:
            continue
        found, *_ = np.linalg.lstsq(ray_tool[mine], np.cos(data.incid_rad[mine]), rcond=None)
        if np.abs(ray_tool[mine] @ found - np.cos(data.incid_rad[mine])).max() < _MAX_INCIDENCE_MISFIT:
            normal[mine] = found / np.linalg.norm(found)
    axis = np.cross(normal, ray_tool)
    return np.einsum("nm,nmc->nc", axis, columns.locus(FRAME_MEAS, (3, 4, 5)))[:, None, :]


def _features(kernel: np.ndarray, keep: int) -> np.ndarray:
    n = len(kernel)
    centre = np.eye(n) - 1.0 / n
    centred = centre @ kernel @ centre
    values, vectors = np.linalg.eigh(centred)
    values, vectors = values[::-1][:keep], vectors[:, ::-1][:, :keep]
    values = np.maximum(values, 0.0)
    good = values > 1e-6 * max(values.max(initial=0.0), 1e-12)
    if not good.any():
        return np.zeros((n, 0))
    features = vectors[:, good] * np.sqrt(values[good])
    return features / np.sqrt((features**2).sum(axis=1).mean())


def _rbf(x: np.ndarray, length: float = 1.0) -> np.ndarray:
    spread = x.std()
    z = (x - x.mean()) / (spread if spread > 0 else 1.0)
    return np.exp(-0.5 * ((z[:, None] - z[None, :]) / length) ** 2)


def drivers(columns: Columns) -> list[Driver]:
    """Everything the data record that an error could follow."""
    fit = columns.fit
    arm, data = fit.chain.arm, fit.chain.data
    out = []

    def add(name: str, kernel: np.ndarray) -> None:
        features = _features(kernel, _SINGLE)
        if features.shape[1]:
            out.append(Driver(name, features))

    for j, joint in enumerate(arm.joints, 1):
        q = data.q[:, j - 1]
        if joint.prismatic:
            add(f"q{j}", _rbf(q))
        else:
            add(f"q{j}", np.exp(-2.0 * np.sin(0.5 * (q[:, None] - q[None, :])) ** 2))
    if arm.has_masses:
        for j in range(1, arm.n + 1):
            tau = columns.basis(Basis("lin", "tau", j))
            if tau.std() > 1e-3 * max(np.abs(tau).max(), 1e-12) and tau.std() > 1e-6:
                add(f"tau{j}", _rbf(tau, 1.5))
    for label, values in (("dir", data.direction), ("qdot", data.qdot)):
        if values is not None:
            for j in range(arm.n):
                x = values[:, j]
                if x.std() > 0:
                    add(f"{label}{j + 1}", np.outer(x, x))
    scalars = [
        ("t", None if data.order_is_time else data.t_s, 0.5),
        ("temp", data.temp_c, 1.0),
        ("payload", data.payload_kg, 1.0),
        ("tag", data.tag, 1.0),
    ]
    if data.has("cam"):
        scalars += [(name, x, 1.0) for name, x in _image_drivers(columns).items()]
    else:
        expected = data.p_m - fit.evaluation.r[:, :3]
        scalars += [(name, expected[:, k], 1.0) for k, name in enumerate(("sx", "sy", "sz"))]
    scalars += [("incid", data.incid_rad, 1.0), ("pan", data.pan_rad, 1.0), ("tilt", data.tilt_rad, 1.0)]
    for name, x, length in scalars:
        if x is not None and np.std(x) > 1e-9:
            add(name, _rbf(np.asarray(x, dtype=float), length))
    if data.order_is_time:
        add("order", _rbf(data.t_s, 0.5))
    return out


def _image_drivers(columns: Columns) -> dict[str, np.ndarray]:
    """Depth and image position of the tool where the MODEL expects it: measured ones carry the very
    noise of the residual and would seem to explain it."""
    fit = columns.fit
    data = fit.chain.data
    expected = data.p_m - fit.evaluation.r[:, :3]
    rotation = np.array([quat_to_matrix(q) for q in data.cam_quat_wxyz])
    x, y, z = np.einsum("nji,nj->in", rotation, expected - data.cam_p_m)
    z = np.maximum(z, 1e-6)
    u, v = x / z, y / z
    out = {"zcam": z}
    # a head that always aims at the tag leaves no image position to depend on
    if max(u.std(), v.std()) > _MIN_IMAGE_SPREAD:
        out |= {"u": u, "v": v, "r2": u**2 + v**2}
    return out


def pairs(singles: list[Driver]) -> list[Driver]:
    """Two drivers at once: joint angle x joint angle, and joint angle x everything slow.

    Features: the kernel (1 + k_a)(1 + k_b) - 1, compressed by SVD.
    """
    by_name = {driver.name: driver for driver in singles}
    angles = [name for name in by_name if name[0] == "q" and name[1:].isdigit()]
    slow = [name for name in ("temp", "t", "payload", "pan", "tilt") if name in by_name]
    wanted = list(itertools.combinations(angles, 2)) + [(a, b) for a in angles for b in slow]
    out = []
    for a, b in wanted:
        fa, fb = by_name[a].features, by_name[b].features
        both = np.einsum("ni,nj->nij", fa, fb).reshape(len(fa), -1)
        features = np.hstack([fa, fb, both - both.mean(axis=0)])
        u, s, _ = np.linalg.svd(features, full_matrices=False)
        kept = u[:, :_DOUBLE] * s[:_DOUBLE]
        out.append(Driver(f"{a} x {b}", kept / np.sqrt((kept**2).sum(axis=1).mean())))
    return out


def cells(columns: Columns, *, double: bool = True) -> list[Cell]:
    """All cells. Double-driver cells are only made at joints (elsewhere they cannot be told apart)."""
    single = drivers(columns)
    out = []
    places = loci(columns)
    for locus in places:
        for driver in single:
            out.append(_cell(locus, driver))
    if double:
        for driver in pairs(single):
            for locus in places:
                if locus.name.startswith("joint"):
                    out.append(_cell(locus, driver))
    return out


def _cell(locus: Locus, driver: Driver) -> Cell:
    n, m, c = locus.rows.shape
    k = driver.features.shape[1]
    columns = np.einsum("nmc,nk->ncmk", locus.rows, driver.features).reshape(n * c, m * k)
    return Cell(locus.name, tuple(driver.name.split(" x ")), columns)
