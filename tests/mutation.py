"""Change flight's sources one token at a time and see whether the unit tests notice.

    mutation.py [FILE ...] [--number 10] [--seed 1] [--jobs 1] [--patience 20] [--at LINE]

FILE is a source of flight (default: the files that guard the arm, the tables and the store). Of each,
`number` mutants are drawn with a fixed seed: another comparison or arithmetical or logical operator, a
condition negated, a constant changed, a statement deleted, min for max. One that does not compile, or
compiles to the same code, is drawn anew. Each is compiled alone and put before the core in programs of the
unit tests: the tests of the file first, then those of its room and of the rooms above, the quickest first,
up to `patience` seconds each. A test that fails or does not end kills it.

One that is not killed has to stand in tests/mutation.csv with a reason, as `equivalent` (no input tells it
from the original) or as `accepted`. The exit status is 1 if one does not stand there, or if fewer than 95 %
of those that are not equivalent are killed. The sources in the tree are never touched; everything happens in
build/mutation."""

import argparse
import csv
import json
import os
import random
import re
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BUILT = ROOT / "build/rel"
WORK = ROOT / "build/mutation"
REVIEWED = Path(__file__).with_suffix(".csv")
LEAST_SHARE = 0.95
SAFETY = (
    "fsw/motion/kc_guard.c", "fsw/motion/kc_bounds.c", "fsw/motion/kc_path.c", "fsw/estimate/kc_monitor.c",
    "fsw/exec/kc_monitoring.c", "fsw/exec/kc_update.c", "fsw/exec/kc_change.c", "fsw/exec/kc_sequence.c",
    "fsw/exec/kc_cmd.c", "fsw/exec/kc_review.c", "fsw/exec/kc_propose.c", "fsw/decide/kc_verdict.c",
    "fsw/lcm/kc_files.c",
)  # fmt: skip
# Token -> what it becomes. Longer tokens are found first.
OTHER = {
    "<=": ["<", ">"], ">=": [">", "<"], "==": ["!="], "!=": ["=="], "&&": ["||"], "||": ["&&"],
    "+=": ["-="], "-=": ["+="], "|=": ["&="], "<<": [">>"], ">>": ["<<"], "++": ["--"], "--": ["++"],
    "<": ["<=", ">="], ">": [">=", "<="], "+": ["-"], "-": ["+"], "*": ["/"], "/": ["*"], "!": [""],
    "kc_min": ["kc_max"], "kc_max": ["kc_min"], "kc_fabs": [""], "true": ["false"], "false": ["true"],
}  # fmt: skip
TOKEN = re.compile(
    r"(?P<number>(?<![\w.])(?:0x[\da-fA-F]+|\d+(?:\.\d*)?(?:e[+-]?\d+)?)[uUlLfF]*)|(?P<word>[A-Za-z_]\w*)"
    r"|(?P<keep>->|\.\.\.|\*=|/=|&=|\^=|%=)|(?P<operator>[<>=!&|+\-]{2}|[<>+\-*/!])"
)
DECLARATION = re.compile(
    r"\s*(static |const |unsigned |struct )*(void|bool|int|char|float|double|size_t|\w+_t)\b[ *]+\w+"
)
STATEMENT = re.compile(r"\s+(?!return|break|continue|default|case|else|goto|if|for|while|do\b|\})[^{}]*;\s*$")


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
        """The line it is in, before and after."""
        first = source.rfind("\n", 0, self.start) + 1
        last = source.find("\n", self.end)
        after = source[first : self.start] + self.text + source[self.end : last]
        return source[first:last].strip(), after.strip()

    def function(self, source: str) -> str:
        found = re.findall(r"^[a-z][\w *]*?(\w+)\(", source[: self.start], re.M)
        return found[-1] if found else ""


def blanked(source: str) -> str:
    """Comments, strings, preprocessor lines and static assertions as spaces."""
    what = r"/\*.*?\*/|\"(?:\\.|[^\"\\\n])*\"|'(?:\\.|[^'\\\n])*'|^#(?:\\\n|[^\n])*|^_Static_assert[^;]*;"
    return re.sub(what, lambda m: re.sub(r"[^\n]", " ", m[0]), source, flags=re.S | re.M)


def other_number(text: str) -> str:
    if re.search(r"[.e]", text) and not text.startswith("0x"):
        return "1.0" if float(text.rstrip("fF")) == 0.0 else f"({text} * 1.5)"
    return f"({text} + 1)" if re.fullmatch(r"(0x)?0+[uUlL]*", text) else f"({text} - 1)"


def in_line(text: str, at: int) -> Iterator[tuple[int, int, str]]:
    """Changes of the code in one line that begins at `at`."""
    declares = DECLARATION.match(text)
    for m in TOKEN.finditer(text):
        word = m[0]
        if declares and "=" not in text[: m.start()] and not text.rstrip().endswith("{"):
            continue  # sizes and pointers of a declaration, parameters
        if m["number"]:
            yield at + m.start(), at + m.end(), other_number(word)
        elif m["operator"] in ("*", "-", "+", "!") and unary(text, m.start()):
            if word in "!-":
                yield at + m.start(), at + m.end(), ""
        else:
            yield from ((at + m.start(), at + m.end(), x) for x in OTHER.get(word, []) if word != "!")
    if (m := re.search(r"\bif \(", text)) and not declares:
        yield at + m.end() - 1, at + m.end(), "(!"
    if STATEMENT.fullmatch(text) and not declares and text.count("(") == text.count(")"):
        yield at + len(text) - len(text.lstrip()), at + len(text.rstrip()), ";"


def unary(text: str, at: int) -> bool:
    before = text[:at].rstrip()
    return not before or before[-1] in "(=,<>&|!+-*/?:{[;" or before.endswith(("return", "sizeof"))


def changes(path: str, source: str) -> list[Mutant]:
    """Every mutant of a file, `if (!` with its closing bracket."""
    code, at = blanked(source), 0
    found = []
    for text in code.split("\n"):
        for start, end, new in in_line(text, at):
            if new == "(!":
                close = closing(code, start)
                found.append(Mutant(path, start, close + 1, f"(!{source[start : close + 1]})"))
            else:
                found.append(Mutant(path, start, end, new))
        at += len(text) + 1
    return found


def closing(code: str, at: int) -> int:
    depth = 0
    for i in range(at, len(code)):
        depth += (code[i] == "(") - (code[i] == ")")
        if depth == 0:
            return i
    raise ValueError("a bracket is not closed")


# --------------------------------------------------------------------------- programs


def room(path: str) -> str:
    return Path(path).parent.name


class Programs:
    """Unit tests linked with the core as a library, before which another one may stand."""

    def __init__(self, patience_s: float) -> None:
        self.patience_s = patience_s
        text = subprocess.check_output(["ninja", "-C", BUILT, "-t", "compdb"], text=True)
        self.compile = {}
        objects = []
        for entry in json.loads(text):
            output = BUILT / entry["output"]
            if not entry["output"].endswith(".o") or not output.exists() or "ground" in entry["output"]:
                continue
            path = os.path.relpath(Path(entry["directory"], entry["file"]).resolve(), ROOT)
            if re.search(r"CMakeFiles/kc_\w+\.dir", entry["output"]):
                self.compile[path] = entry["command"]
                objects.append(str(output))
        WORK.mkdir(parents=True, exist_ok=True)
        # Programs that run already keep their library.
        (WORK / "libcore.so").unlink(missing_ok=True)
        more = [str(BUILT / "libkcm.a"), "-llcm"]
        run("g++", "-shared", "-o", WORK / "libcore.so", *objects, *more)
        (WORK / "none").mkdir(exist_ok=True)
        run("gcc", "-shared", "-o", WORK / "none/libmutant.so", "-x", "c", "/dev/null")
        self.times = WORK / "seconds.json"
        self.seconds = json.loads(self.times.read_text()) if self.times.exists() else {}
        self.rooms = re.findall(r"^ *kc_room\((\w+)", (ROOT / "fsw/CMakeLists.txt").read_text(), re.M)
        for folder in sorted((BUILT / "tests/unit/CMakeFiles").glob("test_*.dir")):
            self.link(folder)
        self.times.write_text(json.dumps(self.seconds))

    def link(self, folder: Path) -> None:
        program = WORK / folder.stem
        objects = list(folder.rglob("*.o"))
        newest = max((o.stat().st_mtime for o in objects), default=0.0)
        known = program.exists() and folder.stem in self.seconds and newest < program.stat().st_mtime
        if not objects or known:
            return
        libraries = [BUILT / "libgiven.a", BUILT / "libunity.a"]
        mutant_first = [
            "-L" + str(WORK / "none"),
            "-Wl,--no-as-needed",
            "-lmutant",
            "-L" + str(WORK),
            "-lcore",
        ]
        more = ["-Wl,--as-needed", BUILT / "libkcm.a", "-llcm", "-lm"]
        run("gcc", "-o", program, *objects, *libraries, *mutant_first, *more)
        if self.seconds.get(folder.stem, 0.0) > self.patience_s:
            return  # known to be too slow for other files than its own
        began = time.monotonic()
        if not self.passes(folder.stem, WORK / "none", 600.0):
            sys.exit(f"{folder.stem} fails without any mutant")
        self.seconds[folder.stem] = time.monotonic() - began

    def passes(self, test: str, mutant: Path, limit_s: float) -> bool:
        env = {**os.environ, "LD_LIBRARY_PATH": f"{mutant}:{WORK}"}
        command = ["stdbuf", "-oL", "timeout", "-k", "1", f"{limit_s:.0f}", WORK / test]
        with subprocess.Popen(
            command, env=env, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, cwd=WORK
        ) as process:
            for line in process.stdout:
                if b":FAIL" in line:
                    process.terminate()
                    return False
            return process.wait() == 0

    def tests_of(self, path: str) -> list[str]:
        """Tests of the file, then those of its room and above, quickest first."""
        own = f"test_{Path(path).stem}"
        least = self.rooms.index(room(path))
        where = {
            f"test_{Path(p).stem}": self.rooms.index(room(p)) for p in self.compile if room(p) in self.rooms
        }
        above = [t for t in self.seconds if t != own and where.get(t, len(self.rooms)) >= least]
        above = [t for t in above if self.seconds[t] <= self.patience_s]
        return [own] * (own in self.seconds) + sorted(above, key=self.seconds.__getitem__)

    def compiled(self, path: str, source: str, folder: Path) -> bytes | None:
        """Object of another text of a source, without lines; None if it does not compile."""
        folder.mkdir(parents=True, exist_ok=True)
        text = folder / Path(path).name
        text.write_text(source)
        words = shlex.split(self.compile[path])
        out = words.index("-o")
        words[out + 1] = str(folder / "mutant.o")
        words[words.index("-c") + 1] = str(text)
        words = [
            w for w in words if w not in ("-g", "-Werror", "-MD", "-fcallgraph-info=su") and w != "ccache"
        ]
        for flag in ("-MT", "-MF"):
            if flag in words:
                del words[words.index(flag) : words.index(flag) + 2]
        words += ["-w", "-g0", f"-ffile-prefix-map={folder}=.", f"-I{(ROOT / path).parent}"]
        done = subprocess.run(words, cwd=BUILT, capture_output=True, check=False)
        return (folder / "mutant.o").read_bytes() if done.returncode == 0 else None


def run(*words: object) -> None:
    done = subprocess.run([str(w) for w in words], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"{' '.join(map(str, words))}\n{done.stderr}")


# --------------------------------------------------------------------------- trial


def killer(programs: Programs, mutant: Mutant, folder: Path) -> str | None:
    """The test that kills the mutant that is compiled in folder; None if it survives."""
    run("gcc", "-shared", "-o", folder / "libmutant.so", folder / "mutant.o")
    for test in programs.tests_of(mutant.path):
        if not programs.passes(test, folder, 10.0 + 5.0 * programs.seconds[test]):
            return test
    return None


def drawn(programs: Programs, path: str, source: str, number: int, seed: int, at: int) -> Iterator[Mutant]:
    """Mutants that compile to something else; each is left compiled in its folder."""
    pool = [m for m in changes(path, source) if at in (0, m.line(source))]
    random.Random(f"{seed} {path}").shuffle(pool)
    plain = programs.compiled(path, source, WORK / "plain")
    n = 0
    for mutant in pool:
        if n == number:
            return
        code = programs.compiled(path, mutant.of(source), WORK / f"{Path(path).stem}-{n}")
        if code is not None and code != plain:
            n += 1
            yield mutant


def reviewed() -> dict[tuple[str, ...], dict[str, str]]:
    if not REVIEWED.exists():
        return {}
    with REVIEWED.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {(row["file"], row["function"], row["original"], row["mutant"]): row for row in rows}


def try_file(programs: Programs, path: str, args: argparse.Namespace) -> list[tuple[Mutant, str | None]]:
    source = (ROOT / path).read_text()
    mutants = list(drawn(programs, path, source, args.number, args.seed, args.at))
    folders = [WORK / f"{Path(path).stem}-{n}" for n in range(len(mutants))]
    with ThreadPoolExecutor(args.jobs) as pool:
        killers = list(pool.map(lambda m, f: killer(programs, m, f), mutants, folders))
    return list(zip(mutants, killers, strict=True))


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("files", nargs="*", default=SAFETY)
    parser.add_argument("--number", type=int, default=10, help="mutants of each file")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--patience", type=float, default=20.0, help="of the tests of other files [s]")
    parser.add_argument("--at", type=int, default=0, help="only mutants of this line")
    args = parser.parse_args()
    programs, known = Programs(args.patience), reviewed()
    total = killed = equivalent = new = 0
    for path in args.files:
        source = (ROOT / path).read_text()
        results = try_file(programs, path, args)
        dead = sum(k is not None for _, k in results)
        total, killed = total + len(results), killed + dead
        print(f"{path}: {dead} of {len(results)} killed", flush=True)
        for mutant, _ in (r for r in results if r[1] is None):
            before, after = mutant.lines(source)
            row = known.get((path, mutant.function(source), before, after))
            equivalent += row is not None and row["verdict"] == "equivalent"
            new += row is None
            verdict = row["verdict"] if row else "NOT KILLED"
            print(f"  {verdict}: line {mutant.line(source)}, {mutant.function(source)}")
            print(f"    - {before}\n    + {after}", flush=True)
    share = killed / max(1, total - equivalent)
    percent = f"{100.0 * share:.1f} %"
    print(f"{killed} of {total} killed, {equivalent} equivalent: {percent}; {new} without a reason")
    return 0 if share >= LEAST_SHARE and new == 0 else 1


if __name__ == "__main__":
    sys.exit(main())
