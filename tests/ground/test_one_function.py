"""Waves of a joint or one smooth function of its angle, a base that drifts or wanders: which is it?"""

import re
from dataclasses import replace

import numpy as np
import poses
import pytest

from kincal import workbench as wb
from kincal.workbench.comparison.compare import compare
from kincal.workbench.diagnosis.one_function import without_pieces
from kincal.workbench.diagnosis.states import Kept
from kincal.workbench.diagnosis.study import Study
from kincal.workbench.evidence.bayes_factors import flat_p
from kincal.workbench.evidence.constants import choose_constants
from kincal.workbench.evidence.scoring import scaled_p

JOINT_4 = np.eye(7)[3]


def bump(q4):
    return 6e-3 * np.exp(-(((q4 - 1.2) / 0.45) ** 2))


def kink(q4):
    return 3e-3 * np.tanh((q4 - 0.8) / 0.2)


def two_waves(q4):
    return 3e-3 * np.cos(q4 + 0.4) + 1.5e-3 * np.cos(2.0 * q4 - 1.0)


def a_wave_and_a_ripple(q4):
    return 3e-3 * np.cos(q4 + 0.4) + 1.5e-3 * np.cos(9.0 * q4 - 1.0)


@pytest.fixture(scope="module")
def study_of(tmp_path_factory, library):
    """Studies of a WAM without gear ratios whose joint 4 has an error that follows its angle."""
    folder = tmp_path_factory.mktemp("data")
    table = poses.arm_toml(folder / "arm.toml")
    table.write_text(re.sub("gear_ratio = .*", "", table.read_text()))

    def study(error):
        def true_q(q, _direction):
            return q + JOINT_4 * error(q[3])

        path = poses.poses_csv(folder / f"{error.__name__}.csv", 80, 31, true_q, noise_size=0.3)
        return Study.of(compare(wb.read_arm(table), wb.read_csv(path, 7)), library, (), True)

    return study


@pytest.fixture(scope="module")
def study_moved(tmp_path_factory, library):
    """Studies of a WAM that the sensor sees moved (N, 3) by what it makes of the shares of the session."""
    folder = tmp_path_factory.mktemp("moved")
    arm = wb.read_arm(poses.arm_toml(folder / "arm.toml"))
    data = wb.read_csv(poses.poses_csv(folder / "poses.csv", 80, 33, noise_size=0.1), 7)
    data = replace(data, cam_p_m=None, cam_quat_wxyz=None, cov=None)

    def study(moved, **changes):
        seen = replace(data, p_m=data.p_m + moved(np.linspace(0.0, 1.0, data.n)), **changes)
        return Study.of(compare(arm, seen), library, (), True)

    return study


def walked(share):
    return np.cumsum(np.random.default_rng(8).normal(0.0, 7e-5, (len(share), 3)), axis=0)


def drifted(share):
    return np.outer(share, [5e-4, -3e-4, 2e-4])


def moved_once(share):
    return np.outer(share > 0.6, [4e-4, 3e-4, -3e-4])


def kept(study, *names):
    effects = choose_constants(study.library, names, study.base.arm, study.base.data)
    return tuple(Kept(h, "accepted", None) for h in effects)


@pytest.mark.parametrize("error", [bump, kink])
def test_pieces_of_a_smooth_function_are_not_named(study_of, error):
    study = study_of(error)
    pieces = kept(study, "encoder_harmonic2[4]", "joint_ripple[4]")
    assert without_pieces(study, pieces, {}) == ()
    before = study.posterior(())
    top = before.top_unnamed.best
    assert before.unnamed_wins and (top.location, top.drivers) == ("joint 4", ("q4",))


@pytest.mark.parametrize(
    ("error", "names"),
    [
        (two_waves, ("encoder_eccentricity[4]", "encoder_harmonic2[4]")),
        (a_wave_and_a_ripple, ("encoder_eccentricity[4]", "joint_ripple[4]")),
    ],
)
def test_waves_that_are_there_keep_their_names(study_of, error, names):
    found = without_pieces(study_of(error), given := kept(study_of(error), *names), {})
    assert [k.effect for k in found] == [k.effect for k in given]
    assert all(k.identity > 0.8 and k.ties == ("unnamed[joint 4: q4]",) for k in found)


def test_the_best_of_several_functions_pays_for_their_number(study_of):
    scorer = study_of(bump).scorer(())
    [cell] = [s for s in scorer.map(double=False) if s.name == "joint 4 | q4"]
    assert scaled_p(cell, 1.0) == pytest.approx(4.0 * flat_p(cell.score.chi2, cell.score.rank))


@pytest.mark.parametrize("names", [("base_drift",), ("base_settling",), ("base_drift", "base_step")])
def test_a_base_that_wanders_has_no_other_name(study_moved, names):
    study = study_moved(walked)
    assert without_pieces(study, kept(study, *names), {}) == ()


def test_a_base_that_wanders_has_no_other_name_where_only_the_order_of_poses_is_known(study_moved):
    """Then the variable has another name."""
    study = study_moved(walked, order_is_time=True, t_s=np.arange(80.0))
    assert without_pieces(study, kept(study, "base_drift", "base_step"), {}) == ()


@pytest.mark.parametrize(("moved", "name"), [(drifted, "base_drift"), (moved_once, "base_step")])
def test_a_base_that_drifts_or_is_moved_keeps_its_name(study_moved, moved, name):
    study = study_moved(moved)
    [found] = without_pieces(study, kept(study, name), {})
    assert found.effect.effect == name and found.identity > 0.9
