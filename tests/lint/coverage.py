"""Line and branch coverage of the flight core, by module, from gcov.

    coverage.py --lines 95 --branches 0 OBJECT...      (objects of the cov variant, after the tests ran)

A line or branch counts as covered when any test program took it; lines of an object that no test ran count as
missed. --missed lists the lines.
"""

import argparse
import json
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def gcov(obj: Path) -> dict:
    """What gcov knows of one object. Its notes file lies beside it, its counters too if it ever ran."""
    command = ["gcov", "--json-format", "--stdout", "--branch-probabilities", str(obj)]
    out = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT).stdout
    return json.loads(out) if out.strip() else {"files": []}


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--lines", type=float, default=0.0, help="least line coverage of all modules together [%%]"
    )
    parser.add_argument("--branches", type=float, default=0.0, help="least branch coverage [%%]")
    parser.add_argument("--missed", action="store_true", help="list missed lines")
    parser.add_argument("objects", type=Path, nargs="+")
    args = parser.parse_args()

    lines: dict[str, dict[int, int]] = defaultdict(lambda: defaultdict(int))
    branches: dict[str, dict[tuple[int, int], int]] = defaultdict(lambda: defaultdict(int))
    for obj in args.objects:
        for file in gcov(obj)["files"]:
            path = Path(file["file"])
            path = path if path.is_absolute() else ROOT / path
            if not path.is_relative_to(ROOT / "fsw"):
                continue
            name = path.relative_to(ROOT).as_posix()
            for line in file["lines"]:
                lines[name][line["line_number"]] += line["count"]
                for k, branch in enumerate(b for b in line["branches"] if not b["throw"]):
                    branches[name][line["line_number"], k] += branch["count"]

    modules: dict[str, list[int]] = defaultdict(lambda: [0, 0, 0, 0])
    for name in sorted(lines):
        row = [
            sum(map(bool, lines[name].values())),
            len(lines[name]),
            sum(map(bool, branches[name].values())),
            len(branches[name]),
        ]
        module = name.split("/")[1]
        modules[module] = [a + b for a, b in zip(modules[module], row, strict=True)]
        if args.missed and row[0] < row[1]:
            print(f"  {name}: {' '.join(str(n) for n, c in sorted(lines[name].items()) if not c)}")

    def percent(part: int, whole: int) -> float:
        return 100.0 * part / whole if whole else 100.0

    print(f"  {'module':10s} {'lines':>12s} {'':>7s} {'branches':>13s}")
    modules["all"] = [sum(column) for column in zip(*modules.values(), strict=True)] or [0, 0, 0, 0]
    for module, (l, nl, b, nb) in modules.items():
        print(
            f"  {module:10s} {l:5d} /{nl:5d} {percent(l, nl):6.1f} % {b:5d} /{nb:5d} {percent(b, nb):6.1f} %"
        )
    l, nl, b, nb = modules["all"]
    short = []
    if percent(l, nl) < args.lines:
        short.append(f"line coverage {percent(l, nl):.2f} %, wanted {args.lines} %")
    if percent(b, nb) < args.branches:
        short.append(f"branch coverage {percent(b, nb):.2f} %, wanted {args.branches} %")
    for text in short:
        print(f"  FAIL {text}")
    return 1 if short or not nl else 0


if __name__ == "__main__":
    sys.exit(main())
