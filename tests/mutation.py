"""Change flight's sources one token at a time and see whether the unit tests notice.

    mutation.py [FILE or ROOM ...] [--number 10] [--seed 1] [--jobs 1] [--patience 20] [--at LINE]

FILE is a source of flight (default: the files that guard the arm, the tables and the store), ROOM a folder of
them (fsw/design). Of each, `number` mutants are drawn with a fixed seed: another comparison or arithmetic or
logical operator, a condition negated, a constant changed, a statement deleted, min for max. One that does not
compile (nor does a function without its return), or compiles to the same code, is drawn anew. Charges of
instructions (`uint64_t ..._cost`) are not drawn: whether they bound what is executed, `make wcet` measures.
Each mutant is compiled alone and put before the core in programs of the unit tests that need the file: the
tests of the file first, then those of its room, then the others, what has killed and the quickest first;
those of other rooms up to `patience` seconds (0: none). A test that fails or does not end kills it.

One that is not killed has to stand in tests/mutation.csv with a reason, as `equivalent` (no input tells it
from the original; no test is run) or as `accepted`. The exit status is 1 if one does not stand there, or if
fewer than 95 % of those that are not equivalent are killed. The sources in the tree are never touched;
everything happens in build/mutation."""

import argparse
import json
import os
import random
import re
import shlex
import signal
import subprocess
import sys
from collections import Counter, deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from threading import Lock, Timer

from mutants import ROOT, Count, Mutant

BUILT = ROOT / "build/rel"
WORK = ROOT / "build/mutation"
GIVEN = (BUILT / "libgiven_world.a", BUILT / "libgiven.a")
LEAST_SHARE = 0.95
SAFETY = (
    "fsw/motion/kc_guard.c", "fsw/motion/kc_bounds.c", "fsw/motion/kc_path.c", "fsw/estimate/kc_monitor.c",
    "fsw/calibrate/kc_monitoring.c", "fsw/calibrate/kc_update.c", "fsw/store/kc_change.c",
    "fsw/app/kc_sequence.c", "fsw/app/kc_dispatch.c", "fsw/command/kc_cmd.c", "fsw/store/kc_review.c",
    "fsw/calibrate/kc_propose.c", "fsw/decide/kc_verdict.c", "fsw/lcm/kc_files.c",
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


def function_of(mutant: Mutant, source: str) -> str:
    found = re.findall(r"^[a-z][\w *]*?(\w+)\(", source[: mutant.start], re.M)
    return found[-1] if found else ""


def charges(mutant: Mutant, source: str) -> bool:
    """Whether it is in a charge of instructions: kc_work.h."""
    found = re.findall(r"^[a-z][\w *]*?\w+\(", source[: mutant.start], re.M)
    name = r"uint64_t \w*cost\b"
    return bool(re.search(name, mutant.lines(source)[0]) or (found and re.search(name, found[-1])))


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


def own(path: str) -> tuple[str, str]:
    """Tests of a source: by value (tests/unit), and in the world (tests/system)."""
    stem = Path(path).stem
    return f"test_{stem}", f"test_{stem.removeprefix('kc_')}"


class Programs:
    """Unit tests linked with the core as a library, before which another one may stand."""

    def __init__(self, patience_s: float) -> None:
        self.patience_s = patience_s
        text = subprocess.check_output(["ninja", "-C", BUILT, "-t", "compdb"], text=True)
        self.compile = {}
        self.folders: dict[str, Path] = {}  # of each test's objects
        objects = []
        for entry in json.loads(text):
            output = BUILT / entry["output"]
            if not entry["output"].endswith(".o") or not output.exists() or "ground" in entry["output"]:
                continue
            if match := re.match(r"tests/\w+/CMakeFiles/(test_\w+)\.dir/", entry["output"]):
                self.folders[match[1]] = BUILT / match[0]
            path = os.path.relpath(Path(entry["directory"], entry["file"]).resolve(), ROOT)
            if re.search(r"CMakeFiles/kc_\w+\.dir", entry["output"]):
                self.compile[path] = entry["command"]
                objects.append(str(output))
        WORK.mkdir(parents=True, exist_ok=True)
        # Renamed into place: tests of another run may be about to load it.
        new = WORK / f"libcore-{os.getpid()}.so"
        more = ["-Wl,-soname,libcore.so", str(BUILT / "libkcm.a"), "-llcm"]
        run("g++", "-shared", "-o", new, *objects, *more)
        new.rename(WORK / "libcore.so")
        (WORK / "none").mkdir(exist_ok=True)
        if not (WORK / "none/libmutant.so").exists():
            run("gcc", "-shared", "-o", WORK / "none/libmutant.so", "-x", "c", "/dev/null")
        self.times = WORK / "seconds.json"
        self.seconds = json.loads(self.times.read_text()) if self.times.exists() else {}
        self.kills: Counter[tuple[str, str]] = Counter()  # by room and test
        self.lock = Lock()
        self.ready: set[str] = set()
        self.rooms = re.findall(r"^ *kc_room\((\w+)", (ROOT / "fsw/CMakeLists.txt").read_text(), re.M)
        self.where = {
            test: self.rooms.index(room(p)) for p in self.compile if room(p) in self.rooms for test in own(p)
        }
        self.tests = sorted(self.folders)
        self.defines, self.wants = symbols([*objects, *map(str, GIVEN)])
        self.reached: dict[str, set[str]] = {}

    def usable(self, test: str, near: bool) -> bool:
        """Linked, and its seconds known; False if it is too slow for the files of other rooms."""
        if not near and self.patience_s <= 0.0:
            return False
        with self.lock:
            if test not in self.ready:
                self.link(self.folders[test])
                self.ready.add(test)
                self.times.write_text(json.dumps(self.seconds))
        return near or self.seconds.get(test, 0.0) <= self.patience_s

    def link(self, folder: Path) -> None:
        program = WORK / folder.stem
        objects = list(folder.rglob("*.o"))
        newest = max(o.stat().st_mtime for o in [*objects, *GIVEN])
        if program.exists() and folder.stem in self.seconds and newest < program.stat().st_mtime:
            return
        libraries = [*GIVEN, BUILT / "libunity.a"]
        mutant_first = [
            "-L" + str(WORK / "none"),
            "-Wl,--no-as-needed",
            "-lmutant",
            "-L" + str(WORK),
            "-lcore",
        ]
        more = ["-Wl,--as-needed", BUILT / "libkcm.a", "-llcm", "-lm"]
        run("gcc", "-o", program, *objects, *libraries, *mutant_first, *more)
        passed, self.seconds[folder.stem] = self.ran(folder.stem, WORK / "none", 600.0)
        if not passed:
            sys.exit(f"{folder.stem} fails without any mutant")

    def ran(self, test: str, mutant: Path, limit_s: float) -> tuple[bool, float]:
        """Whether a test passes, and its seconds: of the processor, as a busy machine kills no mutant."""
        env = {**os.environ, "LD_LIBRARY_PATH": f"{mutant}:{WORK}"}
        command = ["sh", "-c", f'ulimit -c 0; ulimit -t {limit_s:.0f}; exec stdbuf -oL "$0"', WORK / test]
        process = subprocess.Popen(
            command, env=env, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, cwd=WORK
        )
        waits = Timer(60.0 + 20.0 * limit_s, os.kill, (process.pid, signal.SIGKILL))  # it may wait for ever
        waits.start()
        failed = any(b":FAIL" in line for line in process.stdout)
        waits.cancel()
        process.stdout.close()
        if failed:
            os.kill(process.pid, signal.SIGTERM)  # terminate() would wait for it
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        return not failed and process.returncode == 0, usage.ru_utime

    def tests_of(self, path: str) -> list[str]:
        """Tests of the file, then of its room, then others, what has killed and the quickest first."""
        first, least = own(path), self.rooms.index(room(path))
        needed = [t for t in self.tests if self.needs(t, path)]
        order = {
            t: (
                t not in first,
                self.where.get(t) != least,
                -self.kills[room(path), t],
                self.seconds.get(t, 0.0),
            )
            for t in needed
        }
        return sorted(needed, key=order.__getitem__)

    def needs(self, test: str, path: str) -> bool:
        """Whether the test or what it calls refers to a symbol of the source."""
        if test not in self.reached:
            objects = [str(o) for o in self.folders[test].rglob("*.o")]
            _, wants = symbols(objects)
            waiting = [symbol for object_ in objects for symbol in wants[object_]]
            found: set[str] = set()
            while waiting:
                where = self.defines.get(waiting.pop())
                if where is not None and where not in found:
                    found.add(where)
                    waiting += self.wants.get(where, [])
            self.reached[test] = found
        return any(o.endswith(f"/{room(path)}/{Path(path).name}.o") for o in self.reached[test])

    def near(self, test: str, path: str) -> bool:
        """Whether it is a test of the same room."""
        return self.where.get(test) == self.rooms.index(room(path))

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
        words += ["-Werror=return-type", "-g0", f"-ffile-prefix-map={folder}=.", f"-I{(ROOT / path).parent}"]
        done = subprocess.run(words, cwd=BUILT, capture_output=True, check=False)
        return (folder / "mutant.o").read_bytes() if done.returncode == 0 else None


def symbols(objects: list[str]) -> tuple[dict[str, str], dict[str, list[str]]]:
    """Object that defines each global symbol; symbols that each object wants."""
    defines: dict[str, str] = {}
    wants: dict[str, list[str]] = {o: [] for o in objects}
    for line in subprocess.check_output(["nm", "-A", "-P", *objects], text=True).splitlines():
        where, name, kind = line.split()[:3]
        if kind == "U":
            wants.setdefault(where[:-1], []).append(name)
        elif kind.isupper():
            defines[name] = where[:-1]
    return defines, wants


def run(*words: object) -> None:
    done = subprocess.run([str(w) for w in words], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"{' '.join(map(str, words))}\n{done.stderr}")


# --------------------------------------------------------------------------- trial


def killer(programs: Programs, mutant: Mutant, folder: Path) -> str | None:
    """The test that kills the mutant that is compiled in folder; None if it survives."""
    run("gcc", "-shared", "-o", folder / "libmutant.so", folder / "mutant.o")
    for test in programs.tests_of(mutant.path):
        if not programs.usable(test, programs.near(test, mutant.path)):
            continue
        if not programs.ran(test, folder, 2.0 + 5.0 * programs.seconds[test])[0]:
            programs.kills[room(mutant.path), test] += 1
            return test
    return None


def drawn(
    programs: Programs, paths: list[str], number: int, seed: int, at: int
) -> Iterator[tuple[Mutant, Path]]:
    """Mutants that compile to something else, each with the folder that it is compiled in."""
    source = {path: (ROOT / path).read_text() for path in paths}
    pool = [m for p in paths for m in changes(p, source[p]) if at in (0, m.line(source[p]))]
    random.Random(f"{seed} {paths[0] if len(paths) == 1 else room(paths[0])}").shuffle(pool)
    pool = [m for m in pool if not charges(m, source[m.path])]
    plain: dict[str, bytes | None] = {}
    n = 0
    for mutant in pool:
        if n == number:
            return
        folder = WORK / f"{room(mutant.path)}-{n}"
        if mutant.path not in plain:
            plain[mutant.path] = programs.compiled(
                mutant.path, source[mutant.path], WORK / f"plain-{room(mutant.path)}"
            )
        code = programs.compiled(mutant.path, mutant.of(source[mutant.path]), folder)
        if code is not None and code != plain[mutant.path]:
            n += 1
            yield mutant, folder


def sources(name: str) -> list[str]:
    """A file, or the sources of a room."""
    if not (ROOT / name).is_dir():
        return [name]
    return sorted(str(p.relative_to(ROOT)) for p in (ROOT / name).glob("*.c*") if p.name != "main.c")


def tried(
    programs: Programs, name: str, args: argparse.Namespace, count: Count
) -> Iterator[tuple[Mutant, str | None]]:
    mutants = drawn(programs, sources(name), args.number, args.seed, args.at)
    waiting: deque[tuple[Mutant, Future[str | None]]] = deque()
    with ThreadPoolExecutor(args.jobs) as pool:
        for mutant, folder in mutants:
            source = (ROOT / mutant.path).read_text()
            if count.verdict(mutant, function_of(mutant, source), source) == "equivalent":
                yield mutant, None  # every test that needs the file would be run, for nothing
                continue
            waiting.append((mutant, pool.submit(killer, programs, mutant, folder)))
            while waiting and waiting[0][1].done():
                yield waiting[0][0], waiting.popleft()[1].result()
        for mutant, result in waiting:
            yield mutant, result.result()


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("files", nargs="*", default=SAFETY)
    parser.add_argument("--number", type=int, default=10, help="mutants of each file")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--patience", type=float, default=20.0, help="of the tests of other rooms [s]")
    parser.add_argument("--at", type=int, default=0, help="only mutants of this line")
    args = parser.parse_args()
    programs, count = Programs(args.patience), Count()
    for name in args.files:
        killed, total = count.killed, count.total
        for mutant, test in tried(programs, name, args, count):
            source = (ROOT / mutant.path).read_text()
            count.add(mutant, function_of(mutant, source), source, test is not None)
        print(f"{name}: {count.killed - killed} of {count.total - total} killed", flush=True)
    print(count.text)
    return 0 if count.share >= LEAST_SHARE and count.new == 0 else 1


if __name__ == "__main__":
    sys.exit(main())
