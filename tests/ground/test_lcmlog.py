"""Log summaries."""

import json

import pytest
from commands import good, shell
from samples import image, write_log

from kincal import link
from kincal.flight import library
from kincal.link import channels
from kincal.link.eventfile import event_bytes
from kincal_shared.errors import KincalError


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "run.lcmlog"
    write_log(path)
    return path


def test_summary_counts_and_orders_what_is_there(log):
    s = link.read_log(log)
    assert s.counts["KC_PROGRESS"] == 3
    assert s.counts["KC_IMAGE"] == 1
    assert s.counts["SOMETHING_ELSE"] == 1
    assert [p.pose for p in s.sessions[3].progress] == [1, 2, 3]
    assert s.sessions[3].proposal.n_poses == 20
    assert s.mission_s == pytest.approx(8.5)


def test_damaged_message_is_counted_and_the_rest_is_read(log):
    s = link.read_log(log)
    assert s.undecodable == {"KC_HK": 1}
    assert s.hk.boot_count == 2


@pytest.mark.parametrize("n_bytes", [-1, 104, 1 << 30])
def test_an_image_that_counts_other_bytes_than_it_has_is_damaged(tmp_path, n_bytes):
    """LCM's decoder takes whatever follows for the JPEG."""
    good = image(7).encode()
    bad = good[:28] + n_bytes.to_bytes(4, "big", signed=True) + good[32:]
    path = tmp_path / "x.lcmlog"
    path.write_bytes(
        b"".join(event_bytes(n, n, "KC_IMAGE", data) for n, data in ((4, good), (9, bad), (12, good[:31])))
    )
    s = link.read_log(path)
    assert (s.counts["KC_IMAGE"], s.undecodable, s.undecodable_at) == (
        3,
        {"KC_IMAGE": 2},
        {"KC_IMAGE": [9, 12]},
    )
    said = shell("log", path).output
    assert "3 (2 damaged: events 9, 12)" in said
    with pytest.raises(ValueError, match=f"n_bytes is {n_bytes}, 103 bytes follow"):
        channels.decode("KC_IMAGE", bad)
    assert channels.decode("KC_IMAGE", good).jpeg == image(7).jpeg


def test_of_many_damaged_events_the_first_five_are_named(tmp_path):
    path = tmp_path / "x.lcmlog"
    path.write_bytes(b"".join(event_bytes(n, n, "KC_HK", b"no housekeeping") for n in range(7)))
    said = shell("log", path).output
    assert "7 (7 damaged: events 0, 1, 2, 3, 4, ...)" in said


def test_events_come_in_words_with_their_values(log):
    texts = [e.text for e in link.read_log(log).events]
    assert texts[0] == "BOOT: flight software started, boot 2"
    assert texts[1] == "CAL_TAGS_LOST: tags not detected at candidate 11 after 24 search positions"


def test_printed_summary_hides_debug_events_unless_asked(log):
    run = good("log", log)
    assert "CAL_TAGS_LOST" in run.output
    assert "DET_NONE" not in run.output
    assert "fedcba98" in run.output
    assert "DET_NONE" in shell("log", log, "--debug").output


def test_json_summary_is_json(log):
    doc = json.loads(shell("log", log, "--json").output)
    assert doc["sessions"][0]["proposal"]["crc"] == "fedcba98"
    assert doc["refused"] == 1
    assert doc["state"] == "REVIEW"
    assert doc["table_crc"] == {"4": "fedcba98"}


@pytest.mark.parametrize("content", [b"", b"this is not a log at all, only some text " * 4])
def test_file_without_messages_is_refused(tmp_path, content):
    path = tmp_path / "x.lcmlog"
    path.write_bytes(content)
    with pytest.raises(KincalError, match="no LCM messages"):
        link.read_log(path)


def test_every_number_of_the_headers_has_a_name():
    flight, names = library("flight"), link.names
    verdicts = flight.enum("kc_verdict_t", "KC_VERDICT_").values()
    assert [names.verdict_name(n) for n in verdicts] == ["no change needed", "change proposed", "poor fit"]
    assert [names.verdict_key(n) for n in verdicts] == ["no_change", "change", "poor"]
    severities = flight.enum("kc_severity_t", "KC_SEV_").values()
    assert [names.severity_name(n) for n in severities] == ["debug", "info", "warning", "error"]
    assert [names.acquisition_name(n) for n in range(5)] == ["ucb", "random", "dopt", "vopt", "rate"]
    status = [names.coef_status_name(n) for n in range(5)]
    assert status == ["estimated", "masked", "held", "at lower bound", "at upper bound"]
    assert names.state_name(99) == "?99"
    with pytest.raises(KeyError):
        names.opcode("NONSENSE")
