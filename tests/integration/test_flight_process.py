"""The flight process from outside: command line, lockstep, order, tables over the network."""

import random
import subprocess

import pytest
from flight import BINARY, EVENT, IDLE, KIN, TABLE, TABLES, TICK_US, Flight, u32

import kcm

CMD = kcm.cmd_t


def run(*args) -> subprocess.CompletedProcess:
    return subprocess.run([BINARY, *map(str, args)], capture_output=True, text=True, timeout=20)


# ---- command line ----


def test_help_and_version():
    r = run("--help")
    assert r.returncode == 0 and "--lockstep" in r.stdout and "--store DIR" in r.stdout
    r = run("--version")
    assert r.returncode == 0 and r.stdout.startswith("kincal-fsw ")


@pytest.mark.parametrize(
    ("args", "message"),
    [
        ((), "--tables is missing"),
        (("--tables", "t"), "--store is missing"),
        (("--store",), "no value after --store"),
        (("--fast",), "unknown argument --fast"),
        (("--live", "--lockstep", "--tables", "t", "--store", "s"), "exclude each other"),
    ],
)
def test_bad_arguments_are_named(args, message):
    r = run(*args)
    assert r.returncode == 2 and message in r.stderr and "--help" in r.stderr


def test_directories_that_cannot_be_used_are_named(tmp_path):
    r = run("--tables", tmp_path / "none", "--store", tmp_path / "store")
    assert r.returncode == 2 and f"can't read the tables {tmp_path / 'none'}" in r.stderr
    (tmp_path / "file").touch()
    r = run("--tables", TABLES, "--store", tmp_path / "file" / "store")
    assert r.returncode == 2 and "can't make the store" in r.stderr
    r = run("--tables", TABLES, "--store", tmp_path / "store", "--url", "nonsense://")
    assert r.returncode == 1 and "no LCM network at nonsense://" in r.stderr


def test_a_store_belongs_to_one_process(tmp_path):
    with Flight(tmp_path / "store") as f:
        f.start()
        r = run("--tables", TABLES, "--store", tmp_path / "store", "--url", f.url)
        assert r.returncode == 2 and "another flight process uses it" in r.stderr
        assert f.stop() == 0


def test_damaged_default_tables_are_named_and_the_rest_works(tmp_path):
    tables = tmp_path / "tables"
    tables.mkdir()
    for p in TABLES.glob("*.tbl"):
        (tables / p.name).write_bytes(p.read_bytes())
    data = bytearray((tables / "kernel.tbl").read_bytes())
    data[100] ^= 1
    (tables / "kernel.tbl").write_bytes(bytes(data))
    with Flight(tmp_path / "store", tables=tables) as f:
        f.start()
        events, hk = f.first_telemetry()
        assert "the table kernel.tbl: KC_ERR_CRC" in f.stderr.read_text()
        assert [e.index for e in events if e.id == EVENT["TBL_MISSING"]] == [TABLE["KERNEL"]]
        assert hk.table_crc[TABLE["KERNEL"]] == 0 and hk.table_crc[TABLE["SPACE"]] != 0


# ---- lockstep ----


def test_a_tick_is_done_once_and_a_repeated_one_only_answered(tmp_path):
    with Flight(tmp_path / "store") as f:
        f.start()
        assert f.step()
        assert f.n_published == len(f.heard)
        n = f.n_published
        for _ in range(3):
            f.heard, f.done_tick = [], -1
            f.send_time()
            assert f.wait_done(f.tick)
            assert f.heard == [] and f.n_published == n


def test_a_command_is_handled_in_the_tick_after_its_stamp(tmp_path):
    with Flight(tmp_path / "store") as f:
        f.start()
        f.step()
        f.tick += 1  # stamped with the tick to come
        f.command(CMD.NOOP)
        f.tick -= 1
        assert not [m for ch, m in f.step() if ch == "KC_ACK"]
        assert [m.status for ch, m in f.step() if ch == "KC_ACK"] == [0]


def telemetry_of_shuffled(tmp_path, order) -> list[bytes]:
    """Telemetry after the same messages, sent in another order."""
    sent = []
    for seq in range(1, 5):
        for source in (1, 2):
            c = kcm.cmd_t()
            c.t_us, c.seq, c.source, c.opcode = TICK_US, seq, source, (CMD.NOOP, CMD.TABLE_DUMP)[seq % 2]
            c.arg_i = [seq, 0, 0, 0]
            sent.append(("KC_CMD", c))
    image = (TABLES / "config.tbl").read_bytes()
    for at in range(0, len(image), 100):
        m = kcm.table_chunk_t()
        m.t_us, m.kind, m.total_bytes, m.offset = TICK_US, TABLE["CONFIG"], len(image), at
        m.n = len(image[at : at + 100])
        m.data = image[at : at + 100].ljust(1024, b"\0")
        sent.append(("KC_TABLE_UP", m))
    with Flight(tmp_path / f"store{order}") as f:
        f.start()
        f.step()
        for channel, m in sent:
            if channel == "KC_TABLE_UP":
                m.source = CMD.SRC_GROUND
                f.signer.chunk(m)
            elif m.opcode == CMD.TABLE_DUMP:
                f.signer.command(m)
        random.Random(order).shuffle(sent)
        for channel, m in sent:
            f.bus.publish(channel, m)
        sent_back = []
        for _ in range(30):
            sent_back += f.step()
        assert [m.staged_bytes for ch, m in sent_back if ch == "KC_HK"][-1] == len(image)
        return [m.encode() for _, m in sent_back]


def test_the_order_of_arrival_never_matters(tmp_path):
    first = telemetry_of_shuffled(tmp_path, 1)
    assert len(first) > 20
    assert telemetry_of_shuffled(tmp_path, 2) == first
    assert telemetry_of_shuffled(tmp_path, 3) == first


def test_two_calibrations_with_one_seed_send_the_same_bytes(tmp_path):
    logs = []
    for k in range(2):
        with Flight(tmp_path / f"store{k}", "encoder_bias", seed=4) as f:
            f.start()
            f.step()
            f.command(CMD.START, 3, 5, 11)
            log = []
            for _ in range(3000):
                heard = f.step()
                log += [(ch, m.encode()) for ch, m in heard]
                if any(ch == "KC_PROPOSAL" for ch, _ in heard):
                    break
            logs.append(log)
    assert any(ch == "KC_PROPOSAL" for ch, _ in logs[0])
    assert logs[0] == logs[1]


# ---- tables ----


def test_a_table_dump_has_the_bytes_of_the_file(tmp_path):
    with Flight(tmp_path / "store") as f:
        f.start()
        f.step()
        assert f.do(CMD.TABLE_DUMP, TABLE["SPACE"]).status == 0
        data = bytearray()
        for _ in range(300):
            for ch, m in f.heard:
                if ch == "KC_TABLE_DOWN":
                    assert m.offset == len(data)
                    data += bytes(m.data[: m.n])
                    total = m.total_bytes
            if data and len(data) == total:
                break
            f.step()
        assert bytes(data) == (TABLES / "space.tbl").read_bytes()


def test_undecodable_messages_are_counted_and_nothing_else_happens(tmp_path):
    with Flight(tmp_path / "store") as f:
        f.start()
        _, hk = f.first_telemetry()
        for channel in ("KC_CMD", "KC_ARM_STATE", "KC_DETECTION", "KC_TABLE_UP"):
            f.bus.lcm.publish(channel, b"garbage")
        hk = f.until("KC_HK", 30)
        assert hk.n_rx_errors == 4 and hk.state == IDLE and hk.n_cmd_refused == 0


def test_a_live_process_keeps_its_own_time(tmp_path):
    with Flight(tmp_path / "store") as f:
        f.process = subprocess.Popen(
            [BINARY, "--live", "--url", f.url, "--tables", TABLES, "--store", f.store, "--keys", f.keys],
            stderr=f.stderr.open("wb"),
        )
        for _ in range(400):
            f.bus.wait(0.05)
            hks = [m for ch, m in f.heard if ch == "KC_HK"]
            if len(hks) >= 2:
                break
        assert len(hks) >= 2
        said = f.stderr.read_text()
        assert f"runs on {f.url}" in said and "KC_CMD" in said and "KC_HK" in said
        assert (
            said.count("in force") == 1 and f" arm {hks[0].table_crc[TABLE['ARM']] & 0xFFFFFFFF:08x} " in said
        )
        assert 0.9e6 <= hks[1].t_us - hks[0].t_us <= 1.3e6
        f.command(CMD.NOOP)  # stamped in 1970: taken in at once, and refused
        f.tick = hks[1].t_us // TICK_US + 1
        f.command(CMD.NOOP)
        for _ in range(40):
            f.bus.wait(0.05)
            if sum(ch == "KC_ACK" for ch, _ in f.heard) == 2:
                break
        answers = [(m.status, m.event_id) for ch, m in f.heard if ch == "KC_ACK"]
        assert answers == [(-9, EVENT["CMD_BEFORE"]), (0, 0)]
        assert u32(hks[0].table_crc[KIN]) != 0
        assert f.stop() == 0
