"""Exports: generated Python and C, DH table, URDF and JSON against `predict` and against Pinocchio."""

from __future__ import annotations

import itertools
import json
import re
import sys
from dataclasses import replace

import boards
import numpy as np
import poses
import pytest
from commands import good, shell
from exports import CModule, drivers_at, hypothesis, python_module, random_data, unfitted
from places import DATA
from scipy.spatial.transform import Rotation

from kincal import workbench as wb
from kincal.cli.errors import EXIT_INPUT
from kincal.export import calibrated_fit, dh_table
from kincal.export.dh import four_parameter_table
from kincal.export.source import c_header, c_source, describe, python_source, source_left_out
from kincal.export.urdf import roll_pitch_yaw, urdf
from kincal.workbench.comparison.fitrecord import sight_entry
from kincal.workbench.data.readers import read_measurements
from kincal.workbench.fit.least_squares import fit_model
from kincal.workbench.model.effects import Library
from kincal.workbench.model.pnp import column_number
from kincal_shared.errors import BadInput
from kincal_shared.schema.arm import read_arm
from kincal_shared.schema.model import FitEntry, FrameEntry
from kincal_shared.schema.names import FAULTS, FUNCTIONS, LEVER_STRIDE, PNP, VARIABLES
from kincal_shared.schema.terms import ONE, Basis

FRAME = FrameEntry(xyz_m=(0, 0, 0), quat_wxyz=(1, 0, 0, 0))
RECORD = FitEntry(
    when="2026-01-01T00:00:00+00:00", tool_version="0", arm_sha256="", poses=1, components=6, noise_scale=1.0,
    base=FRAME, tool=FRAME,
)  # fmt: skip
PRISMATIC = """name = "gantry */ \\"2\\""
convention = "modified"
gravity_m_s2 = [0.3, 0.2, -9.7]
[base]
xyz_m = [0.1, -0.2, 0.3]
quat_wxyz = [0.5, 0.5, -0.5, 0.5]
[tool]
xyz_m = [0.02, 0.03, 0.1]
quat_wxyz = [0.7071067811865476, 0.0, 0.7071067811865476, 0.0]
"""
MASS = "mass_kg = {m}\ncom_m = [0.02, -0.03, {m}e-2]\n"


def prismatic(tmp_path, masses=True):
    """Slides and turns mixed, antiparallel and skew axes, modified DH."""
    text = PRISMATIC
    rows = [
        ("prismatic", 0.1, 0.3, 0.2, 0.1),
        ("revolute", 0.4, "pi", 0.1, -0.4),
        ("prismatic", 0.0, 1.2, 0.3, 0.7),
        ("revolute", 0.2, "-pi/2", 0.0, 0.0),
        ("revolute", 0.05, 0.7, 0.2, 1.0),
    ]
    for k, (kind, a, alpha, d, phi) in enumerate(rows, 1):
        unit = "m" if kind == "prismatic" else "rad"
        text += f'[[joint]]\ntype = "{kind}"\na_m = {a}\nalpha_rad = "{alpha}"\nd_m = {d}\nphi_rad = {phi}\n'
        text += f"q_min_{unit} = -1.5\nq_max_{unit} = 1.5\n" + (MASS.format(m=k) if masses else "")
    (tmp_path / "gantry.toml").write_text(text)
    return read_arm(tmp_path / "gantry.toml")


def arm_named(name, tmp_path):
    if name == "gantry":
        return prismatic(tmp_path)
    if name == "wam":
        return read_arm(poses.arm_toml(tmp_path / "wam.toml"))
    return read_arm(name)


def generated(fit, tmp_path):
    """Python module and C library of a fit."""
    arm = calibrated_fit(fit, RECORD.model_copy(update={"sight": sight_entry(fit)}))
    (tmp_path / "made.py").write_text(python_source(arm))
    (tmp_path / "made.c").write_text(c_source(arm, "made.h"))
    (tmp_path / "made.h").write_text(c_header(arm))
    about = describe(arm, "c")
    drivers = [(d.name, d.size) for d in about.drivers] + ([("image", 2)] if about.uses_image else [])
    return python_module(tmp_path / "made.py"), CModule(tmp_path / "made.c", about.prefix, drivers, arm.n)


def matrix(pose):
    p, R = pose
    out = np.eye(4)
    out[:3, 3], out[:3, :3] = p, R
    return out


def everything(n):
    """Effects with each basis function and each variable, on every kind of place."""
    places = itertools.cycle([0, 1, n - 1, n, "tool", "camera", "meas"])
    comps = itertools.cycle(range(6))
    indexed = {name: 1 + k % n for k, name in enumerate(VARIABLES) if VARIABLES[name].indexed}
    indexed |= {"levx": LEVER_STRIDE * 1 + 3, "levy": LEVER_STRIDE * 2 + n, "levz": LEVER_STRIDE * 0}
    bases = [Basis("lin", v, indexed.get(v, 0), 0.3, 0.7) for v in VARIABLES if v != "1" and v not in PNP]
    bases += [Basis("lin", v, 0) for v in ("Mx", "My", "Mz", "gx", "gy", "gz")]
    bases += [Basis(fn, "q", 1 + k % n, -0.2, 1.7) for k, fn in enumerate(FUNCTIONS)]
    bases += [Basis("tan2", "incid", 0), Basis("step", "t", 0, 1800.0), Basis("tanh", "tau", 2, 0.0, 0.1)]
    small = {
        "gx": 0.1, "gy": 0.1, "gz": 0.1, "levx": 0.1, "levy": 0.1, "levz": 0.1, "t": 1e-3, "temp": 0.1,
        "tau": 0.02, "Mx": 0.02, "My": 0.02, "Mz": 0.02, "taup": 0.02,
    }  # fmt: skip
    torque = Basis("sin", "tau", n, 0.0, 0.1)
    other = itertools.cycle([ONE, Basis("cos", "q", 1), Basis("lin", "payload", 0), torque])
    rows = [
        (frame, comp, small.get(b.var, 1.0), b, second)
        for b, frame, comp, second in zip(bases, places, comps, other, strict=False)
    ]
    constant = [
        ("camera", 0, 1.0, ONE, ONE),
        ("meas", 4, 1.0, ONE, ONE),
        (2, 4, 1.0, ONE, ONE),
        (n, 5, 1.0, ONE, ONE),
    ]
    return [hypothesis("everything", *rows, *constant)]


def of_library(arm, names):
    return [
        h
        for name in names
        for h in Library.load().find(name, arm, None, {"t0": 900.0, "tau": 600.0, "k": 7.3})
    ]


MODELS = {
    "wam, every basis": ("wam", None),
    "gantry, every basis": ("gantry", None),
    "wam, effects of the library": ("wam", ["joint_compliance", "backlash[4]", "link_bending", "base_flex",
        "joint_coupling[5,6]", "bias_step[3]", "payload_sag", "link_thermal_growth", "latency", "tag_scale",
        "lens_radial", "camera_shift", "range_incidence_bias", "base_settling"]),
    "fr3, modified DH": ("fr3", ["encoder_eccentricity[2]", "joint_ripple[6]", "joint_gravity",
        "link_gravity_tilt[2]", "sensor_scale"]),
    "wam, DH alone": ("wam", []),
}  # fmt: skip


@pytest.fixture(params=MODELS, scope="module")
def model(request, tmp_path_factory):
    """A fit with random coefficients, data, and its generated code."""
    tmp_path = tmp_path_factory.mktemp("model")
    name, effects = MODELS[request.param]
    arm = arm_named(name, tmp_path)
    found = everything(arm.n) if effects is None else of_library(arm, effects)
    own_sensor = request.param.startswith("fr3")
    data = random_data(arm, 5, cam_p_m=not own_sensor, cam_quat_wxyz=not own_sensor)
    fit = unfitted(arm, data, found)
    return fit, data, *generated(fit, tmp_path)


def all_drivers(module, data, i):
    return drivers_at(data, i, {*module.DEFAULTS, *module.NEEDED})


def measured_is_what_predict_expects(fit, data, module, c):
    """Poses measured as the generated code says leave no residual. Returns them."""
    report = module.measured if hasattr(module, "measured") else module.forward
    said = [matrix(report(data.q[i], **all_drivers(module, data, i))) for i in range(data.n)]
    poses_said = np.array(said)
    quat = Rotation.from_matrix(poses_said[:, :3, :3]).as_quat(scalar_first=True)
    measured = replace(data, p_m=poses_said[:, :3, 3], quat_wxyz=quat)
    assert np.abs(fit.predict(measured)).max() < 1e-9
    for i in range(data.n):
        in_c = getattr(c, report.__name__)(data.q[i], **all_drivers(module, data, i))
        assert np.abs(in_c - said[i]).max() < 1e-9
    return poses_said


def test_generated_code_gives_what_predict_gives_with_every_effect(model):
    fit, data, module, c = model
    measured_is_what_predict_expects(fit, data, module, c)
    for i in range(data.n):
        d = all_drivers(module, data, i)
        assert np.abs(c.forward(data.q[i], **d) - matrix(module.forward(data.q[i], **d))).max() < 1e-9
        assert np.abs(c.nominal(data.q[i]) - matrix(module.nominal(data.q[i]))).max() < 1e-9


def test_effects_of_the_generated_code_do_something(model):
    fit, data, module, _ = model
    d = all_drivers(module, data, 0)
    moved = np.linalg.norm(module.forward(data.q[0], **d)[0] - module.nominal(data.q[0])[0])
    assert 1e-3 < moved < 1.0


# --------------------------------------------------------------------------- the way back

# Bent arms, far from singular poses and limits.
BENT = {5: [0.2, -0.5, 0.3, 0.6, -0.4], 7: [0.2, 0.5, -0.3, 1.5, 0.2, -0.9, 0.3]}
BENT_FR3 = [0.1, 0.3, 0.2, -1.8, 0.1, 1.9, 0.3]


def bent(arm, seed):
    middle = BENT_FR3 if "Franka" in arm.name else BENT[arm.n]
    return middle + np.random.default_rng(seed).uniform(-0.2, 0.2, (3, arm.n))


def test_inverse_reaches_a_pose_and_both_languages_agree(model):
    fit, data, module, c = model
    for i, q in enumerate(bent(fit.arm, 1)):
        d = all_drivers(module, data, i)
        p, R = module.forward(q, **d)
        found = module.inverse(p, R, q + 0.1, **d)
        again = module.forward(found, **d)
        assert np.linalg.norm(again[0] - p) < 2e-9
        assert np.abs(again[1] - R).max() < 2e-9
        for wanted in (R, None):
            q_c, reached = c.inverse(p, wanted, q + 0.1, **d)
            assert reached
            assert np.abs(q_c - module.inverse(p, wanted, q + 0.1, **d)).max() < 1e-7


def test_correct_brings_the_real_tool_to_where_it_was_planned(model):
    fit, data, module, c = model
    for i, q in enumerate(bent(fit.arm, 2)):
        d = all_drivers(module, data, i)
        planned, corrected = module.nominal(q), module.correct(q, **d)
        reached = module.forward(corrected, **d)
        assert np.linalg.norm(module.forward(q, **d)[0] - planned[0]) > 1e-3
        assert np.linalg.norm(reached[0] - planned[0]) < 2e-9
        assert fit.arm.n < 6 or np.abs(reached[1] - planned[1]).max() < 2e-9
        q_c, ok = c.correct(q, **d)
        assert ok
        assert np.abs(q_c - corrected).max() < 1e-7


def test_orientation_is_left_alone_where_none_was_measured(tmp_path):
    """Positions do not fix the wrist: joints that only a restored orientation would move stay as planned."""
    arm = arm_named("wam", tmp_path)
    arm = replace(arm, tool=replace(arm.tool, xyz_m=np.zeros(3)))
    fit = unfitted(arm, random_data(arm, 5), [])
    record = RECORD.model_copy(update={"components": 3})
    (tmp_path / "made.py").write_text(python_source(calibrated_fit(fit, record)))
    module, q = python_module(tmp_path / "made.py"), np.array(BENT[7])
    sent = module.correct(q)
    assert np.linalg.norm(module.forward(sent)[0] - module.nominal(q)[0]) < 2e-9
    assert np.abs(module.forward(sent)[1] - module.nominal(q)[1]).max() > 1e-3
    assert np.abs(sent - q)[6] < 1e-3


@pytest.mark.parametrize("model", ["gantry, every basis", "wam, DH alone"], indirect=True)
def test_unreachable_pose_is_said_in_both_languages(model):
    _, data, module, c = model
    d = all_drivers(module, data, 0)
    with pytest.raises(ValueError, match="not reached"):
        module.inverse([50.0, 0, 0], None, data.q[0], **d)
    assert not c.inverse([50.0, 0, 0], None, data.q[0], **d)[1]


def test_missing_and_unknown_drivers_are_named(tmp_path):
    arm = arm_named("wam", tmp_path)
    data = random_data(arm, 5)
    module, _ = generated(unfitted(arm, data, of_library(arm, ["backlash[4]"])), tmp_path)
    with pytest.raises(ValueError, match="direction"):
        module.forward(data.q[0])
    with pytest.raises(ValueError, match="wind"):
        module.forward(data.q[0], direction=data.direction[0], wind=3)


def test_every_variable_and_function_of_the_grammar_is_exported():
    from kincal.export import expressions

    assert {name for name in VARIABLES if expressions.known(name)} == set(VARIABLES) - {"1"}
    assert not {name for name, of in VARIABLES.items() if of.given and of.computed}
    assert set(expressions._FUNCTIONS) == set(FUNCTIONS)


# --------------------------------------------------------------------------- DH table and URDF


def constants_only(fit):
    """The fit with the coefficients of varying terms and of the sensor set to zero, by their names."""
    varying = [
        any(b.var != "1" for t in p.terms for b in t.basis) or any(t.frame in (-2, -1) for t in p.terms)
        for p in fit.parameters
    ]
    return replace(fit, estimate=np.where(varying, 0.0, fit.estimate))


def predicted(fit, data):
    """4x4 tool poses by the flight model."""
    from kincal.workbench.model.flight_model import observations

    return fit.model.at(observations(fit.arm, data)).poses(fit.estimate).matrix


CONSTANT_MODELS = {
    "wam": ("wam", ["encoder_bias", "base_tilt", "base_shift", "tool_shift", "joint_compliance"]),
    "gantry": ("gantry", ["encoder_bias[3]", "tool_shift"]),
    "fr3": ("fr3", []),
    "ur10e": ("ur10e", ["base_shift"]),
}


@pytest.fixture(params=CONSTANT_MODELS, scope="module")
def constant(request, tmp_path_factory):
    tmp_path = tmp_path_factory.mktemp("constant")
    name, effects = CONSTANT_MODELS[request.param]
    arm = arm_named(name, tmp_path)
    arm = replace(arm, base=replace(arm.base, estimate=True), tool=replace(arm.tool, estimate=True))
    data = random_data(arm, 6, 40, cam_p_m=False, cam_quat_wxyz=False)
    return unfitted(arm, data, of_library(arm, effects)), data


def no_beta(fit):
    """The fit with no turn between parallel axes."""
    return replace(fit, estimate=np.where([n.endswith(".beta_rad") for n in fit.names], 0.0, fit.estimate))


def test_dh_table_is_an_arm_table_that_gives_the_constant_part_of_predict(constant, tmp_path):
    from kincal.export.tabular import arm_toml
    from kincal.flight import Arm
    from kincal.rotations import Pose

    fit, data = no_beta(constant[0]), constant[1]
    arm = calibrated_fit(fit, RECORD)
    (tmp_path / "dh.toml").write_text(arm_toml(arm, four_parameter_table(arm)))
    again = read_arm(tmp_path / "dh.toml")
    assert not again.base.estimate
    frames = [Pose.of_wxyz(f.xyz_m, f.quat_wxyz) for f in (again.base, again.tool)]
    got = Arm.of(again, *frames).fk(data.q).matrix
    assert np.abs(got - predicted(constants_only(fit), data)).max() < 1e-9


def screw(axis, shift, angle):
    """(4, 4) shift along and turn about an axis, 0 x .. 2 z."""
    out = np.eye(4)
    out[:3, :3] = Rotation.from_rotvec(angle * np.eye(3)[axis]).as_matrix()
    out[axis, 3] = shift
    return out


def test_dh_csv_gives_the_constant_part_of_predict_with_beta(constant):
    """Rz(phi + q) Tz(d) Tx(a) Rx(alpha) Ry(beta) of Hayati and Mirmirani, with the numbers of the CSV."""
    from kincal.export.tabular import dh_csv

    fit, data = constant
    arm = calibrated_fit(fit, RECORD)
    table = dh_table(arm)
    lines = dh_csv(arm, table).splitlines()
    rows = [line.split(",") for line in lines if line.startswith("joint")]
    turned = sum(name.endswith(".beta_rad") for name in fit.names)
    assert len(rows) == 4 * fit.arm.n + turned
    for row in rows:
        assert float(row[3]) + float(row[4]) == pytest.approx(float(row[5]), abs=1e-15)
    want = predicted(constants_only(fit), data)
    for q, pose in zip(data.q, want, strict=True):
        got = table.base.pose.matrix
        for k, joint in enumerate(fit.arm.joints, 1):
            v = {row[1]: float(row[5]) for row in rows if row[0] == f"joint {k}"}
            slide, turn = (q[k - 1], 0.0) if joint.prismatic else (0.0, q[k - 1])
            got = got @ screw(2, v["d_m"] + slide, v["phi_rad"] + turn) @ screw(0, v["a_m"], v["alpha_rad"])
            got = got @ screw(1, 0.0, v.get("beta_rad", 0.0))
        assert np.abs(got @ table.tool.pose.matrix - pose).max() < 1e-9


def test_arm_table_without_beta_is_as_good_as_a_fit_without_beta(tmp_path, monkeypatch):
    """An arm table has no place for beta. Its other numbers are those that fit best without, to first
    order."""
    from kincal.export.tabular import arm_toml
    from kincal.workbench.model.parameters import dh_parameters

    arm = arm_named("ur10e", tmp_path)
    arm = replace(arm, base=replace(arm.base, estimate=True), tool=replace(arm.tool, estimate=True))
    data = random_data(arm, 6, 120, cam_p_m=False, cam_quat_wxyz=False)
    true = unfitted(arm, data, [])
    beta = np.array([name.endswith(".beta_rad") for name in true.names])
    assert beta.sum() == 2
    true = replace(true, estimate=np.where(beta, [3e-4], 0.02 * true.estimate))
    pose = predicted(true, data)
    noise = np.random.default_rng(8).normal(0, 2e-5, (2, data.n, 3))
    turns = Rotation.from_matrix(pose[:, :3, :3]) * Rotation.from_rotvec(noise[1])
    data = replace(data, p_m=pose[:, :3, 3] + noise[0], quat_wxyz=turns.as_quat(scalar_first=True))
    data = replace(data, cov=np.tile(4e-10 * np.eye(6), (data.n, 1, 1)))
    fit = fit_model(arm, data, robust=False)
    assert fit.estimate[beta] == pytest.approx([3e-4, 3e-4], rel=0.1)

    found = calibrated_fit(fit, replace_record(position_change_mm={"DH beta": 0.4}))
    (tmp_path / "dh.toml").write_text(arm_toml(found, four_parameter_table(found)))
    assert "not contained: DH beta, worth 0.4 mm" in (tmp_path / "dh.toml").read_text()
    with monkeypatch.context() as patched:
        four = [p for p in dh_parameters(arm) if not p[0].endswith(".beta_rad")]
        patched.setattr(sys.modules["kincal.workbench.fit.least_squares"], "dh_parameters", lambda _: four)
        best = rms_mm(fit_model(arm, data, robust=False), data)
        exported = rms_mm(fit_model(read_arm(tmp_path / "dh.toml"), data, dh=False), data)
    assert best > 0.1  # DH alone does not express it
    assert exported < 1.01 * best
    assert rms_mm(no_beta(fit), data) > 1.15 * best  # what leaving it out would give


def rms_mm(fit, data):
    """Position error of a fit's coefficients."""
    return 1e3 * np.sqrt(((predicted(fit, data)[:, :3, 3] - data.p_m) ** 2).sum(axis=1).mean())


def test_urdf_gives_the_constant_part_of_predict_in_pinocchio_and_yourdfpy(constant, tmp_path):
    pinocchio = pytest.importorskip("pinocchio")
    yourdfpy = pytest.importorskip("yourdfpy")
    fit, data = constant
    path = tmp_path / "made.urdf"
    path.write_text(urdf(calibrated_fit(fit, RECORD)))
    want = predicted(constants_only(fit), data)
    assert np.abs(pinocchio_poses(pinocchio, path, data.q) - want).max() < 1e-9
    robot = yourdfpy.URDF.load(str(path), load_meshes=False)
    for q, pose in zip(data.q[:3], want, strict=False):
        robot.update_cfg(q)
        assert np.abs(robot.get_transform(robot.robot.joints[-1].child) - pose).max() < 1e-6


def pinocchio_poses(pinocchio, path, qs):
    """Poses of the last frame of a URDF in its root."""
    model = pinocchio.buildModelFromUrdf(str(path))
    data, out = model.createData(), []
    for q in qs:
        pinocchio.framesForwardKinematics(model, data, q)
        out.append(data.oMf[model.nframes - 1].homogeneous)
    return np.array(out)


@pytest.mark.parametrize(
    "pitch", [0.0, 0.3, np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-9, np.pi / 2 + 1e-8, 1.5707]
)
def test_angles_of_the_urdf_give_the_matrix_back_also_at_the_pole(pitch):
    for roll, yaw in ((0.0, 0.0), (1.1, -2.0), (-3.0, 0.4)):
        R = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
        r, p, y = roll_pitch_yaw(R)
        assert np.abs(Rotation.from_euler("ZYX", [y, p, r]).as_matrix() - R).max() < 1e-12


def test_what_dh_and_urdf_cannot_hold_is_named(tmp_path):
    from kincal.export.urdf import urdf_left_out

    arm = arm_named("wam", tmp_path)
    data = random_data(arm, 6)
    tilted = hypothesis("axis_tilt[3]", (3, 4, 1.0, ONE, ONE))
    found = [tilted, *of_library(arm, ["backlash[4]", "camera_shift", "encoder_bias[2]"])]
    fitted = calibrated_fit(
        unfitted(arm, data, found), replace_record(position_change_mm={"backlash[4]": 0.31})
    )
    in_dh = {one.effect: str(one) for one in four_parameter_table(fitted).left_out}
    assert set(in_dh) == {"axis_tilt[3]", "backlash[4]", "camera_shift"}
    assert in_dh["backlash[4]"] == "backlash[4], worth 0.31 mm: it changes with dir4"
    assert "ry at link 3" in in_dh["axis_tilt[3]"]
    assert "axis_tilt[3]" not in {one.effect for one in dh_table(fitted).left_out}  # it is its beta
    assert "sensor" in in_dh["camera_shift"]
    assert {one.effect for one in urdf_left_out(fitted)} == {"backlash[4]", "camera_shift"}
    assert "worth 0.31 mm" in urdf(fitted)


def test_arm_table_keeps_the_corners_of_both_tags(tmp_path):
    from kincal.export.tabular import arm_toml

    arm = replace(arm_named("wam", tmp_path), target_points_m=np.eye(3), target_second_m=-np.eye(3))
    found = calibrated_fit(unfitted(arm, random_data(arm, 6), []), RECORD)
    (tmp_path / "dh.toml").write_text(arm_toml(found, four_parameter_table(found)))
    again = read_arm(tmp_path / "dh.toml")
    np.testing.assert_array_equal(again.target_points_m, np.eye(3))
    np.testing.assert_array_equal(again.target_second_m, -np.eye(3))


def replace_record(**changes):
    return RECORD.model_copy(update=changes)


def test_sigma_of_a_dh_parameter_is_that_of_the_sum_it_consists_of(tmp_path):
    """Joint 2's offset is its DH error plus its encoder bias: only their sum is determined."""
    poses.poses_csv(tmp_path / "poses.csv", 60, 3)
    arm, data = arm_named("wam", tmp_path), wb.read_csv(tmp_path / "poses.csv", 7)
    fit = wb.fit(arm, data, ["encoder_bias[2]"]).fit
    table = dh_table(calibrated_fit(fit, RECORD))
    row = next(p for p in table.parameters if (p.joint, p.name) == (2, "phi_rad"))
    i, j = fit.names.index("J2.phi_rad"), fit.names.index("encoder_bias[2].b")
    assert row.correction == pytest.approx(fit.estimate[i] + fit.estimate[j])
    assert row.sigma == pytest.approx(np.sqrt(fit.cov[[i, j]][:, [i, j]].sum()))
    assert row.sigma < 0.2 * fit.std_err[i]
    assert row.state == "identifiable"


# --------------------------------------------------------------------------- real arms

REAL = {
    "wam": (DATA / "wam", "wam.csv", ["backlash[1]", "joint_gravity[2,3]", "joint_ripple[4]"]),
    "fr3": (DATA / "fr3", "fr3.csv", ["lens_radial", "encoder_eccentricity[2]"]),
    "ur10": (DATA / "ur10", "ur10d.csv", ["bearing_wobble[2]", "joint_gravity[2]"]),
}


@pytest.mark.parametrize("name", REAL)
def test_exports_of_a_real_arm_reproduce_predict(name, tmp_path):
    pinocchio = pytest.importorskip("pinocchio")
    home, file, names = REAL[name]
    arm = read_arm(next(home.glob("*.toml")))
    data = read_measurements(home / file, arm)
    fit = fit_model(arm, data, wb.choose_constants(Library.load(), names, arm, data))
    module, c = generated(fit, tmp_path)
    want = predicted(fit, data)
    for i in range(0, data.n, 20):
        d = drivers_at(data, i, {*module.DEFAULTS, *module.NEEDED})
        assert np.abs(matrix(module.forward(data.q[i], **d)) - want[i]).max() < 1e-9
        assert np.abs(c.forward(data.q[i], **d) - want[i]).max() < 1e-9
    assert hasattr(module, "measured") == (name == "fr3")
    measured_is_what_predict_expects(fit, data.take(np.arange(0, data.n, 20)), module, c)
    (tmp_path / "made.urdf").write_text(urdf(calibrated_fit(fit, RECORD)))
    some = data.take(np.arange(0, data.n, 20))
    got = pinocchio_poses(pinocchio, tmp_path / "made.urdf", some.q)
    assert np.abs(got - predicted(constants_only(fit), some)).max() < 1e-9


TAG = np.array([[0.05, -0.05, 0.0], [-0.05, 0.05, 0.0], [0.05, 0.05, 0.0], [-0.05, -0.05, 0.0]])  # no order


def with_target_in_view(fit, data):
    """The fit and poses with the target (or with the camera, if it stands) where most of a board is in the
    image."""
    rng = np.random.default_rng(8)
    tool = predicted(fit, data)
    view = boards.pose([0.3, -0.2, 0.1], [0.03, -0.02, 0.35])  # board in the camera frame
    if fit.arm.mount == "tool":
        board = tool[0] @ view
        points = fit.arm.target_points_m @ board[:3, :3].T + board[:3, 3]
        return replace(fit, arm=replace(fit.arm, target_points_m=points)), data
    camera = tool @ np.linalg.inv(view)
    camera[:, :3, 3] += rng.uniform(-0.04, 0.04, (data.n, 3))
    quat = Rotation.from_matrix(camera[:, :3, :3]).as_quat(scalar_first=True)
    return fit, replace(data, cam_p_m=camera[:, :3, 3], cam_quat_wxyz=quat)


def smaller(points_m):
    return 0.7 * points_m + 0.3 * points_m.mean(axis=0)


def with_middle(points_m):
    """Of four corners no tag any more."""
    return np.vstack([smaller(points_m), points_m.mean(axis=0)])


@pytest.mark.parametrize(
    ("points_m", "second"),
    [(boards.BOARD, None), (boards.BOARD, smaller), (TAG, None), (TAG, smaller), (TAG, with_middle)],
    ids=["board", "two boards", "tag", "two tags", "tag and board"],
)
@pytest.mark.parametrize("mount", ["tool", "world"])
def test_measured_is_the_pose_that_the_camera_finds_with_every_fault(mount, points_m, second, tmp_path):
    arm = read_arm(boards.arm_toml(tmp_path / "arm.toml", mount, True))
    arm = replace(arm, **{f: replace(getattr(arm, f), estimate=False) for f in ("base", "tool")})
    arm = replace(arm, target_points_m=points_m)
    on_tool = mount == "tool"
    data = random_data(arm, 8, cam_p_m=not on_tool, cam_quat_wxyz=not on_tool)
    data = replace(data, q=BENT[7] + np.random.default_rng(8).uniform(-0.05, 0.05, data.q.shape))
    faults = [
        hypothesis(fault, *(("meas", c, -1.0, Basis("lin", name, column_number(0, fault)), ONE)
                            for c, name in enumerate(PNP)))
        for fault in FAULTS
    ]  # fmt: skip
    fit = unfitted(arm, data, [*faults, *of_library(arm, ["backlash[4]"])])
    fit, data = with_target_in_view(fit, data)
    arm = fit.arm
    if second:
        arm = replace(arm, target_second_m=second(arm.target_points_m))
        fit = replace(fit, arm=arm)
    module, c = generated(fit, tmp_path)
    said = measured_is_what_predict_expects(fit, data, module, c)
    moved = np.linalg.norm(said[:, :3, 3] - predicted(fit, data)[:, :3, 3], axis=1)
    assert np.median(moved) > 1e-4
    # The border of the image cuts the board, so that its weights are tried, but leaves more than a line.
    assert points_m is TAG or 0.3 < min(seen_share(arm, data, fit, i) for i in range(data.n)) < 0.95
    assert ("tag" in module.DEFAULTS) == bool(second)
    if second:
        one, other = (
            module.measured(data.q[0], **{**all_drivers(module, data, 0), "tag": t}) for t in (0, 1)
        )
        assert np.linalg.norm(one[0] - other[0]) > 1e-5


def seen_share(arm, data, fit, i):
    """Share of the points of the board that is in the image at pose i."""
    tool = predicted(fit, data)[i]
    target = np.linalg.inv(tool)
    if arm.mount != "tool":
        camera = np.eye(4)
        camera[:3, :3] = Rotation.from_quat(data.cam_quat_wxyz[i], scalar_first=True).as_matrix()
        camera[:3, 3] = data.cam_p_m[i]
        target = np.linalg.inv(camera) @ tool
    return boards.project(target, points=arm.target_points_m)[1].mean()


def through_points(sight):
    """An effect that acts through all points of the target, under one of the assumptions what that is."""
    column = Basis("lin", "ptx", column_number(sight, "radial_1"))
    return hypothesis(f"lens_radial_{sight}", ("meas", 0, 1.0, column, ONE))


def test_sensor_is_left_out_and_named_if_its_effects_assume_several_targets(tmp_path):
    arm = arm_named("wam", tmp_path)
    data = random_data(arm, 6)
    lenses = [through_points(0), through_points(1)]
    fit = unfitted(arm, data, [*lenses, *of_library(arm, ["tag_scale", "backlash[4]"])])
    found = calibrated_fit(fit, RECORD)
    why = {one.effect: one.why for one in source_left_out(found)}
    assert set(why) == {"lens_radial_0", "lens_radial_1", "tag_scale"}
    assert "not the arm" in why["lens_radial_0"]
    (tmp_path / "made.py").write_text(python_source(found))
    module = python_module(tmp_path / "made.py")
    assert not hasattr(module, "measured")
    d = drivers_at(data, 0, {*module.DEFAULTS, *module.NEEDED})
    assert set(d) == {"direction"}
    assert np.abs(matrix(module.forward(data.q[0], **d)) - predicted(fit, data)[0]).max() < 1e-9


def test_model_file_keeps_the_camera_and_target_that_were_assumed(tmp_path):
    """Nothing is stated: the board follows from the measurements, which the export does not see."""
    home = DATA / "fr3"
    arm, data, out = next(home.glob("*.toml")), home / "fr3.csv", tmp_path / "M.toml"
    for words in (("add", "--model", out, "lens_radial"),
                  ("fit", "--arm", arm, "--data", data, "--model", out),
                  ("export", "--model", out, "--format", "python", "-o", tmp_path / "o.py")):  # fmt: skip
        done = good("model", *words)
    assert "not in" not in done.stderr
    table = read_arm(arm)
    read = read_measurements(data, table)
    fit = wb.fit(table, read, ["lens_radial"]).fit
    assert fit.data.n == read.n
    assert wb.read_model(out).fit.sight == sight_entry(fit)
    module, some = python_module(tmp_path / "o.py"), read.take(np.arange(0, read.n, 20))
    said = [module.measured(q) for q in some.q]
    quat = Rotation.from_matrix([R for _, R in said]).as_quat(scalar_first=True)
    assert np.abs(fit.predict(replace(some, p_m=np.array([p for p, _ in said]), quat_wxyz=quat))).max() < 1e-9


def test_model_file_without_the_camera_is_refused_where_the_export_needs_it(tmp_path):
    """Versions before [fit.sight] wrote such files."""
    boards.arm_toml(tmp_path / "arm.toml", "tool", True)
    boards.eye_in_hand_csv(tmp_path / "poses.csv", 30, 1, (0.02, 0.0, 0.0, 0.0))
    for words in (("add", "--model", "M.toml", "lens_radial"),
                  ("fit", "--arm", "arm.toml", "--data", "poses.csv", "--model", "M.toml")):  # fmt: skip
        well(tmp_path, "model", *words)
    file = tmp_path / "M.toml"
    before, sight, after = re.split(r"(?ms)^\[fit\.sight\]\n(.*?)(?=^\[)", file.read_text())
    assert "points_m" in sight
    file.write_text(before + after)
    for form, name, status in (
        ("python", "o.py", 2), ("c", "o.c", 2), ("json", "o.json", 0), ("dh", "o.toml", 0),
    ):  # fmt: skip
        done = kincal(tmp_path, "model", "export", "--model", "M.toml", "--format", form, "-o", name)
        assert done.exit_code == status, done.output
        assert (tmp_path / name).exists() == (status == 0)
    done = kincal(tmp_path, "model", "export", "--model", "M.toml", "--format", "c", "-o", "o.c")
    assert all(
        text in done.stderr for text in ("[fit.sight] is missing", str(file), "run `kincal model fit` again")
    )


# --------------------------------------------------------------------------- files and command


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """An arm, its measurements and a fitted model."""
    out = tmp_path_factory.mktemp("export")
    poses.arm_toml(out / "arm.toml")
    poses.poses_csv(out / "poses.csv", 40, 3, lambda q, d: q + np.array([0, 0, 0, 3e-3 * d[3], 0, 0, 0]))
    well(out, "model", "add", "--model", "M.toml", "backlash[4]", "tag_scale")
    well(out, "model", "fit", "--arm", "arm.toml", "--data", "poses.csv", "--model", "M.toml")
    return out


def kincal(folder, *words):
    """A command; words that name files are taken from the folder."""
    files = (".toml", ".csv", ".urdf", ".py", ".c", ".json", ".pdf", ".h")
    given = [str(folder / word) if word.endswith(files) else word for word in words]
    return shell(*given)


def well(folder, *words):
    done = kincal(folder, *words)
    assert done.exit_code == 0, done.output
    return done


def test_model_file_holds_frames_split_data_hash_version_and_covariance(folder):
    import hashlib

    import kincal as package

    model = wb.read_model(folder / "M.toml")
    fit = model.fit
    assert fit.tool_version == package.__version__
    assert fit.data[0].sha256 == hashlib.sha256((folder / "poses.csv").read_bytes()).hexdigest()
    assert len(fit.held) == 10
    assert fit.poses == 40
    sigma = [row[-1] ** 0.5 for row in fit.covariance]
    assert sigma == pytest.approx([s for _, s in model.values.values()], rel=1e-6)
    assert fit.position_change_mm["backlash[4]"] == pytest.approx(1.5, abs=0.8)
    assert fit.base.xyz_m == pytest.approx((0, 0, poses.BASE_Z_M))
    wb.write_model(folder / "again.toml", model)
    assert wb.read_model(folder / "again.toml") == model


def test_change_of_the_model_forgets_the_fit(folder):
    model = wb.read_model(folder / "M.toml").remove(["tag_scale"])
    assert model.fit is None
    assert not model.values


@pytest.mark.parametrize("form, name, beside", [("dh", "mine.toml", "mine.csv"), ("c", "cal.c", "cal.h")])
def test_export_does_not_replace_a_file_that_was_not_named(folder, form, name, beside):
    words = ("model", "export", "--model", "M.toml", "--format", form, "-o", name)
    (folder / beside).write_text("mine")
    done = kincal(folder, *words)
    assert (
        done.exit_code == EXIT_INPUT and f"would be replaced by what is written beside {name}" in done.output
    )
    assert (folder / beside).read_text() == "mine" and not (folder / name).exists()
    (folder / beside).unlink()
    well(folder, *words)
    well(folder, *words)  # its own files


@pytest.mark.parametrize("form, name, files", [
    ("dh", "o.toml", ["o.toml", "o.csv"]), ("json", "o.json", ["o.json"]), ("urdf", "o.urdf", ["o.urdf"]),
    ("python", "o.py", ["o.py"]), ("c", "o.c", ["o.c", "o.h"]),
])  # fmt: skip
def test_export_writes_each_format(folder, form, name, files):
    done = well(folder, "model", "export", "--model", "M.toml", "--format", form, "-o", name)
    assert all((folder / file).stat().st_size > 500 for file in files)
    assert ("backlash[4], worth" in done.stderr) == (form in ("dh", "urdf"))


def test_exported_code_of_a_model_file_predicts_the_measurements_as_the_fit_does(folder):
    words = ("--arm", "arm.toml", "--model", "M.toml", "--format", "python", "-o", "o.py")
    well(folder, "model", "export", *words)
    module = python_module(folder / "o.py")
    arm, data = read_arm(folder / "arm.toml"), wb.read_csv(folder / "poses.csv", 7)
    fit = wb.fit(arm, data, ["backlash[4]", "tag_scale"]).fit
    for i in range(5):
        d = drivers_at(data, i, {*module.DEFAULTS, *module.NEEDED})
        assert np.abs(matrix(module.forward(data.q[i], **d)) - predicted(fit, data)[i]).max() < 1e-9


@pytest.mark.parametrize("position_only", [False, True])
def test_the_error_at_other_poses_is_that_of_the_exported_code(folder, tmp_path, position_only):
    """`compare` fits anew: nothing judged the fitted values by measurements that came later."""
    kincal(folder, "model", "export", "--model", "M.toml", "--format", "python", "-o", "o.py")
    module, new = python_module(folder / "o.py"), tmp_path / "new.csv"
    bent = lambda q, d: q + np.array([0, 2e-3, 0, 3e-3 * d[3], 0, 0, 0])  # noqa: E731 joint 2 has slipped since
    poses.poses_csv(new, 90, 3, bent, position_only=position_only)  # the same arm
    head, *rows = new.read_text().splitlines(keepends=True)
    new.write_text(head + "".join(rows[60:]))
    given = ("model", "predict", "--model", "M.toml", "--data")
    before = (folder / "M.toml").read_bytes()
    found = json.loads(kincal(folder, *given, str(new), "--json").output)
    data, off = wb.read_csv(new, 7), {"nominal": [], "model": []}
    for i in range(data.n):
        d = drivers_at(data, i, {*module.DEFAULTS, *module.NEEDED})
        fitted = (
            module.measured(data.q[i], **d) if hasattr(module, "measured") else module.forward(data.q[i], **d)
        )
        for name, (p, R) in (("nominal", module.nominal(data.q[i])), ("model", fitted)):
            turn = 0.0
            if not position_only:
                turn = (
                    Rotation.from_quat(data.quat_wxyz[i], scalar_first=True) * Rotation.from_matrix(R).inv()
                ).magnitude()
            off[name].append((np.linalg.norm(data.p_m[i] - p), turn))
    for error in found["errors"]:
        pos, rot = 1e3 * np.sqrt(np.mean(np.square(off[error["model"]]), axis=0))
        assert error["pos_mm"] == pytest.approx(pos, abs=1e-5)
        assert error["rot_mrad"] == (None if position_only else pytest.approx(rot, abs=1e-4))
    size = 1e3 * np.array(off["model"])
    assert found["max"]["pos_mm"] == pytest.approx(size[:, 0].max(), abs=1e-5)
    assert found["worst_poses"][0]["id"] == data.ids[int(size[:, 0].argmax())]
    nominal, fitted = (error["pos_mm"] for error in found["errors"])
    assert found["held"]["pos_mm"] < fitted < nominal and found["fit_data"] == []
    assert (folder / "M.toml").read_bytes() == before
    said = kincal(folder, *given, "poses.csv").output
    assert f"note: the model was fitted to {folder / 'poses.csv'}: this is not a prediction" in said


def test_a_fit_to_positions_says_nothing_of_orientations(tmp_path):
    """The turn of the tool frame that the fit leaves open was given as their error."""
    poses.arm_toml(tmp_path / "arm.toml")
    found = []
    for position_only in (True, False):
        poses.poses_csv(tmp_path / f"{position_only}.csv", 40, 3, position_only=position_only)
        if position_only:
            well(tmp_path, "model", "fit", "--arm", "arm.toml", "--data", "True.csv", "--model", "M.toml")
        given = ("model", "predict", "--model", "M.toml", "--data", f"{position_only}.csv")
        found.append(json.loads(well(tmp_path, *given, "--json").stdout))
        assert ("orientations are not compared" in well(tmp_path, *given).stdout) is not position_only
    for key in ("components", "errors", "max", "worst_poses"):
        assert found[0][key] == found[1][key]
    assert found[1]["components"] == 3 and found[1]["errors"][1]["rot_mrad"] is None


def test_a_model_that_was_never_fitted_is_refused(folder, tmp_path):
    on = ("--arm", str(folder / "arm.toml"), "--data", str(folder / "poses.csv"), "--model", "M.toml")
    well(tmp_path, "model", "add", "--model", "M.toml", "backlash[4]")
    done = kincal(tmp_path, "model", "predict", *on)
    assert done.exit_code == EXIT_INPUT and "run `kincal model fit` first" in done.stderr
    made = kincal(tmp_path, "model", "export", "--model", "M.toml", "--format", "python", "-o", "o.py")
    assert made.exit_code == EXIT_INPUT


def test_fit_of_a_model_with_effects_to_other_measurements_says_so(folder, tmp_path):
    """The advice for a second set may name the model file of the first."""
    (tmp_path / "M.toml").write_bytes((folder / "M.toml").read_bytes())
    on = ("model", "fit", "--arm", str(folder / "arm.toml"), "--model", "M.toml", "--data")
    assert "keeps its effects" not in well(tmp_path, *on, str(folder / "poses.csv")).stderr
    lines = (folder / "poses.csv").read_text().splitlines()
    (tmp_path / "other.csv").write_text("\n".join(lines[:-1]))
    said = well(tmp_path, *on, "other.csv").stderr
    assert "poses.csv, and keeps its effects: backlash[4], tag_scale; a new name after --model" in said
    assert "keeps its effects" not in well(tmp_path, *on, "other.csv").stderr


def test_a_file_without_the_effects_of_its_session_is_not_to_be_fitted_without_them(folder, tmp_path):
    """Their error would go into the DH values; that of other effects may, where the file cannot hold them."""
    on = ("--arm", str(folder / "arm.toml"), "--data", str(folder / "poses.csv"), "--model", "M.toml")
    well(tmp_path, "model", "add", "--model", "M.toml", "time_drift[2]")
    well(tmp_path, "model", "fit", *on)
    said = kincal(tmp_path, "model", "export", "--model", "M.toml", "--format", "dh", "-o", "o.toml").stderr
    assert "time_drift[2]; the file holds the arm as it is where that is zero" in said
    assert "fit a model without" not in said
    well(tmp_path, "model", "add", "--model", "M.toml", "backlash[4]")
    well(tmp_path, "model", "fit", *on)
    said = kincal(tmp_path, "model", "export", "--model", "M.toml", "--format", "dh", "-o", "o.toml").stderr
    assert said.rstrip().endswith("fit a model without backlash[4]")


def test_another_session_is_predicted_with_what_the_fitted_one_left(folder, tmp_path):
    """A joint drifts by 4 mrad and stays there. `predict` refused, and said to fit without the drift, which
    leaves it in the DH errors: 1.5 mm."""

    number = itertools.count()
    poses.poses_csv(
        tmp_path / "all.csv", 120, 3,
        lambda q, _: q + np.array([0, 4e-3 * min(next(number) / 89.0, 1.0), 0, 0, 0, 0, 0]),
        noise_size=0.1,
    )  # fmt: skip
    head, *rows = (tmp_path / "all.csv").read_text().splitlines(keepends=True)
    rows.sort(key=lambda row: float(row.split(",")[1]))  # t_s
    (tmp_path / "first.csv").write_text(head + "".join(rows[:90]))
    (tmp_path / "later.csv").write_text(head + "".join(rows[90:]))
    on = ("--arm", str(folder / "arm.toml"), "--model", "M.toml", "--data")
    well(tmp_path, "model", "add", "--model", "M.toml", "time_drift[2]")
    said = well(tmp_path, "model", "fit", *on, "first.csv").output
    assert "time_drift[2] follows the time of this session" in said
    found = json.loads(kincal(tmp_path, "model", "predict", *on, "later.csv", "--json").output)
    assert found["as_in_the_end"] == ["time_drift[2]"]
    assert found["errors"][1]["pos_mm"] < 0.5
    assert (
        "as in the end of the fitted session" in well(tmp_path, "model", "predict", *on, "later.csv").output
    )
    made = well(tmp_path, "model", "export", "--model", "M.toml", "--format", "python", "-o", "o.py")
    assert "give a t_s of that session; its end, `end_s` in the model file," in made.stderr
    assert wb.read_model(tmp_path / "M.toml").fit.end_s == 60.0 * 89
    for files in (["first.csv", "--data", "later.csv"], ["later.csv", "--data", "first.csv"]):
        mixed = kincal(tmp_path, "model", "predict", *on, *files)  # one clock for both
        assert mixed.exit_code == EXIT_INPUT and "nor of others alone" in mixed.stderr
        assert "first.csv), or only files of other sessions" in mixed.stderr
    kept = [f"{row.rstrip()},{'fit' if k < 70 else 'held'}\n" for k, row in enumerate(rows[:90])]
    (tmp_path / "kept.csv").write_text(f"{head.rstrip()},split\n" + "".join(kept))
    well(tmp_path, "model", "fit", *on, "kept.csv")  # its last fitted pose is not the end of the session
    assert wb.read_model(tmp_path / "M.toml").fit.end_s == 60.0 * 89
    again = json.loads(kincal(tmp_path, "model", "predict", *on, "later.csv", "--json").output)
    assert again["errors"][1]["pos_mm"] < 0.5


def test_a_session_of_two_files_is_predicted_by_both_in_their_order_alone(folder, tmp_path):
    """The second file alone begins at 0 on its clock: before the step, that is, and so it was predicted."""
    parts = []
    for k, slip in enumerate((0.0, 4e-3)):
        parts.append(f"{k}.csv")
        poses.poses_csv(tmp_path / parts[k], 40, 3 + k, lambda q, _, s=slip: q + s * np.eye(7)[1])
    on = ("--arm", str(folder / "arm.toml"), "--model", "M.toml", "--data")
    well(tmp_path, "model", "add", "--model", "M.toml", "bias_step[2]")
    well(tmp_path, "model", "fit", *on, parts[0], "--data", parts[1])
    both = json.loads(
        kincal(tmp_path, "model", "predict", *on, parts[0], "--data", parts[1], "--json").stdout
    )
    assert len(both["fit_data"]) == 2 and both["as_in_the_end"] == []
    for files in ([parts[1]], [parts[1], "--data", parts[0]]):
        done = kincal(tmp_path, "model", "predict", *on, *files)
        assert done.exit_code == EXIT_INPUT and "name all files of the fit in its order" in done.stderr


def test_json_holds_every_number_with_its_unit(folder):
    kincal(folder, "model", "export", "--model", "M.toml", "--format", "json", "-o", "o.json")
    got, model = json.loads((folder / "o.json").read_text()), wb.read_model(folder / "M.toml")
    assert {c["name"]: (c["value"], c["std_err"]) for c in got["coefficients"]} == model.values
    assert {c["name"]: c["unit"] for c in got["coefficients"]} == model.units
    covariance = np.array(got["covariance"])
    assert np.abs(covariance - covariance.T).max() == 0
    assert np.linalg.eigvalsh(covariance).min() > -1e-9
    assert {"base", "tool", "base_found", "tool_found"} == set(got["frames"])


@pytest.mark.parametrize("form, name, says", [
    ("urdf", "o.pdf", "writes .urdf or .xml"), ("c", "o.h", "writes .c"), ("python", "o", "writes .py"),
    ("dh", "arm.toml", "is an input"), ("dh", "M.toml", "is an input"),
])  # fmt: skip
def test_wrong_path_is_refused(folder, form, name, says):
    done = kincal(
        folder, "model", "export", "--arm", "arm.toml", "--model", "M.toml", "--format", form, "-o", name
    )
    assert done.exit_code == 2
    assert says in done.stderr


def test_model_without_values_is_refused(folder, tmp_path):
    (tmp_path / "M.toml").write_text('version = 1\neffects = ["backlash[4]"]\n')
    done = kincal(tmp_path, "model", "export", "--arm", str(folder / "arm.toml"), "--model", "M.toml",
                  "--format", "c", "-o", "o.c")  # fmt: skip
    assert done.exit_code == 2
    assert "run `kincal model fit` first" in done.stderr


def with_value(model, number, **change):
    """The text of a model file with other keys of a [[value]]."""
    head, *values = model.split("[[value]]")
    for key, new in change.items():
        values[number - 1] = re.sub(rf"(?m)^{key} = .*", f"{key} = {new}", values[number - 1], count=1)
    return "[[value]]".join([head, *values])


@pytest.mark.parametrize(
    ("number", "change", "words"),
    [
        (1, {"value": "1000.0"}, "is 1000 rad, up to 4 can be fitted"),
        (3, {"value": "-1000.0"}, "value[3], J1.a_m, is -1000 m, up to 2 can be fitted"),
        (-1, {"value": "1e300"}, "tag_scale"),
        (2, {"std_err": "0.5"}, "value[2], J1.alpha_rad, has std_err 0.5, its covariance"),
        (3, {"unit": '"mm"'}, "value[3], J1.a_m, is in mm, it is fitted in m"),
        (2, {"name": '"J1.phi_rad"'}, "value[2].name: is J1.phi_rad, which stands above already"),
    ],
)
@pytest.mark.parametrize("form", ["json", "dh"])
def test_values_that_no_fit_gives_are_refused_by_key(folder, tmp_path, form, number, change, words):
    model = (folder / "M.toml").read_text()
    number = model.count("[[value]]") if number < 0 else number
    (tmp_path / "M.toml").write_text(with_value(model, number, **change))
    suffix = {"json": "json", "dh": "toml"}[form]
    args = ("model", "export", "--arm", str(folder / "arm.toml"), "--model", "M.toml", "--format", form)
    done = kincal(tmp_path, *args, "-o", f"o.{suffix}")
    assert done.exit_code == 2
    assert words in done.stderr
    assert not (tmp_path / f"o.{suffix}").exists()


def test_model_of_another_arm_or_with_other_values_is_refused(folder):
    arm, model = read_arm(folder / "arm.toml"), wb.read_model(folder / "M.toml")
    from kincal.export import calibrated_arm

    with pytest.raises(BadInput, match="another arm table"):
        calibrated_arm(read_arm("iiwa7"), model, Library.load())
    fewer = dict(list(model.values.items())[1:])
    with pytest.raises(BadInput, match="other effects"):
        calibrated_arm(arm, replace(model, values=fewer), Library.load())
    cut = model.fit.model_copy(update={"covariance": model.fit.covariance[1:]})
    with pytest.raises(BadInput, match="covariance"):
        calibrated_arm(arm, replace(model, fit=cut), Library.load())
