"""What the mutants of flight (mutation.py) and of the ground tool (mutation_ground.py) share: a change of a
source, the reviewed list of those that no test has to notice, and the count."""

import csv
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
REVIEWED = Path(__file__).with_name("mutation.csv")


@dataclass(frozen=True)
class Mutant:
    """Characters `start` to `end` of a file become `text`."""

    path: str
    start: int
    end: int
    text: str

    def of(self, source: str) -> str:
        return source[: self.start] + self.text + source[self.end :]

    def line(self, source: str) -> int:
        return source.count("\n", 0, self.start) + 1

    def lines(self, source: str) -> tuple[str, str]:
        """The lines it is in, before and after."""
        first = source.rfind("\n", 0, self.start) + 1
        last = source.find("\n", self.end)
        after = source[first : self.start] + self.text + source[self.end : last]
        return source[first:last].strip(), after.strip()


def reviewed() -> dict[tuple[str, ...], dict[str, str]]:
    """Rows of tests/mutation.csv by file, function, and line before and after."""
    if not REVIEWED.exists():
        return {}
    with REVIEWED.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {(row["file"], row["function"], row["original"], row["mutant"]): row for row in rows}


class Count:
    """What became of mutants: "killed"; alive with a reason: "equivalent", "accepted"; without: "new"."""

    def __init__(self) -> None:
        self.known = reviewed()
        self.found: Counter[str] = Counter()

    def verdict(self, mutant: Mutant, function: str, source: str) -> str:
        """What the reviewed list says of a mutant; "" if it is not there."""
        row = self.known.get((mutant.path, function, *mutant.lines(source)))
        return row["verdict"] if row else ""

    def add(self, mutant: Mutant, function: str, source: str, killed: bool) -> None:
        """Count a mutant, and print it if it is alive."""
        if killed:
            self.found["killed"] += 1
            return
        before, after = mutant.lines(source)
        verdict = self.verdict(mutant, function, source)
        self.found[verdict or "new"] += 1
        print(f"  {verdict or 'NOT KILLED'}: {mutant.path}:{mutant.line(source)}, {function}")
        print(f"    - {before}\n    + {after}", flush=True)

    @property
    def killed(self) -> int:
        return self.found["killed"]

    @property
    def new(self) -> int:
        return self.found["new"]

    @property
    def excused(self) -> int:
        return self.found["equivalent"] + self.found["accepted"]

    @property
    def total(self) -> int:
        return self.found.total()

    @property
    def share(self) -> float:
        """Killed of those that are not equivalent."""
        return self.killed / max(1, self.total - self.found["equivalent"])

    @property
    def text(self) -> str:
        return (
            f"{self.killed} of {self.total} killed, {self.found['equivalent']} equivalent: "
            f"{100.0 * self.share:.1f} %; {self.new} without a reason"
        )
