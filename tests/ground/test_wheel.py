"""`pip install ./ground` in a fresh environment: the wheel holds the flight core and works anywhere."""

import ctypes
import json
import os
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import numpy as np
import poses
import pytest

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.slow


def run(*command, cwd):
    """A child that knows nothing of this tree."""
    env = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "KINCAL_CORE", "PYTHONHOME")}
    done = subprocess.run(
        [str(c) for c in command], cwd=cwd, env=env, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    out = tmp_path_factory.mktemp("wheel")
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-index"]
    run(*pip, "--wheel-dir", out, ROOT / "ground", cwd=out)
    (path,) = out.glob("kincal-*.whl")
    return path


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """A fresh environment with the wheel in it. What the wheel depends on is lent by this one, so that no
    network is needed; the tree itself is not on the path."""
    home = tmp_path_factory.mktemp("venv")
    run(sys.executable, "-m", "venv", home, cwd=home)
    python = home / "bin" / "python"
    site = Path(run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=home).strip())
    (site / "lent.pth").write_text(sysconfig.get_path("purelib") + "\n")
    run(python, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", wheel, cwd=home)
    return home


def test_wheel_holds_the_core_the_declarations_and_the_messages(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    messages = {f"kcm/{p.stem}.py" for p in (ROOT / "fsw" / "msg").glob("*.lcm")}
    assert {"kincal/_core/libkincal.so", "kincal/_core/kincal_cdef.h", "kincal/workbench/effects.toml",
            "kincal/arms/wam.toml"} | messages <= names  # fmt: skip
    assert not [n for n in names if "__pycache__" in n]


def test_core_in_the_wheel_gives_the_bits_of_the_core_that_flies(wheel, tmp_path):
    zipfile.ZipFile(wheel).extract("kincal/_core/libkincal.so", tmp_path)
    answers = []
    for path in (tmp_path / "kincal/_core/libkincal.so", ROOT / "build" / "libkincal.so"):
        lib = ctypes.CDLL(str(path))
        out = (ctypes.c_double * 4)()
        rotation = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]]).ravel()
        lib.kc_R_to_quat((ctypes.c_double * 9)(*rotation), out)
        answers.append(bytes(out))
    assert answers[0] == answers[1]


def test_workbench_runs_from_another_folder_on_a_users_own_arm(installed, tmp_path):
    (tmp_path / "mine").mkdir()
    poses.arm_toml(tmp_path / "mine" / "arm.toml")
    poses.poses_csv(
        tmp_path / "mine" / "poses.csv", 60, 12, lambda q, d: q + np.array([0, 0, 0, 3e-3 * d[3], 0, 0, 0])
    )
    kincal = installed / "bin" / "kincal"
    where = run(installed / "bin" / "python", "-c", "import kincal; print(kincal.__file__)", cwd=tmp_path)
    assert str(installed) in where
    given = ("--arm", "mine/arm.toml", "--data", "mine/poses.csv")
    got = json.loads(run(kincal, "model", "diagnose", *given, "--json", cwd=tmp_path))
    assert (got["verdict"], got["effects"][0]["name"]) == ("effect", "backlash[4]")
    run(kincal, "model", "add", "--model", "M.toml", "backlash[4]", cwd=tmp_path)
    assert "noise floor" in run(kincal, "model", "fit", *given, "--model", "M.toml", cwd=tmp_path)
    run(kincal, "model", "uplink", "--model", "M.toml", cwd=tmp_path)
    assert "terms" in run(kincal, "table", "check", "M.tbl", cwd=tmp_path)
    assert "WAM" in run(kincal, "model", "compare", "--arm", "wam", "--data", "mine/poses.csv", cwd=tmp_path)
