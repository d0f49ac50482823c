"""Normal operation over LCM: somebody else moves the arm and takes frames, flight only listens. When an
encoder slips, its monitor names the joint, and a recalibration limited to it corrects it. Or the executive
starts on the alarm, from the joints that are named; where the alarm was wrong, the calibration finds out."""

import pytest
from flight import CORE, EVENT, IDLE, KIN, REVIEW, TICK_US, Flight, read_table, u32

import kcm
from kincal_sim.executive import Executive
from kincal_sim.scenario import ArmTruth, load
from kincal_sim.vision.imagers import fast_imager
from kincal_sim.world import World

MONITOR = CORE.enum("kc_mon_state_t", "KC_MON_")
SPACE = read_table("space")
FINDINGS = [EVENT[f"MON_{name}"] for name in ("SUSPECT", "UNEXPLAINED", "SEVERAL")]


class Operation:
    """Normal operation: the arm goes to one candidate after the other, a frame at each."""

    def __init__(self, flight: Flight):
        self.flight, self.seq, self.n_obs = flight, 0, 0
        self.events = []

    def _to_world(self, channel, message, **fields):
        self.seq += 1
        message.seq = self.seq
        for name, value in fields.items():
            setattr(message, name, value)
        self.flight.world.receive(channel, message)

    def _ticks(self, n):
        for _ in range(n):
            self.events += [m for ch, m in self.flight.step() if ch == "KC_EVENT"]

    def _rest(self):
        self._ticks(3)
        while self.flight.world.last_motion_us >= self.flight.now_us - TICK_US:
            self._ticks(1)
        self._ticks(5)  # settled

    def go(self, q):
        self._to_world(
            "KC_ARM_CMD", kcm.arm_cmd_t(), n_joints=7, q_rad=[*map(float, q), 0.0][:8], speed_scale=1.0
        )
        self._rest()

    def observe(self):
        """A frame at the next candidate; the monitor's findings."""
        cand = SPACE.cand[self.n_obs * 7 % SPACE.n_cand]
        self.n_obs += 1
        self.events = []
        self._to_world("KC_PANTILT_CMD", kcm.pantilt_cmd_t(), pan_rad=cand.pan_rad, tilt_rad=cand.tilt_rad)
        self.go(SPACE.hub_q[cand.hub][0:7])
        self.go(cand.q_seed[0:7])
        self._to_world("KC_FRAME_REQUEST", kcm.frame_request_t())
        self._ticks(4)
        assert not any(e.id == EVENT["MON_NOT_AT_REST"] for e in self.events)
        self.go(SPACE.hub_q[cand.hub][0:7])
        return [e for e in self.events if e.id in FINDINGS]

    def housekeeping(self):
        return self.flight.until("KC_HK", 20)


@pytest.mark.parametrize(("joint", "bias_rad"), [(1, 0.010), (4, -0.015), (7, 0.030)])
def test_an_encoder_that_slips_is_named_and_it_alone_recalibrated(tmp_path, joint, bias_rad):
    with Flight(tmp_path / "store", "healthy") as f:
        f.start()
        f.step()
        operation = Operation(f)
        assert [operation.observe() for _ in range(10)] == [[]] * 10
        hk = operation.housekeeping()
        assert (hk.state, hk.mon_state, hk.mon_joint, hk.mon_p) == (IDLE, MONITOR["QUIET"], 0, 1.0)

        f.world.plant.encoders.bias_rad[joint - 1] += bias_rad
        found = []
        while not found and operation.n_obs < 15:  # 5 observations
            found = operation.observe()
        (event,) = found
        assert event.id == EVENT["MON_SUSPECT"] and event.index == joint
        assert int(event.want) == 1 << (joint - 1)
        assert event.got == pytest.approx(-bias_rad, abs=0.004)  # true joint - reading
        hk = operation.housekeeping()
        assert (hk.mon_state, hk.mon_joint, hk.mon_suspects) == (MONITOR["NAMED"], joint, 1 << (joint - 1))
        assert hk.mon_p <= 5e-5 and abs(hk.mon_bias + bias_rad) < 4 * hk.mon_sigma

        phi = 4 * (joint - 1)
        operation.go(SPACE.hub_q[0][0:7])
        f.command(kcm.cmd_t.START, -1, 4, 1, arg_u64=1 << phi)
        p = f.until("KC_PROPOSAL")
        assert p.verdict == p.CHANGE
        assert [c for c in range(p.n_coef) if p.status[c] != 1] == [phi]  # all others masked
        assert p.value[phi] == pytest.approx(-bias_rad, abs=0.002)
        assert f.until("KC_HK", 20).state == REVIEW
        assert f.do(kcm.cmd_t.APPROVE_ARM, p.crc).status == 0
        assert f.do(kcm.cmd_t.APPROVE_GO, p.crc).status == 0
        assert u32(operation.housekeeping().table_crc[KIN]) == u32(p.crc)


def until_joints_are_named(operation):
    """The alarm, with the arm at the park pose again."""
    named = (EVENT["MON_SUSPECT"], EVENT["MON_SEVERAL"])
    while not (found := [e for e in operation.observe() if e.id in named]):
        assert operation.n_obs < 8
    operation.go(SPACE.hub_q[0][0:7])
    return found[-1]


def run(f, until, commander=None, max_ticks=20_000):
    """Events by name with their messages, up to a message on the channel `until`, which comes last.
    commander: gets every tick."""
    events = []
    for _ in range(max_ticks):
        heard = f.step()
        events += [m for ch, m in heard if ch == "KC_EVENT"]
        if commander is not None:
            commander.tick(f.now_us, [x for x in heard if x[0] in commander._HANDLERS])
        if found := [m for ch, m in heard if ch == until]:
            return {name: m for m in events for name, number in EVENT.items() if number == m.id}, found[0]
    raise AssertionError(f"no {until}")


def become(world, truth):
    """The same place and time, with another arm."""
    other = World(load("healthy").model_copy(update={"arm": truth}), 1, fast_imager)
    world.plant, world.arm, world.imager = other.plant, other.arm, other.imager


def test_two_joints_slip_and_the_executive_calibrates_from_the_alarm(tmp_path):
    """Unstowing fails, the monitor names joints, the executive starts from them and takes the correction."""
    with Flight(tmp_path / "store", "healthy") as f:
        f.start()
        f.step()
        scenario = load("healthy").model_copy(deep=True)
        scenario.calibration.start, scenario.calibration.poses = "alarm", 3
        executive = Executive(scenario, lambda m: f.bus.publish("KC_CMD", f.signer.command(m)))
        operation = Operation(f)
        f.world.plant.encoders.bias_rad[[1, 4]] += -0.05, 0.08
        event = until_joints_are_named(operation)
        assert event.id == EVENT["MON_SEVERAL"] and int(event.got) == 0b10010
        hk = operation.housekeeping()
        assert hk.mon_state == MONITOR["SEVERAL"] and hk.mon_joint in (2, 5)
        assert min(hk.mon_chance[1], hk.mon_chance[4]) > 0.99 > 0.1 > sum(hk.mon_chance) - 2.0

        ready = [
            ("KC_ARM_STATE", kcm.arm_state_t()),
            ("KC_PANTILT_STATE", kcm.pantilt_state_t()),
            ("KC_HK", hk),
        ]
        executive.tick(f.now_us, ready)
        events, p = run(f, "KC_PROPOSAL", executive)
        assert int(events["CAL_SUSPECTS"].got) == 0b10010 and "CAL_SUSPECTS_DROPPED" not in events
        assert p.verdict == p.CHANGE
        assert p.value[4] == pytest.approx(0.05, abs=0.002) and p.value[16] == pytest.approx(-0.08, abs=0.004)
        assert p.pred_pos_m < 0.0016 and p.p_fit > 0.001
        events, _ = run(f, "KC_HK", executive)
        for _ in range(50):
            events |= run(f, "KC_HK", executive)[0]
            if executive.result:
                break
        assert executive.result["reason"] == "correction approved and active"


@pytest.mark.parametrize(
    ("truth", "coefficient", "value"),
    [
        ({"errors": {"J2.alpha_rad": 0.2}}, 5, 0.2),
        ({"errors": {"J3.d_m": 0.08}}, 11, 0.08),
        ({"encoder_bias_rad": {"J6": -0.1}}, 20, 0.1),
    ],
    ids=["bent", "longer", "other joint"],
)
def test_a_wrong_suspicion_is_dropped_and_the_correction_right(tmp_path, truth, coefficient, value):
    """Joint 3 was named, and it is something else."""
    with Flight(tmp_path / "store", "healthy") as f:
        f.start()
        f.step()
        operation = Operation(f)
        f.world.plant.encoders.bias_rad[2] += 0.06
        assert until_joints_are_named(operation).index == 3
        become(f.world, ArmTruth(**truth))
        f.command(kcm.cmd_t.START, -1, 8, 1, 1)
        events, p = run(f, "KC_PROPOSAL")
        assert int(events["CAL_SUSPECTS"].got) == 0b100
        assert events["CAL_SUSPECTS_DROPPED"].got < 0.01
        assert p.verdict == p.CHANGE and p.rank == p.n_free == 28
        sigma = max(p.sigma[coefficient], 1e-3)
        assert abs(p.value[coefficient] - value) < 4 * sigma and sigma < 0.02


def test_start_from_suspects_is_refused_while_nothing_is_named(tmp_path):
    with Flight(tmp_path / "store", "healthy") as f:
        f.start()
        f.step()
        Operation(f).observe()
        Operation(f).go(SPACE.hub_q[0][0:7])
        answer = f.do(kcm.cmd_t.START, -1, 4, 1, 1)
        assert answer.status != 0 and answer.event_id == EVENT["CAL_NO_SUSPECTS"]
        assert f.do(kcm.cmd_t.START, -1, 4, 1).status == 0
