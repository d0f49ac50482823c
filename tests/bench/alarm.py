"""From the alarm of the monitor to a calibrated arm: how many poses?

    python tests/bench/alarm.py [--cases one two wrong] [--seeds 40] [--first 2001] [--plain] [--out FOLDER]

Somebody operates the arm and takes frames at candidates until the monitor names joints; the arm goes to the
park pose, and START asks for a calibration from what is suspected (--plain: without, to compare).
All poses that this calibration visits count, the local initial ones too. Truth and comparison are MuJoCo's
(study.py).

Cases
- one: the encoder of a joint slipped, by 0.3 to the whole of its error bound
- two: those of two joints did
- left: one slipped, and every DH error is off by what a calibration leaves (normal, 0.1 mrad and 0.05 mm)
- bent, other, healthy: the suspicion is wrong. While the monitor observes, the encoder of a joint is off as
  in `one`; from START on it is right again, and instead a link is bent, turned or longer (alpha, a, d of a
  joint, by 0.3 to the whole of its bound), the encoder of another joint is off, or nothing is
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import cases
import numpy as np
import study

import kcm
from kincal.flight import event_name
from kincal.flight import tables as codec
from kincal.run.inprocess import TABLES, Setup, Simulation, Tick
from kincal_shared.schema.errors import read_toml
from kincal_sim.randomness import generator
from kincal_sim.scenario import ArmTruth, Scenario, load
from kincal_sim.vision.imagers import fast_imager
from kincal_sim.world import World

CASES = ("one", "two", "left", "bent", "other", "healthy")
BOUND = read_toml(study.ROOT / "tables" / "src" / "space.toml")["error_bounds"]
SPACE = codec.decode_as("space", (TABLES / "space.tbl").read_bytes())[1]
TICK_US, SETTLE_TICKS, FRAME_TICKS = 100_000, 6, 5
OBSERVATIONS_MAX, POSES = 12, 4  # before the alarm; besides the local initial poses
LIMIT_MM, LIMIT_MRAD = 1.0, 5.0
LEFT = {"phi_rad": 1e-4, "alpha_rad": 1e-4, "a_m": 5e-5, "d_m": 5e-5}


def scenarios_of(case: str, seed: int) -> tuple[Scenario, Scenario, list[int]]:
    """The arm while the monitor observes it, the arm from START on, and the joints (from 0) off at first."""
    rng = generator(seed, f"alarm {case}")
    size = lambda bound: float(rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 1.0) * bound)  # noqa: E731
    joints = [int(j) for j in rng.choice(7, 2, replace=False)]
    off = sorted(joints) if case == "two" else joints[:1]
    slipped = _arm(case, {f"J{j + 1}": size(_bound("phi_rad", j)) for j in off})
    if case == "left":
        left = {f"J{j}.{name}": float(rng.normal(0, s)) for j in range(1, 8) for name, s in LEFT.items()}
        slipped = _arm(case, dict(slipped.arm.encoder_bias_rad), left)
    if case in ("one", "two", "left"):
        return slipped, slipped, off
    bias, errors = {}, {}
    if case == "other":
        bias = {f"J{joints[1] + 1}": size(_bound("phi_rad", joints[1]))}
    elif case == "bent":
        name = str(rng.choice(["alpha_rad", "a_m", "d_m"]))
        errors = {f"J{joints[1] + 1}.{name}": size(_bound(name, joints[1]))}
    return slipped, _arm(case, bias, errors), off


def _arm(case: str, bias: dict[str, float], errors: dict[str, float] | None = None) -> Scenario:
    arm = ArmTruth(encoder_bias_rad=bias, errors=errors or {})
    return load("healthy").model_copy(deep=True, update={"name": case, "arm": arm})


def _bound(name: str, joint: int) -> float:
    given = BOUND[name]
    return float(given[joint] if isinstance(given, list) else given)


class Operation:
    """Normal operation, then the calibration. Ends with the calibration."""

    channels = ("KC_EVENT",)
    quiet_until_us = 0

    def __init__(self, send: Any, world: list[World], start: Any) -> None:
        self._send, self._world, self._start = send, world, start
        self._steps = self._plan()
        self._wait, self._seq, self.alarm, self.observed = 20, 0, "", 0
        self.started = False

    def tick(self, _now_us: int, messages: list[Any], /) -> bool:
        for channel, m in messages:
            if channel == "KC_EVENT" and event_name(m.id) in (
                "MON_SUSPECT",
                "MON_SEVERAL",
                "MON_UNEXPLAINED",
            ):
                self.alarm = event_name(m.id)
        self._wait -= 1
        if self._wait <= 0:
            self._wait = next(self._steps, 10**9)
        return True

    def _plan(self) -> Any:
        """Steps of the operation; each gives the ticks to wait."""
        while self.observed < OBSERVATIONS_MAX and self.alarm not in ("MON_SUSPECT", "MON_SEVERAL"):
            cand = SPACE.cand[(17 + 7 * self.observed) % SPACE.n_cand]
            self.observed += 1
            self._to_world(
                "KC_PANTILT_CMD", kcm.pantilt_cmd_t(), pan_rad=cand.pan_rad, tilt_rad=cand.tilt_rad
            )
            yield from self._go(SPACE.hub_q[cand.hub][0:7])
            yield from self._go(cand.q_seed[0:7])
            self._to_world("KC_FRAME_REQUEST", kcm.frame_request_t())
            yield FRAME_TICKS
            yield from self._go(SPACE.hub_q[cand.hub][0:7])
        yield from self._go(SPACE.hub_q[0][0:7])
        self.started = True
        self._start(self._send)

    def _to_world(self, channel: str, message: Any, **fields: Any) -> None:
        self._seq += 1
        message.seq = self._seq
        for name, value in fields.items():
            setattr(message, name, value)
        self._world[0].receive(channel, message)

    def _go(self, q: Any) -> Any:
        self._to_world(
            "KC_ARM_CMD", kcm.arm_cmd_t(), n_joints=7, q_rad=[*map(float, q), 0.0], speed_scale=1.0
        )
        yield 3
        while self._world[0].last_motion_us >= self._world[0].now_us - TICK_US:
            yield 1
        yield SETTLE_TICKS


def case(seed: int, values: dict[str, Any]) -> dict[str, Any]:
    """From power-up to the end of the calibration, as columns."""
    case, plain = values["case"], values["plain"]
    before, scenario, slipped = scenarios_of(case, seed)
    witness, world, events = study.Witness(scenario, seed), [], Counter()
    named: dict[str, Any] = {}

    def made(s: Scenario, n: int) -> World:
        world.append(World(s, n, fast_imager))
        return world[0]

    def start(send: Any) -> None:
        suspects = 0 if plain or operation[0].alarm not in ("MON_SUSPECT", "MON_SEVERAL") else 1
        become(world[0], World(scenario, seed, fast_imager))
        m = kcm.cmd_t()
        m.t_us, m.seq, m.source, m.opcode = world[0].now_us, 1, kcm.cmd_t.SRC_EXECUTIVE, kcm.cmd_t.START
        m.arg_i = [-1, POSES, seed, suspects]
        named["suspects"] = suspects
        send(m)

    operation: list[Operation] = []

    def commander(send: Any) -> Operation:
        operation.append(Operation(send, world, start))
        return operation[0]

    def see(tick: Tick) -> bool:
        for channel, m in tick.from_flight:
            if channel == "KC_EVENT":
                events[event_name(m.id)] += 1
            if channel == "KC_HK" and not operation[0].started:
                named["chance"] = [round(float(p), 4) for p in m.mon_chance]
        return witness.see(tick)

    settings = study.settings_text({"n_poses": POSES})
    setup = Setup(tables=study.tables_of("paper", settings), commander=commander, world=made, limit_s=1500.0)
    with Simulation(before, seed, setup) as simulation:
        while (tick := simulation.step()) is not None:
            if not see(tick):
                simulation.stop()
        run = simulation.result()
    entries = witness.entries
    proposal = run.log.last_session.proposal if run.log.last_session else None
    chance = named.get("chance", [0.0] * 8)
    return cases.columns({
        "slipped": slipped, "end": witness.end,
        "alarm": operation[0].alarm, "observed": operation[0].observed, "chance": chance, **named,
        "dropped": events["CAL_SUSPECTS_DROPPED"], "doubt": events["CAL_DOUBT"],
        "mismatch": events["CAL_MODEL_MISMATCH"], "visits": [e["visits"] for e in entries],
        "seconds": [e["seconds"] for e in entries],
        "mm": [e["mm"] for e in entries], "mrad": [e["mrad"] for e in entries], "contacts": run.contacts,
        "pred_mm": 1e3 * proposal.pred_pos_m if proposal else None,
        "p_fit": proposal.p_fit if proposal else None, "rank": proposal.rank if proposal else None,
    })  # fmt: skip


def become(world: World, other: World) -> None:
    """The same place and time, with the arm of another world."""
    world.plant, world.arm, world.imager = other.plant, other.arm, other.imager


def until_good(line: dict[str, Any]) -> float:
    """Visits until the held-out error stays within the limits; infinite: it does not."""
    good = [mm <= LIMIT_MM and mrad <= LIMIT_MRAD for mm, mrad in zip(line["mm"], line["mrad"], strict=True)]
    bad = [i for i, g in enumerate(good) if not g]
    first = bad[-1] + 1 if bad else 0
    return line["visits"][first] if first < len(good) else np.inf


def summary(lines: list[dict[str, Any]]) -> None:
    """A row for each case."""
    print("| case | runs | named right | visits: median / p90 | dropped | end | error [mm] | contacts |")
    for case, plain in sorted({(x["case"], x["plain"]) for x in lines}):
        these = [x for x in lines if (x["case"], x["plain"]) == (case, plain)]
        median, p90 = np.percentile([until_good(x) for x in these], [50, 90], method="inverted_cdf")
        right = [list(np.flatnonzero(np.array(x["chance"]) > 0.5)) == x["slipped"] for x in these]
        row = (
            f"{case}{' plain' if plain else ''}",
            len(these),
            sum(right),
            f"{median:g} / {p90:g}",
            sum(x["dropped"] > 0 for x in these),
            dict(Counter(x["end"] for x in these)),
            f"{max(x['mm'][-1] for x in these):.2f}",
            sum(bool(x["contacts"]) for x in these),
        )
        print("| " + " | ".join(map(str, row)) + " |")


def main() -> None:
    p = cases.options("alarm", __doc__, seeds=40, first=2001)
    p.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    p.add_argument("--plain", action="store_true", help="START without the suspects")
    o = p.parse_args()
    axes = {"case": CASES, "plain": [False, True]}
    wanted = lambda _seed, v: v["case"] in o.cases and v["plain"] == o.plain  # noqa: E731
    summary(cases.fly(o, "alarm:case", axes, wanted))


if __name__ == "__main__":
    main()
