"""A review as operators do it: a run whose fit is poor, then flight on its store and the tool, over LCM."""

import math
import subprocess

import pytest
from click.testing import CliRunner
from flight import BINARY, TABLES

from kincal import review
from kincal.api import reviews
from kincal.cli import main
from kincal.link import Link, crc_text
from kincal.review.status import proposals_in
from kincal.run.inprocess import Script, Setup, command, simulate
from kincal_shared.errors import CommandFailed
from kincal_shared.keys import read, signer_of
from kincal_sim.ports import private_port, private_url

WHO = ("--why", "reason")


def kincal(*args):
    """Exit status, and output as one line; in this process: that of flight is the other one."""
    run = CliRunner().invoke(main, [str(a) for a in args])
    return run.exit_code, " ".join(run.output.split())


@pytest.fixture(scope="module")
def poor_run(tmp_path_factory):
    """A soft elbow and friction, which the flight tables do not model."""
    out = tmp_path_factory.mktemp("review") / "run"
    status, said = kincal(
        "run", "hidden_compliance", "--fast", "--poses", 20, "--no-compare", "--no-summary", "--out", out
    )
    assert status == 1 and "the fit is poor; the proposal is left to the ground" in said
    return out


@pytest.fixture
def live(poor_run):
    """Flight on the store of that run: its URL."""
    port, lock = private_port()
    url = private_url(port)
    command = [BINARY, "--live", "--url", url, "--tables", TABLES, "--store", poor_run / "store"]
    process = subprocess.Popen([*command, "--keys", poor_run / "store.keys"], stderr=subprocess.DEVNULL)
    try:
        with Link(url) as link:
            link.wait_hk(lambda _hk: True, 20.0, "housekeeping")
        yield url
    finally:
        process.terminate()
        process.wait(timeout=20.0)
        lock.close()


def test_a_poor_proposal_goes_live_only_when_two_commands_and_an_override_say_so(poor_run, live):
    log, file = poor_run / "run.lcmlog", poor_run / "store.keys"
    crc = f"{proposals_in(log)[0].crc:08x}"
    on = ("--keys", file, "--url", live)
    assert f"correction {crc} (poor fit) waits for review" in kincal("review", "list", "--live", *on)[1]
    for decide in (("arm",), ("arm", "--override", "x"), ("go",)):
        status, said = kincal("review", *decide, crc, "--by", "A", *WHO, *on)
        assert status != 0 and ("A has not seen" in said or "is not armed" in said)
    status, said = kincal("review", "show", log, "--by", "A", "--tables", TABLES, "--keys", file)
    assert status == 0 and f"A has seen correction {crc}" in said
    assert f"kincal review arm {crc} --by NAME --why REASON --override REASON --keys {file}" in said
    status, said = kincal("review", "arm", crc, "--by", "A", *WHO, *on)
    assert status == 2 and "flight itself calls the fit poor" in said
    with Link(live, signer=signer_of(file)) as link:
        link.wait_hk(lambda _hk: True, 20.0, "housekeeping")  # the command is stamped with flight's time
        with pytest.raises(CommandFailed, match="COR_POOR"):
            link.command("APPROVE_ARM", (int(crc, 16),))  # flight asks by itself, whoever sends
    status, said = kincal("review", "arm", crc, "--by", "A", *WHO, "--override", "rover at risk", *on)
    assert status == 0, said
    listed = kincal("review", "list", "--live", *on)[1]
    assert f"correction {crc} (poor fit) is armed, by key 1 for another" in listed
    with Link(live) as link:
        before = link.wait_hk(lambda hk: hk.proposal_crc != 0, 5.0, "housekeeping")
        assert crc_text(before.table_crc[review.KIN_KIND]) != crc
    status, said = kincal("review", "go", crc, "--by", "A", *WHO, *on)
    assert status == 0 and "by override: rover at risk" in said
    assert f"correction {crc} is in force" in said
    assert "on board: nothing waits" in kincal("review", "list", "--live", *on)[1]
    entries = review.check_journal(poor_run / "review.jsonl", read(file))
    done = [(e.decision, e.override) for e in entries if not e.command]
    assert done == [("seen", ""), ("arm", "rover at risk"), ("approve", "rover at risk")]
    attempts = [e.command for e in entries if e.decision == "attempt"]
    assert attempts == [
        "APPROVE_ARM",
        "APPROVE_ARM",
        "APPROVE_GO",
        "APPROVE_ARM",
        "APPROVE_ARM",
        "APPROVE_GO",
    ]


def test_what_is_left_at_each_pose_adds_up_to_what_flight_states(poor_run):
    log = poor_run / "run.lcmlog"
    shown = reviews.show(log, None, TABLES, [])
    assert shown.about.exact
    fitted = [p for p in shown.residuals if not p.rejected]
    assert sum(not p.extra for p in shown.residuals) == shown.review.n_poses
    assert len(fitted) == len(shown.residuals) - shown.review.n_outliers
    for name, key in (("after_pos_m", "fit_pos_m"), ("after_rot_rad", "fit_rot_rad"),
                      ("before_pos_m", "before_pos_m"), ("before_rot_rad", "before_rot_rad")):  # fmt: skip
        rms = math.sqrt(sum(getattr(p, name) ** 2 for p in fitted) / len(fitted))
        assert rms == pytest.approx(shown.review.numbers[key], rel=0.02), name
    assert all(p.tags and p.frames > 0 for p in fitted)


def test_a_correction_of_some_coefficients_after_another_makes_the_table_that_it_names():
    """What is not estimated keeps value and sigma of the table before; the CRC is that of all of it."""
    first = simulate("paper", 3)
    start = command("START", -1, 4, 7)
    start.arg_u64 = 0b1111 << 12  # joint 4
    second = simulate(
        "paper",
        4,
        Setup(store=first.store, commander=lambda send: Script(send, [(20, start)]), limit_s=400.0),
        each_tick=lambda tick: not any(channel == "KC_PROPOSAL" for channel, _ in tick.from_flight),
    )
    p = second.log.last_session.proposal
    assert sum(status == 1 for status in p.status[: p.n_coef]) == p.n_coef - 4
    assert sum(sigma > 0.0 for sigma in p.sigma[:28]) > 20  # of the first calibration
    shown = review.from_message(p, [])
    assert shown.crc == p.crc & 0xFFFFFFFF
    assert sum(line.sigma > 0.0 for line in shown.coefs) <= 4
