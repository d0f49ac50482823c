"""Table images to and from flight, in chunks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from kincal.flight import library, tables
from kincal_shared.errors import CommandFailed, NoAnswer
from kincal_shared.writing import write_file

from . import channels
from .connection import CommandLink, check_ack, is_ack

if TYPE_CHECKING:
    from .messages import TableChunk

_CHUNKS_AHEAD = 4  # sent before housekeeping has to say that they have arrived


def _nothing() -> None:
    """Does nothing."""


def upload(
    link: CommandLink,
    image: tables.Image,
    timeout_s: float = 30.0,
    accepted: Callable[[], None] = _nothing,
) -> None:
    """Stage, validate, activate a table, and see its CRC in housekeeping. accepted: called as soon as flight
    has taken the last command, also if the CRC is not seen. CommandFailed if flight refuses, NoAnswer if it
    does not answer in time."""
    kind = tables.kind_number(image.kind)
    link.wait_hk(lambda _hk: True, timeout_s, "housekeeping")
    for number, chunk in enumerate(_chunks(image, kind), 1):
        link.send_chunk(chunk)
        end = chunk.offset + chunk.n
        if end == chunk.total_bytes or number % _CHUNKS_AHEAD == 0:
            _wait_staged(link, kind, end, chunk.total_bytes, timeout_s)
    link.command("TABLE_VALIDATE", (kind, image.crc), timeout_s)
    link.command("TABLE_ACTIVATE", (kind, image.crc), timeout_s)
    accepted()
    active = lambda hk: channels.unsigned32(hk.table_crc[kind]) == image.crc  # noqa: E731
    link.wait_hk(active, timeout_s, "the new CRC in housekeeping")


def _chunks(image: tables.Image, kind: int) -> Iterator[TableChunk]:
    room = library("flight").lib.KC_CHUNK_BYTES
    for offset in range(0, len(image.data), room):
        part = image.data[offset : offset + room]
        chunk: TableChunk = channels.message_type("table_chunk_t")()
        chunk.kind, chunk.total_bytes, chunk.offset, chunk.n = kind, len(image.data), offset, len(part)
        chunk.data = part.ljust(room, b"\0")
        yield chunk


def _wait_staged(link: CommandLink, kind: int, end: int, total: int, timeout_s: float) -> None:
    """Chunks have no answer of their own: housekeeping says how far staging has come."""
    try:
        staged = lambda hk: hk.staged_kind == kind and hk.staged_bytes >= end  # noqa: E731
        link.wait_hk(staged, timeout_s, f"staging of byte {end} of {total}")
    except CommandFailed:
        hk = link.last_hk
        where = link.url if hk is None else f"staged {hk.staged_bytes} bytes of kind {hk.staged_kind}"
        raise CommandFailed(
            "flight did not take the table",
            where,
            "look at the events with `kincal log`; tables only change in IDLE",
        ) from None


def dump(link: CommandLink, kind: str, timeout_s: float = 60.0) -> tables.Image:
    """Bring down the active table of a kind, checked against its CRC; kind "proposal": the KIN table that
    waits for review. CommandFailed if flight refuses, NoAnswer if a chunk is lost or it takes too long."""
    flight = library("flight")
    number = int(flight.constant("KC_STORE_PROPOSAL")) if kind == "proposal" else tables.kind_number(kind)
    link.wait_hk(lambda _hk: True, timeout_s, "housekeeping")
    seq = link.send("TABLE_DUMP", (number,))
    data = bytearray()
    for chunk in _received_chunks(link, seq, number, link.clock_s() + timeout_s):
        if chunk.offset != len(data):
            raise NoAnswer(f"dump lost a chunk at byte {len(data)}", link.url, "try again")
        data += bytes(chunk.data[: chunk.n])
        if len(data) >= chunk.total_bytes:
            return tables.decode(bytes(data), link.url)[0]
    raise NoAnswer(f"dump stopped after {len(data)} bytes", link.url, "try again")


def _received_chunks(link: CommandLink, seq: int, kind: int, deadline_s: float) -> Iterator[TableChunk]:
    """Chunks of a kind until none comes in time."""
    while (left_s := deadline_s - link.clock_s()) > 0.0:
        if (received := link.next(left_s)) is None:
            return
        if is_ack(received, seq):
            check_ack(received.message, "TABLE_DUMP", link.url)
        elif received.channel == "KC_TABLE_DOWN" and received.message.kind == kind:
            yield received.message


def write_image(image: tables.Image, path: Path) -> None:
    """Write a table image to a file; its folder is made."""
    write_file(path, image.data)
