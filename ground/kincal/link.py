"""A live connection to the flight process over LCM."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import lcm

from kincal import channels, core, tables
from kincal.errors import KincalError, KincalFailed

SRC_GROUND = 2
CHUNK_BYTES = 1024
DEFAULT_URL = "udpm://239.255.76.67:7667?ttl=0"


@dataclass(frozen=True)
class Heard:
    channel: str
    message: Any


class Link:
    """Listens in a thread; everything heard goes to one queue, in order of arrival. Use as a context."""

    def __init__(
        self,
        url: str,
        listen: tuple[str, ...] = (
            "KC_ACK",
            "KC_HK",
            "KC_EVENT",
            "KC_PROPOSAL",
            "KC_PROGRESS",
            "KC_TABLE_DOWN",
        ),
        first_seq: int | None = None,
    ) -> None:
        try:
            self._lcm = lcm.LCM(url)
        except (RuntimeError, OSError) as error:
            raise KincalError(
                f"cannot open LCM: {error}",
                url,
                "check the URL; multicast needs a route, e.g. `ip route add 224.0.0.0/4 dev lo`",
            ) from None
        self.url = url
        self.heard: queue.Queue[Heard] = queue.Queue()
        self.bad_messages = 0
        self.last_t_us = 0  # mission time last heard from flight
        self.last_hk: Any = None
        # Sequence numbers must grow from call to call, so a fresh link starts at the clock.
        self._seq = first_seq if first_seq is not None else int((time.time() - 1.7e9) * 4.0)
        self._stop = threading.Event()
        for name in listen:
            self._lcm.subscribe(name, self._on_message).set_queue_capacity(0)
        self._thread = threading.Thread(target=self._loop, daemon=True)
        self._thread.start()

    def __enter__(self) -> Link:
        return self

    def __exit__(self, *_exc: object) -> None:
        self.close()

    def close(self) -> None:
        self._stop.set()
        self._thread.join(timeout=2.0)

    def _loop(self) -> None:
        while not self._stop.is_set():
            self._lcm.handle_timeout(100)

    def _on_message(self, channel: str, data: bytes) -> None:
        try:
            message = channels.decode(channel, data)
        except Exception:  # noqa: BLE001 a damaged packet must not end the thread; generated code raises anything
            self.bad_messages += 1
            return
        if channel == "KC_HK":
            self.last_hk = message
        if hasattr(message, "t_us"):
            self.last_t_us = max(self.last_t_us, message.t_us)
        self.heard.put(Heard(channel, message))

    def next(self, timeout_s: float) -> Heard | None:
        """Next message, or None when nothing came in time."""
        try:
            return self.heard.get(timeout=timeout_s)
        except queue.Empty:
            return None

    def wait_for(self, what: Callable[[Heard], bool], timeout_s: float, name: str) -> Any:
        """The first message that fits; others are let go."""
        deadline = time.monotonic() + timeout_s
        while (left := deadline - time.monotonic()) > 0.0:
            heard = self.next(left)
            if heard is not None and what(heard):
                return heard.message
        raise KincalFailed(
            f"{name} did not come within {timeout_s:g} s",
            self.url,
            "is the flight process running on this URL?",
        )

    def wait_hk(self, what: Callable[[Any], bool], timeout_s: float, name: str) -> Any:
        return self.wait_for(lambda h: h.channel == "KC_HK" and what(h.message), timeout_s, name)

    def send(
        self, opcode: str, arg_i: tuple[int, ...] = (), arg_u64: int = 0, t_us: int | None = None
    ) -> int:
        """Publish a command, return its sequence number."""
        self._seq += 1
        command = channels.message_type("cmd_t")()
        command.t_us = self.last_t_us if t_us is None else t_us
        command.seq = self._seq
        command.source = SRC_GROUND
        command.opcode = channels.OPCODES.index(opcode)
        command.arg_i = [as_int32(a) for a in arg_i] + [0] * (4 - len(arg_i))
        command.arg_u64 = arg_u64
        command.arg_d = [0.0] * 4
        self._lcm.publish("KC_CMD", command.encode())
        return self._seq

    def command(
        self, opcode: str, arg_i: tuple[int, ...] = (), timeout_s: float = 10.0, t_us: int | None = None
    ) -> Any:
        """Send a command and wait for its answer. A refusal is an error with the reason."""
        seq = self.send(opcode, arg_i, t_us=t_us)
        return check_ack(
            self.wait_for(lambda h: is_ack(h, seq), timeout_s, f"answer to {opcode}"), opcode, self.url
        )

    def upload(self, image: tables.Image, timeout_s: float = 30.0) -> None:
        """Stage, validate, activate, and see the new CRC in housekeeping."""
        kind = tables.KINDS[image.kind]
        self.wait_hk(lambda _hk: True, timeout_s, "housekeeping")
        for offset in range(0, len(image.data), CHUNK_BYTES):
            part = image.data[offset : offset + CHUNK_BYTES]
            chunk = channels.message_type("table_chunk_t")()
            chunk.t_us = self.last_t_us
            chunk.kind, chunk.total_bytes, chunk.offset, chunk.n = kind, len(image.data), offset, len(part)
            chunk.data = part.ljust(CHUNK_BYTES, b"\0")
            self._lcm.publish("KC_TABLE_UP", chunk.encode())
            end = offset + len(part)
            if end == len(image.data) or (offset // CHUNK_BYTES) % 4 == 3:
                self._wait_staged(kind, end, len(image.data), timeout_s)
        self.command("TABLE_VALIDATE", (kind, image.crc), timeout_s)
        self.command("TABLE_ACTIVATE", (kind, image.crc), timeout_s)
        self.wait_hk(
            lambda hk: hk.table_crc[kind] & 0xFFFFFFFF == image.crc, timeout_s, "the new CRC in housekeeping"
        )

    def _wait_staged(self, kind: int, end: int, total: int, timeout_s: float) -> None:
        """Chunks have no answer of their own: housekeeping says how far staging has come."""
        try:
            self.wait_hk(
                lambda hk: hk.staged_kind == kind and hk.staged_bytes >= end,
                timeout_s,
                f"staging of byte {end} of {total}",
            )
        except KincalFailed:
            hk = self.last_hk
            said = "" if hk is None else f"staged {hk.staged_bytes} bytes of kind {hk.staged_kind}"
            raise KincalFailed(
                "flight did not take the table",
                said or self.url,
                "look at the events with `kincal log`; tables only change in IDLE",
            ) from None

    def dump(self, kind: str, timeout_s: float = 60.0) -> tables.Image:
        """Bring down the active table of a kind, checked against its CRC."""
        number = tables.kind_number(kind)
        self.wait_hk(lambda _hk: True, timeout_s, "housekeeping")
        seq = self.send("TABLE_DUMP", (number,))
        data, total, deadline = bytearray(), None, time.monotonic() + timeout_s
        while total is None or len(data) < total:
            heard = self.next(max(deadline - time.monotonic(), 0.0))
            if heard is None:
                raise KincalFailed(f"dump stopped after {len(data)} bytes", self.url, "try again")
            if is_ack(heard, seq):
                check_ack(heard.message, "TABLE_DUMP", self.url)
            elif heard.channel == "KC_TABLE_DOWN" and heard.message.kind == number:
                chunk = heard.message
                if chunk.offset != len(data):
                    raise KincalFailed(f"dump lost a chunk at byte {len(data)}", self.url, "try again")
                total = chunk.total_bytes
                data += bytes(chunk.data[: chunk.n])
        return tables.decode(bytes(data), self.url)[0]


def as_int32(value: int) -> int:
    """CRCs are unsigned, LCM has no unsigned type."""
    value &= 0xFFFFFFFF
    return value - (1 << 32) if value >= 1 << 31 else value


def is_ack(heard: Heard, seq: int) -> bool:
    return heard.channel == "KC_ACK" and heard.message.source == SRC_GROUND and heard.message.seq == seq


def check_ack(ack: Any, opcode: str, where: str) -> Any:
    if ack.status != 0:
        name = core.ffi.string(core.lib.kc_event_name(ack.event_id)).decode() if ack.event_id else ""
        raise KincalFailed(
            f"{opcode} refused: {core.status_name(ack.status)}" + (f" ({name})" if name else ""),
            where,
            "nothing was changed on board; `kincal review show` tells what waits there",
        )
    return ack


def write_image(image: tables.Image, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(image.data)
