"""Real-time runs: options, checks and the JUnit report. The runs themselves are `make hil`."""

from xml.etree import ElementTree as ET

import pytest
from runs import fake_run

import kcm
from kincal_sim import hil


def hk(t_s, tx_errors=0):
    m = kcm.hk_t()
    m.t_us, m.n_tx_errors = round(t_s * 1e6), tx_errors
    return m


def state(t_s, seq):
    m = kcm.arm_state_t()
    m.t_us, m.seq = round(t_s * 1e6), seq
    return m


def numbered(cls, *seqs):
    out = []
    for seq in seqs:
        m = cls()
        m.seq = seq
        out.append(m)
    return out


@pytest.fixture
def good():
    o = hil.Outcome("paper", 12.0, {"problem": ""})
    o.messages["KC_HK"] = [hk(k) for k in range(10)]
    o.messages["KC_ARM_STATE"] = [state(0.1 * k, k) for k in range(100)]
    o.messages["KC_CMD"] = numbered(kcm.cmd_t, 1, 2)
    o.messages["KC_ACK"] = numbered(kcm.ack_t, 1, 2)
    o.messages["KC_FRAME_REQUEST"] = numbered(kcm.frame_request_t, 1, 2, 3)
    o.messages["KC_DETECTION"] = numbered(kcm.detection_t, 1, 2)
    return o


def failures(outcome):
    return {
        c.get("name"): c.find("failure").text
        for c in hil.junit([outcome]).iter("testcase")
        if c.find("failure") is not None
    }


def test_a_good_run_passes_every_check(good):
    assert failures(good) == {}


@pytest.mark.parametrize(
    "spoil, check, text",
    [
        (lambda o: o.result.update(problem="no luck"), "calibration_ends_as_expected", "no luck"),
        (
            lambda o: o.messages["KC_HK"].pop(5) and o.messages["KC_HK"].pop(5),
            "heartbeats_come_every_second",
            "3.00 s",
        ),
        (lambda o: o.messages["KC_HK"].append(hk(10, 2)), "no_message_errors", "2 send"),
        (
            lambda o: o.messages["KC_ARM_STATE"].append(state(9.95, 40)),
            "arm_states_keep_coming",
            "do not grow",
        ),
        (lambda o: o.messages["KC_ARM_STATE"].append(state(15, 400)), "arm_states_keep_coming", "5.10 s"),
        (lambda o: o.messages["KC_ACK"].pop(), "every_command_is_answered", "1 of 2"),
        (lambda o: o.messages["KC_DETECTION"].clear(), "frames_are_answered", "3 of 3"),
    ],
)
def test_each_defect_fails_its_check(good, spoil, check, text):
    spoil(good)
    assert text in failures(good)[check]


def test_a_run_that_broke_down_is_a_failure_with_its_reason():
    got = failures(hil.Outcome("paper", error="fsw ended with status 7:\n  last output"))
    assert got["calibration_ends_as_expected"].startswith("fsw ended with status 7")


def test_the_report_counts_tests_and_failures(good, tmp_path, capsys):
    bad = hil.Outcome("healthy", error="nobody there")
    tree = hil.junit([good, bad])
    tree.write(tmp_path / "junit.xml")
    suites = ET.parse(tmp_path / "junit.xml").getroot().findall("testsuite")
    assert [(s.get("name"), s.get("tests"), s.get("failures")) for s in suites] == [
        ("hil.paper", "6", "0"),
        ("hil.healthy", "6", "4"),
    ]
    assert hil.report(tree) == 4
    assert "FAIL hil.healthy calibration ends as expected: nobody there" in capsys.readouterr().out


def test_a_bench_needs_a_url():
    for flag in ("--no-sim", "--no-fsw"):
        with pytest.raises(SystemExit):
            hil.options([flag])


def test_options_say_which_processes_are_started(tmp_path):
    url = "udpm://239.255.76.67:7667?ttl=0"
    o = hil.options(["paper", "--url", url, "--no-sim", "--no-fsw", "--out", str(tmp_path)])
    (run,) = hil.plan(o)
    assert run.realtime and run.poses == hil.SHORT_POSES
    assert list(run.commands(url, tmp_path, tmp_path / "keys")) == ["detector", "executive"]
    (run,) = hil.plan(hil.options(["healthy", "--fast"]))
    commands = run.commands(url, tmp_path, tmp_path / "keys")
    assert list(commands) == ["fsw", "executive", "server"]
    assert (
        "--live" in commands["fsw"]
        and "--live" in commands["executive"]
        and "--realtime" in commands["server"]
    )


def test_a_real_time_run_goes_by_the_wall_clock(tmp_path):
    outcome = hil.run_one(fake_run(tmp_path, realtime=True))
    assert failures(outcome) == {}, outcome
    t = [m.t_us for m in outcome.messages["KC_ARM_STATE"]]
    assert 0.09e6 < (t[-1] - t[0]) / (len(t) - 1) < 0.15e6
    assert "KC_TIME" not in outcome.messages
