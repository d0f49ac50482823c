"""Messages of LCM to the structs of kc_app_step and back, for flight in this process.

The flight process does the same in kc_wire.c, which the build makes from fsw/msg; what is sent follows the
same words of the message files here. A test compares the two: every message of a run, byte for byte.
"""

from __future__ import annotations

import re
import struct as packing
from collections import deque
from collections.abc import Callable, Iterable
from functools import cache
from itertools import repeat
from operator import attrgetter, itemgetter
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, cast

import numpy as np

from kincal.flight import library
from kincal.link import unpack_covariance
from kincal.link.channels import BY_NAME, message_type
from kincal_shared.schema.messages import fields_of

if TYPE_CHECKING:
    from kincal.link.messages import ArmState, Cmd, Detection, PantiltState, TableChunk
    from kincal_sim.world import World

Message: TypeAlias = "tuple[str, Any]"
"""Channel and message (a type of messages.pyi, by the channel)."""

_FLIGHT = library("flight")
_NOTHING = bytes(_FLIGHT.ffi.sizeof("kc_in_t"))
_CODES = {  # as messages carry them: LCM has no unsigned types
    "double": "d",
    "int32_t": "i",
    "uint32_t": "i",
    "int64_t": "q",
    "uint64_t": "q",
    "uint8_t": "B",
    "uint16_t": "H",
    "_Bool": "B",
}
_OUTPUTS = [  # member of kc_out_t, channel
    (has[4:], f"KC_{has[4:].upper()}")
    for has, _ in _FLIGHT.ffi.typeof("kc_out_t").fields or ()
    if has.startswith("has_")
]
_INPUTS = {
    name.removeprefix("has_").removeprefix("n_")
    for name, _ in _FLIGHT.ffi.typeof("kc_in_t").fields or ()
    if name.startswith(("has_", "n_"))
} - {"rx_errors", "store_result"}
# Of a covariance, row by row: its upper triangle from all 36 entries, and these from that.
_UPPER_OF_WHOLE = itemgetter(*np.ravel_multi_index(np.triu_indices(6), (6, 6)).tolist())
_WHOLE_OF_UPPER = itemgetter(*unpack_covariance(np.arange(21.0), 6).astype(int).ravel().tolist())


class Place(NamedTuple):
    """A struct, or an array of them, in memory."""

    ctype: Any
    memory: Any
    offset: int = 0

    def member(self, name: str) -> Place:
        """A member of the struct."""
        field = _members(self.ctype)[name]
        return Place(field.type, self.memory, self.offset + field.offset)

    def entry(self, k: int) -> Place:
        """A struct of the array."""
        item = self.ctype.item
        return Place(item, self.memory, self.offset + k * _FLIGHT.ffi.sizeof(item))


def place(pointer: object) -> Place:
    """Where a pointer to a struct points; valid as long as the struct lives."""
    return Place(_FLIGHT.ffi.typeof(cast(Any, pointer)).item, _FLIGHT.ffi.buffer(cast(Any, pointer)))


@cache
def _members(ctype: Any) -> dict[str, Any]:
    return dict(ctype.fields)


class _Layout:
    """Some fields of a struct, read or written at once.

    fields: name, and whether it is an array; at: where its values are among all of them."""

    def __init__(self, ctype: Any, wanted: Callable[[str], bool] = lambda _name: True) -> None:
        self.fields: list[tuple[str, bool]] = []
        self.at: dict[str, int | slice] = {}
        form, end, count = "=", 0, 0
        for name, field in ctype.fields:
            n = field.type.length if field.type.kind == "array" else 1
            code = _CODES.get((field.type.item if field.type.kind == "array" else field.type).cname)
            if code is None or not wanted(name):
                continue
            form += f"{field.offset - end}x{n}{code}"
            end = field.offset + _FLIGHT.ffi.sizeof(field.type)
            array = field.type.kind == "array"
            self.fields.append((name, array))
            self.at[name] = slice(count, count + n) if array else count
            count += n
        self._packing = packing.Struct(form)
        self.unpack_from = self._packing.unpack_from

    def read(self, struct: Place, beyond: int = 0) -> tuple[Any, ...]:
        """All values, those without a sign as messages have them, with one. beyond: bytes after the place."""
        return self.unpack_from(struct.memory, struct.offset + beyond)

    def write(self, struct: Place, values: Iterable[Any]) -> None:
        """All values; what lies between them becomes zero."""
        self._packing.pack_into(struct.memory, struct.offset, *values)


_whole = cache(_Layout)


def _listed(value: Any) -> Any:
    return list(value) if type(value) is tuple else value


# ---- what the message files say


def _packed(cov: Any) -> list[float]:
    """Upper triangle of a covariance, row by row."""
    return list(_UPPER_OF_WHOLE(cov))


def _whole_numbers(value: Any) -> Any:
    return [int(x) for x in value] if isinstance(value, list) else int(value)


def _same(value: Any) -> Any:
    return value


_MADE: dict[str, Callable[[Any], Any]] = {"real": _whole_numbers, "byte": bytes}


class _Kept(NamedTuple):
    """A field of a message that flight keeps elsewhere or as another type: its name there, which entry of the
    array (None: all), and what makes the message's value of it."""

    name: str
    kept: str
    entry: int | None
    made: Callable[[Any], Any]


_AS = re.compile(r"as ((?:\w+\.)*)(\w+)(?:\[(\w+)\])?")


@cache
def _words(type_name: str) -> dict[str, list[str]]:
    """Field -> what its message file says behind it."""
    return {field.name: field.flight.split(", ") for field in fields_of(type_name)}


@cache
def _elsewhere(type_name: str) -> dict[tuple[str, ...], list[_Kept]]:
    """Fields that are no plain copies, by the members on the way to them."""
    found: dict[tuple[str, ...], list[_Kept]] = {}
    for field in fields_of(type_name):
        words = _words(type_name)[field.name]
        place = next(filter(None, map(_AS.fullmatch, words)), None)
        made = _packed if "triangle" in words else _MADE.get("real" if "real" in words else field.base)
        if "received" in words or not (place or made):
            continue
        path, kept, entry = place.groups() if place else ("", field.name, None)
        number = _FLIGHT.constant(entry) if entry else None
        row = _Kept(field.name, kept, number, made or _same)
        found.setdefault(tuple(path.split(".")[:-1]), []).append(row)
    return found


# ---- in


def _write(struct: Place, message: Any, /, **given: Any) -> None:
    """A message; fields that are not given are those of the message with the same names."""
    kind: Any = type(message)
    layout, read, order = _shared(struct.ctype, kind, tuple(given))
    have = (*read(message), *given.values())
    values: list[Any] = []
    for (_, array), k in zip(layout.fields, order, strict=True):
        if array:
            values += have[k]
        else:
            values.append(have[k])
    layout.write(struct, values)


@cache
def _shared(
    ctype: Any, kind: Any, given: tuple[str, ...]
) -> tuple[_Layout, Callable[[Any], Any], tuple[int, ...]]:
    """Fields that a struct and a message have in common, what reads those that are not given, and where each
    field is among what was read and given."""
    renamed = {kept.kept: kept.name for kept in _elsewhere(kind.__name__).get((), ()) if kept.entry is None}
    layout = _Layout(ctype, lambda name: renamed.get(name, name) in kind.__slots__)
    names = [name for name, _ in layout.fields]
    read = [name for name in names if name not in given]
    order = tuple([*read, *given].index(name) for name in names)
    return layout, attrgetter(*(renamed.get(name, name) for name in read)), order


def _write_auth(struct: Place, m: Cmd | TableChunk) -> None:
    _write(struct.member("auth"), m, mac=packing.pack("<2q", *m.mac))


def fill_cmd(struct: Place, m: Cmd) -> None:
    """KC_CMD."""
    _write(struct, m)
    _write_auth(struct, m)


def fill_chunk(struct: Place, m: TableChunk) -> None:
    """KC_TABLE_UP."""
    _write(struct, m)
    _write_auth(struct, m)


_FAULTS = _Layout(_FLIGHT.ffi.typeof("kc_arm_state_t"), lambda name: name == "fault_mask")


def fill_arm(struct: Place, m: ArmState) -> None:
    """KC_ARM_STATE: the newest of a step counts, but no fault of it is lost."""
    (faults,) = _FAULTS.read(struct)
    _write(struct, m, moving=int(m.moving != 0), fault_mask=faults | m.fault_mask)


def fill_pantilt(struct: Place, m: PantiltState) -> None:
    """KC_PANTILT_STATE."""
    _write(struct, m, moving=int(m.moving != 0))


class States:
    """States of arm and pan-tilt unit into kc_in_t without messages between: most of what a simulated flight
    receives. The same bytes as from fill_arm and fill_pantilt.

    there: the inputs hold those of an earlier fill(), which writes what has changed since."""

    _VECTORS = ("q", "dq", "q_cmd", "dir")
    _HEAD = packing.Struct("=qiI")  # t_us, seq, n_joints
    _REST = packing.Struct("=B3xi5d")  # moving, fault_mask, temp_c, payload_kg, g_m_s2
    _NEWER = packing.Struct("=qi")  # t_us, seq
    _AIMS = packing.Struct("=2dB7x")  # pan_rad, tilt_rad, moving

    def __init__(self, inputs: Place) -> None:
        self._memory = inputs.memory
        arm, pantilt, flags = (inputs.member(name) for name in ("arm", "pantilt", "has_arm"))
        self._arm_at, self._pantilt_at = arm.offset, pantilt.offset
        self._aims_at = pantilt.member("pan_rad").offset
        self._rest_at = arm.member("moving").offset
        self._flags_at = slice(flags.offset, flags.offset + 2)  # has_arm, has_pantilt
        self._end = pantilt.offset + _FLIGHT.ffi.sizeof(pantilt.ctype)
        vectors = (arm.member(name) for name in self._VECTORS)
        self._vectors = [np.frombuffer(self._memory, float, v.ctype.length, v.offset) for v in vectors]
        self.there = False
        # What is in the inputs already, if these are there.
        self._held: list[object] = [None] * len(self._VECTORS)
        self._held_rest: tuple[bool, int] = (False, 0)
        self._held_aims: tuple[object, bool] = (None, False)

    def fill(self, world: World) -> None:
        """What the encoders of the world read, as the newest states. Surroundings do not change in a run."""
        if not self.there:
            self._begin(world)
        controller, held, vectors = world.controller, self._held, self._vectors
        # Arrays of the world are never changed in place.
        if (q := world.q_rad) is not held[0]:
            held[0] = q
            vectors[0][: len(q)] = q
        if (dq := world.dq_rad_s) is not held[1]:
            held[1] = dq
            vectors[1][: len(dq)] = dq
        if (q_cmd := controller.q_cmd) is not held[2]:
            held[2] = q_cmd
            vectors[2][: len(q_cmd)] = q_cmd
        if (direction := controller.trajectory.direction) is not held[3]:
            held[3] = direction
            vectors[3][: len(direction)] = direction
        rest = world.arm_moves, controller.fault_mask
        if rest != self._held_rest:
            self._hold_rest(world)
        if world.pantilt_rad is not self._held_aims[0] or world.pantilt_moves is not self._held_aims[1]:
            self._held_aims = world.pantilt_rad, world.pantilt_moves
            aims = world.pantilt_rad.tolist()
            self._AIMS.pack_into(self._memory, self._aims_at, *aims, world.pantilt_moves)
        self._HEAD.pack_into(self._memory, self._arm_at, world.now_us, world.seq, len(q))
        self._NEWER.pack_into(self._memory, self._pantilt_at, world.now_us, world.seq)

    def _begin(self, world: World) -> None:
        """Into inputs that hold none."""
        self.there = True
        self._held = [None] * len(self._VECTORS)
        self._held_aims = (None, False)
        self._hold_rest(world)
        self._memory[self._flags_at] = b"\1\1"

    def _hold_rest(self, world: World) -> None:
        env, fault_mask = world.scenario.env, world.controller.fault_mask
        self._held_rest = world.arm_moves, fault_mask
        rest = (world.arm_moves, fault_mask, env.temp_c, env.payload_kg, *world.gravity_m_s2)
        self._REST.pack_into(self._memory, self._rest_at, *rest)

    def withdraw(self) -> None:
        """Neither of them received."""
        self.there = False
        self._memory[self._flags_at.start : self._end] = bytes(self._end - self._flags_at.start)

    def clear_others(self) -> None:
        """Nothing received but these."""
        self._memory[: self._flags_at.start] = _NOTHING[: self._flags_at.start]
        self._memory[self._end :] = _NOTHING[self._end :]


def fill_detection(struct: Place, m: Detection) -> None:
    """KC_DETECTION."""
    _write(struct, m, cov=_WHOLE_OF_UPPER(m.cov))


# Channel -> member of kc_in_t, if it is not the channel's name, and what fills it, if not _alike.
_MEMBERS = {
    "CMD": "cmd",
    "TABLE_UP": "chunk",
    "DETECTION": "det",
    "ARM_STATE": "arm",
    "PANTILT_STATE": "pantilt",
}
_FILL: dict[str, Callable[[Place, Any], None]] = {
    "cmd": fill_cmd,
    "chunk": fill_chunk,
    "det": fill_detection,
    "arm": fill_arm,
    "pantilt": fill_pantilt,
}


@cache
def member(channel: str) -> str:
    """Where a message of a channel goes: the member of kc_in_t, "" if it is not for flight."""
    name = channel.removeprefix("KC_")
    name = _MEMBERS.get(name, name.lower())
    return name if name in _INPUTS else ""


def fill(name: str, struct: Place, message: object) -> None:
    """A message into its struct of kc_in_t; name: of the member."""
    _FILL[name](struct, message)


def clear(inputs: Place) -> None:
    """Nothing received."""
    inputs.memory[:] = _NOTHING


# ---- out


def _counting() -> packing.Struct:
    """How much is in kc_out_t, in the order of its members: of events too, which count themselves."""
    form, end = "=", 0
    for name, field in _FLIGHT.ffi.typeof("kc_out_t").fields or ():
        at, number = field.offset, field.type
        if name == "events":
            inner = _members(field.type)["n"]
            at, number = at + inner.offset, inner.type
        elif not name.startswith(("n_", "has_")):
            continue
        form += f"{at - end}x{_CODES[number.cname]}"
        end = at + _FLIGHT.ffi.sizeof(number)
    return packing.Struct(form)


_COUNTS = _counting().unpack_from
_NO_COUNTS = (0,) * (3 + len(_OUTPUTS))


class Outputs:
    """What a step of flight gave, in a kc_out_t that is used again and again."""

    def __init__(self, out: Place) -> None:
        self._memory = out.memory
        self._acks, self._events = out.member("ack"), out.member("events").member("e")
        self._ack = _reading("ack_t", self._acks.ctype.item)
        self._event = _reading("event_t", self._events.ctype.item)
        places = [(channel, out.member(name)) for name, channel in _OUTPUTS]
        self._others = [(c, _reading(BY_NAME[c].type, place.ctype), place) for c, place in places]

    def counts(self) -> tuple[int, ...] | None:
        """How much: answers, store requests, events, outputs of KC_OUT_LIST. None: nothing."""
        found = _COUNTS(self._memory)
        return None if found == _NO_COUNTS else found

    def messages(self, counts: tuple[int, ...], t_us: int, event_seq: int) -> list[Message]:
        """What flight publishes after a step, in its order. counts: of this step; t_us: its mission time;
        event_seq: number of the last event before it."""
        n_ack, _, n_event, *has = counts
        found: list[Message] = []
        for k in range(n_ack):
            found.append(("KC_ACK", self._ack.message(self._acks.entry(k), t_us)))
        for k in range(n_event):
            event = self._event.message(self._events.entry(k), t_us)
            event.seq = event_seq + k + 1
            found.append(("KC_EVENT", event))
        for (channel, reading, place), there in zip(self._others, has, strict=True):
            if there:
                found.append((channel, reading.message(place, t_us)))
        return found


class _Reading:
    """How a message is made of its struct: what is the same for all messages of a type."""

    def __init__(self, type_name: str, ctype: Any) -> None:
        self.kind: Any = message_type(type_name)
        self.layout = _Layout(ctype, lambda name: name in self.kind.__slots__)
        self.alike = [name for name, _ in self.layout.fields]
        self.values = itemgetter(*self.layout.at.values(), 0)  # 0: of one index alone it would give no tuple
        self.elsewhere = [self._kept(ctype, *group) for group in _elsewhere(type_name).items()]
        self.zeros = _zeros(type_name)
        self.stamped = _stamped(type_name)

    def message(self, struct: Place, t_us: int) -> Any:
        """A message of a struct. t_us: its time, if the struct has none."""
        message = self.kind.__new__(self.kind)
        values = self.values(self.layout.read(struct))
        # Hundreds in a run: half the time of a loop.
        deque(map(setattr, repeat(message), self.alike, values), maxlen=0)
        for layout, beyond, fields in self.elsewhere:
            values = layout.read(struct, beyond)
            for name, at, made in fields:
                setattr(message, name, made(_listed(values[at])))
        for name, zeros in self.zeros.items():
            setattr(message, name, _listed(zeros))
        if self.stamped:
            message.t_us = t_us
        return message

    @staticmethod
    def _kept(ctype: Any, path: tuple[str, ...], fields: list[_Kept]) -> tuple[_Layout, int, list[_Made]]:
        """An inner struct, where it is [bytes], and which of its values make which fields."""
        inner = Place(ctype, None)
        for name in path:
            inner = inner.member(name)
        layout, made = _whole(inner.ctype), []
        for field in fields:
            at = layout.at[field.kept]
            if field.entry is not None:
                at = cast(slice, at).start + field.entry
            made.append((field.name, at, field.made))
        return layout, inner.offset, made


_Made: TypeAlias = "tuple[str, int | slice, Callable[[Any], Any]]"
_reading = cache(_Reading)


@cache
def _zeros(type_name: str) -> dict[str, object]:
    """Fields that flight does not fill in what it sends."""
    return {
        field.name: (0,) * field.length if "[" in field.type else 0
        for field in fields_of(type_name)
        if "received" in _words(type_name)[field.name]
    }


@cache
def _stamped(type_name: str) -> bool:
    """Whether a message gets its time when it is sent."""
    return "edge" in _words(type_name)["t_us"]
