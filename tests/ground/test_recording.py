"""Recordings of the link: whole files, whatever the medium does."""

import math
import os
import shutil
import time

import lcm
import pytest
from samples import event

from kincal.cli.record import record as cli_record
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
    assert [e.seq for e in recording.recent_events(here, 2, tmp_path)] == [37, 39]
    assert recording.recent_events(here, 2, tmp_path)[0].utc.startswith("2026-11-25T")
    assert 0 < len(recording.recent_events(here, 40, tmp_path)) < 10  # the end of the file only
    assert recording.recent_events(other, 2, tmp_path) == []


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
    assert len(recording.recent_events("udpm://224.0.0.1:1", 5, tmp_path)) == 2


# ---------------------------------------------------------------------------- figures

SIZE = 28 + len("KC_EVENT") + len(DATA)  # of a message in a file


def written(file):
    return [(e.channel, e.timestamp - UTC) for e in lcm.EventLog(str(file), "r")]


@pytest.mark.parametrize(("frame_s", "kept"), [(0.0, [0, 1, 2, 3]), (1.0, [0, 2]), (math.inf, [])])
def test_frames_of_the_camera_are_thinned_and_nothing_else(tmp_path, frame_s, kept):
    r = Recorder(tmp_path, frame_s=frame_s)
    for k in range(4):
        r.take(recording.FRAMES, b"frame", UTC + k, 0.5 * k)
        r.take("OTHER", b"", UTC + k, 0.5 * k)
    r.close()
    found = written(r.files[0])
    assert [t for channel, t in found if channel == recording.FRAMES] == kept
    assert [t for channel, t in found if channel == "OTHER"] == [0, 1, 2, 3]


def test_as_it_is_called_every_frame_and_every_file_stays(tmp_path):
    r = Recorder(tmp_path)
    assert (r.stem, r.most_files, r.frame_s) == ("link", 0, 0.0)
    (size,) = (p.default for p in cli_record.params if p.name == "megabytes")
    assert r.most_bytes == size * 2**20


def test_files_are_named_by_their_first_message_and_filled_to_the_last_byte(tmp_path):
    folder = tmp_path / "a" / "b"
    r = Recorder(folder, "s", most_bytes=2 * SIZE)
    fill(r, 5)
    assert r.state == recording.Recorded(r.files[2], 3, 5, 5 * SIZE, 0, "")
    r.take("KC_EVENT", DATA, UTC + 1_234_567, 1.0)
    r.take("KC_EVENT", DATA, UTC + 2_345_678, 1.0)
    r.close()
    assert [f.name for f in r.files] == [
        f"s-20261125T1302{name}.lcmlog" for name in ("22000Z", "22000Z-1", "22000Z-2", "24345Z")
    ]
    assert [f.stat().st_size for f in r.files] == [2 * SIZE, 2 * SIZE, 2 * SIZE, SIZE]
    assert folder.stat().st_mode & 0o777 == 0o700


def test_a_name_that_a_link_has_is_not_written_through(tmp_path):
    r = Recorder(tmp_path, "s")
    (tmp_path / "s-20261125T130222000Z.lcmlog").symlink_to(tmp_path / "elsewhere")
    fill(r, 1)
    r.close()
    assert r.files[0].name.endswith("Z-1.lcmlog") and not (tmp_path / "elsewhere").exists()


def test_what_was_recorded_is_on_the_medium_after_a_second(tmp_path, monkeypatch):
    r, at = Recorder(tmp_path), []
    monkeypatch.setattr(recording, "_synced", lambda _file: at.append(r.n_messages))
    for now_s in (1.5, 2.0, 2.5, 2.625, 3.75):
        r.take("OTHER", b"", UTC, now_s)
    assert at == [1, 4, 5]
    r.close()
    r.close()
    assert at == [1, 4, 5, 5]


def test_a_medium_that_does_not_keep_what_it_took_is_trouble(tmp_path, monkeypatch):
    r, broken = Recorder(tmp_path), [True]

    def synced(_file):
        if broken:
            raise OSError(5, "Input/output error")

    monkeypatch.setattr(recording, "_synced", synced)
    r.take("OTHER", b"", UTC, 10.0)
    assert (r.n_lost, r.trouble) == (1, f"Input/output error: {tmp_path}")
    r.take("OTHER", b"", UTC, 14.875)
    broken.clear()
    r.take("OTHER", b"", UTC + 9, 15.0)
    r.close()
    assert (r.n_lost, r.n_messages, r.trouble) == (2, 2, "")
    assert written(r.files[-1]) == [("OTHER", 9)]


def test_a_medium_that_takes_a_few_bytes_at_a_time_or_none(tmp_path, monkeypatch):
    class Slow(recording.FileIO):
        def write(self, data):
            return super().write(data[:7]) if room else 0

    room = True
    monkeypatch.setattr(recording, "FileIO", Slow)
    r = Recorder(tmp_path)
    fill(r, 2)
    room = False
    fill(r, 1, 2)
    assert r.trouble == f"No space left on device: {tmp_path}"
    assert written(r.files[0]) == [("KC_EVENT", 0), ("KC_EVENT", 1)]


def test_the_newest_recording_comes_first_and_other_links_are_left_out(tmp_path, monkeypatch):
    monkeypatch.setattr(recording, "FOLDER", tmp_path)
    for k, name in enumerate(("10.0.0.1-1-b", "10.0.0.1-1-c", "10.0.0.1-1-a", "10.0.0.1-11-a")):
        file = tmp_path / f"{name}.lcmlog"
        file.write_bytes(b"")
        os.utime(file, (1e9, 1e9 + k))
    found = [f.stem for f in recording.recordings(None, "udpm://10.0.0.1:1?ttl=0")]
    assert found == ["10.0.0.1-1-a", "10.0.0.1-1-c", "10.0.0.1-1-b"]
    assert len(recording.recordings()) == 4


def test_only_the_newest_recording_is_asked_for_events(tmp_path):
    url = "udpm://10.0.0.1:1?ttl=0"
    for k, number in enumerate((1, 2)):
        r = Recorder(tmp_path, recording.stem_of(url))
        r.take("KC_EVENT", event(k, 10 + k, number, 1).encode(), UTC + 1_500_000 + k * 10**6, 0.0)
        r.take("KC_HK", b"no event", UTC, 0.0)
        r.close()
        os.utime(r.files[0], (1e9, 1e9 + k))
    (line,) = recording.recent_events(url, 5, tmp_path)
    assert (line.seq, line.t_us, line.utc) == (11, 1, "2026-11-25T13:02:24.500+00:00")


@pytest.fixture
def tap(monkeypatch):
    monkeypatch.setattr(recording, "_QUEUE", 2)
    tap = recording.Tap("memq://")
    yield tap
    tap.close()


def test_a_tap_hears_every_channel_and_counts_what_nobody_takes(tap):
    begun_us = time.time_ns() // 1000
    tap._lcm.publish("ANY", b"\1\2")
    channel, data, utc_us = tap.next(5.0)
    assert (channel, data) == ("ANY", b"\1\2") and 0 <= utc_us - begun_us < 60_000_000
    assert tap.next(0.001) is None
    for k in range(5):
        tap._received("ANY", bytes([k]))
    assert tap.n_lost == 3 and tap.next(0.0)[1] == b"\0"
    tap.close()
    assert not tap._thread.is_alive()


class Given:
    """Messages in place of a network: None where nothing comes; the last ones come while it is closed."""

    n_lost, closed = 4, False

    def __init__(self, now, wanted, late):
        self.now, self.wanted, self.late = now, wanted, late

    def next(self, timeout_s):
        rows = self.late if self.closed else self.wanted
        assert timeout_s == 0.0 or not self.closed
        self.now[0] += 0.0 if self.closed else 4.0
        return rows.pop(0) if rows else None

    def close(self):
        self.closed = True


def test_how_a_recording_stands_is_said_at_intervals_and_when_trouble_begins_or_ends(tmp_path, monkeypatch):
    now, said = [100.0], []
    message = ("OTHER", b"", UTC)
    given = Given(now, [message, None, *[message] * 7], [message, message])
    monkeypatch.setattr(recording, "Tap", lambda _url: given)
    monkeypatch.setattr(recording.time, "monotonic", lambda: now[0])
    r = Recorder(tmp_path)
    whole = r._write

    def write(record):
        if now[0] == 116.0:
            raise OSError(28, "No space left on device")
        whole(record)

    monkeypatch.setattr(r, "_write", write)
    end = recording.record(
        "url", r, lambda: not given.wanted, lambda s: said.append((now[0], bool(s.trouble)))
    )
    # at once, at the trouble, at its end, then every ten seconds
    assert said == [(104.0, False), (116.0, True), (124.0, False), (136.0, False)]
    assert (end.n_messages, end.n_lost, end.file) == (8, 2 + 4, r.files[-1])
    assert r._file is None and given.closed
