"""Search spaces: every candidate keeps what its description promises, judged by plain numpy."""

from pathlib import Path

import numpy as np
import pytest
from test_geometry import wam

from kincal import space, tables
from kincal.errors import KincalError
from kincal.geometry import quat_to_R

ROOT = Path(__file__).resolve().parents[2]
SRC, BIN = ROOT / "tables" / "src" / "space.toml", ROOT / "tables" / "bin"
DESC = space.read_description(SRC)
SMALL = DESC.model_copy(update={"candidates": 12, "pool": 25, "seed": 5})


@pytest.fixture(scope="module")
def committed():
    return tables.load(BIN / "space.tbl")[1]


def look_at(p):
    """Pan, tilt and camera pose that centre p, by hand: head at the mast, camera 5 cm ahead and 3 cm up."""
    mast = np.array([-0.35, 0.45, 1.25])
    to = p - mast
    pan = np.arctan2(to[1], to[0])
    flat, drop = np.hypot(to[0], to[1]), -to[2]
    tilt = np.arctan2(drop, flat) + np.arcsin(0.03 / np.hypot(flat, drop))
    cp, sp, ct, st = np.cos(pan), np.sin(pan), np.cos(tilt), np.sin(tilt)
    Rz = np.array([[cp, -sp, 0], [sp, cp, 0], [0, 0, 1]])
    Ry = np.array([[ct, 0, st], [0, 1, 0], [-st, 0, ct]])
    head = Rz @ Ry
    R = head @ np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    return pan, tilt, mast + head @ [0.05, 0, 0.03], R


def test_committed_space_was_built_for_the_committed_arm(committed):
    assert committed.arm_crc == tables.header((BIN / "arm.tbl").read_bytes()).crc
    assert committed.n_cand == DESC.candidates
    assert committed.n_prior == DESC.priors


def test_every_candidate_is_reached_and_seen(committed):
    lo = np.array([-2.6, -2.0, -2.8, -0.9, -4.76, -1.6, -3.0]) + DESC.joints.margin_rad
    hi = np.array([2.6, 2.0, 2.8, 3.1, 1.24, 1.6, 3.0]) - np.array(DESC.joints.margin_rad)
    tilted = {0: (0.12, -25.0), 1: (-0.12, 25.0)}
    for c in committed.cand[0 : committed.n_cand]:
        q = np.array(list(c.q_seed)[:7])
        _, tool = wam(q)
        assert np.all(q >= lo - 1e-6)
        assert np.all(q <= hi + 1e-6)
        assert np.allclose(tool[:3, 3], list(c.p_m), atol=1e-5)
        assert np.allclose(tool[:3, :3], quat_to_R(list(c.q_wxyz)), atol=1e-5)
        assert np.all(tool[:3, 3] >= np.array(DESC.tool.box_min_m) - 1e-6)
        assert np.all(tool[:3, 3] <= np.array(DESC.tool.box_max_m) + 1e-6)
        pan, tilt, eye, R = look_at(tool[:3, 3])
        assert (c.pan_rad, c.tilt_rad) == pytest.approx((pan, tilt), abs=1e-5)
        assert c.tags.bit_count() >= DESC.view.tags_min
        assert c.why == space.WHY_ALL
        for tag in (k for k in (0, 1) if c.tags >> k & 1):
            x, turn = tilted[tag]
            t = np.radians(turn)
            R_tag = tool[:3, :3] @ np.array(
                [[np.cos(t), 0, np.sin(t)], [0, 1, 0], [-np.sin(t), 0, np.cos(t)]]
            )
            centre = tool[:3, 3] + tool[:3, :3] @ [x, 0, -0.02]
            incidence = np.arccos((centre - eye) @ R_tag[:, 2] / np.linalg.norm(centre - eye))
            assert incidence <= DESC.view.incid_max_rad + 1e-6
            for sx, sy in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
                at = R.T @ (centre + R_tag @ [0.03 * sx, 0.03 * sy, 0] - eye)
                u, v = 1397 * at[:2] / at[2] + [959.5, 539.5]
                m = DESC.view.image_margin_px
                assert m <= u <= 1919 - m
                assert m <= v <= 1079 - m


def test_hub_segments_stay_above_the_deck_and_off_the_mast(committed):
    for c in list(committed.cand[0 : committed.n_cand])[::10]:
        a, b = (np.array(list(x)[:7]) for x in (committed.hub_q[c.hub], c.q_seed))
        for s in np.linspace(0, 1, 25):
            frames, tool = wam(a + s * (b - a))
            points = np.array([T[:3, 3] for T in frames[1:]] + [tool[:3, 3]])
            assert points[:, 2].min() > DESC.clear.floor_m - 0.01
            low = points[points[:, 2] < 1.25]
            assert np.hypot(low[:, 0] + 0.35, low[:, 1] - 0.45).min() > DESC.clear.mast_radius_m - 0.01


def test_candidates_are_spread_and_priors_are_apart(committed):
    p = np.array([list(c.p_m) for c in committed.cand[0 : committed.n_cand]])
    gaps = np.linalg.norm(p[:, None] - p[None], axis=2) + np.eye(len(p))
    assert np.median(gaps.min(axis=1)) > 0.03
    priors = p[list(committed.prior[0 : committed.n_prior])]
    assert np.linalg.norm(priors[0] - priors[1]) > 0.1


def test_same_description_gives_the_same_table_and_another_seed_another():
    one, two = (space.build(SMALL, BIN).image.data for _ in range(2))
    other = space.build(SMALL.model_copy(update={"seed": 6}), BIN).image.data
    assert one == two
    assert one != other


def test_direct_edges_join_only_near_candidates(committed):
    q = np.array([list(c.q_seed)[:7] for c in committed.cand[0 : committed.n_cand]])
    n = 0
    for i in range(len(q)):
        for j in range(i):
            bit = i * (i - 1) // 2 + j
            if committed.edge[bit // 8] >> bit % 8 & 1:
                n += 1
                assert np.max(np.abs(q[i] - q[j])) <= DESC.clear.direct_max_rad + 1e-6
    assert n > 0


def test_impossible_description_says_what_most_samples_fail():
    far = SMALL.tool.model_copy(update={"box_min_m": (3.0, 3.0, 3.0), "box_max_m": (4.0, 4.0, 4.0)})
    with pytest.raises(KincalError, match="most fail: outside the position box"):
        space.build(SMALL.model_copy(update={"tool": far, "samples_max": 300}), BIN)


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("candidates  = 300", "candidates  = 2000", "candidates"),
        ("candidates  = 300", "candidate  = 300", "candidate"),
        ('kind  = "space"', 'kind  = "arm"', "not a search space"),
        ("step_rad       = 0.1", "step_rad       = 0.0", "clear.step_rad"),
    ],
)
def test_wrong_description_is_refused_by_field(tmp_path, old, new, what):
    path = tmp_path / "space.toml"
    path.write_text(SRC.read_text().replace(old, new))
    with pytest.raises(KincalError, match=what):
        space.read_description(path)


def test_margins_must_fit_the_arm():
    short = SMALL.joints.model_copy(update={"margin_rad": [0.1] * 6})
    with pytest.raises(KincalError, match="7 joints"):
        space.build(SMALL.model_copy(update={"joints": short}), BIN)


def test_hub_in_the_deck_is_refused():
    low = SMALL.joints.model_copy(update={"hubs_rad": [[0.0, 1.9, 0.0, 0.0, 0.0, 0.0, 0.0]]})
    with pytest.raises(KincalError, match="hub 0"):
        space.build(SMALL.model_copy(update={"joints": low}), BIN)


def test_space_needs_the_built_arm(tmp_path):
    with pytest.raises(KincalError, match="needs the built arm"):
        space.build(SMALL, tmp_path)
