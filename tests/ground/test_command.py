"""`kincal command`, `status`, `review comment` and what they write down: against a link in the same thread,
and over LCM against a few lines of flight."""

import io
import json
import re
import time

import pytest
from commands import shell as kincal
from direct_flight import DirectFlight
from fake_flight import FakeFlight
from rich.console import Console
from rich.markup import escape
from samples import CRC, decided, event, proposal, signed

import kcm
from kincal import review
from kincal.api import operate
from kincal.cli import terminal
from kincal.cli.text import operate as text
from kincal.flight import library
from kincal.operate import recording
from kincal.review.decisions import Operator
from kincal_shared import installation, keys
from kincal_shared.errors import BadInput

STATE = library("flight").enum("kc_state_t", "KC_ST_")
TABLES = installation.root() / "tables" / "bin"
EVENT = library("flight").enum("kc_event_id_t", "KC_EVT_")


@pytest.fixture
def journal(tmp_path):
    return tmp_path / "journal.jsonl"


class Lander(DirectFlight):
    """Starts, aborts and rolls back."""

    def __init__(self, signer=None, kin=CRC):
        super().__init__(signer)
        self.hk.boot_count, self.hk.table_crc = 3, [0, 1, 1, 1, signed(kin), 1, 1, 1]
        self.hk.kin_prev_crc = 7

    def publish(self, channel, message):
        super().publish(channel, message)
        opcode = message.opcode
        if opcode in self.ignores or opcode in self.refuse:
            return
        if opcode == kcm.cmd_t.START:
            self.hk.state = STATE["MOVE"]
            self.answer("KC_EVENT", event(self.hk.t_us, 1, EVENT["CAL_START"], 1, 20.0, 4))
        elif opcode == kcm.cmd_t.ABORT:
            self.hk.state = STATE["SAFE"]
        elif opcode == kcm.cmd_t.ROLLBACK:
            self.hk.table_crc[4] = 7


def act(flight, request, journal, timeout_s=5.0):
    """Steps and outcome of a command; the snapshot has heard flight before."""
    said, steps, snapshot = [], [], operate.Snapshot()
    operate.listen(flight, snapshot, 2.0, lambda s: s.hk is not None)
    who = Operator("A. Operator", "because", journal, timeout_s, said.append)
    done = operate.act(flight, request, who, snapshot, steps.append)
    return done, [s.stage for s in steps], said


def lines(journal, key_file):
    return [(e.decision, e.command, e.why) for e in review.check_journal(journal, keys.read(key_file))]


# ---------------------------------------------------------------------------- written down


def test_a_command_is_written_down_before_it_is_sent_and_after(journal, key_file):
    done, steps, _ = act(Lander(keys.signer_of(key_file)), operate.start(), journal)
    assert done.outcome == operate.DONE and steps == ["sent", "received", "accepted", "done"]
    assert lines(journal, key_file) == [
        ("attempt", "START", "because"),
        ("start", "START", "because"),
    ]
    entry = review.check_journal(journal)[-1]
    assert (entry.by, entry.counter > 0) == ("A. Operator", True)


def test_a_refusal_and_silence_are_written_down_as_what_they_are(journal, key_file):
    flight = Lander(keys.signer_of(key_file))
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


def test_nothing_is_sent_twice_whatever_comes_back(journal, key_file):
    flight = Lander(keys.signer_of(key_file))
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


def test_a_restart_before_the_answer_ends_it_and_says_so(journal, key_file):
    flight = Lander(keys.signer_of(key_file))

    def publish(_channel, _message):
        flight.hk.boot_count += 1

    flight.publish = publish
    done, _, _ = act(flight, operate.start(), journal)
    assert done.outcome == operate.UNCERTAIN and "start 3 -> 4" in done.last_line


def test_an_unsound_journal_stops_a_command_but_not_an_abort(journal, key_file):
    flight = Lander(keys.signer_of(key_file))
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


def test_a_command_is_stamped_by_housekeeping_not_by_the_arm(journal, key_file):
    flight = Lander(keys.signer_of(key_file))
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
        assert "flight would refuse ROLLBACK; nothing was sent" in " ".join(run.output.split())
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
        run = kincal("command", "noop", *given)
        assert run.exit_code == 0, run.output
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


def test_without_housekeeping_nothing_is_sent():
    with FakeFlight() as flight:
        flight._hk = lambda: None
        run = kincal("command", "start", "--url", flight.url)
        assert run.exit_code == 1 and "nothing was sent: no housekeeping within 3 s" in run.output
        assert flight.commands == []


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
        flight.images[3] = (TABLES / "terms.tbl").read_bytes()
        common = ("--journal", journal, "--url", flight.url, "--timeout", 1)
        run = kincal("command", "start", "--joints", "2,4", "--dry-run", *common)
        assert "coefficients f0f0: J2.phi_rad, J2.alpha_rad, J2.a_m, J2.d_m, J4.phi_rad" in run.output
        kincal("command", "start", "--joints", "4", *common)
        assert flight.masks == [0xF000]
        flight.images[3] = (TABLES / "kin.tbl").read_bytes()  # another CRC
        run = kincal("command", "start", "--joints", "4", *common)
        assert run.exit_code == 2 and "are in force, these are" in run.output and flight.masks == [0xF000]


def test_status_is_one_screen_and_plain_data():
    with FakeFlight(CRC) as flight:
        run = kincal("status", "--seconds", 0.5, "--url", flight.url)
        assert run.exit_code == 0, run.output
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
        said = " ".join(run.output.split())
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
    assert kincal("review", "comment", "pose 7 was in shadow", "--crc", "fedcba98", *given).exit_code == 0
    assert kincal("review", "comment", "why now?", "--question", *given).exit_code == 0
    assert lines(journal, key_file) == [("comment", "", "pose 7 was in shadow"), ("question", "", "why now?")]
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
