"""Noise that is correlated in time is no effect, and what depends on place is no noise."""

from dataclasses import replace

import numpy as np
import poses
import pytest
from places import DATA

from kincal import workbench as wb
from kincal.workbench.data.measurements import replicate_groups
from kincal.workbench.diagnosis.heldout import HeldGain
from kincal.workbench.evidence.adequacy import find_outliers
from kincal.workbench.evidence.serial import serial_correlation
from kincal.workbench.fit.least_squares import fit_model
from kincal.workbench.prediction.crossval import stretches
from kincal.workbench.report import explain
from kincal.workbench.report.answers import diagnosis_json
from kincal.workbench.report.diagnosis_text import diagnosis_text

SIGMA_M = 3e-4
LOW, HIGH = (np.array([row[k] for row in poses.WAM]) for k in (3, 4))


def autoregressive(n, rng):
    """Each value nine tenths of the last one."""
    x = rng.normal(size=(n, 3))
    for i in range(1, n):
        x[i] = 0.9 * x[i - 1] + np.sqrt(1.0 - 0.81) * x[i]
    return x


def walk(n, rng):
    x = np.cumsum(rng.normal(size=(n, 3)), axis=0)
    return (x - x.mean(axis=0)) / x.std()


def white(n, rng):
    return rng.normal(size=(n, 3))


def measured(q, seed, noise, *, size=3.0, moved=lambda q: q, shifted_m=0.0):
    """Positions of an arm with DH errors at readings q (n, 7), with white noise and `size` times as much of
    another one."""
    rng, n = np.random.default_rng(seed), len(q)
    errors = 3e-3 * rng.normal(size=(7, 4)) / [1.0, 1.0, 3.0, 3.0]
    p_m = np.array([poses.tool_pose(row, errors)[:3, 3] for row in moved(q)]) + shifted_m
    return wb.Measurements(
        source="made up", ids=tuple(map(str, range(n))), q=q,
        p_m=p_m + SIGMA_M * (rng.normal(size=(n, 3)) + size * noise(n, rng)), t_s=10.0 * np.arange(n),
        cov=np.tile(np.diag([SIGMA_M**2] * 3 + [1e-6] * 3), (n, 1, 1)),
    )  # fmt: skip


def at_random(n, seed):
    return np.random.default_rng(seed).uniform(LOW, HIGH, (n, 7))


def eccentric(q):
    """An error of joint 2 that follows its angle."""
    out = q.copy()
    out[:, 1] += 0.006 * np.sin(q[:, 1])
    return out


def test_a_step_at_a_break_stands_beside_a_drift_across_it(arm, library):
    """A creep that goes on over the hours of a break looks like a jump there."""
    late = np.arange(90) >= 50

    def jumped(q):
        out = q.copy()
        out[late, 2] += 0.004
        return out

    data = measured(at_random(90, 4), 4, white, moved=jumped)
    d = wb.diagnose(arm, replace(data, t_s=data.t_s + 14400.0 * late), library)
    first = d.effects[0]
    assert first.name in ("bias_step[3]", "time_drift[3]")
    both = {first.name, *first.confounded_with}
    assert {"bias_step[3]", "time_drift[3]"} <= both
    assert d.verdict == "undecidable" or first.name == "bias_step[3]"


def in_model(d):
    return [e.name for e in d.effects if e.in_model]


@pytest.mark.parametrize(("noise", "seed"), [(autoregressive, 32), (walk, 31)])
def test_noise_that_is_correlated_in_time_is_no_effect(arm, library, noise, seed):
    """Up to twelve effects came, which held-out poses confirmed: their neighbours in time were fitted."""
    d = wb.diagnose(arm, measured(at_random(100, seed), seed, noise), library)
    assert in_model(d) == []
    assert d.serial is not None
    assert d.serial.share > 0.4
    assert not d.adequate_after
    said = explain.verdict(d)
    assert "correlated in time" in said and "no missing effect" not in said
    assert "the model does NOT explain these data" in diagnosis_text(d)
    assert said.endswith("take more poses, at rest.")  # they are in random order already
    assert diagnosis_json(d)["correlated_in_time"] == {"share": d.serial.share, "p_value": d.serial.p_value}


def test_an_effect_that_holds_in_stretches_stays_a_finding(arm, library):
    d = wb.diagnose(arm, measured(at_random(100, 41), 41, autoregressive, moved=eccentric), library)
    assert d.serial is not None
    assert in_model(d) == ["encoder_eccentricity[2]"]
    assert d.effects[0].held.cross_validated


@pytest.mark.parametrize(
    ("change", "name"),
    [({"moved": eccentric}, "encoder_eccentricity[2]"),
     ({"shifted_m": np.where(np.arange(100) > 60, 2e-3, 0.0)[:, None] * [1.0, -0.5, 0.5]}, "base_step")],
)  # fmt: skip
def test_an_effect_without_such_noise_is_judged_as_before(arm, library, change, name):
    """Also one that follows time: it leaves nothing that does."""
    d = wb.diagnose(arm, measured(at_random(100, 51), 51, white, size=0.0, **change), library)
    assert d.serial is None
    assert in_model(d) == [name]
    assert "correlated" not in explain.verdict(d)


def test_what_depends_on_place_is_not_taken_for_noise(arm):
    """On a path that is walked twice the next pose is near the last one, and what a model lacks is alike in
    both; so it is in the pose of the other round, and noise is not."""
    n = 140
    turn = np.linspace(0.0, 4.0 * np.pi, n)[:, None]
    q = (LOW + HIGH) / 2 + 0.4 * (HIGH - LOW) * np.sin(turn * np.arange(1, 8) + np.arange(7))
    q += np.random.default_rng(1).normal(size=q.shape) * 0.02
    lacking = fit_model(arm, measured(q, 2, white, size=0.0, moved=eccentric))
    noisy = fit_model(arm, measured(q, 2, autoregressive))
    z = lacking.z.reshape(n, -1)
    assert (z[1:] * z[:-1]).sum() > 0.5 * (z**2).sum()  # what a test of the sequence alone sees
    assert not serial_correlation(lacking).correlated
    assert serial_correlation(noisy).correlated


@pytest.mark.parametrize("name", ["fr3", "wam"])
def test_residuals_of_real_arms_are_not_taken_for_noise(name):
    table = wb.read_arm(DATA / name / f"{name}.toml")
    fit = fit_model(table, wb.read_measurements(DATA / name / f"{name}.csv", table))
    assert not serial_correlation(fit).correlated


def test_rows_in_another_order_than_that_of_measurement_say_nothing(arm):
    data = measured(at_random(60, 3), 3, walk)
    assert serial_correlation(fit_model(arm, data)).correlated
    unknown = replace(data, ids=tuple(reversed(data.ids)), order_is_time=True)
    assert not serial_correlation(fit_model(arm, unknown)).correlated


def test_stretches_follow_time_and_not_the_rows():
    t_s = np.random.default_rng(1).permutation(20).astype(float)
    data = wb.Measurements(
        "made up", tuple(map(str, range(20))), np.zeros((20, 1)), np.zeros((20, 3)), t_s=t_s
    )
    number = stretches(data, 4)
    assert [set(t_s[number == k]) for k in range(4)] == [set(range(k, k + 5)) for k in (0, 5, 10, 15)]
    assert (stretches(replace(data, t_s=None), 4) == np.repeat(np.arange(4), 5)).all()


def test_poses_with_noise_in_common_count_as_one():
    """An interval from single poses says that a gain is sure which one stretch alone has."""
    before, after = np.ones(100), np.ones(100)
    after[:10] = 0.2
    alone = HeldGain.of(before, after, cross_validated=True)
    together = HeldGain.of(before, after, np.repeat(np.arange(10), 10), cross_validated=True)
    assert alone.gains
    assert not together.gains


def test_noise_of_one_encoder_is_no_unknown_function(arm, library):
    """It moves the tool in one direction only, which a function at that joint explains better than noise of
    equal size does: it had P > .999, and predicted nothing."""

    def rattling(q):
        out = q.copy()
        out[:, 1] += np.random.default_rng(66).normal(0.0, 0.002, len(q))
        return out

    data = replace(measured(at_random(100, 66), 66, white, moved=rattling, size=0.0), cov=None)
    d = wb.diagnose(arm, data, library)
    assert d.verdict == "undecidable" and not d.adequate_after and not in_model(d)
    assert d.novel is None or (d.novel.location == "joint 2" and not d.novel.found)
    assert "no effect is shown to predict" in explain.verdict(d)


@pytest.mark.parametrize(
    ("off", "said"),
    [
        ((57, 58, 59), "it lasts"),
        ((30, 31, 33), "one after another"),
        ((56, 57), "it lasts"),
        ((10, 30, 50), ""),
    ],
)
def test_outliers_that_were_measured_one_after_another_show_when_something_happened(arm, off, said):
    """Three poses after a jump of the base were three outliers to leave out."""
    rng = np.random.default_rng(3)
    shifted_m = np.where(np.isin(np.arange(60), off)[:, None], 0.02, 0.0)
    data = measured(rng.uniform(LOW, HIGH, (60, 7)), 4, white, size=0.0, shifted_m=shifted_m)
    outliers = find_outliers(fit_model(arm, data))
    assert outliers.ids == tuple(map(str, off))
    words = explain.in_a_row(outliers)
    assert said in words and bool(words) == bool(said) and ("lasts" in words) == (max(off) > 55)
    if said:  # nor in rows of another order than that of measurement
        shuffled = replace(data.take(rng.permutation(60)), t_s=None)
        assert not find_outliers(fit_model(arm, shuffled)).in_a_row


def test_replicates_of_one_pose_in_a_row_show_a_bad_pose_and_not_when_something_happened(arm):
    """Each pose was approached twice, one of them is off both times: "something happened then"."""
    rng = np.random.default_rng(3)
    twice = np.repeat(rng.uniform(LOW, HIGH, (50, 7)), 2, axis=0) + rng.normal(0.0, 1e-5, (100, 7))
    said = []
    for off in ((40, 41), (38, 39, 40, 41)):
        shifted_m = np.where(np.isin(np.arange(100), off)[:, None], 0.02, 0.0)
        data = measured(twice, 4, white, size=0.0, shifted_m=shifted_m)
        data = replace(data, replicate=replicate_groups(data.q))
        outliers = find_outliers(fit_model(arm, data))
        assert outliers.ids == tuple(map(str, off))
        said.append(outliers.in_a_row)
    assert said == [False, True]
