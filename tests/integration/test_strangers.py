"""Strangers on the network of the flight process: what they send changes nothing."""

import copy
import subprocess

import lcm
import pytest
from flight import BINARY, EVENT, IDLE, TABLE, TABLES, Flight

import kcm
from kincal import keys
from kincal_sim.ports import private_port, private_url
from kincal_sim.recorder import Recorder

CMD = kcm.cmd_t
SIGNED = [CMD.START, CMD.APPROVE_ARM, CMD.APPROVE_GO, CMD.REJECT, CMD.ROLLBACK, CMD.TABLE_VALIDATE,
          CMD.TABLE_ACTIVATE, CMD.TABLE_DISCARD]  # fmt: skip


@pytest.fixture
def flight(tmp_path):
    with Flight(tmp_path / "store", "healthy") as f:
        f.start()
        f.step()
        yield f


def command(f, opcode=CMD.START, *args, source=2):
    m = CMD()
    f.seq += 1
    m.t_us, m.seq, m.source, m.opcode = f.now_us, f.seq, source, opcode
    m.arg_i = [*args, 0, 0, 0, 0][:4]
    return m


def send(f, m, channel="KC_CMD"):
    """Send bytes or a message, and step until there is housekeeping: events and answers up to then."""
    f.bus.lcm.publish(channel, m if isinstance(m, bytes) else m.encode())
    heard = []
    for _ in range(11):
        heard += f.step()
    events = [e.id for ch, e in heard if ch == "KC_EVENT"]
    hk = [h for ch, h in heard if ch == "KC_HK"][-1]
    return events, [a for ch, a in heard if ch == "KC_ACK"], hk


def test_commands_without_a_signature_are_refused(flight):
    for opcode in SIGNED:
        events, (ack,), hk = send(flight, command(flight, opcode))
        assert events == [EVENT["CMD_UNSIGNED"]] and ack.status == -13 and hk.state == IDLE


def test_commands_of_a_wrong_key_are_refused(flight):
    own = flight.signer.key
    for key, why in (
        (keys.Key(own.id, bytes(31) + b"\1"), "CMD_FORGED"),
        (keys.Key(own.id + 1, own.secret), "CMD_KEY"),
    ):
        stranger = keys.Signer(key, flight.signer.count)
        events, (ack,), hk = send(flight, stranger.command(command(flight)))
        assert events == [EVENT[why]] and ack.event_id == EVENT[why] and hk.state == IDLE


def test_a_signed_command_that_was_changed_or_cut_off_is_refused(flight):
    """A bit of every byte of the packet, and packets of every length. Those that are no
    message any more are only counted. The time stamp decides when a message is due: its bits are flipped in
    tests/unit/test_kc_signed.c."""
    whole = flight.signer.command(command(flight)).encode()
    hk_before = flight.until("KC_HK")
    sent = 0
    for at in [*range(8), *range(16, len(whole))]:
        changed = bytearray(whole)
        changed[at] ^= 1 << at % 8
        flight.bus.lcm.publish("KC_CMD", bytes(changed))
        flight.step()
        assert not [a for ch, a in flight.heard if ch == "KC_ACK" and a.status == 0], at
        sent += 1
    for n in range(len(whole)):
        flight.bus.lcm.publish("KC_CMD", whole[:n])
        sent += 1
    hk = flight.until("KC_HK")
    bad = hk.n_rx_errors - hk_before.n_rx_errors, hk.n_cmd_refused - hk_before.n_cmd_refused
    assert hk.state == IDLE and sum(bad) == sent and min(bad) > 50
    _, (ack,), _ = send(flight, whole)
    assert ack.status == 0


def test_what_was_recorded_is_refused_when_it_is_played_again_also_after_a_restart(flight):
    """Everything that a ground sent to put a table in force, and a START."""
    image = (TABLES / "config.tbl").read_bytes()
    crc = int.from_bytes(image[12:16], "little", signed=True)
    chunk = kcm.table_chunk_t()
    chunk.t_us, chunk.source, chunk.kind = flight.now_us, 2, TABLE["CONFIG"]
    chunk.total_bytes, chunk.n, chunk.data = len(image), len(image), image.ljust(1024, b"\0")
    recorded = [("KC_TABLE_UP", flight.signer.chunk(chunk).encode())]
    for opcode, *args in (
        (CMD.TABLE_VALIDATE, TABLE["CONFIG"], crc),
        (CMD.TABLE_ACTIVATE, TABLE["CONFIG"], crc),
        (CMD.START, -1, 4, 1),
    ):
        recorded.append(("KC_CMD", flight.signer.command(command(flight, opcode, *args)).encode()))
    for channel, data in recorded:
        _, acks, _ = send(flight, data, channel)
        assert [a.status for a in acks] == [0] * (channel == "KC_CMD")
    flight.do(CMD.ABORT)

    def play_again():
        for channel, data in recorded:
            events, acks, hk = send(flight, data, channel)
            assert events.count(EVENT["CMD_REPLAYED"]) == 1
            assert hk.staged_bytes == 0 and hk.state == 11  # SAFE, after ABORT
            assert all(a.status < 0 for a in acks)

    play_again()
    flight.kill()
    flight.start()
    flight.step()
    play_again()
    assert flight.do(CMD.START, -1, 4, 1).status == 0


def test_a_command_on_the_channel_of_tables_is_no_message(flight):
    signed = flight.signer.command(command(flight)).encode()
    before = flight.until("KC_HK").n_rx_errors
    events, acks, hk = send(flight, signed, "KC_TABLE_UP")
    assert (events, acks, hk.n_rx_errors) == ([], [], before + 1)


def test_a_later_command_overtakes_an_earlier_one(flight):
    first = flight.signer.command(command(flight, CMD.TABLE_DISCARD))
    second = flight.signer.command(command(flight, CMD.TABLE_DISCARD))
    _, (ack,), _ = send(flight, second)
    assert ack.status == 0
    events, (ack,), _ = send(flight, first)
    assert events == [EVENT["CMD_REPLAYED"]] and ack.status == -9


def test_keys_are_rotated_with_a_restart_of_flight(flight):
    old = copy.copy(flight.signer)
    keys.rotate(flight.keys)
    flight.kill()
    flight.start()
    flight.step()
    assert flight.do(CMD.TABLE_DISCARD).status == 0  # the old key, with the new file
    keys.retire(flight.keys)
    flight.signer = keys.signer_of(flight.keys)
    assert flight.do(CMD.TABLE_DISCARD).status == 0  # the new key
    flight.kill()
    flight.start()
    flight.step()
    events, (ack,), _ = send(flight, old.command(command(flight, CMD.TABLE_DISCARD)))
    assert events == [EVENT["CMD_KEY"]] and ack.status == -13


def test_a_process_without_keys_says_so_and_can_only_be_stopped(tmp_path, monkeypatch):
    monkeypatch.delenv(keys.VARIABLE, raising=False)
    with Flight(tmp_path / "store", "healthy") as f:
        command_line = [BINARY, "--url", f.url, "--tables", TABLES, "--store", f.store]
        with f.stderr.open("wb") as err:
            f.process = subprocess.Popen(command_line, stderr=err)
        assert f.wait_done(0)
        events, _ = f.first_telemetry()
        assert EVENT["BOOT_NO_KEYS"] in [e.id for e in events]
        assert f.do(CMD.START, -1, 4, 1).event_id == EVENT["CMD_KEY"]
        assert f.do(CMD.ABORT).status == 0
        assert "no --keys" in f.stderr.read_text()


@pytest.mark.parametrize(
    ("text", "mode", "why"),
    [
        ("kincal-keys 1\n1 " + "0a" * 32 + "\n", 0o644, "others may read or change it"),
        ("kincal-keys 1\n1 0a0a\n", 0o600, "64 hexadecimal digits"),
        ("kincal-keys 9\n", 0o600, "kincal-keys 1"),
        (None, 0, "No such file"),
    ],
)
def test_a_process_does_not_start_with_bad_keys(tmp_path, text, mode, why):
    path = tmp_path / "keys"
    if text is not None:
        path.write_text(text)
        path.chmod(mode)
    arguments = ["--tables", TABLES, "--store", tmp_path / "store", "--keys", path]
    r = subprocess.run([BINARY, *arguments], capture_output=True, text=True, timeout=20)
    assert r.returncode == 2 and why in r.stderr and str(path) in r.stderr


def test_a_packet_that_is_no_time_does_not_end_the_log(tmp_path):
    port, lock = private_port()
    bus = lcm.LCM(private_url(port))
    recorder = Recorder(private_url(port), tmp_path / "run.lcmlog", images=False)
    recorder.start()
    t = kcm.time_t()
    t.tick, t.now_us = 1, 100_000
    for packet in (b"", b"rubbish", t.encode()[:12], t.encode()):
        bus.publish("KC_TIME", packet)
    bus.publish("KC_HK", b"after it")
    recorder.close()
    lock.close()
    log = [(e.timestamp, e.channel) for e in lcm.EventLog(str(tmp_path / "run.lcmlog"), "r")]
    assert log[-2:] == [(100_000, "KC_TIME"), (100_000, "KC_HK")] and len(log) == 5
    assert recorder.n_rx_errors == 3
