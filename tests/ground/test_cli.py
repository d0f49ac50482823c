"""Commands: help, documents, exit status."""

import re

import click
import pytest
from commands import shell as invoke
from places import BIN, ROOT, SRC

from kincal.cli import main
from kincal.cli.errors import EXIT_INPUT

LAYOUT = {"camera": 2, "config": 2, "space": 2}  # of the others 1
GUIDE = (ROOT / "docs" / "GROUND.md").read_text()


def commands(group=main, prefix="kincal"):
    for name, command in sorted(group.commands.items()):
        yield f"{prefix} {name}", command
        if isinstance(command, click.Group):
            yield from commands(command, f"{prefix} {name}")


ALL = dict(commands())


@pytest.mark.parametrize("name", ALL)
def test_command_has_help_with_an_example_and_a_guide_entry(name):
    assert re.search(r"Examples?:\n +kincal ", ALL[name].help)
    assert name in GUIDE


@pytest.mark.parametrize("name", ALL)
def test_every_option_says_what_it_does(name):
    silent = [p.name for p in ALL[name].params if isinstance(p, click.Option) and not p.help]
    assert silent == []


def test_examples_in_help_are_commands_that_exist():
    for name, command in ALL.items():
        for line in re.findall(r"^ +(kincal .*)$", command.help, re.M):
            words = line.split()
            found = max((n for n in ALL if words[: len(n.split())] == n.split()), key=len, default=None)
            assert found is not None, f"{name}: {line}"


def test_table_build_show_check_and_diff(tmp_path):
    out = tmp_path / "config.tbl"
    assert invoke("table", "build", SRC / "config.toml", out).exit_code == 0
    assert out.read_bytes() == (BIN / "config.tbl").read_bytes()
    assert "frames_per_meas" in invoke("table", "show", out).output
    assert '"acquisition": "rate"' in invoke("table", "show", out, "--json").output
    assert invoke("table", "check", out, SRC / "config.toml").exit_code == 0
    assert invoke("table", "diff", out, BIN / "config.tbl").exit_code == 0
    other = tmp_path / "other.toml"
    other.write_text(
        (SRC / "config.toml").read_text().replace("n_poses         = 20", "n_poses         = 21")
    )
    diff = invoke("table", "diff", out, other)
    assert diff.exit_code == 1
    assert re.search(r"n_poses +20 +21", diff.output)


@pytest.mark.parametrize("kind", ["arm", "camera", "terms", "kin", "kernel", "config", "space"])
def test_every_kind_can_be_shown(kind):
    shown = invoke("table", "show", BIN / f"{kind}.tbl")
    assert shown.exit_code == 0, shown.output
    assert f"{kind} table, layout {LAYOUT.get(kind, 1)}" in shown.output


@pytest.mark.parametrize(
    "args",
    [
        ("table", "show", BIN / "nothing.tbl"), ("table", "dump", "legs", "x.tbl"),
        ("space", "show", BIN / "arm.tbl", "--tables", BIN), ("run", "no-such-scenario"),
        ("run", "paper", "--poses", "65"), ("log", SRC / "arm.toml"), ("review", "approve", "12345678"),
    ],
)  # fmt: skip
def test_bad_input_is_status_2_without_a_traceback(args):
    done = invoke(*args)
    assert done.exit_code == EXIT_INPUT, done.output
    assert "Traceback" not in done.output
