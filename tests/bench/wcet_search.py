"""Which tables take the most instructions in a step? A search over what flight accepts.

    python tests/bench/wcet_search.py [--minutes 10] [--seed 1]

A set of tables is a list of seeds: of changes, one after the other, of the largest tables
(tests/bench/wcet_search.c). The search changes the sets that are worst in a state: one change more, one less,
or the changes of two of them. While it searches, the instructions of a step are estimated from the basic
blocks that it enters (build `count`), so that a set takes a quarter of a second; then valgrind counts the
worst in the program that flies.

Every set that was tried is a line of build/wcet-search/tried.jsonl, and a second start goes on from there.
Prints a table by state; exits with 1 if a step takes more than the limit."""

from __future__ import annotations

import argparse
import json
import random
import re
import subprocess
import sys
import time
from collections import defaultdict
from pathlib import Path

from wcet import LIMIT, ROOT, counted, state_names

ESTIMATING = ROOT / "build/count/wcet-search"
FLYING = ROOT / "build/rel/wcet-search"
WORK = ROOT / "build/wcet-search"
TRIED = WORK / "tried.jsonl"
BATCH = 20  # sets a process
KEPT = 6  # sets that are changed further, of each state
CONFIRMED = 4  # sets that valgrind counts
CHANGES_MAX = 60
CALL = re.compile(r"\bcall\s+\w+ <__sanitizer_cov_trace_pc>")
# What gcc keeps on the stack only because of the calls.
KEEPS = re.compile(r"\bmov[a-z]*\s+(%xmm\d+,(0x\w+)?\(%rsp\)|(0x\w+)?\(%rsp\),%xmm\d+)$")

Set = tuple[int, ...]
Worst = dict[int, int]  # by state after the step: instructions


def write_weights(path: Path) -> None:
    """Of each place after a call at the head of a basic block: the instructions up to the next one."""
    listing = subprocess.check_output(["objdump", "-d", "--no-show-raw-insn", ESTIMATING], text=True)
    weights = bytearray()
    block: int | None = None
    after_call = False
    for line in listing.splitlines():
        found = re.match(r"\s*([0-9a-f]+):\t(.*?)\s*(?:#.*)?$", line)
        if not found:
            block = None if line.endswith(">:") else block
            continue
        address, text = int(found[1], 16), found[2]
        if after_call:
            block = address
            weights.extend(bytes(block + 1 - len(weights)))
        after_call = CALL.search(text) is not None
        if block is not None and not after_call and not KEEPS.search(text) and weights[block] < 255:
            weights[block] += 1
    path.write_bytes(weights)


def estimated(sets: list[Set]) -> list[Worst]:
    text = "".join(" ".join(map(str, s)) + "\n" for s in sets)
    command = [str(ESTIMATING), str(WORK / "weights")]
    done = subprocess.run(command, input=text, stdout=subprocess.PIPE, text=True, check=True)
    worst: list[Worst] = [{} for _ in sets]
    for line in done.stdout.splitlines():
        number, state, cost = map(int, line.split())
        if state >= 0:
            worst[number][state] = max(worst[number].get(state, 0), cost)
    return worst


class Search:
    def __init__(self, seed: int) -> None:
        self.best: dict[int, list[tuple[int, Set]]] = defaultdict(list)  # by state, the worst first
        self.tried = self.accepted = 0
        if TRIED.exists():
            for line in TRIED.read_text().splitlines():
                row = json.loads(line)
                self.take(tuple(row["changes"]), {int(k): v for k, v in row["worst"].items()})
        self.random = random.Random(f"{seed} {self.tried}")

    def take(self, changes: Set, worst: Worst) -> None:
        self.tried += 1
        self.accepted += bool(worst)
        for state, cost in worst.items():
            kept = self.best[state]
            if all(cost != c for c, _ in kept):  # a change without an effect is no other set
                self.best[state] = sorted([*kept, (cost, changes)], reverse=True)[:KEPT]

    def child(self) -> Set:
        """Of a set that is among the worst of a state; in one of ten of the largest tables themselves."""
        if not self.best or self.random.random() < 0.1:
            parent: Set = ()
        else:
            parent = self.parent()
        kind = self.random.random()
        if kind < 0.15 and parent:
            out = self.random.randrange(len(parent))
            return parent[:out] + parent[out + 1 :]
        if kind < 0.3 and parent:
            other = self.parent()
            return (parent[: self.random.randint(0, len(parent))] + other)[-CHANGES_MAX:]
        more = tuple(self.random.getrandbits(32) for _ in range(self.random.choice((1, 1, 2, 4))))
        return (parent + more)[-CHANGES_MAX:]

    def parent(self) -> Set:
        return self.random.choice(self.best[self.random.choice(list(self.best))])[1]

    def round(self) -> None:
        sets = [self.child() for _ in range(BATCH)]
        with TRIED.open("a") as file:
            for changes, worst in zip(sets, estimated(sets), strict=True):
                file.write(json.dumps({"changes": changes, "worst": worst}) + "\n")
                self.take(changes, worst)


def confirmed(search: Search) -> Worst:
    """What valgrind counts, with the sets that are worst in a state by the estimate, in their order."""
    leading = sorted((kept[0] for kept in search.best.values()), reverse=True)
    sets = list(dict.fromkeys(s for _, s in leading))[:CONFIRMED]
    text = "".join(" ".join(map(str, s)) + "\n" for s in sets)
    worst: Worst = {}
    for (_number, state, _estimate), cost in counted(WORK / "valgrind", [str(FLYING)], text):
        worst[int(state)] = max(worst.get(int(state), 0), cost)
    return worst


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    WORK.mkdir(parents=True, exist_ok=True)
    write_weights(WORK / "weights")
    search = Search(args.seed)
    end = time.monotonic() + 60.0 * args.minutes
    while time.monotonic() < end:
        search.round()
    names = state_names()
    worst = confirmed(search)
    print("| state after the step | most by the estimate | most that valgrind counts |")
    print("|---|---|---|")
    for state, kept in sorted(search.best.items(), key=lambda item: item[1], reverse=True):
        print(f"| {names[state]} | {kept[0][0]:,} | {worst.get(state, 0):,} |")
    print(f"\n{search.tried:,} sets of tables tried, {search.accepted:,} accepted by flight")
    print(f"worst step: {max(worst.values()):,} of {LIMIT:,} instructions")
    return int(max(worst.values()) > LIMIT)


if __name__ == "__main__":
    sys.exit(main())
