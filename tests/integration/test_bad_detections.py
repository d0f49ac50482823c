"""A single bad detection at any local initial pose: the calibration goes on without it. An arm
outside its bounds repeats what it shows, and is still recognised."""

import copy
import shutil

import numpy as np
import pytest
from flight import CAUSE, STATE

from kincal.flight import tables as codec
from kincal.run.inprocess import TABLES, Hooks, Script, Setup, command, simulate
from kincal_sim.transforms import quaternion, rot, rotation_matrix
from kincal_sim.vision.camera import load_config

N_LOCAL = 14
TAGS = load_config().tags


def offset(R, p):
    """5 cm beside."""
    return R, p + [0.03, -0.04, 0.0]


def flipped(R, p):
    """Tilted to the other side: 40 deg."""
    return rot("x", 0.7)[:3, :3] @ R, p


def of_the_other_tag(R, p):
    """The corners of one tag under the number of the other."""
    one, other = (t.T_tool_tag for t in TAGS)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, p
    T = T @ one @ np.linalg.inv(other)
    return T[:3, :3], T[:3, 3]


def spoiled(m, wrong):
    """A copy of a detection with the wrong pose, and no second one that would be right."""
    m = copy.deepcopy(m)
    R, p = wrong(rotation_matrix(m.q_cam_tool_wxyz), np.array(m.p_cam_tool_m))
    m.p_cam_tool_m = m.p_alt_m = p.tolist()
    m.q_cam_tool_wxyz = m.q_alt_wxyz = quaternion(R).tolist()
    return m


class BadAt:
    """Hooks: all frames of measurement number `bad` (from 1) are spoiled."""

    def __init__(self, bad, wrong):
        self.bad, self.wrong, self.measured = bad, wrong, 0

    def from_flight(self, _tick, messages):
        self.measured += sum(channel == "KC_MEAS" for channel, _ in messages)
        return messages

    def to_flight(self, _tick, messages):
        if self.measured != self.bad - 1:
            return messages
        return tuple(
            (ch, spoiled(m, self.wrong) if ch == "KC_DETECTION" and m.n_tags > 0 else m) for ch, m in messages
        )

    def hooks(self):
        return Hooks(to_flight=self.to_flight, from_flight=self.from_flight)


def tables_with(initial_design, folder):
    """The shipped tables, but for the initial design."""
    shutil.copytree(TABLES, folder)
    _, config = codec.decode_as("config", (TABLES / "config.tbl").read_bytes())
    config.initial_design = initial_design
    (folder / "config.tbl").write_bytes(codec.encode("config", config).data)
    return folder


@pytest.fixture(scope="session")
def by_information(tmp_path_factory):
    """Initial poses are chosen by information."""
    return tables_with(1, tmp_path_factory.mktemp("information") / "tables")


@pytest.fixture(scope="session")
def by_table(tmp_path_factory):
    """All initial poses, in the order of SPACE."""
    return tables_with(0, tmp_path_factory.mktemp("table") / "tables")


def flown(scenario, bad, tables):
    """Until the first pose after the local ones."""
    start = (2, command("START", -1, 6, 1))

    def each_tick(tick):
        stopped = tick.number > 10 and tick.state in (STATE["IDLE"], STATE["SAFE"])
        return not stopped and bad.measured < N_LOCAL + 2

    setup = Setup(tables, commander=lambda send: Script(send, (start,)), hooks=bad.hooks())
    return simulate(scenario, 1, setup, each_tick=each_tick)


def names(run):
    return [e.name for e in run.log.events]


@pytest.mark.parametrize("wrong", [offset, flipped, of_the_other_tag])
@pytest.mark.parametrize("k", range(1, N_LOCAL + 1))
def test_a_single_bad_detection_at_any_local_initial_pose_does_not_end_a_calibration(k, wrong, by_table):
    left_out(flown("paper", BadAt(k, wrong), by_table), k)


@pytest.mark.parametrize("wrong", [offset, flipped, of_the_other_tag])
@pytest.mark.parametrize("k", [1, 2, 3])
def test_a_bad_detection_at_a_chosen_local_initial_pose_begins_anew(k, wrong, by_information):
    run = flown("paper", BadAt(k, wrong), by_information)
    assert "CAL_ABORTED" not in names(run)
    assert names(run).count("CAL_DOUBT") == 1
    assert "CAL_LEAVES_PARK" not in names(run)
    assert "CAL_OUTLIER" not in names(run)[names(run).index("CAL_DOUBT") :]  # the bad one is not used


def left_out(run, k):
    """Pose k, and no other, was left out and measured again."""
    assert "CAL_ABORTED" not in names(run)
    out = {}
    for e in run.log.events:
        if e.name in ("CAL_OUTLIER", "CAL_OUTLIER_ACCEPTED"):
            out[e.index] = e.name == "CAL_OUTLIER"
    assert [pose for pose, is_out in out.items() if is_out] == [k]
    candidates = [m.candidate for m in run.log.last_session.measurements]
    assert candidates.count(candidates[k - 1]) == 2


def test_a_bad_detection_leaves_the_correction_as_good_as_without_it():
    clean, spoiled_run = (
        simulate("paper", 3, Setup(hooks=BadAt(k, of_the_other_tag).hooks())) for k in (0, 5)
    )
    assert clean.record["verdict"] == spoiled_run.record["verdict"] == "change"
    sigma = np.array(clean.log.last_session.proposal.sigma[:28])
    a, b = (np.array(r.log.last_session.proposal.value[:28]) for r in (clean, spoiled_run))
    assert np.all(np.abs(a - b) < 6.0 * sigma)


@pytest.mark.parametrize("tables", ["by_table", "by_information"])
@pytest.mark.parametrize("k", [1, 3, 6])
def test_an_arm_outside_its_bounds_is_recognised_with_a_bad_detection_too(tmp_path, k, tables, request):
    path = tmp_path / "beyond.toml"
    path.write_text('title = "beyond"\n[arm.errors]\n"J4.phi_rad" = 0.6\n[expect]\nverdict = "change"\n')
    run = flown(path, BadAt(k, offset), request.getfixturevalue(tables))
    (end,) = (e for e in run.log.events if e.name == "CAL_ABORTED")
    assert int(end.got) in (CAUSE["MODEL_MISMATCH"], CAUSE["TAGS_NOT_DETECTED"])
    assert run.state == STATE["SAFE"]
