"""What an operator does while something else is wrong: a full medium, a file that hangs, two programs at
once, two flights on one network, clocks that jump."""

import fcntl
import resource
import shutil
import signal
import threading
from contextlib import contextmanager

import pytest
from direct_flight import DirectFlight
from samples import CRC, event, proposal

import kcm
from kincal.api import operate
from kincal.flight import library
from kincal.review import from_message, journal, record
from kincal.review.decisions import Operator, arm, go, reject, see
from kincal_shared import keys
from kincal_shared.errors import BadInput, CommandFailed

STATE = library("flight").enum("kc_state_t", "KC_ST_")
EVENT = library("flight").enum("kc_event_id_t", "KC_EVT_")
NAMES = [f"c{i}" for i in range(54)]


@pytest.fixture
def key_file(tmp_path):
    path = tmp_path / "keys"
    keys.new(path)
    return path


@pytest.fixture
def file(tmp_path):
    return tmp_path / "journal.jsonl"


@contextmanager
def full_medium(room_bytes):
    """No file grows beyond so many bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, ignored)


class Lander(DirectFlight):
    """Starts and aborts; after a command `then` is called."""

    then = staticmethod(lambda _opcode: None)

    def publish(self, channel, message):
        super().publish(channel, message)
        if message.opcode == kcm.cmd_t.START:
            self.hk.state = STATE["MOVE"]
            self.answer("KC_EVENT", event(self.hk.t_us, 1, EVENT["CAL_START"], 1, 20.0, 4))
        elif message.opcode == kcm.cmd_t.ABORT:
            self.hk.state = STATE["SAFE"]
        self.then(message.opcode)


def act(flight, request, file):
    said, snapshot = [], operate.Snapshot()
    operate.listen(flight, snapshot, 2.0, lambda s: s.hk is not None)
    who = Operator("A. Operator", "because", file, 5.0, said.append)
    return operate.act(flight, request, who, snapshot, lambda _step: None), said


def note(file, signer, text="a comment"):
    return record(file, journal.COMMENT, 0, "B. Second", text, "", None, signer)


# ---- ABORT


@pytest.mark.parametrize("trouble", ["no counter", "a folder", "a link", "locked", "full medium"])
def test_an_abort_goes_out_whatever_is_wrong_with_the_counter(key_file, file, trouble):
    """It was lost: the counter has to be kept before a command can be signed."""
    counter = keys.count_file(key_file, 2)
    flight, held = Lander(keys.signer_of(key_file)), None
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
        done, said = act(flight, operate.abort(), file)
    if held:
        held.close()
    assert done.outcome == operate.DONE
    assert [(c.opcode, c.key_id) for c in flight.commands] == [(kcm.cmd_t.ABORT, 0)]
    assert trouble != "full medium" or "not in the journal" in said[-1]


def test_any_other_command_is_not_sent_if_it_cannot_be_counted(key_file, file):
    keys.count_file(key_file, 2).write_text("many\n")
    flight = Lander(keys.signer_of(key_file))
    with pytest.raises(BadInput, match="no counter"):
        act(flight, operate.start(), file)
    assert not flight.commands


def test_a_counter_on_a_full_medium_is_an_error_for_people_and_stays(key_file):
    signer = keys.signer_of(key_file)
    before = signer.count(2)
    with full_medium(0), pytest.raises(BadInput, match="the counter cannot be kept"):
        signer.count(2)
    assert signer.count(2) == before + 1


# ---- the journal


@pytest.mark.parametrize("room", [0, 20, "the line fits, its mark does not"])
def test_a_full_medium_leaves_journal_and_mark_as_they_were(key_file, file, room, monkeypatch):
    """A line without its mark made the next one look like one that somebody had appended."""
    signer = keys.signer_of(key_file)
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
def test_a_journal_that_cannot_be_made_is_an_error_for_people(key_file, tmp_path, place):
    (tmp_path / "a file").write_text("")
    with pytest.raises(BadInput, match="the review journal cannot be kept"):
        note(tmp_path / place, keys.signer_of(key_file))


def test_a_reader_never_sees_a_writer_half_done(key_file, file, monkeypatch):
    """A line that was added between the reading of journal and mark made the journal look cut: a decision was
    refused, an audit raised alarm."""
    signer, parse = keys.signer_of(key_file), journal._parsed
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
def test_a_journal_that_another_program_holds_is_said_not_waited_for(key_file, file, using, monkeypatch):
    signer = keys.signer_of(key_file)
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
def test_a_command_that_flight_took_is_said_also_if_the_journal_is_full_by_then(key_file, file, name):
    """The error of the journal stood alone, as if nothing had been sent."""
    signer = keys.signer_of(key_file)
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


def test_what_became_of_a_decision_is_written_also_if_somebody_else_wrote_meanwhile(key_file, file):
    """A comment of another console between attempt and outcome counted as the outcome."""
    signer = keys.signer_of(key_file)
    flight = Lander(signer).waits(CRC)
    who = Operator("A. Operator", "because", file, 5.0)
    see(file, from_message(proposal(), NAMES), who.by, file, signer)
    flight.refuse[kcm.cmd_t.APPROVE_ARM] = (-8, 13)
    flight.then = lambda _opcode: note(file, keys.signer_of(key_file))
    with pytest.raises(CommandFailed):
        arm(flight, f"{CRC:08x}", who)
    found = [(e.decision, e.command) for e in journal.read(file, signer.known).entries]
    assert found[1:] == [("attempt", "APPROVE_ARM"), ("comment", ""), ("refused", "APPROVE_ARM")]


# ---- two at once


def test_two_programs_that_begin_at_the_same_moment_do_not_share_answers(key_file, monkeypatch):
    """Their numbers came from the clock, to a quarter of a second: who was refused took the other's answer
    for its own, and the journal had two approvals."""
    monkeypatch.setattr("kincal.link.connection.time.time", lambda: 1_795_000_000.0)
    first, second = (DirectFlight(keys.signer_of(key_file)) for _ in range(2))
    assert first.send("APPROVE_GO", (CRC,)) != second.send("APPROVE_GO", (CRC,))
    alone = DirectFlight(), DirectFlight()
    assert len({link.send("NOOP") for link in alone}) == 1  # flight wants these to grow from start to start
