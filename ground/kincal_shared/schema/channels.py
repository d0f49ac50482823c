"""Every LCM channel. The list is channels.csv, made from fsw/msg by `make stubs`."""

from __future__ import annotations

import csv
from importlib import resources
from typing import NamedTuple


class Channel(NamedTuple):
    """One LCM channel: message type of fsw/msg, who sends, who receives, how often, what for."""

    name: str
    type: str
    sender: str
    receivers: str
    rate: str
    purpose: str


def _read() -> tuple[Channel, ...]:
    text = resources.files(__package__).joinpath("channels.csv").read_text(encoding="utf-8")
    return tuple(Channel(**row) for row in csv.DictReader(text.splitlines()))


CHANNELS = _read()
BY_NAME = {channel.name: channel for channel in CHANNELS}
