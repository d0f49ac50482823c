"""Arm tables in TOML (docs/WORKBENCH.md) into a standard-DH arm, modified DH converted exactly."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path

import numpy as np

from kincal.errors import BadInput

MAX_JOINTS = 8


@dataclass(frozen=True)
class Joint:
    """One joint and its link, standard DH; com_m in the standard link frame."""

    prismatic: bool
    a_m: float
    alpha_rad: float
    d_m: float
    phi_rad: float
    q_min: float
    q_max: float
    mass_kg: float | None = None
    com_m: tuple[float, float, float] | None = None
    gear_ratio: float | None = None


@dataclass(frozen=True)
class Frame:
    """A fixed frame; `estimate`: unknown, to be found by the fit without a first guess."""

    xyz_m: np.ndarray
    quat_wxyz: np.ndarray
    estimate: bool


@dataclass(frozen=True)
class Camera:
    """Intrinsics, only needed for effects that look at the image position."""

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float


@dataclass(frozen=True)
class ArmTable:
    name: str
    joints: tuple[Joint, ...]
    base: Frame
    tool: Frame
    gravity_m_s2: np.ndarray
    camera: Camera | None = None
    source: str = ""
    extra: dict = field(default_factory=dict)

    @property
    def n(self) -> int:
        return len(self.joints)

    @property
    def has_masses(self) -> bool:
        return all(joint.mass_kg is not None and joint.com_m is not None for joint in self.joints)

    @property
    def has_gears(self) -> bool:
        return all(joint.gear_ratio for joint in self.joints)


def _shipped():
    """Arm tables that come with the package."""
    folder = resources.files("kincal") / "arms"
    return [file for file in folder.iterdir() if file.name.endswith(".toml")]


def read_arm(path: str | Path) -> ArmTable:
    """Read an arm table by path, or one that is shipped by its name ("wam").

    BadInput names the file, the key and what is wrong with it.
    """
    path = Path(path)
    shipped = {arm.name.removesuffix(".toml"): arm for arm in _shipped()}
    source = shipped[str(path)] if str(path) in shipped and not path.exists() else path
    try:
        table = tomllib.loads(source.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise BadInput(f"{path}: no such file, nor an arm that is shipped ({', '.join(shipped)})") from None
    except IsADirectoryError:
        raise BadInput(f"{path}: is a directory; an arm table (TOML) is needed") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise BadInput(f"{path}: not valid TOML: {error}") from None
    convention = table.get("convention", "standard")
    if convention not in ("standard", "modified"):
        raise BadInput(f'{path}: convention is {convention!r}, "standard" or "modified" is needed')
    rows = table.get("joint", [])
    if not 1 <= len(rows) <= MAX_JOINTS:
        raise BadInput(f"{path}: has {len(rows)} [[joint]] tables, 1 to {MAX_JOINTS} are needed")
    joints = [_joint(path, number, row) for number, row in enumerate(rows, 1)]
    base, tool = (_frame(path, table, key) for key in ("base", "tool"))
    if convention == "modified":
        joints, base = _from_modified(joints, base)
    gravity = _vector(path, table, "gravity_m_s2", 3, [0.0, 0.0, -9.81])
    camera = None
    if "camera" in table:
        try:
            camera = Camera(**{k: float(table["camera"][k]) for k in ("fx_px", "fy_px", "cx_px", "cy_px")})
        except (KeyError, TypeError, ValueError) as error:
            raise BadInput(f"{path}: [camera] needs fx_px, fy_px, cx_px, cy_px: {error}") from None
    return ArmTable(
        name=str(table.get("name", path.stem)),
        joints=tuple(joints),
        base=base,
        tool=tool,
        gravity_m_s2=gravity,
        camera=camera,
        source=str(path),
    )


def _vector(path: Path, table: dict, key: str, length: int, default) -> np.ndarray:
    value = table.get(key, default)
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        array = np.array([])
    if array.shape != (length,) or not np.all(np.isfinite(array)):
        raise BadInput(f"{path}: {key} is {value!r}, {length} finite numbers are needed")
    return array


def _scalar(path: Path, where: str, row: dict, key: str, default: float | None = None) -> float:
    value = row.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise BadInput(f"{path}: {where}: {key} is {value!r}, a finite number is needed")
    return float(value)


def _joint(path: Path, number: int, row: dict) -> Joint:
    where = f"joint {number}"
    kind = row.get("type", "revolute")
    if kind not in ("revolute", "prismatic"):
        raise BadInput(f'{path}: {where}: type is {kind!r}, "revolute" or "prismatic" is needed')
    unit = "m" if kind == "prismatic" else "rad"
    low_key = "q_min_m" if "q_min_m" in row and unit == "m" else "q_min_rad"
    high_key = "q_max_m" if "q_max_m" in row and unit == "m" else "q_max_rad"
    q_min, q_max = _scalar(path, where, row, low_key), _scalar(path, where, row, high_key)
    if not q_min < q_max:
        raise BadInput(f"{path}: {where}: {low_key} {q_min:g} is not below {high_key} {q_max:g}")
    mass = _scalar(path, where, row, "mass_kg") if "mass_kg" in row else None
    com = tuple(_vector(path, row, "com_m", 3, None)) if "com_m" in row else None
    gear = _scalar(path, where, row, "gear_ratio") if "gear_ratio" in row else None
    return Joint(
        prismatic=kind == "prismatic",
        **{key: _scalar(path, where, row, key, 0.0) for key in ("a_m", "alpha_rad", "d_m", "phi_rad")},
        q_min=q_min,
        q_max=q_max,
        mass_kg=mass,
        com_m=com,
        gear_ratio=gear,
    )


def _frame(path: Path, table: dict, key: str) -> Frame:
    row = table.get(key, {})
    xyz = _vector(path, row, "xyz_m", 3, [0.0, 0.0, 0.0])
    quat = _vector(path, row, "quat_wxyz", 4, [1.0, 0.0, 0.0, 0.0])
    norm = float(np.linalg.norm(quat))
    if abs(norm - 1.0) > 1e-3:
        raise BadInput(f"{path}: [{key}] quat_wxyz has norm {norm:.6g}, 1 is needed")
    estimate = row.get("estimate", False)
    if not isinstance(estimate, bool):
        raise BadInput(f"{path}: [{key}] estimate is {estimate!r}, true or false is needed")
    return Frame(xyz, quat / norm, estimate)


def _rx(angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def quat_to_matrix(quat_wxyz: np.ndarray) -> np.ndarray:
    w, x, y, z = quat_wxyz
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _from_modified(joints: list[Joint], base: Frame) -> tuple[list[Joint], Frame]:
    """Modified (proximal) DH is the standard chain with a and alpha shifted by one link.

    prod Rx(al_{i-1}) Tx(a_{i-1}) Rz(th_i) Tz(d_i) = [Rx(al_0) Tx(a_0)] prod Rz(th_i) Tz(d_i) Tx(a_i) Rx(al_i)
    with a_n = alpha_n = 0: the first pair moves into the base frame. A centre of mass moves from
    the modified to the standard frame of its link by the same Tx Rx.
    """
    first = joints[0]
    rotation = quat_to_matrix(base.quat_wxyz)
    xyz = base.xyz_m + rotation @ np.array([first.a_m, 0.0, 0.0])
    half = 0.5 * first.alpha_rad
    w, x, y, z = base.quat_wxyz
    c, s = math.cos(half), math.sin(half)
    quat = np.array([w * c - x * s, x * c + w * s, y * c + z * s, z * c - y * s])
    shifted = []
    for i, joint in enumerate(joints):
        a_m, alpha_rad = (joints[i + 1].a_m, joints[i + 1].alpha_rad) if i + 1 < len(joints) else (0.0, 0.0)
        com = joint.com_m
        if com is not None:
            com = tuple(_rx(alpha_rad).T @ (np.array(com) - np.array([a_m, 0.0, 0.0])))
        shifted.append(
            Joint(
                joint.prismatic,
                a_m,
                alpha_rad,
                joint.d_m,
                joint.phi_rad,
                joint.q_min,
                joint.q_max,
                joint.mass_kg,
                com,
                joint.gear_ratio,
            )
        )
    return shifted, Frame(xyz, quat, base.estimate)
