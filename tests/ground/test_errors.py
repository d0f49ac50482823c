"""Errors: plain exceptions in the library, an exit status only in the CLI."""

import ast
import subprocess
import sys

import click
import pytest
from click.testing import CliRunner
from commands import shell
from places import BIN, ROOT

from kincal.cli.errors import EXIT_INPUT, EXIT_INTERRUPTED, Commands
from kincal_shared.errors import BadInput, CannotAnswer, CommandFailed, KincalError


def test_error_says_what_where_and_what_to_do_in_three_lines():
    error = BadInput("no joint 9", "arm.toml: joint", "count joints from 1")
    assert str(error).splitlines() == [
        "no joint 9",
        "  where: arm.toml: joint",
        "  to do: count joints from 1",
    ]
    assert str(KincalError("only what")) == "only what"


@pytest.mark.parametrize("package", ["api", "cli", "link", "operate", "review", "run"])
def test_every_error_of_what_an_operator_types_says_what_to_do(package):
    """One that only said what was wrong left its reader there."""
    silent = []
    for file in sorted((ROOT / "ground" / "kincal" / package).rglob("*.py")):
        for call in ast.walk(ast.parse(file.read_text())):
            name = getattr(getattr(call, "func", None), "id", "")
            if name in ("BadInput", "CommandFailed", "CannotAnswer"):
                todo = len(call.args) > 2 or any(k.arg == "todo" for k in call.keywords)
                silent += [] if todo else [f"{file.name}:{call.lineno}"]
    assert silent == []


def command_that_raises(error):
    @click.group(cls=Commands)
    def main():
        pass

    @main.command()
    def work():
        raise error

    return CliRunner().invoke(main, ["work"])


@pytest.mark.parametrize(
    ("kind", "status"), [(CommandFailed, 1), (BadInput, 2), (KincalError, 2), (CannotAnswer, 3)]
)
def test_every_error_ends_a_command_with_its_status_and_its_text(kind, status):
    done = command_that_raises(kind("it went wrong", "here", "try again"))
    assert done.exit_code == status
    assert done.output == "Error: it went wrong\n  where: here\n  to do: try again\n"


def test_interrupted_command_ends_with_130():
    done = command_that_raises(KeyboardInterrupt())
    assert done.exit_code == EXIT_INTERRUPTED == 130
    assert "Traceback" not in done.output


@pytest.mark.parametrize(
    ("imported", "loaded", "unwanted"),
    [
        ("kincal.cli, kincal.workbench", "numpy", {"scipy.stats", "scipy.optimize", "plotly", "pyarrow"}),
        ("kincal, kincal_shared.errors", "kincal",
         {"click", "rich", "plotly", "jinja2", "kaleido", "mujoco", "cv2", "numpy"}),
    ],
    ids=["commands and workbench", "library"],
)  # fmt: skip
def test_what_few_answers_need_is_not_loaded_before(imported, loaded, unwanted):
    script = f"import sys, {imported}; print(*sys.modules)"
    env = {"PYTHONPATH": str(ROOT / "ground")}
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=env)
    names = set(done.stdout.split())
    assert loaded in names and not unwanted & names, done.stderr


@pytest.mark.parametrize(
    ("command", "said", "todo"),
    [
        ("run healthy --fast --seed 99999999999", "not in the range 0<=x<=2147483647", "--help"),
        ("run healthy --fast --seed -1", "not in the range", "--help"),
        ("run nothere.toml --fast", "where: nothere.toml", "give a file or one of"),
        ("run . --fast", "no scenario '.'", "give a file or one of"),
        ("run ./ --fast", "this is a directory", "give a file or one of"),
        ("run healthy --fast --out bytes", "bytes is no directory", "name another folder"),
        ("table build empty out", "no sources of tables", "name a file, or their folder"),
        ("table show empty", "Is a directory", "name a table image"),
        ("table diff {bin}/arm.tbl {bin}/kin.tbl", "cannot be compared", "of the same kind"),
        ("arm import bytes -o o.toml", "not a URDF: no XML", "begins with <robot>"),
        ("arm import none.urdf -o o.toml", "no such file", "name a URDF"),
        ("command noop --url nonsense", "this is no LCM URL", "such as udpm://"),
        ("review history bytes", "no message of tables or corrections", "logs of a run"),
    ],
)
def test_a_wrong_word_is_met_with_what_is_wrong_and_what_to_do(
    tmp_path, monkeypatch, capfd, command, said, todo
):
    """What is wrong and what to do; it was a traceback, words of a library, or nothing at all."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "bytes").write_bytes(bytes(range(128, 250)))
    done = shell(*command.format(bin=BIN).split())
    assert done.exit_code == EXIT_INPUT and isinstance(done.exception, SystemExit)
    assert said in done.stderr and todo in done.stderr
    printed = capfd.readouterr()
    assert not printed.err and "Traceback" not in printed.out  # by libraries, past the command


def test_missing_tables_are_asked_for_as_they_are_written(tmp_path):
    """`write shape = ...` and `write joint = "one [[joint]] table for each joint"` are no TOML."""
    (tmp_path / "empty.toml").write_text("")
    said = shell("space", "build", tmp_path / "empty.toml", tmp_path / "o.tbl").stderr
    assert "shape: is missing; write a table [[shape]] for each" in said
    assert "error_bounds: is missing; write the table [error_bounds]" in said
    given = "--arm", tmp_path / "empty.toml", "--data", tmp_path / "none.csv"
    said = shell("model", "compare", *given).stderr
    assert "joint: is missing; write one [[joint]] table for each joint" in said
