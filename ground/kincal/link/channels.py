"""Every LCM channel in one list: the log reader, the live link and docs/INTERFACES.md use it."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from kincal.errors import CommandFailed

if TYPE_CHECKING:
    from .messages import LcmMessage


@dataclass(frozen=True)
class Channel:
    """One LCM channel: message type of fsw/msg, who sends, who receives, how often, what for."""

    name: str
    type: str
    sender: str
    receivers: str
    rate: str
    purpose: str


CHANNELS = (
    Channel(
        "KC_TIME",
        "time_t",
        "simulator",
        "flight, detector, executive",
        "10 Hz mission time, lockstep only",
        "starts tick `tick`; mission time of the tick",
    ),
    Channel(
        "KC_TICK_DONE",
        "tick_done_t",
        "flight, detector, executive",
        "simulator",
        "once a tick, lockstep only",
        "this participant has published everything of the tick",
    ),
    Channel("KC_ARM_STATE", "arm_state_t", "arm controller", "flight", "10 Hz", "encoders, motion, loads"),
    Channel("KC_ARM_CMD", "arm_cmd_t", "flight", "arm controller", "on a move", "joint-space move or hold"),
    Channel("KC_PANTILT_STATE", "pantilt_state_t", "pan-tilt unit", "flight", "10 Hz", "pan-tilt encoders"),
    Channel(
        "KC_PANTILT_CMD", "pantilt_cmd_t", "flight", "pan-tilt unit", "on a move", "turn the pan-tilt unit"
    ),
    Channel("KC_FRAME_REQUEST", "frame_request_t", "flight", "camera", "per frame", "take one frame now"),
    Channel("KC_IMAGE", "image_t", "camera", "tag detector", "per frame request", "grey JPEG"),
    Channel(
        "KC_DETECTION",
        "detection_t",
        "tag detector",
        "flight",
        "one per image, also without tags",
        "tool pose in the camera frame with covariance",
    ),
    Channel("KC_CMD", "cmd_t", "executive, ground", "flight", "on demand", "commands, see opcodes"),
    Channel(
        "KC_ACK", "ack_t", "flight", "executive, ground", "one per command", "accepted or refused, and why"
    ),
    Channel("KC_TABLE_UP", "table_chunk_t", "ground", "flight", "on demand", "table image in chunks, staged"),
    Channel(
        "KC_TABLE_DOWN", "table_chunk_t", "flight", "ground", "one chunk a tick while dumping", "table dump"
    ),
    Channel("KC_EVENT", "event_t", "flight", "all", "as they happen", "events, dictionary in EVENTS.md"),
    Channel("KC_HK", "hk_t", "flight", "all", "1 Hz", "housekeeping and heartbeat"),
    Channel(
        "KC_MEAS", "meas_t", "flight", "ground", "one per accepted measurement", "everything about a pose"
    ),
    Channel(
        "KC_PROGRESS", "progress_t", "flight", "executive, ground", "one per pose", "estimate after each pose"
    ),
    Channel(
        "KC_PROPOSAL",
        "proposal_t",
        "flight",
        "executive, ground",
        "one per calibration",
        "proposed correction, or nothing to change",
    ),
    Channel(
        "KC_SIM_TRUTH",
        "sim_truth_t",
        "simulator",
        "log only",
        "with each frame",
        "truth for tests and pictures",
    ),
)
BY_NAME = {channel.name: channel for channel in CHANNELS}


def message_type(type_name: str) -> Any:
    """Generated LCM class of a message type, e.g. "cmd_t". CommandFailed if the types are not built."""
    try:
        return getattr(importlib.import_module(f"kcm.{type_name}"), type_name)
    except ImportError as error:
        raise CommandFailed(f"message types are not built: {error}", todo="run `make` once") from None


def decode(channel: str, data: bytes) -> LcmMessage:
    """Message of a channel. ValueError if the bytes are not that message."""
    message: LcmMessage = message_type(BY_NAME[channel].type).decode(data)
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
