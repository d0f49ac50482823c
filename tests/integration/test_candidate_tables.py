"""Candidate tables that were tampered with, cut short or over-full, sent up over LCM: each is refused with
the event that names the bad entry, and the active one stays in force, to the byte."""

import struct
import tomllib
import zlib

import pytest
from flight import IDLE, ROOT, TABLES, Flight, u32

import kcm
from kincal import core, tables

CMD, SPACE = kcm.cmd_t, 5
GOOD = (TABLES / "space.tbl").read_bytes()
N_FIRST = len(tomllib.loads((ROOT / "tables" / "src" / "space.toml").read_text())["joints"]["first_rad"])
TBL_FORMAT, TBL_CRC, TBL_RANGE, TBL_DEPENDS, NOT_FINITE, NOT_UNIT = 21, 22, 23, 28, 32, 33
HUB, BODY, VOLUME = 2000, 4000, 5000


def sealed(payload: bytes) -> bytes:
    """An image that says of itself what is true: only what is in it is wrong."""
    return struct.pack("<4sHHII", b"KCT1", SPACE, 1, len(payload), zlib.crc32(payload)) + payload


def flipped(bit: int) -> bytes:
    data = bytearray(GOOD)
    data[bit // 8] ^= 1 << bit % 8
    return bytes(data)


def with_fields(values: dict[str, float]) -> bytes:
    """The good table with other contents ("cand.7.hub": 15), as a careless ground would write it."""
    _, s = tables.load(TABLES / "space.tbl")
    for path, value in values.items():
        where, keys = s, [int(k) if k.isdigit() else k for k in path.split(".")]
        for key in keys[:-1]:
            where = where[key] if isinstance(key, int) else getattr(where, key)
        if isinstance(keys[-1], int):
            where[keys[-1]] = value
        else:
            setattr(where, keys[-1], value)
    n, out = core.ffi.new("uint32_t *"), core.ffi.new("uint8_t[]", core.lib.KC_IMAGE_MAX)
    status = core.lib.kc_tbl_encode(SPACE, s, 0, out, core.lib.KC_IMAGE_MAX, n)
    assert status == 0
    return bytes(core.ffi.buffer(out, n[0]))


def overfull() -> bytes:
    """1025 candidates, all of them there: the last one is a good one once more."""
    _, s = tables.load(TABLES / "space.tbl")
    payload = GOOD[16:]
    cand = 3 * 4 + 4 * 4 + int(s.n_joints) * 4 + 2 * 4 + 1 + 1 + 2
    n = int(s.n_cand)
    edges = (n * (n - 1) // 2 + 7) // 8
    tail = 4 + int(s.n_body) * 33 + 4 + int(s.n_volume) * 33
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
    # what: image, event, entry it names
    "a flipped bit in the version": (flipped(8 * 6), TBL_FORMAT, 2),
    "a flipped bit in the size": (flipped(8 * 8 + 2), TBL_FORMAT, 3),
    "a flipped bit in the CRC": (flipped(12 * 8), TBL_CRC, None),
    "a flipped bit in the payload": (flipped(8 * 4000 + 5), TBL_CRC, None),
    "the last byte cut off": (GOOD[:-1], TBL_FORMAT, 3),
    "half of it cut off": (GOOD[: len(GOOD) // 2], TBL_FORMAT, 3),
    "cut off and sealed again": (sealed(GOOD[16:-1]), TBL_FORMAT, 3),
    "a byte too many": (sealed(GOOD[16:] + b"\0"), TBL_FORMAT, 3),
    "1025 candidates": (overfull(), TBL_RANGE, -1),
    "a seed that is no number": (with_fields({"cand.7.q_seed.2": NAN}), NOT_FINITE, 7),
    "a place that is no number": (with_fields({"cand.9.p_m.0": NAN}), NOT_FINITE, 9),
    "a quaternion off the unit norm": (with_fields({"cand.11.q_wxyz.0": 1.5}), NOT_UNIT, 11),
    "a joint beyond its limit": (with_fields({"cand.4.q_seed.1": LIMIT}), TBL_RANGE, 4),
    "a hub beyond its limit": (with_fields({"hub_q.1.1": LIMIT}), TBL_RANGE, HUB + 1),
    "a hub that does not exist": (with_fields({"cand.5.hub": 15}), TBL_RANGE, 5),
    "a hub segment one way only": (with_fields({"hub_edge.0": 0}), TBL_RANGE, HUB),
    "a prior that is no candidate": (with_fields({"prior.1": 1000}), TBL_RANGE, 1),
    "no tag in view": (with_fields({"cand.6.tags": 0}), TBL_RANGE, 6),
    "a leash of nothing": (with_fields({"servo_leash.3": 0.0}), TBL_RANGE, -1),
    "a body on a joint that is not there": (with_fields({"body.2.frame": 8}), TBL_RANGE, BODY + 2),
    "a volume of no kind": (with_fields({"volume.1.kind": 7}), TBL_RANGE, VOLUME + 1),
    "another arm": (with_fields({"arm_crc": 12345}), TBL_DEPENDS, SPACE),
}


def send(f: Flight, image: bytes) -> list:
    """All of it in chunks of a tick each; events."""
    said, step = [], 1024
    for at in range(0, len(image), step):
        m = kcm.table_chunk_t()
        m.t_us, m.kind, m.total_bytes, m.offset = f.now_us, SPACE, len(image), at
        part = image[at : at + step]
        m.n, m.data = len(part), part + bytes(step - len(part))
        f.bus.publish("KC_TABLE_UP", m)
        said += [m for ch, m in f.step() if ch == "KC_EVENT"]
    return said


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


def dumped(f) -> bytes:
    assert f.do(CMD.TABLE_DUMP, SPACE).status == 0
    data = bytearray()
    for _ in range(200):
        for m in [m for ch, m in f.heard if ch == "KC_TABLE_DOWN"]:
            data += m.data[: m.n]
            if m.offset + m.n == m.total_bytes:
                return bytes(data)
        f.step()
    raise AssertionError("no end of the dump")


@pytest.mark.parametrize("what", BAD)
def test_a_bad_candidate_table_is_refused_by_entry_and_the_active_one_stays(flight, what):
    image, event, entry = BAD[what]
    said = send(flight, image)
    ack = flight.do(CMD.TABLE_VALIDATE, SPACE, crc_in(image))
    said += [m for ch, m in flight.heard if ch == "KC_EVENT"]
    assert ack.status < 0, what
    named = [e for e in said if e.id == event]
    assert named, [(e.id, e.index, e.got, e.want) for e in said]
    assert entry is None or named[0].index == entry
    assert flight.do(CMD.TABLE_ACTIVATE, SPACE, crc_in(image)).status < 0
    hk = state(flight)
    assert hk.state == IDLE and u32(hk.table_crc[SPACE]) == u32(crc_in(GOOD))


def test_an_edge_bit_beyond_the_candidates_is_refused(flight):
    """In the last byte, where the number of pairs leaves some over; without first looks, which come last."""
    _, s = tables.load(TABLES / "space.tbl")
    n = int(s.n_cand) - N_FIRST
    priors = [i for i in s.prior[0 : s.n_prior] if i < n]
    bits = n * (n - 1) // 2
    assert bits % 8 != 0
    fewer = {"n_cand": n, "n_prior": len(priors), **{f"prior.{i}": c for i, c in enumerate(priors)}}
    good = with_fields(fewer)
    send(flight, good)
    assert flight.do(CMD.TABLE_VALIDATE, SPACE, crc_in(good)).status == 0
    image = with_fields({**fewer, f"edge.{bits // 8}": 0x80})
    send(flight, image)
    assert flight.do(CMD.TABLE_VALIDATE, SPACE, crc_in(image)).status < 0
    assert [m.index for ch, m in flight.heard if ch == "KC_EVENT" and m.id == TBL_RANGE] == [-1]
    assert u32(state(flight).table_crc[SPACE]) == u32(crc_in(GOOD))


def test_after_all_that_the_active_table_is_the_same_to_the_byte_and_a_good_one_is_taken(flight):
    assert dumped(flight) == GOOD
    other = with_fields({"cand.3.pan_rad": 0.25})
    send(flight, other)
    assert flight.do(CMD.TABLE_VALIDATE, SPACE, crc_in(other)).status == 0
    assert flight.do(CMD.TABLE_ACTIVATE, SPACE, crc_in(other)).status == 0
    assert u32(state(flight).table_crc[SPACE]) == u32(crc_in(other))
