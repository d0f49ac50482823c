"""A run from start to end."""

from __future__ import annotations

import time

from kincal.link import read_log
from kincal_shared.errors import CommandFailed

from .evaluate import Evaluator, GroundTruth
from .finished import Finished
from .follow import Observer, follow
from .processes import LOGS, Processes, read_json
from .request import Request


def perform(request: Request, observer: Observer | None = None) -> Finished:
    """Run to the end, reporting every pose; decide if the ground does. In this process if no images are
    needed, else in processes of its own. CommandFailed if the run does not start or breaks off."""
    if request.in_process:
        from . import fast  # the only part that needs the simulator here

        return fast.perform(request, observer or Observer())
    return _perform_in_processes(request, observer or Observer())


def _perform_in_processes(request: Request, observer: Observer) -> Finished:
    begun = time.monotonic()
    evaluator = Evaluator(request.tables)
    with Processes(request) as processes:
        reported = follow(request, processes, evaluator, observer)
        errors = processes.errors()
    if not (request.out / "launch.json").is_file():
        raise CommandFailed(f"the run broke off: {errors or 'no message'}", str(request.out), LOGS)
    launch = read_json(request.out / "launch.json")
    evaluator.learn(GroundTruth.of(read_json(request.out / "truth.json")))
    log = read_log(request.out / "run.lcmlog")
    session = log.last_session
    for p in session.progress[reported:]:  # live messages can be lost; the log has them all
        observer.pose(evaluator.pose_line(p, None), p.n_goal)
    return Finished(log, session, launch, evaluator, time.monotonic() - begun)
