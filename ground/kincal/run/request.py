"""What to run, and what the scenario expects of it."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from kincal_shared import installation
from kincal_shared.errors import BadInput
from kincal_shared.schema.scenario import read_scenario

SCENARIOS = installation.root() / "sim" / "scenarios"


@dataclass(frozen=True)
class Request:
    """A run: scenario (file, or name in sim/scenarios), mode ("fast" or "pixels"), what replaces the
    scenario's choice (None: nothing), seed of everything random, folder for results, folder of table images,
    who accepts a correction ("auto", "policy", "ground"; None: as the scenario says), and whether fast mode
    too starts processes that talk over LCM, as pixels always do."""

    scenario: str
    mode: str
    acquisition: str | None
    poses: int | None
    seed: int
    out: Path
    tables: Path
    accept: str | None = None
    processes: bool = False

    @property
    def in_process(self) -> bool:
        """Whether the run needs no other process."""
        return self.mode == "fast" and not self.processes

    def command(self) -> list[str]:
        """Command line of the simulator's launcher."""
        fixed = ["--out", str(self.out), f"--{self.mode}", "--seed", str(self.seed)]
        given = (("--acquisition", self.acquisition), ("--poses", self.poses), ("--accept", self.accept))
        chosen = [word for option, value in given if value is not None for word in (option, str(value))]
        launcher = [sys.executable, "-m", "kincal_sim.launch", self.scenario]
        return [*launcher, *fixed, "--tables", str(self.tables), *chosen]


@dataclass(frozen=True)
class Expectation:
    """What the scenario file expects: title, who accepts, verdict ("no_change", "change", "poor"; "" any) and
    largest RMS error over held-out poses (0: any)."""

    title: str
    accept: str
    verdict: str
    held_out_pos_m: float
    held_out_rot_rad: float


def read_expectation(scenario: str) -> Expectation:
    """Of a scenario file, or a name in sim/scenarios. BadInput if there is none, or it is wrong."""
    path = Path(scenario) if Path(scenario).is_file() else SCENARIOS / f"{scenario}.toml"
    if not path.is_file():
        known = ", ".join(sorted(p.stem for p in SCENARIOS.glob("*.toml")))
        where = Path(scenario) if "/" in scenario or scenario.endswith(".toml") else path  # a file was meant
        why = "this is a directory" if where.is_dir() else f"no scenario {scenario!r}"
        raise BadInput(why, str(where), f"give a file or one of: {known}")
    read = read_scenario(path)
    title = read.title or path.stem
    expect = read.expect
    return Expectation(
        title[:1].upper() + title[1:],
        read.executive.accept,
        expect.verdict,
        expect.held_out_pos_m,
        expect.held_out_rot_rad,
    )
