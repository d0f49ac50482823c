"""The generator of hidden effects: seals, repeatability, and physics against hand-made expectations."""

import json
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from kincal_sim import geom
from kincal_sim.hidden import case, eye, kinds, session
from kincal_sim.hidden.plant import Plant


def order(*effects, n=12, **more):
    return case.Order(id="t", effects=effects, n=n, seed=5, **more)


def readings(*effects, n=6, **more):
    """Noiseless readings with and without the effects of a case."""
    bench = case.Bench(order(*effects, n=n, **more))
    moments, _ = bench.campaign()
    hidden, told = bench.hide()
    return [(bench.read(now, hidden), bench.read(now, [])) for now in moments], told, bench


def in_camera(reading):
    return np.linalg.inv(reading.T_base_cam) @ reading.T


# ---- files and seals ----------------------------------------------------------------------------------


def test_generator_loads_neither_ground_nor_flight_code(tmp_path):
    script = (
        "import sys; from kincal_sim.hidden import case; from pathlib import Path;"
        f"case.make(case.Order('x', ('ratio',), n=8), Path({str(tmp_path)!r}));"
        "print([m for m in sys.modules if m.split('.')[0] == 'kincal'], "
        "'libkincal' in open('/proc/self/maps').read())"
    )
    out = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "[] False"


def test_same_seed_same_files_and_another_seed_others(tmp_path):
    made = [case.make(order("ratio[2]"), tmp_path / name) for name in "ab"]
    assert made[0] == made[1]
    assert (tmp_path / "a/poses.csv").read_bytes() == (tmp_path / "b/poses.csv").read_bytes()
    case.make(case.Order("t", ("ratio[2]",), n=12, seed=6), tmp_path / "c")
    assert (tmp_path / "a/poses.csv").read_bytes() != (tmp_path / "c/poses.csv").read_bytes()


def test_seal_hides_the_answer_and_tells_when_it_was_changed(tmp_path):
    line = case.make(order("hysteresis[4]"), tmp_path)
    text = (tmp_path / "sealed.json").read_text()
    assert "hysteresis" not in text and "hysteresis" not in (tmp_path / "poses.csv").read_text()
    answer = case.unseal(json.loads(text), line["sha256"])
    assert answer["effects"][0]["kind"] == "hysteresis" and answer["effects"][0]["place"] == [4]
    forged = case.seal({**answer, "effects": []})
    with pytest.raises(case.BrokenSeal):
        case.unseal(forged, line["sha256"])


def test_unknown_effects_and_places_are_refused_before_anything_is_written(tmp_path):
    command = [sys.executable, "-m", "kincal_sim.hidden", "make", "--out", str(tmp_path / "o"), "--cases"]
    for wrong in ("gremlins", "compliance[1]", "focal[2]", "differential[all]"):
        done = subprocess.run([*command, wrong], capture_output=True, text=True)
        assert done.returncode == 2 and "error:" in done.stderr
    assert not (tmp_path / "o").exists()


def test_replicates_are_approached_anew_and_noise_is_the_stated_one(tmp_path):
    case.make(order(n=60), tmp_path)
    rows = np.genfromtxt(tmp_path / "poses.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    groups, counts = np.unique(rows["replicate"], return_counts=True)
    assert 6 <= (counts - 1).sum() <= 12
    again = [np.flatnonzero(rows["replicate"] == g) for g in groups[counts > 1]]
    dirs = np.array([[rows[f"dir{j}"][i] for j in range(1, 8)] for pair in again for i in pair])
    assert (dirs[0::2] != dirs[1::2]).any(axis=1).all()
    assert np.ptp(rows["temp_c"]) > 20.0 and np.ptp(rows["u_px"]) > 600.0
    trace = np.sqrt(np.mean(rows["c11"] + rows["c22"] + rows["c33"]))
    assert trace == pytest.approx(np.sqrt(0.6**2 + 0.6**2 + 1.8**2) * 1e-3, rel=1e-6)


# ---- physics ------------------------------------------------------------------------------------------


def test_without_effects_only_the_errors_of_the_arm_are_left():
    """The reading is the forward kinematics of the erroneous chain, written out here by hand."""
    pairs, _, bench = readings()
    for healthy, _ in pairs:
        T = geom.trans(*bench.spec["base"]["xyz_m"])
        for j, joint in enumerate(bench.spec["joint"], 1):
            e = {k: bench.errors[f"J{j}.{k}"] for k in ("phi_rad", "alpha_rad", "a_m", "d_m")}
            T = T @ geom.rot("z", healthy.now.q[j - 1] + e["phi_rad"])
            T = T @ geom.trans(joint["a_m"] + e["a_m"], 0, joint["d_m"] + e["d_m"])
            T = T @ geom.rot("x", joint["alpha_rad"] + e["alpha_rad"])
        T = T @ geom.trans(*bench.spec["tool"]["xyz_m"])
        assert np.abs(healthy.T - T).max() < 1e-9


def test_compliance_agrees_with_itself_at_the_deflected_posture():
    """Spring law at the equilibrium found: q - q_read = c tau / (1 + |tau| / h), tau from MuJoCo there."""
    bench = case.Bench(order("compliance[all]@20", n=6))
    effects, told = bench.hide()
    moments, _ = bench.campaign()
    c = np.zeros(7)
    c[1:6] = np.ravel(told[0]["theta"])
    for now in moments:
        bench.plant.settle(now, effects)
        arm = bench.plant.arms[now.payload_kg]
        tau = arm.gravity_torque()
        wanted = c * tau / (1.0 + np.abs(tau) / 60.0)
        assert np.abs(arm.data.qpos[:7] - now.q - wanted).max() < 1e-11
        assert np.abs(wanted).max() > 1e-4


def test_loads_about_the_base_plate_are_lever_times_weight():
    spec = case.load_spec()
    plant = Plant(spec, {}, (0.0,))
    bench = case.Bench(order(n=6))
    now = next(m for m in bench.campaign()[0] if m.payload_kg == 0.0)

    class Look:
        moment = None

        def __getattr__(self, name):
            return {"head": lambda _n, p, t: (p, t), "camera": lambda _n: np.eye(4)}[name]

        def joints(self, _now, loads):
            Look.moment = loads.moment(np.zeros(3))
            return 0.0

        def bodies(self, _now, _loads):
            return {}

    plant.settle(now, [Look()])
    arm = plant.arms[0.0]
    wanted = np.zeros(3)
    for j, joint in enumerate(spec["joint"], 1):
        at = arm.data.body(f"frame{j}").xmat.reshape(3, 3) @ joint["com_m"] + arm.data.body(f"frame{j}").xpos
        wanted += np.cross(at, [0.0, 0.0, -9.81 * joint["mass_kg"]])
    assert Look.moment == pytest.approx(wanted, abs=1e-9)


def test_bending_of_one_link_moves_only_what_lies_beyond_it():
    pairs, _, bench = readings("bending[5]@5")
    bent, _ = pairs[0]
    arm = bench.plant.arms[bent.now.payload_kg]
    where = {}
    for name, effects in (("straight", []), ("bent", bench.hide()[0])):
        bench.plant.settle(bent.now, effects)
        where[name] = [arm.data.body(f"frame{j}").xpos.copy() for j in range(8)]
    moved = np.linalg.norm(np.array(where["bent"]) - where["straight"], axis=1)
    assert moved[:5].max() < 1e-12 and moved[5:].min() > 1e-6


def test_friction_windup_remembers_where_the_joint_came_from():
    rest = np.zeros(1)
    up = session._wind(rest, np.array([0.2]))
    assert up[0] == pytest.approx(1.0, abs=1e-5)
    small_way_back = session._wind(up, np.array([-0.005]))
    assert -1.0 < small_way_back[0] < 1.0 and small_way_back[0] != pytest.approx(-1.0, abs=0.1)
    assert session._wind(up, np.array([-0.2]))[0] == pytest.approx(-1.0, abs=1e-5)


@pytest.mark.parametrize(("kind", "axis"), [("tag_size", None), ("focal", 2)])
def test_scale_errors_of_camera_and_tag_scale_what_pnp_gives(kind, axis):
    """A tag larger by e comes out nearer by e in all three; a longer focal length only in depth."""
    pairs, told, bench = readings(f"{kind}@2")
    e = told[0]["theta"][0][0]
    for wrong, healthy in pairs:
        ratio = wrong.T_cam_tag[:3, 3] / healthy.T_cam_tag[:3, 3]
        assert ratio[2] == pytest.approx(1 / (1 + e), rel=1e-3)
        wanted = 1.0 if axis == 2 else 1 / (1 + e)
        assert np.allclose(ratio[:2], wanted, rtol=1.5e-3)
    assert bench.optics.tag_size_m == 0.06


def test_radial_distortion_changes_the_range_twice_as_much_as_the_direction():
    """u' = u (1 + k r^2) makes a small tag look larger by 1 + 2 k r^2, averaged over its leanings."""
    table = eye.nominal(case.load_spec())
    lens = eye.Lens(radial=(0.02, 0.0)).optics(SimpleNamespace(camera_temp_c=20.0), table)
    p = np.array([0.5, 0.2, 1.2])
    seen = []
    for spin in np.linspace(0, 2 * np.pi, 16, endpoint=False):
        T = geom.trans(*p) @ geom.rot("z", spin) @ geom.rot("y", 0.5)
        seen.append(eye.perceive(table, eye.image(lens, T), T)[:3, 3])
    change = np.mean(seen, axis=0) / p - 1.0
    k_r2 = 0.02 * (p[0] ** 2 + p[1] ** 2) / p[2] ** 2
    assert change[2] == pytest.approx(-2 * k_r2, rel=0.25)
    assert change[0] - change[2] == pytest.approx(k_r2, rel=0.1)


@pytest.mark.parametrize("kind", sorted(kinds.KINDS))
def test_every_kind_shows_in_the_readings_and_is_reproducible(kind):
    pairs, told, _ = readings(kind, n=6)
    again, told_again, _ = readings(kind, n=6)
    assert told == told_again
    for (a, healthy), (b, _) in zip(pairs, again, strict=True):
        assert np.array_equal(a.T, b.T) and np.isfinite(a.T).all()
        assert np.abs(a.T - healthy.T).max() < 0.1
    assert max(np.abs(a.T - healthy.T).max() for a, healthy in pairs) > 1e-7


def test_a_fixed_head_makes_camera_shift_and_base_motion_the_same():
    pairs, _, _ = readings("camera_shift", fixed_head=True)
    change = [wrong.T @ np.linalg.inv(healthy.T) for wrong, healthy in pairs]
    assert np.abs(np.array(change) - change[0]).max() < 1e-9
