"""A run in this process that leaves the files of a run: `kincal run --fast`."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from typing import TYPE_CHECKING

from kincal.link import CommandLink, Received
from kincal_shared import installation, keys
from kincal_shared.errors import CommandFailed

from .evaluate import Evaluator, GroundTruth
from .finished import Finished
from .follow import Observer, decide
from .inprocess import Setup, Simulation
from .request import Request
from .store import Store

installation.simulator()
from kincal_sim import outputs  # noqa: E402
from kincal_sim.scenario import Scenario, load  # noqa: E402
from kincal_sim.truth import truth_record  # noqa: E402

if TYPE_CHECKING:
    from kincal.link.messages import LcmMessage

URL = "in-process"


class InProcessLink(CommandLink):
    """The ground's side of a run in this process: to wait for a message is to let the run go on. The clock
    of time-outs is mission time."""

    def __init__(self, simulation: Simulation) -> None:
        super().__init__(URL, first_seq=0, signer=simulation.signer)
        self._simulation = simulation
        self._received: deque[Received] = deque()

    def clock_s(self) -> float:
        """Mission time [s]."""
        return self.last_t_us * 1e-6

    def messages(self) -> Iterator[Received]:
        """Whatever flight sends until the run ends."""
        while self._received or self._step():
            if self._received:
                yield self._received.popleft()

    def next(self, timeout_s: float) -> Received | None:
        """See CommandLink. CommandFailed when the run has ended."""
        deadline_s = self.clock_s() + timeout_s
        while not self._received and self.clock_s() < deadline_s:
            if not self._step():
                raise CommandFailed(
                    "the run ended while the ground waited for flight",
                    URL,
                    "`kincal log` of its log says how",
                )
        return self._received.popleft() if self._received else None

    def publish(self, channel: str, message: LcmMessage) -> None:
        """See CommandLink; flight has it in the next tick."""
        self._simulation.publish(channel, message)

    def _step(self) -> bool:
        """One tick; False when the run has ended."""
        tick = self._simulation.step()
        if tick is None:
            return False
        self.last_t_us = tick.now_us
        self._received.extend(self.note(channel, message) for channel, message in tick.from_flight)
        return True


def perform(request: Request, observer: Observer) -> Finished:
    """Run to the end, reporting every pose; decide if the ground does. Writes result.json, truth.json,
    contacts.json, launch.json, run.lcmlog, store/ and store.keys. BadInput for a wrong scenario,
    CommandFailed if the run does not end."""
    begun = time.monotonic()
    evaluator, scenario = Evaluator(request.tables), load(request.scenario)
    with outputs.alone(request.out):
        return _perform_alone(request, observer, evaluator, scenario, begun)


def _perform_alone(
    request: Request, observer: Observer, evaluator: Evaluator, scenario: Scenario, begun: float
) -> Finished:
    """perform, in a folder that no other run writes to."""
    store = Store(outputs.prepare(request.out))
    setup = Setup(
        tables=request.tables,
        store=store,
        acquisition=request.acquisition or "",
        poses=request.poses or 0,
        accept=request.accept or "",
        log=request.out / outputs.LOG,
    )
    with Simulation(scenario, request.seed, setup) as simulation:
        keys.write(request.out / keys.RUN_KEYS, (simulation.signer.key,))
        truth = truth_record(scenario, simulation.world.plant, request.seed, request.mode)
        outputs.write(request.out / outputs.TRUTH, truth)
        evaluator.learn(GroundTruth.of(truth))
        _follow(request, InProcessLink(simulation), evaluator, observer)
        run = simulation.result()
    if not run.ended:
        raise CommandFailed(
            f"no end after {run.mission_s:g} s of mission time",
            str(request.out),
            f"`kincal log {request.out / outputs.LOG}` lists what flight waited for",
        )
    outputs.write(request.out / outputs.RESULT, run.record)
    outputs.write(request.out / outputs.CONTACTS, run.contacts)
    facts = {"url": URL, "scenario": scenario.name, "seed": request.seed, "mode": request.mode}
    wall_s = time.monotonic() - begun
    launch = outputs.conclude(request.out, scenario, facts, wall_s)
    return Finished(run.log, run.log.last_session, launch, evaluator, wall_s)


def _follow(request: Request, link: InProcessLink, evaluator: Evaluator, observer: Observer) -> None:
    for received in link.messages():
        message = received.message
        if received.channel == "KC_PROGRESS":
            observer.pose(evaluator.pose_line(message, None), message.n_goal)
        elif received.channel == "KC_PROPOSAL" and request.accept == "ground":
            decide(request, link, message, evaluator.names, observer)
