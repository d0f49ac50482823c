"""A link whose other end is a few lines in the same thread: decisions and uplinks in milliseconds."""

from collections import deque

from samples import CRC, event, signed

import kcm
from kincal.api import operate
from kincal.flight import library
from kincal.link import CommandLink
from kincal.link.connection import Received
from kincal.review.decisions import Operator

STATE = library("flight").enum("kc_state_t", "KC_ST_")
EVENT = library("flight").enum("kc_event_id_t", "KC_EVT_")


class DirectFlight(CommandLink):
    """Answers each command at once, and says by housekeeping what came of it; when nothing is left to say,
    time passes. hk: the next housekeeping; refuse: opcodes that get this status and event; ignores: opcodes
    without an effect; holds: kind -> image, for a dump; commands, chunks: what came."""

    def __init__(self, signer=None, first_seq=None):
        super().__init__("direct", first_seq, signer)
        self.hk, self.now_s = kcm.hk_t(), 0.0
        self.hk.t_us = 5_000_000
        self.refuse, self.ignores, self.holds = {}, set(), {}
        self.commands, self.chunks, self.waiting = [], [], deque()

    def waits(self, crc, verdict=kcm.proposal_t.CHANGE, state=9):
        self.hk.proposal_crc, self.hk.proposal_verdict, self.hk.state = signed(crc), verdict, state
        return self

    def clock_s(self):
        return self.now_s

    def next(self, timeout_s):
        del timeout_s
        self.now_s += 0.25
        if self.waiting:
            return self.waiting.popleft()
        return self.note("KC_HK", kcm.hk_t.decode(self.hk.encode()))

    def answer(self, channel, message):
        self.waiting.append(self.note(channel, message))

    def publish(self, channel, message):
        if channel == "KC_TABLE_UP":
            self.chunks.append(message)
            self.hk.staged_kind, self.hk.staged_bytes = message.kind, message.offset + message.n
            return
        c = message
        self.commands.append(c)
        a = kcm.ack_t()
        a.t_us, a.source, a.seq, a.opcode = self.hk.t_us, c.source, c.seq, c.opcode
        a.status, a.event_id = self.refuse.get(c.opcode, (0, 0))
        if self.holds and c.opcode == c.TABLE_DUMP and c.arg_i[0] not in self.holds:
            a.status, a.event_id = -8, 13
        self.waiting.append(Received("KC_ACK", a))
        if a.status or c.opcode in self.ignores:
            return
        if c.opcode == c.APPROVE_ARM:
            self.hk.state, self.hk.approval_left_us = 10, 599_000_000
        elif c.opcode == c.APPROVE_GO:
            self.hk.table_crc[4], self.hk.state, self.hk.proposal_crc = c.arg_i[0], 0, 0
        elif c.opcode == c.REJECT:
            self.hk.state, self.hk.proposal_crc = 0, 0
        elif c.opcode == c.TABLE_DUMP and c.arg_i[0] in self.holds:
            self.dump(c.arg_i[0], self.holds[c.arg_i[0]])
        elif c.opcode == c.TABLE_ACTIVATE:
            self.hk.table_crc[c.arg_i[0]] = c.arg_i[1]

    def dump(self, kind, image):
        for offset in range(0, len(image), 1024):
            m = kcm.table_chunk_t()
            m.kind, m.total_bytes, m.offset = kind, len(image), offset
            part = image[offset : offset + 1024]
            m.n, m.data = len(part), part.ljust(1024, b"\0")
            self.answer("KC_TABLE_DOWN", m)


class Lander(DirectFlight):
    """Starts, aborts and rolls back; after a command `then` is called."""

    then = staticmethod(lambda _opcode: None)

    def __init__(self, signer=None, kin=CRC):
        super().__init__(signer)
        self.hk.boot_count, self.hk.table_crc = 3, [0, 1, 1, 1, signed(kin), 1, 1, 1]
        self.hk.kin_prev_crc = 7

    def publish(self, channel, message):
        super().publish(channel, message)
        opcode = message.opcode
        if opcode not in self.ignores and opcode not in self.refuse:
            if opcode == kcm.cmd_t.START:
                self.hk.state = STATE["MOVE"]
                self.answer("KC_EVENT", event(self.hk.t_us, 1, EVENT["CAL_START"], 1, 20.0, 4))
            elif opcode == kcm.cmd_t.ABORT:
                self.hk.state = STATE["SAFE"]
            elif opcode == kcm.cmd_t.ROLLBACK:
                self.hk.table_crc[4] = 7
        self.then(opcode)


def act(flight, request, journal, timeout_s=5.0):
    """Outcome, steps and words of a command; the snapshot has heard flight before."""
    said, steps, snapshot = [], [], operate.Snapshot()
    operate.listen(flight, snapshot, 2.0, lambda s: s.hk is not None)
    who = Operator("A. Operator", "because", journal, timeout_s, said.append)
    done = operate.act(flight, request, who, snapshot, steps.append)
    return done, [s.stage for s in steps], said
