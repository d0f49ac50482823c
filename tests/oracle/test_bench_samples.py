"""The bench of held-out errors runs, and its verdict separates worse from unlucky."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import samples

BENCH = Path(__file__).resolve().parents[1] / "bench"


def test_four_seeds_up_to_eight_poses_are_not_clearly_worse():
    done = subprocess.run(
        [sys.executable, BENCH / "samples.py", "--quick"], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert all(name in done.stdout for name in samples.ACQUISITIONS)


def test_verdict():
    figures = np.random.default_rng(0).lognormal(0.0, 0.3, 20)
    assert not samples.worse(figures, 1.0, 0.5)
    assert not samples.worse(figures, 1.5, 0.5)  # better
    assert not samples.worse(figures, 0.9, 0.5)  # the luck of ten seeds
    assert samples.worse(figures, 0.5, 0.5)
    assert samples.worse(10 * figures, 5.0, 0.9)
