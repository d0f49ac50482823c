"""Messages of LCM to the structs of kc_app_step and back, for flight in this process.

The flight process does the same in kc_wire.c, which the build makes from fsw/msg. A test compares the
two: every message of a run, byte for byte.
"""

from __future__ import annotations

import struct as packing
from collections.abc import Callable, Iterator
from functools import cache
from typing import TYPE_CHECKING, Any, TypeAlias, cast

import numpy as np

from kincal.flight import library
from kincal.link import unpack_covariance
from kincal.link.channels import BY_NAME, message_type, signed32

if TYPE_CHECKING:
    from kincal.flight.headers import (
        KcArmCmd,
        KcArmState,
        KcAuth,
        KcCmd,
        KcDetection,
        KcIn,
        KcMeas,
        KcOut,
        KcPantiltState,
        KcProposal,
        KcTableChunk,
    )
    from kincal.link.messages import ArmState, Cmd, Detection, LcmMessage, PantiltState, TableChunk

Message: TypeAlias = "tuple[str, Any]"
"""Channel and message (a type of messages.pyi, by the channel)."""

_FLIGHT = library("flight")
_NOTHING = bytes(_FLIGHT.ffi.sizeof("kc_in_t"))
_MASK = {"uint64_t": (1 << 64) - 1, "uint32_t": (1 << 32) - 1}  # LCM has no unsigned types
_OTHERWISE = ("cov", "data", "moving", "fault_mask", "mac")
_OUTPUTS = [  # flag and member of kc_out_t, channel
    (has, has[4:], f"KC_{has[4:].upper()}")
    for has, _ in _FLIGHT.ffi.typeof("kc_out_t").fields or ()
    if has.startswith("has_")
]
_INPUTS = {
    name.removeprefix("has_").removeprefix("n_")
    for name, _ in _FLIGHT.ffi.typeof("kc_in_t").fields or ()
    if name.startswith(("has_", "n_"))
} - {"rx_errors", "store_result"}
_UPPER = np.triu_indices(6)


# ---- in


def _unsigned32(value: int) -> int:
    """LCM has no unsigned types: negative ones become too large."""
    return value & 0xFFFFFFFF


def _alike(struct: Any, message: Any) -> None:
    """What both name alike and hold in the same way, as KC_..._FIELDS of the core."""
    kind: Any = type(message)
    signed, unsigned = _shared(_FLIGHT.ffi.typeof(struct), kind)
    for name in signed:
        setattr(struct, name, getattr(message, name))
    for name, mask in unsigned:
        setattr(struct, name, getattr(message, name) & mask)


@cache
def _shared(ctype: Any, kind: Any) -> tuple[tuple[str, ...], tuple[tuple[str, int], ...]]:
    """Fields that a struct and a message have in common: those that are copied, and those without a sign,
    with their masks."""
    fields = (ctype.item if ctype.kind == "pointer" else ctype).fields or ()
    alike = [(n, f.type.cname) for n, f in fields if n in kind.__slots__ and n not in _OTHERWISE]
    return (
        tuple(name for name, cname in alike if cname not in _MASK),
        tuple((name, _MASK[cname]) for name, cname in alike if cname in _MASK),
    )


def _fill_auth(auth: KcAuth, m: Cmd | TableChunk) -> None:
    _alike(auth, m)
    auth.mac = list(packing.pack("<2q", *m.mac))


def fill_cmd(s: KcCmd, m: Cmd) -> None:
    """KC_CMD."""
    _alike(s, m)
    _fill_auth(s.auth, m)


def fill_chunk(s: KcTableChunk, m: TableChunk) -> None:
    """KC_TABLE_UP."""
    _alike(s, m)
    s.data[0 : len(m.data)], s.total = bytes(m.data), _unsigned32(m.total_bytes)
    _fill_auth(s.auth, m)


def fill_arm(s: KcArmState, m: ArmState) -> None:
    """KC_ARM_STATE: the newest of a step counts, but no fault of it is lost."""
    _alike(s, m)
    s.q, s.dq, s.q_cmd = m.q_rad, m.dq_rad_s, m.q_cmd_rad
    s.moving, s.fault_mask = int(m.moving != 0), s.fault_mask | m.fault_mask


def fill_pantilt(s: KcPantiltState, m: PantiltState) -> None:
    """KC_PANTILT_STATE."""
    _alike(s, m)
    s.moving = int(m.moving != 0)


def fill_detection(s: KcDetection, m: Detection) -> None:
    """KC_DETECTION."""
    _alike(s, m)
    s.cov = unpack_covariance(m.cov, 6).ravel().tolist()


# Channel -> member of kc_in_t, if it is not the channel's name, and what fills it, if not _alike.
_MEMBERS = {
    "CMD": "cmd",
    "TABLE_UP": "chunk",
    "DETECTION": "det",
    "ARM_STATE": "arm",
    "PANTILT_STATE": "pantilt",
}
_FILL: dict[str, Callable[[Any, Any], None]] = {
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


def fill(name: str, struct: object, message: object) -> None:
    """A message into its struct of kc_in_t; name: of the member."""
    _FILL.get(name, _alike)(struct, message)


def clear(inputs: KcIn) -> None:
    """Nothing received."""
    _FLIGHT.ffi.memmove(cast(Any, inputs), _NOTHING, len(_NOTHING))


# ---- out


def messages(out: KcOut, t_us: int, event_seq: int) -> Iterator[Message]:
    """What flight publishes after a step, in its order. t_us: mission time of the step; event_seq: number of
    the last event before it."""
    for ack in out.ack[0 : out.n_ack]:
        yield "KC_ACK", _message("ack_t", ack, t_us=t_us)
    for k, event in enumerate(out.events.e[0 : out.events.n], 1):
        yield "KC_EVENT", _message("event_t", event, t_us=t_us, seq=event_seq + k)
    for has, name, channel in _OUTPUTS:
        if getattr(out, has):
            struct, make = getattr(out, name), _MAKE.get(name)
            message = make(struct, t_us) if make else _message(BY_NAME[channel].type, struct, t_us=t_us)
            yield channel, message


def _message(type_name: str, source: Any, /, **given: object) -> LcmMessage:
    """A message; fields that are not given are those of the struct with the same names."""
    kind = _type(type_name)
    message: LcmMessage = kind()
    long = _long(_FLIGHT.ffi.typeof(source))
    for name in kind.__slots__:
        if name in given:
            value = given[name]
        else:
            value = getattr(source, name)
            if type(value) is not float:  # most fields
                value = _plain(value, _signed64 if name in long else signed32)
        setattr(message, name, value)
    return message


_type = cache(message_type)


@cache
def _long(ctype: Any) -> frozenset[str]:
    """Fields of a struct with 64 bits."""
    fields = (ctype.item if ctype.kind == "pointer" else ctype).fields
    return frozenset(
        name for name, field in fields or () if field.type.cname.startswith(("uint64_t", "int64_t"))
    )


def _plain(value: Any, sign: Callable[[int], int] = signed32) -> Any:
    """A field of a struct as messages carry it: lists, and whole numbers with a sign."""
    if isinstance(value, (int, float)):
        return sign(value) if isinstance(value, int) else value
    values = list(value)
    return values if type(values[0]) is float else [_plain(x, sign) for x in values]


def _packed(cov: Any) -> list[float]:
    """Upper triangle of a covariance, row by row."""
    upper: list[float] = np.array(list(cov)).reshape(6, 6)[_UPPER].tolist()
    return upper


def _arm_cmd(s: KcArmCmd, t_us: int) -> LcmMessage:
    return _message("arm_cmd_t", s, t_us=t_us, q_rad=list(s.q))


def _table_down(s: KcTableChunk, t_us: int) -> LcmMessage:
    """Nobody's, and not signed."""
    given = {"t_us": t_us, "total_bytes": signed32(s.total), "data": bytes(s.data)}
    return _message("table_chunk_t", s, **given, key_id=0, counter=0, mac=[0, 0])


def _meas(s: KcMeas, _t_us: int) -> LcmMessage:
    crc = _plain(s.crc)
    lib = _FLIGHT.lib
    given = {name: _plain(getattr(s.arm, name)) for name in ("temp_c", "payload_kg", "g_m_s2")}
    given |= {name: _plain(getattr(s.obs, name)) for name in ("p_m", "q_wxyz", "p_cam_m", "q_cam_wxyz")}
    given |= {
        name: _plain(getattr(s.det, name))
        for name in (
            *("p_cam_tool_m", "q_cam_tool_wxyz", "n_tags", "tag_id", "p_alt_m", "q_alt_wxyz"),
            *("range_m", "incid_rad", "u_px", "v_px", "rms_px", "corner_px"),
        )
    }
    return _message(
        "meas_t",
        s,
        **given,
        t_us=s.t_us,
        q_rad=list(s.arm.q),
        q_cmd_rad=list(s.arm.q_cmd),
        dq_rad_s=list(s.arm.dq),
        dir=[int(d) for d in s.arm.dir],
        cov=_packed(s.obs.cov),
        crc_arm=crc[lib.KC_TBL_ARM],
        crc_camera=crc[lib.KC_TBL_CAMERA],
        crc_terms=crc[lib.KC_TBL_TERMS],
        crc_kin=crc[lib.KC_TBL_KIN],
    )


def _proposal(s: KcProposal, t_us: int) -> LcmMessage:
    kin = s.kin
    return _message(
        "proposal_t",
        s,
        t_us=t_us,
        n_coef=kin.n_coef,
        value=list(kin.value),
        sigma=list(kin.sigma),
        confounded=[_signed64(x) for x in s.confounded],
        crc_arm=signed32(kin.arm_crc),
        crc_terms=signed32(kin.terms_crc),
    )


# Members of kc_out_t that are not sent as _message does.
_MAKE: dict[str, Callable[[Any, int], LcmMessage]] = {
    "arm_cmd": _arm_cmd,
    "meas": _meas,
    "proposal": _proposal,
    "table_down": _table_down,
}


def _signed64(value: int) -> int:
    return value - (1 << 64) if value >= 1 << 63 else value
