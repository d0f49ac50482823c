"""A calibration in this process: the flight core against the simulator, without LCM and without processes.

    from kincal.run.inprocess import simulate
    run = simulate("paper", seed=3)
    run.record["verdict"], run.log.last_session.proposal

The same scenario, seed and tables give the same bits as the processes in lockstep: every message of flight
and of the executive. Time, order and delays of messages are those of lockstep (docs/INTERFACES.md). Tags are
detected by the detection model of fast mode; images are neither rendered nor detected here.

The simulator shares no kinematics with flight; this module is where the two meet. Importing it needs
kincal[sim].
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable
from copy import copy
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import lcm

from kincal.link import LogSummary
from kincal.link.channels import message_type
from kincal.link.log import STATES
from kincal_shared import installation
from kincal_shared.keys import Key, Signer, of_simulation

from .onboard import FlightSoftware
from .store import Store
from .wire import Message

installation.simulator()
message_type("time_t")  # CommandFailed if the message types, which the simulator needs too, are not built
from kincal_sim.executive import Executive, accepted_by  # noqa: E402
from kincal_sim.lockstep import Inbox  # noqa: E402
from kincal_sim.scenario import Scenario, load  # noqa: E402
from kincal_sim.server import COMMANDS, PATIENCE_S, TICK_US  # noqa: E402
from kincal_sim.vision.imagers import fast_imager  # noqa: E402
from kincal_sim.world import World  # noqa: E402

if TYPE_CHECKING:
    from kincal.link.messages import Cmd, LcmMessage

TRUTH = "KC_SIM_TRUTH"
UNHEARD = STATES | {TRUTH}
Messages: TypeAlias = "tuple[Message, ...]"
TABLES = installation.root() / "tables" / "bin"


class Commander(Protocol):
    """Who commands flight: the simulator's executive, or a script."""

    @property
    def channels(self) -> Collection[str]:
        """Those whose messages it needs from now on."""

    @property
    def quiet_until_us(self) -> int:
        """Until then tick() does nothing without messages and need not be called; 0: always call it."""

    def tick(self, now_us: int, messages: list[Message], /) -> bool:
        """Once a tick, after flight, with the messages of earlier ticks; False when everything is over."""


MakeCommander: TypeAlias = Callable[[Callable[["Cmd"], None]], Commander]
"""Called with the function that sends a command; the command is due in the next tick."""


class Script:
    """Commands at fixed ticks and nothing else; flight has each in the tick after it."""

    channels: Collection[str] = ()
    quiet_until_us = 0

    def __init__(self, send: Callable[[Cmd], None], commands: Iterable[tuple[int, Cmd]]) -> None:
        self._send, self._commands = send, tuple(commands)
        self._tick = 0

    def tick(self, now_us: int, _messages: list[Message], /) -> bool:
        """Send what is written for this tick, stamped now."""
        self._tick += 1
        for tick, written in self._commands:
            if tick == self._tick:
                command = copy(written)
                command.t_us = now_us
                self._send(command)
        return True


def command(opcode: str, *arg_i: int, seq: int = 1, source: str = "EXECUTIVE") -> Cmd:
    """A command for a script: command("START", -1, 0, 7). Its arguments are in docs/INTERFACES.md."""
    m: Cmd = message_type("cmd_t")()
    m.seq, m.source = seq, getattr(m, f"SRC_{source}")
    m.opcode, m.arg_i = getattr(m, opcode), [*arg_i, *[0] * (4 - len(arg_i))]
    return m


# ---- faults


def _as_sent(_tick: int, messages: Messages) -> Messages:
    return messages


def _as_clocked(_tick: int, now_us: int) -> int:
    return now_us


def _as_asked(_tick: int, _kind: int, data: bytes) -> bytes:
    return data


def _never(_tick: int) -> bool:
    return False


@dataclass(frozen=True)
class Hooks:
    """What goes wrong between flight and its surroundings: pure functions of the tick (from 1) and of what
    passes in it. They give new messages and change none in place.

    to_flight: messages of simulator and commander on their way to flight; from_flight: what flight publishes
    on its way to everybody; clock: mission time that flight gets [us]; keep: data of a kind on the way
    into the store (empty: a deletion), None when the store refuses to write; power_loss: flight is started
    anew from its store before this tick."""

    to_flight: Callable[[int, Messages], Messages] = _as_sent
    from_flight: Callable[[int, Messages], Messages] = _as_sent
    clock: Callable[[int, int], int] = _as_clocked
    keep: Callable[[int, int, bytes], bytes | None] = _as_asked
    power_loss: Callable[[int], bool] = _never


# ---- a run


class Tick:
    """One tick. number: from 1; now_us: mission time; state: flight's after it, KC_ST_...; from_flight:
    channel and message of what arrived of flight's answers."""

    __slots__ = ("_judged", "_sent", "_world", "from_flight", "now_us", "number", "state")

    def __init__(
        self,
        number: int,
        now_us: int,
        state: int,
        to_flight: Messages,
        from_flight: Messages,
        world: World | None = None,
        judged: bool = False,
    ) -> None:
        self.number, self.now_us, self.state, self.from_flight = number, now_us, state, from_flight
        self._sent, self._world, self._judged = to_flight, world, judged

    @property
    def to_flight(self) -> Messages:
        """Channel and message of what flight was sent. To be asked for before the next tick: the states of
        arm and pan-tilt unit, and the truth, become messages only then."""
        if self._world is None:
            return self._sent
        truth = (self._world.truth(),) if self._judged else ()
        return (*self._world.states(), *self._sent, *truth)


_QUIET = Tick(0, 0, 0, (), ())  # any tick in which flight published nothing


@dataclass(frozen=True)
class SimulatedRun:
    """What a run left.

    ended: the commander (or `each_tick`) ended it; False: the limit of mission time did. state: flight's at
    the end, KC_ST_... record: the executive's, as in result.json; empty with another commander. log: the
    messages as a log reader has them: sessions with measurements, progress and proposal, events, answers,
    last housekeeping. contacts: seconds of mission time by pair of shapes of the true arm that touched.
    world: the simulator as it stood at the end. store: what flight kept. mission_s, wall_s: how long it
    took [s]."""

    scenario: Scenario
    seed: int
    ended: bool
    state: int
    record: dict[str, Any]
    log: LogSummary
    contacts: dict[str, int]
    world: World
    store: Store
    mission_s: float
    wall_s: float


@dataclass(frozen=True)
class Setup:
    """What a run starts from; for most of it the defaults are right.

    tables: folder of table images; store: what an earlier flight left (None: nothing); acquisition, poses,
    accept: instead of the scenario's choice ("", 0: as the scenario says); commander: instead of the
    executive; key: signs commands, and flight takes it (None: one made from the seed); others: keys that
    flight takes too; world: makes the simulator; hooks: faults; log: file for an LCM log (None: no file);
    limit_s: of mission time [s] (0: a minute more than the executive's patience)."""

    tables: Path = TABLES
    store: Store | None = None
    acquisition: str = ""
    poses: int = 0
    accept: str = ""
    commander: MakeCommander | None = None
    key: Key | None = None
    others: tuple[Key, ...] = ()
    world: Callable[[Scenario, int], World] | None = None
    hooks: Hooks = field(default_factory=Hooks)
    log: Path | None = None
    limit_s: float = 0.0


def simulate(
    scenario: Scenario | str | Path,
    seed: int = 1,
    setup: Setup | None = None,
    *,
    each_tick: Callable[[Tick], bool] | None = None,
) -> SimulatedRun:
    """One calibration from power-up to its end, in this process.

    scenario: one that is loaded, a file, or a name in sim/scenarios; seed: of everything random; each_tick:
    gets every tick, and ends the run by False. The result is a function of these, of tables and of store.
    Costs less than 0.1 ms of processor time a tick, 0.2 s for a calibration of 20 poses (280 s of mission).
    One at a time in a process. BadInput for a wrong scenario, or if kincal[sim] is missing; CommandFailed if
    the message types are not built."""
    with Simulation(scenario, seed, setup) as simulation:
        step = simulation.step if each_tick else simulation.until_sent
        while (tick := step()) is not None:
            if each_tick and not each_tick(tick):
                simulation.stop()
        return simulation.result()


class Simulation:
    """A run a tick at a time, for those who act while it goes on. `simulate` says what scenario, seed and
    setup are. Use as a context: its log is closed at the end. What is done to the given scenario while it
    runs, or to `scenario`, changes nothing of it: parts are read once, and would not fit the others."""

    def __init__(self, scenario: Scenario | str | Path, seed: int = 1, setup: Setup | None = None) -> None:
        self._begun_s = time.monotonic()
        self.setup = setup = setup or Setup()
        loaded = scenario if isinstance(scenario, Scenario) else load(scenario)
        self._scenario, self.seed = accepted_by(loaded, setup.accept), seed
        make_world = setup.world or (lambda s, n: World(s, n, fast_imager))
        self.world = make_world(self._scenario, seed)
        self.store = setup.store or Store()
        self.ended = False
        self._log = LogSummary(setup.log or Path("-"))
        self._uncounted = self._judged = 0  # states and truths that were no messages, since the last count
        self._file = lcm.EventLog(str(setup.log), "w", overwrite=True) if setup.log else None
        limit_s = setup.limit_s or self._scenario.executive.total_timeout_s + PATIENCE_S
        self._limit_us = limit_s * 1e6
        self._faulty = setup.hooks != Hooks()
        self._secret = not self._faulty and self._file is None  # what only flight and the commander hear
        self._number = self._now_us = 0
        self._sent: list[Message] = []  # on their way to flight
        self._key = setup.key or of_simulation(seed)
        self.signer = Signer(self._key, self.store.count)
        self._inbox = Inbox()
        self._executive: Executive | None = None
        self._commander = setup.commander(self._send) if setup.commander else self._make_executive()
        self._flight = self._power_up()

    def __enter__(self) -> Simulation:
        return self

    def __exit__(
        self, _type: type[BaseException] | None, _value: BaseException | None, _tb: TracebackType | None
    ) -> None:
        if self._file is not None:
            self._file.close()

    def _make_executive(self) -> Commander:
        chosen = self.setup
        self._executive = Executive(
            self._scenario, self._send, self.seed, chosen.acquisition, poses=chosen.poses
        )
        return self._executive

    def _power_up(self) -> FlightSoftware:
        return FlightSoftware(
            self.setup.tables,
            self.store,
            lambda kind, data: self.setup.hooks.keep(self._number, kind, data),
            (self._key, *self.setup.others),
        )

    @property
    def scenario(self) -> Scenario:
        """What is run, as a copy."""
        return self._scenario.model_copy(deep=True)

    @property
    def log(self) -> LogSummary:
        """The messages so far as a log reader has them."""
        if self._uncounted:
            self._log.count(STATES, self._uncounted)
            self._log.count((TRUTH,), self._judged)
            self._uncounted = self._judged = 0
        return self._log

    def publish(self, channel: str, message: LcmMessage) -> None:
        """A message for flight, due at the first tick later than its stamp."""
        self._sent.append((channel, message))

    def _send(self, command: Cmd) -> None:
        """A command of the commander, signed if it is not."""
        self.publish("KC_CMD", command if command.key_id else self.signer.command(command))

    def stop(self) -> None:
        """No more ticks."""
        self.ended = True

    def until_sent(self) -> Tick | None:
        """Ticks until flight publishes something: that tick, as from step(). None when the run has ended."""
        while (tick := self._tick(_QUIET)) is not None:
            if tick.from_flight:
                return tick
        return None

    def step(self) -> Tick | None:
        """One tick: simulator, flight, commander. None when the run has ended."""
        return self._tick()

    def _tick(self, quiet: Tick | None = None) -> Tick | None:
        """step(); what is given stands for a tick in which flight published nothing."""
        number = self._number + 1
        now_us = number * TICK_US
        if self.ended or now_us > self._limit_us:
            return None
        self._number, self._now_us = number, now_us
        if self._faulty and self.setup.hooks.power_loss(number):
            self._flight = self._power_up()
        world, flight, commander = self.world, self._flight, self._commander
        world.advance(now_us)
        # Where nobody but flight hears the simulator, states need no messages, and what flight does not take
        # need not be made.
        if plain := self._secret and UNHEARD.isdisjoint(commander.channels) and not self._states_sent():
            frames, judged = world.watch()
            to_flight = self._send_to_flight(frames) if frames or self._sent else ()
            flight.receive_states(world)
            self._uncounted += 1
            self._judged += judged
        else:
            to_flight, judged = self._send_to_flight(world.states() + world.observe()), False
        from_flight = self._step_flight()
        if from_flight:
            self._deliver(from_flight)
        if self._inbox or now_us >= commander.quiet_until_us:
            self.ended = not commander.tick(now_us, self._inbox.take(now_us))
        if quiet and not from_flight:
            return quiet
        return Tick(number, now_us, flight.state, to_flight, from_flight, world if plain else None, judged)

    def _states_sent(self) -> bool:
        """Whether states were published by hand: flight has to have them beside the simulator's."""
        return any(channel in STATES for channel, _ in self._sent)

    def _send_to_flight(self, sensors: list[Message]) -> Messages:
        """Commands of the tick before, then what the simulator measures now."""
        sent, self._sent = self._sent, []
        to_flight = self.setup.hooks.to_flight(self._number, (*sent, *sensors))
        for channel, message in to_flight:
            self._flight.receive(channel, message)
            self._record(channel, message)
        for channel, message in sensors:
            if channel in self._commander.channels:
                self._inbox.put(channel, message)
        return to_flight

    def _step_flight(self) -> Messages:
        if self._secret:
            return tuple(self._flight.step(self._now_us))
        if self._file is not None:
            t = message_type("time_t")()
            t.tick, t.now_us = self._number, self._now_us
            self._record("KC_TIME", t)
        hooks = self.setup.hooks
        published = self._flight.step(max(0, hooks.clock(self._number, self._now_us)))
        return hooks.from_flight(self._number, tuple(published))

    def _deliver(self, from_flight: Iterable[Message]) -> None:
        for channel, message in from_flight:
            self._record(channel, message)
            if channel in COMMANDS:
                self.world.receive(channel, message)
            if channel in self._commander.channels:
                self._inbox.put(channel, message)

    def _record(self, channel: str, message: Any) -> None:
        self._log.n_messages += 1
        self._log.counts[channel] += 1
        self._log.add(channel, message)
        if self._file is not None:
            self._file.write_event(self._now_us, channel, message.encode())

    def result(self) -> SimulatedRun:
        """What the run has left so far."""
        return SimulatedRun(
            self._scenario,
            self.seed,
            self.ended,
            self._flight.state,
            self._executive.record() if self._executive else {},
            self.log,
            dict(self.world.contacts),
            self.world,
            self.store,
            self._now_us * 1e-6,
            time.monotonic() - self._begun_s,
        )
