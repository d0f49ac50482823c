"""Many recalibrations of wrong arms: does anything touch, is any command not verified?

    python tests/bench/montecarlo.py [--runs 1000] [--outside 1000] [--seed 1] [--jobs 2] [--out FOLDER]

Each is flown by kincal.run.inprocess.simulate: the flight core against the simulator in fast mode, without
LCM and without processes, as a case of a campaign in FOLDER: it can be stopped and started again. Exit status
1 if a criterion is missed, 2 if FOLDER belongs to other software or other tables.

Sampled errors (run number and seed say which; the bounds are those of tables/src/space.toml [error_bounds])
- inside: run 0 is the paper's set; then by run number in turn 6 of 10 `box`: all 28 DH errors even between
  their bounds; 2 `alone`: one error, any of them, between half its bound and the bound, either way; 2
  `three`: three errors at their bounds, either way.
- outside: in turn `slip`: an encoder of any joint that reads 1 to 2.5 rad wrong (joint 7: beyond its
  bound); `few`: one to three errors at 1.5 to 4 times their bounds; `wide`: all 28 even in the box of 1.5
  to 4 times the bounds, one of them at its end; `both`: a slip and all 28 inside their bounds. No angle is
  more than pi off.
An arm that is within 20 mm of something at the park pose, before anything was commanded, is sampled again,
and counted: whoever parked it there saw to it that it stands free.

Checked
- contact: MuJoCo's arm with the true errors, with itself, deck, ground, mast, pan-tilt unit: at every tick
  and at SUBSTEPS times within each while anything moves (25 ms: a joint at full speed turns 20 mrad).
- limits: every commanded joint inside the limits of the ARM table and of the simulator's arm, every
  pan-tilt angle inside those of the CAMERA table.
- verified: from the contents of the SPACE table, without flight's functions: a command is verified if where
  the arm stands (by its encoders) and where it goes lie inside the servo bound of one candidate, or both on
  one verified straight segment, which it goes along.
- finished: a correction was proposed, or found not to be needed. Else: refused at START, or the cause of
  the abort. Error of the result: RMS tool position over 100 postures that were not measured, by MuJoCo.
"""

import argparse
import sys
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import cases
import mujoco
import numpy as np

from kincal.flight import event_name, library
from kincal.link import unsigned32
from kincal.run.inprocess import Script, Setup, Tick, command, simulate
from kincal.space import SpaceTable, TablesFolder, error_bounds
from kincal_shared.schema.dh import DH_FIELDS
from kincal_shared.schema.space import read_description
from kincal_sim.mechanics.arm import Arm
from kincal_sim.randomness import generator
from kincal_sim.scenario import ArmTruth, Scenario
from kincal_sim.vision.imagers import fast_imager
from kincal_sim.world import World

ROOT = Path(__file__).resolve().parents[2]
TABLES = ROOT / "tables" / "bin"
SPACE_TOML = ROOT / "tables" / "src" / "space.toml"
TICK_US = 100_000
SUBSTEPS = 4
MISSION_S = 7200.0  # the executive's patience
LINGER_TICKS = 30  # after the end: a stopped arm comes to rest
HELD_OUT = 100
FINISH_MIN = 0.99
START_CLEAR_M = 0.02
OUTSIDE_CLEAR_MIN = 0.999
FLIGHT = library("flight")
AT_CANDIDATE = FLIGHT.constant("KC_AT_CANDIDATE")
HUB_BOUND = FLIGHT.decimal("KC_HUB_BOUND") + 1e-6  # about hubs and local initial poses
ON_NODE_RAD = 0.002  # arm at rest within arrive_tol; the rest is rounding
IDLE, REVIEW, SAFE = (FLIGHT.constant(f"KC_ST_{name}") for name in ("IDLE", "REVIEW", "SAFE"))
START_TICK = 3  # the executive hears the first housekeeping and answers it: flight has START in this tick
KINDS_INSIDE = ("box", "alone", "box", "three", "box", "box", "box", "alone", "box", "three")
KINDS_OUTSIDE = ("slip", "few", "wide", "both")


# ---- what is wrong with the arm -------------------------------------------------------------------------


def bounds() -> dict[str, float]:
    """Bound of every DH error [rad or m], by name."""
    return error_bounds(read_description(SPACE_TOML), 7)


def paper() -> dict[str, float]:
    """The paper's set of errors."""
    return dict(read_description(SPACE_TOML).error_bounds.case[0])


def _sign(rng) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _cut(errors: dict[str, float]) -> dict[str, float]:
    return {
        k: float(np.clip(v, -np.pi, np.pi)) if k.endswith("_rad") else float(v) for k, v in errors.items()
    }


def inside(rng, kind: str) -> ArmTruth:
    """An arm with errors inside their bounds."""
    size = bounds()
    names = list(size)
    if kind == "paper":
        return ArmTruth(errors=paper())
    if kind == "box":
        return ArmTruth(errors={n: float(rng.uniform(-s, s)) for n, s in size.items()})
    chosen = rng.choice(len(names), 1 if kind == "alone" else 3, replace=False)
    share = {"alone": lambda: rng.uniform(0.5, 1.0), "three": lambda: 1.0}[kind]
    return ArmTruth(errors={names[k]: _sign(rng) * share() * size[names[k]] for k in chosen})


def outside(rng, kind: str) -> ArmTruth:
    """An arm with errors outside their bounds."""
    size = bounds()
    names = list(size)
    truth = ArmTruth()
    if kind in ("slip", "both"):
        joint = f"J{rng.integers(1, 8)}"
        least = max(1.0, 1.1 * size[f"{joint}.phi_rad"])
        truth.encoder_bias_rad = {joint: _sign(rng) * float(rng.uniform(least, 2.5))}
    if kind == "both":
        truth.errors = {n: float(rng.uniform(-s, s)) for n, s in size.items()}
    if kind == "few":
        chosen = rng.choice(len(names), rng.integers(1, 4), replace=False)
        truth.errors = _cut({names[k]: _sign(rng) * rng.uniform(1.5, 4.0) * size[names[k]] for k in chosen})
    if kind == "wide":
        factor, end = rng.uniform(1.5, 4.0), rng.integers(len(names))
        wide = {n: factor * s * rng.uniform(-1.0, 1.0) for n, s in size.items()}
        wide[names[end]] = _sign(rng) * factor * size[names[end]]
        truth.errors = _cut(wide)
    return truth


def near(arm: Arm) -> set:
    """Pairs of the arm's shapes and what is about it that are within START_CLEAR_M."""
    margin = arm.model.geom_margin.copy()
    arm.model.geom_margin[:] = START_CLEAR_M / 2  # of both geoms of a pair, added
    pairs = set(arm.collisions())
    arm.model.geom_margin[:] = margin
    return pairs


def stands_free(world: World) -> bool:
    """Nothing is near where the arm stands that is not near an arm without errors (neighbours on the arm)."""
    healthy = CheckedWorld(Scenario(name="healthy"), 1)
    return not world.arm.collisions() and near(world.arm) <= near(healthy.arm)


def sample(part: str, seed: int, run: int) -> tuple[str, ArmTruth, int]:
    """Kind, errors, and how many arms were rejected because they did not stand free."""
    kinds, make = (KINDS_INSIDE, inside) if part == "inside" else (KINDS_OUTSIDE, outside)
    kind = "paper" if part == "inside" and run == 0 else kinds[run % len(kinds)]
    rng = np.random.default_rng([seed, 0 if part == "inside" else 1, run])
    for rejected in range(1000):
        truth = make(rng, kind)
        if stands_free(CheckedWorld(Scenario(name="sampled", arm=truth), 1)):
            return kind, truth, rejected
    raise ArithmeticError(f"no arm of kind {kind} that stands free")


# ---- the world, with contacts recorded ------------------------------------------------------------------


class CheckedWorld(World):
    """The simulator's world that also checks for contact between ticks, while anything moves.

    found: contacts by pair of shapes; note: what else to record about one."""

    def __init__(self, scenario: Scenario, seed: int):
        super().__init__(scenario, seed, fast_imager)
        self.found: dict[str, dict] = {}
        self.note = dict
        self._checked = None
        self._record_contacts(*self._axes(0.0))

    def _axes(self, t_s: float):
        return self.controller.trajectory.at(t_s)[0], self.pantilt.trajectory.at(t_s)[0]

    def execute_commands(self, t_us: int) -> None:
        super().execute_commands(t_us)
        for k in range(1, SUBSTEPS + 1):
            self._record_contacts(*self._axes((t_us + k * TICK_US / SUBSTEPS) * 1e-6), t_us * 1e-6)

    def _record_contacts(self, q, pan_tilt, t_s: float = 0.0) -> None:
        at = (q.tobytes(), pan_tilt.tobytes())
        if at == self._checked:
            return
        self._checked = at
        self.stand(q, pan_tilt)
        model, data = self.arm.model, self.arm.data
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        for c in data.contact[: data.ncon] if data.ncon else ():  # seldom; the list is slow even if empty
            pair = " - ".join(sorted((model.geom(c.geom1).name, model.geom(c.geom2).name)))
            new = {"t_s": round(t_s, 1), "n": 0, "deep_m": 0.0, "q": np.round(q, 4).tolist(), **self.note()}
            contact = self.found.setdefault(pair, new)
            contact["n"] += 1
            contact["deep_m"] = max(contact["deep_m"], round(-float(c.dist), 4))


# ---- the check of commands ------------------------------------------------------------------------------


def segment_ends(table: SpaceTable) -> np.ndarray:
    """Ends of all verified segments, (n, 2) nodes: the hubs, then the poses of the table."""
    n_hub = len(table.hub_q_rad)
    ends = {(a, b) for b in range(n_hub) for a in range(b) if table.hub_edges[a] >> b & 1}
    ends |= {(int(hub), n_hub + i) for i, hub in enumerate(table.hub)}
    ends |= {(n_hub + int(j), n_hub + int(i)) for i, j in np.argwhere(table.direct)}
    return np.array(sorted(ends)).reshape(-1, 2)


class CommandCheck:
    """Says what is wrong with a command, from the contents of the tables alone.

    seed, bound (poses, n): seeds, and how far the servo may take each joint from them; hub (hubs, n); a, b
    (segments, n): ends of the verified segments, and their names."""

    def __init__(self):
        tables = TablesFolder(TABLES)
        arm, camera, table = tables.arm, tables.camera, tables.space
        self.n = int(arm.n_joints)
        joints = arm.joint[0 : self.n]
        self.lo, self.hi = np.array([j.q_min for j in joints]), np.array([j.q_max for j in joints])
        self.pantilt_lo = np.array([camera.pan_min_rad, camera.tilt_min_rad])
        self.pantilt_hi = np.array([camera.pan_max_rad, camera.tilt_max_rad])
        self.hub, self.seed = table.hub_q_rad, table.q_rad
        self.servo_bound = table.servo_bound_rad + 1e-6  # single precision
        # local poses are verified no farther than hubs
        local = (np.arange(len(self.seed)) >= table.n_candidates)[:, None]
        self.bound = np.where(local, np.minimum(self.servo_bound, HUB_BOUND), self.servo_bound)
        self._segments(table)

    def _segments(self, table: SpaceTable) -> None:
        node, ends = np.vstack([self.hub, self.seed]), segment_ends(table)
        self.a, self.b = node[ends[:, 0]], node[ends[:, 1]]
        names = [f"hub {h}" for h in range(len(self.hub))] + [f"candidate {i}" for i in range(len(self.seed))]
        self.name = [f"{names[a]} - {names[b]}" for a, b in ends]

    def joints_allowed(self, q) -> bool:
        """Whether joints are finite and inside the limits of the ARM table."""
        return bool(np.all(np.isfinite(q)) and np.all(q >= self.lo) and np.all(q <= self.hi))

    def pantilt_allowed(self, pan_tilt) -> bool:
        """Whether pan-tilt angles are inside the limits of the CAMERA table."""
        return bool(np.all(pan_tilt >= self.pantilt_lo) and np.all(pan_tilt <= self.pantilt_hi))

    def _off_segments(self, q) -> np.ndarray:
        """Distance of q to every segment (largest joint)."""
        along = self.b - self.a
        t = np.clip(np.sum((q - self.a) * along, 1) / np.maximum(np.sum(along * along, 1), 1e-12), 0.0, 1.0)
        return np.max(np.abs(self.a + t[:, None] * along - q), 1)

    def verified(self, start, goal) -> tuple[str, str]:
        """What a command was verified by; or an empty string, and how far it is from anything verified."""
        here, there = np.abs(self.seed - start), np.abs(self.seed - goal)
        inside = np.all(here <= self.bound + ON_NODE_RAD, 1) & np.all(there <= self.bound, 1)
        if np.any(inside):
            return f"bound {int(np.argmax(inside))}", ""
        if np.max(np.abs(goal - start)) <= ON_NODE_RAD:
            return "stays", ""
        off_start, off_goal = self._off_segments(start), self._off_segments(goal)
        segments = (off_start <= ON_NODE_RAD) & (off_goal <= 1e-5)
        if np.any(segments):
            return self.name[int(np.argmax(segments))], ""
        bounds = np.min(np.max(np.maximum(here, there) / self.bound, 1))
        off_rad = float(np.min(np.maximum(off_start, off_goal)))
        return "", f"nearest seed {bounds:.2f} servo bounds off, nearest segment {off_rad:.3f} rad"


# ---- one run --------------------------------------------------------------------------------------------


@dataclass
class Record:
    """What happened in a run."""

    outcome: str = ""
    verdict: str = ""
    poses: int = 0
    crc: int = 0
    coef: list = field(default_factory=list)
    unverified: list = field(default_factory=list)  # commands
    limits: list = field(default_factory=list)  # commands beyond them
    events: Counter = field(default_factory=Counter)
    commands: int = 0
    cause: int = -1
    ended: int | None = None  # tick
    mission_s: float = 0.0  # until then


def rms_m(wrong: Arm, believed: Arm, bias, rng) -> float:
    """RMS distance of two arms' tools over random postures with the true tool in the search region."""
    region = wrong.spec["region"]
    lo, hi = np.array(region["min_m"]), np.array(region["max_m"])
    found: list[float] = []
    for _ in range(100 * HELD_OUT):
        q = rng.uniform(wrong.q_min, wrong.q_max)
        wrong.set(q - bias)
        p = wrong.T_base_tool[:3, 3].copy()
        if np.all(p >= lo) and np.all(p <= hi):
            believed.set(q)
            found.append(float(np.sum((believed.T_base_tool[:3, 3] - p) ** 2)))
            if len(found) == HELD_OUT:
                break
    return float(np.sqrt(np.mean(found))) if found else float("nan")


def coefficient_errors(coef) -> dict[str, float]:
    """The DH errors among the coefficients of a correction (they come first, four a joint)."""
    return {f"J{k // 4 + 1}.{DH_FIELDS[k % 4]}": float(coef[k]) for k in range(28)}


def fly(truth: ArmTruth, seed: int, checker: CommandCheck) -> tuple[Record, CheckedWorld]:
    """One recalibration from power-up to its end."""
    scenario, record = Scenario(name="sampled", arm=truth), Record()
    world, last = CheckedWorld(scenario, seed), {"path": "", "pose": 0}
    world.note = lambda: dict(last)

    def each_tick(tick: Tick) -> bool:
        _listen(tick, record)
        for channel, m in tick.from_flight:
            _check(channel, m, world, checker, record, tick.state, last)
        if record.ended is None and tick.number >= START_TICK and tick.state in (IDLE, REVIEW, SAFE):
            record.ended = tick.number
        return record.ended is None or tick.number < record.ended + LINGER_TICKS

    ask = [(START_TICK - 1, command("START", -1, 0, seed))]
    setup = Setup(TABLES, commander=lambda send: Script(send, ask), world=lambda *_: world, limit_s=MISSION_S)
    run = simulate(scenario, seed, setup, each_tick=each_tick)
    record.outcome = _outcome(record, record.ended is not None)
    record.mission_s = run.mission_s if record.ended is None else record.ended * TICK_US * 1e-6
    return record, world


def _listen(tick: Tick, record: Record) -> None:
    """Record what flight says."""
    for channel, m in tick.from_flight:
        if channel == "KC_EVENT":
            name = event_name(m.id)
            record.events[name] += 1
            if name == "CAL_ABORTED":
                record.cause = int(m.got)
        elif channel == "KC_ACK" and m.status != 0:
            record.outcome = f"refused: {event_name(m.event_id)}"
        elif channel == "KC_MEAS" and m.taken_at == AT_CANDIDATE:
            record.poses = m.pose
        elif channel == "KC_PROPOSAL":
            record.verdict = ("no change", "change", "poor")[m.verdict]
            record.crc, record.coef = unsigned32(m.crc), list(m.value)[: m.n_coef]


def _check(
    channel: str, m, world: CheckedWorld, checker: CommandCheck, record: Record, state: int, last: dict
) -> None:
    """Record what is wrong with a command."""
    if channel == "KC_PANTILT_CMD" and not checker.pantilt_allowed(np.array([m.pan_rad, m.tilt_rad])):
        record.limits.append(f"pan-tilt {m.pan_rad:.3f} {m.tilt_rad:.3f}")
    if channel != "KC_ARM_CMD" or m.hold:
        return
    record.commands += 1
    q, here = np.array(m.q_rad[: checker.n]), world.controller.trajectory.at(world.now_us * 1e-6)[0]
    arm = world.arm
    if (
        not checker.joints_allowed(q)
        or np.any(q < arm.q_min)
        or np.any(q > arm.q_max)
        or not 0 < m.speed_scale <= 1
    ):
        record.limits.append(f"joints {np.round(q, 3).tolist()} scale {m.speed_scale}")
    path, problem = checker.verified(here, q)
    last.update(path=path or "not verified", pose=record.poses)
    if problem:
        record.unverified.append(f"{problem}; state {state}, pose {record.poses}")


def _outcome(record: Record, ended: bool) -> str:
    if record.outcome:
        return record.outcome
    if record.verdict:
        return "finished"
    if record.cause >= 0:
        names = {number: name for name, number in FLIGHT.enum("kc_cause_t", "KC_CAUSE_").items()}
        return f"aborted: {names[record.cause].lower().replace('_', ' ')}"
    return "ended without a proposal" if ended else "not finished in time"


def case(run: int, values: dict) -> dict:
    """A run by its number; part and root (of all runs) are among the values."""
    return cases.columns(one(values["part"], int(values["root"]), run))


def one(part: str, seed: int, run: int) -> dict:
    """A run by its number; everything about it."""
    kind, truth, resampled = sample(part, seed, run)
    record, world = fly(truth, 1000 * seed + run, CommandCheck())
    before_m, after_m = _errors_m(record, world, run)
    return {
        "part": part,
        "kind": kind,
        **_summary(record),
        "contacts": world.found,
        "before_m": round(before_m, 5),
        "after_m": None if after_m is None else round(after_m, 6),
        "mission_s": round(record.mission_s, 1),
        "resampled": resampled,
        "errors": {k: round(v, 5) for k, v in truth.errors.items()},
        "bias": {k: round(v, 5) for k, v in truth.encoder_bias_rad.items()},
    }


def _errors_m(record: Record, world: CheckedWorld, run: int) -> tuple[float, float | None]:
    """RMS tool position error [m] of the nominal arm, and of the corrected one if there is a correction."""
    arm, bias = world.arm, world.plant.encoders.bias_rad
    before_m = rms_m(arm, Arm(), bias, generator(run, "held out"))
    if not record.coef:
        return before_m, None
    corrected = Arm(errors=coefficient_errors(record.coef))
    return before_m, rms_m(arm, corrected, bias, generator(run, "held out"))


def _summary(record: Record) -> dict:
    return {
        "outcome": record.outcome,
        "verdict": record.verdict,
        "crc": f"{record.crc:08x}",
        "poses": record.poses,
        "commands": record.commands,
        "limits": record.limits[:5],
        "unverified": record.unverified[:5],
        "n_limits": len(record.limits),
        "n_unverified": len(record.unverified),
        "coef": [round(c, 6) for c in record.coef],
        "events": dict(sorted(record.events.items())),
    }


# ---- all of them ----------------------------------------------------------------------------------------


def table(results: list[dict], part: str) -> list[str]:
    """Counts by kind of error, and every run that something is wrong with."""
    own = [r for r in results if r["part"] == part]
    kinds = sorted({r["kind"] for r in own})
    lines = [
        f"{part}: {len(own)} runs",
        "kind    runs finished stopped contact limits unverified  left, median  cpu/run",
        *(_row(kind, [r for r in own if r["kind"] == kind]) for kind in kinds),
        _row("all", own),
    ]
    for what in ("outcome", "verdict"):
        count = Counter(r[what] for r in own if r[what])
        lines.append(f"{what}: " + ", ".join(f"{n} {k}" for k, n in count.most_common()))
    lines.append(f"sampled again because they did not stand free: {sum(r['resampled'] for r in own)}")
    return lines + _contacts(own) + _bad_commands(own)


def _row(kind: str, rows: list[dict]) -> str:
    left = [r["after_m"] for r in rows if r.get("after_m") is not None]
    finished = sum(r["outcome"] == "finished" for r in rows)
    return (
        f"{kind:<7} {len(rows):4d} {finished:8d} {len(rows) - finished:7d} "
        f"{sum(bool(r['contacts']) for r in rows):7d} {sum(r['n_limits'] > 0 for r in rows):6d} "
        f"{sum(r['n_unverified'] > 0 for r in rows):10d}  "
        f"{1e3 * np.median(left) if left else float('nan'):9.2f} mm  "
        f"{np.mean([r['cpu_s'] for r in rows]):5.2f} s"
    )


def _contacts(own: list[dict]) -> list[str]:
    pairs = Counter(pair for r in own for pair in r["contacts"])
    lines = [f"contact in {n} runs: {pair}" for pair, n in pairs.most_common(12)]
    for r in (r for r in own if r["contacts"]):
        pair, first = min(r["contacts"].items(), key=lambda x: x[1]["t_s"])
        lines.append(f"  run {r['seed']} {r['kind']}: {pair} at {first['t_s']} s, {first} ({r['outcome']})")
    return lines


def _bad_commands(own: list[dict]) -> list[str]:
    bad = (r for r in own if r["n_limits"] or r["n_unverified"])
    return [f"  run {r['seed']} {r['kind']}: {(r['limits'] + r['unverified'])[:2]}" for r in bad]


def criteria(results: list[dict]) -> dict[str, bool]:
    """What has to hold."""
    ins = [r for r in results if r["part"] == "inside"]
    out = [r for r in results if r["part"] == "outside"]
    bad = sum(r["n_limits"] + r["n_unverified"] for r in results)
    finished = sum(r["outcome"] == "finished" for r in ins)
    clear = sum(not r["contacts"] for r in out)
    found = {"no command outside limits or verified segments": bad == 0}
    if ins:
        found["inside the bounds: no contact"] = not any(r["contacts"] for r in ins)
        found[f"inside the bounds: at least {FINISH_MIN:.0%} finish"] = finished >= FINISH_MIN * len(ins)
        safe = all(r["outcome"].startswith(("finished", "aborted", "refused")) for r in ins)
        found["inside the bounds: the rest abort with a reason"] = safe
    if out:
        name = f"outside the bounds: no contact in at least {OUTSIDE_CLEAR_MIN:.1%}"
        found[name] = clear >= OUTSIDE_CLEAR_MIN * len(out)
    return found


def options(argv: list[str] | None) -> argparse.Namespace:
    """The command line."""
    p = cases.options("montecarlo", __doc__)
    p.add_argument("--runs", type=int, default=1000, help="with errors inside the bounds")
    p.add_argument("--outside", type=int, default=1000, help="with errors outside the bounds")
    p.add_argument("--seed", dest="root", type=int, default=1)
    o = p.parse_args(argv)
    o.first, o.seeds = 0, max(o.runs, o.outside)
    return o


def main(argv: list[str] | None = None) -> int:
    o = options(argv)
    number = {"inside": o.runs, "outside": o.outside}
    settings = {"root": o.root, **bounds()}  # bounds: so that runs with others are not mixed
    axes, wanted = {"part": list(number)}, lambda run, values: run < number[values["part"]]
    results = cases.fly(o, "montecarlo:case", axes, wanted, settings)
    for part in number:
        if any(r["part"] == part for r in results):
            print("\n".join(table(results, part)) + "\n")
    met = criteria(results)
    for name, good in met.items():
        print(f"{'ok  ' if good else 'FAIL'} {name}")
    return 0 if all(met.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
