"""The console's server: who may ask, snapshot and changes, what is sent to flight and how often."""

import json
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from pathlib import Path

import pytest
from fake_flight import FakeFlight
from places import BIN
from samples import CRC, event, progress, proposal, signed, write_log
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

import kcm
from kincal.console.app import Console, make_app
from kincal.console.desk import Desk, Words
from kincal.console.dictionary import dictionary, of_error
from kincal.console.guard import Access
from kincal.console.memory import Memory
from kincal.console.picture import KEPT, Cursor, Picture
from kincal.console.serve import Options, serve
from kincal.console.sources import Live, Recording
from kincal.console.words import joint_limit
from kincal.review import journal, record
from kincal.run.inprocess import simulate
from kincal_shared.errors import BadInput, CommandFailed
from kincal_sim.ports import private_port, private_url

ACCESS = Access(8674, token="the-token")
HOST, ORIGIN = "127.0.0.1:8674", "http://127.0.0.1:8674"
GOOD = {"host": HOST, "origin": ORIGIN, "cookie": "kincal_8674=the-token"}
JSON = {**GOOD, "content-type": "application/json"}
DECIDED = (journal.SEEN, journal.ARMED, journal.APPROVED)
EVIL = '<img src=x onerror="alert(1)">'


@pytest.fixture
def client(picture, own_key_file):
    desk = Desk("memq://", own_key_file, None, BIN, picture, timeout_s=0.2)
    return TestClient(make_app(Console("memq://", picture.geometry, picture, desk), ACCESS), base_url=ORIGIN)


def hk(state: int = 0, proposal_crc: int = 0, kin: int = 1) -> kcm.hk_t:
    m = kcm.hk_t()
    m.t_us, m.state, m.proposal_crc, m.proposal_verdict = 9_000_000, state, signed(proposal_crc), 1
    m.table_crc[4], m.kin_prev_crc = signed(kin), 7
    return m


# ---- who may ask

PATHS = ("/", "/main.js", "/style.css", "/plotly.js", "/api/about", "/api/rows", "/api/journal", "/nothing")


@pytest.mark.parametrize("path", PATHS)
def test_nothing_is_answered_without_the_token(client, path):
    for cookie in ("", "kincal_8674=", "kincal_8674=the-toke", "kincal_8675=the-token", "the-token"):
        answer = client.get(path, headers={"host": HOST, "cookie": cookie})
        assert answer.status_code == 403, (path, cookie)
        assert "token" in answer.text


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize(
    "host", ["evil.example:8674", "127.0.0.1", "127.0.0.1:80", "localhost.evil.example:8674", ""]
)
def test_another_host_is_refused_also_with_the_token(client, path, host):
    assert client.get(path, headers={**GOOD, "host": host}).status_code == 421


def test_the_start_address_gives_a_cookie_that_no_script_reads_and_no_other_page_sends(client):
    answer = client.get("/?token=the-token", headers={"host": HOST}, follow_redirects=False)
    cookie = answer.headers["set-cookie"].lower()
    assert answer.status_code == 303 and answer.headers["location"] == "/"
    assert "httponly" in cookie and "samesite=strict" in cookie
    client.cookies.clear()
    assert client.get("/?token=another", headers={"host": HOST}).status_code == 403
    assert client.get("/api/about?token=the-token", headers={"host": HOST, "cookie": ""}).status_code == 403


def test_the_start_address_is_not_answered_under_another_name(client):
    answer = client.get("/?token=the-token", headers={"host": "evil.example:8674"}, follow_redirects=False)
    assert answer.status_code == 421 and "set-cookie" not in answer.headers


POSTS = ("/api/abort", "/api/start", "/api/rollback", f"/api/review/{CRC:08x}/arm", "/api/nothing")


ORIGINS = [
    None, "null", "http://evil.example", "http://127.0.0.1:80", f"{ORIGIN}.evil.example",
    "https://127.0.0.1:8674",
]  # fmt: skip


@pytest.mark.parametrize("path", POSTS)
@pytest.mark.parametrize("origin", ORIGINS)
def test_a_post_from_another_page_is_refused(client, path, origin):
    headers = {k: v for k, v in {**JSON, "origin": origin}.items() if v is not None}
    assert client.post(path, headers=headers, content=b"{}").status_code == 403


@pytest.mark.parametrize(
    "kind", ["application/x-www-form-urlencoded", "multipart/form-data; boundary=x", "text/plain", ""]
)
def test_a_post_that_a_form_could_send_is_refused(client, kind):
    assert client.post("/api/abort", headers={**GOOD, "content-type": kind}, content=b"{}").status_code == 415


def test_a_post_without_the_token_is_refused(client):
    assert client.post("/api/abort", headers={**JSON, "cookie": ""}, content=b"{}").status_code == 403


def test_too_much_is_not_read(client):
    headers = {**JSON, "content-length": str(1 << 40)}
    assert client.post("/api/start", headers=headers, content=b"{}").status_code == 413


@pytest.mark.parametrize("change", [{"origin": "http://evil.example"}, {"origin": None}, {"cookie": None},
                                    {"host": "evil.example:8674"}])  # fmt: skip
def test_a_websocket_from_elsewhere_is_refused(client, change):
    headers = {k: v for k, v in {**GOOD, **change}.items() if v is not None}
    with pytest.raises(WebSocketDisconnect), client.websocket_connect("/api/feed", headers=headers):
        pass


def test_a_header_that_comes_twice_counts_as_none(client):
    headers = [("host", HOST), ("cookie", GOOD["cookie"]), ("origin", ORIGIN), ("origin", ORIGIN)]
    headers.append(("content-type", "application/json"))
    assert client.post("/api/abort", headers=headers, content=b"{}").status_code == 403


def test_every_answer_forbids_what_is_not_from_here(client):
    for path, headers in (("/", GOOD), ("/api/about", GOOD), ("/", {"host": "x"}), ("/nothing", GOOD)):
        answer = client.get(path, headers=headers)
        policy = answer.headers["content-security-policy"]
        assert "default-src 'none'" in policy and "script-src 'self';" in policy
        assert "frame-ancestors 'none'" in policy and "form-action 'none'" in policy
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert not [name for name in answer.headers if name.startswith("access-control-")]


def test_nothing_names_an_outside_address():
    from kincal.console.app import STATIC

    for path in STATIC.iterdir():
        text = path.read_text("utf-8")
        found = [
            w for w in ("http://", "https://", "//cdn") if w in text.replace("http://www.w3.org/2000/svg", "")
        ]
        assert not found, (path.name, found)


MARKUP = ("innerHTML", "outerHTML =", "insertAdjacentHTML", "document.write", "eval(", "new Function")
MARKUP += ("DOMParser", "createContextualFragment", "srcdoc", "javascript:")


def test_texts_never_become_markup():
    """Only text nodes: none of the ways by which a string becomes elements or code."""
    from kincal.console.app import STATIC

    for path in STATIC.glob("*.js"):
        text = path.read_text("utf-8")
        for word in MARKUP:
            assert word not in text, (path.name, word)


# ---- snapshot and changes


def feed(client):
    return client.websocket_connect("/api/feed", headers=GOOD)


def next_of(ws, kind):
    while (message := json.loads(ws.receive_text()))["kind"] != kind:
        pass
    return message


def test_a_browser_gets_all_last_values_first_and_then_only_what_changed(client, picture):
    picture.add("KC_HK", hk(state=5))
    for k in range(3):
        picture.add("KC_PROGRESS", progress(k))
    picture.add("KC_EVENT", event(1, 1, 1, 1))
    with feed(client) as ws:
        first = json.loads(ws.receive_text())
        assert first["kind"] == "snapshot"
        assert first["values"]["KC_HK"]["data"]["state"] == "SERVO"
        assert [p["pose"] for p in first["values"]["poses"]["data"]] == [1, 2, 3]
        assert [r["name"] for r in first["rows"]] == ["BOOT"]
        picture.add("KC_HK", hk(state=9, proposal_crc=CRC))
        change = next_of(ws, "changes")
        assert set(change["values"]) == {"KC_HK"} and not change["rows"]
        assert change["values"]["KC_HK"]["data"]["proposal"] == f"{CRC:08x}"


def test_a_silent_flight_differs_from_a_lost_link(client, monkeypatch):
    monkeypatch.setattr("kincal.console.app.BEAT_S", 0.1)
    with feed(client) as ws:
        assert json.loads(ws.receive_text())["values"] == {
            "inbox": {"received_s": pytest.approx(time.time(), abs=60), "t_us": None, "data": []}
        }
        assert json.loads(ws.receive_text())["kind"] == "beat"


def test_no_event_and_no_acknowledgement_is_lost_among_ten_thousand_messages(client, picture):
    """Values are conflated: many come in one change; rows are all there, once and in order."""
    ack = kcm.ack_t()
    ack.source, ack.opcode = 2, 2
    with feed(client) as ws:
        json.loads(ws.receive_text())
        got, values, wanted = [], 0, 0
        for k in range(10_000):
            channel, message = [("KC_EVENT", event(k, k, 48, 0)), ("KC_HK", hk()), ("KC_ACK", ack),
                                ("KC_HK", hk()), ("KC_HK", hk())][k % 5]  # fmt: skip
            picture.add(channel, message)
            wanted += channel != "KC_HK"
        while len(got) < wanted:
            change = json.loads(ws.receive_text())
            got += [row["n"] for row in change.get("rows", [])]
            values += len(change.get("values", {}))
    assert got == list(range(wanted)) and wanted == 4000
    assert values < 100


def test_the_picture_does_not_grow(picture):
    for k in range(KEPT + 500):
        picture.add("KC_EVENT", event(k, k, 48, 0))
    cursor = Cursor(0, 100)
    assert len(picture.rows) == KEPT and picture.n_rows == KEPT + 500
    change = picture.changes(cursor)
    assert change["rows_lost"] == 400 and change["rows"][0]["n"] == 500
    assert [r["n"] for r in picture.page(before=600, count=50)] == list(range(550, 600))
    assert picture.page(before=200, count=50) == []


def test_what_a_stranger_sends_stays_text(client, picture):
    """Names of the journal and numbers that are none go out as JSON that no reader takes for markup."""
    m = progress(0)
    m.res_pos_m = float("nan")
    picture.add("KC_PROGRESS", m)
    bad = event(1, 1, 9999, 7, got=float("inf"), index=-5)
    picture.add("KC_EVENT", bad)
    picture.note("info", EVIL, EVIL)
    with feed(client) as ws:
        first = json.loads(ws.receive_text())
    assert first["values"]["poses"]["data"][0]["res_mm"] is None
    assert first["rows"][-1]["text"] == EVIL
    answer = client.get("/api/rows", headers=GOOD)
    assert "<" not in answer.text and answer.json()[-1]["text"] == EVIL
    assert answer.headers["content-type"].startswith("application/json")


def test_a_joint_near_its_limit_and_one_beyond_it_differ():
    assert [joint_limit(x, -100.0, 100.0) for x in (0.0, 89.9, 90.1, -90.1, 100.1, float("nan"))] == [
        "ok", "ok", "near", "near", "beyond", "beyond"]  # fmt: skip


def test_every_event_has_a_cause_and_what_to_do():
    known = dictionary()
    assert len(known) > 90
    assert not [name for name, about in known.items() if not about["cause"] or not about["do"]]


def test_tables_of_the_console_that_do_not_fly_are_named(picture):
    m = hk()
    m.table_crc[1] = 5
    picture.add("KC_HK", m)
    differ = picture.snapshot()[0]["values"]["KC_HK"]["data"]["tables_differ"]
    assert len(differ) == 1 and "ARM" in differ[0] and "00000005" in differ[0]


# ---- the desk


@pytest.fixture
def flight():
    with FakeFlight(proposal_crc=CRC) as fake:
        yield fake


@pytest.fixture
def live(flight, geometry, own_key_file):
    """A console on a flight process with a correction that waits."""
    picture = Picture(geometry)
    message = proposal()
    message.crc_terms = 0
    picture.add("KC_PROPOSAL", message)
    desk = Desk(flight.url, own_key_file, None, BIN, picture, timeout_s=3.0)
    app = make_app(Console(flight.url, geometry, picture, desk), ACCESS)
    with Live(flight.url, picture), TestClient(app, base_url=ORIGIN) as client:
        yield client


def post(client, path, **body):
    return client.post(path, headers=JSON, json=body)


def see(client, by):
    """Look at the page, then say so."""
    at = f"/api/review/{CRC:08x}"
    shown = client.get(at, headers=GOOD).json()["shown"]
    return post(client, f"{at}/seen", number=f"seen {by} {shown}", by=by, shown=shown)


def test_abort_needs_no_key_and_no_words(flight, geometry, tmp_path):
    picture = Picture(geometry)
    desk = Desk(flight.url, tmp_path / "none", None, BIN, picture)
    client = TestClient(make_app(Console(flight.url, geometry, picture, desk), ACCESS), base_url=ORIGIN)
    assert "key" in client.get("/api/about", headers=GOOD).json()["why_no_key"]
    answer = post(client, "/api/abort").json()
    # this flight has no state SAFE: that is not taken for done
    assert not answer["ok"] and answer["text"].startswith("ABORT accepted, but state SAFE was not seen")
    assert [step["stage"] for step in answer["steps"]] == ["sent", "received", "accepted"]
    assert [opcode for opcode, _ in flight.commands] == [kcm.cmd_t.ABORT]


def test_an_approval_takes_somebody_who_has_seen_it_then_two_steps(live, flight, own_key_file):
    crc, words = f"{CRC:08x}", {"by": "A. Reviewer", "why": "residuals clean"}
    at = f"/api/review/{crc}"
    refused = post(live, f"{at}/arm", number="1", **words)
    assert refused.status_code == 409 and "has not seen" in refused.json()["text"]
    assert flight.commands == []
    page = live.get(at, headers=GOOD).json()
    assert (
        page["waits"]
        and page["reasons"] == []
        and any("held" in t for t in page["look_at"])
        and page["page"]["sections"]
    )
    assert see(live, "A. Reviewer").json()["ok"]
    assert post(live, f"{at}/go", number="3", **words).status_code == 409
    assert post(live, f"{at}/arm", number="4", **words).json()["ok"]
    time.sleep(0.2)
    assert post(live, f"{at}/go", number="5", **words).json()["ok"]
    assert flight.kin_crc == CRC
    assert [o for o, _ in flight.commands] == [kcm.cmd_t.APPROVE_ARM, kcm.cmd_t.APPROVE_GO]
    lines = journal.read(journal.place(None, own_key_file)).entries
    assert [e.decision for e in lines if e.decision in DECIDED] == ["seen", "arm", "approve"]


def test_a_question_is_asked_answered_and_looked_at_before_anybody_decides(live, flight, own_key_file):
    at, words = f"/api/review/{CRC:08x}", {"by": "A", "why": "clean"}
    page = lambda: live.get(at, headers=GOOD).json()  # noqa: E731
    version = lambda: live.get("/api/journal/version", headers=GOOD).json()["version"]  # noqa: E731
    before, empty = page(), version()
    assert before["remarks"] == [] and empty == ""
    assert post(live, f"{at}/remark", number="1", by="B", text="in\nshadow?", what="question").json()["ok"]
    stale = post(live, f"{at}/seen", number="2", by="A", shown=before["shown"])
    assert stale.status_code == 409 and "says more than the one that A was shown" in stale.json()["text"]
    assert post(live, f"{at}/seen", number="3", by="A").status_code == 409  # without a page
    (asked,) = page()["remarks"]
    assert (asked["line"], asked["by"], asked["text"], asked["open"]) == (1, "B", "in\nshadow?", True)
    assert any("open question by B" in text and "in shadow?" in text for text in page()["look_at"])
    assert see(live, "A").json()["ok"] and page()["seen_by"] == ["A"] and version() != empty

    for wrong in ({"text": " "}, {"text": "x" * 20_001}, {"what": "arm"}, {"what": "question", "answers": 1},
                  {"answers": 2}, {"answers": -1}, {"answers": -2}):  # fmt: skip
        refused = post(
            live, f"{at}/remark", number=f"{wrong}"[:60], by="B", **{"what": "comment", "text": "no", **wrong}
        )
        assert refused.status_code == 409, wrong
    answered = {"text": "no: lamp on", "what": "comment", "answers": 1}
    assert post(live, f"{at}/remark", number="4", by="B", **answered).json()["ok"]
    assert [(r["line"], r["open"], r["answers"]) for r in page()["remarks"]] == [(1, False, 0), (3, False, 1)]
    assert page()["seen_by"] == []  # not what was said since
    refused = post(live, f"{at}/arm", number="5", **words)
    assert refused.status_code == 409 and "A saw correction fedcba98 before" in refused.json()["text"]
    assert flight.commands == []
    for _ in range(2):  # once is enough
        assert see(live, "A").json()["ok"]
    lines = journal.read(journal.place(None, own_key_file)).entries
    assert [e.decision for e in lines] == ["question", "seen", "comment", "attempt", "refused", "seen"]
    assert post(live, f"{at}/arm", number="6", **words).json()["ok"]


def test_what_is_asked_between_a_look_at_the_page_and_its_line_was_not_seen(live, own_key_file, monkeypatch):
    real = Desk._sound

    def slow(desk):
        kept = real(desk)
        record(desk.journal_path, "question", CRC, "B", "in shadow?", "", None, desk._signer())
        return kept

    monkeypatch.setattr(Desk, "_sound", slow)
    refused = see(live, "A")
    assert refused.status_code == 409 and "says more than the one that A was shown" in refused.json()["text"]
    lines = journal.read(journal.place(None, own_key_file)).entries
    assert [e.decision for e in lines] == ["question"]


def test_what_was_armed_elsewhere_needs_its_override_at_go_too(geometry, own_key_file):
    message = proposal(verdict=kcm.proposal_t.POOR)
    message.crc_terms = 0
    with FakeFlight(proposal_crc=CRC, verdict=kcm.proposal_t.POOR) as flight:
        flight.armed = CRC
        picture = Picture(geometry)
        picture.add("KC_PROPOSAL", message)
        desk = Desk(flight.url, own_key_file, None, BIN, picture, timeout_s=3.0)
        at, words = f"{CRC:08x}", Words("B", "agreed")
        with Live(flight.url, picture):
            wait_for(lambda: picture.newest("KC_HK") is not None)
            desk.see(at, "B")
            assert desk.review(at)["go"]["override"]
            for override, said in (("", "reasons to reject"), ("just go", "at least 3 words")):
                with pytest.raises(BadInput, match=said):
                    desk.decide("go", at, words, override)
            assert flight.commands == []
            desk.decide("go", at, words, " 2 mm will do ")
        assert flight.kin_crc == CRC
    last = desk.entries()[-1]
    assert (last.decision, last.override) == ("approve", "2 mm will do")


def test_another_spelling_of_a_crc_is_the_same_correction(live, flight, monkeypatch):
    """In capitals it was armed past what clearance says against it by now."""
    at, words = f"/api/review/{CRC:08X}", {"by": "A", "why": "clean"}
    assert live.get(at, headers=GOOD).json()["page"] == live.get(at.lower(), headers=GOOD).json()["page"]
    assert see(live, "A").json()["ok"]
    near = lambda desk, crc: ("too near",) if desk.picture.proposal(crc) else ()  # noqa: E731
    monkeypatch.setattr(Desk, "_against", near)
    refused = post(live, f"{at}/arm", number="1", **words)
    assert refused.status_code == 409 and "before this was known: too near" in refused.json()["text"]
    assert flight.commands == []
    for none in ("0", f"{CRC:08x}%20", "%E2%80%AE"):
        refused = live.get(f"/api/review/{none}", headers=GOOD)
        assert refused.status_code == 409 and "is not a CRC" in refused.text


def test_what_to_do_is_said_as_the_form_that_does_it(live, flight):
    """Errors named commands to type into a terminal to whoever sits at the console."""
    at, words = f"/api/review/{CRC:08x}", {"by": "A", "why": "clean"}
    numbers = iter(range(99))

    def todo(path, **body):
        answer = post(live, path, number=f"{next(numbers)}", **body)
        said = answer.json()["text"]
        assert answer.status_code == 409 and "kincal" not in said and "--" not in said
        return said.partition("to do: ")[2]

    assert todo(f"{at}/arm", **words) == "read the page, then write your name at Seen"
    assert todo(f"{at}/arm", by="A") == "fill in the name and the reason"
    assert todo(f"{at}/go", **words) == "ARM first"
    assert todo("/api/review/00000001/reject", **words) == "Corrections shows what waits"
    assert todo("/api/start", **words) == "decide first: Corrections"
    assert see(live, "A").json()["ok"]
    assert todo(f"{at}/arm", override="2 mm will do", **words) == "send it without an override"
    assert post(live, f"{at}/remark", number="q", by="B", text="`kincal status`?", what="question").json()[
        "ok"
    ]
    refused = post(live, f"{at}/arm", number="r", **words).json()["text"]
    assert "`kincal status`?" in refused  # what people wrote stays
    assert refused.endswith("to do: look at it again and say so at Seen, then decide")
    assert see(live, "A").json()["ok"]
    said = post(live, f"{at}/arm", number="s", **words).json()
    assert (
        "`" not in "".join(said["said"]).replace("`kincal status`?", "")
        and "GO puts it in force" in said["text"]
    )
    wait_for(lambda: flight.armed)
    time.sleep(0.2)
    assert "GO puts it in force, Reject drops it" in todo(f"{at}/arm", **words)


@pytest.fixture
def poor(geometry, own_key_file):
    """A flight that waits with a poor fit, what the console knows of it, and the desk that decides."""
    message = proposal(verdict=kcm.proposal_t.POOR)
    message.crc_terms = 0
    with FakeFlight(proposal_crc=CRC, verdict=kcm.proposal_t.POOR) as flight:
        picture = Picture(geometry)
        picture.add("KC_PROPOSAL", message)
        yield flight, picture, Desk(flight.url, own_key_file, None, BIN, picture, timeout_s=3.0)


def test_a_reason_to_reject_leads_to_the_forms_of_override_and_reject(poor):
    _, _, desk = poor
    desk.see(f"{CRC:08x}", "B")
    for override, place, todo in (
        ("", "", "Reject; to approve it in spite of them, ARM with an override of at least 3 words"),
        ("just go", "Override", "say why it is approved in spite of the reasons to reject it"),
    ):
        with pytest.raises(BadInput) as refused:
            desk.decide("arm", f"{CRC:08x}", Words("B", "agreed"), override)
        said = of_error(refused.value)
        assert f"to do: {todo}" in said and (f"where: {place}" in said or not place)
    todo = "see to the journal, then write down by `kincal review comment` what came of it"
    assert of_error(BadInput("x", todo=todo)).endswith(
        "see to the journal, then write to the journal what came of it"
    )


def test_a_request_that_comes_twice_is_carried_out_once(live, flight):
    crc = f"{CRC:08x}"
    body = {"number": "7", "by": "B", "why": "w"}
    first, second = (post(live, f"/api/review/{crc}/reject", **body).json() for _ in range(2))
    assert first["ok"] and second["ok"] and second["again"] and "again" not in first
    assert [o for o, _ in flight.commands] == [kcm.cmd_t.REJECT]
    assert post(live, f"/api/review/{crc}/reject", by="B", why="w").status_code == 409  # no number


@pytest.mark.parametrize("second", ["arm", "reject"])
def test_of_two_decisions_about_a_correction_at_once_the_second_is_not_sent(live, flight, second):
    """Two pages, each with a number of its own: both commands went to flight."""
    at, words = f"/api/review/{CRC:08x}", {"by": "A", "why": "clean"}
    assert see(live, "A").json()["ok"]
    answers = {}
    first = threading.Thread(
        target=lambda: answers.update(first=post(live, f"{at}/arm", number="1", **words))
    )
    first.start()
    while not flight.commands and first.is_alive():
        time.sleep(0.002)
    refused = post(live, f"{at}/{second}", number="2", **words)
    first.join()
    assert answers["first"].json()["ok"] and refused.status_code == 409
    assert "about the same was under way when this one came: nothing was sent" in refused.json()["text"]
    assert "look at what came of that one" in refused.json()["text"]
    assert [o for o, _ in flight.commands] == [kcm.cmd_t.APPROVE_ARM]
    assert post(live, f"{at}/reject", number="3", **words).json()["ok"]  # who has seen that may go on


def test_a_number_that_another_request_had_is_not_answered_by_what_came_of_that(live, flight):
    """REJECT with the number of an ARM was answered "ok", and nothing was sent."""
    at, words = f"/api/review/{CRC:08x}", {"number": "1", "by": "A", "why": "clean"}
    assert see(live, "A").json()["ok"]
    assert post(live, f"{at}/arm", **words).json()["ok"]
    for path, more in ((f"{at}/reject", {}), (f"{at}/arm", {"why": "in doubt"}), (f"{at}/arm", {"new": 1})):
        refused = post(live, path, **{**words, **more})
        assert refused.status_code == 409 and "another request had this number" in refused.json()["text"]
    assert [o for o, _ in flight.commands] == [kcm.cmd_t.APPROVE_ARM]
    assert post(live, f"{at}/arm", **words).json()["again"]
    for number, status in ((7, 400), (["1"], 400), ("9" * 101, 409)):
        assert post(live, f"{at}/arm", **{**words, "number": number}).status_code == status


@pytest.mark.parametrize("body", [{}, {"by": "A"}, {"by": " ", "why": "x"}])
def test_start_and_rollback_need_a_name_and_a_reason(live, flight, body):
    for path in ("/api/start", "/api/rollback"):
        answer = post(live, path, number=f"n{path}{body}", crc="00000001", **body)
        assert answer.status_code == 409 and "name and a reason" in answer.json()["text"]
    assert flight.commands == []


def test_a_rollback_of_what_is_no_longer_in_force_is_not_sent(live, flight):
    answer = post(live, "/api/rollback", number="1", crc="12345678", by="A", why="b")
    assert answer.status_code == 409 and "ROLLBACK was not sent" in answer.json()["text"]
    assert flight.commands == []


def test_words_that_are_none_are_refused(live, flight):
    for content in (b"[]", b"{", b'{"number":"1","by":1,"why":"x"}'):
        assert live.post("/api/start", headers=JSON, content=content).status_code == 400
    assert flight.commands == []


def test_residuals_of_each_pose_are_shown_if_all_of_its_measurements_were_heard(geometry, own_key_file):
    run = simulate("healthy", seed=1)
    session = run.log.last_session
    picture = Picture(geometry)
    desk = Desk("memq://", own_key_file, None, BIN, picture)
    for m in session.measurements[:-1]:
        picture.add("KC_MEAS", m)
    picture.add("KC_PROPOSAL", session.proposal)

    def keys_of():
        page = desk.review(f"{session.proposal.crc & 0xFFFFFFFF:08x}")["page"]
        return [section["key"] for section in page["sections"]]

    assert "left" not in keys_of()
    picture.add("KC_MEAS", session.measurements[-1])
    assert "left" in keys_of()
    picture.add("KC_MEAS", session.measurements[0])  # another flight counts anew
    assert "left" not in keys_of()


# ---- recordings


def test_a_recording_shows_each_moment_and_takes_no_command(geometry, tmp_path):
    write_log(tmp_path / "run.lcmlog")
    recording = Recording.read(tmp_path / "run.lcmlog")
    console = Console("a run.lcmlog", geometry, Picture(geometry), None, recording)
    client = TestClient(make_app(console, ACCESS), base_url=ORIGIN)
    assert client.get("/api/about", headers=GOOD).json()["span_us"] == list(recording.span_us)
    with feed(client) as ws:
        end = json.loads(ws.receive_text())
        assert len(end["values"]["poses"]["data"]) == 3 and end["values"]["inbox"]["data"]
        for t_us, poses in ((1_500_000, 1), (2_500_000, 2), (1_000_000, 1), (3_000_000, 3)):
            ws.send_text(json.dumps({"seek_us": t_us}))
            now = json.loads(ws.receive_text())
            assert len(now["values"]["poses"]["data"]) == poses and now["values"]["inbox"]["data"] == []
    assert post(client, "/api/abort").status_code == 409
    refused = client.get(f"/api/review/{CRC:08x}", headers=GOOD)
    assert refused.status_code == 409
    assert f"`kincal review show 'a run.lcmlog' --crc {CRC:08x}`" in refused.json()["text"]


def test_a_file_without_messages_is_no_recording(tmp_path):
    (tmp_path / "empty.lcmlog").write_bytes(b"nothing")
    with pytest.raises(BadInput, match="no messages of flight"):
        Recording.read(tmp_path / "empty.lcmlog")


# ---- a console that is started anew


def test_what_waits_is_known_after_a_restart_of_the_console(geometry, tmp_path):
    memory, picture = Memory(tmp_path, "url"), Picture(geometry)
    for k in range(3):
        memory.keep("KC_PROGRESS", progress(k), 100.0 + k)
    memory.keep("KC_PROPOSAL", proposal(), 104.0)
    memory.keep("KC_EVENT", event(1, 1, 1, 1), 105.0)
    memory.keep("KC_HK", hk(), 106.0)  # of before: not shown as if it were now
    with memory.path.open("ab") as file:
        file.write(b"\xed\xa1\xda\x01cut off")
    assert Memory(tmp_path, "url").recall(picture) == 5
    assert Memory(tmp_path, "another").recall(Picture(geometry)) == 0
    values = picture.snapshot()[0]["values"]
    assert [p["crc"] for p in values["inbox"]["data"]] == [f"{CRC:08x}"]
    assert len(values["poses"]["data"]) == 3 and values["poses"]["received_s"] == 102.0
    assert "KC_HK" not in values and picture.rows[0]["received_s"] == 105.0


def test_what_is_kept_is_bounded_and_a_full_medium_ends_only_the_keeping(geometry, tmp_path, monkeypatch):
    monkeypatch.setattr("kincal.console.memory.MOST_BYTES", 4000)
    memory = Memory(tmp_path, "url")
    for k in range(200):
        memory.keep("KC_EVENT", event(k, k, 1, 1), 1.0)
    assert sum(p.stat().st_size for p in tmp_path.iterdir()) < 9000
    picture = Picture(geometry)
    assert memory.recall(picture) > 40 and picture.rows[-1]["t_us"] == 199
    memory = Memory(Path("/proc/none"), "url")
    memory.keep("KC_EVENT", event(1, 1, 1, 1), 1.0)
    assert memory.trouble


def test_a_poor_fit_is_armed_by_an_override_only(poor, geometry, own_key_file):
    flight, picture, desk = poor
    app = make_app(Console(flight.url, geometry, picture, desk), ACCESS)
    with Live(flight.url, picture), TestClient(app, base_url=ORIGIN) as client:
        at, words = f"/api/review/{CRC:08x}", {"by": "A", "why": "b"}
        assert "flight itself calls the fit poor" in client.get(at, headers=GOOD).json()["reasons"][0]
        assert see(client, "A").json()["ok"]
        refused = post(client, f"{at}/arm", number="2", **words)
        assert refused.status_code == 409 and "ARM with an override" in refused.json()["text"]
        assert flight.commands == []
        assert post(client, f"{at}/arm", number="3", override="2 mm will do", **words).json()["ok"]
    assert flight.overrides == [1]
    assert journal.read(journal.place(None, own_key_file)).entries[-1].override == "2 mm will do"


# ---- the command


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_command_prints_the_address_serves_and_ends_with_its_recording(tmp_path, number):
    port, lock = private_port()
    command = [sys.executable, "-m", "kincal", "serve", "--port", "0", "--url", private_url(port),
               "--keys", tmp_path / "none", "--folder", tmp_path / "kept",
               "--recordings", tmp_path / "recordings"]  # fmt: skip
    process = subprocess.Popen(  # a shell's background job ignores SIGINT, and so would its children
        command, stdout=subprocess.PIPE, text=True, preexec_fn=lambda: signal.signal(number, signal.SIG_DFL)
    )
    try:
        assert "Ctrl-C ends it" in process.stdout.readline()
        base, token = process.stdout.readline().strip().split("/?token=")
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(f"{base}/api/about", timeout=10)
        cookie = f"kincal_{base.rsplit(':', 1)[1]}={token}"
        request = urllib.request.Request(f"{base}/api/about", headers={"Cookie": cookie})
        with urllib.request.urlopen(request, timeout=10) as answer:
            assert "key" in json.load(answer)["why_no_key"]
        listed = Path(f"/proc/{process.pid}/task").glob("*/children")
        children = [child for path in listed for child in path.read_text().split()]
        assert len(children) == 1
        process.send_signal(number)
        assert process.wait(20) in (130, 143)
        assert not Path(f"/proc/{children[0]}").exists()
    finally:
        process.kill()
        process.stdout.close()
        lock.close()


def test_a_port_that_is_taken_is_said():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(BadInput, match="nothing can listen there"):
            serve(Options("x", BIN, None, port=taken.getsockname()[1]), lambda _access: None)


def test_an_abort_does_not_wait_for_a_decision_that_is_under_way(geometry, own_key_file):
    with FakeFlight(proposal_crc=CRC, dead=True) as flight:
        picture = Picture(geometry)
        message = proposal()
        message.crc_terms = 0
        picture.add("KC_PROPOSAL", message)
        desk = Desk(flight.url, own_key_file, None, BIN, picture, timeout_s=8.0)
        at, words = f"{CRC:08x}", Words("A", "b")
        desk.see(at, "A")
        desk.decide("arm", at, words)
        go = threading.Thread(target=decided_in_vain, args=(desk, at, words), daemon=True)
        with Live(flight.url, picture):
            go.start()  # accepted, but the table never comes in force: it waits for that
            wait_for(lambda: kcm.cmd_t.APPROVE_GO in [o for o, _ in flight.commands])
            abort = threading.Thread(target=desk.abort, daemon=True)
            abort.start()
            wait_for(lambda: kcm.cmd_t.ABORT in [o for o, _ in flight.commands])
            assert go.is_alive()
            abort.join()
            go.join()


def decided_in_vain(desk, crc, words):
    with pytest.raises(CommandFailed, match="was not seen in housekeeping"):
        desk.once("1", lambda: desk.decide("go", crc, words))


def wait_for(what, seconds=6.0):
    deadline = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < deadline
        time.sleep(0.01)
