"""Paths that commands write to: checked before the work, with words that say what to do."""

from __future__ import annotations

import json
import os
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import poses
import pytest
from commands import good, kincal, shell
from medium import full_medium
from places import SRC

from kincal.cli.errors import EXIT_INPUT
from kincal_shared.errors import BadInput
from kincal_shared.letters import unseen
from kincal_shared.writing import MARK, claim, write_file, write_files


def refused(*args):
    """The error of a command that must not have begun: its other files do not exist."""
    done = shell(*args)
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
    source = SRC / "space.toml"
    error = refused("space", "build", source, tmp_path / "space.tbl", "--picture", tmp_path / name)
    assert ".png or .svg" in error
    assert not (tmp_path / "space.tbl").exists()


COMMANDS = {
    "diagnose": (lambda out: diagnose(out.with_suffix(".html"))),
    "uplink": (lambda out: ("model", "uplink", "--model", "none.toml", "-o", out)),
    "uplink --fly": (lambda out: ("model", "uplink", "--model", "none.toml", "--fly", out)),
    "fit": (lambda out: ("model", "fit", "--arm", "none.toml", "--data", "none.csv", "--model", out)),
    "export": (lambda out: ("model", "export", "--model", "none.toml", "--format", "c", "-o", out)),
    "next": (lambda out: ("model", "next", "--arm", "a", "--data", "d", "-o", out, "backlash", "base_flex")),
    "import": (lambda out: ("arm", "import", "none.urdf", "-o", out)),
    "run": (lambda out: ("run", "paper", "--fast", "--out", out)),
    "schema": (lambda out: ("schema", "--out", out)),
    "space": (lambda out: ("space", "build", SRC / "space.toml", out)),
    "dump": (lambda out: ("table", "dump", "kin", out)),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_place_below_a_file_is_refused_before_the_work(tmp_path, command):
    (tmp_path / "file").write_text("")
    error = refused(*COMMANDS[command](tmp_path / "file" / "out"))
    assert "no directory" in error
    assert str(tmp_path / "file") in error


@pytest.mark.parametrize("command", ["uplink", "fit", "export", "next", "import", "space", "dump"])
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
    done = shell(*words)
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


@pytest.mark.parametrize("command", ["diagnose", "uplink", "fit", "export", "next", "import"])
def test_a_folder_that_is_not_there_is_named_before_the_work(tmp_path, command):
    assert f"the folder {tmp_path / 'mistyped'} is not there yet" in refused(
        *COMMANDS[command](tmp_path / "mistyped" / "out")
    )
    assert not (tmp_path / "mistyped").exists()


@pytest.mark.parametrize(
    ("command", "out"),
    [("export --model M.toml --format dh", "run1.toml"), ("export --model M.toml --format dh", "link.toml"),
     ("next --arm arm.toml --data run1.csv backlash[1] backlash[2]", "run1.csv")],
)  # fmt: skip
def test_measurements_are_never_written_over(tmp_path, monkeypatch, command, out):
    """The table run1.csv beside run1.toml took the place of the poses that the model was fitted to."""
    monkeypatch.chdir(tmp_path)
    poses.arm_toml(tmp_path / "arm.toml")
    before = poses.poses_csv(tmp_path / "run1.csv", 40, 1).read_bytes()
    (tmp_path / "link.csv").symlink_to("run1.csv")
    good("model", "fit", "--arm", "arm.toml", "--data", "run1.csv", "--model", "M.toml")
    done = kincal(*command.split(), "-o", out)
    assert done.exit_code == EXIT_INPUT and "is an input, and would be overwritten" in done.output
    assert (tmp_path / "run1.csv").read_bytes() == before


@pytest.mark.parametrize(
    "words",
    [("table", "build"), ("space", "build"), ("arm", "import", "-o"), ("model", "uplink", "--model", "-o")],
)
def test_what_people_wrote_is_never_written_over_by_what_is_made_of_it(tmp_path, words):
    mine = tmp_path / "mine.toml"
    mine.write_bytes((SRC / "kernel.toml").read_bytes())
    given = [*words[:-1], mine, "-o", mine] if words[-1] == "-o" else [*words, mine, mine]
    assert "is an input, and would be overwritten" in refused(*given)
    assert mine.read_bytes() == (SRC / "kernel.toml").read_bytes()


# --------------------------------------------------------------------------- no room


def contents(folder):
    return {path.relative_to(folder): path.is_file() and path.read_bytes() for path in folder.rglob("*")}


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """arm.toml, poses.csv, and M.toml fitted to them."""
    folder = tmp_path_factory.mktemp("fitted")
    poses.arm_toml(folder / "arm.toml", masses=False)
    poses.poses_csv(folder / "poses.csv", 40, 5)
    good("model", "fit", *_given(folder), "--model", folder / "M.toml")
    return folder


def _given(folder):
    return "--arm", str(folder / "arm.toml"), "--data", str(folder / "poses.csv")


WRITTEN = {
    "add": (lambda f: ("model", "add", "--model", f / "M.toml", "backlash[1]"), "M.toml"),
    "fit": (lambda f: ("model", "fit", *_given(f), "--model", f / "M.toml"), "M.toml"),
    "fit anew": (lambda f: ("model", "fit", *_given(f), "--model", f / "new" / "N.toml"), "N.toml"),
    "export": (lambda f: ("model", "export", "--model", f / "M.toml", "--format", "dh",
                          "-o", f / "a" / "b" / "x.toml"), "x.toml"),
    "report": (lambda f: ("model", "diagnose", *_given(f), "--report", f / "new" / "r.html"), "r.html"),
    "next": (lambda f: ("model", "next", *_given(f), "--count", 1, "-o", f / "n.csv", "backlash[1]",
                        "backlash[2]"), "n.csv"),
    "schema": (lambda f: ("schema", "--out", f / "schemas"), "arm.schema.json"),
}  # fmt: skip


@pytest.mark.parametrize("command", WRITTEN)
def test_without_room_everything_stays_as_it_was(fitted, command):
    args, name = WRITTEN[command]
    before = contents(fitted)
    with full_medium():
        error = refused(*args(fitted))
    assert "cannot be written: File too large" in error
    assert name in error
    assert "to do:" in error
    assert contents(fitted) == before


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_standard_output_without_room_is_named():
    command = [sys.executable, "-m", "kincal", "arm", "show", "wam"]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == EXIT_INPUT
    assert "No space left on device\n  where: standard output" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_file_replaced_keeps_its_rights_and_a_link_stays_one(tmp_path):
    kept, link = tmp_path / "kept", tmp_path / "link"
    kept.write_text("old")
    kept.chmod(0o640)
    link.symlink_to(kept)
    write_file(link, "new")
    assert link.is_symlink()
    assert (kept.read_text(), kept.stat().st_mode & 0o777) == ("new", 0o640)


@pytest.mark.parametrize("links", [("M.toml",), ("M.toml", "other")])
def test_a_link_that_leads_to_itself_is_refused_and_stays(tmp_path, links):
    for name, target in zip(links, (*links[1:], links[0]), strict=True):
        (tmp_path / name).symlink_to(target)
    done = kincal("add", "--model", tmp_path / "M.toml", "base_flex")
    assert done.exit_code == EXIT_INPUT
    assert f"symbolic links\n  where: {tmp_path / 'M.toml'}" in done.stderr
    assert "this symbolic link leads to itself" in done.stderr
    with pytest.raises(BadInput, match="symbolic links"):
        write_file(tmp_path / "M.toml", "new")
    assert all((tmp_path / name).is_symlink() for name in links)


def test_a_link_to_a_file_that_is_not_there_yet_stays_one(tmp_path):
    (tmp_path / "M.toml").symlink_to("new.toml")
    good("model", "add", "--model", tmp_path / "M.toml", "base_flex")
    assert (tmp_path / "M.toml").is_symlink() and (tmp_path / "new.toml").is_file()


def test_standard_output_can_be_named_as_a_file(fitted):
    command = [sys.executable, "-m", "kincal", *map(str, WRITTEN["next"][0](fitted))]
    command[command.index(str(fitted / "n.csv"))] = "/dev/stdout"
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "q1,q2,q3" in done.stdout


def test_a_folder_in_which_nothing_can_be_made_is_refused_before_the_work(tmp_path, monkeypatch):
    (tmp_path / "report.html").write_text("")
    monkeypatch.setattr(tempfile, "TemporaryFile", raises(PermissionError(13, "Permission denied")))
    assert "nothing can be written there: Permission denied" in refused(*diagnose(tmp_path / "report.html"))


def raises(error):
    def function(*_args, **_named):
        raise error

    return function


def test_of_several_files_all_are_written_or_none(tmp_path):
    (tmp_path / "old").write_text("old")
    before = contents(tmp_path)
    with full_medium(), pytest.raises(BadInput, match="File too large"):
        write_files({tmp_path / "old": "new", tmp_path / "new" / "small": "", tmp_path / "large": "x" * 101})
    assert contents(tmp_path) == before


@pytest.mark.parametrize("char", ["\u3164", "\u115f", "\u2800", "\u200b", "\ufe0f", "\u00a0", "\n"])
def test_names_with_characters_that_are_not_shown_are_refused(tmp_path, char):
    """Two model files that look alike were two."""
    done = kincal("add", "--model", tmp_path / f"M{char}.toml", "base_flex")
    assert done.exit_code == EXIT_INPUT
    assert f"holds U+{ord(char):04X}, which is not shown" in done.output
    assert list(tmp_path.iterdir()) == []
    effects = tmp_path / "my.toml"
    entry = '[[effect]]\nname = "{}"\n[[effect.parameter]]\nname = "{}"\nsigma = 1.0\n'
    entry += '[[effect.parameter.term]]\nat = "joint[1]"\nbasis = "q1"\n'
    for names in ((f"mi{char}ne", "k"), ("mine", f"k{char}")):
        effects.write_text(entry.format(*(json.dumps(name)[1:-1] for name in names)))
        done = kincal("effects", "--effects", effects)
        assert done.exit_code == EXIT_INPUT, done.output


def test_letters_of_any_script_are_shown():
    assert unseen("joint\U0001d159") == "U+1D159"  # a note without a head
    assert unseen("\uae38 Pr\u00fcfstand \u03b1 2.toml") == ""
    assert unseen("bytes that are no text \udc80") == ""


def test_a_mark_that_is_no_text_marks_nothing(tmp_path):
    """What a power loss left of it ended in a traceback, of an empty folder and of one with files."""
    (tmp_path / MARK).write_bytes(b"\xff\xfe\x00")
    claim(tmp_path, "a test", ["a.txt"])
    (tmp_path / MARK).write_bytes(b"\xff\xfe\x00")
    (tmp_path / "a.txt").write_text("mine")
    with pytest.raises(BadInput, match=r"holds a\.txt"):
        claim(tmp_path, "a test", ["a.txt"])


@pytest.mark.parametrize(
    "make",
    [
        Path.mkdir,
        os.mkfifo,
        lambda mark: mark.symlink_to("mine"),
        lambda mark: mark.symlink_to("not there"),
    ],
    ids=["folder", "pipe", "link", "dangling link"],
)
def test_only_a_file_is_a_mark(tmp_path, make):
    """The file that a link leads to was rewritten, or made; at a pipe the command waited for ever."""
    (tmp_path / "mine").write_bytes(b"\xff\r\n")
    make(tmp_path / MARK)
    with pytest.raises(BadInput) as error:
        claim(tmp_path, "a test", ["a.txt"])
    assert error.value.where == str(tmp_path / MARK)
    assert (tmp_path / "mine").read_bytes() == b"\xff\r\n" and not (tmp_path / "not there").exists()
