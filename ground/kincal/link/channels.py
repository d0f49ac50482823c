"""Every LCM channel and its message type, for the log reader, the live link and docs/INTERFACES.md."""

from __future__ import annotations

import importlib
import struct
from functools import cache
from typing import TYPE_CHECKING, Any

from kincal_shared.errors import CommandFailed
from kincal_shared.schema.channels import BY_NAME, CHANNELS, Channel

from . import former

if TYPE_CHECKING:
    from .messages import LcmMessage

__all__ = ["BY_NAME", "CHANNELS", "Channel", "crc_text", "decode", "message_type", "signed32", "unsigned32"]


# Fields of a message that count entries of its arrays, by type. What reads them need not ask.
_COUNTS = {
    "arm_cmd_t": {"n_joints": "q_rad"},
    "arm_state_t": {"n_joints": "q_rad"},
    "detection_t": {"n_tags": "tag_id"},
    "meas_t": {"n_joints": "q_rad", "n_tags": "tag_id"},
    "proposal_t": {"n_coef": "value"},
    "sim_truth_t": {"n_joints": "q_true_rad"},
    "table_chunk_t": {"n": "data"},
}

IMAGE_HEAD = struct.Struct(">28xi")
"""Of an image, before the JPEG: fingerprint, time, number, width and height; then the bytes of the JPEG."""


@cache
def message_type(type_name: str) -> Any:
    """Generated LCM class of a message type, e.g. "cmd_t". CommandFailed if the types are not built."""
    try:
        return getattr(importlib.import_module(f"kcm.{type_name}"), type_name)
    except ImportError as error:
        raise CommandFailed(f"message types are not built: {error}", todo="run `make` once") from None


def check_image(head: bytes, n_bytes: int) -> None:
    """ValueError if a message of `n_bytes` bytes that begins with `head` is no image: LCM's decoder takes the
    bytes that are there for the JPEG, whatever number stands before them."""
    if len(head) < IMAGE_HEAD.size or not head.startswith(message_type("image_t")._get_packed_fingerprint()):
        raise ValueError("no image")
    (counted,), there = IMAGE_HEAD.unpack_from(head), n_bytes - IMAGE_HEAD.size
    if not 0 <= counted <= there:
        raise ValueError(f"n_bytes is {counted}, {there} bytes follow")


def decode(channel: str, data: bytes) -> LcmMessage:
    """Message of a channel, also of a former type of it. ValueError if the bytes are not that message, or it
    counts more than its arrays hold."""
    if BY_NAME[channel].type == "image_t":
        check_image(data[: IMAGE_HEAD.size], len(data))
    message = former.decode(message_type(BY_NAME[channel].type), data)
    for count, array in _COUNTS.get(BY_NAME[channel].type, {}).items():
        number, room = getattr(message, count), len(getattr(message, array))
        if not 0 <= number <= room:
            raise ValueError(f"{channel}: {count} is {number}, {array} has room for {room}")
    return message


def unsigned32(value: int) -> int:
    """CRCs travel as int32; everywhere else they are unsigned."""
    return value & 0xFFFFFFFF


def signed32(value: int) -> int:
    """The opposite of `unsigned32`."""
    value = unsigned32(value)
    return value - (1 << 32) if value >= 1 << 31 else value


def crc_text(value: int) -> str:
    """A CRC field as people read it: eight hex digits."""
    return f"{unsigned32(value):08x}"
