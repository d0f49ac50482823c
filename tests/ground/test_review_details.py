"""Review to the last detail: limits met exactly, what an approval writes down, what is refused unsent."""

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
from commands import shell
from direct_flight import DirectFlight
from places import BIN
from samples import CRC, decided, proposal, sealed, write_log

import kcm
from kincal import review
from kincal.cli.errors import EXIT_FAILED
from kincal.flight import tables as codec
from kincal.link import LogEvent, LogSummary, Session
from kincal.link.names import VERDICTS
from kincal.review import decisions, journal
from kincal.review.status import choices, proposals_in, see_first, status
from kincal.review.thresholds import read_limits, thresholds
from kincal_shared import keys
from kincal_shared.errors import BadInput, CommandFailed, KincalError

POOR = kcm.proposal_t.POOR


@pytest.fixture
def file(tmp_path):
    return tmp_path / "journal.jsonl"


@pytest.fixture
def good(names):
    """A proposal that nothing speaks against."""
    p = proposal()
    p.rank = 28
    return review.from_message(p, names)


def with_numbers(r, **numbers):
    return replace(r, numbers={**r.numbers, **numbers})


# ------------------------------------------------------------------------ what a reviewer sees


def test_a_crc_may_be_any_of_32_bits_and_has_all_its_digits():
    """Fewer digits named another correction: zeros were put before them."""
    given = ("00000000", "00000001", "FFFFFFFF", "0x1a2b3c4d", "0X1a2b3c4d")
    assert [review.parse_crc(text) for text in given] == [0, 1, 0xFFFFFFFF, 0x1A2B3C4D, 0x1A2B3C4D]
    for wrong in (
        "", "xyz", "-1", "0", "1a2b3c4", "100000000", "0x1a2b3c", "1a2b_c4d", "+1a2b3c4", " 1a2b3c4d",
        "1a2b3c4d\n",
    ):  # fmt: skip
        with pytest.raises(BadInput, match="is not a CRC\n  to do: give its eight hex digits"):
            review.parse_crc(wrong)


def test_a_coefficient_is_judged_in_sigmas_and_listed_unless_masked_and_zero(good):
    line = good.coefs[0]
    assert line.z == pytest.approx(line.value / line.sigma) and abs(line.z) > 1.0
    assert good.coefs[30].z == 0.0
    assert [c.idle for c in good.coefs[27:30]] == [False, True, True]
    assert not replace(good.coefs[30], value=0.1).idle
    assert {c.name for c in good.estimated} == {c.name for c in good.coefs[:28]} - {good.coefs[26].name}
    assert all(c.sigma > 0.0 for c in good.estimated)


def test_every_confounded_coefficient_is_named_but_never_itself(names):
    p = proposal()
    p.confounded[3] = 0b1101100
    r = review.from_message(p, names)
    assert r.coefs[3].confounded == tuple(names[k] for k in (2, 5, 6))
    assert r.coefs[4].confounded == ()


def test_a_log_with_more_coefficients_than_the_table_numbers_the_rest(names):
    r = review.from_message(proposal(n_coef=len(names)), names[:50])
    assert [c.name for c in r.coefs[49:52]] == [names[49], "coef[50]", "coef[51]"]


@pytest.mark.parametrize("field", ["value", "sigma", "cov"])
def test_numbers_that_are_not_finite_are_named_up_to_the_last_one_used(names, field):
    p, last = proposal(n_coef=54), 54 * 55 // 2 if field == "cov" else 54
    getattr(p, field)[last] = math.nan  # nobody reads that
    review.from_message(p, names)
    getattr(p, field)[last - 1] = math.inf
    with pytest.raises(BadInput, match=f"no finite numbers: {field}"):
        review.from_message(p, names)


def test_of_many_damaged_numbers_four_are_named(names):
    p = proposal()
    for key in ("chi2", "p_fit", "kkt", "cond", "pred_pos_m"):
        setattr(p, key, math.nan)
    with pytest.raises(BadInput) as error:
        review.from_message(p, names)
    assert error.value.what.endswith("chi2, p_fit, cond, kkt")


def test_at_its_limit_a_fit_is_good_and_beyond_there_is_a_reason_to_reject(good):
    least = review.P_FIT_MIN
    assert least == 1e-3
    assert review.reasons_to_reject(with_numbers(good, p_fit=least)) == []
    (bad,) = review.reasons_to_reject(with_numbers(good, p_fit=0.99 * least))
    assert "p = 0.00099" in bad
    same = good.numbers["before_pos_m"]
    assert review.reasons_to_reject(with_numbers(good, fit_pos_m=same)) == []
    assert review.reasons_to_reject(with_numbers(good, fit_pos_m=1.01 * same)) == [
        "residual after the fit is larger than before"
    ]
    assert len(review.reasons_to_reject(with_numbers(good, fit_pos_m=math.nan))) == 1
    both = replace(with_numbers(good, p_fit=0.0), verdict=VERDICTS["POOR"])
    assert len(review.reasons_to_reject(both)) == 2


def test_held_coefficients_bounds_and_one_outlier_are_said(good):
    def held(r, *which, status="held"):
        return tuple(replace(c, status=status) if k in which else c for k, c in enumerate(r.coefs))

    assert review.warnings(replace(good, coefs=held(good))) == []
    of_rank = review.warnings(with_numbers(replace(good, coefs=held(good, 1, 2)), rank=26))
    assert of_rank == [
        f"rank 26 of 28; held: {good.coefs[1].name}, {good.coefs[2].name}, {good.coefs[26].name}"
    ]
    plain = tuple(replace(c, status="estimated") for c in good.coefs)
    assert review.warnings(with_numbers(replace(good, coefs=plain), rank=27)) == ["rank 27 of 28; held: none"]
    at = replace(good, coefs=held(good, 0, 3, status="at a bound"))
    assert review.warnings(at) == [f"at a bound: {good.coefs[0].name}, {good.coefs[3].name}"]
    assert review.warnings(replace(good, n_outliers=1)) == ["1 of 20 poses rejected as outliers"]


@pytest.mark.parametrize(
    ("key", "limit", "beyond"),
    [
        ("rank", 28, 27), ("dof", 1, 0), ("p_fit", 1e-3, 9e-4), ("fit_pos_m", 3e-2, 3.1e-2),
        ("fit_rot_rad", 5e-2, 5.1e-2), ("cond", "widest", 1.01), ("p_no_change", "most", 1.01),
    ],
)  # fmt: skip
def test_a_threshold_is_kept_up_to_its_value(good, key, limit, beyond):
    limits = read_limits(BIN)
    named = {"widest": 1.0 / limits.rank_tol, "most": limits.no_change_p}
    if isinstance(limit, str):
        limit, beyond = named[limit], beyond * named[limit]
    assert thresholds(with_numbers(good, **{key: limit}), limits)[key].kept is True
    assert thresholds(with_numbers(good, **{key: beyond}), limits)[key].kept is False
    assert thresholds(good, None).keys() == thresholds(good, limits).keys() - {
        "p_no_change",
        "cond",
        "n_outliers",
    }


@pytest.mark.parametrize(
    ("verdict", "p_fit", "holds"),
    [("CHANGE", 0.57, True), ("CHANGE", 1e-6, False), ("POOR", 0.57, False), ("NO_CHANGE", 0.57, True)],
)
def test_what_comes_from_the_covariance_holds_for_a_good_fit_only(good, verdict, p_fit, holds):
    """The review of a poor fit showed a bound of the error as if it held."""
    r = with_numbers(replace(good, verdict=VERDICTS[verdict]), p_fit=p_fit)
    void = {key for key, asked in thresholds(r, read_limits(BIN)).items() if not asked.holds}
    names = {f"{what}_{unit}" for unit in ("pos_m", "rot_rad")
             for what in ("pred", "pred_camera", "pred_lander", "pred_noise", "bound")}  # fmt: skip
    assert void == (set() if holds else names | {"p_no_change", "confidence", "n_checked"})


def tables_that_stop(folder, **changes):
    """Folder with a CONFIG table that ends a calibration when it is good enough."""
    _, config = codec.decode_as("config", (BIN / "config.tbl").read_bytes())
    config.stop_pos_m = 0.002
    for name, value in changes.items():
        setattr(config, name, value)
    (folder / "config.tbl").write_bytes(codec.encode("config", config).data)
    return folder


@pytest.mark.parametrize(
    ("changes", "tested_early", "text", "kept_up_to"),
    [
        ({}, True, "at most 0.005 for a change", 0.005),
        ({}, False, "at most 0.01 for a change (0.005 if it was tested before)", 0.01),
        ({"no_change_power": 0.0}, True, "at most 0.01 for a change", 0.01),
        ({"stop_pos_m": 0.0}, False, "at most 0.01 for a change", 0.01),
    ],
)
def test_a_table_that_is_tested_before_the_end_is_tested_at_half_its_level(
    tmp_path, good, changes, tested_early, text, kept_up_to
):
    """The review asked for the whole level, and called a change right that flight had refused."""
    limits = read_limits(tables_that_stop(tmp_path, **changes))
    r = replace(good, tested_early=tested_early)
    for p, kept in ((kept_up_to, True), (1.01 * kept_up_to, False)):
        asked = thresholds(with_numbers(r, p_no_change=p), limits)["p_no_change"]
        assert (asked.text, asked.kept) == (text, kept)


def test_an_end_says_whether_the_table_in_force_was_tested_before(names):
    p = proposal()
    for ended, expected in ((1, True), (2, True), (3, False), (0, False)):
        p.ended = ended
        assert review.from_message(p, names).tested_early is expected


def test_an_accuracy_that_a_poor_fit_states_is_not_reached(names):
    """A calibration of one joint ended by its bound with a fit that was poor, and the review said only that
    the required accuracy was reached."""
    p = proposal()
    said = {}
    for verdict in (p.CHANGE, p.POOR):
        p.verdict = verdict
        said[verdict] = review.from_message(p, names).ended
    assert said[p.CHANGE] == "the required accuracy is reached at the required confidence"
    assert said[p.POOR] == said[p.CHANGE] + " by a fit that is poor: its accuracy does not count"
    p.ended = 3
    assert review.from_message(p, names).ended == "all requested poses are measured"


def test_where_nothing_changes_any_chance_of_that_is_right(good):
    unchanged = with_numbers(replace(good, verdict="no change"), p_no_change=1.0)
    assert not unchanged.changes_something
    assert thresholds(unchanged, read_limits(BIN))["p_no_change"].kept is True


def test_the_last_proposal_is_shown_and_any_by_its_crc(tmp_path, monkeypatch):
    first, second = proposal(), proposal()
    second.session, second.crc = 4, 0x77
    sessions = {3: Session(3, [], [], first), 4: Session(4, [], [], sealed(second))}
    log = LogSummary(Path("x"), sessions=sessions)
    monkeypatch.setattr(review, "read_log", lambda _path, _channels: log)
    assert review.find(tmp_path, None, BIN).crc == 0x77
    assert review.find(tmp_path, f"{CRC:08x}", BIN).session == 3


def test_a_covariance_of_other_standard_deviations_is_refused():
    """The CRC covers the standard deviations, not the covariance beside them."""
    p = proposal()
    assert review.from_message(p, []).crc == CRC
    p.cov = [x * 1e-4 for x in p.cov]
    with pytest.raises(BadInput, match="covariance is not that of the standard deviations"):
        review.from_message(p, [])
    p.cov = [0.0] * len(p.cov)  # of an estimate that was not solved flight states none
    assert not review.from_message(p, []).correlation.any()


def test_names_need_the_terms_table(tmp_path):
    with pytest.raises(BadInput, match="no terms table"):
        review.coef_names(tmp_path)


# ------------------------------------------------------------------------ the state of a proposal


def log_with(*events, begin_us=1_000_000):
    p, first = proposal(), kcm.progress_t()
    p.t_us, first.t_us = 9_000_000, begin_us
    summary = LogSummary(Path("x"), sessions={3: Session(3, [first], [], sealed(p))})
    summary.events = [LogEvent(t_us, "info", 0, "", name, index, CRC) for t_us, name, index in events]
    return summary


def test_an_approval_that_expired_can_be_armed_again(good):
    log = log_with((9_500_000, "COR_ARMED", -1))
    assert (status(log, good).armed, status(log, good).waits) == (True, True)
    log = log_with((9_500_000, "COR_ARMED", -1), (9_600_000, "COR_EXPIRED", -1))
    about = status(log, good)
    assert (about.armed, about.waits) == (False, True)
    assert about.state == "waits for review; an approval was armed and expired"
    back = log_with((9_500_000, "COR_ROLLBACK", -1))
    back.hk = kcm.hk_t()
    back.hk.table_crc[review.KIN_KIND] = proposal().crc
    assert status(back, good).state == "in force again after a rollback"


def test_a_list_has_the_numbers_of_each_proposal(tmp_path, signer, file):
    log = tmp_path / "run.lcmlog"
    write_log(log, waiting=proposal())
    (one,) = proposals_in(log)
    assert (one.crc, one.session, one.n_poses) == (CRC, 3, 20)
    assert (one.p_fit, one.before_pos_m, one.fit_pos_m) == (0.57, 3e-2, 4e-4)
    assert one.state.startswith("waits")
    other = review.record(file, "reject", 0x77, "me", "b", "url", None, signer)
    mine = review.record(file, "reject", CRC, "me", "b", "url", None, signer)
    assert proposals_in(log, [other])[0].state == one.state
    assert proposals_in(log, [other, mine])[0].state.startswith("rejected by me")


def test_the_likeliest_choice_comes_first_and_doubt_asks_for_an_override():
    def verbs(*given, **more):
        return [c.command.split()[2] for c in choices(CRC, *given, **more)]

    def overrides(*given, **more):
        return [c.command.split()[2] for c in choices(CRC, *given, **more) if "--override" in c.command]

    change = VERDICTS["CHANGE"]
    assert verbs(change, []) == ["arm", "go", "reject"] and overrides(change, []) == []
    assert verbs(change, ["bad"]) == ["reject", "arm", "go"] and overrides(change, ["bad"]) == ["arm"]
    assert verbs("", []) == ["reject", "arm", "go"] and overrides("", []) == ["arm"]
    assert verbs(change, [], armed=True) == ["go", "reject"]
    for reasons in ([], ["bad"]):
        said = " ".join(c.what for c in choices(CRC, change, reasons))
        assert ("in spite of the reasons to reject it" in said) == bool(reasons)
    assert all(c.command.endswith(" --keys k") for c in choices(CRC, change, [], options=" --keys k"))
    assert see_first(CRC).command == f"kincal review show LOG --crc {CRC:08x} --by NAME"


# ------------------------------------------------------------------------ decisions


def operator(file, by="A. Reviewer", **more):
    said = []
    return decisions.Operator(by, "clean", file, say=said.append, **more), said


def seen(file, r, signer, by="A. Reviewer"):
    return decisions.see(file, r, by, Path("run.lcmlog"), signer)


def test_what_was_seen_stands_with_numbers_verdict_and_what_stood_out(file, good, signer):
    assert seen(file, good, signer).why == "nothing stood out"
    entry = seen(file, replace(good, n_outliers=2), signer, by="B. Second")
    assert (entry.decision, entry.by, entry.crc) == ("seen", "B. Second", f"{CRC:08x}")
    assert entry.why == "2 of 20 poses rejected as outliers"
    assert (entry.numbers, entry.verdict, entry.session) == (good.numbers, good.verdict, 3)
    assert entry.url == str(Path("run.lcmlog").resolve())
    with pytest.raises(BadInput, match="a name and a reason"):
        seen(file, good, signer, by="  ")


def test_a_clean_correction_is_armed_without_an_override_and_put_in_force(file, good, signer):
    flight = DirectFlight(signer).waits(CRC)
    seen(file, good, signer)
    who, said = operator(file)
    now = decisions.arm(flight, f"{CRC:08x}", who)
    assert (now.crc, now.armed, now.left_s) == (CRC, True, pytest.approx(599.0))
    assert any("within 599 s" in text for text in said)
    assert flight.commands[0].arg_i[1] == 0
    decisions.go(flight, f"{CRC:08x}", who)
    assert [c.opcode for c in flight.commands] == [kcm.cmd_t.APPROVE_ARM, kcm.cmd_t.APPROVE_GO]
    written = decided(review.check_journal(file, signer.known))
    assert [e.decision for e in written] == ["seen", "arm", "approve"]
    assert [e.counter for e in written[1:]] == [c.counter for c in flight.commands]
    assert all(e.override == "" and e.numbers == good.numbers for e in written)
    assert any(text.startswith("armed by A. Reviewer") for text in said)
    assert not any("override" in text for text in said)
    assert f"correction {CRC:08x} is in force" in said
    assert said.count(f"recorded in {file}") == 2


@pytest.mark.parametrize("act", [decisions.arm, decisions.go, decisions.reject])
def test_a_decision_without_a_name_is_refused_before_flight_is_asked(file, act, signer):
    flight = DirectFlight(signer).waits(CRC)
    who, _ = operator(file, by=" ")
    with pytest.raises(BadInput, match="a name and a reason"):
        act(flight, f"{CRC:08x}", who)
    assert not flight.commands and flight.now_s == 0.0 and not file.exists()


@pytest.mark.parametrize("act", [decisions.arm, decisions.go, decisions.reject])
def test_nothing_is_decided_about_the_crc_0_by_which_flight_says_that_nothing_waits(file, act, signer):
    flight = DirectFlight(signer)
    who, _ = operator(file)
    with pytest.raises(BadInput, match="no correction has the CRC 00000000"):
        act(flight, "00000000", who)
    assert not flight.commands and not file.exists()


def test_what_is_asked_while_housekeeping_is_waited_for_is_looked_at_first(file, good, signer):
    asked = []

    class Slow(DirectFlight):
        def next(self, timeout_s):
            if not asked:
                asked.append(review.record(file, "question", CRC, "B", "in shadow?", "", None, signer))
            return super().next(timeout_s)

    flight = Slow(signer).waits(CRC)
    seen(file, good, signer)
    who, _ = operator(file)
    for decide in (decisions.arm, decisions.go):
        with pytest.raises(BadInput, match="before this was written: question by B.*in shadow"):
            decide(flight, f"{CRC:08x}", who)
        assert flight.commands == []
        flight.waits(CRC, state=10)
        asked.clear()
        seen(file, good, signer)
    assert [e.decision for e in review.check_journal(file)].count("refused") == 2


def test_a_refusal_that_quotes_long_words_stands_in_the_journal(file, good, signer):
    """It was too long for a line: the error said so instead of what was wrong, and the attempt had no end."""
    flight = DirectFlight(signer).waits(CRC)
    seen(file, good, signer)
    for n in range(40):
        review.record(file, "question", CRC, "B", f"why {n}? " + "x" * 19_900, "", None, signer)
    with pytest.raises(BadInput, match="before this was written: question by B.*why 0.*why 39") as error:
        decisions.arm(flight, f"{CRC:08x}", operator(file)[0])
    assert len(str(error.value)) < 20_000 and flight.commands == []
    entries = review.check_journal(file)
    assert entries[-1].decision == "refused" and journal.unfinished(entries) == []


def test_what_flight_took_and_no_line_can_hold_is_said(file, good, signer, monkeypatch):
    """The journal is full between attempt and outcome."""
    flight = DirectFlight(signer).waits(CRC)
    seen(file, good, signer)
    who, said = operator(file)
    real = journal.append

    def full(path, entry, key, check=None):
        if entry.decision == "arm":
            raise BadInput("no space", str(path))
        return real(path, entry, key, check)

    monkeypatch.setattr(journal, "append", full)
    with pytest.raises(KincalError):
        decisions.arm(flight, f"{CRC:08x}", who)
    assert "NOT in the journal: no space" in said
    assert len(flight.commands) == 1


def test_the_override_of_the_first_step_is_said_and_kept_at_the_second(file, good, signer):
    flight = DirectFlight(signer).waits(CRC, POOR)
    poor = replace(good, verdict=VERDICTS["POOR"])
    seen(file, poor, signer)
    who, said = operator(file)
    for none in ("", "   "):
        with pytest.raises(BadInput, match="flight itself calls the fit poor"):
            decisions.arm(flight, f"{CRC:08x}", who, none)
    assert flight.commands == []
    decisions.arm(flight, f"{CRC:08x}", who, "sample at risk")
    assert flight.commands[0].arg_i[1] == decisions.OVERRIDE == 1
    decisions.go(flight, f"{CRC:08x}", who)
    assert "by override: sample at risk" in said
    assert [e.override for e in decided(review.check_journal(file))] == [
        "",
        "sample at risk",
        "sample at risk",
    ]


def test_a_first_step_overrides_nothing_unless_it_is_asked_to(signer):
    flight = DirectFlight(signer).waits(CRC)
    decisions.send_arm(flight, CRC, 1.0)
    assert flight.commands[0].arg_i[1] == 0


def test_of_a_first_step_that_was_taken_twice_the_second_one_counts(file, good, signer):
    flight = DirectFlight(signer).waits(CRC)
    who = {by: operator(file, by) for by in ("A. Reviewer", "B. Second")}
    for by in who:
        flight.hk.state = 9  # the first one has expired
        seen(file, good, signer, by)
        decisions.arm(flight, f"{CRC:08x}", who[by][0])
    first, said = who["A. Reviewer"]
    decisions.go(flight, f"{CRC:08x}", first)
    assert [text.partition(",")[0] for text in said if "armed by" in text] == ["armed by B. Second"]


def test_a_verdict_that_flight_has_lost_is_a_reason_besides_those_that_were_seen(file, good, signer):
    flight = DirectFlight(signer).waits(CRC, 0)
    seen(file, replace(good, verdict=VERDICTS["POOR"]), signer)
    with pytest.raises(BadInput) as error:
        decisions.arm(flight, f"{CRC:08x}", operator(file)[0])
    assert "calls the fit poor (its numbers do not say why" in str(error.value)
    assert "CAL_EST before it); flight has lost its verdict" in str(error.value)
    assert decisions.on_board(flight).verdict == "" and flight.commands == []
    decisions.arm(flight, f"{CRC:08x}", operator(file)[0], "the log has it")
    assert flight.commands[0].arg_i[1] == decisions.OVERRIDE


def test_a_decision_has_to_be_signed(file, good, signer):
    seen(file, good, signer)
    with pytest.raises(BadInput, match="has to be signed"):
        decisions.arm(DirectFlight().waits(CRC), f"{CRC:08x}", operator(file)[0])


@pytest.mark.parametrize("act", [decisions.arm, decisions.go, decisions.reject])
def test_what_waits_is_said_where_it_is_another_one(file, good, signer, act):
    seen(file, good, signer)
    who, _ = operator(file)
    with pytest.raises(CommandFailed, match=f"{CRC:08x} does not wait on board; 00000077 does"):
        act(DirectFlight(signer).waits(0x77), f"{CRC:08x}", who)
    with pytest.raises(CommandFailed, match="nothing does"):
        act(DirectFlight(signer), f"{CRC:08x}", who)
    _, *refused = review.check_journal(file)
    assert [(e.decision, e.crc) for e in refused] == [("refused", f"{CRC:08x}")] * 2
    assert "00000077 does" in refused[0].why


def test_the_first_step_is_refused_where_it_was_taken_and_the_second_where_it_was_not(file, good, signer):
    seen(file, good, signer)
    flight = DirectFlight(signer).waits(CRC, state=10)
    flight.hk.approval_left_us = 60_000_000
    with pytest.raises(CommandFailed, match="armed already, for another 60 s"):
        decisions.arm(flight, f"{CRC:08x}", operator(file)[0])
    with pytest.raises(CommandFailed, match=r"is not armed \(or has expired\)") as error:
        decisions.go(DirectFlight(signer).waits(CRC), f"{CRC:08x}", operator(file)[0])
    assert f"kincal review arm {CRC:08x}" in str(error.value) and flight.commands == []


def test_who_has_seen_it_is_named_to_who_has_not(file, good, signer):
    seen(file, good, signer, by="B. Second")
    seen(file, replace(good, crc=0x77), signer, by="C. Third")
    with pytest.raises(BadInput) as error:
        decisions.arm(DirectFlight(signer).waits(CRC), f"{CRC:08x}", operator(file)[0])
    assert error.value.what == f"A. Reviewer has not seen correction {CRC:08x} (seen by B. Second)"
    flight = DirectFlight(signer).waits(CRC)
    decisions.arm(flight, f"{CRC:08x}", operator(file, by=" b. second ")[0])
    with pytest.raises(BadInput, match="A. Reviewer has not seen"):
        decisions.go(flight, f"{CRC:08x}", operator(file)[0])
    seen(file, good, signer)
    decisions.go(flight, f"{CRC:08x}", operator(file)[0])


@pytest.mark.parametrize(
    ("act", "opcode", "decision", "text"),
    [
        (decisions.go, kcm.cmd_t.APPROVE_GO, "approve", "was not seen in housekeeping"),
        (decisions.reject, kcm.cmd_t.REJECT, "reject", "the end of the proposal did not come"),
    ],
)
def test_what_flight_took_is_written_even_if_what_it_brings_is_not_seen(
    file, good, signer, act, opcode, decision, text
):
    seen(file, good, signer)
    flight = DirectFlight(signer).waits(CRC, state=10)
    flight.ignores = {opcode}
    with pytest.raises(CommandFailed, match=text):
        act(flight, f"{CRC:08x}", operator(file, timeout_s=1.0)[0])
    assert [e.decision for e in decided(review.check_journal(file))] == ["seen", decision]


@pytest.mark.parametrize("opcode", ["APPROVE_ARM", "APPROVE_GO", "REJECT"])
def test_what_flight_refused_is_written_as_refused(file, good, signer, opcode):
    seen(file, good, signer)
    flight = DirectFlight(signer).waits(CRC, state=9 if opcode == "APPROVE_ARM" else 10)
    flight.refuse = {getattr(kcm.cmd_t, opcode): (-8, 13)}
    act = {"APPROVE_ARM": decisions.arm, "APPROVE_GO": decisions.go, "REJECT": decisions.reject}[opcode]
    with pytest.raises(CommandFailed, match=f"{opcode} refused.*CMD_STATE"):
        act(flight, f"{CRC:08x}", operator(file)[0])
    lines = review.check_journal(file)
    assert [(e.decision, e.command) for e in lines] == [
        ("seen", ""),
        ("attempt", opcode),
        ("refused", opcode),
    ]
    assert f"{opcode} refused" in lines[-1].why and "CMD_STATE" in lines[-1].why


def test_a_decision_that_is_not_answered_is_written_as_that(file, good, signer):
    seen(file, good, signer)
    flight = DirectFlight(signer).waits(CRC)
    flight.publish = lambda _channel, _message: None
    with pytest.raises(CommandFailed, match="answer to APPROVE_ARM did not come"):
        decisions.arm(flight, f"{CRC:08x}", operator(file, timeout_s=1.0)[0])
    assert [e.decision for e in review.check_journal(file)] == ["seen", "attempt", "unanswered"]


@pytest.mark.parametrize("ends", [KeyboardInterrupt, SystemExit])
def test_a_program_that_ends_between_command_and_answer_leaves_a_trace(file, good, signer, ends):
    seen(file, good, signer)
    flight = DirectFlight(signer).waits(CRC)

    def publish(channel, message):
        DirectFlight.publish(flight, channel, message)
        raise ends

    flight.publish = publish
    with pytest.raises(ends):
        decisions.arm(flight, f"{CRC:08x}", operator(file)[0])
    assert [e.decision for e in review.check_journal(file)] == ["seen", "attempt", "unanswered"]
    assert len(flight.commands) == 1


def test_a_rejection_keeps_the_numbers_that_its_author_has_seen(file, good, signer):
    decisions.reject(DirectFlight(signer).waits(CRC), f"{CRC:08x}", operator(file)[0])
    seen(file, good, signer)
    decisions.reject(DirectFlight(signer).waits(CRC), f"{CRC:08x}", operator(file)[0])
    first, _, second = decided(review.check_journal(file))
    assert (first.numbers, first.session) == ({}, None)
    assert (second.numbers, second.session) == (good.numbers, 3)


# ------------------------------------------------------------------------ journal


def record(file, signer, crc=CRC, decision="reject", by="me"):
    return review.record(file, decision, crc, by, "because", "url", None, signer)


def test_what_was_seen_is_found_by_name_and_crc_and_the_last_one_counts(file, signer):
    record(file, signer, decision="seen", by="Me ")
    last = record(file, signer, decision="seen", by="me")
    record(file, signer, decision="seen", by="other")
    record(file, signer, crc=0x77, decision="seen", by="me")
    record(file, signer)
    read = journal.read(file, signer.known)
    assert read.seen_by("ME", f"{CRC:08x}") == last
    assert read.seen_by("nobody", f"{CRC:08x}") is None
    assert journal.read(file).seen_by("me", f"{CRC:08x}") is None  # without the key nobody vouches for it


def test_who_vouches_is_said_with_the_lines(file, signer):
    assert journal.read(file, signer.known).vouched == "nothing to check"
    record(file, signer)
    assert journal.read(file, signer.known).vouched == "each line from the holder of the key"
    assert journal.read(file).vouched.startswith("line 1: nobody can tell")
    record(file, signer)
    assert journal.read(file).vouched.startswith("lines 1 to 2: nobody can tell")
    other = keys.Key(signer.key.id + 1, b"x" * 32)
    assert f"does not have key {signer.key.id}" in journal.read(file, [other]).vouched


def test_a_folder_is_made_for_its_owner_only_and_a_journal_too(tmp_path, signer):
    file = tmp_path / "a" / "b" / "journal.jsonl"
    record(file, signer)
    assert file.parent.stat().st_mode & 0o777 == 0o700
    assert file.stat().st_mode & 0o777 == 0o600


def test_a_line_counts_how_many_before_it_nobody_vouched_for(file, signer):
    record(file, signer)
    other = keys.Signer(keys.Key(signer.key.id + 1, b"x" * 32), keys.counting())
    assert record(file, other).unconfirmed == 1
    assert record(file, other).unconfirmed == 0
    flight = DirectFlight(signer)
    flight.send("NOOP")
    assert [e.counter for e in review.check_journal(file)] == [0, 0, 0]


def test_an_entry_of_the_wrong_types_is_damage(file, signer):
    record(file, signer)
    fields = json.loads(file.read_text())
    for key, wrong in (("by", 1), ("session", "3"), ("numbers", []), ("key_id", "1"), ("counter", None)):
        file.write_text(json.dumps({**fields, key: wrong}, sort_keys=True) + "\n")
        with pytest.raises(KincalError, match="damaged"):
            journal.read(file)


def test_one_journal_of_two_that_nobody_vouches_for_is_enough_to_fail(tmp_path, key_file):
    mine, log = tmp_path / "mine.jsonl", tmp_path / "run" / "run.lcmlog"
    log.parent.mkdir()
    write_log(log)
    record(mine, keys.signer_of(key_file))
    stranger = keys.Signer(keys.Key(9, b"y" * 32), keys.counting())
    record(log.with_name(journal.NAME), stranger)
    given = ["--journal", str(mine), "--keys", str(key_file)]
    assert shell("audit", "verify", *given).exit_code == 0
    run = shell("audit", "verify", log, *given)
    assert run.exit_code == EXIT_FAILED
    assert f"{mine}: 1 decisions and commands in 1 lines, each line from the holder of the key" in run.output
