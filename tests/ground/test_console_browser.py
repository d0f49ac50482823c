"""The console in a real browser, on flight's own core: approval and read-back, abort, a lost server."""

import contextlib
import os
import socket
import threading
import time

import poses
import pytest
import uvicorn
from axe_playwright_python.sync_playwright import Axe
from places import BIN, CHROMIUM
from playwright.sync_api import expect
from simulated_flight import SimulatedFlight

import kcm
from kincal.console.app import Console, make_app
from kincal.console.bench import Bench
from kincal.console.clearances import Clearances
from kincal.console.desk import Desk
from kincal.console.geometry import Geometry
from kincal.console.guard import Access
from kincal.console.past import Past
from kincal.console.picture import Picture
from kincal.console.shelf import Shelf
from kincal.console.sources import Live
from kincal.console.spaces import Spaces
from kincal.review import journal

WIDE = {"width": 1920, "height": 1080}
SHOTS = os.environ.get("KINCAL_SHOTS")  # a folder: pictures of what the tests see

expect.set_options(timeout=30_000)  # of a busy machine
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here")


# Scenes in three dimensions are drawn by the processor here: only tests of kind "scenes" have WebGL, and
# those of kind "words" no figures at all. Pictures for the documents have everything.
FLAT = """
const get = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
  return kind.includes("webgl") ? null : get.call(this, kind, ...more);
};
"""
NO_PLOTLY = "globalThis.Plotly = { react() {} };"


class Served:
    """A console on a flight process; it can be stopped and started again on its port."""

    spaces = bench = clearances = None  # views that it has

    def __init__(self, flight, folder) -> None:
        self.flight, self.folder = flight, folder
        with socket.socket() as s:
            s.bind(("127.0.0.1", 0))
            self.access = Access(s.getsockname()[1])
        self._end = None
        self.start()

    def start(self) -> None:
        geometry = Geometry(BIN)
        self.picture = Picture(geometry)
        clearances = self.clearances = Clearances(self.folder / "clearance")
        desk = Desk(self.flight.url, self.flight.key_file, None, BIN, self.picture, 20.0, clearances)
        self.bench = Bench(self.folder / "bench")
        shelf = Shelf(BIN, self.folder / "made", self.folder / "read", desk)
        desk.elsewhere = lambda: (BIN, shelf.read)
        self.spaces = Spaces(self.folder / "space", shelf, geometry)
        past = Past(
            self.flight.url, self.folder / "recordings", self.folder / "history", self.picture, shelf, desk
        )
        console = Console(
            self.flight.url, geometry, self.picture, desk, None, self.bench, "", shelf, self.spaces, past
        )
        app = make_app(console, self.access)
        self._server = uvicorn.Server(
            uvicorn.Config(app, port=self.access.port, log_level="error", timeout_graceful_shutdown=1)
        )
        self._live = contextlib.ExitStack()
        self._live.enter_context(Live(self.flight.url, self.picture))
        self._thread = threading.Thread(target=self._server.run, daemon=True)
        self._thread.start()
        while not self._server.started:
            time.sleep(0.01)

    def stop(self) -> None:
        self._server.should_exit = True
        self._thread.join()
        self._live.close()
        if self.spaces is not None:
            self.spaces.work.close()
        if self.bench is not None:
            self.bench.close()
        if self.clearances is not None:
            self.clearances.work.close()


@contextlib.contextmanager
def opened(browser, served, drawn="figures"):
    """A page of the console, with "words", "figures" or "scenes"; whatever it asks for from elsewhere, and
    every error of it, fails the test."""
    context = browser.new_context(viewport={"width": 1280, "height": 800})
    page = context.new_page()
    page.set_default_timeout(30_000)
    if drawn != "scenes" and not SHOTS:
        page.add_init_script(FLAT)
    if drawn == "words" and not SHOTS:
        page.route("**/plotly.js", lambda r: r.fulfill(body=NO_PLOTLY, content_type="text/javascript"))
    asked, errors = [], []
    page.on("request", lambda r: asked.append(r.url))
    page.on("pageerror", lambda e: errors.append(str(e)))
    page.on("console", lambda m: errors.append(m.text) if "Content Security Policy" in m.text else None)
    page.goto(served.access.start)
    yield page
    context.close()
    here = ("http://127.0.0.1:", "ws://127.0.0.1:", "data:", "blob:")
    assert not [url for url in asked if not url.startswith(here)]
    assert not errors


def shot(page, name):
    """Light and small as in the documents, dark, and on a large screen."""
    if not SHOTS:
        return
    small = {"width": 1280, "height": 800}
    for more, scheme, size in (("", "light", small), ("-dark", "dark", small), ("-wide", "light", WIDE)):
        page.emulate_media(color_scheme=scheme)
        page.set_viewport_size(size)
        page.wait_for_timeout(1500)
        page.screenshot(path=f"{SHOTS}/{name}{more}.png")
    page.set_viewport_size(small)


def serious(page):
    """What axe-core calls serious or critical; ABORT has to be inside the window."""
    box = page.locator("#abort").bounding_box()
    assert box["x"] + box["width"] <= page.viewport_size["width"]
    found = Axe().run(page, options={"resultTypes": ["violations"]}).response["violations"]
    return [(v["id"], v["nodes"][0]["html"]) for v in found if v["impact"] in ("serious", "critical")]


def test_a_calibration_is_reviewed_approved_in_two_steps_and_seen_in_force(browser, tmp_path):
    with SimulatedFlight("paper", {"REVIEW"}, tmp_path) as flight:
        served = Served(flight, tmp_path)
        with opened(browser, served) as page:
            expect(page.locator(".state h1")).to_contain_text("REVIEW", timeout=60_000)
            expect(page.locator(".state")).to_contain_text("24 of 24 poses")
            assert serious(page) == []
            shot(page, "now-review")
            page.locator(".state a").click()
            expect(page.locator(".document h1")).to_contain_text("Correction")
            crc = page.locator(".document h1").inner_text().split()[-1]
            expect(page.locator("#clearance")).to_contain_text("verified segments")
            expect(page.locator("#reach")).to_contain_text("local initial poses")
            expect(page.locator(".decide")).to_contain_text(
                "local initial poses no longer with a tag in view"
            )
            if SHOTS:
                page.locator("#clearance").scroll_into_view_if_needed()
                shot(page, "corrections-clearance")
            expect(page.locator(".decide .steps button", has_text="Arm the approval")).to_be_disabled()
            page.evaluate("document.querySelector('.document .figure').read = true")
            page.locator("form.seen input").fill("A. Reviewer")
            page.get_by_role("button", name="I have seen it").click()
            page.get_by_role("button", name="Arm the approval").click()
            # a figure that the reader has zoomed stays so
            assert page.evaluate("document.querySelector('.document .figure').read")
            form = page.locator(".decide form", has=page.get_by_role("button", name="ARM", exact=True))
            form.locator("input[name=why]").fill("residuals clean, half of a sen")
            assert serious(page) == []
            shot(page, "corrections-arm")
            assert flight.commands == []  # nothing is sent by the first click

            page.reload()  # a half-typed decision survives
            form = page.locator(".decide form", has=page.get_by_role("button", name="ARM", exact=True))
            expect(form.locator("input[name=why]")).to_have_value("residuals clean, half of a sen")
            form.locator("input[name=why]").fill("residuals clean, rank full")
            form.get_by_role("button", name="ARM", exact=True).click()
            page.get_by_role("button", name="Put it in force").click()
            expect(page.locator(".countdown")).to_contain_text("expires in")
            form = page.locator(".decide form", has=page.get_by_role("button", name="GO", exact=True))
            form.locator("input[name=why]").fill("agreed")
            shot(page, "corrections-go")
            form.get_by_role("button", name="GO", exact=True).click()
            expect(page.locator(".force code")).to_have_text(crc)
            expect(page.locator(".decide")).to_contain_text("In force. Nothing to decide.")
            expect(page.locator(".journal")).to_contain_text(f"approve {crc}")
            shot(page, "corrections-in-force")

            page.get_by_role("button", name="Roll back").click()
            form = page.locator(".force form")
            expect(form.locator(".preview")).to_contain_text("J7.phi_rad goes back by -74 deg")
            if SHOTS:
                expect(page.locator(".review")).to_contain_text("Clearance with the table before")
                shot(page, "corrections-roll-back")
            form.locator("input[name=why]").fill("wrong arm")
            form.get_by_role("button", name="ROLLBACK").click()
            expect(page.locator(".force code")).not_to_have_text(crc)

            page.get_by_role("link", name="History").click()
            expect(page.locator("#in-force")).to_contain_text("KIN")
            expect(page.locator("#trend")).to_contain_text("J7.phi_rad")
            assert serious(page) == []
            shot(page, "history")
            page.get_by_role("link", name="Corrections").click()
            page.get_by_role("button", name="Diagnose these measurements").click()
            expect(page.locator(".work")).to_contain_text("diagnose:")
            expect(page.get_by_role("combobox", name="Arm table")).to_have_value("shipped: wam")
            page.get_by_role("button", name="cancel").click()
            expect(page.locator(".work")).to_contain_text("diagnose cancelled")
        served.stop()
        assert flight.commands == [kcm.cmd_t.APPROVE_ARM, kcm.cmd_t.APPROVE_GO, kcm.cmd_t.ROLLBACK]
        lines = journal.read(journal.place(None, flight.key_file)).entries
        decided = [(e.decision, e.crc) for e in lines if e.decision not in ("attempt", "refused")]
        assert decided[:3] == [(d, crc) for d in ("seen", "arm", "approve")]
        assert decided[3:] == [("rollback", crc)]


def test_abort_is_one_click_in_mid_motion_and_a_lost_server_is_said(browser, tmp_path):
    with SimulatedFlight("paper", {"MEASURE"}, tmp_path) as flight:
        served = Served(flight, tmp_path)
        with opened(browser, served, "scenes") as page:
            expect(page.locator(".state h1")).not_to_contain_text("UNKNOWN")
            expect(page.locator(".scene canvas").first).to_be_visible()
            flight.wait({"MOVE"})
            page.locator("#abort").click()
            expect(page.locator(".state h1")).to_contain_text("SAFE")
            expect(page.locator("#said")).to_contain_text("ABORT done")
            expect(page.locator(".events .list")).to_contain_text("CAL_ABORTED")
            assert flight.commands == [kcm.cmd_t.ABORT]
            shot(page, "now-safe")

            served.stop()
            expect(page.locator("#lost")).to_contain_text("Link to server lost since")
            expect(page.locator("body")).to_have_class("console lost waiting")
            shot(page, "now-lost")
            served.start()
            expect(page.locator("#lost")).to_be_hidden()
            expect(page.locator(".events .list")).to_contain_text("link to server lost from")
            expect(page.locator(".state h1")).to_contain_text("SAFE")
        served.stop()


def test_the_workbench_from_upload_to_undo(browser, tmp_path):
    poses.arm_toml(tmp_path / "arm.toml")
    poses.poses_csv(tmp_path / "poses.csv", 40, seed=1)
    with SimulatedFlight("healthy", {"IDLE", "MOVE"}, tmp_path) as flight:
        served = Served(flight, tmp_path)
        with opened(browser, served) as page:
            page.get_by_role("link", name="Workbench").click()
            page.locator("input[type=file]").set_input_files([tmp_path / "arm.toml", tmp_path / "poses.csv"])
            expect(page.get_by_role("combobox").nth(1)).to_have_value("uploaded: poses.csv")
            page.get_by_role("button", name="Fit").click()
            expect(page.locator(".work")).to_contain_text("fit done in", timeout=60_000)
            expect(page.locator(".document h1")).to_contain_text("Fitted model")
            expect(page.locator(".fits")).to_contain_text("nominal arm")
            page.locator("input[name=effect]").fill("backlash[2]")
            page.get_by_role("button", name="add", exact=True).click()
            expect(page.locator(".effects")).to_contain_text("backlash[2]")
            expect(page.locator(".answer")).to_contain_text("This answer is of another case")
            page.reload()  # the case lies on disk
            expect(page.locator(".effects")).to_contain_text("backlash[2]")
            assert serious(page) == []
            page.get_by_role("button", name="undo").click()
            expect(page.locator(".effects")).not_to_contain_text("backlash[2]")
        served.stop()
