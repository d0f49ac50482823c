"""A base that swings with time is found although nobody states the noise."""

from dataclasses import replace

import numpy as np
import poses
import pytest

from kincal import workbench as wb
from kincal.workbench.comparison.compare import compare
from kincal.workbench.diagnosis.study import Study
from kincal.workbench.evidence.smooth import smooth_effect
from kincal.workbench.evidence.swing import swing
from kincal.workbench.fit.least_squares import fit_model
from kincal.workbench.model.unnamed_names import UnnamedName

PERIODS, SHIFT_M, TURN_RAD = 2.6, 1e-3, 1e-3


@pytest.fixture(scope="module")
def still(tmp_path_factory):
    """Poses whose noise nobody states."""
    path = poses.poses_csv(tmp_path_factory.mktemp("data") / "poses.csv", 60, 41, noise_size=0.3)
    return replace(wb.read_csv(path, 7), cov=None)


@pytest.fixture(scope="module")
def swinging(still):
    wave = np.sin(2.0 * np.pi * PERIODS * (still.t_s - still.t_s[0]) / np.ptp(still.t_s) + 0.7)
    moved = np.cross([0.0, 0.0, TURN_RAD], still.p_m) + SHIFT_M * np.array([0.6, -0.3, 0.7])
    return replace(still, p_m=still.p_m + wave[:, None] * moved)


def test_a_wave_is_found_beyond_doubt_or_not_at_all(arm, still, swinging):
    assert swing(fit_model(arm, still)) is None
    found = swing(fit_model(arm, swinging))
    rate = found.parameters[0].terms[0].basis[0].c1
    assert rate * np.ptp(still.t_s) / (2.0 * np.pi) == pytest.approx(PERIODS, abs=0.3)


def test_noise_that_is_estimated_does_not_hide_a_swing(arm, library, swinging):
    """The covariance of residuals holds the swing: "nothing is missing" had P = .92."""
    study = Study.of(compare(arm, swinging), library, (), True)
    found = study.posterior(())
    top = found.top_unnamed.best
    assert found.none < 1e-6 and found.unnamed > 0.99
    assert (top.location, top.drivers) == ("base translation", ("t",))
    one = smooth_effect(UnnamedName("base translation", ("t",)), study.held_scorer(()))
    assert one.family == "2.5 periods in the session"
    assert study.held_gain((), one.hypothesis).gains
