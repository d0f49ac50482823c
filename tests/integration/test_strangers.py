"""Strangers on the network of the flight process: what they send changes nothing."""

import copy
import subprocess

import lcm
import pytest
from flight import BINARY, EVENT, IDLE, TABLE, TABLES, Flight

import kcm
from kincal_shared import keys
from kincal_sim.ports import private_port, private_url
from kincal_sim.recorder import Recorder

CMD = kcm.cmd_t
SIGNED = [CMD.START, CMD.APPROVE_ARM, CMD.APPROVE_GO, CMD.REJECT, CMD.ROLLBACK, CMD.TABLE_VALIDATE,
          CMD.TABLE_ACTIVATE, CMD.TABLE_DISCARD, CMD.TABLE_DUMP]  # fmt: skip
SAFE = 11
TICKS_A_DAY = 864_000
JOURNAL = 18  # number of its files in the store


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
    tests/system/test_signed.c."""
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
            assert hk.staged_bytes == 0 and hk.state == SAFE  # after ABORT
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


# ---- who crowds out whom


def forged(f, opcode, counter):
    """With the right key's number and a MAC of zeros."""
    m = command(f, opcode)
    m.key_id, m.counter = f.signer.key.id, counter
    return m


@pytest.mark.parametrize("source", [1, 2])
def test_commands_get_through_a_flood_in_their_name(flight, source):
    """In each of ten steps: 8 unsigned ones before the command, as many as once filled the quota of the
    source that they name; 50 forged ones; and 8 copies of the command itself."""
    for k in range(10):
        for _ in range(8):
            flight.bus.publish("KC_CMD", command(flight, CMD.NOOP, source=source))
        for i in range(50):
            m = forged(flight, CMD.REJECT, 2**40 + i)
            m.source = source
            flight.bus.publish("KC_CMD", m)
        own = flight.signer.command(command(flight, CMD.TABLE_DISCARD, source=source))
        for _ in range(9):
            flight.bus.publish("KC_CMD", own)
        other = flight.signer.command(command(flight, CMD.TABLE_DISCARD, source=source))
        flight.bus.publish("KC_CMD", other)
        heard = flight.step()
        acks = {m.seq: m.status for ch, m in heard if ch == "KC_ACK" and m.opcode == CMD.TABLE_DISCARD}
        assert (acks[own.seq], acks[other.seq]) == (0, 0), k


def test_an_upload_gets_through_a_flood_of_chunks(flight):
    image = (TABLES / "config.tbl").read_bytes()
    junk = kcm.table_chunk_t()
    junk.t_us, junk.source, junk.kind, junk.total_bytes, junk.n = 0, 2, 1, 100_000, 1024
    junk.data = bytes(1024)
    chunk = kcm.table_chunk_t()
    chunk.t_us, chunk.source, chunk.kind = flight.now_us, 2, TABLE["CONFIG"]
    chunk.total_bytes, chunk.n, chunk.data = len(image), len(image), image.ljust(1024, b"\0")
    for _ in range(40):
        flight.bus.publish("KC_TABLE_UP", junk)
    flight.bus.publish("KC_TABLE_UP", flight.signer.chunk(chunk))
    flight.step()
    hk = flight.until("KC_HK")
    assert (hk.staged_kind, hk.staged_bytes) == (TABLE["CONFIG"], len(image))


def test_a_stranger_does_not_stop_the_dump_of_the_ground(flight):
    image = (TABLES / "space.tbl").read_bytes()
    assert flight.do(CMD.TABLE_DUMP, TABLE["SPACE"]).status == 0
    data = b""
    for _ in range(len(image) // 1024 + 2):
        data += b"".join(bytes(m.data[: m.n]) for ch, m in flight.heard if ch == "KC_TABLE_DOWN")
        flight.bus.publish("KC_CMD", command(flight, CMD.TABLE_DUMP, TABLE["SPACE"]))
        flight.step()
    assert data == image


@pytest.mark.parametrize("source", [0, 3, 77, -1])
def test_abort_is_taken_of_any_source(flight, source):
    assert flight.do(CMD.START, -1, 4, 1).status == 0
    events, (ack,), hk = send(flight, command(flight, CMD.ABORT, source=source))
    assert (ack.status, ack.source, hk.state) == (0, source, SAFE) and EVENT["CAL_ABORTED"] in events


def test_an_arm_state_with_the_largest_number_does_not_block_those_of_the_arm(flight):
    """It is the newest of its step and taken; the arm's next one has a later stamp, and is taken too."""
    flight.tick += 1
    for channel, m in flight.world.step(flight.now_us):
        flight.bus.publish(channel, m)
        if channel == "KC_ARM_STATE":
            wild = copy.copy(m)
    wild.seq = 2**31 - 1
    flight.bus.publish("KC_ARM_STATE", wild)
    flight.heard = []
    flight.send_time()
    assert flight.wait_done(flight.tick)
    seen = [m.id for ch, m in flight.heard if ch == "KC_EVENT"]
    for _ in range(40):
        seen += [m.id for ch, m in flight.step() if ch == "KC_EVENT"]
    assert seen == [EVENT["IN_JUMP"], EVENT["IN_JUMP"]]  # there and back
    assert flight.do(CMD.START, -1, 4, 1).status == 0


# ---- recorded, and sent later


def test_a_start_that_was_suppressed_does_not_run_days_later(flight):
    start = flight.signer.command(command(flight, CMD.START, -1, 4, 1))
    flight.tick += 3 * TICKS_A_DAY
    flight.step()
    events, (ack,), hk = send(flight, start)
    assert EVENT["CMD_OLD"] in events and (ack.status, hk.state) == (-9, IDLE)
    assert flight.do(CMD.START, -1, 4, 1).status == 0


@pytest.mark.parametrize("gone", ["deleted", "damaged"])
def test_with_both_copies_of_the_journal_gone_a_recorded_start_is_refused(flight, gone):
    start = flight.signer.command(command(flight, CMD.START, -1, 4, 1)).encode()
    assert [a.status for a in send(flight, start)[1]] == [0]
    flight.do(CMD.ABORT)
    flight.until("KC_HK")
    flight.kill()
    files = list(flight.store.glob(f"k{JOURNAL}.*"))
    assert len(files) == 2
    for file in files:
        if gone == "deleted":
            file.unlink()
        else:
            file.write_bytes(file.read_bytes()[:-1] + b"?")
    for again in range(2):
        flight.start()
        events, _ = flight.first_telemetry()
        reported = {EVENT["BOOT_NO_JOURNAL"], EVENT["BOOT_JOURNAL_LOST"]} & {e.id for e in events}
        lost = {EVENT["BOOT_NO_JOURNAL" if gone == "deleted" else "BOOT_JOURNAL_LOST"]}
        assert reported == (set() if again else lost)
        events, (ack,), hk = send(flight, start)
        # a store that shows an earlier run does not say whether the arm was under way: it is held
        assert ack.status == -9 and hk.state == (IDLE if gone == "deleted" else SAFE)
        flight.kill()
    flight.start()
    flight.step()
    flight.step()
    assert flight.do(CMD.START, -1, 4, 1).status == 0


# ---- counters


def test_the_largest_counter_locks_nobody_out(flight):
    wild = keys.Signer(flight.signer.key, lambda _source: 2**63 - 1)
    events, (ack,), _ = send(flight, wild.command(command(flight, CMD.TABLE_DISCARD)))
    assert events == [EVENT["CMD_COUNTER"]] and ack.status == -7
    assert flight.do(CMD.TABLE_DISCARD).status == 0


def test_a_new_key_counts_anew(flight):
    """Whatever the old key has used up: counters belong to keys."""
    assert flight.do(CMD.TABLE_DISCARD).status == 0
    keys.rotate(flight.keys)
    flight.kill()
    flight.start()
    flight.step()
    keys.retire(flight.keys)
    flight.signer = keys.Signer(keys.read(flight.keys)[0], keys.counting())  # from 1
    flight.step()
    assert flight.do(CMD.TABLE_DISCARD).status == 0
    assert flight.signer.counters[2] == 1


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
