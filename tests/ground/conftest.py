"""Environments that several test files share; making one takes seconds."""

import sys
from pathlib import Path

import pytest
from environments import environment, run

from kincal.installation import EXTRAS

ROOT = Path(__file__).resolve().parents[2]


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
