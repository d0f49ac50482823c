"""Evaluating a run: criteria, names, ground truth."""

import io
import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from places import BIN
from rich.console import Console
from samples import CRC, progress, proposal, result, signed
from test_flight_arm import wam

import kcm
from kincal import link, review, run, tables
from kincal.cli.text import run as show
from kincal.flight import library
from kincal.pages import run as run_page
from kincal.pages.page import Provenance
from kincal.results import Criterion, HeldOut
from kincal.rotations import wxyz_of_matrix
from kincal_shared import keys
from kincal_shared.errors import BadInput, CommandFailed, KincalError
from kincal_sim import outputs

EXPECTED = run.Expectation("t", "auto", "change", 2e-3, 5e-3)


def request(**changes):
    given = run.Request("paper", "fast", None, None, 1, Path("x"), BIN)
    return replace(given, **changes)


def finished(verdict=1, ok=True, errors=("J7.phi_rad",)):
    session = link.Session(3)
    session.proposal = proposal(verdict)
    launch = {"ok": ok, "problem": "" if ok else "no new pose", "reason": "fine"}
    return SimpleNamespace(
        launch=launch, session=session, evaluator=SimpleNamespace(errors=dict.fromkeys(errors, 0.1))
    )


def missed(result_, expected=EXPECTED, done=None, **changes):
    return [
        c.name for c in run.criteria(request(**changes), expected, done or finished(), result_) if not c.ok
    ]


def test_a_run_removes_what_an_earlier_one_left_and_nothing_else(tmp_path):
    out = tmp_path / "out"
    outputs.prepare(out)
    mine = [out / "logs" / "mine.out", out / "store" / "mine.txt", out / "notes.txt"]
    old = [out / "logs" / "fsw.err", out / "store" / "k04.a", out / "store" / "k18.tmp", out / "run.lcmlog"]
    for path in (*mine, *old):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("a")
    assert outputs.prepare(out) == out / "store"
    assert [path.exists() for path in (*mine, *old)] == [True] * len(mine) + [False] * len(old)
    mine[0].unlink()
    outputs.prepare(out)
    assert not (out / "logs").exists()
    old[1].write_text("a")
    assert outputs.prepare(out, store=tmp_path / "kept") == tmp_path / "kept"
    assert old[1].exists()


@pytest.mark.parametrize("name", ["truth.json", "summary.html", "store.keys", "logs/fsw.out", "store/k04.a"])
def test_a_run_replaces_no_file_that_somebody_else_made(tmp_path, name):
    """`kincal run --out FOLDER` took any file of the names that it writes for its own."""
    mine = tmp_path / name
    mine.parent.mkdir(exist_ok=True)
    mine.write_text("{}")
    for begin in (outputs.prepare, lambda out: run.Processes(request(out=out, mode="pixels"))):
        with pytest.raises(BadInput, match=f"(?s)holds {name}, which would be replaced.*name a new or empty"):
            begin(tmp_path)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == [mine] and mine.read_text() == "{}"


@pytest.mark.parametrize("mode", ["fast", "pixels"])
def test_a_folder_that_another_run_is_writing_to_is_refused(tmp_path, mode):
    """Two at once removed each other's files, and one failed as if the calibration had."""
    begin = run.perform if mode == "fast" else run.Processes
    with outputs.alone(tmp_path):
        before = sorted(tmp_path.iterdir())
        with pytest.raises(BadInput, match=r"(?s)another run is writing there.*wait for its end"):
            begin(request(out=tmp_path, mode=mode))
        assert sorted(tmp_path.iterdir()) == before
    with outputs.alone(tmp_path):  # free again
        pass


def test_a_run_of_a_version_without_mark_is_taken_over(tmp_path):
    (tmp_path / "launch.json").write_text('{"scenario": "paper", "seed": 1, "mode": "fast"}')
    outputs.prepare(tmp_path)
    assert not (tmp_path / "launch.json").exists()


def test_a_run_puts_the_journal_of_an_earlier_one_aside_with_its_key(tmp_path):
    """The new run has another key, which did not write those lines."""
    file, journal = tmp_path / "store.keys", tmp_path / "review.jsonl"
    for seed in (1, 2, 3):
        outputs.prepare(tmp_path)
        keys.write(file, (keys.of_simulation(seed),))
        signer = keys.signer_of(file)
        review.record(journal, "comment", 0, "A", f"of seed {seed}", "", None, signer)
    for folder, seed in (("earlier-1", 1), ("earlier-2", 2), (".", 3)):
        read = review.journals.of_run(tmp_path / folder / "run.lcmlog")
        assert [entry.why for entry in read.entries] == [f"of seed {seed}"] and not read.unconfirmed
    assert file.stat().st_mode & 0o77 == (tmp_path / "earlier-1" / "store.keys").stat().st_mode & 0o77 == 0


def test_a_journal_that_no_run_made_stays_where_it_is(tmp_path):
    (tmp_path / "review.jsonl").write_text("{}\n")
    with pytest.raises(BadInput, match="a review journal of no run"):
        outputs.prepare(tmp_path)
    assert (tmp_path / "review.jsonl").exists()


def test_good_run_meets_every_criterion():
    assert missed(result()) == []


def test_criterion_on_held_out_error():
    r = replace(result(), after=HeldOut(200, 2.1e-3, 5.1e-3))
    assert missed(r) == ["held-out position RMS", "held-out rotation RMS"]
    r = replace(r, after=HeldOut(200, float("nan"), float("nan")))
    assert missed(r) == ["held-out position RMS", "held-out rotation RMS"]


def test_what_a_correction_that_is_not_in_force_would_give_is_called_proposed():
    r = replace(result(), after_is="proposed", after=HeldOut(200, 2.1e-3, 1e-3))
    assert missed(r) == ["held-out position RMS, proposed"]
    out = Console(file=io.StringIO(), width=100)
    show.run_end(out, r, (), Path("run.lcmlog"))
    words = out.file.getvalue()
    assert re.search(r"^proposed ", words, re.M) and not re.search(r"^after ", words, re.M)
    assert "would go from" in run_page.page(r, Provenance("2026-01-01")).verdict


def test_criterion_on_the_table_in_force():
    r = replace(result(), active_crc=5)
    assert missed(r) == ["correction in force"]
    assert missed(r, accept="ground") == ["correction in force"]
    waits = run.Expectation("t", "ground", "change", 2e-3, 5e-3)
    assert missed(r, expected=waits) == []


def test_criterion_on_true_values_allows_one_of_28_outside_3_sigma():
    r = result()
    for k, want in ((0, []), (1, ["true values inside 3 sigma"])):
        off = [replace(c, estimate=c.true + 4 * c.sigma) if i == k else c for i, c in enumerate(r.coefs)]
        r = replace(r, coefs=tuple(off))
        assert missed(r) == want


def test_true_values_are_no_criterion_when_the_model_cannot_hold_them():
    r = result()
    r = replace(r, coefs=tuple(replace(c, estimate=c.true + 9 * c.sigma) for c in r.coefs))
    assert missed(r, done=finished(errors=("joint_compliance[4]",))) == []


def test_criterion_on_the_verdict_and_on_the_end():
    assert missed(result(), done=finished(verdict=2)) == ["verdict"]
    assert missed(result(), done=finished(ok=False)) == ["run ended well"]
    none = finished(ok=False)
    none.session.proposal = None
    assert missed(result(), done=none) == ["run ended well"]


def test_run_without_any_criterion_has_not_passed():
    assert not replace(result(), criteria=()).ok


@pytest.mark.parametrize(
    ("injected", "name"),
    [
        ("J3.compliance_rad_per_nm", "joint_compliance[3]"),
        ("J2.gain", "encoder_gain[2]"),
        ("J7.phi_rad", "J7.phi_rad"),
    ],
)
def test_injected_errors_get_the_names_of_coefficients(injected, name):
    assert run.coef_name(injected) == name


def test_held_out_error_falls_to_zero_with_the_true_coefficients():
    rng = np.random.default_rng(5)
    errors = {(3, "d"): 0.15, (7, "phi"): 1.3}
    held = []
    for q in rng.uniform(-1, 1, (30, 7)):
        _, T = wam(q, errors)
        held.append(
            {"q_rad": q.tolist(), "p_m": T[:3, 3].tolist(), "q_wxyz": wxyz_of_matrix(T[:3, :3]).tolist()}
        )
    truth = run.GroundTruth.of({"errors": {"J3.d_m": 0.15, "J7.phi_rad": 1.3}, "held_out": held})
    evaluator = run.Evaluator(BIN, truth)
    before = evaluator.held_out(evaluator.initial_coef)
    assert before.pos_m == pytest.approx(0.15, rel=1e-9)
    assert before.rot_rad == pytest.approx(1.3, rel=1e-9)
    after = evaluator.held_out(np.array([evaluator.errors.get(n, 0.0) for n in evaluator.names]))
    assert after.pos_m < 1e-12
    assert after.rot_rad < 1e-7


def test_the_picture_shows_the_arm_once_for_each_pose():
    """Measurements on the way were drawn as poses, so that most numbers stood at other places."""
    at = library("flight").constant("KC_AT_CANDIDATE")
    session = link.Session(1, progress=[progress(0), progress(1)])
    for number, (pose, taken_at, q_rad) in enumerate(((1, at + 1, 0.3), (1, at, 0.1), (2, at, 0.2)), 1):
        m = kcm.meas_t()
        m.observation, m.pose, m.taken_at, m.q_rad = number, pose, taken_at, [q_rad] * 8
        session.measure(m)
    evaluator = run.Evaluator(BIN)
    scene = evaluator.scene(session, evaluator.initial_coef)
    alone = [evaluator.arm.points(np.full((1, 7), q))[0] for q in (0.1, 0.2)]
    assert scene.skeletons.shape[0] == 2 and np.allclose(scene.skeletons, alone)


def test_local_poses_are_told_from_candidates_in_pose_lines():
    """By the bit that the table has for them."""
    evaluator = run.Evaluator(BIN)
    _, table = tables.load(BIN / "space.tbl")
    bits = [c.why >> 15 & 1 for c in table.cand[0 : table.n_cand]]
    for candidate in (0, bits.index(1) - 1, bits.index(1), len(bits) - 1):
        message = progress(1)
        message.candidate = candidate
        line = evaluator.pose_line(message, None)
        assert line.local == bool(bits[candidate])
        assert line.place == ("local" if bits[candidate] else str(candidate))
        assert re.match(rf" 2/20 +{line.place}  +2 ", show.pose_line(line, 20))
    assert show.POSE_HEAD.index("cand") + 4 == show.pose_line(line, 20).index("local") + 5


def test_how_a_run_ended_is_shown_however_much_was_said_before():
    out = Console(file=io.StringIO(), width=100)
    r = replace(result(), events=tuple(f"event {i}" for i in range(30)))
    show.run_end(out, r, [], Path("run.lcmlog"))
    said = re.findall(r"^(event \d+|\.{3} \d+)", out.file.getvalue(), re.M)
    first, last = [f"event {i}" for i in range(6)], [f"event {i}" for i in range(24, 30)]
    assert said == [*first, "... 18", *last]
    r = replace(r, events=r.events[:12])
    out = Console(file=io.StringIO(), width=100)
    show.run_end(out, r, [], Path("run.lcmlog"))
    assert re.findall(r"^event (\d+)", out.file.getvalue(), re.M) == [str(i) for i in range(12)]


def test_run_without_a_proposal_has_no_figures_of_a_fit():
    out = Console(file=io.StringIO(), width=200)
    r = replace(result(), n_free=0, verdict="no proposal", decision="calibration aborted")
    show.run_end(out, r, [], Path("run.lcmlog"))
    assert "verdict: no proposal; decision: calibration aborted; table" in out.file.getvalue()


@pytest.mark.parametrize(
    ("verdict", "n_free", "met", "said"),
    [
        ("no proposal", 0, False, "`kincal log a/run.lcmlog` lists what flight said: its last warnings"),
        ("poor fit", 28, False, "`kincal model diagnose --arm ARM --data a/run.lcmlog` what the model lacks"),
        ("change proposed", 28, False, "`kincal review show a/run.lcmlog` shows the correction"),
        ("change proposed", 28, True, ""),
    ],
)
def test_a_run_that_failed_says_what_to_look_at(verdict, n_free, met, said):
    out = Console(file=io.StringIO(), width=200)
    r = replace(result(), verdict=verdict, n_free=n_free, criteria=(Criterion("x", "1", "2", met),))
    show.run_end(out, r, [], Path("a/run.lcmlog"))
    end = out.file.getvalue().partition("FAILED")[2]
    assert ("to do: " in end) is not met and said in end


def test_expectation_comes_from_the_scenario_file():
    expected = run.read_expectation("paper")
    assert (expected.verdict, expected.held_out_pos_m, expected.held_out_rot_rad) == ("change", 2e-3, 5e-3)
    with pytest.raises(KincalError, match="healthy"):
        run.read_expectation("nonsense")


def test_command_line_of_the_launcher_carries_what_was_asked():
    words = request(acquisition="dopt", poses=9, accept="ground").command()
    for pair in (("--acquisition", "dopt"), ("--poses", "9"), ("--accept", "ground"), ("--seed", "1")):
        assert words[words.index(pair[0]) + 1] == pair[1]
    assert "--fast" in words
    assert "--poses" not in request().command()


def test_missing_result_of_a_run_is_an_error(tmp_path):
    with pytest.raises(CommandFailed, match="no truth.json"):
        run.read_json(tmp_path / "truth.json")


class FakeLink:
    """Takes commands and answers all of them well."""

    url = "fake"

    def __init__(self):
        self.sent = []
        self.signer = keys.Signer(keys.of_simulation(1), keys.counting())

    def command(self, opcode, arg_i=(), *_args, **_kw):
        self.sent.append((opcode, arg_i))

    def wait_hk(self, what, *_args):
        hk = SimpleNamespace(table_crc=[0, 0, 0, 0, signed(CRC), 0, 0, 0], proposal_crc=0)
        assert what(hk)


def test_ground_approves_a_clean_proposal_in_two_steps_and_records_it(tmp_path):
    link = FakeLink()
    names = [f"c{i}" for i in range(54)]
    run.decide(request(out=tmp_path), link, proposal(), names, run.Observer())
    assert link.sent == [("APPROVE_ARM", (CRC,)), ("APPROVE_GO", (CRC,))]
    lines = (tmp_path / "review.jsonl").read_text().splitlines()
    assert [json.loads(line)["decision"] for line in lines] == ["arm", "approve"]


def test_ground_rejects_a_proposal_that_does_not_fit(tmp_path):
    link, p = FakeLink(), proposal()
    p.p_fit = 1e-9
    run.decide(request(out=tmp_path), link, p, [], run.Observer())
    assert link.sent == [("REJECT", (CRC,))]
    assert json.loads((tmp_path / "review.jsonl").read_text())["decision"] == "reject"


def test_ground_does_nothing_when_nothing_needs_to_change(tmp_path):
    link = FakeLink()
    run.decide(request(out=tmp_path), link, proposal(0), [], run.Observer())
    assert link.sent == []
