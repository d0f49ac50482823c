"""Scenarios at real-time pace on any LCM network, with a JUnit report: the hardware-in-the-loop test.

    python -m kincal_sim.hil                                  two short scenarios side by side, all simulated
    python -m kincal_sim.hil --url URL --no-sim paper         a bench on URL takes the simulator's place
    python -m kincal_sim.hil --url URL --no-sim --no-fsw ...  flight runs on the bench as well

The executive asks and decides as in simulation; the checks use what was recorded on the network.
Exit status 0: all checks passed.
"""

from __future__ import annotations

import argparse
import sys
import threading
import time
from collections import defaultdict
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree as ET

import lcm

from kincal_shared.errors import BadInput

from .bus import TYPES
from .launch import add_options, shared_fields, stop_on_terminate
from .processes import ROOT
from .run import LaunchError, Run, execute
from .scenario import find

DEFAULT = ("paper", "healthy")
SHORT_POSES = 8
HK_GAP_MAX_S = 2.5  # heartbeats come every second
STATE_GAP_MAX_S = 1.5  # arm states come every 0.1 s; a frame being rendered delays them
CHANNELS = ("KC_HK", "KC_CMD", "KC_ACK", "KC_ARM_STATE", "KC_FRAME_REQUEST", "KC_DETECTION")


@dataclass
class Outcome:
    """One scenario: the executive's result (or why there is none) and the recorded messages by channel."""

    name: str
    seconds: float = 0.0
    result: dict = field(default_factory=dict)
    error: str = ""
    messages: dict[str, list] = field(default_factory=lambda: defaultdict(list))


def read_log(path: Path) -> dict[str, list]:
    """Messages by channel, of the channels that the checks use."""
    messages: dict[str, list] = defaultdict(list)
    if path.exists() and path.stat().st_size > 0:
        for event in lcm.EventLog(str(path), "r"):
            if event.channel in CHANNELS:
                messages[event.channel].append(TYPES[event.channel].decode(event.data))
    return messages


# ---- checks: each gives the problem, or an empty text ------------------------------------------------


def _longest_gap_s(messages: list) -> float:
    t = [m.t_us for m in messages]
    return max((b - a for a, b in pairwise(t)), default=0) * 1e-6


def calibration_ends_as_expected(o: Outcome) -> str:
    """The executive's result is the one that the scenario expects."""
    return o.error or o.result.get("problem", "no result")


def heartbeats_come_every_second(o: Outcome) -> str:
    """No gap between KC_HK is longer than HK_GAP_MAX_S."""
    if len(o.messages["KC_HK"]) < 2:
        return "no heartbeats"
    gap = _longest_gap_s(o.messages["KC_HK"])
    return f"{gap:.2f} s without a heartbeat" if gap > HK_GAP_MAX_S else ""


def arm_states_keep_coming(o: Outcome) -> str:
    """KC_ARM_STATE counts up without a gap longer than STATE_GAP_MAX_S."""
    states = o.messages["KC_ARM_STATE"]
    if len(states) < 2:
        return "no arm states"
    if any(b.seq <= a.seq for a, b in pairwise(states)):
        return "sequence numbers do not grow"
    gap = _longest_gap_s(states)
    return f"{gap:.2f} s without an arm state" if gap > STATE_GAP_MAX_S else ""


def every_command_is_answered(o: Outcome) -> str:
    """Every KC_CMD has its KC_ACK."""
    answered = {(a.source, a.seq) for a in o.messages["KC_ACK"]}
    open_ = [c for c in o.messages["KC_CMD"] if (c.source, c.seq) not in answered]
    return f"{len(open_)} of {len(o.messages['KC_CMD'])} commands without an answer" if open_ else ""


def frames_are_answered(o: Outcome) -> str:
    """Every KC_FRAME_REQUEST has its KC_DETECTION; the end of a run may cut off the last one."""
    requested = {m.seq for m in o.messages["KC_FRAME_REQUEST"]}
    missing = requested - {m.seq for m in o.messages["KC_DETECTION"]}
    return f"{len(missing)} of {len(requested)} frames without a detection" if len(missing) > 1 else ""


def no_message_errors(o: Outcome) -> str:
    """Flight counted no send or receive errors."""
    if not o.messages["KC_HK"]:
        return "no heartbeats"
    hk = o.messages["KC_HK"][-1]
    errors = hk.n_tx_errors + hk.n_rx_errors
    return f"{hk.n_tx_errors} send and {hk.n_rx_errors} receive errors" if errors else ""


CHECKS = (
    calibration_ends_as_expected,
    heartbeats_come_every_second,
    arm_states_keep_coming,
    every_command_is_answered,
    frames_are_answered,
    no_message_errors,
)


# ---- running and reporting --------------------------------------------------------------------------


def run_one(run: Run) -> Outcome:
    """Execute a run; what goes wrong is part of the outcome."""
    outcome, started = Outcome(run.scenario.stem), time.monotonic()
    try:
        outcome.result = execute(run)
    except (LaunchError, OSError, ValueError) as e:
        outcome.error = str(e)
    outcome.seconds = time.monotonic() - started
    outcome.messages = read_log(run.out / "run.lcmlog")
    return outcome


def run_all(runs: list[Run], side_by_side: bool) -> list[Outcome]:
    """Outcomes in the order given; side by side each run has a network of its own."""
    outcomes: dict[int, Outcome] = {}
    threads = [
        # Daemons: nobody waits for them when this process is terminated, and their processes end with it.
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
        root.append(_suite(o))
    ET.indent(root)
    return ET.ElementTree(root)


def _suite(o: Outcome) -> ET.Element:
    name, problems = f"hil.{o.name}", {check.__name__: check(o) for check in CHECKS}
    suite = ET.Element(
        "testsuite",
        name=name,
        tests=str(len(problems)),
        failures=str(sum(map(bool, problems.values()))),
        errors="0",
        time=f"{o.seconds:.1f}",
    )
    for check, problem in problems.items():
        case = ET.SubElement(suite, "testcase", classname=name, name=check, time="0")
        if problem:
            ET.SubElement(case, "failure", message=problem.split("\n")[0]).text = problem
    return suite


def report(tree: ET.ElementTree) -> int:
    """Print a line per check, give the number of failures."""
    failures = 0
    for case in tree.iter("testcase"):
        failure = case.find("failure")
        failures += failure is not None
        verdict, why = ("ok  ", "") if failure is None else ("FAIL", f": {failure.text}")
        print(f"{verdict} {case.get('classname')} {case.get('name', '').replace('_', ' ')}{why}")
    return failures


def options(argv: list[str] | None) -> argparse.Namespace:
    """The command line."""
    about = (__doc__ or "").split("\n")[0]
    p = argparse.ArgumentParser(prog="python -m kincal_sim.hil", description=about)
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
    """The runs that the command line asks for. Raises BadInput."""
    paths = [find(name) for name in o.scenarios or DEFAULT]
    fields = shared_fields(o) | {"realtime": True, "sim": not o.no_sim, "fsw": not o.no_fsw}
    return [Run(path, o.out / path.stem, **fields) for path in paths]


def main(argv: list[str] | None = None) -> int:
    """The command; exit status 0, 1 (a check failed), 2 (could not run)."""
    o = options(argv)
    stop_on_terminate()
    try:
        runs = plan(o)
    except BadInput as e:
        print(f"hil: {e}", file=sys.stderr)
        return 2
    # On one network the scenarios would talk into each other.
    tree = junit(run_all(runs, side_by_side=not o.url))
    o.out.mkdir(parents=True, exist_ok=True)
    tree.write(o.out / "junit.xml", encoding="utf-8", xml_declaration=True)
    failures = report(tree)
    verdict = f"{failures} checks failed" if failures else "all checks passed"
    print(f"{verdict}; report in {o.out / 'junit.xml'}")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
