"""Instructions of every step of the flight core with everything at its limits, counted by valgrind.

    python tests/bench/wcet.py [CASE...]

tests/bench/wcet.c makes the steps. The counts are those of this processor's instructions and the same at
every run. Prints a table by state; exits with 1 if a step takes more than LIMIT."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROGRAM = ROOT / "build/rel/wcet"
WORK = ROOT / "build/wcet"
LIMIT = 10_000_000
CASES = ("idle", "replay", "random", "ucb", "dopt", "vopt", "rate")


def state_names() -> dict[int, str]:
    text = (ROOT / "fsw/state/kc_states.h").read_text()
    return {int(number): name for name, number in re.findall(r"KC_ST_(\w+) = (\d+)", text)}


def counted(folder: Path, command: list[str], text: str = "") -> list[tuple[list[str], int]]:
    """The lines that a program prints, one for each step, split; and the instructions of the step."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    done = subprocess.run(
        [
            *("valgrind", "-q", "--tool=callgrind", f"--callgrind-out-file={folder}/out"),
            *("--toggle-collect=kc_app_step", "--dump-after=kc_app_step", *command),
        ],
        check=True,
        input=text,
        stdout=subprocess.PIPE,
        text=True,
    )
    lines = done.stdout.splitlines()
    costs = []
    for number in range(1, len(lines) + 1):
        dump = folder / f"out.{number}"
        found = re.search(r"^(?:totals|summary): (\d+)", dump.read_text(), re.MULTILINE)
        costs.append(int(found[1]) if found else 0)
        dump.unlink()
    return [(line.split(), cost) for line, cost in zip(lines, costs, strict=True)]


def steps(case: str) -> list[tuple[str, int, int]]:
    """Part of the case, state in which the step ended, instructions."""
    lines = counted(WORK / case, [str(PROGRAM), case])
    return [(part, int(after), cost) for (part, _before, after), cost in lines]


def main(cases: tuple[str, ...]) -> int:
    names = state_names()
    worst = 0
    print("| case | state after the step | steps | most instructions | on average |")
    print("|---|---|---|---|---|")
    for case in cases:
        by_state = defaultdict(list)
        for part, state, cost in steps(case):
            by_state[part, state].append(cost)
        for (part, state), costs in by_state.items():
            worst = max(worst, *costs)
            mean = sum(costs) // len(costs)
            print(f"| {part} | {names[state]} | {len(costs)} | {max(costs):,} | {mean:,} |")
    print(f"\nworst step: {worst:,} of {LIMIT:,} instructions")
    return int(worst > LIMIT)


if __name__ == "__main__":
    sys.exit(main(tuple(sys.argv[1:]) or CASES))
