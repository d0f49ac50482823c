"""The whole of `kincal run`: run, evaluate, and the same scenario with other acquisitions for comparison."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from kincal.link import names, unsigned32
from kincal.results import Curve, RunResult, angle_text, length_text
from kincal.review import KIN_KIND
from kincal.rotations import Floats

from .criteria import criteria
from .finished import Finished
from .follow import Observer
from .perform import perform
from .request import Expectation, Request, read_expectation

COMPARED = ("ucb", "random")


def calibrate(request: Request, observer: Observer | None = None, *, compare: bool = True) -> RunResult:
    """One whole run, evaluated; with `compare` the compared acquisitions are run in fast mode as well. Writes
    only what the processes of the run write. BadInput for a wrong scenario, CommandFailed if a run breaks
    off."""
    begun, observer = time.monotonic(), observer or Observer()
    expectation = read_expectation(request.scenario)
    observer.started(request, expectation)
    result = run_result(request, expectation, perform(request, observer))
    if compare and result.poses:
        result = replace(result, curves=compare_acquisitions(request, result, observer))
    return replace(result, wall_s=time.monotonic() - begun)


def run_result(request: Request, expectation: Expectation, done: Finished) -> RunResult:
    """Everything about a finished run as plain values."""
    session, evaluator = done.session, done.evaluator
    lines, last = evaluator.lines(session), session.progress[-1] if session.progress else None
    estimated, counted = _coefficients(done)
    acquisition = names.acquisition_name(last.acquisition) if last else "-"
    result = RunResult(
        expectation.title,
        request.scenario,
        request.mode,
        request.seed,
        acquisition,
        last.n_goal if last else request.poses or 0,
        poses=lines,
        before=evaluator.held_out(evaluator.initial_coef),
        after=evaluator.held_out(counted),
        active_crc=unsigned32(done.log.hk.table_crc[KIN_KIND]) if done.log.hk else 0,
        decision=str(done.launch.get("reason", "")),
        curves=(Curve(f"{acquisition}, {request.mode}", lines),) if lines else (),
        scene=evaluator.scene(session, estimated) if session.measurements else None,
        events=_serious_events(done),
        mission_s=done.log.mission_s,
        wall_s=done.wall_s,
    )
    result = _with_proposal(result, done)
    return replace(result, criteria=tuple(criteria(request, expectation, done, result)))


def _coefficients(done: Finished) -> tuple[Floats, Floats]:
    """Estimated coefficients, and those that count: without a change on offer the table in force stays."""
    proposal, evaluator = done.session.proposal, done.evaluator
    if proposal is None:
        return evaluator.initial_coef, evaluator.initial_coef
    estimated = np.array(proposal.value[: evaluator.terms.n])
    changes = names.verdict_key(proposal.verdict) == "change"
    return estimated, estimated if changes else evaluator.initial_coef


def _with_proposal(result: RunResult, done: Finished) -> RunResult:
    """The result with what flight proposed, if it did."""
    p = done.session.proposal
    if p is None:
        return result
    only_proposed = names.verdict_key(p.verdict) == "change" and result.active_crc != unsigned32(p.crc)
    return replace(
        result,
        after_is="proposed" if only_proposed else "after",
        coefs=done.evaluator.coefs(p),
        verdict=names.verdict_name(p.verdict),
        crc=unsigned32(p.crc),
        rank=p.rank,
        n_free=p.n_free,
        p_fit=p.p_fit,
        p_no_change=p.p_no_change,
        noise_scale=p.noise_scale,
        ended=names.ended_text(p.ended, p.verdict),
    )


def _serious_events(done: Finished) -> tuple[str, ...]:
    """Warnings and errors with their mission time."""
    serious = (e for e in done.log.events if e.severity in ("warning", "error"))
    return tuple(f"{e.t_us * 1e-6:8.1f} s  {e.text}" for e in serious)


def compare_acquisitions(request: Request, result: RunResult, observer: Observer) -> tuple[Curve, ...]:
    """Progress of the run, and of the compared acquisitions in fast mode with the same scenario and seed; a
    run that was one of them counts."""
    curves = list(result.curves)
    for acquisition in COMPARED:
        label = f"{acquisition}, fast"
        if any(curve.label == label for curve in curves):
            continue
        out = request.out / f"compare-{acquisition}"
        other = replace(request, mode="fast", acquisition=acquisition, accept="auto", out=out)
        done = perform(other)
        if lines := done.evaluator.lines(done.session):
            curves.append(Curve(label, lines))
            error = f"{length_text(lines[-1].held_pos_m)}, {angle_text(lines[-1].held_rot_rad)}"
            text = f"{len(lines)} poses, held-out RMS {error} ({done.wall_s:.0f} s)"
            observer.note(f"for comparison, {label}: {text}")
    return tuple(curves)
