"""The visibility verdict of a search space against drawn frames (a part of tests/bench/occlusion.py)."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "bench"))

import occlusion


@pytest.fixture(scope="module")
def says():
    return occlusion.Verdicts()


@pytest.fixture(scope="module")
def drawn(says):
    d = occlusion.Drawn(says.desc.sight.margin_m, coarse=2)
    yield d
    d.close()


@pytest.mark.slow
def test_frames_show_what_the_table_says_of_its_candidates(drawn, says):
    rng = np.random.default_rng(1)
    ours = [
        j
        for i, q, stated in occlusion.candidates(1)
        for j in occlusion.judge(drawn, says, f"candidate {i}", q, stated, None if i % 25 else rng, None)
    ]
    assert len(ours) >= len(occlusion.candidates(1))
    assert occlusion.agreement(ours, "verdict used, frame") >= occlusion.GATE
    assert occlusion.too_bold(ours) <= 1.0 - occlusion.GATE
    asked = [j for j in ours if j.verdict and j.found is not None]
    assert len(asked) >= 10
    assert all(j.found for j in asked)


@pytest.mark.slow
def test_rays_and_frames_differ_about_rims_only_where_the_arm_is_in_the_way(drawn, says):
    other = [
        j
        for i, q in enumerate(says.others(40, 1))
        for j in occlusion.judge(drawn, says, f"other {i}", q, None, None, None)
    ]
    hidden = [j for j in other if not j.verdict]
    assert len(hidden) >= 15
    assert len(other) - len(hidden) >= 15
    assert sum(j.share < 0.5 for j in hidden) >= 5
    assert occlusion.too_bold(other) <= 1.0 - occlusion.GATE
    assert occlusion.rims(other)


def test_what_is_not_in_the_frame_has_no_share(drawn, says):
    _, q, tags = occlusion.candidates(1)[0]
    pan, tilt, _ = says.view(q)
    drawn.pose(q, pan, tilt)
    assert all(drawn.shares()[k] == 1.0 for k in (0, 1) if tags >> k & 1)
    drawn.pose(q, pan + np.pi / 2, tilt)  # the camera looks away
    assert drawn.shares() == [0.0, 0.0]


def test_gates_fail_on_disagreement():
    in_sight = occlusion.Judged("", 0, True, True, 1.0, 1.0, True)
    hidden = occlusion.Judged("", 0, False, False, 0.3, 0.2, False)
    bold = occlusion.Judged("", 0, True, True, 0.9, 0.9, False)
    shy = occlusion.Judged("", 0, False, False, 1.0, 1.0, True)
    good = [in_sight] * 50 + [hidden] * 50
    assert all(occlusion.gates(good, good).values())
    for bad in (bold, shy):
        assert not all(occlusion.gates(good + [bad] * 3, good).values())
        assert not all(occlusion.gates(good, good + [bad] * 3).values())
    assert occlusion.rims([shy])
    assert not occlusion.rims([bold])
