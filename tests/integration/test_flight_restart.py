"""Killed at any point and started again: the last committed table is active, and telemetry says what was
interrupted."""

import os
import random
import subprocess
from pathlib import Path

import pytest
from flight import (
    EVENT,
    IDLE,
    KIN,
    REVIEW,
    SAFE,
    STATE,
    Flight,
    copy_store,
    store_with_proposal,
    u32,
)  # fmt: skip

import kcm

AT_CANDIDATE = 0  # taken_at of a measurement that is that of a pose
HERE = Path(__file__).parent
CMD = kcm.cmd_t


@pytest.fixture(scope="module")
def waiting(tmp_path_factory):
    return store_with_proposal(tmp_path_factory.mktemp("waiting"))


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


def calibrate_for(f: Flight, ticks: int) -> int:
    """Step that often, or until a proposal comes; the number of poses measured."""
    poses = 0
    for _ in range(ticks):
        heard = f.step()
        poses += sum(ch == "KC_MEAS" and m.taken_at == AT_CANDIDATE for ch, m in heard)
        if any(ch == "KC_PROPOSAL" for ch, _ in heard):
            break
    return poses


def restart(f: Flight):
    """Kill and start again; events and housekeeping of the first tick."""
    f.kill()
    f.start()
    return f.first_telemetry()


def test_a_process_killed_at_random_points_of_a_calibration_reports_it_and_can_start_again(tmp_path):
    """Wherever it is killed: same tables, the interrupted state and poses, SAFE, and ready to start."""
    rng = random.Random(5)
    interrupted = set()
    with Flight(tmp_path / "store", "encoder_bias") as f:
        f.start()
        _, hk = f.first_telemetry()
        crcs = list(hk.table_crc)
        for k in range(40):
            ack = f.do(CMD.START, -1, 5, k)
            assert ack.status == 0, f"start {k}: status {ack.status}, event {ack.event_id}"
            poses = calibrate_for(f, rng.randrange(1, 250))
            events, hk = restart(f)
            assert list(hk.table_crc) == crcs and hk.boot_count == k + 2
            if hk.state == REVIEW:
                assert EVENT["BOOT_REVIEW"] in ids(events)
                assert f.do(CMD.REJECT, hk.proposal_crc).status == 0
                continue
            interrupted.add(hk.boot_state)
            assert hk.state == SAFE and hk.boot_pose == poses
            outside = {STATE[name] for name in ("IDLE", "REVIEW", "ARMED", "SAFE")}
            assert hk.boot_state >= 0 and hk.boot_state not in outside
            reported = [e for e in events if e.id == EVENT["BOOT_INTERRUPTED"]]
            assert [(e.got, e.want) for e in reported] == [(hk.boot_state, hk.boot_pose)]
    assert len(interrupted) >= 4, f"killed only in states {interrupted}"


def i32(crc: int) -> int:
    """A CRC as a command's argument carries it."""
    return crc - (1 << 32) if crc >= 1 << 31 else crc


def approve(f: Flight, crc: int):
    """Both steps; the last answer, None if the process died before."""
    ack = f.do(CMD.APPROVE_ARM, i32(crc))
    return ack and f.do(CMD.APPROVE_GO, i32(crc))


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


def killed_while_approving(f: Flight, killer: Path, at: int, torn: bool, crc: int) -> bool:
    """Die at the change of a file with this number; whether the approval was answered before."""
    f.start(env_of(killer, at, torn), wait=False)
    answered = f.wait_done(0) and f.step() is not None and approve(f, crc)
    assert f.process.wait(timeout=20) == -9
    f.start()
    return bool(answered)


def check_before_activation(f: Flight, events: list, hk, new: int) -> None:
    """The old table is in force: the correction waits for review and can be approved."""
    assert hk.state == REVIEW and u32(hk.proposal_crc) == new
    assert EVENT["BOOT_REVIEW"] in ids(events)
    assert approve(f, new).status == 0


def check_after_activation(f: Flight, events: list, hk) -> None:
    """The new table is in force: nothing waits, and commands are accepted."""
    assert hk.state == IDLE and hk.proposal_crc == 0 and hk.boot_state == -1
    assert EVENT["BOOT_LOST"] not in ids(events)
    assert f.do(CMD.NOOP).status == 0


@pytest.mark.parametrize("torn", [False, True])
def test_a_process_killed_before_any_change_of_a_file_keeps_the_old_or_the_new_table(
    waiting, killer, tmp_path, torn
):
    store, new, old = waiting
    n = count_changes(killer, waiting, tmp_path)
    assert n > 15, "an approval stores the copy for rollback, the table, the journal"
    outcomes = set()
    for at in range(1, n):
        with Flight(copy_store(store, tmp_path / f"kill{at}")) as f:
            answered = killed_while_approving(f, killer, at, torn, new)
            events, hk = f.first_telemetry()
            active = u32(hk.table_crc[KIN])
            assert active in (old, new), f"kill {at}: {active:08x}"
            assert EVENT["BOOT_SLOT_BAD"] not in ids(events), f"kill {at}: nothing may be left half-written"
            assert active == new or not answered, f"kill {at}: answered, but not kept"
            if active == old:
                check_before_activation(f, events, hk, new)
            else:
                check_after_activation(f, events, hk)
            # Rollback is possible whatever happened.
            assert f.do(CMD.ROLLBACK, i32(new)).status == 0
            assert u32(restart(f)[1].table_crc[KIN]) == old
            outcomes.add(active == new)
    assert outcomes == {False, True}


def newest_slot(store: Path, kind: int) -> Path:
    def number(p: Path) -> int:
        return int.from_bytes(p.read_bytes()[8:16], "little")

    return max(store.glob(f"k{kind:02d}.[ab]"), key=number)


def test_files_of_interrupted_writes_are_ignored_and_removed(waiting, tmp_path):
    store, new, _ = waiting
    rng = random.Random(3)
    for k in range(8):
        copy = copy_store(store, tmp_path / f"torn{k}")
        image = newest_slot(copy, 16).read_bytes()
        for kind in (4, 16, 17, 18):
            (copy / f"k{kind:02d}.tmp").write_bytes(image[: rng.randrange(len(image))])
        with Flight(copy) as f:
            f.start()
            events, hk = f.first_telemetry()
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
        events, hk = f.first_telemetry()
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
        events, hk = f.first_telemetry()
    assert u32(hk.table_crc[KIN]) == old
    assert [e.index for e in events if e.id == EVENT["BOOT_SLOT_BAD"]] == [KIN]
