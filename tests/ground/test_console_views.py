"""The console's views in a real browser, on flight's own core: a search space from its description to its
read-back, an effect from upload to uplink."""

import lcm
import poses
import pytest
from places import CHROMIUM, ROOT
from playwright.sync_api import expect
from simulated_flight import SimulatedFlight
from test_console_browser import Served, opened, serious, shot
from test_console_spaces import SMALL

import kcm

FRAME = ROOT / "docs" / "img" / "frame.jpg"
WIDTH = "fetch('/api/frame/7').then((a) => a.blob()).then(createImageBitmap).then((b) => b.width)"
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


def test_the_frame_of_the_camera_is_shown_with_its_tags(browser, idle):
    with opened(browser, idle) as page:
        expect(page.locator(".frame")).to_contain_text("No detection and no frame was heard")
        bus, data = lcm.LCM(idle.flight.url), FRAME.read_bytes()
        image, found = kcm.image_t(), kcm.detection_t()
        image.seq, image.width_px, image.height_px = 7, 1920, 1080
        image.n_bytes, image.jpeg = len(data), data
        bus.publish("KC_IMAGE", image.encode())
        expect(page.locator(".frame")).to_contain_text("frame 7")
        found.seq, found.n_tags = 6, 1
        found.tag_id[0], found.corner_px[0:8] = 1, [1000, 500, 1100, 510, 1090, 600, 990, 590]
        bus.publish("KC_DETECTION", found.encode())
        expect(page.locator(".frame")).to_contain_text("frame 7, tags of frame 6")
        found.seq = 7
        bus.publish("KC_DETECTION", found.encode())
        expect(page.locator(".frame")).to_contain_text("frame 7 and its tags")
        width = page.evaluate(WIDTH)
        assert width == 1200
        assert serious(page) == []
        shot(page, "now-frame")


def test_a_space_is_described_built_checked_sent_and_read_back(browser, idle):
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


def test_an_effect_from_upload_to_uplink_to_the_next_flight(browser, idle, tmp_path):
    poses.arm_toml(tmp_path / "arm.toml")
    poses.poses_csv(tmp_path / "poses.csv", 40, seed=1)
    with opened(browser, idle) as page:
        page.get_by_role("link", name="Workbench").click()
        page.locator("input[type=file]").set_input_files([tmp_path / "arm.toml", tmp_path / "poses.csv"])
        expect(page.get_by_role("combobox", name="Measurements")).to_have_value("uploaded: poses.csv")

        page.get_by_role("link", name="An effect of your own").click()
        page.get_by_label("basis").first.fill("tanhh(q4) * cos(q6)")
        page.get_by_role("button", name="Check and keep").click()
        expect(page.locator(".field", has_text="tanhh")).to_be_visible()
        assert serious(page) == []
        shot(page, "workbench-own")
        page.get_by_label("basis").first.fill("tanh(q4) * cos(q6)")
        page.get_by_role("button", name="Check and keep").click()
        expect(page.locator(".effects")).to_contain_text("odd_coupling")
        page.locator("input[name=effect]").fill("backlash[9]")
        page.get_by_role("button", name="add", exact=True).click()
        expect(page.locator("#said")).to_contain_text("there is no joint 9")

        expect(page.get_by_role("button", name="Make the TERMS table")).to_be_disabled()
        page.get_by_role("button", name="Fit", exact=True).click()
        expect(page.locator(".document h1")).to_contain_text("Fitted model", timeout=SLOW_MS)
        expect(page.get_by_role("link", name="calibrated_arm.c")).to_be_visible()
        page.get_by_role("button", name="Make the TERMS table").click()
        expect(page.locator(".right")).to_contain_text("with odd_coupling")
        assert serious(page) == []
        shot(page, "workbench-uplink")
        page.get_by_role("link", name="and send it").click()
        crc = page.locator(".tables .chosen b", has_text="TERMS")
        expect(crc).to_be_visible()
        before = len(idle.flight.commands)
        page.get_by_role("button", name="Send the TERMS table").click()
        form = page.locator(".side .confirm form")
        form.locator("input[name=by]").fill("A. Planner")
        form.locator("input[name=why]").fill("found by the workbench")
        assert len(idle.flight.commands) == before  # nothing is sent by the first click
        shot(page, "tables-send-terms")
        form.get_by_role("button", name="SEND", exact=True).click()
        expect(page.locator("#said")).to_contain_text("is in force", timeout=SLOW_MS)
        expect(page.locator(".side .chosen")).to_contain_text("made here, in force")

        page.get_by_role("link", name="Now").click()
        page.get_by_role("button", name="START a calibration").click()
        form = page.locator(".state form")
        form.locator("input[name=why]").fill("with the new effect")
        form.get_by_role("button", name="START", exact=True).click()
        expect(page.locator(".state h1")).not_to_contain_text("IDLE")
        assert idle.flight.commands[-1] == kcm.cmd_t.START
        page.get_by_role("link", name="History").click()
        expect(page.locator("#in-force")).to_contain_text("by A. Planner: found by the workbench")
        assert serious(page) == []
        shot(page, "history-tables")
