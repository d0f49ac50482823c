"""Whole recalibrations of arms that are wrong, many of them: does anything touch, is any command unproven?

    python tests/bench/montecarlo.py [--runs 1000] [--outside 1000] [--seed 1] [--jobs 2] [--out FILE]

The flight core runs in this process (libkincal.so) against the simulator's arm, head and camera in the fast
mode, 100 ms a tick as in lockstep, without LCM and without processes; what goes in and out is what the edge
of the flight process passes on. One line per run goes to FILE at once; runs that are in it already are
skipped, so it can be stopped and started again. Exit status 1 if a gate fails, 2 if FILE belongs to
another flight core or other tables.

Errors drawn (run number and seed say which; the bounds are those of tables/src/space.toml [survive])
- inside: run 0 is the paper's set; then by run number in turn 6 of 10 `box`: all 28 DH errors even between
  their bounds; 2 `alone`: one error, any of them, between half its bound and the bound, either way;
  2 `three`: three errors at their bounds, either way.
- outside: in turn `slip`: an encoder of any joint that reads 1 to 2.5 rad wrong (joint 7:
  beyond its bound); `few`: one to three errors at
  1.5 to 4 times their bounds; `wide`: all 28 even in the box of 1.5 to 4 times the bounds, one of them at
  its end; `both`: a slip and all 28 inside their bounds. No angle is more than pi off.
An arm that is within 20 mm of something where it stands before anything was commanded is drawn again, and
counted: whoever parked it there saw to it that it stands free.

Judged
- contact: MuJoCo's arm with the true errors, with itself, deck, ground, mast, head: at every tick and at
  SUBSTEPS times within each while arm or head move (25 ms: a joint at full speed turns 20 mrad).
- limits: every commanded joint inside the limits of the ARM table and of the simulator's arm, every head
  angle inside the CAMERA table's.
- unproven: from the contents of the SPACE table, without flight's functions: a command is proven if where
  the arm stands (by its encoders) and where it goes lie in the servo box of one candidate, or both on one
  straight segment that the table says was proven, which it goes along.
- finished: a correction was proposed, or found not to be needed. Else: refused at START, or the cause of
  the abort. Error of the result: RMS tool position over 100 postures that were not measured, by MuJoCo.
"""

import argparse
import json
import multiprocessing
import os
import sys
import time
import zlib
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import mujoco  # noqa: E402
import numpy as np  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
for _folder in ("ground", "sim", "build/py"):
    sys.path.insert(0, str(ROOT / _folder))

from kincal import core, tables  # noqa: E402
from kincal.space import description, drawn  # noqa: E402
from kincal_sim.arm import Arm  # noqa: E402
from kincal_sim.eyes import fast_eye  # noqa: E402
from kincal_sim.scenario import ArmTruth, Scenario, generator  # noqa: E402
from kincal_sim.world import World  # noqa: E402

TABLES = ROOT / "tables" / "bin"
SPACE_TOML = ROOT / "tables" / "src" / "space.toml"
TICK_US = 100_000
SUBSTEPS = 4
MISSION_S = 7200.0  # the executive's patience
LINGER_TICKS = 30  # after the end: an arm that was stopped comes to rest
HELD_OUT = 100
FINISH_MIN = 0.99
START_CLEAR_M = 0.02
OUTSIDE_CLEAR_MIN = 0.999
FIRST_LEASH = 0.05 + 1e-6  # about first looks, KC_HUB_LEASH of kc_path.h
ON_NODE_RAD = 0.002  # arm at rest within arrive_tol; the rest is rounding
IDLE, REVIEW, SAFE = 0, 9, 11
START, EXECUTIVE = 1, 2
START_TICK = 3  # the executive hears the first housekeeping and answers it: flight has START in this tick
KINDS_INSIDE = ("box", "alone", "box", "three", "box", "box", "box", "alone", "box", "three")
KINDS_OUTSIDE = ("slip", "few", "wide", "both")


# ---- what is wrong with the arm -------------------------------------------------------------------------


def bounds() -> dict[str, float]:
    """Bound of every DH error to survive, by name."""
    return drawn.bounds(description.read_description(SPACE_TOML), 7)


def paper() -> dict[str, float]:
    return dict(description.read_description(SPACE_TOML).survive.case[0])


def _sign(rng) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _cut(errors: dict[str, float]) -> dict[str, float]:
    return {
        k: float(np.clip(v, -np.pi, np.pi)) if k.endswith("_rad") else float(v) for k, v in errors.items()
    }


def inside(rng, kind: str) -> ArmTruth:
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
    healthy = Watched(Scenario("healthy", ""), 1)
    return not world.arm.collisions() and near(world.arm) <= near(healthy.arm)


def draw(part: str, seed: int, run: int) -> tuple[str, ArmTruth, int]:
    """Kind, errors, and how often an arm that stood in something was thrown away."""
    kinds, make = (KINDS_INSIDE, inside) if part == "inside" else (KINDS_OUTSIDE, outside)
    kind = "paper" if part == "inside" and run == 0 else kinds[run % len(kinds)]
    rng = np.random.default_rng([seed, 0 if part == "inside" else 1, run])
    for again in range(1000):
        truth = make(rng, kind)
        if stands_free(Watched(Scenario("drawn", "", arm=truth), 1)):
            return kind, truth, again
    raise ArithmeticError(f"no arm of kind {kind} that stands free")


# ---- the world, watched ---------------------------------------------------------------------------------


class Watched(World):
    """The simulator's world that looks for contact much oftener, while anything moves."""

    def __init__(self, scenario: Scenario, seed: int):
        super().__init__(scenario, seed, fast_eye)
        self.hits: dict[str, dict] = {}
        self.note = dict  # what else to write down about a contact
        self._still = None
        self._look(*self._axes(0.0))

    def _axes(self, t_s: float):
        return self.controller.mover.at(t_s)[0], self.head.mover.at(t_s)[0]

    def _obey(self, t_us: int) -> None:
        super()._obey(t_us)
        for k in range(1, SUBSTEPS + 1):
            self._look(*self._axes((t_us + k * TICK_US / SUBSTEPS) * 1e-6), t_us * 1e-6)

    def _look(self, q, head, t_s: float = 0.0) -> None:
        at = (q.tobytes(), head.tobytes())
        if at == self._still:
            return
        self._still = at
        self._stand(q, head)
        model, data = self.arm.model, self.arm.data
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        for c in data.contact[: data.ncon]:
            pair = " - ".join(sorted((model.geom(c.geom1).name, model.geom(c.geom2).name)))
            new = {"t_s": round(t_s, 1), "n": 0, "deep_m": 0.0, "q": np.round(q, 4).tolist(), **self.note()}
            hit = self.hits.setdefault(pair, new)
            hit["n"] += 1
            hit["deep_m"] = max(hit["deep_m"], round(-float(c.dist), 4))


# ---- flight, in this process ----------------------------------------------------------------------------


class Flight:
    """The flight core behind the edge's door: sensor messages in, commands and telemetry out."""

    def __init__(self):
        self.app = core.ffi.addressof(core.lib, "kc_app_instance")
        self.inp, self.out = core.ffi.new("kc_in_t *"), core.ffi.new("kc_out_t *")
        core.lib.kc_app_init(self.app)
        for kind in range(1, len(tables.KINDS) + 1):
            data = (TABLES / f"{tables.KIND_NAMES[kind]}.tbl").read_bytes()
            core.check(core.lib.kc_app_load(self.app, kind, data, len(data)), f"table kind {kind}")
        core.lib.kc_app_boot(self.app)
        self.waiting: list = []  # detections come one tick after they were taken, as over the network

    def step(self, now_us: int, heard: list, command=None):
        i = self.inp
        core.ffi.memmove(i, bytes(core.ffi.sizeof(i[0])), core.ffi.sizeof(i[0]))
        for d in self.waiting:
            _detection(i.det[i.n_det], d)
            i.n_det += 1
        self.waiting = []
        for channel, m in heard:
            if channel == "KC_ARM_STATE":
                _arm(i.arm, m)
                i.has_arm = 1
            elif channel == "KC_PANTILT_STATE":
                h = i.pantilt
                h.t_us, h.seq, h.pan_rad, h.tilt_rad, h.moving = (
                    m.t_us,
                    m.seq,
                    m.pan_rad,
                    m.tilt_rad,
                    m.moving,
                )
                i.has_pantilt = 1
            elif channel == "KC_DETECTION":
                self.waiting.append(m)
        if command is not None:
            i.n_cmd = 1
            core.fill(i.cmd[0], command)
        core.lib.kc_app_step(self.app, now_us, i, self.out)
        return self.out

    @property
    def state(self) -> int:
        return int(core.lib.kc_app_state(self.app))


def _arm(s, m) -> None:
    s.t_us, s.seq, s.n_joints = m.t_us, m.seq, m.n_joints
    s.q, s.dq, s.q_cmd, s.dir = m.q_rad, m.dq_rad_s, m.q_cmd_rad, m.dir
    s.moving, s.fault_mask = m.moving, m.fault_mask
    s.temp_c, s.payload_kg, s.g_m_s2 = m.temp_c, m.payload_kg, m.g_m_s2


def _detection(d, m) -> None:
    for name in ("t_us", "seq", "n_tags", "tag_id", "p_cam_tool_m", "p_alt_m", "q_alt_wxyz", "rms_px"):
        setattr(d, name, getattr(m, name))
    for name in ("q_cam_tool_wxyz", "rms_alt_px", "range_m", "incid_rad", "u_px", "v_px", "corner_px"):
        setattr(d, name, getattr(m, name))
    cov = np.zeros((6, 6))
    cov[np.triu_indices(6)] = m.cov
    d.cov = (cov + np.triu(cov, 1).T).ravel().tolist()


class Message:
    """A command on its way to the simulator."""

    def __init__(self, **fields):
        self.__dict__.update(fields)


def commands(out) -> list[tuple[str, Message]]:
    found = []
    if out.has_arm_cmd:
        c = out.arm_cmd
        n, q = int(c.n_joints), list(c.q)
        m = Message(seq=c.seq, n_joints=n, q_rad=q, speed_scale=c.speed_scale, hold=c.hold)
        found.append(("KC_ARM_CMD", m))
    if out.has_pantilt_cmd:
        c = out.pantilt_cmd
        found.append(("KC_PANTILT_CMD", Message(seq=c.seq, pan_rad=c.pan_rad, tilt_rad=c.tilt_rad)))
    if out.has_frame_request:
        found.append(("KC_FRAME_REQUEST", Message(seq=out.frame_seq)))
    return found


# ---- the judge of commands ------------------------------------------------------------------------------


class Judge:
    """Says what is wrong with a command, from the contents of the tables alone."""

    def __init__(self):
        _, arm = tables.load(TABLES / "arm.tbl")
        _, camera = tables.load(TABLES / "camera.tbl")
        _, space = tables.load(TABLES / "space.tbl")
        self.n = int(arm.n_joints)
        self.lo = np.array([arm.joint[j].q_min for j in range(self.n)])
        self.hi = np.array([arm.joint[j].q_max for j in range(self.n)])
        self.head_lo = np.array([camera.pan_min_rad, camera.tilt_min_rad])
        self.head_hi = np.array([camera.pan_max_rad, camera.tilt_max_rad])
        n_hub, n_cand = int(space.n_hub), int(space.n_cand)
        self.hub = np.array([list(space.hub_q[h])[: self.n] for h in range(n_hub)])
        self.seed = np.array([list(space.cand[i].q_seed)[: self.n] for i in range(n_cand)])
        leash = space.servo_leash  # one for all joints, or one each
        leash = [leash] * self.n if isinstance(leash, float) else list(leash)[: self.n]
        self.leash = np.array(leash) + 1e-6  # single precision
        first = np.array([[c.why >> 15 & 1] for c in space.cand[0:n_cand]])  # proven no farther than hubs
        self.box = np.where(first, np.minimum(self.leash, FIRST_LEASH), self.leash)
        # Segments by their ends: nodes are the hubs, then the candidates.
        self.node = np.vstack([self.hub, self.seed])
        ends = {(a, b) for a in range(n_hub) for b in range(n_hub) if space.hub_edge[a] >> b & 1 and a < b}
        ends |= {(int(space.cand[i].hub), n_hub + i) for i in range(n_cand)}
        bit = np.unpackbits(np.frombuffer(core.ffi.buffer(space.edge), np.uint8), bitorder="little")
        i, j = np.tril_indices(n_cand, -1)
        joined = bit[i * (i - 1) // 2 + j] == 1
        ends |= set(zip((n_hub + j[joined]).tolist(), (n_hub + i[joined]).tolist(), strict=True))
        ends = np.array(sorted(ends)).reshape(-1, 2)
        self.a, self.b = self.node[ends[:, 0]], self.node[ends[:, 1]]
        names = [f"hub {h}" for h in range(n_hub)] + [f"candidate {i}" for i in range(n_cand)]
        self.name = [f"{names[a]} - {names[b]}" for a, b in ends]

    def limits(self, q) -> bool:
        return bool(np.all(np.isfinite(q)) and np.all(q >= self.lo) and np.all(q <= self.hi))

    def head(self, pan_tilt) -> bool:
        return bool(np.all(pan_tilt >= self.head_lo) and np.all(pan_tilt <= self.head_hi))

    def _along(self, q) -> np.ndarray:
        """Distance of q to every segment (largest joint)."""
        way = self.b - self.a
        t = np.clip(np.sum((q - self.a) * way, 1) / np.maximum(np.sum(way * way, 1), 1e-12), 0.0, 1.0)
        return np.max(np.abs(self.a + t[:, None] * way - q), 1)

    def proven(self, start, goal) -> tuple[str, str]:
        """What proves a command, or an empty string and how far it is from anything proven."""
        here, there = np.abs(self.seed - start), np.abs(self.seed - goal)
        boxes = np.all(here <= self.box + ON_NODE_RAD, 1) & np.all(there <= self.box, 1)
        if np.any(boxes):
            return f"box {int(np.argmax(boxes))}", ""
        if np.max(np.abs(goal - start)) <= ON_NODE_RAD:
            return "stays", ""
        off_start, off_goal = self._along(start), self._along(goal)
        lines = (off_start <= ON_NODE_RAD) & (off_goal <= 1e-5)
        if np.any(lines):
            return self.name[int(np.argmax(lines))], ""
        box = np.min(np.max(np.maximum(here, there) / self.box, 1))
        line = float(np.min(np.maximum(off_start, off_goal)))
        return "", f"nearest box {box:.2f} leashes, nearest segment {line:.3f} rad"


# ---- one run --------------------------------------------------------------------------------------------


@dataclass
class Story:
    """What happened in a run."""

    outcome: str = ""
    verdict: str = ""
    poses: int = 0
    crc: int = 0
    coef: list = field(default_factory=list)
    ends: list = field(default_factory=list)  # bad commands
    limits: list = field(default_factory=list)
    events: Counter = field(default_factory=Counter)
    commands: int = 0
    cause: int = -1


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
    return {f"J{k // 4 + 1}.{drawn.FIELDS[k % 4]}": float(coef[k]) for k in range(28)}


def fly(truth: ArmTruth, seed: int, judge: Judge) -> tuple[Story, Watched]:
    """One recalibration from power-up to its end."""
    world, flight, story = Watched(Scenario("drawn", "", arm=truth), seed), Flight(), Story()
    last = {"way": "", "pose": 0}
    world.note = lambda: dict(last)
    ask = {"seq": 1, "source": EXECUTIVE, "opcode": START, "arg_i": [-1, 0, seed, 0]}
    ended, tick, stop = None, 0, int(MISSION_S * 1e6 / TICK_US)
    while tick < stop and (ended is None or tick < ended + LINGER_TICKS):
        tick += 1
        now_us = tick * TICK_US
        heard = world.step(now_us)
        out = flight.step(now_us, heard, ask if tick == START_TICK else None)
        _listen(out, story)
        sent = commands(out)
        for channel, m in sent:
            world.take(channel, m)
            _judge(channel, m, world, judge, story, flight, last)
        if ended is None and tick >= START_TICK and flight.state in (IDLE, REVIEW, SAFE):
            ended = tick
    story.outcome = _outcome(story, ended is not None)
    world.mission_s = (ended or tick) * TICK_US * 1e-6
    return story, world


def _listen(out, story: Story) -> None:
    for k in range(out.events.n):
        e = out.events.e[k]
        name = core.ffi.string(core.lib.kc_event_name(e.id)).decode()
        story.events[name] += 1
        if name == "CAL_ABORTED":
            story.cause = int(e.got)
    if out.n_ack and out.ack[0].status != 0:
        name = core.ffi.string(core.lib.kc_event_name(out.ack[0].event_id)).decode()
        story.outcome = f"refused: {name}"
    if out.has_meas:
        story.poses += 1
    if out.has_proposal:
        p = out.proposal
        story.verdict = ("no change", "change", "poor")[p.verdict]
        story.crc = int(p.crc)
        story.coef = list(p.kin.value)[: p.kin.n_coef]


def _judge(channel: str, m, world: Watched, judge: Judge, story: Story, flight: Flight, last: dict) -> None:
    if channel == "KC_PANTILT_CMD" and not judge.head(np.array([m.pan_rad, m.tilt_rad])):
        story.limits.append(f"head {m.pan_rad:.3f} {m.tilt_rad:.3f}")
    if channel != "KC_ARM_CMD" or m.hold:
        return
    story.commands += 1
    q, here = np.array(m.q_rad[: judge.n]), world.controller.mover.at(world.now_us * 1e-6)[0]
    arm = world.arm
    if not judge.limits(q) or np.any(q < arm.q_min) or np.any(q > arm.q_max) or not 0 < m.speed_scale <= 1:
        story.limits.append(f"joints {np.round(q, 3).tolist()} scale {m.speed_scale}")
    way, problem = judge.proven(here, q)
    last.update(way=way or "unproven", pose=story.poses)
    if problem:
        story.ends.append(f"{problem}; state {flight.state}, pose {story.poses}")


def _outcome(story: Story, ended: bool) -> str:
    if story.outcome:
        return story.outcome
    if story.verdict:
        return "finished"
    if story.cause >= 0:
        names = core.ffi.typeof("kc_cause_t").elements
        return f"aborted: {names[story.cause].removeprefix('KC_CAUSE_').lower().replace('_', ' ')}"
    return "ended without a proposal" if ended else "not finished in time"


def one(job: tuple[str, int, int]) -> dict:
    """A run by its number; everything about it as a line of the file."""
    part, seed, run = job
    cpu = time.process_time()
    kind, truth, again = draw(part, seed, run)
    story, world = fly(truth, 1000 * seed + run, Judge())
    rng = generator(run, "held out")
    bias = world.truth.bias_rad
    off = rms_m(world.arm, Arm(), bias, generator(run, "held out"))
    left = rms_m(world.arm, Arm(errors=coefficient_errors(story.coef)), bias, rng) if story.coef else None
    return {
        "part": part,
        "run": run,
        "kind": kind,
        "outcome": story.outcome,
        "verdict": story.verdict,
        "crc": f"{story.crc:08x}",
        "poses": story.poses,
        "commands": story.commands,
        "contacts": world.hits,
        "limits": story.limits[:5],
        "unproven": story.ends[:5],
        "n_limits": len(story.limits),
        "n_unproven": len(story.ends),
        "before_m": round(off, 5),
        "after_m": None if left is None else round(left, 6),
        "mission_s": round(world.mission_s, 1),
        "cpu_s": round(time.process_time() - cpu, 2),
        "drawn_again": again,
        "errors": {k: round(v, 5) for k, v in truth.errors.items()},
        "bias": {k: round(v, 5) for k, v in truth.encoder_bias_rad.items()},
        "coef": [round(c, 6) for c in story.coef],
        "events": dict(sorted(story.events.items())),
    }


# ---- all of them ----------------------------------------------------------------------------------------


def head_line(seed: int) -> dict:
    """What a file of runs belongs to."""
    crc = {p.stem: tables.load(p)[0].crc_text for p in sorted(TABLES.glob("*.tbl"))}
    library = next(f / core.LIBRARY for f in core.folders() if (f / core.LIBRARY).is_file())
    flight = f"{zlib.crc32(library.read_bytes()):08x}"
    return {"seed": seed, "bounds": bounds(), "tables": crc, "flight": flight}


class OtherTables(ValueError):
    """The file holds runs of another flight core, other tables or bounds, or another seed."""


def done(path: Path, head: dict) -> list[dict]:
    """Runs in the file; makes it if there is none. A line that was cut off is dropped."""
    if not path.exists() or not path.read_text().strip():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(head) + "\n")
        return []
    first, *lines = path.read_text().splitlines()
    if json.loads(first) != head:
        raise OtherTables(f"{path} belongs to another flight core, other tables or bounds, or another seed")
    found = []
    for line in lines:
        try:
            found.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    path.write_text("".join(json.dumps(x) + "\n" for x in (head, *found)))
    return found


def run_all(jobs: list[tuple[str, int, int]], processes: int, path: Path, known: list[dict]) -> list[dict]:
    """Fly what is missing, a line each as it comes."""
    have = {(r["part"], r["run"]) for r in known}
    todo = [j for j in jobs if (j[0], j[2]) not in have]
    results = [r for r in known if (r["part"], r["run"]) in {(j[0], j[2]) for j in jobs}]
    start = time.monotonic()
    with open(path, "a") as file, multiprocessing.get_context("spawn").Pool(processes) as pool:
        for k, r in enumerate(pool.imap_unordered(one, todo), 1):
            file.write(json.dumps(r) + "\n")
            file.flush()
            results.append(r)
            if k % 20 == 0 or k == len(todo):
                took = time.monotonic() - start
                left = took / k * (len(todo) - k)
                print(f"{k}/{len(todo)} runs, {took:.0f} s, {left:.0f} s to go", file=sys.stderr, flush=True)
    return results


def table(results: list[dict], part: str) -> list[str]:
    """Counts by kind of error."""
    own = [r for r in results if r["part"] == part]
    kinds = sorted({r["kind"] for r in own}) + ["all"]
    lines = [
        f"{part}: {len(own)} runs",
        "kind    runs finished stopped contact limits unproven  left, median  cpu/run",
    ]
    for kind in kinds:
        rows = [r for r in own if kind in ("all", r["kind"])]
        left = [r["after_m"] for r in rows if r["after_m"] is not None]
        lines.append(
            f"{kind:<7} {len(rows):4d} {sum(r['outcome'] == 'finished' for r in rows):8d} "
            f"{sum(r['outcome'] != 'finished' for r in rows):7d} {sum(bool(r['contacts']) for r in rows):7d} "
            f"{sum(r['n_limits'] > 0 for r in rows):6d} {sum(r['n_unproven'] > 0 for r in rows):8d}  "
            f"{1e3 * np.median(left) if left else float('nan'):9.2f} mm  "
            f"{np.mean([r['cpu_s'] for r in rows]):5.2f} s"
        )
    for what in ("outcome", "verdict"):
        count = Counter(r[what] for r in own if r[what])
        lines.append(f"{what}: " + ", ".join(f"{n} {k}" for k, n in count.most_common()))
    lines.append(f"drawn again because they stood in something: {sum(r['drawn_again'] for r in own)}")
    pairs = Counter(pair for r in own for pair in r["contacts"])
    lines += [f"touched in {n} runs: {pair}" for pair, n in pairs.most_common(12)]
    for r in (r for r in own if r["contacts"]):
        pair, hit = min(r["contacts"].items(), key=lambda x: x[1]["t_s"])
        lines.append(f"  run {r['run']} {r['kind']}: {pair} at {hit['t_s']} s, {hit} ({r['outcome']})")
    for r in (r for r in own if r["n_limits"] or r["n_unproven"]):
        lines.append(f"  run {r['run']} {r['kind']}: {(r['limits'] + r['unproven'])[:2]}")
    return lines


def gates(results: list[dict]) -> dict[str, bool]:
    """What has to hold."""
    ins = [r for r in results if r["part"] == "inside"]
    out = [r for r in results if r["part"] == "outside"]
    bad = sum(r["n_limits"] + r["n_unproven"] for r in results)
    finished = sum(r["outcome"] == "finished" for r in ins)
    clear = sum(not r["contacts"] for r in out)
    found = {"no command outside limits or proven segments": bad == 0}
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
    p = argparse.ArgumentParser(prog="montecarlo.py", description=__doc__.split("\n")[0])
    p.add_argument("--runs", type=int, default=1000, help="with errors inside the bounds")
    p.add_argument("--outside", type=int, default=1000, help="with errors outside the bounds")
    p.add_argument("--seed", type=int, default=1)
    p.add_argument("--jobs", type=int, default=2, help="processes")
    p.add_argument("--out", type=Path, default=ROOT / "build" / "montecarlo.jsonl")
    return p.parse_args(argv)


def main(argv: list[str] | None = None) -> int:
    o = options(argv)
    try:
        known = done(o.out, head_line(o.seed))
    except OtherTables as e:
        print(e, file=sys.stderr)
        return 2
    jobs = [("inside", o.seed, k) for k in range(o.runs)] + [("outside", o.seed, k) for k in range(o.outside)]
    results = run_all(jobs, o.jobs, o.out, known)
    for part in ("inside", "outside"):
        if any(r["part"] == part for r in results):
            print("\n".join(table(results, part)) + "\n")
    held = gates(results)
    for name, good in held.items():
        print(f"{'ok  ' if good else 'FAIL'} {name}")
    return 0 if all(held.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
