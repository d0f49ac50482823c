"""LCM telemetry as CCSDS space packets (CCSDS 133.0-B-2, Space Packet Protocol).

A packet is the primary header (6 bytes, big-endian) and, as packet data field, the LCM message as LCM encodes
it: the fingerprint of its type (8 bytes), then its fields in the order of the .lcm file, big-endian, no gaps.
So nothing is converted or lost. There is no secondary header; mission time is the first field, `t_us`.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

from kincal.link import channels
from kincal_shared.errors import BadInput

APIDS = {
    "KC_HK": 1,
    "KC_EVENT": 2,
    "KC_ACK": 3,
    "KC_PROGRESS": 4,
    "KC_PROPOSAL": 5,
    "KC_MEAS": 6,
    "KC_ARM_STATE": 7,
    "KC_PANTILT_STATE": 8,
    "KC_DETECTION": 9,
    "KC_ARM_CMD": 10,
    "KC_PANTILT_CMD": 11,
}
"""Offset of each channel from the first application process identifier. Numbers never change meaning: a new
channel takes the next one."""

DEFAULT_APID = 1000
_APID_MAX = 2**11 - 2  # 2047 is that of idle packets
_COUNT_MODULUS = 2**14
_STANDALONE = 0b11  # sequence flags: not a part of a longer message
_HEADER = struct.Struct(">HHH")
HEADER_BYTES = _HEADER.size
FINGERPRINT_BYTES = 8


def check_apid(first_apid: int) -> int:
    """The first identifier, if all of them fit into 11 bits. BadInput if not."""
    most = _APID_MAX - max(APIDS.values())
    if not 0 <= first_apid <= most:
        raise BadInput(f"--apid {first_apid} is outside 0 to {most}", todo="the header has 11 bits for it")
    return first_apid


def fingerprint(message_type: str) -> bytes:
    """The eight bytes with which LCM begins a message of that type, e.g. "hk_t"."""
    packed: bytes = channels.message_type(message_type)._get_packed_fingerprint()  # noqa: SLF001 lcm-gen's only name
    return packed


@dataclass
class Packer:
    """Makes packets; counts them by channel, as the protocol asks."""

    first_apid: int = DEFAULT_APID
    _counts: dict[str, int] = field(default_factory=dict)

    def packet(self, channel: str, message: bytes) -> bytes:
        """The packet of an encoded message. KeyError for a channel without identifier."""
        apid = self.first_apid + APIDS[channel]
        count = self._counts.get(channel, 0)
        self._counts[channel] = (count + 1) % _COUNT_MODULUS
        return _HEADER.pack(apid, _STANDALONE << 14 | count, len(message) - 1) + message
