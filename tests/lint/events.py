"""docs/EVENTS.md from the lists in fsw/tables/kc_events.h, and the tables of docs/OPERATIONS.md from these
and fsw/tables/kc_events.toml, where every event has a cause and what the operator does.

events.py            write them
events.py --check    fail if they are not what header and table say

Either fails on an event without cause or action, on an entry of no event, and on a command that kincal lacks.
"""

import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
HEADER = ROOT / "fsw/tables/kc_events.h"
TABLE = ROOT / "fsw/tables/kc_events.toml"
DOC = ROOT / "docs/EVENTS.md"
OPERATIONS = ROOT / "docs/OPERATIONS.md"
CLI = ROOT / "docs/CLI.md"
CONFIG = ROOT / "fsw/tables/kc_config.h"

STRING = r'((?:"(?:[^"\\]|\\.)*"\s*)+)'
ENTRY = re.compile(rf"X\(\s*(\d+)\s*,\s*(\w+)\s*,\s*(\w+)\s*,\s*{STRING},\s*{STRING}\)")
TYPE = re.compile(rf"X\(\s*{STRING},\s*{STRING}\)")
CAUSE = re.compile(rf"X\(\s*(\d+)\s*,\s*(\w+)\s*,\s*{STRING}\)")
PLACEHOLDER = re.compile(r"\{([^{}]*)\}")

INTRO = """# Events

Made by `make dict` from `KC_EVENT_LIST` in `fsw/tables/kc_events.h`; do not edit.

Every event carries its id, a severity, three numbers (`index`, `got`, `want`) and the mission time. The text
says what the numbers mean: `{field:type}` stands for one of them, shown as the table of types says. The last
column is the operator's next step. Ids never change their meaning.

## Dictionary

| id | name | severity | text | what to do |
|---:|---|---|---|---|
"""
TYPES_INTRO = """
## Types of values

| type | shown as |
|---|---|
"""
CAUSES_INTRO = """
## Causes of `CAL_ABORTED`

| cause | name | text |
|---:|---|---|
"""


def joined(literals: str) -> str:
    """Text of adjacent C string literals."""
    return "".join(re.findall(r'"((?:[^"\\]|\\.)*)"', literals))


def cell(text: str) -> str:
    return text.replace("|", r"\|")


def list_of(source: str, macro: str) -> str:
    """Body of the list macro: from its #define to the end of the (joined) line."""
    found = re.search(rf"#define {macro}\(X\)(.*)", source)
    if not found:
        sys.exit(f"{HEADER}: no {macro}")
    return found[1]


def check_unique(rows: list[tuple[int, str, str, str, str]]) -> None:
    for what, column in (("id", 0), ("name", 1)):
        values = [r[column] for r in rows]
        if twice := {v for v in values if values.count(v) > 1}:
            sys.exit(f"{HEADER}: {what} used twice: {twice}")


def check_placeholders(rows: list[tuple[int, str, str, str, str]], types: dict[str, str]) -> None:
    for _, name, _, text, _ in rows:
        for placeholder in PLACEHOLDER.findall(text):
            field, _, kind = placeholder.partition(":")
            if field not in ("index", "got", "want") or kind not in types:
                sys.exit(f"{HEADER}: {name}: unknown placeholder {{{placeholder}}}")


def check_same(what: str, want: set[str], got: set[str]) -> None:
    if want - got:
        sys.exit(f"{TABLE}: {what} without an entry: {', '.join(sorted(want - got))}")
    if got - want:
        sys.exit(f"{TABLE}: entry of no {what}: {', '.join(sorted(got - want))}")


def check_named(text: str) -> None:
    """Commands of kincal and fields of CONFIG that a text names exist."""
    commands = set(re.findall(r"^## kincal ([a-z ]+)$", CLI.read_text(), re.M))
    fields = set(re.findall(r"\w+", CONFIG.read_text()))
    for name in re.findall(r"`kincal ((?:[a-z]+ ?)+)", text):
        if not any(name.strip() == c or name.startswith(f"{c} ") for c in commands):
            sys.exit(f"{TABLE}: `kincal {name.strip()}` is no command")
    for name in re.findall(r"`([a-z]+_[a-z_]+)`", text):
        if name not in fields:
            sys.exit(f"{TABLE}: `{name}` is no field of CONFIG")


def with_made(page: str, name: str, made: str) -> str:
    """The page with what stands between the marks replaced."""
    begin, end = f"<!-- made: {name} -->\n", "<!-- end -->"
    if begin not in page:
        sys.exit(f"{OPERATIONS}: no mark {begin.strip()}")
    head, _, rest = page.partition(begin)
    return head + begin + made + rest[rest.index(end) :]


def operations(rows: list[tuple[int, str, str, str, str]], causes: list[tuple[str, str, str]]) -> str:
    """docs/OPERATIONS.md."""
    table = tomllib.loads(TABLE.read_text())
    entries, aborts = table["event"], table["abort"]
    check_same("event", {name for _, name, *_ in rows}, set(entries))
    check_same("cause", {name for _, name, _ in causes}, set(aborts))
    lines = []
    for i, name, sev, text, action in sorted(rows):
        entry = entries[name]
        if set(entry) != {"cause", "do"} or not entry["cause"].strip() or not entry["do"].strip():
            sys.exit(f"{TABLE}: {name}: needs cause and do")
        todo = action if entry["do"] == "Nothing." and action else f"{action} {entry['do']}".strip()
        check_named(entry["cause"] + entry["do"])
        what = PLACEHOLDER.sub(lambda m: f"*{m[1].partition(':')[2]}*", text)
        cells = (str(i), f"`{name}`", sev, what, entry["cause"], todo)
        lines.append("| " + " | ".join(map(cell, cells)) + " |\n")
    head = "| id | event | severity | what happened | likely causes | what to do |\n" + "|---" * 6 + "|\n"
    page = with_made(OPERATIONS.read_text(), "events", "\n" + head + "".join(lines) + "\n")
    for _, name, _ in causes:
        check_named(aborts[name])
    rest = "".join(f"| {i} | `{n}` | {cell(t)} | {cell(aborts[n])} |\n" for i, n, t in causes)
    head = "| cause | name | what happened | what to do |\n" + "|---" * 4 + "|\n"
    return with_made(page, "causes", "\n" + head + rest + "\n")


def documents() -> dict[Path, str]:
    """What each page has to be."""
    source = re.sub(r"\\\n", " ", HEADER.read_text())
    types = {joined(t): joined(how) for t, how in TYPE.findall(list_of(source, "KC_EVENT_TYPE_LIST"))}
    rows = [
        (int(i), name, sev.lower(), joined(text), joined(action))
        for i, name, sev, text, action in ENTRY.findall(list_of(source, "KC_EVENT_LIST"))
    ]
    causes = [(i, name, joined(text)) for i, name, text in CAUSE.findall(list_of(source, "KC_CAUSE_LIST"))]
    if not (rows and types and causes):
        sys.exit(f"{HEADER}: a list is empty")
    check_unique(rows)
    check_placeholders(rows, types)
    events = (
        INTRO
        + "".join(f"| {i} | `{n}` | {sev} | {cell(t)} | {cell(a)} |\n" for i, n, sev, t, a in sorted(rows))
        + TYPES_INTRO
        + "".join(f"| `{t}` | {cell(how)} |\n" for t, how in types.items())
        + CAUSES_INTRO
        + "".join(f"| {i} | `{n}` | {cell(t)} |\n" for i, n, t in causes)
    )
    return {DOC: events, OPERATIONS: operations(rows, causes)}


def main() -> int:
    status = 0
    for path, text in documents().items():
        if "--check" not in sys.argv[1:]:
            path.write_text(text)
        elif not path.exists() or path.read_text() != text:
            print(f"{path.relative_to(ROOT)} is not what {HEADER.relative_to(ROOT)} says: run `make dict`")
            status = 1
    return status


if __name__ == "__main__":
    sys.exit(main())
