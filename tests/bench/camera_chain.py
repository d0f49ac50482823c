"""Errors of the camera chain that flight does not estimate: are its stated errors true?

    python tests/bench/camera_chain.py [--seeds 20] [--first 1] [--jobs 2] [--only CASE ...] [--out FOLDER]

Each run is a calibration by kincal.run.inprocess.simulate in which the camera is not where flight takes it
to be. Cases
- exact: as flight's CAMERA table says
- stated: all 24 errors and the drift drawn from the 1-sigma values that CAMERA states, and an error of each
  posture as large as CONFIG's floor of a measurement's sigma adds to it: what the lens does
- chain_only: the same without the lens; the floor then makes the stated covariance too large
- three_sigma: each of them drawn evenly between -3 and 3 times its 1-sigma value
- drift: the steady drift alone, three times as large as stated, in a random direction
- tilt_2_mrad, tilt_5_mrad, camera_3_mm, plate_3_mm, drift_10_mm, drift_20_mm: one error; a drift in 400 s
Scenarios: healthy, paper, one slipped joint, and an uplinked effect (compliance of the elbow, estimated
with the DH errors). Each is flown with the executive's limits and with the policy on board.

The errors act on the simulator's camera and tags; nothing of flight's model of the chain is used. Held
against the truth of MuJoCo at 100 postures that were not measured, with the correction that was proposed
- camera: where the correction has the tool, against where the camera sees it (drift as at the end of the run)
- lander: in the base frame
- normalised error squared of the coefficients that were determined, with the covariance of the proposal.

Checked
- stated: the mean normalised error squared lies in the 95 % band of its expectation (chi-square, runs
  independent).
- exact, stated, chain_only, three_sigma, drift: no correction became active with a true error beyond 4
  times the predicted one, in the frame of CONFIG.
Runs are cases of a campaign in FOLDER; a second start continues it. Exit status 1 if a check fails.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field, replace

import cases
import missions
import numpy as np
from scipy.stats import chi2

from kincal.flight import tables as codec
from kincal.run.inprocess import TABLES, Setup, simulate
from kincal_sim.mechanics.plant import AtRest, turn
from kincal_sim.mechanics.spec import load_spec
from kincal_sim.randomness import generator
from kincal_sim.scenario import Scenario
from kincal_sim.transforms import quaternion, rot, rotation_matrix, transform
from kincal_sim.truth import true_coefficients
from kincal_sim.vision.imagers import Imager, fast_imager
from kincal_sim.world import World

CASES = (
    "exact",
    "stated",
    "chain_only",
    "three_sigma",
    "drift",
    "tilt_2_mrad",
    "tilt_5_mrad",
    "camera_3_mm",
    "plate_3_mm",
    "drift_10_mm",
    "drift_20_mm",
)
STATED = ("stated", "chain_only")
WITHIN = ("exact", *STATED, "three_sigma", "drift")
ACCEPT = ("auto", "policy")
AXES = {"case": CASES, "scenario": missions.SCENARIOS, "accept": ACCEPT}
NO_CHANGE, POOR = 0, 2  # proposal_t
BEYOND = 4.0  # times the predicted error
DRIFT_S = 400.0
SAME_POSTURE = 1e-4  # m, rad: an arm at rest moves by some thousandths of a millimetre


# ---- what is wrong with the camera ------------------------------------------------------------------------


@dataclass(frozen=True)
class Chain:
    """Errors of camera and tags. mast, drift (per second), plate: position [m] and rotation vector [rad],
    (6,); mast and drift in the axes of the mast, about its pan-tilt unit; plate: tags on the tool, in its
    frame; zero_rad: pan, tilt; axis_rad: tilt axis about the forward axis, camera about the forward and up
    axes of its mount; size: edges of the tags, relative."""

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
        camera = transform(np.array(spec["camera_xyz_m"]), missions.CAMERA_ON_TILT)
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
    if case in (*STATED, "three_sigma"):
        draw = rng.standard_normal if case in STATED else lambda n: rng.uniform(-3.0, 3.0, n)
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


class Lens:
    """What CONFIG's floor of a measurement's sigma stands for: an error of the detected pose that all frames
    at a posture have in common, and that raises the variance of their mean to the floor."""

    def __init__(self, seed: int):
        _, self.config = codec.decode_as("config", (TABLES / "config.tbl").read_bytes())
        self.rng = generator(seed, "lens")
        self.at, self.unit = np.zeros((4, 4)), np.zeros(6)

    def error(self, m, T_cam_tool: np.ndarray) -> np.ndarray:
        """Position [m] and rotation vector [rad] in the camera frame (6,) for a detection there."""
        if not np.allclose(T_cam_tool, self.at, rtol=0.0, atol=SAME_POSTURE):
            self.at, self.unit = T_cam_tool, self.rng.standard_normal(6)
        c = self.config
        share = (1.0 + (c.frames_per_meas - 1.0) * c.frame_shared) / c.frames_per_meas
        variance = np.array(m.cov)[[0, 6, 11, 15, 18, 20]] * share
        floor = np.repeat([c.sigma_pos_min_m, c.sigma_rot_min_rad], 3)
        return np.sqrt(np.maximum(floor**2 - variance, 0.0)) * self.unit


class ChainWorld(World):
    """The simulator's world with these errors between arm and detections."""

    def __init__(self, scenario: Scenario, seed: int, chain: Chain, lens: Lens | None = None):
        super().__init__(scenario, seed, lambda *args: self._seen(fast_imager(*args)))
        self.chain, self.lens = chain, lens

    def _seen(self, imager: Imager) -> Imager:
        def expose(exposure):
            m = imager.expose(exposure)
            off = np.zeros(6)
            if self.lens is not None and m.n_tags:
                off = self.lens.error(m, np.linalg.inv(exposure.T_base_cam) @ exposure.T_base_tool)
            for p, q in (("p_cam_tool_m", "q_cam_tool_wxyz"), ("p_alt_m", "q_alt_wxyz")):
                setattr(m, p, (np.array(getattr(m, p)) / (1.0 + self.chain.size) + off[:3]).tolist())
                setattr(m, q, quaternion(turn(off[3:]) @ rotation_matrix(getattr(m, q))).tolist())
            return m

        return Imager(imager.channel, expose)

    def _take_frames(self, now_us: int, true: AtRest):
        pan, tilt = self.pantilt.trajectory.at(now_us * 1e-6)[0]
        seen = self.chain.camera(float(pan), float(tilt), now_us * 1e-6)
        return super()._take_frames(
            now_us, replace(true, T_base_cam=seen, T_base_tool=self.chain.tags(true.T_base_tool))
        )


# ---- a run ------------------------------------------------------------------------------------------------


def seen_by(chain: Chain, t_s: float) -> missions.Seen:
    """Where the camera sees what truly is at a pose."""

    def seen(T_base: np.ndarray, pan_rad: float, tilt_rad: float) -> np.ndarray:
        true = chain.camera(pan_rad, tilt_rad, t_s)
        return missions.camera_pose(pan_rad, tilt_rad) @ np.linalg.inv(true) @ T_base

    return seen


def case(seed: int, values: dict[str, str]) -> dict:
    """One calibration, as columns."""
    case, name, accept = (values[key] for key in AXES)
    number = 10_000 * CASES.index(case) + 1000 * missions.SCENARIOS.index(name) + seed
    chain, scenario = drawn(case, generator(number, "camera chain")), missions.scenario_of(name, number)
    lens = Lens(number) if case == "stated" else None
    setup = Setup(
        tables=missions.tables_of(name, accept == "policy"),
        accept=accept,
        world=lambda s, n: ChainWorld(s, n, chain, lens),
    )
    run = simulate(scenario, number, setup)
    line = {"reason": run.record["reason"]}
    if run.log.sessions and (p := run.log.last_session.proposal) is not None:
        line |= judged(p, scenario, number, seen_by(chain, run.mission_s))
        line["active"] = run.record["table_crc_kin"] == f"{p.crc & 0xFFFFFFFF:08x}"
    return cases.columns(line)


def judged(p, scenario: Scenario, number: int, seen: missions.Seen) -> dict:
    """A proposal against the truth."""
    correction = dict(zip(missions.names(scenario.name), p.value, strict=False))
    value, n = missions.nees(p, true_coefficients(scenario), missions.names(scenario.name))
    said = {name: getattr(p, name) for name in ("verdict", "frame", "pred_pos_m", "p_fit", "p_no_change")}
    return said | {
        "nees": value,
        "n": n,
        "camera_m": missions.error_m(scenario, correction, number, seen=seen),
        "lander_m": missions.error_m(scenario, correction, number),
    }


# ---- all of them ------------------------------------------------------------------------------------------


def _true(line: dict) -> float:
    return line["camera_m"] if line["frame"] == 0 else line["lander_m"]


def beyond(line: dict) -> bool:
    """Something is active that is farther off than it may be."""
    return bool(line.get("active")) and not _true(line) <= BEYOND * line["pred_pos_m"]


def summary(lines: list[dict]) -> bool:
    """Print a row for each case and scenario; whether all checks hold."""
    print("case          scenario   runs active (executive, board) none poor", end=" | ")
    print("normalised error, 95 % band", end=" | ")
    print("median mm: camera lander predicted | true/predicted: median largest beyond")
    cells = [(case, name) for case in CASES for name in missions.SCENARIOS]
    good = [_row(cell, [x for x in lines if (x["case"], x["scenario"]) == cell]) for cell in cells]
    return all(good)


def _row(cell: tuple[str, str], own: list[dict]) -> bool:
    made = [x for x in own if "nees" in x]
    if not made:
        if own:
            print(f"{cell[0]:13s} {cell[1]:9s} {len(own):5d} runs without a proposal")
        return not own or cell[0] not in WITHIN
    once = [x for x in made if x["accept"] == made[0]["accept"]]
    n, total = sum(x["n"] for x in once), sum(x["nees"] for x in once)
    low, high = (chi2.ppf(p, n) / n for p in (0.025, 0.975))
    active = [sum(x["active"] for x in made if x["accept"] == a) for a in ACCEPT]
    none, poor = (sum(x["verdict"] == verdict for x in once) for verdict in (NO_CHANGE, POOR))
    ratio = [_true(x) / x["pred_pos_m"] for x in made]
    mm = [1e3 * np.median([x[key] for x in made]) for key in ("camera_m", "lander_m", "pred_pos_m")]
    wrong = sum(beyond(x) for x in made)
    counts = f"{len(own):5d} {active[0]:6d} {active[1]:6d} {none:16d} {poor:4d}"
    print(f"{cell[0]:13s} {cell[1]:9s} {counts}", end=" | ")
    print(f"{total / n:6.3f} {low:.3f} {high:.3f}", end=" | ")
    print(f"{mm[0]:6.2f} {mm[1]:6.2f} {mm[2]:6.2f} | {np.median(ratio):5.2f} {max(ratio):5.2f} {wrong:3d}")
    return (cell[0] != "stated" or low <= total / n <= high) and (cell[0] not in WITHIN or not wrong)


def main(argv: list[str] | None = None) -> int:
    """The bench; exit status as above."""
    p = cases.options("camera_chain", __doc__, seeds=20)
    p.add_argument("--only", nargs="*", default=CASES, choices=CASES)
    p.add_argument("--accept", nargs="*", default=ACCEPT, choices=ACCEPT)
    o = p.parse_args(argv)
    wanted = lambda _seed, v: v["case"] in o.only and v["accept"] in o.accept  # noqa: E731
    lines = cases.fly(o, "camera_chain:case", AXES, wanted)
    return 0 if summary(lines) else 1


if __name__ == "__main__":
    sys.exit(main())
