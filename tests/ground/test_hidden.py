"""The generator of hidden effects: seals, repeatability, and physics against hand-made expectations."""

import json
import subprocess
import sys
import tomllib
from types import SimpleNamespace

import numpy as np
import pytest

from kincal_sim import transforms
from kincal_sim.hidden import __main__, campaign, case, files, kinds, optical_effects, optics, seal
from kincal_sim.hidden.bench import Bench
from kincal_sim.hidden.spec import CaseSpec
from kincal_sim.mechanics.plant import Effect, Plant
from kincal_sim.mechanics.spec import load_spec


def spec(*effects, n=12, **more):
    return CaseSpec(id="t", effects=effects, n=n, seed=5, **more)


def observations(*effects, n=6, **more):
    """Noiseless observations with and without the effects of a case."""
    bench = Bench(spec(*effects, n=n, **more))
    poses, _ = bench.campaign()
    hidden, described = bench.hide()
    return [(bench.observe(at, hidden), bench.observe(at, [])) for at in poses], described, bench


def test_the_arm_table_states_the_corners_of_both_tags_where_the_camera_sees_them():
    target = tomllib.loads(files.arm_toml(load_spec()))["target"]
    pairs, _, bench = observations(n=12)
    seen = set()
    for _, healthy in pairs:
        tag = healthy.at.tag
        corners = np.array(target[("points_m", "second_points_m")[tag]])
        T_cam_tool = np.linalg.inv(healthy.T_base_cam) @ healthy.T_base_tool
        in_camera = corners @ T_cam_tool[:3, :3].T + T_cam_tool[:3, 3]
        u, v, w = bench.optics.K @ in_camera.T
        wanted_px = optics.image(bench.optics, healthy.T_cam_tag)
        assert np.allclose(np.array([u / w, v / w]).T, wanted_px, atol=1e-3)
        seen.add(tag)
    assert seen == {0, 1}


# ---- files and seals ----------------------------------------------------------------------------------


def test_generator_loads_no_flight_code_and_nothing_of_the_ground(tmp_path):
    script = (
        "import sys; from kincal_sim.hidden import case, spec; from pathlib import Path;"
        f"case.make(spec.CaseSpec('x', ('ratio',), n=8), Path({str(tmp_path)!r}));"
        "print({m for m in sys.modules if m.split('.')[0] == 'kincal'}, "
        "'libkincal' in open('/proc/self/maps').read())"
    )
    out = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "set() False"


def test_same_seed_same_files_and_another_seed_others(tmp_path):
    made = [case.make(spec("ratio[2]"), tmp_path / name) for name in "ab"]
    assert made[0] == made[1]
    assert (tmp_path / "a/poses.csv").read_bytes() == (tmp_path / "b/poses.csv").read_bytes()
    case.make(CaseSpec("t", ("ratio[2]",), n=12, seed=6), tmp_path / "c")
    assert (tmp_path / "a/poses.csv").read_bytes() != (tmp_path / "c/poses.csv").read_bytes()


def test_seal_hides_the_answer_and_shows_when_it_was_changed(tmp_path):
    line = case.make(spec("hysteresis[4]"), tmp_path)
    text = (tmp_path / "sealed.json").read_text()
    assert "hysteresis" not in text and "hysteresis" not in (tmp_path / "poses.csv").read_text()
    answer = seal.unseal(json.loads(text), line["sha256"])
    assert answer["effects"][0]["kind"] == "hysteresis" and answer["effects"][0]["place"] == [4]
    forged = seal.seal({**answer, "effects": []})
    with pytest.raises(seal.BrokenSeal):
        seal.unseal(forged, line["sha256"])


def test_unknown_effects_and_places_are_refused_before_anything_is_written(tmp_path, monkeypatch, capsys):
    words = ["hidden", "make", "--out", str(tmp_path / "o"), "--cases"]
    for wrong in ("gremlins", "compliance[1]", "focal[2]", "differential[all]"):
        monkeypatch.setattr(sys, "argv", [*words, wrong])
        assert __main__.main() == 2 and "error:" in capsys.readouterr().err
    assert not (tmp_path / "o").exists()


def test_replicates_are_approached_anew_and_noise_is_the_stated_one(tmp_path):
    case.make(spec(n=60), tmp_path)
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
    """The observation is the forward kinematics of the erroneous chain, written out here by hand."""
    pairs, _, bench = observations()
    for healthy, _ in pairs:
        T = transforms.trans(*bench.arm_spec["base"]["xyz_m"])
        for j, joint in enumerate(bench.arm_spec["joint"], 1):
            e = {k: bench.errors[f"J{j}.{k}"] for k in ("phi_rad", "alpha_rad", "a_m", "d_m")}
            T = T @ transforms.rot("z", healthy.at.q_rad[j - 1] + e["phi_rad"])
            T = T @ transforms.trans(joint["a_m"] + e["a_m"], 0, joint["d_m"] + e["d_m"])
            T = T @ transforms.rot("x", joint["alpha_rad"] + e["alpha_rad"])
        T = T @ transforms.trans(*bench.arm_spec["tool"]["xyz_m"])
        assert np.abs(healthy.T_base_tool - T).max() < 1e-9


def test_compliance_holds_at_the_deflected_posture():
    """Spring law at the equilibrium found: q - q_read = c tau / (1 + |tau| / h), tau from MuJoCo there."""
    bench = Bench(spec("compliance[all]@20", n=6))
    effects, described = bench.hide()
    poses, _ = bench.campaign()
    c = np.zeros(7)
    c[1:6] = np.ravel(described[0]["theta"])
    for at in poses:
        bench.plant.settle(at, effects)
        arm = bench.plant.arm(at.payload_kg)
        tau = arm.gravity_torque()
        wanted = c * tau / (1.0 + np.abs(tau) / 60.0)
        assert np.abs(arm.data.qpos[:7] - at.q_rad - wanted).max() < 1e-11
        assert np.abs(wanted).max() > 1e-4


def test_loads_about_the_base_plate_are_lever_times_weight():
    arm_spec = load_spec()
    plant = Plant(arm_spec)
    at = next(c for c in Bench(spec(n=6)).campaign()[0] if c.payload_kg == 0.0)

    class Probe(Effect):
        moment_nm = None

        def joint_offsets(self, _at, loads):
            self.moment_nm = loads.moment_nm(np.zeros(3))
            return 0.0

    probe = Probe()
    plant.settle(at, [probe])
    wanted = np.zeros(3)
    for j, joint in enumerate(arm_spec["joint"], 1):
        frame = plant.arm().data.body(f"frame{j}")
        com = frame.xmat.reshape(3, 3) @ joint["com_m"] + frame.xpos
        wanted += np.cross(com, [0.0, 0.0, -9.81 * joint["mass_kg"]])
    assert probe.moment_nm == pytest.approx(wanted, abs=1e-9)


def test_bending_of_one_link_moves_only_what_lies_beyond_it():
    pairs, _, bench = observations("bending[5]@5")
    bent, _ = pairs[0]
    arm = bench.plant.arm(bent.at.payload_kg)
    where = {}
    for name, effects in (("straight", []), ("bent", bench.hide()[0])):
        bench.plant.settle(bent.at, effects)
        where[name] = [arm.data.body(f"frame{j}").xpos.copy() for j in range(8)]
    moved = np.linalg.norm(np.array(where["bent"]) - where["straight"], axis=1)
    assert moved[:5].max() < 1e-12 and moved[5:].min() > 1e-6


def test_friction_windup_remembers_where_the_joint_came_from():
    rest = np.zeros(1)
    up = campaign.dahl_friction(rest, np.array([0.2]))
    assert up[0] == pytest.approx(1.0, abs=1e-5)
    small_return = campaign.dahl_friction(up, np.array([-0.005]))
    assert -1.0 < small_return[0] < 1.0 and small_return[0] != pytest.approx(-1.0, abs=0.1)
    assert campaign.dahl_friction(up, np.array([-0.2]))[0] == pytest.approx(-1.0, abs=1e-5)


@pytest.mark.parametrize(("kind", "axis"), [("tag_size", None), ("focal", 2)])
def test_scale_errors_of_camera_and_tag_scale_what_pnp_gives(kind, axis):
    """A tag larger by e comes out nearer by e in all three; a longer focal length only in depth."""
    pairs, described, bench = observations(f"{kind}@2")
    e = described[0]["theta"][0][0]
    for wrong, healthy in pairs:
        ratio = wrong.T_cam_tag[:3, 3] / healthy.T_cam_tag[:3, 3]
        assert ratio[2] == pytest.approx(1 / (1 + e), rel=1e-3)
        wanted = 1.0 if axis == 2 else 1 / (1 + e)
        assert np.allclose(ratio[:2], wanted, rtol=1.5e-3)
    assert bench.optics.tag_size_m == 0.06


def test_radial_distortion_changes_the_range_twice_as_much_as_the_direction():
    """u' = u (1 + k r^2) makes a small tag look larger by 1 + 2 k r^2, averaged over its inclinations."""
    table = optics.nominal(load_spec())
    lens = optical_effects.Lens(radial=(0.02, 0.0)).optics(SimpleNamespace(camera_temp_c=20.0), table)
    p = np.array([0.5, 0.2, 1.2])
    seen = []
    for spin in np.linspace(0, 2 * np.pi, 16, endpoint=False):
        T = transforms.trans(*p) @ transforms.rot("z", spin) @ transforms.rot("y", 0.5)
        seen.append(optics.solve_pnp(table, optics.image(lens, T), T)[:3, 3])
    change = np.mean(seen, axis=0) / p - 1.0
    k_r2 = 0.02 * (p[0] ** 2 + p[1] ** 2) / p[2] ** 2
    assert change[2] == pytest.approx(-2 * k_r2, rel=0.25)
    assert change[0] - change[2] == pytest.approx(k_r2, rel=0.1)


@pytest.mark.parametrize("kind", sorted(kinds.KINDS))
def test_every_kind_shows_in_the_observations_and_is_reproducible(kind):
    pairs, described, _ = observations(kind, n=6)
    again, described_again, _ = observations(kind, n=6)
    assert described == described_again
    for (a, healthy), (b, _) in zip(pairs, again, strict=True):
        assert np.array_equal(a.T_base_tool, b.T_base_tool) and np.isfinite(a.T_base_tool).all()
        assert np.abs(a.T_base_tool - healthy.T_base_tool).max() < 0.1
    assert max(np.abs(a.T_base_tool - healthy.T_base_tool).max() for a, healthy in pairs) > 1e-7


def test_a_fixed_pan_tilt_unit_makes_camera_shift_and_base_motion_the_same():
    pairs, _, _ = observations("camera_shift", fixed_pantilt=True)
    change = [wrong.T_base_tool @ np.linalg.inv(healthy.T_base_tool) for wrong, healthy in pairs]
    assert np.abs(np.array(change) - change[0]).max() < 1e-9
