"""Start every process of a scenario, wait for the end, collect what they leave.

    python -m kincal_sim.launch paper --out build/run --fast

First line of output: JSON with the LCM URL, so that others can attach. Last line: JSON with the result.
In DIR: truth.json, result.json, touched.json, launch.json, run.lcmlog, logs/, store/. Exit status 0 only if
the calibration succeeded and came to the verdict that the scenario expects.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

import lcm

import kcm

from .scenario import ACCEPT, ACQUISITIONS, Scenario, ScenarioError, find, load

ROOT = Path(__file__).resolve().parents[2]
GROUP = "239.255.76.67"
PORTS = range(20000, 32000)
RECEIVE_BYTES = 4 << 20  # asked for; the kernel gives what it allows
POLL_S = 0.02
STOP_WAIT_S = 5.0  # for a process to end by itself or on request
QUIET_S = 0.2  # the log is complete when nothing came for so long
TAIL_LINES = 15
LOGGED = "KC_.*"
LOGGED_NO_IMAGES = "KC_(?!IMAGE).*"
PR_SET_PDEATHSIG = 1


class LaunchError(RuntimeError):
    """A process is missing or ended when it should not have."""


# -- LCM: a private port and a log ------------------------------------------------------------------


def private_port() -> tuple[int, socket.socket]:
    """A port that nobody uses for LCM, and the socket that reserves it while it stays open.

    Multicast receivers share ports, so a TCP socket on the same number serves as the lock between
    launches, and an exclusive UDP bind shows whether anything else listens there."""
    start = random.SystemRandom().randrange(len(PORTS))
    for k in range(len(PORTS)):
        port = PORTS[(start + k) % len(PORTS)]
        lock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            lock.bind(("127.0.0.1", port))
            lock.listen(1)
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                probe.bind(("", port))
            return port, lock
        except OSError:
            lock.close()
    raise LaunchError(f"no free port in {PORTS.start}..{PORTS.stop}")


class Recorder:
    """Writes what is on the bus to an LCM log, in a thread. Times are mission time."""

    def __init__(self, url: str, path: Path, images: bool):
        self._lcm = lcm.LCM(url)
        self._log = lcm.EventLog(str(path), "w", overwrite=True)
        self._lcm.subscribe(LOGGED if images else LOGGED_NO_IMAGES, self._on).set_queue_capacity(0)
        self._now_us = 0
        self._heard = time.monotonic()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> None:
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.is_set() or time.monotonic() - self._heard < QUIET_S:
            self._lcm.handle_timeout(100)

    def _on(self, channel: str, data: bytes) -> None:
        self._heard = time.monotonic()
        if channel == "KC_TIME":
            self._now_us = kcm.time_t.decode(data).now_us
        self._log.write_event(self._now_us or time.time_ns() // 1000, channel, data)

    def close(self) -> None:
        """Take in what is still on its way, then close the file."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        self._log.close()


# -- processes --------------------------------------------------------------------------------------


@dataclass
class Process:
    name: str
    argv: list[str]
    running: subprocess.Popen | None = None


@dataclass
class Team:
    """The processes of a run; stop() ends all that this launch started, and only those."""

    logs: Path
    members: list[Process] = field(default_factory=list)

    def start(self, name: str, argv: list) -> None:
        process = Process(name, [str(a) for a in argv])
        self.logs.mkdir(parents=True, exist_ok=True)
        env = {
            **os.environ,
            "PYTHONUNBUFFERED": "1",
            "PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")]),
            "PYTHONPATH": os.pathsep.join(
                [str(ROOT / "sim"), str(ROOT / "build" / "py"), *filter(None, [os.environ.get("PYTHONPATH")])]
            ),
        }
        with open(self.logs / f"{name}.out", "wb") as out, open(self.logs / f"{name}.err", "wb") as err:
            # A session of its own: ctrl-C reaches only the launcher, which then stops everybody in order.
            process.running = subprocess.Popen(
                process.argv,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                env=env,
                start_new_session=True,
                preexec_fn=_die_with_parent,
            )
        self.members.append(process)

    def status(self, name: str) -> int | None:
        """Exit status, None while it runs or if there is no such process."""
        return next((p.running.poll() for p in self.members if p.name == name), None)

    def wait(self, name: str, seconds: float) -> int | None:
        for p in self.members:
            if p.name == name:
                try:
                    return p.running.wait(seconds)
                except subprocess.TimeoutExpired:
                    return None
        return None

    def stop(self) -> None:
        for p in self.members:
            if p.running.poll() is None:
                p.running.terminate()
        deadline = time.monotonic() + STOP_WAIT_S
        for p in self.members:
            try:
                p.running.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                p.running.kill()
                p.running.wait()

    def tail(self, name: str) -> str:
        """The end of what a process said."""
        lines: list[str] = []
        for kind in ("out", "err"):
            path = self.logs / f"{name}.{kind}"
            if path.exists():
                lines += path.read_text(errors="replace").splitlines()[-TAIL_LINES:]
        return "\n".join(f"    {line}" for line in lines)


_libc = ctypes.CDLL(None, use_errno=True)


def _die_with_parent() -> None:
    """Linux: no orphans, even if the launcher is killed."""
    _libc.prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)


@dataclass
class Run:
    """What to start and where."""

    scenario: Path
    out: Path
    url: str = ""
    fast: bool = False
    seed: int = 1
    acquisition: str = ""
    poses: int = 0
    accept: str = ""  # accept policy instead of the scenario's
    realtime: bool = False
    sim: bool = True  # False: a bench stands in for the simulator
    fsw: bool = True  # False: the flight process already runs somewhere on this URL
    images: bool = False  # log the frames too
    tables: Path = ROOT / "tables" / "bin"
    store: Path | None = None  # None: a fresh one
    fsw_bin: Path = ROOT / "build" / "kincal-fsw"
    detector_bin: Path = ROOT / "build" / "kincal-tagdet"
    detector_config: Path = ROOT / "sim" / "models" / "detector.yml"

    def commands(self, url: str, store: Path) -> dict[str, list]:
        """Command lines by process name, in starting order."""
        me, common = [sys.executable, "-m"], ["--scenario", self.scenario.resolve(), "--url", url]
        pace = "--live" if self.realtime else "--lockstep"
        asked: dict[str, list] = {}
        if self.fsw:
            asked["fsw"] = [self.fsw_bin, "--url", url, "--tables", self.tables, "--store", store, pace]
        if not self.fast:
            asked["detector"] = [
                self.detector_bin,
                "--config",
                self.detector_config,
                "--url",
                url,
                *([] if self.realtime else ["--lockstep"]),
            ]
        asked["executive"] = [
            *me,
            "kincal_sim.executive",
            *common,
            "--out",
            self.out,
            "--seed",
            self.seed,
            "--poses",
            self.poses,
            *(["--acquisition", self.acquisition] if self.acquisition else []),
            *(["--accept", self.accept] if self.accept else []),
            *(["--live"] if self.realtime else []),
        ]
        if self.sim:
            asked["server"] = [
                *me,
                "kincal_sim.server",
                *common,
                "--out",
                self.out,
                "--seed",
                self.seed,
                "--fast" if self.fast else "--pixels",
                *(["--realtime"] if self.realtime else []),
            ]
        return asked

    def check(self) -> None:
        for path, needed in ((self.fsw_bin, self.fsw), (self.detector_bin, not self.fast)):
            if needed and not path.exists():
                raise LaunchError(f"{path} is missing; run `make`")
        if self.fsw and not any(self.tables.glob("*.tbl")):
            raise LaunchError(f"no tables in {self.tables}; run `make tables`")


def judge(scenario: Scenario, result: dict) -> str:
    """Why a run is no success; empty if it is one."""
    if not result.get("success"):
        return result.get("reason", "the executive left no result")
    if scenario.expect.verdict and result["verdict"] != scenario.expect.verdict:
        return f"verdict {result['verdict']}, the scenario expects {scenario.expect.verdict}"
    return ""


def execute(run: Run, announce=None) -> dict:
    """Run a scenario to its end. The result of the executive plus "ok", "problem", "wall_s" and "url".

    Raises LaunchError if a process ends when it should not; everything is stopped in any case."""
    run.check()
    scenario = load(run.scenario)
    run.out.mkdir(parents=True, exist_ok=True)
    for old in ("result.json", "truth.json", "run.lcmlog", "launch.json", "touched.json"):
        (run.out / old).unlink(missing_ok=True)
    store = run.store or run.out / "store"
    if run.store is None:
        shutil.rmtree(store, ignore_errors=True)
    store.mkdir(parents=True, exist_ok=True)
    lock = None
    url = run.url
    if not url:
        port, lock = private_port()
        url = f"udpm://{GROUP}:{port}?ttl=0&recv_buf_size={RECEIVE_BYTES}"
    started = time.monotonic()
    team = Team(run.out / "logs")
    recorder = Recorder(url, run.out / "run.lcmlog", run.images)
    try:
        if announce:
            announce(
                {
                    "url": url,
                    "out": str(run.out),
                    "scenario": scenario.name,
                    "seed": run.seed,
                    "mode": "fast" if run.fast else "pixels",
                    "realtime": run.realtime,
                }
            )
        for name, argv in run.commands(url, store).items():
            team.start(name, argv)
        recorder.start()
        _wait_for_end(team)
    finally:
        # Flight first: a late answer of its own is still telemetry, and belongs into the log.
        team.stop()
        recorder.close()
        if lock:
            lock.close()
    result = json.loads((run.out / "result.json").read_text())
    problem = judge(scenario, result)
    touched = run.out / "touched.json"
    result |= {
        "ok": not problem,
        "problem": problem,
        "wall_s": round(time.monotonic() - started, 2),
        "url": url,
        "scenario": scenario.name,
        "seed": run.seed,
        "mode": "fast" if run.fast else "pixels",
        # Shapes of the simulated arm that met, with the seconds; for information, it ends no run.
        "touched": json.loads(touched.read_text()) if touched.exists() else {},
    }
    (run.out / "launch.json").write_text(json.dumps(result, indent=1) + "\n")
    return result


def _wait_for_end(team: Team) -> None:
    """Until the executive and then the simulator have ended; anybody else ending before is an error."""
    while (left := team.status("executive")) is None:
        for p in team.members:
            status = p.running.poll()
            # The simulator ends when the executive says so, a moment before the executive itself is gone.
            if status is not None and not (p.name == "server" and status == 0):
                if p.name == "executive":
                    break
                raise LaunchError(f"{p.name} ended with status {status}:\n{team.tail(p.name)}")
        time.sleep(POLL_S)
    if left not in (0, 1):
        raise LaunchError(f"executive ended with status {left}:\n{team.tail('executive')}")
    if any(p.name == "server" for p in team.members):
        status = team.wait("server", STOP_WAIT_S)
        if status not in (0, None):
            raise LaunchError(f"server ended with status {status}:\n{team.tail('server')}")


def add_options(p: argparse.ArgumentParser) -> None:
    """Options shared with hil."""
    eye = p.add_mutually_exclusive_group()
    eye.add_argument("--pixels", action="store_true", help="draw frames and detect tags in them (default)")
    eye.add_argument("--fast", action="store_true", help="no pixels: detections with the same noise")
    p.add_argument("--seed", type=int, default=1)
    p.add_argument("--acquisition", default="", choices=["", *ACQUISITIONS])
    p.add_argument("--poses", type=int, default=0, help="0: as scenario and tables say")
    p.add_argument("--url", default="", help="LCM URL (default: a private port)")
    p.add_argument("--tables", type=Path, default=Run.tables)


def shared(o: argparse.Namespace) -> dict:
    """Those options as fields of a Run."""
    return {
        "url": o.url,
        "fast": o.fast,
        "seed": o.seed,
        "acquisition": o.acquisition,
        "poses": o.poses,
        "tables": o.tables,
    }


def options(argv: list[str] | None) -> argparse.Namespace:
    p = argparse.ArgumentParser(prog="python -m kincal_sim.launch", description=__doc__.split("\n")[0])
    p.add_argument("scenario", help="name or file")
    p.add_argument("--out", type=Path, required=True, help="folder for everything a run leaves")
    p.add_argument("--store", type=Path, help="store of an earlier run to go on with (default: a fresh one)")
    p.add_argument("--realtime", action="store_true", help="wall clock instead of lockstep")
    p.add_argument(
        "--accept", default="", choices=["", *ACCEPT], help="accept policy (default: the scenario's)"
    )
    p.add_argument("--images", action="store_true", help="log the frames too (20 MB per 100 frames)")
    p.add_argument("--fsw", type=Path, default=Run.fsw_bin, help="flight process")
    add_options(p)
    return p.parse_args(argv)


def say(record: dict) -> None:
    print(json.dumps(record), flush=True)


def stop_on_terminate() -> None:
    """A terminated launcher cleans up like an interrupted one."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))


def main(argv: list[str] | None = None) -> int:
    o = options(argv)
    stop_on_terminate()
    try:
        run = Run(
            find(o.scenario),
            o.out,
            **shared(o),
            accept=o.accept,
            realtime=o.realtime,
            images=o.images,
            store=o.store,
            fsw_bin=o.fsw,
        )
        result = execute(run, say)
    except (LaunchError, ScenarioError) as e:
        print(f"launch: {e}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("launch: interrupted, all processes stopped", file=sys.stderr)
        return 130
    say(result)
    if result["problem"]:
        print(f"launch: {result['problem']}", file=sys.stderr)
    return 0 if result["ok"] else 1


if __name__ == "__main__":
    sys.exit(main())
