"""`kincal run` from the outside: the whole system, its printed lines, its files and its exit status."""

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from kincal import link, review
from kincal.cli import main
from kincal.flight import tables as codec

ROOT = Path(__file__).resolve().parents[2]
BIN = ROOT / "tables" / "bin"
JOINTS = tomllib.loads((ROOT / "tables" / "src" / "space.toml").read_text())["joints"]
RESERVE = len(JOINTS["reserve"])
LOCAL = len(JOINTS["local_initial_rad"]) - RESERVE


def kincal(*args, timeout=240):
    return subprocess.run(
        [sys.executable, "-m", "kincal", *map(str, args)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=timeout,
    )


def here(*args):
    """Output of a command in this process."""
    done = CliRunner().invoke(main, [str(a) for a in args])
    assert done.exit_code == 0, done.output
    return done.stdout


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """The demo in fast mode, reviewed by the ground, with the comparison runs."""
    out = tmp_path_factory.mktemp("demo")
    return out, kincal("run", "paper", "--fast", "--accept", "ground", "--out", out)


def test_demo_meets_all_its_criteria(demo):
    _, done = demo
    assert done.returncode == 0, done.stdout + done.stderr
    assert "MISSED" not in done.stdout
    assert re.search(r"^passed in \d+ s", done.stdout, re.M)


def test_demo_prints_one_line_a_pose_in_order(demo):
    _, done = demo
    line = r"^ ?(\d+)/(\d+) +(local|\d+) +\d+ +[\d.]+ mm +[\d.]+ mrad +-?[\d.]+"
    poses = re.findall(line, done.stdout.split("\nCorrections")[0], re.M)
    assert [int(n) for n, _, _ in poses] == list(range(1, len(poses) + 1))
    n_local = len(poses) - 20
    assert 2 <= n_local <= LOCAL + RESERVE
    assert [where == "local" for _, _, where in poses] == [True] * n_local + [False] * 20
    assert {int(goal) for _, goal, _ in poses[n_local:]} == {len(poses)}


def test_demo_lists_true_and_estimated_values_of_all_corrections(demo):
    _, done = demo
    rows = re.findall(r"^(J\d\.\w+) +(-?[\d.]+) +(-?[\d.]+) +± ([\d.]+)", done.stdout, re.M)
    assert len(rows) == 28
    values = {name: (float(true), float(got), float(sigma)) for name, true, got, sigma in rows}
    for name, true in (("J7.phi_rad", 1300), ("J2.alpha_rad", 400), ("J3.a_m", 10), ("J3.d_m", 150)):
        assert values[name][0] == pytest.approx(true)
        assert abs(values[name][1] - true) <= 4 * values[name][2]


def test_demo_shows_the_held_out_error_fall_below_the_limits(demo):
    out, _ = demo
    summary = json.loads((out / "summary.json").read_text())
    assert summary["before"]["n"] == summary["after"]["n"] == 200
    assert summary["before"]["pos_m"] > 0.1
    assert summary["after"]["pos_m"] <= 2e-3
    assert summary["after"]["rot_rad"] <= 5e-3
    # the error falls with the poses in all runs that are compared
    assert {c["label"] for c in summary["curves"]} == {"rate, fast", "ucb, fast", "random, fast"}
    for curve in summary["curves"]:
        held = [p["held_pos_m"] for p in curve["poses"]]
        assert 20 + 2 <= len(held) <= 20 + LOCAL + RESERVE
        assert held[-1] < 0.01 * held[0]


def test_demo_in_fast_mode_starts_no_process(demo):
    out, _ = demo
    assert json.loads((out / "launch.json").read_text())["url"] == "in-process"
    assert not (out / "logs").exists()


def test_demo_leaves_page_and_picture(demo):
    out, done = demo
    assert (out / "summary.html").stat().st_size > 1_000_000
    assert (out / "summary.png").stat().st_size > 100_000
    for name in ("summary.html", "summary.png", "run.lcmlog"):
        assert str(out / name) in done.stdout.replace("\n", "")


def test_ground_approved_in_two_steps_and_the_record_says_so(demo):
    out, done = demo
    log = link.read_log(out / "run.lcmlog")
    ground = [c for c in log.commands if c.source == c.SRC_GROUND]
    crc = log.sessions[max(log.sessions)].proposal.crc
    assert [(c.opcode, c.arg_i[0]) for c in ground] == [
        (ground[0].APPROVE_ARM, crc),
        (ground[0].APPROVE_GO, crc),
    ]
    assert log.hk.table_crc[review.KIN_KIND] == crc
    entries = review.check_journal(out / "review.jsonl")
    text = f"{crc & 0xFFFFFFFF:08x}"
    assert [(e.decision, e.crc) for e in entries] == [("arm", text), ("approve", text)]
    assert [(e.key_id, e.counter) for e in entries] == [(c.key_id, c.counter) for c in ground]
    assert f"{out / 'review.jsonl'}: 2 decisions and commands in 2 lines, each line" in here(
        "audit", "verify", log.path
    )
    assert f"table {text} is active" in done.stdout


def test_table_in_force_is_stored_and_holds_the_estimate(demo):
    out, _ = demo
    proposal = next(s.proposal for s in link.read_log(out / "run.lcmlog").sessions.values())
    stored = [p for p in (out / "store").rglob("*") if p.is_file() and b"KCT1" in p.read_bytes()]
    found = []
    for path in stored:
        data = path.read_bytes()
        data = data[data.index(b"KCT1") :]
        size = int.from_bytes(data[8:12], "little")
        image = codec.header(data[: 16 + size])
        if image.kind == "kin" and image.crc == proposal.crc & 0xFFFFFFFF:
            found.append(codec.decode(image.data)[1])
    assert found
    assert list(found[0].value[0:28]) == pytest.approx(proposal.value[:28], abs=0.0)


def test_covariance_of_the_proposal_fits_its_sigmas(demo):
    out, _ = demo
    proposal = next(s.proposal for s in link.read_log(out / "run.lcmlog").sessions.values())
    cov = link.unpack_covariance(proposal.cov, proposal.n_coef)
    assert np.sqrt(np.diag(cov)) == pytest.approx(np.array(proposal.sigma[: proposal.n_coef]), rel=1e-9)
    found = review.from_message(proposal, review.coef_names(BIN))
    assert np.abs(found.correlation).max() <= 1.0 + 1e-9
    assert np.linalg.eigvalsh(found.correlation).min() > 0.0


def test_log_and_review_read_what_the_run_left(demo):
    out, _ = demo
    log = here("log", out / "run.lcmlog")
    n = int(re.search(r"calibration 1: (\d+) poses", log)[1])
    assert 20 < n <= 20 + LOCAL + RESERVE
    assert "COR_ACTIVE" in log
    assert "rank" in here("review", "show", out / "run.lcmlog")


def test_a_missed_criterion_fails_the_run(tmp_path):
    """Given a verdict that a healthy arm cannot have, the exit status is 1 and the criterion is named; with
    processes as without them, the arm is left alone."""
    text = (
        (ROOT / "sim/scenarios/healthy.toml")
        .read_text()
        .replace('verdict = "no_change"', 'verdict = "change"')
    )
    scenario = tmp_path / "strict.toml"
    scenario.write_text(text)
    done = kincal(
        *("run", scenario, "--fast", "--processes", "--poses", 7, "--no-compare", "--no-summary"),
        *("--out", tmp_path / "out"),
    )
    assert done.returncode == 1, done.stdout
    assert re.search(r"MISSED +verdict", done.stdout)
    assert "FAILED" in done.stdout
    assert "no change needed" in done.stdout
    assert json.loads((tmp_path / "out" / "launch.json").read_text())["url"].startswith("udpm:")
    log = link.read_log(tmp_path / "out" / "run.lcmlog")
    nominal = codec.header((BIN / "kin.tbl").read_bytes()).crc
    assert log.hk.table_crc[review.KIN_KIND] & 0xFFFFFFFF == nominal


def test_tables_that_flight_refuses_end_the_run_with_a_message(tmp_path):
    broken = tmp_path / "tables"
    broken.mkdir()
    for path in BIN.glob("*.tbl"):
        (broken / path.name).write_bytes(path.read_bytes())
    data = (broken / "arm.tbl").read_bytes()
    (broken / "arm.tbl").write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    done = kincal("run", "healthy", "--fast", "--tables", broken, "--out", tmp_path / "out")
    assert done.returncode == 2
    assert "TBL_CRC" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_demo_through_pixels(tmp_path):
    """Rendered images and the tag detector, three poses: all criteria are met."""
    done = kincal(
        *("run", "paper", "--poses", 3, "--no-compare", "--no-summary", "--accept", "ground"),
        *("--out", tmp_path),
        timeout=600,
    )
    assert done.returncode == 0, done.stdout
    assert re.search(r"^ok +held-out position RMS", done.stdout, re.M)
    assert json.loads((tmp_path / "launch.json").read_text())["mode"] == "pixels"
    assert link.read_log(tmp_path / "run.lcmlog").counts["KC_DETECTION"] > 30
