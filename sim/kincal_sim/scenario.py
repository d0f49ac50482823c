"""Scenarios by name, checked against the simulator's arm. kincal_shared.schema.scenario reads the files."""

from __future__ import annotations

from pathlib import Path

from kincal_shared.errors import BadInput
from kincal_shared.installation import root
from kincal_shared.schema import names
from kincal_shared.schema.scenario import ArmTruth, Scenario, read_scenario

from .mechanics.spec import UnknownName, joint_index, load_spec, per_joint, split_errors

SCENARIO_DIR = root() / "sim" / "scenarios"
ACQUISITIONS = {"table": -1, **{name: number for number, name in enumerate(names.ACQUISITIONS)}}
VERDICTS = ("no_change", "change", "poor")
ACCEPT = ("ground", "auto", "policy")

__all__ = [
    "ACCEPT",
    "ACQUISITIONS",
    "SCENARIO_DIR",
    "VERDICTS",
    "ArmTruth",
    "Scenario",
    "checked",
    "find",
    "load",
]


def find(name: str | Path) -> Path:
    """A scenario by file name or by its bare name. Raises BadInput."""
    path = Path(name)
    if path.exists():
        return path
    path = SCENARIO_DIR / f"{name}.toml"
    if not path.exists():
        known = ", ".join(sorted(p.stem for p in SCENARIO_DIR.glob("*.toml")))
        raise BadInput(f"no scenario '{name}'", todo=f"known: {known}, or give a file")
    return path


def load(name: str | Path) -> Scenario:
    """Read and check a scenario. Raises BadInput, which lists all that is wrong with the file."""
    path = find(name)
    return checked(read_scenario(path), str(path))


def checked(scenario: Scenario, where: str = "") -> Scenario:
    """The same scenario, if the simulator's arm has what it names. Raises BadInput."""
    _check_names(scenario.arm, len(load_spec()["joint"]), where or scenario.name)
    return scenario


def _check_names(a: ArmTruth, n: int, where: str) -> None:
    """Joints and errors are those of the arm."""
    try:
        split_errors(a.errors, n)
        for named in (a.encoder_bias_rad, a.encoder_gain, a.compliance_rad_per_nm, a.hysteresis_rad):
            per_joint(named, n)
        for name in (name for c in a.coupling for name in (c.joint, c.tanh, c.cos)):
            joint_index(name, n)
    except UnknownName as e:
        raise BadInput(str(e), where) from e
