"""Search spaces: every candidate keeps what its description promises, judged by plain numpy."""

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares
from test_geometry import wam

from kincal import space, tables
from kincal.errors import KincalError
from kincal.geometry import quat_to_R

ROOT = Path(__file__).resolve().parents[2]
SRC, BIN = ROOT / "tables" / "src" / "space.toml", ROOT / "tables" / "bin"
DESC = space.read_description(SRC)
N_FIRST = len(DESC.joints.first_rad)
FIRST, SPARE = 1 << 15, 1 << 14
SMALL = DESC.model_copy(update={"candidates": 12, "samples": 250, "seed": 5})


@pytest.fixture(scope="module")
def committed():
    return tables.load(BIN / "space.tbl")[1]


def ordinary(table):
    """Candidates that are chosen among: all but those that say they are first looks."""
    return [c for c in table.cand[0 : table.n_cand] if not c.why & FIRST]


def first_looks(table):
    return [c for c in table.cand[0 : table.n_cand] if c.why & FIRST]


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
    first = len(DESC.joints.first_rad)
    assert committed.n_cand == DESC.candidates + first
    assert committed.n_prior == DESC.priors + first


def test_every_candidate_is_reached_and_seen(committed):
    lo = np.array([-2.6, -2.0, -2.8, -0.9, -4.76, -1.6, -3.0]) + DESC.joints.margin_rad
    hi = np.array([2.6, 2.0, 2.8, 3.1, 1.24, 1.6, 3.0]) - np.array(DESC.joints.margin_rad)
    tilted = {0: (0.12, -25.0), 1: (-0.12, 25.0)}
    for c in ordinary(committed):
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


SHAPES = {s.name: s for s in DESC.shape}


def capsule_ends(q, errors=None):
    """End points of every capsule of the arm by plain numpy, stretched links included."""
    dh = np.array(
        [[0, 0, 0], [0, 0, 0], [0.045, 0, 0.55], [-0.045, 0, 0], [0, 0, 0.3], [0, 0, 0], [0, 0, 0.06]]
    )
    alpha = np.array([-1, 1, -1, 1, -1, 1, 0]) * np.pi / 2
    off = errors or {}
    T = np.eye(4)
    T[2, 3] = 0.346
    out = {}
    for j in range(7):
        c, s = (
            np.cos(q[j] + off.get(f"J{j + 1}.phi_rad", 0.0)),
            np.sin(q[j] + off.get(f"J{j + 1}.phi_rad", 0.0)),
        )
        link = T @ np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
        grow = np.array([off.get(f"J{j + 1}.a_m", 0.0), 0, off.get(f"J{j + 1}.d_m", 0.0)])
        for name, x in SHAPES.items():
            if x.joint == j + 1:
                ends = [
                    np.array(e) + (grow * e[2] / dh[j, 2] if dh[j, 2] else 0) for e in (x.start_m, x.end_m)
                ]
                out[name] = [link[:3, :3] @ e + link[:3, 3] for e in ends]
        c, s = (f(alpha[j] + off.get(f"J{j + 1}.alpha_rad", 0.0)) for f in (np.cos, np.sin))
        far = np.array([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1.0]])
        far[:3, 3] = dh[j] + grow
        T = link @ far
    return out


def nearest(a, b):
    """Distance of two segments, by trying points of both."""
    s = np.linspace(0, 1, 60)[:, None]
    x, y = a[0] + s * (a[1] - a[0]), b[0] + s * (b[1] - b[0])
    return np.min(np.linalg.norm(x[:, None] - y[None], axis=2))


def too_near(q, errors, margin, slack):
    """Capsules nearer to deck, mast or each other than the margin, by plain numpy; slack either way."""
    ends = capsule_ends(q, errors)
    mast = (np.array([-0.35, 0.45, 0.0]), np.array([-0.35, 0.45, 1.13]))
    fine = {frozenset(p) for p in DESC.touching}
    gaps = {}
    for name, e in ends.items():
        r = SHAPES[name].radius_m
        gaps[name, "mast"] = nearest(e, mast) - r - 0.03
        low = min(e, key=lambda x: x[2])
        if name not in ("turret", "shoulder") and -0.85 < low[0] < 0.15 and abs(low[1]) < 0.7:
            gaps[name, "deck"] = low[2] - r
        for other, f in ends.items():
            if other < name and frozenset((name, other)) not in fine:
                gaps[name, other] = nearest(e, f) - r - SHAPES[other].radius_m
    return {k for k, v in gaps.items() if v < margin + slack}


def test_collision_engine_agrees_with_plain_numpy_about_capsules():
    rng = np.random.default_rng(3)
    _, arm = tables.load(BIN / "arm.tbl")
    _, camera = tables.load(BIN / "camera.tbl")
    hits = 0
    for errors in ({}, {"J3.d_m": 0.15, "J7.phi_rad": 1.3}):
        bodies = space.Bodies(DESC, arm, camera, errors, 0.02)
        for _ in range(250):
            q = rng.uniform([-2.6, -2.0, -2.8, -0.9, -4.7, -1.6, -3.0], [2.6, 2.0, 2.8, 3.1, 1.2, 1.6, 3.0])
            if surely := too_near(q, errors, 0.02, -0.004):
                assert bodies.touching(q), surely
                hits += 1
            pair = bodies.touching(q)
            if pair and all(x in {**SHAPES, "mast": 0} and "tag" not in x for x in pair.split(" - ")):
                names = pair.split(" - ")
                if all(x == "mast" or SHAPES[x].radius_m and SHAPES[x].joint for x in names):
                    assert too_near(q, errors, 0.02, 0.004)
    assert hits > 30


def test_seeds_and_hub_segments_are_clear_with_errors(committed):
    errors = space.draw(DESC, 7)
    assert errors[0]["J7.phi_rad"] == 1.3  # the paper's set is one of them
    for i, c in enumerate(ordinary(committed)[::12]):
        a, b = (np.array(list(x)[:7]) for x in (committed.hub_q[c.hub], c.q_seed))
        for s in np.linspace(0, 1, 9):
            q = a + s * (b - a)
            assert not too_near(q, {}, DESC.clear.nominal_m, -0.005)
            for e in (errors[0], errors[1 + i % (len(errors) - 1)]):
                if not any(x.startswith(("J1.", "J2.", "J4.", "J6.")) and "phi" not in x for x in e):
                    assert not too_near(q, e, DESC.clear.drawn_m, -0.005)


def capsules_of(table, name):
    """Bodies of the table that stand for a capsule shape, by their ends."""
    s = SHAPES[name]
    return [
        i
        for i, b in enumerate(table.body[0 : table.n_body])
        if b.frame == s.joint and np.allclose([*b.start_m, *b.end_m], [*s.start_m, *s.end_m], atol=1e-6)
    ]


def test_bodies_that_must_not_meet_are_all_pairs_but_those_that_touch_by_design(committed):
    apart = lambda i, k: bool(committed.body[max(i, k)].apart >> min(i, k) & 1)  # noqa: E731
    fine = {frozenset(p) for p in DESC.touching}
    single = [name for name, s in SHAPES.items() if s.radius_m is not None]
    n_fine = n_apart = 0
    for a in single:
        for b in single:
            if a >= b:
                continue
            (i,), (k,) = capsules_of(committed, a), capsules_of(committed, b)
            together = frozenset((a, b)) in fine or SHAPES[a].joint == SHAPES[b].joint
            assert apart(i, k) is not together, (a, b)
            n_fine, n_apart = n_fine + together, n_apart + (not together)
    assert (n_fine > 10, n_apart > 10) == (True, True)
    # boxes on the tool are bundles of bodies that cannot move against each other
    tool = [i for i, b in enumerate(committed.body[0 : committed.n_body]) if b.frame == 0]
    assert len(tool) > 4
    assert not any(apart(i, k) for i in tool for k in tool if i != k)
    assert all(b.apart >> i == 0 for i, b in enumerate(committed.body[0 : committed.n_body]))


def test_servo_box_is_clear_with_the_papers_errors(committed):
    rng = np.random.default_rng(4)
    e = {"J7.phi_rad": 1.3, "J3.a_m": 0.01, "J3.d_m": 0.15}
    bad = n = 0
    for c in ordinary(committed)[::10]:
        for _ in range(8):
            q = np.array(list(c.q_seed)[:7]) + rng.uniform(-1, 1, 7) * list(committed.servo_leash)[:7]
            bad += bool(too_near(q, e, 0.0, 0.0))
            n += 1
    assert bad <= 0.01 * n


def test_candidates_are_spread_and_priors_are_apart(committed):
    p = np.array([list(c.p_m) for c in ordinary(committed)])
    gaps = np.linalg.norm(p[:, None] - p[None], axis=2) + np.eye(len(p))
    assert np.median(gaps.min(axis=1)) > 0.03
    # under the kernel's own metric: chosen poses are farther apart than as many taken at random
    _, kernel = tables.load(BIN / "kernel.tbl")
    R = np.array([quat_to_R(list(c.q_wxyz)) for c in ordinary(committed)])
    metric = space.Metric(kernel, DESC.spread.set, p, R)
    order = space.farthest(metric, 40, 0)
    least = lambda ids: min(metric.squared(i)[[j for j in ids if j != i]].min() for i in ids)  # noqa: E731
    drawn = [least(list(np.random.default_rng(s).choice(len(p), 40, replace=False))) for s in range(5)]
    assert least(order) > max(drawn)
    priors = p[[i for i in committed.prior[0 : committed.n_prior] if i < len(p)]]
    assert np.linalg.norm(priors[0] - priors[1]) > 0.1


def test_same_description_gives_the_same_table_and_another_seed_another():
    one, two = (space.build(SMALL, BIN).image.data for _ in range(2))
    other = space.build(SMALL.model_copy(update={"seed": 6}), BIN).image.data
    assert one == two
    assert one != other


def test_direct_edges_join_only_near_candidates(committed):
    q = np.array([list(c.q_seed)[:7] for c in ordinary(committed)])
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
    with pytest.raises(KincalError, match="most fail: too near to or far from the camera"):
        space.build(SMALL.model_copy(update={"tool": far, "samples": 60}), BIN)


def test_metric_is_the_kernel_that_flies(committed):
    from kincal import core

    _, kernel = tables.load(BIN / "kernel.tbl")
    cands = committed.cand[0:40]
    p = np.array([list(c.p_m) for c in cands])
    metric = space.Metric(kernel, 1, p, np.array([quat_to_R(list(c.q_wxyz)) for c in cands]))
    points = core.ffi.new("kc_point_t[]", 40)
    for i, c in enumerate(cands):
        points[i].p_m, points[i].q_wxyz = list(c.p_m), list(c.q_wxyz)
    k = [[core.lib.kc_kernel_eval(kernel, 1, points + i, points + j) for j in range(40)] for i in range(40)]
    got = np.array([metric.covariance(i) for i in range(40)])
    assert np.allclose(got, np.array(k) / k[0][0], atol=2e-6)


def test_helpers_do_not_change_the_table():
    desc = DESC.model_copy(update={"candidates": 5, "samples": 800, "priors": 1})
    one, two = (space.build(desc, BIN, processes=n).image.data for n in (1, 2))
    assert one == two


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("candidates = 300", "candidates = 2000", "candidates: .* 1024, got 2000"),
        ("candidates = 300", "candidate = 300", "candidate: unknown key, perhaps candidates"),
        ("incid_max_rad ", "incid_max_deg ", "view.incid_max_deg: unknown key, perhaps incid_max_rad"),
        ("incid_max_rad   = 0.873", "incid_max_rad = 50.0", r"got 50.0 \(radians: 50 deg are 0.8727\)"),
        ('kind  = "space"', 'kind  = "arm"', "not a search space"),
        ("step_rad       = 0.1", "step_rad       = 0.0", "clear.step_rad"),
        ("box_max_m = [0.95,", "box_max_m = [0.2,", "tool: no room along x: box_min_m 0.3 is not below"),
        ("box_max_m = [0.95,", "box_max_m = [950,", r"tool.box_max_m\[0\]: .*got 950"),
        ("range_min_m     = 0.4", "range_min_m     = 1.8", "range_min_m 1.8 is not below range_max_m"),
        ('"J7.phi_rad" = 1.3', '"J7.phi_deg" = 75', "survive.case: 'J7.phi_deg' is no DH error"),
        ("phi_rad   = [0.1,", "phi_rad   = [-0.1,", r"survive.phi_rad\[0\]: .*got -0.1"),
        ("half_m = [0.50, 0.70, 0.04]", "half_m = [0.50, -0.70, 0.04]", "deck: half_m must be above 0"),
        ("half_m = [0.50, 0.70, 0.04]", "radius_m = 0.5", "kind 'box' takes centre_m and half_m"),
        ('name = "shoulder"', 'name = "turret"', "two shapes or volumes are called 'turret'"),
        ("[-0.35, 0.45, 1.13]", "[-0.35, 0.45]", r"keep_out\[3\].end_m\[2\]: is missing"),
        ("seed       = 20240601", "seed       = -4", "seed"),
        (
            "spare_first = [4,",
            f"spare_first = [{N_FIRST},",
            f"spare_first {N_FIRST}: there are {N_FIRST} first looks, counted from 0",
        ),
        ("spare_first = [4,", "spare_first = [-1,", f"spare_first -1: there are {N_FIRST} first looks"),
        (
            "priors     = 3 ",
            "priors     = 8 ",
            f"8 priors and {N_FIRST} first looks; the table has room for 32",
        ),
        (
            "candidates = 300",
            "candidates = 1010",
            f"1010 candidates and {N_FIRST} first looks; room is for 1024",
        ),
    ],
)
def test_wrong_description_is_refused_by_field(tmp_path, old, new, what):
    path = tmp_path / "space.toml"
    assert old in SRC.read_text()
    path.write_text(SRC.read_text().replace(old, new, 1))
    with pytest.raises(KincalError, match=what) as refused:
        space.read_description(path)
    assert refused.value.where == str(path)


@pytest.mark.parametrize(
    ("part", "change", "what", "where"),
    [
        ("joints", {"margin_rad": [0.1, 0.1, 0.1, 2.5, 0.1, 0.1, 0.1]}, "J4 no room", "margin_rad[3]"),
        ("joints", {"servo_leash_rad": [0.4] * 6}, "6 values for an arm of 7 joints", "servo_leash_rad"),
        ("view", {"head_margin_rad": 2.0}, "leave the head no room", "head_margin_rad"),
        ("view", {"image_margin_px": 600.0}, "leave nothing of 1920 x 1080", "image_margin_px"),
        ("view", {"tags_min": 3}, "the camera table has 2", "tags_min"),
        ("survive", {"case": [{"J8.phi_rad": 0.1}]}, "the arm has 7 joints", "survive.case"),
        ("spread", {"set": 99}, "has sets 0 to 24", "spread.set"),
    ],
)
def test_description_that_does_not_fit_the_tables_says_where(part, change, what, where):
    new = getattr(SMALL, part).model_copy(update=change)
    with pytest.raises(KincalError, match=what) as refused:
        space.build(SMALL.model_copy(update={part: new}), BIN, processes=1)
    assert where in refused.value.where


def test_one_leash_stands_for_all_joints():
    joints = SMALL.joints.model_copy(update={"servo_leash_rad": 0.2})
    survive = SMALL.survive.model_copy(update={"reach": False})
    desc = SMALL.model_copy(update={"joints": joints, "survive": survive})
    built = space.build(desc, BIN, processes=1)
    assert list(built.struct.servo_leash)[:7] == pytest.approx([0.2] * 7)


def test_the_papers_arm_is_brought_to_every_candidate_inside_its_leash(committed):
    """By scipy from the chain of test_geometry, nothing of the search."""
    leash = np.array(list(committed.servo_leash)[:7])
    errors = {(7, "phi"): 1.3, (2, "alpha"): 0.4, (3, "a"): 0.01, (3, "d"): 0.15}
    lo = np.array([-2.6, -2.0, -2.8, -0.9, -4.76, -1.6, -3.0])
    hi = np.array([2.6, 2.0, 2.8, 3.1, 1.24, 1.6, 3.0])
    for c in ordinary(committed)[::30]:
        seed = np.array(list(c.q_seed)[:7])
        _, want = wam(seed)

        def off(q, want=want):
            _, T = wam(q, errors)
            turn = T[:3, :3].T @ want[:3, :3]
            rot = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
            return np.concatenate([T[:3, 3] - want[:3, 3], 0.3 * rot, [0.3 * max(0.0, 1.0 - np.trace(turn))]])

        box = np.maximum(seed - leash, lo), np.minimum(seed + leash, hi)
        starts = [seed + d for d in (np.zeros(7), np.eye(7)[6] * -1.3)]
        tried = [least_squares(off, np.clip(x, box[0] + 1e-6, box[1] - 1e-6), bounds=box) for x in starts]
        assert min(np.linalg.norm(t.fun) for t in tried) < 5e-3


def test_hub_boxes_are_as_large_as_flight_lets_joints_be_off():
    from kincal.space import checks

    header = (ROOT / "fsw/motion/kc_path.h").read_text()
    assert f"#define KC_HUB_LEASH {checks.HUB_LEASH}\n" in header


def test_margins_must_fit_the_arm():
    short = SMALL.joints.model_copy(update={"margin_rad": [0.1] * 6})
    with pytest.raises(KincalError, match="7 joints"):
        space.build(SMALL.model_copy(update={"joints": short}), BIN)


def test_committed_first_looks_are_those_of_the_description_and_lead_the_priors(committed):
    looks, n = first_looks(committed), DESC.candidates
    assert [list(c.q_seed)[:7] for c in looks] == [pytest.approx(q) for q in DESC.joints.first_rad]
    assert [i for i, c in enumerate(looks) if c.why & SPARE] == DESC.joints.spare_first
    assert list(committed.prior[0 : len(looks)]) == list(range(n, n + len(looks)))
    assert all(i < n for i in committed.prior[len(looks) : committed.n_prior])
    assert not any(c.why & SPARE for c in ordinary(committed))


def test_first_looks_are_clear_and_no_segment_leads_to_them_but_that_from_home(committed):
    errors = space.draw(DESC, 7)
    home = np.array(list(committed.hub_q[0])[:7])
    for c in first_looks(committed):
        assert (c.hub, c.tags != 0) == (0, True)
        q = np.array(list(c.q_seed)[:7])
        for s in np.linspace(0, 1, 7):
            at = home + s * (q - home)
            assert not too_near(at, {}, DESC.clear.nominal_m, -0.005)
            assert not too_near(at, errors[0], DESC.clear.drawn_m, -0.005)
    n = DESC.candidates
    bits = np.unpackbits(np.frombuffer(bytes(committed.edge), np.uint8), bitorder="little")
    assert not bits[n * (n - 1) // 2 :].any()


HOME = DESC.joints.hubs_rad[0]


def with_first(looks, spare=(), **changes):
    joints = SMALL.joints.model_copy(update={"first_rad": looks, "spare_first": list(spare)})
    return SMALL.model_copy(update={"joints": joints, **changes})


def turned(joint, by):
    return [x + by * (j == joint) for j, x in enumerate(HOME, 1)]


def test_first_looks_are_built_behind_the_candidates_and_a_table_may_have_none():
    built = space.build(
        with_first([HOME, turned(7, 0.2), turned(7, -0.2)], [2], candidates=5), BIN, processes=1
    )
    n = space.ordinary(built.struct)
    assert (built.kept, built.first_looks) == (n, 3)
    why = [c.why for c in built.struct.cand[0 : n + 3]]
    assert why == [space.WHY_ALL] * n + [FIRST, FIRST, FIRST | SPARE]
    assert list(built.struct.prior[0 : 3 + SMALL.priors])[:3] == [n, n + 1, n + 2]
    none = space.build(with_first([], candidates=5), BIN, processes=1)
    assert [list(c.q_seed) for c in none.struct.cand[0:n]] == [list(c.q_seed) for c in built.struct.cand[0:n]]
    assert (none.first_looks, none.struct.n_cand, none.struct.n_prior) == (0, n, SMALL.priors)


@pytest.mark.parametrize(
    ("look", "what"),
    [
        ([2.5, 1.8, 0.0, 0.4, 0.0, 0.0, 0.0], "first look 1 is too near as drawn: deck"),
        (turned(6, 1.2), "first look 1 is showing a tag with [0-9]+ of 45 arms"),
        (turned(7, 9.0), "first look 1 is outside the joint limits: J7"),
    ],
)
def test_first_look_that_does_not_hold_is_refused_by_number(look, what):
    with pytest.raises(KincalError, match=what) as refused:
        space.build(with_first([HOME, look]), BIN, processes=1)
    assert refused.value.where == "joints.first_rad[1]"


def test_spare_first_look_may_show_a_tag_with_fewer_of_the_wrong_arms():
    """Find a posture between both shares, then ask for it once as an ordinary and once as a spare look."""
    _, arm = tables.load(BIN / "arm.tbl")
    _, camera = tables.load(BIN / "camera.tbl")
    checks = space.Checks(SMALL, arm, camera)
    between = None
    for by in np.arange(0.3, 1.2, 0.05):
        q = np.array(turned(6, by))
        share = np.mean(checks.shown_by_wrong(q))
        if 0.5 <= share < 0.9 and not checks.hub_problem(q):
            between = q
            break
    assert between is not None
    assert "showing a tag with" in checks.first_problem(between, checks.hubs[0])
    assert checks.first_problem(between, checks.hubs[0], spare=True) == ""


def test_hub_in_the_deck_is_refused():
    low = SMALL.joints.model_copy(update={"hubs_rad": [[2.5, 1.8, 0.0, 0.4, 0.0, 0.0, 0.0]]})
    with pytest.raises(KincalError, match="hub 0 is too near as drawn: .*deck"):
        space.build(SMALL.model_copy(update={"joints": low}), BIN)


def test_space_needs_the_built_arm(tmp_path):
    with pytest.raises(KincalError, match="needs the built arm"):
        space.build(SMALL, tmp_path)
