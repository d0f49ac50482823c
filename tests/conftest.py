"""What every Python test may count on."""

import gc
import os
from pathlib import Path

import pytest

from kincal_shared import keys

# Off-screen OpenGL, which only the simulated camera draws with: set before anything imports mujoco.
os.environ.setdefault("MUJOCO_GL", "disable")
os.environ.setdefault("PYOPENGL_PLATFORM", "osmesa")
# One thread each: the machine has few cores, and sums keep their order.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

ROOT = Path(__file__).resolve().parent.parent


def pytest_collection_finish():
    """What is loaded stays: the search for cycles, also that of pytest at the end, does without it."""
    gc.freeze()


@pytest.fixture(autouse=True, scope="session")
def key_file(tmp_path_factory):
    """Keys of the tests' own, and a journal beside them: nobody's home is touched."""
    path = tmp_path_factory.mktemp("keys") / "keys"
    keys.new(path)
    os.environ[keys.VARIABLE] = str(path)
    return path
