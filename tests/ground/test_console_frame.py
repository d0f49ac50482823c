"""The camera's frame and the candidates in force, as the console has them."""

import shutil
from pathlib import Path

import pytest
from starlette.testclient import TestClient
from test_console import ACCESS, GOOD, ORIGIN

import kcm
from kincal import tables
from kincal.console.app import Console, make_app
from kincal.console.geometry import Geometry
from kincal.console.picture import MOST_JPEG, Picture
from kincal.console.shelf import Shelf

BIN = Path(__file__).resolve().parents[2] / "tables" / "bin"
JPEG = b"\xff\xd8\xff" + b"x" * 100


def image(seq, data=JPEG):
    m = kcm.image_t()
    m.t_us, m.seq, m.width_px, m.height_px, m.n_bytes, m.jpeg = seq * 1000, seq, 1920, 1080, len(data), data
    return m


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
    assert got.content == JPEG and got.headers["content-type"] == "image/jpeg"
    assert client.get("/api/frame/2").status_code in (401, 403)
    assert picture.snapshot()[0]["values"]["KC_IMAGE"]["data"] == {"seq": 2, "size_px": [1920, 1080]}


@pytest.mark.parametrize("data", [b"<svg onload=alert(1)>", b"", b"\xff\xd8\xff" + b"x" * MOST_JPEG])
def test_what_is_no_jpeg_is_not_served(served, data):
    picture, _, client = served
    picture.add("KC_IMAGE", image(3, data))
    assert client.get("/api/frame/3", headers=GOOD).status_code == 404


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
