"""The workbench behind the console: files, the case with undo, long work in a process of its own."""

import json
import time
from pathlib import Path

import poses
import pytest
from samples import sealed
from starlette.testclient import TestClient
from test_console import ACCESS, BIN, GOOD, JSON, ORIGIN

import kcm
from kincal import tables
from kincal.console import question
from kincal.console.app import Console, make_app
from kincal.console.bench import Bench
from kincal.console.geometry import Geometry
from kincal.console.picture import Picture
from kincal.console.shelf import Shelf
from kincal.flight import Terms
from kincal_shared.errors import BadInput, CommandFailed


@pytest.fixture
def bench(tmp_path):
    with Bench(tmp_path / "bench") as made:
        yield made


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """An arm and poses of it, as files."""
    folder = tmp_path_factory.mktemp("measured")
    poses.arm_toml(folder / "arm.toml")
    poses.poses_csv(folder / "poses.csv", 60, seed=1)
    return folder


@pytest.fixture
def filled(bench, measured):
    for name in ("arm.toml", "poses.csv"):
        bench.upload(name, (measured / name).read_bytes())
    bench.choose("uploaded: arm.toml", "uploaded: poses.csv")
    return bench


NAMES = [
    "../x.csv", "/etc/x.csv", "a/b.csv", ".x.csv", "", "x", "x.exe", "a\0.csv", "x.csv\n", "<b>.csv", "é.csv",
]  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_a_name_that_leads_elsewhere_is_not_taken(bench, name, tmp_path):
    with pytest.raises(BadInput, match="is not taken"):
        bench.upload(name, b"x")
    assert not list(tmp_path.rglob("*.csv"))


def test_an_upload_never_replaces_another_file(bench):
    bench.upload("a.csv", b"1")
    bench.upload("a.csv", b"1")
    with pytest.raises(BadInput, match="another file a.csv"):
        bench.upload("a.csv", b"2")
    assert (bench.uploads / "a.csv").read_bytes() == b"1"


@pytest.mark.parametrize("name", ["/etc/passwd", "uploaded: ../../x.csv", "folder: x.csv", "shipped: none"])
def test_only_listed_files_can_be_chosen(bench, name):
    with pytest.raises(BadInput, match="no such file"):
        bench.choose(name, "")


def test_links_out_of_the_folder_are_not_listed(tmp_path):
    (tmp_path / "out.csv").write_text("x")
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "link.csv").symlink_to(tmp_path / "out.csv")
    (tmp_path / "in" / "own.csv").write_text("x")
    files = Bench(tmp_path / "bench", tmp_path / "in").files()
    assert [name for name in files if name.startswith("folder")] == ["folder: own.csv"]


def test_effects_can_be_undone_also_after_a_restart(filled):
    filled.effects(["backlash[1]"])
    filled.effects(["backlash[1]", "backlash[2]", "backlash[2]"])
    again = Bench(filled.folder)
    assert again.case.effects == ["backlash[1]", "backlash[2]"]
    again.undo()
    assert again.case.effects == ["backlash[1]"]
    again.undo()
    assert again.case.effects == []
    with pytest.raises(BadInput, match="nothing to undo"):
        again.undo()


def test_another_choice_begins_anew(filled):
    filled.effects(["backlash[1]"])
    filled.choose("shipped: wam", "uploaded: poses.csv")
    assert filled.case.effects == [] and filled.case.past == []


def test_two_choices_in_quick_succession_both_count(filled):
    """Each page sent arm and measurements as it knew them: the second choice undid the first."""
    console = Console("x", Geometry(BIN), None, None, None, filled)
    client = TestClient(make_app(console, ACCESS), base_url=ORIGIN)
    for path, body in (
        ("choose", {"arm": "shipped: wam"}),
        ("choose", {"data": ""}),
        ("choose", {"data": "uploaded: poses.csv"}),
        ("effects", {"effects": ["backlash[1]"], "without": []}),
        ("effects", {"effects": ["backlash[2]"], "without": []}),
        ("effects", {"effects": [], "without": ["backlash[1]"]}),
    ):
        assert client.post(f"/api/bench/{path}", headers=JSON, json=body).json()["ok"]
    case = filled.case
    assert (case.arm, case.data, case.effects) == ("shipped: wam", "uploaded: poses.csv", ["backlash[2]"])


def finished(bench, seconds=60):
    deadline = time.monotonic() + seconds
    while bench.work.job.status == "running":
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return bench.work.job


def test_a_comparison_runs_beside_the_server_and_its_answer_is_kept(filled):
    filled.run("compare")
    with pytest.raises(CommandFailed, match="runs already"):
        filled.run("fit")
    assert finished(filled).status == "done", filled.work.job.text
    answer = Bench(filled.folder).answer("compare")
    assert answer["current"] and "after DH calibration" in answer["text"] and answer["page"]["tiles"]
    filled.effects(["backlash[1]"])
    assert not filled.answer("compare")["current"]


def test_a_cancelled_task_ends_and_leaves_what_was_there(filled):
    filled.run("diagnose")
    process = filled.work._process
    filled.cancel()
    assert process.wait(5) != 0 and filled.work.job.status == "cancelled"
    with pytest.raises(BadInput, match="no answer"):
        filled.answer("diagnose")


def test_a_task_ends_with_the_console(filled):
    filled.run("diagnose")
    process = filled.work._process
    process.stdin.close()  # what the death of the server does
    assert process.wait(20) != 0


def test_what_is_wrong_with_the_data_is_said(filled):
    filled.upload("bad.csv", b"q1,q2\n1,2\n")
    filled.choose("uploaded: arm.toml", "uploaded: bad.csv")
    filled.run("compare")
    assert finished(filled).status == "failed" and "bad.csv" in filled.work.job.text


def test_the_routes_of_the_workbench(filled):
    geometry = Geometry(BIN)
    console = Console("x", geometry, Picture(geometry), None, None, filled)
    client = TestClient(make_app(console, ACCESS), base_url=ORIGIN)
    raw = {**GOOD, "content-type": "application/octet-stream"}
    assert client.post("/api/bench/upload?name=b.csv", headers=raw, content=b"q1\n").json()["ok"]
    assert "uploaded: b.csv" in client.get("/api/bench", headers=GOOD).json()["data"]
    assert client.post("/api/bench/effects", headers=JSON, json={"effects": "x"}).status_code == 400
    body = {"effects": ["backlash[1]"]}
    assert client.post("/api/bench/effects", headers=JSON, json=body).json()["ok"]
    assert client.post("/api/bench/undo", headers=JSON, content=b"{}").json()["ok"]
    assert client.post("/api/bench/run", headers=JSON, json={"what": "rm"}).status_code == 409
    assert client.get("/api/bench/file/fit/M.toml", headers=GOOD).status_code == 409
    for path in ("/api/bench", "/api/bench/answer/fit", "/api/bench/file/fit/M.toml"):
        assert client.get(path, headers={"host": GOOD["host"]}).status_code == 403
    assert json.loads((filled.folder / "case.json").read_text())["effects"] == []


OWN = {
    "effect.name": "odd_coupling", "effect.per": "arm", "parameter.name": "k", "parameter.unit": "rad",
    "parameter.sigma": "5e-3", "term1.at": "joint[3]", "term1.basis": "tanh(q4) * cos(q6)",
}  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "field", "text"),
    [
        ({"term1.basis": "tanh(q4) * cos(q6) * q1"}, "term1.basis", "at most two"),
        ({"term1.basis": "tanhh(q4)"}, "term1.basis", "tanhh"),
        ({"term1.at": "elbow"}, "term1.at", "elbow"),
        ({"term3.at": "link[2]", "term3.basis": "q1", "term3.comp": "xx"}, "term3.comp", "xx"),
        ({"parameter.sigma": "-1"}, "parameter.sigma", "above 0"),
        ({"parameter.sigma": "wide"}, "parameter.sigma", "wide"),
        ({"effect.name": "two words"}, "effect.name", "letters"),
        ({"effect.name": "backlash"}, "effect.name", "ships"),
        ({"effect.per": "leg"}, "effect.per", "arm"),
        ({"term1.at": "", "term1.basis": ""}, "term1.at", "missing"),
        ({"term1.at": "joint[j]"}, "term1.at", "per"),
    ],
)
def test_what_is_wrong_with_an_own_effect_is_said_at_its_field(bench, changes, field, text):
    said = bench.form(OWN | changes)
    assert not said["ok"]
    assert (field, True) in [(p["field"], text in p["text"]) for p in said["problems"]], said["problems"]
    assert not list(bench.folder.rglob("*.toml"))


def test_an_own_effect_is_in_the_library_and_in_a_fit_with_files_to_take_away(filled):
    with pytest.raises(BadInput, match="no effect 'odd_coupling'"):
        filled.effects(["odd_coupling"])
    assert filled.form(OWN)["ok"]
    assert {e["name"] for e in filled.state()["library"] if e["own"]} == {"odd_coupling"}
    filled.effects(["odd_coupling"])
    filled.run("fit")
    assert finished(filled).status == "done", filled.work.job.text
    model = filled.file("fit", "M.toml").read_text("utf-8")
    assert "odd_coupling" in model and str(filled.own) in model
    names = set(filled.answer("fit")["files"])
    assert {"calibrated_arm.py", "calibrated_arm.c", "calibrated_dh.toml", "calibrated_arm.urdf"} <= names
    errors = filled.case.fits[-1]["errors"]
    assert errors[0]["model"] == "nominal" and errors[-1]["mm"] < 0.7 * errors[0]["mm"]
    with pytest.raises(BadInput, match="no such file"):
        filled.file("fit", "../../case.json")


def test_an_effect_that_is_none_or_at_no_joint_is_refused(filled):
    for name, text in (
        ("backlsh[1]", "no effect"),
        ("backlash[9]", "no joint 9"),
        ("base_flex[1]", "whole arm"),
    ):
        with pytest.raises(BadInput, match=text):
            filled.effects([name])
    assert filled.case.effects == []


def test_next_poses_separate_alternatives(filled):
    with pytest.raises(BadInput, match="two or more"):
        filled.run("next", ["backlash[1]"])
    filled.run("next", ["backlash[1]", "encoder_gain[1]"])
    assert finished(filled).status == "done", filled.work.job.text
    assert len(filled.file("next", "next_poses.csv").read_text().splitlines()) == 3 + 8


def test_a_model_becomes_a_terms_table_of_the_tables_that_fly(filled, tmp_path):
    shelf = Shelf(BIN, tmp_path / "made", tmp_path / "read", None)
    with pytest.raises(BadInput, match="no answer"):
        question.uplink(filled, shelf, [])
    filled.effects(["backlash[1]"])
    filled.run("fit")
    assert finished(filled).status == "done", filled.work.job.text
    said = question.uplink(filled, shelf, [])
    assert said["effects"] == ["backlash[1]"]
    image, struct = tables.load(tmp_path / "made" / "terms.tbl")
    assert image.crc_text == said["crc"] and "backlash[1]" in list(Terms.of_table(struct).names)
    assert shelf.row("TERMS")["made"] == said["crc"] and (BIN / "terms.tbl").read_bytes() != image.data
    filled.effects([])
    with pytest.raises(BadInput, match="fit once more"):
        question.uplink(filled, shelf, [])


def test_the_measurements_of_a_correction_become_the_case(filled):
    picture = Picture(Geometry(BIN))
    with pytest.raises(BadInput, match="not heard"):
        question.take(filled, picture, "00000001")
    assert filled.case.arm == "uploaded: arm.toml"
    proposal = kcm.proposal_t()
    proposal.crc, proposal.session, proposal.n_coef = 7, 3, 1
    picture.add("KC_PROPOSAL", sealed(proposal))
    for number in range(1, 4):
        meas = kcm.meas_t()
        meas.session, meas.observation, meas.pose, meas.n_joints = 3, number, number, 7
        picture.add("KC_MEAS", meas)
    said = question.take(filled, picture, "00000007")
    assert "correction 00000007" in said["text"]
    assert filled.case.arm in ("uploaded: arm.toml", "shipped: wam")
    assert filled.case.data == "uploaded: correction-00000007.lcmlog"
    assert filled.work.job.what == "diagnose"
    with pytest.raises(CommandFailed, match="runs already"):
        question.take(filled, picture, "00000007")


@pytest.mark.parametrize("what", ["full medium", "folder", "link that leads nowhere"])
def test_an_upload_that_cannot_be_kept_is_said_and_leaves_nothing(bench, what, monkeypatch):
    """A full medium ended the request with a traceback, and half of the file stayed."""
    bench.uploads.mkdir(parents=True, exist_ok=True)
    if what == "folder":
        (bench.uploads / "m.csv").mkdir()
    elif what == "link that leads nowhere":
        (bench.uploads / "m.csv").symlink_to("/nowhere/at/all")
    before = sorted(bench.uploads.iterdir())
    whole = Path.write_bytes

    def half(path, data):
        whole(path, data[:3])
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as m:
        if what == "full medium":
            m.setattr(Path, "write_bytes", half)
        with pytest.raises((BadInput, CommandFailed), match="was not kept|another file"):
            bench.upload("m.csv", b"1,2,3")
    assert sorted(bench.uploads.iterdir()) == before


def test_a_model_has_no_more_effects_than_anybody_reads(bench):
    with pytest.raises(BadInput, match="no names of effects"):
        bench.effects(["a"] * 100_000)


def test_what_the_medium_refuses_is_an_answer(filled, monkeypatch):
    def full():
        raise OSError(28, "No space left on device", "case.part")

    monkeypatch.setattr(filled, "write", full)
    geometry = Geometry(BIN)
    app = make_app(Console("x", geometry, Picture(geometry), None, None, filled), ACCESS)
    answer = TestClient(app, base_url=ORIGIN).post(
        "/api/bench/effects", headers=JSON, json={"effects": ["backlash[1]"]}
    )
    assert answer.status_code == 507 and "No space left on device: case.part" in answer.json()["text"]
