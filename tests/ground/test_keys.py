"""Key files and counters of senders, and the commands that handle them."""

import os
import threading

import pytest
from commands import shell as cli

import kcm
from kincal_shared import keys
from kincal_shared.errors import BadInput

GOOD = "kincal-keys 1\n7 " + "0a" * 32 + "\n"


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "sub" / "keys"
    keys.new(path)
    return path


def command(source=2):
    m = kcm.cmd_t()
    m.source, m.opcode = source, m.START
    return m


@pytest.mark.parametrize("mode", [0o640, 0o620, 0o604, 0o602, 0o666])
def test_a_file_that_others_may_read_or_change_is_refused(file, mode):
    file.chmod(mode)
    with pytest.raises(BadInput, match="others may read or change the keys"):
        keys.read(file)


def test_a_file_of_another_user_is_refused(file, monkeypatch):
    monkeypatch.setattr(os, "geteuid", lambda: file.stat().st_uid + 1)
    with pytest.raises(BadInput, match="another user"):
        keys.read(file)


@pytest.mark.parametrize(
    "text",
    [
        "", "kincal-keys 1\n", GOOD.replace("keys 1", "keys 2"), GOOD.replace("7 ", "0 "),
        GOOD.replace("7 ", "2147483648 "), GOOD.replace("7 ", "-7 "), GOOD.replace("0a\n", "\n"),
        GOOD.replace("0a\n", "0a0a\n"), GOOD.replace("0a\n", "0g\n"), GOOD.replace("0a", "00"),
        GOOD + GOOD.splitlines()[1] + "\n", GOOD + "".join(f"{n} {'0b' * 32}\n" for n in (8, 9, 107, 108)),
    ],
)  # fmt: skip
def test_a_text_with_anything_wrong_is_refused(tmp_path, text):
    path = tmp_path / "keys"
    path.write_text(text)
    path.chmod(0o600)
    with pytest.raises(BadInput) as refused:
        keys.read(path)
    assert str(path) in refused.value.where and "0a0a" not in str(refused.value)


def test_a_missing_file_says_how_to_make_one(tmp_path):
    with pytest.raises(BadInput, match="kincal key new"):
        keys.read(tmp_path / "keys")


def test_rotation_adds_a_key_that_signs_when_the_old_one_is_retired(file):
    (old,) = keys.read(file)
    new = keys.rotate(file)
    assert keys.read(file) == (old, new) and new.id == 2
    assert keys.signer_of(file).key == old
    with pytest.raises(BadInput, match="under way"):
        keys.rotate(file)
    assert keys.retire(file) == old
    assert keys.signer_of(file).key == new and file.stat().st_mode & 0o777 == 0o600
    with pytest.raises(BadInput, match="no other key"):
        keys.retire(file)


def test_counters_grow_over_senders_and_each_source_has_its_own(file):
    first, second = keys.signer_of(file), keys.signer_of(file)
    ground = [s.command(command()).counter for s in (first, second, first)]
    assert ground == [ground[0], ground[0] + 1, ground[0] + 2]
    keys.count_file(file, 1).write_text("5\n")
    assert first.command(command(source=1)).counter == 6
    keys.rotate(file)
    keys.retire(file)
    assert keys.signer_of(file).command(command()).counter == ground[0] + 3


def test_a_counter_that_is_a_link_or_a_pipe_is_refused_and_what_it_leads_to_stays(file, tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("41\n")
    count = keys.count_file(file, 2)
    count.symlink_to(victim)
    with pytest.raises(BadInput, match="this is a symbolic link") as refused:
        keys.signer_of(file).command(command())
    assert refused.value.where == str(count) and victim.read_text() == "41\n"
    count.unlink()
    os.mkfifo(count)
    with pytest.raises(BadInput, match="no regular file of yours"):
        keys.signer_of(file).command(command())


@pytest.mark.parametrize("change", [keys.rotate, lambda link: keys.join(link, [link.with_name("one")])])
def test_a_link_is_no_place_for_keys_as_the_file_behind_it_would_keep_the_old_ones(file, tmp_path, change):
    link, before = tmp_path / "link", file.read_bytes()
    link.symlink_to(file)
    keys.new(tmp_path / "one")
    with pytest.raises(BadInput, match="is a symbolic link") as refused:
        change(link)
    assert str(file) in refused.value.todo
    assert link.is_symlink() and file.read_bytes() == before


def test_a_folder_is_no_key_file(tmp_path):
    with pytest.raises(BadInput, match="this is a folder"):
        keys.new(tmp_path)


def test_of_two_that_write_a_key_file_at_once_the_slower_one_gets_an_error(file, monkeypatch):
    part = file.with_name("keys.part")
    monkeypatch.setattr(os, "fsync", lambda _file: part.unlink())  # the other was quicker
    with pytest.raises(BadInput, match="another program writes this key file"):
        keys.rotate(file)


def test_a_counter_of_another_user_is_refused(file, monkeypatch):
    count = keys.count_file(file, 2)
    count.write_text("41\n")
    monkeypatch.setattr(os, "geteuid", lambda: count.stat().st_uid + 1)
    with pytest.raises(BadInput, match="no regular file of yours"):
        keys.counters_beside(file)(2)


@pytest.mark.parametrize("text", ["x", "-1", "1.5", "\u0663", str(2**63 - 1), "9" * 100, "1\n2"])
def test_what_is_no_counter_is_refused_and_left(file, text):
    count = keys.count_file(file, 2)
    count.write_text(text, encoding="utf-8")
    with pytest.raises(BadInput, match="this is no counter"):
        keys.signer_of(file).command(command())
    assert count.read_text(encoding="utf-8") == text


def test_a_signature_is_known_by_its_key(file, tmp_path):
    signer, other = keys.signer_of(file), keys.new(tmp_path / "other")
    m = signer.command(command())
    assert signer.counters == {2: m.counter} and keys.signed_by(m, signer.key)
    assert not keys.signed_by(m, other)
    m.opcode = m.ABORT
    assert not keys.signed_by(m, signer.key)


def test_senders_at_the_same_time_never_share_a_counter(file):
    counters, count = [], keys.counters_beside(file)

    def send():
        counters.extend(count(2) for _ in range(50))

    threads = [threading.Thread(target=send) for _ in range(4)]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    assert len(set(counters)) == 200


def test_nothing_is_sent_without_a_key(tmp_path):
    refused = cli("review", "reject", "1a2b3c4d", "--by", "a", "--why", "b", "--keys", tmp_path / "none")
    assert refused.exit_code == 2 and "kincal key new" in refused.output
