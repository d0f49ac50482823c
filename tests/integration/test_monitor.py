"""Normal operation over LCM: somebody else moves the arm and takes frames, flight only listens. When an
encoder slips, its monitor names the joint, and a recalibration limited to it corrects it."""

import pytest
from flight import CORE, EVENT, IDLE, KIN, REVIEW, TICK_US, Flight, read_table, u32

import kcm

MONITOR = CORE.enum("kc_mon_state_t", "KC_MON_")
SPACE = read_table("space")


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
        return [e for e in self.events if e.id in (EVENT["MON_SUSPECT"], EVENT["MON_UNEXPLAINED"])]

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
