"""Poses that a file keeps back choose nothing of a model."""

from dataclasses import replace

import numpy as np
import pytest
from places import DATA

from kincal import workbench as wb


@pytest.mark.parametrize("jump", [26, 30])
def test_the_moment_of_a_step_is_not_chosen_by_held_poses(library, jump):
    """50 poses of a real arm whose base jumps; poses 26 to 29 are kept back, all before it or all after."""
    arm, data = wb.read_arm(DATA / "ur5" / "ur5.toml"), wb.read_csv(DATA / "ur5" / "ur5.csv", 6)
    data = data.take(np.sort(np.random.default_rng(2).permutation(data.n)[:50]))
    number = np.arange(50)
    moved = data.p_m + np.where(number >= jump, 3e-3, 0.0)[:, None] * [1.0, -0.5, 0.5]
    split = np.where((number >= 26) & (number < 30), "held", "fit")
    data = replace(data, t_s=1.0 * number, p_m=moved, split=split)
    [found] = wb.choose_constants(library, ["base_step"], arm, data, joined=True)
    assert dict(found.constants)["t0"] == 27.5  # the middle of the poses that were fitted, 25 and 30
