"""Start every process of a scenario, wait for the end, collect what they leave.

    python -m kincal_sim.launch paper --out build/run --fast

First line of output: JSON with the LCM URL, so that others can attach. Last line: JSON with the result.
In DIR: truth.json, result.json, contacts.json, launch.json, run.lcmlog, logs/, store/. Exit status 0 only if
the calibration succeeded and came to the verdict that the scenario expects.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
from pathlib import Path

from kincal_shared.errors import BadInput

from .run import LaunchError, Run, execute
from .scenario import ACCEPT, ACQUISITIONS, find


def add_options(p: argparse.ArgumentParser) -> None:
    """Options shared with hil."""
    mode = p.add_mutually_exclusive_group()
    mode.add_argument("--pixels", action="store_true", help="render frames and detect tags in them (default)")
    mode.add_argument("--fast", action="store_true", help="no pixels: detections with the same noise")
    p.add_argument("--seed", type=int, default=1)
    p.add_argument("--acquisition", default="", choices=["", *ACQUISITIONS])
    p.add_argument("--poses", type=int, default=0, help="0: as scenario and tables say")
    p.add_argument("--url", default="", help="LCM URL (default: a private port)")
    p.add_argument("--tables", type=Path, default=Run.tables)
    p.add_argument("--keys", type=Path, help="key file of flight and executive (default: one of this run)")


def shared_fields(o: argparse.Namespace) -> dict:
    """The shared options as fields of a Run."""
    return {
        name: getattr(o, name) for name in ("url", "fast", "seed", "acquisition", "poses", "tables", "keys")
    }


def options(argv: list[str] | None) -> argparse.Namespace:
    """The command line."""
    about = (__doc__ or "").split("\n")[0]
    p = argparse.ArgumentParser(prog="python -m kincal_sim.launch", description=about)
    p.add_argument("scenario", help="name or file")
    p.add_argument("--out", type=Path, required=True, help="folder for everything that a run leaves")
    p.add_argument("--store", type=Path, help="store of an earlier run to go on with (default: a fresh one)")
    p.add_argument("--realtime", action="store_true", help="wall clock instead of lockstep")
    p.add_argument(
        "--accept", default="", choices=["", *ACCEPT], help="accept policy (default: the scenario's)"
    )
    p.add_argument("--images", action="store_true", help="log the frames too (20 MB per 100 frames)")
    p.add_argument("--fsw", type=Path, default=Run.fsw_bin, help="flight process")
    add_options(p)
    return p.parse_args(argv)


def run_of(o: argparse.Namespace) -> Run:
    """The run that the command line asks for. Raises BadInput."""
    return Run(
        find(o.scenario),
        o.out,
        **shared_fields(o),
        accept=o.accept,
        realtime=o.realtime,
        images=o.images,
        store=o.store,
        fsw_bin=o.fsw,
    )


def stop_on_terminate() -> None:
    """A terminated launcher cleans up like an interrupted one."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))


def print_json(record: dict) -> None:
    """One line for whoever reads along."""
    print(json.dumps(record), flush=True)


def main(argv: list[str] | None = None) -> int:
    """The command; exit status 0, 1 (no success), 2 (could not run), 130 (interrupted)."""
    o = options(argv)
    stop_on_terminate()
    try:
        result = execute(run_of(o), print_json)
    except (LaunchError, BadInput) as e:
        print(f"launch: {e}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("launch: interrupted, all processes stopped", file=sys.stderr)
        return 130
    print_json(result)
    if result["problem"]:
        print(f"launch: {result['problem']}", file=sys.stderr)
    return 0 if result["ok"] else 1


if __name__ == "__main__":
    sys.exit(main())
