"""The operator's commands against real flight and the fast simulator over LCM: see, abort, roll back."""

import json
import subprocess
import sys
import time

import pytest
from click.testing import CliRunner
from flight import BINARY, TABLES, store_with_proposal

from kincal.cli import main
from kincal.link import Link
from kincal.review import decisions
from kincal_shared import keys
from kincal_sim.ports import private_port, private_url

WHO = ("--by", "A. Operator", "--why", "test")


def kincal(*args):
    """Exit status, and output as one line."""
    run = CliRunner().invoke(main, [str(a) for a in args])
    assert run.exception is None or isinstance(run.exception, SystemExit), run.exc_info
    return run.exit_code, " ".join(run.output.split())


class Live:
    """Flight with the real clock on a network of its own, with an arm in real time if one is asked for."""

    def __init__(self, store, file, scenario=""):
        self.store, self.file, self.scenario = store, file, scenario
        port, self._lock = private_port()
        self.url = private_url(port)
        self.on = ("--keys", file, "--url", self.url)
        self.processes = []

    def start(self):
        command = [BINARY, "--live", "--url", self.url, "--tables", TABLES, "--store", self.store]
        self.processes.append(subprocess.Popen([*command, "--keys", self.file], stderr=subprocess.DEVNULL))
        return self

    def __enter__(self):
        self.start()
        if self.scenario:
            world = [
                sys.executable,
                "-m",
                "kincal_sim.server",
                "--scenario",
                self.scenario,
                "--url",
                self.url,
            ]
            world += ["--fast", "--realtime", "--out", str(self.store) + ".world", "--limit", "600"]
            self.processes.append(subprocess.Popen(world, stderr=subprocess.DEVNULL))
        with Link(self.url) as link:
            link.wait_hk(lambda _hk: True, 30.0, "housekeeping")
        return self

    def __exit__(self, *_):
        for process in self.processes:
            process.kill()
            process.wait()
        self._lock.close()


@pytest.fixture
def file(tmp_path):
    keys.new(tmp_path / "keys")
    return tmp_path / "keys"


def test_a_calibration_is_started_seen_and_aborted_in_mid_motion(tmp_path, file):
    with Live(tmp_path / "store", file, "healthy") as flight:
        deadline = time.monotonic() + 60.0
        while kincal("command", "start", "--dry-run", *flight.on)[0] != 0:  # until the arm is there
            assert time.monotonic() < deadline
        status, said = kincal("command", "start", "--poses", 5, *WHO, *flight.on)
        assert status == 0 and "START done: event CAL_START: calibration 1 started: 5 poses" in said
        status, said = kincal("command", "start", *WHO, *flight.on)
        assert status == 1 and "START refused: CMD_STATE: command START refused in state" in said
        found = json.loads(kincal("status", "--json", "--url", flight.url)[1])
        assert found["calibrating"] and "CMD_STATE" not in found["waits_for"]
        fresh = {i["key"]: i["freshness"]["status"] for i in found["items"]}
        assert (fresh["state"], fresh["joints"], fresh["pantilt"]) == ("fresh", "fresh", "fresh")
        status, said = kincal("command", "abort", *flight.on)
        assert status == 0 and "ABORT done: housekeeping: state SAFE, the arm is held" in said
        found = json.loads(kincal("status", "--json", "--url", flight.url)[1])
        assert found["state"] == "SAFE" and not found["calibrating"]
    status, said = kincal("audit", "verify", "--keys", file)
    assert status == 0 and "2 decisions and commands in 5 lines" in said


def test_a_correction_is_rolled_back_and_a_killed_flight_is_said(tmp_path):
    store, crc, before = store_with_proposal(tmp_path)
    file = store.parent / f"{store.name}.keys"
    with Live(store, file) as flight:
        rejected = kincal("command", "rollback", f"{crc:08x}", "--dry-run", *flight.on)
        assert rejected[0] == 1 and "found: REVIEW" in rejected[1]
        status, said = kincal("review", "show", "--live", "--recordings", tmp_path / "none", *flight.on)
        assert status == 1 and f"correction {crc:08x} (change proposed), as flight holds it" in said
        assert "Where the tool goes" in said and "was not recorded" in said
        with Link(flight.url, signer=keys.signer_of(file)) as link:
            link.wait_hk(lambda _hk: True, 10.0, "housekeeping")
            decisions.send_arm(link, crc, 10.0)
            decisions.send_go(link, crc, 10.0)
            dumped = tmp_path / "now.tbl"
            assert kincal("table", "dump", "kin", dumped, *flight.on)[0] == 0
        status, said = kincal("command", "rollback", "--from", dumped, *flight.on)
        assert status == 0 and "goes back by" in said and "nothing was sent" in said
        status, said = kincal("command", "rollback", f"{crc:08x}", *WHO, *flight.on)
        assert (
            status == 0
            and f"done: housekeeping: correction {before:08x} in force; event COR_ROLLBACK" in said
        )
        status, said = kincal("command", "rollback", "--from", dumped, *flight.on)
        assert status == 1 and "holds no table before" in said and "a table before the one in force" in said
        again = kincal("command", "rollback", f"{crc:08x}", *WHO, *flight.on)
        assert again[0] == 1 and "CMD_CRC" in again[1]
        flight.processes[0].kill()
        status, said = kincal("command", "rollback", f"{before:08x}", *WHO, *flight.on)
        assert status == 1 and "nothing was sent: no housekeeping" in said
