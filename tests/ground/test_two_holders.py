"""Approval by two persons, each with a key of his own: key files, journal, commands, consoles."""

import json
import math
from contextlib import closing

import lcm
import numpy as np
import pytest
from commands import shell as cli
from commands import text_of
from waiting_flight import WaitingFlight

import kcm
from kincal import link as links
from kincal.api import operate
from kincal.console.app import Console, make_app
from kincal.console.desk import Desk, Words
from kincal.console.geometry import Geometry
from kincal.console.picture import Picture
from kincal.console.sources import Live
from kincal.flight import library
from kincal.link import read_log
from kincal.review import changes, decisions, find, journal
from kincal.review.residuals import residuals
from kincal.run.inprocess import TABLES
from kincal_shared import keys
from kincal_shared.errors import BadInput, CommandFailed

ARM, GO = kcm.cmd_t.APPROVE_ARM, kcm.cmd_t.APPROVE_GO


@pytest.fixture
def flight(made, tmp_path):
    with WaitingFlight(made, tmp_path) as waiting:
        yield waiting


def see(flight, key_file, by, journal_file):
    review = find(flight.made.log, flight.made.text, flight.tables)
    decisions.see(journal_file, review, by, flight.made.log, keys.signer_of(key_file))


def decide(flight, verb, key_file, by, journal_file, *more):
    given = ("--by", by, "--why", "clean", "--url", flight.url, "--keys", key_file, "--journal", journal_file)
    return cli("review", verb, flight.made.text, *given, *more)


# ---- key files


def test_ground_and_flight_count_holders_alike():
    flight_lib = library("flight")
    assert flight_lib.constant("KC_HOLDER_NUMBERS") == keys.HOLDER_NUMBERS
    assert flight_lib.constant("KC_KEY_MAX") == keys.MOST
    assert [keys.holder(k) for k in (1, 99, 100, 101, 199)] == [0, 0, 1, 1, 1]


def test_each_holder_makes_and_rotates_a_file_of_his_own_and_flight_gets_both(tmp_path):
    first, second, both = tmp_path / "first", tmp_path / "second", tmp_path / "both"
    assert "key 1;" in cli("key", "new", first).output
    assert "key 101;" in cli("key", "new", second, "--holder", 1).output
    assert keys.rotate(second).id == 102
    assert "keys 1, 101, 102 of 2 holders" in cli("key", "join", first, second, "-o", both).output
    assert keys.read(both) == (*keys.read(first), *keys.read(second))
    assert both.stat().st_mode & 0o077 == 0
    assert "key 1 signs, key 101 is another holder's, key 102" in cli("key", "show", both).output
    for act in ("rotate", "retire"):
        refused = cli("key", act, both)
        assert refused.exit_code == 2 and "several holders" in refused.output
    assert keys.retire(second).id == 101
    assert keys.join(both, (first, second))[1].id == 102


def test_the_numbers_of_a_holder_end(tmp_path):
    path = tmp_path / "keys"
    keys.write(path, (keys.Key(199, b"1" * 32),))
    with pytest.raises(BadInput, match="numbers of this holder end at key 199"):
        keys.rotate(path)


# ---- journal


def write(path, key_file, n=1):
    for _ in range(n):
        journal.append(
            path, journal.Entry("t", "comment", "", "me", "why", None, "", {}), keys.signer_of(key_file)
        )


def test_a_log_with_two_different_messages_of_a_correction_is_not_decided_by(flight, tmp_path):
    """A copy with a better p of the fit under the same CRC took the reasons to reject away."""
    for name, p_fit in (("again", None), ("forged", 0.61)):
        with closing(lcm.EventLog(str(tmp_path / name), "w")) as out:
            for e in lcm.EventLog(str(flight.made.log), "r"):
                out.write_event(e.timestamp, e.channel, e.data)
                if e.channel == "KC_PROPOSAL":
                    m = kcm.proposal_t.decode(e.data)
                    m.p_fit = m.p_fit if p_fit is None else p_fit
                    out.write_event(e.timestamp, e.channel, m.encode())
    assert find(tmp_path / "again", flight.made.text, flight.tables).crc_text == flight.made.text
    with pytest.raises(BadInput, match="two messages of correction .* say different things"):
        find(tmp_path / "forged", flight.made.text, flight.tables)


def test_two_holders_write_into_one_journal_by_turns(tmp_path):
    first, second, path = tmp_path / "first", tmp_path / "second", tmp_path / "journal"
    keys.new(first)
    keys.new(second, 1)
    for key_file in (first, second, first, second):
        write(path, key_file)
    keys.join(tmp_path / "both", (first, second))
    whole = journal.read(path, keys.read(tmp_path / "both"))
    assert [e.key_id for e in whole.entries] == [1, 101, 1, 101] and not whole.unconfirmed
    assert journal.read(path, keys.read(second)).unconfirmed == 0  # his last line vouches for those before it
    mine = journal.read(path, keys.read(first))
    assert mine.unconfirmed == 1 and "key 101" in mine.vouched


def test_a_key_of_before_its_rotation_writes_no_line_any_more(tmp_path):
    first, second, path = tmp_path / "first", tmp_path / "second", tmp_path / "journal"
    keys.new(first)
    keys.new(second, 1)
    old = keys.read(first)
    keys.rotate(first)
    keys.retire(first)
    write(path, first)
    write(path, second)
    before = path.read_bytes()
    write_with = keys.Signer(old[0], keys.counting(), (*old, *keys.read(first)))
    journal.append(path, journal.Entry("t", "comment", "", "me", "why", None, "", {}), write_with)
    with pytest.raises(BadInput, match="of an older key than before it"):
        journal.read(path, keys.read(first))
    assert path.read_bytes().startswith(before)


# ---- what both of them see


def test_what_is_left_at_each_pose_is_in_sum_what_flight_says(made):
    """RMS of all observations: with the table in force, here the nominal one, and with what is proposed."""
    flown, session = changes.Flown(TABLES), read_log(made.log).sessions[1]
    p, measured = session.proposal, session.measurements
    extra = next(k for k, m in enumerate(measured) if m.taken_at)
    found = residuals(made.log, 1, [0.0], list(p.value), flown, (3,), (measured[extra].observation,))
    columns = np.array([(r.before_pos_m, r.before_rot_rad, r.after_pos_m, r.after_rot_rad) for r in found])
    said = [p.before_pos_m, p.before_rot_rad, p.fit_pos_m, p.fit_rot_rad]
    assert np.sqrt(np.mean(columns**2, axis=0)) == pytest.approx(said, rel=1e-9)
    assert [(r.pose, r.candidate, r.frames) for r in found] == [
        (m.pose, m.candidate, m.n_frames) for m in measured
    ]
    assert [r.tags for r in found] == [tuple(m.tag_id[: m.n_tags]) for m in measured]
    assert [r.pose for r in found if r.rejected and not r.extra] == [3]
    assert [k for k, r in enumerate(found) if r.rejected and r.extra] == [extra]
    alone = residuals(made.log, 1, None, list(p.value), flown)
    assert all(math.isnan(r.before_pos_m + r.before_rot_rad) and not r.rejected for r in alone)
    assert [r.after_pos_m for r in alone] == [r.after_pos_m for r in found]
    assert residuals(made.log, 2, None, list(p.value), flown) == ()


# ---- the command line


def test_the_holder_that_armed_cannot_give_go_and_the_other_completes_it(flight, tmp_path):
    """One journal, two terminals."""
    path, text = tmp_path / "journal.jsonl", flight.made.text
    before = flight.in_force
    see(flight, flight.first, "A", path)
    armed = decide(flight, "arm", flight.first, "A", path)
    assert armed.exit_code == 0, armed.output
    assert "given with another key than key 1" in text_of(armed)
    flight.until(lambda: flight.hk.armed_key == 1)
    sent = len(flight.commands)

    same = " ".join(decide(flight, "go", flight.first, "A", path).output.split())
    assert "GO of correction" in same and "another key than key 1" in same and "this is key 1" in same
    dry = decide(flight, "go", flight.first, "A", path, "--dry-run")
    assert dry.exit_code == 1
    assert "GO with another key than key 1" in text_of(dry)
    assert "seen by B" in decide(flight, "go", flight.second, "B", path, "--dry-run").output
    again = " ".join(decide(flight, "arm", flight.second, "B", path).output.split())
    assert "is armed already" in again and "another key than key 1" in again
    assert len(flight.commands) == sent and flight.in_force == before  # nothing of all that was sent

    listed = " ".join(cli("review", "list", "--live", "--url", flight.url, "--journal", path,
                          "--keys", flight.first).output.split())  # fmt: skip
    assert "is armed, by key 1 for another" in listed and "second step by another key than key 1" in listed
    shown = json.loads(cli("status", "--url", flight.url, "--json").output)["waiting"]
    assert shown["armed_key"] == 1 and shown["two_holders"] and shown["left_s"] > 0.0
    assert shown["go_by"] == keys.other_than(1)

    see(flight, flight.second, "B", path)
    assert decide(flight, "go", flight.second, "B", path, "--dry-run").exit_code == 0
    went = decide(flight, "go", flight.second, "B", path)
    assert went.exit_code == 0, went.output
    assert flight.in_force == flight.made.crc
    keys.join(tmp_path / "both", (flight.first, flight.second))
    lines = journal.read(path, keys.read(tmp_path / "both")).entries
    last = [e for e in lines if e.decision in ("arm", "approve")]
    assert [(e.decision, e.by, e.key_id, e.armed_key) for e in last] == [
        ("arm", "A", 1, 0),
        ("approve", "B", 101, 1),
    ]
    refused = [e for e in lines if e.decision == "refused"]
    assert [e.command for e in refused] == ["APPROVE_GO", "APPROVE_ARM"] and "another key" in refused[0].why
    audit = cli("audit", "verify", "--journal", path, "--keys", tmp_path / "both")
    assert audit.exit_code == 0, audit.output
    logged = " ".join(cli("audit", "log", "--journal", path, "--keys", tmp_path / "both").output.split())
    assert "101 (armed by key 1)" in logged or "(armed by" in logged
    assert text in logged


def test_flight_refuses_what_the_tool_lets_through(flight):
    """An older tool, or another program: flight holds the rule, and the approval stays armed."""
    signer = keys.signer_of(flight.first)
    with links.Link(flight.url, operate.LISTEN, signer=signer) as link:
        decisions.on_board(link, 20.0)  # stamped by flight's clock from here on
        link.command("APPROVE_ARM", (flight.made.crc,), 20.0)
        with pytest.raises(CommandFailed, match="CMD_SAME_KEY"):
            link.command("APPROVE_GO", (flight.made.crc,), 20.0)
        hk = link.wait_hk(lambda hk: hk.armed_key == 1, 20.0, "housekeeping")
    assert 2**31 < hk.approval_left_us < 3600e6  # an hour in us has more than 32 bits
    assert flight.state == "ARMED" and flight.in_force != flight.made.crc


# ---- two consoles


class Place:
    """A console with a key file of its own, without a browser."""

    def __init__(self, flight, key_file, folder):
        geometry = Geometry(flight.tables)
        self.picture = Picture(geometry)
        for channel, message in flight.proposal():
            self.picture.add(channel, message)
        self.desk = Desk(
            flight.url, key_file, folder / f"{key_file.name}.jsonl", flight.tables, self.picture, 20.0
        )
        self.app = make_app(Console(flight.url, geometry, self.picture, self.desk), None)
        self.live = Live(flight.url, self.picture)

    def __enter__(self):
        self.live.__enter__()
        return self

    def __exit__(self, *error):
        self.live.__exit__(*error)

    def flight_values(self):
        return self.picture.snapshot()[0]["values"]["KC_HK"]["data"]


def test_two_consoles_agree_and_the_second_one_completes_what_the_first_began(flight, tmp_path):
    crc = flight.made.text
    with Place(flight, flight.first, tmp_path) as a, Place(flight, flight.second, tmp_path) as b:
        flight.until(lambda: a.picture.newest("KC_HK") and b.picture.newest("KC_HK"))
        a.desk.see(crc, "A")
        b.desk.see(crc, "B")
        a.desk.once("1", lambda: a.desk.decide("arm", crc, Words("A", "clean")))
        flight.until(lambda: all(place.flight_values()["armed_key"] == 1 for place in (a, b)))
        for place in (a, b):
            shown = place.flight_values()
            assert (shown["state"], shown["proposal"], shown["two_holders"]) == ("ARMED", crc, True)
            assert shown["go_by"] == keys.other_than(1) and shown["approval_left_s"] > 0.0
        assert a.desk.review(crc)["go"] == {
            "key": 1,
            "why_not": f"GO has to be given with {keys.other_than(1)}",
            "override": False,
        }
        assert b.desk.review(crc)["go"] == {"key": 101, "why_not": "", "override": False}
        sent = len(flight.commands)
        with pytest.raises(CommandFailed, match="another key than key 1"):
            a.desk.decide("go", crc, Words("A", "clean"))
        assert len(flight.commands) == sent
        b.desk.once("1", lambda: b.desk.decide("go", crc, Words("B", "agreed")))
        flight.until(lambda: all(place.flight_values()["tables"]["KIN"] == crc for place in (a, b)))
        assert [a.flight_values()[k] for k in ("state", "proposal", "armed_key")] == ["IDLE", "", 0]
        assert [b.flight_values()[k] for k in ("state", "proposal", "armed_key")] == ["IDLE", "", 0]
    assert flight.commands == [(ARM, 1), (GO, 101)] and flight.taken.count(GO) == 1
    last = journal.read(tmp_path / "second.keys.jsonl", keys.read(flight.second)).entries[-1]
    assert (last.decision, last.key_id, last.armed_key) == ("approve", 101, 1)
