"""The bench that compares ways of choosing poses: its own arithmetic."""

import itertools
import re
import sys

import numpy as np
import pytest
from places import ROOT

from kincal.link.channels import message_type
from kincal.run.inprocess import Setup, Tick, simulate

sys.path.insert(0, str(ROOT / "tests" / "bench"))

import cases  # noqa: E402
import missions  # noqa: E402
import study  # noqa: E402
import study_outside  # noqa: E402
import study_report  # noqa: E402

from kincal_sim.truth import conditions  # noqa: E402


@pytest.mark.parametrize(("first", "seeds"), [(25_251, 2), (-1, 2), (1, 0)])
def test_seeds_that_a_campaign_cannot_hold_are_named_with_the_range(first, seeds, capsys, tmp_path):
    o = cases.options("faults", "", seeds=2).parse_args(["--first", f"{first}", "--seeds", f"{seeds}"])
    o.out = tmp_path
    with pytest.raises(SystemExit) as ended:
        cases.fly(o, "faults:case", {"kind": range(99), "scenario": range(4)}, lambda *_: False)
    said = capsys.readouterr().err
    assert ended.value.code == 2 and f"first seed {first} with {seeds} seeds" in said
    assert "--first at least 0, --seeds at least 1, and together at most 25252" in said


def line(mm, mrad=None, end="change", visits=None):
    n = len(mm)
    columns = {
        "visits": visits or [*range(1, n), n - 1],
        "seconds": [10.0 * (k + 1) for k in range(n)],
        "mm": mm,
        "mrad": mrad or [0.1] * n,
    }
    return {"columns": columns, "before": [100.0, 50.0], "end": end}


@pytest.mark.parametrize(
    ("mm", "mrad", "end", "visits"),
    [
        ([9.0, 2.0, 0.9, 0.5, 0.5], None, "change", 3),
        ([9.0, 0.9, 1.1, 0.5, 0.5], None, "change", 4),  # once within, then not
        ([0.5, 0.4, 0.4], None, "no change", 1),
        ([9.0, 0.9, 0.9, 0.9], [1.0, 6.0, 4.9, 4.0], "change", 3),  # rotation later than position
        ([9.0, 0.9, 0.5, 1.2], None, "change", float("inf")),  # the proposal is worse
        ([9.0, 0.9, 0.9, 0.9], None, "aborted", float("inf")),
        ([9.0, 0.9, 0.9, 0.9], None, "poor", float("inf")),
        ([], None, "no end: out of time", float("inf")),
    ],
)
def test_an_error_counts_as_reached_from_where_it_stays_within_both_limits(mm, mrad, end, visits):
    assert study_report.cost(line(mm, mrad, end), "visits") == visits


def test_the_error_at_a_time_is_that_of_the_last_estimate_before_it():
    run = line([9.0, 2.0, 0.5, 0.4])
    found = [study_report.error_at(run, "seconds", t) for t in (9.9, 10.0, 29.0, 30.0, 1000.0)]
    assert found == [100.0, 9.0, 2.0, 0.5, 0.4]
    assert study_report.error_at(run, "seconds", 5.0, "mrad") == 50.0
    # a larger set of poses may have given fewer observations
    run["columns"]["observations"] = [4, 6, 5, 7]
    assert study_report.error_at(run, "observations", 5) == 0.5


def test_quantiles_count_runs_that_never_get_there():
    inf = float("inf")
    assert study_report.quantile([8.0, 9.0, 10.0, inf], 0.5) == 9.0
    assert study_report.quantile([8.0, 9.0, 10.0, inf], 0.9) == inf
    assert study_report.quantile([float(k) for k in range(1, 11)], 0.9) == 9.0


@pytest.mark.parametrize("name", study.SCENARIOS)
def test_a_moved_model_is_the_arm_that_would_be_built(name):
    scenario, rng = study.scenario_of(name, 3), np.random.default_rng(1)
    correction = {"J2.alpha_rad": 0.3, "J3.d_m": 0.12, "J5.a_m": -0.02, "J7.phi_rad": 1.1}
    if name == "uplinked":
        correction[missions.EFFECT] = 0.003
    moved, built = study.Believed(scenario, {"J1.phi_rad": 0.5}), missions.plant_of(scenario, correction)
    moved.correct(correction)
    for q in rng.uniform(-1.5, 1.5, (5, 7)):
        assert moved.pose(q) == pytest.approx(built.settle(conditions(scenario, q)).T_base_tool, abs=1e-11)


def test_a_perfect_correction_leaves_no_error_and_a_wrong_one_does():
    scenario = study.scenario_of("paper", 1)
    truth = study.Truth(scenario, 1)
    mm, mrad = truth.held_out(study.Believed(scenario, scenario.arm.errors))
    assert mm < 1e-6 and mrad < 1e-4
    turned = scenario.arm.errors | {"J1.phi_rad": 0.001}  # about the vertical: 1 mrad everywhere
    assert truth.held_out(study.Believed(scenario, turned))[1] == pytest.approx(1.0, rel=1e-6)


def test_errors_of_a_scenario_are_those_of_its_seed_and_inside_the_bounds():
    bounds = study.montecarlo.bounds()
    one, other = (study.scenario_of("uniform", seed).arm.errors for seed in (1, 2))
    assert one == study.scenario_of("uniform", 1).arm.errors != other
    assert all(abs(v) <= bounds[k] for k, v in one.items())
    biases = study.scenario_of("two_biases", 1).arm.encoder_bias_rad
    assert len(biases) == 2 and all(0.02 <= abs(v) <= 0.09 for v in biases.values())


def test_a_run_is_recorded_pose_by_pose():
    scenario = study.scenario_of("slipped", 5)
    witness = study.Witness(scenario, 5)
    tables = study.tables_of("slipped", "initial_design=0 n_poses=3")
    run = simulate(scenario, 5, Setup(tables=tables, acquisition="dopt"), each_tick=witness.see)
    progress, entries = run.log.last_session.progress, witness.entries
    assert len(progress) == 17 and len(entries) == 18
    assert [e["visits"] for e in entries[:-1]] == [p.pose for p in progress]
    assert entries[-1]["observations"] == len(run.log.last_session.measurements)
    assert [e["f"] for e in entries[:-1]] == pytest.approx([p.f for p in progress], rel=1e-4)
    # flight's own account of the same mission
    assert [e["joules"] for e in entries[:-1]] == pytest.approx([p.energy_j for p in progress], rel=0.02)
    # both measure the same distance, each with its own kinematics
    assert [e["off_mm"] for e in entries[:-1]] == pytest.approx(
        [1e3 * p.res_pos_m for p in progress], rel=0.02, abs=0.02
    )
    assert witness.before[1] > 30.0 > 5.0 > entries[-1]["mrad"]  # a bias of joint 7


@pytest.mark.parametrize(("verdict", "kept"), [("NO_CHANGE", True), ("CHANGE", False), ("POOR", False)])
def test_without_a_change_the_arm_stays_as_wrong_as_it_was(verdict, kept):
    scenario = study.scenario_of("two_biases", 5)
    witness, proposal = study.Witness(scenario, 5), message_type("proposal_t")()
    proposal.verdict = getattr(proposal, verdict)
    names = missions.names("two_biases")
    true = {f"{j}.phi_rad": -bias for j, bias in scenario.arm.encoder_bias_rad.items()}
    proposal.value[: len(names)] = [true.get(name, 0.0) for name in names]
    assert not witness.see(Tick(1, 100_000, 0, (), (("KC_PROPOSAL", proposal),)))
    assert witness.entries[-1]["mm"] == pytest.approx(witness.before[0] if kept else 0.0, rel=1e-4, abs=1e-6)


def test_a_run_that_was_refused_or_had_no_end_is_recorded_as_one():
    settings = study.settings_text({"n_poses": 3, "poses_min": 64})
    line = study.one(("dopt", settings, "slipped", 5))
    assert line["end"] not in ("change", "no change") and line["columns"]["mm"][-1] == line["before"][0]


def test_a_setting_reaches_config_and_one_that_there_is_not_is_refused():
    folder = study.tables_of("paper", study.settings_text({"est.rank_tol": 1e-5, "n_poses": 9}))
    _, config = study.codec.decode_as("config", (folder / "config.tbl").read_bytes())
    assert config.est.rank_tol == 1e-5 and config.n_poses == 9
    with pytest.raises(ValueError, match="no field 'n_pose'"):
        study.tables_of("paper", "n_pose=9")
    with pytest.raises(ValueError, match="FIELD=VALUE"):
        study.read_settings("n_poses")


# ---- designs of other makers ----------------------------------------------------------------------------


def line_fit(at):
    """Information of a measurement of a line's height at each place: rows (1, x)."""
    rows = np.stack([np.ones_like(at), at], axis=1)[:, None, :]
    return rows.transpose(0, 2, 1) @ rows


def test_detmax_finds_the_known_optimum_of_a_line():
    """For a straight line on [-1, 1] half of the measurements belong to each end."""
    at = np.array([-1.0, -1.0, -1.0, -0.6, -0.2, 0.0, 0.1, 0.5, 0.9, 1.0, 1.0, 1.0])
    chosen, value = study_outside.detmax(line_fit(at), 6, np.random.default_rng(1), starts=1)
    assert sorted(at[chosen]) == [-1.0, -1.0, -1.0, 1.0, 1.0, 1.0]
    assert value == pytest.approx(np.log(36.0), abs=1e-4)


def test_detmax_finds_the_best_of_all_sets():
    """Small enough to try every set."""
    rng = np.random.default_rng(3)
    rows = rng.standard_normal((12, 2, 5))
    matrices = rows.transpose(0, 2, 1) @ rows
    every = [list(c) for c in itertools.combinations(range(12), 4)]
    best = max(np.linalg.slogdet(matrices[c].sum(axis=0))[1] for c in every)
    chosen, value = study_outside.detmax(matrices, 4, rng, starts=10)
    assert value == pytest.approx(best, abs=1e-4) and len(set(chosen)) == 4


def test_the_fit_of_other_designs_has_the_kinematics_of_the_simulator():
    rng = np.random.default_rng(2)
    names = study_outside.coefficients(uplinked=False)
    q, values = rng.uniform(-1.5, 1.5, (3, 7)), rng.uniform(-0.1, 0.1, len(names))
    at = study_outside.chain(q, np.zeros(3), values)
    believed = study.Believed(study.scenario_of("paper", 1), dict(zip(names, values, strict=True)))
    for k in range(3):
        T = believed.pose(q[k])
        assert at.tool_m[k] == pytest.approx(T[:3, 3], abs=1e-12)
        assert at.R[7, k] == pytest.approx(T[:3, :3], abs=1e-12)


@pytest.mark.parametrize("name", ["paper", "uplinked", "two_biases"])
def test_measurements_of_other_designs_agree_with_the_truth_and_the_fit_finds_it(name):
    scenario, uplinked = study.scenario_of(name, 1), name == "uplinked"
    site = study_outside.Site(scenario, 1)
    measured = [m for m in map(site.measure, range(0, 60, 4)) if m is not None]
    data, names = study_outside.joined(measured), study_outside.coefficients(uplinked)
    true = dict.fromkeys(names, 0.0) | scenario.arm.errors
    true |= {f"{j}.phi_rad": -bias for j, bias in scenario.arm.encoder_bias_rad.items()}
    true |= {missions.EFFECT: sum(scenario.arm.compliance_rad_per_nm.values())}
    values = np.array([true[k] for k in names])
    assert 0.2 < np.sqrt(np.mean(data.residuals(values) ** 2)) < 1.2  # frames are averaged
    steps = 1e-6 * np.eye(len(values))
    differences = [(data.residuals(h) - data.residuals(-h)) / 2e-6 for h in steps]
    assert data.jacobian(0.0 * values) == pytest.approx(np.stack(differences, axis=2), abs=1e-3)
    found = study.Believed(scenario, study_outside.fit(data, uplinked))
    mm, mrad = study.Truth(scenario, 1).held_out(found)
    assert mm < study_report.LIMIT_MM and mrad < study_report.LIMIT_MRAD


def test_a_tag_out_of_view_is_a_visit_without_a_measurement(monkeypatch):
    site = study_outside.Site(study.scenario_of("two_biases", 1), 1)
    monkeypatch.setattr(study_outside, "sets", lambda _design, _uplinked: [[2, 3], list(range(8))])
    measure = site.measure
    site.measure = lambda k: None if k in (2, 3) else measure(k)
    monkeypatch.setattr(study_outside, "Site", lambda _scenario, _seed: site)
    line = study.one(("detmax", "", "two_biases", 1))
    assert line["columns"]["visits"] == [2, 8] and line["columns"]["observations"] == [0, 6]
    assert line["columns"]["mm"][0] == line["before"][0] > 10.0 > line["columns"]["mm"][1]
    assert np.isnan(study_report.cost(line, "seconds"))


# ---- tables and figures ---------------------------------------------------------------------------------


def flown(design, seed, mm, end="change"):
    n = len(mm)
    spent = {"visits": [*range(1, n), n - 1], "observations": [*range(1, n), n - 1]}
    spent |= {name: [per * (k + 1) for k in range(n)] for name, per in (("seconds", 10.0), ("joules", 100.0))}
    off = {"off_mm": [*mm[:-1], None], "off_mrad": [*[1.0] * (n - 1), None], "f": [*[-0.1] * (n - 1), None]}
    which = {"design": design, "scenario": "paper", "seed": seed, "end": end, "before": [100.0, 50.0]}
    return which | {"columns": {**spent, **off, "mm": mm, "mrad": [0.1] * n}, "contacts": {}}


SLOW, FAST = [50.0, 20.0, 5.0, 0.8, 0.8], [50.0, 0.9, 0.2, 0.2]
RUNS = [
    *(flown("ucb", seed, SLOW) for seed in (1, 2, 3)),
    *(flown("random", seed, [50.0, 20.0, 0.9, 0.9]) for seed in (1, 2)),
    flown("random", 3, [50.0, 100.0], "aborted"),
    *(flown("dopt", seed, FAST) for seed in (1, 2, 3)),
]


def cells(table, first):
    return [
        c.strip() for row in table.splitlines() if row.startswith(f"| {first}") for c in row.split("|")[1:-1]
    ]


def test_tables_say_what_the_runs_cost():
    made = study.study_of(RUNS)
    costs = study_report.cost_table(made, "paper")
    assert cells(costs, "`ucb`")[1:4] == ["3 of 3", "4 / 4", "4 / 4"]
    assert cells(costs, "`random`")[1:5] == ["2 of 3", "3 / > 3", "3 / never", "30 / never"]
    assert cells(study_report.baseline_table(made), "the paper's errors | `dopt`")[2:] == [
        "3", "0", "0", "0.25", "3", "0", "0.25",
    ]  # fmt: skip
    ratios = cells(study_report.ratio_table(made), "the paper's errors | `dopt`")
    assert ratios[2:] == ["0.50", "0.50", "0.50", "0.25"]
    assert "figaroh" not in study_report.page_parts(made)["designs"]
    assert "9 missions flown. 1 ended" in study_report.endings(made)
    assert "`random`, seed 3: aborted" in study_report.endings(made)


def test_a_sign_test_leaves_out_ties():
    inf = float("inf")
    assert study_report.sign_test([(1, 2), (2, 2), (inf, inf), (3, 2), (1, inf)]) == (2, 2, 1, 1.0)
    assert study_report.sign_test([(1, 2)] * 6)[3] == pytest.approx(2.0 / 2**6)
    assert study_report.sign_test([(2, 2)]) == (0, 1, 0, 1.0)


def test_f_is_on_the_scale_of_its_run():
    assert study_report.objectives(flown("ucb", 1, SLOW)) == pytest.approx([-1.0, -0.7, -0.55, -0.508])


def test_bands_hold_the_last_estimate_of_runs_that_ended():
    runs = [flown("ucb", 1, SLOW), flown("ucb", 2, FAST)]
    made = study_report.error_band(runs, "visits")
    assert made.x.tolist() == [1.0, 2.0, 3.0, 4.0]
    assert made.low.tolist() == [50.0, 0.9, 0.2, 0.2] and made.high.tolist() == [50.0, 20.0, 5.0, 0.8]


def test_the_page_has_a_place_for_every_part_and_keeps_the_rest(tmp_path):
    page, parts = tmp_path / "STUDY.md", study_report.page_parts(study.study_of(RUNS))
    before = study.PAGE.read_text()
    page.write_text(before)
    study_report.write_page(page, parts)
    once = page.read_text()
    study_report.write_page(page, parts)
    assert page.read_text() == once != before
    outside_parts = study_report.PART.sub("", before)
    assert study_report.PART.sub("", once) == outside_parts
    with pytest.raises(ValueError, match="no part 'new'"):
        study_report.write_page(page, {"new": "x"})


def test_no_number_of_a_result_stands_outside_the_generated_parts():
    prose = study_report.PART.sub("", study.PAGE.read_text())
    assert not re.findall(r"\d[\d.]* (?:mm|mrad|s|J|%)(?!\w)", prose.replace("10 to 90 %", ""))


def test_figures_have_a_line_for_each_design():
    made = study_report.figures(study.study_of(RUNS), ROOT)
    lines = {
        path.stem: {t.legendgroup for t in figure.data if t.legendgroup} for path, figure in made.items()
    }
    assert lines["study-poses"] == lines["study-error-paper"] == {"ucb", "random", "dopt"}
    assert lines["study-f-paper"] == {"ucb", "random"}
