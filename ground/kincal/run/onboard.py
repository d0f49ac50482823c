"""The flight core in this process, behind the same door as in the flight process: kc_app_step."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

from kincal.flight import library
from kincal_shared.errors import KincalError
from kincal_shared.keys import Key

from . import wire
from .store import Store
from .wire import Message

if TYPE_CHECKING:
    from kincal.flight.headers import KcApp, KcKeys
    from kincal_sim.world import World

_FLIGHT = library("flight")
_LIB = _FLIGHT.lib
_KINDS = (
    _LIB.KC_STORE_JOURNAL,  # the order of kc_app_load
    *range(1, _LIB.KC_TBL_COUNT),
    *(_LIB.KC_STORE_PREV, _LIB.KC_STORE_PROPOSAL),
)
_KIND_AT = slice(4, 6)  # of a table image
_M = TypeVar("_M")

Keep = Callable[[int, bytes], "bytes | None"]
"""Kind and data that are to be kept -> what is kept; None: the memory refuses to write."""


class _Waiting:
    """Messages that wait until they are due: stamped earlier than the tick. They leave in an order that does
    not depend on when they came, as from fsw/lcm/kc_queue.h; its quotas have no counterpart here."""

    def __init__(self) -> None:
        self._waiting: dict[str, list[Any]] = {}

    def __bool__(self) -> bool:
        return bool(self._waiting)

    def add(self, name: str, message: Any) -> None:
        """A message for the member `name` of kc_in_t."""
        self._waiting.setdefault(name, []).append(message)

    def take(self, now_us: int) -> Iterator[tuple[str, list[Any]]]:
        """What is due, by member, as much as one step takes; the rest waits for the next."""
        waiting, self._waiting = self._waiting, {}
        for name, messages in waiting.items():
            due, later = _split(messages, now_us)
            due = _ORDER.get(name, _by_number)(due)
            room = _ROOM[name]
            if later or due[room:]:
                self._waiting[name] = later + due[room:]
            yield name, due[:room]


def _in_turn(due: list[Any]) -> list[Any]:
    """Commands: the accounts in turn, each by source and number, what has a signature by its source; then
    ABORT without one."""
    turn: dict[int, int] = {}
    keyed = []
    for m in sorted(due, key=lambda m: (m.source, m.seq)):
        account = m.source if m.key_id and 1 <= m.source <= _LIB.KC_SOURCE_MAX else 0
        last = account == 0 and m.opcode == _LIB.KC_CMD_ABORT
        turn[account] = turn.get(account, 0) + (not last)
        keyed.append(((last, turn[account], m.source), m))
    return [m for _, m in sorted(keyed, key=lambda pair: pair[0])]


def _by_place(due: list[Any]) -> list[Any]:
    """Table chunks by time, kind and offset."""
    return sorted(due, key=lambda m: (m.t_us, m.kind, m.offset))


def _by_number(due: list[Any]) -> list[Any]:
    return sorted(due, key=lambda m: m.seq)


# Orders of fsw/lcm/kc_queue.c other than by number, by member.
_ORDER = {"cmd": _in_turn, "chunk": _by_place}
_FIELDS = dict(_FLIGHT.ffi.typeof("kc_in_t").fields or ())
_QUEUED = {name[2:] for name in _FIELDS if name.startswith("n_")}
# How much of each a step takes.
_ROOM = {name: cast(Any, _FIELDS[name]).type.length for name in _QUEUED if name in _FIELDS}


def _split(waiting: list[_M], now_us: int) -> tuple[list[_M], list[_M]]:
    due = [m for m in waiting if cast(Any, m).t_us < now_us]
    return due, [m for m in waiting if cast(Any, m).t_us >= now_us]


def _key_ring(keys: Sequence[Key]) -> KcKeys:
    ring: KcKeys = _FLIGHT.new("kc_keys_t")
    ring.n = len(keys)
    for to, key in zip(ring.key, keys, strict=False):
        to.id, to.secret = key.id, list(key.secret)
    return ring


class FlightSoftware:
    """The flight core with tables and a store, a step at a time.

    tables: folder of images; store: what an earlier flight left, and where this one keeps things; keep: what
    becomes of data on the way into the store; keys: whose commands are taken. The core has one
    instance in a process: making another one here ends the first, whose step() then raises KincalError."""

    _newest: FlightSoftware | None = None

    def __init__(
        self, tables: Path, store: Store, keep: Keep = lambda _kind, data: data, keys: Sequence[Key] = ()
    ) -> None:
        self.store, self.keep = store, keep
        self._app = cast("KcApp", _FLIGHT.ffi.addressof(cast(Any, _FLIGHT.lib), "kc_app_instance"))
        self._step = _LIB.kc_app_step
        self._in, self._out = _FLIGHT.new("kc_in_t"), _FLIGHT.new("kc_out_t")
        self._inputs, self._outputs = wire.place(self._in), wire.Outputs(wire.place(self._out))
        self._newest_of = {name: self._inputs.member(name) for name in ("arm", "pantilt")}
        self._states = wire.States(self._inputs)
        self._states_given = self._others_given = False  # since the last step
        self._waiting = _Waiting()
        self._event_seq = 0
        FlightSoftware._newest = self
        _LIB.kc_app_init(self._app)
        _LIB.kc_app_keys(self._app, _key_ring(keys))
        images = [path.read_bytes() for path in sorted(tables.glob("*.tbl"))]
        for kind in _KINDS:
            defaults = [image for image in images if int.from_bytes(image[_KIND_AT], "little") == kind]
            for data in (*store.offered(kind), *defaults):
                _LIB.kc_app_load(self._app, kind, data, len(data))
        _LIB.kc_app_boot(self._app)

    @property
    def state(self) -> int:
        """State of flight after the last step, KC_ST_..."""
        return int(_LIB.kc_app_state(self._app))

    def receive(self, channel: str, message: Any) -> None:
        """A message for flight; of other channels it takes no notice. States of arm and pan-tilt unit are for
        the next step, everything else for the first one later than its stamp."""
        name = wire.member(channel)
        if name in _QUEUED:
            self._waiting.add(name, message)
        elif name:
            if self._states.there:
                self._states.withdraw()
            wire.fill(name, self._newest_of[name], message)
            setattr(self._in, f"has_{name}", 1)
            self._others_given = True

    def receive_states(self, world: World) -> None:
        """What receive() does with the messages of world.states(), without making them."""
        self._states.fill(world)
        self._states_given = True

    def step(self, now_us: int) -> list[Message]:
        """One tick at a mission time; what flight publishes, after all of it is stored."""
        if FlightSoftware._newest is not self:
            raise KincalError("another flight was started in this process", todo="run one after the other")
        if self._states.there and not self._states_given:
            self._states.withdraw()
        if self._waiting:
            self._take_due(now_us)
        self._step(self._app, now_us, self._in, self._out)
        self._states_given = False
        if self._others_given:
            self._clear()
        counts = self._outputs.counts()
        if counts is None:
            return []
        if self._out.n_store:
            self._store_all()
        published = self._outputs.messages(counts, now_us, self._event_seq)
        self._event_seq += self._out.events.n
        return published

    def _clear(self) -> None:
        """Nothing received but states without messages: most of what is in them stays as it is."""
        self._others_given = False
        if self._states.there:
            self._states.clear_others()
        else:
            wire.clear(self._inputs)

    def _take_due(self, now_us: int) -> None:
        """What waits and is due, into the input of the core."""
        self._others_given = True
        for name, due in self._waiting.take(now_us):
            for k, m in enumerate(due):
                wire.fill(name, self._inputs.member(name).entry(k), m)
            setattr(self._in, f"n_{name}", len(due))

    def _store_all(self) -> None:
        """Up to the first failure; the core hears how it went with the next step."""
        self._others_given = True
        for request in self._out.store[0 : self._out.n_store]:
            data = bytes(_FLIGHT.ffi.buffer(request.data, request.n)) if request.n else b""
            kept = self.keep(request.kind, data)
            self._in.has_store_result, self._in.store_kind = 1, request.kind
            self._in.store_status = _LIB.KC_OK if kept is not None else _LIB.KC_ERR_NUM
            if kept is None:
                return
            self.store.keep(request.kind, kept)
