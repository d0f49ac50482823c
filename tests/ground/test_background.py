"""Work in a second process: the same results and errors as in one, and nothing is left when it ends."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import poses
import pytest
from places import ROOT

from kincal import workbench as wb
from kincal.workbench.numerics.background import second_process, when_asked
from kincal_shared.errors import CannotAnswer

PATIENCE_S = 30


def children(pid):
    return [int(x) for x in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def no_child_is_left():
    with pytest.raises(ChildProcessError):
        os.waitpid(-1, os.WNOHANG)
    return True


def test_work_is_done_in_another_process_and_its_result_comes_back():
    with second_process() as begin:
        result = begin(lambda: (os.getpid(), np.arange(200_000)))
        (worker,) = children(os.getpid())
        pid, numbers = result()
    assert pid == worker != os.getpid()
    assert np.array_equal(numbers, np.arange(200_000))
    assert no_child_is_left()


def test_work_when_asked_is_done_here_and_not_before():
    done = []
    result = when_asked(lambda: done.append(os.getpid()))
    assert done == []
    result()
    assert done == [os.getpid()]


def test_an_error_of_the_second_process_is_raised_where_the_result_is_asked_for(capfd):
    def fails():
        raise CannotAnswer("too few poses", "here", "measure more")

    with second_process() as begin:
        result = begin(fails)
        with pytest.raises(CannotAnswer, match="too few poses"):
            result()
    assert capfd.readouterr() == ("", "")
    assert no_child_is_left()


@pytest.fixture
def interruptible():
    """Tests in the background of a shell have SIGINT ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_work_is_done_here_where_the_second_process_is_ended(number, capfd):
    first, (there, here) = os.getpid(), os.pipe()

    def work():
        if os.getpid() != first:
            os.write(here, b"begun")
            time.sleep(PATIENCE_S)
        return os.getpid()

    with second_process() as begin:
        result = begin(work)
        assert os.read(there, 5) == b"begun"
        os.kill(children(first)[0], number)
        assert result() == first
    os.close(there)
    os.close(here)
    assert capfd.readouterr() == ("", "")
    assert no_child_is_left()


def test_an_error_of_the_first_process_ends_the_second_one():
    with pytest.raises(KeyboardInterrupt), second_process() as begin:
        begin(lambda: time.sleep(PATIENCE_S))
        raise KeyboardInterrupt
    assert no_child_is_left()


def test_results_of_one_and_of_two_processes_are_the_same(tmp_path):
    arm = wb.read_arm(poses.arm_toml(tmp_path / "arm.toml"))
    data = wb.read_csv(poses.poses_csv(tmp_path / "p.csv", 60, 3), 7)
    alone = wb.compare(arm, data).reachable
    with second_process() as begin:
        assert wb.compare(arm, data, begin=begin).reachable == alone


# ------------------------------------------------------------------------------------- the command


@pytest.fixture
def command(tmp_path):
    """`kincal model diagnose`, as soon as it works in two processes, and the second of them."""
    arm = poses.arm_toml(tmp_path / "arm.toml")
    data = poses.poses_csv(tmp_path / "p.csv", 100, 3)
    words = [sys.executable, "-m", "kincal", "model", "diagnose", "--json", "--arm", arm, "--data", data]
    process = subprocess.Popen(
        list(map(str, words)),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=os.environ | {"PYTHONPATH": str(ROOT / "ground")},
        # A test run in the background of a shell has SIGINT ignored, which its children inherit.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    end = time.monotonic() + PATIENCE_S
    while not (second := children(process.pid)) and time.monotonic() < end:
        time.sleep(0.005)
    time.sleep(0.2)  # os.fork() swallows a signal that comes before it is through
    yield process, second[0]
    process.kill()
    process.communicate()


@pytest.mark.parametrize("both", [True, False], ids=["terminal", "first process"])
def test_interrupted_diagnosis_ends_with_130_in_both_processes(command, both):
    process, second = command
    (os.killpg if both else os.kill)(process.pid, signal.SIGINT)
    said = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, *said) == (130, "", "interrupted\n")
    assert not Path(f"/proc/{second}").exists()


def test_diagnosis_answers_although_its_second_process_was_ended(command):
    process, second = command
    os.kill(second, signal.SIGKILL)
    out, err = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, err) == (0, "")
    assert json.loads(out)["reachable"]["pos_mm"] > 0
