"""The XTCE 1.2 database of the packets: every field with unit, meaning, names of its numbers, and alarms.

The fields come from fsw/msg (kincal_shared.schema.messages), the names of numbers from flight's headers, the
events with their texts from its dictionary. pymdb writes the XML.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import yamcs.pymdb as Y

from kincal.flight import library
from kincal.link import channels
from kincal_shared.schema.messages import Field, fields_of

from .packets import APIDS, DEFAULT_APID, check_apid

_BITS = {"int8_t": 8, "int16_t": 16, "int32_t": 32, "int64_t": 64, "double": 64}
_MOST_ELEMENTS = 64  # a longer array is one binary parameter
_AXES = {3: "xyz", 4: "wxyz"}
_NOTICE, _WARNING, _CRITICAL = (list(Y.AlarmLevel)[i] for i in (1, 2, 4))  # of XTCE's levels, from normal up
_RATES_S = {"KC_HK": 1.0, "KC_ARM_STATE": 0.1, "KC_PANTILT_STATE": 0.1}  # of those that come all the time


@dataclass(frozen=True)
class _Choices:
    """Names of the numbers of a field, with what they mean, and which of them raise an alarm."""

    names: Mapping[int, tuple[str, str]]
    alarms: Mapping[str, Y.AlarmLevel]


def _enum(ctype: str, prefix: str, alarms: Mapping[str, Y.AlarmLevel] | None = None) -> _Choices:
    names = {number: (name, "") for name, number in library("flight").enum(ctype, prefix).items()}
    return _Choices(names, alarms or {})


def _events() -> _Choices:
    flight = library("flight")
    numbers = flight.enum("kc_event_id_t", "KC_EVT_").items()
    return _Choices(
        {i: (name, flight.text(flight.lib.kc_event_text(i)) if i else "") for name, i in numbers}, {}
    )


def _statuses() -> _Choices:
    names = _enum("kc_status_t", "KC_").names
    return _Choices(names, {name: _WARNING for name, _ in names.values() if name != "OK"})


@cache
def _choices() -> dict[tuple[str, str], _Choices]:
    """By message and field."""
    states = _enum("kc_state_t", "KC_ST_", {"SAFE": _WARNING, "REVIEW": _NOTICE, "ARMED": _NOTICE})
    stored_states = _Choices({-1: ("NONE", "it was idle"), **states.names}, {})
    verdicts = _enum("kc_verdict_t", "KC_VERDICT_", {"POOR": _CRITICAL, "CHANGE": _NOTICE})
    kinds = _Choices({0: ("NONE", ""), **_enum("kc_tbl_kind_t", "KC_TBL_").names}, {})
    severities = _enum("kc_severity_t", "KC_SEV_", {"WARN": _WARNING, "ERROR": _CRITICAL})
    monitor = {
        0: ("QUIET", ""),
        1: ("JOINT", "a joint is named"),
        2: ("UNEXPLAINED", "no single joint explains it"),
    }
    staged = {0: ("NONE", ""), 1: ("LOADING", ""), 2: ("COMPLETE", ""), 3: ("VALID", "")}
    chosen = _Choices(
        {-1: ("INITIAL_DESIGN", "not by an acquisition"), **_enum("kc_acq_t", "KC_ACQ_").names}, {}
    )
    return {
        ("hk_t", "state"): states,
        ("hk_t", "boot_state"): stored_states,
        ("hk_t", "last_event_id"): _events(),
        ("hk_t", "proposal_verdict"): verdicts,
        ("hk_t", "mon_state"): _Choices(monitor, {"JOINT": _WARNING, "UNEXPLAINED": _WARNING}),
        ("hk_t", "staged_kind"): kinds,
        ("hk_t", "staged_state"): _Choices(staged, {}),
        ("event_t", "id"): _events(),
        ("event_t", "severity"): severities,
        ("ack_t", "opcode"): _enum("kc_opcode_t", "KC_CMD_"),
        ("ack_t", "source"): _enum("kc_source_t", "KC_SRC_"),
        ("ack_t", "status"): _statuses(),
        ("ack_t", "event_id"): _events(),
        ("progress_t", "acquisition"): chosen,
        ("progress_t", "est_status"): _statuses(),
        ("proposal_t", "verdict"): verdicts,
        ("proposal_t", "frame"): _enum("kc_right_in_t", "KC_RIGHT_IN_"),
        ("proposal_t", "status"): _enum("kc_coef_status_t", "KC_COEF_"),
    }


_NOT_ZERO = partial(Y.ThresholdAlarm, warning_high=0.0, warning_low=0.0)
_ALARMS = {
    ("hk_t", "n_events_dropped"): _NOT_ZERO,
    ("hk_t", "n_tx_errors"): _NOT_ZERO,
    ("hk_t", "n_rx_errors"): _NOT_ZERO,
    ("arm_state_t", "fault_mask"): partial(Y.ThresholdAlarm, critical_high=0.0, critical_low=0.0),
}
"""Limits of numbers, by message and field."""


def _is_bits(name: str) -> bool:
    """CRCs and masks travel in signed fields; they are bits."""
    return "crc" in name or name.endswith(("_mask", "_suspects", "confounded"))


def _elements(field: Field) -> Iterator[tuple[str, str]]:
    """(name of a parameter, which element it is) for each value of a field."""
    if field.name == "table_crc":  # by kind of table, from 1
        kinds = {number: name for name, number in library("flight").enum("kc_tbl_kind_t", "KC_TBL_").items()}
        for i in range(field.length):
            yield f"{field.name}_{kinds.get(i, i)}", f"kind {i}"
        return
    if field.length == 1:
        yield field.name, ""
        return
    axes = _AXES.get(field.length, "") if field.base == "double" else ""
    name = field.name.removesuffix("_wxyz")
    for i in range(field.length):
        yield (f"{name}_{axes[i]}", axes[i]) if axes else (f"{name}_{i + 1}", f"element {i + 1}")


def _integer(bits: int, signed: bool) -> Y.Encoding:
    scheme = Y.IntegerEncodingScheme.TWOS_COMPLEMENT if signed else Y.IntegerEncodingScheme.UNSIGNED
    return Y.IntegerEncoding(bits=bits, scheme=scheme)


def _parameter(system: Y.System, field: Field, name: str, which: str) -> Y.Parameter[Any]:
    short = ", ".join(part for part in (field.meaning or field.name, which) if part)
    long, units = f"Field {field.name} of {field.message}", field.unit or None
    key, bits = (field.message, field.name), _BITS[field.base]
    limit = _ALARMS[key]() if key in _ALARMS else None
    if found := _choices().get(key):
        names = sorted(found.names.items())
        return Y.EnumeratedParameter(
            system,
            name,
            [(n, label, text) if text else (n, label) for n, (label, text) in names],
            alarm=Y.EnumerationAlarm(dict(found.alarms)) if found.alarms else None,
            short_description=short,
            long_description=long,
            encoding=_integer(bits, signed=True),
        )
    if field.base == "double":
        return Y.FloatParameter(
            system,
            name,
            bits=64,
            alarm=limit,
            short_description=short,
            long_description=long,
            units=units,
            encoding=Y.FloatEncoding(bits=64),
        )
    signed = not _is_bits(field.name)
    return Y.IntegerParameter(
        system,
        name,
        signed=signed,
        bits=bits,
        alarm=limit,
        short_description=short,
        long_description=long,
        units=units,
        encoding=_integer(bits, signed),
    )


def _binary(system: Y.System, field: Field, name: str) -> Y.Parameter[Any]:
    return Y.BinaryParameter(
        system,
        name,
        short_description=f"{field.meaning or field.name} ({field.length} x {field.base}, big-endian)",
        long_description=f"Field {field.name} of {field.message}",
        encoding=Y.BinaryEncoding(bits=_BITS[field.base] * field.length),
    )


_HEADER = (
    ("VERSION", 3, "Packet version number"),
    ("TYPE", 1, "0: telemetry"),
    ("SEC_HDR_FLG", 1, "0: no secondary header"),
    ("PKT_APID", 11, "Application process identifier: which channel"),
    ("SEQ_FLGS", 2, "3: not a part of a longer message"),
    ("SRC_SEQ_CTR", 14, "Packet sequence count of this identifier"),
    ("PKT_LEN", 16, "Bytes after the header, less one"),
)
"""Primary header: name, bits, meaning. The names are those that other tools use too."""


def _header(system: Y.System) -> tuple[Y.Container, Y.Parameter[Any]]:
    """The container that all packets extend, and the identifier that tells them apart."""
    found = {
        name: Y.IntegerParameter(
            system,
            name,
            signed=False,
            bits=32,
            short_description=about,
            encoding=_integer(bits, signed=False),
        )
        for name, bits, about in _HEADER
    }
    container = Y.Container(
        system,
        "CCSDSPacket",
        [Y.ParameterEntry(parameter) for parameter in found.values()],
        abstract=True,
        short_description="Space packet, CCSDS 133.0-B-2",
    )
    return container, found["PKT_APID"]


def _add(system: Y.System, base: Y.Container, apid: Y.EqExpression, channel: str) -> None:
    """The packet of a channel. Parameters carry its name: KC_HK_state."""
    about = channels.BY_NAME[channel]
    fingerprint = Y.IntegerParameter(
        system,
        f"{channel}_fingerprint",
        signed=True,
        bits=64,
        short_description=f"Fingerprint of {about.type}: other message definitions, other number",
        encoding=_integer(64, signed=True),
    )
    entries = [Y.ParameterEntry(fingerprint)]
    for field in fields_of(about.type):
        if field.length > _MOST_ELEMENTS:
            entries.append(Y.ParameterEntry(_binary(system, field, f"{channel}_{field.name}")))
        else:
            entries += [
                Y.ParameterEntry(_parameter(system, field, f"{channel}_{name}", which))
                for name, which in _elements(field)
            ]
    Y.Container(
        system,
        channel,
        entries,
        base=base,
        condition=apid,
        short_description=f"{about.purpose} ({about.type}, {about.rate})",
        rate=_RATES_S.get(channel),
    )


def xtce(first_apid: int = DEFAULT_APID) -> str:
    """XTCE 1.2 of all packets that the bridge sends with the same first identifier.

    BadInput if the identifiers do not fit into a packet header."""
    check_apid(first_apid)
    system = Y.System("KinCal", short_description="KinCal flight component: telemetry as CCSDS space packets")
    base, apid = _header(system)
    for channel, offset in APIDS.items():
        _add(system, base, Y.EqExpression(apid, first_apid + offset), channel)
    return system.dumps()
