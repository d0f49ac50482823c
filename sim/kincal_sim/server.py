"""The simulator process: owns mission time, moves the arm and the head, takes the frames.

    python -m kincal_sim.server --scenario paper --url udpm://239.255.76.67:7667?ttl=0 --seed 1 --out DIR

In lockstep it ends when the executive leaves; exit status 0. Status 3: mission time limit, 4: somebody
stopped answering.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import kcm

from .bus import LEAVE, Bus
from .eyes import Darkroom, fast_eye, pixel_eye
from .scenario import load
from .world import World

TICK_US = 100_000
REPEAT_S = 1.0  # wall time after which a tick is announced again
REPEATS_MAX = 120  # then whoever is silent is taken for dead
START_WAIT_S = 60.0
COMMANDS = ("KC_ARM_CMD", "KC_PANTILT_CMD", "KC_FRAME_REQUEST")
WHO = {
    "fsw": kcm.tick_done_t.WHO_FSW,
    "detector": kcm.tick_done_t.WHO_DETECTOR,
    "executive": kcm.tick_done_t.WHO_EXECUTIVE,
}
EXIT_TIME_LIMIT, EXIT_SILENT = 3, 4


class Silent(RuntimeError):
    """A participant did not answer."""


class Lockstep:
    """Time as fast as everybody can follow: the next tick comes when all have done this one."""

    def __init__(self, bus: Bus, who: set[int]):
        self.bus, self.who = bus, set(who)
        self.done: dict[int, int] = {}
        self.left: set[int] = set()
        bus.listen("KC_TICK_DONE", self._on_done)

    def _on_done(self, _: str, m) -> None:
        if m.tick == LEAVE:
            self.left.add(m.who)
        else:
            self.done[m.who] = max(m.tick, self.done.get(m.who, -1))

    def _waiting(self, tick: int) -> set[int]:
        return {w for w in self.who - self.left if self.done.get(w, -1) < tick}

    def wait_all_here(self) -> None:
        """Until every participant announced itself."""
        deadline = time.monotonic() + START_WAIT_S
        while self._waiting(0):
            self.bus.wait(0.5)
            if time.monotonic() > deadline:
                raise Silent(f"after {START_WAIT_S:g} s nothing was heard of {self._names(0)}")

    def tick(self, tick: int, now_us: int) -> None:
        """Announce a tick and wait until all have done it; repeated, because datagrams can get lost."""
        t = kcm.time_t()
        t.tick, t.now_us = tick, now_us
        for _ in range(REPEATS_MAX):
            self.bus.publish("KC_TIME", t)
            deadline = time.monotonic() + REPEAT_S
            while self._waiting(tick) and (left := deadline - time.monotonic()) > 0.0:
                self.bus.wait(left)
            if not self._waiting(tick):
                return
        raise Silent(f"tick {tick} was not answered by {self._names(tick)}")

    def _names(self, tick: int) -> str:
        return ", ".join(name for name, w in WHO.items() if w in self._waiting(tick))


def run_lockstep(world: World, bus: Bus, who: set[int], limit_s: float) -> int:
    """Step until the executive leaves. Nothing is published after that, so the last telemetry is
    the same in every run."""
    clock = Lockstep(bus, who)
    clock.wait_all_here()
    tick = 0
    while WHO["executive"] not in clock.left:
        tick += 1
        now_us = tick * TICK_US
        if now_us > limit_s * 1e6:
            print(f"mission time limit of {limit_s:g} s reached", file=sys.stderr)
            return EXIT_TIME_LIMIT
        for channel, message in world.step(now_us):
            bus.publish(channel, message)
        clock.tick(tick, now_us)
    return 0


def run_realtime(world: World, bus: Bus, darkroom: Darkroom, limit_s: float) -> int:
    """Step at 10 Hz of the wall clock and wait for nobody; ends when the executive leaves."""
    gone: list[int] = []
    bus.listen("KC_TICK_DONE", lambda _, m: gone.append(m.who) if m.tick == LEAVE else None)
    start = due = time.monotonic()
    while WHO["executive"] not in gone:
        due = max(due + TICK_US * 1e-6, time.monotonic() - 1.0)
        while (left := due - time.monotonic()) > 0.0:
            bus.wait(left)
        if due - start > limit_s:
            print(f"time limit of {limit_s:g} s reached", file=sys.stderr)
            return EXIT_TIME_LIMIT
        now_us = time.time_ns() // 1000
        for channel, message in world.step(now_us) + darkroom.finished(now_us, world.moved_us):
            bus.publish(channel, message)
    return 0


def options(argv: list[str] | None) -> argparse.Namespace:
    p = argparse.ArgumentParser(prog="python -m kincal_sim.server", description=__doc__.split("\n")[0])
    p.add_argument("--scenario", required=True, help="name or file")
    p.add_argument("--url", required=True, help="LCM URL")
    p.add_argument("--seed", type=int, default=1)
    p.add_argument("--out", type=Path, required=True, help="folder for truth.json and touched.json")
    eye = p.add_mutually_exclusive_group()
    eye.add_argument("--pixels", action="store_true", help="publish frames (default)")
    eye.add_argument("--fast", action="store_true", help="publish detections without drawing anything")
    p.add_argument("--realtime", action="store_true", help="wall clock instead of lockstep")
    p.add_argument(
        "--participants",
        default="",
        help="who answers ticks, by comma (default: fsw, executive and with pixels the detector)",
    )
    p.add_argument(
        "--limit", type=float, default=0.0, help="mission time limit [s] (default: the scenario's)"
    )
    return p.parse_args(argv)


def main(argv: list[str] | None = None) -> int:
    o = options(argv)
    scenario = load(o.scenario)
    eye = fast_eye if o.fast else pixel_eye
    darkroom = Darkroom(eye)
    world = World(scenario, o.seed, darkroom.eye if o.realtime else eye)
    o.out.mkdir(parents=True, exist_ok=True)
    mode = "fast" if o.fast else "pixels"
    (o.out / "truth.json").write_text(json.dumps(world.truth_record(mode), indent=1) + "\n")
    bus = Bus(o.url)
    for channel in COMMANDS:
        bus.listen(channel, world.take)
    # A little longer than the executive waits itself, which then aborts in good order.
    limit_s = o.limit or scenario.executive.total_timeout_s + 60.0
    try:
        return _run(o, world, bus, darkroom, limit_s)
    finally:
        (o.out / "touched.json").write_text(json.dumps(world.touched, indent=1) + "\n")


def _run(o: argparse.Namespace, world: World, bus: Bus, darkroom: Darkroom, limit_s: float) -> int:
    if o.realtime:
        return run_realtime(world, bus, darkroom, limit_s)
    names = (
        o.participants.split(",")
        if o.participants
        else ["fsw", "executive"] + ([] if o.fast else ["detector"])
    )
    try:
        return run_lockstep(world, bus, {WHO[name] for name in names}, limit_s)
    except Silent as e:
        print(f"lockstep ended: {e}", file=sys.stderr)
        return EXIT_SILENT


if __name__ == "__main__":
    sys.exit(main())
