"""What predicts is taken, what harms is taken back; few poses carry few coefficients, many are thinned."""

import sys
from dataclasses import dataclass, replace

import numpy as np
import poses
import pytest
from scipy import stats

from kincal import workbench as wb
from kincal.workbench.diagnosis import guard
from kincal.workbench.diagnosis.guard import never_worse, without_doubtful, without_unsupported
from kincal.workbench.diagnosis.heldout import HeldGain
from kincal.workbench.diagnosis.posterior import Posterior
from kincal.workbench.diagnosis.states import Kept, Selection
from kincal.workbench.diagnosis.study import Study
from kincal.workbench.diagnosis.support import of_turns, worse_blocks
from kincal.workbench.fit.columns import Columns
from kincal.workbench.fit.least_squares import find_frames, fit_model, rms
from kincal.workbench.fit.thinning import MANY, PART, part_of, spread, thinned
from kincal.workbench.model.effects import Hypothesis
from kincal.workbench.model.parameters import DH_SIGMA
from kincal.workbench.prediction.crossval import cross_validate, folds, predicted

LIBRARY = wb.Library.load()
TWIST = np.array([0.0, 1.0, 0.0, 0.6, 0.0, 0.0, 0.0])


def wavy(q, _direction):
    """An error of joint 2 by its own angle and of joint 4 by joints 4 and 6: the second has no name."""
    return q + 4e-3 * TWIST * np.cos(q) + np.eye(7)[3] * 6e-3 * np.tanh(2 * q[3] - 2) * np.cos(q[5])


def measured(folder, n, seed, true_q=None, **options):
    arm = wb.read_arm(poses.arm_toml(folder / "arm.toml"))
    return arm, wb.read_csv(poses.poses_csv(folder / f"{n}-{seed}.csv", n, seed, true_q, **options), 7)


def frames_unknown(path):
    """An arm table that gives neither base nor tool."""
    text = path.read_text().replace("quat_wxyz = [1.0, 0.0, 0.0, 0.0]", "estimate = true")
    path.write_text("\n".join(x for x in text.splitlines() if not x.startswith("xyz_m")))
    return wb.read_arm(path)


# --------------------------------------------------------------------------- cross-validation


@pytest.mark.parametrize("frames_known", [True, False])
def test_cross_validation_is_ridge_regression_fold_by_fold(tmp_path, frames_known):
    """Oracle: scikit-learn's ridge regression on the stacked columns, each fold predicted by the others.
    Unknown frames act like DH errors: what only wide priors tell apart must not cost digits."""
    from sklearn.linear_model import Ridge

    if frames_known:
        arm, data = measured(tmp_path, 24, 3, wavy)
    else:
        _, data = measured(tmp_path, 90, 3, noise_size=0.02, position_only=True)
        arm, data = frames_unknown(tmp_path / "arm.toml"), replace(data, cov=None)
    fit = fit_model(arm, data)
    columns = Columns(fit, np.ones(data.n))
    effect = LIBRARY.find("encoder_eccentricity[2]", arm, data)[0]
    block = columns.hypothesis(effect)
    losses = cross_validate(fit, columns, [block])
    both = np.hstack([fit.J * fit.sigma_prior, 10.0 * block]) / fit.scale
    target = (fit.z + fit.J @ fit.estimate) / fit.scale
    expected = np.zeros(data.n)
    for draw in range(3):
        fold = folds(data, draw=draw)
        for k in np.unique(fold):
            held = np.repeat(fold == k, columns.c)
            ridge = Ridge(alpha=1.0, fit_intercept=False, solver="svd").fit(both[~held], target[~held])
            left = target[held] - ridge.predict(both[held])
            expected[fold == k] += (left.reshape(-1, columns.c) ** 2).sum(axis=1) / 3
    assert losses.effects[0] == pytest.approx(expected, rel=1e-8)
    assert (losses.gain[0] > 0.05) == frames_known  # there is nothing to gain without the effect
    assert (losses.sigmas[0] > 2.0) == frames_known


def test_replicates_are_held_out_together(tmp_path):
    _, data = measured(tmp_path, 30, 5)
    groups = np.repeat(np.arange(10), 3)
    fold = folds(replace(data, replicate=groups))
    assert all(len(set(fold[groups == g])) == 1 for g in range(10))
    assert len(set(fold)) > 4


# --------------------------------------------------------------------------- gains and harms


def test_gain_and_harm_are_said_by_one_interval():
    noise = np.random.default_rng(0).chisquare(3, 400)
    better = HeldGain.of(noise, 0.5 * noise, cross_validated=False)
    worse = HeldGain.of(0.5 * noise, noise, cross_validated=False)
    other = np.random.default_rng(1).chisquare(3, 400)
    open_ = HeldGain.of(noise, other, cross_validated=False)
    assert (better.gains, better.harms, better.worse) == (True, False, False)
    assert (worse.gains, worse.harms, worse.worse) == (False, True, True)
    assert (open_.gains, open_.harms) == (False, False)
    assert better.after_m / better.before_m == pytest.approx(np.sqrt(0.5))


@dataclass
class Held:
    """A study in which every effect multiplies the held-out error; worse: effects that make a block much
    worse; known_noise: noise explains the rest."""

    factor: dict
    n: int = 60
    has_held_out: bool = True
    unnamed_wins: bool = True
    known_noise: bool = False
    worse: tuple = ()

    def explains(self, _model):
        return self.known_noise

    def worse_blocks(self, _model, h):
        return ("time block",) if h.name in self.worse else ()

    def held_square(self, model):
        return self._spread * np.prod([self.factor[h.name] ** 2 for h in model])

    @property
    def _spread(self):
        return np.random.default_rng(3).chisquare(3, self.n)

    def held_error(self, model):
        return float(np.sqrt(self.held_square(model).mean())), None

    def held_gain(self, model, h):
        others = tuple(x for x in model if x is not h)
        return HeldGain.of(self.held_square(others), self.held_square((*others, h)), cross_validated=False)

    def posterior(self, model):
        return Last(self.unnamed_wins, len(model))


@dataclass
class Last:
    """A posterior beside so many effects."""

    unnamed_wins: bool = True
    effects: int = -1


def chosen(*names):
    kept = tuple(Kept(Hypothesis(name, name, ()), "accepted", None) for name in names)
    return Selection(kept, tuple(k.effect for k in kept), None, Last())


def test_what_harms_is_taken_back_and_what_helps_stays():
    study = Held({"good": 0.7, "bad": 1.1})
    found = never_worse(study, chosen("bad", "good"), study)
    assert [k.effect.name for k in found.kept] == ["good"]
    assert [k.effect.name for k in found.taken_back] == ["bad"]
    assert found.last == Last(True, 1)


@pytest.mark.parametrize(
    "gone", [{"factor": {"bad": 0.999}}, {"worse": ("bad",)}], ids=lambda x: next(iter(x))
)
def test_what_does_not_help_poses_that_were_not_fitted_is_no_finding(gone):
    """Held-out poses or a block of poses; evidence that rests on a known noise stands."""
    factor = {"good": 0.7, "bad": 0.97} | gone.get("factor", {})
    study = Held(factor, worse=gone.get("worse", ()))
    found = never_worse(study, chosen("bad", "good"), study)
    assert [k.effect.name for k in found.kept] == ["good"]
    assert [k.effect.name for k in found.taken_back] == ["bad"]
    start = chosen("bad", "good")
    assert never_worse(study, start, replace(study, known_noise=True)) is start


def test_what_surely_does_not_help_is_taken_back_however_strong_its_evidence():
    """It was advised with P = 0.99 and "does not help" in one line."""
    bad = HeldGain(1e-3, 1e-3, (0.985, 1.02))
    gains = {"bad": bad, "turns": replace(bad, rotation=0.95), "little": replace(bad, after_m=0.996e-3),
             "open": replace(bad, interval=(0.95, 1.02))}  # fmt: skip

    class Reported(Held):
        def held_gain(self, _model, h):
            return gains[h.name]

    study = Reported({}, known_noise=True)
    found = never_worse(study, chosen(*gains), study)
    assert [k.effect.name for k in found.kept] == ["turns", "little", "open"]
    assert [k.effect.name for k in found.taken_back] == ["bad"]
    assert [g.judged for g in gains.values()] == ["does not help", *["undecided"] * 3]


def test_an_effect_that_only_turns_gains_unless_positions_lose():
    noise = np.random.default_rng(7).chisquare(3, 40)
    same = HeldGain.of(noise, noise, cross_validated=False)
    assert same.nothing
    turns = replace(same, rotation=0.9)
    assert not turns.nothing
    assert turns.ratio == pytest.approx(np.sqrt((1.0 + 0.9**2) / 2))
    assert replace(turns, after_m=1.01 * same.before_m).nothing
    assert replace(same, rotation=0.998).nothing


def test_a_model_that_only_gains_is_left_alone():
    study = Held({"good": 0.7, "fair": 0.95})
    start = chosen("good", "fair")
    assert never_worse(study, start, study) is start


def test_doubtful_effects_go_one_after_another_and_unproven_ones_have_not_won():
    class Noisy(Held):
        def held_gain(self, model, h):
            gain = super().held_gain(model, h)
            return replace(gain, interval=(gain.interval[0] * 0.9, 1.05)) if h.name == "fair" else gain

    study = Noisy({"good": 0.7, "fair": 0.97, "bad": 1.01})
    found = without_doubtful(study, chosen("good", "fair", "bad"))
    assert [(k.effect.name, k.role) for k in found.kept] == [("good", "accepted"), ("fair", "helps")]
    study.unnamed_wins = False
    found = without_doubtful(study, chosen("good", "fair", "bad"))
    assert [(k.effect.name, k.role) for k in found.kept] == [("good", "accepted"), ("fair", "accepted")]


def test_what_imitates_something_unnamed_goes_once_that_is_in_the_model(monkeypatch):
    """It was advised with P = 5e-113, in the first command."""

    class Beside(Held):
        def held_gain(self, model, h):
            found = super().held_gain(model, h)
            unnamed = any(x.name == "unnamed" for x in model)
            return replace(found, interval=(0.95, 1.05)) if unnamed and h.name in ("piece", "weak") else found

    evidence = {"piece": 1e-30, "needed": 1e-30, "weak": 0.2}
    kept = tuple(
        Kept(Hypothesis(name, name, ()), "helps", Posterior(None, (), (), (), {"none": 0.0, name: p}))
        for name, p in evidence.items()
    )
    start = Selection(kept, tuple(k.effect for k in kept), None, Last())
    monkeypatch.setattr(guard, "_top_function", lambda *_: Hypothesis("unnamed", "unnamed", ()))
    study = Beside({"piece": 0.9, "needed": 0.9, "weak": 0.9, "unnamed": 0.5})
    found = without_unsupported(study, start)
    assert [k.effect.name for k in found.kept] == ["needed", "weak"]
    assert without_unsupported(study, replace(start, last=Last(False))).kept == kept


# --------------------------------------------------------------------------- support by unseen poses


def gaining(n, gain, seed=1, columns=3):
    """Residuals of n poses, and the same with errors smaller by a share on average, by luck more or less."""
    rng = np.random.default_rng(seed)
    before = rng.normal(size=(n, columns))
    return before, before * rng.normal(1.0 - gain, 0.2, (n, 1))


def test_support_is_the_corrected_resampled_t_test():
    """Nadeau, Bengio 2003: variance of the mean of k = 5 folds times 1 + 5 / 4, Student-t with 4 degrees;
    less one standard error, since the effect was chosen."""
    before, after = gaining(80, 0.05)
    gain = ((before**2 - after**2) / (before**2).sum(axis=1).mean()).sum(axis=1)
    t = (gain.mean() / (gain.std(ddof=1) / np.sqrt(80)) - 1.0) / 1.5
    found = of_turns(before, after, 5)
    assert found.probability == pytest.approx(stats.t.cdf(t, 4))
    assert found.ratio == pytest.approx(np.sqrt((after**2).sum() / (before**2).sum()))
    # replicates of a pose err together: four of each say no more than one
    four = [np.repeat(r, 4, axis=0) for r in (before, after)]
    assert of_turns(*four, 5, np.repeat(np.arange(80), 4)).probability == pytest.approx(found.probability)
    assert of_turns(*four, 5).probability > found.probability + 0.02


def test_few_poses_support_nothing_as_surely_as_many():
    few, many = (
        np.median([of_turns(*gaining(n, 0.1, seed), 5).probability for seed in range(20)]) for n in (12, 1200)
    )
    assert few < 0.9 < 0.99 < many


def test_a_gain_of_a_few_poses_is_no_support():
    """One pose of forty gains more than all others lose."""
    before, after = np.ones((40, 3)), 1.01 * np.ones((40, 3))
    before[7], after[7] = 4.0, 1.0
    assert of_turns(before, after, 5).ratio < 0.9
    assert of_turns(before, after, 5).probability < 0.8


def test_an_effect_that_only_turns_is_supported_unless_positions_suffer():
    before, after = gaining(200, 0.2, columns=6)
    after[:, :3] = before[:, :3]
    assert of_turns(before, after, 5).probability > 0.95
    after[:, :3] = 1.06 * before[:, :3]
    assert of_turns(before, after, 5).probability < 0.05
    before, after = gaining(200, 0.2, columns=6)
    after[:, 3:] = 1.3 * before[:, 3:]
    assert of_turns(before, after, 5).probability < 0.05


def test_a_block_that_becomes_much_worse_takes_the_support_away():
    found = of_turns(*gaining(200, 0.3), 5)
    before, _ = gaining(30, 0.0)
    assert found.beside(worse_blocks({"time block": before}, {"time block": 1.05 * before})) == found
    after = {"region": before, "time block": 9 * before}
    bad = found.beside(worse_blocks({"region": before, "time block": before}, after))
    assert (bad.worse, found.worse) == (("time block",), ())
    assert bad.probability < 0.05 < 0.9 < found.probability


def test_poses_in_turns_are_predicted_linearly_as_by_new_fits(tmp_path):
    arm, data = measured(tmp_path, 120, 9, wavy)
    study = Study.of(wb.compare(arm, data), LIBRARY, (), True)
    [h] = LIBRARY.find("encoder_eccentricity[2]", arm, data)
    for model in ((), (h,)):
        fit = study.fit(model)
        linear, anew = predicted(fit, study._turns), study._predicted_in_turns(model)
        assert rms(linear) == pytest.approx(rms(anew), rel=0.01)
        assert np.abs(linear - anew).max() < 0.1 * np.abs(anew).max()
        assert rms(linear)[0] > rms(fit.evaluation.r)[0], "poses that were not fitted are predicted worse"


# --------------------------------------------------------------------------- few poses


def test_few_poses_carry_few_coefficients_and_take_turns_in_being_held_out(tmp_path):
    arm, data = measured(tmp_path, 18, 2, wavy, position_only=True)
    data = replace(data, cov=None)
    study = Study.of(wb.compare(arm, data), LIBRARY, (), True)
    freedom = study.comparison.fit_part.dof
    assert study.room(()) == int(freedom / 4)
    assert len(study.held_square(())) == 18
    found = wb.diagnose(arm, data, LIBRARY)
    assert 4 * sum(len(e.parameters) for e in found.effects if e.in_model) <= freedom
    assert found.remainder.held_pos_m <= found.comparison.rms["held"][0]
    assert all(e.held.cross_validated for e in found.effects)


def test_no_claim_is_sure_while_structure_is_left_and_noise_is_unknown(tmp_path):
    """The library lacks both effects, and nothing says how large the noise is."""
    arm, data = measured(tmp_path, 120, 4, wavy, position_only=True)
    names = [n for n in LIBRARY.effects if n.startswith(("encoder_ecc", "joint_coupling", "bearing"))]
    found = wb.diagnose(arm, replace(data, cov=None), LIBRARY.without(*names))
    assert found.comparison.p_lack_of_fit is None
    assert not found.adequate_after
    assert max((e.probability for e in found.effects), default=0.0) <= 0.9
    assert found.effects, "the best named effects are listed although something unnamed wins"
    assert found.remainder.held_pos_m <= found.comparison.rms["held"][0]


# --------------------------------------------------------------------------- many poses


def test_a_part_is_spread_over_all_conditions_and_always_the_same():
    rng = np.random.default_rng(6)
    crowd = np.vstack([rng.normal(0.0, 0.01, (500, 2)), [[3.0, 0.0], [0.0, 3.0], [-3.0, -3.0]]])
    first = spread(crowd, 4)
    assert {500, 501, 502} < set(first)
    assert list(first) == list(spread(crowd, 4))


def test_many_poses_are_searched_on_a_part_and_judged_on_all(tmp_path):
    n = MANY + 40
    wave = 4e-3 * TWIST * np.eye(7)[1]
    arm, data = measured(tmp_path, n, 8, lambda q, _: q + wave * np.cos(q), position_only=True)
    assert len(part_of(data)) == len(set(part_of(data))) == PART
    fit = fit_model(arm, data)
    few = thinned(fit)
    assert few.data.n == PART
    assert rms(few.evaluation.r)[0] == pytest.approx(rms(fit.evaluation.r)[0], rel=0.1)
    assert few.model.residuals(few.estimate) == pytest.approx(few.evaluation.r, abs=1e-12)
    found = wb.diagnose(arm, data, LIBRARY)
    assert [e.name for e in found.effects if e.accepted] == ["encoder_eccentricity[2]"]
    assert found.final.data.n == found.comparison.poses == n
    amplitude = np.hypot(*[p.value for p in found.effects[0].parameters])
    assert amplitude == pytest.approx(4e-3, rel=0.1)


# --------------------------------------------------------------------------- the fit


def test_few_poses_keep_dh_errors_near_what_a_well_built_arm_has(tmp_path, monkeypatch):
    """20 positions in which joint 4 hardly moves, base and tool unknown: what they do not determine must not
    wander, since other angles of that joint show it."""
    arm = frames_unknown(poses.arm_toml(tmp_path / "arm.toml"))
    data = replace(wb.read_csv(poses.poses_csv(tmp_path / "p.csv", 1500, 5, position_only=True), 7), cov=None)
    alike = np.abs(data.q[:, 3] - np.median(data.q[:, 3])) < 0.15
    few, others = data.take(np.flatnonzero(alike)[:20]), data.take(np.flatnonzero(~alike)[:400])
    frames = find_frames(arm, few)
    error_m, _ = rms(fit_model(arm, few, frames=frames).predict(others))
    monkeypatch.setattr(sys.modules[fit_model.__module__], "_FEW_ROWS", -1e9)  # wide priors for any number
    wide_m, _ = rms(fit_model(arm, few, frames=frames).predict(others))
    assert error_m < 0.4 * wide_m


def test_a_slipped_encoder_is_found_with_few_poses_all_the_same(tmp_path):
    """75 sigmas of what few poses expect: what the data determine is not drawn back."""
    slip_rad = 0.3
    slipped = lambda q, _: q + slip_rad * np.eye(7)[3]  # noqa: E731
    arm, data = measured(tmp_path, 14, 5, slipped, dh_size=0.0)
    fit = fit_model(arm, data)
    k = fit.names.index("J4.phi_rad")
    assert fit.estimate[k] == pytest.approx(slip_rad, abs=4.0 * fit.std_err[k])
    assert fit.std_err[k] < 2e-3


def test_many_poses_are_fitted_with_the_wide_priors(tmp_path):
    arm, data = measured(tmp_path, 40, 5)
    fit = fit_model(arm, data)
    assert fit.sigma_prior[fit.names.index("J2.alpha_rad")] == DH_SIGMA["alpha_rad"]


def test_a_fit_in_a_curved_valley_comes_to_its_end(tmp_path):
    """Positions only, base and tool unknown: damped straight steps crept along the valley and ran out."""
    arm = frames_unknown(poses.arm_toml(tmp_path / "arm.toml"))
    data = wb.read_csv(poses.poses_csv(tmp_path / "p.csv", 80, 7, dh_size=2e-2, position_only=True), 7)
    fit = fit_model(arm, replace(data, cov=None))
    assert fit.converged
    gradient = fit.J.T @ (np.repeat(fit.weight, 3) * fit.z) / fit.scale**2 - fit.estimate / fit.sigma_prior**2
    downhill = gradient * fit.sigma_prior
    inner = (fit.J * fit.sigma_prior).T * np.repeat(fit.weight, 3) @ (fit.J * fit.sigma_prior) / fit.scale**2
    left = downhill @ np.linalg.solve(inner + np.eye(len(downhill)), downhill)
    assert left < 1e-2  # units of chi^2 that an undamped step could still gain
