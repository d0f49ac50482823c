"""The simulator process: owns mission time, moves the arm and the pan-tilt unit, takes the frames.

    python -m kincal_sim.server --scenario paper --url udpm://239.255.76.67:7667?ttl=0 --seed 1 --out DIR

In lockstep it ends when the executive leaves; exit status 0. Status 3: mission time limit, 4: a participant
stopped answering.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import kcm

from . import outputs
from .bus import Bus
from .lockstep import LEAVE, WHO, LockstepClock, ParticipantTimeout
from .scenario import Scenario, load
from .truth import truth_record
from .vision.imagers import BackgroundImager, fast_imager, pixel_imager
from .world import World

TICK_US = 100_000
BEHIND_MAX_S = 1.0  # in real time, what is farther behind is not caught up
PATIENCE_S = 60.0  # longer than the executive, which then aborts in good order
COMMANDS = ("KC_ARM_CMD", "KC_PANTILT_CMD", "KC_FRAME_REQUEST")
EXIT_TIME_LIMIT, EXIT_TIMEOUT = 3, 4


class TimeLimit(RuntimeError):
    """Mission time is over."""


def run_lockstep(world: World, bus: Bus, who: set[int], limit_s: float) -> None:
    """Step until the executive leaves; who: numbers of the participants; limit_s: of mission time.

    Nothing is published after that, so the last telemetry is the same in every run. Raises TimeLimit and
    ParticipantTimeout.
    """
    clock = LockstepClock(bus, who)
    clock.wait_for_all()
    tick = 0
    while WHO["executive"] not in clock.left:
        tick += 1
        now_us = tick * TICK_US
        if now_us > limit_s * 1e6:
            raise TimeLimit(f"mission time limit of {limit_s:g} s reached")
        for channel, message in world.step(now_us):
            bus.publish(channel, message)
        clock.tick(tick, now_us)


def run_realtime(world: World, bus: Bus, background: BackgroundImager, limit_s: float) -> None:
    """Step at 10 Hz of the wall clock and wait for nobody; ends when the executive leaves.

    Raises TimeLimit."""
    gone: set[int] = set()

    def on_tick_done(_: str, m: kcm.tick_done_t) -> None:
        if m.tick == LEAVE:
            gone.add(m.who)

    bus.listen("KC_TICK_DONE", on_tick_done)
    start = due = time.monotonic()
    while WHO["executive"] not in gone:
        due = max(due + TICK_US * 1e-6, time.monotonic() - BEHIND_MAX_S)
        while (left := due - time.monotonic()) > 0.0:
            bus.wait(left)
        if due - start > limit_s:
            raise TimeLimit(f"time limit of {limit_s:g} s reached")
        now_us = time.time_ns() // 1000
        for channel, message in world.step(now_us) + background.completed(now_us, world.last_motion_us):
            bus.publish(channel, message)


def options(argv: list[str] | None) -> argparse.Namespace:
    """The command line."""
    about = (__doc__ or "").split("\n")[0]
    p = argparse.ArgumentParser(prog="python -m kincal_sim.server", description=about)
    p.add_argument("--scenario", required=True, help="name or file")
    p.add_argument("--url", required=True, help="LCM URL")
    p.add_argument("--seed", type=int, default=1)
    p.add_argument("--out", type=Path, required=True, help="folder for truth.json and contacts.json")
    mode = p.add_mutually_exclusive_group()
    mode.add_argument("--pixels", action="store_true", help="publish rendered frames (default)")
    mode.add_argument("--fast", action="store_true", help="publish detections without rendering anything")
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


def participants(o: argparse.Namespace) -> set[int]:
    """Numbers of those who answer ticks."""
    default = ["fsw", "executive"] + ([] if o.fast else ["detector"])
    return {WHO[name] for name in (o.participants.split(",") if o.participants else default)}


def main(argv: list[str] | None = None) -> int:
    """The process; exit status as above."""
    o = options(argv)
    scenario = load(o.scenario)
    o.out.mkdir(parents=True, exist_ok=True)
    make_imager = fast_imager if o.fast else pixel_imager
    background = BackgroundImager(make_imager)
    world = World(scenario, o.seed, background.imager if o.realtime else make_imager)
    truth = truth_record(scenario, world.plant, o.seed, "fast" if o.fast else "pixels")
    outputs.write(o.out / outputs.TRUTH, truth)
    bus = Bus(o.url)
    for channel in COMMANDS:
        bus.listen(channel, world.receive)
    try:
        return _run(o, scenario, world, bus, background)
    finally:
        outputs.write(o.out / outputs.CONTACTS, world.contacts)


def _run(
    o: argparse.Namespace, scenario: Scenario, world: World, bus: Bus, background: BackgroundImager
) -> int:
    limit_s = o.limit or scenario.executive.total_timeout_s + PATIENCE_S
    try:
        if o.realtime:
            run_realtime(world, bus, background, limit_s)
        else:
            run_lockstep(world, bus, participants(o), limit_s)
    except TimeLimit as e:
        print(e, file=sys.stderr)
        return EXIT_TIME_LIMIT
    except ParticipantTimeout as e:
        print(f"lockstep ended: {e}", file=sys.stderr)
        return EXIT_TIMEOUT
    return 0


if __name__ == "__main__":
    sys.exit(main())
