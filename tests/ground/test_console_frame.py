"""The camera's frame and the candidates in force, as the console has them."""

import math
import shutil

import pytest
from places import BIN
from samples import image
from starlette.testclient import TestClient
from test_console import ACCESS, GOOD, ORIGIN

import kcm
from kincal import tables
from kincal.console.app import Console, make_app
from kincal.console.geometry import Geometry
from kincal.console.picture import MOST_JPEG, Picture
from kincal.console.shelf import Shelf
from kincal.console.sources import Playback, Recording
from kincal.operate.recording import Recorder


@pytest.fixture
def served(tmp_path):
    geometry = Geometry(BIN)
    picture, shelf = Picture(geometry), Shelf(BIN, tmp_path / "made", tmp_path / "read", None)
    console = Console("x", geometry, picture, shelf=shelf)
    return picture, shelf, TestClient(make_app(console, ACCESS), base_url=ORIGIN)


def test_the_newest_frame_is_served_by_its_number_and_the_feed_holds_no_bytes(served):
    picture, _, client = served
    for seq in (1, 2):
        picture.add("KC_IMAGE", image(seq))
    assert client.get("/api/frame/1", headers=GOOD).status_code == 404  # the picture does not grow
    got = client.get("/api/frame/2", headers=GOOD)
    assert got.content == image(0).jpeg and got.headers["content-type"] == "image/jpeg"
    assert client.get("/api/frame/2").status_code in (401, 403)
    assert picture.snapshot()[0]["values"]["KC_IMAGE"]["data"] == {
        "seq": 2, "key": 2, "size_px": [1920, 1080]}  # fmt: skip


@pytest.mark.parametrize("data", [b"<svg onload=alert(1)>", b"", b"\xff\xd8\xff" + b"x" * MOST_JPEG])
def test_what_is_no_jpeg_is_not_served(served, data):
    picture, _, client = served
    picture.add("KC_IMAGE", image(3, data))
    assert client.get("/api/frame/3", headers=GOOD).status_code == 404


def test_a_recording_shows_the_frame_of_the_moment_and_keeps_none_in_memory(tmp_path):
    """Frames have the numbers that they had, also after a restart of flight; they stay in the file."""
    recorder, geometry = Recorder(tmp_path, frame_s=1.0), Geometry(BIN)
    pictures = [image(0).jpeg + bytes([k]) for k in range(4)]
    for k, (seq, data) in enumerate(zip((7, 8, 9, 7), pictures, strict=True)):
        for part in (0.0, 0.4):  # the second of a second is left out
            m = image(seq, data if not part else b"left out")
            m.t_us = int((k + part) * 1e6)
            recorder.take("KC_IMAGE", m.encode(), m.t_us, 10.0 + k + part)
        found = kcm.detection_t()
        found.t_us, found.seq = int(k * 1e6), seq
        recorder.take("KC_DETECTION", found.encode(), found.t_us, 10.0 + k)
    recorder.close()
    recording = Recording.read(recorder.files[0])
    assert [f.seq for f in recording.frames] == [7, 8, 9, 7] and recorder.n_lost == 0
    assert not any(hasattr(m, "jpeg") for _, _, m in recording.messages)
    app = make_app(Console("x", geometry, Picture(geometry), recording=recording), ACCESS)
    client, playback = TestClient(app, base_url=ORIGIN), Playback(recording, geometry)
    for t_s in (3, 0, 2):
        values = playback.seek(t_s * 1_000_000).snapshot()[0]["values"]
        assert values["KC_IMAGE"]["data"]["seq"] == values["KC_DETECTION"]["data"]["seq"]
        key = values["KC_IMAGE"]["data"]["key"]
        assert key == t_s and client.get(f"/api/frame/{key}", headers=GOOD).content == pictures[t_s]
    recorder.files[0].write_bytes(b"somebody else's")
    assert client.get("/api/frame/0", headers=GOOD).status_code == 404
    assert client.get("/api/frame/4", headers=GOOD).status_code == 404


@pytest.mark.parametrize(("frame_s", "kept"), [(0.0, 4), (1.0, 2), (math.inf, 0)])
def test_a_recorder_keeps_as_many_frames_as_it_is_asked_to(tmp_path, frame_s, kept):
    recorder = Recorder(tmp_path, frame_s=frame_s)
    for k in range(4):
        recorder.take("KC_IMAGE", image(k).encode(), k, 10.0 + 0.5 * k)
        recorder.take("KC_HK", kcm.hk_t().encode(), k, 10.0 + 0.5 * k)
    recorder.close()
    assert recorder.n_messages == 4 + kept and recorder.n_lost == 0


def test_candidates_are_those_of_the_table_that_is_named(served):
    _, _, client = served
    crc = tables.load(BIN / "space.tbl")[0].crc_text
    assert client.get("/api/about", headers=GOOD).json()["scene"]["space"] == crc
    found = client.get(f"/api/candidates/{crc}", headers=GOOD).json()
    assert found["candidates_m"] == client.get("/api/about", headers=GOOD).json()["scene"]["candidates_m"]
    for other in ("00000001", "x"):
        assert client.get(f"/api/candidates/{other}", headers=GOOD).status_code == 409


def test_tables_of_the_folder_are_replaced_by_those_in_force_where_they_lie_here(served, tmp_path):
    picture, shelf, _ = served
    shelf.made.mkdir()
    shutil.copy(BIN / "config.tbl", shelf.made / "terms.tbl")  # of another kind: passed over

    class Desk:
        pass

    shelf.desk = Desk()
    shelf.desk.picture, shelf.desk.tables_dir = picture, BIN
    (tmp_path / "flown").write_text("no folder")  # nothing can be written: those of before stay
    shelf.adopt()
    assert shelf.desk.tables_dir == BIN
    (tmp_path / "flown").unlink()
    assert (shelf.flown() / "terms.tbl").read_bytes() == (BIN / "terms.tbl").read_bytes()
