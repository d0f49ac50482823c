"""Scenarios at real-time pace on any LCM network, with a JUnit report: the hardware-in-the-loop test.

    python -m kincal_sim.hil                                  two short scenarios side by side, all simulated
    python -m kincal_sim.hil --url URL --no-sim paper         a bench on URL takes the simulator's place
    python -m kincal_sim.hil --url URL --no-sim --no-fsw ...  flight runs on the bench as well

The executive asks and judges as in simulation; the checks look at what was recorded on the network.
Exit status 0: all checks passed.
"""

from __future__ import annotations

import argparse
import sys
import threading
import time
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree as ET

import lcm

from .bus import TYPES
from .launch import ROOT, LaunchError, Run, add_options, execute, shared, stop_on_terminate
from .scenario import ScenarioError, find

DEFAULT = ("paper", "healthy")
SHORT_POSES = 8
HK_GAP_MAX_S = 2.5  # heartbeats come every second
STATE_GAP_MAX_S = 1.5  # arm states come every 0.1 s; a frame being drawn holds them up for a while
CHANNELS = ("KC_HK", "KC_CMD", "KC_ACK", "KC_ARM_STATE", "KC_FRAME_REQUEST", "KC_DETECTION")


@dataclass
class Outcome:
    """One scenario: the executive's result (or why there is none) and the recorded messages by channel."""

    name: str
    seconds: float = 0.0
    result: dict = field(default_factory=dict)
    error: str = ""
    heard: dict[str, list] = field(default_factory=lambda: defaultdict(list))


def read_log(path: Path) -> dict[str, list]:
    """Messages of the channels that the checks look at."""
    heard: dict[str, list] = defaultdict(list)
    if path.exists() and path.stat().st_size > 0:
        for event in lcm.EventLog(str(path), "r"):
            if event.channel in CHANNELS:
                heard[event.channel].append(TYPES[event.channel].decode(event.data))
    return heard


# -- checks: each gives the problem, or nothing -----------------------------------------------------


def _longest_gap_s(messages: list) -> float:
    t = [m.t_us for m in messages]
    return max((b - a for a, b in zip(t, t[1:], strict=False)), default=0) * 1e-6


def calibration_ends_as_expected(o: Outcome) -> str:
    return o.error or o.result.get("problem", "no result")


def heartbeats_come_every_second(o: Outcome) -> str:
    if len(o.heard["KC_HK"]) < 2:
        return "no heartbeats"
    gap = _longest_gap_s(o.heard["KC_HK"])
    return f"{gap:.2f} s without a heartbeat" if gap > HK_GAP_MAX_S else ""


def arm_states_keep_coming(o: Outcome) -> str:
    states = o.heard["KC_ARM_STATE"]
    if len(states) < 2:
        return "no arm states"
    if any(b.seq <= a.seq for a, b in zip(states, states[1:], strict=False)):
        return "sequence numbers do not grow"
    gap = _longest_gap_s(states)
    return f"{gap:.2f} s without an arm state" if gap > STATE_GAP_MAX_S else ""


def every_command_is_answered(o: Outcome) -> str:
    answered = {(a.source, a.seq) for a in o.heard["KC_ACK"]}
    open_ = [c for c in o.heard["KC_CMD"] if (c.source, c.seq) not in answered]
    return f"{len(open_)} of {len(o.heard['KC_CMD'])} commands without an answer" if open_ else ""


def frames_are_answered(o: Outcome) -> str:
    asked = {m.seq for m in o.heard["KC_FRAME_REQUEST"]}
    missing = asked - {m.seq for m in o.heard["KC_DETECTION"]}
    # The end of a run may cut off the last one.
    return f"{len(missing)} of {len(asked)} frames without a detection" if len(missing) > 1 else ""


def no_message_errors(o: Outcome) -> str:
    hk = o.heard["KC_HK"][-1] if o.heard["KC_HK"] else None
    if hk is None:
        return "no heartbeats"
    return (
        f"{hk.n_tx_errors} send and {hk.n_rx_errors} receive errors"
        if hk.n_tx_errors + hk.n_rx_errors
        else ""
    )


CHECKS = (
    calibration_ends_as_expected,
    heartbeats_come_every_second,
    arm_states_keep_coming,
    every_command_is_answered,
    frames_are_answered,
    no_message_errors,
)


# -- running and reporting --------------------------------------------------------------------------


def run_one(run: Run) -> Outcome:
    outcome, started = Outcome(run.scenario.stem), time.monotonic()
    try:
        outcome.result = execute(run)
    except (LaunchError, OSError, ValueError) as e:
        outcome.error = str(e)
    outcome.seconds = time.monotonic() - started
    outcome.heard = read_log(run.out / "run.lcmlog")
    return outcome


def run_all(runs: list[Run], side_by_side: bool) -> list[Outcome]:
    """In the order given; side by side each has a network of its own."""
    outcomes: dict[int, Outcome] = {}
    threads = [
        threading.Thread(target=lambda k=k, r=r: outcomes.__setitem__(k, run_one(r)), daemon=True)
        for k, r in enumerate(runs)
    ]
    for t in threads:
        t.start()
        if not side_by_side:
            t.join()
    for t in threads:
        t.join()
    return [outcomes[k] for k in range(len(runs))]


def junit(outcomes: list[Outcome]) -> ET.ElementTree:
    """One suite per scenario, one case per check."""
    root = ET.Element("testsuites", name="hil")
    for o in outcomes:
        problems = [(check.__name__, check(o)) for check in CHECKS]
        suite = ET.SubElement(
            root,
            "testsuite",
            name=f"hil.{o.name}",
            tests=str(len(problems)),
            failures=str(sum(bool(p) for _, p in problems)),
            errors="0",
            time=f"{o.seconds:.1f}",
        )
        for name, problem in problems:
            case = ET.SubElement(suite, "testcase", classname=f"hil.{o.name}", name=name, time="0")
            if problem:
                ET.SubElement(case, "failure", message=problem.split("\n")[0]).text = problem
    ET.indent(root)
    return ET.ElementTree(root)


def report(tree: ET.ElementTree) -> int:
    """Print a line per check, give the number of failures."""
    failures = 0
    for case in tree.iter("testcase"):
        failure = case.find("failure")
        failures += failure is not None
        verdict = "ok  " if failure is None else "FAIL"
        print(
            f"{verdict} {case.get('classname')} {case.get('name').replace('_', ' ')}"
            + ("" if failure is None else f": {failure.text}")
        )
    return failures


def options(argv: list[str] | None) -> argparse.Namespace:
    p = argparse.ArgumentParser(prog="python -m kincal_sim.hil", description=__doc__.split("\n")[0])
    p.add_argument("scenarios", nargs="*", help=f"names or files (default: {' '.join(DEFAULT)})")
    p.add_argument("--out", type=Path, default=ROOT / "build" / "hil")
    p.add_argument("--no-sim", action="store_true", help="a bench on --url takes the simulator's place")
    p.add_argument("--no-fsw", action="store_true", help="the flight process already runs on --url")
    add_options(p)
    p.set_defaults(poses=SHORT_POSES)
    o = p.parse_args(argv)
    if (o.no_sim or o.no_fsw) and not o.url:
        p.error("--no-sim and --no-fsw need --url: where is the bench?")
    return o


def plan(o: argparse.Namespace) -> list[Run]:
    return [
        Run(
            find(name),
            o.out / find(name).stem,
            **shared(o),
            realtime=True,
            sim=not o.no_sim,
            fsw=not o.no_fsw,
        )
        for name in o.scenarios or DEFAULT
    ]


def main(argv: list[str] | None = None) -> int:
    o = options(argv)
    stop_on_terminate()
    try:
        runs = plan(o)
    except ScenarioError as e:
        print(f"hil: {e}", file=sys.stderr)
        return 2
    # On one network the scenarios would talk into each other.
    tree = junit(run_all(runs, side_by_side=not o.url))
    o.out.mkdir(parents=True, exist_ok=True)
    tree.write(o.out / "junit.xml", encoding="utf-8", xml_declaration=True)
    failures = report(tree)
    print(
        f"{failures} checks failed; report in {o.out / 'junit.xml'}"
        if failures
        else f"all checks passed; report in {o.out / 'junit.xml'}"
    )
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
