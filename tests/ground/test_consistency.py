"""Do arm table and measurements belong together: nothing is found where they do, wrong readings of real sets
are found; and the arm that a model for flight is of."""

from __future__ import annotations

import json
import struct
import zlib
from dataclasses import replace

import numpy as np
import poses
import pytest
from commands import good, kincal
from places import BIN, DATA, SRC

from kincal import tables
from kincal import workbench as wb
from kincal.cli.errors import EXIT_FAILED, EXIT_INPUT
from kincal.flight import Arm
from kincal.rotations import Pose
from kincal.workbench.consistency import check
from kincal.workbench.consistency.units import degree_rows, millimetre_rows
from kincal.workbench.data.measurements import Measurements
from kincal.workbench.data.readers import read_measurements
from kincal.workbench.data.sums import of_joints
from kincal_shared.errors import BadInput
from kincal_shared.schema.arm import dh_rows, other_convention, read_arm, same_joints, shipped_arms
from kincal_shared.schema.datamap import DataMap

SETS = {"wam": "wam/wam", "ur5": "ur5/ur5", "ur10": "ur10/ur10d", "fr3": "fr3/fr3"}


def real(name):
    arm = wb.read_arm(DATA / name / f"{name}.toml")
    return arm, read_measurements(DATA / f"{SETS[name]}.csv", arm)


def codes(arm, data, *, thorough=False):
    return {finding.code for finding in check(arm, data, thorough=thorough).findings}


# --------------------------------------------------------------------------- no false findings


@pytest.mark.parametrize("name", SETS)
def test_nothing_is_found_on_a_real_set_that_is_right(name):
    answer = check(*real(name))
    assert answer.ok
    assert answer.findings == ()


@pytest.mark.parametrize("name", sorted(shipped_arms()))
def test_nothing_is_found_on_a_simulated_set_of_a_shipped_arm(name):
    """Positions with 0.2 mm of noise of an arm with DH errors of a millimetre and a few milliradians."""
    arm, rng = read_arm(name), np.random.default_rng(7)
    q = rng.uniform(
        [max(j.q_min, -3.0) for j in arm.joints], [min(j.q_max, 3.0) for j in arm.joints], (50, arm.n)
    )
    joints = tuple(
        replace(j, a_m=j.a_m + rng.normal(0, 1e-3), d_m=j.d_m + rng.normal(0, 1e-3),
                alpha_rad=j.alpha_rad + rng.normal(0, 3e-3), phi_rad=j.phi_rad + rng.normal(0, 1e-2))
        for j in arm.joints
    )  # fmt: skip
    base, tool = Pose.of_wxyz([0.3, 0.2, 0.1], [0.5] * 4), Pose.of_wxyz([0.05, 0.02, 0.1], [1, 0, 0, 0])
    p_m = Arm.of(replace(arm, joints=joints), base, tool).fk(q).p_m + rng.normal(0, 2e-4, (50, 3))
    unknown = replace(arm, base=replace(arm.base, estimate=True), tool=replace(arm.tool, estimate=True))
    data = wb.Measurements("simulated", tuple(map(str, range(50))), q, p_m)
    answer = check(unknown, data)
    assert answer.findings == ()


def test_dh_errors_are_no_wrong_arm_table(tmp_path):
    """Of the size of those in the method's paper; of a well-built arm: test_check_says_ok_with_status_0."""
    arm = wb.read_arm(poses.arm_toml(tmp_path / "arm.toml"))
    data = wb.read_csv(poses.poses_csv(tmp_path / "poses.csv", 60, 3, dh_size=0.1), 7)
    assert check(arm, data).ok


def test_a_few_poses_of_one_place_are_few_and_not_in_millimetres(tmp_path):
    """As an aborted calibration leaves them: close together, with noise of a millimetre as stated."""
    arm = wb.read_arm(poses.arm_toml(tmp_path / "arm.toml"))
    data = wb.read_csv(poses.poses_csv(tmp_path / "poses.csv", 60, 3), 7)
    two = data.take(np.arange(2))
    sigma_m = 1e-3
    two = replace(two, q=two.q[[0, 0]], p_m=two.p_m[[0, 0]] + [[0.0] * 3, [sigma_m] * 3])
    two = replace(two, cov=np.tile(np.eye(6) * sigma_m**2, (2, 1, 1)))
    (few,) = (f for f in check(arm, two).findings if f.code == "few_poses")
    assert "whether the arm explains them: this check takes at least 12, a fit fewer" in few.text
    assert "millimetres" not in {f.code for f in check(arm, two).findings}
    two = replace(two, cov=two.cov * 1e6)  # 1 mm written as 1
    assert "millimetres" in {f.code for f in check(arm, two).findings}


@pytest.mark.parametrize("position_only", [False, True])
def test_noise_that_a_fit_falls_far_below_is_in_millimetres(tmp_path, position_only):
    arm = wb.read_arm(poses.arm_toml(tmp_path / "arm.toml"))
    path = poses.poses_csv(tmp_path / "poses.csv", 60, 3, noise_size=0.05, position_only=position_only)
    data = wb.read_csv(path, 7)

    def stated(sigma_m):
        return replace(data, cov=np.tile(np.diag([sigma_m**2] * 3 + [1e-8] * 3), (60, 1, 1)))

    assert check(arm, stated(2.9e-3)).ok
    for wrong in (0.05, 0.005):
        (found,) = check(arm, stated(wrong)).findings
        assert found.code == "millimetres"
        assert f"the stated noise is {wrong:g} m, but a fit of the DH errors leaves 0.0" in found.text
    few = stated(0.01).take(np.arange(14))  # a fit leaves little of few poses, whatever the noise
    noisy = replace(few, p_m=few.p_m + np.random.default_rng(1).normal(0.0, 0.01, few.p_m.shape))
    assert "millimetres" not in codes(arm, noisy)


def test_rotation_noise_that_a_fit_falls_far_below_is_in_degrees(tmp_path):
    arm = wb.read_arm(poses.arm_toml(tmp_path / "arm.toml"))
    data = wb.read_csv(poses.poses_csv(tmp_path / "poses.csv", 60, 3, noise_size=0.05), 7)

    def stated(sigma_rad):
        return replace(data, cov=np.tile(np.diag([1e-4**2] * 3 + [sigma_rad**2] * 3), (60, 1, 1)))

    assert check(arm, stated(4.9e-3)).ok
    (found,) = check(arm, stated(np.rad2deg(2e-4))).findings
    assert (found.code, found.severity) == ("degrees", "warning")
    assert "noise of rotations is 0.0115 rad, but a fit" in found.text and "sr_rad in radians" in found.fix
    assert check(arm, replace(stated(0.0115), quat_wxyz=None)).ok


@pytest.mark.parametrize(
    ("unit", "code"), [(1e2, "centimetres"), (1e3, "millimetres"), (1 / 0.0254, "inches")]
)
def test_a_length_has_the_code_of_its_unit(tmp_path, unit, code):
    arm = wb.read_arm(poses.arm_toml(tmp_path / "arm.toml"))
    data = wb.read_csv(poses.poses_csv(tmp_path / "poses.csv", 40, 3, position_only=True), 7)
    assert codes(arm, replace(data, p_m=unit * data.p_m)) == {code}


def test_a_table_of_flight_is_no_arm_table():
    with pytest.raises(wb.BadInput, match="this is a table of flight.*no arm table") as refused:
        read_arm(SRC / "arm.toml")
    assert "arm wam" in refused.value.todo and "problems" not in str(refused.value)


# --------------------------------------------------------------------------- wrong readings are found


def swapped(arm, data):
    return arm, replace(data, q=data.q[:, [0, 2, 1, *range(3, data.n_joints)]])


def mixed(arm, data):
    return arm, replace(data, q=data.q[:, np.random.default_rng(4).permutation(data.n_joints)])


def flipped(arm, data):
    return arm, replace(data, q=data.q * [1, 1, -1, *[1] * (data.n_joints - 3)])


def degrees(arm, data):
    return arm, replace(data, q=np.degrees(data.q))


def millimetres(arm, data):
    return arm, replace(data, p_m=1e3 * data.p_m)


def both_units(arm, data):
    return millimetres(*degrees(arm, data))


def convention(arm, data):
    return other_convention(arm), data


def another_arm(arm, data):
    """Another shipped arm with as many joints."""
    shipped = [read_arm(name) for name in ("iiwa14", "irb120")]
    return replace(arm, joints=next(one for one in shipped if one.n == arm.n).joints), data


WRONG = {
    "swapped": (swapped, {"joint_order"}), "mixed": (mixed, {"joint_order"}), "flipped": (flipped, {"sign"}),
    "degrees": (degrees, {"degrees"}), "millimetres": (millimetres, {"millimetres"}),
    "both units": (both_units, {"degrees", "millimetres"}), "convention": (convention, {"convention"}),
    "another arm": (another_arm, {"wrong_arm"}),
}  # fmt: skip
# Positions alone need a search for the frames, which takes long: on these sets each case once.
ON = {
    "fr3": list(WRONG),
    "wam": ["flipped", "another arm"],
    "ur10": ["swapped", "mixed", "convention"],
    "ur5": ["both units"],
}


@pytest.mark.parametrize(("name", "case"), [(name, case) for name, cases in ON.items() for case in cases])
def test_a_wrong_reading_of_a_real_set_is_found(name, case):
    """By 160 to 250 of its poses: one that all poses show, these show too."""
    spoil, expected = WRONG[case]
    arm, data = real(name)
    arm, data = spoil(arm, data.take(np.arange(0, data.n, 4 if data.n > 400 else 1)))
    assert expected <= codes(replace(arm, source="spoilt"), data)


def test_quaternion_order_and_inverse_of_a_real_set_are_found():
    arm, data = real("fr3")
    assert codes(arm, replace(data, quat_wxyz=np.roll(data.quat_wxyz, -1, axis=1))) == {"quaternion_order"}
    inverse = Pose.of_wxyz(data.p_m, data.quat_wxyz).inverse
    assert codes(arm, replace(data, p_m=inverse.p_m, quat_wxyz=inverse.quat_wxyz)) == {"inverse_pose"}


def longer(arm, *lengths, by=1e3):
    """The arm table with lengths (joint from 1, key) in millimetres."""
    joints = list(arm.joints)
    for j, key in lengths:
        joints[j - 1] = replace(joints[j - 1], **{key: by * getattr(joints[j - 1], key)})
    return replace(arm, joints=tuple(joints))


@pytest.mark.parametrize(
    ("name", "lengths", "said"),
    [
        ("ur5", [(2, "a_m")], "joint[2].a_m = -0.425"),
        ("ur5", [(5, "d_m")], "joint[5].d_m = 0.09465"),
        ("ur10", [(2, "a_m"), (3, "a_m")], "joint[2].a_m = -0.612, joint[3].a_m = -0.5723"),
        ("wam", [(3, "a_m")], "joint[3].a_m = 0.045"),
    ],
)
def test_links_in_millimetres_are_the_first_suspects(name, lengths, said):
    """Other arms that ship, and positions in another unit, were named before them, or alone."""
    arm, data = real(name)
    for thorough in (False, True):
        (found,) = check(longer(arm, *lengths), data, thorough=thorough).findings
        assert (found.code, found.fix) == ("millimetres", f"write metres: {said}")
        assert found.gain > 100.0
    unsigned = replace(data, q=data.q * [1, 1, -1, *[1] * (arm.n - 3)])
    assert {f.fix.partition(":")[0] for f in check(longer(arm, *lengths), unsigned).findings} == {
        "write metres", "change the sign of these readings, or turn the axes in the arm table (joint 3)"
    }  # fmt: skip


def test_an_arm_table_that_is_all_in_millimetres_is_one_finding():
    """Its frames were named first, as wrong ones, and lengths of them as metres."""
    arm = wb.read_arm("wam")
    random = np.random.default_rng(4)
    q = random.uniform([j.q_min for j in arm.joints], [j.q_max for j in arm.joints], (60, 7))
    p_m = np.array([poses.tool_pose(row, np.zeros((7, 4)))[:3, 3] for row in q])
    data = wb.Measurements("made", tuple(map(str, range(60))), q, p_m)
    assert codes(arm, data) == set()
    frames = {name: replace(f, xyz_m=1e3 * f.xyz_m) for name, f in (("base", arm.base), ("tool", arm.tool))}
    lengths = [(j, key) for j in range(1, 8) for key in ("a_m", "d_m")]
    (found,) = check(replace(longer(arm, *lengths), **frames), data).findings
    assert found.code == "millimetres"
    assert found.fix == "write a_m, d_m, xyz_m of [base], xyz_m of [tool] in metres"


def test_links_along_almost_parallel_axes_and_back_are_no_millimetres():
    """Axes of joints 2 and 3 that are 2 mrad skew and cross 17 m away, as an exported URDF has them."""
    arm, rng = read_arm("irb120"), np.random.default_rng(5)
    joints = list(arm.joints)
    joints[1] = replace(joints[1], d_m=-17.4, alpha_rad=2e-3)
    joints[2] = replace(joints[2], d_m=17.4)
    arm = replace(arm, joints=tuple(joints))
    q = rng.uniform(-1.2, 1.2, (40, 6))
    p_m = Arm.of(arm, Pose.identity(), Pose.identity()).fk(q).p_m
    data = wb.Measurements("skew", tuple(map(str, range(40))), q, p_m + rng.normal(0, 1e-4, p_m.shape))
    assert codes(arm, data) == set()
    assert codes(arm, replace(data, p_m=1e3 * data.p_m)) == {"millimetres"}


def test_a_large_arm_in_metres_is_not_in_millimetres():
    arm, data = real("ur5")
    lengths = [(j, key) for j in range(1, 7) for key in ("a_m", "d_m")]
    large = longer(arm, *lengths, by=6.0)
    far = replace(data, p_m=6.0 * data.p_m)
    assert codes(large, far) == set()
    assert codes(large, replace(far, q=far.q * [1, 1, -1, 1, 1, 1])) == {"sign"}
    assert codes(large, replace(far, p_m=1e-3 * far.p_m), thorough=True) == {"millimetres"}
    (found,) = check(longer(arm, *lengths), replace(data, p_m=1e3 * data.p_m)).findings  # both
    assert "the links of the arm table add up to" in found.why


def test_the_other_convention_is_its_own_inverse():
    for name in ("wam", "fr3"):
        arm = read_arm(name)
        there = other_convention(arm)
        assert not same_joints(arm, there)
        np.testing.assert_allclose(dh_rows(other_convention(there)), dh_rows(arm), atol=0.0)


# --------------------------------------------------------------------------- outliers


def moved(data, number, shift_m):
    """Every so-many-th pose shifted."""
    p_m = data.p_m.copy()
    p_m[::number] += [0.0, 0.0, shift_m]
    return replace(data, p_m=p_m)


@pytest.mark.parametrize(("name", "shift_m"), [("wam", 0.285), ("fr3", 0.15), ("ur5", 0.02)])
def test_a_fifth_of_the_poses_far_off_is_found_with_their_numbers(name, shift_m):
    """Of every set, so many that the misfit of the best four fifths does not show them."""
    arm, data = real(name)
    answer = check(arm, moved(data, 5, shift_m))
    (finding,) = answer.findings
    assert (finding.code, finding.severity, answer.ok) == ("outliers", "warning", False)
    assert finding.poses == data.ids[::5]
    assert f"{len(finding.poses)} of {data.n} poses are off by" in finding.why
    assert float(finding.why.split("off by ")[1].split(" mm")[0]) == pytest.approx(1e3 * shift_m, rel=0.1)
    assert finding.fix.endswith(",".join(finding.poses))


def test_a_few_poses_far_off_are_only_said():
    arm, data = real("wam")
    answer = check(arm, moved(data, 80, 0.285))
    assert [(f.code, f.severity, f.poses) for f in answer.findings] == [("outliers", "note", data.ids[::80])]
    assert answer.ok


def test_check_ends_with_status_1_where_a_fifth_of_the_poses_is_off(folder):
    lines = (folder / "poses.csv").read_text().splitlines()
    header = lines[0].split(",")
    for k in range(1, len(lines), 5):
        row = lines[k].split(",")
        row[header.index("px")] = str(float(row[header.index("px")]) + 0.3)
        lines[k] = ",".join(row)
    (folder / "poses.csv").write_text("\n".join(lines))
    given = ("--arm", folder / "arm.toml", "--data", folder / "poses.csv")
    done = kincal("check", *given)
    assert done.exit_code == EXIT_FAILED
    assert "corrected first" in done.stdout
    assert "8 of 40 poses are off by" in done.stdout
    (finding,) = json.loads(kincal("check", *given, "--json").stdout)["findings"]
    assert finding["poses"] == [f"p{k}" for k in range(0, 40, 5)]
    good("model", "check", *given, *finding["fix"].split()[-2:])


# --------------------------------------------------------------------------- the command


@pytest.fixture
def folder(tmp_path):
    poses.arm_toml(tmp_path / "arm.toml")
    poses.poses_csv(tmp_path / "poses.csv", 40, 5)
    return tmp_path


def test_check_says_ok_with_status_0(folder):
    done = good("model", "check", "--arm", folder / "arm.toml", "--data", folder / "poses.csv", "--json")
    answer = json.loads(done.stdout)
    assert (answer["ok"], answer["findings"], answer["poses"]) == (True, [], 40)


def test_check_names_code_reason_fix_and_gain_with_status_1(folder):
    text = (folder / "poses.csv").read_text().replace("q2,q3", "q3,q2", 1)
    (folder / "poses.csv").write_text(text)
    done = kincal("check", "--arm", folder / "arm.toml", "--data", folder / "poses.csv", "--json")
    assert done.exit_code == EXIT_FAILED
    answer = json.loads(done.stdout)
    (finding,) = answer["findings"]  # readings outside the limits follow from it, and are not said
    assert not answer["ok"]
    assert finding["code"] == "joint_order"
    assert finding["gain"] > 10.0
    assert "q1,q3,q2,q4" in finding["fix"]
    shown = kincal("check", "--arm", folder / "arm.toml", "--data", folder / "poses.csv")
    assert shown.exit_code == EXIT_FAILED
    assert "do NOT belong together" in shown.stdout
    advice = finding["fix"].split()[-2:]
    good("model", "check", "--arm", folder / "arm.toml", "--data", folder / "poses.csv", *advice)


def test_readings_outside_the_limits_and_still_joints_are_said(folder):
    arm = wb.read_arm(folder / "arm.toml")
    data = wb.read_csv(folder / "poses.csv", 7)
    q = data.q.copy()
    q[3, 0] += 2.0 * np.pi
    assert codes(arm, replace(data, q=q)) == {"outside_limits"}
    q[:, 4] = 0.2
    assert "spread" in codes(arm, replace(data, q=q))


def test_readings_in_degrees_are_one_finding(folder):
    """They are outside the limits of every joint too, which says nothing more."""
    data = wb.read_csv(folder / "poses.csv", 7)
    arm = wb.read_arm(folder / "arm.toml")
    found = check(arm, replace(data, q=np.degrees(data.q)))
    assert [f.code for f in found.findings if f.severity != "note"] == ["degrees"]


# --------------------------------------------------------------------------- the arm of a model for flight


@pytest.mark.parametrize("name", sorted(shipped_arms()))
def test_kinematics_crc_is_that_of_the_rounded_dh_table(name):
    arm = read_arm(name)
    rows = [
        (int(j.prismatic), *(round(1e6 * x) for x in (j.phi_rad, j.alpha_rad, j.a_m, j.d_m)))
        for j in arm.joints
    ]
    packed = b"".join(struct.pack("<5i", *row) for row in rows)
    assert Arm.of(arm).kinematics_crc == zlib.crc32(packed)


def test_uplink_names_the_arm_in_the_table(folder):
    (folder / "M.toml").write_text("version = 1\n")
    bin_dir = BIN
    args = ("uplink", "--model", folder / "M.toml", "--tables", bin_dir, "-o", folder / "terms.tbl")
    done = good("model", *args, "--arm", folder / "arm.toml")
    assert f"the arm is that of {bin_dir / 'arm.tbl'}" in done.output
    _, terms = tables.load(folder / "terms.tbl")
    _, flown = tables.load(bin_dir / "arm.tbl")
    assert terms.kinematics_crc == Arm.of_table(flown).kinematics_crc != 0


def test_uplink_says_with_which_tables_it_compared_and_needs_those_that_fly(folder, tmp_path):
    (folder / "M.toml").write_text("version = 1\n")
    args = ("uplink", "--model", folder / "M.toml", "--arm", folder / "arm.toml", "-o", tmp_path / "t.tbl")
    assert "tables/bin/arm.tbl" in kincal(*args).output
    assert "bounds within what tables/bin/space.tbl was verified for" in kincal(*args).output
    refused = kincal(*args, "--tables", tmp_path)
    assert refused.exit_code == EXIT_INPUT
    assert "holds no arm.tbl" in refused.stderr and "--tables" in refused.stderr
    (tmp_path / "arm.tbl").write_bytes((BIN / "arm.tbl").read_bytes())
    assert "holds no space.tbl" in kincal(*args, "--tables", tmp_path).stderr


def test_turns_are_no_degrees_and_lost_positions_no_metres(arm):
    """A controller that counts turns; a tracker that writes 0, 0, 0 where it lost the target, or a spike."""
    q = np.random.default_rng(1).uniform(-1.0, 1.0, (40, 7))
    p = np.random.default_rng(2).uniform(-0.4, 0.4, (40, 3)) + [0.4, 0.0, 0.5]
    data = Measurements("made up", tuple(map(str, range(40))), q, p)
    every = np.arange(40) % 2 == 0
    assert not degree_rows(arm, replace(data, q=q + 2.0 * np.pi * every[:, None])).any()
    assert degree_rows(arm, replace(data, q=np.where(every[:, None], np.degrees(q), q))).sum() >= 18
    assert not millimetre_rows(arm, replace(data, p_m=np.where(every[:, None], 0.0, p))).any()
    spike = p.copy()
    spike[7] = [999.0, 999.0, 999.0]
    assert not millimetre_rows(arm, replace(data, p_m=spike)).any()
    mixed = replace(data, p_m=np.where(every[:, None], 1000.0 * p, p))
    assert np.array_equal(millimetre_rows(arm, mixed), every)


# --------------------------------------------------------------------------- joints


def one_joint_after_another(spoil):
    """An irb120 and 60 positions with 0.1 mm of noise, of which ten each turn one joint, and what `spoil`
    made of the readings."""
    arm, rng = read_arm("irb120"), np.random.default_rng(3)
    q = np.tile([0.3, 0.2, -0.3, 0.4, 0.6, 0.2], (60, 1))
    for j in range(6):
        q[10 * j : 10 * j + 10, j] += rng.uniform(-0.7, 0.7, 10)
    arm = replace(arm, base=replace(arm.base, estimate=True), tool=replace(arm.tool, estimate=True))
    tool = Pose.of_wxyz([0.05, 0.02, 0.1], [1, 0, 0, 0])
    p_m = Arm.of(arm, Pose.of_wxyz([0.3, 0.2, 0.1], [1, 0, 0, 0]), tool).fk(q).p_m
    ids = tuple(map(str, range(1, 61)))
    return arm, wb.Measurements("series", ids, spoil(q.copy()), p_m + rng.normal(0, 1e-4, p_m.shape))


def coupled(q, factor=-1.0):
    """Readings of joint 3 that contain joint 2."""
    q[:, 2] += factor * q[:, 1]
    return q


@pytest.mark.parametrize("factor", [-1.0, 1.0])
def test_readings_of_a_joint_that_contain_the_one_before_are_found(tmp_path, factor):
    arm = wb.read_arm(poses.arm_toml(tmp_path / "arm.toml"))
    data = wb.read_csv(poses.poses_csv(tmp_path / "poses.csv", 40, 3), 7)
    (finding,) = check(arm, replace(data, q=coupled(data.q.copy(), factor)), thorough=False).findings
    assert (finding.code, finding.severity) == ("coupled", "error")
    assert "readings of joint 3 contain joint 2 (as FANUC controllers" in finding.why
    assert finding.fix.endswith(f'[readings] q3 = "q3 {"-" if factor > 0 else "+"} q2"')


def test_a_map_file_says_which_readings_contain_another_joint(tmp_path):
    """With its sum the file is read as one in which they do not."""
    arm_path, path = poses.arm_toml(tmp_path / "arm.toml"), poses.poses_csv(tmp_path / "poses.csv", 40, 3)
    header, *rows = [line.split(",") for line in path.read_text().splitlines()]
    second, third = header.index("q2"), header.index("q3")
    for row in rows:
        row[third] = repr(float(row[third]) - float(row[second]))
    (tmp_path / "coupled.csv").write_text("\n".join(",".join(row) for row in [header, *rows]))
    (tmp_path / "map.toml").write_text('[readings]\nq3 = "q3 + q2"\n')
    given = ("--arm", arm_path, "--data", tmp_path / "coupled.csv")
    assert "[readings]" in kincal("check", *given).stdout
    assert "belong together" in good("model", "check", *given, "--map", tmp_path / "map.toml").stdout
    mapped, out = (*given, "--map", tmp_path / "map.toml"), tmp_path / "next.csv"
    asked = good("model", "next", *mapped, "--count", 1, "-o", out, "backlash[1]", "backlash[2]")
    said = 'values are those of the joints, what a controller calls them follows by [readings] q3 = "q3 + q2"'
    assert f"note: {said}" in asked.stderr and f"# {said}; read this file without" in out.read_text()
    plain = good("model", "next", *given, "--force", "--count", 1, "backlash[1]", "backlash[2]")
    assert "values are those of the joints" not in plain.stderr
    for text, why in (
        ("q3 + q9", "there are 7"),
        ("q3 * q2", 'which has another form; write it as in readings = { q3 = "q3 + q2" }'),
        ("q3 - q3", "write q3 and one other joint"),
        ("q2 + q1", "write q3 and one other joint"),
        ('q3 + q2"\nq2 = "q2 + q3', "always move together"),
    ):
        (tmp_path / "map.toml").write_text(f'[readings]\nq3 = "{text}"\n')
        done = kincal("check", *given, "--map", tmp_path / "map.toml")
        assert done.exit_code == EXIT_INPUT and why in done.stderr


@pytest.mark.parametrize(
    ("spoil", "sums", "fix"),
    [
        (coupled, [("q3", "q3 - q2")], 'q3 = "q3 + q2", in the place of [readings] q3 = "q3 - q2"'),
        (coupled, [("q2", "q2 + q3")], 'q3 = "q3 + q2", in the place of [readings] q2 = "q2 + q3"'),
        (lambda q: q, [("q2", "q2 + q1")], 'take [readings] q2 = "q2 + q1" out of the map file'),
    ],
)
def test_a_wrong_sum_of_the_map_is_not_called_a_wrong_arm(tmp_path, spoil, sums, fix):
    """A sum with the other sign ended in "wrong_arm"; one too many in the advice to write the opposite one,
    which takes its place and is as wrong."""
    arm = wb.read_arm(poses.arm_toml(tmp_path / "arm.toml"))
    data = wb.read_csv(poses.poses_csv(tmp_path / "poses.csv", 40, 3), 7)
    q = of_joints(spoil(data.q.copy()), sums)
    (finding,) = check(arm, replace(data, q=q, sums=tuple(sums)), thorough=False).errors
    assert finding.code == "coupled" and fix in finding.fix and finding.gain > 5.0


def test_a_right_sum_of_the_map_stays_where_something_else_is_wrong(tmp_path):
    arm = wb.read_arm(poses.arm_toml(tmp_path / "arm.toml"))
    data = wb.read_csv(poses.poses_csv(tmp_path / "poses.csv", 40, 3), 7)
    q = data.q * [1, 1, 1, -1, 1, 1, 1]
    (finding,) = check(arm, replace(data, q=q, sums=(("q3", "q3 + q2"),)), thorough=False).errors
    assert finding.code == "sign" and "joint 4" in finding.why


def test_a_sum_of_an_angle_and_a_length_is_refused(tmp_path):
    arm = wb.read_arm(poses.arm_toml(tmp_path / "arm.toml"))
    slides = (replace(arm.joints[0], prismatic=True), *arm.joints[1:])
    path, mapping = poses.poses_csv(tmp_path / "poses.csv", 8, 3), DataMap(readings={"q2": "q2 + q1"})
    with pytest.raises(BadInput, match="adds a length to an angle"):
        read_measurements(path, replace(arm, joints=slides), mapping)


def test_a_mistake_about_a_joint_that_moves_in_few_poses_is_found():
    """They are outliers of a fit; the quick check of compare and diagnose finds it too."""
    assert codes(*one_joint_after_another(lambda q: q)) <= {"outside_limits"}
    (finding,) = check(*one_joint_after_another(coupled), thorough=False).findings
    assert finding.code == "coupled" and 'q3 = "q3 + q2"' in finding.fix and finding.gain > 50
    reversed_ = one_joint_after_another(lambda q: q * [1, -1, 1, 1, 1, 1])
    assert codes(*reversed_) == {"sign"}


def test_outliers_name_the_joint_that_moves_in_them():
    def wrong(q):
        q[10:20, 1] = q[10:20, 1][::-1]  # of other rows
        return q

    (finding,) = check(*one_joint_after_another(wrong), thorough=False).findings
    assert (finding.code, finding.severity) == ("outliers", "warning")
    assert "; they are the poses in which joint 2 moves" in finding.why
    assert "readings of joint 2 wrong, or coupled" in finding.fix
    arm, data = real("wam")
    (other,) = check(arm, moved(data, 5, 0.285)).findings
    assert "in which joint" not in other.why


def test_zeros_of_two_joints_a_quarter_turn_off_are_found(tmp_path):
    arm = wb.read_arm(poses.arm_toml(tmp_path / "arm.toml"))
    data = wb.read_csv(poses.poses_csv(tmp_path / "poses.csv", 40, 3), 7)
    shifted = replace(data, q=data.q - [0, np.pi / 2, np.pi / 2, 0, 0, 0, 0])
    finding, *_ = check(arm, shifted, thorough=False).findings
    assert finding.code == "offset" and "(joint 2: +90 deg, joint 3: +90 deg)" in finding.why


def test_an_arm_that_leaves_much_unexplained_is_not_without_a_finding(tmp_path):
    """Much that DH errors explain, and what nothing explains, as several targets mixed in one column."""
    arm = wb.read_arm(poses.arm_toml(tmp_path / "arm.toml"))
    far = wb.read_csv(poses.poses_csv(tmp_path / "far.csv", 60, 3, dh_size=0.1), 7)
    (note,) = check(arm, far, thorough=False).findings
    assert (note.code, note.severity) == ("corrections", "note") and "nominal arm leaves 31%" in note.why
    data = wb.read_csv(poses.poses_csv(tmp_path / "poses.csv", 60, 3, position_only=True), 7)
    mixed = data.p_m + np.random.default_rng(1).normal(0.0, 0.02, data.p_m.shape)
    (finding,) = check(arm, replace(data, p_m=mixed, cov=None), thorough=False).findings
    assert (finding.code, finding.severity) == ("unexplained", "warning")
    assert "several targets mixed in one column" in finding.fix
