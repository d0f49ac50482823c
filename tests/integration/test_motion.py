"""Arm commands over LCM: sides of approach, replicates, the guard, and what ends a calibration."""

import shutil

import numpy as np
import pytest
from flight import CORE, EVENT, IDLE, REVIEW, SAFE, TABLES, Flight, read_table

import kcm
from kincal.flight import tables as codec

CMD = kcm.cmd_t
APPROACH_RAD = 0.05
WHY_LOCAL = CORE.constant("KC_CAND_LOCAL")
SPACE = read_table("space")
LOCAL = {i for i, c in enumerate(SPACE.cand[0 : SPACE.n_cand]) if c.why & WHY_LOCAL}
CLEAR_M = 0.005  # what the guard keeps between the arm and a volume


class Session(Flight):
    """A calibration with some fields of CONFIG changed, and all of its `messages`."""

    def __init__(self, tmp_path, scenario, seed=1, space=None, **config):
        folder = tmp_path / "tables"
        shutil.copytree(TABLES, folder)
        c = read_table("config")
        plain = {"initial_design": 0, "extra_obs_max": 0, "stops_max": 0}  # all initial poses, none between
        for name, value in (plain | config).items():
            setattr(c, name, value)
        (folder / "config.tbl").write_bytes(codec.encode("config", c).data)
        if space is not None:
            (folder / "space.tbl").write_bytes(codec.encode("space", space).data)
        super().__init__(tmp_path / "store", scenario, seed, folder)

    def calibrate(self, poses, seed=1):
        self.start()
        self.step()
        assert self.do(CMD.START, -1, poses, seed).status == 0
        self.messages, ended = list(self.heard), False
        while not ended:
            assert self.step() is not None and self.tick < 20_000
            self.messages += self.heard
            ended = any(ch == "KC_HK" and m.state in (IDLE, REVIEW, SAFE) for ch, m in self.heard)
        return self

    def of(self, *channels):
        return [m for ch, m in self.messages if ch in channels]

    def events(self, *names):
        return [m for m in self.of("KC_EVENT") if m.id in {EVENT[name] for name in names}]

    def measured(self):
        """Candidates after the local initial poses, in order."""
        return [m.candidate for m in self.of("KC_MEAS") if m.candidate not in LOCAL]


def joints(m):
    return np.array(m.q_rad[:7])


def before_each_measurement(messages):
    """The measurement, and the arm commands since the one before it."""
    commands = []
    for m in messages:
        if isinstance(m, kcm.meas_t):
            yield m, commands
            commands = []
        else:
            commands.append(joints(m))


def test_poses_are_approached_from_the_sides_that_telemetry_reports(tmp_path):
    with Session(tmp_path, "encoder_bias", approach_rad=APPROACH_RAD, replicate_every=2) as f:
        messages = f.calibrate(10).of("KC_ARM_CMD", "KC_MEAS")
        assert f.events("GRD_LIMIT", "GRD_PATH", "GRD_VOLUME") == []
    sides, repeats = [], 0
    for m, commands in before_each_measurement(messages):
        if m.candidate in LOCAL:
            seed = np.array(list(SPACE.cand[m.candidate].q_seed)[:7])
            assert sides == [] and np.allclose(commands[-1], seed, atol=1e-6)  # from no side
            continue
        back, goal = commands[-2:]
        assert np.allclose(np.abs(goal - back), APPROACH_RAD, atol=1e-12)
        side = np.sign(goal - back).astype(int)
        assert list(m.dir[:7]) == list(side)
        assert np.allclose(joints(m), goal, atol=1e-3)
        sides.append(tuple(side))
        if m.replicate:
            repeats += 1
            hub = np.array(list(SPACE.hub_q[SPACE.cand[m.candidate].hub])[:7])
            assert min(np.max(np.abs(c - hub)) for c in commands) < 1e-6  # reached anew
            first = next(x for x in messages if isinstance(x, kcm.meas_t) and x.candidate == m.candidate)
            assert first.dir != m.dir
    assert len(sides) == 10 and repeats >= 2 and len(set(sides)) >= 9
    assert 20 <= np.sum(np.array(sides) > 0) <= 50  # of 70; mean 35, sigma 4.2


def test_a_used_up_energy_budget_ends_with_a_proposal_from_the_poses_so_far(tmp_path):
    budget = {"power_idle_w": 15.0, "power_move_w": 60.0, "energy_budget_j": 5000.0}
    with Session(tmp_path, "encoder_bias", **budget) as f:
        f.calibrate(40)
        (event,) = f.events("CAL_ENERGY")
        assert event.want == 5000.0 and 5000.0 < event.got <= 5006.0  # one tick of moving more
        assert f.of("KC_HK")[-1].energy_j >= event.got
        used = [p.energy_j for p in f.of("KC_PROGRESS")]
        assert 3 <= len(used) < 40 and np.all(np.diff([0.0, *used, event.got]) > 0)
        (p,) = f.of("KC_PROPOSAL")
        assert p.n_poses == len(used)


def test_a_calibration_stops_when_the_bound_meets_the_requirement(tmp_path):
    rms = {"stop_confidence": 0.0, "stop_checks": 0, "no_change_power": 0.0}
    with Session(tmp_path, "encoder_bias", stop_pos_m=0.0017, **rms) as f:
        f.calibrate(60)
        (event,) = f.events("CAL_CONVERGED")
        (p,) = f.of("KC_PROPOSAL")
        assert p.bound_pos_m == p.pred_pos_m == event.got <= 0.0017
        assert len(f.of("KC_PROGRESS")) == p.n_poses < 20
        assert p.ended == CORE.constant("KC_ENDED_REQUIREMENT")


def test_lost_tags_cost_a_bounded_search_and_the_candidate(tmp_path):
    """The paper's arm: the tool is 0.4 m and 1.7 rad off its nominal pose."""
    with Session(tmp_path, "paper") as f:
        f.calibrate(20)
        lost = f.events("CAL_TAGS_LOST")
        config = read_table("config")
        skipped = [e.index for e in f.events("CAL_CAND_SKIPPED")]
        measured = f.measured()
        for e in lost:
            assert e.got <= config.search_steps
            assert e.index in skipped and e.index not in measured
        assert len(measured) == 20 and f.of("KC_PROPOSAL")[0].verdict == kcm.proposal_t.CHANGE


@pytest.mark.parametrize("place", [0, 1])
def test_a_volume_around_a_candidate_is_never_entered(tmp_path, place):
    """A ball where an initial pose puts the tool."""
    space = read_table("space")
    cand = [i for i in space.initial[0 : space.n_initial] if i not in LOCAL][place]
    ball = space.volume[space.n_volume]
    ball.kind, ball.p_m, ball.radius_m = 3, list(space.cand[cand].p_m), 0.03
    space.n_volume += 1
    with Session(tmp_path, "healthy", space=space) as f:
        f.calibrate(6)
        refused = f.events("GRD_VOLUME")
        assert refused and all(e.want == space.n_volume - 1 and e.got > -CLEAR_M for e in refused)
        assert cand in [e.index for e in f.events("CAL_CAND_SKIPPED")]
        assert cand not in [m.candidate for m in f.of("KC_MEAS")]
        seed = np.array(list(space.cand[cand].q_seed)[:7])
        assert min(np.max(np.abs(joints(c) - seed)) for c in f.of("KC_ARM_CMD")) > 1e-3
        assert len(f.measured()) == 6
