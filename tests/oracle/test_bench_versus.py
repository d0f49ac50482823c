"""What `make bench` compares with does the same work: the results that its times are of agree."""

import numpy as np
import pytest
import qp
from chains import Numbers, by_pinocchio, chain_of, transform
from scipy.optimize._numdiff import approx_derivative
from versus import design, fits, kinematics, measure, report

from kincal.workbench.fit.least_squares import find_frames, fit_model


@pytest.mark.parametrize("arg", ["paper", "so3"])
def test_kernels_agree(arg):
    g = design.gram(arg, 5, 7)
    seconds, K = g.ours(1)
    assert seconds > 0.0
    assert np.abs(K - g.other()).max() < 1e-12
    assert np.ptp(K) > 0.1


def test_design_steps_choose_the_same_candidate():
    s = design.step_of(6, 40)
    ours = design.OurStep(s)
    for call in (ours.step, ours.anew):
        assert call(2) > 0.0
        for other in (design.by_geometric_kernels, design.by_scikit_learn):
            assert design.off_value(ours, other(s)) < 1e-6
    other = design.by_scikit_learn(design.step_of(7, 40))
    assert not design.off_value(ours, other) < 1e-6, "another step gives something else"


def test_poses_and_jacobians_agree():
    arm = kinematics.arm_of(7, 3)
    ours = kinematics.Ours(arm)
    assert ours.seconds(rounds=1) > 0.0
    T, Jq, J = ours.last()
    none = np.zeros(7)
    numbers = Numbers(
        arm.dh + arm.errors,
        none.astype(bool),
        transform(arm.base_m),
        transform(arm.tool_m),
        np.array([0, 0, -9.81]),
        none,
        np.zeros((7, 3)),
    )
    other = by_pinocchio(chain_of(numbers, arm.q[-1], {}))
    assert np.abs(T - other.T[:3]).max() < 1e-14
    for j in range(7):
        assert np.abs(Jq[:, j] - other.J["q", j]).max() < 1e-14
    model = fits.Numpy(
        arm.dh, none.astype(bool), transform(arm.base_m), transform(arm.tool_m), arm.q[-1:], np.zeros((1, 3)),
        np.eye(3)[None],
    )  # fmt: skip
    x = np.concatenate([arm.errors.ravel(), np.zeros(12)])

    def position(x):
        return model.frames(x)[0][-1][0, :3, 3]

    assert np.abs(J[:3] - approx_derivative(position, x, method="3-point")[:, :28]).max() < 1e-8


@pytest.mark.parametrize("name", ["wam/wam", "fr3/fr3"])
def test_the_model_in_numpy_is_that_of_the_fit(name):
    s = fits.read(name, 40)
    frames = find_frames(s.arm, s.part)
    model = fits.Numpy.of(s, s.part, frames)
    nominal = fit_model(s.arm, s.part, dh=False, frames=frames)
    off = model.residuals(np.zeros(model.n)) - nominal.model.evaluate(0.0 * nominal.estimate).r
    assert np.abs(off).max() < 1e-12
    small = np.random.default_rng(1).normal(size=model.n) * 1e-5
    found, wanted = model.jacobian(small), approx_derivative(model.weighed, small, method="3-point")
    assert np.abs(found - wanted).max() < 0.01 * np.abs(wanted).max()
    assert fits.by_scipy(s, frames, True).pos_m < 0.02


@pytest.mark.parametrize("solver", sorted(qp.there()))
def test_solvers_solve(solver):
    p = qp.made("random", 12, np.random.default_rng(2))
    seconds, x = qp.SOLVERS[solver](p)()
    assert seconds > 0.0
    assert p.residual(x) < 1e-6
    assert p.residual(x + 0.01) > 1e-3


def test_ratios_and_exponents():
    calls = {measure.OURS: lambda: 2.0, "other": lambda: 6.0}
    (found,) = measure.compared("part", "case", calls, {"other": 0.5}, "unit", 3)
    assert (found.ratio, found.low, found.high, found.ours_s, found.off) == (3.0, 3.0, 3.0, 2.0, 0.5)
    grown = measure.growth("part", "n", (2, 4, 8), lambda n: {measure.OURS: lambda: 0.1 * n**3}, 1)
    assert grown.exponent(measure.OURS) == pytest.approx(3.0)
    assert [report.significant(x) for x in (0.0, 0.0837, 3.16, 31.6, 3163.0)] == [
        "0",
        "0.084",
        "3.2",
        "32",
        "3 200",
    ]


def test_every_program_has_its_turn_first():
    order = []
    calls = {name: lambda name=name: order.append(name) or 1.0 for name in "ab"}
    measure.in_turn(calls, 2, warm=0)
    assert order == ["a", "b", "b", "a"]


def test_tables_go_between_their_marks(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("a\n<!-- x: make bench -->\nold\n<!-- end of x -->\nb\n")
    report.put("x", ["new"], page)
    assert page.read_text() == "a\n<!-- x: make bench -->\n\nnew\n\n<!-- end of x -->\nb\n"
    with pytest.raises(ValueError, match="no marks"):
        report.put("y", ["new"], page)
    for name in ("ratios", "growth", "fits", "box QP"):
        assert f"<!-- {name}: make bench -->" in report.PAGE.read_text()
