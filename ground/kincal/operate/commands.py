"""One command to flight and what is known of it: sent, received, accepted or refused, done, and the event
that says so.

Nothing here reads a clock, a network or a file: `Tracked` takes messages and times, and never sends. A
command is sent once; when no answer comes, what is known is said, and nothing is repeated."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from kincal.flight import event_action, event_name, library, status_name, tables
from kincal.link import crc_text, names, unsigned32
from kincal.review.journal import kind_text
from kincal_shared.keys import holder

from .snapshot import FRESH, SEVERAL, EventLine, Snapshot, Waiting, calibrating, event_of, utc_text

if TYPE_CHECKING:
    from kincal.link.messages import Ack, Hk

SENT, RECEIVED, ACCEPTED, REFUSED, DONE = "sent", "received", "accepted", "refused", "done"
"""Verifiers. The outcome of a command is DONE, REFUSED, ACCEPTED (taken, but what it brings was not seen in
time) or UNCERTAIN (no answer: flight may have taken it or not)."""
UNCERTAIN = "unknown"
_KIN = "kin"
_VALID = 3  # hk_t.staged_state
_EVENT_S = 1.0  # in which the event that explains a refusal follows its answer
_FREE = ("IDLE", "SAFE")
END_OTHER = "End the other sender; then `kincal status` shows the state."
STATES: dict[str, tuple[str, ...]] = {
    "START": _FREE,
    "APPROVE_ARM": ("REVIEW",),
    "APPROVE_GO": ("ARMED",),
    "REJECT": ("REVIEW", "ARMED"),
    "ROLLBACK": _FREE,
    "TABLE_VALIDATE": _FREE,
    "TABLE_ACTIVATE": _FREE,
    "TABLE_DISCARD": _FREE,
}
"""States in which flight takes a command; the others are taken in every state."""


# ---- what is asked for


@dataclass(frozen=True)
class Request:
    """A command. what: in words, for the record."""

    opcode: str
    arg_i: tuple[int, ...] = ()
    arg_u64: int = 0
    what: str = ""

    @property
    def crc(self) -> int:
        """The CRC that it names; 0 if it names none."""
        where = 1 if self.opcode.startswith("TABLE_") else 0
        named = self.opcode not in ("NOOP", "START", "ABORT", "TABLE_DISCARD")
        return unsigned32(self.arg_i[where]) if named and len(self.arg_i) > where else 0

    @property
    def kind(self) -> str:
        """Kind of the table that it is about, as the journal calls it; empty if it is about none."""
        about = self.opcode in ("TABLE_VALIDATE", "TABLE_ACTIVATE", "TABLE_DUMP")
        return kind_text(self.arg_i[0]) if about and self.arg_i else ""


def noop() -> Request:
    """Is flight there?"""
    return Request("NOOP", what="liveness check")


def start(
    acquisition: int = -1, poses: int = 0, seed: int = 1, coefficients: int = 0, suspects: bool = False
) -> Request:
    """Begin a calibration. acquisition: number, -1 as CONFIG says; poses, coefficients (bit for each): 0 as
    CONFIG says; suspects: from the joints that the monitor names."""
    args = (acquisition, poses, seed, 1) if suspects else (acquisition, poses, seed)
    what = "begin a calibration" + (" from the monitor's suspects" if suspects else "")
    return Request("START", args, coefficients, what)


def abort() -> Request:
    """Hold the arm and end the calibration."""
    return Request("ABORT", what="hold the arm, end the calibration")


def rollback(crc_in_force: int) -> Request:
    """Bring back the correction before the one in force."""
    return Request(
        "ROLLBACK", (crc_in_force,), what=f"bring back the correction before {crc_text(crc_in_force)}"
    )


def approve_arm(crc: int, override: bool = False) -> Request:
    """First step of an approval."""
    args = (crc, int(library("flight").constant("KC_OVERRIDE_FIT"))) if override else (crc,)
    return Request("APPROVE_ARM", args, what=f"arm the approval of correction {crc_text(crc)}")


def approve_go(crc: int) -> Request:
    """Second step."""
    return Request("APPROVE_GO", (crc,), what=f"put correction {crc_text(crc)} in force")


def reject(crc: int) -> Request:
    """Drop the correction that waits."""
    return Request("REJECT", (crc,), what=f"reject correction {crc_text(crc)}")


def validate(kind: str, crc: int) -> Request:
    """Check the staged table."""
    return Request("TABLE_VALIDATE", (tables.kind_number(kind), crc), what=f"check the staged {kind} table")


def activate(kind: str, crc: int) -> Request:
    """Put the staged table in force."""
    what = f"put {kind} table {crc_text(crc)} in force"
    return Request("TABLE_ACTIVATE", (tables.kind_number(kind), crc), what=what)


def discard() -> Request:
    """Drop the staged table."""
    return Request("TABLE_DISCARD", what="drop the staged table")


# ---- before it is sent


@dataclass(frozen=True)
class Unmet:
    """Why flight would refuse, by the last telemetry: what has to be, what was found, and what to do."""

    condition: str
    found: str
    todo: str

    @property
    def text(self) -> str:
        """The three in one line."""
        return f"{self.condition}; found: {self.found}. {self.todo}"


def unmet(request: Request, now: Snapshot, now_s: float, key_id: int = 0) -> tuple[Unmet, ...]:
    """Conditions that are not met as far as the last telemetry says. Flight decides in the end; empty means
    that nothing is known that speaks against it. ABORT has no condition. key_id: that would sign, 0: not
    known."""
    if request.opcode == "ABORT":
        return ()
    age = now.freshness("KC_HK", now_s)
    if now.hk is None or age.status != FRESH:
        where = "look for the flight process and the URL; `kincal status` shows what comes"
        return (Unmet("housekeeping not older than 3 s", age.why, where),)
    when = f"by housekeeping received {age.receive_age_s or 0.0:.1f} s ago"
    found = [_state(request, now.state, when), *_SPECIAL.get(request.opcode, _nothing)(request, now, now_s)]
    if request.opcode == "APPROVE_GO" and key_id:
        found.append(_holder(now.waiting(now_s), key_id))
    return tuple(one for one in found if one is not None)


def _holder(waits: Waiting, key_id: int) -> Unmet | None:
    if not waits.go_by or holder(waits.armed_key) != holder(key_id):
        return None
    todo = f"the second person: `kincal review go {waits.crc} --keys FILE`; {waits.left_s:.0f} s are left"
    return Unmet(f"GO with {waits.go_by}", f"key {key_id}", todo)


def _state(request: Request, state: str, when: str) -> Unmet | None:
    allowed = STATES.get(request.opcode, (state,))
    if state in allowed:
        return None
    todo = {
        "REVIEW": "decide first: `kincal review list --live`",
        "ARMED": "decide first: `kincal review go`, or `kincal review reject`",
        "STORE": "wait a second: a change is being stored",
    }.get(state, "wait for its end" + (", or `kincal command abort`" if calibrating(state) else ""))
    if request.opcode == "APPROVE_GO" and state == "REVIEW":
        todo = "arm first: `kincal review arm`"
    return Unmet(f"state {' or '.join(allowed)}", f"{state}, {when}", todo)


def _nothing(_request: Request, _now: Snapshot, _now_s: float) -> Sequence[Unmet]:
    return ()


def _start(request: Request, now: Snapshot, now_s: float) -> Sequence[Unmet]:
    found = []
    most = int(library("flight").constant("KC_MEAS_MAX"))
    if not 0 <= request.arg_i[1] <= most:
        found.append(Unmet(f"at most {most} poses", f"{request.arg_i[1]} asked for", "ask for fewer"))
    if missing := [table.kind for table in now.tables() if not table.crc]:
        todo = "`kincal table uplink FILE` for each"
        found.append(Unmet("all seven tables in force", f"no {', '.join(missing)}", todo))
    for channel, who in (("KC_ARM_STATE", "arm controller"), ("KC_PANTILT_STATE", "pan-tilt unit")):
        age = now.freshness(channel, now_s)
        if age.status != FRESH:
            found.append(Unmet(f"messages of the {who}", age.why, "see whether it runs, and its network"))
    arm = now.last("KC_ARM_STATE")
    if arm is not None and arm.message.fault_mask:
        mask = f"fault mask {arm.message.fault_mask:#x}"
        found.append(Unmet("an arm without a fault", mask, "clear it at the arm controller"))
    return found


def _proposal(request: Request, now: Snapshot, now_s: float) -> Sequence[Unmet]:
    waits = now.waiting(now_s).crc
    if waits == crc_text(request.crc):
        return ()
    found = f"{waits} waits" if waits else "nothing waits"
    return (Unmet(f"correction {crc_text(request.crc)} waits", found, "`kincal review list --live`"),)


def _arm(request: Request, now: Snapshot, now_s: float) -> Sequence[Unmet]:
    waits, found = now.waiting(now_s), list(_proposal(request, now, now_s))
    if not found and waits.verdict != names.VERDICTS["CHANGE"] and len(request.arg_i) < 2:  # noqa: PLR2004
        verdict = waits.verdict or "verdict not known"
        todo = "`kincal review reject CRC`; in an emergency `kincal review arm CRC --override REASON`"
        found.append(Unmet("a good fit, or an override", verdict, todo))
    return found


def _rollback(request: Request, now: Snapshot, _now_s: float) -> Sequence[Unmet]:
    active = _in_force(now)
    if active != crc_text(request.crc):
        found = f"{active or 'no correction'} is in force"
        return (Unmet(f"correction {crc_text(request.crc)} in force", found, "name the one in force"),)
    if now.hk is not None and not now.hk.kin_prev_crc:
        return (Unmet("a table before the one in force", "none", "`kincal table uplink FILE` sends one"),)
    return ()


def _in_force(now: Snapshot, kind: str = _KIN) -> str:
    return next((table.crc for table in now.tables() if table.kind == kind), "")


def _staged(request: Request, now: Snapshot, _now_s: float) -> Sequence[Unmet]:
    hk, kind = now.hk, tables.kind_name(request.arg_i[0])
    if hk is None:
        return ()
    if hk.staged_kind == request.arg_i[0]:
        if request.opcode == "TABLE_VALIDATE" or hk.staged_state == _VALID:
            return ()
        todo = f"`kincal command validate {kind.lower()} {crc_text(request.crc)}`"
        return (Unmet(f"a staged {kind} table that flight has checked", "not checked yet", todo),)
    found = f"kind {hk.staged_kind} staged" if hk.staged_kind else "nothing staged"
    return (Unmet(f"a staged {kind} table", found, "`kincal table uplink FILE`"),)


_SPECIAL: dict[str, Callable[[Request, Snapshot, float], Sequence[Unmet]]] = {
    "START": _start,
    "APPROVE_ARM": _arm,
    "APPROVE_GO": _proposal,
    "REJECT": _proposal,
    "ROLLBACK": _rollback,
    "TABLE_VALIDATE": _staged,
    "TABLE_ACTIVATE": _staged,
}


# ---- after it was sent


@dataclass(frozen=True)
class Step:
    """A verifier that was reached. utc: when this was received; t_us: flight's time of it, None if it has
    none; evidence: the message that says so."""

    stage: str
    utc: str
    t_us: int | None
    evidence: str


@dataclass
class Tracked:
    """One command that was sent, and what came of it. sent_s: by the clock of ages; before: telemetry when it
    was sent, which `take` does not change.

    before: the newest housekeeping then; several: more than one flight is heard. What housekeeping shows may
    then be the other one's: nothing counts as done.

    steps: verifiers in the order in which they were reached; outcome: "" while it is open; last_line: how it
    ended, a sentence or two; duplicates: acknowledgements that came again."""

    request: Request
    seq: int
    sent_s: float
    sent_utc_s: float
    timeout_s: float
    boot_count: int | None = None
    state_before: str = ""
    before: Hk | None = None
    several: bool = False

    def __post_init__(self) -> None:
        self.steps: list[Step] = [
            Step(SENT, utc_text(self.sent_utc_s), None, f"{self.request.opcode}, sequence number {self.seq}")
        ]
        self.outcome = self.last_line = ""
        self.duplicates = 0
        self._flight = None if self.before is None else self._identity(self.before)
        self._other: tuple[int, ...] | None = None  # of the last housekeeping, if it seems another flight's
        self._heard_s: float | None = None  # last housekeeping since it was sent
        self._status: int | None = None  # of the first acknowledgement
        self._refusal: tuple[Ack, float] | None = None  # and when it was received
        self._effect: tuple[int, str] | None = None  # what says that it is done: time, evidence
        self._event: EventLine | None = None  # the event that says so
        self._events: dict[int, EventLine] = {}

    @property
    def stage(self) -> str:
        """The last verifier that was reached."""
        return self.steps[-1].stage

    def reached(self, stage: str) -> bool:
        """Whether a verifier was reached."""
        return any(step.stage == stage for step in self.steps)

    def as_dict(self) -> dict[str, Any]:
        """Plain data for --json."""
        return {
            "command": self.request.opcode,
            "what": self.request.what,
            "crc": crc_text(self.request.crc) if self.request.crc else "",
            "sequence_number": self.seq,
            "outcome": self.outcome,
            "last_line": self.last_line,
            "duplicate_acknowledgements": self.duplicates,
            "verifiers": [asdict(step) for step in self.steps],
        }

    # ---- inputs

    def take(self, channel: str, message: Any, now_s: float, utc_s: float) -> tuple[Step, ...]:
        """A message that was received; the verifiers that it reaches. Also after a time-out: a late answer
        still counts."""
        n = len(self.steps)
        if self.outcome in (DONE, REFUSED):
            self.duplicates += channel == "KC_ACK" and self._mine(message)
            return ()
        utc = utc_text(utc_s)
        if channel == "KC_ACK":
            self._on_ack(message, utc, now_s)
        elif channel == "KC_EVENT":
            self._on_event(message, utc)
        elif channel == "KC_HK":
            self._heard_s = now_s
            self._on_hk(message, utc)
        return tuple(self.steps[n:])

    def tick(self, now_s: float) -> None:
        """Time passes: the outcome is set when the time is over."""
        if self._refusal is not None and not self.reached(ACCEPTED) and self.outcome != REFUSED:
            if now_s - self._refusal[1] > _EVENT_S:
                self._refused(self._refusal[0])
            return
        if self.outcome or now_s - self.sent_s < self.timeout_s:
            return
        if self.reached(ACCEPTED):
            missing = f"{self._expected} was not seen within {self.timeout_s:g} s"
            self._end(ACCEPTED, f"{self._name} accepted, but {missing}. See `kincal status`, and the events.")
        else:
            seen = "It is not known whether flight took it."
            if self._effect is not None:
                seen = f"No answer was received, but {self._effect[1]}: by this command or by another one."
            silent = f"{self._name} not answered within {self.timeout_s:g} s"
            self._end(UNCERTAIN, f"{silent}: {self._link(now_s)} {seen} It was sent once. {self._next}")

    # ---- messages

    def _mine(self, ack: Ack) -> bool:
        source = library("flight").lib.KC_SRC_GROUND
        return (ack.source, ack.seq, ack.opcode) == (source, self.seq, names.opcode(self.request.opcode))

    def _on_ack(self, ack: Ack, utc: str, now_s: float) -> None:
        if not self._mine(ack):
            return
        if self._status is not None:
            self.duplicates += 1
            return
        self._status = ack.status
        evidence = f"acknowledgement, status {ack.status}"
        self._reach(RECEIVED, utc, ack.t_us, evidence)
        if ack.status == 0:
            self._accepted(utc, ack.t_us, evidence)
        elif not self.reached(ACCEPTED):
            name = event_name(ack.event_id) if ack.event_id else "no event"
            self._reach(REFUSED, utc, ack.t_us, f"{status_name(ack.status)}, {name}")
            self._refusal = ack, now_s
            if not ack.event_id or ack.event_id in self._events:
                self._refused(ack)

    def _refused(self, ack: Ack) -> None:
        """The end, with the event that says why, which may come after the answer."""
        event = self._events.get(ack.event_id)
        name = event_name(ack.event_id) if ack.event_id else ""
        why = f"{name}: {event.text}" if event else name or status_name(ack.status)
        todo = event_action(ack.event_id) if ack.event_id else ""
        self._end(REFUSED, f"{self._name} refused: {why}. Nothing was changed on board. {todo}".strip())

    def _on_event(self, e: Any, utc: str) -> None:
        line = event_of(e, utc)
        self._events[e.id] = line
        if self._refusal is not None:
            if e.id == self._refusal[0].event_id:
                self._refused(self._refusal[0])
        elif line.name == "CMD_ACCEPTED" and (e.index, e.got) == (
            self.seq,
            names.opcode(self.request.opcode),
        ):
            self._accepted(utc, e.t_us, "event CMD_ACCEPTED")
        elif self._says_so(line.name, e):
            self._event = line
            if self.request.opcode in _DONE_BY_EVENT:
                self._done(utc, e.t_us, f"event {line.name}: {line.text}")

    def _on_hk(self, hk: Hk, utc: str) -> None:
        state = names.state_name(hk.state)
        if not self._same_flight(hk):
            return
        if self.boot_count is not None and hk.boot_count != self.boot_count and not self._shows(hk, state):
            self._restarted(hk, state)
            return
        if state == "STORE" and self.request.opcode in _STORED and self.state_before != "STORE":
            self._reach(RECEIVED, utc, hk.t_us, "state STORE in housekeeping: the change is being stored")
        if self._shows(hk, state):
            said = f"; event {self._event.name}: {self._event.text}" if self._event else ""
            self._done(utc, hk.t_us, f"housekeeping: {self._shown(hk, state)}{said}")

    def _identity(self, hk: Hk) -> tuple[int, ...]:
        """Starts, and CRCs of the tables that this command leaves as they are."""
        if self.request.opcode == "TABLE_ACTIVATE":  # other kinds may be dropped with it
            return (hk.boot_count,)
        kin = tables.kind_number(_KIN) if self.request.opcode in ("APPROVE_GO", "ROLLBACK") else 0
        return (hk.boot_count, *(crc for kind, crc in enumerate(hk.table_crc) if kind != kin))

    def _same_flight(self, hk: Hk) -> bool:
        """Whether housekeeping is of the flight that was heard before, or of its next start. Of a change that
        stays, the second one says so; what goes to and fro are two flights."""
        who = self._identity(hk)
        if self._flight in (None, who):
            self.several = self.several or self._other is not None
        elif who in (self._other, (self._flight[0] + 1, *self._flight[1:])):
            self._other = None
        else:
            self._other = who
            return False
        self._flight = who
        if self.several and self.reached(ACCEPTED):
            self._end(ACCEPTED, self._unread)
        return not self.several

    @property
    def _unread(self) -> str:
        return f"{self._name} accepted; what came of it cannot be read back: {SEVERAL}. {END_OTHER}"

    def _restarted(self, hk: Hk, state: str) -> None:
        taken = (
            "It had been accepted." if self.reached(ACCEPTED) else "It is not known whether flight took it."
        )
        self._end(
            UNCERTAIN,
            f"Flight was started again (start {self.boot_count} -> {hk.boot_count}) before {self._name} was "
            f"done; its state is {state}. {taken} It was sent once. {self._next}",
        )

    # ---- verifiers

    def _reach(self, stage: str, utc: str, t_us: int | None, evidence: str) -> None:
        if not self.reached(stage):
            self.steps.append(Step(stage, utc, t_us, evidence))

    def _accepted(self, utc: str, t_us: int, evidence: str) -> None:
        self._reach(RECEIVED, utc, t_us, evidence)
        self._reach(ACCEPTED, utc, t_us, evidence)
        if self.request.opcode == "NOOP":
            self._effect = t_us, "flight answers"
        if self.several:
            self._end(ACCEPTED, self._unread)
        elif self._effect is not None:
            self._done(utc, *self._effect)

    def _done(self, utc: str, t_us: int, evidence: str) -> None:
        """Done if it was accepted; the effect alone may be somebody else's command, or another flight's."""
        if self.several:
            return
        if not self.reached(ACCEPTED):
            if self.request.opcode in _DONE_BY_EVENT or self._event is not None:
                self._effect = t_us, evidence
            return
        self._reach(DONE, utc, t_us, evidence)
        self._end(DONE, f"{self._name} done: {evidence}")

    def _end(self, outcome: str, last_line: str) -> None:
        self.outcome, self.last_line = outcome, last_line

    # ---- by opcode

    @property
    def _name(self) -> str:
        return (
            f"{self.request.opcode} {crc_text(self.request.crc)}" if self.request.crc else self.request.opcode
        )

    @property
    def _expected(self) -> str:
        return _EXPECTED.get(self.request.opcode, "its effect")

    @property
    def _next(self) -> str:
        if self.request.opcode == "ABORT":
            return "ABORT may be sent again at any time."
        return "Look at the state (`kincal status`) before you send it again."

    def _link(self, now_s: float) -> str:
        if self.several:
            return f"{SEVERAL}. {END_OTHER}"
        if self._heard_s is None:
            return "no housekeeping came either, so the link is cut or flight does not run."
        age = now_s - self._heard_s
        if age > 3.0:  # noqa: PLR2004 as in MOST_AGE_S
            return f"housekeeping stopped {age:.0f} s ago."
        return "housekeeping goes on, so the command or its answer was lost."

    def _says_so(self, name: str, e: Any) -> bool:
        """Whether an event is what this command brings."""
        wanted = _EVENTS.get(self.request.opcode, "")
        if name != wanted:
            return False
        if self.request.opcode in ("APPROVE_ARM", "APPROVE_GO", "REJECT"):
            return math.isfinite(e.got) and unsigned32(int(e.got)) == self.request.crc
        return True

    def _shows(self, hk: Hk, state: str) -> bool:
        """Whether housekeeping shows what this command brings."""
        crc, args, opcode = self.request.crc, self.request.arg_i, self.request.opcode
        in_force = unsigned32(hk.table_crc[tables.kind_number(_KIN)])
        if opcode == "ABORT":
            return state == "SAFE"
        if opcode == "APPROVE_ARM":
            return state == "ARMED" and unsigned32(hk.proposal_crc) == crc
        if opcode == "APPROVE_GO":
            return in_force == crc
        if opcode == "REJECT":
            return hk.proposal_crc == 0
        if opcode == "ROLLBACK":
            return in_force != crc
        if opcode == "TABLE_VALIDATE":
            return hk.staged_kind == args[0] and hk.staged_state == _VALID
        if opcode == "TABLE_ACTIVATE":
            return unsigned32(hk.table_crc[args[0]]) == crc
        if opcode == "TABLE_DISCARD":
            return hk.staged_kind == 0
        return opcode == "START" and self.reached(ACCEPTED) and calibrating(state)

    def _shown(self, hk: Hk, state: str) -> str:
        opcode = self.request.opcode
        if opcode in ("APPROVE_GO", "ROLLBACK"):
            return f"correction {crc_text(hk.table_crc[tables.kind_number(_KIN)])} in force"
        if opcode == "TABLE_ACTIVATE":
            return f"{tables.kind_name(self.request.arg_i[0])} table {crc_text(self.request.crc)} in force"
        if opcode == "REJECT":
            return "no correction waits"
        return {
            "ABORT": "state SAFE, the arm is held",
            "TABLE_VALIDATE": "staged table valid",
            "TABLE_DISCARD": "nothing staged",
        }.get(opcode, f"state {state}")


_STORED = ("APPROVE_GO", "REJECT", "ROLLBACK", "TABLE_ACTIVATE")  # answered when the change is stored
_DONE_BY_EVENT = ("START", "APPROVE_ARM")  # the others by housekeeping: what is in force is read back
_EVENTS = {
    "START": "CAL_START",
    "ABORT": "CAL_ABORTED",
    "APPROVE_ARM": "COR_ARMED",
    "APPROVE_GO": "COR_ACTIVE",
    "REJECT": "COR_REJECTED",
    "ROLLBACK": "COR_ROLLBACK",
    "TABLE_ACTIVATE": "TBL_ACTIVATED",
    "TABLE_DISCARD": "TBL_DISCARDED",
}
_EXPECTED = {
    "START": "the begin of the calibration (CAL_START)",
    "ABORT": "state SAFE",
    "APPROVE_ARM": "state ARMED",
    "APPROVE_GO": "the correction in force",
    "REJECT": "the end of the proposal",
    "ROLLBACK": "another correction in force",
    "TABLE_VALIDATE": "a valid staged table",
    "TABLE_ACTIVATE": "the table in force",
    "TABLE_DISCARD": "an empty staging area",
}
