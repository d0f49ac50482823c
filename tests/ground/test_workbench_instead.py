"""Another cause in the place of one that held-out poses contradict."""

from dataclasses import replace

import numpy as np
import pytest
from places import DATA
from scipy.spatial.transform import Rotation

from kincal import workbench as wb
from kincal.workbench.diagnosis.guard import never_worse
from kincal.workbench.diagnosis.instead import instead
from kincal.workbench.diagnosis.selection import select
from kincal.workbench.diagnosis.states import Kept, Selection
from kincal.workbench.diagnosis.study import Study


def _turned(angle_rad):
    """50 poses of a real arm; from the 28th on its tracker is turned about the axis of joint 1."""
    arm, data = wb.read_arm(DATA / "ur5" / "ur5.toml"), wb.read_csv(DATA / "ur5" / "ur5.csv", 6)
    data = data.take(np.sort(np.random.default_rng(2).permutation(data.n)[:50]))
    moved = data.p_m @ Rotation.from_rotvec([0.0, 0.0, angle_rad]).as_matrix().T
    later = np.arange(50)[:, None] >= 28
    return wb.compare(arm, replace(data, t_s=np.arange(50.0), p_m=np.where(later, moved, data.p_m)))


def _taken_back(study, name):
    posterior = study.posterior(())
    gone = Kept(posterior.by_name[name].best, "accepted", posterior)
    return Selection((), (), posterior, posterior, (gone,))


@pytest.fixture(scope="module")
def few(library):
    """A library of four effects."""
    names = ("base_step", "bias_step", "tool_step", "encoder_eccentricity")
    return wb.Library([library.effects[name] for name in names])


@pytest.fixture(scope="module")
def study(few):
    return Study.of(_turned(4e-3), few, (), True)


def test_what_imitates_an_effect_that_was_taken_back_takes_its_place(study):
    """A jump of an encoder was contradicted by a block of poses, and with it the base that had moved went."""
    other, found = instead(study, _taken_back(study, "bias_step[1]"), lambda _model: None, lambda s: s)
    assert found.model[0].name in ("base_step", "tool_step")
    assert found.taken_back[-1].effect.name == "bias_step[1]"
    assert "bias_step" not in {c.effect.name for c in other.competition.candidates}
    assert "bias_step" in {c.effect.name for c in study.competition.candidates}


def test_nothing_takes_the_place_of_what_was_only_taken_for_its_help(study):
    start = _taken_back(study, "bias_step[1]")
    start = replace(start, taken_back=(replace(start.taken_back[0], role="helps"),))
    other, found = instead(study, start, lambda _model: None, lambda s: s)
    assert other is study and found is start


def test_nothing_takes_a_place_where_held_out_poses_gain_nothing(few):
    calm = Study.of(_turned(0.0), few, (), True)
    found = never_worse(calm, select(calm, lambda _model: None), calm)
    start = replace(found, taken_back=_taken_back(calm, "bias_step[1]").taken_back)
    other, found = instead(calm, start, lambda _model: None, lambda s: s)
    assert other is calm and found is start
