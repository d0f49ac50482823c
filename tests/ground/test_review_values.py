"""What review and its journal say, by value: limits met exactly, both sides of a bound, each kind of line."""

import datetime
import math
from dataclasses import replace
from pathlib import Path

import pytest
from commands import shell
from places import BIN
from samples import CRC as CRC_OF_LOG
from samples import proposal, sealed, signed, write_log

import kcm
from kincal import review
from kincal.api import reviews
from kincal.cli.review import _keys_option
from kincal.flight.tables import decode_as
from kincal.link import LogEvent, LogSummary, Session
from kincal.link.eventfile import event_bytes
from kincal.review import changes, decisions, history, journal
from kincal.review.changes import KinValues
from kincal.review.status import status
from kincal_shared import keys
from kincal_shared.errors import BadInput, CommandFailed

CRC, OTHER = "0000000a", "0000000b"


def entry(decision, crc=CRC, key_id=1, **more):
    return journal.Entry(
        "2026-01-01T00:00:00+00:00", decision, crc, "A", "w", 1, "", {}, key_id=key_id, **more
    )


@pytest.fixture
def signer():
    return keys.Signer(keys.of_simulation(1), keys.counting())


# ------------------------------------------------------------------------------- words


@pytest.mark.parametrize(
    ("by", "why", "good"),
    [
        ("A" * 200, "w" * 20_000, True), ("A", "\ud7ff\ue000", True), ("Zoë Ünal", "w", True),
        (" ", "w", False), ("A", "\t", False), ("A\nB", "w", False), ("A\rB", "w", False),
        ("A\u2028B", "w", False), ("A", "\ud800", False), ("\udfff", "w", False),
        ("A\u200bB", "w", False),  # looks like AB
    ],
)  # fmt: skip
def test_names_and_reasons_are_text_of_a_length_that_a_journal_holds(by, why, good):
    if good:
        review.check_words(by, why)
        for long in ((by.ljust(201, "A"), why), (by, why.ljust(20_001, "w"))):
            with pytest.raises(BadInput, match="up to 200 characters, a reason up to 20000"):
                review.check_words(*long)
    else:
        with pytest.raises(BadInput):
            review.check_words(by, why)


def test_no_line_is_written_with_words_that_cannot_stand_there(tmp_path, signer):
    with pytest.raises(BadInput, match="needs a name"):
        review.record(tmp_path / "j", "comment", 0, " ", "w", "", None, signer)
    assert not (tmp_path / "j").exists()
    line = review.record(tmp_path / "j", "comment", 0, "A", "w", "", None, signer)
    assert (line.crc, line.kind, line.command, line.armed_key, line.counter) == ("", "", "", 0, 0)


def test_a_journal_below_a_file_cannot_be_written(tmp_path, signer):
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInput, match="name another by --journal") as error:
        review.record(tmp_path / "file" / "j", "comment", 0, "A", "w", "", None, signer)
    assert error.value.where == str(tmp_path / "file")


# ------------------------------------------------------------------------------- what a table changes


class Terms:
    """Two coefficients with bounds that differ on both sides, the second with a prior."""

    n = 2
    coef = (
        type("C", (), {"lb": -0.1, "ub": 0.3, "prior_sigma": 0.0}),
        type("C", (), {"lb": -0.2, "ub": 0.4, "prior_sigma": 0.05}),
    )


@pytest.fixture
def flown(monkeypatch):
    found = changes.Flown(BIN)
    found._terms = found.terms = Terms()
    monkeypatch.setattr(changes, "_shifts", lambda *_: [])
    return found


def test_a_bound_is_that_on_the_side_of_the_value(flown):
    values = {(0, 0.0): 0.3, (0, 0.1): 0.3, (0, -0.1): 0.1, (1, -1.0): 0.2, (1, 1.0): 0.4, (2, 1.0): 0.0}
    assert {at: flown.bound(*at) for at in values} == pytest.approx(values)
    assert [flown.prior_sigma(k) for k in range(3)] == [0.0, 0.05, 0.0]


def test_values_alone_are_compared_with_what_is_known_before(flown):
    names = ["J1.phi_rad", "J1.a_m"]
    for old, was in ((KinValues(1, (0.01,)), [0.01, 0.0, 0.0]), (None, [None] * 3)):
        found = changes.of_values([0.06, -0.1, 0.2], [1e-3, 0.0, 0.0], old, names, flown)
        rows = {row.name: row for row in found.rows}
        assert [rows[n].old for n in (*names, "coef[2]") if n in rows] == was[: len(rows)]
        assert rows["J1.phi_rad"].share == pytest.approx(0.2)
        assert found.old_known is (old is not None)
    bare = changes.of_values([0.06], [1e-3], KinValues(1, (0.01,)), names, None)
    assert math.isnan(bare.rows[0].share) and bare.rows[0].source == rows["J1.phi_rad"].source


def test_a_rollback_has_no_sigma_and_shares_of_what_comes_back(flown):
    found = changes.of_rollback(KinValues(2, (0.06, 0.0)), KinValues(1, (-0.05, 0.0)), ["J1.phi_rad"], flown)
    (row,) = found.rows
    assert (row.old, row.new, row.sigma, row.source) == (0.06, -0.05, 0.0, "table before")
    assert row.share == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("status", "sigma", "prior", "text"),
    [
        ("estimated", 1e-3, 0.0, "data"), ("estimated", 0.001, 0.05, "data"),
        ("estimated", 0.05, 0.05, "prior"), ("estimated", 0.035, 0.05, "data 51%, prior"),
        ("at lower bound", 1e-3, 0.0, "data, at lower bound"), ("held", 1e-3, 0.0, "held: kept as it was"),
        ("estimated", 0.0, 0.0, "estimated"),
    ],
)  # fmt: skip
def test_what_a_value_rests_on_is_the_share_of_the_data_beside_the_prior(status, sigma, prior, text):
    assert changes._source(status, sigma, prior) == text


def test_a_row_is_shown_if_it_was_estimated_or_changes(flown):
    found = changes.of_values(
        [0.01, 0.01, 0.01, 0.02], [1e-3, 0.0, 0.0, 0.0], KinValues(1, (0.01,) * 4), "abcd", flown
    )
    assert {row.name for row in found.rows} == {"a", "d"}
    r = review.from_message(proposal(), review.coef_names(BIN))
    old = KinValues(1, tuple(c.value for c in r.coefs))
    assert {row.name for row in changes.of_review(r, old, flown).rows} == {
        c.name for c in r.coefs if c.sigma > 0.0
    }


def test_what_is_large_is_three_degrees_or_25_mm():
    assert (math.radians(3.0), 0.025) == (changes.BIG_RAD, changes.BIG_M)


# ------------------------------------------------------------------------------- what was rejected


def test_rejected_poses_are_those_of_the_session_from_its_first_pose_to_its_proposal():
    p = proposal()
    p.t_us, p.n_outliers = 200, 3
    p = sealed(p)
    session = Session(3)
    session.progress = [type("P", (), {"t_us": 100})()]
    session.proposal = p
    log = LogSummary(Path("-"))
    log.sessions[3] = session

    def event(name, t_us, index=0, got=0.0):
        return LogEvent(t_us, "warning", 0, "", name, index, got)

    plain = [("", 99, 1), ("", 100, 2), ("", 150, 3), ("_ACCEPTED", 160, 3), ("", 200, 6), ("", 201, 4)]
    extra = [("", 99, 11.0), ("", 200, 12.0), ("", 150, 13.0), ("_ACCEPTED", 160, 13.0), ("", 201, 14.0)]
    log.events = [event(f"CAL_OUTLIER{end}", t_us, pose) for end, t_us, pose in plain]
    log.events += [event(f"CAL_EXTRA_OUTLIER{end}", t_us, 5, got) for end, t_us, got in extra]
    r = review.from_message(p, review.coef_names(BIN))
    found = status(log, r)
    assert (found.rejected, found.rejected_extra, found.exact) == ((2, 6), (12,), True)
    assert not status(log, replace(r, n_outliers=2)).exact
    assert status(log, replace(r, session=8)).rejected == ()


# ------------------------------------------------------------------------------- the journal


def test_an_attempt_ends_with_a_line_of_the_same_command_correction_and_key():
    attempts = [
        entry("attempt", command="APPROVE_ARM"),
        entry("attempt", OTHER, command="APPROVE_ARM"),
        entry("attempt", key_id=2, command="APPROVE_ARM"),
        entry("attempt", command="REJECT"),
    ]
    assert journal.unfinished(attempts) == attempts
    for k, line in enumerate(
        (
            entry("arm"),
            entry("refused", OTHER, command="APPROVE_ARM"),
            entry("unanswered", key_id=2, command="APPROVE_ARM"),
            entry("reject"),
        )
    ):
        left = [a for j, a in enumerate(attempts) if j != k]
        assert journal.unfinished([*attempts, line]) == left
    assert journal.unfinished([*attempts, entry("seen"), entry("refused", command="START")]) == attempts


def test_of_attempts_alike_the_one_that_was_killed_stays_open():
    killed, again, other = (
        replace(entry("attempt", command="TABLE_ACTIVATE"), time=f"2026-01-0{k}T00:00:00+00:00", why=why)
        for k, why in ((1, "w"), (2, "w"), (3, "other"))
    )
    assert journal.unfinished([killed, again, entry("table_activate")]) == [killed]
    assert journal.unfinished([killed, again, other, entry("table_activate")]) == [killed, other]
    refused = replace(entry("refused", command="TABLE_ACTIVATE"), why="flight says no")
    assert journal.unfinished([killed, again, refused]) == [killed]


def test_a_note_of_the_end_needs_eight_digits(tmp_path, signer):
    path = tmp_path / "j"
    for why in ("one", "two"):
        review.record(path, "comment", 0, "A", why, "", None, signer)
    found = journal.read(path, signer.known)
    noted = journal.end_text(found)
    count, _, digest = noted.partition(":")
    assert (count, len(digest)) == ("2", 16)
    for good in (noted, f"2:{digest[:8]}", "0"):
        journal.check_noted(found, good)
    for bad in (f"2:{digest[:7]}", f"1:{digest}", f"3:{digest}", "x", "2:00000000"):
        with pytest.raises(BadInput, match="does not hold what was noted"):
            journal.check_noted(found, bad)


def test_an_empty_journal_of_a_flight_that_took_commands_is_missing(tmp_path):
    empty = journal.Journal(tmp_path / "j")
    full = replace(empty, entries=(entry("seen"),))
    assert [bool(journal.missing(x, 1, n)) for x in (empty, full) for n in (0, 7)] == [
        False, True, False, False,
    ]  # fmt: skip
    assert "key 1 up to counter 7" in journal.missing(empty, 1, 7)


def test_why_nobody_vouches_for_lines_follows_from_the_last_of_them():
    key = keys.of_simulation(1)
    with_mac, without = entry("seen", key_id=5, mac="x"), entry("seen", key_id=0)
    assert journal._why([], [key]) == ""
    assert "no key file" in journal._why([with_mac], [])
    assert "no MAC" in journal._why([with_mac, without], [key])
    assert "does not have key 5" in journal._why([without, with_mac], [key])


# ------------------------------------------------------------------------------- history


def correction(crc, utc_s=1.0, session=1, value=0.0, terms="t"):
    return history.Correction(utc_s, session, crc, "", terms, "change", (value,), (1e-3,))


def test_a_table_in_force_is_that_of_a_correction_and_decided_by_lines_about_it():
    found = history.History(corrections=[correction(CRC)])
    kin, config = history.InForce(1.0, "KIN", CRC), history.InForce(1.0, "CONFIG", CRC)
    assert found.what(kin) == "correction of session 1, change"
    assert found.what(config) == "" and found.what(replace(kin, crc=OTHER)) == history.NO_PROPOSAL
    lines = [entry("approve"), entry("approve", OTHER), entry("table_activate"), entry("seen")]
    assert history.decided(kin, lines) == "approved by A: w; sent by A: w"


def test_histories_are_joined_in_order_and_each_change_is_there_once():
    one = history.History([history.InForce(1.0, "KIN", CRC), history.InForce(5.0, "KIN", OTHER)], until_s=6.0)
    two = history.History(
        [history.InForce(3.0, "KIN", CRC), history.InForce(4.0, "CONFIG", CRC)], until_s=4.0
    )
    one.corrections, two.corrections = [correction(CRC, 2.0)], [correction(CRC, 3.0), correction(OTHER, 1.5)]
    found = history.joined([one, two])
    assert [(x.utc_s, x.kind, x.crc) for x in found.in_force] == [
        (1.0, "KIN", CRC),
        (4.0, "CONFIG", CRC),
        (5.0, "KIN", OTHER),
    ]
    assert [(c.utc_s, c.crc) for c in found.corrections] == [(1.5, OTHER), (2.0, CRC)]


def test_the_monitor_is_kept_once_a_minute_and_at_each_change():
    found = history.History()
    for t, state in ((1.0, 0), (30.0, 0), (61.0, 0), (62.0, 1), (121.0, 1), (123.0, 0)):
        rest = {"mon_joint": 0, "mon_bias": 0.0, "mon_sigma": 0.0, "mon_p": 1.0}
        hk = type("H", (), {"mon_state": state, **rest})
        found._monitor(hk, t)
    assert [m.utc_s for m in found.monitor] == [1.0, 61.0, 62.0, 123.0]
    assert [m.utc_s for m in found.monitor_changes()] == [1.0, 62.0, 123.0]
    words = [history.MonitorState(0.0, k, 0, 0.0, 0.0, 0.0).text for k in (-1, 0, 1, 99)]
    assert words[0] == "state -1" and words[1] == "quiet" and words[2] != "quiet" and words[3] == "state 99"


def test_a_trend_says_which_corrections_were_put_in_force_or_approved():
    _, terms = decode_as("terms", (BIN / "terms.tbl").read_bytes())
    found = history.History(
        [history.InForce(1.0, "KIN", CRC), history.InForce(1.0, "CONFIG", OTHER)],
        [
            correction(CRC, value=0.1),
            correction(OTHER, value=0.2),
            correction("c", value=0.3),
            correction("d", terms="u"),
        ],
    )
    (trend,) = history.trends(found, {"t": terms}, [entry("approve", "c"), entry("seen", OTHER)])
    assert [(p.crc, p.value, p.active) for p in trend.points] == [
        (CRC, 0.1, True),
        (OTHER, 0.2, False),
        ("c", 0.3, True),
    ]


# ------------------------------------------------------------------------------- what was seen, and where


def test_reasons_are_those_of_the_numbers_seen_last_and_of_clearance_whoever_saw_it(tmp_path):
    def seen(time, residual_m, *clearance):
        numbers = {"p_fit": 0.5, "fit_pos_m": residual_m, "before_pos_m": 1.0, "noise_scale": 1.0}
        when = f"2026-01-0{time}T00:00:00+00:00"
        return replace(entry("seen"), time=when, against=clearance, verdict="change", numbers=numbers)

    lines = (seen(1, 0.0, "old"), seen(3, 2.0, "new"), seen(2, 0.0, "old"), replace(seen(4, 0.0), crc=OTHER))
    found = [journal.Journal(tmp_path / "a", lines[:2]), journal.Journal(tmp_path / "b", lines[2:])]
    for order in (found, found[::-1]):
        larger, *clearance = reviews.known(order, 0xA, "change").reasons
        assert "residual" in larger and sorted(clearance) == ["new", "old"]
        assert (
            reviews.known(order, 0xB, "change").reasons == reviews.known(order, 0xC, "change").reasons == ()
        )


def test_the_first_step_of_a_journal_counts_if_it_can_be_the_one_in_force():
    """An approval that had expired gave its name and its override to one that somebody else armed."""

    def armed(seconds_ago, **more):
        when = datetime.datetime.now(datetime.UTC) - datetime.timedelta(seconds=seconds_ago)
        return replace(entry(journal.ARMED, **more), time=when.isoformat(timespec="seconds"))

    old, new = armed(300, override="old reason here"), armed(60)
    assert decisions.first_step([old, new, entry("seen")], CRC, 1) is new
    assert decisions.first_step([new, armed(30, crc=OTHER)], CRC, 0) is new
    for lines, key in (([armed(3700)], 1), ([old, new], 101), ([armed(30, crc=OTHER)], 1), ([], 1)):
        assert decisions.first_step(lines, CRC, key) is None


def test_a_correction_is_in_the_newest_recording_that_proposes_it(tmp_path):
    for name, crc in (("a", 1), ("b", CRC_OF_LOG), ("c", CRC_OF_LOG), ("d", 2)):
        p = proposal()
        p.crc = signed(crc)
        write_log(tmp_path / f"{name}.lcmlog", waiting=p)
    (tmp_path / "e.lcmlog").write_bytes(b"")
    (tmp_path / "f.lcmlog").write_text("no log")
    assert reviews.recorded(CRC_OF_LOG, tmp_path) == tmp_path / "c.lcmlog"
    assert reviews.recorded(1, tmp_path) == tmp_path / "a.lcmlog"
    assert reviews.recorded(3, tmp_path) is None


# ------------------------------------------------------------------------------- on the command line


def test_commands_about_a_run_are_given_with_its_keys_unless_others_were_named(tmp_path):
    log, beside = tmp_path / "run.lcmlog", tmp_path / journal.RUN_KEYS
    assert _keys_option(keys.DEFAULT, log) == ""
    beside.write_text("")
    assert _keys_option(keys.DEFAULT, log) == f" --keys {beside}"
    assert _keys_option(tmp_path / "mine", log) == f" --keys {tmp_path}/mine"


def test_review_show_needs_a_log_or_the_link(tmp_path):
    done = shell("review", "show", "--keys", tmp_path / "keys")
    assert done.exit_code == 2 and "name one, or --live" in done.output


# ------------------------------------------------------------------------------- what is refused, and why


def test_a_folder_without_a_table_or_with_another_one_in_its_place_is_refused(tmp_path):
    with pytest.raises(BadInput, match="no arm table"):
        changes.Flown(tmp_path)
    (tmp_path / "arm.tbl").write_bytes((BIN / "terms.tbl").read_bytes())
    with pytest.raises(BadInput, match=r"this is a TERMS table, a arm table|this is a terms table"):
        changes.Flown(tmp_path)
    assert changes.flown(tmp_path) is None and changes.flown(BIN).folder == BIN


def test_a_damaged_message_of_a_recording_hides_none_and_another_error_is_said(tmp_path, monkeypatch):
    hk = kcm.hk_t()
    hk.table_crc[4] = 0xA
    file = tmp_path / "a.lcmlog"
    rows = [("KC_HK", b"damaged"), ("KC_EVENT", b"x"), ("OTHER", b"y"), ("KC_HK", hk.encode())]
    file.write_bytes(b"".join(event_bytes(k, 10**6 * (k + 1), c, d) for k, (c, d) in enumerate(rows)))
    found = history.go_on(history.History(), file)
    assert [(x.kind, x.crc, x.utc_s) for x in found.in_force] == [("KIN", "0000000a", 4.0)]
    assert (found.end, found.until_s) == (file.stat().st_size, 4.0)

    def newer(_channel, _data):
        raise BadInput("of a newer flight")

    monkeypatch.setattr(history.channels, "decode", newer)
    with pytest.raises(BadInput, match="of a newer flight"):
        history.go_on(history.History(), file)


def test_what_is_no_file_or_cannot_be_read_is_no_journal(tmp_path, monkeypatch):
    with pytest.raises(BadInput, match="no regular file"):
        journal.read(tmp_path)

    def broken(*_given):
        raise OSError(5, "Input/output error")

    file = tmp_path / "j"
    file.write_bytes(b"")
    monkeypatch.setattr(journal, "lock", broken)
    with pytest.raises(BadInput, match="cannot be read: Input/output error"):
        journal.read(file)


def test_clearance_that_is_not_known_is_an_error_only_where_its_description_was_named(tmp_path):
    def fails():
        raise CommandFailed("no simulator", "", "install it")

    found, why = reviews.known_or_why(fails, None)
    assert found is None and "no simulator" in why
    with pytest.raises(CommandFailed, match="no simulator"):
        reviews.known_or_why(fails, tmp_path)
    assert reviews.known_or_why(lambda: 7, tmp_path) == (7, "")
