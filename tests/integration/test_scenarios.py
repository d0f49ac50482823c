"""Scenario files, the processes around flight, and whole calibrations in the fast mode."""

import json
import os
import signal
import subprocess
import sys
import time
from functools import partial

import numpy as np
import pytest
from runs import FAKE_FSW, ROOT, coefficient_names, fake_run, fly, held_out_rms, messages, raw, running_with

import kcm
from kincal import core, tables
from kincal_sim import launch, server
from kincal_sim.arm import Arm
from kincal_sim.camera import load_config
from kincal_sim.executive import Executive
from kincal_sim.fastcam import visible_tags
from kincal_sim.scenario import SCENARIO_DIR, ScenarioError, load
from kincal_sim.world import World

FLIGHT_CHANNELS = (
    "KC_ARM_CMD",
    "KC_PANTILT_CMD",
    "KC_FRAME_REQUEST",
    "KC_ACK",
    "KC_EVENT",
    "KC_HK",
    "KC_MEAS",
    "KC_PROGRESS",
    "KC_PROPOSAL",
)


def no_eye(*_):
    return "KC_DETECTION", lambda _frame: kcm.detection_t()


# -- scenario files ---------------------------------------------------------------------------------


@pytest.mark.parametrize("path", sorted(SCENARIO_DIR.glob("*.toml")), ids=lambda p: p.stem)
def test_every_scenario_loads_and_gives_200_held_out_poses_inside_limits_and_region(path):
    scenario = load(path)
    world = World(scenario, 3, no_eye)
    record = world.truth_record("fast")
    assert json.loads(json.dumps(record)) == record
    q = np.array([p["q_rad"] for p in record["held_out"]])
    p = np.array([p["p_m"] for p in record["held_out"]])
    assert len(q) == 200 and np.all(q >= world.arm.q_min) and np.all(q <= world.arm.q_max)
    region = world.arm.spec["region"]
    assert np.all(p >= region["min_m"]) and np.all(p <= region["max_m"])
    assert World(scenario, 3, no_eye).held_out() == record["held_out"]
    assert World(scenario, 4, no_eye).held_out() != record["held_out"]


@pytest.mark.parametrize("name", ["paper", "encoder_bias"])
def test_the_named_true_values_explain_the_held_out_poses_exactly(name):
    record = World(load(name), 1, no_eye).truth_record("fast")
    assert held_out_rms(record, record["errors"])[0] < 1e-12
    assert held_out_rms(record, {})[0] > 0.02


def test_the_paper_scenario_is_the_error_set_of_the_paper():
    assert load("paper").coefficients() == {
        "J7.phi_rad": 1.3,
        "J2.alpha_rad": 0.4,
        "J3.a_m": 0.01,
        "J3.d_m": 0.15,
    }


@pytest.mark.parametrize(
    "text, message",
    [
        ("[arm]\nencoder_bais_rad = {}", "unknown key 'encoder_bais_rad'"),
        ("[arm.errors]\n'J9.phi_rad' = 0.1", "unknown error 'J9.phi_rad'"),
        ("[arm.encoder_bias_rad]\nJ0 = 0.1", "unknown joint 'J0'"),
        ("[executive]\naccept = 'perhaps'", "'perhaps' is not one of ground, auto, policy"),
        ("[calibration]\nacquisition = 'best'", "'best' is not one of"),
        ("[expect]\nverdict = 'good'", "'good' is not one of"),
        ("weather = 1", "unknown key 'weather'"),
    ],
)
def test_a_slip_in_a_scenario_is_named(tmp_path, text, message):
    (tmp_path / "bad.toml").write_text(text)
    with pytest.raises(ValueError, match=message):
        load(tmp_path / "bad.toml")


def test_an_unknown_scenario_lists_the_known_ones():
    known = "known: compliance, encoder_bias, healthy, hidden_compliance, paper"
    with pytest.raises(ScenarioError, match=known):
        load("papers")


# -- executive: given what flight says, then what it does -------------------------------------------


class Flight:
    """Feeds an executive by hand."""

    def __init__(self, **limits):
        scenario = load("paper")
        for name, value in limits.items():
            setattr(scenario.executive, name, value)
        self.sent, self.t_us, self.alive = [], 0, True
        self.executive = Executive(scenario, self.sent.append)

    def tick(self, *said, after_s=0.1):
        self.t_us += round(after_s * 1e6)
        self.alive = self.executive.tick(self.t_us, list(said))

    def decide(self, **proposal):
        """The proposal comes; one phase follows another tick by tick."""
        self.tick(self.proposal(**proposal))
        self.tick()

    def hk(self, state=1, kin=0, n_poses=0, proposal_crc=7):
        m = kcm.hk_t()
        m.t_us, m.state, m.n_poses, m.proposal_crc = self.t_us, state, n_poses, proposal_crc
        m.table_crc = [0, 0, 0, 0, kin, 0, 0, 0]
        return "KC_HK", m

    def ack(self, status=0):
        m = kcm.ack_t()
        m.source, m.seq, m.opcode, m.status = 1, self.sent[-1].seq, self.sent[-1].opcode, status
        return "KC_ACK", m

    def aborted(self, cause):
        m = kcm.event_t()
        m.id, m.severity, m.got = 75, 2, cause
        return "KC_EVENT", m

    def proposal(self, verdict=kcm.proposal_t.CHANGE, **fields):
        m = kcm.proposal_t()
        m.crc, m.verdict = 7, verdict
        for name, value in fields.items():
            setattr(m, name, value)
        return "KC_PROPOSAL", m

    def ready(self):
        """Arm and head are there, and a first heartbeat."""
        self.tick(
            ("KC_ARM_STATE", kcm.arm_state_t()), ("KC_PANTILT_STATE", kcm.pantilt_state_t()), self.hk(0)
        )

    def started(self):
        self.ready()
        self.tick(self.ack())
        self.tick(self.hk(1))
        return self

    @property
    def opcodes(self):
        return [m.opcode for m in self.sent]


START, ABORT, ARM, GO = kcm.cmd_t.START, kcm.cmd_t.ABORT, kcm.cmd_t.APPROVE_ARM, kcm.cmd_t.APPROVE_GO


def test_executive_starts_when_flight_arm_and_head_are_there_and_approves_in_two_steps():
    f = Flight()
    f.tick()
    f.tick(f.hk(0))
    f.tick(("KC_ARM_STATE", kcm.arm_state_t()))
    assert f.sent == []
    f.started()
    f.decide()
    assert f.opcodes == [START, ARM]
    f.tick(f.ack())
    assert f.opcodes == [START, ARM, GO] and [m.arg_i[0] for m in f.sent[1:]] == [7, 7]
    assert [m.seq for m in f.sent] == [1, 2, 3]
    f.tick(f.ack(), f.hk(0, kin=7))
    assert f.executive.result["success"] and f.alive
    f.tick(f.hk(0, kin=7), after_s=2.5)
    assert not f.alive


@pytest.mark.parametrize(
    "proposal, reason",
    [
        ({"pred_pos_m": 0.5}, "predicted position sigma 0.5"),
        ({"pred_rot_rad": float("nan")}, "predicted rotation sigma nan"),
        ({"n_outliers": 99}, "outliers 99"),
        ({"verdict": kcm.proposal_t.POOR}, "the fit is poor"),
    ],
)
def test_executive_approves_nothing_outside_its_limits(proposal, reason):
    f = Flight().started()
    f.decide(**proposal)
    assert f.opcodes == [START]
    assert not f.executive.result["success"] and reason in f.executive.result["reason"]


def test_executive_says_who_is_not_there():
    f = Flight()
    for _ in range(31):
        f.tick(f.hk(0), after_s=1.0)
    assert f.executive.result["reason"] == "no arm state and no head state" and f.sent == []


def test_executive_leaves_the_decision_to_the_ground():
    f = Flight(accept="ground").started()
    f.decide()
    f.tick(f.hk(9))
    assert f.opcodes == [START] and f.executive.result["success"]


def test_executive_waits_for_the_policy_on_board():
    f = Flight(accept="policy").started()
    f.decide()
    f.tick(f.hk(0, kin=7))
    assert f.opcodes == [START] and f.executive.result["reason"] == "accepted on board"


def test_executive_takes_nothing_needs_to_change_for_success():
    f = Flight().started()
    f.decide(verdict=kcm.proposal_t.NO_CHANGE)
    assert f.opcodes == [START] and f.executive.result["verdict"] == "no_change"
    assert f.executive.result["success"]


def test_executive_aborts_when_the_heartbeat_stops():
    f = Flight().started()
    for _ in range(49):
        f.tick()
    assert f.opcodes == [START]
    f.tick()
    f.tick()
    assert f.opcodes == [START, ABORT] and "heartbeat lost" in f.executive.result["reason"]
    f.tick(f.ack())
    f.tick(after_s=2.5)
    assert not f.alive and not f.executive.result["success"]


def test_executive_aborts_when_a_pose_takes_too_long_but_not_while_poses_come():
    f = Flight(pose_timeout_s=20.0).started()
    for pose in range(5):
        for _ in range(15):
            f.tick(f.hk(1, n_poses=pose), after_s=1.0)
    assert f.opcodes == [START]
    for _ in range(10):
        f.tick(f.hk(1, n_poses=4), after_s=1.0)
    assert f.opcodes == [START, ABORT] and "no new pose" in f.executive.result["reason"]


@pytest.mark.parametrize(
    "what, reason",
    [
        (lambda f: f.tick(f.hk(11)), "flight gave the calibration up"),
        (lambda f: f.tick(f.aborted(9), f.hk(11)), "up: no correction within its bounds explains"),
        (lambda f: f.tick(f.aborted(10), f.hk(11)), "up: too few of the first looks saw a tag"),
        (lambda f: f.tick(f.aborted(99), f.hk(11)), "flight gave the calibration up"),
        (lambda f: [f.tick(f.hk(0), after_s=1.1) for _ in range(3)], "idle and proposed nothing"),
    ],
)
def test_executive_notices_when_flight_stopped_by_itself(what, reason):
    f = Flight().started()
    what(f)
    assert reason in f.executive.result["reason"] and f.opcodes == [START]


def test_executive_gives_up_when_a_command_is_refused_or_not_answered():
    f = Flight()
    f.ready()
    f.tick(f.ack(status=-1))
    assert "refused" in f.executive.result["reason"]
    f = Flight()
    f.ready()
    for _ in range(4):
        f.tick(f.hk(0), after_s=1.0)
    assert "not answered" in f.executive.result["reason"]


# -- processes, with a fake in flight's place -------------------------------------------------------


@pytest.mark.parametrize(
    "scenario, script, ok, problem",
    [
        ("paper", "change", True, ""),
        ("healthy", "healthy", True, ""),
        ("paper", "healthy", False, "verdict no_change, the scenario expects change"),
        ("paper", "poor", False, "the fit is poor"),
        ("paper", "refuse", False, "refused"),
        ("paper", "mute", False, "heartbeat lost"),
    ],
)
def test_launch_reports_how_it_ended_and_leaves_nothing_running(tmp_path, scenario, script, ok, problem):
    result = launch.execute(fake_run(tmp_path, scenario, script))
    assert result["ok"] is ok and problem in result["problem"]
    assert running_with(result["url"]) == []
    assert result["touched"] == {}
    truth = json.loads((tmp_path / "out" / "truth.json").read_text())
    assert truth["errors"] == load(scenario).coefficients()
    heard = raw(tmp_path / "out" / "run.lcmlog")
    assert {"KC_TIME", "KC_ARM_STATE", "KC_PANTILT_STATE", "KC_SIM_TRUTH", "KC_HK"} <= set(heard)


def test_a_process_that_dies_is_named_with_its_last_words(tmp_path):
    with pytest.raises(launch.LaunchError, match=r"fsw ended with status 7:\n.*crashes on purpose"):
        launch.execute(fake_run(tmp_path, script="crash"))
    assert running_with(str(tmp_path)) == []


def test_missing_programs_and_tables_are_named_before_anything_starts(tmp_path):
    run = fake_run(tmp_path)
    run.fsw_bin = tmp_path / "nothing"
    with pytest.raises(launch.LaunchError, match="nothing is missing; run `make`"):
        launch.execute(run)
    run = fake_run(tmp_path)
    (run.tables / "none.tbl").unlink()
    with pytest.raises(launch.LaunchError, match="no tables in"):
        launch.execute(run)
    assert not (tmp_path / "out").exists()


def test_an_interrupted_launch_stops_everything_it_started(tmp_path):
    run = fake_run(tmp_path, script="stuck")
    argv = [
        sys.executable,
        "-m",
        "kincal_sim.launch",
        "paper",
        "--fast",
        "--out",
        run.out,
        "--realtime",  # in lockstep a stuck flight process soon ends the run by itself
        "--fsw",
        FAKE_FSW,
        "--tables",
        run.tables,
        "--store",
        run.store,
    ]
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    pipe = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    # What a shell started in the background is deaf to SIGINT, and so would be all it starts.
    hear = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    with subprocess.Popen(argv, **pipe, env=env, preexec_fn=hear) as p:
        line = p.stdout.readline()
        assert line, p.stderr.read()
        first = json.loads(line)
        log = run.out / "run.lcmlog"
        deadline = time.monotonic() + 20
        while (not log.exists() or log.stat().st_size == 0) and time.monotonic() < deadline:
            time.sleep(0.05)
        assert len(running_with(first["url"])) == 3
        p.send_signal(signal.SIGINT)
        try:
            _, err = p.communicate(timeout=20)
        finally:
            p.kill()
    assert p.returncode == 130 and "all processes stopped" in err, err
    assert running_with(first["url"]) == []


def test_launches_side_by_side_get_networks_of_their_own():
    taken = [launch.private_port() for _ in range(20)]
    try:
        assert len({port for port, _ in taken}) == 20
    finally:
        for _, lock in taken:
            lock.close()


def test_two_runs_with_one_seed_say_the_same_to_the_byte_and_another_seed_does_not(tmp_path):
    logs = []
    for k, seed in enumerate((5, 5, 6)):
        launch.execute(fake_run(tmp_path / str(k), seed=seed))
        logs.append(raw(tmp_path / str(k) / "out" / "run.lcmlog"))
    first, again, other = ({c: m for c, m in log.items() if c != "KC_TICK_DONE"} for log in logs)
    assert {c: len(m) for c, m in first.items()} == {c: len(m) for c, m in again.items()}
    for channel in first:
        assert first[channel] == again[channel], channel
    assert kcm.detection_t.decode(first["KC_DETECTION"][-1]).n_tags > 0
    assert first["KC_DETECTION"] != other["KC_DETECTION"]


def test_a_tick_is_announced_again_until_it_is_answered(monkeypatch):
    """A lost KC_TIME or KC_TICK_DONE costs a second, not the run."""
    monkeypatch.setattr(server, "REPEAT_S", 0.01)
    said = []

    class Bus:
        def listen(self, _channel, handler):
            self.handler = handler

        def publish(self, channel, m):
            said.append((channel, m.tick))

        def wait(self, seconds):
            if len(said) < 3:
                time.sleep(seconds)
                return
            done = kcm.tick_done_t()
            done.tick, done.who = 8, 1
            self.handler("KC_TICK_DONE", done)

    server.Lockstep(Bus(), {1}).tick(8, 800_000)
    assert said == [("KC_TIME", 8)] * 3
    monkeypatch.setattr(server, "REPEATS_MAX", 2)
    said.clear()
    with pytest.raises(server.Silent, match="tick 9 was not answered by fsw"):
        server.Lockstep(Bus(), {1}).tick(9, 900_000)


# -- whole calibrations with the flight process, fast mode ------------------------------------------


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Each scenario flown once."""
    done = {}

    def get(name):
        if name not in done:
            out = tmp_path_factory.mktemp(name)
            done[name] = (fly(out, name), out)
        return done[name]

    return get


def proposal_of(out):
    return messages(out / "run.lcmlog", "KC_PROPOSAL")[-1]


@pytest.mark.parametrize("name", ["paper", "encoder_bias"])
def test_a_calibration_finds_the_errors_within_its_own_sigma(runs, name):
    result, out = runs(name)
    assert result["ok"], result["problem"]
    truth, p, names = json.loads((out / "truth.json").read_text()), proposal_of(out), coefficient_names()
    free = [i for i in range(p.n_coef) if p.status[i] != 1]
    estimate = {names[i]: p.value[i] for i in free}
    pos_m, rot_rad = held_out_rms(truth, estimate)
    expect = load(name).expect
    assert pos_m <= expect.held_out_pos_m and rot_rad <= expect.held_out_rot_rad
    inside = [abs(p.value[i] - truth["errors"].get(names[i], 0.0)) <= 3 * p.sigma[i] for i in free]
    assert np.mean(inside) >= 0.95
    assert result["table_crc_kin"] == result["crc"]


def test_a_healthy_arm_needs_no_change(runs):
    result, out = runs("healthy")
    assert result["ok"], result["problem"]
    assert result["verdict"] == "no_change" and proposal_of(out).p_no_change > 0.01
    kin = {m.table_crc[4] for m in messages(out / "run.lcmlog", "KC_HK")}
    assert len(kin) == 1


def test_a_hidden_compliance_is_called_a_poor_fit_and_changes_nothing(runs):
    result, out = runs("compliance")
    assert not result["ok"] and result["verdict"] == "poor"
    assert proposal_of(out).p_fit < 1e-3
    assert len({m.table_crc[4] for m in messages(out / "run.lcmlog", "KC_HK")}) == 1


def test_flight_telemetry_is_the_same_to_the_byte_for_one_seed(runs, tmp_path):
    _, out = runs("paper")
    fly(tmp_path, "paper")
    first, again = raw(out / "run.lcmlog"), raw(tmp_path / "run.lcmlog")
    for channel in FLIGHT_CHANNELS:
        assert first.get(channel, []) == again.get(channel, []), channel


def test_the_flight_model_explains_the_simulated_truth():
    """Two independent kinematics, one truth: exact for geometry, second order in the give for compliance."""
    arm, terms = (
        tables.decode((ROOT / "tables" / "bin" / f"{k}.tbl").read_bytes())[1] for k in ("arm", "terms")
    )
    model, names = core.Model(arm, terms), coefficient_names()
    for name, allowed_m in (("paper", 1e-12), ("encoder_bias", 1e-12), ("compliance", 2e-4)):
        record = World(load(name), 1, no_eye).truth_record("fast")
        coef = np.zeros(len(names))
        for key, value in record["errors"].items():
            coef[names.index(key)] = value
        worst, nominal = (
            max(
                np.linalg.norm(model.eval(h["q_rad"], c, want_J=False).T.p_m - h["p_m"])
                for h in record["held_out"]
            )
            for c in (coef, None)
        )
        assert worst < allowed_m < 0.1 * nominal


def test_every_candidate_and_the_way_to_it_is_clear_and_shows_a_tag_in_the_simulated_world():
    """The ground proved the search space with its own shapes; MuJoCo has the second opinion."""
    space = tables.decode((ROOT / "tables" / "bin" / "space.tbl").read_bytes())[1]
    arm = Arm()
    cfg = load_config(arm.spec)
    for c in (space.cand[i] for i in range(space.n_cand)):
        q = np.array([c.q_seed[j] for j in range(arm.n)])
        hub = np.array([space.hub_q[c.hub][j] for j in range(arm.n)])
        for s in np.linspace(0.0, 1.0, 12):
            arm.set(hub + s * (q - hub), c.pan_rad, c.tilt_rad)
            assert arm.collisions() == []
        assert visible_tags(cfg, arm.model, arm.data, arm.T_base_cam, arm.T_base_tool)
