"""Bearings whose axis shifts or tilts as it turns: the effects against a chain of their own, and what a
diagnosis says where another effect makes the same errors."""

import csv

import numpy as np
import poses
import pytest
from scipy.spatial.transform import Rotation

from kincal import workbench as wb
from kincal.rotations import Pose
from kincal.workbench.diagnosis.findings import confounded_effects
from kincal.workbench.diagnosis.study import Study
from kincal.workbench.fit.least_squares import fit_model
from kincal.workbench.model.flight_model import flight_model
from kincal.workbench.report import explain
from kincal.workbench.report.answers import diagnosis_json
from kincal.workbench.report.diagnosis_text import diagnosis_text
from kincal_shared.schema.effects import read_effects
from kincal_shared.schema.errors import SchemaError

# a, alpha, d, phi: an arm whose joints 2, 3 and 4 are parallel
PARALLEL = (
    (0.0, np.pi / 2, 0.1625, 0.0),
    (-0.425, 0.0, 0.0, 0.0),
    (-0.3922, 0.0, 0.0, 0.0),
    (0.0, np.pi / 2, 0.1333, 0.0),
    (0.0, -np.pi / 2, 0.0997, 0.0),
    (0.0, 0.0, 0.0996, 0.0),
)
# one whose neighbouring joints are all at right angles; axes 2 and 3 meet
CROSSED = (
    (0.0, -np.pi / 2, 0.30, 0.0),
    (0.0, np.pi / 2, 0.0, 0.0),
    (0.02, -np.pi / 2, 0.42, 0.0),
    (-0.02, np.pi / 2, 0.0, 0.0),
    (0.0, -np.pi / 2, 0.38, 0.0),
    (0.0, 0.0, 0.11, 0.0),
)
TOOL_M = (0.03, 0.02, 0.08)
NOISE_M, NOISE_RAD = 1e-4, 2e-4


def moved(shift_m=(0.0, 0.0, 0.0), turn_rad=(0.0, 0.0, 0.0)):
    """4x4 of a shift and a turn."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = Rotation.from_rotvec(turn_rad).as_matrix(), shift_m
    return out


def chain(dh, q, before=None, joint=None):
    """4x4 tool pose; before: {j: 4x4 at the frame before joint j}; joint: {j: error of its angle [rad]}."""
    out = np.eye(4)
    for j, ((a, alpha, d, phi), angle) in enumerate(zip(dh, q, strict=True), 1):
        out = out @ (before or {}).get(j, np.eye(4))
        out = out @ poses.link(a, alpha, d, phi + angle + (joint or {}).get(j, 0.0))
    return out @ moved(TOOL_M)


def arm_of(tmp_path, dh):
    lines = ['name = "six"', 'convention = "standard"', "gravity_m_s2 = [0.0, 0.0, -9.81]"]
    lines += ["[base]", "estimate = true", "[tool]", "estimate = true"]
    for a, alpha, d, phi in dh:
        lines += ["[[joint]]", 'type = "revolute"', f"a_m = {a}", f"alpha_rad = {alpha}", f"d_m = {d}"]
        lines += [f"phi_rad = {phi}", "q_min_rad = -2.8", "q_max_rad = 2.8"]
    path = tmp_path / "arm.toml"
    path.write_text("\n".join(lines) + "\n")
    return wb.read_arm(path)


def measured(tmp_path, dh, seed, error, n=110):
    """Measurements of an arm with DH errors; error(q) -> arguments of `chain`. No noise is stated."""
    rng = np.random.default_rng(seed)
    true = np.array(dh) + rng.normal(size=(6, 4)) * [1e-3, 2e-3, 1e-3, 4e-3]
    base = moved(rng.normal(0, 0.3, 3), (0.01, -0.02, 0.7))
    with (tmp_path / "poses.csv").open("w", newline="") as file:
        out = csv.writer(file)
        out.writerow(["id", *(f"q{j}" for j in range(1, 7)), "px", "py", "pz", "qw", "qx", "qy", "qz"])
        for i in range(n):
            q = rng.uniform(-2.2, 2.2, 6)
            pose = base @ chain(true, q, **error(q))
            p = pose[:3, 3] + rng.normal(0, NOISE_M, 3)
            turn = Rotation.from_rotvec(rng.normal(0, NOISE_RAD, 3)).as_matrix() @ pose[:3, :3]
            out.writerow([f"p{i}", *q, *p, *poses.quat_wxyz(turn)])
    return wb.read_csv(tmp_path / "poses.csv", 6)


def diagnosed(tmp_path, dh, seed, error):
    arm = arm_of(tmp_path, dh)
    return wb.diagnose(arm, measured(tmp_path, dh, seed, error), wb.Library.load())


def out_of_round(joint, size):
    """A joint's link moved along its own x by a wave over one turn: its axis shifts twice a turn."""
    return lambda q: {"before": {joint + 1: moved((size * np.cos(q[joint - 1]), 0.0, 0.0))}}


def tilting(joint, size, height_m=0.0):
    """An axis that tilts twice a turn, about a pivot at a height over its frame."""

    def error(q):
        angle = 2.0 * q[joint - 1]
        lever, turn = moved((0.0, 0.0, height_m)), (size * np.cos(angle), size * np.sin(angle), 0.0)
        return {"before": {joint: lever @ moved(turn_rad=turn) @ np.linalg.inv(lever)}}

    return error


# --------------------------------------------------------------------------- the effects


def by_physics(name, parameter, value, q, dh, size):
    """Tool pose with a coefficient of that size."""
    j = int(name[-2])
    phase = 0.0 if parameter == "A" else np.pi / 2
    if name.startswith("bearing_runout"):
        angle = value * q[j - 1] + phase
        return chain(dh, q, {j: moved((size * np.cos(angle), size * np.sin(angle), 0.0))})
    lever, angle = moved((0.0, 0.0, value * dh[j - 1][2])), 2.0 * q[j - 1] + phase
    turn = moved(turn_rad=(size * np.cos(angle), size * np.sin(angle), 0.0))
    return chain(dh, q, {j: lever @ turn @ np.linalg.inv(lever)})


@pytest.mark.parametrize(
    ("name", "constant", "value"),
    [(f"bearing_runout[{j}]", "k", k) for j in (1, 3) for k in (-1.0, 2.0)]
    + [(f"bearing_wobble2[{j}]", "pivot", h) for j in (1, 3) for h in (0.0, 1.0)],
)
@pytest.mark.parametrize("dh", [PARALLEL, CROSSED], ids=["parallel", "crossed"])
def test_the_arm_moves_as_its_bearing_does(tmp_path, dh, name, constant, value):
    """Against central differences of a plain chain."""
    arm = arm_of(tmp_path, dh)
    data = measured(tmp_path, dh, 3, lambda _q: {}, n=12)
    (h,) = wb.Library.load().find(name, arm, data, {constant: value})
    frame = Pose(R=np.eye(3), p_m=np.zeros(3)), Pose(R=np.eye(3), p_m=np.array(TOOL_M))
    model, step = flight_model(arm, data, *frame, [(p.name, p) for p in h.parameters]), 1e-5
    for k, parameter in enumerate(("A", "B")):
        plus, minus = (model.poses(np.eye(2)[k] * sign * step) for sign in (1.0, -1.0))
        for i, q in enumerate(data.q):
            a, b = (by_physics(name, parameter, value, q, dh, sign * step) for sign in (1.0, -1.0))
            assert (plus.p_m[i] - minus.p_m[i]) == pytest.approx(a[:3, 3] - b[:3, 3], abs=1e-6 * step)
            turned = Rotation.from_matrix(plus.R[i] @ minus.R[i].T).as_rotvec()
            want = Rotation.from_matrix(a[:3, :3] @ b[:3, :3].T).as_rotvec()
            assert turned == pytest.approx(want, abs=1e-6 * step)


def test_a_constant_of_the_grid_may_stand_in_a_gain():
    entry = """
[[effect]]
name = "lever"
per = "joint"
[effect.grid]
h = [0.0, 1.0]
[[effect.parameter]]
name = "c"
sigma = 1e-3
[[effect.parameter.term]]
at = "before[j]"
comp = "tx"
gain = "-$h*d"
"""
    (effect,) = read_effects(entry, "mine.toml")
    assert effect.parameter[0].term[0].constants == ("h",)
    with pytest.raises(SchemaError, match=r"gain.*\$h, which has no value(.|\n)*\[effect.grid\]: h ="):
        read_effects(entry.replace("[effect.grid]\nh = [0.0, 1.0]\n", ""), "mine.toml")


def test_a_bearing_moves_every_pose_alike_and_makes_no_outliers(tmp_path):
    arm = arm_of(tmp_path, CROSSED)
    library = wb.Library.load()
    there = [e for e in library.effects.values() if not e.missing(arm, None)]
    even = {e.name for e in there for h in e.instances(arm, None)[:1] if h.even}
    assert even == {"bearing_wobble2", "bearing_runout"}
    assert all(h.even for name in even for h in library.find(name, arm, None))
    found = diagnosed(tmp_path, PARALLEL, 15, out_of_round(3, 5e-3))
    assert [e.name for e in found.effects if e.in_model] == ["bearing_runout[3]"]
    assert found.outliers.ids == ()


# --------------------------------------------------------------------------- what a diagnosis says of them


def test_a_bearing_that_is_out_of_round_is_no_error_of_two_parallel_joints(tmp_path):
    """Joint 3 and 4 turned by equal angles, forth and back, move the link in the same way."""
    found = diagnosed(tmp_path, PARALLEL, 11, out_of_round(3, 6e-4))
    (effect,) = (e for e in found.effects if e.in_model)
    assert (effect.name, dict(effect.constants)) == ("bearing_runout[3]", {"k": 2.0})
    assert effect.accepted
    assert effect.probability > 0.9


@pytest.mark.parametrize(
    "error",
    [tilting(2, 5e-4), lambda q: {"joint": {3: 8e-4 * np.sin(q[1] + 0.3)}}],
    ids=["bearing", "coupling"],
)
def test_what_no_data_can_tell_apart_is_said_together(tmp_path, error):
    """Axis 3 is at right angles to axis 2: the tilt of one about the other is a turn of joint 3."""
    found = diagnosed(tmp_path, CROSSED, 12, error)
    pair = {"bearing_wobble2[2]", "joint_coupling_harmonic[3,2]"}
    both = {e.name: e for e in found.effects if e.name in pair}
    assert set(both) == pair
    (effect,) = (e for e in found.effects if e.in_model)
    (other,) = (both[name] for name in pair - {effect.name})
    assert set(effect.confounded_with) == {other.name}
    assert set(other.confounded_with) == {effect.name}
    assert max(effect.probability, other.probability) < 0.9
    assert effect.doubts.either > 0.9
    assert effect.probability + other.probability == pytest.approx(effect.doubts.either, abs=0.02)
    assert found.verdict == "undecidable"
    said = explain.verdict(found)
    assert f"{effect.name} or {other.name}, which these data cannot tell apart" in said
    text = diagnosis_text(found)
    assert text.count("      inspect: ") == 2
    assert "      inspect: Bearing of the joint" in text
    assert "      inspect: Cable routing" in text
    row = next(row for row in diagnosis_json(found)["effects"] if row["name"] == effect.name)
    assert row["inspect"].startswith(("Bearing", "Cable"))
    assert f"or with what these data cannot tell from it ({other.name})" in row["why"]


def test_of_several_effects_each_is_named_with_what_it_may_be_as_well(tmp_path):
    def error(q):
        return {**tilting(2, 5e-4)(q), "joint": {5: 2e-3 * np.cos(q[4])}}

    found = diagnosed(tmp_path, CROSSED, 14, error)
    assert found.verdict == "several_effects"
    said = explain.verdict(found)
    assert "bearing_wobble2[2] (or joint_coupling_harmonic[3,2])" in said
    assert "encoder_eccentricity[5] (or" not in said


def test_a_tilt_about_a_pivot_below_the_next_axis_is_no_turn_of_the_next_joint(tmp_path):
    """The pivot is .30 m below axis 2: the tilt also shifts that axis, which no joint does."""
    found = diagnosed(tmp_path, CROSSED, 13, tilting(1, 6e-4))
    (effect,) = (e for e in found.effects if e.in_model)
    assert (effect.name, dict(effect.constants)) == ("bearing_wobble2[1]", {"pivot": 0.0})
    assert effect.confounded_with == ()
    assert effect.probability > 0.9


def test_two_effects_that_one_could_replace_are_confounded_with_it(tmp_path):
    """Where both are in the model."""
    arm = arm_of(tmp_path, PARALLEL)
    data, library = measured(tmp_path, PARALLEL, 11, out_of_round(3, 6e-4)), wb.Library.load()
    study = Study.of(wb.compare(arm, data), library, (), True)
    names = ("encoder_eccentricity[3]", "joint_coupling_harmonic[4,3]")
    model = tuple(library.find(name, arm, data)[0] for name in names)
    fit = fit_model(arm, data, model)
    assert fit.converged
    for h in model:
        assert "bearing_runout[3]" in confounded_effects(study, h, study.reopened(model, h))
