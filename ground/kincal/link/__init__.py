"""Flight over LCM: channels, live link, table transfer, logs.

channels: every channel and its message type. names: numbers in messages as words. connection: the live link.
transfer: tables up and down. log: recorded messages. Types of the messages are in messages.pyi."""

from .channels import CHANNELS, crc_text, unsigned32
from .connection import DEFAULT_URL, CommandLink, Link, Received
from .log import LogEvent, LogSummary, Session, estimated_sigma, read_log, unpack_covariance
from .transfer import dump, upload, write_image

__all__ = [
    "CHANNELS",
    "DEFAULT_URL",
    "CommandLink",
    "Link",
    "LogEvent",
    "LogSummary",
    "Received",
    "Session",
    "crc_text",
    "dump",
    "estimated_sigma",
    "read_log",
    "unpack_covariance",
    "unsigned32",
    "upload",
    "write_image",
]
