"""Signatures: flight's MAC against hashlib, hashlib against RFC 7693, flight's bytes against the sender's."""

import hashlib
import struct

import numpy as np
import pytest
from builders import ffi, lib

import kcm
from kincal.run import wire
from kincal_shared import keys

KEY = keys.Key(3, bytes(range(32)))


def in_core(key=KEY):
    c = ffi.new("kc_key_t *")
    c.id, c.secret = key.id, list(key.secret)
    return c


def mac_of_core(text):
    mac = ffi.new("uint8_t[16]")
    lib.kc_auth_mac(in_core(), text, mac)
    return bytes(mac)


def command(rng):
    m = kcm.cmd_t()
    m.t_us, m.arg_u64 = (int(x) for x in rng.integers(-(2**63), 2**63, 2))
    m.seq, m.source, m.opcode, *m.arg_i = (int(x) for x in rng.integers(-(2**31), 2**31, 7))
    m.arg_d = [float(x) for x in np.frombuffer(rng.bytes(32), "<f8")]  # any bits: also not numbers
    return m


def chunk(rng):
    m = kcm.table_chunk_t()
    m.t_us = int(rng.integers(-(2**63), 2**63))
    m.source, m.kind, m.total_bytes, m.offset, m.n = (int(x) for x in rng.integers(-(2**31), 2**31, 5))
    m.data = rng.bytes(1024)
    return m


def test_the_oracle_is_blake2b():
    """RFC 7693, appendix A; and its appendix E over lengths and keys, of which this is the sum."""
    abc = hashlib.blake2b(b"abc").hexdigest()
    assert abc.startswith("ba80a53f981c4d0d6a2797b69f12f6e94c212f14685ac4b74b12bb6fdbffa2d1")
    sums = hashlib.blake2b(digest_size=32)
    for size in (20, 32, 48, 64):
        for length in (0, 3, 128, 129, 255, 1024):
            text = sequence(length, length)
            sums.update(hashlib.blake2b(text, digest_size=size).digest())
            sums.update(hashlib.blake2b(text, digest_size=size, key=sequence(size, size)).digest())
    assert sums.hexdigest() == "c23a7800d98123bd10f506c61e29da5603d763b8bbad2e737f5e765a7bccd475"


def sequence(length, seed):
    """selftest_seq() of RFC 7693."""
    a, b, out = (0xDEAD4BAD * seed) & 0xFFFFFFFF, 1, bytearray()
    for _ in range(length):
        a, b = b, (a + b) & 0xFFFFFFFF
        out.append(b >> 24)
    return bytes(out)


def test_the_mac_is_that_of_hashlib_at_every_length():
    rng = np.random.default_rng(1)
    for n in (*range(130), 255, 256, 257, 1128):
        head, body = rng.bytes(n), rng.bytes(int(rng.integers(0, 300)))
        text = ffi.new("kc_auth_text_t *")
        buffers = ffi.from_buffer(head), ffi.from_buffer(body)
        text.head, text.n_head, text.body, text.n_body = buffers[0], len(head), buffers[1], len(body)
        assert mac_of_core(text) == hashlib.blake2b(head + body, key=KEY.secret, digest_size=16).digest()


@pytest.mark.parametrize(
    ("make", "sign", "fill", "signed", "struct_name"),
    [
        (command, "command", wire.fill_cmd, "kc_signed_cmd", "kc_cmd_t"),
        (chunk, "chunk", wire.fill_chunk, "kc_signed_chunk", "kc_table_chunk_t"),
    ],
)
def test_sender_and_flight_sign_the_same_bytes(make, sign, fill, signed, struct_name):
    rng = np.random.default_rng(2)
    for _ in range(200):
        m, counter = make(rng), int(rng.integers(1, 2**63))
        getattr(keys.Signer(KEY, lambda _source, n=counter: n), sign)(m)
        m = type(m).decode(m.encode())  # as it arrives
        s, head = ffi.new(f"{struct_name} *"), ffi.new("uint8_t[104]")
        fill(wire.place(s), m)
        text = ffi.new("kc_auth_text_t *", getattr(lib, signed)(s, head))
        assert mac_of_core(text) == struct.pack("<2q", *m.mac) == bytes(s.auth.mac)
