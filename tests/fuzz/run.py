"""Run the fuzz harnesses, each from its seeds and what earlier runs have found.

    run.py PROGRAMS CORPORA [--seconds 4 | --runs N] [NAME ...]
    run.py PROGRAMS CORPORA --pack                              write the seeds anew from the corpora
    run.py PROGRAMS CORPORA --coverage SOURCES                  lines and branches that the corpora reach

PROGRAMS: folder of fuzz_NAME as the preset `fuzz` builds them (for --coverage: `fuzz-cov`). Seeds are
tests/fuzz/seeds/NAME.txt, an input a line in hexadecimal. An input that breaks something is kept as
CORPORA/found-NAME-... and makes the exit status 1; `fuzz_NAME FILE` repeats it."""

import argparse
import hashlib
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

SEEDS = Path(__file__).parent / "seeds"
# harness -> largest input [bytes]
LENGTH = {"tables": 256, "messages": 512, "store": 256, "app": 256, "decoders": 512, "detector": 1024}
# Megabytes that one allocation may have, far beyond what any needs: a size that a message states is believed.
ALLOCATION_MB = 64
# Seconds for one input, far beyond what any needs: a loop that does not end.
HANG_S = 20
# The core has no heap; LCM keeps what it allocates until the end.
SANITIZERS = {
    "ASAN_OPTIONS": "detect_leaks=0:detect_stack_use_after_return=0:quarantine_size_mb=16",
    "UBSAN_OPTIONS": "print_stacktrace=1",
}


def name_of(data: bytes) -> str:
    return hashlib.sha1(data).hexdigest()


def unpack(name: str, corpus: Path) -> None:
    corpus.mkdir(parents=True, exist_ok=True)
    for line in (SEEDS / f"{name}.txt").read_text().split():
        data = bytes.fromhex(line)
        (corpus / name_of(data)).write_bytes(data)


def call(programs: Path, name: str, *args: str) -> subprocess.CompletedProcess[str]:
    command = [str(programs / f"fuzz_{name}"), f"-max_len={LENGTH[name]}", *args]
    env = {**os.environ, **SANITIZERS}
    return subprocess.run(command, env=env, capture_output=True, text=True, errors="replace", check=False)


def fuzz(programs: Path, corpora: Path, name: str, seconds: int, runs: int) -> bool:
    """One harness; whether nothing broke."""
    corpus = corpora / name
    unpack(name, corpus)
    until = f"-runs={runs}" if runs else f"-max_total_time={seconds}"
    how = (
        "-seed=1",
        "-len_control=10",
        f"-timeout={HANG_S}",
        f"-malloc_limit_mb={ALLOCATION_MB}",
        "-print_final_stats=1",
    )
    done = call(programs, name, until, *how, f"-artifact_prefix={corpora}/found-{name}-", str(corpus))
    executed = re.search(r"number_of_executed_units: (\d+)", done.stderr)
    speed = re.search(r"average_exec_per_sec: +(\d+)", done.stderr)
    edges = re.findall(r"cov: (\d+)", done.stderr)
    if done.returncode != 0:
        print("\n".join(done.stderr.splitlines()[-60:]))
    ok = done.returncode == 0 and executed is not None and int(executed[1]) > 0
    figures = f"{executed[1]} executions, {speed[1]} a second, " if executed and speed else ""
    print(f"{'ok  ' if ok else 'FAIL'}  {name:9s} {figures}{edges[-1] if edges else 0} edges", flush=True)
    return ok


def pack(programs: Path, corpora: Path, name: str) -> None:
    """A small set of inputs that reaches the same."""
    with tempfile.TemporaryDirectory() as folder:
        done = call(programs, name, "-merge=1", "-use_counters=0", folder, str(corpora / name))
        if done.returncode != 0:
            sys.exit(done.stderr[-2000:])
        inputs = sorted((path.read_bytes() for path in Path(folder).iterdir()), key=lambda x: (len(x), x))
    SEEDS.mkdir(exist_ok=True)
    (SEEDS / f"{name}.txt").write_text("".join(f"{data.hex()}\n" for data in inputs if data))
    print(f"{name}: {len(inputs)} seeds")


def coverage(programs: Path, corpora: Path, names: list[str], sources: list[str]) -> None:
    tools = Path("/usr/lib/llvm-19/bin")
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            unpack(name, corpora / name)
            os.environ["LLVM_PROFILE_FILE"] = f"{folder}/{name}.raw"
            done = call(programs, name, "-runs=0", str(corpora / name))
            if done.returncode != 0:
                sys.exit(done.stderr[-2000:])
        raw = [f"{folder}/{name}.raw" for name in names]
        subprocess.run([tools / "llvm-profdata", "merge", "-o", f"{folder}/all", *raw], check=True)
        first, *others = (str(programs / f"fuzz_{name}") for name in names)
        objects = [word for other in others for word in ("-object", other)]
        command = [tools / "llvm-cov", "report", first, *objects, f"-instr-profile={folder}/all", *sources]
        subprocess.run(command, check=True)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("programs", type=Path)
    parser.add_argument("corpora", type=Path)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(LENGTH)} (default: all)")
    parser.add_argument("--seconds", type=int, default=4, help="of each harness")
    parser.add_argument("--runs", type=int, default=0, help="executions of each harness instead")
    parser.add_argument("--pack", action="store_true")
    parser.add_argument("--coverage", nargs="+", metavar="SOURCES")
    args = parser.parse_args()
    names = args.names or list(LENGTH)
    if args.coverage:
        coverage(args.programs, args.corpora, names, args.coverage)
        return 0
    if args.pack:
        for name in names:
            pack(args.programs, args.corpora, name)
        return 0
    results = [fuzz(args.programs, args.corpora, name, args.seconds, args.runs) for name in names]
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
