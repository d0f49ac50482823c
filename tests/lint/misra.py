"""MISRA C:2012 over the flight core, by cppcheck's addon: what deviates is in misra.csv, decided once for
each kind, and nothing else deviates.

misra.py [FOLDER]    check; cppcheck keeps its results in FOLDER

A finding of a rule without a row fails, so does one in a file that its row does not name, and a row (or a
file of it) without a finding: its reason has gone. The texts of the rules are not free; the table has their
numbers and says in our words what the code does.
"""

import csv
import json
import os
import re
import subprocess
import sys
import tempfile
from collections import defaultdict
from itertools import takewhile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TABLE = ROOT / "tests/lint/misra.csv"
RUNNER = ROOT / "tests/lint/misra_addon.py"
LATER = ROOT / "tests/lint/later"
JOBS = 2
BUILT = re.findall(r"^ *kc_room\((\w+)", (ROOT / "fsw/CMakeLists.txt").read_text(), re.M)
ROOMS = tuple(room for room in BUILT if room not in ("eigen", "lcm"))  # C++; the process
MADE = ("build/made/decide", "build/made/messages")  # headers that the build makes from fsw/msg
DECISIONS = ("accepted", "misreported")


def findings(build: Path | None) -> dict[str, dict[str, int]]:
    """Rule -> file -> number of findings."""
    with tempfile.TemporaryDirectory() as fresh:
        folder = (build or Path(fresh)).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        addon = dump(folder)
        dumps = [folder / f"{name}.dump" for name in dumped(folder)]
        # Unchanged files have an unchanged dump.
        if set_down(folder / "owned.json", owned(dumps)):
            new = dumps
        else:
            new = [path for path in dumps if not found_after(path)]
        if new:
            checked(folder, addon, str(folder / "owned.json"), str(JOBS), *map(str, new))
        (folder / "files").write_text("".join(f"{path.with_suffix('.ctu-info')}\n" for path in dumps))
        checked(folder, addon, str(folder / "files"), str(folder / "across.found"))
        texts = [path.with_suffix(".found").read_text() for path in [*dumps, folder / "across"]]
    places = {
        (one["errorId"].removeprefix("c2012-"), one["file"], one["linenr"], one["column"])
        for text in texts
        for one in map(json.loads, text.splitlines())
    }
    found: dict[str, dict[str, int]] = defaultdict(lambda: defaultdict(int))
    for rule, path, _line, _column in places:
        found[rule][Path(path).name] += 1
    return found


def dump(folder: Path) -> str:
    """Dumps of the core's files in the folder; the addon that cppcheck would start for each."""
    folders = [f"fsw/{room}" for room in ROOMS]
    options = [
        "--quiet",
        "--addon=misra.py",
        f"--addon-python={LATER}",
        "--std=c11",
        "-UKC_GROUND",
        f"-j{JOBS}",
        "--suppress=missingIncludeSystem",
        f"--cppcheck-build-dir={folder}",
        *(f"-I{room}" for room in [*folders, "fsw/eigen", *MADE]),
    ]
    note = folder / "addon"
    subprocess.run(
        ["cppcheck", *options, *folders],
        cwd=ROOT, env={**os.environ, "KINCAL_ADDON": str(note)}, capture_output=True, check=True,
    )  # fmt: skip
    return note.read_text().strip()


def dumped(folder: Path) -> list[str]:
    """Of each source, in the order of their paths, what cppcheck calls it in the folder."""
    lines = [line.split(":") for line in (folder / "files.txt").read_text().splitlines()]
    return [line[0] for line in sorted(lines, key=lambda line: line[-1])]


def owned(dumps: list[Path]) -> dict[str, list[str]]:
    """Of each dump the files that it is the first to have: its source, and headers."""
    seen: set[str] = set()
    files: dict[str, list[str]] = {}
    for path in dumps:
        with path.open() as text:
            head = "".join(takewhile(lambda line: "<tok " not in line, text))
        files[str(path)] = [
            name for name in re.findall(r'<file index="\d+" name="(.*)"/>', head) if name not in seen
        ]
        seen.update(files[str(path)])
    return files


def set_down(path: Path, what: dict[str, list[str]]) -> bool:
    """Whether it is not what stands there already."""
    text = json.dumps(what)
    if path.exists() and path.read_text() == text:
        return False
    path.write_text(text)
    return True


def found_after(path: Path) -> bool:
    found = path.with_suffix(".found")
    return found.exists() and found.stat().st_mtime_ns >= path.stat().st_mtime_ns


def checked(folder: Path, *arguments: str) -> None:
    # The addon's own folder is root's, perhaps.
    environment = {**os.environ, "PYTHONPYCACHEPREFIX": str(folder / "bytecode")}
    subprocess.run([sys.executable, RUNNER, *arguments], env=environment, check=True)


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
