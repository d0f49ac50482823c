"""How many poses, seconds and joules does a calibration take, by each way of choosing its poses?

    python tests/bench/study.py [--designs ucb dopt ...] [--scenarios paper ...] [--seeds 40] [--first 1]
                                [--jobs 2] [--set FIELD=VALUE ...] [--pixels] [--out FOLDER] [--write]

A design is an acquisition with settings of CONFIG (DESIGNS, below). Each is flown in each scenario with each
seed by kincal.run.inprocess.simulate, from START to the proposal: flight core, the shipped tables, the
simulator in fast mode. Runs are cases of a campaign in FOLDER; a second start continues it. --set changes
fields of CONFIG in all designs (est.rank_tol=1e-5 for a nested one). --pixels draws, compresses and detects
the frames that are measured (pixels.py). --write puts tables into docs/STUDY.md and figures into docs/img.
Designs of other makers fly nothing: study_outside.py.

Scenarios
- paper: the errors of the paper's simulation
- uniform: all 28 DH errors drawn evenly between the error bounds of the space
- two_biases: encoders of two joints read 0.02 to 0.09 rad wrong
- slipped: the encoder of one joint does
- uplinked: the elbow yields under gravity; the TERMS table has the effect

Recorded after each pose: visits (every pose that the arm set out for counts: local initial poses, and
those that were skipped), observations used, mission seconds since START, joules (the powers of CONFIG;
moving while arm or pan-tilt unit says so), and of the estimate at that time the error at HELD_OUT postures
that were not measured, anywhere in the search region (RMS, position and rotation). off_mm, off_mrad: the
measured pose against the kinematics before it was used, the distances in the paper's f (eq. 6); f: as flight
states it. The last entry of a run is its proposal. After an abort, or if flight finds that nothing has to
change, there is no correction, and the last entry is the error of the arm as it was. Truth and comparison are
MuJoCo's; they share no code with flight.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import cases  # noqa: E402
import missions  # noqa: E402
import montecarlo  # noqa: E402
import numpy as np  # noqa: E402
import pixels  # noqa: E402
import study_outside  # noqa: E402
import study_report  # noqa: E402
from study_report import Line, Study  # noqa: E402

from kincal.flight import event_name  # noqa: E402
from kincal.flight import tables as codec  # noqa: E402
from kincal.pages.image import NoPictures  # noqa: E402
from kincal.run.inprocess import TABLES, Setup, Tick, simulate  # noqa: E402
from kincal_sim.mechanics.arm import Arm  # noqa: E402
from kincal_sim.mechanics.spec import split_errors  # noqa: E402
from kincal_sim.randomness import generator  # noqa: E402
from kincal_sim.scenario import ArmTruth, Scenario, load  # noqa: E402
from kincal_sim.transforms import quaternion, rot, rotation_angle, rotation_matrix  # noqa: E402
from kincal_sim.truth import build_plant, held_out_poses  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Design:
    """How poses are chosen. what: in words, for tables; acquisition: its name in CONFIG; settings: fields of
    CONFIG that differ from the shipped table."""

    what: str
    acquisition: str
    settings: dict[str, float] = field(default_factory=dict)


# What flies. A new row here is all that a new design needs. A new field of CONFIG that changes what the older
# designs do gets its old value in their settings, so that they stay what others are compared with.
AT_POSES: dict[str, float] = {"extra_obs_max": 0, "stops_max": 0}  # one observation a pose, none on the way
PAPER: dict[str, float] = {"initial_design": 0, **AT_POSES}  # and all initial poses
DESIGNS = {
    "ucb": Design("GP-UCB on f, as in the paper", "ucb", PAPER),
    "random": Design("by chance, the paper's baseline", "random", PAPER),
    "dopt": Design("most information, D-optimal", "dopt", PAPER),
    "vopt": Design("least predicted variance, V-optimal", "vopt", PAPER),
    "dopt_initial": Design("D-optimal from the start, initial poses too", "dopt", AT_POSES),
    "rate": Design("most information for its cost, from the start: the default", "rate"),
}
# What is chosen before anything is measured and compared offline: study_outside.py.
OUTSIDE = {
    "figaroh": "figaroh's D-optimal weights",
    "detmax": "DETMAX exchange",
}
SCENARIOS = {
    "paper": "the paper's errors",
    "uniform": "uniform errors inside the bounds",
    "two_biases": "two encoder biases",
    "slipped": "one slipped joint",
    "uplinked": "an uplinked effect",
}
ALL = [*DESIGNS, *OUTSIDE]
HELD_OUT = 200
PAGE, IMAGES = ROOT / "docs" / "STUDY.md", ROOT / "docs" / "img"
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


class Truth:
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
    skipped: int = 0  # poses
    observations: int = 0


class Witness:
    """Takes in a run tick by tick. entries: one for each pose, then one for the end; end: how it ended, ""
    while it goes on."""

    def __init__(self, scenario: Scenario, seed: int) -> None:
        self.truth, self.names = Truth(scenario, seed), missions.names(scenario.name)
        self.now = Account()
        self.start_us: int | None = None
        self.measured: dict[int, Any] = {}  # last observation by pose
        self.entries: list[Line] = []
        self.end, self.poses = "", 0
        self._believed = Believed(scenario)
        self.before = self.truth.held_out(self._believed)
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
                error = self.before if m.verdict == m.NO_CHANGE else self.truth.held_out(self._believed)
                self.finish(VERDICTS[m.verdict], error)
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
            self.now.skipped += 1
        elif event == "CAL_ABORTED":
            self.finish("aborted", self.before)

    def _believe(self, values: Any) -> None:
        self._believed.correct(dict(zip(self.names, values, strict=False)))

    def _progress(self, m: Any) -> None:
        off = self._off(self.measured[m.pose])
        self._believe(m.coef)
        self.poses += 1
        self._enter(self.truth.held_out(self._believed), {"off_mm": off[0], "off_mrad": off[1], "f": m.f})

    def _off(self, meas: Any) -> tuple[float, float]:
        """Distance of a measured pose from the one believed, position [mm] and rotation [mrad]."""
        T = self._believed.pose(np.array(meas.q_rad[: meas.n_joints]))
        off_m = np.linalg.norm(T[:3, 3] - np.array(meas.p_m))
        return 1e3 * float(off_m), 1e3 * rotation_angle(T, rotation_matrix(meas.q_wxyz))

    def finish(self, end: str, error: tuple[float, float]) -> None:
        """The run ends, with the arm this much in error."""
        self.end = end
        self._enter(error, {})

    def _enter(self, error: tuple[float, float], more: Line) -> None:
        now = self.now
        entry = {
            "visits": self.poses + now.skipped,
            "observations": now.observations,
            "seconds": round(now.seconds, 1),
            "joules": round(now.joules, 1),
            "mm": error[0],
            "mrad": error[1],
            **more,
        }
        self.entries.append({k: rounded(v) for k, v in entry.items()})


def case(seed: int, values: dict[str, Any]) -> Line:
    """A calibration as columns. values: design, scenario, set (settings in words), pixels."""
    job = (values["design"], settings_of(values["design"], values["set"]), values["scenario"], seed)
    return cases.columns(one(job, values["pixels"]))


def one(job: Job, drawn: bool = False) -> Line:
    """A calibration."""
    return outside(job) if job[0] in OUTSIDE else fly(job, drawn)


def outside(job: Job) -> Line:
    """Sets of poses of another maker, each measured from nothing."""
    design, _, scenario_name, seed = job
    scenario = scenario_of(scenario_name, seed)
    truth, believed = Truth(scenario, seed), Believed(scenario)
    before, columns = truth.held_out(believed), {key: [] for key in COLUMNS}
    for visits, observations, correction in study_outside.corrections(design, scenario, seed):
        believed.correct(correction)
        error = truth.held_out(believed)
        entry = {"visits": visits, "observations": observations, "mm": error[0], "mrad": error[1]}
        for key, values in columns.items():
            values.append(rounded(entry.get(key)))
    return {"end": "change", "before": [rounded(v) for v in before], "columns": columns}


def rounded(value: Any) -> Any:
    """With five digits, if it is a fraction."""
    return float(f"{value:.5g}") if isinstance(value, float) else value


def fly(job: Job, drawn: bool) -> Line:
    """A calibration by flight; drawn: through pixels."""
    name, settings, scenario_name, seed = job
    scenario = scenario_of(scenario_name, seed)
    witness = Witness(scenario, seed)
    setup = Setup(tables=tables_of(scenario_name, settings), acquisition=DESIGNS[name].acquisition)
    if drawn:
        setup = replace(setup, world=imager().world)

    def each_tick(tick: Tick) -> bool:
        imager().see(tick)
        return witness.see(tick)

    run = simulate(scenario, seed, setup, each_tick=each_tick if drawn else witness.see)
    if not witness.end:
        witness.finish(f"no end: {run.record.get('reason', 'out of time')}", witness.before)
    return {
        "end": witness.end,
        "before": [rounded(v) for v in witness.before],
        "columns": {key: [e.get(key) for e in witness.entries] for key in COLUMNS},
        "contacts": run.contacts,
    }


@cache
def imager() -> pixels.DrawnImager:
    """With a detector of its own for each process of the pool."""
    return pixels.DrawnImager(pixels.Detector(Path(tempfile.mkdtemp())))


VERDICTS = ("no change", "change", "poor")  # of proposal_t
COLUMNS = ("visits", "observations", "seconds", "joules", "mm", "mrad", "off_mm", "off_mrad", "f")


# ---- summaries -------------------------------------------------------------------------------------------


def study_of(lines: Sequence[Line]) -> Study:
    """For tables and figures."""
    return Study(lines, SCENARIOS, {name: design.what for name, design in DESIGNS.items()}, OUTSIDE)


def print_summary(study: Study) -> None:
    """The tables as text."""
    for name, part in study_report.page_parts(study).items():
        print(f"{name}\n\n{part}")


# ---- all of them -----------------------------------------------------------------------------------------


def settings_of(design: str, asked: str) -> str:
    """Settings of a design, with those that are asked for."""
    return "" if design in OUTSIDE else settings_text(DESIGNS[design].settings | read_settings(asked))


def prepare(o: argparse.Namespace) -> None:
    """Have the sets of other makers chosen before several processes want them, and settings checked."""
    for design in (d for d in o.designs if d in OUTSIDE):
        for uplinked in {scenario == "uplinked" for scenario in o.scenarios}:
            study_outside.sets(design, uplinked)
    for scenario in o.scenarios:
        for design in o.designs:
            tables_of(scenario, settings_of(design, " ".join(o.set)))


def options(argv: list[str] | None) -> argparse.Namespace:
    """The command line."""
    p = cases.options("study", __doc__, seeds=40)
    p.add_argument("--designs", nargs="+", choices=ALL, default=ALL, metavar="NAME")
    p.add_argument("--scenarios", nargs="+", choices=list(SCENARIOS), default=list(SCENARIOS), metavar="NAME")
    p.add_argument("--set", nargs="+", default=[], metavar="FIELD=VALUE", help="of CONFIG, in all designs")
    p.add_argument("--pixels", action="store_true", help="frames that are measured are drawn and detected")
    p.add_argument("--write", action="store_true", help="tables into docs/STUDY.md, figures into docs/img")
    p.add_argument("--figures", type=Path, metavar="FOLDER", help="figures only, into a folder")
    return p.parse_args(argv)


def main(argv: list[str] | None = None) -> int:
    """The study; exit status 1 if figures could not be drawn, 2 if FOLDER belongs to other software, tables
    or settings, a setting is no field of CONFIG, or figaroh is missing."""
    o = options(argv)
    try:
        prepare(o)
    except ValueError as e:
        print(f"--set: {e}", file=sys.stderr)
        return 2
    except ImportError as e:
        print(f"{e}: make .venv/.stamp-bench installs it; or name other --designs", file=sys.stderr)
        return 2
    axes = {"scenario": list(SCENARIOS), "design": ALL}
    wanted = lambda _seed, v: v["scenario"] in o.scenarios and v["design"] in o.designs  # noqa: E731
    settings = {"set": settings_text(read_settings(" ".join(o.set))), "pixels": o.pixels}
    lines = cases.fly(o, "study:case", axes, wanted, settings)
    study = study_of(lines)
    print_summary(study)
    if o.write:
        study_report.write_page(PAGE, study_report.page_parts(study))
    if o.write or o.figures:
        try:
            print("\n".join(map(str, study_report.save(study, IMAGES if o.write else o.figures))))
        except NoPictures as e:
            print(f"no figures: {e.what}; {e.todo}", file=sys.stderr)
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
