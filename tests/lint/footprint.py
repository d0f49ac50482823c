"""Static memory by module and worst-case stack of the flight code.

    footprint.py --max-static 1048576 --max-stack 32768 .../math/kc_rot.c.o ...

Static memory is what `size` says of the object files. Stack comes from the call graphs that gcc wrote
beside them (-fcallgraph-info=su): the deepest chain of frames, return addresses included. Fails when a
limit is passed, when a function calls itself in whatever roundabout way, when a frame has no fixed size,
or when a call goes through a pointer whose targets are not listed below.
"""

import argparse
import re
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

# Functions outside the tree (memcpy; for the process: LCM, libc) have no call graph. What one of them may
# take, on top of our own chain: glibc's string functions stay well below.
LIBRARY_BYTES = 1024

# Calls through a pointer, by calling function: which functions can be meant. Empty as long as the
# flight code has none.
INDIRECT: dict[str, tuple[str, ...]] = {}

NODE = re.compile(r'^node: \{ title: "([^"]+)" label: "([^"]*)"')
EDGE = re.compile(r'^edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"')
FRAME = re.compile(r"\\n(\d+) bytes \((static|dynamic|dynamic,bounded)\)")


def static_sizes(objects: list[Path]) -> dict[str, list[int]]:
    out = subprocess.run(["size", *map(str, objects)], capture_output=True, text=True, check=True).stdout
    sizes: dict[str, list[int]] = defaultdict(lambda: [0, 0, 0])
    for line in out.splitlines()[1:]:
        fields = line.split()
        row = sizes[Path(fields[5]).parent.name]
        for k in range(3):
            row[k] += int(fields[k])
    return sizes


class CallGraph:
    def __init__(self, objects: list[Path]) -> None:
        self.frame: dict[str, int] = {}
        self.calls: dict[str, set[str]] = defaultdict(set)
        self.faults: list[str] = []
        for obj in objects:
            for line in obj.with_suffix(".ci").read_text().splitlines():
                if node := NODE.match(line):
                    name, label = node[1], node[2]
                    if size := FRAME.search(label):
                        self.frame[name] = int(size[1])
                        if size[2] == "dynamic":
                            self.faults.append(f"{name}: frame without a fixed size")
                elif edge := EDGE.match(line):
                    self.calls[edge[1]].add(edge[2])
        for caller, targets in self.calls.items():
            if "__indirect_call" in targets:
                targets.remove("__indirect_call")
                short = caller.split(":")[-1]
                if short in INDIRECT:
                    targets.update(INDIRECT[short])
                else:
                    self.faults.append(
                        f"{caller}: calls through a pointer; list its targets in {Path(__file__).name}"
                    )

    def deepest(self) -> dict[str, tuple[int, list[str]]]:
        """Of every function: bytes of the deepest chain that starts there, and the chain."""
        done: dict[str, tuple[int, list[str]]] = {}
        open_: list[str] = []

        def visit(name: str) -> tuple[int, list[str]]:
            if name in done:
                return done[name]
            if name in open_:
                self.faults.append("recursion: " + " > ".join([*open_[open_.index(name) :], name]))
                return 0, []
            if name not in self.frame:
                return LIBRARY_BYTES, [f"{name} (library)"]
            open_.append(name)
            below = max((visit(t) for t in sorted(self.calls[name])), default=(0, []), key=lambda b: b[0])
            open_.pop()
            done[name] = (self.frame[name] + below[0], [name, *below[1]])
            return done[name]

        for name in sorted(self.frame):
            visit(name)
        return done


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--max-static", type=int, required=True, help="bytes of .data and .bss together")
    parser.add_argument("--max-stack", type=int, required=True, help="bytes")
    parser.add_argument("objects", type=Path, nargs="+")
    args = parser.parse_args()
    sys.setrecursionlimit(10_000)

    print(f"  {'module':10s} {'text':>9s} {'data':>9s} {'bss':>9s}")
    total = [0, 0, 0]
    for name, row in sorted(static_sizes(args.objects).items()):
        print(f"  {name:10s} {row[0]:9d} {row[1]:9d} {row[2]:9d}")
        total = [a + b for a, b in zip(total, row, strict=True)]
    static = total[1] + total[2]
    print(f"  {'all':10s} {total[0]:9d} {total[1]:9d} {total[2]:9d}")
    print(f"  static memory {static} of {args.max_static} bytes")

    graph = CallGraph(args.objects)
    chains = graph.deepest()
    worst = max(chains.values(), key=lambda c: c[0])
    print(f"  worst stack   {worst[0]} of {args.max_stack} bytes:")
    for name in worst[1]:
        print(f"    {graph.frame.get(name, LIBRARY_BYTES):7d}  {name}")

    faults = sorted(set(graph.faults))
    if static > args.max_static:
        faults.append(f"static memory is over by {static - args.max_static} bytes")
    if worst[0] > args.max_stack:
        faults.append(f"worst stack is over by {worst[0] - args.max_stack} bytes")
    for fault in faults:
        print(f"  FAIL {fault}")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
