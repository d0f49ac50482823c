"""Wrong inputs of the workbench: each ends with status 2 or 3 and words that name the likely cause."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import subprocess
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import poses
import pytest
from commands import good, kincal, shell

from kincal.arms.library import arm_text
from kincal.cli.errors import EXIT_DATA, EXIT_FAILED, EXIT_INPUT
from kincal.workbench.data.readers import read_measurements
from kincal_shared import reading
from kincal_shared.errors import BadInput
from kincal_shared.schema.arm import read_arm

Q = [f"q{j}" for j in range(1, 8)]
P, QUAT = ["px", "py", "pz"], ["qw", "qx", "qy", "qz"]
JOINT = """
[[joint]]
type = "revolute"
a_m = 0.1
alpha_rad = 0.0
d_m = 0.0
phi_rad = 0.0
q_min_rad = -3.0
q_max_rad = 3.0
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """arm.toml and poses.csv that belong together."""
    poses.arm_toml(tmp_path / "arm.toml", masses=False)
    poses.poses_csv(tmp_path / "poses.csv", 40, 5)
    _table(tmp_path, _keep(["id", *Q, *P, *QUAT]))
    return tmp_path


def _table(folder: Path, change: Callable[[list[dict[str, str]]], list[dict[str, str]]]) -> None:
    """Rewrites poses.csv."""
    path = folder / "poses.csv"
    with path.open(newline="") as file:
        rows = change(list(csv.DictReader(file)))
    with path.open("w", newline="") as file:
        out = csv.DictWriter(file, list(rows[0]))
        out.writeheader()
        out.writerows(rows)


def _keep(names):
    return lambda rows: [{name: row[name] for name in names} for row in rows]


def rows(change):
    """A wrong measurements file: every row changed."""
    return lambda folder: _table(folder, lambda found: [change(dict(row)) for row in found])


def renamed(names):
    return rows(lambda row: {names.get(key, key): value for key, value in row.items()})


def scaled(names, factor):
    return rows(lambda row: row | {name: repr(float(row[name]) * factor) for name in names})


def scaled_rows(numbers, names, factor):
    def change(found):
        for k in numbers:
            found[k] |= {name: repr(float(found[k][name]) * factor) for name in names}
        return found

    return lambda folder: _table(folder, change)


def added(**columns):
    return rows(lambda row: row | columns)


def cell(number, name, value):
    def change(found):
        found[number][name] = value
        return found

    return lambda folder: _table(folder, change)


def without(*names):
    return rows(lambda row: {key: value for key, value in row.items() if key not in names})


def exchanged(*names):
    """Values of the columns moved to the next one in the list."""
    return renamed(dict(zip(names, (*names[1:], names[0]), strict=True)))


def arm(pattern, new, count=1):
    """A wrong arm table."""

    def change(folder):
        path = folder / "arm.toml"
        text, found = re.subn(pattern, new, path.read_text(), count=count)
        assert found, pattern
        path.write_text(text)

    return change


def arm_file(text):
    return lambda folder: (folder / "arm.toml").write_text(text)


def unknown_frames(text):
    """An arm table with both frames to be estimated."""
    return lambda folder: (folder / "arm.toml").write_text(
        text.replace("estimate = false", "estimate = true")
    )


def content(data, name="poses.csv"):
    return lambda folder: (folder / name).write_bytes(data)


def doubled(folder):
    path = folder / "poses.csv"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines, *lines[1:]]) + "\n")


def inverted(row):
    """The base seen from the tool."""
    turn = poses.Rotation.from_quat([float(row[name]) for name in (*QUAT[1:], QUAT[0])]).inv()
    p = -turn.apply([float(row[name]) for name in P])
    x, y, z, w = turn.as_quat()
    return row | dict(zip((*P, *QUAT), map(str, (*p, w, x, y, z)), strict=True))


def covariance(variance):
    return added(**{f"c{i}{j}": repr(variance * (i == j)) for i in range(1, 7) for j in range(i, 7)})


def unrelated(folder):
    """Poses in another order than their readings."""

    def change(found):
        mixed = np.random.default_rng(3).permutation(len(found))
        return [
            row | {name: found[k][name] for name in (*P, *QUAT)} for row, k in zip(found, mixed, strict=True)
        ]

    _table(folder, change)


def late(folder):
    """Each reading one row too late."""
    _table(
        folder,
        lambda found: [
            row | {name: other[name] for name in Q} for row, other in zip(found[1:], found[:-1], strict=True)
        ],
    )


def truncated_npz(folder):
    path = folder / "whole.npz"
    np.savez(path, q=np.zeros((20, 7)), p=np.zeros((20, 3)))
    (folder / "poses.csv").write_bytes(path.read_bytes()[:900])


def semicolons_with_both(folder):
    path = folder / "poses.csv"
    lines = path.read_text().splitlines()
    lines = [line.replace(",", ";") for line in lines]
    lines[3] = lines[3].replace(".", ",")
    path.write_text("\n".join(lines) + "\n")


def directory(name):
    def change(folder):
        (folder / name).unlink()
        (folder / name).mkdir()

    return change


def gone(name):
    return lambda folder: (folder / name).unlink()


def mirrored(*axes, turns=False):
    """Positions with an axis reversed; turns: the orientations in that mirror too."""
    mirror = np.diag([-1.0 if name in axes else 1.0 for name in P])

    def change(row):
        p = mirror @ [float(row[name]) for name in P]
        out = dict(zip(P, map(str, p), strict=True))
        if turns:
            turn = poses.Rotation.from_quat([float(row[name]) for name in (*QUAT[1:], QUAT[0])])
            seen = poses.Rotation.from_matrix(mirror @ turn.as_matrix() @ mirror).as_quat()
            out |= dict(zip((*QUAT[1:], QUAT[0]), map(str, seen), strict=True))
        return row | out

    return rows(change)


def other_arm(folder):
    """Poses of an arm whose links are 0.1 m and 0.3 rad off (one sigma each)."""
    poses.poses_csv(folder / "poses.csv", 40, 5, dh_size=0.3)
    _table(folder, _keep(["id", *Q, *P, *QUAT]))


WRONG = {
    # the arm table
    "alpha in degrees": (arm(r"alpha_rad = 1\.57\d*", "alpha_rad = 90"), ["alpha_rad", "degrees"]),
    "key for degrees": (arm(r"alpha_rad = 1\.57\d*", "alpha_deg = 90"), ["alpha_rad", "radians"]),
    "limits in degrees": (arm(r"q_max_rad = 2\.6", "q_max_rad = 150"), ["limit of joint 1", "degrees"]),
    "links in millimetres": (
        arm(r"d_m = ([1-9.0]+)", lambda m: f"d_m = {1e3 * float(m[1])}", 0), ["arm table", "millimetres"],
    ),
    "one link in millimetres": (arm(r"d_m = 0\.55", "d_m = 550.0"),
                                ["millimetres for d_m of joint 3 (550), in metres for the others",
                                 "write metres: joint[3].d_m = 0.55"]),
    "a short link in millimetres": (arm(r"a_m = 0\.045", "a_m = 45.0"), ["joint[3].a_m = 0.045"]),
    "all a in millimetres": (arm(r"(\ba_m = -?)0\.045", r"\g<1>45.0", 0),
                             ["joint[3].a_m = 0.045, joint[4].a_m = -0.045"]),
    "unknown key": (arm(r"phi_rad = 0\.0", "phi_rad = 0.0\nthete_rad = 0.0"), ["thete_rad", "unknown key"]),
    "synonym": (arm("phi_rad", "theta_rad"), ["theta_rad", "phi_rad"]),
    "no convention": (arm("convention.*", ""), ["convention", "missing"]),
    "unknown convention": (arm('"standard"', '"craig"'), ["convention", "modified"]),
    "other convention": (arm('"standard"', '"modified"'), ["DH parameters look standard"]),
    "another shipped arm": (unknown_frames(arm_text("iiwa7")), ["wam", "--arm wam"]),
    "gear ratio of 0": (arm(r"gear_ratio = .*", "gear_ratio = 0"),
                        ["joint[1].gear_ratio", "is 0", "leave gear_ratio out"]),
    "a number of 5000 digits": (arm(r"d_m = 0\.0", "d_m = " + "9" * 5000), ["arm.toml", "too many digits"]),
    "20000 nested lists": (arm(r"$", "\nx = " + "[" * 20000), ["arm.toml", "nested too deeply"]),
    "another arm": (other_arm, ["wrong arm table"]),
    "one joint too many": (lambda f: arm(r"$", JOINT)(f), ["q8", "missing"]),
    "12 joints": (lambda f: arm(r"$", JOINT * 5)(f), ["q8", "q12", "missing"]),
    "one joint too few": (arm(r"\[\[joint\]\][^\[]*$", ""),
                          ["q7", "6 joints", "to do", "--arm", "--column q=q1,q2,q3,q4,q5,q6"]),
    "revolute as prismatic": (arm(r'type = "revolute"', 'type = "prismatic"'), ["joint 1 seems revolute"]),
    "base frame of another place": (arm(r"xyz_m = \[0.0, 0.0, 0.346\]", "xyz_m = [0.5, -0.4, 0.9]"),
                                    ["base or tool frame"]),
    "quaternion of norm 2": (arm(r"quat_wxyz = \[1.0", "quat_wxyz = [2.0"), ["quat_wxyz", "norm"]),
    "text for a number": (arm(r"a_m = 0\.0", 'a_m = "wide"'), ["a_m", "wide"]),
    "arm table no TOML": (arm_file("name: WAM\njoints: 7\n"), ["arm.toml", "not valid TOML"]),
    "arm table of bytes": (content(bytes(range(128, 256)), "arm.toml"),
                           ["arm.toml", "does not look like text"]),
    "arm table a directory": (directory("arm.toml"), ["arm.toml", "directory"]),
    "arm table of Windows": (content("name = 'é'\n".encode("cp1252"), "arm.toml"),
                             ["line 1", "Windows-1252 the line reads: name = 'é'", "iconv -f cp1252"]),
    "arm table a xacro": (arm_file('<?xml version="1.0"?>\n<robot xmlns:xacro="x"><xacro:include/></robot>'),
                          ["xacro FILE > robot.urdf", "kincal arm import robot.urdf"]),
    "arm table a URDF": (arm_file('<robot name="r"/>'), ["is a URDF", "kincal arm import FILE"]),
    "gravity in millimetres": (arm(r"-9\.81", "-9810.0"), ["gravity_m_s2", "9810", "m/s^2"]),
    "a link of 1e300 m": (arm(r"d_m = 0\.3", "d_m = 1e300"), ["d_m", "is 1e+300", "1e+07 or less"]),
    "alpha of the other sign": (arm(r"alpha_rad = (1\.57\d*\nd_m = 0\.0)", r"alpha_rad = -\1"),
                                ["alpha of joint 2", "other sign"]),
    "quaternion of the base x, y, z, w": (arm(r"\[1.0, 0.0, 0.0, 0.0\]", "[0.0, 0.0, 0.0, 1.0]"),
                                          ["quat_wxyz of [base]", "x, y, z, w", "scalar part first"]),
    "no arm table": (gone("arm.toml"), ["arm.toml", "no such file"]),
    # the measurements
    "empty file": (content(b""), ["is empty", "q1..q7"]),
    "header only": (content(",".join([*Q, *P]).encode() + b"\n"), ["no usable row"]),
    "a directory": (directory("poses.csv"), ["poses.csv", "folder"]),
    "no file": (gone("poses.csv"), ["poses.csv", "no such file"]),
    "bytes": (content(bytes(range(128, 256)) * 9), ["poses.csv", "does not look like text"]),
    "UTF-16": (content("q1,q2\n1,2\n".encode("utf-16")), ["poses.csv", "UTF-16", "UTF-8", "iconv -f utf-16"]),
    "UTF-16 without a mark": (content("q1,q2\n1,2\n".encode("utf-16-le")),
                              ["poses.csv", "UTF-16LE", "UTF-8", "iconv -f utf-16le"]),
    "UTF-16 of the other order": (content("q1,\u00b0\n1,2\n".encode("utf-16-be")), ["iconv -f utf-16be"]),
    "an arm table in UTF-16": (content("a = 'a'\n".encode("utf-16-le"), "arm.toml"), ["iconv -f utf-16le"]),
    "a name with what is not shown": (renamed({"q2": "q2\u200b"}),
                                      ["line 1", "column 3, q2\\u200b, holds U+200B", "write q2 without it"]),
    "a mark in the name of the ids": (renamed({"id": "i\ufeffd"}), ["column 1, i\\ufeffd, holds U+FEFF"]),
    "a time with what is not shown": (added(**{"t_s\u00ad": "1"}), ["t_s\\xad, holds U+00AD"]),
    "a number with what is not shown": (cell(3, "q2", "0.5\u200b"),
                                        ["line 5", "q2 is 0.5\\u200b", "holds U+200B", "take it out"]),
    "a minus sign of print": (cell(3, "q2", "\u22120.5"),
                              ["line 5", "q2 is \u22120.5", "sign is U+2212", "- of the keyboard"]),
    "a split with what is not shown": (added(split="fit\u200b"), ["line 2", "split is fit\\u200b"]),
    "Windows-1252": (content("q1,T in °C\n1,2\n".encode("cp1252")),
                     ["poses.csv", "line 1", "q1,T in °C", "iconv -f cp1252 -t utf-8 poses.csv"]),
    "a position of 1e300 m": (cell(3, "py", "1e300"), ["line 5", "py is 1e+300 m", "up to 1e+07"]),
    "counts of an encoder": (cell(3, "q2", "1e12"), ["line 5", "q2 is 1e+12", "counts of an encoder"]),
    "gravity in the data in millimetres": (added(gx="0", gy="0", gz="-9810"),
                                           ["line 2", "gz is -9810", "mm/s^2"]),
    "a value of 140000 letters": (cell(3, "id", "x" * 140000), ["line 5", "characters", "--skip-bad"]),
    "a header without an end": (content(b"q" * 140000), ["line 1", "140000 characters"]),
    "underscore in a number": (cell(3, "q2", "1_0"), ["line 5", "q2 is 1_0, a number is needed"]),
    "digits of another script": (cell(3, "q2", "\u0661.\u0665"), ["line 5", "q2 is", "a number is needed"]),
    "mass below 0": (added(payload_kg="-2"), ["line 2", "payload_kg is -2 kg, 0 or more is needed"]),
    "distance below 0": (added(range_m="-2"), ["line 2", "range_m is -2 m"]),
    "below absolute zero": (added(temp_c="-300"), ["line 2", "temp_c is -300 deg C", "absolute zero"]),
    "tag 7": (added(tag="7"), ["line 2", "tag is 7, up to 1"]),
    "a time of 1e300 s": (added(t_s="1e300"), ["line 2", "t_s is 1e+300 s"]),
    "half a replicate": (added(replicate="1.5"), ["line 2", "replicate is 1.5, a whole number"]),
    "a group of unrelated poses": (added(replicate="7"),
                                   ["line 3", "replicate 7", "differs by", "one commanded pose"]),
    "replicate 1e300": (added(replicate="1e300"), ["line 2", "replicate is 1e+300"]),
    "noise whose square is 0": (added(sp_m="1e-300", sr_rad="0.001"), ["line 2", "sp_m is 1e-300 m"]),
    "noise whose square is infinite": (added(sp_m="0.001", sr_rad="1e300"), ["line 2", "sr_rad is 1e+300"]),
    "covariance of no instrument": (covariance(1e-40), ["line 2", "c11..c66", "of no instrument"]),
    "truncated npz": (truncated_npz, ["cannot be read as npz"]),
    "not a number": (cell(3, "py", "nan"), ["line 5", "py"]),
    "text in a number": (cell(3, "q2", "approx 3"), ["line 5", "q2", "approx 3"]),
    "decimal commas and points": (semicolons_with_both, ["decimal commas", "decimal points"]),
    "missing column": (without("q4"), ["q4", "missing"]),
    "joints from q0 on": (renamed({f"q{j}": f"q{j - 1}" for j in range(1, 8)}),
                          ["q7 missing", "count from 1: q1..q7", "--column q=q0,q1,q2,q3,q4,q5,q6"]),
    "a joint q0 too many": (added(q0="0.1"), ["has column q0, but", "has 7 joints", "--column q=q1,"]),
    "directions from dir0 on": (added(**{f"dir{j}": "1" for j in range(7)}),
                                ["lacks dir7", "count from 1: dir1..dir7", "--column dir=dir0,dir1,dir2"]),
    "part of the quaternion": (without("qz"), ["lacks qz"]),
    "negative sigma": (added(sp_m="-0.001", sr_rad="0.001"), ["sp_m is -0.001"]),
    "noise in millimetres": (added(sp_m="0.6", sr_rad="0.001"), ["stated noise", "millimetres"]),
    "noise of 0.05 mm in millimetres": (added(sp_m="0.05", sr_rad="0.001"),
                                        ["noise is 0.05 m", "leaves", "millimetres", "sp_m in metres"]),
    "unknown split": (added(split="train"), ["split is train"]),
    "direction of 2": (added(**{f"dir{j}": "2" for j in range(1, 8)}), ["dir1", "-1, 0 or +1"]),
    "degrees": (scaled(Q, 180.0 / np.pi), ["degrees", "--units deg"]),
    "some rows in millimetres": (scaled_rows([6, 11, 30], P, 1e3), ["3 of 40 poses look like millimetres",
                                 "ids p6, p11, p30", "--exclude p6,p11,p30"]),
    "most rows in millimetres": (scaled_rows(range(4, 40), P, 1e3), ["36 of 40 poses look like millimetres",
                                 "the others like metres: ids p0, p1, p2, p3;", "--units mm"]),
    "some rows in degrees": (scaled_rows([6, 11, 30], Q, 180.0 / np.pi), ["3 of 40 poses look like degrees",
                             "ids p6, p11, p30"]),
    "most rows in degrees": (scaled_rows(range(4, 40), Q, 180.0 / np.pi), ["36 of 40 poses look like degrees",
                             "the others like radians: ids p0, p1, p2, p3;"]),
    "one joint in degrees": (scaled(["q3"], 180.0 / np.pi), ["readings of joint 3 seem to be in degrees",
                             "multiply q3 by pi/180"]),
    "two joints in degrees": (scaled(["q2", "q4"], 180.0 / np.pi), ["joint 2, 4 seem to be in degrees"]),
    "one coordinate in millimetres": (scaled(["pz"], 1e3), ["pz of the measured positions", "divide pz"]),
    "millimetres": (scaled(P, 1e3), ["millimetres", "--units mm"]),
    "two readings exchanged": (exchanged("q2", "q4"), ["joints 2 and 4 seem exchanged"]),
    "readings in another order": (exchanged("q1", "q3", "q4", "q6"), ["another order"]),
    "sign of one joint": (scaled(["q2"], -1.0), ["joint 2 counts the other way"]),
    "signs of three joints": (scaled(["q1", "q4", "q6"], -1.0), ["joints 1, 4, 6 count the other way"]),
    "one axis mirrored": (mirrored("py"), ["left-handed", "y is reversed", "change the sign of py"]),
    "two axes exchanged": (exchanged("px", "py"),
                           ["left-handed", "x and y are exchanged", "exchange px and py"]),
    "poses in a mirror": (mirrored("py", turns=True),
                          ["left-handed", "y is reversed", "orientations in the same",
                           "sign of joints 1, 3, 5, 7, which looks the same"]),
    "quaternion x, y, z, w": (exchanged("qw", "qz", "qy", "qx"), ["x, y, z, w"]),
    "poses inverted": (rows(inverted), ["poses look inverted"]),
    "orientations inverted": (scaled(["qx", "qy", "qz"], -1.0), ["orientations look inverted"]),
    "readings a row late": (late, ["the row"]),
    "poses of other rows": (unrelated, ["do not belong to these readings"]),
    "doubled file": (doubled, ["looks doubled"]),
    "doubled file without names": (lambda f: (without("id")(f), doubled(f)), ["looks doubled"]),
    "one name for two poses": (cell(3, "id", "p7"), ["'p7'", "2 times"]),
    "one pose": (lambda f: _table(f, lambda found: found[:1]), ["poses"]),
}  # fmt: skip


def compare(*args):
    return kincal("compare", *args)


def given(folder):
    return "--arm", folder / "arm.toml", "--data", folder / "poses.csv"


def on(folder, *more):
    return compare(*given(folder), *more)


def test_the_inputs_belong_together_before_they_are_spoilt(folder):
    done = on(folder)
    assert done.exit_code == 0
    assert "warning" not in done.stderr


@pytest.mark.parametrize("case", WRONG)
def test_wrong_input_names_the_likely_cause(folder, case):
    spoil, words = WRONG[case]
    spoil(folder)
    done = on(folder)
    assert done.exit_code in (EXIT_INPUT, EXIT_DATA), done.output
    assert done.stdout == ""
    for word in words:
        assert word in done.stderr


STREAMS = {
    "a pipe that nobody writes into": (
        os.mkfifo,
        {"--data": "is a pipe, but", "": "that nobody writes into"},
    ),
    "a device": (lambda path: path.symlink_to("/dev/zero"), {"": "is a device, a file is needed"}),
}


@pytest.mark.parametrize("stream", STREAMS)
@pytest.mark.parametrize("option", ["--arm", "--data", "--model", "--map", "--effects"])
def test_what_has_no_end_is_refused_and_not_waited_for(folder, monkeypatch, stream, option):
    monkeypatch.setattr(reading, "_PATIENCE_MS", 10)
    make, words = STREAMS[stream]
    make(folder / "stream")
    given = {"--arm": folder / "arm.toml", "--data": folder / "poses.csv", option: folder / "stream"}
    done = compare(*(word for pair in given.items() for word in pair))
    assert done.exit_code == EXIT_INPUT
    assert words.get(option, words[""]) in done.stderr
    assert f"where: {folder / 'stream'}" in done.stderr


@pytest.mark.parametrize("wait_s", [0.0, 0.3])
def test_a_pipe_that_somebody_writes_into_is_read_to_its_end(folder, wait_s):
    """Also by a writer that is slow to begin."""
    pipe, text = folder / "pipe", (folder / "arm.toml").read_text()
    os.mkfifo(pipe)

    def write():
        with pipe.open("w") as out:
            time.sleep(wait_s)
            out.write(text)
            out.flush()
            time.sleep(wait_s)
            out.write("#" * 200_000)

    with ThreadPoolExecutor() as pool:
        writer = pool.submit(write)
        assert read_arm(pipe).n == 7
        writer.result()


def test_a_pipe_without_an_end_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(reading, "_MOST_BYTES", 1 << 20)
    os.mkfifo(tmp_path / "pipe")
    with subprocess.Popen(f"exec cat /dev/zero > '{tmp_path / 'pipe'}'", shell=True) as writer:
        with pytest.raises(BadInput, match="up to 1 MiB are read from a pipe"):
            read_arm(tmp_path / "pipe")
        writer.kill()


@pytest.mark.parametrize("read", ["wxyz=qx,qy,qz,qw", "xyzw=qw,qx,qy,qz"])
def test_the_other_order_of_quaternions_is_named_whatever_was_said(folder, read):
    done = on(folder, "--rotation", read)
    assert done.exit_code == EXIT_INPUT
    form, _, columns = read.partition("=")
    other = {"wxyz": "xyzw", "xyzw": "wxyz"}[form]
    assert f"quaternions look like {', '.join(other)}" in done.stderr
    advice = f"{other}={columns}"  # as the message says it: the same columns in the same order
    right = on(folder, "--rotation", advice)
    assert right.exit_code == 0, right.stderr


def test_a_file_with_two_byte_order_marks_keeps_its_ids(folder):
    path = folder / "poses.csv"
    path.write_bytes(b"\xef\xbb\xbf" * 2 + path.read_bytes())
    assert read_measurements(path, 7).ids[0] == "p0"


def test_columns_and_ids_with_what_is_not_shown_are_named_so_that_it_is(folder):
    added(**{"force\u200b": "1"})(folder)
    cell(3, "id", "p3\u200b")(folder)
    data = read_measurements(folder / "poses.csv", 7)
    assert data.unknown_columns == ("force\\u200b",)
    with pytest.raises(BadInput, match=r"p2, p3\\u200b, p4"):
        data.without(["p3"])


def test_a_pattern_of_columns_that_count_from_0_is_answered_with_their_list(folder):
    renamed({f"q{j}": f"Joint {j - 1}" for j in range(1, 8)})(folder)
    done = on(folder, "--column", "q=Joint {}")
    assert done.exit_code == EXIT_INPUT
    listed = "q=" + ",".join(f"Joint {j}" for j in range(7))
    assert f"{{}} counts from 1: write --column '{listed}'" in done.stderr
    assert on(folder, "--column", listed).exit_code == 0


def with_euler(folder, axes, scale=1.0):
    """Orientations as Euler angles in columns A, B, C."""

    def change(row):
        turn = poses.Rotation.from_quat([float(row[name]) for name in (*QUAT[1:], QUAT[0])])
        angles = dict(zip("ABC", map(str, scale * turn.as_euler(axes)), strict=True))
        return {name: value for name, value in row.items() if name not in QUAT} | angles

    rows(change)(folder)


@pytest.mark.parametrize(
    ("is_", "said", "frames"),
    [("ZYX", "XYZ", "known"), ("xyz", "XYZ", "known"), ("ZYZ", "ZYX", "known"), ("xyz", "ZYX", "unknown")],
)
def test_the_order_of_euler_angles_is_named(folder, is_, said, frames):
    with_euler(folder, is_)
    if frames == "unknown":
        arm(r"(quat_wxyz = .*)", r"\1\nestimate = true", 0)(folder)
    done = on(folder, "--rotation", f"euler-{said}=A,B,C")
    assert done.exit_code == EXIT_INPUT
    assert f"Euler angles look like {is_}" in done.stderr
    assert f"--rotation euler-{is_}=A,B,C" in done.stderr
    assert on(folder, "--rotation", f"euler-{is_}=A,B,C").exit_code == 0


def test_euler_angles_in_degrees_beside_readings_in_radians_are_named(folder):
    with_euler(folder, "ZYX", 180.0 / np.pi)
    done = on(folder, "--rotation", "euler-ZYX=A,B,C")
    assert done.exit_code == EXIT_INPUT
    assert "Euler angles look like degrees" in done.stderr


def test_three_poses_say_nothing_of_the_arm_and_are_not_called_right(folder):
    _table(folder, lambda found: found[:3])
    done = shell("model", "check", "--arm", folder / "arm.toml", "--data", folder / "poses.csv")
    assert done.exit_code == EXIT_FAILED
    assert "cannot be compared" in done.stdout and "belong together" not in done.stdout
    assert "3 poses are too few" in done.stdout


def test_a_folder_with_the_name_of_a_shipped_arm_is_no_arm_table(folder, monkeypatch):
    monkeypatch.chdir(folder)
    (folder / "ur5").mkdir()
    (folder / "M.toml").write_text('version = 1\narm = "ur5"\n')
    done = compare("--arm", "arm.toml", "--data", "poses.csv", "--model", "M.toml")
    assert "made with" in done.stderr and "(ur5)" in done.stderr
    scaled(["q2"], -1.0)(folder)  # so that the shipped arms are looked at
    done = compare("--arm", "arm.toml", "--data", "poses.csv")
    assert "joint 2 counts the other way" in done.stderr
    assert read_arm("ur5").n == 6


@pytest.mark.parametrize(
    "names", [["joint_compliance[9]"], ["joint_compliance[2,7]"], ["backlash[7]", "base_flex"]]
)
def test_an_effect_at_a_joint_that_the_arm_lacks_is_refused(folder, names):
    model = folder / "M.toml"
    add = ["model", "add", "--model", str(model)]
    done = shell(*add, "--arm", "ur5", *names)
    assert done.exit_code == EXIT_INPUT
    assert "has 6 joints, there is no joint" in done.stderr and "from 1 to 6" in done.stderr
    assert not model.exists()
    model.write_text('version = 1\narm = "ur5"\n')  # fitted with it
    assert shell(*add, *names).exit_code == EXIT_INPUT
    assert "effects" not in model.read_text()
    far = shell("model", "add", "--model", folder / "N.toml", "backlash[17]")
    assert far.exit_code == EXIT_INPUT and "up to 16 joints" in far.stderr


def test_measurements_without_their_arm_do_not_let_joints_pass(folder):
    """Of six joints, say: nothing would refuse joint 7 before the fit."""
    model = folder / "M.toml"
    done = shell("model", "add", "--model", model, "--data", folder / "poses.csv", "backlash[8]")
    assert done.exit_code == EXIT_INPUT and "name it by --arm" in done.stderr
    assert not model.exists()


def test_a_joint_that_few_arms_have_is_refused_until_the_arm_is_named(folder):
    model = folder / "M.toml"
    add = ["model", "add", "--model", str(model)]
    done = shell(*add, "backlash[2]", "joint_compliance[9]")
    assert done.exit_code == EXIT_INPUT and not model.exists()
    assert "joint_compliance[9]: the model does not say yet which arm it is for" in done.stderr
    assert "name the arm table by --arm" in done.stderr
    arm("$", JOINT * 5)(folder)  # 12 joints
    done = good(*add, "--arm", folder / "arm.toml", "joint_compliance[9]")
    assert shell(*add, "backlash[12]").exit_code == 0  # the model knows its arm now
    done = shell(*add, "backlash[13]")
    assert done.exit_code == EXIT_INPUT and "has 12 joints, there is no joint 13" in done.stderr
    done = shell(*add, "--arm", "ur5e", "joint_compliance[3]")
    assert done.exit_code == EXIT_INPUT and "this model was made with WAM" in done.stderr


@pytest.mark.parametrize(
    "name", ["backlash[\u00b2]", "backlash[\u0662]", f"backlash[{'9' * 5000}]", "bias_step[3](t0=1_2)"]
)
def test_numbers_in_names_are_plain(folder, name):
    done = shell("model", "add", "--model", folder / "M.toml", name)
    assert done.exit_code == EXIT_INPUT
    assert "write b" in done.stderr
    assert not (folder / "M.toml").exists()


def test_a_fit_names_the_joint_before_what_the_effect_needs(folder):
    (folder / "M.toml").write_text('version = 1\neffects = ["joint_compliance[9]"]\n')
    done = shell("model", "fit", *given(folder), "--model", folder / "M.toml")
    assert done.exit_code == EXIT_INPUT and "there is no joint 9" in done.stderr


def test_same_file_twice_is_refused(folder):
    path = folder / "poses.csv"
    shutil.copy(path, folder / "copy.csv")
    done = on(folder, "--data", folder / "copy.csv")
    assert done.exit_code == EXIT_INPUT
    assert "same rows" in done.stderr


def test_two_files_of_different_arms_are_refused(folder):
    """The second file is of an arm with another order of the joints."""
    shutil.copy(folder / "poses.csv", folder / "first.csv")
    poses.poses_csv(folder / "poses.csv", 40, 6)
    _table(folder, _keep(["id", *Q, *P, *QUAT]))
    exchanged(*Q)(folder)
    done = compare(
        "--arm", folder / "arm.toml", "--data", folder / "first.csv", "--data", folder / "poses.csv"
    )
    assert done.exit_code == EXIT_INPUT
    assert "do not belong" in done.stderr


@pytest.mark.parametrize("command", ["compare", "diagnose", "fit"])
def test_a_model_of_another_arm_is_refused(folder, command):
    values = "\n".join(f'[[value]]\nname = "J{j}.a_m"\nvalue = 0.0\nstd_err = 0.0' for j in range(1, 7))
    (folder / "M.toml").write_text(f"version = 1\neffects = []\n{values}\n")
    done = shell("model", command, *given(folder), "--model", folder / "M.toml")
    assert done.exit_code == EXIT_INPUT
    assert "6 joints" in done.stderr and "7 joints" in done.stderr


def test_a_model_fitted_with_other_dh_parameters_is_refused(folder):
    (folder / "M.toml").write_text('version = 1\narm = "iiwa7"\n')
    done = on(folder, "--model", folder / "M.toml")
    assert done.exit_code == EXIT_INPUT
    assert "iiwa7" in done.stderr


def test_force_goes_on_and_keeps_the_doubt_in_the_answer(folder):
    scaled(["q7"], -1.0)(folder)
    assert on(folder).exit_code == EXIT_INPUT
    done = on(folder, "--force", "--json")
    assert done.exit_code == 0
    assert any("joint 7 counts the other way" in note for note in json.loads(done.stdout)["notes"])
    assert "warning: joint 7" in done.stderr


def far_away_and_once_lost(folder):
    """A tracker 50 m away, which once gave zeros."""
    unknown_base = arm(r"(quat_wxyz = .*)", r"\1\nestimate = true")
    unknown_base(folder)
    rows(lambda row: row | {"px": repr(float(row["px"]) + 50.0)})(folder)
    scaled_rows([3], P, 0.0)(folder)


NO_OTHER_UNIT = {
    "one pose 10 km away": cell(3, "px", "1e4"),
    "one reading of another turn": cell(3, "q7", "25.0"),
    "a joint ten turns on": rows(lambda row: row | {"q7": repr(float(row["q7"]) + 20.0 * np.pi)}),
    "a pose lost by a tracker": far_away_and_once_lost,
}


@pytest.mark.parametrize("case", NO_OTHER_UNIT)
def test_what_is_far_off_for_another_reason_is_not_called_another_unit(folder, case):
    NO_OTHER_UNIT[case](folder)
    done = on(folder)
    for words in ("look like", "seem to be"):
        assert words not in done.stderr


def test_with_force_a_few_poses_in_millimetres_are_outliers(folder):
    scaled_rows([6, 11, 30], P, 1e3)(folder)
    done = on(folder, "--force", "--json")
    assert done.exit_code == 0, done.stderr
    assert {"p6", "p11", "p30"} <= set(json.loads(done.stdout)["outliers"])


def test_copies_of_a_row_are_no_replicates(folder):
    path = folder / "poses.csv"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines, *lines[3:11]]) + "\n")
    data = read_measurements(path, 7)
    assert (data.n, data.duplicates) == (40, 8)
    assert len(set(data.replicate)) == 40
    done = on(folder)
    assert done.exit_code == 0
    assert "8 of 48 rows repeat another row" in done.stderr
