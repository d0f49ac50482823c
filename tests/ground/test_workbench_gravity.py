"""Gravity on arms whose masses nobody knows, effects at some joints, and second ones of a kind."""

from dataclasses import replace

import numpy as np
import poses
import pytest
from scipy.spatial.transform import Rotation

from kincal import workbench as wb
from kincal.workbench.diagnosis.findings import fitted_values
from kincal.workbench.fit.columns import Columns
from kincal.workbench.fit.least_squares import fit_model
from kincal.workbench.model.hypotheses import Competition, covers, joints_of
from kincal.workbench.model.levers import TOOL, bodies
from kincal.workbench.model.uplink import term_image
from kincal.workbench.report import explain
from kincal_shared.errors import BadInput
from kincal_shared.schema.effects import read_effects
from kincal_shared.schema.errors import SchemaError

G = np.array([0.0, 0.0, -9.81])


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return wb.read_arm(poses.arm_toml(tmp_path_factory.mktemp("arm") / "arm.toml", masses=False))


def measure(tmp_path, n, seed, true_q=None, **more):
    return wb.read_csv(poses.poses_csv(tmp_path / "poses.csv", n, seed, true_q, **more), 7)


def weights(q):
    """Of the WAM's true masses at joint angles q, written out, no code of KinCal takes part: axes and origins
    of the joints, each mass [kg] and where it is [m]."""
    T, axes, origins, masses = np.eye(4), [], [], []
    T[2, 3] = poses.BASE_Z_M
    for (a, alpha, d, _, _, mass, com, _), angle in zip(poses.WAM, q, strict=True):
        axes.append(T[:3, 2])
        origins.append(T[:3, 3])
        T = T @ poses.link(a, alpha, d, angle)
        masses.append((mass, T[:3, :3] @ com + T[:3, 3]))
    return axes, origins, masses


def torques(q):
    """(7,) gravity torques."""
    axes, origins, masses = weights(q)
    return np.array(
        [
            sum(mass * axes[j] @ np.cross(at - origins[j], G) for mass, at in masses[j:])
            for j in range(len(axes))
        ]
    )


def sagging(compliance):
    return lambda q, _direction: q + np.array(compliance) * torques(q)


def test_torques_that_errors_alone_make_are_no_drivers(tmp_path):
    """Of masses on the axis of the last joint, which fitted DH errors tilt by some mrad."""
    arm = wb.read_arm(poses.arm_toml(tmp_path / "arm.toml"))
    data = measure(tmp_path, 40, 6)
    varying = []
    for aside_m in (0.02, 0.0):
        last = replace(arm.joints[-1], com_m=(aside_m, 0.0, arm.joints[-1].com_m[2]))
        held = replace(arm, joints=(*arm.joints[:-1], last))
        varying.append(set(Columns(fit_model(held, data)).torques()))
    assert varying == [{2, 3, 4, 5, 6, 7}, {2, 3, 4, 5, 6}]


def on_a_turning_base(turned, n=100, every_s=60.0):
    """Measurements of a WAM whose mount, at the origin, turns by turned(q, t_s), a rotation vector."""
    rng = np.random.default_rng(8)
    low, high = (np.array([row[k] for row in poses.WAM]) for k in (3, 4))
    q, dh, t_s = rng.uniform(low, high, (n, 7)), 2e-3 * rng.normal(size=(7, 4)), every_s * np.arange(n)
    pose = np.array([poses.tool_pose(row, dh) for row in q])
    turn = Rotation.from_rotvec([turned(row, at) for row, at in zip(q, t_s, strict=True)]).as_matrix()
    noise = Rotation.from_rotvec(2e-4 * rng.normal(size=(n, 3))).as_matrix()
    return wb.Measurements(
        source="made", ids=tuple(f"p{k}" for k in range(n)), q=q, t_s=t_s,
        p_m=(turn @ pose[:, :3, 3:])[:, :, 0] + 1e-4 * rng.normal(size=(n, 3)),
        quat_wxyz=poses.quat_wxyz(noise @ turn @ pose[:, :3, :3]),
    )  # fmt: skip


def test_a_mount_that_is_softer_in_one_direction_is_found(tmp_path, library):
    """About an axis between x and y; it was an unnamed function of the gravity torque, with `base_flex`."""
    soft = np.array([np.cos(0.4), np.sin(0.4), 0.0])

    def tips(q, _t_s):
        moment = sum(np.cross(at - [0, 0, poses.BASE_Z_M], mass * G) for mass, at in weights(q)[2])
        return 3e-5 * soft * (soft @ moment)

    d = wb.diagnose(wb.read_arm(poses.arm_toml(tmp_path / "arm.toml")), on_a_turning_base(tips), library)
    [found] = [e for e in d.effects if e.in_model]
    assert found.name == "mount_compliance" and found.probability > 0.9
    value = {p.name: p.value for p in found.parameters}
    wanted = 3e-5 * np.outer(soft, soft)
    got = [[value["Cxx"], value["Cxy"]], [value["Cxy"], value["Cyy"]]]
    np.testing.assert_allclose(got, wanted[:2, :2], atol=2e-6)


@pytest.mark.parametrize("every_s", [0.2, 60.0])
def test_a_base_that_turns_steadily_is_one_effect(tmp_path, library, every_s):
    """It was `base_settling` and `time_drift`, each larger than the whole, with opposite signs; a rate per
    hour was too small by far in a session of seconds."""
    turns = np.array([1e-3, -5e-4, 5e-4])
    data = on_a_turning_base(lambda _q, t_s: turns * t_s / (69 * every_s), 70, every_s)
    d = wb.diagnose(wb.read_arm(poses.arm_toml(tmp_path / "arm.toml")), data, library)
    [found] = [e for e in d.effects if e.in_model]
    assert found.name == "base_drift" and found.probability > 0.9
    turned = next(p for p in found.parameters if p.name == "rx")
    assert abs(turned.value - 1e-3) < 1e-4 and turned.unit == "rad"


def test_a_base_that_settles_in_translation_is_one_effect(tmp_path, library):
    """Without x, y and z, `base_settling` was left out, and `base_drift` or `base_step` stood there."""
    end = np.array([8e-4, -5e-4, 3e-4])
    data = on_a_turning_base(lambda _q, _t_s: np.zeros(3), 70)
    data = replace(data, p_m=data.p_m + np.outer(1 - np.exp(-data.t_s / 1200.0), end))
    d = wb.diagnose(wb.read_arm(poses.arm_toml(tmp_path / "arm.toml")), data, library)
    [found] = [e for e in d.effects if e.in_model]
    assert found.name == "base_settling" and found.probability > 0.9
    np.testing.assert_allclose([p.value for p in found.parameters if p.name in "xyz"], end, atol=1.5e-4)


# --------------------------------------------------------------------------- against gravity


@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["right", "wrong"])
@pytest.mark.parametrize("name", ["joint_compliance[2]", "gravity_backlash[2]", "link_bending[3]"])
def test_what_gives_way_against_gravity_says_what_to_check(library, tmp_path, name, sign):
    """With the sign of gravity wrong in the arm table it was joint_compliance with P > 0.99, and negative."""
    arm = wb.read_arm(poses.arm_toml(tmp_path / "arm.toml"))
    arm = replace(arm, gravity_m_s2=sign * arm.gravity_m_s2)
    data = measure(tmp_path, 40, 5, sagging([0, 4e-4, 0, 0, 0, 0, 0]))
    h = library.find(name, arm, data)[0]
    [value] = fitted_values(h, fit_model(arm, data, [h]))
    assert np.sign(value.value) == sign and value.wrong_sign == (sign < 0.0)
    said = explain.negative((value,), h.name)
    assert said.startswith(f"{value.name} of {name} is negative: ") == (sign < 0.0)
    assert ("gravity_m_s2" in said) == (sign < 0.0) == bool(said)


# --------------------------------------------------------------------------- gravity without masses


def test_a_sagging_joint_is_named_without_masses_and_held_out_poses_gain(arm, library, tmp_path):
    data = measure(tmp_path, 100, 5, sagging([0, 4e-4, 0, 0, 0, 0, 0]))
    found = wb.diagnose(arm, data, library)
    best = found.effects[0]
    assert best.accepted
    assert covers(best.name, "joint_gravity[2]") or "joint_gravity[2]" in best.confounded_with
    assert found.remainder.held_pos_m < 0.75 * found.comparison.rms["held"][0]
    assert "link_bending" in {n.name for n in found.not_testable}


def test_with_masses_the_effects_of_torque_compete_and_these_do_not(library, tmp_path):
    with_masses = wb.read_arm(poses.arm_toml(tmp_path / "arm.toml"))
    data = measure(tmp_path, 20, 1)
    names = {c.effect.name for c in Competition.of(with_masses, data, library).candidates}
    assert "joint_compliance" in names
    assert not names & {"joint_gravity", "link_gravity_tilt", "slide_gravity"}


def test_bodies_with_levers_of_their_own(arm):
    # about joint 2 of the WAM: tool and wrist on one line with the forearm, elbow off it
    assert bodies(arm, 1, ["levz"])[0] == TOOL
    assert set(bodies(arm, 1, ["levz"])) <= {TOOL, 7, 6, 5, 4, 3}
    assert bodies(arm, 6, ["levz"]) == ()  # the tool lies on the axis of joint 7
    assert bodies(arm, 0, ["levz"]) == ()  # a vertical axis feels no gravity


def test_on_a_base_that_stands_anyhow_the_first_joint_feels_gravity(arm):
    anywhere = replace(arm, base=replace(arm.base, estimate=True))
    assert bodies(anywhere, 0, ["levz"])


def test_only_sliding_joints_slide(arm, library):
    sliding = replace(arm.joints[2], prismatic=True)
    other = replace(arm, joints=(*arm.joints[:2], sliding, *arm.joints[3:]))
    names = [h.name for h in library.find("slide_gravity", other, None)]
    assert names == ["slide_gravity[3]"]
    turning = ("joint_gravity", "encoder_eccentricity", "encoder_harmonic2")
    assert all(f"{name}[3]" not in {h.name for h in library.find(name, other, None)} for name in turning)


def test_flight_takes_the_terms(arm, library):
    effects = [*library.find("joint_gravity[2]", arm, None), *library.find("link_gravity_tilt[1]", arm, None)]
    assert term_image(arm, effects, poses.flown()).data


def test_an_effect_per_body_needs_a_lever_of_it():
    text = """
[[effect]]
name = "mine"
per = "joint"
[[effect.parameter]]
name = "c"
sigma = 1.0
{each}
[[effect.parameter.term]]
at = "joint[j]"
basis = "{basis}"
"""
    read_effects(text.format(each="each_body = true", basis="levz[p,k]"), "mine.toml")
    with pytest.raises(SchemaError, match="each_body"):
        read_effects(text.format(each="each_body = true", basis="q[j]"), "mine.toml")
    with pytest.raises(SchemaError, match="each_body"):
        read_effects(text.format(each="", basis="levz[p,k]"), "mine.toml")


# --------------------------------------------------------------------------- some joints, seconds


def backlash_at_1_and_5(q, direction):
    return q + 2.5e-3 * direction * np.array([1, 0, 0, 0, 1, 0, 0])


def test_an_effect_at_two_joints_is_named_with_them(arm, library, tmp_path):
    found = wb.diagnose(arm, measure(tmp_path, 120, 3, backlash_at_1_and_5), library)
    named = {
        j for e in found.effects if e.accepted and e.name.startswith("backlash[") for j in joints_of(e.name)
    }
    assert named == {1, 5}


def test_a_name_with_several_joints_stands_for_each_of_them(arm, library, tmp_path):
    found = library.find("backlash[1,5]", arm, None)
    assert [h.name for h in found] == ["backlash[1]", "backlash[5]"]
    with pytest.raises(BadInput, match="no such joint"):
        library.find("backlash[1,9]", arm, None)
    fitted = wb.fit(arm, measure(tmp_path, 60, 3, backlash_at_1_and_5), ["backlash[1,5]"], library=library)
    values = dict(zip(fitted.names, fitted.estimate, strict=True))
    assert values["backlash[1].h"] == pytest.approx(2.5e-3, rel=0.2)
    assert values["backlash[5].h"] == pytest.approx(2.5e-3, rel=0.4)


def test_one_effect_at_one_joint_by_two_names_is_refused(arm, library):
    with pytest.raises(BadInput, match=r"backlash\[5\] twice"):
        wb.choose_constants(library, ["backlash[1,5]", "backlash[5,6]"], arm, None)


def test_which_effects_are_open_beside_others(arm, library, tmp_path):
    bare = replace(arm, joints=tuple(replace(j, gear_ratio=None) for j in arm.joints))
    data = measure(tmp_path, 20, 1)
    competition = Competition.of(bare, data, library)

    def open_beside(*names):
        model = [replace(h, name=name) for name in names for h in library.find(name, bare, data)[:1]]
        return {c.name for c in competition.open(model)}

    assert not any(name.startswith("second_ripple") for name in open_beside())
    assert {n for n in open_beside("joint_ripple[2]") if n.startswith("second")} == {"second_ripple[2]"}
    some = open_beside("joint_ripple[2,3]")
    assert "joint_ripple" not in some
    assert {"joint_ripple[1]", "second_ripple", "second_ripple[3]"} <= some
    assert not {"joint_ripple[2]", "joint_ripple[3]", "second_ripple[1]"} & some


def test_an_effect_of_the_model_competes_for_its_own_place(arm, library, tmp_path):
    """Also a second ripple at a joint that the first has left, alone or at several joints."""
    bare = replace(arm, joints=tuple(replace(j, gear_ratio=None) for j in arm.joints))
    data = measure(tmp_path, 20, 1)
    competition = Competition.of(bare, data, library)

    def competing(name, *others):
        model = [replace(h, name=other) for other in others for h in library.find(other, bare, data)[:1]]
        h = replace(library.find(name, bare, data)[0], name=name)
        return {c.name: c.prior for c in competition.with_itself(competition.open(model), h)}

    for name in ("second_ripple[2]", "second_ripple[2,3]"):
        assert name in competing(name, "joint_ripple[1]")
        assert name in competing(name)
    there = competing("joint_ripple[1,2]")
    assert there["joint_ripple[1,2]"] == there["joint_ripple"] == 0.5 * competing("backlash")["joint_ripple"]
