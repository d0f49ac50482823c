"""Sealed cases: does the workbench find hidden physics, and are its probabilities honest?

    python tests/bench/blind.py [--quick] [--share 1.0] [--seed 1] [--processes 1] [--dir build/blind]

The simulator's generator (python -m kincal_sim.hidden, a process of its own) hides effects in a nonlinear
MuJoCo arm and seals what it did; the workbench (kincal.workbench) sees poses.csv and arm.toml only. All
answers are on disk before the first seal is opened, and every seal is checked against the hash in the
manifest. Answers are lines of DIR/answers.jsonl as soon as a block of cases is done; a run that was stopped
goes on from there. Exit 1 if a criterion fails.

What counts as right
- A finding is right if it names a hidden effect: the library's name for that kind (RIGHT) and, where the
  effect sits at one joint or pair, that joint or pair. If it sits at all joints, any one or some of them; a
  bare name ("at some joint") is right too. pd_droop is the same formula as joint_compliance, so each is
  right for the other.
- An effect that no data can tell from the truth (`confounded`) and that is listed with it, as
  confounded_with or as a finding of its own, counts as listed together, and a claim of it as right. Other
  confusions are wrong even if listed. A soft joint 2 and a soft mount are such where the generator's own
  figures say so: less than CONFOUNDED_CHI2 units of noise distinguish them in these poses.
- A claim is any listed effect with probability above 0.9. An effect is found if it was accepted.
- A false alarm is a verdict that something is missing (effect, several_effects, novel) or an accepted
  effect when nothing was hidden. "undecidable" without an accepted effect is no alarm.
- Visible: the effect is longer than VISIBLE in units of the noise (squared) after the DH parameters took
  what they can; computed by the generator from the same poses. Recall and the criterion on pairs count
  visible effects, the rest is printed: what cannot be seen need not be found.
- Probabilities are tested on truths drawn from the diagnosis' own prior (group "from prior"): what comes true
  of something stated with 0.3 depends on how often there is nothing and how large effects are, and the other
  groups are made for other questions. Theirs are printed beside, not tested.
- Deleted: the effect's name is taken out of the library. "identified" = an accepted effect with P > 0.9
  while the model is said to be inadequate still. Frame or driver right: those of the novel finding, or of the
  similar effect that was accepted instead. For an effect at all joints the driver's family counts (tau, q,
  dir ...). Mxj, Myj, Mzj, the gravity levers at joint j whatever its masses, follow what tauj follows.
- Two drivers: a joint error tanh(q_a) cos(q_b). It counts where the exact column, as one more effect of the
  library, reaches P > DECIDED; right is the unnamed at that joint with both drivers.
- Size x 0.4: the kinds of the group "alone", that much smaller. It counts where the effect is visible;
  right is the leading name, the listed effect with the highest probability.
- Systematic error: RMS position error over 200 noiseless poses in a part of the workspace where nothing was
  measured, by the final model; against the median of the cases without effect and with the same N.
"""

import argparse
import hashlib
import itertools
import json
import multiprocessing
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402
from scipy import stats  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]

CLAIM, MENTION = 0.9, 0.05
BLOCK = 20  # cases that are made together
VISIBLE = 40.0
CONFOUNDED_CHI2 = 4.0
DECIDED = 0.99
SMALL = 0.6  # prior sigmas: 0.4 of what the generator hides where a case states no size
BINS = (0.05, 0.2, 0.5, 0.8, 0.95, 1.0000001)
BIN_ERROR = 0.05  # a bin is tested if chance alone moves its frequency by less (one standard error)
# Truths as the diagnosis expects them before it has seen anything: how often nothing is wrong, how often
# something the library has no name for, and how large an effect is, in its prior sigmas.
FROM_PRIOR = 2000
SHARE_NONE, SHARE_UNNAMED = 0.3, 0.1
PRIOR_SIZES = (0.3, 1.0, 3.0)

# The library's names for each kind; an empty tuple: the library has none.
RIGHT = {
    "compliance": ("joint_compliance", "pd_droop"),
    "droop": ("joint_compliance", "pd_droop"),
    "payload_sag": ("payload_sag",),
    "differential": ("differential_coupling",),
    "ratio": ("encoder_gain",),
    "routing": ("joint_coupling",),
    "eccentricity": ("encoder_eccentricity",),
    "oval": ("encoder_harmonic2",),
    "motor_wave": ("motor_harmonic",),
    "differential_wave": (),
    "hysteresis": ("backlash",),
    "gravity_backlash": ("gravity_backlash",),
    "wobble": ("bearing_wobble",),
    "out_of_round": ("bearing_wobble2",),
    "run_out": ("bearing_runout",),
    "bending": ("link_bending",),
    "base_flex": ("base_flex",),
    "base_tilt": ("base_tilt",),
    "base_shift": ("base_shift",),
    "settling": ("base_settling",),
    "tool_shift": ("tool_shift",),
    "link_growth": ("link_thermal_growth",),
    "thermal_zero": ("joint_thermal_drift",),
    "creep": ("time_drift",),
    "encoder_step": ("bias_step",),
    "latency": ("latency",),
    "camera_shift": ("camera_shift",),
    "camera_step": ("camera_step",),
    "pantilt_error": ("pantilt_error",),
    "focal": ("focal_length",),
    "thermal_focal": ("thermal_focal",),
    "principal_point": ("principal_point",),
    "radial": ("lens_radial",),
    "decentring": ("lens_decentring",),
    "tag_size": ("tag_scale",),
    "second_tag": ("second_tag_mount",),
    "incidence": ("range_incidence_bias",),
    "incidence_tilt": (),
    "blooming": ("illumination",),
    "two_drivers": (),
}
# Joints of the bench's arm whose axis meets the next one, at right angles, in the frame before it: there the
# tilt of the one about the other is a turn of the next joint. Joint 1 is not one of them: its frame is known.
MEETING = ("2", "6")
# Where an unnamed effect shows and what it follows: {j} is its joint (each of a pair).
SHOWS = {
    "compliance": ("joint {j}", "tau{j}"),
    "differential": ("joint {j}", "tau{j}"),
    "ratio": ("joint {j}", "q{j}"),
    "eccentricity": ("joint {j}", "q{j}"),
    "hysteresis": ("joint {j}", "dir{j}"),
    "thermal_zero": ("joint {j}", "temp"),
    "encoder_step": ("joint {j}", "t"),
    "creep": ("joint {j}", "t"),
    "latency": ("", "qdot"),
    "settling": ("base", "t"),
    "camera_step": ("camera", "t"),
    "incidence": ("range", "incid"),
    "incidence_tilt": ("tag", "incid"),
    "radial": ("range", "r2"),
    "two_drivers": ("joint {j}", ""),
    "differential_wave": ("joint {j}", "q{j}"),
}
DELETED = (
    "compliance",
    "differential",
    "ratio",
    "eccentricity",
    "hysteresis",
    "thermal_zero",
    "encoder_step",
    "incidence",
)
# Spec: the kinds whose systematic error has to come down to that of the healthy arm.
REPAIRED = ("compliance", "ratio", "hysteresis", "encoder_step", "second_tag", "incidence")
PAIRABLE = (*REPAIRED, "focal", "thermal_zero", "differential", "latency", "camera_step", "eccentricity")


# ------------------------------------------------------------------------------------------------- cases


@dataclass(frozen=True)
class Case:
    """group: what the case is for; without: names taken out of the library (known to the bench only)."""

    group: str
    effects: tuple[str, ...] = ()
    n: int = 100
    extra: dict = field(default_factory=dict)
    without: tuple[str, ...] = ()


def cases(share: float, rng: np.random.Generator) -> list[Case]:
    """The whole battery; share scales how often each is repeated."""

    def times(count: float) -> range:
        return range(max(1, round(count * share)))

    named = [kind for kind, names in RIGHT.items() if names]
    out = [Case("none") for _ in times(60)]
    out += [Case("alone", (kind,)) for kind in named for _ in times(2)]
    for _ in times(20):
        a, b = rng.choice(PAIRABLE, 2, replace=False)
        out.append(Case("two", (str(a), str(b))))
    out += [Case("deleted", (kind,), without=RIGHT[kind]) for kind in DELETED for _ in times(3)]
    out += [Case("deleted", (kind,)) for kind in ("two_drivers", "incidence_tilt") for _ in times(3)]
    out += [Case("none, outliers", extra={"outliers": 0.05}) for _ in times(4)]
    out += [Case("outliers", (kind,), extra={"outliers": 0.05}) for kind in REPAIRED for _ in times(1)]
    out += [Case("none, noise x1.5", extra={"noise": 1.5}) for _ in times(8)]
    out += [Case("noise x1.5", (kind,), extra={"noise": 1.5}) for kind in REPAIRED for _ in times(1)]
    out += [Case("none, sorted", extra={"sequence": "sorted"}) for _ in times(4)]
    out += [Case("sorted", (kind,), extra={"sequence": "sorted"}) for kind in REPAIRED for _ in times(1)]
    fixed = {"fixed_pantilt": True}
    out += [
        Case("fixed pan-tilt", (kind,), extra=fixed)
        for kind in ("camera_shift", "base_shift")
        for _ in times(2)
    ]
    out += [Case("confounded", (kind,)) for kind in ("compliance[2]@0.7", "base_flex@0.7") for _ in times(2)]
    for n in (60, 40):
        out += [Case("none", n=n) for _ in times(10)]
        out += [Case("alone", (kind,), n=n) for kind in named for _ in times(1)]
    out += [from_prior(rng) for _ in times(FROM_PRIOR)]
    out += [Case("two drivers", ("two_drivers",)) for _ in times(16)]
    return out + [Case("size x 0.4", (f"{kind}@{SMALL}",)) for kind in named for _ in times(2)]


def from_prior(rng: np.random.Generator) -> Case:
    """A case drawn as the diagnosis expects it: kind, place, and every parameter normally distributed."""
    from kincal_sim.hidden.kinds import KINDS

    u = rng.random()
    if u < SHARE_NONE:
        return Case("from prior")
    unnamed = u < SHARE_NONE + SHARE_UNNAMED
    kind = KINDS[str(rng.choice([name for name, names in RIGHT.items() if bool(names) != unnamed]))]
    place, parameters = "", len(kind.sigma)
    if kind.together and kind.places and rng.random() < 0.5:
        place, parameters = "[all]", parameters * len(kind.places)
    elif kind.places:
        joints = kind.places[rng.integers(len(kind.places))]
        place = f"[{','.join(map(str, joints if isinstance(joints, tuple) else (joints,)))}]"
    size = rng.choice(PRIOR_SIZES) * np.sqrt(rng.chisquare(parameters) / parameters)
    return Case("from prior", (f"{kind.name}{place}@{size:.4f}",))


def quick_cases() -> list[Case]:
    """Six fixed ones, for `make test`; `make blind` tests the shares."""
    return [
        Case("none"),
        Case("alone", ("compliance[all]",)),
        Case("two", ("second_tag", "hysteresis[all]")),
        Case("deleted", ("hysteresis[all]",), without=RIGHT["hysteresis"]),
        Case("outliers", ("encoder_step[2]",), extra={"outliers": 0.05}),
        Case("sorted", ("latency",), extra={"sequence": "sorted"}),
    ]


def block(row: dict) -> str:
    """Name of the folder of cases that are made together: starting the generator takes as long as a case."""
    return f"b{int(row['id'][1:]) // BLOCK:04d}"


def make(folder: Path, rows: list[dict]) -> dict[str, str]:
    """Let the generator write the cases of a block, if they are not there; gives the hash of each seal."""
    place = folder / block(rows[0])
    place.mkdir(parents=True, exist_ok=True)
    wanted, there = json.dumps(rows), place / "plan.json"
    if not (there.exists() and there.read_text() == wanted and (place / "manifest.json").exists()):
        there.write_text(wanted)
        (place / "manifest.json").unlink(missing_ok=True)
        command = [sys.executable, "-m", "kincal_sim.hidden", "make", "--out", place, "--plan", there]
        env = {**os.environ, "PYTHONPATH": str(ROOT / "sim")}
        done = subprocess.run(list(map(str, command)), env=env, stdout=subprocess.DEVNULL)
        if done.returncode:
            raise RuntimeError("the generator of hidden effects failed")
    return {made["id"]: made["sha256"] for made in json.loads((place / "manifest.json").read_text())}


# ----------------------------------------------------------------------------------------------- answers


def _shows(library, name: str, arm, data) -> tuple[list[str], list[str]]:
    """Frames and drivers of a named effect, in the words of the map."""
    from kincal.flight import FRAME_CAMERA, FRAME_MEAS, FRAME_TOOL

    places = {0: "base", FRAME_TOOL: "tool", FRAME_CAMERA: "camera", FRAME_MEAS: "tag"}
    terms = [term for h in library.find(name, arm, data) for p in h.parameters for term in p.terms]
    frames = {places.get(term.frame, f"link {term.frame}") for term in terms}
    frames |= {f"joint {term.frame + 1}" for term in terms if 0 <= term.frame < arm.n and term.comp == 5}
    frames |= {"range" for term in terms if term.frame == FRAME_CAMERA and term.comp == 2}
    drivers = {f"{b.var}{b.index or ''}" for term in terms for b in term.basis if b.var != "1"}
    return sorted(frames), sorted(drivers)


def arm_alone(fit, queries) -> list[list[float]]:
    """Tool positions of the fitted arm. What a model says about the camera does not move the arm, and the
    queries (positions at zero, no camera) have none: its coefficients count as zero."""
    from kincal.flight import FRAME_CAMERA, FRAME_MEAS
    from kincal.workbench.model.flight_model import observations

    camera_side = [
        bool(p.terms) and all(term.frame in (FRAME_CAMERA, FRAME_MEAS) for term in p.terms)
        for p in fit.parameters
    ]
    coefficients = np.where(camera_side, 0.0, fit.estimate)
    return fit.model.at(observations(fit.arm, queries)).poses(coefficients).p_m.tolist()


def answer_block(folder: Path, pending: list[tuple[Case, dict]]) -> list[dict]:
    """What the workbench says about the cases of a block."""
    sha256 = make(folder, [row for _, row in pending])
    return [answer(folder / block(row) / row["id"], case, sha256[row["id"]]) for case, row in pending]


def answer(folder: Path, case: Case, sha256: str) -> dict:
    """What the workbench says about one case, as plain data; the seal is not touched."""
    from kincal import workbench as wb

    arm = wb.read_arm(folder.parent / "arm.toml")
    data = wb.read_csv(folder / "poses.csv", arm.n)
    library = wb.Library.load().without(*case.without)
    start = time.perf_counter()
    found = wb.diagnose(arm, data, library)
    seconds = time.perf_counter() - start
    queries = wb.read_csv(folder / "queries.csv", arm.n)
    effects = []
    for e in found.effects:
        frames, drivers = _shows(library, e.name, arm, data)
        effects.append(
            {
                "name": e.name,
                "probability": e.probability,
                "accepted": bool(e.accepted or (e.in_model and e.helps)),
                "confounded_with": list(e.confounded_with),
                "frames": frames,
                "drivers": drivers,
            }
        )
    novel = found.novel and {"frame": found.novel.location, "drivers": list(found.novel.depends_on)}
    return {
        "id": folder.name,
        "sha256": sha256,
        "verdict": found.verdict,
        "effects": effects,
        "novel": novel,
        "adequate": bool(found.adequate_after),
        "none": found.probability_none,
        "outliers": list(found.comparison.outliers.ids),
        "predicted_dh": arm_alone(found.comparison.fit_all, queries),
        "predicted": arm_alone(found.final, queries),
        "seconds": seconds,
    }


def fingerprint() -> str:
    """Of the sources that answers come from."""
    digest = hashlib.sha256()
    folders = (ROOT / "ground" / "kincal" / "workbench", ROOT / "sim" / "kincal_sim" / "hidden")
    for folder in folders:
        for path in sorted(path for path in folder.rglob("*.*") if path.suffix != ".pyc"):
            digest.update(path.read_bytes())
    return digest.hexdigest()


def ask(folder: Path, todo: list[Case], plan: list[dict], processes: int) -> list[dict]:
    """All answers. Each is a line of answers.jsonl as soon as its block is done; a run that was stopped, or
    that asked for some groups only, goes on from there as long as the sources are the same."""
    folder.mkdir(parents=True, exist_ok=True)
    path, mark = folder / "answers.jsonl", json.dumps({"of": fingerprint()})
    lines = path.read_text().splitlines() if path.exists() else []
    if not lines or lines[0] != mark:
        lines = [mark]
        path.write_text(f"{mark}\n")
    wanted = {
        row["id"]: json.loads(json.dumps([row, case.without])) for case, row in zip(todo, plan, strict=True)
    }
    done = {
        said["id"]: said for said in map(json.loads, lines[1:]) if wanted.get(said["id"]) == said["asked"]
    }
    pending = [(case, row) for case, row in zip(todo, plan, strict=True) if row["id"] not in done]
    with path.open("a") as file:
        for said in answers(pending, folder, processes):
            said["asked"] = wanted[said["id"]]
            done[said["id"]] = said
            file.write(json.dumps(said) + "\n")
            file.flush()
            names = ", ".join(f"{e['name']} {e['probability']:.2f}" for e in said["effects"] if e["accepted"])
            line = f"{len(done):4}/{len(plan)} {said['id']} {said['seconds']:5.1f} s"
            line += f"  {said['verdict']:16} {names}"
            print(line, file=sys.stderr, flush=True)
    return [done[row["id"]] for row in plan]


def answers(pending: list[tuple[Case, dict]], folder: Path, processes: int) -> Iterator[dict]:
    blocks = [list(some) for _, some in itertools.groupby(pending, key=lambda one: block(one[1]))]
    if processes == 1:
        for some in blocks:
            yield from answer_block(folder, some)
        return
    with ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn")) as pool:
        for done in as_completed([pool.submit(answer_block, folder, some) for some in blocks]):
            yield from done.result()


# ---------------------------------------------------------------------------------------- evaluation


def some_joints() -> list[tuple[int, ...]]:
    """Every choice of joints that a name can list."""
    return [joints for n in range(1, 8) for joints in itertools.combinations(range(1, 8), n)]


def right_names(effect: dict) -> set[str]:
    """All names that are right for a hidden effect."""
    out = set()
    for name in RIGHT[effect["kind"]]:
        out.add(name)
        if effect["place"] == "all":
            out |= {f"{name}[{','.join(map(str, joints))}]" for joints in some_joints()}
        elif effect["place"]:
            out.add(f"{name}[{','.join(map(str, effect['place']))}]")
    return out


def confounded(name: str, fixed_pantilt: bool, soft: bool) -> set[str]:
    """Effects that no data of this kind can tell from `name`. soft: a soft joint 2 and a soft
    mount are the same in these poses."""
    effect, _, place = name.partition("[")
    out = set()
    if effect == "joint_compliance":
        out.add(f"pd_droop[{place}" if place else "pd_droop")
    if effect == "bearing_wobble2" and place and place[:-1] in MEETING:
        out.add(f"joint_coupling_harmonic[{int(place[:-1]) + 1},{place}")
    if soft and name in ("joint_compliance[2]", "base_flex"):
        out |= {"joint_compliance[2]", "base_flex"} - {name}
    if fixed_pantilt and name == "camera_shift":
        out |= {"base_shift", "base_tilt"}
    if fixed_pantilt and name in ("base_shift", "base_tilt"):
        out.add("camera_shift")
    return out


@dataclass
class Evaluated:
    """One case after its seal was opened."""

    case: Case
    truth: list[dict]
    said: dict
    error_dh_mm: float
    error_mm: float
    fixed_pantilt: bool
    decided: bool | None = None  # two drivers: the exact column alone reaches P > DECIDED

    @property
    def soft(self) -> bool:
        return any(e.get("beside_alternatives", np.inf) < CONFOUNDED_CHI2 for e in self.truth)

    def confounded(self, name: str) -> set[str]:
        return confounded(name, self.fixed_pantilt, self.soft)

    @property
    def accepted(self) -> list[dict]:
        return [e for e in self.said["effects"] if e["accepted"]]

    @property
    def alarm(self) -> bool:
        return bool(self.accepted) or self.said["verdict"] in ("effect", "several_effects", "novel")

    @property
    def hidden_names(self) -> set[str]:
        return set().union(*(right_names(e) for e in self.truth)) if self.truth else set()

    def right(self, finding: dict) -> bool:
        name = finding["name"]
        if name in self.hidden_names:
            return True
        listed = set(finding["confounded_with"]) | {e["name"] for e in self.said["effects"]}
        return bool(self.confounded(name) & self.hidden_names & listed)

    def found(self, effect: dict) -> bool:
        names = right_names(effect)
        return any(e["name"] in names or (self.right(e) and len(self.truth) == 1) for e in self.accepted)

    @property
    def visible(self) -> bool:
        return all(e["chi2"] >= VISIBLE for e in self.truth)

    @property
    def leading(self) -> dict | None:
        """The listed effect with the highest probability."""
        return max(self.said["effects"], key=lambda e: e["probability"], default=None)

    @property
    def claims(self) -> list[dict]:
        return [e for e in self.said["effects"] if e["probability"] > CLAIM]

    def both_drivers(self) -> bool:
        """The unnamed was found at the joint of the hidden effect, following both its drivers."""
        joint, drivers = self.truth[0]["place"][0], {f"q{j}" for j in self.truth[0]["drivers"]}
        novel = self.said["novel"]
        return bool(novel) and novel["frame"] == f"joint {joint}" and set(novel["drivers"]) == drivers

    def shows_right(self) -> bool:
        """Frame or driver of what was said about a deleted effect."""
        effect = self.truth[0]
        frame, driver = SHOWS[effect["kind"]]
        everywhere = effect["place"] == "all"
        joints = list(range(1, 8)) if everywhere else (effect["place"] or [0])
        frames = set() if everywhere else {frame.format(j=j) for j in joints if frame}
        drivers = {driver.format(j=j) for j in joints if driver}
        if driver.startswith("tau"):
            drivers |= {f"M{axis}{j}" for axis in "xyz" for j in joints}
        said = [(self.said["novel"]["frame"], self.said["novel"]["drivers"])] if self.said["novel"] else []
        if not said:
            said = [(frame, e["drivers"]) for e in self.accepted for frame in e["frames"]]
        return any(
            any(where == f or where.startswith(f + " ") for f in frames)
            or any(d == x or d.startswith(x) and x in ("qdot",) for d in follows for x in drivers)
            for where, follows in said
        )


def evaluate(folder: Path, case: Case, said: dict) -> Evaluated:
    from kincal_sim.hidden.seal import unseal

    truth = unseal(json.loads((folder / "sealed.json").read_text()), said["sha256"])
    p = np.array(truth["unseen"])[:, :3]

    def error_mm(predicted) -> float:
        return 1e3 * float(np.sqrt(np.mean(np.sum((np.array(predicted) - p) ** 2, axis=1))))

    fixed = truth["spec"]["fixed_pantilt"]
    decided = exact_decides(folder, truth["effects"][0]) if case.group == "two drivers" else None
    return Evaluated(
        case,
        truth["effects"],
        said,
        error_mm(said["predicted_dh"]),
        error_mm(said["predicted"]),
        fixed,
        decided,
    )


def exact_decides(folder: Path, effect: dict) -> bool:
    """Whether the data show tanh(q_a) cos(q_b) beyond doubt once it has a name in the library."""
    from kincal import workbench as wb
    from kincal.workbench.diagnosis.study import Study

    joint, (a, b) = effect["place"][0], effect["drivers"]
    own = folder / "exact.toml"
    own.write_text(
        f'[[effect]]\nname = "exact"\n[[effect.parameter]]\nname = "c"\nunit = "rad"\nsigma = 3e-3\n'
        f'[[effect.parameter.term]]\nat = "joint[{joint}]"\nbasis = "tanh(q{a}) * cos(q{b})"\n'
    )
    arm = wb.read_arm(folder.parent / "arm.toml")
    data = wb.read_csv(folder / "poses.csv", arm.n)
    study = Study.of(wb.compare(arm, data), wb.Library.load(own), (), True)
    return study.posterior(()).probability["exact"] > DECIDED


# ---------------------------------------------------------------------------------------- criteria


@dataclass
class Criterion:
    text: str
    value: str
    ok: bool | None  # None: too few cases to say


def share_criterion(
    text: str, hits: int, of: int, least: float | None = None, most: float | None = None
) -> Criterion:
    if of == 0:
        return Criterion(text, "no case", None)
    rate = hits / of
    ok = (least is None or rate >= least) and (most is None or rate <= most)
    return Criterion(text, f"{hits}/{of} = {rate:.0%}", ok)


def criteria(results: list[Evaluated]) -> list[Criterion]:
    """The figures of docs/DIAGNOSIS.md, at N = 100 and 1.5 sigma; claims also where effects are weaker."""
    full = [r for r in results if r.case.n == 100]
    clean = [r for r in full if r.case.group == "none"]
    library = [r for r in full if r.case.group not in ("deleted", "two drivers")]
    claims = [(r, e) for r in library for e in r.claims]
    out = [
        share_criterion(
            "false alarms on clean data <= 5 %", sum(r.alarm for r in clean), len(clean), most=0.05
        )
    ]
    good = sum(r.right(e) for r, e in claims)
    out.append(share_criterion("claims at P > 0.9 right >= 95 %", good, len(claims), least=0.95))
    out += reliability([r for r in results if r.case.group == "from prior"])
    pairs = [r for r in full if r.case.group == "two" and r.visible]
    both = sum(all(r.found(e) for e in r.truth) for r in pairs)
    out.append(share_criterion("two visible effects both found >= 80 %", both, len(pairs), least=0.80))
    deleted = [r for r in full if r.case.group == "deleted"]
    bold = sum(not r.said["adequate"] and any(e["probability"] > CLAIM for e in r.accepted) for r in deleted)
    out.append(
        share_criterion("deleted: named with P > 0.9 though inadequate: never", bold, len(deleted), most=0.0)
    )
    decided = [r for r in full if r.decided]
    out.append(
        share_criterion(
            "two drivers: joint and both drivers named >= 60 %",
            sum(r.both_drivers() for r in decided),
            len(decided),
            least=0.6,
        )
    )
    small = [r for r in full if r.case.group == "size x 0.4" and r.visible]
    leads = sum(r.leading is not None and r.right(r.leading) for r in small)
    out.append(share_criterion("size x 0.4: leading name right >= 85 %", leads, len(small), least=0.85))
    seen = [r for r in deleted if r.visible]
    out.append(
        share_criterion(
            "deleted: frame or driver right >= 60 %", sum(r.shows_right() for r in seen), len(seen), least=0.6
        )
    )
    out.append(repaired(full, clean))
    out.append(together(full))
    return out


def reliability(results: list[Evaluated]) -> list[Criterion]:
    """Per bin: stated probability against frequency; off if 0.07 is exceeded beyond the sampling error (90 %
    interval of the frequency). A bin is tested if it holds findings enough (BIN_ERROR).
    """
    said = np.array([e["probability"] for r in results for e in r.said["effects"]])
    true = np.array([r.right(e) for r in results for e in r.said["effects"]], float)
    out = []
    for low, high in zip(BINS, BINS[1:], strict=False):
        inside = (said >= low) & (said < high)
        n, hits = int(inside.sum()), float(true[inside].sum())
        text = f"stated {low:.2f}..{min(high, 1.0):.2f} comes true within 0.07"
        if n == 0:
            out.append(Criterion(text, "none stated", None))
            continue
        mean = float(said[inside].mean())
        least, most = stats.beta.ppf([0.05, 0.95], hits + 0.5, n - hits + 0.5)
        enough = np.sqrt((said[inside] * (1.0 - said[inside])).sum()) / n <= BIN_ERROR
        ok = bool(least <= mean + 0.07 and most >= mean - 0.07) if enough else None
        out.append(
            Criterion(text, f"said {mean:.2f}, true {hits / n:.2f} of {n} ({least:.2f}..{most:.2f})", ok)
        )
    return out


def repaired(full: list[Evaluated], clean: list[Evaluated]) -> Criterion:
    text = "unseen-region systematic error / that of no effect <= 1.3"
    rows = [r for r in full if r.case.group == "alone" and r.truth[0]["kind"] in REPAIRED and r.accepted]
    if not rows or not clean:
        return Criterion(text, "no case", None)
    floor = float(np.median([r.error_mm for r in clean]))
    before = float(np.median([r.error_dh_mm for r in rows]))
    after = float(np.median([r.error_mm for r in rows]))
    return Criterion(
        text,
        f"{before:.2f} -> {after:.2f} mm, none {floor:.2f} mm: {after / floor:.2f}",
        after <= 1.3 * floor,
    )


def together(full: list[Evaluated]) -> Criterion:
    """Every accepted effect that no data can tell from others lists them all (one of them with a camera that
    never turns, where either base effect stands for both)."""
    asked = missing = 0
    for r in full:
        listed = {e["name"] for e in r.said["effects"]}
        for e in r.accepted:
            due, stated = r.confounded(e["name"]), listed | set(e["confounded_with"])
            if due:
                asked += 1
                missing += not (due & stated if e["name"] == "camera_shift" else due <= stated)
    return share_criterion("confounded effects listed together: always", asked - missing, asked, least=1.0)


def table(results: list[Evaluated]) -> list[str]:
    """One line per group, kind and N."""
    rows: dict[tuple, list[Evaluated]] = {}
    for r in results:
        kinds = " + ".join(e["kind"] for e in r.truth) or "-"
        key = (r.case.group, "" if r.case.group == "two" else kinds, r.case.n)
        rows.setdefault(key, []).append(r)
    floor = {
        n: float(
            np.median([r.error_mm for r in results if r.case.group == "none" and r.case.n == n] or [np.nan])
        )
        for n in (100, 60, 40)
    }
    head = f"{'group':18}{'hidden':19}{'N':>4}{'cases':>6}{'seen':>5}{'found':>6}{'claims':>7}{'right':>6}"
    lines = [head + f"{'wrong':>6}{'novel':>6}{'mm DH':>8}{'mm':>7}{'/none':>6}  mistaken for"]
    for (group, kinds, n), rs in rows.items():
        claims = [(r, e) for r in rs for e in r.claims]
        wrong = [e["name"] for r in rs for e in r.accepted if not r.right(e)]
        found = sum(bool(r.truth) and all(r.found(e) for e in r.truth) for r in rs)
        after = float(np.median([r.error_mm for r in rs]))
        lines.append(
            f"{group:18}{kinds:19}{n:4}{len(rs):6}{sum(bool(r.truth) and r.visible for r in rs):5}{found:6}"
            f"{len(claims):7}{sum(r.right(e) for r, e in claims):6}{len(wrong):6}"
            f"{sum(r.said['novel'] is not None for r in rs):6}{np.median([r.error_dh_mm for r in rs]):8.2f}"
            f"{after:7.2f}{after / floor[n]:6.2f}  {', '.join(sorted(set(wrong)))}"
        )
    return lines


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--quick", action="store_true", help="six cases")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--share", type=float, default=1.0, help="scales the number of cases")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--dir", type=Path, default=ROOT / "build" / "blind")
    parser.add_argument("--json", type=Path, help="write every answer and truth there")
    parser.add_argument("--only", help="only cases of these groups, comma separated")
    parser.add_argument("--poses", type=int, help="only cases with this many poses")
    args = parser.parse_args()

    rng = np.random.default_rng(args.seed)
    todo = quick_cases() if args.quick else cases(args.share, rng)
    plan = [
        {"id": f"c{k:03d}", "effects": case.effects, "n": case.n, "seed": 1000 * args.seed + k, **case.extra}
        for k, case in enumerate(todo)
    ]
    groups = args.only and args.only.split(",")
    wanted = [k for k, case in enumerate(todo) if (not groups or case.group in groups)
              and args.poses in (None, case.n)]  # fmt: skip
    todo, plan = [todo[k] for k in wanted], [plan[k] for k in wanted]
    start = time.monotonic()
    said = ask(args.dir, todo, plan, args.processes)
    results = [
        evaluate(args.dir / block(row) / row["id"], case, one)
        for row, case, one in zip(plan, todo, said, strict=True)
    ]
    print("\n".join(table(results)))
    seconds = np.array([r.said["seconds"] for r in results])
    print(
        f"\n{len(results)} cases in {time.monotonic() - start:.0f} s; "
        f"one diagnosis: median {np.median(seconds):.1f} s, most {seconds.max():.1f} s\n"
    )
    checked = criteria(results)
    for criterion in checked:
        mark = "  - " if criterion.ok is None else " ok " if criterion.ok else "FAIL"
        print(f"{mark} {criterion.text:58} {criterion.value}")
    print("\nstated probabilities of the other groups, which are no sample of anything:")
    for criterion in reliability(
        [r for r in results if r.case.group not in ("from prior", "deleted", "two drivers")]
    ):
        print(f"     {criterion.text:58} {criterion.value}")
    if args.json:
        args.json.write_text(
            json.dumps(
                [{"group": r.case.group, "n": r.case.n, "truth": r.truth, "said": r.said} for r in results]
            )
        )
    return 1 if any(criterion.ok is False for criterion in checked) else 0


if __name__ == "__main__":
    sys.exit(main())
