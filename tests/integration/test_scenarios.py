"""Scenario files, the processes around flight, and whole calibrations in the fast mode."""

import json
import os
import signal
import subprocess
import sys
import time
import tomllib
from functools import partial

import numpy as np
import pytest
from flight import CAUSE, CORE, EVENT, KIN, ROOT, STATE, TABLES, read_table
from runs import (
    FAKE_FSW,
    coefficient_names,
    fake_run,
    fly,
    held_out_rms,
    messages,
    payloads,
    running_with,
)

import kcm
from kincal.flight import Arm as FlightArm
from kincal.flight import Model, Observations, Terms
from kincal.run import Request, perform
from kincal.run.inprocess import Setup, Store, simulate
from kincal_shared.errors import BadInput
from kincal_sim import executive, lockstep, outputs, ports, run, transforms
from kincal_sim.executive import Executive
from kincal_sim.mechanics.arm import Arm
from kincal_sim.mechanics.plant import Conditions, Effect
from kincal_sim.randomness import generator
from kincal_sim.scenario import SCENARIO_DIR, load
from kincal_sim.truth import build_plant, conditions, held_out_poses, true_coefficients, truth_record
from kincal_sim.vision.camera import load_config
from kincal_sim.vision.detection_model import visible_tags
from kincal_sim.vision.imagers import Imager
from kincal_sim.world import World

COMPARED = ("paper", "healthy")
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


def blind_imager(*_):
    return Imager("KC_DETECTION", lambda _exposure: kcm.detection_t())


def record_of(name, seed=1):
    """What truth.json of a run holds."""
    scenario = load(name)
    return truth_record(scenario, World(scenario, seed, blind_imager).plant, seed, "fast")


# -- scenario files ---------------------------------------------------------------------------------


@pytest.mark.parametrize("path", sorted(SCENARIO_DIR.glob("*.toml")), ids=lambda p: p.stem)
def test_every_scenario_loads_and_gives_200_held_out_poses_inside_limits_and_region(path):
    scenario = load(path)
    world = World(scenario, 3, blind_imager)
    record = truth_record(scenario, world.plant, 3, "fast")
    assert json.loads(json.dumps(record)) == record
    q = np.array([p["q_rad"] for p in record["held_out"]])
    p = np.array([p["p_m"] for p in record["held_out"]])
    assert len(q) == 200 and np.all(q >= world.arm.q_min) and np.all(q <= world.arm.q_max)
    region = world.arm.spec["region"]
    assert np.all(p >= region["min_m"]) and np.all(p <= region["max_m"])
    assert held_out_poses(scenario, world.plant, 3) == record["held_out"]
    assert held_out_poses(scenario, world.plant, 4) != record["held_out"]


@pytest.mark.parametrize("name", ["paper", "encoder_bias", "compliance"])
def test_held_out_poses_are_those_of_one_try_after_the_other(name):
    scenario = load(name)
    plant = build_plant(scenario, pictures=False)
    want = one_try_after_the_other(scenario, plant, 5, 20)
    nowhere = Conditions(q_rad=np.zeros(7), payload_kg=scenario.env.payload_kg)
    plant.settle(nowhere, [*plant.effects, FarTool()])  # what that moved is back where it was
    assert held_out_poses(scenario, plant, 5, 20) == want


class FarTool(Effect):
    """The tool is a metre farther away."""

    def body_offsets(self, _at, _loads):
        return {"tool": transforms.trans(1.0, 0.0, 0.0)}


def one_try_after_the_other(scenario, plant, seed, n):
    rng, rng_sides = generator(seed, "held out"), generator(seed, "held out sides")
    arm, region, found = plant.arm(scenario.env.payload_kg), plant.spec["region"], []
    while len(found) < n:
        q, side = rng.uniform(arm.q_min, arm.q_max), rng_sides.choice([-1, 1], arm.n)
        T = plant.settle(conditions(scenario, q, side)).T_base_tool
        p_m, q_wxyz = T[:3, 3], transforms.quaternion(T)
        if np.all(p_m >= region["min_m"]) and np.all(p_m <= region["max_m"]):
            columns = {"q_rad": q, "dir": side, "p_m": p_m, "q_wxyz": q_wxyz}
            found.append({key: value.tolist() for key, value in columns.items()})
    return found


@pytest.mark.parametrize("name", ["paper", "encoder_bias"])
def test_the_named_true_values_explain_the_held_out_poses_exactly(name):
    record = record_of(name)
    assert held_out_rms(record, record["errors"])[0] < 1e-12
    assert held_out_rms(record, {})[0] > 0.02


def test_the_paper_scenario_is_the_error_set_of_the_paper():
    assert true_coefficients(load("paper")) == {
        "J7.phi_rad": 1.3,
        "J2.alpha_rad": 0.4,
        "J3.a_m": 0.01,
        "J3.d_m": 0.15,
    }


@pytest.mark.parametrize(
    "text, message",
    [
        ("[arm]\nencoder_bais_rad = {}", "arm.encoder_bais_rad: unknown key; write encoder_bias_rad"),
        ("[arm.errors]\n'J9.phi_rad' = 0.1", "unknown error 'J9.phi_rad'"),
        ("[arm.encoder_bias_rad]\nJ0 = 0.1", "'J0' is no joint"),
        (
            "[executive]\naccept = 'perhaps'",
            'executive.accept: is "perhaps"; write "ground" or "auto" or "policy"',
        ),
        ("[calibration]\nacquisition = 'best'", 'calibration.acquisition: is "best"; write "table" or'),
        ("[expect]\nverdict = 'good'", 'expect.verdict: is "good"; write'),
        ("weather = 1", "weather: unknown key"),
    ],
)
def test_a_misspelling_in_a_scenario_is_named(tmp_path, text, message):
    (tmp_path / "bad.toml").write_text(text)
    with pytest.raises(BadInput, match=message):
        load(tmp_path / "bad.toml")


def test_an_unknown_scenario_lists_the_known_ones():
    known = "known: compliance, encoder_bias, healthy, hidden_compliance, paper"
    with pytest.raises(BadInput, match=known):
        load("papers")


# -- executive: given the messages of flight, then its commands -------------------------------------------


class Flight:
    """Feeds an executive by hand."""

    def __init__(self, **limits):
        scenario = load("paper")
        for name, value in limits.items():
            setattr(scenario.executive, name, value)
        self.sent, self.t_us, self.alive = [], 0, True
        self.executive = Executive(scenario, self.sent.append)

    def tick(self, *messages, after_s=0.1):
        self.t_us += round(after_s * 1e6)
        self.alive = self.executive.tick(self.t_us, list(messages))

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
        m.crc, m.verdict, m.p_fit = 7, verdict, 0.5
        for name, value in fields.items():
            setattr(m, name, value)
        return "KC_PROPOSAL", m

    def ready(self):
        """Arm and pan-tilt unit are there, and a first heartbeat."""
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


HELD, AT_LOWER, AT_UPPER = (CORE.constant(f"KC_COEF_{name}") for name in ("HELD", "AT_LOWER", "AT_UPPER"))
START, ABORT, ARM, GO = kcm.cmd_t.START, kcm.cmd_t.ABORT, kcm.cmd_t.APPROVE_ARM, kcm.cmd_t.APPROVE_GO


def test_executive_starts_when_flight_arm_and_pan_tilt_unit_are_there_and_approves_in_two_steps():
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
        ({"pred_pos_m": 0.5}, "predicted position error 0.5"),
        ({"pred_pos_m": 0.0017}, "predicted position error 0.0017 > 0.0016"),
        ({"pred_rot_rad": float("nan")}, "predicted rotation error nan"),
        ({"n_coef": 3, "status": [0, HELD, 0] + 61 * [0]}, "coefficients that are held or at a bound 1 > 0"),
        ({"n_coef": 3, "status": [AT_LOWER, AT_UPPER, 0] + 61 * [0]}, "held or at a bound 2 > 0"),
        ({"n_outliers": 3, "n_poses": 64}, "outliers 3 > 2"),
        ({"n_outliers": 2, "n_poses": 13}, "share of outliers 0.1538 > 0.15"),
        ({"p_fit": 3e-24}, "left to the ground: p of the fit 3e-24 < 0.001"),
        ({"p_fit": float("nan")}, "p of the fit nan"),
        ({"verdict": kcm.proposal_t.POOR}, "the fit is poor"),
    ],
)
def test_executive_approves_nothing_outside_its_limits(proposal, reason):
    f = Flight().started()
    f.decide(**proposal)
    assert f.opcodes == [START]
    assert not f.executive.result["success"] and reason in f.executive.result["reason"]


def test_the_executive_asks_of_a_fit_what_the_policy_on_board_asks():
    config = tomllib.loads((ROOT / "tables/src/config.toml").read_text())
    assert load("paper").executive.p_fit_min == config["accept_p_fit_min"]
    assert load("paper").executive.pred_pos_max_m == config["accept_sigma_max_pos_m"]
    f = Flight(p_fit_min=0.5).started()
    f.decide(p_fit=0.5, n_outliers=2, n_poses=14)
    assert f.opcodes == [START, ARM]


def test_the_numbers_and_causes_of_the_executive_are_those_of_flight():
    states = [STATE[name] for name in ("IDLE", "REVIEW", "SAFE")]
    assert states == [executive.IDLE, executive.REVIEW, executive.SAFE]
    assert (KIN, EVENT["CAL_ABORTED"]) == (executive.TBL_KIN, executive.ABORTED)
    assert executive.UNDETERMINED == (HELD, AT_LOWER, AT_UPPER)
    texts = [CORE.text(CORE.lib.kc_cause_text(number)) for number in CAUSE.values()]
    assert [text for text in texts if text] == list(executive.CAUSES)


def test_the_executive_knows_the_monitor_and_the_event_by_flights_numbers():
    monitor = CORE.enum("kc_mon_state_t", "KC_MON_")
    known = (executive.NAMED, executive.UNEXPLAINED, executive.SEVERAL)
    assert known == (monitor["NAMED"], monitor["UNEXPLAINED"], monitor["SEVERAL"])
    assert EVENT["CAL_NO_PATH"] == executive.NO_PATH


def watching():
    f = Flight()
    f.executive.on_alarm = True
    f.ready()
    f.tick(f.hk(0))
    return f


def alarm(f, state, n_obs=3):
    channel, m = f.hk(0)
    m.mon_state, m.mon_n_obs = state, n_obs
    return channel, m


@pytest.mark.parametrize("state", [1, 3])
def test_executive_starts_on_an_alarm_from_the_suspects(state):
    f = watching()
    for _ in range(40):
        f.tick(f.hk(0), after_s=1.0)
    assert f.sent == []
    f.tick(alarm(f, state))
    assert f.opcodes == [START] and list(f.sent[0].arg_i)[3] == 1
    f.tick(f.ack())
    f.tick(f.hk(1))
    f.decide()
    assert f.opcodes == [START, ARM]


def test_executive_starts_without_suspects_when_the_alarm_stays_unexplained():
    f = watching()
    f.tick(alarm(f, 2, n_obs=4))
    assert f.sent == []
    f.tick(alarm(f, 2, n_obs=5))
    assert f.opcodes == [START] and list(f.sent[0].arg_i)[3] == 0


def test_executive_waits_for_the_arm_to_come_back_and_no_longer_than_it_may_for_an_alarm():
    f = watching()
    f.tick(alarm(f, 1))
    channel, m = f.ack(status=-8)
    m.event_id = executive.NO_PATH
    f.tick((channel, m))
    for _ in range(4):
        f.tick(alarm(f, 1), after_s=1.0)
    assert f.opcodes == [START]
    for _ in range(2):
        f.tick(alarm(f, 1), after_s=1.0)
    assert f.opcodes == [START, START]
    f.tick(f.ack(status=-1))
    assert "refused" in f.executive.result["reason"]
    f = watching()
    for _ in range(3601):
        f.tick(f.hk(0), after_s=1.0)
    assert f.sent == [] and f.executive.result["reason"] == "no alarm for 3600 s"


def test_executive_names_what_is_not_there():
    f = Flight()
    for _ in range(31):
        f.tick(f.hk(0), after_s=1.0)
    assert f.executive.result["reason"] == "no arm state and no pan-tilt state" and f.sent == []


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


def test_executive_counts_no_change_as_success():
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
        (lambda f: f.tick(f.hk(11)), "flight aborted the calibration"),
        (
            lambda f: f.tick(f.aborted(9), f.hk(11)),
            "calibration: no correction within its bounds explains",
        ),
        (
            lambda f: f.tick(f.aborted(10), f.hk(11)),
            "calibration: tags detected at fewer than a third of the local initial poses",
        ),
        (lambda f: f.tick(f.aborted(99), f.hk(11)), "flight aborted the calibration"),
        (lambda f: [f.tick(f.hk(0), after_s=1.1) for _ in range(3)], "idle and proposed nothing"),
    ],
)
def test_executive_notices_when_flight_stopped_by_itself(what, reason):
    f = Flight().started()
    what(f)
    assert reason in f.executive.result["reason"] and f.opcodes == [START]


def test_executive_fails_when_a_command_is_refused_or_not_answered():
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
    "script, ok, problem", [("change", True, ""), ("no-housekeeping", False, "heartbeat lost")]
)
def test_launch_reports_how_it_ended_and_leaves_nothing_running(tmp_path, script, ok, problem):
    result = run.execute(fake_run(tmp_path, script=script))
    assert result["ok"] is ok and problem in result["problem"]
    assert running_with(result["url"]) == []
    assert result["contacts"] == {}
    truth = json.loads((tmp_path / "out" / "truth.json").read_text())
    assert truth["errors"] == true_coefficients(load("paper"))
    heard = payloads(tmp_path / "out" / "run.lcmlog")
    assert {"KC_TIME", "KC_ARM_STATE", "KC_PANTILT_STATE", "KC_SIM_TRUTH", "KC_HK"} <= set(heard)


def test_a_verdict_that_the_scenario_does_not_expect_is_a_problem():
    ended = {"success": True, "verdict": "no_change"}
    assert outputs.problem_with(load("healthy"), ended) == ""
    assert outputs.problem_with(load("paper"), ended) == "verdict no_change, the scenario expects change"
    assert outputs.problem_with(load("healthy"), ended | {"success": False, "reason": "why"}) == "why"


def test_a_process_that_dies_is_named_with_its_last_output(tmp_path):
    with pytest.raises(run.LaunchError, match=r"fsw ended with status 7:\n.*crashes on purpose"):
        run.execute(fake_run(tmp_path, script="crash"))
    assert running_with(str(tmp_path)) == []


def test_missing_programs_and_tables_are_named_before_anything_starts(tmp_path):
    wanted = fake_run(tmp_path)
    wanted.fsw_bin = tmp_path / "nothing"
    with pytest.raises(run.LaunchError, match="nothing is missing; run `make`"):
        run.execute(wanted)
    wanted = fake_run(tmp_path)
    (wanted.tables / "none.tbl").unlink()
    with pytest.raises(run.LaunchError, match="no tables in"):
        run.execute(wanted)
    assert not (tmp_path / "out").exists()


def launch_command(wanted) -> list:
    """The launcher with the fake flight process of a run, in real time: in lockstep a stuck flight process
    soon ends the run by itself."""
    return [
        *(sys.executable, "-m", "kincal_sim.launch", "paper", "--fast", "--realtime"),
        *("--out", wanted.out, "--fsw", FAKE_FSW, "--tables", wanted.tables, "--store", wanted.store),
    ]


def wait_until_written(path, seconds=20.0):
    deadline = time.monotonic() + seconds
    while (not path.exists() or path.stat().st_size == 0) and time.monotonic() < deadline:
        time.sleep(0.05)


def test_an_interrupted_launch_stops_everything_it_started(tmp_path):
    wanted = fake_run(tmp_path, script="stuck")
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    pipe = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    # What a shell started in the background ignores SIGINT, and so would all that it starts.
    listen = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    with subprocess.Popen(launch_command(wanted), **pipe, env=env, preexec_fn=listen) as p:
        line = p.stdout.readline()
        assert line, p.stderr.read()
        url = json.loads(line)["url"]
        wait_until_written(wanted.out / "run.lcmlog")
        assert len(running_with(url)) == 3
        p.send_signal(signal.SIGINT)
        try:
            _, err = p.communicate(timeout=20)
        finally:
            p.kill()
    assert p.returncode == 130 and "all processes stopped" in err, err
    assert running_with(url) == []


def test_launches_side_by_side_get_networks_of_their_own():
    taken = [ports.private_port() for _ in range(20)]
    try:
        assert len({port for port, _ in taken}) == 20
    finally:
        for _, lock in taken:
            lock.close()


def test_a_tick_is_announced_again_until_it_is_answered(monkeypatch):
    """A lost KC_TIME or KC_TICK_DONE costs a second, not the run."""
    monkeypatch.setattr(lockstep, "REPEAT_S", 0.01)
    published = []

    class Bus:
        def listen(self, _channel, handler):
            self.handler = handler

        def publish(self, channel, m):
            published.append((channel, m.tick))

        def wait(self, seconds):
            if len(published) < 3:
                time.sleep(seconds)
                return
            done = kcm.tick_done_t()
            done.tick, done.who = 8, 1
            self.handler("KC_TICK_DONE", done)

    lockstep.LockstepClock(Bus(), {1}).tick(8, 800_000)
    assert published == [("KC_TIME", 8)] * 3
    monkeypatch.setattr(lockstep, "REPEATS_MAX", 2)
    published.clear()
    with pytest.raises(lockstep.ParticipantTimeout, match="tick 9 was not answered by fsw"):
        lockstep.LockstepClock(Bus(), {1}).tick(9, 900_000)


# -- whole calibrations with the flight process, fast mode ------------------------------------------


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Each scenario flown once; those that a test below compares, with processes."""
    done = {}

    def get(name):
        if name not in done:
            out = tmp_path_factory.mktemp(name)
            done[name] = ((fly if name in COMPARED else fly_in_process)(out, name), out)
        return done[name]

    return get


def fly_in_process(out, name):
    perform(Request(name, "fast", None, None, 1, out, TABLES))
    return json.loads((out / "launch.json").read_text())


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
    kin = {m.table_crc[KIN] for m in messages(out / "run.lcmlog", "KC_HK")}
    assert len(kin) == 1


def test_a_hidden_compliance_is_called_a_poor_fit_and_changes_nothing(runs):
    result, out = runs("compliance")
    assert not result["ok"] and result["verdict"] == "poor"
    assert proposal_of(out).p_fit < 1e-3
    assert len({m.table_crc[KIN] for m in messages(out / "run.lcmlog", "KC_HK")}) == 1


@pytest.mark.parametrize("name", COMPARED)
def test_a_run_in_one_process_leaves_the_same_bytes_as_the_processes(runs, name, tmp_path):
    """Every message of everybody, the record of the executive, and all that flight stored: that two runs with
    one seed are the same is shown too. Another seed gives other detections."""
    of_executive, out = runs(name)
    store = Store(tmp_path / "store")
    store.folder.mkdir()
    done = simulate(name, 1, Setup(log=tmp_path / "run.lcmlog", store=store))
    ours, theirs = payloads(tmp_path / "run.lcmlog"), payloads(out / "run.lcmlog")
    assert set(FLIGHT_CHANNELS) <= set(ours)
    theirs.pop("KC_TICK_DONE")  # nobody has to wait for anybody
    theirs["KC_TIME"] = sorted(set(theirs["KC_TIME"]))  # a tick may be announced again
    assert ours.keys() == theirs.keys()
    assert [channel for channel in ours if ours[channel] != theirs[channel]] == []
    short = Setup(log=tmp_path / "other.lcmlog", limit_s=60.0)
    simulate(name, 2, short)
    other = payloads(tmp_path / "other.lcmlog")["KC_DETECTION"]
    assert other and set(other).isdisjoint(ours["KC_DETECTION"])
    assert done.record == {key: of_executive[key] for key in done.record}
    kept = {path.name: path.read_bytes() for path in (out / "store").iterdir()}
    assert kept == {path.name: path.read_bytes() for path in store.folder.iterdir()}
    assert kept == {f"k{kind:02d}.{slot}": whole for (kind, slot), whole in store.slots.items()}


def test_the_flight_model_explains_the_simulated_truth():
    """Two independent kinematics, one truth: exact for geometry, to second order for compliance."""
    table, names = read_table("arm"), coefficient_names()
    arm, terms = FlightArm.of_table(table), Terms.of_table(read_table("terms"))
    for name, allowed_m in (("paper", 1e-12), ("encoder_bias", 1e-12), ("compliance", 2e-4)):
        record = record_of(name)
        q, p_m = (np.array([h[key] for h in record["held_out"]]) for key in ("q_rad", "p_m"))
        model = Model(arm, terms, Observations.of_columns({"q": q}, list(table.gravity_m_s2)))
        coef = np.array([record["errors"].get(name, 0.0) for name in names])
        worst, nominal = (
            np.linalg.norm(model.poses(c).p_m - p_m, axis=1).max() for c in (coef, np.zeros(len(names)))
        )
        assert worst < allowed_m < 0.1 * nominal


def test_every_candidate_and_the_path_to_it_is_clear_and_shows_a_tag_in_the_simulated_world():
    """The ground verified the search space with its own shapes; MuJoCo is the second opinion."""
    space = read_table("space")
    arm = Arm()
    cfg = load_config(arm.spec)
    for c in (space.cand[i] for i in range(space.n_cand)):
        q = np.array([c.q_seed[j] for j in range(arm.n)])
        hub = np.array([space.hub_q[c.hub][j] for j in range(arm.n)])
        for s in np.linspace(0.0, 1.0, 12):
            arm.set(hub + s * (q - hub), c.pan_rad, c.tilt_rad)
            assert arm.collisions() == []
        assert visible_tags(cfg, arm.model, arm.data, arm.T_base_cam, arm.T_base_tool)
