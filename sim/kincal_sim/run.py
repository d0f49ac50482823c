"""One run of a scenario: what is started with which options, and how it ended."""

from __future__ import annotations

import socket
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from kincal_shared import keys

from . import outputs
from .ports import NoFreePort, private_port, private_url
from .processes import ROOT, STOP_WAIT_S, ProcessGroup
from .recorder import Recorder
from .scenario import load

POLL_S = 0.02


class LaunchError(RuntimeError):
    """A process is missing or ended when it should not have."""


@dataclass
class Run:
    """What to start and where.

    scenario: file; out: folder for everything that a run leaves; url: LCM network, "" = a private one;
    fast: no pixels; poses: 0 = as scenario and tables say; accept: policy instead of the scenario's;
    sim, fsw: False = a bench, or a flight process that already runs on this URL, takes the place;
    images: log the frames too; store: None = a fresh one in `out`; keys: key file, None = one of this run
    beside the store, or, with a flight process that runs already, the user's.
    """

    scenario: Path
    out: Path
    url: str = ""
    fast: bool = False
    seed: int = 1
    acquisition: str = ""
    poses: int = 0
    accept: str = ""
    realtime: bool = False
    sim: bool = True
    fsw: bool = True
    images: bool = False
    tables: Path = ROOT / "tables" / "bin"
    store: Path | None = None
    keys: Path | None = None
    fsw_bin: Path = ROOT / "build" / "kincal-fsw"
    detector_bin: Path = ROOT / "build" / "kincal-tagdet"
    detector_config: Path = ROOT / "sim" / "models" / "detector.yml"

    @property
    def mode(self) -> str:
        """ "fast" or "pixels"."""
        return "fast" if self.fast else "pixels"

    def commands(self, url: str, store: Path, keys: Path) -> dict[str, list]:
        """Command lines by process name, in starting order."""
        wanted = {
            "fsw": self.fsw,
            "detector": not self.fast,
            "executive": True,
            "server": self.sim,
        }
        lines = {
            "fsw": [*self._fsw(url, store), "--keys", keys],
            "detector": self._detector(url),
            "executive": [*self._executive(url), "--keys", keys],
            "server": self._server(url),
        }
        return {name: line for name, line in lines.items() if wanted[name]}

    def _fsw(self, url: str, store: Path) -> list:
        pace = "--live" if self.realtime else "--lockstep"
        return [self.fsw_bin, "--url", url, "--tables", self.tables, "--store", store, pace]

    def _detector(self, url: str) -> list:
        pace = [] if self.realtime else ["--lockstep"]
        return [self.detector_bin, "--config", self.detector_config, "--url", url, *pace]

    def _executive(self, url: str) -> list:
        return [
            *self._module("executive", url),
            *("--poses", self.poses),
            *(("--acquisition", self.acquisition) if self.acquisition else ()),
            *(("--accept", self.accept) if self.accept else ()),
            *(("--live",) if self.realtime else ()),
        ]

    def _server(self, url: str) -> list:
        pace = ["--realtime"] if self.realtime else []
        return [*self._module("server", url), f"--{self.mode}", *pace]

    def _module(self, name: str, url: str) -> list:
        """A process of this package, with the options that all of them have."""
        return [
            *(sys.executable, "-m", f"kincal_sim.{name}"),
            *("--scenario", self.scenario.resolve()),
            *("--url", url, "--out", self.out, "--seed", self.seed),
        ]

    def key_file(self, store: Path) -> Path:
        """The key file: the given one, or one beside the store, made if missing. In lockstep the run has to
        be repeatable to the byte, so its key comes from the seed and its counters begin at 0."""
        if self.keys is not None or not self.fsw:
            return keys.file_of(self.keys)
        path = store.with_name(f"{store.name}.keys")
        if self.store is None:  # a fresh flight
            path.unlink(missing_ok=True)
        if not path.exists():
            self._make_keys(path)
        return path

    def _make_keys(self, path: Path) -> None:
        if self.realtime:
            keys.new(path)
            return
        keys.write(path, (keys.of_simulation(self.seed),))
        for source in (1, 2):
            keys.count_file(path, source).write_text("0\n")

    def check(self) -> None:
        """Raise LaunchError if a program or the tables are missing."""
        for path, needed in ((self.fsw_bin, self.fsw), (self.detector_bin, not self.fast)):
            if needed and not path.exists():
                raise LaunchError(f"{path} is missing; run `make`")
        if self.fsw and not any(self.tables.glob("*.tbl")):
            raise LaunchError(f"no tables in {self.tables}; run `make tables`")


def execute(run: Run, announce: Callable[[dict], None] | None = None) -> dict:
    """Run a scenario to its end. The result of the executive plus "ok", "problem", "wall_s" and "url".

    announce: called with the URL and the options before anything starts. Raises LaunchError if a process ends
    when it should not; everything is stopped in any case.
    """
    run.check()
    scenario = load(run.scenario)
    store = outputs.prepare(run.out, run.store)
    key_file = run.key_file(store)
    started = time.monotonic()
    with _network(run.url) as url:
        facts = {"url": url, "scenario": scenario.name, "seed": run.seed, "mode": run.mode}
        if announce:
            announce(facts | {"out": str(run.out), "realtime": run.realtime, "keys": str(key_file)})
        _run_processes(run, url, store, key_file)
    return outputs.conclude(run.out, scenario, facts, time.monotonic() - started)


@contextmanager
def _network(url: str) -> Iterator[str]:
    """The given URL, or that of a network which is reserved as long as the run takes."""
    lock: socket.socket | None = None
    if not url:
        try:
            port, lock = private_port()
        except NoFreePort as e:
            raise LaunchError(str(e)) from e
        url = private_url(port)
    try:
        yield url
    finally:
        if lock:
            lock.close()


def _run_processes(run: Run, url: str, store: Path, key_file: Path) -> None:
    group = ProcessGroup(run.out / "logs")
    recorder = Recorder(url, run.out / outputs.LOG, run.images)
    try:
        for name, argv in run.commands(url, store, key_file).items():
            group.start(name, argv)
        recorder.start()
        _wait_for_end(group)
    finally:
        # Flight first: a late answer of its own is still telemetry, and belongs into the log.
        group.stop()
        recorder.close()


def _wait_for_end(group: ProcessGroup) -> None:
    """Until the executive and then the simulator have ended; anybody else ending before is an error."""
    while (left := group.status("executive")) is None:
        for name in group.processes:
            # The simulator ends when the executive leaves, a moment before the executive itself is gone.
            allowed = {"executive": (None, 0, 1), "server": (None, 0)}.get(name, (None,))
            _check_status(group, name, group.status(name), allowed)
        time.sleep(POLL_S)
    _check_status(group, "executive", left, (0, 1))
    if "server" in group.processes:
        _check_status(group, "server", group.wait("server", STOP_WAIT_S), (None, 0))


def _check_status(group: ProcessGroup, name: str, status: int | None, allowed: tuple) -> None:
    if status not in allowed:
        raise LaunchError(f"{name} ended with status {status}:\n{group.tail(name)}")
