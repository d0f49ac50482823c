"""The simulator's numbers of the arm (models/wam.toml), and the names of its joints and errors. MuJoCo is not
loaded: what only reads a scenario starts sooner."""

from __future__ import annotations

import re
from copy import deepcopy
from functools import lru_cache
from pathlib import Path

import numpy as np

from kincal_shared.installation import root
from kincal_shared.schema.errors import read_toml, validate
from kincal_shared.schema.simulator import PlantFile

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
