"""Write the parts of docs/ that follow from sources: docs/CLI.md from the commands' help, the tables of
docs/INTERFACES.md from the message files and headers, those of docs/TABLES.md from the C source of the
layouts.

    python ground/gen_docs.py            write
    python ground/gen_docs.py --check    say what is out of date; status 1 if anything is

In INTERFACES.md, STATES.md and TABLES.md only what stands between `<!-- made: NAME -->` and `<!-- end -->` is
replaced."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import layouts
from lcm_files import messages, parse

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
WIDTH = 100


# --------------------------------------------------------------------------- blocks of pages


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """A table in Markdown."""
    out = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    out += ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    return "\n".join(out)


def block_channels() -> str:
    """Channels: who sends what to whom."""
    from kincal.link import CHANNELS

    return table(
        ("channel", "type", "from", "to", "rate", "carries"),
        [
            (f"`{c.name}`", f"[`{c.type}`](#{c.type})", c.sender, c.receivers, c.rate, c.purpose)
            for c in CHANNELS
        ],
    )


def block_messages() -> str:
    """Every message type with its fields."""
    from kincal.link import CHANNELS

    used = {c.type: [x.name for x in CHANNELS if x.type == c.type] for c in CHANNELS}
    parts = []
    for m in messages():
        parts.append(
            f"### {m.name}\n\n{', '.join(f'`{c}`' for c in used[m.name])}. {m.comment}".rstrip()
            + "\n\n"
            + table(
                ("field", "type", "unit", "meaning"),
                [(f"`{f.name}`", f"`{f.type}`", f.unit, f.comment) for f in m.fields],
            )
        )
        if m.constants and m.name != "cmd_t":
            parts.append("Constants: " + ", ".join(f"`{n}` = {v}" for n, v in m.constants) + ".")
    return "\n\n".join(parts)


def block_opcodes() -> str:
    """From the comments in cmd_t.lcm, `// NAME: meaning`, one or two names each."""
    text = (ROOT / "fsw/msg/cmd_t.lcm").read_text("utf-8")
    values = {n: v for n, v in parse(ROOT / "fsw/msg/cmd_t.lcm").constants if not n.startswith("SRC_")}
    meaning: dict[str, str] = {}
    names: list[str] = []
    for line in text.splitlines():
        line = line.strip()
        if found := re.match(r"// ([A-Z_]+(?:, [A-Z_]+)*): (.*)", line):
            names = [n.strip() for n in found[1].split(",")]
            for n in names:
                meaning[n] = found[2]
        elif names and line.startswith("//"):
            for n in names:
                meaning[n] += " " + line.removeprefix("//").strip()
        else:
            names = []
    missing = set(values) - set(meaning)
    if missing:
        raise SystemExit(f"cmd_t.lcm does not explain {', '.join(sorted(missing))}")
    return table(
        ("opcode", "name", "meaning and arguments"),
        [(str(v), f"`{n}`", meaning[n]) for n, v in sorted(values.items(), key=lambda item: item[1])],
    )


def c_enum(header: str, name: str) -> list[tuple[str, str, str]]:
    """(value, name, comment) of an enumeration with one name a line."""
    text = (ROOT / header).read_text("utf-8")
    body = re.search(r"typedef enum \{(.*?)\} " + name + ";", text, re.S)
    if body is None:
        raise SystemExit(f"{header}: no enumeration {name}")
    rows = re.findall(r"(KC_\w+)\s*=\s*(-?\d+),?\s*(?:/\*\s*(.*?)\s*\*/)?", body[1], re.S)
    return [(v, n, re.sub(r"\s+", " ", c)) for n, v, c in rows]


def acquisitions() -> str:
    """Numbers and names of kc_acq_t, for comments that name the type."""
    rows = c_enum("fsw/design/kc_acquire.h", "kc_acq_t")
    return ", ".join(f"{v} {n.removeprefix('KC_ACQ_').lower()}" for v, n, _ in rows if n != "KC_ACQ_COUNT")


def block_statuses() -> str:
    """Answers of flight to a command."""
    return table(
        ("status", "name", "meaning"),
        [(v, f"`{n}`", c) for v, n, c in c_enum("fsw/math/kc_status.h", "kc_status_t")],
    )


def block_states() -> str:
    """States of the sequencer."""
    return table(
        ("state", "name", "what happens"),
        [
            (v, f"`{n.removeprefix('KC_ST_')}`", c)
            for v, n, c in c_enum("fsw/state/kc_states.h", "kc_state_t")
        ],
    )


def block_transitions() -> str:
    """Which state comes next: the table that the sequencer itself uses."""
    text = (ROOT / "fsw/state/kc_states.h").read_text("utf-8").replace("\\\n", " ")
    line = re.search(r"#define KC_TRANSITION_LIST\(X\)(.*)", text)
    rows = re.findall(r"X\((\w+), (\w+), (\w+), (\w+)\)", line[1] if line else "")
    if not rows:
        raise SystemExit("fsw/state/kc_states.h: no transitions")
    when = {"SAME_STEP": "the same step", "NEXT_STEP": "the next step"}
    return table(
        ("state", "outcome", "next state", "its work begins in"),
        [(f"`{state}`", outcome.lower(), f"`{then}`", when[step]) for state, outcome, then, step in rows],
    )


def block_kinds() -> str:
    """Kinds of tables."""
    return table(
        ("kind", "name", "holds"),
        [
            (v, f"`{n.removeprefix('KC_TBL_')}`", KIND_TEXT[n])
            for v, n, _c in c_enum("fsw/tables/kc_tables.h", "kc_tbl_kind_t")
            if n in KIND_TEXT
        ],
    )


KIND_TEXT = {
    "KC_TBL_ARM": "DH chain, limits, masses, base and tool frames (`fsw/model/kc_arm.h`)",
    "KC_TBL_CAMERA": "mast, pan-tilt unit, lens, tags on the tool (`fsw/model/kc_camera.h`)",
    "KC_TBL_TERMS": "coefficients and correction terms (`fsw/model/kc_terms.h`)",
    "KC_TBL_KIN": "values of the coefficients in force: what calibration changes (`fsw/tables/kc_tables.h`)",
    "KC_TBL_SPACE": "candidate poses, hubs, verified segments (`fsw/motion/kc_space.h`)",
    "KC_TBL_KERNEL": "spectral tables and hyperparameters (`fsw/design/kc_kernel.h`)",
    "KC_TBL_CONFIG": "how a calibration is run (`fsw/tables/kc_config.h`)",
}


def block_why() -> str:
    """Checks that a candidate passed, as bits."""
    from kincal.space import CHECKS
    from kincal.space.table import local_bit, reserve_bit

    marks = {
        reserve_bit(): "mark of a reserve pose: measured only while fewer than half of the poses before it "
        "showed a tag",
        local_bit(): "mark of a local initial pose, about the park pose; it has none of the bits 0 to 11",
    }
    return table(
        ("bit", "value", "checked and found good"),
        [(str(v.bit_length() - 1), str(v), text) for v, text in (CHECKS | marks).items()],
    )


BLOCKS: dict[str, dict[str, Callable[[], str]]] = {
    "INTERFACES.md": {
        "channels": block_channels,
        "messages": block_messages,
        "opcodes": block_opcodes,
        "statuses": block_statuses,
        "states": block_states,
        "kinds": block_kinds,
        "why": block_why,
    },
    "STATES.md": {"transitions": block_transitions},
    "TABLES.md": {
        kind: partial(layouts.page_table, kind)
        for kind in ("ARM", "CAMERA", "TERMS", "KIN", "SPACE", "KERNEL", "CONFIG")
    },
}


def with_blocks(page: str) -> str:
    """A page of docs/ with its blocks made anew."""
    text = (DOCS / page).read_text("utf-8")
    for name, make in BLOCKS[page].items():
        pattern = re.compile(rf"(<!-- made: {name} -->\n).*?(<!-- end -->)", re.S)
        if len(pattern.findall(text)) != 1:
            raise SystemExit(f"docs/{page} needs exactly one block '<!-- made: {name} -->'")
        made = make().replace("kc_acq_t", acquisitions())
        text = pattern.sub(lambda m, made=made: f"{m[1]}\n{made}\n\n{m[2]}", text)  # type: ignore[misc]
    return text


# --------------------------------------------------------------------------- CLI.md


def commands() -> Iterator[tuple[str, str]]:
    """(full name, help text) of every command, groups first."""
    import click

    from kincal.cli import main

    def walk(command: click.Command, name: str, parent: click.Context | None) -> Iterator[tuple[str, str]]:
        context = click.Context(
            command, info_name=name.split()[-1], parent=parent, terminal_width=WIDTH, max_content_width=WIDTH
        )
        yield name, command.get_help(context)
        if isinstance(command, click.Group):
            for sub in command.list_commands(context):
                child = command.get_command(context, sub)
                if child is not None:
                    yield from walk(child, f"{name} {sub}", context)

    yield from walk(main, "kincal", None)


def cli() -> str:
    """CLI.md: the help of every command."""
    parts = [
        "# Commands of `kincal`\n\nMade by `python ground/gen_docs.py` from the commands' own help; "
        "do not edit.\n"
        "How they are used together: [GROUND.md](GROUND.md)."
    ]
    parts += [f"## {name}\n\n```text\n{text}\n```" for name, text in commands()]
    return "\n\n".join(parts) + "\n"


# --------------------------------------------------------------------------- main


def main(argv: list[str]) -> int:
    """Write or check; the exit status."""
    wanted = {DOCS / page: with_blocks(page) for page in BLOCKS} | {DOCS / "CLI.md": cli()}
    stale = [path for path, text in wanted.items() if not path.is_file() or path.read_text("utf-8") != text]
    if "--check" in argv:
        for path in stale:
            print(
                f"{path.relative_to(ROOT)} is out of date; run `python ground/gen_docs.py`", file=sys.stderr
            )
        return 1 if stale else 0
    for path in stale:
        path.write_text(wanted[path], "utf-8")
        print(f"{path.relative_to(ROOT)} written")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
