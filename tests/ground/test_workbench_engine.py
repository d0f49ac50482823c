"""The workbench's statistics against independent numbers, and its answers on simulated hidden effects."""

import re
from dataclasses import replace
from functools import partial

import mpmath
import numpy as np
import poses
import pytest
from places import DATA
from scipy import stats
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

from kincal import workbench as wb
from kincal.cli.text import model as text
from kincal.flight import Arm, Model, Observations, Terms
from kincal.flight import library as build
from kincal.workbench.diagnosis import additions, unnamed_effects
from kincal.workbench.diagnosis.findings import not_testable
from kincal.workbench.diagnosis.study import Study
from kincal.workbench.evidence import bayes_factors, scoring
from kincal.workbench.fit.columns import Columns
from kincal.workbench.fit.least_squares import fit_model, taken_by
from kincal.workbench.model.flight_model import flight_model
from kincal.workbench.model.uplink import term_table
from kincal.workbench.numerics.distributions import rank_sum_p
from kincal.workbench.prediction import nested
from kincal.workbench.prediction.measurable import Box, Limits
from kincal.workbench.prediction.nextposes import expected_probability, next_poses
from kincal.workbench.prediction.reachable import Reachable
from kincal.workbench.report import advice, explain
from kincal.workbench.report.answers import diagnosis_json, fit_json, fit_text
from kincal.workbench.report.diagnosis_text import diagnosis_text
from kincal_shared.errors import BadInput
from kincal_shared.schema.terms import parse_basis, split_product


def measure(tmp_path, n, seed, true_q=None, **more):
    return wb.read_csv(poses.poses_csv(tmp_path / "poses.csv", n, seed, true_q, **more), 7)


# --------------------------------------------------------------------------- evidence


def score(projector, g, z):
    """Score of one block of columns."""
    (moments,) = bayes_factors.block_moments([g], np.column_stack([projector.basis, projector.apply(z)]))
    own, cross = moments.own, moments.cross
    (found,) = bayes_factors.scores(own, projector.gram(own, cross[:, :, :-1]), cross[:, :, -1]).each()
    return found


def test_bayes_factor_equals_the_ratio_of_multivariate_normal_densities():
    rng = np.random.default_rng(1)
    rows, k, m = 60, 7, 3
    j, g = rng.normal(size=(rows, k)), rng.normal(size=(rows, m))
    z = rng.normal(size=rows) + g @ [0.3, -0.2, 0.4] + j @ rng.normal(size=k)
    projector = bayes_factors.Projector.of(j)
    s = score(projector, g, z)
    one_scale = bayes_factors.NoiseScale(np.array([1.0]), np.array([0.0]))
    got = bayes_factors.ln_bayes_factor(s.u, s.v, one_scale, np.array([0.7]), np.array([1.0]))
    none = stats.multivariate_normal(np.zeros(rows), np.eye(rows) + j @ j.T)
    full = stats.multivariate_normal(np.zeros(rows), np.eye(rows) + j @ j.T + 0.7**2 * g @ g.T)
    assert got == pytest.approx(full.logpdf(z) - none.logpdf(z), abs=1e-9)


@pytest.mark.parametrize("parameters", [1, 5, 12, 30])
def test_bayes_factor_of_many_effects_is_that_of_each(parameters):
    rng = np.random.default_rng(parameters)
    u, v = 3.0 * rng.standard_normal((7, parameters)), 10.0 * rng.random((7, parameters))
    v[0, -1] = 0.0
    noise = bayes_factors.NoiseScale.posterior(600.0, 560.0)
    share = bayes_factors.LAMBDA_WEIGHTS / bayes_factors.LAMBDA_WEIGHTS.sum()
    plain = []
    for k in range(len(u)):
        good = v[k] > 0
        terms = []
        for size, ln_share in zip(bayes_factors.LAMBDAS, np.log(share), strict=True):
            for s, ln_weight in zip(noise.s, noise.ln_weight, strict=True):
                x = size**2 * v[k, good] / s**2
                ln_bf = 0.5 * np.sum(x / (1 + x) * u[k, good] ** 2 / v[k, good] / s**2 - np.log1p(x))
                terms.append(ln_share + ln_weight + ln_bf)
        plain.append(np.logaddexp.reduce(terms))
    assert bayes_factors.ln_bayes_factor(u, v, noise) == pytest.approx(plain, rel=1e-10)
    assert bayes_factors.ln_bayes_factor(u[1], v[1], noise) == pytest.approx(plain[1], rel=1e-10)


def test_moments_of_blocks_are_those_of_projected_columns():
    rng = np.random.default_rng(3)
    projector = bayes_factors.Projector.of(rng.standard_normal((60, 9)))
    blocks = [rng.standard_normal((60, width)) for width in (5, 1, 5)]
    for m in bayes_factors.block_moments(blocks, projector.basis):
        grams = zip(*(w.gram(m.own, m.cross) for w in (projector, projector.squared)), strict=True)
        for k, (once, twice) in zip(m.places, grams, strict=True):
            left = projector.apply(blocks[k])
            assert once == pytest.approx(blocks[k].T @ left, abs=1e-12)
            assert twice == pytest.approx(left.T @ left, abs=1e-12)


def test_moments_together_have_one_width_and_none_is_lost():
    blocks = [np.full((2, width), float(k)) for k, width in enumerate([3, 5, 3] * 100)]
    parts = list(bayes_factors.block_moments(blocks, np.eye(2)))
    few = [
        bayes_factors.Moments([k], m.own[[i]], m.cross[[i]]) for m in parts for i, k in enumerate(m.places)
    ]
    for groups in (parts, list(bayes_factors.together(few))):
        assert sorted(k for group in groups for k in group.places) == list(range(300))
        assert max(len(group.places) for group in groups) == 64
        for group in groups:
            for k, cross in zip(group.places, group.cross, strict=True):
                assert np.array_equal(cross, blocks[k].T)
    assert len(list(bayes_factors.together(few))) == len(parts) == 4 + 2


def test_distance_of_a_ridge_fit_is_that_of_the_covariance_of_its_rows():
    """I - H = s^2 (s^2 I + A A')^-1, inverted whole."""
    rng = np.random.default_rng(4)
    n, c, scale = 12, 3, 0.7
    columns, z, weight = (
        rng.standard_normal((n * c, 20)),
        rng.standard_normal(n * c),
        rng.uniform(0.2, 1.0, n),
    )
    root = np.repeat(np.sqrt(weight), c)
    a = columns * root[:, None]
    left = scale**2 * np.linalg.inv(scale**2 * np.eye(n * c) + a @ a.T)
    e = left @ (root * z)
    d2 = [
        e[i : i + c] @ np.linalg.solve(left[i : i + c, i : i + c], e[i : i + c]) for i in range(0, n * c, c)
    ]
    got = scoring._ridge_distance(columns, z, weight, scale, c)
    assert got == pytest.approx(np.array(d2) / weight, rel=1e-6)


@pytest.mark.parametrize("widest", [1.0, 1e5, 1e9])
def test_hat_matrix_of_rows_near_dependence_is_exact_but_for_rounding(widest):
    """Where squares keep no digit, at 1e9, too; against 60 digits."""
    rng = np.random.default_rng(6)
    rows = rng.normal(size=(60, 8)) * np.geomspace(1e-3, widest, 8)
    rows[:, 7] = rows[:, 6] + rng.normal(size=60)
    with mpmath.workdps(60):
        a = mpmath.matrix(rows.tolist())
        hat = a * (a.T * a + mpmath.eye(8)) ** -1 * a.T
        exact = np.array([[float(hat[i, j]) for j in range(60)] for i in range(60)])
    taken = taken_by(rows)
    assert np.abs(taken @ taken.T - exact).max() < 1e-13 + 1e-15 * widest


@pytest.mark.parametrize(("n", "m"), [(3, 100), (100, 3), (8, 9), (8, 40), (9, 40), (30, 200)])
@pytest.mark.parametrize("ties", [False, True])
def test_rank_sum_test_is_that_of_scipy(n, m, ties):
    for seed in range(5):
        rng = np.random.default_rng(seed)
        x, y = rng.standard_normal(n) + 0.4 * seed, rng.standard_normal(m)
        if ties:
            x, y = x.round(1), y.round(1)
        assert rank_sum_p(x, y) == pytest.approx(stats.mannwhitneyu(x, y).pvalue, rel=1e-10)
    assert rank_sum_p(np.ones(n), np.ones(m)) == 1.0


def test_an_effect_that_dh_imitates_is_absorbed():
    rng = np.random.default_rng(2)
    j = 1e4 * rng.normal(size=(40, 5))
    projector = bayes_factors.Projector.of(j)
    inside = j @ rng.normal(size=(5, 1)) * 1e-4
    outside = rng.normal(size=(40, 1))
    assert score(projector, inside, np.zeros(40)).absorbed > 0.9999
    assert score(projector, outside, np.zeros(40)).absorbed < 0.5


def test_an_effect_that_competes_at_a_joint_is_not_called_absorbed(library):
    """Answers listed `link_gravity_tilt` as absorbed and added link_gravity_tilt[8]: at all joints of this
    real arm DH errors imitate it, at joint 2 they do not. Offsets of encoders are the very DH errors."""
    arm, data = wb.read_arm(DATA / "ur5" / "ur5.toml"), wb.read_csv(DATA / "ur5" / "ur5.csv", 6)
    study = Study.of(wb.compare(arm, data.take(np.arange(0, data.n, 8))), library, (), True)
    found = study.posterior(())
    assert "link_gravity_tilt" not in found.probability and "link_gravity_tilt[2]" in found.probability
    absorbed = {n.name for n in not_testable(study, found) if not n.needs}
    assert "encoder_bias" in absorbed
    assert not absorbed & {name.partition("[")[0] for name in found.probability}


def test_noise_scale_posterior_finds_noise_larger_than_stated():
    rng = np.random.default_rng(3)
    z = 1.5 * rng.normal(size=500)
    noise = bayes_factors.NoiseScale.posterior(float(z @ z), 500.0)
    assert (noise.s * noise.weight).sum() == pytest.approx(1.5, abs=0.1)


# --------------------------------------------------------------------------- bases and terms


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("q3", 0.7), ("q2", 0.3), ("sin(2*q[2])", np.sin(0.6)), ("sin(2*q3)", np.sin(1.4)),
        ("tanh(q3/0.5)", np.tanh(1.4)), ("temp-20", 5.0), ("cos(2*(q3-0.1))", np.cos(1.2)),
        ("step(t-100)", 1.0), ("step(t-101)", 0.0), ("expn(t/50)", np.exp(-2.0)),
        ("ln1p((t-20)/40)", np.log(3.0)), ("sq(q3)", 0.49), ("q3 * sin(q3)", 0.7 * np.sin(0.7)),
        ("2*q3 * 0.5*q3", 0.49),
    ],
)  # fmt: skip
def test_basis_language_means_what_flight_computes(arm, text, value):
    columns = {"q": [[0.0, 0.3, 0.7, 0.0, 0.0, 0.0, 0.0]], "temp_c": [25.0], "t_s": [100.0]}
    model = Model(Arm.of(arm), Terms.of([]), Observations.of_columns(columns, arm.gravity_m_s2))
    factors = [model.basis_values(basis, []) for basis in parse_basis(text, {}, "here")]
    assert np.prod(factors) == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("sinh(q3)", "sinh"), ("speed", "speed"), ("q3 * q4 * q5", "two"), ("q", "joint"), ("sin(", "read"),
        ("t2", "variable"),
    ],
)  # fmt: skip
def test_unreadable_bases_are_refused(text, word):
    with pytest.raises(wb.BadInput, match=word):
        parse_basis(text, {}, "here")


def test_products_split_only_between_bases():
    assert split_product("sin(2*q3) * q4") == ["sin(2*q3)", "q4"]
    assert split_product("2*q3") == ["2*q3"]


def test_library_holds_every_effect_of_the_contract(library):
    wanted = [
        "encoder_bias", "encoder_gain", "encoder_eccentricity", "encoder_harmonic2", "backlash",
        "joint_compliance", "link_bending", "joint_coupling", "link_thermal_growth", "joint_thermal_drift",
        "time_drift", "bias_step", "payload_sag", "base_tilt", "base_shift", "tool_shift", "camera_shift",
        "tag_scale", "range_incidence_bias", "lens_radial", "lens_decentring",
    ]  # fmt: skip
    assert set(wanted) <= set(library.effects)


def test_library_columns_are_derivatives_of_the_corrected_arm(arm, library, tmp_path):
    """Every effect: the linear column equals the central difference of the flight model."""
    data = measure(tmp_path, 8, 4, dh_size=0.0, noise_size=0.0)
    base = fit_model(arm, data, dh=False, robust=False)
    columns = Columns(base, np.ones(data.n))
    for effect in library.effects.values():
        if effect.missing(arm, data):
            continue
        h = effect.instances(arm, data)[0]
        got = columns.hypothesis(h)
        model = flight_model(arm, data, base.base, base.tool, [(p.name, p) for p in h.parameters])
        zero = np.zeros(len(h.parameters))
        for k, p in enumerate(h.parameters):
            step = zero.copy()
            step[k] = 1e-3 * p.sigma
            up, down = model.residuals(step, zero), model.residuals(-step, zero)
            want = -np.einsum("nij,nj->ni", base.whiten, up - down).ravel() / 2e-3
            np.testing.assert_allclose(
                got[:, k], want, atol=2e-5 * max(1.0, np.abs(want).max()), err_msg=effect.name
            )


# --------------------------------------------------------------------------- diagnosis


def test_clean_data_are_called_adequate(arm, library, tmp_path):
    answer = wb.diagnose(arm, measure(tmp_path, 60, 11), library)
    assert answer.verdict == "adequate"
    assert not any(e.accepted for e in answer.effects)
    assert answer.comparison.adequate


def test_unlisted_product_effect_is_mapped_to_its_joint_and_drivers(arm, library, tmp_path):
    def true_q(q, _direction):
        return q + np.array([0, 0, 8e-3 * np.tanh(q[3]) * np.cos(q[5]), 0, 0, 0, 0])

    answer = wb.diagnose(arm, measure(tmp_path, 80, 13, true_q), library)
    assert answer.verdict == "novel"
    assert answer.novel.location == "joint 3"
    assert set(answer.novel.depends_on) == {"q4", "q6"}
    assert diagnosis_json(answer)["novel"]["where"] == "joint 3"
    inputs = advice.Inputs("arm.toml", ("--data", "d.csv"))
    smooth = "kincal model add --model M.toml --arm arm.toml --data d.csv unnamed"
    assert smooth in [step.command for step in advice.next_steps(answer, (), inputs)]
    assert not answer.exhausted
    # a model that has smooth functions: more of them are advised while anything that is left can be predicted
    (added,) = wb.find_unnamed(
        arm, answer.final.data, ["unnamed[joint 3: q4, q6]"], library=library
    ).additions
    smooth_in = wb.compare(arm, answer.final.data, [added.effect.hypothesis])
    for left, exhausted in ((Reachable(1e-3, None, 0.0), True), (Reachable(1e-3, None, 0.5), False)):
        case = replace(answer, effects=(), comparison=replace(smooth_in, black_box=lambda left=left: left))
        commands = [step.command for step in advice.next_steps(case, (), inputs)]
        assert case.exhausted == exhausted
        assert (smooth in commands) != exhausted
        assert explain.verdict(case).endswith("held-out poses depend on no recorded variable.") == exhausted


def test_a_model_may_have_more_coefficients_than_flight_carries(arm, library, tmp_path):
    names = ("encoder_gain", "encoder_eccentricity", "encoder_harmonic2", "bearing_wobble")
    data = measure(tmp_path, 60, 19)
    effects = [h for name in names for h in library.find(name, arm, data)]
    fit = fit_model(arm, data, effects)
    assert len(fit.names) == 28 + 7 + 3 * 14 > build("flight").lib.KC_COEF_MAX
    assert fit.converged
    with pytest.raises(
        wb.BadInput, match=r"flight carries 64(.|\n)*encoder_eccentricity 14(.|\n)*encoder_gain 7"
    ):
        term_table(arm, effects, poses.flown())


def test_some_joints_of_an_effect_are_one_step_of_the_nested_models(arm, tmp_path):
    names = ["backlash[2,4]", "joint_coupling[1,3]"]
    nested = wb.fit(arm, measure(tmp_path, 60, 21), names).nested
    assert [m.model for m in nested.of("held-out poses")] == ["nominal", "DH", *(f"+ {n}" for n in names)]
    assert [g.effect for g in nested.gains if g.block == "poses in turns"] == names


def test_an_effect_that_does_not_help_is_said_in_so_many_words(arm, tmp_path):
    result = wb.fit(arm, measure(tmp_path, 60, 14), ["backlash[2]"])
    assert any("backlash[2] does not help" in explain.no_gain(n) for n in result.nested.no_gain)


def test_small_coefficients_are_printed_with_two_digits_of_their_standard_error(arm, tmp_path):
    result = wb.fit(arm, measure(tmp_path, 60, 14), ["backlash[2]"])
    k = result.names.index("backlash[2].h")
    for value, err, shown in (
        (6.01234e-5, 4.1e-7, ["0.00006012", "0.00000041"]),
        (0.0030221, 2.04e-5, ["0.003022", "0.000020"]),
        (0.5, 0.1, ["0.500000", "0.100000"]),
        (1.0, 0.0, ["1.000000", "0.000000"]),
    ):
        result.estimate[k], result.std_err[k] = value, err
        (line,) = (line for line in fit_text(result).splitlines() if line.startswith("backlash[2].h "))
        assert line.split() == ["backlash[2].h", *shown, "rad"]


def test_an_effect_that_makes_a_block_much_worse_is_not_recommended(arm, tmp_path):
    """A drift of joint 2 that ends when somebody homes the arm: fitted before that, it is wrong after it."""
    data = measure(tmp_path, 100, 31)
    share = np.arange(100) / 100
    drift = np.outer(np.where(share < 0.8, 0.02 * share, 0.0), np.eye(7)[1])
    result = wb.fit(arm, replace(data, q=data.q + drift), ["time_drift[2]", "backlash[4]"])
    assert result.nested.not_recommended == ("time_drift[2]",)
    [line] = explain.not_recommended(result.nested)
    assert line.startswith(
        "NOT recommended: time_drift[2]: it increases the error of the held-out time block"
    )
    assert line in fit_text(result)
    said = fit_json(result)["nested_models"]
    assert said["not_recommended"] == ["time_drift[2]"]
    assert line in said["verdicts"]


def test_unnamed_effects_that_a_fit_would_advise_against_are_not_added(arm, tmp_path, monkeypatch):
    """The drift again, as a smooth function of time: `unnamed` leaves it out, by its name it is added with
    the same words as those of the fit."""
    data = measure(tmp_path, 100, 31)
    share = np.arange(100) / 100
    drift = np.outer(np.where(share < 0.8, 0.02 * share, 0.0), np.eye(7)[1])
    data = replace(data, q=data.q + drift)
    name = "unnamed[joint 2: t]"
    asked = unnamed_effects.find_unnamed(arm, data, [name])
    assert asked.names == (name,)
    library = wb.Library.load().with_unnamed([a.effect.entry() for a in asked.additions])
    result = wb.fit(arm, data, [name], library=library)
    [line] = explain.not_recommended(result.nested)
    assert asked.against == result.nested.against
    words = line.removesuffix("; leave it out, or measure more poses where it fails")
    assert f"{words}; added as requested" in list(text.additions(asked))

    def chosen(comparison, hypotheses, **_):
        return additions.only(comparison, hypotheses, [a.effect for a in asked.additions])

    monkeypatch.setattr(unnamed_effects, "add_unnamed", chosen)
    found = unnamed_effects.find_unnamed(arm, data, ["unnamed"])
    assert (found.names, found.additions, found.all_of_them.steps) == ((), (), ())
    said = list(text.additions(found))
    assert said[0] == f"{words}; not added" and said[1].startswith("unnamed: nothing to add")
    assert found.all_of_them.held_pos_m == pytest.approx(result.comparison.errors["DH"][0], rel=1e-9)


def test_only_much_worse_blocks_and_held_out_poses_speak_against_an_effect():
    held, block = nested.HELD_OUT, "time block"
    sure, open_, tenth = (1.2, 3.0), (0.9, 3.0), (1.02, 1.09)
    cases = {
        (held, tenth, None): True, (block, tenth, None): False, (block, sure, None): True,
        (block, open_, None): False, (block, open_, (2.5, (1.8, 3.1))): True,
        (held, open_, (1.05, (1.01, 1.09))): False,
    }  # fmt: skip
    for (name, interval, rotation), want in cases.items():
        assert nested.EffectGain("x", name, 1e-3, 2e-3, 2.0, interval, rotation).advised_against == want


def test_a_joint_with_a_gear_ratio_has_its_motor_beside_joints_without(library, tmp_path):
    """One ratio was ignored, and `motor_harmonic[2]` said to need what was in the file."""
    head, *joints = poses.arm_toml(tmp_path / "arm.toml").read_text().split("[[joint]]")
    others = [re.sub(r"gear_ratio.*\n", "", joint) for joint in joints]
    (tmp_path / "one.toml").write_text("[[joint]]".join([head, others[0], joints[1], *others[2:]]))
    one = wb.read_arm(tmp_path / "one.toml")
    at = {
        name: {h.name for h in library.find(name, one, None)} for name in ("motor_harmonic", "joint_ripple")
    }
    assert at["motor_harmonic"] == {"motor_harmonic[2]"}
    assert at["joint_ripple"] == {f"joint_ripple[{j}]" for j in (1, 3, 4, 5, 6, 7)}
    with pytest.raises(BadInput, match=r"no such joint with gear_ratio"):
        library.find("motor_harmonic[3]", one, None)


def test_ripple_of_an_arm_without_gear_ratios_is_found_with_its_period(library, tmp_path):
    text = poses.arm_toml(tmp_path / "arm.toml").read_text()
    (tmp_path / "plain.toml").write_text(re.sub(r"gear_ratio.*\n", "", text))
    plain = wb.read_arm(tmp_path / "plain.toml")

    def true_q(q, _direction):
        return q + np.array([0, 0, 0, 3e-3 * np.sin(8.3 * q[3] + 0.4), 0, 0, 0])

    data = measure(tmp_path, 100, 16, true_q)
    answer = wb.diagnose(plain, data, library)
    assert answer.effects[0].name == "joint_ripple[4]"
    assert answer.effects[0].probability > 0.9
    result = wb.fit(plain, data, ["joint_ripple[4]"], library=library)
    assert result.constants["joint_ripple[4]"]["k"] == pytest.approx(8.3, abs=0.15)
    value = dict(zip(result.names, result.estimate, strict=True))
    size = np.hypot(value["joint_ripple[4].A"], value["joint_ripple[4].B"])
    assert size == pytest.approx(3e-3, rel=0.2)


def test_moment_of_a_large_step_is_found_to_the_pose_and_leaves_nothing_else(arm, library, tmp_path):
    count = iter(range(100))

    def true_q(q, _direction):
        return q + np.array([0, 0.02 * (next(count) >= 38), 0, 0, 0, 0, 0])

    answer = wb.diagnose(arm, measure(tmp_path, 100, 17, true_q), library)
    assert (answer.verdict, answer.effects[0].name) == ("effect", "bias_step[2]")
    ((name, t0_s),) = answer.final.hypotheses[0].constants
    assert name == "t0"
    assert 37 * 60.0 < t0_s < 38 * 60.0  # a pose a minute


@pytest.mark.parametrize("turned_rad", [0.0, 4e-3])
def test_orientations_in_another_frame_than_the_positions_are_said(arm, library, tmp_path, turned_rad):
    data = wb.read_csv(poses.poses_csv(tmp_path / "d.csv", 80, 9), 7)
    axis = np.array([0.6, -0.48, 0.64])
    turned = Rotation.from_rotvec(turned_rad * axis) * Rotation.from_quat(data.quat_wxyz, scalar_first=True)
    d = wb.diagnose(arm, replace(data, quat_wxyz=turned.as_quat(scalar_first=True)), library)
    said = "orientations and positions are not in one frame"
    found = d.comparison.turned
    assert (found is not None) == (turned_rad > 0.0) == (said in explain.verdict(d).lower())
    assert d.comparison.adequate == d.adequate_after == (found is None)
    if found is not None:
        assert found.rotation_rad @ axis > 0.5 * turned_rad and found.p_value < 1e-9
        assert (d.verdict, said in " ".join(explain.notes(d.comparison))) == ("undecidable", True)


def test_gross_outliers_do_not_hide_an_effect(arm, library, tmp_path):
    rng = np.random.default_rng(1)
    bad = rng.random(80) < 0.05
    count = iter(range(10**6))

    def true_q(q, direction):
        jump = 0.5 * bad[next(count) % 80]
        return q + np.array([0, jump, 0, 3e-3 * direction[3], 0, 0, 0])

    data = measure(tmp_path, 80, 15, true_q)
    answer = wb.diagnose(arm, data, library)
    assert answer.effects[0].name == "backlash[4]"
    wrong = {f"p{i}" for i in np.flatnonzero(bad)}
    assert set(answer.comparison.outliers.ids) >= wrong == set(answer.outliers.ids)
    # errors with and without them, by another fit
    part, held = answer.comparison.fit_part.data, answer.comparison.held_data
    square = (fit_model(arm, part, answer.final.hypotheses).predict(held)[:, :3] ** 2).sum(axis=1)
    usual = ~np.isin(held.ids, list(wrong))
    assert (~usual).sum() == 1
    last = answer.advised.errors[-1]
    errors_m = np.sqrt([square.mean(), square[usual].mean()])
    assert [last.pos_m, last.usual[0]] == pytest.approx(errors_m, rel=1e-6)
    assert answer.adequate_after == (len(wrong) <= 4)
    assert not replace(answer.outliers, poses=2 * len(wrong)).few
    # the text says both, the first advice is a command that leaves them out, and its error is the usual one
    assert f"1 outlier excluded: {errors_m[1] * 1e3:.3f} mm" in diagnosis_text(answer)
    step = advice.next_steps(answer, (), advice.Inputs("a.toml", ("--data", "d.csv")))[0]
    assert set(step.command.split("--exclude ")[1].split(",")) == wrong
    rest = wb.diagnose(arm, data.without(wrong), library)
    assert rest.advised.errors[-1].pos_m < 1.5 * errors_m[1] < 0.1 * errors_m[0]
    assert not rest.outliers.ids and rest.adequate_after


def test_poses_that_a_file_keeps_back_are_outliers_where_they_are_grossly_off(arm, tmp_path):
    data = measure(tmp_path, 60, 15)
    p_m = data.p_m.copy()
    p_m[57] += 0.3
    split = np.where(np.arange(60) < 40, "fit", "held")
    found = wb.compare(arm, replace(data, p_m=p_m, split=split))
    assert found.outliers.ids == ("p57",)
    assert found.rms["held"][0] > 0.05 > 0.01 > found.errors_without(found.outliers.ids)["DH"][0]


def kept_back(tmp_path, seed, moved_rad=0.0):
    """Sixty poses of which the file keeps back the last twenty, joint 3 moved before these."""
    count = iter(range(10**6))

    def true_q(q, _direction):
        return q + moved_rad * np.array([0, 0, next(count) % 60 >= 40, 0, 0, 0, 0])

    return replace(measure(tmp_path, 60, seed, true_q), split=np.where(np.arange(60) < 40, "fit", "held"))


def test_a_model_that_poses_of_the_file_refute_is_not_adequate(arm, library, tmp_path):
    """Held-out errors of 7 times the noise, and yet "nothing is missing": only fitted poses were tested."""
    answer = wb.diagnose(arm, kept_back(tmp_path, 3, 8e-3), library)
    c = answer.comparison
    assert c.p_unseen < 1e-6 and not c.adequate and not answer.adequate_after
    assert answer.verdict == "undecidable"
    assert "predicted worse than the noise" in diagnosis_text(answer)
    # Chow's test with the whole covariance of the predictions
    there = c.fit_all.at(c.held_data.take(c.held_data.are_not(c.outliers.ids)))
    z = np.einsum("nij,nj->ni", there.whiten, there.evaluation.r).ravel() / c.fit_all.scale
    jac = np.einsum("nij,njk->nik", there.whiten, there.evaluation.J).reshape(len(z), -1) / c.fit_all.scale
    f = z @ np.linalg.solve(np.eye(len(z)) + jac @ c.fit_all.cov @ jac.T, z) / len(z)
    assert c.p_unseen == pytest.approx(stats.f.sf(f, len(z), c.fit_all.dof), rel=1e-3, abs=1e-12)
    p = [wb.compare(arm, kept_back(tmp_path, seed)).p_unseen for seed in range(24)]
    assert stats.kstest(p, "uniform").pvalue > 0.05 and min(p) > 0.002


@pytest.mark.parametrize("bad", [range(55, 60), range(27, 33), (3, 17, 29, 30, 44)])
def test_outliers_that_are_alike_are_no_bad_poses(arm, library, tmp_path, bad):
    """The last poses of a session, or some in its middle: something moved, and to leave them out hides it."""
    data = measure(tmp_path, 60, 15)
    p_m = data.p_m.copy()
    p_m[list(bad)] += 0.2
    answer = wb.diagnose(arm, replace(data, p_m=p_m), library)
    alike = isinstance(bad, range)
    assert set(answer.outliers.ids) == {f"p{i}" for i in bad}
    assert (set(answer.outliers.clusters) & {"order", "t"} != set()) == alike
    text = diagnosis_text(answer)
    assert ("no missing effect" in text) is not alike
    why = [s.why for s in advice.next_steps(answer, (), advice.Inputs("a.toml", ("--data", "d.csv")))]
    assert any("would hide it" in text for text in why) is alike


def test_degrees_given_as_radians_are_suspected(arm, tmp_path):
    data = measure(tmp_path, 20, 16)
    from dataclasses import replace

    with pytest.raises(wb.BadInput, match="degrees"):
        wb.compare(arm, replace(data, q=np.degrees(data.q)))
    with pytest.raises(wb.BadInput, match="millimetres"):
        wb.compare(arm, replace(data, p_m=data.p_m * 1e3))


def test_too_few_poses_cannot_be_answered(arm, tmp_path):
    with pytest.raises(wb.CannotAnswer, match="poses"):
        wb.compare(arm, measure(tmp_path, 4, 17))


def test_next_poses_stay_inside_the_limits_and_gain_power(arm, library, tmp_path):
    data = measure(tmp_path, 30, 18)
    fit = fit_model(arm, data)
    alternatives = [library.find(n, arm, data)[0] for n in ("encoder_gain[2]", "encoder_eccentricity[2]")]
    found = next_poses(fit, alternatives, count=5, tries=60)
    low, high = (np.array([row[k] for row in poses.WAM]) for k in (3, 4))
    assert len({p.q for p in found}) == 5
    assert all(np.all(np.array(p.q) >= low) and np.all(np.array(p.q) <= high) for p in found)
    power = [p.power for p in found]
    assert power == sorted(power)
    assert [p.probability for p in found] == sorted(p.probability for p in found)
    assert 0.5 < found[0].probability < 1.0


def test_expected_probability_is_the_mean_over_normal_log_odds():
    for d2 in (0.1, 3.0, 12.0):
        log_odds = np.random.default_rng(1).normal(d2 / 2, np.sqrt(d2), 400_000)
        assert expected_probability(d2) == pytest.approx(np.mean(1 / (1 + np.exp(-log_odds))), abs=2e-3)


def test_next_poses_stay_where_poses_were_measured(arm, library, tmp_path):
    data = measure(tmp_path, 200, 19)
    # a set that was measured in one corner only
    seen = data.take(np.flatnonzero((data.p_m[:, 0] > 0.1) & (data.p_m[:, 2] > 0.4)))
    fit = fit_model(arm, seen)
    alternatives = [library.find(n, arm, seen)[0] for n in ("encoder_gain[2]", "encoder_eccentricity[2]")]
    hull = Delaunay(seen.p_m)
    centre = seen.p_m.mean(axis=0)
    for p in next_poses(fit, alternatives, count=6, tries=60):
        assert np.linalg.norm(np.array(p.tool_m) - poses.tool_pose(p.q, np.zeros((7, 4)))[:3, 3]) < 0.05
        inward = np.array(p.tool_m) + 0.02 * (centre - p.tool_m)
        assert hull.find_simplex(inward) >= 0


def test_next_poses_keep_out_of_boxes_and_in_what_else_is_possible(arm, library, tmp_path):
    data = measure(tmp_path, 60, 20)
    fit = fit_model(arm, data)
    alternatives = [library.find(n, arm, data)[0] for n in ("encoder_gain[2]", "encoder_eccentricity[2]")]
    limits = Limits(
        inside=(Box.of([2, 2, 2, -2, -2, 0.5]),),
        outside=(Box.of([0.4, -2, 0, 2, 2, 2]),),
        possible=lambda q: q[:, 0] > 0.0,
    )
    found = next_poses(fit, alternatives, count=6, tries=60, limits=limits)
    assert len(found) == 6
    for p in found:
        assert p.q[0] > 0.0
        assert p.tool_m[2] >= 0.5 - 1e-3
        assert p.tool_m[0] <= 0.4 + 1e-3


def test_poses_that_nothing_allows_and_doubled_effects_are_refused(arm, library, tmp_path):
    data = measure(tmp_path, 60, 20)
    fit = fit_model(arm, data)
    one, two = (library.find(n, arm, data)[0] for n in ("encoder_gain[2]", "encoder_eccentricity[2]"))
    with pytest.raises(wb.BadInput, match="twice"):
        next_poses(fit, [one, one])
    with pytest.raises(wb.CannotAnswer, match="inside the given boxes"):
        next_poses(fit, [one, two], tries=20, limits=Limits(inside=(Box.of([8, 8, 8, 9, 9, 9]),)))
    with pytest.raises(wb.BadInput, match="six numbers"):
        Box.of([1, 2, 3])


# --------------------------------------------------------------------------- real arms


def test_fr3_full_dh_meets_the_published_bar():
    answer = wb.compare(wb.read_arm(DATA / "fr3" / "fr3.toml"), wb.read_csv(DATA / "fr3" / "fr3.csv", 7))
    assert answer.rms["held"][0] <= 1.39e-3
    assert answer.rms["held"][1] <= 3.6e-3


def test_ur10_full_dh_meets_the_published_bar():
    answer = wb.compare(wb.read_arm(DATA / "ur10" / "ur10.toml"), wb.read_csv(DATA / "ur10" / "ur10d.csv", 6))
    assert answer.components == 3
    assert round(answer.rms["held"][0] * 1e3, 2) <= 0.39


# --------------------------------------------------------------------------- other sessions


def test_data_of_another_session_are_predicted_with_what_the_fitted_one_left(arm, library, tmp_path):
    data = measure(tmp_path, 60, 31)
    drift = 4e-3 * np.log1p((data.t_s - data.t_s.min()) / 600.0)
    drifted = replace(data, q=data.q - np.outer(drift, np.eye(7)[3]))
    fit = fit_model(arm, drifted, library.find("time_drift[4]", arm, drifted, {"tau": 600.0}))
    plain = fit_model(arm, drifted)
    assert fit.of_session == ("time_drift[4]",)
    other = replace(drifted, q=drifted.q + 1e-4, source="measured a year later")
    copy = replace(drifted, source="a copy of the file")
    np.testing.assert_array_equal(fit.predict(copy), fit.predict(drifted))
    left = replace(
        data, q=data.q - drift.max() * np.eye(7)[3], source="a year later, the joint has stayed there"
    )
    pos_m = [np.sqrt((f.predict(left)[:, :3] ** 2).sum(axis=1).mean()) for f in (fit, plain)]
    assert pos_m[0] < 0.95 * pos_m[1]  # most of it is noise
    at_end = replace(other, source=drifted.source, t_s=np.full(data.n, data.t_s.max()))
    np.testing.assert_array_equal(fit.predict(other), fit.predict(at_end))
    assert "counts what it was in the end" in explain.of_session(fit)[0]
    assert explain.of_session(plain) == []


def test_absorbed_effects_have_p_values_by_their_own_columns(arm, tmp_path):
    """Effects that granted columns imitate: all that is left of their squares is rounding."""
    fit = fit_model(arm, measure(tmp_path, 60, 7))
    rng = np.random.default_rng(5)
    granted = 1e3 * rng.standard_normal((len(fit.z), 4))
    scorer = scoring.Scorer(fit, np.ones(60), True, granted=granted)
    blocks = [1e-3 * granted @ rng.standard_normal((4, 2)) for _ in range(30)]
    score, known = bayes_factors.Score(np.ones(2), np.ones(2), 1.0, 2.0, 2), (scorer.projector, scorer.wz)
    scored = [
        scoring.Scored(f"e{k}", 0.0, score, None, partial(np.copy, block), *known)
        for k, block in enumerate(blocks)
    ]
    least, own = np.ones(scorer.null.shape[1]), []
    for block in blocks:
        q, _ = np.linalg.qr(scorer.projector.apply(block))
        least = np.minimum(least, stats.chi2.sf(((q.T @ scorer.null) ** 2).sum(axis=0), 2))
        own.append(stats.chi2.sf(((q.T @ scorer.wz) ** 2).sum() / scorer.scale**2, 2))
    want = [(np.sum(least <= p) + 1) / (len(least) + 1) for p in own]
    assert list(scoring.family_p(scorer, scored).values()) == pytest.approx(want, abs=0.01)


@pytest.mark.parametrize(
    ("turn_rad", "shift_m", "named", "beside"),
    [
        ((0.0, 0.0, 4e-3), (3e-3, -2e-3, 1e-3), "base_step", ()),
        # about the axis of joint 1: nothing in the data tells them apart
        ((0.0, 0.0, 4e-3), (0.0, 0.0, 0.0), "bias_step[1]", ("base_step",)),
    ],
)
def test_a_tracker_that_is_moved_is_no_encoder_that_jumps(library, turn_rad, shift_m, named, beside):
    """It was named bias_step[1] with P = 1, confounded with nothing. Poses of a real arm."""
    arm, data = wb.read_arm(DATA / "ur5" / "ur5.toml"), wb.read_csv(DATA / "ur5" / "ur5.csv", 6)
    data = data.take(np.sort(np.random.default_rng(2).permutation(data.n)[:50]))
    later = np.arange(50) >= 28
    moved = data.p_m @ Rotation.from_rotvec(turn_rad).as_matrix().T + shift_m
    data = replace(data, t_s=np.arange(50.0), p_m=np.where(later[:, None], moved, data.p_m))
    found = wb.diagnose(arm, data, library).effects[0]
    assert (found.name, found.accepted) == (named, True)
    assert set(beside) <= set(found.confounded_with)
    assert 27.0 < dict(found.constants)["t0"] < 28.0


def test_a_tool_that_is_knocked_is_neither_the_base_nor_an_encoder(arm, library):
    rng = np.random.default_rng(4)
    low, high = (np.array([row[k] for row in poses.WAM]) for k in (3, 4))
    q = rng.uniform(low, high, (80, 7))
    true = np.array([poses.tool_pose(row, np.zeros((7, 4))) for row in q])
    knock = np.where(np.arange(80)[:, None] < 44, 0.0, [3e-3, -2e-3, 1e-3])
    p_m = true[:, :3, 3] + np.einsum("nij,nj->ni", true[:, :3, :3], knock) + 1e-4 * rng.normal(size=(80, 3))
    data = wb.Measurements("made up", tuple(map(str, range(80))), q, p_m, t_s=np.arange(80.0))
    found = wb.diagnose(arm, data, library).effects[0]
    assert (found.name, found.accepted) == ("tool_step", True)
