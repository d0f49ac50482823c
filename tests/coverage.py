"""Every function of flight is called, every condition is both true and false, and each decides (MC/DC).

    coverage.py EXPORT EXCEPTIONS [ROOT]

EXPORT: what `llvm-cov export` says of the unit tests. A condition decides if it alone changed the outcome of
its decision. A statement that never ran in a function that is called stands behind such a condition. clang
leaves out a decision with another one inside an operand, as in `a && !(b && c)`: never measured. EXCEPTIONS:
a table (file, function, condition, never, reason); each row excuses one finding, and one that excuses none is
wrong too. Prints a line for each finding and exits with 1 if there is any."""

import csv
import json
import re
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

COLUMNS = ["file", "function", "condition", "never", "reason"]
# Rooms of flight: the core, and the process around it, whose unit tests let system calls fail.
CMAKE = Path(__file__).resolve().parents[1] / "fsw/CMakeLists.txt"
ROOMS = tuple(re.findall(r"^ *kc_room\((\w+)", CMAKE.read_text(), re.M))
EXPANSION, MCDC_BRANCH = 1, 6  # kinds of LLVM's regions; a condition of several


class Finding(NamedTuple):
    file: str
    function: str
    condition: str  # as the source has it, in one line; empty: the whole function
    never: str  # called, true, false, decides, measured


class Condition(NamedTuple):
    """Where it stands, expansion: 0 in the function itself, otherwise the number of the macro's expansion."""

    file: str
    function: str
    expansion: int
    begin: tuple[int, int]
    end: tuple[int, int]


class Measured:
    """Outcomes of all copies of flight's functions (one of a header is in several objects)."""

    def __init__(self, export: Path, root: Path) -> None:
        self.root = root
        self.calls: Counter[tuple[str, str]] = Counter()
        self.seen: dict[Condition, set[str]] = defaultdict(set)
        self.several: set[Condition] = set()  # conditions of decisions with several
        for record in json.loads(export.read_text())["data"][0]["functions"]:
            if self.file(record["filenames"][0]):
                self.add(record)

    def file(self, name: str) -> str:
        """Relative to the root if it is of flight; empty otherwise."""
        path = Path(name)
        inside = any(path.is_relative_to(self.root / "fsw" / room) for room in ROOMS)
        return str(path.relative_to(self.root)) if inside else ""

    def add(self, record: dict) -> None:
        # LLVM names a static function "file.c:name".
        function = record["name"].rpartition(":")[2]
        self.calls[self.file(record["filenames"][0]), function] += record["count"]
        # Where each expansion of a macro stands: in which other, at which place.
        sites = {r[6]: (r[5], (r[0], r[1])) for r in record["regions"] if r[7] == EXPANSION}
        several: dict[int, list[tuple[tuple[int, int], tuple[int, int], Condition]]] = defaultdict(list)
        for l0, c0, l1, c1, n_true, n_false, expansion, _, kind in record["branches"]:
            name = self.file(record["filenames"][expansion])
            if not name:
                continue
            condition = Condition(name, function, expansion, (l0, c0), (l1, c1))
            self.seen[condition] |= {"true"} if n_true else set()
            self.seen[condition] |= {"false"} if n_false else set()
            if kind != MCDC_BRANCH:
                continue
            self.several.add(condition)
            # A condition of a decision in a macro may be in a macro that it uses: there its place counts.
            at, begin, end = expansion, condition.begin, condition.end
            several[at].append((begin, end, condition))
            while at in sites:
                at, begin = sites[at]
                several[at].append((begin, begin, condition))

        used: set[Condition] = set()
        for l0, c0, l1, c1, _, _, decides in record["mcdc_records"]:
            # A decision does not say of which expansion it is: the first with its conditions, not yet used.
            for conditions in several.values():
                inside = [c for begin, end, c in sorted(conditions) if (l0, c0) <= begin and end <= (l1, c1)]
                if len(inside) == len(decides) and not used.intersection(inside):
                    break
            else:
                raise ValueError(f"{function}: no conditions of the decision in line {l0}")
            used.update(inside)
            for condition, alone in zip(inside, decides, strict=True):
                self.seen[condition] |= {"decides"} if alone else set()

    def text(self, condition: Condition) -> str:
        lines = (self.root / condition.file).read_text().splitlines()
        (l0, c0), (l1, c1) = condition.begin, condition.end
        part = lines[l0 - 1 : l1]
        part[-1] = part[-1][: c1 - 1]
        part[0] = part[0][c0 - 1 :]
        return " ".join(" ".join(part).split())

    def operand(self, condition: Condition) -> bool:
        """Whether && or || stands beside it."""
        lines = (self.root / condition.file).read_text().splitlines()
        (l0, c0), (l1, c1) = condition.begin, condition.end
        before = " ".join([*lines[: l0 - 1], lines[l0 - 1][: c0 - 1]]).rstrip(" (!\\")
        after = " ".join([lines[l1 - 1][c1 - 1 :], *lines[l1 : l1 + 3]]).lstrip(" )\\")
        return before.endswith(("&&", "||")) or after.startswith(("&&", "||"))

    def findings(self) -> Iterator[tuple[Finding, int]]:
        """Each with its line."""
        for (file, function), calls in self.calls.items():
            if not calls:
                yield Finding(file, function, "", "called"), 0
        for condition, seen in sorted(self.seen.items()):
            if not self.calls[condition.file, condition.function] and not seen:
                continue
            several = condition in self.several
            wanted = ["measured"] * (not several and self.operand(condition))
            wanted += ["true", "false"] + ["decides"] * several
            missing = [one for one in wanted if one not in seen]
            if missing:
                # One that is never false cannot decide: one finding.
                finding = Finding(condition.file, condition.function, self.text(condition), missing[0])
                yield finding, condition.begin[0]


def excused(path: Path) -> Iterator[Finding]:
    with path.open(newline="") as file:
        reader = csv.DictReader(file)
        if reader.fieldnames != COLUMNS:
            raise ValueError(f"{path}: the columns have to be {', '.join(COLUMNS)}")
        for row in reader:
            if not row["reason"].strip():
                raise ValueError(f"{path}: no reason for {row['condition']}")
            yield Finding(*(row[name] for name in COLUMNS[:4]))


def main() -> int:
    export, exceptions = map(Path, sys.argv[1:3])
    root = Path(sys.argv[3]).resolve() if len(sys.argv) > 3 else Path(__file__).resolve().parents[1]
    measured = Measured(export, root)
    left = Counter(excused(exceptions))
    n_excused = left.total()
    wrong = 0
    for finding, line in measured.findings():
        if left[finding]:
            left[finding] -= 1
            continue
        wrong += 1
        print(f"{finding.file}:{line}: {finding.function}: never {finding.never}: {finding.condition}")
    for finding in left.elements():
        wrong += 1
        print(f"{exceptions}: needed no more: {', '.join(finding)}")
    sizes = len(measured.calls), len(measured.seen), len(measured.several)
    print("  {} functions, {} conditions, {} of them in decisions with several (MC/DC):".format(*sizes))
    print(f"  {wrong} findings, {n_excused} excused")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
