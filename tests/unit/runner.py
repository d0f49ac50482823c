"""Unity's two chores: a main() for each test file, and running the lot.

runner.py main test_x.c            writes a main() that calls every `void test_...(void)` of the file
                                   (an empty file when it has a main() of its own)
runner.py run [--junit F] BIN...   runs the test programs, sums up, writes JUnit XML

Only the standard library: unit tests need no Python environment.
"""

import argparse
import re
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from pathlib import Path

TIMEOUT_S = 120
RESULT = re.compile(
    r"^(?P<file>[^:\n]+):(?P<line>\d+):(?P<name>\w+):(?P<what>PASS|FAIL|IGNORE)(?::\s?(?P<msg>.*))?$"
)
COLOUR = re.compile(r"\x1b\[\d*m")  # some versions of Unity always paint
TOTALS = re.compile(r"^(\d+) Tests (\d+) Failures (\d+) Ignored\s*$", re.M)


def make_main(source: Path) -> str:
    text = re.sub(r"/\*.*?\*/|//[^\n]*", "", source.read_text(), flags=re.S)
    names = re.findall(r"^void\s+(test_\w+)\s*\(\s*void\s*\)\s*\{", text, flags=re.M)
    if re.search(r"^int\s+main\s*\(", text, flags=re.M):
        missing = [n for n in names if not re.search(rf"RUN_TEST\(\s*{n}\s*\)", text)]
        if missing:
            sys.exit(f"{source}: never run: {', '.join(missing)}")
        return "typedef int kc_test_file_has_its_own_main;\n"
    if not names:
        sys.exit(f"{source}: no test in it")
    out = ['#include "unity.h"', ""]
    out += [f"void {n}(void);" for n in names]
    for hook in ("setUp", "tearDown"):
        if not re.search(rf"^void\s+{hook}\s*\(", text, flags=re.M):
            out.append(f"void {hook}(void) {{}}")
    out += ["", "int main(void)", "{", f'    UnityBegin("{source.name}");']
    lines = {n: text[: re.search(rf"^void\s+{n}\b", text, flags=re.M).start()].count("\n") + 1 for n in names}
    out += [f'    UnityDefaultTestRun({n}, "{n}", {lines[n]});' for n in names]
    out += ["    return UnityEnd();", "}", ""]
    return "\n".join(out)


def run_one(program: Path) -> tuple[ET.Element, int, int, int]:
    """One test program: its JUnit suite and how many passed, failed, were ignored."""
    start = time.monotonic()
    try:
        done = subprocess.run([program], capture_output=True, text=True, errors="replace", timeout=TIMEOUT_S)
        out, code = COLOUR.sub("", done.stdout + done.stderr), done.returncode
    except subprocess.TimeoutExpired as late:
        out, code = f"{late.stdout or ''}\nno end after {TIMEOUT_S} s", -1
    seconds = time.monotonic() - start

    suite = ET.Element("testsuite", name=program.name, time=f"{seconds:.3f}")
    counts = {"PASS": 0, "FAIL": 0, "IGNORE": 0}
    for hit in map(RESULT.match, out.splitlines()):
        if not hit:
            continue
        counts[hit["what"]] += 1
        case = ET.SubElement(suite, "testcase", classname=program.name, name=hit["name"])
        if hit["what"] == "FAIL":
            ET.SubElement(case, "failure", message=hit["msg"] or "").text = hit[0]
            print(f"  {hit[0]}")
        elif hit["what"] == "IGNORE":
            ET.SubElement(case, "skipped", message=hit["msg"] or "")
            print(f"  {hit[0]}")

    # A crash, a sanitizer report or totals that disagree is a failure of its own: no test line says so.
    totals = TOTALS.search(out)
    crashed = totals is None or (code != 0) != (counts["FAIL"] > 0) or int(totals[1]) != sum(counts.values())
    if crashed:
        counts["FAIL"] += 1
        case = ET.SubElement(suite, "testcase", classname=program.name, name="program_ends_well")
        tail = "\n".join(out.splitlines()[-40:])
        ET.SubElement(case, "failure", message=f"exit code {code}").text = tail
        print(f"  {program.name}: exit code {code}\n{tail}")
    suite.set("tests", str(sum(counts.values())))
    suite.set("failures", str(counts["FAIL"]))
    suite.set("skipped", str(counts["IGNORE"]))
    print(f"  {program.name:32s} {counts['PASS']:4d} passed {counts['FAIL']:3d} failed  {seconds:6.2f} s")
    return suite, counts["PASS"], counts["FAIL"], counts["IGNORE"]


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    sub = parser.add_subparsers(dest="what", required=True)
    gen = sub.add_parser("main")
    gen.add_argument("source", type=Path)
    run = sub.add_parser("run")
    run.add_argument("--junit", type=Path)
    run.add_argument("programs", type=Path, nargs="*")
    args = parser.parse_args()

    if args.what == "main":
        print(make_main(args.source), end="")
        return 0

    suites = ET.Element("testsuites")
    passed = failed = ignored = 0
    for program in args.programs:
        suite, p, f, i = run_one(program.resolve())
        suites.append(suite)
        passed, failed, ignored = passed + p, failed + f, ignored + i
    if args.junit:
        args.junit.parent.mkdir(parents=True, exist_ok=True)
        ET.ElementTree(suites).write(args.junit, encoding="unicode")
    print(f"  {len(args.programs)} unit test programs: {passed} passed, {failed} failed, {ignored} ignored")
    return 1 if failed or not passed else 0


if __name__ == "__main__":
    sys.exit(main())
