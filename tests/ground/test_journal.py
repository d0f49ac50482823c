"""The journal of decisions: who can change it unnoticed, what a log says that it lacks, where it lies."""

import json
import os
import time
from dataclasses import replace

import lcm
import pytest
from commands import shell, text_of
from fake_flight import FakeFlight
from samples import CRC, decided, signed, write_log

import kcm
from kincal import review
from kincal.cli.errors import EXIT_FAILED, EXIT_INPUT
from kincal.review import journal as journals
from kincal_shared import keys
from kincal_shared.errors import BadInput

DAMAGED = "the review journal is damaged"
CHANGED = "the review journal was changed"


@pytest.fixture
def file(tmp_path):
    """Keys of a test's own."""
    path = tmp_path / "own" / "keys"
    keys.new(path)
    return path


@pytest.fixture
def journal(tmp_path, file):
    """Three decisions, signed."""
    path = tmp_path / "journal.jsonl"
    for n in range(3):
        decide(path, file, CRC, f"reason {n}")
    return path


def decide(path, file, crc, why="why"):
    """A decision, after the command that carries it out; returns that command."""
    signer = keys.signer_of(file)
    m = kcm.cmd_t()
    m.source, m.opcode, m.seq, m.arg_i = m.SRC_GROUND, m.APPROVE_GO, 7, [signed(crc), 0, 0, 0]
    m = signer.command(m)
    review.record(path, "approve", crc, "me", why, "url", None, signer)
    return m


def read(path, file):
    return journals.read(path, keys.read(file))


def change(path, line, **what):
    """Write other values into a line."""
    lines = path.read_text().splitlines()
    lines[line] = json.dumps({**json.loads(lines[line]), **what}, sort_keys=True)
    path.write_text("\n".join(lines) + "\n")


def verify(path, file, *logs):
    given = ["audit", "verify", *map(str, logs), "--journal", str(path), "--keys", str(file)]
    return shell(*given)


def reject(flight, path, file):
    given = ["--by", "me", "--why", "x", "--url", flight.url, "--journal", str(path), "--keys", str(file)]
    return shell("review", "reject", f"{CRC:08x}", *given)


# ------------------------------------------------------------------------ the last line


def test_every_line_of_a_good_journal_is_vouched_for(journal, file):
    found = read(journal, file)
    assert (len(found.entries), found.unconfirmed) == (3, 0)
    assert [e.counter for e in found.entries] == [found.entries[0].counter + n for n in range(3)]
    run = verify(journal, file)
    assert (
        run.exit_code == 0
        and "3 decisions and commands in 3 lines, each line from the holder of the key" in run.output
    )


@pytest.mark.parametrize(
    "what", [{"why": "better"}, {"crc": "0badcafe"}, {"override": "x"}, {"time": "2020"}, {"mac": "00" * 16}]
)
def test_a_changed_last_line_is_noticed_and_named(journal, file, what):
    change(journal, 2, **what)
    run = verify(journal, file)
    assert run.exit_code == EXIT_INPUT
    assert f"{journal}:3" in run.output and "did not write this line" in run.output


def test_a_line_appended_without_the_key_is_noticed(journal, file, tmp_path):
    other = tmp_path / "other"
    keys.new(other)  # its key has the same number
    with pytest.raises(BadInput, match="did not write this line"):
        decide(journal, other, 1)
    last = journal.read_bytes().splitlines()[-1]
    forged = {**json.loads(last), "previous": journals._hash(last), "mac": "", "key_id": 0, "why": "by hand"}
    with journal.open("a") as out:
        out.write(json.dumps(forged, sort_keys=True) + "\n")
    with pytest.raises(BadInput, match="MAC of a line is missing") as refused:
        read(journal, file)
    assert refused.value.where == f"{journal}:4"


@pytest.mark.parametrize("instead", [[], ["{"]], ids=["gone", "damaged"])
def test_a_line_between_others_that_is_gone_or_damaged_is_named(journal, file, instead):
    lines = journal.read_text().splitlines()
    journal.write_text("\n".join([lines[0], *instead, lines[2]]) + "\n")
    with pytest.raises(BadInput, match="journal") as refused:
        read(journal, file)
    assert refused.value.where == f"{journal}:2"


def test_a_line_that_is_written_differently_is_not_the_line_that_was_signed(journal, file):
    text = journal.read_text().splitlines()
    journal.write_text("\n".join([*text[:2], text[2].replace('"why": "', '"why":  "')]) + "\n")
    with pytest.raises(BadInput, match=DAMAGED):
        read(journal, file)


def test_a_changed_journal_stops_a_decision_before_anything_is_sent(journal, file):
    change(journal, 2, why="better")
    with FakeFlight(CRC) as flight:
        run = reject(flight, journal, file)
    assert run.exit_code == EXIT_INPUT and "did not write this line" in run.output
    assert flight.commands == []


# ------------------------------------------------------------------------ a line that is gone


def log_of(path, commands, status=0):
    """A log with commands of the ground and flight's answers."""
    log = lcm.EventLog(str(path), "w", overwrite=True)
    for n, m in enumerate(commands):
        answer = kcm.ack_t()
        answer.source, answer.seq, answer.opcode, answer.status = m.source, m.seq, m.opcode, status
        log.write_event(2 * n, "KC_CMD", m.encode())
        log.write_event(2 * n + 1, "KC_ACK", answer.encode())
    log.close()
    return path


def cut(journal, lines=1):
    """Take the last lines away."""
    journal.write_text("".join(journal.read_text().splitlines(keepends=True)[:-lines]))


def put_back(journal):
    """Context: the journal and its end mark as they were before, as a thorough forger would put them back."""
    return {path: path.read_bytes() for path in (journal, journals.end_file(journal))}


@pytest.mark.parametrize(("lines", "named"), [(1, "line 3 was removed"), (2, "lines 2 to 3 were removed")])
def test_last_lines_that_are_gone_are_named_by_the_end_mark(journal, file, lines, named):
    cut(journal, lines)
    run = verify(journal, file)
    assert run.exit_code == EXIT_INPUT
    assert f"the review journal was cut: {named} from its end" in run.output
    assert f"{journal}:{4 - lines}" in run.output


def test_without_keys_too_last_lines_that_are_gone_are_noticed(journal):
    cut(journal)
    with pytest.raises(BadInput, match="line 3 was removed"):
        journals.read(journal)


def test_an_end_mark_that_is_changed_gone_or_damaged_is_noticed(journal, file):
    mark = journals.end_file(journal)
    good = json.loads(mark.read_text())
    cut(journal)
    mark.write_text(
        json.dumps({**good, "lines": 2, "last": json.loads(journal.read_text().splitlines()[1])["previous"]})
    )
    with pytest.raises(BadInput, match="end mark of the journal was changed"):
        read(journal, file)
    mark.unlink()
    with pytest.raises(BadInput, match="end mark of the journal is gone: lines after line 2"):
        read(journal, file)
    for text in ("", "{}", "[]", '{"lines": 0, "last": "", "key_id": 1}', "\xff"):
        mark.write_text(text)
        with pytest.raises(BadInput, match="end mark of the journal is damaged"):
            read(journal, file)


def test_a_line_that_was_appended_after_the_end_is_named(journal, file):
    """Also by the holder of the key, if more than one: a power loss leaves one."""
    before = journals.end_file(journal).read_bytes()
    decide(journal, file, CRC, "fourth")
    journals.end_file(journal).write_bytes(before)
    assert len(read(journal, file).entries) == 4  # power was lost between line and mark
    decide(journal, file, CRC, "fifth")
    assert len(read(journal, file).entries) == 5
    journals.end_file(journal).write_bytes(before)
    with pytest.raises(BadInput, match="its end mark stands at line 3, this one was appended") as error:
        read(journal, file)
    assert error.value.where == f"{journal}:4"


def test_a_line_without_its_sign_of_a_mark_was_appended_also_with_the_key(journal, file):
    """What writes lines with MACs writes the mark too, and says so in the line."""
    (key, *_), last = keys.read(file), read(journal, file).entries[-1]
    line = replace(last, previous=journals._hash(last.text().encode()), marked=0)
    with journal.open("a") as out:
        out.write(replace(line, mac=line.mac_of(key)).text() + "\n")
    with pytest.raises(BadInput, match="its end mark stands at line 3, this one was appended"):
        read(journal, file)


def test_a_journal_that_was_put_back_is_noticed_by_what_was_noted(journal, file):
    noted, saved = journals.end_text(read(journal, file)), put_back(journal)
    decide(journal, file, CRC, "fourth")
    later = journals.end_text(read(journal, file))
    journals.check_noted(read(journal, file), noted)
    journals.check_noted(read(journal, file), later)
    for path, data in saved.items():
        path.write_bytes(data)
    journals.check_noted(read(journal, file), noted)
    for bad in (later, "3:", "3:00000000", "x:1", "", f"2:{noted[2:]}"):
        with pytest.raises(BadInput, match="does not hold what was noted"):
            journals.check_noted(read(journal, file), bad)


def test_a_last_line_that_is_gone_with_its_mark_is_noticed_by_what_flight_took(journal, file, tmp_path):
    saved = put_back(journal)
    log = log_of(tmp_path / "run.lcmlog", [decide(journal, file, CRC, "the last")])
    assert verify(journal, file, log).exit_code == 0
    for path, data in saved.items():
        path.write_bytes(data)
    assert verify(journal, file).exit_code == 0  # of itself it cannot tell
    run = verify(journal, file, log)
    text = text_of(run)
    assert run.exit_code == EXIT_FAILED
    assert f"approve of {CRC:08x} (key 1, counter" in text and "a line is gone after its last line" in text
    listed = shell("review", "list", log, "--journal", journal, "--keys", file)
    assert "NOT in the journal" in listed.output


def test_an_override_that_is_not_in_the_journal_is_noticed_and_a_plain_first_step_is_not(file, tmp_path):
    """The first step alone changes nothing; tools of before did not write it down."""
    armed = []
    for override in (0, 1):
        m = kcm.cmd_t()
        m.source, m.opcode, m.seq, m.arg_i = m.SRC_GROUND, m.APPROVE_ARM, 7, [signed(CRC), override, 0, 0]
        armed.append(keys.signer_of(file).command(m))
    journal = tmp_path / "journal.jsonl"
    assert verify(journal, file, log_of(tmp_path / "plain.lcmlog", armed[:1])).exit_code == 0
    run = verify(journal, file, log_of(tmp_path / "override.lcmlog", armed[1:]))
    assert run.exit_code == EXIT_FAILED and f"arm of {CRC:08x}" in text_of(run)


def test_that_somebody_has_seen_it_does_not_stand_for_a_decision_that_is_gone(journal, file, tmp_path):
    saved = put_back(journal)
    log = log_of(tmp_path / "run.lcmlog", [decide(journal, file, CRC, "the last")])
    entry = json.loads(journal.read_text().splitlines()[-1])
    for path, data in saved.items():
        path.write_bytes(data)
    signer = keys.signer_of(file)
    signer.counters[kcm.cmd_t.SRC_GROUND] = entry["counter"]
    review.record(journal, journals.SEEN, CRC, "me", "why", "url", None, signer)
    run = verify(journal, file, log)
    assert run.exit_code == EXIT_FAILED and "a line is gone" in text_of(run)


def test_what_flight_refused_or_a_stranger_sent_is_not_missed(journal, file, tmp_path):
    m = decide(tmp_path / "elsewhere", file, CRC)
    refused = log_of(tmp_path / "refused.lcmlog", [m], status=-8)
    m.mac = [1, 2]
    forged = log_of(tmp_path / "forged.lcmlog", [m])
    m.counter = -1
    negative = log_of(tmp_path / "negative.lcmlog", [m])
    assert verify(journal, file, refused, forged, negative).exit_code == 0


# ------------------------------------------------------------------------ keys that come and go


def test_lines_of_a_retired_key_are_vouched_for_by_those_after_them(journal, file):
    keys.rotate(file)
    keys.retire(file)
    found = read(journal, file)
    assert found.unconfirmed == 3 and "does not have key 1" in found.why
    run = verify(journal, file)
    assert run.exit_code == EXIT_FAILED and "lines 1 to 3: nobody can tell" in text_of(run)
    decide(journal, file, CRC)
    found = read(journal, file)
    assert found.unconfirmed == 0 and found.entries[-1].unconfirmed == 3
    change(journal, 0, why="other")
    with pytest.raises(BadInput, match="does not follow") as refused:
        read(journal, file)
    assert refused.value.where == f"{journal}:2"


def test_a_key_that_is_gone_cannot_come_back(journal, file, tmp_path):
    old = tmp_path / "old"
    keys.write(old, keys.read(file))
    keys.rotate(file)
    keys.retire(file)
    decide(journal, file, CRC)
    with pytest.raises(BadInput, match="older key"):
        signer = keys.signer_of(old)
        last = journal.read_bytes().splitlines()[-1]
        e = journals.Entry(*("x",) * 5, None, "", {}, previous=journals._hash(last), key_id=1)
        with journal.open("a") as out:
            out.write(journals.dataclasses.replace(e, mac=e.mac_of(signer.key)).text() + "\n")
        read(journal, file)


OLD = {
    "time": "2026-11-01T00:00:00+00:00", "decision": "approve", "crc": "fedcba98", "by": "me", "why": "clean",
    "session": 1, "url": "u", "numbers": {"p_fit": 0.5}, "previous": "",
}  # fmt: skip


def test_a_journal_of_before_lines_had_macs_is_read_and_goes_on(tmp_path, file):
    path = tmp_path / "old.jsonl"
    path.write_text(json.dumps(OLD, sort_keys=True) + "\n")
    found = read(path, file)
    assert found.unconfirmed == 1 and "carry no MAC" in found.why
    assert verify(path, file).exit_code == EXIT_FAILED
    with FakeFlight(CRC) as flight:
        run = reject(flight, path, file)
    assert run.exit_code == 0, run.output
    assert "line 1: nobody can tell whether they were changed" in text_of(run)
    found = read(path, file)
    assert found.unconfirmed == 0 and [e.unconfirmed for e in found.entries] == [0, 1, 0]


def test_power_that_is_lost_before_the_mark_is_no_damage_after_lines_without_macs(tmp_path, file):
    path = tmp_path / "old.jsonl"
    first = json.dumps(OLD, sort_keys=True)
    second = json.dumps(OLD | {"previous": journals._hash(first.encode())}, sort_keys=True)
    path.write_text(f"{first}\n{second}\n")
    decide(path, file, CRC, "third")
    before = journals.end_file(path).read_bytes()
    decide(path, file, CRC, "fourth")
    journals.end_file(path).write_bytes(before)
    assert len(read(path, file).entries) == 4


def test_without_keys_the_chain_is_checked_and_that_is_said(journal, tmp_path):
    run = verify(journal, tmp_path / "nowhere")
    assert run.exit_code == EXIT_FAILED and "there is no key file" in run.output


# ------------------------------------------------------------------------ what is no journal


@pytest.mark.parametrize(
    "text",
    [
        b"\xff\xfe\n", b"[]\n", b"5\n", b"{}\n", b"[" * 100_000 + b"\n",
        json.dumps({**OLD, "by": 5}).encode() + b"\n", json.dumps({**OLD, "numbers": []}).encode() + b"\n",
        json.dumps({**OLD, "session": "x"}).encode() + b"\n",
        json.dumps({**OLD, "extra": 1}).encode() + b"\n", b'{"session": ' + b"9" * 5000 + b"}\n",
    ],
)  # fmt: skip
def test_what_is_no_journal_is_refused_with_its_line(tmp_path, file, text):
    path = tmp_path / "j"
    path.write_bytes(text)
    for group, name in (("audit", "verify"), ("review", "list")):
        run = shell(group, name, "--journal", path, "--keys", file)
        assert run.exit_code == EXIT_INPUT and DAMAGED in run.output and f"{path}:1" in run.output


def test_a_line_that_was_cut_by_a_power_loss_is_named(journal, file):
    journal.write_bytes(journal.read_bytes()[:-1])
    with pytest.raises(BadInput, match="no end") as refused:
        read(journal, file)
    assert refused.value.where == f"{journal}:3"


@pytest.mark.parametrize("end", [b"\r\n", b"\r", b"\n\n"])
def test_other_ends_of_line_are_a_change(journal, file, end):
    journal.write_bytes(journal.read_bytes().replace(b"\n", end))
    with pytest.raises(BadInput, match="damaged|changed"):
        read(journal, file)


def test_a_journal_that_is_a_link_or_a_pipe_is_refused(tmp_path, file):
    target = tmp_path / "target"
    target.write_text("")
    (tmp_path / "link").symlink_to(target)
    os.mkfifo(tmp_path / "pipe")
    for name in ("link", "pipe"):
        begun = time.monotonic()
        with pytest.raises(BadInput, match=r"cannot be kept: this is (a symbolic link|no regular file)"):
            decide(tmp_path / name, file, CRC)
        assert time.monotonic() - begun < 2.0
    assert target.read_text() == ""


def test_a_full_medium_leaves_the_journal_as_it_was(journal, file, monkeypatch):
    before = journal.read_bytes()
    opened = keys.open_own

    class Full:
        """Takes ten bytes."""

        def __init__(self, raw):
            self.raw = raw

        def __enter__(self):
            return self

        def __exit__(self, *_):
            self.raw.close()

        def __getattr__(self, name):
            return getattr(self.raw, name)

        def write(self, data):
            return self.raw.write(data[:10])

    monkeypatch.setattr(journals, "open_own", lambda *a: Full(opened(*a)))
    with pytest.raises(BadInput, match="No space left"):
        decide(journal, file, CRC)
    assert journal.read_bytes() == before


# ------------------------------------------------------------------------ where it lies


def test_without_an_option_it_lies_beside_the_keys_at_home(tmp_path, monkeypatch):
    monkeypatch.delenv(keys.VARIABLE)
    monkeypatch.setenv("HOME", str(tmp_path))
    keys.new(keys.file_of(None))
    for folder in ("here", "there"):
        (tmp_path / folder).mkdir()
        monkeypatch.chdir(tmp_path / folder)
        with FakeFlight(CRC) as flight:
            given = ["--by", "me", "--why", folder, "--url", flight.url]
            run = shell("review", "reject", f"{CRC:08x}", *given)
        assert run.exit_code == 0, run.output
    listed = shell("review", "list").output
    assert "here" in listed and "there" in listed
    assert len(decided(review.check_journal(tmp_path / ".kincal" / "review.jsonl"))) == 2


def test_a_run_that_is_reviewed_with_its_own_keys_has_its_own_journal(tmp_path):
    own = tmp_path / "run" / "store.keys"
    keys.new(own)
    with FakeFlight(CRC) as flight:
        given = ["--by", "me", "--why", "x", "--url", flight.url, "--keys", str(own)]
        run = shell("review", "reject", f"{CRC:08x}", *given)
    assert run.exit_code == 0, run.output
    assert read(own.with_name("review.jsonl"), own).unconfirmed == 0


def test_the_decision_of_a_run_is_found_beside_its_log(tmp_path, file):
    folder = tmp_path / "run"
    folder.mkdir()
    log, own = folder / "run.lcmlog", folder / "store.keys"
    write_log(log)
    keys.write(own, (keys.of_simulation(3),))
    decide(folder / "review.jsonl", own, CRC, "of the run")
    given = ["--journal", str(tmp_path / "mine.jsonl"), "--keys", str(file)]
    listed = shell("review", "list", log, *given).output
    assert "of the run" in listed and "nobody can tell" not in listed
    assert verify(tmp_path / "mine.jsonl", file, log).exit_code == 0
    change(folder / "review.jsonl", 0, why="of somebody")
    assert verify(tmp_path / "mine.jsonl", file, log).exit_code == EXIT_INPUT


def test_a_journal_of_a_run_that_is_gone_altogether_is_noticed(tmp_path, file):
    own = tmp_path / "store.keys"
    keys.write(own, (keys.of_simulation(3),))
    log = log_of(tmp_path / "run.lcmlog", [decide(tmp_path / "review.jsonl", own, CRC)])
    (tmp_path / "review.jsonl").unlink()
    run = verify(tmp_path / "mine.jsonl", file, log)
    assert run.exit_code == EXIT_INPUT and "line 1 was removed" in run.output
    journals.end_file(tmp_path / "review.jsonl").unlink()
    run = verify(tmp_path / "mine.jsonl", file, log)
    assert run.exit_code == EXIT_FAILED and "NOT in the journal" in run.output
