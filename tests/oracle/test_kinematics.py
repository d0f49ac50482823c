"""Forward kinematics, every Jacobian and gravity loads of the flight core, against Pinocchio, MuJoCo
and central differences."""

import itertools

import chains
import numpy as np
import pytest
from builders import (
    PoseModel,
    arm_from,
    basis,
    context,
    dh_terms,
    ffi,
    fill,
    fk,
    lib,
    pointer,
    pose_of,
    term,
    terms_from,
    view,
)
from chains import COMPONENTS, by_mujoco, by_pinocchio
from scipy.spatial.transform import Rotation

from kincal.rotations import Pose

TOL = 1e-9
TOOL, CAMERA, MEAS = 9, 10, 11
LIBRARIES = [by_pinocchio, by_mujoco]


def quat(R):
    return Rotation.from_matrix(R).as_quat(scalar_first=True)


def flight_arm(arm):
    """kc_arm_t of plain numbers; wide limits, tests choose the joints."""
    joints = [
        {
            "type": int(arm.prismatic[i]),
            "phi_rad": arm.dh[i, 0],
            "alpha_rad": arm.dh[i, 1],
            "a_m": arm.dh[i, 2],
            "d_m": arm.dh[i, 3],
            "q_min": -7.0,
            "q_max": 7.0,
            "has_mass": 1,
            "mass_kg": arm.mass[i],
            "com_m": arm.com[i],
        }
        for i in range(arm.n)
    ]
    return arm_from(
        joints,
        base_xyz_m=arm.base[:3, 3],
        base_quat_wxyz=quat(arm.base[:3, :3]),
        tool_xyz_m=arm.tool[:3, 3],
        tool_quat_wxyz=quat(arm.tool[:3, :3]),
        gravity_m_s2=arm.gravity,
    )


def all_twists(n, frames=None):
    """One coefficient for every component of every arm frame, basis 1."""
    frames = [*range(n + 1), TOOL] if frames is None else frames
    cells = list(itertools.product(frames, range(6)))
    coefs = [f"F{f}.{COMPONENTS[c]}" for f, c in cells]
    terms = [term(k, f, COMPONENTS[c]) for k, (f, c) in enumerate(cells)]
    return cells, terms_from(coefs, terms, n)


def arms():
    rng = np.random.default_rng(20)
    return [chains.wam()] + [chains.random_arm(rng, n) for n in (1, 2, 3, 5, 6, 7, 8, 8)]


ARMS = arms()
IDS = [
    f"{'wam' if i == 0 else 'random'}-{a.n}" + ("p" if a.prismatic.any() else "") for i, a in enumerate(ARMS)
]


def chain_twists(n, cells, coef):
    out = {}
    for (frame, comp), value in zip(cells, coef, strict=True):
        out.setdefault("tool" if frame == TOOL else frame, np.zeros(6))[comp] = value
    assert all(f == "tool" or f <= n for f in out)
    return out


def test_random_arms_have_both_kinds_of_joints():
    assert any(a.prismatic.any() for a in ARMS)
    assert any((~a.prismatic).any() for a in ARMS)


@pytest.mark.parametrize("library", LIBRARIES)
@pytest.mark.parametrize("arm", ARMS, ids=IDS)
def test_nominal_forward_kinematics(arm, library):
    rng = np.random.default_rng(1)
    flown = flight_arm(arm)
    for _ in range(10):
        q = rng.uniform(-3, 3, arm.n)
        want = library(chains.chain_of(arm, q, {})).T
        np.testing.assert_allclose(fk(flown, q).matrix, want, atol=TOL)


@pytest.mark.parametrize("library", LIBRARIES)
@pytest.mark.parametrize("arm", ARMS, ids=IDS)
def test_corrected_pose_joint_jacobian_and_every_twist(arm, library):
    """All corrections at once and far from zero: their derivatives must be taken inside the product."""
    rng = np.random.default_rng(2)
    # 60 columns at most: an arm of eight joints has ten frames; leave one pair of frames out at a time.
    all_frames = [*range(arm.n + 1), TOOL]
    for skip in ((),) if len(all_frames) * 6 <= 60 else ((0,), (4,), (TOOL,)):
        frames = [f for f in all_frames if f not in skip]
        cells, terms = all_twists(arm.n, frames)
        model = PoseModel(flight_arm(arm), terms)
        for _ in range(4):
            q, coef = rng.uniform(-3, 3, arm.n), rng.uniform(-0.4, 0.4, len(cells))
            got = model.eval(q, coef)
            want = library(chains.chain_of(arm, q, chain_twists(arm.n, cells, coef)))
            np.testing.assert_allclose(got.T.matrix, want.T, atol=TOL)
            for j in range(arm.n):
                np.testing.assert_allclose(got.Jq[j], want.J["q", j], atol=TOL)
            for k, (f, c) in enumerate(cells):
                column = want.J["tool" if f == TOOL else f, c]
                np.testing.assert_allclose(got.J[k], column, atol=TOL)
                np.testing.assert_allclose(got.twist[f, c], column, atol=TOL)


@pytest.mark.parametrize("arm", ARMS, ids=IDS)
def test_dh_errors_are_the_arm_with_other_dh_numbers(arm):
    """delta moves Psi to Psi + delta exactly, also 1.3 rad and 0.15 m."""
    rng = np.random.default_rng(3)
    model = PoseModel(flight_arm(arm), dh_terms(arm.n))
    for _ in range(10):
        q = rng.uniform(-3, 3, arm.n)
        delta = rng.uniform(-1, 1, (arm.n, 4)) * [1.3, 1.3, 0.15, 0.15]
        moved = chains.Numbers(
            arm.dh + delta, arm.prismatic, arm.base, arm.tool, arm.gravity, arm.mass, arm.com
        )
        got = model.eval(q, delta.ravel())
        np.testing.assert_allclose(got.T.matrix, by_pinocchio(chains.chain_of(moved, q, {})).T, atol=TOL)


def test_parameter_jacobian_is_the_one_of_the_method_page():
    """phi: (z x (p-o); z), alpha: (x x (p-o); x), a: (x; 0), d: (z; 0)."""
    arm = chains.wam()
    q = np.random.default_rng(4).uniform(-1.5, 1.5, 7)
    J = PoseModel(flight_arm(arm), dh_terms(7)).eval(q).J
    T, frames = arm.base, [arm.base]
    for i in range(7):
        T = T @ chains.elementary("rz", q[i]) @ chains.link(*arm.dh[i])
        frames.append(T)
    p = (T @ arm.tool)[:3, 3]
    for i in range(7):
        z, o0 = frames[i][:3, 2], frames[i][:3, 3]
        x, o1 = frames[i + 1][:3, 0], frames[i + 1][:3, 3]
        want = [
            np.r_[np.cross(z, p - o0), z],
            np.r_[np.cross(x, p - o1), x],
            np.r_[x, 0, 0, 0],
            np.r_[z, 0, 0, 0],
        ]
        np.testing.assert_allclose(J[4 * i : 4 * i + 4], want, atol=1e-12)


# --------------------------------------------------------------------------- gravity


@pytest.mark.parametrize("library", LIBRARIES)
@pytest.mark.parametrize("arm", ARMS, ids=IDS)
def test_gravity_torques_and_moments(arm, library):
    """Sign: what gravity does to the joint, the opposite of what the motors hold
    (Pinocchio's computeGeneralizedGravity, MuJoCo's qfrc_bias)."""
    rng = np.random.default_rng(5)
    frames = [*range(arm.n + 1), TOOL][:9]
    cells, terms = all_twists(arm.n, frames)
    model = PoseModel(flight_arm(arm), terms)
    for payload in (0.0, 2.5):
        q, coef = rng.uniform(-3, 3, arm.n), rng.uniform(-0.3, 0.3, len(cells))
        twists = chain_twists(arm.n, cells, coef)
        got = model.loads(q, coef, payload_kg=payload)
        want = library(chains.chain_of(arm, q, twists, payload, probes=True), arm.gravity).gravity
        np.testing.assert_allclose(got.tau, [want["q", j] for j in range(arm.n)], atol=1e-8)
        for i in range(arm.n + 1):
            np.testing.assert_allclose(got.moment[i], [want["probe", i, c] for c in range(3)], atol=1e-8)

        bare = chains.Numbers(arm.dh, arm.prismatic, arm.base, arm.tool, arm.gravity, 0 * arm.mass, arm.com)
        want = library(chains.chain_of(bare, q, twists, payload), arm.gravity).gravity
        np.testing.assert_allclose(got.tau_payload, [want["q", j] for j in range(arm.n)], atol=1e-8)


@pytest.mark.parametrize("library", LIBRARIES)
@pytest.mark.parametrize("arm", ARMS, ids=IDS)
def test_gravity_levers_are_what_the_libraries_find_for_one_kilogram(arm, library):
    """A body of 1 kg at the origin of one frame, nothing else: moments about the axes of every frame before
    it, and the force along a sliding joint."""
    rng = np.random.default_rng(8)
    cells, terms = all_twists(arm.n, [*range(arm.n + 1), TOOL][:9])
    q, coef = rng.uniform(-3, 3, arm.n), rng.uniform(-0.3, 0.3, len(cells))
    twists = chain_twists(arm.n, cells, coef)
    model = PoseModel(flight_arm(arm), terms)
    for body in range(1, arm.n + 2):  # the last one is the tool
        mass = np.eye(arm.n + 1)[body - 1]
        one = chains.Numbers(
            arm.dh, arm.prismatic, arm.base, arm.tool, arm.gravity, mass[: arm.n], np.zeros((arm.n, 3))
        )
        want = library(chains.chain_of(one, q, twists, mass[arm.n], probes=True), arm.gravity).gravity
        for link in range(min(body, arm.n)):
            index = 16 * link + (body if body <= arm.n else 0)
            got = [model.basis(f"lev{axis}", index, q, coef) for axis in "xyz"]
            np.testing.assert_allclose(got, [want["probe", link, c] for c in range(3)], atol=1e-9)
            if arm.prismatic[link]:
                assert model.basis("gz", link, q, coef) == pytest.approx(want["q", link], abs=1e-9)


def test_gravity_pulls_an_outstretched_arm_down():
    """One horizontal link of 1 m, 2 kg at its tip, axis along -y: gravity turns it by +19.62 N m."""
    arm = arm_from(
        [{"a_m": 1.0, "q_min": -2, "q_max": 2, "has_mass": 1, "mass_kg": 2.0}],
        base_quat_wxyz=quat(Rotation.from_euler("x", 90, degrees=True).as_matrix()),
    )
    model = PoseModel(arm, dh_terms(1))
    assert model.eval([0.0]).Jq[0][2] == pytest.approx(1.0)  # a positive turn lifts the tip
    assert model.loads([0.0]).tau[0] == pytest.approx(-2 * 9.81)


# --------------------------------------------------------------------------- camera side


def random_pose(rng, scale=1.0):
    return chains.transform(rng.normal(size=3) * scale, rng.normal(size=3))


def observation(arm, q, T_meas, T_cam=None, has_rot=True):
    obs = ffi.new("kc_obs_t *")
    obs.ctx = context(arm, q)[0]
    fields = {"p_m": T_meas[:3, 3], "q_wxyz": quat(T_meas[:3, :3]), "has_rot": int(has_rot)}
    if T_cam is not None:
        fields |= {"p_cam_m": T_cam[:3, 3], "q_cam_wxyz": quat(T_cam[:3, :3]), "has_cam": 1}
    return fill(obs, fields)


@pytest.mark.parametrize("library", LIBRARIES)
def test_camera_side_corrections(library):
    """T_base_cam E_camera T_cam_tool E_meas, and minus its derivatives as columns."""
    rng = np.random.default_rng(6)
    arm = chains.random_arm(rng, 4)
    cells, terms = all_twists(4, [2, CAMERA, MEAS])
    flown = flight_arm(arm)
    model = PoseModel(flown, terms)
    for _ in range(5):
        q, coef = rng.uniform(-2, 2, 4), rng.uniform(-0.4, 0.4, len(cells))
        cam, measured = random_pose(rng), random_pose(rng)
        r, J = model.residual(observation(flown, q, measured, cam), coef)
        want = library(
            [
                chains.Fixed(cam),
                *chains.twist_moves(CAMERA, coef[6:12]),
                chains.Fixed(np.linalg.inv(cam) @ measured),
                *chains.twist_moves(MEAS, coef[12:]),
            ]
        )
        on_arm = library(chains.chain_of(arm, q, {2: coef[:6]}))
        turn = Rotation.from_matrix(want.T[:3, :3] @ on_arm.T[:3, :3].T).as_rotvec()
        np.testing.assert_allclose(r, np.r_[want.T[:3, 3] - on_arm.T[:3, 3], turn], atol=TOL)
        for k, (f, c) in enumerate(cells):
            column = on_arm.J[f, c] if f == 2 else -want.J[f, c]
            np.testing.assert_allclose(J[k], column, atol=TOL)


def test_camera_side_terms_are_zero_without_a_camera():
    rng = np.random.default_rng(7)
    arm = chains.random_arm(rng, 3)
    flown = flight_arm(arm)
    _, terms = all_twists(3, [CAMERA, MEAS])
    measured = random_pose(rng)
    coef = rng.normal(size=12) * 0.3
    r, J = PoseModel(flown, terms).residual(observation(flown, [0.1, 0.2, 0.3], measured), coef)
    T = by_pinocchio(chains.chain_of(arm, [0.1, 0.2, 0.3], {})).T
    np.testing.assert_allclose(r[:3], measured[:3, 3] - T[:3, 3], atol=TOL)
    assert not J.any()


def test_position_only_observation_gives_three_rows():
    rng = np.random.default_rng(8)
    arm = chains.random_arm(rng, 3)
    flown = flight_arm(arm)
    cells, terms = all_twists(3, [1, CAMERA, MEAS])
    model = PoseModel(flown, terms)
    q, cam = rng.normal(size=3), random_pose(rng)
    coef = rng.normal(size=len(cells)) * 0.2
    T = by_pinocchio(chains.chain_of(arm, q, {1: coef[:6]})).T
    measured = T.copy()
    measured[:3, 3] += [0.3, -0.2, 0.1]
    obs = observation(flown, q, measured, cam, has_rot=False)
    obs.q_wxyz = [9.0, 9.0, 9.0, 9.0]  # must not be read
    r, J = model.residual(obs, coef)
    # The tool is taken to stand as the model says, so this is the full case with that rotation.
    full_r, full_J = model.residual(observation(flown, q, measured, cam), coef)
    assert r.shape == (3,)
    np.testing.assert_allclose(r, full_r[:3], atol=1e-12)
    np.testing.assert_allclose(J, full_J[:, :3], atol=1e-12)


# --------------------------------------------------------------------------- bases and differences

JOINT_VARS = {"q", "tau", "dir", "qdot", "tau_payload"}
LINK_VARS = {"mx", "my", "mz"}
VARIABLES = (
    "q",
    "tau",
    "mx",
    "my",
    "mz",
    "dir",
    "temp",
    "t",
    "payload",
    "range",
    "incid",
    "u",
    "v",
    "r2",
    "pan",
    "tilt",
    "qdot",
    "tau_payload",
    "xcam",
    "ycam",
    "zcam",
    "tag",
)
FUNCTIONS = {
    "lin": lambda z: z,
    "sin": np.sin,
    "cos": np.cos,
    "tanh": np.tanh,
    "ln1p": lambda z: np.log(1 + max(z, 0)),
    "expn": lambda z: np.exp(-max(z, 0)),
    "step": lambda z: float(z >= 0),
    "sq": lambda z: z * z,
    "tan2": lambda z: np.tan(np.clip(z, -1.4, 1.4)) ** 2,
    "abs": abs,
}
CTX = {
    "dir": [1, -1, 0, 1],
    "qdot": [0.1, -0.2, 0.3, 0.05],
    "temp_c": -20.0,
    "t_s": 300.0,
    "payload_kg": 0.7,
    "range_m": 1.2,
    "incid_rad": 0.4,
    "u_norm": 0.2,
    "v_norm": -0.15,
    "pan_rad": 0.3,
    "tilt_rad": 0.5,
    "p_cam_tool_m": [0.1, -0.2, 1.1],
    "tag": 0.5,
}


def raw_eval(arm, terms, coef, ctx, loads):
    """Pose at given loads, which the coefficient Jacobian holds fixed."""
    ev = ffi.new("kc_eval_t *")
    lib.kc_model_eval(arm, terms, pointer(coef), ctx, loads, 1, ev)
    return ev


def max_basis(b, ctx, arm):
    loads = ffi.new("kc_loads_t *")
    lib.kc_model_loads(arm, dh_terms(4), ffi.NULL, ctx, loads)
    return abs(lib.kc_basis_eval(fill(ffi.new("kc_basis_t *"), b), ctx, loads))


def difference(plus, minus, step):
    dR = Rotation.from_matrix(plus.R @ minus.R.T).as_rotvec()
    return np.r_[plus.p_m - minus.p_m, dR] / (2 * step)


@pytest.mark.parametrize("var", VARIABLES)
def test_central_differences_of_every_frame_component_and_basis(var):
    """frame x component x variable x function, coefficients away from zero, two factors a term."""
    rng = np.random.default_rng(sum(map(ord, var)))
    arm = chains.random_arm(rng, 4)
    arm.prismatic[:] = [False, True, False, False]
    flown = flight_arm(arm)
    q = rng.uniform(-1.5, 1.5, 4)
    ctx = context(flown, q, **CTX)
    cells = list(itertools.product([0, 2, 4, TOOL, CAMERA, MEAS], range(6)))
    cam, measured = random_pose(rng), random_pose(rng)
    for fn in FUNCTIONS:
        index = (
            int(rng.integers(1, 5))
            if var in JOINT_VARS
            else int(rng.integers(0, 5))
            if var in LINK_VARS
            else 0
        )
        b = basis(fn, var, index, c0=rng.normal() * 0.3, c1=rng.uniform(0.2, 0.8))
        other = basis("cos", "q", 3, c1=0.5)
        terms = terms_from(
            [f"c{k}" for k in range(36)],
            [term(k, f, COMPONENTS[c], b, other, gain=0.7) for k, (f, c) in enumerate(cells)],
            4,
        )
        # Coefficients and steps such that twists stay near 0.05 and 1e-5, for any size of the basis.
        size = max(1.0, max_basis(b, ctx, flown))
        coef, step = rng.uniform(-0.05, 0.05, 36) / size, 1e-5 / size
        obs = observation(flown, q, measured, cam)
        obs.ctx = ctx[0]
        loads = ffi.new("kc_loads_t *")
        lib.kc_model_loads(flown, terms, pointer(coef), ctx, loads)

        def camera_pose(c, terms=terms, obs=obs, loads=loads):
            """Corrected measurement = residual against a model at the identity's place: by its parts."""
            r, ev = np.zeros(6), ffi.new("kc_eval_t *")
            lib.kc_model_residual(flown, terms, pointer(c), obs, loads, pointer(r), ev)
            T = pose_of(ev.T)
            return Pose(T.p_m + r[:3], Rotation.from_rotvec(r[3:]).as_matrix() @ T.R), view(
                ev.J, 36, 6
            ).copy()

        J_arm = view(raw_eval(flown, terms, coef, ctx, loads).J, 36, 6).copy()
        _, J_all = camera_pose(coef)
        for k, (f, _) in enumerate(cells):
            plus, minus = coef.copy(), coef.copy()
            plus[k] += step
            minus[k] -= step
            if f in (CAMERA, MEAS):
                want = -difference(camera_pose(plus)[0], camera_pose(minus)[0], step)
                assert not J_arm[k].any()
            else:
                want = difference(
                    pose_of(raw_eval(flown, terms, plus, ctx, loads).T),
                    pose_of(raw_eval(flown, terms, minus, ctx, loads).T),
                    step,
                )
                np.testing.assert_allclose(J_arm[k], J_all[k])
            np.testing.assert_allclose(
                J_all[k], want, atol=2e-8 * (1 + np.abs(want).max()), err_msg=f"{fn} {cells[k]}"
            )


def expected_variable(var, index, ctx, tau, tau_payload, moment):
    where = {"q": ctx["q"], "tau": tau, "dir": ctx["dir"], "qdot": ctx["qdot"], "tau_payload": tau_payload}
    plain = {
        "temp": "temp_c",
        "t": "t_s",
        "payload": "payload_kg",
        "range": "range_m",
        "incid": "incid_rad",
        "u": "u_norm",
        "v": "v_norm",
        "pan": "pan_rad",
        "tilt": "tilt_rad",
        "tag": "tag",
    }
    if var in where:
        return where[var][index - 1]
    if var in LINK_VARS:
        return moment[index]["xyz".index(var[1])]
    if var == "r2":
        return ctx["u_norm"] ** 2 + ctx["v_norm"] ** 2
    if var.endswith("cam"):
        return ctx["p_cam_tool_m"]["xyz".index(var[0])]
    return ctx[plain[var]]


@pytest.mark.parametrize("fn", FUNCTIONS)
def test_basis_values(fn):
    """Every variable with every function, arguments on both sides of the clips."""
    rng = np.random.default_rng(9)
    arm = chains.random_arm(rng, 4)
    flown = flight_arm(arm)
    q = rng.normal(size=4)
    model = PoseModel(flown, dh_terms(4))
    loads = model.loads(q, payload_kg=CTX["payload_kg"])
    gravity = by_pinocchio(chains.chain_of(arm, q, {}, CTX["payload_kg"], probes=True), arm.gravity).gravity
    bare = chains.Numbers(arm.dh, arm.prismatic, arm.base, arm.tool, arm.gravity, 0 * arm.mass, arm.com)
    carried = by_pinocchio(chains.chain_of(bare, q, {}, CTX["payload_kg"]), arm.gravity).gravity
    tau = [gravity["q", j] for j in range(4)]
    tau_payload = [carried["q", j] for j in range(4)]
    moment = [[gravity["probe", i, c] for c in range(3)] for i in range(5)]
    assert np.allclose(loads.tau, tau)
    ctx = context(flown, q, **CTX)
    c_loads = ffi.new("kc_loads_t *")
    lib.kc_model_loads(flown, dh_terms(4), ffi.NULL, ctx, c_loads)
    for var in VARIABLES:
        for index in range(1, 5) if var in JOINT_VARS else range(5) if var in LINK_VARS else (0,):
            for c0, c1 in ((0.0, 1.0), (0.37, -0.6), (-2.0, 40.0)):
                b = fill(ffi.new("kc_basis_t *"), basis(fn, var, index, c0, c1))
                x = expected_variable(var, index, CTX | {"q": q}, tau, tau_payload, moment)
                want = FUNCTIONS[fn](c1 * (x - c0))
                got = lib.kc_basis_eval(b, ctx, c_loads)
                assert got == pytest.approx(want, rel=1e-7, abs=1e-9), (var, index, c0, c1)


def test_joint_jacobian_by_central_differences():
    rng = np.random.default_rng(10)
    arm = chains.random_arm(rng, 6)
    arm.prismatic[2] = True
    cells, terms = all_twists(6)
    model = PoseModel(flight_arm(arm), terms)
    q, coef, step = rng.normal(size=6), rng.normal(size=len(cells)) * 0.2, 1e-6
    Jq = model.eval(q, coef).Jq
    for j in range(6):
        e = np.eye(6)[j] * step
        want = difference(
            model.eval(q + e, coef, want_J=False).T, model.eval(q - e, coef, want_J=False).T, step
        )
        np.testing.assert_allclose(Jq[j], want, atol=1e-8)


# --------------------------------------------------------------------------- identifiability


def stacked(n_poses, terms, rows, tool=None, seed=11):
    arm = chains.wam(tool=chains.transform(tool or (0, 0, 0)))
    rng = np.random.default_rng(seed)
    model = PoseModel(flight_arm(arm), terms)
    lo, hi = chains.WAM_LIMITS.T
    return np.vstack([model.eval(rng.uniform(lo, hi)).J[:, :rows].T for _ in range(n_poses)])


def column_scale(J):
    """Columns of unit length, but columns of mere rounding errors stay small."""
    norm = np.linalg.norm(J, axis=0)
    return 1.0 / np.maximum(norm, 1e-3 * norm.max())


def flight_rank(J, tol=1e-7):
    """Rank by the flight software's square-root information and pivoted QR, six rows at a time."""
    n, ld = J.shape[1], lib.KC_COEF_MAX + 1
    R = np.zeros((n, ld))
    for start in range(0, len(J), 6):
        block = np.zeros((ld, 6))
        part = J[start : start + 6]
        block[:n, : len(part)] = part.T
        lib.kc_la_fold(pointer(R), n, ld, pointer(block))
    scale, pivot = column_scale(J), np.zeros(n)
    perm, rank = ffi.new("uint32_t[]", n), ffi.new("uint32_t *")
    lib.kc_la_rank(pointer(R), n, ld, pointer(scale), tol, perm, pointer(pivot), rank)
    return rank[0], list(perm), pivot


def dh_base_tool():
    """28 DH errors and a full twist of the base and of the tool frame."""
    coefs, terms = [], []
    for j in range(1, 8):
        for name, frame, comp in (
            ("phi", j - 1, "rz"),
            ("alpha", j, "rx"),
            ("a", j, "tx"),
            ("d", j - 1, "tz"),
        ):
            terms.append(term(len(coefs), frame, comp))
            coefs.append(f"J{j}.{name}")
    for name, frame in (("base", 0), ("tool", TOOL)):
        for comp in COMPONENTS:
            terms.append(term(len(coefs), frame, comp))
            coefs.append(f"{name}.{comp}")
    return terms_from(coefs, terms, 7)


@pytest.mark.parametrize(
    ("terms", "rows", "tool", "columns", "rank"),
    [
        ("dh", 6, (0, 0, 0), 28, 28),
        ("dh", 3, (0, 0, 0), 28, 24),
        ("dh", 3, (0, 0, 0.1), 28, 25),  # a tool point off the wrist also feels alpha_7
        ("dh_base_tool", 6, (0, 0, 0), 40, 34),
    ],
)
def test_rank_of_the_identification_jacobian(terms, rows, tool, columns, rank):
    """METHOD.md 1: full pose 28 of 28, position only 24, DH with base and tool 34 of 40."""
    J = stacked(60, dh_terms(7) if terms == "dh" else dh_base_tool(), rows, tool)
    assert J.shape[1] == columns
    assert np.linalg.matrix_rank(J * column_scale(J), tol=1e-8) == rank
    got, perm, pivot = flight_rank(J)
    assert got == rank
    assert sorted(perm) == list(range(columns))
    assert np.all(pivot[rank:] < 1e-12)


def test_all_dh_errors_are_well_conditioned_with_full_poses():
    J = stacked(60, dh_terms(7), 6)
    assert np.linalg.cond(J) < 4.0
