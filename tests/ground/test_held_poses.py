"""Poses that a file keeps back choose nothing of a model."""

from dataclasses import replace

import numpy as np
import pytest
from places import DATA

from kincal import workbench as wb
from kincal.api.case import Case
from kincal.workbench.diagnosis.advised import advised
from kincal.workbench.evidence.constants import Choice
from kincal.workbench.prediction.nested import HELD_OUT, cost_without
from kincal.workbench.report.answers import fit_json, fit_text


def jumping(jump):
    """50 poses of a real arm, one a second, whose base jumps from pose `jump` on."""
    arm, data = wb.read_arm(DATA / "ur5" / "ur5.toml"), wb.read_csv(DATA / "ur5" / "ur5.csv", 6)
    data = data.take(np.sort(np.random.default_rng(2).permutation(data.n)[:50]))
    number = np.arange(50)
    moved = data.p_m + np.where(number >= jump, 3e-3, 0.0)[:, None] * [1.0, -0.5, 0.5]
    return arm, replace(data, t_s=1.0 * number, p_m=moved)


@pytest.mark.parametrize("jump", [26, 30])
def test_the_moment_of_a_step_is_not_chosen_by_held_poses(library, jump):
    """Poses 26 to 29 are kept back, all before the jump or all after."""
    arm, data = jumping(jump)
    number = np.arange(50)
    data = replace(data, split=np.where((number >= 26) & (number < 30), "held", "fit"))
    [found] = wb.choose_constants(library, ["base_step"], arm, data, joined=True)
    assert dict(found.constants)["t0"] == 27.5  # the middle of the poses that were fitted, 25 and 30


@pytest.fixture(scope="module", params=[27, 28])
def stepped(request):
    """The base jumps before or after pose 27, which is held out because the file says nothing; moment of the
    jump; and a fit with it."""
    arm, data = jumping(request.param)
    return arm, data, request.param - 0.5, wb.fit(arm, data, ["base_step"])


def test_errors_of_held_out_poses_are_of_a_moment_that_they_did_not_choose(stepped):
    """The middle of the poses beside it, 26 and 28; it was that which pose 27 chose with the others. The
    model to use has the latter."""
    arm, data, moment, got = stepped
    stated = wb.fit(arm, data, ["base_step(t0=27)"])
    errors, wanted = ([m.pos_m for m in f.nested.of(HELD_OUT)] for f in (got, stated))
    assert errors == wanted
    assert got.comparison.rms["held"] == stated.comparison.rms["held"]
    assert got.constants["base_step"]["t0"] == moment
    assert f"base_step: t0 = {moment}; held-out poses are predicted with t0 = 27," in fit_text(got)
    assert fit_json(got)["constants"] == {"base_step": {"model": {"t0": moment}, "held_out": {"t0": 27.0}}}
    assert fit_json(stated)["constants"] == {}


def test_every_answer_chooses_constants_without_held_out_poses(library, stepped):
    """What diagnose promises of a fit, compare, and the cost of effects that a table of flight lacks."""
    arm, data, moment, got = stepped
    promised = advised(arm, data, library, ["base_step"], [], dh=True, outliers=got.comparison.outliers.ids)
    assert promised.errors == got.nested.of(HELD_OUT)
    assert Case(arm, data, ("base_step",)).compare().rms == got.comparison.rms
    choice = Choice(library, ("base_step",), arm, data)
    assert dict(choice.hypotheses[0].constants) == {"t0": moment}
    cost = cost_without(arm, data, choice.hypotheses, choice.hypotheses, anew=choice.anew)
    assert cost.after_m == got.nested.of(HELD_OUT)[-1].pos_m
