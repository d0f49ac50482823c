"""The miscalibration monitor against an independent chain: injected encoder biases are named, healthy arms
raise no alarm. Observations are made by numpy (calibration.py), with noise of 0.5 mm and 0.2 deg."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from builders import ffi, fill, lib, pointer
from calibration import PAPER, SIGMA, N, chain_poses, wam_tables
from chains import WAM_LIMITS
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from kincal.flight import check
from kincal.flight.builds import doubles

TABLES = Path(__file__).parents[2] / "tables/src"
CONFIG = tomllib.loads((TABLES / "config.toml").read_text())
FLOOR = CONFIG["sigma_pos_min_m"], CONFIG["sigma_rot_min_rad"]
BASE, TOOL = np.array([0, 0, 0.346]), np.array([0, 0, 0.10])
BOX = np.array([[0.30, 0.95], [-0.55, 0.55], [0.10, 0.95]])  # where the tool works, base frame [m]


def tool_poses(q, x):
    R, p = chain_poses(q, x)
    return R, BASE + p + R @ TOOL


def working_joints(rng, n):
    """Joints anywhere in their limits that put the tool into the working box."""
    q = np.empty((0, 7))
    while len(q) < n:
        more = rng.uniform(*WAM_LIMITS.T, (200, 7))
        p = tool_poses(more, np.zeros(N))[1]
        q = np.vstack([q, more[np.all((p > BOX[:, 0]) & (p < BOX[:, 1]), axis=1)]])
    return q[:n]


class Monitor:
    def __init__(self, x=None, floor=FLOOR):
        self.arm, self.terms = wam_tables()
        fill(self.arm, {"base_xyz_m": BASE, "tool_xyz_m": TOOL})
        self.coef = doubles(np.pad(np.zeros(N) if x is None else x, (0, lib.KC_COEF_MAX - N)))
        self.m, self.v = ffi.new("kc_monitor_t *"), ffi.new("kc_mon_verdict_t *")
        self.work, self.obs = ffi.new("kc_eval_t *"), ffi.new("kc_obs_t *")
        lib.kc_monitor_init(self.m, self.arm, *floor)

    def observe(self, q, R, p):
        o = self.obs
        o.ctx.q[0:7], o.has_rot = q.tolist(), 1
        o.p_m, o.cov = p.tolist(), np.diag(SIGMA**2).ravel().tolist()
        o.q_wxyz = Rotation.from_matrix(R).as_quat(scalar_first=True).tolist()
        check(lib.kc_monitor_add(self.m, self.arm, self.terms, pointer(self.coef), o, self.work), "add")
        lib.kc_monitor_evaluate(self.m, self.v)
        return self.v


def observations(rng, q, x, bias=0.0, shared=None):
    """What the camera measures of the arm with errors x whose joints stand `bias` beyond their readings."""
    R, p = tool_poses(q + bias, x)
    w = rng.normal(0, SIGMA[3:], (len(q), 3))
    d = rng.normal(0, SIGMA[:3], (len(q), 3))
    if shared is not None:
        d, w = d + shared[:3], w + shared[3:]
    return Rotation.from_rotvec(w).as_matrix() @ R, p + d


def run(rng, bias, n_obs=5, n_before=0, x=None, shared=None):
    """First observation with the bias at which a joint is named, and the verdict; (None, ...) if none is."""
    x = np.zeros(N) if x is None else x
    monitor = Monitor(x)
    q = working_joints(rng, n_before + n_obs)
    for qi, Ri, pi in zip(q[:n_before], *observations(rng, q[:n_before], x, shared=shared), strict=True):
        assert monitor.observe(qi, Ri, pi).state == lib.KC_MON_QUIET
    rows = zip(q[n_before:], *observations(rng, q[n_before:], x, bias, shared), strict=True)
    for k, (qi, Ri, pi) in enumerate(rows, 1):
        v = monitor.observe(qi, Ri, pi)
        if v.state == lib.KC_MON_NAMED and v.suspects == 1 << v.joint:
            return k, v
    return (k if v.state == lib.KC_MON_NAMED else None), v


def campaign(rng, cases, n=5, **kw):
    """Share of cases in which the right joint is named, no other one being as likely, and in which it is at
    least among the suspects."""
    alone = among = 0
    for j, size in cases:
        k, v = run(rng, size * np.eye(7)[j], n, **kw)
        among += k is not None and bool(v.suspects >> j & 1)
        alone += k is not None and v.joint == j and v.suspects == 1 << j
    return alone / len(cases), among / len(cases)


def random_cases(rng, n):
    return [(int(rng.integers(7)), rng.choice([-1, 1]) * 0.010 ** rng.uniform(0.5, 1.0)) for _ in range(n)]


@pytest.mark.parametrize("before", [0, 8])
@pytest.mark.parametrize("x", [np.zeros(N), PAPER], ids=["nominal", "calibrated"])
def test_random_biases_of_one_joint_are_named_within_5_observations(before, x):
    """Also when the window is full of healthy observations, and with an active correction of half a metre."""
    rng = np.random.default_rng(50 + before)
    alone, among = campaign(rng, random_cases(rng, 200), n_before=before, x=x)
    assert alone >= 0.95 and among >= 0.97


def test_10_mrad_are_named_within_5_observations_whatever_the_joint():
    """The last joint has no lever: only 0.2 deg of orientation noise limits it, 6.4 sigma in all."""
    rng = np.random.default_rng(60)
    alone = [campaign(rng, [(j, 0.010 * (-1) ** i) for i in range(60)])[0] for j in range(7)]
    assert np.mean(alone) >= 0.95
    assert min(alone[:6]) >= 0.95 and alone[6] >= 0.80


def test_bias_and_its_sigma_are_right():
    """Large ones too: the turn is exact. In units of its sigma the error is at most normal."""
    rng = np.random.default_rng(61)
    whitened = []
    for j, size in random_cases(rng, 60) + [(j, s) for j in range(7) for s in (-0.8, 0.3, 1.2)]:
        monitor, q = Monitor(), working_joints(rng, 5)
        for a in zip(q, *observations(rng, q, np.zeros(N), size * np.eye(7)[j]), strict=True):
            v = monitor.observe(*a)
        if v.state == lib.KC_MON_NAMED and v.n_obs == 5 and v.joint == j:
            whitened.append((v.bias - size) / v.sigma)
    assert len(whitened) >= 70
    assert np.max(np.abs(whitened)) < 4 and 0.6 < np.std(whitened) < 1.2


@pytest.mark.parametrize("kind", ["noise", "at the floor", "one pose"])
def test_1000_healthy_observations_raise_nothing(kind):
    """Noise as stated; all observations also off by the floor in one direction; all at one pose."""
    rng = np.random.default_rng(62)
    shared = np.repeat(FLOOR, 3) * rng.choice([-1, 1], 6) if kind == "at the floor" else None
    monitor, q = Monitor(), working_joints(rng, 1000)
    if kind == "one pose":
        q[:] = q[0]
    for a in zip(q, *observations(rng, q, np.zeros(N), shared=shared), strict=True):
        assert monitor.observe(*a).state == lib.KC_MON_QUIET


def test_alarms_are_no_more_frequent_than_stated():
    """20 arms, 200 observations each: the stated bound lets 0.2 alarms be expected."""
    rng = np.random.default_rng(63)
    over = 0
    for _ in range(20):
        monitor, q = Monitor(), working_joints(rng, 200)
        for a in zip(q, *observations(rng, q, np.zeros(N)), strict=True):
            over += monitor.observe(*a).state != lib.KC_MON_QUIET
    assert over <= 1


def test_two_joints_at_once_are_not_blamed_on_one():
    rng = np.random.default_rng(64)
    wrong = unexplained = 0
    for _ in range(60):
        i, j = rng.choice(7, 2, replace=False)
        bias = rng.uniform(0.05, 0.1) * np.eye(7)[i] - rng.uniform(0.05, 0.1) * np.eye(7)[j]
        monitor, q = Monitor(), working_joints(rng, 5)
        for a in zip(q, *observations(rng, q, np.zeros(N), bias), strict=True):
            v = monitor.observe(*a)
        wrong += v.state == lib.KC_MON_NAMED and not v.suspects & (1 << i | 1 << j)
        unexplained += v.state == lib.KC_MON_UNEXPLAINED
    assert wrong == 0 and unexplained >= 54


def test_one_outlier_is_no_alarm():
    rng = np.random.default_rng(65)
    monitor, q = Monitor(), working_joints(rng, 30)
    R, p = observations(rng, q, np.zeros(N))
    p[10] += [0.05, 0, 0]
    for a in zip(q, R, p, strict=True):
        assert monitor.observe(*a).state == lib.KC_MON_QUIET


def test_joints_whose_axes_fall_together_are_all_named():
    """The arm stretched straight up: joints 1, 3, 5, 7 turn about lines that are the same but for 45 mm that
    cancel, so what one does the others do too."""
    rng = np.random.default_rng(66)
    monitor, q = Monitor(), np.zeros((5, 7))
    for a in zip(q, *observations(rng, q, np.zeros(N), 0.05 * np.eye(7)[4]), strict=True):
        v = monitor.observe(*a)
    assert v.state == lib.KC_MON_NAMED and v.suspects == 0b1010101
    # another posture separates them
    q = working_joints(rng, 5)
    for a in zip(q, *observations(rng, q, np.zeros(N), 0.05 * np.eye(7)[4]), strict=True):
        v = monitor.observe(*a)
    assert v.suspects == 1 << 4


def test_statistic_is_that_of_the_dense_least_squares():
    """Small bias, two observations: bias, sigma and remaining chi-square by the textbook, columns by
    differences of the independent chain, the floor's part added up as amplitudes."""
    rng = np.random.default_rng(67)
    q, zero, h = working_joints(rng, 2), np.zeros(N), 1e-6
    bias = 0.02 * np.eye(7)[1]
    R, p = observations(rng, q, zero, bias)
    monitor = Monitor()
    for a in zip(q, R, p, strict=True):
        v = monitor.observe(*a)
    assert v.state == lib.KC_MON_NAMED and v.joint == 1 and v.n_obs == 2

    def residual(b):
        Rm, pm = tool_poses(q + b * np.eye(7)[1], zero)
        return np.hstack([p - pm, Rotation.from_matrix(R @ Rm.transpose(0, 2, 1)).as_rotvec()]) / SIGMA

    a = -(residual(v.bias + h) - residual(v.bias - h)) / (2 * h)
    floor = np.repeat(FLOOR, 3)
    shared = np.linalg.norm(a / SIGMA * floor, axis=1)
    info = np.sum(a**2)
    var = info + np.sum(shared) ** 2 - np.sum(shared**2)
    assert np.sum(a * residual(v.bias)) == pytest.approx(0, abs=1e-3 * np.sqrt(info))
    assert v.sigma == pytest.approx(np.sqrt(var) / info, rel=1e-3)
    assert v.stat == pytest.approx((v.bias / v.sigma) ** 2, rel=1e-9)
    assert v.rest == pytest.approx(np.sum(residual(v.bias) ** 2), rel=1e-6)
    assert v.p_rest == pytest.approx(chi2.sf(v.rest, 11), rel=1e-9)
    assert v.p == pytest.approx(49 * chi2.sf(v.stat, 1), rel=1e-9)  # 7 joints, 7 onsets
    assert v.off_m == pytest.approx(np.linalg.norm((residual(0) * SIGMA)[1, :3]), rel=1e-9)
