"""explain, check, diff, worth and the pictures of search spaces."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from test_geometry import wam

from kincal import core, link, space, tables
from kincal.cli import main
from kincal.errors import KincalError
from kincal.space import apart, explain, figures, worth

ROOT = Path(__file__).resolve().parents[2]
SRC, BIN = ROOT / "tables" / "src" / "space.toml", ROOT / "tables" / "bin"
DESC = space.read_description(SRC)


def load(kind):
    return tables.load(BIN / f"{kind}.tbl")[1]


@pytest.fixture(scope="module")
def committed():
    return load("space")


@pytest.fixture(scope="module")
def checks():
    return space.Checks(DESC, load("arm"), load("camera"))


def run(*words):
    return CliRunner().invoke(main, [str(w) for w in words])


def few(committed, ids):
    """A table with some of the candidates."""
    out = core.ffi.new("kc_space_t *", committed[0])
    out.n_cand, out.n_prior = len(ids), min(2, len(ids))
    core.ffi.memmove(out.edge, bytes(len(out.edge)), len(out.edge))
    for k, i in enumerate(ids):
        out.cand[k] = committed.cand[i]
    out.prior[0], out.prior[1] = 0, min(1, len(ids) - 1)
    return out


def test_explain_passes_a_candidate_of_the_table_and_names_what_a_moved_one_breaks(committed, checks):
    assert all(x.ok for x in explain.candidate(checks, committed, 3) if not x.check.startswith("tag "))
    moved = few(committed, [3])
    moved.cand[0].q_seed[1] += 0.9  # the shoulder leans forward: the arm goes down
    bad = [x.check for x in explain.candidate(checks, moved, 0) if not x.ok]
    assert bad
    with pytest.raises(KincalError, match="0..0"):
        explain.candidate(checks, moved, 1)


def test_explain_says_why_a_corner_is_empty(checks):
    low = explain.corner(checks, np.array([0.35, 0.45, 0.12]), 0.03, 120)
    assert low.good == 0
    assert sum(low.reasons.values()) == 120
    assert any("deck" in reason for reason in low.reasons)
    middle = explain.corner(checks, np.array([0.6, 0.0, 0.6]), 0.05, 200)
    assert middle.good > 0


def test_check_finds_a_candidate_that_was_moved_and_accepts_the_others(committed, checks):
    arm, camera = (tables.load(BIN / f"{k}.tbl")[0].data for k in ("arm", "camera"))
    table = few(committed, [0, 5, 9, 20])
    with space.Crew(checks, DESC, arm, camera, 1) as crew:
        assert explain.recheck(checks, crew, table).problems == []
        table.cand[2].q_seed[6] += 0.2
        found = explain.recheck(checks, crew, table)
    assert {i for i, _ in found.problems} == {2}
    assert any("0.0 mm and 200.0 mrad beside its pose" in what for _, what in found.problems)
    assert found.bad_hubs == []
    table.hub_q[1] = [1.8, 1.9, 0.0, 0.6, 0.0, 0.0, 0.0, 0.0]
    with space.Crew(checks, DESC, arm, camera, 1) as crew:
        found = explain.recheck(checks, crew, table)
    assert "hub 1 is too near as drawn" in found.bad_hubs[0]
    assert not found.ok
    assert found.tried == 4 * DESC.clear.leash_samples


def with_looks(table, looks):
    """The table with these (joints, bits) as first looks behind its candidates, from hub 0."""
    n = table.n_cand
    for i, (q, why) in enumerate(looks):
        table.cand[n + i] = table.cand[0]
        table.cand[n + i].q_seed[0:7] = [float(x) for x in q]
        table.cand[n + i].hub, table.cand[n + i].why = 0, why
    old = list(table.prior[0 : table.n_prior])
    table.n_cand, table.n_prior = n + len(looks), len(looks) + len(old)
    table.prior[0 : table.n_prior] = [*range(n, n + len(looks)), *old]
    return table


FIRST, SPARE = 1 << 15, 1 << 14
HOME = np.array(DESC.joints.hubs_rad[0])


def test_check_proves_first_looks_again(committed, checks):
    arm, camera = (tables.load(BIN / f"{k}.tbl")[0].data for k in ("arm", "camera"))
    table = with_looks(few(committed, [0, 5]), [(HOME, FIRST), (HOME + 0.2 * np.eye(7)[6], FIRST | SPARE)])
    with space.Crew(checks, DESC, arm, camera, 1) as crew:
        assert explain.recheck(checks, crew, table).ok
        table.cand[2].q_seed[5] += 1.2  # the wrist turns the tags away
        found = explain.recheck(checks, crew, table)
    assert found.problems == []
    (what,) = found.bad_hubs
    assert what.startswith(f"first look at [{HOME[0]:g}")
    assert "showing a tag with" in what
    table.cand[2].q_seed[5] = float(HOME[5])
    table.cand[3].q_seed[0:7] = [2.5, 1.8, 0.0, 0.4, 0.0, 0.0, 0.0]
    with space.Crew(checks, DESC, arm, camera, 1) as crew:
        (what,) = explain.recheck(checks, crew, table).bad_hubs
    assert "too near as drawn" in what


def test_first_looks_are_not_candidates_to_explain_show_or_compare(committed, checks):
    plain, looks = few(committed, [0, 1, 2]), with_looks(few(committed, [0, 1, 2]), [(HOME, FIRST)])
    with pytest.raises(KincalError, match="candidate 3 is a first look"):
        explain.candidate(checks, looks, 3)
    with pytest.raises(KincalError, match=r"0\.\.2"):
        explain.candidate(checks, looks, 4)
    numbers, incid, _ = space.describe(looks, tables.load(BIN / "arm.tbl")[0], load("camera"))
    assert (numbers.candidates, numbers.first_looks, numbers.spare, numbers.priors) == (3, 1, 0, (0, 1))
    assert (len(incid), numbers.unchecked) == (3, 0)
    assert len(space.scene(looks, load("arm"), load("camera")).candidates) == 3
    d = explain.difference(plain, looks, load("kernel"), 0)
    assert (d.same, d.only_a, d.only_b) == (3, [], [])
    assert (d.first, d.first_differ) == ((0, 1), True)
    moved = with_looks(few(committed, [0, 1, 2]), [(HOME + 0.01, FIRST)])
    assert explain.difference(looks, moved, load("kernel"), 0).first_differ
    assert not explain.difference(looks, looks, load("kernel"), 0).first_differ


def test_worth_does_not_count_first_looks(committed):
    got = [load(k) for k in ("arm", "terms", "config", "kernel")]
    ids = list(range(0, 300, 12))
    looks = [(HOME + 0.2 * np.eye(7)[j], FIRST) for j in range(7)]
    plain = worth.worth(few(committed, ids), *got, (8,))
    more = worth.worth(with_looks(few(committed, ids), looks), *got, (8,))
    assert more == plain
    assert max(more.chosen) < len(ids)


def test_diff_counts_what_changed(committed):
    kernel = load("kernel")
    a, b = few(committed, [0, 1, 2, 3]), few(committed, [2, 3, 4, 5, 6])
    d = explain.difference(a, b, kernel, 0)
    assert (d.same, d.only_a, d.only_b) == (2, [0, 1], [2, 3, 4])
    gaps = [
        min(np.linalg.norm(np.subtract(list(y.p_m), list(x.p_m))) for x in a.cand[0:4]) for y in b.cand[2:5]
    ]
    assert d.farthest_new_m == pytest.approx(max(gaps), abs=1e-6)
    assert 0.0 < d.least_covariance < 1.0


def test_worth_agrees_with_jacobians_by_differences(committed):
    """Rank and sigma of 20 poses against numpy and central differences of an independent chain."""
    w = worth.worth(committed, load("arm"), load("terms"), load("config"), load("kernel"), (20,))
    assert w.rank == 28
    assert w.ok
    h = 1e-6
    rows = []
    for i in w.chosen:
        q = np.array(list(committed.cand[i].q_seed)[:7])
        columns = []
        for name in w.asked:
            j, f = int(name[1]), name.split(".")[1].split("_")[0]
            ends = []
            for sign in (1, -1):
                ends.append(wam(q, {(j, f): sign * h})[1])
            dp = (ends[0][:3, 3] - ends[1][:3, 3]) / (2 * h)
            M = (ends[0][:3, :3] - ends[1][:3, :3]) @ ends[1][:3, :3].T / (2 * h)
            columns.append([*dp, M[2, 1], M[0, 2], M[1, 0]])
        rows.append(np.array(columns).T / np.repeat([0.0005, 0.0035], 3)[:, None])
    s = np.sqrt(np.diag(np.linalg.inv(sum(J.T @ J for J in rows))))
    angle = np.array([name.endswith("_rad") for name in w.asked])
    got = next(x for x in w.table if x.acquisition == "dopt")
    assert got.angle_rad == pytest.approx(s[angle].max(), rel=1e-3)
    assert got.length_m == pytest.approx(s[~angle].max(), rel=1e-3)
    assert got.pos_m < next(x for x in w.table if x.acquisition == "random").pos_m


def test_worth_names_what_a_small_space_cannot_identify(committed):
    """Six times the same pose: 6 equations. Twelve with joints 1 to 5 frozen: J1.phi acts like others."""
    got = {k: load(k) for k in ("arm", "terms", "config", "kernel")}
    w = worth.worth(few(committed, [7] * 6), *got.values(), (6,))
    assert w.rank == 6
    assert len(w.held) == 22
    assert not w.ok
    frozen = few(committed, [7] * 14)
    rng = np.random.default_rng(2)
    for i in range(14):
        frozen.cand[i].q_seed[5] += rng.uniform(-0.5, 0.5)
        frozen.cand[i].q_seed[6] += rng.uniform(-0.5, 0.5)
    w = worth.worth(frozen, *got.values(), (14,))
    assert not w.ok
    # axes 1 to 5 never moved: only 6 + the wrist's own can be told; every held one names its likes
    assert {n[:2] for n in w.held} & {"J1", "J2", "J3", "J4"}
    assert any(like for like in w.held.values())
    assert all(np.isnan(x.pos_m) for x in w.table)


def test_a_space_too_small_for_the_model_names_what_it_cannot_identify(tmp_path):
    """Four poses give 24 equations for 28 coefficients: from description to answer by commands alone."""
    text = SRC.read_text().replace("candidates = 300", "candidates = 4").replace("= 50000", "= 2000")
    about = tmp_path / "small.toml"
    about.write_text(text)
    table = tmp_path / "small.tbl"
    assert run("space", "build", about, table, "--tables", BIN).exit_code == 0
    done = run("space", "worth", table, "--model", "none", "--tables", BIN)
    assert done.exit_code == 1
    assert "24 of 28 coefficients can be identified" in done.output
    cannot = [line.split()[0] for line in done.output.splitlines() if " cannot: " in line]
    w = worth.worth(tables.load(table)[1], *(load(k) for k in ("arm", "terms", "config", "kernel")))
    assert len(cannot) == 4
    assert set(cannot) == set(w.held) <= set(w.asked)


def test_effects_that_a_space_cannot_tell_apart_are_named(committed):
    a = apart.apart(committed, load("arm"), "wam", list(range(0, 300, 15)), 0.0005, 0.0035)
    assert a.tested > 10
    assert "encoder_bias" in a.unseen  # a bias is a DH error of the joint
    assert a.harm_m[0][1] >= a.harm_m[-1][1] > 0.0


def test_pictures_show_every_group_and_are_written(tmp_path):
    desc = DESC.model_copy(update={"candidates": 6, "samples": 200, "priors": 2})
    built = space.build(desc, BIN, processes=1)
    assert sum(len(x) for x in figures.dropped(built)) == sum(built.rejected.values())
    assert sum(n for _, n, _ in figures.counted(built)) == built.n_samples
    azimuth, elevation, spin = figures.directions(built)
    assert np.all(np.abs(elevation) <= 90)
    assert np.all(np.abs(spin) <= 180)
    assert len(azimuth) == 6
    scene = space.scene(built.struct, load("arm"), load("camera"))
    figures.save_png(built, scene, tmp_path / "s.png", "t")
    figures.save_html(built, scene, tmp_path / "s.html", "t")
    assert (tmp_path / "s.png").read_bytes()[:4] == b"\x89PNG"
    assert "servo box" in (tmp_path / "s.html").read_text()


def test_commands_answer_with_text_and_status(tmp_path, committed):
    small = tmp_path / "small.tbl"
    image = tables.encode("space", few(committed, [7, 8, 9, 10]))
    link.write_image(image, small)
    where = ("--tables", BIN)
    about = ("--description", SRC)
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
    assert "0.60 0.25 0.60 0.80 1.10 0.90 1.60 rad" in done.output
    assert (tmp_path / "p.png").stat().st_size > 10_000
    assert "kept: 300" in (tmp_path / "p.html").read_text()
    assert run("space", "diff", table, table, *where).exit_code == 0
    assert run("space", "diff", table, small, *where).exit_code == 1
    done = run("space", "worth", small, "--model", "none", *where)
    assert done.exit_code == 1
    assert "cannot" in done.output
    assert run("space", "worth", BIN / "arm.tbl", *where).exit_code == 2
