"""Clearance and reach with a correction. Oracles: MuJoCo's distances of two geoms (GJK, not its contacts) at
the joints where the corrected arm stands, and its own kinematics."""

import io
import json
import math
import shutil
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from commands import good
from direct_flight import DirectFlight
from places import BIN
from rich.console import Console
from samples import decided, proposal, shipped, signed, write_log
from test_changes import kin_image

import kcm
from kincal import space
from kincal.api import corrected, previews, reviews
from kincal.cli.text import review as text
from kincal.console.clearances import Clearances, Found
from kincal.console.desk import Desk, Words
from kincal.console.geometry import Geometry
from kincal.console.picture import Picture
from kincal.console.shelf import Shelf
from kincal.flight import Terms, library
from kincal.flight.tables import decode, decode_as, kinds
from kincal.pages import image
from kincal.review import decisions, from_message, journal, kin_crc, reasons_to_reject, record
from kincal.review.changes import KinValues
from kincal.space.mjcf import ArmModel
from kincal_shared.errors import BadInput, CommandFailed
from kincal_shared.keys import signer_of

SOURCE = BIN.parent / "src" / "space.toml"
DESC = space.read_description(SOURCE)
# the named case of space.toml
WORST = {"J7.phi_rad": 1.3, "J2.alpha_rad": 0.4, "J3.a_m": 0.01, "J3.d_m": 0.15}


def values(errors):
    terms = Terms.of_table(decode_as("terms", (BIN / "terms.tbl").read_bytes(), "terms")[1])
    return [errors.get(name, 0.0) for name in terms.names]


@pytest.fixture(scope="module")
def given():
    return space.TablesFolder(BIN)


@pytest.fixture(scope="module")
def beyond():
    """A tenth beyond the errors that the space was verified for, as TERMS allows."""
    return corrected.between((), values({k: 1.1 * x for k, x in WORST.items()}), BIN)


class Distances:
    """All pairs of an arm, by MuJoCo's distance function."""

    def __init__(self, given, errors):
        built = ArmModel(DESC, given.arm, given.camera, errors)
        self.model = mujoco.MjModel.from_xml_string(built.xml(0.0, 0.0))
        self.data = mujoco.MjData(self.model)
        self.pairs = list(zip(self.model.pair_geom1, self.model.pair_geom2, strict=True))

    def least(self, q):
        self.data.qpos[:] = q
        mujoco.mj_kinematics(self.model, self.data)
        return min(mujoco.mj_geomDistance(self.model, self.data, a, b, 1.0, None) for a, b in self.pairs)

    def tool(self, q):
        self.data.qpos[:] = q
        mujoco.mj_kinematics(self.model, self.data)
        body = self.model.body("tool").id
        return self.data.xpos[body].copy(), self.data.xmat[body].reshape(3, 3).copy()


def test_distances_are_those_of_the_arm_as_the_table_has_it(given):
    """Errors of joint angles alone: the corrected arm at q stands as the nominal one at q plus errors."""
    off = np.array([0.05, -0.08, 0.1, 0.07, -0.1, 0.12, 0.9])
    errors = {f"J{j + 1}.phi_rad": x for j, x in enumerate(off)}
    arm = space.CorrectedArm(DESC, given.arm, given.camera, errors, corrected.HORIZON_M)
    nominal = Distances(given, {})
    for q in given.space.q_rad[::25]:
        assert arm.nearest(q)[0] == pytest.approx(nominal.least(q + off), abs=2e-4)


def test_the_worst_place_is_named_with_its_distance(given, beyond):
    (c,) = [c for c in beyond.clear if c.what == "verified segments"]
    assert c == beyond.worst and c.after.distance_m < 0.0 < c.before.distance_m
    hub, candidate = (int(x) for x in c.after.place.replace("segment hub ", "").split(" to candidate "))
    a, b = given.space.hub_q_rad[hub], given.space.q_rad[candidate]
    errors = {k: 1.1 * x for k, x in WORST.items()}
    postures = [a + (b - a) * s for s in np.linspace(0.0, 1.0, 200)]
    dense = min(map(Distances(given, errors).least, postures))
    # verified every 0.1 rad: between two postures nothing comes nearer by more than half a step at the tool
    assert dense - 2e-4 <= c.after.distance_m < dense + 0.03
    assert c.after.pair == "forearm_offset - mast"


def test_a_segment_nearer_than_the_margin_is_a_reason_against(beyond):
    (reason,) = beyond.reasons
    assert "verified segments" in reason.what and "forearm_offset - mast" in reason.what
    assert reason.threshold == "at least 10 mm" and reason.number == "-21.7 mm"
    inside = corrected.between((), values(WORST), BIN)
    # what SPACE was verified for
    assert not inside.reasons and inside.worst.after.distance_m > inside.margin_m
    review = from_message(proposal(), [])
    shown, changes, stands_out = reviews.with_clearance(review, reviews.what_changes(review, BIN), beyond)
    assert reason in changes.reasons and reason.text in stands_out
    assert reasons_to_reject(shown) == [reason.text] and reasons_to_reject(review) == []


def test_what_loses_sight_of_the_tags_is_to_be_looked_at_and_no_reason_against(beyond):
    stops = beyond.reach[2]
    now = replace(stops, before={"stop 1": "a"}, after={"stop 1": "a", "stop 2": "sees 0 tags"})
    found = replace(beyond, reach=(now,))
    assert found.look_at == (f"1 of {stops.of} stops along segments no longer with tags in view: "
                             "stop 2: sees 0 tags",)  # fmt: skip
    assert found.reasons == beyond.reasons


def test_candidates_that_are_lost_are_those_that_the_servo_cannot_reach(given, beyond):
    """Joints that it finds lead to the pose, by MuJoCo's kinematics; of those that it does not, none are
    found near the bound by many starts either."""
    errors = {k: 1.1 * x for k, x in WORST.items()}
    arm = space.CorrectedArm(DESC, given.arm, given.camera, errors, corrected.HORIZON_M)
    reach, model, table = beyond.reach[0], Distances(given, errors), given.space
    assert not reach.before
    lost = [int(name.split()[1]) for name, why in reach.after.items() if "beyond its servo bound" in why]
    assert 50 < len(lost) < 150
    for i in set(range(0, 300, 20)) - set(lost):
        q, problem = arm.servo(table.q_rad[i], table.poses[i], table.servo_bound_rad)
        p_m, R = model.tool(q)
        assert not problem and np.all(np.abs(q - table.q_rad[i]) <= table.servo_bound_rad + 1e-9)
        assert np.linalg.norm(p_m - table.p_m[i]) < 2.1e-3
        assert np.trace(R.T @ table.poses[i].R) > 3.0 - 5e-5
    for i in lost[:4]:
        q, _ = arm.servo(table.q_rad[i], table.poses[i], 2.0 * table.servo_bound_rad)
        over = np.abs(q - table.q_rad[i]) - table.servo_bound_rad
        assert np.max(over) > 0.0


def test_nothing_changes_without_a_change():
    same = corrected.between((), values({}), BIN)
    assert [c.before for c in same.clear] == [c.after for c in same.clear]
    assert not any(r.lost or r.won for r in same.reach) and "no pose is lost" in same.headline
    assert corrected.Corrected.of_dict(json.loads(json.dumps(same.as_dict()))) == same


def test_what_cannot_be_known_is_said(tmp_path, beyond):
    """Effects that are no DH errors, tables that are not there, a description of another space."""
    assert beyond.left_out_m < 1e-6 and beyond.notes == (beyond.source,)
    assert str(BIN) in beyond.source and str(SOURCE) in beyond.source
    moved = corrected.between(None, values({"base.tx_m": 0.02}), BIN)
    assert moved.left_out_m == pytest.approx(0.02, abs=1e-6)
    assert "not at hand" in moved.notes[1] and "move the tool by up to 20.00 mm" in moved.notes[2]
    for kind in ("arm", "camera", "terms"):
        (tmp_path / f"{kind}.tbl").write_bytes((BIN / f"{kind}.tbl").read_bytes())
    with pytest.raises(BadInput, match="has no space table"):
        corrected.between((), values({}), tmp_path)
    other = tmp_path / "other.toml"
    hub = "[0.9, -0.3, 0.0, 2.0, 0.0, 0.0, 0.0]"
    other.write_text(SOURCE.read_text().replace(hub, hub.replace("0.9", "0.8", 1)))
    with pytest.raises(BadInput, match="not the description of the SPACE table"):
        corrected.between((), values({}), BIN, other)


BEYOND = {k: 1.1 * x for k, x in WORST.items()}
NEAR = "clearance of verified segments (forearm_offset - mast, segment hub 2 to candidate 56)"


@pytest.fixture
def too_near(tmp_path, monkeypatch):
    """The log of a correction that brings the arm too near to something, and it."""
    monkeypatch.setattr(image, "beside", lambda files, _figures: (files, ""))  # a picture takes seconds
    log, p = tmp_path / "run.lcmlog", shipped(proposal(), values(BEYOND))
    write_log(log, waiting=p)
    return log, p


def shown(log, *more):
    words = ["review", "show", str(log), "--tables", str(BIN), "--before", str(BIN), *more]
    run = good(*words, env={"COLUMNS": "200"})
    return run.stdout


def in_force(**other):
    """`table_crc` of KC_HK for the tables as shipped, but for others."""
    crcs = [0] * 8
    for kind, number in kinds().items():
        crcs[number] = decode((BIN / f"{kind}.tbl").read_bytes())[0].crc if number else 0
        crcs[number] = other.get(kind, crcs[number])
    return crcs


def test_show_says_it_as_text_as_json_and_on_the_page(tmp_path, too_near):
    """Among the reasons to reject it, in the same words everywhere."""
    log, p = too_near
    text = shown(log, "--picture", str(tmp_path / "p.svg"))
    assert "Clearance: at least 10.00 mm (SPACE" in text and "Reach and view" in text
    assert f"reason to reject: {NEAR}" in text and f"against it: {NEAR}" in text
    assert "Computed with the tables of" in text and "--override REASON" in text
    page = (tmp_path / "p.html").read_text()
    assert "Clearance with the new table" in page and "Reach and view with the new table" in page
    assert "only an override, with a reason, approves it" in page and f"Reason to reject: {NEAR}" in page
    found = json.loads(shown(log, "--json"))
    assert found["crc"] == f"{p.crc & 0xFFFFFFFF:08x}" and found["numbers"]["rank"] == p.rank
    assert {c["what"] for c in found["clearance"]["clear"]} >= {"park pose", "verified segments"}
    assert found["clearance"]["headline"] and found["clearance_unknown"] == ""
    (reason,) = found["reasons_to_reject"]
    assert reason.startswith(NEAR) and reason.endswith("is -21.7 mm, has to be at least 10 mm")
    assert found["clearance"]["reasons"] == [reason] and reason in found["look_at"]


def test_an_approval_of_what_comes_too_near_takes_an_override_that_the_journal_keeps(too_near, own_key_file):
    log, p = too_near
    text, signer = f"{p.crc & 0xFFFFFFFF:08x}", signer_of(own_key_file)
    shown(log, "--json", "--by", "A", "--keys", str(own_key_file))
    file = journal.place(None, own_key_file)
    (seen,) = journal.read(file, signer.known).entries
    assert seen.against[0].startswith(NEAR) and seen.against[0] in seen.why
    said = reviews.known([journal.read(file)], p.crc & 0xFFFFFFFF, seen.verdict)
    assert (said.reasons, said.override, said.broken) == (seen.against, "", "")
    flight = DirectFlight(signer).waits(p.crc & 0xFFFFFFFF)
    who = decisions.Operator("A", "why", file)
    with pytest.raises(BadInput, match=r"reasons to reject correction .*forearm_offset - mast"):
        decisions.arm(flight, text, who)
    assert flight.commands == []
    decisions.arm(flight, text, who, "the mast is folded")
    assert list(flight.commands[0].arg_i[:2]) == [p.crc, decisions.OVERRIDE]
    decisions.go(flight, text, who)
    lines = decided(journal.read(file, signer.known).entries)
    assert [(e.decision, e.override, e.against) for e in lines] == [
        ("seen", "", seen.against),
        ("arm", "the mast is folded", seen.against),
        ("approve", "the mast is folded", seen.against),
    ]


def test_what_one_person_knows_of_the_clearance_counts_for_everybody(too_near, own_key_file):
    """A. saw the correction where clearance was not known, B. where it was: neither is asked to trust A."""
    _, p = too_near
    text, signer, file = (
        f"{p.crc & 0xFFFFFFFF:08x}",
        signer_of(own_key_file),
        journal.place(None, own_key_file),
    )
    plain = from_message(p, [])
    flight = DirectFlight(signer).waits(plain.crc)
    a, b = (decisions.Operator(name, "why", file) for name in "AB")
    decisions.see(file, plain, "A", Path("run.lcmlog"), signer)
    decisions.arm(flight, text, a)
    decisions.see(file, replace(plain, against=("too near",)), "B", Path("run.lcmlog"), signer)
    for who in (a, b):
        with pytest.raises(BadInput, match="the first step overrides nothing.*too near"):
            decisions.go(flight, text, who)
    flight.hk.state = 9  # it expires
    with pytest.raises(BadInput, match="reasons to reject.*too near"):
        decisions.arm(flight, text, a)
    with pytest.raises(BadInput, match="saw correction .* before this was known: nearer still"):
        decisions.arm(flight, text, b, "because", against=("too near", "nearer still"))
    decisions.arm(flight, text, a, "far enough anyway")
    decisions.go(flight, text, b)
    assert [c.arg_i[1] for c in flight.commands] == [0, 1, 0]


def test_a_second_step_with_another_journal_needs_the_override_too(too_near, own_key_file, tmp_path):
    """What B. saw counts although B.'s journal does not hold what A.'s first step overrides."""
    _, p = too_near
    signer, plain = signer_of(own_key_file), from_message(p, [])
    text, here, elsewhere = plain.crc_text, tmp_path / "a.jsonl", tmp_path / "b.jsonl"
    flight = DirectFlight(signer).waits(plain.crc)
    a = decisions.Operator("A", "fine\narmed by the flight director", here)
    decisions.see(here, plain, "A", Path("run.lcmlog"), signer)
    decisions.arm(flight, text, a)
    for file in (here, elsewhere):
        decisions.see(file, replace(plain, against=("too near",)), "B", Path("run.lcmlog"), signer)
    with pytest.raises(BadInput, match="reasons to reject.*too near"):
        decisions.go(flight, text, decisions.Operator("B", "why", elsewhere))
    with pytest.raises(BadInput, match="A has taken the first step, and said what it overrides: nothing"):
        decisions.go(flight, text, decisions.Operator("B", "why", here), override="far enough anyway")
    assert len(flight.commands) == 1
    said = []
    decisions.go(
        flight,
        text,
        decisions.Operator("B", "why", elsewhere, say=said.append),
        override="far\nenough anyway",
    )
    assert "by override: far enough anyway" in said and len(flight.commands) == 2
    assert journal.read(elsewhere, signer.known).entries[-1].override == "far\nenough anyway"


def test_words_of_the_first_step_are_one_line_of_the_second(too_near, own_key_file):
    _, p = too_near
    signer, plain = signer_of(own_key_file), from_message(p, [])
    file, said = journal.place(None, own_key_file), []
    flight = DirectFlight(signer).waits(plain.crc)
    decisions.see(file, plain, "A", Path("run.lcmlog"), signer)
    decisions.arm(flight, plain.crc_text, decisions.Operator("A", "fine\nby override: accepted", file))
    decisions.go(flight, plain.crc_text, decisions.Operator("A", "why", file, say=said.append))
    assert any(line.startswith("armed by A") and line.endswith("fine by override: accepted") for line in said)
    assert not [line for line in said if "\n" in line]


@pytest.fixture
def desk(too_near, own_key_file, beyond):
    """A console where the clearance is there at once; how far it is can be set."""
    _, p = too_near
    picture = Picture(Geometry(BIN))
    picture.add("KC_PROPOSAL", p)
    desk = Desk("memq://", own_key_file, None, BIN, picture)
    desk.clearances = SimpleNamespace(found=Found("done", beyond))
    desk.clearances.ask = lambda *_given: desk.clearances.found
    return desk, f"{p.crc & 0xFFFFFFFF:08x}", beyond.against


def test_the_console_has_the_same_reasons_and_asks_for_the_same_override(desk):
    desk, crc, against = desk
    page = desk.review(crc)
    assert page["reasons"] == list(against) and page["seen_by"] == []
    assert not set(page["reasons"]) & set(page["look_at"])
    assert any(f"Reason to reject: {NEAR}" in line for line in page["page"]["summary"])
    desk.see(crc, "A")
    desk.see(crc, "a ")  # once is enough
    assert [e.against for e in desk.entries()] == [against]
    desk.clearances.found = Found("not known", why="no tables")
    page = desk.review(crc)
    # what was seen stays a reason
    assert page["reasons"] == list(against) and page["clearance"]["why"] == "no tables"
    assert "clearance and reach are not known: no tables" in page["look_at"]


def test_the_console_shows_open_questions_and_a_journal_that_does_not_verify(desk, own_key_file):
    desk, crc, against = desk
    desk.see(crc, "A")
    asked = ("question", int(crc, 16), "B", "in\nshadow?", "", None, signer_of(own_key_file))
    record(desk.journal_path, *asked)
    (line,) = [text for text in desk.review(crc)["look_at"] if text.startswith("open question by B, ")]
    assert line.endswith("(line 2 of the journal): in shadow?")
    for _ in range(2):
        desk.see(crc, "A")  # again, with the question
    assert [e.decision for e in desk.entries()] == ["seen", "question", "seen"]
    assert line in desk.entries()[-1].why
    desk.journal_path.write_text(desk.journal_path.read_text().replace('"B"', '"C"'))
    page = desk.review(crc)
    assert page["reasons"] == list(against)
    assert page["look_at"][0].startswith("the journal does not verify: the review journal was changed")
    with pytest.raises(BadInput, match="journal was changed"):
        desk.see(crc, "A")


def test_nobody_has_seen_at_the_console_what_is_still_being_computed(desk, beyond):
    desk, crc, against = desk
    desk.clearances.found = Found("running", done=3, of=9)
    assert desk.review(crc)["reasons"] == []
    with pytest.raises(CommandFailed, match="still being computed"):
        desk.decide("arm", crc, Words("A", "clean"))  # seen at a terminal, which knew none
    with pytest.raises(CommandFailed, match="still being computed"):
        desk.see(crc, "A")
    desk.clearances.found = Found("not known", why="another SPACE is in force")
    desk.see(crc, "A")
    assert desk.review(crc)["seen_by"] == ["A"]
    desk.clearances.found = Found("done", beyond)  # the table was read back meanwhile
    page = desk.review(crc)
    assert page["seen_by"] == [] and page["reasons"] == list(against)
    desk.see(crc, "A")
    assert desk.review(crc)["seen_by"] == ["A"] and len(desk.entries()) == 2


def test_the_preview_of_a_rollback_says_how_near_the_arm_comes(tmp_path, own_key_file):
    """On the command line and in the console: from nominal back to what comes too near."""
    nominal, back = values({}), values(BEYOND)
    now, before = kin_image(nominal, 5), kin_image(back)
    for name, made in (("now", now), ("before", before)):
        (tmp_path / f"{name}.tbl").write_bytes(made.data)
    crcs, places = in_force(kin=now.crc), (tmp_path / "now.tbl", tmp_path / "before.tbl")
    found = previews.what_rolls_back(crcs, before.crc, BIN, places)
    (reason,) = found.corrected.against
    assert reason.startswith(NEAR) and found.changes.reasons[0].text == reason
    assert found.as_dict()["clearance"]["reasons"] == [reason]
    out = Console(record=True, width=200, file=io.StringIO())
    text.rolled_back(out, found)
    said = out.export_text()
    assert (
        f"from KIN table {now.crc:08x} back to {before.crc:08x} (values from {tmp_path}/before.tbl)" in said
    )
    assert (found.as_dict()["from"], found.as_dict()["to"]) == (now.crc_text, before.crc_text)
    assert "rolled back" in said and "-21.7 mm" in said and f"against it: {NEAR}" in said
    picture, hk = Picture(Geometry(BIN)), kcm.hk_t()
    hk.table_crc, hk.kin_prev_crc = [signed(c) for c in crcs], signed(before.crc)
    picture.add("KC_HK", hk)
    desk = Desk("memq://", own_key_file, None, BIN, picture)
    desk.clearances = SimpleNamespace(ask=lambda *_given: Found("done", found.corrected))
    desk._values = lambda crc: KinValues(crc, tuple(nominal if crc == now.crc else back))
    page = desk.rollback_preview()
    assert (page["crc"], page["to"]) == (now.crc_text, before.crc_text)
    assert page["against"] == [reason] and page["clearance"]["status"] == "done"
    assert [s["title"] for s in page["near"]][0] == "Clearance with the table before"
    other = previews.what_rolls_back(in_force(kin=now.crc, space=0x77), before.crc, BIN, places)
    assert other.corrected is None and "SPACE 00000077 is in force" in other.why_not
    other = previews.what_rolls_back(in_force(kin=now.crc, terms=0x77), before.crc, BIN, places)
    assert other.changes.rows[0].name.startswith("coef[")  # the names would be those of others


def test_the_console_knows_the_table_before_also_when_another_one_is_in_force(
    tmp_path, own_key_file, too_near
):
    """The folder of the tables in force holds one kinematics table, and a rollback brings back another."""
    _, p = too_near
    picture, hk = Picture(Geometry(BIN)), kcm.hk_t()
    crcs = in_force(kin=p.crc & 0xFFFFFFFF)
    hk.table_crc = [signed(c) for c in crcs]
    hk.kin_prev_crc = signed(in_force()[4])
    picture.add("KC_HK", hk)
    picture.add("KC_PROPOSAL", p)
    desk = Desk("memq://", own_key_file, None, BIN, picture)
    shelf = Shelf(BIN, tmp_path / "made", tmp_path / "read", desk)
    desk.elsewhere = lambda: (shelf.folder, shelf.read)
    shelf.adopt()
    assert not (desk.tables_dir / "kin.tbl").exists()
    assert "J7.phi_rad goes back by -82 deg" in desk.rollback_preview()["headline"]
    picture.newest("KC_HK").kin_prev_crc = 0x77
    with pytest.raises(BadInput, match="are not known to this console"):
        desk.rollback_preview()


def test_what_was_not_recorded_is_asked_of_flight_with_the_tables_in_force(tmp_path, own_key_file):
    """Tables of the folder that are others are read back; what cannot be had is named."""
    image = kin_image(values(BEYOND), before=0x55)
    flight = DirectFlight(signer_of(own_key_file)).waits(image.crc)
    flight.hk.table_crc = [signed(c) for c in in_force()]
    flight.holds = {int(library("flight").constant("KC_STORE_PROPOSAL")): image.data}
    folder, n = tmp_path / "tables", iter(range(9))
    who = decisions.Operator("A. Operator", "was not recorded", tmp_path / "review.jsonl")
    shutil.copytree(BIN, folder)

    def asked():
        into = tmp_path / f"into{next(n)}"
        into.mkdir()
        return previews.asked_for(flight, decisions.on_board(flight), folder, into, who)

    found = asked()
    assert found.crc == image.crc_text and found.corrected.against[0].startswith(NEAR)
    assert found.changes.reasons[0].text == found.corrected.against[0]
    assert f"ARM, CAMERA, TERMS, SPACE of {folder}" in found.sources[2]
    assert "table 00000055 is not at hand" in found.sources[1] and not found.corrected.old_known
    assert found.as_dict()["clearance"]["reasons"] == list(found.corrected.against)
    (folder / "space.tbl").write_bytes((folder / "space.tbl").read_bytes()[:-9])
    (folder / "camera.tbl").unlink()
    missing = asked()
    assert missing.corrected is None and "could not be read back" in missing.why_not
    assert "SPACE" in missing.why_not and "one that cannot be read is here" in missing.why_not
    for kind in ("camera", "space"):
        flight.holds[kinds()[kind]] = (BIN / f"{kind}.tbl").read_bytes()
    again = asked()
    assert "read back from flight, which the folder does not have" in again.corrected.tables
    assert again.corrected.clear == found.corrected.clear
    written = journal.read(who.journal, signer_of(own_key_file).known).entries
    assert [(e.words, e.crc) for e in written[:2]] == [
        ("attempt: read back the proposed KIN table", image.crc_text),
        ("proposed KIN table read back", image.crc_text),
    ]
    assert [e.words for e in written if "SPACE" in e.words] == [
        "attempt: read back the SPACE table",
        "refused: read back the SPACE table",
        "attempt: read back the SPACE table",
        "SPACE table read back",
    ]


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_values_that_are_no_numbers_have_no_clearance(bad):
    with pytest.raises(BadInput, match="no finite number"):
        corrected.between((), [bad], BIN)


def test_tables_of_another_flight_have_no_clearance(tmp_path, too_near):
    """The CRC of each table decides, not its name or place."""
    log, p = too_near
    crcs = corrected.in_force(in_force())
    assert corrected.misfits(BIN, crcs) == {} and corrected.misfits(tmp_path, {"arm": 0}) == {}
    shutil.copytree(BIN, tmp_path / "bin")
    shutil.copy(BIN / "arm.tbl", tmp_path / "bin" / "camera.tbl")
    assert "a ARM table is here" in corrected.misfits(tmp_path / "bin", crcs)["camera"]
    p.crc_arm = 0x77
    p.crc = signed(kin_crc(p))
    write_log(log, waiting=p)
    found = json.loads(shown(log, "--json"))
    assert found["clearance"] is None and found["reasons_to_reject"] == []
    assert "ARM 00000077 is in force" in found["clearance_unknown"]
    assert any(line.startswith("clearance and reach are not known") for line in found["look_at"])


def test_a_file_that_cannot_be_read_is_said(monkeypatch):
    def denied(_path):
        raise PermissionError(13, "Permission denied", str(BIN / "space.tbl"))

    monkeypatch.setattr(Path, "read_bytes", denied)
    with pytest.raises(BadInput, match="cannot be read: Permission denied"):
        corrected.between((), [0.0], BIN, SOURCE)


def test_the_console_computes_it_once_for_each_correction_in_a_process_of_its_own(tmp_path):
    given = ("fedcba98", (), [0.01], BIN, corrected.in_force(in_force()))
    with Clearances(tmp_path) as clearances:
        seen = []
        deadline = time.monotonic() + 120
        while (found := clearances.ask(*given)).status == "running":
            seen.append((found.done, found.of))
            assert time.monotonic() < deadline
            time.sleep(0.05)
        assert found.status == "done", found.why
        assert seen[0] == (0, 0) and seen[-1][0] <= seen[-1][1]
        assert found.corrected.headline.startswith("Clearance of")
    again = Clearances(tmp_path)  # after a restart it is there
    assert again.ask(*given) == found and again.work.job is None
    assert again.ask(*given[:3], tmp_path, {}).status == "not known"
    assert "SPACE 00000077 is in force" in again.ask(*given[:4], {"space": 0x77}).why
