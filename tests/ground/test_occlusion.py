"""The visibility verdict of a search space against drawn frames (a part of tests/bench/occlusion.py)."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "bench"))

import occlusion


@pytest.fixture(scope="module")
def drawn():
    d = occlusion.Drawn()
    yield d
    d.close()


@pytest.fixture(scope="module")
def says():
    return occlusion.Verdicts()


@pytest.fixture(scope="module")
def ours(drawn, says):
    rng = np.random.default_rng(1)
    return [
        j
        for i, q, _, _, stated in occlusion.candidates(12)
        for j in occlusion.judge(drawn, says, f"candidate {i}", q, stated, rng, None)
    ]


@pytest.mark.slow
def test_frames_show_what_the_table_says_of_its_candidates(ours):
    assert len(ours) >= 25
    assert occlusion.agreement(ours) >= occlusion.GATE


@pytest.mark.slow
def test_the_detector_finds_the_tags_that_the_table_says_are_in_view(ours):
    said = [j for j in ours if j.verdict]
    assert sum(j.found for j in said) >= occlusion.GATE * len(said)


@pytest.mark.slow
def test_tags_said_to_be_in_sight_are_whole_in_the_frame_where_the_arm_is_in_the_way(drawn, says):
    judged = [
        j
        for i, q in enumerate(says.others(40, 1))
        for j in occlusion.judge(drawn, says, f"other {i}", q, None, None, None)
    ]
    hidden = [j for j in judged if not j.verdict]
    assert len(hidden) >= 15
    assert len(judged) - len(hidden) >= 15
    assert not [j for j in judged if j.verdict and not j.whole]
    assert sum(j.share < 0.5 for j in hidden) >= 0.5 * len(hidden)  # hidden is not a matter of a rim


def test_what_is_not_in_the_frame_has_no_share(drawn):
    _, q, pan, tilt, tags = occlusion.candidates(1)[0]
    drawn.pose(q, pan, tilt)
    assert all(drawn.shares()[k] >= occlusion.WHOLE for k in (0, 1) if tags >> k & 1)
    drawn.pose(q, pan + np.pi / 2, tilt)  # the camera looks away
    assert drawn.shares() == [0.0, 0.0]
