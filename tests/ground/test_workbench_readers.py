"""Anybody's data: the same poses in many formats, units and conventions are read as the same measurements.

Oracle: scipy.spatial.transform for forms of rotation; the poses that were written."""

import json
import re

import numpy as np
import poses
import pytest
from commands import kincal
from scipy.spatial.transform import Rotation

from kincal import workbench as wb
from kincal_shared.errors import BadInput, CannotAnswer
from kincal_shared.schema.arm import read_arm
from kincal_shared.schema.datamap import DataMap
from kincal_shared.schema.errors import SchemaError, validate

N = 12
RNG = np.random.default_rng(5)
Q = RNG.uniform(-1.5, 1.5, (N, 2))
P = RNG.normal(0.0, 0.5, (N, 3))
TURN = Rotation.random(N, rng=RNG)
T = np.sort(RNG.uniform(0.0, 60.0, N))


def mapped(**doc):
    return validate(DataMap, doc, "map.toml")


def text_file(path, columns, *, separator=",", decimal=".", header=True):
    """columns: name -> N values."""
    lines = [separator.join(columns)] if header else []
    for row in zip(*columns.values(), strict=True):
        cells = [x if isinstance(x, str) else repr(float(x)).replace(".", decimal) for x in row]
        lines.append(separator.join(cells))
    path.write_text("\n".join(lines) + "\n")
    return path


def named(names, values):
    return dict(zip(names, np.asarray(values).T, strict=True))


def plain(**more):
    quat = named(("qw", "qx", "qy", "qz"), TURN.as_quat(scalar_first=True))
    return {**named(("q1", "q2"), Q), **named(("px", "py", "pz"), P), **quat, **more}


def same(data, *, rotation=True, atol=1e-14):
    np.testing.assert_allclose(data.q, Q, atol=atol)
    np.testing.assert_allclose(data.p_m, P, atol=atol)
    if rotation:
        got = Rotation.from_quat(data.quat_wxyz, scalar_first=True)
        assert (got.inv() * TURN).magnitude().max() < 1e-12
    return data


# --------------------------------------------------------------------------- text


@pytest.mark.parametrize(
    ("separator", "decimal"), [(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), (" ", ".")]
)
def test_separators_and_decimal_commas_are_found_out(tmp_path, separator, decimal):
    path = text_file(tmp_path / "d.csv", plain(), separator=separator, decimal=decimal)
    same(wb.read_measurements(path, 2))


def test_mapped_columns_in_degrees_and_millimetres(tmp_path):
    columns = {
        **named(("Joint 1 [deg]", "Joint 2 [deg]"), np.degrees(Q)),
        **named(("X [mm]", "Y [mm]", "Z [mm]"), P * 1e3),
        **named(("A", "B", "C"), TURN.as_euler("ZYX", degrees=True)),
        "time [ms]": T * 1e3, "note": ["ok"] * N, "sp_m": np.full(N, 2e-4), "sr_rad": np.full(N, 1e-3),
    }  # fmt: skip
    path = text_file(tmp_path / "d.csv", columns, separator=";", decimal=",")
    data = same(
        wb.read_measurements(
            path,
            2,
            mapped(
                columns={"q": "Joint {} [deg]", "p": ["X [mm]", "Y [mm]", "Z [mm]"], "t_s": "time [ms]"},
                units={"angle": "deg", "length": "mm", "time": "ms"},
                rotation={"form": "euler", "axes": "ZYX", "columns": ["A", "B", "C"]},
            ),
        )
    )
    np.testing.assert_allclose(data.t_s, T, rtol=1e-12)
    assert data.unknown_columns == ("note",)
    np.testing.assert_allclose(data.cov[0], np.diag([2e-4**2] * 3 + [1e-3**2] * 3))  # own name, own unit


@pytest.mark.parametrize(
    ("form", "values", "more"),
    [
        ("wxyz", TURN.as_quat(scalar_first=True), {}), ("xyzw", TURN.as_quat(), {}),
        ("rotvec", TURN.as_rotvec(), {}), ("matrix", TURN.as_matrix().reshape(N, 9), {}),
        ("euler", TURN.as_euler("xyz"), {"axes": "xyz"}), ("euler", TURN.as_euler("ZYZ"), {"axes": "ZYZ"}),
    ],
)  # fmt: skip
def test_every_form_of_rotation(tmp_path, form, values, more):
    names = [f"r{k}" for k in range(1, values.shape[1] + 1)]
    columns = {**named(("q1", "q2"), Q), **named(("px", "py", "pz"), P), **named(names, values)}
    path = text_file(tmp_path / "d.csv", columns)
    same(wb.read_measurements(path, 2, mapped(rotation={"form": form, "columns": "r{}", **more})))


def test_file_without_header_is_read_by_column_numbers(tmp_path):
    path = text_file(tmp_path / "d.txt", plain(), separator=" ", header=False)
    names = {"q": ["1", "2"], "p": ["3", "4", "5"]}
    turn = {"form": "wxyz", "columns": ["6", "7", "8", "9"]}
    same(wb.read_measurements(path, 2, mapped(columns=names, rotation=turn, text={"header": False})))


def test_prismatic_readings_are_lengths(tmp_path):
    table = tmp_path / "arm.toml"
    joint = "a_m = 0.1\nalpha_rad = 0.0\nd_m = 0.0\nphi_rad = 0.0\n"
    table.write_text(
        'name = "a"\nconvention = "standard"\ngravity_m_s2 = [0.0, 0.0, -9.81]\n[base]\nestimate = true\n'
        f'[tool]\nestimate = true\n[[joint]]\ntype = "revolute"\nq_min_rad = -2\nq_max_rad = 2\n{joint}'
        f'[[joint]]\ntype = "prismatic"\nq_min_m = -2\nq_max_m = 2\n{joint}'
    )
    columns = {"q1": np.degrees(Q[:, 0]), "q2": Q[:, 1] * 1e3, **named(("px", "py", "pz"), P * 1e3)}
    path = text_file(tmp_path / "d.csv", columns)
    units = mapped(units={"angle": "deg", "length": "mm"})
    same(wb.read_measurements(path, read_arm(table), units), rotation=False)


GIVEN = "q1;q2;px;py;pz\n"


@pytest.mark.parametrize(
    ("text", "doc", "words"),
    [
        (GIVEN + "0,5;1;1;2;3\n0.5;1;1;2;3\n", {}, ["decimal commas (0,5)", "points (0.5)", "decimal ="]),
        (GIVEN + "0,5;1.000,5;1;2;3\n", {"text": {"decimal": ","}}, ["line 2", "q2 is 1.000,5"]),
        (GIVEN + "0,5;1;1;2;3\n", {"text": {"decimal": "."}}, ["line 2", "0,5", "with a decimal point"]),
        (GIVEN + "1;1;1;2\n", {}, ["line 2", "4 values"]),
        ("J1;J2;X;Y;Z\n1;2;3;4;5\n", {}, ["line 1", "q1, q2, px", "--column", "J1, J2, X"]),
        ("J1;J2;X;Y;Z\n1;2;3;4;5\n", {"columns": {"q": "j{}", "p": ["X", "Y", "Z"]}},
         ["q: there is no column 'j1'", "did you mean 'J1'", "X, Y, Z"]),
        ("J1;J2;X;Y;Z\n1;2;3;4;5\n", {"columns": {"q": "J1"}}, ["q takes 2 columns", 'q_{}']),
        (GIVEN + "1;2;3;4;5\n", {"rotation": {"form": "matrix", "columns": "m{}"}}, ["'m1', 'm2'"]),
        (GIVEN.strip() + ";a;b;c;d\n1;2;3;4;5;1;1;0;0\n",
         {"rotation": {"form": "xyzw", "columns": ["a", "b", "c", "d"]}}, ["line 2", "a,b,c,d has norm 1.4"]),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_refused_with_place_and_remedy(tmp_path, text, doc, words):
    path = tmp_path / "d.csv"
    path.write_text(text)
    with pytest.raises(BadInput) as error:
        wb.read_measurements(path, 2, mapped(**doc))
    for word in (str(path), *words):
        assert word in str(error.value)


@pytest.mark.parametrize(
    ("doc", "words"),
    [
        ({"columns": {"position": "X"}}, ["columns.position", "write p"]),
        ({"units": {"angle": "degrees"}}, ["units.angle", '"deg"']),
        ({"rotation": {"form": "euler", "columns": "a{}"}}, ["rotation.axes", "ZYX"]),
        ({"rotation": {"form": "euler", "columns": "a{}", "axes": "ZZX"}}, ["axes", "neighbours"]),
        ({"rotation": {"form": "xyzw", "columns": ["a"]}}, ["columns", "1 names", "4"]),
        ({"targets": {"columns": ["a{}"]}, "columns": {"p": "p{}"}}, ["columns.p", "[targets]"]),
        ({"targets": {"columns": ["a{}"], "tool_m": [[0, 0, 0], [1, 0, 0]]}}, ["tool_m", "2 points"]),
    ],
)
def test_map_that_contradicts_itself_is_refused(doc, words):
    with pytest.raises(SchemaError) as error:
        mapped(**doc)
    for word in words:
        assert word in str(error.value)


# --------------------------------------------------------------------------- arrays


def test_npz_with_arrays_of_several_columns(tmp_path):
    np.savez(tmp_path / "d.npz", q=Q, p=P, quat_wxyz=TURN.as_quat(scalar_first=True), t_s=T, rate=30.0)
    data = same(wb.read_measurements(tmp_path / "d.npz", 2))
    np.testing.assert_array_equal(data.t_s, T)


def test_npz_with_names_of_its_own_and_4x4_poses(tmp_path):
    pose = np.tile(np.eye(4), (N, 1, 1))
    pose[:, :3, :3], pose[:, :3, 3] = TURN.as_matrix(), P * 1e3
    np.savez(tmp_path / "d.npz", joints=np.degrees(Q), T_base_tool=pose)
    parts = {k: [f"T_base_tool{4 * (i // 3) + i % 3 + 1}" for i in range(9)] for k in ["columns"]}
    chosen = mapped(
        columns={"q": "joints{}", "p": ["T_base_tool4", "T_base_tool8", "T_base_tool12"]},
        units={"angle": "deg", "length": "mm"},
        rotation={"form": "matrix", **parts},
    )
    same(wb.read_measurements(tmp_path / "d.npz", 2, chosen))


def test_npz_of_arrays_of_different_length_is_refused(tmp_path):
    np.savez(tmp_path / "d.npz", q=Q, p=P[:-1])
    with pytest.raises(BadInput, match=r"'p' has 11 rows, others have 12"):
        wb.read_measurements(tmp_path / "d.npz", 2)


@pytest.mark.parametrize(
    "name, values, words",
    [
        ("q", Q + 1j, "row 1: q1 is ("),
        ("t_s", np.arange(N).astype("datetime64[s]"), "row 1: t_s is 1970-01-01T00:00:00"),
        ("t_s", np.zeros(N, dtype=[("a", "f8")]), "row 1: t_s is (0"),
        ("q", Q.astype(object), "cannot be read as npz"),
        ("t_s", np.array(["1_0"] * N), "row 1: t_s is 1_0, a number is needed"),
    ],
)  # fmt: skip
def test_npz_of_other_things_than_real_numbers_is_refused_by_row(tmp_path, name, values, words):
    np.savez(tmp_path / "d.npz", **{"q": Q, "p": P, name: values})
    with pytest.raises(BadInput, match=re.escape(words)):
        wb.read_measurements(tmp_path / "d.npz", 2)


def test_names_of_bytes_are_names_and_numbers_may_be_texts(tmp_path):
    names, other = np.array([f"a{k}".encode() for k in range(N)]), P + 1j
    np.savez(tmp_path / "d.npz", q=Q.astype(str), p=P, id=names, unused=other)
    assert wb.read_measurements(tmp_path / "d.npz", 2).ids[:2] == ("a0", "a1")


def test_npz_row_that_is_not_finite_is_named_or_skipped(tmp_path):
    p = P.copy()
    p[3, 1] = np.nan
    np.savez(tmp_path / "d.npz", q=Q, p=p)
    with pytest.raises(BadInput, match="row 4: py is nan, a finite number is needed"):
        wb.read_measurements(tmp_path / "d.npz", 2)
    data = wb.read_measurements(tmp_path / "d.npz", 2, skip_bad=True)
    assert (data.n, len(data.skipped)) == (N - 1, 1)


def test_parquet_with_columns_lists_texts_and_times(tmp_path):
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    stamps = (1_700_000_000_000 + np.round(T * 1e3)).astype("datetime64[ms]")
    table = pyarrow.table({
        "id": [f"p{k}" for k in range(N)], "t_s": stamps, "q": list(Q), "px": P[:, 0], "py": P[:, 1],
        "pz": P[:, 2], "quat_wxyz": list(TURN.as_quat(scalar_first=True)), "split": ["fit", "held"] * 6,
    })  # fmt: skip
    parquet.write_table(table, tmp_path / "d.parquet")
    data = same(wb.read_measurements(tmp_path / "d.parquet", 2))
    assert data.ids[3] == "p3"
    assert list(data.split[:2]) == ["fit", "held"]
    np.testing.assert_allclose(np.diff(data.t_s), np.diff(np.round(T, 3)), atol=1e-6)


def test_broken_parquet_is_refused(tmp_path):
    pytest.importorskip("pyarrow")
    (tmp_path / "d.parquet").write_bytes(b"PAR1 and no more")
    with pytest.raises(BadInput, match="cannot be read as Parquet"):
        wb.read_measurements(tmp_path / "d.parquet", 2)


@pytest.mark.parametrize(
    ("name", "content", "extra"), [("d.parquet", b"PAR1", "data"), ("d.bag", b"#", "ros")]
)
def test_reader_whose_package_is_missing_names_the_extra(tmp_path, monkeypatch, name, content, extra):
    (tmp_path / name).write_bytes(content)
    monkeypatch.setattr("kincal_shared.installation.find_spec", lambda _: None)
    with pytest.raises(BadInput, match=rf"kincal\[{extra}\]"):
        wb.read_measurements(tmp_path / name, 2)


# --------------------------------------------------------------------------- targets on the tool

ON_TOOL = np.array([[0.05, 0.0, 0.01], [-0.03, 0.06, 0.0], [-0.02, -0.05, 0.03]])


def targets_file(path, tool=ON_TOOL, more=None, noise=0.0):
    seen = P[:, None] + np.einsum("nij,kj->nki", TURN.as_matrix(), tool)
    seen = seen + np.random.default_rng(1).normal(0.0, 1.0, seen.shape) * noise
    columns = named(("q1", "q2"), Q)
    for k in range(len(tool)):
        columns |= named((f"X{k + 1}", f"Y{k + 1}", f"Z{k + 1}"), seen[:, k] * 1e3)
    return text_file(path, columns | (more or {}))


def targets_map(k, **more):
    names = [[f"X{i}", f"Y{i}", f"Z{i}"] for i in range(1, k + 1)]
    return mapped(targets={"columns": names, **more}, units={"length": "mm"})


def test_three_targets_of_known_place_are_the_pose_of_the_tool(tmp_path):
    path = targets_file(tmp_path / "d.csv")
    same(wb.read_measurements(path, 2, targets_map(3, tool_m=ON_TOOL.tolist())), atol=1e-12)


def test_three_targets_of_unknown_place_are_a_pose_of_a_frame_fixed_to_the_tool(tmp_path):
    data = wb.read_measurements(targets_file(tmp_path / "d.csv"), 2, targets_map(3))
    assert "tool frame" in data.notes[0]
    got = Rotation.from_quat(data.quat_wxyz, scalar_first=True)
    offset = TURN.inv() * got
    assert (offset[0].inv() * offset).magnitude().max() < 1e-9
    np.testing.assert_allclose(TURN.inv().apply(data.p_m - P), [ON_TOOL.mean(axis=0)] * N, atol=1e-12)


def test_noise_of_the_targets_becomes_the_covariance_of_the_pose(tmp_path):
    sigma = 1e-4
    more = {"sp_m": np.full(N, sigma)}
    data = wb.read_measurements(
        targets_file(tmp_path / "d.csv", more=more), 2, targets_map(3, tool_m=ON_TOOL.tolist())
    )
    rng, scatter = np.random.default_rng(3), []
    R = TURN[0].as_matrix()
    points = ON_TOOL @ R.T + P[0]
    for _ in range(4000):  # what a fit of rigid noisy points gives, by scipy
        seen = points + rng.normal(0.0, sigma, (3, 3))
        turn, _ = Rotation.align_vectors(seen - seen.mean(0), ON_TOOL - ON_TOOL.mean(0))
        p = seen.mean(0) - turn.apply(ON_TOOL.mean(0))
        scatter.append([*(p - P[0]), *(turn * TURN[0].inv()).as_rotvec()])
    np.testing.assert_allclose(np.sqrt(np.diag(data.cov[0])), np.std(scatter, axis=0), rtol=0.05)


@pytest.mark.parametrize("k", [1, 2])
def test_one_or_two_targets_are_a_position(tmp_path, k):
    path = targets_file(tmp_path / "d.csv", ON_TOOL[:k])
    data = wb.read_measurements(path, 2, targets_map(k), infer_direction=False)
    assert data.quat_wxyz is None
    np.testing.assert_allclose(TURN.inv().apply(data.p_m - P), [ON_TOOL[:k].mean(axis=0)] * N, atol=1e-12)
    assert bool(data.notes) == (k == 2)


def test_target_that_moved_on_the_tool_is_refused_by_row(tmp_path):
    path = targets_file(tmp_path / "d.csv")
    lines = path.read_text().splitlines()
    cells = lines[4].split(",")
    cells[2] = str(float(cells[2]) + 20.0)
    path.write_text("\n".join([*lines[:4], ",".join(cells), *lines[5:]]))
    with pytest.raises(BadInput, match=r"line 5: target \d is .* mm from where the tool has it"):
        wb.read_measurements(path, 2, targets_map(3))


def test_targets_on_one_line_do_not_fix_an_orientation(tmp_path):
    line = np.array([[0.0, 0.0, 0.0], [0.05, 0.0, 0.0], [0.1, 0.0, 0.0]])
    path = targets_file(tmp_path / "d.csv", line)
    with pytest.raises(CannotAnswer, match="on one line"):
        wb.read_measurements(path, 2, targets_map(3))


# --------------------------------------------------------------------------- several files


def test_rows_of_several_files_are_one_set(tmp_path):
    a = text_file(tmp_path / "a.csv", {k: v[:5] for k, v in plain(temp_c=np.full(N, 20.0)).items()})
    np.savez(tmp_path / "b.npz", q=Q[5:], p=P[5:], quat_wxyz=TURN[5:].as_quat(scalar_first=True))
    data = same(wb.read_measurements([a, tmp_path / "b.npz"], 2))
    assert data.temp_c is None
    assert any("temp_c is left out" in note and "b.npz" in note for note in data.notes)
    assert len(set(data.ids)) == N
    np.testing.assert_array_equal(data.t_s, np.arange(N))


def test_poses_measured_again_in_another_file_are_replicates(tmp_path):
    a = text_file(tmp_path / "a.csv", plain())
    b = text_file(tmp_path / "b.csv", plain() | named(("px", "py", "pz"), P + 1e-4))
    data = wb.read_measurements([a, b], 2)
    np.testing.assert_array_equal(data.replicate[:N], data.replicate[N:])


def test_same_rows_twice_are_refused(tmp_path):
    a, b = (text_file(tmp_path / name, plain()) for name in ("a.csv", "b.csv"))
    for second in (a, b):
        with pytest.raises(BadInput, match="holds the same rows as"):
            wb.read_measurements([a, second], 2)


def test_split_in_one_of_two_files_is_refused(tmp_path):
    a = text_file(tmp_path / "a.csv", {k: v[:5] for k, v in plain(split=["fit"] * N).items()})
    b = text_file(tmp_path / "b.csv", {k: v[5:] for k, v in plain().items()})
    with pytest.raises(BadInput, match=r"b.csv: has no column split"):
        wb.read_measurements([a, b], 2)


# --------------------------------------------------------------------------- ROS bags


def bag(path, *, names=("elbow", "lift"), late=None, poses_topic="/tracker/pose", two=False):
    """Joint states at 50 Hz that hold every pose for a second, and one pose in the middle of each second."""
    pytest.importorskip("rosbags")
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types
    Time, Header = kinds["builtin_interfaces/msg/Time"], kinds["std_msgs/msg/Header"]
    Point, Quat = kinds["geometry_msgs/msg/Point"], kinds["geometry_msgs/msg/Quaternion"]
    Joint, Stamped = kinds["sensor_msgs/msg/JointState"], kinds["geometry_msgs/msg/PoseStamped"]

    def header(ns, frame=""):
        return Header(stamp=Time(sec=ns // 10**9, nanosec=ns % 10**9), frame_id=frame)

    start = 1_700_000_000 * 10**9
    with Writer(path, version=9) as writer:
        joints = writer.add_connection("/joint_states", Joint.__msgtype__, typestore=store)
        tools = writer.add_connection(poses_topic, Stamped.__msgtype__, typestore=store)
        if two:
            writer.add_connection("/other/pose", Stamped.__msgtype__, typestore=store)
        for k in range(N):
            for tick in range(50):
                ns = start + k * 10**9 + tick * 2 * 10**7
                if k == late and tick > 10:
                    continue
                state = dict(zip(("lift", "elbow", "finger"), (*Q[k], 0.02), strict=True))
                values = np.array([state[name] for name in names])
                message = Joint(header=header(ns), name=list(names), position=values,
                                velocity=np.zeros(len(names)), effort=np.zeros(0))  # fmt: skip
                writer.write(joints, ns, store.serialize_cdr(message, Joint.__msgtype__))
            ns = start + k * 10**9 + 5 * 10**8 + 7 * 10**6
            x, y, z, w = TURN[k].as_quat()
            pose = kinds["geometry_msgs/msg/Pose"](
                position=Point(*P[k]), orientation=Quat(x=x, y=y, z=z, w=w)
            )
            message = Stamped(header=header(ns, "tracker"), pose=pose)
            writer.write(tools, ns + 10**6, store.serialize_cdr(message, Stamped.__msgtype__))
    return path


def ros(**doc):
    return mapped(ros=doc)


def test_bag_gives_a_row_for_each_pose_with_the_nearest_joint_state(tmp_path):
    data = same(wb.read_measurements(bag(tmp_path / "bag"), 2, ros(joint_names=["lift", "elbow"])))
    np.testing.assert_allclose(data.t_s, np.arange(N), atol=1e-6)
    np.testing.assert_array_equal(data.qdot, np.zeros((N, 2)))


def test_bag_takes_the_joints_names_from_the_arm_table(tmp_path):
    table = tmp_path / "arm.toml"
    joint = (
        'type = "revolute"\na_m = 0.1\nalpha_rad = 0\nd_m = 0\nphi_rad = 0\nq_min_rad = -2\nq_max_rad = 2\n'
    )
    table.write_text(
        'convention = "standard"\ngravity_m_s2 = [0, 0, -9.81]\n[base]\nestimate = true\n[tool]\n'
        f'estimate = true\n[[joint]]\nname = "lift"\n{joint}[[joint]]\nname = "elbow"\n{joint}'
    )
    path = bag(tmp_path / "bag", names=("finger", "elbow", "lift"))
    data = same(wb.read_measurements(path, read_arm(table), infer_direction=False))
    assert not data.notes


def test_bag_without_names_says_which_order_it_took(tmp_path):
    data = wb.read_measurements(bag(tmp_path / "bag"), 2)
    np.testing.assert_allclose(data.q, Q[:, ::-1])
    assert "elbow, lift" in data.notes[0]


def test_pose_without_a_joint_state_in_time_is_refused_or_skipped(tmp_path):
    path, chosen = bag(tmp_path / "bag", late=4), ros(joint_names=["lift", "elbow"])
    with pytest.raises(
        BadInput, match=r"pose 5: at 4.000 s has no joint state within 0.02 s \(nearest 0.307 s\)"
    ):
        wb.read_measurements(path, 2, chosen)
    assert wb.read_measurements(path, 2, chosen, skip_bad=True).n == N - 1
    assert wb.read_measurements(path, 2, ros(joint_names=["lift", "elbow"], tolerance_s=0.5)).n == N


@pytest.mark.parametrize(
    ("made", "doc", "words"),
    [
        ({"names": ("finger", "elbow", "lift")}, {}, ["3 joints", "joint_names", "finger, elbow, lift"]),
        ({}, {"joint_names": ["lift", "elbo"]}, ["no joint 'elbo'", "did you mean elbow"]),
        ({}, {"joint_names": ["lift"]}, ["1 names", "2 joints"]),
        ({}, {"pose_topic": "/tracker/poses"}, ["no topic /tracker/poses", "did you mean /tracker/pose"]),
        ({"two": True}, {}, ["2 topics", "pose_topic", "/other/pose, /tracker/pose"]),
    ],
)
def test_bag_that_does_not_say_what_is_meant_is_refused(tmp_path, made, doc, words):
    with pytest.raises(BadInput) as error:
        wb.read_measurements(bag(tmp_path / "bag", **made), 2, ros(**doc))
    for word in words:
        assert word in str(error.value)


def test_folder_or_file_that_is_no_bag_is_refused(tmp_path):
    pytest.importorskip("rosbags")
    with pytest.raises(BadInput, match="no ROS 2 bag"):
        wb.read_measurements(tmp_path, 2)
    (tmp_path / "metadata.yaml").write_text("no: bag\n")
    with pytest.raises(BadInput, match="cannot be read as a ROS bag"):
        wb.read_measurements(tmp_path, 2)
    (tmp_path / "d.bag").write_text("no bag")
    with pytest.raises(BadInput, match="cannot be read as a ROS bag"):
        wb.read_measurements(tmp_path / "d.bag", 2)


# --------------------------------------------------------------------------- commands


@pytest.fixture(scope="module")
def foreign(tmp_path_factory):
    """The arm, its poses in KinCal's columns, and the same poses in somebody else's."""
    folder = tmp_path_factory.mktemp("foreign")
    arm = poses.arm_toml(folder / "arm.toml")
    path = poses.poses_csv(folder / "own.csv", 40, 7)
    data = wb.read_csv(path, 7)
    columns = {
        **named([f"A{j}" for j in range(1, 8)], np.degrees(data.q)),
        **named(("X", "Y", "Z"), data.p_m * 1e3),
        **named(("i", "j", "k", "s"), np.roll(data.quat_wxyz, -1, axis=1)),
    }
    text_file(folder / "other.csv", columns, separator=";", decimal=",")
    text = path.read_text().splitlines()
    header = text[0].split(",")
    keep = [header.index(n) for n in header if n[0] in "pq" and n[1:] in [*"1234567xyzw"]]
    bare = [",".join(line.split(",")[k] for k in keep) for line in text if not line.startswith("#")]
    (folder / "bare.csv").write_text("\n".join(bare) + "\n")
    (folder / "map.toml").write_text(
        '[columns]\nq = "A{}"\np = ["X", "Y", "Z"]\n[units]\nangle = "deg"\nlength = "mm"\n'
        '[rotation]\nform = "xyzw"\ncolumns = ["i", "j", "k", "s"]\n'
    )
    both = (folder / "map.toml").read_text().replace('p = ["X", "Y", "Z"]', "")
    (folder / "both.toml").write_text(both + '[targets]\ncolumns = [["X", "Y", "Z"]]\n')
    return folder, arm


def compare(*args):
    return kincal("compare", "--json", *args)


FLAGS = ("--column", "q=A{}", "--column", "p=X,Y,Z", "--units", "deg,mm", "--rotation", "xyzw=i,j,k,s")


def test_foreign_columns_by_map_or_by_options_give_the_answer_of_our_own(foreign):
    folder, arm = foreign
    want = json.loads(compare("--arm", arm, "--data", folder / "bare.csv").stdout)
    for options in (("--map", folder / "map.toml"), FLAGS):
        got = json.loads(compare("--arm", arm, "--data", folder / "other.csv", *options).stdout)
        assert got["rms"]["held"]["pos_mm"] == pytest.approx(want["rms"]["held"]["pos_mm"], rel=1e-6)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--units", "deg,inch"), ["'inch'", "rad, deg"]),
        (("--column", "q"), ["--column q", "q=joint_{}"]),
        (("--column", "joint=A{}"), ["columns.joint"]),
        (("--rotation", "euler=i,j,k"), ["axes"]),
        (("--rotation", "xywz=i,j,k,s"), ["rotation.form", "xyzw"]),
        (("--map", "nothing.toml"), ["nothing.toml", "no such file"]),
        ((), ["q1, q2", "--column", "A1, A2"]),
        (("--map", "both"), ["[rotation] and [targets]"]),
    ],
)
def test_wrong_options_are_refused_with_a_remedy(foreign, options, words):
    folder, arm = foreign
    options = [str(folder / "both.toml") if word == "both" else word for word in options]
    done = compare("--arm", arm, "--data", folder / "other.csv", *options)
    assert done.exit_code == 2
    for word in words:
        assert word in done.stderr


def test_notes_and_unused_columns_are_said_on_stderr(foreign):
    folder, arm = foreign
    done = compare("--arm", arm, "--data", folder / "other.csv", *FLAGS[:6])
    json.loads(done.stdout)
    assert "columns not used: i, j, k, s" in done.stderr
