"""The executive of docs/INTERFACES.md, exactly as printed there, runs a calibration."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from kincal_shared import keys
from kincal_sim.ports import private_port, private_url

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "INTERFACES.md").read_text()
CODE = re.search(r"<!-- executive: begin -->\n+```python\n(.*?)```", TEXT, re.S)[1]


def start(argv, out):
    return subprocess.Popen([str(a) for a in argv], stdout=out, stderr=subprocess.STDOUT, cwd=ROOT)


@pytest.fixture
def mission(tmp_path):
    """Flight process and simulator in lockstep on a URL of their own; both end with the test."""
    port, lock = private_port()
    url = private_url(port)
    (tmp_path / "store").mkdir()

    def run(scenario):
        with (tmp_path / "processes.log").open("wb") as out:
            keys.new(tmp_path / "keys")
            fsw = ["--tables", ROOT / "tables/bin", "--store", tmp_path / "store", "--lockstep"]
            fsw += ["--keys", tmp_path / "keys"]
            sim = ["--scenario", scenario, "--out", tmp_path, "--fast", "--seed", "1"]
            processes = [
                start([ROOT / "build/kincal-fsw", "--url", url, *fsw], out),
                start([sys.executable, "-m", "kincal_sim.server", "--url", url, *sim], out),
            ]
            try:
                program = tmp_path / "executive.py"
                program.write_text(CODE)
                done = subprocess.run(
                    [sys.executable, program, url, tmp_path / "keys"],
                    capture_output=True,
                    text=True,
                    timeout=120,
                )
                status = processes[1].wait(20)
            finally:
                for process in processes:
                    process.terminate()
                    process.wait(20)
        return done, status, (tmp_path / "processes.log").read_text()

    with lock:
        yield run


def test_it_has_about_forty_lines():
    lines = [line for line in CODE.splitlines() if line.strip() and not line.startswith("import")]
    assert len(lines) <= 46


@pytest.mark.parametrize(("scenario", "verdict"), [("encoder_bias", 1), ("healthy", 0)])
def test_printed_executive_runs_a_calibration(mission, scenario, verdict):
    done, status, log = mission(scenario)
    assert done.returncode == 0, done.stdout + done.stderr + log
    found = re.fullmatch(r"verdict (\d), kinematics table ([0-9a-f]{8}) in force\n", done.stdout)
    assert found, done.stdout
    assert int(found[1]) == verdict
    nominal = (ROOT / "tables/bin/kin.tbl").read_bytes()[12:16][::-1].hex()
    assert (found[2] == nominal) == (verdict == 0)
    # the simulator ends because the executive left
    assert status == 0, log
