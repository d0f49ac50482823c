"""Flight and simulator in one process: commands as a script, tables up and down, and faults as hooks.

That such a run gives the bits of the processes is shown in test_scenarios.py.
"""

import copy
from dataclasses import replace

import numpy as np
import pytest
from flight import CAUSE, STATE, TABLES, read_table

from kincal.flight import library
from kincal.flight import tables as codec
from kincal.link import dump, upload
from kincal.link.channels import message_type
from kincal.run import wire
from kincal.run.fast import InProcessLink
from kincal.run.inprocess import Hooks, Script, Setup, Simulation, Store, command, simulate
from kincal.run.onboard import FlightSoftware
from kincal_shared.errors import CommandFailed, KincalError
from kincal_shared.keys import Signer, counting, of_simulation
from kincal_sim.scenario import load
from kincal_sim.vision.imagers import fast_imager
from kincal_sim.world import World

POSES = 4  # besides the local initial poses
START = (2, command("START", -1, POSES, 1))
UNDER_WAY = 400  # a tick in the middle of the local initial poses


def events(run) -> list[str]:
    return [e.name for e in run.log.events]


def flown(*commands, hooks=None, store=None, scenario="encoder_bias", ticks=UNDER_WAY + 300):
    """A run with commands by tick (default: START) that ends when flight has stopped, or at a tick."""
    script = commands or (START,)

    def each_tick(tick):
        stopped = tick.number > UNDER_WAY and tick.state in (STATE["IDLE"], STATE["REVIEW"], STATE["SAFE"])
        return tick.number < ticks and not stopped

    setup = Setup(commander=lambda send: Script(send, script), hooks=hooks or Hooks(), store=store)
    return simulate(scenario, 1, setup, each_tick=each_tick)


def aborted_by(run) -> int:
    return int(next(e.got for e in run.log.events if e.name == "CAL_ABORTED"))


@pytest.mark.parametrize("scenario", ["healthy", "hidden_compliance"])
def test_ticks_until_something_is_sent_are_ticks_one_after_the_other(scenario):
    def sent(ticks, setup):
        with Simulation(scenario, 3, setup) as simulation:
            taken = [t for t in iter(lambda: ticks(simulation), None) if t.from_flight]
            messages = [(t.number, t.now_us, t.state, c, m.encode()) for t in taken for c, m in t.from_flight]
            run = simulation.result()
        log = run.log
        return messages, log.counts, log.n_messages, run.record, run.contacts, run.mission_s, run.store.slots

    whole = Setup(limit_s=400.0)
    one_by_one = sent(Simulation.step, whole)
    assert one_by_one == sent(Simulation.until_sent, whole)
    assert one_by_one[1]["KC_PROGRESS"] > POSES and one_by_one[1]["KC_SIM_TRUTH"] > 100


def test_without_a_command_nothing_moves_and_the_limit_of_time_ends_the_run():
    run = simulate("paper", 1, Setup(commander=lambda send: Script(send, ()), limit_s=3.0))
    assert (run.ended, run.state, run.mission_s) == (False, STATE["IDLE"], 3.0)
    assert (run.log.counts["KC_HK"], run.log.counts["KC_ARM_CMD"], run.record) == (3, 0, {})


def test_a_script_commands_at_its_ticks():
    run = flown(START, (UNDER_WAY, command("ABORT", seq=2)))
    assert [(a.seq, a.status, a.t_us) for a in run.log.acks] == [(1, 0, 300_000), (2, 0, 40_100_000)]
    assert aborted_by(run) == CAUSE["COMMAND"]


def test_the_executive_gives_up_when_nobody_answers_it():
    def lost(_tick, messages):
        return tuple(m for m in messages if m[0] != "KC_CMD")

    run = simulate("paper", 1, Setup(hooks=Hooks(to_flight=lost)))
    assert run.ended
    assert run.record["reason"].startswith("command 1 not answered within")


def test_silence_of_the_arm_aborts_a_calibration():
    def silent(tick, messages):
        return tuple(m for m in messages if tick < UNDER_WAY or m[0] != "KC_ARM_STATE")

    run = flown(hooks=Hooks(to_flight=silent))
    assert run.state == STATE["SAFE"]
    assert aborted_by(run) == CAUSE["SILENT"]


def test_frames_that_nobody_takes_abort_a_calibration():
    def no_camera(tick, messages):
        return tuple(m for m in messages if tick < UNDER_WAY or m[0] != "KC_FRAME_REQUEST")

    run = flown(hooks=Hooks(from_flight=no_camera), ticks=UNDER_WAY + 3000)
    assert aborted_by(run) == CAUSE["CAMERA"]


def test_altered_messages_reach_flight_and_leave_the_simulator_alone():
    def hot(_tick, messages):
        def heated(m):
            changed = copy.copy(m)
            changed.temp_c = 1e4
            return changed

        return tuple((ch, heated(m) if ch == "KC_ARM_STATE" else m) for ch, m in messages)

    run = flown(hooks=Hooks(to_flight=hot), ticks=20)
    assert "IN_RANGE" in events(run)
    assert run.world.arm.n == 7 and not run.log.last_session.measurements


def test_power_loss_ends_the_calibration_and_flight_says_so():
    run = flown(hooks=Hooks(power_loss=lambda tick: tick == UNDER_WAY))
    assert run.state == STATE["SAFE"]
    assert "BOOT_INTERRUPTED" in events(run)
    assert run.log.hk.boot_count == 2


def test_a_store_that_refuses_is_reported_once_a_failure():
    run = flown(hooks=Hooks(keep=lambda tick, _kind, data: data if tick < UNDER_WAY else None))
    assert "STORE_FAIL" in events(run)


def test_a_clock_that_stands_still_is_no_elapsed_time():
    stands = Hooks(clock=lambda _tick, now_us: min(now_us, UNDER_WAY * 100_000))
    run = flown(hooks=stands, ticks=UNDER_WAY + 20)
    assert run.log.hk.t_us == UNDER_WAY * 100_000


def test_the_same_faults_give_the_same_messages():
    def noisy(tick, messages):
        return () if tick % 7 == 0 else messages

    first, again = (flown(hooks=Hooks(to_flight=noisy), ticks=200) for _ in range(2))
    assert [e.text for e in first.log.events] == [e.text for e in again.log.events]
    assert first.log.hk.encode() == again.log.hk.encode()


def test_states_without_messages_are_those_with_messages():
    """Hooks that change nothing have every state made into a message."""

    def sent(hooks):
        stream = []

        def each_tick(tick):
            states = {channel: m.encode() for channel, m in tick.to_flight}
            stream.append((states, [(channel, m.encode()) for channel, m in tick.from_flight]))
            return tick.number < UNDER_WAY

        setup = Setup(commander=lambda send: Script(send, (START,)), hooks=hooks)
        run = simulate("encoder_bias", 1, setup, each_tick=each_tick)
        return stream, run.log.counts

    without, with_messages = sent(Hooks()), sent(Hooks(to_flight=lambda _tick, messages: messages))
    assert without == with_messages
    channels = {channel for states, _ in without[0] for channel in states}
    assert {"KC_ARM_STATE", "KC_PANTILT_STATE", "KC_DETECTION"} <= channels


def test_states_without_messages_fill_the_same_bytes():
    world = World(load("encoder_bias"), 1, fast_imager)
    world.receive("KC_ARM_CMD", arm_command(world.controller.q_cmd + 0.3))
    kept = wire.place(library("flight").new("kc_in_t"))
    kept_states, seen = wire.States(kept), set()
    for tick in range(1, 60):
        world.advance(tick * 100_000)
        with_messages, without = (wire.place(library("flight").new("kc_in_t")) for _ in range(2))
        for channel, message in world.states():
            name = wire.member(channel)
            wire.fill(name, with_messages.member(name), message)
        wire.States(without).fill(world)
        arm, pantilt = without.member("arm"), without.member("pantilt")
        whole = slice(arm.offset, pantilt.offset + library("flight").ffi.sizeof(pantilt.ctype))
        assert bytes(without.memory[whole]) == bytes(with_messages.memory[whole])
        kept_states.fill(world)  # into what earlier ticks left
        assert bytes(kept.memory) == bytes(without.memory)
        if tick % 7 == 0:
            kept_states.withdraw()
            assert not any(bytes(kept.memory))
        seen.add((world.arm_moves, world.controller.fault_mask))
        if tick == 50:
            world.receive("KC_ARM_CMD", arm_command(np.full(7, 50.0), seq=2))
    assert seen == {(True, 0), (False, 0), (False, 127)}


def arm_command(q_rad, seq=1):
    m = message_type("arm_cmd_t")()
    m.seq, m.n_joints, m.q_rad, m.speed_scale = seq, 7, [*q_rad, 0.0], 1.0
    return m


@pytest.mark.parametrize("hooks", [Hooks(), Hooks(to_flight=lambda _tick, messages: messages)])
def test_a_fault_of_the_arm_that_is_published_by_hand_reaches_flight(hooks):
    """Also where the states are no messages: those of the simulator do not replace it."""
    with Simulation("encoder_bias", 1, Setup(hooks=hooks, limit_s=60.0)) as simulation:
        while (tick := simulation.step()) is not None:
            if tick.number == UNDER_WAY:
                (_, m), _pantilt = simulation.world.states()
                m.fault_mask = 4
                simulation.publish("KC_ARM_STATE", m)
        run = simulation.result()
    assert run.state == STATE["SAFE"] and run.log.counts["KC_ARM_STATE"] == tick_count(run) + 1


def tick_count(run) -> int:
    return round(run.mission_s / 0.1)


def test_a_damaged_slot_is_left_for_the_one_before():
    store = Store()
    flown(store=store, ticks=20)
    journal = 18  # KC_STORE_JOURNAL
    older, newest = reversed(store.offered(journal))
    slot = next(key for key, whole in store.slots.items() if key[0] == journal and whole.endswith(newest))
    store.slots[slot] = store.slots[slot][:-1] + b"\xff"
    assert store.offered(journal) == [b"", older]
    assert "BOOT_SLOT_BAD" in events(flown(store=store, ticks=5))


def test_a_store_in_a_folder_is_read_again(tmp_path):
    store = Store(tmp_path)
    for data in (b"one", b"two", b"three"):
        store.keep(4, data)
    assert Store(tmp_path).offered(4) == [b"three", b"two"]
    store.keep(4, b"")
    assert Store(tmp_path).offered(4) == []


def test_tables_go_up_and_down_in_this_process():
    setup = Setup(commander=lambda send: Script(send, ()))
    with Simulation("paper", 1, setup) as simulation:
        link = InProcessLink(simulation)
        config = read_table("config")
        config.n_poses += 1
        image = codec.encode("config", config)
        upload(link, image)
        assert dump(link, "config").data == image.data
        assert dump(link, "arm").data == (TABLES / "arm.tbl").read_bytes()


def test_a_ground_that_waits_for_what_does_not_come_gets_an_error():
    setup = Setup(commander=lambda send: Script(send, ()), limit_s=20.0)
    with Simulation("paper", 1, setup) as simulation:
        link = InProcessLink(simulation)
        with pytest.raises(CommandFailed, match="proposal did not come within 10 s"):
            link.wait_for(lambda r: r.channel == "KC_PROPOSAL", 10.0, "proposal")
        with pytest.raises(CommandFailed, match="the run ended while the ground waited"):
            link.wait_for(lambda r: r.channel == "KC_PROPOSAL", 20.0, "proposal")


def test_one_flight_at_a_time():
    first = FlightSoftware(TABLES, Store())
    FlightSoftware(TABLES, Store()).step(100_000)
    with pytest.raises(KincalError, match="another flight was started"):
        first.step(100_000)


def test_commands_are_taken_by_source_in_turn_and_number():
    """Those with a signature; the others share a turn, and ABORT among them comes last."""
    signer = Signer(of_simulation(1), counting())
    flight = FlightSoftware(TABLES, Store(), keys=(signer.key,))
    flight.step(100_000)
    sent = [command("ABORT", seq=1), command("NOOP", seq=9)]
    sent += [command("NOOP", seq=k, source=s) for k in (1, 2, 3) for s in ("EXECUTIVE", "GROUND")]
    for m in sent:
        m.t_us = 100_000
    for m in sent[:2] + [signer.command(m) for m in sent[2:]][::-1]:
        flight.receive("KC_CMD", m)
    acks = [m for channel, m in flight.step(200_000) if channel == "KC_ACK"]
    signed = [(1, 1), (2, 1), (1, 2), (2, 2), (1, 3), (2, 3)]
    assert [(a.source, a.seq) for a in acks] == [signed[0], (1, 9), *signed[1:], (1, 1)]
    assert acks[-1].opcode == sent[0].opcode and not any(a.status for a in acks)


def test_more_commands_than_a_step_takes_wait_for_the_next():
    flight = FlightSoftware(TABLES, Store())
    for k in range(1, 11):
        flight.receive("KC_CMD", command("NOOP", seq=k))
    steps = [flight.step(t_us) for t_us in (100_000, 200_000)]
    answered = [[m.seq for channel, m in step if channel == "KC_ACK"] for step in steps]
    assert answered == [list(range(1, 9)), [9, 10]]


def test_stamps_before_the_epoch_are_refused_like_those_from_the_network():
    def old(_tick, messages):
        def aged(m):
            changed = copy.copy(m)
            changed.t_us -= 3_600_000_000
            return changed

        return tuple((ch, aged(m) if ch in ("KC_ARM_STATE", "KC_PANTILT_STATE") else m) for ch, m in messages)

    run = flown(hooks=Hooks(to_flight=old), ticks=20)
    assert {e.index for e in run.log.events if e.name == "IN_RANGE"} == {101, 201}


def test_hooks_are_values():
    assert replace(Hooks(), power_loss=lambda _: False) != Hooks()
    assert Hooks() == Hooks()


def test_a_scenario_that_is_changed_while_it_runs_changes_nothing():
    """Parts of it are read once: temperature and gravity reached the arm, and flight late or never."""
    given = load("healthy")
    with Simulation(given, seed=1) as simulation:
        before = simulation.scenario
        for scenario in (given, simulation.scenario):
            scenario.env.temp_c += 40.0
        assert simulation.scenario == before != given
        assert simulation.step().number >= 0
