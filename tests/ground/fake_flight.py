"""A flight process of a few lines, in a thread: staged tables, dumps, two-step approval, housekeeping."""

import threading
import time

import lcm
from samples import signed

import kcm
from kincal_sim.ports import private_port, private_url


class FakeFlight:
    """`refuse`: opcodes answered with KC_ERR_STATE. `dead`: approval is answered, nothing becomes active.
    `verdict`: of the proposal; 0: not known. Anything but CHANGE is armed by an override only."""

    def __init__(
        self,
        proposal_crc: int = 0,
        refuse: tuple[int, ...] = (),
        dead: bool = False,
        verdict: int = kcm.proposal_t.CHANGE,
    ) -> None:
        port, self._port_lock = private_port()
        self.url = private_url(port)
        self.proposal_crc, self.refuse, self.dead, self.verdict = proposal_crc, refuse, dead, verdict
        self.overrides: list[int] = []  # of APPROVE_ARM
        self.boot_count = 0
        self.kin_crc, self.armed, self.images, self.staged = 1, 0, {}, (0, b"")
        self.checked = 0  # hk_t.staged_state
        self.commands: list[tuple[int, int]] = []
        self.masks: list[int] = []  # of START: coefficients
        self.unsigned: list[int] = []  # opcodes without a signature
        self._bus = lcm.LCM(self.url)
        self._bus.subscribe("KC_CMD", self._on_cmd)
        self._bus.subscribe("KC_TABLE_UP", self._on_chunk).set_queue_capacity(0)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join()
        del self._bus  # it holds its handlers, and they this: nothing else would free its sockets
        self._port_lock.close()

    def _run(self) -> None:
        due = 0.0
        while not self._stop.is_set():
            if time.monotonic() >= due:
                due = time.monotonic() + 0.05
                self._hk()
            self._bus.handle_timeout(10)

    def _hk(self) -> None:
        m = kcm.hk_t()
        m.boot_count = self.boot_count
        m.t_us, m.proposal_crc = time.time_ns() // 1000, signed(self.proposal_crc)
        m.state, m.proposal_verdict = (10 if self.armed else 9 if self.proposal_crc else 0), self.verdict
        m.approval_left_us = 599_000_000 if self.armed else 0
        m.staged_kind, m.staged_bytes, m.staged_state = self.staged[0], len(self.staged[1]), self.checked
        m.table_crc[4], m.kin_prev_crc = signed(self.kin_crc), 7
        for kind, image in self.images.items():
            m.table_crc[kind] = signed(int.from_bytes(image[12:16], "little"))
        self._bus.publish("KC_HK", m.encode())

    def _on_chunk(self, _, data: bytes) -> None:
        m = kcm.table_chunk_t.decode(data)
        have = b"" if m.offset == 0 else self.staged[1]
        self.checked = 0
        if m.offset == len(have):
            self.staged = (m.kind, have + bytes(m.data[: m.n]))

    def _on_cmd(self, _, data: bytes) -> None:
        c = kcm.cmd_t.decode(data)
        crc = c.arg_i[0] & 0xFFFFFFFF
        self.commands.append((c.opcode, crc))
        if c.opcode == c.START:
            self.masks.append(c.arg_u64)
        if not c.key_id:
            self.unsigned.append(c.opcode)
        status, event = 0, 13
        if c.opcode in self.refuse:
            status = -8
        elif c.opcode == c.APPROVE_ARM:
            self.overrides.append(c.arg_i[1])
            status = 0 if crc == self.proposal_crc else -5
            if self.verdict != kcm.proposal_t.CHANGE and not c.arg_i[1]:
                status, event = -1, 100
            if not status:
                self.armed = crc
        elif c.opcode == c.APPROVE_GO:
            status = 0 if crc == self.armed else -5
            if not status and not self.dead:
                self.kin_crc, self.proposal_crc, self.armed = crc, 0, 0
        elif c.opcode == c.REJECT:
            self.proposal_crc = self.armed = 0
        elif c.opcode == c.TABLE_VALIDATE:
            self.checked = 3
        elif c.opcode == c.TABLE_ACTIVATE:
            self.images[c.arg_i[0]] = self.staged[1]
        a = kcm.ack_t()
        a.t_us, a.source, a.seq, a.opcode, a.status, a.event_id = (
            c.t_us, c.source, c.seq, c.opcode, status, event if status else 0,
        )  # fmt: skip
        self._bus.publish("KC_ACK", a.encode())
        if c.opcode == c.TABLE_DUMP and not status:
            self._dump(c.arg_i[0])

    def _dump(self, kind: int) -> None:
        image = self.images[kind]
        for offset in range(0, len(image), 1024):
            part = image[offset : offset + 1024]
            m = kcm.table_chunk_t()
            m.kind, m.total_bytes, m.offset, m.n, m.data = (
                kind, len(image), offset, len(part), part.ljust(1024, b"\0"),
            )  # fmt: skip
            self._bus.publish("KC_TABLE_DOWN", m.encode())
