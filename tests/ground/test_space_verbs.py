"""Questions to a search space: explain, check, compare, information, separability, figures."""

import re

import numpy as np
import pytest
from commands import shell
from places import BIN, SRC
from test_flight_arm import wam

from kincal import link, space, tables
from kincal.flight import library
from kincal.pages import image, space_figures
from kincal.pages import space as pages
from kincal.pages.page import Provenance
from kincal_shared.errors import KincalError

SPACE = SRC / "space.toml"
DESC = space.read_description(SPACE)
TABLES = space.TablesFolder(BIN)


def load(kind):
    return tables.load(BIN / f"{kind}.tbl")[1]


@pytest.fixture(scope="module")
def committed():
    """The struct, so that tests can change it; `view` is what the library works on."""
    return load("space")


view = space.SpaceTable.from_struct


@pytest.fixture(scope="module")
def checks():
    return space.Checks(DESC, load("arm"), load("camera"))


def run(*words):
    return shell(*words)


def few(committed, ids):
    """A table with some of the candidates."""
    flight = library("flight")
    out = flight.copy(committed)
    out.n_cand, out.n_initial = len(ids), min(2, len(ids))
    flight.ffi.memmove(out.edge, bytes(len(out.edge)), len(out.edge))
    for k, i in enumerate(ids):
        out.cand[k] = committed.cand[i]
        out.stop[k] = committed.stop[i]
    out.initial[0], out.initial[1] = 0, min(1, len(ids) - 1)
    return out


def test_explain_passes_a_candidate_of_the_table_and_names_what_a_moved_one_breaks(committed, checks):
    assert all(x.ok for x in space.explain_candidate(checks, view(committed), 3) if x.counts)
    moved = few(committed, [3])
    moved.cand[0].q_seed[1] += 0.9  # the shoulder leans forward: the arm goes down
    bad = [x.check for x in space.explain_candidate(checks, view(moved), 0) if not x.ok]
    assert bad
    with pytest.raises(KincalError, match="0..0"):
        space.explain_candidate(checks, view(moved), 1)


def test_explain_says_why_a_region_is_empty(checks):
    low = space.explain_region(checks, np.array([0.35, 0.45, 0.12]), 0.03, 120)
    assert low.good == 0
    assert sum(low.reasons.values()) == 120
    assert any("deck" in reason for reason in low.reasons)
    middle = space.explain_region(checks, np.array([0.6, 0.0, 0.6]), 0.05, 200)
    assert middle.good > 0


def test_check_finds_a_candidate_that_was_moved_and_accepts_the_others(committed, checks):
    table = few(committed, [0, 5, 9, 20])
    with space.WorkerPool(checks, 1) as pool:
        assert space.recheck(checks, pool, view(table)).problems == []
        table.cand[2].q_seed[6] += 0.2
        found = space.recheck(checks, pool, view(table))
    assert {i for i, _ in found.problems} == {2}
    assert any("0.0 mm and 200.0 mrad beside its pose" in what for _, what in found.problems)
    assert found.node_problems == []
    table.hub_q[1] = [1.8, 1.9, 0.0, 0.6, 0.0, 0.0, 0.0, 0.0]
    with space.WorkerPool(checks, 1) as pool:
        found = space.recheck(checks, pool, view(table))
    assert "hub 1: too close (nominal arm)" in found.node_problems[0]
    assert not found.ok
    assert found.sampled == 4 * DESC.clear.servo_bound_samples


def with_local(table, poses):
    """The table with these (joints, bits) as local initial poses behind its candidates, from hub 0."""
    n = table.n_cand
    for i, (q, why) in enumerate(poses):
        table.cand[n + i] = table.cand[0]
        table.cand[n + i].q_seed[0:7] = [float(x) for x in q]
        table.cand[n + i].hub, table.cand[n + i].why = 0, why
    old = list(table.initial[0 : table.n_initial])
    table.n_cand, table.n_initial = n + len(poses), len(poses) + len(old)
    table.initial[0 : table.n_initial] = [*range(n, n + len(poses)), *old]
    return table


LOCAL, RESERVE = 1 << 15, 1 << 14
PARK = np.array(DESC.joints.hubs_rad[0])


def test_check_verifies_local_poses_again(committed, checks):
    table = with_local(few(committed, [0, 5]), [(PARK, LOCAL), (PARK + 0.2 * np.eye(7)[6], LOCAL | RESERVE)])
    with space.WorkerPool(checks, 1) as pool:
        assert space.recheck(checks, pool, view(table)).ok
        table.cand[2].q_seed[5] += 1.2  # the wrist turns the tags away
        found = space.recheck(checks, pool, view(table))
    assert found.problems == []
    (what,) = found.node_problems
    assert what.startswith(f"local initial pose 1 at [{PARK[0]:g}")
    assert "a tag shows with only" in what
    table.cand[2].q_seed[5] = float(PARK[5])
    table.cand[3].q_seed[0:7] = [2.5, 1.8, 0.0, 0.4, 0.0, 0.0, 0.0]
    with space.WorkerPool(checks, 1) as pool:
        (what,) = space.recheck(checks, pool, view(table)).node_problems
    assert "too close (nominal arm)" in what


def test_local_poses_are_not_candidates_to_explain_summarise_or_compare(committed, checks):
    plain = view(few(committed, [0, 1, 2]))
    local = view(with_local(few(committed, [0, 1, 2]), [(PARK, LOCAL)]))
    with pytest.raises(KincalError, match="candidate 3 is a local initial pose"):
        space.explain_candidate(checks, local, 3)
    with pytest.raises(KincalError, match=r"0\.\.2"):
        space.explain_candidate(checks, local, 4)
    found = space.summarise(local, load("camera"), tables.load(BIN / "arm.tbl")[0].crc)
    assert (found.candidates, found.local_initial, found.reserve, found.initial) == (3, 1, 0, (0, 1))
    assert (len(found.candidate_incid_deg), found.unchecked, found.arm_fits) == (3, 0, True)
    assert len(space.scene(local, load("arm"), load("camera")).candidates) == 3
    d = space.compare(plain, local, load("kernel"), 0)
    assert (d.same, d.only_a, d.only_b) == (3, [], [])
    assert (d.n_local, d.local_differ) == ((0, 1), True)
    moved = view(with_local(few(committed, [0, 1, 2]), [(PARK + 0.01, LOCAL)]))
    assert space.compare(local, moved, load("kernel"), 0).local_differ
    assert not space.compare(local, local, load("kernel"), 0).local_differ


def test_information_does_not_count_local_poses(committed):
    ids = list(range(0, 300, 12))
    local = [(PARK + 0.2 * np.eye(7)[j], LOCAL) for j in range(7)]
    plain = space.expected_information(view(few(committed, ids)), TABLES, (8,))
    more = space.expected_information(view(with_local(few(committed, ids), local)), TABLES, (8,))
    assert more == plain
    assert max(more.chosen) < len(ids)


def test_comparison_counts_what_changed(committed):
    kernel = load("kernel")
    a, b = few(committed, [0, 1, 2, 3]), few(committed, [2, 3, 4, 5, 6])
    d = space.compare(view(a), view(b), kernel, 0)
    assert (d.same, d.only_a, d.only_b) == (2, [0, 1], [2, 3, 4])
    gaps = [
        min(np.linalg.norm(np.subtract(list(y.p_m), list(x.p_m))) for x in a.cand[0:4]) for y in b.cand[2:5]
    ]
    assert d.farthest_new_m == pytest.approx(max(gaps), abs=1e-6)
    assert 0.0 < d.min_covariance < 1.0


def test_information_agrees_with_jacobians_by_differences(committed):
    """Rank and sigma of 20 poses against numpy and central differences of an independent chain."""
    w = space.expected_information(view(committed), TABLES, (20,))
    assert w.rank == 28
    assert w.ok
    h = 1e-6
    rows = []
    for i in w.chosen:
        q = np.array(list(committed.cand[i].q_seed)[:7])
        columns = []
        for name in w.coefficients:
            j, f = int(name[1]), name.split(".")[1].split("_")[0]
            ends = []
            for sign in (1, -1):
                ends.append(wam(q, {(j, f): sign * h})[1])
            dp = (ends[0][:3, 3] - ends[1][:3, 3]) / (2 * h)
            M = (ends[0][:3, :3] - ends[1][:3, :3]) @ ends[1][:3, :3].T / (2 * h)
            columns.append([*dp, M[2, 1], M[0, 2], M[1, 0]])
        rows.append(np.array(columns).T / np.repeat([0.0005, 0.0035], 3)[:, None])
    s = np.sqrt(np.diag(np.linalg.inv(sum(J.T @ J for J in rows))))
    angle = np.array([name.endswith("_rad") for name in w.coefficients])
    got = next(x for x in w.expected if x.acquisition == "dopt")
    assert got.angle_rad == pytest.approx(s[angle].max(), rel=1e-3)
    assert got.length_m == pytest.approx(s[~angle].max(), rel=1e-3)
    assert got.pos_m < next(x for x in w.expected if x.acquisition == "random").pos_m


def test_information_names_what_a_small_space_cannot_identify(committed):
    """Six times the same pose: 6 equations. Twelve with joints 1 to 5 frozen: J1.phi acts like others."""
    w = space.expected_information(view(few(committed, [7] * 6)), TABLES, (6,))
    assert w.rank == 6
    assert len(w.unidentifiable) == 22
    assert not w.ok
    frozen = few(committed, [7] * 14)
    rng = np.random.default_rng(2)
    for i in range(14):
        frozen.cand[i].q_seed[5] += rng.uniform(-0.5, 0.5)
        frozen.cand[i].q_seed[6] += rng.uniform(-0.5, 0.5)
    w = space.expected_information(view(frozen), TABLES, (14,))
    assert not w.ok
    # axes 1 to 5 never moved: only 6 + the wrist's own can be identified; the others name what imitates them
    assert {n[:2] for n in w.unidentifiable} & {"J1", "J2", "J3", "J4"}
    assert any(like for like in w.unidentifiable.values())
    assert all(np.isnan(x.pos_m) for x in w.expected)


def test_a_space_too_small_for_the_model_names_what_it_cannot_identify(tmp_path):
    """Four poses give 24 equations for 28 coefficients: from description to answer by commands alone."""
    text = SPACE.read_text().replace("candidates = 300", "candidates = 4").replace("= 50000", "= 2000")
    about = tmp_path / "small.toml"
    about.write_text(text)
    table = tmp_path / "small.tbl"
    assert run("space", "build", about, table, "--tables", BIN, "--processes", 1).exit_code == 0
    done = run("space", "information", table, "--model", "none", "--tables", BIN)
    assert done.exit_code == 1
    assert "24 of 28 coefficients can be identified" in done.output
    cannot = [line.split()[0] for line in done.output.splitlines() if " cannot: " in line]
    w = space.expected_information(space.SpaceTable.load(table)[1], TABLES)
    assert len(cannot) == 4
    assert set(cannot) == set(w.unidentifiable) <= set(w.coefficients)


def test_effects_that_a_space_cannot_tell_apart_are_named(committed):
    chosen = list(range(0, 300, 15))
    a = space.separability(view(committed), load("arm"), "wam", chosen, space.Noise())
    assert a.tested > 10
    assert "encoder_bias" in a.undetectable  # a bias is a DH error of the joint
    assert a.harm_m[0][1] >= a.harm_m[-1][1] > 0.0


def test_figures_count_every_sample_once(tmp_path, monkeypatch):
    desc = DESC.model_copy(update={"candidates": 6, "samples": 200, "initial_poses": 2})
    built = space.build(desc, BIN, processes=1)
    samples = [(s.p_m, s.rejection) for s in built.samples]
    outcome = space_figures.outcome(samples, built.rejected, built.n_samples, built.table.n_candidates)
    assert sum(len(x) for x in outcome.dropped_m.values()) == sum(built.rejected.values())
    assert sum(n for _, n in outcome.counts) == built.n_samples
    azimuth, elevation, spin = space_figures.directions(built.table.candidates().poses.R)
    assert np.all(np.abs(elevation) <= 90)
    assert np.all(np.abs(spin) <= 180)
    assert len(azimuth) == 6
    cands = built.table.candidates()
    scene = space.scene(built.table, load("arm"), load("camera"))
    shown = space_figures.Candidates(scene, cands.poses.R, [0] * 6, [1] * 6, np.zeros(6), np.ones(6))
    page = pages.page("Made-up space", [("what", "value")], shown, outcome, Provenance("2026-11-22"))
    monkeypatch.setattr(image, "save", list)  # `space show` below draws
    files, why = pages.write_all(page, shown, outcome, tmp_path / "s.png")
    assert (files[1:], why) == ([tmp_path / "s.png"], "")
    assert "servo bound" in files[0].read_text()


def test_check_says_when_the_table_states_other_errors_than_the_description(committed, checks):
    table = few(committed, [0, 5])
    table.verified[2].phi_rad = 0.3
    with space.WorkerPool(checks, 1) as pool:
        (what,) = space.recheck(checks, pool, view(table)).node_problems
    assert "verified for phi_rad [0.1, 0.1, 0.3," in what and "error_bounds [0.1, 0.1, 0.1," in what


def test_every_kind_of_rejection_has_its_group_in_the_figures():
    groups = {space_figures.group(kind.with_detail("a - b")) for kind in space.Reason}
    assert groups == {label for label, _, _ in space_figures.GROUPS}
    with pytest.raises(ValueError, match="no such reason"):
        space.kind_of("no such reason")


def test_commands_answer_with_text_and_status(tmp_path, committed):
    small = tmp_path / "small.tbl"
    image = tables.encode("space", few(committed, [7, 8, 9, 10]))
    link.write_image(image, small)
    where = ("--tables", BIN)
    about = ("--description", SPACE)
    table = BIN / "space.tbl"
    done = run("space", "explain", table, 0, *where, *about)
    assert done.exit_code == 0
    assert "segment from hub" in done.output
    done = run("space", "explain", table, "--at", 2, 2, 2, "--samples", 20, *where, *about)
    assert done.exit_code == 1
    assert "0 of 20" in done.output
    assert run("space", "explain", table, *where, *about).exit_code == 2
    assert run("space", "check", small, "--processes", 1, *where, *about).exit_code == 0
    done = run("space", "show", table, *where, "--picture", tmp_path / "p.png")
    assert done.exit_code == 0
    assert "phi 0.10 0.10 0.10 0.10 0.15 0.15 1.30 rad, alpha 0.40 rad, a 30.00 mm, d 20.00" in " ".join(
        done.output.split()
    )
    assert "0.60 0.25 0.60 0.80 1.10 0.90 1.60 rad" in done.output
    assert re.search(r"built for the arm table here +yes", done.output)
    assert (tmp_path / "p.png").stat().st_size > 30_000
    assert "kept: 300" in (tmp_path / "p.html").read_text()
    assert run("space", "diff", table, table, *where).exit_code == 0
    assert run("space", "diff", table, small, *where).exit_code == 1
    done = run("space", "information", small, "--model", "none", *where)
    assert done.exit_code == 1
    assert "cannot" in done.output
    assert run("space", "information", BIN / "arm.tbl", *where).exit_code == 2
