"""Calibrations through pixels, many of them: is the stated sigma of the correction what its error is?

    python tests/bench/sigma.py [--runs 40] [--poses N] [--seed 1] [--frames measured|all] [--floor]
                                [--out FILE]

Each run is a calibration by kincal.run.inprocess.simulate of an arm with errors inside the bounds of
tables/src/space.toml (run 0: the paper's set; the others: all 28 even between half their bounds). Frames
are drawn, compressed and detected (pixels.py), one process of the detector for all runs. With --frames
measured (the default) frames that only aim or search take the detections of fast mode.

The simulated camera has no lens error, stands where CAMERA says, and its tags have exactly the printed size.
So CONFIG's floor of a measurement's sigma (sigma_pos_min_m, sigma_rot_min_rad) and CAMERA's stated errors are
taken away, unless --floor says otherwise: they stand for those, and with them the stated sigma is larger than
the error, as it should be here. camera_chain.py draws errors of the chain.

Checked: the normalised error squared of the coefficients that were determined, e' C^-1 e with the
covariance of the proposal, against chi-square. Its mean over the runs lies in the 95 % band of its
expectation. One line per run goes to FILE at once; runs that are in it already are skipped. Exit status 1
if it does not, or if a run has no correction.
"""

import argparse
import json
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402
from scipy.stats import chi2  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]

import missions  # noqa: E402
from montecarlo import bounds, coefficient_errors, paper  # noqa: E402
from pixels import Detector, DrawnImager  # noqa: E402

from kincal.flight import tables as codec  # noqa: E402
from kincal.run.inprocess import TABLES, Setup, Tick, simulate  # noqa: E402
from kincal_sim.scenario import ArmTruth, load  # noqa: E402

CHAIN_SIGMAS = (
    *("mast_sigma_m", "mast_sigma_rad", "zero_sigma_rad", "axis_sigma_rad", "tag_size_sigma"),
    *("plate_sigma_m", "plate_sigma_rad", "drift_sigma_m_s", "drift_sigma_rad_s"),
)


def exact_tables(folder: Path) -> Path:
    """The shipped tables, with CONFIG and CAMERA as if nothing were common to all frames."""
    made = folder / "tables"
    shutil.copytree(TABLES, made)
    _, config = codec.decode_as("config", (made / "config.tbl").read_bytes())
    config.sigma_pos_min_m = config.sigma_rot_min_rad = 1e-9
    (made / "config.tbl").write_bytes(codec.encode("config", config).data)
    _, camera = codec.decode_as("camera", (made / "camera.tbl").read_bytes())
    for name in CHAIN_SIGMAS:
        setattr(camera, name, 0.0)
    (made / "camera.tbl").write_bytes(codec.encode("camera", camera).data)
    return made


def truth(seed: int, run: int) -> dict[str, float]:
    """The errors of the arm of a run."""
    if run == 0:
        return paper()
    rng = np.random.default_rng([seed, run])
    return {name: float(rng.uniform(-0.5, 0.5) * bound) for name, bound in bounds().items()}


def fly(run: int, seed: int, imager: DrawnImager, tables: Path, poses: int) -> dict:
    """One calibration."""
    errors, before = truth(seed, run), imager.n_drawn
    scenario = load("paper").model_copy(update={"arm": ArmTruth(errors=errors)})

    def each_tick(tick: Tick) -> bool:
        imager.see(tick)
        return True

    setup = Setup(tables=tables, world=imager.world, poses=poses)
    begun = time.process_time()
    flown = simulate(scenario, 1000 * seed + run, setup, each_tick=each_tick)
    proposal = flown.log.last_session.proposal
    line = {"run": run, "reason": flown.record.get("reason"), "frames": imager.n_drawn - before}
    if proposal is not None:
        value, n = missions.nees(proposal, errors, missions.names("paper"))
        line |= {"nees": value, "n": n, "noise_scale": proposal.noise_scale, "p_fit": proposal.p_fit}
        line |= {"outliers": proposal.n_outliers, "verdict": proposal.verdict, "poses": proposal.n_poses}
        found, sigma = coefficient_errors(proposal.value), proposal.sigma
        z = [(found[k] - errors.get(k, 0.0)) / s for k, s in zip(found, sigma, strict=False) if s > 0.0]
        line["beyond_3_sigma"] = int(np.sum(np.abs(z) > 3.0))
    return line | {"cpu_s": round(time.process_time() - begun, 1)}


def summary(lines: list[dict]) -> bool:
    """Print the figures; whether the criterion is met."""
    good = [line for line in lines if "nees" in line]
    for line in lines:
        print(line)
    if not good:
        return False
    n, total = sum(line["n"] for line in good), sum(line["nees"] for line in good)
    low, high = (chi2.ppf(p, n) / n for p in (0.025, 0.975))
    inside = sum(chi2.ppf(0.025, x["n"]) <= x["nees"] <= chi2.ppf(0.975, x["n"]) for x in good)
    values = sum(line["n"] for line in good)
    beyond = sum(line["beyond_3_sigma"] for line in good)
    print(
        f"{len(good)} of {len(lines)} runs with a correction, {sum(x['frames'] for x in lines)} frames drawn"
    )
    print(f"normalised error squared per coefficient {total / n:.3f}, 95 % band {low:.3f} to {high:.3f}")
    print(f"inside the 95 % band of a single run: {inside} of {len(good)}; median noise scale", end=" ")
    print(f"{np.median([x['noise_scale'] for x in good]):.2f}; beyond 3 sigma: {beyond} of {values}")
    return len(good) == len(lines) and low <= total / n <= high


def main(argv: list[str] | None = None) -> int:
    """The bench; exit status as above."""
    p = argparse.ArgumentParser(prog="sigma.py", description=(__doc__ or "").split("\n")[0])
    p.add_argument("--runs", type=int, default=40)
    p.add_argument("--poses", type=int, default=0, help="of a run, besides the local ones (0: CONFIG's)")
    p.add_argument("--seed", type=int, default=1)
    p.add_argument("--frames", choices=("measured", "all"), default="measured")
    p.add_argument("--floor", action="store_true", help="with CONFIG's floor and CAMERA's sigmas")
    p.add_argument("--out", type=Path, default=ROOT / "build" / "sigma.jsonl")
    o = p.parse_args(argv)
    lines = [json.loads(x) for x in o.out.read_text().splitlines()] if o.out.exists() else []
    with tempfile.TemporaryDirectory() as folder:
        detector = Detector(Path(folder))
        imager = DrawnImager(detector, o.frames == "all")
        tables = TABLES if o.floor else exact_tables(Path(folder))
        for run in sorted(set(range(o.runs)) - {line["run"] for line in lines}):
            lines.append(fly(run, o.seed, imager, tables, o.poses))
            with o.out.open("a") as f:
                print(json.dumps(lines[-1]), file=f)
            print(f"run {run}: {lines[-1]}", file=sys.stderr, flush=True)
        detector.close()
    return 0 if summary(lines[: o.runs]) else 1


if __name__ == "__main__":
    sys.exit(main())
