"""What flight keeps through power loss, for flight in this process: the slots that fsw/lcm/kc_files.c writes.

Each kind has two slots; the older one is overwritten. A slot is a header (magic, kind, number, length, CRC)
and the data. A test compares the files with those of the flight process, byte for byte.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

from kincal_shared.keys import counting

_MAGIC = b"KCS1"
_HEADER = struct.Struct("<4sHxxQI")  # magic, kind, number, bytes of data; then the CRC of it all
_CRC = struct.Struct("<I")
_HEADER_BYTES = _HEADER.size + _CRC.size
SLOTS = "ab"


class Store:
    """Slots by (kind, "a" or "b"), whole as in files; in memory, and in a folder if one is given.

    slots may be changed between steps, as a broken memory would. count: counters of those who sign commands
    to this flight; like the store they outlive a run."""

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder
        self.slots: dict[tuple[int, str], bytes] = {}
        self._numbers: dict[tuple[int, str], tuple[bytes, int]] = {}  # slots that were read
        self.count = counting()
        for path in sorted(folder.glob("k??.[ab]")) if folder else ():
            self.slots[int(path.stem[1:]), path.suffix[1:]] = path.read_bytes()

    def offered(self, kind: int) -> list[bytes]:
        """What flight is offered at its start: nothing (empty) for each slot that is damaged, then the data
        of the good ones, newest first."""
        there = [slot for slot in SLOTS if (kind, slot) in self.slots]
        good = [slot for slot in there if self._number(kind, slot)]
        good.sort(key=lambda slot: (-self._number(kind, slot), slot))
        return [b""] * (len(there) - len(good)) + [self.slots[kind, slot][_HEADER_BYTES:] for slot in good]

    def keep(self, kind: int, data: bytes) -> None:
        """Write the older slot of the kind, unless the newest holds the same; no data: delete both."""
        if not data:
            for slot in SLOTS:
                self._put(kind, slot, None)
            return
        a, b = self._number(kind, "a"), self._number(kind, "b")
        slot, newest, last = ("b", "a", a) if b < a else ("a", "b", b)
        if last and self.slots[kind, newest][_HEADER_BYTES:] == data:
            return
        number = last + 1
        header = _HEADER.pack(_MAGIC, kind, number, len(data))
        whole = header + _CRC.pack(zlib.crc32(data, zlib.crc32(header))) + data
        self._put(kind, slot, whole)
        self._numbers[kind, slot] = whole, number

    def _number(self, kind: int, slot: str) -> int:
        """Number of a good slot, 0 if there is none or anything about it is wrong."""
        whole = self.slots.get((kind, slot), b"")
        read, number = self._numbers.get((kind, slot), (None, 0))
        if read is not whole:
            number = self._number_in(kind, whole)
            self._numbers[kind, slot] = whole, number
        return number

    @staticmethod
    def _number_in(kind: int, whole: bytes) -> int:
        if len(whole) < _HEADER_BYTES:
            return 0
        magic, its_kind, number, n = _HEADER.unpack_from(whole)
        crc = zlib.crc32(whole[: _HEADER.size] + whole[_HEADER_BYTES:])
        good = (magic, its_kind, n) == (_MAGIC, kind, len(whole) - _HEADER_BYTES)
        return int(number) if good and (crc,) == _CRC.unpack_from(whole, _HEADER.size) else 0

    def _put(self, kind: int, slot: str, whole: bytes | None) -> None:
        path = self.folder / f"k{kind:02d}.{slot}" if self.folder else None
        if whole is None:
            self.slots.pop((kind, slot), None)
            if path:
                path.unlink(missing_ok=True)
            return
        self.slots[kind, slot] = whole
        if path:
            path.write_bytes(whole)
