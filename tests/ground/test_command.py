"""`kincal command`, `status`, `review comment` and what they write down: against a link in the same thread,
and over LCM against a few lines of flight."""

import io
import json
import re
import time

import pytest
from commands import good, text_of
from commands import shell as kincal
from direct_flight import EVENT, STATE, DirectFlight, Lander, act
from fake_flight import FakeFlight
from places import BIN
from rich.console import Console
from rich.markup import escape
from samples import CRC, decided, event, proposal, signed, write_log
from test_changes import in_force, kin_image

import kcm
from kincal import review
from kincal.api import operate
from kincal.cli import terminal
from kincal.cli.command import command as command_cli
from kincal.cli.errors import EXIT_INPUT
from kincal.cli.review import review as review_cli
from kincal.cli.table import table as table_cli
from kincal.cli.text import operate as text
from kincal.flight import library
from kincal.flight.tables import decode_as, encode, kind_number
from kincal.link import names
from kincal.operate import recording
from kincal.review.decisions import Operator
from kincal_shared import keys
from kincal_shared.errors import BadInput, CommandFailed, NoAnswer

POOR = kcm.proposal_t.POOR
ACQUISITION, CONFIG = library("flight").enum("kc_acq_t", "KC_ACQ_"), kind_number("config")


@pytest.fixture
def journal(tmp_path):
    return tmp_path / "journal.jsonl"


@pytest.fixture
def flight(signer):
    return Lander(signer)


def lines(journal, key_file):
    return [(e.decision, e.command, e.why) for e in review.check_journal(journal, keys.read(key_file))]


# ---------------------------------------------------------------------------- written down


def test_a_command_is_written_down_before_it_is_sent_and_after(journal, key_file):
    done, steps, _ = act(Lander(keys.signer_of(key_file)), operate.start(), journal)
    assert done.outcome == operate.DONE and steps == ["sent", "received", "accepted", "done"]
    assert lines(journal, key_file) == [("attempt", "START", "because"), ("start", "START", "because")]
    entry = review.check_journal(journal)[-1]
    assert (entry.by, entry.counter > 0) == ("A. Operator", True)


def test_a_refusal_and_silence_are_written_down_as_what_they_are(flight, journal, key_file):
    flight.refuse = {kcm.cmd_t.START: (-8, EVENT["CMD_STATE"])}
    assert act(flight, operate.start(), journal)[0].outcome == operate.REFUSED
    flight.refuse, flight.publish = {}, lambda _channel, _message: None
    assert act(flight, operate.rollback(CRC), journal)[0].outcome == operate.UNCERTAIN
    said = [(decision, command) for decision, command, _ in lines(journal, key_file)]
    assert said == [
        ("attempt", "START"), ("refused", "START"), ("attempt", "ROLLBACK"), ("unanswered", "ROLLBACK")
    ]  # fmt: skip
    why = [e.why for e in review.check_journal(journal)]
    assert "START refused: CMD_STATE" in why[1] and "It was sent once." in why[3]


def test_nothing_is_sent_twice_whatever_comes_back(flight, journal):
    sent = flight.publish

    def twice(channel, message):
        sent(channel, message)
        flight.waiting.extend(list(flight.waiting))  # every answer comes again

    flight.publish = twice
    done, steps, _ = act(flight, operate.rollback(CRC), journal)
    assert done.outcome == operate.DONE and len(flight.commands) == 1 and done.duplicates == 1
    flight.publish = lambda _channel, message: flight.commands.append(message)
    act(flight, operate.start(), journal)
    assert [c.opcode for c in flight.commands] == [kcm.cmd_t.ROLLBACK, kcm.cmd_t.START]


def test_a_restart_before_the_answer_ends_it_and_says_so(flight, journal):

    def publish(_channel, _message):
        flight.hk.boot_count += 1

    flight.publish = publish
    done, _, _ = act(flight, operate.start(), journal)
    assert done.outcome == operate.UNCERTAIN and "start 3 -> 4" in done.last_line


def test_an_unsound_journal_stops_a_command_but_not_an_abort(flight, journal):
    act(flight, operate.start(), journal)
    journal.write_text(journal.read_text().replace("A. Operator", "B. Operator"))
    n = len(flight.commands)
    with pytest.raises(BadInput, match="the review journal was changed"):
        act(flight, operate.rollback(CRC), journal)
    assert len(flight.commands) == n
    done, _, said = act(flight, operate.abort(), journal)
    assert done.outcome == operate.DONE and "not in the journal" in said[0]


def test_an_abort_needs_no_key_and_any_other_command_does(journal):
    flight = Lander()
    done, _, said = act(flight, operate.abort(), journal)
    assert done.outcome == operate.DONE and said == [
        "not in the journal: there is no key to vouch for the line"
    ]
    with pytest.raises(BadInput, match="has to be signed"):
        act(flight, operate.start(), journal)


def test_a_command_is_stamped_by_housekeeping_not_by_the_arm(flight, journal):
    snapshot = operate.Snapshot()
    operate.listen(flight, snapshot, 2.0, lambda s: s.hk is not None)
    stranger = kcm.arm_state_t()
    stranger.t_us = 1
    flight.note("KC_ARM_STATE", stranger)
    who = Operator("me", "x", journal, 5.0)
    operate.act(flight, operate.start(), who, snapshot, lambda _step: None)
    assert flight.commands[0].t_us == flight.hk.t_us


# ---------------------------------------------------------------------------- on the command line


def test_a_dry_run_sends_nothing_and_names_what_is_not_met(journal):
    with FakeFlight(CRC) as flight:
        run = kincal(
            "command", "rollback", "00000001", "--dry-run", "--url", flight.url, "--journal", journal
        )
        assert run.exit_code == 1, run.output
        assert "not met: state IDLE or SAFE; found: REVIEW, by housekeeping received" in run.output
        assert "flight would refuse ROLLBACK; nothing was sent" in text_of(run)
        run = kincal(
            "review", "reject", f"{CRC:08x}", "--by", "me", "--why", "x", "--dry-run", "--url", flight.url
        )
        assert run.exit_code == 0 and "nothing known speaks against REJECT" in run.output
        run = kincal(
            "command", "go", f"{CRC:08x}", "--by", "me", "--why", "x", "--dry-run", "--url", flight.url
        )
        assert run.exit_code == 1 and "arm first: `kincal review arm`" in run.output
        assert flight.commands == []
    assert not journal.exists()


def test_a_dry_run_is_also_data(journal):
    with FakeFlight() as flight:
        run = kincal("command", "start", "--dry-run", "--json", "--url", flight.url, "--journal", journal)
    found = json.loads(run.output)
    assert (run.exit_code, found["state"], found["sent"]) == (1, "IDLE", False)
    assert "all seven tables in force" in [u["condition"] for u in found["unmet"]]


def test_a_command_prints_its_verifiers_or_data_and_its_exit_status(journal):
    with FakeFlight() as flight:
        given = ("--url", flight.url, "--journal", journal)
        run = good("command", "noop", *given)
        assert [line.split()[1] for line in run.output.splitlines()[:4]] == [
            "sent", "received", "accepted", "done"
        ]  # fmt: skip
        assert run.output.splitlines()[-1] == "NOOP done: flight answers"
        run = kincal("command", "noop", "--json", *given)
        assert json.loads(run.output)["outcome"] == "done"
    with FakeFlight(refuse=(kcm.cmd_t.START,)) as flight:
        run = kincal("command", "start", "--url", flight.url, "--journal", journal)
        assert run.exit_code == 1 and "START refused: CMD_STATE" in run.output
        assert flight.unsigned == []


@pytest.mark.parametrize(
    ("args", "text"),
    [
        (("--acquisition", "best"), "'best' is no acquisition"),
        (("--coefficients", "xyz"), "is no mask of coefficients"),
        (("--coefficients", "f" * 17), "is no mask of coefficients"),
        (("--joints", "4;5"), "'4;5' are no joints"),
        (("--joints", "4", "--tables", "/"), "cannot read"),
        (("--joints", "9"), "no enabled coefficient of joint 9"),
        (("--joints", "4", "--coefficients", "f"), "two choices of coefficients"),
    ],
)
def test_a_wrong_argument_is_named_before_anything_is_sent(args, text):
    run = kincal("command", "start", *args)
    assert run.exit_code == 2 and text in run.output


def test_a_calibration_of_the_joints_that_the_monitor_suspects(journal):
    with FakeFlight() as flight:
        flight.images[3] = (BIN / "terms.tbl").read_bytes()
        common = ("--journal", journal, "--url", flight.url, "--timeout", 1)
        run = kincal("command", "start", "--joints", "2,4", "--dry-run", *common)
        assert "coefficients f0f0: J2.phi_rad, J2.alpha_rad, J2.a_m, J2.d_m, J4.phi_rad" in run.output
        kincal("command", "start", "--joints", "4", *common)
        assert flight.masks == [0xF000]
        flight.images[3] = (BIN / "kin.tbl").read_bytes()  # another CRC
        run = kincal("command", "start", "--joints", "4", *common)
        assert run.exit_code == 2 and "are in force, these are" in run.output and flight.masks == [0xF000]


def test_status_is_one_screen_and_plain_data():
    with FakeFlight(CRC) as flight:
        run = good("status", "--seconds", 0.5, "--url", flight.url)
        assert "waits for the ground: decide on correction fedcba98 (change proposed)" in run.output
        assert "kin 00000001" in run.output and "arm missing" in run.output
        assert re.search(r"joints +unknown", run.output)
        assert len(run.output.splitlines()) < 40
        run = kincal("status", "--seconds", 0.5, "--json", "--url", flight.url)
    assert json.loads(run.output)["waiting"]["crc"] == "fedcba98"


@pytest.mark.parametrize(("age_s", "ended"), [(1, False), (3600, True)])
def test_status_says_what_is_of_a_recording_and_of_an_earlier_start(tmp_path, monkeypatch, age_s, ended):
    """Events of a recorder that was stopped, and of flight before its restart, passed for the present."""
    monkeypatch.setattr(recording, "FOLDER", tmp_path)
    with FakeFlight() as flight:
        r = recording.Recorder(tmp_path, recording.stem_of(flight.url))
        for k, m in enumerate((event(1, 7, EVENT["BOOT"], 1, index=4), event(2, 8, EVENT["ARM_FAULT"], 3))):
            r.take("KC_EVENT", m.encode(), round((time.time() - age_s) * 1e6) + k, 0.0)
        r.close()
        flight.boot_count = 5
        run = kincal("status", "--seconds", 0.3, "--url", flight.url)
        said = text_of(run)
        flight.boot_count = 4
        now = kincal("status", "--seconds", 0.3, "--url", flight.url).output
    assert f"those with a date are of {r.files[0]}" in said
    assert ("nothing is known of what happened since then" in said) is ended
    assert re.search(
        r"20\d\d-\d\d-\d\dT[\d:]+Z error +ARM_FAULT: .*\(start 4 of flight, not the present one\)", said
    )
    assert "ARM_FAULT" in now and "not the present one" not in now


def test_status_without_flight_says_so_and_fails():
    run = kincal("status", "--seconds", 0.2, "--url", "udpm://239.255.76.67:1?ttl=0")
    assert run.exit_code == 1 and "who has to act is not known: no housekeeping received" in run.output
    assert "whether a correction waits is not known" in run.output
    assert "no correction waits" not in run.output


def printed(snapshot, now_s):
    """One screen of text."""
    out = Console(file=io.StringIO(), width=200)
    text.status(out, snapshot.status(now_s, 0.0), "udpm://nowhere")
    return out.file.getvalue()


def test_a_screen_that_is_stale_does_not_say_that_nothing_waits():
    s = operate.Snapshot()
    s.take("KC_HK", heartbeat("IDLE"), 1.0, 0.0)
    assert "no correction waits" in printed(s, 1.5)
    assert "whether a correction waits is not known\n" in printed(s, 9.0)
    waits = heartbeat("REVIEW")
    waits.proposal_crc, waits.proposal_verdict = signed(CRC), 1
    s.take("KC_HK", waits, 10.0, 0.0)
    assert "REVIEW (stale)" in printed(s, 19.0)
    assert "waits is not known; fedcba98 waited when flight was last heard" in printed(s, 19.0)


def test_cause_and_action_of_an_event_that_comes_again_are_said_once():
    s = operate.Snapshot()
    for seq in (1, 2, 3):
        s.take("KC_EVENT", event(1, seq, EVENT["IN_SILENT"], 3, 2e6, 1), 1.0, 0.0)
    said = printed(s, 1.5)
    assert said.count("IN_SILENT:") == 3 and said.count("cause:") == said.count("do:") == 1
    assert said.rstrip().splitlines()[-1].lstrip().startswith("do:")  # under the newest


def test_questions_and_comments_are_lines_of_the_journal(journal, key_file):
    given = ("--by", "B. Second", "--journal", journal)
    first = good("review", "comment", "pose 7 was in shadow", "--crc", "fedcba98", *given)
    assert "first line of this journal about a correction fedcba98; is the CRC right?" in first.output
    second = good("review", "comment", "pose 8 too", "--crc", "fedcba98", *given)
    assert "is the CRC right" not in second.output
    good("review", "comment", "why now?", "--question", *given)
    assert lines(journal, key_file) == [
        ("comment", "", "pose 7 was in shadow"), ("comment", "", "pose 8 too"), ("question", "", "why now?"),
    ]  # fmt: skip
    empty = kincal("review", "comment", "", *given)
    assert (empty.exit_code, "the comment is empty" in empty.output) == (EXIT_INPUT, True)
    nobody = kincal("review", "comment", "a", "--by", "", "--journal", journal)
    assert (nobody.exit_code, "the name is empty" in nobody.output) == (EXIT_INPUT, True)
    assert len(lines(journal, key_file)) == 3
    assert decided(review.check_journal(journal))[0].crc == "fedcba98"
    assert "pose 7 was in shadow" in kincal("audit", "log", "--journal", journal).output


# ---------------------------------------------------------------------------- a calibration that goes on


def heartbeat(state, boots=1, t_us=1_000_000):
    m = kcm.hk_t()
    m.t_us, m.state, m.boot_count = t_us, STATE[state], boots
    return m


def test_a_follower_shows_what_is_new_and_ends_when_people_have_to_act():
    w = operate.Follower(operate.Snapshot())
    p = kcm.progress_t()
    p.pose, p.n_goal = 1, 20
    assert w.take("KC_HK", heartbeat("MOVE"), 1.0, 0.0)[0].text == "state MOVE, waits for the arm: to arrive"
    assert w.take("KC_HK", heartbeat("AIM"), 2.0, 0.0) == []  # poses and events tell more
    (line,) = w.take("KC_PROGRESS", p, 2.0, 0.0)
    assert line.pose.number == 1 and line.n_goal == 20 and line.first
    (line,) = w.take("KC_PROGRESS", p, 2.0, 0.0)
    assert not line.first
    assert w.take("KC_EVENT", event(1, 1, EVENT["CAL_POSE"], 1), 2.0, 0.0) == []
    assert w.take("KC_EVENT", event(1, 2, EVENT["DET_NONE"], 0), 2.0, 0.0) == []
    (line,) = w.take("KC_EVENT", event(1, 3, EVENT["IN_SILENT"], 3, 2e6, 1), 2.0, 0.0)
    assert line.event.name == "IN_SILENT" and line.event.action
    assert (
        w.take("KC_PROPOSAL", proposal(), 2.0, 0.0)[0].text == "correction fedcba98 proposed: change proposed"
    )
    assert w.ended == ""
    waits = heartbeat("REVIEW")
    waits.proposal_crc, waits.proposal_verdict = signed(CRC), 1
    (line,) = w.take("KC_HK", waits, 3.0, 0.0)
    assert line.text == "state REVIEW, waits for the ground: decide on correction fedcba98 (change proposed)"
    assert w.ended == "a correction waits for people"


@pytest.mark.parametrize("state", ["IDLE", "SAFE"])
def test_a_follower_that_finds_nothing_to_follow_says_so(state):
    w = operate.Follower(operate.Snapshot())
    said = [line.text for line in w.take("KC_HK", heartbeat(state), 1.0, 0.0)]
    assert said[1].startswith("no calibration runs: this waits for the next one, Ctrl-C ends it")
    assert w.take("KC_HK", heartbeat(state), 2.0, 0.0) == [] and w.ended == ""


def test_the_columns_of_poses_have_a_head():
    p = kcm.progress_t()
    line = operate.Follower(operate.Snapshot()).take("KC_PROGRESS", p, 2.0, 0.0)[0]
    out = Console(file=io.StringIO(), width=200)
    text.watched(out, line)
    assert out.file.getvalue().startswith("pose   cand  servo   residual")


def test_a_follower_says_once_that_the_link_is_silent_and_that_flight_was_started_again():
    w = operate.Follower(operate.Snapshot())
    assert w.tick(0.5) == []
    w.take("KC_HK", heartbeat("MOVE"), 1.0, 0.0)
    assert w.tick(1.5) == []
    assert w.tick(9.0)[0].text.startswith("housekeeping is stale")
    assert w.tick(10.0) == []
    said = [line.text for line in w.take("KC_HK", heartbeat("IDLE", 2, 2_000_000), 11.0, 0.0)]
    assert said[0] == "flight was started again: a calibration that ran is lost"
    assert w.tick(11.1)[0].text == "housekeeping comes again"
    assert w.ended.startswith("the calibration has ended")


# ---------------------------------------------------------------------------- no network


class OnLine(Lander):
    """In place of a link of the command line: arm and pan-tilt unit are heard too. quiet: nothing is."""

    quiet = False

    def __enter__(self):
        return self

    def __exit__(self, *_exc):
        self.closed = True

    def next(self, timeout_s):
        if self.quiet:
            self.now_s += timeout_s
            return None
        return super().next(timeout_s)

    def also_heard(self):
        for channel, message in (
            ("KC_ARM_STATE", kcm.arm_state_t()),
            ("KC_PANTILT_STATE", kcm.pantilt_state_t()),
        ):
            message.t_us = self.hk.t_us
            self.answer(channel, message)
        return self


@pytest.fixture
def online(monkeypatch):
    """Runs `kincal command ...` against this flight; None: as it is on the command line."""
    flight = OnLine().also_heard()

    def link(url, channels=("KC_HK",), signer=None):
        assert url == "somewhere" and "KC_HK" in channels
        flight.signer = signer
        return flight

    monkeypatch.setattr("kincal.link.Link", link)
    flight.run = lambda *args: kincal("command", *args, "--url", "somewhere")
    return flight


@pytest.mark.parametrize(
    ("args", "opcode", "arg_i", "arg_u64"),
    [
        (("noop",), "NOOP", (0, 0), 0),
        (("abort",), "ABORT", (0, 0), 0),
        (("start",), "START", (-1, 0, 1, 0), 0),
        (
            ("start", "--poses", 20, "--seed", 7, "--coefficients", "1F", "--suspects"),
            "START", (-1, 20, 7, 1), 0x1F,
        ),
        (("start", "--coefficients", "7fffffffffffffff"), "START", (-1, 0, 1, 0), (1 << 63) - 1),
        (("start", "--acquisition", "RANDOM"), "START", (ACQUISITION["RANDOM"], 0, 1, 0), 0),
        (("rollback", f"{CRC:08x}"), "ROLLBACK", (signed(CRC), 0), 0),
        (("validate", "config", "1a2b3c4d"), "TABLE_VALIDATE", (CONFIG, 0x1A2B3C4D), 0),
        (("activate", "config", "1a2b3c4d"), "TABLE_ACTIVATE", (CONFIG, 0x1A2B3C4D), 0),
        (("discard",), "TABLE_DISCARD", (0, 0), 0),
    ],
)  # fmt: skip
def test_each_command_sends_its_arguments_once_and_is_written_down(
    online, journal, key_file, args, opcode, arg_i, arg_u64
):
    online.hk.staged_state = 3 if opcode == "TABLE_VALIDATE" else 0
    online.hk.staged_kind = CONFIG if opcode == "TABLE_VALIDATE" else 0
    run = online.run(*args, "--journal", journal, "--by", "A. Operator", "--why", "to see")
    assert run.exit_code == 0, run.output
    (sent,) = online.commands
    assert (sent.opcode, tuple(sent.arg_i[: len(arg_i)]), sent.arg_u64) == (
        names.opcode(opcode),
        arg_i,
        arg_u64,
    )
    assert bool(sent.key_id) and online.closed
    written = lines(journal, key_file)
    assert written[-1] == (opcode.lower(), opcode, "to see")
    assert len(written) == (1 if opcode == "ABORT" else 2)


@pytest.mark.parametrize("mask", ["8000000000000000", "-1", "1g"])
def test_a_mask_has_up_to_63_bits(online, mask):
    run = online.run("start", f"--coefficients={mask}")
    assert run.exit_code == 2 and "is no mask of coefficients" in run.output and not online.commands


def test_an_abort_goes_out_without_a_key_and_without_housekeeping(online, tmp_path):
    run = online.run("abort", "--keys", tmp_path / "none")
    assert run.exit_code == 0 and "no key file: ABORT is sent without a signature" in run.output
    assert "not in the journal: there is no key" in run.output
    online.quiet, online.hk.state = True, 0
    run = online.run("abort", "--timeout", 1)
    assert run.exit_code == 1 and "without a signature" not in run.output
    assert [c.opcode for c in online.commands] == [kcm.cmd_t.ABORT] * 2
    assert not online.commands[0].key_id and online.commands[1].key_id


def test_a_noop_is_not_sent_without_the_key_that_it_asks_about(online, tmp_path):
    """With keys that cannot be used it was sent without, said that there was no key file, and was done."""
    mine = tmp_path / "keys"
    keys.new(mine)
    mine.chmod(0o644)
    for more in ((), ("--dry-run",)):
        run = online.run("noop", "--keys", mine, *more)
        assert run.exit_code == 2 and "others may read or change the keys" in run.output, run.output
    assert online.commands == []
    run = online.run("abort", "--keys", mine)
    said = text_of(run)
    assert "others may read or change the keys" in said and "ABORT is sent without a signature" in said
    assert [c.key_id for c in online.commands] == [0]


def test_a_command_that_cannot_be_signed_is_not_sent(online, tmp_path):
    run = online.run("discard", "--keys", tmp_path / "none")
    assert run.exit_code == 2 and "no keys" in run.output and not online.commands, run.output


def test_what_is_done_and_what_is_not_is_the_exit_status(online):
    online.publish, taken = lambda _channel, _message: None, online.publish
    run = online.run("rollback", f"{CRC:08x}", "--timeout", 1, "--json")
    assert run.exit_code == 1 and json.loads(run.output)["outcome"] == "unknown"
    online.publish = taken
    run = online.run("rollback", f"{CRC:08x}", "--json")
    assert run.exit_code == 0 and json.loads(run.output)["outcome"] == "done"


@pytest.mark.parametrize(
    ("command", "heard", "status"), [("start", True, 0), ("start", False, 1), ("discard", False, 0)]
)
def test_a_dry_run_listens_to_what_the_conditions_are_judged_by(online, command, heard, status):
    if not heard:
        online.waiting.clear()
    online.hk.t_us = 5_000_000
    run = online.run(command, "--dry-run", "--json")
    found = json.loads(run.output)
    assert (run.exit_code, bool(found["unmet"])) == (status, status == 1), run.output
    assert (found["command"], found["housekeeping"], found["sent"]) == (
        command.upper() if command == "start" else "TABLE_DISCARD",
        "fresh",
        False,
    )
    assert online.now_s == pytest.approx(0.75 if heard else 3.0 if command == "start" else 0.25)
    assert found["housekeeping_age_s"] == 0.0 and "rollback" not in found and not online.commands


def test_a_dry_run_without_a_key_or_housekeeping_says_so(online, tmp_path):
    run = online.run("discard", "--dry-run", "--json", "--keys", tmp_path / "none")
    (found,) = json.loads(run.output)["unmet"]
    assert found["condition"] == "a key to sign with" and "no keys" in found["found"] and run.exit_code == 1
    for name in ("abort", "noop"):
        assert online.run(name, "--dry-run", "--keys", tmp_path / "none").exit_code == 0
    online.quiet = True
    found = json.loads(online.run("rollback", "--json").output)
    assert (found["housekeeping"], found["state"], "rollback" in found) == ("unknown", "", False)
    run = online.run("discard")
    assert run.exit_code == 1 and "nothing was sent: no housekeeping within 3 s" in run.output
    assert not online.commands


def test_a_rollback_without_its_correction_is_a_preview(online, tmp_path, monkeypatch):
    """Back from a correction to the nominal table, both in files."""
    now, before = kin_image([0.01]), kin_image([0.0])
    (tmp_path / "now.tbl").write_bytes(now.data)
    (tmp_path / "before.tbl").write_bytes(before.data)
    online.hk.table_crc, online.hk.kin_prev_crc = list(map(signed, in_force(now.crc))), signed(before.crc)
    places = ("--from", tmp_path / "now.tbl", "--from", tmp_path / "before.tbl")
    run = online.run("rollback", *places)
    assert run.exit_code == 0 and f"to do it: kincal command rollback {now.crc_text}" in run.output, (
        run.output
    )
    found = json.loads(online.run("rollback", "--json", *places).output)
    (row,) = found["rollback"]["changes"]["rows"]
    assert (row["old"], row["new"], found["command"]) == (0.01, 0.0, "ROLLBACK") and not online.commands
    run = online.run("rollback", "--json")
    assert isinstance(json.loads(run.output)["rollback"], str)
    monkeypatch.setattr("kincal.operate.recording.FOLDER", tmp_path)
    for k in range(6):
        (tmp_path / f"{k}.lcmlog").write_bytes(b"")
    said = online.run("rollback").output
    assert "no preview: " in said and said.count(".lcmlog") == 5  # the newest


@pytest.mark.parametrize(
    ("name", "group", "own"),
    [
        ("arm", review_cli, "arm"),
        ("go", review_cli, "go"),
        ("reject", review_cli, "reject"),
        ("dump", table_cli, "dump"),
    ],
)
def test_decisions_and_dumps_are_the_same_commands_as_in_their_own_groups(name, group, own):
    assert command_cli.commands[name] is group.commands[own]


@pytest.mark.parametrize(
    ("args", "state", "verdict", "armed_by", "status"),
    [
        (("arm",), "REVIEW", 1, 0, 0), (("arm",), "REVIEW", POOR, 0, 1),
        (("arm", "--override", "sample at risk"), "REVIEW", POOR, 0, 0), (("arm",), "IDLE", 1, 0, 1),
        (("go",), "ARMED", 1, "me", 1), (("go",), "ARMED", 1, "B", 0), (("go",), "REVIEW", 1, 0, 1),
        (("reject",), "ARMED", POOR, "me", 0), (("reject",), "IDLE", 1, 0, 1),
    ],
)  # fmt: skip
def test_a_dry_run_of_a_decision_names_what_flight_would_refuse(
    online, key_file, args, state, verdict, armed_by, status
):
    online.waits(CRC, verdict, STATE[state])
    mine = keys.signer_of(key_file).key.id
    online.hk.armed_key = {"me": mine, "B": mine + keys.HOLDER_NUMBERS}.get(armed_by, 0)
    online.hk.go_by_other_key = bool(armed_by)
    journal = review.journal.place(None, key_file)
    shown = review.journal.Entry(
        "", "", "", "", "", 1, "", {"p_fit": 0.5, "fit_pos_m": 0.0, "before_pos_m": 1.0, "noise_scale": 1.0}
    )
    review.record(journal, "seen", CRC, "A", "w", "", shown, keys.signer_of(key_file))
    run = online.run(args[0], f"{CRC:08x}", *args[1:], "--by", "A", "--why", "w", "--dry-run")
    assert run.exit_code == status and not online.commands, run.output
    assert online.now_s == 0.75  # when housekeeping was heard


@pytest.mark.parametrize(("given", "waited_s"), [((), 3.0), (("--timeout", 1), 1.0), (("--timeout", 9), 3.0)])
def test_a_dry_run_of_a_decision_does_not_wait_for_ever(online, given, waited_s):
    online.quiet = True
    run = online.run("reject", f"{CRC:08x}", "--by", "A", "--why", "w", "--dry-run", *given)
    assert run.exit_code == 1 and online.now_s == pytest.approx(waited_s)


@pytest.mark.parametrize(
    ("given", "states", "until_s", "said"),
    [
        ((), ["MOVE", "AIM", "REVIEW"], 0.75, "a correction waits for people"),
        ((), ["MOVE", "SAFE"], 0.5, "the calibration has ended"),
        (("--seconds", 1), ["MOVE"], 1.0, "nothing has ended"),
        (("--seconds", 0.25), ["REVIEW"], 0.25, "a correction waits for people"),
        (("--forever", "--seconds", 2), ["MOVE", "SAFE"], 2.0, "the calibration has ended"),
    ],
)
def test_a_calibration_is_watched_until_people_have_to_act(online, given, states, until_s, said):
    online.waiting.clear()
    real = online.next

    def changing(timeout_s):
        online.hk.state = STATE[states.pop(0) if len(states) > 1 else states[0]]
        return real(timeout_s)

    online.next = changing
    run = kincal("review", "watch", "--live", "--url", "somewhere", *given)
    assert run.exit_code == 0 and run.output.splitlines()[-1] == said, run.output
    assert online.now_s == until_s


def test_what_waits_is_shown_from_its_recording_to_who_is_named(online, journal, key_file, tmp_path):
    show = ("review", "show", "--live", "--url", "somewhere", "--journal", journal, "--recordings", tmp_path)
    run = kincal(*show)
    assert run.exit_code == 1 and "no correction waits on board" in run.output
    online.waits(CRC)
    write_log(tmp_path / "a.lcmlog", waiting=proposal())
    run = good(*show, "--json", "--by", "A. Reviewer")
    assert lines(journal, key_file)[0][:2] == ("seen", "") and not online.commands
    assert json.JSONDecoder().raw_decode(run.output[run.output.index("{") :])[0]["crc"] == f"{CRC:08x}"


@pytest.mark.parametrize("as_json", [(), ("--json",)])
def test_what_waits_and_was_not_recorded_is_asked_of_flight(online, journal, tmp_path, as_json, monkeypatch):
    monkeypatch.setenv("USER", "somebody")
    image = kin_image([0.01])
    online.waits(image.crc)
    online.hk.table_crc = list(map(signed, in_force(1)))
    online.holds = {library("flight").constant("KC_STORE_PROPOSAL"): image.data}
    show = ("review", "show", "--live", "--url", "somewhere", "--journal", journal, "--recordings", tmp_path)
    run = kincal(*show, *as_json)
    assert (
        run.exit_code == 1 and f"the proposal of correction {image.crc_text} was not recorded" in run.output
    )
    assert ('"recorded": false' in run.output) == bool(as_json)
    entries = review.check_journal(journal)
    assert {e.by for e in entries} == {"somebody"} and entries[1].decision == "table_dump"
    kincal(*show, "--by", "A. Reviewer")
    assert review.check_journal(journal)[-1].by == "A. Reviewer"


# ---------------------------------------------------------------------------- what is written of a command


def test_what_flight_took_without_its_effect_is_written_as_taken_with_what_is_missing(
    flight, journal, key_file
):
    flight.publish = lambda channel, message: DirectFlight.publish(flight, channel, message)
    done, _, _ = act(flight, operate.rollback(CRC), journal, 1.0)
    assert done.outcome == operate.ACCEPTED
    assert lines(journal, key_file)[-1] == ("rollback", "ROLLBACK", done.last_line)


@pytest.mark.parametrize(
    ("error", "why"), [(KeyboardInterrupt(), "interrupted"), (CommandFailed("cut", "url", "wait"), "cut")]
)
def test_a_program_that_ends_while_it_waits_leaves_a_trace(flight, journal, key_file, error, why):

    def fails(_timeout_s):
        if flight.commands:
            raise error
        return type(flight).next(flight, 0.2)

    flight.next = fails
    with pytest.raises(type(error)):
        act(flight, operate.start(), journal)
    assert lines(journal, key_file)[-1] == ("unanswered", "START", why)


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (KeyboardInterrupt(), ("unanswered", "TABLE_ACTIVATE", "interrupted")),
        (NoAnswer("silent", "url", "wait"), ("unanswered", "TABLE_ACTIVATE", "silent")),
        (CommandFailed("no", "url", "wait"), ("refused", "TABLE_ACTIVATE", "no")),
    ],
)
def test_an_uplink_that_ends_early_is_written_as_what_is_known(journal, key_file, error, line):
    flight, who = Lander(keys.signer_of(key_file)), Operator("A", "new plan", journal, 2.0)
    flight.publish = lambda *_: (_ for _ in ()).throw(error)
    image, _ = decode_as("config", (BIN / "config.tbl").read_bytes(), "")
    with pytest.raises(type(error)):
        operate.uplink(flight, image, who, 5.0)
    assert lines(journal, key_file)[-1] == line


def test_a_read_back_of_the_proposal_names_what_waits(journal, key_file):
    flight, who = Lander(keys.signer_of(key_file)).waits(CRC), Operator("A", "to see", journal, 2.0)
    image = kin_image([0.01])
    flight.holds = {library("flight").constant("KC_STORE_PROPOSAL"): image.data}
    assert operate.read_back(flight, "proposal", who, 5.0).data == image.data
    entry = review.check_journal(journal)[-1]
    assert (entry.decision, entry.crc, entry.kind) == ("table_dump", f"{CRC:08x}", "proposed KIN")


@pytest.mark.parametrize(("quiet", "sent_s"), [(False, 0.75), (True, 1.2)])
def test_other_flights_are_listened_for_before_anything_is_sent(journal, key_file, quiet, sent_s):
    flight, at = OnLine(keys.signer_of(key_file)), []
    flight.quiet = quiet
    flight.publish = lambda *_: at.append(flight.now_s)
    who = Operator("A", "x", journal, 1.0)
    operate.act(flight, operate.start(), who, operate.Snapshot(), lambda _step: None)
    assert at == [pytest.approx(sent_s)]


@pytest.mark.parametrize(
    ("refused", "silent", "error", "taken"),
    [(True, False, CommandFailed, 0), (False, True, NoAnswer, 0), (False, False, None, 1)],
)
def test_a_decision_is_sent_with_its_verifiers(key_file, refused, silent, error, taken):
    flight, steps, took = Lander(keys.signer_of(key_file)).waits(CRC), [], []
    if refused:
        flight.refuse[kcm.cmd_t.REJECT] = (-8, EVENT["CMD_STATE"])
    if silent:
        flight.publish = lambda *_: None
    send = operate.verified(operate.Snapshot(), lambda step: steps.append(step.stage))
    given = (flight, "REJECT", (CRC,), 2.0, lambda: took.append(len(steps)))
    if error is None:
        send(*given)
        assert steps == ["sent", "received", "accepted", "done"] and took == [3]
    else:
        with pytest.raises(CommandFailed) as caught:
            send(*given)
        assert type(caught.value) is error and "REJECT fedcba98" in caught.value.what
    assert len(took) == taken


def test_a_question_about_a_correction_stands_in_the_journal(journal, key_file):
    signer = keys.signer_of(key_file)
    operate.comment("run.lcmlog", "question", CRC, Operator("B", "why now?", journal), signer)
    (entry,) = review.check_journal(journal)
    assert (entry.decision, entry.crc, entry.by, entry.url) == ("question", f"{CRC:08x}", "B", "run.lcmlog")
    with pytest.raises(BadInput, match="needs a name and a reason"):
        operate.comment("run.lcmlog", "question", CRC, Operator("B", " ", journal), signer)


# ---------------------------------------------------------------------------- coefficients of joints


def test_the_coefficients_of_joints_are_the_enabled_ones(tmp_path):
    image, table = decode_as("terms", (BIN / "terms.tbl").read_bytes(), "")
    kinds = ("phi_rad", "alpha_rad", "a_m", "d_m")
    named = tuple(f"J{j}.{kind}" for j in (2, 4) for kind in kinds)
    assert operate.of_joints((4, 2, 4), BIN / "terms.tbl") == (0xF0F0, image.crc_text, named)
    table.coef[5].enabled = 0
    made = encode("terms", table)
    file = tmp_path / "terms.tbl"
    file.write_bytes(made.data)
    assert operate.of_joints([2], file) == (0xD0, made.crc_text, (named[0], *named[2:4]))
    for i in range(4):
        table.coef[i].enabled = 0
    file.write_bytes(encode("terms", table).data)
    with pytest.raises(BadInput, match="no enabled coefficient of joint 1"):
        operate.of_joints([1, 2], file)


# ---------------------------------------------------------------------------- counters


def test_listening_ends_with_its_time_or_as_soon_as_it_is_enough():
    flight, asked = DirectFlight(), []

    def silent(timeout_s):
        asked.append(timeout_s)
        flight.now_s += timeout_s

    talks, flight.next = flight.next, silent
    operate.listen(flight, operate.Snapshot(), 0.5, lambda _s: False)
    assert asked == [0.2, 0.2, pytest.approx(0.1)]
    operate.listen(flight, operate.Snapshot(), 0.0, lambda _s: False)
    assert len(asked) == 3
    flight.next, snapshot = talks, operate.Snapshot()
    operate.listen(flight, snapshot, 60.0, lambda s: s.heartbeats == 2)
    assert snapshot.heartbeats == 2 and snapshot.last("KC_HK").rx_s == flight.now_s


class Counting(DirectFlight):
    """Refuses a counter that is not above the highest, and says which that is. others: events of commands
    that somebody else has sent before."""

    highest, status, others = 0, -8, ()

    def publish(self, channel, message):
        for got, want in self.others:
            self.replayed(got, want)
        if message.counter <= self.highest:
            self.refuse[message.opcode] = (self.status, EVENT["CMD_REPLAYED"])
        super().publish(channel, message)
        if message.counter <= self.highest:
            self.replayed(message.counter, self.highest)

    def replayed(self, got, want):
        said = event(1, 1, EVENT["CMD_REPLAYED"], 2, float(got))
        said.want = float(want)
        self.answer("KC_EVENT", said)


@pytest.mark.parametrize(
    ("highest", "others", "counter"),
    [(0, (), 0), (1, (), 0), (2, (), 2), (41, (), 41), (41, [(7, 99)], 41), (0, [(7, 99)], 0)],
)
def test_the_highest_counter_of_a_key_is_asked_of_flight(key_file, highest, others, counter):
    signer = keys.signer_of(key_file)
    flight = Counting(signer)
    flight.highest, flight.others, flight.hk.t_us = highest, others, 7_000_000
    assert operate.accepted_counter(flight) == counter
    (sent,) = flight.commands
    assert (sent.opcode, sent.counter, sent.t_us) == (kcm.cmd_t.NOOP, 1, 7_000_000)
    assert flight.signer is signer


def test_a_counter_is_not_guessed(key_file):
    flight = Counting(keys.signer_of(key_file))
    flight.refuse = {kcm.cmd_t.NOOP: (-8, EVENT["CMD_STATE"])}
    with pytest.raises(NoAnswer, match="the counter of this key did not come within 5 s"):
        operate.accepted_counter(flight)
    with pytest.raises(BadInput, match="a key is needed"):
        operate.accepted_counter(DirectFlight())


def test_what_comes_while_a_command_is_followed_is_known_afterwards(journal, key_file):
    flight, snapshot = Lander(keys.signer_of(key_file)), operate.Snapshot()
    who = Operator("A", "x", journal, 5.0)
    operate.act(flight, operate.start(), who, snapshot, lambda _step: None)
    assert snapshot.events(1)[0].name == "CAL_START"
    operate.act(flight, operate.abort(), who, snapshot, lambda _step: None)
    assert snapshot.state == "SAFE"


def test_another_flight_that_is_heard_while_a_command_is_followed_leaves_it_open(flight):
    """What housekeeping shows may be the other one's."""
    flight.ignores.add(kcm.cmd_t.TABLE_DISCARD)
    real, flight.hk.staged_kind = flight.next, 4

    def interleaved(timeout_s):
        if not flight.waiting:
            flight.hk.boot_count ^= 1
        return real(timeout_s)

    flight.next = interleaved
    done = operate.send(flight, operate.discard(), operate.Snapshot(), 60.0)
    assert done.outcome == operate.ACCEPTED and "two senders of housekeeping" in done.last_line
    assert flight.now_s < 5.0


# ---------------------------------------------------------------------------- following


def test_following_ends_where_its_caller_stops_and_yields_what_came():
    flight = Lander()
    flight.hk.state = STATE["MOVE"]
    p = kcm.progress_t()
    p.pose, p.n_goal = 1, 20
    flight.answer("KC_PROGRESS", p)
    found = []
    for line in operate.follow(flight, operate.Snapshot(), lambda f: bool(f.ended)):
        found.append(line)
        if line.text.startswith("state MOVE"):
            flight.hk.state = STATE["SAFE"]
    assert [(line.n_goal, line.first) for line in found] == [(20, True), (0, False), (0, False)]
    assert found[-1].text.startswith("state SAFE")
    assert list(operate.follow(flight, operate.Snapshot(), lambda _f: True)) == []


@pytest.mark.parametrize(
    ("states", "ended", "n_lines"),
    [
        (["IDLE", "MOVE", "IDLE"], "the calibration has ended", [2, 1, 1]),
        (["MOVE", "SAFE"], "the calibration has ended", [1, 1]),
        (["SAFE", "STORE", "SAFE"], "", [2, 1, 1]),
        (["MOVE", "AIM", "ARMED"], "a correction waits for people", [1, 0, 1]),
        (["REVIEW", "IDLE"], "a correction waits for people", [1, 1]),
    ],
)
def test_what_ends_a_calibration_that_is_followed(states, ended, n_lines):
    w = operate.Follower(operate.Snapshot())
    said = [w.take("KC_HK", heartbeat(s, t_us=10**6 * (k + 1)), 1.0 + k, 0.0) for k, s in enumerate(states)]
    assert (w.ended, [len(lines) for lines in said]) == (ended, n_lines)


# ---------------------------------------------------------------------------- nothing commands the terminal

HOSTILE = "\x1b[2J\x1b]0;title\x07\x9b31m\u202eevil\r\b\x7f[red]no[/]"


def test_control_characters_are_shown_not_obeyed():
    assert terminal.printable(HOSTILE) == (
        "\\x1b[2J\\x1b]0;title\\x07\\x9b31m\\x202eevil\\x0d\\x08\\x7f[red]no[/]"
    )
    assert terminal.printable("plain\ttext\nü ± →") == "plain\ttext\nü ± →"
    for colours in (True, False):
        out = terminal.console()
        out.file, out._force_terminal = io.StringIO(), colours
        out.print(f"[bold]{escape(HOSTILE)}[/]", soft_wrap=True)
        from kincal.cli.text.layout import grid

        rows = grid(escape(HOSTILE), "name")
        rows.add_row(escape(HOSTILE))
        out.print(rows)
        text = re.sub(r"\x1b\[[0-9;]*m", "", out.file.getvalue())  # rich's own colours
        assert "evil" in text and not re.search(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202e]", text)
    assert isinstance(out, Console)


@pytest.mark.parametrize("where", ["by", "why"])
def test_names_in_the_journal_and_errors_do_not_reach_the_terminal_raw(journal, where):
    given = {"by": "me", "why": "x"} | {where: f"name {HOSTILE}"}
    run = kincal("review", "comment", given["why"], "--by", given["by"], "--journal", journal)
    shown = run.output + kincal("audit", "log", "--journal", journal).output
    shown += kincal("review", "list", "--journal", journal).output
    shown += kincal("status", "--url", f"bad{HOSTILE}", "--seconds", 0).output
    assert "evil" in shown and not re.search(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202e]", shown)
