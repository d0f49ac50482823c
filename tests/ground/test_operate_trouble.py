"""What an operator does while something else is wrong: a full medium, a file that hangs, two programs at
once, two flights on one network, clocks that jump."""

import fcntl
import resource
import shutil
import threading

import pytest
from commands import shell, text_of
from direct_flight import STATE, DirectFlight, Lander, act
from fake_flight import FakeFlight
from medium import full_medium
from samples import CRC, proposal, signed, write_log

import kcm
from kincal.api import operate
from kincal.review import from_message, journal, kin_crc, record
from kincal.review.decisions import Operator, arm, go, reject, see
from kincal.run.inprocess import simulate
from kincal_shared import keys
from kincal_shared.errors import BadInput, CommandFailed

NAMES = [f"c{i}" for i in range(54)]


@pytest.fixture
def file(tmp_path):
    return tmp_path / "journal.jsonl"


def note(file, signer, text="a comment"):
    return record(file, journal.COMMENT, 0, "B. Second", text, "", None, signer)


# ---- ABORT


@pytest.mark.parametrize("trouble", ["no counter", "a folder", "a link", "locked", "full medium"])
def test_an_abort_goes_out_whatever_is_wrong_with_the_counter(own_key_file, file, trouble):
    """It was lost: the counter has to be kept before a command can be signed."""
    counter = keys.count_file(own_key_file, 2)
    flight, held = Lander(keys.signer_of(own_key_file)), None
    if trouble == "no counter":
        counter.write_text("many\n")
    elif trouble == "a folder":
        counter.mkdir()
    elif trouble == "a link":
        counter.symlink_to("/dev/null")
    elif trouble == "locked":
        held = counter.open("w+")
        fcntl.flock(held, fcntl.LOCK_EX)
    with full_medium(0 if trouble == "full medium" else resource.RLIM_INFINITY):
        done, _, said = act(flight, operate.abort(), file)
    if held:
        held.close()
    assert done.outcome == operate.DONE
    assert [(c.opcode, c.key_id) for c in flight.commands] == [(kcm.cmd_t.ABORT, 0)]
    assert trouble != "full medium" or "not in the journal" in said[-1]


def test_any_other_command_is_not_sent_if_it_cannot_be_counted(own_key_file, file):
    keys.count_file(own_key_file, 2).write_text("many\n")
    flight = Lander(keys.signer_of(own_key_file))
    with pytest.raises(BadInput, match="no counter"):
        act(flight, operate.start(), file)
    assert not flight.commands


def test_a_counter_on_a_full_medium_is_an_error_for_people_and_stays(own_key_file):
    signer = keys.signer_of(own_key_file)
    before = signer.count(2)
    with full_medium(0), pytest.raises(BadInput, match="the counter cannot be kept"):
        signer.count(2)
    assert signer.count(2) == before + 1


# ---- the journal


@pytest.mark.parametrize("room", [0, 20, "the line fits, its mark does not"])
def test_a_full_medium_leaves_journal_and_mark_as_they_were(own_key_file, file, room, monkeypatch):
    """A line without its mark made the next one look like one that somebody had appended."""
    signer = keys.signer_of(own_key_file)
    note(file, signer)
    before = file.read_bytes(), journal.end_file(file).read_bytes()
    for _ in range(3):
        with pytest.raises(BadInput, match="the review journal cannot be kept"):
            if isinstance(room, int):
                with full_medium(len(before[0]) + room):
                    note(file, signer)
            else:
                with monkeypatch.context() as m:
                    m.setattr(journal.os, "open", _no_room(journal.os.open, ".part"))
                    note(file, signer)
        assert (file.read_bytes(), journal.end_file(file).read_bytes()) == before
    note(file, signer)
    assert len(journal.read(file, signer.known).entries) == 2


def _no_room(opening, suffix):
    def opened(path, *rest):
        if str(path).endswith(suffix):
            raise OSError(28, "No space left on device")
        return opening(path, *rest)

    return opened


@pytest.mark.parametrize("place", ["a file/journal", "n" * 300])
def test_a_journal_that_cannot_be_made_is_an_error_for_people(own_key_file, tmp_path, place):
    (tmp_path / "a file").write_text("")
    with pytest.raises(BadInput, match="the review journal cannot be kept"):
        note(tmp_path / place, keys.signer_of(own_key_file))


def test_a_reader_never_sees_a_writer_half_done(own_key_file, file, monkeypatch):
    """A line that was added between the reading of journal and mark made the journal look cut: a decision was
    refused, an audit raised alarm."""
    signer, parse = keys.signer_of(own_key_file), journal._parsed
    note(file, signer)
    writer = threading.Thread(target=lambda: note(file, signer))

    def slowly(*args):
        if threading.current_thread() is not writer and not writer.ident:
            writer.start()
            writer.join(0.3)
        return parse(*args)

    monkeypatch.setattr(journal, "_parsed", slowly)
    assert len(journal.read(file, signer.known).entries) == 1
    writer.join()
    assert len(journal.read(file, signer.known).entries) == 2


@pytest.mark.parametrize("using", ["read", "append"])
def test_a_journal_that_another_program_holds_is_said_not_waited_for(own_key_file, file, using, monkeypatch):
    signer = keys.signer_of(own_key_file)
    note(file, signer)
    monkeypatch.setattr(journal, "LOCK_WAIT_S", 0.1)
    with file.open("r+") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        with pytest.raises(BadInput, match="another program has held this file"):
            if using == "read":
                journal.read(file, signer.known)
            else:
                note(file, signer)
    assert len(journal.read(file, signer.known).entries) == 1


@pytest.mark.parametrize("name", ["start", "arm", "go", "reject"])
def test_a_command_that_flight_took_is_said_also_if_the_journal_is_full_by_then(own_key_file, file, name):
    """The error of the journal stood alone, as if nothing had been sent."""
    signer = keys.signer_of(own_key_file)
    flight = Lander(signer).waits(CRC) if name != "start" else Lander(signer)
    who = Operator("A. Operator", "because", file, 5.0)
    see(file, from_message(proposal(), NAMES), who.by, file, signer)
    if name == "go":
        arm(flight, f"{CRC:08x}", who)
    aside = file.with_suffix(".aside")

    def remove(_opcode):
        shutil.move(file, aside)
        file.mkdir()

    flight.then = remove
    with pytest.raises(CommandFailed) as caught:
        if name == "start":
            act(flight, operate.start(), file)
        else:
            {"arm": arm, "go": go, "reject": reject}[name](flight, f"{CRC:08x}", who)
    assert "the journal has only the attempt" in caught.value.what
    assert caught.value.what.startswith("START done" if name == "start" else "flight took ")
    assert "do not send it again" in caught.value.todo
    state = {"start": "MOVE", "arm": "ARMED", "go": "IDLE", "reject": "IDLE"}[name]
    assert flight.hk.state == STATE[state]


def test_what_became_of_a_decision_is_written_also_if_somebody_else_wrote_meanwhile(own_key_file, file):
    """A comment of another console between attempt and outcome counted as the outcome."""
    signer = keys.signer_of(own_key_file)
    flight = Lander(signer).waits(CRC)
    who = Operator("A. Operator", "because", file, 5.0)
    see(file, from_message(proposal(), NAMES), who.by, file, signer)
    flight.refuse[kcm.cmd_t.APPROVE_ARM] = (-8, 13)
    flight.then = lambda _opcode: note(file, keys.signer_of(own_key_file))
    with pytest.raises(CommandFailed):
        arm(flight, f"{CRC:08x}", who)
    found = [(e.decision, e.command) for e in journal.read(file, signer.known).entries]
    assert found[1:] == [("attempt", "APPROVE_ARM"), ("comment", ""), ("refused", "APPROVE_ARM")]


# ---- two at once


def test_two_programs_that_begin_at_the_same_moment_do_not_share_answers(own_key_file, monkeypatch):
    """Their numbers came from the clock, to a quarter of a second: who was refused took the other's answer
    for its own, and the journal had two approvals."""
    monkeypatch.setattr("kincal.link.connection.time.time", lambda: 1_795_000_000.0)
    first, second = (DirectFlight(keys.signer_of(own_key_file)) for _ in range(2))
    assert first.send("APPROVE_GO", (CRC,)) != second.send("APPROVE_GO", (CRC,))
    alone = DirectFlight(), DirectFlight()
    assert len({link.send("NOOP") for link in alone}) == 1  # flight wants these to grow from start to start


def housekeeping(t_s, boot_count=3, state="IDLE"):
    m = kcm.hk_t()
    m.t_us, m.boot_count, m.state = int(t_s * 1e6), boot_count, STATE[state]
    return m


def heard(*senders, seconds=6.0):
    """A snapshot that has heard each of these once a second, one after the other; and when."""
    snapshot, now_s = operate.Snapshot(), 0.0
    while now_s < seconds:
        for first_s, boot_count, state in senders:
            snapshot.take("KC_HK", housekeeping(first_s + now_s, boot_count, state), now_s, now_s)
            now_s += 1.0 / len(senders)
    return snapshot, now_s


@pytest.mark.parametrize("replayed", [(10.0, 3, "REVIEW"), (10.0, 2, "REVIEW"), (5000.0, 9, "REVIEW")])
def test_two_flights_or_a_recording_on_the_live_network_are_never_fresh(replayed):
    """State, correction and age went to and fro, each called fresh."""
    snapshot, now_s = heard((1000.0, 3, "IDLE"), replayed)
    age = snapshot.freshness("KC_HK", now_s)
    assert age.status == operate.STALE and "two senders of housekeeping" in age.why
    assert "not known: two senders" in snapshot.status(now_s, now_s).waits_for
    assert operate.unmet(operate.start(), snapshot, now_s)[0].found == age.why
    assert operate.unmet(operate.abort(), snapshot, now_s) == ()
    with pytest.raises(CommandFailed, match="was not sent: two senders"):
        operate.refuse_several("START", snapshot.several(now_s), "url")
    alone = now_s
    while alone < now_s + 15.0:
        alone += 1.0
        snapshot.take("KC_HK", housekeeping(1000.0 + alone), alone, alone)
    assert snapshot.freshness("KC_HK", alone).status == operate.FRESH


class Interleaved(DirectFlight):
    """Two flights on one machine: one clock, the same number of starts; housekeeping of each in turn."""

    def __init__(self, signer, numbers=(500, 20)):
        super().__init__(signer)
        self.seqs, self.turn = list(numbers), 0

    def next(self, timeout_s):
        if not self.waiting:
            self.turn ^= 1
            self.seqs[self.turn] += 1
            self.hk.t_us, self.hk.seq = self.hk.t_us + 500_000, self.seqs[self.turn]
        return super().next(timeout_s)


@pytest.mark.parametrize("numbers", [(500, 20), (20, 20)])
def test_two_flights_with_one_clock_differ_in_the_numbers_of_their_messages(tmp_path, own_key_file, numbers):
    """START went to both, and both moved the arm."""
    flight = Interleaved(keys.signer_of(own_key_file), numbers)
    who = Operator("A", "why", tmp_path / "journal.jsonl")
    with pytest.raises(CommandFailed, match="START was not sent: two senders"):
        operate.act(flight, operate.start(), who, operate.Snapshot(), lambda _step: None)
    send = operate.verified(operate.Snapshot(), lambda _step: None)
    with pytest.raises(CommandFailed, match="APPROVE_ARM was not sent: two senders"):
        send(flight, "APPROVE_ARM", (1,), 5.0, lambda: None)
    assert flight.commands == []
    alone = DirectFlight(keys.signer_of(own_key_file))
    assert (
        operate.act(alone, operate.noop(), who, operate.Snapshot(), lambda _step: None).outcome
        == operate.DONE
    )


def test_one_flight_that_starts_again_and_loses_its_clock_is_one():
    snapshot, now_s = heard((1000.0, 3, "IDLE"))
    for boot_count, t_s in ((4, 2000.0), (5, 10.0), (5, 11.0), (5, 12.0)):
        now_s += 1.0
        snapshot.take("KC_HK", housekeeping(t_s, boot_count), now_s, now_s)
        assert snapshot.freshness("KC_HK", now_s).status == operate.FRESH


# ---- arguments


@pytest.mark.parametrize("number", [2**32, 2**32 + 1, -(2**31) - 1, 2**70])
def test_a_link_refuses_what_an_argument_does_not_hold(own_key_file, number):
    link = DirectFlight(keys.signer_of(own_key_file))
    with pytest.raises(BadInput, match="START does not carry"):
        link.send("START", (-1, number, 1))
    assert not link.commands
    link.send("APPROVE_ARM", (0xFFFFFFFF,))
    assert link.commands[0].arg_i[0] == -1


# ---- a journal that is gone


def test_a_journal_that_is_gone_but_for_its_mark_is_not_an_empty_one(own_key_file, file):
    signer = keys.signer_of(own_key_file)
    note(file, signer)
    note(file, signer)
    file.unlink()
    with pytest.raises(BadInput, match="lines 1 to 2 were removed"):
        journal.read(file, signer.known)
    with pytest.raises(BadInput, match="lines 1 to 2 were removed"):
        note(file, signer)


# ---- the command line


def kincal(*args, **env):
    return shell(*args, env=env)


@pytest.mark.parametrize("named", ["~nobody-of-that-name/keys", "/", "."])
def test_a_key_file_that_can_be_none_is_an_error_for_people(named):
    for args in (("audit", "verify"), ("review", "comment", "x", "--by", "b")):
        run = kincal(*args, KINCAL_KEYS=named)
        assert run.exit_code == 2 and "Error: no keys: " in run.output, run.output


@pytest.mark.parametrize("to", ["a" * 70 + ".example:1", "..:1", f"{'x.' * 300}:1"])
def test_a_host_that_is_no_name_is_an_error_for_people(to):
    run = kincal("bridge", "ccsds", "--to", to, "--seconds", "0.1")
    assert run.exit_code == 2 and "Error: host " in run.output, run.output


@pytest.mark.parametrize("megabytes", ["inf", "nan", "1e300"])
def test_a_recording_needs_a_size_that_is_one(tmp_path, megabytes):
    run = kincal("record", "--folder", tmp_path, "--seconds", "0.1", "--megabytes", megabytes)
    assert run.exit_code == 2 and "Traceback" not in run.output, run.output


def test_a_dry_run_names_a_missing_key_too(tmp_path):
    """It said that nothing speaks against a command that could not be sent."""
    with FakeFlight() as flight:
        at = ("--url", flight.url, "--keys", tmp_path / "none")
        run = kincal("command", "discard", "--dry-run", *at)
        assert run.exit_code == 1 and "not met: a key to sign with; found: no keys" in run.output, run.output
        tried = kincal("command", "noop", "--dry-run", *at)
        assert tried.exit_code == 0 and "it would be sent without a signature" in tried.output
        sent = kincal("command", "noop", *at)  # the dry run said so, and it was refused
        assert sent.exit_code == 0 and "NOOP is sent without a signature" in sent.output, sent.output
        assert flight.unsigned == [kcm.cmd_t.NOOP]
    assert list(tmp_path.iterdir()) == []


# ---- telemetry that somebody else sends


@pytest.mark.parametrize(
    "change",
    [
        lambda p: p.value.__setitem__(6, p.value[6] + 1e-12), lambda p: p.sigma.__setitem__(0, 0.5),
        lambda p: setattr(p, "session", 4), lambda p: setattr(p, "n_poses", 21),
        lambda p: setattr(p, "n_coef", 53), lambda p: setattr(p, "crc_kin_before", 0x4321),
        lambda p: setattr(p, "crc_terms", 1), lambda p: setattr(p, "t_us", p.t_us + 1),
        lambda p: setattr(p, "crc", signed(CRC ^ 1)),
    ],
)  # fmt: skip
def test_another_proposal_under_the_crc_that_waits_is_not_shown(change):
    """It was shown, noted as seen and approved by: what came in force then, nobody had seen."""
    p = proposal()
    assert from_message(p, NAMES).crc == CRC
    change(p)
    with pytest.raises(BadInput, match="not the values of the correction that it names"):
        from_message(p, NAMES)


def test_the_command_line_does_not_review_a_forged_proposal(tmp_path):
    forged = proposal()
    forged.value = [0.0] * 64
    log = tmp_path / "run.lcmlog"
    write_log(log, waiting=forged)
    run = kincal("review", "show", log, "--by", "A", "--journal", tmp_path / "j")
    assert run.exit_code == 2 and "do not decide by this message" in text_of(run), run.output
    assert not (tmp_path / "j").exists()


def test_a_calibration_describes_the_table_that_it_proposes():
    run = simulate("healthy", seed=1)
    p = run.log.last_session.proposal
    assert kin_crc(p) == p.crc & 0xFFFFFFFF != 0


# ---- words


def test_a_journal_that_holds_such_words_is_listed_all_the_same(own_key_file, file, monkeypatch, capfd):
    monkeypatch.setattr("kincal.review.check_words", lambda _by, _why: None)
    hostile = "A\ud800\u061c"
    record(file, journal.COMMENT, 0, hostile, hostile, "", None, keys.signer_of(own_key_file))
    run = kincal("audit", "log", "--journal", file, "--keys", own_key_file)
    run.output.encode()
    assert run.exit_code == 0 and "A\\xd800\\x61c" in run.output
    assert "Traceback" not in capfd.readouterr().err
