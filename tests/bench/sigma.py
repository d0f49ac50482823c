"""Calibrations through pixels, many of them: is the stated sigma of the correction what its error is?

    python tests/bench/sigma.py [--runs 40] [--seed 1] [--frames measured|all] [--floor] [--out FILE]

Each run is a calibration by kincal.run.inprocess.simulate of an arm with errors inside the bounds of
tables/src/space.toml (run 0: the paper's set; the others: all 28 even between half their bounds). Frames
are drawn by the simulator's camera about the tags only (Camera.render_tags), compressed, and given to the
tag detector, one process for all runs. With --frames measured (the default) frames that only aim or servo
take the detections of fast mode: they are not measured. A scene that rests is drawn once; each frame has
noise, compression and detection of its own.

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
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import cv2  # noqa: E402
import numpy as np  # noqa: E402
from scipy.stats import chi2  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]

import missions  # noqa: E402
from montecarlo import bounds, coefficient_errors, paper  # noqa: E402

import kcm  # noqa: E402
from kincal.flight import library  # noqa: E402
from kincal.flight import tables as codec  # noqa: E402
from kincal.run.inprocess import TABLES, Setup, Tick, simulate  # noqa: E402
from kincal_sim.randomness import generator  # noqa: E402
from kincal_sim.scenario import ArmTruth, Scenario, load  # noqa: E402
from kincal_sim.vision.camera import Camera, TagsRadiance, load_config  # noqa: E402
from kincal_sim.vision.imagers import Imager, fast_imager  # noqa: E402
from kincal_sim.world import World  # noqa: E402

TAGDET = ROOT / "build" / "kincal-tagdet"
CONFIG = ROOT / "sim" / "models" / "detector.yml"
MEASURE = library("flight").constant("KC_ST_MEASURE")
JPEG_QUALITY = 75  # what whole frames of this scene end up with
CHAIN_SIGMAS = (
    *("mast_sigma_m", "mast_sigma_rad", "zero_sigma_rad", "axis_sigma_rad", "tag_size_sigma"),
    *("plate_sigma_m", "plate_sigma_rad", "drift_sigma_m_s", "drift_sigma_rad_s"),
)


class Detector:
    """The tag detector as one process: a JPEG in, the fields of a detection out."""

    def __init__(self, folder: Path):
        self._image = folder / "frame.jpg"
        command = [str(TAGDET), "--config", str(CONFIG), "--image", "-"]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def detect(self, jpeg: bytes) -> dict:
        """What the detector prints about an image."""
        self._image.write_bytes(jpeg)
        print(self._image, file=self._process.stdin, flush=True)
        return json.loads(self._process.stdout.readline())

    def close(self) -> None:
        """End the process."""
        self._process.stdin.close()
        self._process.wait()


class DrawnImager:
    """Draws a frame, compresses it and has it detected; `drawn` says which, others are of fast mode."""

    def __init__(self, detector: Detector, drawn: Callable[[], bool]):
        self.detector, self.drawn = detector, drawn
        self.n_drawn = 0
        self._scene: tuple[bytes, TagsRadiance | None] = (b"", None)

    def make(self, scenario: Scenario, arm, seed: int) -> Imager:
        """As the functions of kincal_sim.vision.imagers."""
        config = load_config(arm.spec, optics=scenario.optics.changes())
        camera = Camera(config, arm.model)
        rng, fast = generator(seed, "camera"), fast_imager(scenario, arm, seed)

        def expose(exposure):
            if not self.drawn():
                return fast.expose(exposure)
            self.n_drawn += 1
            key = exposure.T_base_cam.tobytes() + exposure.T_base_tool.tobytes()
            if self._scene[0] != key:
                self._scene = key, camera.tags_radiance(arm.data, exposure.T_base_cam, exposure.T_base_tool)
            image = camera.expose_tags(self._scene[1], rng)
            _, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
            return message(self.detector.detect(jpeg.tobytes()), exposure)

        return Imager("KC_DETECTION", expose)


def message(fields: dict, exposure) -> kcm.detection_t:
    """A detection as the detector would publish it."""
    m = kcm.detection_t()
    for name in (set(m.__slots__) & set(fields)) - {"t_us", "seq"}:
        setattr(m, name, fields[name])
    m.t_us, m.seq = exposure.t_us, exposure.seq
    return m


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


def fly(run: int, seed: int, imager: DrawnImager, state: list[int], tables: Path) -> dict:
    """One calibration; state[0] is flight's, for the imager."""
    errors, before = truth(seed, run), imager.n_drawn
    scenario = load("paper").model_copy(update={"arm": ArmTruth(errors=errors)})

    def each_tick(tick: Tick) -> bool:
        state[0] = tick.state
        return True

    setup = Setup(tables=tables, world=lambda s, n: World(s, n, imager.make))
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
    p.add_argument("--seed", type=int, default=1)
    p.add_argument("--frames", choices=("measured", "all"), default="measured")
    p.add_argument("--floor", action="store_true", help="with CONFIG's floor and CAMERA's sigmas")
    p.add_argument("--out", type=Path, default=ROOT / "build" / "sigma.jsonl")
    o = p.parse_args(argv)
    lines = [json.loads(x) for x in o.out.read_text().splitlines()] if o.out.exists() else []
    with tempfile.TemporaryDirectory() as folder:
        detector, state = Detector(Path(folder)), [0]
        imager = DrawnImager(detector, lambda: o.frames == "all" or state[0] == MEASURE)
        tables = TABLES if o.floor else exact_tables(Path(folder))
        for run in sorted(set(range(o.runs)) - {line["run"] for line in lines}):
            lines.append(fly(run, o.seed, imager, state, tables))
            with o.out.open("a") as f:
                print(json.dumps(lines[-1]), file=f)
            print(f"run {run}: {lines[-1]}", file=sys.stderr, flush=True)
        detector.close()
    return 0 if summary(lines[: o.runs]) else 1


if __name__ == "__main__":
    sys.exit(main())
