"""docs/TABLES.md against the flight codec: this page alone is enough to read and write images, its limits are
the ones that flight enforces, and its field numbers are the ones in events."""

import re
import struct
import zlib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from builders import ffi, lib, view
from conftest import ROOT

from kincal.flight import status_name

KINDS = {"arm": 1, "camera": 2, "terms": 3, "kin": 4, "space": 5, "kernel": 6, "config": 7}
CODES = {"u8": "B", "u16": "H", "u32": "I", "u64": "Q", "i32": "i", "f64": "d", "f32": "f"}


@dataclass
class Row:
    number: int
    name: str
    type: str
    count: str  # "1", a number or the name of a count
    limits: tuple | None
    note: str


@dataclass
class Repeat:
    count: str
    array: str
    rows: list = field(default_factory=list)


def layouts():
    """Section of each kind in the page -> rows and repeats."""
    text = (ROOT / "docs" / "TABLES.md").read_text()
    out = {}
    for number, _, body in re.findall(r"^### (\d) (\w+)\n(.*?)(?=^##|\Z)", text, re.S | re.M):
        stack = [[]]
        for line in body.splitlines():
            cells = [c.strip() for c in line.strip("|").split("|")]
            if not line.startswith("|") or cells[0] in ("field", "---:"):
                continue
            if cells[1].startswith("repeat "):
                rep = Repeat(cells[1][7:], cells[4].strip("`"))
                stack[-1].append(rep)
                stack.append(rep.rows)
            elif cells[1] == "end":
                stack.pop()
            else:
                kind, count = re.fullmatch(r"([a-z0-9]+)(?:\[(\w+)\])?", cells[2]).groups()
                limits = tuple(cells[3].split(" .. ")) if cells[3] else None
                stack[-1].append(Row(int(cells[0]), cells[1], kind, count or "1", limits, cells[4]))
        out[int(number)] = stack[0]
    return out


LAYOUTS = layouts()


class Reader:
    """Payload by the page: values by path, and where each field stands first."""

    def __init__(self, kind, payload):
        self.payload, self.at, self.values, self.first = payload, 0, {}, {}
        self.counts = {}
        self.rows(LAYOUTS[kind], "")

    def number(self, text):
        if text.isdigit():
            return int(text)
        if text == "n_edge":
            n = self.counts["n_cand"]
            return (n * (n - 1) // 2 + 7) // 8
        return self.counts[text]

    def take(self, code):
        size = struct.calcsize("<" + code)
        (value,) = struct.unpack_from("<" + code, self.payload, self.at)
        self.at += size
        return value

    def rows(self, rows, where):
        for row in rows:
            if isinstance(row, Repeat):
                for i in range(self.number(row.count)):
                    self.rows(row.rows, f"{where}{row.array}[{i}]." if row.array else f"{where}[{i}]")
            else:
                self.one(row, where)

    def one(self, row, where):
        self.first.setdefault(row.number, (self.at, row))
        # `value[3]`, but `joint[3].a_m`
        path = f"{row.name}{where}" if where.startswith("[") else f"{where}{row.name}"
        if row.type == "char":
            self.values[path] = self.payload[self.at : self.at + 24].rstrip(b"\0").decode()
            self.at += 24
            return
        quat = {"quat": ("d", 4), "quatf": ("f", 4)}
        code, n = quat.get(row.type) or (CODES[row.type], self.number(row.count))
        values = [self.take(code) for _ in range(n)]
        scalar = row.count == "1" and not row.type.startswith("quat")
        self.values[path] = values[0] if scalar else values
        if scalar and row.name.startswith("n_"):
            self.counts[row.name] = values[0]


def image_of(kind):
    """The image as shipped; CONFIG with values in its last fields that are not the standard ones, which an
    image leaves out."""
    data = (ROOT / "tables" / "bin" / f"{kind}.tbl").read_bytes()
    return sealed(kind, data[16:] + struct.pack("<2dB", 0.02, 0.5, 1)) if kind == "config" else data


def version_of(kind):
    """Layout version, as the page says."""
    text = (ROOT / "docs" / "TABLES.md").read_text()
    second = re.search(r"version is that of the kind's layout: 2 for ([\w\s,]+), 1 for the others", text)[1]
    return 2 if kind.upper() in re.findall(r"[A-Z]+", second) else 1


def sealed(kind, payload):
    version = version_of(kind)
    return struct.pack("<4sHHII", b"KCT1", KINDS[kind], version, len(payload), zlib.crc32(payload)) + payload


STRUCTS = {
    "arm": "kc_arm_t *",
    "camera": "kc_camera_t *",
    "terms": "kc_terms_t *",
    "kin": "kc_kin_t *",
    "space": "kc_space_t *",
    "kernel": "kc_kernel_t *",
    "config": "kc_config_t *",
}


def decode(kind, image):
    """Status, struct, events as (id, index, got, want)."""
    out, events = ffi.new(STRUCTS[kind]), ffi.new("kc_events_t *")
    status = lib.kc_tbl_decode(KINDS[kind], image, len(image), out, events)
    return status, out, [(e.id, e.index, e.got, e.want) for e in events.e[0 : events.n]]


def in_struct(s, path):
    for part in re.findall(r"\w+|\[\d+\]", path):
        s = s[int(part[1:-1])] if part.startswith("[") else getattr(s, part)
    return s


def test_every_kind_is_on_the_page():
    assert sorted(LAYOUTS) == sorted(KINDS.values())
    for rows in LAYOUTS.values():
        flat = []

        def walk(rows, flat=flat):
            for r in rows:
                walk(r.rows) if isinstance(r, Repeat) else flat.append(r.number)

        walk(rows)
        assert sorted(flat) == list(range(1, len(flat) + 1))  # newer ones stand where they belong


@pytest.mark.parametrize("kind", KINDS)
def test_header_is_as_documented(kind):
    image = image_of(kind)
    payload = image[16:]
    assert image == sealed(kind, payload)
    assert lib.kc_tbl_image_crc(image, len(image)) == zlib.crc32(payload)


@pytest.mark.parametrize("kind", KINDS)
def test_the_page_reads_what_flight_reads(kind):
    image = image_of(kind)
    read = Reader(KINDS[kind], image[16:])
    assert read.at == len(image) - 16
    status, s, events = decode(kind, image)
    assert status == 0 and not events
    assert len(read.values) > 5
    for path, value in read.values.items():
        flown = in_struct(s, path)
        if isinstance(value, str):
            assert ffi.string(flown).decode() == value
        elif isinstance(value, list):
            assert list(flown[0 : len(value)]) == value, path
        else:
            assert flown == value, path


def limits_of(row):
    cast = float if row.type[0] == "f" else int
    return cast(row.limits[0]), cast(row.limits[1])


def representable(value, code):
    try:
        return struct.unpack("<" + code, struct.pack("<" + code, value))[0]
    except (struct.error, OverflowError):
        return None


def beyond(row):
    """Values just outside the limits, as the field can hold them."""
    lo, hi = limits_of(row)
    if row.type[0] == "f":
        step = np.float64 if row.type == "f64" else np.float32
        cut = [np.nextafter(step(lo), step(-np.inf)), np.nextafter(step(hi), step(np.inf))]
        # a limit that single precision can't hold is rounded to one side of it
        return [float(v) for v in cut if not lo <= float(v) <= hi]
    return [v for v in (lo - 1, hi + 1) if representable(v, CODES[row.type]) is not None]


def fields():
    for kind in KINDS:
        for number, (at, row) in sorted(Reader(KINDS[kind], image_of(kind)[16:]).first.items()):
            yield pytest.param(kind, number, at, row, id=f"{kind}-{number}-{row.name}")


def spoiled(kind, at, row, value):
    payload = bytearray(image_of(kind)[16:])
    struct.pack_into("<" + CODES[row.type], payload, at, value)
    return sealed(kind, bytes(payload))


@pytest.mark.parametrize(("kind", "number", "at", "row"), list(fields()))
def test_limits_on_the_page_are_those_of_flight(kind, number, at, row):
    if row.type in ("char", "quat", "quatf") or row.limits is None:
        return
    for value in beyond(row):
        status, _, events = decode(kind, spoiled(kind, at, row, value))
        assert status_name(status) == "KC_ERR_RANGE"
        assert (events[0][0], events[0][2], events[0][3]) == (lib.KC_EVT_TBL_RANGE, value, number)
        assert events[1][0] == lib.KC_EVT_TBL_BAD_TOTAL and events[1][2] >= 1
    if row.type[0] == "f":
        status, _, events = decode(kind, spoiled(kind, at, row, float("nan")))
        assert status_name(status) == "KC_ERR_RANGE"
        assert events[0][0] == lib.KC_EVT_TBL_NOT_FINITE and events[0][3] == number
    if row.note == "" and row.name[:2] != "n_":
        lo, hi = limits_of(row)
        for value in (representable(v, CODES[row.type]) for v in (lo, hi)):
            if not lo <= value <= hi:
                continue  # single precision rounds this limit outward
            _, _, events = decode(kind, spoiled(kind, at, row, value))
            assert not [e for e in events if (e[0], e[2], e[3]) == (lib.KC_EVT_TBL_RANGE, value, number)]


@pytest.mark.parametrize(
    ("kind", "number", "at", "row"), [p for p in fields() if p.values[3].type.startswith("quat")]
)
def test_quaternions_must_have_unit_norm(kind, number, at, row):
    payload = bytearray(image_of(kind)[16:])
    code = "<4d" if row.type == "quat" else "<4f"
    q = np.array(struct.unpack_from(code, payload, at))
    for stretch, ok in ((1 + 5e-7, True), (1 + 2e-6, False), (1 - 2e-6, False), (0.0, False)):
        struct.pack_into(code, payload, at, *(q * stretch))
        status, _, events = decode(kind, sealed(kind, bytes(payload)))
        refused = [e for e in events if e[0] == lib.KC_EVT_TBL_NOT_UNIT]
        assert (status == 0) == ok
        assert bool(refused) != ok
        if not ok:
            assert refused[0][3] == number


def test_a_table_written_from_the_page_flies():
    """KIN by hand: the page's order of fields, nothing else."""
    value, sigma = np.linspace(-0.2, 0.2, 28), np.full(28, 1e-3)
    payload = struct.pack("<I", 28)
    for v, s in zip(value, sigma, strict=True):
        payload += struct.pack("<dd", v, s)
    payload += struct.pack("<IIIIIQ", 0x11111111, 0x22222222, 0x33333333, 7, 20, 1234567890123)
    status, kin, events = decode("kin", sealed("kin", payload))
    assert status == 0 and not events
    assert np.array_equal(view(kin.value)[:28], value)
    assert (kin.arm_crc, kin.terms_crc, kin.prev_crc) == (0x11111111, 0x22222222, 0x33333333)
    assert (kin.session, kin.n_poses, kin.made_us) == (7, 20, 1234567890123)


def test_no_damaged_image_is_taken():
    """Random bytes, cuts and splices: refused with an event, never a crash."""
    rng = np.random.default_rng(11)
    for kind in KINDS:
        image = image_of(kind)
        for _ in range(60):
            bad = bytearray(image)
            for _ in range(rng.integers(1, 6)):
                bad[rng.integers(len(bad))] ^= 1 << rng.integers(8)
            if rng.random() < 0.5:
                bad = bad[: rng.integers(len(bad))]
            if bytes(bad) == image:
                continue
            status, _, events = decode(kind, bytes(bad))
            assert status != 0 and events
        for _ in range(60):  # right CRC, wrong content: whatever the answer, it must be consistent
            payload = bytearray(image[16:])
            for _ in range(rng.integers(1, 6)):
                payload[rng.integers(len(payload))] = rng.integers(256)
            status, _, events = decode(kind, sealed(kind, bytes(payload)))
            assert (status == 0) == (not events)


def test_the_page_states_the_size_of_the_buffer():
    limits = (ROOT / "fsw/math/kc_limits.h").read_text()
    kib = int(re.search(r"KC_IMAGE_MAX \((\d+)u \* 1024u\)", limits)[1])
    assert f"At most {kib * 1024} bytes" in Path(ROOT / "docs/TABLES.md").read_text()
