"""Decisions in a real browser, at the consoles of two persons: two keys, a poor fit, reject, roll back."""

import contextlib
import threading
import time

import uvicorn
from playwright.sync_api import expect
from test_console_browser import (
    Served,
    opened,
    pytestmark,  # noqa: F401 as there: without Chromium nothing runs
    serious,
    shot,
)
from waiting_flight import WaitingFlight

import kcm
from kincal.console.app import Console, make_app
from kincal.console.desk import Desk
from kincal.console.geometry import Geometry
from kincal.console.picture import Picture
from kincal.console.sources import Live
from kincal.review import journal
from kincal_shared import keys

ARM, GO, REJECT, ROLLBACK = (
    getattr(kcm.cmd_t, n) for n in ("APPROVE_ARM", "APPROVE_GO", "REJECT", "ROLLBACK")
)


class Seat(Served):
    """A console of a person with a key file, which has heard the proposal; both write into one journal."""

    def __init__(self, flight, key_file, folder, heard=True):
        self.key_file, self.journal, self.heard = key_file, folder / "journal.jsonl", heard
        super().__init__(flight, folder)

    def start(self):
        geometry = Geometry(self.flight.tables)
        self.picture = Picture(geometry)
        for channel, message in self.flight.proposal() if self.heard else ():
            self.picture.add(channel, message)
        desk = Desk(self.flight.url, self.key_file, self.journal, self.flight.tables, self.picture, 20.0)
        app = make_app(Console(self.flight.url, geometry, self.picture, desk), self.access)
        config = uvicorn.Config(app, port=self.access.port, log_level="error", timeout_graceful_shutdown=1)
        self._server = uvicorn.Server(config)
        self._live = contextlib.ExitStack()
        self._live.enter_context(Live(self.flight.url, self.picture))
        self._thread = threading.Thread(target=self._server.run, daemon=True)
        self._thread.start()
        while not self._server.started:
            time.sleep(0.01)


@contextlib.contextmanager
def two_seats(browser, flight, folder):
    """Pages of both persons, at the correction that waits."""
    with contextlib.ExitStack() as stack:
        pages = []
        for key_file in (flight.first, flight.second):
            seat = Seat(flight, key_file, folder)
            stack.callback(seat.stop)
            page = stack.enter_context(opened(browser, seat, "words"))
            page.get_by_role("link", name="Corrections").click()
            expect(page.locator(".document h1")).to_contain_text(flight.made.text)
            pages.append(page)
        yield pages


def seen(page, by):
    page.locator("form.seen input").fill(by)
    page.get_by_role("button", name="I have seen it").click()
    expect(page.locator(".steps li").first).to_contain_text(by)


def act(page, opens, name, **words):
    """Both clicks of an action, with its words."""
    page.get_by_role("button", name=opens).click()
    form = page.locator("form", has=page.get_by_role("button", name=name, exact=True))
    for field, text in words.items():
        form.locator(f"[name={field}]").fill(text)
    form.get_by_role("button", name=name, exact=True).click()


def test_what_one_person_arms_another_lets_go_at_a_second_console(browser, made, tmp_path):
    with WaitingFlight(made, tmp_path, tick_s=0.02) as flight, two_seats(browser, flight, tmp_path) as (a, b):
        crc, before = made.text, flight.in_force
        for page in (a, b):
            expect(page.locator(".decide")).to_contain_text(
                "Two persons: GO has to be given with a key of another"
            )
        seen(a, "A. First")
        act(a, "Arm the approval", "ARM", by="A. First", why="clean")
        for page in (a, b):  # both say the same, whoever armed it
            expect(page.locator(".decide .steps")).to_contain_text("armed by key 1")
            expect(page.locator(".countdown")).to_contain_text("expires in")
            expect(page.locator(".decide .steps")).to_contain_text(
                "with another key than key 1, of another holder"
            )
        expect(a.locator(".other-key")).to_contain_text("GO has to be given with another key than key 1")
        expect(a.locator(".other-key")).to_contain_text("This console signs with key 1")
        expect(a.get_by_role("button", name="Put it in force")).to_be_disabled()
        expect(b.locator(".other-key")).to_have_count(0)
        b.emulate_media(color_scheme="dark")
        assert serious(a) == [] and serious(b) == []
        shot(a, "two-persons-first")
        left = a.locator(".countdown").inner_text()
        expect(a.locator(".countdown")).not_to_have_text(left)  # it counts down

        act(b, "Put it in force", "GO", by="B. Second", why="agreed")
        expect(b.locator("#said")).to_contain_text("B. Second has not seen correction")
        expect(b.locator(".journal")).to_contain_text("refused APPROVE_GO")  # drawn anew
        expect(b.locator(".steps form .bad").last).to_contain_text("has not seen correction")
        b.reload()
        expect(b.locator(".document h1")).to_contain_text(crc)
        b.get_by_role("link", name="Now").click()
        expect(b.locator(".state")).to_contain_text("left for GO with another key than key 1")
        shot(b, "two-persons-now")
        b.get_by_role("link", name="Corrections").click()  # as it was left
        expect(b.locator(".document h1")).to_contain_text(crc)
        assert flight.commands == [(ARM, 1)]
        seen(b, "B. Second")
        form = b.locator("form", has=b.get_by_role("button", name="GO", exact=True))  # as it was left
        expect(form.locator("input[name=why]")).to_have_value("agreed")
        form.get_by_role("button", name="GO", exact=True).click()
        for page in (a, b):
            expect(page.locator(".force code")).to_have_text(crc)
            expect(page.locator(".decide")).to_contain_text("In force. Nothing to decide.")
        expect(b.locator(".journal")).to_contain_text(f"approve {crc} B. Second, key 101 (armed by key 1)")
        shot(b, "two-persons-in-force")

        # back to what was in force: one person, with what it changes back
        a.get_by_role("button", name="Roll back").click()
        expect(a.locator(".force .preview")).to_contain_text("What changes back")
        a.locator(".force form input[name=why]").fill("tool misses")
        shot(a, "two-persons-roll-back")
        a.get_by_role("button", name="ROLLBACK").click()
        for page in (a, b):
            expect(page.locator(".force code")).to_have_text(f"{before:08x}")
        assert flight.commands == [(ARM, 1), (GO, 101), (ROLLBACK, 1)]


def test_a_poor_fit_takes_an_override_and_two_persons(browser, made, tmp_path):
    poor = kcm.proposal_t.POOR
    with WaitingFlight(made, tmp_path, poor, 0.02) as flight, two_seats(browser, flight, tmp_path) as (a, b):
        expect(a.locator(".decide")).to_contain_text("flight itself calls the fit poor")
        seen(a, "A. First")
        a.get_by_role("button", name="Arm the approval").click()
        form = a.locator("form", has=a.get_by_role("button", name="ARM", exact=True))
        form.locator("input[name=why]").fill("sample at risk")
        expect(form.get_by_role("button", name="ARM", exact=True)).to_be_disabled()  # without an override
        shot(a, "poor")
        form.locator("[name=override]").fill("will do")
        expect(form).to_contain_text("at least 3 words; 2 so far")
        expect(form.get_by_role("button", name="ARM", exact=True)).to_be_disabled()
        form.locator("[name=override]").fill("2 mm will do")
        asked(a, b, form)
        form.get_by_role("button", name="ARM", exact=True).click()
        expect(b.locator(".decide .steps")).to_contain_text("armed by key 1")
        act(b, "Put it in force", "GO", by="B. Second", why="agreed")
        expect(a.locator(".force code")).to_have_text(made.text)
        assert serious(b) == []
        assert flight.commands == [(ARM, 1), (GO, 101)]
    both = keys.read(flight.first) + keys.read(flight.second)
    lines = journal.read(tmp_path / "journal.jsonl", both).entries
    assert [(e.decision, e.override) for e in lines if e.decision in ("arm", "approve")] == [
        ("arm", "2 mm will do"),
        ("approve", "2 mm will do"),
    ]


def asked(a, b, form):
    """B asks while A writes; A answers by the keyboard alone, and both look again."""
    form.locator("[name=override]").focus()
    act(b, "Write to the journal", "Write", by="B. Second", text="pose 7:\nin \u202eshadow?")
    expect(b.locator(".remarks")).to_contain_text("open question")
    expect(a.locator(".remarks")).to_contain_text("in \\x202eshadow?")  # not turned round
    expect(a.get_by_role("button", name="Arm the approval")).to_be_disabled()
    expect(a.get_by_role("button", name="I have seen it")).to_be_focused()  # that comes next now
    answer = a.get_by_role("button", name="Answer line")
    answer.focus()
    a.keyboard.press("Enter")
    a.keyboard.press("Escape")
    expect(answer).to_be_focused()
    a.keyboard.press("Enter")
    expect(a.get_by_role("textbox", name="Answer to B. Second")).to_be_focused()
    a.keyboard.type("no: the lamp was on")
    act(b, "Write to the journal", "Write", by="B. Second", text="pose 8 too?")
    expect(a.locator(".remarks")).to_contain_text("pose 8 too?")
    expect(a.get_by_role("textbox", name="Answer to B. Second")).to_be_focused()  # nothing typed is lost
    expect(a.get_by_role("textbox", name="Answer to B. Second")).to_have_value("no: the lamp was on")
    shot(a, "question")
    assert serious(a) == []
    b.get_by_role("button", name="Answer line").first.click()
    b.get_by_role("textbox", name="Answer to B. Second").fill("it was dusk")
    a.get_by_role("textbox", name="Answer to B. Second").focus()
    a.keyboard.press("Tab")
    a.keyboard.press("Enter")
    for page in (a, b):
        expect(page.locator(".remarks")).to_contain_text("question, answered")
        expect(page.locator(".remarks .answered")).to_contain_text("no: the lamp was on")
    late = b.get_by_role("textbox", name="Answer to B. Second")
    expect(late).to_have_value("it was dusk")  # A was quicker, and what B has typed was gone
    expect(b.locator(".remarks")).to_contain_text("Somebody has answered meanwhile")
    late.press("Escape")
    expect(late).to_have_count(0)
    seen(b, "B. Second")
    seen(a, "A. First")  # what B asked too
    expect(a.locator("[name=override]")).to_have_value("2 mm will do")


def test_what_two_messages_dispute_can_be_rejected_and_nothing_else(browser, made, tmp_path):
    with WaitingFlight(made, tmp_path, tick_s=0.02) as flight, contextlib.ExitStack() as stack:
        seat = Seat(flight, flight.first, tmp_path)
        stack.callback(seat.stop)
        channel, message = flight.proposal()[-1]
        message.p_fit /= 2
        seat.picture.add(channel, message)
        page = stack.enter_context(opened(browser, seat, "words"))
        page.get_by_role("link", name="Corrections").click()
        expect(page.locator(".review")).to_contain_text("say different things of it")
        expect(page.locator(".review")).to_contain_text("Reject and a new calibration are safe")
        expect(page.locator(".decide")).not_to_contain_text("GO")
        act(page, "Reject", "REJECT", by="A. First", why="disputed")
        expect(page.locator(".journal")).to_contain_text(f"reject {made.text} A. First")
        assert flight.commands == [(REJECT, 1)]


def test_what_was_sent_before_the_console_listened_can_be_rejected_there(browser, made, tmp_path):
    """It said to do so by a command in a terminal."""
    with WaitingFlight(made, tmp_path, tick_s=0.02) as flight, contextlib.ExitStack() as stack:
        seat = Seat(flight, flight.first, tmp_path, heard=False)
        stack.callback(seat.stop)
        page = stack.enter_context(opened(browser, seat, "words"))
        page.get_by_role("link", name="Corrections").click()
        expect(page.locator(".inbox")).to_contain_text(f"Correction {made.text} waits on board")
        page.get_by_role("button", name=f"Reject {made.text}").click()
        page.locator(".inbox [name=by]").fill("A. First")
        page.locator(".inbox [name=why]").press_sequentially("not recorded", delay=150)  # while values come
        page.get_by_role("button", name="REJECT", exact=True).click()
        expect(page.locator(".journal")).to_contain_text(f"reject {made.text} A. First")
        expect(page.locator(".inbox")).not_to_contain_text("waits on board")
        assert flight.commands == [(REJECT, 1)]


def test_the_second_person_may_reject_what_the_first_has_armed(browser, made, tmp_path):
    with WaitingFlight(made, tmp_path, tick_s=0.02) as flight, two_seats(browser, flight, tmp_path) as (a, b):
        before = f"{flight.in_force:08x}"
        seen(a, "A. First")
        act(a, "Arm the approval", "ARM", by="A. First", why="clean")
        expect(b.locator(".decide .steps")).to_contain_text("armed by key 1")
        act(b, "Reject", "REJECT", by="B. Second", why="pose 7 looks blurred")
        for page in (a, b):
            expect(page.locator(".decide")).to_contain_text("does not wait on board. Nothing to decide.")
            expect(page.locator(".force code")).to_have_text(before)
        expect(b.locator(".journal")).to_contain_text(f"reject {made.text} B. Second, key 101")
        assert flight.commands == [(ARM, 1), (REJECT, 101)]
