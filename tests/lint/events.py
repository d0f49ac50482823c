"""docs/EVENTS.md from the lists in fsw/tables/kc_events.h.

events.py            write it
events.py --check    fail if it is not what the header says
"""

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
HEADER = ROOT / "fsw/tables/kc_events.h"
DOC = ROOT / "docs/EVENTS.md"

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


def document() -> str:
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
    return (
        INTRO
        + "".join(f"| {i} | `{n}` | {sev} | {cell(t)} | {cell(a)} |\n" for i, n, sev, t, a in sorted(rows))
        + TYPES_INTRO
        + "".join(f"| `{t}` | {cell(how)} |\n" for t, how in types.items())
        + CAUSES_INTRO
        + "".join(f"| {i} | `{n}` | {cell(t)} |\n" for i, n, t in causes)
    )


def main() -> int:
    text = document()
    if "--check" in sys.argv[1:]:
        if not DOC.exists() or DOC.read_text() != text:
            print(f"{DOC.relative_to(ROOT)} is not what {HEADER.relative_to(ROOT)} says: run `make dict`")
            return 1
        return 0
    DOC.write_text(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
