"""The guard's distances against MuJoCo's: shapes and keep-out volumes of space.toml as MuJoCo geoms, and as
capsules of the SPACE table in flight's own geometry. For keep-out volumes and for pairs of shapes."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from builders import ffi, lib
from scipy.optimize import minimize_scalar

from kincal import tables
from kincal.space.collision import CollisionModel
from kincal.space.encoding import EXCESS_MAX_M, capsules, write_guard
from kincal_shared.schema.space import read_description

TABLES = Path(__file__).parents[2] / "tables"
DESC = read_description(TABLES / "src/space.toml")
(_, ARM), (_, CAMERA), (_, TERMS) = (tables.load(TABLES / f"bin/{k}.tbl") for k in ("arm", "camera", "terms"))
NAMES = [ffi.string(TERMS.coef[i].name).decode() for i in range(TERMS.n_coef)]
FAR_M = 5.0  # distances beyond are cut off by MuJoCo
GEOM_TOL_M = 1e-5  # the table is single precision


class Flight:
    def __init__(self, shapes=None):
        self.space = ffi.new("kc_space_t *")
        self.space.n_joints = ARM.n_joints
        desc = DESC if shapes is None else DESC.model_copy(update={"shape": shapes})
        write_guard(self.space, desc, CAMERA)
        self.ctx, self.loads = ffi.new("kc_ctx_t *"), ffi.new("kc_loads_t *")
        self.placed = ffi.new("kc_guard_arm_t *")
        self.placed.arm, self.placed.space = ARM, self.space
        self.body, self.met = ffi.new("uint32_t *"), ffi.new("uint32_t *")

    def place(self, q, errors):
        coef = ffi.new("double[]", [errors.get(name, 0.0) for name in NAMES])
        self.ctx.q[0 : len(q)] = [float(x) for x in q]
        at = self.placed
        lib.kc_model_frames(ARM, TERMS, coef, self.ctx, self.loads, at.frame, at.along_m, at.across_m)
        return at

    def clearance(self, q, errors):
        return lib.kc_guard_clearance(self.place(q, errors), self.body, self.met)

    def self_clearance(self, q, errors):
        return lib.kc_guard_self_clearance(self.place(q, errors), self.body, self.met)


def rod_to_box(m, d, a, b):
    """MuJoCo answers 11 mm for a capsule whose axis goes right through a box; so by minimising along it."""
    half, along = m.geom_size[b], d.geom_xmat[a].reshape(3, 3)[:, 2] * m.geom_size[a][1]
    middle = (d.geom_xpos[a] - d.geom_xpos[b]) @ d.geom_xmat[b].reshape(3, 3)

    def away(t):
        return np.linalg.norm(np.maximum(np.abs(middle + t * along) - half, 0.0))

    least = minimize_scalar(away, bounds=(-1, 1), method="bounded", options={"xatol": 1e-10}).fun
    return min(least, away(-1), away(1)) - m.geom_size[a][0]


class Engine:
    """Smallest distance of the arm to what it must keep out of, pair by pair."""

    def __init__(self, errors, boxes=True):
        self.of = CollisionModel(DESC, ARM, CAMERA, errors)
        m = self.of.model
        label, outside = self.of.labels, {k.name for k in DESC.keep_out}
        excluded = {(s, k.name) for k in DESC.keep_out for s in k.except_}
        box = {s.name for s in DESC.shape if s.radius_m is None}
        pairs = zip(m.pair_geom1.tolist(), m.pair_geom2.tolist(), strict=True)
        self.own = [
            pair
            for pair in pairs
            if all(label[g] not in outside and (boxes or label[g] not in box) for g in pair)
        ]
        self.pairs = [
            (a, b)
            for a in range(m.ngeom)
            for b in range(m.ngeom)
            if label[a] not in outside
            and label[b] in outside
            and (label[a], label[b]) not in excluded
            and (boxes or label[a] not in box)
        ]

    def clearance(self, q):
        m, d = self.of.model, self.of.data
        d.qpos[: len(q)] = q
        mujoco.mj_kinematics(m, d)
        return min(self.distance(m, d, a, b) for a, b in self.pairs)

    def self_clearance(self, q):
        m, d = self.of.model, self.of.data
        d.qpos[: len(q)] = q
        mujoco.mj_kinematics(m, d)
        return min(mujoco.mj_geomDistance(m, d, a, b, FAR_M, None) for a, b in self.own)

    @staticmethod
    def distance(m, d, a, b):
        kind = mujoco.mjtGeom
        if m.geom_type[b] == kind.mjGEOM_BOX and m.geom_type[a] == kind.mjGEOM_CAPSULE:
            return rod_to_box(m, d, a, b)
        if m.geom_type[b] != kind.mjGEOM_PLANE:
            return mujoco.mj_geomDistance(m, d, a, b, FAR_M, None)
        down = np.abs(d.geom_xmat[a].reshape(3, 3)[2])
        if m.geom_type[a] == mujoco.mjtGeom.mjGEOM_BOX:
            reach = down @ m.geom_size[a]
        else:
            reach = m.geom_size[a][0] + down[2] * m.geom_size[a][1]
        return d.geom_xpos[a][2] - reach - d.geom_xpos[b][2]


def postures(rng, n):
    q = np.array([[ARM.joint[j].q_min, ARM.joint[j].q_max] for j in range(ARM.n_joints)])
    return rng.uniform(*q.T, (n, ARM.n_joints))


# Errors along the axes: links with a length there get longer or shorter (3, 5, 7), the shapes of the others
# count where they are and where they were.
LONGER = {f"J{j}.d_m": d for j, d in enumerate((0.04, -0.05, 0.06, 0.03, -0.04, 0.05, 0.02), 1)}
LEANING = {"J3.a_m": 0.03, "J5.a_m": -0.03, "J7.a_m": 0.03, "J3.d_m": -0.05, "J5.d_m": 0.1}
ERRORS = [{}, {"J2.phi_rad": 0.1, "J4.phi_rad": -0.1, "J7.phi_rad": 1.3}, LONGER, LEANING]
IDS = ["nominal", "encoders", "longer", "leaning"]


@pytest.mark.parametrize("errors", ERRORS, ids=IDS)
def test_links_are_as_far_from_everything_as_in_mujoco(errors):
    """Capsules on both sides; the corrected arm is MuJoCo's arm with these errors."""
    flight, engine = Flight([s for s in DESC.shape if s.radius_m is not None]), Engine(errors, boxes=False)
    rng, n_inside = np.random.default_rng(5), 0
    for q in postures(rng, 300):
        want = engine.clearance(q)
        got = flight.clearance(q, errors)
        if want > 0.0:
            assert got == pytest.approx(want, abs=GEOM_TOL_M)
        else:  # how deep is another question for boxes; that it is inside is not
            assert got < GEOM_TOL_M
            n_inside += 1
    assert 10 <= n_inside < 290


def sampled_errors(rng):
    """Encoders, lengths along the axes, and across them where a link has a length to lean with."""
    return {
        f"J{j}.{field}": rng.normal(0.0, sigma)
        for j in range(1, ARM.n_joints + 1)
        for field, sigma in (("phi_rad", 0.3), ("d_m", 0.03), ("a_m", 0.02))
        if field != "a_m" or ARM.joint[j - 1].d_m != 0.0
    }


def test_links_are_as_far_from_each_other_as_in_mujoco():
    flight = Flight([s for s in DESC.shape if s.radius_m is not None])
    rng, n_inside, n = np.random.default_rng(8), 0, 0
    for errors in [*ERRORS, *(sampled_errors(rng) for _ in range(7))]:
        engine = Engine(errors, boxes=False)
        for q in postures(rng, 120):
            want = engine.self_clearance(q)
            assert flight.self_clearance(q, errors) == pytest.approx(want, abs=GEOM_TOL_M)
            n_inside += want < 0.0
            n += 1
    assert 30 <= n_inside <= n - 30


def test_the_whole_arm_is_no_farther_from_itself_than_in_mujoco_and_hardly_nearer():
    """Each of two boxes may stand in capsules that are too thick by some margin."""
    flight, rng, n = Flight(), np.random.default_rng(9), 0
    for errors in [{}, *(sampled_errors(rng) for _ in range(4))]:
        engine = Engine(errors)
        for q in postures(rng, 60):
            want, got = engine.self_clearance(q), flight.self_clearance(q, errors)
            assert got <= max(want, 0.0) + GEOM_TOL_M
            if want > 0.0:
                assert got >= want - 2 * EXCESS_MAX_M - GEOM_TOL_M
                n += 1
    assert n > 50


def test_the_whole_arm_lies_in_its_capsules_and_they_are_not_much_larger():
    flight, engine = Flight(), Engine({})
    rng, n = np.random.default_rng(6), 0
    for q in postures(rng, 300):
        want, got = engine.clearance(q), flight.clearance(q, {})
        assert got <= max(want, 0.0) + GEOM_TOL_M
        if want > 0.0:
            assert got >= want - EXCESS_MAX_M - GEOM_TOL_M
            n += 1
    assert n > 20


@pytest.mark.parametrize("shape", [s for s in DESC.shape if s.radius_m is None], ids=lambda s: s.name)
def test_a_box_lies_in_its_capsules(shape):
    """Points all over it, corners and edges first."""
    rng = np.random.default_rng(7)
    u = rng.uniform(-1, 1, (4000, 3))
    u[:1000] = np.round(u[:1000])  # corners, edges and faces
    p = np.array(shape.centre_m) + u * shape.half_m
    least = np.full(len(p), np.inf)
    for a, b, radius in capsules(shape):
        along = b - a
        t = np.clip((p - a) @ along / (along @ along), 0, 1)
        least = np.minimum(least, np.linalg.norm(p - a - t[:, None] * along, axis=1) - radius)
    assert np.max(least) <= 1e-12


def test_the_committed_space_has_the_shapes_of_its_description():
    _, space = tables.load(TABLES / "bin/space.tbl")
    want = Flight().space
    for name in ("n_body", "n_volume"):
        assert getattr(space, name) == getattr(want, name) > 0
    assert ffi.buffer(space.body)[:] == ffi.buffer(want.body)[:]
    assert ffi.buffer(space.volume)[:] == ffi.buffer(want.volume)[:]
