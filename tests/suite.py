"""Run the steps of `make test`, all of them even after a failure, and sum up.

    suite.py --junit build/junit --logs build/log --first build --idle cov lint ...    run steps with make
    suite.py --junit build/junit --sum                                      only the closing line

One step more than there are processors runs at once, since many wait for messages or a clock; each gets
PROCESSORS=1. They begin in the order given: those that wait and those that take longest first, so that none is left at the end.
What several steps need is made before (--first), on all processors. Steps that only compute (--idle) run
beside the others, one at a time and with less right to the processors: they take what waiting leaves.
Each step is printed with the seconds that it took and those of the processors.

Tests are counted from the JUnit files that CTest and pytest wrote, never from exit codes; a step
without tests (lint, size ...) or one that fails without a failed test counts as one failure when it fails.
So does one that is ended because it took too long; a test that hangs is ended before (timeout in pytest.ini).
"""

import argparse
import json
import os
import subprocess
import sys
import threading
import time
import xml.etree.ElementTree as ET
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

# Steps that are tests, and the JUnit file each writes.
REPORT = {
    "unit": "unit.xml",
    "cov": "unit-san.xml",
    "oracle": "oracle.xml",
    "integration": "integration.xml",
    "ground-test": "ground.xml",
    "workbench-test": "workbench.xml",
    "live-test": "live.xml",
    "lint-test": "lint.xml",
}


# A step that hangs must not take the others' results with it: CI ends after 5400 s.
LIMIT_S = 2700.0


def count(report: Path) -> tuple[int, int, int]:
    """Passed, failed (errors too), skipped."""
    if not report.exists():
        return 0, 0, 0
    failed = skipped = total = 0
    for case in ET.parse(report).getroot().iter("testcase"):
        total += 1
        failed += case.find("failure") is not None or case.find("error") is not None
        skipped += case.find("skipped") is not None
    return total - failed - skipped, failed, skipped


# Of a step that takes what the others leave: less than half the share of one that does not. More, and the others end
# after them; less, and they end alone.
NICE = 4


def run(step: str, logs: Path, processors: int, nice: int = 0) -> tuple[int, float, float]:
    """Exit status, duration [s] and processor time [s] of a step on so many processors."""
    start = time.monotonic()
    with (logs / f"{step}.txt").open("w") as out:
        politely = ["nice", "-n", str(nice)] if nice else []
        process = subprocess.Popen(
            [*politely, "make", "--no-print-directory", f"-j{processors}", "-k", step,
             f"PROCESSORS={processors}"],
            stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.STDOUT,
        )  # fmt: skip
        limit = threading.Timer(LIMIT_S, process.terminate)  # make ends what it has started
        limit.start()
        _, status, usage = os.wait4(process.pid, 0)  # its own, and of all that it waited for
        limit.cancel()
        process.returncode = os.waitstatus_to_exitcode(status)
    return process.returncode, time.monotonic() - start, usage.ru_utime + usage.ru_stime


def outcome(step: str, code: int, seconds: float, busy_s: float, junit: Path, logs: Path) -> dict:
    """What became of a step, printed too."""
    passed, failed, skipped = count(junit / REPORT[step]) if step in REPORT else (0, 0, 0)
    if step in REPORT and passed + failed == 0:
        code = code or 1  # a test step without a test is no success
    if code and not failed:
        failed = 1
    text = (logs / f"{step}.txt").read_text(errors="replace").splitlines()
    if failed:
        print("\n".join(text[-150:]))
    elif step in ("cov", "size"):
        print("\n".join(line for line in text if line.startswith("  ")))
    tests = f"{passed} passed, {failed} failed" + (f", {skipped} skipped" if skipped else "")
    print(
        f"{'FAIL' if failed else 'ok  '}  {step:14s} {seconds:6.1f} s {busy_s:6.1f} s  "
        f"{tests if step in REPORT else ''}",
        flush=True,
    )
    counts = {"passed": passed, "failed": failed, "skipped": skipped}
    return {"step": step, "seconds": seconds, "processor_s": busy_s, **counts}


def run_all(
    first: list[str], idle: list[str], steps: list[str], junit: Path, logs: Path, processors: int
) -> list[dict]:
    done = [outcome(step, *run(step, logs, processors), junit, logs) for step in first]
    with ThreadPoolExecutor(processors + 1) as lanes, ThreadPoolExecutor(1) as beside:
        running = {lanes.submit(run, step, logs, 1): step for step in steps}
        running |= {beside.submit(run, step, logs, 1, NICE): step for step in idle}
        done += [outcome(running[f], *f.result(), junit, logs) for f in as_completed(running)]
    return done


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--junit", type=Path, required=True)
    parser.add_argument("--logs", type=Path)
    parser.add_argument("--sum", action="store_true")
    parser.add_argument("--processors", type=int, default=min(os.cpu_count() or 1, 4))
    parser.add_argument("--first", action="append", default=[], help="step before all others")
    parser.add_argument("--idle", action="append", default=[], help="step beside all others")
    parser.add_argument("steps", nargs="*")
    args = parser.parse_args()
    summary = args.junit / "summary.json"

    if not args.sum:
        # We are called from make: its job server and flags are not for the steps.
        for name in ("MAKEFLAGS", "MFLAGS", "MAKELEVEL"):
            os.environ.pop(name, None)
        args.logs.mkdir(parents=True, exist_ok=True)
        args.junit.mkdir(parents=True, exist_ok=True)
        began = time.monotonic()
        done = run_all(args.first, args.idle, args.steps, args.junit, args.logs, args.processors)
        summary.write_text(json.dumps(done, indent=1))

    steps = json.loads(summary.read_text()) if summary.exists() else []
    passed, failed, skipped = (sum(s[k] for s in steps) for k in ("passed", "failed", "skipped"))
    if not args.sum:
        print(f"all steps: {time.monotonic() - began:.0f} s; logs in {args.logs}")
    print(f"{passed} passed, {failed} failed" + (f", {skipped} skipped" if skipped else ""))
    return 1 if failed or not passed else 0


if __name__ == "__main__":
    sys.exit(main())
