"""What a calibration gave is given again by the program that other CPUs run (`make cross`)."""

import subprocess

import pytest
from conftest import ROOT
from record import record

from kincal.run.inprocess import Setup


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A short calibration, and the program."""
    folder = tmp_path_factory.mktemp("replay")
    record(folder, (("paper", 3, Setup(poses=1)),))
    sources = [ROOT / "tests/cross" / name for name in ("replay.c", "host.c")]
    sources_of = (ROOT / "fsw", ROOT / "build/made")
    rooms = [f"-I{room}" for place in sources_of for room in place.iterdir() if room.is_dir()]
    build = ["gcc", "-std=c11", "-O1", f"-I{folder}", *rooms, *sources, ROOT / "build/libkincal.a"]
    subprocess.run([*build, "-o", folder / "replay"], check=True)
    return folder


def replayed(folder):
    done = subprocess.run([folder / "replay"], cwd=folder, capture_output=True, text=True)
    return done.returncode, done.stdout


def test_replay_gives_what_the_calibration_gave(folder):
    expected = (folder / "expected.txt").read_text()
    lines = [line.split() for line in expected.splitlines()]
    assert len(lines) > 3
    assert all(crc != "00000000" for crc in lines[-1][2:])  # every group had something to say
    assert replayed(folder) == (0, expected)


def test_a_call_that_is_left_out_shows(folder, tmp_path):
    """A step half way through."""
    data, calls = (folder / "record.bin").read_bytes(), []
    while data:
        n = 4 + int.from_bytes(data[:4], "little")
        calls.append(data[:n])
        data = data[n:]
    del calls[len(calls) // 2]
    (tmp_path / "record.bin").write_bytes(b"".join(calls))
    (tmp_path / "replay").symlink_to(folder / "replay")
    code, text = replayed(tmp_path)
    assert code == 0
    assert text != (folder / "expected.txt").read_text()


def test_a_record_that_breaks_off_is_refused(folder, tmp_path):
    (tmp_path / "record.bin").write_bytes((folder / "record.bin").read_bytes()[:-1])
    (tmp_path / "replay").symlink_to(folder / "replay")
    assert replayed(tmp_path)[0] == 1
