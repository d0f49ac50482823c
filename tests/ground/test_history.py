"""The history of a mission's tables: from recordings, each read once, and as a page."""

import json
import sys

import pytest
from commands import good
from places import BIN
from samples import sealed, signed

import kcm
from kincal import tables
from kincal.console.geometry import Geometry
from kincal.console.past import Past
from kincal.console.picture import Picture
from kincal.console.shelf import Shelf
from kincal.flight import Terms
from kincal.link.eventfile import event_bytes
from kincal.pages import history as pages
from kincal.pages.page import Provenance
from kincal.review import history

URL = "udpm://239.255.76.67:7667?ttl=0"
T0 = 1.8e9
IMAGE, TERMS = tables.load(BIN / "terms.tbl")
NAMES = list(Terms.of_table(TERMS).names)


def hk(kin=0, state=0, joint=0, bias=0.0):
    m = kcm.hk_t()
    m.table_crc[4] = signed(kin)
    m.mon_state, m.mon_joint, m.mon_bias, m.mon_sigma = state, joint, bias, 1e-3
    return "KC_HK", m


def proposal(crc, value, session=1, terms=IMAGE.crc):
    m = kcm.proposal_t()
    m.crc, m.session, m.crc_terms, m.n_coef = signed(crc), session, signed(terms), len(NAMES)
    m.value[0], m.sigma[0] = value, 1e-3
    return "KC_PROPOSAL", sealed(m)


def log(path, *rows):
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("ab") as file:
        for t, (channel, message) in rows:
            file.write(event_bytes(1, int((T0 + t) * 1e6), channel, message.encode()))
    return path


def test_what_was_in_force_and_what_each_correction_said(tmp_path):
    one = log(tmp_path / "a.lcmlog", (1, hk(0xA)), (2, hk(0xA)), (3, proposal(0xB, 0.02)), (4, hk(0xB)))
    two = log(tmp_path / "b.lcmlog", (9, hk(0xB)), (10, proposal(0xC, 0.03, 2)), (11, hk(0xB)), (12, hk(0xA)))
    parts = [history.go_on(history.History(), path) for path in (two, one)]
    found = history.joined(parts)
    kin = [(x.utc_s - T0, x.crc) for x in found.in_force if x.kind == "KIN"]
    assert kin == [(1, "0000000a"), (4, "0000000b"), (12, "0000000a")]
    assert [c.crc for c in found.corrections] == ["0000000b", "0000000c"]
    said = [found.what(x) for x in found.in_force if x.kind == "KIN"]
    assert said[0] == said[2] == history.NO_PROPOSAL and said[1].startswith("correction of session 1")
    assert {history.decided(x, []) for x in found.in_force} == {history.NOBODY}
    (trend,) = history.trends(found, {IMAGE.crc_text: TERMS})
    assert trend.name == NAMES[0] and trend.upper == TERMS.coef[0].ub
    assert [(p.value, p.active) for p in trend.points] == [(0.02, True), (0.03, False)]
    assert history.trends(found, {}) == []  # values of other terms get no names


def test_the_log_of_a_simulated_run_has_seconds_and_no_dates(monkeypatch, tmp_path):
    monkeypatch.setattr(sys.modules[__name__], "T0", 0.0)
    path = log(tmp_path / "run.lcmlog", (1, hk(0xA)), (250.64, proposal(0xB, 0.02)), (251, hk(0xB)))
    said = good("review", "history", path).output
    assert "251.0 s" in said and "1970" not in said
    page = tmp_path / "page.html"
    good("review", "history", path, "--report", page)
    assert "251.0 s" in page.read_text() and "1970-01-01 00:0" not in page.read_text()
    assert history.utc(1.8e9) == "2027-01-15 08:00:00"


def test_a_growing_recording_is_read_on_and_nothing_is_taken_twice(tmp_path):
    path = log(tmp_path / "a.lcmlog", (1, hk(0xA)), (2, proposal(0xB, 0.02)))
    whole = proposal(0xC, 0.03)[1].encode()
    cut = event_bytes(1, int((T0 + 3) * 1e6), "KC_PROPOSAL", whole)
    with path.open("ab") as file:
        file.write(cut[:200])  # the recorder is in the midst of it
    found = history.go_on(history.History(), path)
    again = history.History.of_dict(json.loads(json.dumps(found.as_dict())))
    assert again == found
    with path.open("ab") as file:
        file.write(cut[200:])
    log(path, (4, hk(0xC)))
    after = history.go_on(again, path)
    assert [c.crc for c in after.corrections] == ["0000000b", "0000000c"]
    assert [x.crc for x in after.in_force if x.kind == "KIN"] == ["0000000a", "0000000c"]


def test_the_monitor_keeps_its_changes_of_state(tmp_path):
    path = log(
        tmp_path / "a.lcmlog", *((k, hk()) for k in range(50)), (50, hk(0, 1, 3, 0.01)), (51, hk(0, 1, 3))
    )
    found = history.go_on(history.History(), path)
    assert [(m.state, m.joint) for m in found.monitor] == [(0, 0), (1, 3)]
    assert "joint 3: 0.573" in pages.monitor_grid(found).rows[0][2].text


@pytest.fixture
def past(tmp_path):
    shelf = Shelf(BIN, tmp_path / "made", tmp_path / "read", None)
    folder = tmp_path / "history"
    return Past(URL, tmp_path / "recordings", folder, Picture(Geometry(BIN)), shelf, None)


def test_the_console_reads_each_recording_once_and_adds_what_it_heard(past, tmp_path, monkeypatch):
    name = "239.255.76.67-7667-x.lcmlog"
    log(tmp_path / "recordings" / name, (1, hk(0xA)), (2, proposal(0xB, 0.02)), (3, hk(0xB)))
    log(tmp_path / "recordings" / "10.0.0.1-1-x.lcmlog", (1, proposal(0xE, 0.9)))  # another flight
    assert past.page()["corrections"] == 1
    monkeypatch.setattr(history, "go_on", None)  # nothing is read again
    channel, message = proposal(0xC, 0.03, 2)
    past.picture.add(channel, message)
    shown = past.page()
    assert shown["corrections"] == 2
    force = next(s for s in shown["page"]["sections"] if s["key"] == "in-force")
    assert "0000000b" in [row[2]["text"] for row in force["grid"]["rows"]]
    trend = next(s for s in shown["page"]["sections"] if s["key"] == "trend")["figure"]
    assert trend["layout"]["annotations"][0]["text"].startswith(f"{NAMES[0]} [°]")


def test_a_page_without_anything_says_so():
    made = pages.page(history.History(), [], [], Provenance("2026-01-01"))
    assert "0 corrections" in made.subtitle


def test_the_command_says_the_same_and_writes_the_page(tmp_path):
    path = log(tmp_path / "a.lcmlog", (1, hk(0xA)), (2, proposal(0xB, 0.02)), (3, hk(0xB, 1, 3, 0.01)))
    options = ["--tables", BIN, "--keys", tmp_path / "keys", "--report", tmp_path / "h.html"]
    words = ["review", "history", path, *options]
    done = good(*words, env={"COLUMNS": "200"})
    for text in ("0000000b", "correction of session 1", NAMES[0], "1.146", "yes", "one joint reads wrong"):
        assert text in done.output, done.output
    assert "0000000b" in (tmp_path / "h.html").read_text("utf-8")
