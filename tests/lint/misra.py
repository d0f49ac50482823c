"""MISRA C:2012 over the flight core, by cppcheck's addon: what deviates is in misra.csv, decided once for
each kind, and nothing else deviates.

misra.py [FOLDER]    check; cppcheck keeps its results in FOLDER

A finding of a rule without a row fails, so does one in a file that its row does not name, and a row (or a
file of it) without a finding: its reason has gone. The texts of the rules are not free; the table has their
numbers and says in our words what the code does.
"""

import csv
import os
import re
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TABLE = ROOT / "tests/lint/misra.csv"
ADDON = ROOT / "tests/lint/addon/misra.py"
BUILT = re.findall(r"^ *kc_room\((\w+)", (ROOT / "fsw/CMakeLists.txt").read_text(), re.M)
ROOMS = tuple(room for room in BUILT if room not in ("eigen", "lcm"))  # C++; the process
MADE = ("build/made/decide", "build/made/messages")  # headers that the build makes from fsw/msg
DECISIONS = ("accepted", "misreported")


def findings(build: Path | None) -> dict[str, dict[str, int]]:
    """Rule -> file -> number of findings."""
    folders = [f"fsw/{room}" for room in ROOMS]
    options = [
        "--quiet",
        f"--addon={ADDON}",
        f"--addon-python={sys.executable}",  # as it is: `python3` may be a script that looks for it, 90 times
        "--std=c11",
        "-UKC_GROUND",
        "-j2",
        "--suppress=missingIncludeSystem",
    ]
    options += ["--template={file}: {id}", *(f"-I{folder}" for folder in [*folders, "fsw/eigen", *MADE])]
    environment = dict(os.environ)
    if build:
        build.mkdir(parents=True, exist_ok=True)
        options.append(f"--cppcheck-build-dir={build}")
        # The addon's own folder is root's, perhaps.
        environment["PYTHONPYCACHEPREFIX"] = str(build.resolve() / "bytecode")
    done = subprocess.run(
        ["cppcheck", *options, *folders],
        cwd=ROOT, env=environment, capture_output=True, text=True, check=True,
    )  # fmt: skip
    found: dict[str, dict[str, int]] = defaultdict(lambda: defaultdict(int))
    for path, rule in re.findall(r"^(\S+): misra-c2012-([0-9.]+)$", done.stderr, re.M):
        found[rule][Path(path).name] += 1
    return found


def complaints(rows: list[dict[str, str]], found: dict[str, dict[str, int]]) -> list[str]:
    """What the table does not say, and what it says without need."""
    out = []
    rules = [row["rule"] for row in rows]
    out += [f"rule {r}: more than one row" for r in sorted(set(rules)) if rules.count(r) > 1]
    for rule in sorted(set(found) - set(rules)):
        out.append(f"rule {rule}: deviates without a row in {', '.join(sorted(found[rule]))}")
    for row in rows:
        rule, files = row["rule"], set(row["files"].split())
        if row["decision"] not in DECISIONS or not row["kind"] or not row["reason"]:
            out.append(f"rule {rule}: needs kind, decision ({' or '.join(DECISIONS)}) and reason")
        there = set(found.get(rule, ()))
        if not there:
            out.append(f"rule {rule}: nothing deviates any more: delete its row")
        elif files != {"*"}:
            out += [f"rule {rule}: deviates in {name} too" for name in sorted(there - files)]
            out += [f"rule {rule}: not in {name} any more" for name in sorted(files - there)]
    return out


def main() -> int:
    with TABLE.open(newline="") as table:
        rows = list(csv.DictReader(table))
    found = findings(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
    wrong = complaints(rows, found)
    for line in wrong:
        print(f"misra.csv: {line}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
