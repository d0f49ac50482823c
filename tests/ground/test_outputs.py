"""Paths that commands write to: checked before the work, with words that say what to do."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest
from click.testing import CliRunner

from kincal.cli import main
from kincal.cli.errors import EXIT_INPUT

ROOT = Path(__file__).resolve().parents[2]


def refused(*args):
    """The error of a command that must not have begun: its other files do not exist."""
    done = CliRunner().invoke(main, list(map(str, args)))
    assert isinstance(done.exception, SystemExit), done.exc_info
    assert done.exit_code == EXIT_INPUT
    return done.stderr


def diagnose(report):
    return "model", "diagnose", "--arm", "none.toml", "--data", "none.csv", "--report", report


@pytest.mark.parametrize("name", ["report.pdf", "report", "report.png", "report.html.zip"])
def test_a_report_of_an_unknown_kind_is_refused_with_what_is_possible(tmp_path, name):
    error = refused(*diagnose(tmp_path / name))
    assert ".html" in error
    assert not (tmp_path / name).exists()


@pytest.mark.parametrize("name", ["picture.pdf", "picture.jpg", "picture"])
def test_a_picture_of_an_unknown_kind_is_refused_with_what_is_possible(tmp_path, name):
    source = ROOT / "tables" / "src" / "space.toml"
    error = refused("space", "build", source, tmp_path / "space.tbl", "--picture", tmp_path / name)
    assert ".png or .svg" in error
    assert not (tmp_path / "space.tbl").exists()


COMMANDS = {
    "diagnose": (lambda out: diagnose(out.with_suffix(".html"))),
    "uplink": (lambda out: ("model", "uplink", "--model", "none.toml", "-o", out)),
    "uplink --fly": (lambda out: ("model", "uplink", "--model", "none.toml", "--fly", out)),
    "fit": (lambda out: ("model", "fit", "--arm", "none.toml", "--data", "none.csv", "--model", out)),
    "import": (lambda out: ("arm", "import", "none.urdf", "-o", out)),
    "run": (lambda out: ("run", "paper", "--fast", "--out", out)),
    "schema": (lambda out: ("schema", "--out", out)),
    "space": (lambda out: ("space", "build", ROOT / "tables" / "src" / "space.toml", out)),
    "dump": (lambda out: ("table", "dump", "kin", out)),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_place_below_a_file_is_refused_before_the_work(tmp_path, command):
    (tmp_path / "file").write_text("")
    error = refused(*COMMANDS[command](tmp_path / "file" / "out"))
    assert "no directory" in error
    assert str(tmp_path / "file") in error


@pytest.mark.parametrize("command", ["uplink", "fit", "import", "space", "dump"])
def test_a_directory_in_place_of_a_file_is_refused(tmp_path, command):
    assert "directory" in refused(*COMMANDS[command](tmp_path))


def test_a_file_that_cannot_be_written_is_refused():
    """The kernel's own files refuse even root."""
    if not Path("/proc/version").exists():
        pytest.skip("no /proc here")
    assert "nothing can be written there" in refused(*COMMANDS["uplink"](Path("/proc/none/terms.tbl")))
    assert not Path("/proc/version").stat().st_mode & stat.S_IWUSR


def test_a_pipe_that_nobody_reads_is_refused_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    words = ["review", "comment", "text", "--by", "A", "--journal", str(tmp_path / "pipe")]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == EXIT_INPUT
    assert "nothing can be written there" in done.output


def test_a_path_that_is_fine_is_neither_made_nor_changed(tmp_path):
    kept = tmp_path / "kept.html"
    kept.write_text("as it was")
    before = kept.stat().st_mtime_ns
    assert "none.toml" in refused(*diagnose(kept))
    assert "none.toml" in refused(*diagnose(tmp_path / "new" / "report.html"))
    assert (kept.read_text(), kept.stat().st_mtime_ns) == ("as it was", before)
    assert not (tmp_path / "new").exists()
