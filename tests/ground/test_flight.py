"""kincal.flight: the two builds of the core, arms, terms and the model at many poses."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from places import BIN
from scipy.spatial.transform import Rotation

from kincal import flight
from kincal.flight import (
    FRAME_CAMERA,
    FRAME_MEAS,
    FRAME_TOOL,
    Arm,
    Model,
    Observations,
    Terms,
    library,
    tables,
)
from kincal.flight import terms as flight_terms
from kincal.rotations import Pose, pose_difference
from kincal_shared.errors import BadInput, CannotAnswer, KincalError
from kincal_shared.schema.names import PNP, VARIABLES

TABLE = {kind: tables.decode((BIN / f"{kind}.tbl").read_bytes())[1] for kind in ("arm", "terms")}
GRAVITY = (0.0, 0.0, -9.81)


@dataclass(frozen=True)
class Joint:
    prismatic: bool = False
    a_m: float = 0.1
    alpha_rad: float = np.pi / 2
    d_m: float = 0.2
    phi_rad: float = 0.0
    q_min: float = -2.0
    q_max: float = 2.0
    mass_kg: float | None = None
    com_m: tuple | None = None
    gear_ratio: float | None = None


@dataclass(frozen=True)
class Description:
    joints: tuple
    name: str = "test arm"
    gravity_m_s2: tuple = GRAVITY


@dataclass(frozen=True)
class Basis:
    fn: str = "lin"
    var: str = "1"
    index: int = 0
    c0: float = 0.0
    c1: float = 1.0


@dataclass(frozen=True)
class Term:
    frame: int | str
    comp: int | str
    gain: float = 1.0
    basis: tuple = (Basis(), Basis())


@dataclass(frozen=True)
class Parameter:
    terms: tuple
    sigma: float = 0.1


def arm_of(n, seed=0, masses=True):
    rng = np.random.default_rng(seed)
    joints = []
    for j in range(n):
        a, alpha, d = rng.uniform(-0.3, 0.3), rng.uniform(-1.6, 1.6), rng.uniform(-0.3, 0.3)
        mass = {"mass_kg": rng.uniform(0.5, 5), "com_m": tuple(rng.normal(size=3) * 0.05)} if masses else {}
        joints.append(Joint(prismatic=j == 2, a_m=a, alpha_rad=alpha, d_m=d, **mass))
    return Description(tuple(joints))


def link(joint, q):
    turn, shift = (joint.phi_rad, joint.d_m + q) if joint.prismatic else (joint.phi_rad + q, joint.d_m)
    c, s, ca, sa = np.cos(turn), np.sin(turn), np.cos(joint.alpha_rad), np.sin(joint.alpha_rad)
    a = joint.a_m
    return np.array(
        [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, shift], [0, 0, 0, 1]]
    )


def random_pose(rng):
    return Pose(rng.normal(size=3), Rotation.random(random_state=rng).as_matrix())


EVERYWHERE = [(f, c) for f in (*range(5), FRAME_TOOL, FRAME_CAMERA, FRAME_MEAS) for c in range(6)]


def parameters(places=EVERYWHERE, basis=()):
    pair = (*basis, Basis(), Basis())[:2]
    return [(f"x{k}", Parameter((Term(f, c, 1.0, pair),))) for k, (f, c) in enumerate(places)]


def observed(n_poses, n_joints, seed=1, **more):
    rng = np.random.default_rng(seed)
    columns = {
        "q": rng.uniform(-1.5, 1.5, (n_poses, n_joints)),
        "p_m": rng.normal(size=(n_poses, 3)),
        "quat_wxyz": Rotation.random(n_poses, random_state=rng).as_quat(scalar_first=True),
        "cam_p_m": rng.normal(size=(n_poses, 3)) * 0.1 + [0, 0, -4],
        "cam_quat_wxyz": Rotation.from_rotvec(rng.normal(size=(n_poses, 3)) * 0.1).as_quat(scalar_first=True),
    }
    return Observations.of_columns(columns | more, GRAVITY)


# --------------------------------------------------------------------------- libraries


def test_the_ground_build_has_more_room_and_the_same_enumerations():
    small, big = library("flight"), library("ground")
    assert small.lib.KC_JOINT_MAX == 8 and small.lib.KC_COEF_MAX == 64 and small.lib.KC_FRAME_TOOL == 9
    assert big.lib.KC_JOINT_MAX >= 16 and big.lib.KC_COEF_MAX >= 256 and big.lib.KC_TERM_MAX >= 640
    for ctype, prefix in (("kc_var_t", "KC_VAR_"), ("kc_fn_t", "KC_FN_"), ("kc_comp_t", "KC_")):
        assert small.enum(ctype, prefix) == big.enum(ctype, prefix)
    assert small.enum("kc_state_t", "KC_ST_")["IDLE"] == 0
    assert small.constant("KC_CAND_LOCAL") == 1 << 15 and small.decimal("KC_HUB_BOUND") == 0.05


def test_a_library_that_was_not_built_is_named(monkeypatch, tmp_path):
    from kincal.flight import builds as module

    monkeypatch.setattr(module, "folders", lambda: [tmp_path])
    with pytest.raises(KincalError, match=r"libkincal_ground\.so was not found"):
        module.library_file("ground")


def test_declarations_are_parsed_once_and_again_when_they_change(tmp_path, monkeypatch, capsys):
    import cffi

    from kincal.flight.builds import _declared

    parsed, cdef = [], cffi.FFI.cdef
    monkeypatch.setattr(cffi.FFI, "cdef", lambda *given: parsed.append(1) or cdef(*given))
    two, three = (f"#define N {n}\ntypedef struct {{ double a; int b[{n}]; }} one_t;" for n in (2, 3))
    kept = tmp_path / "one.parsed"
    for declarations, size, times in ((two, 16, 1), (two, 16, 1), (three, 24, 2), (three, 24, 2)):
        ffi = _declared(declarations, kept)
        assert (ffi.sizeof("one_t"), ffi.dlopen(None).N, len(parsed)) == (size, size // 8, times)
    kept.write_bytes(b"\xff" + kept.read_bytes())  # damaged, then nowhere to be kept
    for place in (kept, tmp_path / "none" / "one.parsed"):
        assert _declared(three, place).sizeof("one_t") == 24
    assert len(parsed) == 4 and list(tmp_path.iterdir()) == [kept]
    assert capsys.readouterr() == ("", "")


def test_numpy_sees_structs_as_c_does():
    for build in ("flight", "ground"):
        lib = library(build)
        for ctype in ("kc_obs_t", "kc_arm_t", "kc_terms_t", "kc_loads_t", "kc_eval_t"):
            assert lib.dtype(ctype).itemsize == lib.ffi.sizeof(ctype)
    lib = library("flight")
    arm = TABLE["arm"]
    rows = lib.rows(arm.joint, arm.n_joints)
    assert rows["q_max"].tolist() == [arm.joint[i].q_max for i in range(arm.n_joints)]


def test_structs_copy_and_fill():
    lib = library("flight")
    other = lib.copy(TABLE["arm"])
    lib.set_fields(other, {"name": "other", "joint": [{"a_m": 7.0}], "base_xyz_m": np.ones(3)})
    assert lib.text(other.name) == "other" and other.joint[0].a_m == 7.0
    assert TABLE["arm"].joint[0].a_m != 7.0
    with pytest.raises(ValueError, match="room for 3"):
        lib.set_fields(other, {"base_xyz_m": [0, 0, 0, 0]})


def test_names_of_the_grammar_are_those_of_the_headers():
    assert flight_terms.functions()["ln1p"] == library("flight").lib.KC_FN_LN1P
    assert flight_terms.components() == {"tx": 0, "ty": 1, "tz": 2, "rx": 3, "ry": 4, "rz": 5}
    for name, want in (("1", "ONE"), ("Mx", "MX"), ("taup", "TAU_PAYLOAD"), ("sz", "ZCAM"), ("q", "Q")):
        assert flight_terms.variable(name) == library("flight").constant(f"KC_VAR_{want}")
    with pytest.raises(KeyError):
        flight_terms.variable("nonsense")


# --------------------------------------------------------------------------- arms


@pytest.mark.parametrize("n", [1, 7, 16])
def test_frames_are_products_of_links(n):
    rng = np.random.default_rng(n)
    description, base, tool = arm_of(n), random_pose(rng), random_pose(rng)
    arm = Arm.of(description, base, tool)
    q = rng.uniform(-2, 2, (4, n))
    got = arm.frames(q).matrix
    for i in range(4):
        T = base.matrix
        np.testing.assert_allclose(got[i, 0], T, atol=1e-13)
        for j, joint in enumerate(description.joints):
            T = T @ link(joint, q[i, j])
            np.testing.assert_allclose(got[i, j + 1], T, atol=1e-13)
        np.testing.assert_allclose(got[i, n + 1], T @ tool.matrix, atol=1e-13)
    np.testing.assert_array_equal(arm.fk(q[0]).matrix, got[0, -1])
    np.testing.assert_array_equal(arm.points(q)[:, 0], np.zeros((4, 3)))
    np.testing.assert_array_equal(arm.points(q)[:, 1:-1], arm.frames(q).p_m[:, :-2])


def test_an_arm_table_is_the_arm_that_flies():
    arm, lib = Arm.of_table(TABLE["arm"]), library("flight")
    q = np.linspace(-0.5, 0.5, 7)
    pose = lib.new("kc_pose_t")
    lib.lib.kc_arm_fk(TABLE["arm"], lib.pointer(q), pose)
    np.testing.assert_array_equal(arm.fk(q).p_m, lib.array(pose.p_m))
    np.testing.assert_array_equal(arm.fk(q).R, lib.array(pose.R, 3, 3))
    longer = Arm.of_table(TABLE["arm"], {"J3.d_m": 0.01, "J1.phi_rad": 0.02, "encoder_gain[2]": 1.0})
    assert longer.struct.joint[2].d_m == TABLE["arm"].joint[2].d_m + 0.01
    assert longer.struct.joint[0].phi_rad == TABLE["arm"].joint[0].phi_rad + 0.02


def test_masses_count_only_if_all_are_known():
    joints = arm_of(3).joints
    some = Description((joints[0], Joint(), joints[2]))
    assert [Arm.of(Description(joints)).struct.joint[j].has_mass for j in range(3)] == [1, 1, 1]
    assert [Arm.of(some).struct.joint[j].has_mass for j in range(3)] == [0, 0, 0]


def test_dh_names_of_the_core_have_one_digit():
    ground = library("ground")
    terms, bound = ground.new("kc_terms_t"), ground.pointer(np.ones(4))
    assert ground.lib.kc_terms_add_dh(terms, 10, bound) == ground.lib.KC_ERR_FULL
    assert ground.lib.kc_terms_add_dh(terms, 9, bound) == ground.lib.KC_OK
    assert Terms(terms).names[-1] == "J9.d_m"


def test_too_many_joints_are_refused():
    with pytest.raises(BadInput, match="17 joints, at most 16"):
        Arm.of(arm_of(17))
    with pytest.raises(ValueError, match="3 joint values for an arm of 4"):
        Arm.of(arm_of(4)).fk(np.zeros(3))


# --------------------------------------------------------------------------- the model


def model_of(n=4, n_poses=5, basis=(), places=EVERYWHERE, **more):
    rng = np.random.default_rng(9)
    arm = Arm.of(arm_of(n), random_pose(rng), random_pose(rng))
    return Model(arm, Terms.of(parameters(places, basis)), observed(n_poses, n, **more))


def test_residuals_of_the_nominal_arm_are_measured_minus_model():
    model = model_of()
    zero = np.zeros(model.terms.n)
    records = model.observations.records
    measured = Pose.of_wxyz(records["p_m"], records["q_wxyz"])
    fk = model.arm.fk(records["ctx"]["q"][:, :4])
    np.testing.assert_allclose(model.residuals(zero), pose_difference(measured, fk), atol=1e-12)
    np.testing.assert_allclose(model.poses(zero).matrix, fk.matrix, atol=1e-13)


def test_jacobian_and_twist_are_finite_differences():
    model = model_of(n_poses=3)
    x, h = np.full(model.terms.n, 0.01), 1e-6
    got = model.evaluate(x)
    for k, (frame, comp) in enumerate(EVERYWHERE):
        step = h * np.eye(model.terms.n)[k]
        slope = -(model.residuals(x + step)[:, :3] - model.residuals(x - step)[:, :3]) / (2 * h)
        np.testing.assert_allclose(got.J[:, :3, k], slope, atol=2e-8)
        np.testing.assert_allclose(got.twist[:, frame, comp], got.J[:, :, k], atol=1e-14)


def test_positions_alone_give_three_rows():
    data = {"q": np.zeros((2, 4)), "p_m": np.ones((2, 3))}
    model = model_of().at(Observations.of_columns(data, GRAVITY))
    got = model.evaluate(np.zeros(model.terms.n))
    assert got.r.shape == (2, 3) and got.J.shape == (2, 3, 48)
    assert got.twist.shape == (2, 8, 6, 3) and got.Jq.shape == (2, 3, 4)


def test_no_call_changes_another():
    model = model_of(basis=(Basis(var="tau", index=2), Basis(var="xcam")))
    rng = np.random.default_rng(2)
    x, y = rng.normal(size=(2, model.terms.n)) * 1e-3
    first, values = model.evaluate(x), model.basis_values(Basis(var="zcam"), x)
    model.evaluate(y), model.residuals(y, loads_at=x), model.basis_values(Basis(var="tau", index=1), y)
    again = model.evaluate(x)
    for name in ("r", "J", "twist", "Jq"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    np.testing.assert_array_equal(values, model.basis_values(Basis(var="zcam"), x))
    np.testing.assert_array_equal(first.r, model.residuals(x))  # with terms on the camera side
    for both in zip((first.r, first.J), model.linearised(x), strict=True):
        np.testing.assert_array_equal(*both)
    with pytest.raises(ValueError, match="read-only"):
        model.observations.records["p_m"][0] = 0.0


def test_residuals_alone_are_those_of_an_evaluation():
    for places in (EVERYWHERE, EVERYWHERE[:36]):  # with and without terms on the camera side
        model = model_of(basis=(Basis(var="tau", index=2), Basis(var="q", index=1)), places=places)
        x = np.random.default_rng(2).normal(size=model.terms.n) * 1e-3
        np.testing.assert_allclose(model.residuals(x), model.evaluate(x).r, rtol=0, atol=1e-14)
    few = {"q": np.zeros((2, 4)), "p_m": np.ones((2, 3))}
    model = model.at(Observations.of_columns(few, GRAVITY))
    np.testing.assert_allclose(model.residuals(x), model.evaluate(x).r, rtol=0, atol=1e-15)


def test_loads_stay_at_the_coefficients_that_are_given():
    # joint 2 gives way under gravity; a longer last link changes the torque, but not while loads are held
    sag = Parameter((Term(1, "rz", 1.0, (Basis(var="tau", index=2), Basis())),))
    longer = Parameter((Term(4, "tx"),))
    model = Model(Arm.of(arm_of(4)), Terms.of([("sag", sag), ("longer", longer)]), observed(3, 4))
    zero, x = np.zeros(2), np.array([1e-2, 0.5])
    held = model.basis_values(Basis(var="tau", index=2), zero)
    moved = model.basis_values(Basis(var="tau", index=2), x)
    assert np.abs(held - moved).max() > 1e-3
    assert np.abs(model.residuals(x) - model.residuals(x, loads_at=zero)).max() > 1e-6


def test_the_view_is_a_fixed_point():
    # the scale of what the camera sees: where the tool is seen depends on the correction itself
    scale = Parameter(
        tuple(
            Term("meas", c, 1.0, (Basis(var=f"{v}cam"), Basis()))
            for c, v in (("tx", "x"), ("ty", "y"), ("tz", "z"))
        )
    )
    model = Model(Arm.of(arm_of(4)), Terms.of([("scale", scale)]), observed(5, 4))
    x = np.array([0.02])
    records = model.observations.records
    R = Rotation.from_quat(records["q_cam_wxyz"], scalar_first=True).as_matrix()
    expected = records["p_m"] - model.residuals(x)[:, :3] - records["p_cam_m"]
    seen = np.einsum("nji,nj->ni", R, expected)
    for axis, name in enumerate(("xcam", "ycam", "zcam")):
        np.testing.assert_allclose(model.basis_values(Basis(var=name), x), seen[:, axis], atol=1e-12)
    np.testing.assert_allclose(model.basis_values(Basis(var="u"), x), seen[:, 0] / seen[:, 2], atol=1e-12)


PLAIN = [name for name in VARIABLES if name not in (*PNP, "1")]


def basis_of(name):
    index = 16 * 1 + 3 if VARIABLES[name].of_body else int(VARIABLES[name].indexed)
    return Basis(var=VARIABLES[name].flight, index=index)


@pytest.mark.parametrize("name", PLAIN)
def test_a_term_of_any_variable_sees_the_tool_where_the_model_expects_it(name):
    # beside a term that is known to look at the view, and is zero, nothing changes
    term = Parameter((Term("camera", "ry", 1.0, (basis_of(name), Basis())),))
    view = Parameter((Term("meas", "tx", 1.0, (Basis(var="xcam"), Basis())),))
    data = observed(5, 4, payload_kg=np.full(5, 0.5), t_s=np.ones(5))
    alone, beside = (
        Model(Arm.of(arm_of(4)), Terms.of(rows), data)
        for rows in ([("x", term)], [("x", term), ("view", view)])
    )
    got = alone.residuals(np.array([0.05]))
    np.testing.assert_allclose(got, beside.residuals(np.array([0.05, 0.0])), atol=1e-11)


@pytest.mark.parametrize("name", PLAIN)
def test_modelled_variables_follow_the_model_and_no_others(name):
    # the workbench remembers the values of the others for a whole data set
    model = model_of(payload_kg=np.full(5, 0.5))
    x = np.random.default_rng(3).normal(0.0, 0.01, model.terms.n)
    zero, moved = (model.basis_values(basis_of(name), at) for at in (np.zeros(model.terms.n), x))
    assert bool((zero != moved).any()) == VARIABLES[name].modelled


def test_pixels_stay_as_measured():
    model = model_of(u_norm=np.full(5, 0.25), v_norm=np.full(5, -0.5))
    zero = np.zeros(model.terms.n)
    np.testing.assert_array_equal(model.basis_values(Basis(var="u"), zero), 0.25)
    np.testing.assert_array_equal(model.basis_values(Basis(var="r2"), zero), 0.3125)


def test_columns_of_the_data_reach_their_variables():
    names = ("temp", "t", "payload", "range", "incid", "pan", "tilt", "tag")
    columns = ("temp_c", "t_s", "payload_kg", "range_m", "incid_rad", "pan_rad", "tilt_rad", "tag")
    values = {column: np.full(5, 0.5 + k) for k, column in enumerate(columns)}
    model = model_of(**values, direction=np.full((5, 4), -1.0), qdot=np.full((5, 4), 0.125))
    zero = np.zeros(model.terms.n)
    for k, name in enumerate(names):
        np.testing.assert_array_equal(model.basis_values(Basis(var=name), zero), 0.5 + k)
    np.testing.assert_array_equal(model.basis_values(Basis(var="dir", index=3), zero), -1.0)
    np.testing.assert_array_equal(model.basis_values(Basis(var="qdot", index=4), zero), 0.125)
    few = model.at(model.observations.take([3, 1]))
    np.testing.assert_array_equal(few.residuals(zero), model.residuals(zero)[[3, 1]])


def test_sixteen_joints_and_256_coefficients_are_enough_room():
    places = [(f, c) for f in (*range(17), FRAME_TOOL, FRAME_CAMERA, FRAME_MEAS) for c in range(6)] * 2
    model = model_of(n=16, places=places, n_poses=2)
    got = model.evaluate(np.zeros(240))
    np.testing.assert_array_equal(got.J[..., :120], got.J[..., 120:])
    assert np.isfinite(got.J).all() and got.twist.shape == (2, 20, 6, 6)
    with pytest.raises(CannotAnswer, match="360 coefficients, the ground tool carries at most 256"):
        Terms.of(parameters(places + places[:120]))


def test_a_term_table_flies_as_it_is_evaluated_on_the_ground():
    lib = library("flight")
    arm, terms = Arm.of_table(TABLE["arm"]), Terms.of_table(TABLE["terms"])
    rng = np.random.default_rng(5)
    coef = rng.normal(size=terms.n) * 1e-3
    data = observed(6, 7, direction=np.ones((6, 7)), temp_c=np.full(6, -40.0))
    model = Model(arm, terms, data)
    got = model.evaluate(coef)
    ctx_names = ("q", "dir", "qdot", "g_m_s2", "p_cam_tool_m")
    held = model._hold(coef).observations
    for i in range(6):
        obs, loads, ev = lib.new("kc_obs_t"), lib.new("kc_loads_t"), lib.new("kc_eval_t")
        for name in ctx_names:
            values = held["ctx"][name][i]
            lib.array(getattr(obs.ctx, name))[:] = values[: len(getattr(obs.ctx, name))]
        obs.ctx.temp_c = -40.0
        obs.ctx.u_norm, obs.ctx.v_norm = held["ctx"]["u_norm"][i], held["ctx"]["v_norm"][i]
        for name in ("p_m", "q_wxyz", "p_cam_m", "q_cam_wxyz"):
            lib.array(getattr(obs, name))[:] = held[name][i]
        obs.has_rot = obs.has_cam = 1
        full, r = np.zeros(lib.lib.KC_COEF_MAX), np.zeros(6)
        full[: terms.n] = coef
        lib.lib.kc_model_loads(TABLE["arm"], TABLE["terms"], lib.pointer(full), lib.address(obs.ctx), loads)
        lib.lib.kc_model_residual(
            TABLE["arm"], TABLE["terms"], lib.pointer(full), obs, loads, lib.pointer(r), ev
        )
        np.testing.assert_array_equal(got.r[i], r)
        np.testing.assert_array_equal(got.J[i], lib.array(ev.J, terms.n, 6).T)
    assert terms.names[:4] == ("J1.phi_rad", "J1.alpha_rad", "J1.a_m", "J1.d_m")


def test_wrong_shapes_and_frames_are_refused():
    model = model_of()
    with pytest.raises(ValueError, match="expected shape"):
        model.residuals(np.zeros(3))
    with pytest.raises(ValueError, match="observations of 4 joints, an arm of 7"):
        Model(Arm.of_table(TABLE["arm"]), model.terms, model.observations)
    with pytest.raises(ValueError, match="no frame 40"):
        Terms.of(parameters([(40, 0)]))


def test_measurements_of_a_data_set_become_observations():
    @dataclass(frozen=True)
    class Data:
        q: np.ndarray = field(default_factory=lambda: np.zeros((2, 3)))
        p_m: np.ndarray = field(default_factory=lambda: np.ones((2, 3)))
        quat_wxyz: None = None
        cam_p_m: np.ndarray = field(default_factory=lambda: np.zeros((2, 3)))
        cam_quat_wxyz: np.ndarray = field(default_factory=lambda: np.tile([1.0, 0, 0, 0], (2, 1)))
        u_px: np.ndarray = field(default_factory=lambda: np.array([110.0, 90.0]))
        v_px: np.ndarray = field(default_factory=lambda: np.array([50.0, 50.0]))

    @dataclass(frozen=True)
    class Camera:
        fx_px: float = 100.0
        fy_px: float = 100.0
        cx_px: float = 100.0
        cy_px: float = 50.0

    plain = Observations.of(Data(), GRAVITY)
    seen = Observations.of(Data(), GRAVITY, Camera())
    assert (plain.n, plain.n_joints, plain.components, plain.keep_image) == (2, 3, 3, False)
    np.testing.assert_allclose(seen.records["ctx"]["u_norm"], [0.1, -0.1])
    np.testing.assert_allclose(plain.records["ctx"]["u_norm"], 1.0)


def test_events_are_put_into_words():
    number = library("flight").lib.KC_EVT_TBL_NOT_UNIT
    assert flight.event_name(number) == "TBL_NOT_UNIT"
    assert flight.event_line(number, 3, 0.5, 1.0).startswith("TBL_NOT_UNIT: ")


def test_lists_and_enumerations_of_tables_are_fields_of_the_headers():
    ffi = library("flight").ffi
    for struct, lists in tables.LISTS.items():
        fields = {name for name, _ in ffi.typeof(struct).fields}
        assert set(lists) | set(lists.values()) <= fields, struct
    for (struct, name), (enumeration, prefix) in tables.ENUMS.items():
        assert name in {field_name for field_name, _ in ffi.typeof(struct).fields}
        assert library("flight").enum(enumeration, prefix)
    counters = {
        f for kind in tables.kinds() for f, _ in ffi.typeof(f"kc_{kind}_t").fields if f.startswith("n_")
    }
    listed = {counter for lists in tables.LISTS.values() for counter in lists.values()}
    assert counters - listed <= {"n_hub", "n_joints", "n_poses", "n_stop"}


def test_every_table_is_its_dict_again():
    for kind in tables.kinds():
        image, struct = tables.decode((BIN / f"{kind}.tbl").read_bytes(), kind)
        doc = tables.to_doc(struct)
        if kind == "space":  # bit sets are bytes: they are written, not listed
            continue
        again = tables.new(kind)
        tables.fill(again, doc, kind)
        assert tables.encode(kind, again) == image
