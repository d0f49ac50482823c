"""Clearance and reach with a correction. Oracles: MuJoCo's distances of two geoms (GJK, not its contacts) at
the joints where the corrected arm stands, and its own kinematics."""

import json
import time
from pathlib import Path

import mujoco
import numpy as np
import pytest
from click.testing import CliRunner
from test_review import CRC, proposal, write_log

from kincal import space
from kincal.api import corrected, reviews
from kincal.cli import main
from kincal.console.clearances import Clearances
from kincal.flight import Terms
from kincal.flight.tables import decode_as
from kincal.pages import image
from kincal.review import from_message
from kincal.review.changes import KinValues
from kincal.space.mjcf import ArmModel
from kincal_shared.errors import BadInput

BIN = Path(__file__).resolve().parents[2] / "tables" / "bin"
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
    changes, stands_out = reviews.with_clearance(review, reviews.what_changes(review, BIN), beyond)
    assert reason in changes.reasons and reason.text in stands_out


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
    assert beyond.left_out_m < 1e-6 and not beyond.notes
    moved = corrected.between(None, values({"base.tx_m": 0.02}), BIN)
    assert moved.left_out_m == pytest.approx(0.02, abs=1e-6)
    assert "not at hand" in moved.notes[0] and "move the tool by up to 20.00 mm" in moved.notes[1]
    for kind in ("arm", "camera", "terms"):
        (tmp_path / f"{kind}.tbl").write_bytes((BIN / f"{kind}.tbl").read_bytes())
    with pytest.raises(BadInput, match="has no space table"):
        corrected.between((), values({}), tmp_path)
    other = tmp_path / "other.toml"
    hub = "[0.9, -0.3, 0.0, 2.0, 0.0, 0.0, 0.0]"
    other.write_text(SOURCE.read_text().replace(hub, hub.replace("0.9", "0.8", 1)))
    with pytest.raises(BadInput, match="not the description of the SPACE table"):
        corrected.between((), values({}), BIN, other)


def test_show_says_it_as_text_as_json_and_on_the_page(tmp_path, monkeypatch):
    monkeypatch.setattr(image, "beside", lambda files, _figures: (files, ""))  # a picture takes seconds
    log, p = tmp_path / "run.lcmlog", proposal()
    write_log(log)
    show = ["review", "show", str(log), "--tables", str(BIN), "--before", str(BIN)]
    run = CliRunner().invoke(main, [*show, "--picture", str(tmp_path / "p.svg")], env={"COLUMNS": "200"})
    assert run.exit_code == 0, run.output
    assert "Clearance: at least 10.00 mm (SPACE" in run.output and "Reach and view" in run.output
    page = (tmp_path / "p.html").read_text()
    assert "Clearance with the new table" in page and "Reach and view with the new table" in page
    found = json.loads(CliRunner().invoke(main, [*show, "--json"]).stdout)
    assert found["crc"] == f"{CRC:08x}" and found["numbers"]["rank"] == p.rank
    assert {c["what"] for c in found["clearance"]["clear"]} >= {"park pose", "verified segments"}
    assert found["clearance"]["headline"] and found["clearance_unknown"] == ""


def test_the_console_computes_it_once_for_each_correction_in_a_process_of_its_own(tmp_path):
    review = from_message(proposal(), [])
    old = KinValues(review.crc_before, (), "")
    with Clearances(tmp_path) as clearances:
        seen = []
        deadline = time.monotonic() + 120
        while (found := clearances.ask(review, old, BIN)).status == "running":
            seen.append((found.done, found.of))
            assert time.monotonic() < deadline
            time.sleep(0.05)
        assert found.status == "done", found.why
        assert seen[0] == (0, 0) and seen[-1][0] <= seen[-1][1]
        assert found.corrected.headline.startswith("Clearance of")
    again = Clearances(tmp_path)  # after a restart it is there
    assert again.ask(review, old, BIN) == found and again.work.job is None
    assert again.ask(review, old, tmp_path).status == "not known"
