"""What several test files share: the true arm's table, the effect library, environments of the wheel."""

import sys
from pathlib import Path

import poses
import pytest
from environments import environment, run

from kincal import workbench as wb
from kincal.installation import EXTRAS

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def arm(tmp_path_factory):
    """The WAM, all of it known but its errors."""
    return wb.read_arm(poses.arm_toml(tmp_path_factory.mktemp("arm") / "arm.toml"))


@pytest.fixture(scope="session")
def library():
    """The effects that ship."""
    return wb.Library.load()


@pytest.fixture(scope="session")
def wheel(tmp_path_factory):
    out = tmp_path_factory.mktemp("wheel")
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-index", "--no-build-isolation"]
    run(*pip, "--wheel-dir", out, ROOT / "ground", cwd=out)
    (path,) = out.glob("kincal-*.whl")
    return path


@pytest.fixture(scope="session")
def plain(wheel, tmp_path_factory):
    return environment(tmp_path_factory.mktemp("plain"), wheel)


@pytest.fixture(scope="session")
def full(wheel, tmp_path_factory):
    return environment(tmp_path_factory.mktemp("full"), wheel, EXTRAS)
