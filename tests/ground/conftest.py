"""What several test files share: the true arm's table, the effect library, environments of the wheel."""

import shutil
import subprocess

import poses
import pytest
from environments import SIMULATOR, built_wheel, environment, loaded
from places import BIN, CHROMIUM, ROOT

from kincal import review
from kincal import workbench as wb
from kincal_shared import keys
from kincal_shared.installation import EXTRAS


@pytest.fixture(scope="session")
def arm(tmp_path_factory):
    """The WAM, all of it known but its errors."""
    return wb.read_arm(poses.arm_toml(tmp_path_factory.mktemp("arm") / "arm.toml"))


@pytest.fixture(scope="session")
def library():
    """The effects that ship."""
    return wb.Library.load()


@pytest.fixture(scope="session")
def wheel(tmp_path_factory):
    return built_wheel(tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="session")
def clone(full, tmp_path_factory):
    """What a clone of this tree holds after its build: the files that git has, programs, an environment
    with kincal."""
    root = tmp_path_factory.mktemp("clone")
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True)
    for name in filter(None, listed.stdout.split("\0")):
        if (ROOT / name).is_file():
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, root / name)
    (root / "build").symlink_to(ROOT / "build")
    (root / ".venv").symlink_to(full)
    return root


@pytest.fixture(scope="session")
def plain(wheel, tmp_path_factory):
    return environment(tmp_path_factory.mktemp("plain"), wheel)


@pytest.fixture(scope="session")
def full(wheel, tmp_path_factory):
    return environment(tmp_path_factory.mktemp("full"), wheel, EXTRAS)


@pytest.fixture(scope="session")
def door(full):
    """Where commands are asked for that run in the full environment, all that they need loaded once."""
    with loaded(full, *SIMULATOR) as at:
        yield at


@pytest.fixture(scope="module")
def browser():
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"]
        )
        yield chromium
        chromium.close()


@pytest.fixture(scope="session")
def made(tmp_path_factory):
    """A calibration that has ended with a proposal: flown once, each `WaitingFlight` copies its store."""
    from waiting_flight import proposed  # loads the simulator, which few files need

    return proposed(tmp_path_factory.mktemp("proposed"))


@pytest.fixture(scope="session")
def geometry():
    """What the console draws, from the tables as shipped."""
    from kincal.console.geometry import Geometry  # its packages are an extra

    return Geometry(BIN)


@pytest.fixture
def picture(geometry):
    """A console's last values; nothing was heard yet."""
    from kincal.console.picture import Picture

    return Picture(geometry)


@pytest.fixture
def own_key_file(tmp_path):
    """A file with one new key, of this test alone: its journal is empty."""
    path = tmp_path / "keys"
    keys.new(path)
    return path


@pytest.fixture
def signer(key_file):
    return keys.signer_of(key_file)


@pytest.fixture(scope="session")
def names():
    """Of the coefficients of the tables as shipped."""
    return review.coef_names(BIN)
