"""Command lines on the pages that an operator reads can be typed: the command exists, takes these options and
so many arguments, and no option that it needs is missing. Nothing is run."""

import re
import shlex

import click
import pytest
from places import ROOT

from kincal.cli import main

PAGES = ("README.md", "docs/OPERATIONS.md", "docs/CONSOLE.md", "docs/GROUND.md")
# Of a decision: OPERATIONS says at the beginning that its tables leave them out.
LEFT_OUT = {"by", "why"}


def in_blocks(text):
    """Lines of shell blocks that call `kincal`, without their comments."""
    for block in re.findall(r"^```sh\n(.*?)^```", text, re.S | re.M):
        for part in re.split(r"\n|&& ", block):
            if part.startswith("kincal "):
                yield part


def in_text(text):
    """Code spans that call `kincal` with more than the name of a command."""
    prose = re.sub(r"^```.*?^```", "", text, flags=re.S | re.M)
    yield from re.findall(r"`(kincal [^`]+)`", prose)


def words(line):
    return [w for w in shlex.split(line, comments=True) if w not in ("&", "...")][1:]


def parsed(given, needs_all):
    """Why a command line cannot be typed; "" if it can."""
    command, context = main, click.Context(main, info_name="kincal")
    while isinstance(command, click.Group) and given and not given[0].startswith("-"):
        name, given = given[0], given[1:]
        command = command.get_command(context, name)
        if command is None:
            return f"no command {name}"
        context = click.Context(command, info_name=name, parent=context)
    if isinstance(command, click.Group):
        return ""  # a chapter of the page
    if not given and not needs_all:
        return ""  # only named
    try:
        options, rest, _ = command.make_parser(context).parse_args(list(given))
    except click.UsageError as error:
        return error.format_message()
    if rest:
        return f"too many arguments: {rest}"
    missing = {p.name for p in command.params if p.required and not options.get(p.name)}
    return f"lacks {missing}" if missing - (set() if needs_all else LEFT_OUT) else ""


@pytest.mark.parametrize("page", PAGES)
def test_command_lines_of_blocks_can_be_typed_as_they_stand(page):
    lines = list(in_blocks((ROOT / page).read_text("utf-8")))
    assert lines
    wrong = {line: why for line in lines if (why := parsed(words(line), needs_all=True))}
    assert not wrong


def test_commands_that_the_tables_of_operations_name_can_be_typed():
    """Remedies of events are in these tables: they come from fsw/tables/kc_events.toml."""
    spans = set(in_text((ROOT / "docs" / "OPERATIONS.md").read_text("utf-8")))
    assert len(spans) > 40
    wrong = {span: why for span in spans if (why := parsed(words(span), needs_all=False))}
    assert not wrong


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("kincal model diagnose --data LOG", "lacks {'arm_path'}"),
        ("kincal review arm", ""),
        ("kincal review arm CRC", ""),
        ("kincal review arm CRC --loudly", "No such option '--loudly'"),
        ("kincal review frobnicate", "no command frobnicate"),
        ("kincal status now", "too many arguments: ['now']"),
    ],
)
def test_a_line_that_cannot_be_typed_is_noticed(line, why):
    said = parsed(words(line), needs_all=False)
    assert said.startswith(why) and bool(said) == bool(why)
