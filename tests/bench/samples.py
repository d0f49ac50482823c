"""Held-out error against the number of poses, for every acquisition: the specification's table.

    python tests/bench/samples.py [--quick] [--seeds 20] [--space tables/bin/space.tbl] [--json FILE]

The flight core's estimator, GP and acquisitions (shared library) against an arm they know nothing of:
MuJoCo bodies moved by the paper's error set. Nothing of the flight kinematics enters the ground truth.

Without --space: the bare 7-DOF WAM (no base or tool offset), 600 candidates sampled anew for each seed
uniformly between the joint limits, the first 3 poses at random, then one at a time by the acquisition. A
candidate's pose is the one the TRUE arm has at the candidate's joints: what the visual servo is asked to
reach, reached. Measured: that pose with 0.5 mm and 0.2 deg, 1-sigma each axis; joints are read
without error. Held out: 300 other random joint vectors; RMS distance of the corrected model's tool point
from the true one.

With --space: the scenario's arm and candidate table. A candidate's pose is the nominal one of its
joints, as in flight; the joints measured are those that put the TRUE arm there (found on the MuJoCo
model, within limits; candidates it can't reach are unusable). Held out: a third of the candidates, at
most 300, sampled anew for each seed. The specification's figures are for the unrestricted set: here they
are compared from 11 poses on. Fewer poses of a narrow space tell less whoever chooses them; GP-UCB in
particular is no better than random there until about 15 (median 1.5 mm at 8 poses against the
specification's 0.99).

Both: estimator from nominal start, kernel and weights of tables/src, f recomputed with every new
correction. Two processes; the same figures every time. Exit 1 if a figure is clearly worse than the
specification's (see `worse`).
"""

import argparse
import json
import multiprocessing
import sys
import time
import tomllib
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from servoed import true_joints

from kincal.flight import library
from kincal.flight.kernel import spectral_table
from kincal.rotations import wxyz_of_matrix
from kincal.space import SpaceTable
from kincal_sim.mechanics import arm as sim_arm
from kincal_sim.mechanics.spec import load_spec

ROOT = Path(__file__).resolve().parents[2]
FLIGHT = library("flight")
ffi, lib = FLIGHT.ffi, FLIGHT.lib
ACQUISITIONS = ("random", "ucb", "dopt", "vopt")
CODE = {"ucb": lib.KC_ACQ_UCB, "random": lib.KC_ACQ_RANDOM, "dopt": lib.KC_ACQ_DOPT, "vopt": lib.KC_ACQ_VOPT}
POSES = (5, 6, 8, 11, 15, 20)
N_INITIAL, N_CANDIDATES, N_HELD_OUT = 3, 600, 300
SIGMA_POS_M, SIGMA_ROT_RAD = 0.5e-3, np.deg2rad(0.2)
ERRORS = {"J7.phi_rad": 1.3, "J2.alpha_rad": 0.4, "J3.a_m": 0.01, "J3.d_m": 0.15}

# The specification's figures: median and, where given, 90th percentile of 10 seeds [mm].
REFERENCE = {
    "random": {"median": (9.0, 3.2, 1.24, 0.84, 0.64, 0.53), "p90": (None, 31.3, None, 1.99, 1.07, 0.89)},
    "ucb": {"median": (4.9, 2.9, 0.99, 0.78, 0.77, 0.61), "p90": (None, 25.3, None, 1.31, 0.96, 0.86)},
    "dopt": {"median": (2.5, 1.6, 0.86, 0.68, 0.59, 0.50), "p90": (None, 3.2, None, 1.20, 0.86, 0.68)},
    "vopt": {"median": (3.6, 1.6, 0.97, 0.69, 0.59, 0.50), "p90": (None, 5.8, None, 1.12, 0.81, 0.71)},
}
REFERENCE_SEEDS = 10


# ------------------------------------------------------------------------------------------------- truth


def true_arm(bare: bool) -> sim_arm.Arm:
    """MuJoCo's arm with the paper's errors; bare: without base and tool offset."""
    spec = load_spec()
    if bare:
        spec["base"]["xyz_m"] = spec["tool"]["xyz_m"] = [0.0, 0.0, 0.0]
    return sim_arm.Arm(spec, ERRORS)


def true_poses(arm: sim_arm.Arm, q: np.ndarray) -> np.ndarray:
    """Tool poses (n, 4, 4) at joints (n, joints)."""
    poses = np.empty((len(q), 4, 4))
    for i, qi in enumerate(q):
        arm.set(qi)
        poses[i] = arm.T_base_tool
    return poses


def rotation(w: np.ndarray) -> np.ndarray:
    """Rotation matrix of a rotation vector [rad] (Rodrigues)."""
    angle = np.linalg.norm(w)
    k = w / max(angle, 1e-300)
    K = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


# --------------------------------------------------------------------------------------- the flight side


def flight_arm(spec: dict):
    """Nominal arm table from the simulator's plain numbers (the two keep their own copies of them)."""
    a = ffi.new("kc_arm_t *")
    a.n_joints = len(spec["joint"])
    for k, joint in zip(a.joint, spec["joint"], strict=False):
        k.phi_rad, k.alpha_rad = joint.get("phi_rad", 0.0), joint["alpha_rad"]
        k.a_m, k.d_m = joint["a_m"], joint["d_m"]
        k.q_min, k.q_max = joint["q_rad"]
        k.speed_max = 1.0
    a.base_xyz_m, a.tool_xyz_m = spec["base"]["xyz_m"], spec["tool"]["xyz_m"]
    a.base_quat_wxyz = a.tool_quat_wxyz = [1.0, 0.0, 0.0, 0.0]
    a.gravity_m_s2 = [0.0, 0.0, -9.81]
    return a


def source(name: str) -> dict:
    """A table source of tables/src."""
    with open(ROOT / "tables" / "src" / f"{name}.toml", "rb") as f:
        return tomllib.load(f)


def flight_terms(n_joints: int):
    """The DH errors, bounded and scaled as in tables/src/terms.toml."""
    dh = source("terms")["dh"]
    names = ("phi_rad", "alpha_rad", "a_m", "d_m")
    t = ffi.new("kc_terms_t *")
    bounds = [np.max(dh["bound"][n]) for n in names]  # one for all joints, or one each: the widest
    lib.kc_terms_add_dh(t, n_joints, bounds)
    for i in range(t.n_coef):
        t.coef[i].scale = dh["scale"][names[i % 4]]
        t.coef[i].enabled = 1
    return t


def flight_kernel():
    """The first set of tables/src/kernel.toml."""
    doc = source("kernel")
    k = ffi.new("kc_kernel_t *")
    k.arg = lib.KC_KERNEL_SO3 if doc["arg"] == "so3" else lib.KC_KERNEL_PAPER
    k.n_hyper, k.sigma_eps = 1, doc["sigma_eps"]
    h, entry = k.hyper[0], doc["set"][0]
    h.sigma_s, h.beta_m, h.kappa, h.nu = (entry[n] for n in ("sigma_s", "beta_m", "kappa", "nu"))
    table = spectral_table(doc["arg"], h.kappa, h.nu)
    h.n_w, h.trunc_err = len(table.w), table.trunc_err
    h.w[0 : h.n_w] = table.w.tolist()
    return k


@dataclass(frozen=True)
class Trial:
    """What one seed works with. Of n candidates: seeds that flight knows and joints q that are measured
    (n, joints), poses wanted and reached (n, 4, 4), and whether they can be taken (n,). Of the held-out
    postures: joints, and true poses."""

    seeds: np.ndarray
    q: np.ndarray
    wanted: np.ndarray
    reached: np.ndarray
    usable: np.ndarray
    held_q: np.ndarray
    held_poses: np.ndarray

    @property
    def known(self) -> bool:
        """Whether the seeds are the joints of the measurement; else they are for the nominal arm."""
        return self.seeds is self.q


class Calibration:
    """What flight does between measurements, on the flight core's own structures."""

    def __init__(self, spec: dict):
        config = source("config")
        self.arm = flight_arm(spec)
        self.terms = flight_terms(self.arm.n_joints)
        self.kernel = flight_kernel()
        self.est = ffi.new("kc_est_t *")
        self.gp = ffi.new("kc_gp_t *")
        self.info = ffi.new("kc_acq_work_t *")
        self.ev, self.loads = ffi.new("kc_eval_t *"), ffi.new("kc_loads_t *")
        names = ("a1", "sp_floor_m", "sq_floor_rad", "beta_scale", "vopt_len_m")
        self.weights = {name: config[name] for name in names}
        self.est.arm, self.est.terms = self.arm, self.terms
        for key, value in config["est"].items():
            setattr(self.est.opt, key, value)
        self.cov = np.diag([SIGMA_POS_M**2] * 3 + [SIGMA_ROT_RAD**2] * 3).ravel().tolist()
        self.cov_c = ffi.new("double[36]", self.cov)
        ik = {"iter_max": 8, "tol_pos_m": 0.005, "tol_rot_rad": 0.02, "margin": 0.0, "step_max": 0.3}
        self.ik = ffi.new("kc_ik_opt_t *", ik)

    def begin(self, seed: int, trial: Trial) -> None:
        """Forget everything measured; the candidates are those of a trial."""
        n, joints = len(trial.seeds), trial.seeds
        self.wanted, self.seeds = trial.wanted, None if trial.known else joints
        self.est.n_obs = 0
        self.est.coef = [0.0] * len(self.est.coef)
        self.points = ffi.new("kc_point_t[]", n)
        for point, T in zip(self.points, trial.wanted, strict=True):
            point.p_m, point.q_wxyz = T[:3, 3].tolist(), wxyz_of_matrix(T[:3, :3]).tolist()
        self.joints = np.zeros((n, 8), np.float32)
        self.joints[:, : joints.shape[1]] = joints
        self.joints_c = ffi.cast("float *", self.joints.ctypes.data)
        self.usable = ffi.new("uint8_t[]", trial.usable.astype(np.uint8).tobytes())
        self.n = n
        self.rng = ffi.new("uint64_t *", seed)
        assert lib.kc_gp_init(self.gp, self.kernel, 0, self.points, n) == lib.KC_OK

    def predict(self, ctx):
        """Tool pose of the corrected arm."""
        lib.kc_model_loads(self.arm, self.terms, self.est.coef, ctx, self.loads)
        lib.kc_model_eval(self.arm, self.terms, self.est.coef, ctx, self.loads, 0, self.ev)
        return self.ev.T

    def measure(self, candidate: int, q: np.ndarray, p: np.ndarray, R: np.ndarray) -> None:
        """Take the measurement of a candidate: joints [rad], tool position [m] and rotation."""
        obs = ffi.new("kc_obs_t *")
        obs.ctx.q[0 : len(q)] = q.tolist()
        obs.ctx.g_m_s2 = [0.0, 0.0, -9.81]
        obs.p_m, obs.q_wxyz, obs.cov, obs.has_rot = p.tolist(), wxyz_of_matrix(R).tolist(), self.cov, 1
        assert lib.kc_est_add(self.est, obs) == lib.KC_OK
        point = ffi.new("kc_point_t *", {"p_m": obs.p_m, "q_wxyz": obs.q_wxyz})
        assert lib.kc_gp_add(self.gp, point, 0.0, self.points) == lib.KC_OK
        self.usable[candidate] = 0

    def solve(self) -> int:
        """Estimate, then f of every measurement with the new correction."""
        status = lib.kc_est_solve(self.est)
        n, w = self.est.n_obs, self.weights
        dp, dr, y = ffi.new("double[64]"), ffi.new("double[64]"), ffi.new("double[64]")
        quat = ffi.new("double[4]")
        for i in range(n):
            obs = self.est.obs[i]
            T = self.predict(ffi.addressof(obs, "ctx"))
            dp[i] = np.linalg.norm(np.subtract(list(T.p_m), list(obs.p_m)))
            lib.kc_R_to_quat(T.R, quat)
            dr[i] = lib.kc_quat_dist_rad(quat, obs.q_wxyz)
        lib.kc_acq_objective(dp, dr, n, w["a1"], w["sp_floor_m"], w["sq_floor_rad"], y)
        lib.kc_gp_set_y(self.gp, y)
        return status

    def predict_joints(self) -> None:
        """As flight does: joints of the corrected arm at each candidate's wanted pose."""
        if self.seeds is None:
            return
        q, goal = ffi.new("double[8]"), ffi.new("kc_pose_t *")
        for c in range(self.n):
            if self.usable[c]:
                goal.p_m, goal.R = self.wanted[c][:3, 3].tolist(), self.wanted[c][:3, :3].ravel().tolist()
                q[0 : self.arm.n_joints] = self.seeds[c].tolist()
                lib.kc_ik_solve(self.arm, self.terms, self.est.coef, goal, self.ik, q, self.ev, ffi.NULL)
                self.joints[c] = list(q)

    def choose(self, acquisition: str) -> int:
        """The next candidate."""
        c, value, w = ffi.new("uint32_t *"), ffi.new("double *"), self.weights
        if acquisition == "random":
            status = lib.kc_acq_random(self.usable, self.n, self.rng, c)
        elif acquisition == "ucb":
            beta = lib.kc_acq_beta(self.n, self.gp.n + 1, w["beta_scale"])
            status = lib.kc_acq_ucb(self.gp, self.usable, beta, c, value)
        else:
            self.predict_joints()
            kind, length = CODE[acquisition], w["vopt_len_m"]
            status = lib.kc_acq_info(
                kind, self.est, self.joints_c, self.n, self.usable, self.cov_c, length, self.info, c, value
            )
        assert status == lib.KC_OK, status
        return c[0]

    def held_out_mm(self, q: np.ndarray, poses: np.ndarray) -> float:
        """RMS position error over held-out joints (n, joints) with true poses (n, 4, 4)."""
        ctx = ffi.new("kc_ctx_t *")
        ctx.g_m_s2 = [0.0, 0.0, -9.81]
        total = 0.0
        for qi, T in zip(q, poses, strict=True):
            ctx.q[0 : len(qi)] = qi.tolist()
            total += np.sum((np.array(list(self.predict(ctx).p_m)) - T[:3, 3]) ** 2)
        return 1e3 * float(np.sqrt(total / len(q)))


# --------------------------------------------------------------------------------------------- one session


class BareArm:
    """Candidates are random joint vectors of the bare arm."""

    def __init__(self):
        self.truth = true_arm(bare=True)

    def sample(self, rng: np.random.Generator) -> Trial:
        """Candidates and held-out postures of one seed."""
        lo, hi = self.truth.q_min, self.truth.q_max
        q = rng.uniform(lo, hi, (N_CANDIDATES, len(lo)))
        held = rng.uniform(lo, hi, (N_HELD_OUT, len(lo)))
        poses = true_poses(self.truth, q)
        return Trial(q, q, poses, poses, np.ones(len(q), bool), held, true_poses(self.truth, held))


class SearchSpace:
    """Candidates of a table; the true arm is brought to each nominal pose once."""

    def __init__(self, path: str):
        self.truth, nominal = true_arm(bare=False), sim_arm.Arm(load_spec(), {})
        self.q = SpaceTable.load(Path(path))[1].q_rad
        self.wanted = true_poses(nominal, self.q)
        found = [true_joints(self.truth, T, q) for T, q in zip(self.wanted, self.q, strict=True)]
        self.usable = np.array([f is not None for f in found])
        self.true_q = np.array([q if f is None else f for f, q in zip(found, self.q, strict=True)])
        self.reached = true_poses(self.truth, self.true_q)

    def sample(self, rng: np.random.Generator) -> Trial:
        """Held-out candidates of one seed, and the others to choose among."""
        order = rng.permutation(np.flatnonzero(self.usable))
        held = order[: min(N_HELD_OUT, len(order) // 3)]
        usable = self.usable.copy()
        usable[held] = False
        ours = (self.q, self.true_q, self.wanted, self.reached)
        return Trial(*ours, usable, self.true_q[held], self.reached[held])


def session(seed: int, acquisition: str, site, cal: Calibration, poses) -> list[float]:
    """Held-out error [mm] after each number of poses."""
    rng = np.random.default_rng(seed)
    trial = site.sample(rng)
    cal.begin(seed, trial)
    chosen = [int(c) for c in rng.choice(np.flatnonzero(trial.usable), N_INITIAL, replace=False)]
    figures = []
    for n in range(1, max(poses) + 1):
        c = chosen[n - 1] if n <= N_INITIAL else cal.choose(acquisition)
        T = trial.reached[c]
        p = T[:3, 3] + rng.normal(0.0, SIGMA_POS_M, 3)
        cal.measure(c, trial.q[c], p, rotation(rng.normal(0.0, SIGMA_ROT_RAD, 3)) @ T[:3, :3])
        if n >= N_INITIAL:
            cal.solve()
        if n in poses:
            figures.append(cal.held_out_mm(trial.held_q, trial.held_poses))
    return figures


_worker: dict = {}


def _start(space: str | None) -> None:
    site = SearchSpace(space) if space else BareArm()
    _worker.update(site=site, cal=Calibration(site.truth.spec))


def _job(job):
    seed, acquisition, poses = job
    return session(seed, acquisition, _worker["site"], _worker["cal"], poses)


def measure(seeds: int, acquisitions, poses, space: str | None = None) -> dict[str, np.ndarray]:
    """acquisition -> (seeds, poses) held-out RMS [mm]."""
    jobs = [(seed, a, poses) for a in acquisitions for seed in range(seeds)]
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(2, mp_context=spawn, initializer=_start, initargs=(space,)) as pool:
        rows = list(pool.map(_job, jobs, chunksize=2))
    return {a: np.array(rows[i * seeds : (i + 1) * seeds]) for i, a in enumerate(acquisitions)}


# ------------------------------------------------------------------------------------------------ verdict


def worse(figures: np.ndarray, reference: float, quantile: float) -> bool:
    """Whether a measured quantile is clearly worse than the reference's.

    Both are quantiles of few seeds. Bootstrap of our seeds gives the spread of our quantile and, drawing
    only REFERENCE_SEEDS of them and centring on the reference, the spread the reference must have had.
    Worse: ours is the larger in more than 99.5 % of the pairs (40 figures are compared, so 1 in 200 leaves
    few false alarms).
    """
    rng = np.random.default_rng(1)
    ours = np.quantile(rng.choice(figures, (4000, len(figures))), quantile, axis=1)
    draws = np.quantile(rng.choice(figures, (4000, REFERENCE_SEEDS)), quantile, axis=1)
    theirs = reference * draws / np.quantile(figures, quantile)
    return bool(np.mean(ours > theirs) > 0.995)


def table(results: dict[str, np.ndarray], poses, compared_from: int) -> tuple[list[str], int]:
    """Lines to print, and how many figures are clearly worse than the specification's (marked !)."""
    lines = [
        "held-out position RMS [mm], median / 90th percentile; below each: specification",
        f"{'poses':10s}" + "".join(f"{n:>15d}" for n in poses),
    ]
    bad = 0
    for a, rows in results.items():
        median, p90 = np.median(rows, axis=0), np.quantile(rows, 0.9, axis=0)
        pairs = zip(median, p90, strict=True)
        lines.append(f"{a:10s}" + "".join(f"{m:8.2f} /{p:5.2f}" for m, p in pairs))
        line = f"{'':10s}"
        for i, n in enumerate(poses):
            cell = []
            for key, quantile in (("median", 0.5), ("p90", 0.9)):
                ref = REFERENCE[a][key][POSES.index(n)]
                flag = ref is not None and n >= compared_from and worse(rows[:, i], ref, quantile)
                bad += flag
                cell.append(("-" if ref is None else f"{ref:.2f}") + ("!" if flag else ""))
            line += f"{cell[0]:>8s} /{cell[1]:>5s}"
        lines.append(line)
    return lines, bad


def main() -> int:
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=raw)
    parser.add_argument("--quick", action="store_true", help="4 seeds, up to 8 poses: is it sane")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--space", help="candidate table of a scenario")
    parser.add_argument("--acquisition", action="append", choices=ACQUISITIONS)
    parser.add_argument("--json", type=Path, help="write all figures there")
    args = parser.parse_args()
    seeds, poses = (4, POSES[:3]) if args.quick else (args.seeds, POSES)
    start = time.monotonic()
    results = measure(seeds, args.acquisition or ACQUISITIONS, poses, args.space)
    lines, bad = table(results, poses, compared_from=11 if args.space else 0)
    print("\n".join(lines))
    print(f"{seeds} seeds, {time.monotonic() - start:.0f} s, clearly worse figures (!): {bad}")
    if args.json:
        args.json.write_text(json.dumps({a: rows.tolist() for a, rows in results.items()}))
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
