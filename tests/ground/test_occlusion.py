"""The visibility verdict of a search space against rendered frames (a part of tests/bench/occlusion.py)."""

import numpy as np
import occlusion
import pytest


@pytest.fixture(scope="module")
def search():
    return occlusion.SearchVerdicts()


@pytest.fixture(scope="module")
def arm(search):
    rendered = occlusion.RenderedArm(search.desc.sight.margin_m, coarse=2)
    yield rendered
    rendered.close()


@pytest.mark.slow
def test_frames_show_what_the_table_says_of_its_candidates(arm, search):
    rng, every_twelfth = np.random.default_rng(1), occlusion.candidates(12)
    ours = [
        v
        for i, q, stated in every_twelfth
        for v in occlusion.compare(arm, search, f"candidate {i}", q, stated, None if i % 24 else rng, None)
    ]
    assert len(ours) >= len(every_twelfth)
    for like in ("links as they are, both", "links thicker, both"):
        assert occlusion.agreement(ours, like) >= occlusion.AGREEMENT_MIN
    assert occlusion.only_rims(ours)
    assert occlusion.overstated(ours) <= 1.0 - occlusion.AGREEMENT_MIN
    asked = [v for v in ours if v.verdict and v.detected is not None]
    assert len(asked) >= 10
    assert all(v.detected for v in asked)


@pytest.mark.slow
def test_rays_and_frames_differ_about_rims_only_where_the_arm_hides_the_tag(arm, search):
    other = [
        v
        for i, q in enumerate(search.others(40, 1))
        for v in occlusion.compare(arm, search, f"other {i}", q, None, None, None)
    ]
    hidden = [v for v in other if not v.verdict]
    assert len(hidden) >= 15
    assert len(other) - len(hidden) >= 15
    assert sum(v.share < 0.5 for v in hidden) >= 5
    assert occlusion.overstated(other) <= 1.0 - occlusion.AGREEMENT_MIN
    assert occlusion.only_rims(other)


def test_what_is_not_in_the_frame_has_no_share(arm, search):
    _, q, tags = occlusion.candidates(1)[0]
    pan, tilt, _ = search.view(q)
    arm.pose(q, pan, tilt)
    assert all(arm.shares()[k] == 1.0 for k in (0, 1) if tags >> k & 1)
    arm.pose(q, pan + np.pi / 2, tilt)  # the camera looks away
    assert arm.shares() == [0.0, 0.0]


def test_criteria_fail_on_disagreement():
    in_sight = occlusion.TagVerdict("", 0, True, True, 1.0, 1.0, True)
    hidden = occlusion.TagVerdict("", 0, False, False, 0.3, 0.2, False)
    bold = occlusion.TagVerdict("", 0, True, True, 0.9, 0.9, False)
    shy = occlusion.TagVerdict("", 0, False, False, 1.0, 1.0, True)
    good = [in_sight] * 50 + [hidden] * 50
    assert all(occlusion.criteria(good, good).values())
    for bad in (bold, shy):
        assert not all(occlusion.criteria(good + [bad] * 3, good).values())
        assert not all(occlusion.criteria(good, good + [bad] * 3).values())
    assert occlusion.only_rims([shy])
    assert not occlusion.only_rims([bold])
