"""Messages of LCM to the structs of kc_app_step and back, for flight in this process.

The flight process does the same in fsw/lcm/kc_wire.c. A test compares the two: every message of a run, byte
for byte.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from kincal.flight import library
from kincal.link import unpack_covariance
from kincal.link.channels import message_type, signed32

if TYPE_CHECKING:
    from kincal.flight.headers import (
        KcArmState,
        KcChunk,
        KcCmd,
        KcDetection,
        KcIn,
        KcMeas,
        KcOut,
        KcPantiltState,
        KcProposal,
    )
    from kincal.link.messages import ArmState, Cmd, Detection, LcmMessage, PantiltState, TableChunk

Message: TypeAlias = "tuple[str, Any]"
"""Channel and message (a type of messages.pyi, by the channel)."""

_FLIGHT = library("flight")
_NOTHING = bytes(_FLIGHT.ffi.sizeof("kc_in_t"))
_UNSIGNED_64 = (1 << 64) - 1
_UPPER = np.triu_indices(6)
_NOT_ESTIMATED = (_FLIGHT.lib.KC_COEF_MASKED, _FLIGHT.lib.KC_COEF_HELD)


# ---- in


def _copy(struct: object, message: object, names: Sequence[str]) -> None:
    for name in names:
        setattr(struct, name, getattr(message, name))


def _unsigned32(value: int) -> int:
    """LCM has no unsigned types: negative ones become too large."""
    return value & 0xFFFFFFFF


def _fill_auth(s: KcCmd | KcChunk, m: Cmd | TableChunk) -> None:
    s.t_us = m.t_us & _UNSIGNED_64
    s.auth.key_id, s.auth.counter = _unsigned32(m.key_id), m.counter & _UNSIGNED_64
    s.auth.mac = list(struct.pack("<2q", *m.mac))


def fill_cmd(s: KcCmd, m: Cmd) -> None:
    """KC_CMD."""
    _fill_auth(s, m)
    _copy(s, m, ("seq", "source", "opcode", "arg_i", "arg_d"))
    s.arg_u64 = m.arg_u64 & _UNSIGNED_64


def fill_chunk(s: KcChunk, m: TableChunk) -> None:
    """KC_TABLE_UP."""
    _fill_auth(s, m)
    s.source = m.source
    s.kind, s.data[0 : len(m.data)] = m.kind, bytes(m.data)
    s.total, s.offset, s.n = (_unsigned32(x) for x in (m.total_bytes, m.offset, m.n))


def fill_arm(s: KcArmState, m: ArmState) -> None:
    """KC_ARM_STATE."""
    s.t_us = m.t_us & _UNSIGNED_64
    _copy(s, m, ("seq", "dir", "fault_mask", "temp_c", "payload_kg", "g_m_s2"))
    s.n_joints, s.moving = _unsigned32(m.n_joints), int(m.moving != 0)
    s.q, s.dq, s.q_cmd = m.q_rad, m.dq_rad_s, m.q_cmd_rad


def fill_pantilt(s: KcPantiltState, m: PantiltState) -> None:
    """KC_PANTILT_STATE."""
    s.t_us = m.t_us & _UNSIGNED_64
    _copy(s, m, ("seq", "pan_rad", "tilt_rad"))
    s.moving = int(m.moving != 0)


def fill_detection(s: KcDetection, m: Detection) -> None:
    """KC_DETECTION."""
    s.t_us = m.t_us & _UNSIGNED_64
    _copy(s, m, ("seq", "tag_id", "p_cam_tool_m", "q_cam_tool_wxyz", "p_alt_m", "q_alt_wxyz"))
    _copy(s, m, ("rms_px", "rms_alt_px", "range_m", "incid_rad", "u_px", "v_px", "corner_px"))
    s.n_tags = _unsigned32(m.n_tags)
    s.cov = unpack_covariance(m.cov, 6).ravel().tolist()


def clear(inputs: KcIn) -> None:
    """Nothing received."""
    _FLIGHT.ffi.memmove(_FLIGHT.address(inputs), _NOTHING, len(_NOTHING))


# ---- out


def messages(out: KcOut, t_us: int, event_seq: int) -> Iterator[Message]:
    """What flight publishes after a step, in its order. t_us: mission time of the step; event_seq: number of
    the last event before it."""
    for ack in out.ack[0 : out.n_ack]:
        yield "KC_ACK", _message("ack_t", ack, t_us=t_us)
    for k, event in enumerate(out.events.e[0 : out.events.n], 1):
        yield "KC_EVENT", _message("event_t", event, t_us=t_us, seq=event_seq + k)
    if out.has_arm_cmd:
        yield "KC_ARM_CMD", _message("arm_cmd_t", out.arm_cmd, t_us=t_us, q_rad=list(out.arm_cmd.q))
    if out.has_pantilt_cmd:
        yield "KC_PANTILT_CMD", _message("pantilt_cmd_t", out.pantilt_cmd, t_us=t_us)
    if out.has_frame_request:
        yield "KC_FRAME_REQUEST", _message("frame_request_t", None, t_us=t_us, seq=out.frame_seq)
    if out.has_meas:
        yield "KC_MEAS", _meas(out.meas)
    if out.has_progress:
        yield "KC_PROGRESS", _message("progress_t", out.progress, t_us=t_us)
    if out.has_proposal:
        yield "KC_PROPOSAL", _proposal(out.proposal, t_us)
    if out.has_dump:
        data, total = bytes(out.dump.data), signed32(out.dump.total)
        unsigned = {"source": 0, "key_id": 0, "counter": 0, "mac": [0, 0]}
        given = {"t_us": t_us, "total_bytes": total, "data": data, **unsigned}
        yield "KC_TABLE_DOWN", _message("table_chunk_t", out.dump, **given)
    if out.has_hk:
        crcs = _plain(out.hk.crc)
        yield "KC_HK", _message("hk_t", out.hk, t_us=t_us, n_tx_errors=0, table_crc=crcs)


def _message(type_name: str, source: object, /, **given: object) -> LcmMessage:
    """A message; fields that are not given are those of the struct with the same names."""
    message: LcmMessage = message_type(type_name)()
    for name in message_type(type_name).__slots__:
        setattr(message, name, given[name] if name in given else _plain(getattr(source, name)))
    return message


def _plain(value: Any) -> Any:
    """A field of a struct as messages carry it: lists, and 32 bits with a sign."""
    if isinstance(value, (int, float)):
        return signed32(value) if isinstance(value, int) else value
    return [_plain(x) for x in value]


def _packed(cov: Any) -> list[float]:
    """Upper triangle of a covariance, row by row."""
    upper: list[float] = np.array(list(cov)).reshape(6, 6)[_UPPER].tolist()
    return upper


def _meas(s: KcMeas) -> LcmMessage:
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
    """sigma is 0 where this calibration estimated nothing; the table keeps the old one there."""
    status, kin = list(s.status), s.kin
    sigma = [0.0 if st in _NOT_ESTIMATED else x for x, st in zip(kin.sigma, status, strict=True)]
    return _message(
        "proposal_t",
        s,
        t_us=t_us,
        n_coef=kin.n_coef,
        value=list(kin.value),
        sigma=sigma,
        confounded=[_signed64(x) for x in s.confounded],
        crc_arm=signed32(kin.arm_crc),
        crc_terms=signed32(kin.terms_crc),
    )


def _signed64(value: int) -> int:
    return value - (1 << 64) if value >= 1 << 63 else value
