"""Faults between flight and its surroundings: does anything wrong become active, does anything hang?

    python tests/bench/faults.py [--seeds 2] [--jobs 2] [--only NAME ...] [--json FILE] [--write]

Each kind of fault_kinds.py is flown with each seed by kincal.run.inprocess.simulate: a whole calibration of
the scenario encoder_bias with POSES poses besides the local initial ones, the simulator's executive accepting
within its limits. The seed draws the onset, between 6 and 60 s of mission time, and the fault's own numbers.

Judged, by MuJoCo and from messages and stored images, not by flight's own verdicts
- wrong: a correction was active whose tool position, RMS over postures that were not measured, is more than
  WRONG_M off the true arm, or farther off than the correction before. WRONG_M is the largest predicted sigma
  with which the executive accepts.
- lost: a table was not active any more, or not the one that was there before; for kinematics also not one
  that had been proposed and approved. Or a correction that was answered as approved is not in force when
  flight is started again from what it stored.
- hang: no end within LIMIT_S of mission time, or flight not at rest at the end, or no heartbeat any more.
- silent: the run did not end as it does without the fault, and no warning or error that an operator can act
  on says so: one of the events that the kind names, with a next step in the dictionary; or the executive's
  reason, where only its own link is broken.

Prints one line for each kind. Exit status 1 if anything of this happened. --write puts the table into
docs/ASSURANCE.md.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
import time
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")


ROOT = Path(__file__).resolve().parents[2]
for _folder in ("ground", "sim", "build/py", "tests/bench"):
    sys.path.insert(0, str(ROOT / _folder))

from fault_kinds import KEY, KIN, KINDS, Fault, Kind  # noqa: E402
from montecarlo import coefficient_errors, rms_m  # noqa: E402

from kincal.flight import library  # noqa: E402
from kincal.flight import tables as codec  # noqa: E402
from kincal.link import unsigned32  # noqa: E402
from kincal.run.inprocess import Hooks, Message, Setup, SimulatedRun, Tick, simulate  # noqa: E402
from kincal.run.onboard import FlightSoftware  # noqa: E402
from kincal_sim.arm import Arm  # noqa: E402
from kincal_sim.executive import Executive  # noqa: E402
from kincal_sim.randomness import generator  # noqa: E402
from kincal_sim.scenario import Scenario, load  # noqa: E402

SCENARIO, POSES = "encoder_bias", 6
TABLES = ROOT / "tables" / "bin"
PAGE = ROOT / "docs" / "ASSURANCE.md"
ONSET_TICKS = (60, 600)
LIMIT_S = 1800.0
POSE_TIMEOUT_S = 120.0  # the executive's patience with one pose, so that a stuck run does not cost minutes
REST_TICKS = 30
HEARTBEAT_TICKS = 30  # the longest pause at the end
WRONG_M = 0.005
RUNS_OF_PROCESS = 200  # then a fresh one: what MuJoCo and LCM keep of every run would come to gigabytes
FLIGHT = library("flight")
AT_REST = tuple(FLIGHT.constant(f"KC_ST_{name}") for name in ("IDLE", "REVIEW", "ARMED", "SAFE"))
WARNING = FLIGHT.constant("KC_SEV_WARN")
N_TABLES = FLIGHT.constant("KC_TBL_COUNT")
APPROVE_GO = FLIGHT.lib.KC_CMD_APPROVE_GO
BEGIN, END = "<!-- made: faults -->\n", "<!-- end -->\n"


class Patient:
    """The executive; after it has ended, flight goes on until it is at rest."""

    def __init__(self, executive: Executive):
        self.executive, self.over = executive, False

    def tick(self, now_us: int, messages: list[Message], /) -> bool:
        """See Commander."""
        self.over = self.over or not self.executive.tick(now_us, messages)
        return True


@dataclass
class Witness:
    """What happened, tick by tick."""

    warned: Counter[str] = field(default_factory=Counter)  # names of events
    crcs: list[tuple[int, ...]] = field(default_factory=list)  # of the active tables, each change
    approved: set[int] = field(default_factory=set)
    proposals: dict[int, list[float]] = field(default_factory=dict)
    heartbeat: int = 0  # tick
    ticks: int = 0
    at_rest: int = 0  # ticks, since the executive ended
    state: int = 0

    def see(self, tick: Tick) -> None:
        """Take in one tick."""
        self.ticks, self.state = tick.number, tick.state
        for channel, m in tick.from_flight:
            if channel == "KC_EVENT" and m.severity >= WARNING:
                self.warned[FLIGHT.text(FLIGHT.lib.kc_event_name(m.id))] += 1
            elif channel == "KC_ACK" and m.opcode == APPROVE_GO and m.status == 0:
                self.approved |= set(self.proposals)
            elif channel == "KC_PROPOSAL":
                self.proposals[unsigned32(m.crc)] = list(m.value)[: m.n_coef]
            elif channel == "KC_HK":
                self.heartbeat = tick.number
                crcs = tuple(unsigned32(c) for c in m.table_crc)
                if not self.crcs or self.crcs[-1] != crcs:
                    self.crcs.append(crcs)


@dataclass(frozen=True)
class Verdict:
    """One run. ended: how, in words; wrong, lost, hang, silent: what must not be, "" if it is not."""

    kind: str
    seed: int
    onset_s: float
    ended: str
    events: tuple[str, ...]
    wrong: str
    lost: str
    hang: str
    silent: str
    mission_s: float
    cpu_s: float

    @property
    def faults(self) -> list[str]:
        """What must not be, in words."""
        named = (("wrong", self.wrong), ("lost", self.lost), ("hang", self.hang), ("silent", self.silent))
        return [f"{name}: {text}" for name, text in named if text]


# ---- flying


def _scenario() -> Scenario:
    scenario = load(SCENARIO)
    scenario.executive.pose_timeout_s = POSE_TIMEOUT_S
    return scenario


def fly(seed: int, hooks: Hooks) -> tuple[SimulatedRun, dict, Witness]:
    """A run, the executive's record, and what was seen."""
    scenario, witness, people = _scenario(), Witness(), []

    def make(send) -> Patient:
        people.append(Patient(Executive(scenario, send, seed, poses=POSES)))
        return people[0]

    def each_tick(tick: Tick) -> bool:
        witness.see(tick)
        resting = people[0].over and tick.state in AT_REST
        witness.at_rest = witness.at_rest + 1 if resting else 0
        return witness.at_rest < REST_TICKS

    run = simulate(
        scenario,
        seed,
        Setup(TABLES, commander=make, key=KEY, hooks=hooks, limit_s=LIMIT_S),
        each_tick=each_tick,
    )
    return run, people[0].executive.record(), witness


@cache
def undisturbed(seed: int) -> tuple[dict, Witness]:
    """The same run without a fault."""
    _, record, witness = fly(seed, Hooks())
    return record, witness


def one(job: tuple[str, int]) -> Verdict:
    """Fly one kind with one seed, and judge it."""
    name, seed = job
    kind, begun_s = next(k for k in KINDS if k.name == name), time.process_time()
    rng = generator(seed, f"fault {name}")
    onset = int(rng.integers(*ONSET_TICKS))
    fault = kind.make(onset, rng)
    run, record, witness = fly(seed, fault.hooks)
    ended = f"{record.get('reason', 'the executive did not end')}"
    return Verdict(
        name,
        seed,
        onset / 10,
        ended,
        tuple(sorted(witness.warned)),
        wrong_correction(run, fault, witness),
        lost_table(witness) or lost_approval(run, witness),
        hang(run, record, witness),
        silent(kind, seed, record, witness),
        round(run.mission_s, 1),
        round(time.process_time() - begun_s, 2),
    )


# ---- judging


def initial_crcs() -> dict[int, int]:
    """CRC by kind of the tables that every run starts with."""
    images = (codec.header(path.read_bytes()) for path in TABLES.glob("*.tbl"))
    return {codec.kinds()[image.kind]: image.crc for image in images}


def wrong_correction(run: SimulatedRun, fault: Fault, witness: Witness) -> str:
    """By MuJoCo: the true arm, with what its encoders read now, against one with the corrections that were
    active."""
    bias = run.world.plant.encoders.bias_rad + fault.bias_rad

    def off_m(believed: Arm) -> float:
        return rms_m(run.world.arm, believed, bias, generator(run.seed, "held out"))

    found = []
    for crc in {crcs[KIN] for crcs in witness.crcs} & set(witness.proposals):
        error_m, before_m = off_m(Arm(errors=coefficient_errors(witness.proposals[crc]))), off_m(Arm())
        if not error_m <= min(WRONG_M, before_m):
            found.append(
                f"correction {crc:08x} is {1e3 * error_m:.1f} mm off, {1e3 * before_m:.1f} mm before"
            )
    return ", ".join(found)


def lost_table(witness: Witness) -> str:
    """Every table is the one from before; kinematics may be one that was approved."""
    first = initial_crcs()
    for crcs in witness.crcs:
        for kind in range(1, N_TABLES):
            allowed = {first[kind]} | (witness.approved if kind == KIN else set())
            if crcs[kind] not in allowed:
                return f"{codec.kind_name(kind)} is {crcs[kind]:08x}"
    return ""


def lost_approval(run: SimulatedRun, witness: Witness) -> str:
    """What was answered as approved is in force when flight is started again from what it stored."""
    if not witness.approved:
        return ""
    published = FlightSoftware(TABLES, run.store).step(1)
    (crc,) = (unsigned32(m.table_crc[KIN]) for channel, m in published if channel == "KC_HK")
    return "" if crc in witness.approved else f"after a restart kinematics is {crc:08x}"


def hang(run: SimulatedRun, record: dict, witness: Witness) -> str:
    """Executive and flight have come to an end, and flight still lives."""
    if not run.ended:
        return f"no end after {run.mission_s:.0f} s, state {witness.state}"
    if not record.get("reason"):
        return "the executive did not end"
    unheard = run.log.counts["KC_HK"] == 0 or "heartbeat" in record["reason"]
    if witness.ticks - witness.heartbeat > HEARTBEAT_TICKS and not unheard:
        return f"no heartbeat for {(witness.ticks - witness.heartbeat) / 10:.1f} s"
    return ""


def silent(kind: Kind, seed: int, record: dict, witness: Witness) -> str:
    """Whoever looks at the events (or, where its link is broken, at the executive) finds out."""
    calm, calm_witness = undisturbed(seed)
    same = (record.get("success"), record.get("verdict")) == (calm["success"], calm["verdict"])
    said = witness.warned - calm_witness.warned
    if same or (kind.by == "executive" and record.get("reason")):
        return ""
    explained = [name for name in kind.events if name in said and next_step(name)]
    return "" if explained else f"{record.get('reason')}; events: {', '.join(said) or 'none'}"


@cache
def next_step(event: str) -> str:
    """What the dictionary tells the operator to do."""
    return FLIGHT.text(FLIGHT.lib.kc_event_action(FLIGHT.constant(f"KC_EVT_{event}")))


# ---- all of them


def fly_all(jobs: list[tuple[str, int]], processes: int) -> list[Verdict]:
    """All runs, in the order of jobs."""
    if processes == 1:
        return [one(job) for job in jobs]
    verdicts = []
    with multiprocessing.get_context("spawn").Pool(processes, maxtasksperchild=RUNS_OF_PROCESS) as pool:
        for k, verdict in enumerate(pool.imap(one, jobs), 1):
            verdicts.append(verdict)
            for fault in verdict.faults:
                print(f"{verdict.kind} seed {verdict.seed}: {fault}", file=sys.stderr, flush=True)
            if k % 20 == 0:
                print(f"{k}/{len(jobs)} runs", file=sys.stderr, flush=True)
    return verdicts


def row(kind: Kind, own: Iterable[Verdict]) -> tuple[str, ...]:
    """Cells of the table: kind, what, runs, corrected as without, wrong, lost, hang, silent, events."""
    own = list(own)
    went_on = sum(v.ended == undisturbed(v.seed)[0]["reason"] for v in own)
    seen = Counter(name for v in own for name in v.events if name in kind.events)
    bad = [sum(bool(getattr(v, what)) for v in own) for what in ("wrong", "lost", "hang", "silent")]
    events = ", ".join(f"`{name}`" for name, _ in seen.most_common(3))
    said = events or ("executive" if kind.by == "executive" else "-")
    return (f"`{kind.name}`", kind.what, str(len(own)), str(went_on), *map(str, bad), said)


HEAD = ("kind", "fault", "runs", "went on", "wrong", "lost", "hang", "silent", "what says so")


def table(verdicts: list[Verdict]) -> str:
    """Markdown: one row for each kind that was flown."""
    lines = [f"| {' | '.join(HEAD)} |", f"|{'---|' * len(HEAD)}"]
    for kind in KINDS:
        own = [v for v in verdicts if v.kind == kind.name]
        if own:
            lines.append(f"| {' | '.join(row(kind, own))} |")
    return "\n".join(lines) + "\n"


def write(verdicts: list[Verdict], seeds: int) -> None:
    """Put the table between its marks in docs/ASSURANCE.md."""
    text = PAGE.read_text()
    before, after = text[: text.index(BEGIN) + len(BEGIN)], text[text.index(END) :]
    runs = f"{len(verdicts)} runs: {len({v.kind for v in verdicts})} kinds, {seeds} seeds each.\n\n"
    PAGE.write_text(f"{before}\n{runs}{table(verdicts)}\n{after}")


def options(argv: list[str] | None) -> argparse.Namespace:
    """The command line."""
    p = argparse.ArgumentParser(prog="faults.py", description=(__doc__ or "").split("\n")[0])
    p.add_argument("--seeds", type=int, default=2)
    p.add_argument("--jobs", type=int, default=2, help="processes")
    p.add_argument("--only", nargs="*", choices=[k.name for k in KINDS], metavar="NAME")
    p.add_argument("--json", type=Path, help="write every run there")
    p.add_argument("--write", action="store_true", help="put the table into docs/ASSURANCE.md")
    return p.parse_args(argv)


def main(argv: list[str] | None = None) -> int:
    """The campaign; exit status as above."""
    o = options(argv)
    names = o.only or [k.name for k in KINDS]
    verdicts = fly_all([(name, seed) for seed in range(1, o.seeds + 1) for name in names], o.jobs)
    if o.json:
        o.json.write_text(json.dumps([asdict(v) for v in verdicts], indent=1) + "\n")
    print(table(verdicts))
    for v in verdicts:
        for fault in v.faults:
            print(f"{v.kind} seed {v.seed} from {v.onset_s:g} s: {fault}")
    if o.write:
        write(verdicts, o.seeds)
    bad = sum(bool(v.faults) for v in verdicts)
    print(f"{len(verdicts)} runs, {bad} with something that must not be")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
