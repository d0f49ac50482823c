"""How many poses, seconds and joules does a calibration take, by each way of choosing its poses?

    python tests/bench/study.py [--designs ucb dopt ...] [--scenarios paper ...] [--seeds 40] [--first 1]
                                [--jobs 2] [--set FIELD=VALUE ...] [--out FILE]

A design is an acquisition with settings of CONFIG (DESIGNS, below). Each is flown in each scenario with each
seed by kincal.run.inprocess.simulate, from START to the proposal: flight core, the shipped tables, the
simulator in fast mode. One line per run goes to FILE at once; a second start continues it. --set changes
fields of CONFIG in all designs (est.rank_tol=1e-5 for a nested one).

Scenarios
- paper: the errors of the paper's simulation
- uniform: all 28 DH errors drawn evenly between the error bounds of the space
- two_biases: encoders of two joints read 0.02 to 0.09 rad wrong
- slipped: the encoder of one joint does
- uplinked: the elbow yields under gravity; the TERMS table has the effect

Recorded after each pose: visits (every pose that the arm set out for counts: local initial poses, and
those that were given up), observations used, mission seconds since START, joules (the powers of CONFIG;
moving while arm or pan-tilt unit says so), and of the estimate at that time the error at HELD_OUT postures
that were not measured, anywhere in the search region (RMS, position and rotation). off_mm, off_mrad: the
measured pose against the kinematics before it was used, the distances in the paper's f (eq. 6); f: as flight
states it. The last entry of a run is its proposal. After an abort there is no correction, and the last entry
is the error of the arm as it was. Truth and judgement are MuJoCo's; they share no code with flight.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
for _folder in ("ground", "sim", "build/py", "tests/bench"):
    sys.path.insert(0, str(ROOT / _folder))

import missions  # noqa: E402
import montecarlo  # noqa: E402
import resumable  # noqa: E402

from kincal.flight import event_name  # noqa: E402
from kincal.flight import tables as codec  # noqa: E402
from kincal.run.inprocess import TABLES, Setup, Tick, simulate  # noqa: E402
from kincal_sim.mechanics.arm import Arm, split_errors  # noqa: E402
from kincal_sim.randomness import generator  # noqa: E402
from kincal_sim.scenario import ArmTruth, Scenario, load  # noqa: E402
from kincal_sim.transforms import quaternion, rot, rotation_angle, rotation_matrix  # noqa: E402
from kincal_sim.truth import build_plant, held_out_poses  # noqa: E402


@dataclass(frozen=True)
class Design:
    """How poses are chosen. what: in words, for tables; acquisition: its name in CONFIG; settings: fields of
    CONFIG that differ from the shipped table."""

    what: str
    acquisition: str
    settings: dict[str, float] = field(default_factory=dict)


DESIGNS = {
    "ucb": Design("GP-UCB on f, as in the paper", "ucb"),
    "random": Design("by chance, the paper's baseline", "random"),
    "dopt": Design("most information, D-optimal", "dopt"),
    "vopt": Design("least predicted variance, V-optimal", "vopt"),
    "rate": Design("most information for its cost", "rate"),
    "dopt_info": Design("D-optimal, initial poses too", "dopt", {"initial_design": 1}),
    "rate_info": Design("most information for its cost, initial poses too", "rate", {"initial_design": 1}),
}
SCENARIOS = {
    "paper": "the paper's errors",
    "uniform": "uniform errors inside the bounds",
    "two_biases": "two encoder biases",
    "slipped": "one slipped joint",
    "uplinked": "an uplinked effect",
}
HELD_OUT = 200
LIMIT_MM, LIMIT_MRAD = 1.0, 5.0
Line = dict[str, Any]
Job = tuple[str, str, str, int]  # design, its settings in words, scenario, seed


# ---- what is wrong with the arm --------------------------------------------------------------------------


def scenario_of(name: str, seed: int) -> Scenario:
    """One of SCENARIOS, with errors that the seed draws."""
    if name in missions.SCENARIOS:
        return missions.scenario_of(name, seed)
    rng = generator(seed, f"errors of {name}")
    arm = _uniform(rng) if name == "uniform" else _two_biases(rng)
    return load("healthy").model_copy(deep=True, update={"name": name, "arm": arm})


def _uniform(rng: np.random.Generator) -> ArmTruth:
    """An arm that stands free at the park pose: whoever parked it there saw to that."""
    for _ in range(1000):
        arm = montecarlo.inside(rng, "box")
        if montecarlo.stands_free(montecarlo.CheckedWorld(Scenario(name="drawn", arm=arm), 1)):
            return arm
    raise ArithmeticError("no arm that stands free")


def _two_biases(rng: np.random.Generator) -> ArmTruth:
    joints = rng.choice(np.arange(1, 8), 2, replace=False)
    return ArmTruth(
        encoder_bias_rad={f"J{j}": float(rng.choice([-1.0, 1.0]) * rng.uniform(0.02, 0.09)) for j in joints}
    )


# ---- tables ----------------------------------------------------------------------------------------------


def settings_text(settings: dict[str, float]) -> str:
    """Settings of CONFIG as one word, the same for the same settings."""
    return " ".join(f"{name}={value:.12g}" for name, value in sorted(settings.items()))


def read_settings(text: str) -> dict[str, float]:
    """The settings of such a word. ValueError if one is not FIELD=VALUE."""
    pairs = [part.partition("=") for part in text.split()]
    if bad := [name for name, sign, _ in pairs if not sign]:
        raise ValueError(f"{bad[0]!r} is no FIELD=VALUE")
    return {name: float(value) for name, _, value in pairs}


@cache
def tables_of(scenario: str, settings: str) -> Path:
    """Folder with the tables of a scenario, and with settings of CONFIG. ValueError for a field that CONFIG
    does not have."""
    base = missions.tables_of("uplinked" if scenario == "uplinked" else "paper")
    if not settings:
        return base
    folder = base.with_name(f"{base.name}-{settings.replace(' ', '_')}")
    shutil.copytree(base, folder, dirs_exist_ok=True)
    _, config = codec.decode_as("config", (base / "config.tbl").read_bytes())
    for name, value in read_settings(settings).items():
        set_field(config, name, value)
    (folder / "config.tbl").write_bytes(codec.encode("config", config).data)
    return folder


def set_field(struct: Any, name: str, value: float) -> None:
    """A number into a field by its dotted name. ValueError if there is none."""
    *path, last = name.split(".")
    try:
        for part in path:
            struct = getattr(struct, part)
        old = getattr(struct, last)
    except AttributeError as e:
        raise ValueError(f"CONFIG has no field {name!r}; docs/TABLES.md lists them") from e
    setattr(struct, last, int(value) if isinstance(old, int) else value)


@cache
def powers_w() -> tuple[float, float]:
    """Electric power at rest and while something moves, of the CONFIG table [W]."""
    _, config = codec.decode_as("config", (TABLES / "config.tbl").read_bytes())
    return float(config.power_idle_w), float(config.power_move_w)


# ---- what a run shows ------------------------------------------------------------------------------------


class Believed:
    """The arm that a correction describes, in MuJoCo. Errors move the bodies of one compiled model, since a
    run asks for dozens of corrections."""

    SAG_TOL_RAD, SAG_ITER_MAX = 1e-12, 60

    def __init__(self, scenario: Scenario, correction: Mapping[str, float] | None = None) -> None:
        self.arm = Arm(None, {}, scenario.env.gravity_m_s2, scenario.env.payload_kg)
        self.compliance = np.zeros(self.arm.n)
        self.correct(correction or {})

    def correct(self, correction: Mapping[str, float]) -> None:
        """Have these errors, by coefficient name, and no others."""
        arm, model = self.arm, self.arm.model
        dh, *_ = split_errors({k: v for k, v in correction.items() if k.startswith("J")}, arm.n)
        for j, (joint, error) in enumerate(zip(arm.spec["joint"], dh, strict=True), 1):
            nominal = (joint.get("phi_rad", 0.0), joint["alpha_rad"], joint["a_m"], joint["d_m"])
            phi, alpha, a, d = error + nominal
            frame = model.body(f"frame{j}").id
            model.body_quat[model.body(f"link{j}").id] = quaternion(rot("z", phi))
            model.body_pos[frame], model.body_quat[frame] = (a, 0.0, d), quaternion(rot("x", alpha))
        self.compliance[3] = correction.get(missions.EFFECT, 0.0)

    def pose(self, q_rad: np.ndarray) -> np.ndarray:
        """Tool pose (4x4) at these encoder readings; joints that yield are at rest under gravity."""
        q = q_rad
        self.arm.set(q)
        for _ in range(self.SAG_ITER_MAX if self.compliance.any() else 0):
            before, q = q, q_rad + self.compliance * self.arm.gravity_torque()
            self.arm.set(q)
            if np.abs(q - before).max() < self.SAG_TOL_RAD:
                break
        return self.arm.T_base_tool


class Judge:
    """The true arm of a scenario at postures that are not measured, and how far another arm is from it."""

    def __init__(self, scenario: Scenario, seed: int) -> None:
        # they are reached from random sides, which matters to an arm with hysteresis only
        assert not scenario.arm.hysteresis_rad
        held = held_out_poses(scenario, build_plant(scenario), seed, HELD_OUT)
        self.q_rad = np.array([h["q_rad"] for h in held])
        self.p_m = np.array([h["p_m"] for h in held])
        self.R = np.array([rotation_matrix(h["q_wxyz"]) for h in held])

    def held_out(self, believed: Believed) -> tuple[float, float]:
        """RMS error of an arm over the held-out postures, position [mm] and rotation [mrad]."""
        T = np.array([believed.pose(q) for q in self.q_rad])
        off_m = T[:, :3, 3] - self.p_m
        # Frobenius norm of R - R' = 2 sqrt 2 sin(angle / 2)
        size = np.linalg.norm(T[:, :3, :3] - self.R, axis=(1, 2)) / np.sqrt(8.0)
        off_rad = 2.0 * np.arcsin(np.clip(size, 0.0, 1.0))
        return 1e3 * float(np.sqrt(np.mean(np.sum(off_m**2, 1)))), 1e3 * float(np.sqrt(np.mean(off_rad**2)))


@dataclass
class Account:
    """What a run has cost so far, since START."""

    seconds: float = 0.0
    joules: float = 0.0
    given_up: int = 0  # poses
    observations: int = 0


class Witness:
    """Takes in a run tick by tick. entries: one for each pose, then one for the end; end: how it ended, ""
    while it goes on."""

    def __init__(self, scenario: Scenario, seed: int) -> None:
        self.judge, self.names = Judge(scenario, seed), missions.names(scenario.name)
        self.now = Account()
        self.start_us: int | None = None
        self.measured: dict[int, Any] = {}  # last observation by pose
        self.entries: list[Line] = []
        self.end, self.poses = "", 0
        self._believed = Believed(scenario)
        self.before = self.judge.held_out(self._believed)
        self._last_us = 0

    def see(self, tick: Tick) -> bool:
        """Take in one tick; False at the end."""
        self._spend(tick)
        for channel, m in tick.from_flight:
            if channel == "KC_EVENT":
                self._hear(event_name(m.id), tick.now_us)
            elif channel == "KC_MEAS":
                self.now.observations += 1
                self.measured[m.pose] = m
            elif channel == "KC_PROGRESS":
                self._progress(m)
            elif channel == "KC_PROPOSAL":
                self._believe(m.value)
                self._finish(("no change", "change", "poor")[m.verdict], None)
        return not self.end

    def _spend(self, tick: Tick) -> None:
        if self.start_us is None:
            return
        moving = any(
            m.moving for channel, m in tick.to_flight if channel in ("KC_ARM_STATE", "KC_PANTILT_STATE")
        )
        self.now.joules += powers_w()[moving] * (tick.now_us - self._last_us) * 1e-6
        self.now.seconds = (tick.now_us - self.start_us) * 1e-6
        self._last_us = tick.now_us

    def _hear(self, event: str, now_us: int) -> None:
        if event == "CAL_START":
            self.start_us = self._last_us = now_us
        elif event == "CAL_CAND_SKIPPED":
            self.now.given_up += 1
        elif event == "CAL_ABORTED":
            self._finish("aborted", self.before)

    def _believe(self, values: Any) -> None:
        self._believed.correct(dict(zip(self.names, values, strict=False)))

    def _progress(self, m: Any) -> None:
        off = self._off(self.measured[m.pose])
        self._believe(m.coef)
        self.poses += 1
        self._enter(self.judge.held_out(self._believed), {"off_mm": off[0], "off_mrad": off[1], "f": m.f})

    def _off(self, meas: Any) -> tuple[float, float]:
        """Distance of a measured pose from the one believed, position [mm] and rotation [mrad]."""
        T = self._believed.pose(np.array(meas.q_rad[: meas.n_joints]))
        off_m = np.linalg.norm(T[:3, 3] - np.array(meas.p_m))
        return 1e3 * float(off_m), 1e3 * rotation_angle(T, rotation_matrix(meas.q_wxyz))

    def _finish(self, end: str, error: tuple[float, float] | None) -> None:
        self.end = end
        self._enter(error or self.judge.held_out(self._believed), {})

    def _enter(self, error: tuple[float, float], more: Line) -> None:
        now = self.now
        entry = {
            "visits": self.poses + now.given_up,
            "observations": now.observations,
            "seconds": round(now.seconds, 1),
            "joules": round(now.joules, 1),
            "mm": error[0],
            "mrad": error[1],
            **more,
        }
        self.entries.append({k: float(f"{v:.5g}") if isinstance(v, float) else v for k, v in entry.items()})


def fly(job: Job) -> Line:
    """A calibration, as a line of the file of runs."""
    name, settings, scenario_name, seed = job
    begun = time.process_time()
    scenario = scenario_of(scenario_name, seed)
    witness = Witness(scenario, seed)
    setup = Setup(tables=tables_of(scenario_name, settings), acquisition=DESIGNS[name].acquisition)
    run = simulate(scenario, seed, setup, each_tick=witness.see)
    return {
        "design": name,
        "settings": settings,
        "scenario": scenario_name,
        "seed": seed,
        "end": witness.end or f"no end: {run.record.get('reason', 'out of time')}",
        "before": [float(f"{v:.5g}") for v in witness.before],
        "columns": {key: [e.get(key) for e in witness.entries] for key in COLUMNS},
        "contacts": run.contacts,
        "cpu_s": round(time.process_time() - begun, 2),
    }


COLUMNS = ("visits", "observations", "seconds", "joules", "mm", "mrad", "off_mm", "off_mrad", "f")


# ---- summaries -------------------------------------------------------------------------------------------


def settled(line: Line) -> int | None:
    """Index of the entry from which on the held-out error stays within both limits; None if it does not, or
    if the run ended without a correction."""
    good = [
        mm <= LIMIT_MM and mrad <= LIMIT_MRAD
        for mm, mrad in zip(line["columns"]["mm"], line["columns"]["mrad"], strict=True)
    ]
    if not good or not good[-1] or line["end"] not in ("change", "no change", "poor"):
        return None
    return next((k + 1 for k in range(len(good) - 1, -1, -1) if not good[k]), 0)


def cost(line: Line, column: str) -> float:
    """Visits, observations, seconds or joules until the error stays within the limits; infinite if it does
    not."""
    k = settled(line)
    return float("inf") if k is None else float(line["columns"][column][k])


def error_at(line: Line, column: str, limit: float, what: str = "mm") -> float:
    """Held-out error when that many visits, seconds ... are spent: that of the last entry within the limit;
    before the first one, the error before the calibration."""
    spent = line["columns"][column]
    within = [k for k, value in enumerate(spent) if value <= limit]
    return float(line["columns"][what][within[-1]] if within else line["before"][what == "mrad"])


def quantile(values: list[float], q: float) -> float:
    """The smallest of the values that a share q does not exceed; may be infinite."""
    return float(np.quantile(values, q, method="inverted_cdf"))


def text(value: float, digits: str, beyond: str = "never") -> str:
    """A number for a table."""
    return format(value, digits) if np.isfinite(value) else beyond


VISITS = (3, 6, 8, 10, 12, 14, 17, 20, 25, 34)
SECONDS = (60, 120, 180, 240, 300, 400)


def summary(lines: list[Line]) -> list[str]:
    """Lines to print about the runs of one scenario and one design."""
    flown = max(line["columns"]["visits"][-1] for line in lines if line["columns"]["visits"])
    reached = sum(settled(line) is not None for line in lines)
    out = []
    for column in ("visits", "observations", "seconds", "joules"):
        values = [cost(line, column) for line in lines]
        beyond = f">{flown}" if column == "visits" else "never"
        median, p90 = (text(quantile(values, q), ".0f", beyond) for q in (0.5, 0.9))
        out.append(f"{column} {median}/{p90}")
    ends = [line["columns"] for line in lines]
    final = [quantile([c["mm"][-1] for c in ends], q) for q in (0.5, 0.9)]
    spent = [np.median([c[k][-1] for c in ends]) for k in ("visits", "observations", "seconds", "joules")]
    return [
        f"reached {reached}/{len(lines)}: " + ", ".join(out),
        f"at the end {final[0]:.2f}/{final[1]:.2f} mm, {spent[0]:.0f} visits, {spent[1]:.0f} observations,"
        f" {spent[2]:.0f} s, {spent[3]:.0f} J",
        _errors(lines, "visits", VISITS),
        _errors(lines, "seconds", SECONDS),
    ]


def _errors(lines: list[Line], column: str, limits: tuple[int, ...]) -> str:
    cells = []
    for limit in limits:
        errors = [error_at(line, column, limit) for line in lines]
        cells.append(f"{limit}: {quantile(errors, 0.5):.3g}/{quantile(errors, 0.9):.3g}")
    return f"mm after {column}  " + "  ".join(cells)


def print_summary(lines: list[Line]) -> None:
    """Median/p90 of everything, by scenario and design."""
    print(f"median/90th percentile; limits {LIMIT_MM:g} mm and {LIMIT_MRAD:g} mrad, held out")
    for scenario in SCENARIOS:
        for design in DESIGNS:
            own = [line for line in lines if (line["scenario"], line["design"]) == (scenario, design)]
            if own:
                print("\n    ".join([f"{scenario}, {design}:", *summary(own)]))
    for line in lines:
        if line["end"] not in ("change", "no change"):
            print(f"{line['scenario']}, {line['design']}, seed {line['seed']}: {line['end']}")


# ---- all of them -----------------------------------------------------------------------------------------


def key_of(line: Line) -> Job:
    """The job of a line."""
    return (line["design"], line["settings"], line["scenario"], line["seed"])


def jobs_of(o: argparse.Namespace) -> list[Job]:
    """Seeds first, so that whoever stops the study has all designs on the same seeds."""
    asked = read_settings(" ".join(o.set))
    settings = {name: settings_text(DESIGNS[name].settings | asked) for name in o.designs}
    seeds = range(o.first, o.first + o.seeds)
    return [(d, settings[d], s, seed) for seed in seeds for s in o.scenarios for d in o.designs]


def options(argv: list[str] | None) -> argparse.Namespace:
    """The command line."""
    p = argparse.ArgumentParser(prog="study.py", description=(__doc__ or "").split("\n")[0])
    p.add_argument("--designs", nargs="+", choices=list(DESIGNS), default=list(DESIGNS), metavar="NAME")
    p.add_argument("--scenarios", nargs="+", choices=list(SCENARIOS), default=list(SCENARIOS), metavar="NAME")
    p.add_argument("--seeds", type=int, default=40)
    p.add_argument("--first", type=int, default=1, help="first seed")
    p.add_argument("--jobs", type=int, default=2, help="processes")
    p.add_argument("--set", nargs="+", default=[], metavar="FIELD=VALUE", help="of CONFIG, in all designs")
    p.add_argument("--out", type=Path, default=ROOT / "build" / "study.jsonl")
    return p.parse_args(argv)


def main(argv: list[str] | None = None) -> int:
    """The study; exit status 2 if FILE belongs to another flight core or other tables."""
    o = options(argv)
    try:
        known = resumable.read(o.out, resumable.header(TABLES))
    except resumable.OtherRuns as e:
        print(e, file=sys.stderr)
        return 2
    lines = resumable.run_all(fly, jobs_of(o), o.out, known, key_of, o.jobs)
    print_summary(lines)
    return 0


if __name__ == "__main__":
    sys.exit(main())
