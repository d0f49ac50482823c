"""The fault campaign of tests/bench: an evaluation that can fail, and some of its runs."""

from dataclasses import replace
from types import SimpleNamespace

import faults
import missions
import numpy as np
import pytest
from fault_kinds import KIN, KINDS, Fault, both

from kincal.run.inprocess import Hooks
from kincal.run.store import Store
from kincal_sim.truth import true_coefficients

CALM = "slipped", 1
FIRST = faults.initial_crcs(CALM[0])


@pytest.fixture(scope="module")
def calm():
    """A run without a fault, and what was seen."""
    return faults.fly(*CALM, Hooks())


def test_every_event_that_explains_a_fault_has_a_next_step_for_the_operator():
    assert len(KINDS) == len({kind.name for kind in KINDS}) >= 40
    assert all(faults.next_step(event) for kind in KINDS for event in kind.events)
    assert all(kind.by in ("flight", "executive") for kind in KINDS)


def test_a_run_without_a_fault_has_nothing_that_must_not_be(calm):
    run, record, witness = calm
    assert record["success"] and record["verdict"] == "change"
    assert faults.wrong_correction(run, Fault(Hooks()), witness) == ""
    assert faults.lost_table(witness, FIRST) == ""
    assert faults.hang(run, record, witness) == ""


def test_a_wrong_correction_that_is_active_is_found(calm):
    run, _, witness = calm
    (crc,) = witness.proposals
    proposed = witness.proposals[crc]
    wrong = {name: 0.01 + value for name, value in proposed.correction.items() if name.startswith("J")}
    for other in (replace(proposed, correction=wrong), replace(proposed, predicted_m=1e-6)):
        assert "mm off" in faults.wrong_correction(
            run, Fault(Hooks()), replace(witness, proposals={crc: other})
        )
    slipped = Fault(Hooks(), slip_rad=lambda _tick: 0.03 * np.eye(7)[1])
    assert "mm off" in faults.wrong_correction(run, slipped, witness)
    moved = np.eye(4)
    moved[0, 3] = 0.01
    knocked = Fault(Hooks(), seen=lambda _tick: lambda T: moved @ T)
    assert "mm off" in faults.wrong_correction(run, knocked, witness)


def test_two_faults_act_one_after_the_other():
    def renamed(a: str, b: str):
        return lambda _tick, messages: tuple((ch.replace(a, b), m) for ch, m in messages)

    def moved(x_m: float, turned: float):
        T = np.array([[turned, 0.0, 0.0, x_m], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, turned, 0.0], [0, 0, 0, 1]])
        return lambda _tick: lambda pose: T @ pose

    first = Fault(
        Hooks(renamed("a", "b"), renamed("d", "c"), lambda _tick, now: now + 1, lambda *_: None),
        lambda tick: np.full(7, 1.0 * tick),
        moved(1.0, 1.0),
    )
    second = Fault(
        Hooks(renamed("b", "c"), renamed("e", "d"), lambda _tick, now: 2 * now, power_loss=lambda k: k == 3),
        lambda _tick: np.full(7, 0.5),
        moved(0.0, -1.0),
    )
    fault = both(first, second)
    assert fault.hooks.to_flight(1, (("a", 0),)) == (("c", 0),)
    assert fault.hooks.from_flight(1, (("e", 0),)) == (("c", 0),)
    assert fault.hooks.clock(1, 10) == 22
    assert fault.hooks.keep(1, KIN, b"x") is None
    assert both(second, second).hooks.keep(1, KIN, b"x") == b"x"
    assert [fault.hooks.power_loss(k) for k in (2, 3)] == [False, True]
    assert fault.slip_rad(2).tolist() == [2.5] * 7
    assert fault.seen(1)(np.eye(4))[0, 3] == -1.0


@pytest.mark.parametrize("name", missions.SCENARIOS)
def test_the_error_of_a_correction_is_zero_for_the_true_arm(name):
    scenario = missions.scenario_of(name, 3)
    assert missions.error_m(scenario, true_coefficients(scenario), 1) < 1e-9
    offset = np.array([0.003, 0.0, 0.0])

    def moved(T):
        shifted = T.copy()
        shifted[:3, 3] += offset
        return shifted

    seen = missions.in_camera(moved)
    assert missions.error_m(scenario, true_coefficients(scenario), 1, seen=seen) == pytest.approx(0.003)


def test_an_approval_that_was_answered_but_not_kept_is_found(calm):
    run, _, witness = calm
    assert witness.approved and faults.lost_approval(run, witness) == ""
    forgetful = replace(run, store=Store())
    assert "after a restart" in faults.lost_approval(forgetful, witness)


def test_a_lost_table_is_found(calm):
    _, _, witness = calm
    first = witness.crcs[0]
    for kind in (1, KIN, 7):
        other = tuple(5 if k == kind else crc for k, crc in enumerate(first))
        assert faults.lost_table(replace(witness, crcs=[first, other]), FIRST)
    assert faults.lost_table(replace(witness, approved=set()), FIRST)  # active, but nobody approved it


def test_a_hang_is_found(calm):
    run, record, witness = calm
    assert faults.hang(replace(run, ended=False), record, witness)
    assert faults.hang(run, {}, witness)
    unheard = replace(witness, heartbeat=witness.ticks - 40)
    assert faults.hang(run, record, unheard)
    assert faults.hang(run, record, unheard, heard=False) == ""


def test_an_end_that_nothing_explains_is_found(calm):
    _, record, witness = calm
    kind = next(k for k in KINDS if k.name == "arm_silent")
    stopped = {**record, "success": False, "reason": "flight aborted the calibration"}
    assert faults.silent([kind], CALM, record, witness) == ""
    assert faults.silent([kind], CALM, stopped, witness)
    explained = SimpleNamespace(warned=witness.warned + faults.Counter(["IN_SILENT"]))
    assert faults.silent([kind], CALM, stopped, explained) == ""


@pytest.mark.parametrize(
    "name",
    [
        *("arm_silent", "encoder_slips_30_mrad", "camera_knocked_3_mm", "tags_seem_small", "covariance_zero"),
        *("proposal_damaged", "clock_ahead", "store_damaged", "power_lost_in_review", "command_flood"),
    ],
)
def test_a_fault_makes_nothing_wrong_active_and_is_explained(name):
    assert faults.one(name, "slipped", 1).faults == []
