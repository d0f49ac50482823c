"""The journal of a mission: decisions, commands, attempts, refusals, questions; one JSON object a line, each
with the hash of the line before and a MAC.

The hash shows a line that was changed, taken out or put in between, but not what was done to the last one:
the MAC, made with the key that signed the decision, shows that too. Last lines that are gone are noticed by
the end mark, a file beside the journal: how many lines it has and the hash of the last one, with a MAC. A
journal that was put back together with its mark is noticed where a log has its command: flight took it, and
its counter is above those of the journal (`absent`)."""

from __future__ import annotations

import dataclasses
import errno
import fcntl
import hashlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from kincal.flight import library, tables
from kincal.link import LogSummary, crc_text
from kincal.link.names import opcode
from kincal_shared.errors import BadInput, KincalError
from kincal_shared.keys import JOURNAL, JOURNAL_END, RUN_KEYS, Key, Signer, holder, lock, open_own, signed_by
from kincal_shared.keys import read as read_keys

NAME = JOURNAL
"""Of a journal, beside the key file; of a run it lies beside its log too."""
END = JOURNAL_END
"""Suffix of the end mark."""
VARIABLE = "KINCAL_JOURNAL"
_LABEL = b"KinCal review 1\0"
LOCK_WAIT_S = 5.0
_CANNOT = "the review journal cannot be kept"
_ROOM = "free space there, or name another journal, then try again"
_COPY = "bring back the copy in your records; the tool never rewrites it"
SEEN, ARMED, APPROVED, REJECTED = "seen", "arm", "approve", "reject"
"""What an entry says; `seen` is no decision, but has to come before one."""
ATTEMPT, REFUSED, UNANSWERED = "attempt", "refused", "unanswered"
"""Before a command is sent; that flight or this tool refused it; that nobody knows whether flight took it."""
COMMENT, QUESTION = "comment", "question"
REMARKS = (COMMENT, QUESTION)
"""What people say of a correction beside deciding."""
SAID = (SEEN, ATTEMPT, REFUSED, UNANSWERED, COMMENT, QUESTION)
"""What changes nothing."""
_END_LABEL = b"KinCal journal end 1\0"
_DECIDING = {"APPROVE_ARM": ARMED, "APPROVE_GO": APPROVED, "REJECT": REJECTED}
_OTHERS = ("START", "ROLLBACK", "TABLE_ACTIVATE", "TABLE_DISCARD", "TABLE_DUMP")
_WRITTEN = _DECIDING | {name: name.lower() for name in _OTHERS}
"""The line of each command that flight has taken. An uplink has one, of its last command."""
_TABLES = {
    "table_validate": "staged {} checked",
    "table_activate": "{} put in force",
    "table_discard": "staged table dropped",
    "table_dump": "{} read back",
}
_TO_TABLES = {
    "TABLE_VALIDATE": "check the staged {}",
    "TABLE_ACTIVATE": "put the {} in force",
    "TABLE_DISCARD": "drop the staged table",
    "TABLE_DUMP": "read back the {}",
}


@dataclass(frozen=True)
class Entry:
    """One decision of the journal, or that somebody has seen a proposal. time: UTC, ISO; crc: eight hex
    digits; numbers, verdict: of the proposal as it was seen, empty if nobody had; previous: SHA-256 of the
    line before, empty for the first; override: why it was approved in spite of the reasons to reject it;
    key_id, counter: of the command that carried it out, 0 in journals of before (counter: also where it was
    only seen); unconfirmed: how many lines before it nobody could vouch for when it was written; mac: made
    with that key over all of the others, empty in journals of before. command: that was attempted or refused;
    marked: 1 if an end mark is kept from here on; armed_key: of an approval, the key that took its first
    step, as flight says; against: reasons to reject the proposal that its verdict and numbers do not show
    (clearance), as they were seen; kind: of the table that is sent, checked, put in force or read back. A
    answers: of a comment, the number of the line, from 1, with the question that it answers. A line leaves
    these six out where they are empty."""

    time: str
    decision: str
    crc: str
    by: str
    why: str
    session: int | None
    url: str
    numbers: dict[str, float]
    previous: str = ""
    verdict: str = ""
    override: str = ""
    key_id: int = 0
    counter: int = 0
    unconfirmed: int = 0
    mac: str = ""
    command: str = ""
    marked: int = 0
    armed_key: int = 0
    against: tuple[str, ...] = ()
    kind: str = ""
    answers: int = 0

    def text(self) -> str:
        """The line of the journal."""
        fields = dataclasses.asdict(self)
        # lines of before they were there stay as they are
        later = {"command", "marked", "armed_key", "against", "kind", "answers"}
        return json.dumps({k: v for k, v in fields.items() if v or k not in later}, sort_keys=True)

    @property
    def words(self) -> str:
        """What was done, or attempted, in words; the CRC and who did it are beside it."""
        kind = f"{self.kind} table" if self.kind else "table"
        if self.decision in SAID:
            to = _TO_TABLES.get(self.command, "").format(kind)
            answers = f", answers line {self.answers}" if self.answers else ""
            return f"{self.decision}: {to}" if to else f"{self.decision} {self.command}".strip() + answers
        return _TABLES.get(self.decision, self.decision).format(kind)

    def mac_of(self, key: Key) -> str:
        """What `mac` has to be."""
        return key.digest(_LABEL + dataclasses.replace(self, mac="").text().encode()).hex()


@dataclass(frozen=True)
class Journal:
    """What a journal holds. unconfirmed: how many of its last lines no key vouches for; why: in words; keys:
    that it was checked with; broken: what `inspect` found wrong with it, None if it is sound."""

    path: Path
    entries: tuple[Entry, ...] = ()
    unconfirmed: int = 0
    why: str = ""
    keys: tuple[Key, ...] = field(default=(), repr=False)
    broken: KincalError | None = None

    def open_questions(self, crc: str) -> dict[int, Entry]:
        """Questions about a correction that no comment answers, by the number of their line."""
        answered = {entry.answers for entry in self.entries}
        lines = enumerate(self.entries, 1)
        return {n: e for n, e in lines if (e.decision, e.crc) == (QUESTION, crc) and n not in answered}

    def seen_by(self, who: str, crc: str) -> Entry | None:
        """The last line, vouched for by a key, that says that somebody has seen a proposal; names without
        regard to case and outer spaces."""
        who = who.strip().casefold()
        mine = [e for e in self.seen_all(crc) if e.by.strip().casefold() == who]
        return mine[-1] if mine else None

    def seen_all(self, crc: str) -> list[Entry]:
        """All lines, vouched for by a key, that somebody has seen a proposal."""
        good = self.entries[: len(self.entries) - self.unconfirmed]
        return [e for e in good if (e.decision, e.crc) == (SEEN, crc)]

    @property
    def vouched(self) -> str:
        """Who vouches for its lines, in words."""
        if not self.unconfirmed:
            return "each line from the holder of the key" if self.entries else "nothing to check"
        first, last = len(self.entries) - self.unconfirmed + 1, len(self.entries)
        which = f"lines {first} to {last}" if first < last else f"line {last}"
        return f"{which}: nobody can tell whether they were changed, {self.why}"


def read(path: Path, keys: Sequence[Key] = ()) -> Journal:
    """All entries. BadInput names the first line that does not follow from the one before, or that is not
    what a key of `keys` vouched for."""
    if not os.path.lexists(path):
        return _parsed(path, b"", keys)  # its end mark may say that there was one
    if not path.is_file():
        raise BadInput("the review journal is no regular file", str(path), "name another one by --journal")
    try:
        with open(path, "rb", buffering=0) as file:
            # a writer adds the line first, then the mark: between the two they do not agree
            lock(file, path, LOCK_WAIT_S, fcntl.LOCK_SH)
            return _parsed(path, file.readall(), keys)
    except OSError as error:
        raise BadInput(
            f"the review journal cannot be read: {error.strerror}",
            str(path),
            "see to its permissions, or name another by --journal",
        ) from None


def inspect(path: Path, keys: Sequence[Key] = ()) -> Journal:
    """As `read`, but of a journal that was changed all lines that can be read, which no key vouches for: to
    show them, never to decide by them."""
    try:
        return read(path, keys)
    except BadInput as error:
        entries = _readable(path)
        return Journal(path, entries, len(entries), "the journal does not verify", tuple(keys), error)


def _readable(path: Path) -> tuple[Entry, ...]:
    try:
        lines = _lines(path.read_bytes())
    except OSError:
        return ()
    found = []
    for line in lines:
        with suppress(BadInput):
            found.append(_entry(line, ""))
    return tuple(found)


def question_text(number: int, entry: Entry) -> str:
    """An open question, with how it is answered; number: of its line."""
    return (
        f"open question by {entry.by}, {entry.time}: {one_line(entry.why)} "
        f"(answer it: `kincal review comment TEXT --answers {number} --by NAME`)"
    )


def remark_text(number: int, entry: Entry) -> str:
    """A comment or a question; number: of its line."""
    return f"{entry.words} by {entry.by}, {entry.time} (line {number}): {one_line(entry.why)}"


def append(path: Path, entry: Entry, signer: Signer, check: Callable[[Journal], None] | None = None) -> Entry:
    """Add an entry, with what ties it to the line before and to the last command of the signer; it is on the
    medium when this returns. BadInput as `read`, or if the line cannot be written. check: takes the journal
    while nobody else can write, and raises if the entry does not hold any more."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    except OSError as error:
        raise BadInput(
            f"{_CANNOT}: {error.strerror}", str(path.parent), "name another by --journal"
        ) from None
    with open_own(path, _CANNOT, os.O_APPEND) as file:
        lock(file, path, LOCK_WAIT_S)
        raw = file.readall()
        before = _parsed(path, raw, signer.known)
        if check is not None:
            check(before)
        entry = dataclasses.replace(
            entry,
            previous=_hash(_lines(raw)[-1]) if raw else "",
            key_id=signer.key.id,
            counter=signer.counters.get(_ground(), 0),
            unconfirmed=before.unconfirmed,
            marked=1,
        )
        entry = dataclasses.replace(entry, mac=entry.mac_of(signer.key))
        line = entry.text().encode() + b"\n"
        try:
            if file.write(line) != len(line):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            os.fsync(file.fileno())
            _write_end(path, len(before.entries) + 1, _hash(line.rstrip(b"\n")), signer)
        except OSError as error:
            file.truncate(len(raw))  # without its mark it would make the next line count as appended
            raise BadInput(f"{_CANNOT}: {error.strerror}", str(path), _ROOM) from None
    return entry


def one_line(text: str) -> str:
    """Words of a person for a line of output: what stands in a line of its own was written by the tool."""
    return " ".join(text.split())


def unfinished(entries: Sequence[Entry]) -> list[Entry]:
    """Attempts without a line that says what came of them: the program ended in between. What flight made of
    them, its state and its log say. Of several alike, a line ends the newest with its name and reason: a
    program that was killed does not write any more."""
    waiting: list[Entry] = []
    for entry in entries:
        if entry.decision == ATTEMPT:
            waiting.append(entry)
            continue
        ends = [a for a in waiting if (a.crc, a.key_id) == (entry.crc, entry.key_id) and _ends(a, entry)]
        alike = [a for a in ends if (a.by, a.why) == (entry.by, entry.why)]
        if ends:
            waiting.remove((alike or ends)[-1])
    return waiting


def _ends(attempt: Entry, entry: Entry) -> bool:
    if entry.decision in (REFUSED, UNANSWERED):
        return entry.command == attempt.command
    return entry.decision in (_DECIDING.get(attempt.command), attempt.command.lower())


# ---- the end mark


@dataclass(frozen=True)
class End:
    """How many lines a journal has, and the hash of the last one; mac: made with the key of that number."""

    lines: int
    last: str
    key_id: int
    mac: str = ""

    def mac_of(self, key: Key) -> str:
        """What `mac` has to be."""
        return key.digest(_END_LABEL + f"{self.lines} {self.last} {self.key_id}".encode()).hex()


def end_file(path: Path) -> Path:
    """The end mark of a journal."""
    return path.with_name(path.name + END)


def _write_end(path: Path, lines: int, last: str, signer: Signer) -> None:
    """Whoever finds the mark finds all of it. Between the line and its mark the journal is one line ahead.
    OSError if it cannot be written."""
    end = End(lines, last, signer.key.id)
    end = dataclasses.replace(end, mac=end.mac_of(signer.key))
    file = end_file(path)
    part = file.with_name(file.name + ".part")
    part.unlink(missing_ok=True)
    with open(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii") as out:
        out.write(json.dumps(dataclasses.asdict(end), sort_keys=True) + "\n")
        out.flush()
        os.fsync(out.fileno())
    part.rename(file)


def _read_end(file: Path) -> End | None:
    """None if there is none."""
    if not os.path.lexists(file):
        return None
    try:
        end = End(**json.loads(file.read_bytes()))
        good = isinstance(end.lines, int) and end.lines > 0 and isinstance(end.key_id, int)
        good = good and isinstance(end.last, str) and isinstance(end.mac, str)
    except (OSError, ValueError, TypeError, RecursionError):
        good = False
    if not good:
        raise BadInput("the end mark of the journal is damaged", str(file), _COPY)
    return end


def _check_end(path: Path, entries: Sequence[Entry], last: str, known: Mapping[int, Key]) -> None:
    """The journal ends where its mark says, or one line later: power was lost between the two."""
    file, n = end_file(path), len(entries)
    end = _read_end(file)
    if end is None:
        # one line may be without its mark: power was lost before it was written for the first time
        if sum(entry.marked for entry in entries) > 1:
            raise BadInput(
                f"the end mark of the journal is gone: lines after line {n} may have been removed",
                str(file),
                _COPY,
            )
        return
    if end.key_id in known and end.mac != end.mac_of(known[end.key_id]):
        raise BadInput("the end mark of the journal was changed", str(file), _COPY)
    if n < end.lines:
        gone = f"line {n + 1} was" if end.lines == n + 1 else f"lines {n + 1} to {end.lines} were"
        raise BadInput(f"the review journal was cut: {gone} removed from its end", f"{path}:{n + 1}", _COPY)
    at_mark = last if n == end.lines else entries[end.lines].previous
    if at_mark != end.last:
        where = f"{path}:{end.lines}"
        raise BadInput(
            "the review journal was changed: this line is not the one of its end mark", where, _COPY
        )
    if n > end.lines + 1 or (n > end.lines and not (entries[-1].marked and entries[-1].mac)):
        raise BadInput(
            f"the review journal was changed: its end mark stands at line {end.lines}, this one was appended "
            "after it",
            f"{path}:{end.lines + 1}",
            _COPY,
        )


def end_text(journal: Journal) -> str:
    """Where a journal ends, to be noted elsewhere: number of lines and the hash of the last one."""
    if not journal.entries:
        return "0"
    return f"{len(journal.entries)}:{_hash(journal.entries[-1].text().encode())[:16]}"


def check_noted(journal: Journal, noted: str) -> None:
    """That a journal still holds what `end_text` once said. BadInput if not."""
    count, _, digest = noted.partition(":")
    good = count.isdecimal() and int(count) <= len(journal.entries)
    if good and int(count):
        good = _hash(journal.entries[int(count) - 1].text().encode()).startswith(digest) and len(digest) >= 8
    if not good:
        raise BadInput(
            f"the journal does not hold what was noted: {noted}; it ends at {end_text(journal)}",
            str(journal.path),
            _COPY,
        )


def _ground() -> int:
    return int(library("flight").lib.KC_SRC_GROUND)


def _hash(line: bytes) -> str:
    return hashlib.sha256(line).hexdigest()


def _lines(raw: bytes) -> list[bytes]:
    """Without their ends. Only at what `append` writes: another end of line is a change of the line."""
    lines = raw.split(b"\n")
    return lines if lines[-1] else lines[:-1]


def _parsed(path: Path, raw: bytes, keys: Sequence[Key]) -> Journal:
    """The chain, and the MACs that can be checked."""
    known = {key.id: key for key in keys}
    entries: list[Entry] = []
    before, confirmed = "", 0
    newest: dict[int, int] = {}
    for n, line in enumerate(_lines(raw), 1):
        where = f"{path}:{n}"
        entry = _entry(line, where)
        if entry.previous != before:
            raise BadInput(
                "the review journal was changed: a line does not follow from the one before", where, _COPY
            )
        _check_key(entry, newest, where)
        newest[holder(entry.key_id)] = entry.key_id
        if entry.key_id in known:
            if entry.mac != entry.mac_of(known[entry.key_id]):
                raise BadInput(
                    f"the review journal was changed: key {entry.key_id} did not write this line",
                    where,
                    f"{_COPY}. After `kincal key new` begin a new one: --journal FILE",
                )
            confirmed = n
        entries.append(entry)
        before = _hash(line)
    if raw and not raw.endswith(b"\n"):
        where = f"{path}:{len(entries)}"
        raise BadInput("the review journal is damaged: its last line has no end", where, _COPY)
    unconfirmed = len(entries) - confirmed
    _check_end(path, entries, before, known)
    return Journal(path, tuple(entries), unconfirmed, _why(entries[confirmed:], keys), tuple(keys))


def _check_key(entry: Entry, newest: Mapping[int, int], where: str) -> None:
    """The keys of a holder only go forward: who could write lines of a key that is gone would need no key.
    newest: key of each holder up to this line."""
    gone = entry.key_id < newest.get(holder(entry.key_id), 0) or (not entry.key_id and any(newest.values()))
    if gone or bool(entry.key_id) != bool(entry.mac):
        raise BadInput(
            "the review journal was changed: the MAC of a line is missing, or of an older key than before it",
            where,
            _COPY,
        )


def _why(unconfirmed: Sequence[Entry], keys: Sequence[Key]) -> str:
    if not unconfirmed:
        return ""
    if not keys:
        return "there is no key file to check with"
    if not unconfirmed[-1].mac:
        return "they carry no MAC (written before journals had one, or by somebody else)"
    return f"the key file does not have key {unconfirmed[-1].key_id}"


_TYPES: dict[str, type | tuple[type, ...]] = {
    "session": (int, type(None)),
    "numbers": dict,
    "key_id": int,
    "counter": int,
    "unconfirmed": int,
    "marked": int,
    "answers": int,
    "armed_key": int,
    "against": tuple,
}


def _entry(line: bytes, where: str) -> Entry:
    """An entry of a line; BadInput if it is none."""
    try:
        fields = json.loads(line)
        if isinstance(reasons := fields.get("against"), list):
            fields["against"] = tuple(reasons)
        entry = Entry(**fields)
        values = dataclasses.asdict(entry)
        good = all(isinstance(value, _TYPES.get(name, str)) for name, value in values.items())
        good = good and all(isinstance(reason, str) for reason in entry.against)
        # the same object can be written in many ways, of which one is authenticated
        good = good and (not entry.mac or entry.text().encode() == line)
    except (ValueError, TypeError, AttributeError, RecursionError):
        good = False
    if not good:
        raise BadInput("the review journal is damaged", where, _COPY)
    return entry


# ---- against logs


def absent(journals: Sequence[Journal], log: LogSummary) -> list[str]:
    """Decisions that flight took, signed with a key of a journal, and that no line of it has, in words."""
    return [text for journal in journals for text in _absent(journal, log)]


def _absent(journal: Journal, log: LogSummary) -> list[str]:
    opcodes = {opcode(name): decision for name, decision in _WRITTEN.items()}
    of_tables = {opcode(name) for name in _WRITTEN if name.startswith("TABLE_")}
    taken = {(a.source, a.seq, a.opcode) for a in log.acks if a.status == 0}
    there = {(e.key_id, e.counter, e.decision) for e in journal.entries}
    highest = max((e.counter for e in journal.entries), default=0)
    found: list[str] = []
    for c in log.commands:
        ours = c.opcode in opcodes and c.source == _ground() and (c.source, c.seq, c.opcode) in taken
        # the first step alone changes nothing, and was not written down before there were overrides
        ours = ours and (opcodes[c.opcode] != ARMED or c.arg_i[1] != 0)
        if not ours or (c.key_id, c.counter, opcodes[c.opcode]) in there:
            continue
        if not any(signed_by(c, key) for key in journal.keys):
            continue
        after = "after its last line" if c.counter > highest else "between its lines"
        named = opcodes[c.opcode]
        if c.opcode in of_tables:
            named = _TABLES[named].format(f"{kind_text(c.arg_i[0])} table")
            named += f" ({crc_text(c.arg_i[1])})" if c.arg_i[1] else ""
        elif c.opcode != opcode("START"):
            named += f" of {crc_text(c.arg_i[0])}"
        found.append(
            f"{named} (key {c.key_id}, counter {c.counter}), which "
            f"flight took, is not in {journal.path}: a line is gone {after}, or was never written"
        )
    return found


def kind_text(number: int) -> str:
    """Kind of a table as the journal calls it; number: of a command."""
    known = {n: name.upper() for name, n in tables.kinds().items()}
    known[int(library("flight").constant("KC_STORE_PROPOSAL"))] = "proposed KIN"
    return known.get(number, str(number))


def missing(journal: Journal, key: int, accepted: int) -> str:
    """Why a journal without a line is not that of a first start; empty if it has lines, or may be one.
    accepted: highest counter of this key that flight has accepted, 0: none."""
    if journal.entries or not accepted:
        return ""
    return (
        f"flight has accepted commands of key {key} up to counter {accepted}, and {journal.path} has no "
        "line: it was removed, or is kept elsewhere"
    )


MISSING_TODO = (
    "bring back the copy in your records, with its .end; or name the one that is kept by --journal FILE. If "
    "another program has sent with this key so far, begin it: `kincal review comment TEXT`"
)


def of_run(log: Path, how: Callable[[Path, Sequence[Key]], Journal] = read) -> Journal | None:
    """The journal of a run, beside its log, checked with the keys of the run if they are there; None if there
    is neither. how: `read` or `inspect`, and its errors."""
    path, keys = log.with_name(NAME), log.with_name(RUN_KEYS)
    if not path.is_file() and not keys.is_file():
        return None
    return how(path, read_keys(keys) if keys.is_file() else ())


def place(journal: Path | None, key_file: Path) -> Path:
    """The given one, else beside the key file: one journal for each, as with the counters."""
    return journal.expanduser() if journal else key_file.with_name(NAME)
