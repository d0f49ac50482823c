"""What was written before this flight software: a log and a store of the code before CAMERA stated errors of
the camera chain (KC_PROPOSAL with 49 bytes less, CAMERA and CONFIG of layout 1). tests/ground/former: a
healthy run, its messages but for most of the telemetry; the store after an approved correction."""

import gzip
import json
import shutil
from pathlib import Path

import pytest
from commands import good

from kincal import link
from kincal.flight import library
from kincal.link import channels, former
from kincal.run.inprocess import TABLES, Script, Setup, command, simulate
from kincal.run.store import Store

FORMER = Path(__file__).parent / "former"
KIN_CRC = 0xEFF09077  # that the executive's record named when the store was made


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "former.lcm"
    path.write_bytes(gzip.decompress((FORMER / "log.lcm.gz").read_bytes()))
    return path


def test_a_log_from_before_is_read_whole(log):
    summary = link.read_log(log)
    assert not summary.undecodable
    assert len(summary.last_session.measurements) == len(summary.last_session.progress) == 34
    assert [m.observation for m in summary.last_session.measurements] == list(range(1, 35))
    assert summary.last_session.at_poses == summary.last_session.measurements
    p = summary.last_session.proposal
    assert p.verdict == p.NO_CHANGE
    assert p.crc & 0xFFFFFFFF == 0xC9D33C57
    assert p.crc_kin_before & 0xFFFFFFFF == 0xF64B67C2


def test_a_proposal_from_before_has_an_exact_camera(log):
    p = link.read_log(log).last_session.proposal
    assert p.frame == p.LANDER
    assert 0.0 < p.pred_pos_m < 5e-4
    assert p.pred_noise_pos_m == p.pred_camera_pos_m == p.pred_lander_pos_m == p.pred_pos_m
    assert p.pred_noise_rot_rad == p.pred_camera_rot_rad == p.pred_lander_rot_rad == p.pred_rot_rad


def test_the_commands_read_a_log_from_before(log):
    run = good("log", log, "--json")
    assert json.loads(run.output)["sessions"][0]["proposal"]["verdict"] == "no change needed"


def test_damage_of_a_former_message_is_damage():
    head = next(iter(former.FORMER))
    with pytest.raises(Exception):  # noqa: B017, PT011 generated decoders raise anything
        channels.decode("KC_PROPOSAL", head + bytes(100))
    with pytest.raises(ValueError):  # noqa: PT011
        channels.decode("KC_HK", head + bytes(5000))


def test_former_types_are_not_those_of_today():
    for fingerprint, row in former.FORMER.items():
        assert channels.message_type(row.type)._get_packed_fingerprint() != fingerprint


def test_a_store_from_before_is_in_force_after_a_start(tmp_path):
    """KIN, the journal that names it and what was in force before; CAMERA and CONFIG come from the folder."""
    shutil.copytree(FORMER / "store", tmp_path / "store")
    setup = Setup(
        tables=TABLES, store=Store(tmp_path / "store"), limit_s=3.0, commander=lambda send: Script(send, [])
    )
    run = simulate("healthy", 1, setup)
    hk = run.log.hk
    assert hk.table_crc[library("flight").constant("KC_TBL_KIN")] & 0xFFFFFFFF == KIN_CRC
    assert hk.boot_count == 2
    assert [e.text for e in run.log.events if e.severity in ("WARNING", "ERROR")] == []


def test_counters_of_a_journal_from_before_become_those_of_the_key(tmp_path):
    """Its executive had sent 3 commands: the third is not taken again, the fourth is. Then the journal is one
    of today."""
    shutil.copytree(FORMER / "store", tmp_path / "store")
    store = Store(tmp_path / "store")
    assert {store.slots[18, slot][24:28] for slot in "ab"} == {b"KCJ3"}
    counters = iter((3, 4))
    store.count = lambda _source: next(counters)
    discard = [(tick, command("TABLE_DISCARD", seq=tick)) for tick in (3, 5)]
    setup = Setup(tables=TABLES, store=store, limit_s=1.0, commander=lambda send: Script(send, discard))
    run = simulate("healthy", 1, setup)
    names = [e.name for e in run.log.events if e.name.startswith(("CMD_", "BOOT"))]
    assert names == ["BOOT", "CMD_REPLAYED", "CMD_ACCEPTED"]
    assert b"KCJ5" in {store.slots[18, slot][24:28] for slot in "ab"}


# ---- before approvals by two holders: the journal KCJ4, CONFIG without the rule


def test_a_correction_that_waited_in_a_store_of_two_keys_is_approved_after_a_start(tmp_path):
    """Written by the code before: START with counter 1, a correction that waits, an uplinked CONFIG."""
    shutil.copytree(FORMER / "store-kcj4", tmp_path / "store")
    store = Store(tmp_path / "store")
    assert {store.slots[18, slot][24:28] for slot in "ab"} == {b"KCJ4"}
    config = store.slots[7, "a"][24:]
    counters = iter((1, 2, 3))
    store.count = lambda _source: next(counters)
    crc = 0xDE8CB71F - (1 << 32)
    sent = (("NOOP", ()), ("APPROVE_ARM", (crc,)), ("APPROVE_GO", (crc,)))
    script = [(5 + 10 * i, command(name, *args, seq=i + 1)) for i, (name, args) in enumerate(sent)]
    setup = Setup(tables=TABLES, store=store, limit_s=5.0, commander=lambda send: Script(send, script))
    run = simulate("paper", 1, setup)
    names = [e.name for e in run.log.events]
    assert "CMD_REPLAYED" in names  # the counter of before is known
    assert "BOOT_SLOT_BAD" not in names and "BOOT_LOST" not in names and "COR_ACTIVE" in names
    assert run.log.hk.table_crc[4] == crc
    assert run.log.hk.table_crc[7] & 0xFFFFFFFF == int.from_bytes(config[12:16], "little")
    assert (run.log.hk.go_by_other_key, run.log.hk.boot_count) == (0, 2)
    assert b"KCJ5" in {store.slots[18, slot][24:28] for slot in "ab"}


def test_housekeeping_of_before_has_no_second_holder():
    fingerprint = next(f for f, row in former.FORMER.items() if row.more_bytes == 76 and row.type == "hk_t")
    hk = channels.message_type("hk_t")()
    hk.state, hk.approval_left_us, hk.armed_key, hk.go_by_other_key = 10, 7, 101, 1
    old = channels.decode("KC_HK", fingerprint + hk.encode()[8:-76])
    assert (old.state, old.approval_left_us, old.armed_key, old.go_by_other_key) == (10, 7, 0, 0)
