"""Review: what is shown, what stands out, what is sent, what is recorded."""

import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import good, shell, text_of
from fake_flight import FakeFlight
from places import BIN
from samples import CRC, decided, progress, proposal, sealed, signed, write_log

import kcm
from kincal import review, tables
from kincal.api import reviews
from kincal.cli.errors import EXIT_FAILED, EXIT_INPUT
from kincal.flight import event_name
from kincal.flight.tables import kind_number
from kincal.link import LogEvent, LogSummary, Session
from kincal.link.connection import check_ack
from kincal.pages import image
from kincal.pages import review as review_page
from kincal.pages.page import Provenance, render
from kincal.results import chance_text
from kincal.review.status import status, to_decide
from kincal.review.thresholds import read_limits, thresholds
from kincal_shared import keys
from kincal_shared.errors import CommandFailed, KincalError
from kincal_sim.ports import private_port, private_url

APPROVE = [(kcm.cmd_t.APPROVE_ARM, CRC), (kcm.cmd_t.APPROVE_GO, CRC)]


@pytest.fixture
def drawn():
    """For a test that is about the picture."""


@pytest.fixture(autouse=True)
def undrawn(request, monkeypatch):
    """Elsewhere none is drawn: a browser takes seconds."""
    if "drawn" not in request.fixturenames:
        monkeypatch.setattr(image, "beside", lambda files, _figures: (files, ""))


@pytest.fixture
def journal(tmp_path):
    return tmp_path / "journal.jsonl"


# ------------------------------------------------------------------------ what is shown


def test_proposal_is_shown_with_names_units_and_status(names):
    r = review.from_message(proposal(), names)
    assert r.crc_text == "fedcba98"
    assert r.changes_something
    assert (r.coefs[0].name, r.coefs[0].unit, r.coefs[0].status) == ("J1.phi_rad", "rad", "estimated")
    assert (r.coefs[26].status, r.coefs[26].confounded) == ("held", ("J1.phi_rad",))
    assert r.coefs[28].status == "masked"
    assert len(r.estimated) == 27


def test_correlation_has_unit_diagonal_and_is_symmetric(names):
    c = review.from_message(proposal(), names).correlation
    assert c.shape == (27, 27)
    assert np.allclose(np.diag(c), 1.0)
    assert np.allclose(c, c.T)
    assert np.abs(c).max() <= 1.0 + 1e-12


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({}, "rank 27 of 28"), ({"p_fit": 1e-6}, "worse than the stated noise"),
        ({"n_outliers": 2}, "2 of 20 poses"), ({"verdict": 2}, "poor"),
        ({"fit_pos_m": 1.0}, "larger than before"), ({"status": [3] + [0] * 63}, "at a bound: J1.phi_rad"),
    ],
)  # fmt: skip
def test_what_stands_out_is_named(names, change, word):
    p = proposal()
    for key, value in change.items():
        setattr(p, key, value)
    assert any(word in w for w in review.warnings(review.from_message(p, names)))


@pytest.mark.usefixtures("drawn")
def test_show_prints_all_numbers_and_draws(tmp_path):
    log = tmp_path / "run.lcmlog"
    write_log(log)
    run = good("review", "show", log, "--tables", BIN)
    for text in ("fedcba98", "J7.a_m", "held", *[key for key, _u, _t in review.NUMBERS], "rank 27 of 28"):
        assert text in run.output
    assert (tmp_path / "review-fedcba98.png").stat().st_size > 20_000
    page = (tmp_path / "review-fedcba98.html").read_text()
    assert all(text in page for text in ("Correction fedcba98", "Look at: rank 27 of 28", "Correlation"))


def test_unknown_crc_is_refused(tmp_path):
    log = tmp_path / "run.lcmlog"
    write_log(log)
    run = shell("review", "show", log, "--crc", "0badcafe", "--tables", BIN)
    assert run.exit_code == EXIT_INPUT
    assert "no such proposal" in run.output


def test_terms_table_of_another_run_would_give_wrong_names_and_is_refused():
    crc = int.from_bytes((BIN / "terms.tbl").read_bytes()[12:16], "little")
    assert review.coef_names(BIN, crc) == review.coef_names(BIN)
    with pytest.raises(KincalError, match=f"made with the terms table {crc ^ 1:08x}") as error:
        review.coef_names(BIN, crc ^ 1)
    assert "--tables" in str(error.value)


# ------------------------------------------------------------------------ what is sent


POOR = kcm.proposal_t.POOR


def poor():
    """Like the fit of an arm with an effect that the model lacks."""
    p = proposal(POOR)
    p.rank, p.p_fit, p.noise_scale = 28, 1e-126, 3.2
    return p


def decide(flight, command, journal, *extra, crc=f"{CRC:08x}", by="A. Reviewer"):
    given = ("--why", "clean", "--url", flight.url, "--journal", journal, "--timeout", 3)
    return shell("review", command, crc, "--by", by, *given, *extra)


def refused(flight, run, *texts):
    """Nothing was sent, and the command says why."""
    assert run.exit_code == EXIT_INPUT and flight.commands == [], run.output
    assert all(text in text_of(run) for text in texts), run.output


def see(tmp_path, journal, p=None, by="A. Reviewer"):
    """`review show` of a log with this proposal; words of its output, without line ends."""
    log = tmp_path / "run.lcmlog"
    write_log(log, waiting=p or proposal())
    run = good("review", "show", log, "--tables", BIN, "--journal", journal, "--by", by)
    return text_of(run)


def test_approval_is_two_commands_bound_to_the_crc_and_recorded(tmp_path, journal):
    shown = see(tmp_path, journal)
    assert "pred_pos_m 0.30 mm predicted position error" in shown and "does not hold" not in shown
    assert "page: " in shown and "review-fedcba98.html" in shown
    assert "review arm" in shown and "note in the journal" not in shown  # --by has just noted it
    with FakeFlight(CRC) as flight:
        run = decide(flight, "arm", journal)
        assert run.exit_code == 0, run.output
        assert flight.commands == APPROVE[:1] and flight.overrides == [0]
        assert flight.kin_crc == 1
        assert "nothing is in force yet: within 599 s `kincal review go fedcba98`" in run.output
        run = decide(flight, "go", journal)
    assert run.exit_code == 0, run.output
    assert "armed by A. Reviewer" in run.output
    assert flight.commands == APPROVE
    assert flight.kin_crc == CRC
    lines = review.check_journal(journal)
    assert [e.decision for e in lines] == ["seen", "attempt", "arm", "attempt", "approve"]
    assert [e.command for e in lines] == ["", "APPROVE_ARM", "", "APPROVE_GO", ""]
    assert {e.armed_key for e in lines} == {0}  # this flight names none
    entries = decided(lines)
    assert {(e.crc, e.by, e.session, e.verdict) for e in entries} == {
        ("fedcba98", "A. Reviewer", 3, "change proposed")
    }
    assert all(e.numbers["p_fit"] == pytest.approx(0.57) and e.override == "" for e in entries)
    assert entries[0].why.startswith("rank 27 of 28; held: J7.a_m; clearance and reach are not known")
    assert entries[1].why == "clean"


def test_what_was_not_seen_is_not_approved_but_may_be_rejected(journal):
    with FakeFlight(CRC) as flight:
        run = decide(flight, "arm", journal)
        assert run.exit_code == EXIT_INPUT
        assert "A. Reviewer has not seen correction fedcba98" in run.output
        said = text_of(run)
        assert '`kincal review show --live --by "A. Reviewer"` shows it' in said
        assert "LOG --crc fedcba98 in place of --live" in said
        assert flight.commands == []
        assert decide(flight, "reject", journal).exit_code == 0
    lines = review.check_journal(journal)
    assert [e.decision for e in lines] == ["attempt", "refused", "attempt", "reject"]
    assert "has not seen correction fedcba98" in lines[1].why and lines[1].command == "APPROVE_ARM"


def test_a_line_that_says_seen_and_that_no_key_vouches_for_does_not_count(tmp_path, journal):
    see(tmp_path, journal)
    line = {**json.loads(journal.read_text()), "mac": "", "key_id": 0}
    journal.write_text(json.dumps(line, sort_keys=True) + "\n")
    with FakeFlight(CRC) as flight:
        run = decide(flight, "arm", journal)
    assert run.exit_code == EXIT_INPUT and "this line is not the one of its end mark" in run.output
    assert flight.commands == []
    review.journals.end_file(journal).unlink()  # whoever changes the journal may take its mark away too
    with FakeFlight(CRC) as flight:
        run = decide(flight, "arm", journal)
    assert run.exit_code == EXIT_INPUT and "has not seen" in run.output
    assert flight.commands == []


def test_a_poor_proposal_needs_an_override_and_its_reason_is_kept(tmp_path, journal):
    text = see(tmp_path, journal, poor())
    assert "poor fit; waits for review" in text
    assert "flight waits for a decision; the table in force stays until then" in text
    assert "reason to reject: flight itself calls the fit poor" in text
    assert "kincal review arm fedcba98 --by NAME --why REASON --override REASON" in text
    assert text.index("kincal review reject") < text.index("kincal review arm")
    for number in ("pred_pos_m 0.30 mm", "bound_pos_m 0.40 mm", "p_no_change 1e-09"):
        assert f"{number} does not hold: the fit is poor" in text
    assert "sigma, correlations, predicted error, its bound and p_no_change assume" in text
    with FakeFlight(CRC, verdict=POOR) as flight:
        for extra in ((), ("--override", " ")):
            run = decide(flight, "arm", journal, *extra)
            words = text_of(run)
            assert run.exit_code == EXIT_INPUT
            assert (
                "there are reasons to reject correction fedcba98: flight itself calls the fit poor" in words
            )
            assert "p = 1e-126" in words and "--override REASON" in words
            assert "kincal review reject fedcba98" in words
        assert flight.commands == []
        for short, words in (("x", 1), ("do it", 2), ("- ! -", 0)):
            run = decide(flight, "arm", journal, "--override", short)
            said = f"in at least 3 words; this one has {words}"
            assert run.exit_code == EXIT_INPUT and said in text_of(run)
        assert flight.commands == []
        overridden = "reason to reject, overridden: flight itself calls the fit poor"
        run = decide(flight, "arm", journal, "--override", "the sample is at risk")
        assert run.exit_code == 0, run.output
        assert flight.overrides == [1] and overridden in run.output
        run = decide(flight, "go", journal)
        assert run.exit_code == 0, run.output
        assert "by override: the sample is at risk" in run.output and overridden in run.output
    assert flight.kin_crc == CRC
    seen, armed, approved = decided(review.check_journal(journal))
    assert (seen.verdict, seen.override) == ("poor fit", "")
    assert armed.override == approved.override == "the sample is at risk"
    listed = shell("review", "list", "--journal", journal).output
    assert "override: the sample is at risk" in " ".join(listed.split())


def test_an_override_where_there_is_nothing_to_override_is_refused(tmp_path, journal):
    see(tmp_path, journal)
    with FakeFlight(CRC) as flight:
        run = decide(flight, "arm", journal, "--override", "always")
    assert run.exit_code == EXIT_INPUT and "nothing to override" in run.output
    assert flight.commands == []


def test_a_log_that_says_better_of_a_correction_than_flight_does_is_not_believed(tmp_path, journal):
    see(tmp_path, journal)  # says change proposed
    with FakeFlight(CRC, verdict=POOR) as flight:
        run = decide(flight, "arm", journal, "--override", "because")
    assert run.exit_code == EXIT_INPUT
    assert "poor fit; the log that A. Reviewer has seen says: change proposed" in text_of(run)
    assert flight.commands == []


def test_what_waits_on_board_is_listed_with_verdict_time_left_and_choices(tmp_path, journal):
    def live(flight):
        run = good("review", "list", "--live", "--url", flight.url, "--journal", journal)
        return text_of(run)

    see(tmp_path, journal, poor())
    with FakeFlight(CRC, verdict=POOR) as flight:
        text = live(flight)
        assert "correction fedcba98 (poor fit) waits for review" in text
        assert "kincal review reject fedcba98" in text and "--override REASON" in text
        assert decide(flight, "arm", journal, "--override", "the sample waits").exit_code == 0
        text = live(flight)
        assert "armed by override of these reasons: A. Reviewer, 20" in text and ": the sample waits" in text
        assert "approval of correction fedcba98 (poor fit) is armed for another 599 s" in text
        assert "kincal review go fedcba98" in text and "kincal review arm" not in text
    with FakeFlight() as flight:
        assert "on board: nothing waits" in live(flight)


def test_dry_run_and_status_repeat_the_reasons_and_the_override(tmp_path, journal):
    """A dry run said that nothing speaks against it; why it was armed had to be looked for in the journal."""
    p = proposal()
    p.p_fit = 3e-24
    see(tmp_path, journal, p)
    with FakeFlight(CRC) as flight:

        def status():
            on = ("--url", flight.url, "--journal", str(journal), "--seconds", "0.3")
            run = shell("status", *on)
            found = json.loads(shell("status", "--json", *on).output)["journal"]
            return text_of(run), found

        reason = "reason to reject: fit is worse than the stated noise explains: p = 3e-24"
        run = decide(flight, "arm", journal, "--dry-run")
        said = text_of(run)
        assert run.exit_code == EXIT_FAILED and reason in said
        assert "not met: an override; found: none, but there are reasons to reject it" in said
        for bad in ("x", "word " * 5000):
            assert decide(flight, "arm", journal, "--dry-run", "--override", bad).exit_code == EXIT_INPUT
        run = decide(flight, "arm", journal, "--dry-run", "--override", "drift is known")
        assert run.exit_code == 0 and reason in text_of(run) and flight.commands == []
        text, found = status()
        assert reason in text and f"reason to reject: {found['reasons'][0]}" in text and not found["override"]
        assert decide(flight, "arm", journal, "--override", "drift is known").exit_code == 0
        text, found = status()
        assert reason in text and found["override"].endswith(": drift is known")
        assert f"armed by override of these reasons: {found['override']}" in text
        run = decide(flight, "go", journal, "--dry-run")
        assert run.exit_code == 0 and found["override"] in text_of(run)


def comment(journal, text, *extra, by="B. Second"):
    return shell("review", "comment", text, "--by", by, "--journal", journal, *extra)


def last_line(journal):
    return len(review.check_journal(journal))


def test_an_open_question_is_named_to_whoever_decides_until_a_comment_answers_it(tmp_path, journal):
    see(tmp_path, journal)
    run = comment(journal, "pose 7 in shadow?", "--question", "--crc", "fedcba98")
    assert run.exit_code == 0 and run.output == f"recorded in {journal}: question by B. Second\n"
    nobody = shell("review", "comment", "who says so?", "--journal", journal)
    assert nobody.exit_code == 2 and "Missing option '--by'" in nobody.output
    assert comment(journal, "who is on shift?", "--question").exit_code == 0  # about the mission
    open_ = "open question by B. Second, "
    with FakeFlight(CRC) as flight:
        run = decide(flight, "arm", journal)
        said = text_of(run)
        assert run.exit_code == EXIT_INPUT and flight.commands == []
        assert "A. Reviewer saw correction fedcba98 before this was written: question by B. Second" in said
        assert f"look at: {open_}" in see(tmp_path, journal) and "pose 7 in shadow?" in said
        assert open_ in review.check_journal(journal)[-1].why  # what was seen
        run = shell("review", "list", "--live", "--url", flight.url, "--journal", journal)
        assert f"look at: {open_}" in run.output and "shift" not in run.output.partition("Decisions")[0]
        for verb in ("arm", "go"):
            assert open_ in decide(flight, verb, journal, "--dry-run").output
            run = decide(flight, verb, journal, "--dry-run", by="C. Nobody")
            assert run.exit_code == EXIT_FAILED and "seen by C. Nobody" in run.output
            run = decide(flight, verb, journal)
            assert run.exit_code == 0 and f"note: {open_}" in run.output
    for line, *named in (("1",), ("99",), ("2", "--crc", "00001111"), ("2", "--question")):
        assert comment(journal, "no", "--answers", line, *named).exit_code == EXIT_INPUT
    run = comment(journal, "no, the mast is behind it", "--answers", "2", by="A. Reviewer")
    assert run.exit_code == 0, run.output
    last = review.check_journal(journal)[-1]
    assert (last.crc, last.answers, last.words) == ("fedcba98", 2, "comment, answers line 2")
    assert "open question" not in see(tmp_path, journal)
    # an answer may be a reason to reject: it has to be seen, too
    assert comment(journal, "was it hit?", "--question", "--crc", "fedcba98", by="A. Reviewer").exit_code == 0
    assert comment(journal, "it was: do not approve", "--answers", str(last_line(journal))).exit_code == 0
    with FakeFlight(CRC) as flight:
        run = decide(flight, "arm", journal)
        assert run.exit_code == EXIT_INPUT and flight.commands == []
        assert "do not approve" in run.output
        see(tmp_path, journal)
        assert decide(flight, "arm", journal).exit_code == 0


def test_questions_as_long_as_a_line_may_be_can_be_seen(tmp_path, journal):
    """The line of who has seen it repeated them, was longer than a line may be, and nobody could see it."""
    for n in (1, 2):
        text = f"why {n}? " + "x" * 19_900
        assert comment(journal, text, "--question", "--crc", "fedcba98").exit_code == 0
    assert "x" * 100 in see(tmp_path, journal)
    last = review.check_journal(journal)[-1]
    assert last.decision == "seen" and "why 1? xxx" in last.why and "why 2? xxx" in last.why


def test_what_was_asked_while_the_page_was_made_was_not_seen(tmp_path, journal, monkeypatch):
    """Clearance and page take seconds after the journal was read: a question of that time counted as seen."""
    see(tmp_path, journal)
    real = reviews.show

    def slow(*given):
        shown = real(*given)
        assert comment(journal, "pose 7 in shadow?", "--question", "--crc", "fedcba98").exit_code == 0
        return shown

    monkeypatch.setattr(reviews, "show", slow)
    log = ["review", "show", str(tmp_path / "run.lcmlog"), "--tables", str(BIN), "--journal", str(journal)]
    for more in ((), ("--json",)):
        run = shell(*log, "--by", "A. Reviewer", *more)
        said = text_of(run)
        assert run.exit_code == EXIT_FAILED and "while correction fedcba98 was shown to A. Reviewer" in said
        assert "question by B. Second" in said and "pose 7 in shadow?" in said
    assert [e.decision for e in review.check_journal(journal)] == ["seen", "question", "question"]
    assert shell(*log, "--by", "B. Second").exit_code == 0  # who asked knows it


def test_a_changed_journal_still_shows_what_waits_and_says_that_it_does_not_verify(tmp_path, journal):
    see(tmp_path, journal, poor())
    comment(journal, "pose 7 in shadow?", "--question", "--crc", "fedcba98")
    journal.write_text(journal.read_text().replace("in shadow", "in the sun"))
    with FakeFlight(CRC, verdict=POOR) as flight:
        on = ("--url", flight.url, "--journal", str(journal))
        listed = shell("review", "list", "--live", *on)
        status = shell("status", "--seconds", "0.3", *on)
        dry = decide(flight, "arm", journal, "--dry-run")
    assert listed.exit_code == EXIT_INPUT and status.exit_code == 0 and dry.exit_code == EXIT_FAILED
    assert "correction fedcba98 (poor fit) waits for review" in listed.output
    assert "kincal review reject fedcba98" in listed.output and f"where: {journal}:2" in listed.output
    for output in (listed.output, status.output, dry.output):
        said = " ".join(output.split())
        assert f"{journal} does not verify: the review journal was changed" in said
        assert "calls the fit poor (of a journal that does not verify)" in said
        assert "in the sun? (answer it" in said
    log = ["review", "show", str(tmp_path / "run.lcmlog"), "--tables", str(BIN), "--journal", str(journal)]
    shown = shell(*log)
    assert shown.exit_code == EXIT_INPUT and "reason to reject: flight itself calls" in shown.output
    assert f"{journal} does not verify" in shown.output


def test_commands_that_are_listed_can_be_typed(tmp_path, journal):
    """With the key file, the network and the journal of the command that lists them."""
    other = tmp_path / "my keys"
    keys.new(other)
    with FakeFlight(CRC) as flight:
        words = ["--live", "--url", flight.url, "--journal", str(journal), "--keys", str(other)]
        run = good("review", "list", *words)
        options = f" --keys '{other}' --journal {journal} --url '{flight.url}'"
        commands = re.findall(r"(kincal review (?:show|arm|go|reject) [^\n]*)", run.output)
        assert len(commands) == 4
        assert commands[0].startswith("kincal review show --live ")  # no log has to be found for it
        for command in commands:
            assert command.endswith(options), command


def test_a_poor_proposal_of_a_log_is_listed_as_waiting(tmp_path, journal):
    log = tmp_path / "run.lcmlog"
    write_log(log, waiting=poor())
    run = shell("review", "list", log, "--journal", journal, env={"COLUMNS": "200"})
    row = next(line for line in run.output.splitlines() if "fedcba98" in line)
    assert "poor fit" in row and "waits for review" in row and "below 1e-12" in row


@pytest.mark.parametrize(
    ("event", "advice"),
    [
        ("CMD_KEY", "Give sender and flight the same key file"),
        ("CMD_STATE", "docs/STATES.md"),
        ("", "`kincal review list --live` tells what waits there"),
    ],
)
def test_a_refusal_comes_with_flights_advice_for_its_reason(event, advice):
    ack = kcm.ack_t()
    ack.status, ack.event_id = -8, next((n for n in range(1, 100) if event_name(n) == event), 0)
    with pytest.raises(CommandFailed, match="APPROVE_ARM refused") as refused:
        check_ack(ack, "APPROVE_ARM", "url")
    assert refused.value.todo == f"nothing was changed on board. {refused.value.todo.partition('. ')[2]}"
    assert advice in refused.value.todo and "review show" not in refused.value.todo


def test_silence_is_a_failure_with_a_hint(journal):
    class Nobody:
        port, lock = private_port()
        url = private_url(port)

    run = decide(Nobody, "arm", journal, "--timeout", "0.3")
    Nobody.lock.close()
    assert run.exit_code == EXIT_FAILED
    assert "is the flight process running" in run.output


# ------------------------------------------------------------------------ tables over the link


@pytest.mark.parametrize("kind", ["config", "space"])
def test_uplink_and_dump_bring_the_same_bytes(kind, tmp_path):
    out = tmp_path / "back.tbl"
    with FakeFlight() as flight:
        up = good("table", "uplink", BIN / f"{kind}.tbl", "--url", flight.url)
        good("table", "dump", kind, out, "--url", flight.url)
    assert out.read_bytes() == (BIN / f"{kind}.tbl").read_bytes()
    crc = tables.load(out)[0].crc
    assert flight.commands[:1] == [(kcm.cmd_t.TABLE_VALIDATE, kind_number(kind))]
    assert flight.unsigned == []  # neither staging nor a dump can be taken from a stranger
    assert f"{crc:08x}" in up.output


# ------------------------------------------------------------------------ thresholds, state, rejected poses


def log_with(events, active=0, verdict=1):
    """A log's summary with a proposal and events (name, index, got) after it."""
    summary = LogSummary(Path("x"))
    p = proposal(verdict)
    p.t_us = 9_000_000
    summary.sessions[3] = Session(3, [progress(0)], [], sealed(p))
    summary.events = [
        LogEvent(5_000_000 + k, "info", 0, "", name, index, got)
        for k, (name, index, got) in enumerate(events)
    ]
    summary.hk = kcm.hk_t()
    summary.hk.table_crc[4] = active - (1 << 32) if active >> 31 else active
    return summary


@pytest.mark.parametrize(
    ("events", "active", "verdict", "state"),
    [
        ([("COR_PROPOSED", -1, CRC)], 0, 1, "waits for review"),
        ([("COR_PROPOSED", -1, CRC), ("COR_ARMED", -1, CRC)], 0, 1, "approval armed, not confirmed yet"),
        ([("COR_PROPOSED", -1, CRC), ("COR_REJECTED", -1, CRC)], 0, 1, "rejected"),
        ([("COR_ACTIVE", -1, CRC)], CRC, 1, "in force"),
        ([("COR_ACTIVE", -1, CRC)], 0x77, 1, "was in force; another table is now"),
        ([("COR_REJECTED", -1, 0x77)], 0, 1, "waits for review"),
        ([], 0, 0, "nothing to decide, the table in force stays"),
        ([("COR_PROPOSED", -1, CRC)], 0, 2, "waits for review"),
        ([("COR_PROPOSED", -1, CRC), ("COR_REJECTED", -1, CRC)], 0, 2, "rejected"),
    ],
)
def test_review_says_what_became_of_a_proposal(names, events, active, verdict, state):
    log = log_with(events, active, verdict)
    assert status(log, review.from_message(log.sessions[3].proposal, names)).state == state


@pytest.mark.parametrize(("source", "by"), [(1, ", approved by the executive"), (2, "")])
def test_an_approval_by_the_executive_is_said_as_no_journal_has_it(names, source, by):
    """What the ground approved is in its journal."""
    log, m = log_with([("COR_ACTIVE", -1, CRC)], CRC), kcm.cmd_t()
    m.source, m.opcode, m.arg_i = source, m.APPROVE_GO, [signed(CRC), 0, 0, 0]
    log.commands.append(m)
    assert status(log, review.from_message(log.sessions[3].proposal, names)).state == f"in force{by}"


def test_decisions_of_the_journal_stand_beside_their_proposal(names, journal, signer):
    review.record(journal, "reject", CRC, "me", "because", "url", None, signer)
    review.record(journal, "approve", 0x77, "you", "why not", "url", None, signer)
    log = log_with([])
    r = review.from_message(log.sessions[3].proposal, names)
    assert [e.why for e in status(log, r, review.check_journal(journal)).decisions] == ["because"]


@pytest.mark.parametrize(
    ("decided", "state", "waits"),
    [
        (["seen"], "waits for review", True),
        (["seen", "arm"], "waits for review; an approval was armed by me, ", True),
        (["arm", "approve"], "approved by me, ", False),
        (["arm", "reject"], "rejected by me, ", False),
    ],
)
def test_the_journal_says_what_came_after_the_end_of_the_log(names, journal, signer, decided, state, waits):
    for decision in decided:
        review.record(journal, decision, CRC, "me", "because", "url", None, signer)
    log = log_with([("COR_PROPOSED", -1, CRC)])
    r = review.from_message(log.sessions[3].proposal, names)
    about = status(log, r, review.check_journal(journal))
    assert about.state.startswith(state) and about.waits is waits
    assert bool(to_decide(r, about)) is waits
    armed = status(log_with([("COR_ARMED", -1, CRC)]), r, review.check_journal(journal))
    assert armed.waits is waits and armed.armed is waits
    in_force = log_with([("COR_ACTIVE", -1, CRC)], active=CRC)
    assert status(in_force, r, review.check_journal(journal)).state == "in force"


def test_every_number_has_its_threshold_and_whether_it_is_kept(names):
    r = review.from_message(proposal(), names)
    asked = thresholds(r, read_limits(BIN))
    assert (asked["rank"].text, asked["rank"].kept) == ("all 28 asked for", False)
    assert asked["p_fit"].kept
    assert asked["cond"].kept
    config = tomllib.loads((BIN.parent / "src" / "config.toml").read_text())
    most = config["est"]["outlier_max"]
    assert asked["n_outliers"].text == f"fewer than {most}, the most that flight rejects"
    assert [
        thresholds(replace(r, n_outliers=n), read_limits(BIN))["n_outliers"].kept for n in (most - 1, most)
    ] == [True, False]
    assert asked["p_no_change"].text.startswith(f"at most {config['no_change_p']:g}")
    bad = replace(r, numbers={**r.numbers, "fit_pos_m": 1.0, "p_fit": 1e-6}, n_outliers=99)
    wrong = {key for key, t in thresholds(bad, read_limits(BIN)).items() if t.kept is False}
    assert wrong == {"rank", "p_fit", "fit_pos_m", "n_outliers"}
    assert "no_change_p" not in thresholds(r, read_limits(Path("nowhere")))


def test_review_page_says_state_thresholds_and_rejected_poses(names):
    log = log_with([("COR_PROPOSED", -1, CRC), ("CAL_OUTLIER", 4, 0)])
    r = replace(review.from_message(log.sessions[3].proposal, names), n_outliers=1)
    about = status(log, r)
    made = review_page.page(r, [], Provenance("2026-11-22"), about, read_limits(BIN), to_decide(r, about))
    text = render(made)
    assert "Change proposed; waits for review." in text
    assert "Flight waits for a decision" in text
    shown = [
        text.index(f"kincal review {verb} ") for verb in ("show LOG --crc fedcba98", "arm", "go", "reject")
    ]
    assert shown == sorted(shown)
    assert "--override" not in text
    assert "1 of 20 poses are not in the fit. Pose: 4." in text
    assert "all 28 asked for" in text
    assert "of the same 19" in re.sub(r"<[^>]+>", "", text)


def test_review_page_of_a_poor_proposal_says_that_flight_waits_and_why_to_reject(names):
    p = poor()
    log = log_with([("COR_PROPOSED", -1, CRC)], verdict=2)
    log.sessions[3].proposal.p_fit = p.p_fit
    r = review.from_message(p, names)
    about = status(log, r)
    text = render(
        review_page.page(r, review.warnings(r), Provenance("2026-11-22"), about, None, to_decide(r, about))
    )
    assert "Poor fit; waits for review." in text
    assert "There are reasons to reject this correction: only an override" in text
    assert "Reason to reject: flight itself calls the fit poor" in text
    assert "nothing to decide" not in text
    assert "does not hold: the fit is poor" in text and "do not hold; the error can be much larger" in text
    assert text.index("kincal review reject fedcba98") < text.index("kincal review arm fedcba98")
    assert "--override REASON" in text


def test_a_chance_is_never_nothing():
    assert chance_text(0.0) == chance_text(1e-300) == "below 1e-12"
    assert (chance_text(2.5e-7), chance_text(0.5704), chance_text(1.0)) == ("2.5e-07", "0.57", "1")
