"""Helpers of the tests that run whole scenarios: start them, read their logs, compare them with MuJoCo."""

import os
from pathlib import Path

import lcm
import numpy as np
from flight import read_table

from kincal.flight import Terms
from kincal_sim import transforms
from kincal_sim.bus import TYPES
from kincal_sim.mechanics.arm import Arm
from kincal_sim.run import Run, execute
from kincal_sim.scenario import find

ROOT = Path(__file__).resolve().parents[2]
FAKE_FSW = Path(__file__).with_name("fake_fsw.py")


def fake_run(tmp_path, script="change", **options) -> Run:
    """A run with the fake flight participant that plays `script`."""
    store, tables = tmp_path / "store", tmp_path / "tables"
    for folder in (store, tables):
        folder.mkdir(parents=True, exist_ok=True)
    (store / "script").write_text(script)
    (tables / "none.tbl").touch()
    options = {"fast": True, **options}
    return Run(find("paper"), tmp_path / "out", store=store, tables=tables, fsw_bin=FAKE_FSW, **options)


def fly(tmp_path, scenario, **options) -> dict:
    """Run a scenario with the real flight process in the fast mode."""
    return execute(Run(find(scenario), tmp_path, fast=True, **options))


def payloads(path: Path) -> dict[str, list[bytes]]:
    """Payloads of a log by channel, in order."""
    out: dict[str, list[bytes]] = {}
    for event in lcm.EventLog(str(path), "r"):
        out.setdefault(event.channel, []).append(event.data)
    return out


def messages(path: Path, channel: str) -> list:
    """Decoded messages of one channel of a log, in order."""
    return [TYPES[channel].decode(data) for data in payloads(path).get(channel, [])]


def coefficient_names() -> list[str]:
    """Names of the coefficients of the TERMS table, in its order."""
    return list(Terms.of_table(read_table("terms")).names)


def held_out_rms(truth: dict, errors: dict[str, float]) -> tuple[float, float]:
    """RMS pose error [m], [rad] over the held-out poses of an arm that is assumed to have these DH errors, by
    MuJoCo: no flight kinematics."""
    arm = Arm(errors=errors)
    dp, dr = [], []
    for pose in truth["held_out"]:
        arm.set(pose["q_rad"])
        T = arm.T_base_tool
        dp.append(np.linalg.norm(T[:3, 3] - pose["p_m"]))
        dr.append(transforms.rotation_angle(T, transforms.rotation_matrix(pose["q_wxyz"])))
    return float(np.sqrt(np.mean(np.square(dp)))), float(np.sqrt(np.mean(np.square(dr))))


def running_with(text: str) -> list[int]:
    """Processes whose command line contains the text."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and int(entry.name) != os.getpid():
            try:
                if text.encode() in (entry / "cmdline").read_bytes():
                    found.append(int(entry.name))
            except OSError:
                continue  # it ended meanwhile
    return found
