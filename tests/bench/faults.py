"""Faults between flight and its surroundings: does anything wrong become active, does anything hang?

    python tests/bench/faults.py [--seeds 2] [--first 1] [--jobs 2] [--only NAME ...] [--pairs]
                                 [--out FOLDER] [--write]

Each kind of fault_kinds.py is flown in each scenario of missions.py with each seed by
kincal.run.inprocess.simulate: a whole calibration with POSES poses besides the local initial ones, the
simulator's executive accepting within its limits. Seed and scenario draw the onset, between 6 and 60 s of
mission time, and the fault's own numbers. Runs are cases of a campaign in FOLDER; a second start goes on.
--pairs: a second fault of another kind, drawn by kind, scenario and seed too, with an onset of its own.

Judged, by MuJoCo and from messages and stored images, not by flight's own verdicts
- wrong: a correction was active whose tool position, RMS over postures that were not measured and in the
  frame that CONFIG names, is more than WRONG_M off, or more than WRONG_PREDICTED times the predicted error.
  WRONG_M is the largest predicted error with which the executive accepts.
- lost: a table was not active any more, or not the one that was there before; for kinematics also not one
  that had been proposed and approved. Or a correction that was answered as approved is not in force when
  flight is started again from what it stored.
- hang: no end within LIMIT_S of mission time, or flight not at rest at the end, or no heartbeat any more.
- silent: the run did not end as it does without the fault, nor with a result ("wrong" judges that) or with a
  correction that the executive leaves to the ground for a reason; and no warning or error that an operator
  can act on says so: one of the events that the kind names, with a next step in the dictionary; or the
  executive's reason, where only its own link is broken.

Prints one line for each kind. Exit status 1 if anything of this happened, 2 if FOLDER belongs to other
software or other tables. --write puts the table into docs/ASSURANCE.md.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path

import cases
import missions
from fault_kinds import KEY, KIN, KINDS, Fault, Kind, both

from kincal.flight import library
from kincal.flight import tables as codec
from kincal.link import unsigned32
from kincal.run.inprocess import Hooks, Message, Setup, SimulatedRun, Tick, simulate
from kincal.run.onboard import FlightSoftware
from kincal_sim.executive import Executive
from kincal_sim.randomness import generator
from kincal_sim.scenario import Scenario

POSES = 6
ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "ASSURANCE.md"
ONSET_TICKS = (60, 600)
LIMIT_S = 1800.0
POSE_TIMEOUT_S = 120.0  # the executive's patience with one pose, so that a stuck run does not cost minutes
REST_TICKS = 30
HEARTBEAT_TICKS = 30  # the longest pause at the end
DECLINED = "correction not accepted"
WRONG_M, WRONG_PREDICTED = 0.005, 4.0
FLIGHT = library("flight")
AT_REST = tuple(FLIGHT.constant(f"KC_ST_{name}") for name in ("IDLE", "REVIEW", "ARMED", "SAFE"))
WARNING = FLIGHT.constant("KC_SEV_WARN")
N_TABLES = FLIGHT.constant("KC_TBL_COUNT")
APPROVE_GO = FLIGHT.lib.KC_CMD_APPROVE_GO
BEGIN, END = "<!-- made: faults -->\n", "<!-- end -->\n"


class Patient:
    """The executive; after it has ended, flight goes on until it is at rest."""

    quiet_until_us = 0

    def __init__(self, executive: Executive):
        self.executive, self.over = executive, False
        self.channels = executive.channels

    def tick(self, now_us: int, messages: list[Message], /) -> bool:
        """See Commander."""
        self.over = self.over or not self.executive.tick(now_us, messages)
        return True


@dataclass(frozen=True)
class Proposed:
    """A correction by coefficient name, its predicted error [m], and whether that is in the camera's
    frame."""

    correction: dict[str, float]
    predicted_m: float
    in_camera: bool


@dataclass
class Witness:
    """What happened in a run of a scenario, tick by tick."""

    scenario: str
    warned: Counter[str] = field(default_factory=Counter)  # names of events
    crcs: list[tuple[int, ...]] = field(default_factory=list)  # of the active tables, each change
    approved: set[int] = field(default_factory=set)
    proposals: dict[int, Proposed] = field(default_factory=dict)
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
                correction = dict(zip(missions.names(self.scenario), m.value, strict=False))
                self.proposals[unsigned32(m.crc)] = Proposed(correction, m.pred_pos_m, m.frame == m.CAMERA)
            elif channel == "KC_HK":
                self.heartbeat = tick.number
                crcs = tuple(unsigned32(c) for c in m.table_crc)
                if not self.crcs or self.crcs[-1] != crcs:
                    self.crcs.append(crcs)


@dataclass(frozen=True)
class Verdict:
    """One run. second: the kind of the second fault, "" without; ended: how, in words; went_on: as without
    the fault; wrong, lost, hang, silent: what must not be, "" if it is not."""

    onset_s: float
    second: str
    ended: str
    went_on: bool
    events: tuple[str, ...]
    wrong: str
    lost: str
    hang: str
    silent: str
    mission_s: float

    @property
    def faults(self) -> list[str]:
        """What must not be, in words."""
        named = (("wrong", self.wrong), ("lost", self.lost), ("hang", self.hang), ("silent", self.silent))
        return [f"{name}: {text}" for name, text in named if text]


# ---- flying


def _scenario(name: str, seed: int) -> Scenario:
    scenario = missions.scenario_of(name, seed)
    scenario.executive.pose_timeout_s = POSE_TIMEOUT_S
    return scenario


def fly(name: str, seed: int, hooks: Hooks) -> tuple[SimulatedRun, dict, Witness]:
    """A run of a scenario, the executive's record, and what was seen."""
    scenario, witness, people = _scenario(name, seed), Witness(name), []

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
        Setup(missions.tables_of(name), commander=make, key=KEY, hooks=hooks, limit_s=LIMIT_S),
        each_tick=each_tick,
    )
    return run, people[0].executive.record(), witness


@cache
def undisturbed(name: str, seed: int) -> tuple[dict, Witness]:
    """The same run without a fault."""
    _, record, witness = fly(name, seed, Hooks())
    return record, witness


def one(name: str, scenario: str, seed: int, pairs: bool = False) -> Verdict:
    """Fly one kind in one scenario with one seed, and judge it. pairs: together with a second one."""
    rng = generator(seed, f"fault {name} {scenario}")
    onset = int(rng.integers(*ONSET_TICKS))
    kinds = [next(k for k in KINDS if k.name == name)]
    fault = kinds[0].make(onset, rng)
    if pairs:
        others = [k for k in KINDS if k.name != name]
        kinds.append(others[rng.integers(len(others))])
        fault = both(fault, kinds[1].make(int(rng.integers(*ONSET_TICKS)), rng))
    run, record, witness = fly(scenario, seed, fault.hooks)
    ended = f"{record.get('reason', 'the executive did not end')}"
    return Verdict(
        onset / 10,
        kinds[1].name if pairs else "",
        ended,
        ended == undisturbed(scenario, seed)[0]["reason"],
        tuple(sorted(witness.warned)),
        wrong_correction(run, fault, witness),
        lost_table(witness, initial_crcs(scenario)) or lost_approval(run, witness),
        hang(run, record, witness, heard=all(kind.name != "housekeeping_lost" for kind in kinds)),
        silent(kinds, (scenario, seed), record, witness),
        round(run.mission_s, 1),
    )


def case(seed: int, values: dict) -> dict:
    """The same as columns; kind, scenario and pairs are among the values."""
    return cases.columns(asdict(one(values["kind"], values["scenario"], seed, values["pairs"])))


# ---- judging


@cache
def initial_crcs(scenario: str) -> dict[int, int]:
    """CRC by kind of the tables that a run of the scenario starts with."""
    images = (codec.header(path.read_bytes()) for path in missions.tables_of(scenario).glob("*.tbl"))
    return {codec.kinds()[image.kind]: image.crc for image in images}


def wrong_correction(run: SimulatedRun, fault: Fault, witness: Witness) -> str:
    """By MuJoCo: the true arm, with what its encoders read and its camera sees at the end, against arms
    with the corrections that were active."""
    found = []
    for crc in {crcs[KIN] for crcs in witness.crcs} & set(witness.proposals):
        p = witness.proposals[crc]
        seen = missions.in_camera(fault.seen(witness.ticks)) if p.in_camera else None
        off_m = missions.error_m(run.scenario, p.correction, run.seed, fault.slip_rad(witness.ticks), seen)
        if not off_m <= min(WRONG_M, WRONG_PREDICTED * p.predicted_m):
            found.append(
                f"correction {crc:08x} is {1e3 * off_m:.1f} mm off, predicted {1e3 * p.predicted_m:.1f} mm"
            )
    return ", ".join(found)


def lost_table(witness: Witness, first: dict[int, int]) -> str:
    """Every table is the first one, CRC by kind; kinematics may be one that was approved."""
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
    published = FlightSoftware(missions.tables_of(run.scenario.name), run.store).step(1)
    (crc,) = (unsigned32(m.table_crc[KIN]) for channel, m in published if channel == "KC_HK")
    return "" if crc in witness.approved else f"after a restart kinematics is {crc:08x}"


def hang(run: SimulatedRun, record: dict, witness: Witness, *, heard: bool = True) -> str:
    """Executive and flight have come to an end, and flight still lives. heard: its heartbeats arrive."""
    if not run.ended:
        return f"no end after {run.mission_s:.0f} s, state {witness.state}"
    if not record.get("reason"):
        return "the executive did not end"
    unheard = run.log.counts["KC_HK"] == 0 or "heartbeat" in record["reason"] or not heard
    if witness.ticks - witness.heartbeat > HEARTBEAT_TICKS and not unheard:
        return f"no heartbeat for {(witness.ticks - witness.heartbeat) / 10:.1f} s"
    return ""


def silent(kinds: list[Kind], mission: tuple[str, int], record: dict, witness: Witness) -> str:
    """Whoever looks at the events (or, where its link is broken, at the executive) finds out. kinds: of the
    faults; mission: scenario and seed."""
    calm, calm_witness = undisturbed(*mission)
    same = (record.get("success"), record.get("verdict")) == (calm["success"], calm["verdict"])
    said = witness.warned - calm_witness.warned
    reason = record.get("reason", "")
    decided = record.get("success") or reason.startswith(DECLINED)
    if same or decided or (reason and any(kind.by == "executive" for kind in kinds)):
        return ""
    explained = [name for kind in kinds for name in kind.events if name in said and next_step(name)]
    return "" if explained else f"{record.get('reason')}; events: {', '.join(said) or 'none'}"


@cache
def next_step(event: str) -> str:
    """What the dictionary tells the operator to do."""
    return FLIGHT.text(FLIGHT.lib.kc_event_action(FLIGHT.constant(f"KC_EVT_{event}")))


# ---- all of them


def row(kind: Kind, own: Iterable[dict]) -> tuple[str, ...]:
    """Cells of the table: kind, what, runs, ended as without, wrong, lost, hang, silent, events."""
    own = list(own)
    went_on = sum(v["went_on"] for v in own)
    seen = Counter(name for v in own for name in v["events"] if name in kind.events)
    bad = [sum(bool(v[what]) for v in own) for what in BAD]
    events = ", ".join(f"`{name}`" for name, _ in seen.most_common(3))
    said = events or ("executive" if kind.by == "executive" else "-")
    return (f"`{kind.name}`", kind.what, str(len(own)), str(went_on), *map(str, bad), said)


BAD = ("wrong", "lost", "hang", "silent")
HEAD = ("kind", "fault", "runs", "went on", "wrong", "lost", "hang", "silent", "what says so")


def table(lines: list[dict]) -> str:
    """Markdown: one row for each kind that was flown."""
    rows = [f"| {' | '.join(HEAD)} |", f"|{'---|' * len(HEAD)}"]
    for kind in KINDS:
        own = [v for v in lines if v["kind"] == kind.name]
        if own:
            rows.append(f"| {' | '.join(row(kind, own))} |")
    return "\n".join(rows) + "\n"


def write(lines: list[dict], seeds: int) -> None:
    """Put the table between its marks in docs/ASSURANCE.md."""
    text = PAGE.read_text()
    before, after = text[: text.index(BEGIN) + len(BEGIN)], text[text.index(END) :]
    kinds, scenarios = len({v["kind"] for v in lines}), len({v["scenario"] for v in lines})
    runs = f"{len(lines)} runs: {kinds} kinds, {scenarios} scenarios, {seeds} seeds each.\n\n"
    PAGE.write_text(f"{before}\n{runs}{table(lines)}\n{after}")


def options(argv: list[str] | None) -> argparse.Namespace:
    """The command line."""
    p = cases.options("faults", __doc__, seeds=2)
    p.add_argument("--only", nargs="*", choices=[k.name for k in KINDS], metavar="NAME")
    p.add_argument("--pairs", action="store_true", help="two faults in each run")
    p.add_argument("--write", action="store_true", help="put the table into docs/ASSURANCE.md")
    o = p.parse_args(argv)
    if o.pairs and o.write:
        p.error("--write: the table of docs/ASSURANCE.md has one fault in each run; leave --pairs out")
    return o


def main(argv: list[str] | None = None) -> int:
    """The campaign; exit status as above."""
    o = options(argv)
    axes = {"scenario": missions.SCENARIOS, "kind": [k.name for k in KINDS]}
    wanted = lambda _seed, values: values["kind"] in (o.only or axes["kind"])  # noqa: E731
    lines = cases.fly(o, "faults:case", axes, wanted, {"poses": POSES, "pairs": o.pairs}, BAD)
    print(table(lines))
    bad = [v for v in lines if any(v[what] for what in BAD)]
    for v in bad:
        said = ", ".join(f"{what}: {v[what]}" for what in BAD if v[what])
        kinds = " and ".join(filter(None, (v["kind"], v["second"])))
        print(f"{kinds}, {v['scenario']}, seed {v['seed']}, from {v['onset_s']:g} s: {said}")
    if o.write:
        write(lines, o.seeds)
    print(f"{len(lines)} runs, {len(bad)} with something that must not be")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
