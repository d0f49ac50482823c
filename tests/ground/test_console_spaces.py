"""Search spaces behind the console: why a candidate is in, the description in a form, build, check, send."""

import re
import shutil
import time

import pytest
from fake_flight import FakeFlight
from places import BIN
from starlette.testclient import TestClient
from test_console import ACCESS, GOOD, JSON, ORIGIN

from kincal import space
from kincal.console.app import Console, make_app
from kincal.console.desk import Desk
from kincal.console.geometry import Geometry
from kincal.console.picture import Picture
from kincal.console.shelf import Shelf
from kincal.console.sources import Live
from kincal.console.spaces import Spaces
from kincal_shared import keys
from kincal_shared.errors import BadInput, CommandFailed
from kincal_shared.schema.edit import changed, value_text

# few of everything: a second instead of minutes
SMALL = {
    "candidates": "2", "samples": "60", "seed": "5", "initial_poses": "1", "stops.most": "0",
    "clear.servo_bound_samples": "10", "clear.step_rad": "0.2", "error_bounds.draws": "1",
    "error_bounds.case": "[]", "joints.reserve": "[]",
    "joints.local_initial_rad": "[[-0.8, 0.52, 0.03, 0.79, -0.14, 0.24, -1.55]]",
    "joints.hubs_rad": "[[-0.8, 0.52, 0.03, 0.79, -0.14, 0.24, -1.55], [0.9, -0.3, 0.0, 2.0, 0.0, 0.0, 0.0]]",
}  # fmt: skip


@pytest.fixture
def spaces(tmp_path):
    shelf = Shelf(BIN, tmp_path / "made", tmp_path / "read", None)
    with Spaces(tmp_path / "space", shelf, Geometry(BIN)) as made:
        yield made


def finished(spaces, seconds=120):
    deadline = time.monotonic() + seconds
    while spaces.work.job.status == "running":
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return spaces.work.job


def test_a_candidate_is_explained_with_the_arm_there(spaces):
    rows = spaces.candidates("folder")
    _, table = space.SpaceTable.load(BIN / "space.tbl")
    assert len(rows["rows"]) == table.n_candidates
    found = spaces.explain(17, "folder")
    assert found["good"] and "joint limits" in [row[0]["text"] for row in found["grid"]["rows"]]
    assert found["points_m"][-1] == pytest.approx(rows["rows"][17]["p_m"], abs=2e-4)
    with pytest.raises(BadInput, match=r"0\.\.299"):
        spaces.explain(99999, "folder")
    with pytest.raises(BadInput, match="no such table"):
        spaces.candidates("../keys")


def test_a_value_is_changed_in_the_text_and_comments_stay():
    source = (BIN.parent / "src" / "space.toml").read_text("utf-8")
    after = changed(source, "view.incid_max_rad", '"50*deg"')
    assert 'incid_max_rad = "50*deg" # 50 deg, of those tags' in after
    assert len(after.splitlines()) == len(source.splitlines())
    hubs = changed(source, "joints.hubs_rad", "[[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]")
    assert value_text(hubs, "joints.hubs_rad") == "[[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]"
    assert value_text(hubs, "joints.servo_bound_rad") == value_text(source, "joints.servo_bound_rad")
    assert value_text(changed("a = 1\n", "stops.most", "2"), "stops.most") == "2"
    for bad in ("1\ny = 2", "]", "", "1 # x\n[view]\ntags_min = 4"):
        with pytest.raises(BadInput):
            changed(source, "seed", bad)


def test_every_field_of_the_form_can_be_written_back_unchanged(spaces):
    form = spaces.form()
    before = form.file.read_text("utf-8")
    fields = [f for s in form.sections() for f in s["fields"]]
    assert {"view.tag_min_px", "joints.hubs_rad", "error_bounds.case"} <= {f["path"] for f in fields}
    assert all(f["about"] for f in fields)
    assert form.change({f["path"]: f["text"] for f in fields if f["given"]}) == []
    assert form.file.read_text("utf-8").split() == before.split()


def test_errors_are_named_at_their_fields_and_nothing_is_half_taken(spaces):
    before = spaces.form().file.read_text("utf-8")
    wrong = {"view.tag_min_px": "-3", "tool.box_min_m": "[1, 2]", "seed": "7", "joints.reserve": "[99]",
             "view.incid_max_rad": "50", "samples": "many", "clear.step_rad": ""}  # fmt: skip
    said = spaces.change(wrong)
    assert not said["ok"] and {"clear.step_rad"} == {p["field"] for p in said["problems"]}
    said = spaces.change({k: v for k, v in wrong.items() if v})
    fields = {p["field"]: p["text"] for p in said["problems"]}
    assert set(fields) == {k for k, v in wrong.items() if v} - {"seed"}
    assert "must be 0 or more" in fields["view.tag_min_px"] and "degrees" in fields["view.incid_max_rad"]
    assert spaces.form().file.read_text("utf-8") == before
    with pytest.raises(BadInput, match="no field"):
        spaces.change({"shape": "[]"})
    assert spaces.change({"view.incid_max_rad": "40*deg"})["ok"]
    assert spaces.begin_anew()["ok"] and spaces.form().file.read_text("utf-8") == before


def test_a_file_that_somebody_broke_is_named_and_can_be_begun_anew(spaces):
    file = spaces.form().file
    file.write_text(file.read_text("utf-8") + "\n[view\n", "utf-8")
    assert spaces.state()["wrong"] == 1
    assert "not valid TOML" in spaces.description()["problems"][0]["text"]
    said = spaces.change({"seed": "7"})
    assert not said["ok"] and "not valid TOML" in said["problems"][0]["text"]
    with pytest.raises(BadInput, match="description is wrong"):
        spaces.run("build", "folder")
    assert spaces.begin_anew()["ok"] and spaces.state()["wrong"] == 0


def test_a_space_is_built_checked_and_compared_in_a_process_of_its_own(spaces, tmp_path):
    assert spaces.change(SMALL)["ok"]
    spaces.run("build", "folder")
    spaces.change({"seed": "6"})  # the description that was begun with counts
    with pytest.raises(CommandFailed, match="runs already"):
        spaces.run("check", "folder")
    assert finished(spaces).status == "done", spaces.work.job.text
    crc = spaces.answer("build")["crc"]
    desc = space.read_description(tmp_path / "made" / "space.toml")
    assert desc.seed == 5 and crc == space.build(desc, BIN).image.crc_text == spaces.state()["tables"]["made"]
    assert len(spaces.candidates("made")["rows"]) == 2 and spaces.explain(0, "made")["good"]
    found = spaces.difference("folder", "made")
    assert not found["same"] and len(found["new_m"]) == 2 and len(found["gone_m"]) == 300
    spaces.run("check", "made")
    assert finished(spaces).status == "done", spaces.work.job.text
    answer = spaces.answer("check")
    assert answer["good"] and answer["key"] == {"crc": crc}


def test_a_build_that_is_cancelled_leaves_no_table_and_a_wrong_description_is_not_begun(spaces):
    spaces.run("build", "folder")
    process = spaces.work._process
    spaces.work.cancel()
    assert process.wait(10) != 0
    assert finished(spaces).status == "cancelled" and not spaces.state()["tables"]["made"]
    file = spaces.form().file
    file.write_text(re.sub(r"tags_min .*", "tags_min = 9", file.read_text()))
    with pytest.raises(BadInput, match="description is wrong"):
        spaces.run("build", "folder")
    assert spaces.state()["wrong"] == 1


def test_the_routes_and_a_space_that_was_built_is_sent_and_read_back(tmp_path):
    keys.new(tmp_path / "keys")
    geometry = Geometry(BIN)
    made = tmp_path / "made"
    made.mkdir()
    shutil.copy(BIN / "space.tbl", made / "space.tbl")
    shutil.copy(BIN.parent / "src" / "space.toml", made / "space.toml")
    with FakeFlight() as flight:
        picture = Picture(geometry)
        desk = Desk(flight.url, tmp_path / "keys", None, BIN, picture, timeout_s=10.0)
        shelf = Shelf(BIN, made, tmp_path / "read", desk)
        with Spaces(tmp_path / "space", shelf, geometry) as spaces, Live(flight.url, picture):
            console = Console(flight.url, geometry, picture, desk, shelf=shelf, spaces=spaces)
            client = TestClient(make_app(console, ACCESS), base_url=ORIGIN)
            state = client.get("/api/space", headers=GOOD).json()
            crc = state["tables"]["made"]
            assert crc == state["tables"]["crc"] and state["wrong"] == 0
            assert client.get("/api/space", headers={}).status_code in (401, 403)
            assert client.post("/api/space/run", headers=JSON, json={"what": "rm"}).status_code == 409
            assert client.post("/api/space/description", headers=JSON, json={"values": []}).status_code == 400
            assert client.get("/api/space/answer/..%2Fx", headers=GOOD).status_code in (404, 409)
            assert client.get("/api/space/file/keys", headers=GOOD).status_code == 409
            file = client.get("/api/space/file/space.tbl", headers=GOOD).content
            assert file == (made / "space.tbl").read_bytes()
            words = {"by": "A", "why": "b", "crc": crc, "of": "made", "number": "1"}
            said = client.post("/api/tables/SPACE/send", headers=JSON, json=words).json()
            assert said["ok"], said
            assert client.post("/api/tables/SPACE/read", headers=JSON, json={"number": "2"}).json()["ok"]
            found = client.get("/api/space/difference?of=made&to=read", headers=GOOD).json()
            assert found["same"]
            words |= {"of": "read", "number": "3"}
            assert client.post("/api/tables/SPACE/send", headers=JSON, json=words).status_code == 409
