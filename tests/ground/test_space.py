"""Search spaces: every candidate keeps what its description promises, checked by plain numpy."""

from dataclasses import replace

import numpy as np
import pytest
from places import BIN, SRC
from scipy.optimize import least_squares
from test_flight_arm import wam

from kincal import space, tables
from kincal.flight import tables as codec
from kincal.rotations import Pose, matrix_of_wxyz
from kincal_shared.errors import KincalError

SPACE = SRC / "space.toml"
DESC = space.read_description(SPACE)
N_LOCAL = len(DESC.joints.local_initial_rad)
SMALL = DESC.model_copy(update={"candidates": 12, "samples": 250, "seed": 5})


@pytest.fixture(scope="module")
def committed():
    """The struct, read without the library's view of it."""
    return tables.load(BIN / "space.tbl")[1]


LOCAL, RESERVE = 1 << 15, 1 << 14


def candidates(table):
    """Poses to choose among: all but those that say they are local initial poses."""
    return [c for c in table.cand[0 : table.n_cand] if not c.why & LOCAL]


def local_poses(table):
    return [c for c in table.cand[0 : table.n_cand] if c.why & LOCAL]


def aimed_at(p):
    """Pan, tilt and camera pose that centre p, by hand: pan-tilt unit on the mast, camera 5 cm ahead and 3 cm
    up."""
    mast = np.array([-0.35, 0.45, 1.25])
    to = p - mast
    pan = np.arctan2(to[1], to[0])
    flat, drop = np.hypot(to[0], to[1]), -to[2]
    tilt = np.arctan2(drop, flat) + np.arcsin(0.03 / np.hypot(flat, drop))
    cp, sp, ct, st = np.cos(pan), np.sin(pan), np.cos(tilt), np.sin(tilt)
    Rz = np.array([[cp, -sp, 0], [sp, cp, 0], [0, 0, 1]])
    Ry = np.array([[ct, 0, st], [0, 1, 0], [-st, 0, ct]])
    unit = Rz @ Ry
    R = unit @ np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    return pan, tilt, mast + unit @ [0.05, 0, 0.03], R


def test_committed_space_was_built_for_the_committed_arm(committed):
    assert committed.arm_crc == codec.header((BIN / "arm.tbl").read_bytes()).crc
    first = len(DESC.joints.local_initial_rad)
    assert committed.n_cand == DESC.candidates + first
    assert committed.n_initial == DESC.initial_poses + first


def test_every_candidate_is_reached_and_seen(committed):
    lo = np.array([-2.6, -2.0, -2.8, -0.9, -4.76, -1.6, -3.0]) + DESC.joints.margin_rad
    hi = np.array([2.6, 2.0, 2.8, 3.1, 1.24, 1.6, 3.0]) - np.array(DESC.joints.margin_rad)
    tilted = {0: (0.12, -25.0), 1: (-0.12, 25.0)}
    for c in candidates(committed):
        q = np.array(list(c.q_seed)[:7])
        _, tool = wam(q)
        assert np.all(q >= lo - 1e-6)
        assert np.all(q <= hi + 1e-6)
        assert np.allclose(tool[:3, 3], list(c.p_m), atol=1e-5)
        assert np.allclose(tool[:3, :3], matrix_of_wxyz(list(c.q_wxyz)), atol=1e-5)
        assert np.all(tool[:3, 3] >= np.array(DESC.tool.box_min_m) - 1e-6)
        assert np.all(tool[:3, 3] <= np.array(DESC.tool.box_max_m) + 1e-6)
        pan, tilt, eye, R = aimed_at(tool[:3, 3])
        assert (c.pan_rad, c.tilt_rad) == pytest.approx((pan, tilt), abs=1e-5)
        assert c.tags.bit_count() >= DESC.view.tags_min
        assert c.why == space.ALL_CHECKS
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
    """Distance of two segments, by trying points of the first."""
    along = b[1] - b[0]
    x = a[0] + np.linspace(0, 1, 60)[:, None] * (a[1] - a[0]) - b[0]
    t = np.clip(x @ along / max(along @ along, 1e-12), 0.0, 1.0)
    return np.min(np.linalg.norm(x - t[:, None] * along, axis=1))


def too_near(q, errors, margin, slack):
    """Capsules nearer to deck, mast or each other than the margin, by numpy; slack: added to the margin."""
    ends = capsule_ends(q, errors)
    mast = (np.array([-0.35, 0.45, 0.0]), np.array([-0.35, 0.45, 1.13]))
    fine = {frozenset(p) for p in DESC.collision_exclusions}
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
        bodies = space.CollisionModel(DESC, arm, camera, errors, 0.02)
        for _ in range(250):
            q = rng.uniform([-2.6, -2.0, -2.8, -0.9, -4.7, -1.6, -3.0], [2.6, 2.0, 2.8, 3.1, 1.2, 1.6, 3.0])
            if surely := too_near(q, errors, 0.02, -0.004):
                assert bodies.contact(q), surely
                hits += 1
            pair = bodies.contact(q)
            if pair and all(x in {**SHAPES, "mast": 0} and "tag" not in x for x in pair.split(" - ")):
                names = pair.split(" - ")
                if all(x == "mast" or SHAPES[x].radius_m and SHAPES[x].joint for x in names):
                    assert too_near(q, errors, 0.02, 0.004)
    assert hits > 30


def test_seeds_and_hub_segments_are_clear_with_errors(committed):
    errors = space.sampled_errors(DESC, 7)
    assert errors[0]["J7.phi_rad"] == 1.3  # the paper's set is one of them
    for i, c in enumerate(candidates(committed)[::12]):
        a, b = (np.array(list(x)[:7]) for x in (committed.hub_q[c.hub], c.q_seed))
        for s in np.linspace(0, 1, 9):
            q = a + s * (b - a)
            assert not too_near(q, {}, DESC.clear.nominal_m, -0.005)
            for e in (errors[0], errors[1 + i % (len(errors) - 1)]):
                if not any(x.startswith(("J1.", "J2.", "J4.", "J6.")) and "phi" not in x for x in e):
                    assert not too_near(q, e, DESC.clear.perturbed_m, -0.005)


def capsules_of(table, name):
    """Bodies of the table that stand for a capsule shape, by their ends."""
    s = SHAPES[name]
    return [
        i
        for i, b in enumerate(table.body[0 : table.n_body])
        if b.frame == s.joint and np.allclose([*b.start_m, *b.end_m], [*s.start_m, *s.end_m], atol=1e-6)
    ]


def test_collision_pairs_are_all_but_those_that_may_touch_by_design(committed):
    checked = lambda i, k: bool(committed.body[max(i, k)].collision_pairs >> min(i, k) & 1)  # noqa: E731
    fine = {frozenset(p) for p in DESC.collision_exclusions}
    single = [name for name, s in SHAPES.items() if s.radius_m is not None]
    n_allowed = n_checked = 0
    for a in single:
        for b in single:
            if a >= b:
                continue
            (i,), (k,) = capsules_of(committed, a), capsules_of(committed, b)
            together = frozenset((a, b)) in fine or SHAPES[a].joint == SHAPES[b].joint
            assert checked(i, k) is not together, (a, b)
            n_allowed, n_checked = n_allowed + together, n_checked + (not together)
    assert (n_allowed > 10, n_checked > 10) == (True, True)
    # boxes on the tool are bundles of bodies that cannot move against each other
    tool = [i for i, b in enumerate(committed.body[0 : committed.n_body]) if b.frame == 0]
    assert len(tool) > 4
    assert not any(checked(i, k) for i in tool for k in tool if i != k)
    assert all(b.collision_pairs >> i == 0 for i, b in enumerate(committed.body[0 : committed.n_body]))


def test_servo_bound_is_clear_with_the_papers_errors(committed):
    rng = np.random.default_rng(4)
    e = {"J7.phi_rad": 1.3, "J3.a_m": 0.01, "J3.d_m": 0.15}
    bad = n = 0
    for c in candidates(committed)[::10]:
        for _ in range(8):
            q = np.array(list(c.q_seed)[:7]) + rng.uniform(-1, 1, 7) * list(committed.servo_bound)[:7]
            bad += bool(too_near(q, e, 0.0, 0.0))
            n += 1
    assert bad <= 0.01 * n


def test_candidates_are_spread_and_initial_poses_far_from_each_other(committed):
    p = np.array([list(c.p_m) for c in candidates(committed)])
    gaps = np.linalg.norm(p[:, None] - p[None], axis=2) + np.eye(len(p))
    assert np.median(gaps.min(axis=1)) > 0.03
    # under the kernel's own metric: chosen poses are farther apart than as many taken at random
    _, kernel = tables.load(BIN / "kernel.tbl")
    poses = Pose(p, np.array([matrix_of_wxyz(list(c.q_wxyz)) for c in candidates(committed)]))
    metric = space.KernelMetric(kernel, DESC.spread.set, poses)
    order = space.farthest_points(metric, 40, 0)
    least = lambda ids: min(metric.squared(i)[[j for j in ids if j != i]].min() for i in ids)  # noqa: E731
    random = [least(list(np.random.default_rng(s).choice(len(p), 40, replace=False))) for s in range(5)]
    assert least(order) > max(random)
    initial = p[[i for i in committed.initial[0 : committed.n_initial] if i < len(p)]]
    assert np.linalg.norm(initial[0] - initial[1]) > 0.1


def test_direct_edges_join_only_near_candidates(committed):
    q = np.array([list(c.q_seed)[:7] for c in candidates(committed)])
    n = 0
    for i in range(len(q)):
        for j in range(i):
            bit = i * (i - 1) // 2 + j
            if committed.edge[bit // 8] >> bit % 8 & 1:
                n += 1
                assert np.max(np.abs(q[i] - q[j])) <= DESC.clear.direct_max_rad + 1e-6
    assert n > 0


def test_stops_show_tags_of_the_nominal_arm_and_of_most_wrong_arms(committed):
    checks = space.Checks.load(DESC, space.TablesFolder(BIN))
    assert committed.n_stop == DESC.stops.most == 4
    have = 0
    for i in range(0, committed.n_cand, 9):
        c, places = committed.cand[i], [p for p in committed.stop[i] if p]
        assert places == sorted(set(places))
        assert not (c.why & LOCAL and places)
        hub, seed = (np.array(list(q)[:7]) for q in (committed.hub_q[c.hub], c.q_seed))
        have += bool(places)
        for part in places:
            q = hub + part / 256.0 * (seed - hub)
            assert min(np.abs(q - hub).max(), np.abs(q - seed).max()) > DESC.stops.spacing_rad - 1e-3
            _, tool = wam(q)
            _, _, eye, _ = aimed_at(tool[:3, 3])
            assert DESC.view.range_min_m <= np.linalg.norm(tool[:3, 3] - eye) <= DESC.view.range_max_m
            shown = checks.detected_with_errors(q)
            assert np.mean(shown) >= DESC.stops.shown_min
    numbers = space.summarise(space.SpaceTable.load(BIN / "space.tbl")[1], space.TablesFolder(BIN).camera, 0)
    places = [[p for p in row if p] for row in committed.stop[0 : committed.n_cand]]
    assert (numbers.stops, numbers.stopping) == (sum(map(len, places)), sum(map(bool, places)))
    assert have > 0.8 * len(range(0, DESC.candidates, 9))


def test_stops_are_found_again_and_a_wrong_one_is_named():
    checks = space.Checks.load(DESC, space.TablesFolder(BIN))
    table = space.SpaceTable.load(BIN / "space.tbl")[1]
    i = next(i for i in range(20) if table.row(i).stops)
    row = table.row(i)
    assert space.samples.stops_on(checks, row.hub_q_rad, row.q_rad) == list(row.stops)
    assert not [
        p for p in space.samples.check_row(checks, row, table.servo_bound_rad).problems if "stop" in p
    ]
    blind = next(
        part for part in range(1, 256)
        if checks.stop_problem(space.table.stop_joints(row.hub_q_rad, row.q_rad, part))
    )  # fmt: skip
    wrong = space.samples.check_row(checks, replace(row, stops=(blind,)), table.servo_bound_rad)
    assert [p for p in wrong.problems if p.startswith(f"stop {blind}: ")]


def test_impossible_description_says_what_most_samples_fail():
    far = SMALL.tool.model_copy(update={"box_min_m": (3.0, 3.0, 3.0), "box_max_m": (4.0, 4.0, 4.0)})
    with pytest.raises(KincalError, match="most fail: too close to or too far from the camera"):
        space.build(SMALL.model_copy(update={"tool": far, "samples": 60}), BIN)


def test_metric_is_the_kernel_that_flies(committed):
    from builders import ffi, lib

    _, kernel = tables.load(BIN / "kernel.tbl")
    cands = committed.cand[0:40]
    p = np.array([list(c.p_m) for c in cands])
    poses = Pose(p, np.array([matrix_of_wxyz(list(c.q_wxyz)) for c in cands]))
    metric = space.KernelMetric(kernel, 1, poses)
    points = ffi.new("kc_point_t[]", 40)
    for i, c in enumerate(cands):
        points[i].p_m, points[i].q_wxyz = list(c.p_m), list(c.q_wxyz)
    k = [[lib.kc_kernel_eval(kernel, 1, points + i, points + j) for j in range(40)] for i in range(40)]
    got = np.array([metric.covariance(i) for i in range(40)])
    assert np.allclose(got, np.array(k) / k[0][0], atol=2e-6)


def test_same_description_gives_the_same_table_by_any_number_of_processes_and_another_seed_another():
    desc = SMALL.model_copy(update={"candidates": 3, "initial_poses": 1})
    one, two = (space.build(desc, BIN, processes=n).image.data for n in (1, 2))
    other = space.build(desc.model_copy(update={"seed": desc.seed + 1}), BIN, processes=1).image.data
    assert one == two
    assert one != other


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("candidates = 300", "candidates = 2000", "candidates: is 2000, must be 1024 or less"),
        ("candidates = 300", "candidate = 300", "candidate: unknown key; write candidates"),
        (
            "incid_max_rad   = 0.873", "incid_max_deg = 50",
            "incid_max_rad in radians: incid_max_rad = 0.872665",
        ),
        ("incid_max_rad   = 0.873", "incid_max_rad = 50.0", "in radians, 50 degrees are 0.872665"),
        ('kind  = "space"', 'kind  = "arm"', "not a search space"),
        ("step_rad       = 0.1", "step_rad       = 0.0", "clear.step_rad: is 0.0, must be above 0"),
        (
            "box_max_m = [0.95,", "box_max_m = [0.2,",
            "tool.box_min_m: leaves no room along x: 0.3 is not below",
        ),
        ("box_max_m = [0.95,", "box_max_m = [950,", r"tool.box_max_m\[1\]: is 950, must be 10 or less"),
        (
            "range_min_m     = 0.4", "range_min_m     = 1.8",
            "range_min_m: is 1.8, which is not below range_max_m",
        ),
        ('"J7.phi_rad" = 1.3', '"J7.phi_deg" = 75', "error_bounds.case: 'J7.phi_deg' is no DH error"),
        ("phi_rad   = [0.1,", "phi_rad   = [-0.1,", r"error_bounds.phi_rad\[1\]: is -0.1, must be 0 or more"),
        (
            "half_m = [0.50, 0.70, 0.04]", "half_m = [0.50, -0.70, 0.04]",
            r"keep_out\[2\].half_m: must be above 0",
        ),
        ("half_m = [0.50, 0.70, 0.04]", "radius_m = 0.5", "kind 'box' takes centre_m and half_m"),
        ('name = "shoulder"', 'name = "turret"', "two shapes or volumes are called 'turret'"),
        ("[-0.35, 0.45, 1.13]", "[-0.35, 0.45]", r"keep_out\[4\].end_m: has 2 entries, 3 are needed"),
        (
            '["stem", "scoop"]', '["stem", "scop"]',
            r"collision_exclusions\[4\]: names 'scop', which is no shape",
        ),
        ("seed       = 20240601", "seed       = -4", "seed: is -4"),
        (
            "reserve = [5,", f"reserve = [{N_LOCAL + 1},",
            f"is {N_LOCAL + 1}, there are {N_LOCAL} local initial",
        ),
        ("reserve = [5,", "reserve = [0,", r"joints.reserve\[1\]: is 0, must be 1 or more"),
        (
            "initial_poses     = 3 ", "initial_poses = 8 ",
            f"is 8, with {N_LOCAL} local ones; the table has room for 32",
        ),
        (
            "candidates = 300", "candidates = 1010",
            f"is 1010, with {N_LOCAL} local initial poses; the table has",
        ),
    ],
)  # fmt: skip
def test_wrong_description_is_refused_by_field(tmp_path, old, new, what):
    path = tmp_path / "space.toml"
    assert old in SPACE.read_text()
    path.write_text(SPACE.read_text().replace(old, new, 1))
    with pytest.raises(KincalError, match=what) as refused:
        space.read_description(path)
    assert refused.value.where == str(path)


@pytest.mark.parametrize(
    ("part", "change", "what", "where"),
    [
        ("joints", {"margin_rad": [0.1, 0.1, 0.1, 2.5, 0.1, 0.1, 0.1]}, "J4 no room", "margin_rad[4]"),
        ("joints", {"servo_bound_rad": [0.4] * 6}, "6 values for an arm of 7 joints", "servo_bound_rad"),
        ("view", {"pantilt_margin_rad": 2.0}, "leave the pan-tilt unit no room", "pantilt_margin_rad"),
        ("view", {"image_margin_px": 600.0}, "leave nothing of 1920 x 1080", "image_margin_px"),
        ("view", {"tags_min": 3}, "the camera table has 2", "tags_min"),
        ("error_bounds", {"case": [{"J8.phi_rad": 0.1}]}, "the arm has 7 joints", "error_bounds.case"),
        ("spread", {"set": 99}, "has sets 0 to 24", "spread.set"),
    ],
)
def test_description_that_does_not_fit_the_tables_says_where(part, change, what, where):
    new = getattr(SMALL, part).model_copy(update=change)
    with pytest.raises(KincalError, match=what) as refused:
        space.build(SMALL.model_copy(update={part: new}), BIN, processes=1)
    assert where in refused.value.where


def test_one_servo_bound_stands_for_all_joints():
    joints = SMALL.joints.model_copy(update={"servo_bound_rad": 0.2})
    bounds = SMALL.error_bounds.model_copy(update={"reach": False})
    few = {"candidates": 2, "initial_poses": 1}
    desc = SMALL.model_copy(update={"joints": joints, "error_bounds": bounds, **few})
    built = space.build(desc, BIN, processes=1)
    assert built.table.servo_bound_rad == pytest.approx([0.2] * 7)


def test_the_papers_arm_is_brought_to_every_candidate_inside_its_servo_bound(committed):
    """By scipy from the chain of test_flight_arm, nothing of the search."""
    bound = np.array(list(committed.servo_bound)[:7])
    errors = {(7, "phi"): 1.3, (2, "alpha"): 0.4, (3, "a"): 0.01, (3, "d"): 0.15}
    lo = np.array([-2.6, -2.0, -2.8, -0.9, -4.76, -1.6, -3.0])
    hi = np.array([2.6, 2.0, 2.8, 3.1, 1.24, 1.6, 3.0])
    for c in candidates(committed)[::30]:
        seed = np.array(list(c.q_seed)[:7])
        _, want = wam(seed)

        def off(q, want=want):
            _, T = wam(q, errors)
            turn = T[:3, :3].T @ want[:3, :3]
            rot = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
            return np.concatenate([T[:3, 3] - want[:3, 3], 0.3 * rot, [0.3 * max(0.0, 1.0 - np.trace(turn))]])

        box = np.maximum(seed - bound, lo), np.minimum(seed + bound, hi)
        starts = [seed + d for d in (np.zeros(7), np.eye(7)[6] * -1.3)]
        tried = [least_squares(off, np.clip(x, box[0] + 1e-6, box[1] - 1e-6), bounds=box) for x in starts]
        assert min(np.linalg.norm(t.fun) for t in tried) < 5e-3


def test_margins_must_fit_the_arm():
    short = SMALL.joints.model_copy(update={"margin_rad": [0.1] * 6})
    with pytest.raises(KincalError, match="7 joints"):
        space.build(SMALL.model_copy(update={"joints": short}), BIN)


def test_committed_local_poses_are_those_of_the_description_and_lead_the_initial_design(committed):
    local, n = local_poses(committed), DESC.candidates
    assert [list(c.q_seed)[:7] for c in local] == [pytest.approx(q) for q in DESC.joints.local_initial_rad]
    assert [i for i, c in enumerate(local, 1) if c.why & RESERVE] == DESC.joints.reserve
    assert list(committed.initial[0 : len(local)]) == list(range(n, n + len(local)))
    assert all(i < n for i in committed.initial[len(local) : committed.n_initial])
    assert not any(c.why & RESERVE for c in candidates(committed))


def test_local_poses_are_clear_and_only_segments_from_the_park_pose_lead_to_them(committed):
    errors = space.sampled_errors(DESC, 7)
    park = np.array(list(committed.hub_q[0])[:7])
    for c in local_poses(committed):
        assert (c.hub, c.tags != 0) == (0, True)
        q = np.array(list(c.q_seed)[:7])
        for s in np.linspace(0, 1, 7):
            at = park + s * (q - park)
            assert not too_near(at, {}, DESC.clear.nominal_m, -0.005)
            assert not too_near(at, errors[0], DESC.clear.perturbed_m, -0.005)
    n = DESC.candidates
    bits = np.unpackbits(np.frombuffer(bytes(committed.edge), np.uint8), bitorder="little")
    assert not bits[n * (n - 1) // 2 :].any()


PARK = DESC.joints.hubs_rad[0]


def with_local(poses, reserve=(), **changes):
    joints = SMALL.joints.model_copy(update={"local_initial_rad": poses, "reserve": list(reserve)})
    return SMALL.model_copy(update={"joints": joints, **changes})


def turned(joint, by):
    return [x + by * (j == joint) for j, x in enumerate(PARK, 1)]


def test_local_poses_are_built_behind_the_candidates_and_a_table_may_have_none():
    built = space.build(
        with_local([PARK, turned(7, 0.2), turned(7, -0.2)], [3], candidates=5), BIN, processes=1
    )
    table, n = built.table, built.table.n_candidates
    assert (len(table.q_rad), table.n_local, table.n_reserve) == (n + 3, 3, 1)
    assert table.checks.tolist() == [space.ALL_CHECKS] * n + [LOCAL, LOCAL, LOCAL | RESERVE]
    assert table.initial[:3] == (n, n + 1, n + 2)
    none = space.build(with_local([], candidates=5), BIN, processes=1).table
    assert np.array_equal(none.q_rad, table.q_rad[:n])
    assert (none.n_local, len(none.q_rad), len(none.initial)) == (0, n, SMALL.initial_poses)


@pytest.mark.parametrize(
    ("pose", "what"),
    [
        ([2.5, 1.8, 0.0, 0.4, 0.0, 0.0, 0.0], "local initial pose 2: too close \\(nominal arm\\): deck"),
        (turned(6, 1.2), "local initial pose 2: a tag shows with only [0-9]+ of 45 arms"),
        (turned(7, 9.0), "local initial pose 2: outside the joint limits: J7"),
    ],
)
def test_local_pose_that_does_not_hold_is_refused_by_number(pose, what):
    with pytest.raises(KincalError, match=what) as refused:
        space.build(with_local([PARK, pose]), BIN, processes=1)
    assert refused.value.where == "joints.local_initial_rad[2]"


def test_reserve_pose_may_show_a_tag_with_fewer_of_the_wrong_arms():
    """Find a posture between both shares, then ask for it once as an ordinary and once as a reserve pose."""
    _, arm = tables.load(BIN / "arm.tbl")
    _, camera = tables.load(BIN / "camera.tbl")
    checks = space.Checks(SMALL, arm, camera)
    between = None
    for by in np.arange(0.3, 1.2, 0.05):
        q = np.array(turned(6, by))
        share = np.mean(checks.detected_with_errors(q))
        if 0.5 <= share < 0.9 and not checks.hub_problem(q):
            between = q
            break
    assert between is not None
    assert "a tag shows with only" in checks.local_problem(between, checks.hubs[0])
    assert checks.local_problem(between, checks.hubs[0], reserve=True) == ""


def test_hub_in_the_deck_is_refused():
    low = SMALL.joints.model_copy(update={"hubs_rad": [[2.5, 1.8, 0.0, 0.4, 0.0, 0.0, 0.0]]})
    with pytest.raises(KincalError, match=r"hub 0: too close \(nominal arm\): .*deck"):
        space.build(SMALL.model_copy(update={"joints": low}), BIN)


def test_space_needs_the_built_arm(tmp_path):
    with pytest.raises(KincalError, match="the built arm table is needed"):
        space.build(SMALL, tmp_path)
