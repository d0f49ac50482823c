"""Killed at any point and started again: the last committed table is active and it says what it was doing."""

import os
import random
import subprocess
from pathlib import Path

import pytest
from flight import (
    ARMED,
    EVENT,
    IDLE,
    KIN,
    MOVE,
    REVIEW,
    SAFE,
    UPDATE,
    Flight,
    copy_store,
    proposal_store,
    u32,
)  # fmt: skip

import kcm

HERE = Path(__file__).parent
CMD = kcm.cmd_t


@pytest.fixture(scope="module")
def waiting(tmp_path_factory):
    return proposal_store(tmp_path_factory.mktemp("waiting"))


@pytest.fixture(scope="module")
def killer(tmp_path_factory):
    """The library that kills at the n-th change of a file."""
    so = tmp_path_factory.mktemp("killer") / "kill_at.so"
    subprocess.run(["gcc", "-shared", "-fPIC", "-O1", "-o", so, HERE / "kill_at.c", "-ldl"], check=True)
    return so


def env_of(killer: Path, at: int, torn: bool) -> dict:
    env = dict(os.environ, LD_PRELOAD=str(killer), KILL_AT=str(at))
    return env | ({"KILL_TORN": "1"} if torn else {})


def ids(events) -> list[int]:
    return [e.id for e in events]


def test_killed_at_random_points_of_a_calibration(tmp_path):
    """Wherever it is hit: same tables, the state and pose it was in, SAFE, and ready to start again."""
    rng = random.Random(5)
    seen = set()
    with Flight(tmp_path / "store", "encoder_bias") as f:
        f.start()
        _, hk = f.first_words()
        crcs = list(hk.table_crc)
        for k in range(40):
            ack = f.do(CMD.START, -1, 5, k)
            assert ack.status == 0, f"start {k}: status {ack.status}, event {ack.event_id}"
            state, poses = None, 0
            for _ in range(rng.randrange(1, 250)):
                said = f.step()
                poses += sum(ch == "KC_MEAS" for ch, _ in said)
                for ch, m in said:
                    state = m.state if ch == "KC_HK" else state
                if any(ch == "KC_PROPOSAL" for ch, _ in said):
                    break
            f.kill()
            f.start()
            events, hk = f.first_words()
            assert list(hk.table_crc) == crcs
            assert hk.boot_count == k + 2
            if hk.state == REVIEW:
                assert EVENT["BOOT_REVIEW"] in ids(events)
                assert f.do(CMD.REJECT, hk.proposal_crc).status == 0
                continue
            seen.add(hk.boot_state)
            assert hk.state == SAFE
            assert MOVE <= hk.boot_state <= UPDATE and hk.boot_pose == poses
            told = [e for e in events if e.id == EVENT["BOOT_INTERRUPTED"]]
            assert [(e.got, e.want) for e in told] == [(hk.boot_state, hk.boot_pose)]
    assert len(seen) >= 4, f"hit only in states {seen}"


def approve(f: Flight, crc: int):
    """Both steps; the last answer, None if it died on the way."""
    signed = crc - (1 << 32) if crc >= 1 << 31 else crc
    ack = f.do(CMD.APPROVE_ARM, signed)
    return ack and f.do(CMD.APPROVE_GO, signed)


def count_changes(killer, waiting, tmp_path) -> int:
    """How many changes of files an approval takes, from start to end: the first number that kills nobody."""
    lo, hi = 1, 400
    while lo < hi:
        mid = (lo + hi) // 2
        with Flight(copy_store(waiting[0], tmp_path / f"count{mid}")) as f:
            f.start(env_of(killer, mid, torn=False), wait=False)
            died = not f.wait_done(0) or f.step() is None or approve(f, waiting[1]) is None
            died = died or f.process.poll() is not None
        lo, hi = (mid + 1, hi) if died else (lo, mid)
    return lo


@pytest.mark.parametrize("torn", [False, True])
def test_killed_before_every_single_change_of_a_file_while_a_correction_is_approved(
    waiting, killer, tmp_path, torn
):
    store, new, old = waiting
    n = count_changes(killer, waiting, tmp_path)
    assert n > 15, "an approval stores the copy for rollback, the table, the journal"
    outcomes = set()
    for at in range(1, n):
        with Flight(copy_store(store, tmp_path / f"kill{at}")) as f:
            f.start(env_of(killer, at, torn), wait=False)
            answered = f.wait_done(0) and f.step() is not None and approve(f, new)
            assert f.process.wait(timeout=20) == -9
            f.start()
            events, hk = f.first_words()
            active = u32(hk.table_crc[KIN])
            assert active in (old, new), f"kill {at}: {active:08x}"
            assert EVENT["BOOT_SLOT_BAD"] not in ids(events), f"kill {at}: nothing may be left half-written"
            if answered:
                assert active == new, f"kill {at}: answered, but not kept"
            if active == old:
                assert hk.state == REVIEW and u32(hk.proposal_crc) == new
                assert EVENT["BOOT_REVIEW"] in ids(events)
                ack = approve(f, new)
            else:
                assert hk.state == IDLE and hk.proposal_crc == 0
                assert hk.boot_state in (-1, REVIEW, ARMED)
                if hk.boot_state != -1:
                    assert EVENT["COR_ACTIVE"] in ids(events)
                ack = f.do(CMD.NOOP)
            assert ack.status == 0
            # and the way back is there whatever happened
            signed = new - (1 << 32) if new >= 1 << 31 else new
            assert f.do(CMD.ROLLBACK, signed).status == 0
            f.kill()
            f.start()
            _, hk = f.first_words()
            assert u32(hk.table_crc[KIN]) == old
            outcomes.add(active == new)
    assert outcomes == {False, True}


def newest_slot(store: Path, kind: int) -> Path:
    def number(p: Path) -> int:
        return int.from_bytes(p.read_bytes()[8:16], "little")

    return max(store.glob(f"k{kind:02d}.[ab]"), key=number)


def test_files_left_by_cut_off_writes_are_ignored_and_removed(waiting, tmp_path):
    store, new, _ = waiting
    rng = random.Random(3)
    for k in range(8):
        copy = copy_store(store, tmp_path / f"torn{k}")
        image = newest_slot(copy, 16).read_bytes()
        for kind in (4, 16, 17, 18):
            (copy / f"k{kind:02d}.tmp").write_bytes(image[: rng.randrange(len(image))])
        with Flight(copy) as f:
            f.start()
            events, hk = f.first_words()
            assert hk.state == REVIEW and u32(hk.proposal_crc) == new
            assert EVENT["BOOT_SLOT_BAD"] not in ids(events)
            assert not list(copy.glob("*.tmp"))


def test_a_damaged_journal_slot_costs_one_step_of_history_not_the_tables(waiting, tmp_path):
    store, new, _ = waiting
    copy = copy_store(store, tmp_path / "journal")
    slot = newest_slot(copy, 18)
    slot.write_bytes(slot.read_bytes()[:30])
    with Flight(copy) as f:
        f.start()
        events, hk = f.first_words()
    assert hk.state == REVIEW and u32(hk.proposal_crc) == new
    assert [(e.index, e.severity) for e in events if e.id == EVENT["BOOT_SLOT_BAD"]] == [(18, 2)]
    assert hk.boot_count == 2


def test_a_damaged_active_table_falls_back_to_the_one_before(waiting, tmp_path):
    store, new, old = waiting
    copy = copy_store(store, tmp_path / "kin")
    with Flight(copy) as f:
        f.start()
        f.step()
        assert approve(f, new).status == 0
        f.kill()
        slot = newest_slot(copy, KIN)
        data = bytearray(slot.read_bytes())
        data[200] ^= 1
        slot.write_bytes(bytes(data))
        f.start()
        events, hk = f.first_words()
    assert u32(hk.table_crc[KIN]) == old
    assert [e.index for e in events if e.id == EVENT["BOOT_SLOT_BAD"]] == [KIN]
