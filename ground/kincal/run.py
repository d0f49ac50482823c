"""A whole calibration in simulation: start it, show it, judge it.

The processes are started by `python -m kincal_sim.launch`; this module only listens, reviews as the ground
would, and reads what the run left: run.lcmlog, truth.json, launch.json."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from kincal import channels, lcmlog, report, review, show, space, tables
from kincal.errors import KincalError, KincalFailed
from kincal.geometry import ArmChain, CorrectedArm, quat_to_R, with_dh_errors
from kincal.link import Link
from kincal.results import CoefResult, Curve, Gate, HeldOut, PoseLine, RunResult, angle_text, length_text

ROOT = Path(__file__).resolve().parents[2]
SCENARIOS = ROOT / "sim" / "scenarios"
INSIDE_SHARE = 0.95  # of the true values must lie inside 3 sigma
STOP_WAIT_S = 15.0
ANSWER_S = 10.0
LISTEN = ("KC_ACK", "KC_HK", "KC_MEAS", "KC_PROGRESS", "KC_PROPOSAL")
# Names the simulator gives to what it injects -> coefficients of the terms table.
INJECTED = (
    (re.compile(r"J(\d+)\.compliance_rad_per_nm"), r"joint_compliance[\1]"),
    (re.compile(r"J(\d+)\.gain"), r"encoder_gain[\1]"),
)


@dataclass(frozen=True)
class Request:
    """What to run."""

    scenario: str  # file, or name in sim/scenarios
    mode: str  # "fast" or "pixels"
    acquisition: str | None
    poses: int | None
    seed: int
    out: Path
    tables: Path
    accept: str | None = None  # who decides; None: as the scenario says

    def command(self) -> list[str]:
        out = [
            sys.executable,
            "-m",
            "kincal_sim.launch",
            self.scenario,
            "--out",
            str(self.out),
            f"--{self.mode}",
            "--seed",
            str(self.seed),
            "--tables",
            str(self.tables),
        ]
        for option, value in (
            ("--acquisition", self.acquisition),
            ("--poses", self.poses),
            ("--accept", self.accept),
        ):
            if value is not None:
                out += [option, str(value)]
        return out


@dataclass(frozen=True)
class Plan:
    """What the scenario file says about judging."""

    title: str
    accept: str
    verdict: str
    held_out_pos_m: float
    held_out_rot_rad: float


def read_plan(scenario: str) -> Plan:
    path = Path(scenario) if Path(scenario).is_file() else SCENARIOS / f"{scenario}.toml"
    if not path.is_file():
        known = ", ".join(sorted(p.stem for p in SCENARIOS.glob("*.toml")))
        raise KincalError(f"no scenario {scenario!r}", str(path), f"give a file or one of: {known}")
    doc = tables.read_toml(path)
    expect = doc.get("expect", {})
    title = doc.get("title") or path.stem
    return Plan(
        title[:1].upper() + title[1:],
        doc.get("executive", {}).get("accept", "auto"),
        expect.get("verdict", ""),
        float(expect.get("held_out_pos_m", 0.0)),
        float(expect.get("held_out_rot_rad", 0.0)),
    )


# --------------------------------------------------------------------------- the processes


class Processes:
    """The launcher as a child; use as a context, so that nothing outlives an interruption."""

    def __init__(self, request: Request) -> None:
        env = dict(os.environ)
        env["PYTHONPATH"] = os.pathsep.join(
            [str(ROOT / "sim"), str(ROOT / "build" / "py"), *filter(None, [env.get("PYTHONPATH", "")])]
        )
        request.out.mkdir(parents=True, exist_ok=True)
        # stderr to a file: a full pipe must not stop the launcher
        self._errors = (request.out / "launch.err").open("w+", encoding="utf-8")
        self.child = subprocess.Popen(
            request.command(), stdout=subprocess.PIPE, stderr=self._errors, text=True, env=env
        )
        first = self.child.stdout.readline() if self.child.stdout else ""
        try:
            self.url = str(json.loads(first)["url"])
        except (ValueError, KeyError):
            self.child.wait()
            raise KincalError(
                f"the scenario did not start: {self.errors() or first.strip()}",
                request.scenario,
                "`make` builds what is missing",
            ) from None

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, *_exc: object) -> None:
        if self.child.poll() is None:
            self.child.terminate()  # the launcher stops all it started
            try:
                self.child.wait(STOP_WAIT_S)
            except subprocess.TimeoutExpired:
                self.child.kill()
        if self.child.stdout:
            self.child.stdout.close()
        self._errors.close()

    def running(self) -> bool:
        return self.child.poll() is None

    def errors(self) -> str:
        self._errors.flush()
        self._errors.seek(0)
        return self._errors.read().strip()


def follow(processes: Processes, link: Link) -> Iterator[tuple[str, Any]]:
    """What is heard until the run has ended and nothing more comes."""
    while True:
        ended = not processes.running()
        heard = link.next(0.05)
        if heard is not None:
            yield heard.channel, heard.message
        elif ended:
            return


# --------------------------------------------------------------------------- truth and model


class Judge:
    """Truth of a run against the flight model with the tables of the run."""

    def __init__(self, tables_dir: Path, truth: dict[str, Any] | None = None) -> None:
        self.arm_image, self.arm = tables.load(tables_dir / "arm.tbl")
        _, self.camera = tables.load(tables_dir / "camera.tbl")
        _, self.space = tables.load(tables_dir / "space.tbl")
        _, terms = tables.load(tables_dir / "terms.tbl")
        _, kin = tables.load(tables_dir / "kin.tbl")
        _, config = tables.load(tables_dir / "config.tbl")
        self.a1 = float(config.a1)
        self.model = CorrectedArm(self.arm, terms)
        self.names = self.model.names
        self.start = np.array(list(kin.value[0 : self.model.n_coef]))
        self.errors: dict[str, float] = {}
        self._held: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None = None
        if truth:
            self.take(truth)

    def take(self, truth: dict[str, Any]) -> None:
        self.errors = {coef_name(k): float(v) for k, v in truth["errors"].items()}
        held = truth["held_out"]
        self._held = (
            np.array([h["q_rad"] for h in held]),
            np.array([h["p_m"] for h in held]),
            np.array([quat_to_R(h["q_wxyz"]) for h in held]),
            np.array([h.get("dir", [0.0] * len(h["q_rad"])) for h in held]),
        )

    @property
    def knows_truth(self) -> bool:
        return self._held is not None

    def held_out(self, coef: np.ndarray) -> HeldOut:
        if self._held is None:
            return HeldOut(0, float("nan"), float("nan"))
        q, p, R, side = self._held
        return self.model.held_out(q, p, R, coef, side)

    def pose_line(self, p: Any, meas: Any) -> PoseLine:
        held = self.held_out(np.array(p.coef))
        return PoseLine(
            p.pose + 1,
            p.candidate,
            p.servo_steps,
            tuple(meas.p_m) if meas is not None else (float("nan"),) * 3,  # type: ignore[arg-type]
            p.res_pos_m,
            p.res_rot_rad,
            p.f,
            p.gp_mean,
            p.gp_sigma,
            p.pred_pos_m,
            p.pred_rot_rad,
            held.pos_m,
            held.rot_rad,
            first_look=p.candidate >= space.ordinary(self.space),
        )

    def lines(self, session: lcmlog.Session) -> list[PoseLine]:
        by_pose = {m.pose: m for m in session.measurements}
        worst_m = max((p.res_pos_m for p in session.progress), default=1.0) or 1.0
        worst_rad = max((p.res_rot_rad for p in session.progress), default=1.0) or 1.0
        return [
            replace(
                self.pose_line(p, by_pose.get(p.pose)),
                f_run=-(self.a1 * p.res_pos_m / worst_m + (1.0 - self.a1) * p.res_rot_rad / worst_rad),
            )
            for p in session.progress
        ]

    def coefs(self, proposal: Any) -> list[CoefResult]:
        """All coefficients of a proposal; what was not injected is truly zero."""
        return [
            CoefResult(
                name,
                tables.unit_of(name),
                self.errors.get(name, 0.0) if self.knows_truth else float("nan"),
                proposal.value[i],
                proposal.sigma[i],
                channels.named(channels.COEF_STATUS, proposal.status[i]),
            )
            for i, name in enumerate(self.names[: proposal.n_coef])
        ]

    def scene(self, session: lcmlog.Session, coef: np.ndarray) -> Any:
        """Arm with the estimated DH errors at the measured joints."""
        chain = ArmChain(with_dh_errors(self.arm, dict(zip(self.names, coef, strict=False))))
        q = np.array([m.q_rad[: chain.n] for m in session.measurements]).reshape(-1, chain.n)
        return space.scene(self.space, self.arm, self.camera, q, chain.points)


def coef_name(injected: str) -> str:
    for pattern, name in INJECTED:
        if pattern.fullmatch(injected):
            return pattern.sub(name, injected)
    return injected


def read_json(path: Path) -> dict[str, Any]:
    try:
        return dict(json.loads(path.read_text("utf-8")))
    except (OSError, ValueError) as error:
        raise KincalFailed(
            f"the run left no {path.name}: {error}", str(path.parent), "look into logs/ of that directory"
        ) from None


# --------------------------------------------------------------------------- one run


@dataclass
class Finished:
    """What a run left."""

    log: lcmlog.LogSummary
    session: lcmlog.Session
    launch: dict[str, Any]
    judge: Judge
    wall_s: float


def perform(request: Request, say: Callable[[str], None] = lambda _text: None) -> Finished:
    """Run to the end, print a line a pose, review if the ground decides."""
    begun = time.monotonic()
    judge = Judge(request.tables)
    with Processes(request) as processes:
        printed = watch(request, processes, judge, say)
        errors = processes.errors()
    if not (request.out / "launch.json").is_file():
        raise KincalFailed(
            f"the run broke off: {errors or 'no message'}",
            str(request.out),
            "look into logs/ of that directory",
        )
    launch = read_json(request.out / "launch.json")
    judge.take(read_json(request.out / "truth.json"))
    log = lcmlog.read(request.out / "run.lcmlog")
    session = max(log.sessions.values(), key=lambda s: s.number, default=lcmlog.Session(0))
    for p in session.progress[printed:]:  # the display may miss what the log has
        say(show.pose_line(judge.pose_line(p, None), p.n_goal))
    return Finished(log, session, launch, judge, time.monotonic() - begun)


def watch(request: Request, processes: Processes, judge: Judge, say: Callable[[str], None]) -> int:
    """Show poses while they come; returns how many were shown, in order and without a gap."""
    shown = 0
    with Link(processes.url, LISTEN, first_seq=0) as link:
        for channel, message in follow(processes, link):
            if channel == "KC_PROGRESS" and message.pose == shown:
                if not judge.knows_truth and (request.out / "truth.json").is_file():
                    judge.take(read_json(request.out / "truth.json"))
                say(show.pose_line(judge.pose_line(message, None), message.n_goal))
                shown += 1
            elif channel == "KC_PROPOSAL" and request.accept == "ground":
                decide(request, link, message, judge.names, say)
    return shown


def decide(request: Request, link: Link, proposal: Any, names: list[str], say: Callable[[str], None]) -> None:
    """The ground's review of a run: approve what flight proposes unless something stands out that would
    make a reviewer stop. The decision goes into the journal of the run."""
    found = review.from_message(proposal, names)
    if not found.changes_something:
        return
    stop = [w for w in review.worries(found) if "worse than" in w or "larger than before" in w]
    journal = request.out / "review.jsonl"
    journal.unlink(missing_ok=True)  # every run is its own record
    if stop:
        review.reject(link, found.crc, ANSWER_S)
        review.record(journal, "reject", found.crc, "kincal run", "; ".join(stop), link.url, found)
        say(f"ground: correction {found.crc_text} rejected: {'; '.join(stop)}")
        return
    say(f"ground: correction {found.crc_text} reviewed, nothing stands out")
    review.approve(link, found.crc, ANSWER_S, say=lambda text: say(f"ground: {text}"))
    review.record(
        journal, "approve", found.crc, "kincal run", "fit and rank as they should be", link.url, found
    )


# --------------------------------------------------------------------------- result and gates


def result_of(request: Request, plan: Plan, done: Finished) -> RunResult:
    """Everything about a run as plain values."""
    session, judge, p = done.session, done.judge, done.session.proposal
    hk = done.log.hk
    lines = judge.lines(session)
    after_coef = np.array(p.value[: len(judge.names)]) if p is not None else judge.start
    in_force = int(hk.table_crc[review.KIN_KIND]) & 0xFFFFFFFF if hk is not None else 0
    # Without a change on offer the table in force stays, and is what counts.
    counts = after_coef if p is not None and p.verdict == 1 else judge.start
    acquisition = (
        channels.named(channels.ACQUISITIONS, session.progress[-1].acquisition) if session.progress else "-"
    )
    result = RunResult(
        plan.title,
        request.scenario,
        request.mode,
        request.seed,
        acquisition,
        session.progress[-1].n_goal if session.progress else request.poses or 0,
        lines,
    )
    result.before, result.after = judge.held_out(judge.start), judge.held_out(counts)
    if p is not None:
        result.coefs = judge.coefs(p)
        result.verdict = channels.named(channels.VERDICTS, p.verdict)
        result.crc, result.rank, result.n_free = p.crc & 0xFFFFFFFF, p.rank, p.n_free
        result.p_fit, result.p_no_change, result.noise_scale = p.p_fit, p.p_no_change, p.noise_scale
    result.active_crc = in_force
    result.decision = str(done.launch.get("reason", ""))
    result.curves = [Curve(f"{acquisition}, {request.mode}", tuple(lines))] if lines else []
    result.scene = judge.scene(session, after_coef) if session.measurements else None
    result.events = [
        f"{e.t_us * 1e-6:8.1f} s  {e.text}" for e in done.log.events if e.severity in ("warning", "error")
    ]
    result.mission_s, result.wall_s = done.log.mission_s, done.wall_s
    result.gates = list(gates(request, plan, done, result))
    return result


def gates(request: Request, plan: Plan, done: Finished, r: RunResult) -> Iterator[Gate]:
    """What a run has to meet."""
    launch = done.launch
    yield Gate(
        "run ended well", launch.get("problem") or launch.get("reason", ""), "success", bool(launch.get("ok"))
    )
    p = done.session.proposal
    if p is None:
        return
    if plan.verdict:
        names = ("no_change", "change", "poor")
        yield Gate("verdict", names[p.verdict], plan.verdict, names[p.verdict] == plan.verdict)
    waits = (request.accept or plan.accept) == "ground" and request.accept != "ground"
    if p.verdict == 1 and not waits:
        yield Gate("correction in force", f"{r.active_crc:08x}", f"{r.crc:08x}", r.active_crc == r.crc)
    if plan.held_out_pos_m > 0.0 and r.after:
        yield Gate(
            "held-out position RMS",
            length_text(r.after.pos_m),
            f"<= {length_text(plan.held_out_pos_m)}",
            r.after.pos_m <= plan.held_out_pos_m,
        )
    if plan.held_out_rot_rad > 0.0 and r.after:
        yield Gate(
            "held-out rotation RMS",
            angle_text(r.after.rot_rad),
            f"<= {angle_text(plan.held_out_rot_rad)}",
            r.after.rot_rad <= plan.held_out_rot_rad,
        )
    estimated = [c for c in r.coefs if c.sigma > 0.0]
    if estimated and set(done.judge.errors) <= {c.name for c in estimated}:
        inside = sum(c.inside_3_sigma for c in estimated)
        yield Gate(
            "true values inside 3 sigma",
            f"{inside} of {len(estimated)}",
            f">= {INSIDE_SHARE:.0%}",
            inside >= INSIDE_SHARE * len(estimated),
        )


def comparison(request: Request, main: RunResult, say: Callable[[str], None]) -> list[Curve]:
    """ucb and random in fast mode, same scenario and seed; the run itself counts if it was one of them."""
    curves = list(main.curves)
    for acquisition in ("ucb", "random"):
        label = f"{acquisition}, fast"
        if any(c.label == label for c in curves):
            continue
        other = replace(
            request,
            mode="fast",
            acquisition=acquisition,
            accept="auto",
            out=request.out / f"compare-{acquisition}",
        )
        done = perform(other)
        lines = done.judge.lines(done.session)
        if lines:
            curves.append(Curve(label, tuple(lines)))
            say(
                f"for comparison, {label}: {len(lines)} poses, held-out RMS "
                f"{length_text(lines[-1].held_pos_m)}, {angle_text(lines[-1].held_rot_rad)} "
                f"({done.wall_s:.0f} s)"
            )
    return curves


def run_and_judge(request: Request, out: Console, *, compare: bool, summary: bool) -> RunResult:
    """The whole of `kincal run`."""
    plan = read_plan(request.scenario)
    begun = time.monotonic()
    out.print(f"[bold]{plan.title}[/]: {request.mode}, seed {request.seed}, results in {request.out}")
    out.print(show.POSE_HEAD)

    def say(text: str) -> None:
        out.print(text, markup=False)

    done = perform(request, say)
    result = result_of(request, plan, done)
    if compare and result.poses:
        result.curves = comparison(request, result, say)
    result.wall_s = time.monotonic() - begun
    files = report.write(result, request.out) if summary and result.poses else []
    result.wall_s = time.monotonic() - begun
    show.run_end(out, result, [*files, request.out / "run.lcmlog"])
    return result
