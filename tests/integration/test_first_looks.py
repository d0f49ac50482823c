"""Arms beyond what the ground proved motions for, over LCM: flight finds out by its first looks, the arm
stays near where it stood, nothing touches, and `kincal run` says why."""

import re
import subprocess
import sys

import numpy as np
import pytest
from flight import KIN, ROOT, SAFE
from test_motion import CMD, FIRST, SPACE, Session

from kincal import lcmlog, tables

ABORTED, PROPOSED = 75, 80
STRAY, NOT_SEEN = 9, 10
HOME = np.array(list(SPACE.hub_q[0])[:7])
NODS = np.array([list(SPACE.cand[i].q_seed)[:7] for i in FIRST]) - HOME
NEAR_RAD = np.max(np.abs(NODS)) + 0.002  # as far as first looks go, an arm at rest being off a little
ARMS = {
    "an elbow encoder that is far off": '"J4.phi_rad" = 0.6',
    "a link that is bent by more than any that was proven": '"J2.alpha_rad" = 0.9',
    "a wrist that is turned": '"J6.phi_rad" = 1.2',
}


def scenario(folder, errors):
    path = folder / "beyond.toml"
    path.write_text(f'title = "beyond"\n[arm.errors]\n{errors}\n[expect]\nverdict = "change"\n')
    return path


class Watched(Session):
    """Looks at every tick where the arm is by its encoders and what it truly touches there."""

    def __init__(self, *args):
        super().__init__(*args)
        self.been, self.contacts = [], set()

    def step(self):
        said = super().step()
        t_s = self.now_us * 1e-6
        q = self.world.controller.mover.at(t_s)[0]
        if not self.been or not np.array_equal(q, self.been[-1]):
            self.been.append(q)
            self.world._stand(q, self.world.head.mover.at(t_s)[0])
            self.contacts |= set(self.world.arm.collisions())
        return said


@pytest.mark.parametrize("errors", ARMS.values(), ids=ARMS)
def test_an_arm_that_no_correction_explains_stays_where_it_stood(tmp_path, errors):
    with Watched(tmp_path, scenario(tmp_path, errors)) as f:
        f.calibrate(20)
        (end,) = f.events(ABORTED)
        assert int(end.got) in (STRAY, NOT_SEEN)
        assert f.measured() == [] and 0 < len(f.of("KC_MEAS")) <= len(FIRST)
        assert f.of("KC_PROPOSAL") == [] and f.events(PROPOSED) == []
        first, last = f.of("KC_HK")[0], f.of("KC_HK")[-1]
        assert last.state == SAFE and last.table_crc[KIN] == first.table_crc[KIN] != 0
        off = np.abs(np.array(f.been) - HOME).max(axis=0)
        assert np.all(off <= NEAR_RAD) and off.max() > 0.1
        assert f.contacts == set()
        assert f.do(CMD.START, -1, 20, 1).status == 0  # it can be asked again, from where it is


def test_kincal_run_says_why_in_plain_words_and_leaves_the_table_alone(tmp_path):
    words = ["run", scenario(tmp_path, ARMS["an elbow encoder that is far off"]), "--fast", "--no-compare"]
    done = subprocess.run(
        [sys.executable, "-m", "kincal", *map(str, words), "--out", str(tmp_path / "out")],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert done.returncode == 1, done.stdout + done.stderr
    said = " ".join(done.stdout.split())
    assert "no correction within its bounds explains what was seen, so the arm goes nowhere else" in said
    assert "verdict: no proposal; decision: flight gave" in said and "nan" not in said
    lines = re.findall(r"^ ?\d+/\d+ +(\S+) ", done.stdout, re.M)
    assert lines and set(lines) == {"first"}
    log = lcmlog.read(tmp_path / "out" / "run.lcmlog")
    kin = (ROOT / "tables" / "bin" / "kin.tbl").read_bytes()
    assert log.hk.table_crc[KIN] & 0xFFFFFFFF == tables.header(kin).crc
