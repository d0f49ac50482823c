"""The console's views in a real browser, on flight's own core: a search space from its description to its
read-back, an effect from upload to uplink."""

import pytest
from playwright.sync_api import expect
from simulated_flight import SimulatedFlight
from test_console_browser import CHROMIUM, Served, browser, opened, serious, shot  # noqa: F401 a fixture
from test_console_spaces import SMALL

import kcm

SLOW_MS = 150_000  # of a process of its own, on a busy machine
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here")


@pytest.fixture(scope="module")
def idle(tmp_path_factory):
    """A console on flight in IDLE, for all tests here."""
    folder = tmp_path_factory.mktemp("console")
    with SimulatedFlight("healthy", {"IDLE"}, folder, start=False) as flight:
        served = Served(flight, folder)
        yield served
        served.stop()


def test_a_space_is_described_built_checked_sent_and_read_back(browser, idle):  # noqa: F811
    with opened(browser, idle) as page:
        expect(page.locator(".state h1")).to_contain_text("IDLE")
        page.keyboard.press("Alt+5")
        expect(page.locator(".list li")).to_have_count(300)
        expect(page.locator(".content")).to_contain_text("verified for DH errors up to")
        page.locator(".list ul").focus()
        page.keyboard.press("End")
        page.keyboard.press("ArrowUp")
        expect(page.locator(".content")).to_contain_text("Candidate 298 passes all checks")
        expect(page.locator(".content")).to_contain_text("nominal clearance")
        assert serious(page) == []
        shot(page, "space-candidates")

        page.get_by_role("link", name="Description").click()
        page.get_by_label("tag_min_px").fill("-3")
        page.get_by_role("button", name="Check and keep").click()
        wrong = page.locator(".field", has=page.get_by_label("tag_min_px"))
        expect(wrong).to_contain_text("must be 0 or more")
        assert serious(page) == []
        shot(page, "space-description")
        page.reload()  # what was typed is still there
        expect(page.get_by_label("tag_min_px")).to_have_value("-3")
        page.get_by_label("tag_min_px").fill("30.0")
        for path, text in SMALL.items():
            page.locator(f'[name="{path}"]').fill(text)
        page.get_by_role("button", name="Check and keep").click()
        expect(page.locator(".form-head")).to_contain_text("as kept")

        page.get_by_role("button", name="Build", exact=True).click()
        expect(page.locator(".document h1")).to_contain_text("2 candidates", timeout=SLOW_MS)
        shot(page, "space-built")
        crc = page.locator(".document h1").inner_text().split()[-1]
        page.locator(".tables button", has_text=crc).click()
        expect(page.locator(".list li")).to_have_count(2)
        page.get_by_role("button", name=f"Check {crc}").click()
        expect(page.locator(".document .verdict")).to_contain_text("It holds", timeout=SLOW_MS)
        assert serious(page) == []
        shot(page, "space-checked")

        page.get_by_role("button", name=f"Send {crc}").click()
        form = page.locator(".side .confirm form")
        expect(form).to_contain_text("only in the first, only in the second")
        assert kcm.cmd_t.TABLE_ACTIVATE not in idle.flight.commands  # nothing is sent by the first click
        form.locator("input[name=by]").fill("A. Planner")
        form.locator("input[name=why]").fill("a smaller region")
        assert serious(page) == []
        shot(page, "space-send")
        form.get_by_role("button", name="SEND", exact=True).click()
        expect(page.locator(".tables .chosen")).to_contain_text("in force", timeout=SLOW_MS)
        assert idle.flight.commands.count(kcm.cmd_t.TABLE_ACTIVATE) == 1
        page.get_by_role("button", name="Read back").click()
        expect(page.locator(".tables")).to_contain_text("read back, in force")
        page.get_by_role("link", name="Difference").click()
        page.get_by_label("To", exact=True).select_option("read")
        expect(page.locator(".content")).to_contain_text("the same table")
        page.get_by_label("From", exact=True).select_option("folder")
        expect(page.locator(".content")).to_contain_text("300 candidates go, 2 come")
        shot(page, "space-difference")
