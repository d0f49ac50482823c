"""docs/EVENTS.md from the list in fsw/exec/kc_events.h.

events.py            write it
events.py --check    fail if it is not what the header says
"""

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
HEADER = ROOT / "fsw/exec/kc_events.h"
DOC = ROOT / "docs/EVENTS.md"

ENTRY = re.compile(r'X\(\s*(\d+)\s*,\s*(\w+)\s*,\s*(\w+)\s*,\s*((?:"(?:[^"\\]|\\.)*"\s*)+)\)')
INTRO = """# Events

Made by `make dict` from `KC_EVENT_LIST` in `fsw/exec/kc_events.h`; do not edit.

Every event carries its id, a severity, three numbers (`got`, `want`, `index`) and the mission time; the
text below says what the numbers mean. Ids never change their meaning.

| id | name | severity | text |
|---:|---|---|---|
"""


def document() -> str:
    source = re.sub(r"\\\n", " ", HEADER.read_text())
    rows = [
        (int(i), name, sev, "".join(re.findall(r'"((?:[^"\\]|\\.)*)"', text)))
        for i, name, sev, text in ENTRY.findall(source)
    ]
    if not rows:
        sys.exit(f"{HEADER}: no event found")
    for what, column in (("id", 0), ("name", 1)):
        values = [r[column] for r in rows]
        if twice := {v for v in values if values.count(v) > 1}:
            sys.exit(f"{HEADER}: {what} used twice: {twice}")
    return INTRO + "".join(
        f"| {i} | `{name}` | {sev.lower()} | {text.replace('|', chr(92) + '|')} |\n"
        for i, name, sev, text in sorted(rows)
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
