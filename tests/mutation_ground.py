"""Change the ground's safety code one token or statement at a time and see whether its tests notice.

    mutation_ground.py [ROOM ...] [--number 100] [--seed 1] [--jobs 1] [--patience 3]
                       [--file PATH] [--at LINE]

Rooms are named below: the modules that stand between a person and a wrong table or command on board. Of each,
`number` mutants are drawn with a fixed seed (mutants_python.py). Each one is loaded in place of its module in
a process of its own, forked from one that has NumPy and the rest loaded already, and the tests that reach its
lines run there, what has killed and the quickest first, up to `patience` seconds of tests; one that fails or
does not end kills it. Which tests reach a line is measured once (coverage), and again when files change.
Tests that draw pictures are left out: a browser draws them, for seconds that count in no process here, and
they kill nothing that others do not.

The exit status is 1 if of a room fewer than 85 % of the mutants that are not equivalent are killed, or more
than 5 % are alive with a reason in tests/mutation.csv. The sources in the tree are never touched; everything
happens in build/mutation-ground. A second start goes on where the first one was ended."""

import argparse
import ast
import functools
import gc
import hashlib
import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import json
import os
import random
import resource
import shutil
import signal
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

from mutants import ROOT, Count, Mutant
from mutants_python import Place, Source

GROUND = ROOT / "ground"
TESTS = ROOT / "tests"
WORK = ROOT / "build/mutation-ground"
LEAST_SHARE, MOST_EXCUSED = 0.85, 0.05
LIMIT_BYTES = 6 << 30
LIMIT_S = 10.0  # of the processor, and 20 times what a test takes
CLOCK = 12.0  # times as long by the clock: the processor may be busy, and what only waits has to end too
LATE = "no end of "
DRAWS = "ground/kincal/pages/image.py", "_save"  # starts a browser
PACKAGES = ("kincal", "kincal_shared")
ROOMS = {
    "review": ("review/*.py", "api/reviews.py", "cli/review.py"),
    "keys": ("keys.py", "cli/key.py"),
    "uplink": ("link/*.py", "flight/bounds.py", "workbench/**/uplink.py", "api/tables.py",
               "cli/table.py"),
    "tables": ("tables.py", "flight/tables.py", "flight/terms.py", "schema/tables.py", "schema/terms.py",
               "schema/numbers.py", "schema/base.py"),
    "export": ("export/*.py",),
    "operate": ("operate/*.py", "cli/command.py"),
}  # fmt: skip
# Test files that exercise them. Tests marked slow are not run.
FILES = (
    "review", "journal", "keys", "tables", "bounds", "export", "flight", "flight_arm", "flight_events",
    "schema", "schema_terms", "lcmlog", "hostile", "former", "errors", "outputs",
    "review_details", "keys_details", "tables_details", "uplink_details", "export_details", "link_details",
    "room_on_board", "source_limits",
    "changes", "operate", "command", "recording", "history", "operate_trouble", "sent_tables", "two_holders",
    "corrected", "cli", "review_values",
)  # fmt: skip


def paths_of_tests() -> list[Path]:
    return [TESTS / f"ground/test_{name}.py" for name in FILES]


def helpers() -> list[Path]:
    """What test files share."""
    return [f for f in sorted((TESTS / "ground").glob("*.py")) if not f.name.startswith("test_")]


def all_modules() -> list[Path]:
    return sorted(path for package in PACKAGES for path in (GROUND / package).rglob("*.py"))


def modules(room: str) -> list[Path]:
    return sorted(
        {path for glob in ROOMS[room] for package in PACKAGES for path in (GROUND / package).glob(glob)}
    )


def module_name(path: str) -> str:
    parts = Path(path).relative_to("ground").with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def digest(paths: Sequence[Path]) -> str:
    text = hashlib.sha256()
    for path in paths:
        text.update(str(path.relative_to(ROOT)).encode() + path.read_bytes())
    return text.hexdigest()


# --------------------------------------------------------------------------- a module in place of another


class Instead(importlib.abc.MetaPathFinder):
    """Loads one module from another text."""

    def __init__(self, mutant: Mutant, source: str) -> None:
        self.name, self.text = module_name(mutant.path), mutant.of(source)

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: object = None
    ) -> importlib.machinery.ModuleSpec | None:
        del target
        if name != self.name:
            return None
        spec = importlib.machinery.PathFinder.find_spec(name, path)
        text = self.text

        class Loader(importlib.machinery.SourceFileLoader):
            """Of the file, which is not read."""

            def get_code(self, fullname: str) -> CodeType:
                return compile(text, self.get_filename(fullname), "exec", dont_inherit=True)

        if spec is not None and spec.origin is not None:
            spec.loader = Loader(name, spec.origin)
        return spec


def patch(mutant: Mutant, source: str) -> None:
    """Give the functions of a module the code of the mutant."""
    name, line = module_name(mutant.path), mutant.line(source)
    importlib.import_module(name)  # commands are loaded when they are asked for
    new: dict[tuple[str, int], CodeType] = {}
    waiting = [compile(mutant.of(source), str(ROOT / mutant.path), "exec", dont_inherit=True)]
    while waiting:
        code = waiting.pop()
        waiting += [x for x in code.co_consts if isinstance(x, CodeType)]
        if code.co_firstlineno <= line:  # those behind it may have moved
            new[code.co_qualname, code.co_firstlineno] = code
    gc.unfreeze()
    for found in gc.get_objects():
        if isinstance(found, FunctionType) and found.__module__ == name:
            old = found.__code__
            found.__code__ = new.get((old.co_qualname, old.co_firstlineno), old)
        elif isinstance(found, functools._lru_cache_wrapper):
            module = str(getattr(found, "__module__", ""))
            if module.startswith("kincal") and module != "kincal.flight.builds":  # reads no source of a room
                found.cache_clear()


# --------------------------------------------------------------------------- which tests reach which lines


@dataclass(frozen=True)
class Reach:
    """tests: [s] of the processor that each takes; lines: (file, line) -> tests; files: file -> tests."""

    tests: dict[str, float]
    lines: dict[tuple[str, int], set[str]]
    files: dict[str, set[str]]


class Recorder:
    """Plugin of pytest: names the lines that each test reaches, and those that its shared fixtures reach."""

    def __init__(self, coverage: Any) -> None:
        self.coverage = coverage
        self.seconds: dict[str, float] = {}
        self.fixtures: dict[str, list[str]] = {}
        self.failed: list[str] = []
        self.context = ""

    def switch(self, context: str) -> None:
        self.context = context
        self.coverage.switch_context(context)

    def hooks(self, pytest: Any) -> object:
        """The hooks: pytest is loaded only in processes that run tests."""
        recorder = self

        class Hooks:
            @pytest.hookimpl(hookwrapper=True)
            def pytest_runtest_protocol(self, item: Any) -> Iterator[None]:
                recorder.switch(item.nodeid)
                begun_s = time.process_time()
                yield
                recorder.seconds[item.nodeid] = time.process_time() - begun_s
                recorder.fixtures[item.nodeid] = list(item.fixturenames)
                recorder.switch("")

            @pytest.hookimpl(hookwrapper=True)
            def pytest_fixture_setup(self, fixturedef: Any) -> Iterator[None]:
                before = recorder.context
                if fixturedef.scope != "function":
                    recorder.switch(f"fixture {fixturedef.argname}")
                yield
                recorder.switch(before)

            def pytest_runtest_logreport(self, report: Any) -> None:
                if report.failed:
                    recorder.failed.append(report.nodeid)

        return Hooks()


def pytest_arguments(files: Sequence[str]) -> list[str]:
    (WORK / "tmp").mkdir(exist_ok=True)
    options = ["-q", "-m", "not slow", "-c", str(TESTS / "pytest.ini"), "-W", "ignore"]
    options += ["-p", "no:timeout"]  # a mutant's own limit has the same timer
    options.append(f"--basetemp={scratch(os.getpid())}")
    return [*options, *(str(TESTS / name) for name in files)]


def record(file: Path, out: Path) -> None:
    """In a process of its own: run the tests of a file and write what each reaches."""
    sys.path.remove(str(TESTS))  # tests/coverage.py is another one; pytest.ini puts it back
    import coverage
    import pytest

    measured = coverage.Coverage(
        data_file=None, source=[str(GROUND / package) for package in PACKAGES], config_file=False
    )
    recorder = Recorder(measured)
    measured.start()
    arguments = pytest_arguments([str(file.relative_to(TESTS))])
    status = pytest.main(arguments, [recorder.hooks(pytest)])
    measured.stop()
    if status != 0:
        sys.exit("without any mutant the tests fail: " + ", ".join(recorder.failed))
    data = measured.get_data()
    reached: dict[str, dict[str, list[int]]] = {}
    for name in data.measured_files():
        for line, contexts in data.contexts_by_lineno(name).items():
            for context in filter(None, contexts):
                reached.setdefault(context, {}).setdefault(os.path.relpath(name, ROOT), []).append(line)
    found = {"seconds": recorder.seconds, "fixtures": recorder.fixtures, "reached": reached}
    out.write_text(json.dumps(found))


def reach(jobs: int) -> Reach:
    """What the tests reach, measured for files that changed since."""
    sources = all_modules() + sorted((ROOT / "sim/kincal_sim").rglob("*.py"))
    common = digest([*sources, *helpers()])
    WORK.mkdir(parents=True, exist_ok=True)
    stored = {f: WORK / f"reach-{digest([f])[:16]}-{common[:16]}.json" for f in paths_of_tests()}
    missing = [(file, out) for file, out in stored.items() if not out.exists()]
    running: dict[int, Path] = {}
    while missing or running:
        while missing and len(running) < jobs:
            file, out = missing.pop(0)
            print(f"{file.relative_to(ROOT)}: which lines do its tests reach?", flush=True)
            log = WORK / f"reach-{file.stem}.txt"
            running[forked(lambda file=file, out=out: record(file, out), log)] = log
        pid, status = os.wait()
        log = running.pop(pid)
        if status != 0:
            sys.exit(log.read_text()[-4000:])
    lines: dict[tuple[str, int], set[str]] = {}
    of_files: dict[str, set[str]] = {}
    seconds: dict[str, float] = {}
    for out in stored.values():
        found = json.loads(out.read_text())
        seconds |= found["seconds"]
        for test, fixtures in found["fixtures"].items():
            for context in (test, *(f"fixture {name}" for name in fixtures)):
                for path, numbers in found["reached"].get(context, {}).items():
                    of_files.setdefault(path, set()).add(test)
                    for line in numbers:
                        lines.setdefault((path, line), set()).add(test)
    return Reach(seconds, lines, of_files)


def drawing(lines: dict[tuple[str, int], set[str]]) -> set[str]:
    """Tests that reach the function which draws pictures."""
    path, name = DRAWS
    found = [n for n in ast.walk(ast.parse((ROOT / path).read_text())) if getattr(n, "name", "") == name]
    (function,) = (node for node in found if isinstance(node, ast.AsyncFunctionDef))
    body = {node.lineno for node in ast.walk(function) if isinstance(node, ast.stmt) and node is not function}
    return set().union(*(lines.get((path, number), set()) for number in body))


@functools.cache
def naming(path: str) -> frozenset[str]:
    """Test files that import a module by name. What is run when it is loaded, such as the limits and defaults
    of a pydantic model, has its effect where no line of the module runs."""
    package, _, name = (module := module_name(path)).rpartition(".")

    def named(node: ast.AST) -> bool:
        if isinstance(node, ast.Import):
            return any(alias.name == module for alias in node.names)
        if isinstance(node, ast.ImportFrom):
            names = {alias.name for alias in node.names}
            return node.module == module or (node.module == package and name in names)
        return False

    files = [file for file in paths_of_tests() if any(map(named, ast.walk(ast.parse(file.read_text()))))]
    return frozenset(str(file.relative_to(TESTS)) for file in files)


def forked(act: Callable[[], None], log: Path) -> int:
    """Run something in a process of its own, output to a file; its status is 0 if it ended well."""
    sys.stdout.flush()
    pid = os.fork()
    if pid:
        return pid
    status = 1
    try:
        file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
        for number in (1, 2):  # and of the processes that it starts
            os.dup2(file, number)
        act()
        status = 0
    except SystemExit as error:
        print(error.code)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        shutil.rmtree(scratch(os.getpid()), ignore_errors=True)
        os._exit(status)


def scratch(pid: int) -> Path:
    """Temporary files of the tests of a process."""
    return WORK / "tmp" / str(pid)


# --------------------------------------------------------------------------- trial


class Trial:
    """Plugin of pytest: runs chosen tests in their order, each for a limited time, until one fails."""

    def __init__(self, order: Sequence[str], seconds: dict[str, float], answer: int) -> None:
        self.order = {test: k for k, test in enumerate(order)}
        self.seconds, self.answer = seconds, answer
        self.now = "loading"

    def killed(self, how: str = "") -> None:
        os.write(self.answer, f"{how}{self.now}".encode())
        os._exit(1)

    def limit(self, processor_s: float) -> None:
        """From now on; 0: none."""
        signal.setitimer(signal.ITIMER_PROF, processor_s)
        signal.setitimer(signal.ITIMER_REAL, CLOCK * processor_s)

    def hooks(self, pytest: Any) -> object:
        trial = self

        class Hooks:
            def pytest_collection_modifyitems(self, items: list[Any]) -> None:
                items[:] = [item for item in items if item.nodeid in trial.order]
                items.sort(key=lambda item: trial.order[item.nodeid])

            @pytest.hookimpl(hookwrapper=True)
            def pytest_runtest_protocol(self, item: Any) -> Iterator[None]:
                trial.now = item.nodeid
                trial.limit(LIMIT_S + 20.0 * trial.seconds[item.nodeid])
                yield
                trial.limit(0.0)

            def pytest_runtest_logreport(self, report: Any) -> None:
                if report.failed:
                    trial.killed()

        return Hooks()


def limited(order: Sequence[str], seconds: dict[str, float], answer: int) -> Trial:
    """In a process of its own: bounds of what it may take."""
    resource.setrlimit(resource.RLIMIT_AS, (LIMIT_BYTES, LIMIT_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    trial = Trial(order, seconds, answer)
    for number in (signal.SIGPROF, signal.SIGALRM):
        signal.signal(number, lambda *_: trial.killed(LATE))
    trial.limit(3.0 * LIMIT_S)
    return trial


def tried_patched(mutant: Mutant, source: str, trial: Trial, session: Any) -> None:
    """Run tests that were collected before, with the functions of the module changed."""
    import pytest

    items = {item.nodeid: item for item in session.items if item.nodeid in trial.order}
    chosen = sorted(items.values(), key=lambda item: trial.order[item.nodeid])
    session.config.pluginmanager.register(trial.hooks(pytest))
    session.config._tmp_path_factory._given_basetemp = scratch(os.getpid())
    patch(mutant, source)
    for item, following in zip(chosen, [*chosen[1:], None], strict=True):
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)


def tried_loaded(mutant: Mutant, source: str, trial: Trial) -> None:
    """Load everything of KinCal anew, with the mutant in place, and run tests."""
    import pytest

    for name, module in list(sys.modules.items()):
        file = str(getattr(module, "__file__", ""))
        if name.partition(".")[0] in (*PACKAGES, "kincal_sim") or file.startswith(str(TESTS / "ground")):
            del sys.modules[name]
    sys.meta_path.insert(0, Instead(mutant, source))
    files = dict.fromkeys(test.partition("::")[0] for test in trial.order)
    if pytest.main(pytest_arguments(list(files)), [trial.hooks(pytest)]) != 0:
        trial.killed()


@dataclass(frozen=True)
class Running:
    """A mutant on trial."""

    mutant: Mutant
    place: Place
    answer: int


class Trials:
    """Mutants tried, some at a time; what was found is kept in a file."""

    def __init__(self, jobs: int, patience_s: float) -> None:
        self.jobs, self.patience_s = jobs, patience_s
        self.reach = reach(jobs)
        self.drawing = drawing(self.reach.lines)
        self.session: Any = None  # of pytest, with all tests collected
        self.sources = digest([*all_modules(), *helpers()])
        self.results = WORK / "tried.jsonl"
        self.done: dict[str, str] = {}
        self.kills: Counter[tuple[str, str]] = Counter()
        for line in self.results.read_text().splitlines() if self.results.exists() else []:
            row = json.loads(line)
            self.count(row["path"], row["function"], row["killer"])
            if row["known"] == self.known(row["killer"]):
                self.done[row["mutant"]] = row["killer"]
        self.running: dict[int, Running] = {}

    def known(self, killer: str) -> str:
        """On what a finding depends: that a test kills it on that test, that none does on all of them."""
        file = TESTS / killer.partition("::")[0]
        tests = [file] if "::" in killer and file.is_file() else paths_of_tests()
        return f"{self.sources} {digest(tests)}" + ("" if killer else f" {self.patience_s:g}")

    def count(self, path: str, function: str, killer: str) -> None:
        """Remember what kills."""
        self.kills[path, killer] += 1
        self.kills[f"{path} {function}", killer] += 3

    def order(self, mutant: Mutant, place: Place) -> list[str]:
        """Tests that reach it, what has killed and the quickest first, while there is patience."""
        tests = set().union(*(self.reach.lines.get((mutant.path, n), set()) for n in place.lines))
        if not place.lines:
            files = naming(mutant.path)
            tests = {test for test in self.reach.tests if test.partition("::")[0] in files}
            tests |= self.reach.files.get(mutant.path, set())
        tests = tests - self.drawing
        seconds, here = self.reach.tests, f"{mutant.path} {place.function}"
        first = {t: self.kills[here, t] + self.kills[mutant.path, t] for t in tests}
        chosen: list[str] = []
        left_s = self.patience_s
        for test in sorted(tests, key=lambda t: (-first[t], seconds[t])):
            if seconds[test] <= left_s:
                chosen.append(test)
                left_s -= seconds[test]
        return chosen

    def start(self, mutant: Mutant, place: Place, source: str) -> None:
        order = self.order(mutant, place)
        answer, write = os.pipe()

        def act() -> None:
            trial = limited(order, self.reach.tests, write)
            if place.loaded and order:
                tried_loaded(mutant, source, trial)
            elif order:
                tried_patched(mutant, source, trial, self.session)

        pid = forked(act, WORK / f"trial-{len(self.running)}.txt")
        os.close(write)
        self.running[pid] = Running(mutant, place, answer)

    def finish(self) -> tuple[Mutant, Place, str]:
        """Wait for one: the test that killed it, or ""."""
        pid, status = os.wait()
        shutil.rmtree(scratch(pid), ignore_errors=True)  # it ends at once when a test fails
        ended = self.running.pop(pid)
        killer = os.read(ended.answer, 4096).decode()
        os.close(ended.answer)
        if status != 0 and not killer:
            killer = "the process ended"
        return ended.mutant, ended.place, killer

    def all(self, drawn: Sequence[tuple[Mutant, Place, str]]) -> Iterator[tuple[Mutant, Place, str]]:
        """Each with the test that killed it, or ""."""
        for mutant, place, source in drawn:
            key = f"{mutant.path} {mutant.start} {mutant.end} {mutant.text}"
            if key in self.done:
                yield mutant, place, self.done[key]
                continue
            while len(self.running) >= self.jobs:
                yield self.keep(*self.finish())
            self.start(mutant, place, source)
        while self.running:
            yield self.keep(*self.finish())

    def keep(self, mutant: Mutant, place: Place, killer: str) -> tuple[Mutant, Place, str]:
        if killer:
            self.count(mutant.path, place.function, killer)
        row = {
            "mutant": f"{mutant.path} {mutant.start} {mutant.end} {mutant.text}", "path": mutant.path,
            "function": place.function, "killer": killer, "known": self.known(killer),
        }  # fmt: skip
        with self.results.open("a") as file:
            file.write(json.dumps(row) + "\n")
        return mutant, place, killer

    def check(self, path: str, source: str) -> None:
        """Ends this process if the tests fail with the module as it is, loaded as mutants are."""
        for loaded in (True, False):
            self.start(Mutant(path, 0, 0, ""), Place("", (), loaded), source)
            if killer := self.finish()[2]:
                log = (WORK / "trial-0.txt").read_text()
                sys.exit(f"{path} without any change is killed by {killer}\n{log}")


def drawn(room: str, number: int, seed: int, file: str, at: int) -> list[tuple[Mutant, Place, str]]:
    """Mutants of a room, with the text that each changes."""
    pool = []
    for path in modules(room):
        name = str(path.relative_to(ROOT))
        source = Source(name, path.read_text())
        if file in ("", name):
            pool += [(m, p, source) for m, p in source.changes() if at in (0, m.line(source.text))]
    random.Random(f"{seed} {room}").shuffle(pool)
    found: list[tuple[Mutant, Place, str]] = []
    for mutant, place, source in pool:
        if len(found) < number and source.differs(mutant):
            found.append((mutant, place, source.text))
    return found


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("rooms", nargs="*", default=list(ROOMS), help=" ".join(ROOMS))
    parser.add_argument("--number", type=int, default=100, help="mutants of each room")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--patience", type=float, default=3.0, help="of the tests of a mutant [s]")
    parser.add_argument("--file", default="", help="only mutants of this file")
    parser.add_argument("--at", type=int, default=0, help="only mutants of this line")
    args = parser.parse_args()
    if unknown := set(args.rooms) - set(ROOMS):
        parser.error(f"no such room: {', '.join(sorted(unknown))}; rooms are {' '.join(ROOMS)}")
    trials = Trials(args.jobs, args.patience)
    import pytest

    class Loop:
        """Once the tests are collected, mutants are tried in place of running them."""

        status = 1

        def pytest_runtestloop(self, session: Any) -> bool:
            trials.session = session
            self.status = judged(trials, args)
            return True

    loop = Loop()
    names = [str(file.relative_to(TESTS)) for file in paths_of_tests()]
    pytest.main([*pytest_arguments(names), "-qq", "-s", "--no-summary"], [loop])
    shutil.rmtree(WORK / "tmp", ignore_errors=True)
    return loop.status


def judged(trials: Trials, args: argparse.Namespace) -> int:
    """Draws, tries and counts; the exit status."""
    good = True
    gc.freeze()
    for room in args.rooms:
        found, count, late = drawn(room, args.number, args.seed, args.file, args.at), Count(), 0
        if not found:
            sys.exit(f"nothing to change there in {room}")
        trials.check(found[0][0].path, found[0][2])
        sources = {mutant.path: source for mutant, _, source in found}
        for mutant, place, killer in trials.all(found):
            count.add(mutant, place.function, sources[mutant.path], bool(killer))
            late += killer.startswith(LATE)
        good = good and count.share >= LEAST_SHARE and count.excused <= MOST_EXCUSED * count.total
        print(f"{room}: {count.text}; {late} of the kills by time", flush=True)
    return 0 if good else 1


if __name__ == "__main__":
    os.environ |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    sys.exit(main())
