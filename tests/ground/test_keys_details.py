"""Keys to the last detail: counters, numbers and files at their limits."""

import errno
import os
import time

import pytest
from commands import shell

import kcm
from kincal_shared import keys
from kincal_shared.errors import BadInput

SECRET = "ab" * 32
MOST_COUNT = 2**63 - 1


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "keys"
    keys.new(path)
    return path


def written(tmp_path, *lines):
    path = tmp_path / "written"
    path.write_text("".join(f"{line}\n" for line in ("kincal-keys 1", *lines)))
    path.chmod(0o600)
    return path


def test_counters_in_memory_grow_by_one_from_one_for_each_source():
    count = keys.counting()
    assert [count(1), count(1), count(2), count(1), count(2)] == [1, 2, 1, 3, 2]
    assert keys.counting()(1) == 1


def test_a_lost_counter_begins_at_the_clock_in_microseconds(file):
    before_us = time.time_ns() // 1000
    assert before_us < keys.counters_beside(file)(2) <= time.time_ns() // 1000 + 1
    assert keys.count_file(file, 2).name == "keys.count2"
    assert keys.count_file(file, 2).stat().st_mode & 0o777 == 0o600


def test_a_counter_goes_up_to_the_largest_that_messages_carry(file):
    path = keys.count_file(file, 2)
    path.write_text(f"{MOST_COUNT - 1}\n")
    assert keys.counters_beside(file)(2) == MOST_COUNT
    for last in (MOST_COUNT, MOST_COUNT + 1):
        path.write_text(f"{last}\n")
        with pytest.raises(BadInput, match="no counter"):
            keys.counters_beside(file)(2)
        assert path.read_text() == f"{last}\n"


def test_a_counter_that_gets_longer_or_had_more_behind_it_is_written_alone(file):
    path = keys.count_file(file, 2)
    path.write_text("9   \n\n")
    assert keys.counters_beside(file)(2) == 10
    assert path.read_text() == "10\n"


def test_a_signer_remembers_the_last_counter_of_each_source(file):
    signer = keys.Signer(keys.read(file)[0], keys.counting())
    for source in (1, 1, 2):
        command = kcm.cmd_t()
        command.source = source
        signer.command(command)
    assert signer.counters == {1: 2, 2: 1}
    assert signer.known == (signer.key,)
    assert keys.signer_of(file).known == keys.read(file)


def test_a_signature_holds_with_counter_0_but_not_below(file):
    key = keys.read(file)[0]
    for counter, good in ((0, True), (1, True), (-1, False)):
        command = kcm.cmd_t()
        keys.Signer(key, lambda _source, n=counter: n if n >= 0 else 0).command(command)
        command.counter = counter
        assert keys.signed_by(command, key) is good
    command.counter, command.key_id = 0, key.id + 1
    assert not keys.signed_by(command, key)


@pytest.mark.parametrize("number", [1, 2**31 - 1])
def test_numbers_of_keys_are_positive_and_fit_a_message(tmp_path, number):
    assert keys.read(written(tmp_path, f"{number} {SECRET}"))[0].id == number
    for wrong in (0, 2**31):
        with pytest.raises(BadInput, match="a key is a number"):
            keys.read(written(tmp_path, f"{wrong} {SECRET}"))


def test_a_wrong_line_is_named_by_its_number(tmp_path):
    with pytest.raises(BadInput) as error:
        keys.read(written(tmp_path, f"1 {SECRET}", "2 nonsense"))
    assert error.value.where.endswith("line 3")


def test_the_key_file_is_the_given_one_or_that_of_the_variable_or_that_at_home(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv(keys.VARIABLE, "~/mine")
    assert keys.file_of(tmp_path / "given") == tmp_path / "given"
    assert keys.file_of(None) == tmp_path / "mine"
    monkeypatch.delenv(keys.VARIABLE)
    assert keys.file_of(None) == tmp_path / ".kincal" / "keys"


def test_what_an_interrupted_write_left_is_replaced(file):
    part = file.with_name("keys.part")
    part.write_text("half")
    part.chmod(0o666)
    assert keys.rotate(file).id == 2
    assert not part.exists()
    assert file.stat().st_mode & 0o777 == 0o600


def test_a_new_key_makes_its_folder_for_its_owner_only_and_spares_what_is_there(tmp_path):
    path = tmp_path / "a" / "b" / "keys"
    key = keys.new(path)
    assert [p.stat().st_mode & 0o777 for p in (path.parent, path)] == [0o700, 0o600]
    assert (key.id, len(key.secret)) == (1, 32) and len(set(key.secret)) > 8
    assert keys.read(path) == (key,) and keys.new(tmp_path / "other").secret != key.secret
    before = path.read_bytes()
    with pytest.raises(BadInput, match="a key file already"):
        keys.new(path)
    assert path.read_bytes() == before


def test_each_command_says_which_key_signs(tmp_path, monkeypatch):
    path = tmp_path / "k"

    def said(verb, *file):
        return shell("key", verb, *file).output.strip()

    assert said("new", path).startswith(f"{path}: key 1;")
    assert said("rotate", path).startswith(f"{path}: key 2 added;")
    assert said("show", path).startswith(f"{path}: key 1 signs, key 2 is new\n  key 1: fingerprint ")
    assert said("retire", path).startswith(f"{path}: key 1 is gone, key 2 signs;")
    monkeypatch.setenv(keys.VARIABLE, str(path))
    assert said("show").startswith(f"{path}: key 2 signs\n")


def test_keys_of_simulations_differ_by_seed_only():
    first = keys.of_simulation(1)
    assert first == keys.of_simulation(1) != keys.of_simulation(2)
    assert (first.id, len(first.secret)) == (1, 32)


def test_key_show_has_a_fingerprint_of_each_key_and_no_secret(tmp_path):
    files = [tmp_path / name for name in ("flight", "copy", "other")]
    secret = keys.new(files[0]).secret
    keys.write(files[1], keys.read(files[0]))
    keys.new(files[2])
    shown = [shell("key", "show", f).output.splitlines()[1] for f in files]
    assert shown[0] == shown[1] != shown[2]
    mark = shown[0].partition("fingerprint ")[2]
    assert len(mark) == 8 and mark not in secret.hex() and secret.hex() not in "".join(shown)
    assert keys.Key(1, secret).digest(b"").hex()[:8] != mark  # no MAC of anything that is sent


# ------------------------------------------------------------------------ holders


@pytest.mark.parametrize(
    ("key_id", "first", "last"), [(1, 1, 99), (99, 1, 99), (101, 100, 199), (4242, 4200, 4299)]
)
def test_the_second_step_takes_a_key_of_another_hundred(key_id, first, last):
    assert keys.other_than(key_id).endswith(f"than key {key_id}, of another holder (not {first} to {last})")


def test_the_number_of_a_holder_leaves_room_for_those_of_the_keys(tmp_path):
    most = (2**31 - 1) // 100 - 1
    assert keys.new(tmp_path / "most", most).id == 100 * most + 1
    for number in (-1, most + 1):
        with pytest.raises(BadInput, match="no number of a holder"):
            keys.new(tmp_path / "none", number)
    assert not (tmp_path / "none").exists()


def test_a_file_holds_one_to_four_keys_of_different_numbers(tmp_path):
    lines = [f"{n} {SECRET}" for n in range(1, 6)]
    for n in range(1, 5):
        assert len(keys.read(written(tmp_path, *lines[:n]))) == n
    for wrong, words in (([], "not 0"), (lines, "not 5"), ([lines[0], lines[0]], "")):
        with pytest.raises(BadInput, match=f"one to four keys.*{words}"):
            keys.read(written(tmp_path, *wrong))


def test_files_of_holders_are_joined_if_flight_takes_that_many_keys(tmp_path):
    files = []
    for number in range(5):
        files.append(tmp_path / f"holder{number}")
        keys.new(files[-1], number)
    out = tmp_path / "folder" / "flight"
    for n in range(1, 5):
        assert [key.id for key in keys.join(out, files[:n])] == [100 * k + 1 for k in range(n)]
        assert keys.read(out) == keys.join(out, files[:n])
    before = out.read_bytes()
    for wrong, words in (
        ([], "these are 0"),
        (files, "these are 5"),
        ([files[0], files[0]], "the same number"),
        ([files[0], out], "the same number"),
    ):
        with pytest.raises(BadInput, match=words):
            keys.join(out, wrong)
    with pytest.raises(BadInput, match="file of a holder would be replaced"):
        keys.join(files[1], files[:2])
    assert out.read_bytes() == before and len(keys.read(files[1])) == 1
    assert out.parent.stat().st_mode & 0o777 == 0o700


def test_a_file_that_another_program_holds_is_waited_for_and_then_said(file):
    with file.open("rb", buffering=0) as mine, file.open("rb", buffering=0) as other:
        keys.lock(other, file, 0.0)
        begun_s = time.monotonic()
        with pytest.raises(BadInput, match="has held this file for 0.05 s"):
            keys.lock(mine, file, 0.05)
        assert time.monotonic() - begun_s >= 0.05
        other.close()
        keys.lock(mine, file, 0.0)


@pytest.mark.parametrize(
    ("number", "todo"),
    [(errno.EROFS, "make its medium writable"), (errno.ENOSPC, "free space"), (errno.EACCES, "of your own")],
)
def test_where_the_medium_is_at_fault_the_file_is_not_blamed(tmp_path, monkeypatch, number, todo):
    def refusing(*_given):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "open", refusing)
    with pytest.raises(BadInput) as refused:
        keys.open_own(tmp_path / "review.jsonl", "the review journal cannot be kept")
    assert todo in refused.value.todo and os.strerror(number) in refused.value.what
