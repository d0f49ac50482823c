"""Arms: those that ship, and arm tables from URDF files. Oracle: Pinocchio reads the same URDF."""

import hashlib
import json
import re

import numpy as np
import pytest
from commands import shell
from scipy.spatial.transform import Rotation

pinocchio = pytest.importorskip("pinocchio")

from kincal.arms import arm_text, import_urdf, shipped  # noqa: E402
from kincal_shared.errors import BadInput, CannotAnswer  # noqa: E402
from kincal_shared.schema.arm import read_arm  # noqa: E402

INERTIAL = '<inertial><origin xyz="{x}"/><mass value="{m}"/>' + (
    '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
)


def joint(name, kind, parent, child, *, xyz="0 0 0", rpy="0 0 0", axis="0 0 1", limit="-2 2", more=""):
    lower, upper = limit.split()
    inside = "" if kind == "fixed" else f'<axis xyz="{axis}"/>'
    if kind in ("revolute", "prismatic"):
        inside += f'<limit lower="{lower}" upper="{upper}" effort="1" velocity="1"/>'
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/>{inside}{more}</joint>'
    )


def urdf(path, joints, masses=None, name="bot"):
    """A URDF of these joints; masses: link -> (mass, centre)."""
    masses = masses or {}
    links = dict.fromkeys(re.findall(r'link="([^"]+)"', "".join(joints)))
    body = "".join(
        f'<link name="{link}">'
        + (INERTIAL.format(m=masses[link][0], x=masses[link][1]) if link in masses else "")
        + "</link>"
        for link in links
    )
    path.write_text(f'<robot name="{name}">{body}{"".join(joints)}</robot>')
    return path


def text(values):
    return " ".join(repr(float(v)) for v in values)


def random_urdf(path, seed, n=7):
    """A chain with joints of all kinds, and with parallel, crossing, antiparallel and skew axes."""
    rng = np.random.default_rng(seed)
    joints, masses = [joint("mount", "fixed", "base", "l0", xyz=text(rng.normal(0, 0.2, 3)),
                            rpy=text(rng.uniform(-3, 3, 3)))], {}  # fmt: skip
    for k in range(n):
        kind = rng.choice(["revolute", "revolute", "continuous", "prismatic"])
        right = rng.integers(-1, 3, 3) * np.pi / 2
        rpy = [np.zeros(3), right, rng.uniform(-3, 3, 3)][rng.integers(3)]
        xyz = [np.zeros(3), rng.integers(-1, 2, 3) * 0.25, rng.normal(0, 0.3, 3)][rng.integers(3)]
        axis = [[0, 0, 1], [0, 1, 0], [-1, 0, 0], rng.normal(0, 1, 3)][rng.integers(4)]
        joints.append(
            joint(f"j{k}", kind, f"l{k}", f"l{k + 1}", xyz=text(xyz), rpy=text(rpy), axis=text(axis))
        )
        masses[f"l{k + 1}"] = (float(rng.uniform(0.5, 5)), text(rng.normal(0, 0.1, 3)))
    joints.append(joint("flange", "fixed", f"l{n}", "tip", xyz=text(rng.normal(0, 0.1, 3)),
                        rpy=text(rng.uniform(-3, 3, 3))))  # fmt: skip
    return urdf(path, joints, masses)


def dh_poses(arm, q):
    """Frames 0..n and the measured frame of a table, written out."""
    frame = np.eye(4)
    frame[:3, :3] = Rotation.from_quat(arm.base.quat_wxyz, scalar_first=True).as_matrix()
    frame[:3, 3] = arm.base.xyz_m
    frames = [frame]
    for row, value in zip(arm.joints, q, strict=True):
        phi, d = row.phi_rad + (not row.prismatic) * value, row.d_m + row.prismatic * value
        c, s, ca, sa = np.cos(phi), np.sin(phi), np.cos(row.alpha_rad), np.sin(row.alpha_rad)
        frame = frame @ [[c, -s * ca, s * sa, row.a_m * c], [s, c * ca, -c * sa, row.a_m * s],
                         [0, sa, ca, d], [0, 0, 0, 1]]  # fmt: skip
        frames.append(frame)
    tool = np.eye(4)
    tool[:3, :3] = Rotation.from_quat(arm.tool.quat_wxyz, scalar_first=True).as_matrix()
    tool[:3, 3] = arm.tool.xyz_m
    return frames, frame @ tool


def oracle(path):
    model = pinocchio.buildModelFromUrdf(str(path))
    return model, model.createData()


def oracle_q(model, q):
    """Pinocchio's configuration: continuous joints are (cos, sin)."""
    out = []
    for one, value in zip(list(model.joints)[1:], q, strict=True):
        out += [np.cos(value), np.sin(value)] if one.nq == 2 else [value]
    return np.array(out)


@pytest.mark.parametrize("seed", range(18))
def test_imported_table_is_the_motion_of_the_urdf(tmp_path, seed):
    path = random_urdf(tmp_path / "bot.urdf", seed, n=1 + seed % 9)
    made = import_urdf(path, "base", "tip")
    assert made.difference.largest <= 1e-12
    (tmp_path / "arm.toml").write_text(made.text)
    arm = read_arm(tmp_path / "arm.toml")
    model, data = oracle(path)
    tip = model.getFrameId("tip")
    rng = np.random.default_rng(seed)
    for q in rng.uniform(-2, 2, (20, arm.n)):
        pinocchio.framesForwardKinematics(model, data, oracle_q(model, q))
        np.testing.assert_allclose(dh_poses(arm, q)[1], data.oMf[tip].homogeneous, atol=1e-12, rtol=0)


@pytest.mark.parametrize("seed", range(8))
def test_imported_masses_make_the_gravity_torques_of_the_urdf(tmp_path, seed):
    path = random_urdf(tmp_path / "bot.urdf", seed, n=6)
    (tmp_path / "arm.toml").write_text(import_urdf(path).text)
    arm = read_arm(tmp_path / "arm.toml")
    assert arm.has_masses
    model, data = oracle(path)
    rng = np.random.default_rng(seed)
    for q in rng.uniform(-2, 2, (5, arm.n)):
        want = pinocchio.computePotentialEnergy(model, data, oracle_q(model, q))
        frames, _ = dh_poses(arm, q)
        heights = [(f @ [*row.com_m, 1.0])[2] for f, row in zip(frames[1:], arm.joints, strict=True)]
        got = 9.81 * sum(row.mass_kg * z for row, z in zip(arm.joints, heights, strict=True))
        np.testing.assert_allclose(got, want, rtol=1e-12, atol=1e-10)


def test_table_says_where_it_comes_from_and_what_was_assumed(tmp_path):
    path = urdf(
        tmp_path / "bot.urdf",
        [
            joint("a", "revolute", "base", "l1", xyz="0 0 0.3", rpy="1.5708 0 0", limit="-1.5 2.5"),
            joint("b", "continuous", "l1", "l2", xyz="0.4 0 0", rpy="0 -1.5708 0"),
            joint("c", "prismatic", "l2", "l3", rpy="0 0.3 0", limit="0 0.5"),
        ],
    )
    made = import_urdf(path)
    (tmp_path / "arm.toml").write_text(made.text)
    assert hashlib.sha256(path.read_bytes()).hexdigest() in made.text
    assert 1e-7 < made.difference.largest < 1e-5  # the rounding of the file's 1.5708
    notes = " ".join(made.notes)
    for word in ("90 degrees", "a: ", "b", "masses"):
        assert word in notes
    arm = read_arm(tmp_path / "arm.toml")
    assert [(j.q_min, j.q_max) for j in arm.joints] == [(-1.5, 2.5), (-2 * np.pi, 2 * np.pi), (0.0, 0.5)]
    assert max(abs(j.d_m) + abs(j.a_m) for j in arm.joints) < 1.0


CHAIN = [joint("a", "revolute", "base", "l1"), joint("b", "revolute", "l1", "l2", xyz="1 0 0")]
FINGERS = [joint("f1", "prismatic", "l2", "left"), joint("f2", "prismatic", "l2", "right",
           more='<mimic joint="f1"/>')]  # fmt: skip


@pytest.mark.parametrize(
    ("joints", "ends", "words"),
    [
        (CHAIN, ("bse", "l2"), ["--base", "'bse'", "did you mean base"]),
        (CHAIN, (None, "L1x"), ["--tip", "'L1x'", "did you mean l1"]),
        (CHAIN, ("l2", "base"), ["does not hang", "exchange"]),
        (CHAIN + FINGERS, (None, None), ["2 ends", "--tip", "left", "right"]),
        (CHAIN + FINGERS, (None, "right"), ["'f2' follows joint 'f1'", "mimic", "--tip l2"]),
        (CHAIN + FINGERS, ("left", "right"), ["does not hang on link 'left'"]),
        ([joint("a", "floating", "base", "l1"), CHAIN[1]], (None, None), ["floating", "--base l1"]),
        ([joint("a", "planar", "base", "l1"), CHAIN[1]], (None, None), ["planar", "--base l1"]),
        ([joint("a", "fixed", "base", "l1")], (None, None), ["no moving joint"]),
        ([*CHAIN, joint("c", "revolute", "l3", "l4")], (None, "l2"), ["2 roots", "--base", "l3"]),
        ([joint("a", "revolute", "base", "l1", axis="0 0 0")], (None, None), ["'a'", "length 0"]),
    ],
)
def test_what_is_no_serial_chain_is_refused_with_what_to_do(tmp_path, joints, ends, words):
    with pytest.raises(BadInput) as error:
        import_urdf(urdf(tmp_path / "bot.urdf", joints), *ends)
    for word in words:
        assert word in str(error.value)


def test_chain_of_17_joints_does_not_fit(tmp_path):
    joints = [joint(f"j{k}", "revolute", f"l{k}", f"l{k + 1}", xyz="0.1 0 0") for k in range(17)]
    with pytest.raises(CannotAnswer, match="17 moving joints"):
        import_urdf(urdf(tmp_path / "bot.urdf", joints))


@pytest.mark.parametrize("content", ["", "not xml", "<robot name='x'>", "<html></html>", "<robot name='x'/>"])
def test_file_that_is_no_urdf_is_refused(tmp_path, content):
    path = tmp_path / "bot.urdf"
    path.write_text(content)
    with pytest.raises(BadInput, match="not a URDF"):
        import_urdf(path)


# --------------------------------------------------------------------------- arms that ship


# Where the last link stands at q = 0, as sums of the lengths in the makers' drawings.
AT_ZERO_M = {
    "ur3": (0.24365 + 0.21325, 0.11235 + 0.0819, 0.1519 - 0.08535),
    "ur5": (0.425 + 0.39225, 0.10915 + 0.0823, 0.089159 - 0.09465),
    "ur10": (0.612 + 0.5723, 0.163941 + 0.0922, 0.1273 - 0.1157),
    "ur3e": (0.24355 + 0.2132, 0.13105 + 0.0921, 0.15185 - 0.08535),
    "ur5e": (0.425 + 0.3922, 0.1333 + 0.0996, 0.1625 - 0.0997),
    "ur10e": (0.6127 + 0.57155, 0.17415 + 0.11655, 0.1807 - 0.11985),
    "panda": (0.088, 0.0, 0.333 + 0.316 + 0.384),
    "fr3": (0.088, 0.0, 0.333 + 0.316 + 0.384),
    "iiwa7": (0.0, 0.0, 0.34 + 0.4 + 0.4 + 0.126),
    "iiwa14": (0.0, 0.0, 0.36 + 0.42 + 0.4 + 0.126),
    "irb120": (0.302 + 0.072, 0.0, 0.29 + 0.27 + 0.07),
}


@pytest.mark.parametrize("name", AT_ZERO_M)
def test_shipped_arm_stands_as_the_maker_draws_it(name):
    arm = read_arm(name)
    x, y, z = dh_poses(arm, np.zeros(arm.n))[0][-1][:3, 3]
    np.testing.assert_allclose(np.abs([x, y, z]), np.abs(AT_ZERO_M[name]), atol=1e-9)


def test_every_shipped_arm_is_valid_and_cites_its_source():
    names = [one.name for one in shipped()]
    assert set(names) == {*AT_ZERO_M, "wam"}
    for one in shipped():
        assert one.source, one.name
        assert read_arm(one.name).n == one.joints
        assert arm_text(one.name).startswith("#:schema ")


# --------------------------------------------------------------------------- commands


def run(*args):
    return shell("arm", *args)


def test_list_names_every_arm_with_joints_convention_and_source():
    arms = json.loads(run("list", "--json").stdout)["arms"]
    assert {"name", "joints", "convention", "source"} <= arms[0].keys()
    shown = run("list").stdout
    for one in arms:
        assert one["name"] in shown
        assert one["source"] in shown


def test_show_prints_a_table_that_reads_back(tmp_path):
    (tmp_path / "mine.toml").write_text(run("show", "ur5e").stdout)
    assert read_arm(tmp_path / "mine.toml").joints == read_arm("ur5e").joints
    wrong = run("show", "UR5_e")
    assert wrong.exit_code == 2
    assert "did you mean ur5e" in wrong.stderr


def test_import_writes_the_table_and_prints_the_check(tmp_path):
    path, out = random_urdf(tmp_path / "bot.urdf", 3), tmp_path / "arm.toml"
    done = run("import", path, "--base", "base", "--tip", "tip", "-o", out)
    assert done.exit_code == 0, done.stderr
    assert float(re.search(r"largest difference .* (\S+) m,", done.stdout)[1]) <= 1e-12
    assert "measures another point in a frame of its own: --estimate-frames" in done.stdout
    arm = read_arm(out)
    assert (arm.n, arm.base.estimate, arm.tool.estimate) == (7, False, False)


def test_import_for_a_tracker_writes_unknown_frames(tmp_path):
    path, out = random_urdf(tmp_path / "bot.urdf", 3), tmp_path / "arm.toml"
    done = run("import", path, "--base", "base", "--tip", "tip", "--estimate-frames", "-o", out)
    assert done.exit_code == 0, done.stderr
    assert float(re.search(r"largest difference .* (\S+) m,", done.stdout)[1]) <= 1e-12
    assert "frame of its own" not in done.stdout
    arm = read_arm(out)
    assert (arm.n, arm.base.estimate, arm.tool.estimate) == (7, True, True)


def test_import_names_the_almost_parallel_axes_alone(tmp_path):
    """The length along the axis leads there, that of the next one back: its axes may be at right angles."""
    joints = [
        joint("a", "revolute", "base", "l1"),
        joint("b", "revolute", "l1", "l2", rpy="1.5707963267948966 0 0"),
        joint("c", "revolute", "l2", "l3", xyz="0.3 0.1 0", rpy="0.002 0 0"),
        joint("d", "revolute", "l3", "l4", xyz="0.1 0.1 0", rpy="1.5707963267948966 0 0"),
    ]
    out = tmp_path / "arm.toml"
    done = run("import", urdf(tmp_path / "bot.urdf", joints), "-o", out)
    assert done.exit_code == 0, done.stderr
    assert [k for k, row in enumerate(read_arm(out).joints) if abs(row.d_m) > 10.0] == [1, 2]
    named = re.findall("joint (.) and the next are almost parallel, (\\S+) rad", done.output)
    assert named == [("b", "2.0e-03")]


def test_import_writes_nothing_where_it_cannot(tmp_path):
    path = random_urdf(tmp_path / "bot.urdf", 3)
    (tmp_path / "file").write_text("")
    for out, why in ((tmp_path, "a directory"), (tmp_path / "file" / "arm.toml", "is no directory")):
        done = run("import", path, "-o", out)
        assert (done.exit_code, why in done.stderr) == (2, True), done.stderr


def test_import_names_the_extra_when_the_parser_is_missing(tmp_path, monkeypatch):
    monkeypatch.setattr("kincal_shared.installation.find_spec", lambda _: None)
    done = run("import", random_urdf(tmp_path / "bot.urdf", 3), "-o", tmp_path / "arm.toml")
    assert done.exit_code == 2
    assert "kincal[urdf]" in done.stderr
