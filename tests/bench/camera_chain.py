"""Errors of the camera chain that flight does not estimate: are its stated errors true?

    python tests/bench/camera_chain.py [--seeds 20] [--first 1] [--jobs 2] [--only CASE ...] [--out FILE]

Each run is a calibration by kincal.run.inprocess.simulate in which the camera is not where flight takes it to be.
Cases
- exact: as flight's CAMERA table says
- stated: all 24 errors and the drift drawn from the 1-sigma values that CAMERA states
- three_sigma: each of them drawn evenly between -3 and 3 times its 1-sigma value
- drift: the steady drift alone, three times as large as stated, in a random direction
- tilt_2_mrad, tilt_5_mrad, camera_3_mm, plate_3_mm, drift_10_mm, drift_20_mm: one error; a drift in 400 s
Scenarios: healthy, paper, one slipped joint, and an uplinked effect (compliance of the elbow, estimated with the
DH errors). Each is flown with the executive's limits and with the policy on board.

The errors act on the simulator's camera and tags; nothing of flight's model of the chain is used. Held against the
truth of MuJoCo at the 200 held-out poses of a run, with the correction that was proposed
- camera: where the tool is, against where the camera sees it (drift as at the end of the calibration)
- lander: in the base frame
- normalised error squared of the coefficients that were determined, with the covariance of the proposal.

Checked
- stated: the mean normalised error squared lies in the 95 % band of its expectation (chi-square, runs
  independent).
- exact, stated, three_sigma, drift: no correction became active with a true error beyond 4 times the predicted one,
  in the frame of CONFIG.
One line per run goes to FILE at once; runs that are in it already are skipped. Exit status 1 if a check fails.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import shutil
import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402
from scipy.stats import chi2  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / folder) for folder in ("ground", "sim", "build/py")]

from kincal.flight import library  # noqa: E402
from kincal.flight import tables as codec  # noqa: E402
from kincal.run.evaluate import Evaluator, GroundTruth  # noqa: E402
from kincal.run.inprocess import TABLES, Setup, simulate  # noqa: E402
from kincal_sim.arm import load_spec  # noqa: E402
from kincal_sim.imagers import Imager, fast_imager  # noqa: E402
from kincal_sim.plant import AtRest, turn  # noqa: E402
from kincal_sim.scenario import ArmTruth, Scenario, load  # noqa: E402
from kincal_sim.transforms import rot, transform  # noqa: E402
from kincal_sim.truth import build_plant, truth_record  # noqa: E402
from kincal_sim.world import World  # noqa: E402

CASES = (
    "exact",
    "stated",
    "three_sigma",
    "drift",
    "tilt_2_mrad",
    "tilt_5_mrad",
    "camera_3_mm",
    "plate_3_mm",
    "drift_10_mm",
    "drift_20_mm",
)
WITHIN = ("exact", "stated", "three_sigma", "drift")
SCENARIOS = ("healthy", "paper", "slipped", "uplinked")
ACCEPT = ("auto", "policy")
BEYOND = 4.0  # times the predicted error
DRIFT_S = 400.0
RUNS_OF_PROCESS = 100
FLIGHT = library("flight")
KIN = FLIGHT.constant("KC_TBL_KIN")


# ---- what is wrong with the camera ------------------------------------------------------------------------


@dataclass(frozen=True)
class Chain:
    """Errors of camera and tags. mast, drift (per second), plate: position [m] and rotation vector [rad], (6,);
    mast and drift in the axes of the mast, about its pan-tilt unit; plate: tags on the tool, in its frame; zero_rad:
    pan, tilt; axis_rad: tilt axis about the forward axis, camera about the forward and up axes of its mount;
    size: edges of the tags, relative."""

    mast: np.ndarray = field(default_factory=lambda: np.zeros(6))
    drift: np.ndarray = field(default_factory=lambda: np.zeros(6))
    plate: np.ndarray = field(default_factory=lambda: np.zeros(6))
    zero_rad: np.ndarray = field(default_factory=lambda: np.zeros(2))
    axis_rad: np.ndarray = field(default_factory=lambda: np.zeros(3))
    size: float = 0.0

    def camera(self, pan_rad: float, tilt_rad: float, t_s: float) -> np.ndarray:
        """True T_base_cam (4x4) for these readings of the pan-tilt unit."""
        spec = load_spec()["pantilt"]
        off = self.mast + t_s * self.drift
        mast = transform(np.array(spec["mast_xyz_m"]) + off[:3], turn(off[3:]))
        to_tilt = rot("z", pan_rad + self.zero_rad[0]) @ rot("x", self.axis_rad[0])
        mount = transform(np.zeros(3), turn([self.axis_rad[1], 0.0, self.axis_rad[2]]))
        looks_along_x = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
        camera = transform(np.array(spec["camera_xyz_m"]), looks_along_x)
        return mast @ to_tilt @ rot("y", tilt_rad + self.zero_rad[1]) @ mount @ camera

    def tags(self, T_base_tool: np.ndarray) -> np.ndarray:
        """Where the tags make the tool seem to be (4x4)."""
        return T_base_tool @ transform(self.plate[:3], turn(self.plate[3:]))


def _direction(rng: np.random.Generator) -> np.ndarray:
    v = rng.standard_normal(3)
    return v / np.linalg.norm(v)


def sigmas() -> Chain:
    """1-sigma of every error, as the shipped CAMERA table states it."""
    _, c = codec.decode_as("camera", (TABLES / "camera.tbl").read_bytes())
    six = lambda m, rad: np.repeat([m, rad], 3)  # noqa: E731
    return Chain(
        six(c.mast_sigma_m, c.mast_sigma_rad),
        six(c.drift_sigma_m_s, c.drift_sigma_rad_s),
        six(c.plate_sigma_m, c.plate_sigma_rad),
        np.repeat(c.zero_sigma_rad, 2),
        np.repeat(c.axis_sigma_rad, 3),
        c.tag_size_sigma,
    )


def drawn(case: str, rng: np.random.Generator) -> Chain:
    """The errors of a case."""
    one, far = sigmas(), lambda mm: 1e-3 * mm * _direction(rng)
    if case in ("stated", "three_sigma"):
        draw = rng.standard_normal if case == "stated" else lambda n: rng.uniform(-3.0, 3.0, n)
        parts = {name: value * draw(np.size(value)) for name, value in vars(one).items()}
        return Chain(**{**parts, "size": float(parts["size"][0])})
    sign = float(rng.choice([-1.0, 1.0]))
    none = np.zeros(3)
    return {
        "exact": lambda: Chain(),
        "drift": lambda: Chain(
            drift=3.0 * np.concatenate([one.drift[0] * _direction(rng), one.drift[3] * _direction(rng)])
        ),
        "tilt_2_mrad": lambda: Chain(zero_rad=np.array([0.0, 0.002 * sign])),
        "tilt_5_mrad": lambda: Chain(zero_rad=np.array([0.0, 0.005 * sign])),
        "camera_3_mm": lambda: Chain(mast=np.concatenate([far(3.0), none])),
        "plate_3_mm": lambda: Chain(plate=np.concatenate([far(3.0), none])),
        "drift_10_mm": lambda: Chain(drift=np.concatenate([far(10.0), none]) / DRIFT_S),
        "drift_20_mm": lambda: Chain(drift=np.concatenate([far(20.0), none]) / DRIFT_S),
    }[case]()


class ChainWorld(World):
    """The simulator's world with these errors between arm and detections."""

    def __init__(self, scenario: Scenario, seed: int, chain: Chain):
        super().__init__(scenario, seed, lambda *args: self._scaled(fast_imager(*args)))
        self.chain = chain

    def _scaled(self, imager: Imager) -> Imager:
        def expose(exposure):
            m = imager.expose(exposure)
            for name in ("p_cam_tool_m", "p_alt_m"):
                setattr(m, name, [p / (1.0 + self.chain.size) for p in getattr(m, name)])
            return m

        return Imager(imager.channel, expose)

    def _take_frames(self, now_us: int, true: AtRest):
        pan, tilt = self.pantilt.trajectory.at(now_us * 1e-6)[0]
        seen = self.chain.camera(float(pan), float(tilt), now_us * 1e-6)
        return super()._take_frames(
            now_us, replace(true, T_base_cam=seen, T_base_tool=self.chain.tags(true.T_base_tool))
        )


# ---- a run ------------------------------------------------------------------------------------------------


def scenario_of(name: str, rng: np.random.Generator) -> Scenario:
    """One of SCENARIOS."""
    base = load(name if name in ("healthy", "paper") else "healthy")
    if name == "slipped":
        bias = {f"J{rng.integers(1, 8)}": float(rng.choice([-1.0, 1.0]) * rng.uniform(0.02, 0.09))}
        return base.model_copy(update={"name": name, "arm": ArmTruth(encoder_bias_rad=bias)})
    if name == "uplinked":
        size = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.001, 0.004))
        base = base.model_copy(deep=True, update={"name": name})
        base.arm = ArmTruth(compliance_rad_per_nm={"J4": abs(size)}, errors={"J2.phi_rad": 2.0 * size})
    return base


def _camera_at(q_tool_m: np.ndarray, chain: Chain, t_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Nominal and true T_base_cam, aimed at a point."""
    eye = np.array(load_spec()["pantilt"]["mast_xyz_m"])
    d = q_tool_m - eye
    pan, tilt = float(np.arctan2(d[1], d[0])), float(-np.arctan2(d[2], np.hypot(d[0], d[1])))
    return Chain().camera(pan, tilt, 0.0), chain.camera(pan, tilt, t_s)


def true_errors_m(coef: np.ndarray, evaluator: Evaluator, chain: Chain, t_s: float) -> tuple[float, float]:
    """RMS position error over the held-out poses: in the camera's frame, in the lander's."""
    model, true = evaluator._held_out.poses(coef), evaluator.truth.poses
    in_camera = []
    for p, t in zip(model.p_m, true.p_m, strict=True):
        nominal, seen = (np.linalg.inv(T) for T in _camera_at(t, chain, t_s))
        in_camera.append(np.linalg.norm((nominal @ [*p, 1.0] - seen @ [*t, 1.0])[:3]))
    lander = np.linalg.norm(model.p_m - true.p_m, axis=1)
    return float(np.sqrt(np.mean(np.square(in_camera)))), float(np.sqrt(np.mean(lander**2)))


def nees(proposal, errors: dict[str, float], names_: Iterable[str]) -> tuple[float, int]:
    """Normalised error squared of the determined coefficients, and their number."""
    n = proposal.n_coef
    C = np.zeros((n, n))
    C[np.triu_indices(n)] = proposal.cov[: n * (n + 1) // 2]
    C = C + np.triu(C, 1).T
    e = np.array([v - errors.get(k, 0.0) for k, v in zip(names_, proposal.value, strict=False)])
    use = np.flatnonzero(np.diag(C) > 0.0)
    scale = np.sqrt(np.diag(C)[use])
    z = e[use] / scale
    return float(z @ np.linalg.solve(C[np.ix_(use, use)] / np.outer(scale, scale), z)), len(use)


def fly(job: tuple[str, str, str, int]) -> dict:
    """One calibration."""
    case, name, accept, seed = job
    begun = time.process_time()
    at = CASES.index(case), SCENARIOS.index(name), seed
    rng = np.random.default_rng([81, *at])
    chain, scenario = drawn(case, rng), scenario_of(name, rng)
    setup = Setup(tables=tables_of(name, accept), accept=accept, world=lambda s, n: ChainWorld(s, n, chain))
    run = simulate(scenario, 100_000 * at[0] + 10_000 * at[1] + seed, setup)
    p = run.log.last_session.proposal if run.log.sessions else None
    line = {"case": case, "scenario": name, "accept": accept, "seed": seed, "reason": run.record["reason"]}
    if p is not None:
        truth = truth_record(scenario, build_plant(scenario), seed, "fast")
        evaluator = Evaluator(TABLES, GroundTruth.of(truth))
        camera, lander = true_errors_m(np.array(p.value[: p.n_coef]), evaluator, chain, run.mission_s)
        value, n = nees(p, truth["errors"], evaluator.names)
        line |= {"verdict": p.verdict, "active": run.record["table_crc_kin"] == f"{p.crc & 0xFFFFFFFF:08x}"}
        line |= {"camera_m": camera, "lander_m": lander, "nees": value, "n": n}
        line |= {
            k: getattr(p, k, None)
            for k in ("pred_pos_m", "pred_camera_pos_m", "pred_lander_pos_m", "p_fit", "p_no_change", "n_poses")
        }
        line["frame"] = getattr(p, "frame", 1)
    return line | {"cpu_s": round(time.process_time() - begun, 2)}


@cache
def tables_of(scenario: str, accept: str) -> Path:
    """The shipped tables; with the policy on board switched on, and with the uplinked effect."""
    folder = ROOT / "build" / "camera-chain" / f"{os.getpid()}-{scenario == 'uplinked'}-{accept}"
    shutil.copytree(TABLES, folder, dirs_exist_ok=True)
    if accept == "policy":
        _, config = codec.decode_as("config", (TABLES / "config.tbl").read_bytes())
        config.accept_on_board = 1
        (folder / "config.tbl").write_bytes(codec.encode("config", config).data)
    if scenario == "uplinked":
        _, terms = codec.decode_as("terms", (TABLES / "terms.tbl").read_bytes())
        terms.coef[list(Evaluator(TABLES).names).index("joint_compliance[4]")].enabled = 1
        image = codec.encode("terms", terms)
        _, kin = codec.decode_as("kin", (TABLES / "kin.tbl").read_bytes())
        kin.terms_crc = image.crc
        (folder / "terms.tbl").write_bytes(image.data)
        (folder / "kin.tbl").write_bytes(codec.encode("kin", kin).data)
    return folder


# ---- all of them ------------------------------------------------------------------------------------------


def _true(line: dict) -> float:
    return line["camera_m"] if line["frame"] == 0 else line["lander_m"]


def beyond(line: dict) -> bool:
    """Something is active that is farther off than it may be."""
    return bool(line.get("active")) and not _true(line) <= BEYOND * line["pred_pos_m"]


def summary(lines: list[dict]) -> bool:
    """Print a row for each case and scenario; whether all checks hold."""
    good = True
    for case in CASES:
        for name in SCENARIOS:
            of = [x for x in lines if (x["case"], x["scenario"]) == (case, name)]
            made = [x for x in of if "nees" in x]
            if not made:
                continue
            once = [x for x in made if x["accept"] == "auto"] or made
            n, total = sum(x["n"] for x in once), sum(x["nees"] for x in once)
            low, high = (chi2.ppf(p, n) / n for p in (0.025, 0.975))
            active = {a: sum(bool(x.get("active")) for x in of if x["accept"] == a) for a in ACCEPT}
            ratio = [_true(x) / x["pred_pos_m"] for x in made]
            wrong = sum(beyond(x) for x in made)
            mm = lambda key: 1e3 * float(np.median([x[key] for x in made]))  # noqa: E731
            print(
                f"{case:12s} {name:9s} runs {len(of):3d} active {active['auto']:3d} {active['policy']:3d} "
                f"no change {sum(x.get('verdict') == 0 for x in once):3d} poor {sum(x.get('verdict') == 2 for x in once):3d} | "
                f"nees {total / n:6.3f} [{low:.3f} {high:.3f}] | mm: camera {mm('camera_m'):.2f} lander "
                f"{mm('lander_m'):.2f} predicted {mm('pred_pos_m'):.2f} | true/predicted median {np.median(ratio):.2f} "
                f"max {max(ratio):.2f} | beyond {wrong}"
            )
            good &= case != "stated" or low <= total / n <= high
            good &= case not in WITHIN or not wrong
    return good


def main(argv: list[str] | None = None) -> int:
    """The bench; exit status as above."""
    p = argparse.ArgumentParser(prog="camera_chain.py", description=(__doc__ or "").split("\n")[0])
    p.add_argument("--seeds", type=int, default=20)
    p.add_argument("--first", type=int, default=1, help="first seed")
    p.add_argument("--jobs", type=int, default=2)
    p.add_argument("--only", nargs="*", default=CASES, choices=CASES)
    p.add_argument("--accept", nargs="*", default=ACCEPT, choices=ACCEPT)
    p.add_argument("--out", type=Path, default=ROOT / "build" / "camera_chain.jsonl")
    o = p.parse_args(argv)
    o.out.parent.mkdir(parents=True, exist_ok=True)
    lines = [json.loads(x) for x in o.out.read_text().splitlines()] if o.out.exists() else []
    done = {(x["case"], x["scenario"], x["accept"], x["seed"]) for x in lines}
    seeds = range(o.first, o.first + o.seeds)
    jobs = [(c, s, a, n) for n in seeds for c in o.only for s in SCENARIOS for a in o.accept]
    jobs = [job for job in jobs if job not in done]
    with multiprocessing.Pool(o.jobs, maxtasksperchild=RUNS_OF_PROCESS) as pool, o.out.open("a") as out:
        for line in pool.imap_unordered(fly, jobs):
            print(json.dumps(line), file=out, flush=True)
            lines.append(line)
    return 0 if summary(lines) else 1


if __name__ == "__main__":
    sys.exit(main())
