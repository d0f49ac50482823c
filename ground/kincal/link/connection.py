"""A live connection to the flight process over LCM."""

from __future__ import annotations

import queue
import secrets
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import lcm

from kincal.flight import event_action, event_name, library, status_name
from kincal_shared.errors import BadInput, CommandFailed, NoAnswer
from kincal_shared.keys import Signer

from . import channels, names

if TYPE_CHECKING:
    from .messages import Ack, Cmd, Hk, LcmMessage, TableChunk

DEFAULT_URL = "udpm://239.255.76.67:7667?ttl=0"
LISTEN = ("KC_ACK", "KC_HK", "KC_EVENT", "KC_PROPOSAL", "KC_PROGRESS", "KC_TABLE_DOWN")
_POLL_MS = 100
_JOIN_S = 2.0
_EPOCH_S, _SEQ_PER_S = 1.7e9, 4.0  # sequence numbers of a fresh link without a key
_SEQ_MOST = 2**30  # first number of one with a key


@dataclass(frozen=True)
class Received:
    """A message and the channel that it came on."""

    channel: str
    message: Any  # one of messages.pyi, by the channel


class CommandLink(ABC):
    """The ground's side of flight: commands out, answers in. A subclass brings the messages.

    url: of the network, for people; first_seq: sequence number before the first command. Those of commands
    without a signature must grow from call to call, so a link without a signer starts at the clock unless
    this is given. signer: signs what is sent; without it flight takes NOOP and ABORT only."""

    def __init__(self, url: str, first_seq: int | None = None, signer: Signer | None = None) -> None:
        self.url, self.signer = url, signer
        self.last_t_us = 0  # mission time of the newest message: commands are stamped with it
        self.last_hk: Hk | None = None
        self._seq = _first_seq(signer) if first_seq is None else first_seq

    @abstractmethod
    def next(self, timeout_s: float) -> Received | None:
        """Next message, or None when nothing came in time."""

    @abstractmethod
    def publish(self, channel: str, message: LcmMessage) -> None:
        """Send a message."""

    def clock_s(self) -> float:
        """The clock of time-outs [s]."""
        return time.monotonic()

    def note(self, channel: str, message: LcmMessage) -> Received:
        """A message that was received, after what the link has to know of it."""
        if channel == "KC_HK":
            self.last_hk = cast("Hk", message)
        self.last_t_us = getattr(message, "t_us", self.last_t_us)  # also if flight's clock was set back
        return Received(channel, message)

    # ---- waiting

    def wait_for(self, what: Callable[[Received], bool], timeout_s: float, name: str) -> Any:
        """The first message that fits; others are let go. NoAnswer, with the name, if none comes."""
        deadline = self.clock_s() + timeout_s
        while (left := deadline - self.clock_s()) > 0.0:
            received = self.next(left)
            if received is not None and what(received):
                return received.message
        raise NoAnswer(
            f"{name} did not come within {timeout_s:g} s",
            self.url,
            "is the flight process running on this URL?",
        )

    def wait_hk(self, what: Callable[[Hk], bool], timeout_s: float, name: str) -> Hk:
        """The first housekeeping message that fits. NoAnswer, with the name, if none comes."""
        found = self.wait_for(lambda r: r.channel == "KC_HK" and what(r.message), timeout_s, name)
        return cast("Hk", found)

    # ---- sending

    def send(
        self, opcode: str, arg_i: tuple[int, ...] = (), arg_u64: int = 0, t_us: int | None = None
    ) -> int:
        """Publish a command, e.g. "TABLE_DUMP"; returns its sequence number."""
        if bad := [a for a in arg_i if not -(1 << 31) <= a < 1 << 32]:
            raise BadInput(f"{opcode} does not carry {bad[0]}", todo="its arguments have 32 bits")
        self._seq += 1
        command: Cmd = channels.message_type("cmd_t")()
        command.t_us = self.last_t_us if t_us is None else t_us
        command.seq = self._seq
        command.source = library("flight").lib.KC_SRC_GROUND
        command.opcode = names.opcode(opcode)
        command.arg_i = [channels.signed32(a) for a in arg_i] + [0] * (4 - len(arg_i))
        command.arg_u64 = arg_u64
        command.arg_d = [0.0] * 4
        self.publish("KC_CMD", self._signed(command, opcode))
        return self._seq

    def _signed(self, command: Cmd, opcode: str) -> Cmd:
        """The same, signed. An ABORT that cannot be signed, because the counter cannot be kept, goes out all
        the same: flight takes it from everybody."""
        if self.signer is None:
            return command
        try:
            return self.signer.command(command)
        except BadInput:
            if opcode != "ABORT":
                raise
            command.key_id = command.counter = 0
            return command

    def send_chunk(self, chunk: TableChunk) -> None:
        """Publish a chunk of a table."""
        chunk.t_us = self.last_t_us
        chunk.source = library("flight").lib.KC_SRC_GROUND
        self.publish("KC_TABLE_UP", self.signer.chunk(chunk) if self.signer else chunk)

    def command(
        self, opcode: str, arg_i: tuple[int, ...] = (), timeout_s: float = 10.0, t_us: int | None = None
    ) -> Ack:
        """Send a command and wait for its answer. CommandFailed with flight's reason if it refuses."""
        seq = self.send(opcode, arg_i, t_us=t_us)
        ack = self.wait_for(lambda r: is_ack(r, seq), timeout_s, f"answer to {opcode}")
        return check_ack(ack, opcode, self.url)


def _first_seq(signer: Signer | None) -> int:
    """Answers name a command by this number. Signed commands are told apart by their counters, so theirs may
    begin anywhere: two programs that begin at the same moment must not take each other's answers for their
    own."""
    if signer is not None:
        return secrets.randbelow(_SEQ_MOST)
    return int((time.time() - _EPOCH_S) * _SEQ_PER_S)


class Link(CommandLink):
    """Over LCM. Listens in a thread; everything received goes to one queue, in order of arrival. Use as a
    context.

    url: LCM network; listen: channels; first_seq, signer: see CommandLink. BadInput if LCM cannot be
    opened."""

    def __init__(
        self,
        url: str,
        listen: tuple[str, ...] = LISTEN,
        first_seq: int | None = None,
        signer: Signer | None = None,
    ) -> None:
        super().__init__(url, first_seq, signer)
        self._lcm = open_lcm(url)
        self.received: queue.Queue[Received] = queue.Queue()
        self.bad_messages = 0
        self._stop = threading.Event()
        self._subscriptions = [self._lcm.subscribe(name, self._on_message) for name in listen]
        for subscription in self._subscriptions:
            subscription.set_queue_capacity(0)
        self._thread = threading.Thread(target=self._loop, daemon=True)
        self._thread.start()

    def __enter__(self) -> Link:
        return self

    def __exit__(self, *_exc: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop listening."""
        self._stop.set()
        self._thread.join(timeout=_JOIN_S)
        if not self._thread.is_alive():  # LCM holds what it calls, and is not freed as long as it does
            while self._subscriptions:
                self._lcm.unsubscribe(self._subscriptions.pop())

    def _loop(self) -> None:
        while not self._stop.is_set():
            self._lcm.handle_timeout(_POLL_MS)

    def _on_message(self, channel: str, data: bytes) -> None:
        try:
            message = channels.decode(channel, data)
        except Exception:  # noqa: BLE001 a damaged packet must not end the thread; generated code raises anything
            self.bad_messages += 1
            return
        self.received.put(self.note(channel, message))

    def next(self, timeout_s: float) -> Received | None:
        """See CommandLink."""
        try:
            return self.received.get(timeout=timeout_s)
        except queue.Empty:
            return None

    def publish(self, channel: str, message: LcmMessage) -> None:
        """See CommandLink."""
        self._lcm.publish(channel, message.encode())


def open_lcm(url: str) -> lcm.LCM:
    """An LCM network. BadInput if it cannot be opened."""
    if url and "://" not in url:  # LCM would print where in its source that is wrong
        raise BadInput("this is no LCM URL", url, "give one such as udpm://239.255.76.67:7667?ttl=0")
    try:
        return lcm.LCM(url)
    except (RuntimeError, OSError) as error:
        raise BadInput(
            f"cannot open LCM: {error}",
            url,
            "check the URL; multicast needs a route, e.g. `ip route add 224.0.0.0/4 dev lo`",
        ) from None


def is_ack(received: Received, seq: int) -> bool:
    """Whether this answers the ground's command with that sequence number."""
    if received.channel != "KC_ACK":
        return False
    ack: Ack = received.message
    return ack.source == library("flight").lib.KC_SRC_GROUND and ack.seq == seq


def _advice(event_id: int) -> str:
    """What to do after a refusal: flight's own advice for its reason."""
    return event_action(event_id) or "`kincal review list --live` tells what waits there"


def check_ack(ack: Ack, opcode: str, where: str) -> Ack:
    """The same answer; CommandFailed if it refuses."""
    if ack.status != 0:
        reason = f" ({event_name(ack.event_id)})" if ack.event_id else ""
        raise CommandFailed(
            f"{opcode} refused: {status_name(ack.status)}{reason}",
            where,
            f"nothing was changed on board. {_advice(ack.event_id)}",
        )
    return ack
