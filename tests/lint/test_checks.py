"""The checks find what they are there for: each is given a small tree or program with one fault."""

import configparser
import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import threading
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

LINT = Path(__file__).resolve().parent
TESTS = LINT.parent


def module(path: Path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


def write(root: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


def script(name: str, *args: object) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, LINT / name, *map(str, args)], capture_output=True, text=True)


def compiled(folder: Path, source: str, *flags: str) -> Path:
    """An object file as the Makefile makes it, call graph beside it."""
    path = write(folder, {"fsw/math/kc_x.c": source}) / "fsw/math/kc_x.c"
    obj = path.with_name("kc_x.c.o")
    subprocess.run(
        ["gcc", "-O1", "-c", "-fcallgraph-info=su", *flags, path, "-o", obj], check=True, cwd=folder
    )
    return obj


# ---- a small tree, built by the project's own CMake files

ROOT = TESTS.parent
ROOMS = re.findall(r"^ *kc_room\((\w+)", (ROOT / "fsw/CMakeLists.txt").read_text(), re.M)


def tree(root: Path) -> Path:
    """The description of the build with one small file in each room, and a test of math."""
    files = {f"fsw/{room}/kc_{room}.h": f"int kc_{room}(int n);\n" for room in ROOMS}
    for room in ROOMS:
        name = f"fsw/{room}/kc_{room}.{'cpp' if room == 'eigen' else 'c'}"
        files[name] = f'#include "kc_{room}.h"\nint kc_{room}(int n) {{ return n; }}\n'
    files |= {
        "fsw/msg/time_t.lcm": "package kcm;\n// Channel KC_TIME: simulator -> flight; 10 Hz; time.\n"
        "struct time_t\n{\nint64_t us;\n}\n",
        "fsw/lcm/main.c": "int main(void) { return 0; }\n",
        "ground/native/kg_batch.c": '#include "kc_model.h"\n'
        "int kg(void);\nint kg(void) { return kc_model(1); }\n",
        "sim/native/ks_x.cpp": "extern const int ks_x;\nconst int ks_x = 0;\n",
        "sim/tagdet/main.cpp": "int main() { return 0; }\n",
        "sim/tagdet/frame.cpp": "extern const int kFrame;\nconst int kFrame = 0;\n",
        "tests/bench/wcet.c": "int main(void) { return 0; }\n",
        "tests/bench/wcet_search.c": "int main(void) { return 0; }\n",
        "ground/native/quick_crc.c": "",
        "tests/system/given_nothing.c": "",
        "tests/unit/test_kc_math.c": '#include "unity.h"\n#include "kc_math.h"\n'
        "void test_four(void) { TEST_ASSERT_EQUAL_INT(4, kc_math(4)); }\n",
    }
    files["fsw/eigen/kc_eigen.h"] = '#ifdef __cplusplus\nextern "C"\n#endif\nint kc_eigen(int n);\n'
    for name in ("CMakeLists.txt", "fsw/CMakeLists.txt", "sim/native/CMakeLists.txt",
                 "sim/tagdet/CMakeLists.txt", "ground/CMakeLists.txt",
                 "fsw/musl/kc_musl_names.h", "fsw/math/kc_libm.h",
                 "tests/cross/CMakeLists.txt", "tests/cross/replay.c", "tests/cross/host.c", "ground/cdef.py",
                 "ground/lcm_files.py", "ground/message_structs.py",
                 "tests/unit/CMakeLists.txt", "tests/unit/given_main.c", "tests/unit/given_main.h",
                 "tests/system/CMakeLists.txt"):  # fmt: skip
        files[name] = (ROOT / name).read_text()
    return write(root, files)


def tool(*command: object) -> subprocess.CompletedProcess:
    return subprocess.run([*map(str, command)], capture_output=True, text=True)


def configured(root: Path, build_type: str = "Release", *options: str) -> Path:
    """The build folder of a tree."""
    done = tool("cmake", "-S", root, "-B", root / "build/x", "-G", "Ninja", "-DBUILD_TESTING=ON",
                f"-DCMAKE_BUILD_TYPE={build_type}", "-DCMAKE_COMPILE_WARNING_AS_ERROR=ON",
                "-DCMAKE_VERIFY_INTERFACE_HEADER_SETS=ON", f"-DUNITY={ROOT / 'build/unity/src'}",
                f"-DMUSL={ROOT / 'build/musl'}", f"-DMONOCYPHER={ROOT / 'build/monocypher'}",
                *options)  # fmt: skip
    assert done.returncode == 0, done.stderr
    return root / "build/x"


def build(folder: Path, *targets: str) -> subprocess.CompletedProcess:
    return tool("cmake", "--build", folder, "--target", *targets)


# ---- includes point down, imports too


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    return configured(tree(tmp_path_factory.mktemp("small")))


@pytest.mark.parametrize(
    ("file", "header", "target"),
    [
        ("fsw/math/kc_math.c", "kc_model.h", "kc_math"),
        ("fsw/model/kc_model.c", "kc_eigen.h", "kc_model"),
        ("fsw/design/kc_design.c", "kc_motion.h", "kc_design"),
        ("fsw/app/kc_app.c", "kc_lcm.h", "kc_app"),
        ("fsw/store/kc_store.c", "kc_reach.h", "kc_store"),
        ("fsw/command/kc_command.c", "kc_store.h", "kc_command"),
        ("fsw/messages/kc_messages.c", "kc_state.h", "kc_messages"),
        ("fsw/estimate/kc_estimate.h", "kc_app.h", "kc_estimate_verify_interface_header_sets"),
        ("ground/native/kg_batch.c", "kc_app.h", "kincal_native"),
    ],
)
def test_an_include_of_a_room_that_is_not_below_does_not_compile(small, file, header, target):
    path = small.parents[1] / file
    before = path.read_text()
    path.write_text(f'#include "{header}"\n{before}')
    done = build(small, target)
    path.write_text(before)
    assert done.returncode != 0
    assert f"{header}: No such file" in done.stdout
    assert build(small, target).returncode == 0


@pytest.mark.parametrize(
    ("files", "complaint"),
    [
        ({"fsw/app/kc_a.c": "\n#include <stdio.h>\n"}, "fsw/app/kc_a.c:2: <stdio.h> is not for the core"),
        ({"fsw/model/kc_a.c": "#include <math.h>\n"}, "fsw/model/kc_a.c:1: <math.h> is not for the core"),
        ({"fsw/model/kc_a.c": "double f(double x) { return sin(x); }\n"}, "sin() instead of kc_sin()"),
        ({"fsw/app/kc_a.c": '#include "../math/kc_rot.h"\n'}, "is no header of fsw/"),
        ({"sim/kincal_sim/x.py": "LIB = 'build/libkincal.so'\n"}, "must not load the flight core"),
        ({"sim/tagdet/x.cpp": '#include "kc_rot.h"\n'}, "must not include flight code"),
        ({"sim/native/ks_y.cpp": '#include "kc_rot.h"\n'}, "must not include flight code"),
        (
            {
                "fsw/app/kc_a.h": "void kc_a(void);\n",
                "fsw/app/kc_b.h": "void kc_b(void);\n",
                "fsw/app/kc_a.c": '#include "kc_b.h"\nvoid kc_a(void) { kc_b(); }\n',
                "fsw/app/kc_b.c": '#include "kc_a.h"\nvoid kc_b(void) { kc_a(); }\n',
            },
            "fsw/app: a circle: kc_a.c -> kc_b.c -> kc_a.c",
        ),
        (
            {"fsw/msg/a_t.lcm": "struct a_t\n{\n    int32_t n;\n    double x[n];\n}\n"},
            "fsw/msg/a_t.lcm: x: a message has a fixed size",
        ),
        (
            {"fsw/msg/a_t.lcm": "struct a_t\n{\n    // text\n    string text;\n    int8_t b;\n}\n"},
            "fsw/msg/a_t.lcm: text: a message has a fixed size",
        ),
        (
            {"fsw/msg/image_t.lcm": "struct image_t\n{\n int32_t n;\n byte jpeg[n];\n int8_t b;\n}\n"},
            "fsw/msg/image_t.lcm: jpeg: a message has a fixed size",
        ),
        (
            {"sim/tagdet/main.cpp": 'void f() { kcm_image_t_subscribe(lcm, "KC_IMAGE", on, 0); }\n'},
            "sim/tagdet/main.cpp: kcm_image_t_subscribe() believes n_bytes",
        ),
        (
            {f"ground/kincal/many/m{n}.py": "" for n in range(26)},
            "ground/kincal/many: 26 modules in one folder; 25 are the most",
        ),
    ],
)
def test_an_include_that_is_not_for_its_file_is_named(tmp_path, files, complaint):
    done = script("direction.py", write(tmp_path, files))
    assert done.returncode == 1
    assert complaint in done.stdout


def test_includes_that_are_allowed_and_words_in_comments_pass(tmp_path):
    done = script(
        "direction.py",
        write(
            tmp_path,
            {
                "fsw/math/kc_a.h": "/* sin(x), <stdio.h> */\n#include <stdint.h>\n",
                "fsw/model/kc_b.c": '#include "kc_a.h"\ndouble g(double x) { return kc_sin(x); } // cos(x)\n'
                'const char *text = "see the log (\\"all\\") of tan(x)";\n',
                "fsw/lcm/main.c": '#include <stdio.h>\n#include "kc_a.h"\n#include "kcm_time_t.h"\n',
                "sim/kincal_sim/y.py": "from kincal_sim import world\nimport kcm\n",
            },
        ),
    )
    assert (done.returncode, done.stdout) == (0, "")


@pytest.mark.parametrize(
    ("file", "line", "complaint"),
    [
        (
            "ground/kincal/flight/x.py",
            "import kincal.workbench.fit",
            "kincal.flight.x -> kincal.workbench.fit",
        ),
        (
            "ground/kincal/workbench/model/x.py",
            "from kincal.workbench.diagnosis import study",
            "kincal.workbench.model.x -> kincal.workbench.diagnosis",
        ),
        (
            "ground/kincal/workbench/fit/frames.py",
            "from kincal.workbench.fit import least_squares",
            "No cycles are allowed in kincal.workbench.fit",
        ),
        ("ground/kincal/link/x.py", "from kincal.cli import main", "kincal.link.x -> kincal.cli"),
        (
            "ground/kincal/cli/model/x.py",
            "from kincal.workbench.fit.least_squares import fit_model",
            "kincal.cli.model.x -> kincal.workbench.fit.least_squares",
        ),
        ("sim/kincal_sim/x.py", "def f():\n    import kincal.tables", "kincal_sim.x -> kincal.tables"),
        (
            "ground/kincal_shared/schema/x.py",
            "from kincal.workbench.fit import frames",
            "kincal_shared.schema.x -> kincal.workbench.fit",
        ),
        ("ground/kincal/workbench/x.py", "import kincal_sim.world", "kincal.workbench.x -> kincal_sim.world"),
    ],
)
def test_an_import_that_points_up_is_named(tmp_path, file, line, complaint):
    for package in ("ground/kincal", "ground/kincal_shared", "sim/kincal_sim"):
        shutil.copytree(
            TESTS.parent / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__")
        )
    (tmp_path / file).write_text(line + "\n")
    path = f"{tmp_path / 'ground'}:{tmp_path / 'sim'}"
    done = subprocess.run(
        [Path(sys.executable).with_name("lint-imports"), "--config", TESTS / "layers.ini", "--no-cache"],
        capture_output=True, text=True, env=os.environ | {"PYTHONPATH": path}, cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 1
    assert complaint in done.stdout, done.stdout


# ---- footprint


def test_stack_is_the_sum_along_the_deepest_chain(tmp_path):
    obj = compiled(
        tmp_path,
        "void use(char *);\n"
        "__attribute__((noinline)) static void low(void) { char a[4000]; use(a); }\n"
        "__attribute__((noinline)) static void side(void) { char a[100]; use(a); }\n"
        "void top(void) { char a[2000]; use(a); side(); low(); }\n",
    )
    done = script("footprint.py", "--max-static", 100, "--max-stack", 32768, obj)
    assert done.returncode == 0, done.stdout
    worst = int(next(line for line in done.stdout.splitlines() if "worst stack" in line).split()[2])
    allowance = module(LINT / "footprint.py").LIBRARY_BYTES
    assert 6000 + allowance <= worst <= 6200 + allowance
    assert script("footprint.py", "--max-static", 100, "--max-stack", 6000, obj).returncode == 1


def test_recursion_through_two_functions_is_a_fault(tmp_path):
    obj = compiled(
        tmp_path,
        "int b(int);\n__attribute__((noinline)) int a(int n) { return n ? 1 + b(n - 1) : 0; }\n"
        "__attribute__((noinline)) int b(int n) { return n ? 1 + a(n - 1) : 0; }\n",
        "-fno-optimize-sibling-calls",
        "-fno-inline",
    )
    done = script("footprint.py", "--max-static", 100, "--max-stack", 32768, obj)
    assert done.returncode == 1
    assert "recursion: " in done.stdout


def test_a_frame_of_variable_size_is_a_fault(tmp_path):
    obj = compiled(tmp_path, "void use(char *);\nvoid f(int n) { char a[n]; use(a); }\n")
    done = script("footprint.py", "--max-static", 100, "--max-stack", 32768, obj)
    assert done.returncode == 1
    assert "without a fixed size" in done.stdout


def test_a_call_through_an_unlisted_pointer_is_a_fault(tmp_path):
    obj = compiled(tmp_path, "int f(int (*g)(int)) { return 1 + g(2); }\n")
    done = script("footprint.py", "--max-static", 100, "--max-stack", 32768, obj)
    assert done.returncode == 1
    assert "calls through a pointer" in done.stdout


def test_static_memory_is_data_and_bss_by_module(tmp_path):
    obj = compiled(
        tmp_path, "char zeros[1000];\nchar ones[500] = {1};\nvoid f(void) { zeros[0] = ones[0]; }\n"
    )
    good = script("footprint.py", "--max-static", 1600, "--max-stack", 32768, obj)
    assert good.returncode == 0, good.stdout
    assert any(
        line.split()[0] == "math" and line.split()[2:] == ["500", "1000"] for line in good.stdout.splitlines()
    )
    assert script("footprint.py", "--max-static", 1499, "--max-stack", 32768, obj).returncode == 1


# ---- heap


@pytest.mark.parametrize(
    ("call", "complaint"),
    [
        ("void *malloc(unsigned long);\nvoid *f(void) { return malloc(4); }", "heap functions: malloc"),
        ("void free(void *);\nvoid f(void *p) { free(p); }", "heap functions: free"),
        ("void *_Znwm(unsigned long);\nvoid *f(void) { return _Znwm(4); }", "heap functions: _Znwm"),
        ("double sin(double);\ndouble f(double x) { return sin(x); }", "not for the core: sin"),
        ("long time(long *);\nlong f(void) { return time(0); }", "not for the core: time"),
    ],
)
def test_a_core_that_wants_the_heap_or_a_clock_is_refused(tmp_path, call, complaint):
    obj = compiled(tmp_path, call + "\n")
    archive = tmp_path / "libx.a"
    subprocess.run(["ar", "rcs", archive, obj], check=True)
    done = script("heap.py", archive)
    assert done.returncode == 1
    assert complaint in done.stdout


# ---- what is fetched


def fetched(folder: Path, source: Path, what: str = "musl") -> subprocess.CompletedProcess:
    environment = os.environ | {f"{what.upper()}_DIR": str(source)}
    command = [str(ROOT / ".ci" / what), str(folder)]
    return subprocess.run(command, env=environment, capture_output=True, text=True)


def test_mathematics_is_taken_only_as_it_was_tested(tmp_path):
    """A good folder first: the files come, and no network is needed."""
    assert fetched(tmp_path / "good", ROOT / "build/musl").returncode == 0
    assert (tmp_path / "good/src/math/sin.c").read_text() == (ROOT / "build/musl/src/math/sin.c").read_text()
    other = tmp_path / "good/src/math/exp_data.c"
    other.write_text(other.read_text().replace("0x1.", "0x1.0", 1))
    refused = fetched(tmp_path / "bad", tmp_path / "good")
    assert refused.returncode == 1
    assert "src/math/exp_data.c" in refused.stdout + refused.stderr
    assert not (tmp_path / "bad").exists()


def test_message_authentication_is_taken_only_as_it_was_tested(tmp_path):
    assert fetched(tmp_path / "good", ROOT / "build/monocypher", "monocypher").returncode == 0
    other = tmp_path / "good/src/monocypher.c"
    other.write_text(other.read_text().replace("crypto_verify16", "crypto_verify_16", 1))
    refused = fetched(tmp_path / "bad", tmp_path / "good", "monocypher")
    assert refused.returncode == 1
    assert "src/monocypher.c" in refused.stdout + refused.stderr
    assert not (tmp_path / "bad").exists()


# ---- unit tests and their coverage

UNIT = """#include <stdlib.h>
#include "unity.h"
void test_good(void) { TEST_ASSERT_EQUAL_INT(1, 1); }
/* void test_old(void) { } */
void test_bad(void) { TEST_ASSERT_EQUAL_INT(1, 2); }
void test_later(void) { TEST_IGNORE_MESSAGE("not yet"); }
void test_gone(void) { exit(0); }
void test_crash(void) { abort(); }
"""


@pytest.fixture
def unit_tests(small):
    """Where a test of the small tree can be put; it is found at the next build, and taken away afterwards."""
    before = set((small.parents[1] / "tests/unit").iterdir())
    yield small.parents[1] / "tests/unit"
    for path in set((small.parents[1] / "tests/unit").iterdir()) - before:
        path.unlink()


def test_every_test_function_counts_and_bad_ends_are_failures(small, unit_tests, tmp_path):
    (unit_tests / "test_kc_bad.c").write_text(UNIT)
    folder, report = small, tmp_path / "out.xml"
    done = build(folder, "units")
    assert done.returncode == 0, done.stdout
    done = tool("ctest", "--test-dir", folder, "--output-junit", report)
    assert done.returncode != 0
    assert module(TESTS / "suite.py").count(report) == (2, 3, 1)
    cases = {case.get("name"): case.get("status") for case in ET.parse(report).iter("testcase")}
    assert cases == {
        "kc_math.test_four": "run", "kc_bad.test_good": "run", "kc_bad.test_bad": "fail",
        "kc_bad.test_later": "notrun", "kc_bad.test_gone": "fail", "kc_bad.test_crash": "fail",
    }  # fmt: skip
    assert tool(folder / "unit/test_kc_math", "test_five").returncode != 0  # no such test


def test_a_test_that_would_never_run_does_not_compile(small, unit_tests):
    path = unit_tests / "test_kc_odd.c"
    path.write_text(UNIT + "void  test_odd( void ) { }\n")
    done = build(small, "test_kc_odd")
    assert done.returncode != 0
    assert "test_odd" in done.stdout
    path.write_text("int helper;\n")
    done = build(small, "test_kc_odd")
    assert done.returncode != 0
    assert "no test in it" in " ".join(done.stderr.split())  # CMake breaks lines where the path is long


def counted(folder: Path) -> None:
    """Counters of the unit tests of a tree, as `make cov` exports them."""
    profile, counters = folder / "x.profraw", folder / "x.profdata"
    done = build(folder, "test_kc_math", "kincal_shared")
    assert done.returncode == 0, done.stdout
    assert tool("env", f"LLVM_PROFILE_FILE={profile}", folder / "unit/test_kc_math").returncode == 0
    assert tool("llvm-profdata-19", "merge", "-o", counters, profile).returncode == 0
    done = tool("llvm-cov-19", "export", f"-instr-profile={counters}", folder / "libkincal.so")
    (folder / "x.json").write_text(done.stdout)


def covered(folder: Path, exceptions: str) -> subprocess.CompletedProcess:
    """tests/coverage.py, with the functions of all files but kc_math.c excused."""
    table = folder / "x.csv"
    command = (sys.executable, TESTS / "coverage.py", folder / "x.json", table, folder.parents[1])
    table.write_text("file,function,condition,never,reason\n")
    others = re.findall(r"^(fsw/.+):0: (\w+): never called: $", tool(*command).stdout, re.M)
    rows = [f"{file},{name},,called,not tested\n" for file, name in others if file != "fsw/math/kc_math.c"]
    table.write_text("".join([table.read_text(), *rows, exceptions]))
    return tool(*command)


def test_a_condition_that_no_test_decides_is_a_failure(tmp_path):
    root = tree(tmp_path)
    folder = configured(root, "Coverage", "-DCMAKE_C_COMPILER=clang-19", "-DCMAKE_CXX_COMPILER=clang++-19")
    each = "for (int i = 0; i < n; i++) { m = %s ? 0 : m; }"
    cases = [  # a function each, called with n = 4; what is never what
        ("m = n > 3;", []),  # a value, no condition
        ("if (n > 3) { m = 0; }", [("n > 3", "false")]),
        ("for (int i = 0; i < n; i++) { m = 0; }", []),
        ("if (n > 3 && one) { m = 0; }", [("n > 3", "false"), ("one", "false")]),
        (each % "i > 1 && i < n", [("i < n", "false")]),
        (each % "i > 1 && i < 3", []),
        # both values are seen, but the first is never the reason: where it is true, the second is false
        (each % "i > 1 && i * i < 4", [("i * i < 4", "true"), ("i > 1", "decides")]),
        (each % "i > 1 && (i > 2 || i * i < 9)", [("i * i < 9", "false"), ("i > 2", "decides")]),
        (each % "one && !(i > 1 && i < 3)", [(c, "measured") for c in ("one", "i > 1", "i < 3")]),
        ("SKIP(n) SKIP(n + 9)", [(c, never) for c in ("(x) > 5", "one") for never in ("true", "false")]),
    ]
    text = (
        '#include "kc_math.h"\n#define SKIP(x) if ((x) > 5 && one) { m = 1; }\nstatic volatile int one = 1;\n'
    )
    for k, (body, _) in enumerate(cases):
        text += f"static int case_{k}(int n)\n{{\n    volatile int m = 0;\n    m = !one;\n    {body}\n"
        text += "    return n + 0 * m;\n}\n"
    calls = "".join(f" + 0 * case_{k}(n)" for k in range(len(cases)))
    text += f"int kc_math(int n) {{ return n{calls}; }}\nint kc_b(int n);\nint kc_b(int n) {{ return n; }}\n"
    (root / "fsw/math/kc_math.c").write_text(text)
    counted(folder)
    done = covered(folder, "")
    found = re.findall(r"^fsw/math/kc_math\.c:\d+: (\w+): never (\w+): ?(.*)$", done.stdout, re.M)
    wanted = [(f"case_{k}", never, what) for k, (_, of) in enumerate(cases) for what, never in of]
    assert sorted(found) == sorted([*wanted, ("kc_b", "called", "")]), done.stdout + done.stderr
    assert done.returncode == 1
    rows = "".join(f"fsw/math/kc_math.c,{name},{what},{never},tested\n" for name, never, what in found)
    assert covered(folder, rows).returncode == 0
    assert "needed no more" in covered(folder, rows + rows).stdout
    assert "no reason" in covered(folder, rows.replace("tested", "")).stderr


# ---- types


def test_types_are_read_of_every_part_of_scipy_that_is_used():
    config = configparser.ConfigParser()
    config.read(TESTS / "mypy.ini")
    [section] = [name for name in config.sections() if "scipy." in name]
    skipped = re.findall(r"scipy\.(\w+)\.\*", section)
    assert len(skipped) > 5
    used = re.compile(rf"\bscipy\.({'|'.join(skipped)})\b|\bfrom scipy import .*\b({'|'.join(skipped)})\b")
    sources = [path for folder in ("ground", "sim") for path in (ROOT / folder).rglob("*.py")]
    assert any(re.search(r"\bscipy\.linalg\b", path.read_text()) for path in sources)
    assert [path.name for path in sources if used.search(path.read_text())] == []


# ---- the summary


def test_the_closing_line_sums_all_steps(tmp_path):
    steps = [
        {"step": "unit", "seconds": 1.0, "passed": 5, "failed": 0, "skipped": 0},
        {"step": "lint", "seconds": 1.0, "passed": 0, "failed": 1, "skipped": 0},
    ]
    (tmp_path / "summary.json").write_text(json.dumps(steps))
    command = [sys.executable, TESTS / "suite.py", "--junit", tmp_path, "--sum"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (1, "5 passed, 1 failed\n")


def test_steps_run_side_by_side_after_the_first_also_when_one_fails(tmp_path, monkeypatch, capsys):
    suite, begun, together = module(TESTS / "suite.py"), [], threading.Barrier(4, timeout=60.0)

    def run(step, logs, processors, nice=0):
        begun.append((step, processors, nice))
        (logs / f"{step}.txt").write_text(f"log of {step}")
        if step in ("long", "bad", "short", "computes"):
            together.wait()  # each until the others run too: on two processors three, and one beside
        return int(step == "bad"), 1.0, 0.5

    monkeypatch.setattr(suite, "run", run)
    steps = ["long", "bad", "short"]
    done = suite.run_all(["build"], ["computes", "later"], steps, tmp_path, tmp_path, 2)
    assert begun[0] == ("build", 2, 0) and begun[-1] == ("later", 1, suite.NICE)
    assert sorted(begun[1:-1]) == [
        ("bad", 1, 0),
        ("computes", 1, suite.NICE),
        ("long", 1, 0),
        ("short", 1, 0),
    ]
    assert {d["step"] for d in done if d["failed"]} == {"bad"} and len(done) == 6
    printed = capsys.readouterr().out
    assert "log of bad" in printed and "log of long" not in printed


def test_a_step_has_the_processors_that_it_is_given_and_keeps_its_log(tmp_path, monkeypatch):
    make = tmp_path / "make"
    busy = "from time import process_time as t\nwhile t() < 0.2: pass"
    make.write_text(f'#!/bin/sh\necho "$@"\n{sys.executable} -c "{busy}"\nexit 3\n')
    make.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    code, seconds, busy_s = module(TESTS / "suite.py").run("lint", tmp_path, 2, 1)
    assert code == 3 and 0.2 <= busy_s <= seconds + 0.1, "the time of what the step started counts"
    assert (tmp_path / "lint.txt").read_text() == "--no-print-directory -j2 -k lint PROCESSORS=2\n"


def test_a_step_that_hangs_is_ended_and_fails_and_the_others_keep_their_results(
    tmp_path, monkeypatch, capsys
):
    make = tmp_path / "make"  # the real one ends its jobs too when it is ended
    make.write_text('#!/bin/sh\necho "$@"\ncase "$*" in *hangs*) exec sleep 600;; esac\n')
    make.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    suite = module(TESTS / "suite.py")
    monkeypatch.setattr(suite, "LIMIT_S", 0.5)
    done = suite.run_all([], [], ["hangs", "good"], tmp_path, tmp_path, 1)
    assert {d["step"]: d["failed"] for d in done} == {"hangs": 1, "good": 0}
    assert "FAIL  hangs" in capsys.readouterr().out


def test_no_test_at_all_is_a_failure(tmp_path):
    command = [sys.executable, TESTS / "suite.py", "--junit", tmp_path, "--sum"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (1, "0 passed, 0 failed\n")


def test_pytest_errors_count_as_failures(tmp_path):
    suite = ET.Element("testsuite")
    for child in (None, "failure", "error", "skipped"):
        case = ET.SubElement(suite, "testcase", name=str(child))
        if child:
            ET.SubElement(case, child)
    report = tmp_path / "x.xml"
    ET.ElementTree(suite).write(report)
    assert module(TESTS / "suite.py").count(report) == (1, 2, 1)


# ---- events


def test_the_event_list_is_read_whole():
    header = (TESTS.parent / "fsw/tables/kc_events.h").read_text()
    listed = len(re.findall(r"^ +X\(\d+, ", header, flags=re.M))
    events = module(LINT / "events.py")
    text = events.documents()[events.DOC]
    assert sum(line.startswith("| ") and line[2].isdigit() for line in text.splitlines()) == listed > 0


def test_a_placeholder_of_an_unknown_type_is_refused(tmp_path, monkeypatch):
    events = module(LINT / "events.py")
    text = events.HEADER.read_text().replace("{got:crc}", "{got:furlong}")
    (tmp_path / "kc_events.h").write_text(text)
    monkeypatch.setattr(events, "HEADER", tmp_path / "kc_events.h")
    with pytest.raises(SystemExit, match="furlong"):
        events.documents()


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("\nBOOT = ", "\n# BOOT = ", "event without an entry: BOOT"),
        ("[event]\n", '[event]\nNEWS = { cause = "x", do = "y" }\n', "entry of no event: NEWS"),
        ('COR_ROLLBACK = { cause = "ROLLBACK."', 'COR_ROLLBACK = { cause = " "', "COR_ROLLBACK: needs cause"),
        ("\nCAMERA = ", "\n# CAMERA = ", "cause without an entry: CAMERA"),
        ("`kincal log LOG", "`kincal lag LOG", "kincal lag"),
        ("`budget_us`", "`budgets_us`", "budgets_us"),
    ],
)
def test_an_event_needs_a_cause_and_what_to_do(old, new, complaint, tmp_path, monkeypatch):
    events = module(LINT / "events.py")
    text = events.TABLE.read_text()
    assert old in text
    (tmp_path / "kc_events.toml").write_text(text.replace(old, new, 1))
    monkeypatch.setattr(events, "TABLE", tmp_path / "kc_events.toml")
    with pytest.raises(SystemExit, match=complaint):
        events.documents()


# ---- MISRA


@pytest.mark.parametrize(
    ("row", "found", "complaint"),
    [
        ("10.4,mixed,accepted,compilers check,*", {"10.4": {"a.c": 2}}, None),
        ("10.4,mixed,accepted,compilers check,a.c", {"10.4": {"a.c": 2}, "15.1": {"b.c": 1}}, "15.1"),
        ("10.4,mixed,accepted,compilers check,a.c", {"10.4": {"a.c": 1, "b.c": 1}}, "b.c too"),
        ("10.4,mixed,accepted,compilers check,a.c b.c", {"10.4": {"a.c": 1}}, "not in b.c any more"),
        ("10.4,mixed,accepted,compilers check,*", {}, "delete its row"),
        ("10.4,mixed,perhaps,compilers check,*", {"10.4": {"a.c": 1}}, "decision"),
        ("10.4,mixed,accepted,,*", {"10.4": {"a.c": 1}}, "reason"),
    ],
)
def test_every_deviation_from_misra_is_decided_and_no_decision_is_left_over(row, found, complaint):
    names = ("rule", "kind", "decision", "reason", "files")
    rows = [dict(zip(names, row.split(","), strict=True))]
    said = module(LINT / "misra.py").complaints(rows, found)
    assert [complaint in line for line in said] == [True] if complaint else said == []


def test_misra_finds_all_rules_that_a_line_breaks_and_those_of_headers_once(tmp_path, monkeypatch):
    misra = module(LINT / "misra.py")
    source = '#include "kc_h.h"\nint kc_x(int n);\nint kc_x(int n)\n{\n'
    source += "    if (kc_h(n) + n * 2 > 0) { goto end; }\n    n = 1;\nend:\n    return n;\n}\n"
    header = (
        "static inline int kc_h(int n)\n{\n    if (n > 0) { goto end; }\n    n = 1;\nend:\n    return n;\n}\n"
    )
    core = {f"fsw/{room}/kc_{room}.c": "" for room in misra.ROOMS}
    core |= {
        "fsw/math/kc_h.h": header,
        "fsw/math/kc_x.c": source,
        "fsw/math/kc_y.c": source.replace("_x", "_y"),
    }
    write(tmp_path, core)
    monkeypatch.setattr(misra, "ROOT", tmp_path)
    found = misra.findings(None)
    assert found["15.1"] == {"kc_x.c": 1, "kc_y.c": 1, "kc_h.h": 1}
    assert set(found["12.1"]) == {"kc_x.c", "kc_y.c"}


def test_misra_checks_again_what_has_changed(tmp_path, monkeypatch):
    misra = module(LINT / "misra.py")
    plain, end = "int kc_x(int n);\nint kc_x(int n)\n{\n    n = 1;\n", "    return n;\n}\n"
    write(
        tmp_path, {f"fsw/{room}/kc_{room}.c": "" for room in misra.ROOMS} | {"fsw/math/kc_x.c": plain + end}
    )
    monkeypatch.setattr(misra, "ROOT", tmp_path)
    assert "15.1" not in misra.findings(tmp_path / "build")
    write(tmp_path, {"fsw/math/kc_x.c": plain + "    if (n > 0) { goto end; }\nend:\n" + end})
    assert misra.findings(tmp_path / "build")["15.1"] == {"kc_x.c": 1}


# ---- one vocabulary

GLOSSARY = """# Glossary

## Operation

| term | meaning | source |
|---|---|---|
| <a id="safe"></a>safe `SAFE` | arm held | common |
| <a id="state"></a>state | of the sequencer | UML |
"""


@pytest.mark.parametrize(
    ("files", "complaint"),
    [
        ({"fsw/app/kc_a.c": "int n_looks;\n"}, "fsw/app/kc_a.c:1: 'n_looks' is an old word: observation"),
        (
            {"fsw/app/kc_a.h": "/* two\n * first looks */\n"},
            "fsw/app/kc_a.h:2: 'first looks' is an old word",
        ),
        ({"fsw/msg/a_t.lcm": "double servo_leash;\n"}, "'servo_leash' is an old word: servo bound"),
        ({"ground/kincal/x.py": "class LadderStep: ...\n"}, "'LadderStep' is an old word: nested models"),
        ({"ground/kincal/x.py": "KEYS = {'rungs': 1}\n"}, "ground/kincal/x.py:1: 'rungs' is an old word"),
        (
            {"ground/kincal/x.py": '"""Help.\n\n    The camera head turns.\n"""\n'},
            "x.py:3: 'camera head' is an old",
        ),
        ({"sim/models/a.toml": "[survive]\n"}, "sim/models/a.toml:1: 'survive' is an old word: error bounds"),
        ({"tables/src/a.toml": "# as drawn\nn = 1\n"}, "tables/src/a.toml:1: 'as drawn' is an old word"),
        ({"docs/A.md": "A proven way.\n"}, "docs/A.md:1: 'proven' is an old word: verified"),
        ({"docs/A.md": "The column `twin_of`.\n"}, "'twin_of' is an old word: equivalent effect"),
    ],
)
def test_an_old_word_is_named_with_the_new_one(tmp_path, files, complaint):
    done = script("glossary.py", write(tmp_path, {"docs/GLOSSARY.md": GLOSSARY, **files}))
    assert done.returncode == 1
    assert complaint in done.stdout


def test_the_same_words_in_their_ordinary_sense_pass(tmp_path):
    text = "Look at the log. The hubs are far apart, and it looks like noise that is drawn from a prior.\n"
    code = "int lookup; /* what survives a power loss; two that cannot be told apart */\n"
    files = {"docs/GLOSSARY.md": GLOSSARY, "docs/A.md": text, "fsw/app/kc_a.c": code}
    done = script("glossary.py", write(tmp_path, files), "docs", "fsw")
    assert (done.returncode, done.stdout) == (0, "")


@pytest.mark.parametrize(
    ("files", "complaint"),
    [
        (
            {"fsw/state/kc_states.h": "typedef enum { KC_ST_SAFE = 0, KC_ST_LIMBO = 1 } s;"},
            "LIMBO (states): 'limbo' is not in",
        ),
        (
            {"fsw/tables/kc_events.h": 'X(1, SAFE_MODE, INFO, "text", "")\n'},
            "SAFE_MODE (events): 'mode' is not in",
        ),
        ({"docs/TABLES.md": "| 3 | wobble_m | f64 | | |\n"}, "wobble_m (table fields): 'wobble' is not in"),
        (
            {"ground/kincal/workbench/report/answers.py": "def f(): return {'state': 1, 'frobnicity': 2}\n"},
            "frobnicity (JSON keys): 'frobnicity' is not in",
        ),
        ({"docs/CLI.md": "### `kincal safe polish`\n"}, "kincal safe polish (commands): 'polish' is not in"),
    ],
)
def test_a_specialised_word_without_an_entry_is_named(tmp_path, files, complaint):
    done = script("glossary.py", write(tmp_path, {"docs/GLOSSARY.md": GLOSSARY, **files}))
    assert done.returncode == 1
    assert f"{complaint} docs/GLOSSARY.md" in done.stdout


@pytest.mark.parametrize(("row", "known"), [("the arm waits | told", True), ("the arm waits | ", False)])
def test_a_state_is_explained_by_its_row_on_the_page_of_states(tmp_path, row, known):
    page = f"| state | what happens | ends when |\n|---|---|---|\n| `LIMBO` | {row} |\n\n| `MURK` | a | b |\n"
    header = "typedef enum { KC_ST_SAFE = 0, KC_ST_LIMBO = 1, KC_ST_MURK = 2 } s;"
    files = {"docs/GLOSSARY.md": GLOSSARY, "docs/STATES.md": page, "fsw/state/kc_states.h": header}
    said = script("glossary.py", write(tmp_path, files)).stdout
    assert ("LIMBO (states): 'limbo' is not in" not in said) == known
    assert "MURK (states): 'murk' is not in" in said


@pytest.mark.parametrize(
    ("page", "complaint"),
    [
        (GLOSSARY.replace("| common |", "| |"), "GLOSSARY.md:7: a row is"),
        (GLOSSARY.replace('"state"', '"safe"'), "safe is there twice"),
        (GLOSSARY.replace("</a>safe", "</a>zone"), "Operation: 'zone' stands before 'state'"),
        (GLOSSARY + "See [STATES](STATES.md).\n", "GLOSSARY.md: link to STATES.md leads nowhere"),
        (GLOSSARY + "See [hub](#hub).\n", "GLOSSARY.md: link to #hub leads nowhere"),
        (GLOSSARY + "See method.md 3.\n", "GLOSSARY.md:9: method.md is outside the repository"),
        (
            GLOSSARY + "The sets are in ../shared/data.\n",
            "GLOSSARY.md:9: ../shared is outside the repository",
        ),
    ],
)
def test_a_bad_row_link_or_reference_is_named(tmp_path, page, complaint):
    done = script("glossary.py", write(tmp_path, {"docs/GLOSSARY.md": page}))
    assert done.returncode == 1
    assert complaint in done.stdout


def test_a_source_of_terms_that_is_gone_is_named(tmp_path):
    done = script("glossary.py", write(tmp_path, {"docs/GLOSSARY.md": GLOSSARY}))
    assert done.returncode == 1
    assert "fsw/state/kc_states.h: no states found" in done.stdout


LOOPS = {
    "fsw/math/kc_limits.h": "#define KC_COEF_MAX 64u\n",
    "tests/lint/loops.toml": '[everywhere]\nn_coef = "KC_COEF_MAX"\n',
}
LOOP = "void f(void)\n{{\n    for (uint32_t i = 0u; i < {}; i++) {{}}\n}}\n"


@pytest.mark.parametrize("bound", ["6u", "KC_COEF_MAX", "t->n_coef"])
def test_a_loop_with_a_named_bound_is_listed(tmp_path, bound):
    root = write(tmp_path, LOOPS | {"fsw/app/kc_a.c": LOOP.format(bound) + LOOP.format("t->n_coef")})
    assert script("loops.py", root).returncode == 0
    assert f"| `f` | `i < {bound}` |" in (tmp_path / "build/LOOPS.md").read_text()


@pytest.mark.parametrize(
    ("files", "complaint"),
    [
        ({"fsw/app/kc_a.c": LOOP.format("n")}, "fsw/app/kc_a.c:3: no bound of this loop is known: i < n"),
        (
            {"fsw/app/kc_a.c": "void f(void)\n{\n    while (more()) {}\n}\n"},
            "no bound of this loop is known",
        ),
        ({"tests/lint/loops.toml": '[everywhere]\nn_coef = "LOTS"\n'}, "the bound LOTS names LOTS"),
        ({"tests/lint/loops.toml": '[everywhere]\nn_coef = "64"\nn_x = "6"\n'}, "no loop for n_x"),
    ],
)
def test_a_loop_without_a_bound_is_named(tmp_path, files, complaint):
    first = {"fsw/app/kc_c.c": LOOP.format("t->n_coef")}
    root = write(tmp_path, LOOPS | first | files)
    done = script("loops.py", root)
    assert done.returncode == 1
    assert complaint in done.stdout


# ---- requirements

REQUIREMENT = "id,requirement,rationale,verified by\nKC-A-01,It shall stop.,Safety.,{}\n"
VERIFIED = {
    "Makefile": "wcet: core\n",
    "tests/unit/test_kc_a.c": "void test_it_stops(void) {}\n",
    "docs/REQUIREMENTS.csv": REQUIREMENT.format("tests/unit/test_kc_a.c::test_it_stops; make wcet"),
}


def test_a_requirement_with_its_tests_is_accepted(tmp_path):
    done = script("requirements.py", write(tmp_path, VERIFIED))
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(
    ("files", "complaint"),
    [
        ({"docs/REQUIREMENTS.csv": REQUIREMENT.format("tests/unit/test_kc_b.c")}, "no such file"),
        ({"docs/REQUIREMENTS.csv": REQUIREMENT.format("tests/unit/test_kc_a.c::test_x")}, "no such test"),
        ({"docs/REQUIREMENTS.csv": REQUIREMENT.format("make cross")}, "make cross: no such target"),
        ({"docs/REQUIREMENTS.csv": REQUIREMENT.format("")}, "KC-A-01: verified by is empty"),
        ({"docs/REQUIREMENTS.csv": REQUIREMENT.replace("A-01", "1").format("make wcet")}, "the id is not"),
        ({"docs/REQUIREMENTS.csv": REQUIREMENT.replace("shall ", "").format("make wcet")}, "what shall be"),
        ({"docs/REQUIREMENTS.csv": "id,text\nKC-A-01,x\n"}, "the columns have to be"),
        (
            {
                "docs/REQUIREMENTS.csv": VERIFIED["docs/REQUIREMENTS.csv"]
                + "KC-A-01,It shall.,Why.,make wcet\n"
            },
            "KC-A-01: twice",
        ),
        (
            {"tests/unit/test_kc_b.c": "void test_x(void) {}\n"},
            "tests/unit/test_kc_b.c: verifies no requirement",
        ),
    ],
)
def test_a_requirement_without_a_test_and_a_test_without_one_are_named(tmp_path, files, complaint):
    done = script("requirements.py", write(tmp_path, VERIFIED | files))
    assert done.returncode == 1
    assert complaint in done.stdout
