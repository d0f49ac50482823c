"""One command and its verifiers, and how old telemetry is: without a network and without a clock."""

import re
from pathlib import Path

import numpy as np
import pytest
from samples import CRC, event, signed

import kcm
from kincal.flight import event_name, library
from kincal.flight.events import event_cause, event_todo
from kincal.link import names
from kincal.operate import commands
from kincal.operate.commands import ACCEPTED, DONE, RECEIVED, REFUSED, SENT, UNCERTAIN, Tracked, unmet
from kincal.operate.snapshot import FRESH, STALE, UNKNOWN, Snapshot, event_of

ROOT = Path(__file__).resolve().parents[2]
STATE = library("flight").enum("kc_state_t", "KC_ST_")
EVENT = library("flight").enum("kc_event_id_t", "KC_EVT_")
SEQ, UTC = 77, 1.8e9


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
        101_000_000,
        source,
        seq,
        opcode,
        status,
        event_id,
    )
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


def test_a_next_start_and_a_change_by_somebody_else_are_the_same_flight():
    c = Tracked(commands.approve_go(CRC), SEQ, 10.0, UTC, 5.0, 3, "ARMED", hk())
    go = ack(names.opcode("APPROVE_GO"))
    stages = after(c, ("KC_ACK", go), ("KC_HK", hk(boots=4, kin=CRC)))
    assert stages[-1] == DONE
    c = Tracked(commands.abort(), SEQ, 10.0, UTC, 5.0, 3, "MOVE", hk())
    changed = ("KC_HK", hk(state="SAFE", table_crc=[0, 1, 1, 1, 1, 1, 1, 8]))
    assert after(c, ("KC_ACK", ack(names.opcode("ABORT"))), changed)[-1] == ACCEPTED
    assert after(c, changed, begin_s=11.0)[-1] == DONE  # it stays so


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
            commands.start(),
            {"state": "MOVE"},
            "state IDLE or SAFE",
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
            "a good fit, or an override",
            "poor fit",
        ),
        (commands.approve_go(CRC), {"state": "REVIEW", "proposal_crc": signed(CRC)}, "state ARMED", "REVIEW"),
        (commands.activate("kin", 7), {}, "a staged kin table", "nothing staged"),
    ],
)
def test_an_unmet_condition_is_named_with_what_was_found(request_, fields, condition, found):
    first = unmet(request_, heard(**fields), 10.5)[0]
    assert first.condition == condition and found in first.found and first.todo


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


def test_joints_that_are_off_together_are_shown_with_their_probabilities():
    s, m = Snapshot(), hk(mon_state=3, mon_joint=2)
    m.mon_chance[1], m.mon_chance[3], m.mon_chance[5] = 1.0, 0.94, 0.009
    s.take("KC_HK", m, 1.0, UTC)
    text = {item.key: item.text for item in s.items(1.0)}
    assert text["monitor"] == "joints read wrong together; probability of each: 2 (100%), 4 (94%)"


def test_start_from_the_suspects_is_the_fourth_argument():
    assert commands.start().arg_i == (-1, 0, 1)
    assert commands.start(4, 20, 7, 0x3, suspects=True).arg_i == (4, 20, 7, 1)


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
    commands.noop(),
    commands.start(),
    commands.abort(),
    commands.approve_arm(CRC, True),
    commands.approve_go(CRC),
    commands.reject(CRC),
    commands.rollback(CRC),
    commands.validate("kin", CRC),
    commands.activate("kin", CRC),
    commands.discard(),
]


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
