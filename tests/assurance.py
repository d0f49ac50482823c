"""Run every long check of the flight core and write what they found into docs/ASSURANCE.md.

    assurance.py [NAME ...]       all checks, or those that are named

Each check is a target of make; its output goes to build/assurance. The table keeps the rows of checks that
were not run, with the commit that they were measured at. Exit status 1 if a check failed.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "ASSURANCE.md"
LOGS = ROOT / "build" / "assurance"
BEGIN, END = "<!-- made: figures -->\n", "<!-- end of figures -->\n"
HEAD = "| check | question | found | minutes | commit |\n|---|---|---|---|---|\n"


@dataclass(frozen=True)
class Check:
    """name: target of make, with arguments; figures: pattern of the output lines that say what was found."""

    name: str
    question: str
    figures: str
    arguments: tuple[str, ...] = ()


CHECKS = (
    Check("cov", "is every condition of the core decided by a unit test?", r"\d+ (functions|findings), .*"),
    Check("wcet", "how long is the longest step?", r"worst step: .*"),
    Check(
        "wcet-search",
        "which tables take the most in a step?",
        r"\d[\d,]* sets of tables tried.*|worst step: .*",
        ("MINUTES=30",),
    ),
    Check("cross", "are the bits the same everywhere?", r"\d+% tests passed.*|replay of .* same to the byte"),
    Check("fuzz", "does any input break it?", r"(ok|FAIL) .*executions.*", ("SECONDS=300",)),
    Check("mutation", "do the tests notice a changed token?", r"\d+ of \d+ killed, .*"),
    Check("mutation-ground", "and in the ground's safety code?", r"\w+: \d+ of \d+ killed, .*"),
    Check(
        "campaign-faults",
        "does a fault make a wrong correction active?",
        r"\d+ runs, .*",
        ("SEEDS=125", "WRITE=1"),
    ),
    Check("sigma", "is the stated sigma what the error is?", r"normalised error squared .*"),
    Check("lint", "what do compilers and static analysis find?", r"(?!)"),
)


def rows(text: str) -> dict[str, str]:
    """The table's rows by check."""
    table = text[text.index(BEGIN) + len(BEGIN) : text.index(END)]
    return {found[1]: line for line in table.splitlines() if (found := re.match(r"\| `make ([\w-]+)", line))}


def run(check: Check, measured: str) -> tuple[bool, str]:
    """Whether it passed, and its row. measured: the commit."""
    log, begun_s = LOGS / f"{check.name}.txt", time.monotonic()
    command = ["make", "--no-print-directory", check.name, *check.arguments]
    with log.open("w") as out:
        passed = subprocess.run(command, cwd=ROOT, stdout=out, stderr=subprocess.STDOUT).returncode == 0
    lines = (re.sub(r"^\[\d+/\d+\] ", "", x.strip()) for x in log.read_text(errors="replace").splitlines())
    figures = Counter(re.sub(r"\s+", " ", x).rstrip(":") for x in lines if re.fullmatch(check.figures, x))
    found = "; ".join(f"{n} times {x}" if n > 1 else x for x, n in figures.items())
    found = found or ("nothing" if passed else "")
    cells = (
        f"`{' '.join(['make', check.name, *check.arguments])}`",
        check.question,
        found if passed else f"**FAILED** {found}",
        f"{(time.monotonic() - begun_s) / 60:.0f}",
        measured,
    )
    return passed, f"| {' | '.join(cells)} |"


def commit() -> str:
    """What was measured."""
    return subprocess.run(
        ["git", "describe", "--always", "--dirty"], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout.strip()


def write(found: dict[str, str]) -> None:
    """Put rows into the page, in the order of CHECKS."""
    text = PAGE.read_text()
    known = rows(text) | found
    table = HEAD + "".join(f"{known[check.name]}\n" for check in CHECKS if check.name in known)
    before, after = text[: text.index(BEGIN) + len(BEGIN)], text[text.index(END) :]
    PAGE.write_text(f"{before}\n{table}\n{after}")


def main(names: Iterable[str]) -> int:
    """Run the checks; exit status as above."""
    LOGS.mkdir(parents=True, exist_ok=True)
    failed, measured = 0, commit()
    for check in CHECKS:
        if names and check.name not in names:
            continue
        passed, row = run(check, measured)
        failed += not passed
        write({check.name: row})
        print(row, flush=True)
    return int(failed > 0)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("names", nargs="*", choices=[[], *(check.name for check in CHECKS)], metavar="NAME")
    sys.exit(main(parser.parse_args().names))
