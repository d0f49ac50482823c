"""The Monte Carlo of tests/bench: true to the processes, a judge that can say no, and a few of its runs."""

import copy
import json
import sys

import numpy as np
import pytest
from runs import ROOT, fly

sys.path.insert(0, str(ROOT / "tests" / "bench"))

import montecarlo

from kincal_sim.scenario import ArmTruth, Scenario


@pytest.fixture(scope="module")
def judge():
    return montecarlo.Judge()


@pytest.mark.slow
@pytest.mark.parametrize("run", [3])
def test_it_comes_to_the_same_correction_as_the_processes_over_lcm(run, judge, tmp_path):
    kind, truth, _ = montecarlo.draw("inside", 1, run)
    story, world = montecarlo.fly(truth, 1000 + run, judge)
    lines = [f'"{name}" = {value!r}' for name, value in truth.errors.items()]
    scenario = tmp_path / "drawn.toml"
    scenario.write_text(f'title = "{kind}"\n[arm.errors]\n' + "\n".join(lines) + "\n")
    result = fly(tmp_path / "out", scenario, seed=1000 + run)
    # The CRC covers every bit of every coefficient, and the time at which it was proposed.
    assert (f"{story.crc:08x}", story.verdict, story.poses) == (
        result["crc"],
        result["verdict"],
        result["n_poses"],
    )
    assert bool(world.hits) >= bool(result["touched"])


# The last four were lost once: a first look that alone told of a joint was taken for an outlier (552, 650), a
# link that leans was counted as straight and touched (216, 785).
@pytest.mark.slow
def test_some_recalibrations_touch_nothing_and_finish():
    results = [montecarlo.one(("inside", 1, run)) for run in (4, 552, 650, 216, 785)]
    assert montecarlo.gates(results) == {
        "no command outside limits or proven segments": True,
        "inside the bounds: no contact": True,
        "inside the bounds: at least 99% finish": True,
        "inside the bounds: the rest abort with a reason": True,
    }
    assert all(r["after_m"] < 0.001 < r["before_m"] for r in results)


# These touched something once: at a turn of the wrist before anything was seen (42, 43, 45, 46) or known (44)
# and among the candidates, having left with first looks that were all a little off (41).
@pytest.mark.slow
@pytest.mark.parametrize(("seed", "run"), [(41, 901), (42, 318), (43, 478), (44, 903), (45, 570), (46, 958)])
def test_arms_outside_the_bounds_that_stand_near_something_stop_in_time(seed, run):
    result = montecarlo.one(("outside", seed, run))
    assert result["outcome"] in ("aborted: stray", "aborted: not seen")
    assert not result["contacts"]
    assert result["n_limits"] + result["n_unproven"] == 0


def test_an_encoder_that_slipped_by_a_radian_touches_nothing(judge):
    story, world = montecarlo.fly(ArmTruth(encoder_bias_rad={"J1": 1.2}), 1, judge)
    assert not world.hits
    assert story.outcome.startswith(("finished", "aborted", "refused"))
    assert not story.limits + story.ends


def test_the_judge_knows_proven_commands(judge):
    rng = np.random.default_rng(1)
    for i in rng.choice(len(judge.seed), 30):
        box = judge.seed[i] + rng.uniform(-1.0, 1.0, (2, judge.n)) * (judge.box[i] - 1e-5)
        assert judge.proven(*box)[0].startswith("box")
    for k in rng.choice(len(judge.a), 30):
        middle = 0.5 * (judge.a[k] + judge.b[k])
        assert judge.proven(middle, judge.b[k])[1] == ""
        assert judge.proven(judge.a[k], middle)[1] == ""


def test_the_judge_refuses_what_was_not_proven(judge):
    seed, hub = judge.seed[0], judge.hub[0]
    far = int(np.argmax(np.max(np.abs(judge.seed - seed) / judge.leash, 1)))
    assert judge.proven(seed, judge.seed[far])[1] != ""  # from candidate to candidate without a hub
    push = np.zeros(judge.n)
    push[1] = 3.0 * judge.leash[1]
    assert judge.proven(seed, seed + push)[1] != ""  # out of the servo box
    push[1] = 0.06
    assert judge.proven(judge.hub[1], judge.hub[1] + push)[1] != ""  # hubs have no servo box
    only = copy.copy(judge)  # without the servo boxes that happen to reach hub 0
    around = np.all(np.abs(judge.seed - hub) <= judge.box, 1) & np.any(judge.seed != hub, 1)
    only.box = np.where(around[:, None], 1e-9, judge.box)
    assert only.proven(hub, hub + push)[1] != ""  # nor has the first look there more than a hub
    assert only.proven(hub, hub + 0.8 * push)[1] == ""
    assert not judge.limits(judge.hi + 1e-6)
    assert not judge.limits(np.full(judge.n, np.nan))
    assert not judge.head(judge.head_hi + 0.01)


def test_contact_between_two_ticks_is_seen():
    world = montecarlo.Watched(Scenario("drawn", "", arm=ArmTruth()), 1)
    bent = [2.5, 1.9, 0.0, 0.5, 0.0, 0.0, 0.0]
    q = [*bent, 0.0]
    world.take("KC_ARM_CMD", montecarlo.Message(seq=1, n_joints=7, q_rad=q, speed_scale=1.0, hold=0))
    for tick in range(1, 100):
        world.step(tick * montecarlo.TICK_US)
    assert any("deck" in pair for pair in world.hits)


def test_gates_fail_on_what_must_not_happen():
    good = {
        "part": "inside",
        "run": 0,
        "outcome": "finished",
        "contacts": {},
        "n_limits": 0,
        "n_unproven": 0,
    }
    held = lambda *rows: all(montecarlo.gates([good, *rows]).values())  # noqa: E731
    assert held()
    touched = {"contacts": {"a - b": {}}}
    assert not held(good | touched)
    assert not held(good | {"n_unproven": 1})
    assert not held(good | {"n_limits": 1})
    assert not held(good | {"outcome": "aborted: budget"})
    assert not held(good | {"part": "outside"} | touched)
    outside = [good | {"part": "outside"}] * 999
    assert held(*outside, good | {"part": "outside"} | touched)


def test_runs_go_on_where_they_stopped(tmp_path):
    file, head = tmp_path / "runs.jsonl", {"seed": 1}
    assert montecarlo.done(file, head) == []
    with open(file, "a") as f:
        f.write(json.dumps({"part": "inside", "run": 0}) + '\n{"part": "ins')
    assert montecarlo.done(file, head) == [{"part": "inside", "run": 0}]
    with pytest.raises(montecarlo.OtherTables):
        montecarlo.done(file, {"seed": 2})


@pytest.mark.parametrize("kind", sorted(set(montecarlo.KINDS_INSIDE)))
def test_errors_inside_the_bounds_are(kind):
    size = montecarlo.bounds()
    for k in range(20):
        errors = montecarlo.inside(np.random.default_rng(k), kind).errors
        assert all(abs(v) <= size[name] for name, v in errors.items())


@pytest.mark.parametrize("kind", sorted(montecarlo.KINDS_OUTSIDE))
def test_errors_outside_the_bounds_are(kind):
    size = montecarlo.bounds()
    for k in range(20):
        truth = montecarlo.outside(np.random.default_rng(k), kind)
        beyond = [name for name, v in truth.errors.items() if abs(v) > size[name]]
        assert beyond or any(abs(v) >= 1.0 for v in truth.encoder_bias_rad.values())
        assert all(abs(v) <= np.pi for v in truth.errors.values())
