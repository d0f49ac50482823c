"""Keys of commands: the file that holds them, and the signatures that they make.

Flight takes a command that changes anything only with a MAC over all of its fields and a counter that it has
not seen before (docs/INTERFACES.md, Signed commands). This is the sender's side; it shares no code with
flight's (fsw/decide/kc_auth.c, fsw/command/kc_signed.c)."""

from __future__ import annotations

import errno
import fcntl
import hashlib
import os
import secrets
import stat
import struct
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from typing import Any, TypeVar

from kincal_shared.errors import BadInput

VARIABLE = "KINCAL_KEYS"
DEFAULT = Path("~/.kincal/keys")
JOURNAL, JOURNAL_END = "review.jsonl", ".end"
"""Name of the review journal beside a key file, and what the name of its end mark has more."""
RUN_KEYS = "store.keys"
"""Key file of a simulated run, in its folder."""
MOST = 4
"""Keys of a file: of two holders, the old and the new one of a rotation."""
HOLDER_NUMBERS = 100
"""Numbers of keys for each holder: 1 to 99, 101 to 199, ... (fsw/command/kc_holder.h)."""
_ROTATION = 2
_HEAD = "kincal-keys 1"
_SECRET_BYTES, _MAC_BYTES = 32, 16
_ID_MAX = 2**31 - 1
_COUNT_MAX = 2**63 - 1  # as messages carry it
_COUNT_BYTES = 64
_OWN = "a file of your own has to be there, or none"
COUNTER_WAIT_S = 1.0
"""Longest wait for a counter: whoever holds it does so for milliseconds, and an ABORT may be waiting."""
_LOCK_POLL_S = 0.01
_NAME_KEYS = f"name a file by --keys or ${VARIABLE}; `kincal key new` makes one"
_ROOM = "free space there, then try again"
_MEDIUM = {
    errno.EROFS: "make its medium writable again, then try again",
    errno.ENOSPC: _ROOM,
    errno.EDQUOT: _ROOM,
    errno.EIO: "see to its medium, then try again",
}
"""What to do where it is not the file."""
# label, key, counter, t_us, source; then what a command or a chunk says
_SENDER = "<16sIQqi"
_CMD = struct.Struct(_SENDER + "ii4iq4d")
_CHUNK = struct.Struct(_SENDER + "iiii1024s")
_MAC = struct.Struct("<2q")
_M = TypeVar("_M")

Count = Callable[[int], int]
"""Source -> the counter of its next message; grows with every call."""


@dataclass(frozen=True)
class Key:
    """A number that is known to all and a secret that is not."""

    id: int
    secret: bytes

    @property
    def fingerprint(self) -> str:
        """Eight hex digits by which people tell keys apart; they say nothing of the secret."""
        return hashlib.blake2b(key=self.secret, digest_size=4, person=b"fingerprint").hexdigest()

    def digest(self, text: bytes) -> bytes:
        """MAC of a text, 16 bytes."""
        return hashlib.blake2b(text, key=self.secret, digest_size=_MAC_BYTES).digest()

    def mac(self, text: bytes) -> tuple[int, int]:
        """The same, as messages carry it."""
        low, high = _MAC.unpack(self.digest(text))
        return low, high


# ---- holders


def holder(key_id: int) -> int:
    """Whose key it is, by its number: 0 for 1 to 99, 1 for 101 to 199, ..."""
    return key_id // HOLDER_NUMBERS


def other_than(key_id: int) -> str:
    """Which key may give the second step, in words; key_id: of the first."""
    first = max(holder(key_id) * HOLDER_NUMBERS, 1)
    last = (holder(key_id) + 1) * HOLDER_NUMBERS - 1
    return f"another key than key {key_id}, of another holder (not {first} to {last})"


# ---- signing


class Signer:
    """Signs messages with a key; `count` numbers them. known: keys whose signatures it can check; counters:
    of the last message that it signed, by source."""

    def __init__(self, key: Key, count: Count, known: Sequence[Key] = ()) -> None:
        self.key, self.count = key, count
        self.known = tuple(known) or (key,)
        self.counters: dict[int, int] = {}

    def command(self, m: _M) -> _M:
        """The same cmd_t, signed for its source."""
        return self._sign(m, _command_text)

    def chunk(self, m: _M) -> _M:
        """The same table_chunk_t, signed for its source."""
        return self._sign(m, _chunk_text)

    def _sign(self, message: _M, text: Callable[[Any], bytes]) -> _M:
        m: Any = message
        m.key_id, m.counter = self.key.id, self.count(m.source)
        self.counters[m.source] = m.counter
        m.mac = list(self.key.mac(text(m)))
        return message


def signed_by(command: Any, key: Key) -> bool:
    """Whether this key made the signature of a cmd_t."""
    if command.key_id != key.id or command.counter < 0:
        return False
    return tuple(command.mac) == key.mac(_command_text(command))


def _command_text(m: Any) -> bytes:
    sender = (b"KinCal command 1", m.key_id, m.counter, m.t_us, m.source)
    return _CMD.pack(*sender, m.seq, m.opcode, *m.arg_i, m.arg_u64, *m.arg_d)


def _chunk_text(m: Any) -> bytes:
    sender = (b"KinCal chunk 1", m.key_id, m.counter, m.t_us, m.source)
    return _CHUNK.pack(*sender, m.kind, m.total_bytes, m.offset, m.n, bytes(m.data))


# ---- counters


def counting() -> Count:
    """Counters from 1, in memory: for a flight that begins anew with its sender."""
    last: dict[int, int] = {}

    def count(source: int) -> int:
        last[source] = last.get(source, 0) + 1
        return last[source]

    return count


def counters_beside(keys: Path) -> Count:
    """Counters in a file for each source, beside the key file: they outlive the sender, and senders at the
    same time share them. A file that is missing begins at the clock [us], and so above whatever was used
    before it was lost."""

    def count(source: int) -> int:
        path = count_file(keys, source)
        with open_own(path, "the counter cannot be kept") as file:
            lock(file, path, COUNTER_WAIT_S)
            text = file.read(_COUNT_BYTES).strip()
            if text and not (text.isdigit() and int(text) < _COUNT_MAX):
                raise BadInput("this is no counter", str(path), "write the number of the event CMD_REPLAYED")
            counter = int(text or time.time_ns() // 1000) + 1
            try:
                file.seek(0)
                file.write(f"{counter}\n".encode())  # as long as the one before, or longer
                file.truncate()
            except OSError as error:
                raise BadInput(f"the counter cannot be kept: {error.strerror}", str(path), _ROOM) from None
        return counter

    return count


def count_file(keys: Path, source: int) -> Path:
    """Where the counter of a source is kept."""
    return keys.with_name(f"{keys.name}.count{source}")


def lock(file: FileIO, path: Path, wait_s: float, kind: int = fcntl.LOCK_EX) -> None:
    """Lock an open file. BadInput if another program holds it for longer than `wait_s`."""
    until_s = time.monotonic() + wait_s
    while True:
        try:
            fcntl.flock(file, kind | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() > until_s:
                raise BadInput(
                    f"another program has held this file for {wait_s:g} s",
                    str(path),
                    "`fuser` names it: end it if it hangs, then try again",
                ) from None
            time.sleep(_LOCK_POLL_S)
        else:
            return


def open_own(path: Path, what: str, flags: int = 0) -> FileIO:
    """A file of this user to read and write, made for its owner only if it is missing. BadInput, beginning
    with `what`, if it is a link (who may write in the folder could lead it to any file of this user), no
    regular file, or somebody else's."""
    opening = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC | flags
    try:
        file = os.fdopen(os.open(path, opening, 0o600), "r+b", buffering=0)
    except OSError as error:
        why = "this is a symbolic link" if error.errno == errno.ELOOP else str(error.strerror)
        raise BadInput(f"{what}: {why}", str(path), _MEDIUM.get(error.errno or 0, _OWN)) from None
    status = os.fstat(file.fileno())
    if not stat.S_ISREG(status.st_mode) or status.st_uid != os.geteuid():
        file.close()
        raise BadInput(f"{what}: this is no regular file of yours", str(path), _OWN)
    return file


# ---- key file


def file_of(path: Path | None) -> Path:
    """The key file: the given one, else that of $KINCAL_KEYS, else ~/.kincal/keys. BadInput if that names no
    file."""
    named = path or Path(os.environ.get(VARIABLE) or DEFAULT)
    try:
        file = named.expanduser()
    except RuntimeError:
        raise BadInput("no keys: there is no such home folder", str(named), _NAME_KEYS) from None
    if not file.name:
        raise BadInput("no keys: this is a folder", str(named), _NAME_KEYS)
    return file


def signer_of(path: Path) -> Signer:
    """Signs with the first key of a file, counters beside it. BadInput as `read`."""
    known = read(path)
    return Signer(known[0], counters_beside(path), known)


def read(path: Path) -> tuple[Key, ...]:
    """Keys of a file, the one that signs first. BadInput if it is missing, others may read it, or it is no
    key file."""
    try:
        with path.open("rb") as file:
            _check_owner(os.fstat(file.fileno()), path)
            text = file.read(1024)
    except OSError as error:
        raise BadInput(
            f"no keys: {error.strerror}",
            str(path),
            _NAME_KEYS,
        ) from None
    return _parse(text.decode("ascii", "replace"), path)


def _check_owner(status: os.stat_result, path: Path) -> None:
    if status.st_uid != os.geteuid():
        raise BadInput("the keys belong to another user", str(path), "make keys as the user who runs this")
    if status.st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise BadInput("others may read or change the keys", str(path), "`chmod 600`, and make new keys")


def _parse(text: str, path: Path) -> tuple[Key, ...]:
    head, *lines = text.splitlines() or [""]
    if head != _HEAD:
        raise BadInput(f"the first line is not `{_HEAD}`", str(path), "`kincal key new` makes a key file")
    keys = tuple(_key(line, f"{path}, line {n}") for n, line in enumerate(lines, 2))
    if not keys or len(keys) > MOST or len({key.id for key in keys}) < len(keys):
        raise BadInput(f"one to four keys with different numbers are allowed, not {len(keys)}", str(path))
    return keys


def _key(line: str, where: str) -> Key:
    number, _, secret = line.partition(" ")
    good = number.isdecimal() and 0 < int(number) <= _ID_MAX and len(secret) == 2 * _SECRET_BYTES
    if not good or not set(secret) <= set("0123456789abcdef") or not int(secret, 16):
        raise BadInput("a key is a number, a space and 64 hexadecimal digits, not all zero", where)
    return Key(int(number), bytes.fromhex(secret))


def write(path: Path, keys: tuple[Key, ...]) -> None:
    """Write a key file that only its owner may read; whoever finds it finds all of it. BadInput if it is a
    symbolic link, since the file behind it would keep its keys, or if it cannot be written."""
    if path.is_symlink():
        raise BadInput("this key file is a symbolic link", str(path), f"name the file: {path.resolve()}")
    part = path.with_name(path.name + ".part")
    text = "".join(f"{line}\n" for line in (_HEAD, *(f"{key.id} {key.secret.hex()}" for key in keys)))
    try:
        part.unlink(missing_ok=True)
        with open(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        part.rename(path)
    except (FileExistsError, FileNotFoundError):
        if not path.parent.is_dir():
            raise
        raise BadInput(
            "another program writes this key file", str(path), "`kincal key show` says what it holds now"
        ) from None


def new(path: Path, number: int = 0) -> Key:
    """Make a key file with one key. number: of its holder. BadInput if there is a file already."""
    if path.is_dir():
        raise BadInput("this is a folder", str(path), "name a file in it")
    if path.exists():
        raise BadInput("there is a key file already", str(path), "`kincal key rotate` changes its key")
    if not 0 <= number <= _ID_MAX // HOLDER_NUMBERS - 1:
        raise BadInput(f"{number} is no number of a holder", todo="take 0, 1, 2, ...: one for each person")
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    key = Key(number * HOLDER_NUMBERS + 1, secrets.token_bytes(_SECRET_BYTES))
    write(path, (key,))
    return key


def rotate(path: Path) -> Key:
    """Add a key, which does not sign yet. BadInput if there are two already."""
    keys = _of_one_holder(path)
    if len(keys) == _ROTATION:
        raise BadInput("a rotation is under way", str(path), "`kincal key retire` ends it")
    key = Key(keys[-1].id + 1, secrets.token_bytes(_SECRET_BYTES))
    if holder(key.id) != holder(keys[-1].id):
        raise BadInput(
            f"the numbers of this holder end at key {keys[-1].id}",
            str(path),
            "make a file with the number of a new holder: `kincal key new FILE --holder NUMBER`",
        )
    write(path, (*keys, key))
    return key


def retire(path: Path) -> Key:
    """Take the older key out: the newer one signs from now on. Returns the one that is gone. BadInput if
    there is one key only."""
    keys = _of_one_holder(path)
    if len(keys) < _ROTATION:
        raise BadInput("there is no other key", str(path), "`kincal key rotate` adds one")
    write(path, keys[1:])
    return keys[0]


def _of_one_holder(path: Path) -> tuple[Key, ...]:
    """Keys of a file that can be rotated. BadInput if it has the keys of several holders."""
    keys = read(path)
    if len({holder(key.id) for key in keys}) > 1:
        raise BadInput(
            "this file has the keys of several holders",
            str(path),
            "change the file of one holder, then make this one again: `kincal key join`",
        )
    return keys


def join(path: Path, files: Sequence[Path]) -> tuple[Key, ...]:
    """Make or replace a key file for flight, with the keys of several files. BadInput if two keys have the
    same number, or there are too many."""
    keys = tuple(key for file in files for key in read(file))
    if len({key.id for key in keys}) < len(keys):
        raise BadInput("two of the keys have the same number", ", ".join(map(str, files)),
                       "give each holder a number: `kincal key new FILE --holder NUMBER`")  # fmt: skip
    if not 0 < len(keys) <= MOST:
        raise BadInput(f"flight takes one to four keys, these are {len(keys)}", ", ".join(map(str, files)),
                       "`kincal key retire` takes an old one out")  # fmt: skip
    if any(file.resolve() == path.resolve() for file in files):
        raise BadInput("the file of a holder would be replaced", str(path), "name another file")
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    write(path, keys)
    return keys


# ---- simulation


def of_simulation(seed: int) -> Key:
    """The key of a simulated run in lockstep: made from its seed, since such a run has to be repeatable to
    the byte. It protects nothing."""
    return Key(1, hashlib.blake2b(f"simulated run {seed}".encode(), digest_size=_SECRET_BYTES).digest())
