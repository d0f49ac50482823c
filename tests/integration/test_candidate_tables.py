"""Candidate tables that are damaged, cut short or too long, uplinked over LCM: each is refused with the event
that names the bad entry, and the active one stays in force, to the byte."""

import struct
import tomllib
import zlib

import pytest
from flight import CORE, EVENT, IDLE, ROOT, TABLE, TABLES, Flight, read_table, u32

import kcm
from kincal.flight import tables as codec

CMD, SPACE = kcm.cmd_t, TABLE["SPACE"]
GOOD = (TABLES / "space.tbl").read_bytes()
N_LOCAL = len(
    tomllib.loads((ROOT / "tables" / "src" / "space.toml").read_text())["joints"]["local_initial_rad"]
)
HUB, INITIAL, BODY, VOLUME = (
    CORE.constant(f"KC_SPACE_INDEX_{name}") for name in ("HUB", "INITIAL", "BODY", "VOLUME")
)


def sealed(payload: bytes) -> bytes:
    """An image whose header fits its payload: only the contents are wrong."""
    version = CORE.lib.kc_layout_version(SPACE)
    return struct.pack("<4sHHII", b"KCT1", SPACE, version, len(payload), zlib.crc32(payload)) + payload


def flipped(bit: int) -> bytes:
    data = bytearray(GOOD)
    data[bit // 8] ^= 1 << bit % 8
    return bytes(data)


def with_fields(values: dict[str, float]) -> bytes:
    """The good table with other contents ("cand.7.hub": 15), as a ground with an error would write it."""
    s = read_table("space")
    for path, value in values.items():
        where, keys = s, [int(k) if k.isdigit() else k for k in path.split(".")]
        for key in keys[:-1]:
            where = where[key] if isinstance(key, int) else getattr(where, key)
        if isinstance(keys[-1], int):
            where[keys[-1]] = value
        else:
            setattr(where, keys[-1], value)
    return codec.encode("space", s).data


def too_many() -> bytes:
    """1025 candidates, all of them good: the first one is repeated."""
    s = read_table("space")
    payload = GOOD[16:]
    cand = 3 * 4 + 4 * 4 + int(s.n_joints) * 4 + 2 * 4 + 1 + 1 + 2
    n = int(s.n_cand)
    edges = (n * (n - 1) // 2 + 7) // 8
    tail = 4 + int(s.n_body) * 33 + 4 + int(s.n_volume) * 33 + int(s.n_joints) * 4 * 8
    head = len(payload) - tail - edges - n * cand
    first = payload[head : head + cand]
    many = 1025
    return sealed(
        struct.pack("<I", many)
        + payload[4:head]
        + first * many
        + bytes((many * (many - 1) // 2 + 7) // 8)
        + payload[len(payload) - tail :]
    )


NAN = float("nan")
LIMIT = 2.1  # rad, beyond what joint 2 can do
BAD = {
    # defect: image, event, entry that it names
    "a flipped bit in the version": (flipped(8 * 6), "TBL_FORMAT", 2),
    "a flipped bit in the size": (flipped(8 * 8 + 2), "TBL_FORMAT", 3),
    "a flipped bit in the CRC": (flipped(12 * 8), "TBL_CRC", None),
    "a flipped bit in the payload": (flipped(8 * 4000 + 5), "TBL_CRC", None),
    "the last byte cut off": (GOOD[:-1], "TBL_FORMAT", 3),
    "half of it cut off": (GOOD[: len(GOOD) // 2], "TBL_FORMAT", 3),
    "cut off and sealed again": (sealed(GOOD[16:-1]), "TBL_FORMAT", 3),
    "a byte too many": (sealed(GOOD[16:] + b"\0"), "TBL_FORMAT", 3),
    "1025 candidates": (too_many(), "TBL_RANGE", -1),
    "a seed that is no number": (with_fields({"cand.7.q_seed.2": NAN}), "TBL_NOT_FINITE", 7),
    "a position that is no number": (with_fields({"cand.9.p_m.0": NAN}), "TBL_NOT_FINITE", 9),
    "a quaternion off the unit norm": (with_fields({"cand.11.q_wxyz.0": 1.5}), "TBL_NOT_UNIT", 11),
    "a joint beyond its limit": (with_fields({"cand.4.q_seed.1": LIMIT}), "TBL_RANGE", 4),
    "a hub beyond its limit": (with_fields({"hub_q.1.1": LIMIT}), "TBL_RANGE", HUB + 1),
    "a hub that does not exist": (with_fields({"cand.5.hub": 15}), "TBL_RANGE", 5),
    "a hub segment in one direction only": (with_fields({"hub_edge.0": 0}), "TBL_RANGE", HUB),
    "an initial pose that is no candidate": (with_fields({"initial.1": 1000}), "TBL_RANGE", 1),
    "no tag in view": (with_fields({"cand.6.tags": 0}), "TBL_RANGE", 6),
    "a servo bound of zero": (with_fields({"servo_bound.3": 0.0}), "TBL_RANGE", -1),
    "a body on a joint that is not there": (with_fields({"body.2.frame": 8}), "TBL_RANGE", BODY + 2),
    "stops out of order": (with_fields({"stop.8.0": 200, "stop.8.1": 100}), "TBL_RANGE", 8),
    "a stop of a local initial pose": (with_fields({"stop.300.0": 100}), "TBL_RANGE", 300),
    "a volume of no kind": (with_fields({"volume.1.kind": 7}), "TBL_RANGE", VOLUME + 1),
    "another arm": (with_fields({"arm_crc": 12345}), "TBL_DEPENDS", SPACE),
}


def send(f: Flight, image: bytes) -> list:
    """Uplink an image, one chunk a tick; the events."""
    events, step = [], 1024
    for at in range(0, len(image), step):
        m = kcm.table_chunk_t()
        m.t_us, m.source, m.kind, m.total_bytes, m.offset = f.now_us, 2, SPACE, len(image), at
        part = image[at : at + step]
        m.n, m.data = len(part), part + bytes(step - len(part))
        f.bus.publish("KC_TABLE_UP", f.signer.chunk(m))
        events += [m for ch, m in f.step() if ch == "KC_EVENT"]
    return events


def crc_in(image: bytes) -> int:
    return struct.unpack_from("<i", image, 12)[0]


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    with Flight(tmp_path_factory.mktemp("tables") / "store", "healthy") as f:
        f.start()
        f.step()
        yield f


def state(f):
    return f.until("KC_HK", 20)


def dump(f) -> bytes:
    assert f.do(CMD.TABLE_DUMP, SPACE).status == 0
    data = bytearray()
    for _ in range(200):
        for m in [m for ch, m in f.heard if ch == "KC_TABLE_DOWN"]:
            data += m.data[: m.n]
            if m.offset + m.n == m.total_bytes:
                return bytes(data)
        f.step()
    raise AssertionError("no end of the dump")


@pytest.mark.parametrize("defect", BAD)
def test_a_bad_candidate_table_is_refused_by_entry_and_the_active_one_stays(flight, defect):
    image, event, entry = BAD[defect]
    events = send(flight, image)
    ack = flight.do(CMD.TABLE_VALIDATE, SPACE, crc_in(image))
    events += [m for ch, m in flight.heard if ch == "KC_EVENT"]
    assert ack.status < 0, defect
    named = [e for e in events if e.id == EVENT[event]]
    assert named, [(e.id, e.index, e.got, e.want) for e in events]
    assert entry is None or named[0].index == entry
    assert flight.do(CMD.TABLE_ACTIVATE, SPACE, crc_in(image)).status < 0
    hk = state(flight)
    assert hk.state == IDLE and u32(hk.table_crc[SPACE]) == u32(crc_in(GOOD))


def test_an_edge_bit_beyond_the_candidates_is_refused(flight):
    """In the last byte, which the pairs do not fill; without local initial poses, which come last."""
    s = read_table("space")
    n = int(s.n_cand) - N_LOCAL
    initial = [i for i in s.initial[0 : s.n_initial] if i < n]
    bits = n * (n - 1) // 2
    assert bits % 8 != 0
    fewer = {"n_cand": n, "n_initial": len(initial), **{f"initial.{i}": c for i, c in enumerate(initial)}}
    good = with_fields(fewer)
    send(flight, good)
    assert flight.do(CMD.TABLE_VALIDATE, SPACE, crc_in(good)).status == 0
    image = with_fields({**fewer, f"edge.{bits // 8}": 0x80})
    send(flight, image)
    assert flight.do(CMD.TABLE_VALIDATE, SPACE, crc_in(image)).status < 0
    assert [m.index for ch, m in flight.heard if ch == "KC_EVENT" and m.id == EVENT["TBL_RANGE"]] == [-1]
    assert u32(state(flight).table_crc[SPACE]) == u32(crc_in(GOOD))


def test_after_all_refusals_the_active_table_has_the_same_bytes_and_a_good_one_is_accepted(flight):
    assert dump(flight) == GOOD
    other = with_fields({"cand.3.pan_rad": 0.25})
    send(flight, other)
    assert flight.do(CMD.TABLE_VALIDATE, SPACE, crc_in(other)).status == 0
    assert flight.do(CMD.TABLE_ACTIVATE, SPACE, crc_in(other)).status == 0
    assert u32(state(flight).table_crc[SPACE]) == u32(crc_in(other))
