"""In a clean environment: from a URDF and a CSV in degrees and millimetres to an exported URDF, C and Python.

Oracle: Pinocchio moves the true arm, and reads the exported URDF."""

import csv

import numpy as np
import pytest
from environments import asked
from exports import CModule, python_module

import kincal
from kincal.flight import Observations

pinocchio = pytest.importorskip("pinocchio")
pytestmark = pytest.mark.slow

# Origins of a six-joint arm (xyz, rpy, axis), nominal; the names are those of its maker.
CHAIN = [
    ("shoulder_pan_joint", "shoulder_link", (0, 0, 0.152), (0, 0, 0), (0, 0, 1)),
    ("shoulder_lift_joint", "upper_arm_link", (0, 0.12, 0), (0, np.pi / 2, 0), (0, 1, 0)),
    ("elbow_joint", "forearm_link", (0, -0.093, 0.244), (0, 0, 0), (0, 1, 0)),
    ("wrist_1_joint", "wrist_1_link", (0, 0, 0.213), (0, np.pi / 2, 0), (0, 1, 0)),
    ("wrist_2_joint", "wrist_2_link", (0, 0.104, 0), (0, 0, 0), (0, 0, 1)),
    ("wrist_3_joint", "wrist_3_link", (0, 0, 0.085), (0, 0, 0), (0, 1, 0)),
]
# What DH errors leave of wrong origins: mounting and tool.
EFFECTS = ("encoder_eccentricity[2]", "base_tilt", "base_shift", "tool_shift")
TOOL = ((0, 0.092, 0.05), (0, 0, np.pi / 2))


def numbers(values):
    return " ".join(repr(float(x)) for x in values)


def write_urdf(path, errors=None):
    """The arm; errors (6, 6): what its joints' origins are off by."""
    errors = np.zeros((6, 6)) if errors is None else errors
    links = ["base_link", *(row[1] for row in CHAIN), "tool0"]
    text = [f'<link name="{name}"/>' for name in links]
    for parent, (name, child, xyz, rpy, axis), error in zip(links, CHAIN, errors, strict=False):
        text.append(
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{numbers(xyz + error[:3])}" rpy="{numbers(rpy + error[3:])}"/>'
            f'<axis xyz="{numbers(axis)}"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
        )
    xyz, rpy = TOOL
    text.append(
        '<joint name="flange" type="fixed"><parent link="wrist_3_link"/><child link="tool0"/>'
        f'<origin xyz="{numbers(xyz)}" rpy="{numbers(rpy)}"/></joint>'
    )
    path.write_text(f'<robot name="six">{"".join(text)}</robot>')
    return path


def tool_poses(path, qs):
    """(N, 4, 4) poses of the last frame in the root, by Pinocchio."""
    model = pinocchio.buildModelFromUrdf(str(path))
    data, out = model.createData(), []
    for q in qs:
        pinocchio.framesForwardKinematics(model, data, np.asarray(q, dtype=float))
        out.append(data.oMf[model.getFrameId("tool0")].homogeneous)
    return np.array(out)


def wobbling(q):
    """What joint 2 really does at readings q: its encoder disc is off centre by 1 mrad."""
    return q + np.outer(np.sin(q[:, 1]), [0, 1e-3, 0, 0, 0, 0])


def write_csv(path, true_urdf, n=80, noise_m=2e-5, seed=1):
    """Readings in degrees, positions and Euler angles of the true arm in mm and degrees, a maker's names."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-2.2, 2.2, (n, 6))
    poses = tool_poses(true_urdf, wobbling(q))
    with path.open("w", newline="") as file:
        out = csv.writer(file, delimiter=";")
        out.writerow([*(f"A{j} [deg]" for j in range(1, 7)), "X", "Y", "Z", "A", "B", "C"])
        for readings, pose in zip(np.degrees(q), poses, strict=True):
            p = 1e3 * (pose[:3, 3] + rng.normal(0, noise_m, 3))
            angles = pinocchio.rpy.matrixToRpy(pose[:3, :3])[::-1]
            out.writerow([*readings, *p, *np.degrees(angles)])


@pytest.fixture(scope="module")
def folder(door, tmp_path_factory):
    """A user's folder after six commands."""
    out = tmp_path_factory.mktemp("six")
    rng = np.random.default_rng(5)
    write_urdf(out / "robot.urdf")
    write_urdf(out / "true.urdf", rng.normal(0, 1, (6, 6)) * [5e-4, 5e-4, 5e-4, 1e-3, 1e-3, 1e-3])
    write_csv(out / "poses.csv", out / "true.urdf")
    mapping = ("--units", "deg,mm", "--column", "q=A{} [deg]", "--column", "p=X,Y,Z")
    mapping += ("--rotation", "euler-ZYX=A,B,C")
    model = ("--model", "M.toml")
    commands = (
        ("arm", "import", "robot.urdf", "--base", "base_link", "--tip", "tool0", "-o", "arm.toml"),
        ("model", "add", *model, *EFFECTS),
        ("model", "fit", "--arm", "arm.toml", "--data", "poses.csv", *mapping, *model),
        ("model", "export", *model, "--format", "urdf", "-o", "calibrated.urdf"),
        ("model", "export", *model, "--format", "c", "-o", "calibrated.c"),
        ("model", "export", *model, "--format", "python", "-o", "calibrated.py"),
    )
    for done in asked(door, out, tmp_path_factory.mktemp("answers"), commands):
        assert done.returncode == 0, done.stderr
    return out


@pytest.fixture(scope="module")
def fresh():
    """Readings that were not measured."""
    return np.random.default_rng(9).uniform(-2, 2, (40, 6))


@pytest.fixture(scope="module")
def fitted(folder):
    """The same fit from Python."""
    data = kincal.Data.load(
        folder / "poses.csv",
        columns={"q": "A{} [deg]", "p": ["X", "Y", "Z"]},
        units={"angle": "deg", "length": "mm"},
        rotation={"form": "euler", "columns": ["A", "B", "C"], "axes": "ZYX"},
    )
    return kincal.fit(kincal.Arm.load(folder / "arm.toml"), data, EFFECTS)


def test_exported_c_and_python_reproduce_predict(folder, fitted, fresh):
    want = fitted.predict(fresh).matrix
    module, c = python_module(folder / "calibrated.py"), CModule(folder / "calibrated.c", "six", [], 6)
    for q, pose in zip(fresh, want, strict=True):
        p, R = module.forward(q)
        assert np.abs(p - pose[:3, 3]).max() < 1e-9
        assert np.abs(R - pose[:3, :3]).max() < 1e-9
        assert np.abs(c.forward(q) - pose).max() < 1e-9


def test_exported_code_predicts_the_true_arm(folder, fresh):
    """The true arm is Pinocchio's: less than a thirtieth of the nominal error is left."""
    true = tool_poses(folder / "true.urdf", wobbling(fresh))[:, :3, 3]
    nominal = tool_poses(folder / "robot.urdf", fresh)[:, :3, 3]
    module = python_module(folder / "calibrated.py")
    said = np.array([module.forward(q)[0] for q in fresh])
    left, before = (np.linalg.norm(x - true, axis=1).mean() for x in (said, nominal))
    assert before > 1e-3
    assert left < 0.03 * before


def test_exported_urdf_is_the_constant_part_of_predict_with_its_names(folder, fitted, fresh):
    model, whole = fitted.result.fit.model, fitted.result.estimate
    steady = np.where([name.startswith("encoder_eccentricity") for name in fitted.names], 0.0, whole)
    seen = Observations.of_columns({"q": fresh}, fitted.arm.table.gravity_m_s2)
    want = model.at(seen).poses(steady).matrix
    assert np.abs(tool_poses(folder / "calibrated.urdf", fresh) - want).max() < 1e-9
    assert np.abs(model.at(seen).poses(whole).matrix - want).max() > 1e-4
    text = (folder / "calibrated.urdf").read_text()
    names = [name for row in CHAIN for name in row[:2]]
    assert all(f'"{name}"' in text for name in [*names, "base_link", "tool0"])
    assert "encoder_eccentricity[2], worth" in text
