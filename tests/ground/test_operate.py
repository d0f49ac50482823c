"""One command and its verifiers, and how old telemetry is: without a network and without a clock."""

import re

import numpy as np
import pytest
from places import ROOT
from samples import CRC, event, signed

import kcm
from kincal.flight import event_action, event_name, library, status_name
from kincal.flight.events import event_cause, event_todo
from kincal.flight.tables import kind_number
from kincal.link import names
from kincal.operate import commands
from kincal.operate.commands import ACCEPTED, DONE, RECEIVED, REFUSED, SENT, UNCERTAIN, Tracked, unmet
from kincal.operate.snapshot import FRESH, STALE, UNKNOWN, Senders, Snapshot, event_of

STATE = library("flight").enum("kc_state_t", "KC_ST_")
EVENT = library("flight").enum("kc_event_id_t", "KC_EVT_")
SEQ, UTC = 77, 1.8e9
MOST, CONFIG = library("flight").constant("KC_MEAS_MAX"), kind_number("config")


def hk(t_s=100.0, state="IDLE", boots=3, kin=1, **fields):
    m = kcm.hk_t()
    m.t_us, m.state, m.boot_count = round(t_s * 1e6), STATE[state], boots
    m.table_crc, m.kin_prev_crc = [0, 1, 1, 1, signed(kin), 1, 1, 1], 7
    for name, value in fields.items():
        setattr(m, name, value)
    return m


def ack(opcode, status=0, event_id=0, seq=SEQ, source=2):
    m = kcm.ack_t()
    m.t_us, m.source, m.seq, m.opcode, m.status, m.event_id = (
        101_000_000, source, seq, opcode, status, event_id,
    )  # fmt: skip
    return m


def arm_state(t_s=100.0, fault=0):
    m = kcm.arm_state_t()
    m.t_us, m.n_joints, m.fault_mask = round(t_s * 1e6), 7, fault
    return m


def pantilt_state(t_s=100.0):
    m = kcm.pantilt_state_t()
    m.t_us = round(t_s * 1e6)
    return m


def heard(now_s=10.0, **fields):
    """A snapshot with fresh telemetry."""
    s = Snapshot()
    s.take("KC_HK", hk(**fields), now_s, UTC)
    s.take("KC_ARM_STATE", arm_state(), now_s, UTC)
    s.take("KC_PANTILT_STATE", pantilt_state(), now_s, UTC)
    return s


def tracked(request, state="IDLE"):
    return Tracked(request, SEQ, 10.0, UTC, 5.0, 3, state)


def after(command, *messages, begin_s=10.1):
    """Messages a tenth of a second apart."""
    for k, (channel, message) in enumerate(messages):
        command.take(channel, message, begin_s + 0.1 * k, UTC + 0.1 * k)
    return [step.stage for step in command.steps]


# ---------------------------------------------------------------------------- verifiers


def test_a_start_is_sent_received_accepted_and_done_by_the_event_that_says_so():
    c = tracked(commands.start())
    assert (c.stage, c.outcome) == (SENT, "")
    stages = after(c, ("KC_ACK", ack(1)), ("KC_EVENT", event(102_000_000, 5, EVENT["CAL_START"], 1, 20.0, 4)))
    assert stages == [SENT, RECEIVED, ACCEPTED, DONE]
    assert c.outcome == DONE and "event CAL_START: calibration 4 started: 20 poses" in c.last_line
    assert c.as_dict()["verifiers"][3]["t_us"] == 102_000_000


def test_an_event_before_the_acknowledgement_counts_once_it_is_accepted():
    c = tracked(commands.start())
    after(c, ("KC_EVENT", event(1, 5, EVENT["CAL_START"], 1, 20.0, 4)))
    assert c.outcome == "" and c.stage == SENT  # somebody else may have started it
    assert after(c, ("KC_ACK", ack(1)))[-1] == DONE


def test_an_abort_is_done_when_housekeeping_shows_the_arm_held():
    c = tracked(commands.abort(), "MOVE")
    aborted = event(1, 5, EVENT["CAL_ABORTED"], 3, 0.0, 6)
    assert after(c, ("KC_ACK", ack(2)), ("KC_EVENT", aborted), ("KC_HK", hk(state="MOVE")))[-1] == ACCEPTED
    assert after(c, ("KC_HK", hk(101.0, "SAFE")))[-1] == DONE
    assert "state SAFE, the arm is held; event CAL_ABORTED" in c.last_line


def test_a_rollback_is_done_when_another_correction_is_read_back():
    c = tracked(commands.rollback(CRC))
    storing = ("KC_HK", hk(state="STORE", kin=CRC))
    assert after(c, storing)[-1] == RECEIVED
    assert after(c, ("KC_ACK", ack(6)), ("KC_HK", hk(kin=CRC)))[-1] == ACCEPTED
    assert after(c, ("KC_HK", hk(kin=0xABCD)))[-1] == DONE
    assert "correction 0000abcd in force" in c.last_line


def test_a_refusal_says_why_and_what_to_do_and_ends_it():
    c = tracked(commands.start(), "MOVE")
    why = event(1, 5, EVENT["CMD_STATE"], 3, float(STATE["MOVE"]), 1)
    assert after(c, ("KC_EVENT", why), ("KC_ACK", ack(1, -8, EVENT["CMD_STATE"]))) == [
        SENT,
        RECEIVED,
        REFUSED,
    ]
    assert c.outcome == REFUSED
    assert "CMD_STATE: command START refused in state MOVE. Nothing was changed on board." in c.last_line
    assert c.stage == REFUSED and c.last_line.endswith(f"board. {event_action(EVENT['CMD_STATE'])}")
    bare = tracked(commands.start(), "MOVE")
    after(bare, ("KC_ACK", ack(1, -8)))  # no event says why
    assert bare.last_line == f"START refused: {status_name(-8)}. Nothing was changed on board."


def test_a_refusal_waits_a_moment_for_the_event_that_explains_it():
    c, why = tracked(commands.start(), "MOVE"), event(1, 5, EVENT["CMD_STATE"], 3, float(STATE["MOVE"]), 1)
    assert after(c, ("KC_ACK", ack(1, -8, EVENT["CMD_STATE"])))[-1] == REFUSED and c.outcome == ""
    after(c, ("KC_EVENT", event(1, 4, EVENT["CAL_POSE"], 1)), ("KC_EVENT", why))
    assert c.outcome == REFUSED and "command START refused in state MOVE" in c.last_line
    c = tracked(commands.start(), "MOVE")
    after(c, ("KC_ACK", ack(1, -8, EVENT["CMD_STATE"])))
    c.tick(10.5)
    assert c.outcome == ""
    c.tick(11.2)
    assert c.outcome == REFUSED and c.last_line.startswith("START refused: CMD_STATE. Nothing was changed")


def test_acknowledgements_of_others_and_a_second_one_change_nothing():
    c = tracked(commands.start())
    others = [ack(1, seq=SEQ + 1), ack(1, source=1), ack(2)]
    assert after(c, *[("KC_ACK", m) for m in others]) == [SENT]
    after(c, ("KC_ACK", ack(1)), ("KC_ACK", ack(1, -8, 13)), ("KC_ACK", ack(1)))
    assert [s.stage for s in c.steps] == [SENT, RECEIVED, ACCEPTED] and c.duplicates == 2
    after(c, ("KC_EVENT", event(1, 5, EVENT["CAL_START"], 1)), ("KC_ACK", ack(1, -8, 13)))
    assert c.outcome == DONE and c.duplicates == 3


def test_a_lost_acknowledgement_is_made_good_by_the_event_that_names_the_command():
    c = tracked(commands.start())
    accepted = event(1, 5, EVENT["CMD_ACCEPTED"], 1, 1.0, SEQ)
    assert after(c, ("KC_EVENT", event(1, 4, EVENT["CMD_ACCEPTED"], 1, 1.0, SEQ - 1))) == [SENT]
    assert after(c, ("KC_EVENT", accepted)) == [SENT, RECEIVED, ACCEPTED]


def test_a_cut_link_ends_with_what_is_known():
    c = tracked(commands.start())
    c.tick(14.9)
    assert c.outcome == ""
    c.tick(15.0)
    assert c.outcome == UNCERTAIN
    assert "no housekeeping came either" in c.last_line and "not known whether flight took it" in c.last_line
    assert "sent once" in c.last_line
    lost = tracked(commands.start())
    after(lost, ("KC_HK", hk()), begin_s=14.0)
    lost.tick(15.0)
    assert "housekeeping goes on, so the command or its answer was lost" in lost.last_line


def test_an_answer_after_the_time_out_still_counts():
    c = tracked(commands.start())
    c.tick(15.0)
    after(c, ("KC_ACK", ack(1, -8, EVENT["CMD_STATE"])), begin_s=16.0)
    c.tick(17.1)
    assert c.outcome == REFUSED and "refused" in c.last_line


def test_accepted_without_its_effect_is_not_done():
    c = tracked(commands.rollback(CRC))
    after(c, ("KC_ACK", ack(6)), ("KC_HK", hk(kin=CRC)))
    c.tick(15.0)
    assert c.outcome == ACCEPTED and "another correction in force was not seen within 5 s" in c.last_line


def test_a_restart_of_flight_ends_it_without_guessing():
    c = tracked(commands.rollback(CRC))
    after(c, ("KC_HK", hk(kin=CRC, boots=4)))
    assert c.outcome == UNCERTAIN and "started again (start 3 -> 4)" in c.last_line
    assert "not known whether flight took it" in c.last_line
    taken = tracked(commands.start())
    after(taken, ("KC_ACK", ack(1)), ("KC_HK", hk(boots=4)))
    assert "It had been accepted." in taken.last_line
    stored = tracked(commands.rollback(CRC))
    after(stored, ("KC_ACK", ack(6)), ("KC_HK", hk(kin=2, boots=4)))
    assert stored.outcome == DONE  # accepted, and read back after the restart


@pytest.mark.parametrize(
    "other",
    [{"boots": 9}, {"boots": 2}, {"table_crc": [0, 1, 1, 1, 1, 5, 1, 1]}],
    ids=["started more often", "less often", "with another SPACE"],
)
@pytest.mark.parametrize("request_", [commands.abort(), commands.reject(CRC), commands.discard()], ids=str)
def test_housekeeping_of_another_flight_does_not_say_done(request_, other):
    """The one heard before goes on as it was; the other one shows what the command would bring."""
    shows = {"state": "SAFE", "staged_kind": 0, "proposal_crc": 0}
    as_before = {"state": "REVIEW", "staged_kind": 3, "proposal_crc": signed(CRC)}
    c = Tracked(request_, SEQ, 10.0, UTC, 5.0, 3, "REVIEW", hk(**as_before))
    opcode = names.opcode(request_.opcode)
    stages = after(c, ("KC_ACK", ack(opcode)), ("KC_HK", hk(**shows | other)), ("KC_HK", hk(**as_before)))
    assert stages == [SENT, RECEIVED, ACCEPTED] and c.outcome == ACCEPTED
    assert "two senders of housekeeping" in c.last_line and "End the other sender" in c.last_line


def test_the_first_housekeeping_after_a_command_says_which_flight_took_it():
    c = tracked(commands.abort(), "MOVE")  # nothing was heard before
    come = [("KC_HK", hk(state="MOVE")), ("KC_HK", hk(state="SAFE", boots=9)), ("KC_HK", hk(state="MOVE"))]
    stages = after(c, ("KC_ACK", ack(names.opcode("ABORT"))), *come)
    assert stages == [SENT, RECEIVED, ACCEPTED] and c.outcome == ACCEPTED
    assert "two senders of housekeeping" in c.last_line


def test_a_next_start_and_a_change_by_somebody_else_are_the_same_flight():
    c = Tracked(commands.approve_go(CRC), SEQ, 10.0, UTC, 5.0, 3, "ARMED", hk())
    go = ack(names.opcode("APPROVE_GO"))
    stages = after(c, ("KC_ACK", go), ("KC_HK", hk(boots=4, kin=CRC)))
    assert stages[-1] == DONE
    c = Tracked(commands.abort(), SEQ, 10.0, UTC, 5.0, 3, "MOVE", hk())
    changed = ("KC_HK", hk(state="SAFE", table_crc=[0, 1, 1, 1, 1, 1, 1, 8]))
    assert after(c, ("KC_ACK", ack(names.opcode("ABORT"))), changed)[-1] == ACCEPTED
    assert after(c, changed, begin_s=11.0)[-1] == DONE  # it stays so


# what housekeeping shows when a command has its effect, what is not yet it, and what is then said
KIN, FREE = [0, 1, 1, 1, signed(CRC), 1, 1, 1], {"staged_kind": 0, "proposal_crc": 0}
BUSY = {"staged_kind": 4, "staged_state": 2, "proposal_crc": signed(CRC), "state": "REVIEW"}
SHOWN = [
    (commands.abort(), {"state": "SAFE"}, {"state": "IDLE"}, "state SAFE, the arm is held"),
    (commands.approve_go(CRC), {"table_crc": KIN}, {"state": "IDLE"}, "correction fedcba98 in force"),
    (commands.reject(CRC), {"proposal_crc": 0}, {"proposal_crc": 1}, "no correction waits"),
    (commands.rollback(1), {"table_crc": KIN}, {"state": "IDLE"}, "correction fedcba98 in force"),
    (commands.validate("kin", CRC), {"staged_state": 3}, {"staged_state": 2}, "staged table valid"),
    (commands.validate("kin", CRC), {"staged_state": 3}, {"staged_kind": 5, "staged_state": 3}, "valid"),
    (commands.activate("kin", CRC), {"table_crc": KIN}, {"table_crc": [0, *[signed(CRC)] * 3, 1, 1, 1, 1]},
     "kin table fedcba98 in force"),
    (commands.discard(), {"staged_kind": 0}, {"staged_kind": 1}, "nothing staged"),
    (commands.start(), {"state": "MOVE"}, {"state": "REVIEW"}, "state MOVE"),
]  # fmt: skip


@pytest.mark.parametrize(("request_", "shows", "not_yet", "said"), SHOWN)
def test_a_command_is_done_when_housekeeping_shows_what_it_brings(request_, shows, not_yet, said):
    c, accepted = tracked(request_, "MOVE"), ack(names.opcode(request_.opcode))
    assert after(c, ("KC_ACK", accepted), ("KC_HK", hk(**BUSY | not_yet)))[-1] == ACCEPTED
    assert after(c, ("KC_HK", hk(102.0, **BUSY | shows)), begin_s=12.0)[-1] == DONE
    assert said in c.last_line and c.steps[-1].t_us == 102_000_000
    early = tracked(request_, "MOVE")  # somebody else may have brought it, until flight says that it took it
    assert after(early, ("KC_HK", hk(**BUSY | shows)))[-1] == SENT
    assert after(early, ("KC_ACK", accepted), begin_s=10.5)[-1] == ACCEPTED
    assert after(early, ("KC_HK", hk(**BUSY | shows)), begin_s=10.7)[-1] == DONE


def test_an_effect_that_an_event_explains_counts_once_the_command_is_accepted():
    c = tracked(commands.rollback(CRC))
    rolled_back = event(1, 5, EVENT["COR_ROLLBACK"], 1, 1.0)
    assert after(c, ("KC_EVENT", rolled_back), ("KC_HK", hk(103.0, kin=1)))[-1] == SENT
    assert after(c, ("KC_ACK", ack(6)), begin_s=10.5)[-1] == DONE and c.steps[-1].t_us == 103_000_000


@pytest.mark.parametrize(
    ("request_", "name", "got", "counts"),
    [
        (commands.start(), "CAL_START", 20.0, True),
        (commands.start(), "CAL_ABORTED", 20.0, False),
        (commands.approve_arm(CRC), "COR_ARMED", float(CRC), True),
        (commands.approve_arm(CRC), "COR_ARMED", float(CRC - 1), False),
        (commands.approve_arm(CRC), "COR_ARMED", float("nan"), False),
        (commands.approve_go(CRC), "COR_ACTIVE", float(CRC), False),  # what is in force is read back
    ],
)
def test_the_event_that_ends_a_command_has_to_name_its_correction(request_, name, got, counts):
    c = tracked(request_)
    after(
        c, ("KC_ACK", ack(names.opcode(request_.opcode))), ("KC_EVENT", event(7, 5, EVENT[name], 1, got, 4))
    )
    assert (c.outcome == DONE) == counts


@pytest.mark.parametrize(
    ("request_", "said"),
    [
        (commands.abort(), "ABORT may be sent again at any time"),
        (commands.discard(), "Look at the state (`kincal status`) before you send it again"),
    ],
)
def test_what_is_known_of_a_command_without_an_answer(request_, said):
    """The effect alone may be somebody else's: it is named, and nothing counts as done."""
    c = tracked(request_, "MOVE")
    assert c.outcome == "" and said not in c.last_line
    after(c, ("KC_HK", hk(**BUSY)))
    c.tick(13.1)
    assert c.outcome == ""
    c.tick(15.0)
    assert c.outcome == UNCERTAIN and said in c.last_line and "housekeeping stopped 5 s ago" in c.last_line
    started = tracked(commands.start())
    after(started, ("KC_EVENT", event(1, 5, EVENT["CAL_START"], 1, 20.0, 4)), ("KC_HK", hk()), begin_s=11.8)
    started.tick(15.0)
    assert "No answer was received, but event CAL_START" in started.last_line
    assert "housekeeping stopped 3 s ago" in started.last_line


def test_the_record_of_a_command_names_its_correction():
    c = tracked(commands.rollback(CRC))
    after(c, ("KC_ACK", ack(6)), ("KC_ACK", ack(6)))
    c.tick(15.0)
    found = c.as_dict()
    assert (found["command"], found["crc"], found["sequence_number"]) == ("ROLLBACK", "fedcba98", SEQ)
    assert (found["outcome"], found["duplicate_acknowledgements"]) == (ACCEPTED, 1)
    assert c.last_line.startswith("ROLLBACK fedcba98 accepted")
    assert [v["evidence"] for v in found["verifiers"]][1:] == ["acknowledgement, status 0"] * 2
    assert tracked(commands.noop()).as_dict()["crc"] == ""


# ---------------------------------------------------------------------------- requests


@pytest.mark.parametrize(
    ("request_", "opcode", "arg_i", "crc", "kind"),
    [
        (commands.noop(), "NOOP", (), 0, ""),
        (commands.start(), "START", (-1, 0, 1), 0, ""),
        (commands.start(4, 20, 7, 3, True), "START", (4, 20, 7, 1), 0, ""),
        (commands.abort(), "ABORT", (), 0, ""),
        (commands.approve_arm(CRC), "APPROVE_ARM", (CRC,), CRC, ""),
        (commands.approve_arm(CRC, True), "APPROVE_ARM", (CRC, 1), CRC, ""),
        (commands.approve_go(CRC), "APPROVE_GO", (CRC,), CRC, ""),
        (commands.reject(signed(CRC)), "REJECT", (signed(CRC),), CRC, ""),
        (commands.rollback(CRC), "ROLLBACK", (CRC,), CRC, ""),
        (commands.validate("config", CRC), "TABLE_VALIDATE", (CONFIG, CRC), CRC, "CONFIG"),
        (commands.activate("kin", CRC), "TABLE_ACTIVATE", (4, CRC), CRC, "KIN"),
        (commands.Request("TABLE_DUMP", (CONFIG,)), "TABLE_DUMP", (CONFIG,), 0, "CONFIG"),
        (commands.Request("TABLE_DUMP"), "TABLE_DUMP", (), 0, ""),
        (commands.discard(), "TABLE_DISCARD", (), 0, ""),
    ],
)
def test_a_request_has_its_arguments_and_names_what_it_is_about(request_, opcode, arg_i, crc, kind):
    assert (request_.opcode, request_.arg_i, request_.crc, request_.kind) == (opcode, arg_i, crc, kind)
    assert request_.arg_u64 == (3 if arg_i[:1] == (4,) and opcode == "START" else 0)


# ---------------------------------------------------------------------------- conditions


def test_conditions_are_those_of_flight_in_every_state():
    source = (ROOT / "fsw/app/kc_dispatch.c").read_text()
    free = re.search(r"#define KC_CMD_FREE (.*)", (ROOT / "fsw/command/kc_cmd.h").read_text())[1]
    macros = {"IN_REVIEW": "KC_ST_REVIEW", "IN_ARMED": "KC_ST_ARMED", "KC_CMD_FREE": free, "ANY_STATE": ""}
    rows = dict(re.findall(r"\{KC_CMD_(\w+), KC_SENDER_\w+, ([\w| ]+), (?:true|false)", source))
    assert len(rows) == 11
    for opcode, mask in rows.items():
        wanted = {name for part in mask.split(" | ") for name in re.findall(r"KC_ST_(\w+)", macros[part])}
        assert set(commands.STATES.get(opcode, ())) == wanted, opcode


def test_nothing_speaks_against_a_start_of_a_healthy_lander():
    assert unmet(commands.start(), heard(), 10.5) == ()


@pytest.mark.parametrize(
    ("request_", "fields", "condition", "found"),
    [
        (
            commands.start(), {"state": "MOVE"}, "state IDLE or SAFE",
            "MOVE, by housekeeping received 0.5 s ago",
        ),
        (commands.start(), {"state": "REVIEW"}, "state IDLE or SAFE", "REVIEW"),
        (commands.start(), {"kin": 0}, "all seven tables in force", "no kin"),
        (commands.rollback(CRC), {"kin": 5}, "correction fedcba98 in force", "00000005 is in force"),
        (commands.rollback(CRC), {"kin": CRC, "kin_prev_crc": 0}, "a table before the one in force", "none"),
        (commands.approve_arm(CRC), {"state": "REVIEW"}, "correction fedcba98 waits", "nothing waits"),
        (
            commands.approve_arm(CRC),
            {"state": "REVIEW", "proposal_crc": signed(CRC), "proposal_verdict": 2},
            "a good fit, or an override", "poor fit",
        ),
        (commands.approve_go(CRC), {"state": "REVIEW", "proposal_crc": signed(CRC)}, "state ARMED", "REVIEW"),
        (commands.activate("kin", 7), {}, "a staged kin table", "nothing staged"),
        (commands.activate("kin", 7), {"staged_kind": 1}, "a staged kin table", "kind 1 staged"),
        (
            commands.activate("kin", 7), {"staged_kind": 4, "staged_state": 2},
            "a staged kin table that flight has checked", "not checked yet",
        ),
        (commands.validate("kin", 7), {"staged_kind": 1}, "a staged kin table", "kind 1 staged"),
        (commands.start(poses=-1), {}, f"at most {MOST} poses", "-1 asked for"),
        (commands.start(poses=MOST + 1), {}, f"at most {MOST} poses", f"{MOST + 1} asked for"),
        (commands.start(poses=2**32 + 1), {}, f"at most {MOST} poses", f"{2**32 + 1} asked for"),
        (commands.rollback(CRC), {"kin": 0}, "correction fedcba98 in force", "no correction is in force"),
        (
            commands.approve_go(CRC), {"state": "ARMED", "proposal_crc": 5}, "correction fedcba98 waits",
            "00000005",
        ),
        (commands.reject(CRC), {"state": "ARMED"}, "correction fedcba98 waits", "nothing waits"),
        (
            commands.approve_arm(CRC),
            {"state": "REVIEW", "proposal_crc": signed(CRC), "proposal_verdict": 0},
            "a good fit, or an override", "verdict not known",
        ),
    ],  # fmt: skip
)  # fmt: skip
def test_an_unmet_condition_is_named_with_what_was_found(request_, fields, condition, found):
    first = unmet(request_, heard(**fields), 10.5)[0]
    assert first.condition == condition and found in first.found and first.todo


@pytest.mark.parametrize(
    ("request_", "fields"),
    [
        (commands.noop(), {"state": "MOVE"}),
        (commands.discard(), {"state": "SAFE"}),
        (commands.start(poses=MOST), {"state": "SAFE"}),
        (commands.rollback(CRC), {"kin": CRC}),
        (commands.approve_arm(CRC), {"state": "REVIEW", "proposal_crc": signed(CRC), "proposal_verdict": 1}),
        (commands.approve_arm(CRC, True), {"state": "REVIEW", "proposal_crc": signed(CRC)}),
        (commands.approve_go(CRC), {"state": "ARMED", "proposal_crc": signed(CRC)}),
        (commands.reject(CRC), {"state": "ARMED", "proposal_crc": signed(CRC)}),
        (commands.validate("kin", 7), {"staged_kind": 4, "staged_state": 2}),
        (commands.activate("kin", 7), {"staged_kind": 4, "staged_state": 3}),
    ],
)
def test_nothing_speaks_against_what_flight_would_take(request_, fields):
    assert unmet(request_, heard(**fields), 10.5, key_id=7) == ()


@pytest.mark.parametrize(
    ("request_", "state", "todo"),
    [
        (commands.start(), "MOVE", "wait for its end, or `kincal command abort`"),
        (commands.start(), "REVIEW", "decide first: `kincal review list --live`"),
        (commands.start(), "ARMED", "decide first: `kincal review go`, or `kincal review reject`"),
        (commands.start(), "STORE", "wait a second: a change is being stored"),
        (commands.approve_go(CRC), "REVIEW", "arm first: `kincal review arm`"),
        (commands.approve_go(CRC), "IDLE", "wait for its end"),
        (commands.approve_arm(CRC), "ARMED", "decide first: `kincal review go`, or `kincal review reject`"),
    ],
)
def test_what_to_do_in_a_state_that_does_not_take_a_command(request_, state, todo):
    assert unmet(request_, heard(state=state), 10.5)[0].todo == todo


def test_the_second_step_by_the_holder_of_the_first_is_an_unmet_condition():
    waits = {"state": "ARMED", "proposal_crc": signed(CRC), "go_by_other_key": 1, "armed_key": 7}
    (found,) = unmet(commands.approve_go(CRC), heard(approval_left_us=60_000_000, **waits), 12.0, key_id=7)
    assert found.found == "key 7" and "58 s are left" in found.todo and "review go fedcba98" in found.todo
    for request_, key_id in ((commands.approve_go(CRC), 0), (commands.reject(CRC), 7)):
        assert unmet(request_, heard(**waits), 12.0, key_id) == ()
    assert unmet(commands.approve_go(CRC), heard(**waits | {"go_by_other_key": 0}), 12.0, 7) == ()
    assert unmet(commands.approve_go(CRC), heard(**waits | {"armed_key": 1}), 12.0) == ()  # no key: any


def test_a_start_names_a_fault_and_a_silent_arm():
    s = heard()
    s.take("KC_ARM_STATE", arm_state(fault=4), 10.0, UTC)
    assert [u.found for u in unmet(commands.start(), s, 10.5)] == ["fault mask 0x4"]
    s = heard()
    s.take("KC_HK", hk(103.0), 13.0, UTC)
    assert [u.condition for u in unmet(commands.start(), s, 13.0)] == [
        "messages of the arm controller", "messages of the pan-tilt unit"
    ]  # fmt: skip


def test_stale_or_no_housekeeping_is_an_unmet_condition_but_an_abort_has_none():
    assert unmet(commands.start(), Snapshot(), 1.0)[0].found.startswith("never received")
    assert unmet(commands.noop(), heard(), 20.0)[0].found == "nothing received for 10.0 s"
    assert unmet(commands.abort(), Snapshot(), 1.0) == ()


# ---------------------------------------------------------------------------- ages


def test_unknown_fresh_and_stale_are_three_things():
    s = Snapshot()
    assert s.freshness("KC_HK", 5.0).status == UNKNOWN
    s.take("KC_HK", hk(), 10.0, UTC)
    age = s.freshness("KC_HK", 11.0)
    assert (age.status, age.receive_age_s, age.mission_age_s) == (FRESH, 1.0, 1.0)
    assert s.freshness("KC_HK", 14.0).status == STALE
    assert s.freshness("KC_ARM_STATE", 11.0).status == UNKNOWN


def test_a_message_that_arrives_late_is_stale_by_its_stamp():
    s = Snapshot()
    s.take("KC_HK", hk(100.0), 10.0, UTC)
    s.take("KC_HK", hk(101.0), 20.0, UTC)  # nine seconds late
    age = s.freshness("KC_HK", 20.0)
    assert age.status == STALE and age.receive_age_s == 0.0 and age.mission_age_s == pytest.approx(9.0)
    assert "received 0.0 s ago, but its time stamp is 9.0 s behind flight's clock" in age.why
    s.take("KC_HK", hk(110.2), 20.2, UTC)
    assert s.freshness("KC_HK", 20.3).status == FRESH


@pytest.mark.parametrize(
    ("channel", "stamp_s", "age_s", "why"),
    [
        ("KC_HK", 100.0, 3.0, ""),
        ("KC_HK", 100.0, 3.125, "nothing received for 3.1 s"),
        ("KC_ARM_STATE", 100.0, 2.0, ""),
        ("KC_ARM_STATE", 100.0, 2.125, "nothing received for 2.1 s"),
        ("KC_ARM_STATE", 97.0, 0.0, "its time stamp is 3.0 s behind flight's clock"),
        ("KC_ARM_STATE", 103.0, 0.5, "its time stamp is 2.5 s ahead of flight's clock"),
        ("KC_ARM_STATE", 102.5, 0.5, ""),
        ("KC_PANTILT_STATE", 100.0, 2.125, "nothing received for 2.1 s"),
        ("KC_ACK", 0.0, 2.5, ""),
        ("KC_ACK", 0.0, 3.125, "housekeeping is stale"),
    ],
)
def test_when_a_value_is_stale(channel, stamp_s, age_s, why):
    s = Snapshot()
    s.take("KC_HK", hk(100.0), 10.0, UTC)
    if channel != "KC_HK":
        messages = {"KC_ARM_STATE": arm_state, "KC_PANTILT_STATE": pantilt_state, "KC_ACK": lambda _t: ack(1)}
        s.take(channel, messages[channel](stamp_s), 10.0, UTC)
    age = s.freshness(channel, 10.0 + age_s)
    assert (age.status, age.receive_age_s) == (STALE if why else FRESH, age_s) and why in age.why
    assert (age.mission_age_s == pytest.approx(100.0 + age_s - stamp_s)) or channel == "KC_ACK"
    assert s.freshness(channel, 9.0).receive_age_s == 0.0  # not younger than now


def test_flights_clock_is_known_by_the_message_with_the_least_delay():
    s = Snapshot()
    assert s.mission_now_us(5.0) is None
    s.take("KC_ARM_STATE", arm_state(999.0), 9.0, UTC)
    assert s.mission_now_us(5.0) is None  # the arm has a clock of its own
    s.take("KC_HK", hk(100.0), 10.5, UTC)
    s.take("KC_EVENT", event(100_750_000, 1, EVENT["CAL_POSE"], 1), 11.0, UTC)
    s.take("KC_HK", hk(101.0), 12.0, UTC)
    assert s.mission_now_us(12.0) == 101_750_000
    s.take("KC_HK", hk(50.0), 13.0, UTC)  # set back
    assert s.mission_now_us(13.0) == 50_000_000


def test_messages_are_counted_and_stamped_for_people():
    s = heard()
    s.take("KC_HK", hk(101.0), 11.0, UTC + 0.25)
    last = s.last("KC_HK")
    assert (last.channel, last.n, last.boot, last.rx_s) == ("KC_HK", 2, 0, 11.0)
    assert last.utc == "2027-01-15T08:00:00.250+00:00" and s.heartbeats == 2
    assert s.last("KC_ARM_STATE").n == 1 and s.last("KC_ACK") is None


def test_a_proposal_is_kept_by_its_crc():
    s, p = Snapshot(), kcm.proposal_t()
    p.crc = signed(CRC)
    s.take("KC_PROPOSAL", p, 1.0, UTC)
    assert s.proposal(CRC) is p and s.proposal(CRC - 1) is None


def test_the_last_events_are_kept_but_for_those_of_debugging():
    s = Snapshot()
    for seq in range(503):
        s.take("KC_EVENT", event(1, seq, EVENT["CAL_POSE"], 1), 1.0, UTC)
    assert [e.seq for e in s.events(2)] == [501, 502] and s.events(0) == ()
    assert [e.seq for e in s.events(999)] == list(range(3, 503)) and s.lost_events == 0
    assert len(s.status(1.0, UTC).events) == 8


def test_events_before_the_first_and_after_a_restart_are_not_lost():
    s = heard()
    numbers = [(7, 3), (8, 3), (10, 3), (10, 3), (3, 4), (5, 4)]
    for seq, boots in numbers:
        s.take("KC_HK", hk(100.0 + seq, boots=boots), 11.0, UTC)
        s.take("KC_EVENT", event(1, seq, EVENT["CAL_POSE"], 1), 11.0, UTC)
    assert (s.lost_events, s.restarts) == (2, 1)
    assert s.status(11.0, UTC).boot_count == 4


@pytest.mark.parametrize(
    ("before", "now", "back"),
    [
        ((3, 100, 5), (3, 101, 6), False),
        ((3, 100, 5), (3, 99, 6), True),
        ((3, 100, 5), (3, 100, 5), False),  # the same one again
        ((3, 100, 5), (3, 101, 5), True),
        ((3, 100, 0), (3, 101, 0), False),  # flight of before there were numbers
        ((3, 100, 1), (3, 101, 1), True),
        ((3, 100, 5), (3, 101, 4), True),
        ((3, 100, 5), (4, 10, 1), False),
        ((3, 100, 5), (2, 200, 6), True),
    ],
)
def test_what_comes_from_before_the_message_before_it_is_doubtful(before, now, back):
    senders = Senders()
    for t_s, (boots, t_us, seq) in ((0.0, before), (1.0, now)):
        m = hk(boots=boots)
        m.t_us, m.seq = t_us, seq
        senders.take(m, t_s)
    assert senders.doubtful(1.0) == back and not senders.several(1.0) and senders.taken == 2
    assert senders.doubtful(10.875) == back and not senders.doubtful(11.0)


def test_two_senders_are_forgotten_after_ten_seconds():
    senders = Senders()
    for t_s, boots in ((0.0, 4), (1.0, 3), (2.0, 4), (3.0, 3)):
        senders.take(hk(boots=boots), t_s)
    assert senders.several(10.875) and not senders.several(11.0) and senders.doubtful(12.875)


def test_a_clock_that_is_set_back_does_not_make_everything_stale():
    s = Snapshot()
    s.take("KC_HK", hk(5000.0), 10.0, UTC)
    s.take("KC_HK", hk(100.0), 11.0, UTC)
    s.take("KC_HK", hk(101.0), 12.0, UTC)
    assert s.freshness("KC_HK", 12.0).status == FRESH


def test_values_from_before_a_restart_do_not_pass_for_new():
    s = heard()
    p = kcm.progress_t()
    p.t_us = 100_000_000
    s.take("KC_PROGRESS", p, 10.0, UTC)
    assert s.freshness("KC_PROGRESS", 10.1).status == FRESH
    s.take("KC_HK", hk(100.5, boots=4), 10.5, UTC)
    age = s.freshness("KC_PROGRESS", 10.6)
    assert age.status == STALE and "before flight was started again" in age.why
    assert s.status(10.6, UTC).restarts == 1
    assert s.freshness("KC_HK", 10.6).status == FRESH


def test_what_comes_on_occasion_is_as_fresh_as_the_link():
    s = heard()
    s.take("KC_PROPOSAL", kcm.proposal_t(), 10.0, UTC)
    s.take("KC_HK", hk(200.0), 110.0, UTC)
    assert s.freshness("KC_PROPOSAL", 110.5).status == FRESH
    assert s.freshness("KC_PROPOSAL", 120.0).why == "housekeeping is stale"


def test_who_has_to_act_is_said_and_not_guessed_from_old_telemetry():
    assert "nothing runs" in heard().status(10.5, UTC).waits_for
    waits = {"proposal_crc": signed(CRC), "proposal_verdict": 2}
    assert heard(state="REVIEW", **waits).status(10.5, UTC).waits_for == (
        "the ground: decide on correction fedcba98 (poor fit)"
    )
    armed = heard(state="ARMED", approval_left_us=60_000_000, **waits).status(12.0, UTC)
    assert armed.waiting.left_s == pytest.approx(58.0) and "expires in 58 s" in armed.waits_for
    old = heard(state="MOVE").status(30.0, UTC)
    assert old.waits_for == "not known: nothing received for 20.0 s; the last state was MOVE"
    assert Snapshot().status(1.0, UTC).waits_for.startswith("not known: no housekeeping")


@pytest.mark.parametrize("state", ["IDLE", "SAFE"])
def test_a_start_that_would_be_refused_is_not_offered(state):
    ready = heard(state=state)
    assert "START begins a calibration" in ready.status(10.1, UTC).waits_for
    ready.take("KC_ARM_STATE", arm_state(100.1, fault=4), 10.1, UTC)
    assert "START would be refused: the arm controller reports a fault, mask 0x4" in (
        ready.status(10.2, UTC).waits_for
    )
    silent = heard(state=state)
    silent.take("KC_HK", hk(103.0, state), 13.0, UTC)
    assert "START would be refused: the arm controller is silent (nothing received for 3.1 s)" in (
        silent.status(13.1, UTC).waits_for
    )
    fresh = Snapshot()  # a controller that died before this program began to listen is unknown, never stale
    fresh.take("KC_HK", hk(100.0, state), 10.0, UTC)
    assert "START begins" in fresh.status(10.1, UTC).waits_for  # too early to tell
    fresh.take("KC_HK", hk(101.0, state), 11.0, UTC)
    assert "START would be refused: the arm controller is silent" in fresh.status(11.1, UTC).waits_for


def test_every_state_says_who_has_to_act():
    computing = {"SELECT", "UPDATE", "REFINE", "LEARN", "REPORT", "PROPOSE"}
    for state in STATE:
        if state != "COUNT":
            text = heard(state=state).status(10.5, UTC).waits_for
            assert (text == "flight: it computes") == (state in computing), state


def test_lost_events_are_counted_on_board_and_on_the_link():
    s = heard()
    for seq in (1, 2, 5):
        s.take("KC_EVENT", event(1, seq, EVENT["CAL_POSE"], 1), 10.0, UTC)
    assert s.lost_events == 2
    s.take("KC_HK", hk(101.0, n_events_dropped=3), 11.0, UTC)
    assert s.lost_events == 5


def test_events_come_with_cause_and_action():
    s = heard()
    s.take("KC_EVENT", event(1, 1, EVENT["IN_SILENT"], 3, 2e6, 1), 10.0, UTC)
    s.take("KC_EVENT", event(1, 2, EVENT["DET_NONE"], 0), 10.0, UTC)
    (line,) = s.status(10.1, UTC).events
    assert (
        line.name == "IN_SILENT"
        and "sender has stopped" in line.cause
        and "kincal command start" in line.action
    )


def test_no_event_from_info_up_is_without_cause_and_action():
    """As docs/OPERATIONS.md has them: the console and `kincal status` read the same table."""
    numbers = [n for n in EVENT.values() if event_name(n) != "UNKNOWN"]
    assert len(numbers) > 90
    for number in numbers:
        assert event_cause(number).strip(), event_name(number)
        assert event_todo(number).strip(), event_name(number)
    assert event_cause(60_000) == event_todo(60_000) == ""


def test_every_cause_of_an_abort_says_what_to_do():
    causes = library("flight").enum("kc_cause_t", "KC_CAUSE_")
    for name, number in causes.items():
        if name != "COUNT":
            line = event_of(event(1, 1, EVENT["CAL_ABORTED"], 3, float(number), 6))
            assert line.cause and line.action and "OPERATIONS" not in line.action, name
    for counter, asked in ((1.0, True), (2.0, False)):
        line = event_of(event(1, 1, EVENT["CMD_REPLAYED"], 3, counter, 2))
        assert (line.action == "Nothing.", line.cause.startswith("Somebody with this key asked")) == (
            asked,
            asked,
        )
    silent = event_of(event(1, 1, EVENT["CAL_ABORTED"], 3, float(causes["SILENT"]), 6))
    assert silent.cause == "no state messages from the arm or the pan-tilt unit"
    assert "As event IN_SILENT." in silent.action and "Check that the sender runs" in silent.action
    for got in (99.0, -1.0, float("nan"), float("inf")):
        assert event_of(event(1, 1, EVENT["CAL_ABORTED"], 3, got, 6)).action


def test_a_status_is_plain_data():
    import json

    done = json.loads(json.dumps(heard().status(10.5, UTC).as_dict()))
    assert done["state"] == "IDLE"
    assert {i["key"]: i["freshness"]["status"] for i in done["items"]}["tags"] == UNKNOWN
    assert {t["kind"]: t["crc"] for t in done["tables"]}["kin"] == "00000001"


def test_prismatic_joints_are_shown_in_millimetres():
    s, m = Snapshot(prismatic=[2]), arm_state()
    m.n_joints, m.q_rad[:2] = 2, [0.5, 0.25]
    s.take("KC_ARM_STATE", m, 1.0, UTC)
    s.take("KC_HK", hk(mon_state=1, mon_joint=2, mon_bias=0.004, mon_sigma=0.0005), 1.0, UTC)
    text = {item.key: item.text for item in s.items(1.0)}
    assert text["joints"] == "28.65 deg, 250.00 mm"
    assert text["monitor"] == "joint 2 reads wrong by 4 mm ± 0.5 mm"


def test_every_value_is_shown_with_its_unit():
    s, m, arm, pantilt = Snapshot(), hk(12.25), arm_state(fault=0x14), pantilt_state()
    m.session, m.n_poses, m.n_poses_goal, m.candidate, m.n_cmd_ok, m.n_cmd_refused = 2, 3, 20, 41, 5, 6
    m.n_events_dropped, m.n_rx_errors, m.n_tx_errors, m.energy_j = 7, 8, 9, 1234.4
    m.staged_kind, m.staged_bytes, m.staged_state = kind_number("kin"), 640, 2
    arm.n_joints, arm.q_rad[:3], arm.moving = 2, [0.5, -0.25, 9.0], 1
    pantilt.pan_rad, pantilt.tilt_rad = 0.5, -0.25
    tags, p = kcm.detection_t(), kcm.progress_t()
    tags.n_tags, tags.tag_id[:3] = 2, [4, 6, 8]
    p.res_pos_m, p.res_rot_rad, p.pred_pos_m, p.pred_rot_rad = 0.00125, 0.01, 0.0025, 0.02
    channels = ("KC_HK", "KC_ARM_STATE", "KC_PANTILT_STATE", "KC_DETECTION", "KC_PROGRESS")
    for channel, message in zip(channels, (m, arm, pantilt, tags, p), strict=True):
        s.take(channel, message, 10.0, UTC)
    items = s.items(10.5)
    assert {item.key: (item.value, item.text) for item in items} == {
        "state": (STATE["IDLE"], "IDLE"), "mission_time": (12.25, "12.2 s"), "session": (2, "2"),
        "poses": (3, "3 of 20, local initial poses included"), "candidate": (41, "41"), "boots": (3, "3"),
        "commands_ok": (5, "5"), "commands_refused": (6, "6"), "events_dropped": (7, "7"),
        "rx_errors": (8, "8"), "tx_errors": (9, "9"), "energy": (pytest.approx(1234.4), "1234 J"),
        "monitor": (0, "quiet"), "staged": (m.staged_kind, "kin, 640 bytes, complete"),
        "joints": ([0.5, -0.25], "28.65 deg, -14.32 deg"), "arm_moving": (True, "moving"),
        "arm_fault": (0x14, "0x14"), "pantilt": ([0.5, -0.25], "28.65 -14.32 deg"),
        "pantilt_moving": (False, "at rest"), "tags": (2, "2 (4, 6)"),
        "residual": (0.00125, "1.25 mm, 0.573 deg"), "predicted": (0.0025, "2.50 mm, 1.146 deg"),
    }  # fmt: skip
    assert {item.channel for item in items} == set(channels)
    assert {item.freshness.receive_age_s for item in items} == {0.5}


@pytest.mark.parametrize(
    ("fields", "key", "text"),
    [
        ({"n_poses_goal": 0}, "poses", "0 of 0"),
        ({"staged_kind": 0}, "staged", "nothing"),
        ({"staged_kind": 77, "staged_bytes": 2, "staged_state": 1}, "staged", "kind 77, 2 bytes, loading"),
        ({"staged_kind": CONFIG, "staged_state": 3}, "staged", "config, 0 bytes, valid"),
        ({"staged_kind": CONFIG, "staged_state": 0}, "staged", "config, 0 bytes, nothing"),
        ({"staged_kind": CONFIG, "staged_state": 4}, "staged", "config, 0 bytes, ?4"),
        ({"mon_state": 2}, "monitor", "unexplained error"),
        (
            {"mon_state": 1, "mon_joint": 2, "mon_bias": 0.1, "mon_sigma": 0.01},
            "monitor",
            "joint 2 reads wrong by 5.73 deg ± 0.57 deg",
        ),
        (
            {"mon_state": 3, "mon_chance": [0.01, 0.009, *[0.0] * 6]},
            "monitor",
            "joints read wrong together; probability of each: 1 (1%)",
        ),
    ],  # fmt: skip
)
def test_values_that_have_several_forms(fields, key, text):
    assert next(item.text for item in heard(**fields).items(10.1) if item.key == key) == text


def test_no_tags_are_shown_as_none():
    s = Snapshot()
    s.take("KC_DETECTION", kcm.detection_t(), 1.0, UTC)
    assert next(item for item in s.items(1.0) if item.key == "tags").text == "0"


def test_joints_that_are_off_together_are_shown_with_their_probabilities():
    s, m = Snapshot(), hk(mon_state=3, mon_joint=2)
    m.mon_chance[1], m.mon_chance[3], m.mon_chance[5] = 1.0, 0.94, 0.009
    s.take("KC_HK", m, 1.0, UTC)
    text = {item.key: item.text for item in s.items(1.0)}
    assert text["monitor"] == "joints read wrong together; probability of each: 2 (100%), 4 (94%)"


def test_the_index_by_state_in_operations_has_every_state_and_no_other():
    page = (ROOT / "docs" / "OPERATIONS.md").read_text()
    table = page.partition("## By state")[2].partition("## By symptom")[0]
    named = [name for line in table.splitlines() if line.startswith("| `") for name in
             re.findall(r"`([A-Z]+)`", line.split("|")[1])]  # fmt: skip
    assert sorted(named) == sorted(name for name in STATE if name != "COUNT")


def test_every_command_of_the_tables_in_operations_exists():
    page = (ROOT / "docs" / "OPERATIONS.md").read_text()
    known = set(re.findall(r"^## kincal ([a-z ]+)$", (ROOT / "docs" / "CLI.md").read_text(), re.M))
    used = set(re.findall(r"\bkincal ((?:[a-z]+)(?: [a-z]+)?)", page)) - {"record"}
    lacking = {u for u in used if u not in known and u.split()[0] not in known}
    assert not lacking
    for group in ("command", "review", "audit", "table", "space", "model", "key"):
        verbs = {u.split()[1] for u in used if u.startswith(f"{group} ")}
        assert verbs <= {k.split()[1] for k in known if k.startswith(f"{group} ")}, group


def random_message(rng, opcode):
    """Anything that flight, a stranger or another sender may say."""

    def one(*values):
        return values[rng.integers(len(values))]

    kind = rng.integers(4)
    if kind == 0:
        status, seq, source = one(0, -8), one(SEQ, SEQ, SEQ + 1), one(1, 2, 2)
        return "KC_ACK", ack(one(opcode, opcode, 1), status, one(0, 13, 9999), seq, source)
    if kind == 1:
        got = one(0.0, 1.0, float(opcode), float(CRC), float("nan"), float("inf"), -1e300)
        number = one(*EVENT.values(), 60_000)
        return "KC_EVENT", event(1, int(rng.integers(100)), number, one(0, 1, 2, 3, 9), got, one(SEQ, 0, -1))
    if kind == 2:
        m = hk(
            float(rng.uniform(0, 200)), one(*(s for s in STATE if s != "COUNT")), one(3, 3, 3, 4), one(1, CRC)
        )
        m.proposal_crc, m.staged_kind, m.staged_state = one(0, signed(CRC)), one(0, 4, 99), one(0, 1, 2, 3, 9)
        m.mon_state = one(0, 1, 2, 9)
        return "KC_HK", m
    return "KC_ARM_STATE", arm_state(float(rng.uniform(-1e6, 1e6)), int(rng.integers(16)))


ORDER = [SENT, RECEIVED, ACCEPTED, REFUSED, DONE]


REQUESTS = [
    commands.noop(), commands.start(), commands.abort(), commands.approve_arm(CRC, True),
    commands.approve_go(CRC), commands.reject(CRC), commands.rollback(CRC), commands.validate("kin", CRC),
    commands.activate("kin", CRC), commands.discard(),
]  # fmt: skip


@pytest.mark.parametrize("request_", REQUESTS, ids=lambda r: r.opcode)
def test_whatever_is_received_verifiers_keep_their_order_and_an_end_is_an_end(request_):
    rng = np.random.default_rng(len(request_.opcode))
    opcode = names.opcode(request_.opcode)
    for _ in range(40):
        c, s, now_s = tracked(request_, "MOVE"), Snapshot(), 10.0
        for _ in range(25):
            now_s += float(rng.exponential(0.4))
            channel, message = random_message(rng, opcode)
            before = c.outcome, c.last_line
            c.take(channel, message, now_s, UTC)
            s.take(channel, message, now_s, UTC)
            c.tick(now_s)
            stages = [step.stage for step in c.steps]
            assert len(set(stages)) == len(stages) and stages == sorted(stages, key=ORDER.index)
            assert not {REFUSED, DONE} <= set(stages) and (DONE not in stages or ACCEPTED in stages)
            if before[0] in (DONE, REFUSED):
                assert (c.outcome, c.last_line) == before
            assert bool(c.outcome) == bool(c.last_line)
            unmet(request_, s, now_s)
            assert s.status(now_s, UTC).as_dict()["state"] == s.state
        c.tick(now_s + 100.0)
        assert c.outcome
