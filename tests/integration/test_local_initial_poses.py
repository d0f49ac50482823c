"""Arms beyond the error bounds, over LCM: flight finds out at the local initial poses, the arm stays near its
park pose, nothing touches, and `kincal run` says why."""

import re
import subprocess
import sys

import numpy as np
import pytest
from flight import CAUSE, KIN, ROOT, SAFE
from test_motion import CMD, LOCAL, SPACE, Session

from kincal import link
from kincal.flight import tables as codec

PARK = np.array(list(SPACE.hub_q[0])[:7])
LOCAL_MOTIONS = np.array([list(SPACE.cand[i].q_seed)[:7] for i in LOCAL]) - PARK
NEAR_RAD = np.max(np.abs(LOCAL_MOTIONS)) + 0.002  # an arm at rest is off a little
ARMS = {
    "an elbow encoder that is far off": '"J4.phi_rad" = 0.6',
    "a link that is bent by more than its error bound": '"J2.alpha_rad" = 0.9',
    "a wrist that is turned": '"J6.phi_rad" = 1.2',
}


def scenario(folder, errors):
    path = folder / "beyond.toml"
    path.write_text(f'title = "beyond"\n[arm.errors]\n{errors}\n[expect]\nverdict = "change"\n')
    return path


class RecordedSession(Session):
    """Notes at every tick where the arm is by its encoders and what it truly touches there."""

    def __init__(self, *args):
        super().__init__(*args)
        self.been, self.contacts = [], set()

    def step(self):
        heard = super().step()
        t_s = self.now_us * 1e-6
        q = self.world.controller.trajectory.at(t_s)[0]
        if not self.been or not np.array_equal(q, self.been[-1]):
            self.been.append(q)
            self.world.settle(q, self.world.pantilt.trajectory.at(t_s)[0])
            self.contacts |= set(self.world.arm.collisions())
        return heard


@pytest.mark.parametrize("errors", ARMS.values(), ids=ARMS)
def test_an_arm_that_no_correction_explains_stays_at_its_park_pose(tmp_path, errors):
    with RecordedSession(tmp_path, scenario(tmp_path, errors)) as f:
        f.calibrate(20)
        (end,) = f.events("CAL_ABORTED")
        assert int(end.got) in (CAUSE["MODEL_MISMATCH"], CAUSE["TAGS_NOT_DETECTED"])
        assert f.measured() == [] and 0 < len(f.of("KC_MEAS")) <= len(LOCAL)
        assert f.of("KC_PROPOSAL") == [] and f.events("COR_PROPOSED") == []
        first, last = f.of("KC_HK")[0], f.of("KC_HK")[-1]
        assert last.state == SAFE and last.table_crc[KIN] == first.table_crc[KIN] != 0
        off = np.abs(np.array(f.been) - PARK).max(axis=0)
        assert np.all(off <= NEAR_RAD) and off.max() > 0.1
        assert f.contacts == set()
        assert f.do(CMD.START, -1, 20, 1).status == 0  # it can be asked again, from where it is


def test_kincal_run_names_the_cause_and_leaves_the_table_alone(tmp_path):
    path = scenario(tmp_path, ARMS["an elbow encoder that is far off"])
    args = ["run", path, "--fast", "--no-compare", "--no-summary"]
    done = subprocess.run(
        [sys.executable, "-m", "kincal", *map(str, args), "--out", str(tmp_path / "out")],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert done.returncode == 1, done.stdout + done.stderr
    text = " ".join(done.stdout.split())
    assert "no correction within its bounds explains the observations" in text
    assert "verdict: no proposal; decision: flight aborted" in text and "nan" not in text
    lines = re.findall(r"^ ?\d+/\d+ +(\S+) ", done.stdout, re.M)
    assert lines and set(lines) == {"local"}
    log = link.read_log(tmp_path / "out" / "run.lcmlog")
    kin = (ROOT / "tables" / "bin" / "kin.tbl").read_bytes()
    assert log.hk.table_crc[KIN] & 0xFFFFFFFF == codec.header(kin).crc
