"""Situations of docs/OPERATIONS.md played to their end with the commands that its table names, on flight's
core in this process."""

import re
import sys
import threading

import pytest
from commands import shell
from places import ROOT
from simulated_flight import SimulatedFlight
from waiting_flight import WaitingFlight

import kcm
from kincal.console.desk import Desk, Words
from kincal.console.geometry import Geometry
from kincal.console.picture import Picture
from kincal.console.sources import Live
from kincal.operate.recording import Recorder, record
from kincal_shared.errors import CommandFailed
from kincal_sim.vision.imagers import fast_imager
from kincal_sim.world import World

sys.path.append(str(ROOT / "tests" / "bench"))
import alarm  # noqa: E402

PAGE = (ROOT / "docs" / "OPERATIONS.md").read_text("utf-8")
WORDS = ("--by", "A. Operator", "--why", "played")


def to_the_end(situation):
    """Command lines of a row of the table of situations, as they stand there."""
    (row,) = [line for line in PAGE.splitlines() if line.startswith(f"| {situation} |")]
    return re.findall(r"`kincal ([^`]+)`", row.split("|")[3])


def typed(line, on, **given):
    """A command line with its placeholders filled in, run; its output. on: further options."""
    words = []
    for word in line.split():
        words += WORDS if word == "..." else [given.get(word, WORDS[1] if word == "NAME" else word)]
    run = shell(*words, *on(words), env={"COLUMNS": "200"})
    assert run.exit_code == 0, f"kincal {line}: {run.output}"
    return run.output


def operated():
    """Somebody operates an arm whose fourth encoder slipped, until the monitor names a joint."""
    world, operations = [], []
    scenario = alarm._arm("slipped", {"J4": 0.03})

    def made(s, n):
        world.append(World(s, n, fast_imager))
        return world[0]

    def commander(send):
        operations.append(alarm.Operation(send, world, lambda _send: None))
        return operations[0]

    return scenario, {"world": made, "commander": commander}, operations


def test_the_monitor_names_a_joint(tmp_path):
    """From the alarm to the correction in force, by the page alone."""
    scenario, more, operations = operated()
    with SimulatedFlight(scenario, {"REVIEW"}, tmp_path, **more) as flight:
        common = ("--url", flight.url)
        signing = (*common, "--keys", str(flight.key_file))
        places = {"show": (*signing, "--recordings", str(tmp_path / "recorded"))}

        def on(words):
            unsigned = words[0] == "status" or "watch" in words
            return common if unsigned else places.get(words[1], signing)

        recorder, ended = Recorder(tmp_path / "recorded"), threading.Event()
        recording = threading.Thread(
            target=record, args=(flight.url, recorder, ended.is_set, lambda _r: None)
        )
        recording.start()
        try:
            until(lambda: operations and operations[0].started)
            assert operations[0].alarm == "MON_SUSPECT"
            assert re.search(r"joint 4 reads wrong by -?1\.[5-9]", typed("status", on))
            lines = to_the_end("the monitor names a joint")
            start = next(line for line in lines if "--suspects" in line)
            assert "START done" in typed(f"{start} --poses 2", on)  # few: a test has seconds
            assert flight.commands == [kcm.cmd_t.START]
            assert any("watch" in line for line in lines)
            flight.wait({"REVIEW"}, 180.0)
            waits = to_the_end("a correction waits")
            shown = typed(waits[0], on)
            assert "joint 4 is 1.7 deg off" in shown or "J4.phi_rad" in shown
            crc = re.search(r"correction ([0-9a-f]{8})", shown)[1]
            for line in waits[1:]:
                said = typed(line, on, CRC=crc)
        finally:
            ended.set()
            recording.join()
        assert crc in said  # `kincal status`: in force
        assert re.search(rf"kin +.*{crc}|{crc}.*", said) and flight.state == "IDLE"


def test_an_approval_that_nobody_lets_go_expires(made, tmp_path):
    """The console counts down; then GO is refused with what to do, and arming again goes through."""
    with WaitingFlight(made, tmp_path, approval_s=60) as flight:
        picture = Picture(Geometry(flight.tables))
        for channel, message in flight.proposal():
            picture.add(channel, message)
        desks = [
            Desk(flight.url, key, tmp_path / "journal", flight.tables, picture, 60.0)
            for key in (flight.first, flight.second)
        ]
        words = Words("A. First", "clean"), Words("B. Second", "agreed")
        with Live(flight.url, picture):
            until(lambda: picture.newest("KC_HK") is not None)
            for desk, word in zip(desks, words, strict=True):
                desk.see(made.text, word.by)
            desks[0].decide("arm", made.text, words[0])
            left = []

            def counted():
                hk = picture.snapshot()[0]["values"]["KC_HK"]["data"]
                left.append(hk["approval_left_s"])
                return hk["state"] == "REVIEW"

            until(counted)
            assert left[0] > left[len(left) // 2] > 0.0 == left[-1]
            assert sorted(left, reverse=True) == left
            assert any(row.get("name") == "COR_EXPIRED" for row in picture.page(10**6, 1000))
            before = flight.in_force
            with pytest.raises(CommandFailed, match=r"is not armed \(or has expired\)") as refused:
                desks[1].decide("go", made.text, words[1])
            assert f"`kincal review arm {made.text}` first" in str(refused.value)
            assert flight.in_force == before and not desks[1].may_go()["why_not"]
            assert desks[0].review(made.text)["waits"]
            desks[0].decide("arm", made.text, words[0])
            desks[1].decide("go", made.text, words[1])
            assert flight.in_force == made.crc
    assert [(e["decision"], e["by"]) for e in reversed(desks[0].log())] == [
        ("seen", "A. First"), ("seen", "B. Second"), ("attempt", "A. First"), ("arm", "A. First"),
        ("attempt", "B. Second"), ("refused", "B. Second"), ("attempt", "A. First"), ("arm", "A. First"),
        ("attempt", "B. Second"), ("approve", "B. Second"),
    ]  # fmt: skip


def until(what, seconds=120.0):
    end = threading.Event()
    for _ in range(int(seconds / 0.05)):
        if what():
            return
        end.wait(0.05)
    raise AssertionError("it did not come")


def test_a_journal_that_was_deleted_with_its_mark_is_no_first_start(made, tmp_path):
    """Flight knows the counters of the key: command line and console say what is missing and what to do."""
    with WaitingFlight(made, tmp_path) as flight:
        common = ["--url", flight.url, "--keys", str(flight.second), "--journal", str(tmp_path / "journal")]
        first = shell("audit", "verify", "--live", *common)
        assert first.exit_code == 0 and "a first start" in first.output
        # key 1 has commanded before, in the run that left this store
        common[3] = str(flight.first)
        noop = ["command", "noop", "--url", flight.url, "--keys", str(flight.first), *WORDS]
        assert shell(*noop, "--journal", tmp_path / "other").exit_code == 0
        lost = shell("audit", "verify", "--live", *common, env={"COLUMNS": "400"})
        assert lost.exit_code == 1 and re.search(
            r"accepted commands of key 1 up to counter \d{16}", lost.output
        )
        assert "bring back the copy" in lost.output and "kincal review comment" in lost.output
        picture = Picture(Geometry(flight.tables))
        desk = Desk(flight.url, flight.first, tmp_path / "journal", flight.tables, picture, 60.0)
        assert desk.journal_missing() == ""  # nothing was heard yet
        with Live(flight.url, picture):
            until(lambda: picture.newest("KC_HK") is not None)
            asked = len(flight.commands)
            assert "has no line: it was removed" in desk.journal_missing() == desk.journal_missing()
            assert len(flight.commands) == asked + 1  # once
            assert [r["name"] for r in picture.page(10**6, 1000)].count("JOURNAL_MISSING") == 1
        comment = ["review", "comment", "only tables so far", "--by", "A", *common[2:]]
        assert shell(*comment).exit_code == 0
        assert desk.journal_missing() == ""
        assert shell("audit", "verify", "--live", *common).exit_code == 0
