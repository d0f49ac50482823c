"""Made by ground/message_stubs.py from fsw/msg; do not edit. Every LCM channel: name, type
of its messages, sender, receivers, rate, what it carries."""

from __future__ import annotations

from typing import NamedTuple


class Channel(NamedTuple):
    """One LCM channel: message type of fsw/msg, who sends, who receives, how often, what for."""

    name: str
    type: str
    sender: str
    receivers: str
    rate: str
    purpose: str


# fmt: off
CHANNELS = (
    Channel("KC_ACK", "ack_t", "flight", "executive, ground", "one per command", "accepted or refused, and why"),  # noqa: E501
    Channel("KC_ARM_CMD", "arm_cmd_t", "flight", "arm controller", "on a move", "joint-space move or hold"),  # noqa: E501
    Channel("KC_ARM_STATE", "arm_state_t", "arm controller", "flight", "10 Hz", "encoders, motion, loads"),  # noqa: E501
    Channel("KC_CMD", "cmd_t", "executive, ground", "flight", "on demand", "commands, see opcodes"),  # noqa: E501
    Channel("KC_DETECTION", "detection_t", "tag detector", "flight", "one per image, also without tags", "tool pose in the camera frame with covariance"),  # noqa: E501
    Channel("KC_EVENT", "event_t", "flight", "all", "as they happen", "events, dictionary in EVENTS.md"),  # noqa: E501
    Channel("KC_FRAME_REQUEST", "frame_request_t", "flight", "camera", "per frame", "take one frame now"),  # noqa: E501
    Channel("KC_HK", "hk_t", "flight", "all", "1 Hz", "housekeeping and heartbeat"),  # noqa: E501
    Channel("KC_IMAGE", "image_t", "camera", "tag detector", "per frame request", "grey JPEG"),  # noqa: E501
    Channel("KC_MEAS", "meas_t", "flight", "ground", "one per accepted measurement", "everything about a pose"),  # noqa: E501
    Channel("KC_PANTILT_CMD", "pantilt_cmd_t", "flight", "pan-tilt unit", "on a move", "turn the pan-tilt unit"),  # noqa: E501
    Channel("KC_PANTILT_STATE", "pantilt_state_t", "pan-tilt unit", "flight", "10 Hz", "pan-tilt encoders"),  # noqa: E501
    Channel("KC_PROGRESS", "progress_t", "flight", "executive, ground", "one per pose", "estimate after each pose"),  # noqa: E501
    Channel("KC_PROPOSAL", "proposal_t", "flight", "executive, ground", "one per calibration", "proposed correction, or nothing to change"),  # noqa: E501
    Channel("KC_SIM_TRUTH", "sim_truth_t", "simulator", "log only", "with each frame", "truth for tests and pictures"),  # noqa: E501
    Channel("KC_TABLE_DOWN", "table_chunk_t", "flight", "ground", "one chunk a tick while dumping", "table dump, not signed"),  # noqa: E501
    Channel("KC_TABLE_UP", "table_chunk_t", "ground", "flight", "on demand", "table image in chunks, staged; signed"),  # noqa: E501
    Channel("KC_TICK_DONE", "tick_done_t", "flight, detector, executive", "simulator", "once a tick, lockstep only", "this participant has published everything of the tick"),  # noqa: E501
    Channel("KC_TIME", "time_t", "simulator", "flight, detector, executive", "10 Hz mission time, lockstep only", "starts tick `tick`; mission time of the tick"),  # noqa: E501
)
# fmt: on
BY_NAME = {channel.name: channel for channel in CHANNELS}
