"""Recordings of the link: whole files, whatever the medium does."""

import os
import shutil
import time

import lcm
import pytest
from samples import event

import kcm
from kincal.link import read_log
from kincal.operate import recording
from kincal.operate.recording import RETRY_S, Recorder
from kincal_shared.errors import BadInput
from kincal_sim.ports import private_port, private_url

DATA = event(1, 1, 1, 1).encode()
UTC = 1_795_611_742_000_000


def fill(recorder, n, begin=0):
    for k in range(begin, begin + n):
        recorder.take("KC_EVENT", DATA, UTC + k, 0.001 * k)


def test_a_recording_is_read_by_lcm_and_by_kincal(tmp_path):
    r = Recorder(tmp_path)
    fill(r, 3)
    r.take("OTHER", b"\1\2", UTC + 3, 1.0)
    r.close()
    (file,) = r.files
    read = [(e.eventnum, e.timestamp, e.channel, e.data) for e in lcm.EventLog(str(file), "r")]
    assert read[0] == (0, UTC, "KC_EVENT", DATA) and read[3] == (3, UTC + 3, "OTHER", b"\1\2")
    assert read_log(file).counts["KC_EVENT"] == 3
    assert file.stat().st_mode & 0o777 == 0o600


def test_a_full_file_is_followed_by_another_and_old_ones_go_only_if_asked(tmp_path):
    for keep, left in ((0, 5), (2, 2)):
        folder = tmp_path / str(keep)
        r = Recorder(folder, most_bytes=250, most_files=keep)
        fill(r, 10)
        r.close()
        assert len(r.files) == left == len(list(folder.iterdir()))
        assert all(file.stat().st_size <= 250 for file in r.files)
        assert sum(read_log(file).n_messages for file in r.files) == 2 * left
    assert recording.recordings(tmp_path / "0")[0].parent == tmp_path / "0"


def test_a_full_medium_loses_messages_not_files_and_goes_on_when_there_is_space(tmp_path):
    r = Recorder(tmp_path)
    fill(r, 2)
    whole = recording.FileIO.write

    class Full(recording.FileIO):
        def write(self, data):
            whole(self, data[:20])
            raise OSError(28, "No space left on device")

    real = r._file
    r._file = Full(os.dup(real.fileno()), "w")
    r.take("KC_EVENT", DATA, UTC + 2, 1.0)
    assert r.state.trouble.startswith("No space left on device") and r.n_lost == 1
    r.take("KC_EVENT", DATA, UTC + 3, 1.0 + RETRY_S / 2)
    assert r.n_lost == 2  # not tried again at once
    r.take("KC_EVENT", DATA, UTC + 4, 1.0 + RETRY_S)
    r.close()
    assert (r.state.trouble, r.n_messages, len(r.files)) == ("", 3, 2)
    first, second = (read_log(file) for file in r.files)
    assert (first.n_messages, first.damaged, second.n_messages) == (2, 0, 1)


def test_a_medium_that_is_full_from_the_start_leaves_no_empty_files(tmp_path, monkeypatch):
    r = Recorder(tmp_path)
    monkeypatch.setattr(r, "_write", lambda _record: (_ for _ in ()).throw(OSError(28, "No space left")))
    for k in range(3):
        r.take("KC_EVENT", DATA, UTC, k * 2 * RETRY_S)
    assert r.n_lost == 3 and list(tmp_path.iterdir()) == [] and r.files == []


def test_the_last_events_of_a_link_come_from_its_own_recording_only(tmp_path, monkeypatch):
    here, other = "udpm://239.255.76.67:7991?ttl=0", "udpm://239.255.76.67:7992?ttl=1"
    assert recording.stem_of(here) == "239.255.76.67-7991" and recording.stem_of("") == "link"
    monkeypatch.setattr(recording, "_TAIL_BYTES", 400)
    r = Recorder(tmp_path, recording.stem_of(here))
    for k in range(40):
        r.take("KC_EVENT", event(k, k, 1 if k % 2 else 48, 1 if k % 2 else 0, index=k).encode(), UTC, 0.0)
    r.take("KC_EVENT", b"damaged", UTC, 0.0)
    r.close()
    found = recording.recent_events(here, 2, tmp_path)
    assert [e.seq for e in found.events] == [37, 39]
    assert found.events[0].utc.startswith("2026-11-25T") and found.utc == found.events[0].utc
    assert found.file == r.files[-1] and all(e.recorded for e in found.events)
    assert 0 < len(recording.recent_events(here, 40, tmp_path).events) < 10  # the end of the file only
    assert recording.recent_events(other, 2, tmp_path) == recording.Recent()


def test_recorded_events_name_the_start_of_flight_that_they_are_of(tmp_path):
    url, hk = "udpm://239.255.76.67:7991?ttl=0", kcm.hk_t()
    r = Recorder(tmp_path, recording.stem_of(url))
    hk.boot_count = 2
    for data in (event(1, 1, 48, 1), hk, event(2, 2, 48, 1), event(3, 1, 1, 1, index=3), event(4, 2, 48, 1)):
        r.take("KC_HK" if data is hk else "KC_EVENT", data.encode(), UTC, 0.0)
    r.close()
    assert [e.start for e in recording.recent_events(url, 9, tmp_path).events] == [0, 2, 3, 3]


def test_a_folder_that_cannot_be_written_is_refused_at_once(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInput, match="nothing can be recorded there"):
        Recorder(tmp_path / "file")


@pytest.mark.parametrize("end", ["SIGTERM", "whoever started it was killed"])
def test_kincal_record_is_a_process_of_its_own_that_ends_in_good_order(tmp_path, end):
    """Of a console that was killed it went on for ever: a pipe ends with its last holder."""
    port, lock = private_port()
    url = private_url(port)
    process = recording.spawn(url, tmp_path)
    try:
        bus, deadline = lcm.LCM(url), time.monotonic() + 30.0
        while not list(tmp_path.glob("*.lcmlog")):
            assert time.monotonic() < deadline
            bus.publish("KC_EVENT", DATA)
            time.sleep(0.05)
        for _ in range(200):
            bus.publish("KC_EVENT", DATA)
        time.sleep(0.5)
        if end == "SIGTERM":
            process.terminate()
        else:
            process.stdin.close()  # as the kernel does for a process that is gone
        assert process.wait(timeout=20.0) == 0
    finally:
        process.kill()
        lock.close()
    (file,) = tmp_path.glob("*.lcmlog")
    found = read_log(file)
    assert found.counts["KC_EVENT"] >= 200 and found.damaged == 0


@pytest.mark.parametrize("what", ["the file", "the folder", "another file in its place"])
def test_a_recording_that_somebody_removes_is_said_and_goes_on_in_a_new_file(tmp_path, what):
    """It went on into a file that nobody could open any more, and all was said to be well."""
    r = Recorder(tmp_path / "here")
    r.take("KC_EVENT", DATA, UTC, 10.0)
    (file,) = r.files
    if what == "the folder":
        shutil.rmtree(file.parent)
    else:
        file.unlink()
        if what != "the file":
            file.write_bytes(b"")
    for k in range(1, 8):
        r.take("KC_EVENT", DATA, UTC + k, 10.0 + 0.2 * k)
    assert "was removed while it was written" in r.trouble and r.n_lost >= 6
    r.take("KC_EVENT", DATA, UTC + 10**6, 12.0 + RETRY_S)
    r.close()
    assert not r.trouble and r.files[-1] != file
    assert read_log(r.files[-1]).n_messages == 1


def test_what_is_no_recording_in_the_folder_hides_none(tmp_path):
    """A folder or a broken link of that name ended `kincal status`."""
    r = Recorder(tmp_path, "224.0.0.1-1")
    fill(r, 2)
    r.close()
    (tmp_path / "224.0.0.1-1-z.lcmlog").mkdir()
    (tmp_path / "224.0.0.1-1-y.lcmlog").symlink_to("/nowhere")
    assert recording.recordings(tmp_path) == r.files
    assert len(recording.recent_events("udpm://224.0.0.1:1", 5, tmp_path).events) == 2
