"""Tables behind the console: values, read back, difference, send, explain."""

import re
import shutil
import time

import pytest
from fake_flight import FakeFlight
from places import BIN
from starlette.testclient import TestClient
from test_console import ACCESS, GOOD, JSON, ORIGIN

import kcm
from kincal.console import shelf
from kincal.console.app import Console, make_app
from kincal.console.desk import Desk
from kincal.console.geometry import Geometry
from kincal.console.picture import Picture
from kincal.console.shelf import Shelf
from kincal.console.sources import Live
from kincal.flight.tables import encode
from kincal.review import journal
from kincal.tables import build, load
from kincal_shared import keys


@pytest.fixture
def folder(tmp_path):
    out = tmp_path / "tables"
    shutil.copytree(BIN, out)
    return out


@pytest.fixture
def served(folder, tmp_path):
    """A console, its flight process and its key file."""
    keys.new(tmp_path / "keys")
    geometry = Geometry(folder)
    with FakeFlight() as flight:
        picture = Picture(geometry)
        desk = Desk(flight.url, tmp_path / "keys", None, folder, picture, timeout_s=5.0)
        shelf = Shelf(folder, tmp_path / "made", tmp_path / "read", desk)
        console = Console(flight.url, geometry, picture, desk, shelf=shelf)
        with Live(flight.url, picture), TestClient(make_app(console, ACCESS), base_url=ORIGIN) as client:
            yield client, flight, tmp_path / "keys", desk


def get(client, path):
    return client.get(path, headers=GOOD)


def post(client, path, **body):
    return client.post(path, headers=JSON, json=body)


def test_every_kind_is_listed_with_its_crc_and_a_damaged_one_is_named(served, folder):
    client, *_ = served
    assert {row["kind"] for row in get(client, "/api/tables").json() if row["crc"]} == {
        "ARM", "CAMERA", "TERMS", "KIN", "SPACE", "KERNEL", "CONFIG"}  # fmt: skip
    (folder / "config.tbl").write_bytes(b"damaged")
    config = next(row for row in get(client, "/api/tables").json() if row["kind"] == "CONFIG")
    assert not config["crc"] and config["trouble"]


def test_values_are_those_of_the_source(served):
    client, *_ = served
    rows = get(client, "/api/tables/CONFIG/values").json()["grid"]["rows"]
    assert ["n_poses", "20"] in [[c["text"] for c in row] for row in rows]
    space = get(client, "/api/tables/SPACE/values").json()["grid"]
    assert len(space["rows"]) == 1500 and "more fields" in space["note"]


@pytest.mark.parametrize("kind", ["..%2Fkeys", "NONE", "config.tbl", "%00"])
def test_no_other_file_is_read(served, kind):
    client, *_ = served
    for what in ("values", "difference"):
        assert get(client, f"/api/tables/{kind}/{what}").status_code in (404, 409)


def test_a_table_is_sent_read_back_and_compared(served, folder):
    client, flight, key_file, _ = served
    crc = {row["kind"]: row["crc"] for row in get(client, "/api/tables").json()}["CONFIG"]
    words = {"by": "A", "why": "new plan", "crc": crc}
    assert post(client, "/api/tables/CONFIG/send", number="1", **(words | {"by": ""})).status_code == 409
    assert post(client, "/api/tables/CONFIG/send", number="2", **(words | {"crc": "0"})).status_code == 409
    assert flight.commands == []
    assert post(client, "/api/tables/CONFIG/send", number="3", **words).json()["ok"]
    again = post(client, "/api/tables/CONFIG/send", number="3", **words).json()
    assert again["again"] and [o for o, _ in flight.commands].count(kcm.cmd_t.TABLE_ACTIVATE) == 1
    assert post(client, "/api/tables/CONFIG/read", number="4").json()["ok"]
    assert get(client, "/api/tables/CONFIG/difference").json()["n"] == 0
    changed = folder.parent / "config.toml"
    source = (BIN.parent / "src" / "config.toml").read_text("utf-8")
    changed.write_text(re.sub(r"n_poses( *)= 20", r"n_poses\1= 12", source), "utf-8")
    (folder / "config.tbl").write_bytes(build(changed).data)
    found = get(client, "/api/tables/CONFIG/difference").json()
    assert found["n"] == 1
    assert [c["text"] for c in found["grid"]["rows"][0]] == ["n_poses", "12", "20"]
    lines = journal.read(journal.place(None, key_file)).entries
    assert [(e.words, e.by, e.crc) for e in lines] == [
        ("attempt: put the CONFIG table in force", "A", crc),
        ("CONFIG table put in force", "A", crc),
        ("attempt: read back the CONFIG table", "console", crc),
        ("CONFIG table read back", "console", crc),
    ]
    shown = get(client, "/api/journal").json()
    assert [e["text"] for e in shown] == [e.words for e in reversed(lines)]


def test_a_table_that_flight_refuses_is_written_as_refused(served):
    client, flight, key_file, _ = served
    flight.refuse = (kcm.cmd_t.TABLE_VALIDATE,)
    crc = {row["kind"]: row["crc"] for row in get(client, "/api/tables").json()}["CONFIG"]
    refused = post(client, "/api/tables/CONFIG/send", number="1", by="A", why="new plan", crc=crc)
    assert refused.status_code == 409 and "TABLE_VALIDATE refused" in refused.json()["text"]
    last = journal.read(journal.place(None, key_file)).entries[-1]
    assert (last.decision, last.kind) == ("refused", "CONFIG") and "TABLE_VALIDATE refused" in last.why


def test_names_and_limits_follow_a_table_that_was_made_here_and_sent(served, folder, tmp_path):
    client, _, _, desk = served
    image, struct = load(folder / "terms.tbl")
    struct.coef[0].ub *= 0.9
    made = encode("terms", struct)
    (tmp_path / "made").mkdir()
    (tmp_path / "made" / "terms.tbl").write_bytes(made.data)
    assert made.crc != image.crc
    words = {"by": "A", "why": "b", "crc": made.crc_text, "of": "made", "number": "1"}
    assert post(client, "/api/tables/TERMS/send", **words).json()["ok"]
    deadline = time.monotonic() + 10
    while True:  # until housekeeping says so to the console
        rows = {row["kind"]: row for row in get(client, "/api/tables").json()}
        if load(tmp_path / "flown" / "terms.tbl")[0].crc == made.crc or time.monotonic() > deadline:
            break
    assert rows["TERMS"]["made"] == made.crc_text != rows["TERMS"]["crc"]
    assert load(tmp_path / "flown" / "terms.tbl")[0].crc == made.crc
    assert load(tmp_path / "flown" / "arm.tbl")[0].crc == load(folder / "arm.tbl")[0].crc
    assert desk.tables_dir == tmp_path / "flown" and desk.picture.geometry.crcs["TERMS"] == made.crc
    found = get(client, "/api/tables/TERMS/difference?of=folder&to=made").json()
    assert [c["text"] for c in found["grid"]["rows"][0]][0] == "coef[J1.phi_rad].ub"


def test_a_kinematics_table_is_not_sent_past_the_review(served):
    client, flight, *_ = served
    crc = {row["kind"]: row["crc"] for row in get(client, "/api/tables").json()}["KIN"]
    refused = post(client, "/api/tables/KIN/send", number="1", by="A", why="b", crc=crc)
    assert refused.status_code == 409 and "reviewed" in refused.json()["text"]
    assert flight.commands == []


def test_what_is_staged_is_put_in_force_alone_and_only_if_flight_has_checked_it(served):
    """Somebody else has sent it: with two holders the second person only activates."""
    client, flight, key_file, desk = served
    image = load(BIN / "config.tbl")[0]
    words = {"by": "B. Second", "why": "agreed", "crc": image.crc_text}
    nothing = post(client, "/api/tables/CONFIG/activate", number="1", **words)
    assert nothing.status_code == 409 and "a staged config table" in nothing.json()["text"].lower()
    flight.staged = (7, image.data)
    until(lambda: desk.picture.newest("KC_HK").staged_kind == 7)
    early = post(client, "/api/tables/CONFIG/activate", number="2", **words).json()["text"]
    assert "that flight has checked" in early and f"validate config {image.crc_text}" in early
    flight.checked = 3
    until(lambda: desk.picture.newest("KC_HK").staged_state == 3)
    assert post(client, "/api/tables/CONFIG/activate", number="3", **(words | {"by": ""})).status_code == 409
    assert post(client, "/api/tables/KIN/activate", number="4", **words).status_code == 409
    assert flight.commands == []
    done = post(client, "/api/tables/CONFIG/activate", number="5", **words).json()
    assert done["ok"] and [s["stage"] for s in done["steps"]] == ["sent", "received", "accepted", "done"]
    assert [o for o, _ in flight.commands] == [kcm.cmd_t.TABLE_ACTIVATE]  # nothing is sent again
    lines = journal.read(journal.place(None, key_file)).entries
    crc = image.crc_text
    assert [(e.decision, e.crc) for e in lines] == [("attempt", crc), ("table_activate", crc)]


def until(what, seconds=20.0):
    deadline = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_values_that_differ_in_their_last_digits_are_not_shown_as_the_same():
    assert shelf._differing(0.11, 0.11000000000000001) == ("0.11", "0.11 (+1e-17)")
    assert shelf._differing(0.1, 0.2) == ("0.1", "0.2") and shelf._differing(None, 2.0) == ("absent", "2")
