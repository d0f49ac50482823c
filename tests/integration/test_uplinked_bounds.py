"""An arm outside what the search space was verified for is stopped with uplinked terms as with those that
ship: a hidden effect is found in a log, uplinked, flown (docs/TUTORIAL.md), and then the arm gets worse."""

import shutil

import pytest
from click.testing import CliRunner
from flight import ROOT

from kincal.cli import main
from kincal.flight import library
from kincal.flight import tables as codec
from kincal.run.inprocess import TABLES, Setup, simulate
from kincal_sim.scenario import load

FLIGHT = library("flight")
HIDDEN = load("hidden_compliance")
EFFECTS = ["joint_compliance[4]", "backlash[1]"]
# Each is far outside the error bounds. A coefficient with the bounds of former uplinks (1.5 rad) explains it,
# or the compliance would if its bound came on top of the joint's: near the park pose the torque is constant.
OUTSIDE = {"J4.phi_rad": 0.2, "J1.phi_rad": 0.3, "J6.phi_rad": 0.6}


def kincal(*args):
    done = CliRunner().invoke(main, [str(a) for a in args])
    assert done.exit_code == 0, done.output
    return done.output


@pytest.fixture(scope="module")
def uplinked(tmp_path_factory):
    """Tables to fly with after the effects were found in the log of a calibration that did not fit."""
    out = tmp_path_factory.mktemp("uplinked")
    run = simulate(HIDDEN, 1, Setup(poses=30, log=out / "dh.lcmlog"))
    assert run.record["verdict"] == "poor"
    kincal("model", "add", "--model", out / "M.toml", *EFFECTS)
    kincal("model", "fit", "--arm", "wam", "--data", out / "dh.lcmlog", "--model", out / "M.toml")
    kincal("model", "uplink", "--model", out / "M.toml", "--tables", TABLES, "--fly", out / "tables")
    return out / "tables"


def fly(tables, **errors):
    """A calibration of the arm with the hidden effects and these errors alone."""
    arm = HIDDEN.arm.model_copy(update={"errors": errors})
    return simulate(HIDDEN.model_copy(update={"arm": arm}), 1, Setup(tables=tables, poses=20))


def names(run):
    return {event.name for event in run.log.events}


@pytest.mark.slow
def test_flight_calibrates_the_arm_that_it_was_uplinked_for(uplinked):
    run = simulate(HIDDEN, 2, Setup(tables=uplinked, poses=20))
    assert run.record["verdict"] == "change"
    proposal = run.log.last_session.proposal
    for coefficient, true in ((28, 3e-3), (29, 3e-3)):
        assert abs(proposal.value[coefficient] - true) < 4 * proposal.sigma[coefficient]


@pytest.mark.slow
@pytest.mark.parametrize("name", OUTSIDE)
def test_an_arm_outside_the_bounds_is_stopped_with_uplinked_terms(uplinked, name):
    run = fly(uplinked, **{name: OUTSIDE[name]})
    assert "CAL_MODEL_MISMATCH" in names(run)
    assert run.log.last_session.proposal is None
    assert not run.contacts


def former(folder, tmp_path, verified):
    """The tables of a folder with the DH bounds that uplinks had before; verified: SPACE says it was verified
    for them."""
    out = tmp_path / "former"
    shutil.copytree(folder, out)
    terms = codec.decode_as("terms", (out / "terms.tbl").read_bytes())[1]
    for row in terms.coef[0:28]:
        bound = {"phi_rad": 1.5, "alpha_rad": 0.6, "a_m": 0.05, "d_m": 0.2}[
            FLIGHT.text(row.name).split(".")[1]
        ]
        row.lb, row.ub = -bound, bound
    (out / "terms.tbl").write_bytes(codec.encode("terms", terms).data)
    if verified:
        space = codec.decode_as("space", (out / "space.tbl").read_bytes())[1]
        for joint in space.verified[0:7]:
            joint.phi_rad = joint.alpha_rad = 2.0
            joint.a_m = joint.d_m = 0.3
        (out / "space.tbl").write_bytes(codec.encode("space", space).data)
    return out


@pytest.mark.slow
def test_the_bounds_of_former_uplinks_let_such_an_arm_through(uplinked, tmp_path):
    """So the test above sees what it is there for."""
    run = fly(former(uplinked, tmp_path, verified=True), **{"J4.phi_rad": 0.2})
    assert "CAL_MODEL_MISMATCH" not in names(run)
    assert run.record["verdict"] == "change"


def test_flight_does_not_start_with_the_bounds_of_former_uplinks(tmp_path):
    run = fly(former(ROOT / "tables" / "bin", tmp_path, verified=False))
    assert {"TBL_SPACE_NARROW", "TBL_MISSING"} <= names(run)
    assert run.record["n_poses"] == 0 and not run.record["success"]
    (text,) = {e.text for e in run.log.events if e.name == "TBL_SPACE_NARROW"}
    assert "off by 1.5" in text and "verified for 0.1 there" in text
